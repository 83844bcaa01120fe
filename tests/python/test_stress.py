"""At the edge: findings of benchmarks/stress that were mended, and the quick form of its sweeps."""

import numpy as np
import pytest
import viscovib as vv
from test_pendulum import P1R, START


@pytest.mark.parametrize("method", ["gauss2", "gauss3", "gauss8"])
@pytest.mark.parametrize("h", [0.02, 0.05, 0.08, 0.12])
def test_small_steps_do_not_drift(method, h):
    """Collocation keeps the energy of an oscillator; each step was once solved to 5e-14 only."""
    run = vv.simulate(
        vv.PolynomialSystem(mass=1, stiffness=1), 6400 * h, dt=h, initial=[1, 0], method=method
    )
    energy = (run.state**2).sum(axis=1)
    assert abs(energy[-1] - 1) < 1e-12


def test_small_steps_keep_the_order():
    body = vv.Pendulum(**P1R)
    exact = vv.simulate(body, 64, dt=0.1, initial=START, method="gauss16", keep="last").state
    errors = [
        np.abs(vv.simulate(body, 64, dt=dt, initial=START, method="gauss3").state[-1] - exact).max()
        for dt in (0.1, 0.05, 0.025)
    ]
    assert errors[0] / errors[1] == pytest.approx(64, rel=0.2)
    assert errors[1] / errors[2] == pytest.approx(64, rel=0.2)


@pytest.mark.parametrize(
    "kernel",
    [
        vv.RzhanitsynKernel(amplitude=0, alpha=0.3, beta=0.05),
        vv.RabotnovKernel(amplitude=0, alpha=0.3, beta=0.05),
        vv.AbelKernel(amplitude=0, alpha=0.3),
    ],
    ids=lambda kernel: type(kernel).__name__,
)
def test_a_kernel_of_amplitude_0_is_none(kernel):
    """Its sum of exponentials once had 100001 terms, and a motion stopped at once."""
    few = kernel.sum_of_exponentials(t_min=0.01, t_max=100)
    assert few.weights.tolist() == [0]

    def run(kernel):
        body = vv.Mount(
            mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, kernel=kernel
        )
        return vv.simulate(body, 20, dt=0.25, load=0.5, nu=1.5).state

    assert run(kernel) == pytest.approx(run(None), abs=1e-14)
