"""Structures of any number of coordinates with local elements, condensed to their deflections."""

import os
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.common.values import own_fields
from viscovib.errors import InputError
from viscovib.kernels.relaxation import Kernel
from viscovib.systems.condensed import Condensation, LoadedStructure
from viscovib.systems.element_laws import element_laws
from viscovib.systems.elements import (
    Coupling,
    CouplingTerms,
    ElementTerms,
    direction_of,
    element_terms,
    terms_in_order,
)
from viscovib.systems.laws import Law, named_in
from viscovib.systems.layers import Layers, checked_layers
from viscovib.systems.load import (
    LoadLike,
    VaryingForce,
    for_recent_loads,
    load_series,
    name_places,
    parts_of,
)
from viscovib.systems.mount import warn_of_creep
from viscovib.systems.own_supports import harmonics_apart, moves_apart, with_forces
from viscovib.systems.penalty_supports import (
    fixed,
    fixed_elements,
    held_stiffness,
    penalty_supports,
    warn_of_supports,
)
from viscovib.systems.relaxing_rest import relaxing_rest
from viscovib.systems.speed_matrices import NO_EFFECT, OF_SPEED, WithSpeed, check_skew
from viscovib.systems.spring_groups import texts_of
from viscovib.systems.structure_matrices import (
    block_diagonal,
    check_mass,
    damped_outside,
    dense_of,
    extended,
    has_series,
    is_sparse,
    linear_model,
    matrix_of,
    modal_damping_of,
    note,
    stiffness_parts,
    warn_of_triangle,
    with_damping,
    with_elements,
)
from viscovib.systems.structure_rest import ModalDamping, Rest, dense_rest
from viscovib.systems.supports import Supports, block, split, supports_of

if TYPE_CHECKING:
    from viscovib.systems.characteristic import CharacteristicRoots
    from viscovib.systems.reduced import ReducedRest

#: Largest number of coordinates of which results contain all by default.
ALL_GIVEN = 64
#: Largest numbers of coordinates for modes of dense matrices, and of sparse matrices made dense.
_MAX_DENSE, _SMALL = 5000, 1000
_REDUCED = (
    "speed: a reduced structure has no matrices that depend on it: use "
    "structure.reduce(...).in_modes().structure"
)
#: Largest number of coordinates.
_MOST = 1_000_000


@dataclass(frozen=True, kw_only=True, eq=False)
class Structure(WithSpeed):
    """M u'' + C u' + K u + sum_j e_j (1 - R_j*) [k_j d_j + f_j(d_j)] = load(t), d_j = e_j . u.

    The unknowns are the deflections d_j of nonlinear elements and elements with memory. All other
    coordinates are eliminated exactly,

    Y_k + H(i k nu) G_k(Y) = Y0_k,  H(s) = E^T (K + s C + s^2 M)^-1 E,  Y0_k = E^T D(i k nu)^-1 P_k.

    Parameters
    ----------
    mass : array_like or scipy.sparse array
        M, symmetric and positive semidefinite: n numbers (a diagonal matrix) or shape (n, n).
        Coordinates without mass (rows of 0) follow immediately.
    stiffness : array_like or scipy.sparse array
        K, in the same forms; it may be singular (rigid bodies) or unsymmetric (follower forces).
        For more than 1000 coordinates in sparse matrices use `reduce`.
    damping : array_like or scipy.sparse array, optional
        C, in the same forms; it may be unsymmetric (gyroscopic forces).
    modal_damping : float or array_like, shape (n,)
        Damping ratio of every mode (0.02 is 2 %), or of each mode in the order of frequencies. With
        dampers that couple the modes it is C = M Phi diag(2 ratio omega) Phi' M.
    rayleigh : tuple of two float
        Damping a M + b K by its factors a (1/s) and b (s).
    loss_factor : float
        K (1 + i loss_factor sign(nu)), for harmonic methods only. Modal damping, Rayleigh damping
        and the loss factor refer to the structure with the linear parts of its elements.
    elements : sequence
        Local elements: Spring, FluidDamper, Maxwell, StribeckFriction, Coupling, Jenkins, Iwan,
        BoucWen, Dahl, Gap, Stop. Their linear stiffness and damping are added to K and C.
    layers : sequence of (array, Kernel)
        Stiffness matrices with memory, added to K, for example of a rubber layer, each in the form
        of ``stiffness``: K_j (1 - R_j*). Kernels that are sums of exponentials are exact for any
        size of the matrix; other kernels must act in at most 64 directions. Files do not contain
        layers.
    names, units : sequence of str, optional
        Names and units of the coordinates; default "x1", "x2", ..., and "m".
    base_direction : array_like, shape (n,), optional
        Motion of the coordinates with the base without deformation of a spring; None: the base is
        fixed. With ``supports``: the motion of each of these, shape (n_supports,), or of all n.
    supports : sequence of str, optional
        Names of coordinates of the matrices that are fixed, or move with the base. The structure
        has all other coordinates. The base acts on them by K_fs, C_fs and M_fs, and by the elements
        between them and supports. Modal damping, Rayleigh damping and the loss factor are those of
        the motion relative to the base. ``base={"x1": ..., "x9": ...}`` moves each support on its
        own, without ``base_direction``.
    gyroscopic, circulatory, centrifugal, speed : optional
        Matrices that depend on the speed of a rotor, in the form of ``stiffness``, and the speed,
        as for `PolynomialSystem`. With these matrices modal damping and Rayleigh damping are those
        of the structure at rest, and the loss factor must be 0.

    Examples
    --------
    >>> import numpy as np, viscovib as vv
    >>> n = 50
    >>> k = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    >>> chain = vv.Structure(mass=np.ones(n), stiffness=k, modal_damping=0.01,
    ...                      elements=[vv.Spring(on="x50", law="0.5*d^3")])
    >>> chain.deflections
    ('x50',)
    >>> load = np.zeros(n); load[0] = 0.001
    >>> r = vv.forced_response(chain, [0.06], load=load, method="newton")
    >>> r.dof_names == tuple(f"x{i + 1}" for i in range(n)), r.complete
    (True, True)

    Warns
    -----
    StabilityWarning
        If the integral of a kernel is not between 0 and 1, or the stiffness or damping matrix has
        entries on one side of its diagonal only; if a diagonal entry of the mass or stiffness is
        1e20 times as large as all others (a support by the penalty method): such a coordinate is
        replaced by an exact support and added to ``supports``.
    """

    mass: npt.ArrayLike
    stiffness: npt.ArrayLike
    damping: npt.ArrayLike | None = None
    modal_damping: npt.ArrayLike | None = None
    rayleigh: tuple[float, float] | None = None
    loss_factor: float = 0.0
    elements: Sequence[Any] = ()
    layers: Sequence[tuple[Any, Kernel]] = ()
    names: Sequence[str] | None = None
    units: Sequence[str] | None = None
    base_direction: npt.ArrayLike | None = None
    supports: Sequence[str] = ()
    gyroscopic: npt.ArrayLike | None = None
    circulatory: npt.ArrayLike | None = None
    centrifugal: npt.ArrayLike | None = None
    speed: float | None = None

    time_unit: ClassVar[str] = "s"
    #: Names of all coordinates and their units.
    dof_names: tuple[str, ...] = field(init=False, repr=False)
    dof_units: tuple[str, ...] = field(init=False, repr=False)

    #: Supports that were removed from the matrices; None: none.
    _held: Supports | None = field(init=False, repr=False, default=None)
    #: True if matrices that depend on the speed act on supports.
    _turns_supports: ClassVar[bool] = False

    def __post_init__(self) -> None:
        own_fields(
            self, "modal_damping", "rayleigh", "elements", "layers", "names", "units", "supports"
        )
        self._set("_changed", {name: getattr(self, name) for name in OF_SPEED})
        self._add_inner_coordinates()
        sparse = any(is_sparse(m) for m in (self.mass, self.stiffness, self.damping))
        mass = matrix_of("mass", self.mass, None, sparse)
        n = mass.shape[0]
        most = _MOST if sparse else _MAX_DENSE
        if not 1 <= n <= most:
            form = "sparse" if sparse else "dense"
            raise InputError(f"mass: {n} coordinates, must be 1 to {most} in {form} matrices")
        self._set("mass", mass)
        self._set("stiffness", matrix_of("stiffness", self.stiffness, n, sparse))
        self._set("damping", matrix_of("damping", self.damping, n, sparse))
        check_mass(mass)
        warn_of_triangle("stiffness", self.stiffness)
        warn_of_triangle("damping", self.damping)
        self._read_speed_matrices(n, sparse)
        layers = checked_layers(self.layers, n, sparse)
        names = tuple(f"x{d + 1}" for d in range(n)) if self.names is None else self.names
        self._set("dof_names", texts_of("names", names, n))
        self._set("_places", name_places(self.dof_names))
        if len(self._places) < n:  # type: ignore[attr-defined]
            raise InputError("names: must differ")
        units = ("m",) * n if self.units is None else self.units
        self._set("dof_units", texts_of("units", units, n))
        found = element_terms(self._prepared, self.dof_names, self._places)  # type: ignore[attr-defined]
        self._set("_elements", found + layers.elements)
        self._set("_layers", layers)
        if not isinstance(self.supports, Sequence) or self.supports:
            self._remove_supports()
        elif self.base_direction is not None:
            direction = _native.real_array("base_direction", self.base_direction).copy()
            if direction.shape != (n,):
                raise InputError(f"base_direction: must have shape ({n},), got {direction.shape}")
            direction.setflags(write=False)
            self._set("base_direction", direction)
        self._read_modal_damping()
        self._eliminate_penalties()
        self._fix_speed()
        warn_of_creep([kernel.integral for kernel in self._all_kernels])

    def __repr__(self) -> str:
        return note(self)

    def _read_modal_damping(self) -> None:
        """Store the damping of modes; with internal coordinates it becomes a damping matrix."""
        inner = sum(element.series is not None for element in self._all_elements)
        modal = modal_damping_of(self, self.n_coordinates - inner)
        if inner and modal is not None:
            layers: Layers = self._layers  # type: ignore[attr-defined]
            matrices = self.mass, self.damping, layers.added_to(self.stiffness)
            self._set("damping", damped_outside(*matrices, modal, self._all_elements, inner))
            modal = None
        self._set("_modal", modal)

    def _read_speed_matrices(self, n: int, sparse: bool) -> None:
        """Check the matrices that depend on the speed, without internal coordinates."""
        given = [name for name in OF_SPEED if getattr(self, name) is not None]
        if self.speed is not None:
            if not given:
                raise InputError(NO_EFFECT)
            self._set("speed", _native.number("speed", self.speed))
        inner = 0 if self._plain == {} else n - self._plain["mass"].shape[0]  # type: ignore[attr-defined]
        for name in given:
            matrix = matrix_of(name, getattr(self, name), n - inner, sparse)
            if inner:
                matrix = block_diagonal(matrix, inner)
            self._set(name, matrix)
        if self.gyroscopic is not None:
            check_skew(self.gyroscopic)
        if given and self.loss_factor:
            raise InputError(f"loss_factor: must be 0 with {given[0]}")

    def _fix_speed(self) -> None:
        """With a speed the matrices become constant."""
        if self.speed is None:
            return
        speed = self.speed
        own = ("damping", "stiffness")
        self._changed.update({name: getattr(self, name) for name in own})  # type: ignore[attr-defined]
        damping, stiffness = self._damping_at_rest, self.stiffness
        self._set("_modal", None)
        gyroscopic, circulatory, centrifugal = (getattr(self, name) for name in OF_SPEED)
        with np.errstate(over="ignore", invalid="ignore"):
            if gyroscopic is not None:
                damping = damping + speed * gyroscopic
            if circulatory is not None:
                stiffness = stiffness + speed * circulatory
            if centrifugal is not None:
                stiffness = stiffness + speed * (speed * centrifugal)
        for name, matrix in zip(own, (damping, stiffness), strict=True):
            values = matrix.data if is_sparse(matrix) else matrix
            if not np.isfinite(values).all():
                raise InputError(f"{name} at speed = {speed:g}: must be a finite number")
            self._set(name, matrix)

    def _add_inner_coordinates(self) -> None:
        """Add the internal coordinates of Maxwell elements to all arrays."""
        self._set("_prepared", self.elements)
        self._set("_plain", {})
        if not has_series(self.elements):
            return
        sparse = any(is_sparse(m) for m in (self.mass, self.stiffness, self.damping))
        mass = matrix_of("mass", self.mass, None, sparse)
        n = mass.shape[0]
        names = tuple(f"x{d + 1}" for d in range(n)) if self.names is None else self.names
        units = ("m",) * n if self.units is None else self.units
        layers = checked_layers(self.layers, n, sparse)
        plain = {
            "mass": mass, "stiffness": matrix_of("stiffness", self.stiffness, n, sparse),
            "damping": matrix_of("damping", self.damping, n, sparse),
            "names": texts_of("names", names, n), "units": texts_of("units", units, n),
            "base_direction": self.base_direction, "layers": self.layers,
            "supports": self.supports, "modal_damping": self.modal_damping,
            "rayleigh": self.rayleigh,
        }  # fmt: skip
        prepared, more = extended(self, plain | {"layers": layers.whole})
        if layers.elements:
            raise InputError("layers: with a Maxwell element, kernels must be sums of exponentials")
        self._set("_plain", plain)
        self._set("_prepared", prepared)
        for name, value in more.items():
            self._set(name, value)

    def _eliminate_penalties(self) -> None:
        """Replace coordinates with a huge number on a diagonal by supports."""
        layers: Layers = self._layers  # type: ignore[attr-defined]
        whole = [matrix for matrix, _ in layers.whole]
        places = penalty_supports(
            self.dof_names, self.mass, [self.stiffness, *whole], self._all_elements
        )
        self._set("_fixed", tuple(self.dof_names[i] for i in places))
        if not places.size:
            return
        self._set("supports", (*self.supports, *self._fixed))  # type: ignore[attr-defined]
        if places.size == self.n_coordinates:
            raise InputError(
                "mass: all coordinates are fixed by huge numbers, at least one must be free"
            )
        warn_of_supports(self._fixed)  # type: ignore[attr-defined]
        elements = fixed_elements(self._all_elements, places)
        whole = [fixed(matrix, places) for matrix in whole]
        self._set("_elements", elements)
        kernels = [kernel for _, kernel in layers.whole]
        self._set("_layers", layers._replace(whole=tuple(zip(whole, kernels, strict=True))))
        self._set("mass", fixed(self.mass, places))
        self._set("damping", fixed(self.damping, places))
        self._set("stiffness", held_stiffness(self.stiffness, whole, places))
        for name in OF_SPEED:
            if getattr(self, name) is not None:
                self._set(name, fixed(getattr(self, name), places))

    def _remove_supports(self) -> None:
        """Keep the free coordinates; `_held` keeps the supports and the whole matrices."""
        free, held = split(self.supports, self.dof_names)
        given = tuple(self.supports)
        matrices = (self.mass, self.damping, self.stiffness)
        layers: Layers = self._layers  # type: ignore[attr-defined]
        found = supports_of(
            given, (self.dof_names, self.dof_units), (free, held), matrices, self.base_direction,
            (*terms_in_order(self._prepared, self.dof_names, self._places), *layers.elements),  # type: ignore[attr-defined]
        )  # fmt: skip
        self._set("supports", given)
        turning = [getattr(self, name) for name in OF_SPEED]
        found = found.at_speed(self.speed, turning)
        self._set("_held", found.with_layers(layers, len(self.elements)))
        for name, matrix in zip(("mass", "damping", "stiffness"), matrices, strict=True):
            self._set(name, block(matrix, free, free))
        for name in OF_SPEED:
            if getattr(self, name) is None:
                continue
            whole_matrix = getattr(self, name)
            if abs(block(whole_matrix, free, held)).max() > 0:
                if found.motion is not None:
                    raise InputError(f"{name}: must not act on supports that move with the base")
                self._set("_turns_supports", True)
            self._set(name, block(whole_matrix, free, free))
        whole = tuple((block(matrix, free, free), kernel) for matrix, kernel in layers.whole)
        self._set("_layers", layers._replace(whole=whole))
        for name in ("dof_names", "dof_units"):
            self._set(name, tuple(getattr(self, name)[i] for i in free))
        self._set("_places", name_places(self.dof_names))
        self._set("_elements", tuple(map(found.cut, self._all_elements)))
        if found.motion is not None:
            self._set("base_direction", found.motion[free])

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    @property
    def n_coordinates(self) -> int:
        """Number n of coordinates."""
        return len(self.dof_names)

    @property
    def rate_units(self) -> tuple[str, ...]:
        """Units of the velocities."""
        return tuple(f"{unit}/s" for unit in self.dof_units)

    @property
    def deflections(self) -> tuple[str, ...]:
        """Unknowns of the condensed equations: coordinates, or combinations of them."""
        found = []
        for column in self._condensation.laws.directions.T:
            places = np.flatnonzero(column)
            terms = [f"{column[i]:+.6g}*{self.dof_names[i]}" for i in places[:4]]
            simple = places.size == 1 and column[places[0]] == 1
            more = "+..." if places.size > 4 else ""
            found.append(self.dof_names[places[0]] if simple else "".join(terms) + more)
        return tuple(found)

    @property
    def _all_elements(self) -> tuple[ElementTerms, ...]:
        return self._elements  # type: ignore[attr-defined,no-any-return]

    _is_condensed = True

    @cached_property
    def _terms_in_order(self) -> tuple[ElementTerms | CouplingTerms, ...]:
        """One entry for each element, with directions of the coordinates."""
        held = self._held
        if held is None:
            return terms_in_order(self._prepared, self.dof_names, self._places)  # type: ignore[attr-defined]
        names = held.all_names
        terms = terms_in_order(self._prepared, names, name_places(names))  # type: ignore[attr-defined]
        return tuple(map(held.cut, terms))

    @property
    def _couplings(self) -> tuple[CouplingTerms, ...]:
        found = self._terms_in_order
        return tuple(one for one in found if isinstance(one, CouplingTerms))

    @cached_property
    def _active_kernels(self) -> tuple[Kernel, ...]:
        kernels: list[Kernel] = []
        for element in self._all_elements:
            does = bool(element.powers) or element.law is not None
            if element.kernel is not None and does and element.kernel not in kernels:
                kernels.append(element.kernel)
        for one in self.elements:
            if isinstance(one, Coupling) and one.kernel is not None and one.kernel not in kernels:
                kernels.append(one.kernel)
        return tuple(kernels)

    @cached_property
    def _all_kernels(self) -> tuple[Kernel, ...]:
        """Kernels of elements and layers."""
        layers: Layers = self._layers  # type: ignore[attr-defined]
        return (*self._active_kernels, *(kernel for _, kernel in layers.whole))

    @cached_property
    def _all_laws(self) -> tuple[Law, ...]:
        laws = [element.law for element in self._all_elements if element.law is not None]
        for coupling in self._couplings:
            laws += [law for _, law in coupling.programs]
        return tuple(laws)

    def _laws_at(
        self, q: FloatArray, v: FloatArray
    ) -> Iterator[tuple[Law, FloatArray, FloatArray]]:
        for place in self._condensation.laws.programs:
            d, rate = q @ place.reads.T, v @ place.reads.T
            n = len(place.law.arguments)
            arguments = np.concatenate([d, rate], axis=-1)
            rates = np.concatenate([rate, np.zeros_like(rate)], axis=-1)
            yield place.law, arguments[..., :n], rates[..., :n]

    @property
    def _parameter_names(self) -> tuple[str, ...]:
        names = []
        for i, element in enumerate(self.elements):
            values = {f.name: getattr(element, f.name) for f in fields(element)}
            own = [
                name
                for name, value in values.items()
                if isinstance(value, float | int) and not isinstance(value, bool)
            ]
            own += named_in(values.get("parameters") or (), values.get("law"))
            names += [f"elements[{i}].{name}" for name in own]
        return tuple(names)

    def _with_parameters(self, numbers: Mapping[str, float]) -> "Structure":
        return replace(self, elements=self._elements_with(numbers), **self._given)

    def _elements_with(self, numbers: Mapping[str, float]) -> list[Any]:
        elements = list(self.elements)
        for name, value in numbers.items():
            place, key = name.removeprefix("elements[").split("].")
            element: Any = elements[int(place)]
            inner = getattr(element, "parameters", None) or {}
            change: dict[str, Any] = {key: value}
            if key in inner:
                change = {"parameters": {**inner, key: value}}
            elements[int(place)] = replace(element, **change)
        return elements

    @property
    def _given(self) -> dict[str, Any]:
        """Arguments that `supports` change, and those of a file, as they were given."""
        if self._plain:  # type: ignore[attr-defined]
            speeds = {name: self._changed[name] for name in OF_SPEED}  # type: ignore[attr-defined]
            return self._plain | speeds  # type: ignore[attr-defined,no-any-return]
        given = {
            name: getattr(self, name)
            for name in ("mass", "damping", "stiffness", "base_direction", "modal_damping",
                         "rayleigh")
        } | {"names": self.dof_names, "units": self.dof_units, "supports": ()}  # fmt: skip
        given |= self._changed  # type: ignore[attr-defined]
        held = self._held
        if held is None:
            return given
        names = ("mass", "damping", "stiffness")
        return given | dict(zip(names, held.matrices, strict=True)) | {
            "base_direction": held.given, "names": held.all_names, "units": held.all_units,
            "supports": held.names,
        }  # fmt: skip

    def at_speed(self, speed: float) -> Self:
        """Return the structure with constant matrices: those at a speed (rad/s)."""
        if self._reduced is not None:
            raise InputError(_REDUCED)
        return super().at_speed(speed)

    @cached_property
    def _rest(self) -> Rest:
        """The linear subsystem with the linear parts of the elements, without their memory."""
        self._turned()
        n = self.n_coordinates
        if is_sparse(self.mass) and n > _SMALL:
            raise InputError(
                f"mass: {n} coordinates in sparse matrices, more than {_SMALL}: reduce them first, "
                "such as structure.reduce(frequency=3000, loads=['x1'])"
            )
        layers: Layers = self._layers  # type: ignore[attr-defined]
        stiffness, damping = with_elements(
            layers.added_to(self.stiffness), self.damping, self._all_elements
        )
        parts = stiffness_parts(self.stiffness, self._all_elements)
        if layers.whole:
            return relaxing_rest(
                dense_of(self.mass), damping, stiffness, self._uncoupled, layers.dense, parts
            )
        return dense_rest(dense_of(self.mass), damping, stiffness, self._uncoupled, parts=parts)

    @cached_property
    def _condensation(self) -> Condensation:
        self._turned()
        laws = element_laws(self._all_elements, self.n_coordinates, self._couplings)
        found = Condensation(self._rest, laws, self._reduced)
        found.supports = self._fixed  # type: ignore[attr-defined]
        return found

    @property
    def _element_directions(self) -> FloatArray:
        """Directions of the deflections in results, shape (n, q)."""
        return element_laws(self._all_elements, self.n_coordinates, self._couplings).directions

    @property
    def _inertia(self) -> FloatArray:
        """M b, where b is the direction of the base motion; with supports also M_fs d."""
        mass: Any = self.mass
        found = np.asarray(mass @ self._base_direction, dtype=float)
        held = self._held
        return found if held is None else found + held.mass

    @property
    def _uncoupled(self) -> ModalDamping | None:
        return self._modal  # type: ignore[attr-defined,no-any-return]

    @property
    def _damping_at_rest(self) -> Any:
        """C with the damping of the modes at rest."""
        modal = self._uncoupled
        if modal is None:
            return self.damping
        layers: Layers = self._layers  # type: ignore[attr-defined]
        total = layers.added_to(self.stiffness)
        return with_damping(self.mass, self.damping, total, modal, self._all_elements)

    @property
    def _reduced(self) -> "ReducedRest | None":
        return self.__dict__.get("_reduction")

    def reduce(
        self,
        *,
        frequency: float,
        tolerance: float = 1e-6,
        loads: Sequence[Any] = (),
        lowest: float = 0.0,
        method: str = "modes",
        max_modes: int = 1000,
    ) -> Self:
        """Return the same structure with its linear subsystem reduced to few modes.

        The reduced model contains the modes up to 1.5 times the highest frequency, and as many
        static corrections for the loads and elements as the tolerance requires
        (`systems.reduction`). It needs one factorization. With ``modal_damping`` the part above
        these modes has stiffness-proportional damping.

        Parameters
        ----------
        frequency : float
            Highest circular frequency (rad/s) of the displacements, including harmonics.
        tolerance : float
            Largest relative error of displacements in the norm of strain energy, for every single
            load and element, estimated from residuals of the full equations at 50 frequencies.
        loads : sequence
            Directions of future loads, each as ``on`` of a `Spring`: a coordinate, a mapping {name:
            weight}, a vector. Directions of elements and of the base are included automatically.
        lowest : float
            Lowest circular frequency (rad/s); above 0 for a free structure.
        method : str
            "modes", or "craig-bampton": modes with fixed coordinates of elements and loads, and the
            static shapes of these coordinates.
        max_modes : int
            Largest number of modes and corrections.

        Returns
        -------
        Structure
            With ``reduction``, which contains the error.

        Raises
        ------
        InputError
            If the tolerance cannot be reached, if the factorization does not fit into memory, or
            later if a load acts in a different direction.

        Examples
        --------
        >>> import numpy as np, scipy.sparse as sp, viscovib as vv
        >>> k = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(4000, 4000))
        >>> chain = vv.Structure(mass=sp.eye_array(4000), stiffness=k, modal_damping=0.01,
        ...                      elements=[vv.Spring(on="x4000", law="0.5*d^3")])
        >>> small = chain.reduce(frequency=0.02, loads=["x1"])
        >>> small.reduction.largest_error < 1e-6, small.reduction.squares.size < 100
        (True, True)
        """
        from scipy.sparse import csc_array

        from viscovib.systems.reduced import reduced_rest

        n = self.n_coordinates
        top = _native.number("frequency", frequency)
        low = _native.number("lowest", lowest)
        if not 1e-50 <= top <= 1e50:
            raise InputError(f"frequency = {top:g}: must be 1e-50 to 1e50")
        if not 0 <= low < top:
            raise InputError(f"lowest = {low:g}: must be at least 0 and below frequency = {top:g}")
        wanted = _native.number("tolerance", tolerance)
        if not 1e-12 <= wanted <= 0.1:
            raise InputError(f"tolerance = {wanted:g}: must be 1e-12 to 0.1")
        _native.choice("method", method, ("modes", "craig-bampton"))
        most = _native.integer("max_modes", max_modes, 1, 100_000)
        if isinstance(loads, (str, Mapping)) or not isinstance(loads, Sequence):
            raise InputError(f"loads = {_native.shown(loads)}: must be a list of directions")
        places = self._places  # type: ignore[attr-defined]
        pushed = [direction_of(f"loads[{i}]", on, n, places) for i, on in enumerate(loads)]
        pushed += [element.direction for element in self._all_elements]
        if self._base_direction is not None:
            pushed.append(self._inertia)
        held = self._held
        if held is not None:
            pushed += [push for push in (held.rate, held.place) if push.any()]
        if not pushed:
            raise InputError("loads: must not be empty for a structure without elements")
        directions = np.array(pushed).T
        whole: Sequence[tuple[Any, Kernel]] = self._layers.whole  # type: ignore[attr-defined]
        model = linear_model(
            self.mass, self.damping, self.stiffness, self._uncoupled, self._all_elements
        )._replace(layers=tuple((csc_array(matrix), kernel) for matrix, kernel in whole))
        boundary = None
        if method == "craig-bampton":
            boundary = np.flatnonzero(directions.any(axis=1)).tolist()
            if len(boundary) > most:
                raise InputError(
                    f"method = 'craig-bampton': loads and elements act on {len(boundary)} "
                    f"coordinates, must be on at most max_modes = {most}"
                )
        found = reduced_rest(
            model, directions, frequency=top, tolerance=wanted, lowest=low, most=most,
            boundary=boundary,
        )  # fmt: skip
        result = copy(self)
        for name in ("_condensation", "_reduction", "_rest"):
            result.__dict__.pop(name, None)
        result.__dict__["_reduction"] = found
        result.__dict__["_rest"] = found.rest
        return result

    def in_modes(self) -> Any:
        """Return a reduced structure as a small structure in modal coordinates.

        All functions for structures of few coordinates accept it: steps in time end where friction,
        gaps and stops switch; shooting, events, ensembles and exponents work. Elements act in the
        same directions. Its base is fixed: replace a base motion by the load -M b times its
        acceleration, for the relative motion.

        Returns
        -------
        ModalModel

        Raises
        ------
        InputError
            If the structure is not reduced, has a loss factor, or loads and elements act on
            coordinates without mass.
        """
        # Import by name: the modules depend on each other.
        return import_module("viscovib.systems.modal_model").modal_model(self)

    @classmethod
    def read(
        cls,
        mass: "str | os.PathLike[str]",
        stiffness: "str | os.PathLike[str] | None" = None,
        damping: "str | os.PathLike[str] | None" = None,
        **options: Any,
    ) -> Self:
        """Return a structure from files of its matrices, or from one file of `write`.

        Parameters
        ----------
        mass, stiffness, damping : path
            Matrix Market (.mtx, .mm), Harwell-Boeing (.rb, .hb, .rsa, .rua) or files of
            `scipy.sparse.save_npz` (.npz), each real and square. ``mass`` alone: a .npz file of
            `write`.
        **options
            Other arguments of a structure, such as ``elements``, ``names`` and ``rayleigh``.

        Raises
        ------
        FileError, InputError
            If a file is missing, truncated, complex, of a different type or size, or if it stores
            one triangle twice or not at all.

        Examples
        --------
        >>> import numpy as np, tempfile, pathlib, viscovib as vv
        >>> where = pathlib.Path(tempfile.mkdtemp())
        >>> vv.Structure(mass=[1.0, 2.0], stiffness=np.eye(2)).write(where / "two.npz")
        >>> again = vv.Structure.read(where / "two.npz", elements=[vv.Spring(on="x1", law="d^3")])
        >>> again.dof_names, again.deflections
        (('x1', 'x2'), ('x1',))
        """
        from viscovib.systems.structure_files import read_structure

        return cls(**read_structure(mass, stiffness, damping, options))

    def write(
        self, path: "str | os.PathLike[str]", *, coordinates: Sequence[str] | None = None
    ) -> None:
        """Write the matrices without the elements. Pass elements again when reading.

        Parameters
        ----------
        path : path
            NAME.npz: the whole model with its damping, names, units and base, for `read`. NAME.mtx:
            Matrix Market files NAME_mass.mtx, NAME_stiffness.mtx and NAME_damping.mtx. For a
            reduced structure these are the modal matrices, with NAME_shapes.mtx: a row for each of
            some coordinates; an element or load along e acts on the modes along shapes' e.
        coordinates : sequence of str, optional
            Rows of NAME_shapes.mtx; None: coordinates with elements and loads.
        """
        from viscovib.systems.structure_files import write_structure

        write_structure(self, path, coordinates)

    @property
    def reduction(self) -> Any:
        """Quality of a reduced structure (`systems.reduction.Reduction`); None for a full one."""
        return None if self._reduced is None else self._reduced.reduction

    def natural_frequencies(self) -> FloatArray:
        """Undamped natural circular frequencies at rest without memory (rad/s), ascending.

        Elements count with their linear stiffness. Negative: rest is unstable and the motion grows
        like exp(|omega| t). Coordinates without mass have no frequency.

        Returns
        -------
        ndarray, shape (n_modes,)

        Examples
        --------
        >>> import viscovib as vv
        >>> chain = vv.Structure(mass=[1, 1], stiffness=[[2, -1], [-1, 2]])
        >>> chain.natural_frequencies().round(6)
        array([1.      , 1.732051])
        """
        mass: Any = self.mass
        # Coordinates without mass may have a tiny mass here: their modes are the fastest.
        heavy = int(np.count_nonzero(np.asarray(abs(mass).sum(axis=1))))
        squares = np.sort(self._free.condensation.rest.squares)[:heavy]
        return np.asarray(np.sign(squares) * np.sqrt(np.abs(squares)))

    def characteristic_roots(
        self, count: int | None = None, *, layers: Sequence[tuple[Any, Kernel]] = ()
    ) -> "CharacteristicRoots":
        """Roots of det[M s^2 + C s + K + sum_j (k_j + s c_j) e_j e_j' (1 - R_j(s))] = 0.

        c_j is the linear part of the law of an element with a kernel in the rate. Up to 20
        coordinates, all roots are found as those of `PolynomialSystem.characteristic_roots`. Beyond
        20 coordinates, and with ``count``, Newton's method works on the full matrices, dense or
        sparse. Each root starts from a mode of the stiffness at its frequency.
        ``real`` then lists the positive real roots (up to 500 coordinates, symmetric matrices),
        ``n_unstable`` counts the growing roots in the list, ``complete`` is False, and ``region``
        states the searched part of the plane.

        Parameters
        ----------
        count : int
            Number of roots, by increasing frequency of their modes; None: all, or 6 beyond 20
            coordinates.
        layers : sequence of (array, Kernel)
            Further stiffness matrices with memory, with any kernel, in addition to those of the
            structure.
        """
        from viscovib.systems.sparse_roots import structure_roots

        return structure_roots(self._turned(), count, layers)

    @property
    def _base_direction(self) -> FloatArray | None:
        return None if self.base_direction is None else np.asarray(self.base_direction)

    @for_recent_loads
    def _loaded(
        self, load: LoadLike | None, base: LoadLike | None, nu: float | None = None
    ) -> LoadedStructure:
        """The structure with its loads; ``nu``: their frequency, if it is known."""
        n = self.n_coordinates
        places: Mapping[str, int] = self._places  # type: ignore[attr-defined]
        constant, varying = parts_of(load, n, places)
        apart: dict[int, ComplexArray] = {}
        forces: dict[int, ComplexArray] = {}
        if moves_apart(self, base):
            apart, forces, more = harmonics_apart(self, base)
            varying, base = [*varying, *more], None
        orders, series = load_series(constant, base, n, places)
        orders, series = with_forces(orders, series, forces)
        held = self._held
        if base is not None and held is not None and held.pulls:
            for j, order in enumerate(orders.tolist()):
                series[:-1, j] += held.force(order, nu or 0.0) * series[-1, j]
                if nu is None and order and series[-1, j] and held.rate.any():
                    varying.append(
                        VaryingForce("nu", order, -1j * order * series[-1, j] * held.rate)
                    )
        inertia = np.zeros(n)
        if self._base_direction is not None:
            inertia = self._inertia
        if self._reduced is not None:
            given = np.column_stack([series[:-1], inertia, *(one.force for one in varying)])
            self._reduced.check_loads(given, self.dof_names)
        found = LoadedStructure.of(
            self._condensation, orders, series, inertia, self._base_direction, varying
        )
        found.apart = apart
        return found

    @cached_property
    def _free(self) -> LoadedStructure:
        """The structure without damping, memory and loads."""
        from viscovib.systems.undamped import undamped

        self._refuse_gyroscopic()
        return undamped(self)

    def _moving_most(self, mode: int) -> int:
        """The coordinate with the largest motion in a mode, weighted by the root of its inertia."""
        free = self._free.condensation.rest
        if mode >= free.squares.size:
            raise InputError(f"mode = {mode}: must be 0 to {free.squares.size - 1}")
        mass: Any = self.mass
        moved = np.abs(free.shapes[:, mode]) * np.sqrt(np.abs(mass.diagonal()))
        return int(np.flatnonzero(moved >= (1 - 1e-9) * moved.max())[0])

    def _wanted(self, coordinates: Any, loaded: LoadedStructure) -> npt.NDArray[np.intp]:
        """Indices of the coordinates in results."""
        if coordinates is None:
            # Modal amplitudes represent all coordinates together.
            if self.n_coordinates <= ALL_GIVEN or self.__dict__.get("_all_given"):
                return np.arange(self.n_coordinates)
            touched = loaded.touched
            for element in self._all_elements:
                touched |= element.direction != 0
            # Without loads and elements only the initial state causes motion: show one coordinate.
            places = np.flatnonzero(touched)[:ALL_GIVEN]
            return places if places.size else np.arange(1)
        return self._chosen(coordinates)

    def _chosen(self, coordinates: Any) -> npt.NDArray[np.intp]:
        """Indices of coordinates by name."""
        if isinstance(coordinates, str) or not isinstance(coordinates, Sequence):
            raise InputError(f"coordinates = {_native.shown(coordinates)}: must be a list of names")
        places: Mapping[str, int] = self._places  # type: ignore[attr-defined]
        for name in coordinates:
            if not isinstance(name, str) or name not in places:
                raise InputError(
                    f"coordinates: {_native.shown(name)} must be one of the "
                    f"{self.n_coordinates} coordinates {self.dof_names[0]}, ..."
                )
        if not coordinates:
            raise InputError("coordinates: must not be empty")
        return np.array([places[name] for name in coordinates])
