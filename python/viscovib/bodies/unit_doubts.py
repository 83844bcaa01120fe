"""Warnings for numbers of a body that are probably not in SI units."""

import math
import warnings
from collections.abc import Sequence

import numpy as np

from viscovib._native import FloatArray
from viscovib.bodies.mount_point import MountPoint
from viscovib.bodies.springs import MountSprings
from viscovib.errors import StabilityWarning, caller

#: Mounts farther away than this multiple of the radius of gyration are probably in mm.
_FAR = 50.0
#: Smallest radius of gyration (m) that may be wrong if it is far larger than mount distances.
_LARGE = 20.0
#: If the static deflection in the stiffest direction exceeds this multiple of the size of the body,
#: stiffnesses are probably in N/mm. Machines sink by 1 to 30 mm, on soft air springs by 0.3 m.
_SUNK = 1.0
#: No error of units if the deflection (m) exceeds this even with 1000 times the stiffness.
_DEEPEST = 0.1
_GRAVITY = 9.81


def warn_of_units(
    mass: float,
    inertia: FloatArray,
    center: FloatArray,
    mounts: Sequence[MountPoint],
    springs: MountSprings,
) -> None:
    """Warn of the first number that is probably in wrong units, with the reason.

    Warns
    -----
    StabilityWarning
    """
    radius = math.sqrt(np.trace(inertia) / 2 / mass)
    farthest = 0.0
    for mount in mounts:
        angles = np.asarray(mount.angles)
        largest = float(angles[np.abs(angles).argmax()])
        if abs(largest) > 2 * math.pi:
            warnings.warn(
                f"{mount.name}: angles: {largest:g} is more than a whole turn: angles are in "
                "rad, those in degrees are to be multiplied by units.degree",
                StabilityWarning,
                stacklevel=caller(),
            )
        away = math.dist(np.asarray(mount.position), center)
        farthest = max(farthest, away)
        if away > _FAR * radius:
            warnings.warn(
                f"{mount.name}: is {away:g} m from the centre of mass of a body whose radius "
                f"of gyration is {radius:.3g} m: positions are in m, those in mm are to be "
                "multiplied by units.mm",
                StabilityWarning,
                stacklevel=caller(),
            )
            return
    if radius > max(_FAR * farthest, _LARGE) and farthest > 0:
        warnings.warn(
            f"inertia: the radius of gyration is {radius:.3g} m, the farthest mount is "
            f"{farthest:.3g} m from the centre of mass: inertia is in kg m^2, that in kg mm^2 "
            "is to be multiplied by units.mm**2",
            StabilityWarning,
            stacklevel=caller(),
        )
        return
    _warn_of_soft_springs(mass, max(radius, farthest), springs)


def _warn_of_soft_springs(mass: float, size: float, springs: MountSprings) -> None:
    """Warn of springs so soft that the body would sink by more than its size.

    Springs with only a law are not checked, because their stiffness at rest does not support the
    body. A mass of 1 is not checked either, because such a body may be dimensionless.
    """
    if mass == 1 or any(
        law and not k > 0 for law, k in zip(springs.laws, springs.stiffness, strict=True)
    ):
        return
    along = springs.rows[:, :3]
    total = float(np.linalg.eigvalsh((along.T * springs.stiffness) @ along).max())
    if total <= 0:
        return
    sunk = mass * _GRAVITY / total
    if not (sunk > _SUNK * size and sunk < 1000 * _DEEPEST):
        return
    warnings.warn(
        f"stiffness: of all mounts together at most {total:.3g} N/m in any direction, by which "
        f"{mass:.3g} kg would sink by {sunk:.3g} m, more than the {size:.3g} m "
        "that the body measures: stiffnesses are in N/m, those in N/mm are to be multiplied by "
        "units.newton_per_mm",
        StabilityWarning,
        stacklevel=caller(),
    )
