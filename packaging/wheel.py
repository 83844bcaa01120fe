#!/usr/bin/env python3
"""Make portable wheels: `./run wheel [--python PYTHON]... [--out FOLDER]`.

The core is compiled once for each instruction level, as a shared library and as a driver. For each
Python a thin extension is built, and all parts are put into one wheel. The dynamic loader selects
the library of the highest level that the machine supports (glibc-hwcaps, since glibc 2.33; older
versions use the lowest level). auditwheel then adds the run-time libraries and determines the tag.
"""

import argparse
import base64
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BUILD = ROOT / "build" / "wheel"
#: The first level is for every machine; the other levels are used if they are supported.
LEVELS = ("x86-64-v2", "x86-64-v3", "x86-64-v4")
CORE = "libviscovib_core.so"
PYTHONS = ("3.11", "3.12", "3.13", "3.14")

#: Other libraries in the wheel: files of their licences, and their names.
LICENCES = {
    "libgfortran": (
        "GPL-3.0-or-later WITH GCC-exception-3.1",
        "libgfortran, libquadmath and libgcc_s are the run-time libraries of GCC, under the GNU\n"
        "General Public License, version 3 or later, with the GCC Runtime Library Exception,\n"
        "version 3.1, which lets programs of any licence use them:\n"
        "https://www.gnu.org/licenses/gcc-exception-3.1.html\n"
        "libquadmath is under the GNU Lesser General Public License, version 2.1 or later.\n"
        "Sources: https://gcc.gnu.org\n",
    ),
    "libfftw3": (
        "GPL-2.0-or-later",
        "FFTW 3 is under the GNU General Public License, version 2 or later:\n"
        "https://www.gnu.org/licenses/old-licenses/gpl-2.0.html\n"
        "Copyright (c) 2003, 2007-14 Matteo Frigo and Massachusetts Institute of Technology.\n"
        "Sources: https://www.fftw.org\n"
        "A wheel with it inside may be passed on under these terms only.\n",
    ),
}

SCRIPT = """#!python
import os
import sys
from importlib.util import find_spec

driver = os.path.join(os.path.dirname(find_spec("viscovib").origin), "_core", "viscovib-solve")
os.execv(driver, [driver, *sys.argv[1:]])
"""


def run(*command: object, **options: object) -> None:
    """Run a program; on failure exit with its name and its output."""
    words = [str(word) for word in command]
    done = subprocess.run(
        words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **options
    )
    if done.returncode:
        sys.exit(f"{done.stdout[-4000:]}\nwheel.py: failed: {' '.join(words)}")


def build_level(level: str, fft: str) -> Path:
    """Compile the core and the driver for a level; return their folder."""
    folder = BUILD / f"{level}-{fft}"
    if not (folder / "build.ninja").exists():
        options = ("--buildtype=release", "-Dpython=false", "-Dnative=false")
        run("meson", "setup", folder, *options, f"-Dlevel={level}", f"-Dfft={fft}", cwd=ROOT)
    run("ninja", "-C", folder, f"fortran/{CORE}", "fortran/viscovib-solve")
    return folder / "fortran"


def pythons(named: list[str]) -> list[str]:
    """Return the interpreters for wheels: those named, else those on the path."""
    if named:
        return named
    found = [shutil.which(f"python{version}") for version in PYTHONS]
    works = [one for one in found if one and not subprocess.call([one, "-c", ""], stderr=-3)]
    return works or [sys.executable]


def thin_wheel(python: str, core: Path, folder: Path) -> Path:
    """Build the package for one Python with an existing core, in a new environment."""
    settings = [
        f"--config-settings=setup-args=-Dcore={core}",
        "--config-settings=setup-args=-Dnative=false",
    ]
    run(python, "-m", "pip", "wheel", "--no-deps", *settings, "-w", folder, ROOT)
    (wheel,) = folder.glob("*.whl")
    return wheel


def put_together(wheel: Path, built: dict[str, Path]) -> None:
    """Add the cores, the drivers and their start scripts to an unpacked wheel."""
    core = wheel / "viscovib" / "_core"
    lowest = next(iter(built))
    for level, folder in built.items():
        place = core if level == lowest else core / "glibc-hwcaps" / level
        place.mkdir(parents=True, exist_ok=True)
        shutil.copy2(folder / CORE, place)
        shutil.copy2(folder / "viscovib-solve", core / f"viscovib-solve-{level}")
    compiler = os.environ.get("CC", "cc").split()
    run(*compiler, "-O2", ROOT / "fortran/app/launcher.c", "-o", core / "viscovib-solve")
    (info,) = wheel.glob("*.dist-info")
    scripts = wheel / f"{info.stem}.data" / "scripts"
    scripts.mkdir(parents=True)
    (scripts / "viscovib-solve").write_text(SCRIPT)
    (scripts / "viscovib-solve").chmod(0o755)


def state_licences(wheel: Path) -> None:
    """State the licences of the included libraries in the metadata."""
    (info,) = wheel.glob("*.dist-info")
    inside = [path.name for path in wheel.glob("*.libs/*")]
    names = ["MIT"]
    metadata = (info / "METADATA").read_text()
    for library, (name, text) in LICENCES.items():
        if not any(one.startswith(library) for one in inside):
            continue
        names.append(name)
        (info / "licenses").mkdir(exist_ok=True)
        (info / "licenses" / f"LICENSE.{library}").write_text(text)
        metadata = metadata.replace(
            "\nLicense-File:", f"\nLicense-File: LICENSE.{library}\nLicense-File:", 1
        )
    metadata = metadata.replace(
        "\nLicense-Expression: MIT\n", f"\nLicense-Expression: {' AND '.join(names)}\n"
    )
    (info / "METADATA").write_text(metadata)
    if f"License-Expression: {' AND '.join(names)}" not in metadata:
        sys.exit("wheel.py: the metadata has no License-Expression: a newer meson-python is needed")


def pack(folder: Path, wheel: Path) -> None:
    """Write a wheel with a new RECORD."""
    (info,) = folder.glob("*.dist-info")
    record = info / "RECORD"
    rows = []
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path != record)
    for path in files:
        digest = (
            base64.urlsafe_b64encode(hashlib.sha256(path.read_bytes()).digest())
            .rstrip(b"=")
            .decode()
        )
        rows.append(
            f"{path.relative_to(folder).as_posix()},sha256={digest},{path.stat().st_size}\n"
        )
    record.write_text("".join(rows) + f"{record.relative_to(folder).as_posix()},,\n")
    with zipfile.ZipFile(wheel, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in [*files, record]:
            archive.write(path, path.relative_to(folder).as_posix())


def unpack(wheel: Path, folder: Path) -> None:
    """Unpack a wheel; file modes are kept."""
    with zipfile.ZipFile(wheel) as archive:
        for item in archive.infolist():
            path = Path(archive.extract(item, folder))
            if mode := item.external_attr >> 16:
                path.chmod(mode & 0o777)


def make(python: str, built: dict[str, Path], out: Path) -> Path:
    """Make the wheel of one Python."""
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        wheel = thin_wheel(python, built[LEVELS[0]], work / "thin")
        unpack(wheel, work / "parts")
        put_together(work / "parts", built)
        pack(work / "parts", wheel)
        # Levels above the lowest are intended.
        repair = (sys.executable, "-m", "auditwheel", "repair", "--disable-isa-ext-check")
        run(
            *repair,
            "-w",
            work / "repaired",
            wheel,
            env=os.environ | {"LD_LIBRARY_PATH": str(built[LEVELS[0]])},
        )
        (repaired,) = (work / "repaired").glob("*.whl")
        unpack(repaired, work / "whole")
        state_licences(work / "whole")
        out.mkdir(parents=True, exist_ok=True)
        pack(work / "whole", out / repaired.name)
        return out / repaired.name


def main() -> None:
    """Make all wheels and print their paths."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], prog="./run wheel")
    parser.add_argument(
        "--python", action="append", default=[], help="an interpreter to make a wheel for"
    )
    parser.add_argument(
        "--fft", choices=("fftw", "own"), default="fftw", help="the transform inside"
    )
    parser.add_argument("--out", type=Path, default=ROOT / "dist")
    options = parser.parse_args()
    if platform.machine() != "x86_64":
        sys.exit(f"wheel.py: levels are of x86-64, and this machine is {platform.machine()}")
    built = {level: build_level(level, options.fft) for level in LEVELS}
    for python in pythons(options.python):
        print(make(python, built, options.out), flush=True)


if __name__ == "__main__":
    main()
