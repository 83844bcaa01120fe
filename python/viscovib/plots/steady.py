"""Plots of curves, distinguished by line style as well as by colour."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.backbones import Backbone
from viscovib.analyses.driven import DrivenResponse
from viscovib.analyses.driven_branch import DrivenBranch
from viscovib.common.results import Axes
from viscovib.plots.axes import Shown, jumps_of, moving, torn
from viscovib.plots.panels import Labels, chosen_panels, order_of
from viscovib.plots.style import (
    BY_STABILITY,
    COLOURS,
    STYLES,
    bare,
    harmonic_of,
    in_brackets,
    symbol,
)
from viscovib.results.branch import Branch
from viscovib.results.motion_branch import MotionBranch
from viscovib.results.response import Response

#: Markers of changes of stability other than folds.
_CROSSING_MARKERS = {
    "branch point": "s",
    "symmetry breaking": "^",
    "period doubling": "D",
    "Neimark-Sacker": "v",
}
#: Markers for branches of motions in time.
_MOTION_MARKERS = {"fold": "o", **_CROSSING_MARKERS, "grazing": "x"}
_LABELS = Labels("labels")


def plot_response(
    response: Response | DrivenResponse | Sequence[Response | DrivenResponse],
    ax: Axes | Sequence[Axes] | None = None,
    *,
    labels: Sequence[str] | None = None,
    harmonic: int | tuple[int, ...] = 1,
    x: str = "rad/s",
    y: str = "log",
    reference: float = 1.0,
) -> Sequence[Axes]:
    """Draw amplitude against frequency, one panel per coordinate.

    Parameters
    ----------
    response : Response or DrivenResponse, or sequence of them
        Curves; gaps show missing solutions and jumps to a second branch. Unstable motions are
        dashed if stability is known.
    ax : Axes or sequence of Axes, optional
        One per coordinate. None creates a figure with a panel for each coordinate that moves.
    labels : sequence of str, optional
        A legend entry per curve.
    harmonic : int, or tuple for several base frequencies
        Harmonic to draw.
    x : {"rad/s", "hz"}
        Unit of frequencies that are in rad/s.
    y : {"log", "linear", "db", "phase"}
        Logarithmic or linear amplitudes, decibels, or phases in degrees.
    reference : float
        Amplitude of 0 dB; with that of a moving base the plot shows its transmissibility.

    Returns
    -------
    sequence of Axes, one per coordinate.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> mount = vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2,
    ...                  damping=[[0.2, 0], [0, 0.05]])
    >>> response = vv.forced_response(mount, np.linspace(0.5, 12, 200), base=1e-3)
    >>> axes = vv.plot_response(response, x="hz", y="db", reference=1e-3)

    See Also
    --------
    forced_response, plot_branch
    """
    curves = _native.several("response", response, Response, DrivenResponse)
    shown = Shown.checked(x, y, reference)
    labels = _LABELS.of(labels, len(curves))
    names = curves[0].dof_names
    units = dict(zip(names, curves[0].dof_units, strict=True))
    found = moving(names, np.concatenate([_sizes(curve) for curve in curves]))
    names, axes = chosen_panels(ax, names, found)
    _, label, circular = curves[0]._along
    for axis, name in zip(axes, names, strict=True):
        for i, curve in enumerate(curves):
            values = shown.sizes(curve.coefficient(name, harmonic))
            at = shown.places(np.asarray(curve._along[0]), circular)
            stable = curve.stable
            style: dict[str, Any] = {
                "color": COLOURS[i % len(COLOURS)], "linewidth": 1.6,
                "linestyle": STYLES[i % len(STYLES)],
            }  # fmt: skip
            named = labels[i] if labels else None
            if stable is None:
                axis.plot(*_whole(curve, shown, at, values), label=named, **style)
                continue
            unstable = np.asarray(stable == False)  # noqa: E712
            for part, dashes, own in (
                (np.where(unstable, np.nan, values), "-", named),
                (np.where(_with_neighbours(unstable), values, np.nan), (0, (3, 1.5)), None),
            ):
                style["linestyle"] = dashes
                axis.plot(*_whole(curve, shown, at, part), label=own, **style)
        axis.set_ylabel(shown.y_label(harmonic_of(name, harmonic), units[name]))
        shown.finish(axis)
        bare(axis)
    axes[-1].set_xlabel(shown.x_label(label, circular))
    if labels:
        axes[0].legend(frameon=False)
    return axes


def _sizes(curve: Any) -> FloatArray:
    """Return the largest harmonic of each coordinate at each point, shape (n, n_dof)."""
    return np.asarray(np.abs(curve.coefficients).max(axis=2, initial=0.0))


def _drawn_sizes(branch: Branch | DrivenBranch, harmonic: Any) -> FloatArray:
    """Return the sizes of the drawn harmonic, shape (n, n_dof).

    A coordinate may move only in other harmonics, such as a spring under a swinging body.
    """
    places = (branch._place(name, order_of(harmonic, name)) for name in branch.dof_names)
    return np.abs(np.stack([branch.coefficients[:, d, j] for d, j in places], axis=1))


def _whole(
    curve: Response | DrivenResponse, shown: Shown, at: FloatArray, values: FloatArray
) -> list[FloatArray]:
    """Return a curve with gaps at its jumps."""
    jumps = jumps_of(curve.coefficients)
    if shown.y == "phase":
        with np.errstate(invalid="ignore"):
            jumps = jumps | (np.abs(np.diff(values)) > 180)
    return torn(jumps, at, values)


def _with_neighbours(shown: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Points and their neighbours, so that there is no gap between stretches."""
    wider = shown.copy()
    wider[1:] |= shown[:-1]
    wider[:-1] |= shown[1:]
    return wider


def plot_branch(
    branch: Branch | DrivenBranch,
    ax: Axes | Sequence[Axes] | None = None,
    *,
    harmonic: int | tuple[int, ...] | Mapping[str, int | tuple[int, ...]] = 1,
    x: str = "rad/s",
    y: str = "linear",
    reference: float = 1.0,
) -> Sequence[Axes]:
    """Draw amplitude along a branch, one panel per coordinate.

    Stable parts are solid, unstable ones lighter, thinner and dashed, unknown stability grey and
    dotted. Folds, branch points and other bifurcation points are marked. ``harmonic`` may be a
    mapping from coordinates; ``x``, ``y`` and ``reference`` are those of `plot_response`. Without
    ``ax``, coordinates that do not move have no panel.

    Examples
    --------
    >>> import viscovib as vv
    >>> duffing = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="0.5*x^3")
    >>> branch = vv.trace_response(duffing, (0.3, 2.5), load=0.2)
    >>> axes = vv.plot_branch(branch, x="hz", y="db")

    See Also
    --------
    trace_response, plot_backbone, plot_motion_branch
    """
    _native.check_instance("branch", branch, Branch, DrivenBranch)
    shown = Shown.checked(x, y, reference)
    units = dict(zip(branch.dof_names, branch.dof_units, strict=True))
    sizes = _sizes(branch) if ax is not None else _drawn_sizes(branch, harmonic)
    names, axes = chosen_panels(ax, branch.dof_names, moving(branch.dof_names, sizes))
    circular = branch._circular
    for axis, name in zip(axes, names, strict=True):
        order = order_of(harmonic, name)
        d, j = branch._place(name, order)
        values = shown.sizes(branch.coefficients[:, d, j])
        at = shown.places(branch.parameter, circular)
        wraps = np.zeros(at.size - 1, dtype=bool)
        if shown.y == "phase":
            wraps = np.abs(np.diff(values)) > 180
        for stable, label, style in BY_STABILITY:
            part = _stretch(branch, stable)
            if part.any():
                axis.plot(*torn(wraps, at, np.where(part, values, np.nan)), label=label, **style)
        if branch.folds.size:
            axis.plot(
                shown.places(branch.folds, circular),
                shown.sizes(branch.fold_coefficients[:, d, j]),
                "o", color="k", markersize=4, markerfacecolor="w", label="fold",
            )  # fmt: skip
        _mark_crossings(axis, branch, d, j, shown, circular)
        if branch._crossed:
            axis.plot(
                [point.parameter for point in branch._crossed],
                shown.sizes(np.array([p.coefficients[d, j] for p in branch._crossed])),
                "s", color="k", markersize=4, markerfacecolor="w", label="branch point",
            )  # fmt: skip
        axis.set_ylabel(shown.y_label(harmonic_of(name, order), units[name]))
        shown.finish(axis)
        bare(axis)
    axes[-1].set_xlabel(shown.x_label(branch.label, circular))
    _name_once(axes[0])
    return axes


def plot_motion_branch(
    branch: MotionBranch, ax: Axes | Sequence[Axes] | None = None, *, x: str = "rad/s"
) -> Sequence[Axes]:
    """Draw the largest displacement along a branch of motions in time, one panel per coordinate.

    Line styles are those of `plot_branch`. Folds, branch points, period doublings, Neimark-Sacker
    points and grazing are marked. Without ``ax``, coordinates that do not move have no panel.

    Parameters
    ----------
    branch : MotionBranch
    ax : Axes or sequence of them, optional
        One per coordinate; None creates a figure.
    x : {"rad/s", "hz"}
        Unit of the frequency, if it varies.

    Returns
    -------
    sequence of Axes

    Examples
    --------
    >>> import viscovib as vv
    >>> stop = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.2, forces="20*max(x - 0.5, 0)")
    >>> axes = vv.plot_motion_branch(vv.trace_motion(stop, (0.5, 1.5), load=0.3))

    See Also
    --------
    trace_motion, plot_branch
    """
    _native.check_instance("branch", branch, MotionBranch)
    shown = Shown.checked(x, "linear")
    names, units = branch.dof_names, branch.system.dof_units
    chosen, axes = chosen_panels(ax, names, moving(names, branch.largest))
    circular = branch.varies == "nu"
    for axis, name in zip(axes, chosen, strict=True):
        d = names.index(name)
        at = shown.places(branch.parameter, circular)
        for stable, label, style in BY_STABILITY:
            part = _stretch(branch, stable)
            if part.any():
                axis.plot(at, np.where(part, branch.largest[:, d], np.nan), label=label, **style)
        for kind, marker in _MOTION_MARKERS.items():
            here = [(p, largest[d]) for one, p, largest in branch._marks if one == kind]
            if here:
                places, values = np.array(here).T
                axis.plot(
                    shown.places(places, circular), values, marker, color="k", markersize=5,
                    markerfacecolor="w", linestyle="none", label=kind,
                )  # fmt: skip
        axis.set_ylabel(f"largest ${symbol(name)}${in_brackets(units[d])}")
        bare(axis)
    axes[-1].set_xlabel(shown.x_label(branch.label, circular))
    _name_once(axes[0])
    return axes


def _stretch(
    branch: Branch | DrivenBranch | MotionBranch, stable: bool | None
) -> npt.NDArray[np.bool_]:
    """Points of a branch with one stability; a stretch ends at the first point of the next."""
    if branch.stable is None:
        return np.full(branch.parameter.size, stable is None)
    if stable is None:
        return np.array([one is None for one in branch.stable])
    shown = np.asarray(branch.stable == stable)
    if shown.any():
        shown[1:] |= shown[:-1].copy()
    return shown


def _name_once(axis: Axes) -> None:
    """Write a legend that names each kind of curve once."""
    named = dict(zip(*axis.get_legend_handles_labels()[::-1], strict=True))
    if named:
        axis.legend(named.values(), named.keys(), frameon=False)


def _mark_crossings(
    axis: Axes, branch: Branch | DrivenBranch, d: int, j: int, shown: Shown, circular: bool
) -> None:
    """Mark changes of stability other than folds; each kind has its own marker."""
    for kind, marker in _CROSSING_MARKERS.items():
        if branch._crossed is not None and kind == "branch point":
            # Branch points are marked elsewhere, even if stability does not change there.
            continue
        here = [
            (c.parameter, c.coefficients[d, j])
            for c in branch.crossings
            if c.kind == kind and c.coefficients is not None and c.parameter is not None
        ]
        if here:
            at, values = map(np.array, zip(*here, strict=True))
            axis.plot(
                shown.places(at, circular), shown.sizes(values),
                marker, color="k", markersize=5, markerfacecolor="w", label=kind,
            )  # fmt: skip


def plot_backbone(
    backbone: Backbone | Sequence[Backbone],
    ax: Axes | Sequence[Axes] | None = None,
    *,
    harmonic: int | Mapping[str, int] = 1,
    x: str = "rad/s",
    y: str = "linear",
    reference: float = 1.0,
) -> Sequence[Axes]:
    """Draw amplitude against frequency of free motions, one panel per coordinate.

    Unstable motions are dotted, branch points are marked. ``harmonic`` may be a mapping from
    coordinates; ``x``, ``y`` and ``reference`` are those of `plot_response`. Pass axes of
    `plot_response` or `plot_branch` to draw the curves together.

    Examples
    --------
    >>> import viscovib as vv
    >>> duffing = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="0.5*x^3")
    >>> axes = vv.plot_branch(vv.trace_response(duffing, (0.3, 2.5), load=0.15), x="hz")
    >>> axes = vv.plot_backbone(vv.backbone(duffing, 0, (0.01, 2)), ax=axes, x="hz")

    See Also
    --------
    backbone, plot_branch
    """
    curves = _native.several("backbone", backbone, Backbone)
    shown = Shown.checked(x, y, reference)
    names = curves[0].dof_names
    units = dict(zip(names, curves[0].dof_units, strict=True))
    found = moving(names, np.concatenate([_sizes(curve) for curve in curves]))
    names, axes = chosen_panels(ax, names, found)
    circular = curves[0].energy is None
    labels: list[str] = []
    for curve in curves:
        label = f"backbone, mode {curve.mode}"
        again = sum(other.startswith(label) for other in labels)
        labels.append(f"{label}, family {again + 1}" if again else label)
    for axis, name in zip(axes, names, strict=True):
        order = order_of(harmonic, name)
        for i, curve in enumerate(curves):
            amplitude = shown.sizes(curve.coefficient(name, order))
            at = shown.places(curve.nu, circular)
            shaky = np.zeros(curve.nu.size, dtype=bool)
            if curve.growing is not None:
                shaky = curve.growing > 0
            style: dict[str, Any] = {"color": COLOURS[i % len(COLOURS)], "linewidth": 1.2}
            axis.plot(
                at, np.where(shaky, np.nan, amplitude),
                linestyle=(0, (6, 1.5, 1, 1.5)), label=labels[i], **style,
            )  # fmt: skip
            if shaky.any():
                axis.plot(
                    at, np.where(_with_neighbours(shaky), amplitude, np.nan),
                    linestyle=(0, (1, 1.5)), label="unstable", **style,
                )  # fmt: skip
            if curve.branch_points:
                d = curve.dof_names.index(name)
                where = int(np.flatnonzero(curve.harmonics == order)[0])
                axis.plot(
                    shown.places(np.array([p.nu for p in curve.branch_points]), circular),
                    shown.sizes(np.array([p.coefficients[d, where] for p in curve.branch_points])),
                    "s", color="k", markersize=4, markerfacecolor="w", label="branch point",
                )  # fmt: skip
        axis.set_ylabel(shown.y_label(harmonic_of(name, order), units[name]))
        shown.finish(axis)
        bare(axis)
    unit = " (rad/s)" if circular else ""
    axes[-1].set_xlabel(shown.x_label(rf"circular frequency $\nu${unit}", circular))
    _name_once(axes[0])
    return axes
