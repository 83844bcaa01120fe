"""Periodic motions in time: shooting with located switches."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.analyses.accuracy import Accuracy
from viscovib.analyses.period_map import Found, PeriodMap, Ran
from viscovib.analyses.runs import starting_state
from viscovib.analyses.whole_structure import check_outside
from viscovib.common.counts import things
from viscovib.errors import ConvergenceWarning, caller
from viscovib.results.steady_motion import SteadyMotion
from viscovib.systems.load import LoadLike
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.structure import Structure

_EPS = float(np.finfo(float).eps)
#: Rounding error of a state at the end of a period, as a part of the largest.
_LEFT = 8.0
#: Periods from rest, before Newton's method begins and where it has failed.
_SETTLING = (30, 100, 400)
#: How often steps are made 16 times shorter that do not lead on from rest.
_SHORTER = 3
#: Doublings of the number of steps, and how many may fail before it is given up.
_DOUBLINGS, _FAILURES = 12, 3
#: Multipliers as large as this part of the largest decide with it.
_LEADING = 0.9
MOST_PERIODS = 64
#: States kept of a period at least.
SHOWN = 256


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


def steady_motion(
    system: PolynomialSystem | Structure,
    nu: float,
    *,
    load: LoadLike | None = None,
    initial: npt.ArrayLike | SteadyMotion | None = None,
    n_periods: int = 1,
    method: str = "auto",
    tolerance: float | None = None,
    rtol: float | None = None,
    atol: float | None = None,
) -> SteadyMotion:
    """Find a periodic motion in time by shooting. Steps end where laws switch.

    Newton's method finds the state that repeats after a number of load periods. There is no
    expansion in harmonics, so a gap, an impact or dry friction that sticks is as accurate as a
    smooth law. The derivatives across switches give the Floquet multipliers.

    Parameters
    ----------
    system : PolynomialSystem or Structure
        With at most 512 coordinates (time grows with the cube of their number); with memory, if its
        kernels are sums of exponentials; without hysteresis elements (`Jenkins`, `Iwan`, `BoucWen`,
        `Dahl`: see `forced_response`).
    nu : float
        Circular frequency of the load (rad/s).
    load
        As for `simulate`.
    initial : array_like, shape (2 n_dof,), or SteadyMotion
        Initial guess of the state at t = 0: each coordinate with its velocity. If several periodic
        motions exist, stable or not, a nearby one is found. None: the state of the motion from rest
        after 30 periods, or later if this fails.
    n_periods : int
        Number of load periods after which the motion repeats, 1 to 64: 2 after a period doubling. A
        nearby motion with a shorter period may be found: see `repeats_after`.
    method : {"auto", "gauss8", "gauss16"}
        As for `simulate`; "auto" is "gauss8". "gauss16" for at most 6 coordinates without memory.
    tolerance : float
        Absolute error of the state at t = 0, velocities divided by ``nu``, 1e-13 to 1
        (default: 1e-10 times the largest entry): the step size is halved until the state no longer
        changes.
    rtol, atol : float
        Instead of ``tolerance``: atol + rtol times the largest entry.

    Returns
    -------
    SteadyMotion

    Warns
    -----
    ConvergenceWarning
        If no motion was found, or if the tolerance is not reached.

    Notes
    -----
    With the map P of a state over the period Newton's steps are (1 - P')^-1 (P(y) - y). P' is the
    derivative of the collocation times the jump of perturbations at each switch (Aizerman and
    Gantmakher 1958; see `SteadyMotion.multipliers`). At a grazing contact the map has a square
    root: Newton's method converges slowly near it, and a different motion may lie beyond it.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> friction = vv.PolynomialSystem(mass=1, stiffness=1, forces="0.7*sign(x_dot)")
    >>> motion = vv.steady_motion(friction, 0.4, load=1.0)
    >>> motion.stable, bool(np.abs(motion.multipliers[-1]) < 1e-9)  # it sticks on the way
    (True, True)
    """
    periods = _native.integer("n_periods", n_periods, 1, MOST_PERIODS)
    wanted = Accuracy.checked(tolerance, rtol, atol, 1e-10)
    assert wanted is not None
    mapping = PeriodMap.checked(system, load, nu, periods, method)
    found = begin_at(system, mapping, initial, wanted)
    motion = motion_of(system, mapping, found)
    if motion.outcome != "converged":
        warnings.warn(
            f"steady_motion: {motion.outcome}: no motion was found that repeats after "
            f"{things(periods, 'period')} (the last try is {found.found.correction:.1e} off); give "
            "a nearer initial state, or another n_periods",
            ConvergenceWarning,
            stacklevel=caller(),
        )
    elif motion.error > allowed_of(wanted, mapping, found.found.state):
        warnings.warn(
            f"steady_motion: the error {motion.error:.1e} is above {wanted}: rounding is enlarged "
            f"{found.found.enlarged:.1e} times in the motion that repeats",
            ConvergenceWarning,
            stacklevel=caller(),
        )
    return motion


def begin_at(
    system: PolynomialSystem | Structure,
    mapping: PeriodMap,
    initial: npt.ArrayLike | SteadyMotion | None,
    wanted: Accuracy,
) -> Refined:
    """Find a motion from a state nearby, or from rest."""
    if initial is None:
        return _from_rest(mapping, wanted)
    return refine(mapping, _start_at(system, mapping, initial), wanted)


def _start_at(
    system: PolynomialSystem | Structure,
    mapping: PeriodMap,
    initial: npt.ArrayLike | SteadyMotion,
) -> FloatArray:
    """Return the state to begin with; what is remembered is 0 unless it is known."""
    remembered = np.zeros(mapping.hidden)
    if isinstance(initial, SteadyMotion):
        if initial.remembered.size == remembered.size:
            remembered = initial.remembered
        initial = initial.state[0]
    state = starting_state(initial, mapping.n_dof, system.dof_names)
    if isinstance(system, Structure):
        check_outside(system, state)
    return np.concatenate([state, remembered])


def _from_rest(mapping: PeriodMap, wanted: Accuracy) -> Refined:
    """Let the motion from rest settle before Newton's method."""
    state = np.zeros(mapping.size)
    one = replace(mapping, n_periods=1)
    found = None
    for periods in _SETTLING:
        for _ in range(periods):
            ran = _one_period(one, state)
            if ran.outcome != "completed":
                break
            state = ran.last
        found = refine(mapping, state, wanted)
        if found.found.outcome == "converged":
            break
    assert found is not None
    return found


def _one_period(one: PeriodMap, state: FloatArray) -> Ran:
    """A period in few steps; from rest against a stop only short ones lead on."""
    ran = one.run(state, one.first_steps, beside=False)
    for k in range(1, _SHORTER + 1):
        if ran.outcome != "step too large":
            break
        ran = one.run(state, 16**k * one.first_steps, beside=False)
    return ran


def allowed_of(wanted: Accuracy, mapping: PeriodMap, state: FloatArray) -> float:
    """Error allowed, as `weights` measure states."""
    size = float(np.abs(mapping.weights * state).max(initial=0.0))
    return wanted.absolute + wanted.relative * size


def refine(mapping: PeriodMap, start: FloatArray, wanted: Accuracy, steps: int = 0) -> Refined:
    """Double the steps until the state that comes back changes by no more than is wanted.

    The last two runs differ by one step, so that no place of a switch in its step is common to
    both. What these differ by is taken for the error.
    """
    steps = steps or mapping.first_steps
    latest: Found | None = None
    failures = iterations = 0
    for _ in range(_DOUBLINGS):
        begin = start if latest is None else latest.state
        tolerance = allowed_of(wanted, mapping, begin)
        found = mapping.solve(begin, steps, tolerance)
        iterations += found.iterations
        if found.outcome != "converged":
            failures += 1
            if failures >= _FAILURES:
                return _judged(mapping, found, None, steps, iterations)
            steps *= 2
            continue
        tolerance = max(allowed_of(wanted, mapping, found.state), _rounding(mapping, found))
        if latest is not None and _apart(mapping, latest, found) <= tolerance:
            other = mapping.solve(found.state, steps + 1, tolerance)
            iterations += other.iterations
            if other.outcome == "converged" and _apart(mapping, found, other) <= tolerance:
                told = _judged(mapping, other, found, steps + 1, iterations)
                size = float(np.abs(mapping.weights * other.state).max(initial=0.0))
                if told.error <= max(size, allowed_of(wanted, mapping, other.state)):
                    return told
                # Rounding alone is larger than the motion, as at the resonance of what is undamped.
                return told._replace(found=other._replace(outcome="stalled"))
        latest = found
        steps *= 2
    return _judged(mapping, found._replace(outcome="stalled"), None, steps // 2, iterations)


def _apart(mapping: PeriodMap, one: Found, other: Found) -> float:
    return float(np.abs(mapping.weights * (one.state - other.state)).max())


def _rounding(mapping: PeriodMap, found: Found) -> float:
    """What rounding on the way leaves of the state that comes back."""
    size = float(np.abs(mapping.weights * found.state).max(initial=0.0))
    return _LEFT * _EPS * size * max(1.0, found.enlarged)


def _judged(
    mapping: PeriodMap, found: Found, other: Found | None, steps: int, iterations: int
) -> Refined:
    """Errors of what was found, by another run."""
    multipliers = mapping.multipliers(found.by_start)
    if other is None:
        return Refined(found, steps, float("nan"), multipliers, float("nan"), iterations)
    error = _apart(mapping, found, other) + found.correction * _EPS + _rounding(mapping, found)
    return Refined(
        found, steps, error, multipliers, _multiplier_error(found, other, mapping), iterations
    )


def judged(mapping: PeriodMap, state: FloatArray, steps: int, correction: float) -> Refined:
    """Errors of a state that comes back in so many steps, by twice as many and one."""
    one, other = (mapping.run(state, n) for n in (steps, 2 * steps + 1))
    step, enlarged = mapping.step_back(one.by_start, other.last - one.last)
    outcome = "converged" if one.outcome == other.outcome == "completed" else "stalled"
    found = Found(state, one.by_start, one.passed, outcome, 0, correction, enlarged)
    beside = found._replace(state=state + step, by_start=other.by_start)
    told = _judged(mapping, found, beside, steps, 0)
    # The last correction may have been found on the other side of grazing: what is left counts.
    left, _ = mapping.step_back(one.by_start, one.last - state)
    off = float(np.abs(mapping.weights * left).max())
    return told._replace(error=told.error + max(correction, off))


def _multiplier_error(found: Found, other: Found, mapping: PeriodMap) -> float:
    """Of the multipliers that decide: what the other run changes, and rounding.

    An eigenvalue moves with its matrix by its condition, |left| |right| of its eigenvectors.
    """
    weights = mapping.weights
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
    weights, state = mapping.weights, found.found.state
    size = float(np.abs(weights * state).max(initial=0.0))
    for periods in range(1, mapping.n_periods):
        if mapping.n_periods % periods or found.found.outcome != "converged":
            continue
        part = replace(mapping, n_periods=periods)
        ran = part.run(state, math.ceil(found.steps * periods / mapping.n_periods))
        if ran.outcome != "completed":
            continue
        step, enlarged = part.step_back(ran.by_start, ran.last - state)
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
    ran = mapping.run(found.found.state, found.steps, times=t, beside=False)
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
