"""Periodic loads as Fourier series, in the form of the core."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import wraps
from typing import Any, TypeVar
from weakref import ref

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray, Handle
from viscovib.errors import InputError
from viscovib.systems.frequency_formulas import MOST_FORMULAS, ONE, joined, terms_of, values_of

#: What ``load`` may be: P on x; a vector over the coordinates; forces by the names of coordinates;
#: or {order: any of these}. P may be a formula in nu, such as "0.002*nu^2" for an unbalance.
LoadLike = (
    complex
    | npt.ArrayLike
    | Mapping[str, complex | str]
    | Mapping[int, complex | str | npt.ArrayLike | Mapping[str, complex | str]]
)

_MAX_ORDER = 100_000
#: Code of order k of forces multiplied by formula i, from 1, in the form of the core: i times this
#: minus k.
FORMULA_CODE = -1_000_000


#: Number of recent loads of a system whose form for the core is kept; largest array of a load.
_MOST_KNOWN, _LONGEST_KNOWN = 8, 4096
_PLAIN = frozenset({float, int, complex, str, bool, type(None)})

_Found = TypeVar("_Found")


class _Recent(dict[Any, Any]):
    """Results for recent loads of a system, which its pickles do not contain.

    A copy of the system has the same object, but does not use it: it may differ.
    """

    def __init__(self, system: Any = None) -> None:
        super().__init__()
        self.owner = None if system is None else ref(system)

    def __reduce__(self) -> tuple[Any, ...]:
        return _Recent, ()


def for_recent_loads(find: Callable[..., _Found]) -> Callable[..., _Found]:
    """Keep the results of ``find(system, load, base, ...)`` for the last loads of each system.

    Systems do not change. Reading the load of a structure takes longer than its linear response.
    """

    @wraps(find)
    def found(system: Any, load: Any, base: Any, *more: Any) -> _Found:
        try:
            key = find.__qualname__, _key_of(load), _key_of(base), *map(_key_of, more)
        except TypeError:
            return find(system, load, base, *more)
        known = system.__dict__.get("_recent_loads")
        if known is None or known.owner is None or known.owner() is not system:
            known = system.__dict__["_recent_loads"] = _Recent(system)
        result: _Found | None = known.get(key)
        if result is None:
            result = find(system, load, base, *more)
            if len(known) >= _MOST_KNOWN:
                known.clear()
            known[key] = result
        return result

    return found


def _key_of(load: Any, depth: int = 2) -> Any:
    """A key that only equal loads of the same types have; a TypeError for all other loads."""
    kind = type(load)
    if kind in _PLAIN:
        return kind, load
    if kind is dict and depth:
        return tuple((key, type(key), _key_of(one, depth - 1)) for key, one in load.items())
    if kind is np.ndarray and load.dtype.kind in "iufc" and load.size <= _LONGEST_KNOWN:
        return load.dtype.str, load.shape, load.tobytes()
    if kind in (list, tuple) and len(load) <= _LONGEST_KNOWN:
        kinds = tuple(map(type, load))
        if _PLAIN.issuperset(kinds):
            return kind, kinds, tuple(load)
    raise TypeError


@dataclass(frozen=True)
class Job:
    """A system and its load, as arguments of tasks of the core.

    ``given``: values by name for every task: ``orders``, ``series`` and ``formulas`` of the load;
    for a branch also ``varies``, the parameter that varies.
    """

    system: Handle
    given: Mapping[str, Any]

    @property
    def orders(self) -> npt.NDArray[np.int32]:
        """Harmonic orders of the load, shape (m,)."""
        return np.asarray(self.given["orders"])

    @property
    def series(self) -> ComplexArray:
        """Coefficients of the load, shape (n_dof + 1, m): forces, then the base."""
        return np.asarray(self.given["series"])

    @property
    def n_dof(self) -> int:
        """Number of coordinates that the core computes."""
        return len(self.given["series"]) - 1

    def along(self, **values: Any) -> Job:
        """Return the same with more values."""
        return Job(self.system, {**self.given, **values})

    def run(self, task: str, **values: Any) -> dict[str, Any]:
        """Run a task of the core."""
        return _native.run(task, self.system, **self.given, **values)

    def run_apart(self, task: str, **values: Any) -> dict[str, Any]:
        """Run a task with long parts in a thread, so that Ctrl-C works."""
        return _native.apart(lambda: self.run(task, **values))

    def run_long(self, task: str, **values: Any) -> dict[str, Any]:
        """Run a task of many short parts, so that Ctrl-C works."""
        return _native.interruptible(lambda: self.run(task, **values))


def fourier_coefficients(samples: npt.ArrayLike, orders: int) -> dict[int, complex]:
    """Return the Fourier series of equidistant samples of one period, for ``load`` or ``base``.

    Parameters
    ----------
    samples : array_like, shape (n,)
        Values at t = 0, T/n, 2T/n, ...; n > 2 * orders.
    orders : int
        Highest harmonic.

    Returns
    -------
    dict
        {k: P_k} with f(t) = Im sum_k P_k exp(i k nu t); the mean is the imaginary part of P_0.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> t = np.arange(64) / 64
    >>> series = vv.fourier_coefficients(0.1 * np.sin(2 * np.pi * t), orders=3)
    >>> round(abs(series[1]), 12)
    0.1
    """
    values = _native.real_array("samples", samples, ndim=1)
    highest = _native.integer("orders", orders, 0, _MAX_ORDER)
    if values.size <= 2 * highest:
        raise InputError(
            f"samples: {values.size} values, must be more than {2 * highest} for order {highest}"
        )
    if float(np.abs(values).max()) > 1e150:
        raise InputError("samples: values beyond 1e150 exceed the range of numbers")

    def transform() -> ComplexArray:
        found: ComplexArray = _native.run("spectrum transform", signal=values)["spectrum"]
        return found

    whole = _native.apart(transform) if values.size > _native.MANY_SAMPLES else transform()
    spectrum = whole[: highest + 1] / values.size
    series = {0: 1j * spectrum[0].real}
    series.update({k: 2j * spectrum[k] for k in range(1, highest + 1)})
    return {order: complex(value) for order, value in series.items()}


def load_series(
    load: LoadLike | None, base: Any, n_dof: int, places: Mapping[str, int] | None = None
) -> tuple[npt.NDArray[np.int32], ComplexArray]:
    """Return orders, shape (m,), and coefficients, shape (n_dof + 1, m): forces, then base.

    ``places``: indices of the coordinates by name.
    """
    if type(load) is float and base is None and math.isfinite(load):
        # The usual load: harmonic 1 on the first coordinate.
        series = np.zeros((n_dof + 1, 1), dtype=complex, order="F")
        series[0, 0] = load
        return np.array([1], dtype=np.int32), series
    forces = _by_order("load", load, n_dof, places)
    motions = _by_order("base", base, 1)
    orders = sorted(set(forces) | set(motions))
    series = np.zeros((n_dof + 1, max(len(orders), 1)), dtype=complex, order="F")
    for j, order in enumerate(orders):
        series[:n_dof, j] = forces.get(order, 0.0)
        series[n_dof:, j] = motions.get(order, 0.0)
    return np.array(orders or [1], dtype=np.int32), series


def name_places(names: Sequence[str]) -> dict[str, int]:
    """Indices of coordinates by name."""
    return {name: place for place, name in enumerate(names)}


def one_of(names: Iterable[str]) -> str:
    """Part of a message: the allowed coordinates, the first four by name."""
    known = list(names)
    some = ", ".join(known[:4]) + (", ..." if len(known) > 4 else "")
    return f"must be one of the {len(known)} coordinates {some}"


def base_by_order(base: Any) -> dict[Any, Any]:
    """Motions of a base by harmonic order; a number, a vector or names mean order 1."""
    if base is None:
        return {}
    if not isinstance(base, Mapping) or (base and all(isinstance(one, str) for one in base)):
        return {1: base}
    return dict(base)


def in_components(term: Any) -> bool:
    """True if a base motion is given for each coordinate instead of along a direction."""
    if isinstance(term, Mapping):
        return True
    try:
        return np.ndim(term) > 0
    except ValueError:
        return True


@for_recent_loads
def oscillator_series(
    system: Any, load: LoadLike | None, base: Any
) -> tuple[npt.NDArray[np.int32], ComplexArray, str]:
    """Return `load_series` of an oscillator, and the formulas of its load in the form of the core.

    A term of order -1 - k contains, in place of forces, the displacements of the coordinates by the
    base of order k, and a term of order -k - 10^6 i forces that formula i multiplies.
    """
    terms, n = base_by_order(base), len(system.dof_names)
    along = {order: term for order, term in terms.items() if not in_components(term)}
    constant, varying = parts_of(load, n, name_places(system.dof_names))
    orders, series = load_series(constant, along or None, n, name_places(system.dof_names))
    further: list[tuple[int, ComplexArray]] = []
    if len(along) < len(terms):
        names: tuple[str, ...] = system._base_names
        apart = {order: term for order, term in terms.items() if in_components(term)}
        moved = _by_order("base", apart, len(names), {name: i for i, name in enumerate(names)})
        system._check_base_motion(np.array([_padded(one, n) for one in moved.values()]).T)
        further = [(-1 - order, vector) for order, vector in moved.items()]
    formulas = list(dict.fromkeys(one.formula for one in varying))
    codes = {formula: (i + 1) * FORMULA_CODE for i, formula in enumerate(formulas)}
    further += [(codes[one.formula] - one.order, one.force) for one in varying]
    if not further:
        return orders, series, ""
    more = np.array([_padded(vector, n + 1) for _, vector in further]).T
    return (
        np.concatenate([orders, [code for code, _ in further]]).astype(np.int32),
        np.asfortranarray(np.hstack([series, more])),
        joined(formulas),
    )


def _padded(vector: ComplexArray, n: int) -> ComplexArray:
    return np.concatenate([vector, np.zeros(n - vector.size)])


@dataclass(frozen=True)
class VaryingForce:
    """Forces of one harmonic order, shape (n_dof,), multiplied by a real formula in nu."""

    formula: str
    order: int
    force: ComplexArray


def parts_of(
    load: Any, n_dof: int, places: Mapping[str, int] | None
) -> tuple[Any, list[VaryingForce]]:
    """Return the constant part of a load, and the forces that depend on nu."""
    if not _has_text(load):
        return load, []
    if isinstance(load, Mapping) and _has_text(load.get(0)):
        raise InputError("load[0]: a mean must not depend on nu")
    known: dict[tuple[str, str], dict[str, complex]] = {}

    def coefficient(where: str, text: str, formula: str = ONE) -> complex:
        if (where, text) not in known:
            known[where, text] = terms_of(where, text)
        return known[where, text].get(formula, 0.0)

    constant = _each(load, coefficient, 0)
    formulas = list(dict.fromkeys(one for terms in known.values() for one in terms if one != ONE))
    if len(formulas) > MOST_FORMULAS:
        raise InputError(f"load: {len(formulas)} formulas, must be at most {MOST_FORMULAS}")
    varying = []
    for formula in formulas:
        own = _each(load, lambda where, text, f=formula: coefficient(where, text, f), 1)
        for order, force in _by_order("load", own, n_dof, places).items():
            if force.any():
                varying.append(VaryingForce(formula, order, force))
    return constant, varying


def at_frequency(load: Any, nu: Any) -> Any:
    """Return a load whose texts are numbers at one frequency."""
    if not _has_text(load):
        return load
    at = _native.number("nu", nu)

    def value(where: str, text: str) -> complex:
        terms = terms_of(where, text)
        try:
            values = values_of(list(terms), at)[0]
        except InputError as error:
            raise InputError(f"{where}{str(error).removeprefix('load')}") from None
        return complex(np.dot(list(terms.values()), values))

    return _each(load, value, 0)


def _has_text(load: Any) -> bool:
    if isinstance(load, Mapping):
        return any(map(_has_text, load.values()))
    return isinstance(load, str) or (
        isinstance(load, list | tuple) and any(isinstance(one, str) for one in load)
    )


def _each(load: Any, value: Any, constant: int, where: str = "load") -> Any:
    """The same with values for texts; ``constant`` = 1: with 0 for all that are none."""
    if isinstance(load, str):
        return value(where, load)
    if isinstance(load, Mapping):
        return {k: _each(one, value, constant, f"{where}[{k!r}]") for k, one in load.items()}
    if isinstance(load, list | tuple) and any(isinstance(one, str) for one in load):
        return [_each(one, value, constant, f"{where}[{i}]") for i, one in enumerate(load)]
    return 0 * np.asarray(load) if constant else load


def harmonics_of(orders: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """Return the harmonic orders of forces from the codes of `oscillator_series`."""
    return np.where(orders <= FORMULA_CODE, -orders % -FORMULA_CODE, orders)


def base_shifts(
    orders: npt.NDArray[np.int32], series: ComplexArray, direction: FloatArray | None
) -> list[tuple[int, ComplexArray]]:
    """Orders and displacements (n,) of the coordinates by the base, from `load_series`."""
    shifts = []
    for j, order in enumerate(orders.tolist()):
        if order <= FORMULA_CODE:
            continue
        if order < 0:
            shifts.append((-1 - order, series[:-1, j]))
        elif direction is not None and series[-1, j]:
            shifts.append((order, direction * series[-1, j]))
    return shifts


def _by_order(
    name: str, value: Any, n_dof: int, places: Mapping[str, int] | None = None
) -> dict[int, ComplexArray]:
    if value is None:
        return {}
    alone = not isinstance(value, Mapping) or (value and all(isinstance(one, str) for one in value))
    if alone:
        value = {1: value}
    series = {}
    for order, term in value.items():
        k = _native.integer(f"{name} order", order, 0, _MAX_ORDER)
        where = name if alone else f"{name}[{k}]"
        vector = np.zeros(n_dof, dtype=complex)
        if _has_text(term):
            raise InputError(
                f"{where}: depends on nu, which is not a constant here: must be numbers"
            )
        if isinstance(term, Mapping) and places is not None:
            for key, force in term.items():
                if key not in places:
                    raise InputError(f"{where}: {_native.shown(key)} {one_of(places)}")
                vector[places[key]] += _native.complex_array(f"{where}[{key!r}]", force, ndim=0)
        else:
            _fill(vector, where, term)
        if k == 0 and vector.real.any():
            raise InputError(
                f"{name}[0] has a real part: the mean is the imaginary part "
                f"({name} = Im sum P_k exp(i k nu t)), write it as 1j * mean"
            )
        series[k] = vector
    return series


def _fill(vector: ComplexArray, where: str, term: Any) -> None:
    """Store a number (for the first coordinate) or a vector."""
    given = _native.complex_array(where, term)
    if given.ndim == 0:
        vector[0] = given
    elif given.shape == vector.shape:
        vector[:] = given
    else:
        raise InputError(
            f"{where}: must be a number or have shape {vector.shape}, got {given.shape}"
        )
