"""Multiple scales: time of each result; the symbolic program OSCILATE if it is installed.

Both compute modulation equations, steady motions and their stability for two cubic oscillators
near 1:3, the first under load. OSCILATE returns formulas, viscovib numbers at 1000 detunings.
``pip install oscilate`` for the comparison.
"""

import contextlib
import io
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import viscovib as vv

sys.path.insert(0, str(Path(__file__).parent))
from timing import machine, seconds, show_time

Row = dict[str, Any]


def pendulum(**change: float) -> vv.Pendulum:
    """Return the parameters of the paper with light damping."""
    numbers = {"e": 0.1, "w2": 0.4, "w3": 0.8, "alpha": 0.5, "c1": 0.005, "c2": 0.005, "c3": 0.005}
    return vv.Pendulum(**{**numbers, **change})


def coupled() -> vv.CubicSystem:
    """Two oscillators near 1:3, coupled by x0^2 x1^2/2 in the potential."""
    cubic = np.zeros((2, 2, 2, 2))
    cubic[0, 0, 0, 0], cubic[1, 1, 1, 1] = 0.5, 0.7
    cubic[0, 0, 1, 1] = cubic[1, 0, 0, 1] = 0.3
    return vv.CubicSystem(
        mass=np.eye(2), stiffness=np.diag([1.0, 9.0]), damping=0.01 * np.eye(2), cubic=cubic,
        load=[[0.01], [0.0]], drives=[1.0],
    )  # fmt: skip


def run() -> list[Row]:
    """Times of the results of viscovib."""
    one = pendulum(f0=0.004, p1=1.02)
    three = pendulum(f0=0.001, m01=0.0004, m02=0.002, p1=1.03, p2=0.375, p3=1.08)
    ms, all_loads = vv.MultipleScales(one), vv.MultipleScales(three, tolerance=0.03)
    tuned = vv.MultipleScales(pendulum(w2=0.57, w3=0.9, f0=0.003, p1=1.06))
    detunings = np.linspace(0.97, 1.08, 1000)
    few = np.linspace(1.05, 1.1, 20)
    of_two = coupled()
    jobs = {
        "expansion of the pendulum": lambda: vv.MultipleScales(three),
        "393 conditions of resonance, with labels": lambda: [r.label for r in three_resonances()],
        "the same without labels": lambda: three_resonances(),
        "1000 detunings, all motions, stability": lambda: ms.response("p1", detunings),
        "20 detunings, three loads at once": lambda: all_loads.response(
            "p2", np.linspace(0.36, 0.39, 20)
        ),
        "20 detunings at w1 ~ 2 w2": lambda: tuned.response("p1", few),
        "two oscillators: expansion and 1000 detunings": lambda: vv.MultipleScales(of_two).response(
            "p1", detunings
        ),
    }

    def three_resonances() -> tuple[vv.Resonance, ...]:
        return all_loads.resonances()

    return [{"job": name, "seconds": seconds(job)} for name, job in jobs.items()]


def peer() -> float | None:
    """Time of OSCILATE for the formulas in seconds, or None."""
    try:
        from oscilate import MMS
        from sympy import Function, symbols
    except ImportError:
        return None
    start = time.perf_counter()
    with contextlib.redirect_stdout(io.StringIO()):
        names = "omega_0 omega_1 c_0 c_1 gamma_0 gamma_1 gamma_01 F epsilon"
        w0, w1, c0, c1, g0, g1, g01, force, eps = symbols(names, real=True, positive=True)
        t = symbols("t", real=True, positive=True)
        x, y = (Function(name, real=True)(t) for name in ("x_0", "x_1"))
        equations = [
            x.diff(t, 2) + w0**2 * x + c0 * x.diff(t) + g0 * x**3 + g01 * x * y**2,
            y.diff(t, 2) + w1**2 * y + c1 * y.diff(t) + g1 * y**3 + g01 * x**2 * y,
        ]
        system = MMS.Dynamical_system(t, [x, y], equations, [w0, w1], F=force, fF=[1, 0])
        _, scaling = MMS.scale_parameters([g0, g1, g01, c0, c1, force], [1] * 6, eps)
        scales = MMS.Multiple_scales_oscillator(system, eps, 1, w0, scaling, ratio_omega_osc=[1, 3])
        scales.apply_MMS()
        steady = MMS.Steady_state(scales)
        steady.solve_forced(solve_dof=0)
        steady.stability_analysis_forced(coord="cartesian", eigenvalues=True)
    return time.perf_counter() - start


def main() -> None:
    """Print the table."""
    print(machine())
    rows = run()
    for row in rows:
        print(f"{row['job']:<50}{show_time(row['seconds'])}")
    theirs = peer()
    if theirs is None:
        print("OSCILATE is not installed")
    else:
        print(f"{'OSCILATE, formulas for the two oscillators':<50}{show_time(theirs)}")
        print(f"ratio {theirs / rows[-1]['seconds']:.0f}")


if __name__ == "__main__":
    main()
