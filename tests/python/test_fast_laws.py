"""Laws that change fast along a motion: resolved by divided steps, or reported."""

import time

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

LAW = "0.12*tanh(x_dot/0.2) + 0.26*atan2(x, 1)*cos(x_dot)"


def right_side(t, y):
    x, v = y
    return [v, -x - 0.05 * v - 0.12 * np.tanh(v / 0.2) - 0.26 * np.arctan2(x, 1) * np.cos(v)]


@pytest.mark.parametrize("method", ["verner9", "gauss8"])
def test_fast_laws_are_followed_in_ensembles(method):
    """A run computed separately at one step size stays so at shorter steps."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces=LAW)
    starts = [[20.0, 0.1], [0.5, 0.0], [32.0, 0.0]]
    many = vv.simulate_ensemble(
        system, initial=starts, t_end=6.0, method=method, tolerance=1e-7, n_threads=1
    )
    for start, state in zip(starts, many.state, strict=True):
        judge = solve_ivp(right_side, (0, 6), start, "DOP853", rtol=1e-12, atol=1e-12)
        assert np.abs(judge.y[:, -1] - state).max() < 1e-7


def test_motions_that_outrun_their_laws_are_reported():
    """An escape with a cosine of the velocity would need unlimited division of steps."""
    system = vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.05, forces=LAW)
    begin = time.process_time()
    with pytest.raises(
        vv.InputError, match=r"run 1 ends at t = .*change too fast for steps of any"
    ):
        vv.simulate_ensemble(system, initial=[[0.0, 0.0], [200.0, 200.0]], t_end=20.0, n_threads=1)
    # Without the limit it would take minutes, and more for each unit of time.
    assert time.process_time() - begin < 60


@pytest.mark.parametrize("width", [0.3, 1e-2, 1e-4])
def test_atan2_with_a_number_is_a_layer_as_atan_is(width):
    """The same law in two forms takes the same steps."""

    def made(text):
        return vv.PolynomialSystem(
            mass=1, stiffness=1, damping=0.02, forces=f"0.3*{text}", parameters={"w": width}
        )

    runs = [
        vv.simulate(made(text), initial=[2.0, 0.3], t_end=12.0, tolerance=1e-9)
        for text in ("atan2(x, w)", "atan(x/w)")
    ]
    assert runs[0].step == runs[1].step
    assert np.abs(runs[0].state[-1] - runs[1].state[-1]).max() < 2e-9
    many = [
        vv.simulate_ensemble(made(text), initial=[2.0, 0.3], t_end=12.0).state
        for text in ("atan2(x, w)", "atan(x/w)")
    ]
    assert np.abs(many[0] - many[1]).max() < 2e-8


def test_a_single_motion_that_outruns_its_law_ends():
    system = vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.05, forces=LAW)
    run = vv.simulate(system, initial=[200.0, 200.0], t_end=20.0, dt=0.4)
    assert run.outcome == "step too large"
    assert 5 < run.t_reached < 15
    assert np.isfinite(run.state).all()


def test_a_run_made_by_itself_stays_so_in_shorter_steps():
    """Whole steps that barely resolve a layer are less accurate than divided steps."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="0.5*tanh(x_dot/0.05)")
    many = vv.simulate_ensemble(system, initial=[8.0, 0.1], t_end=10.0, method="dop8", n_threads=1)
    judge = solve_ivp(
        lambda t, y: [y[1], -y[0] - 0.05 * y[1] - 0.5 * np.tanh(y[1] / 0.05)],
        (0, 10), [8.0, 0.1], "DOP853", rtol=1e-12, atol=1e-12,
    )  # fmt: skip
    assert np.abs(judge.y[:, -1] - many.state[0]).max() < 1e-8
    # Regression: the step was a sixteenth of this.
    assert many.step[0] > 0.02
