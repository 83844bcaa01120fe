"""Rotors whose speed changes: run-ups with matrices of the speed, and motors, against SciPy."""

import itertools

import numpy as np
import pytest
import viscovib as vv
from scipy.integrate import solve_ivp


def integrated(rate, ends, start):
    """The last state of an integration over consecutive intervals."""
    for begin, end in itertools.pairwise(ends):
        run = solve_ivp(rate, (begin, end), start, method="DOP853", rtol=1e-12, atol=1e-14)
        start = run.y[:, -1]
    return start


class Laval:
    """A random disc on an anisotropic, nonlinear shaft with internal damping, and its motor."""

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        self.mass, self.k = rng.uniform(0.5, 2), rng.uniform(50, 200, 2)
        self.c, self.internal = rng.uniform(0.5, 3), rng.uniform(0, 0.3)
        self.cubic, self.me = rng.uniform(0, 300), rng.uniform(0.01, 0.05)
        self.inertia = rng.uniform(0.02, 0.1) + self.me**2 / self.mass
        self.torque, self.slope = rng.uniform(0.1, 1), rng.uniform(0.003, 0.03)
        self.wave = rng.uniform(0, 0.2)
        self.start = np.concatenate([0.01 * rng.normal(size=4), [rng.uniform(0, 6), 1.0]])
        self.load, self.nu = 0.0, rng.uniform(1, 9)
        self.relaxed, self.rate_of_memory = 0.0, rng.uniform(0.5, 3)

    def system(self, **more):
        cubic = f"{self.cubic}*(x^2 + y^2)"
        forces = {"x": f"x*{cubic}", "y": f"y*{cubic}"}
        return vv.PolynomialSystem(forces=forces, **self.matrices(), **more)

    def matrices(self):
        turn = self.internal * np.array([[0, 1], [-1, 0]])
        return dict(
            mass=[self.mass] * 2, stiffness=self.k, damping=[self.c] * 2, circulatory=turn,
            names=["x", "y"],
        )  # fmt: skip

    def structure(self):
        cubic = f"{self.cubic}*(x^2 + y^2)"
        law = {"x": f"x*{cubic}", "y": f"y*{cubic}"}
        coupling = vv.Coupling(on={"x": "x", "y": "y"}, law=law)
        return vv.Structure(elements=[coupling], **self.matrices())

    def kernel(self):
        b = self.rate_of_memory
        return vv.PronyKernel(weights=[self.relaxed * b], rates=[b])

    def drive(self):
        return vv.DriveTorque(
            torque=f"{self.torque} - {self.slope}*nu + {self.wave}*sin(phi)",
            inertia=self.inertia, unbalance=[1j * self.me, self.me], phase=self.start[4],
            speed=self.start[5],
        )  # fmt: skip

    def rate(self, t, z):
        """Lagrange's equations with the displacements x + e cos(phi), y + e sin(phi)."""
        x, vx, y, vy, phi, w, *memory = z
        s, c, me = np.sin(phi), np.cos(phi), self.me
        matrix = np.array(
            [[self.mass, 0, -me * s], [0, self.mass, me * c], [-me * s, me * c, self.inertia]]
        )
        stiff = self.k + self.cubic * (x * x + y * y)
        force, b = stiff * [x, y], self.rate_of_memory
        recalled = np.array(memory or [0.0, 0.0])
        push = [
            me * w**2 * c - self.c * vx - w * self.internal * y + self.load * np.sin(self.nu * t),
            me * w**2 * s - self.c * vy + w * self.internal * x,
            self.torque - self.slope * w + self.wave * s,
        ]
        push[:2] += recalled - force
        a = np.linalg.solve(matrix, push)
        rates = [vx, a[0], vy, a[1], w, a[2]]
        return [*rates, *(b * (self.relaxed * force - recalled))] if memory else rates


@pytest.mark.parametrize("seed", range(6))
def test_motors_of_random_rotors(seed):
    """Under a load, as a structure, and with memory."""
    rotor, end, more = Laval(seed), 5.0, {}
    if seed % 2:
        rotor.load = 3.0
        more = dict(load={"x": rotor.load}, nu=rotor.nu)
    system, start = rotor.system(), rotor.start
    if seed % 3 == 1:
        system = rotor.structure()
    elif seed % 3 == 2:
        rotor.relaxed = 0.3
        system, start = rotor.system(kernel=rotor.kernel()), np.append(start, [0.0, 0.0])
    run = vv.simulate(
        system, end, force=rotor.drive(), initial=start[:4], times=[0, 2, end], **more
    )
    exact = integrated(rotor.rate, (0, end), start)
    assert run.system.dof_names == run.dof_names == ("x", "y", "angle")
    assert run.state[-1] == pytest.approx(exact[:6], rel=1e-8, abs=1e-9)
    rates = rotor.rate(end, exact)
    assert run.acceleration[-1] == pytest.approx(rates[1:6:2], rel=1e-6, abs=1e-6)
    if seed % 3 == 1:
        assert run.deflections[-1] == pytest.approx(exact[:4:2], rel=1e-6, abs=1e-9)
        return
    pull = (rotor.k + rotor.cubic * (exact[0] ** 2 + exact[2] ** 2)) * exact[:4:2]
    forces = run.element_forces()
    assert forces.elastic[-1] == pytest.approx(pull, rel=1e-6, abs=1e-7)
    if seed % 3 == 2:
        assert forces.memory[-1] == pytest.approx(-exact[6:], rel=1e-6, abs=1e-7)


def test_a_motor_on_a_body():
    """Six coordinates with an unbalance that couples them, and a gyroscopic rotor."""
    feet = [
        vv.MountPoint(name=f"foot{i}", position=at, stiffness=(2e3, 2.5e3, 3e3), damping=20)
        for i, at in enumerate([(0.3, 0.2, -0.1), (0.3, -0.2, -0.1), (-0.3, 0.1, -0.2)])
    ]
    body = vv.Body(mass=10, inertia=(0.2, 0.3, 0.4), mounts=feet, rotor=(0.05, 0, 0))
    u = body.unbalance(1.0, 0.1, at=(0.1, 0.02, 0.05), axis=(1, 0, 0))
    drive = vv.DriveTorque(torque="0.8 - 0.02*nu", inertia=0.06, unbalance=u, speed=2.0)
    run = vv.simulate(body, 3.0, force=drive, times=[0, 3.0])
    still, moving = body.at_speed(0.0), body.at_speed(1.0)
    gyroscopic = moving._damping - still._damping

    def rate(_, z):
        x, v, (phi, w) = z[:6], z[6:12], z[12:]
        turned = u * np.exp(1j * phi)
        matrix = np.block([[still.mass, turned.real[:, None]], [turned.real, np.array(0.06)]])
        push = w**2 * turned.imag - (still._damping + w * gyroscopic) @ v - still.stiffness @ x
        a = np.linalg.solve(matrix, np.append(push, 0.8 - 0.02 * w))
        return np.concatenate([v, a[:6], [w, a[6]]])

    exact = integrated(rate, (0, 3.0), np.append(np.zeros(13), 2.0))
    assert run.state[-1, ::2] == pytest.approx(np.append(exact[:6], exact[12]), abs=1e-9)
    assert run.state[-1, -1] == pytest.approx(exact[13], rel=1e-9)


def test_dry_friction_holds_the_rotor_and_the_shaft():
    """Against friction forces that are smooth within 1e-7 m/s and 1e-7 rad/s."""
    rotor, friction = Laval(2), 0.6
    system = vv.PolynomialSystem(
        mass=[rotor.mass] * 2, stiffness=rotor.k, damping=[rotor.c] * 2,
        forces={"x": "1.4*sign(x_dot)"}, names=["x", "y"],
    )  # fmt: skip
    drive = vv.DriveTorque(
        torque=f"{rotor.torque}*sin(3*phi) - {friction}*sign(nu)", inertia=rotor.inertia,
        unbalance=[1j * rotor.me, rotor.me], speed=3.0,
    )  # fmt: skip
    run = vv.simulate(system, 1.0, force=drive, initial=[0.05, 0, 0, 0], times=[0, 1.0])

    def rate(_, z):
        x, vx, y, vy, phi, w = z
        s, c, me = np.sin(phi), np.cos(phi), rotor.me
        matrix = np.diag([rotor.mass, rotor.mass, rotor.inertia])
        matrix[2, :2] = matrix[:2, 2] = [-me * s, me * c]
        push = [
            me * w**2 * c - rotor.c * vx - rotor.k[0] * x - 1.4 * np.tanh(vx / 1e-7),
            me * w**2 * s - rotor.c * vy - rotor.k[1] * y,
            rotor.torque * np.sin(3 * phi) - friction * np.tanh(w / 1e-7),
        ]
        a = np.linalg.solve(matrix, push)
        return [vx, a[0], vy, a[1], w, a[2]]

    start = [0.05, 0, 0, 0, 0, 3.0]
    exact = solve_ivp(rate, (0, 1), start, method="Radau", rtol=1e-7, atol=1e-10).y[:, -1]
    assert abs(exact[[1, 5]]).max() < 1e-6
    assert run.state[-1] == pytest.approx(exact, abs=3e-6)


def test_a_motor_without_loss_keeps_the_energy():
    rotor = Laval(3)
    rotor.c = rotor.internal = rotor.torque = rotor.slope = rotor.wave = 0.0
    rotor.start[5] = 9.0
    drive = vv.DriveTorque(
        torque="0", inertia=rotor.inertia, unbalance=[1j * rotor.me, rotor.me], speed=9.0
    )
    run = vv.simulate(rotor.system(), 8, force=drive, rtol=1e-11)
    x, vx, y, vy, phi, w = run.state.T
    kinetic = 0.5 * rotor.mass * (vx**2 + vy**2) + 0.5 * rotor.inertia * w**2
    kinetic += rotor.me * w * (vy * np.cos(phi) - vx * np.sin(phi))
    square = x**2 + y**2
    energy = kinetic + 0.5 * (rotor.k[0] * x**2 + rotor.k[1] * y**2) + rotor.cubic * square**2 / 4
    assert energy == pytest.approx(energy[0], rel=1e-9)


def test_a_weak_motor_is_captured_by_the_resonance():
    """Sommerfeld effect: the speed stays near 10 rad/s, below the idle speed of 20 rad/s."""
    rotor = vv.PolynomialSystem(mass=[1, 1], stiffness=[100, 100], damping=[0.2, 0.2])
    last = {}
    for torque in (0.4, 4.0):
        drive = vv.DriveTorque(torque=f"{torque}*(1 - nu/20)", inertia=0.1, unbalance=[0.02j, 0.02])
        run = vv.simulate(rotor, 60, force=drive, rtol=1e-7)
        speed = run.state[:, -1]
        last[torque] = speed[run.t > 50]
    assert 9 < last[0.4].min() <= last[0.4].max() < 10.2
    assert last[4.0].min() > 19


class Changing:
    """A random rotor of n coordinates whose speed changes linearly between two times."""

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        self.n = n = int(rng.integers(2, 9))
        a, b = rng.normal(size=(2, n, n))
        self.mass, self.stiffness = a @ a.T / n + np.eye(n), 20 * b @ b.T / n + 50 * np.eye(n)
        self.damping = np.diag(rng.uniform(0.3, 0.8, n))
        skew, self.circulatory, self.centrifugal = rng.normal(size=(3, n, n)) / np.sqrt(n)
        self.gyroscopic = 0.2 * (skew - skew.T)
        self.circulatory, self.centrifugal = 0.3 * self.circulatory, 0.01 * self.centrifugal
        self.unbalance = 0.02 * (rng.normal(size=n) + 1j * rng.normal(size=n))
        self.speed = (3.0, 20.0) if seed % 2 else (20.0, 2.0)
        self.start = 0.01 * rng.normal(size=2 * n)
        self.load = vv.RunUp(
            unbalance=self.unbalance, speed=self.speed, duration=4.0, start=0.5, hold=1.0, phase=0.4
        )

    def system(self, **more):
        return vv.PolynomialSystem(
            mass=self.mass, stiffness=self.stiffness, damping=self.damping,
            gyroscopic=self.gyroscopic, circulatory=self.circulatory,
            centrifugal=self.centrifugal, forces={"x1": "30*x1^3 + k*tanh(x2_dot)"},
            parameters={"k": 0.1}, **more,
        )  # fmt: skip

    def turn(self, t):
        """Angle, speed and acceleration of the shaft, and a mask of its load."""
        first, last = self.speed
        slope, passed = (last - first) / 4, min(max(t - 0.5, 0), 4.0)
        angle = 0.4 + first * min(t - 0.5, 0) + first * passed + slope * passed**2 / 2
        angle += last * max(t - 4.5, 0)
        return angle, first + slope * passed, slope * (0.5 <= t <= 4.5), 0.5 <= t <= 5.5

    def rate(self, t, z):
        u, v = z[: self.n], z[self.n :]
        angle, speed, slope, loads = self.turn(t)
        push = loads * (self.unbalance * (speed**2 - 1j * slope) * np.exp(1j * angle)).imag
        push[0] -= 30 * u[0] ** 3 + 0.1 * np.tanh(v[1])
        push -= (self.damping + speed * self.gyroscopic) @ v
        push -= (self.stiffness + speed * self.circulatory + speed**2 * self.centrifugal) @ u
        return np.concatenate([v, np.linalg.solve(self.mass, push)])


@pytest.mark.parametrize("seed", range(4))
def test_run_ups_use_the_matrices_at_the_instantaneous_speed(seed):
    rotor = Changing(seed)
    run = vv.simulate(
        rotor.system(), 6.0, force=rotor.load, initial=rotor.start, times=[0, 3, 6], rtol=1e-11
    )
    begin = np.concatenate([rotor.start[::2], rotor.start[1::2]])
    inner = np.nextafter(np.array([0.5, 4.5, 5.5]), [0, 9, 9])
    exact = begin
    # The load jumps at these times.
    for low, high in ((0, inner[0]), (0.5, 4.5), (inner[1], 5.5), (inner[2], 6)):
        exact = integrated(rotor.rate, (low, high), exact)
    n = rotor.n
    assert run.state[-1][: 2 * n : 2] == pytest.approx(exact[:n], abs=1e-10)
    assert run.state[-1][1 : 2 * n : 2] == pytest.approx(exact[n:], abs=1e-9)
    angle, speed, _, _ = rotor.turn(6.0)
    assert run.state[-1][-2:] == pytest.approx([angle, speed], rel=1e-12)


def test_a_run_up_at_constant_speed_is_a_motion_at_that_speed():
    rotor = Changing(4)
    kernel = vv.PronyKernel(weights=[0.2], rates=[1.5])
    system = rotor.system(springs=[vv.Springs(stiffness=np.diag(np.full(rotor.n, 9.0)),
                                              kernel=kernel)])  # fmt: skip
    load = vv.RunUp(unbalance=rotor.unbalance, speed=(7.0, 7.0), duration=5.0)
    run = vv.simulate(system, 4.0, force=load, times=[4.0], rtol=1e-10)
    same = vv.simulate(system, 4.0, load=49.0 * rotor.unbalance, nu=7.0, times=[4.0], rtol=1e-10)
    assert run.state[-1][:-2] == pytest.approx(same.state[-1], abs=1e-8)


def test_a_given_step_size_is_used():
    rotor = Laval(6)
    given = dict(force=rotor.drive(), initial=rotor.start[:4], times=[0, 2])
    one = vv.simulate(rotor.system(), 2, dt=0.01, **given)
    other = vv.simulate(rotor.system(), 2, **given)
    assert one.step == pytest.approx(0.01)
    assert one.state[-1] == pytest.approx(other.state[-1], rel=1e-7, abs=1e-8)


def test_events_find_a_speed():
    rotor = Laval(5)
    run = vv.simulate(
        rotor.system(), 5, force=rotor.drive(), initial=rotor.start[:4], events=["angle_dot - 2"]
    )
    assert run.events[0].state[:, -1] == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"torque": 5.0}, "torque = 5.0: must be a formula in nu"),
        ({"torque": "5 - q"}, "torque"),
        ({"inertia": 0.0}, "inertia = 0: must be greater than 0"),
        ({"unbalance": np.ones((2, 2))}, "unbalance: must be a number or have shape"),
        ({"speed": "a"}, "speed = 'a': must be a real number"),
    ],
)
def test_wrong_motors_are_refused(given, message):
    with pytest.raises(vv.InputError, match=message):
        vv.DriveTorque(**{"torque": "5 - nu", "inertia": 1.0} | given)


def test_what_is_not_available_is_refused():
    rotor = Laval(1)
    system, drive = rotor.system(), rotor.drive()
    chain = vv.Structure(mass=[1, 0], stiffness=[1, 1], names=["x", "y"])
    with pytest.raises(vv.InputError, match="a motor is for structures all of whose coordinates"):
        vv.simulate(chain, 1, force=drive)
    stop = vv.Stop(on="x", gap=0.1, restitution=0.5)
    with pytest.raises(vv.InputError, match="unbalance: must be 0 with rigid stops"):
        vv.simulate(vv.Structure(elements=[stop], **rotor.matrices()), 1, force=drive)
    with pytest.raises(vv.InputError, match="base: must not move with a DriveTorque"):
        vv.simulate(system, 1, force=drive, base=0.1, nu=1.0)
    with pytest.raises(vv.InputError, match="the speed of its shaft changes"):
        vv.simulate(system, 1, force=drive).system.natural_frequencies()
    with pytest.raises(vv.InputError, match="the speed of its shaft changes"):
        vv.forced_response(vv.simulate(system, 1, force=drive).system, [1.0], load={"x": 1})
    with pytest.raises(vv.InputError, match="inertia = 1e-9: must be greater than"):
        vv.simulate(system, 1, force=vv.DriveTorque(torque="1", inertia=1e-9, unbalance=[1, 1]))
    with pytest.raises(vv.InputError, match=r"unbalance: must have shape \(2,\), got \(3,\)"):
        vv.simulate(system, 1, force=vv.DriveTorque(torque="1", inertia=1, unbalance=np.ones(3)))
    with pytest.raises(vv.InputError, match="memory = 'direct': must be one of"):
        vv.simulate(rotor.system(kernel=rotor.kernel()), 1, force=drive, memory="direct")
    with pytest.raises(vv.InputError, match=r"initial: must have shape \(4,\)"):
        vv.simulate(system, 1, force=drive, initial=np.zeros(6))
    with pytest.raises(vv.InputError, match="names: must not contain 'angle'"):
        vv.simulate(
            vv.PolynomialSystem(mass=[1, 1], stiffness=[1, 1], names=["x", "angle"]), 1,
            force=drive,
        )  # fmt: skip
    with pytest.raises(vv.InputError, match="resume and held are not available"):
        vv.simulate(system, 1, force=drive, held=np.zeros(2))
