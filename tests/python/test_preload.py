"""Polynomial laws with a force at rest (static preload): every method, against SciPy."""

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp


def draw(seed):
    """Parameters of x'' + c x' + (k + a) x + b x^3 + q x^2 + p - memory = P sin(nu t)."""
    rng = np.random.default_rng(seed)
    return dict(
        k=rng.uniform(0.8, 2), c=rng.uniform(0.1, 0.3), a=rng.uniform(0, 0.5),
        q=rng.uniform(-0.2, 0.2), b=rng.uniform(0.1, 0.5), p=rng.uniform(-0.5, 0.5),
        load=rng.uniform(0.1, 0.4), nu=rng.uniform(0.5, 2.0),
        weight=rng.uniform(0.1, 0.4), rate=rng.uniform(0.3, 2.0),
    )  # fmt: skip


def text(n, name="x"):
    return f"{n['a']!r}*{name} + {n['q']!r}*{name}^2 + {n['b']!r}*{name}^3 + {n['p']!r}"


def truth(n, start, t, remembers=False):
    """States at times t by SciPy; the memory of the law is an additional equation."""

    def law(x):
        return n["a"] * x + n["q"] * x**2 + n["b"] * x**3 + n["p"]

    def slope(time, s):
        x, v, m = s
        force = law(x) - n["weight"] * m * remembers
        pushed = n["load"] * np.sin(n["nu"] * time)
        return [v, pushed - n["c"] * v - n["k"] * x - force, law(x) - n["rate"] * m]

    run = solve_ivp(
        slope, (0, t[-1]), [*start, 0], method="DOP853", rtol=1e-12, atol=1e-13, t_eval=t
    )
    return run.y[:2].T


def systems(n):
    """The same system as coordinates and as a structure."""
    springs = dict(mass=[[1.0]], stiffness=[[n["k"]]], damping=[[n["c"]]])
    element = vv.Spring(on="x", law=text(n, "d"))
    return [
        vv.PolynomialSystem(**springs, forces=text(n)),
        vv.Structure(**springs, elements=[element], names=["x"]),
    ]


@pytest.mark.parametrize("seed", range(3))
def test_steady_motions_and_motions_in_time(seed):
    n = draw(seed)
    period = 2 * np.pi / n["nu"]
    late = period * np.concatenate([[0], 70 + np.arange(16) / 16])
    t = np.linspace(0, 15, 31)
    start = [0.3, -0.2]
    steady, in_time = truth(n, [0, 0], late)[1:], truth(n, start, t)
    for system in systems(n):
        for method in ("newton", "successive"):
            found = vv.forced_response(
                system, [n["nu"]], load=n["load"], method=method, harmonics=25
            )
            if method == "successive" and not found.converged[0]:
                continue
            assert found.converged.all()
            waves = np.exp(2j * np.pi * np.outer(found.harmonics, np.arange(16) / 16))
            x = (found.coefficients[0, 0] @ waves).imag
            np.testing.assert_allclose(x, steady[:, 0], atol=1e-8)
        run = vv.simulate(system, 15, load=n["load"], nu=n["nu"], initial=start, times=t)
        np.testing.assert_allclose(run.state, in_time, atol=1e-8)
    plan = vv.plan_response(systems(n)[0], [n["nu"]], load=n["load"], method="newton")
    assert "the static preload" in str(plan)


@pytest.mark.parametrize("seed", range(2))
def test_behind_a_kernel(seed):
    n = draw(100 + seed)
    kernel = vv.PronyKernel(weights=[n["weight"]], rates=[n["rate"]])
    system = vv.PolynomialSystem(
        mass=1, stiffness=n["k"], damping=n["c"],
        springs=[vv.Springs(forces=text(n), kernel=kernel)],
    )  # fmt: skip
    period = 2 * np.pi / n["nu"]
    late = period * np.concatenate([[0], 90 + np.arange(16) / 16])
    steady = truth(n, [0, 0], late, remembers=True)[1:]
    found = vv.forced_response(system, [n["nu"]], load=n["load"], method="newton", harmonics=25)
    waves = np.exp(2j * np.pi * np.outer(found.harmonics, np.arange(16) / 16))
    x = (found.coefficients[0, 0] @ waves).imag
    np.testing.assert_allclose(x, steady[:, 0], atol=1e-8)
    t = np.linspace(0, 15, 31)
    run = vv.simulate(system, 15, load=n["load"], nu=n["nu"], initial=[0.3, -0.2], times=t)
    np.testing.assert_allclose(run.state, truth(n, [0.3, -0.2], t, remembers=True), atol=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_branches_stability_and_ensembles(seed):
    """Points of a branch are responses; its exponents agree with SciPy; a member is a run."""
    n = draw(200 + seed)
    system = systems(n)[0]
    branch = vv.trace_response(system, (0.8, 1.6), load=n["load"], stability=True)
    assert branch.outcome == "completed"
    nu, i = float(branch.nu[branch.nu.size // 2]), branch.nu.size // 2
    waves = np.exp(1j * branch.harmonics[None, :] * 0)
    x = branch.coefficients[i, 0]
    start = [(x * waves).sum().imag, (1j * nu * branch.harmonics * x).sum().imag]
    period = 2 * np.pi / nu
    maps = []
    for nearby in (np.zeros(2), [1e-6, 0], [0, 1e-6], [-1e-6, 0], [0, -1e-6]):
        moved = np.add(start, nearby)
        maps.append(truth(n | {"nu": nu}, moved, np.array([0, period]))[-1])
    np.testing.assert_allclose(maps[0], start, atol=1e-8)
    monodromy = np.array([maps[1] - maps[3], maps[2] - maps[4]]).T / 2e-6
    expected = np.sort(np.abs(np.linalg.eigvals(monodromy)))
    np.testing.assert_allclose(np.sort(np.abs(branch.multipliers[i])), expected, atol=1e-6)
    many = vv.simulate_ensemble(
        system, initial=[[0.3, -0.2], [0.1, 0.4]], t_end=12, load=n["load"], nu=n["nu"]
    )
    for row, first in zip(many.state, ([0.3, -0.2], [0.1, 0.4]), strict=True):
        np.testing.assert_allclose(row, truth(n, first, np.array([0, 12.0]))[-1], atol=1e-7)


@pytest.mark.parametrize("options", [{}, {"dt": 0.1}])
def test_plans_of_motions_in_time_tell_it(options):
    kernel = vv.PronyKernel(weights=[0.3], rates=[0.7])
    one = {"mass": 1, "stiffness": 1, "damping": 0.1}
    stop = {"mass": [[1.0]], "stiffness": [[1.0]], "damping": [[0.1]]}
    reported = "computes: the static preload of laws that are not 0 at rest (up to {})"
    for system, force in (
        (vv.PolynomialSystem(**one, forces="x^3 + 0.3"), 0.3),
        (vv.PolynomialSystem(**one, forces="x^3 + 0.3", kernel=kernel), 0.3),
        (vv.Structure(**stop, elements=[vv.Gap(on="x1", stiffness=2.0, gap=-0.1)]), 0.2),
        (vv.Structure(**stop, elements=[vv.Spring(on="x1", law="0.5*exp(d)")]), 0.5),
    ):
        assert reported.format(force) in str(vv.simulate(system, 3, **options).plan).splitlines()
        many = vv.simulate_ensemble(system, initial=[0, 0], t_end=3, **options)
        assert reported.format(force) in str(many.plan).splitlines()
    plain = vv.PolynomialSystem(**one, forces="x^3 + 0.3*tanh(x)")
    assert "preload" not in str(vv.simulate(plain, 3, **options).plan)
    assert "preload" not in str(vv.simulate_ensemble(plain, initial=[0, 0], t_end=3).plan)
