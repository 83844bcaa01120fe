"""Runs with equal steps: states kept, continuation, and data of the step size search."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.acting import (
    EarlierMotion,
    KnownMotion,
    Loads,
    Panels,
    accelerations,
    panel_ends,
)
from viscovib.analyses.events import Watch
from viscovib.analyses.forces_in_time import element_forces, mount_forces, support_reactions
from viscovib.bodies.body import Body
from viscovib.bodies.turning import renamed_like
from viscovib.common.counts import things
from viscovib.common.mesh import Mesh
from viscovib.common.past import check_start
from viscovib.common.plan import Plan
from viscovib.common.progress import SILENT, Bar, progress_bar
from viscovib.errors import InputError
from viscovib.results.motion_forces import ElementForces, MountForcesInTime, SupportReactions
from viscovib.results.trajectory import OUTCOMES, Trajectory
from viscovib.systems.oscillators import Oscillator
from viscovib.systems.pendulum import Pendulum

MAX_STEPS = 10**12
#: Largest array size of the states of a run: 1 GiB.
MAX_KEPT = 2**27
#: Largest number of steps of the first run of a step size search.
MAX_FIRST_STEPS = 10**9
ROUNDING = 1e-15
#: Relative error of the time of a stop inside a step.
LOCATED = 1e-12
#: Smallest and largest number of halvings, and largest number while two runs end differently.
_MIN_HALVINGS, _MAX_HALVINGS, _MAX_UNLIKE = 5, 12, 9
#: Growth factor of a motion that has diverged.
_AWAY = 10.0
#: Largest number of coordinates in a message; steps per native call with events.
_LISTED, _WATCHED = 4, 10_000


class NotMetError(InputError):
    """No step size meets the tolerance."""


@dataclass(frozen=True, eq=False)
class Wanted:
    """Selection of the states of a run that are kept."""

    every: int = 1
    keep: str = "all"
    tail: float = 0.0
    times: FloatArray | None = None
    #: The original request, if ``times`` replaces it.
    asked: Wanted | None = None

    @classmethod
    def checked(
        cls, times: npt.ArrayLike | None, save_every: int, keep: str, tail: float | None
    ) -> Wanted:
        """Check the arguments of ``simulate``."""
        every = _native.integer("save_every", save_every, 1, MAX_STEPS)
        _native.choice("keep", keep, ("all", "tail", "last"))
        if (keep == "tail") != (tail is not None):
            raise InputError('tail: must be given with keep = "tail", and not without it')
        length = 0.0 if tail is None else _native.number("tail", tail)
        if tail is not None and length <= 0:
            raise InputError(f"tail = {length:g}: must be greater than 0")
        if times is None:
            return cls(every, keep, length)
        if keep != "all" or every != 1:
            raise InputError("times: cannot be given together with save_every or keep")
        wanted = _native.real_array("times", times, ndim=1)
        if not wanted.size:
            raise InputError("times: must not be empty")
        if np.any(np.diff(wanted) <= 0):
            raise InputError("times: must be strictly ascending")
        return cls(times=wanted)

    @property
    def no_choice(self) -> bool:
        """True without a selection, so that all states are kept."""
        return self.times is None and self.every == 1 and self.keep == "all"

    def finer(self, factor: int) -> Wanted:
        """Return the selection of the same states for a run with more steps by a factor."""
        if factor == 1:
            return self
        return replace(self, every=self.every * factor)

    def at(self, times: FloatArray) -> Wanted:
        """Return the selection as states at these times, for unequal steps."""
        if self.keep == "tail":
            times = times[times >= times[-1] - self.tail * (1 + 1e-12)]
        return Wanted(times=times, asked=self.asked or self)


def hopeless(changes: list[float]) -> bool:
    """True if one more halving of the step size is useless: two halvings gain less than a digit.

    This happens for chaotic motions and below the rounding error. A large first step may need some
    halvings before the method converges with its order, or before two runs end in the same way. An
    infinite change is not used for the comparison.
    """
    n = len(changes)
    if n < _MIN_HALVINGS:
        return False
    if not math.isfinite(changes[-1]):
        return n >= _MAX_UNLIKE
    return n >= _MAX_HALVINGS or 0.1 * changes[-3] < changes[-1]


def has_outrun(start: FloatArray, end: FloatArray, one: float, other: float, h: float) -> bool:
    """True if a motion that two runs could not follow has diverged from its start.

    ``one``, ``other``: end times of the runs, which may differ by one step h.
    """
    return bool(
        min(one, other) > h
        and abs(one - other) <= h
        and np.abs(end).max() > _AWAY * np.abs(start).max()
    )


def difference(coarse: Trajectory, fine: Trajectory) -> float:
    """Largest difference of the states of two runs, and of the times at which they stop."""
    n, m = coarse.t.size, fine.t.size
    coarse = renamed_alike(coarse, fine)
    if coarse.outcome == "completed" == fine.outcome and n == m:
        return float(np.abs(fine.state - coarse.state).max())
    if coarse.outcome != fine.outcome or coarse.outcome == "step too large" or abs(n - m) > 1:
        return math.inf
    n = min(n, m)
    if fine.outcome == "diverged" and n and fine.t[n - 1] >= fine.t_reached:
        n -= 1  # at the bound of a coordinate the state changes too fast for a comparison
    moved = abs(fine.t_reached - coarse.t_reached)
    return max(moved, float(np.abs(fine.state[:n] - coarse.state[:n]).max(initial=0.0)))


def renamed_alike(run: Trajectory, like: Trajectory) -> Trajectory:
    """The run, for a body with large rotations with comparable rotation vectors."""
    turns = isinstance(run.system, Body) and run.system._winds
    if not turns or run.state.shape != like.state.shape:
        return run
    return replace(run, state=renamed_like(run.state, like.state))


def starting_state(initial: Any, n: int, dof_names: Sequence[str]) -> FloatArray:
    """Return the initial coordinates and velocities of n coordinates."""
    if type(initial) is not dict:
        state = _native.real_array("initial", initial)
        if state.shape == (2 * n,):
            check_start(state)
            return state
    names = [f"{name}{dot}" for name in dof_names[:_LISTED] for dot in ("", "_dot")]
    listed = f"values of {', '.join(names)}{', ...' if n > _LISTED else ''}"
    if type(initial) is dict:
        raise InputError(f"initial = {_native.shown(initial)}: must be {2 * n} numbers, {listed}")
    raise InputError(f"initial: must have shape {(2 * n,)}, got {state.shape}: {listed}")


@cache
def nothing(n: int, kind: type[Any] = float) -> npt.NDArray[Any]:
    """Return n zeros that are read-only."""
    zeros = np.zeros(n, dtype=kind)
    zeros.setflags(write=False)
    return zeros


@dataclass
class ThinLayers:
    """Data on thin layers of force laws that steps may miss, shared by all runs of a call."""

    #: True if a layer may have been missed. All further steps are then computed in parts.
    seen: bool = False
    #: The longest step of these runs. Parts of shorter steps are shorter by the same factor;
    #: equal parts would have the same error, which a comparison does not show.
    longest: float = 0.0


class Run(ABC):
    """A run that can be continued, with its native state and time."""

    #: Relative error of the approximation of kernels, which two runs may share.
    represented: float = 0.0
    #: Error of states by rounding errors of frequencies, which all runs share.
    by_phases: float = 0.0
    #: Quantity that native calls count.
    counts: ClassVar[str]
    #: Thin layers of laws that steps may miss; shared by the runs of a step size search.
    layers: ThinLayers = ThinLayers()
    #: True if a run without memory data may be continued with new loads from its state.
    remembers_past: ClassVar[bool] = False
    #: Step size divided by the step size whose nodes resolve every layer.
    too_long: float = 0.0
    #: Largest number of steps per native call, which sets the interval of progress and Ctrl-C.
    piece: int = 200_000
    #: Number of equal steps to a given time, and this time (the product with h is rounded).
    goal: tuple[int, float] = (-1, 0.0)
    #: True if the step was found by a tolerance.
    has_found_step: bool = False
    #: As of `Trajectory`, for motions with memory.
    resolution: float | None = None

    def __init__(
        self,
        system: Pendulum | Oscillator,
        method: str,
        state: FloatArray,
        h: float,
        solved: float,
    ) -> None:
        self.system, self.method, self.state, self.h = system, method, state, h
        self.solved = solved
        self.begin = state
        self.done = 0
        self.reached = 0.0
        self.memory: FloatArray | None = None
        #: Ends of steps, if they are not equal.
        self.mesh: Mesh | None = None
        #: Texts of the plan about tables of loads.
        self.tables: tuple[str, ...] = ()
        #: Function that created the run, and corners of its loads.
        self.maker: Callable[[float], Run] | None = None
        self.breaks: FloatArray = nothing(0)
        #: True if new loads act from now on; functions that created the earlier parts, with the
        #: number of steps at the end of each.
        self.anew = False
        self.parts: tuple[tuple[Callable[[float], Run], int], ...] = ()
        #: Events, and start time of the last steps.
        self.watch: Watch | None = None
        self.began = 0.0
        #: Number of states kept per step, from its polynomial.
        self.kept_of_step = 1
        #: Accelerations at wanted times, piece by piece, if these are wanted.
        self.accelerated: list[FloatArray] | None = None
        #: The motion on panels until a time, as what springs remember needs it.
        self.on_panels: tuple[float, Panels] | None = None

    def __copy__(self) -> Run:
        """Return a run with the same data."""
        made: Run = object.__new__(type(self))
        made.__dict__.update(self.__dict__)
        return made

    def on(self, mesh: Mesh) -> Run:
        """Return the run with the steps of a mesh."""
        self.mesh, self.h = mesh, mesh.h
        return self

    def sharpen(self, factor: int) -> None:
        """Reduce the tolerance of equations and kernels for steps that are shorter by the factor.

        Runs with the same tolerance share this error, so their difference would not show it. The
        square of the factor is less than any method gains.
        """
        self.solved = max(self.solved / float(factor) ** 2, ROUNDING)

    def adopt(self, earlier: Run) -> None:
        """Continue from the end of an earlier run, with the loads of this run."""
        assert earlier.maker is not None
        self.state, self.done, self.reached = earlier.state, earlier.done, earlier.reached
        self.h, self.mesh = earlier.h, earlier.mesh
        self.anew = True
        self.watch = None if earlier.watch is None else earlier.watch.going_on()
        self.parts = (*earlier.parts, (earlier.maker, earlier.done))

    def prepare(self, like: Run, factor: int) -> None:
        """Keep the memory that a continued run needs, with steps shorter by the factor."""
        self.piece = like.piece

    def serves(self) -> bool:
        """True if the stored memory is valid for the next steps."""
        return True

    def _mesh_arrays(self) -> tuple[FloatArray, npt.NDArray[np.int64]]:
        """Return the ends of mesh parts and the numbers of their steps; 0 for equal steps."""
        if self.mesh is None:
            return nothing(1), nothing(1, np.int64)
        return self.mesh.ends, self.mesh.made_by

    @abstractmethod
    def _given(self) -> tuple[str, tuple[_native.Handle, ...], dict[str, Any]]:
        """Return the task, its objects, and the values for this kind of run."""

    def _takes_long(self, count: int) -> bool:
        """True if this number of steps may take long."""
        return count > _native.MANY_STEPS

    def _values(
        self, count: int, every: int, times: FloatArray
    ) -> tuple[str, tuple[_native.Handle, ...], dict[str, Any]]:
        """`_given` with the common values, for ``count`` steps from the present state."""
        task, objects, values = self._given()
        watch = self.watch
        if watch is not None:
            values |= {"watched": watch.vector, "sides": watch.sides, "most": watch.room}
        resume = 0 if self.memory is None else 2 if self.anew else 1
        if self.memory is not None:
            values["memory"] = self.memory
        elif self.anew and self.remembers_past:
            resume = 2
        values |= {
            "first": self.done, "n_steps": count, "save_every": every, "resume": resume,
            "h": self.h, "tolerance": self.solved, "times": times, "initial": self.state,
        }  # fmt: skip
        return task, objects, values

    def _found(self, count: int, every: int, columns: int, times: FloatArray) -> dict[str, Any]:
        """Compute ``count`` steps from the present state in the core, and return the results.

        For example the final state ``last`` and its time ``reached``, the number ``made`` of full
        steps and the outcome ``ended``.
        """
        task, objects, values = self._values(count, every, times)
        long = self._takes_long(count)
        found = _native.run_either(long, task, *objects, columns=columns, **values)
        if self.watch is not None:
            self.watch.sides[:] = found["sides"]
        return found

    @abstractmethod
    def _plan(self, end: float, dt: float, tolerance: float, every: int, last: bool) -> str:
        """Return the plan of the core for a run to ``end`` with step size dt (0: searched)."""

    def plan(self, want: Wanted, end: float, sought: float | None = None) -> Plan:
        """Return the plan of a run to ``end``; ``sought``: tolerance of the step size search."""
        dt = self.h if sought is None else 0.0
        want = want.asked or want
        every, last = min(want.every, np.iinfo(np.int32).max), want.keep == "last"
        plan = Plan(self._plan(end, dt, sought or self.solved, every, last))
        if self.tables:
            lines = [s for s in str(plan).splitlines() if s != "skips: the load (there is none)"]
            plan = Plan("\n".join([*lines, *self.tables]))
        if want.times is not None:
            kept = things(want.times.size, "time")
            return plan.and_also(
                [f"skips: storing other states than those at {kept} (not requested)"]
            )
        if want.keep == "tail":
            return plan.and_also(
                [f"skips: storing states before the last {want.tail:g} (not requested)"]
            )
        return plan

    @property
    def has_layers(self) -> bool:
        """True if laws may have thin layers."""
        return False

    @property
    def over_kinks(self) -> bool:
        """True if steps cross kinks of laws, so that errors are not a power of the step size."""
        return False

    @property
    def switched(self) -> FloatArray:
        """States of elements and signs of switching surfaces; empty without switches."""
        return np.empty(0)

    def belongs_to_state(self) -> npt.NDArray[np.bool_]:
        """Mask of the memory that belongs to the state (not to time or to the method)."""
        assert self.memory is not None
        return np.ones(self.memory.size, dtype=bool)

    def state_columns(self) -> slice:
        """Slice of the memory that follows from the modes; also the end of the state."""
        return slice(0, 0)

    def compute_all(self) -> None:  # noqa: B027
        """Compute all coordinates, also those at rest, before the first step."""

    @property
    def time(self) -> float:
        """Present time of the run."""
        return self._time_after(self.done)

    def _time_after(self, steps: int) -> float:
        if self.mesh is not None:
            return self.mesh.time(steps)
        return self.goal[1] if steps == self.goal[0] else steps * self.h

    def steps(self, n: int, want: Wanted, progress: bool) -> Trajectory:
        """Compute n steps."""
        if want.times is not None:
            self._check_times(want.times, n)
        start, first = self.done, self.state
        self.began = self.time
        # Skip states that are not kept in larger parts.
        skipped = 0
        if want.keep == "tail":
            skipped = max(0, n - math.ceil(min(want.tail / self.h, n))) // want.every * want.every
        if want.times is None and want.keep != "last":
            self._check_capacity((n - skipped) // want.every)
        counts = {self.counts: 0}
        states: list[FloatArray] = []
        ended = 0
        # Short runs do not check for a progress bar.
        long = progress or n > _native.MANY_STEPS
        with progress_bar(n, "steps", progress) if long else SILENT as bar:
            if skipped:
                ended = self._advance(skipped, replace(want, keep="last"), states, counts, bar)
                start, first = self.done, self.state
                if ended:
                    # The requested states lie beyond the end: keep the final state.
                    want = replace(want, keep="last")
            if not ended:
                ended = self._advance(n - skipped, want, states, counts, bar)
        if want.times is not None:
            kept = np.concatenate(states)
            t = want.times[: kept.shape[0]]
        elif want.keep == "last":
            kept, t = self.state[np.newaxis], np.array([self.reached])
        else:
            kept = np.concatenate([first[np.newaxis], *states])
            made = start + want.every * np.arange(kept.shape[0])
            t = np.multiply(made, self.h, dtype=float)
            if self.mesh is None and made[-1] == self.goal[0]:
                t[-1] = self.goal[1]
        run = Trajectory(
            t=t,
            state=kept,
            outcome=OUTCOMES[ended],
            t_reached=self.reached,
            step=self.h,
            method=self.method,
            error=None,
            stats={"steps": self.done, **counts},
            system=self.system,
            _resume=self,
            events=() if self.watch is None else self.watch.located(slice(first.size)),
            _planned=partial(self.plan, want, self._time_after(start + n)),
            resolution=self.resolution,
        )
        return self._shaped(run)

    def _shaped(self, run: Trajectory) -> Trajectory:
        """The result with the data of this kind of system."""
        return run

    @property
    def _compared(self) -> npt.NDArray[np.intp]:
        """Indices of the state components that determine the error."""
        return np.arange(self.state.size)

    def _search_values(self) -> dict[str, Any]:
        """Values of the step size search for this kind of run."""
        return {"holds_places": False, "most_direct": 0, "later": 0.0}

    def take_search(self, found: dict[str, Any]) -> None:
        """Store the results of a step size search."""
        self.by_phases, self.too_long = found["by_phases"], found["too_long"]
        self.layers.seen |= bool(found["in_parts"])

    def _advance(
        self,
        n: int,
        want: Wanted,
        states: list[FloatArray],
        counts: dict[str, int],
        bar: Bar,
    ) -> int:
        """Compute n steps in parts; return the outcome."""
        piece = self.piece if self.watch is None else min(self.piece, _WATCHED)
        stored = want.keep != "last" and want.times is None
        every = want.every
        piece = max(piece // every, 1) * every
        left, ended = n, 0
        while left and not ended:
            count = min(piece, left)
            columns = count // every if stored else 0
            times = nothing(0)
            if want.times is not None:
                now, until = self.time, self._time_after(self.done + count)
                if left == count:
                    until = math.inf
                times = want.times[(want.times >= now) & (want.times < until)]
            part = self._found(count, every, columns, times)
            made, ended = part["made"], part["ended"]
            self.memory, self.state = part["memory"], part["last"]
            if self.watch is not None:
                self.watch.take(part["found"], part["n_found"])
                if self.watch.gathers:
                    self.watch.take_gathered(part["found"], part["n_found"])
                if OUTCOMES[ended] == "event":
                    self.state = self.watch.last_state
            self.anew = False
            self.done += made
            self.reached = part["reached"] if ended else self.time
            counts[self.counts] += part["counted"]
            if want.times is not None:
                states.append(part["at_times"].T[: part["n_reached"]])
            elif stored:
                states.append(part["states"].T[: min(columns, made // every)])
            left -= count
            bar.update(made)
        return int(ended)

    def acting(self) -> tuple[_native.Handle, Loads, EarlierMotion | None]:
        """The system, its loads, and its past; None: it has no memory."""
        raise InputError(f"{type(self.system).__name__}: a motion of it has no accelerations")

    def accelerations(self, kept: Trajectory) -> FloatArray:
        """Accelerations of the states that ``kept`` holds, by the equations of motion."""
        return accelerations(self.along(kept, remembers=False))

    def floor(self, kept: Trajectory) -> tuple[FloatArray, ...]:
        """Displacements, velocities and accelerations that the base gives the coordinates."""
        now = self.acting()[1].at(kept.t)
        return now.place, now.speed, now.push

    def mount_forces(self, kept: Trajectory) -> MountForcesInTime:
        """Forces of the mounts of a body."""
        return mount_forces(self.system, self.along(kept))

    def element_forces(self, kept: Trajectory) -> ElementForces:
        """Forces of elements or springs."""
        return element_forces(self.system, self.along(kept))

    def support_reactions(self, kept: Trajectory) -> SupportReactions:
        """Forces at the supports of a structure."""
        system: Any = self.system
        if system._held is None:
            raise InputError("support_reactions: this system has no supports")
        motion, base = self.along(kept), self._base_motion(kept.t)
        if kept._floor is not None:
            direction = np.asarray(system._base_direction)
            if not direction.any():
                raise InputError("support_reactions: base_acceleration moves no free coordinate")
            floor = kept._floor.at(kept.t)
            base = tuple(one @ direction / (direction @ direction) for one in floor)
        return support_reactions(system, motion, base)

    def _base_motion(self, t: FloatArray) -> tuple[FloatArray, ...]:
        """Displacement, velocity and acceleration of a base along its direction, each (n,)."""
        return np.zeros(t.size), np.zeros(t.size), np.zeros(t.size)

    def along(self, kept: Trajectory, *, remembers: bool = True) -> KnownMotion:
        """What acts along the states that ``kept`` holds.

        ``remembers``: whether what springs remember is needed besides accelerations.
        """
        return self._along(kept, kept.state)

    def _along(self, kept: Trajectory, state: FloatArray) -> KnownMotion:
        """The same of states of all coordinates."""
        system, loads, past = self.acting()
        none = nothing(0)

        def relative(t: FloatArray, state: FloatArray) -> tuple[FloatArray, ...]:
            now = loads.at(t)
            laws = none.reshape(1, 0).repeat(t.size, axis=0)
            return state[:, ::2] - now.place, state[:, 1::2] - now.speed, laws

        panels = None
        if past is not None and kept.t.size:
            panels = self._panels(
                kept, past, lambda at: relative(at, self.states_at(at, kept)[:, : state.shape[1]])
            )
        u, rate, _ = relative(kept.t, state)
        return KnownMotion(system, kept.t, u, rate, loads.at(kept.t), panels)

    def _panels(
        self,
        kept: Trajectory,
        past: EarlierMotion,
        states: Callable[[FloatArray], tuple[FloatArray, ...]],
    ) -> Panels:
        """The whole motion on panels, made once."""
        # A run that failed has no states inside its last step.
        ended = kept.outcome in ("completed", "event", "stopped")
        if not ended and kept.t.size < 2:
            raise InputError(
                f"acceleration: the run ended early ({kept.outcome}) with a single state; use "
                "keep='all'"
            )
        until = max(kept.t_reached if ended else kept.t[-1], 1e-3 * self.h)
        if self.on_panels is None or self.on_panels[0] != until:
            ends = panel_ends(self.mesh, self.h, until)
            self.on_panels = until, Panels.of(ends, past, states)
        return self.on_panels[1]

    def gather_all(self, accelerated: list[FloatArray]) -> None:
        """Keep all coordinates from now on, and gather accelerations and forces of laws."""
        self.watch, self.accelerated = None, accelerated

    def states_at(
        self, times: FloatArray, kept: Trajectory, accelerated: list[FloatArray] | None = None
    ) -> FloatArray:
        """States at ascending times of the run that ``kept`` holds, by making it once more.

        ``accelerated``: gathers accelerations relative to the base, then forces of laws.
        """
        latest: Run | None = None
        found = []
        assert self.maker is not None
        for maker, done in (*self.parts, (self.maker, self.done)):
            part = maker(self.h)
            if latest is not None:
                part.adopt(latest)
            part.prepare(self, 1)
            part.mesh = self.mesh
            if accelerated is not None:
                part.gather_all(accelerated)
            begin, until = part.time, self._time_after(done)
            last = done == self.done and maker is self.maker
            here = times[(times >= begin) & ((times < until) | last)]
            if not last or here.size:
                # A run that ended early ended inside a step.
                steps = done - part.done + int(last and kept.outcome != "completed")
                want = Wanted(times=here) if here.size else Wanted(keep="last")
                run = part.steps(steps, want, False)
                if here.size:
                    found.append(run.state)
            latest = part
        return np.concatenate(found)

    def _check_capacity(self, n_kept: int) -> None:
        most = MAX_KEPT // max(self.state.size, 1)
        if n_kept > most:
            raise InputError(
                f"t_end: would keep {n_kept} states, must be at most {most}: see save_every, "
                'keep = "tail" or keep = "last"'
            )

    def _check_times(self, times: FloatArray, n: int) -> None:
        end = self._time_after(self.done + n)
        if times[0] < self.time or times[-1] > end * (1 + 1e-15):
            raise InputError(
                f"times: must be between the start {self.time:g} and the end {end:g} of the run"
            )


def again(run: Run, factor: int) -> Run | None:
    """Return the run from its first start, with steps shorter by a factor; None: it ended early.

    It keeps the memory that its next steps need.
    """
    assert run.maker is not None
    latest: Run | None = None
    for maker, done in (*run.parts, (run.maker, run.done)):
        part = maker(run.h / factor)
        part.sharpen(factor)
        if latest is not None:
            part.adopt(latest)
        part.prepare(run, factor)
        part.mesh = None if run.mesh is None else run.mesh.finer(factor)
        latest = part
        n = done * factor - part.done
        if n and part.steps(n, Wanted(keep="last"), False).outcome != "completed":
            return None
    return latest
