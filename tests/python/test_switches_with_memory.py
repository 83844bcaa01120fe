"""Friction, kinks and stops with kernels of exponentials in time: steps end at switches."""

import re

import mpmath as mp
import numpy as np
import pytest
import viscovib as vv
from referee.switched import Automaton, Contact, Fading, Sliders

WEIGHTS, RATES = [0.3, 12.0], [1.0, 40.0]
KERNEL = vv.PronyKernel(weights=WEIGHTS, rates=RATES)


def rubber(law="0.5*d^3", kernel=KERNEL):
    """A slider and a spring with memory, two masses."""
    return vv.Structure(
        mass=[1.0, 2.0], stiffness=[1.0, 2.0], damping=[0.05, 0.1],
        elements=[
            vv.Jenkins(on=("x1", "x2"), stiffness=3, limit=0.15),
            vv.Spring(on=("x1", "x2"), stiffness=2, law=law, kernel=kernel),
            vv.Gap(on="x2", stiffness=20, gap=0.2),
        ],
    )  # fmt: skip


def true_states(times, gap=np.inf):
    """Reference from switch to switch, with the equations of each mode."""

    def force(d, over):
        return 2 * d + (0.5 * d**3 if gap == np.inf else 0.5 * (d - gap) * over)

    between = np.array([1.0, -1.0])
    judge = Automaton(
        np.array([1.0, 2.0]), np.diag([1.0, 2.0]), np.diag([0.05, 0.1]),
        lambda t: np.array([0.9, 0.0]) * np.sin(1.3 * t),
        [Sliders(between, [3.0], [0.15]), Fading(between, force, WEIGHTS, RATES, gap),
         Contact(np.array([0.0, 1.0]), 20.0, 0.2, False)],
        [None] * 2, [None] * 2,
    )  # fmt: skip
    return judge.run([0.0, 0.0], [0.0, 0.0], times)


def run(system, end=8.0, **given):
    return vv.simulate(system, end, load={"x1": 0.9}, nu=1.3, **given)


@pytest.mark.parametrize(("law", "gap"), [("0.5*d^3", np.inf), ("0.5*max(d - 0.1, 0)", 0.1)])
def test_against_scipy_from_switch_to_switch(law, gap):
    """Sticking, slipping and contact, with and without a kernel on the law, to 1e-10."""
    times = np.linspace(0, 8, 5)
    true = true_states(times, gap)
    for given in ({"dt": 0.05}, {"tolerance": 1e-10}):
        found = run(rubber(law), times=times, **given)
        assert found.outcome == "completed"
        np.testing.assert_allclose(found.state, true, atol=2e-10)


def test_rates_much_faster_than_steps():
    """A start away from rest and switches cause layers of 1e-4 s, followed by divided steps."""
    stiff = vv.PronyKernel(weights=[0.3, 3e3], rates=[1.0, 1e4])
    run_of = {dt: run(rubber(kernel=stiff), initial=[0.3, 0, 0, 0], dt=dt) for dt in (0.1, 0.001)}
    np.testing.assert_allclose(run_of[0.1].state[-1], run_of[0.001].state[-1], atol=2e-10)


#: States at t = 8 by an independent program: a separate sum for each kernel (Gauss-Legendre panels
#: in the logarithm of the rates up to 1e10, faster rates at once), collocation of degree 10 with
#: steps from 1e-9 after each switch; equal to 2e-13 for half the step size.
SINGULAR = [
    (vv.RabotnovKernel(amplitude=0.5, alpha=0.5, beta=2.5), "0.5*d^3",
     [0.5106200202128, -1.1969465828250, -0.0389287491418, -0.9352788370457]),
    (vv.RabotnovKernel(amplitude=0.5, alpha=0.5, beta=2.5), "0.5*max(d - 0.1, 0)",
     [0.4698156631305, -1.2440860046112, -0.0571946090830, -0.9022556463331]),
    (vv.AbelKernel(amplitude=0.1, alpha=0.2), "0.5*d^3",
     [0.7323745592094, -1.0477858506794, 0.0898241234477, -1.0016700510895]),
    (vv.RzhanitsynKernel(amplitude=0.3, alpha=0.3, beta=1), "0.5*max(d - 0.1, 0)",
     [1.0307195561680, -0.8090133252156, 0.2399262943370, -0.8763261592984]),
]  # fmt: skip


@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
@pytest.mark.parametrize(("kernel", "law", "true"), SINGULAR)
def test_singular_kernels(kernel, law, true):
    """Sums are fitted for the step size, so halving it includes their error."""
    for given in ({"tolerance": 1e-8}, {"dt": 0.2, "estimate_error": True}):
        found = run(rubber(law, kernel), **given)
        assert found.outcome == "completed"
        off = np.abs(found.state[-1] - true).max()
        assert off < 5e-12
        assert off < 2 * found.error
    said = str(found.plan).partition("fitted for each step: ")[2]
    assert re.match(
        r"(about )?[5-8]\d( in a thousand steps)?, within (1e-12|5e-14) of R\(t\)", said
    )


@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
def test_error_counts_the_sum():
    """Long steps use the kernel from a larger lag on: only another sum shows this error."""
    kernel, law, true = SINGULAR[2]
    found = run(rubber(law, kernel), dt=8.0 / 7, estimate_error=True)
    off = np.abs(found.state[-1] - true).max()
    assert 1e-14 < off < 1e-5
    assert off < 2 * found.error
    # The rounding error of a motion of size 1 is 1e-15; common errors of two sums may be larger.
    assert run(rubber(law, kernel), tolerance=1e-8).error > 1e-12


@pytest.mark.parametrize("alpha", [0.05, 0.4])
@pytest.mark.parametrize("name", ["rzhanitsyn", "rabotnov"])
def test_what_is_over_before_the_shortest_lag(name, alpha):
    """Half of the kernel at small alpha: its impulse is exact, more accurate with short steps.

    The switch is never reached; the motion by its inverted Laplace transform (Talbot).
    """
    beta = 0.3
    if name == "rabotnov":
        kernel = vv.RabotnovKernel(amplitude=0.3 * beta, alpha=alpha, beta=beta)
    else:
        amplitude = float(0.3 * beta**alpha / mp.gamma(alpha))
        kernel = vv.RzhanitsynKernel(amplitude=amplitude, alpha=alpha, beta=beta)
    with mp.workdps(30):

        def moved(s):
            if name == "rabotnov":
                memory = mp.mpf(kernel.amplitude) / (s ** mp.mpf(alpha) + mp.mpf(beta))
            else:
                memory = mp.mpf(kernel.amplitude) * mp.gamma(mp.mpf(alpha))
                memory *= (s + mp.mpf(beta)) ** -mp.mpf(alpha)
            drag = s * s + mp.mpf(0.1) * s
            return mp.mpf(0.3) * (s + mp.mpf(0.1)) / (drag + 2 - memory)

        true = float(mp.invertlaplace(moved, 5.0, method="talbot", degree=40))
    system = vv.Structure(
        mass=[1.0], stiffness=[1.0], damping=[0.1],
        elements=[
            vv.Spring(on="x1", stiffness=1, kernel=kernel), vv.Gap(on="x1", stiffness=1, gap=9)
        ],
    )  # fmt: skip
    for dt, most in ((0.1, 1e-13), (0.0125, 5e-15)):
        found = vv.simulate(system, 5.0, initial=[0.3, 0.0], dt=dt)
        assert abs(found.state[-1, 0] - true) < most


def test_singular_kernels_go_on():
    """A resumed run uses the sum of the first run, as far as it is valid."""
    system = rubber(kernel=SINGULAR[0][0])
    before = run(system, 4.0, dt=0.1)
    whole, rest = run(system, dt=0.1), vv.simulate(system, 8, resume=before)
    np.testing.assert_allclose(rest.state[-1], whole.state[-1], atol=1e-12)
    free = vv.simulate(system, 8, resume=before, load=0, estimate_error=True)
    again = vv.simulate(system, 8, resume=run(system, 4.0, dt=0.05), load=0)
    np.testing.assert_allclose(free.state[-1], again.state[-1], atol=1e-12)
    with pytest.raises(vv.InputError, match="may go on to 400 at most"):
        vv.simulate(system, 500, resume=before)


def test_many_exponentials():
    """Terms with equal rates count as one, so that the stored states fit."""
    split = vv.PronyKernel(weights=np.repeat(WEIGHTS, 24) / 24, rates=np.repeat(RATES, 24))
    one, many = (run(rubber(kernel=kernel), dt=0.05) for kernel in (KERNEL, split))
    np.testing.assert_allclose(many.state, one.state, atol=1e-12)
    rest = vv.simulate(many.system, 16, resume=many, load=0)
    after = vv.simulate(one.system, 16, resume=one, load=0)
    np.testing.assert_allclose(rest.state, after.state, atol=1e-12)


def test_goes_on_bit_for_bit_and_under_other_loads():
    """Memory states are kept: as in one run under a load that changes."""
    system = rubber()
    before = run(system, 4.0, dt=0.02)
    whole, rest = run(system, dt=0.02), vv.simulate(system, 8, resume=before)
    np.testing.assert_array_equal(whole.state[-1], rest.state[-1])
    free = vv.simulate(system, 8, resume=before, load=0)
    nothing = vv.LoadTable(times=[0, 4, 8], values=[[0.7, 0], [0.7, 0], [0.7, 0]])
    pushed = vv.simulate(system, 8, resume=before, load=0, force=nothing)
    held = vv.simulate(system, 8, resume=before, load={0: [0.7j, 0]}, nu=0.0)
    np.testing.assert_allclose(pushed.state[-1], held.state[-1], atol=1e-11)
    assert np.abs(free.state[-1] - pushed.state[-1]).max() > 0.1
    # Without its past it would move differently.
    fresh = vv.simulate(system, 4, initial=before.state[-1], dt=0.02)
    assert np.abs(fresh.state[-1] - free.state[-1]).max() > 1e-3


def test_parts_behind_a_switch_go_on():
    """A run may be divided anywhere after a switch: step sizes double from there, bitwise equal."""
    stiff = rubber(kernel=vv.PronyKernel(weights=[0.2, 1e3], rates=[1.0, 2e3]))
    whole = run(stiff, dt=1 / 16, initial=[0.3, 0, 0, 0])
    for k in range(1, 128, 14):
        before = run(stiff, k / 16, dt=1 / 16, initial=[0.3, 0, 0, 0])
        rest = vv.simulate(stiff, 8, resume=before)
        np.testing.assert_array_equal(whole.state[-1], rest.state[-1])


@pytest.mark.parametrize("rate", [100.0, 500.0, 2000.0])
def test_jumps_of_loads_with_fast_rates(rate):
    """A rectangular load causes layers, in a table and in resumed runs: SciPy in pieces."""
    weights, rates = [0.2, 0.5 * rate], [1.0, rate]
    system = rubber(kernel=vv.PronyKernel(weights=weights, rates=rates))
    between, now = np.array([1.0, -1.0]), np.zeros(2)
    judge = Automaton(
        np.array([1.0, 2.0]), np.diag([1.0, 2.0]), np.diag([0.05, 0.1]), lambda t: now,
        [Sliders(between, [3.0], [0.15]),
         Fading(between, lambda d, over: 2 * d + 0.5 * d**3, weights, rates, np.inf),
         Contact(np.array([0.0, 1.0]), 20.0, 0.2, False)],
        [None] * 2, [None] * 2,
    )  # fmt: skip
    y, true = judge.start(np.zeros(2), np.array([0.3, 0.0])), []
    for begin, push in enumerate((0.0, 0.9, 0.0)):
        now[0] = push
        y = judge.stretch(y, float(begin), begin + 1.0)
        true.append(y[[0, 2, 1, 3]])
    box = vv.LoadTable(times=[1, 2], values=[[0.9, 0], [0.9, 0]])
    start = {"initial": [0, 0.3, 0, 0], "dt": 0.1}
    found = vv.simulate(system, 3, force=box, times=[1, 2, 3], estimate_error=True, **start)
    np.testing.assert_allclose(found.state, true, atol=2e-12)
    assert np.max(found.error) < 2e-12
    before = vv.simulate(system, 1, **start)
    pushed = vv.simulate(system, 2, resume=before, load={0: [0.9j, 0]}, nu=0.0)
    free = vv.simulate(system, 3, resume=pushed, load=0)
    np.testing.assert_allclose([pushed.state[-1], free.state[-1]], true[1:], atol=2e-12)


def test_order_at_switches_is_that_of_the_method():
    """Slow kernels, so that no parts are graded: steps divided by three, order 7 at least."""
    weights, rates = [0.1, 0.1], [0.3, 0.4]
    system = rubber("8*d^3", vv.PronyKernel(weights=weights, rates=rates))
    between, times = np.array([1.0, -1.0]), np.linspace(0, 8, 3)
    judge = Automaton(
        np.array([1.0, 2.0]), np.diag([1.0, 2.0]), np.diag([0.05, 0.1]),
        lambda t: np.array([0.9, 0.0]) * np.sin(1.3 * t),
        [Sliders(between, [3.0], [0.15]),
         Fading(between, lambda d, over: 2 * d + 8 * d**3, weights, rates, np.inf),
         Contact(np.array([0.0, 1.0]), 20.0, 0.2, False)],
        [None] * 2, [None] * 2,
    )  # fmt: skip
    true = judge.run([0.8, 0.0], [0.0, 0.0], times)
    errors = [
        np.abs(run(system, initial=[0.8, 0, 0, 0], dt=dt, times=times).state - true).max()
        for dt in (1.0, 1 / 3)
    ]
    assert 1e-9 < errors[0] < 1e-6
    assert np.log(errors[0] / errors[1]) / np.log(3) > 7


def test_events_and_means_are_of_coordinates():
    """Events may contain the time; hidden states are not reported."""
    found = run(rubber(), tolerance=1e-9, events=["x1 - 0.1", "t - 3", "x2_dot"])
    assert found.state.shape[1] == 4
    assert found.events[1].t == pytest.approx([3.0], abs=1e-12)
    np.testing.assert_allclose(found.events[0].state[:, 0], 0.1, atol=1e-9)
    np.testing.assert_allclose(found.events[2].state[:, 3], 0.0, atol=1e-9)


def test_stops_rest_and_friction_holds_with_memory():
    """A stop with contact at rest, and friction: driven by the relaxation of the spring."""
    stop = vv.Structure(
        mass=[1.0], stiffness=[0.0], damping=[0.1],
        elements=[
            vv.Gap(on="x1", gap=0.5, restitution=0.5),
            vv.Spring(on="x1", stiffness=1.0, kernel=vv.PronyKernel(weights=[0.5], rates=[1.0])),
        ],
    )  # fmt: skip
    at_rest = vv.simulate(stop, 12, load={0: [1j]}, nu=0.0)
    assert at_rest.state[-1] == pytest.approx([0.5, 0.0], abs=1e-12)
    assert 0 < at_rest.resting_since[0, 0] < 8
    held = vv.Structure(
        mass=[1.0], stiffness=[0.0],
        elements=[
            vv.Spring(on="x1", law="0.4*sign(v)"),
            vv.Spring(on="x1", stiffness=1.0, kernel=vv.PronyKernel(weights=[0.2], rates=[1.0])),
        ],
    )  # fmt: skip
    # Held near 1: the spring relaxes to 0.8 of its force, and friction holds permanently.
    still = vv.simulate(held, 30, load={0: [0.9j]}, nu=0.0)
    kept = still.state[still.t > 25]
    assert np.ptp(kept[:, 0]) < 1e-12
    assert np.abs(kept[:, 1]).max() < 1e-13


def test_what_is_refused_says_why():
    """Tables of points, too many exponentials, and `held`."""
    table = vv.TabulatedKernel(times=[0, 1, 2], values=[0.3, 0.1, 0.05])
    with pytest.raises(vv.InputError, match=r"needs kernels.*sum_of_exponentials"):
        run(rubber(kernel=table))
    many = vv.PronyKernel(weights=np.full(1100, 4e-4), rates=np.linspace(1, 70, 1100))
    with pytest.raises(vv.InputError, match="at most 1024 coordinates and exponentials"):
        run(rubber(kernel=many))
    sharp = [
        vv.Spring(
            on="x1", stiffness=1, law=f"{beta}*d^3",
            kernel=vv.RabotnovKernel(amplitude=0.1, alpha=0.99, beta=beta),
        )
        for beta in range(10, 101, 9)
    ]  # fmt: skip
    sharp = vv.Structure(
        mass=[1.0], stiffness=[1.0], elements=[vv.Jenkins(on="x1", stiffness=1, limit=0.1), *sharp]
    )
    with pytest.raises(vv.InputError, match="of them exponentials of forces that remember"):
        vv.simulate(sharp, 1000, dt=0.1, load=0.3, nu=1)
    with pytest.raises(vv.InputError, match="has the methods auto, gauss8, got method = "):
        run(rubber(), method="rk4")
    # The message for a wrong method does not name the kernel.
    for method in ("rk4", "gauss6"):
        with pytest.raises(vv.InputError, match=f"got method = {method!r}$"):
            run(rubber(kernel=table), method=method)
