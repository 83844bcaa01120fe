"""Structures of few coordinates as polynomial systems in all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.parameters import CORNER_TOLERANCE, SMOOTH_TOLERANCE
from viscovib.errors import InputError
from viscovib.kernels.relaxation import Kernel
from viscovib.systems.element_laws import Laws, laws_along, n_products
from viscovib.systems.elements import ElementTerms, element_terms
from viscovib.systems.layers import Layers
from viscovib.systems.many_numbers import scaled_parts
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.speed_matrices import OF_SPEED
from viscovib.systems.spring_groups import is_definite
from viscovib.systems.structure import Structure
from viscovib.systems.structure_matrices import dense_of, with_elements
from viscovib.systems.structure_rest import matrix_of_modal
from viscovib.systems.system import System

_Note = TypeVar("_Note")
#: Largest number of coordinates in modal coordinates, as of `modal_frame`.
MOST_IN_FRAME = 512
#: The same together with the coordinates of the core for exponentials of memory.
MOST_WITH_MEMORY = 1024
#: Products of coordinates that a power of deflections may become; beyond them it is a law of these.
_MOST_PRODUCTS = 500


def once_each(function: Callable[[Structure], _Note]) -> Callable[[Structure], _Note]:
    """Cache the result of a function for each structure during its lifetime.

    Runs of an ensemble differ in starts and loads, but share the structure.
    """
    known: WeakKeyDictionary[Structure, _Note] = WeakKeyDictionary()

    @wraps(function)
    def note(structure: Structure) -> _Note:
        if structure not in known:
            known[structure] = function(structure)
        return known[structure]

    return note


def usual_tolerance(system: System) -> float:
    """Return the default tolerance of steady motions, which is larger with kinks and jumps."""
    return CORNER_TOLERANCE if system._has_kinks else SMOOTH_TOLERANCE


def lacks_wholeness(system: Structure) -> str | None:
    """Say what keeps a structure from going by its whole equations; None: nothing."""
    n = len(system.dof_names)
    if n > MOST_IN_FRAME:
        return f"is for structures of at most {MOST_IN_FRAME} coordinates, has {n}"
    if system._reduced is not None:
        return "is for structures that are not reduced: use structure.in_modes()"
    if not _all_has_mass(system):
        return "is for structures all of whose coordinates have mass"
    return None


@once_each
def _all_has_mass(structure: Structure) -> bool:
    """Whether the mass matrix is positive definite, but for rounding, as the core decides it."""
    return is_definite(dense_of(structure.mass))


class _Whole(PolynomialSystem):
    """All coordinates of a structure, without the limits of harmonic methods."""

    _has_hidden_forces = True

    def _check_large(self) -> None:
        _native.polynomial_object(self._vector)


@once_each
def whole_system(structure: Structure) -> PolynomialSystem:
    """Return the system in all its coordinates, with its memory in the vector only.

    Modal damping becomes C = M Phi diag(2 zeta omega) Phi^T M, Phi^T M Phi = 1.
    """
    n = structure.n_coordinates
    mass = dense_of(structure.mass)
    if not mass.any(axis=1).all():
        raise InputError("mass: must be positive for a motion in time by the whole equations")
    elements = structure._all_elements
    layers: Layers = structure._layers  # type: ignore[attr-defined]
    stiffness, damping = with_elements(
        layers.added_to(structure.stiffness), structure.damping, elements
    )
    elastic = [one for one in elements if one.kernel is None]
    at_once, _ = with_elements(structure.stiffness, structure.damping, elastic)
    modal = structure._uncoupled
    if modal is not None:
        if np.any(modal.loss):
            raise InputError(
                "loss_factor: has no meaning in time, must be 0 for a motion in time (use a "
                "kernel, or modal_damping)"
            )
        damping = damping + matrix_of_modal(modal, mass, stiffness)
    matrices = [(at_once, None), *((dense_of(matrix), kernel) for matrix, kernel in layers.whole)]
    laws = _laws(structure, elements, matrices)
    turning: dict[str, Any] = {
        name: dense_of(matrix)
        for name in OF_SPEED
        if structure._depends_on_speed and (matrix := getattr(structure, name)) is not None
    }
    whole = _Whole(
        mass=mass, stiffness=stiffness, damping=damping, base_direction=structure.base_direction,
        **turning,
    )  # fmt: skip
    direction = np.zeros(n) if whole._base_direction is None else whole._base_direction
    vector = laws.vector(mass, damping, direction, whole._speed_matrices if turning else ())
    whole.__dict__.update(
        _vector=vector, dof_names=structure.dof_names, dof_units=structure.dof_units,
        _at_once=at_once,
    )  # fmt: skip
    return whole


def _laws(
    structure: Structure,
    elements: Sequence[ElementTerms],
    matrices: Sequence[tuple[FloatArray, Kernel | None]],
) -> Laws:
    """Laws of elements in all coordinates."""
    couplings = structure._couplings
    return laws_along(
        np.eye(structure.n_coordinates), elements, [_mix(one.direction) for one in elements],
        couplings, [[_mix(e) for e in one.directions] for one in couplings], matrices,
        most=_MOST_PRODUCTS,
    )  # fmt: skip


def whole_with_parameters(
    system: Any, numbers: Mapping[str, float]
) -> tuple[FloatArray, FloatArray]:
    """Vector and `scaled_parts` of a system in all its coordinates with other parameters.

    A structure of which only nonlinear terms of elements change keeps its matrices.
    """
    if system._is_condensed and _has_own_matrices(system):
        elements = element_terms(system._elements_with(numbers), system.dof_names, system._places)
        if all(map(_same_slopes, elements, system._all_elements)):
            whole: Any = whole_system(system)
            base = whole._base_direction
            direction = np.zeros(len(whole.dof_names)) if base is None else base
            laws = _laws(system, elements, [(whole._at_once, None)])
            return laws.vector(whole.mass, whole.damping, direction), scaled_parts(whole)
    one = in_all_coordinates(system._with_parameters(numbers), always=True)
    return one._flat, scaled_parts(one)


def _has_own_matrices(structure: Any) -> bool:
    """True if elements, supports and speed do not change the matrices, and nothing has memory."""
    changed = structure._plain or structure._held or structure._fixed
    return not (
        changed or structure._couplings or structure._all_kernels or structure._depends_on_speed
    )


def _same_slopes(one: ElementTerms, other: ElementTerms) -> bool:
    return one.powers.get(1) == other.powers.get(1) and one.damping == other.damping


def in_all_coordinates(system: Any, base: object = None, *, always: bool = False) -> Any:
    """Return a structure whose matrices depend on the speed as a system in all its coordinates.

    ``base``: motion of the base; ``always``: return every structure so. Other systems are returned
    as they are.
    """
    if not system._is_condensed:
        return system
    if not system._depends_on_speed:
        return whole_system(system) if always else system
    note = lacks_wholeness(system)
    if note is not None:
        remedy = "" if "in_modes" in note else ": use structure.reduce(...).in_modes().structure"
        raise InputError(f"speed: a motion at the speed of its load {note}{remedy}")
    if base is not None and system._held is not None:
        raise InputError("base: must not move supports of a structure that depends on the speed")
    return whole_system(system)


def law_places(structure: Structure) -> list[int | None]:
    """The place of each element's law among those of `whole_system`; None: it has none."""
    found: list[int | None] = []
    count = 0
    for element in structure._all_elements:
        mix = _mix(element.direction)
        most = max((power for power in element.powers if power > 1), default=0)
        count += int(most > 0 and n_products(mix, [(mix, most)]) > _MOST_PRODUCTS)
        found.append(None if element.law is None else count)
        count += int(element.law is not None)
    return found


def n_hidden(system: PolynomialSystem, h: float = 0.0, reach: float = 0.0) -> tuple[int, bool]:
    """Count the coordinates that the core adds for memory with step size h (0: upper bound).

    -1: not possible. Also True if a kernel is fitted for these steps and times up to ``reach``.
    """
    flat = system._flat
    # The fourth number counts kernels.
    if not flat[3]:
        return 0, False
    found = _native.run("motion hidden coordinates", system._handle, h=float(h), reach=float(reach))
    return found["n_hidden"], bool(found["fitted"])


def _mix(direction: FloatArray) -> dict[int, float]:
    return {int(i): float(direction[i]) for i in np.flatnonzero(direction)}
