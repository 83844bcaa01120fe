"""A structure of any number of coordinates with local elements, condensed to what is nonlinear."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.condensed import Condensation, LoadedStructure, element_laws
from viscovib.elements import ElementTerms, element_terms
from viscovib.errors import InputError
from viscovib.kernels import Kernel
from viscovib.load import LoadLike, load_series
from viscovib.mount import warn_of_creep
from viscovib.polynomial_system import _square, _words
from viscovib.structure_rest import ModalDamping, Rest, dense_rest

#: Coordinates up to which all are given where none are chosen, and matrices are dense.
_ALL_GIVEN, _MAX_DENSE = 64, 5000


@dataclass(frozen=True, kw_only=True, eq=False)
class Structure:
    """M u'' + C u' + K u + sum_j e_j (1 - R_j*) [k_j d_j + f_j(d_j)] = load(t), d_j = e_j . u.

    Linear almost everywhere: only the deflections d_j of elements that are nonlinear or remember
    are unknowns, everything else is eliminated exactly,

    Y_k + H(i k nu) G_k(Y) = Y0_k,  H(s) = E^T (K + s C + s^2 M)^-1 E,  Y0_k = E^T D(i k nu)^-1 P_k.

    Parameters
    ----------
    mass : array_like
        M, symmetric and positive definite: n numbers (a diagonal matrix) or shape (n, n).
    stiffness : array_like
        K, as mass; it need be neither positive (rigid bodies) nor symmetric (follower forces).
    damping : array_like, optional
        C, as stiffness; it need not be symmetric (gyroscopic forces).
    modal_damping : float or array_like, shape (n,)
        Damping ratio of every mode, or of each, in the order of their frequencies.
    rayleigh : tuple of two float
        Damping a M + b K by its factors a (1/s) and b (s).
    loss_factor : float
        K (1 + i loss_factor sign(nu)), for harmonic methods only: in time it has no meaning.
        Modal damping, Rayleigh's and this one are of the structure with the linear parts of its
        elements.
    elements : sequence of Spring
        Local elements. Their linear stiffness and damping add to K and C.
    names, units : sequence of str, optional
        Of the coordinates; default "x1", "x2", ..., and "m".
    base_direction : array_like, shape (n,), optional
        How the coordinates move with the base without deforming a spring; None: it is fixed.

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
        If the integral of a kernel is not between 0 and 1.
    """

    mass: npt.ArrayLike
    stiffness: npt.ArrayLike
    damping: npt.ArrayLike | None = None
    modal_damping: npt.ArrayLike | None = None
    rayleigh: tuple[float, float] | None = None
    loss_factor: float = 0.0
    elements: Sequence[Any] = ()
    names: Sequence[str] | None = None
    units: Sequence[str] | None = None
    base_direction: npt.ArrayLike | None = None

    time_unit: ClassVar[str] = "s"
    #: Names of all coordinates and their units.
    dof_names: tuple[str, ...] = field(init=False, repr=False)
    dof_units: tuple[str, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        mass = _square("mass", self.mass, None)
        n = mass.shape[0]
        if not 1 <= n <= _MAX_DENSE:
            raise InputError(f"mass: {n} coordinates, must be 1 to {_MAX_DENSE} in dense matrices")
        self._set("mass", mass)
        self._set("stiffness", _square("stiffness", self.stiffness, n))
        self._set("damping", _square("damping", self.damping, n))
        _check_mass(mass)
        self._set("_modal", self._modal_damping(n))
        names = tuple(f"x{d + 1}" for d in range(n)) if self.names is None else self.names
        self._set("dof_names", _words("names", names, n))
        self._set("_places", {name: d for d, name in enumerate(self.dof_names)})
        if len(self._places) < n:  # type: ignore[attr-defined]
            raise InputError("names: must differ")
        units = ("m",) * n if self.units is None else self.units
        self._set("dof_units", _words("units", units, n))
        if self.base_direction is not None:
            direction = _native.real_array("base_direction", self.base_direction).copy()
            if direction.shape != (n,):
                raise InputError(f"base_direction: must have shape ({n},), got {direction.shape}")
            direction.setflags(write=False)
            self._set("base_direction", direction)
        found = element_terms(self.elements, self.dof_names, self._places)  # type: ignore[attr-defined]
        self._set("_elements", found)
        warn_of_creep([kernel.integral for kernel in self._active_kernels], stacklevel=4)

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def _modal_damping(self, n: int) -> ModalDamping | None:
        ratio: float | FloatArray = 0.0
        if self.modal_damping is not None:
            ratios = _native.real_array("modal_damping", self.modal_damping)
            if ratios.shape not in ((), (n,)):
                raise InputError(f"modal_damping: must be one number or {n}, got {ratios.shape}")
            ratio = float(ratios) if ratios.ndim == 0 else ratios.copy()
        by_mass, by_stiffness = 0.0, 0.0
        if self.rayleigh is not None:
            factors = _native.real_array("rayleigh", self.rayleigh)
            if factors.shape != (2,):
                raise InputError("rayleigh: must be two factors, of mass and of stiffness")
            by_mass, by_stiffness = map(float, factors)
        loss = _native.number("loss_factor", self.loss_factor)
        damping = ModalDamping(ratio, loss, by_mass, by_stiffness)
        given = np.any(ratio) or loss or by_mass or by_stiffness
        return damping if given else None

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
        """The unknowns of the condensed equations: coordinates, or combinations of them."""
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

    @cached_property
    def _active_kernels(self) -> tuple[Kernel, ...]:
        kernels: list[Kernel] = []
        for element in self._all_elements:
            if element.kernel is not None and element.powers and element.kernel not in kernels:
                kernels.append(element.kernel)
        return tuple(kernels)

    @cached_property
    def _rest(self) -> Rest:
        """The linear rest with the linear parts of the elements, without memory."""
        stiffness = np.array(self.stiffness, dtype=float)
        damping = np.array(self.damping, dtype=float)
        for element in self._all_elements:
            k, c = element.powers.get(1, 0.0), element.damping
            if k or c:
                places = np.flatnonzero(element.direction)
                e = element.direction[places]
                stiffness[np.ix_(places, places)] += k * np.outer(e, e)
                damping[np.ix_(places, places)] += c * np.outer(e, e)
        modal = self._modal  # type: ignore[attr-defined]
        return dense_rest(np.asarray(self.mass), damping, stiffness, modal)

    @cached_property
    def _condensation(self) -> Condensation:
        return Condensation(self._rest, element_laws(self._all_elements, self.n_coordinates))

    @property
    def _base_direction(self) -> FloatArray | None:
        return None if self.base_direction is None else np.asarray(self.base_direction)

    def _loaded(self, load: LoadLike | None, base: LoadLike | None) -> LoadedStructure:
        n = self.n_coordinates
        orders, series = load_series(load, base, n, self._places)  # type: ignore[attr-defined]
        # Harmonics that are 0 are none.
        kept = np.flatnonzero(series.any(axis=0))
        forces: ComplexArray = series[:-1, kept]
        inertia = np.zeros(n)
        if self._base_direction is not None:
            inertia = np.asarray(self.mass) @ self._base_direction
        return LoadedStructure(
            self._condensation, orders[kept], forces, series[-1, kept], inertia,
            self._base_direction,
        )  # fmt: skip

    def _wanted(self, coordinates: Any, loaded: LoadedStructure) -> npt.NDArray[np.intp]:
        """Places of the coordinates that results hold."""
        if coordinates is None:
            if self.n_coordinates <= _ALL_GIVEN:
                return np.arange(self.n_coordinates)
            touched = loaded.forces.any(axis=1)
            for element in self._all_elements:
                touched |= element.direction != 0
            return np.flatnonzero(touched)[:_ALL_GIVEN]
        if isinstance(coordinates, str) or not isinstance(coordinates, Sequence):
            raise InputError(f"coordinates = {_native.shown(coordinates)}: must be a list of names")
        places: Mapping[str, int] = self._places  # type: ignore[attr-defined]
        for name in coordinates:
            if name not in places:
                raise InputError(
                    f"coordinates: {_native.shown(name)} must be one of the "
                    f"{self.n_coordinates} coordinates {self.dof_names[0]}, ..."
                )
        if not coordinates:
            raise InputError("coordinates: must not be empty")
        return np.array([places[name] for name in coordinates])


def _check_mass(mass: FloatArray) -> None:
    asymmetry = np.abs(mass - mass.T).max()
    try:
        np.linalg.cholesky(mass)
    except np.linalg.LinAlgError:
        asymmetry = np.inf
    if asymmetry > 1e-12 * np.abs(mass).max():
        raise InputError("mass: must be symmetric and positive definite")
