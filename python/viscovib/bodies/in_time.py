"""Motions of points along a motion of a body in time."""

from __future__ import annotations

from typing import Any

import numpy as np

from viscovib._native import FloatArray
from viscovib.bodies.turning import spin, turned

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
