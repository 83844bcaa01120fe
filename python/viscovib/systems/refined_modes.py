"""Modes of matrices in which stiffnesses differ much, to the digits that their entries hold.

An eigensolver leaves errors of 1e-16 of the largest square of a frequency in all of them: next to
a spring of 1e8 times the others soft modes keep eight digits. Products of the modes found with
the matrices, in extended precision, tell what they are off by, and a step of first order in that
squares it (Ogita and Aishima, Japan J. Indust. Appl. Math. 35 (2018) 1007).
"""

from typing import Any

import numpy as np

from viscovib._native import ComplexArray, FloatArray

#: Coordinates up to which extended precision takes less time than all else, of real modes and of
#: complex ones.
MOST_REFINED, MOST_COUPLED_REFINED = 100, 30
#: Squares of frequencies closer together than this keep their digits.
_ALIKE = 0.03
#: Changes that are rounding, and changes too large for a step, as of modes that coincide.
_SETTLED, _LARGE = 1e-13, 0.1
_PASSES = 4


def refined_modes(
    squares: FloatArray, shapes: FloatArray, mass: FloatArray, stiffness: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Squares (m,) and shapes (n, m) of K r = omega^2 M r, symmetric, r^T M r = 1."""
    if _enough(np.abs(squares), MOST_REFINED):
        return squares, shapes
    wide_mass, wide = mass.astype(np.longdouble), stiffness.astype(np.longdouble)
    for _ in range(_PASSES):
        r = shapes.astype(np.longdouble)
        moving = r.T @ (wide_mass @ r)
        pulled = r.T @ (wide @ r)
        values = np.diag(pulled) / np.diag(moving)
        change, _ = _changes(values, moving, (pulled + pulled.T) / 2)
        squares = np.asarray(values, dtype=float)
        if np.abs(change).max() < _SETTLED:
            break
        shapes = np.asarray(r + r @ change, dtype=float)
    order = np.argsort(squares, kind="stable")
    return squares[order], shapes[:, order]


def refined_poles(
    poles: ComplexArray,
    left: ComplexArray,
    right: ComplexArray,
    mass: FloatArray,
    damping: FloatArray,
    stiffness: FloatArray,
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Poles (p,), left and right (n, p) of (s^2 M + s C + K)^-1 = sum left right^T/(s - pole).

    With z = (left, pole left) and w = (right, pole right), w^T A z = 1 and w^T B z = -pole:

    A = [C, M; M, 0],  B = [K, 0; 0, -M].
    """
    if _enough(np.abs(poles) ** 2, 2 * MOST_COUPLED_REFINED):
        return poles, left, right
    m, c, k = (x.astype(np.longdouble) for x in (mass, damping, stiffness))
    for _ in range(_PASSES):
        p = poles.astype(np.clongdouble)
        x, y = left.astype(np.clongdouble), right.astype(np.clongdouble)
        of_mass, damped, pulled = (_product(y.T, _product(one, x)) for one in (m, c, k))
        moving = damped + of_mass * p + p[:, np.newaxis] * of_mass
        pulled = p[:, np.newaxis] * of_mass * p - pulled
        values = np.diag(pulled) / np.diag(moving)
        change, other = _changes(values, moving, pulled)
        poles = np.asarray(values, dtype=complex)
        if max(np.abs(change).max(), np.abs(other).max()) < _SETTLED:
            break
        left = np.asarray(x + _product(x, change), dtype=complex)
        right = np.asarray(y + _product(y, other), dtype=complex)
    return poles, left, right


def _product(a: Any, b: Any) -> Any:
    """Of complex matrices by those of their parts, which take a tenth of the time."""
    real, imaginary = np.ascontiguousarray(b.real), np.ascontiguousarray(b.imag)
    if not np.iscomplexobj(a):
        return a @ real + 1j * (a @ imaginary)
    own, other = np.ascontiguousarray(a.real), np.ascontiguousarray(a.imag)
    return own @ real - other @ imaginary + 1j * (own @ imaginary + other @ real)


def _enough(squares: FloatArray, most: int) -> bool:
    """Whether nothing is lost, or too much is to be done."""
    sizes = squares[squares > 0]
    return not sizes.size or squares.size > most or sizes.min() > _ALIKE * sizes.max()


def _changes(values: Any, moving: Any, pulled: Any) -> tuple[Any, Any]:
    """E and F that make (I + F)^T A (I + E) the unit matrix and keep B diagonal, to first order.

    Of modes that coincide only what they are not normal by is taken away, half by each.
    """
    missing = np.eye(values.size) - moving
    apart = values - values[:, np.newaxis]
    with np.errstate(divide="ignore", invalid="ignore"):
        change = (pulled + values * missing) / apart
    plain = ~(np.abs(change) < _LARGE)
    change[plain] = missing[plain] / 2
    return change, (missing - change).T
