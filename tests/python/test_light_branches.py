"""Branches with very light damping: step sizes follow the rotation of the motion."""

import warnings

import numpy as np
import pytest
import viscovib as vv


def test_what_rounding_leaves_is_reported():
    body = vv.PolynomialSystem(mass=1, stiffness=1, damping=1e-8, forces="0.5*x^3")
    with pytest.warns(vv.ConvergenceWarning) as reported:
        branch = vv.trace_response(body, (0.5, 3), load=2e-8, harmonics=15, stability=False)
    assert any("the rounding error exceeds the tolerance" in str(w.message) for w in reported)
    assert 1e-10 < branch.error.max() < 1e-4


def off_curve(branch, i, damping, cubic, load, at_value=False):
    """Distance of a point from the Duffing branch, by residuals in extended precision.

    With `at_value`: distance of its motion from the motion at its nu.
    """
    kept = np.flatnonzero(branch.coefficients[i, 0])
    k = branch.harmonics[kept].astype(np.longdouble)
    x, nu = branch.coefficients[i, 0, kept].astype(np.clongdouble), np.longdouble(branch.nu[i])
    # Angles of the samples, 2 pi j/n, with more digits than np.pi.
    n = 4 * int(k.max()) + 4
    turn = np.exp(2j * np.arccos(np.longdouble(-1)) * np.arange(n)[:, np.newaxis] * k / n)

    def residual(x, nu):
        wave = (turn @ x).imag
        force = 2j / n * (turn.conj().T @ (cubic * wave**3))
        return x * (1 - (k * nu) ** 2 + 1j * k * nu * damping) + force - load * (k == 1)

    def real(z):
        return np.array([z.real, z.imag])

    h = np.longdouble(1e-9)
    columns = [
        (residual(x + h * d, nu) - residual(x - h * d, nu)) / (2 * h)
        for d in [*np.eye(k.size), *(1j * np.eye(k.size))]
    ]
    columns.append((1 - at_value) * (residual(x, nu + h) - residual(x, nu - h)) / (2 * h))
    slopes = np.array([real(c).ravel() for c in columns], dtype=float).T
    rest = real(residual(x, nu)).astype(float).ravel()
    step = np.linalg.lstsq(slopes, -rest, rcond=None)[0][:-1]
    return np.linalg.norm(step) / abs(branch.coefficients[i, 0, 0])


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
def test_the_error_of_a_point_is_that_of_its_motion_at_its_frequency():
    """Regression: stated errors of 1e-24 to 1e-14 where rounding/damping gave 1e-9."""
    rng = np.random.default_rng(5)
    for exponent in range(-9, 0):
        damping, cubic = 10.0**exponent * rng.uniform(0.5, 2), rng.uniform(0.1, 2)
        load = damping * rng.uniform(0.5, 3)
        body = vv.PolynomialSystem(mass=1, stiffness=1, damping=damping, forces=f"{cubic}*x^3")
        branch = vv.trace_response(body, (0.5, 2.5), load=load, harmonics=5, stability=False)
        # Near folds a single step of Newton's method does not give the distance.
        for i in rng.permutation(np.flatnonzero(branch.error < 1e-6))[:40]:
            off = off_curve(branch, i, damping, cubic, load, at_value=True)
            # Steps with kept factors may leave a hundredth of the tolerance unseen.
            assert off < 3 * branch.error[i] + 1e-12, (damping, cubic, load, branch.nu[i])


def test_rounding_is_no_lack_of_harmonics():
    """Rounding errors divided by the damping must not count as omitted harmonics.

    Points with factors from another point had errors of up to 2e-8 with a stated error of 1e-14.
    """
    rng = np.random.default_rng(0)
    for _ in range(6):
        damping, cubic = 10 ** rng.uniform(-9, -6), rng.uniform(0.1, 2)
        load = damping * rng.uniform(0.5, 3)
        body = vv.PolynomialSystem(mass=1, stiffness=1, damping=damping, forces=f"{cubic}*x^3")
        with warnings.catch_warnings(record=True) as reported:
            warnings.simplefilter("always")
            branch = vv.trace_response(body, (0.9, 1.6), load=load, stability=False)
        assert "too few harmonics" not in repr(branch)
        assert branch.highest.max() <= 21
        words = [str(w.message) for w in reported]
        blurred = np.flatnonzero(branch.error > 1e-10)
        assert len(words) == bool(blurred.size)
        assert all("the rounding error exceeds the tolerance" in one for one in words)
        for i in {*blurred[:: max(1, blurred.size // 6)], *np.argsort(-branch.truncation)[:4]}:
            off = off_curve(branch, i, damping, cubic, load)
            assert off < 2 * max(branch.error[i], 1e-10), (damping, cubic, i, off)
        with pytest.warns(vv.ConvergenceWarning) as reported:
            vv.trace_response(body, (0.9, 1.6), load=load, stability=False, harmonics=1)
        assert any("harmonics up to 1 do not reach" in str(w.message) for w in reported)


def random_chain(seed):
    """One to three masses, damping 1e-8 to 1e-3 of the stiffness, small loads."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 4))
    mass = np.diag(rng.uniform(0.5, 2, n))
    springs = rng.uniform(0.5, 2, n + 1)
    stiffness = np.diag(springs[:-1] + springs[1:])
    stiffness -= np.diag(springs[1:-1], 1) + np.diag(springs[1:-1], -1)
    c = 10 ** rng.uniform(-8, -3)
    names = tuple(f"x{i + 1}" for i in range(n))
    forces = {name: f"{rng.uniform(0, 1):.3f}*{name}^3" for name in names}
    if rng.random() < 0.3:
        forces = {k: f"{v} + {rng.uniform(-0.3, 0.3):.3f}*{k}^2" for k, v in forces.items()}
    load = np.zeros(n)
    load[0] = c * 10 ** rng.uniform(-0.5, 0.5)
    system = vv.PolynomialSystem(
        mass=mass, stiffness=stiffness, damping=c * stiffness, forces=forces, names=names
    )
    omega = np.sqrt(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real)
    return system, {1: list(load)}, (0.4 * omega.min(), 1.5 * omega.max())


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.parametrize("seed", range(8))
def test_folds_do_not_depend_on_steps(seed):
    """Regression: repeated, stuck or missing folds; internal resonances are included."""
    system, load, ends = random_chain(seed)
    some, many = (
        vv.trace_response(
            system, ends, load=load, harmonics=7, stability=False, max_points=20000, max_step=step
        )
        for step in (0.1, 0.02)
    )
    assert some.outcome == many.outcome == "completed"
    assert some.folds.size % 2 == 0
    assert some.nu.size < 700
    order = np.argsort(many.folds)
    assert np.sort(some.folds) == pytest.approx(many.folds[order], rel=1e-8)
