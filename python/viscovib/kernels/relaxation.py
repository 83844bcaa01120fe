"""Relaxation kernels of viscoelastic springs.

A spring of stiffness c with memory is c (1 - R*), where (R*g)(t) = integral_0^t R(t-s) g(s) ds.
Every kernel has its transforms

    R_c(mu) - i R_s(mu) = integral_0^inf R(t) exp(-i mu t) dt

in closed form, with full accuracy.
"""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.common.parameters import TOLERANCE, Number
from viscovib.errors import ConvergenceWarning, InputError, NearNames, caller


class Kernel(NearNames, ABC):
    """A relaxation kernel R(t) (1/s).

    Examples
    --------
    >>> import viscovib as vv
    >>> rubber = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
    >>> isinstance(rubber, vv.Kernel)
    True
    """

    _kind: ClassVar[int]
    #: True if sums of exponentials reach any tolerance.
    _meets: ClassVar[bool] = True

    @cached_property
    @abstractmethod
    def _data(self) -> FloatArray:
        """Parameters in the flat order of the core."""

    @cached_property
    def integral(self) -> float:
        """Integral of R over [0, inf): the fraction of the stiffness lost by complete relaxation.

        It is inf for some kernels. At 1 or more the relaxed stiffness is not positive.
        """
        return float(_native.run("kernel integral", self._handle)["integral"])

    @cached_property
    def _handle(self) -> _native.Handle:
        """The kernel in the core."""
        return self._in_core(self._data)

    def _in_core(self, data: FloatArray) -> _native.Handle:
        """Create a kernel of this kind in the core."""
        return _native.Handle("kernel new", kind=self._kind, data=data)

    def __call__(self, t: npt.ArrayLike) -> FloatArray:
        """R(t) (1/s) at times t > 0 (s), any shape."""
        times = _positive_times(t)
        values = _native.run_in_parts(
            "kernel value", self._handle, 200 * self._seconds, t=times.ravel()
        )["values"]
        _native.check_range("t", times, values, "R(t)")
        result: FloatArray = _same_shape(values, times)
        return result

    def plot(self, ax: Any = None, *, t: npt.ArrayLike | None = None) -> Any:
        """Plot R(t) and the relaxation of a unit step of strain, and return the axes.

        Parameters
        ----------
        ax : sequence of 2 Axes, optional
            By default those of a new figure.
        t : array_like, optional
            Times > 0 (s); by default six decades around the mean time of the kernel.

        Examples
        --------
        >>> import viscovib as vv
        >>> axes = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05).plot()
        """
        from importlib import import_module

        return import_module("viscovib.plots.kernels").plot_kernel(self, ax, t)

    def transform(self, mu: npt.ArrayLike) -> ComplexArray:
        """R_c - i R_s at circular frequencies mu (rad/s), any shape; dimensionless."""
        frequencies = _native.real_array("mu", mu)
        if not np.isfinite(self.integral) and (frequencies == 0).any():
            raise InputError("mu = 0: this kernel has no integral, mu must not be 0")
        values = self._in_units("transform", "mu", frequencies)
        result: ComplexArray = _same_shape(values, frequencies)
        return result

    def cosine(self, mu: npt.ArrayLike) -> FloatArray:
        """R_c, the integral of R(t) cos(mu t)."""
        return np.array(self.transform(mu).real)[()]

    def sine(self, mu: npt.ArrayLike) -> FloatArray:
        """R_s, the integral of R(t) sin(mu t)."""
        return np.array(-self.transform(mu).imag)[()]

    def laplace(self, s: npt.ArrayLike) -> ComplexArray:
        """Laplace transform at complex s (1/s), any shape, continued to the branch cut.

        A pole, or the end of the cut, is an `InputError`.
        """
        points = _native.complex_array("s", s)
        values = self._in_units("laplace", "s", points)
        result: ComplexArray = _same_shape(values, points)
        return result

    def relaxation(self, t: npt.ArrayLike) -> FloatArray:
        """1 - integral of R from 0 to t: stress of a unit stiffness after a unit step of strain.

        Times t > 0 (s), any shape; dimensionless.
        """
        times = _positive_times(t)
        total = self._in_units("accumulated", "t", times, -1)
        result: FloatArray = _same_shape(1 - total, times)
        return result

    @cached_property
    def _seconds(self) -> float:
        """Largest computing time of a value of the transform (s)."""
        return 2e-8 + 5e-9 * self._data.size

    @property
    def _relaxing(self) -> float:
        """Largest computing time of a value of the relaxation (s)."""
        return 2e-6 + 3 * self._seconds

    @abstractmethod
    def _scaled(self, unit: float) -> FloatArray:
        """Parameters of the kernel unit R(unit t), with times in units of ``unit`` (s)."""

    def _in_units(
        self, what: str, name: str, points: npt.NDArray[Any], power: int = 1
    ) -> npt.NDArray[Any]:
        """Compute dimensionless values; where they are not finite, in different units of time.

        In seconds, powers of extreme points would overflow or underflow. Points have the unit
        s^-power.
        """
        flat = points.ravel()
        seconds = self._seconds if power > 0 else self._relaxing
        task = f"kernel {what}"
        found = _native.run_in_parts(task, self._handle, seconds, **{name: flat})
        values: npt.NDArray[Any] = found["values"]
        if found["lost"] == 0 if "lost" in found else _native.all_finite(values):
            return values
        sizes = np.maximum(np.abs(flat.real), np.abs(flat.imag))
        for far, factor in ((sizes > 1 / _SMALL, _SMALL**2), (sizes < _SMALL, _SMALL**-2)):
            far &= (sizes != 0) & ~np.isfinite(values)
            if far.any():
                with np.errstate(over="ignore", invalid="ignore"):
                    data = self._scaled(factor**power)
                if np.isfinite(data).all():
                    values[far] = _native.run_in_parts(
                        task, self._in_core(data), seconds, **{name: flat[far] * factor}
                    )["values"]
        quantity = "the transform" if power > 0 else "the relaxation"
        _native.check_range(name, points, values, quantity)
        return values

    def sum_of_exponentials(
        self, *, tolerance: float = 1e-10, t_min: float, t_max: float
    ) -> ExponentialSum:
        """Replace the kernel by a short sum of exponentials with positive weights.

        The sum has R(t) at times from t_min to t_max and the transform at circular frequencies
        from 1/t_max to 2 pi/t_min, so it includes the integral of R before t_min. Use it for
        motions whose frequencies and step size are in that range.

        The method is the trapezoidal rule over the logarithm of the rates (Beylkin and Monzon,
        2010). Gauss rules replace its slow and its fast end. For a table it is the closest sum
        with positive weights.

        Parameters
        ----------
        tolerance : float
            Relative error, 1e-14 to 0.1.
        t_min, t_max : float
            t_min < t_max (s), both 1e-100 to 1e100.

        Returns
        -------
        ExponentialSum
            A PronyKernel with its measured ``error``.

        Warns
        -----
        ConvergenceWarning
            If ``error`` is larger than ``tolerance``, as may happen for a table.
        """
        wanted = TOLERANCE.check(tolerance)
        first, last = _T_MIN.check(t_min), _T_MAX.check(t_max)
        if not 0 < first < last:
            raise InputError(f"t_min = {first:g}, t_max = {last:g}: must be 0 < t_min < t_max")
        target, later = wanted, _LATER
        for _ in range(_TRIES):
            found, misfit = self._measured_sum(target, first, last, later)
            short = found.error / max(wanted, _SUM_ROUNDING)
            if short <= 1 or not self._meets:
                break
            if later == _LATER and misfit <= max(wanted, _SUM_ROUNDING):
                later *= 3
            else:
                target = max(0.3 * target / short, _LEAST_TOLERANCE)
        if short > 1:
            warnings.warn(
                f"the sum of exponentials meets {found.error:.1e}, not the tolerance {wanted:.1e}",
                ConvergenceWarning,
                stacklevel=caller(),
            )
        return found

    def _measured_sum(
        self, tolerance: float, first: float, last: float, later: float
    ) -> tuple[ExponentialSum, float]:
        """Return a sum, with its error at many times and frequencies, and the error of R(t)."""
        weights, rates = self._complete_exponentials(tolerance, first, last, later)
        if weights.size > _MOST_TERMS:
            raise InputError(
                f"t_min = {first:g}, t_max = {last:g}: a sum to {tolerance:g} needs more than "
                f"{_MOST_TERMS} terms, must be closer to each other"
            )
        times = np.geomspace(first, last, max(200, 12 * weights.size))
        exact = self(times)
        parts = np.array_split(times, -(-times.size * weights.size // _AT_A_TIME))
        close = np.concatenate([np.exp(-np.outer(part, rates)) @ weights for part in parts])
        scale = np.abs(exact) if (exact != 0).all() else np.abs(exact).max()
        misfit = float((np.abs(close - exact) / scale).max()) if np.any(exact) else 0.0
        of_transform = self._transform_error(weights, rates, first, last)
        # A table has no R(t) beyond its last time; its transform uses 0 there.
        error = max(misfit, of_transform) if self._meets else misfit
        found = ExponentialSum(
            weights=weights, rates=rates, t_min=first, t_max=last, error=error,
            transform_error=of_transform,
        )  # fmt: skip
        return found, misfit

    def _transform_error(
        self, weights: FloatArray, rates: FloatArray, first: float, last: float
    ) -> float:
        """Largest error of the transform of a sum, absolute or relative, whichever is larger."""
        mu = np.geomspace(1 / last, 2 * np.pi / first, 200)
        exact = self.transform(mu)
        close = (weights / (rates + 1j * mu[:, np.newaxis])).sum(axis=1)
        scale = np.minimum(np.abs(exact), 1)
        return float((np.abs(close - exact) / scale).max()) if exact.any() else 0.0

    def _complete_exponentials(
        self, tolerance: float, first: float, last: float, later: float
    ) -> tuple[FloatArray, FloatArray]:
        """Weights and rates of a sum that includes the integral before ``first``."""
        from viscovib.kernels.exponential_terms import EARLIER, with_early_part

        weights, rates = self._exponentials(tolerance, EARLIER * first, later * last)
        return with_early_part(self, weights, rates, tolerance, first)

    def _exponentials(
        self, tolerance: float, first: float, last: float
    ) -> tuple[FloatArray, FloatArray]:
        """Weights and rates of the core."""
        found = _native.apart(
            lambda: _native.run(
                "kernel exponentials", self._handle, tolerance=tolerance, t_min=first, t_max=last
            )
        )
        if not found["rates"].size:
            raise InputError(
                f"alpha: this kernel is too close to a single rate for a sum of exponentials "
                f"to {tolerance:g}; must be further from 1, or 1"
            )
        return found["weights"], found["rates"]

    def _check(self) -> None:
        """Let the core check the parameters."""
        _ = self.integral


def check_kernel(name: str, value: object, alternatives: str = " or None") -> None:
    """Refuse a value that is neither a kernel nor None."""
    if not (value is None or isinstance(value, Kernel)):
        shown = _native.shown(value)
        raise InputError(f"{name} = {shown}: must be a Kernel{alternatives}{kernel_call(value)}")


def kernel_call(value: object) -> str:
    """Return the call for the name or the class of a kernel; "" for other values."""
    word = value.__name__ if isinstance(value, type) else value
    word = word.strip().lower().removesuffix("kernel") if isinstance(word, str) else ""
    for one in (RzhanitsynKernel, AbelKernel, RabotnovKernel, PronyKernel):
        if one.__name__.lower() == f"{word}kernel":
            arguments = ", ".join(f"{field.name}=..." for field in fields(one))
            return f"; give {one.__name__}({arguments})"
    return ""


def _positive_times(t: npt.ArrayLike) -> FloatArray:
    times = _native.real_array("t", t)
    if times.size and times.min() <= 0:
        raise InputError(f"t = {times.min()}: must be greater than 0")
    return times


def _same_shape(values: npt.NDArray[Any], like: npt.NDArray[Any]) -> Any:
    return values.reshape(like.shape)[()]


#: Bounds of the times of a sum of exponentials, largest number of terms, and of exponentials per
#: array.
_T_MIN, _T_MAX = Number("t_min", 1e-100, 1e100), Number("t_max", 1e-100, 1e100)
_MOST_TERMS, _AT_A_TIME = 4000, 2**22
#: The sum of the core ends at this multiple of t_max, because it must include 1/t_max.
_LATER = 3.0
#: Largest number of attempts to meet a tolerance, smallest tolerance for the core, and rounding
#: error of sums.
_TRIES, _LEAST_TOLERANCE, _SUM_ROUNDING = 4, 1e-15, 1e-14
#: Points below this and above its inverse may be converted to different units.
_SMALL = 1e-100


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
        Rate of the exponential (1/s), >= 0; for 0 the kernel has no finite integral.

    Examples
    --------
    >>> import viscovib as vv
    >>> rubber = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
    >>> round(rubber.integral, 4)
    0.6161
    >>> loss = rubber.sine(1.5) / (1 - rubber.cosine(1.5))  # loss factor at 1.5 rad/s
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

    def _scaled(self, unit: float) -> FloatArray:
        return np.array([self.amplitude * unit**self.alpha, self.alpha, self.beta * unit])

    @property
    def limit_amplitude(self) -> float:
        """The amplitude A for which the integral is 1: beta^alpha / Gamma(alpha)."""
        unit = RzhanitsynKernel(amplitude=1.0, alpha=self.alpha, beta=self.beta)
        return 1.0 / unit.integral


@dataclass(frozen=True, kw_only=True)
class AbelKernel(Kernel):
    """Abel (power law) kernel R(t) = A t^(alpha-1), 0 < alpha <= 1, without a finite integral.

    Examples
    --------
    >>> import viscovib as vv
    >>> kernel = vv.AbelKernel(amplitude=0.03, alpha=0.2)
    >>> kernel.integral
    inf
    >>> transform = kernel.transform([1.0, 2.0])  # R_c - i R_s
    """

    amplitude: float
    alpha: float
    _kind: ClassVar[int] = 3

    def __post_init__(self) -> None:
        _numbers(self, "amplitude", "alpha")
        self._check()

    @cached_property
    def _data(self) -> FloatArray:
        return np.array([self.amplitude, self.alpha])

    def _scaled(self, unit: float) -> FloatArray:
        return np.array([self.amplitude * unit**self.alpha, self.alpha])


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

    Examples
    --------
    >>> import viscovib as vv
    >>> kernel = vv.RabotnovKernel(amplitude=0.1, alpha=0.5, beta=0.4)
    >>> round(kernel.integral, 12)
    0.25
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

    def _scaled(self, unit: float) -> FloatArray:
        both = np.array([self.amplitude, self.beta]) * unit**self.alpha
        return np.array([both[0], self.alpha, both[1]])


@dataclass(frozen=True, kw_only=True, eq=False)
class PronyKernel(Kernel):
    """Sum of exponentials (generalised Maxwell) R(t) = sum_j w_j exp(-r_j t).

    Parameters
    ----------
    weights : array_like, shape (n,)
        w_j >= 0 (1/s).
    rates : array_like, shape (n,)
        r_j >= 0 (1/s).

    Examples
    --------
    >>> import viscovib as vv
    >>> kernel = vv.PronyKernel(weights=[0.1, 0.2], rates=[0.5, 4])
    >>> round(kernel.integral, 12)
    0.25
    >>> round(float(kernel(1e-9)), 6)
    0.3
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

    def _scaled(self, unit: float) -> FloatArray:
        return self._data * unit

    def _complete_exponentials(
        self, tolerance: float, first: float, last: float, later: float
    ) -> tuple[FloatArray, FloatArray]:
        """The terms of the kernel."""
        return np.asarray(self.weights), np.asarray(self.rates)


@dataclass(frozen=True, kw_only=True, eq=False)
class ExponentialSum(PronyKernel):
    """A sum of exponentials that replaces another kernel, from `Kernel.sum_of_exponentials`.

    Attributes
    ----------
    t_min, t_max : float
        Shortest and longest time for which the sum is valid (s).
    error : float
        Measured largest relative error of R(t) from t_min to t_max (relative to the largest value
        if R vanishes somewhere), or `transform_error` if that is larger. For a table: of R(t) only.
    transform_error : float
        Measured largest error of the transform at circular frequencies from 1/t_max to
        2 pi/t_min, absolute or relative, whichever is larger.

    Examples
    --------
    >>> import viscovib as vv
    >>> rubber = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
    >>> fit = rubber.sum_of_exponentials(tolerance=1e-8, t_min=1e-3, t_max=100)
    >>> fit.weights.shape == fit.rates.shape
    True
    """

    t_min: float
    t_max: float
    error: float
    transform_error: float = float("nan")


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
