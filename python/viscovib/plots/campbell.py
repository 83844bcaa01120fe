"""Pictures of Campbell diagrams."""

from __future__ import annotations

from typing import Any

import numpy as np

from viscovib import _native
from viscovib.analyses.campbell import Campbell
from viscovib.common.results import Axes
from viscovib.plots.panels import panel
from viscovib.plots.style import COLOURS, bare

#: Whirl below which a motion is nearly on a line.
_FLAT = 0.05
#: Directions of whirl with their lines, which differ without colour.
_STYLES: tuple[tuple[str, int, dict[str, Any]], ...] = (
    ("forward", 1, {"color": COLOURS[0], "linewidth": 1.8}),
    ("backward", -1, {"color": COLOURS[2], "linewidth": 1.6, "linestyle": (0, (5, 2))}),
    ("neither", 0, {"color": "0.45", "linewidth": 1.6, "linestyle": (0, (1, 1.2))}),
)


def plot_campbell(diagram: Campbell, ax: Axes | None = None) -> Axes:
    """Draw natural frequencies over the speed, with orders, critical speeds and instability.

    Forward whirl is drawn solid and dark, backward whirl dashed and lighter; without a plane all
    modes are solid. Circles mark critical speeds. Speeds above the threshold of stability are
    shaded.

    Parameters
    ----------
    diagram : Campbell
    ax : Axes, optional

    Returns
    -------
    Axes

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> disc = vv.PolynomialSystem(
    ...     mass=[1, 1], stiffness=[4, 4], gyroscopic=[[0, 0.5], [-0.5, 0]], names=["a", "b"]
    ... )
    >>> ax = vv.plot_campbell(vv.campbell(disc, np.linspace(0, 5, 11), plane=("a", "b")))
    """
    _native.check_instance("diagram", diagram, Campbell)
    ax = panel(ax, (7, 4.5))
    speeds, frequencies = diagram.speeds, diagram.frequencies
    top = np.nanmax(frequencies, initial=0.0) * 1.08 or 1.0
    for order in diagram.orders:
        ax.plot([0, speeds[-1]], [0, order * speeds[-1]], color="0.6", linewidth=0.8, zorder=1)
        right = min(speeds[-1], top / order)
        ax.annotate(
            f"{order:g}\N{MULTIPLICATION SIGN}", (right, order * right), xytext=(-2, -7),
            textcoords="offset points", ha="right", va="top", fontsize=8, color="0.4",
        )  # fmt: skip
    if diagram.whirl is None:
        ax.plot(speeds, frequencies, color=COLOURS[0], linewidth=1.8)
    else:
        directions = np.where(np.abs(diagram.whirl) >= _FLAT, np.sign(diagram.whirl), 0.0)
        for name, direction, style in _STYLES:
            label: str | None = name
            for mode in range(frequencies.shape[1]):
                # A piece between two speeds has the direction at its upper end.
                kept = directions[:, mode] == direction
                kept[:-1] |= kept[1:]
                if kept.sum() < 2:
                    continue
                line = np.where(kept, frequencies[:, mode], np.nan)
                ax.plot(speeds, line, label=label, **style)
                label = None
    critical = diagram.critical_speeds
    if critical.size:
        ax.plot(
            critical, diagram.critical_orders * critical, linestyle="none", marker="o",
            markerfacecolor="white", markeredgecolor="black", markersize=6, label="critical speed",
            zorder=4,
        )  # fmt: skip
    if np.isfinite(diagram.threshold):
        ax.axvspan(diagram.threshold, speeds[-1], color="0.9", zorder=0, label="unstable")
    ax.set(
        xlabel="speed (rad/s)", ylabel="natural frequency (rad/s)", xlim=(speeds[0], speeds[-1]),
        ylim=(0, top),
    )  # fmt: skip
    if ax.get_legend_handles_labels()[0]:
        ax.legend(frameon=False, fontsize=8)
    bare(ax)
    return ax
