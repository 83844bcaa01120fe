"""Matrices of a structure, dense or sparse, with the linear parts of its elements."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.counts import things
from viscovib.errors import InputError, StabilityWarning, caller
from viscovib.systems.elements import ElementTerms, direction_of
from viscovib.systems.load import name_places
from viscovib.systems.series_dampers import Maxwell
from viscovib.systems.spring_groups import square_matrix
from viscovib.systems.structure_rest import ModalDamping, matrix_of_modal

if TYPE_CHECKING:
    from viscovib.kernels.relaxation import Kernel
    from viscovib.systems.linear_model import LinearModel

#: Largest number of coordinates of an element in sparse matrices.
_MANY = 2000
#: Smallest mass. Products with smaller masses underflow and lose digits.
_LEAST_MASS = 1e-280


def is_sparse(matrix: Any) -> bool:
    """True for a matrix of scipy.sparse; this test does not import SciPy."""
    return hasattr(matrix, "tocsc")


def matrix_of(name: str, value: Any, n: int | None, sparse: bool) -> Any:
    """Return a matrix of a structure: a csc_array if ``sparse``, else a dense one."""
    if not sparse:
        return square_matrix(name, value, n)
    from scipy.sparse import csc_array, diags_array

    from viscovib.systems.sparse_pencil import checked_sparse

    if is_sparse(value):
        return checked_sparse(name, value, n)
    if value is None:
        return csc_array((n, n))
    given = _native.real_array(name, value)
    if given.ndim < 2:
        return checked_sparse(name, diags_array(np.atleast_1d(given)), n)
    return checked_sparse(name, square_matrix(name, given, n), n)


def is_triangular(matrix: Any) -> bool:
    """True if the matrix may be one triangle of a symmetric matrix.

    All off-diagonal entries are on one side of it, and the diagonal entries of their rows and
    columns are not 0, as in every semidefinite matrix.
    """
    if is_sparse(matrix):
        places = matrix.tocoo()
        entries = places.data != 0
        rows, columns, diagonal = places.row[entries], places.col[entries], matrix.diagonal()
    else:
        (rows, columns), diagonal = np.nonzero(matrix), np.diagonal(matrix)
    off = rows != columns
    below, above = (rows > columns).any(), (rows < columns).any()
    return bool(below != above and diagonal[rows[off]].all() and diagonal[columns[off]].all())


def warn_of_triangle(name: str, matrix: Any) -> None:
    """Warn of a matrix that looks like one triangle of a symmetric matrix."""
    if is_triangular(matrix):
        warnings.warn(
            f"{name}: has entries on one side of the diagonal only; if it is one triangle of a "
            "symmetric matrix, pass both triangles",
            StabilityWarning,
            stacklevel=caller(),
        )


def note(structure: Any) -> str:
    """Description of a structure in one line."""
    form = "sparse" if is_sparse(structure.mass) else "dense"
    count = len(structure.elements)
    size = things(structure.n_coordinates, "coordinate")
    text = f"{size} in {form} matrices, {things(count, 'element')}"
    found = structure.reduction
    if found is not None:
        text += (
            f", reduced to {things(found.n_modes, 'mode')} and "
            f"{things(found.squares.size - found.n_modes, 'correction')} with an error of "
            f"{found.largest_error:.1e}"
        )
    return f"<Structure: {text}>"


def dense_of(matrix: Any) -> FloatArray:
    """Return a matrix as a dense one."""
    return np.asarray(matrix.toarray() if is_sparse(matrix) else matrix, dtype=float)


def check_mass(mass: Any) -> None:
    """Refuse an unsymmetric or negative mass; rows of 0 are coordinates without mass."""
    diagonal = mass.diagonal()
    if ((diagonal > 0) & (diagonal < _LEAST_MASS)).any():
        i = int(np.argmax((diagonal > 0) & (diagonal < _LEAST_MASS)))
        raise InputError(
            f"mass[{i}, {i}] = {diagonal[i]:g}: must be 0 or at least {_LEAST_MASS:g}: choose "
            "other units"
        )
    if (diagonal < 0).any():
        i = int(np.argmin(diagonal))
        raise InputError(f"mass[{i}, {i}] = {diagonal[i]:g}: must not be negative")
    if is_sparse(mass):
        from viscovib.systems.sparse_pencil import check_mass as check_sparse_mass

        check_sparse_mass(mass)
        return
    asymmetry = np.abs(mass - mass.T).max()
    massive = mass.any(axis=1)
    if not massive.any():
        raise InputError("mass: must not be 0 everywhere")
    try:
        np.linalg.cholesky(mass[np.ix_(massive, massive)])
    except np.linalg.LinAlgError:
        asymmetry = np.inf
    if asymmetry > 1e-12 * np.abs(mass).max():
        raise InputError(
            "mass: must be symmetric and positive definite, but for coordinates without mass"
        )


def with_elements(
    stiffness: Any, damping: Any, elements: Sequence[ElementTerms]
) -> tuple[FloatArray, FloatArray]:
    """Return K and C, dense, with the linear parts of all elements."""
    total, damped = dense_of(stiffness).copy(), dense_of(damping).copy()
    for element in elements:
        k, c = element.powers.get(1, 0.0), element.damping
        if k or c:
            places = np.flatnonzero(element.direction)
            e = element.direction[places]
            total[np.ix_(places, places)] += k * np.outer(e, e)
            damped[np.ix_(places, places)] += c * np.outer(e, e)
    return total, damped


def with_damping(
    mass: Any, damping: Any, stiffness: Any, modal: ModalDamping, elements: Sequence[ElementTerms]
) -> Any:
    """Return C with modal and Rayleigh damping of the modes of K with the elements."""
    if is_sparse(mass):
        model = linear_model(mass, damping, stiffness, modal, elements)
        if not np.any(modal.ratio):
            return damping + modal.by_mass * mass + modal.by_stiffness * model.stiffness
        if mass.shape[0] > _MANY:
            raise InputError(
                f"modal_damping: with a speed, must be of at most {_MANY} coordinates in sparse "
                "matrices: use rayleigh or damping"
            )
    total, _ = with_elements(stiffness, damping, elements)
    more = matrix_of_modal(modal, dense_of(mass), total)
    if is_sparse(mass):
        from scipy.sparse import csc_array

        return damping + csc_array(more)
    return damping + more


def damped_outside(
    mass: Any, damping: Any, stiffness: Any, modal: ModalDamping,
    elements: Sequence[ElementTerms], inner: int,
) -> Any:  # fmt: skip
    """Return C with the damping of the modes without internal coordinates, the last ones."""
    n = mass.shape[0] - inner
    own, at_first = mass[:n, :n], damping[:n, :n]
    if np.any(modal.ratio) and not (own.diagonal() > 0).all():
        raise InputError(
            "modal_damping: with a Maxwell element, must not be given for coordinates without mass"
        )
    plain = [one._replace(direction=one.direction[:n]) for one in elements if one.series is None]
    more = with_damping(own, at_first, stiffness[:n, :n], modal, plain) - at_first
    return damping + block_diagonal(more, inner)


def block_diagonal(matrix: Any, n: int, entry: float = 0.0) -> Any:
    """Return a matrix with n more rows and columns, with an entry on their diagonal."""
    if not is_sparse(matrix):
        return np.pad(matrix, (0, n)) + np.diag(np.append(np.zeros(len(matrix)), [entry] * n))
    from scipy.sparse import block_diag, csc_array

    return csc_array(block_diag([matrix, csc_array(entry * np.eye(n))]))


def stiffness_parts(stiffness: Any, elements: Sequence[ElementTerms]) -> tuple[FloatArray, ...]:
    """K as in `with_elements` and, if not 0, its rounding errors; the sum of both is exact.

    So soft springs keep their digits next to stiff ones. Sums and products with rounding errors:
    Knuth, The Art of Computer Programming 2, 4.2.2; Dekker, Numer. Math. 18 (1971) 224.
    """
    total = dense_of(stiffness).copy()
    left = np.zeros_like(total)
    for element in elements:
        k = element.powers.get(1, 0.0)
        if not k:
            continue
        places = np.flatnonzero(element.direction)
        e, own = element.direction[places], np.ix_(places, places)
        square, square_left = _product(e[:, np.newaxis], e)
        added, added_left = _product(np.float64(k), square)
        before = total[own]
        total[own] = after = before + added
        kept = after - before
        left[own] += (before - (after - kept)) + (added - kept) + added_left + k * square_left
    return (total, left) if left.any() and np.isfinite(left).all() else (total,)


def _product(a: Any, b: Any) -> tuple[Any, Any]:
    """A rounded product and its rounding error."""
    product = a * b
    (a_high, a_low), (b_high, b_low) = _halves(a), _halves(b)
    left = ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low
    return product, left


def _halves(a: Any) -> tuple[Any, Any]:
    """Two numbers with half the digits each, whose sum is a."""
    part, power = np.frexp(a)
    high = np.ldexp(np.round(np.ldexp(part, 26)), power - 26)
    return high, a - high


def linear_model(
    mass: Any,
    damping: Any,
    stiffness: Any,
    modal: ModalDamping | None,
    elements: Sequence[ElementTerms],
    *,
    remembering: bool = False,
) -> LinearModel:
    """Return sparse K and C with the linear parts of elements, and M.

    ``remembering``: include the kernels of elements.
    """
    from viscovib.systems.linear_model import LinearModel
    from viscovib.systems.sparse_pencil import checked_sparse

    n = mass.shape[0]
    layers: list[ElementTerms] = []
    dampers: list[tuple[Any, Kernel]] = []
    elastic: list[tuple[float, FloatArray]] = []
    for e in elements:
        k = e.powers.get(1, 0.0)
        if remembering and e.kernel is not None and k:
            layers.append(e)
        else:
            elastic.append((k, e.direction))
        c = e.remembered_damping
        if remembering and e.kernel is not None and c:
            dampers.append((_of_elements(n, [(c, e.direction)]), e.kernel))
    total = checked_sparse("damping", damping)
    total = total + _of_elements(n, [(e.damping, e.direction) for e in elements])
    modal = ModalDamping() if modal is None else modal
    return LinearModel(
        checked_sparse("mass", mass),
        checked_sparse("stiffness", stiffness) + _of_elements(n, elastic),
        damping=total if total.nnz else None,
        rayleigh=(modal.by_mass, modal.by_stiffness),
        ratio=modal.ratio,  # type: ignore[arg-type]
        loss=modal.loss,  # type: ignore[arg-type]
        layers=[(_of_elements(n, [(e.powers[1], e.direction)]), e.kernel) for e in layers],  # type: ignore[misc]
        dampers=dampers,
    )


def _of_elements(n: int, parts: list[tuple[float, FloatArray]]) -> Any:
    """Sum of factor e e' over directions e."""
    from scipy.sparse import csc_array

    total = csc_array((n, n))
    for factor, direction in parts:
        if not factor:
            continue
        places = np.flatnonzero(direction)
        if places.size > _MANY:
            raise InputError(
                f"elements: one acts on {places.size} coordinates, must act on at most {_MANY} "
                "with sparse matrices"
            )
        e = csc_array(direction[:, np.newaxis])
        total = total + factor * (e @ e.T)
    return csc_array(total)


def modal_damping_of(structure: Any, n: int) -> ModalDamping | None:
    """The damping of a structure that does not couple its modes; None: no such damping."""
    ratio: float | FloatArray = 0.0
    if structure.modal_damping is not None:
        ratios = _native.real_array("modal_damping", structure.modal_damping)
        if ratios.shape not in ((), (n,)):
            raise InputError(f"modal_damping: must be one number or {n}, got {ratios.shape}")
        ratio = float(ratios) if ratios.ndim == 0 else ratios.copy()
    by_mass, by_stiffness = 0.0, 0.0
    if structure.rayleigh is not None:
        factors = _native.real_array("rayleigh", structure.rayleigh)
        if factors.shape != (2,):
            raise InputError("rayleigh: must be two factors, of mass and of stiffness")
        by_mass, by_stiffness = map(float, factors)
    loss = _native.number("loss_factor", structure.loss_factor)
    damping = ModalDamping(ratio, loss, by_mass, by_stiffness)
    given = np.any(ratio) or loss or by_mass or by_stiffness
    return damping if given else None


# Internal coordinates of Maxwell elements, behind the coordinates of the structure.

#: Name of an internal coordinate, and its unit.
_NAME, _UNIT = "maxwell", "m s"


def has_series(elements: Any) -> bool:
    """True if Maxwell elements are among the elements of a structure."""
    return isinstance(elements, (list, tuple)) and any(isinstance(e, Maxwell) for e in elements)


def extended(structure: Any, given: Mapping[str, Any]) -> tuple[list[Any], dict[str, Any]]:
    """Return the elements with internal coordinates, and the arguments with these coordinates.

    ``given``: arguments of the structure without them, with matrices in one form.
    """
    if np.any(structure.loss_factor):
        raise InputError(
            "loss_factor: must not be given with a Maxwell element, whose internal coordinate it "
            "would damp: use damping or modal_damping"
        )
    names, mass = given["names"], given["mass"]
    elements, (columns, stiffness, rates) = _with_inner(structure.elements, names, mass.diagonal())
    n, m = columns.shape

    def joined(matrix: Any, right: Any, below: Any, corner: Any) -> Any:
        blocks = [[matrix, right], [below, np.diag(corner)]]
        if not is_sparse(matrix):
            return np.block(blocks)
        from scipy.sparse import block_array, csc_array

        return csc_array(block_array([[csc_array(part) for part in row] for row in blocks]))

    none, wide = np.zeros((n, m)), columns * rates
    more = {
        "mass": joined(mass, none, none.T, stiffness),
        "damping": joined(given["damping"], columns, -columns.T, stiffness * rates),
        "stiffness": joined(given["stiffness"], wide, none.T, 0 * rates),
        "names": (*names, *(f"{_NAME}{j + 1}" for j in range(m))),
        "units": (*given["units"], *[_UNIT] * m),
        "layers": [(joined(one, none, none.T, 0 * rates), k) for one, k in given["layers"]],
    }
    if given["base_direction"] is not None:
        more["base_direction"] = longer(given["base_direction"], n, m)
    return elements, more


def _with_inner(elements: Sequence[Any], names: Sequence[str], mass: FloatArray) -> tuple[Any, Any]:
    """Return elements with the names of internal coordinates, and A, k and r of the coordinates.

    ``names`` and ``mass``: coordinates, and the diagonal of the mass matrix, shape (n,). Column j
    of A, shape (n, m), is k e of the Maxwell element j; k and r have the shape (m,).
    """
    n, places = len(names), name_places(names)
    m = sum(isinstance(one, Maxwell) for one in elements)
    found, columns, numbers = [], [], []
    for i, one in enumerate(elements):
        if isinstance(one, Maxwell):
            e = direction_of(f"elements[{i}].on", one.on, n, places)
            softness = float((e[mass > 0] ** 2 / mass[mass > 0]).sum())
            rate = float(np.sqrt(one.stiffness * softness)) if softness else 1.0
            columns.append(one.stiffness * e)
            numbers.append((one.stiffness, rate))
        own = replace(one, on=longer(one.on, n, m)) if hasattr(one, "on") else one
        if isinstance(own, Maxwell):
            object.__setattr__(own, "_inner", f"{_NAME}{len(columns)}")
            object.__setattr__(own, "_rate", numbers[-1][1])
        found.append(own)
    stiffness, rates = np.array(numbers).T
    return found, (np.array(columns).T, stiffness, rates)


def longer(on: Any, n: int, m: int) -> Any:
    """A direction given by n numbers with m more numbers, 0."""
    if isinstance(on, Mapping):
        return {name: longer(one, n, m) for name, one in on.items()}
    numbers = isinstance(on, (list, tuple, np.ndarray)) and not any(isinstance(x, str) for x in on)
    return np.append(np.asarray(on), np.zeros(m)) if numbers and np.shape(on) == (n,) else on
