"""Bodies with internal rotors, against exact whirl speeds, NumPy and SciPy."""

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp
from scipy.spatial.transform import Rotation

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
    """Return mass, damping and stiffness of the same body, assembled explicitly."""
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
    """Forward and backward whirl: J w^2 -+ h w - k = 0."""
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
    """Springs with one exponential of memory, as ordinary equations."""
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
    """For a body on one spring at its centre, including the rotors."""
    foot = vv.MountPoint(name="foot", position=(0, 0, 0), stiffness=(K, K, K))
    body = vv.Body(mass=MASS, inertia=INERTIA, mounts=[foot], spin=SPIN)
    start = np.zeros(12)
    start[7::2] = 1e-3, -2e-3, 3e-3
    run = vv.simulate(body, 1.0, initial=start, tolerance=1e-12)
    momentum = body.angular_momentum(run.state)
    assert np.ptp(momentum, axis=0).max() < 1e-12 * np.abs(SPIN).max()
    assert np.abs(np.diff(run.state[:, 7::2], axis=0)).max() > 1e-4


GRAVITY = np.array([5.0, -4.0, -9.0])


def turning(t_end, begin, pulls, gravity=(0, 0, 0), inertia=INERTIA):
    """R and x at the end by SciPy: Newton-Euler, R' = R [w], J w' + w x (J w + h) = m."""

    def rates(t, y):
        place, speed, turn, w = y[:3], y[3:6], y[6:15].reshape(3, 3), y[15:]
        push, moment = MASS * np.asarray(gravity), np.zeros(3)
        for p, k, c in pulls:
            arm = turn @ p
            pull = -k * (place + arm - p) - c * (speed + turn @ np.cross(w, p))
            push, moment = push + pull, moment + np.cross(arm, pull)
        own = turn.T @ moment - np.cross(w, inertia * w + SPIN)
        across = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        return np.concatenate([speed, push / MASS, (turn @ across).ravel(), own / inertia])

    y = solve_ivp(rates, (0, t_end), begin, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return y[6:15].reshape(3, 3), y[:3]


def test_a_rotor_about_a_loaded_position():
    """The weight rotates the body and its rotor; motions from there by Newton-Euler."""
    feet = [
        vv.MountPoint(name=name, position=p, stiffness=k, damping=c)
        for name, p, k, c in (
            ("a", (0.2, 0.1, -0.1), (3e3, 4e3, 2e3), (20, 30, 40)),
            ("b", (-0.3, 0.2, 0.1), (2e3, 3e3, 1e3), (30, 20, 10)),
            ("c", (0.1, -0.3, 0.0), (2e3, 2e3, 2e3), (10, 20, 30)),
        )
    ]
    body = vv.Body(
        mass=MASS, inertia=INERTIA, mounts=feet, geometry="exact", gravity=GRAVITY, spin=SPIN,
        load_axes="space",
    )  # fmt: skip
    at = body.sag().displacement
    loaded = Rotation.from_rotvec(at[3:])
    assert np.linalg.norm(at[3:]) > 0.08
    start = np.zeros(12)
    start[1::2] = 0.3, 0.1, -0.2, 2.0, -3.0, 1.5
    begin = np.concatenate(
        [at[:3], start[1:6:2], loaded.as_matrix().ravel(), loaded.inv().apply(start[7::2])]
    )
    pulls = [(np.asarray(m.position), m.stiffness, m.damping) for m in feet]
    turn, place = turning(1.0, begin, pulls, GRAVITY)
    end = vv.simulate(body, 1.0, initial=start, dt=0.005).state[-1]
    np.testing.assert_allclose(end[:6:2], place - at[:3], atol=1e-10)
    found = (Rotation.from_rotvec(end[6::2]) * loaded).as_matrix()
    np.testing.assert_allclose(found, turn, atol=1e-10)


def test_small_turns_with_a_rotor():
    """Exact and small geometry agree to first order: half the motion, half the relative error."""
    apart = []
    for size in (2e-3, 1e-3):
        start = np.zeros(12)
        start[1::2] = size * np.array([1, -2, 3, 20, -30, 10])
        ends = [
            vv.simulate(some_body(geometry=geometry), 0.5, initial=start, dt=0.002).state[-1]
            for geometry in ("small", "exact")
        ]
        apart.append(np.abs(ends[1] - ends[0]).max() / np.abs(ends[0]).max())
    assert apart[0] < 0.02
    assert apart[0] / apart[1] == pytest.approx(2, rel=0.05)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: some_body(spin=(1, 2)), "spin"),
        (lambda: some_body().modes(), r"characteristic_roots\(\) gives them"),
        (
            lambda: vv.backbone(some_body(), 0, amplitude_range=(1e-4, 1e-3)),
            "a backbone, which omits",
        ),
        (lambda: some_body().scatter(3), r"characteristic_roots\(\) gives them"),
    ],
)
def test_what_is_refused(call, message):
    with pytest.raises(vv.InputError, match=message):
        call()
