"""Steady motions of the pendulum: time and error against shooting and against long runs in time."""

from dataclasses import replace
from typing import Any

import numpy as np
import viscovib as vv
from scipy.integrate import solve_ivp
from timing import pair, seconds, show_time

Row = dict[str, Any]
BODY = {"e": 0.1, "w2": 0.4, "w3": 0.8, "alpha": 0.5, "c1": 0.1, "c2": 0.1, "c3": 0.1}
ONE = vv.Pendulum(**BODY, m01=0.01, p2=0.5)
TWO = vv.Pendulum(**BODY, f0=0.02, m01=0.005, p1=0.93, p2=0.37)
THREE = vv.Pendulum(**BODY, f0=0.01, m01=0.001, m02=0.003, p1=0.93, p2=0.37, p3=0.71)
LIGHT = replace(ONE, c1=0.02, c2=0.02, c3=0.02, m01=0.005)


def shoot(pend: vv.Pendulum, tolerance: float) -> np.ndarray:
    """Initial state of the periodic motion by SciPy: Newton's method on the period map."""

    def disturbed(t: float, y: np.ndarray) -> np.ndarray:
        change = pend.jacobian(t, y[:6]) @ y[6:].reshape(6, 6)
        return np.concatenate([pend.rhs(t, y[:6]), change.ravel()])

    start = np.zeros(6)
    for _ in range(20):
        run = solve_ivp(
            disturbed, (0, 2 * np.pi / pend.p2), np.concatenate([start, np.eye(6).ravel()]),
            "DOP853", rtol=tolerance, atol=0.01 * tolerance,
        )  # fmt: skip
        defect = run.y[:6, -1] - start
        step = np.linalg.solve(run.y[6:, -1].reshape(6, 6) - np.eye(6), defect)
        start = start - step
        if np.abs(step).max() < 10 * tolerance:
            break
    return start


def settle(pend: vv.Pendulum) -> vv.Trajectory:
    """Motion from rest until transients are below 1e-11, then as long for its spectrum."""
    return vv.simulate(
        pend, 1000, initial=np.zeros(6), dt=0.25, method="gauss8", keep="tail", tail=500
    )


def run() -> list[Row]:
    """Each time with the largest error of the state, against many more harmonics."""
    rows: list[Row] = []

    def add(title: str, time: float, error: float) -> None:
        rows.append({"job": title, "seconds": time, "error": error})
        print(f"{title:64} {show_time(time):>8}  error {error:.1e}")

    best = vv.forced_response(ONE, harmonics=51, tolerance=1e-13).state(0, 0.0)
    ours, theirs, ratio = pair(
        lambda: vv.forced_response(ONE, harmonics=21, stability=True), lambda: shoot(ONE, 1e-9)
    )
    found = vv.forced_response(ONE, harmonics=21).state(0, 0.0)
    add("periodic motion, orders to 21, with multipliers", ours, float(np.abs(found - best).max()))
    shot = float(np.abs(shoot(ONE, 1e-9) - best).max())
    add(f"  shooting, SciPy DOP853, 1e-9: {ratio:.0f} times as long", theirs, shot)
    for title, stability in (("", False), (", with multipliers", True)):

        def job(stability: bool = stability) -> vv.DrivenBranch:
            return vv.trace_response(LIGHT, p2=(0.25, 0.6), harmonics=15, stability=stability)

        branch, time = job(), seconds(job)
        fine = vv.trace_response(LIGHT, p2=(0.25, 0.6), harmonics=31, stability=False)
        error = float(np.abs(branch.folds - fine.folds).max())
        name = f"branch of {branch.parameter.size} points, two folds, orders to 15{title}"
        add(name, time, error)
    for title, pend, bounds, most in (
        ("two loads", TWO, (8, 14), 28),
        ("three loads", THREE, (6, 8), 14),
    ):
        t = np.linspace(0, 100, 400)
        exact = vv.forced_response(pend, harmonics=most, stability=False).state(0, t)
        for bound in bounds:

            def solve(pend: vv.Pendulum = pend, bound: int = bound) -> vv.DrivenResponse:
                return vv.forced_response(pend, harmonics=bound, stability=False)

            r = solve()
            name = f"{title}, {len(r.orders)} orders up to {bound} in all"
            add(name, seconds(solve, repeats=3), float(np.abs(r.state(0, t) - exact).max()))

        def choose(pend: vv.Pendulum = pend) -> vv.DrivenResponse:
            return vv.forced_response(pend, stability=False)

        r = choose()
        name = f"{title}, as many as 1e-10 needs, {len(r.orders)} up to {r.highest[0]}"
        add(name, seconds(choose, repeats=3), float(np.abs(r.state(0, t) - exact).max()))
        time = seconds(lambda pend=pend: settle(pend), repeats=3)
        motion = settle(pend)
        late = vv.forced_response(pend, harmonics=most, stability=False).state(0, motion.t)
        add("  motion in time to t = 1000 instead", time, float(np.abs(motion.state - late).max()))
    return rows


if __name__ == "__main__":
    run()
