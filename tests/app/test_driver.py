"""The standalone driver: its tables against Python, exit statuses, files, command lines."""

import csv
import os
import shutil
import subprocess

import numpy as np
import pytest
import viscovib as vv
from driver import GOOD, SCENES, check_failure, command, read_csv, silence


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
    assert str(vv.plan(scene)).splitlines() == solve(scene, "--plan").stdout.splitlines()
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
        assert "1 of 1 frequency solved, 1 of them with too few harmonics" in done.stdout


@pytest.mark.parametrize("harmonics", ["31", "'auto', tolerance = 1e-8"], ids=["31", "auto"])
def test_branches_of_driver_and_python_agree(solve, tmp_path, harmonics):
    scene = tmp_path / "mount_branch.nml"
    text = (SCENES / "mount_branch.nml").read_text()
    scene.write_text(text.replace("harmonics = 'auto'", f"harmonics = {harmonics}"))
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "completed, " in done.stdout
    assert "2 folds" in done.stdout
    table = read_csv(tmp_path / "mount_branch_branch.csv")
    branch = vv.run(scene).branch
    assert str(vv.plan(scene)).splitlines() == solve(scene, "--plan").stdout.splitlines()
    if "debug" not in os.environ.get("VISCOVIB_SOLVE", ""):
        assert (table["nu"] == branch.nu).all()
        if "auto" in harmonics:
            assert (table["highest"] == branch.highest).all()
            assert (table["truncation"] == branch.truncation).all()
            assert (table["error"] == branch.error).all()
        for d, dof in enumerate(branch.dof_names):
            for j, k in enumerate(branch.harmonics):
                assert (table[f"{dof}_{k}_re"] == branch.coefficients[:, d, j].real).all()
                assert (table[f"{dof}_{k}_im"] == branch.coefficients[:, d, j].imag).all()
        assert (table["stable"] == branch.stable).all()
        lines = (tmp_path / "mount_branch_branch.csv").read_text().splitlines()
        reported = [line.split() for line in lines if line.startswith("# stability changes")]
        assert [int(words[5].rstrip(":")) - 1 for words in reported] == [
            c.before for c in branch.crossings
        ]
        assert [float(words[-1]) for words in reported] == [c.parameter for c in branch.crossings]
    silent = tmp_path / "silent.nml"
    silent.write_text(scene.read_text().replace("nu_from", "stability='no', nu_from"))
    assert solve(silent, "--out", tmp_path).returncode == 0
    assert "stable" not in read_csv(tmp_path / "silent_branch.csv").dtype.names
    assert vv.run(silent).branch.stable is None
    assert str(vv.plan(silent)).splitlines() == solve(silent, "--plan").stdout.splitlines()


@pytest.mark.parametrize("memory", [False, True])
def test_stability_of_a_response_in_driver_and_python(solve, tmp_path, memory):
    kernel = "&kernel kind='prony', weights=0.02 0.3, rates=0.15 3 /\n" if memory else ""
    load = f"&load on='x', amplitude={2.5 if memory else 1.5} /\n"
    scene = tmp_path / "judged.nml"
    scene.write_text(
        "&mount mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2,\n"
        f"  damping=0.2 -0.1 -0.1 0.09 /\n{kernel}{load}"
        "&response method='newton', stability='yes', nu_from=2, nu_to=3.4, nu_count=20 /\n"
    )
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    table = read_csv(tmp_path / "judged_response.csv")
    r = vv.run(scene).response
    assert str(vv.plan(scene)).splitlines() == solve(scene, "--plan").stdout.splitlines()
    assert "computes: stability of each motion" in str(vv.plan(scene))
    if "debug" not in os.environ.get("VISCOVIB_SOLVE", ""):
        assert (table["stable"] == r.stable).all()
        assert {0, 1} <= set(table["stable"].tolist())
        r.to_csv(tmp_path / "python.csv")
        assert read_csv(tmp_path / "python.csv").dtype.names == table.dtype.names
    wrong = tmp_path / "wrong.nml"
    wrong.write_text(scene.read_text().replace("'newton'", "'successive'"))
    done = solve(wrong, "--out", tmp_path)
    assert done.returncode != 0
    assert "stability: needs method = newton" in done.stderr


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
                "nu_from=0.5, nu_to=4, nu_count=8",
                f"tolerance=1e-13, harmonics=9, nu={' '.join(p['nu'] for p in points)}",
            )
        )
        done = solve(scene, "--out", tmp_path)
        # The tables have nine harmonics, a fixed number.
        assert done.returncode in (0, 1), done.stderr
        assert f"{len(points)} of {len(points)} frequencies solved" in done.stdout
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
