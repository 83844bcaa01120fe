"""Plots of relaxation kernels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.results import Axes
from viscovib.errors import InputError
from viscovib.kernels.relaxation import Kernel
from viscovib.plots.panels import panels

_DARK = "#0b1d51"
#: Smallest drawn value, relative to the largest.
_SHOWN = 1e-8


def plot_kernel(
    kernel: Kernel, ax: Sequence[Axes] | None = None, t: npt.ArrayLike | None = None
) -> Sequence[Axes]:
    """Draw R(t) and, in a second panel, the relaxation after a unit step of strain."""
    times = _times(kernel) if t is None else _native.real_array("t", t, ndim=1)
    if not times.size or times.min() <= 0:
        raise InputError("t: must be times greater than 0")
    first, second = axes = panels(ax, 2, "R(t) and the relaxation")
    values = kernel(times)
    first.semilogx(times, values, color=_DARK)
    first.set(ylabel="kernel $R(t)$ (1/s)")
    if values.max() > 0:
        # With an exponential decay in view the other decades would be invisible.
        first.set(yscale="log", ylim=(max(values.min(), _SHOWN * values.max()), None))
    second.semilogx(times, kernel.relaxation(times), color=_DARK)
    second.set(xlabel="time $t$ (s)", ylabel=r"relaxation $1 - \int_0^t R$")
    return axes


def _times(kernel: Kernel) -> FloatArray:
    """Return times around the frequency at which the sine transform is largest."""
    mu = np.logspace(-9, 9, 181)
    center = -np.log10(mu[int(np.argmax(kernel.sine(mu)))])
    return np.logspace(center - 3, center + 3, 301)
