"""Piecewise polynomials in time: coefficients (n, n_powers, m), the highest power first.

Piece i is sum_p pieces[:, p, i] (t - breaks[i])^(n_powers - 1 - p). `scipy.interpolate.PPoly` does
the same, but its import takes longer than a motion.
"""

import numpy as np

from viscovib._native import FloatArray


def derivative(pieces: FloatArray) -> FloatArray:
    """Return the coefficients of the derivatives, of the same shape."""
    found = np.zeros_like(pieces)
    powers = np.arange(pieces.shape[1] - 1, 0, -1.0)
    found[:, 1:] = powers[:, np.newaxis] * pieces[:, :-1]
    return found


def values_at(
    breaks: FloatArray, pieces: FloatArray, t: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return values, first and second derivatives, shape (n_times, n).

    The last piece has no end, and before the first break the value is that at this break. At a
    break the values are those after it.
    """
    i = np.clip(np.searchsorted(breaks, t, side="right") - 1, 0, None)
    x = np.maximum(t - breaks[i], 0.0)
    value = rate = half = np.zeros((pieces.shape[0], t.size))
    for p in range(pieces.shape[1]):
        half = half * x + rate
        rate = rate * x + value
        value = value * x + pieces[:, p, i]
    inside = t >= breaks[0]
    return value.T, np.where(inside, rate, 0.0).T, np.where(inside, 2 * half, 0.0).T
