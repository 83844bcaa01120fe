"""Spectra of signals with windows, and names of their frequencies."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.analyses.signals import read_signal, windowed
from viscovib.common.counts import things
from viscovib.common.parameters import Names
from viscovib.common.plan import Plan, wanted_places
from viscovib.common.results import Dataset, Result, as_dataset, span
from viscovib.common.tables import Table
from viscovib.errors import InputError
from viscovib.results.trajectory import Trajectory

WINDOWS = ("rectangular", "hann", "blackman_harris", "flat_top")


@dataclass(frozen=True, eq=False, repr=False)
class Spectrum(Result):
    """One-sided amplitude spectrum.

    Attributes
    ----------
    omega : ndarray, shape (n_bins,)
        Circular frequencies (rad per unit of time), from 0 to half the sampling rate.
    coefficients : complex ndarray, shape (n_bins,) or (n_bins, m)
        X: a tone a cos(omega t + phase) at a bin gives a exp(i phase); X[0] is the mean.
    window : str
    noise_bandwidth : float
        Equivalent noise bandwidth of the window in bins. Divide abs(X)**2 / 2 by it and by the bin
        width for a power spectral density (at half the sampling rate, for an even number of
        samples, twice this; not at 0, which is the mean).
    dt : float
        Time between samples.
    names : tuple of str
        Names of the signals.
    plan : Plan
        What was computed, and what was skipped and why.
    aliased : tuple of str
        Coordinates of a `Trajectory` with frequencies that are too high for the states kept, which
        appear at wrong frequencies; ``complete`` is then False.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> t = 0.01 * np.arange(4096)
    >>> found = vv.spectrum(np.sin(12 * t), 0.01)
    >>> round(float(found.omega[found.amplitude.argmax()]), 1)
    12.0
    """

    omega: FloatArray
    coefficients: ComplexArray
    window: str
    noise_bandwidth: float
    dt: float
    names: tuple[str, ...]
    plan: Plan
    aliased: tuple[str, ...] = ()

    kind = "spectrum"

    @property
    def complete(self) -> bool:  # type: ignore[override]
        """True if no coordinate is known to be aliased."""
        return not self.aliased

    def _headline(self) -> str:
        return f"{things(self.omega.size, 'frequency', 'frequencies')} of {', '.join(self.names)}"

    def _scope(self) -> list[str]:
        width = self.omega[1] if self.omega.size > 1 else math.nan
        lines = [f"omega: {span(self.omega)}, {width:.6g} apart; window {self.window}"]
        if self.aliased:
            names = ", ".join(self.aliased)
            lines.append(f"states are too far apart for {names}: faster components are aliased")
        return lines

    @property
    def amplitude(self) -> FloatArray:
        """Absolute value of each coefficient."""
        return np.abs(self.coefficients)

    @property
    def phase(self) -> FloatArray:
        """Phase of each coefficient (rad), at the first sample."""
        return np.angle(self.coefficients)

    def to_dataset(self) -> Dataset:
        """Return amplitude and phase as an xarray Dataset over omega."""
        dimensions = ("omega", "signal")[: self.coefficients.ndim]
        return as_dataset(
            {"amplitude": (dimensions, self.amplitude), "phase": (dimensions, self.phase)},
            coords={"omega": self.omega},
            attrs={
                "window": self.window,
                "noise_bandwidth": self.noise_bandwidth,
                "dt": self.dt,
                "plan": str(self.plan),
            },
        )

    def _table(self, coordinates: Sequence[str] | None) -> Table:
        columns = self.coefficients.reshape(self.omega.size, -1)
        table = Table(
            [
                f"window {self.window}; omega in rad per unit of time, phases in rad at the first "
                "sample",
                *(
                    f"states are too far apart for {name}: faster components are aliased"
                    for name in self.aliased
                ),
            ],
            {"omega": self.omega},
        )
        for j in wanted_places(coordinates, self.names):
            name, own = self.names[j], columns[:, j]
            # abs and np.angle would differ from the core in the last bits.
            table.columns[f"{name}_amplitude"] = np.hypot(own.real, own.imag)
            table.columns[f"{name}_phase"] = np.array(
                list(map(math.atan2, own.imag.tolist(), own.real.tolist()))
            )
        return table


def spectrum(
    signal: npt.ArrayLike | Trajectory,
    dt: float | None = None,
    *,
    window: str = "hann",
    names: tuple[str, ...] | None = None,
    coordinates: str | tuple[str, ...] | None = None,
) -> Spectrum:
    """Return the amplitude spectrum of equidistant signals, by FFTW.

    Parameters
    ----------
    signal : array_like, shape (n,) or (n, m), or Trajectory
        One signal or several, one column each; n >= 1. For a `Trajectory` the coordinates with the
        spacing of the states kept (which is not its step size).
    dt : float
        Time between samples; only with an array.
    window : {"hann", "rectangular", "blackman_harris", "flat_top"}
        "rectangular" is exact for whole periods; "hann" for general use; "blackman_harris" for
        small lines near large ones; "flat_top" reads amplitudes between bins to 0.2 %.
    names : tuple of str
        Names of the signals; by default "signal", or "signal_1", "signal_2", ..., or the names of
        the coordinates.
    coordinates : str or tuple of str
        For a `Trajectory`: selected coordinates, such as "phi" or "phi_dot"; a single name gives
        coefficients of shape (n_bins,). By default all coordinates, without velocities.

    Warns
    -----
    ConvergenceWarning
        If the velocities of a `Trajectory` show oscillations that are too fast for the states kept.

    Notes
    -----
    The mean under the window is subtracted before the transform and returned as X[0], so it does
    not leak. Records of fewer than 10 samples have no window.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> t = 0.01 * np.arange(4096)
    >>> found = vv.spectrum(np.sin(12 * t), 0.01, window="hann")
    """
    source = read_signal(signal, dt, coordinates=coordinates, most=2)
    samples, step = source.samples, source.step
    kind = WINDOWS.index(_native.choice("window", window, WINDOWS)) + 1
    n = samples.shape[0]
    columns = samples.reshape(n, -1)
    m = columns.shape[1]
    if names is None:
        names = source.names
    if names is None:
        names = ("signal",) if samples.ndim == 1 else tuple(f"signal_{j + 1}" for j in range(m))
    names = Names("names", count=m).check(names)
    spectra, bandwidth = windowed(columns, kind)
    return Spectrum(
        omega=2 * math.pi / (n * step) * np.arange(n // 2 + 1),
        coefficients=np.ascontiguousarray(spectra).reshape(n // 2 + 1, *samples.shape[1:]),
        window=window,
        noise_bandwidth=float(bandwidth),
        dt=step,
        names=names,
        aliased=source.aliased,
        plan=Plan(
            f"computes: spectra of {', '.join(names)}, {things(n, 'sample')}, window {window}\n"
            "skips: negative frequencies (signals are real)"
            + ("\nskips: the window (fewer than 10 samples)" if n < 10 else "")
        ),
    )


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
        Largest sum of the absolute factors, 1 to 20.
    tolerance : float
        Largest distance.

    Returns
    -------
    A name for each frequency: of the lowest order within the tolerance, several of the same order
    joined by " or "; "mean" for 0; "" if none fits.

    Examples
    --------
    >>> import viscovib as vv
    >>> vv.name_frequencies([1.3, 0.93], {"p1": 0.93, "p2": 0.37})
    ['p1 + p2', 'p1']
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
    with np.errstate(over="ignore", invalid="ignore"):
        # Overflowing combinations match no frequency.
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
