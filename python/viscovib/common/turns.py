"""Where motions that are known at times turn: their extremes, by states at times between."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from viscovib._native import FloatArray

#: Corrections of the places of turns: an impact takes a halving for each bit.
_MOST_TURNS = 60


def extremes_of(
    t: FloatArray,
    states: FloatArray,
    states_at: Callable[[FloatArray], FloatArray],
    left: float,
) -> tuple[FloatArray, FloatArray]:
    """Smallest and largest displacement of each coordinate, shapes (n_dof,).

    ``states`` are coordinates and velocities by turns at ascending times; ``states_at`` makes them
    at others. All turns are corrected at once, by the rule of Illinois for the velocity, until
    what is left changes a displacement by no more than ``left`` of it.
    """
    q, v = states[:, ::2], states[:, 1::2]
    low, high = q.min(axis=0), q.max(axis=0)
    times = _hidden(t, q, v)
    if times.size:
        t, states = _merged(t, states, times, states_at)
        q, v = states[:, ::2], states[:, 1::2]
    rows, which = np.nonzero(v[:-1] * v[1:] < 0)
    a, b = t[rows], t[rows + 1]
    at_a, at_b = v[rows, which], v[rows + 1, which]
    last = np.zeros(rows.size, dtype=int)
    for _ in range(_MOST_TURNS):
        if not rows.size:
            break
        between = a + (b - a) * at_a / (at_a - at_b)
        found = _in_any_order(between, states_at)
        here, speed = (found[np.arange(rows.size), 2 * which + k] for k in (0, 1))
        np.minimum.at(low, which, here)
        np.maximum.at(high, which, here)
        same = speed * at_a > 0
        at_b = np.where(same & (last == 1), 0.5 * at_b, at_b)
        at_a = np.where(~same & (last == 2), 0.5 * at_a, at_a)
        a, at_a = np.where(same, between, a), np.where(same, speed, at_a)
        b, at_b = np.where(same, b, between), np.where(same, at_b, speed)
        last = np.where(same, 1, 2)
        size = np.maximum(high - low, np.maximum(np.abs(low), np.abs(high)))[which]
        open_ = (np.abs(speed) * (b - a) > left * size) & (b - a > 4e-16 * np.abs(b))
        rows, which, last = rows[open_], which[open_], last[open_]
        a, b, at_a, at_b = a[open_], b[open_], at_a[open_], at_b[open_]
    return low, high


def _in_any_order(times: FloatArray, states_at: Callable[[FloatArray], FloatArray]) -> FloatArray:
    ascending, back = np.unique(times, return_inverse=True)
    return np.asarray(states_at(ascending)[back])


def _hidden(t: FloatArray, q: FloatArray, v: FloatArray) -> FloatArray:
    """Times at which Hermite's cubic between two states turns back and forth: twice unseen."""
    h = np.diff(t)[:, None]
    slope = np.diff(q, axis=0) / h
    # The velocity of the cubic over s in 0 to 1: v0 + b s + c s^2.
    b = 6 * slope - 4 * v[:-1] - 2 * v[1:]
    c = 3 * (v[:-1] + v[1:]) - 6 * slope
    with np.errstate(divide="ignore", invalid="ignore"):
        s = -b / (2 * c)
        bottom = v[:-1] + 0.5 * b * s
    twice = (v[:-1] * v[1:] > 0) & (s > 0) & (s < 1) & (bottom * v[:-1] < 0)
    rows, columns = np.nonzero(twice)
    return np.asarray(t[rows] + h[rows, 0] * s[rows, columns])


def _merged(
    t: FloatArray,
    states: FloatArray,
    times: FloatArray,
    states_at: Callable[[FloatArray], FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """States with those at further times, ascending."""
    times = np.setdiff1d(times, t)
    every = np.concatenate([t, times])
    order = np.argsort(every)
    return every[order], np.concatenate([states, states_at(times)])[order]
