"""Free motion with memory: roots of the characteristic equation det D(s) = 0."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.common.values import Value
from viscovib.errors import ConvergenceWarning, caller

#: Coordinates up to which the roots take a few milliseconds.
_FEW = 4


@dataclass(frozen=True, eq=False, repr=False)
class CharacteristicRoots(Value):
    """Roots s of free linear motion, a sum of exp(s t).

    Attributes
    ----------
    oscillatory : complex ndarray, shape (n,)
        Roots s with positive imaginary part (1/s), by increasing frequency, a double root twice.
        Their conjugates are roots too.
    real : ndarray, shape (m,)
        Real roots, largest first: without memory all; for Koltunov-Rzhanitsyn kernels those to the
        right of the branch cut at -beta, for other kernels the positive ones.
    n_unstable : int
        Number of roots with positive real part, including conjugates, by the argument principle.
        If rounding errors hide it: the number of those listed, ``complete`` is False.
    complete : bool
        True if all roots in ``region`` are listed, by the argument principle on its boundary.
    region : str
        The part of the complex plane to which ``complete`` refers.

    Examples
    --------
    >>> import viscovib as vv
    >>> rubber = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
    >>> mount = vv.Mount(
    ...     mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, kernel=rubber
    ... )
    >>> roots = mount.characteristic_roots()
    >>> roots.complete
    True
    """

    oscillatory: ComplexArray
    real: FloatArray
    n_unstable: int
    complete: bool
    region: str = ""

    @property
    def growth_rate(self) -> float:
        """Largest real part of the roots (1/s); free motion grows if it is positive."""
        return float(max([*self.oscillatory.real, *self.real], default=-np.inf))

    @property
    def logarithmic_decrement(self) -> FloatArray:
        """-2 pi Re s/Im s of the oscillatory roots."""
        result: FloatArray = -2 * np.pi * self.oscillatory.real / self.oscillatory.imag
        return result


def characteristic_roots(system: _native.Handle, n_dof: int) -> CharacteristicRoots:
    """Roots of the characteristic equation of an oscillator of the core."""
    found = _native.run_either(n_dof > _FEW, "system roots", system)
    missing = found["n_missing"]
    message = ""
    if missing:
        message = f"the argument principle gives {missing:+d} oscillatory roots with a damping "
        message += "ratio below 0.999 to those listed"
    if not found["is_counted"]:
        message = "roots may be missing: rounding errors of det D hide their number (a root near "
        message += "0, or terms of D that differ by too many orders of magnitude)"
    if message:
        warnings.warn(message, ConvergenceWarning, stacklevel=caller())
    return CharacteristicRoots(
        found["oscillatory"], found["real"], found["n_unstable"], bool(found["complete"]),
        found["region"],
    )  # fmt: skip
