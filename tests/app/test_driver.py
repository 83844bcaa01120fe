"""The standalone driver: its tables against Python, exit statuses, files, command lines."""

import os
import shutil
import subprocess

import numpy as np
import pytest
import viscovib as vv
from driver import GOOD, SCENES, check_failure, command, read_csv


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
    hard = GOOD.replace("amplitude=0.1 ", "amplitude=5.0 ")
    scene.write_text(hard)
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0
    assert set(read_csv(tmp_path / "s_response.csv")["method"]) == {"successive", "newton"}
    scene.write_text(hard.replace("&response ", "&response method='successive' "))
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 1
    assert not done.stderr
    assert "try method = 'auto'" in done.stdout
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


def test_full_disk_is_status_3_and_keeps_the_old_table(solve, tmp_path):
    """A disk of four pages in a separate mount namespace."""
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
    assert "mount_paper_response.csv: writing failed (No space left on device)" in done.stderr
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
    "arguments", [[], ["--out"], ["a.nml", "--out", ""], ["--nonsense"], ["a.nml", ""]]
)
def test_wrong_command_line_is_status_2(solve, tmp_path, arguments):
    check_failure(solve(*arguments, cwd=tmp_path), 2, "usage: viscovib-solve", tmp_path)


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


def test_several_scenes_and_the_largest_status(solve, tmp_path):
    paper, branch = SCENES / "mount_paper.nml", SCENES / "mount_branch.nml"
    done = solve(paper, tmp_path / "none.nml", branch, "--out", tmp_path)
    assert done.returncode == 3
    assert "none.nml: cannot be read" in done.stderr
    assert [line.split(":")[0] for line in done.stdout.splitlines()] == [
        f"{tmp_path}/mount_paper_response.csv",
        f"{tmp_path}/mount_branch_branch.csv",
    ]
    alone = tmp_path / "alone"
    assert solve(paper, "--out", alone).returncode == 0
    name = "mount_paper_response.csv"
    assert (alone / name).read_bytes() == (tmp_path / name).read_bytes()
    nothing = tmp_path / "nothing"
    nothing.mkdir()
    done = solve(paper, f"elsewhere/{paper.name}", "--out", nothing)
    check_failure(done, 2, "its tables would have the same names as those of", nothing)
    plans = solve(paper, branch, "--plan").stdout.splitlines()
    assert [line for line in plans if line.endswith(":")] == [f"{paper}:", f"{branch}:"]


def test_a_pipe_in_the_place_of_a_table_stays(solve, tmp_path):
    (tmp_path / "s.nml").write_text(
        "&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2 /\n&modes /\n"
    )
    (tmp_path / "out").mkdir()
    os.mkfifo(tmp_path / "out/s_modes.csv")
    done = solve("s.nml", cwd=tmp_path)
    assert done.returncode == 3
    assert "s_modes.csv: cannot be written (not a regular file)" in done.stderr
    assert (tmp_path / "out/s_modes.csv").is_fifo()
    assert len(list((tmp_path / "out").iterdir())) == 1
