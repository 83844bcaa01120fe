"""What code asks of any system: its laws, its kernels and its parameters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, TypeVar

from viscovib._native import FloatArray
from viscovib.errors import NearNames

if TYPE_CHECKING:
    from viscovib.kernels.relaxation import Kernel
    from viscovib.systems.laws import Law
    from viscovib.systems.supports import Supports

#: Parameters of the load of a system.
OF_LOADS = ("nu", "load_scale")


#: Error of an analysis without a speed, as in the core.
SPEED_NEEDED = (
    "speed: must be given to the system, whose matrices depend on it; no frequency nu of a load is "
    "the speed here"
)
_Any = TypeVar("_Any")


class System(NearNames):
    """Base class of all systems. Each kind overrides what it has."""

    #: True if the loads are parameters of the system itself.
    _has_own_loads = False
    #: True if motions are computed in modes and deflections of elements.
    _is_condensed = False
    #: The system in modes for motions in time; None: it has none of its own.
    _modes_in_time: Any = None
    #: Factor of all kernels.
    _kernel_scale = 1.0
    #: True if matrices depend on the speed of a rotor, which is the frequency of the load.
    _depends_on_speed: bool = False
    #: Supports that were removed from the matrices; None: none.
    _held: Supports | None = None

    @property
    def _turns(self) -> bool:
        """True if the mass matrix depends on the motion of a body."""
        return False

    def _fastest(self: Any) -> float:
        """Rate of the fastest linear motion, or an upper bound (1/s)."""
        return float(self.natural_frequencies().max())

    @property
    def _all_laws(self) -> tuple[Law, ...]:
        """Force laws that are not polynomials."""
        return ()

    def _laws_at(
        self, q: FloatArray, v: FloatArray
    ) -> Iterator[tuple[Law, FloatArray, FloatArray]]:
        """Yield each law with its arguments and their rates.

        ``q`` and ``v`` are coordinates (for a structure, deflections) and their rates, shape
        (..., n); arguments and rates have the shape (..., n_arguments). Rates of rates are 0.
        """
        return iter(())

    @property
    def _has_kinks(self) -> bool:
        """True if a law has kinks or jumps, or an element has hysteresis."""
        return any(law.state or law.branches for law in self._all_laws)

    @property
    def _active_kernels(self) -> tuple[Kernel, ...]:
        return ()

    @property
    def _all_kernels(self) -> tuple[Kernel, ...]:
        """Kernels of elements and layers."""
        return self._active_kernels

    @property
    def _scales(self) -> tuple[str, ...]:
        """Factors of the parts of the system that may vary in an ensemble."""
        return ()

    @property
    def _parameter_names(self) -> tuple[str, ...]:
        """Parameters that may vary in an ensemble, without scales."""
        return ()

    def _turned(self, nu: float | None = None) -> Any:
        """See `turned`."""
        return self

    def _with_parameters(self, numbers: Mapping[str, float]) -> Any:
        """Return the system with new values of these parameters."""
        raise NotImplementedError


def turned(system: _Any, nu: float | None) -> _Any:
    """Return the system with constant matrices: at the speed nu if they depend on it.

    Raises InputError if a speed is needed and nu is None. Other values are returned as they are.
    """
    if not isinstance(system, System):
        return system
    found: _Any = system._turned(nu)
    return found
