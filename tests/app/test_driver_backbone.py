"""Backbones in scenes, by the driver and by Python."""

import re

import numpy as np
import pytest
import viscovib as vv
from driver import GOOD, MOTION, SCENES, check_refused, command, silence

BODY = GOOD.splitlines()[0] + "\n"
FREE = BODY + "&backbone from=0.001, to=0.3 /\n"
SWING = MOTION.splitlines()[0] + "\n&backbone mode=1, from=0.001, to=0.1 /\n"
PAIR = """&system coordinates='a', 'b', mass=1 1, stiffness=1 2 /
&force on='a', law='a^3' /
&backbone from=0.01, to=0.2 /
"""

BAD_BACKBONES = {
    "and response": (GOOD + "&backbone from=0.1, to=1 /", 5, "has &response already"),
    "and branch": (FREE + "&load amplitude=1 /\n&branch nu_from=1, nu_to=2 /", 2, "has &branch"),
    "and motion": (MOTION + "&backbone from=0.1, to=1 /", 3, "has &transient already"),
    "and spectrum": (SWING + "&spectrum /", 3, "&spectrum: needs &transient"),
    "twice": (FREE + "&backbone from=0.1, to=1 /", 3, "a second &backbone"),
    "typo of the group": (
        FREE.replace("&backbone", "&backbon"),
        2,
        "unknown group &backbon; did you mean &backbone?",
    ),
    "typo": (FREE.replace("to=0.3", "to=0.3, harmonic=3"), 2, "did you mean 'harmonics'?"),
    "typo of what is needed": (FREE.replace("from", "form"), 2, "did you mean 'from'?"),
    "without an end": (FREE.replace(", to=0.3", ""), 2, "&backbone lacks to"),
    "backwards": (FREE.replace("to=0.3", "to=0.0005"), 2, "to = 0.0005: must be greater than from"),
    "no way": (FREE.replace("to=0.3", "to=0.001"), 2, "must be greater than from"),
    "from rest": (FREE.replace("0.001", "0"), 2, "from = 0: must be greater than 0"),
    "nan": (FREE.replace("0.001", "nan"), 2, "from = nan: must be a finite number"),
    "mode": (FREE.replace("from", "mode=2, from"), 2, "mode = 2: must be 0 to 1"),
    "mode half": (FREE.replace("from", "mode=0.5, from"), 2, "mode = 0.5: must be an integer"),
    "mode of three": (SWING.replace("mode=1", "mode=-1"), 2, "mode = -1: must be 0 to 2"),
    "dof": (FREE.replace("from", "dof='y', from"), 2, "dof = 'y': must be one of 'x', 'phi'"),
    "dof at rest": (PAIR.replace("from", "dof='b', from"), 3, "dof = 'b': does not move in mode 0"),
    "dof of a swing": (SWING.replace("from", "dof='z', from"), 2, "dof = 'z': does not move in"),
    "dof and energy": (
        SWING.replace("from", "parameter='energy', dof='phi', from"),
        2,
        "dof: is allowed with parameter = 'amplitude' only",
    ),
    "energy of a mount": (
        FREE.replace("from", "parameter='energy', from"),
        2,
        "unknown key 'parameter' in &backbone",
    ),
    "parameter": (SWING.replace("from", "parameter='p1', from"), 2, "must be one of 'amplitude'"),
    "printed": (
        SWING.replace("e=0.1", "e=0.1, equations='printed'"),
        2,
        "mode = 1: the printed equations keep no energy in swings",
    ),
    "harmonics": (FREE.replace("from", "harmonics=0, from"), 2, "harmonics = 0: must be 1 to"),
    "harmonics by another word": (
        FREE.replace("from", "harmonics='all', from"),
        2,
        "harmonics = 'all': must be",
    ),
    "harmonics in all": (
        SWING.replace("from", "harmonics=200, subharmonic=2, from"),
        2,
        "harmonics = 200: must be 1 to 199",
    ),
    "subharmonic": (SWING.replace("from", "subharmonic=21, from"), 2, "must be 1 to 20"),
    "points": (FREE.replace("from", "max_points=1, from"), 2, "max_points = 1: must be 2 to"),
    "step": (FREE.replace("from", "max_step=2, from"), 2, "max_step = 2: must be in [1e-4, 1]"),
    "tolerance": (FREE.replace("from", "tolerance=1, from"), 2, "tolerance = 1: must be in"),
    "switch": (SWING.replace("from", "switch=0, from"), 2, "switch = 0: must be the number"),
    "rigid": (PAIR.replace("=1 2", "=0 2"), 3, "mode = 0: moves as a rigid body"),
    "unstable": (PAIR.replace("=1 2", "=-1 2"), 3, "has an eigenvalue -1 < 0"),
    "coordinates": (FREE.replace("from", "coordinates='z', from"), 2, "'z' is none of them"),
    "alone": ("&backbone from=0.1, to=1 /\n", None, "no &mount group"),
}


def test_loads_are_reported_and_do_nothing(tmp_path):
    scene = tmp_path / "s.nml"
    scene.write_text(FREE)
    bare = vv.run(scene).backbone
    more = "&load amplitude=3 /\n" + GOOD.splitlines()[1] + "\n&backbone"
    lossy = FREE.replace("&backbone", more).replace("mass=1", "mass=1, damping=1 0 0 1")
    scene.write_text(lossy)
    with silence():
        loaded = vv.run(scene).backbone
    assert np.array_equal(bare.nu, loaded.nu)
    assert np.array_equal(bare.coefficients, loaded.coefficients)
    assert any("loads" in skipped for skipped in loaded.plan.skips)


@pytest.mark.parametrize("name", BAD_BACKBONES)
def test_bad_backbone_is_one_line_with_its_place(solve, tmp_path, name):
    text, line, message = BAD_BACKBONES[name]
    check_refused(solve, tmp_path, text, message, line)


def test_no_such_branch_point(solve, tmp_path):
    scene = tmp_path / "s.nml"
    scene.write_text(SWING.replace("from", "switch=7, from"))
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 2
    assert "switch = 7: the backbone has 0 branch points" in done.stderr
    with pytest.raises(vv.InputError, match="switch = 7: the backbone has 0 branch points"):
        vv.run(scene)


def test_commands(tmp_path):
    scene = tmp_path / "s.nml"
    scene.write_text(FREE)
    done = command("run", scene, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"s_backbone.csv", "s_backbone.png"}
    assert "0 folds" in done.stdout
    assert "free motions of mode 0" in command("plan", scene).stdout
    done = command("bench", scene, "--runs", 1)
    assert re.search(r"error \S+ \(relative, of the last frequency", done.stdout), done
    scene.write_text(FREE + "&sweep key='mount.offset', values=0.4 0.5 /\n")
    found = vv.run(scene).sweep
    one = vv.backbone(vv.Scene.read(SCENES / "mount_backbone.nml").mount(), 0, (1e-3, 0.3))
    assert found.nu_last[1] == pytest.approx(one.nu[-1], rel=1e-14)
    assert set(found.outcome.values) == {"completed"}
    few = tmp_path / "few.nml"
    few.write_text(FREE.replace("from", "max_points=5, from"))
    assert command("run", few, "--out", tmp_path / "out").returncode == 1
