"""Structures with sparse matrices: reduced models against full and dense ones."""

import numpy as np
import pytest
import viscovib as vv
from models_of_structures import plate
from scipy.sparse import csc_array, diags_array

#: Both models use the same few harmonics, for any truncation.
pytestmark = pytest.mark.filterwarnings("ignore:.*do not reach the tolerance")
TOP = 2 * np.pi * 400


@pytest.fixture(scope="module")
def steel():
    return plate(8, 8, length=1.2, width=1.0, thickness=0.01, young=2e11, density=7800.0)


def mounted(steel, *, dense=False, **given):
    """A plate on four hardening mounts, two with memory."""
    kernel = vv.RabotnovKernel(amplitude=3.0, alpha=0.6, beta=12.0)
    corners = steel.w[[1, 1, -2, -2], [1, -2, 1, -2]]
    elements = [
        vv.Spring(on=int(c), stiffness=4e5, law="2e15*d^3", kernel=kernel if i < 2 else None)
        for i, c in enumerate(corners)
    ]
    mass, stiffness = steel.mass, steel.stiffness
    if dense:
        mass, stiffness = mass.toarray(), stiffness.toarray()
    given = {"rayleigh": (1.0, 2e-6)} | given
    return vv.Structure(mass=mass, stiffness=stiffness, elements=elements, **given)


def pushed(steel):
    load = np.zeros(steel.mass.shape[0])
    load[steel.w[3, 5]] = 15.0
    return load


DAMPINGS = {
    "rayleigh": {},
    "loss factor": {"rayleigh": None, "loss_factor": 0.05},
    "dashpots": {"rayleigh": None, "damping": 1.0},
}


@pytest.mark.parametrize("damping", DAMPINGS)
def test_reduced_plate_moves_as_the_whole_one(steel, damping):
    given = dict(DAMPINGS[damping])
    n = steel.mass.shape[0]
    if "damping" in given:
        diagonal = np.zeros(n)
        diagonal[steel.w[4, ::2]] = 20.0
        given["damping"] = csc_array(diags_array(diagonal)) + 2e-6 * steel.stiffness
    sparse = mounted(steel, **given)
    if "damping" in given:
        given["damping"] = given["damping"].toarray()
    whole = mounted(steel, dense=True, **given)
    nu = np.linspace(0.1, 0.3, 5) * TOP
    asked = {
        "load": pushed(steel), "method": "newton", "harmonics": 3,
        "coordinates": [f"x{steel.w[i, j] + 1}" for i, j in [(1, 1), (3, 5), (6, 2)]],
    }  # fmt: skip
    other = vv.forced_response(whole, nu, **asked)
    largest = np.abs(other.coefficients).max(axis=(1, 2))
    for method in ("modes", "craig-bampton"):
        small = sparse.reduce(frequency=TOP, tolerance=1e-8, loads=[pushed(steel)], method=method)
        assert small.reduction.squares.size < 150
        one = vv.forced_response(small, nu, **asked)
        assert one.converged.all()
        assert np.abs(one.coefficients[:, :, 1]).max() > 1e-4 * np.abs(one.coefficients).max()
        difference = np.abs(one.coefficients - other.coefficients).max(axis=(1, 2)) / largest
        assert difference.max() < 1e-7
        assert one.reduction_error.max() < 1e-8
        assert "static corrections" in str(one.plan)
        text = repr(small)
        assert text.startswith("<Structure: 324 coordinates in sparse matrices, 4 elements, red")
        assert "\n" not in text


def test_harmonics_above_the_band_are_reported(steel):
    small = mounted(steel).reduce(frequency=TOP / 4, loads=[pushed(steel)])
    with pytest.warns(vv.ConvergenceWarning, match="for which the structure was not reduced"):
        r = vv.forced_response(
            small, [0.24 * TOP], load=pushed(steel), method="newton", harmonics=3
        )
    third = np.abs(r.deflections[0, :, 1]).max() / np.abs(r.deflections[0]).max()
    assert r.reduction_error[0] == pytest.approx(third, rel=0.1)


def test_a_load_elsewhere_is_refused(steel):
    small = mounted(steel).reduce(frequency=TOP, loads=[pushed(steel)])
    with pytest.raises(vv.InputError, match=r"load: acts on 'x8' .* loads=\[...\]"):
        vv.forced_response(small, [100.0], load={"x8": 1.0})


def test_base_motion_of_a_reduced_structure(steel):
    direction = np.zeros(steel.mass.shape[0])
    direction[steel.w.ravel()] = 1.0
    given = {"base_direction": direction}
    small = mounted(steel, **given).reduce(frequency=TOP, tolerance=1e-8)
    whole = mounted(steel, dense=True, **given)
    asked = {"base": 1e-5, "method": "newton", "harmonics": 3, "coordinates": ["x1", "x200"]}
    one, other = (vv.forced_response(s, [200.0, 430.0], **asked) for s in (small, whole))
    largest = np.abs(other.coefficients).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(one.coefficients / largest, other.coefficients / largest, atol=1e-7)


def test_large_sparse_structures_must_be_reduced(steel):
    n = 1200
    chain = diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n))
    s = vv.Structure(mass=np.ones(n), stiffness=chain, elements=[vv.Spring(on=0, law="d^3")])
    with pytest.raises(vv.InputError, match=r"1200 coordinates in sparse matrices, .* reduce them"):
        vv.forced_response(s, [0.1], load={"x1": 1.0})


def test_small_sparse_structures_are_as_dense_ones():
    n = 20
    chain = diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n))
    given = {"mass": np.ones(n), "elements": [vv.Spring(on=0, law="d^3")], "modal_damping": 0.01}
    sparse, dense = (vv.Structure(stiffness=k, **given) for k in (chain, chain.toarray()))
    found = [
        vv.forced_response(s, [0.1, 0.2], load={"x20": 0.01}, method="newton").coefficients
        for s in (sparse, dense)
    ]
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize("damping", ["none", "rayleigh", "loss_factor"])
def test_coordinates_without_mass_follow_at_once(damping):
    """A chain with massless joints, one of them with a spring, against small masses."""
    n = 8
    k = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    mass = np.ones(n)
    mass[[2, 5]] = 0.0
    given = {
        "none": {}, "rayleigh": {"rayleigh": (0.02, 0.01)}, "loss_factor": {"loss_factor": 0.02},
    }[damping]  # fmt: skip
    given |= {"stiffness": k, "elements": [vv.Spring(on="x3", law="0.5*d^3", stiffness=0.3)]}
    found = []
    for tiny in (0.0, 1e-5, 2e-5):
        s = vv.Structure(mass=mass + tiny * (mass == 0), **given)
        r = vv.forced_response(
            s, [0.3, 0.4], load={"x6": 0.05, "x1": 0.02}, method="newton", harmonics=5
        )
        assert r.converged.all()
        found.append(r.coefficients)
    limit = 2 * found[1] - found[2]
    np.testing.assert_allclose(found[0], limit, atol=1e-8 * np.abs(limit).max(), rtol=0)


def test_damped_coordinates_without_mass_are_refused():
    s = vv.Structure(mass=[1.0, 0.0], stiffness=np.eye(2), damping=np.eye(2))
    with pytest.raises(vv.InputError, match="coordinate 1 has no mass, and must not have damping"):
        vv.forced_response(s, [0.3], load=[1.0, 0])


WRONG = {
    "mass: must be square": {"mass": csc_array((3, 2)), "stiffness": np.eye(3)},
    r"stiffness: must be \(3, 3\) as mass is, got shape \(2, 2\)": {
        "mass": np.ones(3), "stiffness": csc_array(np.eye(2)),
    },
    r"mass\[1, 1\] = -1: must not be negative": {
        "mass": csc_array(np.diag([1.0, -1])), "stiffness": np.eye(2),
    },
    "stiffness: must be real, got complex": {
        "mass": np.ones(2), "stiffness": csc_array(1j * np.eye(2)),
    },
    "mass: must not be 0 everywhere": {"mass": csc_array((2, 2)), "stiffness": np.eye(2)},
    "mass: row 1 has 0 on its diagonal": {
        "mass": csc_array([[1.0, 0.1], [0.1, 0]]), "stiffness": np.eye(2),
    },
}  # fmt: skip


@pytest.mark.parametrize("message", WRONG)
def test_wrong_matrices(message):
    with pytest.raises(vv.InputError, match=message):
        vv.Structure(**WRONG[message])


REFUSED = {
    "frequency = 0: must be 1e-50 to 1e50": {"frequency": 0.0},
    r"frequency = 1e\+199: must be": {"frequency": 1e199},
    "lowest = 1e\\+06: must be at least 0 and below frequency": {"lowest": 1e6},
    "tolerance = 1e-14: must be 1e-12 to 0.1": {"tolerance": 1e-14},
    "method = 'best': must be one of": {"method": "best"},
    r"loads\[0\] = 'y': must be one of the": {"loads": ["y"]},
    "loads = 'x1': must be a list": {"loads": "x1"},
    "there are more than 30 modes": {"max_modes": 30, "frequency": 2 * TOP},
}


@pytest.mark.parametrize("message", REFUSED)
def test_wrong_reductions(steel, message):
    with pytest.raises(vv.InputError, match=message):
        mounted(steel).reduce(**{"frequency": TOP, "loads": ["x1"]} | REFUSED[message])


@pytest.mark.filterwarnings("ignore:.*was not reduced")
@pytest.mark.parametrize("seed", range(6))
def test_a_basis_holds_nothing_twice(seed):
    # In a small chain with massless coordinates static vectors soon span everything.
    rng = np.random.default_rng(seed)
    n = int(rng.integers(6, 48))
    k = rng.uniform(0.5, 2, n + 1)
    stiffness = diags_array([k[:-1] + k[1:], -k[1:-1], -k[1:-1]], offsets=[0, 1, -1])
    mass = rng.uniform(0.5, 2, n)
    mass[rng.integers(0, n, 3)] = 0.0
    ends = (int(rng.integers(n)), int(rng.integers(n)))
    on = (
        {f"x{ends[0] + 1}": 1.0}
        if ends[0] == ends[1]
        else dict(zip([f"x{e + 1}" for e in ends], (1.0, -1.0), strict=True))
    )
    spring = vv.Spring(on=on, stiffness=0.06, law="0.4*d^3")
    whole = vv.Structure(
        mass=mass, stiffness=csc_array(stiffness), rayleigh=(0.005, 0.002), elements=[spring]
    )
    load, nu = {f"x{int(rng.integers(n)) + 1}": 0.01}, [float(rng.uniform(0.1, 0.6))]
    asked = {"load": load, "method": "newton", "harmonics": 5}
    every = list(whole.dof_names)
    dense = vv.Structure(
        mass=np.diag(mass), stiffness=stiffness.toarray(), rayleigh=(0.005, 0.002),
        elements=[spring],
    )  # fmt: skip
    true = vv.forced_response(dense, nu, coordinates=every, **asked)
    for method in ("modes", "craig-bampton"):
        small = whole.reduce(frequency=0.65, tolerance=1e-4, loads=list(load), method=method)
        r = vv.forced_response(small, nu, coordinates=every, **asked)
        off = np.abs(r.coefficients - true.coefficients).max()
        assert off < 3e-3 * np.abs(true.coefficients).max()


@pytest.mark.parametrize("mass", [[1.0, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 0.0]])
@pytest.mark.parametrize("method", ["modes", "craig-bampton"])
@pytest.mark.parametrize("loads", [["x3"], ["x2", "x3"], [[1, 0.5, 0.2]]])
def test_elements_and_loads_may_touch_everything(mass, method, loads):
    """Also if nothing, or nothing with mass, remains between the fixed coordinates."""
    stiffness = np.diag([2.0, 2, 2]) - np.diag([1.0, 1], 1) - np.diag([1.0, 1], -1)
    whole = vv.Structure(
        mass=mass, stiffness=stiffness, damping=[0.1, 0, 0],
        elements=[vv.Spring(on="x1", law="0.5*d^3")],
    )  # fmt: skip
    small = whole.reduce(frequency=8.0, loads=loads, method=method)
    load = np.zeros(3)
    for one in loads:
        load += one if not isinstance(one, str) else np.eye(3)[int(one[1]) - 1]
    found, true = (
        vv.forced_response(
            s, [0.7, 1.3], load=0.3 * load, method="newton", harmonics=5,
            coordinates=["x1", "x2", "x3"],
        ).coefficients
        for s in (small, whole)
    )  # fmt: skip
    assert found == pytest.approx(true, abs=1e-10)
