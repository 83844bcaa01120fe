"""Ensembles by Gauss collocation, several trajectories in vector lanes."""

import math

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

LAW = "0.3*tanh(x_dot) + 0.2*sin(x) + 0.1*x^3"
TEXT = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces=LAW)
NU = 0.9


def starts(n=5):
    return np.stack([np.linspace(-1, 1.2, n), np.linspace(0.3, -0.4, n)], 1)


def by_scipy(start, t_end, load=0.5, nu=NU):
    def slope(t, y):
        x, v = y
        law = 0.3 * math.tanh(v) + 0.2 * math.sin(x) + 0.1 * x**3
        return [v, load * math.sin(nu * t) - 0.05 * v - x - law]

    return solve_ivp(slope, (0, t_end), start, "DOP853", rtol=1e-13, atol=1e-15).y[:, -1]


def run(method, dt, **changes):
    given = {"initial": starts(), "t_end": 20, "load": 0.5, "nu": NU} | changes
    return vv.simulate_ensemble(given.pop("system", TEXT), method=method, dt=dt, **given)


@pytest.mark.parametrize(("method", "dt"), [("gauss8", 0.5), ("gauss16", 1.25)])
def test_motions_are_those_of_scipy(method, dt):
    expected = np.array([by_scipy(start, 20) for start in starts()])
    assert np.abs(run(method, dt).state - expected).max() < 1e-13 * 20


def test_order_is_sixteen():
    expected = run("gauss16", 0.5).state
    errors = [np.abs(run("gauss8", dt).state - expected).max() for dt in (4 / 3, 2 / 3)]
    assert 14 < math.log2(errors[0] / errors[1]) < 19


def test_frequencies_and_scales_differ_by_lane():
    nu, scale = np.array([0.3, 0.9, 1.7]), np.array([0.2, 1.0, 2.0])
    many = run(
        "gauss8", 0.4, initial=[0.5, 0], nu=None, parameters={"nu": nu, "load_scale": scale}
    ).state
    expected = [by_scipy([0.5, 0], 20, 0.5 * s, p) for s, p in zip(scale, nu, strict=True)]
    assert np.abs(many - expected).max() < 1e-12


@pytest.mark.parametrize("method", ["gauss8", "gauss16"])
def test_neighbours_do_not_matter(method):
    states = starts(8)
    states[1:] *= [[1], [3], [0.01], [30], [1e-9], [7], [1]]
    together = run(method, 1.0, initial=states)
    for i, state in enumerate(states):
        alone = run(method, 1.0, initial=state)
        np.testing.assert_array_equal(alone.state[0], together.state[i])
        assert alone.outcome[0] == together.outcome[i]


def test_lane_whose_step_is_too_large_is_reported_and_the_others_go_on():
    stiff = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="x^3")
    states = np.array([[0.3, 0.0], [60.0, 0.0], [0.5, 0.0]])
    many = run("gauss8", 1.0, system=stiff, initial=states)
    assert list(many.outcome) == ["completed", "step too large", "completed"]
    assert 0 <= many.t_reached[1] < 20
    one = run("gauss8", 1.0, system=stiff, initial=states[2])
    np.testing.assert_array_equal(many.state[2], one.state[0])


def test_exponents_are_those_of_an_explicit_method():
    double_well = vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.1, forces="x^3 + 0.02*sin(x)")
    given = {"system": double_well, "initial": [0.5, 0.0], "load": 0.35, "nu": 1.0, "t_end": 60}
    gauss, explicit = (
        run(method, dt, lyapunov="all", **given)
        for method, dt in (("gauss8", 0.2), ("verner9", 0.05))
    )
    # The motion is chaotic, so rounding errors grow; the sum of exponents is minus the damping.
    assert np.abs(gauss.spectrum - explicit.spectrum).max() < 1e-6
    assert abs(gauss.spectrum.sum() + 0.1) < 1e-9


def test_pendulums_stop_where_explicit_methods_say():
    body = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01)
    states = np.zeros((4, 6))
    states[:, 1] = [-0.3, -2.5, -6.0, -9.0]
    states[:, 2] = 0.2
    gauss, explicit = (
        vv.simulate_ensemble(body, initial=states, t_end=10, dt=0.1, method=method)
        for method in ("gauss8", "verner9")
    )
    np.testing.assert_array_equal(gauss.outcome, explicit.outcome)
    assert {"completed", "unphysical"} <= set(gauss.outcome)
    assert np.abs(gauss.t_reached - explicit.t_reached).max() < 1e-6
    done = gauss.outcome == "completed"
    assert np.abs(gauss.state[done] - explicit.state[done]).max() < 1e-9


def test_step_is_found():
    many = run("gauss8", "auto", tolerance=1e-11)
    expected = np.array([by_scipy(start, 20) for start in starts()])
    assert np.abs(many.state - expected).max() < 1e-11
    assert many.error is not None
