"""Stated errors of Lyapunov exponents, relative to infinite time."""

import numpy as np
import viscovib as vv


def test_exponents_of_linear_systems():
    """Real parts of eigenvalues, for run times from 10 to 300."""
    above, judged = 0, 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(1, 4))
        a, b = rng.normal(size=(2, n, n))
        stiffness = a @ a.T + 0.3 * np.eye(n)
        damping = 0.3 * rng.random() * (b @ b.T / n + 0.1 * np.eye(n))
        flow = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -damping]])
        exact = np.sort(np.linalg.eigvals(flow).real)[::-1]
        t_end = 10 ** rng.uniform(1, 2.5)
        many = vv.simulate_ensemble(
            vv.PolynomialSystem(mass=np.eye(n), stiffness=stiffness, damping=damping),
            initial=1e-3 * rng.normal(size=(1, 2 * n)), t_end=t_end, lyapunov="all",
            discard=t_end / 4 if seed % 2 else 0.0,
        )  # fmt: skip
        off = np.abs(many.spectrum[0] - exact) / many.spectrum_error[0]
        assert off.max() < 2, seed
        assert many.lyapunov_error[0] == many.spectrum_error[0, 0]
        above += int((off > 1).sum())
        judged += off.size
    assert above <= 0.05 * judged


def test_exponents_of_chaos():
    """96 short runs against the mean of long runs; the errors are a few times the scatter."""
    duffing = vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.25, forces="x^3")
    rng = np.random.default_rng(0)
    long, short = (
        vv.simulate_ensemble(
            duffing, initial=rng.normal(size=(n, 2)), t_end=t_end, load=0.3, nu=1.0, dt=0.1,
            lyapunov=True, discard=100.0,
        )
        for n, t_end in ((16, 4000.0), (96, 300.0))
    )  # fmt: skip
    off = short.lyapunov - long.lyapunov.mean()
    assert (np.abs(off) > short.lyapunov_error).sum() <= 7
    assert np.median(short.lyapunov_error) < 4 * off.std()
    assert long.lyapunov_error.mean() < 0.5 * short.lyapunov_error.mean()
