"""Motion of structures in time: modes are exact in each step, elements are collocated."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.acting import KnownMotion, base_along
from viscovib.analyses.oscillator_motion import (
    NODES,
    PASTS,
    REACH,
    OscillatorRun,
    history_of,
)
from viscovib.analyses.runs import ONE_RUN, Run, Wanted, starting_state
from viscovib.analyses.structure_modal import modal_arrays
from viscovib.common.counts import things
from viscovib.common.parameters import no_frequency
from viscovib.common.past import Past
from viscovib.common.results import Dataset
from viscovib.errors import ConvergenceWarning, InputError, caller
from viscovib.results.trajectory import Trajectory
from viscovib.systems.condensed import LoadedStructure
from viscovib.systems.law_ends import law_end as end_of_law
from viscovib.systems.load import LoadLike
from viscovib.systems.load_table import LoadTable, added
from viscovib.systems.piecewise import derivative
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.structure_loads import (
    Condensed,
    check_forces,
    table_columns,
    warn_of_creeping,
)
from viscovib.systems.whole import lacks_wholeness, whole_system

#: Largest part of a start outside the modes without a warning.
_LEFT_OUT = 1e-6


@dataclass(frozen=True, eq=False, repr=False)
class StructureTrajectory(Trajectory):
    """A `Trajectory` of a structure: chosen coordinates, and the deflections of its elements.

    Attributes
    ----------
    deflections, rates : ndarray, shape (n, q)
        Deflections of the elements, as `Structure.deflections` names them, relative to the base,
        and their rates.
    resting_since : ndarray, shape (n_stops, 2)
        For rigid stops (elements with a restitution): time since which the motion rests against
        each stop at gap and at -gap, after infinitely many impacts; nan if it does not rest at the
        end. Further attributes are those of `Trajectory`; ``state`` contains the coordinates in
        `dof_names`.
    """

    deflections: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    rates: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    resting_since: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    _names: tuple[str, ...] = ()
    _units: tuple[str, ...] = ()

    @property
    def dof_names(self) -> tuple[str, ...]:
        """Names of the coordinates kept."""
        return self._names

    @property
    def dof_units(self) -> tuple[str, ...]:
        """Units of the coordinates kept."""
        return self._units

    @property
    def _law_end(self) -> tuple[str, dict[str, float]] | None:
        """As for a `Trajectory`, from the last deflections that were kept."""
        if not self.deflections.size:
            return None
        # The end is located inside its step; steps that are too large end before it.
        more = self.step if self.outcome == "step too large" else 1e-6 * self.step
        reach = 2 * (self.t_reached - self.t[-1]) + more
        return end_of_law(self.system, (self.deflections[-1], self.rates[-1]), float(reach))

    def _read_by_laws(self, rows: slice) -> tuple[FloatArray, FloatArray]:
        return self.deflections[rows], self.rates[rows]

    def to_dataset(self, *, physical: bool = False) -> Dataset:
        """Coordinates and velocities over t, and ``deflections`` and ``rates`` of the elements."""
        data = super().to_dataset(physical=physical)
        names = [f"y{i + 1}" for i in range(self.deflections.shape[1])]
        system: Any = self.system
        if system._is_condensed:
            names = list(system.deflections)
        return data.assign(
            deflections=(("t", "element"), self.deflections), rates=(("t", "element"), self.rates)
        ).assign_coords(element=names)


def with_deflections(
    run: Trajectory,
    structure: Any,
    places: npt.NDArray[np.intp],
    columns: npt.NDArray[np.intp],
    deflections: FloatArray,
    rates: FloatArray,
    **more: Any,
) -> StructureTrajectory:
    """The result with the coordinates ``places``, the ``columns`` of its states."""
    given: dict[str, Any] = {name: getattr(run, name) for name in Trajectory.__dataclass_fields__}
    given["state"] = np.ascontiguousarray(run.state[:, columns])
    given["events"] = tuple(replace(one, state=one.state[:, columns]) for one in run.events)
    return StructureTrajectory(
        **given, deflections=np.ascontiguousarray(deflections), rates=np.ascontiguousarray(rates),
        _names=tuple(structure.dof_names[i] for i in places),
        _units=tuple(structure.dof_units[i] for i in places), **more,
    )  # fmt: skip


@dataclass(frozen=True)
class StructureMotion:
    """A requested motion of a structure: all data except the step size."""

    mount: Condensed
    end: float
    method: str
    loaded: LoadedStructure
    #: Indices of the coordinates kept.
    places: npt.NDArray[np.intp]
    #: Coordinates and velocities of the body at the start, shape (n,).
    start: FloatArray
    speed: FloatArray
    frequencies: FloatArray
    held: FloatArray
    before: FloatArray
    moved: FloatArray
    #: Displacements of all coordinates at the times ``before``, shape (n, m).
    whole_past: FloatArray
    memory: str
    #: Directions of the columns of tables, shape (n, k), times and polynomials; a single time:
    #: no table.
    patterns: FloatArray
    breaks: FloatArray
    pieces: FloatArray
    table: LoadTable | None = None
    base_breaks: FloatArray = field(default_factory=lambda: np.zeros(1))
    base_pieces: FloatArray = field(default_factory=lambda: np.zeros((4, 1), order="F"))

    @classmethod
    def checked(
        cls,
        structure: Condensed,
        end: float,
        initial: npt.ArrayLike | None,
        method: str,
        load: LoadLike | None,
        nu: float | None,
        base: LoadLike | LoadTable | None,
        force: LoadTable | None,
        held: npt.ArrayLike | Past | None,
        memory: str,
        coordinates: Sequence[str] | None,
    ) -> StructureMotion:
        """Check the arguments of ``simulate`` for a structure."""
        n = len(structure.dof_names)
        table = base if isinstance(base, LoadTable) else None
        waved = None if isinstance(base, LoadTable) else base
        if (table is not None or waved is not None) and structure._base_direction is None:
            raise InputError("base: this system has no base_direction, its base is fixed")
        name = _native.choice("method", method, ("auto", *NODES))
        _native.choice("memory", memory, ("auto", *PASTS))
        before, moved = history_of(held, n)
        state = np.zeros(2 * n)
        state[::2] = moved[:, -1]
        if initial is not None:
            state = starting_state(initial, n, structure.dof_names)
        frequency = 0.0 if nu is None else _native.number("nu", nu)
        if load is None and waved is None and nu is not None:
            raise InputError("nu: must not be given without load or base")
        loaded = structure._loaded(load, waved, frequency)
        if any(place.law.state for place in loaded.condensation.laws.programs):
            raise InputError(
                "elements: have a Jenkins, motions in time of such are not available (periodic "
                "motions are)"
            )
        if loaded.condensation.rest.losses.any():
            raise InputError(
                "loss_factor: has no meaning in time, must be 0 for a motion in time (use a "
                "kernel, or modal_damping)"
            )
        if frequency < 0 or (frequency == 0 and (loaded.orders > 0).any()):
            raise no_frequency(nu if nu is None else frequency)
        patterns, breaks, pieces = table_columns(force, structure)
        directions = loaded.condensation.laws.directions
        check_forces(structure, loaded, patterns)
        warn_of_creeping(structure)
        motion = cls(
            structure, end, "gauss8" if name == "auto" else name, loaded,
            structure._wanted(coordinates, loaded), state[::2].copy(), state[1::2].copy(),
            loaded.orders * frequency, directions.T @ moved[:, 0], before,
            np.asfortranarray(directions.T @ moved), moved, memory, patterns, breaks, pieces,
        )  # fmt: skip
        motion = motion if table is None else motion._on_table(table)
        motion._warn_of_left_out()
        return motion

    def _on_table(self, table: LoadTable) -> StructureMotion:
        """Return the motion with a base table, whose acceleration is a load."""
        base_pieces = table._base_pieces()[:, 0]
        times = np.asarray(table.times)
        bent = np.asfortranarray(-derivative(derivative(base_pieces[np.newaxis])))
        loads = [(self.loaded._inertia, (times, bent))]
        if self.mount._held is not None:
            loads += self.mount._held.pulls_of(times, base_pieces)
        patterns, breaks, pieces = self.patterns, self.breaks, self.pieces
        for push, (at, load) in loads:
            if not load.any():
                continue
            if breaks.size < 2:
                patterns, breaks, pieces = push[:, np.newaxis], at, load
            else:
                k = pieces.shape[0]
                wide = np.concatenate([pieces, np.zeros((1, *pieces.shape[1:]))])
                inert = np.concatenate([np.zeros((k, *load.shape[1:])), load])
                breaks, pieces = added((breaks, wide), (at, inert))
                patterns = np.column_stack([patterns, push])
        return replace(
            self, patterns=patterns, breaks=breaks, pieces=pieces, table=table, base_breaks=times,
            base_pieces=base_pieces,
        )  # fmt: skip

    @property
    def travel(self) -> float:
        """Upper bound of the displacement of the base."""
        table = 0.0 if self.table is None else float(np.abs(np.asarray(self.table.values)).max())
        return float(np.abs(self.loaded.base).sum()) + table

    def base_at(self, t: float) -> float:
        """Displacement of the base."""
        return self.base_state(t)[0]

    def base_state(self, t: float) -> tuple[float, float]:
        """Displacement and velocity of the base, after a corner."""
        place, speed, _ = self.base_motion(np.array([t]))
        return float(place[0]), float(speed[0])

    @cached_property
    def modal(self) -> dict[str, Any]:
        """Arrays of the structure, its load and its start in modes, for the core."""
        return modal_arrays(self)

    def _warn_of_left_out(self) -> None:
        """Warn of a start that the modes do not contain."""
        place, speed = self.base_state(0.0) if self.moves_base else (0.0, 0.0)
        if not (self.start.any() or self.speed.any() or place or speed):
            return
        rest, modal = self.loaded.condensation.rest, self.modal
        for name, column, given in (
            ("displacements", "start", self.start), ("velocities", "start_rates", self.speed),
        ):  # fmt: skip
            held, size = np.zeros(given.size), np.abs(given)
            if rest.squares.size:
                held += rest.shapes @ modal[column]
                size += np.abs(rest.shapes) @ np.abs(modal[column])
            if rest.poles.size:
                kept = rest.poles.imag >= 0
                twice = np.where(rest.poles[kept].imag > 0, 2.0, 1.0)
                z = modal["start_others"] * (1.0 if column == "start" else modal["poles"])
                z = z[: twice.size]
                held += (rest.left[:, kept] @ (twice * z)).real
                size += np.abs(rest.left[:, kept]) @ np.abs(twice * z)
            b = self.mount._base_direction
            if b is not None:
                held += b * (place if column == "start" else speed)
            # Coordinates without mass ignore their initial values.
            left = float(np.abs(given - held)[~self.follows].max(initial=0.0))
            if left > _LEFT_OUT * float(size.max()):
                warnings.warn(
                    f"initial: {left:.2g} of the {name} is not contained in the modes of this "
                    "structure, and is omitted",
                    ConvergenceWarning,
                    stacklevel=caller(),
                )

    @cached_property
    def _given(self) -> _native.Handle:
        """Tables and past in the core."""
        return _native.Handle(
            "motion given", breaks=self.breaks, pieces=self.pieces, base_breaks=self.base_breaks,
            base_pieces=self.base_pieces, held=self.held, before=self.before, moved=self.moved,
        )  # fmt: skip

    @cached_property
    def _modes(self) -> tuple[_native.Handle, _native.Handle]:
        """Elements, and the linear subsystem with its loads, in the core."""
        return modes_in_core(self.modal)

    @property
    def moves_base(self) -> bool:
        """True if the base moves."""
        return self.table is not None or bool(self.loaded.base.any())

    @cached_property
    def follows(self) -> npt.NDArray[np.bool_]:
        """Coordinates without mass, shape (n,)."""
        mass: Any = self.mount.mass
        return np.asarray(np.asarray(abs(mass).sum(axis=1)).ravel() == 0)

    @property
    def first_kept(self) -> FloatArray:
        """Initial values kept: given coordinates, and deflections of the elements."""
        directions = self.loaded.condensation.laws.directions
        place, speed = self.base_state(0.0) if self.moves_base else (0.0, 0.0)
        b = 0.0 if self.mount._base_direction is None else self.mount._base_direction
        u, v = self.start - place * b, self.speed - speed * b
        return np.stack(
            [
                np.concatenate([self.start[self.places], directions.T @ u]),
                np.concatenate([self.speed[self.places], directions.T @ v]),
            ],
            axis=1,
        ).ravel()

    def first_steps(self) -> int:
        """First number of steps of the step size search.

        The modes are exact, so the steps resolve the loads, and the frequency at which stiffness
        and inertia of the deflections are equal.
        """
        found = _native.run(
            "motion first steps", *self._modes, self._given, nodes=NODES[self.method],
            end=float(self.end),
        )  # fmt: skip
        return int(found["first"])

    #: The equations are those with memory, of modes.
    remembers_all: ClassVar[bool] = True

    @property
    def system(self) -> Condensed:
        """The structure."""
        return self.mount

    @property
    def chosen(self) -> dict[str, Any]:
        """What the core chooses for other motions: the latest time of a continued run."""
        return {"reach": REACH * self.end}

    @property
    def remembers(self) -> bool:
        """True if an element or layer has memory."""
        return bool(self.mount._all_kernels)

    @cached_property
    def acting(self) -> dict[str, Any]:
        """The loads on all coordinates, with the inertia of what is relative to the base."""
        loaded, w = self.loaded, self.frequencies
        forces = loaded.forces + np.outer(loaded._inertia, w**2 * loaded.base)
        found: dict[str, Any] = {"frequencies": w, "amplitudes": np.asfortranarray(forces)}
        if self.breaks.size > 1:
            pieces = np.einsum("nk,kpb->npb", self.patterns, self.pieces)
            found |= {"breaks": self.breaks, "pieces": np.asfortranarray(pieces)}
        b = self.mount._base_direction
        if b is None or not self.moves_base:
            return found
        found["waves"] = np.asfortranarray(np.outer(b, loaded.base))
        return found | ({"direction": b} | self._on_base if self.table is not None else {})

    @property
    def _on_base(self) -> dict[str, Any]:
        """The table of the base."""
        if self.table is None:
            return {}
        return {"base_breaks": self.base_breaks, "base_pieces": self.base_pieces[:, np.newaxis]}

    def base_motion(self, t: FloatArray) -> tuple[FloatArray, ...]:
        """Displacement, velocity and acceleration of the base, each (n,), after corners."""
        return base_along(self.frequencies, self.loaded.base, self._on_base, t)

    @property
    def past(self) -> dict[str, Any] | None:
        """What came before t = 0; None: nothing remembers it."""
        return {"before": self.before, "moved": self.whole_past} if self.remembers else None

    @property
    def whole(self) -> PolynomialSystem:
        """The system in all its coordinates."""
        system: Any = self.mount
        if not system._is_condensed:
            return system  # type: ignore[no-any-return]
        note = lacks_wholeness(system)
        if note is not None:
            raise InputError(f"acceleration: {note}")
        return whole_system(system)

    def runs(self, tolerance: float) -> Callable[[float], Run]:
        """Return a function that creates a run with a step size."""
        return partial(StructureRun, self, tolerance)


class StructureRun(OscillatorRun):
    """A run of a structure."""

    motion: Any

    def __init__(self, motion: StructureMotion, tolerance: float, h: float) -> None:
        super().__init__(motion, tolerance, h, motion.first_kept)
        self.moves = None
        #: Jumps of base position and velocity at the start of new loads.
        self.kick = np.zeros(2)
        if motion.follows.any():
            # The core computes the initial positions of coordinates without mass.
            self.state = self.compute(ONE_RUN, 0, Wanted(keep="last"), 0.0)["last"]

    def _run_values(self) -> dict[str, Any]:
        """Values as of other runs with memory; deflections are not compared."""
        return super()._run_values() | {"rows": self._compared + 1}

    @property
    def _compared(self) -> npt.NDArray[np.intp]:
        """Indices of the coordinates, without deflections."""
        return np.arange(2 * self.motion.places.size)

    def _shaped(self, run: Trajectory) -> Trajectory:
        """The result with the selected coordinates and the deflections."""
        run = super()._shaped(run)
        motion, own = self.motion, 2 * self.motion.places.size
        return with_deflections(
            run, motion.mount, motion.places, np.arange(own), run.state[:, own::2],
            run.state[:, own + 1 :: 2],
        )  # fmt: skip

    def acting(self) -> tuple[_native.Handle, dict[str, Any], dict[str, Any] | None]:
        """The structure in all its coordinates, its loads and its past."""
        motion = self.motion
        return _native.polynomial_object(motion.whole._vector), motion.acting, motion.past

    def _base_motion(self, t: FloatArray) -> tuple[FloatArray, ...]:
        return tuple(self.motion.base_motion(t))

    def accelerations(self, kept: Trajectory) -> FloatArray:
        """Of the coordinates that are kept, from a run that keeps all of them."""
        return super().accelerations(kept)[:, self.motion.places]

    def along(self, kept: Trajectory) -> KnownMotion:
        """As of other runs, of all coordinates."""
        whole = self._of_all()
        states = kept.state.T if whole is self else whole.repeat(kept.t, kept)["states"]
        return whole._along(kept, {"states": states})

    def _of_all(self) -> StructureRun:
        """The same run, which keeps all coordinates."""
        n = self.motion.start.size
        if self.motion.places.size == n:
            return self
        self.motion.whole  # noqa: B018

        other = copy(self)
        other.motion = replace(self.motion, places=np.arange(n))
        other.begin = other.motion.first_kept
        other.parts = tuple(part._of_all() for part in self.parts if isinstance(part, StructureRun))
        return other

    def adopt(self, earlier: Run) -> None:
        """Continue from the end of an earlier run, with the loads of this run."""
        super().adopt(earlier)
        assert isinstance(earlier, StructureRun)
        old = np.array(earlier.motion.base_state(self.time))
        self.kick = old - np.array(self.motion.base_state(self.time))

    def _plan(self, **steps: Any) -> str:
        motion, loaded = self.motion, self.motion.loaded
        moving = bool(motion.start.any() or motion.speed.any() or motion.before.size > 1)
        lines = self._plan_of(
            loaded._handle, orders=loaded.job[5], series=loaded.job[6],
            initial=np.full(2 * loaded.condensation.q, float(moving)), held=motion.held, **steps,
        ).splitlines()  # fmt: skip
        nodes = NODES[self.method]
        lines[0] = (
            f"computes: motion to t = {steps['t_end']:g} by {self.method}, forces of elements at "
            f"{things(nodes, 'node')} per step, modes exactly"
        )
        lines.insert(1, f"computes: {loaded.note}")
        return "\n".join(lines)

    def _given(self) -> tuple[str, tuple[_native.Handle, ...], dict[str, Any]]:
        """Task, handles and values for a structure."""
        values = {"nodes": NODES[self.method], "t_end": self.reach, "kick": self.kick}
        return "motion of structure", (*self.motion._modes, self.motion._given), values


def modes_in_core(modal: dict[str, Any]) -> tuple[_native.Handle, _native.Handle]:
    """Elements, and the linear subsystem with its loads, as objects of the core."""
    rest = {name: value for name, value in modal.items() if name != "elements"}
    return _native.polynomial_object(modal["elements"]), _native.Handle("motion given", **rest)


def structure_motion_of(run: Run) -> StructureMotion | None:
    """The motion of a run of a structure, or None."""
    return run.motion if isinstance(run, StructureRun) else None
