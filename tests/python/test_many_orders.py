"""Loads and motions with hundreds of harmonics, against closed forms."""

import numpy as np
import pytest
import viscovib as vv


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("n_orders", [199, 201, 450])
def test_linear_loads_of_many_orders(n_orders, seed):
    """Each harmonic is (K - m w^2 + i c w)^-1 times its load, for any number of harmonics."""
    rng = np.random.default_rng(1000 * seed + n_orders)
    m, c = np.diag(rng.uniform(0.5, 2, 2)), np.diag(rng.uniform(0.1, 0.3, 2))
    k = np.array([[2.0, -1], [-1, 3]]) * rng.uniform(0.5, 2)
    system = vv.PolynomialSystem(mass=m, stiffness=k, damping=c)
    orders = np.sort(rng.permutation(np.arange(1, 2000))[:n_orders])
    load = {int(order): rng.normal(size=2) + 1j * rng.normal(size=2) for order in orders}
    nu = rng.uniform(0.3, 2, 2)
    found = vv.forced_response(system, nu, load=load)
    np.testing.assert_array_equal(found.harmonics, orders)
    w = nu[:, np.newaxis] * orders
    stiffness = k - w[..., None, None] ** 2 * m + 1j * w[..., None, None] * c
    expected = np.linalg.solve(stiffness, np.array([load[int(o)] for o in orders])[..., None])
    np.testing.assert_allclose(
        found.coefficients, expected[..., 0].swapaxes(1, 2), rtol=1e-11, atol=1e-15
    )


@pytest.mark.parametrize("harmonics", [299, "auto"])
def test_balances_of_many_orders(harmonics):
    """A law within its linear range: the closed form again, with load harmonics to 299."""
    law = "min(max(0.4*x, -50), 50)"
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.2, forces=law)
    load = {1: 0.3, 220: 5.0, 299: 7.0}
    found = vv.forced_response(system, [0.7], load=load, method="newton", harmonics=harmonics)
    assert found.converged.all()
    for order, force in load.items():
        w = 0.7 * order
        x = found.coefficients[0, 0, found.harmonics == order][0]
        assert x == pytest.approx(force / (1.4 - w**2 + 0.2j * w), rel=1e-9)


def test_branch_with_a_load_of_high_order():
    """Points of the branch are those of the response at their frequencies."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.2, forces="0.1*x^3")
    load = {1: 0.3, 205: 5.0}
    branch = vv.trace_response(
        system, (0.7, 0.75), load=load, harmonics=207, max_points=4, stability=False
    )
    at = vv.forced_response(system, branch.nu[:2], load=load, method="newton", harmonics=207)
    np.testing.assert_allclose(
        branch.coefficients[:2], at.coefficients[..., : branch.coefficients.shape[2]], atol=1e-8
    )


def test_what_is_refused():
    """One harmonic above the limit, with name and value."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.2, forces="0.1*x^3")
    with pytest.raises(vv.InputError, match=r"harmonics = 400: must be"):
        vv.forced_response(system, [0.7], load=1, method="newton", harmonics=400)
    with pytest.raises(vv.InputError, match="must be at least 401, the highest order of the load"):
        vv.forced_response(system, [0.7], load={401: 1.0}, method="newton", harmonics="auto")
