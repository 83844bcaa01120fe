"""Bodies on a floor that moves in six components, against absolute motions with moving feet."""

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp
from scipy.spatial.transform import Rotation

MASS, INERTIA = 40.0, np.array([1.0, 1.2, 1.5])
#: A threefold arrangement of feet, so that a weight along z causes no rotation.
PLACES = np.array([(0.3, 0.0, 0.05), (-0.15, 0.26, 0.05), (-0.15, -0.26, 0.05)])
K, C, CUBIC = np.array([2e4, 2e4, 5e4]), np.array([30.0, 30.0, 50.0]), 3e9
WEIGHT, RATE = 3.0, 20.0
FLOOR = np.array([2, 1j, 1 - 1j, 3j, -2, 1.5 + 2j]) * 1e-3


def some_body(*, places=PLACES, cubic=0.0, memory=False, **options):
    """A body on three feet, isotropic in the horizontal plane."""
    feet = [
        vv.MountPoint(
            name=f"foot{i}", position=p, stiffness=K, damping=C,
            law=(None, None, f"{cubic!r}*d^3") if cubic else None,
            kernel=vv.PronyKernel(weights=[WEIGHT], rates=[RATE]) if memory else None,
        )
        for i, p in enumerate(places)
    ]  # fmt: skip
    return vv.Body(mass=MASS, inertia=INERTIA, mounts=feet, **options)


ROWS = np.array([np.r_[e, np.cross(p, e)] for p in PLACES for e in np.eye(3)])
MASSES = np.diag([MASS] * 3 + list(INERTIA))


def feet_moved(floor, rate, cubic, start, t_end, memory):
    """Absolute coordinates at t_end by SciPy: springs between the body and the feet at ROWS y."""
    k, c = np.tile(K, 3), np.tile(C, 3)
    law = np.tile([0, 0, cubic], 3)

    def slope(t, y):
        u, v, past = y[:6], y[6:12], y[12:]
        d, d_rate = ROWS @ (u - floor(t)), ROWS @ (v - rate(t))
        force = k * d + law * d**3
        pull = force - (WEIGHT * past if memory else 0.0) + c * d_rate
        return np.r_[v, np.linalg.solve(MASSES, -ROWS.T @ pull), force - RATE * past]

    run = solve_ivp(slope, (0, t_end), start, "DOP853", rtol=1e-11, atol=1e-13)
    return run.y[:, -1]


def test_linear_response_is_that_of_moved_feet():
    """Weight and rotor fixed in space: (K + i w C)(u - y) - i w h x u - w^2 M u = tilted weight."""
    spin, gravity = np.array([2.0, -3.0, 20.0]), np.array([1.0, -2.0, -9.0])
    body = some_body(spin=spin)
    heavy = some_body(gravity=gravity)
    whirl = np.zeros((6, 6))
    whirl[3:, 3:] = np.cross(spin, np.eye(3)).T
    stiff, damp = ROWS.T * np.tile(K, 3) @ ROWS, ROWS.T * np.tile(C, 3) @ ROWS
    names = dict(zip(("x", "y", "z", "rx", "ry", "rz"), FLOOR.tolist(), strict=True))
    for nu in (15.0, 60.0):
        whole = stiff + 1j * nu * (damp - whirl) - nu**2 * MASSES
        right = np.linalg.solve(whole, (stiff + 1j * nu * damp) @ FLOOR)
        for base in (FLOOR, names, {1: FLOOR}):
            found = vv.forced_response(body, [nu], base=base, method="linear")
            np.testing.assert_allclose(found.coefficients[0, :, 0], right, rtol=1e-12)
        np.testing.assert_allclose(
            body.base_transmissibility([nu], FLOOR)[0], right[:3], rtol=1e-12
        )
        # In the frame of the tilting floor the weight changes by -phi x W.
        geometric = heavy._stiffness_at_rest - stiff
        whole = stiff + geometric + 1j * nu * damp - nu**2 * MASSES
        tilted = np.r_[-np.cross(FLOOR[3:], MASS * gravity), np.zeros(3)]
        right = FLOOR + np.linalg.solve(whole, nu**2 * MASSES @ FLOOR + tilted)
        found = vv.forced_response(heavy, [nu], base=FLOOR, method="linear")
        np.testing.assert_allclose(found.coefficients[0, :, 0], right, rtol=1e-12)


def test_small_motions_of_the_floor_are_those_of_a_floor_that_turns():
    """Newton-Euler with moving feet and axes, a weight and a rotor: second-order differences."""
    spin, pull = np.array([2.0, -3.0, 20.0]), np.array([0, 0, -9.81])
    body = some_body(gravity=9.81, spin=spin)
    sag = body.sag().displacement
    assert np.abs(np.delete(sag, 2)).max() < 1e-12
    nu, t_end, apart = 12.0, 0.6, []

    def end(size):
        def floor(t):
            wave = size * FLOOR * np.exp(1j * nu * t)
            return wave.imag, (1j * nu * wave).imag

        def rates(t, y):
            place, speed, turn, w = y[:3], y[3:6], y[6:15].reshape(3, 3), y[15:]
            (x, theta), (v, turning) = (np.split(part, 2) for part in floor(t))
            tilt = Rotation.from_rotvec(theta).as_matrix()
            h = 1e-6
            later = Rotation.from_rotvec(theta + h * turning).as_matrix()
            before = Rotation.from_rotvec(theta - h * turning).as_matrix()
            omega = (later - before) / (2 * h) @ tilt.T
            push, moment = MASS * pull, np.zeros(3)
            for p in PLACES:
                arm = turn @ p
                d = tilt.T @ (place + arm - x) - p + sag[:3]
                # The rate relative to the floor.
                seen = speed + turn @ np.cross(w, p) - v - omega @ (place + arm - x)
                force = -tilt @ (K * d + C * (tilt.T @ seen))
                push, moment = push + force, moment + np.cross(arm, force)
            own = turn.T @ moment - np.cross(w, INERTIA * w + spin)
            across = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
            return np.concatenate([speed, push / MASS, (turn @ across).ravel(), own / INERTIA])

        begin = np.concatenate([np.zeros(6), np.eye(3).ravel(), np.zeros(3)])
        y = solve_ivp(rates, (0, t_end), begin, "DOP853", rtol=1e-10, atol=1e-13).y[:, -1]
        return np.r_[y[:3], Rotation.from_matrix(y[6:15].reshape(3, 3)).as_rotvec()]

    for size in (2.0, 1.0):
        run = vv.simulate(
            body, t_end, initial=np.zeros(12), base=size * FLOOR, nu=nu, dt="auto", tolerance=1e-10
        )
        true = end(size)
        apart.append(np.abs(run.state[-1, ::2] - true).max() / np.abs(true).max())
    assert apart[0] < 0.03
    assert apart[0] / apart[1] == pytest.approx(2, rel=0.15)


@pytest.mark.parametrize("memory", [False, True])
def test_a_record_of_six_columns(memory):
    """In time, progressive, a separate record for each component: absolute motions by SciPy."""
    body = some_body(cubic=CUBIC, memory=memory)
    times = np.linspace(0, 0.5, 11)
    values = 3e-3 * np.random.default_rng(1).normal(size=(11, 6))
    values[[0, -1]] = 0
    record = vv.LoadTable(times=times, values=values, interpolation="cubic")
    run = vv.simulate(body, 0.5, base=record, initial=np.zeros(12), dt="auto", tolerance=1e-9)
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(times, values)
    slope = spline.derivative()
    end = feet_moved(spline, slope, CUBIC, np.zeros(21), 0.5, memory)
    assert np.abs(CUBIC / K[2] * values[:, 2] ** 2).max() > 0.3
    np.testing.assert_allclose(run.state[-1, ::2], end[:6], atol=2e-9)
    np.testing.assert_allclose(run.state[-1, 1::2], end[6:12], atol=2e-7)


def test_a_floor_that_stays_tilted():
    """Corners, and a weight: the final position balances the tilted weight."""
    body = some_body(gravity=9.81)
    ramp = vv.LoadTable(times=[0.1, 0.2], values=[np.zeros(6), [0, 0, 0, 0, 2e-3, 0]])
    run = vv.simulate(body, 20.0, base=ramp, initial=np.zeros(12), dt=0.005)
    weight = np.array([0, 0, -9.81 * MASS])
    tilted = np.r_[-np.cross([0, 2e-3, 0], weight), np.zeros(3)]
    rest = np.r_[np.zeros(4), 2e-3, 0] + np.linalg.solve(body._stiffness_at_rest, tilted)
    assert abs(rest[0]) > 1e-6
    np.testing.assert_allclose(run.state[-1, ::2], rest, atol=1e-10)


def test_nonlinear_response_branches_and_forces():
    """With memory: a response is an absolute motion by SciPy, and so are points of branches."""
    body, nu = some_body(cubic=CUBIC, memory=True), 40.0
    given = {"base": FLOOR, "harmonics": 13, "method": "newton", "tolerance": 1e-8}
    found = vv.forced_response(body, [nu], **given)
    k, x = found.harmonics, found.coefficients[0]

    def at(t):
        return (x @ np.exp(1j * k * nu * t)).imag

    floor = np.outer(FLOOR, k == 1)
    d = ROWS @ (x - floor)
    samples = 2 * np.pi * np.arange(256) / 256
    motion = (d @ np.exp(1j * np.outer(k, samples))).imag
    bent = np.tile([0, 0, CUBIC], 3)[:, np.newaxis] * motion**3
    weights = np.exp(-1j * np.outer(samples, k)) * np.where(k == 0, 1j, 2j) / 256
    force = np.tile(K, 3)[:, np.newaxis] * d + bent @ weights
    past = (force / (1j * k * nu + RATE)).sum(axis=1).imag
    start = np.r_[at(0), (x @ (1j * k * nu)).imag, past]
    period = 2 * np.pi / nu
    end = feet_moved(
        lambda t: (FLOOR * np.exp(1j * nu * t)).imag,
        lambda t: (1j * nu * FLOOR * np.exp(1j * nu * t)).imag,
        CUBIC, start, period / 3, True,
    )  # fmt: skip
    assert np.abs(x[:, k == 3]).max() > 1e-3 * np.abs(x).max()
    np.testing.assert_allclose(end[:6], at(period / 3), atol=1e-7)
    reported = body.mount_forces(found, base=FLOOR)
    np.testing.assert_allclose(reported.deflection[0].reshape(9, -1), d, atol=1e-15)
    assert (body.mount_forces(found).force == reported.force).all()
    with pytest.raises(vv.InputError, match="must be the motion of the floor"):
        body.mount_forces(found, base=2 * FLOOR)

    nus = (30.0, 50.0)
    given = {"base": FLOOR, "harmonics": 13, "tolerance": 1e-6}
    branch = vv.trace_response(body, nus, at=[nu], stability=True, **given)
    i = branch.stops[0]
    kept = branch.harmonics.size
    np.testing.assert_allclose(branch.coefficients[i], x[:, :kept], atol=1e-8)
    assert branch.iterations.max() <= 5
    assert all(branch.stable)
    again = vv.trace_response(body, nus, start=(branch, 3), **given)
    at = again.coefficients[np.abs(again.nu - branch.nu[3]).argmin()]
    np.testing.assert_allclose(at, branch.coefficients[3], atol=1e-9)
    up = vv.trace_response(body, load_range=(0.1, 1.0), nu=nu, stability=False, **given)
    np.testing.assert_allclose(up.coefficients[-1], x[:, : up.harmonics.size], atol=1e-8)
    # The load factor also scales the floor motion.
    scaled = up.load_factor[:, np.newaxis] * (ROWS @ FLOOR)
    fundamental = up.coefficients[..., up.harmonics == 1] @ np.ones(1)
    deflected = body.mount_forces(up).deflection[..., up.harmonics == 1].reshape(-1, 9)
    np.testing.assert_allclose(deflected, fundamental @ ROWS.T - scaled, atol=1e-12)


def test_slopes_of_a_branch_with_weight_and_rotor():
    """The frequency derivative includes weight and rotor: few corrector steps per point."""
    body = some_body(cubic=CUBIC, gravity=9.81, spin=(2.0, -3.0, 20.0))
    given = {"base": 0.2 * FLOOR, "harmonics": 9, "tolerance": 1e-5}
    branch = vv.trace_response(body, (5.0, 60.0), stability=False, **given)
    assert branch.outcome == "completed"
    assert branch.iterations.max() <= 5
    i = branch.nu.size // 2
    one = vv.forced_response(body, branch.nu[[i]], method="newton", **given)
    np.testing.assert_allclose(one.coefficients[0], branch.coefficients[i], atol=1e-7)


def test_exact_geometry_on_a_floor_that_goes_round():
    """Along x and y, a quarter period apart, finite rotations: absolute motions by SciPy."""
    body = some_body(geometry="exact", load_axes="space")
    base, nu = np.array([8e-3, 8e-3j, 2e-3]), 25.0
    start = np.zeros(12)
    start[7::2] = 8.0, -6.0, 4.0
    run = vv.simulate(
        body, 0.3, initial=start, base={"x": 8e-3, "y": 8e-3j, "z": 2e-3}, nu=nu, dt="auto",
        tolerance=1e-10,
    )  # fmt: skip

    def rates(t, y):
        place, speed, turn, w = y[:3], y[3:6], y[6:15].reshape(3, 3), y[15:]
        wave = base * np.exp(1j * nu * t)
        push, moment = np.zeros(3), np.zeros(3)
        for p in PLACES:
            arm = turn @ p
            pull = -K * (place + arm - p - wave.imag)
            pull -= C * (speed + turn @ np.cross(w, p) - (1j * nu * wave).imag)
            push, moment = push + pull, moment + np.cross(arm, pull)
        own = turn.T @ moment - np.cross(w, INERTIA * w)
        across = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        return np.concatenate([speed, push / MASS, (turn @ across).ravel(), own / INERTIA])

    begin = np.concatenate([np.zeros(6), np.eye(3).ravel(), start[7::2]])
    y = solve_ivp(rates, (0, 0.3), begin, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    assert np.linalg.norm(run.state[:, 6::2], axis=1).max() > 0.1
    np.testing.assert_allclose(run.state[-1, :6:2], y[:3], atol=1e-9)
    turn = Rotation.from_rotvec(run.state[-1, 6::2]).as_matrix()
    np.testing.assert_allclose(turn, y[6:15].reshape(3, 3), atol=1e-9)


@pytest.mark.parametrize(
    ("call", "reported"),
    [
        (lambda: vv.forced_response(some_body(), [9.0], base=1e-3), "or a motion for each"),
        (lambda: vv.forced_response(some_body(), [9.0], base=[1, 2]), r"have shape \(6,\)"),
        (lambda: vv.forced_response(some_body(), [9.0], base={"q": 1}), "'q' must be one of the 6"),
        (
            lambda: vv.simulate(
                some_body(), 1, base=vv.LoadTable(times=[0, 1], values=np.zeros((2, 5)))
            ),
            r"must have shape \(2, 6\)",
        ),
        (
            lambda: vv.forced_response(
                some_body(geometry="exact", load_axes="space"), [9.0], base={"rx": 1e-3},
                method="newton",
            ),
            "base: must not turn the floor with geometry = 'exact'",
        ),
        (
            lambda: vv.forced_response(
                some_body(geometry="exact"), [9.0], base={"x": 1e-3}, method="newton"
            ),
            "must be 'space' where the floor",
        ),
        (
            lambda: vv.forced_response(vv.Mount(
                mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2
            ), [1.0], base=[1e-3, 0]),
            "along one direction here",
        ),
    ],
)  # fmt: skip
def test_what_is_refused(call, reported):
    with pytest.raises(vv.InputError, match=reported):
        call()
