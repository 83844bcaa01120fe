"""Orders chosen at each frequency against one number of them for all, of the same accuracy."""

import time
import warnings

import numpy as np
import viscovib as vv
from timing import pair

LOAD = 0.5
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)


def systems() -> dict[str, tuple[object, np.ndarray]]:
    """Name, system and frequencies, from low ones, where motions are far from sines, upwards."""
    stiffness = np.array([[10.0, -5.0], [-5.0, 4.5]])
    given = {
        "mass": 1.0,
        "inertia": 0.1,
        "offset": 0.5,
        "stiffness_x": 10.0,
        "stiffness_phi": 2.0,
        "damping": 0.02 * stiffness,
    }
    kernel = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
    nu = np.linspace(0.5, 10, 500)
    return {
        "mount, cubic": (vv.Mount(**given), nu),
        "mount, cubic, memory": (vv.Mount(**given, kernel=kernel), nu),
        "mount, exact, memory": (vv.Mount(**given, kernel=kernel, geometry="exact"), nu),
        "Duffing": (
            vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="x^3"),
            np.linspace(0.1, 4, 500),
        ),
    }


def _size(x: np.ndarray) -> np.ndarray:
    """The norm of tolerances, with the inertia of a mount."""
    weights = np.sqrt([1.0, 0.1][: x.shape[1]])[:, np.newaxis]
    return (weights * (np.abs(x.real) + np.abs(x.imag))).max(axis=(1, 2))


def run() -> list[dict[str, object]]:
    """One row a system and tolerance: times, errors, and the fewest orders for all as accurate."""
    warnings.simplefilter("ignore")
    rows = []
    for name, (system, nu) in systems().items():
        exact = vv.forced_response(
            system, nu, load=LOAD, method="newton", harmonics=59, tolerance=1e-13
        )

        def solve(harmonics, tolerance, system=system, nu=nu):
            return vv.forced_response(
                system, nu, load=LOAD, method="newton", harmonics=harmonics, tolerance=tolerance
            )

        def error(r, exact=exact) -> float:
            change = exact.coefficients.copy()
            change[:, :, : r.harmonics.size] -= r.coefficients
            found = _size(change) / _size(exact.coefficients)
            # One sweep may leave its branch a few frequencies before the other.
            return float(np.sort(found)[-5])

        for tolerance in TOLERANCES:
            chosen = solve("auto", tolerance)
            reached = error(chosen)
            fixed = next(k for k in range(1, 59, 2) if error(solve(k, tolerance)) <= reached)
            ours, theirs, ratio = pair(
                lambda tolerance=tolerance, solve=solve: solve("auto", tolerance),
                lambda tolerance=tolerance, solve=solve, fixed=fixed: solve(fixed, tolerance),
                clock=time.process_time,
            )
            rows.append(
                {
                    "system": name,
                    "tolerance": tolerance,
                    "error": reached,
                    "median": float(np.median(chosen.highest)),
                    "most": int(chosen.highest.max()),
                    "seconds_a_point": ours / nu.size,
                    "fixed": fixed,
                    "fixed_error": error(solve(fixed, tolerance)),
                    "fixed_seconds_a_point": theirs / nu.size,
                    "ratio": ratio,
                }
            )
    return rows
