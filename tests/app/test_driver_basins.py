"""The standalone driver: basins of attraction, against SciPy and Python; error messages."""

import numpy as np
import pytest
import viscovib as vv
from driver import read_csv, silence

WELLS = """&system coordinates='x' mass=1 stiffness=-1 damping=0.3 /
&force law='x^3' /
&basins vary='x' 'x_dot' from=-1.6 -1.5 to=1.5 1.4 count=7 6 t_end=120 /
"""
DUFFING = """&system coordinates='x' mass=1 stiffness=1 damping=0.05 /
&force law='x^3' /
&load amplitude=0.3 /
&basins vary='x' 'x_dot' from=-3 -2 to=3 2 count=4 3 nu=1.4 n_periods=150 /
"""
PENDULUM = """&pendulum e=0.1 w2=0.4 w3=0.8 alpha=0.5 c1=0.1 c2=0.1 c3=0.1 f0=0.02 p1=0.8 /
&basins vary='phi' 'psi' from=-0.5 -0.3 to=0.5 0.3 count=3 3 n_periods=80 max_period=4 /
"""

GAP = """&system coordinates='x' mass=1 stiffness=-1 damping=0.3 /
&force law='x^3 + 5*max(x - 0.6, 0)' /
&load amplitude=0.15 /
&basins vary='x' 'x_dot' from=-1.5 -1.2 to=1.4 1.3 count=3 3 nu=1.3 n_periods=40 max_period=4 /
"""
MEMORY = """&system coordinates='x' mass=1 stiffness=-1 damping=0.3 /
&kernel kind='prony' weights=0.2 rates=0.7 /
&force law='x^3' /
&basins vary='x' 'x_dot' from=-1.5 -1.2 to=1.4 1.3 count=3 3 t_end=90 /
"""
#: x2 starts and ends at 0: its scale is its motion in between.
BEAM = """&structure coordinates='x1' 'x2' mass=1 1 stiffness=0.4 -1.1 -1.1 1.1 damping=0.3 0.3 /
&element on='x1' law='d^3' /
&basins vary='x1' 'x1_dot' from=-1.5 -1.2 to=1.4 1.3 count=3 3 t_end=150 /
"""
#: The sticking slider is part of the state.
FRICTION = """&structure coordinates='x1' mass=1 stiffness=-1 damping=0.3 /
&element on='x1' law='d^3' /
&element on='x1' hysteresis='jenkins' hysteresis_numbers=2 0.05 /
&basins vary='x1' 'x1_dot' from=-1.5 -1.2 to=1.4 1.3 count=3 3 t_end=60 /
"""
SHAKEN = FRICTION.replace("t_end=60", "nu=1.3 n_periods=40 max_period=4").replace(
    "&basins", "&load amplitude=0.2 /\n&basins"
)
MOUNT = """&mount mass=1 inertia=0.5 offset=0.2 stiffness_x=1 stiffness_phi=0.6
  damping=0.3 0 0 0.2 /
&kernel acts_on='x' kind='prony' weights=0.2 rates=0.7 /
&load amplitude=0.1 /
&basins vary='phi' 'x' from=-0.4 -0.2 to=0.3 0.3 count=2 2 nu=0.8 n_periods=20 max_period=2 /
"""


def _run(solve, folder, text, status=0):
    scene = folder / "scene.nml"
    scene.write_text(text)
    done = solve(scene, "--out", folder)
    assert done.returncode == status, done
    return read_csv(folder / "scene_basins.csv"), np.atleast_1d(
        read_csv(folder / "scene_basins_1.csv")
    )


@pytest.mark.parametrize(
    "text", [WELLS, DUFFING, PENDULUM, GAP, MEMORY, BEAM, MOUNT, FRICTION, SHAKEN]
)
def test_python_tells_the_same(solve, tmp_path, text):
    """The same labels, attractors and certainties."""
    rows, ends = _run(solve, tmp_path, text)
    x, y = rows.dtype.names[:2]
    call = {"n_periods": 150, "load": 0.3, "nu": 1.4}
    if text is WELLS:
        call = {"t_end": 120.0}
    elif text is PENDULUM:
        call = {"n_periods": 80, "max_period": 4}
    elif text is GAP:
        call = {"n_periods": 40, "max_period": 4, "load": 0.15, "nu": 1.3}
    elif text is MOUNT:
        call = {"n_periods": 20, "max_period": 2, "load": 0.1, "nu": 0.8}
    elif text is SHAKEN:
        call = {"n_periods": 40, "max_period": 4, "load": 0.2, "nu": 1.3}
    elif text in (MEMORY, BEAM, FRICTION):
        call = {"t_end": {MEMORY: 90.0, BEAM: 150.0, FRICTION: 60.0}[text]}
    scene = vv.Scene.read(tmp_path / "scene.nml")
    kind = {PENDULUM: "pendulum", MOUNT: "mount"}.get(text, "polynomial_system")
    if text in (BEAM, FRICTION, SHAKEN):
        kind = "structure"
    system = getattr(scene, kind)()
    found = vv.basins(system, {x: np.unique(rows[x]), y: np.unique(rows[y])}, **call)
    np.testing.assert_array_equal(found.labels.ravel(), rows["attractor"])
    np.testing.assert_allclose(found.moved.ravel(), rows["moved"], rtol=1e-2, atol=1e-9)
    np.testing.assert_allclose(found.rest, ends["rest"], rtol=1e-2, atol=1e-6)
    names = [f"{name}{dot}" for name in system.dof_names for dot in ("", "_dot")]
    for own, row in zip(found.attractors, ends, strict=True):
        assert row[names].tolist() == pytest.approx(own[0].tolist(), abs=1e-6)


def test_what_has_not_settled_and_what_has_left(solve, tmp_path):
    """A saddle, a run that is too short, and a run that diverges."""
    even = WELLS.replace("-1.6 -1.5", "-1.5 -1.5").replace("1.5 1.4 count=7 6", "1.5 1.5 count=3 3")
    rows, ends = _run(solve, tmp_path, even, 1)
    assert rows["attractor"][4] == -1
    assert len(ends) == 2
    rows, ends = _run(solve, tmp_path, WELLS.replace("t_end=120", "t_end=1"), 1)
    assert set(rows["attractor"]) == {-1}
    assert not ends.size
    away = WELLS.replace("stiffness=-1", "stiffness=1").replace("'x^3'", "'-x^3'")
    away = away.replace("-1.6 -1.5", "-0.9 0").replace("count=7 6", "count=3 2")
    rows, ends = _run(solve, tmp_path, away, 1)
    left = rows["attractor"] == -2
    assert 0 < left.sum() < left.size
    assert set(rows["outcome"][left]) == {"diverged"}
    assert np.isnan(rows["moved"][left]).all()
    assert ends["x"] == pytest.approx(0, abs=1e-3)


@pytest.mark.parametrize(
    ("scene", "old", "new", "text"),
    [
        (WELLS, "vary='x' 'x_dot'", "vary='x'", "must be two of 'x', 'x_dot'"),
        (WELLS, "vary='x' 'x_dot'", "vary='x' 'y'", "vary = 'y': must be two of"),
        (WELLS, "vary='x' 'x_dot'", "vary='x' 'x'", "is there twice"),
        (WELLS, "vary='x' 'x_dot'", "", "lacks vary"),
        (WELLS, "from=-1.6 -1.5", "from=-1.6", "from has 1 values: must be 2"),
        (WELLS, "count=7 6", "count=7 0", "count = 7 0: must be"),
        (WELLS, "count=7 6", "count=7000 6000", "must be"),
        (WELLS, "count=7 6", "count=7 6.5", "must be integers"),
        (WELLS, "t_end=120", "n_periods=120", "there is none; the length is t_end"),
        (WELLS, "t_end=120", "t_end=-1", "must be greater than 0"),
        (WELLS, "t_end=120", "t_end=1e300", "dt: takes"),
        (WELLS, "t_end=120", "t_end=120 dt=130", "must not exceed t_end"),
        (WELLS, "t_end=120", "t_end=120 dt=-1", "must be greater than 0"),
        (WELLS, "t_end=120", "t_end=120 tolerance=1", "must be between 0 and 1"),
        (WELLS, "t_end=120", "t_end=120 initial=1", "initial has 1 values: must be 2"),
        (WELLS, "t_end=120", "t_end=120 nu=1", "nu: is the frequency"),
        (WELLS, "t_end=120", "t_end=120 tolerence=1", "did you mean 'tolerance'?"),
        (BEAM, "/\n&element", "loss_factor=0.1 /\n&element", "loss_factor has no meaning in time"),
        (GAP, "amplitude=0.15", "amplitude=0.15 kind='base'", "base"),
        (MEMORY, "t_end=90", "t_end=90 dt=100", "must not exceed t_end"),
        (WELLS, "stiffness=-1 damping=0.3", "", "the system has no linear period"),
        (DUFFING, "n_periods=150", "t_end=150", "n_periods under a load"),
        (DUFFING, "n_periods=150", "n_periods=17 dt=80", "dt = 80: must not exceed the length"),
        (DUFFING, "n_periods=150", "n_periods=16", "n_periods = 16: must be more than twice"),
        (DUFFING, "n_periods=150", "n_periods=150 max_period=0", "must be 1 to 1000"),
        (DUFFING, "nu=1.4", "", "&basins lacks nu"),
        (DUFFING, "amplitude=0.3", "amplitude=0.3 kind='base'", "base"),
        (PENDULUM, "max_period=4", "sections=4", "sections = 4: must be 1 to 3"),
        (PENDULUM, "max_period=4", "sections=2", "frequency of that load must be greater"),
        (PENDULUM, "max_period=4", "initial=-1 0 0 0 0 0", "initial: z = -1, must be greater"),
        (PENDULUM, "'phi' 'psi' from=-0.5", "'z' 'psi' from=-1.5", "from: z = -1.5, must be"),
    ],
)
def test_what_is_wrong_is_named(solve, tmp_path, scene, old, new, text):
    """One line with the file and the line, and no output files; Python reports the same."""
    assert old in scene
    path = tmp_path / "scene.nml"
    path.write_text(scene.replace(old, new))
    done = solve(path, "--out", tmp_path / "out")
    assert done.returncode == 2, done
    assert text in done.stderr
    assert "scene.nml:" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not list((tmp_path / "out").glob("*"))
    with pytest.raises(vv.InputError) as reported, silence():
        vv.run(path)
    assert str(reported.value) == done.stderr.strip().removeprefix("viscovib-solve: ")
