"""Periodic loads as Fourier series, in the form of the core."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray, Handle
from viscovib.errors import InputError

#: What ``load`` may be: P on x; a vector over the coordinates; forces by the names of coordinates;
#: or {order: any of these}. P may be a text a + b*nu^2, such as "0.002*nu^2" for an unbalance.
LoadLike = (
    complex
    | npt.ArrayLike
    | Mapping[str, complex | str]
    | Mapping[int, complex | str | npt.ArrayLike | Mapping[str, complex | str]]
)

_MAX_ORDER = 100_000
#: Code of order k of forces per (k nu)^2 in the form of the core: this minus k.
_SQUARES = -1_000_000
_OPERATORS: dict[type, Any] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul,
    ast.Div: operator.truediv, ast.Pow: operator.pow, ast.UAdd: operator.pos,
    ast.USub: operator.neg,
}  # fmt: skip


@dataclass(frozen=True)
class Job:
    """A system and its load, as arguments of tasks of the core.

    ``given``: values by name for every task: ``orders`` and ``series`` of the load; for a branch
    also ``varies``, the parameter that varies.
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


def oscillator_series(
    system: Any, load: LoadLike | None, base: Any
) -> tuple[npt.NDArray[np.int32], ComplexArray]:
    """Return `load_series` of an oscillator whose base may move each coordinate separately.

    A term of order -1 - k contains, in place of forces, the displacements of the coordinates by the
    base of order k, and a term of order -k - 10^6 forces per (k nu)^2.
    """
    if type(load) is float and base is None:
        return load_series(load, None, len(system.dof_names))
    terms, n = base_by_order(base), len(system.dof_names)
    along = {order: term for order, term in terms.items() if not in_components(term)}
    constant, growing = parts_of(load)
    orders, series = load_series(constant, along or None, n, name_places(system.dof_names))
    further: list[tuple[int, ComplexArray]] = []
    if len(along) < len(terms):
        names: tuple[str, ...] = system._base_names
        apart = {order: term for order, term in terms.items() if in_components(term)}
        moved = _by_order("base", apart, len(names), {name: i for i, name in enumerate(names)})
        system._check_base_motion(np.array([_padded(one, n) for one in moved.values()]).T)
        further = [(-1 - order, vector) for order, vector in moved.items()]
    masses = inertial_series(growing, n, name_places(system.dof_names))
    further += [(_SQUARES - order, vector) for order, vector in masses.items()]
    if not further:
        return orders, series
    more = np.array([_padded(vector, n + 1) for _, vector in further]).T
    codes = np.array([code for code, _ in further])
    return (
        np.concatenate([orders, codes]).astype(np.int32),
        np.asfortranarray(np.hstack([series, more])),
    )


def _padded(vector: ComplexArray, n: int) -> ComplexArray:
    return np.concatenate([vector, np.zeros(n - vector.size)])


def inertial_series(
    growing: Any, n_dof: int, places: Mapping[str, int] | None
) -> dict[int, ComplexArray]:
    """Forces per (k nu)^2 by order k, shape (n_dof,), of the second part of `parts_of`."""
    forces = _by_order("force per nu^2", growing, n_dof, places)
    return {k: vector / k**2 for k, vector in forces.items() if k and vector.any()}


def parts_of(load: Any) -> tuple[Any, Any]:
    """Return a and b of a load a + b nu^2 (b = None: it has no text)."""
    if not _has_text(load):
        return load, None
    return tuple(_each(load, lambda where, text, i=i: _in_nu(where, text)[i], i) for i in (0, 1))


def at_frequency(load: Any, nu: Any) -> Any:
    """Return a load whose texts are numbers at one frequency."""
    if not _has_text(load):
        return load
    square = _native.number("nu", nu) ** 2

    def value(where: str, text: str) -> complex:
        a, b = _in_nu(where, text)
        return a + b * square

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


def _in_nu(where: str, text: str) -> tuple[complex, complex]:
    """Return a and b of a text a + b nu^2."""
    if "nu" not in text:
        raise InputError(
            f"{where} = {_native.shown(text)}: must be numbers, got text (a text must depend "
            "on nu, as '0.002*nu^2')"
        )

    def value(node: Any, nu: float) -> Any:
        if isinstance(node, ast.BinOp):
            return _OPERATORS[type(node.op)](value(node.left, nu), value(node.right, nu))
        if isinstance(node, ast.UnaryOp):
            return _OPERATORS[type(node.op)](value(node.operand, nu))
        if isinstance(node, ast.Name):
            return {"nu": nu, "pi": math.pi}[node.id]
        if isinstance(node, ast.Constant) and isinstance(node.value, int | float | complex):
            # No integer, whose powers may have no end.
            return 1.0 * node.value
        raise ValueError

    try:
        tree = ast.parse(text.strip().replace("^", "**"), mode="eval").body
        a, first, second, third = (complex(value(tree, nu)) for nu in (0.0, 1.0, 2.0, 3.0))
    except (ArithmeticError, KeyError, RecursionError, SyntaxError, TypeError, ValueError):
        a = first = second = third = complex(math.nan)
    b = first - a
    with np.errstate(over="ignore", invalid="ignore"):
        off = np.abs([a + 4 * b - second, a + 9 * b - third]).max()
        fits = off <= 1e-11 * np.abs([a, b]).max()
    if not fits:
        raise InputError(
            f"{where} = {_native.shown(text)}: must be a number, or a text a + b*nu^2 such as "
            "'0.002*nu^2' (an unbalance of 0.002 kg m)"
        )
    return a, b


def base_shifts(
    orders: npt.NDArray[np.int32], series: ComplexArray, direction: FloatArray | None
) -> list[tuple[int, ComplexArray]]:
    """Orders and displacements (n,) of the coordinates by the base, from `load_series`."""
    shifts = []
    for j, order in enumerate(orders.tolist()):
        if order <= _SQUARES:
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
        if k == 0 and name == "force per nu^2" and vector.any():
            raise InputError("load[0]: a mean must not depend on nu")
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
