"""Lines of a signal: amplitudes at known frequencies, and lines with unknown frequencies."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.line_fit import ROUGH, LineFit
from viscovib.analyses.signals import read_signal
from viscovib.common.counts import things
from viscovib.common.results import Dataset, Result, as_dataset
from viscovib.errors import InputError
from viscovib.results.trajectory import Trajectory

_MAX_LINES = 50
#: Probability that noise causes such a residual near a line.
_DISTURBED = 1e-3


@dataclass(frozen=True, eq=False, repr=False)
class Lines(Result):
    """Lines of a signal.

    u(t) = mean + sum_j amplitude_j exp(-decay_j (t - start)) cos(omega_j t + phase_j)

    Attributes
    ----------
    omega : ndarray, shape (n,)
        Circular frequencies (rad per unit of time).
    amplitude, phase : ndarray, shape (n,)
        Amplitudes at the first sample, phases (rad) at time 0.
    mean : float
    residual : float
        Root mean square of the residual, weighted towards the middle of the record.
    resolved : ndarray of bool, shape (n,)
        False if the distance to a second line is less than two bins and the widths of both, so that
        noise limits the accuracy, or if a residual above the noise remains near the line, so that
        the lines do not explain the signal.
    decay : ndarray, shape (n,)
        Decay rates (per unit of time), 0 for a steady line, negative for a growing line. The
        damping ratio of a free vibration is ``decay / hypot(decay, omega)``.
    start : float
        Time of the first sample.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> t = 0.01 * np.arange(4096)
    >>> lines = vv.dominant_frequencies(
    ...     np.sin(12 * t) + 0.1 * np.sin(20 * t), 0.01, count=2
    ... )
    """

    omega: FloatArray
    amplitude: FloatArray
    phase: FloatArray
    mean: float
    residual: float
    resolved: npt.NDArray[np.bool_]
    decay: FloatArray
    start: float

    kind = "lines"

    @property
    def complete(self) -> bool:  # type: ignore[override]
        """True if all lines are resolved."""
        return bool(self.resolved.all())

    def _headline(self) -> str:
        close = int((~self.resolved).sum())
        apart = f", {close} close to another line" if close else ""
        found = things(self.omega.size, "line")
        return f"{found}, root mean square of the residual {self.residual:.2g}{apart}"

    def _scope(self) -> list[str]:
        lines = [
            f"omega {omega:.12g}: amplitude {amplitude:.6g}, phase {phase:.6g}"
            + (f", decay {decay:.6g}" if decay else "")
            for omega, amplitude, phase, decay in zip(
                self.omega, self.amplitude, self.phase, self.decay, strict=True
            )
        ]
        return [*lines[:8], *([f"and {len(lines) - 8} more"] if len(lines) > 8 else [])]

    def to_dataset(self) -> Dataset:
        """Return all data as an xarray Dataset over the lines."""
        names = ("omega", "amplitude", "phase", "decay", "resolved")
        return as_dataset(
            {name: ("line", getattr(self, name)) for name in names},
            attrs={"mean": self.mean, "residual": self.residual, "start": self.start},
        )

    def __call__(self, t: npt.ArrayLike) -> FloatArray:
        """Value of the sum at times t."""
        times = _native.real_array("t", t)
        angles = np.multiply.outer(times, self.omega) + self.phase
        envelope = np.exp(-np.multiply.outer(times - self.start, self.decay))
        result: FloatArray = self.mean + (envelope * np.cos(angles)) @ self.amplitude
        return result


def amplitudes_at(
    signal: npt.ArrayLike | Trajectory,
    dt: float | None = None,
    frequencies: npt.ArrayLike | None = None,
    *,
    start: float | None = None,
    coordinate: str | None = None,
) -> Lines:
    """Return amplitudes and phases at known frequencies, by least squares.

    The result is exact for signals that contain no other lines, for any record length. Other lines
    have little effect, because the middle of the record has the largest weight (Hann).

    Parameters
    ----------
    signal : array_like, shape (n,), or Trajectory
        For a `Trajectory` the given ``coordinate`` at the times of its states.
    dt : float
        Time between samples; only with an array.
    frequencies : array_like, shape (m,)
        Circular frequencies, below half the sampling rate (pi/dt), in any order.
    start : float
        Time of the first sample, 0 by default; only with an array.
    coordinate : str
        For a `Trajectory`: "phi", or "phi_dot" for its velocity.

    Returns
    -------
    Lines, in the order of ``frequencies``.

    Warns
    -----
    ConvergenceWarning
        If the velocities of a `Trajectory` show oscillations that are too fast for the states kept.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> t = 0.01 * np.arange(4096)
    >>> lines = vv.amplitudes_at(np.sin(12 * t), 0.01, [12.0])
    """
    source = read_signal(signal, dt, start=start, coordinates=coordinate, most=1)
    samples, step = source.samples, source.step
    if frequencies is None:
        raise InputError("frequencies: must be given")
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
    fit = LineFit(samples, omega * step)
    if not fit.solve_amplitudes():
        raise InputError(
            f"frequencies: too close together, or to 0, for a record of {samples.size * step:g}: "
            f"must be some {2 * math.pi / (samples.size * step):g} apart"
        )
    fit.sums(False, fit.damped)
    return _lines(fit, step, source.start, np.arange(omega.size))


def dominant_frequencies(
    signal: npt.ArrayLike | Trajectory,
    dt: float | None = None,
    *,
    count: int = 5,
    start: float | None = None,
    false_alarm: float = 1e-3,
    coordinate: str | None = None,
) -> Lines:
    """Find the largest lines of a signal with a resolution far better than a bin.

    The largest peak of the windowed spectrum is refined together with all previous lines, by
    weighted least squares in amplitudes and frequencies. Then the next line is searched in the
    residual. The result contains fewer than ``count`` lines if the residual contains no line above
    the surrounding noise or the rounding error.

    Parameters
    ----------
    signal : array_like, shape (n,), or Trajectory
        n >= 16. For a `Trajectory` the given ``coordinate`` at the times of its states.
    dt : float
        Time between samples; only with an array.
    count : int
        Largest number of lines, 1 to 50.
    start : float
        Time of the first sample, 0 by default; only with an array.
    false_alarm : float
        Probability, in (0, 1], that a signal of noise only gives a line. 1: use the largest peak of
        the residual in any case.
    coordinate : str
        For a `Trajectory`: "phi", or "phi_dot" for its velocity.

    Returns
    -------
    Lines, in the order of decreasing amplitude at the first sample. A decay rate is fitted if a
    steady line leaves a residual above the noise. Tones that decay within a few periods or within a
    hundredth of the record are not searched. For a signal without noise errors are at the level of
    rounding errors. A line that is not resolved (see `Lines.resolved`) is less certain. In white
    noise the standard error of a steady line's frequency is 1.53 times the lower bound (Cramer and
    Rao), that of its amplitude 1.22 times, because of the window.

    Warns
    -----
    ConvergenceWarning
        If the velocities of a `Trajectory` show oscillations that are too fast for the states kept.

    Notes
    -----
    The power of a bin must exceed a multiple of the median of the surrounding bins, every third of
    192, in which the noise may have any level but should be nearly constant. With a Hann window
    these are independent, so the multiple follows from the probability (order statistics: Rohling,
    IEEE Trans. AES 19 (1983) 608).

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> t = 0.01 * np.arange(4096)
    >>> lines = vv.dominant_frequencies(
    ...     np.sin(12 * t) + 0.1 * np.sin(20 * t), 0.01, count=2
    ... )
    """
    source = read_signal(signal, dt, start=start, coordinates=coordinate, most=1)
    samples = source.samples
    wanted = _native.integer("count", count, 1, _MAX_LINES)
    if samples.size < 16:
        raise InputError(f"signal: {samples.size} samples, must be at least 16")
    alarm = _native.number("false_alarm", false_alarm)
    if not 0 < alarm <= 1:
        raise InputError(f"false_alarm = {alarm:g}: must be in (0, 1]")
    fit = LineFit(samples, np.empty(0))
    fit.sums(False, fit.damped)
    while True:
        guess = fit.next_line(alarm)
        better = None if guess is None else _better(fit, guess, wanted)
        if better is None:
            break
        fit = better
    if fit.omega.size:
        final = copy(fit)
        if final.refine() and final.total <= fit.total + fit.rounding:
            fit = final
        fit = fit.settle_decays()
    first = np.hypot(fit.a, fit.b) * np.exp(np.minimum(fit.decay, 0.0) * (samples.size - 1))
    order = np.argsort(-first, kind="stable")
    explained = ~fit.disturbed(min(alarm, _DISTURBED))
    return _lines(fit, source.step, source.start, order, explained)


def _better(fit: LineFit, guess: float, wanted: int) -> LineFit | None:
    """Explain a peak of the residual by one more line, or by the decay of a nearby line."""
    more: LineFit | None = None
    if fit.omega.size < wanted and fit.samples.size >= 3 * (fit.omega.size + 1) + 2:
        more = fit.with_line(guess)
        if not (more.solve_amplitudes(1) and more.refine(ROUGH)) or more.total >= fit.total * (
            1 - 1e-12
        ):
            more = None
    line = fit.steady_near(guess)
    decaying = None if line is None else fit.let_decay(line)
    if decaying is None or line is None:
        return more
    if decaying.total >= fit.total - decaying.noise(line):
        return more
    # A new line has two more parameters and must gain more than noise does (Schwarz criterion).
    price = 2 * math.log(fit.samples.size) * decaying.noise(line)
    if more is not None and more.total < decaying.total - price:
        return more
    return decaying


def _lines(
    fit: LineFit,
    step: float,
    start: float,
    order: npt.NDArray[np.int_],
    explained: npt.NDArray[np.bool_] | bool = True,
) -> Lines:
    """Return the result in this order, with phases at time 0."""
    n = fit.samples.size
    omega, decay = fit.omega[order], fit.decay[order]
    # For a growing line the fit contains the amplitude at the last sample.
    first = np.hypot(fit.a, fit.b)[order] * np.exp(np.minimum(decay, 0.0) * (n - 1))
    shift = omega * (0.5 * (n - 1) + start / step)
    phase = np.arctan2(-fit.b[order], fit.a[order]) - shift
    distance = np.abs(np.subtract.outer(omega, omega)) + 2 * math.pi * np.eye(omega.size)
    distance -= np.add.outer(np.abs(decay), np.abs(decay))
    nearest = np.minimum(distance.min(axis=1, initial=math.inf), omega - np.abs(decay))
    return Lines(
        omega=omega / step,
        amplitude=first,
        phase=np.angle(np.exp(1j * phase)),
        mean=fit.mean,
        residual=math.sqrt(max(fit.total, 0.0) / (0.5 * n)),
        resolved=(nearest > 4 * math.pi / n) & np.broadcast_to(explained, omega.shape)[order],
        decay=decay / step,
        start=start,
    )
