"""Starts of branches with a singular or stiff linear part, or a large load."""

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

pytestmark = pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")


def _ends(rng):
    nu = float(rng.uniform(0.3, 2.5))
    return (nu, 1.3 * nu) if rng.random() < 0.5 else (1.3 * nu, nu)


@pytest.mark.parametrize("seed", range(6))
def test_high_loads_and_no_stiffness(seed):
    rng = np.random.default_rng(seed)
    stiff = [0.0, 1.0][seed % 2]
    c, k3, size = rng.uniform(0.02, 0.2), rng.uniform(0.2, 1), 10 ** rng.uniform(-1, 3.4)
    system = vv.PolynomialSystem(mass=1, stiffness=stiff, damping=c, forces=f"{k3!r}*x^3")
    branch = vv.trace_response(system, _ends(rng), load=size, max_points=3, stability=False)
    nu, period = branch.nu[0], 2 * np.pi / branch.nu[0]
    waves = branch.coefficients[0, 0]
    start = [waves.imag.sum(), (1j * branch.harmonics * nu * waves).imag.sum()]
    run = solve_ivp(
        lambda t, y: [y[1], size * np.sin(nu * t) - c * y[1] - stiff * y[0] - k3 * y[0] ** 3],
        (0, period), start, method="DOP853", rtol=1e-12, atol=1e-12,
    )  # fmt: skip
    # Errors of the start grow by the largest multiplier at most.
    admitted = 1e-6 + 1e3 * branch.truncation[0]
    assert np.abs(run.y[:, -1] - start).max() < admitted * np.abs(run.y).max()


@pytest.mark.parametrize("seed", range(4))
def test_couplings_far_stiffer_than_the_rest(seed):
    rng = np.random.default_rng(100 + seed)
    g, masses, c = 10 ** rng.uniform(6, 10), rng.uniform(0.6, 2, 2), rng.uniform(0.03, 0.2)
    k3, size = rng.uniform(0.2, 1, 2), 0.5
    terms = [
        vv.Monomial(coefficient=k3[0], powers=(3, 0), on=0),
        vv.Monomial(coefficient=k3[1], powers=(0, 3), on=1),
    ]
    pair = vv.PolynomialSystem(
        mass=masses, damping=np.eye(2) * c, stiffness=[[1 + g, -g], [-g, 1 + g]],
        forces=terms,
    )  # fmt: skip
    one = vv.PolynomialSystem(
        mass=masses.sum(), damping=2 * c, stiffness=2, forces=f"{float(k3.sum())!r}*x^3"
    )
    ends = _ends(rng)
    same = dict(max_points=2, stability=False)
    stiff = vv.trace_response(pair, ends, load={1: [size, 0]}, **same)
    rigid = vv.trace_response(one, ends, load=size, **same)
    got, true = stiff.coefficients[0, :, :3], rigid.coefficients[0, 0, :3]
    # The error of a stiff coupling is of order 1/g, the rounding error of 1 + g up to g ulp.
    off = np.abs(got - true).max() / np.abs(true).max()
    if off < 0.1:  # else a different motion
        assert off < 30 / g + 100 * g * np.finfo(float).eps
    assert stiff.error[0] < 1e-4


@pytest.mark.parametrize("load", [1.1281341423069074e101, 1.7e308])
def test_what_is_no_number_is_reported(load):
    system = vv.PolynomialSystem(
        mass=0.03, stiffness=672.8, damping=0.01, forces="2.6577956703699335e-26*x^3"
    )
    try:
        branch = vv.trace_response(system, (153.67, 307.3), load=load, max_points=15)
    except vv.InputError:
        return
    assert np.isfinite(branch.coefficients).all()
    assert np.isfinite(branch.truncation).all()


def raised(dynamic, springs, load):
    """Motion with one harmonic at the full load: continuation in the load from rest to p = 1.

    D X + 3/4 springs |X|^2 X = p load, in short steps along (Re X, Im X, p).
    """
    n = load.size

    def equations(z):
        x, p = z[:n] + 1j * z[n:-1], z[-1]
        r = dynamic @ x + 0.75 * springs * abs(x) ** 2 * x - p * load
        a, b = dynamic + np.diag(1.5 * springs * abs(x) ** 2), np.diag(0.75 * springs * x**2)
        by_re, by_im = a + b, 1j * (a - b)
        matrix = np.block([[by_re.real, by_im.real], [by_re.imag, by_im.imag]])
        return np.r_[r.real, r.imag], np.c_[matrix, -np.r_[load, 0 * load]]

    z, tangent = np.zeros(2 * n + 1), np.eye(2 * n + 1)[-1]
    for _ in range(20000):
        tangent = np.linalg.solve(
            np.r_[equations(z)[1], [tangent]], np.eye(2 * n + 1)[-1]
        )  # fmt: skip
        tangent /= np.linalg.norm(tangent)
        before, z = z, z + 0.04 * tangent
        for _ in range(4):
            r, matrix = equations(z)
            z = z - np.linalg.solve(np.r_[matrix, [tangent]], np.r_[r, 0.0])
        if z[-1] >= 1:
            break
    z = before + (z - before) * (1 - before[-1]) / (z[-1] - before[-1])
    z[-1] = 1
    for _ in range(4):
        r, matrix = equations(z)
        z[:-1] -= np.linalg.solve(matrix[:, :-1], r)
    return z[:n] + 1j * z[n:-1]


def test_the_first_motion_is_on_the_curve_of_the_growing_load() -> None:
    """The reference follows the curve of the growing load independently."""
    several = 0
    for seed in range(8, 16):
        rng = np.random.default_rng(seed)
        springs = rng.uniform(-0.3, 1, 2)
        stiffness = np.array([[2.0, -1.0], [-1.0, 1.5]])
        damping, nu = rng.uniform(0.01, 0.05) * stiffness, rng.uniform(0.8, 2.5)
        load = np.array([10 ** rng.uniform(-1, 0.7), 0.0])
        exact = raised(stiffness - nu**2 * np.eye(2) + 1j * nu * damping, springs, load)
        system = vv.PolynomialSystem(
            mass=[1, 1], stiffness=stiffness, damping=damping,
            forces={name: f"{k}*{name}^3" for name, k in zip(("x1", "x2"), springs, strict=True)},
        )  # fmt: skip
        kept = {"load": load, "harmonics": 1, "stability": False}
        first = vv.forced_response(system, [nu], method="newton", **kept)
        assert first.coefficients[0, :, 0] == pytest.approx(exact, rel=1e-7), seed
        along = vv.trace_response(system, (nu, nu + 0.01), max_points=3, **kept)
        assert along.coefficients[0, :, 0] == pytest.approx(exact, rel=1e-7), seed
        several += abs(exact).max() > 1
    assert several > 2


def test_the_first_motion_of_mounts_follows_their_parameters() -> None:
    """A motion on the upper part of the curve in the load would be twice as large."""
    rubber = vv.RzhanitsynKernel(amplitude=0.03, alpha=0.1, beta=0.05)
    found = []
    for offset in np.linspace(0.495, 0.505, 21):
        mount = vv.Mount(
            mass=1, inertia=0.1, offset=offset, stiffness_x=10, stiffness_phi=2, kernel=rubber
        )
        first = vv.forced_response(mount, [1.9], load=0.5, method="newton")
        found.append(abs(first.coefficients[0, 1, 0]))
    assert np.ptp(np.diff(found)) < 1e-4
