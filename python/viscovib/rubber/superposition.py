"""Superposition of sets: shift factors and one smooth curve by common least squares."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from viscovib._native import FloatArray
from viscovib.errors import InputError

#: Decades between knots of the spline, its penalty, and largest number of steps.
KNOTS, _PENALTY, _STEPS = 0.5, 3e-4, 60
#: Smallest slope in units of its standard deviation.
_KNOWN = 0.3


@dataclass(frozen=True)
class Curves:
    """Rows of all sets: abscissa, ordinates (one row per quantity), number of the set."""

    x: FloatArray
    y: FloatArray
    owner: npt.NDArray[np.intp]
    temperatures: FloatArray


@dataclass(frozen=True)
class Ties:
    """Shifts between neighbouring sets from common levels, and slopes at these levels."""

    start: FloatArray
    slopes: FloatArray


def neighbours(curves: Curves) -> Ties:
    """Shifts from each set to the next from common levels."""
    n = curves.temperatures.size
    shifts, slopes = np.zeros(n), np.zeros(n - 1)
    for i in range(1, n):
        cold, warm = (curves.owner == k for k in (i - 1, i))
        # Storage and relaxation moduli increase with frequency; small decreases are scatter.
        a, b = (
            np.maximum.accumulate(curves.y[0][m][np.argsort(curves.x[m])]) for m in (cold, warm)
        )
        xa, xb = np.sort(curves.x[cold]), np.sort(curves.x[warm])
        low, high = max(a[0], b[0]), min(a[-1], b[-1])
        if not low < high:
            raise InputError(
                f"data: the sets at {curves.temperatures[i - 1]:.4g} and "
                f"{curves.temperatures[i]:.4g} deg C do not overlap: no modulus "
                "(over b_T) is in both, sets between them must be "
                "measured"
            )
        levels = np.linspace(low, high, 17)
        tilt = 1e-12 * np.arange(max(a.size, b.size))
        at = [np.interp(levels, y + tilt[: y.size], x) for y, x in ((a, xa), (b, xb))]
        shifts[i] = shifts[i - 1] - float(np.median(at[0] - at[1]))
        # The smaller slope limits the accuracy of a frequency from a level.
        slopes[i - 1] = min((y[-1] - y[0]) / (x[-1] - x[0]) for y, x in ((a, xa), (b, xb)))
    return Ties(-shifts, slopes)


def flatness(curves: Curves, turn: FloatArray, scatter: float) -> FloatArray:
    """Uncertainty of shifts between neighbours by scatter, which is large for flat sets.

    The error of a level is scatter/sqrt(rows), that of a shift this error divided by the slope. The
    errors accumulate from set to set. The slope is that of a straight line through a set minus its
    standard deviation, because the slope of a flat set is due to scatter.
    """
    sets = [curves.owner == i for i in range(curves.temperatures.size)]
    rows = np.array([own.sum() for own in sets])
    slopes = np.empty(rows.size)
    for i, own in enumerate(sets):
        x = curves.x[own] - curves.x[own].mean()
        doubt = scatter / np.linalg.norm(x)
        slopes[i] = max(curves.y[0][own] @ x / (x @ x) - doubt, _KNOWN * doubt, 1e-6)
    known = np.sqrt(np.minimum(rows[1:], rows[:-1]))
    pairs = scatter / np.minimum(slopes[1:], slopes[:-1]) / known
    steps = np.tril(np.ones((rows.size, rows.size - 1)), -1) * pairs
    return np.asarray(np.sqrt(((turn @ steps) ** 2).sum(axis=1)))


class _Spline:
    """A cubic spline for the whole curve, and its least-squares problem."""

    def __init__(self, curves: Curves, ties: Ties, lifted: bool, knots: float) -> None:
        self.curves, self.ties, self.lifted, self.knots = curves, ties, lifted, knots
        n = ties.start.size
        self.one_hot = np.zeros((curves.x.size, n))
        self.one_hot[np.arange(curves.x.size), curves.owner] = 1.0
        self.between = np.diff(np.eye(n), axis=0)[:, 1:]

    def residuals(
        self, s: FloatArray, lift: FloatArray, slopes: bool
    ) -> tuple[FloatArray, FloatArray, int]:
        """Residuals of rows, bends and ties; derivatives, with the spline coefficients last."""
        from scipy.interpolate import BSpline

        curves, free = self.curves, s.size - 1
        x, design, bend = _design(curves.x + s[curves.owner], self.knots)
        m, parts = design.shape[1], curves.y.shape[0]
        width = free * (2 if self.lifted else 1) + parts * m
        target, rows = [], []
        whole = np.vstack([design, bend])
        normal = whole.T @ whole
        for k in range(parts):
            y = curves.y[k] + lift[curves.owner]
            coefficients = np.linalg.solve(normal, design.T @ y)
            target += [y - design @ coefficients, -bend @ coefficients]
            if slopes:
                low, high = x.min(), x.max()
                slope = BSpline(_knots(low, high, self.knots), coefficients, 3).derivative()(x)
                block = np.zeros((curves.x.size + m - 2, width))
                block[: curves.x.size, :free] = slope[:, np.newaxis] * self.one_hot[:, 1:]
                if self.lifted:
                    block[: curves.x.size, free : 2 * free] = -self.one_hot[:, 1:]
                first = width - (parts - k) * m
                block[:, first : first + m] = whole
                rows.append(block)
        gap = np.diff(s) - np.diff(self.ties.start)
        target.append(-self.ties.slopes * gap)
        if slopes:
            tie = np.zeros((free, width))
            tie[:, :free] = self.ties.slopes[:, np.newaxis] * self.between
            rows.append(tie)
        return np.concatenate(target), np.vstack(rows) if slopes else np.zeros((0, 0)), m


def _knots(low: float, high: float, apart: float) -> FloatArray:
    count = max(int(np.ceil((high - low) / apart)), 3)
    return np.asarray(low + (high - low) / count * np.arange(-3, count + 4))


def _design(x: FloatArray, apart: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Abscissas, spline basis at the abscissas, and the penalty on bends."""
    from scipy.interpolate import BSpline

    knots = _knots(x.min(), x.max(), apart)
    inside = np.clip(x, knots[3], knots[-4])
    design = BSpline.design_matrix(inside, knots, 3).toarray()
    return inside, design, _PENALTY**0.5 * np.diff(np.eye(design.shape[1]), 2, axis=0)


def superpose(
    curves: Curves, ties: Ties, lifted: bool, knots: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Factors (set 0 fixed), their covariance, and vertical shifts, by Gauss-Newton."""
    n = ties.start.size
    free = n - 1
    spline = _Spline(curves, ties, lifted, knots)
    s, lift = ties.start.copy(), np.zeros(n)
    for _ in range(_STEPS):
        target, matrix, _ = spline.residuals(s, lift, True)
        # The weak penalty acts on every coefficient: the normal matrix is far from singular.
        step = np.linalg.solve(matrix.T @ matrix, matrix.T @ target)
        change, raised = step[:free], step[free : 2 * free] if lifted else np.zeros(free)
        damp = min(1.0, 0.5 / max(float(np.abs(change).max()), 1e-300))
        cost = float(target @ target)
        while damp > 1e-4:
            ahead = s + damp * np.concatenate([[0], change])
            above = lift + damp * np.concatenate([[0], raised])
            trial = spline.residuals(ahead, above, False)[0]
            if float(trial @ trial) <= cost * (1 + 1e-12):
                break
            damp /= 2
        else:
            break
        s, lift = ahead, above
        if damp * np.abs(change).max() < 1e-6:
            break
    target, matrix, _ = spline.residuals(s, lift, True)
    inverse = np.linalg.inv(matrix.T @ matrix)
    # Bends hardly contribute: degrees of freedom are the rows minus the fitted unknowns.
    count = curves.y.size
    variance = float(target @ target) / max(count + free - matrix.shape[1], 1)
    covariance = np.zeros((n, n))
    covariance[1:, 1:] = variance * inverse[:free, :free]
    return s, covariance, -lift


def _smooth(x: FloatArray, y: FloatArray) -> FloatArray:
    """Residuals from a spline as in `superpose`."""
    _, design, bend = _design(x, KNOTS)
    rows = np.vstack([design, bend])
    found = np.linalg.solve(rows.T @ rows, design.T @ y)
    return np.asarray(y - design @ found)


def scatter_of(curves: Curves, decades: FloatArray) -> float:
    """Root mean square distance of the rows from one smooth curve (decades)."""
    x = curves.x + decades[curves.owner]
    return float(np.sqrt(np.mean([np.mean(_smooth(x, y) ** 2) for y in curves.y])))
