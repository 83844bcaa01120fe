"""Bodies with finite rotations: vector for the core, energy and momentum."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from viscovib._native import ComplexArray, FloatArray
from viscovib.bodies.springs import MountSprings
from viscovib.errors import InputError
from viscovib.kernels.relaxation import Kernel
from viscovib.systems.laws import Law

#: Kernel kind in x that marks the vector of a body with finite rotations for the core.
BODY_IN_VECTOR = -4
#: Angle below which functions of it are computed by series.
_SMALL = 1e-2
#: Samples per harmonic, and smallest number of samples.
_FINE, _FINEST = 32, 512


def turning_vector(
    mass: FloatArray,
    damping: FloatArray,
    base_direction: FloatArray | None,
    springs: MountSprings,
    kernels: Sequence[Kernel],
    spin_inside: FloatArray,
    *,
    loads_turn: bool,
    placed: bool = True,
) -> FloatArray:
    """The body as a vector in the order of `viscovib_body_vector`.

    ``placed``: laws without their linear parts, which are in the stiffness; else as given.
    """
    n = mass.shape[0]
    direction = np.zeros(n) if base_direction is None else base_direction
    parts: list[Any] = [
        [n, len(springs.kernels), len(kernels), float(loads_turn)], spin_inside,
        mass.ravel(order="F"), damping.ravel(order="F"), direction,
    ]  # fmt: skip
    for j, (kernel, law) in enumerate(zip(springs.kernels, springs.laws, strict=True)):
        row, arm = springs.rows[j], springs.arms[j]
        turning = not row[:3].any()
        own = np.flatnonzero(row[6:])
        stiffness, powers, programs = springs.stiffness[j], np.zeros(0), []
        if isinstance(law, Law):
            if placed:
                stiffness, law = stiffness + law.slopes_at_rest[0], law.remainder()
            programs = law.numbers(np.eye(1), {0: 1.0}, 0)
        elif law:
            powers = np.zeros(max(law) - 1)
            for power, c in law.items():
                powers[power - 2] = c
        parts += [
            [0 if kernel is None else kernels.index(kernel) + 1, float(turning)],
            row[3:6] if turning else row[:3], arm,
            [stiffness, springs.damping[j], springs.preload[j]],
            [7 + own[0] if own.size else 0, powers.size], powers, [float(bool(programs))], programs,
        ]  # fmt: skip
    for kernel in kernels:
        parts += [[kernel._kind, kernel._data.size], kernel._data]
    return np.concatenate([np.asarray(part, dtype=float) for part in parts])


def placed_vector(mass: FloatArray, springs: MountSprings) -> FloatArray:
    """A body on springs, their laws as given, as of `mounted_from_vector`."""
    kernels = list(dict.fromkeys(kernel for kernel in springs.kernels if kernel is not None))
    none = np.zeros_like(mass)
    return turning_vector(
        mass, none, None, springs, kernels, np.zeros(3), loads_turn=False, placed=False
    )


def turning_energy(mass: FloatArray, springs: MountSprings, states: FloatArray) -> FloatArray:
    """Kinetic and potential energy at states (u_1, u_1', ...), shape (..., 2 n)."""
    if any(kernel is not None for kernel in springs.kernels):
        raise InputError("kernel: energy is not defined with memory")
    if any(isinstance(law, Law) for law in springs.laws):
        raise InputError("law: is not a polynomial: its potential is unknown")
    u, v = states[..., ::2], states[..., 1::2].copy()
    v[..., 3:6] = spin(u[..., 3:6], v[..., 3:6])
    total: Any = 0.5 * np.einsum("...a,ab,...b", v, mass, v)
    for j, law in enumerate(springs.laws):
        row, arm = springs.rows[j], springs.arms[j]
        d = u @ row
        if row[:3].any():
            moved = turned(u[..., 3:6], arm) - arm - np.cross(u[..., 3:6], arm)
            d = d + moved @ row[:3]
        # Constant forces and the weight are in balance along the coordinates.
        total = total + springs.preload[j] * (d - u[..., :3] @ row[:3])
        total = total + 0.5 * springs.stiffness[j] * d**2
        for power, c in law.items():  # type: ignore[union-attr]
            total = total + c * d ** (power + 1) / (power + 1)
    return np.asarray(total)


def spin(theta: FloatArray, rate: FloatArray) -> FloatArray:
    """Angular velocity in body axes, omega = [1 - b S + c S^2] theta', shape (..., 3)."""
    b, c = _versine(theta)
    across = np.cross(theta, rate)
    return np.asarray(rate - b * across + c * np.cross(theta, across))


def turned(theta: FloatArray, vector: FloatArray) -> FloatArray:
    """A body vector in space axes, R v = [1 + a S + b S^2] v, shape (..., 3)."""
    b, c = _versine(theta)
    across = np.cross(theta, vector)
    a = 1 - (theta**2).sum(axis=-1, keepdims=True) * c
    return np.asarray(vector + a * across + b * np.cross(theta, across))


def further_moved(orders: Any, theta: ComplexArray, arm: FloatArray) -> ComplexArray:
    """Harmonics of R p - p - theta x p in the given orders, from samples.

    Parameters
    ----------
    orders : ndarray of int, shape (m,)
    theta : complex ndarray, shape (n, 3, m)
        Harmonics of the rotation vector.
    arm : ndarray, shape (3,)
        p.

    Returns
    -------
    ndarray, shape (n, 3, m)
    """
    samples = max(_FINE * int(np.max(orders)), _FINEST)
    phase = 2 * np.pi * np.arange(samples) / samples
    waves = np.exp(1j * np.outer(orders, phase))
    turning = np.moveaxis((theta @ waves).imag, 1, 2)
    further = turned(turning, arm) - arm - np.cross(turning, arm)
    weights = np.where(np.asarray(orders) == 0, 1j, 2j) / samples
    return np.asarray((np.moveaxis(further, 2, 1) @ waves.conj().T) * weights)


def _versine(theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(1 - cos t)/t^2 and (t - sin t)/t^3 of the angle t, shape (..., 1)."""
    square = (theta**2).sum(axis=-1, keepdims=True)
    t = np.sqrt(square)
    near = np.abs(t) < _SMALL
    safe = np.where(near, 1.0, t)
    b = np.where(near, 0.5 - square / 24 + square**2 / 720, (1 - np.cos(safe)) / safe**2)
    series = 1 / 6 - square / 120 + square**2 / 5040
    return b, np.where(near, series, (safe - np.sin(safe)) / safe**3)


def angular_momentum(
    inertia: FloatArray, spin_inside: FloatArray, states: FloatArray
) -> FloatArray:
    """Angular momentum about the mass centre in space axes, R (J omega + h), shape (..., 3)."""
    theta, rate = states[..., 6:12:2], states[..., 7:12:2]
    return turned(theta, spin(theta, rate) @ inertia + spin_inside)
