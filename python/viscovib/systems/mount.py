"""The mount: a rigid body on viscoelastic supports, coordinates x (m) and phi (rad)."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.errors import InputError, StabilityWarning, caller
from viscovib.kernels.relaxation import Kernel, check_kernel
from viscovib.systems.characteristic import CharacteristicRoots, characteristic_roots
from viscovib.systems.normal_coordinates import NormalCoordinates
from viscovib.systems.system import System

GEOMETRIES = ("exact", "cubic", "printed")
_AS_X = -1
_NO_KERNEL = 0


@dataclass(frozen=True, kw_only=True, eq=False)
class Mount(System):
    """A rigid body on a spring in x, attached at the distance ``offset``, and a spring in phi.

    Parameters
    ----------
    mass, inertia : float
        m > 0 (kg) and I > 0 about the mass centre (kg m^2).
    offset : float
        l (m), from the mass centre to the supports: the spring in x has the deflection x - l
        sin(phi).
    stiffness_x, stiffness_phi : float
        c_x > 0 (N/m) and c_phi > 0 (N m).
    kernel : Kernel, optional
        Relaxation kernel of the spring in x; None: no memory.
    kernel_phi : Kernel or False, optional
        Relaxation kernel of the spring in phi; None: as ``kernel``; False: no memory.
    damping : array_like, shape (2, 2), optional
        Viscous damping matrix C in M u'' + C u' + ...; None: no damping.
    geometry : {"cubic", "exact", "printed"}
        "exact": full sine and cosine, memory on the deflection; "cubic": potential expanded to
        fourth order, memory on every term; "printed": as cubic with the signs and factors printed
        in the paper.
    cubic_scale, memory_scale : float
        epsilon and epsilon_1 of the paper: factors of the cubic terms and of every kernel; 0
        removes the terms and their cost.

    Warns
    -----
    StabilityWarning
        If the integral of a kernel (times ``memory_scale``) is not between 0 and 1.

    Examples
    --------
    >>> import viscovib as vv
    >>> rubber = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
    >>> mount = vv.Mount(
    ...     mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, kernel=rubber
    ... )
    >>> frequencies = mount.natural_frequencies()  # rad/s, without memory
    """

    mass: float
    inertia: float
    offset: float
    stiffness_x: float
    stiffness_phi: float
    kernel: Kernel | None = None
    kernel_phi: Kernel | bool | None = None
    damping: npt.ArrayLike | None = None
    geometry: str = "cubic"
    cubic_scale: float = 1.0
    memory_scale: float = 1.0

    dof_names: ClassVar[tuple[str, ...]] = ("x", "phi")
    dof_units: ClassVar[tuple[str, ...]] = ("m", "rad")
    rate_units: ClassVar[tuple[str, ...]] = ("m/s", "rad/s")
    time_unit: ClassVar[str] = "s"

    def __post_init__(self) -> None:
        for name in (
            "mass",
            "inertia",
            "offset",
            "stiffness_x",
            "stiffness_phi",
            "cubic_scale",
            "memory_scale",
        ):
            object.__setattr__(self, name, _native.number(name, getattr(self, name)))
        _native.choice("geometry", self.geometry, GEOMETRIES)
        damping = np.zeros((2, 2)) if self.damping is None else self.damping
        matrix = _native.real_array("damping", damping).copy()
        if matrix.shape != (2, 2):
            raise InputError(
                f"damping: must have shape (2, 2), got {matrix.shape}: a viscous damping matrix in "
                "x and phi, such as damping=[[c_x, 0], [0, c_phi]]"
            )
        matrix.setflags(write=False)
        object.__setattr__(self, "damping", matrix)
        check_kernel("kernel", self.kernel)
        if self.kernel_phi is not False:
            check_kernel("kernel_phi", self.kernel_phi, ", None or False")
        self.natural_frequencies()
        warn_of_creep(self.memory_scale * kernel.integral for kernel in self._active_kernels)

    @property
    def _kernel_scale(self) -> float:  # type: ignore[override]
        return self.memory_scale

    def natural_frequencies(self) -> FloatArray:
        """Undamped natural circular frequencies without memory (rad/s), ascending, shape (2,)."""
        return np.array(self._modes["omega"])

    def mode_shapes(self) -> FloatArray:
        """Mode shapes as columns (1, a_2j), shape (2, 2); unit vectors if offset is 0."""
        return np.array(self._modes["shapes"], order="C")

    def modes(self) -> NormalCoordinates:
        """Return the modes without memory and damping, with their normal coordinates."""
        shapes = self.mode_shapes()
        mass = np.array([self.mass, self.inertia])
        modal_mass = np.asarray(mass @ shapes**2)
        kernel = self.kernel
        in_phi = kernel if self.kernel_phi is None else self.kernel_phi
        kernel_phi = in_phi if isinstance(in_phi, Kernel) else None
        coupled = "" if kernel == kernel_phi else "the springs have different kernels"
        if np.asarray(self.damping).any():
            coupled = "there is damping"
        return NormalCoordinates(
            self.natural_frequencies(), shapes, modal_mass, mass, kernel, self.memory_scale, coupled
        )

    def characteristic_roots(self) -> CharacteristicRoots:
        """Roots of det[s^2 M + s C + sum_j K_j (1 - R_j(s))] = 0: decay and frequency.

        Without memory these are the pairs of the damped linear system. With memory they include
        slow real roots, positive if the integral of a kernel exceeds 1.
        """
        return characteristic_roots(self._handle, 2)

    def dynamic_stiffness(self, nu: npt.ArrayLike) -> ComplexArray:
        """D(nu), shape nu.shape + (2, 2), for u = Im(X exp(i nu t)).

        K_x (1 - R_x(nu)) + K_phi (1 - R_phi(nu)) + i nu C - nu^2 M.
        """
        return dynamic_stiffness(self, nu)

    @property
    def _flat(self) -> FloatArray:
        return np.array(
            [
                self.mass,
                self.inertia,
                self.offset,
                self.stiffness_x,
                self.stiffness_phi,
                *np.asarray(self.damping).ravel(order="F"),
                self.cubic_scale,
                self.memory_scale,
                GEOMETRIES.index(self.geometry) + 1,
            ]
        )

    @property
    def _masses(self) -> slice:
        """Indices of the masses in `_flat`."""
        return slice(0, 2)

    @property
    def _kernels(self) -> tuple[int, FloatArray, int, FloatArray]:
        nothing = np.zeros(1)
        in_x = self.kernel
        kind_x, data_x = (in_x._kind, in_x._data) if in_x else (_NO_KERNEL, nothing)
        if isinstance(self.kernel_phi, Kernel):
            return kind_x, data_x, self.kernel_phi._kind, self.kernel_phi._data
        return kind_x, data_x, _AS_X if self.kernel_phi is None else _NO_KERNEL, nothing

    @cached_property
    def _handle(self) -> _native.Handle:
        """The system in the core."""
        return _native.oscillator_object(self._flat, self._kernels)

    @cached_property
    def _modes(self) -> dict[str, Any]:
        """Natural frequencies and mode shapes."""
        return _native.run("system modes", self._handle)

    @cached_property
    def _active_kernels(self) -> tuple[Kernel, ...]:
        if self.memory_scale == 0:
            return ()
        return tuple(k for k in (self.kernel, self.kernel_phi) if isinstance(k, Kernel))

    @property
    def _parameter_names(self) -> tuple[str, ...]:
        return tuple(f.name for f in fields(self) if isinstance(getattr(self, f.name), float))

    def _with_parameters(self, numbers: Mapping[str, float]) -> Mount:
        changes: dict[str, Any] = dict(numbers)
        return replace(self, **changes)

    @property
    def _mass_matrix(self) -> FloatArray:
        return np.diag([self.mass, self.inertia])

    @property
    def _base_direction(self) -> FloatArray:
        return np.array([1.0, 0.0])


def dynamic_stiffness(system: Any, nu: npt.ArrayLike) -> ComplexArray:
    """Return D(nu) of an oscillator at frequencies at which all kernels have a transform."""
    frequencies, kernels = _native.real_array("nu", nu), system._active_kernels
    for kernel in kernels:
        if frequencies.size and (frequencies == 0).any() and math.isinf(kernel.integral):
            raise InputError("nu = 0: a kernel has no integral, nu must not be 0")
    seconds = 1e-6 + sum(kernel._seconds for kernel in kernels)
    found: ComplexArray = _native.run_in_parts(
        "system dynamic_stiffness", system._handle, seconds, nu=frequencies.ravel()
    )["stiffness"]
    found = np.moveaxis(found, 2, 0).reshape(*frequencies.shape, *found.shape[:2])
    _native.check_range("nu", frequencies, found, "the dynamic stiffness")
    return found


def warn_of_creep(integrals: Iterable[float]) -> None:
    """Warn of kernels whose integrals (with their scales) are not between 0 and 1."""
    for total in integrals:
        if total >= 1 or total < 0:
            text = _native.run("kernel doubt", total=float(total))["text"]
            warnings.warn(text, StabilityWarning, stacklevel=caller())
