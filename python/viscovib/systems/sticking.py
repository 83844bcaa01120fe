"""Laws with sticking: the force jumps up where a velocity passes 0."""

from __future__ import annotations

import numpy as np

from viscovib.systems.laws import Law
from viscovib.systems.system import System

#: Points near rest; smallest ratio of the secants to them for an infinite slope, and the ratio from
#: which on the law jumps.
_NEAR, _ENDLESS, _JUMPS = (1e-20, 1e-40), 10.0, 1e19
#: Positions at which a law is tested (some stops are open at 0), and a velocity close to 0.
_POSITIONS, _NEARBY = (0.0, 1.0, -1.0, 1e-3, -1e-3, 1e3, -1e3), 1e-250


def advice_on_sticking(system: System) -> str:
    """Return advice if harmonics find no solution and the system can stick, else "".

    Also for laws such as sqrt(abs(x)) without the finite derivative that Newton's method needs.
    """
    laws = system._all_laws
    text = next((law.text for law in laws if _sticks(law)), None)
    if text is None:
        steep = next((one for law in laws if (one := _endless_slope(law))), None)
        return "" if steep is None else f" (the derivative of {steep} grows without bound)"
    return (
        f" (under {text!r} a body may stick, which harmonics do not represent: use simulate, "
        "steady_motion, a Jenkins element, or a steep tanh of the velocity)"
    )


def _sticks(law: Law) -> bool:
    """True if the force is larger for small positive velocities than for negative ones."""
    if not law.branches or law.state or not law.n_rates:
        return False
    n, m = len(law.arguments), len(_POSITIONS)
    at = np.zeros((2, m, n))
    at[:, :, : n - law.n_rates] = np.array(_POSITIONS)[:, np.newaxis]
    for rate in range(n - law.n_rates, n):
        if rate not in law.places:
            continue
        at[:, :, n - law.n_rates :] = 0.0
        at[0, :, rate], at[1, :, rate] = -_NEARBY, _NEARBY
        before, after = law(at.reshape(2 * m, n))[0].reshape(2, m)
        if (after - before > 1e-12 * (np.abs(after) + np.abs(before))).any():
            return True
    return False


def _endless_slope(law: Law) -> str:
    """Return the argument by which a law near rest grows with a power below 1; "" if none."""
    if law.state:
        return ""
    n = len(law.arguments)
    at_rest = law(np.zeros((1, n)))[0][0]
    for place in law.places:
        for side in (1, -1):
            at = np.zeros((2, n))
            at[:, place] = side * np.array(_NEAR)
            steps = np.abs(law(at)[0] - at_rest) / np.array(_NEAR)
            if _ENDLESS * steps[0] < steps[1] < _JUMPS * steps[0]:
                return f"{law.text!r} at {law.arguments[place]} = 0"
    return ""
