"""Branches of motions that repeat, in time: pseudo-arclength continuation of the map of a period.

Points are z = (state, parameter), measured by the size of the first motion and by the range.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.analyses.accuracy import Accuracy
from viscovib.analyses.following import _Way
from viscovib.analyses.period_map import PeriodMap
from viscovib.analyses.shooting import (
    MOST_PERIODS,
    SHOWN,
    Refined,
    allowed_of,
    begin_at,
    judged,
    motion_of,
)
from viscovib.errors import InputError
from viscovib.results.curves import Crossing
from viscovib.results.motion_branch import MotionBranch
from viscovib.results.steady_motion import SteadyMotion
from viscovib.systems.load import LoadLike
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.structure import Structure

#: Steps along the branch: the first, the longest and the shortest, in units of z.
_FIRST_STEP, _SHORTEST = 0.005, 1e-9
#: Distance of differences by the parameter, as a part of it.
_APART = 1e-6
#: Cosine of the angle between two tangents: shorter steps below, longer ones above.
_BENT, _STRAIGHT = 0.97, 0.998
_MOST_TURNS, _EASY = 8, 4
#: Turns by which a crossing is located, and how near to each other its ends are then.
_LOCATING, _NEAR = 80, 1e-13
#: Multipliers whose imaginary part is more than this part of them are a pair.
_PAIRED = 1e-7


class _Point(NamedTuple):
    """A motion on the branch."""

    z: FloatArray
    tangent: FloatArray
    by_start: FloatArray
    passed: int
    correction: float
    turns: int

    @property
    def multipliers(self) -> ComplexArray:
        return np.asarray(np.linalg.eigvals(self.by_start).astype(complex))


@dataclass
class _Path:
    """What is followed: the map at each value of the parameter, in so many steps."""

    mapping: PeriodMap
    way: _Way
    steps: int
    size: float
    tolerance: float

    def at(self, p: float) -> PeriodMap:
        """The map at a value of what varies."""
        if self.way.varies == "nu":
            return replace(self.mapping, nu=p)
        if self.way.varies == "load_factor":
            return replace(self.mapping, series=self.mapping.series * p)
        assert self.way.numbers is not None
        return replace(self.mapping, flat=self.way.numbers.at(p))

    @property
    def units(self) -> FloatArray:
        """What a number of z is in the units of the state and the parameter."""
        reach = abs(self.way.finish - self.way.start)
        return np.append(self.size / self.mapping.weights, reach)

    def correct(self, guess: FloatArray, along: FloatArray) -> _Point | None:
        """The motion nearest to a guess across a direction; None: Newton's method finds none."""
        z, units, before = guess, self.units, np.inf
        for turn in range(1, _MOST_TURNS + 1):
            y, p = z[:-1] * units[:-1], float(z[-1] * units[-1])
            if self.way.varies == "nu" and p <= 0:
                return None
            h = _APART * max(abs(p), units[-1])
            here, left, right = (self.at(x).run(y, self.steps) for x in (p, p - h, p + h))
            if any(one.outcome != "completed" for one in (here, left, right)):
                return None
            by_p = (right.last - left.last) / (2 * h)
            matrix = np.zeros((z.size, z.size))
            matrix[:-1, :-1] = (here.by_start - np.eye(y.size)) * units[:-1] / units[:-1, None]
            matrix[:-1, -1] = by_p * units[-1] / units[:-1]
            matrix[-1] = along
            rest = np.append((here.last - y) / units[:-1], along @ (z - guess))
            try:
                both = np.linalg.solve(matrix, np.stack([-rest, np.eye(z.size)[-1]], axis=1))
            except np.linalg.LinAlgError:
                return None
            step, tangent = both.T
            correction = float(np.abs(step).max())
            if not np.isfinite(correction) or correction > max(2 * before, 1.0):
                return None
            z = z + step
            floor = 1e-3 * self.tolerance / self.size
            if correction <= floor or (correction <= 1e-11 and correction > 0.3 * before):
                tangent = tangent / np.linalg.norm(tangent)
                return _Point(z, tangent, here.by_start, here.passed, correction, turn)
            before = correction
        return None

    def between(self, one: _Point, other: _Point, part: float) -> _Point | None:
        """A point on the way from one to another."""
        chord = other.z - one.z
        return self.correct(one.z + part * chord, chord / np.linalg.norm(chord))


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
    """Follow motions that repeat with their load along a parameter, in time, through folds.

    As `trace_response`, but by shooting (`steady_motion`): where laws switch, steps end, so that
    folds, period doublings, Neimark-Sacker points and grazing are located as exactly as under
    smooth laws.

    Parameters
    ----------
    system, load, initial, n_periods, method, tolerance, rtol, atol
        As for `steady_motion`, which finds the motion at the beginning of the range.
    nu_range, nu, load_range, vary, vary_range
        What varies, from where and to where, as for `trace_response`; ``vary`` of a
        `PolynomialSystem`.
    max_step : float
        Longest step along the branch, 1e-6 to 0.5: changes of the parameter as a part of its range,
        those of the state as a part of its size.
    max_points : int
        Points at most, 2 to 100000.

    Returns
    -------
    MotionBranch

    Notes
    -----
    Pseudo-arclength continuation (Keller 1977) of P(y, p) = y. Between two points a fold is where
    the tangent has no part along the parameter, a branch point where det(P' - 1), a period doubling
    where det(P' + 1) is 0, a Neimark-Sacker point where a pair of multipliers is on the unit
    circle, grazing where the number of switches changes. What happens twice between two points is
    not seen: take a smaller ``max_step``.

    Examples
    --------
    >>> import viscovib as vv
    >>> duffing = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="x^3")
    >>> vv.trace_motion(duffing, (0.5, 2.0), load=0.3).folds.size
    2
    """
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
    path = _Path(mapping, way, 0, 1.0, 1.0)
    begun = begin_at(system, path.at(way.start), initial, wanted)
    if begun.found.outcome != "converged":
        raise InputError(
            f"{way.argument}: no motion was found at its beginning {way.start:g} that repeats "
            f"after {periods} of its load's periods: give another initial, or begin elsewhere"
        )
    weighed = np.abs(mapping.weights * begun.found.state).max(initial=0.0)
    path = _Path(
        mapping, way, begun.steps, float(weighed) or 1.0,
        allowed_of(wanted, mapping, begun.found.state),
    )  # fmt: skip
    points, outcome = _follow(path, begun.found.state, longest, most)
    return _branch(system, path, points, outcome, periods)


def _follow(path: _Path, state: FloatArray, longest: float, most: int) -> tuple[list[_Point], str]:
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
    while len(points) < most:
        here = points[-1]
        new = path.correct(here.z + step * here.tangent, here.tangent)
        cosine = -1.0 if new is None else float(new.tangent @ here.tangent)
        # Beside a kink the tangent turns however short a step is.
        if new is None or (cosine < _BENT and step > 1e3 * _SHORTEST):
            step *= 0.5
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


def _signs(point: _Point) -> dict[str, float]:
    """Functions of which each changes its sign at a crossing of its kind."""
    one = np.eye(point.by_start.shape[0])
    pairs = [m for m in point.multipliers if m.imag > _PAIRED * abs(m)]
    nearest = min(pairs, key=lambda m: abs(abs(m) - 1), default=None)
    return {
        "fold": float(point.tangent[-1]),
        "branch point": float(np.linalg.det(point.by_start - one)),
        "period doubling": float(np.linalg.det(point.by_start + one)),
        "Neimark-Sacker": np.nan if nearest is None else float(abs(nearest) - 1),
    }


def _sign(kind: str, point: _Point) -> float:
    return _signs(point)[kind]


def _found_between(path: _Path, one: _Point, other: _Point) -> list[tuple[str, float]]:
    """What happens between two points, in its order, and where along the parameter."""
    found: dict[str, tuple[float, float]] = {}
    before, behind = _signs(one), _signs(other)
    changed = [kind for kind in before if before[kind] * behind[kind] < 0]
    if "fold" in changed and "branch point" in changed:
        # At a fold a multiplier passes 1 as well.
        changed.remove("branch point")
    for kind in changed:
        found[kind] = _located(path, one, other, partial(_sign, kind))
    if one.passed != other.passed:
        found["grazing"] = _located(
            path, one, other, lambda point: 1.0 if point.passed == other.passed else -1.0
        )
    return [(kind, found[kind][1]) for kind in sorted(found, key=lambda kind: found[kind][0])]


def _located(
    path: _Path, one: _Point, other: _Point, function: Callable[[_Point], float]
) -> tuple[float, float]:
    """Where on the way a function passes 0, and the parameter there; NaN: lost.

    By the rule of Illinois, and halving where that is slow.
    """
    low, high, last = 0.0, 1.0, 0
    at_low, at_high = function(one), function(other)
    p_low, p_high = float(one.z[-1]), float(other.z[-1])
    for turn in range(_LOCATING):
        part = low + (high - low) * at_low / (at_low - at_high)
        if turn % 4 == 3 or not low < part < high:
            part = 0.5 * (low + high)
        point = path.between(one, other, part)
        if point is None:
            return low, float("nan")
        value = function(point)
        if np.isnan(value):
            return low, float("nan")
        if value * at_low > 0:
            low, at_low, p_low = part, value, float(point.z[-1])
            at_high *= 0.5 if last == 1 else 1.0
            last = 1
        else:
            high, at_high, p_high = part, value, float(point.z[-1])
            at_low *= 0.5 if last == 2 else 1.0
            last = 2
        if high - low <= _NEAR or value == 0:
            break
    return low, 0.5 * (p_low + p_high) * float(path.units[-1])


def _branch(
    system: PolynomialSystem | Structure,
    path: _Path,
    points: list[_Point],
    outcome: str,
    n_periods: int,
) -> MotionBranch:
    """Make the result: errors by another number of steps, crossings, extremes."""
    n, units = 2 * path.mapping.n_dof, path.units
    values = np.array([point.z[-1] * units[-1] for point in points])
    refined: list[Refined] = []
    lows, highs = [], []
    for point, p in zip(points, values, strict=True):
        mapping, state = path.at(float(p)), point.z[:-1] * units[:-1]
        one = judged(mapping, state, path.steps, point.correction * path.size)
        refined.append(one)
        times = np.linspace(0.0, mapping.period, SHOWN, endpoint=False)
        shown = mapping.run(state, path.steps, times=times).at_times[:, ::2]
        lows.append(shown.min(axis=0))
        highs.append(shown.max(axis=0))
    folds, grazings, crossings = [], [], []
    for i, (before, behind) in enumerate(pairwise(points)):
        for kind, p in _found_between(path, before, behind):
            if kind == "fold":
                folds.append(p)
            if kind == "grazing":
                grazings.append(p)
            else:
                place = None if np.isnan(p) else p
                sure = None not in (refined[i].stable, refined[i + 1].stable)
                crossings.append(Crossing(kind, i, place, sure=sure))
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
        grazings=np.array(grazings),
        crossings=tuple(crossings),
        outcome=outcome,
        n_periods=n_periods,
        system=system,
        _points=tuple(makers),
    )
