"""The standalone driver: steady motions by multiple scales."""

import numpy as np
import pytest
import viscovib as vv
from driver import GOOD, MOTION, SCENES, check_failure, command

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
    assert solve(scene, "--plan").stdout.strip() == str(vv.plan(scene))
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
