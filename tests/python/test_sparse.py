"""Reduction of sparse models, against dense matrices."""

import numpy as np
import pytest
import viscovib as vv
from models_of_structures import plate
from scipy.linalg import eigh
from scipy.sparse import block_diag, coo_array, csc_array, diags_array, kron
from viscovib.systems.linear_model import LinearModel
from viscovib.systems.reduction import reduce_model
from viscovib.systems.sparse_pencil import Pencil, checked_sparse, estimated_fill, factored
from viscovib.systems.sparse_roots import direct_solution

TOP = 2 * np.pi * 400


@pytest.fixture(scope="module")
def steel():
    return plate(10, 10, length=1.2, width=1.0, thickness=0.01, young=2e11, density=7800.0)


def springs(steel, stiffness):
    places = steel.w[[0, 0, -1, -1], [0, -1, 0, -1]]
    n = steel.mass.shape[0]
    return csc_array((np.full(4, stiffness), (places, places)), shape=(n, n))


def loads(steel):
    directions = np.zeros((steel.mass.shape[0], 3))
    directions[steel.w[2, 2], 0] = 1
    directions[steel.w[7, 9], 1] = 1
    directions[[steel.w[4, 5], steel.w[4, 5] + 1], 2] = 1, 0.1
    return directions


def dense(model, s):
    c = model.coefficients(np.array([s]))[:, 0]
    return sum(ci * matrix.toarray() for ci, matrix in zip(c, model.matrices, strict=True))


def errors(model, reduced, directions, extra=None):
    """Relative errors of displacements in the energy norm, at frequencies between checks."""
    found = []
    norm = model.at_rest.toarray() + (0.1 * TOP) ** 2 * model.mass.toarray()
    basis = np.concatenate([reduced.shapes, reduced.static], axis=1)
    for part in (0.013, 0.21, 0.47, 0.81, 1.0):
        s = 1j * TOP * part
        full = dense(model, s) + (0 if extra is None else s * extra)
        exact = np.linalg.solve(full, directions)
        if model.damping is None and not model.layers:
            # Computed in the same way as by users of the reduced model.
            squares = reduced.squares * (1 + 1j * model.loss)
            sections = squares + reduced.rates * s + s**2
            u = reduced.shapes @ ((reduced.shapes.T @ directions) / sections[:, np.newaxis])
            soft = 1 + model.rayleigh[1] * s + 1j * model.loss
            u = u + reduced.static @ (reduced.static.T @ directions) / soft
        else:
            u = basis @ np.linalg.solve(basis.T @ full @ basis, basis.T @ directions)
        wrong = exact - u
        energy = [np.einsum("ij,ij->j", v.conj(), norm @ v).real for v in (wrong, exact)]
        found.append(np.sqrt(energy[0] / energy[1]).max())
    return np.array(found)


MODELS = {
    "rayleigh": lambda steel, k: {"rayleigh": (0.5, 1e-6)},
    "loss factor": lambda steel, k: {"loss": 0.1},
    "dashpots": lambda steel, k: {"damping": springs(steel, 300.0) + 1e-6 * k},
    "gyroscopic": lambda steel, k: {"damping": 1e-6 * k + turned(steel, 50.0)},
    "layer": lambda steel, k: {
        "stiffness": 0.3 * k,
        "layers": [(0.7 * k, vv.PronyKernel(weights=[40.0], rates=[100.0]))],
        "rayleigh": (0.5, 1e-6),
    },
}


def turned(steel, rate):
    n = steel.mass.shape[0]
    i, j = steel.w[3, 3], steel.w[5, 5]
    return csc_array(([rate, -rate], ([i, j], [j, i])), shape=(n, n))


@pytest.mark.parametrize("kind", MODELS)
@pytest.mark.parametrize("tolerance", [1e-4, 1e-8])
def test_error_is_estimated_and_kept(steel, kind, tolerance):
    k = steel.stiffness + springs(steel, 1e6)
    model = LinearModel(steel.mass, k)._replace(**MODELS[kind](steel, k))
    directions = loads(steel)
    reduced = reduce_model(model, directions, frequency=TOP, tolerance=tolerance)
    assert reduced.largest_error <= tolerance
    found = errors(model, reduced, directions)
    assert found.max() < reduced.largest_error + 1e-9
    # The estimate is close to the error at the highest frequency, where it is largest.
    assert found[-1] > 0.1 * reduced.error[-1]
    assert reduced.squares.size < 130


def test_held_coordinates_give_the_same(steel):
    k = steel.stiffness + springs(steel, 1e6)
    model = LinearModel(steel.mass, k, rayleigh=(0.5, 1e-6))
    directions = loads(steel)
    boundary = np.flatnonzero(directions.any(axis=1))
    reduced = reduce_model(
        model, directions, frequency=TOP, tolerance=1e-6, boundary=boundary.tolist()
    )
    assert errors(model, reduced, directions).max() < 1e-6
    squares = eigh(k.toarray(), steel.mass.toarray(), eigvals_only=True)
    np.testing.assert_allclose(reduced.squares[:30], squares[:30], rtol=1e-6)


def test_modal_ratios_are_those_of_the_modes(steel):
    k = steel.stiffness + springs(steel, 1e6)
    model = LinearModel(steel.mass, k, ratio=[0.05, 0.02])
    directions = loads(steel)
    reduced = reduce_model(model, directions, frequency=TOP, tolerance=1e-7)
    squares, shapes = eigh(k.toarray(), steel.mass.toarray())
    omega = np.sqrt(squares)
    m = reduced.n_modes
    rates = 2 * 0.02 * omega
    rates[0] = 2 * 0.05 * omega[0]
    rates[m:] = 2 * 0.02 / omega[m - 1] * squares[m:]
    weighted = steel.mass @ shapes
    extra = (weighted * rates) @ weighted.T
    assert errors(model, reduced, directions, extra).max() < 1e-7
    np.testing.assert_allclose(reduced.rates[:m], rates[:m], rtol=1e-9)


def test_rigid_modes_are_zero_and_counted(steel):
    model = LinearModel(steel.mass, steel.stiffness, rayleigh=(0.5, 1e-6))
    directions = loads(steel)
    reduced = reduce_model(model, directions, frequency=TOP, lowest=1.0)
    assert reduced.n_rigid == 3
    assert (reduced.squares[:3] == 0).all()
    assert errors(model, reduced, directions).max() < 1e-6


def test_rounding_of_a_fine_mesh_is_not_seen():
    """A bar of 800 elements with closed-form modes: errors of 1e-14, with 1e-11 in K."""
    n = 800
    stiffness = csc_array(n * diags_array([-1.0, 2, -1], offsets=[-1, 0, 1], shape=(n, n)))
    mass = csc_array(diags_array(np.full(n, 1 / n)))
    model = LinearModel(mass, stiffness, rayleigh=(0.05, 1e-3))
    load = np.zeros((n, 1))
    load[239] = 1
    reduced = reduce_model(model, load, frequency=60.0)
    j = np.arange(1, n + 1)
    squares = (2 * n * np.sin(j * np.pi / 2 / (n + 1))) ** 2
    shapes = np.sqrt(2 * n / (n + 1)) * np.sin(np.outer(j, j) * np.pi / (n + 1))
    np.testing.assert_allclose(reduced.squares[:20], squares[:20], rtol=1e-14)
    for omega in (2.0, 59.0):
        s = 1j * omega
        exact = shapes @ ((shapes.T @ load[:, 0]) / (squares + (0.05 + 1e-3 * squares) * s + s**2))
        direct = direct_solution(model, s, load[:, 0].astype(complex))
        np.testing.assert_allclose(direct, exact, atol=1e-13 * np.abs(exact).max())
        sections = reduced.squares + reduced.rates * s + s**2
        found = reduced.shapes @ ((reduced.shapes.T @ load[:, 0]) / sections)
        claimed = np.interp(omega, reduced.at, reduced.error)
        assert np.abs(found - exact).max() < (claimed + 1e-13) * np.abs(exact).max()


@pytest.mark.parametrize("stiffness", [-1e6, -1e8])
def test_negative_modes_are_all_found(steel, stiffness):
    """Also negative modes beyond the shift, counted by Sylvester's law."""
    k = steel.stiffness + springs(steel, stiffness)
    squares = eigh(k.toarray(), steel.mass.toarray(), eigvals_only=True)
    model = LinearModel(steel.mass, k, rayleigh=(0.5, 1e-6))
    reduced = reduce_model(model, loads(steel), frequency=TOP)
    assert reduced.n_negative == (squares < 0).sum() == 4
    np.testing.assert_allclose(reduced.squares[:4], squares[:4], rtol=1e-9)


@pytest.mark.parametrize("pushed", [False, True])
def test_coordinates_without_mass_are_condensed(steel, pushed):
    n = steel.mass.shape[0]
    mass = np.zeros(n)
    mass[steel.w.ravel()] = 0.7
    k = steel.stiffness + springs(steel, 1e6)
    model = LinearModel(csc_array(diags_array(mass)), k, loss=0.05)
    directions = loads(steel)
    if not pushed:
        directions[steel.w[4, 5] + 1, 2] = 0
    reduced = reduce_model(model, directions, frequency=TOP)
    assert reduced.static.shape[1] == pushed
    assert errors(model, reduced, directions).max() < 1e-6
    # Static condensation by the Schur complement.
    massive = np.flatnonzero(mass)
    rest = np.setdiff1d(np.arange(n), massive)
    full = k.toarray()
    coupling = np.linalg.solve(full[np.ix_(rest, rest)], full[np.ix_(rest, massive)])
    condensed = full[np.ix_(massive, massive)] - full[np.ix_(massive, rest)] @ coupling
    squares = np.linalg.eigvalsh(condensed) / 0.7
    np.testing.assert_allclose(reduced.squares[: reduced.n_modes], squares[: reduced.n_modes], 1e-7)


def test_equal_modes_are_found_as_often_as_they_are(steel):
    """Three equal separate plates: every mode three times."""
    k = steel.stiffness + springs(steel, 1e6)
    mass, stiffness = (csc_array(block_diag([m] * 3)) for m in (steel.mass, k))
    found = Pencil(mass, stiffness, -1e4).lowest_modes((2 * np.pi * 300) ** 2, 1000)
    squares = eigh(k.toarray(), steel.mass.toarray(), eigvals_only=True)
    below = squares[squares < (2 * np.pi * 300) ** 2].repeat(3)
    np.testing.assert_allclose(found.squares[: below.size], below, rtol=1e-8)
    gram = found.shapes.T @ (mass @ found.shapes)
    np.testing.assert_allclose(gram, np.eye(found.squares.size), atol=1e-9)


def supported(n_x, n_y):
    """The first 8 frequencies of a plate supported at its edges."""
    made = plate(n_x, n_y, length=1.2, width=1.0, thickness=0.01, young=2e11, density=7800.0)
    # w and its slope along the edge are fixed; coordinates of a node: w, w_y; then w_x, w_xy.
    along = (made.w[1, 0] - made.w[0, 0]) // 2
    held = {*made.w[[0, -1]].ravel(), *made.w[:, [0, -1]].ravel()}
    held |= {c + 1 for c in made.w[[0, -1]].ravel()}
    held |= {c + along for c in made.w[:, [0, -1]].ravel()}
    free = np.setdiff1d(np.arange(made.mass.shape[0]), list(held))
    cut = np.ix_(free, free)
    found = Pencil(csc_array(made.mass[cut]), csc_array(made.stiffness[cut]), -1.0)
    return np.sqrt(found.lowest_modes((2 * np.pi * 300) ** 2, 100).squares[:8])


def test_plate_has_the_frequencies_of_the_exact_theory():
    """Simply supported: omega = pi^2 (m^2/a^2 + n^2/b^2) sqrt(D/(rho t)), Leissa 1969."""
    rigidity = 2e11 * 0.01**3 / 12 / (1 - 0.3**2)
    m, n = np.meshgrid(np.arange(1, 12), np.arange(1, 12))
    exact = np.pi**2 * ((m / 1.2) ** 2 + n**2) * np.sqrt(rigidity / (7800 * 0.01))
    exact = np.sort(exact.ravel())[:8]
    coarse, fine = supported(12, 10) / exact - 1, supported(24, 20) / exact - 1
    # Convergence from above, with the fourth power of the element size.
    assert (fine > 0).all()
    assert fine.max() < 1e-4
    np.testing.assert_allclose(coarse / fine, 16, rtol=0.1)


def block(k):
    second = diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(k, k))
    mean = diags_array([1.0, 4.0, 1.0], offsets=[-1, 0, 1], shape=(k, k))
    sides = [kron(kron(a, b), c) for a, b, c in [(second, mean, mean), (mean, second, mean)]]
    return csc_array(kron(sum(sides) + kron(kron(mean, mean), second), np.eye(3) + 0.3))


@pytest.mark.parametrize(
    "matrix",
    [
        lambda: plate(40, 40, length=1, width=1, thickness=1, young=1, density=1),
        lambda: plate(200, 8, length=5, width=1, thickness=1, young=1, density=1),
        lambda: block(8),
        lambda: block(12),
    ],
)
def test_fill_is_estimated(matrix):
    made = matrix()
    shifted = made if hasattr(made, "nnz") else csc_array(made.stiffness + made.mass)
    assert 0.5 < estimated_fill(shifted) / factored(shifted, symmetric=True).nnz < 2


def test_what_does_not_fit_is_refused_at_once(monkeypatch):
    made = plate(20, 20, length=1, width=1, thickness=1, young=1, density=1)
    monkeypatch.setattr("viscovib.systems.sparse_pencil.free_memory", lambda: 1e6)
    with pytest.raises(vv.InputError, match=r"1764 coordinates .* need about .* GB to factor"):
        Pencil(made.mass, made.stiffness, -1.0)


def test_a_coordinate_without_mass_and_stiffness_is_refused():
    mass = csc_array(diags_array([1.0, 0.0]))
    with pytest.raises(vv.InputError, match="neither mass nor stiffness"):
        Pencil(mass, mass, -1.0)


def test_a_tolerance_out_of_reach_is_refused(steel):
    k = steel.stiffness + springs(steel, 1e6)
    model = LinearModel(steel.mass, k, rayleigh=(0.5, 1e-6))
    with pytest.raises(vv.InputError, match=r"tolerance = 1e-20: .* must be larger"):
        reduce_model(model, loads(steel), frequency=TOP, tolerance=1e-20)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (coo_array(np.eye(2) * 1j), "mass: must be real, got complex numbers"),
        (csc_array((2, 3)), r"mass: must be square, got shape \(2, 3\)"),
        (csc_array([[1.0, 0], [0, np.nan]]), r"mass\[1, 1\] = nan: must be a finite number"),
    ],
)
def test_wrong_matrices(value, message):
    with pytest.raises(vv.InputError, match=message):
        checked_sparse("mass", value)
