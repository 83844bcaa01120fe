"""Plots of motions in time: histories, phase planes, sections, spectra."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.spectral import Spectrum, name_frequencies
from viscovib.common.results import Axes, Figure
from viscovib.errors import InputError
from viscovib.plots.axes import Shown, logarithmic
from viscovib.plots.panels import Labels, panel, panels
from viscovib.plots.style import COLOURS, STYLES, bare, in_brackets, plain, symbol
from viscovib.results.ensemble import Ensemble
from viscovib.results.motion_forces import ElementForces, FloorForce, PointMotion
from viscovib.results.steady_motion import SteadyMotion
from viscovib.results.trajectory import Trajectory

_LABELS = Labels("labels")
_DOTS: dict[str, Any] = {
    "linestyle": "none",
    "marker": ".",
    "markersize": 1.5,
    "markeredgewidth": 0,
    "color": COLOURS[0],
    "rasterized": True,
}


def plot_in_time(
    result: ElementForces | PointMotion | FloorForce, ax: Axes | Sequence[Axes] | None = None
) -> Sequence[Axes]:
    """Draw the curves of a result over time, an axis for each.

    Parameters
    ----------
    result : ElementForces, PointMotion or FloorForce
    ax : Axes or sequence of Axes, optional
        One per curve. None creates a figure.
    """
    curves = result.panels()
    axes = panels(ax, len(curves), "one per curve")
    for axis, curve in zip(axes, curves, strict=True):
        axis.plot(curve.x, curve.y, color=COLOURS[0])
        unit = f" ({curve.unit})" if curve.unit else ""
        axis.set_ylabel(f"{plain(curve.name)}{unit}")
        bare(axis)
    axes[-1].set_xlabel(curves[-1].x_label)
    return axes


def plot_trajectory(
    trajectory: Trajectory | SteadyMotion | Sequence[Trajectory | SteadyMotion],
    ax: Axes | Sequence[Axes] | None = None,
    *,
    labels: Sequence[str] | None = None,
) -> Sequence[Axes]:
    """Draw the history and the phase plane of each coordinate of motions.

    Parameters
    ----------
    trajectory : Trajectory, SteadyMotion or sequence of them
    ax : sequence of Axes, optional
        Two axes per coordinate, history and phase plane; None creates a figure.
    labels : sequence of str, optional
        A legend entry per motion.

    Returns
    -------
    sequence of Axes: history and phase plane of z, then of phi, then of psi.

    Examples
    --------
    >>> import viscovib as vv
    >>> mount = vv.Mount(
    ...     mass=1,
    ...     inertia=0.1,
    ...     offset=0.5,
    ...     stiffness_x=10,
    ...     stiffness_phi=2,
    ...     damping=[[0.2, -0.1], [-0.1, 0.09]],
    ... )
    >>> axes = vv.plot_trajectory(vv.simulate(mount, 20, load=0.1, nu=1.5))
    """
    runs = _native.several("trajectory", trajectory, Trajectory, SteadyMotion)
    labels = _LABELS.of(labels, len(runs))
    names = runs[0].dof_names
    if ax is None:
        import matplotlib.pyplot as plt

        figure = plt.figure(figsize=(10, 2.4 * len(names)), layout="constrained")
        ax = motion_axes(figure, len(names))
    axes = panels(ax, 2 * len(names), "two per coordinate")
    for d, name in enumerate(names):
        history, plane = axes[2 * d], axes[2 * d + 1]
        for i, run in enumerate(runs):
            style = {"color": COLOURS[i % len(COLOURS)], "linestyle": STYLES[i % len(STYLES)]}
            q, v = run.state[:, 2 * d], run.state[:, 2 * d + 1]
            history.plot(run.t, q, linewidth=1.1, label=labels[i] if labels else None, **style)
            plane.plot(q, v, linewidth=0.7, **style)
        letter = symbol(name)
        unit = runs[0].dof_units[d]
        history.set_ylabel(f"${letter}${in_brackets(unit)}")
        plane.set(xlabel=f"${letter}$", ylabel=rf"${letter}'$")
        for axis in (history, plane):
            bare(axis)
    in_seconds = runs[0].system.time_unit == "s"
    axes[-2].set_xlabel("$t$ (s)" if in_seconds else r"$\tau = \omega_1 t$")
    if labels:
        axes[0].legend(frameon=False)
    return axes


def plot_sections(
    ensemble: Ensemble,
    ax: Axes | None = None,
    *,
    parameter: str | None = None,
    quantity: str = "phi",
) -> Axes:
    """Draw the section points of an ensemble.

    With the name of a ``parameter`` that varies: a bifurcation diagram of ``quantity`` over it;
    without it: a Poincare section, ``quantity`` against its velocity.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> body = vv.Pendulum(
    ...     e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01, f0=0.002, p1=1.02
    ... )
    >>> many = vv.simulate_ensemble(body, initial=np.zeros((3, 6)), t_end=100.0, sections=1)
    >>> ax = vv.plot_sections(many, quantity="z")
    """
    _native.check_instance("ensemble", ensemble, Ensemble)
    if ensemble.sections is None:
        raise InputError("ensemble: contains no sections, must be computed with sections=1, 2 or 3")
    dofs = ensemble.system.dof_names
    d = dofs.index(_native.choice("quantity", quantity, dofs))
    ax = panel(ax)
    letter = symbol(quantity)
    q = ensemble.sections[:, :, 2 * d]
    if parameter is None:
        ax.plot(q.ravel(), ensemble.sections[:, :, 2 * d + 1].ravel(), **_DOTS)
        ax.set(xlabel=f"${letter}$", ylabel=rf"${letter}'$")
    else:
        _native.choice("parameter", parameter, tuple(ensemble.parameters))
        values = np.broadcast_to(ensemble.parameters[parameter][:, np.newaxis], q.shape)
        ax.plot(values.ravel(), q.ravel(), **_DOTS)
        ax.set(xlabel=parameter, ylabel=f"${letter}$ at whole periods (rad)")
    bare(ax)
    return ax


def plot_spectrum(
    spectrum: Spectrum,
    ax: Axes | None = None,
    *,
    bases: Mapping[str, float] | None = None,
    highest: float | None = None,
    x: str = "rad/s",
    y: str = "log",
    reference: float = 1.0,
) -> Axes:
    """Draw amplitude against circular frequency, one curve per signal.

    Parameters
    ----------
    spectrum : Spectrum
    ax : Axes, optional
    bases : mapping of name to frequency, optional
        The largest peaks are labelled as combinations of these, to within a bin.
    highest : float, optional
        Highest circular frequency of the plot.
    x : {"rad/s", "hz"}
        "hz": frequencies in Hz, for signals sampled in seconds.
    y : {"log", "linear", "db"}
        Logarithmic or linear amplitudes, or decibels.
    reference : float
        Amplitude of 0 dB.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> t = 0.01 * np.arange(4096)
    >>> ax = vv.plot_spectrum(vv.spectrum(np.sin(12 * t), 0.01), x="hz", y="db")

    See Also
    --------
    spectrum, name_frequencies
    """
    shown_as = Shown.checked(x, y, reference)
    if y == "phase":
        raise InputError("y = 'phase': must be one of 'log', 'linear', 'db' for a spectrum")
    _native.check_instance("spectrum", spectrum, Spectrum)
    ax = panel(ax, (8, 4.5))
    columns = spectrum.amplitude.reshape(spectrum.omega.size, -1)
    shown = spectrum.omega > 0
    if highest is not None:
        shown &= spectrum.omega <= _native.number("highest", highest)
    for j, name in enumerate(spectrum.names):
        ax.plot(
            shown_as.places(spectrum.omega[shown], True),
            shown_as.sizes(columns[shown, j]),
            color=COLOURS[j % len(COLOURS)],
            linestyle=STYLES[j % len(STYLES)],
            linewidth=0.9,
            label=f"${symbol(name)}$" if len(name) < 4 else plain(name),
        )
    if bases is not None and columns.size:
        _name_peaks(ax, spectrum.omega[shown], columns[shown].max(axis=1), bases, shown_as)
    hertz, level = x == "hz", f"amplitude (dB re {shown_as.reference:g})"
    ax.set(
        xlabel="frequency (Hz)" if hertz else r"circular frequency $\omega$",
        ylabel=level if y == "db" else "amplitude",
    )
    if y == "log" and (columns[shown] > 0).any():
        logarithmic(ax)
    ax.margins(y=0.12 if bases else 0.05)
    ax.legend(frameon=False)
    bare(ax)
    return ax


def _name_peaks(
    ax: Axes,
    omega: FloatArray,
    amplitude: FloatArray,
    bases: Mapping[str, float],
    shown: Shown,
) -> None:
    """Label the peaks above a thousandth of the largest, if there is room."""
    if amplitude.size < 3:
        return
    inner = amplitude[1:-1]
    peaks = 1 + np.flatnonzero((inner > amplitude[:-2]) & (inner >= amplitude[2:]))
    peaks = peaks[amplitude[peaks] > 1e-3 * amplitude.max()]
    if not peaks.size:
        return
    peaks = peaks[np.argsort(-amplitude[peaks])]
    names = name_frequencies(omega[peaks], bases, order=4, tolerance=float(omega[1] - omega[0]))
    room, taken = 0.02 * float(omega[-1] - omega[0]), np.empty(0)
    for k, name in zip(peaks, names, strict=True):
        if not name or np.any(np.abs(taken - omega[k]) < room):
            continue
        taken = np.append(taken, omega[k])
        ax.annotate(
            name.split(" or ")[0],
            (float(shown.places(omega[k], True)), float(shown.sizes(amplitude[k]))),
            xytext=(0, 4),
            textcoords="offset points",
            ha="center",
            va="bottom",
            rotation=90,
            fontsize=7,
        )


def motion_axes(figure: Figure, n: int) -> Sequence[Axes]:
    """Return a row of two panels for each coordinate: history and phase plane."""
    axes = figure.subplots(n, 2, width_ratios=[3, 1], squeeze=False)
    for row in axes[:-1]:
        row[0].sharex(axes[-1, 0])
        row[0].tick_params(labelbottom=False)
    return [axis for row in axes for axis in row]
