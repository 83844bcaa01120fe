"""Periodic loads as Fourier series, in the form of the core."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray, Handle
from viscovib.errors import InputError

#: What ``load`` may be: P on x; a vector over the coordinates; forces by the names of coordinates;
#: or {order: any of these}.
LoadLike = (
    complex
    | npt.ArrayLike
    | Mapping[str, complex]
    | Mapping[int, complex | npt.ArrayLike | Mapping[str, complex]]
)

_MAX_ORDER = 100_000


@dataclass(frozen=True)
class Job:
    """A system and its load, as tasks of the core take them.

    ``given``: values of every task by name: the load's ``orders`` and ``series``; along a branch
    also what ``varies``.
    """

    system: Handle
    given: Mapping[str, Any]

    @property
    def orders(self) -> npt.NDArray[np.int32]:
        """Orders of the load, shape (m,)."""
        return np.asarray(self.given["orders"])

    @property
    def series(self) -> ComplexArray:
        """Its coefficients, shape (n_dof + 1, m): forces, then the base."""
        return np.asarray(self.given["series"])

    @property
    def n_dof(self) -> int:
        """Coordinates that the core computes."""
        return len(self.given["series"]) - 1

    def along(self, **values: Any) -> Job:
        """Return the same with more values."""
        return Job(self.system, {**self.given, **values})

    def run(self, task: str, **values: Any) -> dict[str, Any]:
        """Run a task of the core."""
        return _native.run(task, self.system, **self.given, **values)

    def run_apart(self, task: str, **values: Any) -> dict[str, Any]:
        """Run a task of pieces that may take long, so that Ctrl-C is heard."""
        return _native.apart(lambda: self.run(task, **values))

    def run_long(self, task: str, **values: Any) -> dict[str, Any]:
        """Run a task of many short pieces, so that Ctrl-C is heard."""
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
        raise InputError("samples: values beyond 1e150 leave the range of numbers")

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

    ``places``: of the coordinates, by name.
    """
    if type(load) is float and base is None and math.isfinite(load):
        # The usual load: order 1 on the first coordinate.
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
    """Places of coordinates by their names."""
    return {name: place for place, name in enumerate(names)}


def one_of(names: Iterable[str]) -> str:
    """Which coordinates may be named, the first of them."""
    known = list(names)
    some = ", ".join(known[:4]) + (", ..." if len(known) > 4 else "")
    return f"must be one of the {len(known)} coordinates {some}"


def base_by_order(base: Any) -> dict[Any, Any]:
    """Motions of a base by their orders; a number, a vector or names are order 1."""
    if base is None:
        return {}
    if not isinstance(base, Mapping) or (base and all(isinstance(one, str) for one in base)):
        return {1: base}
    return dict(base)


def in_components(term: Any) -> bool:
    """Whether a motion of the base is given for each coordinate, and not along a direction."""
    if isinstance(term, Mapping):
        return True
    try:
        return np.ndim(term) > 0
    except ValueError:
        return True


def oscillator_series(
    system: Any, load: LoadLike | None, base: Any
) -> tuple[npt.NDArray[np.int32], ComplexArray]:
    """Return `load_series` of an oscillator, whose base may move each coordinate on its own.

    A term of order -1 - k holds, in place of forces, the displacements of the coordinates by the
    base of order k.
    """
    terms, n = base_by_order(base), len(system.dof_names)
    along = {order: term for order, term in terms.items() if not in_components(term)}
    orders, series = load_series(load, along or None, n, name_places(system.dof_names))
    if len(along) == len(terms):
        return orders, series
    names: tuple[str, ...] = system._base_names
    apart = {order: term for order, term in terms.items() if in_components(term)}
    moved = _by_order("base", apart, len(names), {name: i for i, name in enumerate(names)})
    more = np.zeros((n + 1, len(moved)), dtype=complex)
    for j, vector in enumerate(moved.values()):
        more[: len(names), j] = vector
    system._check_base_motion(more[:-1])
    joined = np.hstack([series, more])
    return (
        np.concatenate([orders, [-1 - order for order in moved]]).astype(np.int32),
        np.asfortranarray(joined),
    )


def base_shifts(
    orders: npt.NDArray[np.int32], series: ComplexArray, direction: FloatArray | None
) -> list[tuple[int, ComplexArray]]:
    """Orders and displacements of the coordinates by the base, shape (n,), of `load_series`."""
    shifts = []
    for j, order in enumerate(orders.tolist()):
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
    """Write a number, for the first coordinate, or a vector."""
    given = _native.complex_array(where, term)
    if given.ndim == 0:
        vector[0] = given
    elif given.shape == vector.shape:
        vector[:] = given
    else:
        raise InputError(
            f"{where}: must be a number or have shape {vector.shape}, got {given.shape}"
        )
