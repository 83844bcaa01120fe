"""Motion in time with kinks and jumps of laws: steps end there, and keep their order."""

import warnings

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp


def by_pieces(pieces, surface, t_end, start):
    """SciPy between crossings of a surface, with the right side of each side."""
    t, y, side = 0.0, np.array(start, dtype=float), surface(0.0, start) > 0
    while t < t_end:

        def passed(t, y):
            return surface(t, y)

        passed.terminal, passed.direction = True, -1 if side else 1
        run = solve_ivp(
            pieces[int(side)],
            (t, t_end),
            y,
            "DOP853",
            rtol=1e-13,
            atol=1e-14,
            events=passed,
            max_step=0.02,
        )
        t, y = run.t[-1], run.y[:, -1]
        side ^= run.status == 1
    return y


def bouncing(k, gap, load, nu, c=0.05):
    """An oscillator with a stop, and its right sides without and with contact."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=c, forces=f"{k}*max(x - {gap}, 0)")

    def side(on):
        return lambda t, y: [
            y[1],
            load * np.sin(nu * t) - c * y[1] - y[0] - on * k * (y[0] - gap),
        ]

    return system, (side(0), side(1)), lambda t, y: y[0] - gap


@pytest.mark.parametrize(
    ("method", "order", "steps"), [("gauss2", 4, 640), ("gauss3", 6, 320), ("verner9", 9, 160)]
)
def test_order_through_contacts(method, order, steps):
    """Halving the step of a bouncing oscillator gains the order of the method."""
    system, pieces, surface = bouncing(30.0, 0.5, 0.8, 0.7)
    expected = by_pieces(pieces, surface, 40.0, [0.0, 0.0])
    errors = []
    for n in (steps, 2 * steps):
        run = vv.simulate(system, 40.0, dt=40.0 / n, load=0.8, nu=0.7, method=method, keep="last")
        errors.append(np.abs(run.state[-1] - expected).max())
    assert np.log2(errors[0] / errors[1]) > order - 0.5
    run = vv.simulate(system, 40.0, load=0.8, nu=0.7, tolerance=1e-10)
    assert run.error < 1e-10
    np.testing.assert_allclose(run.state[-1], expected, atol=1e-10)


@pytest.mark.parametrize("method", ["gauss8", "verner9"])
def test_contacts_shorter_than_a_step(method):
    """A contact near grazing is invisible at the ends of steps."""
    system, pieces, surface = bouncing(1000.0, 1 - 1e-4, 0.0, 1.0, c=0.0)
    # The peak at pi/2 lies inside a step; the contact lasts 0.03.
    expected = by_pieces(pieces, surface, 3.0, [0.0, 1.0])
    free = np.array([np.sin(3.0), np.cos(3.0)])
    assert np.abs(expected - free).max() > 1e-3
    for dt in (0.2, 0.1):
        run = vv.simulate(system, 3.0, dt=dt, initial=[0.0, 1.0], method=method, keep="last")
        np.testing.assert_allclose(run.state[-1], expected, atol=3e-10)
    missed = bouncing(1000.0, 1 + 1e-6, 0.0, 1.0, c=0.0)[0]
    run = vv.simulate(missed, 3.0, dt=0.1, initial=[0.0, 1.0], method=method, keep="last")
    np.testing.assert_allclose(run.state[-1], free, atol=1e-12)


LAWS = {
    "2*abs(x)": lambda x: 2 * np.abs(x),
    "3*x*abs(x)": lambda x: 3 * x * np.abs(x),
    "where(x > 0.2, 5*(x - 0.2), 0)": lambda x: np.where(x > 0.2, 5 * (x - 0.2), 0),
    "0.3*sign(x - 0.1)": lambda x: 0.3 * np.sign(x - 0.1),
    "min(max(4*x, -0.5), 0.5)": lambda x: np.clip(4 * x, -0.5, 0.5),
    "7*where(abs(x) > 0.3, x - 0.3*sign(x), 0)": lambda x: (
        7 * np.sign(x) * np.maximum(np.abs(x) - 0.3, 0)
    ),
    "heaviside(x - 0.25)*(x - 0.25)^2": lambda x: (x > 0.25) * (x - 0.25) ** 2,
}


@pytest.mark.parametrize("law", LAWS)
def test_every_kind_of_branch(law):
    """dt="auto" accepts kinks and jumps, and reaches its tolerance."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces=law)
    run = vv.simulate(
        system, 12.0, initial=[0.05, 0.9], load=0.4, nu=1.3, tolerance=1e-9, times=[4.3, 12.0]
    )
    expected = solve_ivp(
        lambda t, y: [y[1], 0.4 * np.sin(1.3 * t) - 0.1 * y[1] - y[0] - LAWS[law](y[0])],
        (0, 12), [0.05, 0.9], "RK45", rtol=1e-10, atol=1e-12, max_step=2e-3, t_eval=[4.3, 12.0],
    )  # fmt: skip
    assert run.error <= 1e-9
    jumps = law.startswith("0.3*sign")
    np.testing.assert_allclose(run.state, expected.y.T, atol=2e-4 if jumps else 1e-8)


def dry(k, c, limit, load, nu, t_end, start):
    """A block with dry friction by SciPy, phase by phase: sliding or sticking."""

    def push(t, x):
        return load * np.sin(nu * t) - k * x

    t, y, way = 0.0, np.array(start, dtype=float), 0
    while t < t_end:
        if way == 0:

            def off(t, y):
                return limit**2 - push(t, y[0]) ** 2

            off.terminal, off.direction = True, -1
            if off(t, y) <= 0:
                way = int(np.sign(push(t, y[0])))
                continue
            grid = np.linspace(t, t_end, 20_000)
            loose = np.flatnonzero(np.abs(push(grid, y[0])) > limit)
            if not loose.size:
                return np.array([y[0], 0.0])
            # The position is constant, so the end of sticking is a root of the load only.
            from scipy.optimize import brentq

            i = loose[0]
            t = brentq(lambda s, off=off, y=y: off(s, y), grid[i - 1], grid[i], xtol=1e-15)
            way = int(np.sign(push(t, y[0])))
            y = np.array([y[0], 0.0])
            continue

        def stop(t, y, way=way):
            return way * y[1]

        stop.terminal, stop.direction = True, -1
        run = solve_ivp(
            lambda t, y, way=way: [y[1], push(t, y[0]) - c * y[1] - way * limit],
            (t, t_end), y, "DOP853", rtol=1e-13, atol=1e-15, events=stop, max_step=0.05,
        )  # fmt: skip
        t, y = run.t[-1], run.y[:, -1]
        if run.status == 1:
            y[1] = 0.0
            way = -way if abs(push(t, y[0])) > limit else 0
    return y


@pytest.mark.parametrize(
    ("method", "order", "steps"), [("gauss2", 4, 200), ("gauss3", 6, 100), ("verner9", 9, 50)]
)
def test_order_through_sticking(method, order, steps):
    """Halving the step of an oscillator that sticks gains the order of the method."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="0.3*sign(x_dot)")
    expected = dry(1, 0.05, 0.3, 0.5, 0.8, 30.0, [0.0, 0.0])
    assert np.abs(expected).max() > 0.1
    errors = []
    for n in (steps, 2 * steps):
        run = vv.simulate(system, 30.0, dt=30.0 / n, load=0.5, nu=0.8, method=method, keep="last")
        errors.append(np.abs(run.state[-1] - expected).max())
    assert np.log2(errors[0] / errors[1]) > order - 0.5
    run = vv.simulate(system, 30.0, load=0.5, nu=0.8, tolerance=1e-11)
    assert run.error < 1e-11
    np.testing.assert_allclose(run.state[-1], expected, atol=1e-11)


@pytest.mark.parametrize(("nu", "limit"), [(0.8, 0.2), (1.2, 0.3)])
def test_den_hartog(nu, limit):
    """Den Hartog's closed form without sticking (1931), to 1e-10."""
    ratio = np.sin(np.pi / nu) / (nu * (1 + np.cos(np.pi / nu)))
    expected = np.sqrt(1 / (1 - nu**2) ** 2 - (limit * ratio) ** 2)
    block = vv.PolynomialSystem(mass=1, stiffness=1, forces=f"{limit}*sign(x_dot)")
    period = 2 * np.pi / nu
    run = vv.simulate(
        block, 400 * period, dt=period / 16, load={1: 1j}, nu=nu, keep="last", events="x_dot"
    )
    x = run.events[0].state[-2:, 0]
    assert abs(x[0] - x[1]) / 2 == pytest.approx(expected, abs=1e-10)


def test_block_on_a_slope_stays():
    """A force below the limit moves nothing; above it the acceleration is constant."""
    block = vv.PolynomialSystem(mass=2, forces="3*sign(x_dot)")
    held = vv.simulate(block, 10.0, load={0: 2.9j}, nu=1.0, dt=0.5)
    assert np.abs(held.state).max() == 0
    moves = vv.simulate(block, 10.0, load={0: 3.5j}, nu=1.0, dt=0.5)
    np.testing.assert_allclose(moves.state[:, 0], 0.125 * moves.t**2, rtol=1e-12)


def test_two_blocks_that_rub():
    """One friction force in two equations, as two texts: constant momentum, both stop."""
    blocks = vv.PolynomialSystem(
        mass=[1, 3],
        forces={"x1": "0.4*sign(x1_dot - x2_dot)", "x2": "0.4*sign(x2_dot - x1_dot)"},
    )
    run = vv.simulate(blocks, 12.0, initial=[0, 2.0, 0, 0], dt=0.1)
    v = run.state[:, 1::2]
    np.testing.assert_allclose(v @ [1, 3], 2.0, atol=1e-13)
    # The relative velocity decreases by 0.4 (1 + 1/3) per unit of time, from 2 to 0.
    np.testing.assert_allclose(
        v[:, 0] - v[:, 1], np.maximum(2 - 0.4 * 4 / 3 * run.t, 0), atol=1e-13
    )


def test_belt():
    """A block on a belt sticks until the spring force reaches the friction, and slips back."""
    block = vv.PolynomialSystem(
        mass=1, stiffness=1, forces="sign(x_dot - 0.5)/(1 + 2*abs(x_dot - 0.5))"
    )
    run = vv.simulate(block, 60.0, dt=0.05, events=["x_dot - 0.5", vv.Event("x", direction="up")])
    assert run.outcome == "completed"
    # A sticking block has the speed of the belt and is never faster.
    assert run.events[0].t.size == 0

    def again(t, y):
        return y[1] - 0.5

    again.terminal, again.direction = True, 1
    slip = solve_ivp(
        lambda t, y: [y[1], -y[0] + 1 / (2 - 2 * y[1])], (0, 30), [1.0, 0.5 - 1e-14], "DOP853",
        rtol=1e-13, atol=1e-14, events=again, max_step=0.02,
    )  # fmt: skip
    period = slip.t[-1] + (1 - slip.y[0, -1]) / 0.5
    passed = run.events[1].t
    assert passed.size > 5
    np.testing.assert_allclose(np.diff(passed[1:]), period, atol=1e-6)
    stuck = run.state[np.abs(run.state[:, 1] - 0.5) < 1e-12, 0]
    assert stuck.size > 50
    assert stuck.max() <= 1 + 1e-12


def test_goes_on_sticking_bit_for_bit():
    """A run divided while sticking, sliding or reversing equals the uninterrupted run."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="0.3*sign(x_dot)")
    whole = vv.simulate(system, 20.0, dt=0.1, load=0.5, nu=0.8)
    assert (np.abs(whole.state[1:, 1]) < 1e-12).sum() > 5
    for cut in (1.0, 3.7, 8.3, 12.0):
        part = vv.simulate(system, cut, dt=0.1, load=0.5, nu=0.8)
        again = vv.simulate(system, 20.0, resume=part)
        np.testing.assert_array_equal(again.state[-1], whole.state[-1])


def angle(sine, cosine, above):
    """The angle on one side of its cut, continued beyond."""
    if above:
        return np.pi / 2 + np.arctan2(-cosine, sine)
    return np.arctan2(cosine, -sine) - np.pi / 2


@pytest.mark.parametrize(
    "law", ["sin(1.5*sign(x))", "0.3*sin(1.5*sign(x))", "tanh(2*sign(x - 0.2))"]
)
def test_jumps_are_no_layers(law):
    """Steps end at a jump over 0 inside a function: no warning at a given step size."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces=law)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert vv.simulate(system, 10, initial=[1, 0], dt=0.05).outcome == "completed"
