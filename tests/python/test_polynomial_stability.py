"""Stability of polynomial systems: multipliers, characteristic roots, period doubling."""

import numpy as np
import pytest
import viscovib as vv
from polynomial_examples import chain
from scipy.linalg import eigvals


@pytest.mark.parametrize("n", [1, 4, 7])
def test_multipliers_at_rest_are_exponentials(n):
    system = chain(n, damping=0.03)
    branch = vv.trace_response(system, (0.7, 0.8), load=0.0)
    stiffness = np.asarray(system.stiffness)
    first = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -0.03 * stiffness]])
    expected = np.exp(eigvals(first) * 2 * np.pi / 0.7)
    found = branch.multipliers[0]
    distance = np.abs(found[:, np.newaxis] - expected)
    # Steps in which the fastest mode rotates by at most 0.6 rad have an error of about 1e-9.
    assert distance.min(axis=0).max() < 2e-9
    assert distance.min(axis=1).max() < 2e-9
    assert branch.stable.all()


@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
def test_roots_where_rest_is_unstable():
    """A double well: a real root for leaving the saddle; no natural frequency there."""
    system = vv.PolynomialSystem(mass=2, stiffness=-1, damping=0.1, forces="x^3")
    roots = system.characteristic_roots()
    assert roots.real == pytest.approx(np.sort(np.roots([2, 0.1, -1]))[::-1], rel=1e-13)
    assert (roots.n_unstable, roots.complete) == (1, True)
    with pytest.raises(vv.InputError, match="rest is unstable"):
        system.natural_frequencies()
    # With a mean load, in one of the wells.
    r = vv.forced_response(system, 3.0, load={0: 0.1j, 1: 0.05}, method="newton")
    assert r.converged.all()
    gyroscopic = vv.PolynomialSystem(
        mass=[1, 1], stiffness=[[1, 0.05], [-0.05, 1.2]], damping=[[0, 0.3], [-0.3, 0]]
    )
    assert gyroscopic.natural_frequencies().size == 2
    creeping = chain(3, kernel=vv.PronyKernel(weights=[1.1], rates=[1]))
    assert creeping.characteristic_roots().n_unstable == 3
    assert creeping.characteristic_roots().complete


def test_period_doubling_in_a_well():
    """Period doubling near f = 0.266 in the well of x'' + 0.3 x' - x + x^3 = f cos(1.2 t).

    Below it the motion about x = 1 repeats after one period, above it after two. Floquet
    multipliers must give this value. Guckenheimer and Holmes (1983), section 2.2.
    """
    system = vv.PolynomialSystem(mass=1, stiffness=2, damping=0.3, forces="3*x^2 + x^3")
    nu = 1.2
    branch = vv.trace_response(system, nu=nu, load_range=(0, 0.3), load=1j, harmonics=25)
    assert [crossing.kind for crossing in branch.crossings] == ["period doubling"]
    i = branch.crossings[0].before
    real = branch.multipliers[i : i + 2, 0].real
    onset = np.interp(1, -real, branch.load_factor[i : i + 2])
    period = 2 * np.pi / nu
    for factor, repeats in ((0.98 * onset, 1), (1.02 * onset, 2)):
        near = int(np.abs(branch.load_factor - factor).argmin())
        x, k = branch.coefficients[near, 0], branch.harmonics
        start = [x.sum().imag + 1e-3, (1j * k * nu * x).sum().imag]
        run = vv.simulate(
            system, 1500 * period, initial=start, load=1j * factor, nu=nu, dt=period / 40,
            save_every=40, keep="tail", tail=3.5 * period,
        )  # fmt: skip
        once, twice = np.abs(run.state[-1] - run.state[-2:-4:-1]).max(axis=1)
        assert twice < 1e-9
        assert (once < 1e-9) == (repeats == 1)


@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
def test_a_multiplier_that_was_counted_but_not_found_is_not_the_slowest():
    """A fast growing exponent of a softening spring with memory: counted but not located."""
    spring = vv.PolynomialSystem(
        mass=1.69, damping=0.017369, stiffness=1.579, forces="-1.072*x^3 + 0.129*x^2",
        kernel=vv.RzhanitsynKernel(amplitude=0.0258, alpha=0.651, beta=0.927),
    )  # fmt: skip
    branch = vv.trace_response(spring, (0.58, 1.74), load=0.75, max_points=40)
    reported = np.isfinite(np.abs(branch.multipliers)).any(axis=1)
    assert (branch.growing > 0).any()
    assert not (branch.slowest & ~reported).any()
