"""Maxwell elements: a spring in series with a fluid damper, with an internal coordinate each.

The deflection q of the spring follows q' = d' - h(q), where h is the rate of the damper under the
force k q. With q = s' + r s, for any r > 0, the coordinate s has the equation

    k s'' + k r s' + k h(s' + r s) - k d' = 0,

and the element exerts k s' + k r s along its direction. These are a mass k, entries of C and K, and
a law of s and s'. The motion of s for q = 0 decays like exp(-r t) and has no effect on the
structure: it adds the exponent -r to those of a motion.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.values import own_fields
from viscovib.errors import InputError
from viscovib.systems.dampers import LosesInCycles, _positive, _take, _within
from viscovib.systems.laws import Law, compile_law

#: Bounds of the exponent.
_EXPONENTS = (0.1, 2.0)
#: Slope of the damper in the linear subsystem for a other than 1, relative to the rate r.
_SLOPE = 1e-4
#: Samples of a cycle (odd), their phases, and most steps of Newton's method.
_SAMPLES, _MOST = 301, 100
_PHASES = 2 * np.pi * np.arange(_SAMPLES) / _SAMPLES


@dataclass(frozen=True, kw_only=True, eq=False)
class Maxwell(LosesInCycles):
    """A spring k in series with a fluid damper c sign(w) abs(w)^a, w its rate, on d = e . u.

    The structure gets an internal coordinate "maxwell1", "maxwell2", ... for each such element,
    behind its other coordinates, also in arrays of loads and states. Multipliers and exponents of
    motions contain one more decaying value for each, without effect on the structure.

    Parameters
    ----------
    on : str, int, tuple of two str, mapping or array_like
        The direction e, as for `Spring`.
    stiffness : float
        k of the spring, greater than 0 (N/m).
    coefficient : float
        c of the damper, greater than 0 (N (s/m)^a).
    exponent : float
        a, 0.1 to 2. Above 1 the element has no linear part at rest (with method="linear" it acts
        there as its spring alone), and where harmonics do not converge, `steady_motion` does.

    Examples
    --------
    A linear element loses pi k X^2 r/(1 + r^2) in a cycle, r = nu c/k:

    >>> import viscovib as vv
    >>> mount = vv.Maxwell(on="x1", stiffness=100, coefficient=10)
    >>> round(float(mount.energy(0.02, nu=10)), 6)
    0.062832
    >>> frame = vv.Structure(mass=[1.0], stiffness=[50.0], elements=[mount])
    >>> frame.dof_names
    ('x1', 'maxwell1')
    """

    on: Any
    stiffness: float
    coefficient: float
    exponent: float = 1.0
    #: Name of the internal coordinate in a structure, and the rate r.
    _inner: str = field(init=False, repr=False, default="")
    _rate: float = field(init=False, repr=False, default=1.0)

    def __post_init__(self) -> None:
        own_fields(self)
        _take(self, "stiffness", "coefficient", "exponent")
        _positive(self, "stiffness", "coefficient")
        if self.exponent == 0:
            raise InputError(
                "exponent = 0: is dry friction, must be 0.1 to 2: use a Jenkins element"
            )
        _within(self, "exponent", *_EXPONENTS)

    @cached_property
    def _whole(self) -> Law:
        """The law k h of the internal coordinate and its rate."""
        q, k = f"(v + {self._rate!r}*d)", self.stiffness
        c, power = self.coefficient, 1 / self.exponent
        text = f"{k * k!r}*{q}/{c!r}"
        if self.exponent != 1:
            text = f"{k!r}*sign{q}*abs({k!r}*{q}/{c!r})^{power!r}"
        return compile_law("law", text, ("d", "v"), {}, 1)

    @property
    def _linear_damping(self) -> float:
        """The slope of k h in the linear subsystem.

        At rest it is 0 for a < 1, infinite for a > 1. A small number, which the law subtracts,
        keeps the stiffness of the internal coordinate above 0.
        """
        slope = self.stiffness / self.coefficient if self.exponent == 1 else _SLOPE * self._rate
        return self.stiffness * slope

    def loop(self, amplitude: float, *, nu: float) -> FloatArray:
        """Return the force at 720 equal steps of a cycle d = X sin(nu t), shape (720,) (N).

        Parameters
        ----------
        amplitude : float
            X, greater than 0 (m).
        nu : float
            Circular frequency, greater than 0 (rad/s).
        """
        parts = np.fft.rfft(self._cycle(amplitude, nu)) / _SAMPLES
        return np.asarray(self.stiffness * np.fft.irfft(720 * parts, 720))

    def _energy(self, sizes: FloatArray, speed: float) -> FloatArray:
        return np.reshape([self._lost(size, speed) for size in sizes.ravel()], sizes.shape)

    def _lost(self, size: float, nu: float) -> float:
        if size == 0:
            return 0.0
        lost = self._cycle(size, nu) * np.cos(_PHASES)
        return float(2 * np.pi * size * self.stiffness * lost.mean())

    def _cycle(self, size: float, nu: float) -> FloatArray:
        """Return q at the samples of a cycle d = X sin(nu t): q' + h(q) = d' by Newton's method."""
        for name, value in (("amplitude", size), ("nu", nu)):
            if _native.number(name, value) <= 0:
                raise InputError(f"{name} = {value:g}: must be greater than 0")
        with np.errstate(all="ignore"):
            q = self._periodic(float(size), float(nu))
        if not np.isfinite(q).all():
            raise InputError(
                f"amplitude = {size:g}: the force is not finite or too small, change the units"
            )
        return q

    def _periodic(self, size: float, nu: float) -> FloatArray:
        ratio = np.float64(self.stiffness) / self.coefficient
        # In y, k q/c = sign(y) abs(y)^p and the rate h = sign(y) abs(y)^r are both smooth.
        p, r = (self.exponent, 1.0) if self.exponent > 1 else (1.0, 1 / self.exponent)
        orders = np.fft.fftfreq(_SAMPLES, 1 / _SAMPLES)
        waves = np.fft.fft(np.eye(_SAMPLES), axis=0)
        change = np.fft.ifft(1j * nu * orders[:, np.newaxis] * waves, axis=0).real / ratio
        speed = size * nu * np.cos(_PHASES)
        # The damper is at most as fast as the deflection.
        largest = float(np.float64(size * nu) ** self.exponent)
        y = _power(np.clip(ratio * size * np.sin(_PHASES), -largest, largest), 1 / p)

        def residual(y: FloatArray) -> FloatArray:
            return np.asarray(change @ _power(y, p) + _power(y, r) - speed)

        for _ in range(_MOST):
            left, a = residual(y), np.abs(y)
            matrix = change * (p * a ** (p - 1)) + np.diag(r * a ** (r - 1))
            if not (np.isfinite(matrix).all() and np.isfinite(left).all()):
                return np.full(_SAMPLES, np.nan)
            try:
                step, part = np.linalg.solve(matrix, -left), 1.0
            except np.linalg.LinAlgError:
                return np.full(_SAMPLES, np.nan)
            while part > 1e-6 and np.linalg.norm(residual(y + part * step)) > np.linalg.norm(left):
                part /= 2
            y = y + part * step
            if np.abs(step).max() <= 1e-13 * np.abs(y).max():
                break
        return _power(y, p) / ratio


def _power(y: FloatArray, p: float) -> FloatArray:
    """Return sign(y) abs(y)^p."""
    return np.asarray(np.sign(y) * np.abs(y) ** p)
