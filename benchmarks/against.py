"""Compare processor times of typical calls in the present build with those of an older commit.

`./run bench --against COMMIT [--turns N] [--limit R] [--only WORD]`. The commit is cloned and
built once, in build/against. Each turn times every job in both builds, each in a separate process.
The ratio is the median over the turns of the least times. The exit status is 1 if a ratio is
above the limit.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]

Job = Callable[[], Any]


def jobs() -> dict[str, tuple[Job, int]]:
    """Return typical calls by name, and the number of calls per turn."""
    import numpy as np
    import viscovib as vv

    kernel = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
    numbers = {"mass": 1, "inertia": 0.1, "offset": 0.5, "stiffness_x": 10, "stiffness_phi": 2}
    mount = vv.Mount(**numbers, kernel=kernel)
    damped = vv.Mount(**numbers, damping=[[0.2, -0.1], [-0.1, 0.09]])
    duffing = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="0.5*x^3")
    common = {"e": 0.1, "alpha": 0.5, "c1": 0.01, "c2": 0.01, "c3": 0.01, "f0": 0.005}
    pendulum = vv.Pendulum(w2=0.4, w3=0.8, p1=0.93, **common)
    tuned = vv.Pendulum(w2=0.43, w3=0.71, p1=1.0, **common)
    start = (0.05, 0, 0.3, 0, -0.2, 0)
    members = np.array(start) + 0.01 * np.random.default_rng(1).standard_normal((256, 6))
    signal = np.cos(0.4 * np.arange(4000)) + 0.1 * np.cos(0.9 * np.arange(4000))
    n = 8
    stiffness = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    end = vv.Spring(on=f"x{n}", law="0.5*d^3")
    chain = vv.Structure(
        mass=np.eye(n), stiffness=stiffness, damping=0.02 * stiffness, elements=[end]
    )
    push = {1: [0.02] + [0.0] * (n - 1)}
    many = np.linspace(0.3, 12, 1000)
    rest = {"keep": "last"}

    def machine(gap: str | None = None, **options: Any) -> vv.Body:
        feet = [(x, y) for x in (-0.6, 0.6) for y in (-0.4, 0.4)]
        law = (None, None, gap)
        mounts = [
            vv.MountPoint(
                name=f"m{i}", position=(x, y, -0.3), stiffness=(4e5, 4e5, 8e5), law=law, **options
            )
            for i, (x, y) in enumerate(feet)
        ]
        return vv.Body(mass=800, inertia=(40, 70, 90), mounts=mounts)

    lossy = machine(loss_factor=0.1, loss_band=(3, 600))
    gaps = machine("1e7*max(d - 0.002, 0) + 1e7*min(d + 0.002, 0)", damping=100)
    rocking = {1: {"z": 500.0, "ry": 50.0}}
    return {
        "response": (lambda: vv.forced_response(mount, many, load=0.1), 9),
        "linear response": (
            lambda: vv.forced_response(mount, many, load=0.1, method="linear"),
            9,
        ),
        "branch": (lambda: vv.trace_response(damped, (0.5, 10), load=0.5, harmonics=9), 9),
        "branch, memory": (
            lambda: vv.trace_response(mount, (0.5, 6), load=0.5, harmonics=9),
            2,
        ),
        "branch, harmonics chosen": (
            lambda: vv.trace_response(duffing, (0.3, 2.5), load=0.3, harmonics="auto"),
            9,
        ),
        "branch of a chain": (
            lambda: vv.trace_response(chain, (0.15, 0.5), load=push, harmonics=9),
            3,
        ),
        "branch of a body with loss factors": (
            lambda: vv.trace_response(lossy, (20, 150), load=rocking),
            2,
        ),
        "branch of a body with gaps": (
            lambda: vv.trace_response(gaps, (55, 66), load=rocking, tolerance=1e-5),
            2,
        ),
        "motion, memory": (lambda: vv.simulate(mount, 100, load=0.5, nu=1.5, **rest), 9),
        "motion, memory, all states": (lambda: vv.simulate(mount, 100, load=0.5, nu=1.5), 9),
        "motion, memory, dt given": (
            lambda: vv.simulate(mount, 100, load=0.5, nu=1.5, dt=0.5, **rest),
            15,
        ),
        "motion of Duffing's oscillator": (
            lambda: vv.simulate(duffing, 200, initial=[0.3, 0], load=0.1, nu=1.1, **rest),
            9,
        ),
        "motion of the pendulum": (lambda: vv.simulate(pendulum, 200, initial=start, **rest), 15),
        "ensemble": (
            lambda: vv.simulate_ensemble(
                pendulum, initial=members, t_end=200, dt=0.25, n_threads=1
            ),
            3,
        ),
        "lines of a signal": (lambda: vv.dominant_frequencies(signal, 1.0, count=2), 9),
        "multiple scales": (
            lambda: vv.MultipleScales(tuned).response("p1", np.linspace(0.95, 1.05, 50)),
            3,
        ),
        "characteristic roots": (lambda: mount.characteristic_roots(), 3),
    }


def measure(only: str) -> None:
    """Print the least processor time of each job in seconds as JSON; null if it fails."""
    warnings.simplefilter("ignore")
    found: dict[str, float | None] = {}
    for name, (call, times) in jobs().items():
        if only not in name:
            continue
        try:
            call()
            spent = []
            for _ in range(times):
                begin = time.process_time()
                call()
                spent.append(time.process_time() - begin)
            found[name] = min(spent)
        except Exception:  # an older build may not have the call
            found[name] = None
    print(json.dumps(found))


def commit_of(name: str) -> str:
    """Return the full name of a commit of this repository."""
    call = ["git", "-C", str(ROOT), "rev-parse", "--verify", "--quiet", f"{name}^{{commit}}"]
    found = subprocess.run(call, capture_output=True, text=True)
    if found.returncode:
        sys.exit(f"bench: --against {name}: no commit of this repository: see git log")
    return found.stdout.strip()


def built(commit: str) -> Path:
    """Clone and build a commit once; return its folder."""
    place = ROOT / "build" / "against" / commit[:12]
    if (place / "built").exists():
        return place
    print(f"bench: building {commit[:12]} in {place.relative_to(ROOT)} (minutes, once)", flush=True)
    if not place.exists():
        place.parent.mkdir(parents=True, exist_ok=True)
        subprocess.run(["git", "clone", "-q", str(ROOT), str(place)], check=True)
        subprocess.run(["git", "-C", str(place), "checkout", "-q", commit], check=True)
    with open(place.parent / f"{commit[:12]}.log", "w") as log:
        done = subprocess.run(["./run", "demo"], cwd=place, stdout=log, stderr=log)
    if done.returncode:
        sys.exit(f"bench: --against {commit[:12]}: it does not build: see {log.name}")
    (place / "built").touch()
    return place


def timed(place: Path, only: str) -> dict[str, float | None]:
    """Time the jobs of this file in the build of a folder."""
    environment = dict(os.environ, OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    environment.pop("PYTHONPATH", None)
    call = [str(place / ".venv/bin/python"), str(Path(__file__).resolve()), "--measure", "--only"]
    out = subprocess.run([*call, only], cwd=place, env=environment, capture_output=True, text=True)
    if out.returncode:
        sys.exit(f"bench: the jobs end in {place}: {out.stderr.strip().splitlines()[-1]}")
    found: dict[str, float | None] = json.loads(out.stdout.splitlines()[-1])
    return found


def main() -> int:
    """Measure in turns and print a table."""
    options = argparse.ArgumentParser(description="Compare speed with an older commit.")
    options.add_argument("--against", default="HEAD", help="a commit, tag or branch")
    options.add_argument("--turns", type=int, default=3)
    options.add_argument("--limit", type=float, default=1.05, help="largest ratio allowed")
    options.add_argument("--only", default="", help="jobs of which the name contains this")
    options.add_argument("--measure", action="store_true", help=argparse.SUPPRESS)
    given = options.parse_args()
    if given.measure:
        measure(given.only)
        return 0
    if given.turns < 1:
        options.error(f"--turns {given.turns}: must be at least 1")
    before = built(commit_of(given.against))
    changed = subprocess.run(
        ["git", "-C", str(ROOT), "status", "--porcelain"], capture_output=True, text=True
    )
    if changed.stdout:
        print("bench: this checkout has changes that are not committed: they are measured too")
    turns = [(timed(before, given.only), timed(ROOT, given.only)) for _ in range(given.turns)]
    if not turns[0][1]:
        sys.exit(f"bench: --only {given.only}: no job has this in its name: {', '.join(jobs())}")
    slow = 0
    print("| job | before (ms) | now (ms) | ratio |\n| --- | --- | --- | --- |")
    for name in turns[0][1]:
        pairs = [(old.get(name), new.get(name)) for old, new in turns]
        whole = [(old, new) for old, new in pairs if old and new]
        if not whole:
            print(f"| {name} | | | not in both |")
            continue
        ratio = statistics.median(new / old for old, new in whole)
        least = [1e3 * min(column) for column in zip(*whole, strict=True)]
        print(f"| {name} | {least[0]:.3f} | {least[1]:.3f} | {ratio:.2f} |")
        slow += ratio > given.limit
    print(f"{slow} of {len(turns[0][1])} jobs above {given.limit:g}")
    return int(slow > 0)


if __name__ == "__main__":
    sys.exit(main())
