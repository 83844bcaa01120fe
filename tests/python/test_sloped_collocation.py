"""Collocation with Newton's method for laws with functions: accuracy and number of calls."""

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

#: Laws of one and two coordinates, as text and for SciPy.
ONE = {
    "0.3*tanh(x_dot) + 0.2*sin(x)": lambda x, v: 0.3 * np.tanh(v) + 0.2 * np.sin(x),
    "0.1*exp(-x)*x_dot + 0.5*x^3": lambda x, v: 0.1 * np.exp(-x) * v + 0.5 * x**3,
    "x/sqrt(1 + x^2) - 0.2*cos(2*x)": lambda x, v: x / np.sqrt(1 + x**2) - 0.2 * np.cos(2 * x),
    "0.2*log(2 + x^2 + x_dot^2)*x": lambda x, v: 0.2 * np.log(2 + x**2 + v**2) * x,
    "0.4*atan(3*x_dot)": lambda x, v: 0.4 * np.arctan(3 * v),
    "0.3*(x - 0.1)^5 - 0.2*x_dot*x^2": lambda x, v: 0.3 * (x - 0.1) ** 5 - 0.2 * v * x**2,
    "sinh(x)/(1.5 + tanh(x_dot))": lambda x, v: np.sinh(x) / (1.5 + np.tanh(v)),
}


@pytest.mark.parametrize("method", ["gauss8", "gauss16"])
@pytest.mark.parametrize("law", ONE)
def test_laws_of_one_coordinate(law, method):
    """The motion agrees with SciPy; a step needs few evaluations of the law."""
    system = vv.PolynomialSystem(mass=2, stiffness=1.5, damping=0.1, forces=law)
    run = vv.simulate(
        system, 20, initial=[0.8, -0.3], load=0.4, nu=0.9, dt=0.2, method=method, keep="last"
    )

    def rates(t, y):
        force = 0.4 * np.sin(0.9 * t) - 0.1 * y[1] - 1.5 * y[0] - ONE[law](y[0], y[1])
        return [y[1], force / 2]

    other = solve_ivp(rates, (0, 20), [0.8, -0.3], "DOP853", rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(run.state[-1], other.y[:, -1], atol=2e-10)
    blocks = 2 if method == "gauss16" else 1
    assert run.stats["evaluations"] < 5 * blocks * run.stats["steps"]


def test_two_coordinates_in_large_steps():
    """Two coordinates coupled by laws and monomials, with the largest possible steps."""
    system = vv.PolynomialSystem(
        mass=[[1, 0.2], [0.2, 2]],
        stiffness=[[3, -1], [-1, 2]],
        damping=[0.1, 0.2],
        forces={"x1": "x1^3 + 2*x1*x2^2", "x2": "tanh(x2) + 0.3*sin(x1 - x2_dot)"},
    )
    start = [0.5, 0.1, -0.4, 0.2]
    mass = np.array([[1, 0.2], [0.2, 2]])

    def rates(t, y):
        x, v = y[::2], y[1::2]
        law = [x[0] ** 3 + 2 * x[0] * x[1] ** 2, np.tanh(x[1]) + 0.3 * np.sin(x[0] - v[1])]
        force = np.array([0.3 * np.sin(1.1 * t), 0]) - np.array([0.1, 0.2]) * v - law
        a = np.linalg.solve(mass, force - np.array([[3, -1], [-1, 2]]) @ x)
        return [v[0], a[0], v[1], a[1]]

    other = solve_ivp(rates, (0, 24), start, "DOP853", rtol=1e-12, atol=1e-13)
    for dt, error in ((0.8, 3e-7), (0.4, 1e-10), (0.2, 3e-11)):
        run = vv.simulate(system, 24, initial=start, load=[0.3, 0], nu=1.1, dt=dt, method="gauss8")
        np.testing.assert_allclose(run.state[-1], other.y[:, -1], atol=error)


def test_energy_and_going_on():
    """A pendulum keeps its energy; a resumed run is bitwise equal."""
    system = vv.PolynomialSystem(mass=1, stiffness=0, damping=0, forces="sin(x)")
    run = vv.simulate(system, 400, initial=[2.0, 0.0], dt=0.5, method="gauss8")
    energy = 0.5 * run.state[:, 1] ** 2 - np.cos(run.state[:, 0])
    assert np.ptp(energy) < 2e-13
    half = vv.simulate(system, 200, initial=[2.0, 0.0], dt=0.5, method="gauss8")
    assert np.array_equal(vv.simulate(system, 400, resume=half).state[-1], run.state[-1])


def test_states_inside_large_steps():
    """States inside steps agree with a run with small steps."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="0.3*tanh(x_dot)")
    call = {"initial": [1.0, 0.0], "load": 0.5, "nu": 0.9, "method": "gauss8"}
    run = vv.simulate(system, 20, dt=1.0, events=["x"], **call)
    fine = vv.simulate(system, 20, dt=0.1, events=["x"], **call)
    np.testing.assert_allclose(run.events[0].t, fine.events[0].t, atol=1e-9)
    assert fine.events[0].t.size > 4


@pytest.mark.parametrize("seed", range(4))
def test_numbers_stand_on_either_side(seed):
    """A number times a law equals the law times the number, bitwise, and so do motions."""
    rng = np.random.default_rng(seed)
    a, b, c = rng.uniform(0.1, 0.9, 3).round(3)
    f, g = rng.choice(
        ["sin(x)", "tanh(x_dot)", "x^3", "(1 + x*x_dot)", "exp(-x_dot)", "max(x, 0)"], 2
    )
    first = f"{a}*{f} - {b}*{c}*{g}*x + 2*(3 - {c})*({a} + {b}*{g})/2"
    other = f"{f}*{a} - {g}*({b}*{c})*x + ({a} + {g}*{b})*(2*(3 - {c}))/2"
    states = [
        vv.simulate(
            vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces=law),
            6,
            initial=[0.4, -0.2],
            dt=0.5,
            method="gauss8",
        ).state
        for law in (first, other)
    ]
    np.testing.assert_array_equal(*states)


@pytest.mark.parametrize("seed", range(3))
def test_the_tolerance_of_the_equations_holds(seed):
    """The error of the step equations is below their tolerance, for any step size."""
    rng = np.random.default_rng(seed)
    law = rng.choice(list(ONE))
    system = vv.PolynomialSystem(mass=1, stiffness=1.5, damping=0.2, forces=law)
    call = {"initial": rng.uniform(-0.6, 0.6, 2), "load": rng.uniform(0.1, 0.5), "nu": 0.9}
    for dt in (0.3, 0.8, 1.2):
        run = {"dt": dt, "method": "gauss8", "keep": "last", **call}
        exact = vv.simulate(system, 24, **run).state[-1]
        for tolerance in (1e-6, 1e-8, 1e-10, 1e-12):
            found = vv.simulate(system, 24, tolerance=tolerance, **run).state[-1]
            assert np.abs(found - exact).max() < 2 * tolerance
