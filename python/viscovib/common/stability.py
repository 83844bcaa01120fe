"""Stability of driven motions: common code of arguments and messages."""

import warnings
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib._native import FloatArray
from viscovib.common.counts import things
from viscovib.common.motion_stability import three_valued
from viscovib.errors import StabilityWarning, caller

#: Growth rates closer to 0 than this count as 0.
STILL = 1e-7


def warn_of_unknown(unknown: npt.NDArray[np.bool_]) -> None:
    """Warn of motions with unknown stability."""
    if unknown.any():
        warnings.warn(
            f"stability of {things(unknown.sum(), 'motion')} is unknown: the problem is too "
            "stiff for the Floquet solver",
            StabilityWarning,
            stacklevel=caller(),
        )


def stability_by_rates(
    growth: FloatArray, off: FloatArray, found: npt.NDArray[np.bool_]
) -> npt.NDArray[Any]:
    """Stability of motions from growth rates and their errors, shape (n, 6); may warn.

    Stable: all rates are below 0 by more than their errors; unstable: one is above; else unknown.
    """
    stable = np.all(growth + off < -STILL, axis=1)
    unknown = ~stable & ~np.any(growth - off >= -STILL, axis=1)
    blurred = unknown & np.isfinite(growth).all(axis=1)
    if blurred.any():
        warnings.warn(
            f"stability of {things(blurred.sum(), 'motion')} is unknown: the largest rate of "
            "growth is smaller than its error, take a longer duration",
            StabilityWarning,
            stacklevel=caller(),
        )
    warn_of_unknown(unknown & ~blurred & found)
    return three_valued(stable, unknown)
