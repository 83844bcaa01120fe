"""Where a force law ends: the edge of its domain, or a pole, on the way of a motion."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from viscovib._native import FloatArray
from viscovib.systems.laws import Law
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.sticking import laws_of
from viscovib.systems.structure import Structure

#: What the core gives where a law has no value.
_WALL = 1e60
#: Places of the way that are looked at, as parts of it, and bisections between two of them.
_PARTS = np.concatenate([[0.0], np.logspace(-9, 0, 73)])
_BISECTIONS = 60
#: How far from rest edges are looked for, parts of that way, and of how many is told.
_FARTHEST, _MOST_TOLD = 1e6, 4
_FAR_PARTS = np.concatenate([[0.0], np.logspace(-15, 0, 301)])
#: Parts of a way on which a pole is looked for, and by how much a law must grow beside it.
_GRID, _FINE_GRID = np.linspace(0.0, 1.0, 41), np.linspace(0.0, 1.0, 401)
_GROWTH = 1e6


def law_end(
    system: object, at: tuple[FloatArray, FloatArray], reach: float
) -> tuple[str, dict[str, float]] | None:
    """Return the text of the law whose domain a motion leaves, and what it reads there.

    Parameters
    ----------
    system
        Of others than polynomial systems and structures no law is known.
    at
        Coordinates and velocities, shape (n,), of a structure deflections and their rates.
    reach : float
        How far the motion may go on (s).

    Returns
    -------
    tuple or None
        None: every law has values on the way.
    """
    found = []
    for law, arguments, along in _laws(system, *at):
        part = _end(law, arguments, reach * along)
        if part is not None:
            found.append((part, law, arguments + part * reach * along))
    if not found:
        return None
    _, law, there = min(found, key=lambda one: one[0])
    return law.text, _read(law, there)


def law_pole(
    system: object, at: tuple[FloatArray, FloatArray], times: FloatArray, reach: float
) -> tuple[str, dict[str, float], float] | None:
    """Return the text of a law that grows without bound on the way, what it reads there, and when.

    Parameters
    ----------
    system
        As of ``law_end``.
    at
        As of ``law_end``, of each state, shape (m, n).
    times : ndarray, shape (m,)
        When the states are (s).
    reach : float
        How far the motion goes on after each (s).

    Returns
    -------
    tuple or None
        None: no law has a pole near. Poles are found where a law is read by one displacement that
        moves straight on; the time is that of this motion.
    """
    for q, v, t in zip(*at, times, strict=True):
        found = []
        for law, arguments, along in _laws(system, q, v):
            part = None if law.state else _pole(law, arguments, reach * along)
            if part is not None:
                found.append((part, law, arguments + part * reach * along))
        if found:
            part, law, there = min(found, key=lambda one: one[0])
            return law.text, _read(law, there), float(t + part * reach)
    return None


def pole_between(
    system: object, at: tuple[FloatArray, FloatArray], times: FloatArray
) -> tuple[str, dict[str, float], float] | None:
    """Return the same of the first pole that states, as of ``law_pole``, are on both sides of."""
    first = None
    q, v = at
    for law, arguments, rates in _arguments(system, q, v):
        if law.state or len(law.places) != 1:
            continue
        place = law.places[0]
        series, along = arguments[:, place], np.zeros(arguments.shape[1])
        begin = arguments[0].copy()
        begin[place], along[place] = series.min(), np.ptp(series)
        part = _pole(law, begin, along, _FINE_GRID)
        if part is None:
            continue
        there = begin + part * along
        passed = np.flatnonzero(np.diff(np.sign(series - there[place])))
        if passed.size and (first is None or times[passed[0]] < first[2]):
            i = int(passed[0])
            speed, ahead = rates[i, place], there[place] - series[i]
            later = float(ahead / speed) if ahead * speed > 0 else np.inf
            when = float(times[i]) + min(later, float(times[i + 1] - times[i]))
            first = law.text, _read(law, there), when
    return first


def told_pole(text: str, reads: dict[str, float], when: float) -> str:
    """A sentence about a pole."""
    where = ", ".join(f"{name} = {value:.6g}" for name, value in reads.items())
    return (
        f"the law '{text}' has a pole at {where}, where the motion comes about t = {when:.6g}: no "
        "steps follow it there (take a law that stays bounded, or end the run before by an event)"
    )


def may_have_poles(system: object) -> bool:
    """Whether the text of a law divides or turns by a tangent."""
    laws: list[Law] = []
    if isinstance(system, PolynomialSystem):
        laws = [law for group in system.groups for _, law in group.laws]
    elif isinstance(system, Structure):
        laws = [place.law for place in system._condensation.laws.programs]
    return any("/" in law.text or "tan(" in law.text for law in laws)


def told_edges(system: object) -> str:
    """Say where the force laws of a system end, if any does: "; the law 'log(1 + x)' ...".

    Steady motions that come there are lost with their place. Each argument is tried alone, the
    others at rest.
    """
    told = []
    for law in laws_of(system):
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
                    told.append(f"; the law {law.text!r} has no value beyond {where}")
    return "".join(told[:_MOST_TOLD])


def _read(law: Law, there: FloatArray) -> dict[str, float]:
    """What a law reads at a place, its rates left out."""
    n_positions = len(law.arguments) - law.n_rates
    read = [place for place in law.places if place < n_positions] or [0]
    return {law.arguments[place]: float(there[place]) for place in read}


def _pole(law: Law, at: FloatArray, along: FloatArray, grid: FloatArray = _GRID) -> float | None:
    """Return the first part of a way at which a law grows without bound, to rounding."""

    def value(parts: FloatArray) -> FloatArray:
        found = np.asarray(law(at + np.atleast_1d(parts)[:, np.newaxis] * along)[0])
        return np.clip(np.where(np.isfinite(found), found, np.inf), -1e300, 1e300)

    f = value(grid)
    if (np.abs(f) >= _WALL).all():
        return None
    for i in range(grid.size - 1):
        low, high = grid[max(i - 1, 0)], grid[min(i + 2, grid.size - 1)]
        around = max(abs(f[max(i - 1, 0)]), abs(f[min(i + 2, grid.size - 1)]), 1e-300)
        changes = f[i] * f[i + 1] < 0
        peaks = i > 0 and abs(f[i]) > abs(f[i - 1]) and abs(f[i]) >= abs(f[i + 1])
        if not (changes or peaks) or around >= _WALL:
            continue
        if changes:
            low, high = grid[i], grid[i + 1]
        # A pole is enclosed by what is larger than all around it, however near one comes.
        for _ in range(12):
            inner = np.linspace(low, high, 33)
            g = value(inner)
            k = int(np.abs(g).argmax())
            place, top = float(inner[k]), float(np.abs(g[k]))
            low, high = inner[max(k - 1, 0)], inner[min(k + 1, 32)]
        if top >= _GROWTH * around:
            return place
    return None


def _arguments(
    system: object, q: FloatArray, v: FloatArray
) -> Iterator[tuple[Law, FloatArray, FloatArray]]:
    """Yield each law with its arguments at states and their rates, shapes (m, n_arguments)."""
    nothing = np.zeros_like(v)
    if isinstance(system, PolynomialSystem):
        for group in system.groups:
            for _, law in group.laws:
                n = len(law.arguments)
                yield law, np.hstack([q, v])[:, :n], np.hstack([v, nothing])[:, :n]
    elif isinstance(system, Structure):
        for place in system._condensation.laws.programs:
            n, (d, rate) = len(place.law.arguments), (x @ place.reads.T for x in (q, v))
            along = np.hstack([rate, np.zeros_like(rate)])
            yield place.law, np.hstack([d, rate])[:, :n], along[:, :n]


def _laws(
    system: object, q: FloatArray, v: FloatArray
) -> Iterator[tuple[Law, FloatArray, FloatArray]]:
    """Yield each law with its arguments and how they change."""
    nothing = np.zeros(v.size)
    if isinstance(system, PolynomialSystem):
        for group in system.groups:
            for _, law in group.laws:
                n = len(law.arguments)
                yield law, np.concatenate([q, v])[:n], np.concatenate([v, nothing])[:n]
    elif isinstance(system, Structure):
        for place in system._condensation.laws.programs:
            d, rate = place.reads @ q, place.reads @ v
            n = len(place.law.arguments)
            yield (
                place.law,
                np.concatenate([d, rate])[:n],
                np.concatenate([rate, np.zeros(rate.size)])[:n],
            )


def _end(law: Law, at: FloatArray, along: FloatArray, parts: FloatArray = _PARTS) -> float | None:
    """Return the first part of the way at which a law has no value, to rounding."""
    if law.state:
        return None
    outside = law(at + parts[:, np.newaxis] * along)[0] == _WALL
    if not outside.any():
        return None
    first = int(outside.argmax())
    if first == 0:
        return 0.0
    low, high = parts[first - 1], parts[first]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if law((at + middle * along)[np.newaxis])[0][0] == _WALL:
            high = middle
        else:
            low = middle
    return float(high)
