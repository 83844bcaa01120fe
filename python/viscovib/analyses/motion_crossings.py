"""What happens between two points of a branch of motions in time, and where."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from viscovib._native import FloatArray
from viscovib.analyses.motion_path import MotionPath, MotionPoint

#: How near to each other the ends are between which a crossing is located, as a part of the way.
_NEAR = 1e-13
#: How near to each other motions on both sides are, and how near to 0 what changes its sign, as a
#: part of what it was: else what is found is a corner of the branch.
_CLOSE, _JUMP = 1e-10, 1e-3
#: Halvings of the way between two points, where what is found does not tell what has changed.
_MOST_HALVINGS = 6
#: Points around a location where nothing is found, and how well their results must agree.
_NODES, _AGREE = 8, 1e-7


def _fold(point: MotionPoint) -> float:
    return float(point.tangent[-1])


def _branching(point: MotionPoint) -> float:
    """The determinant of the bordered derivatives: not 0 at folds."""
    return float(np.linalg.det(np.vstack([point.slopes, point.tangent])))


def _doubling(point: MotionPoint) -> float:
    return float(np.linalg.det(point.by_start + np.eye(point.by_start.shape[0])))


def _pairing(point: MotionPoint) -> float:
    """The sign of the product of all m_i m_j - 1, i < j, times the smallest of them.

    It is continuous where a pair of multipliers becomes real, and does not mix pairs.
    """
    return _nearest_pair(point)[0]


def _nearest_pair(point: MotionPoint) -> tuple[float, bool]:
    """The value of `_pairing`, and whether the smallest is that of a pair that is not real."""
    m = point.multipliers
    i, j = np.triu_indices(m.size, 1)
    factors = m[i] * m[j] - 1
    sizes = np.abs(factors)
    least = int(sizes.argmin())
    sign = np.sign(np.prod(factors / np.maximum(sizes, np.finfo(float).tiny)).real)
    return float(sign * sizes[least]), bool(
        m[i[least]].imag != 0 and m[i[least]].imag == -m[j[least]].imag
    )


#: For each kind: what changes its sign there, and how many multipliers pass the unit circle.
_KINDS: dict[str, tuple[Callable[[MotionPoint], float], int]] = {
    "fold": (_fold, 1),
    "branch point": (_branching, 1),
    "period doubling": (_doubling, 1),
    "Neimark-Sacker": (_pairing, 2),
}


class _LostError(Exception):
    """Newton's method finds no motion between two points."""


class Event(NamedTuple):
    """What happens between two points; None: where is not found."""

    kind: str
    part: float
    point: MotionPoint | None


def errors_of(
    path: MotionPath, one: MotionPoint, other: MotionPoint, blur: float, found: list[Event]
) -> list[float]:
    """How far off the places of events are, as a part of the range: by other steps.

    inf: other steps do not have them; NaN: the place is not found.
    """
    if not found:
        return []
    finer = replace(path, steps=2 * path.steps + 1)
    ends = [finer.correct(point.z, point.tangent) for point in (one, other)]
    others: list[Event] = []
    if ends[0] is not None and ends[1] is not None:
        others = events(finer, ends[0], ends[1], blur)
    result = []
    for event in found:
        if event.point is None:
            result.append(np.nan)
            continue
        place = float(event.point.z[-1])
        beside = [
            abs(float(e.point.z[-1]) - place)
            for e in others
            if e.kind == event.kind and e.point is not None
        ]
        # Ends differ by rounding, and by what Newton's method has left.
        left = max(event.point.correction, float(np.finfo(float).eps) * abs(place))
        result.append(min(beside, default=np.inf) + left)
    return result


def events(
    path: MotionPath,
    one: MotionPoint,
    other: MotionPoint,
    blur: float,
    halvings: int = _MOST_HALVINGS,
) -> list[Event]:
    """What happens between two points, in its order.

    If it does not tell why as many multipliers have passed the unit circle as have, some of it
    happens twice: the halves tell it then. ``blur`` is the error of multipliers.
    """
    found = []
    for kind, (function, _) in _KINDS.items():
        at_one, at_other = function(one), function(other)
        hidden = kind == "Neimark-Sacker" and max(abs(at_one), abs(at_other)) <= 2 * blur
        if at_one * at_other >= 0 or hidden:
            continue
        event = _located(path, one, other, kind, function)
        # Two real multipliers whose product passes 1 are on both sides of the circle.
        if kind != "Neimark-Sacker" or event.point is None or _nearest_pair(event.point)[1]:
            found.append(event)
    change = _outside(other, blur) - _outside(one, blur)
    sums = {0}
    for event in found:
        by = _KINDS[event.kind][1]
        sums = {x + s for x in sums for s in (by, -by)}
    # Not a number: a multiplier is too near to the circle.
    if halvings > 0 and not np.isnan(change) and change not in sums:
        middle = path.between(one, other, 0.5)
        if middle is not None:
            first = events(path, one, middle, blur, halvings - 1)
            second = events(path, middle, other, blur, halvings - 1)
            return [e._replace(part=e.part / 2) for e in first] + [
                e._replace(part=(1 + e.part) / 2) for e in second
            ]
    grazings = _grazings(path, one, other)
    if len(grazings) == 1:
        # Where the branch has a corner, what is between no two motions is there.
        at = grazings[0]
        found = [e if e.point is not None else at._replace(kind=e.kind) for e in found]
    return sorted([*found, *grazings], key=lambda event: event.part)


def _outside(point: MotionPoint, blur: float) -> float:
    """How many multipliers are outside of the unit circle; NaN: one is too near to tell."""
    sizes = np.abs(point.multipliers)
    return float("nan") if (np.abs(sizes - 1) <= 2 * blur).any() else float((sizes > 1).sum())


def _grazings(path: MotionPath, one: MotionPoint, other: MotionPoint) -> list[Event]:
    """Where the number of switches changes, from the last such place to the first."""
    found: list[Event] = []
    ahead, part = other, 1.0
    while one.passed != ahead.passed:
        seen: dict[int, tuple[float, MotionPoint]] = {}

        def function(point: MotionPoint, ahead: MotionPoint = ahead) -> float:
            return 1.0 if point.passed == ahead.passed else -1.0

        event = _located(path, one, ahead, "grazing", function, seen)
        if event.point is None:
            event = event._replace(point=_last_before_corner(path, one, ahead))
        found.append(event._replace(part=event.part * part))
        if event.point is None or -1 not in seen:
            break
        part *= seen[-1][0]
        ahead = seen[-1][1]
    return found


def _last_before_corner(
    path: MotionPath, one: MotionPoint, other: MotionPoint
) -> MotionPoint | None:
    """The last motion with the switches of one of two points on the way to the other.

    Where an impact begins, the branch has a corner, and no motions are across the way between
    points on both sides of it. From the side without it the branch is smooth up to there.
    """
    begin = one if one.passed < other.passed else other
    reach = float(np.linalg.norm(other.z - one.z))
    ahead = begin.tangent if begin is one else -begin.tangent
    last, there, beyond = begin, 0.0, 2.0 * reach
    while beyond - there > _NEAR * max(1.0, float(np.abs(begin.z).max())):
        middle = 0.5 * (there + beyond)
        point = path.correct(begin.z + middle * ahead, ahead)
        if point is not None and point.passed == begin.passed:
            last, there = point, middle
        else:
            beyond = middle
    return last if there > 0 and beyond < 2.0 * reach else None


def _located(
    path: MotionPath,
    one: MotionPoint,
    other: MotionPoint,
    kind: str,
    function: Callable[[MotionPoint], float],
    seen: dict[int, tuple[float, MotionPoint]] | None = None,
) -> Event:
    """Where on the way a function passes 0; ``seen`` gets the last points of either sign."""
    from scipy.optimize import brentq

    ends = {0.0: one, 1.0: other}
    seen = {} if seen is None else seen
    last = one

    def value(part: float) -> float:
        nonlocal last
        point = ends.get(part) or path.between(one, other, part)
        if point is None:
            raise _LostError
        last, found = point, function(point)
        seen[int(np.sign(found))] = (part, point)
        return found

    try:
        part = brentq(value, 0.0, 1.0, xtol=_NEAR, rtol=4 * float(np.finfo(float).eps))
    except _LostError:
        return _interpolated(path, one, other, kind, function)
    near = [point for _, point in seen.values()]
    corner = float(np.abs(near[0].z - near[-1].z).max()) > _CLOSE
    if kind != "grazing":
        left = min(abs(function(point)) for point in near)
        corner = corner or left > _JUMP * max(abs(function(one)), abs(function(other)))
    return Event(kind, float(part), None if corner else last)


def _interpolated(
    path: MotionPath,
    one: MotionPoint,
    other: MotionPoint,
    kind: str,
    function: Callable[[MotionPoint], float],
) -> Event:
    """Zero of a function by its polynomial through points around it.

    At a branch point Newton's equations are singular, and next to it nothing is found.
    """
    lost = Event(kind, 0.5, None)
    parts = 0.5 - 0.5 * np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES)
    tried = [(float(x), path.between(one, other, float(x))) for x in parts]
    found = [(x, point) for x, point in tried if point is not None]
    if len(found) < _NODES - 2:
        return lost
    x = np.array([part for part, _ in found])
    values = np.array([function(point) for _, point in found])
    z = np.array([point.z for _, point in found])
    roots = []
    # All of them, and without one: what that changes is the error.
    for kept in (slice(None), slice(1, None)):
        roots += _root_of(x[kept], values[kept])
    if len(roots) != 2:
        return lost
    at = [np.polynomial.Polynomial.fit(x, column, len(x) - 1)(np.array(roots)) for column in z.T]
    if abs(at[-1][0] - at[-1][1]) > _AGREE:
        return lost
    nearest = found[int(np.abs(x - roots[0]).argmin())][1]
    return Event(kind, roots[0], nearest._replace(z=np.array(at)[:, 0]))


def _root_of(x: FloatArray, values: FloatArray) -> list[float]:
    """The places in the way where the polynomial through values is 0."""
    roots = np.asarray(np.polynomial.Polynomial.fit(x, values, x.size - 1).roots(), dtype=complex)
    real = roots.real[np.abs(roots.imag) < _AGREE]
    return [float(r) for r in real[(real >= 0) & (real <= 1)]]
