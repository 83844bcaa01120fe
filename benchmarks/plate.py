"""A plate of 1e5 coordinates on rubber mounts: reduction, response curve, and memory.

Run in a separate process, so that the memory is that of the plate
(docs/examples/plate_on_mounts.py). Times are processor times.
"""

from __future__ import annotations

import importlib.util
import json
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

Row = dict[str, Any]
SCRIPT = Path(__file__).parents[1] / "docs" / "examples" / "plate_on_mounts.py"


def measure(elements: int) -> dict[str, float]:
    """Seconds, memory and errors of a plate with this number of elements along each edge."""
    import viscovib as vv

    spec = importlib.util.spec_from_file_location("plate_on_mounts", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    structure, _, pushed = made.mounted(elements)
    begun = time.process_time()
    small = structure.reduce(frequency=made.TOP, tolerance=1e-6, loads=[pushed])
    reduced = time.process_time() - begun
    curves = []
    for _ in range(5):
        begun = time.process_time()
        branch = vv.trace_response(
            small, made.BAND, load={pushed: 30.0}, coordinates=[pushed], stability=False,
            tolerance=1e-6,
        )  # fmt: skip
        curves.append(time.process_time() - begun)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    return {
        "coordinates": structure.n_coordinates, "reduction": reduced, "curve": min(curves),
        "points": branch.nu.size, "memory": memory,
        "claimed": small.reduction.largest_error, "error": float(branch.check(points=1)[0]),
    }  # fmt: skip


def run(elements: int = 160) -> list[Row]:
    """Rows of the table of structures."""
    called = [sys.executable, __file__, str(elements)]
    found = json.loads(subprocess.run(called, capture_output=True, text=True, check=True).stdout)
    plate = f"plate of {found['coordinates']} coordinates"
    none = {"whole": np.nan, "ratio": np.nan}
    return [
        {
            "job": f"{plate}: reduced to 1e-6 at 50 frequencies, {found['memory']:.2f} GB",
            "points": 0, "seconds": found["reduction"], "target": 30.0, **none,
            "error": found["claimed"],
        },
        {
            "job": f"{plate}: a curve, checked by the full equations",
            "points": found["points"], "seconds": found["curve"],
            "target": 0.03 / found["points"], **none, "error": found["error"],
        },
    ]  # fmt: skip


if __name__ == "__main__":
    print(json.dumps(measure(int(sys.argv[1]))))
