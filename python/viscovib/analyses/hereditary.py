"""Motions with memory: checked arguments of a run of a mount, and its steps."""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.analyses.acting import EarlierMotion, Loads
from viscovib.analyses.mount_loads import inertia_of, sinusoids
from viscovib.analyses.runs import MAX_STEPS, Run, nothing, starting_state
from viscovib.common.past import Past
from viscovib.errors import InputError, StabilityWarning, caller
from viscovib.kernels.relaxation import AbelKernel, PronyKernel, RzhanitsynKernel
from viscovib.systems.load import LoadLike
from viscovib.systems.load_table import LoadTable, added
from viscovib.systems.oscillators import Oscillator, check_oscillator

#: Nodes per step, and steps per fastest period at the start of the step size search.
NODES = {"gauss2": 2, "gauss3": 3, "gauss4": 4, "gauss6": 6, "gauss8": 8}
FIRST = {"gauss2": 12, "gauss3": 8, "gauss4": 6, "gauss6": 3, "gauss8": 2}
#: Methods for the past, by their index in the core.
PASTS = ("exponentials", "direct")
#: Largest number of steps for which the whole past is kept by default.
_DIRECT_STEPS = 20_000
#: Largest continued time of a run in units of its end; sums of exponentials are fitted for it.
_REACH = 100.0
#: Kernels whose weights need no quadrature, and their largest number of parameters.
_CLOSED, _FEW = {kind._kind for kind in (AbelKernel, PronyKernel, RzhanitsynKernel)}, 50
#: A time that represents infinity (s).
EVER = 1e30
#: Coordinates that move, by the system and those that are driven.
_moving: WeakKeyDictionary[_native.Handle, dict[bytes, npt.NDArray[np.int32]]] = WeakKeyDictionary()


@dataclass(frozen=True)
class MountMotion:
    """A requested motion of a mount: all data except the step size."""

    mount: Oscillator
    end: float
    state: FloatArray
    method: str
    frequencies: FloatArray
    amplitudes: ComplexArray
    base: ComplexArray
    breaks: FloatArray
    pieces: FloatArray
    held: FloatArray
    before: FloatArray
    moved: FloatArray
    memory: str
    #: Flags of the coordinates that move, and the load as given.
    moves: npt.NDArray[np.int32]
    series: tuple[npt.NDArray[np.int32], ComplexArray]
    #: A table of base displacements, its times and polynomials; a single time: no table.
    table: LoadTable | None = None
    base_breaks: FloatArray = field(default_factory=lambda: np.zeros(1))
    base_pieces: FloatArray = field(default_factory=lambda: np.zeros((4, 1, 1), order="F"))

    @classmethod
    def checked(
        cls,
        mount: Oscillator,
        end: float,
        initial: npt.ArrayLike | None,
        method: str,
        load: LoadLike | None,
        nu: float | None,
        base: LoadLike | LoadTable | None,
        force: LoadTable | None,
        held: npt.ArrayLike | Past | None,
        memory: str,
    ) -> "MountMotion":
        """Check the arguments of ``simulate`` for a mount."""
        n = len(mount.dof_names)
        before, moved = history_of(held, n)
        first = moved[:, 0]
        if initial is None:
            state = np.zeros(2 * n)
            state[::2] = moved[:, -1]
        else:
            state = starting_state(initial, n, mount.dof_names)
        name = _native.choice("method", method, ("auto", *NODES))
        name = "gauss8" if name == "auto" else name
        _native.choice("memory", memory, ("auto", *PASTS))
        table = base if isinstance(base, LoadTable) else None
        waved = None if isinstance(base, LoadTable) else base
        check_oscillator(mount, base)
        frequencies, amplitudes, waves, series = sinusoids(mount, load, nu, waved)
        breaks, pieces = table_of(force, n)
        warn_of_slow_mode(mount)
        driven: npt.NDArray[np.bool_] = (amplitudes != 0).any(axis=1) | (moved != 0).any(axis=1)
        driven |= pieces.any(axis=(1, 2)) | state.reshape(n, 2).any(axis=1)
        motion = cls(
            mount, end, state, name, frequencies, amplitudes, waves, breaks, pieces, first, before,
            moved, memory, moving(mount, driven), series,
            base_pieces=nothing(4 * waves.shape[0]).reshape(4, -1, 1),
        )  # fmt: skip
        if base is None:
            return motion
        if table is not None:
            motion = motion._on_table(table)
        # Coordinates at rest move relative to the base.
        moved = np.hstack([motion.base, *motion.base_pieces])
        driven |= (motion._directions @ moved).any(axis=1)
        return replace(motion, moves=moving(mount, driven))

    def _on_table(self, table: LoadTable) -> "MountMotion":
        """Return the motion with a base table, whose acceleration is a load."""
        n = len(self.mount.dof_names)
        names = getattr(self.mount, "_base_names", ()) if table._columned else ()
        base_pieces = table._base_pieces(len(names), n)
        if names:
            self.mount._check_base_motion(base_pieces.max(axis=0))  # type: ignore[union-attr]
        times = np.asarray(table.times)
        moved = np.moveaxis(base_pieces, 1, 0)
        if not names:
            moved = np.einsum("dq,pqt->dpt", self._directions, base_pieces)
        load = inertia_of(self.mount, times, moved)
        loaded = times
        if load.shape[2] > times.size:
            loaded = np.concatenate([[times[0] - EVER], times, [times[-1] + EVER]])
        breaks, pieces = self.breaks, self.pieces
        if load.any():
            breaks, pieces = (
                (loaded, load) if breaks.size < 2 else added((breaks, pieces), (loaded, load))
            )
        still = np.zeros((base_pieces.shape[1], self.frequencies.size), complex, order="F")
        return replace(
            self, breaks=breaks, pieces=pieces, table=table, base_breaks=times,
            base_pieces=base_pieces, base=still,
        )  # fmt: skip

    @property
    def _directions(self) -> FloatArray:
        """Motion of the coordinates per unit displacement of the base, shape (n, q)."""
        n = len(self.mount.dof_names)
        if self.base.shape[0] > 1:
            return np.eye(n)
        direction = self.mount._base_direction
        return (np.zeros(n) if direction is None else direction)[:, np.newaxis]

    @property
    def travel(self) -> float:
        """Upper bound of the displacement of the base."""
        table = 0.0 if self.table is None else float(np.abs(np.asarray(self.table.values)).max())
        return float(np.abs(self.base).sum()) + table

    def base_at(self, t: float) -> FloatArray:
        """Displacements of the coordinates by the base, shape (n,)."""
        moved = (self.base * np.exp(1j * t * self.frequencies)).imag.sum(axis=1)
        if self.table is not None:
            times = np.asarray(self.table.times)
            placed = np.atleast_1d(self.table(np.clip(t, times[0], times[-1])))
            moved[: placed.size] += placed
        return np.asarray(self._directions @ moved)

    @cached_property
    def acting(self) -> Loads:
        """The loads, with the inertia of what is relative to the base, and its motion."""
        breaks, base, pieces = np.zeros(0), None, np.zeros((0, 4, 0))
        if self.table is not None:
            breaks = self.base_breaks
            pieces = np.einsum("dq,pqt->dpt", self._directions, self.base_pieces)
        if self.table is not None or self.base.any():
            base = self._directions @ self.base
        return Loads(
            self.frequencies, self.amplitudes, self.breaks, self.pieces, base, breaks, pieces
        )

    def base_motion(self, t: FloatArray) -> tuple[FloatArray, ...]:
        """Displacement, velocity and acceleration of a base with one direction, each (n,)."""
        breaks, pieces = np.zeros(0), np.zeros((1, 4, 0))
        if self.table is not None:
            breaks, pieces = self.base_breaks, np.moveaxis(self.base_pieces, 1, 0)
        none = np.zeros((1, self.frequencies.size), complex)
        now = Loads(self.frequencies, none, np.zeros(0), pieces, self.base, breaks, pieces).at(t)
        return now.place[:, 0], now.speed[:, 0], now.push[:, 0]

    @property
    def past(self) -> EarlierMotion | None:
        """What came before t = 0; None: nothing remembers it."""
        return EarlierMotion(self.held, self.before, self.moved) if self.remembers else None

    def first_steps(self) -> int:
        """Number of steps at the start of the step size search."""
        fastest = max(self.mount._fastest(), float(self.frequencies.max()))
        per_period = FIRST[self.method]
        wanted = float(self.end) * fastest * per_period / (2 * math.pi)
        return max(4, math.ceil(min(wanted, 2.0 * MAX_STEPS)))

    @property
    def remembers(self) -> bool:
        """True if a spring has memory."""
        return bool(self.mount._active_kernels)

    @property
    def given(self) -> dict[str, Any]:
        """Loads and past for the core."""
        return {
            "frequencies": self.frequencies, "amplitudes": self.amplitudes,
            "breaks": self.breaks, "pieces": self.pieces, "waves": self.base,
            "base_breaks": self.base_breaks, "base_pieces": self.base_pieces, "held": self.held,
            "before": self.before, "moved": self.moved,
        }  # fmt: skip

    def runs(self, tolerance: float) -> Callable[[float], Run]:
        """Return a function that creates a run with a step size."""
        return partial(MountRun, self, tolerance)


class MountRun(Run):
    """A run of a mount or of a system with the same kind of motion."""

    counts = "iterations"

    def __init__(
        self, motion: Any, tolerance: float, h: float, state: FloatArray | None = None
    ) -> None:
        begin = motion.state if state is None else state
        super().__init__(motion.mount, motion.method, begin, h, tolerance)
        self.motion = motion
        self.resolution = 0.0
        self.past = "exponentials"
        #: Shortest step after kinks and jumps (0: none), and True if the base has kinks.
        self.shortest, self.kinks = 0.0, motion.table is not None
        self.moves: Any = getattr(motion, "moves", None)
        if motion.memory == "direct":
            self.past = "direct"

    @property
    def over_kinks(self) -> bool:
        """True if laws have kinks: the past is known at whole steps only."""
        return self.system._has_kinks

    def adopt(self, earlier: Run) -> None:
        """Continue from the end of an earlier run, with the loads of this run."""
        super().adopt(earlier)
        if not isinstance(earlier, MountRun):
            return
        self.memory, self.past, self.shortest = earlier.memory, earlier.past, earlier.shortest
        self.stale = self.kinks and not earlier.kinks
        self.stale |= self.moves is not None and not np.array_equal(self.moves, earlier.moves)
        self.kinks |= earlier.kinks
        self.resolution = earlier.resolution

    def acting(self) -> tuple[_native.Handle, Loads, EarlierMotion | None]:
        """The oscillator, its loads and its past."""
        motion = self.motion
        return motion.mount._handle, motion.acting, motion.past

    def _plan(self, **steps: Any) -> str:
        motion = self.motion
        orders, series = motion.series
        return self._plan_with_memory(
            motion.mount._handle, orders=orders, series=series, initial=motion.state,
            held=motion.held, **steps,
        )  # fmt: skip

    def _plan_with_memory(self, system: _native.Handle, **given: Any) -> str:
        """Return the plan of the core for a system in nodes."""
        text: str = _native.run(
            "motion plan with memory", system, **given,
            method=tuple(reversed(NODES)).index(self.method) + 1,
            past=2 if self.past == "exponentials" else 3,
        )["text"]  # fmt: skip
        return text

    @property
    def reach(self) -> float:
        """Latest time to which the run may be continued."""
        return float(_REACH * self.motion.end)

    def _takes_long(self, count: int) -> bool:
        """True for many steps, the whole past, or first steps whose weights need quadrature."""
        if self.past != "exponentials" or count > _native.MANY_STEPS:
            return True
        if self.memory is not None and not self.anew:
            return False
        mount = self.motion.mount
        return any(k._kind not in _CLOSED or k._data.size > _FEW for k in mount._all_kernels)

    def check_reach(self, end: float) -> None:
        """Refuse a run that continues beyond the time for which kernels are fitted."""
        if end > self.reach * (1 + 1e-9):
            raise InputError(
                f"t_end = {end:g}: a run made for t_end = {self.motion.end:g} may go on to "
                f"{self.reach:g} at most"
            )

    def _given(self) -> tuple[str, tuple[_native.Handle, ...], dict[str, Any]]:
        """Task, handles and values of the equations of an oscillator."""
        values = {**self.motion.given, "moves": self.moves, **self._order()}
        return "motion with memory", (self.motion.mount._handle,), values

    def _order(self) -> dict[str, Any]:
        """Nodes of a step, and latest time of the equations."""
        return {"nodes": NODES[self.method], "t_end": self.reach}

    def _run_values(self) -> dict[str, Any]:
        """Values of a run with memory."""
        return {
            "most_direct": _DIRECT_STEPS if self.motion.memory == "auto" else 0,
            "later": 0.0 if self.mesh is None else self.mesh.later,
            "past": PASTS.index(self.past) + 1, "shortest": float(self.shortest),
            "kinks": bool(self.kinks),
        }  # fmt: skip

    def take(self, found: dict[str, Any]) -> npt.NDArray[np.bool_] | None:
        """Move to the end of a run; store its resolution, shortest step and kind of past."""
        self.resolution, self.shortest = found["resolution"], found["shortest"]
        self.past = PASTS[found["past"] - 1]
        return super().take(found)


def hereditary_run_of(run: Run) -> MountMotion | None:
    """The motion of a run with memory, or None."""
    return run.motion if isinstance(run, MountRun) else None


@cache
def _no_pieces(n: int) -> FloatArray:
    """Polynomials without a table."""
    pieces = np.zeros((n, 4, 1), order="F")
    pieces.setflags(write=False)
    return pieces


def table_of(force: LoadTable | None, n: int) -> tuple[FloatArray, FloatArray]:
    """Return the times of a table and its polynomials for the core."""
    if force is None:
        return nothing(1), _no_pieces(n)
    if not isinstance(force, LoadTable):
        raise InputError(f"force = {_native.shown(force)}: must be a LoadTable")
    return np.asarray(force.times), force._pieces(n)


def moving(system: Oscillator, driven: npt.NDArray[np.bool_]) -> npt.NDArray[np.int32]:
    """Return 1 for coordinates that are driven or coupled to driven ones, else 0."""
    moves = driven.astype(np.int32)
    if system._turns:
        return np.ones_like(moves)
    if driven.all():
        return moves
    known = _moving.setdefault(system._handle, {})
    key = moves.tobytes()
    if key not in known:
        found = _native.run("motion moving coordinates", system._handle, driven=moves)
        known[key] = np.asarray(found["moves"], dtype=np.int32)
    return known[key]


def history_of(held: npt.ArrayLike | Past | None, n: int) -> tuple[FloatArray, FloatArray]:
    """Return times, ascending to 0, and the displacements at them, shape (n_dof, m)."""
    if held is None:
        return np.zeros(1), np.zeros((n, 1), order="F")
    if not isinstance(held, Past):
        return np.zeros(1), np.asfortranarray(_vector("held", held, n)[:, np.newaxis])
    moved = np.asarray(held.displacements)
    if moved.shape[1] != n:
        raise InputError(f"held: displacements must have {n} columns, got {moved.shape[1]}")
    return np.asarray(held.times), np.asfortranarray(moved.T)


def _vector(name: str, value: npt.ArrayLike, n: int) -> FloatArray:
    vector = _native.real_array(name, value)
    if vector.shape != (n,):
        raise InputError(f"{name}: must have shape ({n},), got {vector.shape}")
    return vector


def warn_of_slow_mode(mount: Oscillator) -> None:
    """Warn that a run does not settle if the integral of a kernel is 1 or more."""
    if all(mount._kernel_scale * kernel.integral < 1 for kernel in mount._active_kernels):
        return
    real = mount.characteristic_roots().real
    rate = f"like exp({real[0]:.4g} t)" if real.size else "slowly"
    warnings.warn(
        f"a slow mode grows {rate}: a run does not settle on the steady response",
        StabilityWarning,
        stacklevel=caller(),
    )
