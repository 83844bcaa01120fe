"""Modes of matrices with very different stiffnesses, to the accuracy of their entries.

An eigensolver has errors of 1e-16 of the largest squared frequency in all modes: with one spring
1e8 times as stiff as the others soft modes keep eight digits. Modes of similar frequency lose one
or two digits, which cause phase errors in long motions. The residuals of the computed modes, in
extended precision, give their errors:

    w_j = K r_j - omega_j^2 M r_j,    E_ij = r_i^T w_j/(omega_j^2 - omega_i^2),                  (1)

The error of r_j + sum_i r_i E_ij is the square of this (Ogita and Aishima, Japan J. Indust. Appl.
Math. 35 (2018) 1007). Products with residuals need double precision only. Modes that are too close
to each other for (1) are separated in their common subspace (Rayleigh and Ritz).
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from viscovib._native import ComplexArray, FloatArray
from viscovib.systems.exact_products import Sliced

#: Changes whose square is below the rounding error, and changes too large for a step.
_SMALL, _LARGE = 1e-8, 0.1
#: Relative rounding error of products of modes with residuals.
_ROUNDING = 4 * float(np.finfo(float).eps)
#: Largest condition number of the vectors that separate modes.
_SKEW = 1e4
_PASSES = 6
#: A pole is too close to a rate of a layer within this fraction of the rate.
_NEARBY = 1e-10
#: Bits of numbers and of products with a mass, and largest number of additional bits.
_BITS, _MASS_BITS, _MOST_MORE = 53, 64, 60


class RelaxingPart(NamedTuple):
    """K_j (c - sum_i a_i/(s + b_i)) of a layer with memory; c = 0: K contains its stiffness."""

    matrix: FloatArray
    #: a and b (1/s), shape (k,).
    weights: FloatArray
    rates: FloatArray
    share: float

    def factor(self, s: Any) -> Any:
        """Factor of the matrix at each s."""
        found = np.full(s.shape, self.share, dtype=s.dtype)
        with np.errstate(divide="ignore", invalid="ignore"):
            for a, b in zip(self.weights, self.rates, strict=True):
                found -= a / (s + b)
        return found


def elastic_part(matrix: FloatArray) -> RelaxingPart:
    """A part of the stiffness without memory."""
    return RelaxingPart(matrix, np.zeros(0), np.zeros(0), 1.0)


def refined_modes(
    squares: FloatArray, shapes: FloatArray, mass: FloatArray, *stiffness: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Squares (m,) and shapes (n, m) of K r = omega^2 M r, symmetric, r^T M r = 1.

    K is the sum of ``stiffness``, which is not rounded.
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
        # Half of the non-orthogonality of a pair is removed from each, E_ij + E_ji = -r_i^T M r_j.
        # (1) implies this only without rounding, and divides by a tiny number for close modes.
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

    T(s) = s^2 M + s C + K + sum_j K_j (c_j - sum_i a_ij/(s + b_ij)) with relaxing layers.
    ``more``: F(pole_j) of columns j, without these poles; None: 0. T is then symmetric. Similar to
    (1), with right_j^T T'(pole_j) left_j = 1:

        N_ij = -right_i^T T(pole_j) left_j,    E_ij = N_ij/(pole_j - pole_i),                   (2)

    left_j + sum_i left_i E_ij - F(pole_j) T(pole_j) left_j, and the right vectors likewise. One of
    two successive conjugate poles is refined. Poles close to a pole of a layer are not refined.
    """
    bits = bits_for(np.abs(poles) ** 2)
    if not bits:
        return poles, left, right
    # If all poles are real (a saddle), the array may be real.
    poles, left, right = (one.astype(complex) for one in (poles, left, right))
    pencil = _Pencil(mass, damping, stiffness, layers, bits)
    turned = pencil
    given = mass, damping, stiffness, *(layer.matrix for layer in layers)
    if any((part != part.T).any() for part in given):
        sides = [layer._replace(matrix=layer.matrix.T) for layer in layers]
        turned = _Pencil(mass.T, damping.T, stiffness.T, sides, bits)
    rates = np.concatenate([np.zeros(0), *(layer.rates for layer in layers)])
    nearby = np.abs(poles[:, np.newaxis] + rates) <= _NEARBY * rates
    kept = np.flatnonzero((poles.imag >= 0) & ~nearby.any(axis=1))
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
            # Skip modes with nearly equal shapes, and real modes that would become a complex pair.
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
    """T(s) with matrices sliced for products."""

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
    """Bits of products with the stiffness for the smallest square; 0: all squares are 0."""
    sizes = squares[squares > 0]
    if not sizes.size:
        return 0
    return _BITS + min(_MOST_MORE, math.log2(sizes.max() / sizes.min()))


def _changes(off: Any, values: Any, kept: Any) -> tuple[Any, Any, list[Any]]:
    """E from residuals off (n, m) of the modes kept (m,), among modes with the values (n,).

    Also the pairs for which E is useless, and groups of modes that must be separated together.
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
