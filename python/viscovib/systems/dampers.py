"""Dampers of a structure whose force is a power of the rate."""

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
from viscovib.systems.laws import Law, read_law

#: Bounds of the exponent.
_EXPONENTS = (0.1, 2.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class FluidDamper:
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
    """

    on: Any
    coefficient: float
    exponent: float = 1.0

    def __post_init__(self) -> None:
        own_fields(self)
        for name in ("coefficient", "exponent"):
            object.__setattr__(self, name, _native.number(name, getattr(self, name)))
        if self.coefficient <= 0:
            raise InputError(f"coefficient = {self.coefficient:g}: must be greater than 0")
        if self.exponent == 0:
            raise InputError(
                "exponent = 0: is dry friction, must be 0.1 to 2: use a Jenkins element, or a "
                "Spring with the law 'F*sign(v)'"
            )
        if not _EXPONENTS[0] <= self.exponent <= _EXPONENTS[1]:
            raise InputError(f"exponent = {self.exponent:g}: must be 0.1 to 2")

    @property
    def _damping(self) -> float:
        """The coefficient of a linear damper; else 0."""
        return self.coefficient if self.exponent == 1 else 0.0

    @cached_property
    def _law(self) -> Law | None:
        """The force as a law; None for a linear damper."""
        if self.exponent == 1:
            return None
        values = {"c": self.coefficient, "a": self.exponent}
        law = read_law("law", "c*sign(v)*abs(v)^a", ("d",), values, ("v",))
        assert isinstance(law, Law)
        return law

    def force(self, v: npt.ArrayLike) -> FloatArray:
        """Return f at rates of any shape (N)."""
        rates = _native.real_array("v", v)
        return np.asarray(self.coefficient * np.sign(rates) * np.abs(rates) ** self.exponent)

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
        a = self.exponent
        factor = 2 * sqrt(pi) * gamma(1 + a / 2) / gamma(1.5 + a / 2)
        return np.asarray(factor * self.coefficient * (sizes * speed) ** a * sizes)
