"""Uncertainty of a result from the uncertainty of a fit."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.parameters import Number, Whole
from viscovib.common.results import Axes
from viscovib.common.values import Value
from viscovib.errors import ConvergenceWarning, InputError, caller
from viscovib.rubber.fit import KernelFit, Sample

_SAMPLES, _SEED, _LEVEL = (
    Whole("samples", 2, 10**6),
    Whole("seed", 0, 2**31),
    Number("level", 0.01, 0.9999),
)

#: Fraction of effective samples below which a warning is issued.
_FEW = 0.15


@dataclass(frozen=True, kw_only=True, eq=False)
class Band(Value):
    """Results for kernels from the likelihood of the data: uncertainty of the parameters only.

    The band contains neither the scatter of single measurements nor the misfit of the kernel. So
    fewer measurements than ``level`` lie within it.

    Attributes
    ----------
    nominal : ndarray, shape (...)
        The result for the fit itself.
    low, median, high : ndarray, shape (...)
        Quantiles of the results at each entry, without NaN.
    answers : ndarray, shape (n, ...)
        The result for each sample.
    missing : ndarray of int, shape (...)
        Number of samples without a result.
    level : float
    effective : float
        Number of independent samples.

    Examples
    --------
    >>> nu = np.geomspace(1e-2, 1e4, 40)
    >>> noise = 1 + 0.01 * np.random.default_rng(1).standard_normal((2, 40))
    >>> stiff = 2e6 * (1 - vv.RabotnovKernel(amplitude=2, alpha=0.5, beta=3).transform(nu))
    >>> data = vv.ModulusData(
    ...     frequencies=nu, storage=stiff.real * noise[0], loss=stiff.imag * noise[1]
    ... )
    >>> band = vv.propagate(vv.fit_kernel(data), lambda s: abs(s.kernel.transform(nu)), samples=50)
    >>> band.nominal.shape, band.answers.shape, bool((band.low < band.high).all())
    ((40,), (50, 40), True)
    """

    nominal: FloatArray
    low: FloatArray
    median: FloatArray
    high: FloatArray
    answers: FloatArray
    missing: npt.NDArray[np.intp]
    level: float
    effective: float

    def __repr__(self) -> str:
        with np.errstate(all="ignore"):
            widths = (self.high - self.low) / np.abs(self.median)
        width = float(np.fmax.reduce(widths, axis=None, initial=np.nan))
        return (
            f"Band({self.answers.shape[0]} answers of shape {self.nominal.shape}, "
            f"{100 * self.level:g} % of the parameters only, at most {100 * width:.2g} % wide, "
            f"{self.missing.sum()} missing)"
        )

    def plot(self, x: npt.ArrayLike, ax: "Axes | None" = None, *, label: str = "") -> Axes:
        """Draw the band and the nominal result over x, shape (n,)."""
        # Import by name: the modules depend on each other.
        return import_module("viscovib.plots.rubber").plot_band(self, x, ax, label=label)  # type: ignore[no-any-return]


def propagate(
    fit: KernelFit,
    function: Callable[[Sample], Any],
    *,
    samples: int = 1000,
    seed: int = 0,
    level: float = 0.95,
) -> Band:
    """Propagate the uncertainty of the parameters of a fit through a function.

    Kernels are drawn from the likelihood of the data (`KernelFit.samples`).

    Parameters
    ----------
    fit : KernelFit
    function : callable
        Accepts a `Sample` with ``kernel`` and ``modulus`` and returns a number or an array, of one
        shape for all samples; NaN without a result.
    samples : int
        Number of kernels.
    seed : int
        Seed of the random numbers: the same seed gives the same band.
    level : float
        Fraction of the results within the band.

    Returns
    -------
    Band

    Warns
    -----
    ConvergenceWarning
        If the data do not determine a parameter, or if few of the samples are independent.

    Examples
    --------
    >>> nu = np.geomspace(1e-2, 1e4, 40)
    >>> noise = 1 + 0.02 * np.random.default_rng(1).standard_normal((2, 40))
    >>> stiff = 2e6 * (1 - vv.RabotnovKernel(amplitude=2, alpha=0.5, beta=3).transform(nu))
    >>> data = vv.ModulusData(
    ...     frequencies=nu, storage=stiff.real * noise[0], loss=stiff.imag * noise[1]
    ... )
    >>> fit = vv.fit_kernel(data)
    >>> relaxed = vv.propagate(fit, lambda s: s.modulus * s.kernel.relaxation(10.0), samples=200)
    >>> bool(relaxed.low < relaxed.nominal < relaxed.high)
    True
    """
    _native.check_instance("fit", fit, KernelFit)
    if not callable(function):
        raise InputError(f"function = {_native.shown(function)}: must be callable")
    count, start, part = _SAMPLES.check(samples), _SEED.check(seed), _LEVEL.check(level)
    nominal = _answer(function, Sample(fit.kernel, fit.modulus), None)
    found = np.empty((count, *nominal.shape))
    drawn, effective = fit._sampled(count, start)
    for i, sample in enumerate(drawn):
        found[i] = _answer(function, sample, nominal.shape)
    _warn(fit, count, effective)
    known = np.isfinite(found)
    ends = [0.5 - part / 2, 0.5, 0.5 + part / 2]
    if known.all():
        low, median, high = np.quantile(found, ends, axis=0)
    else:
        flat = np.where(known, found, np.nan).reshape(count, -1)
        quantiles = [
            np.quantile(column[~np.isnan(column)], ends)
            if np.isfinite(column).any()
            else [np.nan] * 3
            for column in flat.T
        ]
        low, median, high = np.array(quantiles).T.reshape(3, *nominal.shape)
    return Band(
        nominal=nominal,
        low=np.asarray(low),
        median=np.asarray(median),
        high=np.asarray(high),
        answers=found,
        missing=np.asarray((~known).sum(axis=0)),
        level=part,
        effective=effective,
    )


def _warn(fit: KernelFit, count: int, effective: float) -> None:
    doubts = []
    if fit.unconstrained:
        doubts.append(f"the data do not constrain {', '.join(fit.unconstrained)}")
    if effective < _FEW * count:
        doubts.append(f"{effective:.0f} of {count} samples are independent: use more samples")
    if doubts:
        warnings.warn(
            f"the ends of the band are uncertain: {'; '.join(doubts)}",
            ConvergenceWarning,
            stacklevel=caller(),
        )


def _answer(
    function: Callable[[Sample], Any], sample: Sample, shape: tuple[int, ...] | None
) -> FloatArray:
    try:
        given = function(sample)
    except TypeError as error:
        # Errors inside a function of Python are those of its author.
        if error.__traceback__ is not None and error.__traceback__.tb_next is not None:
            raise
        raise InputError(f"function = {_native.shown(function)}: {error}") from None
    try:
        answer = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        answer = None
    # None would become NaN, which means that there is no result.
    if answer is None or given is None:
        raise InputError(
            f"function: returned {_native.shown(given)}, must return real numbers of one shape"
        )
    if shape is not None and answer.shape != shape:
        raise InputError(
            f"function: returned shape {answer.shape}, before {shape}: must be one shape"
        )
    return answer
