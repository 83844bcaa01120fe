"""Systems whose damping and stiffness depend on the speed of a rotor."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any, Self

from viscovib.errors import InputError
from viscovib.systems.system import SPEED_NEEDED, System

#: Matrices that depend on the speed.
OF_SPEED = ("gyroscopic", "circulatory", "centrifugal")
UNDAMPED = "gyroscopic: undamped modes omit it; use campbell or characteristic_roots"
NO_EFFECT = "speed: has no effect without gyroscopic, circulatory or centrifugal"
#: Largest relative symmetric part of a gyroscopic matrix.
_SKEW = 1e-12
#: Largest number of coordinates with such matrices, as in the core.
MOST_WITH_SPEED = 512


class WithSpeed(System):
    """C + Omega G and K + Omega K1 + Omega^2 K2 at the speed Omega, the frequency of the load."""

    speed: float | None

    @property
    def _depends_on_speed(self) -> bool:  # type: ignore[override]
        """True if the speed is the frequency of the load."""
        return self.speed is None and self._has_speed_matrices

    @cached_property
    def _has_speed_matrices(self) -> bool:
        given = (getattr(self, name) for name in OF_SPEED)
        return any(one is not None and (one != 0).sum() > 0 for one in given)

    @property
    def _given(self) -> dict[str, Any]:
        """Arguments that the constructor changes, as they were given."""
        return {}

    def at_speed(self, speed: float) -> Self:
        """Return the system with constant matrices: those at a speed (rad/s)."""
        if all(getattr(self, name) is None for name in OF_SPEED):
            raise InputError(NO_EFFECT)
        found: Self = replace(self, **self._given | {"speed": speed})  # type: ignore[type-var]
        return found

    def _turned(self, nu: float | None = None) -> Self:
        if not self._depends_on_speed:
            return self
        if nu is None:
            raise InputError(SPEED_NEEDED)
        return self.at_speed(nu)

    @property
    def _is_gyroscopic(self) -> bool:
        gyroscopic: Any = getattr(self, "gyroscopic", None)
        return gyroscopic is not None and bool((gyroscopic != 0).sum() > 0)

    def _refuse_gyroscopic(self) -> None:
        """Refuse undamped modes of a system with gyroscopic forces, or without a speed."""
        if self._is_gyroscopic:
            raise InputError(UNDAMPED)
        self._turned()


def check_skew(matrix: Any) -> None:
    """Refuse a gyroscopic matrix that is not skew."""
    off = abs(matrix + matrix.T)
    if not off.max() > _SKEW * abs(matrix).max():
        return
    i, j = sorted(int(place) for place in divmod(int(off.argmax()), matrix.shape[0]))
    raise InputError(
        f"gyroscopic: must be skew, has {matrix[i, j]:g} in row {i + 1}, column {j + 1} and "
        f"{matrix[j, i]:g} in row {j + 1}, column {i + 1}"
    )
