"""Motions of oscillators in time: arguments, equations as chosen by the core, and runs."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.analyses.acting import KnownMotion, base_along, loads_at
from viscovib.analyses.mount_loads import inertia_of
from viscovib.analyses.runs import Run, nothing, starting_state
from viscovib.common.parameters import no_frequency
from viscovib.common.past import Past
from viscovib.errors import InputError, StabilityWarning, caller
from viscovib.kernels.relaxation import AbelKernel, PronyKernel, RzhanitsynKernel
from viscovib.results.trajectory import Trajectory
from viscovib.systems.load import (
    LoadLike,
    load_series,
    oscillator_series,
)
from viscovib.systems.load_table import LoadTable, added
from viscovib.systems.oscillators import Oscillator, check_oscillator

#: Methods of equations with memory: nodes per step.
NODES = {"gauss2": 2, "gauss3": 3, "gauss4": 4, "gauss6": 6, "gauss8": 8}
#: Methods of equations without memory by their index in the core.
METHODS = {
    name: place
    for place, name in enumerate(
        ("gauss8", "gauss16", "gauss2", "gauss3", "rk4", "dop8", "verner8", "verner9"), start=1
    )
}
#: All methods.
EVERY_METHOD = tuple(dict.fromkeys(("auto", *METHODS, *NODES)))
#: Methods for the past, by their index in the core.
PASTS = ("exponentials", "direct")
#: Kinds of equations by their number in the core.
WITHOUT_MEMORY, WITH_MEMORY, BY_MODES = 1, 2, 3
#: Largest number of coordinates of smooth systems that are not condensed, as in the core.
MOST_WHOLE = 64
#: Largest number of steps for which the whole past is kept by default.
_DIRECT_STEPS = 20_000
#: Largest continued time of a run in units of its end; sums of exponentials are fitted for it.
REACH = 100.0
#: Kernels whose weights need no quadrature, and their largest number of parameters.
_CLOSED, _FEW = {kind._kind for kind in (AbelKernel, PronyKernel, RzhanitsynKernel)}, 50
#: A time that represents infinity (s).
EVER = 1e30
#: Largest frequency of a base, whose square has a value (rad/s).
_FASTEST_BASE = 1e154


@dataclass(eq=False)
class OscillatorMotion:
    """A requested motion of an oscillator: all data except the step size."""

    #: Class of its runs.
    run_type: ClassVar[Callable[..., Run]]
    system: Oscillator
    end: float
    state: FloatArray
    method: str
    memory: str
    #: Periodic load with the motion of the base, as of `oscillator_series`, and its frequency.
    orders: npt.NDArray[np.int32]
    series: ComplexArray
    nu: float
    breaks: FloatArray
    pieces: FloatArray
    #: Times before the start, and the displacements at them.
    before: FloatArray
    moved: FloatArray
    #: True if a displacement before the start was given; True if the base moves.
    is_held: bool
    moves_base: bool
    #: A table of base displacements, its times and polynomials; a single time: no table.
    table: LoadTable | None
    base_breaks: FloatArray
    base_pieces: FloatArray
    #: What the core has chosen: the kind of equations, the coordinates that move, ...
    chosen: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def checked(
        cls,
        system: Oscillator,
        end: float,
        initial: npt.ArrayLike | None,
        method: str,
        load: LoadLike | None,
        nu: float | None,
        base: LoadLike | LoadTable | None,
        force: LoadTable | None,
        held: npt.ArrayLike | Past | None,
        memory: str,
    ) -> Self:
        """Check the arguments of ``simulate`` for an oscillator; its equations are not chosen."""
        n = len(system.dof_names)
        before, moved = history_of(held, n)
        if initial is not None:
            state = starting_state(initial, n, system.dof_names)
        else:
            state = np.zeros(2 * n)
            if held is not None:
                state[::2] = moved[:, -1]
        if type(method) is not str or method not in EVERY_METHOD:
            _native.choice("method", method, EVERY_METHOD)
        if type(memory) is not str or memory != "auto":
            _native.choice("memory", memory, ("auto", *PASTS))
        table = base if isinstance(base, LoadTable) else None
        orders, series, frequency = _periodic(system, load, nu, base)
        breaks, pieces = table_of(force, n)
        if system._active_kernels:
            warn_of_slow_mode(system)
        motion = cls(
            system, end, state, method, memory, orders, series, frequency, breaks, pieces, before,
            moved, held is not None, base is not None, table, nothing(1), _at_rest(),
        )  # fmt: skip
        return motion if table is None else motion._on_table(table)

    def with_equations(self, kind: int = 0, *, may_have_modes: bool = False) -> Self:
        """Return the motion with the equations that the core chooses, or of the given kind."""
        more = {"equations": kind} if kind else {}
        chosen = _native.run(
            "motion equations", self.system._handle, method=self.method, memory=self.memory,
            t_end=float(self.end), is_held=self.is_held, may_have_modes=may_have_modes,
            initial=self.state, **self._loads, **more,
        )  # fmt: skip
        self.chosen = chosen
        return self

    def after(self, before: "OscillatorMotion") -> Self:
        """Return the motion with the history of an earlier motion under other loads."""
        chosen = self.chosen | {"reach": before.chosen["reach"]}
        if self.remembers_all:
            chosen["moves"] = self.chosen["moves"] | before.chosen["moves"]
        return replace(
            self, before=before.before, moved=before.moved, is_held=before.is_held, chosen=chosen
        )

    def _on_table(self, table: LoadTable) -> Self:
        """Return the motion with a base table, whose acceleration is a load."""
        n = len(self.system.dof_names)
        names = getattr(self.system, "_base_names", ()) if table._columned else ()
        base_pieces = table._base_pieces(len(names), n)
        if names:
            self.system._check_base_motion(base_pieces.max(axis=0))  # type: ignore[union-attr]
        times = np.asarray(table.times)
        moved = np.moveaxis(base_pieces, 1, 0)
        if not names:
            moved = np.einsum("dq,qpt->dpt", self._direction, moved)
        load = inertia_of(self.system, times, moved)
        loaded = times
        if load.shape[2] > times.size:
            loaded = np.concatenate([[times[0] - EVER], times, [times[-1] + EVER]])
        breaks, pieces = self.breaks, self.pieces
        if load.any():
            breaks, pieces = (
                (loaded, load) if breaks.size < 2 else added((breaks, pieces), (loaded, load))
            )
        return replace(
            self, breaks=breaks, pieces=pieces, base_breaks=times, base_pieces=base_pieces
        )

    @property
    def _direction(self) -> FloatArray:
        """Motion of the coordinates per unit displacement of the base, shape (n, 1)."""
        return np.asarray(self.system._base_direction)[:, np.newaxis]

    @property
    def travel(self) -> float:
        """Upper bound of the displacement of the base."""
        table = 0.0 if self.table is None else float(np.abs(np.asarray(self.table.values)).max())
        return table + float(np.abs(self.acting.get("waves", 0.0)).sum())

    def base_at(self, t: float) -> FloatArray:
        """Displacements of the coordinates by the base, shape (n,)."""
        if self.table is not None:
            t = float(np.clip(t, self.base_breaks[0], self.base_breaks[-1]))
        return np.asarray(loads_at(self.acting, np.array([t]))["place"][0])

    @cached_property
    def acting(self) -> dict[str, Any]:
        """The loads, with the inertia of what is relative to the base, and its motion."""
        found = _native.run(
            "motion loads", self.system._handle, orders=self.orders, series=self.series, nu=self.nu
        )
        if not self.moves_base:
            del found["waves"]
        if self.breaks.size > 1:
            found |= {"breaks": self.breaks, "pieces": self.pieces}
        if self.table is not None:
            found |= self._on_base
            if self.base_pieces.shape[1] != len(self.system.dof_names):
                found["direction"] = self._direction[:, 0]
        return found

    @property
    def _on_base(self) -> dict[str, Any]:
        """The table of the base."""
        if self.table is None:
            return {}
        return {"base_breaks": self.base_breaks, "base_pieces": self.base_pieces}

    def base_motion(self, t: FloatArray) -> tuple[FloatArray, ...]:
        """Displacement, velocity and acceleration of a base with one direction, each (n,)."""
        frequencies = np.asarray(self.orders * self.nu)
        return base_along(frequencies, self.series[-1], self._on_base, t)

    @property
    def remembers_all(self) -> bool:
        """True if the equations are those with memory."""
        return bool(self.chosen["equations"] == WITH_MEMORY)

    @property
    def past(self) -> dict[str, Any] | None:
        """What came before t = 0; None: nothing remembers it."""
        return {"before": self.before, "moved": self.moved} if self.remembers else None

    @property
    def remembers(self) -> bool:
        """True if a force has memory."""
        system: Any = self.system
        if system._active_kernels:
            return True
        # Kernels of all coordinates of a structure are in its vector only.
        return bool(getattr(system, "_has_hidden_forces", False) and system._flat[3])

    @property
    def _loads(self) -> dict[str, Any]:
        """Loads and past for the core, as far as there are any."""
        given: dict[str, Any] = {"orders": self.orders, "series": self.series, "nu": self.nu}
        if self.breaks.size > 1:
            given |= {"breaks": self.breaks, "pieces": self.pieces}
        given |= self._on_base
        if self.is_held:
            given |= {"held": self.moved[:, 0], "before": self.before, "moved": self.moved}
        return given

    @cached_property
    def given(self) -> dict[str, Any]:
        """Loads, past and equations for the core."""
        chosen = self.chosen
        return self._loads | {name: chosen[name] for name in ("equations", "method", "reach")}

    def runs(self, tolerance: float) -> Callable[[float], Run]:
        """Return a function that creates a run with a step size."""
        if not self.chosen["method"]:
            _native.choice("method", self.method, ("auto", *NODES))
        return partial(self.run_type, self, tolerance)


def _periodic(
    system: Oscillator, load: LoadLike | None, nu: float | None, base: Any
) -> tuple[npt.NDArray[np.int32], ComplexArray, float]:
    """Return the orders and coefficients of the loads, and their frequency."""
    n = len(system.dof_names)
    if base is None and (load is None or type(load) is float):
        orders, series = load_series(load, None, n)
        if load is None and nu is not None:
            raise InputError("nu: must not be given without load or base")
    else:
        waved = None if isinstance(base, LoadTable) else base
        if base is not None:
            check_oscillator(system, base)
        if load is None is waved and nu is not None:
            raise InputError("nu: must not be given without load or base")
        orders, series = oscillator_series(system, load, waved)[:2]
    frequency = 0.0 if nu is None else _native.number("nu", nu)
    if frequency <= 0 and (frequency < 0 or (orders != 0)[series.any(axis=0)].any()):
        raise no_frequency(nu if nu is None else frequency)
    if base is not None and frequency * float(np.abs(orders).max()) > _FASTEST_BASE:
        raise InputError(f"nu: {frequency:.3g} rad/s of a moving base is beyond all range")
    return orders, series, frequency


class OscillatorRun(Run):
    """A run of an oscillator, by equations without memory or with memory."""

    #: True if only the equations of the run itself give accelerations.
    always_repeats: ClassVar[bool] = False

    def __init__(
        self, motion: Any, tolerance: float, h: float, state: FloatArray | None = None
    ) -> None:
        begin = motion.state if state is None else state
        method = "gauss8" if motion.method == "auto" else motion.method
        super().__init__(motion.system, method, begin, h, tolerance)
        self.motion: Any = motion
        #: True if the equations are those with memory.
        self.by_nodes = bool(motion.remembers_all)
        self.counts = "iterations" if self.by_nodes else "evaluations"
        self.resolution = 0.0 if self.by_nodes else None
        self.past = "direct" if motion.memory == "direct" else "exponentials"
        #: Shortest step after kinks and jumps (0: none), and True if the base has kinks.
        self.shortest, self.kinks = 0.0, motion.table is not None
        self.moves: Any = motion.chosen.get("moves")

    @property
    def over_kinks(self) -> bool:
        """True if laws have kinks: the past is known at whole steps only."""
        return self.by_nodes and self.system._has_kinks

    @property
    def has_layers(self) -> bool:
        """True if the system has laws that are not polynomials."""
        return not self.by_nodes and any(not law.state for law in self.system._all_laws)

    def adopt(self, earlier: Run) -> None:
        """Continue from the end of an earlier run, with the loads of this run."""
        super().adopt(earlier)
        if not isinstance(earlier, OscillatorRun) or earlier.by_nodes != self.by_nodes:
            return
        self.memory, self.past, self.shortest = earlier.memory, earlier.past, earlier.shortest
        if not self.by_nodes:
            return
        self.stale = self.kinks and not earlier.kinks
        self.stale |= self.moves is not None and not np.array_equal(self.moves, earlier.moves)
        self.kinks |= earlier.kinks
        self.resolution = earlier.resolution

    @property
    def switched(self) -> FloatArray:
        """States of elements and signs of surfaces, stored by the core after the method's data."""
        return np.empty(0) if self.memory is None else self.memory[int(self.memory[-1]) : -3]

    def acting(self) -> tuple[_native.Handle, dict[str, Any], dict[str, Any] | None]:
        """The oscillator, its loads and its past."""
        motion = self.motion
        return motion.system._handle, motion.acting, motion.past

    def along(self, kept: Trajectory) -> KnownMotion:
        """As of other runs; on surfaces of laws by the equations of the side that it is on."""
        remembers = self.motion.past is not None
        if self.by_nodes or not (self.always_repeats or self.switched.size or remembers):
            return super().along(kept)
        return self._along(kept, self.repeat(kept.t, kept, accelerates=True))

    @property
    def power(self) -> Callable[[FloatArray, FloatArray], FloatArray] | None:
        """Power of load and damping; None: not available."""
        return None if self.by_nodes or self.motion.moves_base else self._power

    def _power(self, t: FloatArray, state: FloatArray) -> FloatArray:
        v = state[:, 1::2]
        force, system = loads_at(self.motion.acting, t)["load"], self.motion.system
        return np.asarray(np.einsum("ta,ta->t", v, force - v @ system._damping.T))

    def _plan(self, **steps: Any) -> str:
        motion = self.motion
        return self._plan_of(
            motion.system._handle, orders=motion.orders, series=motion.series,
            initial=self.begin, held=motion.moved[:, 0], **steps,
        )  # fmt: skip

    def _plan_of(self, system: _native.Handle, **given: Any) -> str:
        """Return the plan of the core for a system."""
        methods = tuple(reversed(NODES)) if self.by_nodes else tuple(METHODS)
        text: str = _native.run(
            "motion plan of oscillator", system, **given,
            equations=WITH_MEMORY if self.by_nodes else WITHOUT_MEMORY, reach=self.reach,
            method=methods.index(self.method) + 1, past=2 if self.past == "exponentials" else 3,
        )["text"]  # fmt: skip
        return text

    @property
    def reach(self) -> float:
        """Latest time to which the run may be continued."""
        return float(self.motion.chosen["reach"])

    def _takes_long(self, count: int) -> bool:
        """True for many steps, the whole past, or first steps whose weights need quadrature."""
        if count > _native.MANY_STEPS or not self.by_nodes:
            return count > _native.MANY_STEPS
        if self.past != "exponentials":
            return True
        if self.memory is not None and not self.anew:
            return False
        kernels = self.motion.system._all_kernels
        return any(k._kind not in _CLOSED or k._data.size > _FEW for k in kernels)

    def check_reach(self, end: float) -> None:
        """Refuse a run that continues beyond the time for which kernels are fitted."""
        if end > self.reach * (1 + 1e-9) and (self.by_nodes or self.motion.chosen["fitted"]):
            raise InputError(
                f"t_end = {end:g}: a run made for t_end = {self.reach / REACH:g} may go on to "
                f"{self.reach:g} at most"
            )

    def _given(self) -> tuple[str, tuple[_native.Handle, ...], dict[str, Any]]:
        """Task, handles and values of the equations of an oscillator."""
        motion = self.motion
        return "motion of oscillator", (motion.system._handle,), {
            **motion.given, "moves": self.moves
        }  # fmt: skip

    def _run_values(self) -> dict[str, Any]:
        """Values of a run with memory."""
        if not self.by_nodes:
            return {}
        return {
            "most_direct": _DIRECT_STEPS if self.motion.memory == "auto" else 0,
            "later": 0.0 if self.mesh is None else self.mesh.later,
            "past": PASTS.index(self.past) + 1, "shortest": float(self.shortest),
            "kinks": bool(self.kinks),
        }  # fmt: skip

    def take(self, found: dict[str, Any]) -> npt.NDArray[np.bool_] | None:
        """Move to the end of a run; store its resolution, shortest step and kind of past."""
        if self.by_nodes:
            self.resolution, self.shortest = found["resolution"], found["shortest"]
            self.past = PASTS[found["past"] - 1]
        return super().take(found)


OscillatorMotion.run_type = OscillatorRun


@cache
def _nothing_before(n: int) -> FloatArray:
    """Displacements of n coordinates before the start."""
    moved = np.zeros((n, 1), order="F")
    moved.setflags(write=False)
    return moved


@cache
def _at_rest() -> FloatArray:
    """Polynomials of a base without a table."""
    pieces = np.zeros((4, 1, 1), order="F")
    pieces.setflags(write=False)
    return pieces


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


def history_of(held: npt.ArrayLike | Past | None, n: int) -> tuple[FloatArray, FloatArray]:
    """Return times, ascending to 0, and the displacements at them, shape (n_dof, m)."""
    if held is None:
        return nothing(1), _nothing_before(n)
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
