"""Structures in scenes: the driver against the condensation in Python, and refused scenes."""

import warnings

import numpy as np
import pytest
import scipy.sparse as sp
import viscovib as vv
from driver import read_csv

CHAIN = "&structure size=4 mass=1 2 1 1 stiffness={} {} /\n"
FIXED = "2 -1 0 0 -1 2 -1 0 0 -1 2 -1 0 0 -1 2"
FREE = "1 -1 0 0 -1 2 -1 0 0 -1 2 -1 0 0 -1 1"
KERNELS = (
    "&kernel kind='prony' weights=0.3 rates=1.5 /\n"
    "&kernel kind='rzhanitsyn' amplitude=0.048 alpha=0.1 beta=0.05 /\n"
)
LOADS = (
    "&load on='x1' amplitude=0.2 /\n&load on='x3' amplitude=0.1 order=2 phase=0.3 /\n"
    "&load on='x3' amplitude=0.05 order=0 /\n"
)
#: Dampers that couple the modes, memory, a function, dependent directions, a moving base; rigid
#: bodies; gyroscopic forces; a loss factor.
CASES = {
    "all": CHAIN.format(FIXED, "damping=0.1 0.01 0.02 0 base_direction=4*1")
    + KERNELS
    + "&element on='x4' 'X3' law='0.5*d^3 + 0.1*d^2 + 0.2*d' kernel=2 /\n"
    "&element on='x1' damping=0.2 kernel=0 /\n"
    "&element on='x1' 'x2' 'x3' weights=1 -2 1 stiffness=0.4 kernel=1 /\n"
    "&element on='x1' law='Tanh(2*d) - 0.1*d^3 + 0.1*tanh(V)' kernel=0 /\n"
    + LOADS
    + "&load kind='base' amplitude=0.05 phase=0.3 /\n"
    "&branch nu_from=0.6 nu_to=0.7 harmonics=4 stability='no' /\n",
    "rigid": CHAIN.format(FREE, "rayleigh=0.02 0.03")
    + "&element on='x4' law='0.5*d^3 + 0.2*d^2' /\n"
    + LOADS
    + "&branch vary='load_factor' nu=0.5 from=0.5 to=2 /\n",
    "dependent": CHAIN.format(FREE, "modal_damping=0 0.02 0.03 0.04")
    + "&element on='x4' 'x1' law='0.5*d^3 + 0.2*d^2' /\n&element on='x4' 'x2' law='0.5*d^3' /\n"
    "&element on='x2' 'x1' law='0.3*d^4' /\n"
    "&load on='x1' amplitude=0.2 order=2 /\n&load on='x3' amplitude=0.1 /\n"
    "&response nu=0.5 0.7 1.1 method='newton' /\n",
    "whirling": "&structure size=2 mass=1 1 stiffness=1 0.3 -0.3 1 damping=0.1 0.5 -0.5 0.1 /\n"
    "&element on='x1' law='d^3' /\n&load on='x2' amplitude=0.2 /\n"
    "&response nu=0.5 0.7 1.1 method='newton' coordinates='x2' /\n",
    "lossy": CHAIN.format(FIXED, "loss_factor=0.1")
    + "&element on='x4' stiffness=1 /\n&load on='x2' amplitude=0.2 /\n"
    "&response nu=0.5 0.7 1.1 method='linear' /\n",
}


def _direct(scene):
    """The same by modes and condensation in Python."""
    system, loads = scene.structure(), scene.loads()
    if "branch" not in scene.groups:
        group = scene.groups["response"]
        return vv.forced_response(system, scene.nu(), **loads, method=group["method"])
    group = scene.groups["branch"]
    if group["vary"] == "nu":
        return vv.trace_response(
            system, (group["nu_from"], group["nu_to"]), **loads, harmonics=group["harmonics"]
        )
    return vv.trace_response(
        system, nu=group["nu"], load_range=(group["from"], group["to"]), **loads
    )


def _compare(scene, table, direct):
    """The largest difference, relative to the largest amplitude."""
    shapes = scene._shapes()
    motions = direct.coefficients
    if shapes is not None:
        motions = np.einsum("rg,ngk->nrk", shapes, motions)
    worst, seen = 0.0, 0
    for d, name in enumerate(scene._names()):
        for j, order in enumerate(direct.harmonics):
            if f"{name}_{order}_re" in table.dtype.names:
                own = table[f"{name}_{order}_re"] + 1j * table[f"{name}_{order}_im"]
                worst = max(worst, np.abs(own - motions[:, d, j]).max())
                seen += 1
    assert seen
    return worst / np.abs(motions).max()


@pytest.mark.parametrize("name", CASES)
def test_as_python_condenses_it(solve, tmp_path, name):
    path = tmp_path / f"{name}.nml"
    path.write_text(CASES[name])
    done = solve(path, "--out", tmp_path)
    # Few harmonics are enough to compare.
    assert done.returncode in (0, 1), done.stderr
    scene = vv.Scene.read(path)
    kind = "branch" if "branch" in scene.groups else "response"
    table = read_csv(tmp_path / f"{name}_{kind}.csv")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vv.ConvergenceWarning)
        assert _compare(scene, table, _direct(scene)) < 1e-11
    assert "condensed to" in done.stdout + str(vv.plan(path))
    assert str(vv.plan(path)).splitlines() == solve(path, "--plan").stdout.splitlines()
    # The canonical scene reads back to the same.
    assert scene.override({}).canonical == scene.canonical


@pytest.mark.parametrize("law", ["d^3", "0.3*tanh(d)"])
def test_linear_motion_with_an_element_at_rest(solve, tmp_path, law):
    """Regression: the force of the element lost digits at antiresonances of its deflection."""
    k = np.array(FIXED.split(), dtype=float).reshape(4, 4)
    c = 1e-6 * k + np.diag([0.0, 0.0, 0.0, 1e-6])
    nu = [float(np.sqrt(square)) for square in np.linalg.eigvalsh(k[:3, :3])]
    path = tmp_path / "still.nml"
    damping = " ".join(map(str, c.ravel()))
    path.write_text(
        f"&structure size=4 mass=4*1 stiffness={FIXED} damping={damping} /\n"
        f"&element on='x4' law='{law}' /\n&load on='x2' amplitude=0.1 /\n"
        f"&response nu={' '.join(map(repr, nu))} method='linear' /\n"
    )
    done = solve(path, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    table = read_csv(tmp_path / "still_response.csv")
    if "tanh" in law:
        k[3, 3] += 0.3
    for w, row in zip(nu, table, strict=True):
        stiffness = k - w**2 * np.eye(4) + 1j * w * c
        true = np.linalg.solve(stiffness, [0, 0.1, 0, 0])
        own = [row[f"x{i + 1}_1_re"] + 1j * row[f"x{i + 1}_1_im"] for i in range(4)]
        assert np.abs(own - true).max() < 1e-13 * np.abs(true).max()


def test_reduced_structure(solve, tmp_path):
    n = 1500
    k = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n))
    spring = vv.Spring(on=f"x{n}", law="0.5*d^3", stiffness=0.3)
    whole = vv.Structure(mass=sp.eye_array(n), stiffness=k, modal_damping=0.01, elements=[spring])
    small = whole.reduce(frequency=0.03, loads=["x1"])
    small.write(tmp_path / "chain.mtx")
    first = float(np.sqrt(small.reduction.squares[0]))
    path = tmp_path / "reduced.nml"
    path.write_text(
        "&structure mass='chain_mass.mtx' stiffness='chain_stiffness.mtx' "
        "damping='chain_damping.mtx' shapes='chain_shapes.mtx' /\n"
        f"&element on='x{n}' stiffness=0.3 law='0.5*d^3' /\n&load on='x1' amplitude=1e-5 /\n"
        f"&branch nu_from={0.8 * first!r} nu_to={1.2 * first!r} /\n"
    )
    done = solve(path, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    table = read_csv(tmp_path / "reduced_branch.csv")
    load = np.zeros(n)
    load[0] = 1e-5
    true = vv.trace_response(
        small, (0.8 * first, 1.2 * first), load=load, coordinates=["x1", f"x{n}"]
    )
    assert table["nu"] == pytest.approx(true.nu, rel=1e-11)
    own = table[f"x{n}_1_re"] + 1j * table[f"x{n}_1_im"]
    assert np.abs(own - true.coefficient(f"x{n}", 1)).max() < 1e-9 * np.abs(own).max()
    scene = vv.Scene.read(path)
    assert _compare(scene, table, _direct(scene)) < 1e-9


GOOD = "&structure mass=1 2 stiffness=2 3 {} /\n"
END = "&load amplitude=1 /\n&response nu=1 /\n"
HEAD = "%%MatrixMarket matrix coordinate {} general\n"
FILES = {
    "complex.mtx": HEAD.format("complex") + "2 2 1\n1 1 1 0\n",
    "pattern.mtx": HEAD.format("pattern") + "2 2 1\n1 1\n",
    "cut.mtx": HEAD.format("real") + "2 2 3\n1 1 1\n2 2 1\n",
    "long.mtx": HEAD.format("real") + "2 2 1\n1 1 1\n2 2 1\n",
    "outside.mtx": HEAD.format("real") + "2 2 1\n3 1 1\n",
    "nan.mtx": HEAD.format("real") + "2 2 1\n1 1 nan\n",
    "three.mtx": HEAD.format("real") + "3 3 3\n1 1 1\n2 2 1\n3 3 1\n",
    "wide.mtx": HEAD.format("real") + "2 3 1\n1 1 1\n",
    "huge.mtx": HEAD.format("real") + "96816 96816 1\n1 1 1\n",
    "none.mtx": "1 2 3\n",
    "twice.mtx": HEAD.format("real").replace("general", "symmetric")
    + "2 2 4\n1 1 2\n2 2 2\n1 2 -1\n2 1 -1\n",
    "half.mtx": HEAD.format("real") + "2 2 3\n1 1 2\n2 2 2\n1 2 -1\n",
}
REFUSED = {
    "mass='gone.mtx' stiffness=1 1": "cannot be read (No such file",
    "mass='a.npz' stiffness=1 1": "read by Python (Structure.read), which reduces sparse",
    "mass='complex.mtx' stiffness=1 1": "complex.mtx:1: contains complex numbers, must be real",
    "mass='pattern.mtx' stiffness=1 1": "pattern without values",
    "mass='cut.mtx' stiffness=1 1": "cut.mtx:4: is truncated: it declares 3 entries",
    "mass='long.mtx' stiffness=1 1": "has more entries than it says",
    "mass='outside.mtx' stiffness=1 1": "a column within the matrix",
    "mass='nan.mtx' stiffness=1 1": "a finite number",
    "mass=1 2 stiffness='three.mtx'": "its file is 3 x 3, must be 2 x 2",
    "mass='wide.mtx' stiffness=1 1": "its file is 2 x 3, must be 2 x 2",
    "mass='huge.mtx' stiffness=1 1": "Python reduces larger structures (Structure.reduce)",
    "mass='none.mtx' stiffness=1 1": "is not a Matrix Market file",
    "mass=1 2 stiffness='twice.mtx'": "is declared symmetric but stores both (2, 1) and (1, 2): "
    "store one triangle",
    "mass=1 2 stiffness=1 1 damping='half.mtx'": "damping: its file has entries on one side of the "
    "diagonal only: store both triangles",
    "mass=1 2 stiffness='../x.mtx'": "must be in the folder of the scene",
    "mass=1 -1 stiffness=1 1": "must be symmetric and positive definite",
    "mass=1 2 stiffness=1 1 modal_damping=1 2 3": "must be one, or 2",
    "mass=1 2 stiffness=1 1 shapes=1 2 3": "must be rows of 2",
    "mass=1 2 stiffness=1 1 damping=1 0.2 0.2 1 loss_factor=0.1": "leave the modes uncoupled",
    "mass=1 2 stiffness=1 1 coordinates='x' 'x'": "is there twice",
    "mass=1 2 stiffness=1 1 size=400": "must be 1 to 300",
    "mass=1 0 0 1 stiffness=2 -1 -1 2": "mass and stiffness have 4 values each: give size = 4 "
    "(diagonals) or size = 2 (row by row)",
}
ELEMENTS = {
    "on='x9' law='d^3'": "on = 'x9': must be one of the 2 coordinates x1, x2",
    "on='x1' law='d^3 +'": "at its end: expected a number, a coordinate or",
    "on='x1' law='y^3'": "'y' is not a coordinate (only d is); a parameter is written as its",
    "on='x1' law='log(d)'": "must be defined near rest",
    "on='x1' law='d/abs(d)'": "u/abs(u) is sign(u) but for u = 0: write sign",
    "on='x1' law='d*log(abs(d))'": "must have a finite derivative at rest, where its",
    "on='x1' kernel=1": "kernel = 1: must be 0 (none) to 0",
    "on='x1' 'x2' weights=0 0": "is not a direction",
    "law='d^3'": "&element lacks on",
}


@pytest.mark.parametrize("given", REFUSED)
def test_refused(solve, tmp_path, given):
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    scene = tmp_path / "bad.nml"
    scene.write_text(f"&structure {given} /\n{END}")
    _refused(solve, scene, REFUSED[given])


@pytest.mark.parametrize("given", ELEMENTS)
def test_refused_element(solve, tmp_path, given):
    scene = tmp_path / "bad.nml"
    scene.write_text(GOOD.format("") + f"&element {given} /\n{END}")
    _refused(solve, scene, ELEMENTS[given])


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        (
            GOOD.format("") + "&load amplitude=1 /\n&multiple_scales nu_from=1 nu_to=2 /\n",
            "(Scene.structure), here are &response",
        ),
        ("&element on='x1' /\n&mount mass=1 /\n" + END, "&element: needs &structure"),
        (GOOD.format("") + "&mount mass=1 /\n" + END, "give one of them"),
        (
            "&structure size=2 mass=1 1 stiffness=1 -1 -1 1 /\n&element on='x1' 'x2' law='d^3' /\n"
            "&load order=0 amplitude=1 /\n" + END,
            "acts on a rigid body without support",
        ),
    ],
)
def test_refused_together(solve, tmp_path, text, reported):
    scene = tmp_path / "bad.nml"
    scene.write_text(text)
    _refused(solve, scene, reported)


def _refused(solve, scene, reported):
    done = solve(scene, "--out", scene.parent)
    assert done.returncode == (3 if "cannot be read" in reported else 2)
    assert reported in done.stderr
    assert len(done.stderr.splitlines()) == 1
    with pytest.raises(vv.ViscovibError) as caught:
        vv.Scene.read(scene)
    assert f"{caught.value}" in done.stderr
