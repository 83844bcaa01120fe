"""Sweeps: each point computed alone; units of scene keys from the guide."""

import numpy as np

from referee.case import Case, Claim, even, few

JUDGES = ("sweep", "SweepError")


def _function(rng, index):
    a = [even(rng, 0.5, 2, 3) for _ in range(int(rng.integers(3, 5)))]
    b = [few(rng, 0.01, 0.2, 2) for _ in range(int(rng.integers(1, 4)))]
    a, b = sorted(set(a)), sorted(set(b))
    fail = index % 3 == 0
    vectorized = index % 3 == 1
    call = f"""
def point(stiffness, damping):
    if {fail} and np.all(stiffness == {a[-1]}):
        raise ValueError("no such spring")
    return {{"pole": stiffness - damping**2 / 4, "list": np.stack([stiffness, damping * np.ones_like(stiffness)], axis=-1)}}

grid = {{"stiffness": {a}, "damping": {b}}}
data = vv.sweep(point, grid, progress=False, errors="keep", vectorized={vectorized}, chunk=2, n_threads=2)
pole, pair = data["pole"].values, data["list"].values
outcome = data["point_outcome"].values.astype(str)
try:
    vv.sweep(point, grid, progress=False, n_threads=1)
    raised = False
except vv.SweepError as error:
    raised = error.point["stiffness"] == {a[-1]}
"""

    def judge(names, reported):
        x, y = np.meshgrid(a, b, indexing="ij")
        good = np.ones(x.shape, bool)
        if fail:
            good[-1] = False
        true = x - y**2 / 4
        if not vectorized:
            yield Claim("failed points hold no number", np.isfinite(names["pole"]), good)
            yield Claim("outcomes", names["outcome"] == "completed", good)
            yield Claim("values", names["pole"][good], true[good], 1e-15)
            yield Claim("arrays", names["pair"][good], np.stack([x, y], -1)[good], 1e-15)
            yield Claim("a failure names its point", bool(names["raised"]), fail)
        else:
            yield Claim("vectorized values", names["pole"], true, 1e-15)

    return Case(call, judge)


_MOUNT = (
    "&mount mass = 1, inertia = 0.1, offset = 0.5, stiffness_x = 10, stiffness_phi = 2, "
    "damping = 0.1 0 0 0.02 /\n"
)
_TWO = (
    "&system coordinates = 'a', 'b', units = 'm', 'rad', mass = 1, 1, stiffness = 2, -1, -1, 2, "
    "damping = 0.1, 0, 0, 0.1 /\n"
)
_UNITS = (
    # System, analysis, key, values of the key, unit.
    (_MOUNT, "&transient t_end = 5, dt = 0.5, nu = 1.5 /", "transient.t_end", [4, 5], "s"),
    (_MOUNT, "&transient t_end = 5, dt = 0.5, nu = 1.5 /", "transient.dt", [0.25, 0.5], "s"),
    (_MOUNT, "&response nu = 1, 2, method = 'linear' /", "mount.mass", [1, 2], "kg"),
    (_MOUNT, "&response nu = 1, 2, method = 'linear' /", "load.amplitude", [0.1, 0.2], "N"),
    (_TWO, "&response nu = 1, 2, method = 'linear' /", "load.amplitude", [0.1, 0.2], "N"),
    (
        _TWO,
        "&transient initial = 0 0 0 0, t_end = 5, dt = 0.5, nu = 1.5 /",
        "transient.t_end",
        [4, 5],
        "s",
    ),
    ("", "", "transient.t_end", [4, 5], "1/omega_1"),
)


def _units(rng, index):
    system, job, key, values, unit = _UNITS[index % len(_UNITS)]
    on = "x" if "mount" in system else "a"
    if index % len(_UNITS) == 4 and index % 2:
        on = "b"
    amplitude = few(rng, 0.05, 0.5, 2)
    text = f"{system}&load on = '{on}', amplitude = {amplitude} /\n{job}\n"
    if not system:
        text = f"&pendulum e = 0.1, w2 = 0.4, w3 = 0.8, f0 = {amplitude / 50} , p1 = 0.9 /\n&transient initial = 0 0 0.1 0 0 0, t_end = 5, dt = 0.5 /\n"
    call = f"""import pathlib, shutil, tempfile
folder = pathlib.Path(tempfile.mkdtemp())
path = folder / "scene.nml"
path.write_text({text!r})
data = vv.sweep(path, {{{key!r}: {values}}}, progress=False, extract="summary")
unit = data[{key!r}].attrs.get("units", "")
name = sorted(str(x) for x in data.data_vars if str(x).startswith(("peak_", "max_")))[0]
got = data[name].values
scene = vv.Scene.read(path)
true = []
for value in {values}:
    result = vv.run(scene.override({{{key!r}: value}})).value
    dof = name.partition("_")[2]
    true.append(result.peak(dof).amplitude if name[:4] == "peak" else abs(result.coordinate(dof)[result.t >= result.t_reached / 2]).max())
shutil.rmtree(folder)
"""

    def judge(names, reported):
        expected = unit
        if key == "load.amplitude" and on == "b":
            expected = "N m"
        # A moment acts on an angle, a force on a length; otherwise the unit is unknown.
        allowed = {expected, ""} if key == "load.amplitude" and "system" in system else {expected}
        reported = names["unit"]
        yield Claim("unit of a key", reported, reported if reported in allowed else expected)
        yield Claim("value of a sweep", names["got"], np.array(names["true"]), 1e-14, damage=1e-3)

    return Case(call, judge)


def case(rng, index):
    """Draw a grid."""
    return _units(rng, index // 3) if index % 3 == 2 else _function(rng, index)
