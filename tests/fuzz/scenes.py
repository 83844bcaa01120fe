"""Scenes for the driver: generated from the grammar, mutated, and damaged as text.

Each build of the driver runs the same scene in turn.
"""

import csv
import math
import os
import random
import re
import shutil
from pathlib import Path

from grammar import ROOT, SCENES, Grammar, Key, Scene, learn, parse, text_of
from verdicts import SECONDS, Case, Ending, run

#: Builds: name, driver, and whether its address space may be limited.
BUILDS = {
    "release": (ROOT / "build/release/fortran/viscovib-solve", True),
    "debug": (ROOT / "build/debug/fortran/viscovib-solve", True),
    "sanitize": (ROOT / "build/sanitize/fortran/viscovib-solve", False),
}
#: The sanitizers abort at the first finding with a signal.
_SANITIZERS = {
    "ASAN_OPTIONS": "abort_on_error=1:detect_leaks=0:hard_rss_limit_mb=2048",
    "UBSAN_OPTIONS": "halt_on_error=1:abort_on_error=1:print_stacktrace=1",
}
#: Note of the debug build about array copies, which is not a message of the driver.
_NOTE = re.compile(r"(At line .*\n)?Fortran runtime warning: .*\n\s*")
#: Limits for a run, well below the limits of a case.
_LIMITS = ["--max-memory", "1", "--max-seconds"]

_USUAL = ["0", "1", "2", "3", "0.5", "0.1", "1e-3", "10", "7", "-1", "-0.5", "0.05", "100"]
_NASTY = [
    "1e-308", "5e-324", "1.8e308", "1.7e308", "1.7976931348623157e308", "-1.7e308", "1e-160",
    "1e160", "1e150", "1e77", "-0", "2147483647", "-2147483647", "-2147483648", "2147483648",
    "1e999", "nan", "inf", "65536", "1e-16", "1e9", "1e12", "46341", "-1e-9", "1e15", "99999",
    "100000", "1000000", "1e-5", "1e5", "-1e5", "1d0", ".5", "1e-13", "1e6", "20", "64",
]  # fmt: skip
_TEXTS = [
    "'x'", "'phi'", "''", "' '", "'both'", "'auto'", "'x^3'", "'all'", "'yes'", "'no'",
    "'" + "(" * 120 + "x'", "'(x+1)^15'", "'x*x*x - 0.1*x^5'", "'" + "x" * 500 + "'",
    "'tanh(x)/(1e-3 + x^2)'", "'where(x > 0, log(x), exp(-x))'", "'min(x, max(-x, 1e308))'",
    "'sqrt(x - 2)'", "'" + "tanh(" * 80 + "x" + ")" * 80 + "'", "'x^0.5'", "'1/x'", "'exp(700*x)'",
    "'where(x, x)'", "'sin()'", "'x > 0'",
    "'mount.mass'", "'load(2).amplitude'", "'../k.csv'", "'/etc/passwd'", "'k.csv'", "'k.csv '",
    "'pipe'", "'caf\u00e9'", '"it\'s"', "'it''s'",
]  # fmt: skip
#: A file outside of the folder of the scene, and kinds of tables.
_PRECIOUS = "precious:x:0\n"
_KINDS = (
    "response", "branch", "backbone", "transient", "multiple_scales", "modes", "spectrum", "event",
    "basins", "steady", "shock_spectrum",
)  # fmt: skip
_FILES = {"k.csv": b"0 0.2\n1, 0.1\n# note\n2 0.05\n"}


class Scenes:
    """The part of the fuzzer that runs scenes with the driver."""

    name = "scenes"

    def __init__(self, folder: Path, builds: list[str]) -> None:
        self.folder = folder
        self.builds = [name for name in builds if BUILDS[name][0].exists()]
        if not self.builds:
            raise SystemExit("fuzz: no driver is built")
        self.grammar = learn(BUILDS[self.builds[0]][0], ROOT / "build/fuzz/grammar.json")
        samples = [parse(path.read_text()) for path in sorted(SCENES.glob("*.nml"))]
        self.seeds = self.grammar.seeds + samples
        self.texts = [path.read_bytes() for path in sorted(SCENES.glob("*.nml"))]

    def case(self, rng: random.Random, seed: str) -> Case:
        """One scene with one of the builds."""
        draw = rng.random()
        if draw < 0.06:
            content = torn(rng, rng.choice(self.texts))
        elif draw < 0.15:
            content = text_of(grown(rng, self.grammar)).encode()
        else:
            content = text_of(mutated(rng, rng.choice(self.seeds), self.grammar)).encode()
        build = rng.choice(self.builds)
        driver, bounded = BUILDS[build]
        hostile = rng if rng.random() < 0.1 else None
        return drive(content, driver, self.folder, seed, bounded=bounded, hostile=hostile)


def drive(
    content: bytes,
    driver: Path,
    folder: Path,
    seed: str,
    *,
    bounded: bool = True,
    hostile: random.Random | None = None,
    seconds: float = 3.0,
) -> Case:
    """Run a driver on a scene with this limit of time and check what it does.

    With `hostile`, its folder contains links and pipes.
    """
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name, text in {**_FILES, "scene.nml": content}.items():
        (folder / name).write_bytes(text)
    if hostile is not None:
        _plant(hostile, folder)
    command = [str(driver), "scene.nml", "--out", "out", *_LIMITS, f"{seconds:g}"]
    patience = SECONDS * seconds / 3.0
    done = run(command, folder, address_space=bounded, seconds=patience, environment=_SANITIZERS)
    err = _NOTE.sub("", done.err)
    ending = done.ending() or _verdict(done.status, done.out, err) or _tables(folder / "out")
    # The debug build traps an overflow.
    if "debug" in driver.parts and ending and "SIGFPE" in ending.detail:
        ending = Ending("trapped", ending.detail)
    if ending is None:
        warned = done.status == 1 or "warning:" in err
        ending = Ending("done with warnings" if warned else "done")
        if "stopped:" in done.out + done.err:
            ending = Ending("stopped at a given limit")
        elif done.status > 1:
            ending = Ending("refused with a line", err.strip())
    if hostile is not None:
        if _PRECIOUS in done.out + done.err:
            ending = Ending("message", "a file outside of the folder is shown")
        elif (folder.parent / "precious").read_text() != _PRECIOUS:
            ending = Ending("not kept", "a file outside of the folder is changed")
    how = " ".join(["VISCOVIB_SOLVE", *command[1:], "  by", *driver.parts[-4:]])
    return Case("scenes", seed, ending, how, {"scene.nml": content})


def _plant(rng: random.Random, folder: Path) -> None:
    """Replace a table that is read, or tables that are written, by links and pipes."""
    outside, table = folder.parent / "precious", folder / "k.csv"
    outside.write_text(_PRECIOUS)
    table.unlink()
    target = rng.choice(["pipe", "/dev/zero", "../precious", outside, "k.csv", ".", "nothing"])
    os.mkfifo(table) if target == "pipe" else table.symlink_to(target)
    (folder / "out").mkdir()
    for kind in _KINDS:
        for ending in (".csv", ".csv.part"):
            target = rng.choice(["../../precious", outside, "nothing", ".", None])
            if target is not None:
                (folder / "out" / f"scene_{kind}{ending}").symlink_to(target)


def _verdict(status: int, out: str, err: str) -> Ending | None:
    """Check the exit status and the output."""
    if not 0 <= status <= 3:
        return Ending("exit status", f"{status} {err[:2000]}")
    said = [line for line in err.splitlines() if not line.startswith("warning: ")]
    if len(said) > 1 or any(len(line) > 2000 for line in said):
        return Ending("message", err[:2000])
    if (len(said) == 1) != (status > 1) and not (status == 1 and said and "stopped:" in said[0]):
        return Ending("message", f"status {status} and {err[:500]!r}")
    if status <= 1 and len(out.splitlines()) > 1:
        return Ending("message", out[:500])
    return None


def _tables(out: Path) -> Ending | None:
    """Check the files of the output folder."""
    if not out.exists():
        return None
    for path in sorted(out.rglob("*")):
        if path.suffix == ".part" and not path.is_symlink():
            return Ending("part left", path.name)
        if path.suffix == ".csv" and not path.is_symlink() and (fault := not_finite(path)):
            return Ending("not finite", f"{path.name}: {fault}")
    return None


#: Columns that may be NaN in a successful row, and the column that explains it: the stability is
#: unknown, or the multiplier overflows.
_UNKNOWN = {"multiplier": ("stable", ("-1", "0"))}

#: Without these, and with the same number of commas per line, all numbers of a table are finite.
_SUSPECT = re.compile(r"nan|inf|\"|\n\r?\n", re.IGNORECASE)


def not_finite(path: Path) -> str:
    """Location of a non-finite number in a successful row; empty if there is none."""
    head, rows = [], []
    with path.open(newline="") as file:
        for line in file:
            (head if line.startswith("#") else rows).append(line)
    if not rows:
        return "no header"
    commas = rows[0].count(",")
    if not _SUSPECT.search("".join(rows)) and all(line.count(",") == commas for line in rows):
        return ""
    lines = list(csv.reader(rows))
    names = lines[0]
    went_well = "outcome" not in names and any("completed" in line for line in head)
    for i, row in enumerate(lines[1:]):
        if len(row) != len(names):
            return f"row {i}: {len(row)} columns of {len(names)}"
        found = dict(zip(names, row, strict=True))
        if "outcome" in found:
            went_well = found["outcome"] in ("converged", "completed")
        if not went_well:
            continue
        for name, text in found.items():
            other, unknown = _UNKNOWN.get(name, ("", ()))
            if found.get(other) in unknown and not math.isinf(float(text)):
                continue
            if _is_number(text) and not math.isfinite(float(text)):
                return f"row {i}: {name} = {text}"
    return ""


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def value(rng: random.Random, key: Key | None, before: str = "") -> str:
    """A value for a key: valid, unusual or wrong."""
    draw = rng.random()
    if key and key.words and draw < 0.8:
        return f"'{rng.choice(key.words)}'"
    if (key and key.text and draw < 0.7) or draw < 0.05:
        return rng.choice(_TEXTS)
    words = before.split() or ["1"]
    if draw < 0.35:
        words[rng.randrange(len(words))] = rng.choice(_NASTY)
    elif draw < 0.75:
        words = [rng.choice(_USUAL) if rng.random() < 0.5 else word for word in words]
    elif draw < 0.85:
        words = [f"{math.copysign(10 ** rng.uniform(-6, 6), rng.random() - 0.2):.6g}"]
        words *= max(1, len(before.split()))
    elif draw < 0.92:
        words = words[: rng.randrange(len(words) + 1)] or [rng.choice(_NASTY)]
    elif draw < 0.97:
        words = [*words, rng.choice(_USUAL)]
    else:
        words = [f"{rng.choice([2, 3, 70, 1000, 300000])}*{rng.choice(_USUAL)}"]
    return " ".join(words)


def mutated(rng: random.Random, seed: Scene, grammar: Grammar) -> Scene:
    """A valid scene with a few changes."""
    scene = [(name, dict(keys)) for name, keys in seed]
    for _ in range(rng.choice([1, 1, 1, 2, 2, 3, 5])):
        if not scene:
            break
        i = rng.randrange(len(scene))
        name, keys = scene[i]
        known = grammar.groups.get(name, {})
        draw = rng.random()
        if draw < 0.6 and keys:
            key = rng.choice(sorted(keys))
            keys[key] = value(rng, known.get(key), keys[key])
        elif draw < 0.8 and known:
            key = rng.choice(sorted(known))
            keys[key] = value(rng, known[key], keys.get(key, ""))
        elif draw < 0.86 and keys:
            del keys[rng.choice(sorted(keys))]
        elif draw < 0.9:
            scene.insert(rng.randrange(len(scene) + 1), (name, dict(keys)))
        elif draw < 0.93:
            del scene[i]
        else:
            scene.append(rng.choice(rng.choice(grammar.seeds)))
            scene[-1] = (scene[-1][0], dict(scene[-1][1]))
    return scene


def grown(rng: random.Random, grammar: Grammar) -> Scene:
    """Random groups and keys, most of them from scenes with this group."""
    system = rng.choice(["mount", "system", "structure", "pendulum"])
    results = ["response", "branch", "backbone", "transient", "multiple_scales"]
    wanted = [system, rng.choice(results)]
    for name in ("kernel", "load", "spring", "force", "element", "spectrum", "scene", "sweep"):
        wanted += [name] * (rng.random() < 0.4) * rng.randint(1, 2)
    scene: Scene = []
    for name in wanted:
        known = grammar.groups.get(name, {})
        samples = [keys for seed in grammar.seeds for other, keys in seed if other == name]
        keys = dict(rng.choice(samples)) if samples else {}
        for key in rng.sample(sorted(known), min(len(known), rng.randint(0, 3))):
            keys[key] = value(rng, known[key], keys.get(key, ""))
        scene.append((name, keys))
    rng.shuffle(scene)
    return scene


def torn(rng: random.Random, text: bytes) -> bytes:
    """Bytes changed, omitted or doubled; long and deeply nested pieces inserted."""
    found = bytearray(text)
    for _ in range(rng.randint(1, 6)):
        at = rng.randrange(len(found) + 1)
        draw = rng.random()
        if draw < 0.3 and at < len(found):
            found[at] = rng.randrange(256)
        elif draw < 0.5:
            del found[at : at + rng.randint(1, 20)]
        elif draw < 0.7:
            found[at:at] = rng.choice([b"'", b'"', b"/", b"&", b"=", b"!", b",", b"\n", b"*", b"("])
        elif draw < 0.8:
            found[at:at] = found[at : at + rng.randint(1, 200)]
        else:
            found[at:at] = _long_piece(rng)
    return bytes(found)


def _long_piece(rng: random.Random) -> bytes:
    """A long text, up to a megabyte."""
    n = int(10 ** rng.uniform(1, 5.5))
    piece = rng.choice(
        [b"1 ", b"a=1 ", b"&load amplitude=1 /\n", b"'", b"''", b"'x' ", b"x", b",", b"\n", b"(",
         b"&force law='x^3' /\n", b"&spring stiffness=1 /\n", b"9", b"1*", b"300000*1 ",
         b"&kernel kind='prony' weights=1 rates=1 /\n",  b"!", b"-", b"(x+1)*", b"&sweep ",
     b"tanh(", b"where(x > 0, ", b"&force law='sin(x)' /\n",
         b"\xc3\xa9"]
    )  # fmt: skip
    return piece * min(n, 1_000_000 // len(piece))


def parts(folder: Path, builds: list[str]) -> list[Scenes]:
    """Parts of the fuzzer in this module."""
    return [Scenes(folder / "scenes", builds)]
