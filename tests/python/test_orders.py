"""Automatic harmonics at each frequency, and the estimate of the effect of omitted ones."""

import warnings

import numpy as np
import pytest
import viscovib as vv

# Few harmonics are intended here; test_truncation.py tests the warning.
pytestmark = pytest.mark.filterwarnings("ignore:.*estimated relative error")

KERNEL = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
DUFFING = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="x^3")


def random_mount(rng, geometry="cubic", kernel=None):
    stiffness_x, stiffness_phi, offset = rng.uniform((5, 1, 0.1), (20, 5, 0.8))
    stiffness = np.array(
        [
            [stiffness_x, -stiffness_x * offset],
            [-stiffness_x * offset, stiffness_phi + stiffness_x * offset**2],
        ]
    )
    return vv.Mount(
        mass=rng.uniform(0.5, 2),
        inertia=rng.uniform(0.05, 0.5),
        offset=offset,
        stiffness_x=stiffness_x,
        stiffness_phi=stiffness_phi,
        damping=0.02 * stiffness,
        kernel=kernel,
        geometry=geometry,
    )


def random_system(rng):
    """Quadratic and cubic springs between two masses."""
    a, b, c, d = rng.uniform((0.1, -0.3, 0.1, -0.3), (1, 0.3, 1, 0.3))
    return vv.PolynomialSystem(
        mass=rng.uniform(0.5, 2, 2),
        stiffness=[[2, -1], [-1, 1.5]],
        damping=[[0.1, -0.05], [-0.05, 0.1]],
        forces={"x1": f"{a}*x1^3 + {b}*x1^2", "x2": f"{c}*x2^3 + {d}*x2^2"},
    )


def size(system, coefficients):
    """The norm of the tolerances, shape (n,)."""
    inertia = np.asarray(system.mass, dtype=float)
    if isinstance(system, vv.Mount):
        inertia = np.array([system.mass, system.inertia])
    weights = np.sqrt(np.diag(inertia) if inertia.ndim == 2 else np.atleast_1d(inertia))
    parts = np.abs(coefficients.real) + np.abs(coefficients.imag)
    return (weights[:, np.newaxis] * parts).max(axis=(1, 2))


def compare(system, nu, load, tolerance):
    """Response with its true errors, by twice as many harmonics plus twenty."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vv.ConvergenceWarning)
        r = vv.forced_response(
            system, nu, load=load, method="newton", harmonics="auto", tolerance=tolerance
        )
        more = 2 * int(r.harmonics[-1]) + 21
        exact = vv.forced_response(
            system, nu, load=load, method="newton", harmonics=more, tolerance=1e-14
        )
    kept = np.zeros_like(exact.coefficients)
    kept[:, :, : r.harmonics.size] = r.coefficients
    error = size(system, kept - exact.coefficients) / size(system, exact.coefficients)
    # The two sweeps may leave their branch at slightly different frequencies.
    same = r.converged & exact.converged & (error < 1e-2)
    return r, error, same


SYSTEMS = {
    "cubic": lambda rng: random_mount(rng),
    "exact": lambda rng: random_mount(rng, "exact"),
    "cubic with memory": lambda rng: random_mount(rng, "cubic", KERNEL),
    "exact with memory": lambda rng: random_mount(rng, "exact", KERNEL),
    "polynomial": random_system,
}


@pytest.mark.parametrize("kind", SYSTEMS)
@pytest.mark.parametrize("mean", [False, True])
def test_the_estimate_is_the_error(kind, mean):
    """Estimate divided by true error for random systems; errors below 1e-13 are rounding errors."""
    rng = np.random.default_rng(5)
    ratios, seen = [], []
    for tolerance in (1e-4, 1e-7, 1e-10):
        for _ in range(1):
            system = SYSTEMS[kind](rng)
            slow, fast = system.natural_frequencies()
            nu, load = np.linspace(0.2 * slow, 2 * fast, 30), 10 ** rng.uniform(-1.5, 0)
            r, error, same = compare(
                system, nu, {1: load, 0: 0.3j * load} if mean else load, tolerance
            )
            assert (r.truncation[r.converged] <= tolerance).all()
            assert error[same].max() < 1.05 * tolerance
            reported = same & (error > 1e-13)
            ratios.append(r.truncation[reported] / error[reported])
            seen.append(same)
    assert np.mean(seen) > 0.85
    ratio = np.concatenate(ratios)
    assert ratio.size > 30
    assert ratio.min() > 0.9
    assert ratio.max() < 3
    assert np.mean((ratio > 0.99) & (ratio < 1.1)) > 0.9


def test_orders_come_and_go():
    """Few for a nearly sinusoidal motion, more at low frequencies, in both sweep directions."""
    nu = np.linspace(0.1, 5, 200)
    up, error, same = compare(DUFFING, nu, 0.5, 1e-9)
    assert same.all()
    assert error.max() < 1e-9
    assert up.highest[0] > 20
    assert up.highest[-1] <= 5
    assert up.highest.max() == up.harmonics[-1]
    assert (up.highest % 2 == 1).all()
    # No more than necessary: two harmonics less would increase the error tenfold at least.
    fewer = np.searchsorted(up.harmonics, up.highest)
    last = np.abs(up.coefficients[np.arange(nu.size), 0, fewer])
    needed = last / np.abs(up.coefficients[:, 0]).max(axis=1) > 1e-11
    assert needed[1:].mean() > 0.9
    down = vv.forced_response(
        DUFFING, nu[::-1], load=0.5, method="newton", harmonics="auto", tolerance=1e-9
    )
    assert down.highest[-1] == pytest.approx(up.highest[0], abs=4)


def test_orders_not_kept_are_zero():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vv.ConvergenceWarning)
        r = vv.forced_response(
            DUFFING, [1e200, 3.0, 0.05, 1e-3], load=0.5, method="newton", harmonics="auto",
            tolerance=1e-6,
        )  # fmt: skip
    for i in range(r.nu.size):
        if r.converged[i]:
            kept = r.harmonics <= r.highest[i]
            assert np.isfinite(r.coefficients[i]).all()
            assert (r.coefficients[i][:, ~kept] == 0).all()
            assert r.truncation[i] >= 0
        else:
            assert r.highest[i] == 0
            assert np.isnan(r.truncation[i])
            assert np.isnan(r.coefficients[i]).all()
    assert r.converged.tolist() == [False, True, True, True]
    assert r.highest[2] == r.harmonics[-1] > r.highest[1]


def test_an_order_of_the_load_moves_its_multiples():
    """Harmonics 3, 9, 15, ... only: zero harmonics between must not end the search."""
    r, error, same = compare(DUFFING, np.linspace(0.1, 0.5, 20), {3: 0.5}, 1e-8)
    assert same.all()
    assert error.max() < 1e-8
    moved = np.abs(r.coefficients[:, 0]).max(axis=0) > 1e-12
    assert (r.harmonics[moved] % 3 == 0).all()
    base = vv.forced_response(
        DUFFING, 3 * r.nu, load=0.5, method="newton", harmonics="auto", tolerance=1e-8
    )
    k = base.harmonics.size
    assert r.coefficients[:, 0, r.harmonics % 3 == 0][:, :k] == pytest.approx(
        base.coefficients[:, 0, : (r.harmonics % 3 == 0).sum()], abs=3e-8
    )


def test_rounding_ends_the_search():
    r = vv.forced_response(
        DUFFING, np.linspace(0.5, 3, 50), load=0.5, method="newton", harmonics="auto",
        tolerance=1e-14,
    )  # fmt: skip
    assert r.highest.max() < 80


def test_too_few_orders_are_reported():
    with pytest.warns(vv.ConvergenceWarning, match="harmonics do not reach the tol"):
        r = vv.forced_response(
            DUFFING, 0.002, load=30, method="newton", harmonics="auto", tolerance=1e-12
        )
    assert r.highest[0] == 199
    assert r.truncation[0] > 1e-12


def test_the_plan_says_so():
    text = vv.plan_response(DUFFING, [1.0, 2.0], load=1, method="newton", harmonics="auto")
    assert "harmonics chosen at each frequency to meet the tolerance, at most 199" in str(text)
    assert "skips: even harmonics" in str(text)
    chain = 2 * np.eye(50) - np.eye(50, k=1) - np.eye(50, k=-1)
    many = vv.PolynomialSystem(
        mass=np.ones(50), stiffness=chain, forces={f"x{i + 1}": f"x{i + 1}^3" for i in range(50)}
    )
    text = vv.plan_response(many, 1.0, load=1, method="newton", harmonics="auto")
    assert "at most 39" in str(text)


def test_successive_approximations_take_as_many_everywhere():
    body = vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, kernel=KERNEL)
    nu = np.linspace(0.3, 12, 5000)
    r = vv.forced_response(body, nu, load=0.05, harmonics="auto", tolerance=1e-10)
    assert r.converged.all()
    assert r.truncation.max() <= 1e-10
    assert r.corrections.shape[0] == nu.size
    exact = vv.forced_response(body, nu, load=0.05, harmonics=41, tolerance=1e-13)
    assert np.abs(exact.coefficients[:, :, : r.harmonics.size] - r.coefficients).max() < 1e-9


def test_linear_systems_need_no_choice():
    linear = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1)
    r = vv.forced_response(linear, [0.5, 1.0], load=1, method="newton", harmonics="auto")
    assert r.harmonics.tolist() == [1]
    assert (r.truncation == 0).all()
    assert (r.highest == 1).all()
