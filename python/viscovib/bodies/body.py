"""A rigid body in space on mounts at any position: six coordinates."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.bodies.checks import (
    NAMES,
    checked_direction,
    checked_gravity,
    checked_inertia,
    checked_mounts,
    checked_vector,
)
from viscovib.bodies.forces import MountForces, mount_forces
from viscovib.bodies.linear_body import LinearBody
from viscovib.bodies.mount_point import MountPoint, crossing
from viscovib.bodies.springs import (
    condensed_springs,
    mount_springs,
    spring_groups,
)
from viscovib.bodies.statics import Sag, settled
from viscovib.bodies.turning import (
    BODY_IN_VECTOR,
    angular_momentum,
    further_moved,
    placed_vector,
    turning_energy,
    turning_vector,
)
from viscovib.bodies.varying_body import numbers_of_body, rebuilt, with_numbers
from viscovib.common.counts import things
from viscovib.common.values import own
from viscovib.errors import InputError, StabilityWarning, caller
from viscovib.systems.condensed import Condensation
from viscovib.systems.laws import Law
from viscovib.systems.load import LoadLike, base_shifts, oscillator_series
from viscovib.systems.oscillators import check_oscillator

_UNITS = ("m", "m", "m", "rad", "rad", "rad")
_GEOMETRIES = ("small", "exact")
_LOAD_AXES = ("body", "space")


class Body(LinearBody):
    """A rigid body on mounts, each with its own kernel and force law.

    The coordinates are the displacement x, y, z (m) of the mass centre and the rotation rx, ry, rz
    (rad) about it, both small. With the point p of a mount and its rotation R (local to body axes)
    its deflections are d = R^T (u + theta x p), and

        M u'' + sum_j e_j {(1 - R_j*) [k_j d_j + g_j(d_j)] + c_j d_j'} = load(t),  d_j = e_j . u,

    over all directions j of all mounts. This is a `PolynomialSystem`, and every method works for
    it. The floor is at rest or moves: along ``base_direction`` by ``base=``, in all six components
    with their own amplitudes, ``base={"x": 1e-3, "rx": 2e-4j}``, or in time by a `LoadTable` with
    six columns. Rotations of the floor are small, about the mass centre at rest. The weight keeps
    its direction. Responses are absolute.

    Parameters
    ----------
    mass : float
        Mass of the body (kg).
    inertia : array_like, shape (3, 3) or (3,)
        Inertia tensor about the mass centre in body axes (kg m^2), with tensor signs (J_xy = -sum m
        x y), or its diagonal.
    mounts : sequence of MountPoint
        Empty: a free body.
    center : array_like, shape (3,), optional
        Mass centre (m), in the axes of the mounts' positions.
    gravity : float or array_like, shape (3,), optional
        Acceleration (m/s^2); a number acts along -z. The body then has a static deflection: relaxed
        mounts have the stiffness k_j (1 - integral of R_j), coordinates are relative to the loaded
        position, laws are expanded about it, and the preload adds its geometric stiffness, which
        has no memory. None: no gravity. Preloads of the mounts' laws have the same effect.
    geometry : str, optional
        "small": rotations are small, the mounts are nonlinear. "exact": rotations are finite, and
        rx, ry, rz are the rotation vector, the angle (below 2 pi) times the unit vector of the
        axis; all inertia terms are included. After a step that ends beyond 3.5 rad a rotating body
        uses the equivalent vector theta (1 - 2 pi/|theta|). Mounts act along directions fixed in
        the floor, d = e . (u + R p - p). A rotational stiffness acts on the rotation vector: such a
        body keeps its vector, whose angle stays below 2 pi (near it small steps are needed).
        Motions in time and periodic motions are available; modes and linear results refer to small
        motions.
    load_axes : str, optional
        With ``geometry="exact"``: "body": forces and torques rotate with the body, such as the
        torque of an engine; "space": they keep their directions (such a torque has no potential).
    base_direction : str or array_like, shape (6,), optional
        Motion of the floor: "x", ..., "rz" (about the mass centre), or a combination.
    spin : array_like, shape (3,), optional
        Angular momentum h (kg m^2/s) in body axes of rotors with steady spin, such as a flywheel.
        Their mass and inertia are part of the body. It adds the gyroscopic torque h x omega, J
        omega' + omega x (J omega + h) = ... (Goldstein, Classical Mechanics, 5.5), J theta'' - h x
        theta' = ... for small rotations. The modes are complex: see `characteristic_roots`.
    rotor : array_like, shape (3,), optional
        Polar moment of inertia (kg m^2) times the axis in body axes, of a rotor whose speed is the
        frequency nu of the load: h = spin + nu rotor. With ``geometry="small"`` only. `at_speed`
        returns the body at a constant speed, `campbell` its modes over the speed.

    Warns
    -----
    StabilityWarning
        If a kernel's integral is not between 0 and 1, if the loaded position is unstable, or if
        positions, angles, inertia or stiffnesses look like numbers in mm, degrees, kg mm^2 or N/mm.

    Examples
    --------
    >>> import viscovib as vv
    >>> from viscovib.units import hz
    >>> feet = [
    ...     vv.MountPoint(name=f"foot{i}", position=(x, y, -0.1), stiffness=(2e5, 2e5, 4e5))
    ...     for i, (x, y) in enumerate([(0.3, 0.2), (0.3, -0.2), (-0.3, 0.2), (-0.3, -0.2)])
    ... ]
    >>> pump = vv.Body(mass=80, inertia=(2.0, 3.0, 3.5), mounts=feet)
    >>> [round(float(f), 2) for f in pump.modes().hz]
    [14.71, 15.39, 22.51, 27.43, 30.8, 36.05]
    """

    def __init__(
        self,
        *,
        mass: float,
        inertia: npt.ArrayLike,
        mounts: Sequence[MountPoint],
        center: npt.ArrayLike = (0.0, 0.0, 0.0),
        gravity: float | npt.ArrayLike | None = None,
        geometry: str = "small",
        load_axes: str = "body",
        base_direction: str | npt.ArrayLike | None = None,
        spin: npt.ArrayLike = (0.0, 0.0, 0.0),
        rotor: npt.ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        keep = object.__setattr__
        keep(self, "body_mass", _native.number("mass", mass))
        if not self.body_mass > 0:
            raise InputError(f"mass = {self.body_mass:g}: must be greater than 0")
        keep(self, "inertia", own(checked_inertia(inertia)))
        keep(self, "mounts", checked_mounts(mounts))
        keep(self, "center", own(checked_vector("center", center)))
        keep(self, "geometry", _native.choice("geometry", geometry, _GEOMETRIES))
        keep(self, "load_axes", _native.choice("load_axes", load_axes, _LOAD_AXES))
        keep(self, "gravity", own(checked_gravity(gravity)))
        if self.gravity is not None and not self.mounts:
            raise InputError(
                "gravity: must be None, because a free body has no static equilibrium; give "
                "the weight as a load"
            )
        keep(self, "spin", own(checked_vector("spin", spin)))
        keep(self, "rotor", own(checked_vector("rotor", rotor)))
        springs = mount_springs(self.mounts, self.center)
        matrix = springs.mass_of_tracks
        matrix[:3, :3] = self.body_mass * np.eye(3)
        matrix[3:6, 3:6] = self.inertia
        n = matrix.shape[0]
        preload = np.zeros((n, n))
        sag, springs, preload[3:6, 3:6], matrix[3:6, 3:6] = settled(
            springs, matrix, self.mounts, self.gravity, turns=self._turns
        )
        keep(self, "_sag", sag)
        keep(self, "_mount_springs", springs)
        direction = None if base_direction is None else checked_direction(base_direction, n)
        self._check_geometry(direction)
        damping = np.array(springs.damping_matrix)
        damping[3:6, 3:6] -= crossing(self._loaded_axes @ self.spin)
        gyroscopic = np.zeros((n, n))
        gyroscopic[3:6, 3:6] = -crossing(self._loaded_axes @ self.rotor)
        names = (*NAMES, *(f"{mount.name}_y" for mount in self.mounts if mount.track))
        first, *others = spring_groups(springs, preload, names)
        super().__init__(
            mass=matrix,
            stiffness=first.stiffness,
            forces=first.forces,
            damping=damping,
            springs=others,
            names=names,
            units=(*_UNITS, *("m" for _ in names[6:])),
            base_direction=direction,
            gyroscopic=gyroscopic if self.rotor.any() else None,
        )
        self._warn_of_instability()

    def at_speed(self, speed: float) -> Self:
        """Return the body with a steady rotor: that at a speed (rad/s)."""
        if not self.rotor.any():
            raise InputError("speed: has no effect without rotor")
        at = _native.number("speed", speed)
        with warnings.catch_warnings():
            # The given body has already issued these warnings.
            warnings.simplefilter("ignore")
            found: Any = rebuilt(self, spin=self.spin + at * self.rotor, rotor=np.zeros(3))
        turned: Self = found
        return turned

    def _check_geometry(self, direction: FloatArray | None) -> None:
        if self.geometry == "small":
            self._check_rotor("base_direction", np.zeros(6) if direction is None else direction)
            return
        if self.rotor.any():
            raise InputError(
                "rotor: must be 0 with geometry = 'exact': give spin, the angular momentum"
            )
        for mount in self.mounts:
            if any(isinstance(law, Law) and max(law.places, default=0) for law in mount.laws):
                raise InputError(
                    f"{mount.name}: law: must not depend on the rate v with geometry = 'exact'"
                )
        if direction is not None:
            self._check_floor("base_direction", direction)

    def _check_floor(self, name: str, moved: npt.NDArray[Any]) -> None:
        """Refuse motions of the floor, shape (n, ...), that finite rotations do not support."""
        if not self._turns:
            return
        if moved[3:6].any():
            raise InputError(
                f"{name}: must not turn the floor with geometry = 'exact', give x, y or z"
            )
        if self.load_axes == "body":
            raise InputError(
                "load_axes = 'body': must be 'space' where the floor moves with geometry = 'exact'"
            )

    def _check_base_motion(self, moved: npt.NDArray[Any]) -> None:
        self._check_rotor("base", moved)
        self._check_floor("base", moved)

    @property
    def _base_names(self) -> tuple[str, ...]:
        return NAMES

    @cached_property
    def _space(self) -> tuple[FloatArray, FloatArray] | None:
        """Weight and rotors keep their directions if the floor rotates."""
        if self._turns or not (self.spin.any() or self.gravity is not None):
            return None
        damping, stiffness = np.zeros((2, *self._mass_matrix.shape))
        damping[3:6, 3:6] = -crossing(self.spin)
        if self.gravity is not None:
            stiffness[:3, 3:6] = -crossing(self.body_mass * self.gravity)
        return damping, stiffness

    @property
    def _turns(self) -> bool:
        return self.geometry == "exact"

    @property
    def _scales(self) -> tuple[str, ...]:
        return ()

    @property
    def _parameter_names(self) -> tuple[str, ...]:
        return numbers_of_body(self)

    def _with_parameters(self, numbers: Mapping[str, float]) -> LinearBody:
        return with_numbers(self, numbers)

    @property
    def _flat(self) -> FloatArray:
        return self._turning_vector if self._turns else self._vector

    @property
    def _masses(self) -> slice:
        return slice(7, 7 + len(self.dof_names) ** 2) if self._turns else super()._masses

    @cached_property
    def _turning_vector(self) -> FloatArray:
        return turning_vector(
            self._mass_matrix, self._damping, self._base_direction, self._mount_springs,
            self._active_kernels, self._loaded_axes @ self.spin,
            loads_turn=self.load_axes == "body",
        )  # fmt: skip

    @cached_property
    def _placed(self) -> FloatArray:
        """The body at its static equilibrium as of `mounted_from_vector`."""
        return placed_vector(self._mass_matrix, self._mount_springs)

    @property
    def _kernels(self) -> tuple[int, FloatArray, int, FloatArray]:
        nothing = np.zeros(1)
        return (BODY_IN_VECTOR, nothing, 0, nothing) if self._turns else super()._kernels

    def energy(self, state: npt.ArrayLike) -> FloatArray:
        """Kinetic and potential energy at states (u_1, u_1', u_2, ...), shape (..., 2 n).

        For mounts without memory and damping with polynomial laws; with ``geometry="exact"`` it is
        1/2 m x'^2 + 1/2 omega . J omega plus the energy of the springs.
        """
        if not self._turns:
            return super().energy(state)
        return turning_energy(self._mass_matrix, self._mount_springs, self._states(state))

    def angular_momentum(self, state: npt.ArrayLike) -> FloatArray:
        """Angular momentum about the mass centre in space axes (kg m^2/s), shape (..., 3).

        R (J omega + h) at states (u_1, u_1', u_2, ...), shape (..., 2 n); J theta' + h + theta x h
        for small rotations, with h of the rotors.
        """
        self._turned()
        states = self._states(state)
        inertia = self._mass_matrix[3:6, 3:6]
        if not self._turns:
            turning = states[..., 7:12:2] @ inertia
            return np.asarray(turning + self.spin + np.cross(states[..., 6:12:2], self.spin))
        return angular_momentum(inertia, self._loaded_axes @ self.spin, states)

    def _states(self, state: npt.ArrayLike) -> FloatArray:
        states = _native.real_array("state", state)
        n = len(self.dof_names)
        if states.shape[-1:] != (2 * n,):
            raise InputError(f"state: must have shape (..., {2 * n}), got {states.shape}")
        return states

    @cached_property
    def _condensation(self) -> Condensation | None:
        if self._turns or self.spin.any() or self.rotor.any():
            return None
        return condensed_springs(
            self._mount_springs, self._mass_matrix, self._damping, self._stiffness_at_rest
        )

    def __repr__(self) -> str:
        """Return a description in a few lines."""
        lines = [f"<Body: {self.body_mass:g} kg on {things(len(self.mounts), 'mount')}"]
        for mount in self.mounts:
            place = " ".join(f"{p:g}" for p in np.asarray(mount.position))
            stiffness = " ".join(f"{k:g}" for k in np.asarray(mount.stiffness))
            lines.append(f"  {mount.name}: at {place} m, {stiffness} N/m")
        return "\n".join(lines) + ">"

    def sag(self) -> Sag:
        """Return the static equilibrium under gravity and preloads, and the mount forces.

        Raises
        ------
        InputError
            If the body has no ``gravity`` and no preload.
        """
        if self._sag is None:
            raise InputError("gravity: is None, the body has no weight: give gravity=9.81")
        return self._sag

    def motion_of(self, result: Any, point: npt.ArrayLike) -> ComplexArray:
        """Return the displacement of a point of the body in a response or branch.

        Parameters
        ----------
        result : Response or Branch
            A result of this body.
        point : array_like, shape (3,)
            The point (m), in the axes of the mounts' positions.

        Returns
        -------
        ndarray, shape (n_nu, 3, n_harmonics)
            Coefficients (m) like ``result.coefficients``; times -(k nu)^2 they are the
            acceleration. With a moving floor they are absolute.
        """
        arm = self._arm("point", point)
        if str(getattr(result, "varies", "nu")).startswith("center"):
            raise InputError("result: the center varies along it, must not be")
        rows = np.hstack([np.eye(3), -crossing(arm)])
        body = self._coefficients(result)[:, :6]
        moved = np.einsum("ad,ndk->nak", rows, body)
        if self._turns and getattr(result, "method", "newton") != "linear":
            moved = moved + further_moved(np.asarray(result.harmonics), body[:, 3:], arm)
        return np.asarray(moved)

    def mount_forces(self, result: Any, *, base: LoadLike | None = None) -> MountForces:
        """Return deflection, force and lost power of every mount in a response or branch.

        Parameters
        ----------
        result : Response or Branch
            A result of this body.
        base : complex or mapping, optional
            The motion of the floor is that of the result. If given, it must be the same.

        Returns
        -------
        MountForces
            Without the static forces.
        """
        found = self._coefficients(result)
        varies = getattr(result, "varies", "nu")
        if varies not in ("nu", "load_factor"):
            raise InputError(
                f"result: {varies} varies along it, and forces are those of this body: must be "
                "over nu or load_factor, or make the body with the value of a point"
            )
        if base is not None:
            self._check_floor_of(result, base)
        factors = getattr(result, "load_factor", np.ones(result.nu.size))
        relative = result._parts.relative(np.asarray(result.harmonics), found, factors)
        return mount_forces(self.mounts, self._mount_springs, result, relative, turns=self._turns)

    def _check_floor_of(self, result: Any, base: LoadLike) -> None:
        check_oscillator(self, base)
        parts, highest = result._parts, int(np.max(result.harmonics))
        floors = []
        shown = oscillator_series(self, None, base)[:2], (parts.orders, parts.series)
        for orders, series in shown:
            moves = np.zeros((highest + 1, len(self.dof_names)), dtype=complex)
            for order, moved in base_shifts(orders, series, self._base_direction):
                if order <= highest:
                    moves[order] += moved
            floors.append(moves)
        given, own = floors
        if not np.allclose(given, own, rtol=1e-9, atol=1e-12 * np.abs(own).max()):
            raise InputError(
                f"base = {_native.shown(base)}: must be the motion of the floor that the result "
                "was computed for, or left out"
            )

    def _coefficients(self, result: Any) -> ComplexArray:
        found = getattr(result, "coefficients", None)
        if found is None or tuple(getattr(result, "dof_names", ())) != self.dof_names:
            raise InputError(
                f"result = {_native.shown(type(result).__name__)}: must be a Response or Branch of "
                "this body"
            )
        return np.asarray(found)

    def _warn_of_instability(self) -> None:
        squares = np.linalg.eigvalsh(self._stiffness_at_rest)
        if squares[0] < -1e-12 * np.abs(squares).max():
            warnings.warn(
                "the static equilibrium is unstable: the preload tips the body over",
                StabilityWarning,
                stacklevel=caller(),
            )
