"""The group &modes: natural frequencies as a table, by the core, for any system."""

import pickle

import matplotlib.pyplot
import numpy as np
import pytest
import viscovib as vv
from scipy.linalg import eigh

SCENE = """&system coordinates='x' 'y' 'z' mass=1 2 0.5
  stiffness=3 -1 0 -1 4 -2 0 -2 5 /
&kernel kind='prony' weights=0.1 rates=1 /
&modes coordinates='x' 'z' /
"""


@pytest.fixture
def result(tmp_path):
    path = tmp_path / "chain.nml"
    path.write_text(SCENE)
    return vv.run(path)


def test_they_solve_the_eigenvalue_problem(result):
    stiffness = np.array([[3, -1, 0], [-1, 4, -2], [0, -2, 5.0]])
    squares, shapes = eigh(stiffness, np.diag([1, 2, 0.5]))
    columns = result.value.columns
    assert list(columns) == ["mode", "omega", "frequency", "x", "z"]
    assert columns["mode"].tolist() == [0, 1, 2]
    assert columns["omega"] == pytest.approx(np.sqrt(squares), rel=1e-14)
    assert columns["frequency"] == pytest.approx(np.sqrt(squares) / (2 * np.pi), rel=1e-14)
    assert columns["x"] / columns["z"] == pytest.approx(shapes[0] / shapes[2], rel=1e-12)


def test_it_is_a_result_as_others_are(result, tmp_path):
    value = result.value
    assert result.kind == value.kind == "modes"
    assert value.complete
    assert "3 modes, omega = " in repr(value)
    assert "skips: damping, memory and loads" in str(result.plan)
    assert pickle.loads(pickle.dumps(value)) == value
    assert value.to_dataset().omega.values.tolist() == value.columns["omega"].tolist()
    assert "<svg" in value._repr_html_()
    assert len(value.plot()) == 4
    matplotlib.pyplot.close("all")
    value.to_netcdf(tmp_path / "modes.nc")


def test_a_sweep_keeps_its_numbers(tmp_path):
    path = tmp_path / "chain.nml"
    path.write_text(SCENE)
    data = vv.sweep(path, {"system.stiffness(1)": [3.0, 4.0]}, extract="summary", progress=False)
    assert data.omega.values[1] > data.omega.values[0]
