"""The standalone driver: motions in time and their spectra."""

import math
import re
import warnings

import numpy as np
import pytest
import viscovib as vv
from driver import GOOD, MOTION, changed, check_refused, read_csv
from viscovib.cli.commands import main


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
    system = "\n".join(line for line in GOOD.splitlines() if "&load" not in line)
    check_refused(solve, tmp_path, system.split("&response")[0] + f"\n{group}\n", message)


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
    changes = {"dt=0.25": "tolerance=1e-13", "t_end=20": "t_end=2000", "f0=0.005": "f0=0.02"}
    changes |= {"0.3 0 -0.2": "1.3 0 -1.2"}
    check_refused(solve, tmp_path, changed(MOTION, changes), "the motion is chaotic", same=False)


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
    body = changed(MOTION, changes)
    if "p2=2147483648" in body:
        body = re.sub(r"p2\s*=\s*0?\.[0-9]+,?", "", body)
    check_refused(solve, tmp_path, body, text, same=False)


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
    assert main(["run", str(scene), "--out", str(tmp_path / "cli"), "--quiet"]) == int(aliased)


def test_no_message_prints_a_number_that_was_not_measured(solve, tmp_path):
    """For runs with different outcomes no difference is printed."""
    scene = (
        "&system coordinates='x', mass=1, stiffness=1 /\n"
        "&kernel kind='prony', weights=0.1, rates=1 /\n"
        "&force law='x^3', kernel=0 /\n&spring stiffness=1, kernel=1 /\n"
        "&load amplitude=1e12 /\n&transient initial=0 0, nu=1, t_end=3 /\n"
    )
    said = "not met with 2048 steps (runs with different step sizes end differently): the run is"
    check_refused(solve, tmp_path, scene, said, same=False)


KEPT = {
    "mount": GOOD.split("&load")[0] + "&load amplitude=0.3 /\n&transient nu=1.5",
    "pendulum": "&pendulum e=0.1, w2=0.4, w3=0.8, c1=0.01, f0=0.005, p1=0.93 /\n"
    "&transient initial=0.05 0 0.3 0 -0.2 0",
    "system": "&system coordinates='x', mass=1, stiffness=1, damping=0.1 /\n"
    "&force on='x', powers=3, coefficient=0.5 /\n&load on='x', amplitude=0.3 /\n"
    "&transient initial=0 0, nu=1.1",
}


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
    check_refused(solve, tmp_path, f"{KEPT['pendulum']}, t_end=20, {more} /\n", reported)


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
    check_refused(solve, tmp_path, text, "acceleration = 'yes': is for structures")
