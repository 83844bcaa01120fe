"""Modes of matrices in which stiffnesses differ much, to the digits that their entries hold.

An eigensolver leaves errors of 1e-16 of the largest square of a frequency in all of them: next to
a spring of 1e8 times the others soft modes keep eight digits. Where all are alike the last one or
two are lost, which in a long motion become its phase. What the modes found leave of their
equations, computed beyond double precision, tells what they are off by:

    w_j = K r_j - omega_j^2 M r_j,    E_ij = r_i^T w_j/(omega_j^2 - omega_i^2),                  (1)

r_j + sum_i r_i E_ij being off by the square of that (Ogita and Aishima, Japan J. Indust. Appl.
Math. 35 (2018) 1007). Products with residuals need no more than double precision. Modes that are
too near to each other for (1) are taken apart in what they span (Rayleigh and Ritz).
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from viscovib._native import ComplexArray, FloatArray
from viscovib.systems.exact_products import Sliced

#: Changes of which the square is rounding, and changes too large for a step.
_SMALL, _LARGE = 1e-8, 0.1
#: Part of values that products of modes with residuals leave by rounding.
_ROUNDING = 4 * float(np.finfo(float).eps)
#: How far from unit vectors those may be that take modes apart.
_SKEW = 1e4
_PASSES = 6
#: Part of a rate of a layer that a pole is too near to it.
_BESIDE = 1e-10
#: Bits of numbers and of products with a mass, and how many more a stiffness may need.
_BITS, _MASS_BITS, _MOST_MORE = 53, 64, 60


class RelaxingPart(NamedTuple):
    """K_j (c - sum_i a_i/(s + b_i)), of a layer that relaxes; c = 0: K holds it."""

    matrix: FloatArray
    #: a and b (1/s), shape (k,).
    weights: FloatArray
    rates: FloatArray
    share: float

    def factor(self, s: Any) -> Any:
        """What the matrix has at each s."""
        found = np.full(s.shape, self.share, dtype=s.dtype)
        with np.errstate(divide="ignore", invalid="ignore"):
            for a, b in zip(self.weights, self.rates, strict=True):
                found -= a / (s + b)
        return found


def elastic_part(matrix: FloatArray) -> RelaxingPart:
    """What is added to K and does not relax."""
    return RelaxingPart(matrix, np.zeros(0), np.zeros(0), 1.0)


def refined_modes(
    squares: FloatArray, shapes: FloatArray, mass: FloatArray, *stiffness: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Squares (m,) and shapes (n, m) of K r = omega^2 M r, symmetric, r^T M r = 1.

    K is the sum of what is given, which floating point would round.
    """
    from scipy.linalg import eigh

    bits = bits_for(np.abs(squares))
    if not bits:
        return squares, shapes
    springs = [Sliced((part + part.T) / 2, bits) for part in stiffness]
    masses = Sliced(mass, _MASS_BITS)
    for _ in range(_PASSES):
        moved = masses.times(shapes)
        pulled = sum(part.times(shapes) for part in springs)
        off = shapes.T @ np.asarray(pulled - moved * squares, dtype=float)
        moving = shapes.T @ np.asarray(moved, dtype=float)
        change, plain, groups = _changes(off, squares, np.arange(squares.size))
        largest = float(np.abs(change).max())
        better = squares + (np.diag(off) + (change * off).sum(axis=0)) / np.diag(moving)
        # What two are not normal by is taken away half by each, E_ij + E_ji = -r_i^T M r_j: (1)
        # holds it in exact numbers only, and divides modes that nearly coincide by next to nothing.
        change[plain | plain.T] = 0.0
        change = (change - change.T + np.eye(squares.size) - moving) / 2
        turns = []
        for group in groups:
            own, middle = np.ix_(group, group), squares[group].mean()
            block = off[own] + moving[own] * (squares[group] - middle)
            found, turn = eigh((block + block.T) / 2, moving[own])
            better[group], change[own] = middle + found, 0.0
            turns.append((group, turn))
        squares, shapes = better, shapes + shapes @ change
        for group, turn in turns:
            shapes[:, group] = shapes[:, group] @ turn
        if largest < _SMALL and not groups:
            break
    order = np.argsort(squares, kind="stable")
    return squares[order], shapes[:, order]


def refined_poles(
    poles: ComplexArray,
    left: ComplexArray,
    right: ComplexArray,
    mass: FloatArray,
    damping: FloatArray,
    stiffness: FloatArray,
    layers: Sequence[RelaxingPart] = (),
    more: Callable[[ComplexArray, ComplexArray], ComplexArray] | None = None,
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Poles (p,), left and right (n, p) of T(s)^-1 = sum left right^T/(s - pole) + F(s).

    T(s) = s^2 M + s C + K + sum_j K_j (c_j - sum_i a_ij/(s + b_ij)) with layers that relax.
    ``more``: F(pole_j) of columns j, of no poles among these; None: 0. T is symmetric with it. As
    (1), with right_j^T T'(pole_j) left_j = 1:

        N_ij = -right_i^T T(pole_j) left_j,    E_ij = N_ij/(pole_j - pole_i),                   (2)

    left_j + sum_i left_i E_ij - F(pole_j) T(pole_j) left_j, and the other side likewise. Of
    conjugate poles, which follow each other, one is refined; none where a layer has a pole too.
    """
    bits = bits_for(np.abs(poles) ** 2)
    if not bits:
        return poles, left, right
    # Poles that are all real may come in real numbers: those of a saddle.
    poles, left, right = (one.astype(complex) for one in (poles, left, right))
    pencil = _Pencil(mass, damping, stiffness, layers, bits)
    turned = pencil
    given = mass, damping, stiffness, *(layer.matrix for layer in layers)
    if any((part != part.T).any() for part in given):
        sides = [layer._replace(matrix=layer.matrix.T) for layer in layers]
        turned = _Pencil(mass.T, damping.T, stiffness.T, sides, bits)
    rates = np.concatenate([np.zeros(0), *(layer.rates for layer in layers)])
    beside = np.abs(poles[:, np.newaxis] + rates) <= _BESIDE * rates
    kept = np.flatnonzero((poles.imag >= 0) & ~beside.any(axis=1))
    if not kept.size:
        return poles, left, right
    real = poles[kept].imag == 0
    paired = kept[~real]
    own = kept, np.arange(kept.size)
    for _ in range(_PASSES):
        p, x, y = poles[kept], left[:, kept], right[:, kept]
        residual, slope, moved = pencil.of(p, x)
        other_residual, _, _ = turned.of(p, y)
        off, other = -(right.T @ residual), -(left.T @ other_residual)
        change, _, groups = _changes(off, poles, kept)
        back, _, _ = _changes(other, poles, kept)
        largest = max(float(np.abs(change).max()), float(np.abs(back).max()))
        size = (y * slope).sum(axis=0)
        p = p + (off[own] + (change * other).sum(axis=0)) / size
        change[own] = back[own] = (1 - size) / 2
        turns = []
        for group in groups:
            rows, middle = np.ix_(kept[group], group), poles[kept[group]].mean()
            apart = poles[kept[group]] - poles[kept[group], np.newaxis]
            moving = y[:, group].T @ slope[:, group] - apart * (y[:, group].T @ moved[:, group])
            block = off[rows] + moving * (poles[kept[group]] - middle)
            found, turn = np.linalg.eig(np.linalg.solve(moving, block))
            # Modes that nearly share a shape, and real ones that would become a pair, stay.
            if np.linalg.cond(turn) > _SKEW or (real[group].any() and found.imag.any()):
                continue
            p[group], change[rows], back[rows] = middle + found, 0.0, 0.0
            turns.append((group, turn, np.linalg.inv(moving @ turn).T))
        x, y = x + left @ change, y + right @ back
        if more is not None:
            x, y = x - more(poles[kept], residual), y - more(poles[kept], other_residual)
        for group, turn, returned in turns:
            x[:, group], y[:, group] = x[:, group] @ turn, y[:, group] @ returned
        for part in (x, y, p):
            part.imag[..., real] = 0.0
        poles, left, right = poles.copy(), left.copy(), right.copy()
        for whole, part in ((left, x), (right, y), (poles, p)):
            whole[..., kept] = part
            whole[..., paired + 1] = whole[..., paired].conj()
        if largest < _SMALL and not turns:
            break
    return poles, left, right


class _Pencil:
    """T(s), ready to be multiplied."""

    def __init__(
        self,
        mass: FloatArray,
        damping: FloatArray,
        stiffness: FloatArray,
        layers: Sequence[RelaxingPart],
        bits: float,
    ) -> None:
        self.layers = layers
        self.parts = [Sliced(mass, _MASS_BITS), Sliced(damping, bits), Sliced(stiffness, bits)]
        self.parts += [Sliced(layer.matrix, bits) for layer in layers]

    def of(self, p: ComplexArray, x: ComplexArray) -> tuple[ComplexArray, ...]:
        """T(p_j) x_j, T'(p_j) x_j and T''(p_j) x_j/2, shape (n, m)."""
        both = np.concatenate([x.real, x.imag], axis=1)
        products = [part.times(both) for part in self.parts]
        m, c, k, *others = (a[:, : p.size] + 1j * a[:, p.size :] for a in products)
        s = p.astype(np.clongdouble)
        found = [(m * s + c) * s + k, m * (2 * s) + c, m]
        for layer, pulled in zip(self.layers, others, strict=True):
            found[0] = found[0] + pulled * layer.factor(s)
            for a, b in zip(layer.weights, layer.rates, strict=True):
                part = 1 / (s + b)
                found[1] = found[1] + pulled * (a * part**2)
                found[2] = found[2] - pulled * (a * part**3)
        return tuple(np.asarray(one, dtype=complex) for one in found)


def bits_for(squares: FloatArray) -> float:
    """Bits that products with the stiffness need for the least squares; 0: all are 0."""
    sizes = squares[squares > 0]
    if not sizes.size:
        return 0
    return _BITS + min(_MOST_MORE, math.log2(sizes.max() / sizes.min()))


def _changes(off: Any, values: Any, kept: Any) -> tuple[Any, Any, list[Any]]:
    """E of what is left, off (n, m), of modes kept (m,) among those of values (n,).

    And of which pairs it tells nothing, and which modes kept are to be taken apart together.
    """
    apart = values[kept] - values[:, np.newaxis]
    with np.errstate(divide="ignore", invalid="ignore"):
        change = off / apart
    plain = ~(np.abs(change) < _LARGE)
    plain[kept, np.arange(kept.size)] = True
    change[plain] = 0.0
    sizes = np.maximum(np.abs(values), _ROUNDING * np.abs(values).max(initial=0.0))
    lost = _ROUNDING * np.maximum(sizes[:, np.newaxis], sizes[kept])
    near = (plain & (np.abs(off) > lost))[kept]
    np.fill_diagonal(near, False)
    if not near.any():
        return change, plain, []
    from scipy.sparse.csgraph import connected_components

    count, names = connected_components(near, directed=False)
    groups = [np.flatnonzero(names == name) for name in range(count)]
    return change, plain, [group for group in groups if group.size > 1]
