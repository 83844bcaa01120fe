"""Branch of the mount through its folds: time a point and error against independent references."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import viscovib as vv
from timing import seconds, show_time

DATA = Path(__file__).parents[1] / "data"
STIFFNESS = np.array([[10.0, -5.0], [-5.0, 4.5]])
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
    """Write down the same problem as a user would who has no mount."""
    return vv.PolynomialSystem(
        mass=[1.0, 0.1],
        stiffness=STIFFNESS,
        damping=0.02 * STIFFNESS,
        forces={"x": "5/6*phi^3", "phi": "2.5*phi^2*x - 5/3*phi^3"},
        names=("x", "phi"),
    )


def run() -> list[Row]:
    """Whole curves from nu = 0.5 to 10 at a load of 0.5."""
    folds = json.loads((DATA / "mount_periodic_reference.json").read_text())["folds_nu"]
    memory = vv.RzhanitsynKernel(amplitude=0.015, alpha=0.1, beta=0.05)
    rows = []
    for title, body, harmonics, stability in (
        ("orders to 9", mount(), 9, False),
        ("orders to 11", mount(), 11, False),
        ("orders to 15", mount(), 15, False),
        ("orders to 9, with multipliers", mount(), 9, True),
        ("orders to 9, with memory", mount(memory), 9, False),
        ("orders to 9, as polynomials", as_polynomials(), 9, False),
        ("same with multipliers", as_polynomials(), 9, True),
    ):

        def job(
            body: vv.Mount | vv.PolynomialSystem = body,
            harmonics: int = harmonics,
            stability: bool = stability,
        ) -> vv.Branch:
            return vv.trace_response(
                body, (0.5, 10.0), load=0.5, harmonics=harmonics, stability=stability
            )

        branch, time = job(), seconds(job)
        error = np.nan if body.kernel else float(np.abs(branch.folds - folds).max())
        rows.append({"job": title, "seconds": time, "points": branch.nu.size, "fold_error": error})
        print(
            f"{title:32} {show_time(time):>8} {branch.nu.size} points, "
            f"{show_time(time / branch.nu.size)} a point, folds to {error:.1e}"
        )
    return rows
