"""Stability of bodies that turn far: monodromy by SciPy of equations in body rates."""

import numpy as np
import pytest
import viscovib as vv
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

INERTIA, TURNING = np.array([0.3, 0.5, 0.6]), np.array([1.0, 1.3, 0.8])
STIFFNESS, PLACE = np.array([30.0, 40.0, 50.0]), np.array([0.2, 0.1, 0.15])


def unspun(theta):
    """Return J of theta' = J w, w the body rates, by the closed form of the rotation vector."""
    x, y, z = theta
    a, s = np.linalg.norm(theta), np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    share = 1 / 12 if a < 1e-5 else 1 / a**2 - (1 + np.cos(a)) / (2 * a * np.sin(a))
    return np.eye(3) + s / 2 + share * s @ s


@pytest.mark.parametrize(
    ("damping", "spin", "least", "stable"),
    [
        (0.05, (0, 0, 0), 1.5, False),
        (1.5, (0, 0, 0), 0.5, True),
        (0.2, (0.1, 0.2, -0.3), 2.0, False),
        (0.4, (0.1, 0.2, -0.3), 2.0, True),
    ],
)
def test_verdict_is_that_of_the_monodromy(damping, spin, least, stable):
    foot = vv.MountPoint(
        name="m", position=PLACE, stiffness=STIFFNESS, damping=damping,
        rotational_stiffness=TURNING,
    )  # fmt: skip
    body = vv.Body(
        mass=1, inertia=INERTIA, mounts=[foot], geometry="exact", load_axes="space",
        spin=spin,
    )  # fmt: skip
    nu, torque = 1.6, np.array([0.06, 0.6, 0.12])
    found = vv.forced_response(
        body, [nu], load=[0, 0, 0, *torque], method="newton", harmonics=21, tolerance=1e-8,
        stability=True,
    )  # fmt: skip

    def rates(t, y):
        place, speed, theta, w = y[:3], y[3:6], y[6:9], y[9:]
        turn, back = Rotation.from_rotvec(theta).as_matrix(), unspun(theta)
        pull = -STIFFNESS * (place + turn @ PLACE - PLACE)
        pull -= damping * (speed + turn @ np.cross(w, PLACE))
        moment = np.cross(PLACE, turn.T @ pull) - back.T @ (TURNING * theta)
        moment += turn.T @ torque * np.sin(nu * t) - np.cross(w, INERTIA * w + spin)
        return np.concatenate([speed, pull, back @ w, moment / INERTIA])

    def after(y):
        options = {"method": "DOP853", "rtol": 1e-8, "atol": 1e-10}
        return solve_ivp(rates, (0, 2 * np.pi / nu), y, **options).y[:, -1]

    k, x = found.harmonics, found.coefficients[0]
    u, v = x.sum(axis=1).imag, (1j * k * nu * x).sum(axis=1).imag
    start = np.concatenate([u[:3], v[:3], u[3:], np.linalg.solve(unspun(u[3:]), v[3:])])
    np.testing.assert_allclose(after(start), start, atol=1e-6)
    _, motion = found.waveform(0, 64)
    assert np.linalg.norm(motion[:, 3:], axis=1).max() > least
    step = 1e-4
    columns = [(after(start + step * e) - after(start - step * e)) / (2 * step) for e in np.eye(12)]
    largest = np.abs(np.linalg.eigvals(np.array(columns).T)).max()
    assert (largest < 1) == stable
    # Differences know it to 1e-4, as the last line asserts: the verdict is far from that.
    assert abs(largest - 1) > 5e-3
    assert found.stable[0] == stable
    assert np.nanmax(np.abs(found.multipliers[0])) == pytest.approx(largest, abs=1e-4)
