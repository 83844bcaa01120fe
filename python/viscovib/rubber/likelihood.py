"""Samples of the unknowns of a fit from their likelihood exp(-rise/2).

The rise of the sum of squares is in variances of a residual. Priors are flat in the logarithms of
modulus and times. Alphas and parts of the integral x have the prior 1/sqrt(x (1 - x)) (Jeffreys),
which is integrable at the bounds. All unknowns are within `REACH` of the fit.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from viscovib._native import FloatArray

#: Largest distance of samples from the fit, in units of the unknowns.
REACH = 12.0
#: Fraction of effective samples below which the normal distribution with weights is not used.
_NEARLY_NORMAL = 0.5
#: Walkers of the ensemble for each unknown, steps before the first sample and between two samples.
_WALKERS, _BURN_IN, _THIN = 10, 300, 30
#: Largest stretch of a move (Goodman and Weare, Comm. App. Math. Comp. Sci. 5, 2010, 65).
_STRETCH = 2.0


def likely(fit: Any, count: int, rng: np.random.Generator) -> tuple[FloatArray, float]:
    """Return samples of unknowns (count, k) of a `ParametricFit`, and their effective number.

    Samples of the normal distribution of ``covariance`` are resampled with the weights
    exp(-(rise - its parabola)/2). If few samples are effective, an ensemble of walkers is used.
    """
    best, slopes = fit.theta, fit._problem[2]
    rises = _rises_of(fit)
    values, vectors = np.linalg.eigh((fit.covariance + fit.covariance.T) / 2)
    away = rng.standard_normal((count, best.size)) @ (vectors * np.sqrt(np.maximum(values, 0))).T
    drawn = best + np.clip(away, -REACH, REACH)
    inside = np.abs(away).max(axis=1) <= REACH
    parabola = ((away @ slopes.T) ** 2).sum(axis=1) / fit._variance
    gain = (parabola - rises(drawn)) / 2
    weights = np.where(inside, np.exp(np.minimum(gain - gain.max(), 0.0)), 0.0)
    effective = float(weights.sum() ** 2 / max((weights**2).sum(), 1e-300))
    if effective >= _NEARLY_NORMAL * count and not fit.at_bound:
        return drawn[rng.choice(count, count, p=weights / weights.sum())], effective
    return _ensemble(fit, rises, drawn, count, rng)


def _rises_of(fit: Any) -> Callable[[FloatArray], FloatArray]:
    factor, residual, _ = fit._problem
    least, variance = float(residual @ residual), fit._variance

    def rises(thetas: FloatArray) -> FloatArray:
        with np.errstate(all="ignore"):
            said = fit.measured.predicted_of(fit.model, thetas)
            found = ((((said - fit.measured.target) * factor) ** 2).sum(axis=1) - least) / variance
        return np.where(np.isfinite(found), found, np.inf)

    return rises


def _ensemble(
    fit: Any,
    rises: Callable[[FloatArray], FloatArray],
    drawn: FloatArray,
    count: int,
    rng: np.random.Generator,
) -> tuple[FloatArray, float]:
    """Walkers by stretch moves; half of them move along lines through the other half."""
    # Start inside the admissible range: at its ends all priors are 0.
    middle = fit.model.join(*fit.model.split(fit.theta))
    k = middle.size
    n = 2 * max(_WALKERS * k // 2, k + 1)

    def log_densities(thetas: FloatArray) -> FloatArray:
        far = np.abs(thetas - middle).max(axis=1) > REACH
        return np.where(far, -np.inf, fit.model.log_priors(thetas) - rises(thetas) / 2)

    spread = np.clip(drawn - fit.theta, -1.0, 1.0)
    walkers = middle + 0.1 * spread[rng.integers(len(spread), size=n)]
    walkers += 1e-3 * rng.standard_normal((n, k))
    levels = log_densities(walkers)
    rounds = -(-count // n)
    kept = np.empty((rounds, n, k))
    halves = np.arange(n).reshape(2, n // 2)
    for step in range(_BURN_IN + rounds * _THIN):
        for own, other in (halves, halves[::-1]):
            stretch = (1 + (_STRETCH - 1) * rng.random(own.size)) ** 2 / _STRETCH
            partners = walkers[rng.choice(other, own.size)]
            moved = partners + stretch[:, np.newaxis] * (walkers[own] - partners)
            found = log_densities(moved)
            gain = (k - 1) * np.log(stretch) + found - levels[own]
            with np.errstate(invalid="ignore"):
                taken = np.log(rng.random(own.size)) < gain
            walkers[own[taken]], levels[own[taken]] = moved[taken], found[taken]
        if step >= _BURN_IN and (step - _BURN_IN + 1) % _THIN == 0:
            kept[(step - _BURN_IN) // _THIN] = walkers
    whole = kept.reshape(-1, k)
    chosen = whole[rng.permutation(len(whole))[:count]]
    return chosen, _effective(kept, count)


def _effective(kept: FloatArray, count: int) -> float:
    """Number of independent samples (rounds, walkers, k), for the slowest unknown.

    It follows from the autocorrelation of successive rounds, summed until it vanishes.
    """
    rounds = kept.shape[0]
    away = kept - kept.mean(axis=(0, 1))
    variance = np.maximum((away**2).mean(axis=(0, 1)), 1e-300)
    time = np.ones(kept.shape[2])
    open_ones = np.ones(kept.shape[2], dtype=bool)
    for lag in range(1, rounds // 2):
        own = (away[lag:] * away[:-lag]).mean(axis=(0, 1)) / variance
        open_ones &= own > 0.05
        time += 2 * np.where(open_ones, own, 0.0)
        if not open_ones.any():
            break
    return float(min(count, count / time.max()))
