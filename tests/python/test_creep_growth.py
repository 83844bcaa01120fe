"""Growing exponents of mounts with negative relaxed stiffness, far to the right."""

import numpy as np
import pytest
import viscovib as vv
from scipy.optimize import brentq
from scipy.special import gamma

STIFFNESS = np.array([[10.0, -5.0], [-5.0, 4.5]])
MASS = np.diag([1.0, 0.1])


def rates_of_rest(amplitude, alpha, mass=MASS, stiffness=STIFFNESS):
    """Real s > 0 with det(s^2 M + K (1 - R(s))) = 0, R(s) = A Gamma(alpha) s^-alpha."""
    found = []
    for omega2 in np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real:

        def surplus(s, omega2=omega2):
            return s**2 + omega2 * (1 - amplitude * gamma(alpha) * s**-alpha)

        found.append(brentq(surplus, 1e-12, 1e9, xtol=1e-30, rtol=1e-14))
    return sorted(found, reverse=True)


@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
@pytest.mark.parametrize("seed", range(6))
def test_growth_far_from_the_axis_is_found(seed):
    """A growing exponent beyond four frequencies from the axis is found, not only counted."""
    rng = np.random.default_rng(seed)
    alpha = rng.uniform(0.2, 0.6)
    amplitude = 10 ** rng.uniform(0, 2.3)
    mount = vv.Mount(
        mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2,
        kernel=vv.AbelKernel(amplitude=amplitude, alpha=alpha),
    )  # fmt: skip
    rates = rates_of_rest(amplitude, alpha)
    nu = rates[0] * rng.uniform(0.08, 0.3)
    branch = vv.trace_response(mount, (nu, 1.3 * nu), load=1e-6, harmonics=3)
    reported = branch.growing >= 0
    assert reported.any()
    assert (branch.growing[reported] == 2).all()
    for found in branch.exponents[reported]:
        assert found[:2].real == pytest.approx(rates, rel=1e-7)


@pytest.mark.filterwarnings("ignore:kernel integral")
def test_rates_of_two_springs_that_relax_alike():
    # Both springs of a mount with an Abel kernel have a negative relaxed stiffness. Their growth
    # rates differ by less than 1 % and must both be found.
    rng = np.random.default_rng(1)
    closest = 1.0
    for _ in range(15):
        mount = vv.Mount(
            mass=rng.uniform(0.5, 2), inertia=rng.uniform(0.05, 0.5), offset=rng.uniform(0.3, 2),
            stiffness_x=rng.uniform(1, 12), stiffness_phi=rng.uniform(0.05, 2),
            damping=[[0.1, 0], [0, 0.1]],
            kernel=vv.AbelKernel(alpha=rng.uniform(0.3, 0.9), amplitude=rng.uniform(0.05, 0.3)),
        )  # fmt: skip
        roots = mount.characteristic_roots()
        if roots.real[0] < 0.005:
            continue
        branch = vv.trace_response(mount, nu=2.0, load_range=(1e-6, 1.1e-6), load=1.0, max_points=2)
        assert (branch.growing == roots.n_unstable).all()
        found = np.sort(branch.exponents[0].real[:2])[::-1]
        assert found == pytest.approx(roots.real, rel=1e-6)
        closest = min(closest, 1 - roots.real[1] / roots.real[0])
    assert closest < 0.05


@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
@pytest.mark.parametrize("seed", range(6))
def test_creep_of_structures_whose_springs_share_a_kernel(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 5))
    mass, springs = rng.uniform(0.5, 2, n), rng.uniform(0.4, 2, n)
    cuts = np.eye(n) - np.eye(n, k=-1)
    kernel = vv.AbelKernel(amplitude=rng.uniform(0.02, 0.3), alpha=rng.uniform(0.2, 0.8))
    structure = vv.Structure(
        mass=mass, stiffness=np.zeros((n, n)),
        elements=[
            vv.Spring(on=e, stiffness=k, law="0.5*d^3", kernel=kernel)
            for e, k in zip(cuts, springs, strict=True)
        ],
    )  # fmt: skip
    rates = rates_of_rest(
        kernel.amplitude, kernel.alpha, np.diag(mass), cuts.T @ np.diag(springs) @ cuts
    )
    nu = rng.uniform(0.5, 1.5)
    load = {1: [1e-5] + [0.0] * (n - 1)}
    branch = vv.trace_response(structure, (nu, 1.3 * nu), load=load, harmonics=3)
    assert (branch.growing == n).all()
    for found in branch.exponents:
        assert found[:n].real == pytest.approx(rates, rel=1e-6)
