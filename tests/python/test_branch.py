"""Newton's method, branches and stability, against independent references (data/README.md)."""

import json
import subprocess
import sys
import time
import warnings
from dataclasses import replace
from itertools import product

import matplotlib
import numpy as np
import pytest
import viscovib as vv
from processes import end_by_interrupt
from referee.integration import solve_ivp
from tables import DATA

matplotlib.use("Agg")

# Few harmonics are intended here; test_truncation.py tests the warning.
pytestmark = pytest.mark.filterwarnings("ignore:.*estimated relative error")

STIFFNESS = np.array([[10.0, -5.0], [-5.0, 4.5]])
M0 = {"mass": 1, "inertia": 0.1, "offset": 0.5, "stiffness_x": 10, "stiffness_phi": 2}
REFERENCE = json.loads((DATA / "mount_periodic_reference.json").read_text())
KERNEL = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)


def damped(**changes):
    return vv.Mount(**(M0 | {"damping": 0.02 * STIFFNESS} | changes))


def on_each_branch(branch, nu):
    """Indices next to a frequency on each part between folds."""
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
        # The branch passes 2.3 between its points: a parabola through three points.
        near = slice(i - 1, i + 2)
        fit = np.polyfit(branch.nu[near] - 2.3, branch.amplitude("x")[near], 2)
        assert fit[-1] == pytest.approx(row["x1"], rel=1e-6)
    near = slice(middle - 1, middle + 2)
    fit = np.polyfit(branch.nu[near] - 2.3, np.abs(branch.multipliers[near, 0]), 2)
    assert fit[-1] == pytest.approx(1.362179, abs=2e-6)
    assert branch.stable[[upper, middle, lower]].tolist() == [True, False, True]


def variational(nu, k, x, geometry):
    """Monodromy matrix of the mount along Im sum x_k exp(i k nu t), by SciPy."""

    def slope(t, y):
        x_, phi = (x * np.exp(1j * k * nu * t)).sum(axis=1).imag
        if geometry == "exact":
            s, c = np.sin(phi), np.cos(phi)
            rest = 2 + 2.5 * c**2 + 5 * s * (x_ - 0.5 * s)
            stiffness = np.array([[10, -5 * c], [-5 * c, rest]])
        else:
            stiffness = STIFFNESS + np.array(
                [[0, 2.5 * phi**2], [2.5 * phi**2, 5 * phi * x_ - 5 * phi**2]]
            )
        y = y.reshape(4, 4)
        force = stiffness @ y[:2] + 0.02 * STIFFNESS @ y[2:]
        return np.concatenate([y[2:], -force / [[1], [0.1]]]).ravel()

    end = solve_ivp(slope, (0, 2 * np.pi / nu), np.eye(4).ravel(), "DOP853", rtol=1e-13, atol=1e-14)
    return end.y[:, -1].reshape(4, 4)


@pytest.mark.parametrize("geometry", ["cubic", "exact"])
@pytest.mark.parametrize("load", [0.5, {1: 0.5, 0: 0.3j}])
def test_multipliers_keep_ten_digits(geometry, load):
    branch = vv.trace_response(damped(geometry=geometry), (0.5, 10), load=load)
    for i in range(3, branch.nu.size, branch.nu.size // 4):
        matrix = variational(branch.nu[i], branch.harmonics, branch.coefficients[i], geometry)
        expected = np.linalg.eigvals(matrix)
        apart = np.abs(branch.multipliers[i][:, None] - expected)
        worst = max(apart.min(axis=0).max(), apart.min(axis=1).max())
        assert worst < 1e-10 * np.abs(expected).max()
        # The multipliers of the exponents are equal; half a period is solved at order 2.
        again = np.exp(2 * np.pi * branch.exponents[i] / branch.nu[i])
        assert again == pytest.approx(branch.multipliers[i], rel=1e-12)


@pytest.mark.parametrize("load", [2.5, {1: 2.5, 0: 0.3j}])
def test_crossings_are_located(load):
    """At a bifurcation a multiplier lies on the unit circle, at the location of its kind."""
    branch = vv.trace_response(damped(), (0.45, 2.7), load=load, harmonics=15, max_points=3000)
    assert {c.kind for c in branch.crossings} == {
        "Neimark-Sacker", "symmetry breaking" if load == 2.5 else "period doubling"
    }  # fmt: skip
    for crossing in branch.crossings:
        i, nu = crossing.before, crossing.parameter
        assert min(branch.nu[i : i + 2]) < nu < max(branch.nu[i : i + 2])
        roots = np.linalg.eigvals(variational(nu, branch.harmonics, crossing.coefficients, "cubic"))
        root = roots[np.abs(np.abs(roots) - 1).argmin()]
        assert abs(root) == pytest.approx(1, abs=1e-9)
        # The multiplier changes so fast that an error of 1e-8 in the parameter would be visible.
        there = np.abs(branch.multipliers[[i, i + 1]])
        moved = np.abs(np.diff(np.log(there), axis=0)).max() / abs(np.diff(branch.nu[i : i + 2]))
        assert moved * nu > 0.5
        # Multipliers of a whole period; the symmetry breaks at -1 for half a period.
        if crossing.kind == "Neimark-Sacker":
            assert abs(root.imag) > 1e-3
        else:
            assert root == pytest.approx(-1 if crossing.kind == "period doubling" else 1, abs=1e-8)


def test_crossings_at_folds_are_the_folds():
    branch = vv.trace_response(damped(), (0.5, 10), load=0.5)
    assert [c.parameter for c in branch.crossings] == branch.folds.tolist()
    assert [c.coefficients.tolist() for c in branch.crossings] == branch.fold_coefficients.tolist()
    in_load = vv.trace_response(damped(), nu=2.4, load_range=(0, 4), load=0.5)
    assert [c.parameter for c in in_load.crossings] == in_load.folds.tolist()


@pytest.mark.parametrize("geometry", ["cubic", "exact", "printed"])
@pytest.mark.parametrize("load", [0.1, {1: 0.1, 0: 0.05j, 2: 0.02}])
def test_newton_and_successive_approximations_agree(geometry, load):
    body = damped(kernel=KERNEL, geometry=geometry)
    nu = np.linspace(0.4, 10, 60)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vv.ConvergenceWarning)
        newton = vv.forced_response(
            body, nu, load=load, method="newton", harmonics=9, tolerance=1e-13
        )
        successive = vv.forced_response(body, nu, load=load, harmonics=9, tolerance=1e-13)
    both = newton.converged & successive.converged
    assert both.sum() > 50
    assert newton.coefficients[both] == pytest.approx(successive.coefficients[both], abs=1e-12)


def test_steady_motion_with_memory():
    """Amplitudes of two other programs, at a load where successive approximations fail."""
    body = vv.Mount(**M0, kernel=KERNEL)
    r = vv.forced_response(body, 1.5, load=0.5, method="newton", harmonics=25)
    for dof, k, size in (
        ("x", 1, 0.7847667857476247), ("x", 3, 0.01320317783237266),
        ("phi", 1, 0.8833667200752894), ("phi", 3, 0.04005913119995329),
    ):  # fmt: skip
        assert r.amplitude(dof, k)[0] == pytest.approx(size, abs=2e-15)


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


def test_no_load_no_motion():
    branch = vv.trace_response(damped(), (0.5, 3), load=0.0)
    assert branch.outcome == "completed"
    assert np.abs(branch.coefficients).max() == 0
    assert branch.stable.all()


def test_table_dataset_and_picture(tmp_path):
    branch = vv.trace_response(damped(), (0.5, 10), load=0.5)
    branch.to_csv(tmp_path / "branch.csv")
    head = (tmp_path / "branch.csv").read_text().splitlines()
    planned = str(branch.plan).splitlines()
    assert [line.removeprefix("# ") for line in head[1 : len(planned) + 1]] == planned
    head = head[len(planned) :]
    assert head[1].startswith("# branch completed; folds at nu = 2.59318")
    first = branch.crossings[0]
    place = f"{first.before + 1}: {first.kind} at nu = {first.parameter:.16e}"
    reported = head[2].removeprefix("# estimated errors of these folds: ").split()
    assert [float(e) for e in reported] == branch.fold_errors.tolist()
    assert branch.to_dataset().attrs["fold_errors"].tolist() == branch.fold_errors.tolist()
    assert head[3] == f"# stability changes after point {place}"
    reported = head[5].removeprefix("# estimated errors of these changes: ").split()
    assert [float(e) for e in reported] == [c.error for c in branch.crossings]
    assert head[7].startswith("nu,stable,growing,multiplier,highest,truncation,error,x_1_re")
    assert "error: by the last correction and rounding" in head[6]
    rows = [line.split(",") for line in head[7:]]
    errors = [float(row[rows[0].index("error")]) for row in rows[1:]]
    assert errors == branch.error.tolist() == branch.to_dataset().error.to_numpy().tolist()
    assert branch.to_dataset().coefficients.shape == branch.coefficients.shape
    axes = vv.plot_branch(branch)
    assert {line.get_label() for line in axes[0].lines} == {"stable", "unstable", "fold"}
    assert axes[0].lines[2].get_xdata().tolist() == branch.folds.tolist()
    assert axes[0].get_ylabel().endswith("(m)")
    low = vv.trace_response(
        vv.PolynomialSystem(mass=1, stiffness=1, damping=0.3, forces="0.1*x^3", units=["1"]),
        (0.5, 2), load=0.1,
    )  # fmt: skip
    axes = vv.plot_branch(low)
    assert "fold" not in {line.get_label() for line in axes[0].lines}
    assert axes[0].get_ylabel() == "amplitude $|x_{1}|$"
    broken = vv.trace_response(damped(), (0.45, 2.7), load=2.5, harmonics=9)
    axes = vv.plot_branch(broken)
    marks = {line.get_label(): line for line in axes[0].lines}
    (crossing,) = [c for c in broken.crossings if c.kind == "symmetry breaking"]
    assert marks["symmetry breaking"].get_xdata().tolist() == [crossing.parameter]
    place = abs(crossing.coefficients[0, 0])
    assert marks["symmetry breaking"].get_ydata()[0] == pytest.approx(place)
    assert "Neimark-Sacker" in marks
    matplotlib.pyplot.close("all")


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"nu_range": None}, "nu_range, load_range or vary_range: give exactly"),
        ({"load_range": (0, 1)}, "give exactly one of them"),
        ({"nu": 1.0}, "nu: must be given with load_range or vary_range, and not without them"),
        ({"nu_range": (0, 1)}, "nu_range = (0, 1): must be greater than 0"),
        ({"nu_range": (1, 1)}, "must be two different numbers"),
        ({"nu_range": (1, 2, 3)}, "nu_range: must be two numbers"),
        ({"nu_range": (np.nan, 2)}, "must be a finite number"),
        ({"max_points": 1}, "max_points = 1: must be 2 to 100000"),
        ({"max_step": 0}, "max_step = 0: must be in [1e-4, 1]"),
        ({"tolerance": 1e-20}, "tolerance = "),
        ({"harmonics": 0}, "harmonics = 0: must be 1"),
        ({"system": 1}, "system = 1: must be a Mount"),
    ],
)
def test_bad_input_is_named(changes, text):
    given = {"system": damped(), "nu_range": (0.5, 3), "load": 0.5} | changes
    with pytest.raises(vv.InputError) as error:
        vv.trace_response(**given)
    assert text in str(error.value)


@pytest.mark.parametrize("what", ["branch", "response", "orders"])
def test_long_work_hears_an_interrupt(what):
    """SIGINT to a child process during a native call of a minute or more."""
    work = {
        "branch": "vv.trace_response(m, (0.5, 10), load=0.5, harmonics=199, max_step=1e-4, "
        "max_points=9999, stability=False)",
        "response": "vv.forced_response(m, np.linspace(0.5, 10, 9999), load=0.5, harmonics=199, "
        "method='newton')",
        "orders": "vv.forced_response(m, np.linspace(0.5, 10, 99999), load=0.5, "
        "harmonics='auto', method='newton')",
    }[what]
    program = (
        "import numpy as np, viscovib as vv\n"
        "m = vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, "
        "damping=0.02 * np.array([[10, -5], [-5, 4.5]]))\n"
        f"print('ready', flush=True)\n{work}\n"
    )
    child = subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert child.stdout.readline() == "ready\n"
    time.sleep(0.5)
    spent, errors = end_by_interrupt(child)
    assert spent < 1
    assert "KeyboardInterrupt" in errors


def test_stability_of_a_very_stiff_motion_is_not_guessed():
    body = vv.Mount(**(M0 | {"stiffness_phi": 2e9}))
    with pytest.warns(vv.StabilityWarning, match="too stiff for the Floquet solver"):
        branch = vv.trace_response(body, (0.5, 1.5), load=0.1)
    assert branch.stable is None
    assert branch.outcome == "completed"


def test_multipliers_of_a_large_motion():
    """The stiffness along the motion is ten times that at rest; multipliers stay accurate."""
    body = damped()
    branch = vv.trace_response(body, nu=1.0, load_range=(0, 60), load=1.0, harmonics=31)
    # Liouville: the product of the multipliers is exp(-trace(M^-1 C) T).
    trace = 0.02 * (10 + 4.5 / 0.1)
    product = np.abs(np.prod(branch.multipliers, axis=1))
    assert product == pytest.approx(np.exp(-trace * 2 * np.pi), rel=1e-5)


def test_stability_moves_with_the_base():
    """The same motion has the same multipliers under a force and under a base motion."""
    body, nu = damped(), np.array([0.8, 1.4, 3.0])
    moved = vv.forced_response(body, nu, base=0.05, method="newton", stability=True)
    for i, value in enumerate(nu):
        pushed = vv.forced_response(
            body, value, load=value**2 * 0.05, method="newton", stability=True
        )
        assert moved.multipliers[i] == pytest.approx(pushed.multipliers[0], abs=1e-9)


def test_stability_needs_newton():
    for method in ("successive", "linear"):
        with pytest.raises(vv.InputError, match="stability: needs method = newton"):
            vv.forced_response(damped(), 1.0, load=0.1, method=method, stability=True)


@pytest.mark.parametrize("seed", range(4))
def test_a_linear_system_has_a_branch(seed):
    """Motions from the dynamic stiffness, multipliers from the roots of the state matrix."""
    rng = np.random.default_rng([48, seed])
    n = seed % 3 + 1
    c, k = (
        0.05 * np.eye(n),
        np.diag(rng.uniform(1, 4, n)) - 0.3 * (np.eye(n, k=1) + np.eye(n, k=-1)),
    )
    kind = vv.Structure if seed % 2 else vv.PolynomialSystem
    system = kind(mass=np.eye(n), stiffness=k, damping=c)
    loads = {order: rng.normal(size=n) for order in (1, 3)}
    branch = vv.trace_response(system, (0.3, 3), load=loads)
    assert branch.outcome == "completed"
    assert len(branch.folds) == 0
    assert branch.stable.all()
    for order, load in loads.items():
        j = list(branch.harmonics).index(order)
        mu = order * branch.nu[:, np.newaxis, np.newaxis]
        exact = np.linalg.solve(k + 1j * mu * c - mu**2 * np.eye(n), load[:, np.newaxis])[..., 0]
        assert branch.coefficients[:, :, j] == pytest.approx(exact, rel=1e-9, abs=1e-12)
    roots = np.linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [-k, -c]]))
    largest = np.exp(roots.real.max() * 2 * np.pi / branch.nu)
    assert np.abs(branch.multipliers[:, 0]) == pytest.approx(largest, rel=1e-8)
    one = vv.forced_response(system, 1.0, load=loads, stability=True)
    assert one.stable.all()


def _duffing():
    return vv.PolynomialSystem(
        mass=[1.0], stiffness=[[1.0]], damping=[[0.1]], forces={"u": "u^3"}, names=("u",)
    )


def test_where_a_symmetry_breaks_another_branch_leaves():
    options = {"load_range": (0.1, 30.0), "nu": 1.0, "load": 1.0, "harmonics": 31}
    odd = vv.trace_response(_duffing(), **options)
    breaks = [c.parameter for c in odd.crossings if c.kind == "symmetry breaking"]
    assert len(breaks) == 3
    every = vv.trace_response(_duffing(), **options, symmetric=False)
    assert list(every.harmonics) == list(range(32))
    points = every.branch_points
    np.testing.assert_allclose([point.parameter for point in points], breaks, rtol=1e-9)
    # The same locations by multipliers.
    assert [c.kind for c in every.crossings] == [
        "branch point", "branch point", "fold", "fold", "branch point",
    ]  # fmt: skip
    np.testing.assert_allclose(
        [c.parameter for c in every.crossings if c.kind == "branch point"], breaks, rtol=1e-9
    )
    for point in points:
        low, high = sorted(every.parameter[point.before : point.before + 2])
        assert low <= point.parameter <= high
        # The tangent of the side branch has only the mean and even harmonics.
        assert np.abs(point.across[0, ::2]).max() > 0.1
        assert np.abs(point.across[0, 1::2]).max() < 1e-6
    ways = [
        vv.trace_response(
            _duffing(), **options, symmetric=False, leave=points[0], opposite=opposite
        )
        for opposite in (False, True)
    ]
    for way in ways:
        assert way.outcome == "closed"
        # The branch reaches the second point and returns mirrored.
        np.testing.assert_allclose([p.parameter for p in way.branch_points], breaks[1:2], rtol=1e-9)
    first, second = (way.coefficients[1, 0, 0].imag for way in ways)
    assert first == pytest.approx(-second, rel=1e-6)
    middle = ways[0].coefficients[:, 0, 0].imag.argmax()
    load = ways[0].load_factor[middle]
    state = [
        ways[0].coefficients[middle, 0].imag.sum(),
        (ways[0].harmonics * ways[0].coefficients[middle, 0]).real.sum(),
    ]
    after = solve_ivp(
        lambda t, y: [y[1], load * np.sin(t) - 0.1 * y[1] - y[0] - y[0] ** 3],
        (0, 2 * np.pi), state, method="DOP853", rtol=1e-12, atol=1e-12,
    ).y[:, -1]  # fmt: skip
    np.testing.assert_allclose(after, state, atol=1e-7)


def test_a_branch_stops_where_reported():
    values = [2.4, 7.0, 0.5]
    branch = vv.trace_response(
        damped(), (0.5, 10), load=0.5, harmonics=9, at=values, stability=False
    )
    # Between the folds there are three motions at each frequency.
    assert list(branch.nu[branch.stops]) == [0.5, 2.4, 2.4, 2.4, 7.0]
    for i in branch.stops:
        single = vv.forced_response(
            damped(), branch.nu[i], load=0.5, method="newton", harmonics=9, tolerance=1e-13
        )
        distance = np.abs(branch.coefficients[i] - single.coefficients[0]).max()
        assert distance < 1e-9 or branch.nu[i] == 2.4
    without = vv.trace_response(damped(), (0.5, 10), load=0.5, harmonics=9, stability=False)
    np.testing.assert_array_equal(np.delete(branch.nu, branch.stops[1:]), without.nu)
    assert not without.stops.size


def test_leaving_needs_a_branch_point_of_the_same_kind():
    options = {"load_range": (0.1, 4.0), "nu": 1.0, "load": 1.0, "symmetric": False}
    branch = vv.trace_response(_duffing(), **options, harmonics=9, stability=False)
    with pytest.raises(vv.InputError, match="must be one of a branch's branch_points"):
        vv.trace_response(_duffing(), **options, leave=branch)
    with pytest.raises(vv.InputError, match="must have as many as this curve"):
        vv.trace_response(_duffing(), **options, harmonics=11, leave=branch.branch_points[0])
    with pytest.raises(vv.InputError, match=r"at\[0\] = nan: must be"):
        vv.trace_response(_duffing(), **options, at=[np.nan])
    with pytest.raises(vv.InputError, match=r"at = 5: must be in \[0.1, 4\], the range of load_"):
        vv.trace_response(_duffing(), **options, at=[2.0, 5.0])


def test_a_doubled_period_is_a_branch_point_at_half_the_frequency():
    escape = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="-x^2")
    along = {"load_range": (0.01, 0.2), "stability": True}
    once = vv.trace_response(escape, **along, nu=0.85, load=1.0, harmonics=24)
    doubled = [c.parameter for c in once.crossings if c.kind == "period doubling"]
    twice = vv.trace_response(escape, **along, nu=0.425, load={2: 1.0}, harmonics=48)
    assert [p.parameter for p in twice.branch_points] == pytest.approx(doubled, rel=1e-9)
    side = vv.trace_response(
        escape, **along, nu=0.425, load={2: 1.0}, harmonics=48, leave=twice.branch_points[0]
    )
    # Odd multiples of half the frequency, which the main branch does not contain.
    assert np.abs(twice.amplitude("x", 1)).max() < 1e-10
    assert side.amplitude("x", 1).max() > 0.01


@pytest.mark.parametrize(("kernel", "nu"), [(None, 2.4), (KERNEL, 1.8)])
def test_any_parameter_of_a_mount_may_vary(kernel, nu):
    body = damped(kernel=kernel, damping=0.0 * STIFFNESS if kernel else 0.02 * STIFFNESS)
    branch = vv.trace_response(
        body, nu=nu, vary="stiffness_phi", vary_range=(1.2, 3.5), load=0.5, at=[2.0]
    )
    assert branch.varies == "stiffness_phi"
    assert branch.parameter[-1] == 3.5
    assert (branch.nu == nu).all()
    assert (branch.load_factor == 1).all()
    crossed = vv.trace_response(body, (0.5, 4), load=0.5, at=[nu])
    mine, others = (np.sort(b.amplitude("x")[b.stops]) for b in (branch, crossed))
    assert mine == pytest.approx(others, rel=1e-8)
    # The branch in the frequency has its fold at the same point.
    other = vv.trace_response(
        replace(body, stiffness_phi=branch.folds[0]), (0.5, 4), load=0.5, stability=False
    )
    assert np.abs(other.folds - nu).min() < 1e-8
    for i in range(0, branch.nu.size, 15):
        single = vv.trace_response(
            replace(body, stiffness_phi=branch.parameter[i]), (nu, nu + 1), load=0.5,
            max_points=2,
        )  # fmt: skip
        if single.coefficients[0] == pytest.approx(branch.coefficients[i], abs=1e-7):
            assert single.stable[0] == branch.stable[i]
            assert single.multipliers[0, 0] == pytest.approx(branch.multipliers[i, 0], abs=1e-6)


def test_what_may_not_vary_is_said():
    with pytest.raises(vv.InputError, match="vary = 'colour': must be one of 'mass'"):
        vv.trace_response(damped(), nu=2.0, vary="colour", vary_range=(1, 2), load=0.5)
    with pytest.raises(vv.InputError, match="mass = -1"):
        vv.trace_response(damped(), nu=2.0, vary="mass", vary_range=(1, -1), load=0.5)
    with pytest.raises(vv.InputError, match="vary: must be given with vary_range"):
        vv.trace_response(damped(), nu=2.0, vary="mass", load_range=(1, 2), load=0.5)
    with pytest.raises(vv.InputError, match="nu: must be given with load_range or vary_range"):
        vv.trace_response(damped(), vary="mass", vary_range=(1, 2), load=0.5)


@pytest.mark.parametrize("max_step", [0.042, 0.092])
def test_a_branch_point_is_found_from_the_side_branch_too(max_step):
    """Newton's method may converge to the main branch where both branches are close."""
    options = {"load_range": (0.1, 30), "nu": 1, "load": 1, "harmonics": 21, "symmetric": False}
    main = vv.trace_response(_duffing(), **options, stability=False)
    side = vv.trace_response(
        _duffing(), **options, stability=False, leave=main.branch_points[0], max_step=max_step
    )
    assert [point.parameter for point in side.branch_points] == pytest.approx(
        [main.branch_points[1].parameter], rel=1e-9
    )


WEAK_MEMORY = vv.RzhanitsynKernel(amplitude=0.005, alpha=0.1, beta=0.05)


def test_a_crossing_with_memory_is_where_a_branch_leaves():
    """A zero of Hill's determinant against a zero of the determinant of all harmonics."""
    body = vv.PolynomialSystem(
        mass=[1], stiffness=[[1]], damping=[[0.1]], forces={"u": "u^3"}, names=("u",),
        kernel=vv.RzhanitsynKernel(amplitude=0.03, alpha=0.3, beta=0.1),
    )  # fmt: skip
    options = dict(load_range=(0.1, 30), nu=1, load=1, harmonics=41, tolerance=1e-13)
    odd = vv.trace_response(body, **options)
    full = vv.trace_response(body, **options, symmetric=False, stability=False)
    crossed = [c.parameter for c in odd.crossings if c.kind == "symmetry breaking"]
    assert crossed == pytest.approx([p.parameter for p in full.branch_points], rel=1e-11)
    assert len(crossed) == 3


def nearest(branch, nu, motion):
    """Relative distance of a motion from the branch at the same frequency."""
    rows = branch.coefficients[np.abs(branch.nu - nu) <= 1e-13 * nu]
    both = min(rows.shape[2], motion.shape[1])
    gaps = rows.copy()
    gaps[:, :, :both] -= motion[:, :both]
    sizes = np.sqrt((np.abs(gaps) ** 2).sum(axis=(1, 2)))
    return sizes.min() / np.linalg.norm(motion)


@pytest.mark.parametrize(
    ("geometry", "kernel", "tolerance"),
    [("cubic", None, 1e-6), ("exact", WEAK_MEMORY, 1e-9), ("exact", None, 1e-9)],
    ids=["cubic", "exact with memory", "exact"],
)
def test_orders_chosen_point_by_point_keep_the_tolerance(geometry, kernel, tolerance):
    body = damped(geometry=geometry, kernel=kernel)
    branch = vv.trace_response(
        body, (0.5, 10), load=0.5, harmonics="auto", tolerance=tolerance, stability=False
    )
    assert branch.outcome == "completed"
    assert branch.truncation.max() <= tolerance
    assert branch.highest.max() == branch.harmonics[-1] > 2 * branch.highest.min()
    for row, highest in zip(branch.coefficients, branch.highest, strict=True):
        assert not row[:, branch.harmonics > highest].any()
    some = np.arange(0, branch.nu.size, 7)
    exact = vv.trace_response(
        body, (0.5, 10), load=0.5, harmonics=45, tolerance=1e-13, stability=False,
        at=branch.nu[some],
    )  # fmt: skip
    errors = np.array([nearest(exact, branch.nu[i], branch.coefficients[i]) for i in some])
    # Near folds the error along the branch, which the estimate does not include, is unbounded.
    off = np.abs(branch.nu[some][:, np.newaxis] - exact.folds).min(axis=1, initial=1) > 1e-3
    assert (errors[off] < 6 * tolerance).all()
    assert np.median(errors[off]) > 1e-4 * tolerance
    assert branch.folds == pytest.approx(exact.folds, rel=10 * tolerance)


def test_chosen_orders_find_what_many_find():
    """Branch points, side branches, stability, any parameter, with mean and even harmonics."""
    body = _duffing()
    options = dict(load_range=(0.1, 30), nu=1, load=1, symmetric=False)
    auto = vv.trace_response(body, **options, harmonics="auto")
    many = vv.trace_response(body, **options, harmonics=41)
    places = [p.parameter for p in many.branch_points]
    assert [p.parameter for p in auto.branch_points] == pytest.approx(places, rel=1e-8)
    kinds = [c.kind for c in many.crossings]
    assert [c.kind for c in auto.crossings] == kinds
    side = vv.trace_response(body, **options, harmonics="auto", leave=auto.branch_points[0])
    assert np.abs(side.coefficients[-5:, 0, 0]).min() > 1e-3
    back = [p.parameter for p in side.branch_points]
    assert min(abs(p - places[1]) for p in back) < 1e-7
    mount = damped()
    some = vv.trace_response(
        mount, nu=2, load=0.5, vary="stiffness_phi", vary_range=(2, 4), harmonics="auto"
    )
    fixed = vv.trace_response(
        mount, nu=2, load=0.5, vary="stiffness_phi", vary_range=(2, 4), harmonics=31
    )
    assert some.coefficients[-1, :, 0] == pytest.approx(fixed.coefficients[-1, :, 0], rel=1e-8)
    assert some.truncation.max() <= 1e-10


def test_too_few_orders_are_reported():
    """A slow and strong motion needs more harmonics than the limit."""
    with pytest.warns(vv.ConvergenceWarning, match="harmonics up to 63 do not reach"):
        vv.trace_response(
            vv.PolynomialSystem(mass=1, stiffness=1, damping=0.01, forces={"x": "x^3"}),
            (0.02, 0.03), load=3, harmonics="auto", stability=False, tolerance=1e-12,
        )  # fmt: skip


@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
@pytest.mark.parametrize("harmonics", [9, "auto"])
def test_parameters_vary_to_the_ends_of_their_values(harmonics):
    """Range ends: no memory, no offset."""
    body = vv.Mount(**M0, kernel=vv.RzhanitsynKernel(amplitude=0.03, alpha=0.1, beta=0.05))
    options = dict(nu=2.3, load=0.3, harmonics=harmonics)
    up = vv.trace_response(body, **options, vary="memory_scale", vary_range=(0, 1))
    down = vv.trace_response(body, **options, vary="memory_scale", vary_range=(1, 0))
    assert up.outcome == down.outcome == "completed"
    assert (up.parameter[0], up.parameter[-1]) == (0, 1)
    assert (down.parameter[0], down.parameter[-1]) == (1, 0)
    both = up.coefficients[[0, -1], :, :3], down.coefficients[[-1, 0], :, :3]
    assert both[0] == pytest.approx(both[1], rel=1e-8, abs=1e-9)
    away = vv.trace_response(body, **options, vary="offset", vary_range=(0, 0.5))
    assert away.outcome == "completed"
    assert away.coefficients[-1, :, :3] == pytest.approx(up.coefficients[-1, :, :3], rel=1e-8)


@pytest.mark.parametrize("f0", [0.0039, 0.004])
def test_an_ulp_moves_points_by_rounding_only(f0):
    """Step sizes from angles with all digits would give branches with other numbers of points.

    Rounding may decide whether a point needs one more correction. This changes the point by less
    than 1e-10, and later points, along the curve, by up to 1e-7.
    """

    def points(f0):
        body = vv.Pendulum(
            e=0.1, w2=0.53, w3=0.9, alpha=0.5, c1=0.01, c2=0.01, c3=0.01, f0=f0, p1=1.0
        )
        options = dict(p1=(0.9, 1.2), subharmonic=2, harmonics=14, stability=False)
        main = vv.trace_response(body, **options)
        side = vv.trace_response(body, **options, leave=main.branch_points[0])
        return np.concatenate([main.parameter, side.parameter])

    a, b = points(f0), points(np.nextafter(f0, 1))
    assert a.size == b.size > 200
    assert np.median(np.abs(a - b)) < 1e-12
    assert np.abs(a - b).max() < 1e-6


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-5])
def test_the_estimate_along_a_branch_is_the_error(tolerance):
    options = dict(load=0.3, stability=False)
    branch = vv.trace_response(
        _duffing(), (0.3, 2), **options, harmonics="auto", tolerance=tolerance
    )
    some = np.arange(1, branch.nu.size, 3)
    exact = vv.trace_response(
        _duffing(), (0.3, 2), **options, harmonics=45, tolerance=1e-13, at=branch.nu[some]
    )
    errors = np.array([nearest(exact, branch.nu[i], branch.coefficients[i]) for i in some])
    off = np.abs(branch.nu[some][:, np.newaxis] - exact.folds).min(axis=1, initial=1) > 0.02
    ratio = (errors / branch.truncation[some])[off]
    assert ratio.size > 5
    assert (ratio > 0.6).all()
    assert (ratio < 1.7).all()


def test_branch_points_do_not_depend_on_steps():
    options = dict(load_range=(0.1, 30), nu=1, load=1, harmonics=21, symmetric=False)
    places = np.array([
        [
            p.parameter
            for p in vv.trace_response(
                _duffing(), **options, max_step=step, stability=False
            ).branch_points
        ]
        for step in np.linspace(0.04, 0.1, 3)
    ])  # fmt: skip
    assert places.shape == (3, 3)
    assert np.ptp(places, axis=0) == pytest.approx(0, abs=1e-11)


def test_a_branch_ends_behind_as_many_folds_as_wanted():
    body = vv.PolynomialSystem(mass=[[1]], stiffness=[[1]], damping=[[0.1]], forces="x^3")
    whole = vv.trace_response(body, (0.4, 2.5), load=0.3)
    assert len(whole.folds) == 2
    for most in (1, 2, 3):
        part = vv.trace_response(body, (0.4, 2.5), load=0.3, max_folds=most)
        assert len(part.folds) == min(most, 2)
        assert part.outcome == ("completed" if most > 2 else "fold limit")
        np.testing.assert_array_equal(part.coefficients, whole.coefficients[: part.nu.size])
        # One point follows the fold: the branch turns back in the last step.
        turns = np.diff(np.sign(np.diff(part.nu[:-1]))) != 0
        assert turns.sum() == min(most, 2) - (most < 3)
    free = vv.backbone(body, 0, (0.1, 2.0), max_folds=1)
    assert free.outcome == "completed"


def test_a_smaller_angle_gives_a_finer_curve():
    body = vv.PolynomialSystem(mass=[[1]], stiffness=[[1]], damping=[[0.1]], forces="x^3")
    coarse, usual, fine = (
        vv.trace_response(body, (0.4, 2.5), load=0.3, max_step=1, harmonics=5, angle=angle)
        for angle in (0.24, 0.12, 0.03)
    )
    assert coarse.nu.size < usual.nu.size < 0.5 * fine.nu.size
    for other in (coarse, fine):
        np.testing.assert_allclose(other.folds, usual.folds, rtol=1e-10)
    default = vv.trace_response(body, (0.4, 2.5), load=0.3, max_step=1, harmonics=5)
    np.testing.assert_array_equal(default.coefficients, usual.coefficients)


#: nu, damping and cubic term of Duffing oscillators with symmetry breaking.
BREAKING = [
    (0.908, 0.12, 1.1),
    (0.6177359431843465, 0.21937430477979397, 1.4607874444371338),
    (0.6206147803913347, 0.23155908169422354, 0.9393294842112621),
    (0.9598683360914125, 0.23346884311712504, 1.0667415582417452),
    (0.5786129832905695, 0.16563438742559008, 0.8272560242307373),
]


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.parametrize(("nu", "damping", "cubic"), BREAKING[:3])
def test_branches_of_broken_symmetry_do_not_jump_to_the_symmetric_one(nu, damping, cubic):
    """Such a branch is symmetric at its ends only."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=damping, forces=f"{cubic}*x^3")
    along = {"nu": nu, "load": 1, "load_range": (0.05, 20), "symmetric": False, "stability": False}
    main = vv.trace_response(system, **along)
    assert main.branch_points
    for point in main.branch_points:
        left = vv.trace_response(system, **along, leave=point)
        sizes = np.abs(left.coefficients[:, 0, left.harmonics % 2 == 0]).max(axis=1)
        assert left.nu.size > 4
        assert (sizes[1:] > 1e-6).all(), point.parameter


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.parametrize(("nu", "damping", "cubic"), BREAKING[::2])
def test_a_closed_branch_has_a_fold_at_both_ends(nu, damping, cubic):
    """A closed branch also turns back at its start, for any steps, direction and start."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=damping, forces=f"{cubic}*x^3")
    along = {
        "nu": nu, "load": 1, "load_range": (0.05, 20), "symmetric": False, "harmonics": 9,
        "stability": False,
    }  # fmt: skip
    steps = [{}, {"angle": 0.05}, {"angle": 0.08}] + [{"max_step": h / 100} for h in (3, 8)]
    one, other = vv.trace_response(system, **along).branch_points[:2]
    for start, end in (one, other), (other, one):
        for step, opposite in product(steps, (False, True)):
            left = vv.trace_response(system, **along, **step, leave=start, opposite=opposite)
            assert left.outcome == "closed"
            ends = [end.parameter, start.parameter]
            assert left.folds == pytest.approx(ends, rel=1e-9), step
            sure = np.array([end.error, start.error])
            known = np.isfinite(sure)
            assert left.fold_errors[known] == pytest.approx(sure[known], rel=0.1), step
            places = [point.parameter for point in left.branch_points]
            assert places == pytest.approx([end.parameter], rel=1e-9), step
