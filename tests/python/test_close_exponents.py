"""Close exponents of weakly coupled memory: reported as the eigenvalues."""

import numpy as np
import pytest
import viscovib as vv


def eigenvalues(mass, damping, stiffness, weights, rates):
    """Eigenvalues of the linear system with each exponential as a state.

    x'' = M^-1 (-C x' - K x + sum w h), h' = K x - r h.
    """
    n, m = len(mass), len(rates)
    a = np.zeros(((2 + m) * n, (2 + m) * n))
    a[:n, n : 2 * n] = np.eye(n)
    a[n : 2 * n, :n] = -stiffness / mass[:, None]
    a[n : 2 * n, n : 2 * n] = -damping / mass[:, None]
    for j, (w, r) in enumerate(zip(weights, rates, strict=True)):
        rows = slice((2 + j) * n, (3 + j) * n)
        a[n : 2 * n, rows] = w * np.diag(1 / mass)
        a[rows, :n] = stiffness
        a[rows, rows] = -r * np.eye(n)
    return np.linalg.eigvals(a)


@pytest.mark.parametrize("seed", [*range(9), 139])
def test_exponents_side_by_side(seed):
    """Errors below their distance; a single exponent to the root of rounding; complete count."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 5))
    mass = rng.uniform(0.5, 2, n)
    springs = rng.uniform(0.5, 2, n + 1)
    stiffness = np.diag(springs[:-1] + springs[1:])
    stiffness -= np.diag(springs[1:-1], 1) + np.diag(springs[1:-1], -1)
    damping = rng.uniform(0.02, 0.06) * stiffness
    weights = [10 ** rng.uniform(-4.5, -2.5), rng.uniform(0.01, 0.1)]
    rates = [rng.uniform(0.02, 0.1), rng.uniform(0.5, 1.5)]
    nu = rng.uniform(0.8, 3)
    r = vv.forced_response(
        vv.PolynomialSystem(
            mass=mass,
            damping=damping,
            stiffness=stiffness,
            forces=[vv.Monomial(coefficient=0.1, powers=(0,) * (n - 1) + (3,), on=n - 1)],
            kernel=vv.PronyKernel(weights=weights, rates=rates),
        ),
        [nu],
        load=1e-5,
        method="newton",
        stability=True,
    )
    # Multipliers determine exponents up to integer multiples of i nu.
    reported = r.multipliers[0][np.isfinite(r.multipliers[0])]
    true = np.exp(2 * np.pi / nu * eigenvalues(mass, damping, stiffness, weights, rates))
    slow = true[np.abs(true) > np.exp(-2 * np.pi / nu * 0.5)]
    if r.slowest[0]:
        assert abs(reported[0]) == pytest.approx(np.abs(true).max(), abs=2e-5)
    for one in reported[np.abs(reported) > np.abs(slow).min() - 1e-6]:
        nearby = slow[np.abs(slow - one) < 1e-3]
        apart = np.abs(nearby[:, None] - nearby).max()
        assert np.abs(nearby - one).min() < 1e-8 + apart
