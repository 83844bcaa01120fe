"""Events of motions in time, also across kinks and jumps of laws: by the steps of SciPy."""

import numpy as np

from referee import sure_events
from referee.case import Case, Claim, even, number
from referee.integration import solve_ivp

JUDGES = ("Event", "Trajectory.__call__")

#: Texts in x with numbers A (height) and B (position), and the same for NumPy.
LAWS = {
    "A*x^3": lambda x, a, b: a * x**3,
    "9*A*max(x - B, 0)": lambda x, a, b: 9 * a * np.maximum(x - b, 0),
    "A*x*abs(x)": lambda x, a, b: a * x * abs(x),
    "A*min(max(x, -B), B)": lambda x, a, b: a * np.clip(x, -b, b),
    "where(x > B, 20*A*(x - B), 0) + where(x < -B, 20*A*(x + B), 0)": lambda x, a, b: (
        20 * a * (np.maximum(x - b, 0) + np.minimum(x + b, 0))
    ),
    "0.1*A*(abs(x - B) - B)": lambda x, a, b: 0.1 * a * (abs(x - b) - b),
    "A*heaviside(x - B)*(x - B)^2": lambda x, a, b: a * (x > b) * (x - b) ** 2,
}
#: Event functions with a number L.
FUNCTIONS = {
    "x - L": lambda t, y, level: y[0] - level,
    "x_dot - L": lambda t, y, level: y[1] - level,
    "x*x_dot + L": lambda t, y, level: y[0] * y[1] + level,
    "sin(x + t) - L": lambda t, y, level: np.sin(y[0] + t) - level,
}
#: Thin functions of an event function U with a width W: their zeros in widths, and the sign of the
#: slope there.
THIN = {
    "exp(-((U)/W)^2) - 0.5": ((-np.sqrt(np.log(2)), 1), (np.sqrt(np.log(2)), -1)),
    "1/(1 + ((U)/W)^2) - 0.5": ((-1.0, 1), (1.0, -1)),
    "W - abs(U)": ((-1.0, 1), (1.0, -1)),
    "tanh((U)/W) - 0.5": ((np.arctanh(0.5), 1),),
    "where(U > W, -1, 1)": ((1.0, -1),),
    "max(U, -W)*max(-(U), -W)": ((0.0, 0),),
    "atan((U)/W)*(1 - ((U)/W)^2)": ((-1.0, -1), (0.0, 1), (1.0, -1)),
}
_END = 12.0


def _levels(text, width):
    """Locations of the events of a thin function, and signs; touching 0 is not an event."""
    return [(place * width, sign) for place, sign in THIN[text] if sign]


def case(rng, index):
    """Draw an oscillator and an event function; compare events and the final state.

    In every fourth case the event errors are compared.
    """
    if index % 4 == 3:
        return sure_events.case(rng)
    text = list(LAWS)[index % len(LAWS)]
    watched = list(FUNCTIONS)[int(rng.integers(len(FUNCTIONS)))]
    a, b, level = even(rng, 0.5, 3, 3), even(rng, 0.1, 0.6, 3), even(rng, -0.4, 0.4, 3)
    k, c, load = even(rng, 0.5, 2, 3), even(rng, 0.02, 0.2, 3), even(rng, 0.2, 0.8, 3)
    nu, start = even(rng, 0.5, 2, 3), [even(rng, -0.5, 0.5, 3), even(rng, -1, 1, 3)]
    law = text.replace("A", number(a)).replace("B", number(b))
    method = ("gauss8", "gauss8", "verner9", "gauss16")[int(rng.integers(4))]
    direction = ("any", "up", "down")[int(rng.integers(3))]
    function = watched.replace("L", f"({level})")
    levels = [(0.0, 1)]
    if index % 3 == 2:
        # Narrower than a step.
        width = float(f"1e-{int(rng.integers(1, 7))}")
        thin = list(THIN)[int(rng.integers(len(THIN)))]
        function = thin.replace("U", function).replace("W", str(width))
        levels = _levels(thin, width)
    call = f"""s = vv.PolynomialSystem(mass=1, stiffness={k}, damping={c}, forces={law!r})
e = vv.Event({function!r}, direction={direction!r})
m = vv.simulate(s, {_END}, load={load}, nu={nu}, initial={start}, dt=0.05, method={method!r},
    events=[e])
last, outcome, times, states = m.state[-1], str(m.outcome), m.events[0].t, m.events[0].state
middle = m(m.t_reached / 3)
"""

    def judge(names, reported):
        def rates(t, y):
            return [y[1], load * np.sin(nu * t) - c * y[1] - k * y[0] - LAWS[text](y[0], a, b)]

        def plain(t, y):
            return FUNCTIONS[watched](t, y, level)

        def through(place, sign):
            def passed(t, y):
                return sign * (plain(t, y) - place)

            passed.direction = {"any": 0, "up": 1, "down": -1}[direction]
            return passed

        run = solve_ivp(
            rates, (0, _END), start, "DOP853", rtol=1e-11, atol=1e-12, max_step=0.01,
            events=[through(*one) for one in levels], dense_output=True,
        )  # fmt: skip
        yield Claim("outcome", names["outcome"], "completed")
        size = max(1.0, np.abs(run.y).max())
        yield Claim("state", names["last"] / size, run.y[:, -1] / size, 1e-6, damage=1e-2)
        yield Claim("between", names["middle"] / size, run.sol(_END / 3) / size, 1e-6, damage=1e-2)
        t = np.linspace(0, _END, 40_001)
        g = plain(t, run.sol(t))
        turns = np.flatnonzero(np.diff(np.sign(np.diff(g))) != 0) + 1
        ends = np.append(g[turns], g[[0, -1]])
        if any(np.abs(ends - place).min() < 1e-4 for place, _ in levels):
            return
        times = np.sort(np.concatenate([np.empty(0), *(run.t_events or [])]))
        yield Claim("events", len(names["times"]), len(times))
        if len(names["times"]):
            yield Claim("times", names["times"], times, 1e-5, damage=1e-2)
            here = plain(names["times"], names["states"].T)
            off = np.min([np.abs(here - place) for place, _ in levels], axis=0)
            yield Claim("on it", 1 + off.max(), 1.0, 1e-10)

    return Case(call, judge)
