"""Motion in time: fixed-step integration of the pendulum and of polynomial systems."""

import csv
import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.interpolate import CubicSpline
from tqdm import tqdm

from viscovib import _native
from viscovib._native import FloatArray, core
from viscovib.errors import InputError
from viscovib.files import whole_file
from viscovib.load import LoadLike, load_series
from viscovib.pendulum import Pendulum
from viscovib.polynomial_system import PolynomialSystem

#: Explicit methods by their place in the core.
EXPLICIT = {"rk4": 1, "dop8": 2, "verner8": 3, "verner9": 4}
#: All methods by their place in the core.
METHODS = {"gauss8": 1, "gauss16": 2, "gauss2": 3, "gauss3": 4} | {
    name: place + 4 for name, place in EXPLICIT.items()
}
OUTCOMES = ("completed", "diverged", "unphysical")
#: Steps a native call takes at most: how often progress shows and Ctrl-C is heard.
CHUNK = 200_000

#: Numbers that a run needs to go on; the core uses as many as the method has.
_MEMORY = 256
_MAX_STEPS = 10**12
_ROUNDING = 1e-15
#: Highest order of a load in time: its phase is reached by rotations.
_MAX_LOAD_ORDER = 199
#: Halvings of the step before a tolerance is given up.
_MIN_HALVINGS, _MAX_HALVINGS = 5, 12


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A motion in time.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Times of the states kept.
    state : ndarray, shape (n, 2 n_dof)
        Each coordinate and its velocity: (z, z', phi, phi', psi, psi') of a pendulum.
    outcome : str
        "completed"; "diverged": the step is too large or a coordinate passed 1e6, the run
        stopped; "unphysical": z <= -1, the spring passes through the pivot, the run stopped.
    t_reached : float
        Time of the last step made.
    dt : float
        The step.
    method : str
    error : float or None
        Estimated largest error of the states kept, if asked for or ``dt`` was "auto".
    stats : dict
        "steps", "evaluations" (of all lanes at once).
    system : Pendulum or PolynomialSystem
    """

    t: FloatArray
    state: FloatArray
    outcome: str
    t_reached: float
    dt: float
    method: str
    error: float | None
    stats: dict[str, int]
    system: Pendulum | PolynomialSystem
    _resume: dict[str, Any] = field(repr=False)

    @property
    def dof_names(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return self.system.dof_names

    def coordinate(self, name: str) -> FloatArray:
        """One of "z", "z_dot", "phi", ... (name of a coordinate, or with _dot), shape (n,)."""
        names = tuple(f"{d}{dot}" for d in self.dof_names for dot in ("", "_dot"))
        return self.state[:, names.index(_native.choice("name", name, names))]

    def energy_defect(self) -> FloatArray:
        """Energy at each time less that at the first and the work done since, shape (n,).

        Work of the loads less dissipation, by a spline through the power at the states kept: the
        defect shows the error of the motion once these are close enough for the spline. It is
        that of the exact equations; `cubic` and `printed` ones do not keep this balance, nor do
        polynomial forces without a potential, which are refused.
        """
        energy = self.system.energy(self.state)
        if self.t.size < 4:
            raise InputError(f"trajectory: {self.t.size} states kept, must be at least 4")
        motion = _motion(self.system, *self._resume["load"])
        work = CubicSpline(self.t, motion.power(self.t, self.state)).antiderivative()
        return np.asarray(energy - energy[0] - (work(self.t) - work(self.t[0])))

    def to_dataset(self, *, physical: bool = False) -> xr.Dataset:
        """Coordinates and velocities as an xarray Dataset over t.

        With ``physical=True`` in s, m and rad, if the pendulum was built from physical units; z is
        then the extension beyond static.
        """
        time, length = 1.0, 1.0
        units: tuple[str, ...]
        if isinstance(self.system, PolynomialSystem):
            units = ("s", *self.system.dof_units, *(f"{unit}/s" for unit in self.system.dof_units))
        elif not physical:
            units = ("1/omega_1", "L", "rad", "rad", "L omega_1", "rad omega_1", "rad omega_1")
        else:
            scales = self.system.scales
            if scales is None:
                raise InputError(
                    "physical = True: this pendulum was not built by Pendulum.from_physical"
                )
            time, length = scales.time, scales.length
            units = ("s", "m", "rad", "rad", "m/s", "rad/s", "rad/s")
        variables = {}
        for d, name in enumerate(self.dof_names):
            size = length if d == 0 else 1.0
            at, dot = self.state[:, 2 * d] * size, self.state[:, 2 * d + 1] * (size / time)
            variables[name] = ("t", at, {"units": units[1 + d]})
            dot_units = units[1 + len(self.dof_names) + d]
            variables[f"{name}_dot"] = ("t", dot, {"units": dot_units})
        attributes = {"outcome": self.outcome, "dt": self.dt * time, "method": self.method}
        if self.error is not None:
            attributes["error"] = self.error
        coordinates = {"t": ("t", self.t * time, {"units": units[0]})}
        return xr.Dataset(variables, coords=coordinates, attrs=attributes)

    def to_csv(self, path: str | Path) -> None:
        """Write the table that the standalone driver writes: one row a time."""
        names = [f"{d}{dot}" for d in self.dof_names for dot in ("", "_dot")]
        with whole_file(path) as file:
            file.write(f"# viscovib {version('viscovib')}\n")
            file.write(f"# method {self.method}, step {self.dt:.17g}, {self.outcome}\n")
            if isinstance(self.system, PolynomialSystem):
                pairs = zip(self.dof_names, self.system.dof_units, strict=True)
                file.write(f"# t in s, {', '.join(f'{name} in {unit}' for name, unit in pairs)}\n")
            else:
                file.write("# dimensionless: t in 1/omega_1, z in L, phi and psi in rad\n")
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["t", *names])
            for t, row in zip(self.t, self.state, strict=True):
                writer.writerow([f"{value:.16e}" for value in (t, *row)])


def simulate(
    system: Pendulum | PolynomialSystem,
    t_end: float,
    *,
    load: LoadLike | None = None,
    nu: float | None = None,
    dt: float | str = "auto",
    initial: npt.ArrayLike | None = None,
    resume: Trajectory | None = None,
    method: str = "auto",
    tolerance: float | None = None,
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
    system : Pendulum or PolynomialSystem
        The latter without memory and with at most 6 coordinates.
    t_end : float
        End of the run, after its start.
    load : complex, array_like or mapping, optional
        Periodic load of a polynomial system as for `forced_response`, such as P: P sin(nu t) on
        its first coordinate. A pendulum has its loads within.
    nu : float, optional
        Circular frequency of ``load`` (rad/s).
    dt : float or "auto"
        Step, shortened so that a whole number of steps reaches t_end. "auto": halved from a
        quarter of the fastest linear period until halving changes the kept states by no more
        than ``tolerance``.
    initial : array_like, shape (2 n_dof,)
        State at t = 0: each coordinate and its velocity.
    resume : Trajectory
        Continue this run instead, bit for bit as if it had never stopped; ``dt``, ``method`` and
        ``load`` are those of the run.
    method : str
        "gauss8", "gauss16", "gauss2", "gauss3": Gauss-Legendre collocation of that many nodes
        (order twice as high), symplectic; "rk4"; "dop8": Dormand and Prince, order 8; "verner8",
        "verner9": Verner's efficient methods of order 8 and 9. "auto" is "gauss8", the fastest
        for one trajectory at every accuracy.
    tolerance : float
        Wanted absolute error of the kept states, 1e-13 to 1. With ``dt="auto"`` (default 1e-10)
        the step is found by it. With ``dt`` given it only says how far the equations of a
        collocation are solved (default: to rounding).
    times : array_like, shape (n,)
        Keep the states at these ascending times instead, each by a step of its own from the
        step before it, so that it is as exact as those at the ends of steps.
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

    Notes
    -----
    Phases of the loads are carried in two doubles, so that long runs lose no digits; the state
    with compensated summation.
    """
    if not isinstance(system, (Pendulum, PolynomialSystem)):
        raise InputError(f"system = {system!r}: must be a Pendulum or a PolynomialSystem")
    end = _native.number("t_end", t_end)
    want = _Wanted.checked(times, save_every, keep, tail)
    wanted = None if tolerance is None else _native.number("tolerance", tolerance)
    if wanted is not None and not 1e-13 <= wanted <= 1:
        raise InputError(f"tolerance = {wanted:g}: must be in [1e-13, 1]")
    if resume is not None:
        if initial is not None:
            raise InputError("initial and resume are both given: must be one of them")
        if load is not None or nu is not None:
            raise InputError("load, nu: are those of the run that is resumed, must not be given")
        return _go_on(system, end, resume, want, progress)
    if initial is None:
        raise InputError("initial: must be given (or resume)")
    motion = _motion(system, load, nu)
    state = motion.checked(initial)
    if end <= 0:
        raise InputError(f"t_end = {end:g}: must be greater than 0")
    name = _native.choice("method", method, ("auto", *METHODS))
    name = "gauss8" if name == "auto" else name
    solved = _ROUNDING if wanted is None else max(0.1 * wanted, _ROUNDING)
    if dt == "auto":
        wanted = 1e-10 if wanted is None else wanted
        solved = max(0.1 * wanted, _ROUNDING)
        return _by_tolerance(motion, end, state, name, wanted, solved, want, progress)
    step = _native.number("dt", dt)
    if not 0 < step <= end:
        raise InputError(f"dt = {step:g}: must be greater than 0 and not exceed t_end = {end:g}")
    n = math.ceil(end / step * (1 - 1e-12))
    _native.integer("t_end / dt", n, 1, _MAX_STEPS)
    run = _Run(motion, name, state, end / n, solved).steps(n, want, progress)
    if estimate_error:
        finer = _Run(motion, name, state, end / (2 * n), solved)
        check = finer.steps(2 * n, want.finer(2), progress)
        return replace(run, error=_difference(run, check))
    return run


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
    return max(1, math.ceil(end * fastest / (0.5 * math.pi)))


@dataclass(frozen=True, eq=False)
class _Motion:
    """What moves, under which load, and the native routine with what it takes first."""

    system: Pendulum | PolynomialSystem
    load: tuple[LoadLike | None, float | None]
    routine: Callable[..., tuple[Any, ...]]
    given: tuple[Any, ...]

    def checked(self, initial: npt.ArrayLike) -> FloatArray:
        if isinstance(self.system, Pendulum):
            return checked_state("initial", initial, (6,))
        state, n = _native.real_array("initial", initial), 2 * len(self.system.dof_names)
        if state.shape != (n,):
            raise InputError(f"initial: must have shape ({n},), got {state.shape}")
        return state

    def first_steps(self, end: float) -> int:
        if isinstance(self.system, Pendulum):
            return first_steps(self.system, end)
        fastest = max(self.system._fastest(), float(self.given[-1]))
        return max(1, math.ceil(end * fastest / (0.5 * math.pi)))

    def power(self, t: FloatArray, state: FloatArray) -> FloatArray:
        """Power of load and damping."""
        if isinstance(self.system, Pendulum):
            return self.system.power(t, state)
        orders, series, nu = self.given[1:]
        v = state[:, 1::2]
        force = (np.exp(1j * nu * np.outer(t, orders)) @ series[:-1].T).imag
        return np.asarray(np.einsum("ta,ta->t", v, force - v @ self.system._damping.T))


def _motion(
    system: Pendulum | PolynomialSystem, load: LoadLike | None, nu: float | None
) -> _Motion:
    if isinstance(system, Pendulum):
        if load is not None or nu is not None:
            raise InputError("load, nu: must not be given, a pendulum has its loads within")
        return _Motion(system, (None, None), core.pendulum_simulate, (system._flat,))
    if (load is None) != (nu is None):
        raise InputError("load, nu: must be given together, or neither")
    frequency = 0.0 if nu is None else _native.number("nu", nu)
    if nu is not None and frequency <= 0:
        raise InputError(f"nu = {frequency:g}: must be greater than 0")
    given = (system._flat, *load_series(load, None, len(system.dof_names)), frequency)
    if np.max(given[1], initial=0) > _MAX_LOAD_ORDER:
        raise InputError(f"load: order {np.max(given[1])}, must be at most {_MAX_LOAD_ORDER}")
    return _Motion(system, (load, nu), core.polynomial_simulate, given)


@dataclass(frozen=True)
class _Wanted:
    """What is kept of a run."""

    every: int = 1
    keep: str = "all"
    tail: float = 0.0
    times: FloatArray | None = None

    @classmethod
    def checked(
        cls, times: npt.ArrayLike | None, save_every: int, keep: str, tail: float | None
    ) -> "_Wanted":
        every = _native.integer("save_every", save_every, 1, _MAX_STEPS)
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

    def finer(self, factor: int) -> "_Wanted":
        """The same states of a run with so many times the steps."""
        return replace(self, every=self.every * factor)


def hopeless(changes: list[float]) -> bool:
    """Whether halving the step once more is vain: two halvings gain less than a digit.

    So it is with chaotic motion, and below the level of rounding. A large first step may need a
    few halvings before the order of a method shows.
    """
    n = len(changes)
    return n >= _MAX_HALVINGS or (n >= _MIN_HALVINGS and changes[-1] > 0.1 * changes[-3])


def _difference(coarse: Trajectory, fine: Trajectory) -> float:
    if coarse.state.shape != fine.state.shape:
        return math.inf
    return float(np.abs(fine.state - coarse.state).max())


def _by_tolerance(
    motion: "_Motion",
    end: float,
    state: FloatArray,
    method: str,
    wanted: float,
    solved: float,
    want: _Wanted,
    progress: bool,
) -> Trajectory:
    n = want.every * math.ceil(motion.first_steps(end) / want.every)
    factor, coarse = 1, _Run(motion, method, state, end / n, solved).steps(n, want, progress)
    changes: list[float] = []
    while not hopeless(changes):
        factor *= 2
        run = _Run(motion, method, state, end / (n * factor), solved)
        fine = run.steps(n * factor, want.finer(factor), progress)
        change = math.inf
        if "completed" == coarse.outcome == fine.outcome:
            change = _difference(coarse, fine)
            if change <= wanted:
                return replace(fine, error=change)
        elif coarse.outcome == fine.outcome == "unphysical":
            return fine
        changes.append(change)
        coarse = fine
    raise InputError(
        f"tolerance = {wanted:g}: not met with {n * factor} steps (states still change by "
        f"{changes[-1]:.1e} or the run fails); the motion may be chaotic: take a "
        "shorter run or a larger tolerance"
    )


def _go_on(
    system: Pendulum | PolynomialSystem,
    end: float,
    earlier: Trajectory,
    want: _Wanted,
    progress: bool,
) -> Trajectory:
    if earlier.outcome != "completed":
        raise InputError(f"resume: that run ended {earlier.outcome!r}, must be 'completed'")
    given = dict(earlier._resume)
    run = _Run(_motion(system, *given.pop("load")), **given)
    n = round((end - run.time) / run.h)
    if n < 1 or abs(run.time + n * run.h - end) > 1e-9 * max(abs(end), run.h):
        raise InputError(
            f"t_end = {end:g}: must be a whole number of steps {run.h:g} after {run.time:g}"
        )
    return run.steps(n, want, progress)


def _bar(n: int, progress: bool) -> AbstractContextManager["tqdm[Any] | None"]:
    """Return a progress bar if wanted; making even a silent one takes longer than a short run."""
    return tqdm(total=n, unit=" steps", leave=False) if progress else nullcontext()


class _Run:
    """A run that can go on: the native state and how far it has come."""

    def __init__(
        self,
        motion: "_Motion",
        method: str,
        state: FloatArray,
        h: float,
        solved: float,
        done: int = 0,
        memory: FloatArray | None = None,
    ) -> None:
        self.motion, self.method, self.state, self.h = motion, method, state, h
        self.solved, self.done, self.memory = solved, done, memory

    @property
    def time(self) -> float:
        return self.done * self.h

    def steps(self, n: int, want: _Wanted, progress: bool) -> Trajectory:
        """Make n steps."""
        if want.times is not None:
            self._check_times(want.times, n)
        start, first = self.done, self.state
        # What is not kept is passed over in larger pieces.
        skipped = 0
        if want.keep == "tail":
            skipped = max(0, n - math.ceil(want.tail / self.h)) // want.every * want.every
        counts = {"evaluations": 0}
        states: list[FloatArray] = []
        ended = 0
        with _bar(n, progress) as bar:
            if skipped:
                ended = self._advance(skipped, replace(want, keep="last"), states, counts, bar)
                start, first = self.done, self.state
            if not ended:
                ended = self._advance(n - skipped, want, states, counts, bar)
        if want.times is not None:
            kept = np.concatenate(states)
            t = want.times[: kept.shape[0]]
        elif want.keep == "last":
            kept, t = self.state[np.newaxis], np.array([self.time])
        else:
            kept = np.concatenate([first[np.newaxis], *states])
            t = np.multiply(start + want.every * np.arange(kept.shape[0]), self.h, dtype=float)
        return Trajectory(
            t=t,
            state=kept,
            outcome=OUTCOMES[ended],
            t_reached=self.time,
            dt=self.h,
            method=self.method,
            error=None,
            stats={"steps": self.done, **counts},
            system=self.motion.system,
            _resume={
                "load": self.motion.load,
                "method": self.method,
                "state": self.state,
                "h": self.h,
                "solved": self.solved,
                "done": self.done,
                "memory": self.memory,
            },
        )

    def _advance(
        self,
        n: int,
        want: _Wanted,
        states: list[FloatArray],
        counts: dict[str, int],
        bar: "tqdm[Any] | None",
    ) -> int:
        """Make n steps in pieces; return how they ended."""
        piece = max(CHUNK // want.every, 1) * want.every
        left, ended = n, 0
        while left and not ended:
            count = min(piece, left)
            stored = want.keep != "last" and want.times is None
            columns = count // want.every if stored else 0
            times = np.empty(0)
            if want.times is not None:
                now, until = self.time, (self.done + count) * self.h
                if left == count:
                    until = math.inf
                times = want.times[(want.times >= now) & (want.times < until)]
            resume = self.memory is not None
            kept, at_times, last, memory, made, ended, evaluated = _native.call(
                self.motion.routine,
                *self.motion.given,
                METHODS[self.method],
                self.state,
                self.h,
                self.solved,
                self.done,
                count,
                want.every,
                int(resume),
                self.memory if resume else np.zeros(_MEMORY),
                times,
                columns,
            )
            self.memory, self.state = memory, last
            self.done += made
            counts["evaluations"] += evaluated
            if want.times is not None:
                states.append(at_times.T[times <= self.time * (1 + 1e-15)])
            else:
                states.append(kept.T[: min(columns, made // want.every)])
            left -= count
            if bar is not None:
                bar.update(made)
        return int(ended)

    def _check_times(self, times: FloatArray, n: int) -> None:
        end = (self.done + n) * self.h
        if times[0] < self.time or times[-1] > end * (1 + 1e-15):
            raise InputError(
                f"times: must be between the start {self.time:g} and the end {end:g} of the run"
            )
