"""Forces of mounts, elements and springs along a motion in time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.acting import KnownMotion
from viscovib.bodies.body import Body
from viscovib.errors import InputError
from viscovib.results.motion_forces import ElementForces, MountForcesInTime, SupportReactions
from viscovib.systems.elements import element_vector
from viscovib.systems.mount import Mount
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.structure import Structure
from viscovib.systems.whole import law_places


def mount_forces(body: object, motion: KnownMotion) -> MountForcesInTime:
    """Forces of all mounts of a body along their local axes."""
    if not isinstance(body, Body):
        raise InputError(
            "mount_forces: is for motions of a Body; element_forces() is for other systems"
        )
    found = _of_mounts(body, motion)
    parts = ("deflection", "rate", "elastic", "damping", "memory", "moment", "point")
    axes = np.array([mount.rotation for mount in body.mounts]).reshape(-1, 3, 3)
    names = tuple(mount.name for mount in body.mounts)
    shown = {part: found[part].transpose(0, 2, 1) for part in parts}
    return MountForcesInTime(motion.t, names, **shown, axes=axes, _floor=found["floor"])


def _of_mounts(body: Body, motion: KnownMotion) -> dict[str, Any]:
    """What the core finds about the mounts of a body, made once."""
    if not motion.mounts:
        sag = 0.0 if body._sag is None or not body._turns else body._sag.displacement[:3]
        found = motion.find(
            "motion mount forces", flat=body._placed, exact=body._turns,
            mount_of=body._mount_springs.mount_of, center=body.center + sag,
        )  # fmt: skip
        motion.mounts.append(found)
    return motion.mounts[0]


def remembered_by_body(system: object, motion: KnownMotion) -> FloatArray | None:
    """Return the forces -R * g on the coordinates of a body of small rotations, or None."""
    if not isinstance(system, Body) or system._turns or motion.has_accelerations:
        return None
    if motion.make_panels is None:
        return None
    return np.asarray(_of_mounts(system, motion)["remembered"])


def element_forces(system: Any, motion: KnownMotion) -> ElementForces:
    """Forces of the elements of a structure, or of the springs of another system."""
    if isinstance(system, Body):
        raise InputError("element_forces: a Body has mounts: use mount_forces()")
    if system._is_condensed:
        chosen = [
            i
            for i, element in enumerate(system._all_elements)
            # Directions of a coupling are places only.
            if element.powers or element.damping or element.law is not None
        ]
        ends = [one.series or one for one in (system._all_elements[i] for i in chosen)]
        names = _distinct(_name(end.direction, system.dof_names) for end in ends)
        return ElementForces(motion.t, names, **_of_elements(system, motion, chosen))
    if isinstance(system, Mount):
        found = motion.find("motion element forces")
        return ElementForces(motion.t, ("x", "phi"), **found, units=("N", "N m"))
    if isinstance(system, PolynomialSystem):
        return _of_groups(system, motion)
    raise InputError("element_forces: is for a Structure, a PolynomialSystem or a Mount")


def support_reactions(
    structure: Structure, motion: KnownMotion, base: Sequence[FloatArray]
) -> SupportReactions:
    """Forces that hold or move the supports, for a base motion y, y', y'', each (n,)."""
    held = structure._held
    assert held is not None
    weights, rows = held.rows("support_reactions")
    still = np.zeros((motion.t.size, held.held.size))
    matrices = np.moveaxis(rows, 0, 2)
    along = np.zeros(rows.shape[2]) if held.motion is None else held.motion
    arrays = {
        "base": np.stack(base, axis=1), "apart": np.stack(motion.supports or (still,) * 3, axis=2),
        "free": matrices[:, held.free], "held": matrices[:, held.held], "based": (rows @ along).T,
    }  # fmt: skip
    given = {name: np.asfortranarray(array) for name, array in arrays.items()}
    remembers = not motion.has_accelerations
    found = motion.find("motion support reactions", remembers=remembers, **given)
    force = np.asarray(found["force"])
    if held.touched:
        # A coupling has one entry for each of its deflections.
        first = np.cumsum([0, *(len(one) for one in held.ends)])[held.touched].tolist()
        found = _of_elements(structure, motion, first)
        force = force + (found["elastic"] + found["damping"] + found["memory"]) @ weights
    return SupportReactions(motion.t, held.names, force, held.units)


def _of_elements(
    structure: Structure, motion: KnownMotion, chosen: Sequence[int]
) -> dict[str, Any]:
    """Forces of some elements of a structure."""
    elements = [structure._all_elements[i] for i in chosen]
    given: dict[str, Any] = {"elements": element_vector(elements, structure.n_coordinates)}
    if motion.supports is not None:
        held = structure._held
        assert held is not None
        given["apart"] = np.stack(motion.supports, axis=2)
        # Layers do not act on such supports.
        rows = np.concatenate(
            [*held.ends, np.zeros((len(structure._all_elements), held.held.size))]
        )
        given["weights"] = rows[chosen].T
    places = law_places(structure)
    laws = [places[i] for i in chosen if structure._all_elements[i].law is not None]
    # Rows of the forces that the equations gave; 0: an element without a place among them.
    given["laws"] = np.array([0 if one is None else one + 1 for one in laws], dtype=np.int32)
    return motion.find("motion element forces", **given)


def _of_groups(system: PolynomialSystem, motion: KnownMotion) -> ElementForces:
    """Forces of each group of springs on each coordinate, and of the damping matrix."""
    groups, names = system.groups, system.dof_names
    first = np.cumsum([0, *(len(group.laws) for group in groups)]).tolist()
    found = []
    for g in range(len(groups)):
        handle = _native.polynomial_object(system._numbers(g))
        laws = np.arange(first[g], first[g + 1], dtype=np.int32) + 1
        found.append(motion.find("motion element forces", handle, laws=laws))
    parts: dict[str, Any] = {name: np.hstack([one[name] for one in found]) for name in found[0]}
    shown = [
        name if g == 0 else f"springs[{g - 1}].{name}" for g in range(len(groups)) for name in names
    ]
    return ElementForces(motion.t, tuple(shown), **parts)


def _name(direction: FloatArray, names: Sequence[str]) -> str:
    """A direction as a sum of coordinates."""
    places = np.flatnonzero(direction)
    text = ""
    for i in places[:4]:
        w = float(direction[i])
        factor = "" if abs(w) == 1 else f"{abs(w):.6g}*"
        sign = ("-" if w < 0 else "") if not text else (" - " if w < 0 else " + ")
        text += f"{sign}{factor}{names[i]}"
    return text + (" + ..." if places.size > 4 else "")


def _distinct(names: Any) -> tuple[str, ...]:
    """Names of elements on one direction with a number."""
    found: list[str] = []
    for name in names:
        other, k = name, 1
        while other in found:
            k += 1
            other = f"{name} ({k})"
        found.append(other)
    return tuple(found)
