"""Condensation of polynomial systems whose forces act on few of their coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from viscovib._native import FloatArray
from viscovib.errors import InputError
from viscovib.systems.condensed import Condensation
from viscovib.systems.element_laws import Laws, laws_of_groups
from viscovib.systems.structure_rest import dense_rest

#: Smallest number of coordinates for condensation, if at most half of them have forces or memory.
#: For fewer coordinates the full equations are as fast.
_SMALLEST = 4
#: Smallest number of coordinates for which stability without memory uses the condensed equations,
#: for up to two condensed coordinates and for more of them (equal times measured). With memory the
#: determinant of the full equations takes 10 to 200 times as long, and with kinks of laws the
#: balance of many harmonics 2 to 4 times.
_SMALLEST_CHECKED = 6, 8


def condensed_laws(groups: Sequence[Any], n: int, *, always: bool = False) -> Laws | None:
    """Forces and memory in their coordinates; None: too many coordinates to condense.

    ``groups``: springs with their stiffness (n, n), forces {(on, powers): c}, laws and kernel;
    ``always``: condense for any number of coordinates.
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
    found = laws_of_groups(groups, places)
    # Elastic stiffness belongs to the linear subsystem.
    stiffness = (
        one if kernel is not None else 0 * one
        for kernel, one in zip(found.kernels, found.stiffness, strict=True)
    )
    return found._replace(stiffness=tuple(stiffness))


def checked_condensed(n: int, q: int, remembers: bool) -> bool:
    """True if stability is faster with the q condensed coordinates than with all n."""
    return remembers or n >= _SMALLEST_CHECKED[q > 2]


def condensation_of(
    mass: FloatArray, damping: FloatArray, groups: Sequence[Any], *, quiet: bool,
    always: bool = False,
) -> Condensation | None:  # fmt: skip
    """Return the condensed system, or None if condensation has no advantage or no modes.

    ``quiet``: the warning about springs hidden by rounding errors was already issued. ``always``:
    also condense few coordinates.
    """
    laws = condensed_laws(groups, mass.shape[0], always=always)
    if laws is None:
        return None
    stiffness = np.asarray(sum(group.stiffness for group in groups))
    try:
        return Condensation(dense_rest(mass, damping, stiffness, quiet=quiet), laws)
    except InputError:
        # The modes are defective: the compliance is not a sum over modes.
        return None
