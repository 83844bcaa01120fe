"""Peak memory of every kind of job at two sizes.

Each job runs in a separate process. The result is the peak memory of the process, minus the memory
after importing the package and running the smallest form of the job once.
"""

import subprocess
import sys
from typing import Any

Row = dict[str, Any]

HEAD = """
import resource, sys, warnings
import numpy as np, viscovib as vv
warnings.simplefilter("ignore")
KERNEL = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
def mount(**more):
    return vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, **more)
bare = mount(damping=0.02 * np.array([[10.0, -5.0], [-5.0, 4.5]]))
remembering = mount(kernel=KERNEL)
numbers = dict(e=0.1, w2=0.4, w3=0.8, alpha=0.5, f0=.005, p1=.93, p2=.37, p3=.71)
pend = vv.Pendulum(**numbers, m01=.0025, m02=.005, c1=.01, c2=.01, c3=.01)
one = vv.Pendulum(**numbers, c1=.01, c2=.01, c3=.01)
damped = vv.Pendulum(**numbers, m01=.005, c1=.1, c2=.1, c3=.1)
start = (0.05, 0, 0.3, 0, -0.2, 0)
def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
def job(n):
    return {job}
job({least})
before = peak()
kept = job(int(sys.argv[1]))
print(peak() - before)
"""
#: Quantity that grows, sizes (smallest, short, long), whether memory may grow, and the call.
JOBS: dict[str, tuple[str, tuple[int, int, int], bool, str]] = {
    "response, successive approximations": (
        "frequencies", (10, 10_000, 100_000), True,
        "vv.forced_response(remembering, np.linspace(0.3, 12, n), load=0.02, method='successive')",
    ),
    "response, Newton": (
        "frequencies", (10, 1000, 10_000), True,
        "vv.forced_response(remembering, np.linspace(0.3, 12, n), load=0.1, method='newton')",
    ),
    "branch with multipliers": (
        "highest harmonic", (5, 9, 33), True,
        "vv.trace_response(bare, (0.5, 10), load=0.5, harmonics=n)",
    ),
    "torus of two loads": (
        "bound of the orders", (3, 6, 12), True,
        "vv.forced_response(damped, harmonics=n, stability=False)",
    ),
    "multiple scales": (
        "detunings", (10, 1000, 10_000), True,
        "vv.MultipleScales(one).response('p1', np.linspace(0.97, 1.08, n))",
    ),
    "motion of the pendulum, last state": (
        "steps", (100, 100_000, 1_000_000), False,
        "vv.simulate(pend, 0.25 * n, dt=0.25, initial=start, keep='last')",
    ),
    "motion of the pendulum, all states": (
        "steps", (100, 100_000, 1_000_000), True,
        "vv.simulate(pend, 0.25 * n, dt=0.25, initial=start)",
    ),
    "motion with memory, last state": (
        "steps", (100, 10_000, 300_000), False,
        "vv.simulate(remembering, n / 8, dt=0.125, load=0.5, nu=1.5, keep='last')",
    ),
    "motion with memory, direct": (
        "steps", (100, 1000, 4000), True,
        "vv.simulate(remembering, n / 8, dt=0.125, load=0.5, nu=1.5, keep='last', memory='direct')",
    ),
    "ensemble, steps": (
        "steps", (10, 1000, 10_000), False,
        "vv.simulate_ensemble(pend, initial=np.tile(start, (64, 1)), t_end=0.1 * n, dt=0.1,"
        " method='rk4', n_threads=1)",
    ),
    "ensemble, trajectories": (
        "trajectories", (8, 10_000, 100_000), True,
        "vv.simulate_ensemble(pend, initial=np.tile(start, (n, 1)), t_end=1, dt=0.1,"
        " method='rk4', n_threads=1)",
    ),
    "spectrum": (
        "samples", (64, 100_000, 1_000_000), True,
        "vv.spectrum(np.sin(np.arange(n)), 0.1)",
    ),
}  # fmt: skip


def peak(name: str, n: int) -> int:
    """Bytes above the smallest form of the job."""
    _, (least, *_), _, call = JOBS[name]
    program = HEAD.replace("{job}", call).replace("{least}", str(least))
    # Started by a shell, because the peak of a process includes that of its parent.
    done = subprocess.run(
        ["sh", "-c", '"$@"; exit $?', "sh", sys.executable, "-c", program, str(n)],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return int(done.stdout)


def run() -> list[Row]:
    """Peaks of every job at both sizes, and bytes per additional item."""
    rows = []
    for name, (of, (_, short, long), may_grow, _) in JOBS.items():
        low, high = peak(name, short), peak(name, long)
        rows.append(
            {"job": name, "of": of, "short": short, "long": long, "low": low, "high": high,
             "each": (high - low) / (long - short), "flat": not may_grow}
        )  # fmt: skip
        print(f"{name}: {low / 2**20:.2f} MiB at {short}, {high / 2**20:.2f} MiB at {long} {of}")
    return rows
