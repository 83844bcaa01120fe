#!/usr/bin/env python3
"""Test results and speed of builds with several compilers: `packaging/compilers.py`.

The table has a row for each (compiler, Python, build). The row of a compiler states the passed
Fortran suites and the speed of the driver relative to that of the first compiler (median of
alternate runs). The row of a wheel states whether the first example of the README runs, and the
speed measured by `./run bench --wheel`. Builds are kept in build/compilers.
"""

import argparse
import csv
import os
import re
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
#: Number of timed runs of the driver.
SCENE = ROOT / "data" / "scenes" / "mount_paper.nml"


def suites() -> list[str]:
    """Return the names of the Fortran suites."""
    named = ((path.stem.removeprefix("test_"), path) for path in ROOT.glob("tests/fortran/test_*"))
    return sorted(name for name, path in named if f"public :: run_{name}" in path.read_text())


def version(compiler: str) -> str:
    """Return the name and version of a compiler, as it prints them."""
    said = subprocess.run([compiler, "--version"], capture_output=True, text=True).stdout
    found = re.search(r"\d+\.\d+\.\d+", said)
    return f"{Path(compiler).name.split('-')[0]} {found[0] if found else 'of unknown version'}"


def build(compiler: str) -> tuple[Path, str]:
    """Build with a compiler; return the folder, and the error."""
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
    """Run each suite in a separate process; return the suites that pass and those that fail."""
    good: list[str] = []
    bad: list[str] = []
    for suite in suites():
        try:
            done = subprocess.run(
                [str(folder / "tests/fortran/viscovib-tester"), suite],
                capture_output=True,
                text=True,
                timeout=seconds,
            )
            # The suite "skips" counts work, which only the debug build does.
            if "\n0 passed, 0 failed" in f"\n{done.stdout}":
                continue
            (good if done.returncode == 0 else bad).append(suite)
        except subprocess.TimeoutExpired:
            bad.append(f"{suite} (over {seconds:g} s)")
    return good, bad


def speeds(folders: list[Path], turns: int) -> list[float]:
    """Return the time of the first driver divided by that of each, medians of alternate runs."""
    taken: list[list[float]] = [[] for _ in folders]
    with tempfile.TemporaryDirectory() as out:
        for _ in range(turns):
            for i, folder in enumerate(folders):
                driver = folder / "fortran" / "viscovib-solve"
                begin = time.perf_counter()
                subprocess.run([str(driver), str(SCENE), "--out", out, "--quiet"], check=False)
                taken[i].append(time.perf_counter() - begin)
    return [statistics.median(a / b for a, b in zip(taken[0], each, strict=True)) for each in taken]


def wheel_row(wheel: Path | None, table: Path) -> tuple[str, str, str, str, str] | None:
    """Return the row of a wheel: first example of the README in a new environment, and speed."""
    if wheel is None:
        return None
    environment = ROOT / "build" / "compilers" / "wheel-environment"
    python = environment / "bin" / "python"
    subprocess.run([sys.executable, "-m", "venv", "--clear", str(environment)], check=True)
    install = [str(python), "-m", "pip", "install", "-q", "--only-binary", ":all:", str(wheel)]
    # The path contains Python only, so that no compiler is found.
    bare = {"PATH": str(python.parent), "HOME": tempfile.gettempdir()}
    told = "does not install"
    if subprocess.run(install, env=bare).returncode == 0:
        example = [str(python), str(ROOT / "packaging" / "first_example.py")]
        with tempfile.TemporaryDirectory() as folder:
            good = subprocess.run(example, env=bare, cwd=folder, stdout=subprocess.DEVNULL)
        told = "README's first example" + (" runs" if good.returncode == 0 else ": not run")
    speed = ""
    if table.exists():
        with open(table, newline="") as file:
            ratios = [float(row["speed"]) for row in csv.DictReader(file)]
        speed = f"{min(ratios):.2f} to {max(ratios):.2f}"
    number = ".".join(map(str, sys.version_info[:2]))
    return version("gfortran"), number, f"wheel {wheel.stem.split('-')[-1]}", told, speed


def compiler_rows(tried: list[str], turns: int, seconds: float) -> list[tuple[str, ...]]:
    """Return the rows of the compilers."""
    rows: list[tuple[str, ...]] = []
    built: list[Path] = []
    for compiler in tried:
        folder, fault = build(compiler)
        if fault:
            rows.append((version(compiler), "", "release", fault))
            continue
        good, bad = passed(folder, seconds)
        told = f"{len(good)} of {len(good) + len(bad)} suites"
        rows.append(
            (version(compiler), "", "release", told + (f", not {', '.join(bad)}" if bad else ""))
        )
        built.append(folder)
    ratios = iter(speeds(built, turns) if built else [])
    return [(*row, f"{next(ratios):.2f}" if "suites" in row[3] else "") for row in rows]


def main() -> int:
    """Print the table; the exit status is 1 if a suite fails."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fortran", action="append", default=[], help="a compiler to try")
    parser.add_argument("--turns", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=300.0, help="for one suite")
    parser.add_argument("--wheel", type=Path, help="a wheel to install and try too")
    parser.add_argument(
        "--speeds", type=Path, default=ROOT / "out/bench/wheel.csv", help="of ./run bench --wheel"
    )
    options = parser.parse_args()
    tried = options.fortran or [one for one in KNOWN if shutil.which(one)]
    rows = compiler_rows(tried, options.turns, options.seconds)
    if row := wheel_row(options.wheel, options.speeds):
        rows.append(row)
    rows += [(one, "", "release", "untested: not here", "") for one in KNOWN if one not in tried]
    print("| compiler | Python | build | passed | speed |\n| --- | --- | --- | --- | --- |")
    for each in rows:
        print(f"| {' | '.join(each)} |")
    return int(any("not " in row[3] and "untested" not in row[3] for row in rows))


if __name__ == "__main__":
    sys.exit(main())
