"""With `dt="auto"`, `error` includes the errors of kernel sums and of step equations.

Shorter steps reduce these errors, so two runs differ by them.
"""

import numpy as np
import pytest
import viscovib as vv


@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
def test_errors_hold_what_kernels_leave():
    """Against runs with 1e-12, which use other sums of exponentials for singular kernels."""
    rng = np.random.default_rng(3)
    for _ in range(4):
        draw = rng.uniform((0.02, 0.2, 0, 0.1, -1, -1, 10), (0.2, 0.8, 0.1, 1, 1, 1, 20))
        amplitude, alpha, damping, cubic, x, v, end = draw.tolist()
        system = vv.PolynomialSystem(
            mass=1, damping=damping, stiffness=1, forces=f"{cubic!r}*x^3",
            kernel=vv.AbelKernel(amplitude=amplitude, alpha=alpha),
        )  # fmt: skip
        given = {"initial": [x, v], "load": 0.5, "nu": 1.1}
        run = vv.simulate(system, end, tolerance=10 ** rng.uniform(-7, -3), **given)
        exact = vv.simulate(system, end, tolerance=1e-12, times=run.t, **given)
        assert np.abs(run.state - exact.state).max() <= run.error + exact.error
