"""Load tables in time: every corner and jump is resolved, by every method and with memory."""

import itertools
import math

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.linalg import expm

WEIGHTS, RATES = np.array([0.1, 0.2]), np.array([0.7, 3.0])


def oscillator(kernel=None, cubic=0.0):
    forces = {"springs": [vv.Springs(forces=f"{cubic}*x^3")]} if cubic else {}
    return vv.PolynomialSystem(mass=1, stiffness=4, damping=0.1, kernel=kernel, **forces)


def reference(table, end, *, memory=False, cubic=0.0):
    """The motion from rest; each piece of the table is integrated separately."""
    times = np.asarray(table.times)
    ends = np.concatenate([[0.0], times[(times > 0) & (times < end)], [end]])
    weights, rates = (WEIGHTS, RATES) if memory else (np.zeros(0), np.zeros(0))
    y = np.zeros(2 + weights.size)
    for begin, until in itertools.pairwise(ends):
        inside = np.nextafter(begin, until), np.nextafter(until, begin)

        def slope(t, y, inside=inside):
            force = float(table(np.clip(t, *inside)))
            pull = 4 * (y[0] - weights @ y[2:]) + cubic * y[0] ** 3 + 0.1 * y[1]
            return np.concatenate([[y[1], force - pull], y[0] - rates * y[2:]])

        run = solve_ivp(
            slope, (begin, until), y, method="DOP853", rtol=1e-12, atol=1e-14, max_step=0.3
        )
        y = run.y[:, -1]
    return y[:2]


def exact(table, end, memory):
    """The linear oscillator by matrix exponentials on each piece."""
    times, values = np.asarray(table.times), np.asarray(table.values)
    weights, rates = (WEIGHTS, RATES) if memory else (np.zeros(0), np.zeros(0))
    n = 2 + weights.size
    matrix = np.zeros((n + 4, n + 4))
    matrix[0, 1] = 1
    matrix[1, :2] = -4, -0.1
    matrix[1, 2:n] = 4 * weights
    matrix[2:n, 0] = 1
    matrix[2:n, 2:n] = -np.diag(rates)
    # Force, its slope, curvature and third derivative, which is constant on a piece.
    matrix[1, n] = matrix[n, n + 1] = matrix[n + 1, n + 2] = matrix[n + 2, n + 3] = 1
    if table.interpolation == "cubic":
        third, second, first, zeroth = CubicSpline(times, values).c
    else:
        zeroth, first = values[:-1], np.diff(values) / np.diff(times)
        second = third = np.zeros(zeroth.size)
    y, now = np.zeros(n), 0.0
    for i in range(times.size - 1):
        y = (expm(matrix * (times[i] - now)) @ np.append(y, np.zeros(4)))[:n]
        force = [zeroth[i], first[i], 2 * second[i], 6 * third[i]]
        y = (expm(matrix * (times[i + 1] - times[i])) @ np.append(y, force))[:n]
        now = times[i + 1]
    return (expm(matrix * (end - now)) @ np.append(y, np.zeros(4)))[:2]


def pulse(rng, length):
    times = rng.uniform(0, 9) + length * np.linspace(0, 1, 9)
    shape = np.sin(np.linspace(0, np.pi, 9))
    kind = rng.choice(["linear", "cubic"])
    return vv.LoadTable(times=times, values=shape / length, interpolation=kind)


def broken(rng):
    """A table with corners at random times, and jumps at its ends."""
    times = np.sort(rng.uniform(-1, 9, rng.integers(2, 7)))
    return vv.LoadTable(times=times, values=rng.normal(size=times.size))


@pytest.mark.parametrize(
    "value",
    [
        vv.LoadTable(times=np.arange(500.0), values=np.ones((500, 6))),
        vv.Past(times=np.arange(-499.0, 1), displacements=np.ones((500, 2))),
    ],
)
def test_a_long_table_is_printed_in_a_line(value):
    assert len(repr(value)) < 200
    assert "500 numbers" in repr(value)


@pytest.mark.parametrize("length", [0.001, 0.005, 0.011])
def test_no_short_pulse_is_missed(length):
    rng = np.random.default_rng(int(1e4 * length))
    prony = vv.PronyKernel(weights=WEIGHTS, rates=RATES)
    for i in range(20):
        table, memory = pulse(rng, length), bool(i % 2)
        run = vv.simulate(oscillator(prony if memory else None), 10, force=table)
        expected = exact(table, 10, memory)
        assert run.outcome == "completed"
        assert 0 < run.error <= 1e-10
        assert np.abs(run.state[-1] - expected).max() < 3e-11


@pytest.mark.parametrize("method", ["gauss8", "gauss16", "gauss3", "dop8", "verner9", "rk4"])
def test_random_tables_by_every_method(method):
    rng = np.random.default_rng(3)
    tolerance = 1e-6 if method == "rk4" else 1e-10
    for _ in range(5):
        table = broken(rng)
        system = oscillator(cubic=0.3)
        run = vv.simulate(system, 10, force=table, method=method, tolerance=tolerance)
        assert np.abs(run.state[-1] - reference(table, 10, cubic=0.3)).max() <= tolerance


@pytest.mark.parametrize("memory", ["exponentials", "direct"])
def test_random_tables_with_memory(memory):
    rng = np.random.default_rng(4)
    system = oscillator(vv.PronyKernel(weights=WEIGHTS, rates=RATES), cubic=0.3)
    for _ in range(5):
        table = broken(rng)
        run = vv.simulate(system, 10, force=table, memory=memory)
        # The cubic spring has no memory.
        assert run.outcome == "completed"
        assert run.error <= 1e-10
        coarse = vv.simulate(system, 10, force=table, memory=memory, dt=0.2)
        assert np.abs(run.state[-1] - coarse.state[-1]).max() < 2e-10


def test_a_jump_inside_a_table_hides_no_corner():
    """Two very close times give large slopes, relative to which all others are negligible."""
    rng = np.random.default_rng(6)
    prony = vv.PronyKernel(weights=WEIGHTS, rates=RATES)
    for i in range(12):
        times = np.sort(rng.uniform(0, 9, 6))
        j, gap = int(rng.integers(6)), 10 ** rng.uniform(-13, -9)
        table = vv.LoadTable(
            times=np.insert(times, j + 1, times[j] + gap), values=rng.normal(size=7)
        )
        memory = bool(i % 2)
        run = vv.simulate(oscillator(prony if memory else None), 10, force=table)
        assert np.abs(run.state[-1] - exact(table, 10, memory)).max() < 1e-10


def test_order_is_kept_through_corners_and_jumps():
    table = vv.LoadTable(times=[0.777, 1.2345, 2.31], values=[1.0, -0.5, 0.8])
    right = reference(table, 4)
    for method, order in (("rk4", 4), ("gauss2", 4), ("gauss3", 6), ("dop8", 8)):
        coarse, fine = (0.2, 0.05) if order < 8 else (0.5, 0.125)
        errors = [
            np.abs(
                vv.simulate(oscillator(), 4, dt=dt, force=table, method=method).state[-1] - right
            ).max()
            for dt in (coarse, fine)
        ]
        assert math.log(errors[0] / errors[1], 4) > order - 0.5


def test_order_is_kept_where_a_singular_kernel_remembers_a_jump():
    """After a jump accelerations change like t^(2+alpha), which is not smooth."""
    system = oscillator(vv.RabotnovKernel(amplitude=0.05, alpha=0.3, beta=0.5), cubic=0.3)
    table = vv.LoadTable(times=[0.777, 1.2345, 2.31], values=[1.0, -0.5, 0.8])
    states = [vv.simulate(system, 4, dt=dt, force=table).state[-1] for dt in (0.4, 0.2, 0.05)]
    assert np.abs(states[0] - states[2]).max() < 1e-12
    assert np.abs(states[1] - states[2]).max() < 1e-13


def test_records_and_boxes_need_no_help():
    rng = np.random.default_rng(5)
    record = vv.LoadTable(times=0.01 * np.arange(100), values=rng.normal(size=100))
    box = vv.LoadTable(times=[1.2345, 1.7], values=[1.0, 1.0])
    for table in (record, box):
        run = vv.simulate(oscillator(), 5, force=table)
        assert np.abs(run.state[-1] - reference(table, 5)).max() < 1e-10
        assert np.all(np.diff(run.t) > 0)
        assert run.t[-1] == 5


def test_runs_go_on_through_breaks():
    prony = vv.PronyKernel(weights=WEIGHTS, rates=RATES)
    table = vv.LoadTable(times=[0.777, 1.2345, 3.31], values=[1.0, -0.5, 0.8])
    for system in (oscillator(), oscillator(prony)):
        whole = vv.simulate(system, 5, dt=0.1, force=table)
        first = vv.simulate(system, 1.5, dt=0.1, force=table)
        second = vv.simulate(system, 5, resume=first)
        assert np.abs(second.state[-1] - whole.state[-1]).max() < 1e-12


def test_given_steps_keep_states_at_equal_times():
    table = vv.LoadTable(times=[0.777, 1.2345], values=[1.0, -0.5])
    run = vv.simulate(oscillator(), 3, dt=0.1, force=table)
    assert np.allclose(run.t, 0.1 * np.arange(31), atol=1e-14)
    tail = vv.simulate(oscillator(), 3, dt=0.1, force=table, keep="tail", tail=1.0)
    assert (tail.state == run.state[-tail.t.size :]).all()
    last = vv.simulate(oscillator(), 3, dt=0.1, force=table, keep="last")
    assert (last.state[0] == run.state[-1]).all()
    some = vv.simulate(oscillator(), 3, dt=0.1, force=table, save_every=5)
    assert (some.state == run.state[::5]).all()


@pytest.mark.parametrize("kernel", [None, vv.PronyKernel(weights=[0.1], rates=[1.0])])
def test_the_plan_names_a_table_that_acts(kernel):
    body = vv.PolynomialSystem(mass=1.0, stiffness=4.0, kernel=kernel)
    table = vv.LoadTable(times=[0, 1, 2.5], values=[0.0, 1.0, 0.0])
    plan = str(vv.simulate(body, 5, force=table).plan)
    assert "computes: force by a table of 3 times, 0 to 2.5" in plan
    assert "there is none" not in plan
    assert "there is none" in str(vv.simulate(body, 5, initial=[1.0, 0.0]).plan)
