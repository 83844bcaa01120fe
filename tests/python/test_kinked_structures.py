"""Multipliers of structures with contacts, against products of matrix exponentials."""

import itertools

import numpy as np
import pytest
import viscovib as vv
from scipy.linalg import expm
from scipy.optimize import brentq


def _chain(rng, n, coupled):
    """A chain with a stop at its end, and its matrices."""
    mass = rng.uniform(0.8, 1.2, n)
    stiffness = n * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    damping = np.diag(rng.uniform(0.05, 0.4, n)) if coupled else np.diag(0.1 * mass)
    gap, k = round(rng.uniform(0.01, 0.1), 3), round(rng.uniform(1, 5) * n, 3)
    structure = vv.Structure(
        mass=mass,
        stiffness=stiffness,
        damping=damping,
        elements=[vv.Gap(on=f"x{n}", stiffness=k, gap=gap)],
    )
    return structure, mass, stiffness, damping, k, gap


def _multipliers(response, mass, stiffness, damping, k, gap, weight=0.0, rate=1.0):
    """All multipliers of the first motion, largest first, and the number of contacts.

    The first spring may have memory: its force is less by weight m, m' = x_1 - rate m.
    """
    n, nu, last = mass.size, response.nu[0], response.coefficients[0, -1]

    def over(theta):
        waves = np.exp(1j * np.multiply.outer(theta, response.harmonics))
        return (waves @ last).imag - gap

    theta = np.linspace(0, 2 * np.pi, 4001)
    sign = over(theta) > 0
    ends = [brentq(over, theta[i], theta[i + 1], xtol=1e-15)
            for i in np.flatnonzero(sign[1:] != sign[:-1])]  # fmt: skip
    ends = [0.0, *ends, 2 * np.pi]
    whole = np.eye(2 * n + 1)
    for a, b in itertools.pairwise(ends):
        now = stiffness.astype(float).copy()
        now[-1, -1] += k if over((a + b) / 2) > 0 else 0
        rates = np.zeros((2 * n + 1, 2 * n + 1))
        rates[:n, n:-1] = np.eye(n)
        rates[n:-1, :n] = -now / mass[:, None]
        rates[n:-1, n:-1] = -damping / mass[:, None]
        rates[n, -1] = weight / mass[0]
        rates[-1, [0, -1]] = 1.0, -rate
        whole = expm(rates * (b - a) / nu) @ whole
    if not weight:
        whole = whole[:-1, :-1]
    values = np.linalg.eigvals(whole)
    return values[np.argsort(-np.abs(values))], len(ends) - 2


def _nearest(reported, values):
    """The largest distance of a reported multiplier from its nearest reference."""
    reported = reported[np.isfinite(reported)]
    assert reported.size > 0
    return max(np.abs(values - one).min() for one in reported)


def _motion(rng, structure, stiffness, n):
    load = np.zeros(n)
    load[-1] = rng.uniform(0.5, 3) * (10 if n > 20 else 1)
    nu = np.sqrt(np.linalg.eigvalsh(stiffness)[0]) * rng.uniform(0.4, 1.5)
    return vv.forced_response(
        structure, [nu], load=load, method="newton", harmonics=40, stability=True,
        **({"coordinates": structure.names} if isinstance(structure, vv.Structure) else {}),
    )  # fmt: skip


@pytest.mark.parametrize("n", [1, 3, 26])
@pytest.mark.parametrize("coupled", [True, False])
@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
def test_multipliers_of_structures_with_a_stop(n, coupled):
    rng = np.random.default_rng([n, coupled])
    touching = 0
    for _ in range(4 if n < 20 else 3):
        structure, *rest = _chain(rng, n, coupled)
        response = _motion(rng, structure, rest[1], n)
        if not response.converged[0]:
            continue
        values, touches = _multipliers(response, *rest)
        touching += touches > 0
        largest = abs(values[0])
        assert _nearest(response.multipliers[0], values) < 1e-9 * max(1, largest)
        if abs(largest - 1) > 1e-3:
            assert response.stable[0] in (None, largest < 1)
    assert touching >= 2


@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
def test_multipliers_of_a_stop_with_memory(n):
    rng = np.random.default_rng([n, 7])
    touching = 0
    for _ in range(8):
        _, mass, stiffness, damping, k, gap = _chain(rng, n, True)
        weight, rate = rng.uniform(0.05, 0.5), rng.uniform(0.3, 3)
        own = np.zeros((n, n))
        own[0, 0] = 1.0
        last = "x" if n == 1 else f"x{n}"
        law = f"{k}*max({last} - {gap}, 0)"
        kernel = vv.PronyKernel(weights=[weight], rates=[rate])
        system = vv.PolynomialSystem(
            mass=mass, stiffness=stiffness - own, damping=damping,
            forces=law if n == 1 else {last: law},
            springs=[vv.Springs(stiffness=own, kernel=kernel)],
        )  # fmt: skip
        response = _motion(rng, system, stiffness, n)
        if not response.converged[0] or response.stable[0] is None:
            continue
        values, touches = _multipliers(response, mass, stiffness, damping, k, gap, weight, rate)
        touching += touches > 0
        assert _nearest(response.multipliers[0], values) < 2e-5 * max(1, abs(values[0]))
        if abs(abs(values[0]) - 1) > 1e-3:
            assert response.stable[0] == (abs(values[0]) < 1)
    assert touching >= 2
