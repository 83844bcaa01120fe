"""Loads and motions with hundreds of harmonics, against closed forms."""

import numpy as np
import pytest
import viscovib as vv

#: Den Hartog (Trans. ASME 53, 1931): x'' + x + R sgn x' = cos(nu t) without sticking has the
#: amplitude X = sqrt(1/(1-nu^2)^2 - (R sin(pi/nu)/(nu (1 + cos(pi/nu))))^2); pairs (nu, R).
DEN_HARTOG = [(0.8, 0.2), (1.2, 0.3)]


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


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
def test_friction_of_den_hartog():
    """Errors of 1e-4 with 299 harmonics, decreasing as 1/K, and covered by the estimate."""
    wanted = 0.0
    highest = np.array([99, 199, 299, 399])
    for nu, friction in DEN_HARTOG:
        turn = np.pi / nu
        damped = friction * np.sin(turn) / (nu * (1 + np.cos(turn)))
        amplitude = np.sqrt(1 / (1 - nu**2) ** 2 - damped**2)
        system = vv.PolynomialSystem(mass=1, stiffness=1, forces=f"{friction}*sign(x_dot)")
        errors = []
        for k in highest.tolist():
            found = vv.forced_response(system, [nu], load=1, method="newton", harmonics=k)
            errors.append(abs(found.peak_to_peak("x")[0] / 2 / amplitude - 1))
            assert errors[-1] < found.truncation[0]
        order = -np.polyfit(np.log(highest), np.log(errors), 1)[0]
        assert order == pytest.approx(1, abs=0.01)
        wanted = max(wanted, errors[2])
    assert wanted < 1e-4


def test_what_is_refused():
    """One harmonic above the limit, with name and value."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.2, forces="0.1*x^3")
    with pytest.raises(vv.InputError, match=r"harmonics = 400: must be"):
        vv.forced_response(system, [0.7], load=1, method="newton", harmonics=400)
    with pytest.raises(vv.InputError, match="must be at least 401, the highest order of the load"):
        vv.forced_response(system, [0.7], load={401: 1.0}, method="newton", harmonics="auto")
