"""Resumed runs: bitwise equal, under other loads, with an error estimate, or refused."""

import math
import pickle

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp
from referee.models import Swinging

WEIGHTS, RATES = np.array([0.1, 0.2]), np.array([0.7, 3.0])
PRONY = vv.PronyKernel(weights=WEIGHTS, rates=RATES)
SINGULAR = vv.RabotnovKernel(amplitude=0.3, alpha=0.3, beta=0.5)


def chain(rng, kernel):
    """Two masses in a row on a base, the first spring cubic, with or without memory."""
    k, c = rng.uniform(1, 5, 2), rng.uniform(0.05, 0.3, 2)
    links = np.array([[1.0, 0.0], [-1.0, 1.0]])
    body = vv.PolynomialSystem(
        mass=np.diag(rng.uniform(0.5, 2, 2)),
        stiffness=links.T @ np.diag(k) @ links,
        damping=links.T @ np.diag(c) @ links,
        base_direction=[1, 1],
        kernel=kernel,
        springs=[vv.Springs(forces={"x1": "0.2*x1^3"})],
    )
    return body


def motion(body, memory, parts):
    """The final state by SciPy: parts end at times, each with functions for load and base."""
    mass, stiffness, damping = body.mass, body.stiffness, body.damping
    y = np.zeros(8 if memory else 4)
    begin = 0.0
    for until, load, base in parts:

        def slope(t, y, load=load, base=base):
            place, rate = base(t)
            d, v = y[:2] - place, y[2:4] - rate
            pull = stiffness @ d + damping @ v - load(t)
            pull[0] += 0.2 * d[0] ** 3
            h = y[4:].reshape(-1, 2)
            if memory:
                pull -= stiffness @ (WEIGHTS @ h)
            a = -np.linalg.solve(mass, pull)
            return np.concatenate([y[2:4], a, (d - RATES[: len(h), np.newaxis] * h).ravel()])

        y = solve_ivp(slope, (begin, until), y, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
        begin = until
    return np.stack([y[:2], y[2:4]], axis=1).ravel()


def nothing(t):
    return np.zeros(2)


def still(t):
    return 0.0, 0.0


@pytest.mark.parametrize("memory", [None, "exponentials", "direct"])
def test_other_loads_act_from_there_on(memory):
    """Loads, tables of forces and of base motions, none: each against SciPy, with the past."""
    rng = np.random.default_rng(21)
    job = {} if memory is None else {"memory": memory}
    for _ in range(3):
        body = chain(rng, PRONY if memory else None)
        nu, size = rng.uniform(0.5, 2, 2)
        run = vv.simulate(body, 4, load=0.5, nu=1.1, **job)
        first = (4, lambda t: np.array([0.5 * math.sin(1.1 * t), 0]), still)
        table = vv.LoadTable(times=[4.5, 5.3, 6.1], values=[size, -1.0, 0.7])

        def pushed(t, table=table):
            return np.array([np.interp(t, table.times, table.values), 0])

        moved = vv.LoadTable(times=[4, 5.3], values=[0, size])
        phase = np.exp(-4j * nu)
        later = [
            (
                {"load": {1: [0, size]}, "nu": nu},
                [(8, lambda t, nu=nu, size=size: np.array([0, size * math.sin(nu * t)]), still)],
            ),
            ({"load": 0}, [(8, nothing, still)]),
            (
                {"force": table},
                [(4.5, nothing, still), (5.3, pushed, still), (6.1, pushed, still)]
                + [(8, nothing, still)],
            ),
            (
                {"base": moved},
                [
                    (5.3, nothing, lambda t, s=size: (s * (t - 4) / 1.3, s / 1.3)),
                    (8, nothing, lambda t, s=size: (s, 0.0)),
                ],
            ),
            (
                {"base": 0.3 * phase, "nu": nu},
                [
                    (
                        8,
                        nothing,
                        lambda t, nu=nu: (
                            0.3 * math.sin(nu * (t - 4)),
                            0.3 * nu * math.cos(nu * (t - 4)),
                        ),
                    )
                ],
            ),
        ]
        for loads, parts in later:
            more = vv.simulate(body, 8, resume=run, estimate_error=True, **loads)
            expected = motion(body, memory, [first, *parts])
            assert more.t[0] == run.t[-1]
            assert np.abs(more.state[0] - run.state[-1]).max() < 1e-14
            assert 0 < more.error < 1e-9
            assert np.abs(more.state[-1] - expected).max() < 1e-11 + 10 * more.error


@pytest.mark.parametrize("loads", ["force", "base", "load"])
def test_a_singular_kernel_sees_the_jump_to_another_load(loads):
    """Exponentials fitted for the jump agree with the whole past, for any step size."""
    body = chain(np.random.default_rng(22), SINGULAR)
    other = {
        "force": {"force": vv.LoadTable(times=[2, 3.123], values=[0.4, -0.3])},
        "base": {"base": vv.LoadTable(times=[2, 2.5], values=[0, 0.4])},
        "load": {"load": {1: 0.7j}, "nu": 2.0},
    }[loads]
    ends = []
    for memory, dt in (("exponentials", 0.25), ("exponentials", 0.125), ("direct", 0.25)):
        run = vv.simulate(body, 2, dt=dt, initial=[0.3, 0, 0, 0], memory=memory)
        more = vv.simulate(body, 4, resume=run, estimate_error=memory != "direct", **other)
        assert more.error is None or more.error < 1e-13
        ends.append(more.state[-1])
    assert np.abs(np.array(ends) - ends[-1]).max() < 1e-13


def test_times_may_be_chosen_where_steps_hold_several_states():
    body = chain(np.random.default_rng(3), PRONY)
    run = vv.simulate(body, 3, load=0.3, nu=1.0)
    assert run.step > run.t[1]
    all_kept = vv.simulate(body, 6, resume=run)
    some = vv.simulate(body, 6, resume=run, times=all_kept.t[[3, 8]])
    np.testing.assert_allclose(some.state, all_kept.state[[3, 8]], atol=1e-13)


def test_a_pendulum_goes_on_under_other_loads():
    rng = np.random.default_rng(23)
    for method in ("gauss8", "gauss3", "dop8", "verner9"):
        numbers = {"e": 0.1, "w2": rng.uniform(0.3, 0.5), "w3": 0.8, "c1": 0.02}
        before = vv.Pendulum(f0=0.02, p1=0.9, **numbers)
        after = vv.Pendulum(f0=0.04, p1=rng.uniform(0.5, 1.5), m01=0.01, p2=0.3, **numbers)
        for start in ([0.1, 0, 0.2, 0, 0.1, 0], [0.1, 0, 0, 0, 0, 0]):
            run = vv.simulate(before, 5, dt=0.1, initial=start, method=method)
            more = vv.simulate(after, 10, resume=run, estimate_error=True)
            y = start
            for body, span in ((before, (0, 5)), (after, (5, 10))):
                right = Swinging.of(body).right
                y = solve_ivp(right, span, y, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
            assert more.system == after
            assert np.abs(more.state[-1] - y).max() < 1e-11 + 5 * more.error
            assert more.error < 1e-6
        with pytest.raises(vv.InputError, match="system: must be that of the run"):
            vv.simulate(vv.Pendulum(e=0.1, w2=0.7, w3=0.8), 10, resume=run)


@pytest.mark.parametrize(
    ("kernel", "memory"),
    [(None, "auto"), (PRONY, "auto"), (PRONY, "direct"), (SINGULAR, "direct"), (SINGULAR, "auto")],
)
def test_bit_for_bit_where_it_is_said(kernel, memory):
    """Bitwise for equal steps without fitted kernels; else to the tolerance of the fit."""
    rng = np.random.default_rng(24)
    for _ in range(3):
        body = chain(rng, kernel)
        job = {"dt": 0.125, "memory": memory, "load": 0.3, "nu": 1.3, "initial": rng.normal(size=4)}
        whole = vv.simulate(body, 4, **job)
        first = vv.simulate(body, 1.5, **job)
        middle = vv.simulate(body, 2.25, resume=first)
        last = vv.simulate(body, 4, resume=middle)
        if kernel is SINGULAR and memory == "auto":
            assert np.abs(last.state - whole.state[18:]).max() < 1e-12
        else:
            assert (last.state == whole.state[18:]).all()
            assert last.resolution == whole.resolution


def test_a_run_read_back_goes_on():
    body = chain(np.random.default_rng(27), PRONY)
    run = vv.simulate(body, 2, dt=0.125, force=vv.LoadTable(times=[0, 1], values=[0, 1.0]))
    read = pickle.loads(pickle.dumps(run))
    for job in ({}, {"load": 0.3, "nu": 1.0}, {"estimate_error": True}):
        one, other = (vv.simulate(body, 4, resume=start, **job) for start in (run, read))
        assert (one.state == other.state).all()


def test_the_estimate_is_that_of_the_whole_run():
    """From the first start: the error of the earlier part is included."""
    body = chain(np.random.default_rng(25), PRONY)
    job = {"dt": 0.5, "method": "gauss2", "load": 0.5, "nu": 1.1, "initial": [0.4, 0, 0.2, 0]}
    whole = vv.simulate(body, 10, estimate_error=True, **job)
    first = vv.simulate(body, 5, **job)
    rest = vv.simulate(body, 10, resume=first, estimate_error=True)
    assert rest.error == pytest.approx(
        np.abs(whole.state[10:] - vv.simulate(body, 10, **(job | {"dt": 0.25})).state[20::2]).max(),
        rel=1e-9,
    )
    assert rest.error <= whole.error
    assert "from the first start on" in str(rest.plan)


def test_a_base_goes_on_from_where_it_was():
    body = chain(np.random.default_rng(26), PRONY)
    run = vv.simulate(body, 5, base=vv.LoadTable(times=[1, 2], values=[0, 0.5]))
    with pytest.raises(vv.InputError, match=r"base: is at 0 at t = 5, must go on from 0.5"):
        vv.simulate(body, 8, resume=run, load=1.0, nu=1.0)
    vv.simulate(body, 8, resume=run, base=vv.LoadTable(times=[5, 6], values=[0.5, 0.0]))
    plain = vv.PolynomialSystem(mass=1, stiffness=4, base_direction=[1])
    explicit = vv.simulate(plain, 5, dt=0.1, method="dop8", initial=[1, 0])
    with pytest.raises(vv.InputError, match="with method 'dop8' a moving base"):
        vv.simulate(plain, 8, resume=explicit, base=vv.LoadTable(times=[5, 6], values=[0, 1.0]))


@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
@pytest.mark.parametrize(
    "kernel",
    [
        vv.RzhanitsynKernel(amplitude=0.05, alpha=0.3, beta=0.01),
        vv.RabotnovKernel(amplitude=0.05, alpha=0.5, beta=0.1),
        vv.AbelKernel(amplitude=0.02, alpha=0.4),
    ],
)
def test_a_kernel_fitted_for_a_short_run_serves_one_a_hundred_times_as_long(kernel):
    body = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, kernel=kernel, forces="x^3")
    job = {"dt": 0.125, "load": 0.3, "nu": 1.3, "initial": [0.5, 0]}
    whole = vv.simulate(body, 99, **job)
    first = vv.simulate(body, 1, **job)
    run = first
    for end in (2, 25, 99):
        run = vv.simulate(body, end, resume=run)
        assert np.abs(run.state[-1] - whole.state[8 * end]).max() < 1e-12
    assert np.abs(vv.simulate(body, 99, resume=first).state - whole.state[8:]).max() < 1e-12
    with pytest.raises(
        vv.InputError, match="t_end = 101: a run made for t_end = 1 may go on to 100"
    ):
        vv.simulate(body, 101, resume=first)


@pytest.mark.parametrize("seed", range(2))
def test_other_loads_leave_no_coordinate_behind(seed):
    """Two uncoupled masses move as separate masses, whichever is loaded."""
    rng = np.random.default_rng(seed)
    k, f = rng.uniform(1, 3, 2), rng.uniform(0.05, 0.2, 2)
    kinds, *loaded = rng.integers(0, 2, (3, 2))
    begin = rng.integers(0, 2, (2, 2)) * rng.uniform(-0.5, 0.05, (2, 2))
    first, then = loaded * rng.uniform(0.2, 1, (2, 2))

    def element(on, i):
        if kinds[i]:
            return vv.Gap(on=on, stiffness=k[i], gap=f[i])
        return vv.Jenkins(on=on, stiffness=k[i], limit=f[i])

    def run(places):
        system = vv.Structure(
            mass=np.ones(len(places)), stiffness=k[places], damping=0.1 * k[places],
            elements=[element(f"x{j + 1}", i) for j, i in enumerate(places)],
        )  # fmt: skip
        start = begin[places].ravel()
        before = vv.simulate(system, 2, dt=0.02, initial=start, load=first[places], nu=1.1)
        return vv.simulate(system, 5, resume=before, load=then[places], nu=1.7).state[-1]

    np.testing.assert_allclose(run([0, 1]), np.concatenate([run([0]), run([1])]), atol=1e-12)


RUBBER = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)


@pytest.mark.parametrize("kind", ["linear", "memory", "cubic", "kink", "structure"])
def test_runs_whose_step_was_found_go_on_to_any_time(kind):
    rng = np.random.default_rng(len(kind))
    chain = 2 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1)
    one = {"mass": 1, "stiffness": 1, "damping": 0.1}
    system = {
        "linear": lambda: vv.PolynomialSystem(**one),
        "memory": lambda: vv.PolynomialSystem(**one, forces="0.5*x^3", kernel=RUBBER),
        "cubic": lambda: vv.PolynomialSystem(**one, forces="0.5*x^3"),
        "kink": lambda: vv.PolynomialSystem(**one, forces="0.5*max(x - 0.1, 0)"),
        "structure": lambda: vv.Structure(
            mass=np.eye(3), stiffness=chain, damping=0.05 * chain,
            elements=[vv.Spring(on="x3", law="0.5*d^3")],
        ),
    }[kind]()  # fmt: skip
    load = {"x1": 0.3} if kind == "structure" else 0.3
    first, middle, last = np.cumsum(rng.uniform(1, 4, 3))
    whole = vv.simulate(system, last, load=load, nu=1.1)
    run = vv.simulate(system, first, load=load, nu=1.1)
    for end in (middle, last):
        run = vv.simulate(system, end, resume=run)
        assert run.t[-1] == run.t_reached == end
    assert run.state[-1] == pytest.approx(whole.state[-1], abs=1e-9)
    other = vv.simulate(system, last + 0.7123, resume=run, load=load, nu=0.9, keep="last")
    assert other.t[-1] == last + 0.7123
    with pytest.raises(vv.InputError, match="must be greater than"):
        vv.simulate(system, middle, resume=run)
    given = vv.simulate(system, 1.0, dt=0.1, load=load, nu=1.1)
    with pytest.raises(vv.InputError, match=r"a whole number of steps 0\.1"):
        vv.simulate(system, 1.23, resume=given)


def test_the_last_time_is_the_end_itself():
    """Not the rounded product of steps and step size."""
    rng = np.random.default_rng(3)
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1)
    for i in range(40):
        end = float(rng.uniform(0.1, 100))
        run = vv.simulate(system, end, dt=end / rng.uniform(2, 300), initial=[1, 0])
        assert run.t[-1] == run.t_reached == end
        n = int(rng.integers(1, 9))
        later = vv.simulate(system, end + n * run.step, resume=run, keep=("all", "last")[i % 2])
        assert later.t[-1] == later.t_reached == end + n * run.step


def test_any_end_may_be_gone_on_from():
    """For any last digit of its end time: steps times step size may exceed the end."""
    system = vv.Structure(
        mass=[2.0, 0.7], stiffness=[[1.99, -0.79], [-0.79, 2.19]], rayleigh=(0.01, 0.01),
        elements=[vv.Spring(on="x2", law="0.3*d^3")],
    )  # fmt: skip
    for end in np.random.default_rng(5).uniform(3, 9, 20).round(2):
        run = vv.simulate(system, end, load={"x1": 0.1}, nu=0.7, tolerance=1e-7, method="gauss4")
        more = vv.simulate(system, 2 * end, resume=run)
        assert more.t[0] == pytest.approx(end, rel=1e-15)
        assert more.t[-1] == 2 * end
