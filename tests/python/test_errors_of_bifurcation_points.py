"""Stated errors of bifurcation points and branch points."""

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

pytestmark = pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")


def _disturbances(system, nu, load, start):
    """Perturbations of a periodic motion after a period, by integration in time."""
    damping, force = float(system.damping[0, 0]), system.forces
    a, b = force

    def right(t, y):
        x, v = y[:2]
        slope = 1 + 2 * a * x + 3 * b * x * x
        rate = load * np.sin(2 * nu * t) - damping * v - x - a * x * x - b * x**3
        by = y[2:].reshape(2, 2)
        return [v, rate, *(np.array([[0, 1], [-slope, -damping]]) @ by).ravel()]

    state = np.array(start)
    for _ in range(20):
        last = solve_ivp(
            right, (0, 2 * np.pi / nu), [*state, 1, 0, 0, 1], "DOP853", rtol=1e-12, atol=1e-13
        ).y[:, -1]
        by = last[2:].reshape(2, 2)
        step = np.linalg.solve(by - np.eye(2), state - last[:2])
        state = state + step
        if np.abs(step).max() < 1e-11:
            break
    return by


class _Drawn:
    """x'' + c x' + x + a x^2 + b x^3 under a load of harmonic 2."""

    def __init__(self, c, a, b):
        self.damping, self.forces = np.array([[c]]), (a, b)
        self.system = vv.PolynomialSystem(
            mass=1, stiffness=1, damping=c, forces=f"{a}*x^2 + {b}*x^3"
        )


@pytest.mark.parametrize("seed", range(4))
def test_branch_points_are_those_of_motions_in_time(seed):
    """A multiplier is 1 at the branch point: SciPy locates it to 1e-9."""
    rng = np.random.default_rng(seed)
    drawn = _Drawn(0.03, round(rng.uniform(0.5, 0.9), 3), round(rng.uniform(0.5, 0.9), 3))
    load = round(rng.uniform(0.15, 0.25), 3)
    branch = vv.trace_response(
        drawn.system, (0.6, 1.4), load={2: load}, symmetric=False, harmonics=9 + 2 * seed
    )
    crossings = [c for c in branch.crossings if c.kind == "branch point"]
    assert crossings
    for one in crossings[:2]:
        waves = one.coefficients[0]
        start = [waves.imag.sum(), (branch.harmonics * one.parameter * waves.real).sum()]

        def passed(nu, start=start):
            by = _disturbances(drawn, nu, load, start)
            return float(np.linalg.det(by - np.eye(2)))

        reach = max(1e-6, 3 * one.error)
        # The motion continues through the point, a simple zero of the determinant.
        lower, upper = passed(one.parameter - reach), passed(one.parameter + reach)
        assert lower * upper < 0
        true = one.parameter + reach * (lower + upper) / (lower - upper)
        assert abs(true - one.parameter) <= 1.3 * one.error + 2e-9
