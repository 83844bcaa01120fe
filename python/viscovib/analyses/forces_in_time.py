"""Forces of mounts, elements and springs along a motion in time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.acting import KnownMotion, accelerations
from viscovib.bodies.body import Body
from viscovib.errors import InputError
from viscovib.kernels.relaxation import Kernel
from viscovib.results.motion_forces import ElementForces, MountForcesInTime, SupportReactions
from viscovib.systems.laws import Law
from viscovib.systems.mount import Mount
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.structure import Structure
from viscovib.systems.whole import law_places

#: Forces at states of a motion: coordinates, rates, and forces of laws if these are known.
_Forces = Callable[[FloatArray, FloatArray, FloatArray | None], FloatArray]


def remembered(
    motion: KnownMotion, forces: _Forces, kernels: Sequence[Kernel | None], scale: float = 1.0
) -> FloatArray:
    """Return -R * g for each force (n, m), each with its kernel or None."""
    panels = motion.panels
    found = np.zeros((motion.t.size, len(kernels)))
    if panels is None or not any(kernel is not None for kernel in kernels):
        return found
    values = forces(panels.u, panels.rate, panels.laws)
    held = np.zeros(len(kernels))
    if panels.held.any():
        at = panels.held[np.newaxis]
        held = forces(at, 0 * at, np.full((1, panels.laws.shape[1]), np.nan))[0]
    for kernel in dict.fromkeys(kernels):
        if kernel is None:
            continue
        these = [j for j, one in enumerate(kernels) if one == kernel]
        part = panels.recalled(kernel, values[:, these], held[these], motion.t)
        found[:, these] = -scale * part
    return found


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
        panels = motion.panels
        given = {} if panels is None else panels.given | {"times": motion.t}
        found = _native.run_either(
            panels is not None, "motion mount forces", flat=body._placed, exact=body._turns,
            mount_of=body._mount_springs.mount_of, center=body.center + sag,
            u=np.asfortranarray(motion.u), rate=np.asfortranarray(motion.rate), **given,
        )  # fmt: skip
        motion.mounts.append(found)
    return motion.mounts[0]


def remembered_by_body(system: object, motion: KnownMotion) -> FloatArray | None:
    """Return the forces -R * g on the coordinates of a body of small rotations, or None."""
    if not isinstance(system, Body) or system._turns or motion.push is not None:
        return None
    if motion.make_panels is None:
        return None
    return np.asarray(_of_mounts(system, motion)["remembered"])


def element_forces(system: object, motion: KnownMotion) -> ElementForces:
    """Forces of the elements of a structure, or of the springs of another system."""
    if isinstance(system, Body):
        raise InputError("element_forces: a Body has mounts: use mount_forces()")
    if isinstance(system, Structure):
        return _of_structure(system, motion)
    if isinstance(system, Mount):
        return _of_mount(system, motion)
    if isinstance(system, PolynomialSystem):
        return _of_polynomial(system, motion)
    raise InputError("element_forces: is for a Structure, a PolynomialSystem or a Mount")


def support_reactions(
    structure: Structure, motion: KnownMotion, base: Sequence[FloatArray]
) -> SupportReactions:
    """Forces that hold or move the supports, for a base motion y, y', y'', each (n,)."""
    held = structure._held
    assert held is not None
    weights, rows = held.rows("support_reactions")
    relative = motion.u, motion.rate, accelerations(motion) - motion.acting.push
    force: FloatArray = np.zeros((motion.t.size, held.held.size))
    for row, own, moved in zip(rows[::-1], relative, base, strict=True):
        force += own @ row[:, held.free].T
        if held.motion is not None:
            force += np.outer(moved, row @ held.motion)
    for row, each in zip(rows[::-1], motion.supports or (), strict=False):
        force += each @ row[:, held.held].T
    if held.touched:
        # A coupling has one entry for each of its deflections.
        first = np.cumsum([0, *(len(one) for one in held.ends)])[held.touched].tolist()
        force += _of_structure(structure, motion, first).force @ weights
    return SupportReactions(motion.t, held.names, force, held.units)


def _of_structure(
    structure: Structure, motion: KnownMotion, only: Sequence[int] | None = None
) -> ElementForces:
    at = law_places(structure)
    rows = [
        i
        for i, element in enumerate(structure._all_elements)
        # Directions of a coupling are places only.
        if (element.powers or element.damping or element.law is not None)
        and (only is None or i in only)
    ]
    chosen = [(structure._all_elements[i], at[i]) for i in rows]
    directions = np.array([element.direction for element, _ in chosen])
    directions = directions.reshape(-1, structure.n_coordinates).T

    def forces(u: FloatArray, rate: FloatArray, laws: FloatArray | None) -> FloatArray:
        return forces_of(u @ directions, rate @ directions, laws)

    def forces_of(d: FloatArray, speed: FloatArray, laws: FloatArray | None) -> FloatArray:
        force: FloatArray = np.zeros(d.shape)
        for j, (element, place) in enumerate(chosen):
            law: Any = element.law
            if law is None or not law.state:
                for power, c in element.powers.items():
                    force[:, j] += c * d[:, j] ** power
            if law is not None:
                force[:, j] += _law_values(law, d[:, j], speed[:, j], laws, place)
        return force

    d, speed = motion.u @ directions, motion.rate @ directions
    if motion.supports is not None:
        held = structure._held
        assert held is not None
        ends_of = np.concatenate(held.ends)[rows].T
        d = d + motion.supports[0] @ ends_of
        speed = speed + motion.supports[1] @ ends_of
    damping = speed * np.array([element.damping for element, _ in chosen])
    elastic = forces_of(d, speed, motion.laws)
    ends = [element.series or element for element, _ in chosen]
    for j, (element, _) in enumerate(chosen):
        if element.series is not None:
            e, k, rate = element.series
            elastic[:, j], damping[:, j] = k * (speed[:, j] + rate * d[:, j]), 0.0
            d[:, j], speed[:, j] = motion.u @ e, motion.rate @ e
    names = _distinct(_name(end.direction, structure.dof_names) for end in ends)
    kernels = [element.kernel for element, _ in chosen]
    return ElementForces(
        motion.t, names, d, speed, elastic, damping,
        remembered(motion, forces, kernels),
    )  # fmt: skip


def _law_values(
    law: Law, d: FloatArray, speed: FloatArray, laws: FloatArray | None, place: int | None
) -> FloatArray:
    """Forces of a law: as the run has them, else by the law itself."""
    known = np.full(d.shape, np.nan)
    if laws is not None and place is not None and laws.shape[1]:
        known = laws[:, place].copy()
    unset = np.isnan(known)
    if law.state:
        # Before t = 0 an element is at rest.
        known[unset] = 0.0
    elif unset.any():
        both = np.stack([d[unset], speed[unset]], axis=1)
        known[unset] = law.values(both[:, : len(law.arguments)])
    return known


def _of_mount(mount: Mount, motion: KnownMotion) -> ElementForces:
    """The springs of x and phi; the damping matrix is no part of them."""
    stiffness = np.array([mount.stiffness_x, mount.stiffness_phi])

    def moved(u: FloatArray, rate: FloatArray) -> tuple[FloatArray, FloatArray]:
        phi, speed = u[:, 1], rate[:, 1]
        if mount.geometry == "exact":
            arm, slope = np.sin(phi), np.cos(phi)
        else:
            arm = phi - mount.cubic_scale * phi**3 / 6
            slope = 1 - mount.cubic_scale * phi**2 / 2
        d = np.stack([u[:, 0] - mount.offset * arm, phi], axis=1)
        return d, np.stack([rate[:, 0] - mount.offset * slope * speed, speed], axis=1)

    def forces(u: FloatArray, rate: FloatArray, _: FloatArray | None) -> FloatArray:
        force: FloatArray = stiffness * moved(u, rate)[0]
        return force

    d, speed = moved(motion.u, motion.rate)
    in_phi = mount.kernel if mount.kernel_phi is None else mount.kernel_phi
    kernels = [mount.kernel, in_phi if isinstance(in_phi, Kernel) else None]
    memory = remembered(motion, forces, kernels, mount.memory_scale)
    return ElementForces(
        motion.t, ("x", "phi"), d, speed, stiffness * d, np.zeros_like(d), memory, ("N", "N m")
    )


def _of_polynomial(system: PolynomialSystem, motion: KnownMotion) -> ElementForces:
    """Forces of each group of springs on each coordinate, and of the damping matrix."""
    n = len(system.dof_names)
    groups = system.groups
    first = np.cumsum([0, *(len(group.laws) for group in groups)])

    def forces(u: FloatArray, rate: FloatArray, laws: FloatArray | None) -> FloatArray:
        found = np.zeros((u.shape[0], len(groups), n))
        for g, group in enumerate(groups):
            found[:, g] = u @ group.stiffness.T
            for (on, powers), c in group.forces.items():
                found[:, g, on] += c * np.prod(u ** np.array(powers), axis=1)
            both = np.concatenate([u, rate], axis=1)
            for k, (on, law) in enumerate(group.laws):
                known = None if laws is None or not laws.shape[1] else laws[:, first[g] + k]
                if known is None or np.isnan(known).any():
                    known = law.values(both[:, : len(law.arguments)])
                found[:, g, on] += known
        return found.reshape(u.shape[0], -1)

    elastic_part = forces(motion.u, motion.rate, motion.laws)
    kernels = [group.kernel for group in groups for _ in range(n)]
    memory = remembered(motion, forces, kernels)
    damping = np.zeros_like(elastic_part)
    damping[:, :n] = motion.rate @ np.asarray(system._damping).T
    names = [
        name if g == 0 else f"springs[{g - 1}].{name}"
        for g in range(len(groups))
        for name in system.dof_names
    ]
    times = len(groups)
    return ElementForces(
        motion.t, tuple(names), np.tile(motion.u, times), np.tile(motion.rate, times),
        elastic_part, damping, memory,
    )  # fmt: skip


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
