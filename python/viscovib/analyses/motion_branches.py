"""Branches of periodic motions in time: pseudo-arclength continuation of the map of a period.

`motion_path` contains the continuation, `motion_crossings` the bifurcation points.
"""

from __future__ import annotations

import warnings
from functools import partial
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.accuracy import Accuracy
from viscovib.analyses.following import _Way
from viscovib.analyses.motion_crossings import errors_of, events
from viscovib.analyses.motion_errors import (
    Refined,
    judged,
    motion_of,
    repeats_after,
    weights_of,
)
from viscovib.analyses.motion_path import MotionPath, MotionPoint
from viscovib.analyses.period_map import PeriodMap, check_mapped
from viscovib.analyses.shooting import MOST_PERIODS, search
from viscovib.common.counts import things
from viscovib.errors import ConvergenceWarning, InputError, caller
from viscovib.results.curves import Crossing
from viscovib.results.motion_branch import MotionBranch
from viscovib.results.steady_motion import SteadyMotion
from viscovib.systems.load import LoadLike
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.structure import Structure

#: Steps along the branch: the first, the longest and the shortest, in units of z.
_FIRST_STEP, _SHORTEST = 0.005, 1e-9
#: Steps so short may be at a corner.
_CORNER = 1e-7
#: Cosine of the angle between two tangents: shorter steps below, longer ones above.
_BENT, _STRAIGHT = 0.97, 0.998
#: Iterations after which steps may become longer.
_EASY = 4


def trace_motion(
    system: PolynomialSystem | Structure,
    nu_range: tuple[float, float] | None = None,
    *,
    load: LoadLike | None = None,
    nu: float | None = None,
    load_range: tuple[float, float] | None = None,
    vary: str | None = None,
    vary_range: tuple[float, float] | None = None,
    initial: npt.ArrayLike | SteadyMotion | None = None,
    n_periods: int = 1,
    method: str = "auto",
    max_step: float = 0.02,
    max_points: int = 2000,
    tolerance: float | None = None,
    rtol: float | None = None,
    atol: float | None = None,
) -> MotionBranch:
    """Follow periodic motions along a parameter, in time, through folds.

    This is `trace_response` by shooting (`steady_motion`): steps end where laws switch, so folds,
    period doublings, Neimark-Sacker points and grazing are located as accurately as with smooth
    laws.

    Parameters
    ----------
    system, load, initial, n_periods, method, tolerance, rtol, atol
        As for `steady_motion`, which finds the motion at the start of the range.
    nu_range, nu, load_range, vary, vary_range
        The parameter that varies and its range, as for `trace_response`; ``vary`` for a
        `PolynomialSystem`.
    max_step : float
        Largest step along the branch, 1e-6 to 0.5: the change of the parameter relative to its
        range, and of the state relative to its size.
    max_points : int
        Largest number of points, 2 to 100000.

    Returns
    -------
    MotionBranch

    Warns
    -----
    ConvergenceWarning
        If no step continues the branch, if a bifurcation point could not be located, or if errors
        exceed the tolerance.

    Notes
    -----
    Pseudo-arclength continuation (Keller 1977) of P(y, p) = y. The test functions between two
    points are: for a fold the component of the tangent along the parameter, for a branch point the
    determinant of the derivatives with the tangent, for a period doubling det(P' + 1), for a
    Neimark-Sacker point the product of m_i m_j - 1 over the multipliers with a complex pair
    (Kuznetsov, Elements of Applied Bifurcation Theory, 10.2), for grazing the number of switches.
    If more multipliers cross the unit circle than these functions explain, the step is halved. At
    grazing of a rigid stop the branch has a corner. It continues where the derivatives behind the
    corner vanish, in the direction that keeps the sign of their determinant. Two changes between
    two points may be missed: use a smaller ``max_step``.

    Examples
    --------
    >>> import viscovib as vv
    >>> duffing = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="x^3")
    >>> vv.trace_motion(duffing, (0.5, 2.0), load=0.3).folds.size
    2
    """
    check_mapped(system)
    ranges = {"nu_range": nu_range, "load_range": load_range, "vary_range": vary_range}
    if vary is not None and isinstance(system, Structure):
        raise InputError(f"vary = {vary!r}: is for a PolynomialSystem here, see trace_response")
    way = _Way.checked(system, ranges, nu, vary, load, None)
    periods = _native.integer("n_periods", n_periods, 1, MOST_PERIODS)
    wanted = Accuracy.checked(tolerance, rtol, atol, 1e-10)
    assert wanted is not None
    longest = _native.number("max_step", max_step)
    if not 1e-6 <= longest <= 0.5:
        raise InputError(f"max_step = {longest:g}: must be 1e-6 to 0.5")
    most = _native.integer("max_points", max_points, 2, 100_000)
    mapping = PeriodMap.checked(system, load, way.fixed, periods, method)
    path = MotionPath(mapping, way, 0, 1.0, 1.0)
    begun = search(system, path.at(way.start), initial, wanted)
    if begun["outcome"] != 0:
        raise InputError(
            f"{way.argument}: no motion was found at its beginning {way.start:g} that repeats "
            f"after {periods} of its load's periods: give another initial, or begin elsewhere"
        )
    state = begun["begin"]
    weighed = np.abs(weights_of(mapping) * state).max(initial=0.0)
    path = MotionPath(
        mapping, way, begun["n_steps"], float(weighed) or 1.0, _allowed_of(wanted, mapping, state)
    )
    points, outcome = _follow(path, state, longest, most)
    if not points:
        raise InputError(
            f"{way.argument}: the motion at its beginning {way.start:g} cannot be followed: others "
            "are next to it there, as where friction holds a mass for good, or at a fold: begin "
            "elsewhere"
        )
    branch = _branch(system, path, points, outcome, periods)
    _warn_of_doubts(branch, path, points, wanted)
    return branch


def _allowed_of(wanted: Accuracy, mapping: PeriodMap, state: FloatArray) -> float:
    """Error allowed, velocities divided by the frequency of the load."""
    size = float(np.abs(weights_of(mapping) * state).max(initial=0.0))
    return wanted.absolute + wanted.relative * size


def _warn_of_doubts(
    branch: MotionBranch, path: MotionPath, points: list[MotionPoint], wanted: Accuracy
) -> None:
    """Tell why a branch ends early, what is not located, and where errors are above the wanted."""
    at, told = path.way.varies, []
    if branch.outcome == "stuck":
        told.append(
            f"the branch ends at {at} = {branch.parameter[-1]:.9g}: no step leads on"
            + path.switches_ahead(points[-1])
        )
    if branch._lost:
        told.append(f"{things(branch._lost, 'place')} on the way could not be located (nan, None)")
    allowed = [
        _allowed_of(wanted, path.mapping, point.z[:-1] * path.units[:-1]) for point in points
    ]
    above = np.flatnonzero(~(branch.error <= allowed))
    if above.size:
        worst = int(above[np.nan_to_num(branch.error[above], nan=np.inf).argmax()])
        told.append(
            f"the error is above {wanted} at {things(above.size, 'point')}, most "
            f"({branch.error[worst]:.1e}) at {at} = {branch.parameter[worst]:.9g}: steps are those "
            "of the beginning of the branch: give a smaller tolerance, or begin there"
        )
    for sentence in told:
        warnings.warn(f"trace_motion: {sentence}", ConvergenceWarning, stacklevel=caller())


def _follow(
    path: MotionPath, state: FloatArray, longest: float, most: int
) -> tuple[list[MotionPoint], str]:
    """Points from the beginning of the range to its end."""
    way, units = path.way, path.units
    ahead = 1.0 if way.finish > way.start else -1.0
    across = np.eye(state.size + 1)[-1]
    first = path.correct(np.append(state, way.start) / units, across)
    if first is None:
        return [], "stuck"
    points = [first._replace(tangent=first.tangent * ahead * np.sign(first.tangent[-1]))]
    step = min(_FIRST_STEP, longest)
    end = way.finish / units[-1]
    at_corner: MotionPoint | None = None
    while len(points) < most:
        here = points[-1]
        new = path.correct(here.z + step * here.tangent, here.tangent)
        cosine = -1.0 if new is None else _cosine(here, new)
        # Another part of the branch, that runs the other way, is no branch point.
        if new is not None and here.turn_of_way != new.turn_of_way:
            new = new if step <= _FIRST_STEP and new.passed == here.passed else None
        # Near a kink the tangent turns for any step size.
        if new is None or (cosine < _BENT and step > 1e3 * _SHORTEST):
            step *= 0.5
            if step < _CORNER and here is not at_corner:
                at_corner = here
                new = path.round_corner(here)
                if new is not None:
                    points.append(new)
                    step = _CORNER
            if step < _SHORTEST:
                return points, "stuck"
            continue
        if ahead * (new.z[-1] - end) >= 0:
            last = path.correct(
                here.z + (new.z - here.z) * (end - here.z[-1]) / (new.z[-1] - here.z[-1]), across
            )
            if last is None:
                return points, "stuck"
            if last.tangent @ here.tangent < 0:
                last = last._replace(tangent=-last.tangent)
            last.z[-1] = end
            return [*points, last], "completed"
        if ahead * (new.z[-1] - way.start / units[-1]) < 0:
            return points, "completed"
        points.append(new)
        # Where motions are larger than at the beginning, steps are as much longer.
        if cosine > _STRAIGHT and new.turns <= _EASY:
            step = min(1.6 * step, longest * max(1.0, float(np.abs(new.z[:-1]).max())))
    return points, "points"


def _cosine(one: MotionPoint, other: MotionPoint) -> float:
    """Of the largest angle between the tangents of two points and the way from one to the other."""
    chord = other.z - one.z
    chord = chord / np.linalg.norm(chord)
    return float(min(one.tangent @ other.tangent, one.tangent @ chord, other.tangent @ chord))


def _branch(
    system: PolynomialSystem | Structure,
    path: MotionPath,
    points: list[MotionPoint],
    outcome: str,
    n_periods: int,
) -> MotionBranch:
    """Make the result: errors by another number of steps, crossings, extremes."""
    n, units = 2 * path.mapping.n_dof, path.units
    values = np.array([point.z[-1] * units[-1] for point in points])
    refined: list[Refined] = []
    lows, highs, sooner = [], [], []
    for point, p in zip(points, values, strict=True):
        mapping, state = path.at(float(p)), point.z[:-1] * units[:-1]
        one = judged(mapping, state, path.steps, point.correction * path.size)
        refined.append(one)
        sooner.append(repeats_after(mapping, one))
        low, high = path.reach(point)
        lows.append(low)
        highs.append(high)
    folds, grazings, crossings, marks = [], [], [], []
    fold_errors, grazing_errors = [], []
    for i, (before, behind) in enumerate(pairwise(points)):
        blur = max(one.multiplier_error for one in refined[i : i + 2])
        sure = None not in (refined[i].stable, refined[i + 1].stable)
        found = events(path, before, behind, blur)
        for event, off in zip(found, errors_of(path, before, behind, blur, found), strict=True):
            place = None if event.point is None else float(event.point.z[-1] * units[-1])
            error = float(off * units[-1])
            if event.point is not None and place is not None:
                marks.append((event.kind, place, path.reach(event.point)[1]))
            if event.kind == "fold":
                folds.append(np.nan if place is None else place)
                fold_errors.append(error)
            if event.kind == "grazing":
                grazings.append(np.nan if place is None else place)
                grazing_errors.append(error)
            else:
                told = None if place is None else error
                crossings.append(Crossing(event.kind, i, place, sure=sure, error=told))
    makers = [
        partial(motion_of, system, path.at(float(p)), one)
        for p, one in zip(values, refined, strict=True)
    ]
    return MotionBranch(
        varies=path.way.varies,
        parameter=values,
        nu=path.way.nu(values),
        state=np.array([one.found.state[:n] for one in refined]).reshape(-1, n),
        smallest=np.array(lows),
        largest=np.array(highs),
        multipliers=np.array([one.multipliers for one in refined]),
        stable=np.array([one.stable for one in refined], dtype=object),
        passages=np.array([point.passed for point in points], dtype=np.int64),
        error=np.array([one.error for one in refined]),
        folds=np.array(folds),
        fold_errors=np.array(fold_errors),
        grazings=np.array(grazings),
        grazing_errors=np.array(grazing_errors),
        crossings=tuple(crossings),
        outcome=outcome,
        n_periods=n_periods,
        system=system,
        repeats_after=np.array(sooner, dtype=np.int64),
        _marks=tuple(marks),
        _points=tuple(makers),
    )
