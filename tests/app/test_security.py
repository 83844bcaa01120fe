"""SECURITY.md: each promise has tests; scenes execute no code and show no other files."""

import re
from pathlib import Path

import pytest
import viscovib as vv

ROOT = Path(__file__).parents[2]
#: Tests of each promise, by its first words.
PROMISES = {
    "Scenes are data": [
        "app/test_security.py::test_a_scene_executes_nothing",
        "python/test_explorer.py::test_no_title_or_name_of_a_file_is_executed",
    ],
    "Files of a scene": [
        "app/test_driver_limits.py::test_files_outside_the_folder_need_leave",
        "app/test_security.py::test_matrices_outside_the_folder_need_leave",
        "app/test_security.py::test_messages_show_nothing_of_a_file",
    ],
    "Texts stay texts": ["python/test_fuzz.py::test_texts_of_users_stay_texts"],
    "Regular files": [
        "app/test_driver_limits.py::test_only_regular_files_are_read",
        "python/test_special_files.py::test_only_regular_files_are_read",
        "python/test_special_files.py::test_only_regular_matrices_are_read",
        "python/test_special_files.py::test_files_have_a_largest_size",
    ],
    "Tables and pictures": [
        "app/test_driver_limits.py::test_a_link_named_like_a_table_is_replaced",
        "app/test_driver_limits.py::test_a_part_that_is_a_link_is_not_followed",
        "app/test_driver.py::test_a_pipe_in_the_place_of_a_table_stays",
        "python/test_special_files.py::test_a_link_is_replaced_and_never_followed",
        "python/test_special_files.py::test_a_pipe_or_a_device_keeps_its_place",
    ],
    "Failures": [
        "app/test_driver_limits.py::test_a_limit_on_the_size_of_files_is_reported",
        "python/test_special_files.py::test_a_full_disk_is_reported_and_leaves_nothing",
        "python/test_special_files.py::test_a_full_disk_ends_a_sweep_with_one_line",
    ],
    "Long scenes": ["app/test_driver_limits.py::test_a_megabyte_is_read_or_refused_at_once"],
    "Checkpoints": [
        "python/test_sweep_checkpoint.py::test_a_checkpoint_of_somebody_else_reaches_nothing_outside",
        "python/test_sweep_checkpoint.py::test_nothing_is_written_before_the_identity_is_compared",
        "python/test_sweep_checkpoint.py::test_a_checkpoint_is_never_unpickled",
    ],
    "The explorer": [
        "python/test_explorer.py::test_the_page_is_behind_a_token",
        "python/test_explorer.py::test_the_token_is_in_no_process_list",
    ],
}


def test_each_promise_has_tests():
    text = (ROOT / "SECURITY.md").read_text().partition("## What is not")[0]
    assert re.findall(r"^- \*\*(.+?)\.\*\*", text, re.MULTILINE) == list(PROMISES)
    assert text.count("\n- ") == len(PROMISES)
    for names in PROMISES.values():
        for name in names:
            file, _, test = name.partition("::")
            assert f"\ndef {test}(" in (ROOT / "tests" / file).read_text(), name


SCENE = (
    "&scene title='{code}' /\n&system mass=1 stiffness=1 damping=0.1 coordinates='x' /\n"
    "&force on='x' law='{law}' /\n&load on='x' amplitude=0.1 /\n"
    "&response nu_from=0.5 nu_to=2 nu_count=5 method='linear' /\n"
)
CODE = (
    "__import__(''os'').system(''touch executed'')",
    "$(touch executed)",
    "`touch executed`",
    "; touch executed",
    "(lambda: open(''executed'', ''w''))()",
    "{0.__class__}",
)


@pytest.mark.parametrize("code", CODE)
def test_a_scene_executes_nothing(solve, tmp_path, monkeypatch, code):
    """Any text of a scene may be Python or shell code."""
    monkeypatch.chdir(tmp_path)
    scene = tmp_path / "scene.nml"
    for title, law in ((code, "x^3"), ("plain", code), ("plain", f"x^3 + {code}")):
        scene.write_text(SCENE.format(code=title, law=law))
        done = solve(scene, "--out", tmp_path / "out")
        assert done.returncode == (0 if law == "x^3" else 2)
        if law == "x^3":
            vv.run(scene).to_csv("a.csv")
        else:
            with pytest.raises(vv.InputError):
                vv.Scene.read(scene)
        assert not Path("executed").exists()


def test_matrices_outside_the_folder_need_leave(solve, tmp_path):
    folder, scene = tmp_path / "scenes", tmp_path / "scenes" / "scene.nml"
    folder.mkdir()
    matrix = "%%MatrixMarket matrix coordinate real general\n1 1 1\n1 1 2.0\n"
    (tmp_path / "m.mtx").write_text(matrix)
    (folder / "link.mtx").symlink_to("../m.mtx")
    for name in ("../m.mtx", str(tmp_path / "m.mtx"), "link.mtx"):
        scene.write_text(f"&structure mass='{name}' stiffness=1 /\n&modes /\n")
        assert "must be in the folder of the scene" in solve(scene, "--plan").stderr
        with pytest.raises(vv.InputError, match="must be in the folder of the scene"):
            vv.Scene.read(scene)
        assert solve(scene, "--plan", "--allow-paths").returncode == 0
        vv.Scene.read(scene, allow_paths=True)


SECRETS = (
    "root:x:0:0\n",
    "%%MatrixMarket matrix coordinate real general\nroot:x:0:0\n",
    "%%MatrixMarket matrix coordinate real general\n1 1 1\nroot:x:0:0\n",
    '{"kind": "root:x:0:0"}',
    '{"root:x:0:0": 1}',
    "0 0.2\nroot:x:0:0 1\n",
)


@pytest.mark.parametrize("content", SECRETS)
def test_messages_show_nothing_of_a_file(solve, tmp_path, content):
    """A file named by a scene is no table, matrix or kernel: its lines are not printed."""
    scene, load = tmp_path / "scene.nml", "&load amplitude=0.1 /\n"
    for kind, name in (("tabulated", "f.csv"), ("fitted", "f.json"), ("", "f.mtx")):
        (tmp_path / name).write_text(content)
        scene.write_text(
            "&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2 /\n"
            f"&kernel kind='{kind}' file='{name}' /\n{load}&response nu=1 method='linear' /\n"
            if kind
            else f"&structure mass='{name}' stiffness=1 /\n&modes /\n"
        )
        done = solve(scene, "--out", tmp_path / "out")
        assert done.returncode == 2
        assert ":x:0" not in done.stderr + done.stdout
        with pytest.raises(vv.ViscovibError) as raised:
            vv.Scene.read(scene)
        assert ":x:0" not in str(raised.value)
