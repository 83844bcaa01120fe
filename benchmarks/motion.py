"""Motion of the pendulum: run time against error, one trajectory and many, and other programs.

Other programs are used if they are installed (`./run bench --peers`); otherwise a line names those
skipped. All compute the same motion: set P1r to t = 200, error of the last state against 20 digits.
Ensembles: P1r with 1024 initial phi in [-0.5, 0.5], largest error of all members against the most
accurate of our own runs.
"""

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import viscovib as vv
from timing import seconds, show_time

P1R = {
    "e": 0.1, "w2": 0.4, "w3": 0.8, "alpha": 0.5, "c1": 0.01, "c2": 0.01, "c3": 0.01,
    "f0": 0.005, "m01": 0.0025, "m02": 0.005, "p1": 0.93, "p2": 0.37, "p3": 0.71,
}  # fmt: skip
START = np.array([0.05, 0.0, 0.3, 0.0, -0.2, 0.0])
END = 200.0
TARGETS = (1e-4, 1e-8, 1e-12)
DATA = Path(__file__).parents[1] / "data"
Row = dict[str, Any]


def reference() -> np.ndarray:
    """State of P1r at t = 200."""
    states = json.loads((DATA / "pendulum_time_reference.json").read_text())["P1r"]["states"]
    return np.array([float(text) for text in states["200"]])


def right_side(t: float, y: Any, out: Any, z_r: float) -> None:
    """The equations in plain Python, for peers that need a function."""
    e, w2, w3, alpha, r = 0.1, 0.4, 0.8, 0.5, 4.0
    z, vz, phi, vphi, psi, vpsi = y[0], y[1], y[2], y[3], y[4], y[5]
    s, c, length = math.sin(phi - psi), math.cos(phi - psi), 1 + z
    a1 = 0.005 * math.cos(0.93 * t) - 0.01 * vz - z - alpha * z * (z * (z + 3 * z_r) + 3 * z_r**2)
    a1 += w2**2 * (math.cos(phi) - 1) + length * vphi**2 + e * c * vpsi**2
    a2 = (0.0025 * math.cos(0.37 * t) - 0.01 * vphi) / length - w2**2 * math.sin(phi)
    a2 -= 2 * vz * vphi + e * s * vpsi**2
    a3 = 0.005 * math.cos(0.71 * t) - 0.01 * vpsi - w3**2 * math.sin(psi)
    a3 -= r * (2 * c * vz * vphi - length * s * vphi**2)
    p = (a3 - r * (s * a1 + c * a2)) / (1 - e * r)
    out[0], out[2], out[4] = vz, vphi, vpsi
    out[1], out[3], out[5] = a1 - e * s * p, (a2 - e * c * p) / length, p


def ours() -> Iterator[tuple[str, str, Callable[[], np.ndarray]]]:
    """Every method of the library, with step sizes or tolerances."""
    body = vv.Pendulum(**P1R)
    steps = {
        "gauss8": [(2.5, 1e-5), (2.2, 1e-6), (2.0, 1e-8), (1.6, 1e-9), (1.3, 1e-11), (1.0, 1e-12)],
        "gauss16": [(2.5, 1e-9), (2.0, 1e-12), (2.0, None)],
        "gauss3": [(0.8, 1e-6), (0.3, 1e-9), (0.1, 1e-12)],
        "gauss2": [(0.2, 1e-6), (0.05, 1e-9)],
        "rk4": [(0.2, None), (0.05, None), (0.013, None)],
        "dop8": [(1.2, None), (0.7, None), (0.5, None), (0.25, None), (0.15, None)],
        "verner8": [(1.2, None), (0.8, None), (0.5, None), (0.25, None), (0.15, None)],
        "verner9": [(1.4, None), (0.8, None), (0.55, None), (0.3, None), (0.2, None)],
    }
    for method, settings in steps.items():
        for dt, tolerance in settings:
            yield (
                f"viscovib {method}",
                f"dt = {dt}",
                lambda method=method, dt=dt, tolerance=tolerance: vv.simulate(
                    body, END, dt=dt, initial=START, method=method, tolerance=tolerance, keep="last"
                ).state[-1],
            )
    for wanted in (1e-4, 1e-8, 1e-12):
        yield (
            'viscovib, dt="auto"',
            f"tolerance {wanted:g}",
            lambda wanted=wanted: vv.simulate(
                body, END, initial=START, tolerance=wanted, keep="last"
            ).state[-1],
        )


def scipy_runs() -> Iterator[tuple[str, str, Callable[[], np.ndarray]]]:
    """DOP853 of SciPy, with a right side compiled by numba if it is installed."""
    from scipy.integrate import solve_ivp

    z_r = vv.Pendulum(**P1R).z_r
    function, name = right_side, "SciPy DOP853, Python right side"
    try:
        import numba

        function, name = numba.njit(right_side), "SciPy DOP853, compiled right side"
    except ImportError:
        print("numba is not installed: SciPy gets a right side in Python")

    def derivative(t: float, y: np.ndarray) -> np.ndarray:
        out = np.empty(6)
        function(t, y, out, z_r)
        return out

    for tolerance in (1e-6, 1e-10, 1e-13):
        yield (
            name,
            f"rtol {tolerance:g}",
            lambda tolerance=tolerance: solve_ivp(
                derivative, (0, END), START, "DOP853", rtol=tolerance, atol=tolerance / 10
            ).y[:, -1],
        )


def heyoka_system() -> tuple[Any, list[Any]]:
    """The equations for the Taylor integrator of heyoka."""
    import heyoka as hy

    z_r, e, w2, w3, alpha, r = vv.Pendulum(**P1R).z_r, 0.1, 0.4, 0.8, 0.5, 4.0
    z, vz, phi, vphi, psi, vpsi = hy.make_vars("z", "vz", "phi", "vphi", "psi", "vpsi")
    s, c, length, t = hy.sin(phi - psi), hy.cos(phi - psi), 1 + z, hy.time
    a1 = 0.005 * hy.cos(0.93 * t) - 0.01 * vz - z - alpha * z * (z * (z + 3 * z_r) + 3 * z_r**2)
    a1 = a1 + w2**2 * (hy.cos(phi) - 1) + length * vphi**2 + e * c * vpsi**2
    a2 = (0.0025 * hy.cos(0.37 * t) - 0.01 * vphi) / length - w2**2 * hy.sin(phi)
    a2 = a2 - 2 * vz * vphi - e * s * vpsi**2
    a3 = 0.005 * hy.cos(0.71 * t) - 0.01 * vpsi - w3**2 * hy.sin(psi)
    a3 = a3 - r * (2 * c * vz * vphi - length * s * vphi**2)
    p = (a3 - r * (s * a1 + c * a2)) / (1 - e * r)
    rates = [vz, a1 - e * s * p, vphi, (a2 - e * c * p) / length, vpsi, p]
    return hy, list(zip([z, vz, phi, vphi, psi, vpsi], rates, strict=True))


def heyoka_runs() -> Iterator[tuple[str, str, Callable[[], np.ndarray]]]:
    """Heyoka, one trajectory, with its fast mathematics."""
    try:
        hy, system = heyoka_system()
    except ImportError:
        print("heyoka is not installed: left out")
        return
    for tolerance in (1e-4, 1e-6, 1e-8, 1e-10, 1e-13):
        taylor = hy.taylor_adaptive(system, START, tol=tolerance, fast_math=True)

        def run(taylor: Any = taylor) -> np.ndarray:
            taylor.time = 0.0
            taylor.state[:] = START
            taylor.propagate_until(END)
            return taylor.state.copy()

        yield "heyoka, fast_math", f"tol {tolerance:g}", run


def numbalsoda_runs() -> Iterator[tuple[str, str, Callable[[], np.ndarray]]]:
    """DOP853 of numbalsoda, completely compiled."""
    try:
        import numba
        from numbalsoda import dop853, lsoda_sig
    except ImportError:
        print("numbalsoda is not installed: left out")
        return
    z_r = vv.Pendulum(**P1R).z_r
    inner = numba.njit(right_side)

    @numba.cfunc(lsoda_sig)
    def derivative(t: float, y: Any, out: Any, _: Any) -> None:
        inner(t, y, out, z_r)

    times = np.array([0.0, END])
    for tolerance in (1e-6, 1e-10, 1e-13):
        yield (
            "numbalsoda DOP853",
            f"rtol {tolerance:g}",
            lambda tolerance=tolerance: dop853(
                derivative.address, START, times, rtol=tolerance, atol=tolerance / 10
            )[0][-1],
        )


def cvode_runs() -> Iterator[tuple[str, str, Callable[[], np.ndarray]]]:
    """CVODE of SUNDIALS by scikit-sundae, Adams methods, compiled right side called by Python."""
    try:
        import numba
        from sksundae.cvode import CVODE
    except ImportError:
        print("scikit-sundae or numba is not installed: CVODE left out")
        return
    z_r, function = vv.Pendulum(**P1R).z_r, numba.njit(right_side)
    times = np.array([0.0, END])

    def derivative(t: float, y: np.ndarray, out: np.ndarray) -> None:
        function(t, y, out, z_r)

    for tolerance in (1e-6, 1e-10, 1e-13):
        solver = CVODE(
            derivative, rtol=tolerance, atol=tolerance / 10, method="Adams", max_num_steps=10**6
        )
        yield (
            "CVODE Adams, compiled right side",
            f"rtol {tolerance:g}",
            lambda solver=solver: solver.solve(times, START).y[-1],
        )


def heyoka_ensemble(
    states: np.ndarray, make: Callable[[], tuple[Any, list[Any]]] = heyoka_system
) -> Iterator[tuple[str, str, Callable[[], np.ndarray]]]:
    """Heyoka in batches of eight."""
    try:
        hy, system = make()
    except ImportError:
        return
    for tolerance in (1e-4, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13, 1e-14):
        batch = hy.taylor_adaptive_batch(system, states[:8].T.copy(), tol=tolerance, fast_math=True)

        def run(batch: Any = batch) -> np.ndarray:
            last = np.empty_like(states)
            for i in range(0, len(states), 8):
                batch.set_time(0.0)
                batch.state[:] = states[i : i + 8].T
                batch.propagate_until(END)
                last[i : i + 8] = batch.state.T
            return last

        yield "heyoka, batch of 8, fast_math", f"tol {tolerance:g}", run


def one_trajectory() -> list[Row]:
    """Run time and error of every method and peer on one trajectory."""
    expected, rows = reference(), []
    for source in (ours, scipy_runs, cvode_runs, numbalsoda_runs, heyoka_runs):
        for method, setting, job in source():
            error = float(np.abs(job() - expected).max())
            slow = method.startswith(("SciPy", "CVODE"))
            time = seconds(job, repeats=3 if slow else 9, shortest=0.0 if slow else 0.005)
            rows.append({"method": method, "setting": setting, "seconds": time, "error": error})
            print(f"{method:34} {setting:18} {error:8.1e} {show_time(time)}")
    return rows


def many_trajectories(n: int = 1024) -> list[Row]:
    """Run time per trajectory on one core, and largest error over the ensemble."""
    body, states = vv.Pendulum(**P1R), np.tile(START, (n, 1))
    states[:, 2] = np.linspace(-0.5, 0.5, n)

    def job(method: str, dt: float) -> Callable[[], np.ndarray]:
        return lambda: (
            vv.simulate_ensemble(
                body, initial=states, t_end=END, dt=dt, method=method, n_threads=1
            ).state
        )

    expected = job("verner9", 0.1)()
    jobs = [
        (f"viscovib {method}", f"dt = {dt}", job(method, dt))
        for method in ("dop8", "verner8", "verner9")
        for dt in (1.3, 1.0, 0.7, 0.5, 0.4, 0.3, 0.2)
    ]
    steps = {"gauss8": (2.5, 2.0, 1.6, 1.3, 1.0, 0.7), "gauss16": (4.0, 3.0, 2.0)}
    jobs += [
        (f"viscovib {method}", f"dt = {dt}", job(method, dt))
        for method in steps
        for dt in steps[method]
    ]
    rows = []
    for method, setting, work in (*jobs, *heyoka_ensemble(states)):
        error = float(np.abs(work() - expected).max())
        time = seconds(work, repeats=5, shortest=0.0) / n
        rows.append({"method": method, "setting": setting, "seconds": time, "error": error})
        print(f"{method:34} {setting:18} {error:8.1e} {show_time(time)} a trajectory")
    return rows


def at_errors(rows: list[Row]) -> list[Row]:
    """Time of each method at given errors, interpolated between its settings."""
    table = []
    for method in dict.fromkeys(row["method"] for row in rows):
        own = sorted((r["error"], r["seconds"]) for r in rows if r["method"] == method)
        errors = np.log([max(e, 1e-16) for e, _ in own])
        times = np.log([t for _, t in own])
        row: Row = {"method": method}
        for target in TARGETS:
            within = errors[0] <= math.log(target)
            row[f"{target:g}"] = (
                math.exp(np.interp(math.log(target), errors, times)) if within else math.nan
            )
        table.append(row)
    return table


def run() -> tuple[list[Row], list[Row]]:
    """Both jobs."""
    return one_trajectory(), many_trajectories()
