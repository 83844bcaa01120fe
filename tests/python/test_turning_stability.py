"""Stability of bodies with large rotations: monodromy by SciPy in body rates."""

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp
from scipy.spatial.transform import Rotation

INERTIA, TURNING = np.array([0.3, 0.5, 0.6]), np.array([1.0, 1.3, 0.8])
STIFFNESS, PLACE = np.array([30.0, 40.0, 50.0]), np.array([0.2, 0.1, 0.15])


def unspun(theta):
    """Return J of theta' = J w, w the body rates, by the closed form of the rotation vector.

    For vectors of shape (3, m) the result has the shape (m, 3, 3).
    """
    x, y, z = theta
    zero = np.zeros_like(x)
    s = np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), -1, 0)
    a = np.maximum(np.linalg.norm(theta, axis=0), 1e-5)
    share = np.where(a > 1e-5, 1 / a**2 - (1 + np.cos(a)) / (2 * a * np.sin(a)), 1 / 12)
    return np.eye(3) + s / 2 + share[:, np.newaxis, np.newaxis] * s @ s


def times(matrices, vectors):
    """Multiply matrices of shape (m, 3, 3) by vectors of shape (3, m)."""
    return np.einsum("mij,jm->im", matrices, vectors)


def cross(a, b):
    """Vector products of the columns."""
    return np.cross(a, b, axis=0)


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

    place, stiffness, inertia, turning = (
        v.reshape(3, 1) for v in (PLACE, STIFFNESS, INERTIA, TURNING)
    )

    def rates(t, flat):
        y = flat.reshape(12, -1)
        moved, speed, theta, w = y[:3], y[3:6], y[6:9], y[9:]
        turn, back = Rotation.from_rotvec(theta.T).as_matrix(), unspun(theta)
        turned_back = turn.transpose(0, 2, 1)
        pull = -stiffness * (moved + (turn @ PLACE).T - place)
        pull -= damping * (speed + times(turn, cross(w, place)))
        moment = cross(place, times(turned_back, pull))
        moment -= times(back.transpose(0, 2, 1), turning * theta)
        moment += (turned_back @ torque).T * np.sin(nu * t)
        moment -= cross(w, inertia * w + np.reshape(spin, (3, 1)))
        return np.concatenate([speed, pull, times(back, w), moment / inertia]).ravel()

    def after(y):
        """States of shape (12, m) after a period, all with the same steps."""
        options = {"method": "DOP853", "rtol": 1e-8, "atol": 1e-10}
        return solve_ivp(rates, (0, 2 * np.pi / nu), y.ravel(), **options).y[:, -1].reshape(12, -1)

    k, x = found.harmonics, found.coefficients[0]
    u, v = x.sum(axis=1).imag, (1j * k * nu * x).sum(axis=1).imag
    body_rates = np.linalg.solve(unspun(u[3:, np.newaxis])[0], v[3:])
    start = np.concatenate([u[:3], v[:3], u[3:], body_rates])[:, np.newaxis]
    np.testing.assert_allclose(after(start), start, atol=1e-6)
    _, motion = found.waveform(0, 64)
    assert np.linalg.norm(motion[:, 3:], axis=1).max() > least
    step = 1e-4
    ends = after(start + step * np.hstack([np.eye(12), -np.eye(12)]))
    largest = np.abs(np.linalg.eigvals((ends[:, :12] - ends[:, 12:]) / (2 * step))).max()
    assert (largest < 1) == stable
    # Differences are accurate to 1e-4, as the last line asserts: sufficient for the verdict.
    assert abs(largest - 1) > 5e-3
    assert found.stable[0] == stable
    assert np.nanmax(np.abs(found.multipliers[0])) == pytest.approx(largest, abs=1e-4)
