"""The standalone driver: tables, exit statuses, and every wrong scene a line."""

import csv
import os
import shutil
import subprocess
import sys
import warnings
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import viscovib as vv

SCENES = Path(__file__).parents[2] / "data" / "scenes"

GOOD = """&mount mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2 /
&kernel kind='rzhanitsyn', amplitude=0.048, alpha=0.1, beta=0.05 /
&load amplitude=0.1 /
&response nu_min=0.5, nu_max=4, nu_count=8 /
"""
MOTION = """&pendulum e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, f0=0.005, p1=0.93 /
&transient initial=0.05 0 0.3 0 -0.2 0, t_end=20, dt=0.25 /
"""
KERNEL = "kind='rzhanitsyn', amplitude=0.048, alpha=0.1, beta=0.05"
BRANCH = GOOD[: GOOD.index("&response")] + "&branch nu_from=1, nu_to=4 /\n"
GRID = "nu_min=0.5, nu_max=4, nu_count=8"


@contextmanager
def silence():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def read_csv(path):
    return np.genfromtxt(
        [line for line in path.read_text().splitlines() if not line.startswith("#")],
        delimiter=",",
        names=True,
        dtype=None,
        encoding="utf-8",
    )


@pytest.mark.parametrize(
    "name", ["mount_paper", "mount_two_kernels", "base_linear", "mount_resonance", "absorber"]
)
def test_driver_and_python_agree_to_the_last_bit(solve, tmp_path, name):
    scene = SCENES / f"{name}.nml"
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    table = read_csv(tmp_path / f"{name}_response.csv")
    if "debug" not in os.environ.get("VISCOVIB_SOLVE", ""):
        with silence():
            result = vv.run(scene)
        r = result.response
        assert (table["nu"] == r.nu).all()
        assert (table["outcome"] == r.outcome).all()
        for d, dof in enumerate(r.dof_names):
            for j, k in enumerate(r.harmonics):
                assert (table[f"{dof}_{k}_re"] == r.coefficients[:, d, j].real).all()
                assert (table[f"{dof}_{k}_im"] == r.coefficients[:, d, j].imag).all()
        r.to_csv(tmp_path / "python.csv")
        assert read_csv(tmp_path / "python.csv").dtype.names == table.dtype.names


@pytest.mark.parametrize("method", ["newton", "successive"])
def test_orders_are_chosen_in_scenes(solve, tmp_path, method):
    scene = tmp_path / "orders.nml"
    scene.write_text(GOOD.replace("&response ", f"&response method='{method}', harmonics='auto', "))
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert vv.plan(scene).splitlines() == solve(scene, "--plan").stdout.splitlines()
    table = read_csv(tmp_path / "orders_response.csv")
    assert (table["truncation"] <= 1e-10).all()
    if method == "newton":
        assert table["highest"].min() < table["highest"].max()
    r = vv.run(scene).response
    if "debug" not in os.environ.get("VISCOVIB_SOLVE", ""):
        assert (table["highest"] == r.highest).all()
        assert (table["truncation"] == r.truncation).all()
        assert (table["phi_3_re"] == r.coefficient("phi", 3).real).all()
    r.to_csv(tmp_path / "python.csv")
    assert read_csv(tmp_path / "python.csv").dtype.names == table.dtype.names
    if method == "newton":
        scene.write_text(
            "&system coordinates='x', mass=1, stiffness=1, damping=0.05 /\n"
            "&force law='x^3' /\n&load amplitude=30 /\n"
            "&response method='newton', harmonics='auto', nu=0.002, tolerance=1e-12 /\n"
        )
        done = solve(scene, "--out", tmp_path)
        assert done.returncode == 1
        assert "1 of 1 frequencies solved, 1 with too few harmonics" in done.stdout


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"dt=0.25": "tolerance=1e-9"},
        {"dt=0.25": "dt=0.3, method='verner9', save_every=7"},
        {"dt=0.25": "dt=1, tolerance=1e-6, method='gauss16'", "e=0.1": "equations='cubic', e=0.1"},
    ],
)
def test_motions_of_driver_and_python_agree_to_the_last_bit(solve, tmp_path, changes):
    text = MOTION
    for old, new in changes.items():
        text = text.replace(old, new)
    scene = tmp_path / "motion.nml"
    scene.write_text(text)
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    table = read_csv(tmp_path / "motion_transient.csv")
    run = vv.run(scene).trajectory
    assert vv.plan(scene).splitlines() == solve(scene, "--plan").stdout.splitlines()
    run.to_csv(tmp_path / "python.csv")
    again = read_csv(tmp_path / "python.csv")
    assert again.dtype.names == table.dtype.names
    assert (again["t"] == table["t"]).all()
    if "debug" not in os.environ.get("VISCOVIB_SOLVE", ""):
        for name in table.dtype.names:
            assert (table[name] == again[name]).all()


@pytest.mark.parametrize(
    "group",
    [
        "&transient t_end=20, dt=0.25, nu=1.5 /\n&load amplitude=0.5 /",
        "&transient t_end=20, nu=1.5, save_every=2 /\n&load amplitude=0.5, phase=1 /",
        "&transient t_end=5, dt=0.1, initial=0.1 0 0.05 0, memory='direct' /",
        "&transient t_end=5, dt=0.1, held=0.1 0.05 /\n&load order=0, amplitude=0.2 /",
        "&transient t_end=5, dt=0.1, nu=1.3 /\n&load kind='base', amplitude=0.1 /\n&spectrum /",
    ],
)
def test_motions_with_memory_agree(solve, tmp_path, group):
    scene = tmp_path / "motion.nml"
    system = "\n".join(line for line in GOOD.splitlines() if "&load" not in line)
    system = system.split("&response")[0]
    scene.write_text(f"{system}\n{group}\n")
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    table = read_csv(tmp_path / "motion_transient.csv")
    result = vv.run(scene)
    run = result.trajectory
    assert (table["t"] == run.t).all()
    ours = np.stack([table[name] for name in table.dtype.names[1:]], axis=1)
    assert np.abs(ours - run.state).max() < 1e-13
    assert vv.plan(scene).strip() == solve(scene, "--plan").stdout.strip()
    assert (result.spectrum is None) == ("&spectrum" not in group)


@pytest.mark.parametrize(
    ("group", "message"),
    [
        ("&transient t_end=20, dt=0.25 /\n&load amplitude=0.5 /", "nu"),
        ("&transient t_end=20, dt=0.25, nu=1 /", "is the frequency of a load, and none has one"),
        ("&transient t_end=20, dt=0.25, memory='some' /", "must be one of 'auto'"),
        ("&transient t_end=20, dt=0.25, method='rk4' /", "must be one of 'gauss8'"),
        ("&transient t_end=20, dt=25 /", "dt = 25: must be greater than 0 and not exceed"),
        ("&transient t_end=20, initial=1 2 /", "initial"),
        ("&transient t_end=20 /\n&multiple_scales from=1, to=2 /", "needs &pendulum"),
    ],
)
def test_bad_motions_with_memory(solve, tmp_path, group, message):
    scene = tmp_path / "motion.nml"
    system = "\n".join(line for line in GOOD.splitlines() if "&load" not in line)
    scene.write_text(system.split("&response")[0] + f"\n{group}\n")
    done = solve(scene, "--out", tmp_path / "out")
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert message in done.stderr


def test_a_table_of_points_runs_directly(solve, tmp_path):
    scene = tmp_path / "table.nml"
    scene.write_text(
        "&mount mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2 /\n"
        "&kernel kind='tabulated', times=0 1 4, values=0.2 0.1 0 /\n"
        "&transient initial=0.1 0 0 0, t_end=3, dt=0.1 /\n"
    )
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "all of the past" in solve(scene, "--plan").stdout
    scene.write_text(scene.read_text().replace("dt=0.1", "dt=0.1, memory='exponentials'"))
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 2
    assert "no sum of exponentials" in done.stderr


def test_a_system_of_ones_own(solve, tmp_path):
    """Every group that makes one up, read by the driver and by Python."""
    scene = tmp_path / "own.nml"
    scene.write_text(
        "&system coordinates='a', 'b', units='m', 'rad', mass=1, 0.1, 0.1, 0.5,\n"
        "  stiffness=2, -1, -1, 1.5, damping=0.1, 0.05, base_direction=1, 0 /\n"
        "&kernel kind='prony', weights=0.1, rates=0.4 /\n"
        "&spring stiffness=0.5, 0, kernel=0 /\n"
        "&force on='a', coefficient=0.4, powers=2, 1 /\n"
        "&force on='b', coefficient=0.3, powers=0, 3, kernel=0 /\n"
        "&load on='b', amplitude=0.1, phase=0.3 /\n&load order=0, amplitude=0.05 /\n"
        "&load kind='base', order=2, amplitude=0.02 /\n"
        "&response method='newton', nu_min=0.3, nu_max=2.5, nu_count=30 /\n"
    )
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "X_k of b (rad)" in (tmp_path / "own_response.csv").read_text()
    table = read_csv(tmp_path / "own_response.csv")
    system = vv.PolynomialSystem(
        mass=[[1, 0.1], [0.1, 0.5]],
        stiffness=[[2, -1], [-1, 1.5]],
        damping=[0.1, 0.05],
        kernel=vv.PronyKernel(weights=[0.1], rates=[0.4]),
        forces={"a": "0.4*a^2*b"},
        springs=[vv.Springs(stiffness=[0.5, 0], forces={"b": "0.3*b^3"})],
        names=("a", "b"),
        base_direction=[1, 0],
    )
    load = {0: [0.05j, 0], 1: [0, 0.1 * np.exp(0.3j)]}
    r = vv.forced_response(system, table["nu"], load=load, base={2: 0.02}, method="newton")
    read = vv.run(scene).response
    assert read.dof_units == ("m", "rad")
    assert read.coefficients == pytest.approx(r.coefficients, abs=1e-15)
    for d, dof in enumerate("ab"):
        for j, k in enumerate(r.harmonics):
            found = table[f"{dof}_{k}_re"] + 1j * table[f"{dof}_{k}_im"]
            assert found == pytest.approx(r.coefficients[:, d, j], abs=1e-12)


def test_motion_of_a_system_of_ones_own(solve, tmp_path):
    scene = tmp_path / "own.nml"
    scene.write_text(
        "&system coordinates='a', 'b', units='m', 'rad', mass=1, 0.5, stiffness=2, -1, -1, 1.5,\n"
        "  damping=0.1, 0.05 /\n&force on='a', coefficient=0.4, powers=2, 1 /\n"
        "&load on='b', amplitude=0.1, phase=0.3 /\n&load order=0, amplitude=0.05 /\n"
        "&transient initial=0.3, 0, -0.2, 0.1, t_end=30, dt=0.25, nu=1.3 /\n&spectrum /\n"
    )
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    table = read_csv(tmp_path / "own_transient.csv")
    assert table.dtype.names == ("t", "a", "a_dot", "b", "b_dot")
    assert "# units: t in s, a in m, b in rad" in (tmp_path / "own_transient.csv").read_text()
    system = vv.PolynomialSystem(
        mass=[1, 0.5], stiffness=[[2, -1], [-1, 1.5]], damping=[0.1, 0.05],
        forces={"a": "0.4*a^2*b"}, names=("a", "b"),
    )  # fmt: skip
    load = {0: [0.05j, 0], 1: [0, 0.1 * np.exp(0.3j)]}
    run = vv.simulate(system, 30, dt=0.25, initial=[0.3, 0, -0.2, 0.1], load=load, nu=1.3)
    read = vv.run(scene)
    assert read.trajectory.state == pytest.approx(run.state, abs=1e-14)
    assert read.spectrum.names == ("a", "b")
    assert table["b_dot"] == pytest.approx(run.coordinate("b_dot"), abs=1e-12)
    names = read_csv(tmp_path / "own_spectrum.csv").dtype.names
    assert {"a_amplitude", "b_amplitude"} <= set(names)
    assert vv.plan(scene).splitlines() == solve(scene, "--plan").stdout.splitlines()


def test_branch_of_a_system_of_ones_own(solve, tmp_path):
    done = solve(SCENES / "duffing_branch.nml", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    branch = vv.run(SCENES / "duffing_branch.nml").branch
    table = read_csv(tmp_path / "duffing_branch_branch.csv")
    assert branch.folds.size == 2
    assert table["nu"] == pytest.approx(branch.nu, abs=1e-9)
    assert table["x_0_im"] == pytest.approx(branch.coefficients[:, 0, 0].imag, abs=1e-8)
    assert "16 harmonics" in vv.plan(SCENES / "duffing_branch.nml")


def test_branches_of_driver_and_python_agree(solve, tmp_path):
    scene = SCENES / "mount_branch.nml"
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "completed, " in done.stdout
    assert "2 folds" in done.stdout
    table = read_csv(tmp_path / "mount_branch_branch.csv")
    branch = vv.run(scene).branch
    assert vv.plan(scene).splitlines() == solve(scene, "--plan").stdout.splitlines()
    if "debug" not in os.environ.get("VISCOVIB_SOLVE", ""):
        assert (table["nu"] == branch.nu).all()
        for d, dof in enumerate(branch.dof_names):
            for j, k in enumerate(branch.harmonics):
                assert (table[f"{dof}_{k}_re"] == branch.coefficients[:, d, j].real).all()
                assert (table[f"{dof}_{k}_im"] == branch.coefficients[:, d, j].imag).all()


def test_spectra_of_driver_and_python_agree(solve, tmp_path):
    scene = tmp_path / "motion.nml"
    scene.write_text(MOTION + "&spectrum window='flat_top', discard=5 /\n")
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert vv.plan(scene).splitlines() == solve(scene, "--plan").stdout.splitlines()
    table = read_csv(tmp_path / "motion_spectrum.csv")
    spectrum = vv.run(scene).spectrum
    assert spectrum.coefficients.shape == (31, 3)
    spectrum.to_csv(tmp_path / "python.csv")
    again = read_csv(tmp_path / "python.csv")
    assert again.dtype.names == table.dtype.names
    for dof in ("z", "phi", "psi"):
        driver, python = (
            rows[f"{dof}_amplitude"] * np.exp(1j * rows[f"{dof}_phase"]) for rows in (table, again)
        )
        assert driver == pytest.approx(python, abs=1e-14)


def test_motion_that_stops_early_is_status_1(solve, tmp_path):
    scene = tmp_path / "motion.nml"
    scene.write_text(MOTION.replace("0.05 0 0.3", "0 -3 0.3"))
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 1
    assert "unphysical at t = " in done.stdout
    assert len(read_csv(tmp_path / "motion_transient.csv")) >= 1


def test_chaos_is_refused_and_leaves_nothing(solve, tmp_path):
    scene = tmp_path / "motion.nml"
    scene.write_text(
        MOTION.replace("dt=0.25", "tolerance=1e-13")
        .replace("t_end=20", "t_end=2000")
        .replace("f0=0.005", "f0=0.02")
        .replace("0.3 0 -0.2", "1.3 0 -1.2")
    )
    out = tmp_path / "out"
    out.mkdir()
    check_failure(solve(scene, "--out", out), 2, "the motion may be chaotic", out)


def test_plan_prints_and_computes_nothing(solve, tmp_path):
    done = solve(SCENES / "mount_paper.nml", "--plan", cwd=tmp_path)
    assert done.returncode == 0
    assert "skips: even harmonics and half of each period" in done.stdout
    assert not list(tmp_path.iterdir())


def test_no_memory_skips_the_transforms(solve, tmp_path):
    scene = tmp_path / "s.nml"
    scene.write_text(GOOD.replace("&kernel kind", "! &kernel kind"))
    assert "skips: kernel transforms (no memory)" in solve(scene, "--plan").stdout


def test_unsolved_frequencies_are_status_1(solve, tmp_path):
    scene = tmp_path / "s.nml"
    scene.write_text(GOOD.replace("amplitude=0.1 ", "amplitude=5.0 "))
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 1
    assert not done.stderr
    table = read_csv(tmp_path / "s_response.csv")
    lost = table["outcome"] != "converged"
    assert lost.any()
    assert np.isnan(table["x_1_re"][lost]).all()


def test_creep_is_warned_of(solve, tmp_path):
    scene = tmp_path / "s.nml"
    scene.write_text(GOOD.replace("0.048", "0.078"))
    done = solve(scene, "--out", tmp_path, "--quiet")
    assert done.returncode == 0
    assert done.stdout == ""
    assert done.stderr.startswith("warning: kernel integral = 1.00124")


def test_help_and_version(solve):
    assert "usage:" in solve("--help").stdout
    assert vv.__version__ in solve("--version").stdout


BAD_SCENES = {
    "typo in a key": (GOOD.replace("stiffness_x", "stifness_x"), 1, "did you mean 'stiffness_x'?"),
    "strange key": (GOOD.replace("mass=1,", "mass=1, colour=2,"), 1, "must be one of mass, "),
    "unknown group": (GOOD + "&pendulums /\n", 5, "unknown group &pendulums"),
    "missing key": (GOOD.replace("mass=1, ", ""), 1, "&mount lacks mass"),
    "negative mass": (GOOD.replace("mass=1", "mass=-1"), 1, "mass = -1: must be greater than 0"),
    "zero stiffness": (GOOD.replace("phi=2", "phi=0"), 1, "stiffness_phi = 0: must be greater"),
    "nan": (GOOD.replace("mass=1", "mass=nan"), 1, "mass = nan: must be a finite number"),
    "infinite": (GOOD.replace("mass=1", "mass=1e999"), 1, "mass = 1e999: must be a finite"),
    "text for number": (GOOD.replace("mass=1", "mass='one'"), 1, "mass = one: must be a number"),
    "number for text": (GOOD.replace("'rzhanitsyn'", "3"), 2, "kind = 3: must be a quoted text"),
    "two values": (GOOD.replace("mass=1,", "mass=1 2,"), 1, "mass has 2 values"),
    "a number with two signs": (GOOD.replace("mass=1", "mass=1-2"), 1, "mass = 1-2: must be a"),
    "too small": (GOOD.replace("mass=1", "mass=1e-999"), 1, "mass = 1e-999: must be a finite"),
    "logical for number": (GOOD.replace("mass=1", "mass=.true."), 1, "mass = .true.: must be a"),
    "letters exchanged": (GOOD.replace("alpha", "alhpa"), 2, "did you mean 'alpha'?"),
    "no value between commas": (GOOD.replace(GRID, "nu=1,,2"), 4, "nu: no value before a comma"),
    "repeats without end": (GOOD.replace(GRID, "nu=999999999*1"), 4, "must be a value, or a count"),
    "rates too few": (
        GOOD.replace(KERNEL, "kind='prony', weights=0.1 0.2 0.3,\nrates=1"),
        3,
        "weights and rates have 3 and 1 numbers: must match",
    ),
    "values too few": (
        GOOD.replace(KERNEL, "kind='tabulated', times=0 1 2,\nvalues=0.1"),
        3,
        "times and values have 3 and 1 numbers: must match",
    ),
    "no value": (GOOD.replace("mass=1,", "mass=,"), 1, "mass has no value"),
    "twice": (GOOD.replace("mass=1,", "mass=1,\nmass=2,"), 2, "mass is given twice"),
    "unknown kernel": (GOOD.replace("'rzhanitsyn'", "'maxwell'"), 2, "must be one of 'rzhan"),
    "alpha": (GOOD.replace("alpha=0.1", "alpha=1.5"), 2, "alpha = 1.5: must be in (0, 1]"),
    "beta": (GOOD.replace("beta=0.05", "beta=-1"), 2, "beta = -1: must not be negative"),
    "beta needed": (
        GOOD.replace("beta=0.05", "beta=0").replace("&load", "&load order=0, amplitude=1/\n&load"),
        2,
        "has no finite integral",
    ),
    "kernel twice": (
        GOOD.replace("&load", "&kernel kind='abel', amplitude=1, alpha=1/\n&load"),
        3,
        "has a kernel already",
    ),
    "geometry": (GOOD.replace("mass=1", "geometry='flat', mass=1"), 1, "geometry = 'flat'"),
    "damping": (GOOD.replace("mass=1", "damping=1 2 3, mass=1"), 1, "damping has 3 values"),
    "grid reversed": (GOOD.replace("nu_max=4", "nu_max=0.2"), 4, "nu_max = 0.2: must be greater"),
    "grid of one": (GOOD.replace("count=8", "count=1"), 4, "nu_count = 1: must be 2 to"),
    "grid count real": (GOOD.replace("count=8", "count=8.5"), 4, "8.5: must be an integer"),
    "nu unsorted": (
        GOOD.replace(GRID, "nu=1 3 2"),
        4,
        "nu (value 3) = 2 after 3: must be strictly increasing",
    ),
    "nu zero": (GOOD.replace(GRID, "nu=0 1"), 4, "greater than 0"),
    "nu twice": (GOOD.replace("nu_min", "nu=1, nu_min"), 4, "nu_min: the frequencies are listed"),
    "grid without end": (GOOD.replace("count=8", "count=100000000"), 4, "must be 2 to 1000000"),
    "tolerance": (GOOD.replace("nu_count=8", "nu_count=8,\ntolerance=0"), 5, "tolerance = 0"),
    "harmonics": (GOOD.replace("nu_count=8", "nu_count=8,\nharmonics=200"), 5, "must be 1 to 199"),
    "harmonics in words": (
        GOOD.replace("nu_count=8", "nu_count=8,\nharmonics='many'"),
        5,
        "harmonics = 'many': must be one of 'auto'",
    ),
    "iterations": (GOOD.replace("nu_count=8", "nu_count=8, max_iterations=0"), 4, "must be 1 to"),
    "relaxation": (GOOD.replace("nu_count=8", "nu_count=8, relaxation=2"), 4, "must be in (0, 1]"),
    "too few harmonics": (GOOD.replace("&load", "&load order=11,"), 4, "must be at least 11"),
    "order without end": (GOOD.replace("&load", "&load order=2000000000,"), 3, "must be 0 (mean)"),
    "phase of the mean": (GOOD.replace("&load", "&load order=0, phase=1,"), 3, "phase: the mean"),
    "base on phi": (GOOD.replace("&load", "&load kind='base', on='phi',"), 3, "on: the base moves"),
    "load order": (GOOD.replace("&load", "&load order=-1,"), 3, "order = -1: must be 0"),
    "no load": (GOOD.replace("&load amplitude=0.1 /", ""), None, "no &load group"),
    "no result": (GOOD[: GOOD.index("&response")], None, "no &response group"),
    "two mounts": (GOOD + GOOD.splitlines()[0], 5, "a second &mount"),
    "truncated": (GOOD[:-2], 4, "&response is not ended"),
    "truncated in a text": (GOOD[: GOOD.index("zhan")], 2, "quoted text is not ended"),
    "group in a group": (GOOD.replace("/\n&kernel", "\n&kernel"), 2, "'&kernel' inside &mount"),
    "outside": ("mass = 1\n" + GOOD, 1, "'mass' stands outside a group"),
    "no equals": (GOOD.replace("mass=1", "mass 1"), 1, "'mass' in &mount is not followed by '='"),
    "empty": ("", None, "no group such as &mount found"),
    "pendulum and mount": (MOTION + GOOD.splitlines()[0], 3, "&mount: belongs to a mount"),
    "pendulum with a kernel": (GOOD.splitlines()[1] + "\n" + MOTION, 1, "&kernel: belongs to"),
    "two results of a mount": (GOOD + MOTION.splitlines()[1], 4, "has &transient already"),
    "pendulum alone": (MOTION.splitlines()[0], None, "no &transient group"),
    "no such body": (MOTION.replace("e=0.1", "e=0.3"), 1, "must be less than 1"),
    "equations": (MOTION.replace("e=0.1", "e=0.1, equations='best'"), 1, "must be one of 'exact'"),
    "five numbers": (MOTION.replace("-0.2 0,", "-0.2,"), 2, "initial has 5 values"),
    "start below the pivot": (MOTION.replace("=0.05", "=-1.5"), 2, "z must be greater than -1"),
    "end": (MOTION.replace("t_end=20", "t_end=0"), 2, "t_end = 0: must be greater than 0"),
    "step": (MOTION.replace("dt=0.25", "dt=30"), 2, "not exceed t_end = 20"),
    "step negative": (MOTION.replace("dt=0.25", "dt=-1"), 2, "dt = -1: must be greater than 0"),
    "method": (MOTION.replace("dt=", "method='euler', dt="), 2, "must be one of 'gauss8'"),
    "motion tolerance": (MOTION.replace("dt=0.25", "tolerance=2"), 2, "must be in [1e-13, 1]"),
    "save_every": (MOTION.replace("dt=", "save_every=0, dt="), 2, "must be at least 1"),
    "too much to keep": (MOTION.replace("0.25", "1e-9"), 2, "would keep more than"),
    "window": (MOTION + "&spectrum window='hamming' /", 3, "window = 'hamming': must be one of"),
    "discard": (MOTION + "&spectrum discard=20 /", 3, "discard = 20: must not be negative"),
    "spectrum of a mount": (GOOD + "&spectrum /", 5, "&spectrum: needs &pendulum"),
    "branch and response": (GOOD + "&branch nu_from=1, nu_to=2 /", 5, "has &response already"),
    "branch to nowhere": (BRANCH.replace("nu_to=4", "nu_to=1"), 4, "must differ from nu_from"),
    "branch from zero": (BRANCH.replace("nu_from=1", "nu_from=0"), 4, "nu_from = 0: must be"),
    "branch of one": (BRANCH.rstrip()[:-1] + ", max_points=1 /", 4, "must be 2 to"),
    "branch step": (BRANCH.rstrip()[:-1] + ", max_step=0 /", 4, "max_step = 0: must be in"),
    "branch harmonics": (BRANCH.rstrip()[:-1] + ", harmonics=0 /", 4, "harmonics = 0: must be"),
    "not UTF-8": (GOOD.encode() + b"&scene title='caf\xe9' /\n", 5, "byte 233 found"),
    "binary": ("\x00\x01\x7f" * 50, 1, "this is not a text file"),
}


def check_failure(done, status, text, folder):
    assert done.returncode == status, done
    assert done.stdout == ""
    lines = done.stderr.splitlines()
    assert len(lines) == 1, done.stderr
    assert text in lines[0]
    assert not list(folder.iterdir())


@pytest.mark.parametrize("name", BAD_SCENES)
def test_bad_scene_is_one_line_with_its_place(solve, tmp_path, name):
    text, line, message = BAD_SCENES[name]
    scene = tmp_path / "bad.nml"
    scene.write_bytes(text if isinstance(text, bytes) else text.encode())
    out = tmp_path / "out"
    out.mkdir()
    done = solve(scene, "--out", out)
    check_failure(done, 2, message, out)
    place = f"{scene}:{line}: " if line else f"{scene}: "
    assert place in done.stderr
    with silence(), pytest.raises(vv.InputError) as error:
        vv.Scene.read(scene)
    assert str(error.value).startswith(place)
    assert message in str(error.value)


def test_tabulated_kernel_in_a_file_is_the_one_in_the_scene(solve, tmp_path):
    (tmp_path / "kernel.txt").write_text("# s, 1/s\n0 0.1\n1, 0.05  ! measured\n\n2 0.01")
    scenes = {
        "file": GOOD.replace(KERNEL, "kind='tabulated', file='kernel.txt'"),
        "here": GOOD.replace(KERNEL, "kind='tabulated', times=0 1 2, values=0.1 0.05 0.01"),
    }
    tables = []
    for name, text in scenes.items():
        scene = tmp_path / f"{name}.nml"
        scene.write_text(text.replace("nu_min", "method='linear', nu_min"))
        assert solve(scene, "--out", tmp_path).returncode == 0
        tables.append(read_csv(tmp_path / f"{name}_response.csv"))
    assert (tables[0] == tables[1]).all()
    (kernel,) = vv.Scene.read(tmp_path / "file.nml").groups["kernel"]
    assert kernel["times"] == [0, 1, 2]
    assert kernel["values"] == [0.1, 0.05, 0.01]


@pytest.mark.parametrize(
    ("text", "status", "message"),
    [
        ("0 1\n1 x\n", 2, "kernel.txt:2: '1 x': must be two finite numbers"),
        ("0 1\n0 2\n", 2, "scene.nml:2: file: times (value 2) = 0 after 0"),
        (None, 3, "scene.nml:2: file: "),
    ],
)
def test_bad_kernel_file_is_one_line(solve, tmp_path, text, status, message):
    scene = tmp_path / "scene.nml"
    scene.write_text(GOOD.replace(KERNEL, "kind='tabulated', file='kernel.txt'"))
    if text is not None:
        (tmp_path / "kernel.txt").write_text(text)
    out = tmp_path / "out"
    out.mkdir()
    check_failure(solve(scene, "--out", out), status, message, out)


def test_long_lists_are_read_at_once(solve, tmp_path):
    """Reading 200 000 numbers takes a fraction of a second; it once grew with their square."""
    scene = tmp_path / "scene.nml"
    scene.write_text(GOOD.replace(GRID, "nu=" + " ".join(str(i) for i in range(1, 200_001))))
    begun = os.times()
    done = solve(scene, "--plan")
    assert done.returncode == 0, done.stderr
    assert "200000 frequencies" in done.stdout
    # Time of its own, whatever else this machine does.
    ended = os.times()
    spent = ended.children_user + ended.children_system
    assert spent - begun.children_user - begun.children_system < 10


def test_full_disk_is_status_3_and_keeps_the_old_table(solve, tmp_path):
    """A disk of four pages, in a mount name space of its own."""
    disk = tmp_path / "disk"
    disk.mkdir()
    program = solve("--version").args[0]
    script = (
        f"mount -t tmpfs -o size=16k tmpfs {disk} || exit 99; cd {disk}; mkdir out; "
        f"echo old > out/mount_paper_response.csv; "
        f"{program} {SCENES / 'mount_paper.nml'} --out out; echo $?; ls out; cat out/*"
    )
    if shutil.which("unshare") is None:
        pytest.skip("no unshare")
    done = subprocess.run(
        ["unshare", "-m", "sh", "-c", script], capture_output=True, text=True, timeout=60
    )
    if done.returncode != 0:
        pytest.skip("this user may not mount")
    assert done.stdout.split() == ["3", "mount_paper_response.csv", "old"]
    assert "mount_paper_response.csv: writing failed (disk full?)" in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize("what", ["missing", "folder", "forbidden"])
def test_unreadable_scene_is_status_3(solve, tmp_path, what):
    scene = tmp_path / "scene.nml"
    out = tmp_path / "out"
    out.mkdir()
    if what == "folder":
        scene.mkdir()
    if what == "forbidden":
        scene.write_text(GOOD)
        scene.chmod(0)
        if os.access(scene, os.R_OK):
            pytest.skip("this user reads everything")
    check_failure(solve(scene, "--out", out), 3, str(scene), out)
    with pytest.raises(vv.FileError, match=r"scene\.nml"):
        vv.Scene.read(scene)


def test_output_folder_that_cannot_be_is_status_3(solve, tmp_path):
    (tmp_path / "file").write_text("")
    done = solve(SCENES / "mount_paper.nml", "--out", tmp_path / "file" / "sub")
    assert done.returncode == 3
    assert len(done.stderr.splitlines()) == 1
    assert "cannot be written" in done.stderr


def test_table_in_the_place_of_a_folder_leaves_nothing(solve, tmp_path):
    (tmp_path / "mount_paper_response.csv").mkdir()
    done = solve(SCENES / "mount_paper.nml", "--out", tmp_path)
    assert done.returncode == 3
    assert [path.name for path in tmp_path.iterdir()] == ["mount_paper_response.csv"]


@pytest.mark.parametrize(
    "arguments", [[], ["--out"], ["a.nml", "--out", ""], ["--nonsense"], ["a.nml", "b.nml"]]
)
def test_wrong_command_line_is_status_2(solve, tmp_path, arguments):
    check_failure(solve(*arguments, cwd=tmp_path), 2, "usage: viscovib-solve", tmp_path)


def command(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "viscovib.cli", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_python_command_runs_plans_and_draws(tmp_path):
    done = command("run", SCENES / "mount_paper.nml", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "400 of 400 frequencies solved" in done.stdout
    assert (tmp_path / "mount_paper_response.png").stat().st_size > 20_000
    assert "skips: base motion" in command("plan", SCENES / "mount_paper.nml").stdout
    done = command("run", SCENES / "pendulum_paper.nml", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "completed at t = 2000, 8001 states" in done.stdout
    assert (tmp_path / "pendulum_paper_transient.png").stat().st_size > 20_000
    done = command("run", SCENES / "mount_branch.nml", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "fold at nu = 2.5931843" in done.stdout
    assert (tmp_path / "mount_branch_branch.png").stat().st_size > 20_000
    done = command("run", tmp_path / "none.nml")
    assert done.returncode == 3
    assert len(done.stderr.splitlines()) == 1


def test_driver_reproduces_the_tabulated_curves(solve, tmp_path):
    """Every curve of data/mount_response_h9.csv through a scene file, to 1e-10."""
    lines = (SCENES.parent / "mount_response_h9.csv").read_text().splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    curves = {}
    for row in rows:
        curves.setdefault((row["geometry"], row["A"], row["P"]), []).append(row)
    assert len(curves) == 21
    for (geometry, a, load), points in curves.items():
        scene = tmp_path / "curve.nml"
        scene.write_text(
            GOOD.replace("0.048", a)
            .replace("amplitude=0.1 ", f"amplitude={load} ")
            .replace("mass=1", f"geometry='{geometry}', mass=1")
            .replace(
                "nu_min=0.5, nu_max=4, nu_count=8",
                f"tolerance=1e-13, nu={' '.join(p['nu'] for p in points)}",
            )
        )
        done = solve(scene, "--out", tmp_path)
        assert done.returncode == 0, done.stderr
        table = read_csv(tmp_path / "curve_response.csv")
        for dof in ("x", "phi"):
            largest = np.array(
                [abs(complex(float(p[f"{dof}_1_re"]), float(p[f"{dof}_1_im"]))) for p in points]
            )
            for k in (1, 3, 5, 7, 9):
                for part in ("re", "im"):
                    expected = np.array([float(p[f"{dof}_{k}_{part}"]) for p in points])
                    error = np.abs(table[f"{dof}_{k}_{part}"] - expected)
                    assert (error <= 1e-10 * largest).all()


def test_sweeps_are_left_to_python(solve, tmp_path):
    scene = tmp_path / "scene.nml"
    scene.write_text(GOOD + "&sweep key='load.amplitude', values=0.1 0.2 /\n")
    for more in ([], ["--plan"]):
        done = solve(scene, "--out", tmp_path / "out", *more)
        assert done.returncode == 2
        assert done.stderr == (
            f"viscovib-solve: {scene}:5: &sweep: sweeps are run by Python (viscovib sweep SCENE); "
            "this program runs single points, leave the group out\n"
        )
    assert not (tmp_path / "out").exists()
    scene.write_text(GOOD + "&sweep key='load.weight', values=0.1 0.2 /\n")
    done = solve(scene, "--out", tmp_path / "out")
    assert done.returncode == 2
    assert done.stderr.startswith(f"viscovib-solve: {scene}:5: key = 'load.weight': &load has no")


@pytest.mark.parametrize(
    ("group", "message"),
    [
        ("key='', values=1", "must be a key in its group"),
        ("key='.', values=1", "must be a key in its group"),
        ("key='load.', values=1", "must be a key in its group"),
        ("key='load(.amplitude', values=1", "must be a key in its group"),
        ("key='load().amplitude', values=1", "must be a key in its group"),
        ("key='load(x).amplitude', values=1", "must be a key in its group"),
        ("key='load(999999999999).amplitude', values=1", "must be a key in its group"),
        ("key='load(7).amplitude', values=1", "this scene has &load 1 times"),
        ("key='mount.', values=1", "must be a key in its group"),
        ("key=3, values=1", "must be a quoted text"),
        ("key='load.amplitude', values='a'", "must be numbers"),
        ("key='load.amplitude', values=", "values has no value"),
        ("key='load.amplitude', min=1, max=2, count=3, spacing='odd'", "must be one of"),
    ],
)
def test_every_wrong_sweep_is_a_line(solve, tmp_path, group, message):
    scene = tmp_path / "scene.nml"
    scene.write_text(GOOD + f"&sweep {group} /\n")
    done = solve(scene, "--out", tmp_path / "out")
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith(f"viscovib-solve: {scene}:5: ")
    assert message in done.stderr


STEADY = """&pendulum e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.005, c2=0.005, f0=0.002, p1=1 /
&multiple_scales from=1.0, to=1.05, count=26 /
"""

BAD_STEADY = {
    "both results": (STEADY + MOTION.splitlines()[1], 2, "has &transient already"),
    "spectrum of steady motions": (STEADY + "&spectrum /", 3, "&spectrum: needs &transient"),
    "of a mount": (GOOD + "&multiple_scales from=1, to=2 /", 5, "needs &pendulum"),
    "parameter": (STEADY.replace("from", "parameter='p4', from"), 2, "must be one of 'p1'"),
    "nowhere": (STEADY.replace("to=1.05", "to=1.0"), 2, "to = 1: must be greater than from = 1"),
    "count": (STEADY.replace("count=26", "count=1"), 2, "count = 1: must be 2 to"),
    "from": (STEADY.replace("from=1.0", "from=-1.0"), 2, "from = -1: must be greater than 0"),
    "tolerance": (STEADY.replace("count", "tolerance=1, count"), 2, "tolerance = 1: must be in"),
}


@pytest.mark.parametrize("name", BAD_STEADY)
def test_bad_multiple_scales_is_one_line_with_its_place(solve, tmp_path, name):
    text, line, message = BAD_STEADY[name]
    scene = tmp_path / "bad.nml"
    scene.write_text(text)
    out = tmp_path / "out"
    out.mkdir()
    done = solve(scene, "--out", out)
    check_failure(done, 2, message, out)
    assert f"{scene}:{line}: " in done.stderr


def test_steady_motions_by_driver_and_python(solve, tmp_path):
    scene = tmp_path / "steady.nml"
    scene.write_text(STEADY)
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    lines = (tmp_path / "steady_multiple_scales.csv").read_text().splitlines()
    lines = [line for line in lines if not line.startswith("#")]
    table = np.genfromtxt(lines, delimiter=",", names=True)
    result = vv.run(scene)
    assert result.kind == "multiple_scales"
    np.testing.assert_allclose(table["p1"], result.steady.at, rtol=1e-15)
    np.testing.assert_allclose(table["z_re"], result.steady.harmonics[:, 0].real, rtol=1e-12)
    np.testing.assert_array_equal(table["stable"] == 1, result.steady.stable)
    assert solve(scene, "--plan").stdout.strip() == vv.plan(scene).strip()
    with pytest.raises(vv.InputError, match="this scene gave something else"):
        _ = result.trajectory


def test_steady_motions_by_command(tmp_path):
    done = command("run", SCENES / "pendulum_scales.nml", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "pendulum_scales_multiple_scales.csv").exists()
    assert (tmp_path / "pendulum_scales_multiple_scales.png").stat().st_size > 20_000


def test_steady_motions_of_no_load(solve, tmp_path):
    scene = tmp_path / "still.nml"
    scene.write_text(STEADY.replace("f0=0.002", "f0=0"))
    done = solve(scene, "--out", tmp_path / "out")
    assert done.returncode == 2
    assert "load 1 has no amplitude" in done.stderr
