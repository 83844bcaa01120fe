"""Motions of polynomial systems in time against responses and other methods."""

import matplotlib
import numpy as np
import pytest
import viscovib as vv
from polynomial_examples import KERNEL, chain
from referee.integration import solve_ivp

matplotlib.use("Agg")


def test_energy_needs_a_potential():
    system = chain(3, damping=0.0)
    state = np.array([0.3, 0.1, -0.2, 0.4, 0.5, 0.0])
    u, v = state[::2], state[1::2]
    stretch = np.diff(np.concatenate([[0], u, [0]]))
    expected = (v @ v + (stretch**2).sum()) / 2 + 0.05 * (stretch**4).sum()
    assert system.energy(state) == pytest.approx(expected, rel=1e-14)
    odd = vv.PolynomialSystem(mass=[1, 1], stiffness=[1, 1], forces={"x1": "x2^3"})
    with pytest.raises(vv.InputError, match=r"x2\^3 on x1 has no potential"):
        odd.energy(np.zeros(4))
    with pytest.raises(vv.InputError, match="energy is not defined with memory"):
        chain(2, kernel=KERNEL).energy(np.zeros(4))


@pytest.mark.parametrize("method", ["gauss8", "gauss3"])
def test_rest_where_large_terms_cancel(method):
    """Near an equilibrium accelerations are small differences; step equations still converge."""
    wells = vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.3, forces="x^3")
    heavy = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.3)
    run = vv.simulate(wells, 120, dt=0.13, initial=[1.0, 0.3], method=method)
    assert run.outcome == "completed"
    assert np.abs(run.state[-1] - [1.0, 0.0]).max() < 1e-7
    run = vv.simulate(heavy, 150, dt=0.13, load={0: 1j}, nu=1.0, method=method)
    decay = np.sqrt(1 - 0.15**2)
    t = run.t
    x = 1 - np.exp(-0.15 * t) * (np.cos(decay * t) + 0.15 / decay * np.sin(decay * t))
    np.testing.assert_allclose(run.state[:, 0], x, atol=1e-5 if method == "gauss3" else 1e-14)


def retained(mass, damping, stiffness, power, terms):
    """Equations of a motion with a force power x1^3; terms (weight, rate) of the kernel."""
    n = mass.shape[0]

    def slope(t, y):
        u, v, z = y[:n], y[n : 2 * n], y[2 * n :].reshape(len(terms), n)
        force = stiffness @ u
        force[0] += power * u[0] ** 3
        # Each term of the kernel has z' = w f - r z for every force.
        more = [w * force - r * one for (w, r), one in zip(terms, z, strict=True)]
        a = np.linalg.solve(mass, 0.3 * np.sin(1.1 * t) - damping @ v - force + z.sum(axis=0))
        return np.concatenate([v, a, *more])

    return slope


@pytest.mark.parametrize(
    ("terms", "in_law"),
    [([], False), ([], True), ([(0.2, 1.0), (0.1, 9.0)], False)],
    ids=["none", "in a law", "prony"],
)
def test_strong_dampers_cost_nothing(terms, in_law):
    """Fast decay needs no short steps, for any number of coordinates, wherever a damper stands."""
    rng = np.random.default_rng(9)
    kernel = None
    if terms:
        weights, rates = zip(*terms, strict=True)
        kernel = vv.PronyKernel(weights=weights, rates=rates)
    for n in (1, 2, 3, 5):
        root = rng.normal(size=(n, n))
        stiffness = root @ root.T + np.eye(n)
        damping = np.diag(10.0 ** rng.uniform(2.5, 5, n)) + 0.1 * stiffness
        mass = np.diag(rng.uniform(0.5, 2, n))
        power = float(rng.uniform(0.1, 1))
        names = [f"x{i + 1}" for i in range(n)]
        own, force = damping.copy(), f"{power!r}*x1^3"
        if in_law:
            force += f" + {float(own[0, 0])!r}*x1_dot"
            own[0, 0] = 0.0
        system = vv.PolynomialSystem(
            mass=mass, stiffness=stiffness, damping=own, forces={"x1": force}, kernel=kernel,
            names=names,
        )  # fmt: skip
        start = np.zeros(2 * n)
        start[::2] = rng.uniform(-0.5, 0.5, n)
        load = {1: dict.fromkeys(names, 0.3)}
        run = vv.simulate(system, 40.0, initial=start, load=load, nu=1.1, keep="last")
        assert run.stats["steps"] < 2000
        begin = np.concatenate([start[::2], start[1::2], np.zeros(len(terms) * n)])
        slope = retained(mass, damping, stiffness, power, terms)
        true = solve_ivp(slope, (0, 40.0), begin, method="Radau", rtol=1e-9, atol=1e-11).y[:, -1]
        np.testing.assert_allclose(run.state[0, ::2], true[:n], rtol=0, atol=1e-7)
