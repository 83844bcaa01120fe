"""Pictures of shock response spectra, on four-way logarithmic paper."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from viscovib import _native
from viscovib.analyses.shock_spectra import ShockResponseSpectrum
from viscovib.common.results import Axes
from viscovib.plots.axes import logarithmic, plain_hertz
from viscovib.plots.panels import panel
from viscovib.plots.style import COLOURS, STYLES, bare

#: Curves of a picture.
CURVES = ("maximax", "positive", "negative", "primary", "residual")


def plot_shock_spectrum(
    spectrum: ShockResponseSpectrum,
    ax: Axes | None = None,
    *,
    curves: str | tuple[str, ...] = "maximax",
) -> Axes:
    """Draw a shock response spectrum over the natural frequency.

    A pseudo-velocity is drawn on four-way logarithmic paper: along rising grey lines the relative
    displacement is constant, along falling grey lines the pseudo-acceleration.

    Parameters
    ----------
    spectrum : ShockResponseSpectrum
    ax : Axes, optional
    curves : str or tuple of str
        "maximax", "positive", "negative", "primary" or "residual".
    """
    _native.check_instance("spectrum", spectrum, ShockResponseSpectrum)
    names = (curves,) if isinstance(curves, str) else tuple(curves)
    ax = panel(ax, (7, 5))
    order = np.argsort(spectrum.frequencies)
    for i, name in enumerate(names):
        ax.plot(
            spectrum.frequencies[order],
            getattr(spectrum, _native.choice("curves", name, CURVES))[order],
            color=COLOURS[i % len(COLOURS)],
            linestyle=STYLES[i % len(STYLES)],
            label=name,
        )
    unit = spectrum.unit.replace("^2", "$^2$")
    label = spectrum.quantity.replace("_", " ").replace("pseudo ", "pseudo-")
    ax.set(xlabel="natural frequency (Hz)", ylabel=f"{label} ({unit})")
    ax.set_xscale("log")
    plain_hertz(ax)
    if any(np.any(getattr(spectrum, name) > 0) for name in names):
        logarithmic(ax)
        if spectrum.quantity == "pseudo_velocity":
            _four_way(ax)
    ax.legend(frameon=False)
    bare(ax)
    return ax


def _four_way(ax: Axes) -> None:
    """Draw lines of constant displacement (m) and of constant acceleration (m/s^2)."""
    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    ends = np.array([left, right])
    style: dict[str, Any] = {"color": "0.8", "linewidth": 0.6, "zorder": 0}
    for rises, unit in ((True, "m"), (False, "m/s$^2$")):
        # log v = log(level) +- log(2 pi f).
        turned = 2 * math.pi * ends
        corners = np.array([low, high])[:, np.newaxis]
        levels = np.log10(corners / turned if rises else corners * turned)
        for power in range(math.ceil(levels.min()), math.floor(levels.max()) + 1):
            level = 10.0**power
            ax.plot(ends, level * turned if rises else level / turned, **style)
            # Labels are near the left end, of rising lines further inside than of falling ones.
            f = 1.6 * left if rises else max(1.1 * left, 1.3 * level / (2 * math.pi * high))
            v = 2 * math.pi * f * level if rises else level / (2 * math.pi * f)
            if rises and v < low:
                f, v = low / (2 * math.pi * level), low
            if left <= f <= right * 0.6 and low <= v <= 0.8 * high:
                ax.annotate(
                    f"{level:g} {unit}",
                    (f, v),
                    xytext=(3, 3 if rises else -3),
                    textcoords="offset points",
                    rotation=35 if rises else -35,
                    rotation_mode="anchor",
                    va="bottom" if rises else "top",
                    fontsize=6,
                    color="0.5",
                )
    ax.set(xlim=(left, right), ylim=(low, high))
