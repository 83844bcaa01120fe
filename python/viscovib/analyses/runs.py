"""Runs with equal steps: states kept, continuation, and data of the step size search."""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.accuracy import Accuracy
from viscovib.analyses.acting import KnownMotion, accelerations, loads_at
from viscovib.analyses.events import Watch
from viscovib.analyses.forces_in_time import (
    element_forces,
    mount_forces,
    remembered_by_body,
    support_reactions,
)
from viscovib.common.mesh import Mesh
from viscovib.common.past import check_start
from viscovib.common.plan import Plan
from viscovib.common.progress import counted_pieces
from viscovib.errors import InputError
from viscovib.results.motion_forces import ElementForces, MountForcesInTime, SupportReactions
from viscovib.results.trajectory import OUTCOMES, LocatedEvents, Trajectory
from viscovib.systems.oscillators import Oscillator
from viscovib.systems.pendulum import Pendulum

MAX_STEPS = 10**12
#: Largest array size of the states of a run: 1 GiB.
MAX_KEPT = 2**27
#: Largest number of steps of the first run of a step size search.
MAX_FIRST_STEPS = 10**9
ROUNDING = 1e-15
#: Growth factor of a motion that has diverged.
_AWAY = 10.0
#: What a native call makes: one run, one run and its error, or runs with decreasing steps.
ONE_RUN, WITH_ERROR, WITH_SEARCH = range(3)
#: Largest number of coordinates in a message; number of first steps from which on a search may
#: take long.
_LISTED, _FEW = 4, 16


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

    def at(self, times: FloatArray) -> Wanted:
        """Return the selection as states at these times, for unequal steps."""
        if self.keep == "tail":
            times = times[times >= times[-1] - self.tail * (1 + 1e-12)]
        return Wanted(times=times, asked=self.asked or self)


def has_outrun(start: FloatArray, end: FloatArray, one: float, other: float, h: float) -> bool:
    """True if a motion that two runs could not follow has diverged from its start.

    ``one``, ``other``: end times of the runs, which may differ by one step h.
    """
    return bool(
        min(one, other) > h
        and abs(one - other) <= h
        and np.abs(end).max() > _AWAY * np.abs(start).max()
    )


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
    """A run that can be continued: its equations, and its state and data after some steps."""

    #: Quantity that native calls count.
    counts: str
    #: Number of equal steps to a given time, and this time (the product with h is rounded).
    goal: tuple[int, float] = (-1, 0.0)
    #: True if the step was found by a tolerance.
    has_found_step: bool = False
    #: As of `Trajectory`, for motions with memory.
    resolution: float | None = None
    #: True if the data of earlier steps are not those that the next steps need.
    stale: bool = False

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
        #: Corners of the loads.
        self.breaks: FloatArray = nothing(0)
        #: True if new loads act from now on; the runs under earlier loads.
        self.anew = False
        self.parts: tuple[Run, ...] = ()
        #: Events, and the number of states kept per step, from its polynomial.
        self.watch: Watch | None = None
        self.kept_of_step = 1
        #: Thin layers of laws that steps may miss; other runs of a call may share them.
        self.layers = ThinLayers()
        #: The motion on panels until a time, as what springs remember needs it.
        self.on_panels: tuple[float, dict[str, Any]] | None = None

    def __copy__(self) -> Run:
        """Return a run with the same data."""
        made: Run = object.__new__(type(self))
        made.__dict__.update(self.__dict__)
        return made

    def on(self, mesh: Mesh) -> Run:
        """Return the run with the steps of a mesh."""
        self.mesh, self.h = mesh, mesh.h
        return self

    def adopt(self, earlier: Run) -> None:
        """Continue from the end of an earlier run, with the loads of this run."""
        self.state, self.done, self.reached = earlier.state, earlier.done, earlier.reached
        self.h, self.mesh = earlier.h, earlier.mesh
        self.has_found_step = earlier.has_found_step
        self.anew = True
        self.watch, self.layers = earlier.watch, earlier.layers
        self.parts = (*earlier.parts, earlier)

    def check_reach(self, end: float) -> None:  # noqa: B027
        """Refuse a run that continues beyond the time for which kernels are fitted."""

    @abstractmethod
    def _given(self) -> tuple[str, tuple[_native.Handle, ...], dict[str, Any]]:
        """Return the task, its objects, and the values of the equations."""

    def _takes_long(self, count: int) -> bool:
        """True if this number of steps may take long."""
        return count > _native.MANY_STEPS

    def _equations(self) -> tuple[str, tuple[_native.Handle, ...], dict[str, Any]]:
        """`_given`; of a run with parts: an object for each of them."""
        own = self._given()
        if not self.parts:
            return own
        handles = []
        for task, objects, values in (*(part._given() for part in self.parts), own):
            if task == own[0] and "moves" in own[2]:
                # Steps of all parts compute the same coordinates.
                values = {**values, "moves": own[2]["moves"]}
            handles.append(_native.Handle(task, *objects, **values))
        return "motion run", tuple(handles), {"until": np.array([one.done for one in self.parts])}

    def compute(
        self,
        aim: int,
        n: int,
        want: Wanted,
        end: float,
        progress: bool = False,
        **more: Any,
    ) -> dict[str, Any]:
        """Compute n steps to ``end``, also their error, or search for a step size (``aim``).

        Return the results of the core: for example the final state ``last`` and its time
        ``reached``, the number ``made`` of full steps and the outcome ``ended``.
        """
        self.check_reach(end)
        times = nothing(0) if want.times is None else want.times
        task, objects, values = self._equations()
        values = values | self._values(want.every, times) | {
            "aim": aim, "n_steps": n, "t_end_of_run": float(end),
        }  # fmt: skip
        if want.keep != "all":
            values |= {"last_only": want.keep == "last", "tail": float(want.tail)}
        if self.mesh is not None:
            values |= {"ends": self.mesh.ends, "made_by": self.mesh.made_by}
        if self.done:
            values |= {"begun": (*self.parts, self)[0].begin, "remakes": self.stale}
            if self.memory is not None:
                values["memory"] = self.memory
        long = self._takes_long(n) or (aim != ONE_RUN and n > _FEW)
        if not (long or progress):
            return _native.run(task, *objects, **(values | more))
        with counted_pieces(progress, n if aim == ONE_RUN else None):
            return _native.run_either(long, task, *objects, **(values | more))

    def _values(self, every: int, times: FloatArray) -> dict[str, Any]:
        """Return the present state of the run, and which states it keeps."""
        self.layers.longest = max(self.layers.longest, self.h)
        values = self._run_values() | {
            "first": self.done, "save_every": every,
            "resume": 2 if self.anew else 1 if self.done else 0, "h": self.h,
            "tolerance": self.solved, "times": times, "initial": self.state,
        }  # fmt: skip
        if self.layers.seen or self.layers.longest > self.h:
            values |= {"in_parts": self.layers.seen, "longest": self.layers.longest}
        if self.watch is not None:
            values |= {"watched": self.watch.vector, "sides": self.watch.sides}
        return values

    def as_object(self) -> _native.Handle:
        """Return the run at its start as an object of the core, for a task about many runs."""
        task, objects, values = self._given()
        return _native.Handle(task, *objects, **values, **self._values(1, nothing(0)))

    def take(self, found: dict[str, Any]) -> npt.NDArray[np.bool_] | None:
        """Move to the end of a run that the core has made; return the mask of valid events."""
        self.state, self.memory = found["last"], found["memory"]
        self.done, self.reached = found["made"], found["reached"]
        self.anew = self.stale = False
        self.layers.seen |= bool(found["in_parts"])
        watch = self.watch
        if watch is None:
            return None
        watch.sides[:] = found["sides"]
        if watch.gathers:
            watch.take_gathered(found["found"], found["n_found"])
        return watch.take(found["found"], found["n_found"])

    @abstractmethod
    def _plan(self, **steps: Any) -> str:
        """Return the plan of the core; ``steps``: end, step size, accuracy and kept states."""

    def plan(self, want: Wanted, end: float, sought: Accuracy | None = None) -> Plan:
        """Return the plan of a run to ``end``; ``sought``: accuracy of the step size search."""
        accuracy = sought or Accuracy(self.solved)
        want = want.asked or want
        steps: dict[str, Any] = {
            "t_end": float(end), "dt": 0.0 if sought else float(self.h),
            "tolerance": float(accuracy.absolute),
            "relative": 0.0 if accuracy.by_size else float(accuracy.relative),
            "save_every": min(want.every, np.iinfo(np.int32).max),
            "last_only": want.keep == "last",
        }  # fmt: skip
        if want.times is not None:
            steps["times"] = want.times
        elif want.keep == "tail":
            steps["tail"] = float(want.tail)
        plan = Plan(self._plan(**steps))
        if self.tables:
            lines = [s for s in str(plan).splitlines() if s != "skips: the load (there is none)"]
            plan = Plan("\n".join(lines)).and_also(self.tables)
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
    def time(self) -> float:
        """Present time of the run."""
        return self._time_after(self.done)

    def _time_after(self, steps: int) -> float:
        if self.mesh is not None:
            return self.mesh.time(steps)
        return self.goal[1] if steps == self.goal[0] else steps * self.h

    def steps(self, n: int, want: Wanted, progress: bool) -> Trajectory:
        """Compute n steps."""
        end = self._time_after(self.done + n)
        self.check_wanted(want, n)
        found = self.compute(ONE_RUN, n, want, end, progress)
        self.take(found)
        events = () if self.watch is None else self.watch.located(slice(self.state.size))
        return self._shaped(self.result(found, "", None, partial(self.plan, want, end), events))

    def check_wanted(self, want: Wanted, n: int) -> None:
        """Refuse states outside of the next n steps, or too many."""
        if want.times is not None:
            self._check_times(want.times, n)
        elif want.keep == "all":
            self._check_capacity(n // want.every)
        elif want.keep == "tail":
            self._check_capacity(math.ceil(min(want.tail / self.h, n)) // want.every)

    def result(
        self,
        found: dict[str, Any],
        prefix: str = "",
        error: float | None = None,
        planned: Callable[[], Plan] | None = None,
        events: tuple[LocatedEvents, ...] = (),
    ) -> Trajectory:
        """One of the runs that the core has made, with all coordinates computed."""
        return Trajectory(
            t=found[f"{prefix}t"],
            state=found[f"{prefix}states"].T,
            outcome=OUTCOMES[found[f"{prefix}ended"]],
            t_reached=found[f"{prefix}reached"],
            step=found[f"{prefix}step"],
            method=self.method,
            error=error,
            stats={"steps": found[f"{prefix}made"], self.counts: found["counted"]},
            system=self.system,
            _resume=self,
            _planned=planned or partial(self.plan, Wanted(), 0.0),
            resolution=self.resolution,
            events=events,
        )

    def _shaped(self, run: Trajectory) -> Trajectory:
        """The result with the data of this kind of system."""
        return run

    @property
    def _compared(self) -> npt.NDArray[np.intp]:
        """Indices of the state components that determine the error."""
        return np.arange(self.state.size)

    def _run_values(self) -> dict[str, Any]:
        """Values of a run of this kind besides those of its equations."""
        return {}

    def acting(self) -> tuple[_native.Handle, dict[str, Any], dict[str, Any] | None]:
        """The system, its loads, and its past; None: it has no memory."""
        raise InputError(f"{type(self.system).__name__}: a motion of it has no accelerations")

    def accelerations(self, kept: Trajectory) -> FloatArray:
        """Accelerations of the states that ``kept`` holds, by the equations of motion."""
        return accelerations(kept._known, remembered_by_body(self.system, kept._known))

    def floor(self, kept: Trajectory) -> tuple[FloatArray, ...]:
        """Displacements, velocities and accelerations that the base gives the coordinates."""
        found = loads_at(self.acting()[1], kept.t)
        return found["place"], found["speed"], found["push"]

    def mount_forces(self, kept: Trajectory) -> MountForcesInTime:
        """Forces of the mounts of a body."""
        return mount_forces(self.system, kept._known)

    def element_forces(self, kept: Trajectory) -> ElementForces:
        """Forces of elements or springs."""
        return element_forces(self.system, kept._known)

    def support_reactions(self, kept: Trajectory) -> SupportReactions:
        """Forces at the supports of a structure."""
        system: Any = self.system
        if system._held is None:
            raise InputError("support_reactions: this system has no supports")
        motion, base = kept._known, self._base_motion(kept.t)
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

    def along(self, kept: Trajectory) -> KnownMotion:
        """What acts along the states that ``kept`` holds."""
        return self._along(kept, {"states": kept.state.T})

    def _along(self, kept: Trajectory, found: dict[str, Any]) -> KnownMotion:
        """The same of states of all coordinates, with accelerations if states do not give them."""
        system, loads, past = self.acting()
        given = loads | {"times": kept.t, "states": found["states"]}
        own = "accelerations" in found
        if own:
            given["accelerations"] = found["accelerations"]
        make = None
        if past is not None and kept.t.size:
            make = partial(self._panels, kept, past, found["states"], own)
        return KnownMotion(system, kept.t, given, make)

    def _panels(
        self, kept: Trajectory, past: dict[str, Any], states: FloatArray, repeats: bool
    ) -> dict[str, Any]:
        """The whole motion on panels, made once; ``repeats``: states do not give forces of laws."""
        # A run that failed has no states inside its last step.
        ended = kept.outcome in ("completed", "event", "stopped")
        if not ended and kept.t.size < 2:
            raise InputError(
                f"acceleration: the run ended early ({kept.outcome}) with a single state; use "
                "keep='all'"
            )
        until = max(kept.t_reached if ended else kept.t[-1], 1e-3 * self.h)
        if self.on_panels is None or self.on_panels[0] != until:
            steps: dict[str, Any] = {"h": float(self.h), "until": float(until)}
            if self.mesh is not None:
                steps |= {"ends": self.mesh.ends, "made_by": self.mesh.made_by}
            found = _native.run(
                "motion panels", times=kept.t, states=states, repeats=repeats, **steps
            )
            if "panel_times" in found:
                again = self.repeat(found.pop("panel_times"), kept, accelerates=repeats)
                found["panel_states"] = again["states"]
                if repeats:
                    found["panel_accelerations"] = again["accelerations"]
            self.on_panels = until, past | found
        return self.on_panels[1]

    def states_at(self, times: FloatArray, kept: Trajectory) -> FloatArray:
        """States at ascending times of the run that ``kept`` holds, by making it once more."""
        return np.asarray(self.repeat(times, kept)["states"].T[:, self._compared])

    def repeat(
        self, times: FloatArray, kept: Trajectory, *, accelerates: bool = False
    ) -> dict[str, Any]:
        """Repeat the run that ``kept`` holds, with all coordinates at other times.

        ``accelerates``: also accelerations relative to the base, then forces of laws.
        """
        run = copy.copy(self)
        run.watch, run.memory = None, None
        run.state = (*self.parts, self)[0].begin
        run.done = self.parts[-1].done if self.parts else 0
        # A run that ended early ended inside a step.
        n = self.done - run.done + int(kept.outcome != "completed")
        more: dict[str, Any] = {"resume": 0, "later": 0.0, "accelerates": accelerates}
        return run.compute(ONE_RUN, n, Wanted(times=times), kept.t_reached, **more)

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
