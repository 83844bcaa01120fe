"""Texts of the explorer about a result: its peaks, and the legend of lines and signs."""

from collections.abc import Sequence

import numpy as np

from viscovib.explorer.drawn import STABLE, UNKNOWN, UNSTABLE, Curve
from viscovib.explorer.state import State
from viscovib.sweeps.scenes import summary

_LINE = (
    "<svg width='30' height='10' aria-hidden='true'><line x1='0' x2='30' y1='5' y2='5' "
    "stroke='{color}' stroke-width='{width}' stroke-dasharray='{dash}'/></svg> {text}"
)
_SIGNS = {
    "fold": "&#9675;",
    "branch point": "&#9633;",
    "symmetry breaking": "&#9651;",
    "period doubling": "&#9671;",
    "Neimark-Sacker": "&#9661;",
}


def peaks(state: State) -> str:
    """Return peaks and their changes since the scene was read, as HTML."""
    if state.result.value._form == "table" and state.result.kind != "modes":
        # The first row of a table of harmonics is not informative.
        return ""
    try:
        now, before = summary(state.result), state.first_numbers
    except ValueError:
        # This kind of result has no summary.
        return ""
    parts = []
    for key, value in now.items():
        if isinstance(value, str) or key.startswith("nu_peak"):
            continue
        text = f"{key} <b>{value:.4g}</b>"
        if f"nu_{key}" in now:
            text += f" at {now[f'nu_{key}']:.4g}"
        old = before.get(key)
        if old and np.isfinite(value / old) and value != old:
            text += f" ({100 * (value / old - 1):+.1f} %)"
        if value or old:
            parts.append(text)
    return " &ensp; ".join(parts)


def legend(curves: Sequence[Curve], known: bool, frozen: bool, measured: bool) -> str:
    """Return the legend of the drawn lines and signs, as HTML.

    ``known``: whether stability was computed.
    """
    kinds = {int(s) for curve in curves for s in curve.stability[np.isfinite(curve.y)]}
    styles = (
        ("#0b1d51", 3, "", "stable", known and STABLE in kinds),
        ("#c8452e", 2, "7 4", "unstable", UNSTABLE in kinds),
        ("#666666", 2, "2 3", "stability unknown", known and UNKNOWN in kinds),
        ("#9a9a9a", 5, "", "frozen", frozen),
    )
    texts = [
        _LINE.format(color=color, width=width, dash=dash, text=text)
        for color, width, dash, text, shown in styles
        if shown
    ]
    if measured:
        texts.append("<b style='color:#1b7f4d'>&times;</b> measured")
    marks = {kind for curve in curves for kind, (x, _) in curve.marks.items() if len(x)}
    texts += [f"{sign} {kind}" for kind, sign in _SIGNS.items() if kind in marks]
    return " &ensp; ".join(f"<span style='white-space:nowrap'>{text}</span>" for text in texts)
