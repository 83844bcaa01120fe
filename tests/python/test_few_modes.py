"""Structures with few modes: multiple scales, and roots of reduced models."""

import numpy as np
import pytest
import scipy.sparse as sp
import viscovib as vv

PRONY = vv.PronyKernel(weights=[0.02], rates=[0.1])
K = 2 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1)


def chain(n=200, *, law="0.005*d^3", **more):
    k = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n)).tocsc()
    joint = vv.Spring(on="x100", stiffness=0.05, law=law, kernel=PRONY)
    return vv.Structure(mass=sp.eye_array(n), stiffness=k, elements=[joint], **more)


@pytest.mark.parametrize("kernel", [None, PRONY])
@pytest.mark.parametrize("layered", [False, True])
def test_all_modes_are_the_whole_system(kernel, layered):
    """Three coordinates, in modal and physical coordinates."""
    spring = vv.Spring(on=("x1", "x3"), stiffness=0.4, law="0.3*d^2 + 0.5*d^3", kernel=kernel)
    layer = np.diag([0.3, 0.1, 0.0])
    structure = vv.Structure(
        mass=[1, 2, 1.5], stiffness=K, damping=0.02 * K, elements=[spring],
        layers=[(layer, PRONY)] if layered else [],
    )  # fmt: skip
    e = np.array([1, 0, -1.0])
    forces = {"x1": "0.3*(x1-x3)^2 + 0.5*(x1-x3)^3", "x3": "-0.3*(x1-x3)^2 - 0.5*(x1-x3)^3"}
    springs = [vv.Springs(stiffness=0.4 * np.outer(e, e), forces=forces, kernel=kernel)]
    springs += [vv.Springs(stiffness=layer, kernel=PRONY)] if layered else []
    whole = vv.PolynomialSystem(mass=[1, 2, 1.5], stiffness=K, damping=0.02 * K, springs=springs)
    a = vv.MultipleScales(structure, load={"x1": 0.02}, nu=0.8)
    b = vv.MultipleScales(whole, load=[0.02, 0, 0], nu=0.8)
    assert a.modes_left_out < 1e-12
    assert np.abs(a.exponents - b.exponents).max() < 1e-12
    nu = np.linspace(0.5, 0.9, 5)
    first, second = a.response("nu", nu), b.response("nu", nu)
    assert first.dof_names == whole.dof_names
    assert np.abs(first.harmonics - second.harmonics).max() < 1e-11


@pytest.mark.parametrize("damping", [{"modal_damping": 0.01}, {"rayleigh": (1e-4, 0.1)}])
def test_a_reduced_chain_as_by_harmonic_balance(damping):
    """The error of the expansion is of fourth order; the error of omitted modes is stated."""
    small = chain(**damping).reduce(frequency=0.2, loads=["x100"])
    nu = np.linspace(0.034, 0.042, 3)
    off = []
    for size in (2e-4, 1e-4):
        given = {"load": {"x100": size}}
        scales = vv.MultipleScales(small, nu=0.04, modes=[0, 2, 4, 6], **given)
        assert scales.modes_left_out < 2e-3
        found = scales.response("nu", nu)
        exact = vv.forced_response(small, nu, method="newton", coordinates=["x100"], **given)
        seen = np.abs(found.harmonics[:, found.dof_names.index("x100")])
        off.append(np.abs(seen / np.abs(exact.coefficients[:, 0, 0]) - 1).max())
    assert off[0] < 0.02
    assert off[1] < 8e-3


def test_few_modes_are_reported():
    with pytest.warns(vv.RangeWarning, match="do not contain 0.2"):
        vv.MultipleScales(chain(modal_damping=0.01), load={"x100": 1e-4}, nu=0.04, modes=[0, 1])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({}, "modes: the structure has 200"),
        ({"modes": [0, 0]}, "must be at most 6 different ones"),
        ({"modes": "01"}, "must be a list of numbers"),
        ({"modes": [200]}, "modes = 200"),
        ({"modes": [0], "load": {"y": 1}}, "y"),
    ],
)
def test_bad_modes(given, words):
    with pytest.raises(vv.InputError, match=words):
        vv.MultipleScales(chain(), nu=0.04, **given)


def test_laws_without_an_expansion():
    with pytest.raises(vv.InputError, match="must have polynomial laws"):
        vv.MultipleScales(chain(law="tanh(d) - d"), modes=[0])
    with pytest.raises(vv.InputError, match="modes: are for a Structure"):
        vv.MultipleScales(vv.PolynomialSystem(mass=1, stiffness=1), modes=[0])


def test_roots_of_a_reduced_model_with_modal_ratios():
    n = 200
    small = chain(modal_damping=0.01).reduce(frequency=0.2, loads=["x1"])
    found = small.characteristic_roots(3).oscillatory
    e, k = np.eye(n)[99], 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    squares, shapes = np.linalg.eigh(k + 0.05 * np.outer(e, e))
    matrix = np.zeros((2 * n + 1, 2 * n + 1))
    matrix[:n, n : 2 * n] = np.eye(n)
    matrix[n : 2 * n, :n] = -(shapes * squares) @ shapes.T
    matrix[n : 2 * n, n : 2 * n] = -(shapes * 0.02 * np.sqrt(squares)) @ shapes.T
    matrix[n : 2 * n, -1], matrix[-1, :n], matrix[-1, -1] = 0.05 * e, 0.02 * e, -0.1
    roots = np.linalg.eigvals(matrix)
    # Above the modes kept the damping increases with the frequency; the static part differs.
    for s in found:
        assert np.abs(roots / s - 1).min() < 1e-6
