"""Masses held by dry friction do not move, also at the limit of sticking: closed forms."""

import warnings

import numpy as np
import pytest
import viscovib as vv


@pytest.mark.parametrize("method", ["auto", "gauss3", "verner9"])
def test_comes_to_rest_on_the_edge(method):
    """From an odd number of widths mu/k a free motion ends where friction just holds the mass."""
    rng = np.random.default_rng(11)
    for _ in range(60):
        mass, k, mu = rng.integers(1, 30, 3) / np.array([4.0, 4.0, 20.0])
        swings = int(rng.integers(1, 6))
        way = rng.choice([-1, 1])
        omega = np.sqrt(k / mass)
        system = vv.PolynomialSystem(
            mass=mass, stiffness=k, damping=0, forces="mu*sign(x_dot)", parameters={"mu": mu}
        )
        run = vv.simulate(
            system,
            25 / omega,
            initial=[way * (2 * swings + 1) * mu / k, 0],
            dt=rng.choice([0.05, 0.1, 0.13]) / omega,
            method=method,
        )
        assert run.outcome == "completed"
        rest = way * (-1) ** swings * mu / k
        after = run.state[omega * run.t > swings * np.pi + 1e-3]
        assert np.abs(after[:, 0] - rest).max() < 1e-10 * mu / k
        assert np.abs(after[:, 1]).max() < 1e-12 * mu / k * omega


@pytest.mark.parametrize("scale", [1e-2, 1e-3, 1e-5])
def test_a_slow_load_breaks_it_loose_in_time(scale):
    """Before that nothing creeps, for any duration; the motion afterwards is known."""
    rng = np.random.default_rng([12, round(1 / scale)])
    mass, k, mu = rng.uniform(0.3, 3, 3)
    rate = scale * rng.uniform(0.5, 2)
    omega, loose = np.sqrt(k / mass), mu / rate
    system = vv.PolynomialSystem(
        mass=mass, stiffness=k, damping=0, forces="mu*sign(x_dot)", parameters={"mu": mu}
    )
    load = vv.LoadTable(times=[0, 10 * loose], values=[0, 10 * mu])
    run = vv.simulate(system, loose + 30 / omega, force=load, dt=0.8 / omega)
    since = np.maximum(run.t - loose, 0)
    exact = rate / k * (since - np.sin(omega * since) / omega)
    assert run.outcome == "completed"
    assert np.abs(run.state[run.t < loose, 0]).max() < 1e-22
    assert np.abs(run.state[:, 0] - exact).max() < 1e-11 * mu / k


def test_many_masses_held_under_loads_stay():
    """Loads below the friction limit of each mass move none of them."""
    rng = np.random.default_rng(13)
    for n in (1, 2, 4, 6):
        spring = (
            rng.uniform(0.5, 2, n) * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1) + 2 * np.eye(n)
        )
        limits = rng.uniform(0.5, 2, n)
        coordinates = [f"u{i}" for i in range(n)]
        system = vv.PolynomialSystem(
            mass=np.diag(rng.uniform(0.5, 2, n)),
            stiffness=spring,
            damping=0.01 * spring,
            forces=[f"{mu}*sign({name}_dot)" for mu, name in zip(limits, coordinates, strict=True)],
            names=coordinates,
        )
        with warnings.catch_warnings():
            warnings.simplefilter("error", vv.RangeWarning)
            run = vv.simulate(system, 2e3, load=0.9 * limits, nu=0.01, dt=0.5, events=["u0_dot"])
        assert np.abs(run.state).max() < 1e-20
        assert run.events[0].t.size == 0
