"""Driven motions of the pendulum, against integration, shooting and energy balance by SciPy."""

import functools
import warnings
from dataclasses import replace

import matplotlib
import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp
from referee.models import Swinging
from scipy.optimize import root
from tables import lines_without_plan

matplotlib.use("Agg")

# Few harmonics are intended here; test_truncation.py tests the warning.
pytestmark = pytest.mark.filterwarnings("ignore:.*estimated relative error")

BODY = {"e": 0.1, "w2": 0.4, "w3": 0.8, "alpha": 0.5, "c1": 0.05, "c2": 0.05, "c3": 0.05}


LIGHT = {"c1": 0.02, "c2": 0.02, "c3": 0.02}


def swung(**changes):
    return vv.Pendulum(**(BODY | {"m01": 0.01, "p2": 0.5} | changes))


def after(pend, t, y, tolerance=1e-13):
    right = Swinging.of(pend).right if pend.equations == "exact" else pend.rhs
    run = solve_ivp(right, (0, t), y, "DOP853", rtol=tolerance, atol=1e-14)
    return run.y[:, -1]


@pytest.mark.parametrize("equations", ["exact", "cubic", "printed"])
@pytest.mark.parametrize(
    "loads",
    [
        {"m01": 0.01, "p2": 0.5},
        {"m01": 0.0, "m02": 0.05, "p3": 0.6},
        {"m01": 0.0, "f0": 0.1, "p1": 0.9},
        # Ratios 3 : 2 : 1, and a constant load.
        {"f0": 0.05, "p1": 0.75, "m02": 0.01, "p3": 0.25},
        {"f0": 0.02, "p1": 0.0},
    ],
)
def test_motion_returns_after_a_period(equations, loads):
    pend = swung(equations=equations, **loads)
    r = vv.forced_response(pend, tolerance=1e-11)
    assert r.converged.all()
    assert r.axes == (("nu",) if "m02" in loads and "f0" in loads else r.axes)
    start = r.state(0, 0.0)
    period = 2 * np.pi / r.nu[0]
    assert after(pend, period, start) == pytest.approx(start, abs=2e-9)
    # Also within the period.
    half = after(pend, 0.37 * period, start)
    assert r.state(0, 0.37 * period) == pytest.approx(half, abs=2e-9)


def test_work_of_the_loads_is_dissipated():
    pend = swung(m01=0.02, f0=0.05, p1=1.0)
    r = vv.forced_response(pend, tolerance=1e-13, harmonics=40)
    t = np.linspace(0, 2 * np.pi / r.nu[0], 400, endpoint=False)
    power = pend.power(t, r.state(0, t))
    assert abs(power.mean()) < 1e-13
    assert np.abs(power).max() > 1e-3


def test_small_motion_is_the_linear_one():
    pend = swung(m01=1e-6, p2=0.35)
    r = vv.forced_response(pend)
    p, w2, w3, e = 0.35, 0.4, 0.8, 0.1
    ratio = (w3 / w2) ** 2
    stiffness = np.array([[w2**2, 0], [0, w3**2]]) + 1j * p * np.diag([0.05, 0.05])
    linear = np.linalg.solve(stiffness - p**2 * np.array([[1, e], [ratio, 1]]), [1e-6, 0])
    # cos(p t) = Im(i exp(i p t)).
    found = [r.coefficient("phi")[0], r.coefficient("psi")[0]]
    assert np.array(found) == pytest.approx(1j * linear, rel=1e-9)


def fixed_amplitude(pend, at, guess):
    """State and frequency p2 of the periodic motion with phi(0) = at, by shooting."""

    def defect(unknown):
        moved = replace(pend, p2=unknown[5])
        y = np.insert(unknown[:5], 2, at)
        return after(moved, 2 * np.pi / unknown[5], y) - y

    found = root(defect, guess, method="hybr", options={"xtol": 1e-13})
    assert np.abs(found.fun).max() < 1e-11
    return found.x


@functools.cache
def overhanging():
    return vv.trace_response(swung(m01=0.005, **LIGHT), p2=(0.25, 0.6), harmonics=25)


def test_folds_against_shooting():
    """Near a fold the frequency is a smooth function of phi(0): its extremum is the fold."""
    branch, pend = overhanging(), swung(m01=0.005, **LIGHT)
    assert branch.outcome == "completed"
    assert branch.folds.size == 2
    for fold, coefficients in zip(branch.folds, branch.fold_coefficients, strict=True):
        waves = 1j * branch.harmonics * fold
        start = np.empty(6)
        start[::2] = coefficients.sum(axis=1).imag
        start[1::2] = (waves * coefficients).sum(axis=1).imag
        guess = np.append(np.delete(start, 2), fold)
        steps = np.array([-2, -1, 0, 1, 2]) * 2e-3
        values = [fixed_amplitude(pend, start[2] + s, guess)[5] for s in steps]
        fit = np.polynomial.Polynomial.fit(steps, values, 4)
        roots = fit.deriv().roots()
        top = roots[np.abs(roots).argmin()].real
        assert abs(top) < 1e-3
        assert fit(top) == pytest.approx(fold, abs=1e-8)


def test_stability_changes_at_the_folds_only():
    branch = overhanging()
    assert [crossing.kind for crossing in branch.crossings] == ["fold", "fold"]
    first, last = (c.before for c in branch.crossings if c.kind == "fold")
    assert not branch.stable[first + 1 : last + 1].any()
    assert branch.stable[: first + 1].all()
    assert branch.stable[last + 1 :].all()


def test_branch_in_load_and_frequency_meet():
    in_load = vv.trace_response(swung(**LIGHT), m01=(0, 0.005), p2=None, harmonics=25)
    assert in_load.outcome == "completed"
    assert in_load.parameter[[0, -1]].tolist() == [0, 0.005]
    light = swung(m01=0.005, **LIGHT)
    single = vv.forced_response(light, harmonics=25, tolerance=1e-13)
    branch = overhanging()
    end = in_load.coefficients[-1]
    assert end == pytest.approx(single.coefficients[0], abs=1e-9)
    near = int(np.abs(branch.parameter - 0.5).argmin())
    point = vv.forced_response(light, p2=branch.parameter[near], harmonics=25)
    assert branch.coefficients[near] == pytest.approx(point.coefficients[0], abs=1e-8)


PARAMETRIC = BODY | LIGHT | {"f0": 0.1, "p1": 0.8}


def doubling(p1):
    """det(M^2 - I) of the swinging about the motion in z alone, by shooting."""
    pend = vv.Pendulum(**(PARAMETRIC | {"p1": p1}))
    period = 2 * np.pi / p1

    own = Swinging.of(pend)

    def stretched(t, y):
        return own.right(t, np.array([y[0], y[1], 0, 0, 0, 0]))[:2]

    def defect(y):
        run = solve_ivp(stretched, (0, period), y, "DOP853", rtol=1e-13, atol=1e-14)
        return run.y[:, -1] - y

    rest = root(defect, [0.0, 0.0], options={"xtol": 1e-13}).x

    def disturbed(t, y):
        state = np.array([y[0], y[1], 0, 0, 0, 0])
        change = pend.jacobian(t, state)[2:, 2:] @ y[2:].reshape(4, 4)
        return np.concatenate([own.right(t, state)[:2], change.ravel()])

    run = solve_ivp(
        disturbed, (0, period), [*rest, *np.eye(4).ravel()], "DOP853", rtol=1e-12, atol=1e-13
    )
    period_map = run.y[2:, -1].reshape(4, 4)
    return np.linalg.det(period_map @ period_map - np.eye(4))


@functools.cache
def parametric():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vv.StabilityWarning)
        return vv.trace_response(
            vv.Pendulum(**PARAMETRIC), p1=(0.5, 1.0), subharmonic=2, harmonics=24
        )


def test_parametric_resonance_is_found_and_followed():
    branch = parametric()
    assert branch.outcome == "completed"
    assert branch.axes == ("nu",)
    assert branch.amplitude("phi").max() == 0
    assert branch.nu == pytest.approx(branch.parameter / 2, rel=1e-15)
    points = np.array([point.parameter for point in branch.branch_points])
    assert points.size == 4
    for p in points:
        # The true location lies between.
        assert doubling(p - 1e-8) * doubling(p + 1e-8) < 0
    p = branch.parameter
    unstable = ((p > points[0]) & (p < points[1])) | (p > points[2])
    assert np.array_equal(branch.stable, ~unstable)
    assert [crossing.kind for crossing in branch.crossings] == 4 * ["branch point"]
    sizes = np.abs(branch.multipliers)
    assert np.array_equal(branch.growing, (sizes > 1 + 1e-9).sum(axis=1))
    assert (np.diff(sizes, axis=1) <= 1e-12).all()
    at = [crossing.before for crossing in branch.crossings]
    assert at == [point.before for point in branch.branch_points]
    # The determinant and the multipliers agree.
    assert [crossing.parameter for crossing in branch.crossings] == pytest.approx(points, abs=1e-9)


def test_period_doubling_is_reported_from_branch_points():
    """Over one period of the load the swinging with half the frequency has the multiplier -1."""
    branch = vv.trace_response(vv.Pendulum(**PARAMETRIC), p1=(0.5, 1.0), harmonics=12)
    doubled = parametric().branch_points
    kinds = [crossing.kind for crossing in branch.crossings]
    assert kinds == ["branch point", "branch point", "period doubling", "branch point"]
    assert len(branch.branch_points) == 3
    where = [crossing.parameter for crossing in branch.crossings]
    assert where == pytest.approx([point.parameter for point in doubled], abs=1e-9)


def test_broken_symmetry_is_a_motion():
    """Where the swinging under m01 alone loses its half-period mirror symmetry."""
    pend = swung(m01=0.02)
    branch = vv.trace_response(pend, p2=(0.9, 1.1), harmonics=21, tolerance=1e-12)
    assert len(branch.branch_points) == 2
    assert branch.amplitude("z", 1).max() < 1e-12
    off = vv.trace_response(
        pend,
        p2=(0.9, 1.1),
        harmonics=21,
        tolerance=1e-12,
        leave=branch.branch_points[0],
        max_points=25,
    )
    assert off.amplitude("z", 1)[-1] > 0.05
    waves = 1j * off.harmonics * off.nu[-1]
    start = np.empty(6)
    start[::2] = off.coefficients[-1].sum(axis=1).imag
    start[1::2] = (waves * off.coefficients[-1]).sum(axis=1).imag
    moved = replace(pend, p2=off.parameter[-1])
    assert after(moved, 2 * np.pi / off.nu[-1], start) == pytest.approx(start, abs=1e-10)


def test_switched_branch_is_a_motion():
    pend, point = vv.Pendulum(**PARAMETRIC), parametric().branch_points[-2]
    ways = [
        vv.trace_response(
            pend, p1=(0.5, 1.0), subharmonic=2, harmonics=24, leave=point, opposite=opposite,
            max_points=20,
        )
        for opposite in (False, True)
    ]  # fmt: skip
    for branch in ways:
        assert branch.amplitude("phi")[-1] > 0.1
        i, p1 = -1, branch.parameter[-1]
        moved = vv.Pendulum(**(PARAMETRIC | {"p1": p1}))
        waves = 1j * branch.orders[:, 0] * branch.nu[i]
        start = np.empty(6)
        start[::2] = branch.coefficients[i].sum(axis=1).imag
        start[1::2] = (waves * branch.coefficients[i]).sum(axis=1).imag
        period = 2 * np.pi / p1
        assert after(moved, 2 * period, start) == pytest.approx(start, abs=1e-7)
        # After half the period of the motion it is its mirror image.
        assert after(moved, period, start)[2:] == pytest.approx(-start[2:], abs=1e-7)
    # Both directions give the same motion, shifted by a period of the load.
    assert ways[0].amplitude("phi") == pytest.approx(ways[1].amplitude("phi"), abs=1e-6)


def test_branch_ends_where_the_spring_reaches_its_pivot():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vv.StabilityWarning)
        branch = vv.trace_response(vv.Pendulum(**PARAMETRIC), p1=(0.5, 1.4))
    assert branch.outcome == "unphysical"
    t = np.linspace(0, 2 * np.pi / branch.nu[-1], 300)
    waves = np.exp(1j * np.outer(t, branch.harmonics * branch.nu[-1]))
    z = (waves @ branch.coefficients[-1, 0]).imag
    assert z.min() == pytest.approx(-1, abs=1e-3)


def test_what_is_not_found_is_reported():
    with pytest.warns(vv.ConvergenceWarning, match="1 of 2 motions not found"):
        r = vv.forced_response(
            vv.Pendulum(**PARAMETRIC), f0=[0.01, 40.0], harmonics=9, stability=True
        )
    assert r.converged.tolist() == [True, False]
    assert np.isnan(r.coefficients[1]).all()
    assert r.stable.tolist() == [True, None]


def test_table_dataset_and_picture(tmp_path):
    branch = overhanging()
    branch.to_csv(tmp_path / "branch.csv")
    lines = lines_without_plan(tmp_path / "branch.csv")
    assert lines[1].startswith(f"# branch completed; folds at {branch.varies} = ")
    first = branch.crossings[0]
    place = f"{first.before + 1}: fold at {branch.varies} = {first.parameter:.16e}"
    assert lines[2].startswith("# estimated errors of these folds: ")
    assert lines[4] == f"# stability changes after point {place}"
    assert lines[8].startswith(f"{branch.varies},omega_1,stable,growing,multiplier,error,z_0_re")
    assert len(lines) == 9 + branch.parameter.size
    assert branch.to_dataset().coefficients.shape == branch.coefficients.shape
    axes = vv.plot_branch(branch)
    assert axes[1].get_ylabel().startswith("amplitude")
    assert {"stable", "unstable", "fold"} <= {line.get_label() for line in axes[0].lines}
    axes = vv.plot_branch(parametric(), harmonic=2)
    assert "branch point" in {line.get_label() for line in axes[0].lines}
    matplotlib.pyplot.close("all")
    r = vv.forced_response(swung(), harmonics=9)
    r.to_csv(tmp_path / "row.csv")
    assert lines_without_plan(tmp_path / "row.csv")[2].startswith("p2,omega_1,out")
    assert r.to_dataset().outcome.values.tolist() == ["converged"]
    rows = vv.forced_response(swung(), p2=np.linspace(0.5, 0.6, 5), harmonics=9)
    axes = vv.plot_response([rows, rows], labels=["a", "b"], harmonic=3)
    assert axes[-1].get_xlabel() == "p2"
    assert axes[1].lines[0].get_ydata() == pytest.approx(rows.amplitude("phi", 3))
    matplotlib.pyplot.close("all")
    t, q = r.waveform(0, 64)
    assert q == pytest.approx(r.state(0, t)[:, ::2])


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: vv.forced_response(vv.Pendulum(**BODY)), "at least one load of a frequency > 0"),
        (lambda: vv.forced_response(swung(), p2=[0.5], m01=[0.1]), "only one of them may vary"),
        (lambda: vv.forced_response(swung(), p2=-1), "p2 = -1: must be greater than 0"),
        (lambda: vv.forced_response(swung(), p1=1.0), "p1: varies, but no load acts at it: f0 = 0"),
        (lambda: vv.forced_response(swung(), p2=[[1.0]]), "must have 0 or 1 dimension"),
        (lambda: vv.forced_response(swung(), harmonics=0), "harmonics = 0: must be 1 to 399"),
        (lambda: vv.forced_response(swung(), tolerance=0), "tolerance = 0: must be in"),
        (lambda: vv.forced_response(swung(), subharmonic=0), "subharmonic = 0: must be 1 to 20"),
        (
            lambda: vv.forced_response(swung(f0=0.1, p1=0.777), subharmonic=2),
            "subharmonic = 2: needs a single base frequency",
        ),
        (lambda: vv.trace_response(swung()), "one must be given, as (from, to)"),
        (lambda: vv.trace_response(swung(), p2=(0, 1)), "p2 = (0, 1): must be greater than 0"),
        (lambda: vv.trace_response(swung(), p2=0.3), "p2: must be two numbers"),
        (lambda: vv.trace_response(swung(), p2=(1, 2), max_step=9), "max_step = 9: must be in"),
        (lambda: vv.trace_response(swung(), p2=(1, 2), leave=3), "leave = 3: must be one of"),
        (lambda: vv.trace_response(3, (1, 2)), "must be a Mount"),
        (lambda: vv.trace_response(system=3, p2=(1, 2)), "system = 3: must be a Mount or a"),
        (lambda: vv.forced_response(3, nu=1.0), "system = 3: must be a Mount or a Poly"),
        (
            lambda: vv.trace_response(
                vv.Pendulum(**PARAMETRIC),
                p1=(0.5, 1),
                harmonics=15,
                leave=parametric().branch_points[0],
            ),
            "use the same harmonics, loads and symmetry",
        ),
        (
            lambda: vv.trace_response(
                vv.Pendulum(**PARAMETRIC),
                p1=(0.5, 1),
                subharmonic=2,
                harmonics=24,
                leave=parametric().branch_points[0],
                symmetric=True,
            ),
            "give symmetric=False",
        ),
        (
            lambda: vv.forced_response(swung()).amplitude("phi", 99),
            "harmonic = 99: must be one of those kept",
        ),
    ],
)
def test_bad_input_is_named(call, text):
    with pytest.raises(vv.InputError) as error:
        call()
    assert text in str(error.value)
