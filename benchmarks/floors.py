"""Distance of every hot path from its floor: the least time of its arithmetic on this machine.

The floor of a path is the number of operations that its result needs, counted as multiply-adds
of a register of eight (or measured by a plain kernel of benchmarks/floors, compiled with fixed
shapes), times their measured time. The time reached also contains the overhead of Python, checks
and bookkeeping.
"""

import math
import subprocess
from pathlib import Path
from typing import Any

import branch as branches
import memory
import motion
import numpy as np
import response_curve
import steady
import viscovib as vv
from timing import least, show_time

ROOT = Path(__file__).parents[1]
BUILD = ROOT / "build" / "release"
Row = dict[str, Any]


def plain_kernels() -> dict[str, float]:
    """Seconds of each plain kernel, measured by the compiled program."""
    program = BUILD / "benchmarks" / "floors" / "viscovib-floors"
    subprocess.run(
        ["ninja", "-C", BUILD, program.relative_to(BUILD)], check=True, capture_output=True
    )
    done = subprocess.run([program], check=True, capture_output=True, text=True)
    lines = [line.split(",") for line in done.stdout.splitlines()]
    return {name: float(value) for name, value, *_ in lines}


class Table:
    """Rows of floor, time reached, and ratio."""

    def __init__(self) -> None:
        self.kernels = plain_kernels()
        self.rows: list[Row] = []

    def add(self, path: str, needed: str, floor: float, reached: float) -> None:
        """Add a row and print it."""
        self.rows.append(
            {"path": path, "needed": needed, "floor": floor, "reached": reached,
             "ratio": reached / floor}
        )  # fmt: skip
        print(
            f"{path:52} floor {show_time(floor):>8}, reached {show_time(reached):>8}, "
            f"ratio {reached / floor:.1f}"
        )

    def registers(self, n: float) -> float:
        """Seconds of n multiply-adds of a register."""
        return n * self.kernels["multiply_add"]


def of_response(table: Table) -> None:
    """Kernel transforms and the curve by successive approximations."""
    k = table.kernels
    kernel = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
    mu = np.linspace(0.01, 100, 100_000)
    table.add(
        "transforms of a kernel, a pair",
        "logarithm, exponential, arc tangent, sine and cosine in plain double precision",
        k["power"], least(lambda: kernel.transform(mu)) / mu.size,
    )  # fmt: skip
    body, nu = response_curve.mount(), response_curve.NU
    r = vv.forced_response(body, nu, load=response_curve.LOAD)
    turns = float(r.iterations.mean())
    table.add(
        "successive approximations, a frequency",
        f"{turns:.1f} iterations (19 samples, 5 harmonics, 2 coordinates) and 5 transforms",
        turns * k["response_iteration"] / 8 + 5 * k["power"],
        least(lambda: vv.forced_response(body, nu, load=response_curve.LOAD)) / nu.size,
    )  # fmt: skip


def of_branch(table: Table) -> None:
    """Points of a branch, multipliers, stability with memory."""
    k = table.kernels
    bare, remembering = branches.mount(), branches.mount(
        vv.RzhanitsynKernel(amplitude=0.015, alpha=0.1, beta=0.05)
    )  # fmt: skip
    table.add("20 equations, factors and a solution", "the same with the size known",
              k["lu_20"], k["library_lu_20"])  # fmt: skip
    plain = branches.followed(bare, 9, False)
    found = plain()
    points, turns = found.nu.size, float(found.iterations.mean())
    # Samples of two coordinates and back; three derivatives by 19 Fourier coefficients; the matrix.
    work = (19 * 10 * 2 * 2 + 3 * 19 * 19 + 400) / 8
    without = least(plain) / points
    table.add(
        "harmonic balance, a point of a branch, orders to 9",
        f"{turns:.1f} iterations: 20 equations, moments of the derivatives",
        turns * (k["lu_20"] + table.registers(work)), without,
    )  # fmt: skip
    # Formulas of the monodromy matrix: dense rows of four columns, steps of 0.6 rad.
    rate = math.sqrt(np.abs(branches.STIFFNESS / np.array([[1.0], [0.1]])).sum(axis=1).max())
    steps = float(np.maximum(12, np.pi * rate / found.nu / 0.6).mean())
    table.add(
        "multipliers, a point",
        f"{steps:.0f} steps of 12 stages: stiffness, 4 columns, sums over 6 stages: 20 registers",
        table.registers(steps * 12 * 20),
        max(least(branches.followed(bare, 9, True)) / points - without, 1e-9),
    )  # fmt: skip
    plain = branches.followed(remembering, 9, False)
    points = plain().nu.size
    table.add(
        "stability with memory, a point",
        "5 determinants of 20 complex equations for the count, 5 for 2 pairs and for memory's each",
        20 * k["complex_lu_20"],
        (least(branches.followed(remembering, 9, True), repeats=3) - least(plain, repeats=3))
        / points,
    )  # fmt: skip


def of_motion(table: Table) -> None:
    """Right sides of the pendulum in both kinds of steps."""
    k = table.kernels
    body = vv.Pendulum(**motion.P1R)
    # Right side: 62 register operations (counted in the source), 2 sines, a quotient.
    right_side = table.registers(62) + 2 * k["sine_cosine"] + k["division"]

    def long_run() -> vv.Trajectory:
        return vv.simulate(body, 20_000, dt=1.0, initial=motion.START, method="gauss8", keep="last")

    n = long_run().stats["evaluations"]
    table.add(
        "gauss8, an iteration (8 nodes)",
        "sums over 8 nodes (48), start (6), right side, comparison (9)",
        right_side + table.registers(63), least(long_run, repeats=5) / n,
    )  # fmt: skip
    states = np.tile(motion.START, (1024, 1))
    steps = 400
    for method, stages, terms in (("rk4", 4, 1), ("dop8", 12, 6), ("verner9", 16, 8)):

        def many(method: str = method) -> vv.Ensemble:
            return vv.simulate_ensemble(
                body, initial=states, t_end=steps * 0.2, dt=0.2, method=method, n_threads=1
            )

        table.add(
            f"ensemble, a stage of {method}, 8 trajectories",
            f"sums over {terms} stages ({6 * terms}), state (12), loads (6), right side",
            right_side + table.registers(6 * terms + 18),
            least(many, repeats=5) / (states.shape[0] / 8 * steps * stages),
        )  # fmt: skip


def of_memory(table: Table) -> None:
    """Steps with memory."""
    k = table.kernels
    table.add("history update, 32 terms, 2 coordinates",
              "60 multiply-adds to recall, 56 to carry on", k["history_update"],
              k["library_history"])  # fmt: skip
    body, n = memory.mount(), 100_000

    def run() -> vv.Trajectory:
        return vv.simulate(body, n / 8, dt=0.125, load=memory.LOAD, nu=memory.NU, method="gauss4",
                           tolerance=1e-10, keep="last")  # fmt: skip

    turns = run().stats["iterations"] / n
    few = body.kernel.sum_of_exponentials(
        t_min=0.125 * 0.07, t_max=n / 8, tolerance=1e-10
    ).rates.size
    # The products of the plain kernel are those of three iterations and the prediction.
    table.add(
        "step with memory, gauss4",
        f"{few} terms, {turns:.1f} iterations, sine and cosine of the load",
        k["history_update"] * few / 32 + k["step_products"] * (turns + 2) / 5 + k["sine_cosine"],
        least(run, repeats=5) / n,
    )  # fmt: skip


def of_spectrum(table: Table) -> None:
    """Fourier transform of a long signal."""
    signal = np.sin(np.arange(2**17) * 0.1)
    table.add("spectrum of 2^17 samples", "the transform by FFTW, planned by measuring; the window",
              table.kernels["fourier"] + table.registers(2**17 / 8),
              least(lambda: vv.spectrum(signal, 0.1)))  # fmt: skip


def of_scales(table: Table) -> None:
    """Steady motions by multiple scales."""
    pend = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.005, c2=0.005, c3=0.005, f0=0.004,
                       p1=1.02)  # fmt: skip
    ms, detunings = vv.MultipleScales(pend), np.linspace(0.97, 1.08, 1000)
    each = len(ms.response("p1", detunings).index) / detunings.size
    table.add(
        "multiple scales, a detuning",
        f"{each:.2f} motions, a cubic equation and eigenvalues of 6 x 6 each (10 n^3 operations)",
        table.registers(each * (10 * 6**3 + 100) / 16),
        least(lambda: ms.response("p1", detunings)) / detunings.size,
    )  # fmt: skip


def of_torus(table: Table) -> None:
    """A motion under two loads: residuals of all harmonics."""
    r = vv.forced_response(steady.TWO, harmonics=8, stability=False)
    turns, samples = int(np.max(r.iterations)), 32**2
    transform = 2.5 * samples * np.log2(samples) / 16
    # Right side as in `of_motion`.
    k = table.kernels
    right_side = table.registers(62) + 2 * k["sine_cosine"] + k["division"]
    table.add(
        f"two loads, {len(r.orders)} orders",
        f"{turns} residuals: 9 transforms of {samples} samples (2.5 n log n), right sides",
        turns * (table.registers(9 * transform) + samples / 8 * right_side),
        least(lambda: vv.forced_response(steady.TWO, harmonics=8, stability=False), repeats=3),
    )


def run() -> tuple[list[Row], dict[str, float]]:
    """All paths, and the plain kernels."""
    table = Table()
    for part in (of_response, of_branch, of_motion, of_memory, of_spectrum, of_scales, of_torus):
        part(table)
    return table.rows, table.kernels


if __name__ == "__main__":
    run()
