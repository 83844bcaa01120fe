"""Structures condensed to their nonlinear coordinates: branches, compared with full matrices.

Processor time, the least of several runs.

The chain: n unit masses between unit springs, both ends fixed, damping 0.02 K, one cubic spring 0.5
at the last mass and a load of 0.02 on the first; chain B: one end fixed, cubic spring and load at
the free end, 1 % of critical damping in every mode, its peak 10 % above the linear one; the beam:
data/structures/beam_cubic_reference.json.
"""

from __future__ import annotations

import json
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import peer_pyharm
import plate
import viscovib as vv
from timing import least, pair, show_time

Row = dict[str, Any]

BEAM = Path(__file__).parents[1] / "data" / "structures" / "beam_cubic_reference.json"
#: Sizes of chain B; the last sizes show how time grows.
SIZES = (32, 128, 512, 1024)


def matrix(n: int, *, free: bool = False) -> np.ndarray:
    """Stiffness of a chain, both ends or the first one fixed."""
    stiffness = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    if free:
        stiffness[-1, -1] = 1
    return stiffness


def chain(n: int) -> tuple[vv.PolynomialSystem, vv.Structure, float]:
    """The chain, full and condensed, and its first frequency."""
    k, end = matrix(n), f"x{n}"
    given = {"mass": np.ones(n), "stiffness": k, "damping": 0.02 * k}
    whole = vv.PolynomialSystem(**given, forces={end: f"0.5*{end}^3"})
    # The method without condensation.
    whole.__dict__["_condensation"] = None
    structure = vv.Structure(**given, elements=[vv.Spring(on=end, law="0.5*d^3")])
    return whole, structure, 2 * np.sin(0.5 * np.pi / (n + 1))


def chain_b(n: int) -> tuple[vv.Structure, float, float]:
    """Chain B, its first frequency and load: amplitude 1 at 1.1 times that frequency."""
    half = 0.5 * np.pi / (2 * n + 1)
    w = 2 * np.sin(half)
    tip = 4 / (2 * n + 1) * np.cos(half) ** 2
    cubic = (1.1**2 - 1) * w**2 / (0.75 * tip)
    structure = vv.Structure(
        mass=np.ones(n), stiffness=matrix(n, free=True), modal_damping=0.01,
        elements=[vv.Spring(on=f"x{n}", law="c*d^3", parameters={"c": cubic})],
    )  # fmt: skip
    return structure, w, 0.02 * 1.1 * w**2 / tip


def beam() -> tuple[vv.Structure, dict[str, Any]]:
    """The beam of the reference, and its reference values."""
    elements, length, side, young, density = 20, 0.7, 0.014, 2.05e11, 7800.0
    h, area, inertia = length / elements, side**2, side**4 / 12
    n = 2 * (elements + 1)
    mass, stiffness = np.zeros((n, n)), np.zeros((n, n))
    k = np.array([[12, 6 * h, -12, 6 * h], [0, 4 * h * h, -6 * h, 2 * h * h],
                  [0, 0, 12, -6 * h], [0, 0, 0, 4 * h * h]])  # fmt: skip
    m = np.array([[156, 22 * h, 54, -13 * h], [0, 4 * h * h, 13 * h, -3 * h * h],
                  [0, 0, 156, -22 * h], [0, 0, 0, 4 * h * h]])  # fmt: skip
    for i in range(elements):
        part = slice(2 * i, 2 * i + 4)
        stiffness[part, part] += young * inertia / h**3 * (k + np.triu(k, 1).T)
        mass[part, part] += density * area * h / 420 * (m + np.triu(m, 1).T)
    names = [f"{kind}{i}" for i in range(1, elements + 1) for kind in ("w", "r")]
    structure = vv.Structure(
        mass=mass[2:, 2:], stiffness=stiffness[2:, 2:], names=names, modal_damping=0.01,
        elements=[vv.Spring(on="w20", law="6e9*d^3")],
    )  # fmt: skip
    return structure, json.loads(BEAM.read_text())


def show(row: Row) -> Row:
    """Print a line."""
    a_point = show_time(row["seconds"] / row["points"]) if row["points"] else ""
    target = f", target {show_time(row['target'])}" if row["target"] else ""
    other = f", {row['ratio']:.3g} times as long whole" if row["ratio"] == row["ratio"] else ""
    print(f"{row['job']:56} {show_time(row['seconds']):>8} {a_point:>8} a point{target}{other}")
    return row


def line(job: str, curve: Callable[[], vv.Branch], target: float) -> Row:
    """Time of a branch; the target is that of a point."""
    points = curve().nu.size
    row: Row = {"job": job, "points": points, "seconds": least(curve), "target": target}
    return row | {"whole": np.nan, "ratio": np.nan, "error": np.nan}


def chains(stability: bool) -> list[Row]:
    """The chain, condensed and full in turn: times of points, their motions and folds."""
    rows = []
    for n, target in ((8, 0.0), (32, 150e-6 if stability else 15e-6)):
        whole, structure, w = chain(n)
        load = np.zeros(n)
        load[0] = 0.02

        def curve(
            system: vv.PolynomialSystem | vv.Structure, load: np.ndarray = load, w: float = w
        ) -> vv.Branch:
            return vv.trace_response(
                system, (0.5 * w, 1.5 * w), load=load, harmonics=9, stability=stability
            )

        name = f"chain of {n}, orders to 9{', with stability' if stability else ''}"
        row = line(name, lambda s=structure, f=curve: f(s), target)
        ours, theirs = curve(structure), curve(whole)
        _, row["whole"], _ = pair(
            lambda s=structure, f=curve: f(s),
            lambda s=whole, f=curve: f(s),
            repeats=3,
            clock=time.process_time,
        )
        row["ratio"] = row["whole"] / theirs.nu.size / (row["seconds"] / row["points"])
        if ours.folds.size == theirs.folds.size:
            row["error"] = np.abs(ours.folds / theirs.folds - 1).max(initial=0.0)
        rows.append(show(row))
    return rows


def growth(stability: bool) -> list[Row]:
    """Chain B with increasing numbers of masses and automatic harmonics."""
    rows = []
    for n in SIZES:
        structure, w, load = chain_b(n)
        target = {32: (15e-6, 150e-6), 1024: (60e-6, 800e-6)}.get(n, (0.0, 0.0))[stability]
        name = f"chain B of {n}{', with stability' if stability else ''}"
        rows.append(
            show(
                line(
                    name,
                    lambda s=structure, w=w, p=load, n=n: vv.trace_response(
                        s, (0.5 * w, 1.5 * w), load={f"x{n}": p}, stability=stability
                    ),
                    target,
                )
            )
        )
    first, last = (row["seconds"] / row["points"] for row in (rows[0], rows[-1]))
    exponent = np.log(last / first) / np.log(SIZES[-1] / SIZES[0])
    print(f"time of a point grows with the number of masses to the power {exponent:.2f}")
    return rows


def whole_curve() -> Row:
    """The beam through its folds with an error of 1e-8."""
    structure, known = beam()
    hz = 2 * np.pi

    def curve() -> vv.Branch:
        return vv.trace_response(
            structure, (15 * hz, 50 * hz), load={"w20": 1.0}, stability=False, tolerance=1e-8
        )

    row = line("beam of 40 coordinates, whole curve at 1e-8", curve, 0.0)
    row["target"] = 3e-3 / row["points"]
    row["error"] = np.abs(np.sort(curve().folds) / known["folds"] - 1).max()
    return show(row)


def steps_in_time(n: int, method: str, target: float, *, whole: bool = False) -> Row:
    """A step of chain B whose spring has memory, without the preparation of the run."""
    structure, w, load = chain_b(n)
    end, few, many = f"x{n}", 10, 810 if n > 100 else 4010
    kernel = vv.RzhanitsynKernel(amplitude=0.05, alpha=0.3, beta=0.1)
    cubic = structure.elements[0].parameters["c"]
    spring = vv.Spring(on=end, stiffness=0.01, law=f"{cubic}*d^3", kernel=kernel)
    system = vv.Structure(
        mass=np.ones(n), stiffness=matrix(n, free=True), modal_damping=0.01, elements=[spring]
    )
    h = 0.25

    def steps(body: vv.Structure | vv.PolynomialSystem, count: int) -> float:
        forced = {"load": np.eye(n)[-1] * load, "nu": w}
        only = {"coordinates": [end]} if isinstance(body, vv.Structure) else {}
        return least(
            lambda: vv.simulate(
                body, h * count, dt=h, method=method, keep="last", tolerance=1e-12, **forced, **only
            )
        )

    seconds = max(steps(system, many) - steps(system, few), 0.0)
    row: Row = {
        "job": f"step in time, {n} modes, a hereditary spring, {method}", "points": many - few,
        "seconds": seconds, "target": target, "whole": np.nan, "ratio": np.nan, "error": np.nan,
    }  # fmt: skip
    if whole:
        ends = np.zeros((n, n))
        ends[-1, -1] = 0.01
        # Modal damping as a matrix.
        squares, shapes = np.linalg.eigh(matrix(n, free=True) + ends)
        body = vv.PolynomialSystem(
            mass=np.ones(n), stiffness=matrix(n, free=True),
            damping=shapes * (0.02 * np.sqrt(squares)) @ shapes.T,
            springs=[vv.Springs(stiffness=ends, forces={end: f"{cubic}*{end}^3"}, kernel=kernel)],
        )  # fmt: skip
        row["whole"] = steps(body, many) - steps(body, few)
        row["ratio"] = row["whole"] / seconds
    return show(row)


def peers() -> list[Row]:
    """PyHarm on the chain, with all coordinates and with the nonlinear coordinates only."""
    lack = peer_pyharm.missing()
    if lack:
        print(lack)
        return []
    warnings.simplefilter("ignore")
    rows = []
    for n in (8, 32):
        _, structure, w = chain(n)
        for reduced in (False, True):
            job = peer_pyharm.chain(matrix(n), w, 9, reduced=reduced)
            # Compiled with the small chain, because a run with the large one takes a minute.
            start = time.process_time()
            branch = job()
            seconds = time.process_time() - start
            known = vv.trace_response(
                structure, (0.5 * w, 1.5 * w), load={"x1": 0.02}, harmonics=9, stability=False
            )
            form = "its nonlinear coordinates" if reduced else "all coordinates"
            row: Row = {
                "job": f"chain of {n}, orders to 9: pyHarm, {form}", "points": branch.nu.size,
                "seconds": least(job, repeats=2) if n == 8 else seconds, "target": 0.0,
                "whole": np.nan, "ratio": np.nan,
            }  # fmt: skip
            ours = float(known.amplitude(f"x{n}").max())
            row["error"] = abs(float(np.abs(branch.first).max()) / ours - 1)
            rows.append(show(row))
    return rows


def run() -> list[Row]:
    """All rows."""
    warnings.simplefilter("ignore", vv.ConvergenceWarning)
    rows = [*chains(stability=False), *growth(stability=False), whole_curve()]
    rows += [*chains(stability=True), *growth(stability=True)]
    rows += [steps_in_time(32, "gauss8", 0.0, whole=True), steps_in_time(1000, "gauss8", 15e-6)]
    rows += [steps_in_time(1000, "gauss4", 15e-6)]
    rows += [show(row) for row in plate.run()]
    return rows + peers()


if __name__ == "__main__":
    run()
