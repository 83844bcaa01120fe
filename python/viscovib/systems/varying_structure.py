"""Parameters of the elements of a structure that may vary along a branch, by name."""

from __future__ import annotations

import re
from copy import copy
from dataclasses import fields, replace
from typing import Any, NamedTuple

import numpy as np

from viscovib import _native
from viscovib.common.counts import things
from viscovib.errors import InputError
from viscovib.systems.contacts import Contact
from viscovib.systems.dampers import RateElement
from viscovib.systems.elements import Coupling, ElementTerms, Spring, _law_terms
from viscovib.systems.friction import Hysteresis
from viscovib.systems.laws import (
    _ARGUMENT,
    _MULTIPLY,
    _NUMBER,
    _ODD,
    Law,
    compile_law,
    function_law,
    named_in,
)
from viscovib.systems.load import LoadLike
from viscovib.systems.own_supports import moves_apart
from viscovib.systems.series_dampers import Maxwell
from viscovib.systems.structure import Structure
from viscovib.systems.varying import Varied, affine

#: Index of the factor of all kernels in the laws of q coordinates.
_MEMORY = 4


class VariedStructure(NamedTuple):
    """The vector of a structure as `Varied`, and a structure with this vector."""

    numbers: Varied
    system: Structure


def varied_structure(
    structure: Structure,
    name: object,
    start: float,
    finish: float,
    load: LoadLike | None,
    base: LoadLike | None,
) -> VariedStructure:
    """Return the numbers of ``elements[0].stiffness``, ``elements[0].k3`` or ``memory_scale``.

    For elements with states and for stops also their parameters, such as ``elements[0].limit``.

    The linear subsystem does not change: the change of a stiffness or a law is an additional law,
    (1 - R*) [f(d; p) - f(d; p_0)]. So no modes are computed along the branch. Modal damping,
    Rayleigh damping and a loss factor refer to the given structure.
    """
    if name == "memory_scale":
        if not structure._active_kernels:
            raise InputError("vary = 'memory_scale': the structure has no kernel")
        loaded = structure._loaded(load, base)
        flat = loaded.job[0]
        direction = np.zeros(flat.size)
        laws = loaded.condensation.law_vector(loaded._base_deflections)
        direction[flat.size - laws.size + _MEMORY] = 1.0
        return VariedStructure(
            Varied("memory_scale", flat - direction * flat, direction), structure
        )
    place, key = _element(structure, name)
    held = structure._held
    if held is not None and moves_apart(structure, base) and held.ends[place].any():
        raise InputError(
            f"vary = {name!r}: elements[{place}] acts on a support, so its forces by a motion of "
            "each support would vary too: must act on free coordinates, or give base_direction"
        )
    if not isinstance(structure.elements[place], Spring):
        for end in (finish, start):
            ends: dict[str, Any] = {key: end}
            replace(structure.elements[place], **ends)

    def at(value: float) -> Structure:
        return _variant(structure, str(name), place, key, value)

    numbers = affine(
        str(name), key, lambda p: np.asarray(at(p)._loaded(load, base).job[0]), start, finish
    )
    return VariedStructure(numbers, at(max(abs(start), abs(finish))))


def _element(structure: Structure, name: object) -> tuple[int, str]:
    form = None
    if isinstance(name, str):
        form = re.fullmatch(r"elements\[(\d+)\]\.(\w+)", name.replace(" ", ""))
    if form is None:
        raise InputError(
            f"vary = {_native.shown(name)}: must be 'memory_scale', or a number of an element such "
            "as 'elements[0].stiffness' or 'elements[0].k3', k3 being one of its parameters; other "
            "numbers of a structure change all its modes"
        )
    place, key = int(form[1]), form[2]
    if place >= len(structure.elements):
        raise InputError(f"vary = {name!r}: the structure has "
                         f"{things(len(structure.elements), 'element')}")  # fmt: skip
    element = structure.elements[place]
    if isinstance(element, Spring):
        own = named_in(element.parameters or (), element.law)
        allowed: tuple[str, ...] = ("stiffness", *own)
    else:
        allowed = _numbers_of(element)
    if not allowed:
        raise InputError(
            f"vary = {name!r}: elements[{place}] is a {type(element).__name__}, of which no number "
            "may vary"
        )
    if key not in allowed:
        raise InputError(f"vary = {name!r}: must be one of {', '.join(allowed)} of this element")
    return place, key


def _numbers_of(element: object) -> tuple[str, ...]:
    """Parameters of an element that is not a spring; a rigid stop has no steady motion."""
    if isinstance(element, Maxwell):
        # The stiffness is part of the matrices; no number of the law is linear in the exponent.
        return ("coefficient",) if element.exponent != 1 else ()
    rigid = isinstance(element, Contact) and element.stiffness is None
    if rigid or not isinstance(element, (Contact, Hysteresis, RateElement)):
        return ()
    # A linear damper is part of the linear subsystem.
    if isinstance(element, RateElement) and element._law is None:
        return ()
    values = {one.name: getattr(element, one.name) for one in fields(element)}  # type: ignore[arg-type]
    return tuple(key for key, value in values.items() if isinstance(value, float))


def _other_law(terms: list[ElementTerms], at: int, element: Any, key: str, value: float) -> None:
    """Change a parameter of an element without changing the linear subsystem."""
    own, other = terms[at], copy(element)
    # Both ends of the range were checked; other values are not checked.
    object.__setattr__(other, key, value)
    if isinstance(element, Contact):
        apart = element._law.stiffness_at_rest
        terms[at] = own._replace(law=other._law.without([*apart, 0.0]))
        return
    if isinstance(element, (RateElement, Maxwell)):
        for cached in ("_whole", "_damping", "_law"):
            other.__dict__.pop(cached, None)
        terms[at] = own._replace(law=other._whole.without([own.powers.get(1, 0.0), own.damping]))
        return
    terms[at] = own._replace(law=other._law)
    # The core subtracts the new stiffness at rest; the linear subsystem contains the old one.
    terms.append(_linear(own, other._stiffness_at_rest - element._stiffness_at_rest))


def _linear(own: ElementTerms, stiffness: float) -> ElementTerms:
    """A stiffness parallel to an element, as a law."""
    code = (_ARGUMENT, _NUMBER, _MULTIPLY)
    law = Law("k*d", ("d",), code, (1.0, stiffness, 0.0), _ODD, 1)
    return ElementTerms(own.direction, {}, 0.0, own.kernel, law)


def _program(where: str, law: Any, parameters: dict[str, float]) -> Law:
    """Return a law as a program, also if it is a polynomial."""
    if not isinstance(law, str):
        law = function_law(where, law, ("d",), parameters, ("v",))
    return law if isinstance(law, Law) else compile_law(where, law, ("d", "v"), parameters, 1)


def _variant(structure: Structure, name: str, place: int, key: str, value: float) -> Structure:
    """Return the structure with a new value and an unchanged linear subsystem."""
    spring: Any = structure._prepared[place]  # type: ignore[attr-defined]
    terms = list(structure._all_elements)
    # A coupling has several terms.
    at = sum(len(e.on) if isinstance(e, Coupling) else 1 for e in structure.elements[:place])
    own = terms[at]
    if not isinstance(spring, Spring):
        _other_law(terms, at, spring, key, value)
    elif key == "stiffness":
        terms.append(_linear(own, value - spring.stiffness))
    else:
        before: dict[str, float] = dict(spring.parameters or {})
        remembers = spring.kernel is not None
        powers, program, _ = _law_terms(spring.law, {**before, key: value}, remembers)
        old = _law_terms(spring.law, before, remembers)[0]
        if program is None and powers.get(1, 0.0) == old.get(1, 0.0):
            linear = {1: own.powers[1]} if 1 in own.powers else {}
            higher = {power: c for power, c in powers.items() if power > 1}
            terms[at] = own._replace(powers=linear | higher)
        else:
            where, given = f"vary = {name!r}", {**before, key: value}
            law = _program(where, spring.law, given).less(_program(where, spring.law, before))
            terms.append(ElementTerms(own.direction, {}, 0.0, own.kernel, law))
    result = copy(structure)
    # Modes and a reduction do not change.
    result.__dict__["_rest"] = structure._rest
    for cached in ("_condensation", "_free", "_active_kernels", "_all_laws"):
        result.__dict__.pop(cached, None)
    result._set("_elements", tuple(terms))
    return result
