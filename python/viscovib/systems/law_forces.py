"""Harmonics of the forces of elements at given deflections."""

from typing import Any

import numpy as np

from viscovib._native import ComplexArray, FloatArray
from viscovib.systems.element_laws import Laws

#: Samples per period and harmonic for laws that are not polynomials, and the smallest number.
_PER_ORDER, _FEWEST = 16, 256
#: Size of the array of one part of the samples.
_AT_ONCE = 1_000_000


def are_smooth(laws: Laws) -> bool:
    """True if samples of a period give the harmonics of all forces to rounding error."""
    return not any(place.law.state or place.law.branches for place in laws.programs)


def forces_on_rest(
    laws: Laws, nu: FloatArray, orders: Any, y: ComplexArray, order: int
) -> ComplexArray:
    """-G_k of one harmonic k > 0, shape (n, q), at deflections y = Im sum_k Y_k exp(i k nu t).

    G_k = 2 i/N sum_j g(y(t_j)) exp(-i k nu t_j) over N samples of a period, times 1 - R(i k nu)
    with a kernel. Polynomials of degree p are free of aliasing if N > (p + 1) k_max. Linear forces
    contribute only -R kappa Y_k: their elastic part belongs to the linear subsystem.

    ``y``: shape (n, q, m), of smooth laws (`are_smooth`).
    """
    degree = max((sum(powers) for group in laws.forces for _, powers in group), default=1)
    highest = int(orders.max())
    count = (degree + 1) * highest + 1
    if laws.programs:
        count = max(count, _PER_ORDER * highest, _FEWEST)
    phase = 2 * np.pi * np.arange(count) / count
    waves = np.exp(1j * np.outer(orders, phase))
    back = 2j / count * np.exp(-1j * order * phase)
    kernels = [kernel for kernel in laws.kernels if kernel is not None]
    found = np.empty(y.shape[:2], dtype=complex)
    step = max(1, _AT_ONCE // (count * y.shape[1]))
    for first in range(0, nu.size, step):
        part = slice(first, first + step)
        found[part] = _of_some(laws, kernels, nu[part], orders, y[part], order, waves, back)
    return found


def _of_some(
    laws: Laws, kernels: list[Any], nu: FloatArray, orders: Any, y: ComplexArray, order: int,
    waves: ComplexArray, back: ComplexArray,
) -> ComplexArray:  # fmt: skip
    at = (y @ waves).imag
    own = y[:, :, np.flatnonzero(orders == order)[0]]
    total = np.zeros_like(own)
    for kernel, stiffness, forces in zip(laws.kernels, laws.stiffness, laws.forces, strict=True):
        retained = 0.0 if kernel is None else kernel.transform(order * nu)[:, np.newaxis]
        if kernel is not None:
            total += retained * (own @ stiffness.T)
        elif stiffness.any():
            total -= own @ stiffness.T
        if not forces:
            continue
        force = np.zeros_like(at)
        for (on, powers), c in forces.items():
            product: Any = c
            for b, power in enumerate(powers):
                if power:
                    product = product * at[:, b] ** power
            force[:, on] += product
        total -= (1 - retained) * (force @ back)
    if laws.programs:
        rate = ((1j * nu[:, np.newaxis, np.newaxis] * orders * y) @ waves).imag
    for place, reads, targets, law in laws.programs:
        positions, rates = reads @ at, reads @ rate
        arguments = np.concatenate([positions, rates], axis=1)[:, : len(law.arguments)]
        flat = np.asfortranarray(arguments.transpose(0, 2, 1).reshape(-1, arguments.shape[1]))
        parts = law(flat)[0].reshape(nu.size, -1) @ back
        if place:
            parts = parts * (1 - kernels[place - 1].transform(order * nu))
        for on, weight in targets.items():
            total[:, on] -= weight * parts
    return total
