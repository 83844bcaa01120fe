"""Parts of the benchmark in separate processes with time limits; tables in files."""

import csv
import os
import pickle
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from timing import machine, versions

Row = dict[str, Any]
#: Lines of the page, and rows of run time against error by problem.
Part = tuple[list[str], dict[str, list[Row]]]


def write_csv(path: Path, rows: list[Row]) -> None:
    """Write rows below a header about the machine."""
    with open(path, "w", newline="", encoding="utf-8") as file:
        file.write(f"# {machine()}\n# {versions()}\n")
        writer = csv.DictWriter(file, list(dict.fromkeys(key for row in rows for key in row)))
        writer.writeheader()
        writer.writerows(rows)


def keep(out: Path, name: str, part: Part) -> None:
    """Store the result of a part for the parent process."""
    (out / f".{name}.pickle").write_bytes(pickle.dumps(part))


def run_parts(
    program: Path, out: Path, limits: dict[str, float]
) -> tuple[dict[str, Part], list[str]]:
    """Results of all parts, and a line for each part that failed or exceeded its limit."""
    found: dict[str, Part] = {}
    lost: list[str] = []
    begun = time.monotonic()
    for i, (name, limit) in enumerate(limits.items()):
        spent = time.monotonic() - begun
        print(f"== {i + 1} of {len(limits)}: {name} ({spent:.0f} s so far, at most {limit:.0f} s "
              "for this part)", flush=True)  # fmt: skip
        kept = out / f".{name}.pickle"
        kept.unlink(missing_ok=True)
        part = [str(program), "--part", name, "--out", str(out)]
        ended = run_one([sys.executable, "-u", *part], limit)
        if ended == "" and kept.exists():
            found[name] = pickle.loads(kept.read_bytes())
            kept.unlink()
        else:
            lost.append(f"{name}: {ended or 'gave nothing'}, left out")
            print(lost[-1], flush=True)
    print(f"== done: {len(found)} of {len(limits)} parts, {time.monotonic() - begun:.0f} s")
    return found, lost


def run_one(command: list[str], limit: float) -> str:
    """Run a command; return None or an error text. Its child processes end with it."""
    with subprocess.Popen(command, start_new_session=True) as process:
        try:
            code = process.wait(timeout=limit)
        except BaseException as error:
            os.killpg(process.pid, signal.SIGKILL)
            if isinstance(error, subprocess.TimeoutExpired):
                return f"ended after {limit:.0f} s"
            raise
    return f"exit status {code}" if code else ""
