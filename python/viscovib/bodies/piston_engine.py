"""Shaking forces, moments and torques of reciprocating engines."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.bodies.checks import checked_axis, checked_vector
from viscovib.common.values import own_fields, short_repr
from viscovib.errors import InputError
from viscovib.systems.frequency_formulas import ONE, KnownTerms

if TYPE_CHECKING:
    from viscovib.bodies.body import Body

#: Samples of a revolution for the series of the slider-crank, whose terms fall geometrically.
_SAMPLES = 4096
#: Largest number, and least length of a rod relative to the crank.
_LARGEST, _SHORTEST = 1e30, 1.001
#: Highest order that may be requested.
_MOST = 50
#: Sums below this part of their largest term are zero.
_ZERO = 1e-13
#: Differences of angles (rad) that are due to numbers of few digits.
_NEAR = 1e-3
#: Intervals of a cycle at least, and points of Gauss's rule in each, for a pressure trace.
_INTERVALS, _POINTS = 256, 8


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PistonEngine:
    r"""A reciprocating engine at constant speed: inertia forces, moments and torque by order.

    At the angle theta from its top dead centre a piston is at x = r cos(theta) + sqrt(l^2 - r^2
    sin^2(theta)) from the crank. With the two-mass model of the connecting rod, cylinder i pushes
    the engine along its axis by

    .. math:: F_i = -m \ddot x = m r \nu^2 (\cos\theta + A_2 \cos 2\theta - A_4 \cos 4\theta \ldots)

    A_2 = (r/l) + (r/l)^3/4 + ..., A_4 = (r/l)^3/4 + ... and the further terms are those of the
    exact motion. The crank receives the torque T = -(m x'' + p A) x', with derivatives by theta
    (times nu^2 for the inertia), and the engine the reaction -T about its shaft. The mean of T goes
    to the driven machine and is not among the loads (`mean_torque`).

    Parameters
    ----------
    crank_radius, rod_length : float
        r, and l > r (m).
    reciprocating_mass : float
        m of one cylinder (kg): the piston and the part of the rod at its pin.
    crank_angles : array_like, shape (n,)
        Angle of the crank throw of each cylinder at t = 0 (rad), from ``up`` by the right-hand rule
        about ``axis``. The shaft turns in this direction.
    positions : array_like, shape (n,)
        Position of each cylinder along ``axis`` (m), from the point ``at``.
    bank_angles : float or array_like, shape (n,)
        Angle of the axis of each cylinder from ``up`` (rad): +-pi/4 for a V engine of 90 degrees.
    rotating_mass : float or array_like, shape (n,)
        Unbalanced mass at each crank pin (kg), negative for a counterweight.
    axis, up : str or array_like, shape (3,)
        Axis of the shaft; direction of the bank angle 0, whose part along ``axis`` is removed.
    at : array_like, shape (3,)
        A point of the shaft (m), in the coordinates of the body.
    strokes : {4, 2}
        A cylinder fires once in two revolutions (half orders), or once in each.
    firing_order : sequence of int, optional
        Numbers of the cylinders (1 to n) as they fire, for four strokes with gas forces and n > 1.
        Each fires at the dead centre nearest to even intervals: check `firing_angles`.
    pressure : tuple of two array_like, optional
        Angles after the firing dead centre (rad), within one cycle and strictly ascending, and
        pressures above that in the crankcase (Pa), linear between them and periodic.
    bore : float, optional
        Diameter of the pistons (m), with ``pressure``.
    gas_torque : mapping, optional
        Instead of the pressure, T of one cylinder by order: T = T_0 + Im sum_k T_k exp(i k theta),
        {0.5: a + 1j * b, ...} (N m) for a sin + b cos. The order 0 is real.
    highest : float
        Highest order of the loads. `neglected` is the sum of the terms above it.

    Attributes
    ----------
    orders : ndarray, shape (m,)
        Multiples of the speed of the shaft: those whose loads are not zero.
    forces, moments : ndarray, shape (m, 3), complex
        Im[c exp(i order nu t)] nu^2: c of the forces (kg m), and of the moments about ``at`` with
        the reaction of the inertia torque (kg m^2).
    gas_moments : ndarray, shape (m, 3), complex
        Reaction of the gas torque (N m).
    firing_angles : ndarray, shape (n,)
        Angles by which the shaft has turned since t = 0 when the cylinders fire (rad).

    Raises
    ------
    InputError
        If shapes differ, the rod is not longer than the crank, or the cylinders cannot fire in
        this order.

    Notes
    -----
    Restrictions: constant speed, cylinder axes through the shaft, equal cylinders, and no couple
    of the rod beyond that of its two masses.

    Source: C. F. Taylor, The Internal-Combustion Engine in Theory and Practice, vol. 2, MIT Press
    1968, ch. 8; J. P. Den Hartog, Mechanical Vibrations, 4th ed., McGraw-Hill 1956, ch. 5.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> four = vv.PistonEngine(
    ...     crank_radius=0.045, rod_length=0.15, reciprocating_mass=0.6,
    ...     crank_angles=(0, np.pi, np.pi, 0), positions=(-0.15, -0.05, 0.05, 0.15),
    ... )
    >>> four.orders  # no force of order 1
    array([2., 4., 6., 8.])
    >>> round(float(abs(four.forces[0, 2]) / (4 * 0.6 * 0.045)), 4)  # A_2 = 0.3 + 0.3^3/4 + ...
    0.3071
    """

    crank_radius: float
    rod_length: float
    reciprocating_mass: float
    crank_angles: npt.ArrayLike
    positions: npt.ArrayLike
    bank_angles: npt.ArrayLike = 0.0
    rotating_mass: npt.ArrayLike = 0.0
    axis: str | npt.ArrayLike = "x"
    up: str | npt.ArrayLike = "z"
    at: npt.ArrayLike = (0.0, 0.0, 0.0)
    strokes: int = 4
    firing_order: Sequence[int] | None = None
    pressure: tuple[npt.ArrayLike, npt.ArrayLike] | None = None
    bore: float | None = None
    gas_torque: Mapping[float, complex] | None = None
    highest: float = 8.0

    __repr__ = short_repr

    def __post_init__(self) -> None:
        own_fields(
            self, "crank_angles", "positions", "bank_angles", "rotating_mass", "axis", "up", "at",
            "firing_order", "pressure", "gas_torque",
        )  # fmt: skip
        for name in ("crank_radius", "rod_length", "reciprocating_mass"):
            value = _native.number(name, getattr(self, name))
            if not value > 0:
                raise InputError(f"{name} = {value:g}: must be greater than 0")
            if not 1 / _LARGEST <= value <= _LARGEST:
                raise InputError(f"{name} = {value:g}: must be at most {_LARGEST:g}, or 1 over it")
        if not self.rod_length >= _SHORTEST * self.crank_radius:
            raise InputError(
                f"rod_length = {self.rod_length:g}: must be at least {_SHORTEST:g} crank_radius, "
                f"{_SHORTEST * self.crank_radius:g}"
            )
        if _native.integer("strokes", self.strokes, 2, 4) == 3:
            raise InputError(f"strokes = {_native.shown(self.strokes)}: must be 4 or 2")
        if not 1 <= _native.number("highest", self.highest) <= _MOST:
            raise InputError(f"highest = {self.highest:g}: must be 1 to {_MOST}")
        if (self.pressure is None) != (self.bore is None):
            raise InputError("pressure, bore: must be given together")
        if self.pressure is not None and self.gas_torque is not None:
            raise InputError("pressure, gas_torque: must not both be given")
        checked_vector("at", self.at)
        _ = self.orders

    @cached_property
    def _angles(self) -> FloatArray:
        """Angles of the throws and of the cylinders, and positions, shape (3, n)."""
        angles = _native.real_array("crank_angles", self.crank_angles, ndim=1)
        if not angles.size:
            raise InputError("crank_angles: must have a number of each cylinder, got none")
        return np.array([angles, self._each("bank_angles"), self._each("positions")])

    def _each(self, name: str) -> FloatArray:
        """A number of each cylinder; one number is that of all."""
        given = _native.real_array(name, getattr(self, name))
        n = np.size(self.crank_angles)
        if given.shape != (n,) and not (given.ndim == 0 and (n == 1 or name != "positions")):
            raise InputError(f"{name}: must have shape ({n},), as crank_angles, got {given.shape}")
        if not (np.abs(given) <= _LARGEST).all():
            raise InputError(f"{name}: must be at most {_LARGEST:g}")
        return np.asarray(np.broadcast_to(given, n))

    @cached_property
    def _axes(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Unit vectors along the shaft, up, and a quarter turn from it."""
        along, up = checked_axis("axis", self.axis), checked_axis("up", self.up)
        across = np.cross(along, up)
        if not np.linalg.norm(across) > 1e-6:
            raise InputError("up: must not be parallel to axis")
        across /= np.linalg.norm(across)
        return along, np.cross(across, along), across

    def _motion(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives x' and x'' by theta (m)."""
        s, c = self.crank_radius * np.sin(theta), self.crank_radius * np.cos(theta)
        height = np.sqrt(self.rod_length**2 - s**2)
        return -s - s * c / height, -c + (s**2 - c**2) / height - (s * c) ** 2 / height**3

    @cached_property
    def _series(self) -> tuple[ComplexArray, ComplexArray]:
        """Series of force and torque of one cylinder over nu^2, by order 0, 1, ...: Im sum c e."""
        speed, acceleration = self._motion(np.linspace(0, 2 * math.pi, _SAMPLES, endpoint=False))
        force = -self.reciprocating_mass * acceleration
        return 2j * np.fft.rfft(force) / _SAMPLES, 2j * np.fft.rfft(force * speed) / _SAMPLES

    @property
    def neglected(self) -> float:
        """Sum of the inertia forces of one cylinder above ``highest``, relative to m r nu^2."""
        terms = np.abs(self._series[0][int(self.highest) + 1 :])
        # Terms of rounding errors.
        kept = terms > 1e-15 * self.reciprocating_mass * self.crank_radius
        return float(terms[kept].sum() / (self.reciprocating_mass * self.crank_radius))

    @cached_property
    def _gas(self) -> dict[float, complex]:
        """The gas torque T of one cylinder by order, from its firing dead centre."""
        step = 2.0 / self.strokes
        if self.gas_torque is not None:
            found = {}
            for order, value in _native.mapping("gas_torque", self.gas_torque).items():
                k = _native.number("gas_torque", order)
                if not 0 <= k <= _MOST or k % step:
                    raise InputError(
                        f"gas_torque[{k:g}]: orders must be 0, {step:g}, {2 * step:g}, ... {_MOST}"
                    )
                found[k] = complex(_native.complex_array(f"gas_torque[{k:g}]", value, ndim=0))
            if np.imag(found.get(0.0, 0.0)) != 0:
                raise InputError("gas_torque[0]: is the mean, must be real")
            return found
        if self.pressure is None:
            return {}
        angles, values = self._trace()
        bore = _native.number("bore", self.bore)
        if not 0 < bore <= _LARGEST:
            raise InputError(f"bore = {bore:g}: must be greater than 0 and at most {_LARGEST:g}")
        cycle = 2 * math.pi / step
        ends = np.union1d(np.linspace(0, cycle, _INTERVALS + 1), angles % cycle)
        points, weights = np.polynomial.legendre.leggauss(_POINTS)
        theta = ends[:-1, np.newaxis] + 0.5 * np.diff(ends)[:, np.newaxis] * (points + 1)
        parts = 0.5 * np.diff(ends)[:, np.newaxis] * weights
        torque = (
            -0.25
            * math.pi
            * bore**2
            * np.interp(theta, angles, values, period=cycle)
            * self._motion(theta)[0]
        )
        orders = np.arange(0, self.highest + 1e-9, step)
        sums = [(parts * torque * np.exp(-1j * k * theta)).sum() / cycle for k in orders]
        return {k: (2j if k else 1) * c for k, c in zip(orders.tolist(), sums, strict=True)}

    def _trace(self) -> tuple[FloatArray, FloatArray]:
        """Angles and pressures."""
        if not isinstance(self.pressure, (tuple, list)) or len(self.pressure) != 2:
            raise InputError("pressure: must be two arrays, angles (rad) and pressures (Pa)")
        angles, values = (_native.real_array("pressure", one, ndim=1) for one in self.pressure)
        if angles.shape != values.shape or angles.size < 3:
            raise InputError(
                f"pressure: must be two arrays of the same size, at least 3, got {angles.shape} "
                f"and {values.shape}"
            )
        if not (np.abs(values) <= _LARGEST).all():
            raise InputError(f"pressure: must be at most {_LARGEST:g}")
        cycle = math.pi * self.strokes
        if (np.diff(angles) <= 0).any() or angles[-1] - angles[0] > cycle * (1 + 1e-12):
            raise InputError(
                f"pressure: angles must ascend and span at most a cycle, {cycle:.6g} rad (not "
                "degrees)"
            )
        return angles, values

    @property
    def firing_angles(self) -> FloatArray:
        """Angles by which the shaft has turned since t = 0 when each cylinder fires (rad)."""
        throws, banks, _ = self._angles
        n, turn = throws.size, 2 * math.pi
        first = np.asarray((banks - throws) % turn)
        if self.strokes == 2 or n == 1:
            return first
        if self.firing_order is None:
            raise InputError("firing_order: is needed with gas forces and four strokes")
        order = _native.real_array("firing_order", self.firing_order, ndim=1) - 1
        if sorted(order.tolist()) != list(range(n)):
            raise InputError(
                f"firing_order = {_native.shown(self.firing_order)}: must contain each of 1 to {n}"
                " once"
            )
        order = order.astype(int)
        start, even = first[order[0]], np.arange(n) * (2 * turn / n)
        # Two dead centres of each cylinder, relative to even intervals.
        late = (first[order] - start) % turn + np.array([[0.0], [turn]])
        off = (late - even + turn) % (2 * turn) - turn
        chosen = (np.abs(off) + _NEAR * (off > 0)).argmin(axis=0)
        off = np.take_along_axis(off, chosen[np.newaxis], 0)[0]
        if np.ptp(off) > 2 * turn / n - _NEAR:
            raise InputError(
                f"firing_order = {_native.shown(self.firing_order)}: the cylinders do not reach "
                "their dead centres in this order; check crank_angles, bank_angles and the "
                "direction of rotation"
            )
        found = np.empty(n)
        found[order] = start + even + off
        return np.asarray(found)

    @property
    def mean_torque(self) -> float:
        """Mean torque of all cylinders on the shaft (N m)."""
        return float(np.real(self._gas.get(0.0, 0.0))) * np.size(self.crank_angles)

    @cached_property
    def _loads(self) -> tuple[FloatArray, ComplexArray]:
        """Orders, and forces, moments and gas moments by order, shape (3, m, 3)."""
        along, up, across = self._axes
        throws, banks, places = self._angles
        turned = throws - banks
        cylinders = np.outer(np.cos(banks), up) + np.outer(np.sin(banks), across)
        pins = np.exp(1j * throws)[:, np.newaxis] * (1j * up + across)
        pins = (self._each("rotating_mass") * self.crank_radius)[:, np.newaxis] * pins
        force, torque = self._series
        gas = self._gas
        fires = self.firing_angles if gas else turned
        orders = np.arange(0.5, self.highest + 1e-9, 0.5)
        parts = np.zeros((3, orders.size, throws.size, 3), dtype=complex)
        for j, order in enumerate(orders.tolist()):
            k = int(order)
            if order == k:
                phases = np.exp(1j * k * turned)[:, np.newaxis]
                parts[0, j] = force[k] * phases * cylinders
                if k == 1:
                    parts[0, j] += pins
                parts[1, j] = np.cross(places[:, np.newaxis] * along, parts[0, j])
                parts[1, j] -= torque[k] * phases * along
            parts[2, j] = -gas.get(order, 0) * np.outer(np.exp(-1j * order * fires), along)
        sums = parts.sum(axis=2)
        largest = np.abs(parts).sum(axis=2).max(axis=(1, 2), keepdims=True)
        sums[np.abs(sums) <= _ZERO * largest] = 0
        acts = sums.any(axis=(0, 2))
        return orders[acts], sums[:, acts]

    @property
    def orders(self) -> FloatArray:
        """Orders of the loads that are not zero, shape (m,)."""
        return np.array(self._loads[0])

    @property
    def forces(self) -> ComplexArray:
        """Inertia forces over nu^2 (kg m), shape (m, 3)."""
        return np.array(self._loads[1][0])

    @property
    def moments(self) -> ComplexArray:
        """Moments of inertia forces about ``at`` over nu^2 (kg m^2), shape (m, 3)."""
        return np.array(self._loads[1][1])

    @property
    def gas_moments(self) -> ComplexArray:
        """Reaction of the gas torque (N m), shape (m, 3)."""
        return np.array(self._loads[1][2])

    def _on(self, body: Body) -> tuple[ComplexArray, ComplexArray]:
        """Loads on a body over nu^2, and independent of nu, each of shape (m, n_dof)."""
        from viscovib.bodies.body import Body

        _native.check_instance("body", body, Body)
        inertia = [
            body.load(force=one, torque=moment, at=self.at)
            for one, moment in zip(self.forces, self.moments, strict=True)
        ]
        gas = [body.load(torque=one) for one in self.gas_moments]
        shape = (len(inertia), len(body.dof_names))
        return np.reshape(inertia, shape), np.reshape(gas, shape)

    def amplitudes(self, body: Body, speeds: npt.ArrayLike) -> ComplexArray:
        """Return the loads of all orders on a body, for `Body.engine_orders`.

        Parameters
        ----------
        body : Body
            A body whose mount positions and ``at`` have the same origin.
        speeds : array_like, shape (n,)
            Speeds of the shaft (rad/s).

        Returns
        -------
        ndarray, shape (n, m, n_dof)
            Amplitudes by speed and by order (``orders``).
        """
        nu = _native.real_array("speeds", speeds, ndim=1)
        inertia, gas = self._on(body)
        return np.asarray(np.multiply.outer(nu**2, inertia) + gas)

    def load(self, body: Body, *, per: str = "revolution") -> dict[int, dict[str, Any]]:
        """Return the loads of all orders on a body as formulas in nu, along branches too.

        Parameters
        ----------
        body : Body
            A body whose mount positions and ``at`` have the same origin.
        per : {"revolution", "cycle"}
            The meaning of nu: the speed of the shaft, or half of it, for half orders. The harmonic
            of nu is then the order, or twice the order.

        Returns
        -------
        dict
            For ``load=`` of `forced_response`, `trace_response` and `simulate`.

        Examples
        --------
        >>> import viscovib as vv
        >>> foot = vv.MountPoint(name="foot", position=(0, 0, 0), stiffness=(1e5, 1e5, 1e5))
        >>> body = vv.Body(mass=100, inertia=(2, 5, 5), mounts=[foot])
        >>> single = vv.PistonEngine(
        ...     crank_radius=0.04, rod_length=0.14, reciprocating_mass=0.5, crank_angles=[0],
        ...     positions=[0],
        ... )
        >>> list(single.load(body))
        [1, 2, 3, 4, 5, 6, 7, 8]
        """
        times = 1 + (_native.choice("per", per, ("revolution", "cycle")) == "cycle")
        harmonics = self.orders * times
        if (harmonics % 1).any():
            raise InputError(
                f"per = {per!r}: the engine has half orders, must be 'cycle': nu is then half the "
                "speed of the shaft"
            )
        found: dict[int, dict[str, Any]] = {}
        for k, inertia, gas in zip(harmonics.astype(int).tolist(), *self._on(body), strict=True):
            found[k] = {}
            for name, a, b in zip(body.dof_names, inertia, gas, strict=True):
                terms = {"nu^2": complex(times**2 * a), ONE: complex(b)}
                kept = {formula: value for formula, value in terms.items() if value}
                if kept:
                    found[k][name] = KnownTerms(kept) if a else complex(b)
        return found
