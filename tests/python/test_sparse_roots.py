"""Characteristic roots of sparse models with memory."""

import json
from pathlib import Path

import numpy as np
import pytest
import viscovib as vv
from scipy.sparse import csc_array, diags_array
from viscovib.systems.linear_model import LinearModel
from viscovib.systems.matrix_files import read_matrix
from viscovib.systems.sparse_roots import sparse_roots

DATA = Path(__file__).parents[2] / "data" / "structures"


def sandwich():
    reference = json.loads((DATA / "sandwich_beam_reference.json").read_text())
    tau, g0, stiff, alpha = 8.230e-9, 3.504e5, 3.062e9, 0.675
    kernel = vv.RabotnovKernel(
        amplitude=(1 - g0 / stiff) * tau**-alpha, alpha=alpha, beta=tau**-alpha
    )
    mass, elastic, viscous = (
        read_matrix(name, DATA / f"sandwich_beam_{name}.mtx")
        for name in ("mass", "elastic", "viscous")
    )
    model = LinearModel(mass, elastic, layers=[(stiff * viscous, kernel)])
    return model, np.array(reference["lam_168"]) @ [1, 1j]


def test_six_roots_of_a_sandwich_beam():
    """Core with Rabotnov kernel: Van Beeumen, Meerbergen, Michiels 2013 (NLEVP)."""
    model, reference = sandwich()
    roots, shapes = sparse_roots(model, 6)
    # The reference uses exp(i lam t), with ten digits.
    np.testing.assert_allclose(roots / 1j, reference, rtol=3e-10)
    beam = vv.Structure(mass=model.mass, stiffness=model.stiffness)
    public = beam.characteristic_roots(6, layers=model.layers)
    np.testing.assert_array_equal(public.oscillatory, roots)
    for s, shape in zip(roots, shapes.T, strict=True):
        c = model.coefficients(np.array([s]))[:, 0]
        full = sum(ci * matrix for ci, matrix in zip(c, model.matrices, strict=True))
        assert np.linalg.norm(full @ shape) < 1e-14 * np.linalg.norm(abs(full) @ abs(shape))


@pytest.mark.parametrize("ratio", [0.1, 0.8])
def test_roots_of_a_chain_are_those_of_dense_matrices(ratio):
    """A chain with memory in two springs."""
    n = 8
    elastic = diags_array([-1.0, 2.2, -1.0], offsets=[-1, 0, 1], shape=(n, n)).tocsc()
    layer = np.zeros((n, n))
    layer[2, 2] = layer[5, 5] = 3.0
    kernel = vv.RabotnovKernel(amplitude=ratio, alpha=0.6, beta=1.0)
    model = LinearModel(
        csc_array(np.eye(n)), csc_array(elastic), damping=0.01 * elastic,
        layers=[(csc_array(layer), kernel)],
    )  # fmt: skip
    roots, _ = sparse_roots(model, n)
    system = vv.PolynomialSystem(
        mass=np.eye(n), stiffness=elastic.toarray(), damping=0.01 * elastic.toarray(),
        springs=[vv.Springs(stiffness=layer, kernel=kernel)],
    )  # fmt: skip
    dense = system.characteristic_roots().oscillatory
    springs = [vv.Spring(on=on, stiffness=3.0, kernel=kernel) for on in ("x3", "x6")]
    structure = vv.Structure(
        mass=np.ones(n), stiffness=elastic, damping=0.01 * elastic, elements=springs
    )
    for found in (roots, structure.characteristic_roots(n).oscillatory):
        np.testing.assert_allclose(
            sorted(found, key=lambda s: s.imag), sorted(dense, key=lambda s: s.imag), rtol=1e-10
        )


def test_without_memory_and_with_equal_modes():
    """Two equal chains: each root twice, with separate shapes."""
    one = diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(4, 4)).toarray()
    stiffness = csc_array(np.kron(np.eye(2), one))
    model = LinearModel(csc_array(np.eye(8)), stiffness, rayleigh=(0.02, 0.01))
    roots, shapes = sparse_roots(model, 4)
    squares = np.linalg.eigvalsh(one)[:2].repeat(2)
    rates = 0.02 + 0.01 * squares
    exact = -rates / 2 + 1j * np.sqrt(squares - rates**2 / 4)
    np.testing.assert_allclose(roots, exact, rtol=1e-8)
    assert np.linalg.matrix_rank(shapes, tol=1e-6) == 4


@pytest.mark.parametrize(
    ("layers", "message"),
    [
        ("x", "layers = 'x': must be a list"),
        ([np.eye(2)], r"layers\[0\] = .*: must be \(matrix, kernel\)"),
        ([(np.eye(2), 3)], r"layers\[0\]\[1\] = 3: must be a Kernel"),
        ([(np.eye(3), vv.AbelKernel(amplitude=0.1, alpha=0.5))], r"layers\[0\]\[0\]: must have"),
    ],
)
def test_wrong_layers(layers, message):
    with pytest.raises(vv.InputError, match=message):
        vv.Structure(mass=[1, 1], stiffness=[1, 2]).characteristic_roots(1, layers=layers)


def test_a_structure_of_few_coordinates_has_all_its_roots():
    """Six by default, fewer if there are fewer."""
    pair = vv.Structure(
        mass=[1, 2], stiffness=[[3, -1], [-1, 2]], damping=[[0.2, -0.1], [-0.1, 0.1]],
        elements=[vv.Spring(on="x1", law="d^3")],
    )  # fmt: skip
    whole = vv.PolynomialSystem(
        mass=[1, 2], stiffness=[[3, -1], [-1, 2]], damping=[[0.2, -0.1], [-0.1, 0.1]]
    )
    roots = pair.characteristic_roots().oscillatory
    np.testing.assert_allclose(roots, whole.characteristic_roots().oscillatory, rtol=1e-12)


def test_damping_that_mixes_modes_hides_no_root():
    """Two modes coupled by damping, from which Newton's method converges to the same root."""
    mass = np.array([[1.0152, -0.0474], [-0.0474, 1.1635]])
    stiffness = np.array([[2.3211, -0.2708], [-0.2708, 2.4318]])
    damping = np.array([[1.2321, -0.0173], [-0.0173, 0.1553]])
    other = np.diag([0.0026811, 0.01339])
    for unit in (np.eye(2), other):
        pair = vv.Structure(
            mass=unit @ mass @ unit, stiffness=unit @ stiffness @ unit,
            damping=unit @ damping @ unit,
        )  # fmt: skip
        inverse = np.linalg.inv(mass)
        ordinary = np.block(
            [[np.zeros((2, 2)), np.eye(2)], [-inverse @ stiffness, -inverse @ damping]]
        )
        exact = np.linalg.eigvals(ordinary)
        exact = np.sort_complex(exact[exact.imag > 0])
        roots = np.sort_complex(pair.characteristic_roots().oscillatory)
        np.testing.assert_allclose(roots, exact, rtol=1e-10)
