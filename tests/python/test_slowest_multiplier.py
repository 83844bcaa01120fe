"""The slowest multiplier for kernels with power-law relaxation, against their spectra."""

from math import cos, gamma, pi, sin

import numpy as np
import pytest
import viscovib as vv
from scipy.linalg import expm

pytestmark = pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
#: Steps per period, and step of the logarithm of the rates.
N, H = 240, 0.5


def spectrum(kernel):
    """Weights and rates from the branch cut: R(s) = int w(x)/(x + s) dx, x = exp(u)."""
    x = np.exp(np.arange(-150, 150, H))
    a, alpha = kernel.amplitude, kernel.alpha
    if isinstance(kernel, vv.AbelKernel):
        density = a * gamma(alpha) * sin(pi * alpha) / pi * x**-alpha
    else:
        p, b = x**alpha, kernel.beta
        density = a / pi * p * sin(pi * alpha) / (p**2 + 2 * b * p * cos(pi * alpha) + b**2)
    return density * x * H, x


def multipliers(kernel, damping, cubic, nu, orders, waves):
    """Multipliers of x'' + c x' + F = sum e_k, e_k' = w_k F - r_k e_k, F = (1 + 3 cubic x^2) dx.

    By a Magnus expansion of order four.
    """
    weights, rates = spectrum(kernel)
    step = 2 * np.pi / nu / N
    # Relaxation within a step changes the stiffness; very slow relaxation is one state with rate 0.
    fast, slow = rates * step > 2000, rates * step < 1e-11
    at_once = (weights[fast] / rates[fast]).sum()
    kept = ~(fast | slow)
    w = np.append(weights[slow].sum(), weights[kept])
    r = np.append(0.0, rates[kept])

    def matrix(t):
        x = (waves @ np.exp(1j * orders * nu * t)).imag
        stiffness = 1 + 3 * cubic * x**2
        m = np.zeros((r.size + 2, r.size + 2))
        m[0, 1], m[1, 1], m[1, 2:] = 1, -damping, 1
        m[1, 0], m[2:, 0] = -stiffness * (1 - at_once), w * stiffness
        m[2:, 2:] = -np.diag(r)
        return m

    product = np.eye(r.size + 2)
    for i in range(N):
        a, b = (matrix((i + 0.5 + s * np.sqrt(3) / 6) * step) for s in (-1, 1))
        omega = step / 2 * (a + b) + np.sqrt(3) / 12 * step**2 * (b @ a - a @ b)
        product = expm(omega) @ product
    return np.linalg.eigvals(product)


@pytest.mark.parametrize(
    "kernel",
    [
        vv.AbelKernel(amplitude=0.02, alpha=0.6),
        vv.AbelKernel(amplitude=0.01, alpha=0.3),
        vv.RabotnovKernel(amplitude=0.3, alpha=0.4, beta=0.2),
    ],
    ids=repr,
)
def test_the_slowest_multiplier_is_the_largest_of_all(kernel):
    damping, cubic = 5e-4, 0.8
    system = vv.PolynomialSystem(
        mass=1, stiffness=1, damping=damping, forces=f"{cubic}*x^3", names=("x",), kernel=kernel
    )
    branch = vv.trace_response(system, (0.5, 1.8), load=0.3, max_points=200)
    reported = np.flatnonzero(branch.slowest & (branch.truncation < 1e-8))
    assert reported.size >= 3
    growing = reported[branch.growing[reported] > 0]
    for i in {reported[0], reported[reported.size // 2], growing[growing.size // 2]}:
        true = multipliers(
            kernel, damping, cubic, branch.nu[i], branch.harmonics, branch.coefficients[i].ravel()
        )
        got = np.nanmax(np.abs(branch.multipliers[i]))
        assert got == pytest.approx(np.abs(true).max(), rel=2e-6)
        # Relaxation below the resolution of the reference counts as multiplier 1.
        assert branch.growing[i] >= (np.abs(true) > 1 + 1e-4).sum()
