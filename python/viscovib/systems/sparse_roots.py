"""Characteristic roots of sparse models with memory, by Newton's method on the full matrices.

D(s) x = 0, x_k = 1, D(s) = sum_i c_i(s) A_i as in `reduction`. Newton's method for both together
(Mehrmann and Voss 2004, section 3), x_k the largest entry of x:

    [ D(s)  D'(s) x ] [dx]     [ D(s) x ]
    [ e_k'     0    ] [ds] = - [    0   ]                                                       (1)

This matrix stays regular at a simple root, where D(s) is singular. For fine meshes D(s) x is a
small difference of large numbers, so it is computed in extended precision.

The starting value decides which root is found. Memory makes a structure softer at lower
frequencies: Re D(i omega) + omega^2 M increases with omega. So each mode j has one frequency with
omega_j(K(omega)) = omega, the j-th natural frequency of the stiffness at omega. It is the start.
"""

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.sparse import block_array, csc_array

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.errors import ConvergenceWarning, InputError, caller
from viscovib.kernels.relaxation import Kernel
from viscovib.systems.characteristic import CharacteristicRoots
from viscovib.systems.layers import matrices_of
from viscovib.systems.linear_model import LinearModel, damping_and_layers, modal_rates
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.sparse_pencil import Modes, Pencil, check_memory, factored
from viscovib.systems.spring_groups import Springs, is_definite
from viscovib.systems.structure_matrices import dense_of, linear_model
from viscovib.systems.structure_rest import matrix_of_modal

#: Largest number of steps of Newton's method, and of the search for a starting frequency.
_NEWTON, _BEGINNING = 30, 40
#: Newton's method has converged if a step is below the first fraction of s, or if it is below the
#: second fraction and no longer decreases.
_CONVERGED, _ROUNDING = 1e-13, 1e-10
#: Largest number of coordinates for all roots by default.
_FEW = 20
#: Largest number of coordinates for all eigenvalues, if some roots were not found.
_SMALL = 200
#: Largest number of coordinates for the search of growing real roots.
_DENSE = 500
#: Relative accuracy of a starting frequency.
_CLOSE = 1e-3


def sparse_roots(model: LinearModel, count: int) -> tuple[ComplexArray, ComplexArray]:
    """Return the first oscillatory roots s (1/s), Im s > 0, and their shapes, shape (n, count).

    They are in the order of the modes; NaN where Newton's method does not converge. Rigid and
    negative modes have no oscillatory root and are skipped.
    """
    n = model.mass.shape[0]
    if np.any(model.ratio):
        raise InputError("damping: modal ratios have no matrix; use the roots of the modes")
    roots = np.full(count, np.nan, dtype=complex)
    shapes = np.full((n, count), np.nan, dtype=complex)
    skipped = None
    omega = 0.0
    for j in range(count):
        if skipped is None:
            at_once = _modes_at(model, np.inf, count)
            skipped = int((at_once[0] <= 0).sum())
        omega, shape = _beginning(model, j + skipped, max(omega, 0.0))
        if not omega:
            break
        s, found, converged = _newton(model, omega, shape)
        twice = np.abs(roots[:j] - s) < 1e-9 * abs(s)
        same = twice & (_likeness(shapes[:, :j], found) > 1 - 1e-6)
        if converged and not same.any() and s.imag > 0:
            roots[j], shapes[:, j] = s, found
    if np.isnan(roots).any():
        _fill(model, roots, shapes)
    if np.isnan(roots).any():
        warnings.warn(
            f"{int(np.isnan(roots).sum())} of {count} characteristic roots were not found (NaN)",
            ConvergenceWarning,
            stacklevel=caller(),
        )
    return roots, shapes


def _fill(model: LinearModel, roots: ComplexArray, shapes: ComplexArray) -> None:
    """Fill in missing roots of a small model from its eigenvalues that were not found.

    With damping that couples modes, Newton's method may lead from two modes to the same root. If
    some mode does not oscillate, the assignment of roots to modes is not unique.
    """
    n = model.mass.shape[0]
    if model.layers or model.dampers or model.loss or n > _SMALL:
        return
    mass, stiffness = (
        np.asarray(m.toarray()) for m in map(csc_array, (model.mass, model.stiffness))
    )
    damping = model.rayleigh[0] * mass + model.rayleigh[1] * stiffness
    if model.damping is not None:
        damping = damping + csc_array(model.damping).toarray()
    try:
        right = -np.linalg.solve(mass, np.hstack([stiffness, damping]))
    except np.linalg.LinAlgError:
        return
    found, vectors = np.linalg.eig(np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), right]))
    above = np.flatnonzero(found.imag > 1e-9 * np.abs(found))
    if above.size != n:
        return
    for s in roots[~np.isnan(roots)]:
        above = np.delete(above, np.argmin(np.abs(found[above] - s)))
    above = above[np.argsort(np.abs(found[above]))]
    for j, i in zip(np.flatnonzero(np.isnan(roots)), above, strict=False):
        x = vectors[:n, i]
        roots[j], shapes[:, j] = found[i], x / x[np.argmax(np.abs(x))]


def structure_roots(structure: Any, count: Any, layers: Any) -> CharacteristicRoots:
    """`Structure.characteristic_roots`."""
    n = structure.n_coordinates
    # Coordinates without mass have no roots of their own.
    most = max(1, min(200, int(np.count_nonzero(structure.mass.diagonal()))))
    wanted = _native.integer("count", min(6, most) if count is None else count, 1, most)
    model = linear_model(
        structure.mass, structure.damping, structure.stiffness, structure._uncoupled,
        structure._all_elements, remembering=True,
    )  # fmt: skip
    own = matrices_of(structure._layers.whole, n, sparse=True)
    more = matrices_of(layers, n, sparse=True)
    relaxing = [*model.layers, *own, *more]
    modal = structure._uncoupled
    if structure._reduced is not None and np.any(model.ratio):
        model, modal = _in_modes(structure, relaxing, len(more), model.dampers), None
    else:
        model = model._replace(layers=relaxing)
    if structure._fixed:
        model = _without(model, [structure._places[name] for name in structure._fixed])
    if count is None and _has_all(model):
        return _all_roots(model, modal)
    roots, _ = sparse_roots(model, wanted)
    real = _growing(model)
    growing = 2 * int((roots.real > 0).sum()) + (0 if real is None else real.size)
    region = f"the first {wanted} oscillatory roots" + (
        " and Im s = 0, Re s > 0" if real is not None else ""
    )
    return CharacteristicRoots(roots, np.zeros(0) if real is None else real, growing, False, region)


def _has_all(model: LinearModel) -> bool:
    """True if all roots of the model are those of a polynomial system of few coordinates."""
    small = model.mass.shape[0] <= _FEW and is_definite(dense_of(model.mass))
    return small and not (model.dampers or np.any(model.loss))


def _all_roots(model: LinearModel, modal: Any) -> CharacteristicRoots:
    """All roots of a model of few coordinates, as those of a polynomial system.

    ``modal``: damping by modes; None if the matrices contain it.
    """
    mass, stiffness = (dense_of(matrix) for matrix in (model.mass, model.stiffness))
    damping = np.zeros_like(mass) if model.damping is None else dense_of(model.damping)
    if modal is not None:
        damping = damping + matrix_of_modal(modal, mass, dense_of(model.at_rest))
    layers = [Springs(stiffness=dense_of(matrix), kernel=kernel) for matrix, kernel in model.layers]
    return PolynomialSystem(
        mass=mass, damping=damping, springs=[Springs(stiffness=stiffness), *layers]
    ).characteristic_roots()


def _growing(model: LinearModel) -> FloatArray | None:
    """Positive real roots, largest first: where the number of negative eigenvalues of D changes.

    None: D is too large for dense eigenvalues, or not symmetric.
    """
    n = model.mass.shape[0]
    matrices = [m for m in model.matrices if m is not None]
    if n > _DENSE or np.any(model.ratio) or any(abs(m - m.T).max() > 0 for m in matrices):
        return None
    model = model._replace(loss=0.0)
    dense = [np.asarray(csc_array(m).toarray()) for m in model.matrices]

    def below(s: float) -> int:
        values = model.coefficients(np.array([s + 0j]))[:, 0].real
        whole = sum(value * matrix for value, matrix in zip(values, dense, strict=True))
        sizes = np.linalg.eigvalsh(whole)
        return int((sizes < -1e-13 * np.abs(sizes).max()).sum())

    size = np.abs(dense[0].diagonal()).max()
    fastest = float(np.sqrt(np.abs(csc_array(model.at_rest).diagonal()).max() / size)) or 1.0
    roots: list[float] = []
    low, high = 1e-9 * fastest, 1e6 * fastest
    parts = [(low, below(low), high, below(high))]
    while parts:
        a, n_a, b, n_b = parts.pop()
        if n_a == n_b:
            continue
        middle = float(np.sqrt(a * b))
        if b - a <= 1e-12 * b or not a < middle < b:
            roots += [middle] * abs(n_a - n_b)
            continue
        n_middle = below(middle)
        parts += [(a, n_a, middle, n_middle), (middle, n_middle, b, n_b)]
    return np.array(sorted(roots, reverse=True))


def _without(model: LinearModel, places: Sequence[int]) -> LinearModel:
    """The model without coordinates that are supports."""
    left = np.delete(np.arange(model.mass.shape[0]), places)

    def part(matrix: Any) -> Any:
        return None if matrix is None else csc_array(csc_array(matrix)[left][:, left])

    return model._replace(
        mass=part(model.mass), stiffness=part(model.stiffness), damping=part(model.damping),
        layers=[(part(m), kernel) for m, kernel in model.layers],
        dampers=[(part(m), kernel) for m, kernel in model.dampers],
    )  # fmt: skip


def _in_modes(
    structure: Any,
    relaxing: Sequence[tuple[Any, Kernel]],
    n_more: int,
    dampers: Sequence[tuple[Any, Kernel]],
) -> LinearModel:
    """The reduced model, with a matrix of its modal ratios, and its layers and dampers with memory.

    The last ``n_more`` layers do not belong to the structure.
    """
    found = structure._reduced.reduction
    damping, _ = damping_and_layers(structure._reduced.model, found)
    layers, dampers = (
        [(csc_array(found.shapes.T @ (matrix @ found.shapes)), kernel) for matrix, kernel in parts]
        for parts in (relaxing, dampers)
    )
    # Modes and damping refer to the springs without relaxation.
    own = layers[: len(layers) - n_more]
    elastic = np.diag(found.squares) - sum(matrix.toarray() for matrix, _ in own)
    return LinearModel(
        csc_array(np.eye(found.squares.size)), csc_array(elastic), csc_array(damping),
        layers=layers, dampers=dampers,
    )  # fmt: skip


def _beginning(model: LinearModel, j: int, lowest: float) -> tuple[float, FloatArray]:
    """Frequency omega that mode j of the stiffness at omega has, and its shape."""
    omega = np.inf
    shape = np.zeros(0)
    for _ in range(_BEGINNING):
        squares, shapes = _modes_at(model, omega, j + 1)
        if j >= squares.size:
            return 0.0, shape
        shape = shapes[:, j]
        if squares[j] <= 0:
            return 0.0, shape
        new = float(np.sqrt(squares[j]))
        if abs(new - omega) <= _CLOSE * new or not model.layers:
            return new, shape
        omega = new
    return float(omega), shape


def _modes_at(model: LinearModel, omega: float, count: int) -> tuple[FloatArray, FloatArray]:
    """The lowest modes of Re K(omega); for an infinite frequency those without relaxation."""
    stiffness = model.stiffness
    for layer, kernel in model.layers:
        kept = 1.0 if np.isinf(omega) else float(1 - kernel.cosine(omega))
        stiffness = stiffness + kept * layer
    scale = abs(stiffness).max() / abs(model.mass).max()
    pencil = Pencil(model.mass, csc_array(stiffness), -1e-12 * scale)
    modes = pencil.lowest_count(count)
    return modes.squares, modes.shapes


def _newton(
    model: LinearModel, omega: float, shape: FloatArray
) -> tuple[complex, ComplexArray, bool]:
    """Newton's method (1) from a mode."""
    x = shape.astype(np.clongdouble)
    s = _rayleigh(model, 1j * omega, shape)
    k = int(np.argmax(np.abs(shape)))
    x = x / x[k]
    n = x.size
    row = csc_array(([1.0], ([0], [k])), shape=(1, n))
    smallest = np.inf
    for _ in range(_NEWTON):
        values, slopes = _coefficients(model, s)
        column = _product(model, slopes, x).astype(complex)
        right = np.append(-_product(model, values, x), 0).astype(complex)
        # Scaled by the matrix: otherwise its units would determine the pivots.
        size = np.abs(column).max()
        bordered = block_array(
            [[combined(model, values), csc_array(column[:, np.newaxis])], [size * row, None]],
            format="csc",
        )
        try:
            step = solved(bordered, right)
        except RuntimeError:
            return s, x.astype(complex), False
        if not np.isfinite(step).all():
            return s, x.astype(complex), False
        s, x = complex(s + step[n]), x + step[:n]
        moved = abs(step[n]) / abs(s)
        # Converged, or as close as the rounding errors allow.
        if moved <= _CONVERGED or (moved <= _ROUNDING and moved >= 0.5 * smallest):
            return s, x.astype(complex), True
        smallest = min(smallest, moved)
    return s, x.astype(complex), False


def _product(model: LinearModel, values: ComplexArray, x: Any) -> Any:
    """D x in extended precision."""
    total = np.zeros(x.size, dtype=np.clongdouble)
    for value, matrix in zip(values, model.matrices, strict=True):
        total += np.clongdouble(value) * (matrix.astype(np.longdouble) @ x)
    return total


def _rayleigh(model: LinearModel, s: complex, x: FloatArray) -> complex:
    """Root of x' D(s) x = 0 near s (Rayleigh functional of this shape)."""
    weights = np.array([x @ (matrix @ x) for matrix in model.matrices])
    start = s
    for _ in range(_NEWTON):
        values, slopes = _coefficients(model, s)
        step = (values @ weights) / (slopes @ weights)
        s = s - step
        if abs(step) < 1e-6 * abs(s):
            break
    near = np.isfinite(s) and 0.2 * abs(start) < abs(s) < 5 * abs(start) and s.imag > 0
    return s if near else start


def _coefficients(model: LinearModel, s: complex) -> tuple[ComplexArray, ComplexArray]:
    """c_i(s) and their derivatives by a central difference, sufficient for Newton's method."""
    h = 1e-5 * abs(s)
    at = model.coefficients(np.array([s, s + h, s - h]))
    return at[:, 0], np.asarray((at[:, 1] - at[:, 2]) / (2 * h))


def combined(model: LinearModel, values: ComplexArray) -> csc_array:
    """D(s) from the values c_i(s)."""
    total = values[0] * model.mass
    for value, matrix in zip(values[1:], model.matrices[1:], strict=True):
        total = total + value * matrix
    return total


def solved(
    matrix: csc_array, right: ComplexArray, product: Callable[[Any], Any] | None = None
) -> ComplexArray:
    """Solution of a sparse complex system by factorization.

    It is corrected by its residual in extended precision: for fine meshes rounding errors matter,
    even those of the sum that forms the matrix. ``product``: product of this sum and a vector
    without these errors.
    """
    check_memory(matrix)
    wide = matrix.astype(np.clongdouble)
    times = product or (lambda x: wide @ x)
    rows = abs(matrix).sum(axis=1)
    for symmetric in (True, False):
        factors = factored(matrix, symmetric=symmetric)
        if factors is None:
            continue
        found = factors.solve(right).astype(np.clongdouble)
        for _ in range(2):
            left = right - times(found)
            found = found + factors.solve(left.astype(complex))
        left = np.abs(right - times(found)).astype(float)
        scale = rows * float(np.abs(found).max()) + np.abs(right)
        if np.isfinite(left).all() and (left <= 1e-10 * scale).all():
            return np.asarray(found.astype(complex))
    raise RuntimeError("singular")


def direct_solution(
    model: LinearModel, s: complex, right: ComplexArray, modes: Modes | None = None
) -> ComplexArray:
    """D(s)^-1 right from the full matrices.

    ``modes``: modes with damping ratios, if given. Their damping, M Phi r Phi' M added to a part
    of K (`ModalDampingMatrix`), is full. With y = Phi' M x as further unknowns the system stays
    sparse.
    """
    if not np.any(model.ratio):
        values = model.coefficients(np.array([s]))[:, 0]
        return solved(combined(model, values), right, lambda x: _product(model, values, x))
    if modes is None:
        raise InputError("damping: modal ratios have no matrix without their modes")
    rates, slope = modal_rates(model, modes.squares)
    a, b = model.rayleigh
    plain = model._replace(ratio=0.0, rayleigh=(a, b + slope))
    sparse = combined(plain, plain.coefficients(np.array([s]))[:, 0])
    seen = np.asarray(model.mass @ modes.shapes)
    # Scaled by the matrix: otherwise its units would determine the pivots.
    unit = abs(sparse).max() / np.abs(seen).max()
    whole = block_array(
        [
            [sparse, csc_array(seen * (s * (rates - slope * modes.squares)))],
            [csc_array(unit * seen.T), csc_array(-unit * np.eye(rates.size))],
        ],
        format="csc",
    )
    return solved(whole, np.append(right, np.zeros(rates.size)))[: right.size]


def _likeness(shapes: ComplexArray, shape: ComplexArray) -> FloatArray:
    sizes = np.linalg.norm(shapes, axis=0) * np.linalg.norm(shape)
    return np.asarray(np.abs(shapes.conj().T @ shape) / sizes)
