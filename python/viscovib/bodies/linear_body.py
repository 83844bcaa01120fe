"""Linear results of a body: modes, axes, loads, transmissibilities."""

from __future__ import annotations

import math
import os
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.bodies.checks import (
    checked_axis,
    checked_complex_vector,
    checked_floor,
    checked_vector,
    inverse_of,
)
from viscovib.bodies.damped_modes import stiffness_at, with_shapes
from viscovib.bodies.mean_square import mean_square
from viscovib.bodies.modes import BodyModes, find_damped_modes, find_modes
from viscovib.bodies.mount_point import MountPoint, crossing
from viscovib.bodies.springs import MountSprings
from viscovib.bodies.statics import Sag
from viscovib.bodies.turning import turned
from viscovib.errors import InputError
from viscovib.systems.polynomial_system import PolynomialSystem


class LinearBody(PolynomialSystem):
    """A body on its mounts for small motions."""

    body_mass: float
    inertia: FloatArray
    mounts: tuple[MountPoint, ...]
    center: FloatArray
    gravity: FloatArray | None
    spin: FloatArray
    rotor: FloatArray
    geometry: str
    load_axes: str
    _sag: Sag | None
    _mount_springs: MountSprings

    def _check_real(self) -> None:
        """Refuse modes of a body with rotors."""
        if self.spin.any() or self.rotor.any():
            raise InputError(
                "spin: modes of a body with parts that spin are complex, must be 0 here; "
                "characteristic_roots() gives them"
            )

    def _check_rotor(self, name: str, moved: npt.NDArray[Any]) -> None:
        """Refuse rotations of the floor, shape (n, ...), with a rotor of any speed."""
        if self.rotor.any() and moved[3:6].any():
            raise InputError(
                f"{name}: must not turn the floor with a rotor at the speed of the load: use "
                "body.at_speed(speed)"
            )

    @property
    def _turns(self) -> bool:
        return self.geometry == "exact"

    def _arm(self, name: str, place: npt.ArrayLike | None) -> FloatArray:
        """Vector from the mass centre to a point of the body, in the axes of the coordinates."""
        if place is None:
            return np.zeros(3)
        arm = checked_vector(name, place) - self.center
        return np.asarray(self._loaded_axes @ arm)

    @property
    def _loaded_axes(self) -> FloatArray:
        """Rotation of the body at rest from its position without weight, shape (3, 3)."""
        if not self._turns or self._sag is None:
            return np.eye(3)
        return np.asarray(turned(self._sag.displacement[3:6], np.eye(3)).T)

    def modes(self, *, stiffness: str | float | None = None) -> BodyModes:
        """Return the modes about the static equilibrium with their kinetic energies.

        Parameters
        ----------
        stiffness : "instantaneous", "relaxed" or float, optional
            Undamped modes with a selected stiffness: before relaxation, after complete relaxation,
            or at a circular frequency (rad/s). None: with kernels, damped modes, each with the
            stiffness and the loss at its own root of the characteristic equation, one for each
            undamped mode unless its motion creeps; without kernels, undamped modes.

        Returns
        -------
        BodyModes
            Frequencies (Hz), damping ratios, shapes, kinetic energy of each coordinate (percent),
            decoupling.

        Raises
        ------
        InputError
            If the static equilibrium is unstable, or if the body contains rotors.
        """
        self._check_real()
        if stiffness is None:
            if self._active_kernels:
                return find_damped_modes(self)
            return find_modes(self, self._stiffness_at_rest)
        if not isinstance(stiffness, str):
            nu = _native.number("stiffness", stiffness)
            if not nu > 0:
                raise InputError(f"stiffness = {nu:g}: a circular frequency must be above 0")
            return find_modes(self, stiffness_at(self, nu), f"{nu:g}")
        which = _native.choice("stiffness", stiffness, ("instantaneous", "relaxed"))
        if which == "instantaneous":
            return find_modes(self, self._stiffness_at_rest)
        kept = [1.0 if g.kernel is None else 1.0 - g.kernel.integral for g in self.groups]
        if not np.isfinite(kept).all():
            raise InputError("stiffness = 'relaxed': a kernel has no finite integral")
        relaxed = sum(k * g.stiffness for k, g in zip(kept, self.groups, strict=True))
        return find_modes(self, np.asarray(relaxed), "'relaxed'")

    @cached_property
    def _damped_roots(self) -> tuple[ComplexArray, ComplexArray]:
        return with_shapes(self, self.characteristic_roots().oscillatory)

    def animate_mode(
        self,
        mode: int = 1,
        path: str | os.PathLike[str] | None = None,
        *,
        frames: int = 40,
        fps: float = 20.0,
    ) -> Any:
        """Animate a mode in space, with the largest motion a quarter of the picture.

        Parameters
        ----------
        mode : int
            Number of the mode, from 1.
        path : path, optional
            File to write: ``.gif``, ``.html`` or ``.mp4`` (as for `animate`). None: not written.
        frames : int
            Pictures per period.
        fps : float
            Pictures per second, up to 200.

        Returns
        -------
        matplotlib.animation.FuncAnimation

        Raises
        ------
        InputError
            If the mode does not exist, the static equilibrium is unstable, or the file type is not
            supported.
        """
        films = import_module("viscovib.plots.body_films")
        return films.film_of_mode(self, mode, path, frames, fps)

    def torque_roll_axis(self, about: str | npt.ArrayLike = "x") -> FloatArray:
        """Return the axis about which a free body rotates under a torque, through the mass centre.

        It is the direction of J^-1 t (Harris, Shock and Vibration Handbook). If a body can roll
        about this axis in a single mode, a torque excites only this mode.

        Parameters
        ----------
        about : "x", "y", "z" or array_like, shape (3,)
            Axis of the torque, for example of the crankshaft.

        Returns
        -------
        ndarray, shape (3,)
            A unit vector in body axes.
        """
        axis = np.linalg.solve(self._mass_matrix[3:6, 3:6], checked_axis("about", about))
        return np.asarray(axis / np.linalg.norm(axis))

    def roll_share(self, about: str | npt.ArrayLike = "x") -> FloatArray:
        """Return the share of roll about the torque-roll axis in each mode (percent), shape (6,).

        |phi^H M r|^2/(r^T M r) of modes of unit modal mass, with the roll r about this axis. The
        shares of all undamped modes add up to 100. For an ideal suspension a single share is 100.
        """
        roll = np.zeros(len(self.dof_names))
        roll[3:6] = self.torque_roll_axis(about)
        push = self._mass_matrix @ roll
        return np.asarray(100 * np.abs(self.modes().shapes.conj().T @ push) ** 2 / (roll @ push))

    def centers(self) -> tuple[FloatArray, FloatArray]:
        """Return the centres of stiffness and of compliance (m), in the axes of the positions.

        In space there is no single elastic centre. The coupling block of the stiffness matrix is
        symmetric about the first point, that of its inverse about the second (Loncaric 1987). They
        agree if a true elastic centre exists.

        Raises
        ------
        InputError
            If the stiffness does not determine such a point.
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
                raise InputError(f"mounts: do not determine the centre of {what}")
            found = np.linalg.solve(system, sign * twist)
            places.append(self.center + self._loaded_axes.T @ found)
        return places[0], places[1]

    def load(
        self,
        force: npt.ArrayLike = (0.0, 0.0, 0.0),
        torque: npt.ArrayLike = (0.0, 0.0, 0.0),
        at: npt.ArrayLike | None = None,
    ) -> ComplexArray:
        """Return a force (N) at a point (m; None: the mass centre) and a torque (N m) as a load.

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
        """Return the load of a rotating unbalance m e nu^2 at one speed nu (rad/s).

        The force rotates about ``axis`` through the point ``at`` (m) by the right-hand rule. At t =
        0 it points along the next axis, y for "x".

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
            raise InputError(f"nu = {speed:g}: the force is not finite, must be smaller")
        along = checked_axis("axis", axis)
        # A perpendicular vector, then the third vector of the right-handed system.
        second = np.roll(np.eye(3)[np.abs(along).argmax()], 1)
        second -= along * (along @ second)
        second /= np.linalg.norm(second)
        third = np.cross(along, second)
        # Im[(i p + q) exp(i nu t)] = p cos nu t + q sin nu t.
        return self.load(force=size * (1j * second + third), at=at)

    def base_transmissibility(
        self,
        nu: npt.ArrayLike,
        axis: str | npt.ArrayLike = "z",
        point: npt.ArrayLike | None = None,
        *,
        relative: bool = False,
    ) -> ComplexArray:
        """Return the displacement of a point of the body divided by that of the floor, linear.

        Parameters
        ----------
        nu : array_like
            Circular frequencies (rad/s).
        axis : "x", ..., "rz" or array_like, shape (3,) or (6,)
            Motion of the floor: the direction (3), or the complex amplitudes of all six components
            (m and rad, about the mass centre at rest), which are not scaled.
        point : array_like, shape (3,), optional
            Point of the body (m); None: the mass centre.
        relative : bool
            True: relative to the floor.

        Returns
        -------
        ndarray, shape (*nu.shape, 3)
            Along x, y and z; ``20*log10(abs(...))`` are decibels. For six components the
            displacement itself (m).
        """
        frequencies = _native.real_array("nu", nu)
        direction = np.zeros(len(self.dof_names), dtype=complex)
        direction[:6] = checked_floor("axis", axis)
        self._check_rotor("axis", direction)
        at = frequencies[..., None]
        push = at**2 * (self._mass_matrix @ direction)
        if self._space is not None:
            push = push - 1j * at * (self._space[0] @ direction) - self._space[1] @ direction
        moved = self._solved(frequencies, push)
        if not _native.flag("relative", relative):
            moved = moved + direction
        arm = self._arm("point", point)
        return np.asarray(moved[..., :6] @ np.hstack([np.eye(3), -crossing(arm)]).T)

    def force_transmissibility(
        self,
        nu: npt.ArrayLike,
        axis: str | npt.ArrayLike = "z",
        at: npt.ArrayLike | None = None,
    ) -> ComplexArray:
        """Return the sum of the forces on the floor divided by a force on the body, linear.

        Parameters
        ----------
        nu : array_like
            Circular frequencies (rad/s).
        axis : "x", "y", "z" or array_like, shape (3,)
            Direction of the force.
        at : array_like, shape (3,), optional
            Point of the force (m); None: the mass centre.

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
        # The force on the floor is the force minus the inertia force of the body.
        inertia = -(frequencies[..., None] ** 2) * self.body_mass * moved[..., :3]
        return np.asarray(push[..., :3] - inertia)

    def random_floor(
        self,
        hz: npt.ArrayLike,
        density: npt.ArrayLike,
        axis: str | npt.ArrayLike = "z",
        point: npt.ArrayLike | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Return the acceleration of a point of the body on a randomly moving floor, linear.

        S_body = |H|^2 S_floor, and the mean square is the integral of S over the frequencies.

        Parameters
        ----------
        hz : array_like, shape (n,)
            Frequencies (Hz), ascending.
        density : array_like, shape (n,)
            One-sided spectral density of the floor's acceleration ((m/s^2)^2/Hz); straight lines
            between the frequencies.
        axis, point
            As for `base_transmissibility`.


        Returns
        -------
        density : ndarray, shape (n, 3)
            Spectral densities of the acceleration along x, y and z ((m/s^2)^2/Hz).
        rms : ndarray, shape (3,)
            Root mean squares from the first to the last frequency (m/s^2), including narrow
            resonances between the frequencies.
        """
        frequencies = _native.real_array("hz", hz)
        given = _native.real_array("density", density)
        if frequencies.ndim != 1 or frequencies.size < 2 or (np.diff(frequencies) <= 0).any():
            raise InputError("hz: must be ascending, two or more")
        if given.shape != frequencies.shape or (given < 0).any():
            raise InputError(f"density: must have shape {frequencies.shape}, none negative")

        def gain(at: FloatArray) -> FloatArray:
            answer = self.base_transmissibility(2 * math.pi * at, axis, point)
            return np.asarray(np.abs(answer) ** 2)

        with np.errstate(over="ignore", invalid="ignore"):
            densities = gain(frequencies) * given[:, np.newaxis]
            total = mean_square(gain, frequencies, given)
        if not np.isfinite(total).all():
            raise InputError(f"density = {given.max():g}: no finite mean, must be smaller")
        return densities, np.sqrt(total)

    def engine_orders(
        self, speeds: npt.ArrayLike, orders: npt.ArrayLike, loads: npt.ArrayLike
    ) -> ComplexArray:
        """Return the response to loads at multiples of a speed, linear.

        Parameters
        ----------
        speeds : array_like, shape (n,)
            Speeds of the crankshaft (rad/s).
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
        """Return the modes of n bodies with random mount stiffnesses, to check a suspension.

        Every local stiffness of every mount is multiplied by its own random factor, uniform in [1 -
        spread, 1 + spread]. With kernels each mode has the stiffness at its own frequency in the
        body without scatter.

        Returns
        -------
        hz : ndarray, shape (n, 6)
            Frequencies (Hz) of `modes`, ascending.
        decoupling : ndarray, shape (n, 6)
            The largest kinetic energy share of a coordinate in each mode (percent).
        """
        self._check_real()
        count = _native.integer("n", n, 1, 10_000_000)
        part = _native.number("spread", spread)
        if not 0 <= part < 1:
            raise InputError(f"spread = {part:g}: must be in [0, 1)")
        start = _native.integer("seed", seed, 0, 2**31)
        springs, modes = self._mount_springs, self.modes()
        shape = (count, springs.stiffness.size)
        changes = np.random.default_rng(start).uniform(1 - part, 1 + part, shape) - 1
        if not self._active_kernels:
            squares, energy = self._scattered(self._stiffness_at_rest, changes * springs.stiffness)
            return np.sqrt(np.maximum(squares, 0)) / (2 * math.pi), energy
        hz, decoupling = np.zeros((2, count, modes.omega.size))
        for r, omega in enumerate(modes.omega):
            kept = np.array([
                1.0 if kernel is None or not omega else 1 - np.real(kernel.transform(omega))
                for kernel in springs.kernels
            ])  # fmt: skip
            nominal = stiffness_at(self, omega) if omega else self._stiffness_at_rest
            # The shapes are orthogonal: find this mode among the modes of its stiffness.
            undamped = find_modes(self, nominal)
            like = np.abs(modes.shapes[:, r].conj() @ self._mass_matrix @ undamped.shapes)
            place = int(like.argmax())
            squares, energy = self._scattered(nominal, changes * springs.stiffness * kept)
            decoupling[:, r] = energy[:, place]
            if omega:
                ratios = squares[:, place] / undamped.omega[place] ** 2
                hz[:, r] = modes.hz[r] * np.sqrt(np.maximum(ratios, 0))
        order = np.argsort(hz, axis=1)
        return np.take_along_axis(hz, order, 1), np.take_along_axis(decoupling, order, 1)

    def _scattered(self, nominal: FloatArray, changes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Squared frequencies and decoupling for changes of each spring (n, n_springs)."""
        lower = np.linalg.inv(np.linalg.cholesky(self._mass_matrix))
        scaled = self._mount_springs.rows @ lower.T
        matrices = np.einsum("ja,nj,jb->nab", scaled, changes, scaled, optimize=True)
        squares, vectors = np.linalg.eigh(matrices + lower @ nominal @ lower.T)
        shapes = np.einsum("ba,nbr->nar", lower, vectors)
        energy = 100 * shapes * np.einsum("ab,nbr->nar", self._mass_matrix, shapes)
        return squares, energy.max(axis=1)

    def _solved(self, nu: FloatArray, push: npt.NDArray[Any]) -> ComplexArray:
        found = np.linalg.solve(self.dynamic_stiffness(nu), push[..., None])[..., 0]
        return np.asarray(found)
