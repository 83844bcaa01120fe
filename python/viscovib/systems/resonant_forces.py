"""Forces of elements near resonances of the linear subsystem, with modal amplitudes as unknowns.

Near a resonance the few modes with a nearly vanishing dynamic stiffness dominate the compliance H.
Their size costs digits of all other modes, and of the small difference between the load and the
forces on these modes. With their amplitudes a as additional unknowns,

    y = free + H' g + seen^T a,   apart a = modes + seen g,

no digits are lost; H' is the compliance of the other modes, ``free`` their motion under the load.
"""

from typing import Any

import numpy as np

from viscovib._native import ComplexArray
from viscovib.systems.resting_forces import products, solved

#: A mode is near a resonance if its dynamic stiffness is at most this part of its stiffness. This
#: limits the loss of accuracy of the other modes.
_NEARBY = 1e-2
#: Motions treated together, with few modes near resonances.
_TOGETHER = 64


def compliance(
    c: Any, s: ComplexArray, t: ComplexArray, w: ComplexArray, modes: Any
) -> ComplexArray:
    """H at each s from some of the modes, shape (n, q, q).

    ``c``: a `Condensation`; t and w: 1/(squares + rates s + s^2) and 1/(s - poles).
    """
    h = products(t[:, modes], c.seen[modes], c.seen[modes])
    h = h + products(w, c.left, c.right)
    h = h + c.laws.directions.T @ c.flexible
    return np.asarray(h + s[:, np.newaxis, np.newaxis] * (c.laws.directions.T @ c.flexible_rate))


def with_modes(
    h: ComplexArray, seen: Any, apart: ComplexArray, moved: ComplexArray, modes: ComplexArray
) -> tuple[ComplexArray, ComplexArray]:
    """Forces g and amplitudes a, shapes (n, q) and (n, m); ``h``: H', ``moved``: y - free."""
    q = moved.shape[1]
    found = solved(_bordered(h, seen, apart), np.concatenate([moved, modes], axis=1))
    return found[:, :q], found[:, q:]


def _bordered(h: ComplexArray, seen: Any, apart: ComplexArray) -> ComplexArray:
    (n, q), m = h.shape[:2], seen.shape[0]
    whole = np.zeros((n, q + m, q + m), dtype=complex)
    whole[:, :q, :q] = h
    whole[:, :q, q:] = seen.T
    whole[:, q:, :q] = -seen
    whole[:, np.arange(q, q + m), np.arange(q, q + m)] = apart
    return whole


def refine(
    c: Any,
    s: ComplexArray,
    fractions: tuple[ComplexArray, ComplexArray, ComplexArray],
    loads: tuple[ComplexArray, ComplexArray, ComplexArray],
    y: ComplexArray,
    of_laws: Any,
    found: tuple[ComplexArray, ComplexArray],
) -> None:
    """Forces g and amplitudes of real modes, ``found``, of the modes near a resonance.

    ``fractions``: squares + rates s + s^2, and t and w as in `compliance`; ``loads``: on real
    modes, on complex modes, and the motion of the static part; ``of_laws``: mask of forces from the
    laws, which are replaced only where the amplitudes become more accurate.
    """
    apart, t, w = fractions
    modes, poles, rigid = loads
    g, amplitudes = found
    near = np.abs(apart) < _NEARBY * np.abs(c.rest.squares)
    rows = np.flatnonzero(near.any(axis=1))
    rows = rows[np.argsort(np.abs(s[rows]), kind="stable")]
    for first in range(0, rows.size, _TOGETHER):
        part = rows[first : first + _TOGETHER]
        loud = np.flatnonzero(near[part].any(axis=0))
        quiet = np.delete(np.arange(c.rest.squares.size), loud)
        here, turned, seen = t[part], w[part], c.seen[loud]
        pushed = modes[part][:, quiet] * here[:, quiet]
        free = rigid[part] + pushed @ c.seen[quiet] + (poles[part] * turned) @ c.left
        h = compliance(c, s[part], here, turned, quiet)
        own_apart = apart[part][:, loud]
        forces, own = with_modes(h, seen, own_apart, y[part] - free, modes[part][:, loud])
        whole = (modes[part] + forces @ c.seen.T) * here
        whole[:, loud] = own
        better = ~of_laws[part]
        if not better.all():
            # Rounding errors of the amplitudes by both methods.
            sizes = np.abs(y[part]) + np.abs(pushed) @ np.abs(c.seen[quiet])
            sizes += (np.abs(h) @ np.abs(forces)[:, :, np.newaxis])[:, :, 0]
            on_modes = np.abs(modes[part]) + np.abs(forces) @ np.abs(c.seen).T
            inverse = np.abs(np.linalg.inv(_bordered(h, seen, own_apart)))
            both = np.concatenate([sizes, on_modes[:, loud]], axis=1)
            lost = (inverse @ both[:, :, np.newaxis])[:, :, 0]
            q = y.shape[1]
            others = (np.abs(here[:, quiet]) * (lost[:, :q] @ np.abs(c.seen[quiet]).T)).max(
                axis=1, initial=0.0
            )
            mine = np.maximum(others, lost[:, q:].max(axis=1))
            better |= mine < (np.abs(here) * on_modes).max(axis=1)
        g[part[better]], amplitudes[part[better]] = forces[better], whole[better]
