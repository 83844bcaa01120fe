"""Maxwell elements with a nonlinear damper: SciPy with the deflection of the spring as a state."""

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp
from scene_texts import columns_of
from scipy.sparse import csc_array

ROOT = Path(__file__).parents[2]
SOLVE = os.environ.get("VISCOVIB_SOLVE", ROOT / "build" / "release" / "fortran" / "viscovib-solve")
REFERENCE = next(
    one["value"]
    for one in json.loads((ROOT / "data" / "fluid_dampers.json").read_text())
    if one["name"] == "maxwell_nonlinear"
)


@pytest.mark.parametrize("a", [0.5, 0.35])
def test_published_values(a):
    element = vv.Maxwell(on="x1", stiffness=80, coefficient=2, exponent=a)
    system = vv.Structure(mass=[1.0], stiffness=[20.0], elements=[element])
    shock = vv.HalfSine(amplitude=[4.0, 0.0], duration=0.5)
    run = vv.simulate(system, 3, force=shock, tolerance=1e-11)
    wanted = np.array(REFERENCE[f"maxwell_nonlinear_alpha_{a}"]["state_at_3"])
    forces = run.element_forces()
    assert forces.names == ("x1",)
    found = [*run.state[-1, :2], forces.force[-1, 0] / 80]
    assert np.abs(found - wanted).max() < 1e-12
    # The work of the load is stored in the mass and its spring, or done on the element.
    stored = 0.5 * run.state[-1, 1] ** 2 + 10 * run.state[-1, 0] ** 2
    work = np.trapezoid(forces.force[:, 0] * run.state[:, 1], run.t)
    assert work == pytest.approx(
        4 * np.trapezoid(np.sin(np.pi * run.t / 0.5) * (run.t <= 0.5) * run.state[:, 1], run.t)
        - stored,
        rel=0.02,
    )


class Random:
    """Masses with a Maxwell element, a stop in some cases, and their equations."""

    def __init__(self, seed, exponents=(1.0, 0.8, 0.5, 0.35)):
        rng = np.random.default_rng(seed)
        self.n = n = int(rng.integers(1, 4))
        self.mass, self.c = rng.uniform(0.5, 3, n), rng.uniform(1.5, 3, n)
        self.k = np.diag(rng.uniform(5, 30, n))
        for i in range(n - 1):
            pair = np.eye(n)[i] - np.eye(n)[i + 1]
            self.k = self.k + rng.uniform(2, 20) * np.outer(pair, pair)
        self.e = rng.normal(size=n)
        self.stiffness, self.coefficient = rng.uniform(5, 60), rng.uniform(0.5, 8)
        self.a = exponents[seed % len(exponents)]
        self.gap = 0.1 if seed % 3 == 0 else np.inf
        self.load, self.mean = rng.uniform(0.5, 3, n), rng.uniform(0, 1) * (seed % 2)
        self.nu = rng.uniform(2, 6)
        self.element = vv.Maxwell(
            on=self.e, stiffness=self.stiffness, coefficient=self.coefficient, exponent=self.a
        )
        elements = [self.element]
        if np.isfinite(self.gap):
            elements.append(vv.Gap(on=np.eye(n)[0], stiffness=10, gap=self.gap))
        self.given = {"mass": self.mass, "stiffness": self.k, "damping": self.c}
        self.elements = elements
        self.system = vv.Structure(**self.given, elements=elements)
        zero = np.zeros(1)
        self.loads = {
            0: np.concatenate([1j * self.mean * self.load, zero]),
            1: np.concatenate([self.load, zero]),
        }

    def rates(self, t, y):
        n = self.n
        u, v, q = y[:n], y[n : 2 * n], y[2 * n]
        f = self.stiffness * q
        pull = self.load * (self.mean + np.sin(self.nu * t)) - self.k @ u - self.c * v - self.e * f
        if np.isfinite(self.gap):
            pull[0] -= 10 * max(u[0] - self.gap, 0)
        flow = np.sign(f) * (abs(f) / self.coefficient) ** (1 / self.a)
        return np.concatenate([v, pull / self.mass, [self.e @ v - flow]])

    def late(self, t, start=None):
        y = np.zeros(2 * self.n + 1) if start is None else start
        return solve_ivp(self.rates, (0, t), y, "DOP853", rtol=1e-11, atol=1e-13).y[:, -1]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("exponents", [(1.0, 0.8, 0.5, 0.35), (1.5, 2.0)], ids=["low", "high"])
def test_motions_in_time(seed, exponents):
    one = Random(seed, exponents)
    n = one.n
    run = vv.simulate(one.system, 4, load=one.loads, nu=one.nu, tolerance=1e-10)
    wanted = one.late(4)
    assert run.outcome == "completed"
    assert np.abs(run.state[-1, : 2 * n : 2] - wanted[:n]).max() < 1e-8
    assert np.abs(run.state[-1, 1 : 2 * n : 2] - wanted[n : 2 * n]).max() < 1e-7
    force = run.element_forces().force[-1, 0]
    assert force == pytest.approx(one.stiffness * wanted[-1], abs=1e-7)


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.parametrize("seed", range(4))
def test_steady_motions(seed):
    """Harmonics and shooting against late states; the work of the load is lost; stability."""
    one = Random(seed)
    n = one.n
    r = vv.forced_response(
        one.system, [one.nu], load=one.loads, method="newton", harmonics=61, stability=True
    )
    x, k = r.coefficients[0], r.harmonics
    size = np.abs(x[:n]).max()
    wanted = one.late(40 * 2 * np.pi / one.nu)
    assert np.abs(x[:n].imag.sum(axis=1) - wanted[:n]).max() < (20 * r.truncation[0] + 1e-6) * size
    fed = np.pi * (one.load @ x[:n, k == 1].conj().imag)[0]
    own = np.pi * one.nu * (k**2 * one.c[:, np.newaxis] * np.abs(x[:n]) ** 2).sum()
    assert r.dissipation()[0, 0] == pytest.approx(fed - own, abs=1e-4 * fed)
    assert r.stable[0] in (True, None)
    check_by_shooting(one, wanted, size)


def check_by_shooting(one, wanted, size):
    """Check the motion, and its multipliers by differences of motions in time."""
    n = one.n
    motion = vv.steady_motion(one.system, one.nu, load=one.loads)
    assert np.abs(motion(0.0)[: 2 * n : 2] - wanted[:n]).max() < 1e-6 * size
    # The multipliers are those of the equations, and one of the internal coordinate.
    h, states = 1e-6, 2 * n + 1
    period = 2 * np.pi / one.nu
    shooting = np.array([
        (one.late(period, wanted + h * row) - one.late(period, wanted - h * row)) / (2 * h)
        for row in np.eye(states)
    ]).T  # fmt: skip
    growth = np.sort(np.abs(np.linalg.eigvals(shooting)))
    inner = next(e for e in one.system._prepared if isinstance(e, vv.Maxwell))._rate
    growth = np.sort([*growth, np.exp(-inner * period)])
    assert np.sort(np.abs(motion.multipliers)) == pytest.approx(growth, abs=2e-4)


@pytest.mark.parametrize("seed", range(2))
def test_steady_motions_of_high_exponents(seed):
    """Where the slope of the rate is infinite, harmonics may not converge, but shooting does."""
    one = Random(seed, (1.5, 2.0))
    wanted = one.late(40 * 2 * np.pi / one.nu)
    check_by_shooting(one, wanted, np.abs(wanted[: one.n]).max())


@pytest.mark.parametrize("seed", [1, 2, 5])
def test_loops(seed):
    one = Random(seed, (1.0, 0.8, 0.5, 0.35, 1.5, 2.0)).element
    ratio = one.stiffness / one.coefficient

    def rates(t, y):
        v = 0.3 * 4 * np.cos(4 * t)
        flow = np.sign(y[0]) * (ratio * abs(y[0])) ** (1 / one.exponent)
        return [v - flow, one.stiffness * y[0] * v]

    start = solve_ivp(rates, (0, 30 * np.pi / 2), [0, 0], "DOP853", rtol=1e-10, atol=1e-13).y
    times = np.pi / 2 * np.arange(721) / 720
    cycle = solve_ivp(
        rates, (0, np.pi / 2), [start[0, -1], 0], "DOP853", rtol=1e-11, atol=1e-14, t_eval=times
    ).y
    loop = one.loop(0.3, nu=4)
    # A force with a corner in its rate has slower Fourier coefficients.
    near = 2e-4 if one.exponent <= 1 else 2e-3
    assert np.abs(loop - one.stiffness * cycle[0, :-1]).max() < near * np.abs(loop).max()
    assert one.energy([0.0, 0.3], nu=4) == pytest.approx([0, cycle[1, -1]], rel=1e-4)
    ax = vv.plot_loop(one, 0.3, nu=4)
    d, force = ax.lines[0].get_data()
    assert np.trapezoid(force, d) == pytest.approx(cycle[1, -1], rel=1e-3)


def test_a_linear_element_is_a_kernel():
    element = vv.Maxwell(on="x1", stiffness=30, coefficient=6)
    kernel = vv.PronyKernel(weights=[5 * (1 - 1e-12)], rates=[5.0])
    both = []
    for one in (element, vv.Spring(on="x1", stiffness=30, kernel=kernel)):
        system = vv.Structure(mass=[1.0], stiffness=[20.0], elements=[one])
        both.append(vv.forced_response(system, [3.0, 5.0], load={"x1": 1.0}).coefficients[:, 0, -1])
    assert np.allclose(*both, rtol=1e-9)


def test_parameters_supports_and_sparse_matrices():
    one = Random(5)
    n = one.n
    twice = one.system._with_parameters({"elements[0].coefficient": 2 * one.coefficient})
    assert twice.dof_names == one.system.dof_names
    many = vv.simulate_ensemble(
        one.system, t_end=2, load=one.loads, nu=one.nu, initial=np.zeros((2, 2 * n + 2)),
        parameters={"elements[0].coefficient": [one.coefficient, 2 * one.coefficient]},
    )  # fmt: skip
    for system, state in zip((one.system, twice), many.state, strict=True):
        run = vv.simulate(system, 2, load=one.loads, nu=one.nu)
        assert np.abs(run.state[-1] - state).max() < 1e-8
    given = {name: csc_array(np.diag(m) if np.ndim(m) == 1 else m) for name, m in one.given.items()}
    sparse = vv.Structure(**given, elements=one.elements)
    both = [
        vv.forced_response(
            s, [one.nu], load=one.loads, method="newton", harmonics=15, tolerance=1e-3
        )
        for s in (one.system, sparse)
    ]
    assert np.abs(both[0].coefficients - both[1].coefficients).max() < 1e-12
    branch = vv.trace_response(
        one.system, vary="elements[0].coefficient", nu=one.nu, load=one.loads, harmonics=15,
        vary_range=(one.coefficient, 2 * one.coefficient), tolerance=1e-3,
    )  # fmt: skip
    there = vv.forced_response(
        twice, [one.nu], load=one.loads, method="newton", harmonics=15, tolerance=1e-3
    )
    assert np.allclose(branch.coefficients[-1][0, 1], there.coefficients[0][0, 1], rtol=1e-5)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"exponent": 0}, "exponent = 0: is dry friction, must be 0.1 to 2: use a Jenkins"),
        ({"exponent": 2.5}, "exponent = 2.5: must be 0.1 to 2"),
        ({"stiffness": -1}, "stiffness = -1: must be greater than 0"),
        ({"coefficient": 0}, "coefficient = 0: must be greater than 0"),
    ],
)
def test_wrong_arguments(given, words):
    with pytest.raises(vv.InputError) as caught:
        vv.Maxwell(**{"on": "x1", "stiffness": 1.0, "coefficient": 1.0, **given})
    assert words in str(caught.value)


def test_the_loss_of_no_motion_needs_a_frequency_too():
    element = vv.Maxwell(on="x1", stiffness=1.0, coefficient=1.0)
    assert element.energy(0.0, nu=1.0) == 0
    with pytest.raises(vv.InputError, match="nu = -1: must be greater than 0"):
        element.energy(0.0, nu=-1.0)


@pytest.mark.parametrize("seed", range(3))
def test_damping_of_modes(seed, tmp_path):
    """It is that of the modes without Maxwell elements, also with supports and in scenes."""
    rng = np.random.default_rng([77, seed])
    n = int(rng.integers(2, 5))
    root = rng.normal(size=(2, n, n))
    mass, stiffness = (one @ one.T + n * np.eye(n) for one in root)
    free = np.arange(n - (seed % 2))
    spring = vv.Spring(on="x1", stiffness=2.0, damping=0.1)
    ratios, factors = rng.uniform(0.01, 0.1, free.size), rng.uniform(0, 0.1, 2)
    by_mass, by_stiffness = factors.tolist()
    if seed % 3 == 0:
        by_mass = by_stiffness = 0.0
    given = {"mass": mass, "stiffness": stiffness, "supports": [f"x{n}"] if seed % 2 else []}
    element = vv.Maxwell(on=("x1", "x2"), stiffness=30.0, coefficient=2.0, exponent=0.6)
    if free.size == 1:
        element = vv.Maxwell(on="x1", stiffness=30.0, coefficient=2.0, exponent=0.6)
    damped = {"modal_damping": ratios, "rayleigh": (by_mass, by_stiffness)}
    system = vv.Structure(**given, **damped, elements=[spring, element])
    # Modes by Cholesky factors and a symmetric eigenvalue problem of NumPy.
    m, k = (one[np.ix_(free, free)] for one in (mass, stiffness))
    k = k + 2.0 * np.outer(np.eye(free.size)[0], np.eye(free.size)[0])
    factor = np.linalg.cholesky(m)
    inverse = np.linalg.inv(factor)
    squares, vectors = np.linalg.eigh(inverse @ k @ inverse.T)
    rates = 2 * ratios * np.sqrt(squares) + by_mass + by_stiffness * squares
    wanted = factor @ (vectors * rates) @ vectors.T @ factor.T
    whole = np.zeros((n, n))
    whole[np.ix_(free, free)] = wanted
    other = vv.Structure(**given, damping=whole, elements=[spring, element])
    np.testing.assert_allclose(system.damping, other.damping, atol=1e-12 * np.abs(wanted).max())
    sparse = {name: csc_array(given[name]) for name in ("mass", "stiffness")}
    same = vv.Structure(**(given | sparse), **damped, elements=[spring, element])
    np.testing.assert_allclose(same.damping.toarray(), system.damping, atol=1e-12)
    run = vv.simulate(other, 3, load={"x1": 1.0}, nu=2.0, dt=0.01)
    own = vv.simulate(system, 3, load={"x1": 1.0}, nu=2.0, dt=0.01)
    np.testing.assert_allclose(own.state[-1], run.state[-1], atol=1e-11)
    numbers = {name: " ".join(map(repr, map(float, one.ravel()))) for name, one in
               (("mass", mass), ("stiffness", stiffness), ("modal_damping", ratios))}  # fmt: skip
    keys = " ".join(f"{name}={text}" for name, text in numbers.items())
    held = f"supports='x{n}'" if seed % 2 else ""
    on = "'x1'" if free.size == 1 else "'x1' 'x2'"
    path = tmp_path / "modal.nml"
    path.write_text(
        f"&structure size={n} {keys} {held} rayleigh={by_mass!r} {by_stiffness!r} /\n"
        "&element on='x1' stiffness=2 damping=0.1 /\n"
        f"&element on={on} series_stiffness=30 fluid_coefficient=2 fluid_exponent=0.6 /\n"
        "&load on='x1' amplitude=1 /\n&transient t_end=3 dt=0.01 nu=2 /\n"
    )
    subprocess.run([SOLVE, path, "--out", tmp_path, "--quiet"], check=True)
    last = (tmp_path / "modal_transient.csv").read_text().splitlines()[-1].split(",")
    np.testing.assert_allclose(float(last[1]), own.state[-1, 0], atol=1e-10)
    np.testing.assert_allclose(columns_of(vv.run(path))["x1"][-1], own.state[-1, 0], atol=1e-10)


def test_loss_factors_are_refused():
    element = vv.Maxwell(on="x1", stiffness=1.0, coefficient=1.0)
    with pytest.raises(vv.InputError, match="loss_factor: must not be given with a Maxwell"):
        vv.Structure(mass=[1.0], stiffness=[1.0], elements=[element], loss_factor=0.1)
    for given, more in (({"modal_damping": 0.1}, []), ({"rayleigh": (0.1, 0.1)}, [0.1])):
        light = {"mass": [1.0, 0.0], "stiffness": [[2.0, -1], [-1, 2]], "elements": [element]}
        if more:
            assert vv.Structure(**light, **given).damping[1, 1] == pytest.approx(0.2)
            continue
        with pytest.raises(vv.InputError, match="modal_damping: with a Maxwell element"):
            vv.Structure(**light, **given)


def test_on_a_support():
    """A mass on a moving support, by relative coordinates."""
    element = vv.Maxwell(on=("x1", "x2"), stiffness=30, coefficient=2, exponent=0.6)
    held = vv.Structure(
        mass=[1.0, 5.0], stiffness=[[20.0, -20], [-20, 20]], elements=[element], supports=["x2"],
        base_direction=[1.0],
    )  # fmt: skip
    plain = vv.Structure(
        mass=[1.0], stiffness=[20.0], base_direction=[1.0],
        elements=[vv.Maxwell(on="x1", stiffness=30, coefficient=2, exponent=0.6)],
    )  # fmt: skip
    shock = vv.HalfSine(amplitude=5.0, duration=0.3)
    runs = [vv.simulate(s, 3, base_acceleration=shock, tolerance=1e-10) for s in (held, plain)]
    assert np.abs(runs[0].state[-1, :2] - runs[1].state[-1, :2]).max() < 1e-10
    forces = [run.element_forces().force[-1] for run in runs]
    assert forces[0] == pytest.approx(forces[1], abs=1e-8)
    pull = runs[0].support_reactions().force[-1, 0]
    assert pull == pytest.approx(-20 * runs[1].state[-1, 0] - forces[1][0], abs=1e-8)
