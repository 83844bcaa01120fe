"""Moduli as sums of relaxing parts: linear least squares with non-negative weights.

M*(w) = M_e + sum_j M_j i w tau_j/(1 + i w tau_j), M_e >= 0, M_j >= 0, on a grid of times tau_j.
Every modulus of a passive relaxing material is a limit of such sums (Bernstein's theorem). So data
that no sum approximates do not belong to such a material.
"""

import math

import numpy as np

from viscovib._native import FloatArray

#: Largest number of terms.
MOST_TERMS = 2000


def grid_of_times(low: float, high: float, per_decade: float, beyond: float = 0.0) -> FloatArray:
    """Times from ``low`` to ``high`` (s) and ``beyond`` decades further, equal log steps."""
    decades = math.log10(high / low) + 2 * beyond
    # Rounding errors of the times must not add a term.
    n = min(max(math.ceil(decades * per_decade - 1e-9) + 1, 2), MOST_TERMS)
    return np.asarray(np.geomspace(low / 10**beyond, high * 10**beyond, n))


def dynamic_design(nu: FloatArray, tau: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Columns of storage and of loss, the first for M_e, shape (n, 1 + terms)."""
    x = nu[:, np.newaxis] * tau
    below = 1 / (1 + x * x)
    storage, loss = np.empty((2, nu.size, tau.size + 1))
    storage[:, 0], loss[:, 0] = 1.0, 0.0
    loss[:, 1:] = x * below
    storage[:, 1:] = x * loss[:, 1:]
    return storage, loss


def relaxing_design(t: FloatArray, tau: FloatArray, ramp: float) -> FloatArray:
    """Columns of the modulus over time after a ramp of the duration ``ramp`` (s)."""
    x = t[:, np.newaxis] / tau
    design = np.ones((t.size, tau.size + 1))
    design[:, 1:] = np.exp(-x)
    if ramp > 0:
        y = np.minimum(ramp / tau, 700.0)
        # Mean of exp(-(t - s)/tau) over the ramp, s from 0 to its end.
        design[:, 1:] = np.exp(-np.maximum(x - y, 0)) * -np.expm1(-y) / np.maximum(y, 1e-300)
    return design


def nonnegative(
    rows: FloatArray, target: FloatArray, smooth: float = 0.0, damped: FloatArray | None = None
) -> FloatArray:
    """Solve rows x = target in the least-squares sense with x >= 0.

    ``smooth`` weighs the second differences of x[1:], in units of ``damped`` (the size of each),
    relative to the residuals.
    """
    from scipy.optimize import nnls

    if smooth > 0 and rows.shape[1] > 4:
        n = rows.shape[1] - 1
        bend = np.diff(np.eye(n), 2, axis=0)
        extra = np.zeros((n - 2, n + 1))
        extra[:, 1:] = smooth * bend / (1.0 if damped is None else damped)
        rows = np.vstack([rows, extra])
        target = np.concatenate([target, np.zeros(n - 2)])
    # Normalize the columns; replace many rows by a triangular matrix.
    length = np.sqrt((rows * rows).sum(axis=0))
    length[length == 0] = 1.0
    scaled = np.column_stack([rows / length, target])
    if scaled.shape[0] > 2 * scaled.shape[1]:
        scaled = np.asarray(np.linalg.qr(scaled, mode="r"))
    found, _ = nnls(scaled[:, :-1], scaled[:, -1], maxiter=100 * rows.shape[1])
    return np.asarray(found / length)


def rms(residual: FloatArray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(residual * residual))) if residual.size else 0.0
