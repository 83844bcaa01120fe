"""Checks of the data of a body, and of positions, directions and loads."""

from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.bodies.mount_point import MountPoint
from viscovib.errors import InputError

NAMES = ("x", "y", "z", "rx", "ry", "rz")


def checked_inertia(value: npt.ArrayLike) -> FloatArray:
    """Return the inertia tensor, shape (3, 3)."""
    given = _native.real_array("inertia", value)
    tensor = np.diag(given) if given.shape == (3,) else given.copy()
    if tensor.shape != (3, 3):
        raise InputError(f"inertia: must have shape (3,) or (3, 3), got {given.shape}")
    return np.asarray(tensor)


def checked_mounts(value: Any) -> tuple[MountPoint, ...]:
    """Return the mounts, whose names must differ."""
    if isinstance(value, (list, tuple)) and not value:
        # A free body.
        return ()
    mounts = tuple(_native.several("mounts", value, MountPoint))
    names = [mount.name for mount in mounts]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"mounts: the name {name!r} is given twice, names must differ")
    return mounts


def checked_gravity(value: Any) -> FloatArray | None:
    """Return an acceleration, shape (3,); a number acts along -z."""
    if value is None:
        return None
    given = _native.real_array("gravity", value)
    if given.ndim == 0:
        if given < 0:
            raise InputError(
                f"gravity = {float(given):g}: must not be negative as a number, which acts along "
                "-z; give (0, 0, gz) for another direction"
            )
        return np.array([0.0, 0.0, -float(given)])
    return checked_vector("gravity", given)


def checked_vector(name: str, value: npt.ArrayLike) -> FloatArray:
    """Three numbers."""
    vector = _native.real_array(name, value).copy()
    if vector.shape != (3,):
        raise InputError(f"{name}: must have shape (3,), got {vector.shape}")
    return np.asarray(vector)


def checked_complex_vector(name: str, value: npt.ArrayLike) -> ComplexArray:
    """Three complex numbers."""
    vector = _native.complex_array(name, value)
    if vector.shape != (3,):
        raise InputError(f"{name}: must have shape (3,), got {vector.shape}")
    return np.asarray(vector)


def checked_axis(name: str, value: str | npt.ArrayLike) -> FloatArray:
    """Return a unit vector."""
    if isinstance(value, str):
        return np.asarray(np.eye(3)["xyz".index(_native.choice(name, value, ("x", "y", "z")))])
    vector = checked_vector(name, value)
    largest = float(np.abs(vector).max())
    if not largest > 0:
        raise InputError(f"{name} = 0 0 0: must have a direction")
    # Squares of very large or small numbers would overflow or underflow.
    if not 1e-100 < largest < 1e100:
        vector = vector / largest
    return np.asarray(vector / np.linalg.norm(vector))


def checked_floor(name: str, value: str | npt.ArrayLike) -> ComplexArray:
    """Motion of the floor, shape (6,), from a coordinate, a direction, or six amplitudes."""
    moved = np.zeros(6, dtype=complex)
    if isinstance(value, str):
        moved[NAMES.index(_native.choice(name, value, NAMES))] = 1.0
    elif np.shape(value) == (6,):
        moved[:] = _native.complex_array(name, value)
    else:
        moved[:3] = checked_axis(name, value)
    return moved


def checked_direction(value: str | npt.ArrayLike, n: int) -> FloatArray:
    """Motion of all coordinates with the floor, shape (n,)."""
    direction = np.zeros(n)
    if isinstance(value, str):
        direction[NAMES.index(_native.choice("base_direction", value, NAMES))] = 1.0
        return direction
    given = _native.real_array("base_direction", value)
    if given.shape != (6,):
        raise InputError(f"base_direction: must be one of {NAMES} or have shape (6,)")
    direction[:6] = given
    return direction


def inverse_of(matrix: FloatArray) -> FloatArray:
    """The inverse of a stiffness without free rigid-body motions."""
    if np.linalg.cond(matrix) > 1e14:
        raise InputError(
            "mounts: do not fully support the body, so there is no centre of compliance"
        )
    return np.asarray(np.linalg.inv(matrix))
