"""The pendulum and its motion: energy, limits, independent reference states, orders."""

import json
from itertools import pairwise

import mpmath as mp
import numpy as np
import pytest
import viscovib as vv
from scipy.linalg import eigh
from tables import DATA, read_table

P1R = {
    "e": 0.1, "w2": 0.4, "w3": 0.8, "alpha": 0.5, "c1": 0.01, "c2": 0.01, "c3": 0.01,
    "f0": 0.005, "m01": 0.0025, "m02": 0.005, "p1": 0.93, "p2": 0.37, "p3": 0.71,
}  # fmt: skip
START = (0.05, 0.0, 0.3, 0.0, -0.2, 0.0)
REFERENCE = json.loads((DATA / "pendulum_time_reference.json").read_text())


def free(**changes):
    return vv.Pendulum(**({"e": 0.1, "w2": 0.4, "w3": 0.8, "alpha": 0.5} | changes))


def states(n=50, size=0.5):
    return np.random.default_rng(7).uniform(-size, size, (n, 6))


def test_power_is_the_rate_of_change_of_the_energy():
    """Relates the equations of motion to the energy at random states, with loads and damping."""
    body, h = vv.Pendulum(**(P1R | {"f0": 0.3, "m01": 0.2, "m02": 0.4, "c2": 0.2})), 1e-3
    for t, y in zip(np.linspace(0, 30, 50), states(), strict=True):
        slope = body.rhs(t, y)
        steps = np.array([-2, -1, 1, 2]) * h
        energies = body.energy(y + steps[:, None] * slope)
        rate = energies @ np.array([1, -8, 8, -1]) / (12 * h)
        assert rate == pytest.approx(body.power(t, y), abs=1e-11)


def test_cubic_approaches_exact_with_the_fourth_power_of_the_state():
    y = states(20, 1.0)
    difference = [
        np.abs(free().rhs(0, s * y) - free(equations="cubic").rhs(0, s * y)).max()
        for s in (0.04, 0.02, 0.01)
    ]
    orders = np.log2(np.array(difference[:-1]) / difference[1:])
    assert orders == pytest.approx([4.0, 4.0], abs=0.15)


def test_printed_equations_do_not_keep_the_energy():
    printed = free(equations="printed")
    drift = [
        np.ptp(body.energy(vv.simulate(body, 50, dt=0.25, initial=START).state))
        for body in (free(), printed)
    ]
    assert drift[0] < 1e-14
    assert drift[1] > 1e-4


def test_linear_modes_against_an_eigensolver():
    for e in (1e-6, 0.01, 0.1, 0.24):
        body = free(e=e)
        # Mass matrix in energy form, which is symmetric: psi'' has the weight e/r.
        weight = e / body.r
        mass = np.array([[1, e], [e, weight]])
        stiffness = np.diag([0.16, 0.64 * weight])
        squares, _ = eigh(stiffness, mass)
        omega, shapes = body.natural_frequencies(), body.mode_shapes()
        assert omega[1:] == pytest.approx(np.sqrt(squares), rel=1e-13)
        assert omega[0] == pytest.approx(np.sqrt(1 + 1.5 * body.z_r**2), rel=1e-15)
        for w, shape in zip(omega[1:], shapes[1:, 1:].T, strict=True):
            left, right = stiffness @ shape, w**2 * mass @ shape
            assert left == pytest.approx(right, rel=1e-9, abs=1e-14)
        assert np.abs(shapes).max(axis=0) == pytest.approx(1.0)


@pytest.mark.parametrize("alpha", [0.0, 1e-12, 0.5, 1e8])
def test_static_elongation_is_the_root(alpha):
    z = free(alpha=alpha).z_r
    assert alpha * z**3 + z == pytest.approx(0.16, rel=1e-15)


def test_physical_units_come_back():
    body = vv.Pendulum.from_physical(
        m=2.0, I_A=0.5, E=0.1, L0=0.8, k1=400.0, k2=5000.0, C1=1.0, C2=0.1, C3=0.05,
        F1=3.0, M2=0.2, M3=0.1, Omega1=14.0, Omega2=3.0, Omega3=6.0,
    )  # fmt: skip
    omega = np.sqrt(200.0)
    length = 0.1 / body.e
    sag = length - 0.8
    assert 400 * sag + 5000 * sag**3 == pytest.approx(2.0 * 9.81, rel=1e-14)
    assert body.z_r == pytest.approx(sag / length, rel=1e-13)
    assert body.r == pytest.approx(2.0 * 0.1 * length / 0.5, rel=1e-14)
    assert body.p1 == pytest.approx(14.0 / omega)


@pytest.mark.parametrize(("name", "loads"), [("P1r", 1.0), ("P1", 4.0), ("P2r", 0.0)])
@pytest.mark.parametrize(("method", "dt"), [("gauss8", 0.5), ("gauss16", 1.0)])
def test_reference_states(name, loads, method, dt):
    """States with 20 digits by quadruple precision and a Taylor method (data/README.md)."""
    changes = {k: loads * P1R[k] for k in ("f0", "m01", "m02")}
    if not loads:
        changes |= {"c1": 0.0, "c2": 0.0, "c3": 0.0}
    body = vv.Pendulum(**(P1R | changes))
    for t, texts in REFERENCE[name]["states"].items():
        run = vv.simulate(body, float(t), dt=dt, initial=START, method=method)
        expected = np.array([float(text) for text in texts])
        # P1 amplifies errors by 1e5 until t = 100.
        assert run.state[-1] == pytest.approx(expected, abs=1e-10 if name == "P1" else 2e-13)


@pytest.mark.parametrize(
    ("method", "steps", "order", "above"),
    [
        ("gauss2", (0.4, 0.04), 4, 0.1),
        ("gauss3", (1.0, 0.1), 6, 0.1),
        ("gauss8", (2.0, 0.8), 16, 0.4),
        ("rk4", (0.5, 0.05), 4, 0.1),
        ("dop8", (0.8, 0.1), 8, 0.1),
        # The leading error terms of Verner's method are so small that the next terms dominate.
        ("verner8", (0.6, 0.2), 8, 1.0),
        ("verner9", (0.6, 0.2), 9, 1.0),
    ],
)
def test_observed_order(method, steps, order, above):
    """Errors at 100 times, so that a zero of one component has no effect."""
    body, times = vv.Pendulum(**P1R), np.arange(1, 101)
    exact = vv.simulate(body, 100, dt=0.25, initial=START, method="gauss16", times=times).state
    errors = [
        np.linalg.norm(
            vv.simulate(body, 100, dt=dt, initial=START, method=method, times=times).state - exact
        )
        for dt in steps
    ]
    observed = np.log(errors[0] / errors[1]) / np.log(steps[0] / steps[1])
    assert order - 0.15 < observed < order + above


def test_energy_of_the_symplectic_methods_stays_bounded():
    body = free()
    for method, dt, bound in (("gauss2", 0.2, 1e-6), ("gauss8", 1.0, 1e-12)):
        run = vv.simulate(body, 20_000, dt=dt, initial=START, method=method, save_every=100)
        energy = body.energy(run.state)
        quarters = [np.ptp(part) for part in np.array_split(energy, 4)]
        assert max(quarters) < bound
        assert quarters[3] < 2 * quarters[0] + 1e-14


def test_balance_of_energy_along_a_driven_run():
    """The energy change is the work of the loads minus dissipation; the spline error is dt^4."""
    body = vv.Pendulum(**P1R)
    defects = [
        np.abs(vv.simulate(body, 100, dt=dt, initial=START).energy_defect()).max()
        for dt in (0.1, 0.05, 0.025)
    ]
    orders = np.log2(np.array(defects[:-1]) / defects[1:])
    assert orders == pytest.approx([4, 4], abs=0.2)
    assert defects[2] < 1e-11
    wrong = vv.simulate(vv.Pendulum(**P1R, equations="printed"), 100, dt=0.05, initial=START)
    assert np.abs(wrong.energy_defect()).max() > 1e-4
    with pytest.raises(vv.InputError, match="must be at least 4"):
        vv.simulate(body, 1, dt=0.5, initial=START).energy_defect()


def test_a_run_goes_on_bit_for_bit():
    body = vv.Pendulum(**P1R)
    whole = vv.simulate(body, 100, dt=0.5, initial=START)
    first = vv.simulate(body, 40, dt=0.5, initial=START, keep="last")
    rest = vv.simulate(body, 100, resume=first, save_every=2)
    assert (rest.state == whole.state[80::2]).all()
    assert (rest.t == whole.t[80::2]).all()


def test_phases_lose_no_digit_in_a_long_run():
    """A driven linear spring, against its closed steady solution after 1e6."""
    body = free(alpha=0.0, c1=0.05, f0=1e-3, p1=0.93)
    end = 1_000_000
    run = vv.simulate(body, end, dt=1.0, initial=(0, 0, 0, 0, 0, 0), keep="last")
    with mp.workdps(40):
        p, c = mp.mpf(0.93), mp.mpf(0.05)
        steady = (mp.mpf(1e-3) / (1 - p**2 + 1j * p * c) * mp.exp(1j * p * end)).real
    assert run.state[-1, 0] == pytest.approx(float(steady), abs=1e-16)


@pytest.mark.parametrize("method", ["gauss8", "gauss16", "gauss2", "verner9"])
def test_motion_that_fades_out_of_the_range_of_numbers(method):
    body = free(c1=0.5, c2=0.5, c3=0.5)
    run = vv.simulate(body, 20_000, dt=0.5, initial=START, method=method, keep="last")
    assert run.outcome == "completed"
    assert np.abs(run.state).max() < 1e-300


def test_wanted_tolerance_is_met():
    body = vv.Pendulum(**P1R)
    expected = np.array([float(text) for text in REFERENCE["P1r"]["states"]["200"]])
    for tolerance in (1e-4, 1e-8, 1e-12):
        run = vv.simulate(body, 200, initial=START, tolerance=tolerance)
        assert run.error <= tolerance
        assert np.abs(run.state[-1] - expected).max() <= tolerance


@pytest.mark.parametrize("equations", ["exact", "cubic", "printed"])
def test_jacobian_against_differences(equations):
    """Central differences of the right side, extrapolated twice."""
    body = vv.Pendulum(**(P1R | {"f0": 0.3, "m01": 0.2, "c2": 0.2}), equations=equations)
    for t, y in zip(np.linspace(0, 30, 20), states(20), strict=True):
        jacobian = body.jacobian(t, y)
        for j, direction in enumerate(np.eye(6)):
            by_step = [
                (body.rhs(t, y + h * direction) - body.rhs(t, y - h * direction)) / (2 * h)
                for h in (4e-3, 2e-3, 1e-3)
            ]
            once = [(4 * b - a) / 3 for a, b in pairwise(by_step)]
            limit = (16 * once[1] - once[0]) / 15
            assert jacobian[:, j] == pytest.approx(limit, rel=1e-8, abs=1e-9)


def test_jacobians_of_many_states():
    y = states(6).reshape(2, 3, 6)
    whole = vv.Pendulum(**P1R).jacobian(1.0, y)
    assert whole.shape == (2, 3, 6, 6)
    assert (whole[1, 2] == vv.Pendulum(**P1R).jacobian(1.0, y[1, 2])).all()


@pytest.mark.parametrize("method", ["gauss8", "gauss16", "verner9"])
def test_states_at_wanted_times_are_as_exact_as_steps(method):
    body = vv.Pendulum(**P1R)
    times = np.array([0.0, 0.3, 7.77, 50.0, 99.9, 100.0])
    dt = 0.2 if method == "verner9" else 1.0
    run = vv.simulate(body, 100, dt=dt, initial=START, method=method, times=times)
    exact = [
        vv.simulate(body, t, dt=min(t, 0.25), initial=START, method="gauss16").state[-1]
        for t in times[1:]
    ]
    assert (run.t == times).all()
    assert (run.state[0] == START).all()
    assert run.state[1:] == pytest.approx(np.array(exact), abs=2e-12)


def test_wanted_times_leave_the_run_alone():
    body = vv.Pendulum(**P1R)
    times = np.sort(np.random.default_rng(3).uniform(0, 100, 50))
    plain = vv.simulate(body, 100, dt=0.5, initial=START, keep="last")
    run = vv.simulate(body, 100, dt=0.5, initial=START, times=[*times, 100.0])
    assert (run.state[-1] == plain.state[-1]).all()


def test_tail_is_the_end_of_the_whole():
    body = vv.Pendulum(**P1R)
    whole = vv.simulate(body, 100, dt=0.5, initial=START)
    tail = vv.simulate(body, 100, dt=0.5, initial=START, keep="tail", tail=20)
    assert tail.t[0] == 80
    assert (tail.state == whole.state[160:]).all()


def test_explicit_runs_go_on_bit_for_bit():
    body = vv.Pendulum(**P1R)
    for method in ("rk4", "dop8", "verner8", "verner9"):
        whole = vv.simulate(body, 20, dt=0.25, initial=START, method=method)
        first = vv.simulate(body, 8, dt=0.25, initial=START, method=method, keep="last")
        assert (vv.simulate(body, 20, resume=first).state == whole.state[32:]).all()


def test_error_estimate_of_a_given_step():
    body = vv.Pendulum(**P1R)
    expected = np.array([float(text) for text in REFERENCE["P1r"]["states"]["200"]])
    for method, dt in (("gauss8", 2.0), ("verner8", 0.5), ("rk4", 0.05)):
        run = vv.simulate(
            body, 200, dt=dt, initial=START, method=method, keep="last", estimate_error=True
        )
        error = np.abs(run.state[-1] - expected).max()
        assert error / 2 < run.error < 2 * error


def test_results_in_physical_units():
    """A small vertical oscillation about equilibrium: m Z'' = -(k1 + 3 k2 Z_r^2) Z in s and m."""
    body = vv.Pendulum.from_physical(m=2.0, I_A=0.5, E=0.1, L0=0.8, k1=400.0, k2=5000.0)
    length, small = body.scales.length, 1e-6
    run = vv.simulate(body, 20, dt=0.1, initial=(small / length, 0, 0, 0, 0, 0))
    data = run.to_dataset(physical=True)
    sag = length - 0.8
    omega = np.sqrt((400.0 + 3 * 5000.0 * sag**2) / 2.0)
    t = data.t.values
    assert data.z.values == pytest.approx(small * np.cos(omega * t), abs=1e-10)
    assert data.z_dot.values == pytest.approx(-small * omega * np.sin(omega * t), abs=2e-9)
    assert (data.t.units, data.z.units, data.psi_dot.units) == ("s", "m", "rad/s")
    with pytest.raises(vv.InputError, match="not built by"):
        vv.simulate(free(), 1, dt=0.1, initial=START).to_dataset(physical=True)


def test_a_run_as_a_table(tmp_path):
    run = vv.simulate(free(), 2, dt=0.5, initial=START)
    run.to_csv(tmp_path / "run.csv")
    rows = read_table(tmp_path / "run.csv")
    assert [float(row["phi_dot"]) for row in rows] == run.coordinate("phi_dot").tolist()


def test_too_large_a_step_says_so():
    run = vv.simulate(free(), 100, dt=20.0, initial=START)
    assert run.outcome == "step too large"
    assert run.t_reached < 100
    assert np.isfinite(run.state).all()


def test_spring_through_the_pivot_stops_the_run():
    run = vv.simulate(free(), 100, dt=0.1, initial=(0.0, -3.0, 0.0, 0.0, 0.0, 0.0))
    assert run.outcome == "unphysical"
    assert 0 < run.t_reached < 2
    with pytest.raises(vv.InputError, match="ended 'unphysical'"):
        vv.simulate(free(), 200, resume=run)


def test_dataset_names_the_coordinates():
    data = vv.simulate(free(), 10, dt=0.5, initial=START).to_dataset()
    assert float(data.phi[0]) == 0.3
    assert data.psi_dot.shape == (21,)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: free(e=0.25), "e w3^2/w2^2 = 1: must be less than 1"),
        (lambda: free(w2=0.0), "w2 = 0: must be greater than 0"),
        (lambda: free(alpha=-1), "alpha = -1: must not be negative"),
        (lambda: free(c1=np.nan), "c1 = nan: must be a finite number"),
        (lambda: free(equations="true"), "equations = 'true': must be one of"),
        (lambda: vv.Pendulum.from_physical(m=-1, I_A=1, E=1, L0=1, k1=1), "m = -1: must be"),
        (lambda: free().rhs(0, [1, 2]), "state: must have shape (..., 6)"),
        (lambda: vv.simulate(free(), 10, dt=0.0, initial=START), "dt = 0: must be greater"),
        (lambda: vv.simulate(free(), 10, dt=-1, initial=START), "dt = -1: must be greater"),
        (lambda: vv.simulate(free(), 10, dt=np.nan, initial=START), "dt = nan: must be a finite"),
        (lambda: vv.simulate(free(), 10, dt=11, initial=START), "not exceed t_end = 10"),
        (lambda: vv.simulate(free(), -10, initial=START), "t_end = -10: must be greater"),
        (lambda: vv.simulate(free(), 10), "initial: must be given"),
        (lambda: vv.simulate(free(), 10, initial=[1, 2]), "initial: must have shape (6,)"),
        (lambda: vv.simulate(free(), 10, initial=(-1, 0, 0, 0, 0, 0)), "must be greater than -1"),
        (lambda: vv.simulate(free(), 10, initial=START, method="rk5"), "method = 'rk5'"),
        (lambda: vv.simulate(free(), 10, initial=START, tolerance=0), "tolerance = 0"),
        (lambda: vv.simulate(free(), 10, initial=START, save_every=0), "save_every = 0"),
        (lambda: vv.simulate(free(), 10, initial=START, keep="some"), "keep = 'some'"),
        (lambda: vv.simulate(free(), 10, initial=START, keep="tail"), "tail: must be given"),
        (lambda: vv.simulate(free(), 10, initial=START, tail=1), "tail: must be given"),
        (lambda: vv.simulate(free(), 10, initial=START, times=[]), "times: must not be empty"),
        (lambda: vv.simulate(free(), 10, initial=START, times=[2, 1]), "times: must be strictly"),
        (lambda: vv.simulate(free(), 10, initial=START, times=[11]), "between the start 0 and"),
        (lambda: vv.simulate(free(), 10, initial=START, times=[1], keep="last"), "times: cannot"),
        (lambda: free(scales=1.0), "scales = 1.0: must be Scales"),
        (lambda: vv.simulate("body", 10, initial=START), "must be a Pendulum"),
    ],
)
def test_bad_input_is_named(make, text):
    with pytest.raises(vv.InputError) as error:
        make()
    assert text in str(error.value)
