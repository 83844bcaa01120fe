"""Accelerations along motions in time, by the equations of motion."""

import pickle

import numpy as np
import pytest
import viscovib as vv
from scipy.integrate import solve_ivp

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
def test_accelerations_with_memory_beside_exponentials_as_states(seed):
    """M a = load - C v - sum of (1 - R*) g, each exponential a state of an independent solver."""
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
    """Of every kind of system: differences of order 8, but for those across a jump."""
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


def test_accelerations_of_runs_that_go_on():
    """After other loads, from a pickle and for a last state alone they are those of one run."""
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
    # The load jumps where the other one begins.
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
    """A coordinate without mass follows its forces: the equations do not contain its rate."""
    light = vv.Structure(mass=np.diag([1.0, 0.0]), stiffness=[[2.0, -1], [-1, 2]])
    run = vv.simulate(light, 2, initial=[1, 0, 0.5, 0])
    with pytest.raises(vv.InputError, match="all of whose coordinates have mass"):
        _ = run.acceleration
