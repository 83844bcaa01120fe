"""Tolerances of motions in time."""

from dataclasses import dataclass

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.parameters import RTOL, TIME_TOLERANCE
from viscovib.errors import InputError

_EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class Accuracy:
    """Allowed errors: ``absolute``, and ``relative`` to the largest value of each column.

    ``by_size``: relative to the size of the motion instead, which for displacements is the largest
    displacement, for velocities the largest of all numbers.
    """

    absolute: float
    relative: float = 0.0
    by_size: bool = False

    @classmethod
    def checked(
        cls, tolerance: float | None, rtol: float | None, atol: float | None, default: float | None
    ) -> "Accuracy | None":
        """Check the arguments; ``default``: relative to the size of the motion, None: none."""
        if rtol is None and atol is None:
            if tolerance is not None:
                return cls(TIME_TOLERANCE.check(tolerance))
            return None if default is None else cls(0.0, default, by_size=True)
        if tolerance is not None:
            raise InputError(
                "tolerance, rtol and atol: tolerance is another name for atol, give only one "
                "of them"
            )
        relative = 0.0 if rtol is None else RTOL.check(rtol)
        absolute = 0.0 if atol is None else _native.number("atol", atol)
        if absolute < 0 or (rtol is None and absolute == 0):
            raise InputError(f"atol = {absolute:g}: must be greater than 0, or 0 with an rtol")
        return cls(absolute, relative)

    @property
    def solved(self) -> float:
        """Relative tolerance for approximations, such as kernels."""
        return 0.1 * min(filter(None, (self.absolute, self.relative)))

    @property
    def text(self) -> str:
        """The allowed error as a text."""
        if self.by_size:
            return f"{self.relative:g} of the size of the motion"
        if self.relative == 0:
            return f"{self.absolute:g}"
        absolute = f"{self.absolute:g} and " if self.absolute > 0 else ""
        return f"{absolute}{self.relative:g} of the largest"

    def __str__(self) -> str:
        """Return the tolerance as given by the user."""
        if self.by_size:
            return f"tolerance = {self.relative:g} of the size of the motion"
        if self.relative == 0:
            return f"tolerance = {self.absolute:g}"
        return f"rtol = {self.relative:g}, atol = {self.absolute:g}"


def rounding_of(states: FloatArray) -> float:
    """Rounding error of states; 0 only if all states are 0."""
    return 4 * _EPS * float(np.abs(states).max(initial=0.0))
