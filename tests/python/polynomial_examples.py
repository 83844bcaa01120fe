"""Polynomial systems and periodic solutions for several tests."""

import numpy as np
import viscovib as vv
from referee.integration import solve_ivp
from scipy.optimize import root

KERNEL = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)


def chain(n, cubic=0.2, damping=0.05, **changes):
    """Equal masses between walls; each spring has a cubic part in its own elongation."""
    stiffness = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    names = ["0", *(f"x{i + 1}" for i in range(n)), "0"]
    forces = {
        names[
            i
        ]: f"{cubic}*({names[i]} - {names[i - 1]})^3 + {cubic}*({names[i]} - {names[i + 1]})^3"
        for i in range(1, n + 1)
    }
    given = {"mass": np.ones(n), "stiffness": stiffness, "damping": damping * stiffness}
    given["names"] = names[1:-1]
    return vv.PolynomialSystem(**(given | {"forces": forces} | changes))


def periodic(right, start, period):
    """Shooting: the initial state of a periodic solution, with SciPy only."""

    def after(y):
        return solve_ivp(right, (0, period), y, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]

    found = root(lambda y: after(y) - y, start, tol=1e-13)
    assert np.abs(found.fun).max() < 1e-11
    return found.x


def state_at_zero(r, i=0):
    x, k = r.coefficients[i], r.harmonics
    return np.concatenate([x.sum(axis=1).imag, (1j * k * r.nu[i] * x).sum(axis=1).imag])
