"""Pictures: every curve is told apart by line style as well as by colour."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._backbone import Backbone
from viscovib._native import FloatArray
from viscovib._spectrum import Spectrum, name_frequencies
from viscovib.branch_result import Branch
from viscovib.driven import DrivenResponse
from viscovib.driven_branch import DrivenBranch
from viscovib.ensemble import Ensemble
from viscovib.errors import InputError
from viscovib.panels import Labels, order_of, panel, panels
from viscovib.parameters import Flag
from viscovib.response_result import Response
from viscovib.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Dark to light, so that order survives a greyscale print.
COLOURS = ("#0b1d51", "#7b1e7a", "#c8452e", "#e08e1b", "#b9b21a")
STYLES = ("-", (0, (6, 1.5)), (0, (4, 1.2, 1, 1.2)), (0, (2, 1)), (0, (1, 1)))

#: How changes of stability other than folds are marked.
_CROSSING_MARKERS = {
    "branch point": "s",
    "symmetry breaking": "^",
    "period doubling": "D",
    "Neimark-Sacker": "v",
}
_LOG, _LABELS = Flag("log"), Labels("labels")
_SYMBOLS = {"x": "x", "phi": r"\varphi", "psi": r"\psi"}
_DOTS: dict[str, Any] = {
    "linestyle": "none",
    "marker": ".",
    "markersize": 1.5,
    "markeredgewidth": 0,
    "color": COLOURS[0],
    "rasterized": True,
}


def plot_response(
    response: Response | DrivenResponse | Sequence[Response | DrivenResponse],
    ax: Axes | Sequence[Axes] | None = None,
    *,
    labels: Sequence[str] | None = None,
    harmonic: int | tuple[int, ...] = 1,
    log: bool = True,
) -> Sequence[Axes]:
    """Draw amplitude against frequency, one panel a coordinate.

    Parameters
    ----------
    response : Response or DrivenResponse, or sequence of them
        Curves; gaps show where no solution was found. Where stability is known all are solid, but
        dashed where unstable.
    ax : Axes or sequence of Axes, optional
        Where to draw: as many as there are coordinates; None makes a figure.
    labels : sequence of str, optional
        A legend entry a curve.
    harmonic : int, or tuple for several base frequencies
        Order to draw.
    log : bool
        Logarithmic amplitudes.

    Returns
    -------
    sequence of Axes, one a coordinate.
    """
    curves = _native.several("response", response, Response, DrivenResponse)
    _LOG.check(log)
    labels = _LABELS.of(labels, len(curves))
    names = curves[0].dof_names
    axes = panels(ax, len(names))
    for axis, name, unit in zip(axes, names, curves[0].dof_units, strict=True):
        for i, curve in enumerate(curves):
            amplitude = _amplitude(curve, name, harmonic)
            shown: list[tuple[FloatArray, Any]] = [(amplitude, STYLES[i % len(STYLES)])]
            if isinstance(curve, Response) and curve.stable is not None:
                unstable = curve.stable == False  # noqa: E712
                shown = [
                    (np.where(unstable, np.nan, amplitude), "-"),
                    (np.where(_with_neighbours(unstable), amplitude, np.nan), (0, (3, 1.5))),
                ]
            for values, style in shown:
                axis.plot(
                    curve.nu if isinstance(curve, Response) else curve.parameter,
                    values,
                    color=COLOURS[i % len(COLOURS)],
                    linestyle=style,
                    linewidth=1.6,
                    label=labels[i] if labels and style == shown[0][1] else None,
                )
        axis.set_ylabel(rf"amplitude $|{_harmonic(name, harmonic)}|${_in(unit)}")
        if log and any((line.get_ydata() > 0).any() for line in axis.lines):
            axis.set_yscale("log")
        _bare(axis)
    axes[-1].set_xlabel(
        r"circular frequency of the load $\nu$ (rad/s)"
        if isinstance(curves[0], Response)
        else curves[0].varies or curves[0].axes[0]
    )
    if labels:
        axes[0].legend(frameon=False)
    return axes


def _with_neighbours(shown: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Points and those beside them, so that a stretch leaves no gap."""
    wider = shown.copy()
    wider[1:] |= shown[:-1]
    wider[:-1] |= shown[1:]
    return wider


def _in(unit: str) -> str:
    """Unit in brackets; nothing of a coordinate that has none."""
    return "" if unit in ("1", "L") else f" ({unit})"


def _amplitude(
    curve: Response | DrivenResponse, name: str, harmonic: int | tuple[int, ...]
) -> FloatArray:
    if isinstance(curve, DrivenResponse):
        return curve.amplitude(name, harmonic)
    if not isinstance(harmonic, int):
        raise InputError(f"harmonic = {_native.shown(harmonic)}: must be an integer")
    return curve.amplitude(name, harmonic)


def plot_branch(
    branch: Branch | DrivenBranch,
    ax: Axes | Sequence[Axes] | None = None,
    *,
    harmonic: int | tuple[int, ...] | Mapping[str, int | tuple[int, ...]] = 1,
    log: bool = False,
) -> Sequence[Axes]:
    """Draw amplitude along a branch, one panel a coordinate.

    Stable parts are solid, unstable ones dashed; where stability is unknown the line is grey.
    Folds, branch points and other changes of stability are marked. ``harmonic`` may be a mapping
    from coordinates.
    """
    _native.check_instance("branch", branch, Branch, DrivenBranch)
    _LOG.check(log)
    names = branch.dof_names
    axes = panels(ax, len(names))
    for axis, name, unit in zip(axes, names, branch.dof_units, strict=True):
        order = order_of(harmonic, name)
        amplitude = branch.amplitude(name, order)
        if branch.stable is None:
            axis.plot(branch.parameter, amplitude, color="0.45", label="stability unknown")
        else:
            for stable, style in ((True, "-"), (False, (0, (3, 1.5)))):
                # A stretch ends at the first point of the next, so that no gap shows.
                shown = branch.stable == stable
                shown[1:] |= shown[:-1].copy()
                axis.plot(
                    branch.parameter,
                    np.where(shown, amplitude, np.nan),
                    color=COLOURS[0] if stable else COLOURS[2],
                    linestyle=style,
                    label="stable" if stable else "unstable",
                )
            unknown = np.array([s is None for s in branch.stable])
            if unknown.any():
                axis.plot(
                    branch.parameter,
                    np.where(unknown, amplitude, np.nan),
                    color="0.45",
                    marker=".",
                    label="stability unknown",
                )
        d, j = branch._place(name, order)
        if branch.folds.size:
            axis.plot(
                branch.folds, np.abs(branch.fold_coefficients[:, d, j]), "o", color="k",
                markersize=4, markerfacecolor="w", label="fold",
            )  # fmt: skip
        _mark_crossings(axis, branch, d, j)
        if isinstance(branch, DrivenBranch) and branch.branch_points:
            axis.plot(
                [point.parameter for point in branch.branch_points],
                [abs(point.coefficients[d, j]) for point in branch.branch_points],
                "s", color="k", markersize=4, markerfacecolor="w", label="branch point",
            )  # fmt: skip
        axis.set_ylabel(rf"amplitude $|{_harmonic(name, order)}|${_in(unit)}")
        if log:
            axis.set_yscale("log")
        _bare(axis)
    axes[-1].set_xlabel(branch.label)
    # Of several branches on the same axes each kind is named once.
    named = dict(zip(*axes[0].get_legend_handles_labels()[::-1], strict=True))
    axes[0].legend(named.values(), named.keys(), frameon=False)
    return axes


def _mark_crossings(axis: Axes, branch: Branch | DrivenBranch, d: int, j: int) -> None:
    """Mark changes of stability other than folds, a sign for each kind."""
    for kind, marker in _CROSSING_MARKERS.items():
        if isinstance(branch, DrivenBranch) and kind == "branch point":
            # Those are marked whether stability changes there or not.
            continue
        here = [c for c in branch.crossings if c.kind == kind and c.coefficients is not None]
        if here:
            axis.plot(
                [c.parameter for c in here if c.parameter is not None],
                [abs(c.coefficients[d, j]) for c in here if c.coefficients is not None],
                marker, color="k", markersize=5, markerfacecolor="w", label=kind,
            )  # fmt: skip


def plot_backbone(
    backbone: Backbone | Sequence[Backbone],
    ax: Axes | Sequence[Axes] | None = None,
    *,
    harmonic: int | Mapping[str, int] = 1,
) -> Sequence[Axes]:
    """Draw amplitude against frequency of free motions, one panel a coordinate.

    Motions known to be unstable are dotted, branch points are marked. ``harmonic`` may be a mapping
    from coordinates. Axes of `plot_response` or `plot_branch` may be given, so that the curves lie
    together.
    """
    curves = _native.several("backbone", backbone, Backbone)
    names = curves[0].dof_names
    axes = panels(ax, len(names))
    labels: list[str] = []
    for curve in curves:
        label = f"backbone, mode {curve.mode}"
        again = sum(other.startswith(label) for other in labels)
        labels.append(f"{label}, family {again + 1}" if again else label)
    for axis, name, unit in zip(axes, names, curves[0].dof_units, strict=True):
        order = order_of(harmonic, name)
        for i, curve in enumerate(curves):
            amplitude = curve.amplitude(name, order)
            shaky = np.zeros(curve.nu.size, dtype=bool)
            if curve.growing is not None:
                shaky = curve.growing > 0
            style: dict[str, Any] = {"color": COLOURS[i % len(COLOURS)], "linewidth": 1.2}
            axis.plot(
                curve.nu,
                np.where(shaky, np.nan, amplitude),
                linestyle=(0, (6, 1.5, 1, 1.5)),
                label=labels[i],
                **style,
            )
            if shaky.any():
                axis.plot(
                    curve.nu,
                    np.where(_with_neighbours(shaky), amplitude, np.nan),
                    linestyle=(0, (1, 1.5)),
                    label="unstable",
                    **style,
                )
            if curve.branch_points:
                d = names.index(name)
                where = int(np.flatnonzero(curve.harmonics == order)[0])
                axis.plot(
                    [point.nu for point in curve.branch_points],
                    [abs(point.coefficients[d, where]) for point in curve.branch_points],
                    "s", color="k", markersize=4, markerfacecolor="w", label="branch point",
                )  # fmt: skip
        axis.set_ylabel(rf"amplitude $|{_harmonic(name, order)}|${_in(unit)}")
        _bare(axis)
    unit = " (rad/s)" if curves[0].energy is None else ""
    axes[-1].set_xlabel(rf"circular frequency $\nu${unit}")
    named = dict(zip(*axes[0].get_legend_handles_labels()[::-1], strict=True))
    axes[0].legend(named.values(), named.keys(), frameon=False)
    return axes


def plot_trajectory(
    trajectory: Trajectory | Sequence[Trajectory],
    ax: Axes | Sequence[Axes] | None = None,
    *,
    labels: Sequence[str] | None = None,
) -> Sequence[Axes]:
    """Draw motions: for each coordinate its history and its phase plane.

    Parameters
    ----------
    trajectory : Trajectory or sequence of them
    ax : sequence of Axes, optional
        Where to draw: two a coordinate, history and phase plane; None makes a figure.
    labels : sequence of str, optional
        A legend entry a motion.

    Returns
    -------
    sequence of Axes: history and phase plane of z, then of phi, then of psi.
    """
    runs = _native.several("trajectory", trajectory, Trajectory)
    labels = _LABELS.of(labels, len(runs))
    names = runs[0].dof_names
    if ax is None:
        import matplotlib.pyplot as plt

        figure = plt.figure(figsize=(10, 2.4 * len(names)), layout="constrained")
        ax = motion_axes(figure, len(names))
    axes = panels(ax, 2 * len(names), "two a coordinate")
    for d, name in enumerate(names):
        history, plane = axes[2 * d], axes[2 * d + 1]
        for i, run in enumerate(runs):
            style = {"color": COLOURS[i % len(COLOURS)], "linestyle": STYLES[i % len(STYLES)]}
            q, v = run.state[:, 2 * d], run.state[:, 2 * d + 1]
            history.plot(run.t, q, linewidth=1.1, label=labels[i] if labels else None, **style)
            plane.plot(q, v, linewidth=0.7, **style)
        symbol = _symbol(name)
        unit = runs[0].dof_units[d]
        history.set_ylabel(f"${symbol}${_in(unit)}")
        plane.set(xlabel=f"${symbol}$", ylabel=rf"${symbol}'$")
        for axis in (history, plane):
            _bare(axis)
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

    With the name of a ``parameter`` that varies, a bifurcation diagram of ``quantity`` over it;
    without, a Poincare section: ``quantity`` against its velocity.
    """
    _native.check_instance("ensemble", ensemble, Ensemble)
    if ensemble.sections is None:
        raise InputError("ensemble: holds no sections, ask for them by sections=1, 2 or 3")
    dofs = ensemble.system.dof_names
    d = dofs.index(_native.choice("quantity", quantity, dofs))
    ax = panel(ax)
    symbol = _symbol(quantity)
    q = ensemble.sections[:, :, 2 * d]
    if parameter is None:
        ax.plot(q.ravel(), ensemble.sections[:, :, 2 * d + 1].ravel(), **_DOTS)
        ax.set(xlabel=f"${symbol}$", ylabel=rf"${symbol}'$")
    else:
        _native.choice("parameter", parameter, tuple(ensemble.parameters))
        values = np.broadcast_to(ensemble.parameters[parameter][:, np.newaxis], q.shape)
        ax.plot(values.ravel(), q.ravel(), **_DOTS)
        ax.set(xlabel=parameter, ylabel=f"${symbol}$ at whole periods (rad)")
    _bare(ax)
    return ax


def plot_spectrum(
    spectrum: Spectrum,
    ax: Axes | None = None,
    *,
    bases: Mapping[str, float] | None = None,
    highest: float | None = None,
) -> Axes:
    """Draw amplitude against circular frequency, a curve a signal.

    Parameters
    ----------
    spectrum : Spectrum
    ax : Axes, optional
    bases : mapping of name to frequency, optional
        The largest peaks are named as combinations of these, within a bin.
    highest : float, optional
        Highest frequency shown.
    """
    _native.check_instance("spectrum", spectrum, Spectrum)
    ax = panel(ax, (8, 4.5))
    columns = spectrum.amplitude.reshape(spectrum.omega.size, -1)
    shown = spectrum.omega > 0
    if highest is not None:
        shown &= spectrum.omega <= _native.number("highest", highest)
    for j, name in enumerate(spectrum.names):
        ax.plot(
            spectrum.omega[shown],
            columns[shown, j],
            color=COLOURS[j % len(COLOURS)],
            linestyle=STYLES[j % len(STYLES)],
            linewidth=0.9,
            label=f"${_symbol(name)}$" if len(name) < 4 else name,
        )
    if bases is not None and columns.size:
        _name_peaks(ax, spectrum.omega[shown], columns[shown].max(axis=1), bases)
    ax.set(xlabel=r"circular frequency $\omega$", ylabel="amplitude")
    if (columns[shown] > 0).any():
        ax.set_yscale("log")
    ax.margins(y=0.12 if bases else 0.05)
    ax.legend(frameon=False)
    _bare(ax)
    return ax


def _name_peaks(
    ax: Axes, omega: FloatArray, amplitude: FloatArray, bases: Mapping[str, float]
) -> None:
    """Write names above the peaks that reach a thousandth of the largest, where there is room."""
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
            (float(omega[k]), float(amplitude[k])),
            xytext=(0, 4),
            textcoords="offset points",
            ha="center",
            va="bottom",
            rotation=90,
            fontsize=7,
        )


def _symbol(name: str) -> str:
    """How a name looks in mathematics: Greek, italic with a number below, or upright."""
    if name in _SYMBOLS or (len(name) == 1 and name != "_"):
        return _SYMBOLS.get(name, name)
    if name[0].isalpha() and name[1:].isdigit():
        return f"{{{name[0]}_{{{name[1:]}}}}}"
    return rf"\mathrm{{{name}}}".replace("_", r"\_")


def _harmonic(name: str, order: int | tuple[int, ...]) -> str:
    """Write the order below a letter, above a name that has an index of its own."""
    plain = name in _SYMBOLS or len(name) == 1
    text = str(order) if isinstance(order, int) else ",".join(map(str, order))
    return f"{_symbol(name)}_{{{text}}}" if plain else f"{_symbol(name)}^{{({text})}}"


def _bare(axis: Axes) -> None:
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(color="0.9", linewidth=0.6)
    axis.set_axisbelow(True)


def motion_axes(figure: Figure, n: int) -> Sequence[Axes]:
    """Return two panels a coordinate, history and phase plane, in rows."""
    axes = figure.subplots(n, 2, width_ratios=[3, 1], squeeze=False)
    for row in axes[:-1]:
        row[0].sharex(axes[-1, 0])
        row[0].tick_params(labelbottom=False)
    return [axis for row in axes for axis in row]
