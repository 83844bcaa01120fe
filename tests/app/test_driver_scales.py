"""The standalone driver: steady motions by multiple scales."""

import pytest
from driver import GOOD, MOTION, SCENES, check_refused, command

STEADY = """&pendulum e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.005, c2=0.005, f0=0.002, p1=1 /
&multiple_scales from=1.0, to=1.05, count=26, tolerance=0.05 /
"""

OF_MOUNT = GOOD[: GOOD.index("&response")] + "&multiple_scales from=1.3, to=1.7, count=9 /\n"

BAD_STEADY = {
    "both results": (STEADY + MOTION.splitlines()[1], 2, "has &transient already"),
    "spectrum of steady motions": (STEADY + "&spectrum /", 3, "&spectrum: needs &transient"),
    "with a response": (GOOD + "&multiple_scales from=1, to=2 /", 5, "has &response already"),
    "of a mount": (OF_MOUNT.replace("from", "parameter='p1', from"), 4, "must be one of 'nu'"),
    "frequency twice": (OF_MOUNT.replace("from", "nu=1, from"), 4, "is what is varied"),
    "no frequency": (OF_MOUNT.replace("from", "parameter='load', from"), 4, "nu"),
    "order": (OF_MOUNT.replace("ude=0.1 /", "ude=0.1, order=3 /"), 4, "must have order 1 alone"),
    "phase": (OF_MOUNT.replace("ude=0.1 /", "ude=0.1, phase=1 /"), 4, "must have phase 0"),
    "base": (OF_MOUNT.replace("ude=0.1 /", "ude=0.1, kind='base' /"), 4, "must be a force"),
    "no load": (OF_MOUNT.replace("ude=0.1 /", "ude=0 /"), 4, "must have order 1 alone"),
    "ordering of a mount": (OF_MOUNT.replace("count", "ordering='general', count"), 4, "ordering"),
    "ordering": (
        STEADY.replace("count", "ordering='strong', count"),
        2,
        "must be one of 'general'",
    ),
    "parameter": (STEADY.replace("from", "parameter='p4', from"), 2, "must be one of 'p1'"),
    "nowhere": (STEADY.replace("to=1.05", "to=1.0"), 2, "to = 1: must be greater than from = 1"),
    "count": (STEADY.replace("count=26", "count=1"), 2, "count = 1: must be 2 to"),
    "from": (STEADY.replace("from=1.0", "from=-1.0"), 2, "from = -1: must be greater than 0"),
    "tolerance": (STEADY.replace("tolerance=0.05", "tolerance=1"), 2, "tolerance = 1: must be in"),
}


@pytest.mark.parametrize("name", BAD_STEADY)
def test_bad_multiple_scales_is_one_line_with_its_place(solve, tmp_path, name):
    text, line, message = BAD_STEADY[name]
    check_refused(solve, tmp_path, text, message, line)


@pytest.mark.parametrize("scene", ["pendulum_scales", "mount_scales"])
def test_steady_motions_by_command(tmp_path, scene):
    done = command("run", SCENES / f"{scene}.nml", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / f"{scene}_multiple_scales.csv").exists()
    assert (tmp_path / f"{scene}_multiple_scales.png").stat().st_size > 20_000


def test_steady_motions_of_no_load(solve, tmp_path):
    scene = tmp_path / "still.nml"
    scene.write_text(STEADY.replace("f0=0.002", "f0=0"))
    done = solve(scene, "--out", tmp_path / "out")
    assert done.returncode == 2
    assert "load 1 has no amplitude" in done.stderr
