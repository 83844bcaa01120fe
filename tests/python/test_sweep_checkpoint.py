"""Checkpoints of sweeps: finished points are kept, and damaged ones are recomputed."""

import _thread
import fcntl
import hashlib
import json
import os
import pickle
import runpy
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import viscovib as vv
import xarray as xr
import zarr
from processes import end_by_interrupt
from viscovib.common import fingerprint

PAPER = Path(__file__).parents[2] / "data" / "scenes" / "mount_paper.nml"
GRID = {"a": np.arange(1.0, 9.0), "b": np.array([0.5, 1.5, 2.5])}
SCALE = 3.0

#: A sweep in a separate process; every started point is recorded.
CHILD = """
import os, sys, time
import numpy as np, viscovib as vv
notes, checkpoint = sys.argv[1:3]
def slow(a, b):
    with open(notes, "a") as file:
        file.write(f"{a} {b}\\n")
    time.sleep(float(os.environ["PAUSE"]))
    return {"y": a * b, "v": np.array([a, b]), "w": f"{a:g}"}
data = vv.sweep(slow, {"a": np.arange(30.0), "b": np.arange(4)}, checkpoint=checkpoint,
                chunk=4, n_threads=2, progress=False)
np.save(notes + ".npy", data.y.values)
"""


def sweep(*arguments, **options):
    return vv.sweep(*arguments, progress=False, **options)


class Counted:
    """A function that records its calls; the record is not part of its identity."""

    def __init__(self, factor=1.0):
        self.factor = factor

    def __call__(self, a, b):
        sys.modules[__name__].CALLS.append((a, b))
        return {"y": self.factor * a * b, "wave": np.array([a, 1j * b]), "word": f"{a:g}"}


CALLS = []


@pytest.fixture(autouse=True)
def _fresh():
    CALLS.clear()


def test_what_comes_back_from_disk_is_what_was_computed(tmp_path):
    here = sweep(Counted(), GRID)
    there = sweep(Counted(), GRID, checkpoint=tmp_path / "c", chunk=5)
    assert len(CALLS) == 48
    again = sweep(Counted(), GRID, checkpoint=tmp_path / "c")
    assert len(CALLS) == 48
    for data in (there, again):
        assert list(data.data_vars) == list(here.data_vars)
        for name, item in here.items():
            assert data[name].dims == item.dims
            assert (data[name].values == item.values).all()
    # Other programs can read it as a plain Zarr store.
    plain = xr.open_zarr(tmp_path / "c", chunks=None)
    assert (plain.y.values == here.y.values).all()
    assert (plain.point_outcome == 1).all()


def test_a_scene_keeps_its_coordinates_and_units_on_disk(tmp_path):
    grid = {"mount.stiffness_x": [8.0, 12.0]}
    here, there = (sweep(PAPER, grid, checkpoint=c) for c in (None, tmp_path / "c"))
    xr.testing.assert_equal(here.drop_vars("unit"), there.drop_vars("unit"))
    assert (there.unit.values == here.unit.values).all()
    assert there.nu.attrs["units"] == "rad/s"
    assert there["mount.stiffness_x"].attrs["units"] == "N/m"


def finished(folder):
    """Points of the chunks whose outcomes are on disk."""
    done = set()
    for file in (folder / "point_outcome" / "c").rglob("*"):
        if file.is_file() and file.name.isdigit():
            done.add((float(file.relative_to(folder).parts[2]), file.name))
    return done


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_killed_sweep_goes_on_where_it_was(start, tmp_path, monkeypatch, how):
    """The process is killed in the middle of its chunks."""
    script = tmp_path / "child.py"
    script.write_text(CHILD)
    notes, folder = tmp_path / "notes", tmp_path / "c"
    command = [sys.executable, str(script), str(notes), str(folder)]
    # Longer than a busy machine needs to hear the signal.
    monkeypatch.setenv("PAUSE", "0.15")
    child = start(command, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while len(finished(folder)) < 6 and child.poll() is None:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert child.poll() is None
    # Stopped while its finished points are counted.
    child.send_signal(signal.SIGSTOP)
    begun = len(notes.read_text().splitlines())
    child.send_signal(how)
    child.send_signal(signal.SIGCONT)
    _, said = child.communicate(timeout=30)
    if how == signal.SIGINT:
        # Two threads, each with a chunk of four points.
        assert len(notes.read_text().splitlines()) - begun <= 8
        assert said.strip().endswith("KeyboardInterrupt")
    assert child.returncode == -how
    safe = {a for a, _ in finished(folder)}
    assert 6 <= len(safe) < 30
    notes.rename(tmp_path / "first")
    monkeypatch.setattr(sys, "argv", command[1:])
    monkeypatch.setenv("PAUSE", "0")
    runpy.run_path(str(script), run_name="__main__")
    repeated = [line.split() for line in notes.read_text().splitlines()]
    assert {float(a) for a, _ in repeated} == {float(a) for a in range(30)} - safe
    assert len(repeated) == 4 * (30 - len(safe))
    y = np.load(str(notes) + ".npy")
    assert (y == np.outer(np.arange(30.0), np.arange(4))).all()


def test_broken_and_half_written_chunks_are_made_again(tmp_path):
    folder = tmp_path / "c"
    want = sweep(Counted(), GRID, checkpoint=folder, chunk=3).y.values
    assert len(CALLS) == 24

    def spoil(name, i, how):
        file = next(f for f in (folder / name / "c" / str(i)).rglob("0") if f.is_file())
        data = bytearray(file.read_bytes())
        if how == "flip":
            data[len(data) // 2] ^= 4
        elif how == "cut":
            data = data[: len(data) // 2]
        elif how == "empty":
            data = b""
        file.write_bytes(data) if how != "gone" else file.unlink()

    for k, name in enumerate(("y", "wave", "word", "point_outcome", "point_error")):
        for how in ("flip", "cut", "empty", "gone"):
            CALLS.clear()
            spoil(name, k, how)
            again = sweep(Counted(), GRID, checkpoint=folder)
            assert {a for a, _ in CALLS} == {k + 1.0}, (name, how)
            assert len(CALLS) == 3
            assert (again.y.values == want).all()


def test_another_sweep_is_refused_with_what_differs(tmp_path):
    folder = tmp_path / "c"

    def plain(a, b):
        return SCALE * a * b

    sweep(plain, GRID, checkpoint=folder)

    def refused(message, function=plain, grid=GRID, **options):
        with pytest.raises(vv.InputError, match=message) as reported:
            sweep(function, grid, checkpoint=folder, **options)
        assert "\n" not in str(reported.value)

    refused(
        "grid a last: was 8.0, is 9.0", grid=GRID | {"a": np.arange(1.0, 10.0)[[0, *range(2, 9)]]}
    )
    refused("grid a count: was 8, is 9", grid=GRID | {"a": np.arange(1.0, 10.0)})
    middle = GRID["a"].copy()
    middle[3] += 1e-13
    refused("grid a values: differs", grid=GRID | {"a": middle})
    refused("grid: have another order", grid=dict(reversed(GRID.items())))
    refused("vectorized: was False, is True", vectorized=True)
    refused("name: was .*plain, is .*lambda", function=lambda a, b: 2 * a)

    def plain(a, b):
        return SCALE * (a + b)

    refused("function code: differs", function=plain)

    def plain(a, b):
        """The same; documentation is not part of the identity."""
        return SCALE * a * b

    assert sweep(plain, GRID, checkpoint=folder).result[0, 0] == 1.5


def test_what_a_function_looks_at_counts_as_well(tmp_path, monkeypatch):
    inner = {"k": np.array([1.0, 2.0])}

    def outer(a, b, *, power=2):
        return SCALE * a**power + inner["k"][0] * b

    folder = tmp_path / "c"
    sweep(outer, GRID, checkpoint=folder)
    inner["k"][1] = 2.5
    with pytest.raises(vv.InputError, match="value of 'inner': differs"):
        sweep(outer, GRID, checkpoint=folder)
    inner["k"][1] = 2.0
    sweep(outer, GRID, checkpoint=folder)
    monkeypatch.setattr(sys.modules[__name__], "SCALE", 3.5)
    with pytest.raises(vv.InputError, match="value of 'SCALE': differs"):
        sweep(outer, GRID, checkpoint=folder)
    monkeypatch.undo()
    outer.__kwdefaults__["power"] = 3
    with pytest.raises(vv.InputError, match="default of 'power': differs"):
        sweep(outer, GRID, checkpoint=folder)
    with pytest.raises(vv.InputError, match=r"function name: was .*outer, is Counted"):
        sweep(Counted(), GRID, checkpoint=folder)
    folder = tmp_path / "d"
    sweep(Counted(1.0), GRID, checkpoint=folder)
    with pytest.raises(vv.InputError, match="function object: differs"):
        sweep(Counted(2.0), GRID, checkpoint=folder)


def test_sets_in_the_code_are_the_same_in_another_process(tmp_path):
    """Python orders sets of strings differently in each process."""
    script = tmp_path / "child.py"
    script.write_text(
        "import runpy, sys\n"
        "def of(a):\n"
        "    return a in {'one', 'two', 'three', ('four', 4)}\n"
        "print(runpy.run_path(sys.argv[1])['describe'](of)['code'])\n"
    )
    source = Path(fingerprint.__file__)
    said = {
        subprocess.run(
            [sys.executable, str(script), str(source)], check=True, timeout=60,
            capture_output=True, env={**os.environ, "PYTHONHASHSEED": seed},
        ).stdout
        for seed in "12345"
    }  # fmt: skip
    assert len(said) == 1


#: Module of a sweep function, and ways to refer to the law in another module.
WAYS = {
    "from": ("from {laws} import law", "return law(a) * b"),
    "module": ("import {laws}", "return {laws}.law(a) * b"),
    "deep": ("import {laws}", "return {laws}.twice(a) * b"),
    "inside": ("", "from {laws} import law\n    return law(a) * b"),
    "inside module": ("", "import {laws} as its\n    return its.law(a) * b"),
    "class": ("from {laws} import Spring", "return Spring(2.0).force(a) * b"),
    "object": ("from {laws} import SPRING", "return SPRING.force(a) * b"),
    "number": ("from {laws} import law", "return law(a) * b"),
}
LAWS = """
from helper_of_{laws} import power
import numpy as np
K = {number}
def law(x):
    return K * power(x)
def twice(x):
    return 2 * law(x)
def unused(x):
    return {unused}
class Spring:
    def __init__(self, k):
        self.k = k
    def force(self, x):
        return self.k * law(x)
SPRING = Spring(3.0)
"""


def describe_apart(folder, *, power="x**3", number=2.0, unused="x"):
    """Descriptions of a function for each way in another process, after an edit of the modules."""
    (folder / "helper_of_laws.py").write_text(f"def power(x):\n    return {power}\n")
    (folder / "laws.py").write_text(LAWS.format(laws="laws", number=number, unused=unused))
    for place, (begin, body) in enumerate(WAYS.values()):
        begin, body = (text.format(laws="laws") for text in (begin, body))
        (folder / f"way{place}.py").write_text(f"{begin}\ndef of(a, b):\n    {body}\n")
    (folder / "begin.py").write_text(
        "import sys\nsys.dont_write_bytecode = True\n"
        "from viscovib.common.fingerprint import describe\n"
        f"for place in range({len(WAYS)}):\n"
        "    print(describe(__import__(f'way{place}').of))\n"
    )
    done = subprocess.run(
        [sys.executable, "begin.py"], cwd=folder, check=True, timeout=60, capture_output=True
    )
    lines = done.stdout.splitlines()
    assert len(lines) == len(WAYS)
    return dict(zip(WAYS, lines, strict=True))


def test_edits_of_modules_that_a_function_names_are_seen(tmp_path):
    """For any kind of reference; not for unused names and documentation."""
    first = describe_apart(tmp_path)
    # Another process, and another function that is not used.
    assert describe_apart(tmp_path, unused="x + 1") == first
    for edit in ({"number": 2.5}, {"power": "x**5"}):
        edited = describe_apart(tmp_path, **edit)
        assert [way for way in WAYS if edited[way] == first[way]] == []


def test_functions_that_call_each_other_are_described():
    """Cycles and chains of any length."""
    space = {"__name__": "__main__"}
    n = 3000
    chain = "\n".join(f"def f{i}(x): return f{(i + 1) % n}(x)" for i in range(n))
    exec(chain, space)
    assert fingerprint.describe(space["f0"]) == fingerprint.describe(space["f0"])


def test_another_scene_is_refused_by_its_key(tmp_path):
    folder, copy = tmp_path / "c", tmp_path / "scene.nml"
    text = PAPER.read_text()
    copy.write_text(text)
    grid = {"load.amplitude": [0.02, 0.04]}
    sweep(copy, grid, checkpoint=folder, extract="summary")
    copy.write_text(text.replace("mount of the paper", "the same under another title"))
    sweep(copy, grid, checkpoint=folder, extract="summary")
    copy.write_text(text.replace("stiffness_x = 10.0", "stiffness_x = 11.0"))
    with pytest.raises(vv.InputError, match=r"scene mount.stiffness_x: was 10.0, is 11.0"):
        sweep(copy, grid, checkpoint=folder, extract="summary")
    copy.write_text(text)
    with pytest.raises(vv.InputError, match="extract: was summary, is all"):
        sweep(copy, grid, checkpoint=folder)


def test_failures_are_kept_or_tried_again(tmp_path):
    folder, fragile = tmp_path / "c", {"yes": True}

    class Fragile(Counted):
        def __call__(self, a, b):
            value = super().__call__(a, b)
            if a == 3 and os.environ.get("VISCOVIB_TEST_FRAGILE"):
                raise OSError("no licence")
            return value

    os.environ["VISCOVIB_TEST_FRAGILE"] = "1"
    try:
        with pytest.raises(vv.SweepError, match=r"at a = 3.0, b = 0.5: OSError: no licence"):
            sweep(Fragile(), GRID, checkpoint=folder, chunk=3, n_threads=1)
        kept = sweep(Fragile(), GRID, checkpoint=folder, errors="keep")
        assert (kept.point_outcome[2] == "failed").all()
        assert np.isnan(kept.y.values[2]).all()
        n = len(CALLS)
        again = sweep(Fragile(), GRID, checkpoint=folder, errors="keep")
        assert len(CALLS) == n
        assert (again.point_error[2] == "OSError: no licence").all()
    finally:
        del os.environ["VISCOVIB_TEST_FRAGILE"]
    whole = sweep(Fragile(), GRID, checkpoint=folder)
    assert len(CALLS) == n + 3
    assert np.isfinite(whole.y.values).all()
    assert "point_outcome" not in whole
    assert fragile


def test_folders_that_are_no_checkpoint_are_left_alone(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(vv.InputError, match="exists and is not a checkpoint"):
        sweep(Counted(), GRID, checkpoint=tmp_path)
    (tmp_path / "file").write_text("mine")
    with pytest.raises(vv.FileError, match=r"checkpoint = .*file: cannot be used"):
        sweep(Counted(), GRID, checkpoint=tmp_path / "file")
    foreign = tmp_path / "foreign"
    xr.Dataset({"y": ("t", [1.0])}).to_zarr(foreign, zarr_format=3, consolidated=False)
    with pytest.raises(vv.InputError, match="is not the checkpoint of a sweep"):
        sweep(Counted(), GRID, checkpoint=foreign)


@pytest.fixture(scope="module")
def undamaged(tmp_path_factory):
    """A checkpoint and its data."""
    folder = tmp_path_factory.mktemp("undamaged") / "c"
    return folder, sweep(Counted(), GRID, checkpoint=folder, chunk=5).load()


@pytest.mark.parametrize(
    "file", ["zarr.json", "y/zarr.json", "point_error/zarr.json", "a/zarr.json", "a/c/0"]
)
@pytest.mark.parametrize("content", [b"{", b"\xff\xfe", b"null", b"[" * 5000, b"{}", None])
def test_damaged_metadata_are_put_right(tmp_path, undamaged, file, content):
    folder = tmp_path / "c"
    whole, want = undamaged
    shutil.copytree(whole, folder)
    (folder / file).unlink() if content is None else (folder / file).write_bytes(content)
    again = sweep(Counted(), GRID, checkpoint=folder).load()
    assert not CALLS
    assert again.identical(want)
    # Without the copy the content is unknown: a line that names the file.
    (folder / "point_outcome" / "copies.json").write_bytes(b"{")
    if content is not None and file != "a/c/0":
        (folder / file).write_bytes(b"{")
        with pytest.raises(vv.FileError, match=rf"c: {file} is damaged and cannot be restored"):
            sweep(Counted(), GRID, checkpoint=folder)


def test_without_its_outcomes_a_checkpoint_begins_again(tmp_path):
    """The folder of outcomes also contains checksums and copies: nothing is known to be valid."""
    folder = tmp_path / "c"
    want = sweep(Counted(), GRID, checkpoint=folder, chunk=5).load()
    shutil.rmtree(folder / "point_outcome")
    CALLS.clear()
    assert sweep(Counted(), GRID, checkpoint=folder).load().identical(want)
    assert len(CALLS) == 24


def test_chunks_in_the_place_of_others_are_made_again(tmp_path):
    """All files of an intact chunk, from elsewhere in the sweep or from a similar sweep."""
    folder, other = tmp_path / "c", tmp_path / "other"
    want = sweep(Counted(), GRID, checkpoint=folder, chunk=3).load()
    sweep(Counted(3.0), GRID, checkpoint=other, chunk=3)
    names = [f.parent.name for f in sorted(folder.glob("*/c"))]

    def files(where, i):
        found = [p for n in names for p in (where / n / "c" / str(i)).rglob("*") if p.is_file()]
        return [*found, *(p for p in (where / "point_outcome/seal" / str(i)).iterdir())]

    for source, i, j in ((folder, 2, 5), (other, 3, 3), (other, 0, 1)):
        before = {file: file.read_bytes() for file in files(folder, j)}
        for file in files(source, i):
            there = folder.joinpath(*file.relative_to(source).parts)
            parts = list(there.relative_to(folder).parts)
            parts[2] = str(j)
            folder.joinpath(*parts).write_bytes(file.read_bytes())
        assert before != {file: file.read_bytes() for file in files(folder, j)}
        CALLS.clear()
        again = sweep(Counted(), GRID, checkpoint=folder).load()
        assert {a for a, _ in CALLS} == {j + 1.0}
        assert len(CALLS) == 3
        assert again.identical(want)


def test_a_checkpoint_is_written_by_one_at_a_time(start, tmp_path):
    folder = tmp_path / "c"
    sweep(Counted(), GRID, checkpoint=folder)
    holder = (
        "import sys, os, fcntl; fcntl.flock(os.open(sys.argv[1], os.O_RDONLY), fcntl.LOCK_EX)\n"
        "print('held', flush=True); sys.stdin.read()"
    )
    other = start(
        [sys.executable, "-c", holder, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert other.stdout.readline() == b"held\n"
    with pytest.raises(vv.InputError, match="being written by another sweep"):
        sweep(Counted(), GRID, checkpoint=folder)
    other.kill()
    other.communicate()
    sweep(Counted(), GRID, checkpoint=folder)
    # A running sweep holds the lock too.

    def inside(a, b):
        try:
            fd = os.open(tmp_path / "d", os.O_RDONLY)
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return 1
        finally:
            os.close(fd)
        return 0

    seen = sweep(inside, GRID, checkpoint=tmp_path / "d", chunk=3)
    assert (seen.result == 1).all()


def test_killed_between_its_first_files_it_begins_again(tmp_path):
    """For any part of the preparations that was made before the process died."""
    folder = tmp_path / "c"
    sweep(Counted(), GRID, checkpoint=folder, chunk=6)
    about = (folder / "zarr.json").read_text()
    for name in ("y", "point_error", "a"):
        for file in sorted((folder / name).rglob("*"), reverse=True):
            file.unlink() if file.is_file() else file.rmdir()
        (folder / name).rmdir()
    # Before the variables are fixed their list is empty.
    group = json.loads(about)
    group["attributes"]["viscovib_sweep"]["variables"] = None
    group.pop("consolidated_metadata", None)
    (folder / "zarr.json").write_text(json.dumps(group))
    CALLS.clear()
    data = sweep(Counted(), GRID, checkpoint=folder)
    assert len(CALLS) == 24
    assert (data.y.values == np.outer(GRID["a"], GRID["b"])).all()
    assert (data.a.values == GRID["a"]).all()


#: Two points of a minute each in the core, which no signal reaches.
LONG = """
import sys, numpy as np, viscovib as vv
body = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=.01, c2=.01, c3=.01, f0=.005, m01=.0025,
                   m02=.005, p1=.93, p2=.37, p3=.71)
def long(x):
    if x < 2:
        return x
    n = 300_000_000
    return vv.simulate(body, 0.1 * n, dt=0.1, initial=(0.01 * x, 0, 0.1, 0, 0, 0), keep="last").t
print("begun", flush=True)
vv.sweep(lambda x: (long(x), 0.0)[1], {"x": np.arange(4)}, checkpoint=sys.argv[1], chunk=1,
         n_threads=2, progress=False)
"""


def test_ctrl_c_does_not_wait_for_points_under_way(start, tmp_path):
    script, folder = tmp_path / "long.py", tmp_path / "c"
    script.write_text(LONG)
    child = start(
        [sys.executable, str(script), str(folder)], stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    deadline = time.monotonic() + 60
    while len(finished(folder)) < 2:
        assert child.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.02)
    time.sleep(0.3)
    spent, said = end_by_interrupt(child)
    assert spent < 1
    assert said.strip().endswith("KeyboardInterrupt")
    assert len(finished(folder)) == 2


def test_a_coordinate_that_is_gone_for_good_is_reported(tmp_path):
    """Without its copy it would be read as zeros."""
    folder = tmp_path / "c"
    sweep(Counted(), GRID, checkpoint=folder, chunk=3)
    (folder / "a" / "c" / "0").unlink()
    copy = folder / "point_outcome" / "copies.json"
    copy.write_text(copy.read_text()[:50])
    with pytest.raises(
        vv.ViscovibError, match="the values of a are missing and cannot be restored"
    ):
        sweep(Counted(), GRID, checkpoint=folder, chunk=3)


def everything(folder):
    """Contents of a folder: files with their content, links with their targets."""
    return {
        path.relative_to(folder): os.readlink(path)
        if path.is_symlink()
        else path.read_bytes()
        if path.is_file()
        else path.lstat().st_mode
        for path in sorted(folder.rglob("*"))
    }


def with_attributes(folder, change):
    """Change the attributes of a checkpoint, in its metadata and in their copy."""
    root, copy = folder / "zarr.json", folder / "point_outcome" / "copies.json"
    held = json.loads(copy.read_text().partition("\n")[2])
    change(held["attributes"]["viscovib_sweep"])
    content = json.loads(root.read_text()) | {"attributes": held["attributes"]}
    content.pop("consolidated_metadata", None)
    root.write_text(json.dumps(content))
    text = json.dumps(held)
    copy.write_text(f"{hashlib.sha256(text.encode()).hexdigest()}\n{text}")


def named_outside(folder, outside):
    """Files of a variable with this name would be removed after a failure."""
    for file in sorted((folder / "y").rglob("*"), reverse=True):
        file.unlink() if file.is_file() else file.rmdir()
    (folder / "y").rmdir()
    name = f"{outside}/victim"

    def change(about):
        about["variables"][name] = about["variables"].pop("y")

    with_attributes(folder, change)


def linked(name, target):
    """Replace a file or a folder by a link; the data restored by the copy are damaged too."""

    def plant(folder, outside):
        place = folder / name
        if place.is_dir():
            shutil.copytree(place, outside / "copied")
            shutil.rmtree(place)
        elif place.exists():
            place.unlink()
        place.parent.mkdir(parents=True, exist_ok=True)
        place.symlink_to(str(target).format(outside=outside))
        (folder / "wave" / "zarr.json").write_text("{}")

    return plant


def piped(name):
    def plant(folder, outside):
        (folder / name).unlink()
        os.mkfifo(folder / name)

    return plant


#: Possible attacks in a checkpoint with the identity of the sweep.
HOSTILE = {
    "file": linked("y/zarr.json", "{outside}/precious"),
    "part": linked("wave/zarr.json.part", "{outside}/precious"),
    "part of the group": linked("zarr.json.part", "{outside}/precious"),
    "part of a seal": linked("point_outcome/seal/0/0.part", "{outside}/precious"),
    "folder": linked("wave", "{outside}/copied"),
    "folder of seals": linked("point_outcome/seal", "{outside}/copied"),
    "seal": linked("point_outcome/seal/0/0", "/dev/zero"),
    "chunk": linked("y/c/0/0", "/dev/zero"),
    "copy": linked("point_outcome/copies.json", "/dev/zero"),
    "group": linked("zarr.json", "/dev/zero"),
    "pipe as chunk": piped("y/c/0/0"),
    "pipe as copy": piped("point_outcome/copies.json"),
    "pipe as group": piped("zarr.json"),
    "pipe as seal": piped("point_outcome/seal/0/0"),
    "name": named_outside,
}


@pytest.mark.parametrize("how", HOSTILE)
def test_a_checkpoint_of_somebody_else_reaches_nothing_outside(tmp_path, how):
    """Links, pipes and devices are refused in a line; nothing is read or written through them."""
    outside, folder = tmp_path / "outside", tmp_path / "c"
    sweep(Counted(), GRID, checkpoint=folder, chunk=3)
    (outside / "victim" / "c" / "0").mkdir(parents=True)
    for name in ("precious", "victim/c/0/0"):
        (outside / name).write_text("precious")
    HOSTILE[how](folder, outside)
    before = everything(outside)
    with pytest.raises(vv.FileError) as refused:
        sweep(Counted(), GRID, checkpoint=folder, errors="keep")
    assert str(refused.value).startswith(f"checkpoint = {folder}: ")
    assert "\n" not in str(refused.value)
    assert everything(outside) == before


@pytest.mark.parametrize("damaged", ["y/zarr.json", "a/c/0", None])
def test_nothing_is_written_before_the_identity_is_compared(tmp_path, damaged):
    folder = tmp_path / "c"
    sweep(Counted(3.0), GRID, checkpoint=folder, chunk=3)
    if damaged is not None:
        (folder / damaged).write_text("{")
    before = everything(folder)
    with pytest.raises(vv.InputError, match="contains another sweep"):
        sweep(Counted(), GRID, checkpoint=folder)
    (folder / "zarr.json").write_text("{")
    before[Path("zarr.json")] = b"{"
    with pytest.raises(vv.InputError, match="contains another sweep"):
        sweep(Counted(), GRID, checkpoint=folder)
    assert everything(folder) == before


def test_the_copy_of_another_sweep_is_not_used(tmp_path):
    """The copy is intact, but restoring it would restore another sweep."""
    folder, other = tmp_path / "c", tmp_path / "other"
    want = sweep(Counted(), GRID, checkpoint=folder, chunk=3).load()
    sweep(Counted(3.0), {**GRID, "a": GRID["a"] + 0.5}, checkpoint=other, chunk=2)
    shutil.copy(other / "point_outcome/copies.json", folder / "point_outcome/copies.json")
    CALLS.clear()
    assert sweep(Counted(), GRID, checkpoint=folder).load().identical(want)
    assert not CALLS


def test_a_checkpoint_is_never_unpickled(tmp_path):
    """Zarr version 2 has a codec that executes its data: only version 3 is opened."""
    folder, mark = tmp_path / "c", tmp_path / "executed"
    sweep(Counted(), GRID, checkpoint=folder, chunk=3)

    class Executed:
        def __reduce__(self):
            return (Path.touch, (mark,))

    content = pickle.dumps(Executed())
    meta = {
        "zarr_format": 2, "shape": [8, 3], "chunks": [1, 3], "dtype": "|O", "fill_value": 0,
        "order": "C", "compressor": None, "filters": [{"id": "pickle", "protocol": 5}],
        "dimension_separator": "/",
    }  # fmt: skip
    for name in ("y", "point_outcome"):
        (folder / name / "zarr.json").unlink()
        (folder / name / ".zarray").write_text(json.dumps(meta))
        (folder / name / "0").mkdir()
        (folder / name / "0" / "0").write_bytes(content)
    (folder / ".zgroup").write_text('{"zarr_format": 2}')
    for file in ("point_outcome/copies.json", "zarr.json"):
        with suppress(vv.ViscovibError):
            sweep(Counted(), GRID, checkpoint=folder).load()
        assert not mark.exists()
        (folder / file).unlink()
    with suppress(vv.ViscovibError):
        sweep(Counted(), GRID, checkpoint=folder).load()
    assert not mark.exists()


@pytest.mark.parametrize("name", ["create_group", "open_group", "consolidate_metadata"])
def test_a_stop_does_not_break_off_the_store(tmp_path, monkeypatch, name):
    """At any time: a Zarr coroutine that is created but never awaited causes a warning."""
    if name == "open_group":
        sweep(Counted(), GRID, checkpoint=tmp_path / "c")
    own, ended = getattr(zarr, name), []

    def stopped(*arguments, **options):
        _thread.interrupt_main()
        time.sleep(0.05)
        ended.append(own(*arguments, **options))
        return ended[-1]

    monkeypatch.setattr(zarr, name, stopped)
    with pytest.raises(KeyboardInterrupt):
        sweep(Counted(), GRID, checkpoint=tmp_path / "c")
    assert ended
    monkeypatch.undo()
    assert sweep(Counted(), GRID, checkpoint=tmp_path / "c").y[7, 2] == 20
