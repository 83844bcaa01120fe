"""Shocks on systems against the exact answer of their modes."""

import pickle
from functools import reduce

import numpy as np
import pytest
import viscovib as vv
from scipy.integrate import quad
from test_body import engine
from viscovib.systems.load_table import PiecewiseTable, added

LENGTH, START = 0.011, 0.002
#: Each shock, its formula at s = (t - start)/duration, and corners within it.
SHOCKS = {
    "half sine": (vv.HalfSine, {}, lambda s: np.sin(np.pi * s), []),
    "haversine": (vv.Haversine, {}, lambda s: np.sin(np.pi * s) ** 2, []),
    "sawtooth": (vv.Sawtooth, {}, lambda s: s, []),
    "trapezoid": (
        vv.Trapezoid, {"rise": 0.25 * LENGTH}, lambda s: min(1, 4 * s, 4 * (1 - s)), [0.25, 0.75],
    ),
    "unequal trapezoid": (
        vv.Trapezoid, {"rise": 0.0, "fall": 0.5 * LENGTH}, lambda s: min(1, 2 * (1 - s)), [0.5],
    ),
    "linear sweep": (
        vv.Chirp, {"hz": (0.0, 500.0)},
        lambda s: np.sin(2 * np.pi * 250 * LENGTH * s**2), [],
    ),
    "logarithmic sweep": (
        vv.Chirp, {"hz": (800.0, 200.0), "sweep": "logarithmic"},
        lambda s: np.sin(2 * np.pi * 800 * LENGTH * (1 - 0.25**s) / np.log(4)), [],
    ),
    "step": (vv.Step, {}, lambda s: 1.0, []),
}  # fmt: skip


@pytest.mark.parametrize("name", SHOCKS)
def test_shocks_have_the_motion_of_duhamels_integral(name):
    """q_r = sum of phi_r F integral of a(s) sin(w_r (t - s))/w_r over the shock."""
    body = engine()
    push = body.load(force=(0, 300, 2000), torque=(5, 0, 0)).real
    kind, numbers, shape, corners = SHOCKS[name]
    if kind is not vv.Step:
        numbers = numbers | {"duration": LENGTH}
    shock = kind(amplitude=push, start=START, **numbers)
    end = 0.03
    run = vv.simulate(body, end, force=shock, dt="auto", tolerance=1e-11)
    squares, shapes = np.linalg.eig(np.linalg.solve(body.mass, body.stiffness))
    omega = np.sqrt(squares.real)
    shapes = shapes.real / np.sqrt(np.einsum("ir,ij,jr->r", shapes.real, body.mass, shapes.real))
    t = end - START
    until = t if kind is vv.Step else LENGTH
    answers = [
        quad(
            lambda s, w=w: shape(s / LENGTH) * np.sin(w * (t - s)) / w, 0, until, epsabs=1e-16,
            epsrel=1e-13, points=[LENGTH * c for c in corners] or None, limit=200,
        )[0]
        for w in omega
    ]  # fmt: skip
    expected = shapes @ (answers * (shapes.T @ push))
    np.testing.assert_allclose(run.state[-1, ::2], expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("name", SHOCKS)
def test_shocks_have_the_values_of_their_formula(name):
    kind, numbers, shape, _ = SHOCKS[name]
    if kind is not vv.Step:
        numbers = numbers | {"duration": LENGTH}
    shock = kind(amplitude=(2.0, -3.0), start=START, **numbers)
    s = np.linspace(0, 1, 1237)[1:-1]
    wanted = np.array([shape(one) for one in s])
    found = shock(START + LENGTH * s)
    assert np.abs(found - np.outer(wanted, [2.0, -3.0])).max() < 2e-13
    assert not shock(START - 1e-9).any()
    assert shock(START + 2 * LENGTH).any() == (kind is vv.Step)
    again = pickle.loads(pickle.dumps(shock))
    assert np.array_equal(again(START + LENGTH * s), found)
    assert "times" not in repr(shock)
    assert "amplitude=" in repr(shock)


def test_shocks_on_one_coordinate_and_what_is_refused():
    shock = vv.LoadTable.sawtooth(3.0, 0.5, start=1.0)
    np.testing.assert_allclose(shock([0.9, 1.25, 1.5, 1.6]), [0, 1.5, 3, 0])
    with pytest.raises(vv.InputError, match="duration = 0: must be greater than 0"):
        vv.LoadTable.half_sine(1.0, 0)
    with pytest.raises(vv.InputError, match="amplitude: must be a number"):
        vv.LoadTable.half_sine([[1.0]], 1)
    with pytest.raises(vv.InputError, match="the load is not finite"):
        vv.HalfSine(amplitude=1.7e308, duration=0.1)
    for given, says in [
        ({"rise": 0.7, "fall": 0.5}, r"rise \+ fall = 1.2: must be at most the duration, 1"),
        ({"rise": -0.1}, "rise, fall = -0.1: must not be negative"),
    ]:
        with pytest.raises(vv.InputError, match=says):
            vv.Trapezoid(amplitude=1, duration=1, **given)
    for given, says in [
        ({"hz": (1, 2, 3)}, "hz: must be two frequencies"),
        ({"hz": (-1, 2)}, "hz = -1, 2: must be greater than 0"),
        ({"hz": (0, 2), "sweep": "logarithmic"}, "hz = 0, 2: must be greater than 0"),
        ({"hz": (0, 1e6)}, "cycles, must be at most"),
        ({"hz": (1, 2), "sweep": "random"}, "sweep"),
    ]:
        with pytest.raises(vv.InputError, match=says):
            vv.Chirp(amplitude=1, duration=1, **given)
    with pytest.raises(vv.InputError, match="unit"):
        vv.Step(amplitude=1, unit="ft/s^2")


def test_sums_of_shocks_and_records_have_the_sum_of_the_values():
    """Polynomials of different degrees on random times; steps end at every corner of both."""
    rng = np.random.default_rng(3)
    for _ in range(50):
        a, b = rng.uniform(0.01, 0.05, 2)
        record = vv.LoadTable(
            times=np.cumsum(rng.uniform(0.001, 0.02, 6)), values=rng.standard_normal(6)
        )
        parts = [
            vv.HalfSine(amplitude=1.0, duration=a, start=rng.uniform(0, 0.02)),
            record,
            vv.Chirp(amplitude=0.5, duration=b, hz=(5.0, 60.0)),
        ]
        table = reduce(added, [(one.times, one._pieces(1)) for one in parts])
        total = PiecewiseTable.of(*table)
        t = np.sort(rng.uniform(-0.01, 0.15, 200))
        assert np.abs(total(t)[:, 0] - sum(one(t) for one in parts)).max() < 1e-13
        corners = total._breaks(1)
        assert np.isin(record.times, corners).all()
        assert np.isin([parts[0].times[0], parts[0].times[-1]], corners).all()
