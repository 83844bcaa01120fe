"""Structures in scenes: motions in time, spectra and backbones, by the driver and by Python."""

import numpy as np
import pytest
import viscovib as vv
from driver import check_refused, read_csv

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


@pytest.mark.parametrize("name", ["coupled", "held"])
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
    check_refused(solve, tmp_path, text, REFUSED[text])


@pytest.mark.parametrize(
    "element",
    [
        "hysteresis='jenkins' hysteresis_numbers=2 0.05 1 0.2",
        "hysteresis='dahl' hysteresis_numbers=2 0.1 1 law='0.2*d^3' stiffness=0.3 damping=0.1",
        "hysteresis='bouc_wen' hysteresis_numbers=2 0.1 1 0.5",
        "fluid_coefficient=0.4 fluid_exponent=0.5 fluid_limit=0.1 fluid_relief=0.2",
        "fluid_coefficient=0.4 fluid_exponent=1.5 law='0.1*d^3'",
        "fluid_coefficient=0.4 fluid_exponent=0.5 series_stiffness=3",
    ],
)
def test_python_reads_every_part_of_an_element(solve, tmp_path, element):
    start = [0.5, 0, -0.2, 0] + [0, 0] * ("series" in element)
    (tmp_path / "scene.nml").write_text(
        "&structure coordinates='x1' 'x2' mass=1 1.5 stiffness=3 -1 -1 2 damping=0.1 0.1 /\n"
        f"&element on='x1' 'x2' {element} /\n&load amplitude=0.2 /\n"
        f"&transient nu=1.1 t_end=15 initial={' '.join(map(str, start))} tolerance=1e-8 /\n"
    )
    done = solve(tmp_path / "scene.nml", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    table = read_csv(tmp_path / "scene_transient.csv")
    structure = vv.Scene.read(tmp_path / "scene.nml").structure()
    run = vv.simulate(structure, 15, initial=start, load=0.2, nu=1.1, tolerance=1e-8, keep="last")
    for place, name in enumerate(("x1", "x1_dot", "x2", "x2_dot")):
        assert table[name][-1] == pytest.approx(run.state[-1, place], abs=1e-8)
