"""Pendulums at their pivot: the end of a run does not depend on method or outputs."""

import math

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp
from referee.models import Swinging
from referee.pivots import reached

METHODS = ("gauss8", "gauss2", "verner9", "dop8", "rk4")


def thrown(rng, damping):
    """Return a pendulum thrown towards its pivot."""
    body = Swinging(
        e=0.1, w2=0.4, w3=0.8, f0=0.3, p1=1.0, c1=0.01, c2=damping, c3=0.01,
    )  # fmt: skip
    start = [-0.5, float(rng.uniform(-1.5, -0.8)), float(rng.uniform(0.01, 0.6)), 0.0, 0.0, 0.0]
    return body, start


@pytest.mark.parametrize("damping", [0.0, 1e-3, 0.02, 0.1, 0.5, 2.0])
def test_the_end_depends_neither_on_the_method_nor_on_events_nor_on_lanes(damping):
    """Without damping a motion passes its pivot; with strong damping it is stiff there."""
    rng = np.random.default_rng(int(1000 * damping))
    seen = set()
    for _ in range(3):
        body, start = thrown(rng, damping)
        pendulum = eval(body.source)
        when, _ = reached(body, start, 1.5)
        outcome = "unphysical" if math.isfinite(when) else "completed"
        seen.add(outcome)
        for method in METHODS:
            step = 0.01 if method in ("gauss2", "rk4") else 0.02
            job = {"initial": start, "dt": step, "method": method}
            plain = vv.simulate(pendulum, 1.5, **job)
            watched = vv.simulate(pendulum, 1.5, events=["phi", "z + 0.5"], **job)
            timed = vv.simulate(pendulum, 1.5, times=np.linspace(0.1, 1.5, 41), **job)
            found = [(run.outcome, run.t_reached) for run in (plain, watched, timed)]
            job["initial"] = [start, [0.5 * x for x in start]]
            for more in ({}, {"lyapunov": True}):
                # Verner8, verner9 and Gauss collocation use vector lanes.
                if method in ("dop8", "gauss2"):
                    continue
                many = vv.simulate_ensemble(pendulum, t_end=1.5, **job, **more)
                found.append((many.outcome[0], many.t_reached[0]))
            for word, t in found:
                assert word == outcome, (method, start)
                assert abs(t - min(when, 1.5)) < (1e-4 if step == 0.01 else 1e-7), (method, start)
            assert plain.state[-1] == pytest.approx(watched.state[-1], abs=1e-7)
    assert damping < 0.02 or "unphysical" in seen


@pytest.mark.parametrize("method", ["gauss8", "verner9", "verner8"])
def test_a_flight_past_the_pivot_is_followed_by_events_and_wanted_states(method):
    """It takes a thousandth of a step: states and events inside agree with another program."""
    body = Swinging(e=0.1, w2=0.4, w3=0.8, p1=1.0)
    pendulum = eval(body.source)
    start = [-0.5, -1.5, 0.02, 0.0, 0.0, 0.0]
    events = [lambda t, y: y[2] - 1, lambda t, y: y[0] + 0.99, lambda t, y: y[1]]
    times = np.concatenate([np.linspace(0.36, 0.37, 11), [0.5, 0.6]])
    true = solve_ivp(
        body.right, (0, 0.6), start, "DOP853", times, events=events, rtol=1e-13, atol=1e-13
    )
    job = {"initial": start, "dt": 0.02, "method": method}
    run = vv.simulate(pendulum, 0.6, times=times[:-1], **job)
    watched = vv.simulate(pendulum, 0.6, events=["phi - 1", "z + 0.99", "z_dot"], **job)
    assert run.t == pytest.approx(times[:-1], abs=0)
    size = np.maximum(np.abs(true.y.T).max(axis=0), 1)
    assert (np.abs(run.state - true.y.T[:-1]) / size).max() < 1e-7
    for passages, wanted, states in zip(watched.events, true.t_events, true.y_events, strict=True):
        assert passages.t == pytest.approx(wanted, abs=1e-9)
        assert (np.abs(passages.state - states) / size).max() < 1e-6
    long = vv.simulate(pendulum, 20, events="phi", **job)
    assert long.outcome == "completed"
    assert long.state[-1] == pytest.approx(vv.simulate(pendulum, 20, **job).state[-1], abs=1e-9)


def test_an_event_that_ends_the_run_near_the_pivot():
    """The event ends the run even if the step would reach the pivot."""
    rng = np.random.default_rng(4)
    for damping in (0.02, 0.5):
        body, start = thrown(rng, damping)
        start[1:3] = -1.4, 0.02
        pendulum = eval(body.source)
        stop = vv.Event("z + 0.9995", terminal=True)

        def there(t, y):
            return y[0] + 0.9995

        there.terminal = True
        true = solve_ivp(
            body.right, (0, 1.5), start, "Radau", events=there, rtol=1e-11, atol=1e-13,
        )  # fmt: skip
        for method in ("gauss8", "verner9", "rk4"):
            run = vv.simulate(
                pendulum, 1.5, initial=start, dt=0.01, method=method, events=[stop, "z + 0.9999"]
            )
            assert run.outcome == "event"
            assert run.t_reached == pytest.approx(true.t[-1], abs=1e-7)
            assert run.events[1].t.size == 0
            assert run.events[0].state[0][0] == pytest.approx(-0.9995, abs=1e-9)
