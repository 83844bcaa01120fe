"""Stability of motions with too few harmonics: unknown if the truncation may decide it."""

import numpy as np
import pytest
import viscovib as vv

pytestmark = pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")


def _chain(rng):
    n = int(rng.integers(1, 4))
    mass, k = rng.uniform(0.5, 2, n), rng.uniform(0.5, 2, n + 1)
    stiffness = np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
    cubic, square = rng.uniform(0.2, 2), rng.uniform(-0.5, 0.5)
    system = vv.PolynomialSystem(
        mass=np.diag(mass), stiffness=stiffness, damping=rng.uniform(0.01, 0.05) * stiffness,
        names=[f"x{i + 1}" for i in range(n)], forces={"x1": f"{cubic}*x1^3 + {square}*x1^2"},
    )  # fmt: skip
    lowest = np.sqrt(np.linalg.eigvalsh(stiffness / np.sqrt(np.outer(mass, mass)))[0])
    load = np.zeros(n)
    load[rng.integers(n)] = 10 ** rng.uniform(-0.5, 0.5)
    return system, rng.uniform(0.3, 2) * lowest, load


def _motion(system, nu, load, orders):
    return vv.forced_response(
        system, [nu], load=load, method="newton", harmonics=orders, stability=True, tolerance=1e-9
    )


def test_verdicts_of_few_harmonics_are_those_of_many():
    """Random chains: without perturbed harmonics five of them would be wrong."""
    rng = np.random.default_rng(41)
    judged = unknown = unstable = caught = 0
    for _ in range(160):
        system, nu, load = _chain(rng)
        few = _motion(system, nu, load, int(rng.choice([1, 2, 3, 5])))
        if not few.converged[0] or few.truncation[0] < 1e-9:
            continue
        many = _motion(system, nu, load, 31)
        kept = many.coefficients[0][:, np.searchsorted(many.harmonics, few.harmonics)]
        size = np.abs(kept).max()
        if not many.converged[0] or many.stable[0] is None:
            continue
        if np.abs(few.coefficients[0] - kept).max() > 10 * few.truncation[0] * size:
            continue  # A different motion.
        if few.stable[0] is None:
            unknown += 1
            caught += (abs(few.multipliers[0, 0]) < 1) != many.stable[0]
            continue
        assert few.stable[0] == many.stable[0]
        judged += 1
        unstable += not many.stable[0]
    assert judged > 90
    assert unstable > 3
    assert caught > 2
    assert 0 < unknown < 0.35 * (judged + unknown)


def test_a_multiplier_that_jumps_from_one_side_of_the_circle_to_the_other():
    """On the upper branch perturbed motions have 1.8 and -2.3; the exact motion is stable.

    Event-accurate shooting finds it stable from its period doubling at .73875 down to its
    Neimark-Sacker point at .61861. Regression: ten points reported as unstable.
    """
    stiffness = np.array([[1.0, -1], [-1, 2]])
    system = vv.PolynomialSystem(
        mass=[1, 1], stiffness=stiffness, damping=0.03 * stiffness,
        forces={"x1": "100*max(x1 - 1, 0)"},
    )  # fmt: skip
    branch = vv.trace_response(system, (0.8, 0.6), load=[0, 0.1], harmonics=21)
    upper = np.arange(branch.nu.size) > branch.nu[60:].argmax() + 60
    there = upper & (branch.nu < 0.7387) & (branch.nu > 0.6187)
    assert there.sum() > 10
    assert not any(one is False for one in branch.stable[there])
    # If all perturbed motions are unstable, the verdict is unstable.
    lower = ~upper & (np.arange(branch.nu.size) > 32) & (branch.nu < 0.656)
    assert all(one is False for one in branch.stable[lower])
