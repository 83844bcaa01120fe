"""Peers for a motion with memory: pycaputo, and idesolver for a short motion.

pycaputo solves D^a y = f(t, y) with an order for each unknown. The Koltunov-Rzhanitsyn kernel is
converted by z(t) = exp(beta t) w(t), w = int_0^t (t-s)^(alpha-1)/Gamma(alpha) exp(-beta (t-s))
F(u(s)) ds, for which D^alpha z = exp(beta t) F(u), z(0) = 0, and M u'' = P - F + A Gamma(alpha) w:
six unknowns of orders 1, 1, 1, 1, alpha, alpha. It sums the whole past at every step.

idesolver iterates y' = c(t, y) + int_0^t k(t, s) F(y(s)) ds over the whole interval and computes
each integral with quad of SciPy. The singularity (t-s)^(-0.9) is expensive, so only a short motion
is possible. Version 1.1.0 fails under NumPy 2 because of a name and a keyword; both are fixed here.
"""

import warnings
from collections.abc import Callable, Iterator
from math import gamma

import numpy as np

NU, LOAD = 1.5, 0.5
AMPLITUDE, ALPHA, BETA = 0.048, 0.1, 0.05
MASS = np.array([1.0, 0.1])
Job = Callable[[], np.ndarray]


def spring_force(x: float, phi: float) -> np.ndarray:
    """K u + N(u) of the cubic geometry."""
    return np.array(
        [
            10 * x - 5 * phi + 5 / 6 * phi**3,
            -5 * x + 4.5 * phi + 2.5 * phi**2 * x - 5 / 3 * phi**3,
        ]
    )


def caputo(method: str, n: int, end: float) -> Job:
    """Return a job of pycaputo in n steps."""
    from pycaputo.controller import make_fixed_controller
    from pycaputo.derivatives import CaputoDerivative
    from pycaputo.events import StepAccepted
    from pycaputo.fode import caputo as methods
    from pycaputo.stepping import evolve

    kind = getattr(methods, method)
    orders = tuple(CaputoDerivative(a) for a in (1.0, 1.0, 1.0, 1.0, ALPHA, ALPHA))

    def source(t: float, y: np.ndarray) -> np.ndarray:
        force = spring_force(y[0], y[1])
        pull = -force + AMPLITUDE * gamma(ALPHA) * np.exp(-BETA * t) * y[4:]
        pull[0] += LOAD * np.sin(NU * t)
        return np.concatenate([y[2:4], pull / MASS, np.exp(BETA * t) * force])

    def job() -> np.ndarray:
        solver = kind(
            ds=orders, control=make_fixed_controller(end / n, tstart=0.0, tfinal=end),
            source=source, y0=(np.zeros(6),), **({"corrector_iterations": 1} if
            method.startswith("PEC") else {}),
        )  # fmt: skip
        *_, last = (e for e in evolve(solver, dtinit=end / n) if isinstance(e, StepAccepted))
        return last.y[:2] if abs(last.t - end) < 1e-9 * end else np.full(2, np.nan)

    return job


def idesolver(points: int, tolerance: float, end: float) -> Job:
    """Return a job of idesolver with its result at this number of points."""
    from idesolver import IDESolver, idesolver as inner

    if not hasattr(np, "ComplexWarning"):
        setattr(np, "ComplexWarning", np.exceptions.ComplexWarning)  # noqa: B010
    inner.coerce_to_array = np.atleast_1d

    def own(t: float, y: np.ndarray) -> np.ndarray:
        pull = -spring_force(y[0], y[1])
        pull[0] += LOAD * np.sin(NU * t)
        return np.concatenate([y[2:], pull / MASS])

    def remembered(y: np.ndarray) -> np.ndarray:
        return np.concatenate([np.zeros(2), spring_force(y[0], y[1]) / MASS])

    def job() -> np.ndarray:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return IDESolver(
                x=np.linspace(0, end, points), y_0=np.zeros(4), c=own,
                d=lambda t: np.ones(1), f=remembered, upper_bound=lambda t: t,
                k=lambda t, s: np.array([AMPLITUDE * np.exp(-BETA * (t - s)) * (t - s) **
                                         (ALPHA - 1)]),
                global_error_tolerance=tolerance, max_iterations=60, ode_atol=tolerance / 10,
                ode_rtol=tolerance / 10, int_atol=tolerance / 10, int_rtol=tolerance / 10,
            ).solve()[:2, -1]  # fmt: skip

    return job


def long_runs(end: float) -> Iterator[tuple[str, str, int, Job]]:
    """Method, setting, steps and job of the methods that reach the end of the long motion."""
    try:
        import pycaputo  # noqa: F401
    except ImportError:
        print("pycaputo is not installed: left out")
        return
    for method, counts in (("PECE", (800, 1600, 3200)), ("ExplicitTrapezoidal", (1600, 3200))):
        for n in counts:
            yield f"pycaputo {method}", f"{n} steps", n, caputo(method, n, end)


def short_runs(end: float) -> Iterator[tuple[str, str, int, Job]]:
    """The same for a motion of one second."""
    try:
        import idesolver as _  # noqa: F401
    except ImportError:
        print("idesolver is not installed: left out")
        return
    for points, tolerance in ((20, 1e-2), (40, 1e-3)):
        yield "idesolver", f"{points} points", points, idesolver(points, tolerance, end)
