"""Parameters of a body that may vary along a branch, by name."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.bodies.linear_body import LinearBody
from viscovib.bodies.mount_point import MountPoint
from viscovib.errors import InputError
from viscovib.systems.varying import Varied, varied

_AXES = "xyz"
#: Highest power of p: a law of power q at a mount with a varied position has q + 1.
_HIGHEST = 8
#: Largest relative error of the polynomial.
_ROUNDING = 1e-12
_OF_MOUNTS = ("stiffness", "damping", "position")


def varied_body(body: LinearBody, name: object, start: float, finish: float) -> Varied:
    """Return the numbers of ``mass``, ``mounts[front].stiffness[z]``, ``mounts[front].k3`` ...

    The body is created at some values p, and polynomials in p are fitted to its numbers: of degree
    1 for masses and stiffnesses, of degree q + 1 for the position of a mount with a law of power q.
    All other names are those of a polynomial system.
    """
    changed = _changed(body, name)
    if changed is None:
        return varied(body, name, start, finish)

    def numbers(p: float) -> FloatArray:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return np.asarray(rebuilt(body, **changed(p))._vector)

    for end in (start, finish):
        numbers(end)
    try:
        return _polynomial(str(name), numbers, start, finish)
    except InputError as error:

        def with_slopes(p: float) -> FloatArray:
            # Stiffness and damping at rest, such as F/w of F tanh(v/w), are not polynomials in w.
            return np.asarray(rebuilt(body, **changed(p))._with_slopes_of(body)._vector)

        try:
            return _polynomial(str(name), with_slopes, start, finish)
        except InputError:
            raise error from None


def numbers_of_body(body: LinearBody) -> tuple[str, ...]:
    """Names of the parameters of a body, without the entries of its matrices."""
    names = ["mass", "inertia_scale", *(f"center[{axis}]" for axis in _AXES)]
    for mount in body.mounts:
        places = [*(f"[{axis}]" for axis in _AXES), "_scale"]
        own = [f"{key}{place}" for key in _OF_MOUNTS for place in places]
        names += [f"mounts[{mount.name}].{key}" for key in (*own, *mount._named_parameters)]
    return tuple(names)


def with_numbers(body: LinearBody, numbers: Mapping[str, float]) -> LinearBody:
    """Return the body with new values of parameters."""
    with warnings.catch_warnings():
        # The given body has already issued these warnings.
        warnings.simplefilter("ignore")
        for name, value in numbers.items():
            changed = _changed(body, name)
            assert changed is not None
            body = rebuilt(body, **changed(value))
    return body


def rebuilt(body: LinearBody, **changes: Any) -> LinearBody:
    """Return a new body with changed arguments."""
    given: dict[str, Any] = {
        "mass": body.body_mass, "inertia": body.inertia, "mounts": body.mounts,
        "center": body.center, "gravity": body.gravity, "geometry": body.geometry,
        "load_axes": body.load_axes, "base_direction": body.base_direction, "spin": body.spin,
        "rotor": body.rotor,
    }  # fmt: skip
    return type(body)(**(given | changes))


def _changed(body: LinearBody, name: object) -> Callable[[float], dict[str, Any]] | None:
    """Function of p that returns changed arguments; None: not a parameter of a body."""
    if name == "mass":
        return lambda p: {"mass": p}
    if name == "inertia_scale":
        return lambda p: {"inertia": p * np.asarray(body.inertia)}
    if not isinstance(name, str):
        return None
    text = name.replace(" ", "")
    form = re.fullmatch(r"center\[([xyz])\]", text)
    if form is not None:
        axis = _AXES.index(form[1])
        return lambda p: {"center": _with(body.center, axis, p)}
    if not text.startswith("mounts["):
        return None
    form = re.fullmatch(r"mounts\[([^\]]*)\]\.(.*)", text)
    names = [mount.name for mount in body.mounts]
    place = 0
    if form is not None:
        place = names.index(_native.choice(f"vary = {name!r}: mount", form[1], tuple(names)))
    mount = body.mounts[place]
    of_laws = mount._named_parameters
    if form is not None and form[2] in of_laws:
        return _of_law(body, place, form[2])
    form = re.fullmatch(r"mounts\[([^\]]*)\]\.(\w+?)(?:_scale|\[([xyz])\])", text)
    if form is None or form[2] not in _OF_MOUNTS:
        raise InputError(
            f"vary = {name!r}: must be a number of a mount such as 'mounts[{mount.name}]."
            "stiffness[z]' or '.position[x]' (of stiffness, damping and position), or a factor "
            "such as '.stiffness_scale'"
            + (f", or a parameter of its laws, {', '.join(of_laws)}" if of_laws else "")
        )
    key = form[2]
    # The full linear stiffness, including polynomial laws.
    was = np.asarray(mount._elastic if key == "stiffness" else getattr(mount, key), dtype=float)

    def at(p: float) -> dict[str, Any]:
        value = p * was if form[3] is None else _with(was, _AXES.index(form[3]), p)
        mounts = list(body.mounts)
        mounts[place] = _mount_with(name, mount, key, value)
        return {"mounts": mounts}

    return at


def _of_law(body: LinearBody, place: int, key: str) -> Callable[[float], dict[str, Any]]:
    """Function that returns the arguments for a parameter of the laws of a mount."""
    mount = body.mounts[place]
    before = dict(mount.parameters or {})

    def at(p: float) -> dict[str, Any]:
        mounts = list(body.mounts)
        mounts[place] = replace(mount, parameters={**before, key: p})
        return {"mounts": mounts}

    return at


def _with(vector: Any, axis: int, p: float) -> FloatArray:
    changed = np.array(vector, dtype=float)
    changed[axis] = p
    return changed


def _mount_with(name: str, mount: MountPoint, key: str, value: FloatArray) -> MountPoint:
    """The mount with a new value, without further checks."""
    if key != "position" and not (value >= 0).all():
        raise InputError(f"{name}: must not be less than 0, got {value.min():g}")
    value.setflags(write=False)
    other = copy(mount)
    object.__setattr__(other, "_elastic" if key == "stiffness" else key, value)
    return other


def _polynomial(
    name: str, numbers: Callable[[float], FloatArray], start: float, finish: float
) -> Varied:
    """Fit the numbers by powers of p, at values where none is 0 by chance."""
    unit = max(abs(start), abs(finish))
    places = np.cos(np.pi * (np.arange(_HIGHEST + 4) + 0.37) / (_HIGHEST + 4))
    low, high = min(start, finish), max(start, finish)
    at = 0.5 * (low + high) + 0.5 * (high - low) * places
    found = [numbers(p) for p in at.tolist()]
    if all(one.size == found[0].size for one in found):
        known = np.array(found)
        size = np.abs(known).max(0)
        for degree in range(1, _HIGHEST + 1):
            powers = np.vander(at / unit, degree + 1, increasing=True)
            series = np.linalg.lstsq(powers, known, rcond=None)[0]
            if (np.abs(powers @ series - known) <= _ROUNDING * size).all():
                scaled = series / (unit ** np.arange(degree + 1))[:, None]
                return Varied(name, scaled[0], scaled[1:].ravel())
    raise InputError(
        f"vary = {name!r}: the numbers of the body are not polynomials in it, as with a static "
        "deflection on progressive mounts: create a body for each value"
    )
