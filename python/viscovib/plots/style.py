"""Common style of all plots: colours, line styles, symbols, frames."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: From dark to light, so that a greyscale print has the same order.
COLOURS = ("#0b1d51", "#7b1e7a", "#c8452e", "#e08e1b", "#b9b21a")
STYLES = ("-", (0, (6, 1.5)), (0, (4, 1.2, 1, 1.2)), (0, (2, 1)), (0, (1, 1)))

#: Stable motions are dark, thick and solid, unstable ones lighter, thinner and dashed, unknown ones
#: grey and dotted: they differ without colour and where they overlap.
BY_STABILITY: tuple[tuple[bool | None, str, dict[str, Any]], ...] = (
    (True, "stable", {"color": COLOURS[0], "linewidth": 2.0}),
    (False, "unstable", {"color": COLOURS[2], "linewidth": 1.3, "linestyle": (0, (4, 2))}),
    (None, "stability unknown", {"color": "0.45", "linewidth": 1.5, "linestyle": (0, (1, 1.2))}),
)
#: Names that need no escape, and characters that need one in a formula.
_WORD, _SIGN, _ESCAPED = re.compile(r"\w+"), re.compile(r"([\\{}$])"), r"\\\1"
SYMBOLS = {"x": "x", "phi": r"\varphi", "psi": r"\psi"}


def plain(text: str) -> str:
    """Return a text that matplotlib draws unchanged: a dollar sign does not start a formula."""
    return text.replace("$", r"\$")


def in_brackets(unit: str) -> str:
    """Unit in brackets; empty for a dimensionless coordinate."""
    return "" if unit in ("1", "L") else f" ({plain(unit)})"


def symbol(name: str) -> str:
    """Return a name in mathematical notation: Greek, italic with an index, or upright."""
    if name in SYMBOLS or (len(name) == 1 and name.isalnum()):
        return SYMBOLS.get(name, name)
    if name[:1].isalpha() and name[1:].isdigit():
        return f"{{{name[0]}_{{{name[1:]}}}}}"
    if _WORD.fullmatch(name):
        return rf"\mathrm{{{name}}}".replace("_", r"\_")
    return rf"\text{{{_SIGN.sub(_ESCAPED, name)}}}"


def harmonic_of(name: str, order: int | tuple[int, ...]) -> str:
    """Return the symbol with the order below a letter, or above a name with its own index."""
    plain = name in SYMBOLS or len(name) == 1
    text = ",".join(map(str, order)) if isinstance(order, tuple) else str(order)
    return f"{symbol(name)}_{{{text}}}" if plain else f"{symbol(name)}^{{({text})}}"


def bare(axis: Axes) -> None:
    """Remove the upper and right frame lines and add a light grid."""
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(color="0.9", linewidth=0.6)
    axis.set_axisbelow(True)
