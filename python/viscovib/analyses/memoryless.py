"""Motions without memory, or with exponentials as coordinates, by methods for ODEs."""

import math
from collections.abc import Callable, Mapping
from functools import cache, partial
from typing import Any, ClassVar, TypeGuard

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.acting import EarlierMotion, KnownMotion, Loads
from viscovib.analyses.hereditary import (
    EVER,
    NODES,
    MountMotion,
    moving,
    table_of,
    warn_of_slow_mode,
)
from viscovib.analyses.runs import (
    MAX_STEPS,
    Run,
    ThinLayers,
    nothing,
    starting_state,
)
from viscovib.common.parameters import MAX_HARMONICS, no_frequency
from viscovib.common.past import Past
from viscovib.errors import InputError
from viscovib.results.trajectory import Trajectory
from viscovib.systems.load import LoadLike, load_series, name_places
from viscovib.systems.load_table import LoadTable
from viscovib.systems.mount import Mount
from viscovib.systems.pendulum import Pendulum
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.whole import MOST_IN_FRAME, MOST_WITH_MEMORY, n_hidden

#: Explicit methods by their index in the core.
EXPLICIT = {"rk4": 1, "dop8": 2, "verner8": 3, "verner9": 4}
#: Taylor's method by its order, only for many motions together.
TAYLOR = {"taylor8": 7, "taylor12": 8, "taylor16": 9, "taylor20": 10, "taylor24": 11}
#: Methods for many motions together.
SIDE_BY_SIDE = EXPLICIT | {"gauss8": 5, "gauss16": 6} | TAYLOR
#: All methods for single runs by their index in the core.
METHODS = {"gauss8": 1, "gauss16": 2, "gauss2": 3, "gauss3": 4} | {
    name: place + 4 for name, place in EXPLICIT.items()
}
#: Methods of systems without memory; the last ones are those of systems with memory.
_EVERY_METHOD = tuple({"auto": 0} | METHODS | NODES)
#: Largest number of coordinates for explicit methods: the size of a vector lane of the core.
MAX_DOF = 6
#: Methods for more coordinates, with modes of the linear subsystem.
IN_SECTIONS = ("gauss8", "gauss2", "gauss3")
#: Methods with memory at switches: partial steps after a switch double their length.
REMEMBERING = ("gauss8",)
#: Allowed values of ``memory`` for these motions.
AS_COORDINATES = ("auto", "exponentials")
#: Where the numbers of a system count its kernels; of structures they stand in elements alone.
_N_KERNELS = 3
#: Largest continued time of a run in units of its end; sums of exponentials are fitted for it.
_REACH = 100.0


def pendulum_runs(
    system: Pendulum,
    end: float,
    initial: npt.ArrayLike | None,
    method: str,
    solved: float,
) -> tuple[Callable[[float], Run], int]:
    """Return a function that creates a run with a step size, and the first number of steps."""
    if initial is None:
        raise InputError("initial: must be given (or resume)")
    state = checked_state("initial", initial, (6,))
    name = _native.choice("method", method, ("auto", *METHODS))
    name = "gauss8" if name == "auto" else name
    return partial(_PendulumRun.of, system, name, state, solved), first_steps(system, end)


def checked_state(name: str, value: npt.ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Return states with z > -1, of the given shape."""
    state = _native.real_array(name, value)
    if state.shape != shape:
        raise InputError(f"{name}: must have shape {shape}, got {state.shape}")
    lowest = state[0] if state.ndim == 1 else state[..., 0].min()
    if lowest <= -1:
        raise InputError(f"{name} z = {lowest:g}: must be greater than -1")
    return state


def first_steps(system: Pendulum, end: float) -> int:
    """First number of steps of the step size search: four per fastest linear period."""
    fastest = system._fastest()
    if not math.isfinite(end * fastest):
        raise InputError(
            f"t_end = {end:g}: contains more periods of the fastest motion (frequency "
            f"{fastest:g}) than can be counted"
        )
    return max(1, math.ceil(min(end * fastest / (0.5 * math.pi), 2.0 * MAX_STEPS)))


def goes_as_pendulum(
    system: Mount | PolynomialSystem,
    method: str,
    load: LoadLike | None,
    base: LoadLike | LoadTable | None,
    held: npt.ArrayLike | Past | None,
    memory: str,
) -> TypeGuard[PolynomialSystem]:
    """True if the methods of a pendulum are sufficient for a system."""
    if isinstance(system, Mount) or system._turns:
        return False
    if not (isinstance(memory, str) and memory in AS_COORDINATES):
        return False
    if system._active_kernels and not _fades_near_switches(system, method):
        return False
    orders: list[Any] = []
    for given in (load, base):
        # Numbers and None are tested faster than mappings.
        if given is not None and type(given) is not float and isinstance(given, Mapping):
            # Names of coordinates mean order 1.
            orders += [1 if isinstance(order, str) else order for order in given]
    highest = max(orders, default=0)
    return (
        len(system.dof_names) <= MAX_DOF
        # An unknown method is refused later with a list of all names.
        and not (isinstance(method, str) and method in NODES and method not in METHODS)
        # Without switches the methods of a mount are used.
        and ((base is None and held is None) or switches_by_itself(system))
        and isinstance(highest, int)
        and highest <= MAX_HARMONICS
    )


def goes_in_sections(system: object, method: str, memory: str) -> TypeGuard[PolynomialSystem]:
    """True if a system with more coordinates than a lane has steps that end at switches."""
    if not isinstance(system, PolynomialSystem) or system._turns or not switches_by_itself(system):
        return False
    n = len(system.dof_names)
    if not MAX_DOF < n <= MOST_IN_FRAME or not system._has_frame:
        return False
    if not (isinstance(memory, str) and memory in AS_COORDINATES):
        return False
    if not (isinstance(method, str) and method in ("auto", *IN_SECTIONS)):
        return False
    return not system._active_kernels or _fades_near_switches(system, method)


def switches_by_itself(system: PolynomialSystem) -> bool:
    """True if a law has kinks or jumps."""
    return any(law.state or law.branches for group in system.groups for _, law in group.laws)


def reads_rates(system: PolynomialSystem) -> bool:
    """True if a law depends on a velocity (and may have a thin layer)."""
    n = len(system.dof_names)
    return any(
        place >= n for group in system.groups for _, law in group.laws for place in law.places
    )


def _fades_near_switches(system: PolynomialSystem, method: str) -> bool:
    """True if steps may end at switches in spite of memory: it has few exponentials."""
    if method not in ("auto", *REMEMBERING) or not switches_by_itself(system):
        return False
    return 0 <= n_hidden(system)[0] <= MOST_WITH_MEMORY - len(system.dof_names)


@cache
def _all_move(n: int) -> npt.NDArray[np.int32]:
    """Flags for the core if every coordinate moves; read-only."""
    moves = np.ones(n, dtype=np.int32)
    moves.setflags(write=False)
    return moves


def polynomial_runs(
    system: PolynomialSystem,
    end: float,
    initial: npt.ArrayLike | None,
    method: str,
    load: LoadLike | None,
    nu: float | None,
    force: LoadTable | None,
    solved: float,
    whole: bool = False,
    base: LoadLike | LoadTable | None = None,
    held: npt.ArrayLike | Past | None = None,
) -> tuple[Callable[[float], Run], int]:
    """Return a function that creates a run with a step size, and the first number of steps.

    ``whole``: full equations of a structure, with elements that may switch.
    """
    n = len(system.dof_names)
    motion: MountMotion | None = None
    if base is None and held is None:
        breaks, pieces = table_of(force, n)
        state = np.zeros(2 * n) if initial is None else starting_state(initial, n, system.dof_names)
        if load is None and nu is not None:
            raise InputError("nu: must not be given without load")
        # A number contains no names of coordinates.
        named = None if type(load) is float else name_places(system.dof_names)
        orders, series = load_series(load, None, n, named)
    else:
        motion = MountMotion.checked(
            system, end, initial, "auto", load, nu, base, force, held, "auto"
        )
        breaks, pieces, state = motion.breaks, motion.pieces, motion.state
        orders, series = motion.series
    frequency = 0.0 if nu is None else _native.number("nu", nu)
    # For few numbers lists are faster than arrays.
    given_orders: list[int] = orders.tolist()
    if motion is not None:
        given_orders = [k if k >= 0 else -1 - k for k in given_orders]
    forces: list[list[complex]] = series.tolist()
    starts: list[float] = state.tolist()
    acting = [k for k, column in zip(given_orders, zip(*forces, strict=True), strict=True)
              if any(column)]  # fmt: skip
    if frequency < 0 or (frequency == 0 and acting and max(given_orders) > 0):
        raise no_frequency(nu if nu is None else frequency)
    if type(method) is not str or method not in _EVERY_METHOD:
        _native.choice("method", method, _EVERY_METHOD)
    name = "gauss8" if method == "auto" else method
    # Steps must resolve the highest harmonic of the load.
    highest = frequency * max(acting, default=0)
    if n <= MAX_DOF:
        fastest = system._fastest()
    else:
        fastest = _native.run("motion fastest rate", system._handle)["fastest"]
    many = end * max(fastest, highest) / (0.5 * math.pi)
    steps = max(1, math.ceil(min(many, 2.0 * MAX_STEPS)))
    pushed = [False] * n if force is None else [bool(one.any()) for one in pieces]
    driven = [
        pushed[i] or any(forces[i]) or starts[2 * i] != 0 or starts[2 * i + 1] != 0
        for i in range(n)
    ]
    # States of elements and surfaces keep their order if loads change later.
    together = all(driven) or whole or motion is not None or switches_by_itself(system)
    moves = _all_move(n) if together else moving(system, np.array(driven))
    layers = ThinLayers()
    reach = EVER
    if system._active_kernels and motion is None:
        warn_of_slow_mode(system)
    flat = system._flat
    if flat[_N_KERNELS] and n_hidden(system)[1]:
        reach = min(_REACH * end, EVER)
        if motion is not None:
            reach -= float(motion.before[0])
    past = _no_past(n) if motion is None else (motion.held, motion.before, motion.moved)
    moved = _no_base() if motion is None else (motion.base_breaks, motion.base_pieces)
    loads = {
        "orders": orders, "series": series, "nu": frequency, "breaks": breaks, "pieces": pieces,
        "base_breaks": moved[0], "base_pieces": moved[1],
    }  # fmt: skip
    job = (
        flat, orders, series, frequency, breaks, pieces, moves, layers, reach, force, motion,
        moved, past, loads, system._handle,
    )  # fmt: skip
    return partial(PolynomialRun.of_job, system, name, state, solved, job), steps


@cache
def _no_past(n: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Past of a motion that starts at rest: displacement held, times, displacements."""
    return nothing(n), nothing(1), np.zeros((n, 1), order="F")


@cache
def _no_base() -> tuple[FloatArray, FloatArray]:
    """A base without a table."""
    return nothing(1), np.zeros((4, 1, 1), order="F")


class PolynomialRun(Run):
    """A run of a polynomial system without memory."""

    counts = "evaluations"
    system: PolynomialSystem
    #: True if only the equations of the run itself give accelerations.
    always_repeats: ClassVar[bool] = False

    def __init__(
        self,
        system: PolynomialSystem,
        method: str,
        state: FloatArray,
        h: float,
        solved: float,
        job: tuple[Any, ...],
    ) -> None:
        super().__init__(system, method, state, h, solved)
        self.job = job
        self.layers = job[7]
        self.hidden, self.fitted = 0, False
        if job[0][_N_KERNELS]:
            self.hidden, self.fitted = n_hidden(system, h, job[8])

    @classmethod
    def of_job(
        cls,
        system: PolynomialSystem,
        method: str,
        state: FloatArray,
        solved: float,
        job: tuple[Any, ...],
        h: float,
    ) -> "PolynomialRun":
        """Create a run, with the step size as the last argument."""
        return cls(system, method, state, h, solved, job)

    def adopt(self, earlier: Run) -> None:
        """Continue from the end of an earlier run, with the states of its elements."""
        super().adopt(earlier)
        self.memory = earlier.memory
        if isinstance(earlier, PolynomialRun):
            self.job = (
                *self.job[:8], earlier.job[8], *self.job[9:12], earlier.job[12], *self.job[13:]
            )  # fmt: skip
            self.hidden, self.fitted = earlier.hidden, earlier.fitted

    @property
    def has_layers(self) -> bool:
        """True if the system has laws that are not polynomials."""
        return any(group.laws for group in self.system.groups)

    @property
    def switched(self) -> FloatArray:
        """States of elements and signs of surfaces, stored by the core after the method's data."""
        return np.empty(0) if self.memory is None else self.memory[int(self.memory[-1]) : -3]

    @property
    def system_in_core(self) -> _native.Handle:
        """The system in the core (with changed numbers in a run with perturbed parameters)."""
        handle: _native.Handle = self.job[14]
        return handle

    @property
    def motion(self) -> MountMotion | None:
        """Motion of the base and past of the run; None: neither."""
        known: MountMotion | None = self.job[10]
        return known

    def acting(self) -> tuple[_native.Handle, Loads, EarlierMotion | None]:
        """The system, its loads, and its past; None: it has no memory."""
        motion, job = self.motion, self.job
        past = EarlierMotion(*job[12]) if self.hidden else None
        if motion is not None:
            return self.system_in_core, motion.acting, past
        orders, series, frequency, breaks, pieces = job[1:6]
        loads = Loads(orders * frequency, series[: len(job[6])], breaks, pieces)
        return self.system_in_core, loads, past

    def along(self, kept: Trajectory) -> KnownMotion:
        """As of other runs; on surfaces of laws by the equations of the side that it is on."""
        if not (self.switched.size or self.hidden or self.always_repeats):
            return super().along(kept)
        system, loads, past = self.acting()
        n = len(self.job[6])

        def states(t: FloatArray) -> tuple[FloatArray, ...]:
            found, moved = self.repeat(t, kept, accelerates=True), loads.moved(t)
            state = found["states"].T
            gathered.append(found["accelerations"].T[: state.shape[0]])
            return state[:, ::2] - moved[0], state[:, 1::2] - moved[1], gathered[-1][:, n:]

        gathered: list[FloatArray] = []
        u, rate, laws = states(kept.t)
        push, make = gathered[0][:, :n], None
        if past is not None and kept.t.size:
            make = partial(self._panels, kept, past, states)
        return KnownMotion(system, kept.t, u, rate, loads.at(kept.t), make, push, laws)

    def power(self, t: FloatArray, state: FloatArray) -> FloatArray:
        """Power of load and damping."""
        _, orders, series, nu, *_ = self.job
        table = self.job[9]
        v = state[:, 1::2]
        force = (np.exp(1j * nu * np.outer(t, orders)) @ series[:-1].T).imag
        if table is not None:
            given = table(t)
            force = force + given if given.ndim == 2 else force
            force[:, 0] += given if given.ndim == 1 else 0.0
        return np.asarray(np.einsum("ta,ta->t", v, force - v @ self.system._damping.T))

    def _plan(self, **steps: Any) -> str:
        text: str = _native.run(
            "motion plan without memory", self.system_in_core, orders=self.job[1],
            series=self.job[2], reach=float(self.job[8]), initial=self.begin,
            method=METHODS[self.method], **steps,
        )["text"]  # fmt: skip
        return text

    def check_reach(self, end: float) -> None:
        """Refuse a run that continues beyond the time for which kernels are fitted."""
        reach = self.job[8]
        if self.fitted and end > reach * (1 + 1e-9):
            raise InputError(
                f"t_end = {end:g}: a run made for t_end = {reach / _REACH:g} with kernels that are "
                f"not sums of exponentials may go on to {reach:g} at most"
            )

    def _given(self) -> tuple[str, tuple[_native.Handle, ...], dict[str, Any]]:
        """Task, handles and values of the equations of a polynomial system."""
        held, before, moved = self.job[12]
        values = {
            "held": held, "before": before, "moved": moved, "method": METHODS[self.method],
            "moves": self.job[6], "reach": float(self.job[8]), **self.job[13],
        }  # fmt: skip
        return "motion without memory", (self.system_in_core,), values


class _PendulumRun(Run):
    """A run of a pendulum."""

    counts = "evaluations"
    system: Pendulum

    @classmethod
    def of(
        cls, system: Pendulum, method: str, state: FloatArray, solved: float, h: float
    ) -> "_PendulumRun":
        """Create a run, with the step size as the last argument."""
        return cls(system, method, state, h, solved)

    def power(self, t: FloatArray, state: FloatArray) -> FloatArray:
        """Power of loads and damping."""
        return self.system.power(t, state)

    def accelerations(self, kept: Trajectory) -> FloatArray:
        """By the equations of motion."""
        return self.system.rhs(kept.t, kept.state)[:, 1::2]

    @property
    def swings(self) -> int:
        """1 if phi or psi move; 0: only the spring is integrated."""
        return int(any(self.begin[2:].tolist()) or self.system.m01 != 0 or self.system.m02 != 0)

    def _plan(self, **steps: Any) -> str:
        text: str = _native.run(
            "motion plan of pendulum", self.system._handle, initial=self.begin,
            method=METHODS[self.method], **steps,
        )["text"]  # fmt: skip
        return text

    def _given(self) -> tuple[str, tuple[_native.Handle, ...], dict[str, Any]]:
        """Task, handles and values for a pendulum."""
        swings = self.watch is not None or bool(self.swings)
        values = {"method": METHODS[self.method], "swings": swings}
        return "motion of pendulum", (self.system._handle,), values
