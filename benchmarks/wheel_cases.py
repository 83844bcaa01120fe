"""The cases of `./run bench --wheel`, timed in this process: reads names of cases, writes seconds.

It imports the viscovib of the environment, and nothing else of this folder.
"""

import sys
import time
from collections.abc import Callable

import numpy as np
import viscovib as vv


def cases() -> dict[str, Callable[[], object]]:
    """Return the cases by name."""
    rubber = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
    mount = vv.Mount(
        mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, kernel=rubber
    )
    body = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, f0=0.005, p1=0.93)
    start = [0.05, 0.0, 0.3, 0.0, -0.2, 0.0]
    starts = np.tile(start, (64, 1))
    starts[:, 2] += np.linspace(-0.1, 0.1, 64)
    nu = np.linspace(0.3, 12, 1000)
    return {
        "response": lambda: vv.forced_response(mount, nu, load=0.1),
        "branch with stability": lambda: vv.trace_response(mount, (0.5, 6), load=0.5),
        "pendulum motion": lambda: vv.simulate(body, 500, initial=start, dt=0.25),
        "ensemble": lambda: vv.simulate_ensemble(body, initial=starts, t_end=100, dt=0.1),
        "motion with memory": lambda: vv.simulate(mount, 100, load=0.5, nu=1.5),
    }


def main() -> None:
    """Time each named case repeatedly for a tenth of a second, and print the least time."""
    known = cases()
    print(*known, sep=",", flush=True)
    for line in sys.stdin:
        work = known[line.strip()]
        taken = []
        while sum(taken) < 0.1 or len(taken) < 3:
            begin = time.perf_counter()
            work()
            taken.append(time.perf_counter() - begin)
        print(min(taken), flush=True)


if __name__ == "__main__":
    main()
