"""Plots of results: by `Result.plot`, as files, in notebooks."""

import os
from collections.abc import Callable, Mapping, Sequence
from inspect import signature
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from viscovib.analyses.backbones import Backbone
from viscovib.analyses.campbell import Campbell
from viscovib.analyses.driven import DrivenResponse
from viscovib.analyses.driven_branch import DrivenBranch
from viscovib.analyses.shock_spectra import ShockResponseSpectrum
from viscovib.analyses.spectral import Spectrum
from viscovib.bodies.forces import MountForces
from viscovib.common.files import whole_file
from viscovib.common.results import Axes, Figure, Result
from viscovib.errors import InputError, near_name
from viscovib.plots.axes import moving
from viscovib.plots.bodies import plot_mount_forces, plot_mount_forces_in_time
from viscovib.plots.campbell import plot_campbell
from viscovib.plots.motions import (
    motion_axes,
    plot_in_time,
    plot_sections,
    plot_spectrum,
    plot_trajectory,
)
from viscovib.plots.scales import moving as moving_steadily, plot_modulation, plot_scales_response
from viscovib.plots.shocks import plot_shock_spectrum
from viscovib.plots.steady import plot_backbone, plot_branch, plot_motion_branch, plot_response
from viscovib.plots.style import COLOURS, bare, plain
from viscovib.results.branch import Branch
from viscovib.results.ensemble import Ensemble
from viscovib.results.modulation import Modulation
from viscovib.results.motion_branch import MotionBranch
from viscovib.results.motion_forces import (
    ElementForces,
    FloorForce,
    MountForcesInTime,
    PointMotion,
    SupportReactions,
)
from viscovib.results.response import Response, lowest_order
from viscovib.results.scales import ScalesResponse
from viscovib.results.steady_motion import SteadyMotion
from viscovib.results.trajectory import Trajectory
from viscovib.scene.table import TableResult


class Drawn(NamedTuple):
    """Additions to the plot of a result: base frequencies with names, other branches."""

    bases: Mapping[str, float] | None = None
    switched: Sequence[Any] = ()


def _largest_place(curves: Sequence[DrivenBranch | Backbone], d: int) -> int:
    """Index of the largest order of a coordinate, without the mean."""
    first = int(not np.any(curves[0].harmonics[0]))
    sizes = np.max([np.abs(curve.coefficients[:, d, first:]).max(axis=0) for curve in curves], 0)
    return first + int(sizes.argmax())


def _largest_order(branches: Sequence[DrivenBranch], d: int) -> int | tuple[int, ...]:
    order = branches[0].orders[_largest_place(branches, d)]
    return int(order[0]) if order.size == 1 else tuple(order.tolist())


def _rows(figure: Figure, results: Sequence[Any]) -> Any:
    """Return a panel for each coordinate that moves in at least one result."""
    return figure.subplots(_moving(results), 1, sharex=True, squeeze=False)[:, 0]


def _moving(results: Sequence[Any]) -> int:
    """Return the number of coordinates that move."""
    sizes = [np.abs(one.coefficients).max(axis=2, initial=0.0) for one in results]
    return len(moving(results[0].dof_names, np.concatenate(sizes)))


def _draw_response(result: Response, figure: Figure, _: Drawn) -> None:
    axes = _rows(figure, [result])
    plot_response(result, axes, harmonic=lowest_order(result.harmonics))


def _draw_driven(result: DrivenResponse, figure: Figure, _: Drawn) -> None:
    axes = _rows(figure, [result])
    plot_response(result, axes, harmonic=lowest_order(result.harmonics))


def _draw_branch(result: Branch, figure: Figure, _: Drawn) -> None:
    plot_branch(result, _rows(figure, [result]))


def _moving_in_time(result: MotionBranch) -> tuple[str, ...]:
    return moving(result.dof_names, result.largest)


def _draw_motion_branch(result: MotionBranch, figure: Figure, _: Drawn) -> None:
    plot_motion_branch(result, figure.subplots(len(_moving_in_time(result)), 1, sharex=True))


def _draw_driven_branch(result: DrivenBranch, figure: Figure, more: Drawn) -> None:
    branches: list[DrivenBranch] = [result, *more.switched]
    # A coordinate at rest on one branch may move on another.
    several = bool(more.switched)
    axes = (
        figure.subplots(len(result.dof_names), 1, sharex=True)
        if several
        else _rows(figure, branches)
    )
    orders = {name: _largest_order(branches, d) for d, name in enumerate(result.dof_names)}
    for branch in branches:
        plot_branch(branch, axes, harmonic=orders)


def _draw_backbone(result: Backbone, figure: Figure, more: Drawn) -> None:
    names = result.dof_names
    curves: list[Backbone] = [result, *more.switched]
    most = {name: int(result.harmonics[_largest_place(curves, d)]) for d, name in enumerate(names)}
    plot_backbone(curves, _rows(figure, curves), harmonic=most)


def _draw_scales(result: ScalesResponse, figure: Figure, _: Drawn) -> None:
    plot_scales_response(result, figure.subplots(len(moving_steadily(result)), 1, sharex=True))


def _draw_trajectory(result: Trajectory | SteadyMotion, figure: Figure, _: Drawn) -> None:
    plot_trajectory(result, motion_axes(figure, len(result.dof_names)))


def _draw_spectrum(result: Spectrum, figure: Figure, more: Drawn) -> None:
    highest = 5 * max(more.bases.values()) if more.bases else None
    plot_spectrum(result, figure.subplots(), bases=more.bases, highest=highest)


def _draw_shock(result: ShockResponseSpectrum, figure: Figure, _: Drawn) -> None:
    plot_shock_spectrum(result, figure.subplots())


def _draw_campbell(result: Campbell, figure: Figure, _: Drawn) -> None:
    plot_campbell(result, figure.subplots())


def _table_size(result: TableResult) -> tuple[float, float]:
    return 7, 1.6 * (len(result.columns) - 1) + 1


def _draw_table(result: TableResult, figure: Figure, _: Drawn) -> Sequence[Axes]:
    panels = result.panels()
    axes = list(figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0])
    for axis, panel in zip(axes, panels, strict=True):
        # Integers are counted items, so no line connects them.
        counted = panel.x.dtype.kind == "i"
        axis.plot(panel.x, panel.y, "o" if counted else "o-", color=COLOURS[0], markersize=4)
        axis.set(ylabel=plain(panel.name), xlabel=panel.x_label)
        axis.xaxis.get_major_locator().set_params(integer=counted)
        bare(axis)
        axis.label_outer()
    return axes


def _plot_table(result: TableResult) -> Sequence[Axes]:
    """Draw each column over the first in a new figure."""
    import matplotlib.pyplot as plt

    figure = plt.figure(figsize=_table_size(result), layout="constrained")
    return _draw_table(result, figure, Drawn())


def _panel_size(result: Any) -> tuple[float, float]:
    return 7, 3 * _moving([result]) if hasattr(result, "coefficients") else 3.0


#: For each kind of result: function that draws into a figure, figure size, public function.
_DRAWN: dict[type, tuple[Callable[..., Any], Callable[[Any], tuple[float, float]], Any]] = {
    Response: (_draw_response, _panel_size, plot_response),
    DrivenResponse: (_draw_driven, _panel_size, plot_response),
    Branch: (_draw_branch, _panel_size, plot_branch),
    DrivenBranch: (_draw_driven_branch, _panel_size, plot_branch),
    MotionBranch: (
        _draw_motion_branch, lambda r: (7, 3 * len(_moving_in_time(r))), plot_motion_branch,
    ),
    Backbone: (_draw_backbone, _panel_size, plot_backbone),
    Trajectory: (_draw_trajectory, lambda r: (10, 2.4 * len(r.dof_names)), plot_trajectory),
    SteadyMotion: (_draw_trajectory, lambda r: (10, 2.4 * len(r.dof_names)), plot_trajectory),
    Spectrum: (_draw_spectrum, lambda _: (8, 4.5), plot_spectrum),
    ShockResponseSpectrum: (_draw_shock, lambda _: (7, 5), plot_shock_spectrum),
    Campbell: (_draw_campbell, lambda _: (7, 4.5), plot_campbell),
    TableResult: (_draw_table, _table_size, _plot_table),
    ScalesResponse: (
        _draw_scales, lambda r: (7, 3 * len(moving_steadily(r))), plot_scales_response,
    ),
}  # fmt: skip
#: Results that only the public function draws.
_PLOTTED: dict[type, Any] = {
    Ensemble: plot_sections,
    Modulation: plot_modulation,
    MountForces: plot_mount_forces,
    MountForcesInTime: plot_mount_forces_in_time,
    ElementForces: plot_in_time,
    PointMotion: plot_in_time,
    FloorForce: plot_in_time,
    SupportReactions: plot_in_time,
}


def plot(result: Result, *args: Any, **options: Any) -> Any:
    """Draw a result by the function for its kind."""
    own = _PLOTTED.get(type(result))
    function = _drawn(result)[2] if own is None else own
    parameters = list(signature(function).parameters.values())[1:]
    known = [p.name for p in parameters]
    for name in options:
        if name not in known and not any(p.kind is p.VAR_KEYWORD for p in parameters):
            raise InputError(
                f"plot: {name}: is not an option of this picture, {near_name(name, known)}"
            )
    if len(args) > sum(p.kind is not p.KEYWORD_ONLY for p in parameters):
        raise InputError(f"plot: takes options by name: {', '.join(known)}")
    return function(result, *args, **options)


def _drawn(result: Result) -> Any:
    # Results of structures are subclasses of switched.
    for kind in type(result).__mro__:
        if kind in _DRAWN:
            return _DRAWN[kind]
    raise InputError(f"plot: no picture of {result.kind} is known")


def save_picture(
    result: Result,
    path: str | os.PathLike[str] | IO[str],
    *,
    bases: Mapping[str, float] | None = None,
    switched: Sequence[DrivenBranch] | Sequence[Backbone] = (),
    small: bool = False,
    title: str = "",
) -> None:
    """Draw a result into a file, without a display; an open file gets SVG.

    ``bases`` name the peaks of a spectrum; ``switched`` are bifurcating branches;
    ``small``: half the size, for notebooks; ``title`` is above the picture.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    draw, size, _ = _drawn(result)
    figure = Figure(figsize=size(result), layout="constrained")
    FigureCanvasAgg(figure)
    draw(result, figure, Drawn(bases, switched))
    if switched:
        figure.set_size_inches(7, 3 * len(figure.axes))
    if title:
        figure.suptitle(plain(title), fontsize="medium")
    if small:
        figure.set_size_inches(*(0.6 * x for x in size(result)))
    if not isinstance(path, (str, os.PathLike)):
        figure.savefig(path, format="svg")
        return
    with whole_file(path, "wb") as file:
        figure.savefig(file, dpi=200, format=Path(path).suffix.lstrip(".") or "png")
