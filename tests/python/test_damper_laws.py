"""Progressive stops, relief valves, Stribeck friction, general Bouc-Wen loops, by SciPy."""

import json
import os
import subprocess
import warnings
from pathlib import Path

import numpy as np
import pytest
import viscovib as vv
from referee.element_motions import Driven, Valve
from referee.integration import solve_ivp
from referee.switched import Contact, Stribeck, Turning
from scipy.integrate import quad

ROOT = Path(__file__).parents[2]
SOLVE = os.environ.get("VISCOVIB_SOLVE", ROOT / "build" / "release" / "fortran" / "viscovib-solve")
#: Random elements: the source of each, its law as a text, and its reference.
KINDS = ("gap", "stop", "valve", "stribeck", "bouc-wen")


def draw(kind, rng):
    """An element on x1, a text of its law, and its part of the reference automaton."""
    e = np.array([1.0, 0.0])
    k, gap = rng.uniform(5, 50), rng.uniform(0.02, 0.2)
    if kind in ("gap", "stop"):
        p = float(rng.choice([1, 1.5, 2, 2.7, 3]))
        both = kind == "stop"
        element = (vv.Stop if both else vv.Gap)(on="x1", stiffness=k, gap=gap, exponent=p)
        text = f"{k!r}*stop(d, {gap!r}, {p!r})" if both else f"{k!r}*max(d - {gap!r}, 0)^{p!r}"
        return element, text, Contact(e, k, gap, both, p)
    if kind == "valve":
        c, a = rng.uniform(0.2, 2), float(rng.choice([0.8, 1, 1.5, 2]))
        limit, s = rng.uniform(0.1, 0.5), float(rng.choice([0, 0.3]))
        element = vv.FluidDamper(on="x1", coefficient=c, exponent=a, limit=limit, relief=s)
        return element, f"relief(v, {c!r}, {a!r}, {limit!r}, {s!r})", Valve(e, c, a, limit, s)
    if kind == "stribeck":
        static = rng.uniform(0.1, 0.6)
        coulomb, v_s = static * rng.uniform(0.3, 1), rng.uniform(0.05, 0.5)
        d = float(rng.choice([1, 1.5, 2]))
        element = vv.StribeckFriction(
            on="x1", coulomb=coulomb, static=static, velocity=v_s, exponent=d
        )
        text = f"stribeck(v, {coulomb!r}, {static!r}, {v_s!r}, {d!r})"
        return element, text, Stribeck(static, coulomb, v_s, d)
    b, n = rng.uniform(1, 8), float(rng.choice([1, 1.5, 2, 3]))
    # A hardening element with n > 1 becomes infinite.
    g = b * rng.uniform(-3, -1) if n == 1 and rng.random() < 0.5 else b * rng.uniform(1, 3)
    element = vv.BoucWen(on="x1", stiffness=2.0, ratio=0.2, beta=b, gamma=g, exponent=n)
    turning = Turning(
        e, lambda z, way: 1 - (g + b * np.sign(way * z)) * np.abs(z) ** n, 0.4, 1.6
    )  # fmt: skip
    return element, None, turning


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(2))
def test_motions_from_switch_to_switch(kind, seed):
    """Two masses against SciPy; a text of the law gives the same motion."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    element, text, reference = draw(kind, rng)
    mass, k = rng.uniform(0.5, 2, 2), np.array([[3.0, -1], [-1, 2]]) * rng.uniform(0.5, 3)
    c, load, nu = 0.1 * mass, rng.uniform(0.5, 1.5, 2), rng.uniform(0.8, 2.5)
    q, v = rng.uniform(-0.3, 0.02, 2), rng.uniform(-1, 1, 2)
    friction = [reference, None] if kind == "stribeck" else [None, None]
    elements = [] if kind == "stribeck" else [reference]
    wanted = Driven(
        [], mass, k, np.diag(c), lambda t: load * np.sin(nu * t), elements, friction, [None, None]
    ).run(q, v, [0.0, 2.0, 6.0])  # fmt: skip
    start = np.stack([q, v], axis=1).ravel()
    springs = [element] if text is None else [element, vv.Spring(on="x1", law=text)]
    for one in springs:
        system = vv.Structure(mass=mass, stiffness=k, damping=c, elements=[one])
        run = vv.simulate(
            system, 6, initial=start, load=load, nu=nu, times=[0, 2, 6], tolerance=1e-11
        )
        assert run.outcome == "completed"
        assert np.abs(run.state - wanted).max() < 1e-8


@pytest.mark.parametrize(("a", "limit"), [(0.3, 0.1), (0.5, 0.4)])
def test_valves_of_dampers_with_infinite_slope(a, limit):
    damper = vv.FluidDamper(on="x1", coefficient=1.66, exponent=a, limit=limit, relief=0.2)
    system = vv.Structure(mass=[1.0], stiffness=[2.0], damping=[0.1], elements=[damper])
    run = vv.simulate(system, 3, initial=[0.1, 0.5], load=[1.0], nu=1.7, tolerance=1e-10)
    found = solve_ivp(
        lambda t, y: [y[1], np.sin(1.7 * t) - 2 * y[0] - 0.1 * y[1] - float(damper.force(y[1]))],
        (0, 3), [0.1, 0.5], "Radau", rtol=1e-8, atol=1e-10,
    )  # fmt: skip
    assert np.abs(run.state[-1] - found.y[:, -1]).max() < 1e-6


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.parametrize("kind", ["gap", "stop", "valve", "smooth stribeck", "bouc-wen"])
def test_steady_motions_are_late_states(kind):
    """Harmonics against a motion in time, which settles; also the loss of energy and stability."""
    rng = np.random.default_rng([0, 7])
    if kind == "smooth stribeck":
        element = vv.StribeckFriction(
            on="x1", coulomb=0.1, static=0.2, velocity=0.3, exponent=2, width=0.2
        )
    else:
        element = draw(kind, rng)[0]
    system = vv.Structure(
        mass=[1.0, 1.5], stiffness=[[3.0, -1], [-1, 2]], damping=[0.3, 0.3], elements=[element]
    )
    nu = rng.uniform(0.8, 2.0)
    r = vv.forced_response(
        system, [nu], load=[1.0, 0.3], method="newton", harmonics=61, tolerance=1e-9,
        stability=True,
    )  # fmt: skip
    run = vv.simulate(system, 60 * 2 * np.pi / nu, load=[1.0, 0.3], nu=nu, tolerance=1e-9)
    size = np.abs(r.coefficients[0]).max()
    late = r.coefficients[0].imag.sum(axis=1)
    rough = 20 * r.truncation[0] + 1e-6
    assert np.abs(run.state[-1, ::2] - late).max() < rough * size
    assert r.stable[0] in (True, None)
    x = r.coefficients[0]
    fed = np.pi * (np.array([1.0, 0.3]) @ x[:, r.harmonics == 1].conj().imag)[0]
    lost = np.pi * nu * 0.3 * (r.harmonics**2 * np.abs(x) ** 2).sum()
    assert r.dissipation()[0, 0] == pytest.approx(fed - lost, abs=rough * abs(fed))


@pytest.mark.parametrize("seed", range(3))
def test_energy_and_force_of_rate_elements(seed):
    rng = np.random.default_rng(seed)
    for kind in ("valve", "stribeck"):
        element = draw(kind, rng)[0]
        size, nu = rng.uniform(0.05, 2), rng.uniform(0.3, 30)
        v = rng.normal(size=20)
        if kind == "valve":
            low = element.coefficient * np.abs(v) ** element.exponent
            knee = (element.limit / element.coefficient) ** (1 / element.exponent)
            high = element.limit + element.relief * (np.abs(v) - knee)
            force = np.where(np.abs(v) < knee, low, high)
        else:
            drop = element.static - element.coulomb
            ratio = np.abs(v / element.velocity) ** element.exponent
            force = element.coulomb + drop * np.exp(-ratio)
            knee = element.velocity
        assert np.allclose(element.force(v), np.sign(v) * force, rtol=1e-13, atol=0)
        at = np.arcsin(min(knee / (size * nu), 1))
        lost, _ = quad(
            lambda p, one=element, top=size * nu: float(one.force(top * np.sin(p)) * np.sin(p)),
            0, np.pi / 2, points=[at], epsabs=1e-13, limit=300,
        )  # fmt: skip
        assert element.energy(size, nu=nu) == pytest.approx(4 * size * lost, rel=1e-9)


def test_energy_of_a_narrow_stribeck_curve():
    """A curve far narrower than the rates adds (F_s - F_c) v_s^2/V^2, by integration by parts."""
    v_s, top = 1e-6, 2.0
    element = vv.StribeckFriction(on="x1", coulomb=1, static=3, velocity=v_s, exponent=1)
    more = element.energy(1.0, nu=top) - 4.0
    assert more == pytest.approx(4 * 2 * (v_s / top) ** 2, abs=1e-14)


def test_general_bouc_wen_loops():
    """Reversals of softening beyond beta and of hardening: closed forms and quadratures."""
    found = json.loads((ROOT / "data" / "fluid_dampers.json").read_text())
    wanted = next(one for one in found if one["name"] == "bouc_wen_loops_g_beyond_b")["value"]
    for text, one in wanted.items():
        b, g, n = (float(part.split("=")[1]) for part in text.split(", "))
        element = vv.BoucWen(on="x1", stiffness=1.0, beta=b, gamma=g, exponent=n)
        # The force after six passages of the cycle approaches that of the periodic cycle.
        ends = np.array([float(x) for x in one["z_at_reversals_abs"]])
        path = 0.25 * np.array([1, -1] * 100)
        settled = np.abs(element.loop(path)[-1])
        assert abs(settled - ends[-1]) < 4 * abs(ends[-1] - ends[-2])


@pytest.mark.parametrize(
    ("gamma", "n"),
    [(-3.0, 1), (-1.999, 1.3), (2.001, 1), (40.0, 1.3), (-3.0, 4.5), (2.001, 4.5), (40.0, 4.5)],
)
def test_loops_of_any_gamma(gamma, n):
    """Loops and energies cycle after cycle by SciPy, below the deflection of an infinite force."""
    element = vv.BoucWen(on="x1", stiffness=1.0, ratio=0.1, beta=2.0, gamma=gamma, exponent=n)
    d = np.array([0.2, -0.15, 0.1, -0.2]) * (1.7 if n > 4 else 1)
    z, before = 0.0, np.inf
    for _ in range(400):
        force, lost = [], 0.0
        for i, now in enumerate(d):
            change = now - d[i - 1]
            way = np.sign(change)
            y = solve_ivp(
                lambda _, y, way=way: [
                    way * (1 - (gamma + 2.0 * np.sign(way * y[0])) * abs(y[0]) ** n),
                    way * 0.9 * y[0],
                ],
                (0, abs(change)), [z, 0.0], "DOP853", rtol=1e-11, atol=1e-13, max_step=0.05,
            ).y  # fmt: skip
            z, lost = y[0, -1], lost + y[1, -1]
            force.append(0.1 * now + 0.9 * z)
        if abs(force[0] - before) < 1e-13:
            break
        before = force[0]
    np.testing.assert_allclose(element.loop(d), force, atol=1e-8)
    assert element.energy(d) == pytest.approx(lost, abs=1e-8)


def test_every_interface(tmp_path):
    """Scene, structure and polynomial system with the same elements."""
    scene = tmp_path / "dampers.nml"
    scene.write_text(
        "&structure mass=1 2 stiffness=20 -10 -10 20 damping=0.1 0.1 /\n"
        "&element on='x1' fluid_coefficient=1.5 fluid_exponent=2 fluid_limit=0.4 "
        "fluid_relief=0.1 /\n"
        "&element on='x2' law='50*stop(d, 0.05, 1.5) + stribeck(v, 0.1, 0.2, 0.3, 2)' /\n"
        "&element on='x1' 'x2' stiffness=1 hysteresis='bouc_wen' "
        "hysteresis_numbers=2 0.1 3 5 1.5 /\n"
        "&element on='x1' hysteresis='dahl' hysteresis_numbers=2 0.1 /\n"
        "&element on='x2' hysteresis='jenkins' hysteresis_numbers=2 0.1 1 0.2 /\n"
        "&load on='x1' amplitude=3 /\n&transient t_end=3 nu=6 tolerance=1e-9 /\n"
    )
    subprocess.run([SOLVE, scene, "--out", tmp_path, "--quiet"], check=True, timeout=60)
    table = (tmp_path / "dampers_transient.csv").read_bytes()
    last = np.array(table.splitlines()[-1].split(b",")[1:], dtype=float)
    elements = [
        vv.FluidDamper(on="x1", coefficient=1.5, exponent=2, limit=0.4, relief=0.1),
        vv.Stop(on="x2", stiffness=50, gap=0.05, exponent=1.5),
        vv.StribeckFriction(on="x2", coulomb=0.1, static=0.2, velocity=0.3, exponent=2),
        vv.Spring(on=("x1", "x2"), stiffness=1),
        vv.BoucWen(on=("x1", "x2"), stiffness=2, ratio=0.1, beta=3, gamma=5, exponent=1.5),
        vv.Dahl(on="x1", stiffness=2, limit=0.1),
        vv.Iwan(on="x2", stiffness=[2, 1], limit=[0.1, 0.2]),
    ]
    given = {"mass": [1.0, 2.0], "stiffness": [[20.0, -10], [-10, 20]], "damping": [0.1, 0.1]}
    run = vv.simulate(
        vv.Structure(**given, elements=elements), 3, load=[3, 0], nu=6, tolerance=1e-9
    )
    assert np.allclose(last, run.state[-1], rtol=0, atol=1e-8)
    run = vv.simulate(
        vv.Structure(**given, elements=elements[:3]), 3, load=[3, 0], nu=6, tolerance=1e-9
    )
    system = vv.PolynomialSystem(
        mass=[1, 2], stiffness=given["stiffness"], damping=[[0.1, 0], [0, 0.1]],
        forces={"x1": "relief(x1_dot, 1.5, 2, 0.4, 0.1)",
                "x2": "50*stop(x2, 0.05, 1.5) + stribeck(x2_dot, 0.1, 0.2, 0.3, 2)"},
    )  # fmt: skip
    other = vv.simulate(system, 3, load=[3, 0], nu=6, tolerance=1e-9)
    assert np.allclose(other.state[-1], run.state[-1], rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        ("hysteresis='bouc_wen' hysteresis_numbers=1 2", "2 numbers, must be stiffness ratio"),
        ("hysteresis='bouc_wen' hysteresis_numbers=1 0 -3 1", "beta = -3: must be greater than 0"),
        ("hysteresis='bouc_wen' hysteresis_numbers=1 1 3 1", "ratio = 1: must be 0 to less than 1"),
        ("hysteresis='dahl' hysteresis_numbers=1 2 -1", "exponent = -1: must be 0 to 20"),
        ("hysteresis='jenkins' hysteresis_numbers=1 2 3", "3 numbers, must be stiffness limit"),
        ("hysteresis='jenkins' hysteresis_numbers=1 -2", "limit = -2: must be greater than 0"),
        ("law='stop(d, -1)'", "stop: gap = -1: must be at least 0"),
        ("law='relief(v, 1, 0, 3)'", "relief: exponent = 0: must be 0.1 to 2"),
        ("law='relief(v, 1, 2, -3)'", "relief: limit = -3: must be greater than 0"),
        ("law='stribeck(v, 2, 1, 3)'", "stribeck: static = 1: must be at least coulomb, 2"),
        ("law='stribeck(v, 2)'", "stribeck has 1 constants: must be stribeck(u, coulomb"),
        ("law='relief(v, 1e-300, 0.3, 1e300)'", "it divides by 0, or takes a function outside"),
        ("law='stribek(v, 1, 2, 3)'", "did you mean stribeck?"),
        ("series_stiffness=3", "series_stiffness = 3: needs a fluid_coefficient"),
        ("series_stiffness=3 fluid_coefficient=1 stiffness=2", "other parts belong to another"),
        (
            "series_stiffness=3 fluid_coefficient=1 hysteresis='dahl' hysteresis_numbers=1 1",
            "belongs to another &element",
        ),
        ("law='stop(d, v)'", "stop: its operands behind the first must be numbers"),
        ("fluid_coefficient=1 fluid_limit=-1", "fluid_limit = -1: must not be negative"),
    ],
)
def test_wrong_scenes(tmp_path, numbers, words):
    scene = tmp_path / "wrong.nml"
    scene.write_text(
        f"&structure mass=1 stiffness=1 /\n&element on='x1' {numbers} /\n"
        "&load amplitude=3 /\n&transient t_end=2 nu=6 /\n"
    )
    with pytest.raises(vv.InputError) as caught:
        vv.run(scene)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: vv.FluidDamper(on=0, coefficient=1, exponent=0, limit=1), "is dry friction"),
        (lambda: vv.FluidDamper(on=0, coefficient=1, limit=-1), "limit = -1: must be greater"),
        (lambda: vv.FluidDamper(on=0, coefficient=1, limit=1, relief=-2), "relief = -2: must be"),
        (lambda: vv.FluidDamper(on=0, coefficient=1, relief=2), "relief = 2: must be 0 without"),
        (lambda: vv.Stop(on=0, stiffness=1, gap=-1, exponent=2), "gap = -1: must be at least 0"),
        (lambda: vv.Gap(on=0, stiffness=1, gap=1, exponent=0.5), "exponent = 0.5: must be 1 to 20"),
        (lambda: vv.Gap(on=0, restitution=1, gap=1, exponent=2), "must be 1 with a restitution"),
        (lambda: vv.StribeckFriction(on=0, coulomb=-1, static=2, velocity=1), "coulomb = -1: must"),
        (lambda: vv.StribeckFriction(on=0, coulomb=3, static=2, velocity=1), "static = 2: must be"),
        (lambda: vv.StribeckFriction(on=0, coulomb=1, static=2, velocity=0), "velocity = 0: must"),
        (
            lambda: vv.StribeckFriction(on=0, coulomb=1, static=2, velocity=1, exponent=0),
            "exponent = 0: must be 0.5 to 4",
        ),
        (lambda: vv.plot_loop(vv.Gap(on=0, restitution=1, gap=1), 1, nu=1), "must be an element"),
        (lambda: vv.plot_loop(vv.Gap(on=0, stiffness=1, gap=1), -1, nu=1), "amplitude = -1"),
    ],
)
def test_wrong_arguments(make, words):
    with pytest.raises(vv.InputError) as caught:
        make()
    assert words in str(caught.value)


def test_loops_are_drawn():
    """The area of the drawn loop is the loss in its title."""
    kernel = vv.PronyKernel(weights=[0.3], rates=[1.0])
    for element in (
        vv.FluidDamper(on="x1", coefficient=2, exponent=0.5, limit=1),
        vv.StribeckFriction(on="x1", coulomb=1, static=2, velocity=0.1),
        vv.BoucWen(on="x1", stiffness=2, beta=1, gamma=3),
        vv.Spring(on="x1", stiffness=2, law="d^3 + 0.1*v", damping=0.3, kernel=kernel),
        vv.Stop(on="x1", stiffness=2, gap=0.1, exponent=2),
    ):
        ax = vv.plot_loop(element, 0.5, nu=1.5)
        d, force = ax.lines[0].get_data()
        lost = float(ax.get_title().split()[3])
        assert np.trapezoid(force, d) == pytest.approx(lost, abs=3e-3 * max(abs(force)))


@pytest.mark.parametrize("seed", range(3))
def test_sticking_on_both_sides_of_a_steep_damper(seed):
    """From rest to sliding and back, with all steps alike and without warnings."""
    rng = np.random.default_rng(seed)
    k = rng.uniform(0.5, 2, 3)
    a, *exponents = rng.choice([0.2, 0.4, 0.9]), rng.choice([1, 1.5, 2]), rng.choice([1, 1.5, 2])
    system = vv.Structure(
        mass=rng.uniform(0.5, 2.5, 2),
        stiffness=[[k[0] + k[1], -k[1]], [-k[1], k[1] + k[2]]],
        damping=rng.uniform(0.05, 0.3, 2),
        elements=[
            vv.FluidDamper(on={"x1": -1.0, "x2": 1.0}, coefficient=0.1, exponent=a),
            *(
                vv.StribeckFriction(on=on, coulomb=c, static=2 * c, velocity=0.1, exponent=n)
                for on, c, n in zip(("x1", "x2"), (0.15, 0.1), exponents, strict=True)
            ),
            vv.Jenkins(on="x1", stiffness=1.5, limit=0.15),
        ],
    )
    load = rng.uniform(-0.9, 0.9, 2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        runs = [vv.simulate(system, 20, load=load, nu=1.1, dt=dt) for dt in (0.02, 0.005, 0.002)]
    assert [run.outcome for run in runs] == ["completed"] * 3
    assert np.ptp([run.state[-1] for run in runs], axis=0).max() < 1e-9
