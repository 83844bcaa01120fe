"""The body of a scene, from its groups &body and &mount_point."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from viscovib.bodies.body import Body
from viscovib.bodies.checks import NAMES
from viscovib.bodies.mount_point import FluidTrack, MountPoint
from viscovib.kernels.relaxation import Kernel

#: Keys of a &mount_point that are attributes of `MountPoint` with the same names.
_SAME = ("position", "stiffness", "angles", "damping", "rotational_stiffness")


def body_of(
    given: Mapping[str, Any],
    mount_points: Sequence[Mapping[str, Any]],
    kernels: Sequence[Kernel | None],
) -> Body:
    """Build the body; ``kernels`` are in the order of their numbers, None first."""
    inertia = np.asarray(given["inertia"], dtype=float)
    spin, rotor = np.array([given["spin"], given["rotor"]], dtype=float)
    if "speed" in given:
        spin, rotor = spin + given["speed"] * rotor, 0 * rotor
    return Body(
        mass=given["mass"],
        inertia=inertia if inertia.size == 3 else inertia.reshape(3, 3),
        mounts=[_mount_point(group, kernels) for group in mount_points],
        center=given["center"],
        gravity=given["gravity"] if any(given["gravity"]) else None,
        geometry=given["geometry"],
        load_axes=given["load_axes"],
        base_direction=given["base_direction"] if any(given["base_direction"]) else None,
        spin=spin,
        rotor=rotor,
    )


def _mount_point(group: Mapping[str, Any], kernels: Sequence[Kernel | None]) -> MountPoint:
    which = group["kernels"] if "kernels" in group else [group["kernel"]] * 3
    laws = [group[f"law_{axis}"].lower() for axis in "xyz"]
    track = None
    if any(group["track"]):
        mass, damping, stiffness = group["track"]
        axis = "xyz".index(group["track_axis"])
        track = FluidTrack(mass=mass, damping=damping, stiffness=stiffness, axis=axis)
    return MountPoint(
        name=group["name"].lower(),
        **{key: group[key] for key in _SAME},
        kernel=[kernels[place] for place in which],
        law=[None if law == "0" else law for law in laws],
        track=track,
    )


def coordinates_of(mount_points: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """Names of the coordinates of a body: six, and one for each fluid track."""
    tracked = [group["name"].lower() for group in mount_points if any(group["track"])]
    return (*NAMES, *(f"{name}_y" for name in tracked))
