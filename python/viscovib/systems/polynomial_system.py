"""User-defined systems of n degrees of freedom with force laws and memory."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.common.values import own_fields
from viscovib.errors import InputError
from viscovib.kernels.relaxation import Kernel
from viscovib.systems.characteristic import CharacteristicRoots, characteristic_roots
from viscovib.systems.condensed import Condensation, LoadedStructure
from viscovib.systems.element_laws import different, laws_of_groups
from viscovib.systems.laws import Law, named_in, parameter_values, spell
from viscovib.systems.load import (
    LoadLike,
    for_recent_loads,
    load_series,
    name_places,
    parts_of,
)
from viscovib.systems.mount import dynamic_stiffness, warn_of_creep
from viscovib.systems.python_law import python_laws
from viscovib.systems.speed_matrices import MOST_WITH_SPEED, NO_EFFECT, OF_SPEED, WithSpeed
from viscovib.systems.spring_groups import (
    Forces,
    SpringGroup,
    Springs,
    spring_group,
    square_matrix,
    texts_of,
)
from viscovib.systems.stiffness_ratio import warn_of_lost_springs

#: Bounds of coordinates: in dense matrices; with forces or memory in more than half of them.
_MAX_COORDINATES, _MAX_WHOLE, _FEW = 2000, 64, 8
#: Kernel kind in x that marks a vector that contains all kernels for the core.
_KERNELS_IN_VECTOR = -2


@dataclass(frozen=True, kw_only=True, eq=False)
class PolynomialSystem(WithSpeed):
    """M u'' + C u' + sum_g (1 - R_g*) [K_g u + f_g(u, u')] = load(t).

    All forces are on the left side, like the stiffness: a hardening spring has positive
    coefficients. Linear terms in ``forces`` are added to ``stiffness`` internally (the attribute
    stays as given), and without a kernel to the damping.

    Parameters
    ----------
    mass : array_like
        M, symmetric and positive definite: a number (one coordinate), n numbers (a diagonal matrix)
        or shape (n, n); n up to 64, or to 2000 if forces and kernels act in at most half of the
        coordinates and in at most 64.
    stiffness : array_like, optional
        K: a number, n numbers or shape (n, n); None: zero. It may be indefinite or unsymmetric
        (follower forces).
    forces : str, mapping or sequence of Monomial, optional
        Nonlinear forces f. For one coordinate a text such as ``"0.5*x^3"``; else ``{"x1": "2*(x1 -
        x2)^3", "x2": "2*(x2 - x1)^3"}``, by equation, or a list of such texts, one per coordinate.
        Polynomials use +, -, *, /, ^ and integer powers, degree up to 15. Texts with functions,
        such as ``"tanh(x)"`` or ``"max(x1 - x2 - 0.1, 0)"``, have the syntax of `Spring`. Texts may
        contain rates, such as ``"0.2*x_dot*abs(x_dot)"``: ``x_dot`` is the rate of ``x``. Also
        Python functions (`PythonLaw`), or `Monomial` objects.
    kernel : Kernel, optional
        Relaxation kernel of this stiffness and these forces; None: no memory.
    damping : array_like, optional
        C, viscous damping, in the same forms as the stiffness.
    springs : sequence of Springs, optional
        Further groups of springs, each with its own kernel.
    names : sequence of str, optional
        Names of the coordinates; default "x", or "x1", "x2", ...
    units : sequence of str, optional
        Units of the coordinates; default "m".
    base_direction : array_like, shape (n,), optional
        Motion of the coordinates with the base without deformation of a spring, for example ones
        for a chain of masses; None: the base is fixed. If the mass matrix couples coordinates to
        the supports by a block M_fs, add the load -M_fs a with the acceleration a of the supports.
    parameters : mapping of str to float, optional
        Numbers in the forces, also those of ``springs``; each may vary along a branch
        (``vary="k3"``).
    gyroscopic : array_like, shape (n, n), optional
        G, skew: the damping of a rotor at the speed Omega is C + Omega G. Up to 512
        coordinates.
    circulatory, centrifugal : array_like, optional
        K1 and K2, in the forms of the stiffness: the stiffness at the speed Omega is K + Omega K1 +
        Omega^2 K2, without memory in the last two terms. K1 comes from the damping of rotating
        parts (internal damping), K2 from centrifugal forces.
    speed : float, optional
        Speed Omega (rad/s) of the three matrices. None: the frequency nu of the load; an analysis
        without a load frequency then refuses the system. For a speed of r nu, multiply G and K1 by
        r and K2 by r^2.

    Warns
    -----
    StabilityWarning
        If the integral of a kernel is not between 0 and 1.
    RangeWarning
        If the stiffness of springs differs so much that rounding errors affect the soft springs:
        the relative error of the square of a frequency exceeds 1e-6.

    Examples
    --------
    >>> import viscovib as vv
    >>> chain = vv.PolynomialSystem(
    ...     mass=[1, 1],
    ...     stiffness=[[2, -1], [-1, 2]],
    ...     damping=[0.1, 0.1],
    ...     forces={"x1": "x1^3"},
    ... )
    >>> chain.dof_names
    ('x1', 'x2')
    """

    mass: npt.ArrayLike
    stiffness: npt.ArrayLike | None = None
    forces: Forces = None
    kernel: Kernel | None = None
    damping: npt.ArrayLike | None = None
    springs: Sequence[Springs] = ()
    names: Sequence[str] | None = None
    units: Sequence[str] | None = None
    base_direction: npt.ArrayLike | None = None
    parameters: Mapping[str, float] | None = None
    gyroscopic: npt.ArrayLike | None = None
    circulatory: npt.ArrayLike | None = None
    centrifugal: npt.ArrayLike | None = None
    speed: float | None = None

    time_unit: ClassVar[str] = "s"
    #: True if the core has forces that ``groups`` does not contain.
    _has_hidden_forces: ClassVar[bool] = False
    dof_names: tuple[str, ...] = field(init=False, repr=False)
    dof_units: tuple[str, ...] = field(init=False, repr=False)
    #: All groups; the first has the stiffness, forces and kernel of this system.
    groups: tuple[SpringGroup, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        own_fields(self, "stiffness", "forces", "springs", "names", "units")
        mass = square_matrix("mass", self.mass, None)
        n = mass.shape[0]
        if not 1 <= n <= _MAX_COORDINATES:
            raise InputError(f"mass: {n} coordinates, must be 1 to {_MAX_COORDINATES}")
        self._set("mass", mass)
        names = ("x",) if n == 1 else tuple(f"x{d + 1}" for d in range(n))
        self._set("dof_names", texts_of("names", names if self.names is None else self.names, n))
        for name in self.dof_names:
            fits = name.isascii() and name.isidentifier() and len(name) <= 16
            if not fits or name == "t" or name.endswith("_dot"):
                raise InputError(
                    f"names: {name!r} must be letters, digits and _, not begin with a digit, have "
                    "at most 16 characters, and not be t or end in _dot"
                )
        if len(set(self.dof_names)) < n:
            raise InputError(f"names = {', '.join(self.dof_names)}: must differ")
        units = ("m",) * n if self.units is None else self.units
        self._set("dof_units", texts_of("units", units, n))
        self._set("damping", square_matrix("damping", self.damping, n))
        if not isinstance(self.springs, (list, tuple)):
            raise InputError("springs: must be a sequence of Springs, such as [Springs(...)]")
        self._set("forces", python_laws(self.forces))
        own = Springs(stiffness=self.stiffness, forces=self.forces, kernel=self.kernel)
        rates = [f"{name}_dot" for name in self.dof_names]
        values = parameter_values(self.parameters, (*self.dof_names, *rates))
        self._set("parameters", values or None)
        groups = [spring_group("", own, self.dof_names, values)]
        for i, springs in enumerate(self.springs):
            if not isinstance(springs, Springs):
                raise InputError(f"springs[{i}] = {_native.shown(springs)}: must be Springs")
            groups.append(spring_group(f"springs[{i}].", springs, self.dof_names, values))
        self._set("stiffness", square_matrix("stiffness", self.stiffness, n))
        self._set("groups", tuple(groups))
        if self.base_direction is not None:
            direction = _native.real_array("base_direction", self.base_direction).copy()
            if direction.shape != (n,):
                raise InputError(f"base_direction: must have shape ({n},), got {direction.shape}")
            direction.setflags(write=False)
            self._set("base_direction", direction)
        self._read_speed()
        if n <= _MAX_WHOLE or self._depends_on_speed:
            handle = _native.polynomial_object(self._vector)
            if 1 < n <= _MAX_WHOLE:
                warn_of_lost_springs(handle)
        else:
            self._check_large()
        warn_of_creep([kernel.integral for kernel in self._active_kernels])

    def _read_speed(self) -> None:
        """Check the matrices that depend on the speed; with a speed they become constant."""
        n = len(self.dof_names)
        given = [name for name in OF_SPEED if getattr(self, name) is not None]
        for name in given:
            if n > MOST_WITH_SPEED:
                raise InputError(f"{name}: {n} coordinates, must be 1 to {MOST_WITH_SPEED}")
            self._set(name, square_matrix(name, getattr(self, name), n))
        if self.speed is None:
            return
        if not given:
            raise InputError(NO_EFFECT)
        speed = _native.number("speed", self.speed)
        # The core checks the matrices.
        self._set("speed", None)
        _native.polynomial_object(self._numbers())
        self._set("speed", speed)
        del self.__dict__["_damping"]
        with np.errstate(over="ignore", invalid="ignore"):
            _, circulatory, centrifugal = self._speed_matrices
            turning = speed * (circulatory + speed * centrifugal)
        self._set("groups", (*self.groups, SpringGroup(turning, {}, None, given=turning)))

    @property
    def _speed_matrices(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The gyroscopic, circulatory and centrifugal matrix."""
        given = (getattr(self, name) for name in OF_SPEED)
        none = np.zeros_like(self._mass_matrix)
        gyroscopic, circulatory, centrifugal = (none if one is None else one for one in given)
        return gyroscopic, circulatory, centrifugal

    @property
    def _named_parameters(self) -> tuple[str, ...]:
        """The parameters that occur in the forces."""
        return named_in(self.parameters or (), self.forces, *(one.forces for one in self.springs))

    @property
    def _parameter_names(self) -> tuple[str, ...]:
        return self._named_parameters

    @property
    def _scales(self) -> tuple[str, ...]:
        return ("stiffness_scale", "damping_scale", "forces_scale", "memory_scale")

    def _with_parameters(self, numbers: Mapping[str, float]) -> PolynomialSystem:
        return replace(self, parameters={**(self.parameters or {}), **numbers})

    def _with_slopes_of(self, other: PolynomialSystem) -> PolynomialSystem:
        """Return the system with the linear parts of the laws of ``other`` kept separate."""
        found = copy(self)
        pairs = zip(self.groups, other.groups, strict=True)
        found._set("groups", tuple(own.with_slopes_of(group) for own, group in pairs))
        kind = type(found)
        for name in list(found.__dict__):
            if isinstance(getattr(kind, name, None), cached_property):
                del found.__dict__[name]
        return found

    def _check_large(self) -> None:
        """Check a system with more coordinates than the core accepts: it must be condensable."""
        n = len(self.dof_names)
        symmetric = np.abs(self._mass_matrix - self._mass_matrix.T).max()
        try:
            np.linalg.cholesky(self._mass_matrix)
        except np.linalg.LinAlgError:
            symmetric = np.inf
        if symmetric > 1e-12 * np.abs(self._mass_matrix).max():
            raise InputError("mass: must be symmetric and positive definite")
        condensed = self._condensation
        if condensed is None or condensed.q > _MAX_WHOLE:
            raise InputError(
                f"mass: {n} coordinates, must be 1 to {_MAX_WHOLE} unless forces or memory act in "
                f"half of them or fewer, and in at most {_MAX_WHOLE}"
            )
        _native.polynomial_object(condensed.law_vector(np.zeros(condensed.q)))

    @cached_property
    def _condensation(self) -> Condensation | None:
        """The system condensed to coordinates with forces or memory; None: these are too many."""
        from viscovib.systems.polynomial_laws import condensation_of

        if self._depends_on_speed:
            return None
        note = len(self.dof_names) <= _MAX_WHOLE
        return condensation_of(self._mass_matrix, self._damping, self.groups, quiet=note)

    @cached_property
    def _modes_in_time(self) -> Condensation | None:
        """The system in modes for motions in time, with exact fast decay; None: no modes."""
        from viscovib.systems.polynomial_laws import condensation_of

        return condensation_of(
            self._mass_matrix, self._damping, self.groups, quiet=True, always=True
        )

    @property
    def _may_be_whole(self) -> bool:
        """True if linear motions in all coordinates are as fast."""
        return len(self.dof_names) <= _FEW

    def _condenses(self, stability: bool) -> bool:
        """True if motions (and their stability, if computed) are faster when condensed."""
        from viscovib.systems.polynomial_laws import checked_condensed

        n = len(self.dof_names)
        always = n > _MAX_WHOLE or self._has_kinks
        if self._condensation is None or not stability or always:
            return self._condensation is not None
        return checked_condensed(n, self._condensation.q, bool(self._active_kernels))

    @for_recent_loads
    def _loaded(
        self, load: LoadLike | None, base: LoadLike | None, _: float | None = None
    ) -> LoadedStructure:
        """The condensed system under a load."""
        condensation = self._condensation or self._modes_in_time
        assert condensation is not None
        n = len(self.dof_names)
        places = name_places(self.dof_names)
        constant, varying = parts_of(load, n, places)
        orders, series = load_series(constant, base, n, places)
        direction = self._base_direction
        inertia = np.zeros(n) if direction is None else self._mass_matrix @ direction
        return LoadedStructure.of(condensation, orders, series, inertia, direction, varying)

    def _wanted(self, coordinates: Sequence[str] | None, _: LoadedStructure) -> Any:
        """Indices of the coordinates in results: all."""
        if coordinates is not None:
            raise InputError("coordinates: can be chosen for a structure only, must be None")
        return np.arange(len(self.dof_names))

    @property
    def rate_units(self) -> tuple[str, ...]:
        """Units of the velocities."""
        return tuple(f"{unit}/s" for unit in self.dof_units)

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def natural_frequencies(self) -> FloatArray:
        """Undamped natural circular frequencies at rest without memory (rad/s), ascending.

        For a rotor with a gyroscopic matrix see `campbell`.
        """
        return self._modes[0].copy()

    def mode_shapes(self) -> FloatArray:
        """Mode shapes as columns, shape (n, n), the largest entry of each 1."""
        return self._modes[1].copy()

    def characteristic_roots(self) -> CharacteristicRoots:
        """Roots of det[s^2 M + s C + sum_g (K_g + s C_g) (1 - R_g(s))] = 0 at rest.

        They are the decay and frequency of free motion. C_g is the linear part of the laws of a
        group with a kernel in the rates.
        """
        return characteristic_roots(self._turned()._handle, len(self.dof_names))

    def dynamic_stiffness(self, nu: npt.ArrayLike) -> ComplexArray:
        """D(nu), shape nu.shape + (n, n), for u = Im(X exp(i nu t)).

        sum_g (K_g + i nu C_g) (1 - R_g(nu)) + i nu C - nu^2 M. C_g is the linear part of the laws
        of a group with a kernel in the rates. Matrices that depend on the speed are those at nu, or
        at ``speed``.
        """
        found = dynamic_stiffness(self, nu)
        for group in self.groups:
            if group.law_dampers is not None and group.kernel is not None:
                at = np.asarray(nu, dtype=float)
                kept = 1j * at * (1 - np.asarray(group.kernel.transform(at)))
                found += kept[..., np.newaxis, np.newaxis] * group.law_dampers
        return found

    def _fastest(self) -> float:
        """Upper bound of the rates of the linear system without memory (1/s), as in the core."""
        return self._linear_rate

    @cached_property
    def _linear_rate(self) -> float:
        inverse = np.linalg.inv(self._mass_matrix)
        stiffness = np.abs(inverse @ self._stiffness_at_rest).sum(axis=1).max()
        return float(np.sqrt(stiffness) + np.abs(inverse @ self._damping).sum(axis=1).max())

    def energy(self, state: npt.ArrayLike) -> FloatArray:
        """Kinetic and potential energy at states (u_1, u_1', u_2, ...), shape (..., 2 n).

        The forces, all without memory, must have a potential: d f_a/d u_b = d f_b/d u_a.
        """
        n = len(self.dof_names)
        states = _native.real_array("state", state)
        if states.shape[-1:] != (2 * n,):
            raise InputError(f"state: must have shape (..., {2 * n}), got {states.shape}")
        u, v = states[..., ::2], states[..., 1::2]
        stiffness, forces = self._conservative
        with np.errstate(over="ignore", invalid="ignore"):
            total = 0.5 * np.einsum("...a,ab,...b", v, self._mass_matrix, v)
            total += 0.5 * np.einsum("...a,ab,...b", u, stiffness, u)
            # Euler: a potential of degree d + 1 has u . f = (d + 1) V.
            for (on, powers), c in forces.items():
                shape = np.prod(u ** np.array(powers), axis=-1)
                total += c / (sum(powers) + 1) * u[..., on] * shape
        _native.check_states(states, np.asarray(total), "the energy")
        return np.asarray(total)

    @property
    def _all_laws(self) -> tuple[Law, ...]:
        return tuple(law for group in self.groups for _, law in group.laws)

    def _laws_at(
        self, q: FloatArray, v: FloatArray
    ) -> Iterator[tuple[Law, FloatArray, FloatArray]]:
        arguments = np.concatenate([q, v], axis=-1)
        rates = np.concatenate([v, np.zeros_like(v)], axis=-1)
        for law in self._all_laws:
            n = len(law.arguments)
            yield law, arguments[..., :n], rates[..., :n]

    @property
    def _mass_matrix(self) -> FloatArray:
        return np.asarray(self.mass, dtype=float)

    @cached_property
    def _damping(self) -> FloatArray:
        """C with the linear parts of laws of rates."""
        total = np.asarray(self.damping, dtype=float)
        for group in self.groups:
            if group.law_damping is not None:
                total = total + group.law_damping
        if self.speed is not None:
            total = total + self.speed * self._speed_matrices[0]
        return total

    @cached_property
    def _modes(self) -> tuple[FloatArray, FloatArray]:
        self._refuse_gyroscopic()
        found = _native.run("system modes", self._handle)
        shapes = found["shapes"]
        largest = np.take_along_axis(shapes, np.abs(shapes).argmax(axis=0)[np.newaxis], axis=0)
        return found["omega"], np.ascontiguousarray(shapes / largest)

    @cached_property
    def _stiffness_at_rest(self) -> FloatArray:
        return np.asarray(sum(group.stiffness for group in self.groups))

    @cached_property
    def _conservative(self) -> tuple[FloatArray, dict[tuple[int, tuple[int, ...]], float]]:
        """Stiffness and forces of all groups, if they have a potential."""
        self._turned()
        if self._active_kernels:
            raise InputError("kernel: energy is not defined with memory")
        if any(group.laws for group in self.groups):
            raise InputError("forces: are not polynomials, so their potential is unknown")
        stiffness = self._stiffness_at_rest
        if not np.allclose(stiffness, stiffness.T, rtol=1e-12, atol=0):
            raise InputError("stiffness: must be symmetric for forces to have a potential")
        forces: dict[tuple[int, tuple[int, ...]], float] = {}
        for group in self.groups:
            for key, c in group.forces.items():
                forces[key] = forces.get(key, 0.0) + c
        for (on, powers), c in forces.items():
            for b, p in enumerate(powers):
                if b == on or not p:
                    continue
                # c p u^(powers - e_b) must equal the derivative of f_b with respect to u_on.
                other = list(powers)
                other[b] -= 1
                other[on] += 1
                expected = forces.get((b, tuple(other)), 0.0) * other[on]
                if abs(expected - c * p) > 1e-12 * abs(c * p):
                    raise InputError(
                        f"forces: {spell(powers, self.dof_names)} on {self.dof_names[on]} has no "
                        f"potential: {self.dof_names[b]} lacks its counterpart"
                    )
        return stiffness, forces

    @property
    def _flat(self) -> FloatArray:
        """The vector of numbers for the core."""
        return self._vector

    @property
    def _masses(self) -> slice:
        """Indices of the masses in this vector."""
        return slice(5, 5 + len(self.dof_names) ** 2)

    @cached_property
    def _vector(self) -> FloatArray:
        return self._numbers()

    def _numbers(self, only: int | None = None) -> FloatArray:
        """Return the system as numbers for the core, or ``only`` one of its groups.

        The damping matrix belongs to the first group.
        """
        n = len(self.dof_names)
        groups = self.groups if only is None else self.groups[only : only + 1]
        direction = np.zeros(n) if self.base_direction is None else self.base_direction
        damping = self._damping if (only or 0) == 0 else np.zeros((n, n))
        more: list[FloatArray] = []
        if only is None:
            more = [*(self._space or ()), *(self._speed_matrices if self._depends_on_speed else ())]
        laws = laws_of_groups(groups)
        return laws.vector(self._mass_matrix, damping, np.asarray(direction), more)

    @property
    def _kernels(self) -> tuple[int, FloatArray, int, FloatArray]:
        nothing = np.zeros(1)
        return _KERNELS_IN_VECTOR, nothing, 0, nothing

    @cached_property
    def _handle(self) -> _native.Handle:
        """The system in the core."""
        return _native.oscillator_object(self._flat, self._kernels)

    @cached_property
    def _active_kernels(self) -> tuple[Kernel, ...]:
        return tuple(different([group.kernel for group in self.groups]))

    @property
    def _space(self) -> tuple[FloatArray, FloatArray] | None:
        """Damping and stiffness relative to the inertial frame instead of the moving base."""
        return None

    @property
    def _base_names(self) -> tuple[str, ...]:
        """The first coordinates, which the base may move with separate amplitudes."""
        return self.dof_names

    def _check_base_motion(self, moved: npt.NDArray[Any]) -> None:
        """Refuse impossible displacements of coordinates by the base, shape (n, ...)."""

    @property
    def _base_direction(self) -> FloatArray | None:
        return None if self.base_direction is None else np.asarray(self.base_direction)
