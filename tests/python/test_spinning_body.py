"""Bodies with parts that spin inside, against exact whirl speeds, NumPy and SciPy."""

import numpy as np
import pytest
import viscovib as vv
from scipy.integrate import solve_ivp

MASS, INERTIA, SPIN, ARM, K = 40.0, np.array([1.0, 1.2, 1.5]), np.array([4.0, -7.0, 60.0]), 0.3, 2e4


def some_body(inertia=INERTIA, spin=SPIN, k=(K, K, K), **options):
    """Return a body on four feet in the plane of its centre."""
    places = [(ARM, 0), (-ARM, 0), (0, ARM), (0, -ARM)]
    feet = [
        vv.MountPoint(name=f"foot{i}", position=(x, y, 0.05), stiffness=k, damping=(3, 4, 5))
        for i, (x, y) in enumerate(places)
    ]
    return vv.Body(mass=MASS, inertia=inertia, mounts=feet, spin=spin, **options)


def matrices(k=K):
    """Return mass, damping and stiffness of the same, put together by hand."""
    stiff, damp, mass = np.zeros((6, 6)), np.zeros((6, 6)), np.diag([MASS] * 3 + list(INERTIA))
    for x, y in [(ARM, 0), (-ARM, 0), (0, ARM), (0, -ARM)]:
        for axis, c in zip(np.eye(3), (3, 4, 5), strict=True):
            row = np.r_[axis, np.cross((x, y, 0.05), axis)]
            stiff += k * np.outer(row, row)
            damp += c * np.outer(row, row)
    for b in range(3):
        damp[3:, 3 + b] -= np.cross(SPIN, np.eye(3)[b])
    return mass, damp, stiff


def test_whirl_speeds_of_a_flywheel():
    """Forward and backward: J w^2 -+ h w - k = 0."""
    feet = [
        vv.MountPoint(name=f"foot{i}", position=(x, y, 0), stiffness=(K, K, K))
        for i, (x, y) in enumerate([(ARM, 0), (-ARM, 0), (0, ARM), (0, -ARM)])
    ]
    body = vv.Body(mass=MASS, inertia=(1, 1, 1.5), mounts=feet, spin=(0, 0, 60))
    found = np.sort(body.characteristic_roots().oscillatory.imag)
    whirl = [(np.sqrt(60**2 + 8 * K * ARM**2) + sign * 60) / 2 for sign in (-1, 1)]
    np.testing.assert_allclose(found[[0, -1]], whirl, rtol=1e-12)


def test_response_to_an_unbalance():
    mass, damp, stiff = matrices()
    body = some_body()
    nu = np.array([20.0, 40.0, 90.0])
    for w in nu:
        load = body.unbalance(w, 0.01, at=(0, 0, 0.1), axis="z")
        found = vv.forced_response(body, [w], load=load, method="linear").coefficients[0, :, 0]
        right = np.linalg.solve(stiff - w * w * mass + 1j * w * damp, load)
        np.testing.assert_allclose(found, right, rtol=1e-10, atol=1e-14)


def test_motion_in_time_with_memory():
    """Springs that remember by one exponential, as ordinary equations."""
    mass, damp, stiff = matrices()
    body = some_body()
    weight, rate = 2.0, 5.0
    feet = [
        vv.MountPoint(
            name=m.name, position=m.position, stiffness=m.stiffness, damping=(3, 4, 5),
            kernel=vv.PronyKernel(weights=[weight], rates=[rate]),
        )
        for m in body.mounts
    ]  # fmt: skip
    body = vv.Body(mass=MASS, inertia=INERTIA, mounts=feet, spin=SPIN)
    start = np.zeros(12)
    start[7::2] = 0.1, -0.2, 0.3
    run = vv.simulate(body, 0.5, initial=start, tolerance=1e-10)

    def slope(t, y):
        u, v, past = y[:6], y[6:12], y[12:]
        pull = damp @ v + stiff @ (u - weight * past)
        return np.r_[v, np.linalg.solve(mass, -pull), u - rate * past]

    right = solve_ivp(
        slope, (0, 0.5), np.r_[start[::2], start[1::2], np.zeros(6)], "DOP853", t_eval=run.t,
        rtol=1e-12, atol=1e-14,
    ).y[:12].T  # fmt: skip
    assert np.abs(run.state[:, ::2] - right[:, :6]).max() < 1e-10
    assert np.abs(run.state[:, 1::2] - right[:, 6:]).max() < 1e-8


def test_angular_momentum_is_kept_without_torque():
    """Of a body that one spring at its centre holds, with that of the parts that spin."""
    foot = vv.MountPoint(name="foot", position=(0, 0, 0), stiffness=(K, K, K))
    body = vv.Body(mass=MASS, inertia=INERTIA, mounts=[foot], spin=SPIN)
    start = np.zeros(12)
    start[7::2] = 1e-3, -2e-3, 3e-3
    run = vv.simulate(body, 1.0, initial=start, tolerance=1e-12)
    momentum = body.angular_momentum(run.state)
    assert np.ptp(momentum, axis=0).max() < 1e-12 * np.abs(SPIN).max()
    assert np.abs(np.diff(run.state[:, 7::2], axis=0)).max() > 1e-4


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: some_body(spin=(1, 2)), "spin"),
        (lambda: some_body(geometry="exact"), "spin: must be 0 with geometry = 'exact'"),
        (lambda: some_body(base_direction="rx"), "on a floor that turns"),
        (lambda: some_body().modes(), r"characteristic_roots\(\) gives them"),
        (
            lambda: vv.backbone(some_body(), 0, amplitude_range=(1e-4, 1e-3)),
            "a backbone leaves out",
        ),
        (lambda: some_body().scatter(3), r"characteristic_roots\(\) gives them"),
    ],
)
def test_what_is_refused(call, message):
    with pytest.raises(vv.InputError, match=message):
        call()
