"""Fluid viscous dampers c sign(v) abs(v)^a, whose slope is infinite at rest for a < 1."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp
from scipy.integrate import quad
from scipy.optimize import brentq

ROOT = Path(__file__).parents[2]
DATA = ROOT / "data" / "fluid_dampers.json"
REFERENCE = {one["name"]: one["value"] for one in json.loads(DATA.read_text())}


def _chain(n, stiffness):
    matrix = stiffness * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    matrix[-1, -1] = stiffness
    return matrix


def _dampers(n, c, a):
    rest = [(f"x{j + 1}", f"x{j}") for j in range(1, n)]
    return [vv.FluidDamper(on=on, coefficient=c, exponent=a) for on in ["x1", *rest]]


@pytest.mark.parametrize(("a", "c"), [(0.5, 1.5), (1.5, 2.0)])
def test_reference_from_rest(a, c):
    given = REFERENCE[f"fluid_damper_alpha_{a}"]
    damper = vv.FluidDamper(on="x1", coefficient=c, exponent=a)
    system = vv.Structure(mass=[1.0], stiffness=[100.0], elements=[damper], base_direction=[1.0])
    run = vv.simulate(
        system, 2, base_acceleration=vv.HalfSine(amplitude=5.0, duration=0.3), times=[1, 2],
        events=["x1_dot"],
    )  # fmt: skip
    assert run.outcome == "completed"
    assert run.error < 1e-10
    assert np.allclose(run.state[0], [given["x_at_1"], given["v_at_1"]], rtol=0, atol=1e-10)
    assert np.allclose(run.state[1], [given["x_at_2"], given["v_at_2"]], rtol=0, atol=1e-10)
    assert np.allclose(run.events[0].t, given["zeros_of_v"], rtol=0, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_random_chains_from_rest(seed):
    rng = np.random.default_rng(seed)
    n, a = int(rng.integers(1, 4)), float(rng.uniform(0.3, 2))
    m, c = rng.uniform(0.5, 2, n), 10 ** rng.uniform(-2, 0.5)
    k, top, length = _chain(n, 10 ** rng.uniform(0, 2.5)), 10 ** rng.uniform(0, 1), 0.5
    system = vv.Structure(
        mass=m, stiffness=k, base_direction=np.ones(n), elements=_dampers(n, c, a)
    )
    run = vv.simulate(system, 1.0, base_acceleration=vv.HalfSine(amplitude=top, duration=length))
    e = np.eye(n) - np.eye(n, k=-1)

    def slopes(t, y, on):
        v = e @ y[n:]
        force = e.T @ (c * np.sign(v) * np.abs(v) ** a)
        return np.r_[y[n:], -(k @ y[:n] + force) / m - on * top * np.sin(np.pi * t / length)]

    y = np.zeros(2 * n)
    for begin, on in ((0.0, 1.0), (length, 0.0)):
        y = solve_ivp(
            slopes, (begin, begin + length), y, "Radau", args=(on,), rtol=1e-9, atol=1e-12,
            max_step=length / 50,
        ).y[:, -1]  # fmt: skip
    size = np.abs(y).max()
    assert run.outcome == "completed"
    assert run.error <= 1e-9 * size
    assert np.allclose(np.r_[run.state[-1][0::2], run.state[-1][1::2]], y, rtol=0, atol=2e-8 * size)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("a", [0.15, 0.25])
def test_given_steps_are_as_accurate_and_without_a_warning(a):
    """Steps end where the rate is 0, so that no layer is missed."""
    system = vv.Structure(mass=[1.0, 2.0], stiffness=_chain(2, 100.0), elements=_dampers(2, 5.0, a))
    shock = vv.HalfSine(amplitude=[100.0, 0.0], duration=0.1)
    wanted = vv.simulate(system, 1, force=shock, tolerance=1e-11).state[-1]
    for step in (1e-2, 1e-3):
        found = vv.simulate(system, 1, force=shock, dt=step).state[-1]
        assert np.abs(found - wanted).max() < 1e-10 * np.abs(wanted).max()


@pytest.mark.parametrize(("a", "top"), [(0.15, 0.5), (0.3, 0.2), (0.4, 0.1)])
def test_slow_creep_from_rest(a, top):
    # Inertia is negligible: c v^a = p - k x.
    damper = vv.FluidDamper(on="x1", coefficient=1.5, exponent=a)
    system = vv.Structure(mass=[1e-3], stiffness=[1.0], elements=[damper])
    run = vv.simulate(system, 2, force=vv.HalfSine(amplitude=top, duration=1.0))

    def rate(t, x):
        force = (top * np.sin(np.pi * t) if t <= 1 else 0.0) - x
        return np.sign(force) * np.abs(force / 1.5) ** (1 / a)

    found = solve_ivp(rate, (0, 1), [0.0], rtol=1e-10, atol=1e-30)
    found = solve_ivp(rate, (1, 2), found.y[:, -1], rtol=1e-10, atol=1e-30)
    assert run.outcome == "completed"
    assert run.state[-1, 0] == pytest.approx(found.y[0, -1], rel=1e-3)


@pytest.mark.parametrize("a", [0.2, 0.5])
def test_many_floors(a):
    # The balance of energy: the work of the load is stored or lost in the dampers. Motions of at
    # most six coordinates advance together in lanes; this one advances alone.
    n = 7
    k = _chain(n, 100.0)
    system = vv.Structure(mass=np.ones(n), stiffness=k, elements=_dampers(n, 2.0, a))
    load = np.zeros(n)
    load[-1] = 3.0
    run = vv.simulate(system, 1, load=load, nu=4.0, times=np.linspace(0, 1, 801))
    q, v = run.state[:, 0::2], run.state[:, 1::2]
    rates = v @ (np.eye(n) - np.eye(n, k=-1)).T
    lost = np.trapezoid(2 * np.abs(rates) ** (1 + a), run.t, axis=0).sum()
    work = np.trapezoid(load[-1] * np.sin(4 * run.t) * v[:, -1], run.t)
    stored = 0.5 * (v[-1] @ v[-1] + q[-1] @ k @ q[-1])
    assert run.outcome == "completed"
    assert work == pytest.approx(stored + lost, rel=1e-5)


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.parametrize("a", [0.3, 0.7])
def test_steady_motion_and_multipliers(a):
    damper = vv.FluidDamper(on="x1", coefficient=1.5, exponent=a)
    system = vv.Structure(mass=[1.0], stiffness=[100.0], elements=[damper])
    motion = vv.steady_motion(system, 8.0, load=[5.0])
    assert motion.outcome == "converged"
    assert motion.stable
    # Liouville's formula, integrated from the zeros of the rate in powers of the time.
    times, weights = np.polynomial.legendre.leggauss(400)
    zero = brentq(lambda one: motion(one)[1], *_around_zero(motion), xtol=1e-12)
    s = 0.5 * (times + 1)
    total = 0.0
    for way in (1, -1):
        at = zero + way * np.pi / 16 * s ** (2 / a)
        speed = np.abs(motion(at % (np.pi / 4))[:, 1])
        rate = 1.5 * a * speed ** (a - 1) * (2 / a) * s ** (2 / a - 1)
        total += np.pi / 16 * float(0.5 * weights @ rate)
    product = np.abs(np.prod(motion.multipliers))
    assert product == pytest.approx(np.exp(-2 * total), rel=1e-2)
    found = vv.forced_response(system, [8.0], load=[5.0], method="newton", harmonics=99)
    turns = np.exp(2j * np.pi * np.outer(found.harmonics, np.arange(2000)) / 2000)
    wave = (found.coefficients[0, 0] @ turns).imag
    top = np.abs(motion.extremes("x1")).max()
    assert np.abs(wave).max() == pytest.approx(top, rel=10 * found.truncation[0])


def _around_zero(motion):
    times = np.linspace(0, np.pi / 4, 50)
    speeds = motion(times)[:, 1]
    place = int(np.flatnonzero(speeds[1:] * speeds[:-1] < 0)[0])
    return times[place], times[place + 1]


def test_energy():
    for text, value in REFERENCE["fluid_energy_closed_form"].items():
        damper = vv.FluidDamper(on="x1", coefficient=10, exponent=float(text))
        found = damper.energy(0.02, nu=2 * np.pi * 1.5)
        assert found == pytest.approx(float(value), rel=1e-14)
        lost, _ = quad(
            lambda t, one=damper: float(one.force(np.cos(t)) * np.cos(t)), 0, 2 * np.pi,
            points=[np.pi / 2, 1.5 * np.pi],
        )  # fmt: skip
        assert damper.energy(-1.0, nu=1) == pytest.approx(lost, rel=1e-7)


def test_resumed():
    system = vv.Structure(
        mass=[1.0, 1.0], stiffness=_chain(2, 100.0), elements=_dampers(2, 1.0, 0.3)
    )
    whole = vv.simulate(system, 2, load=[0, 3], nu=5)
    first = vv.simulate(system, 1, load=[0, 3], nu=5)
    both = vv.simulate(system, 2, resume=first, times=[2.0])
    assert np.allclose(both.state[-1], whole.state[-1], rtol=0, atol=1e-10)


def test_vary():
    system = vv.Structure(
        mass=[1.0], stiffness=[100.0],
        elements=[vv.FluidDamper(on="x1", coefficient=1.0, exponent=1.5)],
    )  # fmt: skip
    branch = vv.trace_response(
        system, vary="elements[0].coefficient", vary_range=(1.0, 2.0), nu=9.0, load=[1.0]
    )
    end = vv.Structure(
        mass=[1.0], stiffness=[100.0],
        elements=[vv.FluidDamper(on="x1", coefficient=2.0, exponent=1.5)],
    )  # fmt: skip
    there = vv.forced_response(end, [9.0], load=[1.0], method="newton")
    assert np.allclose(branch.coefficients[-1][0, 0], there.coefficients[0][0, 0], rtol=1e-5)


@pytest.mark.parametrize("a", [0.433, 0.455])
def test_first_moments_under_a_sinusoid(a):
    """At first c v^a = 5 sin(8 t): inertia is negligible, and the rate far below its error."""
    damper = vv.FluidDamper(on="x1", coefficient=1.2, exponent=a)
    system = vv.Structure(mass=[1.0], stiffness=[200.0], elements=[damper])
    run = vv.simulate(system, 1, load=[5.0], nu=8.0, tolerance=1e-9)
    assert run.outcome == "completed"
    for step in (1e-2, 1e-3):
        other = vv.simulate(system, 1, load=[5.0], nu=8.0, dt=step)
        assert other.outcome == "completed"
        assert np.abs(other.state[-1] - run.state[-1]).max() < 1e-9


def test_scenes_name_dry_friction(tmp_path):
    scene = tmp_path / "friction.nml"
    scene.write_text(
        "&structure mass=1 stiffness=100 /\n"
        "&element on='x1' fluid_coefficient=1 fluid_exponent=0 /\n"
        "&load amplitude=3 /\n&transient t_end=2 nu=6 /\n"
    )
    with pytest.raises(
        vv.InputError, match=r"0.1 to 2; dry friction \(0\) is the law F\*sign\(v\)"
    ):
        vv.run(scene)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"exponent": 0}, "exponent = 0: is dry friction, must be 0.1 to 2: use a Jenkins"),
        ({"exponent": 0.05}, "exponent = 0.05: must be 0.1 to 2"),
        ({"exponent": 2.5}, "exponent = 2.5: must be 0.1 to 2"),
        ({"coefficient": 0}, "coefficient = 0: must be greater than 0"),
        ({"coefficient": "a"}, "coefficient = 'a'"),
    ],
)
def test_wrong_arguments(given, words):
    with pytest.raises(vv.InputError) as caught:
        vv.FluidDamper(**{"on": "x1", "coefficient": 1.0, "exponent": 0.5, **given})
    assert words in str(caught.value)


_SMOOTH = (
    "0.3*d^3",
    "tanh(1000*d)",
    "0.2*v*abs(v)",
    "2*max(d - 0.2, 0)",
    "0.1*abs(d)",
    "0.3*sinh(v)",
)
_STEEP = (
    "0.3*sign(v)*abs(v)^0.4",
    "0.1*sign(v)",
    "sqrt(abs(d))*sign(d)",
    "0.2*sign(v + d)*abs(v + d)^0.9",
)


@pytest.mark.parametrize("law", _SMOOTH + _STEEP)
def test_linear_responses_say_that_they_lack_a_force(law, tmp_path):
    n = 3
    spring = vv.Spring(on="x2", law=law)
    system = vv.Structure(mass=np.ones(n), stiffness=np.diag([1.0, 2, 3]), damping=0.1 * np.eye(n),
                          elements=[spring, vv.Spring(on="x1", law="0.1*d^3")])  # fmt: skip
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        response = vv.forced_response(system, [0.7, 0.9], load={1: np.ones(n)}, method="linear")
    said = [one for one in seen if "finite slope at rest" in str(one.message)]
    skips = [one for one in response.plan["skips"] if "finite slope at rest" in one]
    assert (len(said), len(skips)) == ((1, 1) if law in _STEEP else (0, 0))


@pytest.mark.parametrize("a", [0.2, 0.5, 0.9])
def test_dampers_in_parallel_are_one(a):
    """From rest; the second one has the rate -2 v, so that it adds c 2^(1 + a) sign(v) |v|^a."""

    def moved(*dampers):
        system = vv.Structure(mass=[1.3], stiffness=[2.0], damping=[0.1], elements=list(dampers))
        return vv.simulate(system, 15, load=0.7, nu=1.1, dt=0.02).state[-1]

    first = vv.FluidDamper(on="x1", coefficient=0.2, exponent=a)
    second = vv.FluidDamper(on={"x1": -2.0}, coefficient=0.1, exponent=a)
    both = vv.FluidDamper(on="x1", coefficient=0.2 + 0.1 * 2 ** (1 + a), exponent=a)
    assert np.allclose(moved(first, second), moved(both), rtol=0, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_turning_points_between_a_contact_and_dampers(seed):
    """A motion may nearly rest where it turns: the damper carries what springs and load leave."""
    rng = np.random.default_rng(seed)
    elements = [
        vv.Gap(on="x1", gap=rng.uniform(0.1, 0.3), stiffness=rng.uniform(5, 15)),
        vv.Jenkins(on="x1", stiffness=rng.uniform(1, 3), limit=rng.uniform(0.1, 0.3)),
        *(
            vv.FluidDamper(on="x1", coefficient=rng.uniform(0.05, 0.5), exponent=exponent)
            for exponent in (round(rng.uniform(0.3, 0.6), 2), 1.2)
        ),
    ]
    system = vv.Structure(mass=[1.0], stiffness=[1.0], damping=[0.1], elements=elements)
    load = rng.uniform(0.5, 1.5)
    runs = [vv.simulate(system, 30, load=load, nu=0.9, dt=dt) for dt in (0.05, 0.02, 0.008)]
    assert [run.outcome for run in runs] == ["completed"] * 3
    assert np.ptp([run.state[-1] for run in runs], axis=0).max() < 1e-9
