"""Parameters of a system that may vary along a branch, by name."""

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.parameters import NEARLY_NOTHING
from viscovib.errors import InputError
from viscovib.systems.laws import expand, spell
from viscovib.systems.mount import Mount
from viscovib.systems.oscillators import Oscillator
from viscovib.systems.polynomial_system import PolynomialSystem

#: Index of each parameter in the vector of a mount.
_ENTRIES = {
    "mass": 1, "inertia": 2, "offset": 3, "stiffness_x": 4, "stiffness_phi": 5, "cubic_scale": 10,
    "memory_scale": 11,
}  # fmt: skip
#: Vector of a polynomial system: length before its matrices, and index of the factor of kernels.
_HEAD, _MEMORY = 5, 4
#: Relative rounding error of a vector that is affine in p.
_ROUNDING = 1e-13
#: Test values avoid whole numbers, which as powers would give a different form.
_BETWEEN = 0.8371
_NAMES = "'memory_scale', 'mass_scale', 'damping_scale', 'stiffness_scale' or 'forces_scale'"


class Varied(NamedTuple):
    """Vector of a system: ``rest + p direction[:n] + p^2 direction[n:2 n] + ...``."""

    name: str
    rest: FloatArray
    direction: FloatArray

    def at(self, p: float) -> FloatArray:
        """Vector of the system at p."""
        x = p or NEARLY_NOTHING
        series = self.direction.reshape(-1, self.rest.size)
        return self.rest + x ** np.arange(1, series.shape[0] + 1) @ series


def varied(system: Oscillator, name: object, start: float, finish: float) -> Varied:
    """Return the numbers that a name varies; both ends of the range must give a valid system."""
    if isinstance(system, Mount):
        key = _native.choice("vary", name, tuple(_ENTRIES))
        for value in (finish, start):
            changes: dict[str, Any] = {key: value}
            replace(system, **changes)
        return _entries(key, system._flat, {_ENTRIES[key] - 1: 1.0})
    assert isinstance(system, PolynomialSystem)
    if isinstance(name, str) and name in system._named_parameters:
        return _of_parameter(system, name, start, finish)
    found = _of_polynomial(system, name)
    for value in (finish, start):
        _native.polynomial_object(found.rest + value * found.direction)
    return found


def _of_parameter(system: PolynomialSystem, name: str, start: float, finish: float) -> Varied:
    """Return the numbers that a parameter of forces varies.

    The stiffness and damping of a law at rest, such as F/w of F tanh(v/w), may not be affine in the
    parameter. Then they keep their initial values, and the difference stays in the law.
    """
    try:
        return affine(name, name, lambda p: system._with_parameters({name: p})._flat, start, finish)
    except InputError as error:

        def numbers(p: float) -> FloatArray:
            return system._with_parameters({name: p})._with_slopes_of(system)._flat

        try:
            return affine(name, name, numbers, start, finish)
        except InputError:
            raise error from None


def affine(
    name: str, key: str, numbers: Callable[[float], FloatArray], start: float, finish: float
) -> Varied:
    """Return the numbers of a system that depend on p, if they are ``rest + p direction``."""
    unit = _BETWEEN * max(abs(start), abs(finish))
    first, second, third = (numbers(unit * i) for i in (1.0, 2.0, 3.0))
    direction = (second - first) / unit if second.size == first.size else first
    if first.size == third.size == second.size:
        left = np.abs(third - first - 2 * unit * direction)
        if (left <= _ROUNDING * np.maximum(np.abs(first), np.abs(third))).all():
            return Varied(name, first - unit * direction, direction)
    raise InputError(f"vary = {name!r}: {key} must occur in the law as a separate number")


def _entries(
    name: str, flat: FloatArray, weights: dict[int, float], staying: dict[int, float] | None = None
) -> Varied:
    """Vary entries of the vector; ``staying``: constant part of an entry."""
    rest, direction = flat.copy(), np.zeros(flat.size)
    for i, weight in weights.items():
        rest[i], direction[i] = (staying or {}).get(i, 0.0), weight
    return Varied(name, rest, direction)


def _of_polynomial(system: PolynomialSystem, name: object) -> Varied:
    form = None
    if isinstance(name, str):
        form = re.fullmatch(
            r"(?:springs\[(\d+)\]\.)?(mass|damping|stiffness|forces|memory)(_scale|\[(.*)\])?",
            name.replace(" ", ""),
        )
    names, n = system.dof_names, len(system.dof_names)
    entry = "'stiffness'" if n == 1 else f"'stiffness[{names[0]},{names[1]}]'"
    force = "'forces[x^3]'" if n == 1 else f"'forces[{names[0]},{names[1]}^3]'"
    if form is None:
        raise InputError(
            f"vary = {_native.shown(name)}: must be {_NAMES}, an entry such as {entry} of "
            f"mass, damping or stiffness, or a coefficient such as {force}; the prefix "
            "'springs[0].' selects those springs"
            + (
                f"; or a parameter of its forces, {', '.join(system._named_parameters)}"
                if system._named_parameters
                else ""
            )
        )
    group = 0 if form[1] is None else int(form[1]) + 1
    what, kind = form[2], form[3] or ""
    if group > len(system.springs) or (group and what not in ("stiffness", "forces")):
        raise InputError(
            f"vary = {name!r}: the system has {len(system.springs)} springs, whose stiffness "
            "and forces may vary"
        )
    flat = system._flat
    if what == "memory":
        if kind != "_scale":
            raise InputError(f"vary = {name!r}: must be 'memory_scale'")
        if not system._active_kernels:
            raise InputError("vary = 'memory_scale': the system has no kernel")
        return _entries(str(name), flat, {_MEMORY: 1.0})
    if kind == "_scale":
        # Vary all groups unless one is named.
        every = range(len(system.groups)) if what in ("stiffness", "forces") else (0,)
        weights: dict[int, float] = {}
        staying: dict[int, float] = {}
        for one in every if form[1] is None else (group,):
            if what == "forces" and system.groups[one].laws:
                raise InputError(
                    f"vary = {name!r}: must not scale laws with functions, only polynomials can "
                    "be scaled"
                )
            places, fixed = _places(system, what, one)
            weights |= {i: float(flat[i]) - fixed.get(i, 0.0) for i in places.values()}
            staying |= fixed
        weights = {i: weight for i, weight in weights.items() if weight}
        if not weights:
            raise InputError(f"vary = {name!r}: all of it is 0")
        return _entries(str(name), flat, weights, staying)
    places, staying = _places(system, what, group)
    given = system.groups[group].given
    if what == "stiffness" and given is not None:
        # The given entry, without the linear part of the forces.
        more = system.groups[group].stiffness - given
        staying = {
            i: float(more[names.index(on), names.index(by)]) for (on, by), i in places.items()
        }
    key = _key(system, str(name), what, form[4])
    if key not in places:
        allowed = ", ".join(f"{on}: {spell(powers, names)}" for on, powers in places)
        raise InputError(f"vary = {name!r}: is not among the forces ({allowed})")
    weights = {places[key]: 1.0}
    mirrored = (key[1], key[0])
    if what != "forces":
        there, here = places[mirrored], places[key]
        if flat[there] - staying.get(there, 0.0) == flat[here] - staying.get(here, 0.0):
            weights[there] = 1.0
    return _entries(str(name), flat, weights, staying)


def _places(
    system: PolynomialSystem, what: str, group: int
) -> tuple[dict[tuple[Any, Any], int], dict[int, float]]:
    """Indices of the entries of a group, and the linear parts of laws in them."""
    if what == "forces":
        return _forces(system, group), {}
    names, n = system.dof_names, len(system.dof_names)
    first = {"mass": _HEAD, "damping": _HEAD + n * n}.get(what, 0)
    first = first or _HEAD + 2 * n * n + n + group * (1 + n * n) + 1
    places = {(names[i], names[j]): first + i + n * j for i in range(n) for j in range(n)}
    added: Any = None
    if what == "stiffness":
        added = system.groups[group].law_slopes
    elif what == "damping":
        added = system._damping - np.asarray(system.damping, dtype=float)
    if added is None:
        return places, {}
    return places, {
        i: float(added[names.index(on), names.index(by)]) for (on, by), i in places.items()
    }


def _forces(system: PolynomialSystem, group: int) -> dict[tuple[Any, Any], int]:
    """Indices of the coefficients of a group, by equation and powers."""
    n = len(system.dof_names)
    first = _HEAD + 2 * n * n + n + len(system.groups) * (1 + n * n)
    first += sum(len(g.forces) for g in system.groups[:group]) * (3 + n)
    return {
        (system.dof_names[on], powers): first + k * (3 + n)
        for k, (on, powers) in enumerate(system.groups[group].forces)
    }


def _key(system: PolynomialSystem, name: str, what: str, inside: str | None) -> tuple[Any, Any]:
    """Equation and coordinate or powers from the text in brackets."""
    names = system.dof_names
    parts = inside.split(",") if inside else []
    if len(names) == 1 and len(parts) == (what == "forces"):
        parts = [names[0], *(parts or names)]
    wanted = "an equation and a monomial" if what == "forces" else "two coordinates"
    if len(parts) != 2:
        raise InputError(f"vary = {name!r}: must have {wanted} in brackets")
    for part in parts[: 1 if what == "forces" else 2]:
        _native.choice(f"vary = {name!r}: coordinate", part, names)
    if what != "forces":
        return parts[0], parts[1]
    terms = expand("vary", parts[1], names)
    if len(terms) != 1 or next(iter(terms.values())) != 1:
        raise InputError(f"vary = {name!r}: {parts[1]} must be one monomial, as x^2*y")
    return parts[0], next(iter(terms))
