"""Relaxation kernels: how a viscoelastic spring forgets.

A spring of stiffness c with memory has c (1 - R*) in its place, where
(R*g)(t) = integral_0^t R(t-s) g(s) ds. Every kernel gives its transforms

    R_c(mu) - i R_s(mu) = integral_0^inf R(t) exp(-i mu t) dt

in closed form, to the last digits.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray, core
from viscovib.errors import InputError


class Kernel(ABC):
    """A relaxation kernel R(t) (1/s)."""

    _kind: ClassVar[int]

    @cached_property
    @abstractmethod
    def _data(self) -> FloatArray:
        """Parameters in the flat order of the core."""

    @cached_property
    def integral(self) -> float:
        """Integral of R over [0, inf): what a spring loses in the end (inf if there is none).

        At 1 or more the relaxed stiffness is not positive.
        """
        return float(_native.call(core.kernel_integral, self._kind, self._data)[0])

    def __call__(self, t: npt.ArrayLike) -> FloatArray:
        """R(t) (1/s) at times t > 0 (s), any shape."""
        times = _native.real_array("t", t)
        if times.size and times.min() <= 0:
            raise InputError(f"t = {times.min()}: must be greater than 0")
        (values,) = _native.call(core.kernel_value, self._kind, self._data, times.ravel())
        result: FloatArray = _same_shape(values, times)
        return result

    def transform(self, mu: npt.ArrayLike) -> ComplexArray:
        """R_c - i R_s at circular frequencies mu (rad/s), any shape; dimensionless."""
        frequencies = _native.real_array("mu", mu)
        if not np.isfinite(self.integral) and (frequencies == 0).any():
            raise InputError("mu = 0: this kernel has no integral, mu must not be 0")
        (values,) = _native.call(core.kernel_transform, self._kind, self._data, frequencies.ravel())
        result: ComplexArray = _same_shape(values, frequencies)
        return result

    def cosine(self, mu: npt.ArrayLike) -> FloatArray:
        """R_c, the integral of R(t) cos(mu t)."""
        return np.array(self.transform(mu).real)[()]

    def sine(self, mu: npt.ArrayLike) -> FloatArray:
        """R_s, the integral of R(t) sin(mu t)."""
        return np.array(-self.transform(mu).imag)[()]

    def laplace(self, s: npt.ArrayLike) -> ComplexArray:
        """Laplace transform at complex s (1/s), any shape, continued off its branch cut."""
        points = _native.complex_array("s", s)
        (values,) = _native.call(core.kernel_laplace, self._kind, self._data, points.ravel())
        result: ComplexArray = _same_shape(values, points)
        return result

    def _check(self) -> None:
        """Let the core judge the parameters."""
        _ = self.integral


def _same_shape(values: npt.NDArray[Any], like: npt.NDArray[Any]) -> Any:
    return values.reshape(like.shape)[()]


@dataclass(frozen=True, kw_only=True)
class RzhanitsynKernel(Kernel):
    """Koltunov-Rzhanitsyn kernel R(t) = A exp(-beta t) t^(alpha-1).

    Parameters
    ----------
    amplitude : float
        A >= 0 (1/s^alpha).
    alpha : float
        Exponent of the weak singularity, in (0, 1].
    beta : float
        Rate of the exponential (1/s), >= 0; without it the kernel has no integral.
    """

    amplitude: float
    alpha: float
    beta: float
    _kind: ClassVar[int] = 1

    def __post_init__(self) -> None:
        _numbers(self, "amplitude", "alpha", "beta")
        self._check()

    @cached_property
    def _data(self) -> FloatArray:
        return np.array([self.amplitude, self.alpha, self.beta])

    @property
    def limit_amplitude(self) -> float:
        """The A at which the integral reaches 1: beta^alpha / Gamma(alpha)."""
        unit = RzhanitsynKernel(amplitude=1.0, alpha=self.alpha, beta=self.beta)
        return 1.0 / unit.integral


@dataclass(frozen=True, kw_only=True)
class AbelKernel(Kernel):
    """Abel (power law) kernel R(t) = A t^(alpha-1), 0 < alpha <= 1; it has no integral."""

    amplitude: float
    alpha: float
    _kind: ClassVar[int] = 3

    def __post_init__(self) -> None:
        _numbers(self, "amplitude", "alpha")
        self._check()

    @cached_property
    def _data(self) -> FloatArray:
        return np.array([self.amplitude, self.alpha])


@dataclass(frozen=True, kw_only=True)
class RabotnovKernel(Kernel):
    """Rabotnov's fractional-exponential kernel.

    R(t) = A t^(alpha-1) E_{alpha,alpha}(-beta t^alpha) with the Mittag-Leffler function E;
    transform A / ((i mu)^alpha + beta), integral A / beta.

    Parameters
    ----------
    amplitude : float
        A >= 0 (1/s^alpha).
    alpha : float
        Fractional order, in (0, 1].
    beta : float
        beta >= 0 (1/s^alpha).
    """

    amplitude: float
    alpha: float
    beta: float
    _kind: ClassVar[int] = 4

    def __post_init__(self) -> None:
        _numbers(self, "amplitude", "alpha", "beta")
        self._check()

    @cached_property
    def _data(self) -> FloatArray:
        return np.array([self.amplitude, self.alpha, self.beta])


@dataclass(frozen=True, kw_only=True, eq=False)
class PronyKernel(Kernel):
    """Sum of exponentials (generalised Maxwell) R(t) = sum_j w_j exp(-r_j t).

    Parameters
    ----------
    weights : array_like, shape (n,)
        w_j >= 0 (1/s).
    rates : array_like, shape (n,)
        r_j >= 0 (1/s).
    """

    weights: npt.ArrayLike
    rates: npt.ArrayLike
    _kind: ClassVar[int] = 2

    def __post_init__(self) -> None:
        _vectors(self, "weights", "rates")
        self._check()

    @cached_property
    def _data(self) -> FloatArray:
        return np.concatenate([np.asarray(self.weights), np.asarray(self.rates)])


@dataclass(frozen=True, kw_only=True, eq=False)
class TabulatedKernel(Kernel):
    """A measured kernel R(t_i), with an exact transform of its interpolant.

    Parameters
    ----------
    times : array_like, shape (n,)
        t_i >= 0 (s), strictly increasing, n >= 2.
    values : array_like, shape (n,)
        R(t_i) (1/s).
    interpolation : {"linear", "exponential"}
        "linear": straight between points, constant before the first, 0 after the last.
        "exponential": log-linear between points (all values > 0), the first and last rates
        continued outside.
    """

    times: npt.ArrayLike
    values: npt.ArrayLike
    interpolation: str = "linear"
    _kind: ClassVar[int] = 5
    _codes: ClassVar[tuple[str, ...]] = ("linear", "exponential")

    def __post_init__(self) -> None:
        _vectors(self, "times", "values")
        _native.choice("interpolation", self.interpolation, self._codes)
        self._check()

    @cached_property
    def _data(self) -> FloatArray:
        code = float(self._codes.index(self.interpolation))
        return np.concatenate([[code], np.asarray(self.times), np.asarray(self.values)])


def _numbers(kernel: Kernel, *names: str) -> None:
    for name in names:
        object.__setattr__(kernel, name, _native.number(name, getattr(kernel, name)))


def _vectors(kernel: Kernel, first: str, second: str) -> None:
    for name in (first, second):
        array = _native.real_array(name, getattr(kernel, name), ndim=1).copy()
        array.setflags(write=False)
        object.__setattr__(kernel, name, array)
    sizes = [getattr(kernel, name).size for name in (first, second)]
    if sizes[0] != sizes[1]:
        raise InputError(f"{first} and {second} have {sizes[0]} and {sizes[1]} numbers: must match")
    if sizes[0] == 0:
        raise InputError(f"{first}: must not be empty")
