"""Continued runs, with the same loads or with new loads."""

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.events import Watch
from viscovib.analyses.memoryless import pendulum_runs
from viscovib.analyses.oscillator_motion import (
    NODES,
    WITH_MEMORY,
    OscillatorMotion,
)
from viscovib.analyses.runs import Run, Wanted, nothing
from viscovib.analyses.step_search import with_estimate
from viscovib.analyses.structure_motion import StructureMotion, structure_motion_of
from viscovib.analyses.whole_structure import WholeRun, whole_motion
from viscovib.common.counts import things
from viscovib.common.mesh import Mesh
from viscovib.errors import InputError
from viscovib.kernels.tabulated import TabulatedKernel
from viscovib.results.trajectory import Trajectory
from viscovib.systems.load import LoadLike
from viscovib.systems.load_table import LoadTable

#: Parameters of a pendulum that define its loads.
_LOADS = ("f0", "m01", "m02", "p1", "p2", "p3")
#: Largest jump of the base at the start of a new base motion, relative to its travel.
_OFF = 1e-9
#: A table ends at 0 below this part of its largest value; number of returns of a jump through its
#: end; largest number of corners of a table at which steps end.
_ENDS_AT_0, _RETURNS, _MOST_CORNERS = 1e-9, 8, 16

Maker = Callable[[float], Run]


def known(
    make: Maker,
    breaks: FloatArray | None = None,
    force: LoadTable | None = None,
    base: LoadLike | LoadTable | None = None,
    watch: Watch | None = None,
) -> Maker:
    """Add to runs the corners of their loads, and the tables for their plan."""
    words = []
    tables = () if force is base is None else (("force", force), ("motion of the base", base))
    for name, table in tables:
        if isinstance(table, LoadTable):
            times = np.asarray(table.times)
            span = f"{things(times.size, 'time')}, {times[0]:g} to {times[-1]:g}"
            words.append(f"computes: {name} by a table of {span}")
    return _Known(make, nothing(0) if breaks is None else breaks, tuple(words), watch)


@dataclass(frozen=True, eq=False)
class _Known:
    """Maker of runs that adds the data of loads to each run."""

    make: Maker
    breaks: FloatArray
    tables: tuple[str, ...]
    watch: Watch | None = None

    def __call__(self, h: float) -> Run:
        run = self.make(h)
        run.breaks, run.tables = self.breaks, self.tables
        if self.watch is not None:
            run.watch = self.watch.fresh()
        return run


def breaks_of(force: LoadTable | None, base: LoadLike | LoadTable | None, n_dof: int) -> FloatArray:
    """Return the times of corners, jumps and ends of tables, ascending."""
    breaks: FloatArray = nothing(0)
    # Other types are refused when loads are read.
    if isinstance(force, LoadTable):
        breaks = force._breaks(n_dof)
    if isinstance(base, LoadTable):
        breaks = np.union1d(breaks, base._breaks(np.asarray(base.values)[0].size))
    return breaks


def with_delayed_jumps(
    breaks: FloatArray, system: Any, end: float, initial: object, held: object
) -> FloatArray:
    """Add the times at which a jump at t = 0 returns through a kernel table that ends above 0."""
    kernels = system._active_kernels
    if not kernels or (initial is None and held is None):
        return breaks
    found: set[float] = set()
    for kernel in kernels:
        if not isinstance(kernel, TabulatedKernel) or kernel.interpolation != "linear":
            continue
        times, values = np.asarray(kernel.times), np.asarray(kernel.values)
        if abs(values[-1]) > _ENDS_AT_0 * np.abs(values).max():
            found.update(times[-1] * np.arange(1, _RETURNS + 1))
            if times.size <= _MOST_CORNERS:
                found.update(times)
    inside = [float(t) for t in found if 0 < t < end]
    return np.union1d(breaks, inside) if inside else breaks


def check_resumed(
    run: Trajectory, given: Mapping[str, object], choices: Mapping[str, object]
) -> None:
    """Refuse arguments that a continued run takes from the earlier run."""
    _native.check_instance("resume", run, Trajectory)
    note = [name for name, value in given.items() if value is not None]
    note += [name for name, value in choices.items() if not _native.is_auto(value)]
    if note:
        raise InputError(
            f"{', '.join(note)}: taken from the run that is resumed, must not be given with resume"
        )
    if run.outcome != "completed":
        raise InputError(f"resume: that run ended {run.outcome!r}, must be 'completed'")


def other_loads(
    system: Any,
    earlier: Trajectory,
    end: float,
    load: LoadLike | None,
    nu: float | None,
    base: LoadLike | LoadTable | None,
    force: LoadTable | None,
    coordinates: Sequence[str] | None = None,
) -> Maker | None:
    """Return a maker of runs with new loads; None: no new loads."""
    run: Any = earlier._resume
    given = {"load": load, "nu": nu, "base": base, "force": force}
    loaded = any(value is not None for value in given.values())
    if system._is_condensed or structure_motion_of(run) is not None:
        if coordinates is not None:
            raise InputError(
                "coordinates: taken from the run that is resumed, must not be given with resume"
            )
        if run.system is not system:
            raise InputError("system: must be that of the run that is resumed, the same object")
        return _other_loads_of_structure(run, end, load, nu, base, force, loaded)
    if system._has_own_loads:
        for name, value in given.items():
            if value is not None:
                raise InputError(f"{name}: is for a Mount; a Pendulum has its loads in itself")
        if run.system._has_own_loads:
            loads = {name: getattr(run.system, name) for name in _LOADS}
            if np.array_equal(replace(system, **loads)._flat, run.system._flat):
                if np.array_equal(system._flat, run.system._flat):
                    return None
                make, _ = pendulum_runs(system, end, run.state, run.method, run.solved)
                return known(make)
    parts = [(body._flat, *getattr(body, "_kernels", ())) for body in (system, run.system)]
    if type(system) is not type(run.system) or not all(
        np.array_equal(one, other) for one, other in zip(*parts, strict=True)
    ):
        raise InputError("system: must be that of the run that is resumed, but for its loads")
    if not loaded:
        return None
    breaks = breaks_of(force, base, len(system.dof_names))
    before = run.motion
    if run.by_nodes:
        motion = OscillatorMotion.checked(
            system, before.end, run.state, run.method, load, nu, base, force, None, before.memory
        ).with_equations(WITH_MEMORY)
    else:
        motion = OscillatorMotion.checked(
            system, end, run.state, run.method, load, nu, base, force, None, "auto"
        )
        motion = replace(motion, is_held=before.is_held).with_equations()
        if motion.remembers_all and run.method not in NODES:
            raise InputError(
                f"resume: with method {run.method!r} a moving base is not available, must be one "
                f"of {', '.join(NODES)}"
            )
    _check_base(motion, before, run.time)
    if motion.remembers_all == run.by_nodes:
        motion = motion.after(before)
    return known(motion.runs(run.solved), breaks, force, base)


def _other_loads_of_structure(
    run: Run,
    end: float,
    load: LoadLike | None,
    nu: float | None,
    base: LoadLike | LoadTable | None,
    force: LoadTable | None,
    loaded: bool,
) -> Maker | None:
    """`other_loads` for a structure, with the modes of the run."""
    if not loaded:
        return None
    if isinstance(run, WholeRun):
        given: Any = run.system
        names = None if run.places is None else [given.dof_names[i] for i in run.places]
        before = run.motion
        begun = whole_motion(
            given, before.end if run.by_nodes else end, None, run.method, load, nu, force, names,
            base=base, memory=before.memory, before=before,
        )  # fmt: skip
        assert begun is not None
        _check_base(begun, before, run.time)
        breaks = breaks_of(force, base, len(given.dof_names))
        return known(begun.runs(run.solved), breaks, force, base)
    before = structure_motion_of(run)
    assert before is not None
    system = before.mount
    names = [system.dof_names[i] for i in before.places] if system._is_condensed else None
    motion = StructureMotion.checked(
        system, before.end, None, run.method, load, nu, base, force, None, before.memory, names,
    )  # fmt: skip
    _check_base(motion, before, run.time)
    motion = replace(
        motion, held=before.held, before=before.before, moved=before.moved, start=before.start,
        speed=before.speed,
    )  # fmt: skip
    breaks = breaks_of(force, base, len(system.dof_names))
    return known(motion.runs(run.solved), breaks, force, base)


def _check_base(motion: Any, before: Any, now: float) -> None:
    """Refuse a base whose position jumps."""
    if not (motion.moves_base or before.moves_base):
        return
    places = [np.atleast_1d(one.base_at(now)) for one in (motion, before)]
    here, place = np.broadcast_arrays(*places)
    most = max(one.travel for one in (motion, before))
    if np.abs(here - place).max() > _OFF * most:
        if np.ptp(here) == 0 == np.ptp(place):
            # A base that moves all coordinates together has one position.
            here, place = here[:1], place[:1]
        begins, was = (" ".join(f"{one:.9g}" for one in places) for places in (here, place))
        raise InputError(
            f"base: is at {begins} at t = {now:g}, must go on from {was}, where it was"
        )


def go_on(
    earlier: Trajectory,
    end: float,
    want: Wanted,
    progress: bool,
    other: Maker | None,
    estimated: bool,
) -> Trajectory:
    """Continue a run to ``end``, with new loads if given."""
    run: Run = copy.copy(earlier._resume)
    if run.watch is not None:
        run.watch = run.watch.going_on()
    if other is not None:
        before, run = run, other(run.h)
        run.adopt(before)
    n, kept = _ahead(run, end, want)
    if estimated:
        return with_estimate(run, n, end, kept, progress)
    return run.steps(n, kept, progress)


def _ahead(run: Run, end: float, want: Wanted) -> tuple[int, Wanted]:
    """Return the number of steps to ``end`` and the states kept; set the mesh of the run."""
    now = run.time
    if run.mesh is None and not run.breaks.size:
        n = round((end - now) / run.h)
        if n >= 1 and abs(now + n * run.h - end) <= 1e-9 * max(abs(end), run.h):
            run.goal = run.done + n, end
            if run.kept_of_step > 1 and want.no_choice:
                # With a new goal the present time may differ in its last digit.
                want = want.at(np.linspace(run.time, end, n * run.kept_of_step + 1))
            return n, want
        if not run.has_found_step:
            raise InputError(
                f"t_end = {end:g}: must be a whole number of steps {run.h:g} after {now:g}"
            )
    if not end > now:
        raise InputError(f"t_end = {end:g}: must be greater than {now:g}, where the run ended")
    done = run.done
    if run.mesh is None:
        run.mesh = Mesh(run.h, run.breaks, np.array([now]), np.array([done], dtype=np.int64))
    elif run.anew:
        run.mesh = replace(run.mesh, breaks=run.breaks)
    run.mesh = mesh = run.mesh.extended(end)
    if want.times is None and want.keep != "last":
        parts = run.kept_of_step if want.no_choice else 1
        wanted = np.arange(done * parts, mesh.count * parts + 1, want.every)
        want = want.at(mesh.finer(parts).times(wanted))
    return mesh.count - done, want
