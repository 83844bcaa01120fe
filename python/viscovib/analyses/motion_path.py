"""What a branch of motions follows: the map of a period at each value of a parameter.

Points are z = (state, parameter), measured by the size of the first motion and by the range.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from viscovib._native import ComplexArray, FloatArray
from viscovib.analyses.following import _Way
from viscovib.analyses.period_map import PeriodMap
from viscovib.analyses.shooting import SHOWN
from viscovib.common.turns import extremes_of

#: Distance of differences by the parameter, as a part of it; corrections behind which these stay.
_APART, _SETTLED = 1e-6, 1e-7
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
        return np.append(self.size / self.mapping.weights, reach)

    def correct(self, guess: FloatArray, along: FloatArray) -> MotionPoint | None:
        """The motion nearest to a guess across a direction; None: Newton's method finds none."""
        z, units, before, by_p = guess, self.units, np.inf, None
        for turn in range(1, _MOST_TURNS + 1):
            y, p = z[:-1] * units[:-1], float(z[-1] * units[-1])
            if self.way.varies == "nu" and p <= 0:
                return None
            here = self.at(p).run(y, self.steps)
            if here.outcome != "completed":
                return None
            # So near to the end what the parameter does changes no more.
            if by_p is None or before > _SETTLED:
                by_p = self._by_parameter(y, p)
            if by_p is None:
                return None
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
                return MotionPoint(
                    z, tangent, matrix[:-1], here.by_start, here.passed, correction, turn
                )
            before = correction
        return None

    def _by_parameter(self, y: FloatArray, p: float) -> FloatArray | None:
        """What the end of a motion changes by with the parameter: by differences."""
        h = _APART * max(abs(p), float(self.units[-1]))
        left, right = (self.at(x).run(y, self.steps) for x in (p - h, p + h))
        if left.outcome != "completed" or right.outcome != "completed":
            return None
        return np.asarray((right.last - left.last) / (2 * h))

    def reach(self, point: MotionPoint) -> tuple[FloatArray, FloatArray]:
        """Smallest and largest displacements of the motion at a point."""
        mapping = self.at(float(point.z[-1] * self.units[-1]))
        state = point.z[:-1] * self.units[:-1]

        def states_at(t: FloatArray) -> FloatArray:
            return mapping.run(state, self.steps, times=t).at_times

        t = np.linspace(0.0, mapping.period, max(SHOWN, self.steps) + 1)
        states = states_at(t)
        return extremes_of(t[: len(states)], states, states_at, _LEFT)

    def between(self, one: MotionPoint, other: MotionPoint, part: float) -> MotionPoint | None:
        """A point on the way from one to another."""
        chord = other.z - one.z
        return self.correct(one.z + part * chord, chord / np.linalg.norm(chord))
