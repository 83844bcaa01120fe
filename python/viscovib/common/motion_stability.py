"""Stability of periodic motions from codes of the core."""

import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from viscovib._native import ComplexArray
from viscovib.common.counts import things
from viscovib.errors import StabilityWarning, caller


def codes_of(stable: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
    """1: stable, 0: unstable, -1: unknown."""
    return np.array([-1 if s is None else int(s) for s in stable])


def whole_or_codes(stable: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Stability for tables: booleans, or codes if some values are unknown."""
    return stable if stable.dtype == bool else codes_of(stable)


def three_valued(stable: npt.NDArray[np.bool_], unknown: npt.NDArray[np.bool_]) -> npt.NDArray[Any]:
    """Stability as booleans; if some values are unknown, as objects True, False and None."""
    if not unknown.any():
        return stable
    verdicts = stable.astype(object)
    verdicts[unknown] = None
    return verdicts


def stability_columns(
    growing: npt.NDArray[np.int32], multipliers: ComplexArray | None
) -> dict[str, Any]:
    """Columns of a table: stable, growing and the size of the largest multiplier."""
    columns: dict[str, Any] = {
        "stable": np.where(growing < 0, -1, growing == 0),
        "growing": growing,
    }
    largest = np.full(growing.size, np.nan + 0j)
    if multipliers is not None and multipliers.size:
        largest = multipliers[:, 0]
    # abs would differ from the core in the last bit.
    columns["multiplier"] = np.hypot(largest.real, largest.imag)
    return columns


def hanging(
    stable: npt.NDArray[Any] | None,
    few: npt.NDArray[np.bool_],
    cause: str = "neglected harmonics decide",
) -> str:
    """Text on the motions with too ``few`` harmonics and unknown stability; empty if none."""
    n = 0 if stable is None else sum(s is None for s in stable[few])
    if not n:
        return ""
    return f"; stability of {n} of these is unknown, for {cause} it"


def truncated_crossings(before: Sequence[int], few: npt.NDArray[np.bool_]) -> str:
    """Text on the crossings near motions with too ``few`` harmonics; empty if none.

    They are located on the motions with the harmonics kept. The error of their locations for the
    converged motion is the truncation.
    """
    n = sum(bool(few[i : i + 2].any()) for i in before)
    if not n:
        return ""
    return f"; {n} of {len(before)} crossings next to these are those of the truncated motion"


class Stability(NamedTuple):
    """Stability of n motions, with multipliers and exponents; see `Branch`."""

    stable: npt.NDArray[Any]
    multipliers: ComplexArray
    exponents: ComplexArray
    slowest: npt.NDArray[np.bool_]

    @classmethod
    def of(
        cls,
        codes: npt.NDArray[np.int32],
        multipliers: ComplexArray,
        exponents: ComplexArray,
        solved: npt.NDArray[np.bool_] | None = None,
    ) -> "Stability":
        """Create it from arrays of the core; codes: 1 stable, 0 unstable, -1 unknown.

        2: stable, but a slower exponent than the first one may exist. -2: unknown because of
        neglected harmonics; the caller warns of these.
        Warn of all other motions, among the ``solved`` ones, with unknown stability.
        """
        unknown = codes < 0
        stable = three_valued(codes > 0, unknown)
        undecided = codes == -1 if solved is None else (codes == -1) & solved
        if undecided.any():
            warnings.warn(
                f"stability of {undecided.sum()} of {things(undecided.size, 'motion')} is unknown: "
                "an exponent lies on the imaginary axis within rounding errors, the problem is too "
                "stiff for the Floquet solver, or a force law jumps and the motion sticks at the "
                "jump, grazes it or has memory",
                StabilityWarning,
                stacklevel=caller(),
            )
        finite = ~np.isnan(multipliers)
        columns = int(finite.sum(axis=0).max(initial=0))
        return cls(
            stable,
            np.ascontiguousarray(multipliers[:columns].T),
            np.ascontiguousarray(exponents[:columns].T),
            # Growing exponents were counted, but may not have been found.
            ((codes == 0) & finite.any(axis=0)) | (codes == 1),
        )
