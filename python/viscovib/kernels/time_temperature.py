"""Temperature dependence of rubber: shift laws and kernels.

A thermorheologically simple material relaxes at a temperature T like at its reference T_r, but
slower by the factor a_T. Its modulus at a frequency f equals that at a_T f and T_r (Ferry,
Viscoelastic Properties of Polymers, 1980, ch. 11). A kernel becomes R_T(t) = R(t/a_T)/a_T.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.errors import InputError
from viscovib.kernels.relaxation import Kernel

#: J/(mol K), and 0 deg C in K.
GAS_CONSTANT, KELVIN = 8.31446261815324, 273.15
#: Largest parameter of a law.
_LARGEST = 1e9


class ShiftLaw(ABC):
    """Ratio of the relaxation times at a temperature and at the reference temperature.

    Examples
    --------
    >>> law = vv.WLF(reference=20.0, c1=8.86, c2=101.6)
    >>> isinstance(law, vv.ShiftLaw), float(law(20.0))
    (True, 1.0)
    """

    reference: float

    @abstractmethod
    def log10(self, temperature: npt.ArrayLike) -> FloatArray:
        """Decades log10(a_T) at temperatures (deg C), any shape."""

    def __call__(self, temperature: npt.ArrayLike) -> FloatArray:
        """a_T at temperatures (deg C), any shape; 1 at the reference."""
        # The result may underflow to 0 or overflow to infinity.
        with np.errstate(over="ignore", under="ignore"):
            return np.asarray(10.0 ** self.log10(temperature))[()]


@dataclass(frozen=True, kw_only=True)
class WLF(ShiftLaw):
    """Law of Williams, Landel and Ferry, log10 a_T = -c1 (T - T_r)/(c2 + T - T_r).

    J. Am. Chem. Soc. 77 (1955) 3701. It is valid above the glass transition, T > T_r - c2.

    Parameters
    ----------
    reference : float
        T_r (deg C).
    c1 : float
        Decades, > 0.
    c2 : float
        Kelvin, > 0.

    Examples
    --------
    >>> law = vv.WLF(reference=20.0, c1=8.86, c2=101.6)
    >>> round(float(law.log10(70.0)), 3)
    -2.922
    """

    reference: float
    c1: float
    c2: float

    def __post_init__(self) -> None:
        _numbers(self, "reference", "c1", "c2")
        for name in ("c1", "c2"):
            _positive(name, getattr(self, name))

    def log10(self, temperature: npt.ArrayLike) -> FloatArray:
        """Decades log10(a_T) at temperatures (deg C), any shape."""
        t = _native.real_array("temperature", temperature) - self.reference
        if (t <= -self.c2).any():
            raise InputError(
                f"temperature = {t.min() + self.reference:g}: must be above reference - c2 = "
                f"{self.reference - self.c2:g}, where the law ends"
            )
        return np.asarray(-self.c1 * (t / (self.c2 + t)))[()]


@dataclass(frozen=True, kw_only=True)
class Arrhenius(ShiftLaw):
    """A thermally activated process: ln a_T = (E_a/R) (1/T - 1/T_r), temperatures in kelvin.

    Parameters
    ----------
    reference : float
        T_r (deg C).
    activation_energy : float
        E_a (J/mol), > 0.

    Examples
    --------
    >>> law = vv.Arrhenius(reference=20.0, activation_energy=80e3)
    >>> round(float(law.log10(40.0)), 3)
    -0.91
    """

    reference: float
    activation_energy: float

    def __post_init__(self) -> None:
        _numbers(self, "reference", "activation_energy")
        if self.reference <= -KELVIN:
            raise InputError(f"reference = {self.reference:g}: must be above -{KELVIN} deg C")
        _positive("activation_energy", self.activation_energy)

    def log10(self, temperature: npt.ArrayLike) -> FloatArray:
        """Decades log10(a_T) at temperatures (deg C), any shape."""
        warmer = _native.real_array("temperature", temperature) - self.reference
        kelvin = self.reference + KELVIN
        if (warmer <= -kelvin).any():
            raise InputError(
                f"temperature = {warmer.min() + self.reference:g}: must be above -{KELVIN} deg C"
            )
        rate = self.activation_energy / GAS_CONSTANT / np.log(10.0)
        # The difference of inverses would lose digits near the reference.
        return np.asarray(-rate / kelvin * (warmer / (kelvin + warmer)))[()]


@dataclass(frozen=True, kw_only=True)
class ThermalKernel(Kernel):
    """A kernel with a temperature: R_T(t) = R(t/a_T)/a_T.

    Parameters
    ----------
    kernel : Kernel
        R, at the reference of the law.
    shift : ShiftLaw
        `WLF` or `Arrhenius`.
    temperature : float, optional
        T (deg C); the reference if it is not given.

    Examples
    --------
    >>> cold = vv.RabotnovKernel(amplitude=0.3, alpha=0.6, beta=1.5)
    >>> rubber = vv.ThermalKernel(kernel=cold, shift=vv.WLF(reference=20.0, c1=8.86, c2=101.6))
    >>> mount = vv.Mount(
    ...     mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, kernel=rubber.at(40)
    ... )
    >>> warm = rubber.at(40)
    >>> bool(np.isclose(warm.transform(3.0), cold.transform(3.0 * warm.slowness)))
    True
    """

    kernel: Kernel
    shift: ShiftLaw
    temperature: float | None = None

    def __post_init__(self) -> None:
        _native.check_instance("kernel", self.kernel, Kernel)
        _native.check_instance("shift", self.shift, ShiftLaw)
        if isinstance(self.kernel, ThermalKernel):
            raise InputError("kernel: has a temperature already, must be the kernel within")
        at = self.shift.reference if self.temperature is None else self.temperature
        object.__setattr__(self, "temperature", _native.number("temperature", at))
        if not np.isfinite(self._data).all() or not self.slowness > 0:
            raise InputError(
                f"temperature = {self.temperature:g}: the kernel leaves the range of numbers, "
                f"must be closer to the reference {self.shift.reference:g}"
            )
        self._check()

    def at(self, temperature: float) -> "ThermalKernel":
        """The same material at a different temperature (deg C)."""
        return ThermalKernel(kernel=self.kernel, shift=self.shift, temperature=temperature)

    @property
    def slowness(self) -> float:
        """a_T."""
        assert self.temperature is not None
        return float(self.shift(self.temperature))

    @property
    def _kind(self) -> int:  # type: ignore[override]
        return self.kernel._kind

    @cached_property
    def _data(self) -> FloatArray:
        with np.errstate(all="ignore"):
            return self.kernel._scaled(1 / self.slowness) if self.slowness else np.array([np.nan])

    @property
    def _seconds(self) -> float:
        return self.kernel._seconds

    @property
    def _relaxing(self) -> float:
        return self.kernel._relaxing

    def _scaled(self, unit: float) -> FloatArray:
        return self.kernel._scaled(unit / self.slowness)

    def _complete_exponentials(
        self, tolerance: float, first: float, last: float, later: float
    ) -> tuple[FloatArray, FloatArray]:
        slow = self.slowness
        first, last = first / slow, last / slow
        weights, rates = self.kernel._complete_exponentials(tolerance, first, last, later)
        return weights / slow, rates / slow


def _positive(name: str, value: float) -> None:
    if not value > 0:
        raise InputError(f"{name} = {value:g}: must be greater than 0")
    if value > _LARGEST:
        raise InputError(
            f"{name} = {value:g}: must be at most {_LARGEST:g}, no material exceeds this"
        )


def _numbers(owner: Any, *names: str) -> None:
    for name in names:
        object.__setattr__(owner, name, _native.number(name, getattr(owner, name)))
