"""Computation of a scene at one point."""

from __future__ import annotations

import copy
import math
import os
import warnings
from dataclasses import dataclass, replace
from functools import cached_property, partial
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

#: Groups whose analyses have a result class.
_WITH_CLASS = ("response", "branch", "backbone", "multiple_scales", "transient")


@dataclass(frozen=True, eq=False, repr=False)
class SceneResult:
    """The result of a scene.

    ``value`` is the result that the Python function of the analysis returns: a `Response`, a
    `Branch`, a `Backbone`, a `Trajectory` with its ``spectrum``, ``shock_spectrum`` and ``events``,
    or a `ScalesResponse`; `switched` are the branches that bifurcate from it. Results of a
    structure have the coordinates that the scene names. Analyses without a result class, reduced
    structures, and branches over a number of a body have a `TableResult`; a scene with &sweep has a
    Dataset.

    The tables of structures and bodies, and those of ``decay``, ``forces``, ``reactions`` and
    ``peaks``, are computed by the compiled core at first use, as by the driver.

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
    shock_spectrum: ShockResponseSpectrum | TableResult | None = None

    def __repr__(self) -> str:
        parts = (self.value, self.spectrum, self.events, self.shock_spectrum, *self.switched)
        more = [repr(one) for one in parts if one is not None]
        return "\n".join([f"<SceneResult of {self.scene.path.name}>", *more])

    @cached_property
    def _tables(self) -> dict[str, TableResult]:
        """The tables of the driver by name, computed in the core."""
        return run_tables(self.scene, self.plan)

    def _further(self, name: str) -> TableResult | None:
        return self._tables.get(name) if name in _further_tables(self.scene) else None

    @property
    def decay(self) -> TableResult | None:
        """The table of &free_decay."""
        return self._further("free_decay")

    @property
    def forces(self) -> TableResult | None:
        """The table of ``forces = 'yes'`` in &transient."""
        return self._further("forces")

    @property
    def reactions(self) -> TableResult | None:
        """The table of ``forces = 'yes'`` at the supports of a structure."""
        return self._further("reactions")

    @property
    def peaks(self) -> TableResult | None:
        """The table of ``peaks = 'yes'`` in &transient or &ensemble."""
        return self._further("peaks")

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
        name = f"{self.kind}_{place}" if place else self.kind
        self._write(self.switched[place - 1] if place else value, path, name)

    def spectrum_to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the table of the spectrum."""
        if self.spectrum is None:
            raise InputError("spectrum_to_csv: this scene computed no spectrum")
        self._write(self.spectrum, path, "spectrum")

    def events_to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the table of events: for each event its number, from 1, the time and the state."""
        if self.events is None:
            raise InputError("events_to_csv: this scene has no &event")
        self._write(self.events, path, "event")

    def decay_to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the table of decaying oscillations."""
        if self.decay is None:
            raise InputError("decay_to_csv: this scene has no &free_decay")
        self._write(self.decay, path, "free_decay")

    def shock_spectrum_to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the table of the shock response spectrum."""
        if self.shock_spectrum is None:
            raise InputError("shock_spectrum_to_csv: this scene has no &shock_spectrum")
        self._write(self.shock_spectrum, path, "shock_spectrum")

    def forces_to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the table of forces of mounts, elements or springs."""
        if self.forces is None:
            raise InputError("forces_to_csv: this scene has no forces = 'yes'")
        self._write(self.forces, path, "forces")

    def reactions_to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the table of reactions at supports."""
        if self.reactions is None:
            raise InputError(
                "reactions_to_csv: this scene has no forces = 'yes' of a structure with supports"
            )
        self._write(self.reactions, path, "reactions")

    def peaks_to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the table of peaks."""
        if self.peaks is None:
            raise InputError("peaks_to_csv: this scene has no peaks = 'yes'")
        self._write(self.peaks, path, "peaks")

    def _write(self, value: Result, path: str | os.PathLike[str], name: str) -> None:
        """Write a table; ``name``: as in the names of files of the driver."""
        if _has_core_tables(self.scene):
            value = self._tables[name]
        # Tables of the core have the coordinates of the scene already.
        groups = {} if value._form == "table" else self.scene.groups
        wanted = groups.get(name.rstrip("_0123456789"), {}).get("coordinates")
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
    kind = next((name for name in _WITH_CLASS if name in scene.groups), None)
    if kind is None or scene._is_reduced or ("body" in scene.groups and _varies_number(scene)):
        return _of_tables(scene, planned)
    if kind == "multiple_scales":
        return SceneResult(scene, replace(scene._steady(), plan=planned))
    if kind == "transient":
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
    if kind == "backbone":
        free, families = scene._backbones()
        note = tuple(replace(family, plan=planned) for family in families)
        return SceneResult(scene, replace(free, plan=planned), switched=note)
    if kind == "branch" and scene.is_pendulum:
        first, bifurcating = scene._driven()
        return SceneResult(scene, first, switched=bifurcating)
    extra = _extra_columns(scene, kind)
    if kind == "branch":
        from viscovib.analyses.periodic import trace_response

        branch = trace_response(**scene._branch())
        return SceneResult(scene, _with(branch, plan=planned, _extra_columns=extra))
    from viscovib.analyses.forced import forced_response

    response = forced_response(**scene._job(), progress=progress)
    given = {"_planned": partial(given_plan, planned), "_extra_columns": extra}
    return SceneResult(scene, _with(response, **given))


def _varies_number(scene: Scene) -> bool:
    """True for a branch over a number of the system; Python does not follow all of a body."""
    varied = scene.groups.get("branch", {}).get("vary", "nu")
    return varied not in ("nu", "load_factor")


def _with(result: _R, **values: Any) -> _R:
    """A copy with other values; lazily computed attributes (structures) remain lazy."""
    found = copy.copy(result)
    vars(found).update(values)
    return found


def _extra_columns(scene: Scene, name: str) -> tuple[str, ...]:
    """Optional columns that a group requests."""
    return tuple(key for key in ("sampling", "dissipation") if scene.groups[name].get(key) == "yes")


def _further_tables(scene: Scene) -> list[str]:
    """Names of the tables that only the core makes, in addition to those of results."""
    found = ["free_decay"] if "free_decay" in scene.groups else []
    group = scene.groups.get("transient", scene.groups.get("ensemble", {}))
    found += [key for key in ("forces", "peaks") if group.get(key) == "yes"]
    if "forces" in found and texts(scene.groups.get("structure", {}).get("supports", ())):
        found.append("reactions")
    return found


def _has_core_tables(scene: Scene) -> bool:
    """True if the core makes all tables: Python rounds the numbers of such systems differently."""
    return not scene.groups.keys().isdisjoint(("structure", "body")) or bool(_further_tables(scene))


def _of_tables(scene: Scene, planned: Plan) -> SceneResult:
    """Compute everything in the core; the result has the tables of the standalone driver."""
    tables = run_tables(scene, planned)
    value, *more = tables.values()
    result = SceneResult(
        scene, value, tables.get("spectrum"), tables.get("event"),
        tuple(one for one in more if one.kind == value.kind), tables.get("shock_spectrum"),
    )  # fmt: skip
    vars(result)["_tables"] = tables
    return result


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
