"""Errors of the motions of a branch, from a different step size."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from viscovib._native import ComplexArray, FloatArray
from viscovib.analyses.period_map import PeriodMap
from viscovib.results.steady_motion import SteadyMotion
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.structure import Structure

_EPS = float(np.finfo(float).eps)
#: Rounding error of a state at the end of a period, as a part of the largest.
_LEFT = 8.0
#: Multipliers as large as this part of the largest decide with it.
_LEADING = 0.9
#: States kept of a period at least.
SHOWN = 256


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


class Refined(NamedTuple):
    """A periodic motion with a sufficiently small step size."""

    found: Found
    steps: int
    error: float
    multipliers: ComplexArray
    multiplier_error: float
    iterations: int

    @property
    def stable(self) -> bool | None:
        """True if perturbations decay; None: undecided."""
        if self.found.outcome != "converged" or not self.multipliers.size:
            return None
        largest = float(np.abs(self.multipliers[0]))
        return None if abs(largest - 1) <= self.multiplier_error else largest < 1


def step_back(
    mapping: PeriodMap, by_start: FloatArray, rest: FloatArray
) -> tuple[FloatArray, float]:
    """Newton's step (1 - P')^-1 rest to a state that comes back, and how much it enlarges."""
    weights = weights_of(mapping)
    balanced = weights[:, None] * (np.eye(rest.size) - by_start) / weights
    inverse = np.linalg.pinv(balanced, rcond=_EPS)
    step = inverse @ (weights * rest) / weights
    return step, float(np.abs(inverse).sum(axis=1).max())


def weights_of(mapping: PeriodMap) -> FloatArray:
    """Velocities comparable with displacements: divided by the frequency of the load."""
    weights = np.full(2 * mapping.n_dof + mapping.hidden, 1 / mapping.nu)
    weights[: 2 * mapping.n_dof : 2] = 1.0
    return weights


def _apart(mapping: PeriodMap, one: Found, other: Found) -> float:
    return float(np.abs(weights_of(mapping) * (one.state - other.state)).max())


def _rounding(mapping: PeriodMap, found: Found) -> float:
    """What rounding on the way leaves of the state that comes back."""
    size = float(np.abs(weights_of(mapping) * found.state).max(initial=0.0))
    return _LEFT * _EPS * size * max(1.0, found.enlarged)


def multipliers(by_start: FloatArray) -> ComplexArray:
    """Floquet multipliers, the largest first."""
    found = np.linalg.eigvals(by_start).astype(complex)
    return np.asarray(found[np.argsort(-np.abs(found), kind="stable")])


def _judged(
    mapping: PeriodMap, found: Found, other: Found | None, steps: int, iterations: int
) -> Refined:
    """Errors of what was found, by another run."""
    sizes = multipliers(found.by_start)
    if other is None:
        return Refined(found, steps, float("nan"), sizes, float("nan"), iterations)
    error = _apart(mapping, found, other) + found.correction * _EPS + _rounding(mapping, found)
    return Refined(found, steps, error, sizes, _multiplier_error(found, other, mapping), iterations)


def judged(mapping: PeriodMap, state: FloatArray, steps: int, correction: float) -> Refined:
    """Errors of a state that comes back in so many steps, by twice as many and one."""
    one, other = (mapping.run(state, n) for n in (steps, 2 * steps + 1))
    step, enlarged = step_back(mapping, one.by_start, other.last - one.last)
    outcome = "converged" if one.outcome == other.outcome == "completed" else "stalled"
    found = Found(state, one.by_start, one.passed, outcome, 0, correction, enlarged)
    beside = found._replace(state=state + step, by_start=other.by_start)
    told = _judged(mapping, found, beside, steps, 0)
    # The last correction may have been found on the other side of grazing: what is left counts.
    left, _ = step_back(mapping, one.by_start, one.last - state)
    off = float(np.abs(weights_of(mapping) * left).max())
    return told._replace(error=told.error + max(correction, off))


def _multiplier_error(found: Found, other: Found, mapping: PeriodMap) -> float:
    """Of the multipliers that decide: what the other run changes, and rounding.

    An eigenvalue moves with its matrix by its condition, |left| |right| of its eigenvectors.
    """
    weights = weights_of(mapping)
    balanced = weights[:, None] * found.by_start / weights
    change = weights[:, None] * (found.by_start - other.by_start) / weights
    values, right = np.linalg.eig(balanced)
    left = np.linalg.pinv(right)
    conditions = np.linalg.norm(left, axis=1) * np.linalg.norm(right, axis=0)
    leading = np.abs(values) >= _LEADING * np.abs(values).max(initial=0.0)
    moved = float(np.linalg.norm(change)) + _LEFT * _EPS * float(np.linalg.norm(balanced))
    return float(conditions[leading].max(initial=1.0)) * moved


def repeats_after(mapping: PeriodMap, found: Refined) -> int:
    """After how many periods of the load the motion comes back already, to its error.

    Newton's step of the map of a part of the time tells how far the nearest motion is that repeats
    after that part.
    """
    weights, state = weights_of(mapping), found.found.state
    size = float(np.abs(weights * state).max(initial=0.0))
    for periods in range(1, mapping.n_periods):
        if mapping.n_periods % periods or found.found.outcome != "converged":
            continue
        part = replace(mapping, n_periods=periods)
        ran = part.run(state, math.ceil(found.steps * periods / mapping.n_periods))
        if ran.outcome != "completed":
            continue
        step, enlarged = step_back(part, ran.by_start, ran.last - state)
        left = _LEFT * _EPS * size * max(1.0, enlarged)
        if float(np.abs(weights * step).max()) <= 2 * found.error + left:
            return periods
    return mapping.n_periods


def motion_of(
    system: PolynomialSystem | Structure, mapping: PeriodMap, found: Refined
) -> SteadyMotion:
    """Make the result, with the motion over one period."""
    n = 2 * mapping.n_dof
    parts = math.ceil(SHOWN / found.steps)
    t = np.linspace(0.0, mapping.period, parts * found.steps + 1)
    ran = mapping.run(found.found.state, found.steps, times=t, derivatives=False)
    return SteadyMotion(
        nu=mapping.nu,
        n_periods=mapping.n_periods,
        repeats_after=repeats_after(mapping, found),
        t=t[: ran.at_times.shape[0]],
        state=ran.at_times,
        remembered=found.found.state[n:].copy(),
        multipliers=found.multipliers,
        stable=found.stable,
        error=found.error,
        multiplier_error=found.multiplier_error,
        outcome=found.found.outcome,
        iterations=found.iterations,
        passages=found.found.passed,
        step=mapping.period / found.steps,
        method=mapping.method,
        system=system,
        _map=mapping,
    )
