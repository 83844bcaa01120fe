"""The explorer without a browser: numbers, undo, links, files and the server."""

import os
import runpy
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
import pytest
import viscovib as vv
from viscovib.cli.commands import main
from viscovib.explorer import sheet
from viscovib.explorer.drawn import UNSTABLE, curves_of, motion_of
from viscovib.explorer.measured import read_measured
from viscovib.explorer.numbers import numbers
from viscovib.explorer.state import State
from viscovib.plots.outlines import drawing_of

SCENES = Path(__file__).parents[2] / "data" / "scenes"
PAPER = SCENES / "mount_paper.nml"


@pytest.mark.filterwarnings("ignore:kernel integral")
@pytest.mark.parametrize("path", sorted(SCENES.glob("*.nml")), ids=lambda path: path.stem)
def test_every_slider_may_stand_at_its_value(path):
    scene = vv.Scene.read(path).override({})
    found = numbers(scene)
    assert found
    for key, number in found.items():
        low, high = number.ends(number.value)
        assert low <= number.value <= high
        assert low < high
        # The key is known to the scene, and has this value.
        value = int(number.value) if number.whole else number.value
        assert scene.override({key: value}).canonical == scene.canonical


def test_entries_of_a_symmetric_matrix_move_together():
    state = State(vv.Scene.read(SCENES / "absorber.nml"))
    assert "spring(2).stiffness(3)" not in state.numbers
    assert state.numbers["spring(2).stiffness(2)"].unit == "N/m"
    state.set("spring(2).stiffness(2)", -0.03)
    again = state.now.current().groups["spring"][1]["stiffness"]
    assert again == [0.045, -0.03, -0.03, 0.045]


def test_parameters_of_laws_have_sliders(tmp_path):
    """A slider changes the law; the unit of a parameter is unknown."""
    path = tmp_path / "scene.nml"
    path.write_text(
        "&parameters k3=0.7 nu=0.2 /\n&system coordinates='x' mass=1 stiffness=1 damping=0.4 /\n"
        "&force law='k3*x^3 + nu*x^5' /\n&load amplitude=0.3 /\n&response nu=0.3 /\n"
    )
    scene = vv.Scene.read(path)
    found = numbers(scene)
    assert [found[f"parameters.{name}"].unit for name in ("k3", "nu")] == ["", ""]
    other = scene.override({"parameters.k3": 2.0})
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.4, forces="2*x^3 + 0.2*x^5")
    right = vv.forced_response(system, [0.3], load=0.3)
    np.testing.assert_allclose(vv.run(other).value.amplitude("x"), right.amplitude("x"), rtol=1e-12)


def test_undo_redo_and_the_way_back():
    state = State(vv.Scene.read(PAPER))
    first = state.scene_text()
    for mass in (1.1, 1.2, 1.3):
        state.set("mount.mass", mass)
    state.settle()
    moved = state.scene_text()
    state.set_exactly("load.amplitude", "0.2")
    with pytest.raises(vv.InputError, match="mass = -1"):
        state.set_exactly("mount.mass", "-1")
    with pytest.raises(vv.InputError, match="'heavy': must be a number"):
        state.set_exactly("mount.mass", "heavy")
    # The refused change had no effect: two steps, one per movement.
    state.undo()
    assert state.scene_text() == moved
    state.undo()
    assert state.scene_text() == first
    assert not state.can_undo
    state.redo()
    assert state.scene_text() == moved
    want = vv.run(vv.Scene.read(PAPER).override({"mount.mass": 1.3})).value
    assert np.array_equal(state.result.value.coefficients, want.coefficients)
    state.reset()
    assert state.scene_text() == first
    state.read_text("&mount mass=1, inertia=1, offset=0, stiffness_x=1, stiffness_phi=1 /\n"
                    "&load amplitude=0.1 /\n&response nu=0.5 /\n", "other.nml")  # fmt: skip
    assert state.value("mount.inertia") == 1
    state.undo()
    assert state.scene_text() == first
    assert state.value("mount.inertia") == 0.1


def test_an_address_that_is_no_text_is_read():
    """Bytes that are not UTF-8, and scene names that no file can have."""
    from viscovib.explorer.server import page_of, query_of

    assert query_of({"a": [b"\xff"], "b": [b"2", b"3"]}) == [("a", "\ufffd"), ("b", "2")]
    scene = vv.Scene.read(SCENES / "mount_two_kernels.nml")
    for name in ("x" * 5000 + ".nml", "x\0.nml", "\ufffd.nml"):
        assert page_of(scene, query=[("scene", name)]).state.now.scene.path == scene.path


def test_a_link_leads_to_the_same_scene():
    state = State(vv.Scene.read(SCENES / "mount_two_kernels.nml"))
    state.set_exactly("load(2).amplitude", "0.05")
    state.set_exactly("mount.damping(2)", "0.01")
    query = urllib.parse.parse_qsl(state.link().lstrip("?"))
    again = State(vv.Scene.read(SCENES / "mount_two_kernels.nml"))
    again.follow(query)
    assert again.scene_text() == state.scene_text()
    assert again.now.current().groups["mount"]["damping"] == [0.2, 0.01, 0.01, 0.03]
    # A number with its initial value does not appear in the address.
    again.set_exactly("mount.damping(2)", "0.05")
    assert again.link() == "?load(2).amplitude=0.05"
    with pytest.raises(vv.InputError, match=r"mount.weight: must be one of mount.mass"):
        again.follow([("mount.weight", "1")])
    with pytest.raises(vv.InputError, match="'x': must be a number"):
        again.follow([("mount.mass", "x")])


@pytest.mark.parametrize("typed", [False, True])
def test_the_python_lines_give_the_same(tmp_path, monkeypatch, typed, capsys):
    import matplotlib

    matplotlib.use("Agg")
    state = State(vv.Scene.read(PAPER))
    if typed:
        state.read_text(state.scene_text())
    state.set("mount.mass", 1.5)
    monkeypatch.chdir(tmp_path)
    Path("lines.py").write_text(state.python_lines())
    reported = runpy.run_path("lines.py")
    matplotlib.pyplot.close("all")
    assert "400 of 400" in capsys.readouterr().out
    assert reported["result"].value == state.result.value


def test_no_title_or_name_of_a_file_is_executed(tmp_path, monkeypatch):
    """Scenes are untrusted, and their users run the generated lines."""
    import matplotlib

    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    attack = "open('executed', 'w').close()"
    text = State(vv.Scene.read(PAPER)).scene_text()
    title = next(line for line in text.splitlines() if "title = " in line)
    for words in (f'"""\n{attack}\n"""', f'""" + str({attack}) + """', f"' + {attack} + '", "\\"):
        quoted = words.replace("'", "''").replace("\n", " ")
        state = State(vv.Scene.read(PAPER))
        state.read_text(text.replace(title, f"  title = '{quoted}'"))
        name = f"{words}.nml".replace("/", "")
        (tmp_path / name).write_text(text)
        for lines in (state.python_lines(), State(vv.Scene.read(name)).python_lines()):
            Path("lines.py").write_text(lines)
            runpy.run_path("lines.py")
            matplotlib.pyplot.close("all")
            assert not Path("executed").exists()


def test_a_broken_scene_is_reported_with_its_line():
    state = State(vv.Scene.read(PAPER))
    before = state.now
    text = (SCENES / "base_linear.nml").read_text()
    with pytest.raises(vv.InputError, match=r"^line 3: mass = -1: must be greater than 0"):
        state.read_text(text.replace("mass = 1.0", "mass = -1.0"))
    with pytest.raises(vv.InputError, match=r"^no &response group"):
        state.read_text("&mount mass=1 /\n")
    assert state.now is before


def test_curves_are_those_of_the_result():
    result = vv.run(SCENES / "mount_branch.nml")
    x, phi = curves_of(result.value)
    branch = result.value
    assert np.array_equal(x.y, branch.amplitude("x"))
    assert np.array_equal(x.stability == UNSTABLE, branch.stable == False)  # noqa: E712
    assert (np.isnan(x.part(UNSTABLE)) | (x.part(UNSTABLE) == x.y)).all()
    assert phi.marks["fold"][0].tolist() == branch.folds.tolist()
    scene = vv.Scene.read(SCENES / "mount_branch.nml")
    motion = motion_of(scene, branch, (), x, 100)
    assert f"{branch.nu[100]:.5g} rad/s" in motion.about


def test_a_body_has_sliders_curves_and_a_sheet(tmp_path, capsys, monkeypatch):
    path = tmp_path / "body.nml"
    path.write_text(
        "&body mass=10 inertia=0.3 0.01 0 0.01 0.2 0 0 0 0.4 base_direction=0 0 1 0 0 0 /\n"
        "&mount_point name='fluid' position=0.1 0.2 0 stiffness=1e4 1e4 2e4 track=1 20 5e3 /\n"
        "&mount_point name='b' position=-0.1 0.1 0 stiffness=1e4 1e4 2e4 law_z='1e8*d^3' /\n"
        "&mount_point name='c' position=0 -0.2 0.1 stiffness=1e4 1e4 2e4 /\n"
        "&load on='z' amplitude=5 /\n&branch nu_from=20 nu_to=30 harmonics=3 tolerance=1e-3 /\n"
    )
    state = State(vv.Scene.read(path))
    # A symmetric pair of entries is one slider; units are those of a body.
    assert "body.inertia(4)" not in state.numbers
    assert state.numbers["body.inertia(2)"].unit == "kg m^2"
    known = numbers(state.now.scene)
    assert known["mount_point(1).track(3)"].label == "track stiffness"
    assert known["body.base_direction(3)"].label == "base_direction [z]"
    before = curves_of(state.result.value)[2]
    state.set("mount_point(2).stiffness(3)", 2.5e4)
    after = curves_of(state.result.value)[2]
    assert before.name == after.name == "z"
    assert after.y[0] < before.y[0]
    keys = "body.mass,body.inertia(2)"
    moved = []
    run_one = sheet.run_one
    monkeypatch.setattr(sheet, "run_one", lambda one: moved.append(one) or run_one(one))
    # `fluid_y` must not be interpreted as an index in a formula.
    assert main(["explore", str(path), "--sheet", "--keys", keys, "--out", str(tmp_path)]) == 0
    assert (tmp_path / "body_explore.png").stat().st_size > 10000
    # Both entries of the inertia change together; otherwise nothing would be drawn.
    assert {one.groups["body"]["inertia"][3] for one in moved} == {0.008, 0.01, 0.0125}
    capsys.readouterr()


def test_curves_of_a_structure_are_columns_of_its_table():
    curves = curves_of(vv.run(SCENES / "beam_branch.nml").value)
    assert [(curve.name, curve.order) for curve in curves] == [("x7", 1), ("x15", 1)]
    found = vv.trace_response(
        vv.Scene.read(SCENES / "beam_branch.nml").structure(), (120, 360), load={"x15": 1.0},
        tolerance=1e-8, coordinates=["x7", "x15"],
    )  # fmt: skip
    assert np.nanmax(curves[1].y) == pytest.approx(found.amplitude("x15").max(), rel=1e-3)
    assert set(curves[1].stability) == {0, 1}


def test_a_motion_on_a_branch_that_leaves_is_its_own():
    scene = vv.Scene.read(SCENES / "pendulum_backbone.nml")
    result = vv.run(scene)
    (other,) = result.switched
    curve = curves_of(result.value, result.switched)[0]
    first = len(result.value.nu)
    assert np.isnan(curve.y[first])
    # The motions of the side branch swing, the others do not.
    own, swung = (
        motion_of(scene, result.value, result.switched, curve, point)
        for point in (first - 1, first + len(other.nu) - 1)
    )
    assert own.drawing.outlines[2].x.std(axis=0).max() < 1e-6
    assert swung.drawing.outlines[2].x.std(axis=0).max() > 0.1


def test_outlines_move_as_the_body_does():
    t = np.linspace(0, 2 * np.pi, 9)
    motion = np.column_stack([0.3 * np.sin(t), 0.2 * np.cos(t)])
    block = drawing_of(motion, ("x", "phi"), ("m", "rad"), vv.Mount(
        mass=1, inertia=1, offset=0.5, stiffness_x=1, stiffness_phi=1)).outlines[2]  # fmt: skip
    factor = drawing_of(motion, ("x", "phi"), ("m", "rad")).factor
    np.testing.assert_allclose(block.x.mean(axis=1), factor * motion[:, 0] / 0.5, atol=1e-14)
    # Rigid: sides have constant lengths.
    sides = np.hypot(np.diff(block.x, axis=1), np.diff(block.y, axis=1))
    np.testing.assert_allclose(sides, sides[:1] * np.ones((9, 1)), rtol=1e-12)
    # The foot of the spring is at x - l sin(phi).
    foot = drawing_of(motion, ("x", "phi"), ("m", "rad")).outlines[1].x[:, -1]
    want = factor * motion[:, 0] / 0.5 - np.sin(factor * motion[:, 1])
    np.testing.assert_allclose(foot, want, atol=1e-12)


def test_measured_curves():
    table = "# bench\nnu, phi, x\n1, 0.1, 0.2\n2, , 0.3\n"
    found = read_measured(table, ["x", "phi"], [1, 1])
    assert found["x"][1].tolist() == [0.2, 0.3]
    assert np.isnan(found["phi"][1][1])
    plain = read_measured("1 0.1\n2 0.2\n", ["x", "phi"], [1, 1])
    assert list(plain) == ["x"]
    assert plain["x"][0].tolist() == [1, 2]
    for text, message in (
        ("", "contains no numbers"),
        ("nu,x\n", "names of columns but no numbers"),
        ("1\n2\n", "one column"),
        ("1,2,3\n1,2\n", "row 2 has 2 columns, must have 3"),
        ("nu,y,z\n1,2,3\n", "no column is named after a coordinate"),
        ("a,b\nc,d\n", "first column contains no numbers"),
    ):
        with pytest.raises(vv.InputError, match=message):
            read_measured(text, ["x", "phi"], [1, 1])


def test_a_table_of_our_own_is_a_measured_curve(tmp_path):
    result = vv.run(PAPER)
    result.to_csv(tmp_path / "t.csv")
    found = read_measured((tmp_path / "t.csv").read_text(), ["x", "phi"], [1, 1])
    np.testing.assert_allclose(found["phi"][1], result.value.amplitude("phi"), rtol=1e-15)


def test_the_page_is_behind_a_token():
    pytest.importorskip("bokeh")
    page = vv.explore(PAPER, keys=["mount.mass"])
    try:
        with urllib.request.urlopen(page.address) as answer:
            text = answer.read().decode()
        # No resource is loaded from outside.
        assert "https://" not in text.replace("https://www.w3.org", "")
        for place in ("", "wrong/", "static/js/bokeh.min.js"):
            with pytest.raises(urllib.error.HTTPError, match="404"):
                urllib.request.urlopen(page.address.rsplit("/", 2)[0] + "/" + place)
        assert page.address in page._repr_html_()
    finally:
        page.stop()
    with pytest.raises(vv.InputError, match=r"--keys mount.weight: must be one of mount.mass"):
        vv.explore(PAPER, keys=["mount.weight"])


#: A fake browser that records its arguments, and the mode and text of its file.
BROWSER = """#!/bin/sh
file="${1#file://}"
{ echo "$*"; stat -c %a "$file" "$(dirname "$file")"; cat "$file"; } > "$NOTES.part"
mv "$NOTES.part" "$NOTES"
"""


def test_the_token_is_in_no_process_list(start, tmp_path):
    pytest.importorskip("bokeh")
    browser, notes = tmp_path / "browser", tmp_path / "notes"
    browser.write_text(BROWSER)
    browser.chmod(0o755)
    given = {"BROWSER": f"{browser} %s", "NOTES": str(notes), "TMPDIR": str(tmp_path)}
    child = start(
        [sys.executable, "-m", "viscovib", "explore", str(PAPER)], stdout=subprocess.PIPE,
        text=True, env={**os.environ, **given},
    )  # fmt: skip
    address = child.stdout.readline().strip()
    token = address.rstrip("/").rpartition("/")[2]
    assert len(token) == 32
    deadline = time.monotonic() + 30
    while not notes.exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    command, *modes, _ = notes.read_text().split("\n", 3)
    assert command.startswith("file:///")
    assert token not in command
    assert modes == ["600", "700"]
    assert address in notes.read_text()
    assert token not in Path(f"/proc/{child.pid}/cmdline").read_text()
    child.send_signal(signal.SIGINT)
    assert child.wait(30) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["browser", "notes"]


def test_the_command_says_what_is_wrong(tmp_path, capsys):
    assert main(["explore", str(PAPER), "--port", "70000"]) == 2
    assert "--port 70000: must be 0 to 65535" in capsys.readouterr().err
    out = ["--out", str(tmp_path), "--sheet"]
    assert main(["explore", str(PAPER), *out, "--keys", "mount.mass,load.amplitude"]) == 0
    assert (tmp_path / "mount_paper_explore.png").stat().st_size > 10_000
    assert main(["explore", str(PAPER), *out, "--keys", "mount.weight"]) == 2
    assert "--keys mount.weight: must be one of mount.mass" in capsys.readouterr().err
