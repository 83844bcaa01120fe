"""A rigid body in space on its mounts: six coordinates, any number of mounts at any place."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Sequence
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.bodies.checks import (
    NAMES,
    checked_axis,
    checked_complex_vector,
    checked_direction,
    checked_gravity,
    checked_inertia,
    checked_mounts,
    checked_vector,
    inverse_of,
)
from viscovib.bodies.forces import MountForces, mount_forces
from viscovib.bodies.modes import BodyModes, find_modes
from viscovib.bodies.mount_point import MountPoint, crossing
from viscovib.bodies.springs import (
    MountSprings,
    condensed_springs,
    mount_springs,
    spring_groups,
)
from viscovib.bodies.statics import Sag, find_sag, geometric_stiffness
from viscovib.bodies.turning import (
    BODY_IN_VECTOR,
    about_turned,
    angular_momentum,
    further_moved,
    turned,
    turning_energy,
    turning_vector,
)
from viscovib.errors import InputError, StabilityWarning, caller
from viscovib.systems.condensed import Condensation
from viscovib.systems.laws import Law
from viscovib.systems.load import LoadLike, load_series
from viscovib.systems.polynomial_system import PolynomialSystem

_UNITS = ("m", "m", "m", "rad", "rad", "rad")
_GEOMETRIES = ("small", "exact")
_LOAD_AXES = ("body", "space")
#: Mounts farther away than so many radii of gyration look like millimetres given as metres.
#: Radius of gyration (m) above which one that is far larger than distances of mounts is doubted.
_LARGE = 20.0
_FAR = 50.0


class Body(PolynomialSystem):
    """A rigid body on mounts, each of them rubber with its own memory and force law.

    The coordinates are the displacement x, y, z (m) of the centre of mass and the rotation
    rx, ry, rz (rad) about it, both small. With the point p of a mount and its rotation R (local
    to body axes) its deflections are d = R^T (u + theta x p), and

        M u'' + sum_j e_j {(1 - R_j*) [k_j d_j + g_j(d_j)] + c_j d_j'} = load(t),  d_j = e_j . u,

    over all directions j of all mounts: a `PolynomialSystem`, on which every method works. The
    floor is at rest, or moves along ``base_direction``; responses are absolute then too.

    Parameters
    ----------
    mass : float
        Of the body (kg).
    inertia : array_like, shape (3, 3) or (3,)
        Tensor of inertia about the centre of mass in body axes (kg m^2), with the signs of a
        tensor (J_xy = -sum m x y), or its diagonal.
    mounts : sequence of MountPoint
    center : array_like, shape (3,), optional
        Centre of mass (m), in the axes in which the mounts' positions are given.
    gravity : float or array_like, shape (3,), optional
        Acceleration (m/s^2), a number along -z. The body then sags: mounts carry
        k_j (1 - integral of R_j) in the end, coordinates count from the loaded position, laws
        are those about it, and the preload adds its geometric stiffness, which remembers nothing.
        None: no gravity, mounts without preload.
    geometry : str, optional
        "small": rotations are small, the mounts are nonlinear. "exact": rotations are finite, and
        rx, ry, rz are the rotation vector, the angle (below 2 pi) times the unit vector of the axis
        about which the body is turned; all inertia terms are kept. A body that goes on turning is
        told by the other vector of the same rotation, theta (1 - 2 pi/|theta|), after a step that
        ends beyond 3.5 rad. Mounts act along directions fixed in the floor,
        d = e . (u + R p - p), and what holds rotations is deflected by the rotation vector: such a
        body keeps its vector, whose angle stays below 2 pi (near it steps must be short). Motions
        in time and periodic ones are computed then; modes and what is linear are those of small
        motions.
    load_axes : str, optional
        With ``geometry="exact"``: "body": forces and torques turn with the body, such as the
        torque of an engine; "space": they keep their directions (a torque that does has no
        potential).
    base_direction : str or array_like, shape (6,), optional
        How the floor moves: "x", ..., "rz" (about the centre of mass), or a mix.

    Warns
    -----
    StabilityWarning
        If a kernel's integral is not between 0 and 1, if the loaded position is unstable, or if
        positions look like millimetres.

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
    ) -> None:
        own = object.__setattr__
        own(self, "body_mass", _native.number("mass", mass))
        if not self.body_mass > 0:
            raise InputError(f"mass = {self.body_mass:g}: must be greater than 0")
        own(self, "inertia", checked_inertia(inertia))
        own(self, "mounts", checked_mounts(mounts))
        own(self, "center", checked_vector("center", center))
        own(self, "geometry", _native.choice("geometry", geometry, _GEOMETRIES))
        own(self, "load_axes", _native.choice("load_axes", load_axes, _LOAD_AXES))
        own(self, "gravity", checked_gravity(gravity))
        self._warn_of_units()
        springs = mount_springs(self.mounts, self.center)
        matrix = springs.mass_of_tracks
        matrix[:3, :3] = self.body_mass * np.eye(3)
        matrix[3:6, 3:6] = self.inertia
        n = matrix.shape[0]
        preload = np.zeros((n, n))
        sag = None
        if self.gravity is not None:
            weight = np.zeros(n)
            weight[:3] = self.body_mass * self.gravity
            sag = find_sag(springs, weight, turns=self._turns)
            springs = springs.about(sag._deflection)
            if self._turns:
                springs = about_turned(springs, sag.displacement, sag._carried)
                turn = turned(sag.displacement[3:6], np.eye(3)).T
                matrix[3:6, 3:6] = turn @ self.inertia @ turn.T
            preload = geometric_stiffness(springs, sag._carried)
        own(self, "_sag", sag)
        own(self, "_mount_springs", springs)
        direction = None if base_direction is None else checked_direction(base_direction, n)
        self._check_geometry(direction)
        names = (*NAMES, *(f"{mount.name}_y" for mount in self.mounts if mount.track))
        first, *others = spring_groups(springs, preload, names)
        super().__init__(
            mass=matrix,
            stiffness=first.stiffness,
            forces=first.forces,
            damping=springs.damping_matrix,
            springs=others,
            names=names,
            units=(*_UNITS, *("m" for _ in names[6:])),
            base_direction=direction,
        )
        self._warn_of_instability()

    body_mass: float
    inertia: FloatArray
    mounts: tuple[MountPoint, ...]
    center: FloatArray
    gravity: FloatArray | None
    geometry: str
    load_axes: str
    _sag: Sag | None
    _mount_springs: MountSprings

    def _check_geometry(self, direction: FloatArray | None) -> None:
        if self.geometry == "small":
            return
        for mount in self.mounts:
            if any(isinstance(law, Law) and max(law.places, default=0) for law in mount.laws):
                raise InputError(
                    f"{mount.name}: law: must not depend on the rate v with geometry = 'exact'"
                )
        if direction is not None and direction[3:6].any():
            raise InputError(
                "base_direction: must not turn the floor with geometry = 'exact', give x, y or z"
            )
        if direction is not None and self.load_axes == "body":
            raise InputError(
                "load_axes = 'body': must be 'space' where the floor moves with geometry = 'exact'"
            )

    @property
    def _turns(self) -> bool:
        return self.geometry == "exact"

    @property
    def _winds(self) -> bool:
        """Whether what is turned once more is the same: nothing holds rotations."""
        return self._turns and bool(self._mount_springs.rows[:, :3].any(axis=1).all())

    @property
    def _flat(self) -> FloatArray:
        return self._turning_vector if self._turns else self._vector

    @cached_property
    def _turning_vector(self) -> FloatArray:
        return turning_vector(
            self._mass_matrix, self._damping, self._base_direction, self._mount_springs,
            self._active_kernels, loads_turn=self.load_axes == "body",
        )  # fmt: skip

    @property
    def _kernels(self) -> tuple[int, FloatArray, int, FloatArray]:
        nothing = np.zeros(1)
        return (BODY_IN_VECTOR, nothing, 0, nothing) if self._turns else super()._kernels

    def energy(self, state: npt.ArrayLike) -> FloatArray:
        """Kinetic and potential energy at states (u_1, u_1', u_2, ...), shape (..., 2 n).

        Of mounts without memory and damping whose laws are polynomials; with
        ``geometry="exact"`` 1/2 m x'^2 + 1/2 omega . J omega and the springs' own.
        """
        if not self._turns:
            return super().energy(state)
        return turning_energy(self._mass_matrix, self._mount_springs, self._states(state))

    def angular_momentum(self, state: npt.ArrayLike) -> FloatArray:
        """About the centre of mass in axes of space (kg m^2/s), shape (..., 3).

        R J omega at states (u_1, u_1', u_2, ...), shape (..., 2 n); J theta' where rotations are
        small.
        """
        states = self._states(state)
        inertia = self._mass_matrix[3:6, 3:6]
        if not self._turns:
            return np.asarray(states[..., 7:12:2] @ inertia)
        return angular_momentum(inertia, states)

    def _arm(self, name: str, place: npt.ArrayLike | None) -> FloatArray:
        """From the centre of mass to a point of the body, in the axes of the coordinates."""
        if place is None:
            return np.zeros(3)
        arm = checked_vector(name, place) - self.center
        return np.asarray(self._loaded_axes @ arm)

    @property
    def _loaded_axes(self) -> FloatArray:
        """How the body at rest is turned out of the position without weight, shape (3, 3)."""
        if not self._turns or self._sag is None:
            return np.eye(3)
        return np.asarray(turned(self._sag.displacement[3:6], np.eye(3)).T)

    def _states(self, state: npt.ArrayLike) -> FloatArray:
        states = _native.real_array("state", state)
        n = len(self.dof_names)
        if states.shape[-1:] != (2 * n,):
            raise InputError(f"state: must have shape (..., {2 * n}), got {states.shape}")
        return states

    @cached_property
    def _condensation(self) -> Condensation | None:
        if self._turns:
            return None
        return condensed_springs(
            self._mount_springs, self._mass_matrix, self._damping, self._stiffness_at_rest
        )

    def __repr__(self) -> str:
        """Say what it is in a few lines."""
        lines = [f"<Body: {self.body_mass:g} kg on {len(self.mounts)} mounts"]
        for mount in self.mounts:
            place = " ".join(f"{p:g}" for p in np.asarray(mount.position))
            stiffness = " ".join(f"{k:g}" for k in np.asarray(mount.stiffness))
            lines.append(f"  {mount.name}: at {place} m, {stiffness} N/m")
        return "\n".join(lines) + ">"

    def modes(self) -> BodyModes:
        """Modes about the position at rest without memory, with their kinetic energies.

        Returns
        -------
        BodyModes
            Frequencies (Hz), shapes, kinetic energy of each coordinate (percent), decoupling.

        Raises
        ------
        InputError
            If the position at rest is unstable.
        """
        return find_modes(self)

    def animate_mode(
        self,
        mode: int = 1,
        path: str | os.PathLike[str] | None = None,
        *,
        frames: int = 40,
        fps: float = 20.0,
    ) -> Any:
        """Show a mode as a moving picture in space, its largest swing a quarter of the picture.

        Parameters
        ----------
        mode : int
            Which, from 1.
        path : path, optional
            Where to write it: ``.gif``, ``.html`` or ``.mp4`` (as of `animate`). None: not written.
        frames : int
            Pictures of one period.
        fps : float
            Pictures per second, up to 200.

        Returns
        -------
        matplotlib.animation.FuncAnimation

        Raises
        ------
        InputError
            If there is no such mode, the rest is unstable, or the file cannot be of this kind.
        """
        films = import_module("viscovib.plots.body_films")
        return films.film_of_mode(self, mode, path, frames, fps)

    def sag(self) -> Sag:
        """Where the body rests under gravity, and what each mount carries.

        Raises
        ------
        InputError
            If the body was made without ``gravity``.
        """
        if self._sag is None:
            raise InputError("gravity: is None, the body has no weight: give gravity=9.81")
        return self._sag

    def torque_roll_axis(self, about: str | npt.ArrayLike = "x") -> FloatArray:
        """Axis about which a free body turns under a torque, through the centre of mass.

        It is the direction of J^-1 t (Harris, Shock and Vibration Handbook). A body whose
        mounts let it roll about this axis answers a torque with one mode only.

        Parameters
        ----------
        about : "x", "y", "z" or array_like, shape (3,)
            Axis of the torque, that of the crankshaft.

        Returns
        -------
        ndarray, shape (3,)
            A unit vector in body axes.
        """
        axis = np.linalg.solve(self._mass_matrix[3:6, 3:6], checked_axis("about", about))
        return np.asarray(axis / np.linalg.norm(axis))

    def roll_share(self, about: str | npt.ArrayLike = "x") -> FloatArray:
        """How much of each mode is rolling about the torque-roll axis (percent), shape (6,).

        (phi^T M r)^2/(r^T M r) of modes of unit modal mass, r the roll about that axis. The shares
        of all modes add up to 100: of an ideal suspension one is 100, the others 0.
        """
        roll = np.zeros(len(self.dof_names))
        roll[3:6] = self.torque_roll_axis(about)
        push = self._mass_matrix @ roll
        return np.asarray(100 * (self.modes().shapes.T @ push) ** 2 / (roll @ push))

    def centers(self) -> tuple[FloatArray, FloatArray]:
        """Centre of stiffness and centre of compliance (m), in the axes of the positions.

        In space no single elastic centre exists. About the first the coupling block of the
        stiffness matrix is symmetric, about the second that of its inverse (Loncaric 1987);
        they agree where a true elastic centre exists.

        Raises
        ------
        InputError
            If the stiffness leaves such a point undetermined.
        """
        stiffness = self._stiffness_at_rest[:6, :6]
        places = []
        for what, matrix, sign, corner in (
            ("stiffness", stiffness, -1.0, slice(0, 3)),
            ("compliance", inverse_of(stiffness), 1.0, slice(3, 6)),
        ):
            block = matrix[corner, corner]
            off = matrix[:3, 3:]
            odd = off - off.T
            twist = np.array([odd[2, 1], odd[0, 2], odd[1, 0]])
            system = np.trace(block) * np.eye(3) - block
            if np.linalg.cond(system) > 1e12:
                raise InputError(f"mounts: leave the centre of {what} undetermined")
            found = np.linalg.solve(system, sign * twist)
            places.append(self.center + self._loaded_axes.T @ found)
        return places[0], places[1]

    def load(
        self,
        force: npt.ArrayLike = (0.0, 0.0, 0.0),
        torque: npt.ArrayLike = (0.0, 0.0, 0.0),
        at: npt.ArrayLike | None = None,
    ) -> ComplexArray:
        """A force (N) at a point (m; None: the centre of mass) and a torque (N m) as a load.

        Returns
        -------
        ndarray, shape (n,)
            For ``load=`` of `forced_response`, `trace_response` and `simulate`.
        """
        pushed = checked_complex_vector("force", force)
        arm = self._arm("at", at)
        if self._turns and self.load_axes == "space" and arm.any():
            raise InputError(
                "at: with geometry = 'exact' and load_axes = 'space' the arm of a force turns with "
                "the body: must be None, the centre of mass"
            )
        total = np.zeros(len(self.dof_names), dtype=complex)
        total[:3] = pushed
        total[3:6] = checked_complex_vector("torque", torque) + crossing(arm) @ pushed
        return total

    def unbalance(
        self,
        nu: float,
        mass_eccentricity: float,
        at: npt.ArrayLike | None = None,
        axis: str | npt.ArrayLike = "x",
    ) -> ComplexArray:
        """The load of a rotating unbalance m e nu^2 at one speed nu (rad/s).

        The force turns about ``axis`` through the point ``at`` (m) by the right-hand rule; at
        t = 0 it points along the second of two axes across, y for "x".

        Parameters
        ----------
        nu : float
            Speed (rad/s).
        mass_eccentricity : float
            m e (kg m).
        """
        speed = _native.number("nu", nu)
        size = _native.number("mass_eccentricity", mass_eccentricity) * speed * speed
        if not math.isfinite(size):
            raise InputError(f"nu = {speed:g}: the force is no finite number, must be smaller")
        along = checked_axis("axis", axis)
        # Some vector across, then the third of the right-handed three.
        second = np.roll(np.eye(3)[np.abs(along).argmax()], 1)
        second -= along * (along @ second)
        second /= np.linalg.norm(second)
        third = np.cross(along, second)
        # Im[(i p + q) exp(i nu t)] = p cos nu t + q sin nu t.
        return self.load(force=size * (1j * second + third), at=at)

    def motion_of(self, result: Any, point: npt.ArrayLike) -> ComplexArray:
        """Displacement of a point of the body in a response or along a branch.

        Parameters
        ----------
        result : Response or Branch
            Of this body.
        point : array_like, shape (3,)
            Where (m), in the axes of the mounts' positions.

        Returns
        -------
        ndarray, shape (n_nu, 3, n_harmonics)
            Coefficients (m) like ``result.coefficients``; times -(k nu)^2 they are the
            acceleration. Where the floor moves they are absolute too.
        """
        arm = self._arm("point", point)
        rows = np.hstack([np.eye(3), -crossing(arm)])
        body = self._coefficients(result)[:, :6]
        moved = np.einsum("ad,ndk->nak", rows, body)
        if self._turns and getattr(result, "method", "newton") != "linear":
            moved = moved + further_moved(np.asarray(result.harmonics), body[:, 3:], arm)
        return np.asarray(moved)

    def mount_forces(self, result: Any, *, base: LoadLike | None = None) -> MountForces:
        """Deflection, force and lost power of every mount in a response or along a branch.

        Parameters
        ----------
        result : Response or Branch
            Of this body.
        base : complex or mapping, optional
            Motion of the floor as given to `forced_response`; to be given if the body has a
            ``base_direction`` (0 where the floor was at rest).

        Returns
        -------
        MountForces
            Without what the mounts carry at rest.
        """
        relative = self._coefficients(result)
        if self.base_direction is None:
            if base is not None:
                raise InputError("base: this body has no base_direction, its floor is fixed")
            return mount_forces(
                self.mounts, self._mount_springs, result, relative, turns=self._turns
            )
        if base is None:
            raise InputError(
                "base: the floor of this body may move, give the motion that the result was "
                "computed for (0: none)"
            )
        orders, series = load_series(None, base, len(self.dof_names))
        moved = {int(k): y for k, y in zip(orders, series[-1], strict=True)}
        if any(moved.values()) and getattr(result, "varies", "nu") == "load_factor":
            raise InputError("result: the motion of the floor must not vary along it")
        floor = np.array([moved.get(int(k), 0.0) for k in np.asarray(result.harmonics)])
        direction = np.asarray(self.base_direction)
        return mount_forces(
            self.mounts, self._mount_springs, result, relative - np.outer(direction, floor),
            turns=self._turns,
        )  # fmt: skip

    def base_transmissibility(
        self,
        nu: npt.ArrayLike,
        axis: str | npt.ArrayLike = "z",
        point: npt.ArrayLike | None = None,
        *,
        relative: bool = False,
    ) -> ComplexArray:
        """Displacement of a point of the body over that of the floor, linear.

        Parameters
        ----------
        nu : array_like
            Circular frequencies (rad/s).
        axis : "x", "y", "z" or array_like, shape (3,)
            Direction in which the floor moves.
        point : array_like, shape (3,), optional
            Where on the body (m); None: the centre of mass.
        relative : bool
            Relative to the floor.

        Returns
        -------
        ndarray, shape (*nu.shape, 3)
            Along x, y and z; ``20*log10(abs(...))`` are decibels.
        """
        frequencies = _native.real_array("nu", nu)
        along = checked_axis("axis", axis)
        direction = np.zeros(len(self.dof_names))
        direction[:3] = along
        push = frequencies[..., None] ** 2 * (self._mass_matrix @ direction)
        moved = self._solved(frequencies, push)
        arm = self._arm("point", point)
        answer = moved[..., :6] @ np.hstack([np.eye(3), -crossing(arm)]).T
        return np.asarray(answer if _native.flag("relative", relative) else answer + along)

    def force_transmissibility(
        self,
        nu: npt.ArrayLike,
        axis: str | npt.ArrayLike = "z",
        at: npt.ArrayLike | None = None,
    ) -> ComplexArray:
        """Sum of the forces on the floor over a force on the body, linear.

        Parameters
        ----------
        nu : array_like
            Circular frequencies (rad/s).
        axis : "x", "y", "z" or array_like, shape (3,)
            Direction of the force.
        at : array_like, shape (3,), optional
            Where it acts (m); None: at the centre of mass.

        Returns
        -------
        ndarray, shape (*nu.shape, 3)
            Along x, y and z.
        """
        frequencies = _native.real_array("nu", nu)
        push = np.broadcast_to(
            self.load(checked_axis("axis", axis), at=at),
            (*frequencies.shape, 0 + len(self.dof_names)),
        )
        moved = self._solved(frequencies, push)
        # What does not accelerate the body goes to the floor.
        inertia = -(frequencies[..., None] ** 2) * self.body_mass * moved[..., :3]
        return np.asarray(push[..., :3] - inertia)

    def random_floor(
        self,
        hz: npt.ArrayLike,
        density: npt.ArrayLike,
        axis: str | npt.ArrayLike = "z",
        point: npt.ArrayLike | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Acceleration of a point of the body on a floor that shakes at random, linear.

        S_body = |H|^2 S_floor, and the mean square is the integral of S over the frequencies.

        Parameters
        ----------
        hz : array_like, shape (n,)
            Frequencies (Hz), ascending.
        density : array_like, shape (n,)
            One-sided spectral density of the floor's acceleration ((m/s^2)^2/Hz).
        axis, point
            As of `base_transmissibility`.

        Returns
        -------
        density : ndarray, shape (n, 3)
            Spectral densities of the acceleration along x, y and z ((m/s^2)^2/Hz).
        rms : ndarray, shape (3,)
            Root mean squares over these frequencies (m/s^2), by the trapezoidal rule.
        """
        frequencies = _native.real_array("hz", hz)
        given = _native.real_array("density", density)
        if frequencies.ndim != 1 or frequencies.size < 2 or (np.diff(frequencies) <= 0).any():
            raise InputError("hz: must be ascending, two or more")
        if given.shape != frequencies.shape or (given < 0).any():
            raise InputError(f"density: must have shape {frequencies.shape}, none negative")
        answer = self.base_transmissibility(2 * math.pi * frequencies, axis, point)
        with np.errstate(over="ignore"):
            densities = np.abs(answer) ** 2 * given[:, np.newaxis]
            mean = (densities[1:] + densities[:-1]) / 2 * np.diff(frequencies)[:, np.newaxis]
            total = mean.sum(axis=0)
        if not np.isfinite(total).all():
            raise InputError(f"density = {given.max():g}: no finite mean, must be smaller")
        return densities, np.sqrt(total)

    def engine_orders(
        self, speeds: npt.ArrayLike, orders: npt.ArrayLike, loads: npt.ArrayLike
    ) -> ComplexArray:
        """Answer to loads whose frequencies are multiples of a speed, linear.

        Parameters
        ----------
        speeds : array_like, shape (n,)
            Of the crankshaft (rad/s).
        orders : array_like, shape (m,)
            Multiples of the speed: 0.5, 1, 2, ...
        loads : array_like, shape (m, n_dof) or (n, m, n_dof)
            Amplitudes (see `load`), at all speeds or at each.

        Returns
        -------
        ndarray, shape (n, m, n_dof)
            Coefficients of u = Im sum_j X_j exp(i order_j speed t).
        """
        turning = _native.real_array("speeds", speeds, ndim=1)
        multiples = _native.real_array("orders", orders, ndim=1)
        if (turning <= 0).any() or (multiples <= 0).any():
            raise InputError("speeds, orders: must be greater than 0")
        given = _native.complex_array("loads", loads)
        shape = (turning.size, multiples.size, len(self.dof_names))
        if given.shape not in (shape[1:], shape):
            raise InputError(f"loads: must have shape {shape[1:]} or {shape}, got {given.shape}")
        return self._solved(np.outer(turning, multiples), np.broadcast_to(given, shape))

    def scatter(
        self, n: int, spread: float = 0.15, *, seed: int = 0
    ) -> tuple[FloatArray, FloatArray]:
        """Modes of n bodies whose mounts' stiffnesses scatter: how robust a suspension is.

        Every local stiffness of every mount is multiplied by a random factor of its own, uniform
        in [1 - spread, 1 + spread].

        Returns
        -------
        hz : ndarray, shape (n, 6)
            Natural frequencies (Hz), ascending.
        decoupling : ndarray, shape (n, 6)
            The largest kinetic energy share of a coordinate in each mode (percent).
        """
        count = _native.integer("n", n, 1, 10_000_000)
        part = _native.number("spread", spread)
        if not 0 <= part < 1:
            raise InputError(f"spread = {part:g}: must be in [0, 1)")
        start = _native.integer("seed", seed, 0, 2**31)
        rows, stiffness = self._mount_springs.rows, self._mount_springs.stiffness
        factors = np.random.default_rng(start).uniform(1 - part, 1 + part, (count, stiffness.size))
        rest = self._stiffness_at_rest - (rows.T * stiffness) @ rows
        lower = np.linalg.inv(np.linalg.cholesky(self._mass_matrix))
        scaled = rows @ lower.T
        matrices = np.einsum("ja,nj,jb->nab", scaled, factors * stiffness, scaled, optimize=True)
        squares, vectors = np.linalg.eigh(matrices + lower @ rest @ lower.T)
        shapes = np.einsum("ba,nbr->nar", lower, vectors)
        energy = 100 * shapes * np.einsum("ab,nbr->nar", self._mass_matrix, shapes)
        return np.sqrt(np.maximum(squares, 0)) / (2 * math.pi), energy.max(axis=1)

    def _solved(self, nu: FloatArray, push: npt.NDArray[Any]) -> ComplexArray:
        found = np.linalg.solve(self.dynamic_stiffness(nu), push[..., None])[..., 0]
        return np.asarray(found)

    def _coefficients(self, result: Any) -> ComplexArray:
        found = getattr(result, "coefficients", None)
        if found is None or tuple(getattr(result, "dof_names", ())) != self.dof_names:
            raise InputError(
                f"result = {_native.shown(type(result).__name__)}: must be a Response or Branch of "
                "this body"
            )
        return np.asarray(found)

    def _warn_of_units(self) -> None:
        radius = math.sqrt(np.trace(self.inertia) / 2 / self.body_mass)
        farthest = 0.0
        for mount in self.mounts:
            largest = float(np.abs(np.asarray(mount.angles)).max())
            if largest > 2 * math.pi:
                warnings.warn(
                    f"{mount.name}: angles: {largest:g} is more than a whole turn: angles are in "
                    "rad, those in degrees are to be multiplied by units.degree",
                    StabilityWarning,
                    stacklevel=caller(),
                )
            away = math.dist(np.asarray(mount.position), self.center)
            farthest = max(farthest, away)
            if away > _FAR * radius:
                warnings.warn(
                    f"{mount.name}: is {away:g} m from the centre of mass of a body whose radius "
                    f"of gyration is {radius:.3g} m: positions are in m, those in mm are to be "
                    "multiplied by units.mm",
                    StabilityWarning,
                    stacklevel=caller(),
                )
                return
        if radius > max(_FAR * farthest, _LARGE) and farthest > 0:
            warnings.warn(
                f"inertia: the radius of gyration is {radius:.3g} m, the farthest mount is "
                f"{farthest:.3g} m from the centre of mass: inertia is in kg m^2, that in kg mm^2 "
                "is to be multiplied by units.mm**2",
                StabilityWarning,
                stacklevel=caller(),
            )

    def _warn_of_instability(self) -> None:
        squares = np.linalg.eigvalsh(self._stiffness_at_rest)
        if squares[0] < -1e-12 * np.abs(squares).max():
            warnings.warn(
                "the position at rest is unstable: the preload turns the body over",
                StabilityWarning,
                stacklevel=caller(),
            )
