"""Local elements of a structure: springs and dampers along a direction, with laws and memory."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.values import own_fields
from viscovib.errors import InputError
from viscovib.kernels.relaxation import Kernel, check_kernel
from viscovib.systems.contacts import Contact
from viscovib.systems.dampers import RateElement
from viscovib.systems.friction import Hysteresis
from viscovib.systems.laws import MAX_DEGREE, Law, parameter_values, read_law
from viscovib.systems.load import one_of
from viscovib.systems.python_law import PythonLaw, callable_law, python_law, python_laws
from viscovib.systems.series_dampers import Maxwell

#: Types of a direction: a coordinate, two coordinates (their difference), weights, or a vector.
On = "str | int | tuple[str, str] | Mapping[str, float] | npt.ArrayLike"


@dataclass(frozen=True, kw_only=True, eq=False)
class Spring:
    """A spring or damper on the deflection d = e . u: (1 - R*) [k d + f(d, v)] + c v, v = d'.

    Its force acts along e [...], opposite to the deflection.

    Parameters
    ----------
    on : str, int, tuple of two str, mapping or array_like
        The direction e: a coordinate; two coordinates, ("x3", "x7"), for the difference u_3 - u_7;
        {name: weight}; or a vector of all weights.
    stiffness : float
        k (N/m), positive or negative.
    damping : float
        c (N s/m), viscous, without memory.
    law : str or callable, optional
        f of the deflection d and its rate v: a polynomial such as "k3*d^3" (degree up to 15) or a
        text with functions, such as "c*v*abs(v)", "F0*tanh(v/0.01)", "k*max(d - gap, 0)" or
        "where(d > 0, k1*d, k2*d)". Functions: sin, cos, tan, asin, acos, atan, atan2, sinh, cosh,
        tanh, asinh, acosh, atanh, exp, log, sqrt, abs, sign, heaviside, pow, min, max, where,
        comparisons and pi. The linear part at rest is added to k and c (with a kernel c v stays in
        the law). A value at rest, as in ``d^3 + 0.3``, is a static preload. Alternatively a
        function of d, v and parameters: `PythonLaw`.
    parameters : mapping of str to float, optional
        Numbers in the law.
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
    law: str | PythonLaw | Callable[..., Any] | None = None
    parameters: Mapping[str, float] | None = None
    kernel: Kernel | None = None

    def __post_init__(self) -> None:
        own_fields(self)
        for name in ("stiffness", "damping"):
            object.__setattr__(self, name, _native.number(name, getattr(self, name)))
        check_kernel("kernel", self.kernel)
        object.__setattr__(self, "law", python_law(self.law))
        terms, program, damping = _law_terms(self.law, self.parameters, self.kernel is not None)
        object.__setattr__(self, "_law_damping", damping)
        object.__setattr__(self, "_terms", terms)
        object.__setattr__(self, "_program", program)

    @property
    def degree(self) -> int:
        """Highest power of the deflection in its force; 0 if it is not a polynomial."""
        if self._program is not None:  # type: ignore[attr-defined]
            return 0
        return max(self._powers, default=0)

    @property
    def _powers(self) -> dict[int, float]:
        """Coefficients by power of d, including the stiffness."""
        terms: dict[int, float] = dict(self._terms)  # type: ignore[attr-defined]
        terms[1] = terms.get(1, 0.0) + self.stiffness
        return {power: c for power, c in sorted(terms.items()) if c != 0}


@dataclass(frozen=True, kw_only=True, eq=False)
class Coupling:
    """Forces between several deflections of a structure: g_a = (1 - R*) f_a(d_1, d_2, ...).

    Each force acts along the direction of its deflection d_a = e_a . u, opposite to it, and may
    depend on all deflections: springs in series with large rotations, follower forces, forces
    between different points.

    Parameters
    ----------
    on : mapping of str to direction
        Deflections by their names in the law; directions as for `Spring`.
    law : mapping of str to str
        f_a by deflection: polynomials of degree 2 to 15 or texts with functions as for `Spring`;
        a_dot is the rate of the deflection a. A deflection without a force is an argument only.
        Linear parts belong to the stiffness of the structure.
    parameters : mapping of str to float, optional
        Numbers in the law.
    kernel : Kernel, optional
        Relaxation kernel R of these forces.

    Examples
    --------
    >>> import viscovib as vv
    >>> bent = vv.Coupling(on={"a": "x3", "b": ("x3", "x7")},
    ...                    law={"a": "k*a*b^2", "b": "k*a^2*b"}, parameters={"k": 0.5})
    >>> sorted(bent.on)
    ['a', 'b']
    """

    on: Mapping[str, Any]
    law: Mapping[str, str | PythonLaw | Callable[..., Any]]
    parameters: Mapping[str, float] | None = None
    kernel: Kernel | None = None

    def __post_init__(self) -> None:
        own_fields(self)
        if (
            not isinstance(self.on, Mapping)
            or not self.on
            or not all(isinstance(name, str) for name in self.on)
        ):
            raise InputError(
                f"on = {_native.shown(self.on)}: must be a mapping of names to directions, such as "
                "{'a': 'x3'}"
            )
        check_kernel("kernel", self.kernel)
        taken = tuple(self.on)
        values = parameter_values(self.parameters, (*taken, *(f"{one}_dot" for one in taken)))
        if not isinstance(self.law, Mapping) or not self.law:
            raise InputError(f"law = {_native.shown(self.law)}: must be a mapping to texts")
        object.__setattr__(self, "law", python_laws(self.law))
        names = tuple(self.on)
        forces: dict[tuple[int, tuple[int, ...]], float] = {}
        programs: list[tuple[int, Law]] = []
        for name, text in self.law.items():
            where = f"law[{name!r}]"
            if name not in names:
                raise InputError(f"{where}: must be one of the deflections {', '.join(names)}")
            if not isinstance(text, str) and not callable_law(text):
                raise InputError(f"{where} = {_native.shown(text)}: must be a text or a function")
            found = read_law(where, text, names, values, [f"{one}_dot" for one in names])
            if isinstance(found, Law):
                if found.slopes_at_rest.any():
                    raise InputError(
                        f"{where} = {found.text!r}: must have no linear part at rest (the "
                        "linear part belongs to the stiffness of the structure)"
                    )
                programs.append((names.index(name), found))
                continue
            for powers, c in found.items():
                if not 2 <= sum(powers) <= MAX_DEGREE:
                    raise InputError(
                        f"{where}: has a term of degree {sum(powers)}, must be 2 to "
                        f"{MAX_DEGREE} (the linear part belongs to the stiffness of the "
                        "structure)"
                    )
                forces[names.index(name), powers] = c
        object.__setattr__(self, "_forces", forces)
        object.__setattr__(self, "_programs", tuple(programs))


class CouplingTerms(NamedTuple):
    """A coupling for the condensation: directions, and forces by equation and powers."""

    directions: tuple[FloatArray, ...]
    forces: dict[tuple[int, tuple[int, ...]], float]
    kernel: Kernel | None
    #: Laws that are not polynomials, with the index of the deflection on which each acts.
    programs: tuple[tuple[int, Law], ...] = ()


class Series(NamedTuple):
    """A Maxwell element in terms of its internal coordinate s: its force is k (s' + r s)."""

    #: Direction of the deflection, shape (n,).
    direction: FloatArray
    stiffness: float
    rate: float


class ElementTerms(NamedTuple):
    """An element for the condensation: direction e, shape (n,), and coefficients."""

    direction: FloatArray
    powers: dict[int, float]
    damping: float
    kernel: Kernel | None
    #: A law that is not a polynomial, without its linear part.
    law: Law | None = None
    #: Of a Maxwell element, whose direction is that of its internal coordinate.
    series: Series | None = None

    @property
    def active(self) -> bool:
        """True if the element is nonlinear or has memory."""
        bent = self.law is not None or max(self.powers, default=1) > 1
        return self.kernel is not None or bent

    @property
    def remembered_damping(self) -> float:
        """Derivative of the law with respect to the rate at rest; 0 without a kernel."""
        if self.kernel is None or self.law is None or not self.law.n_rates:
            return 0.0
        return float(self.law.damping_at_rest()[0])


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
        if isinstance(element, Coupling):
            # Only the directions of a coupling matter here: deflections of the structure.
            coupled = coupling_terms([element], names, places, i)[0]
            found += [ElementTerms(e, {}, 0.0, None) for e in coupled.directions]
            continue
        if isinstance(element, Hysteresis):
            e = direction_of(f"elements[{i}].on", element.on, len(names), places)
            powers = {1: element._stiffness_at_rest}
            found.append(ElementTerms(e, powers, 0.0, None, element._law))
            continue
        if isinstance(element, Contact):
            e = direction_of(f"elements[{i}].on", element.on, len(names), places)
            law = element._law
            if law.state:
                found.append(ElementTerms(e, {}, 0.0, None, law))
                continue
            slope = float(law.stiffness_at_rest[0])
            powers = {1: slope} if slope else {}
            found.append(ElementTerms(e, powers, 0.0, None, law.remainder()))
            continue
        if isinstance(element, RateElement):
            e = direction_of(f"elements[{i}].on", element.on, len(names), places)
            found.append(ElementTerms(e, {}, element._damping, None, element._law))
            continue
        if isinstance(element, Maxwell):
            e = direction_of(f"elements[{i}].on", element.on, len(names), places)
            own = np.zeros(len(names))
            own[places[element._inner]] = 1.0
            whole, series = element._whole, Series(e, element.stiffness, element._rate)
            damping = element._linear_damping
            slopes = (damping * element._rate, damping)
            bent = whole.without(slopes) if element.exponent != 1 else None
            found.append(ElementTerms(own, {1: slopes[0]}, damping, None, bent, series))
            continue
        if not isinstance(element, Spring):
            raise InputError(
                f"elements[{i}] = {_native.shown(element)}: must be a Spring, a FluidDamper, a "
                "Maxwell, a StribeckFriction, a Coupling, a Jenkins, an Iwan, a BoucWen, a Dahl, "
                "a Gap, a Stop or one of user_elements()"
            )
        e = direction_of(f"elements[{i}].on", element.on, len(names), places)
        program = element._program  # type: ignore[attr-defined]
        damping = element.damping + element._law_damping  # type: ignore[attr-defined]
        found.append(ElementTerms(e, element._powers, damping, element.kernel, program))
    return tuple(found)


def element_vector(elements: Sequence[ElementTerms], n: int) -> FloatArray:
    """Return elements of n coordinates and their kernels as numbers for the core."""
    kernels = list(dict.fromkeys(one.kernel for one in elements if one.kernel is not None))
    parts: list[Any] = [[n, len(elements), len(kernels)]]
    for one in elements:
        powers = [one.powers.get(power, 0.0) for power in range(2, MAX_DEGREE + 1)]
        series = (one.series.stiffness, one.series.rate) if one.series is not None else (0.0, 0.0)
        place = 0 if one.kernel is None else kernels.index(one.kernel) + 1
        parts += [
            [place, one.powers.get(1, 0.0), one.damping, *series, *powers], one.direction,
            one.direction if one.series is None else one.series.direction,
            [int(one.law is not None)],
        ]  # fmt: skip
        if one.law is not None:
            parts.append(one.law.numbers(np.ones((1, 1)), {0: 1.0}, 0))
    for kernel in kernels:
        parts += [[kernel._kind, kernel._data.size], kernel._data]
    return np.concatenate([np.asarray(part, dtype=float) for part in parts])


def terms_in_order(
    elements: Sequence[Any], names: Sequence[str], places: Mapping[str, int]
) -> tuple["ElementTerms | CouplingTerms", ...]:
    """Return one entry for each element."""
    return tuple(
        (coupling_terms if isinstance(one, Coupling) else element_terms)([one], names, places)[0]
        for one in elements
    )


def coupling_terms(
    elements: Sequence[Any], names: Sequence[str], places: Mapping[str, int], first: int = 0
) -> tuple[CouplingTerms, ...]:
    """Return the couplings among elements."""
    found = []
    for i, element in enumerate(elements, first):
        if isinstance(element, Coupling):
            directions = tuple(
                direction_of(f"elements[{i}].on[{name!r}]", on, len(names), places)
                for name, on in element.on.items()
            )
            forces: dict[tuple[int, tuple[int, ...]], float] = element._forces  # type: ignore[attr-defined]
            programs: tuple[tuple[int, Law], ...] = element._programs  # type: ignore[attr-defined]
            found.append(CouplingTerms(directions, forces, element.kernel, programs))
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
        raise InputError(
            f"{where} = {_native.shown(on)}: is not a direction: all its weights are 0"
        )
    return e


def _place(where: str, name: Any, n: int, places: Mapping[str, int]) -> int:
    if isinstance(name, str):
        if name in places:
            return places[name]
        raise InputError(f"{where} = {name!r}: {one_of(places)}")
    if isinstance(name, (int, np.integer)) and not isinstance(name, bool) and 0 <= name < n:
        return int(name)
    raise InputError(f"{where} = {_native.shown(name)}: must be a coordinate, 0 to {n - 1}")


def _law_terms(
    law: Any, parameters: Any, remembers: bool
) -> tuple[dict[int, float], Law | None, float]:
    """Coefficients of the powers of d in a law.

    Also the remainder of a law that is not a polynomial in d, and its part of the damping.
    """
    if law is None:
        if parameters is not None and not (isinstance(parameters, Mapping) and not parameters):
            raise InputError("parameters: must not be given without a law")
        return {}, None, 0.0
    if not isinstance(law, str) and not callable_law(law):
        raise InputError(
            f"law = {_native.shown(law)}: must be a text such as 'k3*d^3', or a function"
        )
    values = parameter_values(parameters, ("d", "v"))
    found = read_law("law", law, ("d",), values, ("v",), preloaded=True)
    if isinstance(found, Law):
        slope = float(found.stiffness_at_rest[0])
        damping = float(found.damping_at_rest(remembers=remembers)[0])
        return ({1: slope} if slope else {}), found.remainder(remembers=remembers), damping
    terms = {power: c for (power,), c in found.items()}
    terms.pop(0, None)
    if max(terms, default=0) > MAX_DEGREE:
        raise InputError(f"law: has degree {max(terms)}, must be at most {MAX_DEGREE}")
    return terms, None, 0.0
