"""Events and dense output of motions in time, against SciPy and exact motions."""

import math

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

DUFFING = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="x^3")
START = [0.3, 0.8]


def duffing(t, y):
    return [y[1], 0.5 * np.sin(1.2 * t) - 0.1 * y[1] - y[0] - y[0] ** 3]


@pytest.mark.parametrize("method", ["gauss8", "gauss16", "gauss3", "rk4", "verner9"])
def test_events_of_a_duffing_oscillator(method):
    """Times and states against SciPy, by every method."""

    def level(t, y):
        return y[0] - 0.1

    def turn(t, y):
        return y[1]

    def mixed(t, y):
        return y[0] * y[1] - 0.2 * np.sin(t)

    turn.direction = -1
    expected = solve_ivp(
        duffing, (0, 25), START, "DOP853", rtol=1e-13, atol=1e-14, max_step=0.02,
        events=[level, turn, mixed],
    )  # fmt: skip
    run = vv.simulate(
        DUFFING, 25.0, initial=START, load=0.5, nu=1.2, method=method,
        events=["x - 0.1", vv.Event("x_dot", direction="down"), "x*x_dot - 0.2*sin(t)"],
        **({"dt": 2e-3} if method in ("rk4", "gauss3") else {"dt": 0.1}),
    )  # fmt: skip
    atol = 1e-9 if method in ("rk4", "gauss3") else 2e-12
    assert [e.t.size for e in run.events] == [t.size for t in expected.t_events]
    for found, t, y in zip(run.events, expected.t_events, expected.y_events, strict=True):
        np.testing.assert_allclose(found.t, t, atol=atol)
        np.testing.assert_allclose(found.state, y, atol=atol)


def test_terminal_event_ends_the_run():
    """The final state is that of the event; later states are not stored."""
    stop = vv.Event("x + 0.2", direction="down", terminal=True)
    run = vv.simulate(
        DUFFING, 25.0, initial=START, load=0.5, nu=1.2, events=[stop, "x_dot"],
        times=np.linspace(0, 25, 51),
    )  # fmt: skip

    def passed(t, y):
        return y[0] + 0.2

    passed.terminal, passed.direction = True, -1
    expected = solve_ivp(
        duffing, (0, 25), START, "DOP853", rtol=1e-13, atol=1e-14, events=passed, max_step=0.05
    )
    assert run.outcome == "event"
    assert run.complete
    assert run.t_reached == pytest.approx(expected.t[-1], abs=1e-10)
    assert run.events[0].t == pytest.approx([expected.t[-1]], abs=1e-10)
    assert run.t[-1] <= run.t_reached
    assert (run.events[1].t < run.t_reached).all()
    last = vv.simulate(DUFFING, 25.0, initial=START, load=0.5, nu=1.2, events=[stop], keep="last")
    np.testing.assert_allclose(last.state[-1], expected.y[:, -1], atol=1e-9)


def test_events_with_memory_and_of_structures():
    """Located by the polynomial of the step: the function is 0 and states are at the times."""
    kernel = vv.PronyKernel(weights=[0.3], rates=[1.0])
    memory = vv.PolynomialSystem(mass=1, stiffness=2, damping=0.1, kernel=kernel, forces="x^3")
    chain = vv.Structure(
        mass=np.eye(2), stiffness=[[2.0, -1], [-1, 2]], damping=0.1 * np.eye(2),
        elements=[vv.Spring(on="x1", law="d^3")],
    )  # fmt: skip
    for system, name, load in ((memory, "x", 0.5), (chain, "x2", [0.5, 0])):
        run = vv.simulate(system, 20.0, load=load, nu=1.1, events=[f"{name} - 0.1", f"{name}_dot"])
        place = list(system.dof_names).index(name)
        assert run.events[0].t.size > 3
        np.testing.assert_allclose(run.events[0].state[:, 2 * place], 0.1, atol=1e-12)
        np.testing.assert_allclose(run.events[1].state[:, 2 * place + 1], 0, atol=1e-12)
        again = vv.simulate(system, 20.0, load=load, nu=1.1, dt=run.step, times=run.events[0].t)
        np.testing.assert_allclose(again.state, run.events[0].state, atol=1e-9)
        sign = np.sign(run.coordinate(name) - 0.1)
        assert run.events[0].t.size >= (np.diff(sign) != 0).sum()
        np.testing.assert_allclose(run(run.events[0].t), again.state, atol=1e-9)


def test_events_of_a_pendulum_that_goes_on():
    """A run in two parts finds the events of the whole run."""
    body = vv.Pendulum(
        e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01, f0=0.02, p1=1.02
    )
    start = [0.1, 0, 0.2, 0, 0.1, 0]
    call = {"dt": 0.25, "events": ["z", "phi_dot - psi"]}
    whole = vv.simulate(body, 60.0, initial=start, **call)
    part = vv.simulate(body, 25.0, initial=start, **call)
    rest = vv.simulate(body, 60.0, resume=part)
    for i in range(2):
        both = np.concatenate([part.events[i].t, rest.events[i].t])
        np.testing.assert_allclose(both, whole.events[i].t, atol=1e-12)


def test_dense_output_has_the_order_of_the_method():
    """States between steps are as accurate as at step ends."""
    expected = solve_ivp(
        duffing, (0, 25), START, "DOP853", rtol=1e-13, atol=1e-14, dense_output=True
    ).sol
    t = np.array([24.9, 0.0, 3.33, 3.34, 17.123, 25.0])
    run = vv.simulate(DUFFING, 25.0, initial=START, load=0.5, nu=1.2, dt=0.25)
    np.testing.assert_allclose(run(t), expected(t).T, atol=1e-10)
    np.testing.assert_allclose(run(3.33), expected(3.33), atol=1e-10)
    errors = [
        np.abs(
            vv.simulate(DUFFING, 25.0, initial=START, load=0.5, nu=1.2, dt=dt, method="gauss3")(t)
            - expected(t).T
        ).max()
        for dt in (0.1, 0.05)
    ]
    assert np.log2(errors[0] / errors[1]) > 5.5
    longer = vv.simulate(DUFFING, 30.0, resume=run)
    np.testing.assert_allclose(longer(t), expected(t).T, atol=1e-10)


def test_bad_events():
    """One-line messages that name the argument."""
    for events, words in (
        (["y - 1"], "'y'"),
        (["1 + 2"], "depends on no quantity"),
        ([3], "must be a text or an Event"),
        ([], "1 to 100"),
        (["x -"], r"events\[0\]"),
    ):
        with pytest.raises(vv.InputError, match=words):
            vv.simulate(DUFFING, 1.0, dt=0.1, events=events)
    with pytest.raises(vv.InputError, match="direction"):
        vv.Event("x", direction="left")
    run = vv.simulate(DUFFING, 1.0, dt=0.1, initial=START)
    with pytest.raises(vv.InputError, match=r"t = 1\.5"):
        run(1.5)


@pytest.mark.parametrize("structure", [False, True])
def test_the_first_step_with_memory(structure):
    """Velocities and events inside the singular first step, against small steps and SciPy.

    The first panels are 1e-13 of the step, where differences of displacements give no velocity.
    """
    memory = vv.PronyKernel(weights=[0.1], rates=[0.5])
    if structure:
        spring = vv.Spring(on="x1", stiffness=1, kernel=memory)
        block = vv.Structure(mass=[1.0], stiffness=[0.0], damping=[0.05], elements=[spring])
    else:
        block = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, kernel=memory)
    name = "x1" if structure else "x"
    times = np.r_[np.geomspace(1e-14, 0.5, 40), 1.0]

    def rates(t, y):
        return [y[1], y[2] - y[0] - 0.05 * y[1], 0.1 * y[0] - 0.5 * y[2]]

    exact = solve_ivp(
        rates, (0, 1), [1, 0.3, 0], "DOP853", t_eval=times, rtol=1e-13, atol=1e-15, max_step=0.05,
        events=[lambda t, y: y[1], lambda t, y: y[0] - 1.001],
    )  # fmt: skip
    run = vv.simulate(
        block, 1.0, initial=[1, 0.3], dt=0.5, times=times, tolerance=1e-13,
        events=[f"{name}_dot", f"{name} - 1.001"],
    )  # fmt: skip
    np.testing.assert_allclose(run.state, exact.y[:2].T, atol=2e-12)
    for event, expected in zip(run.events, exact.t_events, strict=True):
        np.testing.assert_allclose(event.t, expected, atol=2e-12)


def chain_of(n, rng, *, modal, kernel=None):
    """Return a chain with a cubic spring at its first mass, and its damping."""
    stiffness = 40.0 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    damping = 0.002 * stiffness
    if not modal:
        damping = damping + np.diag(rng.uniform(0, 0.1, n))
    spring = vv.Spring(on="x1", law="30*d^3", kernel=kernel)
    system = vv.Structure(
        mass=np.eye(n), stiffness=stiffness, damping=damping, elements=[spring],
        names=[f"x{i + 1}" for i in range(n)],
    )  # fmt: skip
    return system, stiffness, damping


@pytest.mark.parametrize(
    ("modal", "memory", "step"),
    [(True, False, {"dt": 0.02}), (False, True, {"dt": 0.02}), (True, True, {"tolerance": 1e-11})],
)
def test_places_in_steps_of_structures(modal, memory, step):
    """Many events per step, with stored maps: modes, residual, loads, memory, against SciPy."""
    n, rng = 6, np.random.default_rng(4)
    w, r = (0.3, 0.8) if memory else (0.0, 1.0)
    kernel = vv.PronyKernel(weights=[w], rates=[r]) if memory else None
    system, stiffness, damping = chain_of(n, rng, modal=modal, kernel=kernel)
    push, start = rng.normal(size=n), np.zeros(2 * n)
    start[1::2] = rng.normal(size=n) * 0.3
    signals = {
        "x3_dot": lambda t, y: y[n + 2],
        "x1 - 0.02": lambda t, y: y[0] - 0.02,
        "x2*x5 - 0.001*(t + 1)": lambda t, y: y[1] * y[4] - 0.001 * (t + 1),
    }

    def rhs(t, y):
        force = stiffness @ y[:n] + damping @ y[n : 2 * n] - push * np.sin(3.1 * t)
        pull = 30 * y[0] ** 3
        force[0] += pull - w * y[-1]
        return np.concatenate([y[n : 2 * n], -force, [pull - r * y[-1]]])

    first = np.concatenate([start[::2], start[1::2], [0.0]])
    true = solve_ivp(
        rhs, (0, 12), first, method="DOP853", rtol=1e-12, atol=1e-13, max_step=0.02,
        events=list(signals.values()),
    )  # fmt: skip
    run = vv.simulate(system, 12, load=push, nu=3.1, initial=start, events=list(signals), **step)
    for found, times, states in zip(run.events, true.t_events, true.y_events, strict=True):
        assert found.t.size == times.size > 5
        np.testing.assert_allclose(found.t, times, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.state[:, ::2], states[:, :n], rtol=0, atol=1e-9)


@pytest.mark.parametrize("structure", [False, True])
def test_edges_of_functions_are_no_passages(structure):
    """The boundary of the domain of an event function is not an event."""
    if structure:
        system = vv.Structure(mass=[1], stiffness=[[1]], names=["x"])
    else:
        system = vv.PolynomialSystem(mass=1, stiffness=1)
    rng = np.random.default_rng(8)
    for _ in range(6):
        # x = cos(t) is in the domain down to -a; the function is 0 at c.
        a, c = float(rng.uniform(-0.5, 0.5)), float(rng.uniform(0.6, 0.9))
        for function in (
            f"sqrt(x + ({a})) - sqrt({c} + ({a}))",
            f"log((x + ({a}))/({c} + ({a})))",
            f"sqrt({c} + ({a})) - sqrt(x + ({a}))",
            f"asin(x + ({a}) - 1) - asin({c} + ({a}) - 1)",
        ):
            run = vv.simulate(system, 12, initial=[1, 0], dt=0.1, events=function)
            first = math.acos(c)
            true = [first, 2 * math.pi - first, 2 * math.pi + first, 4 * math.pi - first]
            assert run.events[0].t == pytest.approx([t for t in true if t < 12], abs=1e-8)


@pytest.mark.parametrize("steps", [20, 60, 180])
def test_a_run_that_needs_more_room_for_its_past_begins_anew(steps):
    """Regression: a restarted run kept the signs of its end: a false event at t = 0 ended it."""
    one = vv.PronyKernel(weights=[0.3], rates=[1.0])
    stiffness = [[2.3, -1.0, 0.0], [-1.0, 2.3, -1.0], [0.0, -1.0, 2.3]]
    system = vv.PolynomialSystem(
        mass=np.ones(3), damping=0.07 * np.eye(3), names=["x", "y", "z"],
        springs=[vv.Springs(stiffness=stiffness, kernel=one)],
    )  # fmt: skip
    call = {"initial": [-0.2, 0, -0.2, 0, -0.2, 0], "dt": 3.8 / steps}
    events = [vv.Event("y + 0.085"), vv.Event("y_dot - 0.1", direction="up"), "x - z + 0.01"]
    direct, brief = (
        vv.simulate(system, 3.8, events=events, memory=memory, **call)
        for memory in ("direct", "exponentials")
    )
    assert [found.t.size for found in direct.events] == [1, 1, 0]
    for found, true in zip(direct.events, brief.events, strict=True):
        np.testing.assert_allclose(found.t, true.t, atol=1e-6)
    ends = [vv.Event("y - 0.01", direction="down", terminal=True)]
    assert vv.simulate(system, 1.9, events=ends, memory="direct", **call).outcome == "completed"


@pytest.mark.parametrize("restitution", [0.6, 0.9, 1.0])
def test_impacts_are_events_with_a_name(restitution):
    """Free motion from (0, 1) with a rigid stop: x = g cos(s) - e v sin(s) between impacts."""
    rng = np.random.default_rng(int(10 * restitution))
    for side in (1, -1, 0):
        gap = float(rng.uniform(0.05, 0.4))
        stop = (vv.Stop if side == 0 else vv.Gap)(
            on={"x2": float(side or 1)}, gap=gap, restitution=restitution
        )
        body = vv.Structure(
            mass=[2, 1], stiffness=[3, 1], elements=[vv.Spring(on="x1", law="d^3"), stop]
        )
        start = [0.2, 0, 0, 1.0 if side >= 0 else -1.0]
        run = vv.simulate(body, 30, initial=start, events=["impact", "x1", "impact[1]"])
        times, rates = [np.arcsin(gap)], [restitution * np.cos(np.arcsin(gap))]
        while side and times[-1] < 30:
            times.append(times[-1] + 2 * (np.pi - np.arctan(rates[-1] / gap)))
            rates.append(restitution * rates[-1])
        if side == 0:
            # From one stop to the other, g cos(s) - v sin(s) = -g, while the energy suffices.
            while times[-1] < 30:
                v = rates[-1]
                size, phase = np.hypot(gap, v), np.arctan2(v, gap)
                times.append(times[-1] + np.arccos(-gap / size) - phase)
                rates.append(restitution * v)
        n = int((np.array(times) < 30).sum())
        assert run.events[0].t == pytest.approx(times[:n], abs=1e-8)
        assert run.events[2].t == pytest.approx(times[:n], abs=1e-8)
        assert np.abs(run.events[0].state[:, 3]) == pytest.approx(rates[:n], abs=1e-8)
        assert run.events[1].t.size > 0


def test_an_impact_without_a_rigid_stop_is_refused():
    stops = [vv.Stop(on="x1", gap=g, restitution=0.5) for g in (0.1, 0.2)]
    job = {"load": {"x1": 0.1}, "nu": 0.9}
    soft = vv.Structure(mass=[1], stiffness=[1], elements=[vv.Stop(on="x1", gap=1, stiffness=5)])
    with pytest.raises(vv.InputError, match="no element is a rigid stop"):
        vv.simulate(soft, 5, events=["impact"], **job)
    two = vv.Structure(mass=[1], stiffness=[1], elements=stops)
    with pytest.raises(vv.InputError, match=r"must be impact\[0\], impact\[1\]"):
        vv.simulate(two, 5, events=["impact"], **job)
    with pytest.raises(vv.InputError, match="must not be terminal"):
        vv.simulate(two, 5, events=[vv.Event("impact[0]", terminal=True)], **job)


def test_a_function_without_any_value_is_reported(recwarn):
    system = vv.PolynomialSystem(mass=1, stiffness=1)
    run = vv.simulate(system, 5, initial=[1, 0], events=["log(x - 2)", "x"])
    assert run.events[0].t.size == 0
    assert run.events[1].t.size == 2
    reported = [str(one.message) for one in recwarn]
    assert len(reported) == 1
    assert "events[0] = 'log(x - 2)': has no value on the whole run" in reported[0]
