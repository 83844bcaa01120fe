"""The standalone driver: events of motions in time."""

import pytest
import viscovib as vv
from driver import GOOD, check_refused, read_csv

MOUNT = GOOD[: GOOD.index("&load")] + "&load amplitude=0.5 /\n"
PENDULUM = "&pendulum e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, f0=0.005, p1=0.93 /\n"
SYSTEM = """&parameters gap = 0.2, k3 = 1 /
&system coordinates = 'x' 'y', mass = 1 2, stiffness = 1 -0.2 -0.2 0.7, damping = 0.1 0.05 /
&force on = 'x', law = 'k3*x^3 + 0.3*sin(x)' /
&load on = 'x', amplitude = 0.5, phase = 0.3 /
"""
CHAIN = """&structure size=3 mass=1 2 1 stiffness=2 -1 0 -1 2 -1 0 -1 2 rayleigh=0.02 0.03 /
&kernel kind='prony' weights=0.3 rates=1.5 /
&element on='x1' stiffness=0.4 law='0.5*d^3' /
&load on='x3' amplitude=0.2 /
"""
SCENES = {
    "system": SYSTEM + "&transient initial=0.1 0 0 0.3, nu=1.3, t_end=30, coordinates='y' /\n"
    "&event function='X - Gap', direction='up' /\n&event function='y_dot' /\n",
    "stops": SYSTEM + "&transient initial=0.1 0 0 0.3, nu=1.3, t_end=30, dt=0.2 /\n"
    "&event function='x - y*cos(t)' /\n"
    "&event function='y + gap', direction='down', terminal='yes' /\n",
    "stops, step found": SYSTEM + "&transient initial=0.1 0 0 0.3, nu=1.3, t_end=30 /\n"
    "&event function='y + gap', direction='down', terminal='yes' /\n",
    "stops, relative": SYSTEM + "&transient initial=0.1 0 0 0.3, nu=1.3, t_end=30, rtol=1e-7 /\n"
    "&event function='y + gap', direction='down', terminal='yes' /\n",
    "pendulum that stops": PENDULUM + "&transient initial=0.05 0 0.3 0 -0.2 0, t_end=20 /\n"
    "&event function='phi + 0.1', terminal='yes' /\n",
    "kept last": SYSTEM + "&transient initial=0.1 0 0 0.3, nu=1.3, t_end=30, keep='last' /\n"
    "&event function='y + gap', direction='down', terminal='yes' /\n",
    "none": SYSTEM + "&transient initial=0.1 0 0 0.3, nu=1.3, t_end=3 /\n"
    "&event function='x - 50*gap' /\n",
    "pendulum": PENDULUM + "&transient initial=0.05 0 0.3 0 -0.2 0, t_end=20, tolerance=1e-9 /\n"
    "&spectrum /\n&event function='phi - 0.1*sin(0.1*t)' /\n&event function='z_dot' /\n",
    "spring alone": PENDULUM + "&transient initial=0.05 0 0 0 0 0, t_end=9, rtol=1e-9 /\n"
    "&event function='z', direction='down' /\n",
    "mount": MOUNT + "&transient t_end=20, nu=1.5, tolerance=1e-8 /\n&event function='x_dot' /\n",
    "mount that stops": MOUNT + "&transient t_end=20, nu=1.5, dt=0.1 /\n"
    "&event function='x - 0.2', terminal='yes' /\n",
    "mount, last": MOUNT + "&transient t_end=20, nu=1.5, dt=0.1, keep='last' /\n"
    "&event function='x - 0.2', terminal='yes' /\n",
    "structure": CHAIN + "&transient nu=0.9, t_end=20, tolerance=1e-9, coordinates='x3' /\n"
    "&spectrum coordinates='x2' discard=5 /\n&event function='x1 - x2' /\n"
    "&event function='x3_dot', direction='down' /\n",
    "thin": SYSTEM + "&transient initial=0.1 0 0 0.3, nu=1.3, t_end=30, dt=0.5 /\n"
    "&event function='exp(-((x - gap)/1e-5)^2) - 0.5' /\n"
    "&event function='max(tanh((y_dot - 0.1)/1e-4), sin(40*x))' /\n",
    "structure, thin": CHAIN + "&transient nu=0.9, t_end=20, dt=0.1 /\n"
    "&event function='1/(1 + ((x1 - 0.05)/1e-5)^2) - 0.5' /\n"
    "&event function='abs(x3 - 0.02) - 1e-4', direction='down' /\n",
    "structure that stops": CHAIN + "&transient nu=0.9, t_end=20, dt=0.1 /\n"
    "&event function='x1 - 0.1*x2 - 0.05*t', terminal='yes' /\n",
}


def test_states_end_before_an_event_that_ends_the_run(solve, tmp_path):
    """With memory, a state after the last event must not be written."""
    scene = tmp_path / "motion.nml"
    scene.write_text(SCENES["mount that stops"])
    done = solve(scene, "--out", tmp_path)
    assert "event at t = " in done.stdout
    table, event = (read_csv(tmp_path / f"motion_{kind}.csv") for kind in ("transient", "event"))
    run = vv.run(scene).trajectory
    assert run.t[-1] <= run.t_reached == pytest.approx(float(event["t"]), rel=1e-10)
    assert table["x"][-1] == pytest.approx(0.2, abs=0.05)
    assert run.state[-1, 0] == pytest.approx(0.2, abs=0.05)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("X - Gap", "z - gap", "function = 'z - gap': "),
        ("X - Gap", "2*gap", "depends on no quantity, must name x, x_dot, y, y_dot, t"),
        ("X - Gap", "x - (gap", "bad.nml:6: function = 'x - (gap': "),
        ("'up'", "'left'", "direction = 'left': must be one of 'any', 'up', 'down'"),
        ("'up'", "'up', terminal='maybe'", "terminal = 'maybe': must be one of 'no', 'yes'"),
        ("function='X", "funktion='X", "did you mean 'function'?"),
        ("k3 = 1", "k3 = 1, t = 2", "t: is what an &event names, must be another"),
        ("X - Gap", "x - gpa", "function = 'x - gpa': 'gpa' is neither a variable nor a parameter"),
        ("X - Gap", "x - gpa", "(did you mean gap?)"),
        ("&transient", "&response nu=1 /\n!", "&event: needs &transient"),
    ],
)
def test_what_is_refused(solve, tmp_path, old, new, text):
    check_refused(solve, tmp_path, SCENES["system"].replace(old, new, 1), text)


def test_a_function_too_fine_for_rounding_is_reported(solve, tmp_path):
    scene = tmp_path / "fine.nml"
    scene.write_text(
        "&system coordinates='x', mass=1, stiffness=1 /\n&event function='x - 0.3' /\n"
        "&event function='exp(-((x - 0.3)/1e-18)^2) - 0.5' /\n"
        "&transient initial=0 1, t_end=7, dt=0.1 /\n"
    )
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    reported = "; event 2 (exp(-((x - 0.3)/1e-18)^2) - 0.5, any) changes too fast in 3 steps"
    assert reported in done.stdout
    assert "event 1" not in done.stdout


def test_a_function_without_any_value_is_reported(solve, tmp_path):
    scene = tmp_path / "undefined.nml"
    scene.write_text(
        "&system coordinates='x', mass=1, stiffness=1 /\n&event function='x' /\n"
        "&event function='log(x - 2)' /\n&transient initial=1 0, t_end=5, dt=0.1 /\n"
    )
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "; event 2 (log(x - 2), any) has no value on the way" in done.stdout
    assert "event 1" not in done.stdout
