"""Multipliers along a branch of a body with memory, against SciPy with the full equations."""

import numpy as np
import viscovib as vv
from referee.integration import solve_ivp
from test_body import engine
from viscovib.units import hz

KERNEL = vv.PronyKernel(weights=[2.0], rates=[60.0])
CUBE = 1e10


def of_scipy(body, nu, x, orders, kernel=KERNEL, cube=CUBE):
    """Multipliers of M u'' = -sum_j c_j (f_j' d_j - z_j), z_j' = w f_j' d_j - r z_j, d = c u."""
    springs = body._mount_springs
    rows, n = np.asarray(springs.rows), springs.rows.shape[0]
    bent = np.arange(n) % 3 == 2
    inverse = np.linalg.inv(np.asarray(body.mass))
    weight, rate = kernel.weights[0], kernel.rates[0]
    size = 12 + n

    def slope(t, y):
        y = y.reshape(size, size)
        deflection = rows @ (x @ np.exp(1j * orders * nu * t)).imag
        stiffness = springs.stiffness + bent * 3 * cube * deflection**2
        force = stiffness[:, None] * (rows @ y[:6])
        push = -inverse @ (rows.T @ (force - y[12:]))
        return np.vstack([y[6:12], push, weight * force - rate * y[12:]]).ravel()

    run = solve_ivp(slope, (0, 2 * np.pi / nu), np.eye(size).ravel(), method="DOP853",
                    rtol=1e-10, atol=1e-10)  # fmt: skip
    values = np.linalg.eigvals(run.y[:, -1].reshape(size, size))
    return values[np.argsort(-np.abs(values))]


def test_multipliers_along_a_branch():
    """Each computation starts from the previous multipliers: all agree with the full equations."""
    body = engine(KERNEL, "1e10*d^3")
    branch = vv.trace_response(
        body, (20 * hz, 29 * hz), load=body.load(torque=(0, 500, 0)).real, harmonics=9,
        tolerance=1e-4, stability=True,
    )  # fmt: skip
    assert branch.nu.size > 30
    assert 0 < np.sum(branch.stable == True) < branch.nu.size  # noqa: E712
    changes = np.flatnonzero(branch.stable[1:] != branch.stable[:-1])
    for i in {int(changes[0]), int(changes[0]) + 1, branch.nu.size // 3, branch.nu.size - 2}:
        expected = of_scipy(body, branch.nu[i], branch.coefficients[i], branch.harmonics)
        reported = branch.multipliers[i][np.isfinite(branch.multipliers[i])]
        assert branch.stable[i] == (np.abs(expected[0]) < 1)
        assert reported.size >= 8
        for value in reported:
            assert np.abs(expected - value).min() < 1e-6 * max(1, np.abs(value))
        # The largest multiplier is in the list.
        assert np.abs(reported - expected[0]).min() < 1e-6 * np.abs(expected[0])


def test_multipliers_where_modes_want_their_rows_exchanged():
    """A soft mode coupled to stiff modes: its pivot is small near some harmonics.

    About 4 of 23 determinants per motion are computed by deflections instead of modes.
    """
    kernel = vv.PronyKernel(weights=[0.4], rates=[60.0])
    places = [(-0.07, 0.46, 0.16), (0, -0.46, 0.1), (0.25, -0.04, -0.2)]
    mounts = [
        vv.MountPoint(
            name=f"m{i}", position=place, stiffness=(1e5, 1e5, 4e6), kernel=kernel,
            angles=(0.12 * (i - 1), 0.12 * (1 + 0.2 * i), 0.3 * i), law=(None, None, "1e11*d^3"),
        )
        for i, place in enumerate(places)
    ]  # fmt: skip
    inertia = [[9.91, -0.813, -0.472], [-0.813, 4.12, 1.34], [-0.472, 1.34, 9.09]]
    body = vv.Body(mass=160, inertia=inertia, mounts=mounts)
    nus = np.array([30.0, 45.0, 60.0, 100.0, 130.0])
    load = body.load(torque=(300, 300, 60), force=(150, 0, 300)).real
    found = vv.forced_response(
        body, nus, load=load, method="newton", harmonics=9, tolerance=1e-2, stability=True
    )
    for i, nu in enumerate(nus):
        expected = of_scipy(body, nu, found.coefficients[i], found.harmonics, kernel, 1e11)
        reported = found.multipliers[i][np.isfinite(found.multipliers[i])]
        assert found.stable[i] == (np.abs(expected[0]) < 1)
        assert reported.size == 12
        for value in reported:
            assert np.abs(expected - value).min() < 1e-7
        assert np.abs(reported - expected[0]).min() < 1e-7
