"""Damped modes of a body on rubber: roots s of det D(s) = 0 and their shapes."""

from __future__ import annotations

from typing import Any

import numpy as np

from viscovib._native import ComplexArray, FloatArray

#: Largest numbers of iterations for the stiffness at the frequency of a mode, and for its root.
_STIFFNESS_STEPS, _ROOT_STEPS = 60, 30
#: Roots with a smaller relative difference are one root. It has as many shapes as D has singular
#: values below the second number, relative to the largest.
_SAME, _NULL = 1e-8, 1e-7
#: A mode is supported if its eigenvalue is above this part of the largest.
_HELD = 1e-12


def damped_roots(body: Any) -> tuple[ComplexArray, ComplexArray]:
    """Return roots s (n,) by increasing frequency and shapes (n_dof, n) of oscillatory modes.

    Each root starts at the undamped mode with the stiffness at its own frequency. Successive linear
    problems D(s) phi = mu D'(s) phi give the next iterate s - mu (Ruhe, SIAM J. Numer. Anal. 10,
    1973, 674). If modes are missing, the roots of `characteristic_roots` are added.
    """
    mass = body._mass_matrix
    starts = [_undamped_start(body, r) for r in range(mass.shape[0])]
    held = [start for start in starts if start[0] > 0]
    roots = np.array([_root(body, 1j * omega, shape) for omega, shape in held], dtype=complex)
    found = _with_shapes(body, roots)
    if found[0].size < len(held):
        found = _with_shapes(body, np.append(roots, body.characteristic_roots().oscillatory))
    return found


def characteristic_matrix(body: Any, s: complex) -> ComplexArray:
    """D(s) = s^2 M + s C + sum_g (K_g + s C_g) (1 - R_g(s))."""
    total: Any = s**2 * body._mass_matrix + s * body._damping
    for group in body.groups:
        linear = group.stiffness
        if group.law_dampers is not None:
            linear = linear + s * group.law_dampers
        kept = 1.0 if group.kernel is None else 1.0 - complex(group.kernel.laplace(s))
        total = total + kept * linear
    return np.asarray(total, dtype=complex)


def stiffness_at(body: Any, nu: float) -> FloatArray:
    """The real part of the dynamic stiffness without inertia at a circular frequency."""
    return np.asarray(body.dynamic_stiffness(nu).real + nu**2 * body._mass_matrix)


def _undamped_start(body: Any, rank: int) -> tuple[float, FloatArray]:
    """Frequency and shape of a mode with the stiffness at its own frequency; 0: no support."""
    from scipy.linalg import eigh

    mass = body._mass_matrix
    squares, shapes = eigh(body._stiffness_at_rest, mass)
    omega = 0.0
    for _ in range(_STIFFNESS_STEPS):
        if not squares[rank] > _HELD * np.abs(squares).max():
            break
        if abs(squares[rank] - omega**2) < 1e-4 * omega**2:
            break
        omega = float(np.sqrt(squares[rank]))
        squares, shapes = eigh(stiffness_at(body, omega), mass)
    return omega, shapes[:, rank]


def _root(body: Any, s: complex, shape: Any) -> complex:
    """The root near s with the most similar shape; NaN: not found."""
    from scipy.linalg import eig

    mass = body._mass_matrix
    for _ in range(_ROOT_STEPS):
        h = 1e-6 * abs(s)
        slope = (characteristic_matrix(body, s + h) - characteristic_matrix(body, s - h)) / (2 * h)
        moves, vectors = eig(characteristic_matrix(body, s), slope)
        like = np.abs(shape.conj() @ mass @ vectors) ** 2
        like /= np.einsum("ar,ab,br->r", vectors.conj(), mass, vectors).real
        best = int(np.argmax(np.where(np.isfinite(moves), like, -1.0)))
        s, shape = s - complex(moves[best]), vectors[:, best]
        if not np.isfinite(s) or s.imag <= 1e-9 * abs(s):
            break
        if abs(moves[best]) <= 1e-13 * abs(s):
            return s
    return complex(np.nan, np.nan)


def _with_shapes(body: Any, roots: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Distinct and multiple roots with null vectors of D, phi^H M phi = 1."""
    found: list[complex] = []
    shapes: list[ComplexArray] = []
    mass = body._mass_matrix
    lower = np.linalg.cholesky(mass)
    inverse = np.linalg.inv(lower)
    roots = roots[np.isfinite(roots)]
    for s in roots[np.lexsort((roots.real, roots.imag))]:
        if found and abs(s - found[-1]) < _SAME * abs(s):
            continue
        count = int((np.abs(roots - s) < _SAME * abs(s)).sum())
        _, sizes, vectors = np.linalg.svd(inverse @ characteristic_matrix(body, s) @ inverse.T)
        for k in range(1, count + 1):
            if k > 1 and sizes[-k] > _NULL * sizes[0]:
                break
            shape = inverse.T @ vectors[-k].conj()
            largest = shape[np.abs(shape).argmax()]
            found.append(complex(s))
            shapes.append(shape * abs(largest) / largest)
    n = mass.shape[0]
    return np.array(found, dtype=complex), np.array(shapes, dtype=complex).reshape(-1, n).T
