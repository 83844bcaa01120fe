"""Reciprocating engines: balances of standard engines, and random ones by mechanics."""

import pickle

import numpy as np
import pytest
import viscovib as vv

PI = np.pi
FOUR = {
    "crank_radius": 0.045, "rod_length": 0.15, "reciprocating_mass": 0.6,
    "crank_angles": (0, PI, PI, 0), "positions": (-0.15, -0.05, 0.05, 0.15),
}  # fmt: skip


def test_an_inline_four_has_a_force_of_second_order_only():
    """4 m r A_2 along the cylinders, which is 4 m r (r/l) to first order in r/l."""
    for radius in (0.045, 0.003):
        engine = vv.PistonEngine(**FOUR | {"crank_radius": radius}, axis="y", up="z")
        ratio, size = radius / 0.15, 4 * 0.6 * radius
        assert engine.orders.tolist()[:2] == [2, 4]
        second = ratio + ratio**3 / 4 + 15 * ratio**5 / 128 + 35 * ratio**7 / 512
        fourth = ratio**3 / 4 + 3 * ratio**5 / 16 + 35 * ratio**7 / 256
        # cos 2 theta is Im[i exp(2 i theta)].
        wanted = size * np.array([[0, 0, 1j * second], [0, 0, -1j * fourth]])
        assert np.abs(engine.forces[:2] - wanted).max() < 2 * size * ratio**9
        assert not engine.forces[:, :2].any()
        # No moment across the shaft: cylinders are symmetric about the point.
        assert not engine.moments[:, [0, 2]].any()
    torque = -0.5 * 4 * 0.6 * 0.003**2  # -m r^2/2 sin 2 theta of each cylinder, to first order
    assert engine.moments[0, 1] == pytest.approx(-torque, rel=1e-3)


def test_a_cross_plane_v8_with_counterweights_is_balanced():
    """90 degrees. Without counterweights only a rotating moment of order 1 is left."""
    throws = np.repeat(np.radians([0, 90, 270, 180]), 2)
    given = {
        "crank_radius": 0.042, "rod_length": 0.15, "reciprocating_mass": 0.7,
        "crank_angles": throws, "positions": np.repeat([-0.165, -0.055, 0.055, 0.165], 2),
        "bank_angles": np.tile([-PI / 4, PI / 4], 4), "highest": 3,
    }  # fmt: skip
    engine = vv.PistonEngine(**given, rotating_mass=-0.35)
    assert not engine.forces.any()
    assert not engine.moments[:, 1:].any()
    bare = vv.PistonEngine(**given)
    assert bare.orders.tolist() == [1]
    assert not bare.forces.any()
    # Im[i exp(i x)] = cos x: y and z differ by a quarter turn.
    assert np.abs(bare.moments[0, 1]) == pytest.approx(np.abs(bare.moments[0, 2]), rel=1e-12)
    assert np.abs(bare.moments[0, 1]) > 0.7 * 0.042 * 0.1


def test_an_inline_six_has_neither_forces_nor_moments():
    engine = vv.PistonEngine(
        crank_radius=0.04, rod_length=0.14, reciprocating_mass=0.5,
        crank_angles=np.radians([0, 120, 240, 240, 120, 0]),
        positions=0.09 * np.arange(6) - 0.225, rotating_mass=0.8, highest=5,
    )  # fmt: skip
    assert engine.orders.tolist() == [3]
    assert not engine.forces.any()
    assert not engine.moments[:, 1:].any()
    # To first order in r/l the torque is -m r^2 (3/4) (r/l) sin 3 theta of each cylinder.
    assert engine.moments[0, 0] == pytest.approx(6 * 0.75 * 0.5 * 0.04**3 / 0.14, rel=0.05)


def drawn(rng, n, **more):
    """A random engine."""
    radius = rng.uniform(0.02, 0.1)
    return {
        "crank_radius": radius, "rod_length": radius * rng.uniform(2.5, 5),
        "reciprocating_mass": rng.uniform(0.1, 2), "crank_angles": rng.uniform(-7, 7, n),
        "positions": rng.uniform(-0.5, 0.5, n), "bank_angles": rng.uniform(-3, 3, n),
        "rotating_mass": rng.normal(size=n), "axis": rng.normal(size=3),
        "up": rng.normal(size=3), "highest": 40,
    } | more  # fmt: skip


def test_cylinders_fire_at_a_dead_centre_in_their_order():
    for throws, banks, order, wanted in [
        ([0, 180, 180, 0], 0, (1, 3, 4, 2), [0, 540, 180, 360]),
        ([0, 120, 240, 240, 120, 0], 0, (1, 5, 3, 6, 2, 4), [0, 480, 240, 600, 120, 360]),
        ([0, 0], [0, 45], (1, 2), [0, 405]),
        ([0, 180], 0, (1, 2), [0, 180]),
        ([0, 0], 0, (2, 1), [360, 0]),
        ([0, 90, 270, 180], 0, (1, 3, 2, 4), [0, 450, 270, 540]),
    ]:  # fmt: skip
        n = len(throws)
        engine = vv.PistonEngine(
            crank_radius=0.05, rod_length=0.16, reciprocating_mass=1, positions=np.zeros(n),
            crank_angles=-np.radians(throws), bank_angles=np.radians(banks), firing_order=order,
        )  # fmt: skip
        np.testing.assert_allclose(np.degrees(engine.firing_angles), wanted, atol=1e-9)


def test_loads_on_a_body_by_speed_and_as_formulas():
    rng = np.random.default_rng(5)
    foot = vv.MountPoint(name="foot", position=(0.1, 0, -0.2), stiffness=(1e5, 2e5, 3e5),
                         damping=(100, 100, 100), rotational_stiffness=(9e4, 8e4, 9e4))  # fmt: skip
    body = vv.Body(mass=90, inertia=(3, 5, 6), center=(0.02, 0.03, 0.01), mounts=[foot])
    engine = vv.PistonEngine(
        **drawn(rng, 3, highest=4, crank_angles=(0, 4, 2), bank_angles=0), at=(0.1, 0.2, 0.3),
        firing_order=(1, 3, 2), gas_torque={0.5: 20 - 5j, 1: 30j, 1.5: 90},
    )  # fmt: skip
    speeds = np.array([50.0, 120.0])
    loads = engine.amplitudes(body, speeds)
    for i, nu in enumerate(speeds):
        for j in range(engine.orders.size):
            wanted = body.load(
                force=nu**2 * engine.forces[j], at=engine.at,
                torque=nu**2 * engine.moments[j] + engine.gas_moments[j],
            )  # fmt: skip
            np.testing.assert_allclose(loads[i, j], wanted, rtol=1e-13, atol=1e-13)
    found = body.engine_orders(speeds, engine.orders, loads)
    # The same as one periodic motion of the cycle, whose frequency is half the speed.
    cycle = vv.forced_response(body, speeds / 2, load=engine.load(body, per="cycle"))
    for i, name in enumerate(body.dof_names):
        for j, order in enumerate(engine.orders):
            amplitude = cycle.amplitude(name, harmonic=int(2 * order))
            np.testing.assert_allclose(amplitude, np.abs(found[:, j, i]), rtol=1e-9)
    with pytest.raises(vv.InputError, match="must be 'cycle'"):
        engine.load(body)
    with pytest.raises(vv.InputError, match="body"):
        engine.load(foot, per="cycle")
    branch = vv.trace_response(body, (50.0, 70.0), load=engine.load(body, per="cycle"))
    on_branch = body.engine_orders(
        2 * branch.nu, engine.orders, engine.amplitudes(body, 2 * branch.nu)
    )
    for j, order in enumerate(engine.orders):
        amplitude = branch.amplitude("ry", harmonic=int(2 * order))
        np.testing.assert_allclose(amplitude, np.abs(on_branch[:, j, 4]), rtol=1e-7)
    again = pickle.loads(pickle.dumps(engine))
    assert np.array_equal(again.forces, engine.forces)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"crank_radius": 0}, "crank_radius = 0: must be greater than 0"),
        ({"rod_length": 0.04}, "rod_length = 0.04: must be at least 1.001 crank_radius"),
        ({"crank_radius": 1e40}, "crank_radius = 1e.40: must be at most 1e.30"),
        ({"rotating_mass": 1e40}, "rotating_mass: must be at most 1e.30"),
        ({"crank_angles": []}, "crank_angles: must have a number of each cylinder"),
        ({"positions": 0.0}, r"positions: must have shape \(4,\)"),
        ({"bank_angles": (0, 1)}, r"bank_angles: must have shape \(4,\)"),
        ({"up": "x"}, "up: must not be parallel to axis"),
        ({"strokes": 3}, "strokes"),
        ({"highest": 51}, "highest = 51: must be 1 to 50"),
        ({"bore": 0.08}, "pressure, bore: must be given together"),
        ({"gas_torque": {0.3: 1}}, r"gas_torque\[0.3\]: orders must be 0, 0.5, 1"),
        ({"gas_torque": {0: 1j}}, "is the mean, must be real"),
        ({"gas_torque": {1: 1}}, "firing_order: is needed"),
        ({"gas_torque": {1: 1}, "firing_order": (1, 2, 3)}, "must contain each of 1 to 4 once"),
        ({"gas_torque": {1: 1}, "firing_order": (1, 4, 3, 2)}, "do not reach their dead centres"),
        ({"gas_torque": {1: 1}, "firing_order": (1, 2, 3), "positions": (0, 1, 2),
          "crank_angles": (0, 4 * PI / 3, 2 * PI / 3)}, "do not reach their dead centres"),
        ({"pressure": ([0, 180, 720], [1, 2, 1]), "bore": 0.1}, "not degrees"),
        ({"pressure": ([0, 1], [1, 2]), "bore": 0.1}, "at least 3"),
        ({"at": (0, 0)}, "at: must have shape"),
    ],
)  # fmt: skip
def test_bad_engines_are_refused(given, says):
    with pytest.raises(vv.InputError, match=says):
        vv.PistonEngine(**FOUR | given)
