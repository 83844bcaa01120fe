"""Prony series fitted to measurements: non-negative weights on a grid of times."""

import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from viscovib._native import FloatArray
from viscovib.common.parameters import Number, Whole
from viscovib.errors import ConvergenceWarning, InputError, caller
from viscovib.kernels.relaxation import Kernel, PronyKernel
from viscovib.kernels.time_temperature import ShiftLaw
from viscovib.rubber.data import CreepData, ModulusData, RelaxationData
from viscovib.rubber.fit import _COUNT, _SEED, KernelFit, Optimum, Sample
from viscovib.rubber.measured import Measured
from viscovib.rubber.prony_spectrum import (
    dynamic_design,
    grid_of_times,
    nonnegative,
    relaxing_design,
    rms,
)

_TERMS, _SMOOTH = Whole("terms", 1, 2000), Number("smooth", lowest=0)
#: Terms per decade for "auto", weights of an L-curve, passes of weights by the model.
_DENSITIES = (0.5, 1.0, 2.0, 4.0)
_L_CURVE = np.geomspace(1e-4, 1e2, 25)
_PASSES, _NOISE = 4, 0.15
#: Smallest relaxed modulus relative to the smallest modulus, so that the integral is < 1.
_LEAST = 1e-6
#: Weight of a given modulus; number of samples for intervals.
_GIVEN, _SAMPLES = 1e4, 200

#: Number of fits to resampled data for the band of a picture.
_REFITS_OF_BAND = 40


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PronyFit(KernelFit):
    """A Prony series; see `KernelFit`.

    Its uncertainty comes from fits to data that are resampled with the scatter of the residuals
    (parametric bootstrap), because weights at 0 have no normal distribution. The uncertainty of the
    scatter itself follows from the number of data beyond the non-zero terms (Student's t). If there
    are none, intervals are 0 to infinity, and there are no samples.

    Attributes
    ----------
    times, moduli : ndarray, shape (n,)
        tau_j (s), descending, and M_j (Pa, N/m) of the non-zero terms.
    relaxed : float
        M_e, the relaxed modulus.

    Examples
    --------
    >>> nu = np.geomspace(1e-2, 1e4, 40)
    >>> noise = 1 + 0.01 * np.random.default_rng(1).standard_normal((2, 40))
    >>> stiff = 2e6 * (1 - vv.RabotnovKernel(amplitude=2, alpha=0.5, beta=3).transform(nu))
    >>> data = vv.ModulusData(
    ...     frequencies=nu, storage=stiff.real * noise[0], loss=stiff.imag * noise[1]
    ... )
    >>> fit = vv.fit_kernel(data, kind="prony", terms=10)
    >>> bool(abs(fit.modulus - fit.relaxed - fit.moduli.sum()) < 1), bool((fit.moduli > 0).all())
    (True, True)
    """

    measured: Measured
    grid: FloatArray
    found: FloatArray
    weights: str
    smooth: float
    given: float | None
    shift: ShiftLaw | None
    kind: str = "prony"  # type: ignore[misc]
    optima: tuple[Optimum, ...] = ()

    @property
    def modulus(self) -> float:
        """Instantaneous modulus."""
        return float(self.found.sum())

    @property
    def relaxed(self) -> float:
        """Relaxed modulus."""
        return float(self.found[0])

    @property
    def times(self) -> FloatArray:
        """Relaxation times of the terms (s)."""
        return np.asarray(self.grid[self.found[1:] > 0][::-1])

    @property
    def moduli(self) -> FloatArray:
        """Modulus of each term."""
        return np.asarray(self.found[1:][self.found[1:] > 0][::-1])

    @cached_property
    def bare_kernel(self) -> Kernel:
        """The kernel at the reference temperature, without a shift law."""
        return self._kernel(self.found)

    def _kernel(self, found: FloatArray) -> Kernel:
        on = found[1:] > 0
        if not on.any():
            return PronyKernel(weights=[0.0], rates=[1.0])
        rates = 1 / self.grid[on]
        return PronyKernel(weights=found[1:][on] * rates / found.sum(), rates=rates)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return ("modulus", "relaxed")

    @property
    def _free(self) -> int:
        """Number of data beyond the number of fitted terms."""
        known = self.measured.count + (self.given is not None)
        return known - int(np.count_nonzero(self.found))

    @cached_property
    def _spread(self) -> FloatArray:
        """Moduli and relaxed moduli of refits, shape (n, 2)."""
        refits = self._refits(_SAMPLES, 0)
        return np.array([(found.sum(), found[0]) for found in refits])

    @cached_property
    def interval(self) -> dict[str, tuple[float, float]]:
        """95 % interval of each parameter."""
        if self._free < 1:
            return dict.fromkeys(self.names, (0.0, math.inf))
        low, high = np.quantile(self._spread, [0.025, 0.975], axis=0)
        return {k: (float(low[i]), float(high[i])) for i, k in enumerate(self.names)}

    @cached_property
    def unconstrained(self) -> tuple[str, ...]:
        """Parameters that the data do not determine."""
        return tuple(k for k, (low, high) in self.interval.items() if not high < 5 * low)

    @property
    def parameters(self) -> dict[str, float]:
        """Parameters, NaN for undetermined ones."""
        values = {"modulus": self.modulus, "relaxed": self.relaxed}
        return {k: math.nan if k in self.unconstrained else v for k, v in values.items()}

    def _refits(self, n: int, seed: int) -> Iterator[FloatArray]:
        rng = np.random.default_rng(seed)
        said = self._predicted()
        size = said if self.weights == "model" else self.measured.target
        relative = (said - self.measured.target) / size
        m = self.measured.log_rates.size
        free, known = self._free, self.measured.count
        if free < 1:
            raise InputError(
                f"data: {known} numbers for {np.count_nonzero(self.found)} parts of the fit do "
                "not determine the scatter: must be more"
            )
        scatter = np.repeat([rms(relative[:m]), rms(relative[m:])], [m, relative.size - m])
        scatter *= math.sqrt(known / free)
        for _ in range(n):
            unsure = math.sqrt(free / rng.chisquare(free))
            drawn = said + size * scatter * unsure * rng.standard_normal(said.size)
            yield _solve(self.measured, self.grid, size, drawn, self.smooth, self.given)

    def samples(self, n: int, *, seed: int = 0) -> Iterator[Sample]:
        """Return n kernels from fits to resampled data."""
        yield from self._sampled(_COUNT.check(n), _SEED.check(seed))[0]

    def _sampled(self, n: int, seed: int) -> tuple[Iterator[Sample], float]:
        return (
            Sample(self._thermal(self._kernel(found)), float(found.sum()))
            for found in self._refits(n, seed)
        ), float(n)

    def _predicted(self) -> FloatArray:
        return _design(self.measured, self.grid) @ self.found

    def _predicted_error(self) -> FloatArray:
        refits = np.array(list(self._refits(_REFITS_OF_BAND, 0)))
        predicted = refits @ _design(self.measured, self.grid).T
        return np.asarray(1.96 * predicted.std(axis=0))

    def _saved(self) -> dict[str, Any]:
        return {
            "grid": self.grid.tolist(),
            "found": self.found.tolist(),
            "smooth": self.smooth,
            "given_modulus": self.given,
        }


def fit_prony(
    data: ModulusData | RelaxationData | CreepData,
    measured: Measured,
    given: float | None,
    terms: str | int,
    smooth: str | float,
    weights: str,
    law: ShiftLaw | None,
) -> PronyFit:
    """Fit a Prony series; see `fit_kernel`."""
    if isinstance(data, CreepData):
        raise InputError(
            "kind = 'prony': creep has no linear fit, must be rabotnov or another kind"
        )
    low, high = -measured.log_rates.max(), -measured.log_rates.min()
    if isinstance(terms, str) and terms == "auto":
        grids = [grid_of_times(math.exp(low), math.exp(high), density) for density in _DENSITIES]
    else:
        grids = [np.geomspace(math.exp(low), math.exp(high), _TERMS.check(terms))]
    chosen = _SMOOTH.check(0.0 if isinstance(smooth, str) and smooth == "L-curve" else smooth)
    # The criterion assumes that residuals are noise. If they are not, use the closest fit.
    densest = _weighed(measured, grids[-1], chosen, given, weights)
    if densest[1] == "data" and weights == "model":
        grids = grids[-1:]
    best: tuple[float, FloatArray, FloatArray, str] | None = None
    for grid in grids:
        found, used = _weighed(measured, grid, chosen, given, weights)
        score = _criterion(measured, grid, found)
        if best is None or score < best[0]:
            best = (score, grid, found, used)
    assert best is not None
    _, grid, found, used = best
    if smooth == "L-curve":
        chosen = _corner(measured, grid, given)
        found, used = _weighed(measured, grid, chosen, given, weights)
    fit = PronyFit(
        measured=measured,
        grid=grid,
        found=found,
        weights=used,
        smooth=chosen,
        given=given,
        shift=law,
    )
    if isinstance(data, ModulusData) and not (measured.shares[: measured.log_rates.size] > 0).any():
        warnings.warn(
            "storage_weight = 0: the loss alone determines neither the relaxed nor the "
            "instantaneous modulus",
            ConvergenceWarning,
            stacklevel=caller(),
        )
    if fit._free < 1:
        warnings.warn(
            f"data: {measured.count} numbers for {np.count_nonzero(found)} parts of the fit do "
            "not determine its uncertainty: no parameter has an interval",
            ConvergenceWarning,
            stacklevel=caller(),
        )
    return fit


def _design(measured: Measured, grid: FloatArray) -> FloatArray:
    data = measured.data
    if isinstance(data, ModulusData):
        return np.vstack(dynamic_design(np.exp(measured.log_rates), grid))
    assert isinstance(data, RelaxationData)
    return relaxing_design(np.asarray(data.times), grid, data.ramp)


def _solve(
    measured: Measured,
    grid: FloatArray,
    size: FloatArray,
    target: FloatArray,
    smooth: float,
    given: float | None,
) -> FloatArray:
    """M_e > 0 and M_j >= 0 by least squares."""
    factor = np.where(measured.shares > 0, measured.shares / size, 0.0)
    counted = factor > 0
    rows = (_design(measured, grid) * factor[:, np.newaxis])[counted]
    least = _LEAST * float(measured.target[: measured.log_rates.size].min())
    right = (target * factor)[counted] - least * rows[:, 0]
    if given is not None:
        rows = np.vstack([rows, np.full(rows.shape[1], _GIVEN / given)])
        right = np.append(right, _GIVEN * (1 - least / given))
    typical = float(np.median(measured.target[: measured.log_rates.size]))
    found = nonnegative(rows, right, smooth, np.full(grid.size, typical))
    found[0] += least
    return found


def _weighed(
    measured: Measured, grid: FloatArray, smooth: float, given: float | None, weights: str
) -> tuple[FloatArray, str]:
    """Fit with weights by the data, then by the model if the residuals are noise."""
    found = _solve(measured, grid, measured.target, measured.target, smooth, given)
    said = _design(measured, grid) @ found
    relative = (said / measured.target - 1) * (measured.shares > 0)
    if weights != "model" or rms(relative) > _NOISE or (said <= 0).any():
        return found, "data"
    for _ in range(_PASSES):
        found = _solve(measured, grid, said, measured.target, smooth, given)
        before, said = said, np.maximum(_design(measured, grid) @ found, 1e-300)
        if np.abs(said / before - 1).max() < 1e-6:
            break
    return found, "model"


def _criterion(measured: Measured, grid: FloatArray, found: FloatArray) -> float:
    """Schwarz criterion n ln(sum r^2/n) + k ln n."""
    relative = (_design(measured, grid) @ found / measured.target - 1) * measured.shares
    n = max(measured.count, 1)
    total = max(float(relative @ relative), 1e-28 * n)
    return n * math.log(total / n) + np.count_nonzero(found) * math.log(n)


def _corner(measured: Measured, grid: FloatArray, given: float | None) -> float:
    """Weight at the corner of the L-curve (log bends over log residuals): largest curvature."""
    points = []
    typical = float(np.median(measured.target[: measured.log_rates.size]))
    for weight in _L_CURVE:
        found = _solve(measured, grid, measured.target, measured.target, float(weight), given)
        relative = (_design(measured, grid) @ found / measured.target - 1) * measured.shares
        bends = np.diff(found[1:], 2) / typical
        points.append((math.log(rms(relative) + 1e-15), math.log(rms(bends) + 1e-15)))
    x, y = np.array(points).T
    dx, dy = np.gradient(x), np.gradient(y)
    bend = dx * np.gradient(dy) - dy * np.gradient(dx)
    curvature = bend / np.maximum((dx**2 + dy**2) ** 1.5, 1e-12)
    return float(_L_CURVE[int(np.argmax(curvature[1:-1])) + 1])
