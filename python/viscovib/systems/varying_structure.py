"""Numbers of a structure's elements that may vary along a branch, by name."""

from __future__ import annotations

import re
from copy import copy
from typing import Any, NamedTuple

import numpy as np

from viscovib import _native
from viscovib.errors import InputError
from viscovib.systems.elements import Coupling, ElementTerms, Spring, _law_terms
from viscovib.systems.laws import _ARGUMENT, _MULTIPLY, _NUMBER, _ODD, Law, called_law, compile_law
from viscovib.systems.load import LoadLike
from viscovib.systems.structure import Structure
from viscovib.systems.varying import Varied, affine

#: Where the factor of all kernels stands in the laws of q coordinates.
_MEMORY = 4


class VariedStructure(NamedTuple):
    """The numbers of a structure as `Varied`, and a structure whose numbers they are."""

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
    """Which numbers ``elements[0].stiffness``, ``elements[0].k3`` or ``memory_scale`` means.

    The linear rest stays as it is: what a stiffness or a law differs by is a law of its own,
    (1 - R*) [f(d; p) - f(d; p_0)]. So no modes are computed along the branch, and modal damping,
    Rayleigh's and a loss factor are those of the structure as it was given.
    """
    if name == "memory_scale":
        if not structure._active_kernels:
            raise InputError("vary = 'memory_scale': the structure has no kernel")
        loaded = structure._loaded(load, base)
        flat = loaded.job[0]
        direction = np.zeros(flat.size)
        laws = loaded.condensation.law_vector(loaded._base_deflections)
        direction[flat.size - sum(np.size(part) for part in laws) + _MEMORY] = 1.0
        return VariedStructure(
            Varied("memory_scale", flat - direction * flat, direction), structure
        )
    place, key = _element(structure, name)

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
        raise InputError(f"vary = {name!r}: the structure has {len(structure.elements)} elements")
    element = structure.elements[place]
    if not isinstance(element, Spring):
        raise InputError(
            f"vary = {name!r}: must be of a Spring, elements[{place}] is a {type(element).__name__}"
        )
    allowed = ("stiffness", *(element.parameters or ()))
    if key not in allowed:
        raise InputError(f"vary = {name!r}: must be one of {', '.join(allowed)} of this element")
    return place, key


def _program(where: str, law: Any, parameters: dict[str, float]) -> Law:
    """Return a law as a program, one that is a polynomial too."""
    if isinstance(law, str):
        return compile_law(where, law, ("d", "v"), parameters, 1)
    return called_law(where, law, ("d",), parameters, ("v",))


def _variant(structure: Structure, name: str, place: int, key: str, value: float) -> Structure:
    """Return the structure with another value, its linear rest as before."""
    spring = structure.elements[place]
    terms = list(structure._all_elements)
    # A coupling stands for several.
    at = sum(len(e.on) if isinstance(e, Coupling) else 1 for e in structure.elements[:place])
    own = terms[at]
    if key == "stiffness":
        code = (_ARGUMENT, _NUMBER, _MULTIPLY)
        law = Law("k*d", ("d",), code, (1.0, value - spring.stiffness, 0.0), _ODD, 1)
        terms.append(ElementTerms(own.direction, {}, 0.0, own.kernel, law))
    else:
        before = dict(spring.parameters)
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
    # Its modes stay, and so does a reduction.
    result.__dict__["_rest"] = structure._rest
    for cached in ("_condensation", "_free", "_active_kernels"):
        result.__dict__.pop(cached, None)
    result._set("_elements", tuple(terms))
    return result
