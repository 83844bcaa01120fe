"""Accelerations, forces and peaks along motions in time."""

import pickle

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

#: Central differences of order 8.
WEIGHTS = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
PRONY = vv.PronyKernel(weights=[0.3, 0.2], rates=[1.0, 4.0])
STEEP = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
RAMPS = vv.LoadTable(times=[0, 1, 1.5, 4], values=[0, 0.1, -0.1, 0.0], interpolation="linear")
MASS = np.diag([2.0, 1.0, 1.5])
STIFFNESS = np.array([[8.0, -3, 0], [-3, 7, -2], [0, -2, 6]])
DAMPING = np.array([[0.2, -0.1, 0], [-0.1, 0.1, 0], [0, 0, 0.03]])


def mount(**more):
    return vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, **more)


def chain(*elements, **more):
    return vv.Structure(
        mass=MASS, stiffness=STIFFNESS, damping=DAMPING, elements=list(elements), **more
    )


def on_feet(geometry, kernel, **more):
    feet = [
        vv.MountPoint(
            name=f"foot{i}", position=(x, y, -0.1), stiffness=(200, 200, 400), kernel=kernel,
            damping=(1, 1, 2),
        )
        for i, (x, y) in enumerate([(0.3, 0.2), (0.3, -0.2), (-0.3, 0.2)])
    ]  # fmt: skip
    return vv.Body(mass=8, inertia=(0.2, 0.3, 0.35), mounts=feet, geometry=geometry, **more)


@pytest.mark.parametrize("seed", range(6))
def test_accelerations_with_memory_with_exponentials_as_states(seed):
    """M a = load - C v - sum of (1 - R*) g, exponentials as states of an independent solver."""
    rng = np.random.default_rng([49, seed])
    n = int(rng.integers(1, 4))
    root = rng.normal(size=(2, n, n))
    mass, stiffness = (one @ one.T + n * np.eye(n) for one in root)
    cubic, weights, rates = rng.uniform(0.1, 1, n), rng.uniform(0.1, 0.5, 2), rng.uniform(0.3, 6, 2)
    damping, load, nu = 0.1 * np.eye(n), rng.normal(size=n), rng.uniform(0.5, 2)
    system = vv.PolynomialSystem(
        mass=mass,
        damping=damping,
        springs=[
            vv.Springs(
                stiffness=stiffness,
                forces={f"x{i + 1}": f"{float(cubic[i])!r}*x{i + 1}^3" for i in range(n)}
                if n > 1
                else f"{float(cubic[0])!r}*x^3",
                kernel=vv.PronyKernel(weights=weights, rates=rates),
            )
        ],
    )
    start = rng.normal(size=2 * n)
    run = vv.simulate(system, 6, initial=start, load=load, nu=nu)

    def slopes(t, y):
        u, v, hidden = y[:n], y[n : 2 * n], y[2 * n :].reshape(2, n)
        force = stiffness @ u + cubic * u**3
        push = load * np.sin(nu * t) - damping @ v - force + hidden.sum(axis=0)
        lost = np.outer(weights, force) - rates[:, None] * hidden
        return np.concatenate([v, np.linalg.solve(mass, push), lost.ravel()])

    begin = np.concatenate([start[::2], start[1::2], np.zeros(2 * n)])
    exact = solve_ivp(slopes, (0, 6), begin, method="DOP853", rtol=3e-14, atol=1e-15, t_eval=run.t)
    expected = np.array([slopes(*one)[n : 2 * n] for one in zip(exact.t, exact.y.T, strict=True)])
    assert np.abs(run.acceleration - expected).max() < 3e-11 * np.abs(expected).max()


FAMILY = {
    "mount": lambda: (mount(), {"load": 0.1, "nu": 1.5, "initial": [0.1, 0, 0.1, 0.2]}),
    "steep kernel": lambda: (mount(kernel=STEEP), {"held": [0.1, 0.1]}),
    "step by step": lambda: (
        mount(kernel=STEEP),
        {"memory": "direct", "dt": 0.1, "initial": [0.1, 0, 0.1, 0.2]},
    ),
    "past": lambda: (
        mount(kernel=PRONY),
        {"held": vv.Past(times=[-2, -1, 0], displacements=[[0, 0], [0.2, 0.1], [0.1, 0]])},
    ),
    "corners of the base": lambda: (
        vv.PolynomialSystem(
            mass=MASS, stiffness=STIFFNESS, damping=DAMPING, forces={"x1": "0.5*x1^3"},
            base_direction=[1, 1, 1],
        ),
        {"base": RAMPS, "initial": [0.1] * 6},
    ),
    "structure": lambda: (
        chain(vv.Spring(on={"x1": 1, "x3": -1}, stiffness=2, law="0.5*d^3", kernel=PRONY),
              base_direction=[1, 1, 1]),
        {"base": 0.1, "nu": 2.0, "initial": [0.1] * 6, "coordinates": ["x2"]},
    ),
    "hysteresis": lambda: (
        chain(vv.Jenkins(on={"x1": 1, "x3": -1}, stiffness=2, limit=0.2),
              vv.Spring(on={"x2": 1}, stiffness=1.0, kernel=PRONY)),
        {"load": {1: {"x1": 0.9}}, "nu": 1.3, "initial": [0.3] * 6},
    ),
    "friction": lambda: (
        vv.PolynomialSystem(mass=1, stiffness=4, forces="0.5*sign(x_dot)"),
        {"load": 1.5, "nu": 1.3, "initial": [2.0, 0.0]},
    ),
    "floor that turns": lambda: (
        on_feet("small", PRONY, gravity=9.81, spin=(0, 0, 1.0), base_direction="z"),
        {"base": {"x": 0.01, "rx": 0.02j}, "nu": 5.0},
    ),
    "finite rotations": lambda: (
        on_feet("exact", STEEP, load_axes="body"),
        {"load": [0, 0, 20, 1, 3, 2], "nu": 9.0, "initial": [0.05, 0.1] * 6},
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", FAMILY)
def test_accelerations_are_the_slopes_of_velocities(case):
    """For every kind of system: differences of order 8, except across a jump."""
    system, given = FAMILY[case]()
    run = vv.simulate(system, 5, **given)
    inner = run.t[(run.t > 0.1) & (run.t < 4.9)]
    rows = np.searchsorted(run.t, inner)
    h = 4e-3
    velocities = [w * run(inner + (k - 4) * h)[:, 1::2] for k, w in enumerate(WEIGHTS)]
    off = np.abs(sum(velocities) / h - run.acceleration[rows])
    assert run.acceleration.shape == (run.t.size, run.state.shape[1] // 2)
    assert np.median(off) < 1e-10 * np.abs(run.acceleration).max()
    assert np.quantile(off, 0.9) < 2e-8 * np.abs(run.acceleration).max()


@pytest.mark.parametrize("parts", [5, 8, 11, 32])
def test_accelerations_with_memory_do_not_depend_on_the_states_of_a_step(parts):
    given = {"load": 0.5, "nu": 1.5, "dt": 0.1}
    few = vv.simulate(mount(kernel=STEEP), 4, **given)
    many = vv.simulate(mount(kernel=STEEP), 4, times=np.linspace(0, 4, 40 * parts + 1), **given)
    np.testing.assert_allclose(many.acceleration[::parts], few.acceleration, atol=1e-12)


def test_accelerations_of_runs_that_go_on():
    """With other loads, from a pickle and for a last state, they equal those of one run."""
    system = mount(kernel=STEEP)
    start = [0.1, 0, 0.1, 0.2]
    given = {"load": 0.1, "nu": 1.5, "initial": start, "dt": 0.1}
    first = vv.simulate(system, 2, **given)
    whole = vv.simulate(system, 4, **given)
    later = vv.simulate(system, 4, resume=first)
    last = vv.simulate(system, 4, **given, keep="last")
    np.testing.assert_allclose(later.acceleration, whole.acceleration[20:], atol=1e-13)
    np.testing.assert_allclose(last.acceleration[0], whole.acceleration[-1], atol=1e-13)
    other = vv.simulate(system, 4, resume=first, load=0.3, nu=2.0)
    again = pickle.loads(pickle.dumps(other))
    np.testing.assert_array_equal(again.acceleration, other.acceleration)
    # The load jumps where the other load begins.
    jump = 0.3 * np.sin(4.0) - 0.1 * np.sin(3.0)
    force = system._mass_matrix @ (other.acceleration[0] - first.acceleration[-1])
    np.testing.assert_allclose(force, [jump, 0], atol=1e-12)


def test_accelerations_of_pendulums_and_units():
    pendulum = vv.Pendulum(
        e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01, f0=0.02, m01=0.01, m02=0.02,
        p1=0.93, p2=0.37, p3=0.71, equations="exact",
    )  # fmt: skip
    run = vv.simulate(pendulum, 5, initial=[0.1, 0, 0.2, 0, 0.1, 0.1])
    np.testing.assert_array_equal(run.acceleration, pendulum.rhs(run.t, run.state)[:, 1::2])
    assert run.acceleration_units == ("L omega_1^2", "rad omega_1^2", "rad omega_1^2")
    assert vv.simulate(mount(), 1, dt=0.1).acceleration_units == ("m/s^2", "rad/s^2")


def test_accelerations_that_are_not_there():
    """A coordinate without mass follows its forces: no equation has its acceleration."""
    light = vv.Structure(mass=np.diag([1.0, 0.0]), stiffness=[[2.0, -1], [-1, 2]])
    run = vv.simulate(light, 2, initial=[1, 0, 0.5, 0])
    with pytest.raises(vv.InputError, match="all of whose coordinates have mass"):
        _ = run.acceleration


def stiff_feet(geometry, kernel, law, **more):
    """A body on four mounts with local axes of their own."""
    places = [(0.3, 0.2), (0.3, -0.2), (-0.3, 0.2), (-0.3, -0.2)]
    feet = [
        vv.MountPoint(
            name=f"foot{i}", position=(*place, -0.1), angles=(0.1 * i, 0.2, -0.3),
            stiffness=(200, 200, 400), kernel=kernel, law=law, damping=(1, 1, 2),
            rotational_stiffness=(3, 3, 0) if geometry == "small" else (0, 0, 0),
        )
        for i, place in enumerate(places)
    ]  # fmt: skip
    return vv.Body(
        mass=8, inertia=(0.2, 0.3, 0.35), center=(0.02, 0.01, 0.03), mounts=feet,
        geometry=geometry, load_axes="space", **more,
    )  # fmt: skip


BODIES = [
    ("small", None, None),
    ("small", STEEP, "3e4*d^3"),
    ("small", PRONY, "50*max(d - 0.01, 0)"),
    ("exact", None, "3e4*d^3"),
    ("exact", PRONY, "3e4*d^3"),
]


@pytest.mark.parametrize("case", range(len(BODIES)))
def test_mount_forces_hold_the_balance_of_momentum(case):
    """Mass times acceleration and the force on the floor are the load; about its centre, too."""
    geometry, kernel, law = BODIES[case]
    body = stiff_feet(geometry, kernel, law, base_direction="z")
    start = np.zeros(12)
    start[[0, 4, 7, 9]] = 0.01, 0.01, 0.5, 0.3
    load = body.load((1, 2, 10), torque=(0.1, 0.2, 0.3)).real
    given = {"base": 0.005} if geometry == "small" else {}
    end = 0.3 if law and "max" in law else 1.5
    run = vv.simulate(body, end, initial=start, load=load, nu=9.0, **given)
    floor = run.floor_force(body.center)
    push = np.sin(9 * run.t)[:, None] * load
    # Of laws with kinks the panels of the memory end next to these.
    near = 1e-6 if law and "max" in law else 1e-11
    off = push[:, :3] - 8 * run.acceleration[:, :3] - floor.force
    assert np.abs(off).max() < near * np.abs(floor.force).max()
    if geometry == "small":
        off = push[:, 3:] - run.acceleration[:, 3:] * [0.2, 0.3, 0.35] - floor.moment
        assert np.abs(off).max() < near * np.abs(floor.moment).max()
        return
    t = run.t[(run.t > 0.1) & (run.t < 1.4)][::5]
    rows = np.searchsorted(run.t, t)
    h = 2e-3
    momentum = [w * body.angular_momentum(run(t + (k - 4) * h)) for k, w in enumerate(WEIGHTS)]
    about = floor.moment - np.cross(run.state[:, 0:6:2], floor.force)
    off = push[rows, 3:] - sum(momentum) / h - about[rows]
    assert np.abs(off).max() < 1e-8 * np.abs(about).max()


@pytest.mark.parametrize("law", ["3e4*d^3", None])
def test_parts_of_mount_forces_in_a_steady_motion(law):
    """In time they are those of the response, by harmonics of the same motion."""
    body = stiff_feet("small", PRONY, law)
    load = body.load((0, 0, 10))
    nu = 11.0
    response = vv.forced_response(body, [nu], load=load, harmonics=9)
    expected = body.mount_forces(response)
    run = vv.simulate(body, 60, load=load.real, nu=nu, times=np.linspace(59.0, 60.0, 40))
    forces = run.mount_forces()
    waves = np.exp(1j * nu * np.outer(run.t, expected.harmonics))
    for name in ("deflection", "force"):
        of_response = np.einsum("iak,nk->nia", getattr(expected, name)[0], waves).imag
        size = np.abs(of_response).max()
        assert np.abs(getattr(forces, name) - of_response).max() < 2e-6 * size


ELEMENTS = {
    "spring with memory": [vv.Spring(on=("x1", "x3"), stiffness=2, law="0.5*d^3", kernel=STEEP)],
    "friction": [vv.Spring(on="x2", law="0.3*sign(v)"), vv.Gap(on="x1", stiffness=20, gap=0.1)],
    "hysteresis": [
        vv.Jenkins(on=("x1", "x3"), stiffness=2, limit=0.2),
        vv.Spring(on="x2", stiffness=1.0, damping=0.2, kernel=PRONY),
    ],
    "Bouc-Wen": [vv.BoucWen(on="x1", stiffness=2, beta=3.0, gamma=1.0, ratio=0.1)],
    "law with memory": [
        vv.Spring(on=("x1", "x3"), stiffness=2, law="0.1*v*abs(v)", kernel=PRONY, damping=0.1)
    ],
}


@pytest.mark.parametrize("case", ELEMENTS)
def test_forces_of_elements_hold_the_balance_of_each_coordinate(case):
    system = chain(*ELEMENTS[case])
    run = vv.simulate(system, 4, load={1: {"x1": 0.9}}, nu=1.3, initial=[0.3] * 6)
    forces = run.element_forces()
    directions = np.array([element.direction for element in system._all_elements])
    off = run.acceleration @ MASS + run.state[:, 1::2] @ DAMPING + run.state[:, ::2] @ STIFFNESS
    off += forces.force @ directions
    off[:, 0] -= 0.9 * np.sin(1.3 * run.t)
    assert np.abs(off).max() < 2e-10
    np.testing.assert_allclose(forces.deflection, run.state[:, ::2] @ directions.T, atol=1e-14)


def test_forces_of_springs_of_other_systems():
    springs = vv.Springs(
        stiffness=np.eye(3), forces={"x2": "0.4*x2^3+0.1*tanh(x2_dot)"}, kernel=PRONY
    )
    system = vv.PolynomialSystem(
        mass=MASS, stiffness=STIFFNESS, damping=DAMPING, springs=[springs], forces={"x1": "x1*x2"}
    )
    run = vv.simulate(system, 4, load=0.5, nu=1.3, initial=[0.3] * 6)
    forces = run.element_forces()
    off = run.acceleration @ MASS + forces.force.reshape(run.t.size, -1, 3).sum(axis=1)
    off[:, 0] -= 0.5 * np.sin(1.3 * run.t)
    assert np.abs(off).max() < 1e-12
    assert forces.names[3] == "springs[0].x1"
    body = mount(kernel=STEEP, geometry="exact", kernel_phi=False)
    run = vv.simulate(body, 4, initial=[0.3, 0, 0.4, 0])
    forces = run.element_forces()
    on_x, on_phi = forces.force.T
    phi = run.state[:, 2]
    np.testing.assert_allclose(run.acceleration[:, 0], -on_x, atol=1e-12)
    np.testing.assert_allclose(
        0.1 * run.acceleration[:, 1], 0.5 * np.cos(phi) * on_x - on_phi, atol=1e-12
    )


def test_energy_along_a_motion_is_that_of_its_elements():
    """Energy at the start is what is left, and what elements have taken."""
    damper = vv.Spring(on=("x1", "x2"), stiffness=1.0, damping=0.3)
    friction = vv.Jenkins(on="x3", stiffness=2, limit=0.05)
    system = vv.Structure(mass=MASS, stiffness=STIFFNESS, elements=[damper, friction])
    run = vv.simulate(system, 6, initial=[0.3, 0, -0.2, 0, 0.1, 0], times=np.linspace(0, 6, 3001))
    forces = run.element_forces()
    u, v = run.state[:, ::2], run.state[:, 1::2]
    energy = 0.5 * (
        np.einsum("ni,ij,nj->n", v, MASS, v) + np.einsum("ni,ij,nj->n", u, STIFFNESS, u)
    )
    np.testing.assert_allclose(energy + forces.work.sum(axis=1), energy[0], atol=2e-8)
    stored = 0.5 * (forces.deflection[:, 0] ** 2 - forces.deflection[0, 0] ** 2)
    np.testing.assert_allclose(forces.dissipated[:, 0], forces.work[:, 0] - stored, atol=1e-9)


def test_points_of_a_body_and_of_its_floor():
    """A point that turns by finite angles: differences of its place; on the floor: none at rest."""
    body = stiff_feet("exact", PRONY, None)
    start = np.zeros(12)
    start[[0, 7, 9, 11]] = 0.01, 2.0, 1.5, -1.0
    run = vv.simulate(body, 1.0, initial=start)
    point = (0.2, -0.1, 0.4)
    times = np.linspace(0.1, 0.9, 20)
    h = 2e-3
    at = [vv.simulate(body, 1.0, initial=start, times=times + (k - 4) * h) for k in range(9)]
    moved = [one.motion_of(point) for one in at]
    speed = sum(w * one.displacement for w, one in zip(WEIGHTS, moved, strict=True)) / h
    push = sum(w * one.velocity for w, one in zip(WEIGHTS, moved, strict=True)) / h
    np.testing.assert_allclose(moved[4].velocity, speed, atol=1e-9)
    np.testing.assert_allclose(moved[4].acceleration, push, atol=1e-7)
    small = stiff_feet("small", None, None, base_direction="z")
    run = vv.simulate(small, 1.0, base={"x": 0.01, "rx": 0.02j}, nu=5.0)
    absolute, relative = run.motion_of("foot1"), run.motion_of("foot1", relative=True)
    waves = np.exp(5j * run.t)
    arm = np.subtract(small.mounts[1].position, small.center)
    floor = np.outer((0.01 * waves).imag, [1, 0, 0])
    floor += np.outer((0.02j * waves).imag, np.cross([1, 0, 0], arm))
    np.testing.assert_allclose(absolute.displacement - relative.displacement, floor, atol=1e-14)
    off = absolute.acceleration - relative.acceleration
    np.testing.assert_allclose(off, -25 * floor, atol=1e-12)
    local = np.einsum("ab,na->nb", small.mounts[1].rotation, relative.displacement)
    np.testing.assert_allclose(run.mount_forces().deflection[:, 1], local, atol=1e-14)


@pytest.mark.parametrize("seed", range(5))
def test_peaks_between_states(seed):
    """Of free motions of one oscillator in closed form; the error is that of the value."""
    rng = np.random.default_rng([490, seed])
    omega, decay = rng.uniform(1, 3), rng.uniform(0.05, 0.3)
    system = vv.PolynomialSystem(mass=1, stiffness=omega**2, damping=2 * decay)
    run = vv.simulate(system, 8, initial=[0, 1], times=np.linspace(0, 8, 81))
    fast = np.sqrt(omega**2 - decay**2)
    t = np.arctan2(fast, decay) / fast
    top = run.peak("x")
    expected = np.exp(-decay * t) * np.sin(fast * t) / fast
    assert abs(top.value - expected) <= top.error < 1e-9
    assert abs(top.t - t) < 1e-4
    slowest, force, other = run.peak(["x_ddot", lambda r: 2 * r.state[:, 0], "x_dot"])
    assert abs(force.value - 2 * expected) < 1e-9
    assert abs(other.value - 1) < 1e-12
    assert other.t < 1e-12
    kept = run.acceleration[:, 0]
    assert abs(slowest.value) >= np.abs(kept).max()


@pytest.mark.parametrize("case", FAMILY)
def test_peaks_of_every_kind_of_system(case):
    """The motion has the value at its time, and no larger one at many other times."""
    system, given = FAMILY[case]()
    run = vv.simulate(system, 5, **given, times=np.linspace(0, 5, 401))
    names = [f"{name}{dot}" for name in run.dof_names for dot in ("", "_dot", "_ddot")]
    found = run.peak(names)
    times = np.unique([*np.linspace(0, 5, 1501), *(one.t for one in found)])
    dense = vv.simulate(system, 5, **given, times=times)
    many = np.stack([dense.state[:, ::2], dense.state[:, 1::2], dense.acceleration], axis=2)
    for one, values in zip(found, many.reshape(times.size, -1).T, strict=True):
        largest = np.abs(values).max()
        assert abs(one.value) > largest - one.error - 1e-9 * largest, one
        if case == "friction" and one.name == "x_ddot":
            # It jumps, and the peak is on one side.
            continue
        assert one.error < 2e-9 * largest, one
        assert abs(values[np.searchsorted(times, one.t)] - one.value) < one.error + 1e-9 * largest


def test_peaks_of_mounts_in_one_pass_and_names_that_are_not_there():
    body = stiff_feet("small", PRONY, None)
    shock = vv.LoadTable.half_sine(body.load((3, 0, 20)).real, 0.11)
    run = vv.simulate(body, 1.0, force=shock)
    found = run.peak(["foot0.z", "foot2.x", "floor.z", "z_ddot"])
    dense = vv.simulate(body, 1.0, force=shock, times=np.linspace(0, 1, 20001))
    forces = dense.mount_forces().force
    dense_peaks = [
        np.abs(forces[:, 0, 2]).max(), np.abs(forces[:, 2, 0]).max(),
        np.abs(dense.floor_force().force[:, 2]).max(), np.abs(dense.acceleration[:, 2]).max(),
    ]  # fmt: skip
    for one, largest in zip(found, dense_peaks, strict=True):
        assert abs(abs(one.value) - largest) < 1e-6 * largest + one.error
    with pytest.raises(vv.InputError, match=r"quantity = 'foot9.z': .*did you mean 'foot"):
        run.peak("foot9.z")
    with pytest.raises(vv.InputError, match=r"point = 'fot1': .*did you mean 'foot1'"):
        run.motion_of("fot1")
    with pytest.raises(vv.InputError, match=r"point: must have shape \(3,\)"):
        run.motion_of((1, 2))
    with pytest.raises(vv.InputError, match="element_forces: a Body has mounts"):
        run.element_forces()
    with pytest.raises(vv.InputError, match=r"must return shape"):
        run.peak(lambda r: r.state)
    other = vv.simulate(mount(), 1, dt=0.1)
    with pytest.raises(vv.InputError, match=r"motion_of: is for motions of a Body"):
        other.motion_of((0, 0, 0))
    with pytest.raises(vv.InputError, match=r"mount_forces: is for motions of a Body"):
        other.mount_forces()


def test_pictures_and_tables_of_forces():
    import matplotlib.pyplot as plt

    body = stiff_feet("small", None, None)
    run = vv.simulate(body, 0.5, initial=[0.01, 0] * 6, dt=0.01)
    assert len(run.mount_forces().plot()) == 4
    assert len(run.floor_force().plot()) == 6
    assert len(run.motion_of("foot0").plot()) == 3
    system = chain(vv.Spring(on="x1", stiffness=1.0))
    forces = vv.simulate(system, 2, initial=[0.1] * 6, dt=0.1).element_forces()
    assert len(forces.plot()) == 1
    plt.close("all")
    data = run.mount_forces().to_dataset()
    assert data.force.sel(mount="foot1", axis="z").shape == (run.t.size,)
    assert data.force.attrs["units"] == "N"
    assert forces.to_dataset().elastic.dims == ("t", "element")
