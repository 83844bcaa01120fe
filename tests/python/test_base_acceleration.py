"""Accelerations of the base against its motions and closed forms."""

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp
from test_body import engine

RUBBER = vv.PronyKernel(weights=[0.1], rates=[2.0])
CHAIN = {"mass": np.diag([1.0, 2.0]), "stiffness": [[300.0, -100.0], [-100.0, 100.0]]}
SYSTEMS = {
    "polynomial system": lambda: vv.PolynomialSystem(
        mass=2.0, stiffness=50.0, damping=0.3, forces="40*x^3", base_direction=[1.0]
    ),
    "two coordinates with memory": lambda: vv.PolynomialSystem(
        **CHAIN, damping=np.eye(2), kernel=RUBBER, base_direction=[1.0, 1.0]
    ),
    "mount": lambda: vv.Mount(
        mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, kernel=RUBBER
    ),
    "structure": lambda: vv.Structure(
        **CHAIN, damping=np.eye(2), base_direction=[1.0, 1.0],
        elements=[vv.Spring(on={"x1": 1}, stiffness=10, law="200*d^3", kernel=RUBBER)],
    ),
    "structure with a stop": lambda: vv.Structure(
        **CHAIN, damping=np.eye(2), base_direction=[1.0, 1.0],
        elements=[vv.Gap(on={"x1": 1}, stiffness=1000.0, gap=0.003)],
    ),
    "body": engine,
}  # fmt: skip


@pytest.mark.parametrize("name", SYSTEMS)
def test_an_acceleration_is_a_motion_of_the_base(name):
    """The base moves by y = 0.8 t^3, its acceleration is 4.8 t."""
    system = SYSTEMS[name]()
    t = np.linspace(0, 1, 6)
    base: object = 0.8 * t**3
    acceleration: object = vv.LoadTable(times=t, values=4.8 * t)
    if name == "body":
        base = np.outer(base, [0, 0, 1, 0, 0, 0])
        acceleration = {"z": acceleration}
    push = 0.2 * np.arange(1, len(system.dof_names) + 1)
    force = vv.LoadTable(times=[0, 0.3, 0.6], values=np.outer([0, 1, 0], push))
    for more in ({}, {"force": force, "load": {1: push}, "nu": 4.0}):
        moved = vv.LoadTable(times=t, values=base, interpolation="cubic")
        absolute = vv.simulate(system, 0.99, dt=0.0099, base=moved, **more)
        relative = vv.simulate(system, 0.99, dt=0.0099, base_acceleration=acceleration, **more)
        direction = system._base_direction
        if direction is None:
            direction = np.array([0, 0, 1, 0, 0, 0])
        wanted = absolute.state[:, ::2] - np.outer(0.8 * absolute.t**3, direction)
        off = np.abs(relative.state[:, ::2] - wanted).max()
        assert off < 2e-10 * np.abs(wanted).max()
        push = relative.acceleration - absolute.acceleration
        assert np.abs(push).max() < 1e-7 * np.abs(absolute.acceleration).max()
        assert (relative.relative_to_base, absolute.relative_to_base) == (True, False)
        assert "relative to the base" in relative.summary()


def test_a_point_of_a_body_moves_with_a_base_that_accelerates():
    t = np.linspace(0, 1, 6)
    base = vv.LoadTable(
        times=t, values=np.outer(0.8 * t**3, [0, 0, 1, 0, 0, 0]), interpolation="cubic"
    )
    acceleration = {"z": vv.LoadTable(times=t, values=4.8 * t)}
    body, point = engine(), (0.1, 0.2, 0.3)
    absolute = vv.simulate(body, 0.99, dt=0.0099, base=base)
    relative = vv.simulate(body, 0.99, dt=0.0099, base_acceleration=acceleration)
    for given in (False, True):
        one, other = (run.motion_of(point, relative=given) for run in (absolute, relative))
        assert np.abs(one.displacement - other.displacement).max() < 1e-10
        assert np.abs(one.velocity - other.velocity).max() < 1e-8
        assert np.abs(one.acceleration - other.acceleration).max() < 1e-6
    assert np.abs(absolute.floor_force().force - relative.floor_force().force).max() < 1e-4


def test_the_motion_of_a_base_is_that_of_its_cubics_and_waves():
    swing = vv.PolynomialSystem(mass=1.0, stiffness=4.0, damping=1.0, base_direction=[1.0])
    shock = vv.HalfSine(amplitude=2.0, duration=0.5, start=0.1)
    run = vv.simulate(swing, 2, base_acceleration=shock, dt=0.01)
    wanted = run.acceleration[:, 0]
    assert np.abs(wanted + 4 * run.state[:, 0] + run.state[:, 1]).max() < 1e-10
    place, speed, _ = run._floor.at(np.array([0.05, 0.6, 1.6]))
    reached = 2 * 2.0 * 0.5 / np.pi
    assert speed[:, 0] == pytest.approx([0, reached, reached], abs=1e-11)
    assert place[:, 0] == pytest.approx([0, reached * 0.25, reached * 1.25], abs=1e-11)
    run = vv.simulate(swing, 2, base_acceleration=0.5 + 0.2j, nu=1.5, dt=0.01)
    wave = -(0.5 + 0.2j) / 1.5**2 * np.exp(1.5j * run.t)
    assert run._floor.at(run.t)[0][:, 0] == pytest.approx(wave.imag, abs=1e-14)


def test_a_base_that_drifts_loses_no_digits():
    """A step of acceleration: x = -(a/w^2) (1 - cos w t), with the base 5e5 m away at the end."""
    swing = vv.PolynomialSystem(mass=2.0, stiffness=18.0, base_direction=[1.0])
    push = vv.Step(amplitude=1.0)
    run = vv.simulate(swing, 1000, base_acceleration=push, dt="auto", tolerance=1e-11)
    wanted = -(1 - np.cos(3 * run.t)) / 9
    assert np.abs(run.state[:, 0] - wanted).max() < 1e-10
    longer = vv.simulate(swing, 1001, resume=run)
    assert longer.relative_to_base
    assert abs(longer.state[-1, 0] + (1 - np.cos(3003)) / 9) < 1e-10


def test_a_shock_in_g_moves_a_progressive_mount_as_scipy_has_it():
    mount = vv.PolynomialSystem(
        mass=3.0, stiffness=3e4, damping=40.0, forces="2e8*x^3", base_direction=[1.0]
    )
    shock = vv.HalfSine(amplitude=15.0, duration=0.011, start=0.002, unit="g")
    run = vv.simulate(mount, 0.05, base_acceleration=shock, dt="auto", tolerance=1e-10)

    def rate(t, y):
        a = 15 * 9.80665 * np.sin(np.pi * (t - 0.002) / 0.011) * (0.002 <= t <= 0.013)
        return [y[1], -a - (40 * y[1] + 3e4 * y[0] + 2e8 * y[0] ** 3) / 3]

    y = [0.0, 0.0]
    for begin, end in ((0.002, 0.013), (0.013, 0.05)):
        y = solve_ivp(rate, (begin, end), y, method="DOP853", rtol=1e-13, atol=1e-16).y[:, -1]
    assert abs(run.state[-1, 0] - y[0]) < 1e-10
    assert abs(run.state[-1, 1] - y[1]) < 1e-7


def test_an_oscillating_acceleration_has_the_steady_response_of_the_base_motion():
    mount = vv.PolynomialSystem(mass=1.0, stiffness=4.0, damping=1.0, base_direction=[1.0])
    run = vv.simulate(mount, 60, base_acceleration=0.5 + 0.2j, nu=1.5, dt="auto")
    moved = vv.forced_response(mount, [1.5], base=-(0.5 + 0.2j) / 1.5**2, method="linear")
    relative = moved.coefficients[0, 0, 0] + (0.5 + 0.2j) / 1.5**2
    assert abs(run.state[-1, 0] - (relative * np.exp(1.5j * 60)).imag) < 1e-9


def test_what_an_acceleration_cannot_be_is_refused_in_a_line():
    table = vv.LoadTable(times=[0, 1, 2], values=[0, 1, 0])
    along = vv.PolynomialSystem(mass=1, stiffness=1, base_direction=[1.0])
    fixed = vv.PolynomialSystem(mass=1, stiffness=1)
    in_g = vv.LoadTable(times=[0, 1, 2], values=[0, 1, 0], unit="g")
    pendulum = vv.Pendulum(
        e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01, f0=0.002, p1=1.02
    )
    for system, given, says in [
        (along, {"base_acceleration": table, "base": table}, "both given"),
        (along, {"base_acceleration": "sin(t)"}, "must be a LoadTable, a shock"),
        (along, {"base_acceleration": 1.0}, "nu: must be given"),
        (along, {"base_acceleration": {"z": table}}, "must be one of x"),
        (fixed, {"base_acceleration": table}, "has no base_direction"),
        (engine(), {"base_acceleration": table}, "has no base_direction"),
        (pendulum, {"base_acceleration": table, "initial": np.zeros(6)}, "is for a Mount"),
        (along, {"force": in_g}, "force: is an acceleration in g"),
        (along, {"base": in_g}, "base: is an acceleration in g"),
        (vv.Structure(mass=[[1.0]], stiffness=[[1.0]]), {"force": in_g}, "force: is an accelera"),
        (vv.Structure(mass=[[1.0]], stiffness=[[1.0]]), {"base_acceleration": table},
         "has no base_direction"),
    ]:  # fmt: skip
        with pytest.raises(vv.InputError, match=says):
            vv.simulate(system, 1, **given)
    with pytest.warns(vv.RangeWarning, match=r"base_acceleration: its peak is 4903.33 m/s\^2"):
        vv.simulate(along, 0.1, base_acceleration=vv.Step(amplitude=500, unit="g"))
    drifts = vv.LoadTable(times=np.arange(200), values=0.3 + np.zeros(200))
    with pytest.warns(vv.RangeWarning, match=r"offset of 0.3 m/s\^2"):
        vv.simulate(along, 0.1, base_acceleration=drifts)
