"""Computation of a scene at one point."""

from __future__ import annotations

import copy
import math
import os
import warnings
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np

from viscovib import _native
from viscovib.common.counts import things
from viscovib.common.plan import Plan, given_plan, wanted_places
from viscovib.common.results import Result
from viscovib.errors import ConvergenceWarning, InputError, caller
from viscovib.scene.scene import Scene, texts
from viscovib.scene.table import TableResult, run_tables

if TYPE_CHECKING:
    import xarray as xr

    from viscovib.analyses.backbones import Backbone
    from viscovib.analyses.driven_branch import DrivenBranch
    from viscovib.analyses.shock_spectra import ShockResponseSpectrum
    from viscovib.analyses.spectral import Spectrum
    from viscovib.results.branch import Branch
    from viscovib.results.response import Response
    from viscovib.results.scales import ScalesResponse
    from viscovib.results.trajectory import Trajectory

_R = TypeVar("_R", bound=Result)

#: Groups of a scene that request no computation.
_SUBJECTS = (
    "scene", "parameters", "mount", "system", "pendulum", "kernel", "spring", "force", "structure",
    "element", "layer", "body", "mount_point", "load", "drive_torque", "sweep",
)  # fmt: skip

#: Groups whose tables are additions to that of another group.
_FURTHER = ("spectrum", "event", "free_decay", "shock_spectrum")
#: Keys of &transient that request tables of their own.
_TABLES = ("forces", "peaks")


@dataclass(frozen=True, eq=False, repr=False)
class SceneResult:
    """The result of a scene.

    ``value`` is the result that the Python function of the analysis returns: a `Response`, a
    `Branch`, a `Backbone`, a `Trajectory` with its ``spectrum``, ``shock_spectrum`` and ``events``,
    or a `ScalesResponse`; `switched` are the branches that bifurcate from it. Structures and
    bodies, motions with &free_decay, and analyses without a result class have a `TableResult` (see
    `Scene.structure` and `Scene.body`); a scene with &sweep has a Dataset.

    Examples
    --------
    >>> import viscovib as vv
    >>> result = vv.run("data/scenes/mount_paper.nml")
    >>> result.kind
    'response'
    >>> result.to_csv("table.csv")
    """

    scene: Scene
    value: (
        Response | Branch | DrivenBranch | Backbone | Trajectory | ScalesResponse | TableResult
        | xr.Dataset
    )  # fmt: skip
    spectrum: Spectrum | TableResult | None = None
    events: TableResult | None = None
    switched: tuple[DrivenBranch, ...] | tuple[Backbone, ...] | tuple[TableResult, ...] = ()
    #: The table of &free_decay; the motion itself is then a table too.
    decay: TableResult | None = None
    shock_spectrum: ShockResponseSpectrum | None = None
    #: The tables of ``forces = 'yes'`` and ``peaks = 'yes'`` in &transient, of peaks in &ensemble.
    forces: TableResult | None = None
    reactions: TableResult | None = None
    peaks: TableResult | None = None

    def __repr__(self) -> str:
        parts = (
            self.spectrum, self.events, self.decay, self.shock_spectrum, self.forces,
            self.reactions, self.peaks, *self.switched,
        )  # fmt: skip
        more = [repr(one) for one in parts if one is not None]
        return "\n".join([f"<SceneResult of {self.scene.path.name}>", repr(self.value), *more])

    @property
    def _result(self) -> Result | None:
        """The result of a single run; None for a sweep."""
        return self.value if isinstance(self.value, Result) else None

    def _single(self, otherwise: str) -> Result:
        """The result of a single run, or an error with this message."""
        if self._result is None:
            raise InputError(otherwise)
        return self._result

    def _of(self, form: str) -> Any:
        if self._result is None or self._result._form != form:
            raise InputError(f"{form}: this scene computed another result, see value")
        return self._result

    @property
    def kind(self) -> str:
        """Kind as in the names of tables: "response", "branch", "transient", ..."""
        return "sweep" if self._result is None else self._result.kind

    @property
    def plan(self) -> Plan:
        """What was computed, and what was skipped and why."""
        return plan(self.scene)

    def to_csv(self, path: str | os.PathLike[str], which: int = 0) -> None:
        """Write the table of the driver, with the selected coordinates.

        ``which``: 0 is the result itself; 1, 2, ... are the further branches in ``switched``.
        """
        place = _native.integer("which", which, 0, len(self.switched))
        value = self._single("to_csv: is for single results, a sweep has points")
        self._write(self.switched[place - 1] if place else value, path)

    def spectrum_to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the table of the spectrum."""
        if self.spectrum is None:
            raise InputError("spectrum_to_csv: this scene computed no spectrum")
        self._write(self.spectrum, path)

    def events_to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the table of events: for each event its number, from 1, the time and the state."""
        if self.events is None:
            raise InputError("events_to_csv: this scene has no &event")
        self._write(self.events, path)

    def decay_to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the table of decaying oscillations."""
        if self.decay is None:
            raise InputError("decay_to_csv: this scene has no &free_decay")
        self._write(self.decay, path)

    def shock_spectrum_to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the table of the shock response spectrum."""
        if self.shock_spectrum is None:
            raise InputError("shock_spectrum_to_csv: this scene has no &shock_spectrum")
        self._write(self.shock_spectrum, path)

    def forces_to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the table of forces of mounts, elements or springs."""
        if self.forces is None:
            raise InputError("forces_to_csv: this scene has no forces = 'yes'")
        self._write(self.forces, path)

    def reactions_to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the table of reactions at supports."""
        if self.reactions is None:
            raise InputError(
                "reactions_to_csv: this scene has no forces = 'yes' of a structure with supports"
            )
        self._write(self.reactions, path)

    def peaks_to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the table of peaks."""
        if self.peaks is None:
            raise InputError("peaks_to_csv: this scene has no peaks = 'yes'")
        self._write(self.peaks, path)

    def _write(self, value: Result, path: str | os.PathLike[str]) -> None:
        group = value.kind
        if group in ("event", "reactions", *_TABLES):
            group = "ensemble" if "ensemble" in self.scene.groups else "transient"
        group = group.replace("shock_response", "shock")
        wanted = self.scene.groups[group].get("coordinates")
        title = self.scene.groups.get("scene", {}).get("title", "")
        table = value._table(None if wanted is None else texts(wanted))
        table.write(path, str(self.plan), f", scene {self.scene.path}\n{title}".rstrip())

    @property
    def response(self) -> Response:
        """The response of a mount."""
        found: Response = self._of("response")
        return found

    @property
    def branch(self) -> Branch | DrivenBranch:
        """The branch."""
        found: Branch | DrivenBranch = self._of("branch")
        return found

    @property
    def backbone(self) -> Backbone:
        """The free motions of a mode."""
        found: Backbone = self._of("backbone")
        return found

    @property
    def sweep(self) -> xr.Dataset:
        """A few numbers at every point of a grid (`viscovib.sweeps.scenes.summary`)."""
        if self._result is not None:
            raise InputError("sweep: this scene computed another result, see value")
        found: Any = self.value
        return cast("xr.Dataset", found)

    @property
    def steady(self) -> ScalesResponse:
        """The steady motions by multiple scales."""
        found: ScalesResponse = self._of("steady")
        return found

    @property
    def trajectory(self) -> Trajectory:
        """The motion of a pendulum."""
        found: Trajectory = self._of("trajectory")
        return found


def run_one(scene: Scene, *, progress: bool = False) -> SceneResult:
    """Compute a scene without &sweep."""
    planned = plan(scene)
    by_core = not scene.groups.keys().isdisjoint(("structure", "body", "free_decay"))
    if by_core or _tables_of(scene):
        return _by_core(scene, planned)
    if "multiple_scales" in scene.groups:
        return SceneResult(scene, replace(scene._steady(), plan=planned))
    if "transient" in scene.groups:
        from viscovib.analyses.transient import simulate

        found = simulate(**scene._motion(), progress=progress)
        run = replace(found, _planned=partial(given_plan, planned))
        accelerates = scene.groups["transient"]["acceleration"] == "yes"
        run = _with(run, _accelerates=accelerates)
        return SceneResult(
            scene,
            run,
            _spectrum(scene, run),
            _events(scene, run),
            shock_spectrum=_shock_spectrum(scene, run),
        )
    if "backbone" in scene.groups:
        free, families = scene._backbones()
        note = tuple(replace(family, plan=planned) for family in families)
        return SceneResult(scene, replace(free, plan=planned), switched=note)
    if "branch" in scene.groups and scene.is_pendulum:
        first, bifurcating = scene._driven()
        return SceneResult(scene, first, switched=bifurcating)
    if "branch" in scene.groups:
        from viscovib.analyses.periodic import trace_response

        branch = trace_response(**scene._branch())
        return SceneResult(
            scene, _with(branch, plan=planned, _extra_columns=_extra_columns(scene, "branch"))
        )
    if "response" not in scene.groups:
        return _by_core(scene, planned)
    from viscovib.analyses.forced import forced_response

    response = forced_response(**scene._job(), progress=progress)
    shown = _with(
        response,
        _planned=partial(given_plan, planned),
        _extra_columns=_extra_columns(scene, "response"),
    )
    return SceneResult(scene, shown)


def _with(result: _R, **values: Any) -> _R:
    """A copy with other values; lazily computed attributes (structures) remain lazy."""
    found = copy.copy(result)
    vars(found).update(values)
    return found


def _extra_columns(scene: Scene, name: str) -> tuple[str, ...]:
    """Optional columns that a group requests."""
    return tuple(key for key in ("sampling", "dissipation") if scene.groups[name].get(key) == "yes")


def _tables_of(scene: Scene) -> list[str]:
    """Tables that keys of &transient or &ensemble request."""
    if "ensemble" in scene.groups:
        return ["peaks"] if scene.groups["ensemble"]["peaks"] == "yes" else []
    group = scene.groups.get("transient", {})
    found = [key for key in _TABLES if group.get(key) == "yes"]
    if "forces" in found and texts(scene.groups.get("structure", {}).get("supports", ())):
        found.append("reactions")
    return found


def _by_core(scene: Scene, planned: Plan) -> SceneResult:
    """Compute everything in the core; the result has the tables of the standalone driver."""
    kinds = [name for name, group in scene.groups.items() if name not in _SUBJECTS and group != []]
    kinds.sort(key=_FURTHER.count)
    several = ("basins", "ensemble", "steady_motion")
    many = next((name for name in several if name in scene.groups), None)
    if many and (many != "ensemble" or scene.groups[many]["sections"]):
        kinds = [many, f"{many}_1", *_tables_of(scene)]
        first, *more = run_tables(scene, kinds, planned)
        peaks = next((table for table in more if table.kind == "peaks"), None)
        points = tuple(replace(table, kind=many) for table in more if table is not peaks)
        return SceneResult(scene, first, switched=points, peaks=peaks)
    first, *further_tables = run_tables(scene, kinds + _tables_of(scene), planned)
    further = {table.kind: table for table in further_tables}
    spectra, located, decay, shock = map(further.get, _FURTHER)
    extremes = None
    if shock is not None:
        from viscovib.scene.shocks import spectrum_of_table

        group = scene.groups["shock_spectrum"]
        extremes = spectrum_of_table(shock.notes, shock.columns, group)
    return SceneResult(
        scene, first, spectra, located, decay=decay, shock_spectrum=extremes,
        forces=further.get("forces"), reactions=further.get("reactions"),
        peaks=further.get("peaks"),
    )  # fmt: skip


def _events(scene: Scene, run: Trajectory) -> TableResult | None:
    """Located events of the scene as a table like that of the core; None without events."""
    groups = scene.groups["event"]
    if not groups:
        return None
    notes = []
    for i, (group, found) in enumerate(zip(groups, run.events, strict=True), start=1):
        ends = ", terminal" if group["terminal"] == "yes" else ""
        note = f"{group['function']}, {group['direction']}{ends}"
        notes.append(f"event {i}: {note}, {things(found.t.size, 'occurrence')}")
    which = [np.full(found.t.size, i, dtype=int) for i, found in enumerate(run.events, start=1)]
    state = np.concatenate([found.state for found in run.events])
    columns = {
        "event": np.concatenate(which),
        "t": np.concatenate([found.t for found in run.events]),
    }
    late = [found.error for found in run.events if found.error is not None]
    off = [found.state_error for found in run.events if found.state_error is not None]
    if late:
        columns |= {"t_error": np.concatenate(late), "state_error": np.concatenate(off)}
    table = run._table(texts(scene.groups["transient"]["coordinates"]))
    for name in [one for one in list(table.columns)[1:] if not one.endswith("_ddot")]:
        place = 2 * run.dof_names.index(name.removesuffix("_dot")) + name.endswith("_dot")
        columns[name] = state[:, place]
    note = f"{things(state.shape[0], 'occurrence')} of {things(len(groups), 'event')}"
    notes.append(table.notes[-1])
    return TableResult("event", columns, tuple(notes), run.plan, run.complete, note)


def _shock_spectrum(scene: Scene, run: Trajectory) -> ShockResponseSpectrum | None:
    """The shock response spectrum, if the scene has &shock_spectrum."""
    group = scene.groups.get("shock_spectrum")
    if group is None:
        return None
    from viscovib.scene.shocks import shock_spectrum

    return shock_spectrum(group, scene._hz(), run)


def _spectrum(scene: Scene, run: Trajectory) -> Spectrum | None:
    """Spectra of the coordinates, if the scene has &spectrum."""
    group = scene.groups.get("spectrum")
    if group is None:
        return None
    from viscovib.analyses.signals import warn_of_aliases
    from viscovib.analyses.spectral import spectrum

    kept = run.t >= group["discard"] * (1 - 1e-12)
    if kept.sum() < 2:
        warnings.warn(
            f"no spectrum: {things(kept.sum(), 'state')} from discard = {group['discard']:g} on, "
            "must be at least 2",
            ConvergenceWarning,
            stacklevel=caller(),
        )
        return None
    step = float(run.t[min(1, run.t.size - 1)])
    wanted = wanted_places(texts(group["coordinates"]), run.dof_names)
    found = spectrum(
        run.state[kept][:, [2 * d for d in wanted]],
        step,
        window=group["window"],
        names=tuple(run.dof_names[d] for d in wanted),
    )
    aliased = []
    for d in wanted:
        name, moved, rate = run.dof_names[d], run.state[kept, 2 * d], run.state[kept, 2 * d + 1]
        if warn_of_aliases(name, moved, rate, step):
            aliased.append(name)
    return replace(found, plan=run.plan, aliased=tuple(aliased))


def plan(scene: Scene | str | os.PathLike[str]) -> Plan:
    """Return what a scene computes and what is skipped, with the reasons.

    Examples
    --------
    >>> import viscovib as vv
    >>> skipped = vv.plan("data/scenes/mount_paper.nml")["skips"]
    """
    read = scene if isinstance(scene, Scene) else Scene.read(scene)
    if read.groups["sweep"]:
        return _plan_sweep(read)
    given = {"path": os.fsencode(read.path), "text": read.canonical.encode()}
    return Plan(_native.run("scene plan", **given)["plan"])


def _plan_sweep(scene: Scene) -> Plan:
    grid = scene.sweep_grid()
    axes = [
        f"{name} ({things(v.size, 'value')} from {v[0]:g} to {v[-1]:g})" for name, v in grid.items()
    ]
    points = math.prod(v.size for v in grid.values())
    return Plan(
        f"sweeps: {' x '.join(axes)} = {things(points, 'point')}, each:\n{plan(scene.override({}))}"
    )
