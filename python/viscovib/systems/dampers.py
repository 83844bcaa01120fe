"""Dampers and friction elements of a structure whose force depends on the rate only."""

from dataclasses import dataclass
from functools import cached_property
from math import gamma, pi, sqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.values import own_fields
from viscovib.errors import InputError
from viscovib.systems.laws import Law, compile_law

#: Bounds of the exponents.
_EXPONENTS, _STRIBECK = (0.1, 2.0), (0.5, 4.0)
#: Nodes of a double-exponential rule on (0, 1), and their weights.
_T = np.linspace(-4, 4, 257)
_NODES = 1 / (1 + np.exp(-pi * np.sinh(_T)))
_WEIGHTS = pi / 32 * np.cosh(_T) * _NODES / (1 + np.exp(pi * np.sinh(_T)))


class LosesInCycles:
    """An element with an energy loss in cycles of its deflection."""

    def energy(self, amplitude: npt.ArrayLike, *, nu: float) -> FloatArray:
        """Return the energy loss (J) of a cycle d = X sin(nu t).

        Parameters
        ----------
        amplitude : array_like
            X, of any shape (m).
        nu : float
            Circular frequency, greater than 0 (rad/s).
        """
        sizes = np.abs(_native.real_array("amplitude", amplitude))
        speed = _native.number("nu", nu)
        if speed <= 0:
            raise InputError(f"nu = {speed:g}: must be greater than 0")
        with np.errstate(all="ignore"):
            return np.asarray(self._energy(sizes, speed))

    def _energy(self, sizes: FloatArray, speed: float) -> FloatArray:
        """Return the loss at amplitudes of any shape and a frequency above 0."""
        raise NotImplementedError


class RateElement(LosesInCycles):
    """An element with a force f(v) along a direction, odd in the rate v = d'."""

    on: Any

    @property
    def _text(self) -> str:
        """The force in the syntax of laws."""
        raise NotImplementedError

    @property
    def _rate_of_kink(self) -> float:
        """A rate above 0 at which the force has a kink; 0: none."""
        return 0.0

    @cached_property
    def _whole(self) -> Law:
        return compile_law("law", self._text, ("d", "v"), {}, 1)

    @cached_property
    def _damping(self) -> float:
        """Slope of the force at rest, which belongs to the linear subsystem."""
        return float(self._whole.damping_at_rest()[0])

    @cached_property
    def _law(self) -> Law | None:
        """The force without its linear part at rest; None for a linear damper."""
        return self._whole.remainder()

    def force(self, v: npt.ArrayLike) -> FloatArray:
        """Return f at rates of any shape (N)."""
        rates = _native.real_array("v", v)
        at = np.stack([np.zeros(rates.size), rates.ravel()], axis=1)
        return self._whole.values(at).reshape(rates.shape)

    def _energy(self, sizes: FloatArray, speed: float) -> FloatArray:
        # 4 X times the integral of f(X nu sin p) sin p over a quarter of the cycle, with a kink.
        tops = speed * sizes[..., np.newaxis]
        kink = np.arcsin(np.minimum(self._rate_of_kink / np.maximum(tops, 1e-300), 1.0))
        total = np.zeros(sizes.shape)
        for start, end in ((0 * kink, kink), (kink, pi / 2)):
            sines = np.sin(start + (end - start) * _NODES)
            total += ((end - start) * self.force(tops * sines) * sines) @ _WEIGHTS
        return 4 * sizes * total


@dataclass(frozen=True, kw_only=True, eq=False)
class FluidDamper(RateElement):
    """A fluid viscous damper f = c sign(v) abs(v)^a, v = d', on the deflection d = e . u.

    For a < 1 the slope of f is infinite at v = 0. Motions in time solve for the forces of such
    dampers in every step, so that they may start at rest and creep. Harmonics of a steady motion
    decay by a power; `truncation` estimates the error.

    Parameters
    ----------
    on : str, int, tuple of two str, mapping or array_like
        The direction e, as for `Spring`.
    coefficient : float
        c, greater than 0 (N (s/m)^a).
    exponent : float
        a, 0.1 to 2. Dampers of buildings: 0.15 to 0.5; linear: 1; flow through an orifice: 2.
    limit : float, optional
        F, the force at which a relief valve opens, greater than 0 (N): for larger rates
        abs(f) = F + s (abs(v) - (F/c)^(1/a)).
    relief : float
        s, the slope with the open valve, at least 0 (N s/m).

    Examples
    --------
    The energy of a cycle x = X sin(nu t) is 2 sqrt(pi) G(1 + a/2)/G(3/2 + a/2) c (X nu)^a X with
    the gamma function G (pi c nu X^2 for a = 1; Soong and Constantinou, Passive and Active
    Structural Vibration Control in Civil Engineering, 1994):

    >>> import viscovib as vv
    >>> damper = vv.FluidDamper(on="x1", coefficient=10, exponent=0.35)
    >>> damper.force([-1, 0, 2]).round(4).tolist()
    [-10.0, 0.0, 12.7456]
    >>> round(float(damper.energy(0.02, nu=9.42477796)), 6)
    0.404566
    >>> vv.FluidDamper(on="x1", coefficient=10, exponent=2, limit=40).force([1, 3]).tolist()
    [10.0, 40.0]
    """

    on: Any
    coefficient: float
    exponent: float = 1.0
    limit: float | None = None
    relief: float = 0.0

    def __post_init__(self) -> None:
        own_fields(self)
        _take(self, "coefficient", "exponent", "relief")
        _positive(self, "coefficient")
        if self.exponent == 0:
            raise InputError(
                "exponent = 0: is dry friction, must be 0.1 to 2: use a Jenkins element, or "
                "StribeckFriction"
            )
        _within(self, "exponent", *_EXPONENTS)
        if self.limit is not None:
            _take(self, "limit")
            _positive(self, "limit")
        if self.relief < 0:
            raise InputError(f"relief = {self.relief:g}: must be at least 0")
        if self.relief and self.limit is None:
            raise InputError(f"relief = {self.relief:g}: must be 0 without a limit")

    @property
    def _text(self) -> str:
        c, a = self.coefficient, self.exponent
        if self.limit is not None:
            return f"relief(v, {c!r}, {a!r}, {self.limit!r}, {self.relief!r})"
        return f"{c!r}*v" if a == 1 else f"{c!r}*sign(v)*abs(v)^{a!r}"

    @cached_property
    def _law(self) -> Law | None:
        linear = self.exponent == 1 and self.limit is None
        return None if linear else self._whole.remainder()

    @property
    def _rate_of_kink(self) -> float:
        """Rate at which the valve opens."""
        if self.limit is None:
            return 0.0
        with np.errstate(all="ignore"):
            return float((np.float64(self.limit) / self.coefficient) ** (1 / self.exponent))

    def _energy(self, sizes: FloatArray, speed: float) -> FloatArray:
        if self.limit is not None:
            return super()._energy(sizes, speed)
        a = self.exponent
        factor = 2 * sqrt(pi) * gamma(1 + a / 2) / gamma(1.5 + a / 2)
        return np.asarray(factor * self.coefficient * (sizes * speed) ** a * sizes)


@dataclass(frozen=True, kw_only=True, eq=False)
class StribeckFriction(RateElement):
    """Dry friction with a Stribeck curve, f = [F_c + (F_s - F_c) exp(-abs(v/v_s)^d)] sign(v).

    The force falls from the static force at rest to the Coulomb force, so that motions may stick
    and slip. In time the force is set-valued at v = 0 (Filippov) and steps end where the motion
    sticks. With ``width`` > 0, tanh(v/width) replaces sign(v); use it for steady motions by
    harmonics (Armstrong-Helouvry et al., Automatica 30, 1994).

    Parameters
    ----------
    on : str, int, tuple of two str, mapping or array_like
        The direction e of the deflection d = e . u, v = d', as for `Spring`.
    coulomb : float
        F_c, at least 0 (N).
    static : float
        F_s, greater than 0 and at least F_c (N).
    velocity : float
        v_s, the Stribeck velocity, greater than 0 (m/s).
    exponent : float
        d, 0.5 to 4.
    width : float
        Rate over which a regularized force changes its sign, at least 0 (m/s); 0: sign(v).

    Examples
    --------
    >>> import viscovib as vv
    >>> brake = vv.StribeckFriction(on="x1", coulomb=1, static=1.5, velocity=0.1)
    >>> brake.force([-1, 0, 0.1]).round(4).tolist()
    [-1.0, 0.0, 1.1839]
    >>> round(float(brake.energy(0.5, nu=10)), 4)
    2.0004
    """

    on: Any
    coulomb: float
    static: float
    velocity: float
    exponent: float = 1.0
    width: float = 0.0

    def __post_init__(self) -> None:
        own_fields(self)
        _take(self, "coulomb", "static", "velocity", "exponent", "width")
        _positive(self, "static", "velocity")
        for name in ("coulomb", "width"):
            if getattr(self, name) < 0:
                raise InputError(f"{name} = {getattr(self, name):g}: must be at least 0")
        if self.static < self.coulomb:
            raise InputError(
                f"static = {self.static:g}: must be at least coulomb, {self.coulomb:g}"
            )
        _within(self, "exponent", *_STRIBECK)

    @property
    def _text(self) -> str:
        numbers = (self.coulomb, self.static, self.velocity, self.exponent, self.width)
        return f"stribeck(v, {', '.join(map(repr, numbers))})"


def _take(element: Any, *names: str) -> None:
    for name in names:
        object.__setattr__(element, name, _native.number(name, getattr(element, name)))


def _positive(element: Any, *names: str) -> None:
    for name in names:
        if getattr(element, name) <= 0:
            raise InputError(f"{name} = {getattr(element, name):g}: must be greater than 0")


def _within(element: Any, name: str, low: float, high: float) -> None:
    value = getattr(element, name)
    if not low <= value <= high:
        raise InputError(f"{name} = {value:g}: must be {low:g} to {high:g}")
