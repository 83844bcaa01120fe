"""Newton's method, branches and stability, against independent references (data/README.md)."""

import json
import os
import resource
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import matplotlib
import numpy as np
import pytest
import viscovib as vv
from scipy.integrate import solve_ivp
from tables import DATA

matplotlib.use("Agg")

STIFFNESS = np.array([[10.0, -5.0], [-5.0, 4.5]])
M0 = {"mass": 1, "inertia": 0.1, "offset": 0.5, "stiffness_x": 10, "stiffness_phi": 2}
REFERENCE = json.loads((DATA / "mount_periodic_reference.json").read_text())
KERNEL = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)


def damped(**changes):
    return vv.Mount(**(M0 | {"damping": 0.02 * STIFFNESS} | changes))


def on_each_branch(branch, nu):
    """Indices next to a frequency on each stretch between folds."""
    turns = np.flatnonzero(np.diff(np.sign(np.diff(branch.nu)))) + 1
    parts = np.split(np.arange(branch.nu.size), turns)
    return [part[np.abs(branch.nu[part] - nu).argmin()] for part in parts]


@pytest.mark.parametrize("nu", [1.0, 1.98, 7.15])
def test_reference_amplitudes(nu):
    (row,) = [row for row in REFERENCE["first_harmonics"] if row["nu"] == nu]
    r = vv.forced_response(damped(), nu, load=0.5, method="newton", harmonics=25)
    assert r.amplitude("x")[0] == pytest.approx(row["x1"], rel=1e-9)
    assert r.amplitude("phi")[0] == pytest.approx(row["phi1"], rel=1e-9)


def test_reference_folds():
    branch = vv.trace_response(damped(), (0.5, 10), load=0.5, harmonics=25)
    assert branch.outcome == "completed"
    assert branch.folds == pytest.approx(REFERENCE["folds_nu"], abs=2e-12)
    assert [crossing.kind for crossing in branch.crossings] == ["fold", "fold"]
    back = vv.trace_response(damped(), (10, 0.5), load=0.5, harmonics=25)
    assert back.folds == pytest.approx(REFERENCE["folds_nu"][::-1], abs=2e-12)


def test_all_three_solutions_and_the_multiplier_of_the_middle_one():
    body, rows = damped(), [row for row in REFERENCE["first_harmonics"] if row["nu"] == 2.3]
    branch = vv.trace_response(
        body, (0.5, 10), load=0.5, harmonics=21, max_step=0.005, max_points=9999
    )
    upper, middle, lower = on_each_branch(branch, 2.3)
    for i, row in zip((upper, middle, lower), rows, strict=True):
        # The branch passes 2.3 between its points: a parabola through three of them.
        near = slice(i - 1, i + 2)
        fit = np.polyfit(branch.nu[near] - 2.3, branch.amplitude("x")[near], 2)
        assert fit[-1] == pytest.approx(row["x1"], rel=1e-6)
    near = slice(middle - 1, middle + 2)
    fit = np.polyfit(branch.nu[near] - 2.3, np.abs(branch.multipliers[near, 0]), 2)
    assert fit[-1] == pytest.approx(1.362179, abs=2e-6)
    assert branch.stable[[upper, middle, lower]].tolist() == [True, False, True]


@pytest.mark.parametrize("geometry", ["cubic", "exact"])
@pytest.mark.parametrize("load", [0.5, {1: 0.5, 0: 0.3j}])
def test_multipliers_against_integration_of_the_motion(geometry, load):
    """The monodromy matrix by differences of motions in time, which share no code."""
    body = damped(geometry=geometry)
    nu = 1.3
    r = vv.forced_response(body, nu, load=load, method="newton", harmonics=17)
    branch = vv.trace_response(body, (nu, 1.4), load=load, harmonics=17)
    mean = load[0].imag if isinstance(load, dict) else 0.0

    def motion(t, y):
        x, phi = y[:2]
        if geometry == "exact":
            spring = 10 * (x - 0.5 * np.sin(phi))
            force = np.array([spring, -0.5 * np.cos(phi) * spring + 2 * phi])
        else:
            force = STIFFNESS @ y[:2] + np.array(
                [10 * 0.5 / 6 * phi**3, 2.5 * phi**2 * x - 2 / 3 * 2.5 * phi**3]
            )
        force = np.array([0.5 * np.sin(nu * t) + mean, 0]) - force - 0.02 * STIFFNESS @ y[2:]
        return np.concatenate([y[2:], force / [1, 0.1]])

    k, period = r.harmonics, 2 * np.pi / nu
    start = np.concatenate(
        [(r.coefficients[0] * factor).sum(axis=1).imag for factor in (np.ones(k.size), 1j * k * nu)]
    )

    def after_a_period(y):
        return solve_ivp(motion, (0, period), y, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]

    assert after_a_period(start) == pytest.approx(start, abs=1e-7)
    h = 1e-4
    columns = [
        (after_a_period(start + h * e) - after_a_period(start - h * e)) / (2 * h) for e in np.eye(4)
    ]
    expected = np.linalg.eigvals(np.array(columns).T)
    expected = expected[np.argsort(-np.abs(expected))]
    assert np.abs(branch.multipliers[0]) == pytest.approx(np.abs(expected), abs=1e-6)
    assert branch.multipliers[0].sum() == pytest.approx(expected.sum(), abs=1e-6)


@pytest.mark.parametrize("geometry", ["cubic", "exact", "printed"])
@pytest.mark.parametrize("load", [0.1, {1: 0.1, 0: 0.05j, 2: 0.02}])
def test_newton_and_successive_approximations_agree(geometry, load):
    body = damped(kernel=KERNEL, geometry=geometry)
    nu = np.linspace(0.4, 10, 60)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vv.ConvergenceWarning)
        newton = vv.forced_response(body, nu, load=load, method="newton", tolerance=1e-13)
        successive = vv.forced_response(body, nu, load=load, tolerance=1e-13)
    both = newton.converged & successive.converged
    assert both.sum() > 50
    assert newton.coefficients[both] == pytest.approx(successive.coefficients[both], abs=1e-12)


def test_steady_motion_with_memory():
    """Amplitudes that two other programs agree on, at a load where successive ones fail."""
    body = vv.Mount(**M0, kernel=KERNEL)
    r = vv.forced_response(body, 1.5, load=0.5, method="newton", harmonics=25)
    for dof, k, size in (
        ("x", 1, 0.7847667857476247), ("x", 3, 0.01320317783237266),
        ("phi", 1, 0.8833667200752894), ("phi", 3, 0.04005913119995329),
    ):  # fmt: skip
        assert r.amplitude(dof, k)[0] == pytest.approx(size, abs=2e-15)


@pytest.mark.parametrize("geometry", ["cubic", "exact", "printed"])
def test_every_frequency_is_solved_through_the_resonance(geometry):
    body = vv.Mount(**M0, kernel=KERNEL, geometry=geometry)
    r = vv.forced_response(body, np.linspace(0.5, 10, 150), load=0.5, method="newton")
    assert r.converged.all()


def test_a_moving_base_is_a_load():
    body, nu, y = damped(), np.linspace(0.5, 4, 20), 0.004
    moved = vv.forced_response(body, nu, base=y, method="newton")
    for i in range(nu.size):
        pushed = vv.forced_response(body, nu[i], load=nu[i] ** 2 * y, method="newton")
        relative = moved.coefficients[i].copy()
        relative[0, 0] -= y
        assert relative == pytest.approx(pushed.coefficients[0], abs=1e-10)
    branch = vv.trace_response(body, (0.5, 4), base=y)
    i = int(np.abs(branch.nu - 2).argmin())
    same = vv.forced_response(body, branch.nu[i], base=y, method="newton", tolerance=1e-12)
    assert branch.coefficients[i] == pytest.approx(same.coefficients[0], abs=1e-9)


def test_branch_in_the_load_and_in_the_frequency_meet():
    body = damped()
    in_load = vv.trace_response(body, nu=2.4, load_range=(0, 1), load=0.5)
    assert in_load.outcome == "completed"
    assert in_load.load_factor[[0, -1]].tolist() == [0, 1]
    assert in_load.folds.size % 2 == 0
    r = vv.forced_response(
        body, np.linspace(10, 2.4, 300) if in_load.amplitude("x")[-1] < 0.6 else
        np.linspace(0.5, 2.4, 300), load=0.5, method="newton",
    )  # fmt: skip
    assert in_load.amplitude("x")[-1] == pytest.approx(r.amplitude("x")[-1], rel=1e-8)


def test_peak_of_an_overhanging_curve():
    coarse = vv.trace_response(damped(), (0.5, 10), load=0.5)
    fine = vv.trace_response(damped(), (0.5, 10), load=0.5, max_step=0.003, max_points=9999)
    peak = coarse.peak("x")
    assert peak.enclosed
    assert peak.amplitude == pytest.approx(fine.amplitude("x").max(), rel=1e-4)
    assert peak.nu == pytest.approx(fine.nu[fine.amplitude("x").argmax()], rel=1e-3)
    second = coarse.peak("phi", band=(5, 9))
    assert second.enclosed
    assert second.nu == pytest.approx(7.1, abs=0.1)
    assert not coarse.peak("x", band=(0.5, 1)).enclosed


def test_no_load_no_motion():
    branch = vv.trace_response(damped(), (0.5, 3), load=0.0)
    assert branch.outcome == "completed"
    assert np.abs(branch.coefficients).max() == 0
    assert branch.stable.all()


def test_few_points_give_what_there_is():
    branch = vv.trace_response(damped(), (0.5, 10), load=0.5, max_points=20)
    assert branch.outcome == "step limit"
    assert branch.nu.size == 20


def test_symmetry_breaks_in_a_strongly_driven_mount():
    """Both maps, of half a period and of a whole one, must tell the same story."""
    body = damped()
    odd = vv.trace_response(body, (0.45, 2.7), load=2.5, harmonics=25, max_points=3000)
    for crossing in odd.crossings:
        i = crossing.before
        inside = np.abs(odd.multipliers[i : i + 2, 0])
        assert inside.min() <= 1 + 1e-9 <= inside.max()
        assert crossing.kind in ("fold", "symmetry breaking", "Neimark-Sacker")
    folds = sum(crossing.kind == "fold" for crossing in odd.crossings)
    assert folds == odd.folds.size


def test_table_dataset_and_picture(tmp_path):
    branch = vv.trace_response(damped(), (0.5, 10), load=0.5)
    branch.to_csv(tmp_path / "branch.csv")
    head = (tmp_path / "branch.csv").read_text().splitlines()[:4]
    assert head[1].startswith("# folds at nu = 2.59318")
    assert head[3].startswith("nu,load_factor,stable,x_1_re")
    assert branch.to_dataset().coefficients.shape == branch.coefficients.shape
    axes = vv.plot_branch(branch)
    assert {line.get_label() for line in axes[0].lines} == {"stable", "unstable", "fold"}
    assert axes[0].lines[2].get_xdata().tolist() == branch.folds.tolist()
    matplotlib.pyplot.close("all")


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"nu_range": None}, "nu_range or load_range: must be given"),
        ({"load_range": (0, 1)}, "only one of them"),
        ({"nu": 1.0}, "nu: must be given with load_range, and only then"),
        ({"nu_range": (0, 1)}, "nu_range = (0, 1): must be greater than 0"),
        ({"nu_range": (1, 1)}, "must be two different numbers"),
        ({"nu_range": (1, 2, 3)}, "nu_range: must be two numbers"),
        ({"nu_range": (np.nan, 2)}, "must be a finite number"),
        ({"max_points": 1}, "max_points = 1: must be 2 to 100000"),
        ({"max_step": 0}, "max_step = 0: must be in [1e-4, 1]"),
        ({"tolerance": 1e-20}, "tolerance = "),
        ({"harmonics": 0}, "harmonics = 0: must be 1"),
        ({"mount": 1}, "mount = 1: must be a Mount"),
        ({"mount": damped(cubic_scale=0.0)}, "nothing is nonlinear"),
    ],
)
def test_bad_input_is_named(changes, text):
    given = {"mount": damped(), "nu_range": (0.5, 3), "load": 0.5} | changes
    with pytest.raises(vv.InputError) as error:
        vv.trace_response(given.pop("mount"), **given)
    assert text in str(error.value)


def _own_seconds(pid):
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@pytest.mark.parametrize("what", ["branch", "response", "orders"])
def test_long_work_hears_an_interrupt(what):
    """SIGINT to a process of its own, in the middle of a native call of a minute or more."""
    work = {
        "branch": "vv.trace_response(m, (0.5, 10), load=0.5, harmonics=199, max_step=1e-4, "
        "max_points=9999, stability=False)",
        "response": "vv.forced_response(m, np.linspace(0.5, 10, 9999), load=0.5, harmonics=199, "
        "method='newton')",
        "orders": "vv.forced_response(m, np.linspace(0.5, 10, 999999), load=0.5, "
        "harmonics='auto', method='newton')",
    }[what]
    program = (
        "import numpy as np, viscovib as vv\n"
        "m = vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, "
        "damping=0.02 * np.array([[10, -5], [-5, 4.5]]))\n"
        f"print('ready', flush=True)\n{work}\n"
    )
    started = resource.getrusage(resource.RUSAGE_CHILDREN)
    before = started.ru_utime + started.ru_stime
    child = subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert child.stdout.readline() == "ready\n"
    time.sleep(0.5)
    # Time of its own, whatever else this machine does.
    spent = _own_seconds(child.pid)
    child.send_signal(signal.SIGINT)
    _, errors = child.communicate(timeout=30)
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert ended.ru_utime + ended.ru_stime - before - spent < 1
    assert "KeyboardInterrupt" in errors


def test_stability_of_a_very_stiff_motion_is_not_guessed():
    body = vv.Mount(**(M0 | {"stiffness_phi": 2e9}))
    with pytest.warns(vv.StabilityWarning, match="time scales are too far apart"):
        branch = vv.trace_response(body, (0.5, 1.5), load=0.1)
    assert branch.stable is None
    assert branch.outcome == "completed"


def test_multipliers_of_a_large_motion():
    """Springs ten times as stiff along the motion as at rest: still those of the reference kind."""
    body = damped()
    branch = vv.trace_response(body, nu=1.0, load_range=(0, 60), load=1.0, harmonics=31)
    # Liouville: their product is exp(-trace(M^-1 C) T).
    trace = 0.02 * (10 + 4.5 / 0.1)
    product = np.abs(np.prod(branch.multipliers, axis=1))
    assert product == pytest.approx(np.exp(-trace * 2 * np.pi), rel=1e-5)
