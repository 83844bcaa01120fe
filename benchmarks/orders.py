"""Automatic harmonics per frequency or branch point against a fixed number of equal accuracy."""

import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import viscovib as vv
from timing import pair

LOAD = 0.5
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
#: Function of harmonics and tolerance that returns a result and the coefficients to compare.
Solver = Callable[[int | str, float], tuple[Any, np.ndarray]]


def systems() -> dict[str, tuple[object, np.ndarray]]:
    """Name, system and frequencies, from low frequencies (many harmonics) upwards."""
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
    """The norm used for tolerances, with the inertia of a mount."""
    weights = np.sqrt([1.0, 0.1][: x.shape[1]])[:, np.newaxis]
    return (weights * (np.abs(x.real) + np.abs(x.imag))).max(axis=(1, 2))


def along_frequencies(system: object, nu: np.ndarray) -> Solver:
    """Newton's method at each frequency."""

    def solve(harmonics: int | str, tolerance: float) -> tuple[vv.Response, np.ndarray]:
        found = vv.forced_response(
            system, nu, load=LOAD, method="newton", harmonics=harmonics, tolerance=tolerance
        )
        return found, found.coefficients

    return solve


def along_branch(system: object, nu: np.ndarray) -> Solver:
    """The branch, with points at some of the frequencies."""

    def solve(harmonics: int | str, tolerance: float) -> tuple[vv.Branch, np.ndarray]:
        found = vv.trace_response(
            system, (nu[0], nu[-1]), load=LOAD, harmonics=harmonics, tolerance=tolerance,
            at=nu[7::20], stability=False,
        )  # fmt: skip
        return found, found.coefficients[found.stops]

    return solve


def compare(name: str, solve: Solver, left_out: int) -> list[dict[str, object]]:
    """One row per tolerance: times, errors, and the smallest fixed number that is as accurate.

    ``left_out``: number of largest errors that are ignored.
    """
    exact = solve(59, 1e-13)[1]

    def error(harmonics: int | str, tolerance: float) -> float:
        x = solve(harmonics, tolerance)[1]
        if x.shape[0] != exact.shape[0]:
            return np.inf
        change = exact.copy()
        change[:, :, : x.shape[2]] -= x
        found = _size(change) / _size(exact)
        return float(np.sort(found)[-1 - left_out])

    rows: list[dict[str, object]] = []
    for tolerance in TOLERANCES:
        chosen = solve("auto", tolerance)[0]
        reached = error("auto", tolerance)
        fixed = next(k for k in range(1, 59, 2) if error(k, tolerance) <= reached)
        others = solve(fixed, tolerance)[0]
        ours, theirs, ratio = pair(
            lambda tolerance=tolerance: solve("auto", tolerance),
            lambda tolerance=tolerance, fixed=fixed: solve(fixed, tolerance),
            clock=time.process_time,
        )
        rows.append(
            {
                "system": name,
                "tolerance": tolerance,
                "error": reached,
                "median": float(np.median(chosen.highest)),
                "most": int(chosen.highest.max()),
                "seconds_a_point": ours / chosen.nu.size,
                "fixed": fixed,
                "fixed_error": error(fixed, tolerance),
                "fixed_seconds_a_point": theirs / others.nu.size,
                "ratio": ratio,
            }
        )
    return rows


def run() -> list[dict[str, object]]:
    """Rows of all systems."""
    warnings.simplefilter("ignore")
    rows = []
    for name, (system, nu) in systems().items():
        # The two sweeps may leave their branch at slightly different frequencies.
        rows += compare(name, along_frequencies(system, nu), 4)
        rows += compare(f"{name}: branch", along_branch(system, nu), 0)
    return rows
