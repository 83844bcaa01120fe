"""Coordinates without mass in scenes: condensed manually, by SciPy and by Python."""

import os

import numpy as np
import pytest
import viscovib as vv
from driver import changed, check_failure, check_refused, read_csv, silence
from referee.integration import solve_ivp

# A chain 0-a-1-b-2-c-0 whose second mass is zero: the springs a and b act in series.
CHAIN = """&structure size=3 mass=1 0 2 stiffness=5 -3 0 -3 5.5 -2.5 0 -2.5 4 damping={} {} /
{}&element on='x1' law='0.7*d^3' /
&element on='x1' 'x2' stiffness=1.5 {}/
&load on='x3' amplitude=0.4 /
"""
WHOLE = np.array([[6.5, -4.5, 0], [-4.5, 7.0, -2.5], [0, -2.5, 4.0]])
KEPT = [0, 2]
LEFT = WHOLE[np.ix_(KEPT, KEPT)] - np.outer(WHOLE[KEPT, 1], WHOLE[1, KEPT]) / WHOLE[1, 1]
FOLLOW = -WHOLE[1, KEPT] / WHOLE[1, 1]


def _scene(more, damping="0.1 0 0.2", keys="", kernels=""):
    own = "kernel=0 " if kernels else ""
    return CHAIN.format(damping, keys, kernels, own) + more


def _table(solve, folder, text, kind):
    """The table of the driver, equal to that of Python."""
    (folder / "scene.nml").write_text(text)
    done = solve(folder / "scene.nml", "--out", folder)
    assert done.returncode == 0, done
    path = folder / f"scene_{kind}.csv"
    with silence():
        vv.run(folder / "scene.nml").to_csv(folder / "mine.csv")
    if "debug" not in os.environ.get("VISCOVIB_SOLVE", ""):
        assert path.read_bytes() == (folder / "mine.csv").read_bytes()
    return read_csv(path)


def test_modes(solve, tmp_path):
    rows = _table(solve, tmp_path, _scene("&modes /\n"), "modes")
    squares = np.linalg.eigvals(LEFT / np.array([[1.0], [2.0]]))
    np.testing.assert_allclose(rows["omega"], np.sqrt(np.sort(squares)), rtol=1e-12)
    follows = FOLLOW @ [rows["x1"], rows["x3"]]
    np.testing.assert_allclose(rows["x2"], follows, atol=1e-12)


@pytest.mark.parametrize(
    ("method", "damping", "keys"),
    [("newton", "0 0 0", "modal_damping=0.02"), ("linear", "0.1 0 0.2", "")],
)
def test_response(solve, tmp_path, method, damping, keys):
    """Automatic condensation in Python; the linear response with the full matrices."""
    ask = f"&response nu=0.5 1.3 2.2 method='{method}' harmonics=7 /\n"
    kernels = "&kernel kind='rabotnov' amplitude=0.2 alpha=0.6 beta=0.8 /\n"
    rows = _table(solve, tmp_path, _scene(ask, damping, keys, kernels), "response")
    scene = vv.Scene.read(tmp_path / "scene.nml")
    own = vv.forced_response(
        scene.structure(), [0.5, 1.3, 2.2], method=method, harmonics=7, **scene.loads()
    )
    for d in range(3):
        for j, k in enumerate(own.harmonics):
            reported = rows[f"x{d + 1}_{k}_re"] + 1j * rows[f"x{d + 1}_{k}_im"]
            np.testing.assert_allclose(reported, own.coefficients[:, d, j], rtol=1e-8, atol=1e-12)
    if method == "linear" and not keys:
        for i, nu in enumerate([0.5, 1.3, 2.2]):
            matrix = WHOLE - nu**2 * np.diag([1, 0, 2]) + 1j * nu * np.diag([0.1, 0, 0.2])
            u = np.linalg.solve(matrix, [0, 0, 0.4])
            reported = [rows[f"x{d}_1_re"][i] + 1j * rows[f"x{d}_1_im"][i] for d in (1, 2, 3)]
            np.testing.assert_allclose(reported, u, rtol=1e-10)


def test_motion(solve, tmp_path):
    """At any position it follows the other masses from the first state; an event detects it."""
    ask = "&transient t_end=8 nu=1.1 initial=0.5 0 0.9 0 -0.2 0.3 /\n&event function='x2' /\n"
    rows = _table(solve, tmp_path, _scene(ask), "transient")
    inverse, c = np.array([1.0, 0.5]), np.array([0.1, 0.2])

    def rates(t, y):
        u, v = y[:2], y[2:]
        load = np.array([-0.7 * u[0] ** 3, 0.4 * np.sin(1.1 * t)])
        return np.concatenate([v, inverse * (load - c * v - LEFT @ u)])

    run = solve_ivp(
        rates, (0, 8), [0.5, -0.2, 0, 0.3], "DOP853", rtol=1e-12, atol=1e-13, dense_output=True
    )
    y = run.sol(np.minimum(rows["t"], 8))
    for name, true in (
        ("x1", y[0]),
        ("x3", y[1]),
        ("x2", FOLLOW @ y[:2]),
        ("x2_dot", FOLLOW @ y[2:]),
    ):
        np.testing.assert_allclose(rows[name], true, atol=2e-9)
    events = np.atleast_1d(read_csv(tmp_path / "scene_event.csv"))
    assert events.size > 2
    np.testing.assert_allclose(FOLLOW @ run.sol(events["t"])[:2], 0, atol=1e-8)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("mass=1 0 2", "mass=0 0 0", ":1: mass: must not be 0 everywhere"),
        ("mass=1 0 2", "mass=1 0 -2", ":1: mass: must be symmetric and positive definite, but for"),
        ("mass=1 0 2", "mass=1 0 0 0 0 0.1 0 0 2", ":1: mass: must be symmetric and positive"),
        ("damping=0.1 0 0.2", "damping=0.1 0.1 0.2", "coordinate 2 has no mass, and must not have"),
        ("stiffness=1.5", "damping=1.5", ":1: damping: coordinate 2 has no mass, and must not"),
        ("damping=0.1 0 0.2", "rayleigh=0 0.1", ":1: rayleigh: its factor of the stiffness damps"),
        ("damping=0.1 0 0.2", "loss_factor=0.1", ":1: loss_factor: it damps coordinate 2"),
        ("on='x1' law", "on='x2' law", "&element: a law or a kernel acts on coordinate 2, which"),
        ("&load on='x3'", "&load on='x2'", "&load: it acts on coordinate 2, which has no mass"),
        ("5.5 -2.5", "-1.5 -2.5", "a coordinate has neither mass nor stiffness"),
        ("damping=0.1 0 0.2", "modal_damping=0.1 0.1 0.1", "modal_damping has 3 values: must be"),
    ],
)
def test_what_is_refused(solve, tmp_path, old, new, text):
    check_refused(solve, tmp_path, changed(_scene("&modes /\n"), {old: new}), text)


@pytest.mark.parametrize(
    "numbers", ["mass=1 1 stiffness=1d32 -1 -1 2", "mass=1d24 1 stiffness=1 0 0 2"]
)
def test_supports_by_huge_numbers_are_refused(solve, tmp_path, numbers):
    scene = tmp_path / "scene.nml"
    scene.write_text(
        f"&structure size=2 {numbers} /\n&load on='x2' amplitude=1 /\n&response nu=0.5 /\n"
    )
    (tmp_path / "out").mkdir()
    done = solve(scene, "--out", tmp_path / "out")
    check_failure(
        done, done.returncode, "for a support remove its row and column", tmp_path / "out"
    )
