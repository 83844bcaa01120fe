"""The standalone driver: polynomial systems."""

import numpy as np
import pytest
import viscovib as vv
from driver import read_csv


def test_a_table_of_points_runs_directly(solve, tmp_path):
    scene = tmp_path / "table.nml"
    scene.write_text(
        "&mount mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2 /\n"
        "&kernel kind='tabulated', times=0 1 4, values=0.2 0.1 0 /\n"
        "&transient initial=0.1 0 0 0, t_end=3, dt=0.1 /\n"
    )
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "the whole past" in solve(scene, "--plan").stdout
    scene.write_text(scene.read_text().replace("dt=0.1", "dt=0.1, memory='exponentials'"))
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 2
    assert "not a sum of exponentials" in done.stderr


def test_campbell_diagram_without_instability(solve, tmp_path):
    """A frequency w is the speed where 4 - w^2 = 0.5 w^2 or -0.5 w^2."""
    scene = tmp_path / "disc.nml"
    scene.write_text(
        "&system coordinates='a' 'b' mass=1 0 0 1 stiffness=4 0 0 4 gyroscopic=0 0.5 -0.5 0 /\n"
        "&campbell speed_from=0 speed_to=5 speed_count=11 /\n"
    )
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "disc_campbell.csv").read_text()
    assert "no eigenvalue has a positive real part" in text
    line = next(line for line in text.splitlines() if "critical speeds (" in line)
    found = [float(word) for word in line.split(":")[-1].split()]
    np.testing.assert_allclose(found, [np.sqrt(4 / 1.5), np.sqrt(4 / 0.5)], rtol=1e-12)


def test_a_system_of_ones_own(solve, tmp_path):
    """Every group of a system, read by the driver and by Python."""
    scene = tmp_path / "own.nml"
    scene.write_text(
        "&system coordinates='a', 'b', units='m', 'rad', mass=1, 0.1, 0.1, 0.5,\n"
        "  stiffness=2, -1, -1, 1.5, damping=0.1, 0.05, base_direction=1, 0 /\n"
        "&kernel kind='prony', weights=0.1, rates=0.4 /\n"
        "&spring stiffness=0.5, 0, kernel=0 /\n"
        "&force on='a', coefficient=0.4, powers=2, 1 /\n"
        "&force on='b', coefficient=0.3, powers=0, 3, kernel=0 /\n"
        "&load on='b', amplitude=0.1, phase=0.3 /\n&load order=0, amplitude=0.05 /\n"
        "&load kind='base', order=2, amplitude=0.02 /\n"
        "&response method='newton', nu_from=0.3, nu_to=2.5, nu_count=30 /\n"
    )
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "X_k of b (rad)" in (tmp_path / "own_response.csv").read_text()
    table = read_csv(tmp_path / "own_response.csv")
    system = vv.PolynomialSystem(
        mass=[[1, 0.1], [0.1, 0.5]],
        stiffness=[[2, -1], [-1, 1.5]],
        damping=[0.1, 0.05],
        kernel=vv.PronyKernel(weights=[0.1], rates=[0.4]),
        forces={"a": "0.4*a^2*b"},
        springs=[vv.Springs(stiffness=[0.5, 0], forces={"b": "0.3*b^3"})],
        names=("a", "b"),
        base_direction=[1, 0],
    )
    load = {0: [0.05j, 0], 1: [0, 0.1 * np.exp(0.3j)]}
    r = vv.forced_response(system, table["nu"], load=load, base={2: 0.02}, method="newton")
    read = vv.run(scene).response
    assert read.dof_units == ("m", "rad")
    assert read.coefficients == pytest.approx(r.coefficients, abs=1e-15)
    for d, dof in enumerate("ab"):
        for j, k in enumerate(r.harmonics):
            found = table[f"{dof}_{k}_re"] + 1j * table[f"{dof}_{k}_im"]
            assert found == pytest.approx(r.coefficients[:, d, j], abs=1e-12)


def test_motion_of_a_system_of_ones_own(solve, tmp_path):
    scene = tmp_path / "own.nml"
    scene.write_text(
        "&system coordinates='a', 'b', units='m', 'rad', mass=1, 0.5, stiffness=2, -1, -1, 1.5,\n"
        "  damping=0.1, 0.05 /\n&force on='a', coefficient=0.4, powers=2, 1 /\n"
        "&load on='b', amplitude=0.1, phase=0.3 /\n&load order=0, amplitude=0.05 /\n"
        "&transient initial=0.3, 0, -0.2, 0.1, t_end=30, dt=0.25, nu=1.3 /\n&spectrum /\n"
    )
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    table = read_csv(tmp_path / "own_transient.csv")
    assert table.dtype.names == ("t", "a", "a_dot", "b", "b_dot")
    assert "# units: t in s, a in m, b in rad" in (tmp_path / "own_transient.csv").read_text()
    system = vv.PolynomialSystem(
        mass=[1, 0.5], stiffness=[[2, -1], [-1, 1.5]], damping=[0.1, 0.05],
        forces={"a": "0.4*a^2*b"}, names=("a", "b"),
    )  # fmt: skip
    load = {0: [0.05j, 0], 1: [0, 0.1 * np.exp(0.3j)]}
    run = vv.simulate(system, 30, dt=0.25, initial=[0.3, 0, -0.2, 0.1], load=load, nu=1.3)
    read = vv.run(scene)
    assert read.trajectory.state == pytest.approx(run.state, abs=1e-14)
    assert read.spectrum.names == ("a", "b")
    assert table["b_dot"] == pytest.approx(run.coordinate("b_dot"), abs=1e-12)
    names = read_csv(tmp_path / "own_spectrum.csv").dtype.names
    assert {"a_amplitude", "b_amplitude"} <= set(names)
    assert str(vv.plan(scene)).splitlines() == solve(scene, "--plan").stdout.splitlines()


def test_a_tab_in_a_law_is_a_blank(solve, tmp_path):
    tables = []
    for name, blank in (("plain", " "), ("tabs", "\t")):
        scene = tmp_path / f"{name}.nml"
        scene.write_text(
            "&system coordinates='x' mass=1 stiffness=1 damping=0.05 /\n"
            f"&force on='x' law='0.3*x^3{blank}+{blank}0.1*tanh(x){blank}' /\n"
            "&transient t_end=3 initial=0 1 dt=0.1 /\n"
        )
        assert solve(scene, "--out", tmp_path).returncode == 0
        tables.append(read_csv(tmp_path / f"{name}_transient.csv"))
    np.testing.assert_array_equal(tables[0], tables[1])


def test_a_law_that_ends_is_reported_with_its_place(solve, tmp_path):
    scene = tmp_path / "ends.nml"
    scene.write_text(
        "&system coordinates='still' 'x', mass=1 1, stiffness=1 0 0 1 /\n"
        "&force on='x', law='0.3*log(1 + x)' /\n"
        "&transient initial=0 0 1.5 0, t_end=20, dt=0.05 /\n"
    )
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 1
    assert "diverged at t = 2.11776" in done.stdout
    assert "; the law '0.3*log(1 + x)' has no value beyond x = -1\n" in done.stdout
    assert "still" not in done.stdout


@pytest.mark.parametrize("kernel", ["", "&kernel kind='prony', weights=0.1, rates=0.5 /\n"])
@pytest.mark.parametrize("edge", [0.7, 1.25])
@pytest.mark.parametrize("structure", [False, True])
def test_laws_of_structures_and_of_what_remembers_are_reported_too(
    solve, tmp_path, structure, kernel, edge
):
    """The original text of the law and the location, although no state is stored there."""
    behind = 1 if kernel else 0
    law = f"0.3*sqrt({edge} + {{}}) - 0.3*sqrt({edge})"
    system = (
        f"&system coordinates='still' 'x', mass=1 1, stiffness=1 0 0 1 /\n"
        f"&force on='x', law='{law.format('x')}', kernel={behind} /\n"
    )
    if structure:
        (tmp_path / "m.mtx").write_text(
            "%%MatrixMarket matrix coordinate real symmetric\n2 2 2\n1 1 1\n2 2 1\n"
        )
        system = (
            "&structure mass='m.mtx', stiffness='m.mtx', coordinates='still' 'x' /\n"
            f"&element on='x', law='{law.format('D')}', kernel={behind} /\n"
        )
    scene = tmp_path / "ends.nml"
    scene.write_text(
        system + kernel + "&transient initial=0 0 1.5 0, t_end=20, dt=0.05, save_every=3 /\n"
    )
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 1, done.stderr
    name = "d" if structure else "x"
    reported = f"; the law '{law.format('D' if structure else 'x')}' has no value beyond {name} = "
    assert reported in done.stdout
    place = float(done.stdout.split(reported)[1].split()[0])
    assert place == pytest.approx(-edge, abs=1e-5)


#: Law, keys of &transient, motion of the base, and True if the equations have memory.
CHOICES = {
    "smooth": ("x1^3", "initial=0.2 0 0 0", "", False),
    "smooth on a moving base": ("x1^3", "", "&load kind='base' amplitude=0.05 /\n", True),
    "kinks on a moving base": ("3*max(x1, 0)", "", "&load kind='base' amplitude=0.05 /\n", False),
    "held": ("x1^3", "held=0.2 0", "", True),
    "nodes": ("x1^3", "initial=0.2 0 0 0 method='gauss6'", "", True),
    "strong damping": ("x1^3", "initial=0.2 0 0 0 t_end=3 tolerance=1e-8", "", True),
}


@pytest.mark.parametrize("name", CHOICES)
def test_scenes_and_python_choose_the_same_equations(tmp_path, name):
    """The states are then equal but for rounding; other equations differ by the tolerance."""
    law, group, base, by_nodes = CHOICES[name]
    damping = [4000.0, 0.05] if name == "strong damping" else [0.1, 0.05]
    path = tmp_path / "own.nml"
    end = "" if "t_end" in group else "t_end=6 dt=0.2"
    path.write_text(
        "&system coordinates='x1', 'x2', mass=1, 0.5, stiffness=2, -1, -1, 1.5, base_direction=1, 1"
        f",\n  damping={damping[0]}, {damping[1]} /\n&force on='x1', law='{law}' /\n"
        f"&load on='x2', amplitude=0.1 /\n{base}&transient nu=1.3 {end} {group} /\n"
    )
    system = vv.PolynomialSystem(
        mass=[1, 0.5], stiffness=[[2, -1], [-1, 1.5]], damping=damping, base_direction=[1, 1],
        forces={"x1": law},
    )  # fmt: skip
    given = {"dt": 0.2, "load": {1: [0, 0.1]}, "nu": 1.3, "base": 0.05 if base else None}
    given |= {"held": [0.2, 0]} if "held" in group else {}
    given |= {"initial": [0.2, 0, 0, 0]} if "initial" in group else {}
    given |= {"method": "gauss6"} if "gauss6" in group else {}
    if name == "strong damping":
        given |= {"dt": "auto", "tolerance": 1e-8}
    run = vv.simulate(system, 3 if name == "strong damping" else 6, **given)
    assert ("iterations" in run.stats) == by_nodes
    read = vv.run(path).trajectory
    assert read.t == pytest.approx(run.t, abs=1e-14)
    assert read.state == pytest.approx(run.state, abs=2e-13)
