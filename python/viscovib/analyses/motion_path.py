"""What a branch of motions follows: the map of a period at each value of a parameter.

Points are z = (state, parameter), measured by the size of the first motion and by the range.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from viscovib._native import ComplexArray, FloatArray
from viscovib.analyses.following import _Way
from viscovib.analyses.motion_errors import SHOWN, weights_of
from viscovib.analyses.period_map import PeriodMap, Ran
from viscovib.common.turns import extremes_of

#: Distance of differences by the parameter, as a part of it; corrections behind which these stay.
_APART, _SETTLED = 1e-6, 1e-7
#: What differences to both sides may differ by, as a part of them, before they are taken so much
#: nearer; and no nearer than this, as distances above.
_STRAIGHT, _NEARER, _NEAREST = 1e-2, 1 / 32, 5e-13
#: How far behind a corner its other side is looked for, and how far motions on it.
_BEHIND, _ON = (1e-8, 1e-7, 1e-6, 1e-5), (1e-7, 1e-6, 1e-5, 1e-4, 1e-3)
#: What extremes may be off by, as a part of them.
_LEFT = 1e-9
#: Iterations of Newton's method.
_MOST_TURNS = 8


class MotionPoint(NamedTuple):
    """A motion on the branch."""

    z: FloatArray
    tangent: FloatArray
    #: Derivatives of P(y, p) - y by z, in the units of z.
    slopes: FloatArray
    by_start: FloatArray
    passed: int
    correction: float
    turns: int

    @property
    def multipliers(self) -> ComplexArray:
        """Floquet multipliers, in no order."""
        return np.asarray(np.linalg.eigvals(self.by_start).astype(complex))

    @property
    def turn_of_way(self) -> float:
        """The sign of the bordered derivatives' determinant: it changes at branch points alone."""
        return float(np.linalg.slogdet(np.vstack([self.slopes, self.tangent]))[0])


@dataclass
class MotionPath:
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
        return np.append(self.size / weights_of(self.mapping), reach)

    def _slopes(
        self, z: FloatArray, by_p: FloatArray | None, apart: float
    ) -> tuple[Ran, FloatArray, FloatArray, float] | None:
        """The map at z and its derivatives, in units of z; those by the parameter may be known."""
        units = self.units
        y, p = z[:-1] * units[:-1], float(z[-1] * units[-1])
        if self.way.varies == "nu" and p <= 0:
            return None
        here = self.at(p).run(y, self.steps)
        if here.outcome != "completed":
            return None
        if by_p is None:
            by_p, apart = self._by_parameter(y, p, here.last, apart)
        if by_p is None:
            return None
        slopes = np.zeros((y.size, z.size))
        slopes[:, :-1] = (here.by_start - np.eye(y.size)) * units[:-1] / units[:-1, None]
        slopes[:, -1] = by_p * units[-1] / units[:-1]
        return here, slopes, by_p, apart

    def correct(self, guess: FloatArray, along: FloatArray) -> MotionPoint | None:
        """The motion nearest to a guess across a direction; None: Newton's method finds none."""
        z, units, before, by_p, apart = guess, self.units, np.inf, None, _APART
        for turn in range(1, _MOST_TURNS + 1):
            # So near to the end what the parameter does changes no more.
            stays = apart == _APART and before <= _SETTLED
            found = self._slopes(z, by_p if stays else None, apart)
            if found is None:
                return None
            here, slopes, by_p, apart = found
            matrix = np.vstack([slopes, along])
            rest = np.append(here.last / units[:-1] - z[:-1], along @ (z - guess))
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
                return MotionPoint(z, tangent, slopes, here.by_start, here.passed, correction, turn)
            before = correction
        return None

    def round_corner(self, here: MotionPoint) -> MotionPoint | None:
        """The next point where the branch has a corner, as where an impact begins; None: none.

        Behind it the branch continues in the null direction of the derivatives of the other side.
        The sign of the determinant, which is constant, distinguishes forwards and backwards.
        """
        for ahead in _BEHIND:
            beside = self._slopes(here.z + ahead * here.tangent, None, _APART)
            if beside is None or beside[0].passed == here.passed:
                continue
            tangent = np.linalg.svd(beside[1])[2][-1]
            way = float(np.linalg.slogdet(np.vstack([beside[1], tangent]))[0])
            tangent = tangent * way * here.turn_of_way
            for step in _ON:
                new = self.correct(here.z + step * tangent, tangent)
                if new is not None and new.passed == beside[0].passed:
                    return new
        return None

    def switches_ahead(self, here: MotionPoint) -> str:
        """Say whether laws switch otherwise next to a point."""
        for ahead in _BEHIND:
            z = here.z + ahead * here.tangent
            there = self.at(float(z[-1] * self.units[-1])).run(z[:-1] * self.units[:-1], self.steps)
            if there.outcome == "grazing" or there.passed != here.passed:
                return (
                    f"; near it laws switch {there.passed} times instead of {here.passed}, as "
                    "at a grazing contact"
                )
        return ""

    def _by_parameter(
        self, y: FloatArray, p: float, here: FloatArray, apart: float
    ) -> tuple[FloatArray | None, float]:
        """What the end of a motion changes by with the parameter: by differences so far apart.

        Also how far they were. Derivatives grow like the square root of how deep a law is entered:
        near grazing, differences across it are those of neither side.
        """
        size, units = max(abs(p), float(self.units[-1])), self.units[:-1]
        while True:
            h = apart * size
            left, right = (self.at(x).run(y, self.steps) for x in (p - h, p + h))
            if left.outcome != "completed" or right.outcome != "completed":
                return None, apart
            change = right.last - left.last
            bend = float(np.abs((right.last - 2 * here + left.last) / units).max())
            straight = bend <= _STRAIGHT * float(np.abs(change / units).max())
            if straight or apart * _NEARER < _NEAREST:
                return np.asarray(change / (2 * h)), apart
            apart *= _NEARER

    def reach(self, point: MotionPoint) -> tuple[FloatArray, FloatArray]:
        """Smallest and largest displacements of the motion at a point."""
        mapping = self.at(float(point.z[-1] * self.units[-1]))
        state = point.z[:-1] * self.units[:-1]

        def states_at(t: FloatArray) -> FloatArray:
            return mapping.run(state, self.steps, times=t, derivatives=False).at_times

        t = np.linspace(0.0, mapping.period, max(SHOWN, self.steps) + 1)
        states = states_at(t)
        return extremes_of(t[: len(states)], states, states_at, _LEFT)

    def between(self, one: MotionPoint, other: MotionPoint, part: float) -> MotionPoint | None:
        """A point on the way from one to another."""
        chord = other.z - one.z
        return self.correct(one.z + part * chord, chord / np.linalg.norm(chord))
