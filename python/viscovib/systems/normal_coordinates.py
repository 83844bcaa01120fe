"""Normal coordinates of a mount, equations (7) and (8) of its paper."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.errors import InputError
from viscovib.kernels.relaxation import Kernel


@dataclass(frozen=True, eq=False)
class NormalCoordinates:
    """Normal coordinates f of a `Mount`: u = shapes f.

    If both springs have the same kernel R and ``damping`` is 0, the linear equations are

        f_j'' + omega_j^2 (1 - R*) f_j = F_j,   F_j = shapes_j . P / modal_mass_j.

    Attributes
    ----------
    omega : ndarray, shape (2,)
        Natural frequencies without memory (rad/s).
    shapes : ndarray, shape (2, 2)
        Mode shapes (1, a_2j) as columns.
    modal_mass : ndarray, shape (2,)
        shapes_j . M shapes_j.

    Examples
    --------
    >>> import viscovib as vv
    >>> mount = vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2)
    >>> modes = mount.modes()
    >>> f = modes.normal([0.1, 0.2])
    >>> print(*modes.physical(f).round(12))
    0.1 0.2
    """

    omega: FloatArray
    shapes: FloatArray
    modal_mass: FloatArray
    _mass: FloatArray
    #: The kernel of both springs with its scale, or the reason why the equations are coupled.
    _kernel: Kernel | None
    _scale: float
    _coupled: str

    def normal(self, u: npt.ArrayLike) -> npt.NDArray[np.generic]:
        """Return f of coordinates (x, phi), real or complex, shape (..., 2)."""
        return np.asarray((_pairs("u", u) * self._mass) @ self.shapes / self.modal_mass)

    def physical(self, f: npt.ArrayLike) -> npt.NDArray[np.generic]:
        """Return (x, phi) of normal coordinates, shape (..., 2)."""
        return np.asarray(_pairs("f", f) @ self.shapes.T)

    def force(self, load: npt.ArrayLike) -> npt.NDArray[np.generic]:
        """Return F_j of a force and a moment, shape (..., 2) (m/s^2)."""
        return np.asarray(_pairs("load", load) @ self.shapes / self.modal_mass)

    def dynamic_stiffness(self, nu: npt.ArrayLike) -> ComplexArray:
        """Return omega_j^2 (1 - R(nu)) - nu^2, shape nu.shape + (2,), of decoupled equations."""
        if self._coupled:
            raise InputError(
                f"dynamic_stiffness: {self._coupled}, so the normal coordinates are coupled; use "
                "mount.dynamic_stiffness(nu)"
            )
        frequencies = _native.real_array("nu", nu)
        kept = np.ones(frequencies.shape, dtype=complex)
        if self._kernel is not None:
            kept = 1 - self._scale * np.asarray(self._kernel.transform(frequencies))
        return np.asarray(kept[..., np.newaxis] * self.omega**2 - frequencies[..., np.newaxis] ** 2)


def _pairs(name: str, value: npt.ArrayLike) -> ComplexArray | FloatArray:
    array = _native.any_array(name, value)
    checked = (_native.complex_array if array.dtype.kind == "c" else _native.real_array)(
        name, value
    )
    if checked.shape[-1:] != (2,):
        raise InputError(f"{name}: must have shape (..., 2), got {checked.shape}")
    return checked
