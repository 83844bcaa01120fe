"""Time steps up to and beyond the stability limit, for every method of vv.simulate."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import viscovib as vv
from scenes import PENDULUM, START, far, mount
from scipy.integrate import DOP853
from tally import Row, Tally

OF_PENDULUM = ("gauss2", "gauss3", "gauss8", "gauss16", "rk4", "dop8", "verner8", "verner9")
OF_MOUNT = ("gauss2", "gauss3", "gauss4", "gauss6", "gauss8")
Job = Callable[[], Row]
#: Factor by which an error may exceed its estimate.
HONEST = 3.0
END = 64.0


def jobs(quick: bool) -> Iterator[tuple[str, Job]]:
    """One job per row."""
    counts = 5 if quick else 41
    for method in OF_PENDULUM:
        yield f"steps, pendulum {method}", lambda m=method: of_pendulum(m, counts)
    for method in OF_MOUNT[-1:] if quick else OF_MOUNT:
        yield f"steps, mount {method}", lambda m=method: of_mount(m, counts)
    for method in ("rk4", "dop8", "verner8", "verner9"):
        yield f"edge of {method}", lambda m=method: edge_of_explicit(m)
    for method in ("gauss2", "gauss3", "gauss8", "gauss16"):
        yield f"edge of {method}", lambda m=method: edge_of_gauss(m)


def of_pendulum(method: str, count: int) -> Row:
    """Errors against gauss16 with steps of 0.1, each with its estimate."""
    body = vv.Pendulum(**PENDULUM)

    def run(dt: float) -> vv.Trajectory:
        return vv.simulate(
            body, END, dt=dt, initial=START, method=method, estimate_error=True,
            save_every=1, keep="last",
        )  # fmt: skip

    exact = vv.simulate(body, END, dt=0.1, initial=START, method="gauss16", keep="last")
    return _sweep(f"pendulum, {method}", run, exact, count)


def of_mount(method: str, count: int) -> Row:
    """The mount with memory and cubic terms, from rest under a load."""
    body = mount()

    def run(dt: float, method: str = method) -> vv.Trajectory:
        return vv.simulate(
            body, END, dt=dt, load=0.5, nu=1.5, method=method, estimate_error=True, keep="last"
        )

    return _sweep(f"mount with memory, {method}", run, replace(run(0.02, "gauss8")), count)


def _sweep(
    what: str, run: Callable[[float], vv.Trajectory], exact: vv.Trajectory, count: int
) -> Row:
    steps = END / np.unique(np.geomspace(1, END / 0.05, count).round())[::-1]
    tally = Tally(
        "time step", what, f"dt = {steps[0]:.3g} ... {steps[-1]:.3g}", HONEST,
        "error / its estimate",
    )  # fmt: skip
    before, ended = "", ""
    for dt in steps:
        label = f"dt = {dt:.3g}"
        result = tally.trial(label, lambda dt=dt: run(float(dt)))
        if result is None:
            continue
        tally.check(label, bool(np.isfinite(result.state).all()), "states are not finite")
        if result.outcome != "completed":
            early = 0 <= result.t_reached <= END
            tally.check(label, early, f"stopped at t = {result.t_reached:g}")
            ended = ended or f"{result.outcome} from dt = {dt:.3g} on"
            continue
        error = far(result.state[-1], exact.state[-1])
        size = float(np.abs(exact.state[-1]).max())
        estimate = max(float(result.error or 0) / size, 1e-13)
        if not ended:
            before = f"error {error:.1e} before that (dt = {dt:.3g})"
        # An estimate of 10 % or more only states that the step is too large.
        if estimate < 0.1:
            tally.measure(label, error / estimate)
    tally.notes.append(ended + "; " + before if ended else f"completed everywhere; {before}")
    return tally.row()


def edge_of_explicit(method: str) -> Row:
    """Largest h omega at which the linear oscillator does not grow, and that of R(z)."""
    known = {"rk4": _edge([[0] * 4, [0.5, 0, 0, 0], [0, 0.5, 0, 0], [0, 0, 1, 0]],
                          [1 / 6, 1 / 3, 1 / 3, 1 / 6]),
             "dop8": _edge(DOP853.A, DOP853.B)}  # fmt: skip
    tally = Tally(
        "time step", f"undamped oscillator, {method}", "edge by bisection", 1e-3,
        "edge against |R(i h omega)| = 1",
    )  # fmt: skip
    found = tally.trial("bisection", lambda: _bisect(lambda h: _growth(method, h) > 1 + 1e-7))
    assert found is not None
    tally.notes.append(f"grows from h omega = {found:.6g} on")
    if method in known:
        tally.measure("bisection", abs(found / known[method] - 1))
    return tally.row()


def edge_of_gauss(method: str) -> Row:
    """Gauss collocation never grows; its iteration stops converging, and reports it.

    Accelerations are solved to 1e-15, so a step has an error of (h omega)^2 times that.
    """
    tally = Tally(
        "time step", f"undamped oscillator, {method}", "h omega = 0.01 ... 100", 3e-14,
        "growth a step over max(1, (h omega)^2), where completed",
    )  # fmt: skip
    edge = 0.0
    for h in np.geomspace(0.01, 100, 81):
        result = tally.trial(f"h = {h:.3g}", lambda h=h: _oscillate(method, float(h), 64))
        if result is None or result.outcome != "completed":
            edge = edge or h
            continue
        energy = (result.state**2).sum(axis=1)
        growth = abs(np.sqrt(energy[-1] / energy[0]) - 1) / 64
        # Near the edge, from 11 on, the iteration converges slowly and ends further away.
        tally.measure(f"h = {h:.3g}", growth / max(1, h**2), 1e-12 if h > 8 else None)
    tally.notes.append(f"diverged from h omega = {edge:.3g} on")
    return tally.row()


def _oscillate(method: str, h: float, n: int) -> vv.Trajectory:
    oscillator = vv.PolynomialSystem(mass=1, stiffness=1)
    return vv.simulate(oscillator, n * h, dt=h, initial=[1e-3, 0], method=method)


def _growth(method: str, h: float) -> float:
    """Growth factor per step of the linear oscillator, from the middle of a run to its end."""
    run = _oscillate(method, h, 512)
    energy = (run.state**2).sum(axis=1)
    half = energy.size // 2
    return float((energy[-1] / energy[half]) ** (0.5 / (energy.size - 1 - half)))


def _bisect(grows: Callable[[float], bool]) -> float:
    """Smallest value above which the solution grows."""
    steps = np.arange(0.5, 12, 0.05)
    at = next(i for i, h in enumerate(steps) if grows(float(h)))
    low, high = float(steps[at - 1]), float(steps[at])
    for _ in range(25):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if grows(middle) else (middle, high)
    return low


def _edge(a: object, b: object) -> float:
    """First y with |R(i y)| > 1, R(z) = 1 + z b (1 - z A)^-1 1."""
    matrix, weights = np.array(a, dtype=float), np.array(b, dtype=float)
    n = weights.size
    matrix = matrix[:n, :n]

    def grows(y: float) -> bool:
        inner = np.linalg.solve(np.eye(n) - 1j * y * matrix, np.ones(n))
        return bool(abs(1 + 1j * y * weights @ inner) > 1 + 1e-7)

    return _bisect(grows)
