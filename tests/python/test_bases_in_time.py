"""Tables of base motion: against SciPy in absolute coordinates, and against a harmonic base."""

import itertools
import math

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp
from scipy.interpolate import CubicSpline

WEIGHTS, RATES = np.array([0.1, 0.2]), np.array([0.7, 3.0])


class Moved:
    """Two masses on a moving base in absolute coordinates; springs with memory."""

    def __init__(self, rng, memory):
        self.memory = memory
        self.mass = np.diag(rng.uniform(0.5, 2, 2))
        k, c = rng.uniform(1, 5, 2), rng.uniform(0.05, 0.3, 2)
        links = np.array([[1.0, 0.0], [-1.0, 1.0]])  # the first link connects to the base
        self.stiffness = links.T @ np.diag(k) @ links
        self.damping = links.T @ np.diag(c) @ links
        self.cubic = rng.uniform(0, 0.5)
        kernel = vv.PronyKernel(weights=WEIGHTS, rates=RATES) if memory else None
        self.system = vv.PolynomialSystem(
            mass=self.mass,
            stiffness=self.stiffness,
            damping=self.damping,
            base_direction=[1, 1],
            kernel=kernel,
            springs=[vv.Springs(forces={"x1": f"{self.cubic}*x1^3"})],
        )

    def motion(self, table, end, start, load=None):
        """The final state; each piece of the table is integrated separately."""
        times, values = np.asarray(table.times), np.asarray(table.values)
        ends = np.concatenate([[0.0], times[(times > 0) & (times < end)], [end]])
        y = np.concatenate([start[::2], start[1::2], np.zeros(4 if self.memory else 0)])
        for begin, until in itertools.pairwise(ends):
            middle = (begin + until) / 2
            i = int(np.searchsorted(times, middle)) - 1
            if middle < times[0] or middle > times[-1]:
                place = [values[0] if middle < times[0] else values[-1]]
            elif table.interpolation == "cubic":
                place = CubicSpline(times, values).c[:, i]
            else:
                place = [np.diff(values)[i] / np.diff(times)[i], values[i]]
            origin = times[max(i, 0)]

            def slope(t, y, place=place, origin=origin):
                base = np.polyval(place, t - origin)
                rate = np.polyval(np.polyder(place), t - origin)
                d, v = y[:2] - base, y[2:4] - rate
                pull = self.stiffness @ d + self.damping @ v
                pull[0] += self.cubic * d[0] ** 3
                if self.memory:
                    pull -= self.stiffness @ (WEIGHTS @ y[4:].reshape(2, 2))
                if load is not None:
                    pull[0] -= load(t)
                a = -np.linalg.solve(self.mass, pull)
                h = y[4:].reshape(-1, 2)
                rest = d - RATES[: len(h), np.newaxis] * h
                return np.concatenate([y[2:4], a, rest.ravel()])

            y = solve_ivp(slope, (begin, until), y, method="DOP853", rtol=1e-12, atol=1e-14).y[
                :, -1
            ]
        return np.stack([y[:2], y[2:4]], axis=1).ravel()


def table_of(rng):
    """A base motion with corners, or a spline, with arbitrary start and end."""
    times = np.cumsum(rng.uniform(0.2, 2, rng.integers(2, 7))) - rng.uniform(0, 2)
    kind = rng.choice(["linear", "cubic"]) if times.size > 3 else "linear"
    return vv.LoadTable(times=times, values=0.3 * rng.normal(size=times.size), interpolation=kind)


@pytest.mark.parametrize("memory", [None, "exponentials", "direct"])
def test_random_bases(memory):
    rng = np.random.default_rng(11)
    for i in range(8):
        body, table = Moved(rng, memory is not None), table_of(rng)
        start = 0.2 * rng.normal(size=4)
        job = {} if memory is None else {"memory": memory}
        if i % 2:
            job |= {"load": 0.3, "nu": 1.3}
        run = vv.simulate(body.system, 8, base=table, initial=start, **job)
        load = (lambda t: 0.3 * math.sin(1.3 * t)) if i % 2 else None
        expected = body.motion(table, 8, start, load)
        assert 0 < run.error <= 1e-10
        assert np.abs(run.state[-1] - expected).max() < 5e-12
        given = vv.simulate(
            body.system, 8, base=table, initial=start, dt=0.2, estimate_error=True, **job
        )
        assert np.abs(given.state[-1] - expected).max() < 5e-12 + 10 * given.error


def test_states_are_those_of_the_body_at_corners_too():
    """The velocity of the body does not jump at a corner of the base motion."""
    body = vv.PolynomialSystem(mass=1, stiffness=4, damping=0.1, base_direction=[1])
    table = vv.LoadTable(times=[0.5, 1, 2], values=[0, 1.0, 0.0])
    times = [0.5, np.nextafter(1, 0), 1.0, np.nextafter(1, 2), 1.5, 2.0, 2.5]
    at = vv.simulate(body, 3, dt=0.25, base=table, times=times).state
    kept = vv.simulate(body, 3, dt=0.25, base=table)
    for t, state in zip(times, at, strict=True):
        near = np.abs(kept.t - t).argmin()
        assert np.abs(kept.state[near] - state).max() < 1e-14
    last = vv.simulate(body, 1, dt=0.25, base=table, keep="last")
    assert np.abs(last.state[0] - at[2]).max() < 1e-14


def test_order_is_kept_where_a_singular_kernel_remembers_a_corner():
    """A corner of the base is a jump of the deflection velocity; the ramp may be very short."""
    kernel = vv.RabotnovKernel(amplitude=0.3, alpha=0.3, beta=0.5)
    mount = vv.Mount(
        mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, kernel=kernel
    )
    for ramp in (1.0, 1e-3, 1e-8):
        table = vv.LoadTable(times=[0.777, 0.777 + ramp], values=[0.0, 0.1])
        states = [vv.simulate(mount, 3, dt=dt, base=table).state[-1] for dt in (0.2, 0.1, 0.05)]
        assert np.abs(states[0] - states[2]).max() < 1e-12
        assert np.abs(states[1] - states[2]).max() < 1e-13
    ends = [
        vv.simulate(mount, 1, dt=0.2, base=table, memory=memory).state[-1]
        for memory in ("exponentials", "direct")
    ]
    assert np.abs(ends[0] - ends[1]).max() < 1e-14


def test_a_base_that_jumps_or_has_columns_is_refused():
    body = vv.PolynomialSystem(mass=1, stiffness=4, base_direction=[1])
    jump = vv.LoadTable(times=[0, 1, np.nextafter(1, 2)], values=[0, 0, 1.0])
    with pytest.raises(vv.InputError, match="base: moves from 0 to 1 within"):
        vv.simulate(body, 5, base=jump)
    with pytest.raises(vv.InputError, match="base: values must have shape"):
        vv.simulate(body, 5, base=vv.LoadTable(times=[0, 1], values=[[0.0], [1.0]]))
    fixed = vv.PolynomialSystem(mass=1, stiffness=4)
    with pytest.raises(vv.InputError, match="base: this system has no base_direction"):
        vv.simulate(fixed, 5, base=vv.LoadTable(times=[0, 1], values=[0.0, 1.0]))
    with pytest.raises(vv.InputError, match="nu: must not be given"):
        vv.simulate(body, 5, base=vv.LoadTable(times=[0, 1], values=[0.0, 1.0]), nu=1.0)
