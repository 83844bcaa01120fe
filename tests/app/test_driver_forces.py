"""The standalone driver: tables of mount forces and of peaks of a motion in time."""

import os
from dataclasses import replace

import numpy as np
import pytest
import viscovib as vv
from driver import check_failure
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

DEBUG = "debug" in os.environ.get("VISCOVIB_SOLVE", "")
KERNELS = {
    "": "",
    "prony": "&kernel kind='prony' weights=0.3 0.6 rates=1 5 /\n",
    "steep": "&kernel kind='rzhanitsyn' amplitude=0.048 alpha=0.1 beta=0.05 /\n",
}
#: Laws along z, by the kind of geometry.
LAWS = {
    "small": ["0", "3e4*d^3 + 200*d^2", "40*tanh(3*d) + 0.5*v*abs(v)", "50*max(d - 0.01, 0)"],
    "exact": ["0", "3e4*d^3 + 200*d^2", "40*tanh(3*d)"],
}
PLACES = {"fl": (0.3, 0.2), "fr": (0.3, -0.2), "rl": (-0.3, 0.2), "rr": (-0.3, -0.2)}


def read_csv(path):
    """Columns by their names, which have dots; the quantities of a table of peaks are words."""
    rows = [line.split(",") for line in path.read_text().splitlines() if line[0] != "#"]
    columns = dict(zip(rows[0], zip(*rows[1:], strict=True), strict=True))
    return {
        name: np.array(column, dtype=str if name == "quantity" else float)
        for name, column in columns.items()
    }


def random_scene(seed):
    """A body of 8 kg under a force along (1, 2, 10), and its frequency."""
    rng = np.random.default_rng([71, seed])
    geometry = list(LAWS)[seed % 2]
    law = LAWS[geometry][seed // 2 % len(LAWS[geometry])]
    kernel = list(KERNELS)[seed % 3] if "max" not in law else ""
    feet = []
    for i, (name, (x, y)) in enumerate(list(PLACES.items())[: 3 + seed % 2]):
        keys = f"position={x} {y} -0.1 stiffness=200 200 400 damping=1 1 2 law_z='{law}'"
        keys += f" kernel={int(bool(kernel))}"
        angles = rng.uniform(-0.4, 0.4, 3).round(3)
        keys += " angles=" + " ".join(map(str, angles))
        if geometry == "small" or seed % 4 == 1:
            keys += " rotational_stiffness=3 0 2"
        if seed % 5 == 0 and i == 1:
            keys += " track=0.1 0.2 30 track_axis='z'"
        feet.append(f"&mount_point name='{name}' {keys} /\n")
    weight = "gravity=0 0 -9.81" if seed % 3 else ""
    n = 6 + (seed % 5 == 0)
    start = " ".join(map(str, rng.uniform(-0.01, 0.01, 2 * n).round(4)))
    return (
        f"{KERNELS[kernel]}&body mass=8 inertia=0.2 0.3 0.35 center=0.02 0.01 0.03 {weight} "
        f"geometry='{geometry}' load_axes='space' /\n{''.join(feet)}&load force=1 2 10 /\n"
        f"&transient nu=9 t_end=0.9 dt=0.015 initial={start} acceleration='yes' forces='yes' "
        "peaks='yes' point=0.1 -0.2 0.3 /\n"
    )


def tables_of(solve, folder, text):
    """The tables of the driver by their names."""
    scene = folder / "scene.nml"
    scene.write_text(text)
    done = solve(scene, "--out", folder)
    assert done.returncode == 0, done.stderr
    names = ("transient", "forces", "peaks")
    return {name: read_csv(folder / f"scene_{name}.csv") for name in names}


def check_same(columns, table):
    """The table of the driver is that of Python; of a debug build, up to rounding."""
    assert list(columns) == list(table)
    for name, column in columns.items():
        if not DEBUG or column.dtype.kind == "U":
            np.testing.assert_array_equal(column, table[name])
        # Rounding errors choose the time of a peak on a plateau.
        elif name != "error" and not (name == "t" and "quantity" in columns):
            size = np.abs(column).max()
            np.testing.assert_allclose(column, table[name], rtol=0, atol=1e-7 * size)


@pytest.mark.parametrize("seed", range(16))
def test_forces_of_random_bodies(solve, tmp_path, seed):
    """Driver, `vv.run` and Python agree, and all forces together accelerate the mass."""
    text = random_scene(seed)
    tables = tables_of(solve, tmp_path, text)
    forces, motion = tables["forces"], tables["transient"]
    result = vv.run(tmp_path / "scene.nml")
    for name, table in tables.items():
        other = getattr(result, "value" if name == "transient" else name).columns
        check_same(other, table)
    result.forces_to_csv(tmp_path / "forces.csv")
    result.peaks_to_csv(tmp_path / "peaks.csv")
    for name in ("forces", "peaks"):
        own = (tmp_path / f"{name}.csv").read_text().splitlines()
        driven = (tmp_path / f"scene_{name}.csv").read_text().splitlines()
        assert len(own) == len(driven)
        assert DEBUG or own[1:] == driven[1:]
    push = np.sin(9 * forces["t"])
    size = max(np.abs(forces[f"floor.{axis}"]).max() for axis in "xyz")
    for axis, load in zip("xyz", (1, 2, 10), strict=True):
        off = load * push - 8 * motion[f"{axis}_ddot"] - forces[f"floor.{axis}"]
        # What remembers v*abs(v) is not smooth.
        assert np.abs(off).max() < (1e-10 if "abs(v)" in text else 1e-11) * size

    body = result.scene.body()
    group = result.scene.groups["transient"]
    run = vv.simulate(body, 0.9, dt=0.015, nu=9.0, initial=group["initial"],
                      **result.scene.loads())  # fmt: skip
    own, floor = run.mount_forces(), run.floor_force()
    parts = {"": own.force, "_elastic": own.elastic, "_damping": own.damping,
             "_memory": own.memory, "_deflection": own.deflection, "_rate": own.rate,
             "_moment": own.moment, "_work": own.work,
             "_dissipated": own.dissipated}  # fmt: skip
    for end, part in parts.items():
        for i, name in enumerate(own.names):
            for j, axis in enumerate("xyz"):
                near = 1e-12 * max(np.abs(part).max(), np.abs(own.force).max() * (end != "_rate"))
                found = forces[f"{name}.{axis}{end}"]
                np.testing.assert_allclose(found, part[:, i, j], rtol=0, atol=near, err_msg=end)
    for j, axis in enumerate("xyz"):
        for end, part in (("", floor.force), ("_moment", floor.moment)):
            near = 1e-12 * np.abs(floor.force).max()
            found = forces[f"floor.{axis}{end}"]
            np.testing.assert_allclose(found, part[:, j], rtol=0, atol=near)
    for power, energy in ((own.force, "_work"), (own.damping, "_dissipated")):
        spline = CubicSpline(own.t, (power * own.rate)[:, 0, 2]).antiderivative()(own.t)
        np.testing.assert_allclose(forces[f"fl.z{energy}"], spline, atol=1e-12 * size)
    point = run.motion_of([0.1, -0.2, 0.3])
    place = body._arm("point", [0.1, -0.2, 0.3])
    turned = np.cross(run.state[:, 6:12:2], place)
    if body._turns:
        turned = Rotation.from_rotvec(run.state[:, 6:12:2]).apply(place) - place
    np.testing.assert_allclose(point.displacement, run.state[:, :6:2] + turned, atol=1e-15)
    for j, axis in enumerate("xyz"):
        for order, end in enumerate(("", "_dot", "_ddot")):
            own = (point.displacement, point.velocity, point.acceleration)[order][:, j]
            near = 1e-11 * np.abs(own).max()
            np.testing.assert_allclose(motion[f"point_{axis}{end}"], own, rtol=0, atol=near)
            if order < 2:
                rate = (point.velocity, point.acceleration)[order][:, j]
                slope = CubicSpline(run.t, own)(run.t, 1)
                assert np.abs(slope - rate)[3:-3].max() < 0.05 * np.abs(rate).max()
    peaks = tables["peaks"]
    names = [str(name) for name in peaks["quantity"]]
    assert names[-3:] == ["floor.x", "floor.y", "floor.z"]
    kept = [not name.startswith("point") for name in names]
    values, names = peaks["value"][kept], [n for n in names if not n.startswith("point")]
    for name, value, top in zip(names, values, run.peak(names), strict=True):
        assert value == pytest.approx(top.value, rel=1e-11, abs=1e-12 * size), name
        assert abs(value) >= np.abs((motion | forces)[name]).max()


SYSTEMS = {
    "pendulum": "&pendulum e=0.1 w2=0.4 w3=0.8 f0=0.02 p1=0.9 /\n"
    "&transient initial=0.05 0 0.3 0 -0.2 0 t_end=9 @ /\n",
    "mount": "&kernel kind='prony' weights=0.3 rates=1 /\n"
    "&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2 /\n"
    "&load on='x' amplitude=0.1 /\n&transient initial=0.05 0 0.3 0 t_end=9 nu=1.5 @ /\n",
    "system": "&system coordinates='x' 'y' mass=1 2 stiffness=2 -1 -1 2 damping=0.1 0 0 0.1 /\n"
    "&force on='x' law='0.5*sign(x_dot) + x^3' /\n&load on='x' amplitude=1.3 /\n"
    "&transient initial=0.3 0 0.1 0 t_end=5 nu=1.1 coordinates='y' @ /\n",
    "structure": "&structure mass=1 2 1 stiffness=2 -1 0 -1 2 -1 0 -1 2 damping=0.1 0.1 0.2 /\n"
    "&element on='x1' 'x2' stiffness=0.5 law='0.4*d^3' /\n&load on='x1' amplitude=0.8 /\n"
    "&transient t_end=5 nu=0.9 initial=0.1 0 0.2 0 0 0 coordinates='x1' 'x3' @ /\n",
    "shock": "&system coordinates='x' mass=2 stiffness=800 damping=1 /\n"
    "&load on='x' shape='half_sine' amplitude=30 duration=0.1 /\n"
    "&transient t_end=0.4 @ /\n",
}  # fmt: skip


@pytest.mark.parametrize("dt", ["", "dt=0.04"])
@pytest.mark.parametrize("kind", SYSTEMS)
def test_peaks_are_those_of_close_states(solve, tmp_path, kind, dt):
    """For states far apart too: the largest of many states around each peak."""
    text = SYSTEMS[kind]
    keys = f"{dt} peaks='yes' acceleration='yes'"
    scene = tmp_path / "scene.nml"
    scene.write_text(text.replace("@", keys))
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    peaks = read_csv(tmp_path / "scene_peaks.csv")
    result = vv.run(scene)
    check_same(result.peaks.columns, peaks)
    assert "largest magnitude" in repr(result)
    for name, value, at in zip(*(peaks[key] for key in ("quantity", "value", "t")), strict=True):
        h = 1e-3 * (9 if kind in ("pendulum", "mount") else 1)
        end = float(result.scene.groups["transient"]["t_end"])
        near = np.clip(at + h * np.linspace(-1, 1, 21), 1e-9, end)
        times = " ".join(f"{t:.17g}" for t in np.unique([*near, at]))
        scene.write_text(text.replace("@", f"{dt} times={times} acceleration='yes'"))
        done = solve(scene, "--out", tmp_path)
        assert done.returncode == 0, done.stderr
        close = read_csv(tmp_path / "scene_transient.csv")[name]
        size = np.abs(peaks["value"]).max()
        assert np.abs(close).max() == pytest.approx(abs(value), abs=1e-8 * size)


ENSEMBLES = {
    "pendulum": ("&pendulum e=0.1 w2=0.4 w3=0.8 f0=0.02 p1=0.9 /\n", "p1", ""),
    "system": (
        "&system coordinates='x' 'y' mass=1 2 stiffness=2 -1 -1 2 damping=0.1 0 0 0.1 /\n"
        "&force on='x' law='0.7*x^3' /\n&load on='x' amplitude=1.3 /\n",
        "load_scale", "nu=1.1",
    ),
    "memory": (
        "&kernel kind='prony' weights=0.3 rates=1 /\n&load on='x' amplitude=0.4 /\n"
        "&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2 /\n",
        "nu", "",
    ),
    "body": (
        "&body mass=8 inertia=0.2 0.3 0.35 gravity=0 0 -9.81 geometry='exact' /\n"
        + "".join(f"&mount_point name='{name}' position={x} {y} -0.1 stiffness=200 200 400 "
                  "damping=1 1 2 law_z='3e4*d^3' /\n" for name, (x, y) in PLACES.items())
        + "&load on='z' amplitude=20 /\n",
        "load_scale", "nu=9 forces='yes'",
    ),
}  # fmt: skip


@pytest.mark.parametrize("steps", ["dt=0.02", ""])
@pytest.mark.parametrize("name", ENSEMBLES)
def test_peaks_of_ensembles(solve, tmp_path, name, steps):
    """They are those of single motions from Python, from `discard` on."""
    head, vary, keys = ENSEMBLES[name]
    n = {"pendulum": 3, "body": 6}.get(name, 2)
    start = [0.01 * (i % 3) for i in range(2 * n)]
    scene = tmp_path / "scene.nml"
    scene.write_text(
        f"{head}&ensemble vary='{vary}' from=0.8 to=1.2 count=3 t_end=2 discard=0.3 {keys} {steps} "
        f"initial={' '.join(map(str, start))} peaks='yes' acceleration='yes' /\n"
    )
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    peaks = read_csv(tmp_path / "scene_peaks.csv")
    result = vv.run(scene)
    check_same(result.peaks.columns, peaks)
    for i, value in enumerate(np.linspace(0.8, 1.2, 3).tolist()):
        mine = np.isclose(peaks[vary], value)
        names = [str(one) for one in peaks["quantity"][mine]]
        nu = {"pendulum": "", "system": "nu=1.1", "body": "nu=9"}.get(name, f"nu={value!r}")
        text = head.replace("p1=0.9", f"p1={value!r}")
        if vary == "load_scale":
            size = 1.3 if name == "system" else 20
            text = text.replace(f"amplitude={size}", f"amplitude={size * value!r}")
        scene.write_text(
            f"{text}&transient {nu} t_end=2 {steps or 'tolerance=1e-10'} "
            f"initial={' '.join(map(str, start))} /\n"
        )
        one = vv.Scene.read(scene)
        if name == "body":
            run = vv.simulate(one.body(), 2, initial=start, nu=9.0, dt=0.02 if steps else "auto",
                              **one.loads())  # fmt: skip
        else:
            run = vv.simulate(**one._motion())
        late = np.append(0.3, run.t[run.t > 0.3])
        tops = replace(run, t=late, state=run(late)).peak(names)
        for quantity, value_found, top in zip(names, peaks["value"][mine], tops, strict=True):
            near = 1e-9 if steps else 1e-6
            size = max(abs(top.value), 1e-3)
            assert value_found == pytest.approx(top.value, abs=near * size), (quantity, i)


def test_requests_that_are_refused(solve, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    scene = tmp_path / "scene.nml"
    cases = {
        "peaks='yes' keep='last'": "peaks = 'yes': needs the states all along",
        "forces='yes'": "forces",
        "peaks='maybe'": "peaks = 'maybe': must be one of 'no', 'yes'",
    }
    for keys, reported in cases.items():
        scene.write_text(SYSTEMS["pendulum"].replace("@", keys))
        check_failure(solve(scene, "--out", out), 2, reported, out)
