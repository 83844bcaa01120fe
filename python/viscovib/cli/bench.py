"""The command ``viscovib bench``: computing time and accuracy of a scene on this machine."""

import argparse
import os
import platform
import statistics
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from viscovib import __version__, _native
from viscovib.analyses.backbones import Backbone
from viscovib.analyses.driven_branch import DrivenBranch
from viscovib.analyses.forced import forced_response
from viscovib.analyses.transient import simulate
from viscovib.cli.words import as_json
from viscovib.common.parameters import MAX_HARMONICS
from viscovib.common.results import Result
from viscovib.errors import InputError, ViscovibError
from viscovib.results.branch import Branch
from viscovib.results.response import Response
from viscovib.results.trajectory import Trajectory
from viscovib.scene.job import SceneResult, plan, run_one
from viscovib.scene.scene import Scene
from viscovib.sweeps.points import quiet

_MAX_RUNS = 100_000


@dataclass(frozen=True)
class Timing:
    """Times of repeated runs of one task (s)."""

    name: str
    seconds: tuple[float, ...]

    @property
    def best(self) -> float:
        """The shortest time, because other work on the machine only adds time."""
        return min(self.seconds)

    @property
    def median(self) -> float:
        """The median time."""
        return statistics.median(self.seconds)


@dataclass(frozen=True)
class Benchmark:
    """Measurements of a scene.

    Attributes
    ----------
    phases : tuple of Timing
        "read" the file, "plan", "compute" and "table", each alone.
    size : str
        Description of the computation, with the time per item.
    error : float or None
        Estimated error from a second, more accurate computation; None if that failed.
    compared : str
        Kind of the error and its reference.
    """

    scene: Scene
    phases: tuple[Timing, ...]
    size: str
    error: float | None
    compared: str

    def __str__(self) -> str:
        """Lines for a terminal."""
        width = max(len(phase.name) for phase in self.phases)
        lines = [
            f"{self.scene.path}: {self.size}",
            f"{'':{width}}  {'best':>10}  {'median':>10}  runs",
        ]
        lines += [
            f"{p.name:{width}}  {_time(p.best):>10}  {_time(p.median):>10}  {len(p.seconds)}"
            for p in self.phases
        ]
        error = "not estimated" if self.error is None else f"{self.error:.1e}"
        lines += [f"error {error} ({self.compared})", f"on {_machine()}"]
        return "\n".join(lines)


def measure(scene: Scene, *, seconds: float = 2.0, runs: int | None = None) -> Benchmark:
    """Time a scene: at least 3 runs within ``seconds``, or a given number of runs.

    The first run, which loads modules and fills caches, is not counted. Groups &sweep are
    ignored: one point is timed.
    """
    limit = _native.number("seconds", seconds)
    if limit <= 0:
        raise InputError(f"seconds = {limit:g}: must be greater than 0")
    count = None if runs is None else _native.integer("runs", runs, 1, _MAX_RUNS)
    one = scene.override({})
    with warnings.catch_warnings(), tempfile.TemporaryDirectory() as folder:
        quiet()
        result = run_one(one)
        value = result._single("bench: must be a single result, not a sweep")
        table = Path(folder) / "table.csv"
        share = limit / 6
        phases = (
            _timing("read", lambda: Scene.read(scene.path, allow_paths=True), share, count),
            _timing("plan", lambda: plan(one), share, count),
            _timing("compute", lambda: run_one(one), 3 * share, count),
            _timing("table", lambda: result.to_csv(table), share, count),
        )
        error, compared = _error(result)
    return Benchmark(scene, phases, _size(value, phases[2].best), error, compared)


def run_bench(options: argparse.Namespace) -> int:
    """Measure and print; return the exit status."""
    scene = Scene.read(options.scene, allow_paths=options.allow_paths)
    found = measure(scene, seconds=options.seconds, runs=options.runs)
    if not options.json:
        print(found)
        return 0
    phases = {p.name: {"best": p.best, "median": p.median, "runs": len(p.seconds)}
              for p in found.phases}  # fmt: skip
    print(as_json({"scene": options.scene, "status": 0, "size": found.size, "seconds": phases,
                   "error": found.error, "compared": found.compared}))  # fmt: skip
    return 0


def add_options(command: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    command.add_argument("--seconds", type=float, default=2.0, help="time for all of it (2)")
    command.add_argument("--runs", type=int, help="runs of each part, instead")


def _timing(name: str, what: Callable[[], Any], limit: float, count: int | None) -> Timing:
    taken: list[float] = []
    end = time.perf_counter() + limit
    while len(taken) < _MAX_RUNS:
        begun = time.perf_counter()
        what()
        done = time.perf_counter()
        taken.append(done - begun)
        if len(taken) >= (count or 3) and (count is not None or done >= end):
            break
    return Timing(name, tuple(taken))


def _size(value: Result, best: float) -> str:
    n, pieces, piece = value._pieces()
    return f"{pieces}, {_time(best / n)} a {piece}"


def _error(result: SceneResult) -> tuple[float | None, str]:
    """Compute again more accurately; return the largest difference."""
    scene, value = result.scene, result._single("bench: must be a single result, not a sweep")
    try:
        return _ERRORS[value._form](scene, value) if value._form in _ERRORS else (None, "")
    except ViscovibError as error:
        return None, str(error)


def _motion_error(scene: Scene, value: Trajectory) -> tuple[float | None, str]:
    if value.error is None:
        value = simulate(**scene._motion(), estimate_error=True)
    return value.error, "of the states, by half the step"


def _response_error(scene: Scene, value: Response) -> tuple[float | None, str]:
    job = scene._job()
    if value.method == "linear":
        return None, "linear: solved directly, no iteration and no truncation"
    more = min(2 * int(value.harmonics.max(initial=0)) + 1, MAX_HARMONICS)
    better = forced_response(**(job | {"harmonics": more, "tolerance": 1e-13}))
    kept = np.searchsorted(better.harmonics, value.harmonics)
    both = value.converged & better.converged
    if not both.any():
        return None, "no frequency is solved in both"
    change = np.abs(better.coefficients[both][:, :, kept] - value.coefficients[both])
    size = np.abs(better.coefficients[both]).max(axis=2, keepdims=True)
    worst = float((change / np.maximum(size, 1e-300)).max())
    reference = (
        f"relative, at {both.sum()} frequencies, against {more} harmonics and tolerance 1e-13"
    )
    return worst, reference


def _branch_error(scene: Scene, value: Branch | DrivenBranch) -> tuple[float | None, str]:
    if value.harmonics.ndim > 1:
        # The orders are those of several frequencies.
        return None, ""
    more = min(2 * int(value.harmonics.max()) + 1, MAX_HARMONICS)
    better = run_one(scene.override({"branch.harmonics": more, "branch.tolerance": 1e-13})).branch
    # The peaks of the lowest order that moves.
    change = []
    for d, name in enumerate(value.dof_names):
        moves = np.abs(value.coefficients[:, d]).max(axis=0) > 0
        orders = value.harmonics[moves & (value.harmonics > 0)]
        if orders.size:
            k = int(orders[0])
            change.append(abs(value.peak(name, k).amplitude / better.peak(name, k).amplitude - 1))
    return max(change), f"relative, of the peaks, against {more} harmonics and tolerance 1e-13"


def _backbone_error(scene: Scene, value: Backbone) -> tuple[float | None, str]:
    group = scene.groups["backbone"]
    multiple = group.get("subharmonic", 1)
    more = min(2 * int(value.harmonics.max()) // multiple + 1, MAX_HARMONICS // multiple)
    finer = {"backbone.harmonics": more, "backbone.tolerance": 1e-13}
    better = run_one(scene.override(finer)).backbone
    if value.outcome != "completed" or better.outcome != "completed":
        return None, "the curve does not reach its end"
    reference = f"relative, of the last frequency, against {more} harmonics and tolerance 1e-13"
    return abs(float(value.nu[-1] / better.nu[-1]) - 1), reference


#: Function that estimates the error of a result, by its form.
_ERRORS: dict[str, Callable[[Scene, Any], tuple[float | None, str]]] = {
    "trajectory": _motion_error, "response": _response_error, "branch": _branch_error,
    "backbone": _backbone_error,
}  # fmt: skip


def _time(seconds: float) -> str:
    for size, unit in ((1.0, "s"), (1e-3, "ms"), (1e-6, "us")):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"


def _machine() -> str:
    name = platform.processor() or platform.machine()
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                name = line.partition(":")[2].strip()
                break
    except OSError:
        pass
    return (
        f"{name}, {os.cpu_count()} processors, Python {platform.python_version()}, "
        f"viscovib {__version__}"
    )
