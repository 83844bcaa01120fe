"""Laws of elements in the smallest number of coordinates."""

from collections.abc import Mapping, Sequence
from itertools import combinations_with_replacement
from math import comb, factorial, inf, prod
from typing import Any, NamedTuple

import numpy as np

from viscovib._native import FloatArray
from viscovib.kernels.relaxation import Kernel
from viscovib.systems.elements import CouplingTerms, ElementTerms
from viscovib.systems.laws import Law, compile_law, spell

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

    def vector(
        self, mass: FloatArray, damping: FloatArray, direction: FloatArray, more: Sequence[Any] = ()
    ) -> FloatArray:
        """Return a polynomial system with these laws as numbers for the core.

        ``mass``, ``damping``: shape (q, q); ``direction``: motion of the coordinates with the base,
        shape (q,). ``more``: further matrices of the system.
        """
        kernels = different(self.kernels)
        springs: list[Any] = []
        monomials: list[Any] = []
        for kernel, stiffness, forces in zip(
            self.kernels, self.stiffness, self.forces, strict=True
        ):
            place = 0 if kernel is None else kernels.index(kernel) + 1
            springs += [[place], stiffness.ravel(order="F")]
            monomials += [[c, on + 1, place, *powers] for (on, powers), c in forces.items()]
        laws = [one.law.numbers(one.reads, one.targets, one.kernel) for one in self.programs]
        parts: list[Any] = [
            [mass.shape[0], len(self.kernels), len(monomials), len(kernels), 1.0],
            mass.ravel(order="F"), damping.ravel(order="F"), direction, *springs, *monomials,
        ]  # fmt: skip
        for kernel in kernels:
            parts += [[kernel._kind, kernel._data.size], kernel._data]
        if laws or more:
            parts += [[len(laws)], *laws]
        parts += [matrix.ravel(order="F") for matrix in more]
        return np.concatenate([np.asarray(part, dtype=float) for part in parts])

    def forces_at(self, at: FloatArray, rates: FloatArray) -> list[FloatArray]:
        """Nonlinear forces of each kernel on the coordinates, shape (q, m), before relaxation.

        ``at``, ``rates``: coordinates and their rates, shape (q, m).
        """
        found = [np.zeros_like(at) for _ in self.kernels]
        for force, group in zip(found, self.forces, strict=True):
            for (on, powers), c in group.items():
                used = [i for i, power in enumerate(powers) if power]
                force[on] += c * prod(at[i] ** powers[i] for i in used)
        kernels = [None, *different(self.kernels)]
        for one in self.programs:
            both = np.concatenate([one.reads @ at, one.reads @ rates])[: len(one.law.arguments)]
            values = one.law.values(np.asfortranarray(both.T))
            for on, weight in one.targets.items():
                found[self.kernels.index(kernels[one.kernel])][on] += weight * values
        return found

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
    return laws_along(np.array(chosen).T, active, weights, couplings, mixes)


def laws_along(
    directions: FloatArray,
    elements: Sequence[ElementTerms],
    weights: Sequence[dict[int, float]],
    couplings: Sequence[CouplingTerms] = (),
    mixes: Sequence[Sequence[dict[int, float]]] = (),
    matrices: Sequence[tuple[FloatArray, Kernel | None]] = (),
    *,
    most: float = inf,
) -> Laws:
    """Return the laws of elements in few coordinates.

    ``weights``: the deflection of each element, {coordinate: weight}; ``mixes``: those of each
    coupling. ``matrices``: further stiffness, shape (q, q), with kernels. ``most``: a power of
    deflections that becomes more monomials remains a law of the deflections.
    """
    q = directions.shape[1]
    kernels: list[Kernel | None] = []
    stiffness: list[FloatArray] = []
    forces: list[Monomials] = []
    programs: list[LawPlace] = []

    def group_of(kernel: Kernel | None) -> int:
        if kernel not in kernels:
            kernels.append(kernel)
            stiffness.append(np.zeros((q, q)))
            forces.append({})
        return kernels.index(kernel)

    def put(kernel: Kernel | None, on: dict[int, float], own: Any, terms: Any, laws: Any) -> None:
        group = group_of(kernel)
        kept: dict[tuple[int, ...], float] = {}
        for powers, c in terms.items():
            factors = [(own[j], power) for j, power in enumerate(powers) if power]
            if n_products(on, factors) > most:
                kept[powers] = c
            else:
                add_force(forces[group], c, on, factors, q)
        if kept:
            laws = [_power_law(kept, len(own)), *laws]
        place = kernel_place(kernels, kernel)
        programs.extend(LawPlace(place, _rows(own, q), on, law) for law in laws)

    for matrix, kernel in matrices:
        stiffness[group_of(kernel)] += matrix
    for element, mix in zip(elements, weights, strict=True):
        if not element.powers and element.law is None:
            continue
        # An elastic stiffness without memory is already part of the linear subsystem.
        if element.kernel is not None:
            column = _rows([mix], q)[0]
            k = element.powers.get(1, 0.0)
            stiffness[group_of(element.kernel)] += k * np.outer(column, column)
        terms: Any = {(power,): c for power, c in element.powers.items() if power > 1}
        put(element.kernel, mix, [mix], terms, [] if element.law is None else [element.law])
    for coupling, own in zip(couplings, mixes, strict=True):
        for on, mix in enumerate(own):
            terms = {powers: c for (at, powers), c in coupling.forces.items() if at == on}
            laws = [law for at, law in coupling.programs if at == on]
            put(coupling.kernel, mix, own, terms, laws)
    return Laws(directions, tuple(kernels), tuple(stiffness), tuple(forces), tuple(programs))


def laws_of_groups(groups: Sequence[Any], places: Any = None) -> Laws:
    """Return the forces of groups of springs, all of which act on some coordinates, ``places``."""
    kernels = tuple(group.kernel for group in groups)
    stiffness = tuple(group.stiffness for group in groups)
    forces: tuple[Monomials, ...] = tuple(group.forces for group in groups)
    directions = np.zeros((stiffness[0].shape[0], 0))
    index: Any = range(stiffness[0].shape[0])
    if places is not None or any(group.laws for group in groups):
        directions = np.eye(stiffness[0].shape[0])
    if places is not None:
        directions = directions[:, places]
        index = {int(place): i for i, place in enumerate(places)}
        stiffness = tuple(one[np.ix_(places, places)] for one in stiffness)
        forces = tuple(
            {
                (index[on], tuple(powers[place] for place in places)): c
                for (on, powers), c in one.items()
            }
            for one in forces
        )
    programs = tuple(
        LawPlace(kernel_place(kernels, group.kernel), directions, {index[on]: 1.0}, law)
        for group in groups
        for on, law in group.laws
    )
    return Laws(directions, kernels, stiffness, forces, programs)


def n_products(on: Mapping[int, float], factors: list[tuple[dict[int, float], int]]) -> int:
    """Number of monomials of a product of powers of linear combinations."""
    return len(on) * prod(comb(len(mix) + power - 1, power) for mix, power in factors)


def _power_law(terms: Mapping[tuple[int, ...], float], n: int) -> Law:
    """Return a polynomial in n deflections, {powers: coefficient}, as a program."""
    names = [f"d{j}" for j in range(n)]
    texts = [f"{float(c)!r}*{spell(powers, names)}" for powers, c in terms.items()]
    return compile_law("law", " + ".join(f"({text})" for text in texts), names, {})


def _is_linear(element: ElementTerms) -> bool:
    return element.law is None and max(element.powers, default=1) < 2


def different(kernels: Sequence[Kernel | None]) -> list[Kernel]:
    """Return the kernels that are not None, each once."""
    found: list[Kernel] = []
    for kernel in kernels:
        if kernel is not None and kernel not in found:
            found.append(kernel)
    return found


def kernel_place(kernels: Sequence[Kernel | None], kernel: Kernel | None) -> int:
    """Return the index of a kernel among the kernels that are not None, from 1; 0: no kernel."""
    return 0 if kernel is None else different(kernels).index(kernel) + 1


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
