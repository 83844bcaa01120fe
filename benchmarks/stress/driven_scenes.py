"""The scenes of data/scenes by the driver: their tables as numbers, and their inputs."""

import csv
import math
import os
import re
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
SCENES = sorted((ROOT / "data" / "scenes").glob("*.nml"))
#: Arrays by name; texts (outcomes, exit status) as arrays of text.
Tables = dict[str, np.ndarray]
#: Columns about the computation, not about the motion.
NO_RESULTS = ("iterations", "rate", "nu_given")
#: Keys whose numbers are counts or indices.
COUNTS = (
    "nu_count",
    "count",
    "harmonics",
    "order",
    "kernel",
    "max_iterations",
    "subharmonic",
    "switch",
)
#: Multipliers with a magnitude this near to 1 may be double (always for free motions, else at
#: branch points): rounding moves them by its square root.
MET = 1e-2
#: Columns of estimated errors, and the columns whose size scales their rounding errors (none: the
#: estimates are relative to the motion).
ESTIMATES = {"truncation": "", "error": "order"}


def driver_of(build: Path) -> Path:
    """The driver of a build; a test may set another driver."""
    return Path(os.environ.get("VISCOVIB_SOLVE", build / "fortran" / "viscovib-solve"))


def text_of(scene: Path) -> str:
    """A scene without the groups of `viscovib sweep`."""
    return re.sub(r"^&sweep\b.*$\n?", "", scene.read_text(encoding="utf-8"), flags=re.MULTILINE)


def run_scene(driver: Path, text: str, seconds: float = 300) -> Tables:
    """Run a scene and return its results."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.nml"
        path.write_text(text, encoding="utf-8")
        done = subprocess.run(
            [driver, path, "--quiet", "--out", folder], capture_output=True, text=True,
            timeout=seconds, check=False,
        )  # fmt: skip
        found: Tables = {"exit status": np.array([str(done.returncode)])}
        for table in sorted(Path(folder).glob("*.csv")):
            kind = table.stem.removeprefix("scene").strip("_-") or "table"
            found |= {f"{kind} {name}": column for name, column in columns(table).items()}
        return found


def columns(table: Path) -> Tables:
    """Columns of a table, grouped by coordinate, shape (rows, columns)."""
    text = table.read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    head, *rows = list(csv.reader(lines))
    found: dict[str, list[np.ndarray]] = {}
    for name, cells in zip(head, zip(*rows, strict=True), strict=True):
        if name in NO_RESULTS:
            continue
        try:
            numbers = np.array([float(cell) for cell in cells])
        except ValueError:
            found[name] = [np.array(cells)]
            continue
        if name.endswith("_phase"):
            # A phase is meaningful only with its amplitude.
            size = found[name.removesuffix("_phase")].pop()
            found[name.removesuffix("_phase")] += [size * np.cos(numbers), size * np.sin(numbers)]
        else:
            group = name.removesuffix("_amplitude") if "_amplitude" in name else name.split("_")[0]
            found.setdefault(group, []).append(numbers)
    folds = re.findall(r"folds at nu =(.*)", text)
    if folds:
        found["folds"] = [np.array([float(word) for word in folds[0].split()])]
    return {name: np.column_stack(parts) for name, parts in found.items()}


def moved(new: Tables, old: Tables) -> tuple[float, str]:
    """Largest change relative to the size of its group of columns, and the name of the group."""
    if new.keys() != old.keys():
        return math.inf, f"{', '.join(sorted(new.keys() ^ old.keys()))}: in one only"
    worst, where = 0.0, ""
    for name, was in old.items():
        table, _, column = name.rpartition(" ")
        size = None
        if column in ESTIMATES:
            motion = old.get(f"{table} {ESTIMATES[column]}", np.ones(1))
            size = float(np.nanmax(np.abs(motion)))
        now = new[name]
        if column == "multiplier" and now.shape == was.shape:
            met = np.maximum(np.abs(now - 1), np.abs(was - 1)) < MET
            now, was = np.where(met, 1, now), np.where(met, 1, was)
        change = movement(now, was, size)
        if change > worst or not where:
            worst, where = change, name
    return worst, where


def movement(new: np.ndarray, old: np.ndarray, size: float | None = None) -> float:
    """Largest change over `size` (the largest number); infinite if shapes, texts or NaN differ."""
    if new.shape != old.shape or new.dtype.kind != old.dtype.kind:
        return math.inf
    if new.dtype.kind == "U":
        return 0.0 if (new == old).all() else math.inf
    lost = np.isnan(old)
    if (np.isnan(new) != lost).any():
        return math.inf
    if lost.all():
        return 0.0
    # Equal infinities count as unchanged.
    gap = np.where(new == old, 0.0, np.abs(new - old))[~lost].max()
    if size is None:
        size = float(np.abs(old[~lost]).max())
    return float(gap / size) if size > 0 else float(gap)


def numbers_of(text: str) -> Iterator[tuple[str, int, int]]:
    """Each real input of a scene: its name, and the start and end of its digits."""
    number = re.compile(r"(?<![\w.^*])[+-]?(?:\d+\.?\d*|\.\d+)(?:[ed][+-]?\d+)?(?![\w.^])", re.I)
    at, key, group = 0, "", ""
    for line in text.splitlines(keepends=True):
        # Comments are replaced by blanks, so that positions do not change.
        body = re.sub(r"!.*", lambda m: " " * len(m.group()), line)
        spots = [(m.start(), "key", m.group(1).strip().lower(), m)
                 for m in re.finditer(r"(&\w+|[A-Za-z_]\w*(?=\s*=))", body)]  # fmt: skip
        spots += [(m.start(), "number", m.group(), m) for m in number.finditer(body)]
        for start, kind, word, match in sorted(spots, key=lambda spot: spot[0]):
            if kind == "key":
                if word.startswith("&"):
                    group = word[1:]
                else:
                    key = word
            elif group == "scene" or key in COUNTS:
                continue
            elif float(word.lower().replace("d", "e")) != 0:
                yield f"{group}.{key}", at + start, at + match.end()
        at += len(line)


def changed(text: str, start: int, end: int, value: float) -> str:
    """The scene with another number at this position."""
    return f"{text[:start]}{value!r}{text[end:]}"
