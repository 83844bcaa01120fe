"""The standalone driver: one line for every wrong scene; lists and tables in files."""

import os

import numpy as np
import pytest
import viscovib as vv
from driver import (
    BRANCH,
    GOOD,
    GRID,
    KERNEL,
    MOTION,
    check_failure,
    check_refused,
    read_csv,
)

BAD_SCENES = {
    "typo in a key": (GOOD.replace("stiffness_x", "stifness_x"), 1, "did you mean 'stiffness_x'?"),
    "strange key": (GOOD.replace("mass=1,", "mass=1, colour=2,"), 1, "must be one of mass, "),
    "unknown group": (GOOD + "&pendulums /\n", 5, "unknown group &pendulums"),
    "missing key": (GOOD.replace("mass=1, ", ""), 1, "&mount lacks mass"),
    "negative mass": (GOOD.replace("mass=1", "mass=-1"), 1, "mass = -1: must be greater than 0"),
    "zero stiffness": (GOOD.replace("phi=2", "phi=0"), 1, "stiffness_phi = 0: must be greater"),
    "nan": (GOOD.replace("mass=1", "mass=nan"), 1, "mass = nan: must be a finite number"),
    "infinite": (GOOD.replace("mass=1", "mass=1e999"), 1, "mass = 1e999: must be a finite"),
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
    "damping": (GOOD.replace("mass=1", "damping=1 2 3, mass=1"), 1, "damping has 3 values"),
    "former name": (GOOD.replace("nu_to", "nu_max"), 4, "nu_max: the ends are nu_from and nu_to"),
    "grid reversed": (GOOD.replace("nu_to=4", "nu_to=0.2"), 4, "nu_to = 0.2: must be greater"),
    "grid of one": (GOOD.replace("count=8", "count=1"), 4, "nu_count = 1: must be 2 to"),
    "nu unsorted": (
        GOOD.replace(GRID, "nu=1 3 2"),
        4,
        "nu (value 3) = 2 after 3: must be strictly increasing",
    ),
    "nu zero": (GOOD.replace(GRID, "nu=0 1"), 4, "greater than 0"),
    "nu twice": (
        GOOD.replace("nu_from", "nu=1, nu_from"),
        4,
        "nu_from: the frequencies are listed",
    ),
    "grid without end": (GOOD.replace("count=8", "count=100000000"), 4, "must be 2 to 1000000"),
    "tolerance": (GOOD.replace("nu_count=8", "nu_count=8,\ntolerance=0"), 5, "tolerance = 0"),
    "harmonics": (GOOD.replace("nu_count=8", "nu_count=8,\nharmonics=400"), 5, "must be 1 to 399"),
    "harmonics in words": (
        GOOD.replace("nu_count=8", "nu_count=8,\nharmonics='many'"),
        5,
        "harmonics = 'many': must be one of 'auto'",
    ),
    "harmonics without quotes": (
        GOOD.replace("nu_count=8", "nu_count=8,\nharmonics=auto"),
        5,
        "harmonics = auto: must be an integer or, in quotes, 'auto'",
    ),
    "iterations": (GOOD.replace("nu_count=8", "nu_count=8, max_iterations=0"), 4, "must be 1 to"),
    "relaxation": (GOOD.replace("nu_count=8", "nu_count=8, relaxation=2"), 4, "must be in (0, 1]"),
    "too few harmonics": (
        GOOD.replace("&load", "&load order=11,").replace("nu_count=8", "nu_count=8, harmonics=9"),
        4,
        "must be at least 11",
    ),
    "order without end": (GOOD.replace("&load", "&load order=2000000000,"), 3, "must be 0 (mean)"),
    "phase of the mean": (GOOD.replace("&load", "&load order=0, phase=1,"), 3, "phase: the mean"),
    "base on phi": (GOOD.replace("&load", "&load kind='base', on='phi',"), 3, "on: the base moves"),
    "formula of another variable": (
        GOOD.replace("amplitude=0.1", "amplitude='0.1*mu^2'"),
        3,
        "amplitude = '0.1*mu^2': must be a number or a formula in nu: 'mu' is neither",
    ),
    "phase of another variable": (
        GOOD.replace("amplitude=0.1", "amplitude=0.1, phase='nu*t'"),
        3,
        "phase = 'nu*t': must be a number or a formula in nu: 't' is neither",
    ),
    "parameter with the name of the frequency": (
        "&parameters nu=2 /\n&system coordinates='x' mass=1 stiffness=1 damping=1 /\n"
        "&load amplitude='0.1*nu' /\n&response nu=1 /\n",
        1,
        "nu: is the frequency in a formula of a &load",
    ),
    "empty formula": (GOOD.replace("amplitude=0.1", "amplitude=''"), 3, "a formula in nu"),
    "formula of the mean": (
        GOOD.replace("amplitude=0.1", "amplitude='nu', order=0"),
        3,
        "must be a number for order = 0",
    ),
    "formula of the base": (
        GOOD.replace("amplitude=0.1", "amplitude='nu', kind='base'"),
        3,
        "must be a number for kind = 'base'",
    ),
    "formula without a value": (
        GOOD.replace("amplitude=0.1", "amplitude='log(nu - 1)'"),
        4,
        "load: '(log(nu - 1))' has no finite value at nu = ",
    ),
    "formula with a pole": (
        "&system coordinates='x' mass=1 stiffness=1 damping=1 /\n"
        "&load amplitude='0.1/(nu - 1)' /\n&branch nu_from=0.5 nu_to=1.7 /\n",
        3,
        "load: '(0.1/(nu - 1))' has no finite value at nu = ",
    ),
    "formula without a value in time": (
        "&system coordinates='x' mass=1 stiffness=1 damping=1 /\n"
        "&load amplitude='0.1/(nu - 1)' /\n&transient nu=1 t_end=5 /\n",
        3,
        "load: '(0.1/(nu - 1))' has no finite value at nu = 1",
    ),
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
    "spectrum of a mount": (GOOD + "&spectrum /", 5, "&spectrum: needs &transient"),
    "branch and response": (GOOD + "&branch nu_from=1, nu_to=2 /", 5, "has &response already"),
    "branch to nowhere": (BRANCH.replace("nu_to=4", "nu_to=1"), 4, "must differ from nu_from"),
    "branch from zero": (BRANCH.replace("nu_from=1", "nu_from=0"), 4, "nu_from = 0: must be"),
    "branch of one": (BRANCH.rstrip()[:-1] + ", max_points=1 /", 4, "must be 2 to"),
    "branch angle": (BRANCH.rstrip()[:-1] + ", angle=1 /", 4, "angle = 1: must be in"),
    "two names of an error": (
        GOOD.replace(GRID, GRID + ", rtol=1e-6, tolerance=1e-5"),
        4,
        "rtol = 1e-6: is another name of tolerance",
    ),
    "negative atol": (GOOD.replace(GRID, GRID + ", atol=-1"), 4, "atol = -1: must be in [0, 1e30]"),
    "negative rtol of a branch": (
        BRANCH.rstrip()[:-1] + ", rtol=-1e-3 /",
        4,
        "rtol = -0.001: must be in [1e-14, 0.1]",
    ),
    "branch folds": (BRANCH.rstrip()[:-1] + ", max_folds=0 /", 4, "max_folds = 0: must be 1 to"),
    "branch step": (BRANCH.rstrip()[:-1] + ", max_step=0 /", 4, "max_step = 0: must be in"),
    "branch harmonics": (BRANCH.rstrip()[:-1] + ", harmonics=0 /", 4, "harmonics = 0: must be"),
    "not UTF-8": (GOOD.encode() + b"&scene title='caf\xe9' /\n", 5, "byte 233 found"),
    "binary": ("\x00\x01\x7f" * 50, 1, "this is not a text file"),
}


@pytest.mark.parametrize("name", BAD_SCENES)
def test_bad_scene_is_one_line_with_its_place(solve, tmp_path, name):
    text, line, message = BAD_SCENES[name]
    check_refused(solve, tmp_path, text, message, line)


def test_tabulated_kernel_in_a_file_is_the_one_in_the_scene(solve, tmp_path):
    (tmp_path / "kernel.txt").write_text("# s, 1/s\n0 0.1\n1, 0.05  ! measured\n\n2 0.01")
    scenes = {
        "file": GOOD.replace(KERNEL, "kind='tabulated', file='kernel.txt'"),
        "here": GOOD.replace(KERNEL, "kind='tabulated', times=0 1 2, values=0.1 0.05 0.01"),
    }
    tables = []
    for name, text in scenes.items():
        scene = tmp_path / f"{name}.nml"
        scene.write_text(text.replace("nu_from", "method='linear', nu_from"))
        assert solve(scene, "--out", tmp_path).returncode == 0
        tables.append(read_csv(tmp_path / f"{name}_response.csv"))
    assert (tables[0] == tables[1]).all()
    (kernel,) = vv.Scene.read(tmp_path / "file.nml").groups["kernel"]
    assert kernel["times"] == [0, 1, 2]
    assert kernel["values"] == [0.1, 0.05, 0.01]


@pytest.mark.parametrize(
    ("text", "status", "message"),
    [
        ("0 1\n1 x\n", 2, "kernel.txt:2: a line must be two finite numbers"),
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
    """Reading 200 000 numbers takes a fraction of a second, linear in their number."""
    scene = tmp_path / "scene.nml"
    scene.write_text(GOOD.replace(GRID, "nu=" + " ".join(str(i) for i in range(1, 200_001))))
    begun = os.times()
    done = solve(scene, "--plan")
    assert done.returncode == 0, done.stderr
    assert "200000 frequencies" in done.stdout
    # Processor time, independent of other processes.
    ended = os.times()
    spent = ended.children_user + ended.children_system
    assert spent - begun.children_user - begun.children_system < 10


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
    check_refused(solve, tmp_path, GOOD + f"&sweep {group} /\n", message, 5)


def test_a_response_says_why_it_has_no_solution(solve, tmp_path):
    """Reason and location of the failure, and the location of the largest truncation."""
    scene = tmp_path / "scene.nml"
    text = (
        "&system coordinates='x' mass=1 stiffness=1 damping=0.1 /\n"
        "&force on='x' law='0.5*sign(x_dot)' /\n&load on='x' amplitude=0.4 /\n"
        "&response nu=0.5 0.6 0.9 method='newton' /\n"
    )
    scene.write_text(text)
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 1
    reported = "0 of 3 frequencies solved; no solution (3 stalled) at nu = 0.5 to 0.9, nan there"
    assert reported in done.stdout
    text = text.replace("0.5*sign(x_dot)", "0.5*x^3").replace("nu=", "harmonics=3 nu=")
    scene.write_text(text)
    done = solve(scene, "--out", tmp_path)
    assert (
        "3 of them with too few harmonics (worst at nu = 0.5, with an estimated relative error of"
        in done.stdout
    )


@pytest.mark.parametrize("kind", ["system", "structure"])
def test_static_equilibria_balance_the_forces(solve, tmp_path, kind):
    """Random springs with a relaxed kernel: K (1 - integral) u + c u^3 = F."""
    rng = np.random.default_rng(5)
    scene = tmp_path / "scene.nml"
    for _ in range(4):
        n = int(rng.integers(1, 4))
        root = rng.normal(size=(n, n))
        stiffness = root @ root.T + np.eye(n)
        cubic, force = rng.uniform(0.1, 1), rng.uniform(-2, 2)
        weight, rate, spring = rng.uniform(0.1, 0.5), rng.uniform(0.5, 2), rng.uniform(0.5, 2)
        listed = " ".join(map(str, stiffness.ravel()))
        names = " ".join(f"'x{i + 1}'" for i in range(n))
        more = f"&element on='x1' stiffness={spring} kernel=1 /\n"
        more += f"&element on='x1' law='{cubic}*d^3' kernel=0 /"
        whole = "kernel=0" if kind == "system" else ""
        if kind == "system":
            own = " ".join(map(str, np.diag([spring] + [0.0] * (n - 1)).ravel()))
            more = (
                f"&spring stiffness={own} kernel=1 /\n&force on='x1' law='{cubic}*x1^3' kernel=0 /"
            )
        scene.write_text(
            f"&{kind} coordinates={names} mass={'1 ' * n} stiffness={listed} {whole} /\n"
            f"&kernel kind='prony' weights={weight} rates={rate} /\n{more}\n"
            f"&load on='x1' amplitude={force} order=0 /\n&equilibrium /\n"
        )
        done = solve(scene, "--out", tmp_path)
        assert done.returncode == 0, done.stderr
        table = read_csv(tmp_path / "scene_equilibrium.csv")
        u = np.array([float(table[f"x{i + 1}"]) for i in range(n)])
        left = stiffness @ u
        left[0] += spring * (1 - weight / rate) * u[0] + cubic * u[0] ** 3 - force
        assert np.abs(left).max() < 1e-9 * abs(force)


def test_static_equilibria_have_constant_loads(solve, tmp_path):
    scene = GOOD.split("&response")[0] + "&equilibrium /\n"
    check_refused(solve, tmp_path, scene, "the loads must be constant (order = 0)")


def test_characteristic_roots_of_modal_damping(solve, tmp_path):
    """s^2 + 2 zeta omega s + omega^2 for each mode."""
    scene = tmp_path / "scene.nml"
    scene.write_text(
        "&structure mass=1 1 stiffness=2 -1 -1 2 modal_damping=0.03 /\n&characteristic_roots /\n"
    )
    assert solve(scene, "--out", tmp_path).returncode == 0
    table = read_csv(tmp_path / "scene_characteristic_roots.csv")
    assert np.array(table["damping_ratio"], float) == pytest.approx([0.03, 0.03], rel=1e-12)
    omega = np.hypot(np.array(table["s_re"], float), np.array(table["s_im"], float))
    assert omega == pytest.approx([1, np.sqrt(3)], rel=1e-12)


def test_characteristic_roots_refuse_what_has_none(solve, tmp_path):
    structure = "&structure mass=1 stiffness=2 loss_factor=0.1 /\n"
    for text, reported in (
        (structure, "loss_factor: has no meaning in free motion"),
        ("&structure mass=1 0 stiffness=2 -1 -1 2 /\n", "mass: must be positive"),
        ("&pendulum e=0.1 w2=0.4 w3=0.8 /\n", "&characteristic_roots: belongs to a mount"),
    ):
        check_refused(solve, tmp_path, f"{text}&characteristic_roots /\n", reported)


def random_switching(rng):
    """A scene and the same system in Python: gaps and friction."""
    n = int(rng.integers(1, 4))
    names = [f"x{i + 1}" for i in range(n)]
    root = rng.normal(size=(n, n))
    stiffness, mass = root @ root.T + np.eye(n), rng.uniform(0.5, 2, n)
    damping = rng.uniform(0.05, 0.2) * np.eye(n)
    last, cubic, friction = names[-1], rng.uniform(0.1, 2), rng.uniform(0.01, 0.2)
    laws = {
        "x1": f"{rng.uniform(2, 30)}*max(x1 - {rng.uniform(0.05, 0.3)}, 0)",
        last: f"{cubic}*{last}^3 + {friction}*sign({last}_dot)",
    }
    amplitudes = rng.uniform(-1, 1, n)
    rows = [" ".join(map(repr, m.ravel().tolist())) for m in (np.diag(mass), stiffness, damping)]
    text = (
        f"&system coordinates={' '.join(map(repr, names))}\n"
        f"  mass={rows[0]}\n  stiffness={rows[1]}\n  damping={rows[2]} /\n"
    )
    text += "".join(f"&force on='{x}' law='{law}' /\n" for x, law in laws.items())
    text += "".join(
        f"&load on='{x}' amplitude={a!r} /\n"
        for x, a in zip(names, amplitudes.tolist(), strict=True)
    )
    system = vv.PolynomialSystem(
        mass=np.diag(mass), stiffness=stiffness, damping=damping, names=names, forces=laws
    )
    return text, system, amplitudes


@pytest.mark.parametrize("seed", [0, 3])
def test_steady_motions_as_in_python(solve, tmp_path, seed):
    """The table contains the states, the multipliers and the error of `vv.steady_motion`."""
    rng = np.random.default_rng(seed)
    text, system, amplitudes = random_switching(rng)
    nu, periods = float(rng.uniform(0.5, 2)), int(rng.integers(1, 3))
    scene = tmp_path / "scene.nml"
    scene.write_text(f"{text}&steady_motion nu={nu!r} n_periods={periods} rtol=1e-9 /\n")
    done = solve(scene, "--out", tmp_path)
    motion = vv.steady_motion(system, nu, load=amplitudes, n_periods=periods, rtol=1e-9)
    assert motion.complete
    assert done.returncode == 0, done.stderr
    assert ("unstable" in done.stdout) is (motion.stable is False)
    lines = (tmp_path / "scene_steady_motion.csv").read_text().splitlines()
    rows = [line for line in lines if not line.startswith("#")][1:]
    table = np.array([[float(cell) for cell in row.split(",")] for row in rows])
    np.testing.assert_array_equal(table[:, 0], motion.t)
    np.testing.assert_allclose(table[:, 1:], motion.state, rtol=0, atol=1e-13)
    assert f"repeats after {motion.repeats_after};" in "".join(lines)
    reported = (tmp_path / "scene_steady_motion_1.csv").read_text().splitlines()
    found = np.array(
        [complex(*map(float, row.split(",")[:2])) for row in reported if row[0] in "-0123456789"]
    )
    np.testing.assert_allclose(np.abs(found), np.abs(motion.multipliers), rtol=0, atol=1e-9)


REPEATS = "&system mass=1 stiffness=1 damping=0.1 coordinates='x' /\n&load amplitude=0.3 /\n"


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        (REPEATS + "&steady_motion /", "nu"),
        (REPEATS + "&steady_motion nu=-1 /", "nu = -1: must be greater than 0"),
        (REPEATS + "&steady_motion nu=1 n_periods=65 /", "n_periods = 65: must be 1 to 64"),
        (REPEATS + "&steady_motion nu=1 method='rk4' /", "must be one of 'gauss8', 'gauss16'"),
        (REPEATS + "&steady_motion nu=1 tolerance=0 /", "tolerance = 0: must be in [1e-13, 1]"),
        (REPEATS + "&steady_motion nu=1 tolerance=1e-9 rtol=1e-9 /", "must not be given with rtol"),
        (REPEATS + "&steady_motion nu=1 period=2 /", "unknown key 'period'"),
        (
            "&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2 /\n"
            "&load amplitude=0.1 /\n&steady_motion nu=1 /",
            "takes a &system, a &structure or a &body",
        ),
        (
            "&system mass=1 stiffness=1 base_direction=1 coordinates='x' /\n"
            "&load kind='base' amplitude=0.1 /\n&steady_motion nu=1 /",
            "the base must be at rest",
        ),
        (
            "&structure mass=1 stiffness=1 loss_factor=0.1 /\n&load amplitude=0.1 on='x1' /\n"
            "&steady_motion nu=1 /",
            "without shapes and loss_factor",
        ),
        (
            "&system mass=1 stiffness=1 coordinates='x' kernel=1 /\n"
            "&kernel kind='abel' amplitude=0.05 alpha=0.2 /\n"
            "&load amplitude=0.1 /\n&steady_motion nu=1 /",
            "kernels that are not sums of exponentials",
        ),
    ],
)
def test_steady_motions_refused(solve, tmp_path, text, reported):
    check_refused(solve, tmp_path, text + "\n", reported)


def test_free_decay_is_that_of_python(solve, tmp_path):
    """Roots and amplitudes as in Python; roots of the characteristic equation."""
    rng, scene = np.random.default_rng(4), tmp_path / "scene.nml"
    for group in ("system", "structure"):
        c, k, start = rng.uniform(0.02, 0.1), rng.uniform(1, 3), rng.uniform(1, 5)
        names = " coordinates='x1' 'x2'"
        scene.write_text(
            f"&{group} mass=1 2 stiffness={k} -1 -1 {k} damping={c} 0 0 {2 * c} {names} /\n"
            "&transient t_end=60 dt=0.1 initial=0.1 0 0 0 /\n"
            f"&free_decay count=2 start={start} /\n"
        )
        done = solve(scene, "--out", tmp_path)
        assert done.returncode == 0, done.stderr
        assert "2 decaying oscillations" in done.stdout
        table = read_csv(tmp_path / "scene_free_decay.csv")
        found = np.array(table["s_re"], float) + 1j * np.array(table["s_im"], float)
        pair = {"mass": [1, 2], "stiffness": [[k, -1], [-1, k]], "damping": [c, 2 * c]}
        system = vv.PolynomialSystem(**pair, names=["x1", "x2"])
        roots = system.characteristic_roots().oscillatory
        assert found[np.argsort(found.imag)] == pytest.approx(roots, rel=1e-8)
        run = vv.simulate(system, 60, dt=0.1, initial=[0.1, 0, 0, 0])
        decay = vv.free_decay(run, start=start)
        # Each row of the table equals the motion in Python.
        for i, name in enumerate(("x1", "x2")):
            got = np.array(table[f"{name}_re"], float) + 1j * np.array(table[f"{name}_im"], float)
            assert got == pytest.approx(decay.amplitudes[:, i], rel=1e-6, abs=1e-9)
        assert vv.run(scene).decay.columns["s_re"] == pytest.approx(found.real, rel=1e-15)


def test_free_decay_needs_states(solve, tmp_path):
    system = "&system coordinates='x' mass=1 stiffness=1 /\n"
    motion = "&transient t_end=10 dt=0.1 initial=0.1 0 /\n"
    last = motion.replace(" /", " keep='last' /")
    for text, expected in (
        ("&free_decay /\n", "&free_decay: needs &transient"),
        (motion + "&free_decay start=10 /\n", "start = 10: must not be negative"),
        (motion + "&free_decay count=51 /\n", "count = 51: must be 1 to 50"),
        (last + "&free_decay /\n", "needs the states all along"),
    ):
        check_refused(solve, tmp_path, system + text, expected)
    # After the motion.
    scene = tmp_path / "scene.nml"
    scene.write_text(system + motion + "&free_decay start=9.5 count=1 /\n")
    done = solve(scene, "--out", tmp_path)
    assert (done.returncode, "must be at least 8" in done.stderr) == (2, True)


@pytest.mark.parametrize("seed", [0, 1])
def test_branches_of_motions_as_in_python(solve, tmp_path, seed):
    """The table contains the points and the events of `vv.trace_motion`."""
    rng = np.random.default_rng(seed)
    text, system, amplitudes = random_switching(rng)
    start = float(rng.uniform(0.5, 1.5))
    ends, nu = (start, start + 0.1), float(rng.uniform(0.5, 1.5))
    scene = tmp_path / "scene.nml"
    options = {"max_step": 0.2, "max_points": 30}
    if seed == 0:
        keys = f"vary='load_factor' nu={nu!r} from={ends[0]!r} to={ends[1]!r}"
        branch = vv.trace_motion(system, nu=nu, load_range=ends, load=amplitudes, **options)
    else:
        keys = f"nu_from={ends[0]!r} nu_to={ends[1]!r}"
        branch = vv.trace_motion(system, ends, load=amplitudes, **options)
    scene.write_text(f"{text}&trace_motion {keys} max_step=0.2 max_points=30 /\n")
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == (0 if branch.complete else 1), done.stderr
    table = read_csv(tmp_path / "scene_trace_motion.csv")
    np.testing.assert_allclose(np.array(table[branch.varies], float), branch.parameter, rtol=1e-12)
    for name, column in (("x1_min", branch.smallest), ("x1_max", branch.largest)):
        np.testing.assert_allclose(np.array(table[name], float), column[:, 0], atol=1e-12)
    states = np.array([table["x1"], table["x1_dot"]], float).T
    np.testing.assert_allclose(states, branch.state[:, :2], atol=1e-12)
    codes = np.array(table["stable"], int).tolist()
    assert codes == [{True: 1, False: 0, None: -1}[one] for one in branch.stable]
    head = (tmp_path / "scene_trace_motion.csv").read_text()
    assert head.count("# grazing after point") == branch.grazings.size
    assert head.count("# fold after point") == branch.folds.size


@pytest.mark.parametrize(
    ("keys", "reported"),
    [
        ("nu_from=1", "nu_to"),
        ("nu_from=1 nu_to=1", "nu_to = 1: must differ from nu_from"),
        ("nu_from=-1 nu_to=1", "nu_from = -1: must be greater than 0"),
        ("vary='load_factor' from=1 to=2", "nu"),
        ("vary='mass' from=1 to=2 nu=1", "must be one of 'nu', 'load_factor'"),
        ("nu_from=1 nu_to=2 max_step=1", "max_step = 1: must be in [1e-6, 0.5]"),
        ("nu_from=1 nu_to=2 max_points=1", "max_points = 1: must be 2 to 100000"),
    ],
)
def test_branches_of_motions_refused(solve, tmp_path, keys, reported):
    check_refused(solve, tmp_path, f"{REPEATS}&trace_motion {keys} /\n", reported)
