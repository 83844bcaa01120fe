"""The linear subsystem of a structure: its modes, and the flexibility of omitted modes."""

import math
from collections.abc import Callable, Sequence
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
    refined_modes,
    refined_poles,
)
from viscovib.systems.stiffness_ratio import (
    warn_of_lost_modes,
    warn_of_lost_poles,
    without_rounding,
)

#: Relative rounding errors: off-diagonal entries of modal damping, squared frequencies.
_OFF_DIAGONAL, _RIGID = 1e-12, 1e-12
_EPS = float(np.finfo(float).eps)
#: Bits of a product with cancellation.
_BITS = 106
#: Mixing of two modes by rounding errors.
_MIXED = 16 * _EPS
#: Relative squared frequency of modes that represent coordinates without mass.
_AT_ONCE = 1e10


class Remembered(NamedTuple):
    """Contribution of one exponential of a layer K_j to the initial state of complex modes.

    z_l += pushed_l . (K_j y), y' = -rate y + weight seen^T u. K_j y is computed in extended
    precision, because a stiff layer amplifies rounding errors of small deformations.
    """

    weight: float
    rate: float
    #: Shape (n, k); None: the coordinates themselves. Then shapes (k, k) and (p, k).
    seen: FloatArray | None
    layer: FloatArray
    pushed: ComplexArray


class Rest(NamedTuple):
    """D(s)^-1 of M u'' + C u' + K u as a sum over modes, plus the flexibility of omitted modes.

    sum_m phi_m phi_m^T/(squares_m (1 + i loss_m) + rates_m s + s^2)
    + sum_l left_l right_l^T/(s - poles_l) + flexibility.
    """

    #: Real modes: omega^2 (1/s^2), exactly 0 of rigid bodies, 2 zeta omega (1/s), loss factors,
    #: shape (m,), and shapes phi, mass-normalised, shape (n, m).
    squares: FloatArray
    rates: FloatArray
    losses: FloatArray
    shapes: FloatArray
    #: Complex modes, shape (p,), and shapes (n, p), including conjugates.
    poles: ComplexArray
    left: ComplexArray
    right: ComplexArray
    #: Response of the omitted modes to forces (n, c): deflections, and the part times s; None: no
    #: modes are omitted.
    flexibility: Callable[[FloatArray], tuple[FloatArray, FloatArray]] | None = None
    #: Initial states of layers in the complex modes.
    remembered: tuple[Remembered, ...] = ()
    #: C u with all damping of the complex modes; None: no complex modes.
    resisting: Callable[[FloatArray], FloatArray] | None = None
    #: K and the parts added to it, for all modes; None: with coordinates without mass.
    springs: FloatArray | None = None
    relaxing: tuple[RelaxingPart, ...] = ()

    @property
    def n_modes(self) -> int:
        """Number of modes; complex modes are counted in pairs."""
        return self.squares.size + self.poles.size // 2


class ModalDamping(NamedTuple):
    """Damping that does not couple the modes, in addition to the damping matrix."""

    #: Damping ratios zeta and loss factors, one for all modes or one for each mode.
    ratio: float | FloatArray = 0.0
    loss: float | FloatArray = 0.0
    #: Rayleigh's factors of mass (1/s) and stiffness (s).
    by_mass: float = 0.0
    by_stiffness: float = 0.0

    def rates(self, squares: FloatArray) -> FloatArray:
        """2 zeta omega of each mode (1/s)."""
        omega = np.sqrt(np.maximum(squares, 0))
        return np.asarray(2 * self.ratio * omega + self.by_mass + self.by_stiffness * squares)


def dense_rest(
    mass: FloatArray,
    damping: FloatArray,
    stiffness: FloatArray,
    modal: ModalDamping | None = None,
    *,
    quiet: bool = False,
    parts: Sequence[FloatArray] = (),
) -> Rest:
    """Return all modes of dense matrices; ``quiet``: another function warns of rounding errors.

    ``parts``: matrices whose exact sum is the stiffness.
    """
    from scipy.linalg import LinAlgError, eigh

    n = mass.shape[0]
    parts = parts or (stiffness,)
    if not mass.any(axis=1).all():
        return _condensed_rest(mass, damping, stiffness, modal)
    none = np.zeros((n, 0), dtype=complex)
    if _symmetric(stiffness) and _symmetric(damping):
        try:
            squares, shapes = eigh(stiffness, mass)
        except LinAlgError:
            raise InputError(
                "mass: must be positive definite, it is singular to rounding: eliminate "
                "coordinates that depend on other coordinates"
            ) from None
        squares, shapes = refined_modes(squares, shapes, mass, *parts)
        squares = without_rounding(squares, shapes, stiffness)
        if not quiet:
            warn_of_lost_modes(squares, shapes, mass, stiffness)
        seen = shapes.T @ damping @ shapes
        rates = np.diag(seen).copy()
        lost = _rounding_of(seen, shapes, damping)
        coupled = (np.abs(seen - np.diag(rates)) > lost).any()
        rates[np.abs(rates) <= np.diag(lost)] = 0.0
        losses = np.zeros(n)
        if modal is not None:
            rates = rates + modal.rates(squares)
            losses = losses + modal.loss
        if not coupled:
            first, *more = ((part + part.T) / 2 for part in parts)
            return Rest(
                squares, rates, losses, shapes, np.zeros(0, complex), none, none, springs=first,
                relaxing=tuple(map(elastic_part, more)),
            )  # fmt: skip
    if modal is not None:
        damping = damping + matrix_of_modal(modal, mass, stiffness)
    return _complex_rest(mass, damping, stiffness, quiet, parts)


def matrix_of_modal(modal: ModalDamping, mass: FloatArray, stiffness: FloatArray) -> FloatArray:
    """Modal and Rayleigh damping with dampers that couple the modes, C = M Phi diag(rates) Phi^T M.

    Phi are the modes without damping, Phi^T M Phi = 1, of the coordinates that have mass.
    """
    from scipy.linalg import eigh

    if np.any(modal.loss):
        raise InputError(
            "loss_factor: needs a symmetric stiffness and dampers that do not couple the "
            "modes, must be 0 with other dampers (in damping, in elements, or in laws of rates)"
        )
    extra = modal.by_mass * mass + modal.by_stiffness * stiffness
    if not np.any(modal.ratio):
        return np.asarray(extra)
    if not _symmetric(stiffness):
        raise InputError("modal_damping: needs a symmetric stiffness, whose modes it damps")
    kept = mass.any(axis=1)
    inner, m = stiffness, mass
    if not kept.all():
        inner, m = stiffness[np.ix_(kept, kept)], mass[np.ix_(kept, kept)]
        sides = stiffness[np.ix_(~kept, kept)]
        inner = inner - sides.T @ np.linalg.solve(stiffness[np.ix_(~kept, ~kept)], sides)
    squares, shapes = eigh(inner, m)
    squares, shapes = refined_modes(squares, shapes, m, inner)
    pushed = m @ shapes
    rates = 2 * modal.ratio * np.sqrt(np.maximum(without_rounding(squares, shapes, inner), 0))
    extra[np.ix_(kept, kept)] += (pushed * rates) @ pushed.T
    return np.asarray(extra)


def _condensed_rest(
    mass: FloatArray, damping: FloatArray, stiffness: FloatArray, modal: ModalDamping | None
) -> Rest:
    """Modes with coordinates (0) without mass, which follow the coordinates (1) without delay.

    u_0 = K_00^-1 (p_0 - K_01 u_1) gives K_11 - K_10 K_00^-1 K_01 (Guyan 1965, exact here).
    """
    idle = ~mass.any(axis=1)
    kept = ~idle
    inner = stiffness[np.ix_(idle, idle)]
    inverse = idle_bend(damping, stiffness, idle)
    follow = -inverse @ stiffness[np.ix_(idle, kept)]
    carry = -inverse.T @ stiffness[np.ix_(kept, idle)].T
    left = stiffness[np.ix_(kept, kept)] + stiffness[np.ix_(kept, idle)] @ follow
    if _symmetric(stiffness):
        left = (left + left.T) / 2
    rest = dense_rest(mass[np.ix_(kept, kept)], damping[np.ix_(kept, kept)], left, modal)

    def whole(part: Any, relation: FloatArray) -> Any:
        found = np.empty((mass.shape[0], part.shape[1]), dtype=part.dtype)
        found[kept], found[idle] = part, relation @ part
        return found

    shapes = whole(rest.shapes, follow)
    squares, rates, losses = rest.squares, rest.rates, rest.losses
    given: Any = partial(_moved_idle, idle, inverse)
    if modal is not None and (modal.by_stiffness or np.any(modal.loss)):
        # Coordinates without mass have a part of the damping: represent them by modes of very high
        # frequency, with the response 1/(1 + i loss + s by_stiffness).
        high = _AT_ONCE * max(float(np.abs(squares).max()), 1.0)
        extra = np.zeros((mass.shape[0], inner.shape[0]))
        extra[idle] = np.linalg.inv(np.linalg.cholesky(inner)).T * np.sqrt(high)
        more = np.ones(inner.shape[0])
        shapes = np.concatenate([shapes, extra], axis=1)
        squares = np.append(squares, high * more)
        rates = np.append(rates, modal.by_stiffness * high * more)
        losses = np.append(losses, np.max(modal.loss) * more)
        given = None

    return Rest(
        squares, rates, losses, shapes, rest.poles, whole(rest.left, follow),
        whole(rest.right, carry), given, resisting=partial(_resisting_kept, kept, rest.resisting),
    )  # fmt: skip


def idle_bend(damping: FloatArray, stiffness: FloatArray, idle: Any) -> FloatArray:
    """Return K_00^-1 of the coordinates without mass, which must have stiffness and no damping."""
    if damping[idle].any() or damping[:, idle].any():
        i = int(np.flatnonzero(idle & (damping.any(axis=0) | damping.any(axis=1)))[0])
        raise InputError(f"damping: coordinate {i} has no mass, and must not have damping either")
    inner = stiffness[np.ix_(idle, idle)]
    if idle.any() and _scaled_condition(inner) > 1 / _OFF_DIAGONAL:
        raise InputError("mass: a coordinate has neither mass nor stiffness")
    return np.asarray(np.linalg.inv(inner))


def _moved_idle(idle: Any, inverse: Any, forces: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Deflections of the coordinates without mass by forces, and their part times s."""
    moved = np.zeros_like(forces)
    moved[idle] = inverse @ forces[idle]
    return moved, np.zeros_like(forces)


def _resisting_kept(kept: Any, resisting: Any, u: FloatArray) -> FloatArray:
    """C u; only coordinates with mass have damping."""
    forces = np.zeros_like(u)
    if resisting is not None:
        forces[kept] = resisting(u[kept])
    return forces


def _scaled_condition(matrix: FloatArray) -> float:
    """Condition number in units that make the diagonal 1."""
    size = np.abs(np.diag(matrix))
    unit = np.sqrt(np.where(size > 0, size, 1.0))
    return float(np.linalg.cond(matrix / unit / unit[:, np.newaxis]))


def _symmetric(matrix: FloatArray) -> bool:
    """True if symmetric up to rounding errors of each off-diagonal entry and of the largest."""
    root = np.sqrt(np.abs(np.diag(matrix)))
    size = np.maximum(np.abs(matrix), np.multiply.outer(root, root))
    lost = 1e-12 * np.maximum(size, size.T) + 4 * _EPS * np.abs(matrix).max(initial=0.0)
    return bool((np.abs(matrix - matrix.T) <= lost).all())


def _rounding_of(seen: FloatArray, shapes: FloatArray, damping: FloatArray) -> FloatArray:
    """Rounding error of phi_i^T C phi_j, shape (m, m).

    The error of the products is relative to their terms, so that a strong damper does not hide weak
    ones. The error of the shapes mixes two modes: equal damping of both does not couple them.
    """
    size, rates = np.abs(shapes), np.abs(np.diag(seen))
    lost = _OFF_DIAGONAL * (size.T @ np.abs(damping) @ size)
    return np.asarray(lost + _MIXED * (rates[:, np.newaxis] + rates))


def _complex_rest(
    mass: FloatArray,
    damping: FloatArray,
    stiffness: FloatArray,
    quiet: bool,
    parts: Sequence[FloatArray],
) -> Rest:
    """Right and left modes of (s^2 M + s C + K) u = 0 by its companion matrix."""
    from scipy.linalg import eig

    n = mass.shape[0]
    zero, one = np.zeros((n, n)), np.eye(n)
    inverse = np.linalg.inv(mass)
    matrix = np.block([[zero, one], [-inverse @ stiffness, -inverse @ damping]])
    poles, lefts, rights = eig(matrix, left=True, right=True)
    # (s - A)^-1 = sum right left^H/(left^H right)/(s - pole); displacements answer to
    # accelerations M^-1 f.
    scale = np.einsum("im,im->m", lefts.conj(), rights)
    condition = np.abs(scale).min() / max(np.abs(scale).max(), np.finfo(float).tiny)
    if condition < 1e-8:
        raise InputError(
            "damping: the structure has defective modes (as critically damped ones or undamped "
            "rigid bodies under a damping matrix that is not modal), which no sum over modes gives"
        )
    left = rights[:n]
    right = inverse.T @ (lefts[n:].conj() / scale)
    first, *more = parts
    elastic = tuple(map(elastic_part, more))
    poles, left, right = refined_poles(poles, left, right, mass, damping, first, elastic)
    # A motion without springs and dampers that dampers couple to the other modes.
    poles[np.abs(poles) <= _RIGID * _fastest(poles, inverse @ stiffness)] = 0.0
    if not quiet:
        warn_of_lost_poles(poles, left, right, stiffness)
    none = np.zeros(0)
    return Rest(
        none, none, none, np.zeros((n, 0)), poles, left, right, resisting=exactly_by(damping),
        springs=first, relaxing=elastic,
    )  # fmt: skip


def exactly_by(damping: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """C u in extended precision: strong dampers amplify rounding errors of small motions."""
    return partial(_exact_product, damping)


def _exact_product(damping: FloatArray, u: FloatArray) -> FloatArray:
    return np.asarray(Sliced(damping, _BITS).times(u[:, np.newaxis])[:, 0], dtype=float)


def _fastest(poles: ComplexArray, springs: FloatArray) -> float:
    """Reference rate for poles that are rounding errors, from the springs M^-1 K."""
    fastest = float(np.abs(poles).max())
    return max(math.sqrt(np.abs(springs).max()), _RIGID * fastest)


def in_modes(
    rest: Rest, mass: Any, place: FloatArray, speed: FloatArray
) -> tuple[FloatArray, FloatArray, ComplexArray]:
    """Coordinates and rates of real modes, and states of complex modes, for displacements u.

    Two formulas give the same value,

        phi^T M u = phi^T K u/omega^2,    right^T (pole M + C) u = -right^T K u/pole,

    (with the relaxed K at that pole). Each mode uses the formula with the smaller rounding error of
    its shape. With the exact K u a small deformation of a stiff spring hardly excites its mode,
    while phi^T M u may have an error of 1e-16, which oscillates with the velocity 1e-16 omega.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        moved, driven = mass @ place, mass @ speed
        real, poles = rest.shapes.T @ moved, rest.poles
        damped = 0 * place if rest.resisting is None else rest.resisting(place)
        others = poles * (rest.right.T @ moved) + rest.right.T @ damped
        squares = np.concatenate([np.abs(rest.squares), np.abs(poles) ** 2])
        bits = bits_for(squares) if place.any() else 0.0
        if bits and rest.springs is not None:
            pulled, others_pulled = _pulled(rest, place, bits)
            size = np.abs(mass) @ np.abs(place)
            shapes, right = np.abs(rest.shapes).T, np.abs(rest.right).T
            soft = shapes @ np.abs(pulled) < rest.squares * (shapes @ size)
            real[soft] = (rest.shapes.T @ pulled)[soft] / rest.squares[soft]
            lost = np.abs(poles) * (right @ size) + right @ np.abs(damped)
            bent = np.einsum("pn,np->p", right, np.abs(others_pulled))
            soft = bent < np.abs(poles) * lost
            bent = np.einsum("np,np->p", rest.right, others_pulled)
            others[soft] = -bent[soft] / poles[soft]
        found = real, rest.shapes.T @ driven, others + rest.right.T @ driven
    if not all(np.isfinite(part).all() for part in found):
        raise InputError(
            f"initial = {np.abs([place, speed]).max():g}: no finite number in modes, must be "
            "smaller"
        )
    return found


def _pulled(rest: Rest, place: FloatArray, bits: float) -> tuple[FloatArray, ComplexArray]:
    """K u without relaxation, shape (n,), and with the relaxed K at each pole, (n, p)."""
    assert rest.springs is not None
    first = Sliced(rest.springs, bits).times(place[:, np.newaxis])
    at_poles = np.repeat(first, rest.poles.size, axis=1).astype(np.clongdouble)
    for layer in rest.relaxing:
        moved = Sliced(layer.matrix, bits).times(place[:, np.newaxis])
        first = first + layer.share * moved
        at_poles += moved * layer.factor(rest.poles.astype(np.clongdouble))
    return first[:, 0].astype(float), at_poles.astype(complex)
