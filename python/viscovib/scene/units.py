"""Units of the numbers in a scene, which depend on its system."""

import re
from collections.abc import Mapping
from typing import Any

from viscovib.scene.body import coordinates_of

_MOUNT = {
    "mass": "kg",
    "inertia": "kg m^2",
    "offset": "m",
    "stiffness_x": "N/m",
    "stiffness_phi": "N m",
}
_BODY = {"mass": "kg", "inertia": "kg m^2", "center": "m", "gravity": "m/s^2"}
_MOUNT_POINT = {
    "position": "m", "stiffness": "N/m", "angles": "rad", "damping": "N s/m",
    "rotational_stiffness": "N m",
}  # fmt: skip
#: Unit of a load on a coordinate with this unit.
_FORCES = {"m": "N", "rad": "N m"}
#: Units of entries of matrices, by the units of two coordinates.
_MATRICES = {
    "mass": {("m", "m"): "kg", ("m", "rad"): "kg m", ("rad", "rad"): "kg m^2"},
    "damping": {("m", "m"): "N s/m", ("m", "rad"): "N s", ("rad", "rad"): "N m s"},
    "stiffness": {("m", "m"): "N/m", ("m", "rad"): "N", ("rad", "rad"): "N m"},
}
#: Units of the parts of an element, by the unit of its deflection.
_ELEMENTS = {
    unit: {entry: found[unit, unit] for entry, found in _MATRICES.items() if entry != "mass"}
    for unit in ("m", "rad")
}
_TIMES = ("t_end", "dt", "discard")
#: Groups with initial values.
_STARTS = ("transient", "ensemble", "basins")
_FREQUENCIES = ("nu", "nu_from", "nu_to", "p1", "p2", "p3", "amplitudes_at")


def unit_of(groups: Mapping[str, Any], key: str) -> str:
    """Return the unit of a key such as "load(2).amplitude"; "" if it has none or is unknown.

    A pendulum is dimensionless: its times are in 1/omega_1 and its frequencies in omega_1. The
    coordinates of a user-defined system have the given units (default: m), times are in s.
    """
    form = re.fullmatch(r"(\w+)(?:\((\d+)\))?\.(\w+)(?:\((\d+)\))?", key.lower())
    if form is None:
        return ""
    group, which, entry, element = form[1], int(form[2] or 1), form[3], int(form[4] or 1)
    pendulum = bool(groups.get("pendulum"))
    found = groups.get(group) or {}
    several = found if isinstance(found, list) else [found]
    own = several[which - 1] if 1 <= which <= len(several) else {}
    if group == "parameters":
        # Parameters of laws have unknown units, even one with the name nu.
        return ""
    if entry == "discard" and "n_periods" in own:
        return ""
    if entry in _TIMES:
        return "1/omega_1" if pendulum else "s"
    if entry in _FREQUENCIES:
        return "omega_1" if pendulum else "rad/s"
    if group == "element":
        return _element_unit(groups, own, entry)
    if entry in _MATRICES and group in ("mount", "system", "spring", "structure", "layer"):
        return _matrix_unit(_coordinates(groups)[0], own.get(entry), entry, element)
    if group == "mount":
        return _MOUNT.get(entry, "")
    if group == "body":
        return _BODY.get(entry, "")
    if group == "mount_point":
        track = ("kg", "N s/m", "N/m")
        return track[element - 1] if entry == "track" else _MOUNT_POINT.get(entry, "")
    if group == "kernel":
        return _kernel_unit(own, entry)
    if group == "load":
        return _load_unit(groups, own, entry)
    coordinates, rates = _coordinates(groups)
    if group in _STARTS and entry == "initial" and element <= 2 * len(coordinates):
        return (coordinates, rates)[(element - 1) % 2][(element - 1) // 2]
    if group == "transient" and entry == "held" and element <= len(coordinates):
        return coordinates[element - 1]
    if entry in ("from", "to"):
        return _end_unit(groups, group, own, coordinates)
    return ""


def _matrix_unit(units: list[str], values: Any, entry: str, element: int) -> str:
    """Return the unit of an entry of a matrix or of its diagonal."""
    n = len(units)
    diagonal = not isinstance(values, list) or len(values) == n
    row, column = (element - 1,) * 2 if diagonal else divmod(element - 1, n)
    if not 0 <= row < n:
        return ""
    first, second = sorted((units[row], units[column]))
    return _MATRICES[entry].get((first, second), "")


def _element_unit(groups: Mapping[str, Any], own: Mapping[str, Any], entry: str) -> str:
    """Return the unit of a part of an element whose coordinates have the same unit."""
    names, (units, _) = _names(groups), _coordinates(groups)
    on = own.get("on", [])
    on = on if isinstance(on, list) else [on]
    found = {units[names.index(name)] if name in names else "" for name in on}
    return _ELEMENTS.get(found.pop(), {}).get(entry, "") if len(found) == 1 else ""


def _kernel_unit(kernel: Mapping[str, Any], entry: str) -> str:
    kind = str(kernel.get("kind", "")).lower()
    units = {
        "rates": "1/s", "weights": "1/s", "times": "s", "values": "1/s", "temperature": "degC",
    }  # fmt: skip
    # R = A exp(-beta t) t^(alpha-1); in Rabotnov's kernel beta multiplies t^alpha instead.
    if kind == "rzhanitsyn":
        units["beta"] = "1/s"
    elif kind == "rabotnov":
        units["beta"] = "1/s^alpha"
    return units.get(entry, "1/s^alpha" if entry == "amplitude" else "")


def _load_unit(groups: Mapping[str, Any], load: Mapping[str, Any], entry: str) -> str:
    if entry == "phase":
        return "rad"
    if entry != "amplitude":
        return ""
    names, (units, _) = _names(groups), _coordinates(groups)
    if "force" in load or "torque" in load:
        return ""
    if load.get("kind") == "base" and load.get("on") in names:
        return units[names.index(load["on"])]
    if load.get("kind") == "base":
        return units[0] if len(set(units)) == 1 or groups.get("mount") else ""
    on = load.get("on", names[0] if len(names) == 1 or groups.get("mount") else None)
    return _FORCES.get(units[names.index(on)], "") if on in names else ""


def _end_unit(
    groups: Mapping[str, Any], group: str, own: Mapping[str, Any], coordinates: list[str]
) -> str:
    varied = str(own.get("vary", own.get("parameter", "")))
    if group in ("branch", "ensemble", "multiple_scales"):
        pendulum = bool(groups.get("pendulum"))
        if varied in _FREQUENCIES or (not varied and group != "ensemble"):
            return "omega_1" if pendulum else "rad/s"
        return _MOUNT.get(varied, "") if groups.get("mount") else ""
    if group != "backbone" or own.get("parameter", "amplitude") != "amplitude":
        return ""
    names = _names(groups)
    if own.get("dof") in names:
        return coordinates[names.index(own["dof"])]
    return coordinates[0] if len(set(coordinates)) == 1 else ""


def _names(groups: Mapping[str, Any]) -> list[str]:
    if groups.get("mount"):
        return ["x", "phi"]
    if groups.get("pendulum"):
        return ["z", "phi", "psi"]
    if groups.get("body"):
        return list(coordinates_of(groups["mount_point"]))
    found = (groups.get("system") or groups.get("structure") or {}).get("coordinates", "x")
    return list(found) if isinstance(found, list) else [found]


def _coordinates(groups: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    """Units of the coordinates and of their velocities."""
    if groups.get("mount"):
        return ["m", "rad"], ["m/s", "rad/s"]
    if groups.get("pendulum"):
        return ["L", "rad", "rad"], ["L omega_1", "rad omega_1", "rad omega_1"]
    names = _names(groups)
    if groups.get("body"):
        units = [*3 * ["m"], *3 * ["rad"], *(len(names) - 6) * ["m"]]
        return units, [f"{unit}/s" for unit in units]
    note = (groups.get("system") or groups.get("structure") or {}).get("units", "m")
    listed = list(note) if isinstance(note, list) else [note] * len(names)
    listed += [""] * (len(names) - len(listed))
    return listed, [f"{unit}/s" if unit else "" for unit in listed]
