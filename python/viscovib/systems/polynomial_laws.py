"""Polynomial systems whose forces act in few of their coordinates, condensed to these."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from viscovib._native import FloatArray
from viscovib.errors import InputError
from viscovib.systems.condensed import Condensation
from viscovib.systems.element_laws import LawPlace, Laws, kernel_place
from viscovib.systems.structure_rest import dense_rest

#: Coordinates from which on a system is condensed, if half of them or fewer have forces or memory:
#: below, the whole equations take no longer.
_SMALLEST = 4
#: Coordinates from which on stability without memory is judged by the condensed equations: this
#: many, and so many more for each coordinate left (measured with 1 to 4 of them); below, monodromy
#: matrices take less time, and give all multipliers. With memory the determinant of the whole takes
#: 10 to 200 times as long.
_SMALLEST_JUDGED, _JUDGED_EACH = 8, 3


#: How many times as fast as the springs dampers are where steps in time follow modes, as in the
#: core.
_MUCH_FASTER = 50.0


def condensed_laws(groups: Sequence[Any], n: int, *, always: bool = False) -> Laws | None:
    """Forces and memory in the coordinates that have them; None: in too many to condense.

    ``groups``: springs with their stiffness (n, n), forces {(on, powers): c}, laws and kernel;
    ``always``: however many they are.
    """
    touched = np.zeros(n, dtype=bool)
    for group in groups:
        for on, powers in group.forces:
            touched[on] = True
            touched[np.flatnonzero(powers)] = True
        for on, law in group.laws:
            touched[[on, *(place % n for place in law.places)]] = True
        if group.kernel is not None:
            touched |= group.stiffness.any(axis=0) | group.stiffness.any(axis=1)
    places = np.flatnonzero(touched)
    few = n >= _SMALLEST and 2 * places.size <= n
    if not places.size or not (few or always):
        return None
    kernels, stiffness, forces, programs = [], [], [], []
    index = {int(place): i for i, place in enumerate(places)}
    for group in groups:
        own = group.stiffness[np.ix_(places, places)]
        # What is elastic belongs to the rest.
        kernels.append(group.kernel)
        stiffness.append(own if group.kernel is not None else np.zeros_like(own))
        forces.append(
            {
                (index[on], tuple(powers[place] for place in places)): c
                for (on, powers), c in group.forces.items()
            }
        )
        reads = np.eye(n)[:, places]
        for on, law in group.laws:
            place = kernel_place(kernels, group.kernel)
            programs.append(LawPlace(place, reads, {index[on]: 1.0}, law))
    found = tuple(kernels), tuple(stiffness), tuple(forces), tuple(programs)
    return Laws(np.eye(n)[:, places], *found)


def judged_condensed(n: int, q: int, remembers: bool) -> bool:
    """Whether the stability of n coordinates condensed to q takes less time condensed."""
    return remembers or n >= max(_SMALLEST_JUDGED, _JUDGED_EACH * q + 2)


def condensation_of(
    mass: FloatArray, damping: FloatArray, groups: Sequence[Any], *, quiet: bool,
    always: bool = False,
) -> Condensation | None:  # fmt: skip
    """Return the condensed system, or None where that has no use or no modes.

    ``quiet``: the warning about springs hidden by rounding errors was printed. ``always``: also of
    few coordinates.
    """
    laws = condensed_laws(groups, mass.shape[0], always=always)
    if laws is None:
        return None
    stiffness = np.asarray(sum(group.stiffness for group in groups))
    try:
        return Condensation(dense_rest(mass, damping, stiffness, quiet=quiet), laws)
    except InputError:
        # Defective modes: no sum over modes gives the compliance.
        return None


def strong_damping(mass: FloatArray, damping: FloatArray, stiffness: FloatArray) -> float:
    """The rate of what decays (1/s) where dampers are much faster than springs, else 0."""
    inverse = np.linalg.inv(mass)
    drag = float(np.abs(inverse @ damping).sum(axis=1).max())
    springs = math.sqrt(np.abs(inverse @ stiffness).sum(axis=1).max())
    return drag if drag > _MUCH_FASTER * springs else 0.0
