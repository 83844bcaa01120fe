"""What is told of a motion does not depend on the unit in which forces are measured."""

import numpy as np
import pytest
import viscovib as vv

SCALES = (2.0**20, 2.0**-20)


def _chain(rng, n):
    springs = rng.uniform(0.5, 2, n + 1)
    stiffness = np.diag(springs[:-1] + springs[1:])
    stiffness -= np.diag(springs[1:-1], 1) + np.diag(springs[1:-1], -1)
    mass, damping = rng.uniform(0.5, 2, n), 10 ** rng.uniform(-4, -1) * stiffness
    quadratic, cubic = rng.uniform(0.1, 0.4), rng.uniform(0.1, 1)
    kernel = vv.PronyKernel(weights=[rng.uniform(0.01, 0.1)], rates=[rng.uniform(0.1, 2)])

    def system(scale):
        return vv.PolynomialSystem(
            mass=mass * scale,
            stiffness=stiffness * scale,
            damping=damping * scale,
            forces={"x1": f"{quadratic * scale!r}*x1^2 + {cubic * scale!r}*x1^3"},
            kernel=kernel if n == 2 else None,
            names=[f"x{i + 1}" for i in range(n)],
        )

    return system


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
def test_errors_are_the_same_in_any_unit_of_force(n):
    # The mean has no equation for its real part. Told to round as the forces do, it was an error
    # that grew with their numbers.
    rng = np.random.default_rng(n)
    for _ in range(3):
        system, nu = _chain(rng, n), np.sort(rng.uniform(0.3, 2.5, 5))
        load = np.array([10 ** rng.uniform(-3, -1)] + [0.0] * (n - 1))
        for method in ("newton", "successive"):
            own = vv.forced_response(system(1.0), nu, load=load, method=method)
            for scale in SCALES:
                other = vv.forced_response(system(scale), nu, load=scale * load, method=method)
                for name in ("coefficients", "truncation", "error"):
                    np.testing.assert_array_equal(getattr(other, name), getattr(own, name), name)
        # Steps along branches differ a little: pivots do.
        own, other = (
            vv.trace_response(system(scale), (0.4, 2.2), load=scale * load).error
            for scale in (1.0, SCALES[0])
        )
        assert np.median(other) < 4 * np.median(own)
