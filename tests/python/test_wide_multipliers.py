"""Multipliers of very different size: slow loads, the smallest below rounding of the largest.

For a linear response the exponents are those of the linear part, for any period.
"""

import numpy as np
import pytest
import viscovib as vv


def linear_exponents(mass, stiffness, damping):
    n = len(mass)
    low = [-np.linalg.solve(np.diag(mass), part) for part in (stiffness, damping)]
    values = np.linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], low]))
    return np.sort(values.real)[::-1]


@pytest.mark.parametrize("symmetric", [True, False])
def test_exponents_of_saddles_under_slow_loads(symmetric):
    rng = np.random.default_rng(5 + symmetric)
    spread = 0.0
    for _ in range(60):
        n = int(rng.integers(1, 5))
        a, b = rng.normal(size=(2, n, n))
        stiffness = a + a.T + rng.uniform(-1, 3) * np.eye(n)
        damping = 0.1 * rng.uniform() * b @ b.T + 1e-3 * np.eye(n)
        mass = rng.uniform(0.5, 2, n)
        true = linear_exponents(mass, stiffness, damping)
        # The largest multiplier is far above 1/epsilon, but finite.
        nu = max(2 * np.pi * np.abs(true).max() / rng.uniform(5, 600), 0.005)
        system = vv.PolynomialSystem(
            mass=mass.tolist(), stiffness=stiffness.tolist(), damping=damping.tolist(),
            forces=[vv.Monomial(coefficient=1.0, powers=(3,) + (0,) * (n - 1), on=0)],
        )  # fmt: skip
        branch = vv.trace_response(
            system, nu=nu, load_range=(0.9, 1.1), load={1: (1e-9 * rng.normal(size=n)).tolist()},
            harmonics=3, max_points=3, symmetric=symmetric,
        )  # fmt: skip
        assert (branch.growing == (true > 0).sum()).all()
        assert branch.exponents[0].real == pytest.approx(true, abs=1e-6 * np.abs(true).max())
        assert not branch.crossings
        spread = max(spread, np.ptp(branch.exponents[0].real) * 2 * np.pi / nu)
    assert spread > 500


def test_a_multiplier_beyond_the_range_of_numbers_is_not_known():
    system = vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.1, forces="x^3")
    with pytest.warns(vv.StabilityWarning, match="unknown"):
        branch = vv.trace_response(system, nu=1e-3, load_range=(1e-3, 2e-3), load=1, max_points=3)
    assert branch.growing is None


def test_exponents_of_a_pendulum_under_a_slow_load():
    rng = np.random.default_rng(3)
    for _ in range(12):
        e, w2, w3 = rng.uniform(0.03, 0.1), rng.uniform(0.4, 0.6), rng.uniform(0.9, 1.1)
        c, p1 = rng.uniform(0.01, 0.9, 3), rng.uniform(0.01, 0.05)
        system = vv.Pendulum(e=e, w2=w2, w3=w3, c1=c[0], c2=c[1], c3=c[2], f0=1e-9, p1=p1)
        step = 1e-5
        a = np.array([
            (system.rhs(0, row) - system.rhs(0, -row)) / (2 * step) for row in step * np.eye(6)
        ]).T  # fmt: skip
        true = np.sort(np.linalg.eigvals(a).real)[::-1]
        branch = vv.trace_response(system, f0=(1e-9, 2e-9), harmonics=3, max_points=3)
        sizes = np.log(np.abs(branch.multipliers[0])) * p1 / (2 * np.pi)
        assert np.sort(sizes)[::-1] == pytest.approx(true, abs=1e-5)
