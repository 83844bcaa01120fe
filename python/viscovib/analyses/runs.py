"""Runs in equal steps: what is kept of them, how they go on, how their step is found."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, ClassVar, NamedTuple

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
from viscovib.analyses.forces_in_time import element_forces, mount_forces
from viscovib.bodies.body import Body
from viscovib.bodies.turning import told_like
from viscovib.common.counts import things
from viscovib.common.mesh import Mesh
from viscovib.common.past import check_start
from viscovib.common.plan import Plan
from viscovib.common.progress import SILENT, Bar, progress_bar
from viscovib.errors import InputError
from viscovib.results.motion_forces import ElementForces, MountForcesInTime
from viscovib.results.trajectory import OUTCOMES, Trajectory
from viscovib.systems.oscillators import Oscillator
from viscovib.systems.pendulum import Pendulum

MAX_STEPS = 10**12
#: Numbers that a run keeps at most: 1 GiB.
MAX_KEPT = 2**27
#: Steps of a first run whose step is to be found.
MAX_FIRST_STEPS = 10**9
ROUNDING = 1e-15
#: Relative error of the time of a stop inside a step.
LOCATED = 1e-12
#: Halvings of the step before a tolerance is given up, and while two runs end unlike each other.
_MIN_HALVINGS, _MAX_HALVINGS, _MAX_UNLIKE = 5, 12, 9
#: How many times as large a motion is that has run away.
_AWAY = 10.0
#: Coordinates that a message lists; steps of a native call that looks for events.
_LISTED, _WATCHED = 4, 10_000


class NotMetError(InputError):
    """A tolerance that no step met."""


@dataclass(frozen=True, eq=False)
class Wanted:
    """What is kept of a run."""

    every: int = 1
    keep: str = "all"
    tail: float = 0.0
    times: FloatArray | None = None
    #: What was asked for, where ``times`` stand for it.
    asked: Wanted | None = None

    @classmethod
    def checked(
        cls, times: npt.ArrayLike | None, save_every: int, keep: str, tail: float | None
    ) -> Wanted:
        """Check the arguments of ``simulate``."""
        every = _native.integer("save_every", save_every, 1, MAX_STEPS)
        _native.choice("keep", keep, ("all", "tail", "last"))
        if (keep == "tail") != (tail is not None):
            raise InputError('tail: must be given with keep = "tail", and only then')
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
        """Whether nothing was asked for, so that all states are kept."""
        return self.times is None and self.every == 1 and self.keep == "all"

    def finer(self, factor: int) -> Wanted:
        """The same states of a run with so many times the steps."""
        if factor == 1:
            return self
        return replace(self, every=self.every * factor)

    def at(self, times: FloatArray) -> Wanted:
        """The same, of states at these times, where steps are not equal."""
        if self.keep == "tail":
            times = times[times >= times[-1] - self.tail * (1 + 1e-12)]
        return Wanted(times=times, asked=self.asked or self)


def hopeless(changes: list[float]) -> bool:
    """Whether halving the step once more is vain: two halvings gain less than a digit.

    So it is with chaotic motion, and below the level of rounding. A large first step may need a
    few halvings before the order of a method shows, or before two runs end alike: an infinite
    change is no measure of what a halving gains.
    """
    n = len(changes)
    if n < _MIN_HALVINGS:
        return False
    if not math.isfinite(changes[-1]):
        return n >= _MAX_UNLIKE
    return n >= _MAX_HALVINGS or 0.1 * changes[-3] < changes[-1]


def has_outrun(start: FloatArray, end: FloatArray, one: float, other: float, h: float) -> bool:
    """Whether a motion that two runs could not follow has run away from where it began.

    ``one``, ``other``: when they ended; they ended at one place, within a step h of the longer.
    """
    return bool(
        min(one, other) > h
        and abs(one - other) <= h
        and np.abs(end).max() > _AWAY * np.abs(start).max()
    )


def difference(coarse: Trajectory, fine: Trajectory) -> float:
    """Largest difference of the states of two runs, and of the times at which they stop."""
    n, m = coarse.t.size, fine.t.size
    coarse = told_in_one_way(coarse, fine)
    if coarse.outcome == "completed" == fine.outcome and n == m:
        return float(np.abs(fine.state - coarse.state).max())
    if coarse.outcome != fine.outcome or coarse.outcome == "step too large" or abs(n - m) > 1:
        return math.inf
    n = min(n, m)
    if fine.outcome == "diverged" and n and fine.t[n - 1] >= fine.t_reached:
        n -= 1  # where a coordinate passes its bound it changes faster than any time is known
    moved = abs(fine.t_reached - coarse.t_reached)
    return max(moved, float(np.abs(fine.state[:n] - coarse.state[:n]).max(initial=0.0)))


def told_in_one_way(run: Trajectory, like: Trajectory) -> Trajectory:
    """The run, of a body that turns far by those rotation vectors that can be compared."""
    turns = isinstance(run.system, Body) and run.system._winds
    if not turns or run.state.shape != like.state.shape:
        return run
    return replace(run, state=told_like(run.state, like.state))


class Piece(NamedTuple):
    """What a native call returns of the steps it made."""

    #: States a column each, and at the wanted times; the last one; all that going on needs.
    states: FloatArray
    at_times: FloatArray
    last: FloatArray
    memory: FloatArray
    #: Whole steps, wanted times reached, and the time of the last state.
    made: int
    n_reached: int
    reached: float
    ended: int
    counted: int
    #: Signal, time and state of each event, a column each; how many there are.
    found: FloatArray
    n_found: int

    @classmethod
    def of(cls, found: dict[str, Any]) -> Piece:
        """What a task found."""
        return cls(
            found["states"], found["at_times"], found["last"], found["memory"],
            found["made"], found["n_reached"], found["reached"], found["ended"], found["counted"],
            found.get("found", _NONE), found.get("n_found", 0),
        )  # fmt: skip


_NONE = np.empty((0, 0))


def starting_state(initial: Any, n: int, dof_names: Sequence[str]) -> FloatArray:
    """Return coordinates and velocities to begin with, of n coordinates."""
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
    """So many zeros that nobody writes into, which native calls only read."""
    zeros = np.zeros(n, dtype=kind)
    zeros.setflags(write=False)
    return zeros


@dataclass
class ThinLayers:
    """Where steps may miss thin layers of force laws: all runs of a call know what one has met."""

    #: Whether one may have been missed: all steps are made in parts that see them from then on.
    seen: bool = False
    #: The longest step of these runs: parts of shorter ones are as much shorter, lest all have the
    #: same parts, whose error no comparison tells.
    longest: float = 0.0


class Run(ABC):
    """A run that can go on: the native state and how far it has come."""

    #: Relative error of what stands for kernels, which two runs may share.
    represented: float = 0.0
    #: What rounding of frequencies computed beforehand makes of states, which all runs share.
    by_phases: float = 0.0
    #: What the native calls count.
    counts: ClassVar[str]
    #: Thin layers of forces that steps may miss; those of a search for the step share them.
    layers: ThinLayers = ThinLayers()
    #: Whether a run without a memory of its own may go on under other loads from its state.
    remembers_past: ClassVar[bool] = False
    #: Whether equations and kernels are solved to a tolerance, which `sharpen` takes down.
    sharpens: bool = False
    #: How many times as long the steps are as those whose nodes see every layer.
    too_long: float = 0.0
    #: Steps a native call takes at most: how often progress shows and Ctrl-C is heard.
    piece: int = 200_000
    #: Number of equal steps that end at a given time, and that time: their product is rounded.
    goal: tuple[int, float] = (-1, 0.0)
    #: True if the step was found by a tolerance.
    has_found_step: bool = False

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
        #: Where steps end, if they are not equal.
        self.mesh: Mesh | None = None
        #: What tables of loads are called in the plan.
        self.tables: tuple[str, ...] = ()
        #: What made the run, and where its loads have corners.
        self.maker: Callable[[float], Run] | None = None
        self.breaks: FloatArray = nothing(0)
        #: Whether other loads act from now on than before; what made the earlier parts, and
        #: how many steps were done at the end of each.
        self.anew = False
        self.parts: tuple[tuple[Callable[[float], Run], int], ...] = ()
        #: Events to look for, and when the steps made last began.
        self.watch: Watch | None = None
        self.began = 0.0
        #: States kept of a step by its polynomial, if more than that at its end are.
        self.kept_of_step = 1
        #: States on the way of a search that found no step.
        self.looks: FloatArray = nothing(0)
        #: Accelerations at wanted times, piece by piece, if these are wanted.
        self.accelerated: list[FloatArray] | None = None
        #: The motion on panels until a time, as what springs remember needs it.
        self.on_panels: tuple[float, Panels] | None = None

    def on(self, mesh: Mesh) -> Run:
        """The same run in the steps of a mesh."""
        self.mesh, self.h = mesh, mesh.h
        return self

    def sharpen(self, factor: int) -> None:  # noqa: B027
        """Solve equations, and fit kernels, as much better as steps are shorter by the factor.

        Two runs that leave as much of them differ by none of it.
        """

    def adopt(self, earlier: Run) -> None:
        """Go on from the end of an earlier run, under the loads of this one."""
        assert earlier.maker is not None
        self.state, self.done, self.reached = earlier.state, earlier.done, earlier.reached
        self.h, self.mesh = earlier.h, earlier.mesh
        self.anew = True
        self.watch = None if earlier.watch is None else earlier.watch.going_on()
        self.parts = (*earlier.parts, (earlier.maker, earlier.done))

    def prepare(self, like: Run, factor: int) -> None:
        """Remember as much as another run will need, in steps shorter by the factor."""
        self.piece = like.piece

    def serves(self) -> bool:
        """Whether what is remembered serves the steps to come."""
        return True

    def _mesh_arrays(self) -> tuple[FloatArray, npt.NDArray[np.int64]]:
        """Return ends of pieces and the steps made by each, one at 0 for equal steps."""
        if self.mesh is None:
            return nothing(1), nothing(1, np.int64)
        return self.mesh.ends, self.mesh.made_by

    @abstractmethod
    def _given(self) -> tuple[str, tuple[_native.Handle, ...], dict[str, Any]]:
        """Return the task of a piece, its objects, and what it is given that others are not."""

    def _takes_long(self, count: int) -> bool:
        """Whether so many steps may take long."""
        return count > _native.MANY_STEPS

    def _values(
        self, count: int, every: int, times: FloatArray
    ) -> tuple[str, tuple[_native.Handle, ...], dict[str, Any]]:
        """The same with what every piece is given, of ``count`` steps from the present state."""
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
        """Make ``count`` steps from the present state in the core, and return what it finds."""
        task, objects, values = self._values(count, every, times)
        long = self._takes_long(count)
        found = _native.run_either(long, task, *objects, columns=columns, **values)
        if self.watch is not None:
            self.watch.sides[:] = found["sides"]
        return found

    def _native_steps(self, count: int, every: int, columns: int, times: FloatArray) -> Piece:
        """Make ``count`` steps from the present state."""
        return Piece.of(self._found(count, every, columns, times))

    @abstractmethod
    def _plan(self, end: float, dt: float, tolerance: float, every: int, last: bool) -> str:
        """Return the core's words about a run to ``end`` in steps dt, 0 if they are sought."""

    def plan(self, want: Wanted, end: float, sought: float | None = None) -> Plan:
        """Say what a run to ``end`` computes; ``sought``: the tolerance by which its step was."""
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
                [f"skips: storing other states than those at {kept} (not asked for)"]
            )
        if want.keep == "tail":
            return plan.and_also(
                [f"skips: storing states before the last {want.tail:g} (not asked for)"]
            )
        return plan

    @property
    def has_layers(self) -> bool:
        """Whether there may be such layers at all."""
        return False

    @property
    def over_kinks(self) -> bool:
        """Whether steps go over kinks of laws, so that errors are no power of their length."""
        return False

    @property
    def switched(self) -> FloatArray:
        """What tells on which sides of its surfaces the motion is; none: nothing switches."""
        return np.empty(0)

    def belongs_to_state(self) -> npt.NDArray[np.bool_]:
        """Which numbers of the memory are of the state; others are of time, or of the method."""
        assert self.memory is not None
        return np.ones(self.memory.size, dtype=bool)

    def told_by_state(self) -> slice:
        """Numbers of the memory that follow from others, and that the state ends with as well."""
        return slice(0, 0)

    def compute_all(self) -> None:  # noqa: B027
        """Compute all coordinates, also those that nothing moves, before the first step."""

    @property
    def time(self) -> float:
        """How far the run has come."""
        return self._time_after(self.done)

    def _time_after(self, steps: int) -> float:
        if self.mesh is not None:
            return self.mesh.time(steps)
        return self.goal[1] if steps == self.goal[0] else steps * self.h

    def steps(self, n: int, want: Wanted, progress: bool) -> Trajectory:
        """Make n steps."""
        if want.times is not None:
            self._check_times(want.times, n)
        start, first = self.done, self.state
        self.began = self.time
        # What is not kept is passed over in larger pieces.
        skipped = 0
        if want.keep == "tail":
            skipped = max(0, n - math.ceil(min(want.tail / self.h, n))) // want.every * want.every
        if want.times is None and want.keep != "last":
            self._check_room((n - skipped) // want.every)
        counts = {self.counts: 0}
        states: list[FloatArray] = []
        ended = 0
        # Short runs do not look for somebody who watches.
        long = progress or n > _native.MANY_STEPS
        with progress_bar(n, "steps", progress) if long else SILENT as bar:
            if skipped:
                ended = self._advance(skipped, replace(want, keep="last"), states, counts, bar)
                start, first = self.done, self.state
                if ended:
                    # What was wanted lies beyond the stop: the state there is all there is.
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
            events=() if self.watch is None else self.watch.passages(slice(first.size)),
            _planned=partial(self.plan, want, self._time_after(start + n)),
        )
        return self._shaped(run)

    def _shaped(self, run: Trajectory) -> Trajectory:
        """The run with what its kind of system tells."""
        return run

    @property
    def _judged(self) -> npt.NDArray[np.intp]:
        """Which numbers of a state tell how exact a run is."""
        return np.arange(self.state.size)

    def _search_values(self) -> dict[str, Any]:
        """What a search is given besides of this kind of run."""
        return {"holds_places": False, "most_direct": 0, "later": 0.0}

    def take_search(self, found: dict[str, Any]) -> None:
        """Remember what a search has met."""
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
        """Make n steps in pieces; return how they ended."""
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
            part = self._native_steps(count, every, columns, times)
            if self.watch is not None:
                self.watch.take(part.found, part.n_found)
                if self.watch.gathers:
                    self.watch.take_gathered(part.found, part.n_found)
                if OUTCOMES[part.ended] == "event":
                    part = part._replace(last=self.watch.last_state)
            self.memory, self.state, ended = part.memory, part.last, part.ended
            self.anew = False
            self.done += part.made
            self.reached = part.reached if ended else self.time
            kept = part.states.T[: min(columns, part.made // every)]
            counts[self.counts] += part.counted
            if want.times is not None:
                states.append(part.at_times.T[: part.n_reached])
            elif stored:
                states.append(kept)
            left -= count
            bar.update(part.made)
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
        until = max(kept.t_reached, 1e-3 * self.h)
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
                # A run that stopped did so inside a step.
                steps = done - part.done + int(last and kept.outcome != "completed")
                want = Wanted(times=here) if here.size else Wanted(keep="last")
                run = part.steps(steps, want, False)
                if here.size:
                    found.append(run.state)
            latest = part
        return np.concatenate(found)

    def _check_room(self, n_kept: int) -> None:
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
    """The same run from its first start, in steps shorter by a factor; None: it stopped before.

    It remembers what its steps to come will need.
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
