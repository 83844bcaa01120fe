"""`./run fuzz`: random cases until the time is over, and a table of how they ended.

    ./run fuzz [--minutes N | --cases N] [--first N] [--seed S] [--parts scenes,...]
               [--builds release,release,debug]   a build named twice has twice the share
    ./run fuzz --again scenes:SEED:NUMBER

Each part of the fuzzer is a module in this folder with a function `parts(folder, builds)`. It
returns objects with a `name` and a method `case(rng, seed) -> Case` (see verdicts.py). Case n of a
part depends on the seed and n only, so a single case can be repeated. Findings are written to
OUT/findings. After the fix their scenes are added to tests/fuzz/found, which the tests run.
"""

import argparse
import importlib
import json
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from verdicts import BAD, GOOD

#: Modules with parts.
MODULES = ("scenes", "api", "checkpoints", "texts", "varied")
#: Seconds between two tables of a running session.
_PAUSE = 30.0


def main() -> int:
    """Run, print the table; the exit status is 1 if there is a finding."""
    options = _options()
    # In shared memory if possible, because a disk waits for each new file.
    memory = Path("/dev/shm")
    place = memory if os.access(memory, os.W_OK) else options.out
    with tempfile.TemporaryDirectory(prefix="viscovib-fuzz-", dir=place) as work:
        return _run(options, Path(work))


def _run(options: argparse.Namespace, work: Path) -> int:
    out: Path = options.out
    every = [part for name in MODULES for part in _parts(name, work, options.builds)]
    if options.again:
        return _again(every, options.again, out)
    chosen = [part for part in every if not options.parts or part.name in options.parts]
    tables: dict[str, Counter[str]] = {part.name: Counter() for part in chosen}
    until = time.monotonic() + 60 * options.minutes
    started = time.monotonic()
    used = dict.fromkeys(tables, 0.0)
    left = list(chosen)
    written = started
    for number in (signal.SIGINT, signal.SIGTERM):
        # For a background process of a shell, Ctrl-C would be ignored.
        signal.signal(number, signal.default_int_handler)
    while left and time.monotonic() < until:
        # All parts have the same share of the time, independent of the duration of their cases.
        part = min(left, key=lambda one: used[one.name])
        counts, began = tables[part.name], time.monotonic()
        try:
            case = _case(part, options.seed, options.first + sum(counts.values()))
        except KeyboardInterrupt:
            # An interrupted run prints its results.
            break
        used[part.name] += time.monotonic() - began
        counts[case.ending.verdict] += 1
        if time.monotonic() - written > _PAUSE:
            # Write regularly, so that a killed run loses little.
            _write(out, tables)
            written = time.monotonic()
        if not case.ending.good:
            print(f"{case.seed}: {case.ending.verdict}: {case.write(out / 'findings')}")
            print(f"  {case.ending.detail[:300]}", flush=True)
        if options.cases and sum(counts.values()) >= options.cases:
            left.remove(part)
    print(table(tables, time.monotonic() - started))
    for part in chosen:
        if hasattr(part, "reported"):
            print(part.reported())
    _write(out, tables)
    return int(any(n for counts in tables.values() for v, n in counts.items() if v in BAD))


def _write(out: Path, tables: dict[str, Counter[str]]) -> None:
    (out / "table.json").write_text(json.dumps(tables, indent=1))


def _case(part: Any, seed: str, number: int) -> Any:
    name = f"{part.name}:{seed}:{number}"
    return part.case(random.Random(name), name)


def _again(every: list[Any], which: str, out: Path) -> int:
    name, seed, number = which.split(":")
    part = next(part for part in every if part.name == name)
    case = _case(part, seed, int(number))
    print(f"{case.ending.verdict}: {case.ending.detail}\n{case.write(out / 'again')}")
    return int(not case.ending.good)


def table(tables: dict[str, Counter[str]], seconds: float) -> str:
    """Table of the endings of each part, as Markdown."""
    words = [*GOOD, *BAD]
    lines = [f"| part | cases | {' | '.join(words)} |", "| --- " * (len(words) + 2) + "|"]
    for name, counts in tables.items():
        cells = " | ".join(str(counts[word]) for word in words)
        lines.append(f"| {name} | {sum(counts.values())} | {cells} |")
    return "\n".join([*lines, f"{seconds:.0f} s"])


def _parts(name: str, folder: Path, builds: list[str]) -> list[Any]:
    module = importlib.import_module(name)
    return list(module.parts(folder, builds))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="./run fuzz", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--cases", type=int, default=0, help="of each part; 0: until time is over")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--seed", default=time.strftime("%Y%m%d"), help="today's date")
    parser.add_argument("--parts", type=lambda text: text.split(","), default=[])
    parser.add_argument(
        "--builds", type=lambda text: text.split(","), default=["release", "debug", "sanitize"]
    )
    parser.add_argument("--again", metavar="PART:SEED:NUMBER", help="repeat one case")
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"))
    options = parser.parse_args()
    options.out = options.out.resolve()
    options.out.mkdir(parents=True, exist_ok=True)
    return options


if __name__ == "__main__":
    sys.exit(main())
