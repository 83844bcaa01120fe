"""Lyapunov exponents by neighbouring motions, of systems that switch or remember.

Motions beside a motion, a small distance d apart in coordinates and velocities, are followed with
it; again and again their differences are made orthogonal and of length d (Benettin et al.,
Meccanica 15, 1980, with differences instead of the variational equation). Each is a run of its
own, so that it switches at times of its own: what a corner, a jump or an impact does to small
disturbances (saltation) is in the difference.

With memory the state is the whole past. A disturbance is then one of coordinates and velocities at
t = 0 under an undisturbed past; from there on its own past belongs to it and is scaled with it.
Exponents are the growth of its present coordinates and velocities: those of the past follow.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from viscovib._native import FloatArray
from viscovib.analyses.runs import Run, Wanted

#: Distance of a neighbour, of the size of the motion; below this part of it two motions are one.
_APART, _ONE = 1e-7, 1e-7
#: Growth between two looks that is taken for a moment between two switches, when first seen.
_LEAP = 1e3
#: How near to a whole turn phases are that differ by one.
_TURN = 1e-9
#: States by which the size of a motion is known.
_LOOKS = 512


@dataclass
class _Neighbour:
    """A run beside another."""

    run: Run
    #: Sum of the logarithms of growth.
    grown: float = 0.0


def exponents_of(
    make: Callable[[FloatArray | None], Run],
    widths: tuple[int, int],
    n_steps: int,
    n_discard: int,
    count: int,
    quarter: int,
) -> FloatArray:
    """Mean rates of growth of ``count`` disturbances; NaN of a motion that stops.

    ``make`` begins the run, its start moved by so much; ``widths`` of a start, and of what is kept
    of coordinates and velocities; ``quarter``: steps between two looks.
    -inf: the disturbance vanishes altogether, as where friction sticks.
    """
    missing = np.full(count, math.nan)
    scout = make(None)
    looked = scout.steps(n_steps, Wanted(every=max(1, n_steps // _LOOKS)), False)
    if looked.outcome != "completed":
        return missing
    begun, width = widths
    size = np.abs(looked.state[:, :width]).max(axis=0)
    # Coordinates with coordinates, velocities with velocities.
    time = quarter * scout.h
    length = max(float(size[::2].max()), time * float(size[1::2].max())) or 1.0
    scale = np.resize([length, length / time], width)
    base = make(None)
    # In no special direction.
    first = np.linalg.qr(np.random.default_rng(1).standard_normal((begun, count)))[0]
    units = np.resize(scale, begun)
    others = [_Neighbour(make(_APART * units * first[:, j])) for j in range(count)]
    done, leapt = 0, False
    while done < n_steps:
        n = min(quarter, (n_discard if done < n_discard else n_steps) - done)
        runs = [base, *(other.run for other in others)]
        if any(run.steps(n, Wanted(keep="last"), False).outcome != "completed" for run in runs):
            return missing
        done += n
        leapt = not _renew(base, others, scale, patient=not leapt, last=done == n_steps)
        if done == n_discard:
            for other in others:
                other.grown = 0.0
    return np.array([other.grown for other in others]) / (base.h * (n_steps - n_discard))


def _renew(
    base: Run, others: list[_Neighbour], scale: FloatArray, *, patient: bool, last: bool
) -> bool:
    """Make differences orthogonal and short again; False: that is left for the next look."""
    assert base.memory is not None
    own = np.concatenate([base.state, base.memory])
    n, width = base.state.size, scale.size
    differences = []
    for other in others:
        assert other.run.memory is not None
        its = np.concatenate([other.run.state, other.run.memory])
        # Phases of loads are the same, but rounding may have turned one more.
        turned = np.abs(np.abs(its - own) - 2 * math.pi) < _TURN
        turned &= np.minimum(np.abs(its), np.abs(own)) < _TURN
        differences.append(np.where(turned, 0.0, its - own))
    apart = max(float(np.linalg.norm(d[:width] / scale)) for d in differences)
    # One has switched and the other not yet: the difference is that of a moment.
    if not last and ((patient and apart > _LEAP * _APART) or _astride(base, others)):
        return False
    parts: list[FloatArray] = []
    for other, whole in zip(others, differences, strict=True):
        for _ in range(2):
            for part in parts:
                along = (part[:width] / scale) @ (whole[:width] / scale)
                whole = whole - along / _APART**2 * part
        length = float(np.linalg.norm(whole[:width] / scale))
        if length <= _ONE * _APART:
            other.grown, whole = -math.inf, np.zeros_like(whole)
        else:
            other.grown += math.log(length / _APART)
            whole = whole * (_APART / length)
        parts.append(whole)
        moved = own + whole
        other.run.state, other.run.memory = moved[:n].copy(), moved[n:].copy()
    return True


def _astride(base: Run, others: list[_Neighbour]) -> bool:
    """Whether a neighbour is on another side of a surface than the motion."""
    mine = base.switched
    for other in others:
        its = other.run.switched
        off = np.abs(its - mine)
        if (off >= np.maximum(0.5, 1e-3 * np.abs(mine))).any():
            return True
    return False
