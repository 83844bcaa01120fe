"""The standalone driver: motions in time and their spectra."""

import math
import os
import re
import warnings

import numpy as np
import pytest
import viscovib as vv
from driver import GOOD, MOTION, check_failure, read_csv
from viscovib.cli.commands import main


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"dt=0.25": "tolerance=1e-9"},
        {"dt=0.25": "rtol=1e-7, atol=1e-12"},
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
    assert str(vv.plan(scene)).splitlines() == solve(scene, "--plan").stdout.splitlines()
    run.to_csv(tmp_path / "python.csv")
    again = read_csv(tmp_path / "python.csv")
    assert again.dtype.names == table.dtype.names
    assert (again["t"] == table["t"]).all()
    if "debug" not in os.environ.get("VISCOVIB_SOLVE", ""):
        for name in table.dtype.names:
            assert (table[name] == again[name]).all()


@pytest.mark.parametrize("keep", ["all", "last"])
@pytest.mark.parametrize("kernel", ["", "\n&kernel kind='prony', weights=0.2, rates=1.5 /"])
def test_the_default_accuracy_is_relative_to_the_motion(solve, tmp_path, kernel, keep):
    """As in Python: the same motion in other units of length, with the same relative accuracy."""
    found = []
    for unit in (2.0**-30, 1.0, 2.0**20):
        scene = tmp_path / f"motion{unit:g}.nml"
        scene.write_text(
            "&system coordinates='x', mass=1, stiffness=1, damping=0.1 /\n"
            f"&force on='x', law='{0.5 / unit**2!r}*x^3' /{kernel}\n"
            f"&transient t_end=25, initial={unit!r} 0, keep='{keep}' /\n"
        )
        done = solve(scene, "--out", tmp_path)
        assert done.returncode == 0, done.stderr
        table = read_csv(tmp_path / f"motion{unit:g}_transient.csv")
        found.append(np.array([np.atleast_1d(table[name]) / unit for name in ("x", "x_dot")]))
        assert str(vv.plan(scene)).splitlines() == solve(scene, "--plan").stdout.splitlines()
        run = vv.run(scene).trajectory
        assert np.abs(run.state.T[:, -1] / unit - found[-1][:, -1]).max() <= 1e-12
    for other in found:
        np.testing.assert_allclose(other, found[1], rtol=0, atol=1e-12)


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
    assert str(vv.plan(scene)) == solve(scene, "--plan").stdout.strip()
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
        ("&transient t_end=20 /\n&multiple_scales from=1, to=2 /", "has &transient already"),
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


def test_spectra_of_driver_and_python_agree(solve, tmp_path):
    scene = tmp_path / "motion.nml"
    scene.write_text(MOTION + "&spectrum window='flat_top', discard=5 /\n")
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert str(vv.plan(scene)).splitlines() == solve(scene, "--plan").stdout.splitlines()
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
    # It passes very near its pivot, where smaller steps replace the given steps. They do not follow
    # the later motion.
    scene.write_text(MOTION.replace("0.05 0 0.3", "0 -3 0.3"))
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 1
    assert "step too large at t = 2.75" in done.stdout
    # Straight through the pivot, located within the step; the only stored row is the stop.
    free = MOTION.replace("0.05 0 0.3 0 -0.2 0", "0 -3 0 0 0 0")
    free = re.sub(r"(f0|m01|m02)\s*=\s*[0-9.]+", r"\1=0", free)
    scene.write_text(free.replace("&transient", "&transient keep='last', "))
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 1
    assert "unphysical at t = " in done.stdout
    row = read_csv(tmp_path / "motion_transient.csv")
    assert float(row["t"]) == pytest.approx(math.asin(1 / 3), abs=3e-3)
    assert float(row["z"]) == pytest.approx(-1, abs=1e-12)


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
    check_failure(solve(scene, "--out", out), 2, "the motion is chaotic", out)


@pytest.mark.parametrize(
    ("changes", "samples"),
    [
        ({"0.05 0 0.3": "0 -3 0.3"}, 0),
        ({"dt=0.25": "dt=0.25, save_every=70"}, 0),
        ({"dt=0.25": "dt=0.25, save_every=40"}, 1),
    ],
)
def test_too_few_states_for_a_spectrum_are_reported_and_the_motion_kept(
    solve, tmp_path, changes, samples
):
    text = MOTION + "&spectrum discard=18 /\n"
    for old, new in changes.items():
        text = text.replace(old, new)
    scene = tmp_path / "motion.nml"
    scene.write_text(text)
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 1, done.stderr
    counted = "1 state" if samples == 1 else f"{samples} states"
    assert f"no spectrum: {counted} from discard on" in done.stdout
    assert not (tmp_path / "motion_spectrum.csv").exists()
    with pytest.warns(vv.ConvergenceWarning, match=f"no spectrum: {counted} from"):
        result = vv.run(scene)
    assert result.spectrum is None
    assert result.trajectory.t.size >= 1


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"dt=0.25": "tolerance=1e-6", "w2=": "p2=2147483648, w2="}, "must be at most"),
        ({"dt=0.25": "dt=1e-7"}, "would keep"),
    ],
)
def test_work_is_bounded_before_the_first_step(solve, tmp_path, changes, text):
    scene = tmp_path / "motion.nml"
    body = MOTION
    for old, new in changes.items():
        assert old in body
        body = body.replace(old, new)
    if "p2=2147483648" in body:
        body = re.sub(r"p2\s*=\s*0?\.[0-9]+,?", "", body)
    scene.write_text(body)
    out = tmp_path / "out"
    out.mkdir()
    check_failure(solve(scene, "--out", out), 2, text, out)


@pytest.mark.parametrize("kernel", ["", "&kernel kind='prony', weights=0.1, rates=0.7 /\n"])
def test_escapes_end_at_their_time(solve, tmp_path, kernel):
    """Soft springs near the separatrix; the same time as in Python."""
    scene = tmp_path / "escape.nml"
    springs = [("-0.39*x^3", 2.51), ("-0.81*x^3", 1.21), ("-0.3*x^2", 4.0)]
    if kernel and "debug" in os.environ.get("VISCOVIB_SOLVE", ""):
        springs = springs[2:]  # The first step of the others overflows, which debugging traps.
    for law, start in springs:
        scene.write_text(
            "&system coordinates='x', mass=1, damping=0.02, stiffness=1 /\n"
            f"{kernel}&force law='{law}', kernel=0 /\n"
            f"&transient initial={start} 0, t_end=30, tolerance=1e-8 /\n"
        )
        done = solve(scene, "--out", tmp_path)
        assert done.returncode == 1
        reported = re.search(r"diverged at t = ([0-9.]+), (\d+) states", done.stdout)
        run = vv.run(scene).trajectory
        assert run.outcome == "diverged"
        assert float(reported[1]) == pytest.approx(run.t_reached, abs=1e-10)
        assert int(reported[2]) == run.t.size > 20


@pytest.mark.parametrize("kernel", ["", "&kernel kind='prony', weights=1e-2, rates=1 /\n"])
def test_ends_that_are_alike_by_chance_are_refused(solve, tmp_path, kernel):
    """A body in two wells passes through chaos and settles: equal final states are no proof."""
    scene = tmp_path / "wells.nml"
    text = (
        "&system coordinates='x', mass=1, damping=0.1, stiffness=-1 /\n"
        f"{kernel}&force law='x^3', kernel=0 /\n&load on='x', amplitude=0.4 /\n"
        "&transient initial=0.1 0, t_end=1000, nu=1.2, keep='last' /\n"
    )
    scene.write_text(text)
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 2
    assert "not met" in done.stderr
    with pytest.raises(vv.InputError, match="not met"):
        vv.run(scene)
    scene.write_text(text.replace("t_end=1000", "t_end=20"))
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    last = [float(s) for s in (tmp_path / "wells_transient.csv").read_text().split()[-1].split(",")]
    run = vv.run(scene).trajectory
    assert last[1:3] == pytest.approx(run.state[-1], abs=1e-9)


def free_slide(mass, stiffness, friction, x, v, t):
    """A mass on a spring with dry friction: arcs about -+ friction/stiffness, until it sticks."""
    omega, begin = math.sqrt(stiffness / mass), 0.0
    side = np.sign(v) or -np.sign(x)
    states = np.empty((t.size, 2))
    while abs(v) > 0 or stiffness * abs(x) > friction:
        center = -side * friction / stiffness
        a, b = x - center, v / omega
        turn = (math.atan2(b, a) % math.pi or math.pi) / omega
        now = t >= begin
        phase = omega * (t[now] - begin)
        states[now, 0] = center + a * np.cos(phase) + b * np.sin(phase)
        states[now, 1] = omega * (b * np.cos(phase) - a * np.sin(phase))
        x = center + a * math.cos(omega * turn) + b * math.sin(omega * turn)
        v, begin, side = 0.0, begin + turn, -side
    states[t >= begin] = x, 0.0
    return states


@pytest.mark.parametrize("form", ["system", "structure", "prony"])
def test_motions_that_begin_sliding_and_end_sticking(solve, tmp_path, form):
    """Each run with smaller steps begins with its initial signs, not with final signs."""
    rng = np.random.default_rng(5)
    for _ in range(6):
        m, k, f = rng.uniform(0.5, 2), rng.uniform(0.5, 3), rng.uniform(0.1, 0.4)
        x, v = rng.uniform(-0.3, 0.3), rng.uniform(-1, 1)
        if form == "system":
            text = (
                f"&system coordinates='x', mass={m}, stiffness={k} /\n"
                f"&force law='{f}*sign(x_dot)' /\n"
            )
        else:
            text = (
                f"&structure mass={m}, stiffness={k}, coordinates='x' /\n"
                f"&element on='x', law='{f}*sign(v)', kernel=0 /\n"
            )
        if form == "prony":
            text += (
                "&kernel kind='prony', weights=0.5, rates=1 /\n&element on='x', stiffness=1e-14 /\n"
            )
        scene = tmp_path / f"{form}.nml"
        scene.write_text(f"{text}&transient initial={x} {v}, t_end=30, tolerance=1e-9 /\n")
        done = solve(scene, "--out", tmp_path)
        assert done.returncode == 0, done.stderr
        table = read_csv(tmp_path / f"{form}_transient.csv")
        true = free_slide(m, k, f, x, v, table["t"])
        assert true[-1, 1] == 0
        assert table["x"] == pytest.approx(true[:, 0], abs=1e-9)
        assert table["x_dot"] == pytest.approx(true[:, 1], abs=1e-8)


@pytest.mark.parametrize(("every", "aliased"), [(1, False), (10, True)])
def test_a_spectrum_of_states_too_far_apart(solve, tmp_path, every, aliased):
    """10 rad/s sampled at 0.5 s appears at 2.57 rad/s: driver and Python issue a warning."""
    scene = tmp_path / "alias.nml"
    scene.write_text(
        "&system coordinates='x', mass=1, stiffness=100, damping=0.001 /\n"
        f"&transient initial=1, 0, t_end=100, dt=0.05, save_every={every} /\n"
        "&spectrum coordinates='x' /\n"
    )
    result = solve(scene, "--out", tmp_path)
    assert result.returncode == int(aliased)
    reported = "states 0.5 apart are too far for the spectrum of x: by its velocity 100 %"
    assert (reported in result.stdout) == aliased
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        found = vv.run(scene)
    assert found.spectrum.complete == (not aliased)
    assert found.spectrum.aliased == (("x",) if aliased else ())
    begins = [str(one.message).partition(":")[0] for one in heard]
    assert begins == ["states 0.5 apart are too far for x"] * aliased
    own = tmp_path / "own.csv"
    found.spectrum_to_csv(own)
    if "debug" not in os.environ.get("VISCOVIB_SOLVE", ""):
        assert own.read_bytes() == (tmp_path / "alias_spectrum.csv").read_bytes()
    # Different rounding in the debug build changes the phases of very weak lines.
    lines = [read_csv(path) for path in (own, tmp_path / "alias_spectrum.csv")]
    first, second = (x["x_amplitude"] * np.exp(1j * x["x_phase"]) for x in lines)
    assert np.abs(first - second).max() < 1e-14
    assert main(["run", str(scene), "--out", str(tmp_path / "cli"), "--quiet"]) == int(aliased)


def test_no_message_prints_a_number_that_was_not_measured(solve, tmp_path):
    """For runs with different outcomes no difference is printed."""
    scene = tmp_path / "scene.nml"
    scene.write_text(
        "&system coordinates='x', mass=1, stiffness=1 /\n"
        "&kernel kind='prony', weights=0.1, rates=1 /\n"
        "&force law='x^3', kernel=0 /\n&spring stiffness=1, kernel=1 /\n"
        "&load amplitude=1e12 /\n&transient initial=0 0, nu=1, t_end=3 /\n"
    )
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 2
    said = "not met with 2048 steps (runs with different step sizes end differently): the run is"
    assert said in done.stderr
    with pytest.raises(vv.InputError, match=re.escape(said)):
        vv.run(scene)


KEPT = {
    "mount": GOOD.split("&load")[0] + "&load amplitude=0.3 /\n&transient nu=1.5",
    "pendulum": "&pendulum e=0.1, w2=0.4, w3=0.8, c1=0.01, f0=0.005, p1=0.93 /\n"
    "&transient initial=0.05 0 0.3 0 -0.2 0",
    "system": "&system coordinates='x', mass=1, stiffness=1, damping=0.1 /\n"
    "&force on='x', powers=3, coefficient=0.5 /\n&load on='x', amplitude=0.3 /\n"
    "&transient initial=0 0, nu=1.1",
}


@pytest.mark.parametrize("name", KEPT)
@pytest.mark.parametrize(
    "kept",
    [
        "times=0.5 1.234 7 19.9", "keep='tail', tail=3.3", "dt=0.1, times=0 0.5 1.234 7 20",
        "dt=0.1, keep='tail', tail=3.3", "keep='tail', tail=3.3, save_every=2",
    ],
)  # fmt: skip
def test_states_at_times_and_of_the_end(solve, tmp_path, name, kept):
    scene = tmp_path / "kept.nml"
    scene.write_text(f"{KEPT[name]}, t_end=20, {kept} /\n")
    assert solve(scene, "--out", tmp_path).returncode == 0
    table = read_csv(tmp_path / "kept_transient.csv")
    run = vv.run(scene).trajectory
    found = np.stack([np.atleast_1d(table[column]) for column in table.dtype.names], axis=1)
    assert found.shape == (run.t.size, 1 + run.state.shape[1])
    assert np.abs(found - np.column_stack([run.t, run.state])).max() < 1e-13
    wanted = [float(t) for t in kept.split("times=")[-1].split()] if "times" in kept else None
    assert run.t[-1] == 20 if wanted is None else list(run.t) == wanted
    if wanted is None:
        assert 0 < run.t[0] <= 20 - 3.3
    assert str(vv.plan(scene)).splitlines() == solve(scene, "--plan").stdout.splitlines()


@pytest.mark.parametrize(
    ("more", "reported"),
    [
        ("tail=1", "tail: must be given with keep = 'tail', and not without it"),
        ("keep='tail'", "&transient lacks tail"),
        ("keep='tail', tail=-1", "tail = -1: must be greater than 0"),
        ("times=3 2", "times (value 2) = 2 after 3: must be strictly increasing"),
        ("tims=3 2", "unknown key 'tims' in &transient; did you mean 'times'?"),
        ("times=1 30", "times = 1 to 30: must be between 0 and t_end = 20"),
        ("times=1 3, keep='last'", "times: cannot be given together with save_every or keep"),
        ("times=1 3 /\n&spectrum", "needs states at equal steps, and &transient has times"),
    ],
)  # fmt: skip
def test_refused_times(solve, tmp_path, more, reported):
    scene = tmp_path / "kept.nml"
    scene.write_text(f"{KEPT['pendulum']}, t_end=20, {more} /\n")
    out = tmp_path / "out"
    out.mkdir()
    check_failure(solve(scene, "--out", out), 2, reported, out)


PRONY = "&kernel kind='prony' weights=0.3 0.6 rates=1 5 /\n"
PAIR = (
    "&structure mass=1 2 1 stiffness=2 -1 0 -1 2 -1 0 -1 2 damping=0.1 0.1 0.2 "
    "base_direction=1 1 1 /"
)
ACCELERATIONS = {
    "pendulum": "&pendulum e=0.1 w2=0.4 w3=0.8 f0=0.02 p1=0.9 /\n"
    "&transient initial=0.05 0 0.3 0 -0.2 0 t_end=5 dt=0.1 @ /\n",
    "steep kernel": "&kernel kind='rzhanitsyn' amplitude=0.048 alpha=0.1 beta=0.05 /\n"
    "&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2 /\n"
    "&load on='x' amplitude=0.1 /\n&load kind='base' amplitude=0.02 order=2 /\n"
    "&transient initial=0.05 0 0.3 0 t_end=4 nu=1.5 @ /\n",
    "held": f"{PRONY}&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2 "
    "geometry='exact' /\n&transient held=0.05 0.3 t_end=4 keep='tail' tail=2 dt=0.1 @ /\n",
    "friction": "&system coordinates='x' 'y' mass=1 2 stiffness=2 -1 -1 2 damping=0.1 0 0 0.1 /\n"
    "&force on='x' law='0.5*sign(x_dot) + x^3' /\n&load on='x' amplitude=1.3 /\n"
    "&transient initial=0.3 0 0.1 0 t_end=5 nu=1.1 coordinates='y' @ /\n",
    "structure": f"{PRONY}{PAIR}\n&element on='x1' 'x2' stiffness=0.5 law='0.4*d^3' kernel=1 /\n"
    "&load on='x1' amplitude=0.8 /\n&load kind='base' amplitude=0.1 phase=0.3 /\n"
    "&transient t_end=5 nu=0.9 initial=0.1 0 0.2 0 0 0 coordinates='x1' 'x3' @ /\n",
    "kinks with memory": f"{PRONY}&structure mass=1 2 stiffness=2 1 damping=0.1 0.1 /\n"
    "&element on='x1' 'x2' law='5*max(d - 0.1, 0) + 0.3*d' kernel=1 /\n"
    "&element on='x2' law='0.2*sign(v)' kernel=0 /\n&load on='x1' amplitude=0.8 /\n"
    "&transient t_end=6 nu=0.9 keep='last' @ /\n",
}


@pytest.mark.parametrize("name", ACCELERATIONS)
def test_accelerations_of_driver_and_python_agree(solve, tmp_path, name):
    """Python's are compared with other programs; the table is the same but for these columns."""
    tables = []
    for key in ("acceleration='yes'", ""):
        scene = tmp_path / "motion.nml"
        scene.write_text(ACCELERATIONS[name].replace("@", key))
        done = solve(scene, "--out", tmp_path)
        assert done.returncode == 0, done.stderr
        tables.append(read_csv(tmp_path / "motion_transient.csv"))
        if key:
            run = vv.run(scene)
    run.to_csv(tmp_path / "python.csv")
    again = read_csv(tmp_path / "python.csv")
    table, plain = tables
    assert table.dtype.names == again.dtype.names
    added = [column for column in table.dtype.names if column.endswith("_ddot")]
    assert len(added) == (len(table.dtype.names) - 1) / 3
    for column in table.dtype.names:
        size = np.abs(again[column]).max()
        np.testing.assert_allclose(table[column], again[column], rtol=0, atol=2e-13 * size)
        if column not in added:
            np.testing.assert_array_equal(table[column], plain[column])


def test_accelerations_that_the_driver_refuses(solve, tmp_path):
    text = (
        "&structure mass=1 0 stiffness=2 -1 -1 2 /\n"
        "&transient t_end=1 initial=0.1 0 0.05 0 acceleration='yes' /\n"
    )
    scene = tmp_path / "motion.nml"
    scene.write_text(text)
    done = solve(scene, "--out", tmp_path / "out")
    assert done.returncode == 2
    assert "acceleration = 'yes': is for structures" in done.stderr
    scene.write_text(text.replace("'yes'", "'maybe'"))
    done = solve(scene, "--out", tmp_path / "out")
    assert done.returncode == 2
    assert "acceleration = 'maybe': must be one of 'no', 'yes'" in done.stderr
