"""Motions that pass through chaos and settle: two runs may have equal final states by chance."""

import numpy as np
import pytest
import viscovib as vv

#: A body in two wells: first chaos, finally a periodic motion in either well.
WELLS = vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.1, forces="x^3")
LOAD = {"load": 0.4, "nu": 1.2}


@pytest.mark.parametrize(
    "kept", [{"keep": "last"}, {"keep": "tail", "tail": 5.0}, {"times": [1e3]}]
)
def test_what_is_kept_is_not_all_that_is_compared(kept):
    """A reported final state is also reached by neighbouring starts."""
    draw, refused = np.random.default_rng(3), 0
    for _ in range(12):
        start = np.array([draw.uniform(-0.3, 0.3), 0.0])
        ends = []
        for nearby in (0, 4e-11):
            try:
                run = vv.simulate(WELLS, 1000, initial=start + nearby, **LOAD, **kept)
            except vv.InputError as error:
                refused += "differ before the end" in str(error) or "chaotic" in str(error)
                continue
            ends.append(run.state[-1])
        if len(ends) == 2:
            assert np.abs(ends[1] - ends[0]).max() < 1e-5
    assert refused > 6


def test_motions_that_stay_together_are_reported():
    """Large motions that decay keep the tolerance relative to their final size."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.2, forces="x^3")
    whole = vv.simulate(system, 400, initial=[50.0, 0.0], load=0.1, nu=0.7, tolerance=1e-8)
    last = vv.simulate(
        system, 400, initial=[50.0, 0.0], load=0.1, nu=0.7, keep="last", tolerance=1e-10
    )
    assert np.abs(last.state[-1] - whole.state[-1]).max() < 2e-8
