"""Distribution of the time of a point over phases, and growth of the cost.

Phases are measured by sampling with `perf` of Linux, or skipped with a message: the job runs
repeatedly, and every routine of the compiled core belongs to a phase. Growth is measured by
timing jobs of several sizes; the exponent refers to the last doubling.
"""

import math
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import viscovib as vv
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from timing import least, show_time

Row = dict[str, Any]
KERNEL = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
#: Parts of the names of routines (first match counts); jobs; the phase.
PHASES = (
    ("complex_power", "kernel transforms"),
    ("rzhanitsyn", "kernel transforms"),
    ("linear_response", "dynamic stiffness"),
    ("compliance", "dynamic stiffness"),
    ("lane_product", "harmonics to samples and back"),
    ("harmonic_set", "harmonics to samples and back"),
    ("deflection", "forces"),
    ("force_", "forces"),
    ("acceleration", "right side"),
    ("sine_cosine", "right side"),
    ("factorize", "equations solved"),
    ("dense_MOD_solve", "equations solved"),
    ("dense", "equations solved"),
    ("floquet", "multipliers"),
    ("monodromy", "multipliers"),
    ("eigenvalues", "multipliers"),
    ("motion_stability", "multipliers"),
    ("stage_", "multipliers"),
    ("hill", "stability with memory"),
    ("successive", "iteration: compliance, comparison"),
    ("harmonic_balance", "derivatives and residuals"),
    ("sample_tables", "derivatives and residuals"),
    ("curve_", "prediction, steps"),
    ("branch", "prediction, steps"),
    ("node_states", "sums over nodes"),
    ("predict", "prediction"),
    ("carry_on", "prediction"),
    ("exchange", "comparison"),
    ("compare", "comparison"),
    ("phases", "loads"),
    ("time_load", "loads"),
    ("exponential_history", "history: recall and update"),
    ("gather_channels", "history: recall and update"),
    ("product_of", "linear part: products"),
    ("add_columns", "linear part: products"),
    ("step_equations", "linear part: products"),
    ("hereditary", "bookkeeping of a step"),
    ("gauss", "bookkeeping of a step"),
)


def mount(**more: Any) -> vv.Mount:
    """The reference mount."""
    return vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, **more)


def chain(n: int, kernel: vv.Kernel | None = None) -> vv.PolynomialSystem:
    """A row of n masses between walls, with hardening springs."""
    stiffness = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    names = [f"x{i}" for i in range(1, n + 1)]
    return vv.PolynomialSystem(
        mass=np.ones(n), stiffness=stiffness, damping=0.05 * stiffness, kernel=kernel,
        forces={name: f"0.1*{name}^3" for name in names}, names=tuple(names),
    )  # fmt: skip


DAMPED = mount(damping=0.02 * np.array([[10.0, -5.0], [-5.0, 4.5]]))
PENDULUM = vv.Pendulum(
    e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01, f0=0.005, m01=0.0025, m02=0.005,
    p1=0.93, p2=0.37, p3=0.71,
)  # fmt: skip
START = np.array([0.05, 0.0, 0.3, 0.0, -0.2, 0.0])
NU = np.linspace(0.3, 12.0, 1000)
#: Name, unit of work, number of units per call, the call.
JOBS: dict[str, tuple[int, Callable[[], Any]]] = {
    "response point": (
        1000, lambda: vv.forced_response(mount(kernel=KERNEL), NU, load=0.05),
    ),
    "branch point": (
        205, lambda: vv.trace_response(DAMPED, (0.5, 10), load=0.5, harmonics=9, stability=False),
    ),
    "branch point with multipliers": (
        205, lambda: vv.trace_response(DAMPED, (0.5, 10), load=0.5, harmonics=9),
    ),
    "motion step (pendulum, gauss8)": (
        200, lambda: vv.simulate(PENDULUM, 200, dt=1.0, initial=START, keep="last"),
    ),
    "hereditary step (mount, gauss4)": (
        80_000, lambda: vv.simulate(mount(kernel=KERNEL), 10_000, dt=0.125, load=0.5, nu=1.5,
                                  method="gauss4", tolerance=1e-10, keep="last"),
    ),
}  # fmt: skip


def sampled(name: str, length: float = 2.0) -> None:
    """Run a job repeatedly while perf samples it (in a separate process)."""
    _, job = JOBS[name]
    warnings.simplefilter("ignore")
    job()
    with subprocess.Popen(
        ["perf", "record", "-e", "cpu-clock", "-F", "2000", "-o", sys.argv[2], "-p",
         str(os.getpid())], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    ) as watcher:  # fmt: skip
        time.sleep(0.3)
        end = time.process_time() + length
        while time.process_time() < end:
            job()
        watcher.send_signal(signal.SIGINT)


def shares(name: str) -> dict[str, float]:
    """Fraction of the time of each phase."""
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "perf.data"
        subprocess.run([sys.executable, __file__, name, data], check=True, capture_output=True)
        report = subprocess.run(
            ["perf", "report", "-i", data, "--stdio", "-F", "overhead,dso,symbol", "-t", ";"],
            capture_output=True, text=True, check=True,
        ).stdout  # fmt: skip
    parts: dict[str, float] = {}
    for line in report.splitlines():
        cells = [cell.strip() for cell in line.split(";")]
        if line.startswith("#") or len(cells) < 3 or not cells[0].endswith("%"):
            continue
        phase = phase_of(cells[1], cells[2])
        parts[phase] = parts.get(phase, 0.0) + float(cells[0].rstrip("%")) / 100
    return parts


def phase_of(library: str, routine: str) -> str:
    """The phase of a routine."""
    if "_viscovib" in library:
        for part, phase in PHASES:
            if part in routine:
                return phase
        return "other routines of the core"
    if library.startswith("[kernel"):
        return "system: memory pages, clock"
    if "libm." in library:
        return "sines and exponentials of the C library"
    if "memmove" in routine or "memset" in routine or "malloc" in routine or "free" in routine:
        return "memory moved and allocated"
    return "Python and NumPy"


def costs() -> list[Row]:
    """Phases of every job."""
    if shutil.which("perf") is None:
        print("perf is not installed: phases left out")
        return []
    rows = []
    for name, (count, job) in JOBS.items():
        try:
            parts = shares(name)
        except subprocess.CalledProcessError:
            print(f"perf may not be used here: phases of {name} left out")
            continue
        warnings.simplefilter("ignore")
        each = least(job, repeats=5) / count
        for phase, part in sorted(parts.items(), key=lambda item: -item[1]):
            rows.append({"job": name, "seconds": each, "phase": phase, "part": part})
        print(f"{name}: {show_time(each)}, " + ", ".join(
            f"{r['phase']} {100 * r['part']:.0f} %" for r in rows if r["job"] == name
            and r["part"] > 0.03
        ))  # fmt: skip
    return rows


def growing() -> dict[str, tuple[str, list[int], Callable[[int], Callable[[], Any]]]]:
    """Jobs by size: meaning of the size, sizes, and the call for a size."""

    def motion(n: int) -> Callable[[], Any]:
        body = chain(n)
        return lambda: vv.simulate(body, 100, dt=0.25, load=[0.1] + [0] * (n - 1), nu=0.9,
                                   keep="last")  # fmt: skip

    def hereditary(n: int) -> Callable[[], Any]:
        body = chain(n, KERNEL)
        return lambda: vv.simulate(body, 100, dt=0.25, load=[0.1] + [0] * (n - 1), nu=0.9,
                                   keep="last")  # fmt: skip

    def balance(n: int) -> Callable[[], Any]:
        body = chain(n)
        return lambda: vv.forced_response(
            body, np.linspace(0.4, 0.6, 20), load=[0.1] + [0] * (n - 1), method="newton",
            harmonics=5,
        )  # fmt: skip

    def harmonics(n: int) -> Callable[[], Any]:
        return lambda: vv.forced_response(mount(kernel=KERNEL), NU, load=0.05, harmonics=n)

    def newton_harmonics(n: int) -> Callable[[], Any]:
        return lambda: vv.trace_response(DAMPED, (0.5, 10), load=0.5, harmonics=n, stability=False)

    def steps(n: int) -> Callable[[], Any]:
        return lambda: vv.simulate(PENDULUM, n, dt=1.0, initial=START, keep="last")

    def hereditary_steps(n: int) -> Callable[[], Any]:
        body = mount(kernel=KERNEL)
        return lambda: vv.simulate(body, n / 8, dt=0.125, load=0.5, nu=1.5, method="gauss4",
                                   tolerance=1e-10, keep="last")  # fmt: skip

    def trajectories(n: int) -> Callable[[], Any]:
        states = np.tile(START, (n, 1))
        return lambda: vv.simulate_ensemble(PENDULUM, initial=states, t_end=40, dt=0.4, n_threads=1)

    def frequencies(n: int) -> Callable[[], Any]:
        nu = np.linspace(0.3, 12, n)
        return lambda: vv.forced_response(mount(kernel=KERNEL), nu, load=0.05)

    return {
        "response, 1000 frequencies": ("highest harmonic", [3, 5, 9, 17, 33, 65], harmonics),
        "branch": ("highest harmonic", [3, 5, 9, 17, 33], newton_harmonics),
        "response, orders to 9": ("frequencies", [1, 10, 100, 1000, 10_000], frequencies),
        "20 points by Newton": ("degrees of freedom", [1, 2, 4, 8, 16], balance),
        "400 steps": ("degrees of freedom", [1, 2, 4, 8, 16, 32], motion),
        "400 steps with memory": ("degrees of freedom", [1, 2, 4, 8, 16, 32], hereditary),
        "pendulum, gauss8": ("steps", [10, 100, 1000, 10_000, 100_000], steps),
        "mount with memory, gauss4": ("steps", [10, 100, 1000, 10_000, 100_000], hereditary_steps),
        "ensemble, 100 steps": ("trajectories", [1, 8, 64, 512, 4096], trajectories),
    }


def growth() -> list[Row]:
    """Time of every job at every size, and the exponent between the last two."""
    rows = []
    for name, (of_what, sizes, make) in growing().items():
        times = []
        for n in sizes:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                times.append(least(make(n), repeats=3))
            exponent = math.nan
            if len(times) > 1:
                ratio = sizes[len(times) - 1] / sizes[len(times) - 2]
                exponent = math.log(times[-1] / times[-2]) / math.log(ratio)
            rows.append(
                {"job": name, "of": of_what, "n": n, "seconds": times[-1], "exponent": exponent}
            )
        print(f"{name}: " + ", ".join(
            f"{n} {show_time(t)}" for n, t in zip(sizes, times, strict=True)
        ) + f" {of_what}; last exponent {exponent:.2f}")  # fmt: skip
    return rows


def draw(path: Path, costs: list[Row], growth: list[Row]) -> None:
    """Phases as bars, growth as lines, one panel for each kind of size."""
    kinds = list(dict.fromkeys(row["of"] for row in growth))
    jobs = list(dict.fromkeys(row["job"] for row in costs))
    figure = Figure(figsize=(12, 3.6 + 4.2 * bool(jobs)), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subfigures(2 if jobs else 1, 1, squeeze=False).ravel()
    if jobs:
        _draw_phases(panels[0].subplots(), jobs, costs)
    axes = panels[-1].subplots(1, len(kinds))
    for axis, kind in zip(np.atleast_1d(axes), kinds, strict=True):
        for i, job in enumerate(dict.fromkeys(r["job"] for r in growth if r["of"] == kind)):
            line = [r for r in growth if r["job"] == job and r["of"] == kind]
            axis.loglog([r["n"] for r in line], [1e3 * r["seconds"] for r in line],
                        marker="osD"[i % 3], color=str(0.4 * i), linewidth=1, markersize=4,
                        label=job)  # fmt: skip
        axis.set(xlabel=kind, ylabel="time (ms)")
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.yaxis.set_minor_formatter(NullFormatter())
        axis.grid(color="0.9")
        axis.spines[["top", "right"]].set_visible(False)
        axis.legend(frameon=False, fontsize=7)
    figure.savefig(path, dpi=160)


def _draw_phases(axis: Any, jobs: list[str], costs: list[Row]) -> None:
    phases = list(dict.fromkeys(row["phase"] for row in costs if row["part"] >= 0.02))
    tints = [str(0.1 + 0.75 * (i % 9) / 9) for i in range(len(phases))]
    hatches = ("", "////", "....")
    for i, job in enumerate(jobs):
        left = 0.0
        for k, phase in enumerate(phases):
            part = sum(r["part"] for r in costs if r["job"] == job and r["phase"] == phase)
            axis.barh(i, part, left=left, color=tints[k], hatch=hatches[k // 9 % 3],
                      edgecolor="white", height=0.7,
                      label=phase if i == 0 or left == 0 else None)  # fmt: skip
            left += part
    axis.set_yticks(range(len(jobs)), jobs)
    axis.invert_yaxis()
    axis.set(xlim=(0, 1), xlabel="part of the time")
    axis.spines[["top", "right"]].set_visible(False)
    shown = [_patch(tints[k], hatches[k // 9 % 3], phase) for k, phase in enumerate(phases)]
    axis.legend(handles=shown, frameon=False, fontsize=7, loc="center left",
                bbox_to_anchor=(1.0, 0.5))  # fmt: skip


def _patch(tint: str, hatch: str, label: str) -> Any:
    from matplotlib.patches import Patch

    return Patch(facecolor=tint, hatch=hatch, edgecolor="white", label=label)


def run() -> tuple[list[Row], list[Row]]:
    """Phases and growth."""
    return costs(), growth()


if __name__ == "__main__":
    sampled(sys.argv[1])
