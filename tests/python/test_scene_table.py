"""Each key of scenes, read from the table: wrong types, bounds, words, names and defaults."""

import inspect
import re
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import viscovib as vv
from viscovib.explorer import numbers
from viscovib.scene import scene as scene_file

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs" / "_extensions"))

import scene_keys  # noqa: E402

GROUPS = {group["name"]: group for group in scene_keys.read_groups()}
#: Groups of a scene with each system, with the keys that they need.
SYSTEMS = {
    "mount": {"mount": "mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2"},
    "system": {"system": "coordinates='x' mass=1 stiffness=1 damping=0.1"},
    "structure": {"structure": "mass=1 2 stiffness=2 -1 -1 2 damping=0.1 0.1"},
    "body": {
        "body": "mass=1 inertia=1 1 1",
        "mount_point": "name='a' position=0 0 0 stiffness=1 1 1 rotational_stiffness=1 1 1",
    },
    "pendulum": {"pendulum": "e=0.1 w2=0.4 w3=0.8 f0=0.02 p1=0.9"},
}
START = {"mount": 4, "system": 2, "structure": 4, "body": 12, "pendulum": 6}
#: Keys that a group needs; of a group that depends on the system, a function of it.
NEEDS = {
    "spring": "stiffness=1",
    "force": "law='x^3'",
    "element": "on='x1'",
    "layer": "stiffness=1 1",
    "kernel": "kind='prony' weights=0.1 rates=1",
    "load": "amplitude=0.1",
    "response": "nu_from=0.5 nu_to=2 nu_count=3",
    "branch": "nu_from=0.5 nu_to=2",
    "backbone": "from=0.1 to=0.2",
    "multiple_scales": "from=0.5 to=2",
    "campbell": "speed_from=0 speed_to=2 speed_count=3",
    "drive_torque": "torque='1' inertia=1",
    "steady_motion": "nu=1",
    "trace_motion": "nu_from=0.5 nu_to=2",
    "transient": "t_end=5",
    "shock_spectrum": "coordinate='{0}' frequencies=1 2",
    "event": "function='{0} - 0.1'",
    "ensemble": "vary='load_scale' from=0.5 to=1 count=2 t_end=5",
    "basins": "vary='{0}' '{0}_dot' from=-0.1 -0.1 to=0.1 0.1 count=2 2 n_periods=20",
    "sweep": "key='load.amplitude' min=0.1 max=0.2 count=2",
}
#: Where a key is read under a condition: what the group has instead.
INSTEAD = {
    ("force", "coefficient"): "powers=3",
    ("force", "powers"): "coefficient=1",
    ("element", "hysteresis_numbers"): "on='x1' hysteresis='dahl'",
    ("mount_point", "kernels"): "name='a' position=0 0 0 stiffness=1 1 1",
    ("kernel", "amplitude"): "kind='rzhanitsyn' alpha=0.1 beta=1",
    ("kernel", "alpha"): "kind='rzhanitsyn' amplitude=0.1 beta=1",
    ("kernel", "beta"): "kind='rzhanitsyn' amplitude=0.1 alpha=0.5",
    ("kernel", "interpolation"): "kind='tabulated' times=0 1 values=0.1 0.01",
    ("kernel", "file"): "kind='tabulated' times=0 1 values=0.1 0.01",
    ("kernel", "times"): "kind='tabulated' values=0.1 0.01",
    ("kernel", "values"): "kind='tabulated' times=0 1",
    ("kernel", "numbers"): "kind='fitted'",
    ("kernel", "shift_law"): "kind='fitted' numbers=1 0.1 0.5 1",
    ("kernel", "shift_numbers"): "kind='fitted' numbers=1 0.1 0.5 1",
    ("kernel", "temperature"): "kind='fitted' numbers=1 0.1 0.5 1 shift_law='wlf' "
    "shift_numbers=20 10 100",
    **{("load", key): "shape='half_sine' amplitude=1 duration=1" for key in ("start", "duration")},
    **{("load", key): "shape='trapezoid' amplitude=1 duration=1" for key in ("rise", "fall")},
    **{("load", key): "shape='chirp' amplitude=1 duration=1 hz=1 2" for key in ("hz", "sweep")},
    **{
        ("load", key): "kind='unbalance' shape='run_up' amplitude=1 duration=1 speed=1 2"
        for key in ("speed", "hold")
    },
    **{("load", key): "shape='record' times=0 1 values=0 1" for key in ("times", "values")},
    ("load", "unit"): "kind='acceleration' shape='step' amplitude=1",
    ("load", "file"): "shape='record' times=0 1 values=0 1",
    **{
        ("shock_spectrum", key): "coordinate='x' from=1 to=2 count=3"
        for key in ("frequencies", "from", "to", "count", "spacing")
    },
    **{
        ("shock_spectrum", key): "times=0 1 values=0 1 frequencies=1"
        for key in ("file", "times", "values", "unit")
    },
    ("load", "force"): "torque=1 0 0",
    ("load", "torque"): "force=1 0 0",
    ("load", "at"): "force=1 0 0",
    ("response", "nu"): "",
    ("branch", "from"): "to=2 nu=1 vary='load_factor'",
    ("branch", "to"): "from=1 nu=1 vary='load_factor'",
    ("branch", "nu"): "from=1 to=2 vary='load_factor'",
    ("multiple_scales", "nu"): "from=0.5 to=2 parameter='load'",
    ("trace_motion", "from"): "to=2 nu=1 vary='load_factor'",
    ("trace_motion", "to"): "from=1 nu=1 vary='load_factor'",
    ("trace_motion", "nu"): "from=1 to=2 vary='load_factor'",
    ("transient", "tail"): "t_end=5 keep='tail'",
    ("ensemble", "n_periods"): "vary='load_scale' from=0.5 to=1 count=2 sections=1",
    ("basins", "t_end"): "vary='{0}' '{0}_dot' from=-0.1 -0.1 to=0.1 0.1 count=2 2",
    ("sweep", "values"): "key='load.amplitude'",
}
COORDINATE = {"mount": "x", "system": "x", "structure": "x1", "body": "x", "pendulum": "z"}
#: The first system that has the group, unless only another one reads the key.
OF = {"trace_motion": "system", "steady_motion": "system", "ensemble": "system"}
WRONG = {"text": "1", "word": "1", "yes/no": "1", "file": "1", "words": "1", "integer": "1.5"}
WRONG |= {"integers": "1.5", "count": "1.5", "matrix": "nan"}


def parsed(text):
    """Return the keys of a text with their values."""
    parts = re.split(r"(?:^| )(\w+)=", text)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def scene(row, group, system, given=None, *, name=None):
    """Return a scene with a key of a group; without the key if nothing is given."""
    key, here = row["name"], group["name"]
    result = here if group["role"] == "result" else group.get("needs", "")
    in_time = system == "pendulum" or (here == "load" and "shape" in INSTEAD.get((here, key), key))
    result = result or ("transient" if in_time else "response")
    texts = {"scene": "title='a'", **SYSTEMS[system]}
    if here == "parameters":
        texts["force"] = "law='k*x^3'"
    if "kernel" in (here, key) or key in ("kernels", "held", "memory"):
        texts["kernel"] = NEEDS["kernel"]
    constant = result == "equilibrium" or (here, key) == ("basins", "t_end")
    if system != "pendulum":
        texts["load"] = NEEDS["load"] + " order=0" * constant
    for one in (result, here):
        texts.setdefault(one, NEEDS.get(one, ""))
    texts[here] = INSTEAD.get((here, key), texts[here])
    if result in ("transient", "ensemble"):
        texts[result] += " initial=" + " ".join(["0.01"] * START[system])
    is_shock = in_time and here == "load"
    if result in ("transient", "ensemble", "basins") and system != "pendulum":
        texts[result] += " nu=1" * (not constant and not is_shock)
    if system == "pendulum":
        texts[result] = texts[result].replace("nu_", "").replace("load_scale", "f0")
    lines = []
    for one, text in texts.items():
        keys = parsed(text.replace("{0}", COORDINATE[system]))
        if one == here:
            keys.pop(key, None)
            if given is not None:
                keys["k" if key == "*" else name or key] = given
        lines.append(" ".join([f"&{one}", *(f"{k}={v}" for k, v in keys.items()), "/"]))
    return "\n".join(lines)


def read(folder, text):
    path = folder / "scene.nml"
    path.write_text(text + "\n")
    return vv.Scene.read(path)


def refused(folder, text):
    """Return the message of a scene that is wrong, without the path."""
    with pytest.raises(vv.InputError) as error:
        read(folder, text)
    return str(error.value).partition(": ")[2]


def system_of(row, group):
    wanted = OF.get(group["name"])
    return wanted if wanted in row["systems"] else row["systems"][0]


ROWS = {
    f"{group['name']}.{row['name']} of {system_of(row, group)}": (row, group)
    for group in GROUPS.values()
    for row in group["rows"]
}
NAMED = [name for name, (row, _) in ROWS.items() if row["name"] != "*"]
# Without these keys a group is read in another way, which lacks other keys.
for alternative in ("kernel.numbers", "sweep.values"):
    NAMED.remove(f"{alternative} of mount")


@pytest.mark.parametrize("name", ROWS)
def test_a_wrong_type_is_named_with_its_key(tmp_path, name):
    row, group = ROWS[name]
    wrong = WRONG.get(row["type"], "'a'")
    if "size" in row:
        wrong = f"{row['size']}*{wrong}"
    message = refused(tmp_path, scene(row, group, system_of(row, group), wrong))
    key = "k" if row["name"] == "*" else row["name"]
    assert re.match(rf"{key} (= \S+|has 1 values): must be ", message)


@pytest.mark.parametrize("name", NAMED)
def test_a_misspelt_key_is_found(tmp_path, name):
    row, group = ROWS[name]
    key, system = row["name"], system_of(row, group)
    misspelt = key[0] + key
    value = WRONG.get(row["type"], "'a'")
    message = refused(tmp_path, scene(row, group, system, value, name=misspelt))
    assert message == f"unknown key '{misspelt}' in &{group['name']}; did you mean '{key}'?"


BOUNDED = [
    (name, side)
    for name, (row, _) in ROWS.items()
    for side in ("above", "at_least", "below", "at_most")
    if side in row
]


def outside(row, side):
    """Return a number that is just out of a bound, and not the default."""
    bound, whole = row[side], row["type"] in ("integer", "integers", "count")
    step = 1 if whole else max(abs(bound), 1e-3) / 8
    number = {"at_least": bound - step, "at_most": bound + step}.get(side, bound)
    if number == row.get("default"):
        number -= step
    return int(number) if whole else float(number)


@pytest.mark.parametrize(("name", "side"), BOUNDED)
def test_out_of_bounds_is_refused_and_the_bound_is_named(tmp_path, name, side):
    row, group = ROWS[name]
    given = f"{row.get('size', 1)}*{outside(row, side)!r}"
    message = refused(tmp_path, scene(row, group, system_of(row, group), given))
    assert re.match(rf"{row['name']} = \S+: {re.escape(row['must'])}$", message)


WORDED = [name for name, (row, _) in ROWS.items() if "words" in row]


@pytest.mark.parametrize("name", WORDED)
def test_words_are_those_of_the_table(tmp_path, name):
    row, group = ROWS[name]
    system = system_of(row, group)
    message = refused(tmp_path, scene(row, group, system, "'no such'"))
    words = ", ".join(f"'{word}'" for word in row["words"])
    assert message == f"{row['name']} = 'no such': must be one of {words}"


DEFAULTS = [
    name
    for name, (row, _) in ROWS.items()
    if "default" in row and "otherwise" not in row and row["type"] not in ("matrix", "file")
]


@pytest.mark.parametrize("name", DEFAULTS)
def test_the_default_is_that_of_the_table(tmp_path, name):
    """A scene without the key is read as the scene with its default."""
    row, group = ROWS[name]
    system, default = system_of(row, group), row["default"]
    given = f"'{default}'" if isinstance(default, str) else repr(default)
    size = row.get("size", 1)
    if row["type"] == "reals" and "size" not in row and row["name"] != "modal_damping":
        size = START[system] // (1 if row["name"] == "initial" else 2)
    given = f"{size}*{given}" if size > 1 else given
    short = read(tmp_path, scene(row, group, system)).canonical
    assert f"\n  {row['name']} =" in short
    assert read(tmp_path, scene(row, group, system, given)).canonical == short


def test_the_page_has_the_table_of_each_group():
    page = (ROOT / "docs" / "reference" / "scenes.md").read_text()
    assert set(re.findall(r"\{\{ (\w+) \}\}", page)) == set(scene_keys.tables())


#: Groups with a function or class of Python that has the same options.
CALLED = [
    (group["python"], row)
    for group in GROUPS.values()
    if "python" in group
    for row in group["rows"]
    if row.get("python", row["name"])
]


@pytest.mark.parametrize(
    ("function", "row"), CALLED, ids=lambda one: one if isinstance(one, str) else one["name"]
)
def test_python_has_the_names_and_defaults_of_the_table(function, row):
    arguments = inspect.signature(getattr(vv, function)).parameters
    one = arguments[row.get("python", row["name"])]
    # None and "auto" mean that the library selects the value.
    if one.default in (inspect.Parameter.empty, None, "auto") or "default" not in row:
        return
    default = row["default"] == "yes" if row["type"] == "yes/no" else row["default"]
    assert np.all(np.equal(one.default, default))


DUFFING = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="x^3", names=["x"])
SWING = vv.Pendulum(e=0.1, w2=0.4, w3=0.8)
CALLS = {
    "mount": partial(vv.Mount, mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2),
    "pendulum": partial(vv.Pendulum, e=0.1, w2=0.4, w3=0.8),
    "mount_point": partial(vv.MountPoint, name="a", position=(0, 0, 0), stiffness=(1, 1, 1)),
    "response": partial(vv.forced_response, DUFFING, nu=[1.0], load=0.1),
    "branch": partial(vv.trace_response, DUFFING, (0.5, 2), load=0.1),
    "branch of pendulum": partial(vv.trace_response, SWING, p1=(1, 2)),
    "backbone": partial(vv.backbone, DUFFING, 0, (0.1, 0.2)),
    "backbone of pendulum": partial(vv.backbone, SWING, 0, (0.1, 0.2)),
    "steady_motion": partial(vv.steady_motion, DUFFING, nu=1.0, load=0.1),
    "trace_motion": partial(vv.trace_motion, DUFFING, (0.5, 2), load=0.1),
    "transient": partial(vv.simulate, DUFFING, t_end=5, initial=[0.1, 0]),
    "ensemble": partial(vv.simulate_ensemble, DUFFING, t_end=5, initial=[[0.1, 0]]),
    "basins": partial(vv.basins, DUFFING, {"x": [0.1], "x_dot": [0.0]}, n_periods=20),
}
#: Arguments of Python whose range depends on the call, and words for other values.
OTHER = {
    "response.relaxation", "branch.nu", "trace_motion.nu", "transient.nu", "ensemble.nu",
    "basins.nu", "transient.dt", "ensemble.dt", "ensemble.amplitudes_at", "basins.dt",
    "transient.atol", "transient.tail",
    "transient.times", "transient.save_every", "ensemble.n_periods", "basins.t_end",
    "basins.sections", "body.mass",
}  # fmt: skip


def called(name):
    group = ROWS[name][1]["name"]
    return CALLS.get(f"{group} of pendulum" if name.endswith("pendulum") else group) or CALLS.get(
        group
    )


@pytest.mark.parametrize(
    ("name", "side"),
    [
        (name, side)
        for name, side in BOUNDED
        if called(name)
        and name.partition(" ")[0] not in OTHER
        and not ROWS[name][0].get("python", "a").endswith(("range", "starts"))
        and ROWS[name][0].get("python", "a")
    ],
)
def test_python_refuses_the_same_in_the_same_words(name, side):
    row = ROWS[name][0]
    given = outside(row, side)
    value = [given] * row["size"] if "size" in row else given
    with pytest.raises(vv.InputError) as error:
        called(name)(**{row["name"]: value})
    assert str(error.value).endswith(row["must"])
    assert str(error.value).startswith((row["name"], "a"))


def test_lists_of_groups_in_python_are_those_of_the_table():
    assert set(scene_file._REPEATABLE) == {name for name in GROUPS if "repeats" in GROUPS[name]}
    assert set(numbers._PHYSICS) <= set(GROUPS)


@pytest.mark.parametrize("file", ["include/viscovib.h.in", "docs/reference/c.md"])
def test_the_c_interface_names_the_methods_of_the_table(file):
    (row,) = (row for row in GROUPS["response"]["rows"] if row["name"] == "method")
    text = (ROOT / file).read_text()
    assert all(f'"{word}"' in text for word in row["words"])
    keys = re.findall(r"viscovib_branch\(system, (\w+), (\w+)", text) or [("nu_from", "nu_to")]
    names = {one["name"] for one in GROUPS["branch"]["rows"]}
    assert set(keys[0]) <= names
