"""Periodic motions in time: SciPy from switch to switch over one period.

A Newton step of the independent period map, with derivatives by differences, estimates the
distance of a start from the periodic motion.
"""

import numpy as np

from referee.case import Case, Claim, even, few
from referee.switched import Automaton, Contact

JUDGES = (
    "steady_motion", "SteadyMotion", "SteadyMotion.__call__", "SteadyMotion.extremes",
    "SteadyMotion.period", "trace_motion", "MotionBranch", "MotionBranch.motion",
)  # fmt: skip

#: Step of the differences, and error of a state by SciPy.
_APART, _LEFT = 1e-5, 2e-11
#: Allowed relative difference of one-sided derivatives.
_ALIKE = 1e-2


def case(rng, index):
    """One or two masses with springs behind gaps, dry friction and rigid stops."""
    n = 1 + index % 2
    mass = [few(rng, 0.5, 3) for _ in range(n)]
    k, c = [few(rng, 0.5, 3) for _ in range(n)], few(rng, 0.05, 0.4)
    stiffness = np.diag(k)
    if n == 2:
        between = few(rng, 0.2, 2)
        stiffness = stiffness + between * np.array([[1, -1], [-1, 1]])
    damping = c * np.eye(n)
    kind, gap = index // 2 % 4, few(rng, 0.1, 0.6)
    friction, stops, elements, sources = [None] * n, [None] * n, [], []
    if kind in (0, 3):
        stiff, both = few(rng, 2, 60), bool(rng.random() < 0.5)
        name = "Stop" if both else "Gap"
        sources.append(f"vv.{name}(on={{'x1': 1}}, stiffness={stiff}, gap={gap})")
        elements.append(Contact(np.eye(n)[0], stiff, gap, both))
    if kind in (1, 3):
        friction[n - 1] = few(rng, 0.02, 0.4)
        sources.append(f"vv.Spring(on='x{n}', stiffness=0, law='{friction[n - 1]}*sign(v)')")
    if kind == 2:
        stops[0] = (gap, even(rng, 0, 0.9, 1))
        sources.append(f"vv.Gap(on='x1', gap={gap}, restitution={stops[0][1]})")
    load, nu = [even(rng, 0.3, 1.0, 3) for _ in range(n)], few(rng, 0.4, 2.0)
    found = f"m = vv.steady_motion(s, {nu}, load={load})"
    if index % 5 == 4:
        found = f"""b = vv.trace_motion(s, ({nu}, {round(1.1 * nu, 4)}), load={load}, max_step=0.1,
    max_points=60)
m = b.motion(-1)"""
    call = f"""s = vv.Structure(mass={np.diag(mass).tolist()}, stiffness={stiffness.tolist()},
    damping={damping.tolist()}, elements=[{", ".join(sources)}])
{found}
outcome, start, error, stable = m.outcome, m.state[0], m.error, m.stable
multipliers, multiplier_error = m.multipliers, m.multiplier_error
nu, period, later = m.nu, m.period, m(m.period / 3)
top = m.extremes('x1')
"""

    def judge(names, reported):
        if names["outcome"] != "converged":
            return
        nu = names["nu"]
        machine = Automaton(
            np.array(mass), stiffness, damping, lambda t: np.array(load) * np.sin(nu * t), elements,
            friction, stops,
        )  # fmt: skip
        start, period = names["start"], names["period"]
        times = np.array([0.0, period / 3, period])

        def after(y, times=times[[0, 2]]):
            found = machine.run(y[::2], y[1::2], times)
            return None if found is None else found[1:]

        mine = after(start, times)
        sides = [after(start + s * _APART * one) for one in np.eye(2 * n) for s in (1, -1)]
        if mine is None or any(one is None for one in sides):
            return
        by = np.array(
            [(a[-1] - b[-1]) / (2 * _APART) for a, b in zip(sides[::2], sides[1::2], strict=True)]
        ).T
        apart = [
            np.abs(a[-1] + b[-1] - 2 * mine[-1]).max() / _APART
            for a, b in zip(sides[::2], sides[1::2], strict=True)
        ]
        if max(apart) > _ALIKE * max(1.0, np.abs(by).max()):
            # A contact is grazed in between: the derivative is one-sided.
            return
        inverse = np.linalg.pinv(np.eye(2 * n) - by)
        enlarged = max(1.0, float(np.abs(inverse).sum(axis=1).max()))
        true = start + inverse @ (mine[-1] - start)
        admitted = 2 * max(1.0, nu) * names["error"] + _LEFT * enlarged
        yield Claim("state at t = 0", start, true, admitted, damage=1e-4)
        yield Claim("a third later", names["later"], mine[0], admitted, damage=1e-4)
        mine_largest = float(np.abs(np.linalg.eigvals(by)).max())
        if names["stable"] is not None and abs(mine_largest - 1) > 1e-2:
            yield Claim("stable", bool(names["stable"]), bool(mine_largest < 1))
        dense = machine.run(start[::2], start[1::2], np.linspace(0, period, 400))
        if dense is not None:
            low, high = names["top"]
            reach = float(np.abs(dense[:, 1]).max()) * period / 400
            yield Claim("smallest x1", low, float(dense[:, 0].min()), reach, damage=3.0)
            yield Claim("largest x1", high, float(dense[:, 0].max()), reach, damage=3.0)

    return Case(call, judge, may_refuse=index % 5 == 4)
