"""Stability of driven motions: what arguments and messages share."""

import warnings

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib.errors import InputError, StabilityWarning

#: Rates of growth closer to 0 than this count as 0.
STILL = 1e-7


def check_duration(duration: object) -> float:
    """Check the time over which rates of growth are averaged."""
    span = _native.number("duration", duration)
    if not 1 <= span <= 1e6:
        raise InputError(f"duration = {span:g}: must be in [1, 1e6]")
    return span


def warn_of_unknown(unknown: npt.NDArray[np.bool_], stacklevel: int = 4) -> None:
    """Say of how many motions stability is unknown, if of any."""
    if unknown.any():
        warnings.warn(
            f"stability of {unknown.sum()} motions is unknown: time scales are too far apart",
            StabilityWarning,
            stacklevel=stacklevel,
        )
