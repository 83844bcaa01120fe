"""Motion with memory: run time against error, compared with the rules of published codes.

The mount with the Koltunov-Rzhanitsyn kernel (alpha = 0.1, so that a third of its integral lies
below 1e-4 s), nonlinear, from rest under a harmonic load to t = 100. Errors are those of the last
displacements against 12 digits of two independent programs. The other rules are implemented here
in NumPy as in their papers, with the whole history at every step. pycaputo and idesolver are used
if they are installed (peer_memory.py), idesolver to t = 1 only.
"""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import peer_memory
import viscovib as vv
from scipy.special import gammainc
from timing import seconds, show_time

DATA = Path(__file__).parents[1] / "data"
NU, LOAD, END = 1.5, 0.5, 100.0
AMPLITUDE, ALPHA, BETA = 0.048, 0.1, 0.05
MASS = np.array([1.0, 0.1])
STIFFNESS = np.array([[10.0, -5.0], [-5.0, 4.5]])
Row = dict[str, Any]
Case = tuple[str, str, int, Callable[[], np.ndarray]]


def mount() -> vv.Mount:
    """The reference scene."""
    return vv.Mount(
        mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2,
        kernel=vv.RzhanitsynKernel(amplitude=AMPLITUDE, alpha=ALPHA, beta=BETA),
    )  # fmt: skip


def reference(end: float = END) -> np.ndarray:
    """Displacements at t = 1, 10 or 100."""
    cases = json.loads((DATA / "mount_memory_reference.json").read_text())["time_domain"]
    (value,) = [
        case["value"]
        for case in cases
        if case["nonlinear"] and case["nu"] is not None and case["t"] == end
    ]
    return np.array([float(text) for text in value])


def spring_force(u: np.ndarray) -> np.ndarray:
    """K u + N(u) of the cubic geometry."""
    x, phi = u
    bend = np.array([10 * 0.5 / 6 * phi**3, 2.5 * phi**2 * x - 10 * 0.25 * 2 / 3 * phi**3])
    return STIFFNESS @ u + bend


def badalov(n: int) -> np.ndarray:
    """Badalov, Eshmatov and Yusupov (1987): singularity removed by substitution, trapezoids."""
    h = END / n
    k = np.arange(n + 1)
    weights = ((k + 1.0) ** ALPHA - np.maximum(k - 1.0, 0.0) ** ALPHA) * h**ALPHA / 2
    weights[0] = h**ALPHA / 2
    weights *= AMPLITUDE / ALPHA * np.exp(-BETA * h * k)
    u, force, pulls = np.zeros((n + 1, 2)), np.zeros((n + 1, 2)), np.zeros((n + 1, 2))
    load = np.zeros((n + 1, 2))
    load[:, 0] = LOAD * np.sin(NU * h * k)
    for i in range(1, n + 1):
        # u = double integral of the acceleration; the factor t - s is 0 at the present time.
        outer = h * (i - k[:i]) * h
        outer[0] /= 2
        u[i] = outer @ pulls[:i]
        force[i] = spring_force(u[i])
        last = weights[: i + 1].copy()
        last[i] = (i**ALPHA - (i - 1) ** ALPHA) * h**ALPHA / 2 * AMPLITUDE / ALPHA
        last[i] *= np.exp(-BETA * h * i)
        pulls[i] = (load[i] - force[i] + last @ force[i::-1]) / MASS
    return u[n]


def piecewise_linear(n: int) -> np.ndarray:
    """Average acceleration of Newmark; force piecewise linear in time with exact weights."""
    h = END / n
    t = h * np.arange(n + 2)
    zero = AMPLITUDE * _incomplete(ALPHA, t)
    one = AMPLITUDE * _incomplete(ALPHA + 1, t)
    mass0, mass1 = np.diff(zero), np.diff(one)
    # For the step at lag k: weights of its later and earlier end.
    later = (t[1:] * mass0 - mass1) / h
    earlier = (mass1 - t[:-1] * mass0) / h
    u, v, force = np.zeros((n + 1, 2)), np.zeros(2), np.zeros((n + 1, 2))
    a = np.zeros(2)
    for i in range(1, n + 1):
        past = later[1:i] @ force[i - 1 : 0 : -1] + earlier[:i] @ force[i - 1 :: -1]
        load = np.array([LOAD * np.sin(NU * t[i]), 0.0])
        new = a
        for _ in range(60):
            here = u[i - 1] + h * v + h**2 / 4 * (a + new)
            force[i] = spring_force(here)
            before, new = new, (load - force[i] * (1 - later[0]) + past) / MASS
            if np.abs(new - before).max() < 1e-13:
                break
        u[i] = u[i - 1] + h * v + h**2 / 4 * (a + new)
        v = v + h / 2 * (a + new)
        a = new
    return u[n]


def _incomplete(power: float, t: np.ndarray) -> np.ndarray:
    """Integral of s^(power-1) exp(-beta s) from 0 to t."""
    from math import gamma

    return gamma(power) * BETA**-power * gammainc(power, BETA * t)


def cases() -> Iterator[Case]:
    """All methods with their numbers of steps."""
    body = mount()
    for memory, names, counts in (
        ("exponentials", ("gauss4", "gauss6", "gauss8"), (150, 200, 300, 400, 600, 800, 1600)),
        ("direct", ("gauss4", "gauss8"), (200, 400, 800)),
    ):
        for name in names:
            for n in counts:
                yield (
                    f"viscovib {name}, {memory}",
                    f"{n} steps",
                    n,
                    lambda name=name, n=n, memory=memory: vv.simulate(
                        body, END, dt=END / n, load=LOAD, nu=NU, method=name, memory=memory,
                        tolerance=1e-11, keep="last",
                    ).state[-1, ::2],
                )  # fmt: skip
    for wanted in (1e-6, 1e-10):
        yield (
            'viscovib, dt="auto"',
            f"tolerance {wanted:g}",
            0,
            lambda wanted=wanted: vv.simulate(
                body, END, load=LOAD, nu=NU, tolerance=wanted, keep="last"
            ).state[-1, ::2],
        )
    for n in (800, 3200, 12800):
        yield "rule of Badalov et al.", f"{n} steps", n, lambda n=n: badalov(n)
    for n in (800, 3200, 12800):
        yield "piecewise linear, exact weights", f"{n} steps", n, lambda n=n: piecewise_linear(n)


def timed(exact: np.ndarray, case: Case) -> Row:
    """Time and error of a case."""
    method, setting, steps, run = case
    own = method.startswith("viscovib")
    error = float(np.abs(run() - exact).max())
    time = seconds(run) if own else seconds(run, repeats=3, shortest=0.0)
    print(f"{method:34} {setting:18} error {error:.1e}  {show_time(time)}")
    return {"method": method, "setting": setting, "steps": steps, "error": error, "seconds": time}


def measure() -> list[Row]:
    """Time and error of every case."""
    exact = reference()
    return [timed(exact, case) for case in (*cases(), *peer_memory.long_runs(END))]


def short() -> list[Row]:
    """The same to t = 1, for a peer that cannot compute longer motions."""
    exact, body = reference(1.0), mount()
    rows = []
    for n in (2, 4, 8):
        job = lambda n=n: vv.simulate(  # noqa: E731
            body, 1.0, dt=1.0 / n, load=LOAD, nu=NU, method="gauss8", tolerance=1e-11, keep="last"
        ).state[-1, ::2]
        rows.append(timed(exact, ("viscovib gauss8", f"{n} steps", n, job)))
    return rows + [timed(exact, case) for case in peer_memory.short_runs(1.0)]


def growth() -> list[Row]:
    """Cost of a step over the length of the run."""
    body = mount()
    rows = []
    for n in (1_000, 10_000, 100_000, 1_000_000):
        time = seconds(
            lambda n=n: vv.simulate(
                body, n / 8, dt=0.125, load=LOAD, nu=NU, method="gauss4", tolerance=1e-10,
                keep="last",
            )
        )  # fmt: skip
        rows.append({"steps": n, "seconds_a_step": time / n})
        print(f"{n:8} steps: {show_time(time / n)} a step")
    return rows


def run() -> tuple[list[Row], list[Row], list[Row]]:
    """Long motions, short ones, and the cost of a step."""
    return measure(), short(), growth()


if __name__ == "__main__":
    run()
