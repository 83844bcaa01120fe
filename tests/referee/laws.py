"""Force laws with functions: by NumPy's functions, SciPy's steps and the waveform's equation."""

import numpy as np
from scipy.integrate import solve_ivp

from referee.case import Case, Claim, even, few, number

JUDGES = ("Spring", "Spring.degree")

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


def _draw(rng):
    text = list(LAWS)[int(rng.integers(len(LAWS)))]
    a, b = even(rng, 0.1, 1, 3), even(rng, 0.5, 2, 3)
    if text.startswith("A*(exp"):
        a = -a
    law = text.replace("A", f"({a})").replace("B", f"({b})")
    c, k, load = even(rng, 0.05, 0.3, 3), even(rng, 0.5, 2, 3), even(rng, 0.05, 0.5, 3)
    nu = few(rng, 0.3, 3, 4)
    source = (
        f"vv.PolynomialSystem(mass=1, stiffness={number(k)}, damping={number(c)}, forces={law!r})"
    )
    return source, lambda x: LAWS[text](x, a, b), c, k, load, nu


def _steady(rng, index):
    source, force, c, k, load, nu = _draw(rng)
    call = f"""r = vv.forced_response({source}, [{nu}], load={load}, method="newton")
x, orders, truncation, ok = r.coefficients[0, 0], r.harmonics, r.truncation[0], r.converged[0]
"""

    def judge(names, told):
        if not names["ok"]:
            return
        x, orders = names["x"], names["orders"]
        theta = 2 * np.pi * np.arange(2048) / 2048
        waves = np.exp(1j * np.outer(orders, theta))
        u = (x @ waves).imag
        left = (((-((orders * nu) ** 2) + 1j * orders * nu * c + k) * x) @ waves).imag
        left = left + force(u) - load * np.sin(theta)
        # The equation's residual, answered by the linear system alone.
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

    def judge(names, told):
        run = solve_ivp(
            lambda t, y: [y[1], load * np.sin(nu * t) - c * y[1] - k * y[0] - force(y[0])],
            (0, 8), start, "DOP853", rtol=1e-12, atol=1e-13, max_step=0.1,
        )  # fmt: skip
        yield Claim("outcome", names["outcome"], "completed")
        yield Claim("state", names["state"], run.y[:, -1], 1e-8)

    return Case(call, judge)


def _element(rng, index):
    _, _, c, k, load, nu = _draw(rng)
    a, b = even(rng, 0.1, 1, 3), even(rng, 0.5, 2, 3)
    call = f"""chain = np.array([[2.0, -1, 0], [-1, 2, -1], [0, -1, 1]]) * {k}
spring = vv.Spring(on=("x1", "x3"), law="a*tanh(d/b) + d^3", parameters={{"a": {a}, "b": {b}}})
s = vv.Structure(mass=np.eye(3), stiffness=chain, damping={c} * np.eye(3), elements=[spring])
r = vv.forced_response(s, [{nu}], load=[{load}, 0, 0], method="newton")
x, orders, ok, degree = r.coefficients[0], r.harmonics, r.converged[0], spring.degree
"""

    def judge(names, told):
        yield Claim("degree", names["degree"], 0)
        if not names["ok"]:
            return
        x, orders = names["x"], names["orders"]
        theta = 2 * np.pi * np.arange(2048) / 2048
        waves = np.exp(1j * np.outer(orders, theta))
        chain = np.array([[2.0, -1, 0], [-1, 2, -1], [0, -1, 1]]) * k
        d = ((x[0] - x[2]) @ waves).imag
        f = 2j / 2048 * ((a * np.tanh(d / b) + d**3) @ waves.conj().T)
        f[orders == 0] /= 2
        for j, order in enumerate(orders):
            left = (chain + (1j * order * nu * c - (order * nu) ** 2) * np.eye(3)) @ x[:, j]
            left = left + f[j] * np.array([1, 0, -1]) - load * (order == 1) * np.eye(3)[0]
            yield Claim("equations kept", 1 + np.abs(left).max() / load, 1.0, 1e-8)

    return Case(call, judge)


def case(rng, index):
    """Draw a law, and ask for its steady motion, its motion in time, or that of a structure."""
    return (_steady, _motion, _element)[index % 3](rng, index // 3)
