"""Laws of elements in the smallest number of coordinates."""

from collections.abc import Sequence
from itertools import combinations_with_replacement
from math import factorial
from typing import Any, NamedTuple

import numpy as np

from viscovib._native import FloatArray
from viscovib.kernels.relaxation import Kernel
from viscovib.systems.elements import CouplingTerms, ElementTerms
from viscovib.systems.laws import Law

#: A direction is linearly dependent if its independent part is below this fraction.
_DEPENDENT = 1e-9

#: Forces: {(equation, powers of the coordinates): coefficient}.
Monomials = dict[tuple[int, tuple[int, ...]], float]


class LawPlace(NamedTuple):
    """A law that is not a polynomial: number of its kernel, from 1 (0: none), and its equations."""

    kernel: int
    #: Matrix from y to its arguments, and from y' to the rates, shape (n_arguments, q).
    reads: FloatArray
    #: Weights of the law in the equations of y.
    targets: dict[int, float]
    law: Law


class Laws(NamedTuple):
    """Elements in few coordinates y = Q^T u: forces of each kernel on each coordinate."""

    #: Q, shape (n, q).
    directions: FloatArray
    #: Kernels (None: no memory), linear stiffness of each, shape (q, q), and monomials.
    kernels: tuple[Kernel | None, ...]
    stiffness: tuple[FloatArray, ...]
    forces: tuple[Monomials, ...]
    #: Laws that are not polynomials.
    programs: tuple[LawPlace, ...] = ()

    def watching(self, direction: FloatArray) -> tuple["Laws", int]:
        """Add a direction to those of the coordinates; also return the index of its coordinate.

        If it depends linearly on them, it replaces one; else it is a new one without forces.
        """
        q = self.directions.shape[1]
        weights = np.linalg.lstsq(self.directions, direction, rcond=None)[0]
        left = np.linalg.norm(direction - self.directions @ weights)
        if left > _DEPENDENT * np.linalg.norm(direction):
            return self._with_one_more(direction), q
        # The coordinate y_j with the largest weight is replaced by the new one.
        j = int(np.abs(weights).argmax())
        turn = np.eye(q)
        turn[j] = -weights / weights[j]
        turn[j, j] = 1 / weights[j]
        chosen = self.directions.copy()
        chosen[:, j] = direction
        return self._turned(turn, chosen), j

    def _turned(self, turn: FloatArray, directions: FloatArray) -> "Laws":
        """The laws in coordinates z, y = turn z: forces turn^T g(turn z)."""
        q = turn.shape[0]
        mixes = [{int(i): float(row[i]) for i in np.flatnonzero(row)} for row in turn]
        forces = []
        for group in self.forces:
            own: Monomials = {}
            for (on, powers), c in group.items():
                factors = [(mixes[b], power) for b, power in enumerate(powers) if power]
                add_force(own, c, mixes[on], factors, q)
            forces.append(own)
        programs = []
        for one in self.programs:
            weights = np.zeros(q)
            weights[list(one.targets)] = list(one.targets.values())
            targets = turn.T @ weights
            programs.append(
                one._replace(
                    reads=one.reads @ turn,
                    targets={int(i): float(targets[i]) for i in np.flatnonzero(targets)},
                )
            )
        stiffness = tuple(turn.T @ k @ turn for k in self.stiffness)
        return Laws(directions, self.kernels, stiffness, tuple(forces), tuple(programs))

    def _with_one_more(self, direction: FloatArray) -> "Laws":
        more = np.concatenate([self.directions, direction[:, np.newaxis]], axis=1)
        wider = tuple(np.pad(k, (0, 1)) for k in self.stiffness)
        forces = tuple(
            {(on, (*powers, 0)): c for (on, powers), c in group.items()} for group in self.forces
        )
        programs = tuple(
            one._replace(reads=np.pad(one.reads, ((0, 0), (0, 1)))) for one in self.programs
        )
        return Laws(more, self.kernels, wider, forces, programs)


def element_laws(
    elements: Sequence[ElementTerms], n: int, couplings: Sequence[CouplingTerms] = ()
) -> Laws:
    """Condense nonlinear and hereditary elements; elastic ones belong to the linear subsystem."""
    # Deflections with laws come first, so that laws are written in few coordinates.
    active = sorted((e for e in elements if e.active), key=_is_linear)
    chosen: list[FloatArray] = []
    weights = [_in_terms_of(chosen, element.direction) for element in active]
    mixes = [[_in_terms_of(chosen, e) for e in coupling.directions] for coupling in couplings]
    if not chosen:
        # Without such elements one coordinate represents the linear response.
        chosen.append(np.eye(1, n)[0])
    q = len(chosen)
    kernels: list[Kernel | None] = []
    stiffness: list[FloatArray] = []
    forces: list[Monomials] = []

    def group_of(kernel: Kernel | None) -> int:
        if kernel not in kernels:
            kernels.append(kernel)
            stiffness.append(np.zeros((q, q)))
            forces.append({})
        return kernels.index(kernel)

    for element, mix in zip(active, weights, strict=True):
        i = group_of(element.kernel)
        column = np.zeros(q)
        column[list(mix)] = list(mix.values())
        # An elastic stiffness without memory is already part of the linear subsystem.
        if element.kernel is not None:
            stiffness[i] += element.powers.get(1, 0.0) * np.outer(column, column)
        for power, c in element.powers.items():
            if power > 1:
                add_force(forces[group_of(element.kernel)], c, mix, [(mix, power)], q)
    for coupling, own in zip(couplings, mixes, strict=True):
        i = group_of(coupling.kernel)
        for (on, powers), c in coupling.forces.items():
            factors = [(own[j], power) for j, power in enumerate(powers) if power]
            add_force(forces[i], c, own[on], factors, q)
    programs = [
        LawPlace(kernel_place(kernels, element.kernel), _rows([mix], q), mix, element.law)
        for element, mix in zip(active, weights, strict=True)
        if element.law is not None
    ]
    programs += [
        LawPlace(kernel_place(kernels, coupling.kernel), _rows(own, q), own[on], law)
        for coupling, own in zip(couplings, mixes, strict=True)
        for on, law in coupling.programs
    ]
    found = tuple(kernels), tuple(stiffness), tuple(forces), tuple(programs)
    return Laws(np.array(chosen).T, *found)


def _is_linear(element: ElementTerms) -> bool:
    return element.law is None and max(element.powers, default=1) < 2


def kernel_place(kernels: Sequence[Kernel | None], kernel: Kernel | None) -> int:
    """Return the index of a kernel among the kernels that are not None, from 1; 0: no kernel."""
    return 0 if kernel is None else [k for k in kernels if k is not None].index(kernel) + 1


def _rows(mixes: Sequence[dict[int, float]], q: int) -> FloatArray:
    """Deflections as linear combinations of y, one row each."""
    rows = np.zeros((len(mixes), q))
    for row, mix in zip(rows, mixes, strict=True):
        row[list(mix)] = list(mix.values())
    return rows


def _in_terms_of(chosen: list[FloatArray], direction: FloatArray) -> dict[int, float]:
    """Weights of the chosen coordinates; an independent direction becomes a new coordinate."""
    if chosen:
        basis = np.array(chosen).T
        weights = np.linalg.lstsq(basis, direction, rcond=None)[0]
        left = np.linalg.norm(direction - basis @ weights)
        if left <= _DEPENDENT * np.linalg.norm(direction):
            largest = np.abs(weights).max()
            return {
                int(i): float(weights[i]) for i in np.flatnonzero(abs(weights) > 1e-12 * largest)
            }
    chosen.append(direction)
    return {len(chosen) - 1: 1.0}


def add_force(forces: Monomials, c: float, on: dict[int, float], factors: Any, q: int) -> None:
    """Add g_a = on_a c prod_j (sum_b w_jb y_b)^p_j, by the multinomial theorem."""
    product: dict[tuple[int, ...], float] = {(0,) * q: c}
    for mix, power in factors:
        grown: dict[tuple[int, ...], float] = {}
        for picks in combinations_with_replacement(mix, power):
            exponents = [0] * q
            for place in picks:
                exponents[place] += 1
            factor = float(factorial(power))
            for place, weight in mix.items():
                factor *= weight ** exponents[place] / factorial(exponents[place])
            for powers, value in product.items():
                key = tuple(a + b for a, b in zip(powers, exponents, strict=True))
                grown[key] = grown.get(key, 0.0) + value * factor
        product = grown
    for place, weight in on.items():
        for powers, value in product.items():
            forces[place, powers] = forces.get((place, powers), 0.0) + weight * value
