"""Slowly decaying harmonics: automatic harmonics, measured decay, extrapolation."""

import warnings

import numpy as np
import pytest
import viscovib as vv

#: Den Hartog, Trans. ASME 53 (1931): nu, friction, half peak-to-peak value, without sticking.
CLOSED = [(0.8, 0.2, 2.7114152554), (1.2, 0.3, 2.072384268)]


def friction(size):
    return vv.PolynomialSystem(mass=1, stiffness=1, forces=f"{size}*sign(x_dot)")


def found(system, nu, highest, load=1):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vv.ConvergenceWarning)
        return vv.forced_response(system, [nu], load=load, method="newton", harmonics=highest)


@pytest.mark.parametrize(("nu", "size", "amplitude"), CLOSED)
def test_extrapolation_meets_the_closed_form(nu, size, amplitude):
    """199 harmonics solved to 2e-4, extrapolated to 1e-6; both within the stated error."""
    fine, middle, coarse = (found(friction(size), nu, k) for k in (199, 99, 49))
    best = fine.extrapolated(middle, coarse)
    # It does not solve the truncated equations, which is not a sampling error.
    assert best.sampling[0] == fine.sampling[0] < 1e-12
    for one, bound in ((fine, 2e-4), (best, 1e-6)):
        error = abs(one.peak_to_peak("x")[0] / 2 / amplitude - 1)
        assert error < bound
        assert error < one.truncation[0]
    assert best.truncation[0] < 2e-6
    assert best.power[0] == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize(
    ("force", "load"), [("0.3*tanh(x_dot/0.05)", 1), ("3*max(x - 0.2, 0)", 0.5)]
)
def test_extrapolation_never_makes_worse(force, load):
    """Against 199 harmonics: results without a jump stay equal or become more accurate."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces=force)
    exact = found(system, 0.8, 199, load)
    for highest in ((19, 11, 5), (49, 24, 12)):
        fine, middle, coarse = (found(system, 0.8, k, load) for k in highest)
        best = fine.extrapolated(middle, coarse)
        m = fine.harmonics.size
        errors = [
            np.linalg.norm(one.coefficients[0, 0] - exact.coefficients[0, 0, :m])
            for one in (fine, best)
        ]
        assert errors[1] <= 1.01 * errors[0]


def test_extrapolation_refuses_what_does_not_belong_together():
    """Other frequencies, harmonics that do not decay, another result."""
    fine, middle = (found(friction(0.2), 0.8, k) for k in (31, 15))
    with pytest.raises(vv.InputError, match="highest harmonics 31, 15 and 15: must decrease"):
        fine.extrapolated(middle, middle)
    with pytest.raises(vv.InputError, match="coarse: must be of the same frequencies"):
        fine.extrapolated(middle, found(friction(0.2), 0.9, 7))
    with pytest.raises(vv.InputError, match="middle: must be a Response, got int"):
        fine.extrapolated(3, middle)


@pytest.mark.parametrize(
    ("force", "power"), [("0.4*x_dot*abs(x_dot)", 5), ("3*max(x - 0.2, 0)", 4),
                         ("0.3*sign(x_dot)", 3)]
)  # fmt: skip
def test_the_fall_of_harmonics_is_measured(force, power):
    """A jump of the n-th derivative of the force gives a decay k^-(n + 3)."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces=force)
    response = found(system, 0.8, 199)
    assert response.fall_off()[0] == pytest.approx(power, abs=0.3)
    with pytest.warns(vv.ConvergenceWarning, match=rf"harmonics there fall as k\^-{power}"):
        vv.forced_response(system, [0.8], load=1, method="newton", harmonics=99, tolerance=1e-13)
    few = found(system, 0.8, 3)
    assert np.isnan(few.fall_off()).all()


def test_orders_of_a_branch_go_as_far_as_the_law_needs():
    """Quadratic damping to 1e-9 needs more than 63; the limit of a polynomial is lower."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="0.4*x_dot*abs(x_dot)")
    branch = vv.trace_response(
        system, (0.9, 1.1), load=1, harmonics="auto", tolerance=1e-9, stability=False
    )
    assert 63 < branch.highest.max() < 199
    assert branch.truncation.max() <= 1e-9
    one = vv.forced_response(
        system, [branch.nu[-1]], load=1, method="newton", tolerance=1e-10, harmonics=199
    )
    m = branch.harmonics.size
    assert branch.coefficients[-1, 0] == pytest.approx(one.coefficients[0, 0, :m], abs=2e-9)
    assert "at most 199" in str(branch.plan)
    duffing = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="x^3")
    assert "at most 63" in str(vv.trace_response(duffing, (0.9, 1.1), load=1).plan)
