"""Linear subsystem of a structure with layers with memory, as modes of an extended state.

A layer K_j with R_j(t) = sum_i a_ij exp(-b_ij t) adds to the equations

    M u'' + C u' + K u - sum_j K_j sum_i z_ij = p,    z_ij' = -b_ij z_ij + a_ij u,               (1)

K with the unrelaxed stiffness of all layers (Golla and Hughes, J. Appl. Mech. 52 (1985) 897, in
different variables). With K_j = L_j N_j^T of full column rank only y_ij = N_j^T z_ij is stored. So
the compliance is rational, and exactly a sum over the modes of (u, u', y).

Coordinates without mass (0) follow the others (1) without delay,
u_0 = K_00^-1 (p_0 - K_01 u_1 + sum_ij L_0j y_ij). Rigid bodies without springs and dampers have a
double root at 0; they are separated first, as real modes.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from viscovib._native import ComplexArray, FloatArray
from viscovib.errors import InputError
from viscovib.systems.exact_products import Sliced
from viscovib.systems.refined_modes import (
    RelaxingPart,
    bits_for,
    elastic_part,
    refined_poles,
)
from viscovib.systems.structure_rest import (
    ModalDamping,
    Remembered,
    Rest,
    dense_rest,
    exactly_by,
    idle_bend,
    matrix_of_modal,
)

#: Largest number of states for which all modes are computed.
_MOST_STATES = 4000
#: Relative sizes below which singular values of a layer, poles and entries count as 0.
_RANK, _RIGID, _OFF_DIAGONAL = 1e-12, 1e-13, 1e-12
#: Largest relative error of the compliance by the sum over modes, and the frequencies of the check,
#: in units of a middle frequency.
_LOST, _PROBES = 1e-7, (0.05, 0.7, 1.9, 11.0)

#: Bits of products with layers; relative distance from a rate within which a pole has no motion.
_BITS, _NEARBY = 64.0, 1e-10
#: Rates above this multiple of the fastest mode act as springs and dampers.
_FAST = 1e5

#: A stiffness matrix, and weights (1/s) and rates (1/s) of its kernel.
Layer = tuple[FloatArray, FloatArray, FloatArray]


class RelaxingModes(NamedTuple):
    """Modes of (1) in the form of `structure_rest.Rest`."""

    poles: ComplexArray
    left: ComplexArray
    right: ComplexArray
    #: K_00^-1 on all coordinates; None: all have mass.
    flexibility: FloatArray | None
    remembered: tuple[Remembered, ...]
    #: Free rigid-body modes, mass-normalised, shape (n, r).
    bodies: FloatArray
    relaxing: tuple[RelaxingPart, ...]


def relaxing_rest(
    mass: FloatArray,
    damping: FloatArray,
    stiffness: FloatArray,
    modal: ModalDamping | None,
    layers: Sequence[Layer],
    alone: Sequence[FloatArray] = (),
) -> Rest:
    """Return all modes of dense matrices with layers with memory.

    ``stiffness`` and ``modal`` refer to the structure without relaxation; ``alone``: parts whose
    exact sum is the stiffness without layers.
    """
    if modal is not None and np.any(modal.loss):
        raise InputError("loss_factor: must be 0 with layers, whose kernels are their losses")
    symmetric = all(
        np.abs(m - m.T).max() <= _OFF_DIAGONAL * np.abs(m).max()
        for m in (damping, stiffness, *(part[0] for part in layers))
        if m.any()
    )
    if symmetric and mass.any(axis=1).all():
        parts = [*alone, *(layer[0] for layer in layers)] if alone else []
        stiff = dense_rest(mass, damping, stiffness, modal, parts=parts)
        bits = max(bits_for(np.abs(stiff.squares)), _BITS)
        seen = [_in_modes(stiff.shapes, part[0], bits) for part in layers]
        if stiff.squares.size and all(_is_diagonal(matrix) for matrix in seen):
            springs, relaxing = _elastic_and_relaxing(stiffness, layers, alone)
            rest = _mode_by_mode(mass, stiff, seen, layers)
            return rest._replace(springs=springs, relaxing=relaxing)
    if modal is not None:
        damping = damping + matrix_of_modal(modal, mass, stiffness)
    found = relaxing_modes(mass, damping, stiffness, layers, alone)
    zero = np.zeros(found.bodies.shape[1])
    flexible = found.flexibility
    given = None if flexible is None else partial(_flexed, flexible)
    return Rest(
        zero, zero, zero, found.bodies, found.poles, found.left, found.right, given,
        found.remembered, exactly_by(damping), alone[0] if alone else stiffness,
        found.relaxing,
    )  # fmt: skip


def _elastic_and_relaxing(
    stiffness: FloatArray, layers: Sequence[Layer], alone: Sequence[FloatArray]
) -> tuple[FloatArray, tuple[RelaxingPart, ...]]:
    """K and the parts added to it, from the stiffness of `relaxing_rest`."""
    held, *more = alone or (stiffness,)
    share = 1.0 if alone else 0.0
    parts = (RelaxingPart(*layer, share) for layer in layers)
    return held, (*parts, *map(elastic_part, more))


def _in_modes(shapes: FloatArray, matrix: FloatArray, bits: float) -> FloatArray:
    return np.asarray(shapes.T @ Sliced(matrix, bits).times(shapes).astype(float))


def _is_diagonal(matrix: FloatArray) -> bool:
    off = np.abs(matrix - np.diag(np.diag(matrix))).max(initial=0.0)
    return bool(off <= _OFF_DIAGONAL * np.abs(matrix).max(initial=0.0))


def _mode_by_mode(
    mass: FloatArray, alone: Rest, seen: Sequence[FloatArray], layers: Sequence[Layer]
) -> Rest:
    """The linear subsystem if no layer couples the modes: each mode has its own few states."""
    bends = np.array([np.diag(matrix) for matrix in seen])
    relaxing = (np.abs(bends) > _RANK * np.abs(bends).max()).any(axis=0)
    one = np.ones((1, 1))
    places = np.flatnonzero(relaxing)
    modes = [
        relaxing_modes(
            one, alone.rates[m] * one, alone.squares[m] * one,
            [(k * one, a, b) for k, (_, a, b) in zip(bends[:, m], layers, strict=True)],
        )
        for m in places
    ]  # fmt: skip
    starts = np.concatenate([[0], np.cumsum([mode.poles.size for mode in modes])]).astype(int)
    matrices = [matrix for matrix, _, rates in layers for _ in rates]
    remembered = []
    for i, parts in enumerate(zip(*(mode.remembered for mode in modes), strict=True)):
        pushed = np.zeros((starts[-1], mass.shape[0]), dtype=complex)
        for column, part in enumerate(parts):
            if part.layer.any():
                own = slice(starts[column], starts[column + 1])
                pushed[own] = np.outer(part.pushed, alone.shapes[:, places[column]])
        first = modes[0].remembered[i]
        remembered.append(Remembered(first.weight, first.rate, None, matrices[i], pushed))

    def spread(name: str) -> ComplexArray:
        columns = [
            np.outer(alone.shapes[:, m], getattr(mode, name)[0])
            for m, mode in zip(places, modes, strict=True)
        ]
        return np.concatenate(columns, axis=1)

    inertia = np.asarray(mass @ alone.shapes)

    still = ~relaxing
    return Rest(
        alone.squares[still], alone.rates[still], alone.losses[still], alone.shapes[:, still],
        np.concatenate([mode.poles for mode in modes]), spread("left"), spread("right"), None,
        tuple(remembered), resisting=partial(_resisting_modes, inertia, alone.rates),
    )  # fmt: skip


def _flexed(flexible: FloatArray, forces: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Deflections of the omitted modes by forces, and their part times s."""
    return flexible @ forces, np.zeros_like(forces)


def _resisting_modes(inertia: FloatArray, rates: FloatArray, u: FloatArray) -> FloatArray:
    """C u of modal damping, with M Phi."""
    return np.asarray(inertia @ (rates * (inertia.T @ u)))


def relaxing_modes(
    mass: FloatArray,
    damping: FloatArray,
    stiffness: FloatArray,
    layers: Sequence[Layer],
    alone: Sequence[FloatArray] = (),
) -> RelaxingModes:
    """Return the modes of (1); ``stiffness``: without relaxation, ``alone``: without layers.

    ``alone`` contains parts whose sum is the exact stiffness.
    """
    n = mass.shape[0]
    idle = ~mass.any(axis=1)
    bodies = _bodies(mass, damping, stiffness, layers)
    slow, soft, damped = layers, stiffness, damping
    if not idle.any():
        slow, soft, damped = _without_fast_terms(mass, damping, stiffness, layers)
    parts = [(*_factors(matrix), weights, rates) for matrix, weights, rates in slow]
    count = 2 * int((~idle).sum()) + sum(seen.shape[1] * rates.size for _, seen, _, rates in parts)
    if count > _MOST_STATES:
        raise InputError(
            f"layers: {count} states with what the layers remember, must be at most {_MOST_STATES} "
            "(fewer coordinates, layers of lower rank, kernels of fewer exponentials)"
        )
    system = _States(mass, damped, soft, parts, idle, bodies)
    poles, left, right, rows = system.modes()
    flexibility = None
    if idle.any():
        flexibility = np.zeros((n, n))
        flexibility[np.ix_(idle, idle)] = system.bend
    held, relaxing = _elastic_and_relaxing(stiffness, layers, alone)

    def more(at: ComplexArray, forces: ComplexArray) -> ComplexArray:
        moved = bodies @ ((bodies.T @ forces) / at**2)
        return moved if flexibility is None else moved + flexibility @ forces

    poles, left, right = refined_poles(poles, left, right, mass, damping, held, relaxing, more)
    poles[np.abs(poles) <= _RIGID * np.abs(poles).max(initial=0.0)] = 0.0
    remembered = []
    places = list(reversed(system.places))
    for i, (matrix, weights, rates) in enumerate(layers):
        for a, b in zip(weights, rates, strict=True):
            # right^T/(pole + b), except for poles that do not move u.
            nearby = poles + b
            moving = np.abs(nearby) > _NEARBY * b
            pushed = np.zeros((poles.size, n), dtype=complex)
            if places and places[-1][:2] == (i, b):
                *_, acts, first = places.pop()
                pushed = rows[:, first : first + acts.shape[1]] @ np.linalg.pinv(acts)
            pushed[moving] = right.T[moving] / nearby[moving, np.newaxis]
            remembered.append(Remembered(float(a), float(b), None, matrix, pushed))
    found = RelaxingModes(poles, left, right, flexibility, tuple(remembered), bodies, relaxing)
    _check(found, mass, damping, stiffness, layers, system.middle)
    return found


def _without_fast_terms(
    mass: FloatArray, damping: FloatArray, stiffness: FloatArray, layers: Sequence[Layer]
) -> tuple[list[Layer], FloatArray, FloatArray]:
    """Layers without terms of rates far above all modes, and K and C that include these terms.

    w/(s + b) = w/b - s w/b^2 + ...: a softer spring and a damper. The poles near -b add less than
    (s/b)^4 to the compliance. The refinement of the other poles uses all terms.
    """
    size = np.linalg.norm(np.linalg.solve(mass, stiffness)) ** 0.5
    fast = _FAST * (size + np.linalg.norm(np.linalg.solve(mass, damping)))
    slow = []
    for matrix, weights, rates in layers:
        one = rates > fast
        slow.append((matrix, weights[~one], rates[~one]))
        stiffness = stiffness - (weights[one] / rates[one]).sum() * matrix
        damping = damping + (weights[one] / rates[one] ** 2).sum() * matrix
    return slow, stiffness, damping


def _factors(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """L and N of a layer L N^T."""
    left, sizes, right = np.linalg.svd(matrix)
    kept = sizes > _RANK * max(sizes[0], np.finfo(float).tiny)
    roots = np.sqrt(sizes[kept])
    return left[:, kept] * roots, right[kept].T * roots


def _bodies(
    mass: FloatArray, damping: FloatArray, stiffness: FloatArray, layers: Sequence[Layer]
) -> FloatArray:
    """Free rigid-body motions, mass-normalised."""
    from scipy.linalg import null_space

    matrices = [damping, stiffness, *(matrix for matrix, _, _ in layers)]
    scaled = [np.ldexp(m, -np.frexp(np.abs(m).max())[1]) for m in matrices if m.any()]
    both = [part for m in scaled for part in (m, m.T)]
    found = null_space(np.vstack(both), rcond=_RANK) if both else np.eye(mass.shape[0])
    if not found.shape[1]:
        return found
    if both:
        # With stiff springs the result has their rounding errors along soft springs.
        back = np.linalg.pinv(np.vstack(both), rcond=_RANK)
        exact = [Sliced(part, 2 * _BITS) for part in both]
        for _ in range(2):
            bent = np.concatenate([part.times(found).astype(float) for part in exact])
            found = found - back @ bent
    inertia = found.T @ mass @ found
    root = np.linalg.cholesky(inertia)
    return np.asarray(np.linalg.solve(root, found.T).T)


class _States:
    """x' = A x + B p, u = C x + F p without free rigid bodies, in units of a middle frequency."""

    def __init__(
        self, mass: Any, damping: Any, stiffness: Any, parts: Any, idle: Any, bodies: Any
    ) -> None:
        n = mass.shape[0]
        kept = ~idle
        self.bend = idle_bend(damping, stiffness, idle)
        # u = whole v + idle part, p acts on v by carry^T.
        follow, carry = np.zeros((n, int(kept.sum()))), np.zeros((n, int(kept.sum())))
        follow[kept] = carry[kept] = np.eye(int(kept.sum()))
        follow[idle] = -self.bend @ stiffness[np.ix_(idle, kept)]
        carry[idle] = -self.bend.T @ stiffness[np.ix_(kept, idle)].T
        bend = np.zeros((n, n))
        bend[np.ix_(idle, idle)] = self.bend
        m1 = mass[np.ix_(kept, kept)]
        # v = shapes w with unit mass, without free bodies.
        root = np.linalg.cholesky(m1)
        shapes = np.linalg.inv(root).T
        if bodies.shape[1]:
            body = root.T @ bodies[kept]
            shapes = shapes @ np.linalg.svd(body)[0][:, body.shape[1] :]
        out, into = follow @ shapes, carry @ shapes
        k = into.T @ stiffness @ out
        c = shapes.T @ damping[np.ix_(kept, kept)] @ shapes
        m = shapes.shape[1]
        self.middle = float(np.sqrt(np.linalg.norm(k) / np.sqrt(max(m, 1)))) or 1.0
        unit = self.middle
        sizes = [seen.shape[1] for _, seen, _, rates in parts for _ in rates]
        starts = 2 * m + np.concatenate([[0], np.cumsum(sizes, dtype=int)]).astype(int)
        total = int(starts[-1])
        matrix, pushed = np.zeros((total, total)), np.zeros((total, n))
        shown = np.zeros((n, total))
        matrix[:m, m : 2 * m] = unit * np.eye(m)
        matrix[m : 2 * m, :m], matrix[m : 2 * m, m : 2 * m] = -k / unit, -c
        pushed[m : 2 * m] = into.T / unit
        shown[:, :m] = out
        self.places = []
        held: list[tuple[int, FloatArray, FloatArray, float, float]] = []
        for i, (left, seen, weights, rates) in enumerate(parts):
            for a, b in zip(weights, rates, strict=True):
                first = int(starts[len(held)])
                held.append((first, left, seen, a, b))
                self.places.append((i, b, left, first))
        for first, left, seen, a, b in held:
            rows = slice(first, first + seen.shape[1])
            matrix[rows, rows] -= b * np.eye(seen.shape[1])
            matrix[rows, :m] += a * (seen.T @ out)
            pushed[rows] += a * (seen.T @ bend)
            for other, other_left, *_ in held:
                columns = slice(other, other + other_left.shape[1])
                matrix[rows, columns] += a * (seen.T @ bend @ other_left)
            matrix[m : 2 * m, rows] += into.T @ left / unit
            shown[:, rows] += bend @ left
        self.matrix, self.pushed, self.shown = matrix, pushed, shown

    def modes(self) -> tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray]:
        """Poles, left and right vectors of the sum, and weights of the states in each mode."""
        from scipy.linalg import eig

        total = self.matrix.shape[0]
        if not total:
            none = np.zeros((self.shown.shape[0], 0), dtype=complex)
            return np.zeros(0, dtype=complex), none, none, np.zeros((0, 0), dtype=complex)
        poles, lefts, rights = eig(self.matrix, left=True, right=True)
        scale = np.einsum("im,im->m", lefts.conj(), rights)
        if not np.abs(scale).min() > 0:
            raise _defective()
        rows = (lefts.conj() / scale).T
        return poles, self.shown @ rights, (rows @ self.pushed).T, rows


def _check(
    found: RelaxingModes, mass: Any, damping: Any, stiffness: Any, layers: Any, middle: float
) -> None:
    """Refuse nearly defective modes, whose sum is not the compliance."""
    n = mass.shape[0]
    load = np.cos(np.arange(1.0, n + 1))
    for part in _PROBES:
        s = 1j * part * middle
        whole = stiffness + s * damping + s**2 * mass
        for matrix, weights, rates in layers:
            whole = whole - (weights / (s + rates)).sum() * matrix
        mixed = found.left @ ((found.right.T @ load) / (s - found.poles))
        mixed = mixed + found.bodies @ (found.bodies.T @ load) / s**2
        if found.flexibility is not None:
            mixed = mixed + found.flexibility @ load
        lost = np.abs(whole @ mixed - load).max()
        size = (np.abs(whole) @ np.abs(mixed)).max() + np.abs(load).max()
        if not lost <= _LOST * size:
            raise _defective()


def _defective() -> InputError:
    return InputError(
        "damping: the structure has defective modes (as critically damped ones under a damping "
        "matrix that is not modal), which no sum over modes gives"
    )


def remembered_of(one: Remembered, times: FloatArray, moved: FloatArray) -> FloatArray:
    """K_j y(0) with y' = -b y + a u, for straight lines between displacements at times up to 0.

    Before the first time u is constant. A piece of length l from u_0 to u_1, x = b l, adds
    a l exp(b t_1) [u_0 g(x) + (u_1 - u_0) (1 - g(x))/x], g(x) = (1 - exp(-x))/x.
    """
    a, b = one.weight, one.rate
    seen = moved if one.seen is None else one.seen.T @ moved
    seen = Sliced(one.layer, 2 * _BITS).times(seen).astype(float)
    if b == 0 and seen[:, 0].any():
        raise InputError("held: a layer relaxes without end, what was held must be 0 at first")
    y = np.zeros(seen.shape[0])
    if b > 0:
        y = a / b * np.exp(b * times[0]) * seen[:, 0]
    for i in range(times.size - 1):
        length = times[i + 1] - times[i]
        x = b * length
        first = -np.expm1(-x) / x if x > 0 else 1.0
        # (1 - g)/x, by its series where cancellation would occur.
        second = (1 - first) / x if x > 0.1 else _series(x)
        line = seen[:, i] * first + (seen[:, i + 1] - seen[:, i]) * second
        y = y + a * length * np.exp(b * times[i + 1]) * line
    return np.asarray(y)


def _series(x: float) -> float:
    """1/2 - x/6 + x^2/24 - ..."""
    total, term = 0.0, 0.5
    for k in range(3, 16):
        total += term
        term *= -x / k
    return total
