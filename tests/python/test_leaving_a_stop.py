"""Motions that leave a stop just before a step ends, or before a run is resumed."""

import math

import numpy as np
import pytest
import viscovib as vv


def pushed(gap, *, both):
    """A mass against a stop without restitution."""
    kind = vv.Stop if both else vv.Gap
    element = kind(on="x1", gap=gap, restitution=0)
    return vv.Structure(mass=[1.0], stiffness=[[0.6]], damping=[[0.03]], elements=[element])


@pytest.mark.parametrize("seed", range(4))
def test_steps_that_end_just_behind(seed):
    """It leaves with zero velocity and acceleration: at first by less than rounding errors."""
    rng = np.random.default_rng([31, seed])
    gap, force, nu = rng.uniform(0.1, 0.4), rng.uniform(0.45, 0.8), rng.uniform(1.2, 1.6)
    block = pushed(gap, both=bool(rng.integers(2)))
    load = {"load": force, "nu": nu, "initial": [gap, 0.0]}
    # In contact while force sin(nu t) is above 0.6 gap.
    leaves = (math.pi - math.asin(0.6 * gap / force)) / nu
    first = vv.simulate(block, leaves, dt=leaves / 8, keep="last", **load)
    if abs(first.state[-1, 1]) > 0:
        pytest.skip("it begins by leaving")
    expected = vv.simulate(block, leaves + 0.5, tolerance=1e-12, times=[leaves + 0.5], **load)
    for ahead in 10 ** np.linspace(-7, -1.5, 12):
        h = (leaves + ahead) / 16
        run = vv.simulate(block, leaves + 0.5, dt=h, keep="last", **load)
        assert run.outcome == "completed", ahead
        assert np.abs(run.state - expected.state).max() < 1e-11


def test_resumed_runs_with_times():
    """They take the steps of the resumed run, for any distance of the times."""
    rng = np.random.default_rng(43)
    for _ in range(12):
        block = pushed(rng.uniform(0, 0.5), both=True)
        load = {"load": rng.uniform(0.1, 1), "nu": rng.uniform(0.5, 2)}
        start = [0.0, rng.uniform(-1, 1)]
        first = vv.simulate(block, 10.0, initial=start, times=[0.0, 10.0], **load)
        whole = vv.simulate(block, 30.0, initial=start, keep="last", **load)
        rest = vv.simulate(block, 30.0, resume=first, times=[10.0, 30.0])
        assert rest.outcome == "completed"
        assert rest.step == first.step
        assert np.abs(rest.state[-1] - whole.state[-1]).max() < 1e-9
