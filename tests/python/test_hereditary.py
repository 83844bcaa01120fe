"""Motion with memory: against independent programs, harmonic balance and roots."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp
from tables import lines_without_plan

DATA = Path(__file__).parents[2] / "data"
REFERENCE = json.loads((DATA / "mount_memory_reference.json").read_text())["time_domain"]


@pytest.mark.parametrize("case", REFERENCE, ids=lambda case: f"{case['start']} t={case['t']}")
@pytest.mark.parametrize("memory", ["exponentials", "direct"])
def test_reference_values(mount, case, memory):
    # Direct sums with 200 steps or more are slower and not more accurate.
    if memory == "direct" and case["t"] > 10:
        pytest.skip("the same weights as in the shorter runs")
    system = mount(case["A"], cubic_scale=1.0 if case["nonlinear"] else 0.0)
    free = case["nu"] is None
    start = [0.1, 0, 0.05, 0] if free else None
    load = {} if free else {"load": 0.5, "nu": case["nu"]}
    run = vv.simulate(system, case["t"], dt=0.1, initial=start, memory=memory, **load)
    expected = [float(value) for value in case["value"]]
    assert run.outcome == "completed"
    # The nonlinear values have 11 correct digits or more, see data/README.md.
    assert np.abs(run.state[-1, ::2] - expected).max() < (1e-12 if case["nonlinear"] else 1e-13)


@pytest.mark.parametrize(
    "kernel",
    [
        vv.AbelKernel(amplitude=0.1, alpha=0.2),
        vv.RabotnovKernel(amplitude=0.3, alpha=0.5, beta=1.0),
        vv.RzhanitsynKernel(amplitude=0.1, alpha=0.3, beta=0.05),
    ],
)
@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
def test_the_error_tells_what_sums_of_exponentials_leave(kernel):
    """Their quadrature nodes coincide for steps h and h/2 if the spacing is log(2)."""
    body = vv.Mount(
        mass=1.9, inertia=0.3, offset=0.4, stiffness_x=9, stiffness_phi=3, kernel=kernel
    )

    def run(tolerance):
        return vv.simulate(body, 5, load=[0.3, 0], nu=1.1, tolerance=tolerance, times=[2.5, 5])

    right = run(1e-12).state
    for tolerance in (1e-3, 1e-4, 5e-5, 1e-5):
        reported = run(tolerance)
        assert np.abs(reported.state - right).max() < 2 * reported.error < 2 * tolerance


def test_step_found_by_tolerance(mount):
    for tolerance in (1e-6, 1e-10):
        run = vv.simulate(mount(), 100, load=0.5, nu=1.5, tolerance=tolerance)
        expected = [-7.857499117945091e-01, -8.354445983421139e-01]
        assert run.error <= tolerance
        assert np.abs(run.state[-1, ::2] - expected).max() <= tolerance


@pytest.mark.parametrize("method", ["gauss2", "gauss3", "gauss4", "gauss6", "gauss8"])
def test_methods_agree(mount, method):
    best = vv.simulate(mount(), 5, dt=0.05, load=0.5, nu=1.5).state[-1]
    steps = {"gauss2": 0.002, "gauss3": 0.01}.get(method, 0.02)
    other = vv.simulate(mount(), 5, dt=steps, load=0.5, nu=1.5, method=method).state[-1]
    assert np.abs(other - best).max() < 2e-10


def test_error_falls_with_the_step(mount):
    exact = [8.706100051384379e-01, 9.234816022517897e-01]
    errors = [
        np.abs(
            vv.simulate(mount(), 10, dt=dt, load=0.5, nu=1.5, method="gauss4").state[-1, ::2]
            - exact
        ).max()
        for dt in (0.5, 0.125)
    ]
    assert math.log(errors[0] / errors[1], 4) > 6


@pytest.mark.parametrize("geometry", ["cubic", "exact"])
def test_long_run_is_the_steady_response(mount, geometry):
    system = mount(geometry=geometry)
    n, orders = 64, (1, 3, 5)
    t = 700 + 2 * np.pi / 1.5 * np.arange(n) / n
    run = vv.simulate(system, t[-1], dt=0.125, load=0.5, nu=1.5, times=t)
    steady = vv.forced_response(system, [1.5], load=0.5, method="newton", harmonics=25)
    for d in range(2):
        for order in orders:
            found = 2j * np.mean(run.state[:, 2 * d] * np.exp(-1.5j * order * t))
            balance = steady.coefficients[0, d, list(steady.harmonics).index(order)]
            assert abs(found - balance) < 1e-12


def test_slow_mode_grows_like_its_root(mount):
    with pytest.warns(vv.StabilityWarning):
        system = mount(0.078, cubic_scale=0.0)
    period = 2 * np.pi / 1.5
    t = np.concatenate([start + period * np.arange(16) / 16 for start in (5000.0, 19990.0)])
    with pytest.warns(vv.StabilityWarning, match=r"exp\(0.0006236 t\)"):
        run = vv.simulate(system, t[-1], dt=0.5, load=0.5, nu=1.5, times=t)
    means = run.state[:16, 0].mean(), run.state[16:, 0].mean()
    rate = math.log(means[1] / means[0]) / 14990
    assert rate == pytest.approx(6.235198e-4, rel=2e-6)
    # The growth rate is the largest real root.
    assert rate == pytest.approx(system.characteristic_roots().real[0], rel=1e-4)


def test_free_decay_has_the_characteristic_roots(mount):
    system = mount(cubic_scale=0.0)
    run = vv.simulate(system, 40, dt=0.05, initial=[0.1, 0, 0.05, 0])
    decay = vv.free_decay(run, start=5)
    roots = system.characteristic_roots()
    for root, decrement in zip(roots.oscillatory, roots.logarithmic_decrement, strict=True):
        nearest = np.abs(decay.roots - root).argmin()
        assert abs(decay.roots[nearest] - root) < 1e-6
        assert decay.logarithmic_decrement[nearest] == pytest.approx(decrement, abs=1e-5)
    assert decay.residual < 1e-5


def test_creep_goes_to_the_relaxed_stiffness(mount):
    """Under a constant force the displacement approaches that of K (1 - integral of R)."""
    system = mount(0.02, cubic_scale=0.0, damping=[[2.0, 0], [0, 0.2]])
    run = vv.simulate(system, 400, dt=0.2, load={0: [0.1j, 0]}, keep="last")
    stiffness = np.array([[10, -5], [-5, 4.5]]) * (1 - system.kernel.integral)
    assert run.state[-1, ::2] == pytest.approx(np.linalg.solve(stiffness, [0.1, 0]), rel=1e-7)


@pytest.mark.parametrize("memory", ["exponentials", "direct"])
def test_what_was_held_is_remembered(mount, memory):
    """Held for ever by the relaxed force, the body stays where it is."""
    system = mount(cubic_scale=0.0)
    where = np.array([0.1, 0.05])
    force = np.array([[10, -5], [-5, 4.5]]) @ where * (1 - system.kernel.integral)
    run = vv.simulate(system, 5, dt=0.2, load={0: 1j * force}, held=where, memory=memory)
    assert np.abs(run.state - [0.1, 0, 0.05, 0]).max() < 1e-15
    # A body that came to rest there long ago under that force moves in the same way when released.
    let_go = vv.simulate(system, 5, dt=0.2, held=where, memory=memory)
    fresh = vv.simulate(system, 5, dt=0.2, initial=[0.1, 0, 0.05, 0], memory=memory)
    assert np.abs(let_go.state[-1] - fresh.state[-1]).max() > 1e-3


@pytest.mark.parametrize("memory", ["exponentials", "direct"])
def test_runs_go_on_bit_for_bit(mount, memory):
    job = {"dt": 0.1, "initial": [0.1, 0, 0.05, 0], "load": 0.5, "nu": 1.5, "memory": memory}
    whole = vv.simulate(mount(), 12, **job)
    part = vv.simulate(mount(), 5, **job)
    rest = vv.simulate(mount(), 12, resume=part)
    again = vv.simulate(mount(), 12, resume=part)
    short = vv.simulate(mount(), 0.2, **job)
    if memory == "direct":
        assert (rest.state[-1] == whole.state[-1]).all()
    # Kernel sums are valid for 100 times the intended run time, so other end times differ.
    assert np.abs(rest.state[-1] - whole.state[-1]).max() < 1e-13
    assert (rest.state == again.state).all()
    assert np.abs(vv.simulate(mount(), 12, resume=short).state[-1] - whole.state[-1]).max() < 1e-12
    halves = vv.simulate(mount(), 12, resume=vv.simulate(mount(), 7, resume=part))
    assert (halves.state[-1] == rest.state[-1]).all()
    with pytest.raises(vv.InputError, match="may go on to 20 at most"):
        vv.simulate(mount(), 21, resume=short)


@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
def test_other_kernels_fast_and_direct(mount):
    kernels = {
        "prony": vv.PronyKernel(weights=[0.02, 0.5, 3.0], rates=[0.1, 2.0, 50.0]),
        "abel": vv.AbelKernel(amplitude=0.05, alpha=0.4),
        "rabotnov": vv.RabotnovKernel(amplitude=0.3, alpha=0.6, beta=0.8),
        "alpha 0.01": vv.RzhanitsynKernel(amplitude=0.005, alpha=0.01, beta=0.05),
        "alpha 1": vv.RzhanitsynKernel(amplitude=0.1, alpha=1.0, beta=0.5),
    }
    for name, kernel in kernels.items():
        system = mount(kernel=kernel, kernel_phi=False if name == "abel" else None)
        job = {"dt": 0.1, "initial": [0.1, 0, 0.05, 0], "load": 0.2, "nu": 1.5}
        fast = vv.simulate(system, 3, memory="exponentials", **job)
        direct = vv.simulate(system, 3, memory="direct", **job)
        assert np.abs(fast.state - direct.state).max() < 1e-11, name


def test_tables_run_directly_or_as_a_fit(mount):
    smooth = vv.PronyKernel(weights=[0.2, 0.05], rates=[2.0, 0.1])
    t = np.linspace(0, 60, 6001)
    table = vv.TabulatedKernel(times=t, values=np.append(smooth([1e-9]), smooth(t[1:])))
    job = {"dt": 0.1, "load": 0.5, "nu": 1.5}
    exact = vv.simulate(mount(kernel=smooth), 10, **job)
    run = vv.simulate(mount(kernel=table), 10, **job)
    assert np.abs(run.state - exact.state).max() < 1e-5
    with pytest.warns(vv.ConvergenceWarning, match="not the tolerance 1.0e-10"):
        fit = table.sum_of_exponentials(t_min=0.01, t_max=50)
    assert isinstance(fit, vv.PronyKernel)
    assert fit.error < 1e-3
    fitted = vv.simulate(mount(kernel=fit), 10, **job)
    assert np.abs(fitted.state - exact.state).max() < 1e-3
    with pytest.raises(vv.InputError, match="not a sum of exponentials"):
        vv.simulate(mount(kernel=table), 10, memory="exponentials", **job)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-12])
@pytest.mark.parametrize("alpha", [0.01, 0.5, 1.0])
def test_sums_of_exponentials(alpha, tolerance):
    kernel = vv.RzhanitsynKernel(amplitude=0.3, alpha=alpha, beta=0.02)
    fast = kernel.sum_of_exponentials(tolerance=tolerance, t_min=1e-3, t_max=100)
    assert fast.error <= tolerance
    assert (np.asarray(fast.weights) > 0).all()
    t = np.geomspace(1e-3, 100, 777)
    assert np.abs(fast(t) / kernel(t) - 1).max() <= tolerance


def test_large_motion_in_large_steps(mount):
    """Where the simple iteration converges slowly (14 per step), Newton's method is used."""
    system = mount(damping=[[0.5, 0], [0, 0.05]], geometry="exact")
    coarse = vv.simulate(system, 2, dt=0.1, load=300.0, nu=1.5)
    fine = vv.simulate(system, 2, dt=0.01, load=300.0, nu=1.5)
    assert np.abs(coarse.state[-1]).max() > 80
    assert np.abs(coarse.state[-1] - fine.state[-1]).max() < 1e-3
    assert coarse.stats["iterations"] < 10 * coarse.stats["steps"]


def test_steps_too_large_stop_with_an_outcome(mount):
    run = vv.simulate(mount(), 100, dt=20.0, load=500.0, nu=1.5)
    assert run.outcome == "step too large"
    assert run.t.size == run.t_reached / run.step + 1


def test_table_and_dataset(mount, tmp_path):
    run = vv.simulate(mount(), 1, dt=0.1, initial=[0.1, 0, 0.05, 0])
    run.to_csv(tmp_path / "run.csv")
    lines = lines_without_plan(tmp_path / "run.csv")
    assert lines[2:4] == ["# units: t in s, x in m, phi in rad", "t,x,x_dot,phi,phi_dot"]
    data = run.to_dataset()
    assert data["phi_dot"].attrs["units"] == "rad/s"
    assert data["t"].attrs["units"] == "s"
    with pytest.raises(vv.InputError, match="for pendulums only"):
        run.energy_defect()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"load": 0.5}, "nu: must be given with a load"),
        ({"nu": 1.5}, "nu: must not be given without load or base"),
        ({"initial": [0, 0]}, r"initial: must have shape \(4,\), got \(2,\)"),
        ({"initial": [0, math.nan, 0, 0]}, r"initial\[1\] = nan"),
        ({"held": [0, 0, 0]}, r"held: must have shape \(2,\)"),
        ({"method": "rk4"}, "method = 'rk4'"),
        ({"memory": "none"}, "memory = 'none'"),
        ({"force": [1, 2]}, "must be a LoadTable"),
        ({"dt": 11}, "dt = 11"),
    ],
)
def test_bad_input(mount, arguments, message):
    with pytest.raises(vv.InputError, match=message):
        vv.simulate(mount(), 10, **arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"times": [0, 1, 1], "values": [0, 0, 0]}, r"times\[2\] = 1 after 1"),
        ({"times": [0], "values": [0]}, "times: must have shape"),
        ({"times": [0, 1], "values": [0, math.inf]}, r"values\[1\] = inf"),
        ({"times": [0, 1], "values": [0, 0, 0]}, "values: must have shape"),
        ({"times": [0, 1], "values": [0, 0], "interpolation": "step"}, "interpolation = 'step'"),
    ],
)
def test_bad_load_tables(arguments, message):
    with pytest.raises(vv.InputError, match=message):
        vv.LoadTable(**arguments)


@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
def test_held_needs_an_integral(mount):
    with pytest.raises(
        vv.InputError, match="held: must be None, because a kernel has no finite integral"
    ):
        vv.simulate(
            mount(kernel=vv.AbelKernel(amplitude=0.01, alpha=0.5)), 1, dt=0.1, held=[0.1, 0]
        )


def test_pendulums_take_no_loads():
    body = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, alpha=0.5)
    with pytest.raises(vv.InputError, match="load: is for a Mount"):
        vv.simulate(body, 1, initial=np.zeros(6), load=1.0)


@pytest.mark.parametrize("geometry", ["cubic", "exact"])
def test_a_known_past_is_remembered(mount, geometry):
    """A run divided at t = 4; its first part is the past of the second."""
    system = mount(geometry=geometry)
    cut, n = 4.0, 400
    early = cut * np.arange(n + 1) / n
    times = np.concatenate([early, [5.0, 8.0]])
    whole = vv.simulate(system, 8, dt=0.05, load=0.5, nu=1.5, times=times)
    errors = []
    for thin in (1, 2):
        past = vv.Past(times=early[::thin] - cut, displacements=whole.state[: n + 1 : thin, ::2])
        rest = vv.simulate(
            system, 4, dt=0.05, load=0.5 * np.exp(1.5j * cut), nu=1.5,
            initial=whole.state[n], held=past, times=[1.0, 4.0],
        )  # fmt: skip
        errors.append(np.abs(rest.state - whole.state[n + 1 :]).max())
    # Linear interpolation between the times: an error of second order.
    assert errors[0] < 2e-6
    assert errors[1] / errors[0] == pytest.approx(4, rel=0.05)
    forgetful = vv.simulate(
        system, 4, dt=0.05, load=0.5 * np.exp(1.5j * cut), nu=1.5, initial=whole.state[n],
        times=[1.0, 4.0],
    )  # fmt: skip
    assert np.abs(forgetful.state - whole.state[n + 1 :]).max() > 1e-2


def test_a_past_is_the_same_directly_and_as_what_was_held(mount):
    still = vv.Past(times=[-3, -1, 0], displacements=[[0.1, 0.05]] * 3)
    one = vv.simulate(mount(), 2, dt=0.1, held=still)
    two = vv.simulate(mount(), 2, dt=0.1, held=[0.1, 0.05])
    assert np.abs(one.state - two.state).max() < 1e-15
    swing = vv.Past(times=[-2, -1, -0.3, 0], displacements=[[0, 0], [0.2, 0], [0, 0.1], [0, 0]])
    job = {"dt": 0.1, "load": 0.3, "nu": 1.5, "held": swing}
    fast = vv.simulate(mount(), 3, memory="exponentials", **job)
    direct = vv.simulate(mount(), 3, memory="direct", **job)
    assert np.abs(fast.state - direct.state).max() < 1e-13
    part = vv.simulate(mount(), 3, resume=vv.simulate(mount(), 1, memory="direct", **job))
    assert (part.state[-1] == direct.state[-1]).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"times": [0], "displacements": [[0, 0]]}, "two or more and strictly ascending"),
        ({"times": [-1, -1, 0], "displacements": [[0, 0]] * 3}, "strictly ascending"),
        ({"times": [-1, 1], "displacements": [[0, 0]] * 2}, "the last is 1, must be 0"),
        ({"times": [-1, 0], "displacements": [[0, 0]]}, "displacements: must have shape"),
        ({"times": [-1, 0], "displacements": [0, 0]}, "must have 2 dimension"),
    ],
)
def test_bad_pasts(arguments, message):
    with pytest.raises(vv.InputError, match=message):
        vv.Past(**arguments)


def test_a_past_of_other_coordinates(mount):
    with pytest.raises(vv.InputError, match="displacements must have 2 columns, got 3"):
        vv.simulate(mount(), 1, dt=0.1, held=vv.Past(times=[-1, 0], displacements=[[0, 0, 0]] * 2))


def test_resolution_tells_steps_too_large(mount):
    exact = [-7.857499117945091e-01, -8.354445983421139e-01]
    for method, dt in (("gauss2", 0.25), ("gauss4", 0.5), ("gauss8", 0.5)):
        run = vv.simulate(mount(), 100, dt=dt, load=0.5, nu=1.5, method=method)
        assert np.abs(run.state[-1, ::2] - exact).max() < run.resolution < 1e-2
    with pytest.warns(vv.ConvergenceWarning, match="steps do not resolve the motion"):
        vv.simulate(mount(), 100, dt=1.0, load=0.5, nu=1.5, method="gauss2")


def by_steps(times, values, stiffness, cubic, damping, load, nu, initial, t_end, length):
    """Return x, x_dot at t_end, with delayed integrals of the spring force, by SciPy.

    R is piecewise linear with knots t_i at multiples of ``length`` and 0 after the last knot. With
    Y' = w and Z' = Y for the spring force w, the memory is R(0) Y + sum_i slope_i (Z(t - t_i) -
    Z(t - t_i+1)) - R(t_n) Y(t - t_n).
    """
    pieces = []

    def before(t, k):
        return 0.0 if t <= 0 else pieces[min(int(t / length + 1e-9), len(pieces) - 1)](t)[k]

    slopes = np.diff(values) / np.diff(times)

    def rates(t, s, now):
        x, v, y, _z = s
        w = stiffness * x + cubic * x**3

        def past(lag, k):
            return s[k] if lag == 0 else before(now + (t - now) - lag, k)

        memory = values[0] * y - values[-1] * past(times[-1], 2)
        for slope, one, other in zip(slopes, times[:-1], times[1:], strict=True):
            memory += slope * (past(one, 3) - past(other, 3))
        return [v, load * np.sin(nu * t) - damping * v - w + memory, w, y]

    state = [*initial, 0.0, 0.0]
    for k in range(round(t_end / length)):
        found = solve_ivp(
            rates, (k * length, (k + 1) * length), state, "DOP853", rtol=1e-13, atol=1e-15,
            dense_output=True, max_step=length / 8, args=(k * length,),
        )  # fmt: skip
        pieces.append(found.sol)
        state = found.y[:, -1]
    return state[:2]


@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
def test_a_table_that_ends_above_zero_keeps_the_order_of_the_steps():
    """With an initial displacement: steps that end at the knots have no delayed jump inside."""
    rng = np.random.default_rng(3)
    for times in ([0, 0.5, 2, 3], [0, 0.5, 1], [0, 0.25, 0.75, 3.5]):
        values = np.sort(rng.uniform(0.02, 0.4, len(times)))[::-1].round(3)
        cubic, damping, start = rng.uniform(0.2, 1), rng.uniform(0.05, 0.2), rng.uniform(0.2, 0.5)
        system = vv.PolynomialSystem(
            mass=1, stiffness=2, damping=damping, forces=f"{cubic}*x^3",
            kernel=vv.TabulatedKernel(times=times, values=values),
        )  # fmt: skip
        found = vv.simulate(system, 4, dt=1 / 16, initial=[start, 0], load=0.3, nu=1.1, keep="last")
        known = by_steps(times, values, 2.0, cubic, damping, 0.3, 1.1, [start, 0], 4, 0.25)
        np.testing.assert_allclose(found.state[-1], known, rtol=0, atol=1e-11)
