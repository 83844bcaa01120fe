"""Force laws with functions: by functions of NumPy, steps of SciPy and the residual of the waveform."""

import re

import numpy as np

from referee.case import Case, Claim, even, few, number
from referee.integration import solve_ivp

JUDGES = (
    "PythonLaw", "Spring", "Spring.degree", "Jenkins", "Jenkins.loop", "Jenkins.energy",
    "Response.extrapolated", "PeriodicMotions.fall_off",
)  # fmt: skip

#: Texts in x with numbers A and B, and the same for NumPy; all smooth.
LAWS = {
    "A*tanh(x/B)": lambda x, a, b: a * np.tanh(x / b),
    "A*sin(x/B)": lambda x, a, b: a * np.sin(x / b),
    "A*x/(B + x^2)": lambda x, a, b: a * x / (b + x**2),
    "A*asinh(x/B) + x^3": lambda x, a, b: a * np.arcsinh(x / b) + x**3,
    "A*(sqrt(B + x^2) - sqrt(B))": lambda x, a, b: a * (np.sqrt(b + x**2) - np.sqrt(b)),
    "A*atan2(x, B)": lambda x, a, b: a * np.arctan2(x, b),
    "A*(exp(-B*x) - 1)": lambda x, a, b: a * (np.exp(-b * x) - 1),
    "A*x*exp(-x^2/B)": lambda x, a, b: a * x * np.exp(-(x**2) / b),
}


#: Texts with the rate v.
RATES = {
    "A*tanh(x_dot/B)": lambda x, v, a, b: a * np.tanh(v / b),
    "A*x_dot*(x^2 + B)": lambda x, v, a, b: a * v * (x**2 + b),
    "A*x_dot/(B + x_dot^2)": lambda x, v, a, b: a * v / (b + v**2),
    "A*x_dot*sqrt(B + x_dot^2)": lambda x, v, a, b: a * v * np.sqrt(b + v**2),
    "A*sin(x)*x_dot^2 + B*x_dot": lambda x, v, a, b: a * np.sin(x) * v**2 + b * v,
    "A*x^2*x_dot + B*sin(x)": lambda x, v, a, b: a * x**2 * v + b * np.sin(x),
}


def _draw(rng):
    if rng.random() < 0.5:
        text = list(RATES)[int(rng.integers(len(RATES)))]
        force = RATES[text]
    else:
        text = list(LAWS)[int(rng.integers(len(LAWS)))]
        alone = LAWS[text]

        def force(x, v, a, b):
            return alone(x, a, b)

    a, b = even(rng, 0.1, 1, 3), even(rng, 0.5, 2, 3)
    if text.startswith("A*(exp"):
        a = -a
    law = text.replace("A", f"({a})").replace("B", f"({b})")
    c, k, load = even(rng, 0.05, 0.3, 3), even(rng, 0.5, 2, 3), even(rng, 0.05, 0.5, 3)
    nu = few(rng, 0.3, 3, 4)
    source = (
        f"vv.PolynomialSystem(mass=1, stiffness={number(k)}, damping={number(c)}, forces={law!r})"
    )
    return source, lambda x, v: force(x, v, a, b), c, k, load, nu


def _steady(rng, index):
    source, force, c, k, load, nu = _draw(rng)
    call = f"""r = vv.forced_response({source}, [{nu}], load={load}, method="newton")
x, orders, truncation, ok = r.coefficients[0, 0], r.harmonics, r.truncation[0], r.converged[0]
"""

    def judge(names, reported):
        if not names["ok"]:
            return
        x, orders = names["x"], names["orders"]
        theta = 2 * np.pi * np.arange(2048) / 2048
        waves = np.exp(1j * np.outer(orders, theta))
        u, v = (x @ waves).imag, ((1j * orders * nu * x) @ waves).imag
        left = (((-((orders * nu) ** 2) + 1j * orders * nu * c + k) * x) @ waves).imag
        left = left + force(u, v) - load * np.sin(theta)
        # The residual of the equation, converted to a displacement by the linear system.
        size = np.abs(u).max() * k + load
        allowed = (1e-8 + 100 * max(names["truncation"], 0.0)) * size
        limit = allowed * max(1.0, (orders.max() * nu) ** 2)
        yield Claim("residual", 1 + np.abs(left).max() / limit, 1.0, 1.0, damage=2.0)
        kept = 2j / 2048 * (left @ waves.conj().T)
        yield Claim("equations kept", np.abs(kept).max() / size + 1, 1.0, 1e-8)

    return Case(call, judge)


def _motion(rng, index):
    source, force, c, k, load, nu = _draw(rng)
    start = [even(rng, -1, 1, 3), even(rng, -1, 1, 3)]
    step = [0.02, "'auto'"][index % 2]
    call = f"""m = vv.simulate({source}, 8.0, load={load}, nu={nu}, initial={start}, dt={step},
    tolerance={None if step == 0.02 else 1e-9})
state, outcome = m.state[-1], str(m.outcome)
"""

    def judge(names, reported):
        run = solve_ivp(
            lambda t, y: [y[1], load * np.sin(nu * t) - c * y[1] - k * y[0] - force(y[0], y[1])],
            (0, 8), start, "DOP853", rtol=1e-12, atol=1e-13, max_step=0.1,
        )  # fmt: skip
        yield Claim("outcome", names["outcome"], "completed")
        yield Claim("state", names["state"], run.y[:, -1], 1e-8)

    return Case(call, judge)


#: NumPy names of functions that accept complex arguments.
_OF_NUMPY = {
    "tanh": "np.tanh", "asinh": "np.arcsinh", "sin": "np.sin", "sqrt": "np.sqrt", "exp": "np.exp",
    "^": "**",
}  # fmt: skip


def _called(rng, index):
    """The same laws as Python functions; without atan2, which accepts no complex numbers."""
    found = (_steady, _motion, _multipliers)[index % 3](rng, index // 3)

    def function(law):
        if "atan2" in law[1]:
            return law[0]
        body = re.sub(r"[a-z]+(?=\()|\^", lambda one: _OF_NUMPY[one[0]], law[1])
        return f"forces=vv.PythonLaw(lambda x, x_dot: {body})"

    return Case(re.sub(r"forces='([^']*)'", function, found.call), found.judge)


def _contact(rng, index):
    """Roots and powers that begin at contact; runs of SciPy end and begin there."""
    power, (a, gap) = (
        [0.5, 1.5, 2.5, 0.75][index % 4],
        (even(rng, 0.2, 20, 3), even(rng, -0.3, 0.3, 3)),
    )
    c, load, nu = even(rng, 0.02, 0.2, 3), even(rng, 0.1, 1, 3), few(rng, 0.3, 2, 4)
    start = [even(rng, -1, 1, 3), even(rng, -1, 1, 3)]
    call = f"""system = vv.PolynomialSystem(mass=1, stiffness=1, damping={c}, forces="{a}*max(x - {gap}, 0)^{power}")
m = vv.simulate(system, 8.0, load={load}, nu={nu}, initial={start})
state, outcome, error = m.state[-1], str(m.outcome), m.error
"""

    def judge(names, reported):
        def rates(t, y):
            pushed = a * max(y[0] - gap, 0.0) ** power
            return [y[1], load * np.sin(nu * t) - c * y[1] - y[0] - pushed]

        def passage(t, y):
            return y[0] - gap

        passage.terminal = True
        how = {"method": "DOP853", "rtol": 3e-14, "atol": 1e-16, "max_step": 0.05}
        t, y = 0.0, np.array(start)
        while t < 8.0:
            run = solve_ivp(rates, (t, 8.0), y, events=passage, **how)
            t, y = run.t[-1], run.y[:, -1]
            if t < 8.0:
                run = solve_ivp(rates, (t, min(8.0, t + 1e-9)), y, **how)
                t, y = run.t[-1], run.y[:, -1]
        yield Claim("outcome", names["outcome"], "completed")
        # The interpolation of SciPy locates the contact to about 1e-9 if the force begins with a
        # root.
        yield Claim("state at contact", names["state"], y, names["error"] + 1e-8)

    return Case(call, judge)


def _layer(rng, index):
    """A thin layer somewhere in the motion; the steps of SciPy are short within it."""
    texts = ("tanh({z})", "exp(-({z})^2)/{e}/5", "1/(1 + ({z})^2)/{e}/10", "atan({z})")
    forces = (
        np.tanh, lambda z: np.exp(-min(z * z, 700.0)) / e / 5, lambda z: 1 / (1 + z * z) / e / 10,
        np.arctan,
    )  # fmt: skip
    e, place = few(rng, 1e-3, 1e-2, 2), even(rng, -0.3, 0.5, 3)
    text, force = texts[index % 4], forces[index % 4]
    a = even(rng, 0.1, 0.4, 3) * (-1) ** (index // 4)
    c, load, nu = even(rng, 0.02, 0.2, 3), even(rng, 0.1, 1, 3), few(rng, 0.3, 2, 4)
    start = [even(rng, -1, 1, 3), even(rng, -1, 1, 3)]
    kind, weight, rate = index // 8 % 3, few(rng, 0.05, 0.5, 2), few(rng, 0.5, 2, 2)
    law = text.format(z=f"({'d' if kind else 'x'} - {place})/{e}", e=e)
    # A spring of stiffness 1/2 with memory, or none.
    own = 0.5 if kind == 2 else 0.0
    spring = f"vv.Spring(on='x1', law='{a}*{law}')"
    if own:
        kernel = f"vv.PronyKernel(weights=[{weight}], rates=[{rate}])"
        spring += f", vv.Spring(on='x1', stiffness={own}, kernel={kernel})"
    one = "mass=np.eye(1), stiffness=np.eye(1)"
    system = (
        f"vv.Structure({one}, damping={c}*np.eye(1), elements=[{spring}])"
        if kind
        else f"vv.PolynomialSystem(mass=1, stiffness=1, damping={c}, forces='{a}*{law}')"
    )
    call = f"""system = {system}
m = vv.simulate(system, 4.0, load={load if not kind else [load]}, nu={nu}, initial={start})
state, outcome, error = m.state[-1], str(m.outcome), m.error
"""

    def judge(names, reported):
        def rates(t, y):
            full = y[0] + own * (y[0] - y[2]) + a * force((y[0] - place) / e)
            return [y[1], load * np.sin(nu * t) - c * y[1] - full, weight * y[0] - rate * y[2]]

        run = solve_ivp(
            rates, (0, 4), [*start, 0.0], "DOP853", rtol=1e-12, atol=1e-14, max_step=e / 4
        )
        yield Claim("outcome", names["outcome"], "completed")
        yield Claim("state beyond layers", names["state"], run.y[:2, -1], names["error"] + 2e-9)

    return Case(call, judge)


def _element(rng, index):
    _, _, c, k, load, nu = _draw(rng)
    a, b = even(rng, 0.1, 1, 3), even(rng, 0.5, 2, 3)
    call = f"""chain = np.array([[2.0, -1, 0], [-1, 2, -1], [0, -1, 1]]) * {k}
spring = vv.Spring(on=("x1", "x3"), law="a*tanh(d/b) + d^3 + a*tanh(v/b)", parameters={{"a": {a}, "b": {b}}})
s = vv.Structure(mass=np.eye(3), stiffness=chain, damping={c} * np.eye(3), elements=[spring])
r = vv.forced_response(s, [{nu}], load=[{load}, 0, 0], method="newton")
x, orders, ok, degree = r.coefficients[0], r.harmonics, r.converged[0], spring.degree
"""

    def judge(names, reported):
        yield Claim("degree", names["degree"], 0)
        if not names["ok"]:
            return
        x, orders = names["x"], names["orders"]
        theta = 2 * np.pi * np.arange(2048) / 2048
        waves = np.exp(1j * np.outer(orders, theta))
        chain = np.array([[2.0, -1, 0], [-1, 2, -1], [0, -1, 1]]) * k
        d = ((x[0] - x[2]) @ waves).imag
        v = ((1j * orders * nu * (x[0] - x[2])) @ waves).imag
        f = 2j / 2048 * ((a * np.tanh(d / b) + d**3 + a * np.tanh(v / b)) @ waves.conj().T)
        f[orders == 0] /= 2
        for j, order in enumerate(orders):
            left = (chain + (1j * order * nu * c - (order * nu) ** 2) * np.eye(3)) @ x[:, j]
            left = left + f[j] * np.array([1, 0, -1]) - load * (order == 1) * np.eye(3)[0]
            yield Claim("equations kept", 1 + np.abs(left).max() / load, 1.0, 1e-8)

    return Case(call, judge)


def _multipliers(rng, index):
    source, force, c, k, load, nu = _draw(rng)
    call = f"""r = vv.forced_response({source}, [{nu}], load={load}, method="newton", stability=True)
x, orders, ok, truncation = r.coefficients[0, 0], r.harmonics, r.converged[0], r.truncation[0]
multipliers, stable = r.multipliers[0], r.stable[0]
"""

    def judge(names, reported):
        if not names["ok"] or not names["truncation"] < 1e-7:
            return
        x, orders = names["x"], names["orders"]

        def tangent(t, y):
            waves = np.exp(1j * orders * nu * t)
            at, rate = (x @ waves).imag, (1j * orders * nu * x @ waves).imag
            h = 1e-5
            # Derivatives of the law with respect to each argument by Richardson differences.
            by = [
                (8 * (force(at + h * p, rate + h * q) - force(at - h * p, rate - h * q))
                 - force(at + 2 * h * p, rate + 2 * h * q)
                 + force(at - 2 * h * p, rate - 2 * h * q)) / (12 * h)
                for p, q in ((1, 0), (0, 1))
            ]  # fmt: skip
            y = y.reshape(2, 2)
            return np.array([y[1], -(k + by[0]) * y[0] - (c + by[1]) * y[1]]).ravel()

        period = 2 * np.pi / nu
        matrix = solve_ivp(
            tangent, (0, period), np.eye(2).ravel(), "DOP853", rtol=1e-9, atol=1e-11,
            max_step=period / 50,
        ).y[:, -1].reshape(2, 2)  # fmt: skip
        expected = np.linalg.eigvals(matrix)
        known = names["multipliers"]
        size = max(1.0, np.abs(expected).max())
        # Nearly equal multipliers change like the square root of an error.
        gap = max(abs(expected[0] - expected[1]), 1e-4)
        limit = 1e-6 * size * max(1.0, size / gap)
        worst = min(np.abs(known - expected).max(), np.abs(known[::-1] - expected).max())
        yield Claim("multipliers", 1 + worst / limit, 1.0, 1.0, damage=2.0)
        if np.abs(np.abs(expected) - 1).min() > 1e-4:
            yield Claim("stable", bool(names["stable"]), bool((np.abs(expected) < 1).all()))

    return Case(call, judge)


def _slider(rng, index):
    k, limit = few(rng, 1, 30), few(rng, 0.05, 0.5)
    c, load, nu = even(rng, 0.02, 0.2, 3), few(rng, 0.1, 2), few(rng, 0.3, 3, 4)
    call = f"""slider = vv.Jenkins(on="x1", stiffness={k}, limit={limit})
s = vv.Structure(mass=[[1.0]], stiffness=[[1.0]], damping=[[{c}]], elements=[slider])
r = vv.forced_response(s, [{nu}], load=[{load}], method="newton", harmonics=31)
x, orders, ok, truncation = r.coefficients[0, 0], r.harmonics, r.converged[0], r.truncation[0]
d = (x @ np.exp(2j * np.pi * np.outer(orders, np.arange(512)) / 512)).imag
loop, lost = slider.loop(d), float(slider.energy(d))
"""

    def judge(names, reported):
        if not names["ok"]:
            return
        x, orders, d = names["x"], names["orders"], names["d"]
        # Plasticity with a yield stress, by its return map; the work around the loop.
        slip, force = 0.0, np.empty(3 * d.size)
        for i, now in enumerate(np.tile(d, 3)):
            trial = k * (now - slip)
            if abs(trial) > limit:
                slip += (abs(trial) - limit) / k * np.sign(trial)
            force[i] = k * (now - slip)
        own = force[-d.size :]
        yield Claim("loop", names["loop"], own, 1e-9)
        middle = 0.5 * (own + np.roll(own, 1))
        work = float(middle @ (d - np.roll(d, 1)))
        size = max(limit * np.ptp(d), 1e-300)
        yield Claim("work", 1 + abs(names["lost"] - work) / size, 1.0, 3e-3, damage=0.1)
        fed = -np.pi * load * x[orders == 1][0].imag
        damped = np.pi * c * nu * float((orders**2 * np.abs(x) ** 2).sum())
        size = np.pi * load * np.abs(x).sum()
        allowed = 2e-3 + 10 * max(names["truncation"], 0.0)
        yield Claim("energy", 1 + abs(fed - damped - work) / size / allowed, 1.0, 1.0, damage=2.0)

    return Case(call, judge)


def _friction(rng, index):
    """Dry friction without sticking: the motion is linear between turning points, which give equations."""
    size, nu = few(rng, 0.02, 0.3), few(rng, 0.4, 2.5, 4)
    if abs(nu - 1) < 0.05:
        nu += 0.1
    call = f"""s = vv.PolynomialSystem(mass=1, stiffness=1, forces="{size}*sign(x_dot)")
r = [vv.forced_response(s, [{nu}], load=1, method="newton", harmonics=k) for k in (25, 49, 99)]
best = r[2].extrapolated(r[1], r[0])
fall, power, reported = r[2].fall_off()[0], best.power[0], (r[2].truncation[0], best.truncation[0])
heights = [one.peak_to_peak("x")[0] / 2 for one in (r[2], best)]
"""

    def judge(names, reported):
        exact = _without_stops(nu, size)
        if exact is None:
            return
        for what, height, reported in zip(
            ("amplitude", "extrapolated"), names["heights"], names["reported"], strict=True
        ):
            yield Claim(what, height, exact, 2 * reported * exact, damage=10.0)
        yield Claim("fall", names["fall"], 3.0, 0.5, damage=1.0)
        if np.isfinite(names["power"]):
            yield Claim("power", names["power"], 1.0, 0.1, damage=1.0)

    return Case(call, judge)


def _without_stops(nu, size):
    """X of x'' + x + size sign x' = sin(nu t + a), or None if the motion sticks."""
    # From X at t = 0 down to -X: x = size + A cos t + B sin t + (p cos nu t + q sin nu t)/(1 - nu^2).
    half, g = np.pi / nu, 1 / (1 - nu**2)
    c, s = np.cos(half), np.sin(half)
    rows = np.array([
        [1, 0, g, 0], [0, 1, 0, nu * g], [c, s, -g, 0], [-s, c, 0, -nu * g],
    ])  # fmt: skip
    try:
        by_height = np.linalg.solve(rows, [1, 0, -1, 0])
        alone = np.linalg.solve(rows, [-size, 0, -size, 0])
    except np.linalg.LinAlgError:
        return None
    p, q = by_height[2:], alone[2:]
    heights = np.roots([p @ p, 2 * p @ q, q @ q - 1])
    t = np.linspace(0, half, 2001)
    for height in sorted(heights.real[np.abs(heights.imag) < 1e-12], reverse=True):
        a, b, pp, qq = height * by_height + alone
        rate = -a * np.sin(t) + b * np.cos(t) + nu * g * (qq * np.cos(nu * t) - pp * np.sin(nu * t))
        if height > 0 and (rate[1:-1] < 0).all() and rate[1:-1].max() < 0:
            return float(height)
    return None


def case(rng, index):
    """Draw a law and a question: steady motion, stability, motion in time, or a structure."""
    kinds = (_steady, _motion, _element, _multipliers, _slider, _friction, _contact, _layer,
             _called)  # fmt: skip
    return kinds[index % len(kinds)](rng, index // len(kinds))
