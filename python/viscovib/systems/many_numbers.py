"""Vectors of numbers of polynomial systems with different parameters of their laws, for many runs.

A parameter may change the form of a system: a factor of 0 removes a term, a power of 2 becomes a
square. The core finds the runs of the same form.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from viscovib._native import FloatArray
from viscovib.errors import InputError
from viscovib.systems.laws import _NUMBER, ManyLaws, compile_many, expand
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.spring_groups import Forces, by_equation

#: Number of entries of a flat vector before its matrices, and of a law before its arguments.
_HEAD, _LAW_HEAD = 5, 7


class ManySystems(NamedTuple):
    """Systems of n runs; n = 1: of all runs."""

    #: Vector of each, shape (n, most numbers), and how many numbers of it are used, shape (n,).
    flat: FloatArray
    lengths: npt.NDArray[np.int32]
    #: Stiffness and damping matrices without the linear parts of laws, shape (n, d, d, 2).
    own: FloatArray


class _OneByOneError(Exception):
    """Some law cannot be read for all runs at once."""


class _Places(NamedTuple):
    """Indices of the numbers that may differ in a flat vector without kernels."""

    damping: int
    stiffness: list[int]
    monomials: list[int]
    #: For each law, indices of the numbers on its stack.
    laws: list[list[int]]


def _places(flat: FloatArray) -> _Places:
    n, n_groups, n_monomials = (int(x) for x in flat[:3])
    at = _HEAD + 2 * n * n + n
    stiffness = [at + i * (1 + n * n) + 1 for i in range(n_groups)]
    at += n_groups * (1 + n * n)
    monomials = [at + i * (3 + n) for i in range(n_monomials)]
    at += n_monomials * (3 + n)
    laws = []
    if at < flat.size:
        count, at = int(flat[at]), at + 1
        for _ in range(count):
            m, k, steps = (int(x) for x in flat[at : at + 3])
            at += _LAW_HEAD + 2 * m * n + 2 * k
            codes = flat[at : at + 2 * steps : 2]
            laws.append([at + 2 * int(i) + 1 for i in np.flatnonzero(codes == _NUMBER)])
            at += 2 * steps
    return _Places(_HEAD + n * n, stiffness, monomials, laws)


def joined(systems: Sequence[tuple[FloatArray, FloatArray]]) -> ManySystems:
    """Systems from the vector and the `scaled_parts` of each."""
    lengths = np.array([flat.size for flat, _ in systems], dtype=np.int32)
    flat = np.zeros((len(systems), lengths.max()))
    for row, (numbers, _) in zip(flat, systems, strict=True):
        row[: numbers.size] = numbers
    return ManySystems(flat, lengths, np.stack([own for _, own in systems]))


def scaled_parts(system: PolynomialSystem) -> FloatArray:
    """Stiffness and damping matrices without the linear parts of laws, shape (d, d, 2)."""
    d = len(system.dof_names)
    slopes = [group.law_slopes for group in system.groups if group.law_slopes is not None]
    stiffness = system._stiffness_at_rest - sum(slopes, np.zeros((d, d)))
    return np.stack([stiffness, np.asarray(system.damping)], axis=2)


def systems_of_parameters(
    system: PolynomialSystem, parameters: Mapping[str, FloatArray]
) -> ManySystems:
    """Systems with arrays of values of their parameters."""
    n = next(iter(parameters.values())).size

    def make(i: int) -> PolynomialSystem:
        one = system
        for name, values in parameters.items():
            one = one._with_parameters({name: float(values[i])})
        return one

    try:
        return _together(system, parameters, n, make)
    except _OneByOneError:
        return joined([(one._flat, scaled_parts(one)) for one in map(make, range(n))])


class _ManyGroups(NamedTuple):
    """A group of springs in all runs."""

    stiffness: FloatArray
    slopes: FloatArray
    damping: FloatArray
    #: Coefficients by equation and powers, and a mask of the runs with this term.
    forces: dict[tuple[int, tuple[int, ...]], tuple[FloatArray, npt.NDArray[np.bool_]]]
    laws: list[ManyLaws]


def _together(
    system: PolynomialSystem,
    parameters: Mapping[str, FloatArray],
    n: int,
    make: Callable[[int], PolynomialSystem],
) -> ManySystems:
    values = {name: np.full(n, x) for name, x in (system.parameters or {}).items()}
    values.update(parameters)
    given = [(system.stiffness, system.forces)]
    given += [(one.stiffness, one.forces) for one in system.springs]
    d = len(system.dof_names)
    groups = []
    for stiffness, forces in given:
        matrix = np.zeros((d, d))
        if stiffness is not None:
            plain = np.asarray(stiffness, dtype=float)
            matrix = np.diag(np.atleast_1d(plain)) if plain.ndim < 2 else plain
        groups.append(_group(matrix, forces, system.dof_names, values, n))
    own = np.empty((n, d, d, 2))
    at_rest = sum((g.stiffness for g in groups[1:]), groups[0].stiffness)
    with_laws = [g.slopes for g in groups if g.laws]
    own[..., 0] = at_rest - sum(with_laws, np.zeros((d, d)))
    own[..., 1] = np.asarray(system.damping, dtype=float)
    damping = own[..., 1]
    for group in groups:
        damping = damping + group.damping
    forms = [there for g in groups for _, there in g.forces.values()]
    forms += [column for g in groups for law in g.laws for column in law.form]
    whole, lengths = np.zeros((n, 0)), np.empty(n, dtype=np.int32)
    for runs in _alike(forms, n):
        first_one = make(int(runs[0]))
        flat = np.tile(first_one._flat, (runs.size, 1))
        places = _places(first_one._flat)
        flat[:, places.damping : places.damping + d * d] = _columns(damping[runs])
        for first, group in zip(places.stiffness, groups, strict=True):
            flat[:, first : first + d * d] = _columns(group.stiffness[runs])
        terms = [
            many.forces[key][0]
            for one, many in zip(first_one.groups, groups, strict=True)
            for key in one.forces
        ]
        for place, c in zip(places.monomials, terms, strict=True):
            flat[:, place] = c[runs]
        laws = [law for g in groups for law in g.laws]
        for its, law in zip(places.laws, laws, strict=True):
            flat[:, its] = law.numbers(runs)
        lengths[runs] = flat.shape[1]
        whole = np.pad(whole, ((0, 0), (0, max(0, flat.shape[1] - whole.shape[1]))))
        whole[runs, : flat.shape[1]] = flat
    return ManySystems(whole, lengths, own)


def _columns(matrices: FloatArray) -> FloatArray:
    """Matrices of runs, each stored column by column."""
    return np.asarray(matrices.transpose(0, 2, 1).reshape(matrices.shape[0], -1))


def _alike(columns: list[npt.NDArray[Any]], n: int) -> list[npt.NDArray[np.intp]]:
    """Runs with the same values in all columns."""
    if not columns:
        return [np.arange(n)]
    table = np.stack([np.asarray(column, dtype=float) for column in columns], axis=1)
    if (table == table[0]).all():
        return [np.arange(n)]
    _, which = np.unique(table, axis=0, return_inverse=True)
    return [np.flatnonzero(which == k) for k in range(int(which.max()) + 1)]


def _group(
    stiffness: FloatArray,
    forces: Forces,
    names: tuple[str, ...],
    values: Mapping[str, FloatArray],
    n: int,
) -> _ManyGroups:
    """`spring_group` for all runs, with the terms in the same order."""
    d = len(names)
    total = np.tile(stiffness, (n, 1, 1))
    slopes, damping = np.zeros((2, n, d, d))
    found: dict[tuple[int, tuple[int, ...]], tuple[FloatArray, npt.NDArray[np.bool_]]] = {}
    laws = []

    def read(where: str, text: Any, rates: list[str]) -> Any:
        return _read_many(where, text, names, rates, values, n)

    for _, on, law in by_equation("forces", forces, names, read):
        if isinstance(law, ManyLaws):
            slopes[:, on] += law.slopes[:, :d]
            damping[:, on] += law.slopes[:, d:]
            laws.append(law)
            continue
        for powers, c in law.items():
            if sum(powers) == 1:
                total[:, on, powers.index(1)] += c
            else:
                before, there = found.get((on, powers), (np.zeros(n), np.zeros(n, dtype=bool)))
                found[on, powers] = before + c, there | (c != 0)
    return _ManyGroups(total + slopes, slopes, damping, found, laws)


def _read_many(
    where: str,
    text: Any,
    names: tuple[str, ...],
    rates: list[str],
    values: Mapping[str, FloatArray],
    n: int,
) -> dict[tuple[int, ...], FloatArray] | ManyLaws:
    """`read_law` for all sets of values."""
    if not isinstance(text, str):
        raise _OneByOneError
    try:
        terms = expand(where, text, [*names, *values])
    except InputError:
        laws = compile_many(text, [*names, *rates], values, n)
        if laws is None:
            # Read one by one, so that the first error is reported.
            raise _OneByOneError from None
        return laws
    found: dict[tuple[int, ...], FloatArray] = {}
    for powers, c in terms.items():
        factor = np.full(n, c)
        for one, power in zip(values.values(), powers[len(names) :], strict=True):
            # Powers of Python numbers give the same digits as for one system.
            factor *= np.array([x**power for x in one.tolist()])
        own = powers[: len(names)]
        found[own] = found.get(own, np.zeros(n)) + factor
    if (0,) * len(names) in found or not all(np.isfinite(c).all() for c in found.values()):
        raise _OneByOneError
    return found
