"""Shared fixtures: the reference scene of the mount."""

import pytest
import viscovib as vv


@pytest.fixture
def mount():
    """Build the reference mount with any parameter changed."""

    def build(amplitude=0.048, **changes):
        kernel = vv.RzhanitsynKernel(amplitude=amplitude, alpha=0.1, beta=0.05)
        parameters = {
            "mass": 1.0,
            "inertia": 0.1,
            "offset": 0.5,
            "stiffness_x": 10.0,
            "stiffness_phi": 2.0,
            "kernel": kernel,
        }
        return vv.Mount(**(parameters | changes))

    return build
