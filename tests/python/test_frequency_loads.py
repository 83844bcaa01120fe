"""Loads that depend on the frequency: closed forms, SciPy, and constant loads of the same value."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

SYSTEM = vv.PolynomialSystem(
    mass=[1.0, 1.0],
    stiffness=[[2.0, -1.0], [-1.0, 2.0]],
    damping=[0.1, 0.1],
    names=["a", "b"],
    forces={"b": "0.5*b^3"},
)
DATA = Path(__file__).parents[2] / "data" / "unbalance_reference.json"
REFERENCE = {one["name"]: one for one in json.loads(DATA.read_text())}
#: Names of NumPy in formulas.
NUMPY = {name: getattr(np, name) for name in ("sqrt", "exp", "sin", "tan", "tanh", "where")}
UNBALANCED = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="x^3")


def value_of(formula, nu):
    """Return the value of a formula by Python."""
    return eval(formula.replace("^", "**"), {"nu": np.asarray(nu, dtype=float), "pi": np.pi}, NUMPY)


def random_system(rng, kind):
    """Return a system, and the name of one of its coordinates."""
    n = {"mount": 2, "condensed": 8}.get(kind, int(rng.integers(1, 4)))
    springs = rng.uniform(0.5, 2.0, n + 1)
    stiffness = np.diag(springs[:-1] + springs[1:])
    stiffness -= np.diag(springs[1:-1], 1) + np.diag(springs[1:-1], -1)
    kernel = vv.RzhanitsynKernel(amplitude=0.2, alpha=0.4, beta=1.0) if rng.random() < 0.5 else None
    names = [f"x{i + 1}" for i in range(n)]
    mass, cubic = rng.uniform(0.5, 2.0, n), rng.uniform(0.1, 0.5)
    if kind == "mount":
        system = vv.Mount(
            mass=float(mass[0]), inertia=float(mass[1]), offset=0.3, stiffness_x=3.0,
            stiffness_phi=1.0, kernel=kernel, damping=[[0.2, 0], [0, 0.1]], cubic_scale=0.1,
        )  # fmt: skip
        names = list(system.dof_names)
    elif kind in ("structure", "damped structure"):
        element = vv.Spring(on="x1", stiffness=0.3, law=f"{cubic}*d^3", kernel=kernel)
        given = {"modal_damping": 0.05}
        if kind == "damped structure":
            given = {"damping": 0.1 * stiffness + np.diag(rng.uniform(0.01, 0.1, n))}
        system = vv.Structure(mass=np.diag(mass), stiffness=stiffness, elements=[element], **given)
    elif kind in ("body", "turning body"):
        points = [
            vv.MountPoint(
                name=name, position=rng.uniform(-0.3, 0.3, 3), stiffness=rng.uniform(20, 60, 3),
                damping=rng.uniform(0.5, 1.0, 3), law=(f"{100 * cubic}*d^3", None, None),
            )
            for name in "abcd"
        ]  # fmt: skip
        system = vv.Body(
            mass=1, inertia=[0.03, 0.02, 0.04], mounts=points,
            geometry="exact" if kind == "turning body" else "small",
        )  # fmt: skip
        names = list(system.dof_names)
    else:
        system = vv.PolynomialSystem(
            mass=mass, stiffness=stiffness, damping=0.05 * stiffness, kernel=kernel,
            forces={"x1": f"{cubic}*x1^3"}, names=names,
        )  # fmt: skip
    return system, names[int(rng.integers(len(names)))]


KINDS = [
    "mount", "system", "condensed", "structure", "damped structure", "body", "turning body",
]  # fmt: skip


@pytest.mark.parametrize("seed", range(2))
def test_a_rotor_with_an_unbalance_in_closed_form(seed):
    rng = np.random.default_rng(seed)
    m, k, c, me = rng.uniform(0.5, 2, 4) * [1, 9, 0.2, 0.01]
    own = [
        vv.PolynomialSystem(mass=m, stiffness=k, damping=c, names=["x"]),
        vv.Structure(mass=[[m]], stiffness=[[k]], damping=[[c]], names=["x"]),
    ]
    nu = np.sort(rng.uniform(0.5, 8, 7))
    expected = me * nu**2 / (k - m * nu**2 + 1j * c * nu)
    # The amplitude is largest at nu^2 = omega^2/(1 - 2 zeta^2).
    zeta = c / (2 * np.sqrt(k * m))
    top = np.sqrt(k / m / (1 - 2 * zeta**2))
    for system in own:
        load = {1: {"x": f"{me}*nu^2"}}
        response = vv.forced_response(system, nu, load=load)
        np.testing.assert_allclose(response.coefficients[:, 0, 0], expected, rtol=1e-12)
        peak = vv.trace_response(system, (0.2 * top, 3 * top), load=load).peak("x")
        assert peak.nu == pytest.approx(top, rel=1e-7)
        size = me / m / (2 * zeta * np.sqrt(1 - zeta**2))
        assert peak.amplitude == pytest.approx(size, rel=1e-10)


@pytest.mark.parametrize(
    "formula", ["0.02*nu^2", "0.02*nu^2/sqrt(1 + nu)*exp(1j*0.4*nu)", "0.01 + 0.02j*nu^3"]
)
def test_motions_of_a_branch_repeat_in_scipy(formula):
    branch = vv.trace_response(UNBALANCED, (0.4, 2.0), load=formula)
    for i in range(0, branch.nu.size, 12):
        nu, z = float(branch.nu[i]), branch.coefficients[i, 0]
        p = complex(value_of(formula, nu))
        start = [z.imag.sum(), nu * (branch.harmonics * z.real).sum()]
        end = solve_ivp(
            lambda t, y, nu=nu, p=p: [
                y[1], (p * np.exp(1j * nu * t)).imag - 0.05 * y[1] - y[0] - y[0] ** 3
            ],
            (0, 2 * np.pi / nu), start, method="DOP853", rtol=1e-12, atol=1e-14,
        ).y[:, -1]  # fmt: skip
        np.testing.assert_allclose(end, start, rtol=0, atol=1e-9)


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
def test_folds_of_a_branch_with_unbalance():
    """Both folds and the largest x at them agree with another program (data/README.md)."""
    values = REFERENCE["unbalance_duffing"]["value"]
    folds = [one["nu"] for one in values]
    branch = vv.trace_response(UNBALANCED, (0.3, 2.0), load="0.02*nu^2", stability=True)
    np.testing.assert_allclose(branch.folds, folds, rtol=1e-10)
    places = [np.abs(branch.nu - nu).argmin() for nu in folds]
    np.testing.assert_array_equal(branch.stable[[0, sum(places) // 2, -1]], [True, False, True])
    angle = np.linspace(0, 2 * np.pi, 20001)
    waves = np.exp(1j * np.outer(branch.harmonics, angle))
    largest = (branch.fold_coefficients[:, 0] @ waves).imag.max(axis=1)
    np.testing.assert_allclose(largest, [one["max_x"] for one in values], rtol=1e-7)
    motions = vv.trace_motion(UNBALANCED, (0.7, 1.3), load="0.02*nu^2")
    np.testing.assert_allclose(motions.folds, folds, rtol=1e-7)


def test_response_of_a_gyroscopic_rotor_to_an_unbalance():
    """The rotor of data/unbalance_reference.json, z = x + i y: at each speed a matrix of rates."""
    inertia, polar, unbalance = 0.02, 0.035, 1e-3
    mass = [1, 1, inertia, inertia]
    stiffness = np.kron([[400, -30], [-30, 6]], np.eye(2))
    damping = np.diag([1, 1, 0.01, 0.01]).astype(float)
    turn = np.zeros((4, 4))
    turn[2, 3], turn[3, 2] = polar, -polar
    expected = REFERENCE["gyroscopic_overhung_rotor"]["value"]["response"]
    load = {1: {"x": f"1j*{unbalance}*nu^2", "y": f"{unbalance}*nu^2"}}
    for name, one in expected.items():
        nu = float(name.removeprefix("nu="))
        system = vv.PolynomialSystem(
            mass=mass, stiffness=stiffness, damping=damping + nu * turn, names=["x", "y", "a", "b"]
        )
        found = vv.forced_response(system, [nu], load=load).coefficients[0, :, 0]
        # x = Re Z exp(i nu t) and y = Im Z exp(i nu t).
        z, theta = found[1], found[3]
        np.testing.assert_allclose(found[[0, 2]], 1j * found[[1, 3]], rtol=1e-10)
        np.testing.assert_allclose(
            [abs(z), np.angle(z), abs(theta), np.angle(theta)],
            [one["abs_z"], one["phase_z"], one["abs_theta"], one["phase_theta"]], rtol=1e-12,
        )  # fmt: skip


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.parametrize("kind", KINDS)
def test_the_derivative_by_the_frequency_is_exact(kind):
    """A wrong derivative would take more corrections than one under a constant load."""
    rng = np.random.default_rng(KINDS.index(kind))
    system, name = random_system(rng, kind)
    steep, flat = (
        vv.trace_response(system, (0.8, 1.2), load={1: {name: p}}, harmonics=5, stability=False)
        for p in ("0.1*nu^2*exp(3*nu - 3)", 0.1)
    )
    assert steep.iterations.mean() < flat.iterations.mean() + 0.7


def test_runs_of_an_ensemble_have_the_load_of_their_frequency():
    nu = np.array([0.6, 0.9, 1.4])
    formula = "0.3*nu^2*exp(0.5j*nu)"
    found = vv.simulate_ensemble(
        SYSTEM, initial=np.zeros((3, 4)), t_end=20, load={"b": formula}, parameters={"nu": nu}
    )
    for i, one in enumerate(nu):
        run = vv.simulate(SYSTEM, 20, load={"b": formula}, nu=one, keep="last")
        np.testing.assert_allclose(found.state[i], run.state[-1], rtol=0, atol=1e-9)


def test_periodic_motions_by_shooting_have_the_load_of_their_frequency():
    formula = "0.1*nu^2/(1 + 0.2*nu)"
    motion = vv.steady_motion(SYSTEM, nu=1.3, load={"a": formula})
    other = vv.steady_motion(SYSTEM, nu=1.3, load={"a": float(value_of(formula, 1.3))})
    np.testing.assert_allclose(motion.state, other.state, rtol=0, atol=1e-10)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("nu*y", "'y' is neither a variable (nu) nor a parameter"),
        ("nu*nux", "did you mean nu?"),
        ("nu/0", "divides by 0"),
        ("nu(", "'nu' is not a known function"),
        ("nu*(", "expected"),
        ("__import__('nu')", "is not a known function"),
        ("nu + 9^9^9^9", "divides by 0, or takes a function outside its domain"),
        ("sqrt(1j*nu)", "complex numbers may be in"),
        ("(1j*nu)^nu", "complex numbers may be in"),
        ("nu < 1j", "complex numbers may be in"),
    ],
)
def test_a_wrong_formula_is_named(text, fault):
    with pytest.raises(vv.InputError, match=r"load\['a'\] = ") as error:
        vv.forced_response(SYSTEM, [1.0], load={"a": text})
    assert fault in str(error.value)


ANALYSES = {
    "forced_response": lambda load: vv.forced_response(SYSTEM, [0.5, 1.0], load=load),
    "trace_response": lambda load: vv.trace_response(SYSTEM, (0.4, 1.7), load=load),
    "simulate": lambda load: vv.simulate(SYSTEM, 5, load=load, nu=1.0),
    "steady_motion": lambda load: vv.steady_motion(SYSTEM, nu=1.0, load=load),
    "trace_motion": lambda load: vv.trace_motion(SYSTEM, (0.4, 1.7), load=load),
    "ensemble": lambda load: vv.simulate_ensemble(
        SYSTEM, initial=np.zeros((2, 4)), t_end=5, load=load, parameters={"nu": [0.5, 1.0]}
    ),
}


@pytest.mark.parametrize("analysis", ANALYSES)
@pytest.mark.parametrize("text", ["0.1/(nu - 1)", "0.1*log(nu - 1)", "sqrt(0.9 - nu)"])
def test_a_load_without_a_finite_value_is_named(analysis, text):
    with pytest.raises(vv.InputError, match="has no finite value at nu = ") as error:
        ANALYSES[analysis]({"a": text})
    assert re.sub(r"^0.1\*|^0.1", "", text).replace(" ", "") in str(error.value).replace(" ", "")


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.parametrize(
    "formula",
    [
        "1/(nu - 0.3)",
        "0.1 + sqrt(nu - 0.4)",
        "sqrt(nu^2 - 2*nu + 1.000001)",
        "where(nu < 1, nu, 2 - nu)",
        "abs(nu - 1)^1.5",
        "sin(nu)/nu",
        "tan(0.9*nu)",
        "where(abs(nu - 1) > 0.1, 1/(nu - 1), 0)",
    ],
)
def test_a_load_that_is_finite_is_not_refused(formula):
    """The response is linear, so its harmonic is the load times the receptance."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.4)
    branch = vv.trace_response(system, (0.4, 1.7), load=formula)
    expected = value_of(formula, branch.nu)
    own = branch.coefficients[:, 0, 0] * (1 - branch.nu**2 + 0.4j * branch.nu)
    np.testing.assert_allclose(own, expected, rtol=1e-8, atol=1e-8)


def test_a_mean_is_constant():
    with pytest.raises(vv.InputError, match="a mean must not depend on nu"):
        vv.forced_response(SYSTEM, [1.0], load={0: "nu^2"})
