"""Motion in time: fixed-step integration of the pendulum."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from tqdm import tqdm

from viscovib import _native
from viscovib._native import FloatArray, core
from viscovib.errors import InputError
from viscovib.pendulum import Pendulum

#: Gauss collocation by number of nodes; order is twice that.
METHODS = {"gauss2": 2, "gauss3": 3, "gauss8": 8, "gauss16": 16}
OUTCOMES = ("completed", "diverged", "unphysical")
#: Steps a native call takes at most: how often progress shows and Ctrl-C is heard.
CHUNK = 200_000

_MEMORY = 12 + 6 + 16 * 4 + 1
_MAX_STEPS = 10**12
_ROUNDING = 1e-15


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A motion in time.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Times of the states kept, the first being the start.
    state : ndarray, shape (n, 2 * n_dof)
        (z, z', phi, phi', psi, psi').
    outcome : str
        "completed"; "diverged": the step is too large, the run stopped; "unphysical": z <= -1, the
        spring passes through the pivot, the run stopped.
    t_reached : float
        Time of the last step made.
    dt : float
        The step.
    error : float or None
        Estimated largest error of the states kept, where `dt` was "auto"; else None.
    stats : dict
        "steps", "evaluations" (of all nodes at once).
    """

    t: FloatArray
    state: FloatArray
    outcome: str
    t_reached: float
    dt: float
    error: float | None
    stats: dict[str, int]
    dof_names: tuple[str, ...]
    _resume: dict[str, Any] = field(repr=False)

    def to_dataset(self) -> xr.Dataset:
        """Coordinates and velocities as an xarray Dataset over t."""
        variables = {}
        for d, name in enumerate(self.dof_names):
            variables[name] = ("t", self.state[:, 2 * d])
            variables[f"{name}_dot"] = ("t", self.state[:, 2 * d + 1])
        attributes = {"outcome": self.outcome, "dt": self.dt}
        return xr.Dataset(variables, coords={"t": self.t}, attrs=attributes)


def simulate(
    system: Pendulum,
    t_end: float,
    *,
    dt: float | str = "auto",
    initial: npt.ArrayLike | None = None,
    resume: Trajectory | None = None,
    method: str = "gauss8",
    tolerance: float = 1e-10,
    save_every: int = 1,
    keep: str = "all",
    progress: bool = False,
) -> Trajectory:
    """Integrate a motion from t = 0, or on from an earlier one, to t_end in equal steps.

    Parameters
    ----------
    system : Pendulum
    t_end : float
        End of the run, after its start.
    dt : float or "auto"
        Step, shortened so that a whole number of steps reaches t_end. "auto": halved from a
        quarter of the fastest linear period until halving changes the kept states by no more
        than ``tolerance``.
    initial : array_like, shape (6,)
        State at t = 0.
    resume : Trajectory
        Continue this run instead, bit for bit as if it had never stopped; ``dt`` and ``method``
        are those of the run.
    method : {"gauss8", "gauss16", "gauss2", "gauss3"}
        Gauss-Legendre collocation of that many nodes (order twice as high), symplectic.
    tolerance : float
        Wanted absolute error of the kept states with ``dt="auto"``, 1e-13 to 1.
    save_every : int
        Keep every so many-th step.
    keep : {"all", "last"}
        "last": only the last state; nothing else is stored.
    progress : bool
        Show a progress bar.

    Notes
    -----
    Phases of the loads are carried in two doubles, so that long runs lose no digits; the state
    with compensated summation.
    """
    if not isinstance(system, Pendulum):
        raise InputError(f"system = {system!r}: must be a Pendulum")
    end = _native.number("t_end", t_end)
    every = _native.integer("save_every", save_every, 1, _MAX_STEPS)
    _native.choice("keep", keep, ("all", "last"))
    if resume is not None:
        if initial is not None:
            raise InputError("initial and resume are both given: must be one of them")
        return _go_on(system, end, resume, every, keep, progress)
    if initial is None:
        raise InputError("initial: must be given (or resume)")
    state = _native.real_array("initial", initial)
    if state.shape != (6,):
        raise InputError(f"initial: must have shape (6,), got {state.shape}")
    if state[0] <= -1:
        raise InputError(f"initial z = {state[0]:g}: must be greater than -1")
    if end <= 0:
        raise InputError(f"t_end = {end:g}: must be greater than 0")
    nodes = METHODS[_native.choice("method", method, tuple(METHODS))]
    if dt == "auto":
        return _by_tolerance(system, end, state, nodes, tolerance, every, keep, progress)
    step = _native.number("dt", dt)
    if not 0 < step <= end:
        raise InputError(f"dt = {step:g}: must be greater than 0 and not exceed t_end = {end:g}")
    n = math.ceil(end / step * (1 - 1e-12))
    _native.integer("t_end / dt", n, 1, _MAX_STEPS)
    run = _Run(system, nodes, state, end / n)
    return run.steps(n, every, keep, progress)


def _by_tolerance(
    system: Pendulum,
    end: float,
    state: FloatArray,
    nodes: int,
    tolerance: float,
    every: int,
    keep: str,
    progress: bool,
) -> Trajectory:
    wanted = _native.number("tolerance", tolerance)
    if not 1e-13 <= wanted <= 1:
        raise InputError(f"tolerance = {wanted:g}: must be in [1e-13, 1]")
    fastest = max(*system.natural_frequencies(), system.p1, system.p2, system.p3)
    n = every * max(1, math.ceil(end * fastest / (0.5 * math.pi) / every))
    factor, coarse = 1, _Run(system, nodes, state, end / n).steps(n, every, keep, progress)
    for _ in range(12):
        factor *= 2
        fine = _Run(system, nodes, state, end / (n * factor)).steps(
            n * factor, every * factor, keep, progress
        )
        if "completed" == coarse.outcome == fine.outcome:
            change = float(np.abs(fine.state - coarse.state).max())
            if change <= wanted:
                return Trajectory(**{**vars(fine), "error": change})
        elif coarse.outcome == fine.outcome == "unphysical":
            return fine
        coarse = fine
    raise InputError(
        f"tolerance = {wanted:g}: not met with {n * factor} steps (states still change by "
        f"{np.abs(fine.state[-1] - coarse.state[-1]).max():.1e} or the run fails); the motion may "
        "be chaotic: take a shorter run or a larger tolerance"
    )


def _go_on(
    system: Pendulum, end: float, earlier: Trajectory, every: int, keep: str, progress: bool
) -> Trajectory:
    if earlier.outcome != "completed":
        raise InputError(f"resume: that run ended {earlier.outcome!r}, must be 'completed'")
    run = _Run(system, **earlier._resume)
    n = round((end - run.time) / run.h)
    if n < 1 or abs(run.time + n * run.h - end) > 1e-9 * max(abs(end), run.h):
        raise InputError(
            f"t_end = {end:g}: must be a whole number of steps {run.h:g} after {run.time:g}"
        )
    return run.steps(n, every, keep, progress)


class _Run:
    """A run that can go on: the native state and how far it has come."""

    def __init__(
        self,
        system: Pendulum,
        nodes: int,
        state: FloatArray,
        h: float,
        done: int = 0,
        memory: FloatArray | None = None,
    ) -> None:
        self.system, self.nodes, self.state, self.h, self.done = system, nodes, state, h, done
        self.memory = memory

    @property
    def time(self) -> float:
        return self.done * self.h

    def steps(self, n: int, every: int, keep: str, progress: bool) -> Trajectory:
        """Make n steps."""
        first, start, parts = self.state, self.done, []
        evaluations, ended = 0, 0
        piece = max(CHUNK // every, 1) * every
        left = n
        with tqdm(total=n, unit=" steps", disable=not progress, leave=False) as bar:
            while left and not ended:
                count = min(piece, left)
                columns = count // every if keep == "all" else 0
                resume = self.memory is not None
                states, kept, made, ended, evaluated = _native.call(
                    core.pendulum_simulate,
                    self.system._flat,
                    self.nodes,
                    self.state,
                    0.0,
                    self.h,
                    _ROUNDING,
                    count,
                    every,
                    int(resume),
                    self.memory if resume else np.zeros(_MEMORY),
                    columns,
                )
                self.memory, self.done = kept, self.done + made
                self.state = np.stack([kept[:3], kept[3:6]], axis=1).ravel()
                evaluations += evaluated
                parts.append(states.T[: made // every])
                left -= count
                bar.update(made)
        if keep == "all":
            kept_states = np.concatenate([first[np.newaxis], *parts])
            t = np.multiply(start + every * np.arange(kept_states.shape[0]), self.h, dtype=float)
        else:
            kept_states, t = self.state[np.newaxis], np.array([self.time])
        return Trajectory(
            t=t,
            state=kept_states,
            outcome=OUTCOMES[ended],
            t_reached=self.time,
            dt=self.h,
            error=None,
            stats={"steps": self.done - start, "evaluations": evaluations},
            dof_names=self.system.dof_names,
            _resume={
                "nodes": self.nodes,
                "state": self.state,
                "h": self.h,
                "done": self.done,
                "memory": self.memory,
            },
        )
