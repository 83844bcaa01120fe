"""Stability of a beating motion by integration of the full equations."""

from __future__ import annotations

from dataclasses import fields
from typing import NamedTuple

import numpy as np

from viscovib._native import ComplexArray, FloatArray
from viscovib.analyses.ensemble import simulate_ensemble
from viscovib.errors import InputError
from viscovib.systems.cubic_system import CubicSystem
from viscovib.systems.pendulum import Pendulum
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.spring_groups import Monomial

#: Steps per period of the fastest significant line; relative size of significant lines.
_STEPS, _COUNTS = 30, 1e-3
#: In decay times of the slowest mode: time until the initial state has decayed, and averaging time
#: of the growth (also over half of it).
_SETTLING, _AVERAGED = 14.0, 20.0
#: Relative initial distance of a neighbour and its averaging time: above rounding at the end.
_NEARBY, _NEARBY_AVERAGED = 1e-4, 12.0
#: Largest number of steps of a run.
_MOST_STEPS = 1_000_000
#: A run has left the motion if it ends beyond this multiple of the estimated errors.
_STAYS = 5.0


class _Growth(NamedTuple):
    """Mean growth over the first half and the whole of a time, and the final state."""

    half: float
    whole: float
    span: float
    t: float
    state: FloatArray


def growth_of_neighbours(
    system: object,
    varied: dict[str, float],
    frequencies: FloatArray,
    harmonics: ComplexArray,
    errors: FloatArray,
    slowest: float,
) -> tuple[float, float]:
    """Return the growth of neighbours in the full equations, and its error (inf: unknown).

    The equations are integrated from the state of the motion at t = 0 until the error of this
    state has decayed. Then the growth g = log(|d(t + T)|/|d(t)|)/T of a difference d is averaged.
    It is the Lyapunov exponent + O(1/T). Its error is twice the difference between T and T/2, plus
    one e-folding. A run that ends farther from the motion than the errors allow has no result.
    """
    unknown = (0.0, np.inf)
    size = np.abs(harmonics[1:]).max(axis=1, initial=0.0)
    if slowest <= 0 or not np.isfinite(errors).all() or not size.any():
        return unknown
    fastest = float(frequencies[1:][size > _COUNTS * size.max()].max())
    step = 2 * np.pi / (_STEPS * fastest)
    if (_SETTLING + _AVERAGED) / slowest / step > _MOST_STEPS:
        return unknown

    def note(t: float) -> FloatArray:
        waves = np.exp(1j * frequencies * t)[:, None] * harmonics
        rates = 1j * frequencies @ waves
        return np.ravel(np.column_stack([waves.sum(axis=0).real, rates.real]))

    try:
        if isinstance(system, Pendulum):
            found = _of_pendulum(system, varied, note(0.0), step, slowest)
        elif isinstance(system, CubicSystem):
            found = _of_cubic(system, varied, note(0.0), step, slowest)
        else:
            return unknown
    except InputError:
        return unknown
    if found is None or not np.isfinite([found.half, found.whole]).all():
        return unknown
    allowed = _STAYS * np.ravel(np.column_stack([errors, fastest * errors]))
    if (np.abs(found.state - note(found.t)) > allowed + 1e-9 * np.abs(found.state).max()).any():
        return unknown
    return found.whole, 2 * abs(found.whole - found.half) + 1 / found.span


def _of_pendulum(
    system: Pendulum, varied: dict[str, float], start: FloatArray, step: float, slowest: float
) -> _Growth | None:
    numbers = {f.name: getattr(system, f.name) for f in fields(system) if f.init}
    full = Pendulum(**(numbers | varied))
    settled, span = _SETTLING / slowest, _AVERAGED / slowest
    growth = []
    for part in (0.5 * span, span):
        found = simulate_ensemble(
            full, initial=start, t_end=settled + part, dt=step, discard=settled, lyapunov=True,
            n_threads=1,
        )  # fmt: skip
        if found.outcome[0] != "completed" or found.lyapunov is None:
            return None
        growth.append(float(found.lyapunov[0]))
    return _Growth(growth[0], growth[1], span, float(found.t_end[0]), found.state[0])


def _of_cubic(
    system: CubicSystem, varied: dict[str, float], start: FloatArray, step: float, slowest: float
) -> _Growth | None:
    """Represent each load by an additional oscillator, s'' + p^2 s = 0 with s(0) = 1."""
    drives = np.array(system.drives, dtype=float)
    load = np.array(system.load, dtype=float)
    for name, value in varied.items():
        k = int(name[1:]) - 1
        if name[0] == "p":
            drives[k] = value
        else:
            load[:, k] *= value / load[np.abs(load[:, k]).argmax(), k]
    n, loads = load.shape
    quadratic, cubic = (
        None if x is None else np.asarray(x, dtype=float) for x in (system.quadratic, system.cubic)
    )
    if any(x is not None and x.shape[-1] != n for x in (quadratic, cubic)):
        return None
    whole = n + loads

    def grown(matrix: object, corner: FloatArray) -> FloatArray:
        larger = np.zeros((whole, whole))
        larger[:n, :n] = 0.0 if matrix is None else matrix
        larger[n:, n:] = corner
        return larger

    terms = []
    for x in (quadratic, cubic):
        if x is None:
            continue
        for place in np.argwhere(x):
            powers = np.bincount(place[1:], minlength=whole).tolist()
            terms.append(
                Monomial(coefficient=float(x[tuple(place)]), powers=powers, on=int(place[0]))
            )
    for i, k in np.argwhere(load):
        powers = np.eye(whole, dtype=int)[n + k].tolist()
        terms.append(Monomial(coefficient=-float(load[i, k]), powers=powers, on=int(i)))
    full = PolynomialSystem(
        mass=grown(system.mass, np.eye(loads)),
        stiffness=grown(system.stiffness, np.diag(drives**2)),
        damping=grown(system.damping, np.zeros((loads, loads))),
        forces=terms,
    )
    settled, span = _SETTLING / slowest, _NEARBY_AVERAGED / slowest
    state = np.concatenate([start, np.tile([1.0, 0.0], loads)])
    state = simulate_ensemble(full, initial=state, t_end=settled, dt=step, n_threads=1).state[0]
    both = np.tile(state, (2, 1))
    both[1, : 2 * n] += _NEARBY * np.abs(state[: 2 * n]).max() * np.resize([1.0, 0.7, -0.8], 2 * n)
    apart = [np.linalg.norm(both[1] - both[0])]
    for _ in range(2):
        both = simulate_ensemble(full, initial=both, t_end=span / 2, dt=step, n_threads=1).state
        apart.append(np.linalg.norm(both[1, : 2 * n] - both[0, : 2 * n]))
    if not (np.isfinite(apart).all() and min(apart) > 0):
        return None
    logs = np.log(np.array(apart) / apart[0])
    return _Growth(
        float(2 * logs[1] / span), float(logs[2] / span), span, settled + span, both[0, : 2 * n]
    )
