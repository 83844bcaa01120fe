"""Damped modes of a body on rubber: roots s of det D(s) = 0 and their shapes."""

from __future__ import annotations

from typing import Any

import numpy as np

from viscovib._native import ComplexArray, FloatArray

#: Roots with a smaller relative difference are one root. It has as many shapes as D has singular
#: values below the second number, relative to the largest.
_SAME, _NULL = 1e-8, 1e-7


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


def with_shapes(body: Any, roots: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
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
