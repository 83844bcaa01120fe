"""Stated errors of events: with memory, bursts of the load, near grazing.

Kernels of exponentials give ordinary equations. SciPy solves them between corners of the load.
"""

import numpy as np
from scipy.optimize import brentq

from referee.case import Case, Claim, even, few, number, numbers
from referee.integration import solve_ivp

_END = 10.0
#: Error of the reference, and the factor by which stated errors may be exceeded.
_JUDGE, _BY = 4e-13, 1.5
#: Events this near to grazing, in errors of the state, may be missing.
_NEAR = 1e3


class _Motion:
    """A motion by SciPy, in pieces between corners of its load."""

    def __init__(self, rates, start, corners):
        self.ends = np.unique(np.r_[0.0, corners[(corners > 0) & (corners < _END)], _END])
        self.parts = []
        y = np.asarray(start, dtype=float)
        for a, b in zip(self.ends[:-1], self.ends[1:], strict=True):
            part = solve_ivp(
                rates, (a, b), y, "DOP853", rtol=1e-13, atol=1e-14, max_step=0.05,
                dense_output=True,
            )  # fmt: skip
            y = part.y[:, -1]
            self.parts.append(part.sol)

    def __call__(self, t):
        place = np.clip(np.searchsorted(self.ends, t, side="left") - 1, 0, len(self.parts) - 1)
        t, place = np.broadcast_arrays(np.asarray(t, dtype=float), place)
        found = np.array([self.parts[i](x) for x, i in zip(t.ravel(), place.ravel(), strict=True)])
        return found.T if t.ndim else found[0]


def _passages(motion, fine, times, level, row):
    """Times at which a component of the state crosses a level; turning points are checked."""
    g = fine[row] - level
    turns = np.flatnonzero(fine[1, :-1] * fine[1, 1:] < 0) if row == 0 else []
    places = list(times)
    for i in turns:
        # Rounding error of a turning point between two times.
        places.append(brentq(lambda t: motion(t)[1], times[i], times[i + 1], xtol=1e-14))
    places = np.unique(places)
    at = np.interp(places, times, g)
    new = ~np.isin(places, times)
    if new.any():
        at[new] = motion(places[new])[row] - level
    found = [
        brentq(lambda t: motion(t)[row] - level, places[i], places[i + 1], xtol=1e-15, rtol=1e-15)
        for i in np.flatnonzero(at[:-1] * at[1:] < 0)
    ]
    return np.array(found), np.abs(at[new]).min() if new.any() else np.inf


def _late(slack, rate, bend):
    """Change of the event time for an error ``slack`` of the event function."""
    rest = rate**2 - 2 * abs(bend) * slack
    if rest > 0:
        return 2 * slack / (abs(rate) + np.sqrt(rest))
    return np.sqrt(2 * slack / max(abs(bend), 1e-300))


def case(rng):
    """Draw an oscillator, its load, and levels, one of which is grazed."""
    m = int(rng.integers(0, 3))
    rates = np.array([few(rng, 0.1, 10, 3) for _ in range(m)])
    weights = np.array([even(rng, 0.05, 0.3, 3) for _ in range(m)])
    if m:
        weights = np.round(weights * min(1.0, 0.8 / (weights / rates).sum()), 6)
    k, c, cubic = even(rng, 0.5, 3, 3), even(rng, 0.02, 0.2, 3), even(rng, 0, 1, 3)
    start = [even(rng, -1, 1, 3), even(rng, -1, 1, 3)]
    size, nu = even(rng, 0.1, 0.8, 3), even(rng, 0.5, 2, 3)
    corners, forces = np.empty(0), np.empty(0)
    load = f"load={size}, nu={nu}"
    if rng.integers(2):
        # A burst, which may be much shorter than a step.
        begin, length = even(rng, 1, 6, 4), few(rng, 0.01, 1, 3)
        inner = np.sort(np.round(begin + length * rng.random(int(rng.integers(3, 10))), 6))
        corners = np.unique(np.r_[0.0, begin, inner, begin + 1.1 * length, 9.5])
        forces = np.where((corners > begin) & (corners < begin + 1.05 * length), 1.0, 0.0)
        forces = np.round(forces * rng.normal(size=corners.size) * rng.uniform(0.3, 5), 4)
        load = f"force=vv.LoadTable(times={numbers(corners)}, values={numbers(forces)})"

    def equations(t, y):
        force = np.interp(t, corners, forces, left=0, right=0) if forces.size else 0.0
        force = force if forces.size else size * np.sin(nu * t)
        spring = k * y[0] + cubic * y[0] ** 3
        return np.r_[
            y[1], force - spring - c * y[1] + y[2:].sum(), weights * spring - rates * y[2:]
        ]

    motion = _Motion(equations, [*start, *np.zeros(m)], corners)
    times = np.linspace(0, _END, 4001)
    fine = motion(times)
    tops = np.flatnonzero((fine[1, :-1] > 0) & (fine[1, 1:] <= 0))
    levels = [even(rng, -0.4, 0.4, 3)]
    if tops.size:
        i = tops[int(rng.integers(tops.size))]
        top = motion(brentq(lambda t: motion(t)[1], times[i], times[i + 1], xtol=1e-14))[0]
        levels.append(float(top - few(rng, 1e-13, 1e-3)))
    kept = ("", "keep='last'", "times=[5.0, 10.0]")[int(rng.integers(3))]
    sought = f"dt={even(rng, 0.05, 0.4, 3)}, estimate_error=True"
    if rng.integers(3):
        sought = f"tolerance={(1e-10, 1e-8, 1e-6)[int(rng.integers(3))]}"
    method = ("gauss8", "gauss3", "gauss2")[min(int(rng.integers(4)), 2)]
    kernel = f", kernel=vv.PronyKernel(weights={numbers(weights)}, rates={numbers(rates)})"
    events = ["x_dot", *(f"x - ({number(one)})" for one in levels)]
    call = f"""s = vv.PolynomialSystem(mass=1, stiffness={k}, damping={c}, forces='{cubic}*x^3'{
        kernel if m else ""
    })
r = vv.simulate(s, {_END}, {load}, initial={start}, method={method!r}, {sought},
    events={events}{", " + kept if kept else ""})
found, error = [(e.t, e.state, e.error, e.state_error) for e in r.events], r.error
"""

    def judge(names, reported):
        for i, (t, states, error, state_error) in enumerate(names["found"]):
            level, row = (0.0, 1) if i == 0 else (levels[i - 1], 0)
            true, near = _passages(motion, fine, times, level, row)
            known = np.isfinite(error)
            yield Claim(f"known, event {i}", bool(known.all()), True)
            if not true.size or not t.size or not known.all():
                continue
            if near > _NEAR * max(names["error"], _JUDGE) or row == 1:
                yield Claim(f"passages, event {i}", t.size, true.size)
            partner = np.abs(true[:, np.newaxis] - t).argmin(axis=0)
            exact = motion(true[partner])
            moved = np.array([equations(x, y) for x, y in zip(true[partner], exact.T, strict=True)])
            moved = moved.reshape(-1, 2 + m)
            bend = moved[:, 1] if row == 0 else np.zeros(t.size)
            own = np.array([_late(_JUDGE, *two) for two in zip(moved[:, row], bend, strict=True)])
            yield Claim(f"times, event {i}", t, true[partner], _BY * error + own, damage=1e-2)
            pace = np.abs(moved[:, :2]).max(axis=1)
            off = np.abs(states - exact[:2].T).max(axis=1)
            yield Claim(
                f"states, event {i}", 1 + off, np.ones(t.size),
                _BY * state_error + _JUDGE + pace * own, damage=1e-1,
            )  # fmt: skip

    return Case(call, judge)
