"""Stability of driven motions: multipliers from monodromy matrices, what a branch crosses."""

import warnings
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray, core
from viscovib.branch import Crossing
from viscovib.errors import InputError, StabilityWarning
from viscovib.torus import IntArray

#: Multipliers this close to the unit circle count as on it.
_CIRCLE = 1e-9
#: Entries of a monodromy matrix beyond this say nothing any more.
_LARGEST = 1e100
#: Rates of growth closer to 0 than this count as 0.
STILL = 1e-7


def check_duration(duration: object) -> float:
    """Check the time over which rates of growth are averaged."""
    span = _native.number("duration", duration)
    if not 1 <= span <= 1e6:
        raise InputError(f"duration = {span:g}: must be in [1, 1e6]")
    return span


def floquet(
    matrices: FloatArray, found: npt.NDArray[np.bool_]
) -> tuple[ComplexArray, npt.NDArray[np.bool_]]:
    """Multipliers, largest first, NaN where unknown, and stability from monodromy matrices."""
    stack = np.ascontiguousarray(matrices.transpose(2, 0, 1))
    good = found & np.all(np.abs(stack) < _LARGEST, axis=(1, 2))
    multipliers = np.full((found.size, 6), np.nan + 0j)
    roots = np.linalg.eigvals(stack[good]).astype(complex)
    multipliers[good] = np.take_along_axis(roots, np.argsort(-np.abs(roots), axis=1), axis=1)
    stable = np.zeros(found.size, dtype=bool)
    stable[good] = np.abs(multipliers[good, 0]) <= 1 + _CIRCLE
    if (found & ~good).any():
        warnings.warn(
            f"stability of {(found & ~good).sum()} motions is unknown: time scales are too far "
            "apart",
            StabilityWarning,
            stacklevel=4,
        )
    return multipliers, stable


def crossings_along(
    job: tuple[object, ...],
    orders: IntArray,
    tolerance: float,
    branch: tuple[FloatArray, FloatArray, ComplexArray],
    folds: tuple[IntArray, FloatArray],
) -> tuple[Crossing, ...]:
    """Changes of stability between neighbours that are both known, in units of the core.

    ``branch``: parameters, unknowns (n, points), multipliers; ``folds``: points before, values.
    """
    p, x, multipliers = branch
    sizes = np.abs(multipliers)
    outside = np.count_nonzero(sizes > 1 + _CIRCLE, axis=1)
    unknown = np.isnan(sizes.sum(axis=1))
    result = []
    for i in np.flatnonzero(outside[1:] != outside[:-1]).tolist():
        if unknown[i] or unknown[i + 1]:
            continue
        near = np.flatnonzero(np.abs(folds[0] - i) <= 1)
        if near.size:
            result.append(Crossing("fold", i, float(folds[1][near[0]])))
            continue
        # The multiplier, by size, that is outside on one side only.
        place = int(max(outside[i], outside[i + 1])) - 1
        nearer = i if abs(sizes[i, place] - 1) < abs(sizes[i + 1, place] - 1) else i + 1
        where, roots = None, multipliers[nearer]
        if (sizes[i, place] - 1) * (sizes[i + 1, place] - 1) < 0:
            between = _Between(job, orders, tolerance, p[i : i + 2], x[:, i : i + 2])
            where = between.crossing(place)
            roots = roots if where is None else between.multipliers(where)
        result.append(Crossing(_kind(roots), i, where))
    return tuple(result)


@dataclass(frozen=True)
class _Between:
    """Motions between two neighbours of a branch: their parameters and unknowns."""

    job: tuple[object, ...]
    orders: IntArray
    tolerance: float
    p: FloatArray
    x: FloatArray

    def multipliers(self, value: float) -> ComplexArray:
        """At a value of the parameter, largest first; NaN if no motion is found."""
        part = (value - self.p[0]) / (self.p[1] - self.p[0])
        guess = self.x[:, 0] + part * (self.x[:, 1] - self.x[:, 0])
        kept = np.ones((len(self.orders), 3), dtype=np.intc, order="F")
        bound = int(np.abs(self.orders).sum(axis=1).max())
        _, codes, *_, matrices = _native.call(
            core.pendulum_balance, *self.job[:2], kept, *self.job[2:], np.array([value]),
            self.tolerance, 1.0, bound, bound, 0, guess, np.zeros(1, dtype=np.intc),
        )  # fmt: skip
        multipliers: ComplexArray = floquet(matrices, codes == 0)[0][0]
        return multipliers

    def crossing(self, place: int) -> float | None:
        """Where the multiplier of this place has size 1."""
        low, high = self.p.tolist()
        try:
            return float(
                brentq(
                    lambda value: np.abs(self.multipliers(value)[place]) - 1,
                    low, high, xtol=1e-11 * abs(low), rtol=1e-13,
                )
            )  # fmt: skip
        except (ValueError, RuntimeError):
            # No motion between, or no change of sign seen once more.
            return None


def _kind(roots: ComplexArray) -> str:
    """What is crossed, by the multiplier nearest to the circle."""
    root = roots[np.abs(np.abs(roots) - 1).argmin()]
    if abs(root.imag) > 1e-4 * abs(root):
        return "Neimark-Sacker"
    return "branch point" if root.real > 0 else "period doubling"
