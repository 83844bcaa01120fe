"""Decay to subnormal numbers: motions with a damped coordinate without load."""

import time
from collections.abc import Callable, Iterator

import numpy as np
import viscovib as vv
from scenes import kernel_of
from steps import Job
from tally import Row, Tally

TINY = float(np.finfo(float).tiny)
#: Steps before the coordinate has decayed.
ALIVE = 4000


def jobs(quick: bool) -> Iterator[tuple[str, Job]]:
    """One job per row."""
    n = 200_000 if quick else 2_000_000
    for method in ("gauss2", "gauss8", "rk4", "verner9"):
        yield f"fading, {method}", lambda m=method: of_pendulum(m, n)
    yield "fading, ensemble", lambda: of_ensemble(n // 4)
    for memory in (False, True):
        yield "fading, mount", lambda m=memory: of_mount(m, n // 2)


def _row(what: str, n: int, run: Callable[[int], np.ndarray]) -> Row:
    """Time of a step after the decay, relative to that of a step before."""
    tally = Tally(
        "fading", what, f"{n} steps, phi from 1e-2 to below 1e-308", 1.5,
        f"processor time of a step over that in the first {ALIVE}",
    )  # fmt: skip

    def seconds(n_steps: int, times: int) -> float:
        begun = time.process_time()
        for _ in range(times):
            states = tally.trial(f"{n_steps} steps", lambda: run(n_steps))
        spent = time.process_time() - begun
        sizes = np.abs(np.asarray(states))
        tally.check("states", not ((sizes > 0) & (sizes < TINY)).any(), "subnormal numbers")
        return spent / (n_steps * times)

    ratios = [seconds(n, 1) / seconds(ALIVE, n // (10 * ALIVE)) for _ in range(3)]
    tally.measure(f"median of 3, {min(ratios):.2f} ... {max(ratios):.2f}", float(np.median(ratios)))
    return tally.row()


def _pendulum() -> vv.Pendulum:
    return vv.Pendulum(e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.1, c2=0.1, c3=0.1, f0=0.02, p1=0.93)


def of_pendulum(method: str, n: int) -> Row:
    """Only z is driven; phi and psi decay."""
    body = _pendulum()
    return _row(
        f"pendulum, {method}",
        n,
        lambda steps: vv.simulate(
            body, 0.25 * steps, dt=0.25, initial=(0, 0, 0.01, 0, -0.01, 0), method=method,
            save_every=steps // 1000,
        ).state,
    )  # fmt: skip


def of_ensemble(n: int) -> Row:
    """The same, eight per register."""
    body = _pendulum()
    return _row(
        "ensemble of 8 pendulums, rk4",
        n,
        lambda steps: vv.simulate_ensemble(
            body, initial=np.tile((0, 0, 0.01, 0, -0.01, 0), (8, 1)), t_end=0.25 * steps, dt=0.25,
            method="rk4", n_threads=1,
        ).state,
    )  # fmt: skip


def of_mount(memory: bool, n: int) -> Row:
    """Two uncoupled oscillators."""
    body = vv.PolynomialSystem(
        mass=[1, 1], stiffness=[[1, 0], [0, 4]], damping=[[0.2, 0], [0, 0.2]],
        forces={"x1": "0.5*x1^3", "x2": "0.3*x2^3"},
        kernel=kernel_of(0.3, 0.3) if memory else None,
    )  # fmt: skip
    return _row(
        f"oscillators, gauss4, {'memory' if memory else 'no memory'}",
        n,
        lambda steps: vv.simulate(
            body, 0.25 * steps, dt=0.25, initial=[0, 0, 0.01, 0], load=(0.1, 0), nu=0.9,
            method="gauss4", save_every=steps // 1000,
        ).state,
    )  # fmt: skip
