"""Branches of a pendulum in scenes, by the driver and by Python."""

import csv
import os
import re
from contextlib import nullcontext

import numpy as np
import pytest
import viscovib as vv
from driver import MOTION, SCENES, check_failure, read_csv, silence

PENDULUM_BRANCH = MOTION.splitlines()[0] + "\n&branch from=0.9, to=1 /\n"
TORUS = """&pendulum e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.1, c2=0.1, c3=0.1, f0=0.02, p1=0.93,
  m01=0.01, p2=0.37 /
&branch from=0.9, to=0.95, harmonics=4, symmetry='kept' /
"""

BAD_BRANCHES = {
    "branch and motion": (MOTION + "&branch from=0.9, to=1 /", 3, "has &transient already"),
    "branch and scales": (
        PENDULUM_BRANCH + "&multiple_scales from=0.9, to=1 /",
        3,
        "has &branch already",
    ),
    "no such load": (PENDULUM_BRANCH.replace("from", "parameter='p2', from"), 2, "m01 = 0"),
    "no base": (
        TORUS.replace("from", "parameter='nu', from"),
        3,
        "needs a single base frequency",
    ),
    "no such branch": (PENDULUM_BRANCH.replace("to=1", "to=0.9"), 2, "must differ from from"),
    "orders": (PENDULUM_BRANCH.replace("to=1", "to=1, harmonics=0"), 2, "harmonics = 0: must be"),
    "too many orders": (TORUS.replace("=4", "=99"), 3, "harmonics = 99: must be 1 to"),
    "switch": (PENDULUM_BRANCH.replace("to=1", "to=1, switch=0"), 2, "switch = 0: must be"),
    "switch half": (PENDULUM_BRANCH.replace("to=1", "to=1, switch=0.5"), 2, "must be integers"),
    "symmetry": (PENDULUM_BRANCH.replace("to=1", "to=1, symmetry='no'"), 2, "must be one of 'any'"),
    "stability": (PENDULUM_BRANCH.replace("to=1", "to=1, stability='maybe'"), 2, "must be one of"),
    "nan": (
        PENDULUM_BRANCH.replace("from=0.9", "from=nan"),
        2,
        "from = nan: must be a finite number",
    ),
    "subharmonic": (PENDULUM_BRANCH.replace("to=1", "to=1, subharmonic=0"), 2, "must be 1 to 20"),
}


def test_branches_of_a_pendulum_agree(solve, tmp_path):
    """Folds, branch points, and the swinging motions that bifurcate at the first branch point."""
    scene = SCENES / "pendulum_branch.nml"
    checked = "debug" in os.environ.get("VISCOVIB_SOLVE", "")
    if checked:
        # The same branches with fewer harmonics, because 30 take 20 s with run-time checks.
        assert "harmonics = 30" in scene.read_text()
        text = scene.read_text().replace("harmonics = 30", "harmonics = 8")
        scene = tmp_path / scene.name
        scene.write_text(text)
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == checked, done.stderr
    assert "completed, " in done.stdout
    assert "2 folds, 4 branch points" in done.stdout
    assert done.stdout.endswith("; 1 bifurcating branch\n")
    with silence() if checked else nullcontext():
        result = vv.run(scene)
    assert str(vv.plan(scene)).splitlines() == solve(scene, "--plan").stdout.splitlines()
    assert len(result.switched) == 1
    for name, branch in (("branch", result.branch), ("branch_1", result.switched[0])):
        path = tmp_path / f"pendulum_branch_{name}.csv"
        table = read_csv(path)
        text = path.read_text()
        folds = [float(x) for x in re.search("; folds at p1 =(.*)", text)[1].split()]
        points = [float(x) for x in re.search("# branch points at p1 =(.*)", text)[1].split()]
        assert folds == pytest.approx(branch.folds, rel=1e-9)
        assert points == pytest.approx([p.parameter for p in branch.branch_points], rel=1e-9)
        changes = re.findall(r"# stability changes after point (\d+): (.*) at p1 = (\S+)", text)
        assert [kind for _, kind, _ in changes] == [c.kind for c in branch.crossings]
        where = [c.parameter for c in branch.crossings]
        assert [float(at) for _, _, at in changes] == pytest.approx(where, rel=1e-9)
        outside = (np.abs(branch.multipliers) > 1 + 1e-9).sum(axis=1)
        assert (table["stable"] == (table["growing"] == 0)).all()
        if checked:
            continue
        assert folds == branch.folds.tolist()
        assert (table["p1"] == branch.parameter).all()
        assert [int(before) for before, _, _ in changes] == [1 + c.before for c in branch.crossings]
        assert [float(at) for _, _, at in changes] == where
        assert (table["growing"] == outside).all()
        assert (table["stable"] == branch.stable).all()
        largest = branch.multipliers[:, 0]
        assert (table["multiplier"] == np.hypot(largest.real, largest.imag)).all()
        for d, dof in enumerate(branch.dof_names):
            for j, k in enumerate(branch.harmonics):
                assert (table[f"{dof}_{k}_re"] == branch.coefficients[:, d, j].real).all()
                assert (table[f"{dof}_{k}_im"] == branch.coefficients[:, d, j].imag).all()
    # Swinging motions at half the frequency of the load.
    assert result.switched[0].amplitude("phi", 1).max() > 0.3
    assert result.branch.amplitude("phi", 1).max() == 0


def test_stability_may_be_left_out(solve, tmp_path):
    scene = tmp_path / "s.nml"
    scene.write_text(PENDULUM_BRANCH.replace("to=1", "to=1, stability='no'"))
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "stable" not in read_csv(tmp_path / "s_branch.csv").dtype.names
    assert "skips: stability (not requested)" in solve(scene, "--plan").stdout
    assert vv.run(scene).branch.stable is None


def test_quasi_periodic_branch_of_a_scene(solve, tmp_path):
    scene = tmp_path / "torus.nml"
    scene.write_text(TORUS)
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 1, done.stderr
    assert "1 of 1 branch with too few harmonics" in done.stdout
    lines = (tmp_path / "torus_branch.csv").read_text().splitlines()
    rows = list(csv.reader(line for line in lines if not line.startswith("#")))
    with pytest.warns(vv.ConvergenceWarning, match="4 harmonics: the estimated relative error"):
        branch = vv.run(scene).branch
    assert branch.axes == ("p1", "p2")
    assert rows[0][:4] == ["p1", "omega_1", "omega_2", "error"]
    assert len(rows[0]) == 4 + 6 * len(branch.orders)
    column = rows[0].index("phi_1,-2_re")
    values = np.array([float(row[column]) for row in rows[1:]])
    place = branch.orders.tolist().index([1, -2])
    assert values == pytest.approx(branch.coefficients[:, 1, place].real, abs=1e-12)
    assert str(vv.plan(scene)).splitlines() == solve(scene, "--plan").stdout.splitlines()


@pytest.mark.parametrize("name", BAD_BRANCHES)
def test_bad_branch_is_one_line_with_its_place(solve, tmp_path, name):
    text, line, message = BAD_BRANCHES[name]
    scene = tmp_path / "bad.nml"
    scene.write_text(text)
    out = tmp_path / "out"
    out.mkdir()
    done = solve(scene, "--out", out)
    check_failure(done, 2, message, out)
    assert f"bad.nml:{line}: " in done.stderr
    with pytest.raises(vv.ViscovibError) as error:
        vv.run(scene)
    assert str(error.value) in done.stderr
