"""Poles of force laws, and layers in which a law changes within less than a step."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from viscovib._native import FloatArray
from viscovib.systems.laws import _CALLED, BRANCHES, WALL, Law
from viscovib.systems.system import System

#: Instruction codes of the core.
_NUMBER, _ARGUMENT, _ADD, _SUBTRACT, _MULTIPLY, _DIVIDE, _POWER = range(1, 8)
_SQUARE, _KNOWN_POWER, _NEGATE = 8, 9, 10
_COS, _TAN, _SQRT, _ABS, _ATAN2, _ATLEAST, _WHERE = 12, 13, 25, 26, 29, 35, 36
#: Smooth functions of one operand, which may turn a small change of it into a layer.
_SMOOTH = frozenset((_SQUARE, _KNOWN_POWER, *range(11, 26)))
_ROOTS = frozenset((_KNOWN_POWER, _SQRT))
_DIVIDING = frozenset((_DIVIDE, _POWER, _KNOWN_POWER, _TAN))
_EPS = float(np.finfo(float).eps)
#: Secant steps and bisections for a zero; largest number of distinct points.
_SECANTS, _BISECTIONS, _MOST_PLACES = 30, 60, 64
#: Growth of differences per halving of the distance (2^p for 1/x^p), number of halvings, nearest
#: distance to a zero in units of its rounding error, and nearest distance to a double zero.
_GROWTH, _HALVINGS, _NEAREST, _TOUCHING = 1.15, 12, 1e4, 1e-6
_DOUBLINGS = 40
#: Relative size of a sum that counts as rounding error.
_CANCELLED = 1e-13
#: Distance on both sides of a zero, as a fraction of the path; size of an operand at this distance,
#: relative to the ends, from which on it jumps over 0.
_NEARBY, _JUMPED = 1e-9, 1e-3
#: Fractions of a straight path at which zeros are searched.
_GRID = np.linspace(0.0, 1.0, 41)
#: Half widths of layers, and the largest one, as fractions of the path between two states.
_WIDTHS = np.logspace(-12, 0, 241)
_THIN = 0.1
#: Sample points about a point, as such fractions: on both sides and at the point itself.
_ASIDE = np.concatenate([-_WIDTHS, _WIDTHS, [0.0]])
#: A coarse subset of them for a first test, which drops a point if less than this fraction of the
#: change of the law happens within a thin layer.
_COARSELY, _SOME = np.concatenate([-_WIDTHS[::4], _WIDTHS[::4], [0.0]]), 0.1
#: Points per call, such that the arrays stay in the cache.
_AT_ONCE = 8


@dataclass(frozen=True)
class Layer:
    """A change of a law within a small width, and the time at which a motion reaches it."""

    text: str
    reads: dict[str, float]
    change: float
    width: float
    when: float
    #: Time that the motion spends in the layer (s).
    takes: float

    def note(self) -> str:
        """Sentence for a message."""
        return (
            f"the law '{self.text}' changes by {self.change:.3g} within {self.width:.3g} about "
            f"{_named(self.reads)}, which the motion reaches near t = {self.when:.6g} and "
            f"stays for {self.takes:.2g}: a layer thinner than a step (use a smaller dt, or a "
            "wider layer)"
        )


def law_pole(
    system: System, at: tuple[FloatArray, FloatArray], times: FloatArray, reach: float
) -> tuple[str, dict[str, float], float] | None:
    """Return the text of a law with a pole on the path, its arguments there, and the time.

    Parameters
    ----------
    system
        A polynomial system or a structure; all other systems have no laws.
    at
        Coordinates and velocities, shape (m, n); for a structure, deflections and their rates.
    times : ndarray, shape (m,)
        Times of the states (s).
    reach : float
        Time by which the motion is extrapolated after each state (s).

    Returns
    -------
    tuple or None
        None: no law has a pole on the straight extrapolation of the motion.
    """
    for i, begin in enumerate(times):
        q, v = at[0][i : i + 1], at[1][i : i + 1]
        way = (q + reach * _GRID[:, np.newaxis] * v, np.repeat(v, _GRID.size, axis=0))
        found = pole_between(system, way, begin + reach * _GRID, 0.0)
        if found is not None:
            return found
    return None


def pole_between(
    system: System, at: tuple[FloatArray, FloatArray], times: FloatArray, step: float
) -> tuple[str, dict[str, float], float] | None:
    """Return the first pole between states; arguments and result as for ``law_pole``.

    A step over a pole may be deflected by it. So the path that each state would follow within a
    step (s) with its rates is also searched.
    """
    first = None
    for law, rows, rates in _arguments(system, *at, _DIVIDING):
        divisors = _divisors(law)
        ahead = rows[:-1] + np.minimum(np.diff(times), step)[:, np.newaxis] * rates[:-1]
        places = [
            place for ends in (rows[1:], ahead) for place in _places(law, divisors, rows[:-1], ends)
        ]
        for when, place in sorted(
            ((_time(law, place, times, rates), place) for place in places), key=lambda one: one[0]
        ):
            if first is not None and when >= first[2]:
                break
            if _grows(law, place):
                first = law.text, law.read_at(place.there), when
                break
    return first


def layer_between(
    system: System, at: tuple[FloatArray, FloatArray], times: FloatArray
) -> Layer | None:
    """Return the largest change of a law between states; arguments as for ``law_pole``."""
    found = None
    for law, rows, rates in _arguments(system, *at, _SMOOTH):
        places = _sharp(law, _places(law, _bent(law), rows[:-1], rows[1:]))
        for place, (change, width) in zip(places, _changes(law, places), strict=True):
            if width > _THIN or (found is not None and change <= found.change):
                continue
            span = float(times[place.row + 1] - times[place.row])
            way = 2 * width * float(np.linalg.norm(place.along[list(law.places)]))
            when = _time(law, place, times, rates)
            reads = law.read_at(place.there)
            found = Layer(law.text, reads, change, way, when, 2 * width * span)
    return found


def pole_text(text: str, reads: dict[str, float], when: float) -> str:
    """Sentence about a pole for a message."""
    return (
        f"the law '{text}' has a pole at {_named(reads)}, which the motion reaches near t = "
        f"{when:.6g}, and no step size resolves it (use a bounded law, or end the run earlier "
        "by an event)"
    )


def _named(reads: dict[str, float]) -> str:
    return ", ".join(f"{name} = {value:.6g}" for name, value in reads.items())


class _Place(NamedTuple):
    """Zero of an operand between two rows of arguments."""

    row: int
    part: float
    there: FloatArray
    along: FloatArray
    #: True for a double zero: the operand does not change its sign.
    touches: bool


def _time(law: Law, place: _Place, times: FloatArray, rates: FloatArray) -> float:
    """Time at which a motion with constant rate reaches a point; at most the next time."""
    begin, end = times[place.row : place.row + 2]
    used = list(law.places)
    along = place.along[used]
    speed = float((rates[place.row, used] @ along) / (along @ along))
    later = place.part / speed if speed > 0 else np.inf
    return float(begin + min(later, end - begin))


def _places(law: Law, operands: list[Law], begins: FloatArray, ends: FloatArray) -> list[_Place]:
    """Zeros of the operands on straight paths, in the order of the paths."""
    found: dict[str, _Place] = {}
    used = list(law.places)
    key_of = "%.6g " * len(used)
    along = ends - begins
    for operand in operands:
        values, slopes = zip(operand(begins), operand(ends), strict=True)
        first, last = (np.einsum("ij,ij->i", slope, along) for slope in slopes)
        changes = values[0] * values[1] < 0
        # The operand approaches 0 at the start and moves away from it at the end.
        turns = (values[0] * first < 0) & (values[1] * last > 0) & ~changes
        for some, turning in ((changes, False), (turns, True)):
            chosen = np.flatnonzero(some)[:_MOST_PLACES]
            zeros = list(_zeros(operand, begins, along, chosen, turning=turning))
            if not zeros:
                continue
            at = [row for row, *_ in zeros]
            there = begins[at] + np.array([[part] for _, part, _ in zeros]) * along[at]
            # Adding 0 turns -0 into 0.
            numbers = (there[:, used] + 0.0).tolist()
            for (row, part, touches), place, read in zip(zeros, there, numbers, strict=True):
                if not touches and _jumps(operand, place, along[row], begins[row]):
                    continue  # steps end there
                key = key_of % tuple(read)
                if key not in found or found[key].row > row:
                    found[key] = _Place(row, part, place, along[row], touches)
    return sorted(found.values(), key=lambda one: (one.row, one.part))[:_MOST_PLACES]


def _jumps(operand: Law, there: FloatArray, way: FloatArray, begin: FloatArray) -> bool:
    """True if an operand that changes its sign at a point jumps over 0."""
    if not operand.branches:
        return False
    near = operand(there + np.array([[-_NEARBY], [_NEARBY]]) * way)[0]
    ends = operand(begin + np.array([[0.0], [1.0]]) * way)[0]
    return bool(np.abs(near).max() > _JUMPED * np.abs(ends).max())


def _zeros(
    operand: Law, begins: FloatArray, along: FloatArray, rows: NDArray[np.intp], *, turning: bool
) -> Iterator[tuple[int, float, bool]]:
    """Yield paths with a zero of an operand, the fraction of the path, and True for a double zero.

    ``turning``: on these paths the operand approaches 0 and moves away again.
    """
    if rows.size == 0:
        return
    at, way = begins[rows], along[rows]

    def value(parts: FloatArray) -> FloatArray:
        return operand.values(at + parts[:, np.newaxis] * way)

    def slope(parts: FloatArray) -> FloatArray:
        slopes = operand(at + parts[:, np.newaxis] * way)[1]
        return np.asarray(np.einsum("ij,ij->i", slopes, way))

    none, all_of_it = np.zeros(rows.size), np.ones(rows.size)
    if not turning:
        parts = _bracketed(value, none, all_of_it)
        for row, part in zip(rows.tolist(), parts.tolist(), strict=True):
            yield row, part, False
        return
    turn = _bracketed(slope, none, all_of_it)
    crosses = value(turn) * value(none) < 0
    touches = _cancels(operand, at + turn[:, np.newaxis] * way)
    sides = [
        _bracketed(value, *ends) for ends in ((none, turn), (turn, all_of_it)) if crosses.any()
    ]
    for i, row in enumerate(rows):
        if crosses[i]:
            for side in sides:
                yield int(row), float(side[i]), False
        elif touches[i]:
            yield int(row), float(turn[i]), True


def _bracketed(
    function: Callable[[FloatArray], FloatArray], low: FloatArray, high: FloatArray
) -> FloatArray:
    """Zeros between points of different sign, vectorized (Illinois method, then bisection)."""
    low, high = low.copy(), high.copy()
    f, g = function(low), function(high)
    for i in range(_SECANTS + _BISECTIONS):
        with np.errstate(all="ignore"):
            middle = high - g * (high - low) / (g - f)
        inside = (middle >= np.minimum(low, high)) & (middle <= np.maximum(low, high))
        middle = np.where(inside & (i < _SECANTS), middle, 0.5 * (low + high))
        h = function(middle)
        across = h * g < 0
        low, f = np.where(across, high, low), np.where(across, g, 0.5 * f)
        moved = np.abs(middle - high)
        high, g = middle, h
        if ((g == 0) | (moved <= 8 * _EPS) | (np.abs(high - low) <= _EPS)).all():
            break
    return high


def _cancels(operand: Law, at: FloatArray) -> NDArray[np.bool_]:
    """True where a sum is 0 by cancellation, to rounding error."""
    if operand.code[-1] not in (_ADD, _SUBTRACT):
        return np.zeros(len(at), bool)
    size = sum(np.abs(part.values(at)) for part in _operands(operand))
    return np.asarray(np.abs(operand.values(at)) <= _CANCELLED * size)


def _grows(law: Law, place: _Place) -> bool:
    """True if a law grows without bound on one side of a point."""
    used = list(law.places)
    largest = float(np.abs(place.there[used]).max() + np.abs(place.along[used]).max())
    unit = largest / float(np.abs(place.along[used]).max())
    near = (_TOUCHING if place.touches else _NEAREST * _EPS) * unit
    parts = near * 2.0 ** np.arange(_DOUBLINGS)
    for side in (-1, 1):
        f = law.values(place.there + side * parts[:, np.newaxis] * place.along)
        # Near a pole of high order all values have reached the limit.
        f = f[np.argmax(np.abs(f) < WALL) :][: _HALVINGS + 2]
        if f.size < _HALVINGS + 2 or (np.abs(f) >= WALL).any():
            continue
        differences = np.abs(np.diff(f))
        if (differences[:-1] > _GROWTH * differences[1:]).all() and differences[-1] > 0:
            return True
    return False


def _sharp(law: Law, places: list[_Place]) -> list[_Place]:
    """The points about which a tenth of the change of a law may happen within a thin layer.

    A layer is at least as wide as its distance from the point, so the coarse widths resolve it.
    """
    if not places:
        return []
    values = _values_about(law, places, _COARSELY)
    both = np.abs(values[:, :-1] - values[:, -1:])
    within = both[:, np.abs(_COARSELY[:-1]) <= _THIN].max(axis=1)
    smooth = within < _SOME * both.max(axis=1)
    return [place for place, passed in zip(places, smooth.tolist(), strict=True) if not passed]


def _changes(law: Law, places: list[_Place]) -> list[tuple[float, float]]:
    """Change of a law about each point, and the half width that contains half of the change."""
    if not places:
        return []
    values = _values_about(law, places, _ASIDE)
    largest = np.maximum(values.max(axis=1), -values.min(axis=1))
    before, after = np.split(values[:, :-1], 2, axis=1)
    if law.branches:
        # Steps end where the law jumps, as sign(v)*exp(-abs(v)) does: the jump is no layer.
        before, after = before - before[:, :1], after - after[:, :1]
    else:
        before, after = before - values[:, -1:], after - values[:, -1:]
    both = np.maximum(np.abs(before), np.abs(after))
    change = both.max(axis=1)
    widths = _WIDTHS[(both >= 0.5 * change[:, np.newaxis]).argmax(axis=1)]
    # At a step the two ends differ; at a bump they are equal.
    ends = np.abs(after[:, -1] - before[:, -1])
    found = np.where((largest >= WALL) | ~(change > 0), 0.0, np.maximum(change, ends))
    return list(zip(found.tolist(), np.where(found > 0, widths, 1.0).tolist(), strict=True))


def _values_about(law: Law, places: list[_Place], aside: FloatArray) -> FloatArray:
    """Values of a law at the offsets ``aside`` from each point, shape (m, n_aside)."""
    found = np.empty((len(places), aside.size))
    for begin in range(0, len(places), _AT_ONCE):
        some = places[begin : begin + _AT_ONCE]
        # Arguments one after the other, in the order of the core.
        there = np.array([place.there for place in some]).T[:, :, np.newaxis]
        along = np.array([place.along for place in some]).T[:, :, np.newaxis]
        at = (there + along * aside).reshape(there.shape[0], -1).T
        found[begin : begin + _AT_ONCE] = law.values(at).reshape(len(some), -1)
    return found


def _divisors(law: Law) -> list[Law]:
    """Operands that must not be 0: divisors, cosines of tangents, bases of negative powers."""
    found = []
    for i, code in enumerate(law.code):
        if code == _DIVIDE:
            found.append(_operands(law, i)[1])
        elif code == _TAN:
            angle = _operands(law, i)[0]
            found.append(replace(angle, code=(*angle.code, _COS), number=(*angle.number, 0.0)))
        elif code == _POWER or (code == _KNOWN_POWER and law.number[i] < 0):
            found.append(_operands(law, i)[0])
    return [factor for one in found for factor in _factors(one)]


def _bent(law: Law) -> list[Law]:
    """Operands of the smooth functions of a law; near their zeros the law may change most.

    Steps end at the zero of a branch, such as abs(v), whose root is not smooth there.
    """
    found = [
        _operands(law, i)[0]
        for i, code in enumerate(law.code)
        if code in _SMOOTH and not (code in _ROOTS and law.code[i - 1] in BRANCHES)
    ]
    return [factor for one in found for factor in _factors(one)]


def _factors(operand: Law) -> list[Law]:
    """Factors of an operand: it is 0 where one is, and none has a double zero by its form."""
    code = operand.code[-1]
    if code == _NUMBER:
        return []
    parts = _operands(operand)
    if code == _MULTIPLY:
        return [factor for part in parts for factor in _factors(part)]
    if code in (_SQUARE, _NEGATE, _SQRT, _ABS, _DIVIDE) or (
        code == _KNOWN_POWER and operand.number[-1] > 0
    ):
        return _factors(parts[0])
    return [operand] if _ARGUMENT in operand.code else []


def _operands(law: Law, last: int = -1) -> list[Law]:
    """Operands of an instruction of a law, each as a law."""
    last %= len(law.code)
    if _n_operands(law.code[last]) == 0:
        return []
    begins: list[int] = []
    for i, code in enumerate(law.code[: last + 1]):
        n = _n_operands(code)
        taken = begins[len(begins) - n :]
        if i == last:
            ends = [*taken[1:], i]
            return [
                replace(law, code=law.code[a:b], number=law.number[a:b])
                for a, b in zip(taken, ends, strict=True)
            ]
        del begins[len(begins) - n :]
        begins.append(taken[0] if taken else i)
    return []


def _n_operands(code: int) -> int:
    if code in (_NUMBER, _ARGUMENT):
        return 0
    if code == _WHERE:
        return 3
    if code > _CALLED:
        return code - _CALLED
    two = _ADD <= code <= _POWER or _ATAN2 <= code <= _ATLEAST or code > _WHERE
    return 2 if two else 1


def _arguments(
    system: System, q: FloatArray, v: FloatArray, having: frozenset[int]
) -> Iterator[tuple[Law, FloatArray, FloatArray]]:
    """Yield each law with one of the instructions ``having``, its arguments and their rates.

    Arguments and rates have the shape (m, n_arguments); rates of rates are set to 0. Hysteresis
    elements are skipped.
    """
    for law, arguments, rates in system._laws_at(q, v):
        if not law.state and law.places and not having.isdisjoint(law.code):
            yield law, arguments, rates
