"""The spring pendulum: a rigid body on a nonlinear spring, dimensionless."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.parameters import Number, checked
from viscovib.errors import InputError
from viscovib.systems.system import System

EQUATIONS = ("exact", "cubic", "printed")
#: Parameters of a pendulum, in the order of the core.
PARAMETERS = (
    "e", "w2", "w3", "alpha", "c1", "c2", "c3", "f0", "m01", "m02", "p1", "p2", "p3",
)  # fmt: skip

#: Largest evaluation time of the equations per state (s).
_SECONDS = 1e-6
#: Arguments of `Pendulum.from_physical` in their order; E > 0, else the body would not swing.
_PHYSICAL = (
    *(Number(name, above=0) for name in ("m", "I_A", "E", "L0", "k1")),
    Number("k2", lowest=0),
    *map(Number, ("C1", "C2", "C3")),
    Number("g", above=0),
    *map(Number, ("F1", "M2", "M3", "Omega1", "Omega2", "Omega3")),
)


@dataclass(frozen=True)
class Scales:
    """Physical size of one dimensionless unit: time (s) and length (m)."""

    time: float
    length: float


@dataclass(frozen=True, kw_only=True)
class Pendulum(System):
    """A rigid body that hangs on a spring and damper, three degrees of freedom.

    The dimensionless time is tau = omega_1 t with omega_1 = sqrt(k_1/m). A state is (z, z', phi,
    phi', psi, psi'): z is the extension beyond the static one divided by L, phi the angle of the
    spring, psi the angle of the body (rad).

    Parameters
    ----------
    e : float
        E/L >= 0, distance from the spring to the mass centre; e w3^2/w2^2 < 1.
    w2, w3 : float
        Frequencies over omega_1, > 0.
    alpha : float
        k_2 L^2/k_1 >= 0, cubic stiffness of the spring.
    c1, c2, c3 : float
        Viscous damping of z, phi, psi.
    f0, m01, m02, p1, p2, p3 : float
        Loads f0 cos(p1 tau) on z, m01 cos(p2 tau) on phi, m02 cos(p3 tau) on psi.
    equations : {"exact", "cubic", "printed"}
        "cubic": expanded to third order; "printed": as printed in the paper.
    scales : Scales, optional
        Physical units, set by `from_physical`, to convert results back.

    Examples
    --------
    >>> import viscovib as vv
    >>> body = vv.Pendulum(
    ...     e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01, f0=0.002, p1=1.02
    ... )
    >>> frequencies = body.natural_frequencies()
    >>> run = vv.simulate(body, 20, initial=[0.05, 0, 0.1, 0, 0, 0])
    """

    e: float
    w2: float
    w3: float
    alpha: float = 0.0
    c1: float = 0.0
    c2: float = 0.0
    c3: float = 0.0
    f0: float = 0.0
    m01: float = 0.0
    m02: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    p3: float = 0.0
    equations: str = "exact"
    scales: Scales | None = None

    dof_names: ClassVar[tuple[str, ...]] = ("z", "phi", "psi")
    dof_units: ClassVar[tuple[str, ...]] = ("L", "rad", "rad")
    rate_units: ClassVar[tuple[str, ...]] = ("L omega_1", "rad omega_1", "rad omega_1")
    time_unit: ClassVar[str] = "1/omega_1"
    #: The parameters as a vector for the core.
    _flat: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name in PARAMETERS:
            object.__setattr__(self, name, _native.number(name, getattr(self, name)))
        if not isinstance(self.scales, (Scales, type(None))):
            raise InputError(f"scales = {_native.shown(self.scales)}: must be Scales or None")
        _native.choice("equations", self.equations, EQUATIONS)
        numbers = [getattr(self, name) for name in PARAMETERS]
        flat = np.array([*numbers, EQUATIONS.index(self.equations) + 1])
        flat.flags.writeable = False
        object.__setattr__(self, "_flat", flat)
        # Check the numbers.
        _ = self._handle

    _has_own_loads = True

    def _fastest(self) -> float:
        """The fastest natural frequency, or the fastest load."""
        return max(super()._fastest(), self.p1, self.p2, self.p3)

    @property
    def _parameter_names(self) -> tuple[str, ...]:
        return PARAMETERS

    def _with_parameters(self, numbers: Mapping[str, float]) -> Pendulum:
        changes: dict[str, Any] = dict(numbers)
        return replace(self, **changes)

    @cached_property
    def _handle(self) -> _native.Handle:
        """The pendulum in the core."""
        return _native.Handle("system pendulum", flat=self._flat)

    @cached_property
    def _modes(self) -> dict[str, Any]:
        """Natural frequencies, mode shapes, r and z_r."""
        return _native.run("system pendulum_modes", self._handle)

    @classmethod
    def from_physical(
        cls,
        *,
        m: float,
        I_A: float,
        E: float,
        L0: float,
        k1: float,
        k2: float = 0.0,
        C1: float = 0.0,
        C2: float = 0.0,
        C3: float = 0.0,
        g: float = 9.81,
        F1: float = 0.0,
        M2: float = 0.0,
        M3: float = 0.0,
        Omega1: float = 0.0,
        Omega2: float = 0.0,
        Omega3: float = 0.0,
        equations: str = "exact",
    ) -> Pendulum:
        """Create a pendulum from physical units (kg, m, s, N).

        m, I_A: mass and moment of inertia about the end of the spring; E: distance from there to
        the mass centre; L0: free length; k1 (N/m), k2 (N/m^3); C1 (N s/m), C2, C3 (N m s); loads F1
        (N), M2, M3 (N m) at Omega1..3 (rad/s). The unit of length is L = L0 + Z_r with the static
        elongation k1 Z_r + k2 Z_r^3 = m g.
        """
        m, I_A, E, L0, k1, k2, C1, C2, C3, g, F1, M2, M3, Omega1, Omega2, Omega3 = checked(
            _PHYSICAL, locals()
        ).values()
        try:
            return cls._scaled(
                m, I_A, E, L0, k1, k2, (C1, C2, C3), g, (F1, M2, M3), (Omega1, Omega2, Omega3),
                equations,
            )  # fmt: skip
        except (OverflowError, ZeroDivisionError):
            raise InputError(
                "m, I_A, E, L0, k1, k2, g, ...: are too far apart, the dimensionless numbers "
                "must be in the range of numbers"
            ) from None

    @classmethod
    def _scaled(
        cls,
        m: float,
        I_A: float,
        E: float,
        L0: float,
        k1: float,
        k2: float,
        damping: tuple[float, float, float],
        g: float,
        loads: tuple[float, float, float],
        frequencies: tuple[float, float, float],
        equations: str,
    ) -> Pendulum:
        (C1, C2, C3), (F1, M2, M3), (Omega1, Omega2, Omega3) = damping, loads, frequencies
        # Z_r of k1 Z + k2 Z^3 = m g without cancellation.
        ratio, weight = k2 / k1, m * g / k1
        scale = math.sqrt(3 * ratio)
        elongation = (
            2 / scale * math.sinh(math.asinh(1.5 * scale * weight) / 3)
            if scale * weight > 1e-8
            else weight * (1 - ratio * weight**2)
        )
        length = L0 + elongation
        omega = math.sqrt(k1 / m)
        numbers = {
            "e": E / length,
            "w2": math.sqrt(g / length) / omega,
            "w3": math.sqrt(m * g * E / I_A) / omega,
            "alpha": ratio * length**2,
            "c1": C1 / (m * omega),
            "c2": C2 / (m * length**2 * omega),
            "c3": C3 / (I_A * omega),
            "f0": F1 / (m * length * omega**2),
            "m01": M2 / (m * length**2 * omega**2),
            "m02": M3 / (I_A * omega**2),
            "p1": Omega1 / omega,
            "p2": Omega2 / omega,
            "p3": Omega3 / omega,
        }
        if not all(map(math.isfinite, numbers.values())):
            raise OverflowError
        return cls(**numbers, equations=equations, scales=Scales(time=1 / omega, length=length))

    @property
    def r(self) -> float:
        """w3^2/w2^2 = m E L/I_A."""
        return float(self._modes["r"])

    @property
    def z_r(self) -> float:
        """Static elongation, the real root of alpha z^3 + z = w2^2."""
        return float(self._modes["z_r"])

    def natural_frequencies(self) -> FloatArray:
        """Linear undamped frequencies divided by omega_1, shape (3,): z, then swinging modes."""
        return np.array(self._modes["omega"])

    def mode_shapes(self) -> FloatArray:
        """Mode shapes as columns in (z, phi, psi), largest entry 1, shape (3, 3)."""
        return np.array(self._modes["shapes"], order="C")

    def rhs(self, t: npt.ArrayLike, state: npt.ArrayLike) -> FloatArray:
        """Time derivative of states, shape (..., 6), at times t (scalar or shape (...))."""
        states = self._states(state)
        acceleration, _, _ = self._evaluate(t, states)
        _native.check_states(states, acceleration, "the acceleration")
        derivative = np.empty_like(states)
        derivative[..., ::2] = states[..., 1::2]
        derivative[..., 1::2] = acceleration
        return derivative

    def jacobian(self, t: npt.ArrayLike, state: npt.ArrayLike) -> FloatArray:
        """Derivative of `rhs` with respect to the state, shape (..., 6, 6)."""
        states = self._states(state)
        result = np.zeros((*states.shape, 6))
        of_accelerations = _native.run_in_parts(
            "system pendulum_jacobian", self._handle, _SECONDS, drive=self._drives(t, states),
            state=states.reshape(-1, 6).T,
        )["jacobian"]  # fmt: skip
        found = np.moveaxis(of_accelerations, 2, 0).reshape(*states.shape[:-1], 3, 6)
        _native.check_states(states, found, "the Jacobian matrix")
        result[..., 0, 1] = result[..., 2, 3] = result[..., 4, 5] = 1
        result[..., 1::2, :] = of_accelerations.transpose(2, 0, 1).reshape(*states.shape[:-1], 3, 6)
        return result

    def energy(self, state: npt.ArrayLike) -> FloatArray:
        """Energy divided by m L^2 omega_1^2, shape (...): constant without loads and damping."""
        states = self._states(state)
        result: FloatArray = self._evaluate(0.0, states)[1][()]
        _native.check_states(states, np.asarray(result), "the energy")
        return result

    def power(self, t: npt.ArrayLike, state: npt.ArrayLike) -> FloatArray:
        """Rate of change of the energy: work of the loads minus dissipation, shape (...)."""
        states = self._states(state)
        result: FloatArray = self._evaluate(t, states)[2][()]
        _native.check_states(states, np.asarray(result), "the power")
        return result

    def _states(self, state: npt.ArrayLike) -> FloatArray:
        states = _native.real_array("state", state)
        if states.ndim < 1 or states.shape[-1] != 6:
            raise InputError(f"state: must have shape (..., 6), got {states.shape}")
        if not states.size:
            raise InputError(f"state: has no states, its shape is {states.shape}")
        return states

    def _evaluate(
        self, t: npt.ArrayLike, states: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        found = _native.run_in_parts(
            "system pendulum_motion", self._handle, _SECONDS, drive=self._drives(t, states),
            state=states.reshape(-1, 6).T,
        )  # fmt: skip
        shape = states.shape[:-1]
        return (
            found["acceleration"].T.reshape(*shape, 3),
            found["energy"].reshape(shape),
            found["power"].reshape(shape),
        )

    def _drives(self, t: npt.ArrayLike, states: FloatArray) -> FloatArray:
        """cos(p_j t) at the time of each state, shape (3, n)."""
        times = _native.real_array("t", t)
        if times.ndim and times.shape != states.shape[:-1]:
            raise InputError(
                f"t: must be one number or have shape {states.shape[:-1]}, got {times.shape}"
            )
        times = np.broadcast_to(times, states.shape[:-1])
        with np.errstate(over="ignore", invalid="ignore"):
            phases = np.outer([self.p1, self.p2, self.p3], times.ravel())
            if not np.isfinite(phases).all():
                raise InputError(
                    f"t = {times.ravel()[np.abs(times).argmax()]:g}: the phases of the loads "
                    "exceed the range of numbers, must be smaller"
                )
        return np.asfortranarray(np.cos(phases))
