"""Truncation estimates, against three times as many harmonics, and warnings."""

import warnings

import numpy as np
import pytest
import viscovib as vv


def random_system(rng):
    """One to three coupled coordinates, forces of degree 2 to 5, with or without memory."""
    n = int(rng.integers(1, 4))
    names = [f"x{i + 1}" for i in range(n)]
    mass = rng.uniform(0.5, 2, n)
    root = rng.normal(size=(n, n))
    stiffness = root @ root.T + np.diag(rng.uniform(0.5, 2, n))
    forces = {}
    for name in names:
        powers = [rng.multinomial(rng.choice([2, 3, 3, 5]), np.ones(n) / n) for _ in range(2)]
        products = ["*".join(f"{x}^{k}" for x, k in zip(names, p, strict=True) if k)
                    for p in powers]  # fmt: skip
        forces[name] = " + ".join(f"{0.3 * rng.normal():.4f}*{product}" for product in products)
    kernel = None
    if rng.random() < 0.4:
        kernel = vv.PronyKernel(weights=[rng.uniform(0.02, 0.2)], rates=[rng.uniform(0.1, 2)])
    system = vv.PolynomialSystem(
        mass=mass, stiffness=stiffness, damping=rng.uniform(0.02, 0.2) * stiffness, forces=forces,
        names=names, kernel=kernel,
    )  # fmt: skip
    order = int(rng.choice([1, 1, 2, 3]))
    load = {order: rng.normal(size=n) * 10 ** rng.uniform(-1.5, 0.3)}
    if rng.random() < 0.3:
        load[order + 1] = 0.1 * rng.normal(size=n)
    omega = np.sqrt(np.linalg.eigvalsh(stiffness).max() / mass.max())
    return system, mass, load, omega * rng.uniform(0.15, 1.5) / order


def size(mass, x):
    return (np.sqrt(mass)[:, None] * (np.abs(x.real) + np.abs(x.imag))).max()


@pytest.mark.parametrize("method", ["newton", "successive"])
def test_estimates_are_true_errors(method):
    """40 random systems with few harmonics: at least 0.4 of the true error, rarely above 3."""
    rng = np.random.default_rng(14)
    ratios = []
    for _ in range(40):
        system, mass, load, nu = random_system(rng)
        few = int(rng.integers(max(load), max(load) + 8))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", vv.ConvergenceWarning)
            a, b = (
                vv.forced_response(
                    system, nu, load=load, harmonics=k, method=method, tolerance=1e-13
                )
                for k in (few, 3 * few + 20)
            )
        if not (a.converged[0] and b.converged[0]) or b.truncation[0] > 1e-3 * a.truncation[0]:
            continue
        change = b.coefficients[0].copy()
        kept = np.searchsorted(b.harmonics, a.harmonics)
        change[:, kept] -= a.coefficients[0]
        true = size(mass, change) / size(mass, b.coefficients[0])
        if true > 1e-11:
            ratios.append(a.truncation[0] / true)
    assert len(ratios) > 15
    assert min(ratios) > 0.4
    assert np.quantile(ratios, 0.9) < 3


def test_two_orders_that_vanish_tell_nothing():
    """A load of harmonic 3 drives 3, 9, 15: the two highest of 13 are 0, and 15 is missing."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="x^3")
    options = {"nu": 0.15, "load": {3: 0.3}}
    for method in ("newton", "successive"):
        with pytest.warns(vv.ConvergenceWarning, match="harmonics above 13"):
            few = vv.forced_response(system, harmonics=13, method=method, **options)
        all_of_them = vv.forced_response(system, method=method, **options)
        lacking = np.abs(all_of_them.coefficient("x", 15) / all_of_them.coefficient("x", 3))
        assert few.truncation == pytest.approx(lacking, rel=0.5)


@pytest.mark.parametrize("nu", [0.2, 0.05])
def test_a_branch_that_begins_with_too_few_orders_begins_with_more(nu):
    """A solution with nine harmonics exists here, but none with more nearby."""
    if nu == 0.2:
        system, load = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="x^3"), 20
    else:
        system, load = vv.Mount(
            mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, geometry="cubic",
            damping=0.02 * np.array([[10.0, -5.0], [-5.0, 4.5]]),
        ), 10  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vv.ConvergenceWarning)
        branch = vv.trace_response(system, (nu, 1.02 * nu), load=load, stability=False)
    assert branch.nu.size > 1
    assert np.isfinite(branch.coefficients).all()


@pytest.mark.parametrize("method", ["linear", "successive", "newton"])
@pytest.mark.parametrize(("moved", "amplitude"), [("load", 1e160), ("base", 1.79e308)])
def test_no_number_that_is_not_finite_has_converged(method, moved, amplitude):
    system = vv.PolynomialSystem(
        mass=1, stiffness=1, damping=0.05, forces="x^3", base_direction=[1.0]
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vv.ConvergenceWarning)
        r = vv.forced_response(system, [0.5, 1, 2], **{moved: amplitude}, method=method)
    finite = np.isfinite(r.coefficients).all(axis=(1, 2))
    assert (r.converged == finite).all()


def kinked_system(rng, index):
    """One or two masses with friction, hysteresis, a stop or a law with a corner."""
    n = 1 + index // 6 % 2
    k = rng.uniform(0.5, 3)
    stiffness = [[k]] if n == 1 else [[2 * k, -k], [-k, k]]
    matrices = {"mass": np.eye(n) * rng.uniform(0.5, 2), "stiffness": stiffness}
    matrices["damping"] = rng.uniform(0.02, 0.2) * np.array(stiffness)
    a, b, c = rng.uniform(0.3, 3, 3)
    if index % 6 > 3:
        law = f"{0.3 * a}*max(x1 - {0.2 * b}, 0)" if index % 6 == 4 else f"{0.04 * a}*sign(x1_dot)"
        return vv.PolynomialSystem(**matrices, forces={"x1": law}, names=["x1", "x2"][:n])
    element = (
        vv.Jenkins(on="x1", stiffness=a, limit=0.2 * b),
        vv.Iwan(on="x1", stiffness=[a, b, c], limit=[0.1, 0.1 * a, 0.3 * b]),
        vv.BoucWen(on="x1", stiffness=a, ratio=0.1, beta=b, gamma=0.2 * b, exponent=2),
        vv.Stop(on="x1", stiffness=5 * a, gap=0.2 * b),
    )[index % 6]
    return vv.Structure(**matrices, elements=[element])


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
def test_estimates_with_kinks():
    """24 systems, 5 to 31 harmonics: waveforms against three times as many harmonics.

    Includes few harmonics, which do not show the decay, and sliders in parallel, whose harmonics
    beat: the next harmonic may be zero where later ones are not.
    """
    rng = np.random.default_rng(2)
    phase = np.linspace(0, 2 * np.pi, 999)
    ratios = []
    for i in range(24):
        system = kinked_system(rng, i)
        few = int(rng.choice([5, 7, 15, 31]))
        nu, load = rng.uniform(0.3, 2.5), [rng.uniform(0.2, 2), 0][: len(system.mass)]
        a, b = (
            vv.forced_response(system, nu, load=load, harmonics=k, method="newton")
            for k in (few, 3 * few + 40)
        )
        if not (a.converged[0] and b.converged[0]):
            continue
        x, y = (
            (r.coefficients[0] @ np.exp(1j * np.outer(r.harmonics, phase))).imag for r in (a, b)
        )
        ratios.append(np.linalg.norm(x - y) / np.linalg.norm(y) / (a.truncation[0] + 1e-9))
    assert len(ratios) > 20
    assert max(ratios) < 1.1
    # Nor far smaller: an estimate of ten times the error is of no use.
    assert np.median(ratios) > 0.15


@pytest.mark.parametrize("highest", [31, 61, 101])
def test_estimates_of_steep_smooth_laws(highest):
    """Harmonics decay slowly, so those beyond the larger set count."""
    system = vv.PolynomialSystem(mass=1, damping=0.05, stiffness=1, forces="0.3*tanh(x_dot/0.05)")

    def run(harmonics):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", vv.ConvergenceWarning)
            return vv.forced_response(system, [1.1], load=0.5, harmonics=harmonics, method="newton")

    short, long = run(highest), run(199)
    kept, true = short.coefficients[0].ravel(), long.coefficients[0].ravel()
    change = true.copy()
    change[: kept.size] -= kept
    error = np.linalg.norm(change) / np.linalg.norm(true)
    # Regression: a fifth of the error, if only the next harmonics are counted.
    assert 0.8 * error < short.truncation[0] < 4 * error


LAWS = (
    "A*sign(x_dot)", "A*tanh(x_dot/0.2)", "A*max(x_dot - 0.1, 0)", "A*x_dot*abs(x_dot)",
    "A*x_dot^3", "A*abs(x_dot)*x^2", "A*max(x - 0.1, 0)", "A*x*abs(x)", "A*sin(2*x)",
    "A*min(max(x, -0.1), 0.1)",
)  # fmt: skip


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
def test_successive_approximations_tell_what_orders_and_samples_leave():
    """Forces with rates, jumps and kinks: against Newton's method with many more harmonics."""
    rng = np.random.default_rng(12)
    ratios = []
    for k in range(20):
        law = LAWS[k % len(LAWS)].replace("A", f"{10 ** rng.uniform(-2, -0.5):.3g}")
        memory = vv.PronyKernel(weights=[0.1], rates=[0.7]) if k % 3 == 0 else None
        system = vv.PolynomialSystem(
            mass=1, stiffness=1, damping=rng.uniform(0.1, 0.4), forces=law, kernel=memory
        )
        given = {"nu": rng.uniform(0.3, 2.5), "load": rng.uniform(0.2, 1)}
        found = vv.forced_response(system, **given, harmonics=(3, 9, 15, "auto")[k % 4])
        if not found.converged[0]:
            continue
        exact = vv.forced_response(system, **given, harmonics=151, method="newton")
        lacking = exact.coefficients[0, 0].copy()
        kept = np.searchsorted(exact.harmonics, found.harmonics[found.harmonics <= 151])
        lacking[kept] -= found.coefficients[0, 0, : kept.size]
        true = size([1], lacking) / size([1], exact.coefficients[0])
        if true > 3 * exact.truncation[0] + 1e-11:
            ratios.append(true / (found.truncation[0] + 1e-10))
    assert len(ratios) > 7
    assert max(ratios) < 3


def test_errors_are_reported_of_the_motion_that_a_base_leaves_at_rest_nearly():
    """Far above resonance a body hardly moves, while its springs follow the base."""
    rng = np.random.default_rng(11)
    for _ in range(8):
        c, swing = rng.uniform(0.3, 1), rng.uniform(0.4, 0.8)
        system = vv.PolynomialSystem(
            mass=1, stiffness=1, damping=0.02, forces=f"{c}*x^3 + {c / 5}*x^2", base_direction=[1]
        )
        nu = rng.uniform(10, 30)
        true = vv.forced_response(
            system, [nu], base=swing, method="newton", harmonics=25, tolerance=1e-12
        )
        found = [
            vv.forced_response(system, [nu], base=swing, method=method, tolerance=1e-9)
            for method in ("successive", "newton")
        ]
        found.append(vv.trace_response(system, (nu, 1.01 * nu), base=swing, tolerance=1e-9))
        largest = abs(true.coefficients).max()
        assert largest < 0.1 * swing
        for run in found:
            assert run.truncation[0] < 1e-9
            kept = dict(zip(run.harmonics, run.coefficients[0, 0], strict=True))
            for k, x in zip(true.harmonics, true.coefficients[0, 0], strict=True):
                assert abs(x - kept.get(k, 0)) < 2e-9 * largest
