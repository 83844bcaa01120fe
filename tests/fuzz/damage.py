"""Damaged or hostile checkpoints of sweeps, and the sweeps that resume from them.

Run by a worker. A sweep is run, its files are damaged, and it is run again. It must return the same
values or refuse with one line, and must not recompute intact chunks. Links, pipes, devices and
foreign checkpoints must have no effect outside the folder.
"""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import viscovib as vv

CALLS: list[tuple[Any, ...]] = []

#: A sweep in a separate process, which is killed.
CHILD = """
import sys, time, warnings
import viscovib as vv
warnings.simplefilter("ignore")
def slow(a, b):
    time.sleep(0.01)
    return {"y": a * b, "w": f"{a:g}"}
data = vv.sweep(slow, {"a": [float(i) for i in range(20)], "b": [1.0, 2.0]}, checkpoint=sys.argv[1],
                chunk=2, n_threads=2, progress=False)
assert (data.y.values == [[a * b for b in (1.0, 2.0)] for a in range(20)]).all(), data.y.values
assert (data.w.values[:, 0] == [f"{a:g}" for a in range(20)]).all()
"""


class Point:
    """The function of a sweep; its calls are recorded outside of it."""

    def __init__(self, factor: float, kind: str) -> None:
        self.factor, self.kind = factor, kind

    def __call__(self, a: float, b: float) -> Any:
        sys.modules[__name__].CALLS.append((a, b))  # type: ignore[attr-defined]
        if self.kind == "failing" and a == 2.0:
            raise ValueError(f"no value at {a}")
        if self.kind == "number":
            return self.factor * a * b
        if self.kind == "scene":
            import xarray as xr

            wave = self.factor * a * np.arange(3.0) + b
            return xr.Dataset({"wave": ("nu", wave)}, coords={"nu": [1.0, 2.0, 3.0]})
        return {"y": self.factor * a * b, "wave": np.array([a, 1j * b]), "word": f"{a:g}"}


def checkpoint(seed: str) -> dict[str, Any]:
    """One case."""
    rng = random.Random(seed)
    folder = Path(f"case{os.getpid()}")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            reported: list[str] = []
            kind = rng.choices([_killed, _hostile, _case], [0.02, 0.3, 0.68])[0]
            verdict, detail = kind(rng, folder, reported)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return {"verdict": verdict, "detail": "; ".join([detail, *reported])}


def _case(rng: random.Random, folder: Path, reported: list[str]) -> tuple[str, str]:
    kind = rng.choice(["number", "several", "failing", "scene"])
    grid = {
        "a": [float(i) for i in range(1, rng.randint(2, 6))],
        "b": [0.5, 1.5, 2.5][: rng.randint(1, 3)],
    }
    chunk = rng.randint(1, 6)
    other = {"a": [x + rng.choice([0.0, 0.5]) for x in grid["a"]], "b": grid["b"]}

    def sweep(where: str, factor: float, points: dict[str, list[float]]) -> Any:
        CALLS.clear()
        return vv.sweep(
            Point(factor, kind), points, checkpoint=folder / where, progress=False, chunk=chunk,
            n_threads=1, errors="keep",
        ).load()  # fmt: skip

    reported.append(f"{kind}, grid {grid}, chunk {chunk}")
    want = sweep("mine", 1.0, grid)
    sweep("other", rng.choice([1.0, 3.0]), other)
    mine = folder / "mine"
    touched: set[Path] = set()
    for _ in range(rng.choice([1, 1, 2, 4])):
        touched |= spoil(rng, mine, folder / "other", reported)
    try:
        again = sweep("mine", 1.0, grid)
    except vv.ViscovibError as error:
        text = str(error)
        bad = "\n" in text or len(text) > 1000
        return ("message" if bad else "refused with a line"), text
    except Exception as error:
        return "exception", f"{type(error).__name__}: {str(error)[:300]}"
    computed = set(CALLS)
    if not again.identical(want):
        return "not the same", str(again)[:800]
    if needless := computed - _points_of(touched, mine, grid, chunk):
        return "not kept", f"computed again {sorted(needless)}"
    sweep("mine", 1.0, grid)
    return ("not kept", f"not mended: {CALLS}") if CALLS else ("done", "")


def _hostile(rng: random.Random, folder: Path, reported: list[str]) -> tuple[str, str]:
    """A foreign checkpoint, of this sweep or of another."""
    grid, mine, outside = {"a": [1.0, 2.0, 3.0], "b": [0.5, 1.5]}, folder / "mine", folder / "out"
    kind, same = rng.choice(["number", "several", "failing", "scene"]), rng.random() < 0.7
    reported.append(f"{kind}, {'same' if same else 'other'} identity")

    def sweep(factor: float) -> Any:
        return vv.sweep(
            Point(factor, kind), grid, checkpoint=mine, progress=False, chunk=2, n_threads=1,
            errors="keep",
        ).load()  # fmt: skip

    want = sweep(1.0)
    (outside / "folder").mkdir(parents=True)
    for name in ("precious", "folder/0", "folder/zarr.json"):
        (outside / name).write_text("precious")
    for _ in range(rng.choice([1, 1, 2, 3])):
        plant(rng, mine, outside.resolve(), reported)
    if rng.random() < 0.3:
        spoil(rng, mine, mine, reported)
    kept, before = _snapshot(outside), _snapshot(mine)
    try:
        again = sweep(1.0 if same else 3.0)
    except vv.ViscovibError as error:
        verdict, text = "refused with a line", str(error)
        if "\n" in text or len(text) > 1000:
            verdict = "message"
        if not same and _snapshot(mine) != before:
            verdict, text = "not kept", f"written into before it was refused: {text}"
    except Exception as error:
        verdict, text = "exception", f"{type(error).__name__}: {str(error)[:300]}"
    else:
        verdict, text = "done", ""
        if not same or not again.identical(want):
            verdict, text = "not the same", str(again)[:800]
    if _snapshot(outside) != kept:
        return "not kept", "something outside of the folder is changed"
    return verdict, text


def plant(rng: random.Random, mine: Path, outside: Path, reported: list[str]) -> None:
    """Place a link, a pipe or a device into a checkpoint, also in place of a temporary file."""
    places = sorted(path for path in mine.rglob("*") if not path.is_symlink())
    place = rng.choice(places)
    if rng.random() < 0.3 and place.is_file():
        place.write_bytes(b"{")
        place = place.with_name(f"{place.name}.part")
    elif place.is_dir():
        shutil.rmtree(place)
    else:
        place.unlink()
    target = rng.choice(
        ["pipe", "/dev/zero", "/dev/stdin", "/proc/self/environ", outside / "precious",
         outside / "folder", outside / "nothing", place, ".."]
    )  # fmt: skip
    reported.append(f"{place.relative_to(mine)} is {target}")
    if target == "pipe":
        os.mkfifo(place)
    else:
        place.symlink_to(target)


def _snapshot(folder: Path) -> dict[str, Any]:
    """Contents of a folder, without following links."""
    found: dict[str, Any] = {}
    for place, folders, names in os.walk(folder):
        for path in (Path(place) / name for name in (*folders, *names)):
            found[str(path)] = os.readlink(path) if path.is_symlink() else path.lstat().st_mode
            if path.is_file() and not path.is_symlink():
                found[str(path)] = path.read_bytes()
    return found


def _points_of(
    touched: set[Path], mine: Path, grid: dict[str, list[float]], chunk: int
) -> set[tuple[float, float]]:
    """Points that may be lost with files: of their chunks, or all if the copies are lost."""
    every = {(a, b) for a in grid["a"] for b in grid["b"]}
    names = [path.relative_to(mine).parts for path in touched]
    if any(path[1:] == ("copies.json",) for path in names) or any(len(p) == 1 for p in names):
        return every
    inner = min(len(grid["b"]), chunk)
    outer = min(len(grid["a"]), max(chunk // len(grid["b"]), 1))
    lost = set()
    for name in names:
        if name[0] in ("a", "b", "nu") or name[1] not in ("c", "seal"):
            continue
        if len(name) < 4:
            # A whole folder.
            i = [int(name[2])] if len(name) > 2 else range(len(grid["a"]))
            j: Any = range(len(grid["b"]))
        else:
            i, j = [int(name[2])], [int(name[3])]
        for p in i:
            for q in j:
                lost |= {
                    (a, b)
                    for a in grid["a"][p * outer : (p + 1) * outer]
                    for b in grid["b"][q * inner : (q + 1) * inner]
                }
    return lost


def spoil(rng: random.Random, mine: Path, other: Path, reported: list[str]) -> set[Path]:
    """Damage a file; return the changed files."""
    files = sorted(path for path in mine.rglob("*") if path.is_file())
    if not files:
        return set()
    file = rng.choice(files)
    content = file.read_bytes()
    how = rng.choice(["flip", "flip", "cut", "empty", "gone", "swap", "swap", "copy", "foreign",
                      "random", "folder", "chunk", "chunk", "tree", "longer", "text"])  # fmt: skip
    reported.append(f"{how} {file.relative_to(mine)}")
    if how == "flip" and content:
        data = bytearray(content)
        for _ in range(rng.choice([1, 1, 3])):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        file.write_bytes(data)
    elif how == "cut":
        file.write_bytes(content[: rng.randrange(len(content) + 1)])
    elif how == "empty":
        file.write_bytes(b"")
    elif how == "gone":
        file.unlink()
    elif how in ("swap", "copy"):
        first = file.relative_to(mine).parts[:2]
        alike = [f for f in files if f.relative_to(mine).parts[:2] == first]
        second = rng.choice(alike if rng.random() < 0.8 else files)
        reported.append(f"with {second.relative_to(mine)}")
        file.write_bytes(second.read_bytes())
        if how == "swap":
            second.write_bytes(content)
            return {file, second}
    elif how == "chunk":
        return _moved(rng, mine, rng.choice([mine, other]), reported)
    elif how == "foreign":
        source = other / file.relative_to(mine)
        if source.is_file():
            file.write_bytes(source.read_bytes())
    elif how == "random":
        file.write_bytes(rng.randbytes(rng.choice([1, 10, len(content)])))
    elif how == "folder":
        file.unlink()
        file.mkdir()
    elif how == "tree" and file.parent != mine:
        gone = {f for f in files if file.parent in f.parents}
        shutil.rmtree(file.parent)
        return gone
    elif how == "longer":
        file.write_bytes(content + b"\0" * rng.choice([1, 1000]))
    elif how == "text":
        words = [b'{"a":', b"[" * 5000, b"\xff\xfe", b"null", b'"x"', b"{}", b"1e999"]
        file.write_bytes(rng.choice(words))
    return {file}


def _moved(rng: random.Random, mine: Path, source: Path, reported: list[str]) -> set[Path]:
    """Replace a chunk by another intact chunk."""
    places = sorted(
        f.relative_to(source / "point_outcome" / "c").parts[:2]
        for f in (source / "point_outcome" / "c").rglob("*")
        if f.is_file()
    )
    if not places:
        return set()
    start, end = rng.choice(places), rng.choice(places)
    reported.append(f"chunk {start} of {source.name} to {end}")
    moved = set()
    for file in sorted(source.rglob("*")):
        name = file.relative_to(source).parts
        if file.is_file() and name[1:2] in (("c",), ("seal",)) and name[2:4] == start:
            there = mine.joinpath(*name[:2], *end, *name[4:])
            if there.is_symlink() or (there.exists() and not there.is_file()):
                continue
            there.parent.mkdir(parents=True, exist_ok=True)
            there.write_bytes(file.read_bytes())
            moved.add(there)
    return moved


def _killed(rng: random.Random, folder: Path, reported: list[str]) -> tuple[str, str]:
    """A sweep that is killed at a random time, sometimes also damaged, and run again."""
    (folder / "child.py").write_text(CHILD)
    command = [sys.executable, str(folder / "child.py"), str(folder / "mine")]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    child = subprocess.Popen(command, **quiet)  # type: ignore[call-overload]
    deadline = time.monotonic() + 10
    while not (folder / "mine").exists() and time.monotonic() < deadline:
        time.sleep(0.005)
    time.sleep(rng.uniform(0, 0.6))
    child.send_signal(signal.SIGKILL)
    child.communicate()
    reported.append("killed")
    if rng.random() < 0.5 and (folder / "mine").exists():
        spoil(rng, folder / "mine", folder / "mine", reported)
    done = subprocess.run(command, timeout=15, check=False, **quiet)  # type: ignore[call-overload]
    lines = done.stderr.strip().splitlines()
    if done.returncode == 0:
        return "done", ""
    last = lines[-1] if lines else ""
    if last.startswith(("viscovib.errors.InputError", "viscovib.errors.FileError")):
        return "refused with a line", last
    return "exception", done.stderr[-800:]
