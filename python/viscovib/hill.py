"""Stability of periodic motions with memory: growing exponents, counted from Hill's determinant."""

import warnings
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray, core
from viscovib.errors import StabilityWarning

#: Exponents kept beyond two a coordinate: memory has slow ones of its own.
_MORE = 4


def stability_with_memory(
    system: tuple[Any, ...],
    nu: FloatArray,
    coefficients: ComplexArray,
    orders: npt.NDArray[np.int32],
    half_wave: bool,
) -> tuple[npt.NDArray[Any], ComplexArray, npt.NDArray[np.int32]]:
    """Whether each motion is stable, exponents, and how many of them grow (-1: unknown).

    ``system``: as the core takes it; ``coefficients``: of the core, shape (m, n_dof, n). Stable:
    bool, or with None where that is unknown; exponents: see `Branch`.
    """
    cancel = np.zeros(1, dtype=np.intc)
    n_growing, found, _ = _native.call_interruptibly(
        core.oscillator_hill, cancel, *system, nu, coefficients, int(orders[-1]), int(half_wave),
        2 * coefficients.shape[1] + _MORE, cancel,
    )  # fmt: skip
    exponents = np.ascontiguousarray(found.T)
    growing = (exponents.real > 0).sum(axis=1)
    # More found than counted: one of the two is wrong.
    n_growing = np.where(growing > n_growing, -1, n_growing)
    exponents[growing != n_growing] = np.nan
    exponents = exponents[:, : int((~np.isnan(exponents)).sum(axis=1).max(initial=0))]
    stable: npt.NDArray[Any] = n_growing == 0
    unknown = n_growing < 0
    if unknown.any():
        stable = stable.astype(object)
        stable[unknown] = None
        warnings.warn(
            f"stability of {unknown.sum()} of {unknown.size} motions is unknown: an exponent lies "
            "on the imaginary axis to rounding, or time scales are too far apart",
            StabilityWarning,
            stacklevel=3,
        )
    return stable, exponents, n_growing
