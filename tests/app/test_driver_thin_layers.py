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
