"""One picture, instead of the page, with the effect of each number of a scene."""

import warnings
from collections.abc import Sequence
from pathlib import Path

from viscovib.common.files import whole_file
from viscovib.errors import ViscovibError
from viscovib.explorer.drawn import Curve, curves_of
from viscovib.explorer.numbers import Number, chosen
from viscovib.plots.axes import logarithmic
from viscovib.plots.style import COLOURS, STYLES, bare, harmonic_of, in_brackets, symbol
from viscovib.scene.job import run_one
from viscovib.scene.scene import Scene
from viscovib.sweeps.points import quiet

#: Largest number of shown numbers, and the factor by which each is changed.
_MOST, _FACTOR = 12, 1.25


def _label(curve: Curve) -> str:
    unit = in_brackets(curve.unit) if curve.unit else ""
    if curve.order is None:
        return f"${symbol(curve.name)}${unit}"
    return f"$|{harmonic_of(curve.name, curve.order)}|${unit}"


def _values(number: Number, factor: float) -> dict[str, float]:
    """Return a number times a factor; its equal entry in a symmetric matrix changes too."""
    return {key: number.value * factor for key in (number.key, number.mirror) if key is not None}


def save_sheet(scene: Scene, path: Path, keys: Sequence[str] | None = None) -> None:
    """Draw the effect of each number in a row of panels, at 0.8, 1 and 1.25 times its value."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    one = scene.override({})
    moved = [number for number in chosen(one, keys).values() if number.value][:_MOST]
    with warnings.catch_warnings():
        quiet()
        middle = curves_of(run_one(one).value)
        n = len(middle)
        figure = Figure(figsize=(4.2 * n, 1.9 * len(moved) + 0.6), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(len(moved), n, sharex=True, squeeze=False)
        for row, number in zip(axes, moved, strict=True):
            for factor, colour, style in (
                (1 / _FACTOR, COLOURS[3], STYLES[1]),
                (1.0, "0.3", "-"),
                (_FACTOR, COLOURS[0], STYLES[3]),
            ):
                try:
                    found = (
                        middle
                        if factor == 1
                        else curves_of(run_one(one.override(_values(number, factor))).value)
                    )
                except ViscovibError:
                    # This value is out of range: draw only the others.
                    continue
                for axis, curve in zip(row, found, strict=True):
                    label = f"{number.key} = {number.value * factor:.4g}"
                    axis.plot(
                        curve.x, curve.y, color=colour, linestyle=style, linewidth=1.1, label=label
                    )
            for axis, curve in zip(row, middle, strict=True):
                axis.set_ylabel(_label(curve))
                if curve.log:
                    logarithmic(axis)
                bare(axis)
            legend = row[0].legend(
                frameon=False, fontsize=7, loc="lower left", bbox_to_anchor=(0, 1), ncols=3
            )
            # Above its row, where a blank title leaves room; it must not widen the column.
            legend.set_in_layout(False)
            row[0].set_title(" ", fontsize=9)
    for axis, curve in zip(axes[-1], middle, strict=True):
        axis.set_xlabel(curve.x_label)
    with whole_file(path, "wb") as file:
        figure.savefig(file, dpi=120, format="png")
