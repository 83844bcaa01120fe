"""Thin layers of laws in time: the driver divides steps as Python does."""

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
    """The driver searches for layers as Python does, with and without memory."""
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


THIN = """&system coordinates='x' mass=1 stiffness=1 damping=0.05 /
&force law='50*exp(-((x-0.3)/1e-5)^2)*x_dot' /
&load amplitude=0.5 /
&ensemble vary='load_scale' from=0.5 to=1 count=3 nu=0.9 initial=0 0 t_end=20 {}/
"""


@pytest.mark.parametrize("more", ["", "dt=0.3 "])
def test_motions_side_by_side_see_them(solve, tmp_path, more):
    """A missed layer would cause an error of 3e-3 for a tolerance of 1e-8."""
    scene = tmp_path / "scene.nml"
    scene.write_text(THIN.format(more))
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done
    rows = read_csv(tmp_path / "scene_ensemble.csv")
    law = "50*exp(-((x-0.3)/1e-5)^2)*x_dot"
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces=law)
    for scale, *found in zip(rows["load_scale"], rows["x"], rows["x_dot"], strict=True):
        run = vv.simulate(system, 20, initial=[0, 0], load=0.5 * scale, nu=0.9)
        assert np.abs(found - run.state[-1]).max() < 2e-8
        # Steps of 0.3 give inaccurate peaks and means.
        roughly = np.abs(run.state[:, 0]).max()
        assert rows["peak_x"][rows["load_scale"] == scale] == pytest.approx(roughly, rel=0.02)
    reported = np.sqrt(np.trapezoid(run.state[:, 0] ** 2, run.t) / 20)
    assert rows["rms_x"][-1] == pytest.approx(reported, rel=0.02)


def test_their_exponents_are_those_of_neighbours(solve, tmp_path):
    """The exponent of a motion that enters a thin layer, as of Python."""
    scene = tmp_path / "scene.nml"
    scene.write_text(THIN.format("lyapunov='yes' "))
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done
    rows = read_csv(tmp_path / "scene_ensemble.csv")
    law = "50*exp(-((x-0.3)/1e-5)^2)*x_dot"
    many = vv.simulate_ensemble(
        vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces=law), initial=[0, 0],
        t_end=20, load=0.5, nu=0.9, parameters={"load_scale": rows["load_scale"]}, lyapunov=True,
    )  # fmt: skip
    np.testing.assert_allclose(rows["lyapunov"], many.lyapunov, rtol=0, atol=1e-6)
