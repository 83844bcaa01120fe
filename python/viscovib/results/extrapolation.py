"""Motions extrapolated to infinitely many harmonics."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from viscovib._native import ComplexArray
from viscovib.errors import InputError

#: Harmonic orders, X_k of shape (n_dof, m), and the highest harmonic kept.
Motion: TypeAlias = tuple[npt.NDArray[Any], ComplexArray, int]

#: Valid powers (1 for a jump; from 2 on neglected harmonics dominate the error), largest change of
#: a motion in units of its error estimate, and safety factor of the estimate.
_POWERS, _MOST_MOVED, _SAFETY = (0.4, 2.0), 2.0, 3.0
#: Smallest number of harmonics of the coarsest motion.
_FEWEST = 4


def check_orders(highest: list[int]) -> None:
    """Refuse numbers of harmonics (coarsest first) that give no limit."""
    if not _FEWEST <= highest[0] < highest[1] < highest[2]:
        raise InputError(
            f"highest harmonics {highest[2]}, {highest[1]} and {highest[0]}: must decrease "
            f"from each response to the next, to at least {_FEWEST}"
        )


def extrapolated(
    three: list[Motion], truncation: float
) -> tuple[ComplexArray, float, float] | None:
    """Return X_k for all harmonics, the estimated error and p; None if there is no improvement.

    ``three``: three responses, the coarsest first; ``truncation``: the estimate of the finest.
    """
    found = _row(three)
    if found is None:
        return None
    row, moved, error, p = found
    believed = moved <= _MOST_MOVED * truncation and error < truncation
    return (row, error, p) if believed else None


def _row(three: list[Motion]) -> tuple[ComplexArray, float, float, float] | None:
    """X_k, change of the kept harmonics, estimated error and p; None: no power fits."""
    orders, finest, _ = three[-1]
    kept = [int((one[0] <= one[2]).sum()) for one in three]
    if not all(np.array_equal(one[0][:k], orders[:k]) for one, k in zip(three, kept, strict=True)):
        return None
    if not kept[0] < kept[1] < kept[2]:
        return None
    # The middle between the last harmonic kept and the first neglected one.
    ends = [orders[k - 1] + 0.5 * (orders[k - 1] - orders[k - 2]) for k in kept]
    weights = np.where(orders == 0, 1.0, 0.5)

    def size(x: ComplexArray) -> float:
        return float(np.sqrt((weights[: x.shape[-1]] * np.abs(x) ** 2).sum()))

    n = kept[0]
    first = size(three[1][1][:, :n] - three[0][1][:, :n])
    second = size(finest[:, :n] - three[1][1][:, :n])
    p = _power(ends, first, second)
    if p is None:
        return None

    def beyond(j: int, q: float) -> ComplexArray:
        """Extrapolation from the responses j - 1 and j with the power q."""
        k = kept[j - 1]
        x = np.array(three[j][1])
        share = (ends[j] / ends[j - 1]) ** -q
        x[:, :k] += (x[:, :k] - three[j - 1][1][:, :k]) * share / (1 - share)
        return x

    best = beyond(2, p)
    spread = size(best[:, :n] - beyond(1, p)[:, :n]) + size(best - beyond(2, round(2 * p) / 2))
    norm = size(finest)
    error = _SAFETY * (spread + _left_out(finest[:, : kept[2]])) / norm
    return best, size(best - finest) / norm, error, p


def _power(ends: list[float], first: float, second: float) -> float | None:
    """Power p of X(K) = X + C K^-p from two differences of three responses."""
    if not 0 < second < first:
        return None

    def lacks(p: float) -> float:
        powers = [end**-p for end in ends]
        share: float = (powers[1] - powers[2]) / (powers[0] - powers[1])
        return share - second / first

    if lacks(_POWERS[0]) * lacks(_POWERS[1]) > 0:
        return None
    from scipy.optimize import brentq

    return float(brentq(lacks, *_POWERS))


def _left_out(x: ComplexArray) -> float:
    """Size of all neglected harmonics, if octaves continue to decrease like the last two."""
    m = x.shape[1]
    high, low = (float(np.sqrt(0.5 * (np.abs(part) ** 2).sum()))
                 for part in (x[:, m // 2 :], x[:, m // 4 : m // 2]))  # fmt: skip
    ratio = min(high / low, 0.9) if low > 0 else 0.9
    return high * ratio / float(np.sqrt(1 - ratio**2))
