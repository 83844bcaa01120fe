"""Exponentials that replace the part of a kernel before the shortest time of a sum."""

from typing import Any

import numpy as np

from viscovib._native import FloatArray

#: The sum of the core starts at this part of the shortest time. Its transform equals that of the
#: kernel at these s, in units of the inverse of the shortest time.
EARLIER, _AGREED = 1e-6, np.array([0.5, 2.0])
#: Number of exponentials that replace all fast ones, exp(-rate first) < tolerance exp(-_DECAYED).
_FAST, _DECAYED = 5, 6.0


def with_early_part(
    kernel: Any, weights: FloatArray, rates: FloatArray, tolerance: float, first: float
) -> tuple[FloatArray, FloatArray]:
    """Complete a sum that is valid from ``EARLIER * first`` on, and shorten it.

    One exponential represents the integral and the first moment of R before the start of the sum.
    All terms that have decayed at ``first`` are then a discrete measure of the relaxation times
    y = 1/rate with masses weight/rate. Their transform is the integral of 1/(1 + s y). A Gauss rule
    with a few nodes approximates it for s up to a few 1/first.
    """
    s = _AGREED / first
    unfitted: FloatArray = kernel.laplace(s.astype(complex)).real - (
        weights / (s[:, None] + rates)
    ).sum(axis=1)
    rate = 1 / (EARLIER * first)
    if unfitted[0] - unfitted[1] > np.finfo(float).eps * abs(unfitted[0]):
        rate = max(rate, (unfitted[1] * s[1] - unfitted[0] * s[0]) / (unfitted[0] - unfitted[1]))
    if unfitted[0] > 0:
        weights, rates = np.append(weights, unfitted[0] * (s[0] + rate)), np.append(rates, rate)
    fast = (rates * first > _DECAYED - np.log(tolerance)) & (weights > 0)
    if fast.sum() <= _FAST:
        return weights, rates
    times, masses = _gauss_rule(1 / rates[fast], weights[fast] / rates[fast])
    return np.append(weights[~fast], masses / times), np.append(rates[~fast], 1 / times)


def _gauss_rule(places: FloatArray, masses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Nodes and weights of the Gauss rule of a discrete measure, by Lanczos and Golub-Welsch."""
    total = masses.sum()
    basis = [np.sqrt(masses / total)]
    diagonal, nearby = [], []
    for _ in range(_FAST):
        image = places * basis[-1]
        diagonal.append(basis[-1] @ image)
        for _ in range(2):
            image = image - np.array(basis).T @ (np.array(basis) @ image)
        size = np.linalg.norm(image)
        if size <= np.finfo(float).eps * diagonal[0]:
            break
        nearby.append(size)
        basis.append(image / size)
    n = len(diagonal)
    off = np.diag(nearby[: n - 1], 1)
    nodes, vectors = np.linalg.eigh(np.diag(diagonal) + off + off.T)
    return nodes, total * vectors[0] ** 2
