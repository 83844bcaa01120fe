"""Peaks of responses and branches, against maxima found by other methods."""

import warnings

import numpy as np
import pytest
import viscovib as vv
from scipy.optimize import minimize_scalar

LIGHT = vv.Mount(
    mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, geometry="cubic",
    damping=0.02 * np.array([[10.0, -5.0], [-5.0, 4.5]]),
)  # fmt: skip


def highest_of(branch, dof):
    """The largest point of a dense branch: below the maximum by a relative error of about 1e-5."""
    return branch.amplitude(dof).max()


@pytest.mark.parametrize("count", [7, 40])
@pytest.mark.parametrize("downwards", [False, True])
def test_a_jump_is_no_summit(count, downwards):
    """A parabola across the jump of a light mount would be 11 percent too large."""
    nu = np.linspace(0.5, 10, count)[:: -1 if downwards else 1]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vv.ConvergenceWarning)
        r = vv.forced_response(LIGHT, nu, load=0.5, method="newton")
    dense = vv.trace_response(LIGHT, (0.5, 10), load=0.5, max_step=0.005, stability=False)
    for dof in ("x", "phi"):
        peak, top = r.peak(dof), highest_of(dense, dof)
        assert peak.amplitude <= top * (1 + 1e-5)
        if peak.enclosed:
            # A maximum of the branch, at its frequency.
            near = np.abs(dense.nu - peak.nu) < 0.05
            assert peak.amplitude <= dense.amplitude(dof)[near].max() * (1 + 1e-5)
        else:
            assert peak.amplitude == r.amplitude(dof)[r.nu == peak.nu].max()


def test_a_branch_has_the_peak_of_a_dense_one():
    dense = vv.trace_response(LIGHT, (0.5, 10), load=0.5, max_step=0.002, stability=False,
                              max_points=20000)  # fmt: skip
    coarse = vv.trace_response(LIGHT, (0.5, 10), load=0.5, max_step=0.3, stability=False)
    for dof in ("x", "phi"):
        peak = coarse.peak(dof)
        assert peak.enclosed
        assert peak.amplitude == pytest.approx(highest_of(dense, dof), rel=1e-5)
        assert peak.amplitude >= highest_of(dense, dof) * (1 - 1e-10)
        assert coarse.peak(dof).nu == pytest.approx(dense.peak(dof).nu, rel=1e-6)


def test_a_base_that_moves_counts():
    """The absolute motion has its maximum at another frequency than the relative motion."""
    system = vv.PolynomialSystem(
        mass=1, stiffness=1, damping=0.2, forces="1e-12*x^3", base_direction=[1.0]
    )
    nu = np.linspace(0.2, 3, 15)
    best = minimize_scalar(
        lambda v: -abs(1 + v**2 / (1 - v**2 + 0.2j * v)), bounds=(0.8, 1.2), method="bounded",
        options={"xatol": 1e-10},
    )  # fmt: skip
    for method in ("linear", "newton", "successive"):
        peak = vv.forced_response(system, nu, base=0.1, method=method).peak("x")
        assert peak.amplitude == pytest.approx(-0.1 * best.fun, rel=1e-8)
    branch = vv.trace_response(system, (0.2, 3), base=0.1, stability=False)
    assert branch.peak("x").amplitude == pytest.approx(-0.1 * best.fun, rel=1e-8)


def test_peaks_along_loads_and_parameters_are_on_the_branch():
    """A third harmonic has its maximum at an intermediate load: against points at many loads."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="x^3")
    for name, ends in (("stiffness", (0.2, 12)), ("load", (0.1, 6))):
        options = {"nu": 1.6, "load": 1.0, "stability": False}
        if name == "load":
            options |= {"load_range": ends}
        else:
            options |= {"vary": name, "vary_range": ends}
        dense = vv.trace_response(system, **options, max_step=0.003, max_points=20000)
        coarse = vv.trace_response(system, **options)
        peak, top = coarse.peak("x"), dense.amplitude("x").max()
        assert peak.amplitude == pytest.approx(top, rel=1e-5)


def test_a_pendulum_too():
    swung = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, c1=0.05, c2=0.05, c3=0.05, f0=0.05, p1=1)
    dense = vv.trace_response(swung, p1=(0.7, 1.3), stability=False, max_step=0.003)
    coarse = vv.trace_response(swung, p1=(0.7, 1.3), stability=False)
    peak = coarse.peak("z")
    assert peak.enclosed
    assert peak.amplitude == pytest.approx(dense.amplitude("z").max(), rel=1e-5)
    assert peak.amplitude >= dense.amplitude("z").max() * (1 - 1e-10)


def test_resonances_of_hardly_any_damping():
    """Down to a relative width of 1e-10 the peak is F/(c w); without damping it is infinite."""
    rng = np.random.default_rng(6)
    for damping in (*10 ** rng.uniform(-10, -3, 20), 0.0):
        k, nu = rng.uniform(0.5, 3), np.sort(rng.uniform(0.3, 2.5, 5))
        system = vv.PolynomialSystem(mass=1, stiffness=k, damping=damping)
        response = vv.forced_response(system, [0.2, *nu, 3.0], load=1)
        peak = response.peak("x")
        assert peak.enclosed
        np.testing.assert_allclose(peak.nu, np.sqrt(k - damping**2 / 2), rtol=1e-7)
        if damping:
            true = 1 / (damping * np.sqrt(k - damping**2 / 4))
            assert abs(peak.amplitude - true) < 1e-7 * true
        else:
            assert peak.amplitude == np.inf
    # A computed frequency may coincide with the resonance.
    met = vv.forced_response(vv.PolynomialSystem(mass=1, stiffness=1), [0.5, 0.9, 1.3], load=1)
    assert met.peak("x").amplitude == np.inf
    assert "inf" in met.summary()


@pytest.mark.parametrize("method", ["linear", "successive", "newton", "branch"])
def test_what_is_0_but_for_rounding_has_no_peak(method):
    """The middle of three masses in antiphase motion; the linear search must end."""
    rng = np.random.default_rng(5)
    for cubic in (0, 0.3) if method == "linear" else (0.3, 0.1):
        c, q = 10 ** rng.uniform(-3, -1), rng.uniform(0.3, 2)
        k = np.array([[1 + q, -q, 0], [-q, 2 * q + 1, -q], [0, -q, 1 + q]])
        forces = {name: f"{cubic}*{name}^3" for name in "ac"} if cubic else {}
        chain = vv.PolynomialSystem(
            mass=np.ones(3), stiffness=k, damping=c * k, names=list("abc"), forces=forces
        )
        load = {"a": c, "c": -c}
        if method == "branch":
            found = vv.trace_response(chain, (0.5, 2), load=load, stability=False)
        else:
            found = vv.forced_response(chain, np.linspace(0.5, 2, 40), load=load, method=method)
        peak = found.peak("b", 1)
        assert peak.amplitude < 1e-12
        assert not peak.enclosed
        assert found.peak("a", 1).enclosed
