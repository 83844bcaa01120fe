"""Stated errors of event times and states."""

import math
import pickle

import numpy as np
import pytest
import viscovib as vv
from referee.sure_events import case

SWING = vv.PolynomialSystem(mass=1, stiffness=1)
PRONY = vv.PronyKernel(weights=[0.3], rates=[1])


@pytest.mark.parametrize("seed", range(6))
def test_errors_hold_of_random_oscillators(seed):
    """With and without memory, under bursts, at grazed levels; by SciPy."""
    drawn = case(np.random.default_rng([717, seed]))
    names = {"np": np, "vv": vv}
    exec(drawn.call, names)
    for claim in drawn.judge(names, []):
        assert claim.ratio() <= 1, f"{claim}\n{drawn.call}"


@pytest.mark.parametrize("step", [{}, {"dt": 0.4, "estimate_error": True}], ids=["auto", "given"])
@pytest.mark.parametrize("below", [1e-3, 1e-12])
def test_near_grazing(below, step):
    """Levels below the maxima of sin(t): errors are valid and like roots of rounding errors."""
    level = 1 - below
    run = vv.simulate(SWING, 12.0, initial=[0, 1], events=[f"x - {level!r}"], **step)
    found = run.events[0]
    half = math.acos(level)
    true = np.array([math.pi / 2 + 2 * math.pi * k + s * half for k in (0, 1) for s in (-1, 1)])
    off = np.abs(found.t[:, np.newaxis] - true).min(axis=1)
    assert (off <= 1.5 * found.error).all()
    state = np.column_stack([np.sin(true), np.cos(true)])
    near = np.abs(found.t[:, np.newaxis] - true).argmin(axis=1)
    assert (np.abs(found.state - state[near]).max(axis=1) <= 1.5 * found.state_error).all()
    if below >= 1e-6:
        assert (found.error <= 40 * max(run.error, 1e-14) / math.sqrt(2 * below)).all()


@pytest.mark.parametrize("dt", [1.2, 0.7, 0.3])
def test_turning_points_in_long_steps(dt):
    """As accurate as step ends; the velocity at a turning point is 0 within rounding error."""
    damped = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1)
    run = vv.simulate(damped, 18.0, initial=[0, 1], dt=dt, events=["x_dot"])
    fast = math.sqrt(1 - 0.05**2)
    true = (math.atan(fast / 0.05) + math.pi * np.arange(6)) / fast
    np.testing.assert_allclose(run.events[0].t, true[: run.events[0].t.size], atol=1e-13)
    np.testing.assert_allclose(run.events[0].state[:, 1], 0, atol=1e-14)


def test_ends_by_events_are_as_sure_as_rounding_leaves_them():
    """At least 1e-12 of the time; near grazing the error is larger."""
    rng = np.random.default_rng(5)
    for _ in range(12):
        below = 10 ** rng.uniform(-7, -0.1)
        level = 1 - below
        stop = vv.Event(f"x - {level!r}", terminal=True)
        begin = rng.uniform(0, 6)
        run = vv.simulate(
            SWING, 20.0, initial=[math.sin(begin), math.cos(begin)], events=[stop], keep="last"
        )
        half = math.acos(level)
        ends = [(math.pi / 2 + 2 * math.pi * k + s * half) - begin for k in (0, 1) for s in (-1, 1)]
        off = min(abs(run.t_reached - t) for t in ends)
        assert off <= 1.5 * run.error
        assert run.error <= 200 * max(1e-14, run.events[0].error[-1])
        assert run.error >= run.events[0].error[-1]
        if below > 0.1:
            assert run.error < 2e-13


def test_jumps_and_thin_functions_know_their_errors():
    texts = ["where(x > 0.2, -1, 1)", "abs(x - 0.3) - 1e-6", "sign(x - 0.1*x_dot)", "x*x_dot"]
    run = vv.simulate(SWING, 12.0, initial=[0, 1], events=texts)
    step, thin, slanted, _ = run.events
    for found in run.events:
        assert np.isfinite(found.error).all()
        assert found.error.max() < 1e-12
        assert found.state_error.max() < 1e-12
    true = np.array([math.asin(0.2), math.pi - math.asin(0.2)])
    assert (np.abs(step.t[:2] - true) <= 1.5 * step.error[:2]).all()
    assert slanted.t[0] == pytest.approx(math.atan(0.1), abs=1.5 * slanted.error[0])
    assert thin.t.size == 8


@pytest.mark.parametrize(
    "system",
    [
        vv.Structure(mass=[1], stiffness=1, elements=[vv.Stop(on="x1", gap=0.4, restitution=0.6)]),
        vv.Structure(mass=[1], stiffness=1, elements=[vv.Dahl(on="x1", stiffness=2, limit=0.3)]),
        vv.Structure(
            mass=[1, 1], stiffness=[[2, -1], [-1, 2]], damping=[0.1, 0.1],
            elements=[vv.Spring(on="x1", law="d^3", kernel=PRONY)],
        ),
        vv.PolynomialSystem(
            mass=1, stiffness=1, forces="x^3",
            kernel=vv.RzhanitsynKernel(amplitude=0.1, alpha=0.3, beta=0.2),
        ),
        vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2),
        vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="9*max(x - 0.2, 0)"),
    ],
    ids=["stop", "Dahl", "layer", "Rzhanitsyn", "mount", "gap"],
)  # fmt: skip
def test_errors_hold_of_other_systems(system):
    """By runs with incommensurate steps."""
    name = system.dof_names[0]
    n = len(system.dof_names)
    load = {"load": 0.4, "nu": 1.1, "initial": [0.1, 0.3] * n}
    call = {"events": [f"{name} - 0.1", f"{name}_dot", f"{name}*{name}_dot - 0.01*t"]}
    run = vv.simulate(system, 9.0, tolerance=1e-8, keep="last", **load, **call)
    fine = vv.simulate(system, 9.0, dt=min(run.step, 0.1) / 7.3, **load, **call)
    assert fine.events[0].error is None
    assert sum(found.t.size for found in run.events) > 4
    for found, judge in zip(run.events, fine.events, strict=True):
        assert found.t.size == judge.t.size
        assert (np.abs(found.t - judge.t) <= 1.5 * found.error).all()
        off = np.abs(found.state - judge.state).max(axis=1, initial=0)
        assert (off <= 1.5 * found.state_error).all()


def test_resumed_runs_tell_errors_where_they_are_asked_to():
    first = vv.simulate(SWING, 6.0, initial=[0, 1], dt=0.3, events=["x - 0.3"])
    rest = vv.simulate(SWING, 12.0, resume=first, estimate_error=True)
    found = rest.events[0]
    true = 2 * math.pi * np.arange(3) + math.asin(0.3)
    true = np.sort(np.concatenate([true, true + math.pi - 2 * math.asin(0.3)]))
    true = true[(true > 6) & (true < 12)]
    assert found.t.size == true.size
    assert (np.abs(found.t - true) <= 1.5 * found.error).all()
    assert found.error.max() < 1e-12


def test_what_is_reported():
    """Summaries, pairs, copies; None if the run has no error."""
    run = vv.simulate(SWING, 12.0, initial=[0, 1], events=["x - 0.3", "x - 5"])
    times, states = run.events[0]
    assert times.shape == run.events[0].error.shape == run.events[0].state_error.shape == (4,)
    assert states.shape == (4, 2)
    assert "events[0] x - 0.3: 4 occurrences, estimated errors up to " in str(run)
    assert "events[1] x - 5: 0 occurrences" in str(run)
    assert run.events[1].error.size == 0
    assert pickle.loads(pickle.dumps(run)) == run
    plain = vv.simulate(SWING, 12.0, initial=[0, 1], dt=0.1, events=["x - 0.3"])
    assert plain.events[0].error is None
    assert plain.events[0].state_error is None
    assert "events[0] x - 0.3: 4 occurrences, errors not estimated" in str(plain)
