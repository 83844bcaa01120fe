"""Decaying motions: no subnormal numbers, which are ten times slower on many processors."""

import numpy as np
import pytest
import viscovib as vv

#: z is driven, phi and psi decay: below 1e-308 after about 14000 units of time.
PENDULUM = dict(e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.1, c2=0.1, c3=0.1, f0=0.02, p1=0.93)
FADING = (0, 0, 0.01, 0, -0.01, 0)


def subnormal(states):
    sizes = np.abs(states)
    return int(((sizes > 0) & (sizes < np.finfo(float).tiny)).sum())


def oscillators(kernel):
    """Two uncoupled oscillators; the second is not driven."""
    return vv.PolynomialSystem(
        mass=[1, 1], stiffness=[[1, 0], [0, 4]], damping=[[0.2, 0], [0, 0.2]],
        forces={"x1": "0.5*x1^3", "x2": "0.3*x2^3"}, kernel=kernel,
    )  # fmt: skip


@pytest.mark.parametrize("method", ["gauss2", "gauss8", "gauss16", "rk4", "verner9"])
def test_no_state_is_subnormal(method):
    run = vv.simulate(vv.Pendulum(**PENDULUM), 20_000, dt=0.25, initial=FADING, method=method)
    assert 0 < np.abs(run.state[40_000, 2:]).max() < 1e-180
    assert subnormal(run.state) == 0
    assert np.abs(run.state[-1, 2:]).max() < 1e-300
    assert np.abs(run.state[-1, :2]).max() > 0.01


@pytest.mark.parametrize(
    "kernel", [None, vv.PronyKernel(weights=[0.1], rates=[1.0])], ids=["none", "memory"]
)
def test_no_state_of_a_mount_is_subnormal(kernel):
    run = vv.simulate(
        oscillators(kernel), 20_000, dt=0.25, initial=[0, 0, 0.01, 0], load=(0.1, 0), nu=0.9,
        method="gauss4",
    )  # fmt: skip
    assert np.abs(run.state[20_000, 2:]).max() > 0
    assert subnormal(run.state) == 0
    assert np.abs(run.state[-1, 2:]).max() < 1e-300


def test_the_callers_arithmetic_is_left_alone():
    vv.simulate(vv.Pendulum(**PENDULUM), 10, dt=0.25, initial=FADING)
    vv.simulate_ensemble(vv.Pendulum(**PENDULUM), initial=FADING, t_end=10, dt=0.25, n_threads=1)
    vv.simulate(
        oscillators(vv.PronyKernel(weights=[0.1], rates=[1.0])), 10, dt=0.25, load=(1, 0), nu=1
    )
    assert np.float64(np.finfo(float).tiny) / np.array([4.0]) > 0
