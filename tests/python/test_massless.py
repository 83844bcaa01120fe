"""Motions of structures with massless coordinates, against reduced equations."""

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

N, MOVING, IDLE = 4, [0, 2], [1, 3]
PRONY = vv.PronyKernel(weights=[0.3], rates=[1.2])
RNG = np.random.default_rng(2)
A = RNG.normal(size=(N, N))
K, M, C = A @ A.T + 2 * np.eye(N), np.array([1.0, 0, 2, 0]), np.array([0.1, 0, 0.2, 0])
LOAD, NU, START = np.array([0.3, 1.0, 0, 0.5]), 1.1, np.array([0.4, 0.1, 0, 0, -0.2, 0, 0, 0])
TABLE = vv.LoadTable(times=[1, 3], values=[0.5, 1.0], on="x4")
ALONE, ACROSS = np.array([0.0, 1, 0, 0]), np.array([1.0, 0, 0, -1])


def structure(e, kernel, **more):
    element = vv.Spring(on=e, stiffness=0.8, law="1.5*d^3", kernel=kernel)
    return vv.Structure(mass=M, stiffness=K, damping=C, elements=[element], **more)


class Reduced:
    """Reference: displacements of massless coordinates by Newton's method at every instant."""

    def __init__(self, e, kernel):
        self.e, self.kernel, self.guess = e, kernel, np.zeros(2)
        self.weight = 0.0 if kernel is None else kernel.weights[0]
        self.rate = 0.0 if kernel is None else kernel.rates[0]

    def pull(self, t, u, y, table):
        d = self.e @ u
        push = LOAD * np.sin(NU * t)
        if table:
            push[3] += np.interp(t, TABLE.times, TABLE.values)
        return push - K @ u - self.e * (0.8 * d + 1.5 * d**3 - y)

    def place(self, t, moving, y, table):
        u = np.zeros(N)
        u[MOVING], u[IDLE] = moving, self.guess
        for _ in range(30):
            d = self.e @ u
            slope = K + np.outer(self.e, self.e) * (0.8 + 4.5 * d**2)
            step = np.linalg.solve(slope[np.ix_(IDLE, IDLE)], self.pull(t, u, y, table)[IDLE])
            u[IDLE] += step
            if np.abs(step).max() < 1e-15:
                break
        self.guess = u[IDLE]
        return u

    def run(self, end):
        def right(t, s, table):
            u = self.place(t, s[:2], s[4], table)
            d = self.e @ u
            gained = self.weight * (0.8 * d + 1.5 * d**3) - self.rate * s[4]
            pulled = self.pull(t, u, s[4], table)[MOVING] - C[MOVING] * s[2:4]
            return np.concatenate([s[2:4], pulled / M[MOVING], [gained]])

        s = np.concatenate([START[::2][MOVING], START[1::2][MOVING], [0.0]])
        for a, b in ((0, 1), (1, 3), (3, end)):
            args = {"args": (a == 1,), "method": "DOP853", "rtol": 1e-13, "atol": 1e-14}
            s = solve_ivp(right, (a, b), s, **args).y[:, -1]
        places = [
            self.place(
                end + h, solve_ivp(right, (end, end + h), s, **args).y[:2, -1] if h else s[:2],
                s[4] + h * right(end, s, False)[4], False,
            )
            for h in (-1e-5, 0, 1e-5)
        ]  # fmt: skip
        return places[1], (places[2] - places[0]) / 2e-5


@pytest.mark.parametrize("e", [ALONE, ACROSS], ids=["alone", "across"])
@pytest.mark.parametrize("kernel", [None, PRONY], ids=["elastic", "prony"])
def test_as_reduced_equations(e, kernel):
    """Loads, a table with jumps and elements act on massless coordinates."""
    run = vv.simulate(
        structure(e, kernel), 8, initial=START, load=LOAD, nu=NU, force=TABLE, tolerance=1e-10
    )
    place, rate = Reduced(e, kernel).run(8)
    assert np.abs(run.state[-1, ::2] - place).max() < 1e-12
    assert np.abs(run.state[-1, 1::2] - rate).max() < 1e-8
    assert np.abs(run.deflections[-1] - e @ place).max() < 1e-12
    first = Reduced(e, kernel).place(0.0, START[::2][MOVING], 0.0, False)
    assert np.abs(run.state[0, ::2] - first).max() < 1e-13


def test_rates_are_those_of_places():
    """At the ends of steps, and at requested times inside them."""
    t = np.linspace(0, 8, 4001)
    run = vv.simulate(
        structure(ACROSS, PRONY), 8, initial=START, load=LOAD, nu=NU, dt=0.05, times=t
    )
    slope = (run.state[2:, ::2] - run.state[:-2, ::2]) / (2 * t[1])
    assert np.abs(slope - run.state[1:-1, 1::2]).max() < 1e-5


@pytest.mark.parametrize("kernel", [None, PRONY])
def test_goes_on_bit_for_bit(kernel):
    system = structure(ACROSS, kernel)
    given = {"initial": START, "load": LOAD, "nu": NU, "dt": 0.05}
    half = vv.simulate(system, 5, **given)
    once, twice = vv.simulate(system, 9, **given), vv.simulate(system, 9, resume=half)
    assert (once.state[-1] == twice.state[-1]).all()
    assert np.abs(once.deflections[-1] - ACROSS @ once.state[-1, ::2]).max() < 1e-14


def test_a_kernel_that_is_infinite_at_first_needs_mass():
    kernel = vv.RabotnovKernel(amplitude=0.3, alpha=0.5, beta=0.9)
    with pytest.raises(vv.InputError, match="infinite at first acts on a coordinate without mass"):
        vv.simulate(structure(ALONE, kernel), 4, load=LOAD, nu=NU)
    # In parallel with another spring it is allowed.
    vv.simulate(structure([0, 0, 1, 0], kernel), 4, load=LOAD, nu=NU, tolerance=1e-8)


def test_settles_on_the_periodic_motion():
    system = structure(ACROSS, PRONY)
    run = vv.simulate(system, 60 * 2 * np.pi / NU, load=LOAD, nu=NU, tolerance=1e-9)
    found = vv.forced_response(system, [NU], load=LOAD, method="newton", harmonics=25)
    assert np.abs(run.state[-1, ::2] - found.coefficients[0].imag.sum(axis=1)).max() < 1e-8


def test_other_loads_from_a_time_on():
    """The displacements jump with the load; memory states do not."""
    system = structure(ALONE, PRONY)
    jumps = vv.LoadTable(times=[3, 8], values=[1.0, 1.0], on=dict(x1=0.3, x2=1.0, x4=0.5))
    steady = {"initial": START, "dt": 0.02}
    half = vv.simulate(system, 3, **steady)
    more = vv.simulate(system, 8, resume=half, load={0: LOAD * 1j}, nu=1.0)
    whole = vv.simulate(system, 8, force=jumps, **steady)
    assert np.abs(more.state[-1] - whole.state[-1]).max() < 1e-9


def test_a_law_of_rates_needs_mass():
    element = vv.Spring(on="x2", law="0.1*v*abs(v)")
    system = vv.Structure(mass=M, stiffness=K, damping=C, elements=[element])
    with pytest.raises(vv.InputError, match="reads the rate of a coordinate without mass"):
        vv.simulate(system, 1.0, initial=START)
