"""The standalone driver: numbers of laws by name."""

import numpy as np
import pytest
import viscovib as vv
from driver import check_refused, read_csv

SYSTEM = """&parameters k3 = 0.3, f0 = 2e-2, soft = 0.05 /
&system coordinates = 'x', mass = 1, stiffness = 1, damping = 0.02 /
&force law = '1e0*k3*x^3' /
&force law = 'F0*tanh( x_dot/soft )' /
&load amplitude = 0.02 /
&response nu = 0.7 0.9 1.4, harmonics = 15, tolerance = 1e-6, method = 'newton' /
"""
STRUCTURE = """&parameters k3 = 0.3, gap = 0.1 /
&structure mass = 1 1, stiffness = 2 -1 -1 2, damping = 0.02 0.02, size = 2 /
&element on = 'x1', law = 'k3*d^3' /
&element on = 'x1' 'x2', law = 'k3*max(d - gap, 0)' /
&load on = 'x1', amplitude = 0.1 /
&response nu = 0.7 0.9, harmonics = 9, tolerance = 1e-3, method = 'newton' /
"""
BODY = """&parameters k3 = 3e7, k5 = 1e9 /
&body mass = 10, inertia = 0.3 0.2 0.4 /
&mount_point name = 'a', position = 0.1 0.2 0, stiffness = 1e4 1e4 2e4, law_z = 'k3*d^3' /
&mount_point name = 'b', position = -0.1 0.1 0, stiffness = 1e4 1e4 2e4, law_x = 'k3*d^3 + k5*d^5' /
&mount_point name = 'c', position = 0 -0.2 0.1, stiffness = 1e4 1e4 2e4, damping = 9 9 9 /
&load on = 'z', amplitude = 5 /
&response nu = 30 50, harmonics = 5, tolerance = 1e-3, method = 'newton' /
"""
NUMBERS = {"k3": "0.3", "f0": "2e-2", "F0": "2e-2", "soft": "0.05", "gap": "0.1"}
STIFF = {"k3": "3e7", "k5": "1e9"}


def table(path):
    """Rows without the line with the name of the scene."""
    return path.read_text().splitlines()[1:]


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.parametrize(
    ("text", "numbers"), [(SYSTEM, NUMBERS), (STRUCTURE, NUMBERS), (BODY, STIFF)]
)
def test_names_stand_for_their_numbers(solve, tmp_path, text, numbers):
    named, plain = tmp_path / "named.nml", tmp_path / "plain.nml"
    named.write_text(text)
    lines = text.splitlines()[1:]
    for name, number in numbers.items():
        lines = [line.replace(name, number) for line in lines]
    plain.write_text("\n".join(lines) + "\n")
    for scene in (named, plain):
        done = solve(scene, "--out", tmp_path)
        assert done.returncode in (0, 1), done.stderr
    own = table(tmp_path / "named_response.csv")
    assert own == table(tmp_path / "plain_response.csv")
    vv.run(named).to_csv(tmp_path / "python.csv")
    # The debug driver may round differently.
    found, expected = (read_csv(tmp_path / f"{name}.csv") for name in ("python", "named_response"))
    columns = [name for name in found.dtype.names if name.endswith(("_re", "_im"))]
    assert len(columns) > 4
    for column in columns:
        assert found[column] == pytest.approx(expected[column], rel=1e-9, abs=1e-15)


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
def test_python_has_the_names(tmp_path):
    scene = tmp_path / "a.nml"
    scene.write_text(SYSTEM)
    read = vv.Scene.read(scene)
    assert read.polynomial_system().parameters == {"k3": 0.3, "f0": 0.02, "soft": 0.05}
    other = read.override({"parameters.k3": 0.6})
    assert other.polynomial_system().parameters["k3"] == 0.6
    scene.write_text(STRUCTURE)
    first, second = vv.Scene.read(scene).structure().elements
    assert first.parameters == {"k3": 0.3}
    assert second.parameters == {"k3": 0.3, "gap": 0.1}
    scene.write_text(BODY)
    body, same = vv.Scene.read(scene).body(), tmp_path / "same.nml"
    same.write_text(BODY.split("\n", 1)[1].replace("k3", "3e7").replace("k5", "1e9"))
    load, nu = [0, 0, 5, 0, 0, 0], [30.0, 50.0]
    found, expected = (
        vv.forced_response(one, nu, load=load, harmonics=5).coefficients
        for one in (body, vv.Scene.read(same).body())
    )
    assert found == pytest.approx(expected, rel=1e-12, abs=1e-18)


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
def test_sweeps_change_them(tmp_path):
    scene = tmp_path / "a.nml"
    scene.write_text(SYSTEM + "&sweep key = 'parameters.k3', values = 0 0.3 0.6 /\n")
    swept = vv.sweep(vv.Scene.read(scene))
    direct = []
    for k3 in (0.0, 0.3, 0.6):
        scene.write_text(SYSTEM.replace("k3 = 0.3", f"k3 = {k3}"))
        direct.append(vv.run(scene).response.coefficients)
    assert np.abs(swept["coefficients"].values - direct).max() < 1e-14


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("1e0*k3*x^3", "1e0*x^3", "bad.nml:1: k3: is in no law"),
        ("k3 = 0.3", "k4 = 0.3", "law = '1e0*k3*x^3': 'k3' is neither a variable nor a parameter "),
        ("k3 = 0.3", "k4 = 0.3", "bad.nml:3: "),
        ("x_dot/soft", "x_dot/sotf", "law = 'F0*tanh( x_dot/sotf )': 'sotf' is neither a variable"),
        ("x_dot/soft", "x_dot/sotf", "(did you mean soft?)"),
        ("k3*x^3", "k3*x^3 +", "law = '1e0*k3*x^3 +': "),
        ("soft = 0.05", "soft = 0.05, tanh = 1", "tanh: is a name that laws have already"),
        ("soft = 0.05", "soft = 0.05, x = 1", "x: is the name of a coordinate"),
        ("soft = 0.05", "soft = 0.05, x_dot = 1", "x_dot: is the name of a coordinate"),
        ("soft = 0.05", "soft = 'a'", "soft = a: must be a number"),
        ("soft = 0.05", "soft = 0", "law = 'F0*tanh( x_dot/soft )': it divides by 0"),
        ("k3*x", "k3(x)*x", "law = '1e0*k3(x)*x^3': 'k3' is not a known function"),
        ("&load", "&parameters e = 1 /\n&load", "a second &parameters"),
    ],
)
def test_what_is_refused(solve, tmp_path, old, new, text):
    check_refused(solve, tmp_path, SYSTEM.replace(old, new, 1), text)


@pytest.mark.parametrize(
    ("text", "old", "new", "reported"),
    [
        (STRUCTURE, "gap, 0", "gpa, 0", "(did you mean gap?)"),
        (STRUCTURE, "'k3*d^3'", "'k3*d^3/0'", "law = 'k3*d^3/0': it divides by 0"),
        (BODY, "'k3*d^3'", "'k2*d^3'", "law_z = 'k2*d^3': 'k2' is neither a variable nor a "),
        (BODY, "'k3*d^3'", "'k3*log(d)'", "law_z = 'k3*log(d)': must have a value at d = 0"),
    ],
)
def test_laws_are_reported_as_they_were_written(solve, tmp_path, text, old, new, reported):
    check_refused(solve, tmp_path, text.replace(old, new, 1), reported)


def test_a_mount_has_no_laws(solve, tmp_path):
    scene = (
        "&parameters a = 1 /\n&mount mass=1, inertia=0.1, offset=0.5, stiffness_x=10, "
        "stiffness_phi=2 /\n&load amplitude=0.1 /\n&response nu=1 /\n"
    )
    check_refused(solve, tmp_path, scene, "&parameters: needs &system, &structure or &body")


@pytest.mark.parametrize(
    "rest",
    [
        "&system coordinates = 'x', mass = 1 / &spring stiffness = 2, kernel = 1 /\n"
        "&force law = 'c*tanh(x_dot)', kernel = 1 /\n",
        "&structure size = 1, mass = 1, stiffness = 0, coordinates = 'x' /\n"
        "&element on = 'x', stiffness = 2, law = 'c*tanh(v)', kernel = 1 /\n",
    ],
)
def test_linear_response_holds_rates_behind_kernels(solve, tmp_path, rest):
    """(1 - R) (k + i nu c) is in the dynamic stiffness, as in Python."""
    kernel = "&kernel kind = 'prony', weights = 0.4, rates = 1.3 /\n"
    load = "&load amplitude = 0.1 /\n&response nu = 0.5 1.3 2, method = 'linear' /\n"
    scene = tmp_path / "a.nml"
    scene.write_text(f"&parameters c = 0.3 /\n{kernel}{rest}{load}")
    assert solve(scene, "--out", tmp_path).returncode == 0
    rows = read_csv(tmp_path / "a_response.csv")
    s = 1j * np.array([0.5, 1.3, 2])
    found = rows["x_1_re"] + 1j * rows["x_1_im"]
    stiffness = (2 + 0.3 * s) * (1 - 0.4 / (1.3 + s)) + s**2
    assert found == pytest.approx(0.1 / stiffness, rel=1e-12)
