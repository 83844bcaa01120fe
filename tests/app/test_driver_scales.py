"""The standalone driver: steady motions by multiple scales."""

import os

import numpy as np
import pytest
import viscovib as vv
from driver import GOOD, MOTION, SCENES, check_failure, command, read_csv, silence

STEADY = """&pendulum e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.005, c2=0.005, f0=0.002, p1=1 /
&multiple_scales from=1.0, to=1.05, count=26, tolerance=0.05 /
"""

OF_MOUNT = GOOD[: GOOD.index("&response")] + "&multiple_scales from=1.3, to=1.7, count=9 /\n"
OF_SYSTEM = """&system mass=1 1, stiffness=1 4.04, damping=0.01 0.01, coordinates='a' 'b' /
&kernel kind='prony', weights=0.02, rates=0.8 /
&force on='a', coefficient=0.4, powers=1 1 /
&force on='b', coefficient=0.2, powers=2 0 /
&load amplitude=0.002, on='a' /
&load amplitude=0.001, on='b' /
&multiple_scales parameter='load', from=0.0005, to=0.004, count=5, nu=1.01 /
"""

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
    np.testing.assert_allclose(table["z_re"], result.steady.harmonics[:, 0].real, rtol=1e-11)
    np.testing.assert_array_equal(table["stable"] == 1, result.steady.stable)
    assert solve(scene, "--plan").stdout.strip() == str(vv.plan(scene))
    with pytest.raises(vv.InputError, match="this scene computed another result"):
        _ = result.trajectory


@pytest.mark.parametrize(
    ("text", "moves"),
    [
        (STEADY, "z"),
        (STEADY.replace("count=26", "count=26, ordering='weak_coupling'"), "z"),
        (OF_MOUNT, "phi"),
        (OF_MOUNT.replace("from=1.3, to=1.7", "parameter='load', nu=1.6, from=-0.1, to=0.2"), "x"),
        (OF_SYSTEM, "b"),
        (OF_SYSTEM.replace("force on", "force kernel=1, on"), "a"),
    ],
)
def test_steady_motions_are_the_same_to_the_last_bit(solve, tmp_path, text, moves):
    scene = tmp_path / "steady.nml"
    scene.write_text(text)
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    table = read_csv(tmp_path / "steady_multiple_scales.csv")
    with silence():
        steady = vv.run(scene).steady
    assert steady.index.size > 4
    # The debug build rounds differently.
    rounding = 1e-9 if "debug" in os.environ.get("VISCOVIB_SOLVE", "") else 0
    largest = np.abs(steady.harmonics).max()
    np.testing.assert_allclose(table[steady.parameter], steady.at, rtol=rounding)
    for d, name in enumerate(steady.dof_names):
        for part in ("re", "im"):
            ours = getattr(steady.harmonics[:, d], {"re": "real", "im": "imag"}[part])
            np.testing.assert_allclose(
                table[f"{name}_{part}"], ours, rtol=0, atol=rounding * largest
            )
    assert steady.amplitude(moves).max() > 1e-5
    np.testing.assert_allclose(
        table["error_estimate"], steady.error_estimate, rtol=0, atol=rounding * largest
    )
    np.testing.assert_array_equal(table["stable"] == 1, steady.stable)
    with silence():
        assert solve(scene, "--plan").stdout.strip() == str(vv.plan(scene))
    # The canonical scene reads back to the same.
    with silence():
        again = vv.Scene.read(scene)
        (tmp_path / "again.nml").write_text(again.canonical)
        np.testing.assert_array_equal(
            vv.run(tmp_path / "again.nml").steady.harmonics, steady.harmonics
        )


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
