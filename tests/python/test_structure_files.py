"""Structures in files: what is written is read back; reduced ones in modal coordinates."""

from itertools import product

import numpy as np
import pytest
import viscovib as vv
from models_of_structures import plate, write_matrix
from scipy.io import mmread
from scipy.sparse import csc_array, diags_array

TOP = 2 * np.pi * 400
CHAIN = csc_array(diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(6, 6)))
SPRING = vv.Spring(on="a3", stiffness=0.2, damping=0.01, law="0.5*d^3")


@pytest.mark.parametrize("dense", [False, True])
def test_a_structure_comes_back(tmp_path, dense):
    given = {
        "mass": np.arange(1.0, 7), "stiffness": CHAIN.toarray() if dense else CHAIN,
        "damping": 0.01 * (CHAIN.toarray() if dense else CHAIN), "rayleigh": (0.1, 0.02),
        "names": [f"a{i}" for i in range(6)], "units": ["mm"] * 6, "base_direction": np.ones(6),
    }  # fmt: skip
    vv.Structure(**given).write(tmp_path / "s.npz")
    found = [
        vv.forced_response(s, [0.3], load={"a1": 0.1}, base=0.1, method="newton")
        for s in (
            vv.Structure.read(tmp_path / "s.npz", elements=[SPRING]),
            vv.Structure(**given, elements=[SPRING]),
        )
    ]
    assert found[0].dof_units == ("mm",) * 6
    np.testing.assert_array_equal(*(r.coefficients for r in found))


def test_matrix_market_and_harwell_boeing(tmp_path):
    write_matrix(tmp_path / "k.mtx", CHAIN)
    write_matrix(tmp_path / "m.npz", np.eye(6))
    s = vv.Structure.read(tmp_path / "m.npz", tmp_path / "k.mtx", modal_damping=0.01)
    assert (s.stiffness != CHAIN).nnz == 0
    vv.Structure(mass=np.ones(6), stiffness=CHAIN).write(tmp_path / "s.mtx")
    again = vv.Structure.read(*(tmp_path / f"s_{name}.mtx" for name in ("mass", "stiffness")))
    assert (again.stiffness != CHAIN).nnz == 0


@pytest.mark.parametrize("ending", [".mtx", ".npz"])
def test_one_triangle_is_no_structure(tmp_path, ending):
    """A file with one triangle is refused, an array causes a warning."""
    rng = np.random.default_rng(11)
    write_matrix(tmp_path / "m.mtx", np.eye(6))
    for triangle in (np.tril, np.triu):
        full = CHAIN.toarray() + np.diag(rng.uniform(0, 1, 6))
        half, whole = tmp_path / f"half{ending}", tmp_path / f"whole{ending}"
        write_matrix(half, triangle(full))
        write_matrix(whole, full + triangle(rng.normal(size=(6, 6))))
        vv.Structure.read(tmp_path / "m.mtx", whole, whole)
        refused = pytest.raises(vv.InputError, match=r"damping: .* one side of the diagonal only")
        with refused:
            vv.Structure.read(tmp_path / "m.mtx", whole, half)
        for given in (triangle(full), csc_array(triangle(full))):
            with pytest.warns(vv.StabilityWarning, match=r"stiffness: .* pass both triangles"):
                vv.Structure(mass=np.ones(6), stiffness=given)


@pytest.mark.parametrize("dashpots", [False, True])
def test_a_reduced_structure_moves_as_a_small_one(tmp_path, dashpots):
    steel = plate(8, 8, length=1.2, width=1.0, thickness=0.01, young=2e11, density=7800.0)
    mounts = [int(steel.w[i, j]) for i, j in [(1, 1), (1, -2), (-2, 1), (-2, -2)]]
    pushed = int(steel.w[3, 5])
    law = {"stiffness": 4e5, "law": "2e15*d^3", "damping": 30.0 * dashpots}
    whole = vv.Structure(
        mass=steel.mass, stiffness=steel.stiffness, rayleigh=(1.0, 2e-6),
        elements=[vv.Spring(on=on, **law) for on in mounts],
    )  # fmt: skip
    small = whole.reduce(frequency=TOP, loads=[f"x{pushed + 1}"])
    small.write(tmp_path / "p.mtx", coordinates=[f"x{i + 1}" for i in [*mounts, pushed]])
    shapes = np.asarray(mmread(tmp_path / "p_shapes.mtx", spmatrix=False).toarray())
    header = (tmp_path / "p_shapes.mtx").read_text().splitlines()[1]
    assert header.split()[0] == "%rows:"
    assert header.split()[1:] == [f"x{i + 1}" for i in [*mounts, pushed]]
    read = vv.Structure.read(
        *(tmp_path / f"p_{name}.mtx" for name in ("mass", "stiffness", "damping")),
        elements=[vv.Spring(on=row, **law) for row in shapes[:4]],
    )
    nu = [0.1 * TOP, 0.2 * TOP]
    asked = {"method": "newton", "harmonics": 3, "tolerance": 1e-3}
    one = vv.forced_response(
        small, nu, load={f"x{pushed + 1}": 15.0}, coordinates=[f"x{pushed + 1}"], **asked
    )
    modes = list(read.dof_names)
    other = vv.forced_response(read, nu, load=15.0 * shapes[4], coordinates=modes, **asked)
    moved = np.einsum("m,nmk->nk", shapes[4], other.coefficients)
    largest = np.abs(moved).max()
    np.testing.assert_allclose(one.coefficients[:, 0], moved, atol=1e-8 * largest)


def test_wrong_files(tmp_path):
    write_matrix(tmp_path / "k.mtx", CHAIN)
    write_matrix(tmp_path / "m.mtx", np.eye(5))
    with pytest.raises(vv.InputError, match=r"stiffness: .*k.mtx has 6 rows, must have 5 as mass"):
        vv.Structure.read(tmp_path / "m.mtx", tmp_path / "k.mtx")
    for ending, (rows, columns) in product((".npz", ".mtx"), ((2, 7), (7, 2), (5, 6))):
        write_matrix(tmp_path / f"o{ending}", np.tril(np.ones((rows, columns)), -1))
        with pytest.raises(vv.InputError, match=rf"{rows} x {columns}, must be square"):
            vv.Structure.read(tmp_path / "m.mtx", tmp_path / f"o{ending}")
    with pytest.raises(vv.FileError, match=r"stiffness: .*none.mtx cannot be read"):
        vv.Structure.read(tmp_path / "m.mtx", tmp_path / "none.mtx")
    with pytest.raises(
        vv.InputError, match=r"mass = .*m.mtx': must end in .npz to contain a whole"
    ):
        vv.Structure.read(tmp_path / "m.mtx")
    np.savez(tmp_path / "x.npz", x=np.eye(2))
    with pytest.raises(vv.FileError, match=r"x.npz contains no structure"):
        vv.Structure.read(tmp_path / "x.npz")
    (tmp_path / "y.npz").write_bytes((tmp_path / "x.npz").read_bytes()[:50])
    with pytest.raises(vv.FileError, match=r"mass: .*y.npz cannot be read"):
        vv.Structure.read(tmp_path / "y.npz")
    with pytest.raises(vv.FileError, match=r"mass: .*z.npz cannot be read \(No such file"):
        vv.Structure.read(tmp_path / "z.npz")
    s = vv.Structure(mass=np.ones(6), stiffness=CHAIN, rayleigh=(0.1, 0.1))
    with pytest.raises(vv.InputError, match=r"Rayleigh and loss factors have no matrix"):
        s.write(tmp_path / "s.mtx")
    with pytest.raises(vv.InputError, match=r"must end in .npz or .mtx"):
        s.write(tmp_path / "s.txt")
    with pytest.raises(vv.InputError, match="coordinates: only a reduced structure"):
        s.write(tmp_path / "s.npz", coordinates=["x1"])


def test_matrices_are_all_written_or_none(tmp_path):
    """A limit on the file size allows the mass file and not the stiffness file."""
    resource = pytest.importorskip("resource")
    n = 30
    system = vv.Structure(mass=np.ones(n), stiffness=np.eye(n) * n + np.ones((n, n)) / 3)
    system.write(tmp_path / "a.mtx")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    sizes = {name: len(content) for name, content in before.items()}
    room = sizes["a_mass.mtx"] + 100
    assert room < sizes["a_stiffness.mtx"]
    other = vv.Structure(mass=np.full(n, 2.0), stiffness=system.stiffness)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, limits[1]))
    try:
        with pytest.raises(vv.FileError, match=r"a_stiffness.mtx: cannot be written"):
            other.write(tmp_path / "a.mtx")
        with pytest.raises(vv.FileError):
            other.write(tmp_path / "b.mtx")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
