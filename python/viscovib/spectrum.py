"""Spectra of signals: windows, amplitudes at known frequencies, and lines found to many digits."""

import csv
import itertools
import math
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
import numpy.typing as npt
import xarray as xr

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray, core
from viscovib.errors import InputError
from viscovib.files import whole_file
from viscovib.plan import Plan

WINDOWS = ("rectangular", "hann", "blackman_harris", "flat_top")

_MAX_LINES = 50
_MAX_ITERATIONS = 30
#: Lines smaller than this part of the largest are rounding.
_FLOOR = 1e-12
#: Bins of every third of which the noise around a line is judged.
_NEIGHBOURHOOD = 192
#: While lines are still being found the others need not be known to rounding.
_ROUGH = 1e-6
#: Least squares worse conditioned than this cannot tell the frequencies apart.
_MAX_CONDITION = 1e12


@dataclass(frozen=True, eq=False)
class Spectrum:
    """One-sided amplitude spectrum.

    Attributes
    ----------
    omega : ndarray, shape (n_bins,)
        Circular frequencies (rad per unit of time), from 0 to half the sampling rate.
    coefficients : complex ndarray, shape (n_bins,) or (n_bins, m)
        X: a tone a cos(omega t + phase) at a bin gives a exp(i phase); X[0] is the mean.
    window : str
    noise_bandwidth : float
        Equivalent noise bandwidth of the window in bins: divide abs(X)**2 / 2 by this and by the
        bin width to get a power spectral density.
    dt : float
        Sampling step.
    names : tuple of str
        A name for each signal.
    plan : Plan
        What was computed, what was skipped and why.
    """

    omega: FloatArray
    coefficients: ComplexArray
    window: str
    noise_bandwidth: float
    dt: float
    names: tuple[str, ...]
    plan: Plan

    @property
    def amplitude(self) -> FloatArray:
        """Size of each coefficient."""
        return np.abs(self.coefficients)

    @property
    def phase(self) -> FloatArray:
        """Phase of each coefficient (rad), at the first sample."""
        return np.angle(self.coefficients)

    def to_dataset(self) -> xr.Dataset:
        """Amplitude and phase as an xarray Dataset over omega."""
        dimensions = ("omega", "signal")[: self.coefficients.ndim]
        return xr.Dataset(
            {"amplitude": (dimensions, self.amplitude), "phase": (dimensions, self.phase)},
            coords={"omega": self.omega},
            attrs={
                "window": self.window,
                "noise_bandwidth": self.noise_bandwidth,
                "dt": self.dt,
                "plan": str(self.plan),
            },
        )

    def to_csv(self, path: str | Path) -> None:
        """Write a table: one row a frequency, amplitude and phase of each signal."""
        columns = self.coefficients.reshape(self.omega.size, -1)
        names = [f"{name}_{kind}" for name in self.names for kind in ("amplitude", "phase")]
        with whole_file(path) as file:
            file.write(f"# viscovib {version('viscovib')}\n{self.plan.comments()}")
            file.write(f"# window {self.window}; omega in rad per unit of time, phases in rad at ")
            file.write("the first sample\n")
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["omega", *names])
            for omega, row in zip(self.omega, columns, strict=True):
                cells = [part for x in row for part in (abs(x), np.angle(x))]
                writer.writerow([f"{value:.16e}" for value in (omega, *cells)])


@dataclass(frozen=True, eq=False)
class Lines:
    """Lines of a signal: u(t) = mean + sum_j amplitude_j cos(omega_j t + phase_j).

    Attributes
    ----------
    omega : ndarray, shape (n,)
        Circular frequencies (rad per unit of time).
    amplitude, phase : ndarray, shape (n,)
        Phases (rad) at time 0.
    mean : float
    residual : float
        Root mean square of what is left, weighted towards the middle of the record.
    resolved : ndarray of bool, shape (n,)
        False where another line is nearer than two bins: such a pair is only as good as the
        signal is clean.
    """

    omega: FloatArray
    amplitude: FloatArray
    phase: FloatArray
    mean: float
    residual: float
    resolved: npt.NDArray[np.bool_]

    def __call__(self, t: npt.ArrayLike) -> FloatArray:
        """Value of the sum at times t."""
        times = _native.real_array("t", t)
        angles = np.multiply.outer(times, self.omega) + self.phase
        result: FloatArray = self.mean + np.cos(angles) @ self.amplitude
        return result


def spectrum(
    signal: npt.ArrayLike,
    dt: float,
    *,
    window: str = "hann",
    names: tuple[str, ...] | None = None,
) -> Spectrum:
    """Amplitude spectrum of signals sampled in equal steps, by FFTW.

    Parameters
    ----------
    signal : array_like, shape (n,) or (n, m)
        One signal or several, a column each; n >= 1.
    dt : float
        Sampling step.
    window : {"hann", "rectangular", "blackman_harris", "flat_top"}
        "rectangular" is exact for whole periods; "hann" for looking; "blackman_harris" for small
        lines beside large ones; "flat_top" reads amplitudes between bins to 0.2 %.
    names : tuple of str
        Names of the signals; by default "signal", or "signal_1", "signal_2", ...

    Notes
    -----
    The mean under the window is taken out before the transform and returned as X[0], so that it
    does not leak. Records of fewer than 10 samples are not windowed.
    """
    samples, step = _samples(signal, dt, most=2)
    kind = WINDOWS.index(_native.choice("window", window, WINDOWS)) + 1
    n = samples.shape[0]
    columns = samples.reshape(n, -1)
    m = columns.shape[1]
    if names is None:
        names = ("signal",) if samples.ndim == 1 else tuple(f"signal_{j + 1}" for j in range(m))
    if len(names) != m:
        raise InputError(f"names: {len(names)} given, must be {m}, one a signal")
    spectra, bandwidth = core.windowed_spectrum(
        np.asfortranarray(columns), kind, n_spectrum=n // 2 + 1
    )
    return Spectrum(
        omega=2 * math.pi / (n * step) * np.arange(n // 2 + 1),
        coefficients=np.ascontiguousarray(spectra).reshape(n // 2 + 1, *samples.shape[1:]),
        window=window,
        noise_bandwidth=float(bandwidth),
        dt=step,
        names=tuple(names),
        plan=Plan(
            f"computes: spectra of {', '.join(names)}, {n} samples, window {window}\n"
            "skips: negative frequencies (signals are real)"
            + ("\nskips: the window (fewer than 10 samples)" if n < 10 else "")
        ),
    )


def amplitudes_at(
    signal: npt.ArrayLike, dt: float, frequencies: npt.ArrayLike, *, start: float = 0.0
) -> Lines:
    """Amplitudes and phases at known frequencies, by least squares.

    Exact for signals that hold no other lines, whole periods or not; other lines disturb little,
    since the middle of the record weighs most (Hann).

    Parameters
    ----------
    signal : array_like, shape (n,)
    dt : float
        Sampling step.
    frequencies : array_like, shape (m,)
        Circular frequencies, below half the sampling rate (pi/dt), ascending or not.
    start : float
        Time of the first sample, to which phases refer back.
    """
    samples, step = _samples(signal, dt, most=1)
    omega = _native.real_array("frequencies", frequencies, ndim=1)
    if not 1 <= omega.size <= _MAX_LINES:
        raise InputError(f"frequencies: {omega.size} given, must be 1 to {_MAX_LINES}")
    limit = math.pi / step
    for j, value in enumerate(omega):
        if not 0 < value < limit:
            raise InputError(
                f"frequencies[{j}] = {value:g}: must be greater than 0 and less than {limit:g}, "
                "half the sampling rate"
            )
    if samples.size < 2 * omega.size + 1:
        raise InputError(
            f"signal: {samples.size} samples, must be at least {2 * omega.size + 1} for "
            f"{omega.size} frequencies"
        )
    begin = _native.number("start", start)
    fit = _Fit(samples, omega * step)
    fitted = fit.solve_amplitudes()
    fit.total = fit.sums(0)[2]
    if not fitted:
        raise InputError(
            f"frequencies: too close together, or to 0, for a record of {samples.size * step:g}: "
            f"must be some {2 * math.pi / (samples.size * step):g} apart"
        )
    return fit.lines(step, begin)


def dominant_frequencies(
    signal: npt.ArrayLike,
    dt: float,
    *,
    count: int = 5,
    start: float = 0.0,
    false_alarm: float = 1e-3,
) -> Lines:
    """Find the largest lines of a signal, far beyond the width of a bin.

    The largest peak of the windowed spectrum is refined, and with it all lines found before, by
    weighted least squares in amplitudes and frequencies together; then the next is sought in what
    is left. Fewer than ``count`` lines come back if nothing is left that stands above the noise
    around it, or above rounding.

    Parameters
    ----------
    signal : array_like, shape (n,)
        n >= 16.
    dt : float
        Sampling step.
    count : int
        Lines wanted, 1 to 50.
    start : float
        Time of the first sample, to which phases refer back.
    false_alarm : float
        Probability, in (0, 1], that a signal of nothing but noise gives a line at all. 1: take
        the largest of what is left, line or not.

    Returns
    -------
    Lines, largest first. For a clean signal errors are at rounding level; a line that is not
    resolved from its neighbour (see `Lines.resolved`) is less certain. In white noise the standard
    error of a frequency is 1.53 times the least possible one (Cramer and Rao), that of an
    amplitude 1.22 times: the price of the window, which keeps other lines out.

    Notes
    -----
    The power of a bin must exceed a multiple of the median of the bins around it, every third of
    192, over which noise may have any level but should be nearly even. Under the window of Hann
    these are independent, so that the multiple follows from the probability without further
    assumptions on the level (order statistics: Rohling, IEEE Trans. AES 19 (1983) 608).
    """
    samples, step = _samples(signal, dt, most=1)
    wanted = _native.integer("count", count, 1, _MAX_LINES)
    if samples.size < 16:
        raise InputError(f"signal: {samples.size} samples, must be at least 16")
    begin = _native.number("start", start)
    alarm = _native.number("false_alarm", false_alarm)
    if not 0 < alarm <= 1:
        raise InputError(f"false_alarm = {alarm:g}: must be in (0, 1]")
    fit = _Fit(samples, np.empty(0))
    fit.total = fit.sums(0)[2]
    for _ in range(wanted):
        if samples.size < 3 * (fit.omega.size + 1) + 2:
            break
        guess = fit.next_line(alarm)
        if guess is None:
            break
        trial = fit.with_line(guess)
        if not (trial.solve_amplitudes(1) and trial.refine(_ROUGH)):
            break
        if trial.total >= fit.total * (1 - 1e-12):
            break
        fit = trial
    final = copy(fit)
    if fit.omega.size and final.refine():
        fit = final
    fit.solve_amplitudes()
    fit.total = fit.sums(0)[2]
    return fit.lines(step, begin)


def name_frequencies(
    frequencies: npt.ArrayLike,
    bases: Mapping[str, float],
    *,
    order: int = 5,
    tolerance: float = 1e-6,
) -> list[str]:
    """Name frequencies as combinations of known ones, such as "2 p1 - p2".

    Parameters
    ----------
    frequencies : array_like, shape (n,)
    bases : mapping of name to frequency
    order : int
        Largest sum of the sizes of the factors, 1 to 20.
    tolerance : float
        Largest distance.

    Returns
    -------
    A name each: of the lowest order within the tolerance, several of the same order joined by
    " or "; "mean" for 0; "" where none fits.
    """
    values = np.atleast_1d(_native.real_array("frequencies", frequencies))
    if values.ndim != 1:
        raise InputError(f"frequencies: must have 0 or 1 dimension(s), got shape {values.shape}")
    if not _native.mapping("bases", bases):
        raise InputError("bases: must not be empty")
    known = {str(name): _native.number(f"bases[{name!r}]", value) for name, value in bases.items()}
    highest = _native.integer("order", order, 1, 20)
    width = _native.number("tolerance", tolerance)
    if width < 0:
        raise InputError(f"tolerance = {width:g}: must not be negative")
    span = range(-highest, highest + 1)
    if (2 * highest + 1) ** len(known) > 10**7:
        raise InputError(f"order = {highest}: too many combinations of {len(known)} frequencies")
    combinations = [
        (sum(map(abs, factors)), factors)
        for factors in itertools.product(span, repeat=len(known))
        if 0 < sum(map(abs, factors)) <= highest and next(filter(None, factors)) > 0
    ]
    orders = np.array([size for size, _ in combinations])
    sums = np.array([factors for _, factors in combinations]) @ np.array(list(known.values()))
    names = []
    for value in values:
        if abs(value) <= width:
            names.append("mean")
            continue
        near = np.flatnonzero(np.abs(np.abs(sums) - abs(value)) <= width)
        if not near.size:
            names.append("")
            continue
        best = near[orders[near] == orders[near].min()]
        names.append(
            " or ".join(
                _combination(tuple(known), np.sign(sums[i] * value) * np.array(combinations[i][1]))
                for i in best
            )
        )
    return names


def _combination(names: tuple[str, ...], factors: npt.NDArray[np.float64]) -> str:
    """Write sum of factor times name, a positive term first."""
    terms = sorted(
        ((int(k), name) for k, name in zip(factors, names, strict=True) if k),
        key=lambda x: x[0] < 0,
    )
    text = ""
    for k, name in terms:
        sign = ("- " if k < 0 else "+ ") if text else ("-" if k < 0 else "")
        size = "" if abs(k) == 1 else f"{abs(k)} "
        text += f"{' ' if text else ''}{sign}{size}{name}"
    return text


class _Fit:
    """Lines and their least squares fit; frequencies in rad a sample."""

    def __init__(self, samples: FloatArray, omega: FloatArray) -> None:
        self.samples, self.omega = samples, np.asarray(omega, dtype=float)
        self.a, self.b = np.zeros(self.omega.size), np.zeros(self.omega.size)
        self.mean = float(samples.mean())
        #: Weighted sum of the squares of what was left when it was last asked for.
        self.total = math.inf

    def with_line(self, omega: float) -> "_Fit":
        """Add a line of amplitude 0."""
        more = _Fit(self.samples, np.append(self.omega, omega))
        more.a, more.b, more.mean = np.append(self.a, 0.0), np.append(self.b, 0.0), self.mean
        return more

    def _table(self) -> FloatArray:
        return np.asfortranarray(np.stack([self.omega, self.a, self.b]))

    def sums(self, n_free: int) -> tuple[FloatArray, FloatArray, float]:
        """Matrix and right-hand side of a step, and the weighted sum of squares now."""
        matrix, right, total = core.fit_sums(
            self.samples, self._table(), self.mean, n_free, 1 + 2 * self.omega.size + n_free
        )
        return matrix, right, float(total)

    def _solve(self, n_free: int) -> FloatArray | None:
        """Return the change of all parameters, or None if they cannot be told apart."""
        matrix, right, self.total = self.sums(n_free)
        scale = np.sqrt(np.diag(matrix))
        if not np.all(scale > 0) or not np.all(np.isfinite(matrix)):
            return None
        scaled = matrix / np.outer(scale, scale)
        values, vectors = np.linalg.eigh(scaled)
        if values[0] * _MAX_CONDITION < values[-1]:
            return None
        change: FloatArray = vectors @ ((vectors.T @ (right / scale)) / values) / scale
        return change

    def solve_amplitudes(self, times: int = 2) -> bool:
        """Fit mean and amplitudes; the second time to remove what rounding left."""
        for _ in range(times):
            change = self._solve(0)
            if change is None:
                return False
            self.mean += float(change[0])
            self.a = self.a + change[1::2]
            self.b = self.b + change[2::2]
        return True

    def refine(self, enough: float = 1e-14) -> bool:
        """Gauss-Newton in amplitudes and frequencies together, to steps that are small enough."""
        n, half = self.omega.size, max(0.5 * (self.samples.size - 1), 1.0)
        smallest = math.inf
        for _ in range(_MAX_ITERATIONS):
            change = self._solve(n)
            if change is None:
                return False
            moved = change[1 + 2 * n :]
            # No line moves by more than a bin at once.
            damping = min(1.0, math.pi / max(float(np.abs(moved).max()), 1e-300))
            self.mean += float(change[0])
            self.a = self.a + change[1 : 1 + 2 * n : 2]
            self.b = self.b + change[2 : 1 + 2 * n : 2]
            self.omega = self.omega + damping * moved / half
            if not np.all((self.omega > 0) & (self.omega < math.pi)):
                return False
            size = float(np.abs(moved).max())
            if size <= enough or (size <= 1e-9 and size >= 0.5 * smallest):
                break
            smallest = min(smallest, size)
        return True

    def next_line(self, alarm: float) -> float | None:
        """Frequency of the largest peak that is neither rounding nor noise, None without one."""
        n = self.samples.size
        left = core.fit_residual(self.samples, self._table(), self.mean)
        amplitudes = np.abs(
            core.windowed_spectrum(left[:, np.newaxis], 2, n_spectrum=n // 2 + 1)[0][:, 0]
        )
        amplitudes[0] = 0.0
        bins = self.omega * n / (2 * math.pi)
        for position in bins:
            amplitudes[max(0, round(position - 1)) : round(position + 1) + 1] = 0.0
        above = amplitudes
        if alarm < 1:
            above = np.where(_stands_out(amplitudes, alarm), amplitudes, 0.0)
        k = int(above.argmax())
        largest = float(np.hypot(self.a, self.b).max(initial=0.0))
        scale = max(largest, float(np.abs(self.samples).max()))
        if above[k] <= _FLOOR * scale or above[k] == 0.0:
            return None
        # Between the bins of a Hann window the two largest neighbours tell where the peak is.
        before = amplitudes[k - 1]
        after = amplitudes[k + 1] if k + 1 < amplitudes.size else 0.0
        ratio = max(before, after) / amplitudes[k]
        offset = (2 * ratio - 1) / (ratio + 1) * (1 if after >= before else -1)
        position = k + max(-0.5, min(0.5, offset))
        return float(min(max(2 * math.pi * position / n, 0.1 / n), math.pi * (1 - 0.1 / n)))

    def lines(self, step: float, start: float) -> Lines:
        """Return the result, phases brought back to time 0."""
        n = self.samples.size
        amplitude = np.hypot(self.a, self.b)
        order = np.argsort(-amplitude, kind="stable")
        omega = self.omega[order]
        shift = omega * (0.5 * (n - 1) + start / step)
        phase = np.arctan2(-self.b[order], self.a[order]) - shift
        distance = np.abs(np.subtract.outer(omega, omega)) + 2 * math.pi * np.eye(omega.size)
        resolved = np.minimum(distance.min(axis=1, initial=math.inf), omega) > 4 * math.pi / n
        return Lines(
            omega=omega / step,
            amplitude=amplitude[order],
            phase=np.angle(np.exp(1j * phase)),
            mean=self.mean,
            residual=math.sqrt(max(self.total, 0.0) / (0.5 * n)),
            resolved=resolved,
        )


def _stands_out(amplitudes: FloatArray, alarm: float) -> npt.NDArray[np.bool_]:
    """Bins above the noise around them, but for a false alarm in any of all; 0 is no bin.

    Of m independent powers, exponentially distributed with one mean, let M be the j-th smallest.
    Another exceeds c M with probability prod_i (m - i + 1)/(m - i + 1 + c), i = 1 ... j.
    """
    power = amplitudes**2
    n = power.size
    n_blocks = max(1, n // _NEIGHBOURHOOD)
    width = -(-n // n_blocks)
    padded = np.zeros(n_blocks * width)
    padded[:n] = power
    around = np.sort(padded.reshape(n_blocks, width)[:, ::3], axis=1)
    empty = (around == 0.0).sum(axis=1)
    # The bin itself and its neighbour in the window may be among them.
    m = np.maximum(around.shape[1] - empty - 2, 1)
    j = (m + 1) // 2
    median = around[np.arange(n_blocks), np.minimum(empty + j - 1, around.shape[1] - 1)]
    limit = np.empty(n_blocks)
    for size in np.unique(m):
        limit[m == size] = _multiple(int(size), alarm / max(n - 1, 1))
    return np.asarray(power > np.repeat(limit * median, width)[:n])


def _multiple(m: int, probability: float) -> float:
    """Multiple c of the median of m powers that another exceeds with this probability."""
    waits = m - np.arange((m + 1) // 2)
    low, high = 0.0, 1.0
    while -np.log1p(high / waits).sum() > math.log(probability):
        low, high = high, 2 * high
    for _ in range(60):
        c = 0.5 * (low + high)
        if -np.log1p(c / waits).sum() > math.log(probability):
            low = c
        else:
            high = c
    return high


def _samples(signal: npt.ArrayLike, dt: float, *, most: int) -> tuple[FloatArray, float]:
    samples = _native.real_array("signal", signal)
    if not 1 <= samples.ndim <= most or samples.shape[0] == 0:
        shapes = "(n,)" if most == 1 else "(n,) or (n, m)"
        raise InputError(f"signal: must have shape {shapes} with n >= 1, got {samples.shape}")
    if samples.size and float(np.abs(samples).max()) > 1e150:
        raise InputError("signal: values beyond 1e150 leave the range of numbers")
    step = _native.number("dt", dt)
    if step <= 0:
        raise InputError(f"dt = {step:g}: must be greater than 0")
    return samples, step
