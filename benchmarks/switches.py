"""Switches with a weakly singular kernel in time: run time against error.

A mass on rubber (Koltunov-Rzhanitsyn, alpha = 0.3) with a slider and a gap, from rest under a
harmonic load to t = 20: it sticks, slides and touches. It is compared with two methods in Python.
The first has a piecewise linear force with exact weights, Newmark's average acceleration, a return
mapping of the slider and the whole history at every step; its steps do not end at switches. The
second is graded collocation from switch to switch with a separate sum of exponentials. It is the
reference of such motions in the tests and gives the exact state here.
"""

import sys
from collections.abc import Callable, Iterator
from math import gamma
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import viscovib as vv
from scipy.special import gammainc
from timing import seconds, show_time

sys.path.append(str(Path(__file__).parents[1] / "tests"))

from referee.singular import Graded, Remembering
from referee.switched import Contact, Sliders

NU, LOAD, END = 1.3, 0.9, 20.0
MASS, STIFFNESS, DAMPING = 1.0, 1.0, 0.1
RUBBER, HARDENING = 2.0, 0.5
AMPLITUDE, ALPHA, BETA = 0.15, 0.3, 0.5
SLIDER, LIMIT = 3.0, 0.15
CONTACT, GAP = 20.0, 0.2
Row = dict[str, Any]


def system() -> vv.Structure:
    """The mass with its springs."""
    kernel = vv.RzhanitsynKernel(amplitude=AMPLITUDE, alpha=ALPHA, beta=BETA)
    return vv.Structure(
        mass=[MASS], stiffness=[STIFFNESS], damping=[DAMPING],
        elements=[
            vv.Spring(on="x1", stiffness=RUBBER, law=f"{HARDENING}*d^3", kernel=kernel),
            vv.Jenkins(on="x1", stiffness=SLIDER, limit=LIMIT),
            vv.Gap(on="x1", stiffness=CONTACT, gap=GAP),
        ],
    )  # fmt: skip


def graded() -> np.ndarray:
    """Displacement and velocity at the end, by collocation of degree 10 from switch to switch."""
    on = np.ones(1)
    law = ("rzhanitsyn", AMPLITUDE, ALPHA, BETA)
    found = Graded(
        np.array([MASS]), np.array([[STIFFNESS]]), np.array([[DAMPING]]),
        lambda t: np.array([LOAD]) * np.sin(NU * t),
        [
            Remembering(on, lambda d, over: RUBBER * d + HARDENING * d**3, law, np.inf),
            Sliders(on, [SLIDER], [LIMIT]), Contact(on, CONTACT, GAP, False),
        ],
    )  # fmt: skip
    return found.run([0.0], [0.0], np.array([0.0, END]))[-1]


def piecewise_linear(n: int) -> np.ndarray:
    """The same with n equal steps that do not end at switches."""
    h = END / n
    t = h * np.arange(n + 2)
    zero, one = (
        AMPLITUDE * gamma(p) * BETA**-p * gammainc(p, BETA * t) for p in (ALPHA, ALPHA + 1)
    )
    mass0, mass1 = np.diff(zero), np.diff(one)
    # For the step at lag k: weights of its later and earlier end.
    later, earlier = (t[1:] * mass0 - mass1) / h, (mass1 - t[:-1] * mass0) / h
    u, v, a, slid, force = 0.0, 0.0, 0.0, 0.0, np.zeros(n + 1)
    for i in range(1, n + 1):
        past = later[1:i] @ force[i - 1 : 0 : -1] + earlier[:i] @ force[i - 1 :: -1]
        new = a
        for _ in range(60):
            here, rate = u + h * v + h**2 / 4 * (a + new), v + h / 2 * (a + new)
            force[i] = RUBBER * here + HARDENING * here**3
            pull = min(max(slid + SLIDER * (here - u), -LIMIT), LIMIT)
            others = STIFFNESS * here + DAMPING * rate + CONTACT * max(here - GAP, 0.0) + pull
            before = new
            new = (LOAD * np.sin(NU * t[i]) - force[i] * (1 - later[0]) + past - others) / MASS
            if abs(new - before) < 1e-13:
                break
        u, v, a, slid = here, rate, new, pull
    return np.array([u, v])


def cases() -> Iterator[tuple[str, str, Callable[[], np.ndarray]]]:
    """All methods."""
    body = system()

    def moved(**given: Any) -> np.ndarray:
        run = vv.simulate(body, END, load=[LOAD], nu=NU, keep="last", **given)
        return np.asarray(run.state[-1])

    for n in (50, 100, 200):
        yield "viscovib", f"{n} steps", lambda n=n: moved(dt=END / n)
    for wanted in (1e-4, 1e-10):
        yield (
            'viscovib, dt="auto"', f"tolerance {wanted:g}",
            lambda wanted=wanted: moved(tolerance=wanted),
        )  # fmt: skip
    for n in (400, 1600, 6400, 12800):
        yield (
            "piecewise linear, exact weights", f"{n} steps",
            lambda n=n: piecewise_linear(n),
        )  # fmt: skip


def run() -> list[Row]:
    """Error of the last state and time of each method; for the reference the time only."""
    begun = perf_counter()
    exact = graded()
    judged = perf_counter() - begun
    rows = []
    for method, setting, job in cases():
        own = method.startswith("viscovib")
        error = float(np.abs(job() - exact).max())
        time = seconds(job) if own else seconds(job, repeats=3, shortest=0.0)
        rows.append({"method": method, "setting": setting, "error": error, "seconds": time})
    rows.append(
        {"method": "graded collocation", "setting": "degree 10", "error": None, "seconds": judged}
    )
    for row in rows:
        told = "" if row["error"] is None else f"{row['error']:.1e}"
        print(f"{row['method']:32} {row['setting']:18} {told:8} {show_time(row['seconds'])}")
    return rows


if __name__ == "__main__":
    run()
