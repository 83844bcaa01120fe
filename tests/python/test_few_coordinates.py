"""Multipliers of structures with few coordinates, whose perturbations are integrated."""

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp


def laws(d, v):
    """Derivatives of the element forces with respect to deflection and rate."""
    return [
        (1.2 * d[0] ** 2, 0.0),
        (3 / np.cosh(3 * d[1]) ** 2, 0.2 / np.cosh(v[1]) ** 2),
    ]


def random_structure(rng, n, damping):
    """Some masses, springs, two elements; the kind of damping determines the modes."""
    stiffness = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    half = 0.2 * rng.normal(size=(n, n))
    mass = np.diag(rng.uniform(0.5, 2, n)) + half @ half.T
    if damping == "modal":
        # The stiffness includes the linear part of the second element.
        held = np.zeros((n, n))
        held[1, 1] = 3.0
        c = 0.02 * (stiffness + held)
        c[1, 1] -= 0.2
    else:
        turned = 0.05 * rng.normal(size=(n, n))
        c = np.diag(rng.uniform(0, 0.1, n)) + turned - turned.T
    elements = [
        vv.Spring(on=("x1", f"x{n}"), law="0.4*d^3"),
        vv.Spring(on="x2", law="tanh(3*d) + 0.2*tanh(v)"),
    ]
    structure = vv.Structure(mass=mass, stiffness=stiffness, damping=c, elements=elements)
    q = np.zeros((n, 2))
    q[0, 0], q[n - 1, 0], q[1, 1] = 1, -1, 1
    return structure, mass, c, stiffness, q


@pytest.mark.parametrize("damping", ["modal", "gyroscopic"])
@pytest.mark.parametrize("n", [2, 5])
def test_multipliers_against_integration(n, damping):
    rng = np.random.default_rng(n)
    structure, mass, c, k, q = random_structure(rng, n, damping)
    nu = np.array([0.7, 1.3])
    load = rng.uniform(0.1, 0.3, n)
    response = vv.forced_response(
        structure, nu, load=load, method="newton", harmonics=61, tolerance=1e-9, stability=True
    )
    assert response.multipliers.shape[1] >= min(2 * n, 8)
    for i, omega in enumerate(nu):
        harmonics, orders = response.coefficients[i], np.asarray(response.harmonics)

        def slope(t, y, omega=omega, harmonics=harmonics, orders=orders):
            wave = np.exp(1j * omega * orders * t)
            u = (harmonics * wave).sum(axis=1).imag
            du = (harmonics * wave * 1j * omega * orders).sum(axis=1).imag
            by_d, by_v = k.copy(), c.copy()
            for a, (one, two) in enumerate(laws(q.T @ u, q.T @ du)):
                by_d = by_d + one * np.outer(q[:, a], q[:, a])
                by_v = by_v + two * np.outer(q[:, a], q[:, a])
            y = y.reshape(2 * n, 2 * n)
            return np.concatenate(
                [y[n:], -np.linalg.solve(mass, by_d @ y[:n] + by_v @ y[n:])]
            ).ravel()

        run = solve_ivp(slope, (0, 2 * np.pi / omega), np.eye(2 * n).ravel(), "DOP853",
                        rtol=1e-11, atol=1e-12)  # fmt: skip
        true = np.linalg.eigvals(run.y[:, -1].reshape(2 * n, 2 * n))
        found = response.multipliers[i]
        for value in found[~np.isnan(found)]:
            assert np.abs(true - value).min() < 1e-8
        assert np.abs(found[0]) == pytest.approx(np.abs(true).max(), rel=1e-8)
        assert response.stable[i] == (np.abs(true).max() < 1)
