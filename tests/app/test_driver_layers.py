"""Layers of a structure in scenes: springs in the driver against relaxing matrices in Python."""

import os

import numpy as np
import pytest
import viscovib as vv
from driver import check_failure, check_refused, read_csv, silence

BODY = (
    "&structure mass=1 2 1 stiffness=2 -1 0 -1 2 -1 0 -1 2 damping=0.1 0 0 0 0.05 0 0 0 0.1 {}/\n"
)
KERNELS = (
    "&kernel kind='prony' weights=0.2 0.05 rates=1.0 0.2 /\n"
    "&kernel kind='rabotnov' amplitude=0.2 alpha=0.6 beta=0.8 /\n"
)
LAYERS = (
    "&layer stiffness=1 0.5 0.2 0.5 1.2 0.1 0.2 0.1 0.8 /\n"
    "&layer stiffness=0 0 0 0 0.5 -0.5 0 -0.5 0.5 kernel=2 /\n"
    "&layer stiffness=0.3 0 0.1 kernel=0 /\n"
)
REST = "&element on='x3' law='0.7*d^3' kernel=0 /\n&load on='x1' amplitude=0.5 /\n"
SCENE = BODY.format("") + KERNELS + LAYERS + REST


def _table(solve, folder, text, status=0):
    (folder / "scene.nml").write_text(text)
    done = solve(folder / "scene.nml", "--out", folder)
    assert done.returncode == status, done
    with silence():
        vv.run(folder / "scene.nml").to_csv(folder / "mine.csv")
    (path,) = folder.glob("scene_*.csv")
    if "debug" in os.environ.get("VISCOVIB_SOLVE", ""):
        ours, theirs = read_csv(path), read_csv(folder / "mine.csv")
        assert ours.dtype == theirs.dtype
        assert len(ours) == len(theirs)
    else:
        assert path.read_bytes() == (folder / "mine.csv").read_bytes()
    return read_csv(path), vv.Scene.read(folder / "scene.nml")


def _close(rows, coefficients, orders):
    for d in range(3):
        for j, k in enumerate(orders):
            reported = rows[f"x{d + 1}_{k}_re"] + 1j * rows[f"x{d + 1}_{k}_im"]
            assert reported == pytest.approx(coefficients[:, d, j], rel=1e-8, abs=1e-9)


@pytest.mark.parametrize("method", ["newton", "linear"])
def test_response(solve, tmp_path, method):
    more = f"&response nu=0.6 1.0 1.7 method='{method}' harmonics=9 /\n"
    rows, scene = _table(solve, tmp_path, SCENE + more)
    structure = scene.structure()
    assert len(structure.layers) == 2
    r = vv.forced_response(structure, [0.6, 1.0, 1.7], method=method, harmonics=9, **scene.loads())
    _close(rows, r.coefficients, r.harmonics)


def test_motion(solve, tmp_path):
    """Python: exponentials as states of complex modes; driver: memory of springs."""
    text = SCENE.replace(" kernel=2 /", " /")
    more = "&transient nu=1.1 t_end=10 tolerance=1e-9 initial=0.3 0 0 0 -0.2 0.1 /\n"
    rows, scene = _table(solve, tmp_path, text + more)
    run = vv.simulate(
        scene.structure(), 10, initial=[0.3, 0, 0, 0, -0.2, 0.1], nu=1.1, tolerance=1e-10,
        load=scene.loads()["load"],
    )  # fmt: skip
    last = [rows[name][-1] for name in ("x1", "x1_dot", "x2", "x2_dot", "x3", "x3_dot")]
    assert np.array(last) == pytest.approx(run.state[-1], abs=1e-7)


REFUSED = {
    ":4: stiffness: must be symmetric": (BODY.format(""), "&layer stiffness=1 2 0 0 1 0 0 0 1 /"),
    ":4: stiffness has 2 values: must be 3": (BODY.format(""), "&layer stiffness=1 2 /"),
    ":4: kernel = 3: must be": (BODY.format(""), "&layer stiffness=1 2 3 kernel=3 /"),
    ":4: &layer: belongs to a structure in all its": (
        BODY.format("shapes=1 0 0 0 1 0 0 0 1"), "&layer stiffness=1 2 3 /"
    ),
    ":4: &layer: needs &structure": (
        "&system coordinates='x' mass=1 stiffness=1 /\n", "&layer stiffness=1 /"
    ),
}  # fmt: skip


@pytest.mark.parametrize("message", REFUSED)
def test_refused(solve, tmp_path, message):
    body, layer = REFUSED[message]
    check_refused(solve, tmp_path, f"{body}{KERNELS}{layer}\n&modes /\n", message)


def test_a_layer_in_many_directions_is_pythons(solve, tmp_path):
    ones = " ".join(["1"] * 70)
    scene = tmp_path / "scene.nml"
    scene.write_text(
        f"&structure mass={ones} stiffness={ones} /\n&kernel kind='prony' weights=0.2 rates=1 /\n"
        f"&layer stiffness={ones} /\n&load on='x1' amplitude=1 /\n&response nu=1 /\n"
    )
    out = tmp_path / "out"
    out.mkdir()
    check_failure(solve(scene, "--out", out), 2, ":3: stiffness: its layer acts in 70", out)
