"""Polynomial systems given in several ways, and wrong arguments."""

import numpy as np
import pytest
import viscovib as vv
from polynomial_examples import KERNEL, chain


def test_monomials_and_texts_say_the_same():
    by_text = chain(2)
    listed = [
        vv.Monomial(coefficient=c, powers=powers, on=on)
        for on, rows in (("x1", 0), (1, 1))
        for c, powers in (
            [(0.4, {"x1": 3}), (-0.6, (2, 1)), (0.6, {"x1": 1, "x2": 2}), (-0.2, [0, 3])]
            if rows == 0
            else [(-0.2, (3, 0)), (0.6, (2, 1)), (-0.6, (1, 2)), (0.4, (0, 3))]
        )
    ]
    by_list = chain(2, forces=listed)
    nu = np.linspace(0.3, 2, 20)
    a = vv.forced_response(by_text, nu, load=0.1, method="newton")
    b = vv.forced_response(by_list, nu, load=0.1, method="newton")
    assert a.coefficients == pytest.approx(b.coefficients, abs=1e-14)


DUFFING = {"mass": 1, "stiffness": 1, "forces": "x^3"}


TWO = {"mass": [1, 1], "stiffness": [1, 1]}


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"mass": 0}, "mass: must be symmetric and positive definite"),
        ({"mass": [[1, 2], [2, 1]]}, "mass: must be symmetric and positive definite"),
        ({"mass": np.ones((2, 3))}, "mass: must have shape"),
        ({"mass": np.ones(2001)}, "mass: 2001 coordinates, must be 1 to 2000"),
        (
            {
                "mass": np.ones(65),
                "stiffness": np.ones(65),
                "kernel": vv.AbelKernel(amplitude=0.1, alpha=0.5),
            },
            "mass: 65 coordinates, must be 1 to 64 unless forces",
        ),
        ({"mass": []}, "mass: 0 coordinates"),
        ({"mass": np.nan}, "mass = nan: must be a finite number"),
        (DUFFING | {"stiffness": [1, 2]}, "stiffness: must have shape (1,) or (1, 1), got (2,)"),
        (DUFFING | {"damping": np.ones((2, 2))}, "damping: must have shape"),
        (DUFFING | {"kernel": 1}, "kernel = 1: must be a Kernel or None"),
        (DUFFING | {"names": "x"}, "names = 'x': must be a sequence of 1 texts"),
        (DUFFING | {"names": ["2x"]}, "names: '2x' must be letters, digits and _"),
        (TWO | {"names": ["a", "a"]}, "names = a, a: must differ"),
        (TWO | {"units": ["m"]}, "units = ['m']: must be 2 texts"),
        (TWO | {"base_direction": [1]}, "base_direction: must have shape (2,), got (1,)"),
        (TWO | {"forces": "x1^3"}, "forces = 'x1^3': must name its equation"),
        (TWO | {"forces": {"y": "x1^3"}}, "equation 'y' must be one of 'x1' (0), 'x2' (1)"),
        (TWO | {"forces": {"x1": 3}}, "forces['x1'] = 3: must be a text"),
        (
            TWO | {"forces": {"x1": "z^2"}},
            "forces['x1'] = 'z^2': 'z' is neither a variable (x1, x2, ",
        ),
        (TWO | {"forces": {"x1": "x3_dot^3"}}, "'x3_dot' is neither a variable (x1, x2, "),
        (TWO | {"forces": {"x1": "x1 x2"}}, "expected an operator or the end"),
        (TWO | {"forces": {"x1": "2*(x1 + x2"}}, "at its end: expected )"),
        (TWO | {"forces": {"x1": "x1 + x2)"}}, "')' (character 8): expected an operator"),
        (TWO | {"forces": {"x1": "x1^1.5"}}, "must be defined near rest"),
        (TWO | {"forces": {"x1": "x1^-1"}}, "must be defined near rest"),
        (TWO | {"forces": {"x1": "x1^x2"}}, "must be defined near rest"),
        (TWO | {"forces": {"x1": "1/x1"}}, "must be defined near rest"),
        (TWO | {"forces": {"x1": "tanh(1/x1)"}}, "must be defined near rest"),
        (TWO | {"forces": {"x1": "0.3*atan(1/x2_dot)"}}, "must be defined near rest"),
        (TWO | {"forces": {"x1": "x1 / abs(x1)"}}, "u/abs(u) is sign(u) but for u = 0: write sign"),
        (TWO | {"forces": {"x1": "x1/0"}}, "it divides by 0"),
        (TWO | {"forces": {"x1": "2*"}}, "at its end: expected a number, a name or"),
        (TWO | {"forces": {"x1": "1e999*x1^2"}}, "'1e999' is not a finite number"),
        (TWO | {"forces": {"x1": "x1^1e999"}}, "'1e999' is not a finite number"),
        (TWO | {"forces": {"x1": "(" * 5000 + "x1" + ")" * 5000}}, "must not be nested deeper"),
        (TWO | {"forces": {"x1": "x1+" * 9000}}, "characters, must be at most 20000"),
        (TWO | {"forces": [1]}, "forces[0] = 1: must be a Monomial"),
        (TWO | {"forces": ["a^3"]}, "forces: 1 texts, must be 2, one per coordinate"),
        (TWO | {"forces": 1}, "forces = 1: must be a text, a mapping or Monomials"),
        (
            TWO | {"forces": [vv.Monomial(coefficient=1, powers=(2,), on=0)]},
            "forces[0].powers: has 1 powers, must be 2",
        ),
        (
            TWO | {"forces": [vv.Monomial(coefficient=1, powers={"y": 2}, on=0)]},
            "forces[0].powers: unknown coordinate 'y'",
        ),
        (
            TWO | {"forces": [vv.Monomial(coefficient=1, powers=(2, 0), on=2)]},
            "forces[0].on: equation 2 must be one of",
        ),
        (
            TWO | {"forces": [vv.Monomial(coefficient=1, powers=(15, 1), on=0)]},
            "forces[0].powers: degree 16, must be at most 15",
        ),
        (TWO | {"springs": vv.Springs(stiffness=1)}, "springs: must be a sequence of Springs"),
        (TWO | {"springs": [1]}, "springs[0] = 1: must be Springs"),
        (TWO | {"springs": [vv.Springs(stiffness=1)]}, "springs[0].stiffness: must have shape"),
    ],
)
def test_bad_systems_are_named(given, text):
    with pytest.raises(vv.InputError) as error:
        vv.PolynomialSystem(**given)
    assert text in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("work", "text"),
    [
        (lambda s: vv.forced_response(s, 1, base=0.1), "base: this system has no base_direction"),
        (lambda s: vv.forced_response(s, 1, load=[1, 2]), "must be a number or have shape (1,)"),
        (
            lambda s: vv.forced_response(chain(20), 1, load=1, method="newton", harmonics=199),
            "harmonics = 199: makes 4000 unknowns with 20 coordinates, must be at most 2000",
        ),
        (
            lambda s: vv.trace_response(
                chain(20), (0.1, 1), load=1, max_points=100_000, harmonics=49
            ),
            "max_points = 100000: must be at most",
        ),
        (lambda s: vv.simulate(s, 1, initial=[0, 0], load=1), "nu: must be given with a load"),
        (lambda s: vv.simulate(s, 1, initial=[0, 0], load=1, nu=0), "nu = 0: must be greater"),
        (lambda s: vv.simulate(s, 1, initial=[0, 0, 0]), "initial: must have shape (2,), got (3,)"),
        (
            lambda s: vv.simulate(chain(7), 1, initial=np.zeros(14), method="dop8"),
            "method = 'dop8': must be one of",
        ),
        (
            lambda s: vv.simulate(chain(2, kernel=KERNEL), 1, method="dop8"),
            "method = 'dop8': must be one of",
        ),
        (
            lambda s: vv.simulate(s, 1, base=0.1, nu=1),
            "base: this system has no base_direction",
        ),
        (lambda s: vv.simulate(s, 1, held=[1, 2]), "held: must have shape (1,), got (2,)"),
        (
            lambda s: vv.forced_response(
                vv.PolynomialSystem(
                    mass=1, forces="x + x^2", kernel=vv.AbelKernel(amplitude=0.1, alpha=0.5)
                ),
                1, load=0.1, method="newton",
            ),
            "a kernel has no finite integral",
        ),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
def test_bad_jobs_are_named(work, text):
    with pytest.raises(vv.InputError) as error:
        work(vv.PolynomialSystem(**DUFFING))
    assert text in str(error.value)


def test_creep_is_reported():
    with pytest.warns(vv.StabilityWarning, match="kernel integral = 2 >= 1"):
        vv.PolynomialSystem(**DUFFING, kernel=vv.PronyKernel(weights=[2], rates=[1]))


def test_huge_motions_overflow_in_words():
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.01, forces="x^15")
    with pytest.warns(vv.ConvergenceWarning):
        r = vv.forced_response(system, [0.5, 1.0], load=1e30, method="successive")
    assert not r.converged.any()
    run = vv.simulate(system, 10, dt=0.5, initial=[1e3, 0])
    assert run.outcome == "diverged"


@pytest.mark.parametrize(
    "law",
    [
        *("tanh(1/abs(x1))", "1/(1 + 1/x1^2)", "tanh(x1/1e-7)", "sign(x1)"),
        # At rest only rounding errors of these terms remain.
        *("tanh(x1) - x1", "cos(x1) - 1 + 0.5*x1^2", "log(1 + x1) - x1 + 0.5*x1^2"),
        *("sqrt(1 + x1) - 1 - 0.5*x1", "1e9*(exp(x1) - 1 - x1)", "sin(x1_dot)^2 - x1_dot^2"),
    ],
)
def test_laws_with_one_value_at_rest(law):
    assert vv.PolynomialSystem(**TWO | {"forces": {"x1": law}}).forces == {"x1": law}


def test_laws_that_are_flat_at_rest():
    """There the last digit of a value changes by rounding, which is not a jump."""
    rng = np.random.default_rng(5)
    shapes = (
        "{a}*tanh((x1 - {b})/{c})",
        "{a}*exp(-((x1 - {b})/{c})^2) + {b}",
        "{a}*atan(x1 - {b})",
    )
    for i in range(300):
        b = round(float(rng.uniform(0.05, 0.3)), 3)
        values = {"a": round(float(rng.uniform(0.1, 2)), 3), "b": b}
        law = shapes[i % 3].format(c=round(b / float(rng.uniform(15, 25)), 6), **values)
        assert vv.PolynomialSystem(**TWO | {"forces": {"x1": law}}).forces == {"x1": law}
