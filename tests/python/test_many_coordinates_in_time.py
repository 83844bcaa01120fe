"""Kinks, friction, hysteresis and rigid stops in structures of more than six coordinates."""

import numpy as np
import pytest
import viscovib as vv
from referee.switched import Automaton, Contact, Sliders

#: A chain connected to the ground at both ends.
N = 9


def chain(n, *elements, mass=None):
    """A chain of masses with elements."""
    k = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    mass = np.ones(n) if mass is None else mass
    c = 0.02 * k * np.outer(mass > 0, mass > 0)
    return vv.Structure(mass=mass, stiffness=k, damping=c, elements=list(elements))


def push(n):
    """Amplitudes of a load at both ends."""
    return np.array([0.8, *[0.0] * (n - 2), 0.4])


def slider():
    return vv.Jenkins(on={"x2": 1, "x3": -1}, stiffness=3, limit=0.1)


@pytest.mark.parametrize("n", [N, 80])
def test_against_scipy_from_switch_to_switch(n):
    """A slider and a gap, to 1e-11 with steps of a tenth of the load period."""
    structure = chain(n, slider(), vv.Gap(on=f"x{n}", stiffness=20, gap=0.1))
    times, nothing = np.linspace(0, 8, 5), np.zeros(n)
    axes, names = np.eye(n), [f"x{i + 1}" for i in range(n)]
    drawn = [Sliders(axes[1] - axes[2], [3.0], [0.1]), Contact(axes[-1], 20.0, 0.1, False)]
    k = structure.stiffness
    judge = Automaton(
        np.ones(n), k, 0.02 * k, lambda t: push(n) * np.sin(0.7 * t), drawn, [None] * n, [None] * n
    )
    true = judge.run(nothing, nothing, times)
    for given in ({"dt": 1.0}, {"dt": 0.3}, {"tolerance": 1e-9}):
        run = vv.simulate(
            structure, 8, load=push(n), nu=0.7, times=times, coordinates=names, **given
        )
        assert run.outcome == "completed"
        np.testing.assert_allclose(run.state, true, atol=1e-11)


@pytest.mark.parametrize("n", [7, N, 70])
def test_polynomial_systems_end_steps_there_too(n):
    """The same equations and steps as a structure, also with a kernel and a base."""
    k = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    law = "5*max({} - 0.1, 0) + 0.05*sign({})"
    forces = ["0"] * n
    forces[1] = law.format("x2", "x2_dot")
    given = {"mass": np.ones(n), "stiffness": k, "damping": 0.02 * k}
    system = vv.PolynomialSystem(**given, forces=forces, base_direction=np.ones(n))
    element = vv.Spring(on="x2", law=law.format("d", "v"))
    structure = vv.Structure(**given, elements=[element], base_direction=np.ones(n))
    names = [f"x{i + 1}" for i in range(n)]
    for acting in ({"load": push(n)}, {"base": 0.3}):
        run = vv.simulate(system, 6, nu=0.7, tolerance=1e-10, **acting)
        other = vv.simulate(structure, 6, nu=0.7, times=run.t, coordinates=names, dt=0.3, **acting)
        assert run.outcome == other.outcome == "completed"
        np.testing.assert_allclose(run.state, other.state, atol=1e-10)


#: Elements on the first three coordinates, one case each.
SLIDER = 'vv.Jenkins(on="x2", stiffness=3, limit=0.1)'
STICKS = "vv.Spring(on='x2', law='0.2*sign(v)')"
PARTS = {
    "kink": 'vv.Spring(on="x2", law="5*max(d - 0.1, 0) + d*abs(v)")',
    "sticks": STICKS,
    "Iwan": 'vv.Iwan(on={"x1": 1, "x3": -1}, stiffness=[2, 3], limit=[0.1, 0.3])',
    "BoucWen": 'vv.BoucWen(on="x2", stiffness=3, ratio=0.1, beta=5, gamma=2, exponent=1.5)',
    "Dahl": 'vv.Dahl(on="x2", stiffness=3, limit=0.2)',
    "stop": 'vv.Stop(on="x2", gap=0.1, restitution=0.6)',
    "stop and slider": f'vv.Stop(on="x1", gap=0.1, restitution=0), {SLIDER}',
}


def test_friction_and_a_slider_that_switch_at_once_are_refused():
    """Two runs could agree by chance; on separate deflections they cannot."""
    sticks = vv.Spring(on="x2", law="0.2*sign(v)")
    with pytest.raises(vv.InputError, match="takes no law that switches"):
        vv.simulate(
            chain(N, vv.Jenkins(on="x2", stiffness=3, limit=0.1), sticks), 1, load=push(N), nu=0.7
        )
    run = vv.simulate(chain(N, slider(), sticks), 1, load=push(N), nu=0.7)
    assert run.outcome == "completed"


@pytest.mark.parametrize("name", PARTS)
def test_a_part_that_stands_alone_moves_as_by_itself(name):
    """Three masses with six uncoupled masses, compared with the three masses alone."""
    elements = eval(f"[{PARTS[name]}]")
    alone = chain(3, *elements)
    n = 3 + N
    k, mass = np.zeros((n, n)), 1 + 0.1 * np.arange(n)
    k[:3, :3], k[3:, 3:] = alone.stiffness, chain(N).stiffness
    mass[:3] = 1.0
    both = vv.Structure(mass=mass, stiffness=k, damping=0.02 * k, elements=elements)
    load = np.r_[1.2, 0.3, -0.7, push(N)]
    one = vv.simulate(alone, 20, load=load[:3], nu=0.9, dt=0.1)
    other = vv.simulate(both, 20, load=load, nu=0.9, dt=0.25, times=one.t[::10])
    assert other.outcome == one.outcome == "completed"
    np.testing.assert_allclose(other.state[:, :6], one.state[::10], atol=1e-10)


def test_infinitely_many_impacts_end():
    """Rounding errors of many modes must not keep a mass bouncing on a stop."""
    for n in (7, 8, 10, 20, 90):
        structure = chain(n, vv.Gap(on=f"x{n}", gap=0.1, restitution=0.5))
        run = vv.simulate(structure, 60, load=push(n), nu=0.7, dt=0.2)
        assert run.outcome == "completed"
        assert run.deflections.max() < 0.1 + 1e-14


def test_goes_on_and_in_ensembles():
    """Bitwise equal to the uninterrupted run; also in an ensemble; with events."""
    structure = chain(N, slider(), vv.Stop(on=f"x{N}", gap=0.1, restitution=0.5))
    given = {"load": push(N), "nu": 0.7, "dt": 0.2}
    run = vv.simulate(structure, 12, events=["x3"], **given)
    whole = vv.simulate(structure, 12, resume=vv.simulate(structure, 6, **given))
    np.testing.assert_array_equal(whole.state[-1], run.state[-1])
    many = vv.simulate_ensemble(structure, initial=np.zeros((2, 2 * N)), t_end=12, **given)
    np.testing.assert_array_equal(many.state[1], run.state[-1])
    assert np.abs(run.events[0].state[:, 4]).max() < 1e-13


def test_stiff_modes_need_no_steps():
    """A beam of ten elements; its fastest mode has 47 periods per step."""
    m, length = 10, 0.1
    k, mass = np.zeros((2 * m + 2, 2 * m + 2)), np.zeros((2 * m + 2, 2 * m + 2))
    s = length
    own = np.array([[12, 6 * s, -12, 6 * s], [6 * s, 4 * s**2, -6 * s, 2 * s**2],
                    [-12, -6 * s, 12, -6 * s], [6 * s, 2 * s**2, -6 * s, 4 * s**2]])  # fmt: skip
    heavy = np.array(
        [
            [156, 22 * s, 54, -13 * s],
            [22 * s, 4 * s**2, 13 * s, -3 * s**2],
            [54, 13 * s, 156, -22 * s],
            [-13 * s, -3 * s**2, -22 * s, 4 * s**2],
        ]
    )
    for i in range(m):
        at = np.ix_(range(2 * i, 2 * i + 4), range(2 * i, 2 * i + 4))
        k[at] += own / s**3
        mass[at] += heavy * s / 420
    k, mass = k[2:, 2:], mass[2:, 2:]
    tip = f"x{2 * m - 1}"
    beam = vv.Structure(
        mass=mass, stiffness=k, damping=1e-3 * k,
        elements=[vv.Jenkins(on=tip, stiffness=4.0, limit=0.05)],
    )  # fmt: skip
    load = np.zeros(2 * m)
    load[-2] = 0.4
    fastest = np.sqrt(np.linalg.eigvals(np.linalg.solve(mass, k)).real.max())
    run = vv.simulate(beam, 6, load=load, nu=2.0, dt=0.05, estimate_error=True)
    assert 0.05 * fastest > 47 * 2 * np.pi
    assert run.error < 1e-6
    fine = vv.simulate(beam, 6, load=load, nu=2.0, dt=0.005)
    np.testing.assert_allclose(run.state, fine.state[::10], atol=2 * run.error)
    np.testing.assert_allclose(run.state[:, ::2], fine.state[::10, ::2], atol=1e-8)


def test_what_is_refused_says_why():
    """Other methods; more coordinates; masses of 0 with kinked laws."""
    with pytest.raises(vv.InputError, match="has the methods auto, gauss8, gauss2, gauss3"):
        vv.simulate(chain(N, slider()), 1, load=push(N), nu=0.7, method="rk4")
    with pytest.raises(vv.InputError, match="at most 512 coordinates, has 513"):
        vv.simulate(chain(513, slider()), 1, load=push(513), nu=0.7)
    light = np.r_[0.0, np.ones(N - 1)]
    with pytest.raises(vv.InputError, match="all of whose coordinates have mass"):
        vv.simulate(chain(N, slider(), mass=light), 1, load=push(N), nu=0.7)
    run = vv.simulate(chain(N, slider()), 1, load=push(N), nu=0.7, dt=0.1, coordinates=["x1"])
    assert run.state.shape == (11, 2)
    kink = vv.Spring(on="x2", law="max(d, 0)")
    run = vv.simulate(chain(N, kink, mass=light), 1, load=push(N), nu=0.7, dt=0.1)
    assert run.outcome == "completed"
    run = vv.simulate(chain(N, kink), 1, load=push(N), nu=0.7, dt=0.1, coordinates=["x1"])
    assert run.state.shape == (11, 2)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("kind", ["Dahl", "BoucWen"])
def test_errors_with_elements_that_settle_fast_are_reported(kind, seed):
    """Parts between reversals were equal in two runs; powers have errors of 1e-9 at state 0."""
    rng = np.random.default_rng(seed)
    stiffness = rng.uniform(2, 10)
    element = vv.Dahl(on="x2", stiffness=stiffness, limit=rng.uniform(0.05, 0.4), exponent=2)
    if kind == "BoucWen":
        element = vv.BoucWen(on="x2", stiffness=stiffness, ratio=0.2, beta=rng.uniform(2, 40),
                             gamma=rng.uniform(0, 2), exponent=1.5)  # fmt: skip
    structure = vv.Structure(
        mass=[1.2, 2.5], stiffness=[[2.5, -1.2], [-1.2, 1.7]], damping=[0.03, 0.07],
        elements=[element, vv.Spring(on="x1", law="0.8*max(d - 0.15, 0)")],
    )  # fmt: skip
    given = {
        "load": {0: [0.5j, 0.9j], 1: [0.5, 0.5], 2: [0.2, 0.3]}, "nu": 1.2,
        "initial": [0.09, 0.18, -0.13, 0.3], "times": np.linspace(0, 9, 8 + seed),
    }  # fmt: skip
    fine = vv.simulate(structure, 9.0, dt=0.01, **given)
    run = vv.simulate(structure, 9.0, tolerance=1e-6, **given)
    assert np.abs(run.state - fine.state).max() <= 2 * max(run.error, 1e-13)
