"""Branch points under force laws other than polynomials, and the cost of polynomials as text laws.

One mass on a spring with one law, harmonics up to 15, without stability, from below to above the
resonance. A time is the time of a call divided by the number of points. A polynomial as a text
law is compared with the same polynomial given by coefficients; both are run alternately. pyHarm
also has a Jenkins element and a penalty contact; it uses 256 samples per period.
"""

import math
import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import motion
import numpy as np
import peer_friction
import viscovib as vv

Row = dict[str, Any]

#: Target time of a branch point (s), by law.
_JENKINS, _TANH = 80e-6, 40e-6
_ROUNDS = 15
#: Target overhead of a polynomial as text law, and of a load by a formula, as a fraction.
MOST_RATIO, MOST_OF_LOAD = 1.5, 1.05


def _free(forces: Any) -> vv.PolynomialSystem:
    return vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces=forces)


def _on_spring(*elements: Any) -> vv.Structure:
    return vv.Structure(mass=[[1.0]], stiffness=[[1.0]], damping=[[0.05]], elements=list(elements))


def cases() -> dict[str, tuple[Any, float | None]]:
    """Systems by the name of their law, and the target."""
    return {
        "tanh(v) friction": (_free("0.3*tanh(x_dot)"), _TANH),
        "tanh(v/0.5) friction": (_free("0.3*tanh(x_dot/0.5)"), _TANH),
        "tanh(v/0.1) friction": (_free("0.3*tanh(x_dot/0.1)"), _TANH),
        "sin(x)": (_free("0.3*sin(x)"), None),
        "Jenkins element": (_on_spring(vv.Jenkins(on="x1", stiffness=1, limit=0.3)), _JENKINS),
        "gap, penalty": (_free("3*max(x - 0.5, 0)"), None),
        "quadratic damping": (_free("0.3*x_dot*abs(x_dot)"), None),
    }


def _job(system: Any) -> Callable[[], Any]:
    load = [0.5] if isinstance(system, vv.Structure) else 0.5

    def job() -> Any:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", vv.ConvergenceWarning)
            return vv.trace_response(
                system, (0.5, 1.6), load=load, harmonics=15, tolerance=1e-6, stability=False
            )

    return job


def _by_turns(jobs: list[Callable[[], Any]]) -> list[tuple[float, int]]:
    """Least time of each job, measured in turn, and numbers of points."""
    best = [float("inf")] * len(jobs)
    points = [job().nu.size for job in jobs]
    for _ in range(_ROUNDS):
        for i, job in enumerate(jobs):
            start = time.perf_counter()
            job()
            best[i] = min(best[i], time.perf_counter() - start)
    return list(zip(best, points, strict=True))


def _of_peer(law: str) -> float:
    """Time of pyHarm per point after compilation; NaN for a law that it does not have."""
    if law not in peer_friction.ELEMENTS:
        return float("nan")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        job = peer_friction.branch(law, 0.1)
        job()
        start = time.perf_counter()
        points = len(job())
        return (time.perf_counter() - start) / points


def run() -> tuple[list[Row], list[Row]]:
    """Return rows of branch points by law, and of text laws with the same polynomials."""
    systems = cases()
    found = _by_turns([_job(system) for system, _ in systems.values()])
    rows = [
        {"law": name, "seconds": best / n, "points": n, "target": target}
        for (name, (_, target)), (best, n) in zip(systems.items(), found, strict=True)
    ]
    problem = peer_friction.missing()
    if problem:
        print(problem)
    for row in rows:
        row["peer"] = float("nan") if problem else _of_peer(row["law"])
    pairs = {
        "0.3*x^3 of a system": (_free("0.3*x^3"), _free({"x": "0.1*x*x*x + 0.2*x^3"})),
        "k3*d^3 of an element": (
            _on_spring(vv.Spring(on="x1", law="0.3*d^3")),
            _on_spring(vv.Spring(on="x1", law="k3*d*abs(1)*d^2*cos(0)", parameters={"k3": 0.3})),
        ),
    }
    ratios = []
    for name, (plain, text) in pairs.items():
        (first, n), (second, m) = _by_turns([_job(plain), _job(text)])
        ratios.append(
            {"law": name, "seconds": first / n, "text": second / m,
             "ratio": (second / m) / (first / n)}
        )  # fmt: skip
    return rows, ratios


def varying_loads() -> list[Row]:
    """Branches under loads by formulas in the frequency, with the same under a constant load.

    The formulas have the value of the constant load, so that the points are the same.
    """
    chain = np.diag(np.full(40, 2.0)) - np.diag(np.ones(39), 1) - np.diag(np.ones(39), -1)
    element = vv.Spring(on="x1", stiffness=0.3, law="0.3*d^3")
    systems = {
        "one mass": (_free("x^3"), "x", 0.2, (0.3, 2.0)),
        "40 masses": (
            vv.Structure(mass=np.eye(40), stiffness=chain, modal_damping=0.03, elements=[element]),
            "x3", 0.05, (0.1, 1.5),
        ),
    }  # fmt: skip
    rows = []
    for name, (system, on, size, ends) in systems.items():
        formulas = (f"{size} + 1e-14*nu^2", f"{size}*sqrt(1 + 0*nu)*exp(0*nu)")

        def job(load: complex | str, system: Any = system, on: str = on, ends: Any = ends) -> Any:
            return lambda: vv.trace_response(
                system, ends, load={1: {on: load}}, harmonics=15, tolerance=1e-6, stability=False
            )

        first, *others = _by_turns([job(load) for load in (size, *formulas)])
        for formula, (best, n) in zip(formulas, others, strict=True):
            plain = first[0] / first[1]
            rows.append({"system": name, "load": formula, "constant": plain, "seconds": best / n,
                         "ratio": best / n / plain})  # fmt: skip
    return rows


def ensembles(n: int = 64) -> list[Row]:
    """Motions of a text law and of the pendulum to t = 200, eight per register, measured in turn.

    Errors refer to collocation of order 32 with small steps, which the tests compare with SciPy.
    """
    text = vv.PolynomialSystem(
        mass=1, stiffness=1, damping=0.05, forces="0.3*tanh(x_dot) + 0.2*sin(x)"
    )
    starts = np.stack([np.linspace(-1, 1, n), np.zeros(n)], 1)
    swings = np.tile(motion.START, (n, 1))
    swings[:, 2] = np.linspace(-0.5, 0.5, n)
    of = {
        "pendulum": {"system": vv.Pendulum(**motion.P1R), "initial": swings},
        "0.3*tanh(x_dot) + 0.2*sin(x)": {"system": text, "initial": starts, "load": 0.5, "nu": 0.9},
    }
    steps = {
        "verner9": (0.5, 0.3, 0.2),
        "gauss8": (1.6, 1.0, 0.7),
    }
    # Systems with laws only.
    series = {"taylor8": (0.4, 0.3), "taylor12": (0.5, 0.4, 0.3), "taylor20": (0.6, 0.5, 0.4)}
    rows: list[Row] = []
    for name, given in of.items():
        expected = _many(given, "gauss16", 1.0).state
        for method, sizes in (steps | ({} if name == "pendulum" else series)).items():
            for dt in sizes:
                error = float(np.abs(_many(given, method, dt).state - expected).max())
                rows.append({"law": name, "method": method, "dt": dt, "error": error,
                             "given": given, "seconds": float("inf")})  # fmt: skip
    for _ in range(_ROUNDS):
        for row in rows:
            start = time.perf_counter()
            _many(row["given"], row["method"], row["dt"])
            row["seconds"] = min(row["seconds"], (time.perf_counter() - start) / n)
    for row in rows:
        del row["given"]
    return rows


def _many(given: dict[str, Any], method: str, dt: float) -> Any:
    return vv.simulate_ensemble(**given, t_end=motion.END, dt=dt, method=method, n_threads=1)


#: Errors at which ensembles are compared with heyoka's.
WANTED = (1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13)


def beside_heyoka(n: int = 128, rounds: int = 15) -> list[Row]:
    """Ensembles of the pendulum and of a text law to t = 200 on one core, viscovib and heyoka.

    For each error: the least processor time per motion of the fastest setting with this error,
    measured in turn in one run, and the ratio of heyoka to viscovib. One state per motion is kept.
    """
    text = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces=_TEXT)
    starts = np.stack([np.linspace(-1, 1, n), np.zeros(n)], 1)
    swings = np.tile(motion.START, (n, 1))
    swings[:, 2] = np.linspace(-0.5, 0.5, n)
    of: dict[str, tuple[dict[str, Any], Any]] = {
        "pendulum": (
            {"system": vv.Pendulum(**motion.P1R), "initial": swings},
            motion.heyoka_system,
        ),
        _TEXT: ({"system": text, "initial": starts, "load": _LOAD, "nu": _NU}, _heyoka_system),
    }
    steps = {
        "verner9": (1.0, 0.8, 0.7, 0.6, 0.5, 0.4, 0.35, 0.3, 0.25, 0.2, 0.17),
        "gauss8": (2.0, 1.8, 1.6, 1.4, 1.3, 1.2, 1.1, 1.0, 0.9, 0.8),
    }
    # Of systems with laws only.
    series = {
        "taylor8": (0.45, 0.425, 0.4, 0.375, 0.35, 0.3, 0.25, 0.2),
        "taylor12": (0.6, 0.55, 0.5, 0.45, 0.4, 0.375, 0.35, 0.325, 0.3, 0.275, 0.25),
        "taylor16": (0.7, 0.65, 0.6, 0.55, 0.5, 0.45, 0.4, 0.375, 0.35, 0.325, 0.3),
        "taylor20": (0.75, 0.7, 0.65, 0.6, 0.55, 0.5, 0.475, 0.45, 0.425, 0.4),
        "taylor24": (0.7, 0.6, 0.55, 0.5, 0.45),
    }
    table: list[Row] = []
    for name, (given, make) in of.items():
        expected = _many(given, "gauss16", 1.0).state
        ours = [
            (f"{method}, {dt:g}", lambda g=given, m=method, dt=dt: _many(g, m, dt).state)
            for method, sizes in (steps | ({} if name == "pendulum" else series)).items()
            for dt in sizes
        ]
        peers = [
            (setting, job) for _, setting, job in motion.heyoka_ensemble(given["initial"], make)
        ]
        if not peers:
            print("heyoka is not installed: the comparison of ensembles is skipped")
            return []
        jobs = [*ours, *peers]
        errors = [float(np.abs(job() - expected).max()) for _, job in jobs]
        times = np.empty((rounds, len(jobs)))
        for i in range(rounds):
            for j, (_, job) in enumerate(jobs):
                start = time.process_time()
                job()
                times[i, j] = (time.process_time() - start) / n
        least = times.min(axis=0)
        for wanted in WANTED:
            best = [
                min((j for j in some if errors[j] <= wanted), key=lambda j: least[j], default=-1)
                for some in (range(len(ours)), range(len(ours), len(jobs)))
            ]
            row: Row = {"law": name, "error": wanted}
            for who, j in zip(("viscovib", "heyoka"), best, strict=True):
                row[who] = jobs[j][0] if j >= 0 else ""
                row[f"{who}_seconds"] = float(least[j]) if j >= 0 else math.nan
            row["ratio"] = row["heyoka_seconds"] / row["viscovib_seconds"]
            table.append(row)
    return table


#: A text law for one motion: start, load and length.
_TEXT, _START, _LOAD, _NU, _END = "0.3*tanh(x_dot) + 0.2*sin(x)", (1.0, 0.0), 0.5, 0.9, 200.0


def _own_motions() -> Iterator[tuple[str, str, Callable[[], Any]]]:
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces=_TEXT)
    settings = {
        "gauss8": ((1.6, 1e-10), (1.4, 1e-10), (1.3, 1e-10), (1.0, 1e-12)),
        "verner9": ((0.7, None), (0.5, None), (0.3, None)),
    }
    for method, steps in settings.items():
        for dt, solved in steps:
            yield (
                f"viscovib {method}",
                f"dt = {dt}",
                lambda method=method, dt=dt, solved=solved: vv.simulate(
                    system, _END, initial=_START, load=_LOAD, nu=_NU, dt=dt, method=method,
                    tolerance=solved, keep="last",
                ).state[-1],
            )  # fmt: skip


def _of_numbalsoda() -> Iterator[tuple[str, str, Callable[[], Any]]]:
    try:
        import numba
        from numbalsoda import dop853, lsoda_sig
    except ImportError:
        print("numbalsoda is not installed: left out")
        return

    @numba.cfunc(lsoda_sig)
    def derivative(t: float, y: Any, out: Any, _: Any) -> None:
        law = 0.3 * math.tanh(y[1]) + 0.2 * math.sin(y[0])
        out[0] = y[1]
        out[1] = 0.5 * math.sin(0.9 * t) - 0.05 * y[1] - y[0] - law

    times, start = np.array([0.0, _END]), np.array(_START)
    for tolerance in (1e-9, 1e-10, 1e-11, 1e-12):
        yield (
            "numbalsoda DOP853",
            f"rtol {tolerance:g}",
            lambda tolerance=tolerance: dop853(
                derivative.address, start, times, rtol=tolerance, atol=tolerance / 10
            )[0][-1],
        )


def _heyoka_system() -> tuple[Any, list[Any]]:
    """The same law for the Taylor integrator of heyoka."""
    import heyoka as hy

    x, v = hy.make_vars("x", "v")
    law = 0.3 * hy.tanh(v) + 0.2 * hy.sin(x)
    return hy, [(x, v), (v, _LOAD * hy.sin(_NU * hy.time) - 0.05 * v - x - law)]


def _of_heyoka() -> Iterator[tuple[str, str, Callable[[], Any]]]:
    try:
        hy, rates = _heyoka_system()
    except ImportError:
        print("heyoka is not installed: left out")
        return
    for tolerance in (1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12):
        taylor = hy.taylor_adaptive(rates, list(_START), tol=tolerance, fast_math=True)

        def run(taylor: Any = taylor) -> Any:
            taylor.time = 0.0
            taylor.state[:] = _START
            taylor.propagate_until(_END)
            return taylor.state.copy()

        yield "heyoka, fast_math", f"tol {tolerance:g}", run


def one_motion() -> list[Row]:
    """One motion of a text law to t = 200: times and errors of viscovib and peers, in turn."""
    jobs = [*_own_motions(), *_of_numbalsoda(), *_of_heyoka()]
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces=_TEXT)
    expected = vv.simulate(
        system, _END, initial=_START, load=_LOAD, nu=_NU, dt=0.5, method="gauss16", keep="last"
    ).state[-1]
    rows: list[Row] = [
        {"method": method, "setting": setting, "seconds": float("inf"),
         "error": float(np.abs(job() - expected).max())}
        for method, setting, job in jobs
    ]  # fmt: skip
    for _ in range(_ROUNDS):
        for row, (_, _, job) in zip(rows, jobs, strict=True):
            start = time.perf_counter()
            for _ in range(5):
                job()
            row["seconds"] = min(row["seconds"], (time.perf_counter() - start) / 5)
    return rows
