"""Stability of polynomial systems: multipliers, characteristic roots, period doubling."""

import numpy as np
import pytest
import viscovib as vv
from polynomial_examples import chain


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
