"""Polynomials as text against Python arithmetic."""

from fractions import Fraction

import pytest
import viscovib as vv
from hypothesis import given, reject, strategies as st
from viscovib.systems.laws import expand, spell

NAMES = ("x", "phi", "x_2")


def value(polynomial, at):
    total = Fraction(0)
    for powers, c in polynomial.items():
        term = Fraction(c)
        for u, p in zip(at, powers, strict=True):
            term *= u**p
        total += term
    return total


def texts(depth):
    if depth == 0:
        return st.one_of(
            st.sampled_from(NAMES), st.integers(0, 9).map(str), st.sampled_from(["0.5", "0.25"])
        )
    inner = texts(depth - 1)
    return st.one_of(
        inner,
        st.tuples(inner, st.sampled_from(["+", "-", "*", " * "]), inner).map(
            lambda parts: f"({''.join(parts)})"
        ),
        st.tuples(inner, st.sampled_from(["^2", "**2", "^3", "/4", "^0"])).map(
            lambda parts: f"({parts[0]}){parts[1]}"
        ),
        inner.map(lambda text: f"-{text}"),
    )


@given(text=texts(3), at=st.lists(st.integers(-3, 3), min_size=3, max_size=3))
def test_value_is_that_of_the_text(text, at):
    # Small integers and quarters: every coefficient is exact.
    names = dict(zip(NAMES, map(Fraction, at), strict=True))
    exact = text.replace("^", "**").replace("0.5", "half").replace("0.25", "quarter")
    expected = eval(exact, {"half": Fraction(1, 2), "quarter": Fraction(1, 4)} | names)
    try:
        polynomial = expand("f", text, NAMES)
    except vv.InputError:
        # A degree above 15 is the subject of another test.
        reject()
    assert float(value(polynomial, [Fraction(u) for u in at])) == pytest.approx(float(expected))
    assert all(polynomial.values())


@pytest.mark.parametrize("text", ["1e305*x^3", "x^3*1e305", "1e200*1e200*x^3", "x^3/1e-305"])
def test_large_coefficients_are_named(text):
    with pytest.raises(vv.InputError, match="its coefficients must be at most 1e300"):
        vv.PolynomialSystem(mass=1, stiffness=1, forces=text)


def test_spelling():
    assert expand("f", "2*(x - phi)^2/4", NAMES) == {
        (2, 0, 0): 0.5,
        (1, 1, 0): -1.0,
        (0, 2, 0): 0.5,
    }
    assert spell((2, 0, 1), NAMES) == "x^2*x_2"
    assert expand("f", "x - x", NAMES) == {}


def test_no_expression_grows_without_bound():
    names = [f"q{i}" for i in range(60)]
    with pytest.raises(vv.InputError, match="takes too long to expand"):
        expand("f", f"({' + '.join(names)})^8", names)


def test_a_sum_of_thousands_of_terms():
    """Laws of reduced models have this many terms, without nesting."""
    text = "+".join(f"{i}*x^3-x^2" for i in range(1200))
    assert expand("forces", text, ["x"]) == {(3,): 1200 * 1199 / 2, (2,): -1200.0}
    with pytest.raises(vv.InputError, match="must not be deeper than 100"):
        expand("forces", "(" * 5000 + "x^3" + ")" * 5000, ["x"])
