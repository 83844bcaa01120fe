#!/usr/bin/env python3
"""Which compilers build the core, pass the Fortran suites, and how fast they make it.

`packaging/compilers.py [--fortran COMPILER]...` makes a table of (compiler, build) against (suites
passed, speed of the driver relative to the first compiler). Builds are kept in build/compilers.
"""

import argparse
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BUILDS = ROOT / "build" / "compilers"
KNOWN = ("gfortran", "gfortran-13", "gfortran-14", "flang-new-19", "flang-22")
#: Runs of the driver that are timed.
SCENE = ROOT / "data" / "scenes" / "mount_paper.nml"


def suites() -> list[str]:
    """Return the names of the Fortran suites."""
    return sorted(path.stem.removeprefix("test_") for path in ROOT.glob("tests/fortran/test_*.f90"))


def build(compiler: str) -> tuple[Path, str]:
    """Build with a compiler; the folder, and what failed."""
    folder = BUILDS / Path(compiler).name
    environment = os.environ | {"FC": compiler}
    if not (folder / "build.ninja").exists():
        options = ("--buildtype=release", "-Dpython=false", "-Dtests=true")
        done = subprocess.run(
            ["meson", "setup", str(folder), *options],
            cwd=ROOT,
            env=environment,
            capture_output=True,
            text=True,
        )
        if done.returncode:
            return folder, "cannot be set up: " + done.stdout.strip().splitlines()[-1]
    done = subprocess.run(["ninja", "-C", str(folder)], capture_output=True, text=True)
    (folder / "said.txt").write_text(done.stdout)
    return folder, "" if done.returncode == 0 else f"does not build ({folder}/said.txt)"


def passed(folder: Path, seconds: float) -> tuple[list[str], list[str]]:
    """Run each suite in a process of its own; those that pass, and those that do not."""
    good, bad = [], []
    for suite in suites():
        try:
            done = subprocess.run(
                [str(folder / "tests/fortran/viscovib-tester"), suite],
                capture_output=True,
                timeout=seconds,
            )
            (good if done.returncode == 0 else bad).append(suite)
        except subprocess.TimeoutExpired:
            bad.append(f"{suite} (over {seconds:g} s)")
    return good, bad


def speeds(folders: list[Path], turns: int) -> list[float]:
    """Return the time of the first driver by that of each, medians of alternate runs."""
    taken: list[list[float]] = [[] for _ in folders]
    with tempfile.TemporaryDirectory() as out:
        for _ in range(turns):
            for i, folder in enumerate(folders):
                driver = folder / "fortran" / "viscovib-solve"
                begin = time.perf_counter()
                subprocess.run([str(driver), str(SCENE), "--out", out, "--quiet"], check=False)
                taken[i].append(time.perf_counter() - begin)
    return [statistics.median(a / b for a, b in zip(taken[0], each, strict=True)) for each in taken]


def main() -> int:
    """Print the table; the exit status is 1 if a suite fails."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fortran", action="append", default=[], help="a compiler to try")
    parser.add_argument("--turns", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=300.0, help="for one suite")
    options = parser.parse_args()
    tried = options.fortran or [one for one in KNOWN if shutil.which(one)]
    rows, built = [], []
    for compiler in tried:
        folder, fault = build(compiler)
        if fault:
            rows.append((compiler, fault, None))
            continue
        good, bad = passed(folder, options.seconds)
        told = f"{len(good)} of {len(good) + len(bad)}"
        rows.append((compiler, told + (f", not {', '.join(bad)}" if bad else ""), len(built)))
        built.append(folder)
    ratios = speeds(built, options.turns) if built else []
    print("| compiler | suites passed | speed |\n| --- | --- | --- |")
    for compiler, told, place in rows:
        speed = "" if place is None else f"{ratios[place]:.2f}"
        print(f"| {compiler} | {told} | {speed} |")
    for compiler in KNOWN:
        if compiler not in tried:
            print(f"| {compiler} | untested: not on this machine | |")
    return int(any("not" in told for _, told, _ in rows))


if __name__ == "__main__":
    sys.exit(main())
