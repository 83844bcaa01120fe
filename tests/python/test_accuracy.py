"""Requested accuracy in time: absolute, relative, and the reason if it is not reached."""

import math

import mpmath
import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp


def duffing(stiffness=1.0, cubic=1.0, damping=0.0):
    return vv.PolynomialSystem(
        mass=1, stiffness=stiffness, damping=damping, springs=[vv.Springs(forces=f"{cubic}*x^3")]
    )


def test_easy_conservative_motions_need_few_steps():
    """The step equations are solved to less than 0.1 of the tolerance; their errors add up."""
    rng = np.random.default_rng(1)
    for _ in range(8):
        k, c = rng.uniform(0.5, 2, 2)
        chain = vv.PolynomialSystem(
            mass=np.eye(2),
            stiffness=[[2 * k, -k], [-k, 2 * k]],
            springs=[vv.Springs(forces={"x1": f"{c}*x1^3"})],
        )
        run = vv.simulate(chain, 60, initial=[0.7, 0, 0, 0], keep="last")
        assert run.error <= 1e-10
        assert run.stats["steps"] <= 1500

    def slope(t, y):
        pull = 2 * k * y[0] - k * y[2] + c * y[0] ** 3, 2 * k * y[2] - k * y[0]
        return [y[1], -pull[0], y[3], -pull[1]]

    right = solve_ivp(slope, (0, 60), [0.7, 0, 0, 0], method="DOP853", rtol=1e-12, atol=1e-14)
    assert np.abs(run.state[-1] - right.y[:, -1]).max() < 1e-9


@pytest.mark.parametrize("kept", [{}, {"keep": "last"}, {"times": [25.0]}])
@pytest.mark.parametrize("kernel", [None, vv.PronyKernel(weights=[0.2], rates=[1.5])])
@pytest.mark.parametrize("seed", range(1))
def test_the_default_accuracy_does_not_depend_on_the_unit_of_length(seed, kernel, kept):
    """A motion in other units of length takes the same steps and gives the same scaled states."""
    rng = np.random.default_rng(seed)
    cubic, amplitude, nu = rng.uniform([0.2, 0.1, 0.5], [1.0, 0.5, 2.0]).tolist()

    def motion(unit):
        system = vv.PolynomialSystem(
            mass=1, stiffness=1, damping=0.05, forces=f"{cubic / unit**2!r}*x^3", kernel=kernel
        )
        start = [unit, 0.5 * unit]
        return vv.simulate(system, 25, initial=start, load=amplitude * unit, nu=nu, **kept)

    one = motion(1.0)
    assert one.error <= 1e-10 * max(1.2, np.abs(one.state).max())
    for unit in (2.0**-30, 2.0**20):
        other = motion(unit)
        assert other.stats["steps"] == one.stats["steps"]
        np.testing.assert_allclose(other.state / unit, one.state, rtol=0, atol=1e-12)
        assert other.error / unit <= 1e-10 * max(1.2, np.abs(one.state).max())


@pytest.mark.parametrize("start", [[1.0, 0.0], [0.0, 1.0]])
@pytest.mark.parametrize("end", [0.5 * math.pi, 40 * math.pi])
@pytest.mark.parametrize("wanted", [{}, {"rtol": 1e-8}])
def test_the_size_of_a_motion_is_not_that_of_its_last_state(start, end, wanted):
    """The final displacement or velocity of these motions is 0."""
    linear = vv.PolynomialSystem(mass=1, stiffness=1)
    turned = np.array([[math.cos(end), math.sin(end)], [-math.sin(end), math.cos(end)]]) @ start
    for kept in ({"keep": "last"}, {"times": [end]}):
        run = vv.simulate(linear, end, initial=start, **kept, **wanted)
        off = np.abs(run.state[-1] - turned).max()
        assert off <= run.error <= wanted.get("rtol", 1e-10)


def test_errors_of_long_motions_without_damping_are_bounded():
    """Rounding errors of the energy accumulate: the phase error grows as the square of the time."""
    rng = np.random.default_rng(13)
    periods = 10_000
    for _ in range(4):
        cubic, size = rng.uniform([0.2, 0.5], [1.0, 1.2]).tolist()
        with mpmath.workdps(40):
            squared = mpmath.mpf(cubic) * mpmath.mpf(size) ** 2
            end = 2 * math.pi * periods
            phase, m = mpmath.sqrt(1 + squared) * mpmath.mpf(end), squared / (2 + 2 * squared)
            right = float(size * mpmath.ellipfun("cn", phase, m=m))
        system = vv.PolynomialSystem(mass=1, stiffness=1, forces=f"{cubic!r}*x^3")
        run = vv.simulate(
            system, end, initial=[size, 0], keep="last", dt=0.1 * math.pi, estimate_error=True
        )
        assert abs(run.state[-1, 0] - right) <= run.error < 1e-6


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e4])
def test_relative_accuracy_is_the_same_at_every_size(size):
    linear = vv.PolynomialSystem(mass=1, stiffness=4, damping=0.1)
    run = vv.simulate(linear, 10, initial=[size, 0], rtol=1e-8)
    root = complex(-0.05, math.sqrt(4 - 0.05**2))
    right = size * (np.exp(root * run.t) * (1 + 1j * root.real / root.imag)).real
    assert np.abs(run.state[:, 0] - right).max() <= 1e-8 * size
    assert 0 < run.error <= 1e-8 * np.abs(run.state).max()


def test_peaks_between_the_states_kept_are_low():
    shock = vv.LoadTable(
        times=np.linspace(0.1, 0.111, 12), values=100 * np.sin(np.linspace(0, np.pi, 12))
    )
    system = vv.PolynomialSystem(mass=1, stiffness=(20 * math.pi) ** 2, damping=2.0)
    run = vv.simulate(system, 0.5, force=shock)
    fine = vv.simulate(system, 0.5, force=shock, dt=1e-4)
    largest = np.abs(fine.state[:, 0]).max()
    assert abs(np.abs(run.state[:, 0]).max() / largest - 1) < 2e-3
    free = vv.simulate(duffing(), 30, initial=[1, 0])
    between = vv.simulate(duffing(), 30, initial=[1, 0], times=np.linspace(0, 30, 4001))
    assert np.abs(np.interp(between.t, free.t, free.state[:, 0]) - between.state[:, 0]).max() < 2e-3


def test_no_error_is_zero_but_of_no_motion():
    linear = vv.PolynomialSystem(mass=1, stiffness=4)
    assert vv.simulate(linear, 10).error == 0
    assert vv.simulate(linear, 10, initial=[1, 0]).error > 0


@pytest.mark.parametrize(
    ("system", "arguments", "message"),
    [
        (
            vv.PolynomialSystem(mass=1, stiffness=4),
            {"initial": [9e5, 0], "tolerance": 1e-10},
            "give rtol",
        ),
        (
            duffing(stiffness=-1.0, damping=0.25),
            {"initial": [0.1, 0], "load": 0.3, "nu": 1.0, "t_end": 300},
            "agree to t = .*chaotic or unstable",
        ),
        # In a long run a perturbation grows early.
        (
            duffing(stiffness=-1.0, damping=0.1),
            {"initial": [0.1, 0], "load": 0.3, "nu": 1.2, "t_end": 3000},
            "agree to t = .*chaotic or unstable",
        ),
        # A single state cannot show chaos.
        (
            duffing(stiffness=-1.0, damping=0.1),
            {"initial": [0.1, 0], "load": 0.3, "nu": 1.2, "t_end": 1000, "keep": "last"},
            "not resolved, or the motion is chaotic",
        ),
        (
            vv.PolynomialSystem(mass=1, stiffness=1, forces="0.2*sign(x_dot)"),
            {"load": 1, "nu": 0.8, "t_end": 3000, "tolerance": 1e-12, "keep": "last"},
            "the rounding error is about",
        ),
    ],
)
def test_the_cause_is_named(system, arguments, message):
    with pytest.raises(vv.InputError, match=message):
        vv.simulate(system, arguments.pop("t_end", 40), **arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"rtol": 1e-8, "tolerance": 1e-8}, "give only one of them"),
        ({"rtol": 1e-15}, "rtol = 1e-15: must be in"),
        ({"atol": 0}, "atol = 0: must be greater than 0"),
        ({"rtol": 1e-8, "dt": 0.1}, "must not be given with dt"),
    ],
)
def test_bad_accuracies(arguments, message):
    with pytest.raises(vv.InputError, match=message):
        vv.simulate(duffing(), 10, initial=[1, 0], **arguments)


def test_ensembles_take_relative_accuracies():
    pendulum = vv.Pendulum(e=0.1, w2=0.4, w3=0.8)
    starts = np.array([[0, 0, size, 0, 0, 0] for size in (0.05, 0.1, 0.2)])
    loose = vv.simulate_ensemble(pendulum, initial=starts, t_end=20, rtol=1e-4)
    tight = vv.simulate_ensemble(pendulum, initial=starts, t_end=20, tolerance=1e-12)
    sizes = np.abs(tight.state).max(axis=0)
    assert (np.abs(loose.state - tight.state) <= 1e-4 * sizes.clip(1e-6 * sizes.max())).all()
    assert loose.error > 0


def test_a_corner_behind_memory_is_no_chaos():
    """With memory="direct" steps do not end at corners: the message states this, not chaos."""
    kernel = vv.RzhanitsynKernel(amplitude=0.05, alpha=0.5, beta=0.5)
    system = vv.PolynomialSystem(
        mass=1, stiffness=1, damping=0.1, forces="2*heaviside(x - 0.1)*x_dot", kernel=kernel
    )
    with pytest.raises(vv.InputError, match="jump or corner at which no step ends"):
        vv.simulate(
            system, 15, initial=[0.2, 0], load=0.5, nu=1.0, dt="auto", tolerance=1e-6,
            memory="direct",
        )  # fmt: skip


LAWS = {
    "0.5*x^3": lambda x: 0.5 * x**3,
    "0.3*tanh(4*x)": lambda x: 0.3 * np.tanh(4 * x),
    "0.2*tanh(20*x)": lambda x: 0.2 * np.tanh(20 * x),
    "exp(3*x) - 1": lambda x: np.exp(3 * x) - 1,
    "0.5*max(x - 0.1, 0)": lambda x: 0.5 * np.maximum(x - 0.1, 0),
}


WEIGHTS, RATES = np.array([0.3, 1.5]), np.array([0.8, 5.0])


def remembering(law, k):
    """Return an oscillator with memory and its ordinary differential equations."""
    system = vv.PolynomialSystem(
        mass=1, stiffness=k, damping=0.1, springs=[vv.Springs(forces=law)],
        kernel=vv.PronyKernel(weights=WEIGHTS, rates=RATES),
    )  # fmt: skip

    def slope(t, y):
        pull = 0.1 * y[1] + k * (y[0] - WEIGHTS @ y[2:]) + LAWS[law](y[0])
        return np.concatenate([[y[1], -pull], y[0] - RATES * y[2:]])

    return system, slope


@pytest.mark.parametrize("tolerance", [1e-6, 1e-8, 1e-10])
def test_states_inside_steps_are_as_exact_as_reported(tolerance):
    """Dense output between step ends, where steps are longer than the distance of stored states."""
    rng = np.random.default_rng(5)
    fewer = 0
    for law in list(LAWS)[:4] * 2:
        system, slope = remembering(law, rng.uniform(0.5, 4))
        start = [rng.uniform(0.3, 0.8), 0]
        run = vv.simulate(system, 12, initial=start, tolerance=tolerance)
        right = solve_ivp(
            slope, (0, 12), [*start, 0, 0], "DOP853", t_eval=run.t, rtol=1e-13, atol=1e-14,
            max_step=0.05,
        ).y[:2].T  # fmt: skip
        assert np.abs(run.state - right).max() <= run.error + 1e-11
        assert run.error <= tolerance
        fewer += run.stats["steps"] < run.t.size - 1
        longer = vv.simulate(system, 18, resume=run)
        assert np.diff(longer.t).max() < 1.01 * np.diff(run.t).max()
    # A tighter tolerance may need more steps to confirm the states.
    assert fewer >= 2 or tolerance < 1e-9


@pytest.mark.parametrize("tolerance", [None, 1e-8, 1e-5])
def test_smooth_motions_take_few_steps_and_tell_their_errors(tolerance):
    """The finer of two runs has far less error than they differ, also between ends of steps."""
    pendulum = vv.Pendulum(
        e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01, f0=0.005, m01=0.0025,
        m02=0.005, p1=0.93, p2=0.37, p3=0.71,
    )  # fmt: skip
    start = [0.05, 0, 0.3, 0, -0.2, 0]
    run = vv.simulate(pendulum, 100, initial=start, tolerance=tolerance)
    # Near both ends of the run, too, the states do not need shorter steps.
    assert run.stats["steps"] <= (280 if tolerance is None else 140) < run.t.size
    given = dict(t_eval=run.t, rtol=1e-13, atol=1e-14, max_step=0.1)
    right = solve_ivp(pendulum.rhs, (0, 100), start, "DOP853", **given).y.T
    # The reference has an error, too.
    assert np.abs(run.state - right).max() <= run.error + 1e-12
    assert run.error <= (tolerance or 1e-10)
    last = vv.simulate(pendulum, 100, initial=start, tolerance=tolerance, keep="last")
    assert last.stats["steps"] <= 140
    assert np.abs(last.state - right[-1]).max() <= last.error <= (tolerance or 1e-10)


def test_unstable_motions_tell_what_their_equations_leave():
    """Errors of the equations of steps grow a million times as large until the end."""
    pendulum = vv.Pendulum(
        e=0.08387699202230699, w2=0.55136251357748, w3=0.2972688379964675,
        alpha=0.25293973197999575, c1=0.001475519235475009, c2=0.009934672051365017,
        c3=0.0033166275878903206, f0=0.0004217851112664639, m01=0.001716294600229289,
        m02=0.0036105528482533824, p1=1.8964719020737273, p2=1.079914701889223,
        p3=0.976098475175281,
    )  # fmt: skip
    start, end = [0.11846773, -0.18785727, 0.02759224, 0.561747, 0.05091384, 0.412613], 109.14938
    for tolerance in (1e-4, 8.445e-5, 3e-5, 1e-5):
        run = vv.simulate(pendulum, end, initial=start, tolerance=tolerance)
        times = run.t[1:]
        right = vv.simulate(pendulum, end, initial=start, times=times, dt=end / 4224)
        assert np.abs(run.state[1:] - right.state).max() <= run.error <= tolerance


def test_states_between_ends_with_memory_need_no_shorter_steps():
    rubber = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
    mount = vv.Mount(
        mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, kernel=rubber
    )
    run = vv.simulate(mount, 50, load=0.5, nu=1.5)
    fine = vv.simulate(mount, 50, load=0.5, nu=1.5, dt=50 / (2 * (run.t.size - 1)), save_every=2)
    assert 2 * run.stats["steps"] < run.t.size
    assert np.abs(run.state - fine.state).max() <= run.error <= 1e-10 * np.abs(run.state).max()


@pytest.mark.parametrize("method", ["gauss3", "gauss4", "gauss6", "gauss8"])
def test_methods_of_low_order_tell_the_errors_inside_their_steps(method):
    """Errors inside steps: at step ends these methods are far more accurate."""
    rng = np.random.default_rng(3)
    for _ in range(4):
        n = 5
        k = rng.uniform(0.3, 2, n + 1)
        stiffness = np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
        stiffness[0, 0] += 100
        system = vv.Structure(
            mass=rng.uniform(0.5, 2, n), stiffness=stiffness,
            elements=[
                vv.Spring(on="x3", stiffness=0.2, law="0.07*d^2 + 0.9*d^3", damping=0.1),
                vv.Spring(on={"x2": 1, "x5": -1}, stiffness=0.1, law="0.3*d^3"),
            ],
        )  # fmt: skip
        given = dict(initial=rng.uniform(-0.5, 0.5, 2 * n), t_end=7.0)
        run = vv.simulate(system, method=method, tolerance=1e-8, **given)
        right = vv.simulate(system, tolerance=1e-13, **given)(run.t)
        assert np.abs(run.state - right).max() <= 2 * run.error + 1e-12
        assert run.error <= 1e-8


def test_an_error_in_the_first_step_is_seen():
    """Panels of the first step and those of half the step must not share nodes."""
    system, slope = remembering("0.5*max(x - 0.1, 0)", 0.6887574583357975)
    start = [0.4916844403927591, 0]
    right = solve_ivp(slope, (0, 12), [*start, 0, 0], "DOP853", rtol=1e-12, atol=1e-13).y[:2, -1]
    for dt in (3.0, 1.5, 0.75):
        run = vv.simulate(system, 12, initial=start, dt=dt, estimate_error=True, memory="direct")
        assert np.abs(run.state[-1] - right).max() <= 3 * run.error


def test_growth_of_roundings_is_in_the_error():
    """Rounding errors of the parameters are equal in all runs, so differences do not show them.

    Reference: extrapolated midpoint steps in quadruple precision, at two tolerances that agree to
    2e-11.
    """
    near_chaos = vv.Pendulum(
        e=0.034886, w2=0.846614, w3=1.131382, alpha=0.5, c1=0.01, c2=0.01, c3=0.03, f0=0.134902,
        m01=0.021876, m02=0.023002, p1=2.044942, p2=0.991777, p3=0.88864,
    )  # fmt: skip
    start = [-0.2172, 0.139, -0.1622, -0.0997, -0.2143, -0.1478]
    right = [
        0.13468971674374552, -0.1933858031815513, -0.1403792023790578, 0.0417605430169101,
        -0.8000846937704145, -0.351981364284461,
    ]  # fmt: skip
    run = vv.simulate(near_chaos, 183, initial=start, tolerance=1e-6, keep="last")
    assert np.abs(run.state[-1] - right).max() <= run.error <= 1e-6
    with pytest.raises(
        vv.InputError, match="amplifies rounding errors of the numbers of the system"
    ):
        vv.simulate(near_chaos, 183, initial=start, tolerance=3e-8, keep="last")


@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
def test_errors_hold_what_kernels_leave():
    """Against runs with 1e-12, which use other sums of exponentials for singular kernels."""
    rng = np.random.default_rng(3)
    for _ in range(4):
        draw = rng.uniform((0.02, 0.2, 0, 0.1, -1, -1, 10), (0.2, 0.8, 0.1, 1, 1, 1, 20))
        amplitude, alpha, damping, cubic, x, v, end = draw.tolist()
        system = vv.PolynomialSystem(
            mass=1, damping=damping, stiffness=1, forces=f"{cubic!r}*x^3",
            kernel=vv.AbelKernel(amplitude=amplitude, alpha=alpha),
        )  # fmt: skip
        given = {"initial": [x, v], "load": 0.5, "nu": 1.1}
        run = vv.simulate(system, end, tolerance=10 ** rng.uniform(-7, -3), **given)
        exact = vv.simulate(system, end, tolerance=1e-12, times=run.t, **given)
        assert np.abs(run.state - exact.state).max() <= run.error + exact.error


#: A body in two wells: first chaos, finally a periodic motion in either well.
WELLS = vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.1, forces="x^3")


LOAD = {"load": 0.4, "nu": 1.2}


@pytest.mark.parametrize(
    "kept", [{"keep": "last"}, {"keep": "tail", "tail": 5.0}, {"times": [1e3]}]
)
def test_what_is_kept_is_not_all_that_is_compared(kept):
    """A reported final state is also reached by neighbouring starts."""
    draw, refused = np.random.default_rng(3), 0
    for _ in range(12):
        start = np.array([draw.uniform(-0.3, 0.3), 0.0])
        ends = []
        for nearby in (0, 4e-11):
            try:
                run = vv.simulate(WELLS, 1000, initial=start + nearby, **LOAD, **kept)
            except vv.InputError as error:
                refused += "differ before the end" in str(error) or "chaotic" in str(error)
                continue
            ends.append(run.state[-1])
        if len(ends) == 2:
            assert np.abs(ends[1] - ends[0]).max() < 1e-5
    assert refused > 6


def test_motions_that_stay_together_are_reported():
    """Large motions that decay keep the tolerance relative to their final size."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.2, forces="x^3")
    whole = vv.simulate(system, 400, initial=[50.0, 0.0], load=0.1, nu=0.7, tolerance=1e-8)
    last = vv.simulate(
        system, 400, initial=[50.0, 0.0], load=0.1, nu=0.7, keep="last", tolerance=1e-10
    )
    assert np.abs(last.state[-1] - whole.state[-1]).max() < 2e-8
