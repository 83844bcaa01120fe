"""A structure in some of its modes, as a polynomial system in as many of its coordinates.

u = V q with the chosen modes. If fewer than the maximum, V also contains the static deflections of
the other modes under the elements and the load (MacNeal, Computers and Structures 1 (1971) 581).
With u_c = V_c q at as many coordinates c, preferably of elements, q = V_c^-1 u_c and
M' = V_c^-T V^T M V V_c^-1; K' and C' likewise. Elements keep their laws and kernels, along
e^T V V_c^-1. The omitted part is reported.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.errors import InputError
from viscovib.systems.element_laws import laws_along
from viscovib.systems.linear_model import damping_and_layers
from viscovib.systems.load import load_series
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.spring_groups import Monomial, Springs
from viscovib.systems.structure import Structure

#: Largest numbers of modes and of forces of an expansion by multiple scales.
MOST_MODES, _MOST_FORCES = 6, 3000
#: Preference factor for coordinates of elements; relative weights that are rounding errors.
_PREFERRED, _ROUNDING = 1e3, 1e-12
#: A static part is dropped if its linearly independent fraction is below this.
_DEPENDENT = 1e-6


class FewModes(NamedTuple):
    """A structure in some of its modes."""

    system: PolynomialSystem
    #: Names of its coordinates in the structure, and u = shapes u_c, shape (n, m).
    names: tuple[str, ...]
    shapes: FloatArray
    #: Modal forces of the load, as forces on u_c, shape (m,).
    load: FloatArray
    #: Relative deflections of the elements under the load in the omitted modes.
    left_out: float


def few_modes(structure: Structure, modes: Any, load: Any, nu: float | None) -> FewModes:
    """Return a structure in the chosen modes; None: all modes, if they are few."""
    from scipy.linalg import qr

    modal = squares, shapes, damping = _modal(structure)
    force = _force(structure, load)
    mixed = _with_corrections(structure, squares, shapes, _chosen(modes, squares.size), force)
    shapes, mass = shapes @ mixed, mixed.T @ mixed
    stiffness, damping = (mixed.T * squares) @ mixed, mixed.T @ damping @ mixed
    touched = np.zeros(structure.n_coordinates, dtype=bool)
    for element in structure._all_elements:
        touched |= element.direction != 0
    weight = np.where(touched, _PREFERRED, 1.0)
    _, _, order = qr((shapes * weight[:, np.newaxis]).T, mode="economic", pivoting=True)
    places = np.sort(order[: shapes.shape[1]])
    inverse = np.linalg.inv(shapes[places])
    turned = shapes @ inverse
    matrices = [inverse.T @ part @ inverse for part in (mass, damping, stiffness)]
    system = _system(structure, turned, *matrices)
    return FewModes(
        system, tuple(structure.dof_names[i] for i in places), turned, turned.T @ force,
        _left_out(structure, modal, turned, matrices, force, nu),
    )  # fmt: skip


def _with_corrections(
    structure: Structure, squares: FloatArray, shapes: FloatArray, chosen: Any, force: FloatArray
) -> FloatArray:
    """The chosen modes and static parts of other modes, orthonormal, as columns of all modes."""
    columns = list(np.eye(squares.size)[chosen])
    others = np.ones(squares.size, dtype=bool)
    others[chosen] = False
    others &= squares != 0
    pushes = [element.direction for element in structure._all_elements]
    for push in [*pushes, force]:
        seen = np.where(others, shapes.T @ push, 0.0)
        bent = np.where(others, seen / np.where(squares == 0, 1.0, squares), 0.0)
        size = np.linalg.norm(bent)
        for column in columns:
            bent = bent - column * (column @ bent)
        left = np.linalg.norm(bent)
        if len(columns) < MOST_MODES and left > _DEPENDENT * size > 0:
            columns.append(bent / left)
    return np.array(columns).T


def _chosen(modes: Any, count: int) -> Any:
    if modes is None:
        if count > MOST_MODES:
            raise InputError(
                f"modes: the structure has {count}, must be at most {MOST_MODES} of them, such as "
                "modes=[0, 1]"
            )
        return np.arange(count)
    if isinstance(modes, str) or not isinstance(modes, Sequence) or not modes:
        raise InputError(f"modes = {_native.shown(modes)}: must be a list of numbers from 0")
    found = [_native.integer("modes", one, 0, count - 1) for one in modes]
    if len(set(found)) < len(found) or len(found) > MOST_MODES:
        raise InputError(f"modes: must be at most {MOST_MODES} different ones")
    return np.sort(np.array(found))


def _modal(structure: Structure) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Squares, shapes and damping Phi^T C Phi of the structure without relaxation."""
    modal = structure._uncoupled
    if modal is not None and np.any(modal.loss):
        raise InputError("loss_factor: is for harmonic methods, must be 0 (use modal_damping)")
    if structure._reduced is not None:
        found = structure._reduced.reduction
        damping, _ = damping_and_layers(structure._reduced.model, found)
        order = np.argsort(found.squares)
        return found.squares[order], found.shapes[:, order], damping[np.ix_(order, order)]
    rest = structure._free.condensation.rest
    matrix: Any = structure.damping
    damping = rest.shapes.T @ (matrix @ rest.shapes)
    for element in structure._all_elements:
        seen = rest.shapes.T @ element.direction
        damping = damping + element.damping * np.outer(seen, seen)
    if modal is not None:
        damping = damping + np.diag(modal.rates(rest.squares))
    return rest.squares, rest.shapes, np.asarray(damping)


def _force(structure: Structure, load: Any) -> FloatArray:
    """Amplitudes of the load, times cos(nu t), on all coordinates."""
    if load is None:
        return np.zeros(structure.n_coordinates)
    _, series = load_series(load, None, structure.n_coordinates, structure._places)  # type: ignore[attr-defined]
    if series.shape[1] != 1 or series.imag.any():
        raise InputError("load: must be one amplitude per coordinate, times cos(nu t)")
    return np.asarray(series[:-1, 0].real)


def _system(
    structure: Structure,
    turned: FloatArray,
    mass: FloatArray,
    damping: FloatArray,
    stiffness: FloatArray,
) -> PolynomialSystem:
    """The polynomial system in the chosen coordinates."""
    elements, couplings = structure._all_elements, structure._couplings
    if any(one.law is not None for one in elements) or any(one.programs for one in couplings):
        raise InputError("elements: must have polynomial laws for an expansion in modes")
    layers = structure._layers.whole  # type: ignore[attr-defined]
    laws = laws_along(
        np.eye(mass.shape[0]), elements, [_mix(turned.T @ one.direction) for one in elements],
        couplings, [[_mix(turned.T @ e) for e in one.directions] for one in couplings],
        [(np.zeros_like(mass), None)]
        + [(turned.T @ (matrix @ turned), kernel) for matrix, kernel in layers],
    )  # fmt: skip
    if sum(map(len, laws.forces)) > _MOST_FORCES:
        raise InputError(
            "modes: the laws of the elements have more than "
            f"{_MOST_FORCES} terms in them, must be fewer modes, or laws of lower degree"
        )
    # The modes are those of the unrelaxed springs; the first group has no kernel.
    laws.stiffness[0][:] = stiffness - sum(laws.stiffness[1:])
    springs = [
        Springs(
            stiffness=0.5 * (linear + linear.T), kernel=kernel,
            forces=[Monomial(coefficient=c, powers=powers, on=on)
                    for (on, powers), c in forces.items() if c],
        )
        for kernel, linear, forces in zip(laws.kernels, laws.stiffness, laws.forces, strict=True)
    ]  # fmt: skip
    return PolynomialSystem(
        mass=0.5 * (mass + mass.T), damping=damping, springs=springs,
        names=[f"q{j + 1}" for j in range(len(mass))],
    )  # fmt: skip


def _mix(seen: FloatArray) -> dict[int, float]:
    largest = float(np.abs(seen).max(initial=0.0))
    return {int(j): float(seen[j]) for j in np.flatnonzero(np.abs(seen) > _ROUNDING * largest)}


def _left_out(
    structure: Structure,
    modal: tuple[FloatArray, FloatArray, FloatArray],
    turned: FloatArray,
    matrices: Sequence[FloatArray],
    force: FloatArray,
    nu: float | None,
) -> float:
    """Largest relative error of the linear deflections of elements by the omitted modes."""
    rest = structure._rest
    e = np.array([element.direction for element in structure._all_elements]).reshape(
        -1, structure.n_coordinates
    )
    if not e.size or not force.any():
        return 0.0
    mass, damping, stiffness = matrices
    s = 1j * (1.0 if nu is None else nu)
    squares, shapes, all_damping = modal
    apart = np.diag(squares + s**2) + s * all_damping
    whole: Any = shapes @ np.linalg.solve(apart, shapes.T @ force)
    if rest.flexibility is not None:
        whole = whole + rest.flexibility(force[:, np.newaxis])[0][:, 0]
    few = np.linalg.solve(stiffness + s * damping + s**2 * mass, turned.T @ force)
    seen = e @ whole
    off = np.abs(seen - e @ (turned @ few)).max()
    return float(off / max(np.abs(seen).max(), np.finfo(float).tiny))
