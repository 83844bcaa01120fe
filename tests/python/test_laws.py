"""Force laws with functions: derivatives, and motions against SciPy and against polynomials."""

import warnings
from pathlib import Path

import mpmath
import numpy as np
import pytest
import viscovib as vv
from viscovib.systems.laws import Law, compile_law, read_law

SMOOTH = {
    "F0*tanh(d/w)": lambda d: 2 * np.tanh(d / 0.3),
    "k*d + sin(d)": lambda d: 3 * d + np.sin(d),
    "d/(1 + d^2)": lambda d: d / (1 + d**2),
    "exp(-d)*d^2 - cos(2*d) + 1": lambda d: np.exp(-d) * d**2 - np.cos(2 * d) + 1,
    "atan2(d, 1) + asinh(d)*sqrt(1 + d*d)": lambda d: (
        np.arctan(d) + np.arcsinh(d) * np.sqrt(1 + d**2)
    ),
    "log(2 + d) - log(2) + pow(d, 3)": lambda d: np.log(2 + d) - np.log(2) + d**3,
    "asin(d/4)*acos(d/4) + atanh(d/4) + acosh(5 + d) - acosh(5)": lambda d: (
        np.arcsin(d / 4) * np.arccos(d / 4) + np.arctanh(d / 4) + np.arccosh(5 + d) - np.arccosh(5)
    ),
    "sinh(d)*cosh(d) + tan(d/3) + atan(d)": lambda d: (
        np.sinh(d) * np.cosh(d) + np.tan(d / 3) + np.arctan(d)
    ),
    "2^d - 1 + (1 + d*d)^1.5": lambda d: 2.0**d - 1 + (1 + d * d) ** 1.5,
    "(2 + d)^(d/3) + 1/(3 + d)^2 + d^-2*d^4": lambda d: (
        (2 + d) ** (d / 3) + 1 / (3 + d) ** 2 + d**2
    ),
}  # fmt: skip
KINKS = {
    "k*max(d - gap, 0)": lambda d: 3 * np.maximum(d - 0.1, 0),
    "abs(d) + min(d, 0.2) + sign(d)": lambda d: np.abs(d) + np.minimum(d, 0.2) + np.sign(d),
    "where(d > 0.1, k*d, 2*d)": lambda d: np.where(d > 0.1, 3 * d, 2 * d),
    "where(d <= 0.1, 1, 0) + (d < 2)*(d >= -3)*d + heaviside(d)": lambda d: (
        np.where(d <= 0.1, 1, 0) + d + np.heaviside(d, 0.5)
    ),
}
NUMBERS = {"F0": 2.0, "w": 0.3, "k": 3.0, "gap": 0.1}


@pytest.mark.parametrize("text", [*SMOOTH, *KINKS])
def test_values_and_derivatives(text):
    """Values against NumPy; derivatives against Richardson differences."""
    law = read_law("law", text, ("d",), NUMBERS)
    assert isinstance(law, Law)
    d = np.linspace(-1.31, 1.27, 41)
    value, slopes = law(d[:, np.newaxis])
    expected = (SMOOTH | KINKS)[text]
    np.testing.assert_allclose(value, expected(d), rtol=1e-13, atol=1e-14)

    def difference(h):
        return (expected(d + h) - expected(d - h)) / (2 * h)

    fine = (64 * difference(5e-4) - 20 * difference(1e-3) + difference(2e-3)) / 45
    np.testing.assert_allclose(slopes[:, 0], fine, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize(
    ("text", "parity"),
    [
        ("tanh(d) + d^3*cos(d)", -1), ("d*abs(d)", -1), ("max(d, 0)", 0), ("cosh(d)*d^2", 1),
        ("d^2 + sin(d)", 0), ("where(abs(d) > 1, d, tanh(d))", -1), ("exp(d)", 0),
        ("sqrt(1 + d^2)", 1), ("sin(d)^3 + tanh(d)/cosh(d)", -1),
    ],
)  # fmt: skip
def test_parity(text, parity):
    """The parity follows from the structure of a law; odd laws keep odd harmonics only."""
    law = read_law("law", text, ("d",), {})
    assert isinstance(law, Law)
    assert law.parity == parity


def test_polynomials_stay_polynomials():
    """A polynomial law keeps its exact treatment."""
    assert read_law("law", "k*d^3 + d*(d - 1)", ("d",), {"k": 2.0}) == {(3,): 2, (2,): 1, (1,): -1}
    spring = vv.Spring(on="x", law="k*d^3", parameters={"k": 2.0})
    assert spring.degree == 3
    assert vv.Spring(on="x", law="tanh(d)").degree == 0


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("tanhh(d)", r"'tanhh' is not a known function \(did you mean tanh\?\)"),
        ("tahn(d)", r"'tahn' is not a known function \(did you mean tanh\?\)"),
        ("snih(d)", r"\(did you mean sinh\?\)"),
        ("sin(dd)", r"'dd' is neither a variable \(d, v\) nor a parameter \(did you mean d\?\)"),
        (
            "k3*d^3",
            r"^law = 'k3\*d\^3': 'k3' is neither a variable \(d, v\) nor a parameter"
            r".*; to make it one, give parameters=\{'k3': its value\}$",
        ),
        ("F0*tanh(d)", r"'F0' is neither .* give parameters=\{'F0': its value\}"),
        ("max(d)", r"expected ,"),
        ("sin(d", r"at its end: expected \)"),
        ("tanh(d)/0", "it divides by 0"),
        ("sin(d) + log(0 - 1)", "outside its domain"),
        ("sin(2d)", "expected"),
        ("abs(" * 300 + "d" + ")" * 300, "nested deeper than 100"),
        ("+".join(["sin(d)"] * 2000), "it is too long"),
        ("sin(é)", r"'é' \(character 5\): expected a number, a name or \($"),
        ("2d", r"'d' \(character 2\): expected .*; write products with \*$"),
        ("(1 + d)(1 - d)", r"'\(' \(character 8\): expected .*; write products with \*$"),
        (
            "d'^3",
            r'"\'" \(character 2\): expected .*; write the rate of x as x_dot, the rate of d as v$',
        ),
        (
            "d′",
            r"'′' \(character 2\): expected .*; write the rate of x as x_dot, the rate of d as v$",
        ),
        ("|d|*d", r"'\|' \(character 1\): expected .*; write an absolute value as abs\(x\)$"),
        ("d^3 − d", r"'−' \(character 5\): expected .*; write minus as -$"),
        ("2·d", r"'·' \(character 2\): expected .*; write products with \*$"),
        ("2×d", r"'×' \(character 2\): expected .*; write products with \*$"),
        ("d³", r"'³' \(character 2\): expected .*; write powers as x\^2, x\^3$"),
        ("0,5*d", r"',' \(character 2\): expected .*; write numbers with a decimal point$"),
        ("d;", r"';' \(character 2\): expected an operator or the end$"),
    ],
)
def test_wrong_laws(text, reported):
    """One line with the fault and a suggestion."""
    with pytest.raises(vv.InputError, match=reported):
        vv.Spring(on="x", law=text)


SCENE = Path(__file__).parents[2] / "data/scenes/duffing_branch.nml"


@pytest.mark.parametrize(
    "entry",
    [
        lambda text: vv.Spring(on="x", law=text.replace("x", "d")),
        lambda text: vv.PolynomialSystem(mass=1, stiffness=1, forces=text),
        lambda text: vv.simulate(
            vv.PolynomialSystem(mass=1, stiffness=1), 1, initial=[1, 0], events=text
        ),
        lambda text: vv.simulate_ensemble(
            vv.PolynomialSystem(mass=1, stiffness=1, forces=f"k*{text}", parameters={"k": 1}),
            t_end=1, initial=[1, 0], parameters={"k": [1, 2]},
        ),
        lambda text: vv.MountPoint(
            name="a", position=(0, 0, 0), stiffness=(1, 1, 1),
            law=(text.replace("x", "d"), None, None),
        ),
        lambda text: vv.Structure(mass=[1.0], stiffness=[[1.0]], names=[text]),
        lambda text: vv.Scene.read(SCENE).override({"scene.title": text}),
        lambda text: vv.Scene.read(SCENE).override({"force(1).on": text}),
    ],
)  # fmt: skip
@pytest.mark.parametrize("text", ["x\0+x", "\0x", "x^3\0", "sin(x)\0 + x"])
def test_a_nul_character_ends_no_text(entry, text):
    """The text after it would be omitted without a message."""
    with pytest.raises(vv.InputError, match="must have no NUL character") as error:
        entry(text)
    assert "\0" not in str(error.value)


@pytest.mark.parametrize("text", ["0x10*x", "1_000*x", "1.5_0*x^2", "1e1_0*x", "0b1*x", "x # y"])
def test_numbers_of_python_are_none(text, tmp_path):
    """As in a scene, which the driver reads."""
    with pytest.raises(vv.InputError, match=r"expected|must be"):
        vv.PolynomialSystem(mass=1, stiffness=1, forces=text)
    scene = tmp_path / "a.nml"
    scene.write_text(
        "&system coordinates='x', mass=1, stiffness=1 /\n&load amplitude=1 /\n"
        f"&force on='x', law='{text}' /\n&response nu=1 /\n"
    )
    with pytest.raises(vv.InputError):
        vv.Scene.read(scene)
    x_2 = vv.PolynomialSystem(mass=1, stiffness=1, names=["x_2"], forces="0.5e1*x_2^3 + 1E-1*x_2^2")
    assert x_2.groups[0].forces == {(0, (3,)): 5.0, (0, (2,)): 0.1}


@pytest.mark.parametrize("text", ["0.3*tanh(x) + 0.1*x*abs(x)", "0.3*x^3 + 0.1*x^2"])
def test_tabs_and_ends_of_lines_are_blanks(text):
    plain = vv.PolynomialSystem(mass=1, stiffness=1, forces=text)
    spread = vv.PolynomialSystem(
        mass=1, stiffness=1, forces="\t" + text.replace(" + ", "\n\t + \t") + "\r\n"
    )
    runs = [vv.simulate(one, 3, initial=[0.4, 1], dt=0.1) for one in (plain, spread)]
    np.testing.assert_array_equal(runs[0].state, runs[1].state)


def test_outside_the_domain_is_a_wall():
    """A motion beyond the domain of a logarithm is no solution, and no NaN occurs."""
    law = read_law("law", "log(1 + d)", ("d",), {})
    value, _ = law(np.array([[-2.0], [0.0]]))
    assert value[0] == 1e60
    assert value[1] == 0
    wall = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="-0.2*log(1 - x)")
    run = vv.simulate(wall, 50, load=2.0, nu=0.9, dt=0.01)
    assert run.outcome != "completed"
    assert np.isfinite(run.state).all()


@pytest.mark.parametrize(
    "text",
    [
        "tanh(log(1 + d))",
        "d/(1 + 1/(3 + sqrt(1 + d)))",
        "min(d, acosh(2 + d))",
        "where(asin(-d) < 0, d, 2*d)",
        "d*exp(-(1 + d)^1.5)",
        "sin(d)*(sign(atanh(-d)) + pow(1 + d, 0.5 + d^2))",
    ],
)
def test_no_function_hides_what_has_no_value(text):
    """Beyond -1 a part is undefined: then the law is undefined, independent of other parts."""
    law = read_law("law", text, ("d",), {})
    value, slopes = law(np.array([[-0.9], [-1.1], [0.3]]))
    assert value[1] == 1e60
    assert slopes[1, 0] == 0
    assert np.abs(value[[0, 2]]).max() < 10
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.2, forces=text.replace("d", "x"))
    with pytest.warns(vv.ConvergenceWarning):
        found = vv.forced_response(system, [0.9], load=20, method="newton", harmonics=9)
    assert not found.converged.any()


def test_what_where_leaves_aside_needs_no_value():
    """A root in the unused branch of `where` does not count."""
    law = read_law("law", "where(d > 0, d + d^1.5, d/(2 - exp(900*d)))", ("d",), {})
    at = np.array([-0.5, 0.25, 2.0])
    assert law(at[:, np.newaxis])[0] == pytest.approx([-0.25, 0.375, 2 + 2**1.5], rel=1e-15)
    law = read_law("law", "d*(1 + d)^(9000 + d)", ("d",), {})
    assert law(np.array([[-0.5]]))[0] == 0


def test_multiple_scales_refuse_by_name():
    """Multiple scales expand in powers."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="tanh(x)")
    with pytest.raises(vv.InputError, match="multiple scales take polynomials only"):
        vv.MultipleScales(system, load=0.1, nu=1.0)
    with pytest.raises(vv.InputError, match="potential is unknown"):
        system.energy([0.1, 0])


def test_condensed_with_functions():
    """A long chain with a law of two coordinates, against the full equations."""
    n = 10
    chain = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    names = [f"x{i + 1}" for i in range(n)]
    common = {"mass": np.eye(n), "stiffness": chain, "damping": 0.02 * chain}
    text = {"x2": "tanh(3*(x2 - x5))", "x5": "tanh(3*(x5 - x2))"}
    kernel = vv.PronyKernel(weights=[0.3], rates=[1.0])
    springs = [vv.Springs(forces=text, kernel=kernel)]
    condensed = vv.PolynomialSystem(**common, springs=springs)
    # The added term acts on all coordinates and is 0.
    all_of_it = "+".join(f"0*{name}^3" for name in names)
    idle = vv.Springs(forces={name: f"1e-300*sin({all_of_it})" for name in names})
    whole = vv.PolynomialSystem(**common, springs=[*springs, idle])
    load = np.eye(n)[0] * 0.2
    found, expected = (
        vv.forced_response(s, [0.5, 1.1], load=load, method="newton", harmonics=9)
        for s in (condensed, whole)
    )
    assert "condensed" in str(found.plan)
    assert "condensed" not in str(expected.plan)
    for name in names:
        np.testing.assert_allclose(
            found.coefficient(name, 1), expected.coefficient(name, 1), rtol=1e-9
        )


def test_coupling_with_functions():
    """A law of two deflections equals forces of the coordinates."""
    chain = np.diag([2.0, 2, 2]) - np.diag([1.0, 1], 1) - np.diag([1.0, 1], -1)
    common = {"mass": np.eye(3), "stiffness": chain, "damping": 0.05 * chain}
    text = "k*a*tanh(b^2)"
    couple = vv.Coupling(on={"a": "x1", "b": ("x2", "x3")}, law={"a": text}, parameters={"k": 2})
    structure = vv.Structure(**common, elements=[couple])
    plain = vv.PolynomialSystem(**common, forces={"x1": "2*x1*tanh((x2 - x3)^2)"})
    found, expected = (
        vv.forced_response(s, [0.7], load=[0.5, 0, 0.3], method="newton", harmonics=21)
        for s in (structure, plain)
    )
    for name in ("x1", "x2", "x3"):
        np.testing.assert_allclose(
            found.coefficient(name, 1), expected.coefficient(name, 1), rtol=1e-9
        )
    with pytest.raises(vv.InputError, match="must have no linear part at rest"):
        vv.Coupling(on={"a": "x1", "b": "x2"}, law={"a": "tanh(a + b)"})


@pytest.mark.parametrize("vary", ["stiffness[x1,x1]", "stiffness[x1,x2]", "stiffness_scale"])
def test_the_stiffness_varies_with_a_law(vary):
    """The linear part of a law stays when the stiffness varies: against separate systems."""

    def system(stiffness):
        return vv.PolynomialSystem(
            mass=[1, 1], stiffness=stiffness, damping=0.1 * np.eye(2),
            forces={"x1": "tanh(2*x1 - x2)", "x2": "sin(x2 - x1) + x2^3"},
        )  # fmt: skip

    first = np.array([[2.0, -0.5], [-0.5, 1.5]])
    finish = {"stiffness[x1,x1]": 2.4, "stiffness[x1,x2]": -0.3, "stiffness_scale": 1.2}[vary]
    last = first * finish
    if vary != "stiffness_scale":
        last = first.copy()
        last[0, 1 if vary.endswith("x2]") else 0] = finish
        last[1 if vary.endswith("x2]") else 0, 0] = finish
    start = {"stiffness[x1,x1]": 2.0, "stiffness[x1,x2]": -0.5, "stiffness_scale": 1.0}[vary]
    load = [0.3, 0.1]
    branch = vv.trace_response(
        system(first), nu=1.1, vary=vary, vary_range=(start, finish), load=load
    )
    for i, stiffness in ((0, first), (-1, last)):
        found = vv.forced_response(system(stiffness), [1.1], load=load, method="newton")
        np.testing.assert_allclose(
            branch.coefficients[i, :, :3], found.coefficients[0, :, :3], atol=1e-8
        )
    with pytest.raises(vv.InputError, match="must not scale laws with functions"):
        vv.trace_response(system(first), nu=1.1, vary="forces_scale", vary_range=(1, 2), load=load)


@pytest.mark.parametrize(
    ("text", "exact", "low", "high"),
    [
        ("tanh(x)", mpmath.tanh, 1e-12, 60), ("sin(x)", mpmath.sin, 1e-9, 1e5),
        ("cos(x)", mpmath.cos, 1e-9, 1e5), ("exp(x)", mpmath.exp, 1e-9, 130),
        ("log(x)", mpmath.log, 2e-20, 1e20), ("1/x", lambda x: 1 / x, 1e-8, 1e8),
    ],
)  # fmt: skip
def test_functions_of_samples_are_right_to_the_last_digits(text, exact, low, high):
    """Values and derivatives against mpmath, for numbers of samples that do not fill a block."""
    law = compile_law("law", text, ("x",), {})
    x = np.geomspace(low, high, 1003)
    x[::2] *= 1 if text == "log(x)" else -1
    value, slope = law(x[:, np.newaxis])
    with mpmath.workdps(40):
        known = np.array([float(exact(mpmath.mpf(float(at)))) for at in x])
        by_x = np.array([float(mpmath.diff(exact, mpmath.mpf(float(at)))) for at in x])
    assert np.abs(value / known - 1).max() <= 4 * np.finfo(float).eps
    # 1 - tanh^2 inherits the cancellation of tanh; other derivatives are as accurate as values.
    allowed = 4 * np.finfo(float).eps * (np.maximum(1, 1 / np.abs(by_x)) if "tanh" in text else 1)
    near = np.minimum(np.abs(slope[:, 0] / by_x - 1) / allowed, np.abs(slope[:, 0] - by_x) / 1e-15)
    assert near.max() <= 1


@pytest.mark.parametrize("width", [0.5, 0.1, 0.03, 0.003])
def test_samples_are_as_many_as_a_law_needs(width):
    """The residual in the kept harmonics vanishes with 2^16 samples, even for steep laws."""
    system = vv.PolynomialSystem(
        mass=1, stiffness=1, damping=0.1, forces=f"0.3*tanh(x_dot/{width})"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vv.ConvergenceWarning)
        response = vv.forced_response(system, [0.8, 1.1], load=1, method="newton", harmonics=15)
    theta = 2 * np.pi * np.arange(2**16) / 2**16
    for nu, x in zip(response.nu, response.coefficients[:, 0], strict=True):
        k = response.harmonics
        rate = ((1j * k * nu * x) @ np.exp(1j * np.outer(k, theta))).imag
        force = 2j / theta.size * np.fft.rfft(0.3 * np.tanh(rate / width))[k]
        left = (1 - (k * nu) ** 2 + 0.1j * k * nu) * x + force - (k == 1)
        assert np.abs(left).max() < 1e-10


def test_a_plan_tells_a_preload():
    """For a law with a force at rest and for a negative gap; for no other law."""
    gap = [vv.Gap(on="x1", stiffness=5, gap=size) for size in (-0.2, 0.2)]
    first, second = (
        vv.Structure(mass=[[1.0]], stiffness=[[1.0]], damping=[[0.1]], elements=[one])
        for one in gap
    )
    cosine = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="0.3*cos(x)")
    reported = "the static preload of laws that are not 0 at rest (up to "
    for system, load, value in ((first, [0.1], "1)"), (cosine, 0.1, "0.3)"), (second, [0.1], "")):
        plan = str(vv.plan_response(system, [1.0], load=load, method="newton"))
        assert (reported + value in plan) == bool(value)
        assert (reported in plan) == bool(value)
