"""Responses of polynomial systems against shooting by SciPy, closed forms and the mount."""

import dataclasses

import numpy as np
import pytest
import viscovib as vv
from polynomial_examples import chain, state_at_zero
from referee.integration import solve_ivp
from scipy.optimize import brentq


@pytest.mark.parametrize(("quadratic", "cubic"), [(0.0, 0.3), (0.0, -0.3), (0.5, 0.0), (0.4, 0.7)])
def test_backbone_of_small_amplitudes(quadratic, cubic):
    """Peak at omega_0 + (3 cubic/8 - 5 quadratic^2/12) a^2: Nayfeh and Mook (1979), section 2.3."""
    system = vv.PolynomialSystem(
        mass=1, stiffness=1, damping=1e-4, forces=f"{quadratic}*x^2 + {cubic}*x^3"
    )
    slopes = []
    for load in (2e-6, 4e-6):
        peak = vv.trace_response(
            system, (0.99, 1.01), load=load, max_step=0.01, stability=False
        ).peak("x")
        slopes.append((peak.nu - 1) / peak.amplitude**2)
    expected = 3 * cubic / 8 - 5 * quadratic**2 / 12
    assert slopes[1] == pytest.approx(expected, rel=0.02)


def test_memory_of_the_mean():
    """At rest under a constant load a kernel reduces every force by the factor 1 - its integral."""
    kernel = vv.RzhanitsynKernel(amplitude=0.2, alpha=0.5, beta=0.7)
    system = vv.PolynomialSystem(
        mass=1, kernel=kernel, forces="x + 0.3*x^2 + 0.5*x^3", springs=[vv.Springs(stiffness=0.4)]
    )
    kept = 1 - 0.2 * np.sqrt(np.pi / 0.7)
    assert kernel.integral == pytest.approx(1 - kept, rel=1e-14)
    expected = brentq(
        lambda x: kept * (x + 0.3 * x**2 + 0.5 * x**3) + 0.4 * x - 0.8, 0, 5, xtol=1e-15
    )
    for method in ("newton", "successive"):
        r = vv.forced_response(
            system, 0.9, load={0: 0.8j}, method=method, relaxation=0.5, tolerance=1e-13
        )
        assert r.coefficient("x", 0)[0] == pytest.approx(1j * expected, rel=1e-12)
        assert np.abs(r.coefficients[0, 0, 1:]).max() < 1e-13


def test_twenty_masses():
    system, nu = chain(20), 0.31
    r = vv.forced_response(system, nu, load=0.3, method="newton", harmonics=31, tolerance=1e-12)
    start, stiffness = state_at_zero(r), np.asarray(system.stiffness)

    def motion(t, y):
        u, v = y[:20], y[20:]
        stretch = np.diff(np.concatenate([[0], u, [0]]))
        force = -np.diff(0.2 * stretch**3) + stiffness @ (u + 0.05 * v)
        force[0] -= 0.3 * np.sin(nu * t)
        return np.concatenate([v, -force])

    after = solve_ivp(motion, (0, 2 * np.pi / nu), start, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    assert after == pytest.approx(start, abs=1e-8)
    assert np.abs(start).max() > 0.1


def test_harmonics_are_as_many_as_needed():
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.2, forces="0.5*x^2 + 0.5*x^3")
    r = vv.forced_response(system, [0.8, 1.0], load=0.5, method="newton", harmonics="auto")
    assert r.truncation.max() <= 1e-10
    assert 9 < r.harmonics[-1] < 60
    # A coordinate at rest, and many of them.
    idle = vv.PolynomialSystem(
        mass=[1, 1], stiffness=[1, 2], damping=[0.2, 0.2], forces={"x1": "x1^3", "x2": "x2^3"}
    )
    assert vv.forced_response(
        idle, 1.0, load=0.5, method="newton", harmonics="auto"
    ).harmonics[-1] < 60  # fmt: skip
    r = vv.forced_response(chain(20), 0.5, load=0.5, method="newton", harmonics="auto")
    assert r.truncation.max() <= 1e-10


def residual(system, load, nu, orders, x, oversampling):
    """Harmonics of M u'' + C u' + sum_g (1 - R_g*) [K_g u + f_g] - load, by numpy.fft."""
    n = x.shape[0]
    samples = oversampling * (int(orders.max()) + 1)
    u = (np.exp(2j * np.pi * np.outer(np.arange(samples) / samples, orders)) @ x.T).imag
    mass, damping = np.asarray(system.mass), np.asarray(system.damping)
    total = (1j * orders * nu) ** 2 * (mass @ x) + 1j * orders * nu * (damping @ x)
    size = np.abs(total).max()
    for group in system.groups:
        force = u @ group.stiffness.T
        for (on, powers), c in group.forces.items():
            force[:, on] += c * np.prod(u ** np.array(powers), axis=1)
        spectrum = 2j * np.fft.fft(force, axis=0)[orders].T / samples
        spectrum[:, orders == 0] = 0.5j * spectrum[:, orders == 0].imag
        kept = 1 if group.kernel is None else 1 - group.kernel.transform(orders * nu)
        total = total + kept * spectrum
        size = max(size, np.abs(spectrum).max())
    for j, k in enumerate(orders):
        total[:, j] -= load.get(int(k), np.zeros(n))
    return np.abs(total).max() / size


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.parametrize("seed", range(8))
def test_solutions_of_random_systems_satisfy_their_equations(seed):
    rng = np.random.default_rng(seed)
    n, degree = int(rng.integers(1, 5)), int(rng.choice([3, 5, 8]))
    kernels = [
        None,
        vv.PronyKernel(weights=[0.4 * rng.random()], rates=[0.5 + rng.random()]),
        vv.RzhanitsynKernel(amplitude=0.1 * rng.random(), alpha=0.3, beta=0.2),
    ]

    def springs():
        root = rng.normal(size=(n, n))
        monomials = []
        for _ in range(int(rng.integers(1, 5))):
            factors = rng.integers(n, size=int(rng.integers(2, degree + 1)))
            powers = np.bincount(factors, minlength=n).tolist()
            c = float(rng.normal() * 10 ** rng.uniform(-2, 1))
            monomials.append(vv.Monomial(coefficient=c, powers=powers, on=int(rng.integers(n))))
        kernel = kernels[int(rng.integers(3))]
        return vv.Springs(stiffness=root @ root.T + np.eye(n), forces=monomials, kernel=kernel)

    root = rng.normal(size=(n, n))
    system = vv.PolynomialSystem(
        mass=root @ root.T + 0.3 * np.eye(n),
        damping=0.1 * np.ones(n),
        springs=[springs(), springs()],
    )
    load = {1: 0.1 * rng.normal(size=n) + 0j, 2: 0.05j * rng.normal(size=n)}
    if seed % 2:
        load[0] = 0.1j * rng.normal(size=n)
    found = 0
    for method in ("newton", "successive"):
        r = vv.forced_response(
            system, np.geomspace(0.3, 3, 6), load=load, method=method, harmonics=9, tolerance=1e-12
        )
        for i in np.flatnonzero(r.converged):
            x = r.coefficients[i]
            assert residual(system, load, r.nu[i], r.harmonics, x, 2 * degree + 2) < 1e-10
            found += 1
    assert found >= 6


@pytest.mark.parametrize("forces", ["tanh(2*x)", "2*x + x^3"])
def test_stiffness_as_given(forces):
    """The printed forces define the same system: forces keep their linear parts."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces=forces)
    assert system.stiffness == [[1.0]]
    again = eval(repr(system), {"PolynomialSystem": vv.PolynomialSystem, "array": np.array})
    for one in (system, again, dataclasses.replace(system, mass=1.0)):
        assert one.natural_frequencies() == pytest.approx([np.sqrt(3)], rel=1e-15)
