"""Untrusted scenes and large scenes: time, memory, files, and messages."""

import os
import resource
import signal
import stat
import subprocess
import sys
import time

import pytest
import viscovib as vv
from driver import GOOD, MOTION, SCENES, check_failure, command, separate_command

TABLE = "&kernel kind='tabulated', file='{}' /\n"
MEGABYTE = 1_000_000


def with_table(file):
    return GOOD.replace(GOOD[GOOD.index("&kernel") : GOOD.index("&load")], TABLE.format(file))


def long_scene(name, share=1):
    """Scenes of about 1 MB, or a fraction of it, with many equal pieces."""
    size = MEGABYTE // share
    head, wanted = GOOD[: GOOD.index("&load")], GOOD[GOOD.index("&response") :]
    tail = "&load amplitude=1 /\n" + wanted
    system = "&system coordinates='x', mass=1, stiffness=1 /\n"
    return {
        "loads": head + "&load amplitude=0.1 /\n" * (45_000 // share) + wanted,
        "few loads": head + "&load amplitude=0.1 /\n" * (15_000 // share) + wanted,
        "forces": system + "&force law='x^3' /\n" * (9_000 // share) + tail,
        "springs": system + "&spring stiffness=1 /\n" * (19_000 // share) + tail,
        "kernels": system
        + "&kernel kind='abel', amplitude=0.1, alpha=0.2 /\n" * (18_000 // share)
        + tail,
        "title": f"&scene title='{'x' * size}' /\n{GOOD}",
        "quotes": f"&scene title='{chr(39) * size}' /\n{GOOD}",
        "switch": MOTION[: MOTION.index("&transient")]
        + f"&branch parameter='p1', from=1, to=2, switch={300_000 // share}*1 /\n",
        "coordinates": f"&system coordinates={300_000 // share}*'x', mass=1, stiffness=1 /\n"
        + tail,
        "words": "&system coordinates=" + "'x' " * (250_000 // share)
        + ", mass=1, stiffness=1 /\n" + tail,
        "values": head + "&load amplitude=1 /\n&response nu=" + "1 " * (500_000 // share) + "/\n",
        "ascending": head + "&load amplitude=1 /\n&response method='linear', nu="
        + " ".join(map(str, range(1, 145_000 // share))) + " /\n",
        "keys": "&mount " + "".join(f"k{i}=1 " for i in range(120_000 // share)) + "/\n" + tail,
        "law": system + "&force law='" + "(x+1)^7*x^8*0+" * (70_000 // share) + "x^2' /\n" + tail,
        "laws": "&system coordinates='x' 'y' 'z', mass=1 1 1, stiffness=1 1 1 /\n"
        + ("&force on='x', law='(1+x+y+z)^5*(1+x+y+z)^5*0' /\n") * (19_000 // share)
        + tail,
        "sweeps": GOOD + "&sweep key='mount.mass', values=1 2 /\n" * (19_000 // share),
        "comments": "!" * size + "\n" + GOOD,
        "letters": "x" * size,
        "blanks": GOOD + " " * size,
        "ends": GOOD + "\n" * size,
    }[name]  # fmt: skip


@pytest.mark.parametrize(
    "name",
    ["loads", "few loads", "forces", "springs", "kernels", "title", "quotes", "switch",
     "coordinates", "words", "values", "ascending", "keys", "law", "laws", "sweeps", "comments",
     "letters", "blanks", "ends"],
)  # fmt: skip
def test_a_megabyte_is_read_or_refused_at_once(solve, tmp_path, name):
    scene = tmp_path / "scene.nml"
    # In the debug build (up to 20 s) an eighth of the pieces is enough.
    checked = "debug" in solve("--version").args[0]
    scene.write_text(long_scene(name, 8 if checked else 1))
    # Processor time: at most 0.6 s on an idle machine, twice as much on a busy one.
    bound = 30.0 if checked else 4.0
    started = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    done = solve(scene, "--plan")
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - started < bound
    assert done.returncode in (0, 2)
    assert len(done.stderr) < 2000
    assert len(done.stderr.splitlines()) == (done.returncode == 2)
    if checked:
        # Python reads the scene with the release library.
        return
    began = time.process_time()
    if done.returncode == 0:
        vv.Scene.read(scene)
    else:
        with pytest.raises(vv.InputError, match=r"\A.{1,512}\Z"):
            vv.Scene.read(scene)
    assert time.process_time() - began < bound


def test_files_outside_the_folder_need_leave(solve, tmp_path):
    folder, out = tmp_path / "scenes", tmp_path / "out"
    (folder / "below").mkdir(parents=True)
    out.mkdir()
    secret = tmp_path / "secret"
    secret.write_text("root:x:0:0\n")
    (tmp_path / "outside.csv").write_text("0 0.2\n1 0.1\n")
    (folder / "below" / "k.csv").write_text("0 0.2\n1 0.1\n")
    (folder / "link.csv").symlink_to(tmp_path / "outside.csv")
    scene = folder / "scene.nml"
    refused = [str(secret), "../secret", "../none", "/none", "link.csv", "below/../../outside.csv"]
    for file in refused:
        scene.write_text(with_table(file))
        check_failure(solve(scene, "--out", out), 2, "must be in the folder of the scene", out)
        with pytest.raises(vv.InputError, match="must be in the folder of the scene"):
            vv.Scene.read(scene)
    for file in ("below/k.csv", "./below/k.csv", str(folder / "below" / "k.csv")):
        scene.write_text(with_table(file))
        assert solve(scene, "--plan").returncode == 0
        assert vv.Scene.read(scene).groups["kernel"][0]["times"] == [0.0, 1.0]
    scene.write_text(with_table("../outside.csv"))
    assert solve(scene, "--plan", "--allow-paths").returncode == 0
    assert command("plan", scene, "--allow-paths").returncode == 0
    assert command("plan", scene).returncode == 2
    vv.Scene.read(scene, allow_paths=True)
    scene.write_text(with_table("../secret"))
    done = solve(scene, "--out", out, "--allow-paths")
    check_failure(done, 2, "secret:1: a line must be two finite numbers", out)
    assert ":x:0" not in done.stderr
    with pytest.raises(vv.InputError, match=r"secret:1: ") as caught:
        vv.Scene.read(scene, allow_paths=True)
    assert ":x:0" not in str(caught.value)


def test_only_regular_files_are_read(solve, tmp_path):
    pipe, out = tmp_path / "pipe", tmp_path / "out"
    out.mkdir()
    os.mkfifo(pipe)
    for path in (pipe, "/dev/zero", "/dev/null", "/proc/self/status"):
        check_failure(solve(path, "--out", out), 3, "cannot be read (not a regular file)", out)
        with pytest.raises(vv.FileError, match="not a regular file"):
            vv.Scene.read(path)
    scene = tmp_path / "scene.nml"
    scene.write_text(with_table("pipe"))
    check_failure(solve(scene, "--out", out), 3, "not a regular file", out)


def test_a_standard_output_that_is_full_is_status_3(solve, tmp_path):
    """Plan and summary cannot be written: nothing is computed."""
    scene = tmp_path / "scene.nml"
    scene.write_text(GOOD)
    driver = [solve("--version").args[0]]
    calls = [
        [*driver, scene, "--plan"],
        [*driver, scene, "--out", tmp_path / "out"],
        [*driver, "--help"],
    ]
    _check_full(calls)


def test_a_standard_output_of_python_that_is_full_is_status_3(tmp_path):
    scene = tmp_path / "scene.nml"
    scene.write_text(GOOD)
    python = [sys.executable, "-m", "viscovib"]
    calls = [
        [*python, "plan", scene],
        [*python, "run", scene, "--out", tmp_path / "out", "--json"],
        [*python, "--version"],
    ]
    _check_full(calls)


def _check_full(calls):
    for call in calls:
        with open("/dev/full", "w") as full:
            done = subprocess.run(call, stdout=full, stderr=subprocess.PIPE, text=True, timeout=120)
        assert done.returncode == 3, call
        assert len(done.stderr.splitlines()) == 1, done.stderr
        assert "standard output: cannot be written (No space left on device)" in done.stderr


@pytest.mark.skipif("sanitize" in os.environ.get("VISCOVIB_SOLVE", ""), reason="its own stack")
def test_a_small_stack_is_refused_or_raised(solve, tmp_path):
    scene = tmp_path / "scene.nml"
    scene.write_text(GOOD)
    driver = solve("--version").args[0]

    def run(limit):
        return subprocess.run(
            ["sh", "-c", f"ulimit {limit}; exec {driver} {scene} --out {tmp_path}"],
            capture_output=True, text=True, timeout=120,
        )  # fmt: skip

    assert run("-S -s 64").returncode == 0
    assert run("-s 1024").returncode == 0
    done = run("-s 64")
    assert done.returncode == 2
    assert done.stderr == (
        "viscovib-solve: the limit of the stack is 64 kB, must be at least 1024 kB (ulimit -s)\n"
    )


def test_a_quiet_run_says_why_its_status_is_1(solve, tmp_path):
    scene = tmp_path / "scene.nml"
    scene.write_text(
        "&system coordinates='x', mass=1, stiffness=1 /\n&load amplitude=1 /\n"
        "&response nu=1 2, method='linear' /\n"
    )
    for done in (
        solve(scene, "--out", tmp_path, "--quiet"),
        command("run", scene, "--out", tmp_path, "--quiet"),
    ):
        assert (done.returncode, done.stdout) == (1, "")
        assert done.stderr.startswith("warning: ")
        assert "1 of 2 frequencies solved" in done.stderr
        assert len(done.stderr.splitlines()) == 1


def test_names_with_blanks_and_new_lines(solve, tmp_path):
    for name in ("end ", "two\nlines", " ", "caf\u00e9"):
        scene = tmp_path / name
        scene.write_text(GOOD)
        done = solve(scene, "--out", tmp_path / "out ")
        assert done.returncode == 0, done.stderr
        assert len(done.stdout.splitlines()) == 1
        assert (tmp_path / "out " / f"{name}_response.csv").exists()
        assert vv.Scene.read(scene).title == ""
        scene.write_text("&mount /\n")
        done = solve(scene)
        assert done.returncode == 2
        assert len(done.stderr.splitlines()) == 1
        with pytest.raises(vv.InputError) as caught:
            vv.Scene.read(scene)
        assert "\n" not in str(caught.value)
    nothing = tmp_path / "nothing"
    nothing.mkdir()
    check_failure(solve(tmp_path / "no\nfile", cwd=nothing), 3, "no?file", nothing)


def test_a_part_that_is_a_link_is_not_followed(solve, tmp_path):
    target = tmp_path / "precious"
    target.write_text("precious")
    out = tmp_path / "out"
    out.mkdir()
    (out / "mount_paper_response.csv.part").symlink_to(target)
    assert solve(SCENES / "mount_paper.nml", "--out", out).returncode == 0
    assert target.read_text() == "precious"
    assert [path.name for path in out.iterdir()] == ["mount_paper_response.csv"]
    assert stat.S_ISREG((out / "mount_paper_response.csv").lstat().st_mode)
    (out / "python.csv.part").symlink_to(target)
    vv.run(SCENES / "mount_paper.nml").to_csv(out / "python.csv")
    assert target.read_text() == "precious"
    assert not (out / "python.csv.part").exists()


def test_a_link_named_like_a_table_is_replaced(solve, tmp_path):
    """Driver, command and Python: the target of the link is unchanged."""
    scene, table = SCENES / "mount_paper.nml", "mount_paper_response.csv"
    writers = [
        lambda folder: solve(scene, "--out", folder).returncode,
        lambda folder: command("run", scene, "--out", folder, "--quiet").returncode,
        lambda folder: vv.run(scene).to_csv(folder / table),
    ]
    precious = tmp_path / "precious"
    precious.write_text("precious")
    leads = [precious, "../precious", "nothing", table, tmp_path]
    for i, write in enumerate(writers):
        for j, target in enumerate(leads if i != 1 else leads[:1]):
            folder = tmp_path / f"out{i}{j}"
            folder.mkdir()
            (folder / table).symlink_to(target)
            assert not write(folder)
            assert stat.S_ISREG((folder / table).lstat().st_mode)
            assert (folder / table).read_text().startswith("#")
            assert precious.read_text() == "precious"
            assert {path.suffix for path in folder.iterdir()} <= {".csv", ".png"}
    # Replacing a link to a device must not remove the device.
    for write in (writers[0], writers[1]):
        folder = tmp_path / f"device{writers.index(write)}"
        folder.mkdir()
        (folder / table).symlink_to("/dev/null")
        assert write(folder) == 3
        assert (folder / table).is_symlink()


def test_a_limit_on_the_size_of_files_is_reported(solve, tmp_path):
    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 14, 1 << 14))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

    program = solve("--version").args[0]
    done = subprocess.run(
        [program, SCENES / "mount_paper.nml", "--out", tmp_path],
        preexec_fn=limit, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    check_failure(done, 3, "writing failed (File too large)", tmp_path)


LONG = {
    "motion": MOTION.replace("t_end=20, dt=0.25", "t_end=1e9, dt=0.01, save_every=1000000"),
    "memory": "&mount mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2 /\n"
    "&kernel kind='rzhanitsyn', amplitude=0.048, alpha=0.1, beta=0.05 /\n"
    "&transient held=0.1 0, t_end=1e6, dt=0.001, save_every=1000000 /\n",
    "response": GOOD.replace("nu_count=8", "nu_count=20000, method='newton', harmonics=31"),
    "branch": GOOD[: GOOD.index("&response")]
    + "&branch nu_from=1, nu_to=400, harmonics=31, max_points=20000, max_step=1e-4, "
    "stability='no' /\n",
}


@pytest.mark.parametrize("name", sorted(LONG))
def test_a_bound_on_time_keeps_what_is_done(solve, tmp_path, name):
    scene = tmp_path / "scene.nml"
    scene.write_text(LONG[name])
    done = solve(scene, "--out", tmp_path, "--max-seconds", 0.5)
    assert done.returncode == 1, done
    assert "stopped: the time limit is reached" in done.stdout
    assert done.stderr == ""
    (table,) = tmp_path.glob("*.csv")
    assert "stopped" in table.read_text()
    assert not list(tmp_path.glob("*.part"))


def test_a_command_has_the_same_bounds(tmp_path):
    scene = tmp_path / "scene.nml"
    scene.write_text(LONG["motion"])
    done = separate_command("run", scene, "--out", tmp_path, "--max-seconds", 0.5, "--quiet")
    assert done.returncode == 1, done
    assert "stopped" in (tmp_path / "scene_transient.csv").read_text()
    scene.write_text(GOOD + "&sweep key='mount.mass', min=1, max=2, count=100000 /\n")
    done = separate_command("sweep", scene, "--out", tmp_path, "--max-seconds", 1, "--quiet")
    assert done.returncode == 1, done
    assert done.stderr.splitlines()[-1].startswith("viscovib: stopped: the limit of 1 s is reached")
    done = command("run", SCENES / "mount_paper.nml", "--max-seconds", -1)
    assert done.returncode == 2


@pytest.mark.skipif("sanitize" in os.environ.get("VISCOVIB_SOLVE", ""), reason="its own memory")
def test_a_bound_on_memory_ends_with_one_line(solve, tmp_path):
    scene = tmp_path / "scene.nml"
    scene.write_text(GOOD.replace("nu_count=8", "nu_count=1000000, method='linear'"))
    done = solve(scene, "--out", tmp_path / "out", "--max-memory", 0.02)
    assert done.returncode == 1, done
    assert "stopped: more than 0.02 GB of memory are needed" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())
    nothing = tmp_path / "nothing"
    nothing.mkdir()
    for wrong in ("0", "nan", "-1", "much"):
        done = solve(scene, "--max-memory", wrong, cwd=nothing)
        check_failure(done, 2, "must be a number", nothing)


def test_the_smallest_integer_is_refused(solve, tmp_path):
    pendulum = MOTION[: MOTION.index("&transient")]
    for result in (
        "&branch parameter='p1', from=0.7, to=0.8, switch=-2147483648 /\n",
        "&backbone mode=1, from=0.01, to=0.02, switch=-2147483648 /\n",
        "&backbone mode=-2147483648, from=0.01, to=0.02 /\n",
    ):
        scene = tmp_path / "scene.nml"
        scene.write_text(pendulum + result)
        done = solve(scene)
        assert done.returncode == 2
        assert "= -2147483648: must be " in done.stderr


@pytest.mark.parametrize(
    "changed",
    ["stiffness_x=1.79e308", "offset=1.79e308", "mass=1e-307", "inertia=1e-307", "mass=1.7e308",
     "stiffness_phi=1e-300", "stiffness_x=1e300"],
)  # fmt: skip
def test_extreme_numbers_end_multiple_scales_in_time(solve, tmp_path, changed):
    key = changed.partition("=")[0]
    scene = tmp_path / "scene.nml"
    keys = {"mass": "1", "inertia": "0.1", "offset": "0.5", "stiffness_x": "10",
            "stiffness_phi": "2"} | {key: changed.partition("=")[2]}  # fmt: skip
    mount = " ".join(f"{name}={number}" for name, number in keys.items())
    rest = GOOD[GOOD.index("&kernel") : GOOD.index("&response")]
    scene.write_text(
        f"&mount {mount} /\n{rest}&multiple_scales parameter='nu' from=1 to=2 count=3 /\n"
    )
    done = solve(scene, "--out", tmp_path / "out")
    assert done.returncode in (0, 1, 2) or (
        done.returncode == -signal.SIGFPE and "debug" in str(done.args[0])
    ), done
