"""Motions of structures in time, against the full systems and SciPy."""

import pickle
import re

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp
from scipy.linalg import eigh, expm

PRONY = vv.PronyKernel(weights=[0.1, 0.3], rates=[0.5, 3.0])
SINGULAR = vv.RzhanitsynKernel(amplitude=0.1, alpha=0.3, beta=0.2)


def chain(n: int) -> np.ndarray:
    return 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)


def pair(n, kernel, damping, base=None):
    """A chain with two elements, as a structure and as a polynomial system."""
    stiffness = chain(n)
    ends = np.zeros((n, n))
    ends[-1, -1] = 0.7
    common = {
        "mass": np.ones(n),
        "stiffness": stiffness,
        "damping": damping,
        "base_direction": base,
    }
    structure = vv.Structure(
        **common,
        elements=[
            vv.Spring(on=f"x{n}", stiffness=0.7, law="0.5*d^3", kernel=kernel),
            vv.Spring(on=("x1", "x3"), law="0.2*d^2 + 0.3*d^3"),
        ],
    )
    d = "(x1 - x3)"
    law = f"0.2*{d}^2 + 0.3*{d}^3"
    whole = vv.PolynomialSystem(
        **common,
        forces={"x1": law, "x3": f"-({law})"},
        springs=[vv.Springs(stiffness=ends, forces={f"x{n}": f"0.5*x{n}^3"}, kernel=kernel)],
    )
    return structure, whole


def cases(n):
    rng = np.random.default_rng(n)
    load = np.zeros(n)
    load[0], load[3] = 0.5, 0.2
    start = 0.3 * rng.normal(size=2 * n)
    table = vv.LoadTable(times=[0, 1.03, 2.5, 4.7], values=rng.normal(size=(4, n)))
    past = vv.Past(times=[-3, -1, 0], displacements=0.2 * rng.normal(size=(3, n)))
    return {
        "two orders from rest": {"load": {1: load, 3: 0.3 * load}, "nu": 0.7},
        "a jump of the load": {"load": {0: 0.2j * load, 1: 1j * load}, "nu": 0.7, "initial": start},
        "free": {"initial": start},
        "table": {"force": table},
        "held": {"held": past},
        "base": {"base": {1: 0.3, 2: 0.1j}, "nu": 0.9},
        "base by a table": {
            "base": vv.LoadTable(times=[0, 1.03, 2.5, 4.7], values=[0.1, 1, 1, 0.3]),
            "initial": start,
        },
    }


@pytest.mark.parametrize(
    ("case", "kernel", "damping"),
    [
        (case, (None, PRONY, SINGULAR)[i % 3], ("modal", "not modal")[i // 3 % 2])
        for i, case in enumerate(cases(8))
    ],
    ids=list(cases(8)),
)
def test_as_the_whole_system(kernel, damping, case):
    n = 8
    matrix = 0.03 * np.eye(n) if damping == "modal" else 0.02 * chain(n)
    structure, whole = pair(n, kernel, matrix, np.ones(n))
    if case == "held" and kernel is None:
        pytest.skip("nothing remembers")
    options = cases(n)[case]
    got = vv.simulate(structure, 6.0, dt=0.25, **options)
    wanted = vv.simulate(whole, 6.0, dt=0.0625, save_every=4, **options)
    assert got.outcome == "completed"
    assert got.dof_names == wanted.dof_names
    # Tables cause larger motions, with errors of 2e-11 for steps of 1/4 (4e-14 for 1/8).
    allowed = 1e-10 if "table" in case else 2e-12
    assert np.abs(got.state - wanted.state).max() < allowed
    at = np.array([0.0, 0.1, 1.03, 2.2345, 5.9])
    inside = vv.simulate(structure, 6.0, dt=0.25, times=at, **options)
    between = vv.simulate(whole, 6.0, dt=0.0625, times=at, **options)
    assert np.abs(inside.state - between.state).max() < allowed


@pytest.mark.parametrize(("method", "order"), [("gauss2", 4), ("gauss3", 6), ("gauss4", 8)])
def test_order(method, order):
    structure, _ = pair(8, None, None)
    start = 0.5 * np.random.default_rng(1).normal(size=16)
    exact = vv.simulate(structure, 4.0, dt=0.02, initial=start, keep="last").state
    errors = [
        np.abs(
            vv.simulate(
                structure, 4.0, dt=h, initial=start, keep="last", method=method
            ).state - exact
        ).max()
        for h in (0.5, 0.25)
    ]  # fmt: skip
    assert np.log2(errors[0] / errors[1]) > order - 0.6


@pytest.mark.parametrize("method", ["gauss3", "gauss4", "gauss6"])
def test_a_singular_start_by_any_method(method):
    """The panels of a start have separate nodes, different from those of later steps."""
    structure, whole = pair(8, PRONY, None)
    options = {"load": 1j * np.eye(8)[0], "nu": 0.4}
    got = vv.simulate(structure, 3.0, dt=0.05, method=method, keep="last", **options)
    wanted = vv.simulate(whole, 3.0, dt=0.05, keep="last", **options)
    assert np.abs(got.state - wanted.state).max() < 1e-10


def test_energy_of_a_long_run():
    """An undamped chain with cubic springs keeps its energy, for long runs and stiff springs."""
    n = 40
    rng = np.random.default_rng(2)
    stiffness = np.diag(10.0 ** rng.uniform(-1, 6, n)) + chain(n)
    structure = vv.Structure(
        mass=np.ones(n), stiffness=stiffness, elements=[vv.Spring(on="x1", law="0.3*d^3")]
    )
    start = np.zeros(2 * n)
    start[0], start[1] = 1.0, 0.5
    run = vv.simulate(structure, 2000.0, dt=0.1, initial=start, save_every=100)
    u, v = run.state[:, ::2], run.state[:, 1::2]
    energy = 0.5 * (v**2).sum(axis=1) + 0.5 * np.einsum("ta,ab,tb->t", u, stiffness, u)
    energy += 0.3 / 4 * u[:, 0] ** 4
    assert np.abs(energy / energy[0] - 1).max() < 1e-11


def test_linear_structure_is_exact_at_any_step():
    rng = np.random.default_rng(3)
    n = 5
    stiffness = np.diag(10.0 ** np.arange(n)) + 0.1 * chain(n)
    structure = vv.Structure(mass=np.ones(n), stiffness=stiffness, damping=0.1 * np.eye(n))
    start = rng.normal(size=2 * n)
    matrix = np.zeros((2 * n, 2 * n))
    matrix[:n, n:], matrix[n:, :n], matrix[n:, n:] = np.eye(n), -stiffness, -0.1 * np.eye(n)
    wanted = expm(7.0 * matrix) @ np.concatenate([start[::2], start[1::2]])
    got = vv.simulate(structure, 7.0, dt=3.5, initial=start, keep="last").state[0]
    assert np.abs(got[::2] - wanted[:n]).max() < 1e-12
    assert np.abs(got[1::2] - wanted[n:]).max() < 1e-10


@pytest.mark.parametrize("kernel", [None, PRONY, SINGULAR], ids=["none", "prony", "singular"])
@pytest.mark.parametrize("damping", [0.03 * np.eye(8), 0.02 * chain(8)], ids=["modal", "not"])
def test_goes_on_bit_for_bit(kernel, damping):
    structure, whole = pair(8, kernel, damping)
    options = cases(8)["a jump of the load"]
    once = vv.simulate(structure, 10.0, dt=0.25, tolerance=1e-12, **options)
    half = vv.simulate(structure, 5.0, dt=0.25, tolerance=1e-12, **options)
    twice = vv.simulate(structure, 10.0, resume=half)
    if kernel is not SINGULAR:  # exponentials are fitted to the length of a run
        assert np.array_equal(once.state[-1], twice.state[-1])
    assert np.abs(once.state[-1] - twice.state[-1]).max() < 1e-11
    other = vv.simulate(structure, 10.0, resume=half, load=np.eye(8)[2], nu=1.3)
    before = vv.simulate(whole, 5.0, dt=0.0625, **options)
    wanted = vv.simulate(whole, 10.0, resume=before, load=np.eye(8)[2], nu=1.3)
    assert np.abs(other.state[-1] - wanted.state[-1]).max() < 1e-10


def test_the_first_trace_of_a_wave_is_no_escape():
    """Far from the load deflections grow as powers of time, which is no escape."""
    n = 200
    structure = vv.Structure(
        mass=np.ones(n), stiffness=chain(n), elements=[vv.Spring(on=f"x{n}", law="0.5*d^3")]
    )
    run = vv.simulate(structure, 60.0, dt=0.5, load=np.eye(n)[0], nu=0.7, coordinates=["x1"])
    assert 0 < np.abs(run.deflections).max() < 1e-12
    assert run.stats["iterations"] < 3 * run.stats["steps"]


def test_only_wanted_coordinates_are_kept():
    structure, _ = pair(8, None, None)
    run = vv.simulate(structure, 40.0, load=np.eye(8)[0], nu=0.5, coordinates=["x4", "x8"], dt=0.25)
    assert run.dof_names == ("x4", "x8")
    assert run.state.shape == (161, 4)
    assert run.deflections.shape == (161, 2)
    assert np.allclose(run.deflections[:, 0], run.coordinate("x8"), atol=1e-14)
    assert vv.spectrum(run, coordinates="x4").omega.size
    data = run.to_dataset()
    assert "x8_dot" in data
    assert list(data.element.values) == list(structure.deflections)
    assert np.array_equal(data.deflections, run.deflections)
    assert len(run.plot()) == 4
    assert np.array_equal(pickle.loads(pickle.dumps(run)).deflections, run.deflections)
    assert "modes exactly" in str(run.plan)


def test_escape_of_a_soft_spring_is_reported():
    structure = vv.Structure(
        mass=np.ones(3), stiffness=chain(3), elements=[vv.Spring(on="x2", law="-d^3")]
    )
    run = vv.simulate(structure, 50.0, dt=0.1, initial=[0, 0, 3.0, 0, 0, 0])
    assert run.outcome == "diverged"

    def rhs(t, y):
        return np.concatenate([y[3:], -chain(3) @ y[:3] + np.array([0, y[1] ** 3, 0])])

    far = solve_ivp(
        rhs, (0, 2), [0, 3.0, 0, 0, 0, 0], rtol=1e-12, atol=1e-12, method="DOP853",
        events=_terminal(lambda t, y: abs(y[1]) - 1e6),
    ).t[-1]  # fmt: skip
    assert abs(run.t_reached - far) < 1e-5


def _terminal(event):
    event.terminal = True
    return event


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"coordinates": ["y"]}, "coordinates: 'y' must be one of the 8"),
        ({"initial": [1.0]}, r"initial: must have shape \(16,\)"),
        ({"base": 0.1, "nu": 1.0}, "base: this system has no base_direction"),
        ({"nu": 1.0}, "nu: must not be given without load or base"),
        ({"load": np.ones(8)}, "nu: must be given with a load"),
        ({"method": "rk4"}, "method = 'rk4'"),
        ({"dt": 2.0, "t_end": 1.0}, "dt = 2"),
        ({"force": 3.0}, "force = 3.0: must be a LoadTable"),
    ],
)
def test_bad_input(options, words):
    structure, _ = pair(8, None, None)
    end = options.pop("t_end", 10.0)
    with pytest.raises(vv.InputError, match=words):
        vv.simulate(structure, end, **options)


def test_a_loss_factor_has_no_meaning_in_time():
    structure = vv.Structure(mass=np.ones(3), stiffness=chain(3), loss_factor=0.1)
    with pytest.raises(vv.InputError, match="loss_factor: has no meaning in time"):
        vv.simulate(structure, 1.0)


def test_the_end_asked_for_is_inside_the_run():
    """The number of steps times the step size may end a rounding error before it."""
    stiffness = np.array([[3.0, -1], [-1, 2]])
    system = vv.Structure(
        mass=np.eye(2), stiffness=stiffness, damping=0.02 * stiffness,
        elements=[vv.Spring(on="x1", law="0.4*d^3")],
    )  # fmt: skip
    for end in (7.3, 30, 50):
        run = vv.simulate(
            system, end, initial=[0.2, 0, 0.1, 0], load={"x1": 0.3}, nu=0.9, tolerance=1e-8
        )
        assert run(end) == pytest.approx(run.state[-1], abs=1e-12)
        with pytest.raises(vv.InputError, match="must be in"):
            run(end * (1 + 1e-9))


@pytest.mark.parametrize("n", [65, 80])
def test_a_large_structure_that_only_its_start_moves(n):
    """Without load and elements the default coordinate is the first, as in the driver."""
    system = vv.Structure(mass=np.ones(n), stiffness=chain(n))
    run = vv.simulate(system, 10.0, initial=[0.1, 0] * n, tolerance=1e-9, keep="last")
    flow = expm(10 * np.block([[np.zeros((n, n)), np.eye(n)], [-chain(n), np.zeros((n, n))]]))
    assert run.dof_names == ("x1",)
    assert run.state[-1, 0] == pytest.approx(0.1 * flow[0, :n].sum(), abs=1e-13)
    every = vv.simulate(
        system, 10.0, initial=[0.1, 0] * n, tolerance=1e-9, coordinates=system.dof_names[:3]
    )
    assert every.state[-1, 0] == pytest.approx(run.state[-1, 0], abs=1e-14)


DAMPED = {
    "modal, dampers": {"damping": np.diag([0.1, 0.02, 0.3]), "modal_damping": 0.05},
    "Rayleigh, dampers": {"damping": np.diag([0.1, 0.02, 0.3]), "rayleigh": (0.05, 0.02)},
    "modal, layer": {"modal_damping": 0.05},
    "Rayleigh, layer": {"rayleigh": (0.05, 0.02)},
    "Rayleigh, coupling layer": {"rayleigh": (0.05, 0.02)},
}


@pytest.mark.parametrize("reduced", [False, True])
@pytest.mark.parametrize("kind", DAMPED)
def test_a_start_is_resisted_by_all_damping(kind, reduced):
    """States of complex modes need C u, including modal and Rayleigh damping."""
    n, t, weight, rate = 3, 4.0, 0.3, 1.5
    mass = np.array([1, 1.3, 0.8])
    stiffness = np.array([[3.0, -1, 0], [-1, 2.5, -1], [0, -1, 2]])
    start = np.array([0.3, 0.1, -0.2, 0.2, 0.5, -0.1])
    layer = np.zeros((n, n))
    if "layer" in kind:
        layer = np.diag([0, 0, 0.8]) if "coupling" in kind else 0.5 * stiffness
    given = dict(DAMPED[kind])
    damping = given.get("damping", np.zeros((n, n)))
    squares, shapes = eigh(stiffness + layer, np.diag(mass))
    pushed = mass[:, np.newaxis] * shapes
    damping = damping + (pushed * (2 * given.get("modal_damping", 0) * np.sqrt(squares))) @ pushed.T
    a, b = given.get("rayleigh", (0, 0))
    damping = damping + a * np.diag(mass) + b * (stiffness + layer)
    if "layer" in kind:
        kernel = vv.PronyKernel(weights=[weight], rates=[rate])
        given["layers"] = [(layer, kernel)]
    structure = vv.Structure(mass=np.diag(mass), stiffness=stiffness, **given)
    if reduced:
        structure = structure.reduce(frequency=10.0, loads=["x1"])
    run = vv.simulate(structure, t, initial=start, times=[t])
    rates = np.zeros((3 * n, 3 * n))
    rates[:n, n : 2 * n], rates[2 * n :, :n] = np.eye(n), weight * np.eye(n)
    rates[2 * n :, 2 * n :] = -rate * np.eye(n)
    sides = [-stiffness - layer, -damping, layer]
    rates[n : 2 * n] = np.concatenate(sides, axis=1) / mass[:, np.newaxis]
    true = expm(t * rates) @ [*start[::2], *start[1::2], *np.zeros(n)]
    assert run.state[0] == pytest.approx(list(true[: 2 * n].reshape(2, n).T.ravel()), abs=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_rayleigh_damping_of_an_unsymmetric_stiffness(seed):
    """In all coordinates, as a structure with a contact is computed, it is a M + b K."""
    rng = np.random.default_rng([31, seed])
    mass, stiffness = np.diag(rng.uniform(1, 2, 3)), np.diag(rng.uniform(5, 9, 3))
    stiffness[0, 1], stiffness[1, 0] = rng.uniform(-2, 2, 2)
    a, b = rng.uniform(0.02, 0.1, 2).tolist()
    gap = vv.Gap(on="x1", stiffness=10, gap=0.05)
    one, other = (
        vv.simulate(
            vv.Structure(mass=mass, stiffness=stiffness, elements=[gap], **damping),
            5, load={"x1": 1.0}, nu=2.0, tolerance=1e-10,
        ).state[-1]
        for damping in ({"rayleigh": (a, b)}, {"damping": a * mass + b * stiffness})
    )  # fmt: skip
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-10)
    assert np.abs(one[2:4]).max() > 1e-3


#: Laws of a mass on a deflection: smooth, steep, strong dampers, thin friction, self-excitation.
LAWS = [
    "0.5*d^3", "1.3*sin(d)", "0.8*tanh(d/0.05)", "0.3*tanh(v)", "0.2*tanh(v/0.001)", "300*v^3",
    "1e4*tanh(v)", "(1 + d^2)*1e4*v", "2e4*v*sqrt(1 + v^2)", "20*(d^2 - 1)*v + 0.3*d^3",
]  # fmt: skip


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("remembers", [False, True])
def test_both_constructors_go_by_the_same_equations(law, remembers):
    """A system costs as many steps as a polynomial system and as a structure."""
    rng = np.random.default_rng([len(law), int(remembers)])
    n = int(rng.integers(1, 4))
    stiffness = chain(n) * rng.uniform(0.5, 2)
    damping, mass = 0.05 * stiffness, rng.uniform(0.5, 2, n)
    start = rng.uniform(-0.6, 0.6, 2 * n)
    kernel = vv.PronyKernel(weights=[0.2], rates=[1.0]) if remembers else None
    own = np.zeros((n, n))
    own[0, 0] = 0.5
    names = [f"x{i + 1}" for i in range(n)]
    force = re.sub(r"\bv\b", "x1_dot", re.sub(r"\bd\b", "x1", law))
    springs = [
        vv.Springs(stiffness=stiffness, forces={"x1": force}),
        vv.Springs(stiffness=own, kernel=kernel),
    ]
    polynomial = vv.PolynomialSystem(
        mass=np.diag(mass), damping=damping, springs=springs, names=names
    )
    elements = [vv.Spring(on="x1", law=law), vv.Spring(on="x1", stiffness=0.5, kernel=kernel)]
    structure = vv.Structure(
        mass=np.diag(mass), stiffness=stiffness, damping=damping, elements=elements
    )
    given = {"load": rng.uniform(-0.4, 0.4, n), "nu": 1.3, "initial": start, "keep": "last"}
    runs = [vv.simulate(one, 20.0, **given) for one in (polynomial, structure)]
    one, other = runs
    assert one.stats["steps"] == other.stats["steps"]
    work = [max(value for name, value in run.stats.items() if name != "steps") for run in runs]
    assert work[0] == pytest.approx(work[1], rel=0.05)
    assert np.abs(one.state - other.state).max() <= 1e-9 * np.abs(one.state).max()
