"""The standalone driver: ensembles, against SciPy; names in error messages."""

import numpy as np
import pytest
import viscovib as vv
from driver import changed, check_refused, read_csv
from referee.integration import solve_ivp

SYSTEM = """&system coordinates='x' mass=1 stiffness=-1 damping=0.3 /
&force on='x' law='x^3' /
&load on='x' amplitude=1 /
"""
MANY = (
    SYSTEM
    + """&ensemble vary='load_scale' from=0.2 to=0.3 count=9 nu=1.2 initial=0.1 0.2
  sections=1 n_periods=4 discard=2 tolerance=1e-9 /
"""
)
STATES = ("z", "z_dot", "phi", "phi_dot", "psi", "psi_dot")


def _run(solve, folder, text):
    scene = folder / "many.nml"
    scene.write_text(text)
    done = solve(scene, "--out", folder)
    assert done.returncode == 0, done.stderr
    return read_csv(folder / "many_ensemble.csv")


def test_every_number_of_a_pendulum_varies(solve, tmp_path):
    """Rows for each number against the Python ensemble with the same name."""
    rng = np.random.default_rng(6)
    given = {
        "e": 0.1, "w2": 0.4, "w3": 0.8, "alpha": 0.5, "c1": 0.01, "c2": 0.02, "c3": 0.03,
        "f0": 0.002, "m01": 0.001, "m02": 0.003, "p1": 1.02, "p2": 0.5, "p3": 0.9,
    }  # fmt: skip
    text = "&pendulum " + " ".join(f"{key}={value!r}" for key, value in given.items()) + " /\n"
    for name, value in given.items():
        values = np.linspace(value, value * rng.uniform(1.1, 1.3), 3).tolist()
        group = (
            f"&ensemble vary='{name}' from={values[0]!r} to={values[-1]!r} count=3\n"
            "  initial=0.1 0 0.2 0 0.1 0.05 t_end=4 dt=0.02 /\n"
        )
        table = _run(solve, tmp_path, text + group)
        np.testing.assert_allclose(table[name], values, rtol=1e-15)
        many = vv.simulate_ensemble(
            vv.Pendulum(**given), t_end=4, dt=0.02, initial=[0.1, 0, 0.2, 0, 0.1, 0.05],
            parameters={name: table[name]},
        )  # fmt: skip
        found = np.column_stack([table[column] for column in STATES])
        np.testing.assert_allclose(found, many.state, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("law", "accuracy"), [("0.4*x^3", "dt=0.05"), ("5*max(x - 0.2, 0)", "rtol=1e-7 atol=1e-9")]
)
def test_statistics_and_amplitudes(solve, tmp_path, law, accuracy):
    """All columns against Python, side by side and one after another."""
    text = (
        "&system coordinates='y' 'x' mass=1 2 damping=0.2 0.2 stiffness=2 -1 -1 2 /\n"
        f"&force on='x' law='{law}' /\n&load on='x' amplitude=0.4 /\n"
        "&ensemble vary='nu' from=0.8 to=1.6 count=3 initial=0 0 0 0 t_end=30 discard=7\n"
        f"  {accuracy} amplitudes_at=0.7 1.3 sample_every=3 /\n"
    )
    table = _run(solve, tmp_path, text)
    system = vv.PolynomialSystem(
        names=["y", "x"], mass=[1, 2], damping=[0.2, 0.2], forces={"x": law},
        stiffness=[[2, -1], [-1, 2]],
    )  # fmt: skip
    given = {name: float(value) for name, value in (one.split("=") for one in accuracy.split())}
    many = vv.simulate_ensemble(
        system, initial=np.zeros(4), t_end=30, discard=7, parameters={"nu": table["nu"]},
        load={"x": 0.4}, statistics=True, amplitudes_at=[0.7, 1.3], sample_every=3, **given,
    )  # fmt: skip
    for j, name in enumerate(system.dof_names):
        for kind in ("peak", "mean", "rms"):
            found = table[f"{kind}_{name}"]
            np.testing.assert_allclose(found, getattr(many, kind)[:, 2 * j], rtol=1e-12)
        for k in range(2):
            found = table[f"{name}_{k + 1}_re"] + 1j * table[f"{name}_{k + 1}_im"]
            np.testing.assert_allclose(found, many.amplitudes[:, k, j], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"vary='load_scale'": "vary='mass'"}, "must be one of 'nu'"),
        ({"vary='load_scale' ": ""}, "vary"),
        ({"count=9": "count=0"}, "must be 1 to"),
        ({"sections=1": "sections=2"}, "must be 0 to 1"),
        ({"n_periods=4": "t_end=4"}, "n_periods"),
        ({"tolerance=1e-9": "tolerance=1e-9 rtol=1e-6"}, "must not be given with rtol"),
        ({"tolerance=1e-9": "sample_every=0"}, "must be 1 to"),
        ({"tolerance=1e-9": "amplitudes_at=-1"}, "must be greater than 0"),
        ({"tolerance=1e-9": "amplitudes_at=90"}, "resolve no frequency of"),
        ({"discard=2": "discard=4"}, "less than the run"),
        ({"nu=1.2": ""}, "nu"),
        ({"vary='load_scale' from=0.2": "vary='nu' from=0.2"}, "the frequency is what varies"),
        ({"tolerance=1e-9": "tolerance=1e-20"}, "tolerance"),
        ({"initial=0.1 0.2": "initial=0.1"}, "initial"),
        ({"tolerance": "lyapunov='maybe' tolerance"}, "lyapunov"),
        ({"tolerance": "method='taylor20' lyapunov='yes' tolerance"}, "no Lyapunov exponents"),
        ({"x^3": "2^x", "tolerance": "method='taylor20' tolerance"}, "power series"),
    ],
)
def test_what_is_wrong_is_named(solve, tmp_path, changes, text):
    """One line with file and line."""
    check_refused(solve, tmp_path, changed(MANY, changes), text)


@pytest.mark.parametrize(
    ("line", "group"),
    [(2, "sections=1 n_periods=3 dt=16 /"), (3, "t_end=10\ndt=1e-12 /"), (2, "t_end=1e12 /")],
)
def test_what_cannot_be_computed_is_reported_with_its_line(solve, tmp_path, line, group):
    scene = tmp_path / "long.nml"
    scene.write_text(
        "&system coordinates='x', mass=1, stiffness=-1 / &force on='x' law='x^3' / "
        "&load on='x' amplitude=1 /\n"
        f"&ensemble vary='load_scale' from=0.2 to=0.3 count=2 nu=1.2 initial=0.1 0.2 {group}\n"
    )
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 2
    assert f"long.nml:{line}: " in done.stderr, done.stderr
    with pytest.raises(vv.InputError) as reported:
        vv.run(scene)
    assert done.stderr == f"viscovib-solve: {reported.value}\n"


NUMBERS = "&parameters k3=0.7 mu=0.2 n=2 /"
LAWS = f"""&system coordinates='x' mass=1 stiffness=0.5 damping=0.3 /
{NUMBERS}
&force on='x' law='k3*x^3 + 0.1*x^2' /
&force on='x' law='mu*tanh(5*x_dot)*(1 + 0.1*x^n)' /
&load on='x' amplitude=0.3 /
"""


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"vary='k3'": "vary='k4'"}, "'forces_scale', 'k3', 'mu', 'n'"),
        ({"k3": "nu"}, "is also one of the &parameters"),
    ],
)
def test_a_parameter_that_cannot_vary(solve, tmp_path, changes, text):
    """One line with the reason."""
    ensemble = "&ensemble vary='k3' from=0 to=2 count=4 nu=1.2 initial=0.4 0.2 t_end=9 /\n"
    check_refused(solve, tmp_path, changed(LAWS + ensemble, changes), text)


@pytest.mark.parametrize(
    "vary", ["nu", "load_scale", "k3", "stiffness_scale", "damping_scale", "forces_scale"]
)
def test_ensembles_of_structures_are_those_of_python(solve, tmp_path, vary):
    """All numbers of a structure whose element has a linear and a cubic part."""
    values = np.linspace(0.8, 1.3, 5)
    given = {} if vary == "nu" else {"nu": 1.1}
    text = f"""&structure mass=1 1 stiffness=2 -1 -1 2 damping=0.1 0.1 /
&element on='x1' law='0.3*d + k3*d^3' /
&parameters k3=0.5 /
&load on='x1' amplitude=0.3 /
&ensemble vary='{vary}' from=0.8 to=1.3 count=5 initial=0.2 0 0.1 0 t_end=20
  {"" if vary == "nu" else "nu=1.1"} /
"""
    table = _run(solve, tmp_path, text)
    spring = vv.Spring(on="x1", law="0.3*d + k3*d^3", parameters={"k3": 0.5})
    structure = vv.Structure(
        mass=[1, 1], stiffness=[[2, -1], [-1, 2]], damping=[0.1, 0.1], elements=[spring]
    )
    name = "elements[0].k3" if vary == "k3" else vary
    many = vv.simulate_ensemble(
        structure, t_end=20, initial=[0.2, 0, 0.1, 0], load={1: {"x1": 0.3}},
        parameters={name: values}, **given,
    )  # fmt: skip
    np.testing.assert_allclose(table["x1"], many.state[:, 0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(table["x2_dot"], many.state[:, 3], rtol=0, atol=1e-9)


PRONY = "&kernel weights=0.2 rates=1 kind='prony' /\n&parameters k3=0.6 /\n"
CORNER = "law='8*k3*max({} - 0.1, 0)' /\n&parameters k3=0.6 /\n"
TWO = "&structure mass=1 1 stiffness=2 -1 -1 2 damping=0.1 0.1 /\n"
#: Motions that are computed one after another.
ALONE = {
    "memory": "&system coordinates='x' mass=1 stiffness=1 damping=0.1 kernel=1 /\n"
    f"&force on='x' law='k3*x^3' /\n{PRONY}",
    "corner": "&system coordinates='x' mass=1 stiffness=1 damping=0.1 /\n&force on='x' "
    + CORNER.format("x"),
    "memory of an element": f"{TWO}&element on='x1' stiffness=0.5 law='k3*d^3' kernel=1 /\n{PRONY}",
}


@pytest.mark.parametrize(
    ("which", "changes", "text"),
    [
        ("memory", {"lyapunov='no'": "method='verner9'"}, "one after another, must be one of"),
        ("corner", {"lyapunov='no'": "method='taylor8'"}, "one after another, must be one of"),
        ("memory", {"vary='nu'": "vary='stiffness_scale' nu=1"}, "must be one of 'nu'"),
        ("memory", {"initial=0 0": "initial=0 0 0"}, "initial has 3 values: must be 2"),
        ("memory", {"count=3": "count=-3"}, "count = -3: must be 1 to"),
        ("memory", {"count=3": "cout=3"}, "unknown key 'cout' in &ensemble; did you mean 'count'?"),
        ("memory of an element", {"0.1 0.1 /": "0.1 0.1 loss_factor=0.1 /"}, "loss_factor"),
        ("corner", {"amplitude=0.3": "shape='half_sine' kind='force' duration=2"}, "transient"),
    ],
)  # fmt: skip
def test_what_is_wrong_one_after_another(solve, tmp_path, which, changes, text):
    """One line with file and line, at most one remedy."""
    names, start = ("x1", "0 0 0 0") if "element" in which else ("x", "0 0")
    scene = (
        f"{ALONE[which]}&load on='{names}' amplitude=0.3 /\n&ensemble vary='nu' from=1 to=2 "
        f"count=3 initial={start} t_end=20 lyapunov='no' /\n"
    )
    check_refused(solve, tmp_path, changed(scene, changes), text)


def test_a_slider_is_part_of_the_state(solve, tmp_path):
    """Hysteresis elements are computed one after another, with their states."""
    table = _run(
        solve, tmp_path,
        "&structure coordinates='x1' mass=1 stiffness=1 /\n"
        "&element on='x1' hysteresis='jenkins' hysteresis_numbers=2 0.05 /\n"
        "&load amplitude=0.2 /\n"
        "&ensemble vary='nu' from=1 to=1.2 count=3 initial=1 0 t_end=20 /\n",
    )  # fmt: skip
    for nu, x in zip(table["nu"], table["x1"], strict=True):

        def rates(t, y, nu=nu):
            slips = abs(y[2]) >= 0.05 and y[1] * y[2] > 0
            force = np.clip(y[2], -0.05, 0.05)
            return [y[1], 0.2 * np.sin(nu * t) - y[0] - force, 0.0 if slips else 2 * y[1]]

        # Steps are short, because the slider switches inside them.
        run = solve_ivp(rates, (0, 20), [1, 0, 0.05], max_step=2e-3)
        assert x == pytest.approx(run.y[0, -1], abs=2e-3)


def test_amplitudes_of_a_linear_spring(solve, tmp_path):
    """The steady amplitude in closed form; a motion that diverges has none."""
    text = (
        "&system coordinates='x' mass=1 stiffness=4 damping=0.8 /\n&load on='x' amplitude=1 /\n"
        "&ensemble vary='nu' from=1 to=1.2 count=2 initial=0 0 t_end=250 discard=60\n"
        "  amplitudes_at=1 /\n"
    )
    table = _run(solve, tmp_path, text)
    assert np.hypot(table["x_1_re"][0], table["x_1_im"][0]) == pytest.approx(
        1 / abs(3 + 0.8j), rel=1e-6
    )
    away = text.replace("&load", "&force on='x' law='-5*x^3' /\n&load").replace("0 0 t", "3 0 t")
    scene = tmp_path / "many.nml"
    scene.write_text(away)
    assert solve(scene, "--out", tmp_path).returncode == 1
    table = read_csv(tmp_path / "many_ensemble.csv")
    assert set(table["outcome"]) == {"diverged"}
    assert np.isnan([table[name][0] for name in ("peak_x", "mean_x", "x_1_re", "x_1_im")]).all()
