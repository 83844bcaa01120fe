"""Shocks on a body beside the exact answer of its modes."""

import numpy as np
import pytest
import viscovib as vv
from scipy.integrate import quad
from test_body import engine


@pytest.mark.parametrize("kind", ["half_sine", "sawtooth"])
def test_shocks_beside_duhamel(kind):
    """q_r = sum of phi_r F integral of a(s) sin(w_r (t - s))/w_r over the shock, after it."""
    body = engine()
    push = body.load(force=(0, 300, 2000), torque=(5, 0, 0)).real
    shape = {"half_sine": lambda s: np.sin(np.pi * s / 0.011), "sawtooth": lambda s: s / 0.011}[
        kind
    ]
    shock = getattr(vv.LoadTable, kind)(push, 0.011, start=0.002)
    run = vv.simulate(body, 0.1, force=shock, dt="auto", tolerance=1e-11)
    squares, shapes = np.linalg.eig(np.linalg.solve(body.mass, body.stiffness))
    omega = np.sqrt(squares.real)
    shapes = shapes.real / np.sqrt(np.einsum("ir,ij,jr->r", shapes.real, body.mass, shapes.real))
    t = run.t[-1] - 0.002
    answers = [
        quad(lambda s, w=w: shape(s) * np.sin(w * (t - s)) / w, 0, 0.011, epsabs=1e-15)[0]
        for w in omega
    ]
    expected = shapes @ (answers * (shapes.T @ push))
    np.testing.assert_allclose(run.state[-1, ::2], expected, atol=1e-8 * np.abs(expected).max())


def test_shocks_on_one_coordinate_and_what_is_refused():
    shock = vv.LoadTable.sawtooth(3.0, 0.5, start=1.0)
    np.testing.assert_allclose(shock([0.9, 1.25, 1.5, 1.6]), [0, 1.5, 3, 0])
    with pytest.raises(vv.InputError, match="duration = 0: must be greater than 0"):
        vv.LoadTable.half_sine(1.0, 0)
    with pytest.raises(vv.InputError, match="peak: must be a number"):
        vv.LoadTable.half_sine([[1.0]], 1)
