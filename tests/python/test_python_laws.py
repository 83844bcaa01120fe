"""Force laws as Python functions: against texts; derivatives, errors, other processes."""

import ctypes
import math
import pickle
import subprocess
import sys

import numpy as np
import pytest
import viscovib as vv
from viscovib.common.fingerprint import digest
from viscovib.systems.laws import Law, read_law

ONE = {"mass": 1, "stiffness": 1, "damping": 0.1}
RUBBER = vv.RzhanitsynKernel(amplitude=0.2, alpha=0.5, beta=0.5)
TEXT = "k*tanh(x) + 0.2*x_dot*cos(x)"


def bent(x, x_dot, k):
    # Requires arrays, so that it is called and not converted to a text.
    x = np.asarray(x)
    return k * np.tanh(x) + 0.2 * x_dot * np.cos(x)


def bent_slopes(x, x_dot, k):
    return k / np.cosh(x) ** 2 - 0.2 * x_dot * np.sin(x), 0.2 * np.cos(x)


def pair(forces=bent, text=TEXT, **more):
    parameters = {"k": 0.7}
    return [
        vv.PolynomialSystem(**ONE | more, forces=law, parameters=parameters)
        for law in (text, forces)
    ]


def differ(text, python):
    """Largest difference. A function is not known to be odd, so even harmonics are kept."""
    places = [list(python.harmonics).index(k) for k in text.harmonics]
    rest = np.delete(python.coefficients, places, axis=2)
    left = python.coefficients[:, :, places] - text.coefficients
    return max(np.abs(left).max(), np.abs(rest).max(initial=0.0))


def masses(law):
    k = np.array([[2.0, -1], [-1, 2]])
    spring = vv.Spring(on=("x1", "x2"), law=law, parameters={"k": 0.7})
    return vv.Structure(mass=[1, 1], stiffness=k, damping=0.05 * k, elements=[spring])


@pytest.mark.parametrize("forces", [bent, vv.PythonLaw(bent, slopes=bent_slopes)])
@pytest.mark.parametrize("kernel", [None, RUBBER])
def test_steady_motions_are_those_of_the_text(forces, kernel):
    runs = [
        vv.forced_response(
            system,
            [0.7, 1.4],
            load=0.8,
            method="newton",
            stability=True,
            harmonics=15,
            tolerance=1e-8,
        )
        for system in pair(forces, kernel=kernel)
    ]
    assert differ(*runs) < 1e-10
    assert runs[0].stable.tolist() == runs[1].stable.tolist()


def test_branches_over_a_parameter_are_those_of_the_text():
    text, python = (
        vv.trace_response(system, vary="k", vary_range=(0.5, 2), nu=1.2, load=0.8, harmonics=9,
                          tolerance=1e-2)
        for system in pair()
    )  # fmt: skip
    assert python.outcome == text.outcome == "completed"
    assert python.amplitude("x")[-1] == pytest.approx(text.amplitude("x")[-1], rel=1e-9)


def test_structures_take_functions_of_a_deflection():
    laws = "k*tanh(d)*d^2", lambda d, k: k * np.tanh(d) * d**2
    text, python = (
        vv.forced_response(
            masses(law), [0.9], load=[0, 0.4], method="newton", harmonics=13, tolerance=1e-2
        )
        for law in laws
    )
    assert differ(text, python) < 1e-11
    text, python = (
        vv.trace_response(masses(law), vary="elements[0].k", vary_range=(0.5, 1), nu=0.9,
                          load=[0, 0.4], harmonics=5, tolerance=1e-2)
        for law in laws
    )  # fmt: skip
    assert python.amplitude("x1")[-1] == pytest.approx(text.amplitude("x1")[-1], rel=1e-9)


@pytest.mark.parametrize("kernel", [None, RUBBER])
def test_motions_in_time_are_those_of_the_text(kernel):
    runs = [
        vv.simulate(s, 8, load=0.8, nu=1.1, tolerance=1e-9, method="gauss8" if kernel is None
                    else "auto")
        for s in pair(kernel=kernel)
    ]  # fmt: skip
    assert np.allclose(runs[0].state[-1], runs[1].state[-1], rtol=0, atol=2e-8)


def test_ensembles_exponents_and_basins_are_those_of_the_text():
    many = [
        vv.simulate_ensemble(s, initial=[0.1, 0], parameters={"k": [0.5, 0.7, 1.0]}, load=0.8,
                             nu=1.1, t_end=10, dt=0.1, lyapunov="all")
        for s in pair()
    ]  # fmt: skip
    assert np.allclose(many[0].spectrum, many[1].spectrum, rtol=0, atol=1e-9)
    wells = [
        vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.5, forces=law)
        for law in ("2*x^3/(1 + x^2)", lambda x: 2 * x**3 / (1 + x**2))
    ]
    grid = {"x": [-1.5, 0.5], "x_dot": [-0.5, 0.5]}
    first, second = (vv.basins(s, grid, t_end=40, dt=0.2, tolerance=1e-3) for s in wells)
    assert (first.labels == second.labels).all()
    assert len(set(second.labels.ravel())) == 2


def test_plans_say_that_a_law_is_in_python():
    text, python = (str(vv.plan_response(s, [1.0], load=1, method="newton")) for s in pair())
    assert "computes: 1 law in Python, each time it is needed" in python
    assert "Python" not in text


@pytest.mark.parametrize(
    ("law", "reported"),
    [
        (lambda d: np.abs(np.asarray(d)) * d, "not analytic"),
        (lambda d: np.array([math.sin(x) for x in d]), "does not accept complex numbers"),
        (lambda d: 1.0 if d > 0 else 2.0, "must take arrays, entry by entry"),
        (lambda d: d.sum(), "returns different values for an array"),
        (lambda d: d[:1], "must return one number for each entry"),
        (lambda d, w: d + w, "the argument 'w' of <lambda> is neither a variable (d, v) nor"),
        (lambda k: k, "must have one of d, v as an argument"),
        (lambda *d: d[0], "does not list its arguments"),
        (lambda d: 1j * d, "must return real numbers"),
        (lambda d: np.log(d), "must be defined near rest"),
        (vv.PythonLaw(lambda d: d**3, slopes=lambda d: 2 * d**2), "its slopes give"),
        (vv.PythonLaw(lambda d: d**3, slopes=lambda d: (d, d)), "2 derivatives, must be 1"),
    ],
)
def test_functions_that_cannot_be_laws_are_refused(law, reported):
    with pytest.raises(vv.InputError, match="law") as caught:
        vv.Spring(on="x1", law=law, parameters={"k": 1.0})
    assert reported in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("seed", range(8))
def test_laws_whose_parts_cancel_at_rest_are_taken(seed):
    """Rounding errors of the parts exceed the differences used for checking derivatives."""
    a, b = np.random.default_rng(seed).uniform(0.1, 2, 2)
    for law in (
        lambda d: b * (np.sqrt(a + d**2) - np.sqrt(a)),
        lambda d: b * (np.cos(a * d) - 1),
        lambda d: a * np.exp(b * d / 1e3) - a,
    ):
        vv.Spring(on="x1", law=law)


def test_a_kinked_function_with_slopes_of_its_own_is_right():
    """`interp` of NumPy has no complex step."""

    def table(d):
        return np.interp(d, [-1e4, 0, 1e4], [-1e4, 0, 2e4])

    law = vv.PythonLaw(table, slopes=lambda d: np.where(d < 0, 1.0, 2.0))
    text = "where(d > 0, 2*d, d)"
    found = [
        vv.forced_response(
            masses(one), [0.5], load=[0, 0.2], method="newton", harmonics=31, tolerance=1e-2
        )
        for one in (text, law)
    ]
    assert differ(*found) < 1e-5


def test_where_a_function_has_no_value_a_motion_ends():
    system = vv.PolynomialSystem(**ONE, forces=lambda x: np.log1p(x))
    run = vv.simulate(system, 30, initial=[0, -3.0], dt=0.01)
    assert run.outcome == "diverged"
    assert "has no value beyond x = -1" in run.reason


def test_an_error_of_a_function_reaches_the_caller():
    calls = {"left": 10**9}

    def fails(x):
        calls["left"] -= 1
        if calls["left"] < 0:
            raise KeyError("no such entry")
        return np.asarray(x) ** 3

    system = vv.PolynomialSystem(**ONE, forces=fails)
    calls["left"] = 20
    with pytest.raises(vv.InputError, match=r"the law fails raised KeyError .*no such entry"):
        vv.simulate(system, 30, initial=[0.5, 0], dt=0.1)
    calls["left"] = 10**9
    assert vv.simulate(system, 3, initial=[0.5, 0], dt=0.1).outcome == "completed"


def test_arguments_with_defaults_may_be_left_out():
    def law(d, size=2.0, v=0.0, *, k):
        return k * d**3 * size + v**3

    spring = vv.Spring(on="x1", law=law, parameters={"k": 3.0})
    value, slopes = spring._program(np.array([[0.5, 2.0]]))
    assert value[0] == pytest.approx(3 * 0.125 * 2 + 8, rel=1e-14)
    assert slopes[0] == pytest.approx([3 * 3 * 0.25 * 2, 12], rel=1e-14)


def test_functions_of_other_calls_are_not_mixed_up():
    """After a system is deleted no other law may be mistaken for its law."""
    first = vv.PolynomialSystem(**ONE, forces=lambda x: x**3)
    before = vv.simulate(first, 3, initial=[0.5, 0], dt=0.1).state[-1]
    for power in (2, 5, 7):
        other = vv.PolynomialSystem(**ONE, forces=lambda x, p=power: x**p)
        vv.simulate(other, 3, initial=[0.5, 0], dt=0.1)
    assert (vv.simulate(first, 3, initial=[0.5, 0], dt=0.1).state[-1] == before).all()


def test_systems_travel_to_other_processes(tmp_path):
    (tmp_path / "law_of_user.py").write_text("def cubic(x, k):\n    return k * x**3\n")
    make = (
        "import sys, pickle; sys.path.insert(0, {!r})\n"
        "import viscovib as vv, law_of_user\n"
        "s = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces=law_of_user.cubic,\n"
        "                        parameters=dict(k=0.5))\n"
        "x = vv.simulate(s, 5, initial=[1, 0], dt=0.1).state[-1].tolist()\n"
        "open({!r}, 'wb').write(pickle.dumps((s, x)))\n"
    ).format(str(tmp_path), str(tmp_path / "system"))
    subprocess.run([sys.executable, "-c", make], check=True)
    sys.path.insert(0, str(tmp_path))
    try:
        system, x = pickle.loads((tmp_path / "system").read_bytes())
    finally:
        sys.path.remove(str(tmp_path))
    assert vv.simulate(system, 5, initial=[1, 0], dt=0.1).state[-1].tolist() == x
    # A copy in the same process uses the same law, also after one of both is deleted.
    again = pickle.loads(pickle.dumps(system))
    del system
    assert vv.simulate(again, 5, initial=[1, 0], dt=0.1).state[-1].tolist() == x


def test_checkpoints_know_the_function_again():
    systems = [vv.PolynomialSystem(**ONE, forces=bent, parameters={"k": 0.7}) for _ in range(2)]
    assert digest(systems[0]) == digest(systems[1])


def random_law(rng, names):
    """A random function of these names with NumPy functions, with a few kinks and jumps."""
    ones = [
        "np.tanh({})",
        "np.sin({})",
        "np.arctan({})",
        "np.log1p(np.tanh({})**2)",
        "np.abs({})",
        "np.sqrt(1.5 + ({})**2)",
        "np.clip({}, -0.4, 0.3)",
        "np.expm1(np.sin({}))",
        "-({})",
    ]
    twos = [
        "({}) + ({})",
        "({}) * ({})",
        "np.maximum({}, {})",
        "({}) / (2 + ({})**2)",
        "np.where(({0}) > 0.1, {0}, {1})",
        "({}) - 0.25*({})",
    ]
    text = names[0]
    for _ in range(rng.integers(1, 6)):
        if rng.random() < 0.5:
            text = ones[rng.integers(len(ones))].format(text)
        else:
            text = twos[rng.integers(len(twos))].format(text, names[rng.integers(len(names))])
    return f"({names[0]})*({text})"  # fmt: skip


@pytest.mark.parametrize("seed", range(10))
def test_functions_of_numpy_words_become_texts_of_the_same_values(seed):
    """They then cost as much as texts; values and slopes are those of the function."""
    rng = np.random.default_rng(seed)
    source = random_law(rng, ["d", "v", "k"])
    function = eval(f"lambda d, v, k: {source} + 0*v*k", {"np": np})
    law = read_law("law", function, ["d"], {"k": 0.7}, ["v"])
    assert isinstance(law, Law)
    assert not law.calls
    at = rng.uniform(-2, 2, (50, 2))
    values, slopes = law(at)
    assert values == pytest.approx(function(*at.T, 0.7), rel=1e-12, abs=1e-13)
    h = 1e-6
    near = (function(at[:, 0] + h, at[:, 1], 0.7) - function(at[:, 0] - h, at[:, 1], 0.7)) / (2 * h)
    off = np.abs(slopes[:, 0] - near) > 1e-5 * (1 + np.abs(near))
    # At most a few of the points are next to a kink or a jump.
    assert off.sum() <= 2


@pytest.mark.parametrize(
    "law",
    [
        lambda d: np.interp(d, [-1e4, 0, 1e4], [-1e4, 0, 1e4]),
        lambda d: d if np.all(d == 0) else 2 * d,
        lambda d, seen=[]: d * (1 + (seen.append(0) or len(seen) > 1)),
        lambda d: np.vectorize(math.tanh)(d.real) + 0 * d,
    ],
)
def test_functions_that_texts_cannot_say_are_called(law):
    """Branches on values, numbers that change between calls, other libraries."""
    calls = vv.PythonLaw(law, slopes=lambda d: np.ones_like(d), arguments=["d"])
    try:
        found = read_law("law", calls, ["d"], {}, ["v"])
    except vv.InputError:
        return
    assert found.calls


def compiled(function, m):
    """A compiled function of m numbers; the library only sees its address."""
    return ctypes.CFUNCTYPE(ctypes.c_double, *[ctypes.c_double] * m)(function)


@pytest.mark.parametrize("m", [1, 2, 5, 8])
def test_compiled_functions_are_called_with_their_operands_in_order(m):
    rng = np.random.default_rng(m)
    w = rng.uniform(0.2, 1, m)
    names = ["x", "x_dot", *(f"k{i}" for i in range(2, m))][:m]
    parameters = dict(zip(names[2:], rng.uniform(-1, 1, max(m - 2, 0)), strict=True))

    def value(*at):
        return math.sin(w @ np.array(at))

    slopes = [
        compiled(lambda *at, i=i: w[i] * math.cos(w @ np.array(at)), m) for i in range(min(m, 2))
    ]
    law = vv.PythonLaw(compiled(value, m), slopes=slopes, arguments=names)
    total = " + ".join(f"{a!r}*{name}" for a, name in zip(w.tolist(), names, strict=True))
    runs = [
        vv.trace_response(
            vv.PolynomialSystem(mass=1, stiffness=1, damping=0.6, forces=one,
                                parameters=parameters),
            (0.8, 1.2), load=0.3, harmonics=7, tolerance=1e-3,
        )
        for one in (law, f"sin({total})")
    ]  # fmt: skip
    assert runs[0].amplitude("x")[-1] == pytest.approx(runs[1].amplitude("x")[-1], rel=1e-9)
    assert "law in Python" not in str(runs[0].plan)


def test_compiled_functions_give_the_motion_of_their_text():
    library = ctypes.CDLL(None)
    for name in ("sinh", "cosh"):
        getattr(library, name).restype = ctypes.c_double
        getattr(library, name).argtypes = [ctypes.c_double]
    law = vv.PythonLaw(library.sinh, slopes=[library.cosh], arguments=["x"])
    ends = [
        vv.simulate(vv.PolynomialSystem(**ONE, forces=one), 30, initial=[1, 0]).state[-1]
        for one in (law, "sinh(x)")
    ]
    assert np.allclose(*ends, rtol=0, atol=1e-9)
    with pytest.raises(vv.InputError, match="cannot be stored or sent to another process"):
        pickle.dumps(vv.PolynomialSystem(**ONE, forces=law))


def test_wrong_compiled_functions_are_refused():
    sine, cosine = compiled(math.sin, 1), compiled(math.cos, 1)
    integer = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_int)(lambda n: 1.0 * n)
    for law, text in [
        (vv.PythonLaw(sine, arguments=["x"]), "slopes .* list of 1 compiled"),
        (vv.PythonLaw(sine, slopes=[cosine]), "name them"),
        (vv.PythonLaw(sine, slopes=[np.cos], arguments=["x"]), "must be compiled functions of 1"),
        (vv.PythonLaw(integer, slopes=[cosine], arguments=["x"]), "argtypes .c_double."),
        (vv.PythonLaw(sine, slopes=[sine], arguments=["x"]), "derivative of .* by x"),
    ]:
        with pytest.raises(vv.InputError, match=text):
            vv.PolynomialSystem(**ONE, forces=law)
