"""Relative and absolute tolerances of motions in frequency, against integration in time."""

import numpy as np
import pytest
import viscovib as vv
from scipy.special import ellipk

DUFFING = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="x^3")


@pytest.mark.parametrize("size", [1, 1e-9])
def test_a_relative_error_holds_however_small_the_motion(size):
    """If sizes differ by s and the cubic force by 1/s^2, nothing else differs."""
    scaled = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces=f"{size**-2:.17g}*x^3")
    for method in ("newton", "successive"):
        one, other = (
            vv.forced_response(body, [0.3, 2.0], load=0.05 * s, method=method, rtol=1e-8)
            for body, s in ((DUFFING, 1), (scaled, size))
        )
        assert (one.iterations == other.iterations).all()
        np.testing.assert_allclose(
            other.coefficients / size, one.coefficients, rtol=1e-8, atol=1e-12
        )


def test_an_absolute_error_spares_corrections_of_small_motions():
    nu, load = np.linspace(0.2, 3, 40), 1e-4
    exact = vv.forced_response(DUFFING, nu, load=load, method="newton")
    loose = vv.forced_response(DUFFING, nu, load=load, method="newton", atol=1e-5)
    assert loose.iterations.sum() < 0.7 * exact.iterations.sum()
    assert np.abs(loose.amplitude("x") - exact.amplitude("x")).max() < 1e-5
    # No unjustified warning, and enough harmonics for a small absolute error.
    assert loose.complete
    assert (loose.truncation * np.abs(loose.coefficients).max(axis=(1, 2)) < 1e-5).all()


def test_branches_and_backbones_keep_an_absolute_error():
    exact = vv.trace_response(DUFFING, (0.3, 3), load=0.3, at=[1, 2], stability=False)
    loose = vv.trace_response(DUFFING, (0.3, 3), load=0.3, at=[1, 2], stability=False, atol=1e-4)
    assert loose.iterations.sum() < 0.7 * exact.iterations.sum()
    assert loose._lacking() == ""
    for one, other in zip(exact.stops, loose.stops, strict=True):
        few = min(exact.coefficients.shape[2], loose.coefficients.shape[2])
        off = exact.coefficients[one, :, :few] - loose.coefficients[other, :, :few]
        assert np.abs(off).max() < 1e-4
    free = vv.backbone(DUFFING, 0, (0.01, 1), rtol=1e-12, atol=1e-9)
    # The period of a Duffing oscillator by an elliptic integral.
    top = np.abs(free.coefficients[-1, 0].sum())
    w = np.sqrt(1 + top**2)
    true = np.pi * w / (2 * ellipk(top**2 / (2 * w**2)))
    assert abs(free.nu[-1] - true) < 1e-8


@pytest.mark.parametrize(("given", "reported"), [
    ({"rtol": 1e-6, "tolerance": 1e-5}, "tolerance is another name for rtol"),
    ({"rtol": 2.0}, "rtol = 2: must be in"),
    ({"atol": -1.0}, "atol = -1: must be in"),
    ({"atol": float("nan")}, "atol = nan: must be a finite number"),
])  # fmt: skip
def test_bad_errors_are_reported_by_name(given, reported):
    for call in (
        lambda: vv.forced_response(DUFFING, 1.0, load=0.1, **given),
        lambda: vv.plan_response(DUFFING, [1.0], load=0.1, **given),
        lambda: vv.trace_response(DUFFING, (1, 2), load=0.1, **given),
        lambda: vv.backbone(DUFFING, 0, (0.01, 1), **given),
    ):
        with pytest.raises(vv.InputError, match=reported):
            call()


def test_a_pendulum_takes_no_absolute_error_in_its_response():
    swung = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, c1=0.05, f0=0.01, p1=0.7)
    with pytest.raises(vv.InputError, match="atol: is not an argument for a pendulum"):
        vv.forced_response(swung, atol=1e-3)
    one, other = (vv.forced_response(swung, **{name: 1e-8}) for name in ("rtol", "tolerance"))
    np.testing.assert_array_equal(one.coefficients, other.coefficients)


def test_structures_take_both_in_the_displacements_of_elements():
    n = 12
    k = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    spring = vv.Spring(on="x3", law="d^3")
    body = vv.Structure(mass=np.ones(n), stiffness=k, damping=0.05 * k, elements=[spring])
    nu, load = np.linspace(0.1, 0.3, 30), np.eye(n)[0] * 0.01
    exact, loose, named = (
        vv.forced_response(body, nu, load=load, method="newton", coordinates=["x3"], **given)
        for given in ({}, {"atol": 1e-3}, {"rtol": 1e-10})
    )
    assert loose.iterations.sum() < 0.9 * exact.iterations.sum()
    assert loose.complete
    assert 1e-8 < np.abs(loose.amplitude("x3") - exact.amplitude("x3")).max() < 1e-3
    np.testing.assert_array_equal(named.coefficients, exact.coefficients)
