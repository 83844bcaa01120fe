"""Local elements of a structure: springs and dampers along a direction, with laws and memory."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.errors import InputError
from viscovib.expression import MAX_DEGREE, expand
from viscovib.kernels import Kernel

#: What a direction may be: a coordinate, two of them for their difference, weights, or a vector.
On = "str | int | tuple[str, str] | Mapping[str, float] | npt.ArrayLike"


@dataclass(frozen=True, kw_only=True, eq=False)
class Spring:
    """A spring or damper on the deflection d = e . u of a structure: (1 - R*) [k d + f(d)] + c d'.

    Its force acts along the direction in which it reads the deflection, e [...], against it.

    Parameters
    ----------
    on : str, int, tuple of two str, mapping or array_like
        The direction e: a coordinate; two of them, ("x3", "x7"), for the difference u_3 - u_7;
        {name: weight}; or a vector of all weights.
    stiffness : float
        k (N/m), of any sign.
    damping : float
        c (N s/m), viscous, without memory.
    law : str, optional
        f as a polynomial in d, such as "k3*d^3": degree up to 15; what is linear adds to k.
    parameters : mapping of str to float, optional
        Numbers that the law names.
    kernel : Kernel, optional
        Relaxation kernel R of stiffness and law; None: no memory.

    Examples
    --------
    >>> import viscovib as vv
    >>> vv.Spring(on={"x3": 1, "x7": -1}, law="k3*d^3", parameters={"k3": 2.0}).degree
    3
    """

    on: Any
    stiffness: float = 0.0
    damping: float = 0.0
    law: str | None = None
    parameters: Mapping[str, float] | None = None
    kernel: Kernel | None = None

    def __post_init__(self) -> None:
        for name in ("stiffness", "damping"):
            object.__setattr__(self, name, _native.number(name, getattr(self, name)))
        if not (self.kernel is None or isinstance(self.kernel, Kernel)):
            raise InputError(f"kernel = {_native.shown(self.kernel)}: must be a Kernel or None")
        object.__setattr__(self, "_terms", _law_terms(self.law, self.parameters))

    @property
    def degree(self) -> int:
        """Highest power of the deflection in its force."""
        return max(self._powers, default=0)

    @property
    def _powers(self) -> dict[int, float]:
        """Coefficients by power of d, the stiffness among them."""
        terms: dict[int, float] = dict(self._terms)  # type: ignore[attr-defined]
        terms[1] = terms.get(1, 0.0) + self.stiffness
        return {power: c for power, c in sorted(terms.items()) if c != 0}


class ElementTerms(NamedTuple):
    """An element as the condensation takes it: direction e, shape (n,), and coefficients."""

    direction: FloatArray
    powers: dict[int, float]
    damping: float
    kernel: Kernel | None


def element_terms(
    elements: Sequence[Any], names: Sequence[str], places: Mapping[str, int]
) -> tuple[ElementTerms, ...]:
    """Return all elements of a structure with these coordinates."""
    if isinstance(elements, Spring) or not isinstance(elements, (list, tuple)):
        raise InputError(
            f"elements = {_native.shown(elements)}: must be a list of Spring, such as "
            "[Spring(on='x1', law='d^3')]"
        )
    found = []
    for i, element in enumerate(elements):
        if not isinstance(element, Spring):
            raise InputError(f"elements[{i}] = {_native.shown(element)}: must be a Spring")
        e = direction_of(f"elements[{i}].on", element.on, len(names), places)
        found.append(ElementTerms(e, element._powers, element.damping, element.kernel))
    return tuple(found)


def direction_of(where: str, on: Any, n: int, places: Mapping[str, int]) -> FloatArray:
    """Return the weights of all coordinates."""
    e = np.zeros(n)
    if isinstance(on, (str, int, np.integer)) and not isinstance(on, bool):
        e[_place(where, on, n, places)] = 1.0
    elif isinstance(on, Mapping):
        for name, weight in on.items():
            e[_place(where, name, n, places)] += _native.number(f"{where}[{name!r}]", weight)
    elif isinstance(on, (tuple, list)) and on and all(isinstance(one, str) for one in on):
        if len(on) != 2:
            raise InputError(f"{where} = {_native.shown(on)}: must be two names, for a difference")
        e[_place(where, on[0], n, places)] += 1.0
        e[_place(where, on[1], n, places)] -= 1.0
    else:
        e = _native.real_array(where, on).copy()
        if e.shape != (n,):
            raise InputError(f"{where}: must have shape ({n},), got {e.shape}")
    if not e.any():
        raise InputError(f"{where} = {_native.shown(on)}: is no direction, all its weights are 0")
    return e


def _place(where: str, name: Any, n: int, places: Mapping[str, int]) -> int:
    if isinstance(name, str):
        if name in places:
            return places[name]
        some = ", ".join(list(places)[:4]) + (", ..." if n > 4 else "")
        raise InputError(f"{where} = {name!r}: must be one of the {n} coordinates {some}")
    if isinstance(name, (int, np.integer)) and not isinstance(name, bool) and 0 <= name < n:
        return int(name)
    raise InputError(f"{where} = {_native.shown(name)}: must be a coordinate, 0 to {n - 1}")


def _law_terms(law: Any, parameters: Any) -> dict[int, float]:
    """Coefficients of the powers of d in a law."""
    if law is None:
        if parameters:
            raise InputError("parameters: must not be given without a law")
        return {}
    if not isinstance(law, str):
        raise InputError(f"law = {_native.shown(law)}: must be a text such as 'k3*d^3'")
    if parameters is None:
        parameters = {}
    if not isinstance(parameters, Mapping):
        raise InputError(f"parameters = {_native.shown(parameters)}: must be a mapping to numbers")
    values = {}
    for name, value in parameters.items():
        if not isinstance(name, str) or not name.isidentifier() or name == "d":
            raise InputError(f"parameters: {_native.shown(name)} must be a name, other than d")
        values[name] = _native.number(f"parameters[{name!r}]", value)
    names = ("d", *values)
    terms: dict[int, float] = {}
    for powers, c in expand("law", law, names).items():
        factor = c
        for value, power in zip(values.values(), powers[1:], strict=True):
            factor *= value**power
        if not np.isfinite(factor):
            raise InputError(f"law = {_native.shown(law)}: a coefficient is not finite")
        terms[powers[0]] = terms.get(powers[0], 0.0) + factor
    if terms.get(0, 0.0) != 0:
        raise InputError(f"law: has the constant {terms[0]:g}, which belongs to the load")
    terms.pop(0, None)
    if max(terms, default=0) > MAX_DEGREE:
        raise InputError(f"law: has degree {max(terms)}, must be at most {MAX_DEGREE}")
    return terms
