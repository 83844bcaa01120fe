"""Thin layers of laws in time: the driver makes the same parts of steps as Python."""

import os

import numpy as np
import pytest
import viscovib as vv
from driver import read_csv

SCENE = """&system coordinates='x' mass=1 stiffness=1 damping=0.05 /
&force on='x' law='{law}' /
&transient t_end=6 initial=0 1 {more}/
"""


@pytest.mark.parametrize("more", ["", "dt=0.05 "])
@pytest.mark.parametrize("law", ["-4*exp(-((x-0.13)/2e-3)^2)", "0.3*tanh((x-0.2)/1e-3)"])
def test_parts_are_the_same(solve, tmp_path, law, more):
    scene = tmp_path / "scene.nml"
    scene.write_text(SCENE.format(law=law, more=more))
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done
    rows = read_csv(tmp_path / "scene_transient.csv")
    last = np.array([rows["x"][-1], rows["x_dot"][-1]])
    run = vv.run(scene).value
    free = vv.simulate(vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05), 6, initial=[0, 1])
    assert np.abs(run.state[-1] - free.state[-1]).max() > 1e-3
    if "debug" in os.environ.get("VISCOVIB_SOLVE", ""):
        assert last == pytest.approx(run.state[-1], abs=1e-9)
    else:
        np.testing.assert_array_equal(last, run.state[-1])


CHAIN = """&structure size=2 mass=1 1 stiffness=2 -1 -1 2 rayleigh=0 0.05 /
{kernel}&element on='x1' law='{law}' /
&transient t_end=4 initial=0 1 0 -0.3 {more}/
&event function='x1 - 0.1' /
"""
MEMORY = (
    "&kernel kind='prony' weights=0.3 rates=0.7 /\n"
    "&element on='x1' stiffness=1 law='0' kernel=1 /\n"
)


@pytest.mark.parametrize("more", ["", "keep='last' "])
@pytest.mark.parametrize("kernel", ["", MEMORY])
@pytest.mark.parametrize("law", ["3*exp(-((d-0.13)/2e-3)^2)", "0.5*tanh((d-0.2)/1e-3)"])
def test_structures_take_steps_that_see_them(solve, tmp_path, law, kernel, more):
    """The driver looks for layers as Python does, with memory and without."""
    scene = tmp_path / "scene.nml"
    scene.write_text(CHAIN.format(law=law, kernel=kernel, more=more))
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done
    rows = read_csv(tmp_path / "scene_transient.csv")
    last = [np.atleast_1d(rows[name])[-1] for name in ("x1", "x1_dot", "x2", "x2_dot")]
    run = vv.simulate(
        vv.Scene.read(scene).structure(), 4.0, initial=[0, 1, 0, -0.3], events=["x1 - 0.1"]
    )
    assert run.error < 1e-9
    assert np.abs(last - run.state[-1]).max() < 1e-9
    passages = np.atleast_1d(read_csv(tmp_path / "scene_event.csv"))
    assert passages["t"] == pytest.approx(run.events[0].t, abs=1e-9)
    vv.run(scene).to_csv(tmp_path / "own.csv")
    if "debug" not in os.environ.get("VISCOVIB_SOLVE", ""):
        theirs = tmp_path / "scene_transient.csv"
        assert (tmp_path / "own.csv").read_bytes() == theirs.read_bytes()
    wide = law.replace("2e-3", "1e6").replace("1e-3", "1e6").replace("3*exp", "0*exp")
    scene.write_text(CHAIN.format(law=wide, kernel=kernel, more=more))
    without = vv.simulate(vv.Scene.read(scene).structure(), 4.0, initial=[0, 1, 0, -0.3])
    assert np.abs(run.state[-1] - without.state[-1]).max() > 1e-3
