"""Branches along parameters of elements, against structures with these values."""

import numpy as np
import pytest
import scipy.sparse as sp
import viscovib as vv

pytestmark = pytest.mark.filterwarnings("ignore:.*do not reach the tolerance")

N = 8
KERNEL = vv.PronyKernel(weights=[0.3], rates=[1.5])


def chain(kernel=None, *, sparse=False, **numbers):
    """Spring and law at the end, another element in the middle."""
    given = {"k": 0.3, "k3": 0.5, "F0": 0.2, "w": 0.7} | numbers
    k = 2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1)
    elements = [
        vv.Spring(on=f"x{N}", stiffness=given["k"], law="k3*d^3 + 0.1*d^2",
                  parameters={"k3": given["k3"]}, kernel=kernel),
        vv.Spring(on=("x4", "x7"), law="F0*tanh(d/w)",
                  parameters={"F0": given["F0"], "w": given["w"]}),
    ]  # fmt: skip
    matrix = sp.csc_array(k) if sparse else k
    mass = sp.eye_array(N) if sparse else np.ones(N)
    # A matrix: modal damping would refer to the modes of the initial values.
    damping = 0.02 * matrix
    return vv.Structure(mass=mass, stiffness=matrix, damping=damping, elements=elements)


LOAD = np.eye(N)[0] * 0.05
NU = 0.25


@pytest.mark.parametrize(
    ("name", "key", "ends"),
    [
        ("elements[0].stiffness", "k", (0.1, 0.8)),
        ("elements[0].k3", "k3", (0.2, 1.5)),
        ("elements[1].F0", "F0", (0.05, 0.6)),
        ("elements[1].w", "w", (0.4, 1.2)),
    ],
)
@pytest.mark.parametrize("kernel", [None, KERNEL], ids=["elastic", "relaxing"])
def test_as_structures_with_these_numbers(name, key, ends, kernel):
    branch = vv.trace_response(
        chain(kernel), nu=NU, vary=name, vary_range=ends, load=LOAD, harmonics=3, tolerance=1e-9,
        max_step=0.5,
    )  # fmt: skip
    assert branch.outcome == "completed"
    assert branch.varies == name
    assert branch.dof_names == tuple(f"x{i + 1}" for i in range(N))
    for i in (0, branch.nu.size // 2, branch.nu.size - 1):
        value = float(branch.parameter[i])
        alone = vv.forced_response(
            chain(kernel, **{key: value}), [NU], load=LOAD, harmonics=3, method="newton",
            stability=True,
        )  # fmt: skip
        error = np.abs(alone.coefficients[0] - branch.coefficients[i]).max()
        assert error < 2e-7 * np.abs(alone.coefficients).max()
        assert alone.stable[0] == branch.stable[i]


def test_factor_of_memory():
    branch = vv.trace_response(
        chain(KERNEL), nu=NU, vary="memory_scale", vary_range=(0.2, 1.0), load=LOAD, harmonics=5,
        stability=False,
    )  # fmt: skip
    weak = vv.PronyKernel(weights=[0.3 * branch.parameter[0]], rates=[1.5])
    for i, kernel in ((0, weak), (-1, KERNEL)):
        alone = vv.forced_response(chain(kernel), [NU], load=LOAD, harmonics=5, method="newton")
        assert np.abs(alone.coefficients[0] - branch.coefficients[i]).max() < 1e-9


def test_fold_along_a_coefficient_and_its_peak():
    """A fold along a coefficient is a fold of the branch in the frequency at this value."""
    structure = vv.Structure(
        mass=np.ones(N), stiffness=chain().stiffness, modal_damping=0.002,
        elements=[vv.Spring(on=f"x{N}", law="k3*d^3", parameters={"k3": 0.5})],
    )  # fmt: skip
    first = np.sqrt(np.linalg.eigvalsh(structure.stiffness)[0])
    branch = vv.trace_response(
        structure, nu=1.02 * first, vary="elements[0].k3", vary_range=(0.001, 2), load=LOAD,
        harmonics=5,
    )  # fmt: skip
    assert branch.folds.size == 2
    value = float(branch.folds[0])
    there = vv.Structure(
        mass=np.ones(N), stiffness=chain().stiffness, modal_damping=0.002,
        elements=[vv.Spring(on=f"x{N}", law="k3*d^3", parameters={"k3": value})],
    )  # fmt: skip
    along = vv.trace_response(there, (0.9 * first, 1.1 * first), load=LOAD, harmonics=5)
    assert np.abs(along.folds / (1.02 * first) - 1).min() < 1e-7
    peak = branch.peak(f"x{N}")
    assert peak.amplitude >= np.abs(branch.coefficient(f"x{N}", 1)).max() * (1 - 1e-9)


def test_reduced_structure_varies_with_its_modes():
    whole = chain(KERNEL)
    small = chain(KERNEL, sparse=True).reduce(frequency=2.0, tolerance=1e-9, loads=["x1"])
    given = {"nu": NU, "vary": "elements[0].stiffness", "vary_range": (0.1, 0.5), "load": LOAD}
    a, b = (
        vv.trace_response(s, **given, harmonics=3, stability=False, coordinates=["x8"])
        for s in (whole, small)
    )
    for x, y in ((a.coefficients[0], b.coefficients[0]), (a.coefficients[-1], b.coefficients[-1])):
        assert np.abs(x - y).max() < 1e-6 * np.abs(x).max()


@pytest.mark.parametrize(
    ("name", "reported"),
    [
        ("mass", "must be 'memory_scale', or a number of an element"),
        (3, "must be 'memory_scale'"),
        ("elements[7].k", "the structure has 2 elements"),
        ("elements[0].q", "must be one of stiffness, k3 of this element"),
        ("memory_scale", "the structure has no kernel"),
    ],
)
def test_refused(name, reported):
    with pytest.raises(vv.InputError, match=r"^vary = ") as caught:
        vv.trace_response(chain(), nu=NU, vary=name, vary_range=(0.1, 1), load=LOAD)
    assert reported in f"{caught.value}"


GIVEN = {
    0: {"stiffness": 3.0, "limit": 0.2},
    1: {"stiffness": 1.0, "beta": 1.0, "gamma": 0.5, "ratio": 0.1, "exponent": 1.5},
    2: {"stiffness": 5.0, "gap": 0.3},
    3: {"stiffness": 2.0, "gap": -0.05},
    4: {"stiffness": 2.0, "limit": 0.3, "exponent": 1.0},
}


def joints(place=0, **numbers):
    """Two masses with an element of each kind."""
    given = {i: kept | numbers if i == place else kept for i, kept in GIVEN.items()}
    elements = [
        vv.Jenkins(on="x1", **given[0]), vv.BoucWen(on="x2", **given[1]),
        vv.Stop(on="x2", **given[2]), vv.Gap(on="x1", **given[3]),
        vv.Dahl(on=("x1", "x2"), **given[4]),
    ]  # fmt: skip
    return vv.Structure(
        mass=np.eye(2), stiffness=[[2, -1.0], [-1, 2]], damping=[0.1, 0.1], elements=elements
    )


@pytest.mark.parametrize(
    ("place", "key", "ends"),
    [
        (0, "limit", (0.1, 0.4)), (1, "ratio", (0.05, 0.5)), (2, "gap", (0.2, 0.5)),
        (3, "gap", (-0.05, 0.2)), (4, "exponent", (0.7, 2.0)),
    ],
)  # fmt: skip
def test_numbers_of_elements_with_states_and_stops(place, key, ends):
    branch = vv.trace_response(
        joints(), vary=f"elements[{place}].{key}", vary_range=ends, nu=1.1, load=[0.8, 0],
        harmonics=3, tolerance=1e-9, max_step=0.5, stability=False,
    )  # fmt: skip
    assert branch.outcome == "completed"
    i = branch.nu.size - 2
    assert branch.parameter[i] != pytest.approx(ends[1], rel=1e-3)
    alone = vv.forced_response(
        joints(place, **{key: float(branch.parameter[i])}), [1.1], load=[0.8, 0], harmonics=3,
        method="newton", tolerance=1e-9,
    )  # fmt: skip
    error = np.abs(alone.coefficients[0] - branch.coefficients[i]).max()
    assert error < 1e-8 * np.abs(alone.coefficients).max()


def test_numbers_that_an_element_does_not_have():
    def trace(name, ends=(0.1, 0.5)):
        vv.trace_response(joints(), vary=name, vary_range=ends, nu=1.1, load=[0.8, 0])

    for name, reported in [
        ("elements[0].gap", "must be one of stiffness, limit of this element"),
        ("elements[2].restitution", "must be one of gap, stiffness, exponent of"),
    ]:
        with pytest.raises(vv.InputError, match=reported):
            trace(name)
    with pytest.raises(vv.InputError, match=r"ratio = 1: must be in \[0, 1\)"):
        trace("elements[1].ratio", (0.1, 1.0))
