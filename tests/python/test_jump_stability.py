"""Stability of motions with laws that jump, against a map by SciPy that stops at each jump."""

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

pytestmark = pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
#: Jump variable, mass, stiffness, damping, cubic, jump, load, frequency.
CASES = {
    "friction": ("rate", [1.0], [[1.0]], 0.05, 0.3, 0.1, 0.5, 0.9),
    "friction of two": ("rate", [1.2, 0.8], [[1.4, -0.5], [-0.5, 1.1]], 0.04, 0.0, 0.15, 0.8, 1.3),
    "stop": ("place", [1.0], [[1.0]], 0.05, 0.0, 0.05, 0.5, 0.6),
    "two with a stop": ("place", [0.9, 1.5], [[1.6, -0.4], [-0.4, 0.9]], 0.05, 0.5, 0.1, 0.6, 1.1),
    # Unstable equilibrium in the middle: a motion about it.
    "unstable": ("place", [1.0], [[1.0]], 0.02, 0.8, -0.2, 0.9, 1.6),
}


def make(case):
    kind, mass, stiffness, damping, cubic, jump, *_ = case
    n = len(mass)
    names = tuple(f"q{i + 1}" for i in range(n))
    law = f"{jump}*sign({'q1_dot' if kind == 'rate' else 'q1'}) + {cubic}*q1^3"
    return vv.PolynomialSystem(
        mass=np.diag(mass), stiffness=stiffness, damping=damping * np.array(stiffness),
        forces=[law] + ["0*q1"] * (n - 1), names=names,
    )  # fmt: skip


def over_a_period(case, state):
    """The state after a period; steps end at the jumps."""
    kind, mass, stiffness, damping, cubic, jump, load, nu = case
    n, k = len(mass), np.array(stiffness)
    place = n if kind == "rate" else 0
    t, s, end = 0.4, state.copy(), 0.4 + 2 * np.pi / nu
    side = np.sign(s[place])

    def rates(t, s, side):
        force = -k @ s[:n] - damping * k @ s[n:]
        force[0] += load * np.sin(nu * t) - cubic * s[0] ** 3 - jump * side
        return np.concatenate([s[n:], force / np.array(mass)])

    while t < end - 1e-13:

        def passes(t, s, side):
            return s[place]

        passes.terminal, passes.direction = True, -side
        run = solve_ivp(
            rates, (t, end), s, "DOP853", events=passes, args=(side,), rtol=1e-10, atol=1e-12
        )
        t, s = run.t[-1], run.y[:, -1].copy()
        if run.status == 1:
            side = -side
            s[place] = side * 1e-300
    return s


@pytest.mark.parametrize("name", CASES)
def test_multipliers_have_what_a_jump_does_to_neighbours(name):
    case = CASES[name]
    nu, n = case[-1], len(case[1])
    r = vv.forced_response(
        make(case), [nu], load=[case[-2]] + [0.0] * (n - 1), method="newton", stability=True
    )
    assert r.converged[0]
    wave = r.coefficients[0] * np.exp(1j * r.harmonics * nu * 0.4)
    state = np.concatenate([wave.imag.sum(axis=1), (1j * r.harmonics * nu * wave).imag.sum(axis=1)])
    h = 1e-6
    changes = [
        (over_a_period(case, state + d) - over_a_period(case, state - d)) / (2 * h)
        for d in h * np.eye(2 * n)
    ]
    true = np.linalg.eigvals(np.array(changes).T)
    got = r.multipliers[0]
    apart = [np.abs(true - mu).min() for mu in got]
    assert max(apart) < 2e-3 * max(1.0, np.abs(true).max()) ** 2
    assert r.stable[0] == (np.abs(true).max() < 1)


def test_memory_under_a_jump_is_unknown():
    kernel = vv.PronyKernel(weights=[0.1], rates=[0.5])
    system = vv.PolynomialSystem(
        mass=1, stiffness=1, damping=0.05, forces="0.1*sign(x_dot)", names=("x",), kernel=kernel
    )
    with pytest.warns(vv.StabilityWarning, match="a force law jumps"):
        r = vv.forced_response(system, [0.6], load=0.5, method="newton", stability=True)
    assert r.converged[0]
    assert r.stable[0] is None
