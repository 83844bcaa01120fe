"""Effect of compiler flags: results of several builds of the library compared.

The reference build is that of `./run` (build/release: -O3 for this machine); other builds are in
build/stress-NAME. The driver of each build runs the scenes of data/scenes and some scenes
that must fail or end without a solution. The compiled core of each build computes the results of
built.py. Changes are relative to the largest number of a result. -ffast-math is measured without a
limit, since no release is built with it.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from driven_scenes import ROOT, SCENES, Tables, driver_of, moved, movement, run_scene, text_of
from scenes import far
from steps import Job
from tally import Row, Tally

OURS, UNSAFE = "release", "fast-math"
#: Meson options of each build by name.
BUILDS = {
    OURS: ["-Dbuildtype=release"],
    "O0": ["-Doptimization=0"],
    "O2": ["-Doptimization=2"],
    "O3-generic": ["-Doptimization=3", "-Dnative=false"],
    UNSAFE: ["-Doptimization=3", "-Dunsafe_math=true"],
}
DATA = ROOT / "data"
#: Allowed changes: the worst conditioned result (stability at the boundary) has a condition of 1e3,
#: the longest motion accumulates 1e6 rounding errors.
LIMIT = 1e-11
MOUNT = "&mount mass = 1, inertia = 0.1, offset = 0.5, stiffness_x = 10, stiffness_phi = 2 /\n"
LINEAR = "&response method = 'linear', nu = 1 /\n"
#: Scenes that must be refused (status 2) or end without a solution (status 1).
DELICATE = {
    "load is NaN": (MOUNT + "&load amplitude = nan /\n" + LINEAR, "2"),
    "stiffness is infinite": (
        MOUNT.replace("10", "1e999") + "&load amplitude = 1 /\n" + LINEAR, "2",
    ),
    "driven at its natural frequency": (
        "&system coordinates = 'x', mass = 1, stiffness = 4 /\n&load amplitude = 1 /\n"
        "&response method = 'linear', nu = 2 /\n", "1",
    ),
    "far beyond convergence": (
        MOUNT + "&kernel kind = 'rzhanitsyn', amplitude = 0.048, alpha = 0.1, beta = 0.05 /\n"
        "&load amplitude = 1e6 /\n&response method = 'successive', nu = 0.7 1.5 3.0 /\n", "1",
    ),
    "load that overflows": (
        MOUNT + "&load amplitude = 1e307 /\n&response method = 'successive', nu = 0.7 1.5 /\n", "1",
    ),
}  # fmt: skip


def jobs(quick: bool) -> Iterator[tuple[str, Job]]:
    """The builds, then one job per result; the quick form omits slow builds."""
    if quick:
        return
    study = Study()
    for name in BUILDS:
        yield f"flags, {name}", lambda name=name: study.of_build(name)
    for scene in SCENES:
        yield f"flags, {scene.name}", lambda scene=scene: study.of_scene(scene)
    yield "flags, delicate", study.of_delicate
    from built import results

    for name in results():
        yield f"flags, {name}", lambda name=name: study.of_result(name)


def build(name: str) -> Path:
    """Configure and compile one build; return its folder."""
    if name == OURS:
        return ROOT / "build" / OURS
    folder = ROOT / "build" / f"stress-{name}"
    options = ["-Dbuildtype=plain", "-Ddebug=false", "-Dtests=false", *BUILDS[name]]
    known = [folder] if (folder / "build.ninja").exists() else ["--", folder]
    verb = ["configure"] if len(known) == 1 else ["setup"]
    for command in (["meson", *verb, *options, *known], ["ninja", "-C", folder]):
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        if done.returncode:
            lines = (done.stdout + done.stderr).splitlines()
            raise RuntimeError(f"build {name}: " + " ".join(lines[-3:]))
    return folder


def computed(folder: Path) -> Tables:
    """Results of built.py with a build."""
    with tempfile.TemporaryDirectory() as place:
        out = Path(place) / "results.npz"
        subprocess.run(
            [sys.executable, Path(__file__).parent / "built.py", folder, out], check=True,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
        )  # fmt: skip
        with np.load(out) as found:
            return {name: found[name] for name in found.files}


def references() -> dict[str, np.ndarray]:
    """Values of independent programs, by the names of built.py."""
    memory = json.loads((DATA / "mount_memory_reference.json").read_text())
    (late,) = [c for c in memory["time_domain"] if c["nonlinear"] and c["nu"] and c["t"] == 100]
    pendulum = json.loads((DATA / "pendulum_time_reference.json").read_text())
    state = np.array([float(text) for text in pendulum["P1r"]["states"]["200"]])
    folds = json.loads((DATA / "mount_periodic_reference.json").read_text())["folds_nu"]
    return {
        "motion with memory at t = 100": np.array([float(text) for text in late["value"]]),
        "motion of the pendulum at t = 200": state,
        "the same by verner9": state,
        "folds of the branch": np.array([float(nu) for nu in folds]),
        "kernel transforms": np.ones(1080),
        "energy after 1e6 undamped steps of gauss2": np.ones(1),
    }


class Study:
    """Results of every build, for the rows of the table."""

    def __init__(self) -> None:
        self.scenes: dict[str, dict[str, Tables]] = {}
        self.results: dict[str, Tables] = {}
        self.references = references()

    def of_build(self, name: str) -> Row:
        """Build and run everything; this row only states whether the build succeeded."""
        tally = Tally("compiler flags", "build", " ".join(BUILDS[name]), 0.5, "builds that failed")
        folder = tally.trial(name, lambda: build(name))
        tally.measure(name, float(folder is None))
        if folder is not None:
            driver = driver_of(folder)
            texts = {scene.name: text_of(scene) for scene in SCENES}
            texts |= {what: text for what, (text, _) in DELICATE.items()}
            self.scenes[name] = {what: run_scene(driver, text) for what, text in texts.items()}
            self.results[name] = computed(folder)
        return tally.row()

    def others(self) -> list[str]:
        """Builds to compare with the reference build, -ffast-math last."""
        return [name for name in BUILDS if name != OURS and name in self.results]

    def of_scene(self, scene: Path) -> Row:
        """Tables of the driver."""
        ours = self.scenes[OURS][scene.name]
        tally = Tally("compiler flags", f"scene {scene.stem}", ", ".join(self.others()), LIMIT,
                      "movement over the size of the column")  # fmt: skip
        for name in self.others():
            self._judge(tally, name, *moved(self.scenes[name][scene.name], ours))
        return tally.row()

    def of_result(self, what: str) -> Row:
        """One result of built.py."""
        ours = self.results[OURS][what]
        tally = Tally("compiler flags", what, ", ".join(self.others()), LIMIT,
                      "movement over the size of the result")  # fmt: skip
        tally.check(OURS, ours.dtype.kind != "U", str(ours))
        for name in self.others():
            self._judge(tally, name, movement(self.results[name][what], ours), "")
        exact = self.references.get(what)
        if exact is not None:
            errors = [
                f"{name} {far(found[what], exact):.1e}"
                for name, found in self.results.items()
                if found[what].shape == exact.shape
            ]
            tally.notes.append("error against the reference: " + ", ".join(errors))
        return tally.row()

    def of_delicate(self) -> Row:
        """Scenes that must be refused, or end without a solution."""
        tally = Tally("compiler flags", "scenes without a solution", ", ".join(BUILDS), 0.5,
                      "scenes that end otherwise than they must")  # fmt: skip
        for name, found in self.scenes.items():
            lost = [
                what
                for what, (_, status) in DELICATE.items()
                if found[what]["exit status"][0] != status
            ]
            if name == UNSAFE:
                tally.notes.append(f"{name}: {len(lost)} of them: {', '.join(lost) or 'none'}")
            else:
                tally.trial(name, lambda: None)
                tally.measure(", ".join([name, *lost]), len(lost))
        return tally.row()

    def _judge(self, tally: Tally, name: str, change: float, where: str) -> None:
        tally.notes.append(f"{name} {change:.1e}" + (f" ({where})" if where else ""))
        if name != UNSAFE:
            tally.trial(name, lambda: None)
            tally.measure(name, change)
