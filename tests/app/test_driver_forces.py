"""The standalone driver: tables of mount forces and of peaks of a motion in time."""

import numpy as np
import pytest
import viscovib as vv
from driver import check_refused
from scipy.interpolate import CubicSpline

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


@pytest.mark.parametrize("seed", [0, 1, 3, 5, 10])
def test_forces_of_random_bodies(solve, tmp_path, seed):
    """Driver and Python agree, and all forces together accelerate the mass."""
    text = random_scene(seed)
    tables = tables_of(solve, tmp_path, text)
    forces, motion = tables["forces"], tables["transient"]
    push = np.sin(9 * forces["t"])
    size = max(np.abs(forces[f"floor.{axis}"]).max() for axis in "xyz")
    for axis, load in zip("xyz", (1, 2, 10), strict=True):
        off = load * push - 8 * motion[f"{axis}_ddot"] - forces[f"floor.{axis}"]
        # What remembers v*abs(v) is not smooth.
        assert np.abs(off).max() < (1e-10 if "abs(v)" in text else 1e-11) * size

    scene = vv.Scene.read(tmp_path / "scene.nml")
    body = scene.body()
    group = scene.groups["transient"]
    run = vv.simulate(body, 0.9, dt=0.015, nu=9.0, initial=group["initial"],
                      **scene.loads())  # fmt: skip
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
    peaks = tables["peaks"]
    names = [str(name) for name in peaks["quantity"]]
    assert names[-3:] == ["floor.x", "floor.y", "floor.z"]
    kept = [not name.startswith("point") for name in names]
    values, names = peaks["value"][kept], [n for n in names if not n.startswith("point")]
    for name, value, top in zip(names, values, run.peak(names), strict=True):
        assert value == pytest.approx(top.value, rel=1e-11, abs=1e-12 * size), name
        assert abs(value) >= np.abs((motion | forces)[name]).max()


PENDULUM = (
    "&pendulum e=0.1 w2=0.4 w3=0.8 f0=0.02 p1=0.9 /\n"
    "&transient initial=0.05 0 0.3 0 -0.2 0 t_end=9 {} /\n"
)


def test_requests_that_are_refused(solve, tmp_path):
    for keys, reported in (
        ("peaks='yes' keep='last'", "peaks = 'yes': needs the states all along"),
        ("forces='yes'", "forces"),
        ("peaks='maybe'", "peaks = 'maybe': must be one of 'no', 'yes'"),
    ):
        check_refused(solve, tmp_path, PENDULUM.format(keys), reported)
    plain = "&structure mass=1 2 stiffness=2 -1 -1 2 size=2"
    slider = "hysteresis='jenkins' hysteresis_numbers=2 0.1"
    for head, reported in (
        (f"{plain} /\n", "forces = 'yes': needs an &element or supports"),
        (f"{plain} loss_factor=0.1 /\n&element on='x1' {slider} /\n",
         "hysteresis: a motion in time needs"),
    ):  # fmt: skip
        check_refused(
            solve, tmp_path, f"{head}&transient t_end=1 dt=0.1 forces='yes' /\n", reported
        )
