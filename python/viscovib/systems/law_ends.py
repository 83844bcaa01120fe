"""Edges of the domains of force laws on the path of a motion."""

from __future__ import annotations

import numpy as np

from viscovib._native import FloatArray
from viscovib.systems.laws import WALL, Law
from viscovib.systems.system import System

#: Sample points as fractions of the path, and number of bisections between two points.
_PARTS = np.concatenate([[0.0], np.logspace(-9, 0, 73)])
_BISECTIONS = 60
#: Largest distance from rest of the search for edges, fractions of it, and edges reported.
_FARTHEST, _MOST_SHOWN = 1e6, 4
_FAR_PARTS = np.concatenate([[0.0], np.logspace(-15, 0, 301)])


def law_end(
    system: System, at: tuple[FloatArray, FloatArray], reach: float
) -> tuple[str, dict[str, float]] | None:
    """Return the text of the law whose domain a motion leaves, and its arguments at the edge.

    Parameters
    ----------
    system
        A polynomial system or a structure; all other systems have no laws.
    at
        Coordinates and velocities, shape (n,); for a structure, deflections and their rates.
    reach : float
        Time by which the motion is extrapolated (s).

    Returns
    -------
    tuple or None
        None: the whole path lies inside the domains of all laws.
    """
    found = []
    for law, arguments, along in system._laws_at(*at):
        part = _end(law, arguments, reach * along)
        if part is not None:
            found.append((part, law, arguments + part * reach * along))
    if not found:
        return None
    _, law, there = min(found, key=lambda one: one[0])
    return law.text, law.read_at(there)


def edges_text(system: System) -> str:
    """Return a text on the edges of the force laws, such as "; the law 'log(1 + x)' ...".

    A search for steady motions that fails at an edge does not locate it. Each argument is varied
    alone, with all other arguments at 0.
    """
    note = []
    for law in system._all_laws:
        if law.state:
            continue
        n = len(law.arguments)
        for place in law.places:
            for side in (-_FARTHEST, _FARTHEST):
                along = np.zeros(n)
                along[place] = side
                part = _end(law, np.zeros(n), along, _FAR_PARTS)
                if part is not None:
                    others = {law.arguments[j]: 0.0 for j in law.places if j != place}
                    reads = {law.arguments[place]: part * side} | others
                    where = ", ".join(f"{name} = {value:.6g}" for name, value in reads.items())
                    note.append(f"; the law {law.text!r} has no value beyond {where}")
    return "".join(note[:_MOST_SHOWN])


def force_at_rest(system: System) -> float:
    """Return the largest force of a law at rest (static preload)."""
    values = (
        float(abs(law(np.zeros((1, len(law.arguments))))[0][0]))
        for law in system._all_laws
        if not law.state
    )
    return max(values, default=0.0)


def _end(law: Law, at: FloatArray, along: FloatArray, parts: FloatArray = _PARTS) -> float | None:
    """Return the first fraction of the path at which a law has no value, to rounding error."""
    if law.state:
        return None
    outside = law(at + parts[:, np.newaxis] * along)[0] == WALL
    if not outside.any():
        return None
    first = int(outside.argmax())
    if first == 0:
        return 0.0
    low, high = parts[first - 1], parts[first]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if law((at + middle * along)[np.newaxis])[0][0] == WALL:
            high = middle
        else:
            low = middle
    return float(high)
