"""Ensembles against single motions, closed forms and independent references."""

import json

import numpy as np
import pytest
import viscovib as vv
from tables import DATA
from test_pendulum import P1R, START, free

REFERENCE = json.loads((DATA / "pendulum_time_reference.json").read_text())


def starts(n, low=-0.5, high=0.5):
    states = np.tile(START, (n, 1))
    states[:, 2] = np.linspace(low, high, n)
    return states


@pytest.mark.parametrize("method", ["rk4", "dop8", "verner8", "verner9"])
def test_members_are_single_runs(method):
    """Bitwise equal to the single run, in any lane."""
    body = vv.Pendulum(**P1R)
    many = vv.simulate_ensemble(body, initial=starts(11), t_end=20, dt=0.5, method=method)
    for i in (0, 4, 10):
        alone = vv.simulate(body, 20, dt=0.5, initial=starts(11)[i], method=method, keep="last")
        assert (many.state[i] == alone.state[-1]).all()
    assert (many.outcome == "completed").all()
    assert many.t_reached == pytest.approx(20)


def test_reference_state():
    body = vv.Pendulum(**P1R)
    expected = np.array([float(text) for text in REFERENCE["P1r"]["states"]["200"]])
    many = vv.simulate_ensemble(body, initial=START, t_end=200, dt=0.15, method="verner9")
    assert many.state[0] == pytest.approx(expected, abs=1e-12)


def test_parameters_vary_by_run():
    p1, f0 = np.array([0.7, 0.93, 1.2]), np.array([0.01, 0.005, 0.02])
    body = vv.Pendulum(**P1R)
    many = vv.simulate_ensemble(
        body, initial=START, t_end=30, dt=0.2, parameters={"p1": p1, "f0": f0}
    )
    for i in range(3):
        alone = vv.Pendulum(**(P1R | {"p1": p1[i], "f0": f0[i]}))
        run = vv.simulate(alone, 30, dt=0.2, initial=START, method="verner9", keep="last")
        assert (many.state[i] == run.state[-1]).all()
    assert many.to_dataset().p1.values.tolist() == p1.tolist()


def test_threads_change_no_bit():
    body = vv.Pendulum(**P1R)
    wanted = {
        "t_end": 50, "dt": 0.4, "statistics": True, "amplitudes_at": [0.93, 0.37],
        "lyapunov": True, "discard": 10,
    }  # fmt: skip
    one, three = (
        vv.simulate_ensemble(body, initial=starts(77), n_threads=n, **wanted) for n in (1, 3)
    )
    for name in ("state", "peak", "mean", "rms", "amplitudes", "lyapunov"):
        assert (getattr(one, name) == getattr(three, name)).all()


@pytest.mark.parametrize(
    ("discard", "method"), [(0.0, "verner9"), (0.6, "gauss8"), (20.07, "verner9"), (59.9, "gauss8")]
)
def test_statistics_are_those_of_the_motion(method, discard):
    """By the polynomials of a single run, from `discard` on, also within a step."""
    body = vv.Pendulum(**P1R)
    many = vv.simulate_ensemble(
        body, initial=START, t_end=60, dt=0.25, discard=discard, statistics=True, method=method
    )
    run = vv.simulate(body, 60, dt=0.1, initial=START)
    x, w = np.polynomial.legendre.leggauss(12)
    edges = np.linspace(discard, 60, 121)
    half = np.diff(edges)[:, np.newaxis] / 2
    states = run((edges[:-1, np.newaxis] + half * (x + 1)).ravel()).reshape(120, 12, 6)
    weights = (half * w / (60 - discard))[..., np.newaxis]
    assert many.mean[0] == pytest.approx((weights * states).sum((0, 1)), abs=1e-10)
    assert many.rms[0] == pytest.approx(np.sqrt((weights * states**2).sum((0, 1))), abs=1e-10)
    times = np.linspace(discard, 60, 6001)
    places = times[np.abs(run(times)).argmax(axis=0)]
    for i in range(6):
        near = np.clip(places[i] + np.linspace(-0.01, 0.01, 4001), discard, 60)
        assert many.peak[0, i] == pytest.approx(np.abs(run(near)[:, i]).max(), abs=5e-10)


def test_statistics_of_a_run_of_one_step():
    body = vv.Pendulum(**P1R)
    many = vv.simulate_ensemble(body, initial=START, t_end=0.1, dt=0.1, statistics=True)
    run = vv.simulate(body, 0.1, dt=0.01, initial=START)
    x, w = np.polynomial.legendre.leggauss(12)
    states = run(0.05 * (x + 1))
    assert many.mean[0] == pytest.approx(w @ states / 2, abs=1e-10)
    assert many.rms[0] == pytest.approx(np.sqrt(w @ states**2 / 2), abs=1e-9)
    assert many.peak[0] == pytest.approx(np.abs(run(np.linspace(0, 0.1, 1001))).max(0), abs=1e-8)


def test_amplitude_of_a_linear_spring():
    """A driven linear spring in its steady state: amplitude and phase in closed form."""
    p, c, f = 0.83, 0.3, 1e-3
    body = free(alpha=0.0, c1=c, f0=f, p1=p)
    many = vv.simulate_ensemble(
        body, initial=np.zeros(6), t_end=1000, dt=0.25, discard=300, amplitudes_at=[p, 0.4]
    )
    assert many.amplitudes[0, 0, 0] == pytest.approx(f / (1 - p**2 + 1j * p * c), abs=1e-10)
    # Leakage of the Hann window decays with the cube of the distance in bins, here 48.
    assert abs(many.amplitudes[0, 1, 0]) < abs(many.amplitudes[0, 0, 0]) / 48**3


def test_sections_are_states_at_whole_periods():
    p1 = np.array([0.8, 0.93])
    body = vv.Pendulum(**P1R)
    many = vv.simulate_ensemble(
        body, initial=START, n_periods=6, discard=2, dt=0.2, sections=1, parameters={"p1": p1},
        method="verner9",
    )  # fmt: skip
    assert many.sections.shape == (2, 4, 6)
    np.testing.assert_allclose(many.dt, 2 * np.pi / np.array(p1), rtol=1e-14)
    assert (many.step <= 0.2).all()
    for i in range(2):
        alone = vv.Pendulum(**(P1R | {"p1": p1[i]}))
        times = 2 * np.pi / p1[i] * np.arange(3, 7)
        run = vv.simulate(alone, 60, dt=0.1, initial=START, times=times)
        assert many.sections[i] == pytest.approx(run.state, abs=1e-10)


def test_lyapunov_exponent_of_a_damped_linear_spring():
    """All perturbations of a linear system decay, the slowest with -c/2."""
    body = vv.Pendulum(e=0.0, w2=0.4, w3=0.8, c1=0.02, c2=0.3, c3=0.3)
    many = vv.simulate_ensemble(
        body, initial=np.zeros(6), t_end=4000, dt=0.5, discard=400, lyapunov=True
    )
    assert many.lyapunov[0] == pytest.approx(-0.01, rel=1e-3)


def test_lyapunov_exponent_against_two_runs():
    """Growth of the distance of two motions, initially 1e-9."""
    body = vv.Pendulum(**(P1R | {"f0": 0.02, "m01": 0.01, "m02": 0.02}))
    end = 200
    many = vv.simulate_ensemble(body, initial=START, t_end=end, dt=0.1, lyapunov=True)
    direction = np.zeros(6)
    direction[::2] = 1 / np.sqrt(3)
    two = [
        vv.simulate(body, end, dt=0.1, initial=np.add(START, s * 1e-9 * direction), keep="last")
        for s in (-1, 1)
    ]
    growth = np.linalg.norm(two[1].state[0] - two[0].state[0]) / 2e-9
    assert many.lyapunov[0] * end == pytest.approx(np.log(growth), rel=1e-3)
    assert growth > 1e5


def test_step_is_found():
    body = vv.Pendulum(**P1R)
    many = vv.simulate_ensemble(body, initial=starts(9), t_end=50, tolerance=1e-9)
    exact = vv.simulate_ensemble(body, initial=starts(9), t_end=50, dt=0.1, method="verner9")
    assert many.error <= 1e-9
    assert np.abs(many.state - exact.state).max() <= 1e-9


def test_runs_that_fail_leave_the_others_alone():
    states = starts(6)
    states[2] = [0, -3, 0, 0, 0, 0]  # the spring goes through the pivot
    states[4, 5] = 1e7  # rotates too fast for any step size
    many = vv.simulate_ensemble(
        free(), initial=states, t_end=50, dt=0.25, statistics=True, lyapunov=True
    )
    assert many.outcome.tolist() == [
        "completed", "completed", "unphysical", "completed", "step too large", "completed",
    ]  # fmt: skip
    good = [0, 1, 3, 5]
    apart = vv.simulate_ensemble(
        free(), initial=states[good], t_end=50, dt=0.25, statistics=True, lyapunov=True
    )
    assert (many.state[good] == apart.state).all()
    assert (many.rms[good] == apart.rms).all()
    assert many.t_reached[2] < 2
    assert np.isfinite(many.state).all()
    assert many.state[2, 0] > -1


def test_lanes_that_fall_through_the_pivot_end_in_numbers():
    rng = np.random.default_rng(0)
    for _ in range(12):
        system = vv.Pendulum(
            e=rng.uniform(0.03, 0.15), w2=rng.uniform(0.4, 0.6), w3=rng.uniform(0.8, 1),
            alpha=rng.uniform(0, 0.8), c1=0.03, c2=0.02, c3=0.02,
        )  # fmt: skip
        states = np.zeros((8, 6))
        states[:, 1] = -rng.uniform(3, 9, 8)
        states[:, 2] = rng.uniform(-0.4, 0.4, 8)
        many = vv.simulate_ensemble(system, initial=states, t_end=10, dt=0.2, lyapunov=True)
        stopped = many.outcome != "completed"
        assert stopped.any()
        assert np.isfinite(many.state).all()
        assert (many.state[:, 0] > -1).all()
        assert (many.t_reached[stopped] < 10).all()


def test_interrupt_stops_the_threads(monkeypatch):
    import time

    def interrupted(*_, **__):
        time.sleep(0.2)
        raise KeyboardInterrupt

    monkeypatch.setattr("viscovib.analyses.ensemble.as_completed", interrupted)
    # Processor time; without the interrupt it would be days.
    begin = time.process_time()
    with pytest.raises(KeyboardInterrupt):
        vv.simulate_ensemble(free(), initial=starts(64), t_end=1e7, dt=0.1)
    assert time.process_time() - begin < 10


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"initial": np.zeros((2, 5))}, "initial: must have shape (n, 6) or (6,), got (2, 5)"),
        ({"initial": np.zeros((0, 6))}, "must be the same number of runs"),
        ({"initial": [-1, 0, 0, 0, 0, 0]}, "initial z = -1: must be greater than -1"),
        ({"initial": [np.nan, 0, 0, 0, 0, 0]}, "must be a finite number"),
        ({"t_end": -1}, "t_end = -1: must be greater than 0"),
        ({"t_end": None}, "t_end or n_periods: give exactly"),
        ({"n_periods": 3}, "give exactly one of them"),
        ({"t_end": None, "n_periods": 3}, "sections must name the load"),
        ({"dt": 0}, "dt = 0: must be greater than 0"),
        ({"dt": np.inf}, "dt = inf: must be a finite number"),
        ({"dt": 11}, "must be greater than 0 and not exceed"),
        ({"discard": 10}, "discard = 10: must be less than t_end = 10"),
        ({"method": "gauss3"}, "method = 'gauss3': must be one of 'auto', 'rk4'"),
        ({"sections": 4}, "sections = 4: must be 1 to 3"),
        ({"sections": 1, "system": free()}, "p1 must be greater than 0"),
        ({"amplitudes_at": [0.0]}, "amplitudes_at: must be greater than 0"),
        ({"amplitudes_at": [1, 6.3]}, "resolve no frequency of 6.283 or more"),
        ({"amplitudes_at": [2.2], "sample_every": 3}, "sample_every = 3: states 1.5 apart resolve"),
        ({"parameters": {"p4": [1.0]}}, "'p4' is not a parameter of the pendulum"),
        ({"parameters": {"e": [0.1, 0.9]}}, "must be less than 1"),
        ({"parameters": {"e": [0.1, 0.1]}, "initial": np.zeros((3, 6))}, "lengths differ"),
        ({"initial": np.broadcast_to(0.0, (10**9, 6))}, "1000000000 runs with states of 6 numbers"),
        ({"parameters": {"e": np.broadcast_to(0.1, 10**9)}}, "must be at most 11184810 runs"),
        ({"tolerance": 2}, "tolerance = 2: must be in"),
        ({"n_threads": 0}, "n_threads = 0: must be 1 to"),
        ({"system": 1}, "system = 1: must be a Pendulum"),
    ],
)
def test_bad_input_is_named(changes, text):
    given = {"system": vv.Pendulum(**P1R), "initial": START, "t_end": 10, "dt": 0.5} | changes
    with pytest.raises(vv.InputError) as error:
        vv.simulate_ensemble(given.pop("system"), **given)
    assert text in str(error.value)
