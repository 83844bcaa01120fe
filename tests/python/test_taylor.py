"""Ensembles by the Taylor method, 32 motions in parallel."""

import math

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

NU = 0.9
#: Laws with every function that has a power series, as text and in NumPy.
LAWS = {
    "0.3*tanh(x_dot) + 0.2*sin(x) + 0.1*x^3": lambda x, v: (
        0.3 * np.tanh(v) + 0.2 * np.sin(x) + 0.1 * x**3
    ),
    "0.2*exp(0.5*x)*cos(x_dot) - 0.2": lambda x, v: 0.2 * np.exp(0.5 * x) * np.cos(v) - 0.2,
    "x/sqrt(1 + x^2) + 0.1*x_dot/(2 + x^2)": lambda x, v: (
        x / np.hypot(1, x) + 0.1 * v / (2 + x * x)
    ),
    "0.3*sinh(0.5*x) + 0.1*(cosh(0.4*x_dot) - 1)": lambda x, v: (
        0.3 * np.sinh(0.5 * x) + 0.1 * (np.cosh(0.4 * v) - 1)
    ),
    "0.2*atan(2*x) + 0.1*asinh(x_dot)": lambda x, v: 0.2 * np.arctan(2 * x) + 0.1 * np.arcsinh(v),
    "0.2*asin(0.2*x) - 0.1*acos(0.2*x_dot) + 0.157": lambda x, v: (
        0.2 * np.arcsin(0.2 * x) - 0.1 * np.arccos(0.2 * v) + 0.157
    ),
    "0.2*atanh(0.2*x) + 0.1*acosh(3 + 0.2*x_dot)": lambda x, v: (
        0.2 * np.arctanh(0.2 * x) + 0.1 * np.arccosh(3 + 0.2 * v)
    ),
    "0.2*log(4 + x) + 0.1*tan(0.3*x_dot)": lambda x, v: 0.2 * np.log(4 + x) + 0.1 * np.tan(0.3 * v),
    "0.4*(3 + x)^1.5 - 1/(4 + x_dot)^2 - 2": lambda x, v: (
        0.4 * (3 + x) ** 1.5 - 1 / (4 + v) ** 2 - 2
    ),
    "0.1*x^7 - 0.2*(x + x_dot)^2/(3 - x)^0.5": lambda x, v: (
        0.1 * x**7 - 0.2 * (x + v) ** 2 / (3 - x) ** 0.5
    ),
}


def system(law):
    return vv.PolynomialSystem(mass=1.3, stiffness=1.7, damping=0.11, forces=law)


#: Methods, a step size with rounding errors only, and one that shows the order.
METHODS = {
    "taylor8": (0.015, 0.2), "taylor12": (0.05, 0.4), "taylor16": (0.1, 0.6),
    "taylor20": (0.1, 0.7), "taylor24": (0.1, 0.8),
}  # fmt: skip

TEXT = system("0.3*tanh(x_dot) + 0.2*sin(x)")


def by_scipy(law, start, t_end, load=0.5, nu=NU):
    def slope(t, y):
        x, v = y
        return [v, (load * math.sin(nu * t) - 0.11 * v - 1.7 * x - law(x, v)) / 1.3]

    return solve_ivp(slope, (0, t_end), start, "DOP853", rtol=1e-13, atol=1e-15).y[:, -1]


def starts(n=5):
    return np.stack([np.linspace(-0.8, 0.9, n), np.linspace(0.3, -0.4, n)], 1)


def run(dt, **changes):
    given = {"initial": starts(), "t_end": 12, "load": 0.5, "nu": NU, "method": "taylor20"}
    given |= changes
    return vv.simulate_ensemble(given.pop("system", TEXT), dt=dt, **given)


@pytest.mark.parametrize("law", LAWS)
def test_motions_are_those_of_scipy(law):
    expected = np.array([by_scipy(LAWS[law], start, 12) for start in starts()])
    # Below the accuracy of SciPy.
    other = run(0.1, system=system(law), method="gauss16")
    for method, (dt, _) in METHODS.items():
        many = run(dt, system=system(law), method=method)
        assert (many.outcome == "completed").all()
        assert np.abs(many.state - expected).max() < 5e-13
        assert np.abs(many.state - other.state).max() < 6e-15, method


@pytest.mark.parametrize("method", METHODS)
def test_orders(method):
    expected, order = run(0.125, method="gauss16").state, int(method.removeprefix("taylor"))
    coarse = METHODS[method][1]
    errors = [np.abs(run(dt, method=method).state - expected).max() for dt in (coarse, coarse / 2)]
    assert errors[1] > 2e-15
    assert abs(math.log2(errors[0] / errors[1]) - order) < 0.15 * order


def test_several_coordinates_orders_and_numbers_that_vary():
    chain = vv.PolynomialSystem(
        mass=np.diag([1.0, 1.4]),
        stiffness=[[2.0, -0.9], [-0.9, 1.5]],
        damping=0.05 * np.eye(2),
        forces={"x1": "0.2*x1^3 - 0.1*x1*x2^2", "x2": "0.3*tanh(x2_dot - x1_dot) + 0.1*x1*x2"},
    )
    rng = np.random.default_rng(4)
    n = 37
    given = {
        "system": chain,
        "initial": rng.uniform(-0.6, 0.6, (n, 4)),
        "load": {0: [0.1j, 0.0], 1: [0.3, 0.1j], 3: [0.0, 0.2]},
        "nu": None,
        "parameters": {"nu": rng.uniform(0.3, 1.5, n), "load_scale": rng.uniform(-1, 2, n)},
    }
    other = run(0.1, **given | {"method": "gauss16"})
    assert np.abs(run(0.1, **given).state - other.state).max() < 1e-14


def test_scales_of_stiffness_and_damping_vary():
    cubic = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="0.5*x^3")
    scales = {
        "stiffness_scale": [0.5, 1, 2],
        "damping_scale": [0, 1, 4],
        "forces_scale": [2, 1, -0.1],
    }
    given = {"system": cubic, "initial": [0.4, 0.1], "parameters": scales}
    other = run(0.1, **given | {"method": "gauss16"})
    assert np.abs(run(0.1, **given).state - other.state).max() < 1e-14


def test_neighbours_and_threads_do_not_matter():
    states = starts(70)
    states[1::7] *= 30
    states[3::11] *= 1e-9
    together = run(0.5, initial=states, n_threads=2)
    assert {"completed"} < set(together.outcome)
    for i in (0, 1, 3, 31, 32, 69):
        alone = run(0.5, initial=states[i])
        np.testing.assert_array_equal(alone.state[0], together.state[i])
        assert alone.outcome[0] == together.outcome[i]
        assert alone.t_reached[0] == together.t_reached[i]


def test_numbers_of_neighbours_do_not_matter_to_sums():
    """Parameters that are equal in some runs do not change the sums of any run."""
    law = "a*tanh(x_dot) - 0.2 + 3*(b*tanh(x_dot) - c*x^2) - (c*sin(x) + sin(x) - x^2*x_dot)"
    numbers = {"a": [0.3, 0.1, 0.2], "b": [0.3, 0.2, 0.1], "c": [0.1, 1.0, 0.3]}
    given = {"method": "taylor20", "t_end": 12, "dt": 0.3, "initial": [0.4, 0.1]}
    text = {"mass": 1.3, "stiffness": 1.7, "damping": 0.11, "forces": law}
    plain = vv.PolynomialSystem(**text, parameters={"a": 0.3, "b": 0.3, "c": 0.1})
    together = vv.simulate_ensemble(plain, **given, parameters=numbers)
    for i in range(3):
        own = {name: values[i] for name, values in numbers.items()}
        alone = vv.simulate_ensemble(vv.PolynomialSystem(**text, parameters=own), **given)
        np.testing.assert_array_equal(alone.state[0], together.state[i])


def test_what_is_gathered_is_that_of_other_methods():
    asked = {
        "statistics": True, "amplitudes_at": [NU, 2 * NU], "sections": 1, "n_periods": 6,
        "discard": 2, "t_end": None,
    }  # fmt: skip
    mine, other = run(0.1, **asked), run(0.1, **asked | {"method": "gauss16"})
    for name in ("state", "peak", "mean", "rms", "amplitudes", "sections"):
        assert np.abs(getattr(mine, name) - getattr(other, name)).max() < 1e-12, name


@pytest.mark.parametrize("method", METHODS)
def test_step_is_found(method):
    many = run("auto", tolerance=1e-11, method=method)
    expected = np.array(
        [by_scipy(lambda x, v: 0.3 * np.tanh(v) + 0.2 * np.sin(x), start, 12) for start in starts()]
    )
    assert np.abs(many.state - expected).max() <= 1e-11
    assert 0 < many.error <= 1e-11


def test_a_series_that_does_not_converge_is_reported():
    stiff = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="x^3")
    states = np.array([[0.3, 0.0], [60.0, 0.0], [0.5, 0.0]])
    many = run(0.5, system=stiff, initial=states)
    assert list(many.outcome) == ["completed", "step too large", "completed"]


def test_escapes_and_ends_of_domains_are_those_of_other_methods():
    soft = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="-x^3 + 0.1*log(3 + x)")
    states = np.array([[0.3, 0.0], [1.6, 1.0], [-1.2, -1.5], [0.5, 0.0], [2.0, 0.5]])
    mine = run(0.05, system=soft, initial=states, load=0.05)
    other = run(0.05, system=soft, initial=states, load=0.05, method="verner9")
    assert list(mine.outcome) == list(other.outcome)
    assert len(set(mine.outcome)) > 1
    assert np.abs(mine.t_reached - other.t_reached).max() < 1e-6


@pytest.mark.parametrize("width", [1.0, 0.1, 0.01, 1e-5])
@pytest.mark.parametrize("method", ["taylor8", "taylor20"])
def test_layers_that_steps_may_miss_are_seen(width, method):
    # A motion next to a run with divided steps; unresolved motions are not returned.
    law = f"0.3*tanh(x_dot/{width}) + 0.2*exp(-(x/{width})^2)"
    many = run(0.25, system=system(law), initial=starts(3), t_end=6, method=method)
    for start, state, outcome in zip(starts(3), many.state, many.outcome, strict=True):
        if outcome != "completed":
            continue
        fine = vv.simulate(
            system(law), 6, initial=start, load=0.5, nu=NU, tolerance=1e-9, keep="last"
        )
        assert np.abs(state - fine.state[-1]).max() < 1e-4


@pytest.mark.parametrize(
    ("changes", "reported"),
    [
        ({"system": system("0.1*abs(x)")}, "one after the other"),
        ({"system": system("0.1*atan2(x, x_dot)")}, "one after the other"),
        ({"system": system("0.1*2^x + 0.1*(x + 3)^0.3")}, "power series"),
        ({"lyapunov": True}, "no Lyapunov exponents"),
    ],
)
def test_what_it_cannot_do_is_refused(changes, reported):
    with pytest.raises(vv.InputError, match=reported):
        run(0.2, **changes)


def test_pendulums_are_refused():
    body = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01)
    with pytest.raises(vv.InputError, match="method = 'taylor20'"):
        vv.simulate_ensemble(body, initial=np.zeros((2, 6)), t_end=10, dt=0.1, method="taylor20")
