"""Pendulums whose spring may reach its pivot, and the time."""

import math

import numpy as np

from referee.case import Case, Claim, even
from referee.integration import solve_ivp
from referee.models import Array, Swinging, pendulum

#: Spring length below which an implicit method is used, and above which an explicit one is used
#: again: near the pivot, damping divided by the square of the length is stiff.
_NEAR, _FAR = 0.02, 0.04
#: Spring length that counts as the pivot: the remaining time is this length over the speed.
_REACHED = 1e-7
_PHASES = 100


def reached(p: Swinging, state: Array, end: float) -> tuple[float, Array]:
    """Return the time at the pivot and the state there; (inf, last state) if it is not reached."""
    t, y, near = 0.0, np.array(state, float), False
    for _ in range(_PHASES):
        bounds = ((_REACHED, -1), (_FAR, 1)) if near else ((_NEAR, -1),)
        events = [_length(*bound) for bound in bounds]
        how = (
            {"method": "Radau", "rtol": 1e-10, "atol": 1e-13, "jac": lambda t, y: _slopes(p, t, y)}
            if near
            else {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13}
        )
        found = solve_ivp(p.right, (t, end), y, events=events, **how)
        t, y = float(found.t[-1]), found.y[:, -1]
        if near and found.t_events[0].size:
            return t + (1 + y[0]) / -y[1], y
        if found.status != 1:
            return math.inf, y
        near = not near
    return math.nan, y


def _length(bound: float, direction: int):
    """Event: the spring has this length."""

    def event(t, y):
        return y[0] + 1 - bound

    event.terminal = True
    event.direction = direction
    return event


def _slopes(p: Swinging, t: float, y: Array) -> Array:
    return p.jacobian(t, np.asarray(y)[np.newaxis])[0]


def case(rng: np.random.Generator, index: int) -> Case:
    """A spring that may reach its pivot; the outcome and the time are checked."""
    p = pendulum(rng, (1e-3, 0.02))
    p = p.__class__(**(vars(p) | {"f0": even(rng, 0.05, 0.5, 2), "p1": even(rng, 0.6, 1.2, 3)}))
    state = [0.0, 0.0, even(rng, -0.3, 0.3, 2), 0.0, 0.0, 0.0]
    if index % 4 >= 2:
        state[2] /= 100  # passes near the pivot, with little angular momentum
    end = even(rng, 20, 40, 3)
    step = "" if index % 2 else ", dt=0.25"
    call = f"""system = {p.source}
try:
    run = vv.simulate(system, {end}, initial={state}, tolerance=1e-6{step})
    state, outcome, reached = run.state, run.outcome, run.t_reached
except vv.InputError as error:
    state, outcome, reached = np.zeros((2, 6)), f"refused: {{error}}", None
"""

    def judge(names, reported):
        when, last = reached(p, state, end)
        crossed = math.isfinite(when)
        other, end_state = reached(p, np.array(state) + 1e-10, end)
        if math.isnan(when) or crossed != math.isfinite(other):
            return
        if (abs(other - when) if crossed else np.abs(end_state - last).max()) > 1e-5:
            return  # chaotic: the true motion is unknown
        if index % 2 == 0 and not crossed and names["outcome"] == "step too large":
            return  # correct for a given step size
        if names["outcome"].startswith("refused") and "step too large" not in names["outcome"]:
            return  # reported as chaotic
        yield Claim("outcome", names["outcome"], "unphysical" if crossed else "completed")
        yield Claim(
            "states kept are numbers",
            bool(np.isfinite(names["state"]).all() and (names["state"][:-1, 0] > -1).all()),
            True,
        )
        if crossed and names["outcome"] == "unphysical" and index % 2:
            yield Claim("time of the stop", names["reached"], when, 1e-5, damage=1e-2)

    return Case(call, judge)
