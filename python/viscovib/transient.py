"""Motion in time: fixed-step integration of every system."""

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, TypeGuard

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray, core
from viscovib.accuracy import Accuracy
from viscovib.errors import ConvergenceWarning, InputError
from viscovib.hereditary import MountMotion, moving, table_of
from viscovib.load import LoadLike, load_series
from viscovib.load_table import LoadTable
from viscovib.mesh import Mesh
from viscovib.mount import Mount
from viscovib.past import Past
from viscovib.pendulum import Pendulum
from viscovib.plan import Plan
from viscovib.polynomial_system import PolynomialSystem
from viscovib.runs import (
    MAX_FIRST_STEPS,
    MAX_STEPS,
    ROUNDING,
    Piece,
    Run,
    Wanted,
    by_tolerance,
    difference,
    go_on,
)
from viscovib.trajectory import Trajectory

#: Explicit methods by their place in the core.
EXPLICIT = {"rk4": 1, "dop8": 2, "verner8": 3, "verner9": 4}
#: All methods by their place in the core.
METHODS = {"gauss8": 1, "gauss16": 2, "gauss2": 3, "gauss3": 4} | {
    name: place + 4 for name, place in EXPLICIT.items()
}
#: Numbers that a run needs to go on; the core uses as many as the method has.
_MEMORY = 256
#: Above this last coefficient of a step, relative to the motion, a run warns.
_ROUGH = 1e-2
#: Highest order of a load without memory: its phase is reached by rotations.
_MAX_LOAD_ORDER = 199
#: Coordinates of a polynomial system that the methods of a pendulum take.
_MAX_DOF = 6


def simulate(
    system: Pendulum | Mount | PolynomialSystem,
    t_end: float,
    *,
    dt: float | str = "auto",
    initial: npt.ArrayLike | None = None,
    resume: Trajectory | None = None,
    method: str = "auto",
    tolerance: float | None = None,
    rtol: float | None = None,
    atol: float | None = None,
    load: LoadLike | None = None,
    nu: float | None = None,
    base: LoadLike | None = None,
    force: LoadTable | None = None,
    held: npt.ArrayLike | Past | None = None,
    memory: str = "auto",
    times: npt.ArrayLike | None = None,
    save_every: int = 1,
    keep: str = "all",
    tail: float | None = None,
    estimate_error: bool = False,
    progress: bool = False,
) -> Trajectory:
    """Integrate a motion from t = 0, or on from an earlier one, to t_end in equal steps.

    Parameters
    ----------
    system : Pendulum, Mount or PolynomialSystem
    t_end : float
        End of the run, after its start.
    dt : float or "auto"
        Step, shortened so that a whole number of steps reaches t_end. "auto": halved from about
        a quarter of the fastest linear period until halving changes the kept states by no more
        than ``tolerance``. So many states are kept then (up to 100 000, and unless all of the past
        is kept) that no peak between them is higher by more than 1/500 of the largest displacement.
    initial : array_like, shape (2 n_dof,)
        State at t = 0, (z, z', phi, phi', psi, psi') or (x, x', phi, phi'). A mount without one
        starts at rest, or where it was ``held``.
    resume : Trajectory
        Continue this run instead, bit for bit as if it had never stopped; system, step, method
        and loads are those of the run. A kernel that is fitted by exponentials is so for the
        first ``t_end``: there the two agree to the tolerance only.
    method : str
        Of a pendulum: "gauss8", "gauss16", "gauss2", "gauss3": Gauss-Legendre collocation of
        that many nodes (order twice as high), symplectic; "rk4"; "dop8": Dormand and Prince,
        order 8; "verner8", "verner9": Verner's efficient methods of order 8 and 9. "auto" is
        "gauss8", the fastest for one trajectory at every accuracy.
        Of a mount: "gauss2", "gauss3", "gauss4", "gauss6" or "gauss8", the accelerations being
        collocated and what is remembered a polynomial through the nodes and both ends; "auto"
        is "gauss8".
    tolerance : float
        Wanted absolute error of the kept states, 1e-13 to 1. With ``dt="auto"`` (default 1e-10)
        the step is found by it. With ``dt`` given it only says how far the equations of a
        step are solved, and how well kernels are represented (default: to rounding).
        A polynomial system without memory, of at most 6 coordinates and under nothing but a
        ``force`` and a ``load`` of orders up to 199, has the methods of a pendulum; else those of
        a mount.
    rtol, atol : float
        With ``dt="auto"``, instead of ``tolerance``: each coordinate and velocity is wanted within
        atol + rtol times its largest value of the run (rtol 1e-13 to 1; atol 0 if not given).
    load, nu, base
        Not of a pendulum: periodic load, its frequency and motion of the base, as for
        ``forced_response``; a constant force F is ``load={0: 1j * F}``.
    force : LoadTable
        Not of a pendulum: any load in time, besides the periodic one. Steps end on its corners
        and ends; with ``dt`` given, states are kept at equal times all the same.
    held : array_like, shape (n_dof,), or Past
        Of a mount: displacement relative to the base held for all t < 0, or any motion before
        it, which its springs remember; None: at rest.
    memory : {"auto", "exponentials", "direct"}
        Of a mount with kernels: "exponentials": each kernel as a sum of exponentials, at a cost
        that does not grow with time; "direct": all of the past at every step, exact for any
        kernel, at a cost that grows with the square of the time. "auto": exponentials where the
        kernels are such sums, else direct.
    times : array_like, shape (n,)
        Keep the states at these ascending times instead: of a pendulum each by a step of its own
        from the step before it, of a mount by the polynomial of the step.
    save_every : int
        Keep every so many-th step.
    keep : {"all", "tail", "last"}
        "tail": what lies in the last ``tail`` units of time; "last": only the last state. Nothing
        else is stored.
    tail : float
        Length of the part that ``keep="tail"`` keeps.
    estimate_error : bool
        With ``dt`` given, run once more in half steps and report the largest difference of the
        states kept.
    progress : bool
        Show a progress bar.

    Warns
    -----
    ConvergenceWarning
        If the given steps do not resolve a motion with memory (``Trajectory.resolution``).
    StabilityWarning
        If a mount's kernel has an integral of 1 or more: free motion creeps away, and a run from
        rest does not settle on the steady response.

    Notes
    -----
    Phases of the loads are carried in two doubles, so that long runs lose no digits; the state
    with compensated summation. With memory, a first step that is not from rest without load is
    made of panels that double their length from 1e-13 of it on, since the start is singular.
    """
    if not isinstance(system, Pendulum | Mount | PolynomialSystem):
        raise InputError(
            f"system = {_native.shown(system)}: must be a Pendulum or a Mount or a PolynomialSystem"
        )
    end = _native.number("t_end", t_end)
    at_first = 1
    want = Wanted.checked(times, save_every, keep, tail)
    auto = _native.is_auto(dt)
    accuracy = Accuracy.checked(tolerance, rtol, atol, 1e-10 if auto else None)
    if not auto and (rtol is not None or atol is not None):
        raise InputError('rtol, atol: are for dt = "auto", must not be given with dt')
    # The step alone decides the error: its equations are solved to rounding, which costs little.
    wanted = None if auto or accuracy is None else accuracy.absolute
    if resume is not None:
        if initial is not None:
            raise InputError("initial and resume are both given: must be one of them")
        if load is not None or nu is not None:
            raise InputError("load, nu: are those of the run that is resumed, must not be given")
        _check_resumed(
            system,
            resume,
            {"base": base, "force": force, "held": held, "tolerance": tolerance},
            {"dt": dt, "method": method, "memory": memory},
        )
        return go_on(resume, end, want, progress)
    if end <= 0:
        raise InputError(f"t_end = {end:g}: must be greater than 0")
    if isinstance(system, Pendulum):
        given = {"load": load, "nu": nu, "base": base, "force": force, "held": held}
        for argument, value in given.items():
            if value is not None:
                raise InputError(f"{argument}: is for a Mount; a Pendulum has its loads in itself")
        _native.choice("memory", memory, ("auto",))
        make, n = _pendulum_runs(system, end, initial, method, wanted)
    elif _as_pendulum(system, method, load, base, held, memory):
        make, n = _polynomial_runs(system, end, initial, method, load, nu, force, wanted)
    else:
        motion = MountMotion.checked(
            system, end, initial, method, load, nu, base, force, held, memory
        )
        solved = ROUNDING if accuracy is None else accuracy.solved
        make = motion.runs(solved if motion.remembers or not auto else ROUNDING)
        n, at_first = motion.first_steps(), 2 if motion.remembers else 1
    breaks = np.empty(0) if force is None else force._breaks(len(system.dof_names))
    if force is not None:
        make = _with_table(make, force)

    estimated = _native.flag("estimate_error", estimate_error)

    def run(factor: int, parts: int) -> Trajectory:
        if mesh is not None:
            finer, kept = mesh.finer(factor), on_mesh
            if parts > 1:
                kept = want.at(mesh.all_times(parts))
            return make(finer.h).on(finer).steps(finer.count, kept, progress)
        steps, kept = n * factor, want
        if factor > 1:
            kept = want.finer(factor // parts)
        return make(end / steps).steps(steps, kept, progress)

    if auto:
        assert accuracy is not None
        if n > MAX_FIRST_STEPS:
            raise InputError(
                f"t_end = {end:g}: takes {n:.1e} steps of the fastest motion or load, must be at "
                f"most {MAX_FIRST_STEPS:g}: take a shorter run, slower loads or softer springs, or "
                "give dt"
            )
        n = want.every * math.ceil(n / want.every)
        mesh, on_mesh = _mesh(force, breaks, end, end / n, at_first, want)
        free = want.every == 1 and want.keep == "all" and want.times is None
        return by_tolerance(run, n, accuracy, dense=free)
    step = _native.number("dt", dt)
    if not 0 < step <= end:
        raise InputError(f"dt = {step:g}: must be greater than 0 and not exceed t_end = {end:g}")
    if end / step > MAX_STEPS:
        raise InputError(f"dt = {step:g}: t_end / dt must be at most {MAX_STEPS:g}")
    n = math.ceil(end / step * (1 - 1e-12))
    mesh, on_mesh = _mesh(force, breaks, end, end / n, at_first, want, equal=n)
    result = run(1, 1)
    if result.resolution is not None and result.resolution > _ROUGH:
        warnings.warn(
            f"dt = {step:g}: steps do not resolve the motion (resolution "
            f"{result.resolution:.1e}, should be below {_ROUGH:g})",
            ConvergenceWarning,
            stacklevel=2,
        )
    if estimated:
        fine = run(2, 1)
        return replace(
            result,
            error=difference(result, fine),
            _planned=partial(_plan_with_estimate, result),
        )
    return result


def _plan_with_estimate(run: Trajectory) -> Plan:
    return run.plan.instead(
        "estimate of the error", "computes: estimate of the error, by a run in half steps"
    )


def _with_table(make: Callable[[float], Run], force: LoadTable) -> Callable[[float], Run]:
    """Let the plan of a run name the table of forces that acts."""
    times = np.asarray(force.times)
    words = f"computes: force by a table of {times.size} times, {times[0]:g} to {times[-1]:g}"

    def made(h: float) -> Run:
        run = make(h)
        run.table = words
        return run

    return made


def _mesh(
    force: LoadTable | None,
    breaks: FloatArray,
    end: float,
    h: float,
    at_first: int,
    want: Wanted,
    equal: int | None = None,
) -> tuple[Mesh | None, Wanted]:
    """Return where steps end, None if they are equal, and what is kept of them.

    ``equal``: states are kept after so many equal steps, whatever the loads are.
    """
    if force is None:
        return None, want
    mesh = Mesh.until(end, h, breaks, at_first=at_first)
    if mesh.count > MAX_STEPS:
        raise InputError(f"force: takes {mesh.count:.1e} steps, must be at most {MAX_STEPS:g}")
    if want.times is not None or want.keep == "last":
        return mesh, want
    times = mesh.all_times() if equal is None else np.multiply(np.arange(equal + 1), h, dtype=float)
    times[-1] = end
    return mesh, want.at(times[:: want.every])


def _check_resumed(
    system: Pendulum | Mount | PolynomialSystem,
    run: Trajectory,
    given: Mapping[str, object],
    choices: Mapping[str, object],
) -> None:
    """Refuse by name what a run that goes on has already."""
    _native.check_instance("resume", run, Trajectory)
    parts = [(body._flat, *getattr(body, "_kernels", ())) for body in (system, run.system)]
    if type(system) is not type(run.system) or not all(
        np.array_equal(one, other) for one, other in zip(*parts, strict=True)
    ):
        raise InputError("system: must be that of the run that is resumed")
    told = [name for name, value in given.items() if value is not None]
    told += [name for name, value in choices.items() if not _native.is_auto(value)]
    if told:
        raise InputError(
            f"{', '.join(told)}: as of the run that is resumed, must not be given with resume"
        )


def _pendulum_runs(
    system: Pendulum,
    end: float,
    initial: npt.ArrayLike | None,
    method: str,
    wanted: float | None,
) -> tuple[Callable[[float], Run], int]:
    """Return what makes a run with a step, and the steps to begin with."""
    if initial is None:
        raise InputError("initial: must be given (or resume)")
    state = checked_state("initial", initial, (6,))
    name = _native.choice("method", method, ("auto", *METHODS))
    name = "gauss8" if name == "auto" else name
    solved = ROUNDING if wanted is None else max(0.1 * wanted, ROUNDING)
    return lambda h: _PendulumRun(system, name, state, h, solved), first_steps(system, end)


def checked_state(name: str, value: npt.ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Return states with z > -1, of the given shape."""
    state = _native.real_array(name, value)
    if state.shape != shape:
        raise InputError(f"{name}: must have shape {shape}, got {state.shape}")
    if (state[..., 0] <= -1).any():
        raise InputError(f"{name} z = {state[..., 0].min():g}: must be greater than -1")
    return state


def first_steps(system: Pendulum, end: float) -> int:
    """Steps to begin with when the step is to be found: four a fastest linear period."""
    natural = float(system.natural_frequencies().max())
    fastest = max(natural, system.p1, system.p2, system.p3)
    return max(1, math.ceil(min(end * fastest / (0.5 * math.pi), 2.0 * MAX_STEPS)))


def _as_pendulum(
    system: Mount | PolynomialSystem,
    method: str,
    load: LoadLike | None,
    base: LoadLike | None,
    held: npt.ArrayLike | Past | None,
    memory: str,
) -> TypeGuard[PolynomialSystem]:
    """Whether a system needs nothing but what the methods of a pendulum give."""
    if isinstance(system, Mount) or system._active_kernels or not _native.is_auto(memory):
        return False
    highest = max(load, default=0) if isinstance(load, Mapping) else 1
    return (
        len(system.dof_names) <= _MAX_DOF
        and method in ("auto", *METHODS)
        and all(given is None for given in (base, held))
        and isinstance(highest, int)
        and highest <= _MAX_LOAD_ORDER
    )


def _polynomial_runs(
    system: PolynomialSystem,
    end: float,
    initial: npt.ArrayLike | None,
    method: str,
    load: LoadLike | None,
    nu: float | None,
    force: LoadTable | None,
    wanted: float | None,
) -> tuple[Callable[[float], Run], int]:
    """Return what makes a run with a step, and the steps to begin with."""
    n = len(system.dof_names)
    breaks, pieces = table_of(force, n)
    state = np.zeros(2 * n) if initial is None else _native.real_array("initial", initial)
    if state.shape != (2 * n,):
        raise InputError(f"initial: must have shape ({2 * n},), got {state.shape}")
    if load is None and nu is not None:
        raise InputError("nu: must not be given without load")
    orders, series = load_series(load, None, n)
    frequency = 0.0 if nu is None else _native.number("nu", nu)
    if frequency < 0 or (frequency == 0 and (orders > 0).any() and series.any()):
        given = "None" if nu is None else f"{frequency:g}"
        raise InputError(f"nu = {given}: must be greater than 0 with a load of order 1 or more")
    name = "gauss8" if method == "auto" else method
    solved = ROUNDING if wanted is None else max(0.1 * wanted, ROUNDING)
    # Steps must see the highest order of the load.
    highest = frequency * int(orders[series.any(axis=0)].max(initial=0))
    steps = max(1, math.ceil(end * max(system._fastest(), highest) / (0.5 * math.pi)))
    driven = (series[:-1] != 0).any(axis=1) | (state.reshape(n, 2) != 0).any(axis=1)
    moves = moving(system, driven | pieces.any(axis=(1, 2)))
    job = (system._flat, orders, series, frequency, breaks, pieces, moves, force)
    return lambda h: _PolynomialRun(system, name, state, h, solved, job), steps


class _PolynomialRun(Run):
    """A run of a polynomial system without memory."""

    counts = "evaluations"
    system: PolynomialSystem

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

    def power(self, t: FloatArray, state: FloatArray) -> FloatArray:
        """Power of load and damping."""
        _, orders, series, nu, *_, table = self.job
        v = state[:, 1::2]
        force = (np.exp(1j * nu * np.outer(t, orders)) @ series[:-1].T).imag
        if table is not None:
            given = table(t)
            force = force + given if given.ndim == 2 else force
            force[:, 0] += given if given.ndim == 1 else 0.0
        return np.asarray(np.einsum("ta,ta->t", v, force - v @ self.system._damping.T))

    def _plan(self, end: float, dt: float, tolerance: float, every: int, last: bool) -> bytes:
        text: bytes = _native.call(
            core.polynomial_plan, *self.job[:3], self.begin, end, dt, tolerance,
            METHODS[self.method], every, int(last),
        )[0]  # fmt: skip
        return text

    def _native_steps(self, count: int, every: int, columns: int, times: FloatArray) -> Piece:
        resume = self.memory is not None
        return Piece(
            *_native.call(
                core.polynomial_simulate,
                *self.job[:6],
                *self._mesh_arrays(),
                METHODS[self.method],
                self.job[6],
                self.state,
                self.h,
                self.solved,
                self.done,
                count,
                every,
                int(resume),
                self.memory if resume else np.zeros(_MEMORY),
                times,
                columns,
            )
        )


class _PendulumRun(Run):
    """A run of a pendulum."""

    counts = "evaluations"
    system: Pendulum

    def power(self, t: FloatArray, state: FloatArray) -> FloatArray:
        """Power of loads and damping."""
        return self.system.power(t, state)

    @property
    def swings(self) -> int:
        """Whether anything moves phi or psi; else the spring alone is integrated."""
        return int(self.begin[2:].any() or self.system.m01 != 0 or self.system.m02 != 0)

    def _plan(self, end: float, dt: float, tolerance: float, every: int, last: bool) -> bytes:
        text: bytes = _native.call(
            core.pendulum_plan, self.system._flat, self.begin, end, dt, tolerance,
            METHODS[self.method], every, int(last),
        )[0]  # fmt: skip
        return text

    def _native_steps(self, count: int, every: int, columns: int, times: FloatArray) -> Piece:
        resume = self.memory is not None
        return Piece(
            *_native.call(
                core.pendulum_simulate,
                self.system._flat,
                METHODS[self.method],
                self.swings,
                self.state,
                self.h,
                self.solved,
                self.done,
                count,
                every,
                int(resume),
                self.memory if resume else np.zeros(_MEMORY),
                times,
                columns,
            )
        )
