"""Events of motions in time, also through kinks and jumps of laws: by SciPy's steps."""

import numpy as np
from scipy.integrate import solve_ivp

from referee.case import Case, Claim, even, number

JUDGES = ("Event", "Trajectory.__call__")

#: Texts in x with numbers A (height) and B (place), and the same for NumPy.
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
#: Functions watched with a number L.
FUNCTIONS = {
    "x - L": lambda t, y, level: y[0] - level,
    "x_dot - L": lambda t, y, level: y[1] - level,
    "x*x_dot + L": lambda t, y, level: y[0] * y[1] + level,
    "sin(x + t) - L": lambda t, y, level: np.sin(y[0] + t) - level,
}
_END = 12.0


def case(rng, index):
    """Draw an oscillator and a function of its state; ask for passages and the last state."""
    text = list(LAWS)[index % len(LAWS)]
    watched = list(FUNCTIONS)[int(rng.integers(len(FUNCTIONS)))]
    a, b, level = even(rng, 0.5, 3, 3), even(rng, 0.1, 0.6, 3), even(rng, -0.4, 0.4, 3)
    k, c, load = even(rng, 0.5, 2, 3), even(rng, 0.02, 0.2, 3), even(rng, 0.2, 0.8, 3)
    nu, start = even(rng, 0.5, 2, 3), [even(rng, -0.5, 0.5, 3), even(rng, -1, 1, 3)]
    law = text.replace("A", number(a)).replace("B", number(b))
    method = ("gauss8", "gauss8", "verner9", "gauss16")[int(rng.integers(4))]
    direction = ("any", "up", "down")[int(rng.integers(3))]
    function = watched.replace("L", f"({level})")
    call = f"""s = vv.PolynomialSystem(mass=1, stiffness={k}, damping={c}, forces={law!r})
e = vv.Event({function!r}, direction={direction!r})
m = vv.simulate(s, {_END}, load={load}, nu={nu}, initial={start}, dt=0.05, method={method!r},
    events=[e])
last, outcome, times, states = m.state[-1], str(m.outcome), m.events[0].t, m.events[0].state
middle = m(m.t_reached / 3)
"""

    def judge(names, told):
        def rates(t, y):
            return [y[1], load * np.sin(nu * t) - c * y[1] - k * y[0] - LAWS[text](y[0], a, b)]

        def passed(t, y):
            return FUNCTIONS[watched](t, y, level)

        passed.direction = {"any": 0, "up": 1, "down": -1}[direction]
        run = solve_ivp(
            rates, (0, _END), start, "DOP853", rtol=1e-11, atol=1e-12, max_step=0.01,
            events=passed, dense_output=True,
        )  # fmt: skip
        yield Claim("outcome", names["outcome"], "completed")
        size = max(1.0, np.abs(run.y).max())
        yield Claim("state", names["last"] / size, run.y[:, -1] / size, 1e-6)
        yield Claim("between", names["middle"] / size, run.sol(_END / 3) / size, 1e-6)
        t = np.linspace(0, _END, 40_001)
        g = passed(t, run.sol(t))
        turns = np.flatnonzero(np.diff(np.sign(np.diff(g))) != 0) + 1
        near = np.abs(g[[0, -1]]).min()
        if turns.size:
            near = min(near, np.abs(g[turns]).min())
        if near < 1e-4:
            return
        yield Claim("events", len(names["times"]), len(run.t_events[0]))
        if len(names["times"]):
            yield Claim("times", names["times"], run.t_events[0], 1e-5)
            here = passed(names["times"], names["states"].T)
            yield Claim("on it", 1 + np.abs(here).max(), 1.0, 1e-10)

    return Case(call, judge)
