"""Stability for laws with kinks and memory: a Prony kernel as ordinary equations."""

import numpy as np
import pytest
import viscovib as vv
from scipy.linalg import expm

pytestmark = pytest.mark.filterwarnings(
    "ignore::viscovib.ConvergenceWarning", "ignore::viscovib.StabilityWarning"
)


def largest_multiplier(mass, stiffness, damping, slope, weight, rate, nu):
    """By small steps of M q'' + C q' + F - e = 0, e' = weight F - rate e, F = (K + slope) q."""
    n, period = len(mass), 2 * np.pi / nu
    product, known = np.eye(3 * n), {}
    for s in slope:
        if s not in known:
            k = stiffness.copy()
            k[0, 0] += s
            a = np.zeros((3 * n, 3 * n))
            a[:n, n : 2 * n] = np.eye(n)
            a[n : 2 * n] = np.hstack([-k, -damping, np.eye(n)]) / mass[:, None]
            a[2 * n :, :n], a[2 * n :, 2 * n :] = weight * k, -rate * np.eye(n)
            known[s] = expm(a * period / len(slope))
        product = known[s] @ product
    return np.abs(np.linalg.eigvals(product)).max()


def test_verdicts_are_right_or_unknown():
    rng = np.random.default_rng(4)
    judged = growing = 0
    for _ in range(30):
        n = int(rng.integers(1, 3))
        mass, stiffness = rng.uniform(0.5, 2, n), np.diag(rng.uniform(0.5, 2, n))
        if n == 2:
            stiffness = stiffness + rng.uniform(0.2, 1) * np.array([[1, -1], [-1, 1.0]])
        damping = 10 ** rng.uniform(-3, -2) * stiffness
        hard, gap = float(10 ** rng.uniform(0, 1.3)), float(rng.uniform(0, 0.3))
        kind = rng.choice(["both", "one", "abs"])
        law, slope_of = {
            "both": (
                f"{hard}*(max(x1 - {gap}, 0) + min(x1 + {gap}, 0))",
                lambda x, hard=hard, gap=gap: hard * (np.abs(x) > gap),
            ),
            "one": (f"{hard}*max(x1, 0)", lambda x, hard=hard: hard * (x > 0)),
            "abs": (f"{hard / 10}*abs(x1)", lambda x, hard=hard: hard / 10 * np.sign(x)),
        }[kind]
        weight, rate = float(10 ** rng.uniform(-2.5, -1)), float(10 ** rng.uniform(-1, 0.7))
        system = vv.PolynomialSystem(
            mass=np.diag(mass), stiffness=stiffness, damping=damping,
            forces=[law] + ["0*x1"] * (n - 1), names=tuple(f"x{i + 1}" for i in range(n)),
            kernel=vv.PronyKernel(weights=[weight], rates=[rate]),
        )  # fmt: skip
        nu = float(rng.uniform(0.5, 2.5) * np.sqrt(stiffness[0, 0] / mass[0]))
        load = [float(10 ** rng.uniform(-1, 0.5))] + [0.0] * (n - 1)
        r = vv.forced_response(
            system, [nu], load=load, method="newton", stability=True, harmonics=31
        )
        if not r.converged[0] or r.stable[0] is None:
            continue
        angle = 2 * np.pi * (np.arange(3000) + 0.5) / 3000
        x = (r.coefficients[0, 0] @ np.exp(1j * np.outer(r.harmonics, angle))).imag
        largest = largest_multiplier(mass, stiffness, damping, slope_of(x), weight, rate, nu)
        if abs(np.log(largest)) < 2e-3:
            continue
        assert r.stable[0] == (largest < 1), (law, nu, load)
        judged, growing = judged + 1, growing + (largest > 1)
    assert judged >= 12
    assert growing >= 1
