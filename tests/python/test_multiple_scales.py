"""Multiple scales against symbolic derivations, known formulas and time integration."""

import dataclasses
import itertools
import re
import warnings
from fractions import Fraction
from math import comb

import numpy as np
import pytest
import scipy.optimize
import sympy as sp
import viscovib as vv
from scales_reference import interaction, pendulum_equations, terms_to_third

FREE = {"e": 0.1, "w2": 0.48, "w3": 0.8, "alpha": 0.5}


def one(**terms):
    return vv.CubicSystem(mass=[[1.0]], **terms)


def test_quadratic_and_cubic_together():
    # Nayfeh and Mook, Nonlinear oscillations, 1979, (2.3.31).
    omega, a2, a3 = 1.3, 0.4, 0.7
    ms = vv.MultipleScales(one(stiffness=[[omega**2]], quadratic=[[[a2]]], cubic=[[[[a3]]]]))
    expected = (9 * a3 * omega**2 - 10 * a2**2) / (24 * omega**3)
    np.testing.assert_allclose(ms.interaction, [[expected]], rtol=1e-13)


def test_terms_in_velocity_and_acceleration():
    # (1 + k q^2) q'' + k q q'^2 + q = 0, from T = (1 + k q^2) q'^2/2: with x = q + k q^3/6 and
    # x' = sqrt(1 + k q^2) q' to this order, x'' + x - k x^3/6 ... gives -k b^2/4 in all.
    k = 0.3
    cubic = np.zeros((1, 3, 3, 3))
    cubic[0, 0, 0, 2] = k
    cubic[0, 0, 1, 1] = k
    ms = vv.MultipleScales(one(stiffness=[[1.0]], cubic=cubic))
    # Period by quadrature of the energy integral.
    b = 1e-2
    theta, weight = np.polynomial.legendre.leggauss(60)
    angle = np.pi / 4 * (theta + 1)
    quarter = np.pi / 4 * np.sum(weight * np.sqrt(1 + k * b**2 * np.sin(angle) ** 2))
    shift = np.pi / 2 / quarter - 1
    np.testing.assert_allclose(ms.interaction[0, 0] * b**2, shift, rtol=1e-4)


@pytest.fixture(scope="module")
def lagrange():
    numbers = [sp.Rational(Fraction(str(FREE[k]))) for k in ("e", "w2", "w3", "alpha")]
    return terms_to_third(*pendulum_equations(*numbers))


def test_pendulum_interaction_against_lagrange_and_sympy(lagrange):
    omega, gamma = interaction(lagrange, 3)
    pend = vv.Pendulum(**FREE)
    ms = vv.MultipleScales(pend, tolerance=1e-6)
    order = [int(np.argmin([abs(w - x) for w in omega])) for x in ms.frequencies]
    np.testing.assert_allclose(ms.frequencies, [float(omega[i]) for i in order], rtol=1e-14)
    expected = [[float(gamma[i, k]) for k in order] for i in order]
    np.testing.assert_allclose(ms.interaction, expected, rtol=1e-10)


def packed_terms(system):
    """Polynomial form as a function of (q, q', q'')."""
    packed = vv.MultipleScales(system, tolerance=0.01)._form.packed
    n, n_arguments, n2, n3 = (int(packed[i]) for i in (0, 2, 5, 6))
    at = 8 + 2 * n_arguments + n
    a = packed[at : at + 4 * n * n].reshape(4, n, n).transpose(0, 2, 1)
    at += 4 * n * n
    quadratic = packed[at : at + 4 * n2].reshape(n2, 4)
    cubic = packed[at + 4 * n2 : at + 4 * n2 + 5 * n3].reshape(n3, 5)

    def residual(q, v, acceleration):
        x = np.concatenate([q, v, acceleration])
        total = a[0] @ q + a[1] @ v + a[2] @ acceleration + a[3] @ q
        for terms in (quadratic, cubic):
            for row, *places, c in terms:
                total[int(row) - 1] += c * np.prod(x[np.array(places, int) - 1])
        return total

    return residual


@pytest.mark.parametrize("equations", ["cubic", "exact"])
def test_polynomial_form_is_the_cubic_variant(equations):
    residual = packed_terms(vv.Pendulum(**FREE, c1=0.1, c2=0.2, c3=0.3, equations=equations))
    pend = vv.Pendulum(**FREE, c1=0.1, c2=0.2, c3=0.3, f0=0.3, m01=0.2, m02=0.1, equations="cubic")
    rng = np.random.default_rng(1)
    for _ in range(20):
        state = rng.uniform(-0.4, 0.4, 6)
        acceleration = pend.rhs(0.0, state)[1::2]
        loads = residual(state[::2], state[1::2], acceleration)
        np.testing.assert_allclose(loads, [0.3, 0.2, 0.1], atol=4e-15)


def test_printed_equations_to_third_degree():
    # Against the printed equations: the difference is of fourth degree.
    with pytest.warns(vv.RangeWarning, match="mode 3 is unstable"):
        residual = packed_terms(vv.Pendulum(**FREE, equations="printed"))
    pend = vv.Pendulum(**FREE, equations="printed")
    direction = np.array([0.3, -0.2, 0.5, 0.4, -0.6, 0.3])
    sizes = []
    for size in (0.1, 0.05):
        state = size * direction
        sizes.append(abs(residual(state[::2], state[1::2], pend.rhs(0.0, state)[1::2])).max())
    assert 3.7 < np.log2(sizes[0] / sizes[1]) < 4.6


CASES = {
    "free": ({}, 0.02, 1e-3),
    "near 3:1": ({"w2": 0.4}, 0.05, 1e-3),
    "near 2:1, damped": ({"w2": 0.57, "c1": 0.01, "c2": 0.02, "c3": 0.01}, 0.05, 1e-3),
    "loaded far from the modes": (
        {"w2": 0.57, "w3": 0.9, "c2": 0.01, "m02": 0.05, "p3": 0.31},
        0.05,
        1e-3,
    ),
}


def halvings(case, n=5, t_end=30.0):
    """Relative errors and estimates of motions whose sizes are halved."""
    change, tolerance, _ = CASES[case]
    errors, estimates = [], []
    for k in range(n):
        size = 0.25 * 2.0**-k
        numbers = {**FREE, **change}
        if "m02" in numbers:
            numbers["m02"] *= size
        pend = vv.Pendulum(**numbers)
        initial = size * np.array([0.3, 0.1, 0.2, -0.05, -0.15, 0.05])
        t = np.linspace(0, t_end, 61)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", vv.RangeWarning)
            motion = vv.MultipleScales(pend, tolerance=tolerance).motion(t, initial)
        exact = vv.simulate(pend, t_end, times=t, initial=initial, tolerance=1e-13).state
        errors.append(abs(motion.state - exact)[:, ::2].max() / size)
        estimates.append(motion.error_estimate.max() / size)
    return np.array(errors), np.array(estimates)


@pytest.mark.parametrize("case", CASES)
def test_error_falls_with_the_third_power(case):
    # Terms to third order: the error is amplitude^4, relative to the motion amplitude^3.
    errors, estimates = halvings(case)
    assert errors[0] > 1000 * errors[-1]
    powers = np.log2(errors[:-1] / errors[1:])[-2:]
    assert ((powers > 2.8) & (powers < 3.4)).all()
    # The estimate has the size of the error.
    ratio = estimates[1:] / errors[1:]
    assert (ratio > 0.1).all()
    assert (ratio < 100).all()


def test_motion_begins_at_the_state_given():
    initial = np.array([0.05, 0.01, 0.04, -0.02, -0.03, 0.02])
    pend = vv.Pendulum(**FREE, c1=0.02, f0=0.01, p1=0.4)
    motion = vv.MultipleScales(pend).motion([0.0], initial)
    np.testing.assert_allclose(motion.state[0], initial, atol=1e-15)


def test_fewer_steps_than_direct_integration():
    pend = vv.Pendulum(**FREE, c1=0.002, c2=0.002, c3=0.002)
    initial = np.array([0.02, 0, 0.01, 0, 0.01, 0])
    modulation = vv.MultipleScales(pend).modulation([0.0, 500.0], initial)
    steps = vv.simulate(pend, 500, initial=initial, tolerance=1e-8, keep="last").stats["steps"]
    assert modulation.steps * 10 < steps


def test_resonances_of_many_frequencies_are_counted():
    """Six modes and six loads: the number given by combinatorics."""

    def vectors(n):
        """Integer vectors of n entries with a sum of moduli of 2 to 4, both signs, +- c once."""
        total = 0
        for k in (2, 3, 4):
            signed = sum(2**j * comb(n, j) * comb(k - 1, j - 1) for j in range(1, k + 1))
            total += (signed - 2 * comb(n + k - 1, k)) // 2
        # 2 e_i - 2 e_j is e_i - e_j.
        return total - comb(n, 2)

    frequencies = np.arange(1, 7) ** 1.03
    system = vv.CubicSystem(
        mass=np.eye(6), stiffness=np.diag(frequencies**2), load=np.eye(6),
        drives=np.linspace(0.7, 3, 6),
    )  # fmt: skip
    found = vv.MultipleScales(system).resonances()
    # Combinations of loads only are not resonances.
    assert len(found) == vectors(12) - vectors(6)
    assert len({r.multiples for r in found}) == len(found)


def test_terms_are_all_there():
    """Six equal oscillators: each pair, and each third conjugate, in each equation."""
    terms = vv.MultipleScales(
        vv.CubicSystem(mass=np.eye(6), stiffness=np.eye(6), cubic=np.ones((6, 6, 6, 6)))
    ).terms
    assert len(terms) == 6 * comb(7, 2) * 6
    assert len({(t.mode, t.factors) for t in terms}) == len(terms)


def test_labels():
    pend = vv.Pendulum(**FREE, f0=0.1, m02=0.1, p1=0.9, p3=1.5)
    labels = {r.label for r in vv.MultipleScales(pend).resonances()}
    assert {"p1 ~ w1", "w1 ~ 2 w2", "p3 ~ w2 + w3", "w3 ~ 3 w2"} <= labels
    assert not any("p2" in label for label in labels)


def flow_of(ms):
    """Modulation equations in the rotating frame, from the list of terms."""

    def rates(a):
        da = (ms.exponents - 1j * ms.frame) * a
        for term in ms.terms:
            value = term.coefficient
            for factor in term.factors:
                if factor.startswith("a"):
                    j = int(factor[1:].rstrip("*")) - 1
                    value = value * (np.conj(a[j]) if factor.endswith("*") else a[j])
            da[term.mode] += value
        return da

    return rates


STEADY = {
    "one load": ({"c1": 0.004, "c2": 0.004, "c3": 0.004, "f0": 0.002, "p1": 1.05}, "p1", 3),
    "three loads": (
        {
            "c1": 0.01, "c2": 0.01, "c3": 0.01,
            "f0": 0.003, "m01": 0.001, "m02": 0.004, "p1": 1.05, "p2": 0.45, "p3": 0.99,
        },
        "p2",
        None,
    ),
    "three modes in internal resonance": (
        {
            "e": 0.002, "w2": 0.5, "w3": 1.0, "alpha": 0.0,
            "c1": 0.01, "c2": 0.01, "c3": 0.01, "m02": 0.005, "p3": 0.99,
        },
        "p3",
        3,
    ),
    "2:1": (
        {"w2": 0.57, "w3": 0.9, "c1": 0.01, "c2": 0.01, "c3": 0.01, "f0": 0.003, "p1": 1.06},
        "p1",
        3,
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", STEADY)
def test_steady_motions_are_all_found(case):
    """Each is a zero of the flow; a search from many starts finds no other."""
    change, parameter, count = STEADY[case]
    pend = vv.Pendulum(**{**FREE, **change})
    ms = vv.MultipleScales(pend, tolerance=0.03)
    assert ms.autonomous
    response = ms.response(parameter, [change[parameter]])
    rates = flow_of(ms)
    found = response.amplitudes / 2
    scale = abs(found).max()
    for a in found:
        assert abs(rates(a)).max() < 1e-10 * scale
    if count is not None:
        assert len(found) == count

    def real(x):
        da = rates(x[:3] + 1j * x[3:])
        return np.concatenate([da.real, da.imag])

    rng = np.random.default_rng(2)
    for _ in range(60):
        start = rng.uniform(-2, 2, 6) * scale
        result = scipy.optimize.root(real, start, tol=1e-14)
        if np.abs(real(result.x)).max() > 1e-12 * scale or np.abs(result.x).max() > 5 * scale:
            continue
        a = result.x[:3] + 1j * result.x[3:]
        assert min(abs(a - b).max() for b in found) < 1e-6 * scale

    # Stability by differences of the same flow.
    for i, a in enumerate(found):
        x = np.concatenate([a.real, a.imag])
        step = 1e-6 * scale
        columns = [(real(x + step * d) - real(x - step * d)) / (2 * step) for d in np.eye(6)]
        roots = np.linalg.eigvals(np.array(columns).T)
        growth = response.eigenvalues[i].real.max()
        np.testing.assert_allclose(growth, roots.real.max(), atol=1e-7)
        signs = response.routh_hurwitz(i)
        assert response.stable[i] == bool((signs > 0).all())


def test_eigenvalues_of_many_modes_in_one():
    """Three equal undamped oscillators under one load: close roots keep their digits."""
    rng = np.random.default_rng(0)
    potential = rng.normal(size=(3,) * 4)
    orders = itertools.permutations(range(4))
    system = vv.CubicSystem(
        mass=np.eye(3), stiffness=np.eye(3), load=[[1e-4], [0], [0]], drives=[1.01],
        cubic=sum(potential.transpose(p) for p in orders) / 24,
    )  # fmt: skip
    ms = vv.MultipleScales(system, tolerance=0.05)
    response = ms.response("p1", [1.01])
    rates = flow_of(ms)
    assert response.index.size > 1
    for a, found in zip(response.amplitudes / 2, response.eigenvalues, strict=True):
        # The flow is of third degree, so two central differences give its derivative exactly.
        columns = []
        for d in [*np.eye(3), *(1j * np.eye(3))]:
            one, two = ((rates(a + h * d) - rates(a - h * d)) / (2 * h) for h in (0.01, 0.02))
            columns.append((4 * one - two) / 3)
        matrix = np.array(columns).T
        roots = np.linalg.eigvals(np.vstack([matrix.real, matrix.imag]))
        apart = [abs(roots - value).min() for value in found]
        assert max(apart) < 1e-12 * abs(roots).max()


def test_routh_table_of_a_known_polynomial():
    """s^4 + 2 s^3 + 3 s^2 + 4 s + 5: column 1, 2, 1, -6, 5, two roots in the right half plane."""
    pend = vv.Pendulum(**FREE, c1=0.005, f0=0.001, p1=1.04)
    response = vv.MultipleScales(pend).response("p1", [1.04])
    roots = np.roots([1, 2, 3, 4, 5])
    known = dataclasses.replace(response, eigenvalues=roots[np.newaxis])
    scale = abs(roots).max() ** np.arange(5)
    np.testing.assert_allclose(known.routh_hurwitz(0) * scale, [1, 2, 1, -6, 5], rtol=1e-12)
    # A zero ends the table: s^3 + s^2 + s + 1.
    ended = dataclasses.replace(response, eigenvalues=np.roots([1, 1, 1, 1])[np.newaxis])
    column = ended.routh_hurwitz(0)
    np.testing.assert_allclose(column[:3], [1, 1, 0], atol=1e-14)
    assert np.isnan(column[3])


def test_unstable_mode_is_reported():
    with pytest.warns(vv.RangeWarning, match="mode 1 is unstable without load"):
        vv.MultipleScales(vv.Pendulum(**FREE, c1=-0.01))


def test_leaving_the_range_is_reported():
    ms = vv.MultipleScales(vv.Pendulum(**FREE), tolerance=0.05)
    with pytest.warns(vv.RangeWarning, match="leaves the range"):
        motion = ms.motion([0.0, 1.0], [0.15, 0, 0.12, 0, 0.1, 0])
    assert not motion.in_range.all()


def test_overdamped_is_refused():
    with pytest.raises(vv.InputError, match="does not oscillate"):
        vv.MultipleScales(vv.Pendulum(**FREE, c1=5.0))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda ms: vv.MultipleScales(vv.Pendulum(e=0.0, w2=0.5, w3=0.5)),
            "w3 = 0.5: must differ from w2 where e = 0",
        ),
        (lambda ms: vv.MultipleScales(3), "system = 3: must be a"),
        (lambda ms: vv.MultipleScales(ms.system, tolerance=1.0), "tolerance = 1: must be in"),
        (lambda ms: ms.response("p7", [1.0]), "parameter = 'p7': must be one of"),
        (lambda ms: ms.response("p1", []), "values: must contain at least one"),
        (lambda ms: ms.response("p1", [-1.0]), "p1 = -1: must be greater than 0"),
        (lambda ms: ms.response("p2", [1.0]), "load 2 has no amplitude"),
        (lambda ms: ms.modulation([1.0, 0.0], np.zeros(6)), "t: must be one or more times"),
        (lambda ms: ms.modulation([1.0]), "initial or amplitudes: give exactly"),
        (lambda ms: ms.modulation([1.0], np.zeros(5)), r"initial: must have shape \(6,\)"),
        (lambda ms: ms.modulation([1.0], np.full(6, 50.0)), "beyond the range"),
        (lambda ms: ms.modulation([1.0], np.zeros(6), accuracy=1), "accuracy = 1: must be in"),
        (lambda ms: ms.resonances(tolerance=2), "tolerance = 2: must be in"),
        (lambda ms: ms.backbone(3, 0.1), "mode = 3: must be 0 to 2"),
        (
            lambda ms: vv.CubicSystem(mass=[[1]], stiffness=[[-1]]),
            "eigenvalue -1, all must be greater than 0",
        ),
        (
            lambda ms: vv.CubicSystem(mass=[[1]], stiffness=[[1]], cubic=[[1]]),
            r"cubic: must have shape",
        ),
    ],
)
def test_bad_input(call, message):
    ms = vv.MultipleScales(vv.Pendulum(**FREE, f0=0.001, p1=1.0))
    with pytest.raises(vv.InputError, match=message):
        call(ms)


def test_pictures(tmp_path):
    import matplotlib

    matplotlib.use("Agg")
    pend = vv.Pendulum(**FREE, c1=0.005, c2=0.005, c3=0.005, f0=0.001, p1=1.04)
    ms = vv.MultipleScales(pend)
    axes = vv.plot_scales_response(ms.response("p1", np.linspace(1.02, 1.06, 41)))
    assert len(axes) == 1
    axes[0].figure.savefig(tmp_path / "response.png")
    initial = [0.01, 0, 0.01, 0, 0.01, 0]
    motion = ms.motion(np.linspace(0, 50, 201), initial)
    axes = vv.plot_modulation(motion, vv.simulate(pend, 50, initial=initial))
    assert len(axes) == 3
    axes[0].figure.savefig(tmp_path / "motion.png")
    with pytest.raises(vv.InputError, match="ax: 1 axes given, must be 3"):
        vv.plot_modulation(motion, ax=axes[0])
    matplotlib.pyplot.close("all")


def test_results_as_tables(tmp_path):
    pend = vv.Pendulum(**FREE, c1=0.005, f0=0.001, p1=1.04)
    ms = vv.MultipleScales(pend)
    response = ms.response("p1", [1.03, 1.04])
    response.to_csv(tmp_path / "steady.csv")
    lines = (tmp_path / "steady.csv").read_text().splitlines()
    rows = [line for line in lines if not line.startswith("#")]
    assert len(rows) == 1 + response.index.size
    assert response.to_dataset().sizes["dof"] == 3
    assert ms.motion([0.0, 1.0], [0.01, 0, 0, 0, 0, 0]).to_dataset().sizes["t"] == 2


def test_example_runs(tmp_path):
    import runpy
    import sys
    from pathlib import Path

    example = Path(__file__).parents[2] / "docs" / "examples" / "multiple_scales.py"
    arguments = sys.argv
    try:
        sys.argv = [str(example), str(tmp_path)]
        with warnings.catch_warnings():
            runpy.run_path(str(example), run_name="__main__")
    finally:
        sys.argv = arguments
    names = {path.stem for path in tmp_path.iterdir()}
    assert names == {"error", "response", "mount", "modulation"}


def test_wide_tolerance():
    """With a wide tolerance no mode is resonant with its own conjugate."""
    pend = vv.Pendulum(e=0.1, w2=1.0863, w3=3.2589, alpha=0.0177, f0=0.002, p1=0.51)
    initial = np.array([0.01, 0, 0.002, 0, 0.002, 0])
    t = np.linspace(0, 20, 41)
    motion = vv.MultipleScales(pend, tolerance=0.2).motion(t, initial)
    exact = vv.simulate(pend, 20, times=t, initial=initial, tolerance=1e-12).state
    assert abs(motion.state - exact)[:, ::2].max() < 1e-4


@pytest.mark.parametrize("load", [1e-5, 1e-9, 1e-12, 1e-30])
def test_tiny_loads_have_their_linear_motion(load):
    """The small root of the cubic equation keeps its digits next to large roots."""
    system = one(stiffness=[[1]], damping=[[0.01]], cubic=[[[[1.0]]]], load=[[load]], drives=[1.04])
    steady = vv.MultipleScales(system, tolerance=0.1).response("p1", [1.04])
    assert steady.index.size == 1
    linear = load / (1 - 1.04**2 + 0.01j * 1.04)
    np.testing.assert_allclose(steady.harmonics[0, 0], linear, rtol=2e-7)


@pytest.mark.parametrize("size", [1e-3, 1e-12, 1e-40])
def test_small_amplitudes_take_the_same_steps(size):
    """No fixed amplitude scale: for linear flows even the steps are equal."""
    system = one(stiffness=[[1]], damping=[[0.01]])
    found = vv.MultipleScales(system).modulation([0.0, 200.0], amplitudes=[size])
    wanted = vv.MultipleScales(system).modulation([0.0, 200.0], amplitudes=[1.0])
    assert found.steps == wanted.steps
    np.testing.assert_allclose(found.amplitude / size, wanted.amplitude, rtol=1e-12)


def test_the_solution_is_a_formula():
    """Each coefficient, with its amplitudes, in the equation of its mode, by its order."""
    duffing = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.02, forces="0.5*x^3")
    scales = vv.MultipleScales(duffing, load=0.01, nu=1.02)
    text = scales._repr_latex_()
    assert text.startswith("$$\\begin{aligned}u_{\\mathrm{x}} &= \\sum")
    # Shift 3 c/(8 w) a^2 for the real amplitude a = 2 |a_1|: 1.5 c/w for the complex one.
    cubic = re.search(r"\+ (\d\.\d+)\\,i\)\\,a_\{1\}\\,a_\{1\}\\,\\bar a_\{1\}", text)
    assert float(cubic[1]) == pytest.approx(0.75, rel=1e-3)
    assert text.count("p_{1}") == 1
    assert text.index("O(a^3)") < min(text.index("p_{1}"), cubic.start())


def test_the_load_of_a_body():
    """`Body.load` returns complex amplitudes; real ones are a load cos(nu t)."""
    foot = vv.MountPoint(
        name="foot", position=(0, 0, 0), stiffness=(100, 150, 210), damping=(1, 1, 1),
        rotational_stiffness=(11, 17, 23),
    )  # fmt: skip
    body = vv.Body(mass=1, inertia=(0.1, 0.2, 0.3), mounts=[foot])
    nu = np.array([9.9, 10.1])
    by_scales = vv.MultipleScales(body, load=body.load(force=(0.1, 0, 0)), nu=10.0).response(
        "nu", nu
    )
    exact = vv.forced_response(body, nu, load=body.load(force=(0.1, 0, 0)))
    assert by_scales.amplitude("x") == pytest.approx(exact.amplitude("x"), rel=1e-3)
    with pytest.raises(vv.InputError, match="load: must be real"):
        vv.MultipleScales(body, load=1j * body.load(force=(0.1, 0, 0)), nu=10.0)
