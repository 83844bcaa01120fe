"""Branch of the mount through its folds: run time against error, compared with AUTO-07p and pyHarm.

Errors of the folds refer to values with 13 digits, errors of the first harmonics to a balance with
many harmonics, solved by SciPy at twelve points (curve.py).
"""

import warnings
from collections.abc import Callable
from typing import Any

import curve
import numpy as np
import peer_auto
import peer_pyharm
import viscovib as vv
from curve import STIFFNESS
from timing import pair, seconds, show_time

Row = dict[str, Any]


def mount(kernel: vv.Kernel | None = None) -> vv.Mount:
    """Problem M0: damping 0.02 times the stiffness, cubic geometry."""
    damping = 0.02 * STIFFNESS if kernel is None else None
    return vv.Mount(
        mass=1.0,
        inertia=0.1,
        offset=0.5,
        stiffness_x=10.0,
        stiffness_phi=2.0,
        damping=damping,
        kernel=kernel,
    )


def as_polynomials() -> vv.PolynomialSystem:
    """The same problem as a user would write it without `Mount`."""
    return vv.PolynomialSystem(
        mass=[1.0, 0.1],
        stiffness=STIFFNESS,
        damping=0.02 * STIFFNESS,
        forces={"x": "5/6*phi^3", "phi": "2.5*phi^2*x - 5/3*phi^3"},
        names=("x", "phi"),
    )


def followed(
    body: vv.Mount | vv.PolynomialSystem, harmonics: int, stability: bool
) -> Callable[[], vv.Branch]:
    """Return a job that follows the branch at a load of 0.5 from nu = 0.5 to 10."""
    return lambda: vv.trace_response(
        body, (0.5, 10.0), load=0.5, harmonics=harmonics, stability=stability
    )


def row(method: str, setting: str, stability: bool, found: curve.Branch, time: float) -> Row:
    """Row of the table; an error is NaN if there is no independent value."""
    return {
        "method": method,
        "setting": setting,
        "multipliers": stability,
        "points": found.nu.size,
        "seconds": time,
        "fold_error": curve.fold_error(found),
        "error": curve.amplitude_error(found),
        "ratio": np.nan,
    }


def show(line: Row) -> None:
    """Print a line."""
    ratio = "" if np.isnan(line["ratio"]) else f"  {line['ratio']:.3g} times as long as ours"
    print(
        f"{line['method']:28} {line['setting']:26} {show_time(line['seconds']):>8} "
        f"{line['points']:4} points, folds to {line['fold_error']:.1e}, amplitudes to "
        f"{line['error']:.1e}{ratio}"
    )


def own() -> list[Row]:
    """Branches of viscovib, for several numbers of harmonics, with and without multipliers."""
    rows = []
    for stability in (False, True):
        name = "viscovib, with multipliers" if stability else "viscovib"
        for harmonics in (5, 7, 9, 11, 13, 15, 21):
            job = followed(mount(), harmonics, stability)
            found = job()
            points = curve.Branch(found.nu, found.coefficients[:, :, 0], found.folds)
            rows.append(row(name, f"orders to {harmonics}", stability, points, seconds(job)))
            rows[-1]["harmonics"] = harmonics
            show(rows[-1])
    return rows


def against(
    line: Row, theirs: Callable[[], object], ours: list[Row], stability: bool, slow: bool = False
) -> Row:
    """Time of a peer and its ratio to our fastest branch without larger errors, in turn."""
    enough = [
        mine
        for mine in ours
        if mine["multipliers"] == stability
        and mine["fold_error"] <= line["fold_error"]
        and mine["error"] <= line["error"]
    ]
    if enough:
        best = min(enough, key=lambda mine: mine["harmonics"])
        job = followed(mount(), best["harmonics"], stability)
        _, line["seconds"], line["ratio"] = pair(job, theirs, repeats=3 if slow else 7)
    else:
        line["seconds"] = seconds(theirs, repeats=3, shortest=0.0)
    show(line)
    return line


def peers(ours: list[Row]) -> list[Row]:
    """AUTO-07p, which always computes multipliers, and pyHarm, which never does."""
    rows = []
    lack = peer_auto.missing()
    if lack:
        print(lack)
    else:
        with peer_auto.Auto() as auto:
            for intervals, degree in ((8, 4), (10, 4), (15, 4), (20, 4), (40, 4), (10, 7)):
                found = auto.branch(intervals, degree)
                line = row(
                    "AUTO-07p, with multipliers", f"{intervals} intervals, degree {degree}", True,
                    found, np.nan,
                )  # fmt: skip
                rows.append(against(line, auto.job(intervals, degree), ours, True))
    lack = peer_pyharm.missing()
    if lack:
        print(lack)
        return rows
    for highest, step in ((5, 0.1), (7, 0.1), (9, 0.1), (11, 0.05), (15, 0.02)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            job = peer_pyharm.branch(highest, step)
            line = row("pyHarm", f"orders to {highest}, step {step}", False, job(), np.nan)
            rows.append(against(line, job, ours, False, slow=True))
    return rows


def others() -> list[Row]:
    """The same branch with memory, and written as polynomials."""
    memory = vv.RzhanitsynKernel(amplitude=0.015, alpha=0.1, beta=0.05)
    rows = []
    for name, body, stability in (
        ("viscovib, with memory", mount(memory), False),
        ("viscovib, as polynomials", as_polynomials(), False),
        ("viscovib, as polynomials", as_polynomials(), True),
    ):
        job = followed(body, 9, stability)
        found, time = job(), seconds(job)
        rows.append(
            {"method": name, "multipliers": stability, "points": found.nu.size, "seconds": time}
        )
        print(
            f"{name}{', multipliers' if stability else '':14} {show_time(time):>8} "
            f"{found.nu.size} points, {show_time(time / found.nu.size)} a point"
        )
    return rows


def run() -> tuple[list[Row], list[Row]]:
    """All methods for this branch, and further branches of viscovib."""
    rows = own()
    return rows + peers(rows), others()
