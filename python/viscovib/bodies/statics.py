"""Static equilibrium of a body under its weight and preloads, and its mount forces."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.bodies.mount_point import MountPoint
from viscovib.bodies.springs import MountSprings
from viscovib.bodies.turning import placed_vector
from viscovib.common.values import Value
from viscovib.errors import StabilityWarning, caller


@dataclass(frozen=True, eq=False, repr=False)
class Sag(Value):
    """The static equilibrium of a body after complete relaxation.

    Attributes
    ----------
    displacement : ndarray, shape (n,)
        x, y, z (m) and rx, ry, rz (rad) from the position without weight and preload.
    deflections : ndarray, shape (n_mounts, 3)
        Deflection of each mount along its local axes (m).
    forces : ndarray, shape (n_mounts, 3)
        Force of each mount on the body along its local axes (N).
    residual : float
        Residual of weight and preloads, relative to them.

    Examples
    --------
    >>> import viscovib as vv
    >>> foot = vv.MountPoint(
    ...     name="foot", position=(0, 0, 0), stiffness=(1e5, 1e5, 2e5),
    ...     rotational_stiffness=(1e3, 1e3, 1e3),
    ... )
    >>> sag = vv.Body(mass=5, inertia=(0.1, 0.2, 0.3), mounts=[foot], gravity=10).sag()
    >>> round(float(1e3 * sag.displacement[2]), 6)  # mm
    -0.25
    """

    displacement: FloatArray
    deflections: FloatArray
    forces: FloatArray
    residual: float


def settled(
    springs: MountSprings,
    mass: FloatArray,
    mounts: Sequence[MountPoint],
    gravity: FloatArray | None,
    *,
    turns: bool,
) -> tuple[Sag | None, MountSprings, FloatArray, FloatArray]:
    """Let the core place a body on its springs.

    Returns its static equilibrium (None: without weight and preloads), the springs about it, the
    stiffness of their forces against rotations, shape (3, 3), and the inertia in axes of the floor.

    Warns
    -----
    StabilityWarning
        For numbers that are probably not in SI units.
    """
    found = _native.run(
        "system body",
        flat=placed_vector(mass, springs),
        names=b"".join(mount.name.encode().ljust(64) for mount in mounts),
        first=np.array(springs.first, dtype=int) + 1,
        angles=np.array([mount.angles for mount in mounts], dtype=float).reshape(-1, 3).T,
        gravity=np.zeros(3) if gravity is None else gravity,
        exact=turns,
    )
    for line in found["doubts"].splitlines():
        warnings.warn(line, StabilityWarning, stacklevel=caller())
    inertia = mass[3:6, 3:6]
    if gravity is None and not found["preloads"]:
        return None, springs, np.zeros((3, 3)), inertia
    d, force = found["d"], found["carried"]
    places = np.array(springs.first)[:, None] + np.arange(3)
    sag = Sag(found["q"], d[places], -force[places], found["residual"])
    springs = springs.about(d)
    if turns:
        springs = replace(springs, rows=found["rows"], arms=found["arms"], preload=force)
        inertia = found["axes"] @ inertia @ found["axes"].T
    return sag, springs, found["bend"], inertia
