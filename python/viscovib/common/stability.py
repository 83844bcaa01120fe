"""Stability of driven motions: what arguments and messages share."""

import warnings

import numpy as np
import numpy.typing as npt

from viscovib.common.counts import things
from viscovib.errors import StabilityWarning, caller

#: Rates of growth closer to 0 than this count as 0.
STILL = 1e-7


def warn_of_unknown(unknown: npt.NDArray[np.bool_]) -> None:
    """Say of how many motions stability is unknown, if of any."""
    if unknown.any():
        warnings.warn(
            f"stability of {things(unknown.sum(), 'motion')} is unknown: the problem is too "
            "stiff for the Floquet solver",
            StabilityWarning,
            stacklevel=caller(),
        )
