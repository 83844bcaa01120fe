"""Deflections of mounts and motions of points along a motion of a body in time."""

from __future__ import annotations

from typing import Any

import numpy as np

from viscovib._native import FloatArray
from viscovib.bodies.springs import MountSprings
from viscovib.bodies.turning import spin, turned
from viscovib.systems.laws import Law

#: Step of derivatives by complex numbers.
_STEP = 1e-100


def point_moved(
    arm: FloatArray, u: FloatArray, rate: FloatArray, push: FloatArray | None, *, turns: bool
) -> tuple[FloatArray, ...]:
    """Displacement, velocity and acceleration (n, 3) of a point, from coordinates (n, 6 or more).

    ``arm``: from the centre of mass; without ``push``, the second derivatives, no acceleration.
    """
    theta, spins = u[:, 3:6], rate[:, 3:6]
    if not turns:
        moved = [u, rate] if push is None else [u, rate, push]
        return tuple(one[:, :3] + np.cross(one[:, 3:6], arm) for one in moved)
    now = turned(theta, arm)
    # The angular velocity in axes of space is that of the opposite rotation in axes of the body.
    omega = spin(-theta, spins)
    velocity = rate[:, :3] + np.cross(omega, now)
    if push is None:
        return u[:, :3] + now - arm, velocity
    along: Any = spin(-theta - 1j * _STEP * spins, spins + 1j * _STEP * push[:, 3:6])
    swing = np.cross(along.imag / _STEP, now) + np.cross(omega, np.cross(omega, now))
    return u[:, :3] + now - arm, velocity, push[:, :3] + swing


def deflected(
    springs: MountSprings, u: FloatArray, rate: FloatArray, *, turns: bool
) -> tuple[FloatArray, FloatArray]:
    """Deflections of all springs and their rates, shape (n, n_springs)."""
    d, speed = u @ springs.rows.T, rate @ springs.rows.T
    if turns:
        for j, row in enumerate(springs.rows):
            if not row[:3].any():
                continue
            place, velocity = point_moved(springs.arms[j], u, rate, None, turns=True)
            d[:, j] += (place - u[:, :3] - np.cross(u[:, 3:6], springs.arms[j])) @ row[:3]
            speed[:, j] += (velocity - rate[:, :3] - np.cross(rate[:, 3:6], springs.arms[j])) @ row[
                :3
            ]
    return d, speed


def elastic(springs: MountSprings, d: FloatArray, rate: FloatArray) -> FloatArray:
    """Forces k d + g(d, d') of all springs without memory, shape (n, n_springs)."""
    force = springs.stiffness * d
    for j, law in enumerate(springs.laws):
        if isinstance(law, Law):
            both = np.stack([d[:, j], rate[:, j]], axis=1)
            force[:, j] += law.values(both[:, : len(law.arguments)])
        elif law:
            force[:, j] += sum(c * d[:, j] ** power for power, c in law.items())
    return force
