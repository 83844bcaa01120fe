"""The same tables to the last byte, by the driver and by Python, for every sample scene."""

import os
import re
from pathlib import Path

import numpy as np
import pytest
import viscovib as vv
from driver import SCENES, silence
from viscovib.common.curve_options import OPTIONS
from viscovib.scene.job import _has_core_tables

HERE = Path(__file__).parent / "scenes"
SAMPLES = sorted(path.name for path in SCENES.glob("*.nml") if path.name != "mount_map.nml")
#: Every analysis, group and option that the sample scenes do not use; a scene has one result.
MORE = sorted(path.name for path in HERE.glob("*.nml"))
FOLDED = """&system coordinates='x' mass=1 stiffness=1 damping=0.1 /
&force on='x' law='x^3' /
&load amplitude=0.3 /
&branch nu_from=0.4 nu_to=2.5 {}={!r} /
"""
DEBUG = "debug" in os.environ.get("VISCOVIB_SOLVE", "")
#: Tables of Python in addition to the result and its further branches.
FURTHER = {
    "event": "events", "shock_spectrum": "shock_spectrum", "spectrum": "spectrum",
    "free_decay": "decay", "forces": "forces", "reactions": "reactions", "peaks": "peaks",
}  # fmt: skip


def _header(table):
    return next(line for line in table.splitlines() if not line.startswith(b"#"))


def _compare(solve, scene, folder):
    """Compare plans and tables; of the debug build, which rounds differently, names of columns."""
    done = solve(scene, "--out", folder / "driver", "--quiet")
    assert done.returncode in (0, 1), done
    with silence():
        result = vv.run(scene)
        assert str(vv.plan(scene)).splitlines() == solve(scene, "--plan").stdout.splitlines()
    tables = {path.stem: path.read_bytes() for path in (folder / "driver").glob("*.csv")}
    own = {}
    for i in range(len(result.switched) + 1):
        result.to_csv(folder / "own.csv", i)
        own[f"{scene.stem}_{result.kind}" + f"_{i}" * (i > 0)] = (folder / "own.csv").read_bytes()
    for name, part in FURTHER.items():
        if getattr(result, part) is not None:
            getattr(result, f"{part}_to_csv")(folder / "own.csv")
            own[f"{scene.stem}_{name}"] = (folder / "own.csv").read_bytes()
    _check_value(result)
    if DEBUG:
        tables, own = ({name: _header(one) for name, one in x.items()} for x in (tables, own))
    assert tables == own


def _check_value(result):
    """The result of a structure or a body is that of the table, to the rounding of its modes."""
    value = result.value
    if not _has_core_tables(result.scene) or value._form == "table":
        return
    kind, table = next(iter(result._tables.items()))
    assert result.kind == kind
    assert value.complete == table.complete
    assert str(value.plan) == str(table.plan)
    wanted = np.atleast_1d(result.scene.groups[kind]["coordinates"]).tolist()
    own = value._table(wanted).columns
    first, *columns = own
    if kind in ("branch", "backbone") or own[first].size != table.columns[first].size:
        # Rounding changes steps along a curve, and the core condenses layers in another way.
        assert kind != "response"
        return
    parts = "_(dot|ddot|[0-9]+_re|[0-9]+_im)"
    for name in wanted:
        shown = [one for one in columns if re.fullmatch(f"{re.escape(name)}({parts})?", one)]
        assert set(shown) <= set(table.columns)
        found, expected = (np.array([x[one] for one in shown]) for x in (own, table.columns))
        size = np.nanmax(np.abs(expected), initial=0.0)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * size)


@pytest.mark.skipif(DEBUG, reason="samples take minutes with run-time checks")
@pytest.mark.parametrize("name", SAMPLES)
def test_sample(solve, tmp_path, name):
    # File names in the table are those passed to both programs.
    _compare(solve, SCENES / name, tmp_path)


@pytest.mark.parametrize("name", MORE)
def test_scene(solve, tmp_path, name):
    _compare(solve, HERE / name, tmp_path)


@pytest.mark.parametrize("name", OPTIONS)
def test_option_of_curves(solve, tmp_path, name):
    scene = tmp_path / "folded.nml"
    scene.write_text(FOLDED.format(name, OPTIONS[name].other))
    _compare(solve, scene, tmp_path)


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
