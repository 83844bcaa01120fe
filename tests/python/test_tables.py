"""The same table to the last byte, by the driver and by Python, for every sample scene."""

import os
import subprocess
import warnings
from pathlib import Path

import pytest
import viscovib as vv
from viscovib.common.curve_options import OPTIONS

ROOT = Path(__file__).parents[2]
SCENES = ROOT / "data" / "scenes"
SOLVE = os.environ.get("VISCOVIB_SOLVE", ROOT / "build" / "release" / "fortran" / "viscovib-solve")

POINTS = sorted(path.name for path in SCENES.glob("*.nml"))
SWEPT = ("mount_map.nml",)
#: Options that the sample scenes do not use.
MORE = {
    "equilibrium": "&structure mass=1 2 stiffness=2 -1 -1 2 damping=0.1 0.1 /\n"
    "&element on='x1' law='0.4*d^3' /\n&load on='x2' amplitude=0.3 order=0 /\n&equilibrium /\n",
    "steady_motion": """&scene title='a gap and dry friction' /
&structure mass=1 2 stiffness=2 -1 -1 2 damping=0.1 0.1 /
&kernel kind='prony' weights=0.3 rates=1.5 /
&element on='x1' 'x2' stiffness=0.5 kernel=1 /
&element on='x1' law='9*max(d - 0.1, 0)' kernel=0 /
&element on='x2' law='0.1*sign(v)' kernel=0 /
&load on='x1' amplitude=0.8 /
&steady_motion nu=0.9 n_periods=2 coordinates='x2' /
""",
    "trace_motion": """&system coordinates='x' 'y' mass=1 2 stiffness=2 -1 -1 2
  damping=0.1 0 0 0.1 /
&force on='x' law='9*max(x - 0.2, 0)' /
&load on='x' amplitude=0.3 /
&trace_motion nu_from=0.7 nu_to=0.8 max_step=0.2 coordinates='x' /
""",
    "linear_branch": "&system coordinates='x' mass=1 stiffness=1 damping=0.1 /\n"
    "&load amplitude=0.3 /\n&branch nu_from=0.5 nu_to=2 /\n",
    "unbalance": """&system coordinates='x' 'y' mass=1 2 stiffness=2 -1 -1 2 damping=0.02 0 0 0.03 /
&force on='x' law='0.3*x^3' /
&load on='y' amplitude=0.02 kind='unbalance' order=2 phase=0.3 /
&load on='y' amplitude=0.01 order=2 /
&response nu=0.3 0.5 0.9 method='newton' /
""",
    "formulas of loads": """&parameters me=0.02 a=0.1 /
&system coordinates='x' 'y' mass=1 2 stiffness=2 -1 -1 2 damping=0.02 0 0 0.03 /
&force on='x' law='0.3*x^3' /
&load on='y' amplitude='me*Nu^2/sqrt(1 + a*nu)' phase='atan(0.2*nu)' /
&load on='x' amplitude=0.01 phase='0.1*nu + a' order=2 /
&load on='x' amplitude=0.02 phase=0.3 order=2 /
&load on='y' amplitude='0.01*exp(-nu)' kind='unbalance' order=3 /
&response nu=0.3 0.5 0.9 method='newton' sampling='yes' dissipation='yes' /
""",
    "formulas of loads on a mount": """&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10
  stiffness_phi=2 damping=0.3 0 0 0.1 /
&load amplitude='0.001*nu^2' phase='0.1*nu' /
&branch nu_from=1 nu_to=3 harmonics=3 /
""",
    "formulas of loads on a structure": """&structure mass=1 2 1.5 stiffness=2 -1 0 -1 2 -1 0 -1 2
  modal_damping=0.05 base_direction=1 1 1 /
&element on='x1' law='0.4*d^3' /
&load on='x2' amplitude='0.02*nu^2' phase='0.3*nu' /
&load amplitude=0.01 kind='base' /
&branch nu_from=0.5 nu_to=1.5 dissipation='yes' /
""",
    "formulas of loads on a damped structure": """&structure mass=1 2 1.5
  stiffness=2 -1 0 -1 2 -1 0 -1 2 damping=0.1 0 0 0 0.2 0 0 0 0.05 /
&element on='x1' law='0.4*d^3' /
&load on='x3' amplitude='0.02*nu^2' order=2 /
&response nu=0.3 0.5 0.9 dissipation='yes' /
""",
    "formulas of loads in time": """&structure mass=1 2 1.5 stiffness=2 -1 0 -1 2 -1 0 -1 2
  modal_damping=0.05 /
&element on='x1' law='0.4*d^3' /
&load on='x2' amplitude='0.02*nu^2' phase='0.3*nu' /
&transient t_end=9 nu=1.2 /
""",
    "formulas of loads on a body": """&body mass=1 inertia=0.03 0.02 0.04 geometry='exact' /
&mount_point name='a' position=0.2 0.1 0 stiffness=40 50 60 damping=0.5 0.4 0.6 /
&mount_point name='b' position=-0.2 0.1 0.1 stiffness=40 50 60 damping=0.5 0.4 0.6 /
&mount_point name='c' position=0 -0.2 0 stiffness=40 50 60 damping=0.5 0.4 0.6 /
&load force=1 0.5 0 torque=0 0 0.1 amplitude='0.001*nu^2' phase='0.1*nu' /
&branch nu_from=6 nu_to=9 harmonics=3 /
""",
    "formulas of loads in an ensemble": """&system coordinates='x' mass=1 stiffness=1 damping=0.1 /
&force on='x' law='0.3*x^3' /
&load amplitude='0.2*nu^2' phase='0.5*nu' /
&ensemble vary='nu' from=0.5 to=1.5 count=5 initial=0.1 0 t_end=9 /
""",
    "formulas of loads, periodic": """&system coordinates='x' mass=1 stiffness=1 damping=0.1 /
&force on='x' law='0.3*x^3' /
&load amplitude='0.2*nu^2' /
&trace_motion nu_from=0.5 nu_to=0.8 /
""",
    "corners": "&system coordinates='x' mass=1 stiffness=1 damping=0.1 /\n"
    "&force on='x' law='0.3*abs(x)*x' /\n&load amplitude=0.3 /\n&response nu=0.5 0.6 1.2 /\n",
    "corners_of_a_branch": "&system coordinates='x' mass=1 stiffness=1 damping=0.1 /\n"
    "&force on='x' law='0.3*abs(x)*x' /\n&load amplitude=0.3 /\n&branch nu_from=0.5 nu_to=0.7 /\n",
    "judged": """&scene title='a response, its stability and its mean' /
&system coordinates='x' 'y' mass=1 1 stiffness=2 -1 -1 2 damping=0.1 0 0 0.1 /
&force on='x' law='0.5*x^3 + 0.2*x^2' /
&load on='x' amplitude=0.2 /
&response nu=0.5 0.7 1.2 method='newton' stability='yes' coordinates='y' /
""",
    "vary": """&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2
  damping=0.1 0 0 0.1 /
&load amplitude=0.1 /
&branch vary='stiffness_x' nu=2 from=8 to=12 coordinates='x' /
""",
    "switches with memory": """&kernel kind='prony' weights=0.3 0.6 rates=1 5 /
&structure mass=1 2 stiffness=2 1 damping=0.1 0.1 /
&element on='x1' 'x2' law='5*max(d - 0.1, 0) + 0.3*d' kernel=1 /
&element on='x2' law='0.2*sign(v)' kernel=0 /
&load on='x1' amplitude=0.8 /
&transient t_end=12 nu=0.9 tolerance=1e-10 /
&event function='x2 - t/10' /
""",
    "a singular kernel": """&kernel kind='rabotnov' amplitude=0.5 alpha=0.4 beta=1.5 /
&structure mass=1 2 stiffness=2 1 damping=0.1 0.1 /
&element on='x1' 'x2' law='5*max(d - 0.1, 0) + 0.3*d' kernel=1 /
&element on='x2' law='0.2*sign(v)' kernel=0 /
&load on='x1' amplitude=0.8 /
&transient t_end=6 nu=0.9 tolerance=1e-10 /
""",
    "a system with a singular kernel": """&kernel kind='abel' amplitude=0.05 alpha=0.2 /
&system coordinates='x' 'y' mass=1 2 stiffness=2 -1 -1 2 damping=0.1 0 0 0.1 /
&force on='x' law='5*max(x - 0.1, 0)' /
&force on='y' law='0.1*sign(y_dot)' kernel=0 /
&load on='x' amplitude=0.8 /
&transient t_end=6 nu=0.9 dt=0.1 /
""",
    "a system that switches with memory": """&kernel kind='prony' weights=0.3 0.6 rates=1 5 /
&system coordinates='x' 'y' mass=1 2 stiffness=2 -1 -1 2 damping=0.1 0 0 0.1 /
&force on='x' law='5*max(x - 0.1, 0)' /
&force on='y' law='0.1*sign(y_dot)' kernel=0 /
&load on='x' amplitude=0.8 /
&transient t_end=12 nu=0.9 tolerance=1e-10 /
""",
    "a base and a past with switches": """&kernel kind='prony' weights=0.3 0.6 rates=1 5 /
&system coordinates='x' 'y' mass=1 2 stiffness=2 -1 -1 2 damping=0.1 0 0 0.1
  base_direction=1 0.5 /
&force on='x' law='5*max(x - 0.1, 0)' /
&force on='y' law='0.1*sign(y_dot)' kernel=0 /
&load kind='base' amplitude=0.4 /
&load on='x' amplitude=0.8 /
&transient t_end=12 nu=0.9 held=0.2 0.1 initial=0.1 0 0.1 0.2 tolerance=1e-10 /
&event function='x - 0.2' /
""",
    "a base with switches": """
&system mass=1 stiffness=1 damping=0.1 base_direction=1 coordinates='x' /
&force on='x' law='5*max(x - 0.1, 0)' /
&load kind='base' amplitude=0.4 /
&transient t_end=12 nu=0.9 dt=0.1 /
""",
    "a past with a singular kernel": """&kernel kind='rabotnov' amplitude=0.3 alpha=0.4 beta=1 /
&structure mass=1 2 stiffness=1 2 damping=0.1 0.2 base_direction=1 1 /
&element on='x1' 'x2' stiffness=2 law='5*max(d - 0.1, 0)' /
&load kind='base' amplitude=0.2 /
&transient t_end=4 nu=1.1 held=0.3 -0.1 tolerance=1e-9 /
""",
    "folded": """&system coordinates='x' mass=1 stiffness=1 damping=0.1 /
&force on='x' law='x^3' /
&load amplitude=0.3 /
&branch nu_from=0.4 nu_to=2.5 {} /
""",
    "diverged": """&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2 /
&load amplitude=2 /
&response nu=1.9 2 2.1 harmonics=5 /
""",
    "two_tones": """&pendulum e=0.1 w2=0.4 w3=0.8 c1=0.05 c2=0.05 c3=0.05
  f0=0.01 p1=0.9 m01=0.01 p2=0.31 /
&branch parameter='p1' from=0.9 to=0.95 harmonics=3 max_points=10 /
""",
    "laws_in_time": """&system coordinates='x' 'y' mass=1 0.1 stiffness=1.2 -0.2 -0.2 0.2
  damping=0.03 0 0 0 /
&kernel kind='prony' weights=0.3 rates=1.5 /
&force on='y' law='Tanh(3*x - y)' kernel=1 /
&force on='x' law='max(x - 0.1, 0) + 0.3*x^2' kernel=0 /
&load on='x' amplitude=0.5 /
&transient t_end=10 dt=0.05 nu=1.1 /
""",
    "modes": """&system coordinates='x' 'y' mass=1 1 stiffness=2 -1 -1 2 /
&modes coordinates='y' /
""",
    "roots": """&kernel kind='rzhanitsyn' amplitude=0.048 alpha=0.1 beta=0.05 /
&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2 /
&characteristic_roots /
""",
    "campbell": """&system coordinates='x' 'y' mass=1 1 stiffness=2 3 damping=0.3 0.3
  gyroscopic=0 0.5 -0.5 0 circulatory=0 0.2 -0.2 0 /
&campbell speed_from=0 speed_to=4 speed_count=9 orders=1 2 plane='x' 'y' /
""",
    "free_decay": """&system coordinates='x' 'y' mass=1 1 stiffness=2 -1 -1 2 damping=0.1 0 0 0.05 /
&transient t_end=40 dt=0.1 initial=0.1 0 0 0 /
&free_decay start=2 /
""",
    "modes_of_a_pendulum": """&pendulum e=0.1 w2=0.4 w3=0.8 /
&modes /
""",
    "lost": """&system coordinates='x' 'y' mass=1 1 stiffness=2 -1 -1 2 damping=0.05 0 0 0.05
  base_direction=1 0.5 /
&kernel kind='prony' weights=0.3 rates=1.5 /
&force on='x' law='0.2*tanh(x_dot/0.1) + 0.3*x^3' kernel=0 /
&force on='y' law='0.1*y^3' kernel=1 /
&load on='x' amplitude=0.4 /
&load kind='base' amplitude=0.1 phase=0.4 /
&response nu=0.5 0.7 1.2 method='newton' harmonics=9 sampling='yes' dissipation='yes'
  coordinates='y' /
""",
    "lost_linear": """&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2
  damping=0.1 0 0 0.1 /
&kernel kind='abel' amplitude=0.05 alpha=0.3 /
&load amplitude=0.1 /
&response nu=1 2 3 method='linear' sampling='yes' dissipation='yes' /
""",
    "lost_by_a_mount": """&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2
  geometry='exact' damping=0.1 0 0 0.1 /
&kernel kind='prony' weights=0.3 rates=1.5 /
&load kind='base' amplitude=0.1 phase=1 /
&load order=3 amplitude=0.05 /
&response nu=1 2 3 method='newton' sampling='yes' dissipation='yes' stability='yes' /
""",
    "lost_along": """&system mass=1 stiffness=1 damping=0.1 base_direction=1 coordinates='x' /
&force on='x' law='0.5*x*abs(x) + 0.1*x_dot^3' /
&load kind='base' amplitude=0.3 phase=0.5 /
&branch nu=1.2 vary='load_factor' from=0.2 to=1 sampling='yes' dissipation='yes' /
""",
    "many": """&scene title='a diagram' /
&system coordinates='x' mass=1 stiffness=-1 damping=0.3 /
&force on='x' law='x^3' /
&load on='x' amplitude=1 /
&ensemble vary='load_scale' from=0.2 to=0.35 count=11 nu=1.2 initial=0.1 0.2 sections=1
  n_periods=30 discard=20 dt=0.1 lyapunov='yes' /
""",
    "basins": """&scene title='two wells' /
&system coordinates='x' 'y' mass=1 1 stiffness=-1 1 damping=0.3 0.4 /
&force on='x' law='x^3 + 0.1*(x - y)^3' /
&force on='y' law='0.1*tanh(y - x)' /
&basins vary='x' 'y_dot' from=-1.5 -1 to=1.4 1 count=6 5 initial=0 0.1 0.2 0 t_end=60
  coordinates='y' /
""",
    "basins_of_a_pendulum": """&pendulum e=0.1 w2=0.4 w3=0.8 c1=0.1 c2=0.1 c3=0.1 f0=0.02 p1=0.8 /
&basins vary='psi' 'z' from=-0.4 -0.1 to=0.4 0.1 count=3 2 n_periods=60 dt=0.25 max_period=3 /
""",
    "basins_of_a_gap": """&structure coordinates='x' 'y' mass=1 1 stiffness=1 0.5 damping=0.3 0.4 /
&kernel kind='prony' weights=0.1 rates=0.7 /
&element on='x' 'y' law='d^3 + 3*max(d - 0.2, 0)' /
&load on='x' amplitude=0.2 /
&basins vary='x' 'y_dot' from=-1 -1 to=1.4 1 count=3 2 nu=0.9 n_periods=20 max_period=3 /
""",
    "pendulums": """&pendulum e=0.1 w2=0.4 w3=0.8 alpha=0.5 c1=0.01 c2=0.01 c3=0.01 p1=1.02 /
&ensemble vary='f0' from=0.001 to=0.004 count=4 initial=0 0 0.1 0 0 0 t_end=20 discard=5
  coordinates='phi' /
""",
    "series": """&system coordinates='x' mass=1 stiffness=1 damping=0.1 /
&force on='x' law='0.3*tanh(x_dot) + 0.2*sin(x) + 0.1*x^3' /
&load on='x' amplitude=1 /
&ensemble vary='nu' from=0.3 to=1.7 count=37 initial=0.1 0.2 t_end=30 discard=5 dt=0.4
  method='taylor20' /
""",
    "part": """&pendulum e=0.1 w2=0.4 w3=0.8 /
&transient initial=0.05 0 0.3 0 -0.2 0 t_end=20 dt=0.25 coordinates='phi' /
&spectrum coordinates='psi' window='flat_top' discard=5 /
""",
}
# The truncation determines the stability of one point.
MORE["decided by harmonics left out"] = (
    "&mount mass=1, inertia=0.051, offset=0.5, stiffness_x=12.50, stiffness_phi=1.12,\n"
    "  damping=0.002836 0 0 0.0002836 /\n&load on='phi', amplitude=0.1761, phase=0.833, order=2 /\n"
    "&response nu_from=0.483, nu_to=2.772, nu_count=12, method='newton', harmonics=9,\n"
    "  stability='yes' /\n"
)
# Step sizes begin with the highest harmonic of the load.
for order in 2, 7:
    MORE[f"order {order}"] = (
        "&system coordinates='a', mass=1, stiffness=0.5, damping=0.03 /\n&force law='0.2*a^3' /\n"
        f"&load amplitude=0.1, order={order} /\n&load amplitude=0, order=9 /\n"
        "&transient initial=-0.5 -0.2, t_end=8, nu=1.1, tolerance=1e-8 /\n"
    )
#: Each option of curves, for both programs.
FOLDED = MORE.pop("folded")
MORE |= {name: FOLDED.format(f"{name}={one.other!r}") for name, one in OPTIONS.items()}


def _compare(scene, folder):
    out = folder / "driver"
    done = subprocess.run(
        [SOLVE, scene, "--out", out, "--quiet"], capture_output=True, text=True, timeout=60
    )
    assert done.returncode in (0, 1), done
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vv.ConvergenceWarning)
        warnings.simplefilter("ignore", vv.StabilityWarning)
        result = vv.run(scene)
    tables = {path.name: path.read_bytes() for path in out.glob("*.csv")}
    mine = folder / "mine.csv"
    stem = f"{scene.stem}_{result.kind}"
    for i in range(len(result.switched) + 1):
        result.to_csv(mine, i)
        assert mine.read_bytes() == tables.pop(f"{stem}_{i}.csv" if i else f"{stem}.csv")
    if result.events is not None:
        result.events_to_csv(mine)
        assert mine.read_bytes() == tables.pop(f"{scene.stem}_event.csv")
    if result.shock_spectrum is not None:
        result.shock_spectrum_to_csv(mine)
        assert mine.read_bytes() == tables.pop(f"{scene.stem}_shock_spectrum.csv")
    if result.spectrum is not None:
        result.spectrum_to_csv(mine)
        assert mine.read_bytes() == tables.pop(f"{scene.stem}_spectrum.csv")
    if result.decay is not None:
        result.decay_to_csv(mine)
        assert mine.read_bytes() == tables.pop(f"{scene.stem}_free_decay.csv")
    assert not tables


@pytest.mark.parametrize("name", [name for name in POINTS if name not in SWEPT])
def test_sample(tmp_path, name):
    # File names in the table are those passed to both programs.
    _compare(SCENES / name, tmp_path)


@pytest.mark.parametrize("name", MORE)
def test_more(tmp_path, name):
    scene = tmp_path / f"{name}.nml"
    scene.write_text(MORE[name])
    _compare(scene, tmp_path)


@pytest.mark.parametrize("kind", ["response", "modes"])
def test_names_of_scenes_may_be_any_bytes(tmp_path, kind):
    """File names need not be UTF-8; tables contain their bytes."""
    scene = tmp_path / os.fsdecode(b"a\xff.nml")
    load = "&load amplitude=0.1 /\n&response nu=1 method='linear' /\n" if kind == "response" else ""
    scene.write_text(
        "&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2 /\n"
        f"{load or '&modes /'}\n"
    )
    result = vv.run(vv.Scene.read(scene).override({"mount.mass": 2}))
    assert result.value.complete
    vv.plan(scene)
    vv.run(scene).to_csv(tmp_path / "a.csv")
    assert b"a\xff.nml" in (tmp_path / "a.csv").read_bytes()
