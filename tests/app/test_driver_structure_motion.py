"""Structures in scenes: motions in time, spectra and backbones, by the driver and by Python."""

import os
import re

import numpy as np
import pytest
import viscovib as vv
from driver import SCENES, read_csv
from referee.integration import solve_ivp
from scipy.linalg import expm

CHAIN = "&structure size=4 mass=1 2 1 1 stiffness={} {} /\n"
FIXED = "2 -1 0 0 -1 2 -1 0 0 -1 2 -1 0 0 -1 2"
FREE = "1 -1 0 0 -1 2 -1 0 0 -1 2 -1 0 0 -1 1"
KERNELS = (
    "&kernel kind='prony' weights=0.3 rates=1.5 /\n"
    "&kernel kind='rzhanitsyn' amplitude=0.048 alpha=0.1 beta=0.05 /\n"
)
START = "initial=0.1 0 0 0.2 0 0 -0.1 0.3"
#: Dampers that couple the modes, memory, a moving base; a mean load on a free body; an initial
#: past; gyroscopic forces; dampers that couple the modes, without a load.
MOTIONS = {
    "coupled": CHAIN.format(FIXED, "damping=0.1 0.01 0.02 0 base_direction=4*1")
    + KERNELS
    + "&element on='x4' 'X3' law='0.5*d^3 + 0.1*d^2 + 0.2*d' kernel=2 /\n"
    "&element on='x1' damping=0.2 law='Tanh(2*d)' kernel=0 /\n"
    "&load on='x1' amplitude=0.2 phase=0.4 /\n&load kind='base' amplitude=0.05 phase=0.3 /\n"
    f"&transient nu=0.7 t_end=12 tolerance=1e-10 coordinates='x1' 'x3' {START} /\n"
    "&spectrum coordinates='x4' discard=4 /\n",
    "rigid": CHAIN.format(FREE, "rayleigh=0.02 0.03")
    + "&element on='x4' 'x1' law='0.5*d^3 + 0.2*d^2' /\n&load on='x3' amplitude=0.05 order=0 /\n"
    f"&transient t_end=6 dt=0.05 save_every=3 {START} /\n",
    "held": CHAIN.format(FIXED, "modal_damping=0.02")
    + KERNELS
    + "&element on='x4' stiffness=1.5 law='0.5*d^3' kernel=1 /\n"
    "&transient t_end=6 held=0.1 0.2 0.3 0.4 keep='last' /\n",
    "whirling": "&structure size=2 mass=1 1 stiffness=1 0.3 -0.3 1 damping=0.1 0.5 -0.5 0.1 /\n"
    "&element on='x1' law='d^3' /\n&load on='x2' amplitude=0.2 /\n"
    "&transient nu=0.9 t_end=10 initial=0.3 0 -0.2 0.1 /\n",
    "free": CHAIN.format(FIXED, "damping=0.1 0.01 0.02 0")
    + f"&element on='x4' law='0.5*d^3' /\n&transient t_end=6 {START} /\n",
}


def _same(one, other):
    """Byte by byte, if both programs use one build."""
    if "debug" not in os.environ.get("VISCOVIB_SOLVE", ""):
        assert one.read_bytes() == other.read_bytes()
    a, b = (read_csv(path) for path in (one, other))
    for name in a.dtype.names:
        size = np.abs(a[name]).max()
        if name == "error":
            # An estimate of rounding errors, which depends on the build.
            assert a[name] == pytest.approx(b[name], rel=0.1)
        elif "_phase" not in name:
            assert a[name] == pytest.approx(b[name], abs=1e-9 * size + 1e-14)


def _direct(scene):
    """The same motion by `vv.simulate`."""
    group = scene.groups["transient"]
    given = {name: load for name, load in scene.loads().items() if load}
    fixed = {"dt": group["dt"]} if group["dt"] else {}
    return vv.simulate(
        scene.structure(), group["t_end"], **given, **fixed, nu=group.get("nu"),
        initial=group["initial"], held=group["held"] if any(np.atleast_1d(group["held"])) else None,
        save_every=group["save_every"], keep=group["keep"],
    )  # fmt: skip


@pytest.mark.parametrize("name", MOTIONS)
def test_motion(solve, tmp_path, name):
    path = tmp_path / f"{name}.nml"
    path.write_text(MOTIONS[name])
    done = solve(path, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    table = read_csv(tmp_path / f"{name}_transient.csv")
    scene = vv.Scene.read(path)
    direct = _direct(scene)
    at = np.atleast_1d(table["t"])
    seen = 0
    for d, dof in enumerate(scene._names()):
        for column, row in ((dof, 2 * d), (f"{dof}_dot", 2 * d + 1)):
            if column in table.dtype.names:
                # The times of stored states may depend on the other stored values.
                own = np.interp(direct.t, at, np.atleast_1d(table[column]))
                same = np.isclose(direct.t[:, np.newaxis], at[np.newaxis], rtol=1e-12).any(axis=1)
                assert same.sum() >= min(20, at.size)
                assert own[same] == pytest.approx(direct.state[same, row], abs=1e-9)
                seen += 1
    assert seen >= 4
    assert str(vv.plan(path)).splitlines() == solve(path, "--plan").stdout.splitlines()
    assert scene.override({}).canonical == scene.canonical


def test_motion_is_that_of_the_equations(solve, tmp_path):
    """Gyroscopic forces and a follower force, against DOP853 on x and y."""
    (tmp_path / "whirling.nml").write_text(MOTIONS["whirling"])
    assert solve(tmp_path / "whirling.nml", "--out", tmp_path).returncode == 0
    table = read_csv(tmp_path / "whirling_transient.csv")
    k = np.array([[1, 0.3], [-0.3, 1]])
    c = np.array([[0.1, 0.5], [-0.5, 0.1]])

    def rates(t, state):
        u, v = state[:2], state[2:]
        force = -k @ u - c @ v - [u[0] ** 3, -0.2 * np.sin(0.9 * t)]
        return [*v, *force]

    true = solve_ivp(
        rates, (0, 10), [0.3, -0.2, 0, 0.1], "DOP853", table["t"], rtol=1e-12, atol=1e-13
    ).y
    for name, row in zip(("x1", "x2", "x1_dot", "x2_dot"), true, strict=True):
        assert table[name] == pytest.approx(row, abs=1e-9)


def _twins(solve, folder, mass, damping, stiffness, start, t):
    """Displacements and velocities of the first two masses of two chains with the same start."""

    def reported(numbers):
        return " ".join(repr(float(x)) for x in np.ravel(numbers))

    (folder / "twins.nml").write_text(
        f"&structure size={2 * mass.size} mass={reported(np.tile(mass, 2))} "
        f"stiffness={reported(stiffness)} damping={reported(np.kron(np.eye(2), damping))} /\n"
        f"&transient t_end={t} tolerance=1e-9 keep='last' coordinates='x1' 'x2' "
        f"initial={reported(np.outer(np.tile(start, 2), [1, 0]))} /\n"
    )
    assert solve(folder / "twins.nml", "--out", folder).returncode == 0
    table = read_csv(folder / "twins_transient.csv")
    return [float(table[name]) for name in ("x1", "x2", "x1_dot", "x2_dot")]


@pytest.mark.parametrize("stiff", [1e2, 1e5, 1e8])
@pytest.mark.parametrize("n", [2, 12])
def test_soft_motions_with_stiff_springs(solve, tmp_path, n, stiff):
    """Two chains whose masses are connected by stiff springs move like one chain."""
    one = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    whole = np.kron(np.eye(2), one) + stiff * np.kron([[1, -1], [-1, 1]], np.eye(n))
    start, t = np.linalg.solve(one, np.eye(n)[1]), 10.0
    found = _twins(solve, tmp_path, np.ones(n), 0 * one, whole, start, t)
    angles = np.arange(1, n + 1) * np.pi / (2 * n + 2)
    waves = np.sin(2 * np.outer(np.arange(1, n + 1), angles)) * np.sqrt(2 / (n + 1))
    rates, parts = 2 * np.sin(angles), waves.T @ start
    true = waves @ np.column_stack([np.cos(rates * t) * parts, -rates * np.sin(rates * t) * parts])
    assert found == pytest.approx([*true[:2, 0], *true[:2, 1]], abs=2e-14)


@pytest.mark.parametrize("stiff", [1e2, 1e5, 1e8])
@pytest.mark.parametrize("n", [2, 12])
def test_soft_motions_with_dampers_that_couple_modes(solve, tmp_path, n, stiff):
    """With different dampers at some masses; with equal dampers stiff modes would coincide."""
    one = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    whole = np.kron(np.eye(2), one) + stiff * np.kron([[1, -1], [-1, 1]], np.eye(n))
    mass, start, t = 1 + np.arange(n) / n, np.linalg.solve(one, np.eye(n)[1]), 10.0
    dampers = np.diag(0.2 + 0.3 * (np.arange(n) % 3 == 1))
    found = _twins(solve, tmp_path, mass, dampers, whole, start, t)
    rates = np.block([[np.zeros((n, n)), np.eye(n)], [-one, -dampers]])
    rates[n:] /= mass[:, np.newaxis]
    true = (expm(t * rates) @ [*start, *np.zeros(n)]).reshape(2, n)[:, :2]
    assert found == pytest.approx(list(true.ravel()), abs=1e-13)


def test_python_writes_the_same(solve, tmp_path):
    path = tmp_path / "coupled.nml"
    path.write_text(MOTIONS["coupled"])
    assert solve(path, "--out", tmp_path).returncode == 0
    result = vv.run(path)
    result.to_csv(tmp_path / "own.csv")
    _same(tmp_path / "own.csv", tmp_path / "coupled_transient.csv")
    result.spectrum_to_csv(tmp_path / "own.csv")
    _same(tmp_path / "own.csv", tmp_path / "coupled_spectrum.csv")


@pytest.mark.parametrize("dof", ["x15", "x13", None])
def test_backbone(solve, tmp_path, dof):
    """Amplitude of the deflection of the element, of another coordinate, or the largest one."""
    text = (SCENES / "beam_branch.nml").read_text()
    for name in ("mass", "stiffness"):
        (tmp_path / f"beam_{name}.mtx").write_bytes((SCENES / f"beam_{name}.mtx").read_bytes())
    path = tmp_path / "beam.nml"
    named = "" if dof is None else f"dof='{dof}'"
    path.write_text(
        text[: text.index("&load")]
        + f"&backbone from=1e-5 to=1e-3 {named} harmonics=7 coordinates='x7' 'x15' /\n"
    )
    done = solve(path, "--out", tmp_path)
    assert done.returncode in (0, 1), done.stderr
    table = read_csv(tmp_path / "beam_backbone.csv")
    scene = vv.Scene.read(path)
    with pytest.warns(vv.ConvergenceWarning):
        true = vv.backbone(
            scene.structure(), 0, (1e-5, 1e-3), dof=dof, harmonics=7, coordinates=["x7", "x15"]
        )
    assert table["nu"] == pytest.approx(true.nu, rel=1e-10)
    for name in ("x7", "x15"):
        for k in (1, 3, 5, 7):
            assert table[f"{name}_{k}"] == pytest.approx(true.coefficient(name, k).imag, abs=1e-12)
    vv.run(path).to_csv(tmp_path / "own.csv")
    _same(tmp_path / "own.csv", tmp_path / "beam_backbone.csv")
    assert scene.override({}).canonical == scene.canonical
    assert str(vv.plan(path)).splitlines() == solve(path, "--plan").stdout.splitlines()


SHAPES = "&structure mass=1 1 stiffness=1 3 modal_damping=0.01 shapes=1 1 1 -1 0.5 0.2 /\n"
FINE = "&structure mass=1 2 stiffness=2 3 {} /\n&element on='x1' law='d^3' /\n"
REFUSED = {
    SHAPES + "&transient t_end=1 initial=1 0 0 0 0 0 /\n": "initial: must be 0 of a structure with",
    SHAPES + "&transient t_end=1 held=1 0 0 /\n": "held: must be 0 of a structure with shapes",
    FINE.format("loss_factor=0.1") + "&transient t_end=1 /\n": "loss_factor has no meaning in time",
    FINE.format("") + "&transient t_end=1 nu=2 /\n": "is the frequency of a load, and none has one",
    FINE.format("") + "&backbone from=0.1 to=1 mode=2 /\n": "mode = 2: must be 0 to 1",
    FINE.format("") + "&backbone from=0.1 to=1 mode=1 dof='x2' /\n": "does not move in mode 1",
    FINE.format("") + "&backbone from=0.1 to=1 dof='y' /\n": "must be one of",
    FINE.format("") + "&backbone from=1 to=0.1 /\n": "to = 0.1: must be greater than from",
    FINE.replace("d^3", "v^3").format("") + "&backbone from=0.1 to=1 /\n": "some depend on rates",
}


@pytest.mark.parametrize("text", REFUSED)
def test_refused(solve, tmp_path, text):
    path = tmp_path / "bad.nml"
    path.write_text(text)
    done = solve(path, "--out", tmp_path)
    assert done.returncode == 2, done.stdout
    assert REFUSED[text] in done.stderr
    assert len(done.stderr.splitlines()) == 1
    with pytest.raises(vv.InputError) as problem:
        vv.run(path)
    assert REFUSED[text] in str(problem.value)


#: Stops, friction and gaps between the coordinates of small structures, each with a damping.
SWITCHING = {
    "gap": "&structure size=2 mass=1 2 stiffness=2 -1 -1 2 damping=0.1 0 0 0.1 /\n"
    "&element on='x1' law='30*max(d - 0.1, 0)' /\n&load on='x2' amplitude=0.7 phase=0.2 /\n"
    "&transient t_end=12 nu=0.9 initial=0.3 0 0 0 /\n",
    "friction": "&structure size=2 mass=1 2 stiffness=2 -1 -1 2 modal_damping=0.02 0.05 /\n"
    "&element on='x1' 'x2' weights=1 -0.5 stiffness=0.4 law='0.3*sign(v) + d^3' /\n"
    "&load on='x1' amplitude=0.7 /\n&transient t_end=12 nu=0.9 /\n",
    "quadratic": CHAIN.format(FIXED, "rayleigh=0.02 0.03")
    + "&element on='x1' 'x3' law='where(d > 0.1, 5*d - 0.5, 0) + 0.2*v*abs(v)' /\n"
    f"&transient t_end=6 dt=0.1 save_every=3 {START} /\n&spectrum discard=1 /\n",
    "remembering": "&structure size=2 mass=1 2 stiffness=2 -1 -1 2 damping=0.1 0 0 0.1 /\n"
    + KERNELS
    + "&element on='x1' law='30*max(d - 0.1, 0)' kernel=0 /\n"
    "&element on='x2' stiffness=1.5 law='0.5*d^3' kernel=1 /\n&load on='x2' amplitude=0.7 /\n"
    "&transient t_end=8 nu=0.9 initial=0.3 0 0 0 memory='Exponentials' method='GAUSS8' /\n",
    # Tables contain the coordinates with elements or loads.
    "many": "&structure size=70 mass=70*1 stiffness=70*2 damping=70*0.1 /\n"
    + "".join(f"&element on='x{i}' 'x{i + 1}' stiffness=1 /\n" for i in (1, 2, 3, 69))
    + "&element on='x2' law='30*max(d - 0.1, 0)' /\n&element on='x70' law='0.1*sign(v)' /\n"
    "&load on='x1' amplitude=0.7 /\n&transient t_end=8 nu=0.9 /\n",
    "system": "&system coordinates='x1' 'x2' 'x3' 'x4' 'x5' 'x6' 'x7' stiffness=2 2 2 2 2 2 2 "
    "mass=1 1 2 1 1 1 1 damping=0.1 0.1 0.1 0.1 0.1 0.1 0.1 kernel=0 /\n"
    "&force on='x2' law='30*max(x2 - 0.1, 0) + x2 - x1' /\n"
    "&force on='x1' law='x1 - x2 + 0.1*sign(x1_dot)' /\n"
    "&load on='x1' amplitude=0.7 /\n&transient t_end=8 nu=0.9 /\n",
}


@pytest.mark.parametrize("name", SWITCHING)
def test_steps_end_where_laws_switch(solve, tmp_path, name):
    """Also for small structures: the table is exact; fixed steps would miss the corners.

    The memory option "exponentials" is accepted in upper and lower case.
    """
    path = tmp_path / f"{name}.nml"
    path.write_text(SWITCHING[name])
    done = solve(path, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    table = read_csv(tmp_path / f"{name}_transient.csv")
    scene = vv.Scene.read(path)
    group, load = scene.groups["transient"], scene.loads()["load"]
    system = scene.structure() if name != "system" else scene.polynomial_system()
    run = vv.simulate(
        system, group["t_end"], initial=group["initial"], tolerance=1e-11,
        times=table["t"][1:], load=load or None, nu=group["nu"] if load else None,
    )  # fmt: skip
    for place, one in enumerate(n for n in table.dtype.names if n != "t"):
        assert table[one][1:] == pytest.approx(run.state[-table.size + 1 :, place], abs=3e-10)
    vv.run(path).to_csv(tmp_path / "again.csv")
    _same(tmp_path / f"{name}_transient.csv", tmp_path / "again.csv")
    assert str(vv.plan(path)).splitlines() == solve(path, "--plan").stdout.splitlines()
    assert scene.override({}).canonical == scene.canonical


@pytest.mark.parametrize("amplitude", [0.3, 0.35, 0.4, 0.45, 0.5, 0.55])
def test_steps_over_kinks_are_found_alike(solve, tmp_path, amplitude):
    """If two runs may have the same error, both compare three: the same steps and error."""
    path = tmp_path / "kinked.nml"
    path.write_text(
        CHAIN.format(FIXED, "damping=0.1 0.01 0.02 0")
        + KERNELS
        + "&element on='x1' law='3*max(d - 0.1, 0)' kernel=2 /\n"
        f"&load on='x1' amplitude={amplitude} /\n"
        f"&transient nu=0.7 t_end=8 tolerance=1e-5 keep='last' {START} /\n"
    )
    done = solve(path, "--out", tmp_path)
    assert done.returncode == 0
    scene = vv.Scene.read(path)
    run = vv.simulate(
        scene.structure(), 8, **{k: v for k, v in scene.loads().items() if v}, nu=0.7,
        initial=scene.groups["transient"]["initial"], tolerance=1e-5, keep="last",
    )  # fmt: skip
    notes = (tmp_path / "kinked_transient.csv").read_text()
    reported = float(re.search("estimated error (.*)", notes)[1])
    assert reported == pytest.approx(run.error, rel=1e-6)
    assert float(done.stdout.split("estimated error")[1]) == float(f"{reported:.1e}")
    table = read_csv(tmp_path / "kinked_transient.csv")
    assert float(table["x1"]) == pytest.approx(run.state[0, 0], abs=1e-13)
