"""The ordering of weak coupling: e is of the size of the amplitudes."""

import mpmath
import numpy as np
import pytest
import viscovib as vv

pytestmark = pytest.mark.filterwarnings("ignore::viscovib.RangeWarning")

BODY = {"w2": 0.43, "w3": 0.71, "alpha": 0.5}


def weak(e, **change):
    return vv.MultipleScales(vv.Pendulum(e=e, **{**BODY, **change}), ordering="weak_coupling")


def at_rest(ms):
    return np.array([np.ravel(ms.backbone(j, 0.0))[0] for j in range(3)])


def test_frequencies_to_the_second_power_of_e():
    """Taylor coefficients of the roots of (w2^2 - L)(w3^2 - L) = e r L^2, by mpmath."""
    mpmath.mp.dps = 40
    a, b = mpmath.mpf("0.43") ** 2, mpmath.mpf("0.71") ** 2
    r = b / a

    def lower(e, sign):
        root = mpmath.sqrt((a - b) ** 2 + 4 * e * r * a * b)
        return mpmath.sqrt((a + b + sign * root) / 2 / (1 - e * r))

    e = 0.02
    found = at_rest(weak(e))
    for sign in (-1, 1):
        c = mpmath.taylor(lambda x, s=sign: lower(x, s), 0, 2)
        wanted = float(c[0] + c[1] * e + c[2] * e**2)
        assert min(abs(found - wanted)) < 1e-14
    assert weak(e).frequencies[0] == pytest.approx(vv.MultipleScales(weak(e).system).frequencies[0])
    # First power, explicitly: -e r w2^3/(2 (w3^2 - w2^2)).
    shift = -float(r) * 0.43**3 / (2 * (0.71**2 - 0.43**2))
    tiny = at_rest(weak(1e-7))
    np.testing.assert_allclose((tiny[1] - 0.43) / 1e-7, shift, rtol=1e-6)


def test_dropped_terms_are_of_fourth_order():
    """If e and the motion are halved, the orderings differ by the power of the omitted terms."""
    apart = []
    t = np.linspace(0, 20, 81)
    for k in range(2, 6):
        x = 2.0**-k
        initial = x * np.array([0.06, 0.02, 0.05, -0.01, -0.03, 0.01])
        system = vv.Pendulum(e=0.08 * x, **BODY)
        one, other = (
            vv.MultipleScales(system, ordering=o).motion(t, initial).state
            for o in ("general", "weak_coupling")
        )
        apart.append(abs(one - other)[:, ::2].max())
    powers = np.log2(np.array(apart[:-1]) / apart[1:])
    assert (powers > 3.7).all()
    assert (powers < 4.4).all()


def test_both_agree_without_coupling():
    system = vv.Pendulum(e=0.0, **BODY, c1=0.01, c2=0.01, c3=0.01, f0=0.002, p1=1.0)
    one, other = (vv.MultipleScales(system, ordering=o) for o in ("general", "weak_coupling"))
    np.testing.assert_allclose(one.interaction, other.interaction, atol=1e-13)
    np.testing.assert_allclose(
        one.response("p1", [1.0, 1.02]).harmonics, other.response("p1", [1.0, 1.02]).harmonics,
        rtol=1e-11, atol=1e-16,
    )  # fmt: skip
    assert [r.label for r in one.resonances()] == [r.label for r in other.resonances()]


def test_interaction_is_that_of_no_coupling():
    """The interaction contains e to the power 0 only: products of e and cubic terms are omitted."""
    np.testing.assert_allclose(weak(0.05).interaction, weak(0.0).interaction, atol=1e-12)
    full = vv.MultipleScales(vv.Pendulum(e=0.05, **BODY)).interaction
    assert abs(full - weak(0.05).interaction).max() > 1e-3


def test_its_error_counts_what_it_drops():
    """Against integration of the full pendulum, with e not small."""
    system = vv.Pendulum(e=0.08, **BODY)
    t = np.linspace(0, 30, 121)
    initial = np.array([0.01, 0, 0.02, 0, -0.01, 0])
    exact = vv.simulate(system, 30, times=t, initial=initial, tolerance=1e-12).state
    errors = []
    for ordering in ("general", "weak_coupling"):
        motion = vv.MultipleScales(system, ordering=ordering).motion(t, initial)
        error = abs(motion.state - exact)[:, ::2].max()
        assert error / 4 < motion.error_estimate.max() < 6 * error
        errors.append(error)
    assert errors[1] > 20 * errors[0]


def test_equal_frequencies_are_refused():
    with pytest.raises(vv.InputError, match=r"w3 = 0.43: must differ from w2 where e = 0 or"):
        weak(0.05, w3=0.43)
