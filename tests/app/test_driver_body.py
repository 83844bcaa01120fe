"""Bodies in scenes: the driver against Python, and refused scenes."""

import os

import numpy as np
import pytest
import viscovib as vv
from driver import check_refused
from scene_texts import columns_of
from viscovib.bodies.varying_body import _changed, rebuilt

MASSES = (
    "mass=163.9 inertia=9.91 -0.813 -0.472 -0.813 4.12 1.34 -0.472 1.34 9.09 center=0.01 0.02 -0.03"
)
KERNELS = (
    "&kernel kind='rzhanitsyn' amplitude=0.6 alpha=0.4 beta=20 /\n"
    "&kernel kind='prony' weights=0.3 rates=4 /\n"
)
MOUNTS = """&mount_point name='Left' position=-0.066 0.463 0.156 stiffness=349e3 370e3 453e3
  angles=0.2 -0.3 1.57 law_z='1E10*D^3 + 1e8*d^2' law_x='1e5*sinh(d/0.1)' damping=100 20 30
  rotational_stiffness=100 0 300 track=20 300 1e5 track_axis='y' /
&mount_point name='right' position=-0.004 -0.456 0.101 stiffness=141e3 57e3 367e3 kernel=2
  law_z='1e10*d^3' /
&mount_point name='rear' position=0.25 -0.045 -0.2 stiffness=640e3 450e3 225e3 kernels=0 1 2
  angles=0 -0.17 0 law_y='2e8*d^2' /
"""
LOADS = (
    "&load on='ry' amplitude=200 /\n&load on='left_y' amplitude=20 order=2 phase=0.3 /\n"
    "&load on='z' amplitude=150 order=0 /\n"
)


def body(options="", loads=LOADS):
    return f"&body {MASSES} {options} /\n" + KERNELS + MOUNTS + loads


def run_both(solve, folder, text, kind):
    """The tables of driver and Python, equal byte by byte if both use one build."""
    path = folder / "body.nml"
    path.write_text(text)
    done = solve(path, "--out", folder / "out")
    assert done.returncode == 0, done.stderr
    result = vv.run(path)
    result.to_csv(folder / "same.csv")
    if "debug" in os.environ.get("VISCOVIB_SOLVE", ""):
        return result
    table = (folder / "out" / f"body_{kind}.csv").read_bytes()
    assert table == (folder / "same.csv").read_bytes()
    return result


@pytest.mark.parametrize(("geometry", "gravity"), [("small", ""), ("exact", "gravity=2 1 -9.81")])
def test_as_python_builds_it(solve, tmp_path, geometry, gravity):
    """Kernels, laws, dampers, rotational springs, a track and gravity, built by two programs."""
    what = "&response nu=30 80 method='newton' harmonics=5 tolerance=5e-2 /\n"
    options = f"geometry='{geometry}' {gravity}"
    result = run_both(solve, tmp_path, body(options) + what, "response")
    system, loads = result.scene.body(), result.scene.loads()
    found = vv.forced_response(
        system, [30.0, 80.0], **loads, method="newton", harmonics=5, tolerance=5e-2
    )
    columns = columns_of(result)
    table = np.array([
        [columns[f"{name}_{k}_re"] + 1j * columns[f"{name}_{k}_im"] for k in found.harmonics]
        for name in system.dof_names
    ])  # fmt: skip
    assert np.isfinite(table).all()
    size = np.abs(table).max()
    np.testing.assert_allclose(table, found.coefficients.transpose(1, 2, 0), atol=1e-9 * size)
    if gravity:
        # A progressive law with preload causes a mean and even harmonics.
        assert np.abs(columns["z_2_re"]).max() > 1e-6
    modes = run_both(solve, tmp_path, body(options, "") + "&modes /\n", "modes")
    undamped = system.modes(stiffness="instantaneous")
    np.testing.assert_allclose(columns_of(modes)["frequency"], undamped.hz, rtol=1e-10)


def test_in_time_on_a_moving_floor(solve, tmp_path):
    options = "geometry='exact' load_axes='space' base_direction=0 0 1 0 0 0"
    loads = LOADS + "&load kind='base' amplitude=0.001 /\n"
    what = "&transient t_end=0.2 nu=80 tolerance=1e-8 /\n"
    result = run_both(solve, tmp_path, body(options, loads) + what, "transient")
    scene = result.scene
    found = vv.simulate(scene.body(), 0.2, nu=80.0, **scene.loads(), dt="auto", tolerance=1e-8)
    columns = columns_of(result)
    for d, name in enumerate(found.dof_names):
        end = np.abs(found.state[-1, 2 * d] - columns[name][-1])
        assert end < 1e-8, name


def test_parts_that_spin(solve, tmp_path):
    """The same bytes as Python; the response of (K + i w (C - [h]x) - w^2 M) u = F by NumPy."""
    spin = (3.0, -20.0, 7.0)
    options = f"spin={' '.join(map(str, spin))}"
    what = "&response nu=30 80 method='linear' harmonics=1 /\n"
    scene = f"&body {MASSES} {options} /\n" + "".join(
        f"&mount_point name='{name}' position={place} stiffness=3e5 4e5 5e5 damping=100 20 30 /\n"
        for name, place in (("a", "0.1 0.4 0.1"), ("b", "0 -0.4 0.1"), ("c", "0.3 0 -0.2"))
    )  # fmt: skip
    scene += "&load on='ry' amplitude=200 /\n"
    run = run_both(solve, tmp_path, scene + what, "response")
    columns = columns_of(run)
    body_here = run.scene.body()
    plain = vv.Body(
        mass=body_here.body_mass, inertia=body_here.inertia, center=body_here.center,
        mounts=body_here.mounts,
    )  # fmt: skip
    h1, h2, h3 = spin
    cross = np.array([[0, -h3, h2], [h3, 0, -h1], [-h2, h1, 0]])
    for i, nu in enumerate((30.0, 80.0)):
        matrix = plain.dynamic_stiffness(nu).astype(complex)
        matrix[3:, 3:] -= 1j * nu * cross
        expected = np.linalg.solve(matrix, [0, 0, 0, 0, 200, 0])
        table = [
            columns[f"{name}_1_re"][i] + 1j * columns[f"{name}_1_im"][i]
            for name in body_here.dof_names
        ]
        np.testing.assert_allclose(table, expected, atol=1e-12 * np.abs(expected).max())


FLOOR = """&load kind='base' on='x' amplitude=3e-4 phase=0.5 /
&load kind='base' on='rx' amplitude=5e-4 phase=-1 /
&load kind='base' on='rz' order=2 amplitude=3e-4 /
"""


def test_a_floor_that_moves_in_components(solve, tmp_path):
    """Components with different phases, a weight and a rotor: against a Python body."""
    options = "gravity=0 0 -9.81 spin=3 -20 7 base_direction=0 0 3e-4 0 0 0"
    text = body(options, FLOOR + "&load kind='base' amplitude=1 /\n")
    text += "&response nu=40 80 method='newton' harmonics=7 tolerance=0.1 /\n"
    result = run_both(solve, tmp_path, text, "response")
    columns, scene = columns_of(result), result.scene
    system, loads = scene.body(), scene.loads()
    assert sorted(loads["base"]) == [1, 2]
    found = vv.forced_response(
        system, [40.0, 80.0], **loads, harmonics=7, tolerance=0.1, method="newton"
    )
    for d, name in enumerate(found.dof_names):
        for j, k in enumerate(found.harmonics):
            table = columns[f"{name}_{k}_re"] + 1j * columns[f"{name}_{k}_im"]
            far = 1e-9 * np.abs(found.coefficients[:, d]).max()
            np.testing.assert_allclose(table, found.coefficients[:, d, j], atol=far)


def test_a_force_in_any_direction_at_a_point(solve, tmp_path):
    """And a torque, about a position rotated by the weight: the same as Body.load."""
    loads = (
        "&load force=30 -20 50 at=0.2 0.1 -0.3 phase=0.4 /\n"
        "&load torque=1 2 3 force=4 5 6 order=2 amplitude=2 /\n"
    )
    what = "&response nu=30 80 method='newton' harmonics=5 tolerance=5e-2 /\n"
    result = run_both(
        solve, tmp_path, body("geometry='exact' gravity=2 1 -9.81", loads) + what, "response"
    )
    system = result.scene.body()
    given = result.scene.loads()
    one = system.load((30, -20, 50), at=(0.2, 0.1, -0.3)) * np.exp(0.4j)
    np.testing.assert_allclose(given["load"][1], one, rtol=1e-14)
    two = 2 * system.load((4, 5, 6), (1, 2, 3))
    np.testing.assert_allclose(given["load"][2], two, rtol=1e-14)
    found = vv.forced_response(
        system, [30.0, 80.0], **given, method="newton", harmonics=5, tolerance=5e-2
    )
    columns = columns_of(result)
    for d, name in enumerate(found.dof_names):
        table = columns[f"{name}_1_re"] + 1j * columns[f"{name}_1_im"]
        own = found.coefficients[:, d, list(found.harmonics).index(1)]
        np.testing.assert_allclose(table, own, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "ends"),
    [
        ("inertia_scale", (0.9, 1.1)),
        ("mounts[rear].stiffness[z]", (2e5, 3e5)),
        ("mounts[right].position[x]", (-0.1, 0.1)),
    ],
)
def test_a_number_that_varies(solve, tmp_path, name, ends):
    """Ends of a branch are motions of Python bodies with that number."""
    load = "&load on='ry' amplitude=10 /\n"
    more = "" if "position" in name or "center" in name else "gravity=0 0 -9.81"
    what = (
        f"&branch vary='{name}' from={ends[0]} to={ends[1]} nu=110 harmonics=3 tolerance=0.1\n"
        "  stability='no' /\n"
    )
    result = run_both(solve, tmp_path, body(more, load) + what, "branch")
    columns, scene = columns_of(result), result.scene
    system = scene.body()
    np.testing.assert_allclose(columns[name][[0, -1]], ends, rtol=1e-9)
    for row, p in ((0, ends[0]), (-1, ends[1])):
        changed = rebuilt(system, **_changed(system, name)(float(p)))
        x = vv.forced_response(
            changed, [110.0], **scene.loads(), harmonics=3, method="newton", tolerance=0.1
        )
        j = list(x.harmonics).index(1)
        for d, dof in enumerate(x.dof_names):
            reported = columns[f"{dof}_1_re"][row] + 1j * columns[f"{dof}_1_im"][row]
            assert abs(reported - x.coefficients[0, d, j]) < 1e-6 * np.abs(x.coefficients).max()


def test_sweep_over_a_mount(tmp_path):
    path = tmp_path / "swept.nml"
    path.write_text(
        body(loads="") + "&modes /\n&sweep key='mount_point(2).stiffness(3)' values=3e5 4e5 5e5 /\n"
    )
    found = vv.run(path).sweep
    assert found["mount_point(2).stiffness(3)"].attrs["units"] == "N/m"
    values = []
    for k in (3e5, 4e5, 5e5):
        scene = vv.Scene.read(path).override({"mount_point(2).stiffness(3)": k})
        values.append(scene.body().modes(stiffness="instantaneous").hz[0])
    np.testing.assert_allclose(found["frequency"].values, values, rtol=1e-12)


WANTED = "&modes /\n"


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        (f"&body {MASSES} / {WANTED}", "needs &mount_point"),
        (f"&body {MASSES} spin=3 -20 7 / {KERNELS} {MOUNTS} {WANTED}", "must be 0 for &modes"),
        (f"&body mass=1 inertia=1 1 3 / {MOUNTS} {WANTED}", "larger than the sum of the other two"),
        (f"&body mass=1 inertia=1 1 -1 / {MOUNTS} {WANTED}", "principal moments -1"),
        (f"&body mass=0 inertia=1 1 1 / {MOUNTS} {WANTED}", "mass = 0: must be greater than 0"),
        (f"&body {MASSES} / {KERNELS} {MOUNTS} {MOUNTS} {WANTED}", "'Left': is given twice"),
        (
            f"&body {MASSES} / &mount_point name='a' position=0 0 0 stiffness=0 0 0 / {WANTED}",
            "stiffness = 0 0 0: must not be 0 in every direction",
        ),
        (
            f"&body {MASSES} / &mount_point name='a' position=0 0 stiffness=1 0 0 / {WANTED}",
            "position has 2 values: must be 3",
        ),
        (
            f"&body {MASSES} / &mount_point name='a' position=0 0 0 stiffness=1 1 1 "
            "law_x='log(d)' /" + WANTED,
            "must have a value at d = 0",
        ),
        (
            f"&body {MASSES} / &mount_point name='a' position=0 0 0 stiffness=1 1 1 "
            f"law_x='d*log(abs(d))' / {WANTED}",
            "must have a finite derivative at d = 0",
        ),
        (
            f"&body {MASSES} geometry='exact' / &mount_point name='a' position=0 0 0 "
            f"stiffness=1 1 1 law_x='v*abs(v)' / {WANTED}",
            "must not depend on the rate v",
        ),
        (
            f"&body {MASSES} gravity=0 0 -10 / &mount_point name='a' position=0 0 0 "
            f"stiffness=1 0 0 / {WANTED}",
            "no mount supports the weight",
        ),
        (
            f"&body {MASSES} gravity=0 0 -10 / &kernel kind='prony' weights=2 rates=1 / "
            f"&mount_point name='a' position=0 0 0 stiffness=1 1 1 / {WANTED}",
            "integral of a kernel is 2, must be below 1",
        ),
        (
            body("geometry='exact'") + "&backbone from=0.001 to=0.01 /",
            "must be 'small'",
        ),
        (body(loads="&load force=1 2 3 on='x' /") + WANTED, "say where it acts"),
        (body(loads="&load force=1 2 /") + WANTED, "has 2 values: must be 3"),
        (body(loads="&load at=1 2 3 amplitude=1 /") + WANTED, "at: needs force"),
        (body(loads="&load kind='base' amplitude=1 /") + WANTED, "or on = the coordinate"),
        (body(loads="&load kind='base' on='w' amplitude=1 /") + WANTED, "on = 'w'"),
        (body(loads="&load kind='base' at=1 2 3 amplitude=1 /") + WANTED, "only a force has"),
        (
            body("geometry='exact' load_axes='space'", "&load kind='base' on='rx' amplitude=1 /")
            + WANTED,
            "must not turn the floor",
        ),
        (
            body("geometry='exact'", "&load kind='base' on='x' amplitude=1 /") + WANTED,
            "must be 'space' where the floor",
        ),
        (
            body("geometry='exact' load_axes='space'", "&load force=0 0 1 at=1 0 0 /") + WANTED,
            "must be the centre of mass",
        ),
        (
            body() + "&branch vary='mounts[q].stiffness[z]' from=1 to=2 nu=9 /",
            "a number of a mount",
        ),
        (body() + "&branch vary='mounts[left].law' from=1 to=2 nu=9 /", "a number of a mount"),
        (body() + "&branch vary='mass' from=-1 to=2 nu=9 /", "mass and inertia must be greater"),
        (
            body() + "&branch vary='mounts[left].stiffness[x]' from=1 to=-2 nu=9 /",
            "must not be less than 0, got -2",
        ),
        (
            body("geometry='exact'") + "&branch vary='mass' from=1 to=2 nu=9 /",
            "vary = 'mass': must",
        ),
        (f"&mount_point name='a' position=0 0 0 stiffness=1 1 1 / {WANTED}", "needs &body"),
        (
            f"&mount mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2 / "
            f"&body {MASSES} / {WANTED}",
            "give one of them",
        ),
    ],
)
def test_refused(solve, tmp_path, text, reported):
    """One line with the name and its location."""
    check_refused(solve, tmp_path, text, reported)


def test_millimetres_are_reported(solve, tmp_path):
    path = tmp_path / "far.nml"
    path.write_text(
        "&body mass=1 inertia=1 1 1 / "
        f"&mount_point name='a' position=300 0 0 stiffness=1 1 1 / {WANTED}"
    )
    assert "positions are in m" in solve(path, "--out", tmp_path / "out").stderr
