"""Least squares fits of lines, steady or decaying, to a signal."""

import math
from copy import copy
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.signals import windowed

_MAX_ITERATIONS = 60
#: Initial and largest damping of a step, relative to the diagonal.
_FIRST_DAMPING, _MOST_DAMPING = 1e-3, 1e8
#: Lines below this part of the largest are rounding errors.
_FLOOR = 1e-12
#: Number of bins around a line; every third gives the noise.
_NEIGHBOURHOOD = 192
#: Relative accuracy of lines while further lines are searched.
ROUGH = 1e-6
#: Largest condition number; beyond it the frequencies are indistinguishable.
_MAX_CONDITION = 1e12
#: A line decays if the decay lowers the sum of squares by this number of variances of the nearby
#: noise. By chance this happens once in 1e7 cases (square of a normal variable).
_DECAYS = 30.0
#: Starting values x of a decay by exp(-2 x) over the record, and the largest decay.
_STARTS = (0.3, 1.0, 3.0, 10.0, 30.0, 80.0)
_MOST_DECAY = 150.0
#: A steady line within this distance (bins) of a peak of the residual may be decaying.
_NEAR = 6.0


class LineFit:
    """Lines and their least squares fit; frequencies and rates of decay per sample."""

    def __init__(self, samples: FloatArray, omega: FloatArray) -> None:
        self.samples, self.omega = samples, np.asarray(omega, dtype=float)
        n = self.omega.size
        self.decay, self.a, self.b = np.zeros(n), np.zeros(n), np.zeros(n)
        #: Flags of lines that may decay.
        self.damped = np.zeros(n, dtype=bool)
        self._signal = _native.Handle("spectrum signal", signal=samples)
        self.mean = float(samples.mean())
        self.half = max(0.5 * (samples.size - 1), 1.0)
        #: Weighted sum of squares of the residual, from the last call of ``sums``.
        self.total = math.inf
        #: The rounding error of this sum.
        self.rounding = 0.5 * samples.size * (1e-15 * float(np.abs(samples).max(initial=0.0))) ** 2

    def with_line(self, omega: float) -> "LineFit":
        """Add a line of amplitude 0."""
        more = copy(self)
        more.omega = np.append(self.omega, omega)
        more.decay, more.a, more.b = (np.append(x, 0.0) for x in (self.decay, self.a, self.b))
        more.damped = np.append(self.damped, False)
        return more

    def sums(self, free: bool, damped: npt.NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
        """Matrix and right-hand side of a step; store the weighted sum of squares in ``total``."""
        places = np.flatnonzero(damped).astype(np.int32) + 1
        n_free = self.omega.size if free else 0
        found = self._run("line_sums", n_free=n_free, free_decay=places)
        self.total = float(found["total"])
        return found["matrix"], found["right"]

    def solve_amplitudes(self, times: int = 2) -> bool:
        """Fit mean and amplitudes; the second time removes rounding errors."""
        for _ in range(times):
            change = _solution(*self.sums(False, np.zeros(self.omega.size, dtype=bool)))
            if change is None:
                return False
            self._move_amplitudes(change)
        return True

    def refine(self, enough: float = 1e-14) -> bool:
        """Least squares in all parameters, until the steps are small enough.

        Gauss-Newton steps, damped towards steepest descent (Levenberg, Marquardt) while a step
        increases the residual, so the fit never gets worse. Amplitudes are solved for at each step
        with the decay rates, which makes the sum of squares far less curved (Golub and Pereyra,
        Inverse Problems 19, 2003).
        """
        n = self.omega.size
        apart = bool(self.damped.any())
        if apart and not self.solve_amplitudes(1):
            return False
        matrix, right = self.sums(True, self.damped)
        smallest, damping = math.inf, 0.0
        for _ in range(_MAX_ITERATIONS):
            change = _solution(matrix, right, damping)
            if change is None:
                return False
            size = float(np.abs(change[1 + 2 * n :]).max(initial=0.0))
            settled = size <= enough or (size <= 1e-9 and size >= 0.5 * smallest)
            # First-order decrease of the sum of squares by the step.
            settled |= float(change @ right) <= enough * self.total
            trial = copy(self)
            better = trial._step(change) and (not apart or trial.solve_amplitudes(1))
            if better:
                matrix_there, right_there = trial.sums(True, self.damped)
                better = trial.total <= self.total + self.rounding
            if better:
                self._restore(trial)
                matrix, right = matrix_there, right_there
                smallest, damping = min(smallest, size), 0.1 * damping
            elif settled or damping > _MOST_DAMPING:
                break
            else:
                damping = max(10 * damping, _FIRST_DAMPING)
                continue
            if settled and damping <= _FIRST_DAMPING:
                break
        return True

    def let_decay(self, line: int) -> "LineFit | None":
        """Fit again with a line that may decay or grow; None if this cannot be solved."""
        best: LineFit | None = None
        for size in (*_STARTS, *(-x for x in _STARTS)):
            trial = copy(self)
            trial.decay = self.decay.copy()
            trial.decay[line] = size / self.half
            trial.a, trial.b = self.a.copy(), self.b.copy()
            if not trial.solve_amplitudes(1):
                continue
            trial.sums(False, np.zeros(self.omega.size, dtype=bool))
            if best is None or trial.total < best.total:
                best = trial
        if best is None:
            return None
        best.damped = self.damped.copy()
        best.damped[line] = True
        return best if best.refine(ROUGH) else None

    def settle_decays(self) -> "LineFit":
        """Select the lines that decay according to the signal."""
        fit = self
        for line in fit._decays_seen():
            trial = fit.let_decay(line)
            if trial is None or not trial.refine():
                continue
            if fit.total - trial.total > _DECAYS * trial.noise(line):
                fit = trial
        for line in map(int, np.flatnonzero(fit.damped)):
            steady = copy(fit)
            steady.damped, steady.decay = fit.damped.copy(), fit.decay.copy()
            steady.damped[line], steady.decay[line] = False, 0.0
            if not (steady.solve_amplitudes() and steady.refine()):
                continue
            if steady.total - fit.total <= _DECAYS * fit.noise(line):
                fit = steady
        return fit

    def _decays_seen(self) -> list[int]:
        """Steady lines whose decay would, to first order, lower the sum of squares enough."""
        steady = np.flatnonzero(~self.damped)
        if not steady.size:
            return []
        matrix, right = self.sums(True, np.ones(self.omega.size, dtype=bool))
        first = matrix.shape[0] - self.omega.size
        known = [*range(first), *(first + np.flatnonzero(self.damped))]
        without = _solution(matrix[np.ix_(known, known)], right[known])
        if without is None:
            return []
        before = without @ right[known]
        gains = {}
        for line in map(int, steady):
            with_it = [*known, first + line]
            change = _solution(matrix[np.ix_(with_it, with_it)], right[with_it])
            if change is not None:
                gains[line] = change @ right[with_it] - before
        # The noise takes a spectrum, and it is at least the rounding error.
        if max(gains.values(), default=0.0) <= _DECAYS * self.least_noise:
            return []
        left = self._left()
        return [line for line, gain in gains.items() if gain > _DECAYS * self.noise(line, left)]

    @property
    def least_noise(self) -> float:
        """Rounding error as the variance of a sample."""
        return 2 * self.rounding / self.samples.size

    def noise(self, line: int, amplitudes: FloatArray | None = None) -> float:
        """Variance of a sample of the noise near a line, at least the rounding error.

        It follows from the powers of nearby bins without lines: under a Hann window their mean is
        6/n of the variance. ``amplitudes``: those of the residual, if known.
        """
        n = self.samples.size
        if amplitudes is None:
            amplitudes = self._left()
        bins = np.arange(amplitudes.size)
        places = self.omega * n / (2 * math.pi)
        widths = 3.0 + np.abs(self.decay) * n / (2 * math.pi)
        free = np.all(np.abs(np.subtract.outer(bins, places)) > widths, axis=1) & (bins > 2)
        distance = np.abs(bins - places[line])
        near = np.flatnonzero(free)[np.argsort(distance[free], kind="stable")[:24]]
        if near.size < 4:
            return max(self.least_noise, 2 * self.total / n)
        return max(self.least_noise, n / 6 * float((amplitudes[near] ** 2).mean()))

    def next_line(self, alarm: float) -> float | None:
        """Frequency of the largest peak above rounding errors and noise; None: no peak."""
        n = self.samples.size
        amplitudes = self._left()
        for position in self.omega * n / (2 * math.pi):
            amplitudes[max(0, round(position - 1)) : round(position + 1) + 1] = 0.0
        above = np.where(self._stands_out(amplitudes, alarm), amplitudes, 0.0)
        k = int(above.argmax())
        if above[k] == 0.0:
            return None
        # With a Hann window the two largest neighbouring bins give the position of the peak.
        before = amplitudes[k - 1]
        after = amplitudes[k + 1] if k + 1 < amplitudes.size else 0.0
        ratio = max(before, after) / amplitudes[k]
        offset = (2 * ratio - 1) / (ratio + 1) * (1 if after >= before else -1)
        position = k + max(-0.5, min(0.5, offset))
        return float(min(max(2 * math.pi * position / n, 0.1 / n), math.pi * (1 - 0.1 / n)))

    def disturbed(self, alarm: float) -> npt.NDArray[np.bool_]:
        """Lines with a nearby residual above the noise, which the fit does not explain."""
        left = np.flatnonzero(self._stands_out(self._left(), alarm))
        in_bins = self.samples.size / (2 * math.pi)
        distance = np.abs(np.subtract.outer(self.omega * in_bins, left))
        reach = _NEAR + 2 * np.abs(self.decay) * in_bins
        return np.asarray((distance <= reach[:, np.newaxis]).any(axis=1))

    def _stands_out(self, amplitudes: FloatArray, alarm: float) -> npt.NDArray[np.bool_]:
        """Mask of bins above rounding errors and noise; ``alarm``: probability of a false alarm."""
        amplitudes[0] = 0.0
        largest = float(np.hypot(self.a, self.b).max(initial=0.0))
        above = amplitudes > _FLOOR * max(largest, float(np.abs(self.samples).max()))
        return above & _stands_out(amplitudes, alarm) if alarm < 1 and above.any() else above

    def steady_near(self, omega: float) -> int | None:
        """Line nearest to a frequency, if it is near and steady so far."""
        if not self.omega.size:
            return None
        distance = np.abs(self.omega - omega) * self.samples.size / (2 * math.pi)
        line = int(distance.argmin())
        return line if distance[line] <= _NEAR and not self.damped[line] else None

    def _left(self) -> FloatArray:
        """Amplitude spectrum of the residual under a Hann window."""
        left = self._run("line_residual")["residual"]
        spectra, _ = windowed(left[:, np.newaxis], 2)
        amplitudes: FloatArray = np.abs(spectra[:, 0])
        return amplitudes

    def _run(self, task: str, **values: Any) -> dict[str, Any]:
        """Run a task on samples and lines; with many samples such that Ctrl-C works."""
        table, mean = self._table(), float(self.mean)

        def work() -> dict[str, Any]:
            return _native.run(f"spectrum {task}", self._signal, lines=table, mean=mean, **values)

        many = self.samples.size * (1 + self.omega.size) > _native.MANY_SAMPLES
        return _native.apart(work) if many else work()

    def _table(self) -> FloatArray:
        return np.array([self.omega, self.decay, self.a, self.b], order="F")

    def _restore(self, other: "LineFit") -> None:
        self.__dict__.update(copy(other).__dict__)

    def _move_amplitudes(self, change: FloatArray) -> None:
        n = self.omega.size
        self.mean += float(change[0])
        self.a = self.a + change[1 : 1 + 2 * n : 2]
        self.b = self.b + change[2 : 2 + 2 * n : 2]

    def _step(self, change: FloatArray) -> bool:
        """Change all parameters; return False if a frequency leaves its range."""
        n = self.omega.size
        moved, decays = np.split(change[1 + 2 * n :], [n])
        self._move_amplitudes(change)
        # Limit a step to one bin for frequencies, and to a factor e^(2 pi) for decays.
        largest = float(np.abs(change[1 + 2 * n :]).max(initial=1e-300))
        share = min(1.0, math.pi / largest)
        self.omega = self.omega + share * moved / self.half
        if decays.size:
            self._move_decays(share * decays / self.half)
        return bool(np.all((self.omega > 0) & (self.omega < math.pi)))

    def _move_decays(self, change: FloatArray) -> None:
        limit = _MOST_DECAY / self.half
        before, after = self.decay, self.decay.copy()
        after[self.damped] = np.clip(before[self.damped] + change, -limit, limit)
        # The amplitude refers to the first sample, or to the last sample of a growing line.
        turned = np.where((before >= 0) & (after < 0), 1.0, 0.0) - np.where(
            (before < 0) & (after >= 0), 1.0, 0.0
        )
        factor = np.exp(-turned * after * (self.samples.size - 1))
        self.a, self.b, self.decay = self.a * factor, self.b * factor, after


def _solution(matrix: FloatArray, right: FloatArray, damping: float = 0.0) -> FloatArray | None:
    """Change of the parameters, or None if they are indistinguishable.

    ``damping``: addition to the diagonal, relative to it.
    """
    scale = np.sqrt(matrix.diagonal())
    if not scale.min() > 0 or not _native.all_finite(matrix):
        return None
    scaled = matrix / scale / scale[:, np.newaxis]
    if damping > 0:
        scaled += damping * np.eye(scale.size)
    values, vectors = np.linalg.eigh(scaled)
    if values[0] * _MAX_CONDITION < values[-1]:
        return None
    change: FloatArray = vectors @ ((vectors.T @ (right / scale)) / values) / scale
    return change


def _stands_out(amplitudes: FloatArray, alarm: float) -> npt.NDArray[np.bool_]:
    """Mask of bins except 0 above the surrounding noise; ``alarm``: probability of a false bin.

    Let M be the j-th smallest of m independent powers with the same exponential distribution. One
    more exceeds c M with probability prod_i (m - i + 1)/(m - i + 1 + c), i = 1 ... j.
    """
    power = amplitudes**2
    n = power.size
    n_blocks = max(1, n // _NEIGHBOURHOOD)
    width = -(-n // n_blocks)
    padded = np.zeros(n_blocks * width)
    padded[:n] = power
    around = np.sort(padded.reshape(n_blocks, width)[:, ::3], axis=1)
    empty = (around == 0.0).sum(axis=1)
    # Exclude the bin itself and its neighbour in the window.
    m = np.maximum(around.shape[1] - empty - 2, 1)
    j = (m + 1) // 2
    median = around[np.arange(n_blocks), np.minimum(empty + j - 1, around.shape[1] - 1)]
    limit = np.empty(n_blocks)
    for size in np.unique(m):
        limit[m == size] = _multiple(int(size), alarm / max(n - 1, 1))
    return np.asarray(power > np.repeat(limit * median, width)[:n])


@cache
def _multiple(m: int, probability: float) -> float:
    """Multiple c of the median of m powers that a further power exceeds with a probability.

    Newton's method from below: the logarithm of the probability is convex in c.
    """
    waits = m - np.arange((m + 1) // 2)
    c = step = 0.0
    while c == 0.0 or step > 1e-14 * c:
        excess = float(np.log1p(c / waits).sum()) + math.log(probability)
        step = -excess / float((1 / (waits + c)).sum())
        c += step
    return c
