"""Pasts with corners, jumps and thin layers of a law with memory: quadrature on each side."""

import itertools

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

WEIGHTS, RATES = np.array([0.2, 0.5]), np.array([0.5, 3.0])
LAWS = {
    "5*max(d - 0.1, 0)": lambda d: 5 * np.maximum(d - 0.1, 0),
    "2*abs(d - 0.1)*d": lambda d: 2 * np.abs(d - 0.1) * d,
    "20*max(d - 0.1, 0)^1.5": lambda d: 20 * np.maximum(d - 0.1, 0) ** 1.5,
    "where(d > 0.1, 1 + d, -d)": lambda d: np.where(d > 0.1, 1 + d, -d),
    "0.5*tanh((d - 0.1)/1e-3)": lambda d: 0.5 * np.tanh((d - 0.1) / 1e-3),
    "3*d^15": lambda d: 3 * d**15,
}


def remembered(times, d, force):
    """Integral of the force times w exp(-r (t - s)) over the past, by graded Gauss quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    total = WEIGHTS / RATES * force(d[0])
    for (begin, end), (first, last) in zip(
        itertools.pairwise(times), itertools.pairwise(d), strict=True
    ):
        place = begin + (0.1 - first) / (last - first) * (end - begin)
        near = place + (end - begin) * np.r_[-(0.5 ** np.arange(40)), 0, 0.5 ** np.arange(40)]
        cuts = np.unique(np.r_[begin, near[(near > begin) & (near < end)], end])
        for a, b in itertools.pairwise(cuts):
            t = (a + b) / 2 + (b - a) / 2 * nodes
            f = (b - a) / 2 * weights * force(first + (last - first) * (t - begin) / (end - begin))
            fading = np.exp(-np.multiply.outer(RATES, b - t))
            total = total * np.exp(-RATES * (b - a)) + WEIGHTS * (fading @ f)
    return total


@pytest.mark.parametrize("memory", ["exponentials", "direct"])
@pytest.mark.parametrize("law", LAWS)
def test_pasts_across_corners(law, memory):
    rng = np.random.default_rng(7)
    force = LAWS[law]
    kernel = vv.PronyKernel(weights=WEIGHTS, rates=RATES)
    spring = vv.Spring(on="x1", law=law, kernel=kernel)
    system = vv.Structure(mass=[1.0], stiffness=[1.0], elements=[spring])
    for _ in range(2):
        times = np.sort(np.append(-rng.uniform(0.1, 5, 4), 0.0))
        d = rng.uniform(-1, 1, 5)

        def slope(t, y):
            pull = force(y[0])
            return np.r_[y[1], y[2:].sum() - y[0] - pull, WEIGHTS * pull - RATES * y[2:]]

        start = np.r_[0.5, 0.0, remembered(times, d, force)]
        right = solve_ivp(slope, (0, 0.3), start, method="DOP853", rtol=1e-12, atol=1e-14).y[:2, -1]
        run = vv.simulate(
            system, 0.3, initial=[0.5, 0.0], memory=memory,
            held=vv.Past(times=times, displacements=d[:, np.newaxis]),
        )  # fmt: skip
        assert np.abs(run.state[-1] - right).max() < 3e-12 + 3 * run.error
