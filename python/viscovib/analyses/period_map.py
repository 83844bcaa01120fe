"""The map of one or more periods of the load in time: where a start leads, and its neighbours.

Steps end where laws switch, and what small disturbances become goes with the motion in the core:
along steps by the derivative of the collocation, across switches by saltation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.analyses.memoryless import (
    MAX_DOF,
    METHODS,
    MOST_IN_FRAME,
)
from viscovib.analyses.runs import MAX_FIRST_STEPS, ROUNDING, nothing
from viscovib.analyses.whole_structure import check_whole
from viscovib.bodies.body import Body
from viscovib.errors import InputError
from viscovib.results.trajectory import OUTCOMES
from viscovib.systems.load import LoadLike, load_series, name_places
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.structure import Structure
from viscovib.systems.whole import n_hidden, whole_system

#: The fastest linear motion has so many steps a period at first, and any period of the load.
_FIRST, _LEAST = 4, 4
_EPS = float(np.finfo(float).eps)
#: Iterations of Newton's method, and halvings of one of its steps.
_MOST_TURNS, _MOST_HALVINGS = 30, 8
#: Rounding error of a state at the end of a period, as a part of the largest.
_LEFT = 8.0


class Ran(NamedTuple):
    """A motion over the whole time of the map."""

    last: FloatArray
    #: Derivatives of the last state by the first; 0 if they were not followed.
    by_start: FloatArray
    #: States at the times asked for, as many as were reached, without what is remembered.
    at_times: FloatArray
    #: Surfaces on which laws switch that were passed.
    passed: int
    outcome: str
    reached: float


class Found(NamedTuple):
    """What Newton's method made of a start."""

    state: FloatArray
    by_start: FloatArray
    passed: int
    outcome: str
    iterations: int
    correction: float
    #: By how much what is left of the map is enlarged in its fixed point.
    enlarged: float


def _fastest_of_many(system: PolynomialSystem) -> float:
    """Upper bound of the rates of a linear rest of more coordinates."""
    fastest: float = _native.run("motion fastest rate", system._handle)["fastest"]
    return fastest


def check_mapped(system: object) -> None:
    """Refuse a system whose motions are not repeated in time."""
    if not isinstance(system, (PolynomialSystem, Structure)):
        raise InputError(
            f"system = {_native.shown(system)}: must be a PolynomialSystem or a Structure "
            "(of others see forced_response and trace_response)"
        )


@dataclass(frozen=True)
class PeriodMap:
    """From a state at t = 0 to that after so many periods of the load.

    A state are coordinates and velocities by turns, then the rates of what is remembered.
    """

    flat: FloatArray
    orders: npt.NDArray[np.int32]
    series: ComplexArray
    nu: float
    n_periods: int
    n_dof: int
    hidden: int
    fastest: float
    method: str

    @classmethod
    def checked(
        cls,
        system: PolynomialSystem | Structure,
        load: LoadLike | None,
        nu: float,
        n_periods: int,
        method: str,
    ) -> PeriodMap:
        """Check what is given; nothing is computed yet."""
        check_mapped(system)
        if isinstance(system, Body) or getattr(system, "_turns", False):
            raise InputError("system: is a Body, must be a PolynomialSystem or a Structure")
        whole = system
        if isinstance(system, Structure):
            check_whole(system)
            whole = whole_system(system)
        assert isinstance(whole, PolynomialSystem)
        n = len(whole.dof_names)
        if n > MOST_IN_FRAME:
            raise InputError(f"system: has {n} coordinates, must have at most {MOST_IN_FRAME}")
        hidden, fitted = n_hidden(whole)
        if hidden < 0 or fitted or n + hidden > MOST_IN_FRAME:
            raise InputError(
                "system: has kernels that are no sums of exponentials, or too many of these: take "
                "their sum_of_exponentials(), or forced_response"
            )
        sections = n > MAX_DOF or hidden > 0
        allowed = ("auto", "gauss8") if sections else ("auto", "gauss8", "gauss16")
        name = _native.choice("method", method, allowed)
        if load is None:
            raise InputError("load: must be given: its period is that of the motion")
        frequency = _native.number("nu", nu)
        if frequency <= 0:
            raise InputError(f"nu = {frequency:g}: must be greater than 0")
        named = None if isinstance(load, float) else name_places(whole.dof_names)
        orders, series = load_series(load, None, n, named)
        acting = [int(k) for k, one in zip(orders, series[:-1].T, strict=True) if np.any(one)]
        linear = whole._fastest() if n <= MAX_DOF else _fastest_of_many(whole)
        fastest = max(linear, frequency * max(acting, default=1))
        return cls(
            whole._flat, orders, series, frequency, n_periods, n, hidden, fastest,
            "gauss8" if name == "auto" else name,
        )  # fmt: skip

    @property
    def period(self) -> float:
        """Of the motion."""
        return 2 * math.pi * self.n_periods / self.nu

    @property
    def size(self) -> int:
        """Numbers of a state."""
        return 2 * self.n_dof + self.hidden

    @cached_property
    def system_in_core(self) -> _native.Handle:
        """The system in the core."""
        return _native.polynomial_object(self.flat)

    @property
    def weights(self) -> FloatArray:
        """Velocities comparable with displacements: divided by the frequency of the load."""
        weights = np.full(self.size, 1 / self.nu)
        weights[: 2 * self.n_dof : 2] = 1.0
        return weights

    @property
    def first_steps(self) -> int:
        """How many steps a search for them begins with."""
        many = _FIRST * self.period * self.fastest / (2 * math.pi)
        if many > MAX_FIRST_STEPS:
            raise InputError(
                f"nu = {self.nu:g}: takes {many:.1e} steps of the fastest motion, must be at most "
                f"{MAX_FIRST_STEPS:g}: take a faster load, or softer springs"
            )
        return max(_LEAST * self.n_periods, math.ceil(many))

    def run(
        self,
        state: FloatArray,
        steps: int,
        times: FloatArray | None = None,
        beside: bool = True,
    ) -> Ran:
        """Make the motion from a state, in so many steps, optionally with its derivatives."""
        found = _native.run_either(
            steps > _native.MANY_STEPS, "motion of a period", self.system_in_core,
            orders=self.orders, series=self.series, nu=float(self.nu),
            method=METHODS[self.method], thin=min(1.0, self.first_steps / steps),
            h=self.period / steps, n_steps=steps, tolerance=ROUNDING, begin=state,
            times=nothing(0) if times is None else times, neighbours=beside,
        )  # fmt: skip
        outcome = OUTCOMES[found["ended"]]
        if outcome == "completed" and beside and not found["known"]:
            outcome = "grazing"
        return Ran(
            found["last"], found["by_start"], found["at_times"].T[: found["n_reached"]],
            found["n_passed"], outcome, found["reached"],
        )  # fmt: skip

    def step_back(self, by_start: FloatArray, rest: FloatArray) -> tuple[FloatArray, float]:
        """Newton's step (1 - P')^-1 rest to a state that comes back, and how much it enlarges.

        In the units of `weights`, so that no unit of time makes a small singular value of it.
        """
        weights = self.weights
        balanced = weights[:, None] * (np.eye(self.size) - by_start) / weights
        inverse = np.linalg.pinv(balanced, rcond=_EPS)
        step = inverse @ (weights * rest) / weights
        return step, float(np.abs(inverse).sum(axis=1).max())

    def solve(self, start: FloatArray, steps: int, tolerance: float) -> Found:
        """Newton's method for a state that comes back; corrections are measured by `weights`."""
        state, weights = start, self.weights
        ran = self.run(state, steps)
        if ran.outcome != "completed":
            outcome = "diverged" if ran.outcome == "diverged" else "stalled"
            return Found(state, ran.by_start, ran.passed, outcome, 0, math.inf, math.inf)
        last_size, correction = math.inf, math.inf
        for turn in range(1, _MOST_TURNS + 1):
            rest = ran.last - state
            step, enlarged = self.step_back(ran.by_start, rest)
            correction = float(np.abs(weights * step).max())
            size = float(np.abs(weights * state).max())
            floor = _LEFT * _EPS * size * max(1.0, enlarged)
            done = correction <= max(1e-3 * tolerance, floor) or (
                correction <= tolerance and correction > 0.5 * last_size
            )
            last_size = correction
            ahead = self._ahead(state, step, rest, steps, done)
            if ahead is None:
                return Found(state, ran.by_start, ran.passed, "stalled", turn, correction, enlarged)
            state, ran = ahead
            if done:
                return Found(
                    state, ran.by_start, ran.passed, "converged", turn, correction, enlarged
                )
        return Found(state, ran.by_start, ran.passed, "stalled", _MOST_TURNS, correction, math.inf)

    def _ahead(
        self, state: FloatArray, step: FloatArray, rest: FloatArray, steps: int, done: bool
    ) -> tuple[FloatArray, Ran] | None:
        """A step of Newton's method, as much of it as lowers what is left; None: none does."""
        before = float(np.abs(self.weights * rest).max())
        part = 1.0
        for _ in range(_MOST_HALVINGS):
            moved = state + part * step
            ran = self.run(moved, steps)
            if ran.outcome == "completed":
                left = float(np.abs(self.weights * (ran.last - moved)).max())
                if done or left <= (1 - 0.25 * part) * before:
                    return moved, ran
            part *= 0.5
        return None

    def multipliers(self, by_start: FloatArray) -> ComplexArray:
        """Floquet multipliers, the largest first."""
        found = np.linalg.eigvals(by_start).astype(complex)
        return np.asarray(found[np.argsort(-np.abs(found), kind="stable")])
