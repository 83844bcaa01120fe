"""Structures condensed to the deflections of their elements, against the full system."""

import pickle

import numpy as np
import pytest
import scipy.linalg
import viscovib as vv
from viscovib._native import ComplexArray, FloatArray

#: Both models use the same few harmonics, for any truncation.
pytestmark = [
    pytest.mark.filterwarnings("ignore:.*do not reach the tolerance"),
    pytest.mark.filterwarnings("ignore:successive approximations do not converge"),
]

ABEL = vv.RzhanitsynKernel(amplitude=0.08, alpha=0.3, beta=0.4)
RUBBER = vv.RabotnovKernel(amplitude=0.3, alpha=0.5, beta=0.9)


def chain(n: int) -> FloatArray:
    """Stiffness of unit masses with unit springs, both ends fixed."""
    return 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)


def both(n: int, law: str, *, stiffness: FloatArray | None = None, **more: object) -> tuple:
    """The chain with a law at its end, full and condensed."""
    k = chain(n) if stiffness is None else stiffness
    end = f"x{n}"
    whole = vv.PolynomialSystem(
        mass=np.ones(n), stiffness=k, forces={end: law.replace("d", end)}, **more
    )
    spring = vv.Spring(on=end, law=law)
    return whole, vv.Structure(mass=np.ones(n), stiffness=k, elements=[spring], **more)


def difference(a: vv.Response, b: vv.Response) -> float:
    """Difference of the motions found by both, relative to the largest coefficient."""
    assert (a.converged == b.converged).all()
    assert a.converged.sum() > 0.8 * a.nu.size
    kept = min(a.harmonics.size, b.harmonics.size)
    one, other = (x.coefficients[x.converged][..., :kept] for x in (a, b))
    return float(np.abs(one - other).max() / np.abs(one).max())


@pytest.mark.parametrize(("n", "method"), [(2, "linear"), (8, "successive"), (16, "newton")])
def test_condensed_chain_is_the_whole_one(n: int, method: str) -> None:
    whole, structure = both(n, "0.5*d^3", damping=0.02 * chain(n))
    nu = np.linspace(0.5, 1.4, 20) * whole.natural_frequencies()[0]
    load = np.zeros(n)
    load[0] = 0.002 if method == "successive" else 0.02
    given = {"load": load, "method": method, "harmonics": 9}
    found = [vv.forced_response(system, nu, **given) for system in (whole, structure)]
    assert difference(*found) < 1e-12


def test_non_symmetric_matrices_have_complex_modes() -> None:
    n = 6
    rng = np.random.default_rng(3)
    gyroscopic = rng.normal(size=(n, n))
    damping = 0.05 * chain(n) + 0.1 * (gyroscopic - gyroscopic.T) + np.diag([0.1, 0, 0, 0, 0, 0])
    stiffness = chain(n) + 0.05 * rng.normal(size=(n, n))
    whole, structure = both(n, "0.3*d^2 + 0.5*d^3", stiffness=stiffness, damping=damping)
    nu = np.linspace(0.2, 0.8, 15)
    given = {"load": {0: np.full(n, 0.003j), 1: np.full(n, 0.02)}, "method": "newton"}
    found = [vv.forced_response(s, nu, harmonics=8, **given) for s in (whole, structure)]
    assert difference(*found) < 1e-12
    assert "pairs of complex modes" in str(found[1].plan)


def test_elements_with_kernels_of_their_own() -> None:
    """Dependent directions, two kernels, one linear element, one element without memory."""
    n = 6
    mass, damping = np.linspace(1, 2, n), 0.02 * chain(n)
    elements = [
        vv.Spring(
            on=("x2", "x5"), stiffness=0.4, law="k*d^3", parameters={"k": 0.7}, kernel=RUBBER
        ),
        vv.Spring(on="x2", law="0.2*d^3", kernel=ABEL),
        vv.Spring(on={"x5": 2.0}, stiffness=0.3, kernel=ABEL),
        vv.Spring(on="x1", stiffness=0.5, damping=0.03),
        vv.Spring(on=[0, 0, 0, 0, 0, 1], law="0.1*d^5 + 0.2*d"),
    ]
    structure = vv.Structure(mass=mass, stiffness=chain(n), damping=damping, elements=elements)
    e = np.zeros(n)
    e[[1, 4]] = 1, -1
    five, first = np.zeros((n, n)), np.zeros((n, n))
    five[4, 4], first[0, 0] = 4 * 0.3, 1.0
    last = np.zeros((n, n))
    last[-1, -1] = 0.2
    whole = vv.PolynomialSystem(
        mass=mass, stiffness=chain(n) + 0.5 * first + last, damping=damping + 0.03 * first,
        forces={"x6": "0.1*x6^5"},
        springs=[
            vv.Springs(stiffness=0.4 * np.outer(e, e), kernel=RUBBER,
                       forces={"x2": "0.7*(x2-x5)^3", "x5": "-0.7*(x2-x5)^3"}),
            vv.Springs(stiffness=five, forces={"x2": "0.2*x2^3"}, kernel=ABEL),
        ],
    )  # fmt: skip
    assert len(structure.deflections) == 3
    nu = np.linspace(0.3, 1.2, 20)
    given = {"load": {1: {"x4": 0.05}, 2: {"x1": 0.02}}, "method": "newton", "harmonics": 8}
    vector: dict[int, ComplexArray] = {}
    for order, forces in given["load"].items():
        vector[order] = np.zeros(n, dtype=complex)
        for name, force in forces.items():
            vector[order][int(name[1:]) - 1] = force
    a = vv.forced_response(whole, nu, **(given | {"load": vector}))
    assert difference(a, vv.forced_response(structure, nu, **given)) < 1e-12


def test_couplings_read_and_act_in_several_places() -> None:
    """Also along dependent directions, with memory, and with read-only coordinates."""
    n = 6
    given = {"mass": np.linspace(1, 2, n), "stiffness": chain(n), "damping": 0.03 * chain(n)}
    structure = vv.Structure(
        **given,
        elements=[
            vv.Spring(on="x2", law="0.2*d^3"),
            vv.Coupling(
                on={"a": "x2", "b": ("x2", "x5"), "c": {"x5": 2.0}},
                law={"a": "k*a*b^2 + b^2*c", "b": "k*a^2*b"}, parameters={"k": 0.4}, kernel=RUBBER,
            ),
        ],
    )  # fmt: skip
    on_two = "0.4*x2*(x2-x5)^2 + (x2-x5)^2*2*x5"
    across = "0.4*x2^2*(x2-x5)"
    whole = vv.PolynomialSystem(
        **given, forces={"x2": "0.2*x2^3"},
        springs=[vv.Springs(forces={"x2": f"{on_two} + {across}", "x5": f"-{across}"},
                            kernel=RUBBER)],
    )  # fmt: skip
    assert structure.deflections == ("x2", "+1*x2-1*x5")
    nu = np.linspace(0.3, 1.2, 15)
    load = np.zeros(n)
    load[3] = 0.05
    both_ways = [
        vv.forced_response(s, nu, load=load, method="newton", harmonics=8)
        for s in (whole, structure)
    ]
    assert difference(*both_ways) < 1e-12
    with pytest.raises(vv.InputError, match=r"law\['a'\]: has a term of degree 1, must be 2"):
        vv.Coupling(on={"a": "x1", "b": "x2"}, law={"a": "b"})


def test_rigid_bodies() -> None:
    """Free-free: only the element determines the mean."""
    n = 5
    free = chain(n)
    free[0, 0] = free[-1, -1] = 1
    nu = np.linspace(0.4, 1.4, 15)
    load = {0: np.full(n, 0.01j), 1: np.array([0.1, 0, 0, 0, 0])}
    for law in ("0.1*d + 0.4*d^2 + 0.5*d^3", "0.5*d^3"):
        whole, structure = both(n, law, stiffness=free, damping=0.05 * free)
        given = {"load": load if "d^2" in law else load[1], "method": "newton", "harmonics": 10}
        a, b = (vv.forced_response(s, nu, **given) for s in (whole, structure))
        assert difference(a, b) < 2e-12
        assert ("of rigid bodies" in str(b.plan)) == (law == "0.5*d^3")


def test_a_rigid_body_that_nothing_holds_has_no_mean() -> None:
    free = np.array([[1.0, -1.0], [-1.0, 1.0]])
    spring = vv.Spring(on=("x1", "x2"), law="0.1*d^2")
    structure = vv.Structure(mass=[1, 2], stiffness=free, elements=[spring])
    with pytest.raises(vv.InputError, match="rigid body without support"):
        vv.forced_response(structure, [0.3], load={0: [0.1j, 0]}, method="newton")
    r = vv.forced_response(structure, [0.3], load=[0.01, 0], method="newton")
    assert r.complete


@pytest.mark.parametrize("given", [{"modal_damping": 0.02}, {"rayleigh": (0.01, 0.03)}])
def test_modal_damping_is_a_matrix(given: dict) -> None:
    n = 6
    k = chain(n)
    omega2, shapes = np.linalg.eigh(k)
    ratios = 2 * 0.02 * np.sqrt(omega2) if "modal_damping" in given else 0.01 + 0.03 * omega2
    whole, _ = both(n, "0.5*d^3", damping=shapes @ np.diag(ratios) @ shapes.T)
    spring = vv.Spring(on="x6", law="0.5*d^3")
    structure = vv.Structure(mass=np.ones(n), stiffness=k, elements=[spring], **given)
    nu = np.linspace(0.2, 0.7, 15)
    load = np.full(n, 0.02)
    found = [vv.forced_response(s, nu, load=load, method="newton") for s in (whole, structure)]
    assert difference(*found) < 1e-9


def test_loss_factor_is_a_complex_stiffness() -> None:
    n, nu = 4, np.array([0.3, 1.1])
    structure = vv.Structure(mass=np.ones(n), stiffness=chain(n), loss_factor=0.1)
    r = vv.forced_response(structure, nu, load={2: {"x2": 1.0}}, method="linear")
    force = np.array([0, 1.0, 0, 0])
    for i, mu in enumerate(2 * nu):
        expected = np.linalg.solve(chain(n) * (1 + 0.1j) - mu**2 * np.eye(n), force)
        assert np.abs(r.coefficients[i, :, 0] - expected).max() < 1e-12 * np.abs(expected).max()


def test_coordinates_are_chosen() -> None:
    n = 80
    structure = vv.Structure(
        mass=np.ones(n), stiffness=chain(n), modal_damping=0.01,
        elements=[vv.Spring(on=("x40", "x41"), law="d^3")],
    )  # fmt: skip
    load = {"x3": 0.01}
    assert vv.forced_response(structure, [0.05], load=load).dof_names == ("x3", "x40", "x41")
    r = vv.forced_response(structure, [0.05], load=load, coordinates=["x80", "x3"])
    assert r.dof_names == ("x80", "x3")


def test_distant_modes_are_one_polynomial() -> None:
    """Many modes, near and far from the frequency: deflections against a dense solution."""
    n = 200
    structure = vv.Structure(
        mass=np.ones(n), stiffness=chain(n), rayleigh=(0.001, 0.02), base_direction=np.ones(n),
        elements=[vv.Spring(on="x200", law="d^3"), vv.Spring(on=("x7", "x60"), law="d^3")],
    )  # fmt: skip
    damping = 0.001 * np.eye(n) + 0.02 * chain(n)
    nu = np.array([1e-4, 0.013, 0.02, 0.05, 0.11, 0.3, 0.9, 1.7, 2.5])
    load = {0: {"x5": 1e-4j}, 2: {"x3": 1e-4 + 2e-4j, "x90": 1e-4}}
    r = vv.forced_response(structure, nu, load=load, base={2: 1e-4j}, method="linear")
    seen = np.zeros((n, 2))
    seen[-1, 0], seen[6, 1], seen[59, 1] = 1, 1, -1
    for i, mu in enumerate(2 * nu):
        force = np.zeros(n, dtype=complex)
        force[[2, 89]] = 1e-4 + 2e-4j, 1e-4
        force += mu**2 * 1e-4j
        u = np.linalg.solve(chain(n) + 1j * mu * damping - mu**2 * np.eye(n), force)
        error = np.abs(r.deflections[i, :, 1] - seen.T @ u).max()
        assert error < 1e-11 * np.abs(seen.T @ u).max()
    rest = np.linalg.solve(chain(n), 1e-4 * np.eye(1, n, 4)[0])
    assert np.abs(r.deflections[:, :, 0] - 1j * seen.T @ rest).max() < 1e-11 * np.abs(rest).max()


@pytest.mark.parametrize("dof", ["x1", "x4", "x6"])
def test_small_free_motions_are_those_of_perturbation(dof: str) -> None:
    """First-order perturbation nu^2 = w^2 + A^2 lambda, u = A (u0 + A^2 u1), near a resonance.

    The compliance of the deflections x1 - x2, x2, x4 is that of a single mode; x1 depends
    on them.
    """
    n, at = 6, int(dof[1]) - 1
    k = chain(n) + np.diag(np.linspace(0, 1, n))
    elements = [
        vv.Spring(on=("x1", "x2"), law="0.5*d^3"), vv.Spring(on="x2", law="0.3*d^3"),
        vv.Spring(on="x4", law="0.3*d^3"),
    ]  # fmt: skip
    structure = vv.Structure(mass=np.eye(n), stiffness=k, elements=elements)
    free = vv.backbone(structure, 0, (1e-6, 3e-5), dof=dof, harmonics=1)
    squares, v = np.linalg.eigh(k)
    u0 = v[:, 0] / v[at, 0]
    force = np.zeros(n)
    force[:2] = np.array([1, -1]) * 0.75 * 0.5 * (u0[0] - u0[1]) ** 3
    force[[1, 3]] += 0.75 * 0.3 * u0[[1, 3]] ** 3
    slope = (v[:, 0] @ force) / (v[:, 0] @ u0)
    u1 = v[:, 1:] @ ((v[:, 1:].T @ (slope * u0 - force)) / (squares[1:] - squares[0]))
    u1 -= u0 * u1[at]
    size = free.coefficients[:, at, 0].imag
    true = size[:, np.newaxis] * (u0 + np.outer(size**2, u1))
    assert (np.abs(free.coefficients[:, :, 0].imag - true).max(axis=1) < 1e-13 * size).all()
    assert np.abs(free.nu**2 - squares[0] - slope * size**2).max() < 1e-14


def test_polynomial_systems_are_condensed_underneath() -> None:
    """Also if the full system has more coordinates than the core accepts."""
    n = 12
    k = chain(n)
    bottom = np.zeros((n, n))
    bottom[0, 0] = 0.5
    given = {
        "mass": np.ones(n), "stiffness": k, "damping": 0.03 * k, "base_direction": np.ones(n),
        "forces": {"x12": "0.3*x12^2 + 0.5*x12^3", "x4": "0.2*x4*x12^2"},
        "springs": [vv.Springs(stiffness=bottom, forces={"x1": "0.4*x1^3"}, kernel=ABEL)],
    }  # fmt: skip
    few = vv.PolynomialSystem(**given)
    # A negligible force on too many coordinates prevents condensation.
    given["forces"] = given["forces"] | {f"x{i}": f"1e-40*x{i}^3" for i in range(5, 11)}
    whole = vv.PolynomialSystem(**given)
    nu = np.linspace(0.15, 0.5, 15)
    loads = {"load": {1: np.full(n, 0.01), 3: np.full(n, 0.002)}, "base": {2: 0.01j}}
    for method in ("successive", "newton"):
        a, b = (
            vv.forced_response(s, nu, **loads, method=method, harmonics=8, max_iterations=9)
            for s in (whole, few)
        )
        assert ("condensed" in str(b.plan), "condensed" in str(a.plan)) == (True, False)
        both_found = a.converged & b.converged
        assert both_found.sum() > 5
        one, other = a.coefficients[both_found], b.coefficients[both_found]
        assert (
            np.abs(one - other).max() < (1e-12 if method == "newton" else 1e-9) * np.abs(one).max()
        )
    many = vv.PolynomialSystem(mass=np.ones(80), stiffness=chain(80), forces={"x3": "x3^3"})
    r = vv.forced_response(many, 0.05, load=0.001, method="newton")
    assert r.coefficients.shape[1] == 80


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"elements": [vv.Spring(on="x9", law="d^3")]}, r"elements\[0\].on = 'x9': must be one"),
        ({"elements": [vv.Spring(on={}, law="d^3")]}, "is not a direction"),
        ({"elements": "x1"}, "elements = 'x1': must be a list of Spring"),
        ({"damping": np.eye(2)}, "damping: must have shape"),
        ({"mass": [1, -1, 1]}, r"mass\[1, 1\] = -1: must not be negative"),
        ({"names": ["a", "a", "b"]}, "names: must differ"),
    ],
)
def test_bad_input(given: dict, message: str) -> None:
    with pytest.raises(vv.InputError, match=message):
        vv.Structure(**({"mass": np.ones(3), "stiffness": chain(3)} | given))


def penalty_structures(rng, count):
    """Random structures with coordinates fixed by huge numbers, and the same without them."""
    for i in range(count):
        n = int(rng.integers(3, 8))
        a, b = rng.normal(size=(2, n, n))
        stiffness = 1e4 * (a @ a.T + 0.3 * np.eye(n))
        mass = b @ b.T / n + np.eye(n)
        damping = 0.5 * mass + 1e-4 * stiffness
        fixed = rng.permutation(n)[: int(rng.integers(1, n - 1))]
        free = np.setdiff1d(np.arange(n), fixed)
        penalty = 10.0 ** rng.uniform(26, 60)
        held, heavy, springs = stiffness.copy(), mass.copy(), []
        if i % 3 == 0:
            held[fixed, fixed] = penalty
        elif i % 3 == 1:
            heavy[fixed, fixed] = penalty
        else:
            springs = [
                vv.Spring(on=f"x{j + 1}", law="k*d", parameters={"k": penalty}) for j in fixed
            ]
        names = [f"x{j + 1}" for j in free]
        cubic = [vv.Spring(on=names[-1], law="1e5*d^3")]
        with pytest.warns(vv.StabilityWarning, match="supports there"):
            whole = vv.Structure(
                mass=heavy, stiffness=held, damping=damping, elements=springs + cubic
            )
        inner = np.ix_(free, free)
        part = vv.Structure(
            mass=mass[inner], stiffness=stiffness[inner], damping=damping[inner], names=names,
            elements=cubic,
        )  # fmt: skip
        assert set(whole.supports) == {f"x{j + 1}" for j in fixed}
        yield whole, part, names


def test_huge_numbers_on_a_diagonal_are_supports():
    """Eigensolvers would lose all small eigenvalues next to them."""
    for whole, part, names in penalty_structures(np.random.default_rng(3), 9):
        load, at = {names[-1]: 30.0}, [40.0, 60.0]
        job = {"load": load, "method": "newton", "coordinates": names}
        responses = [vv.forced_response(s, at, **job) for s in (whole, part)]
        assert whole.supports[0] in str(responses[0].plan)
        for name in names:
            assert responses[0].amplitude(name) == pytest.approx(
                responses[1].amplitude(name), rel=1e-9
            )
        runs = [vv.simulate(s, 0.3, load=load, nu=40.0, dt=0.01) for s in (whole, part)]
        for name in names:
            assert runs[0].coordinate(name) == pytest.approx(
                runs[1].coordinate(name), abs=1e-9 * np.abs(runs[1].state).max()
            )
        roots = [s.characteristic_roots(count=len(names)).oscillatory for s in (whole, part)]
        assert roots[0] == pytest.approx(roots[1], rel=1e-9)


def test_a_rigid_connection_by_huge_numbers_is_refused():
    link = np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    with pytest.raises(vv.InputError, match="x1, x2 are coupled by entries more than 1e"):
        vv.Structure(mass=np.ones(3), stiffness=1e32 * link + np.eye(3))


@pytest.mark.parametrize("seed", range(3))
def test_an_indefinite_sparse_mass_is_refused(seed):
    from scipy.sparse import csr_array

    root = np.tril(np.random.default_rng(seed).uniform(0.5, 1, (8, 8)))
    mass = root @ np.diag([1, 1, 1, 1, 1, 1, 1, -0.1]) @ root.T
    np.fill_diagonal(mass, np.abs(np.diag(mass)))
    matrices = {"mass": csr_array(mass), "stiffness": csr_array(np.eye(8))}
    with pytest.raises(vv.InputError, match="mass: must be"):
        vv.forced_response(vv.Structure(**matrices), [0.5], load={"x1": 1.0}, method="linear")


def test_natural_frequencies_are_those_of_the_linear_part():
    """Random structures, by LAPACK with massless coordinates condensed."""
    rng = np.random.default_rng(4)
    for _ in range(20):
        n, free = int(rng.integers(1, 7)), int(rng.integers(0, 2))
        root = rng.normal(size=(n + free, n + free))
        stiffness = root @ root.T + 0.1 * np.eye(n + free)
        mass = np.diag(np.r_[rng.uniform(0.5, 2, n), np.zeros(free)])
        linear = rng.uniform(0, 1)
        structure = vv.Structure(
            mass=mass, stiffness=stiffness, damping=0.02 * mass,
            elements=[vv.Spring(on="x1", law=f"{linear!r}*d + d^3")],
        )  # fmt: skip
        whole = stiffness.copy()
        whole[0, 0] += linear
        kept, left = slice(0, n), slice(n, None)
        bent = whole[kept, kept] - whole[kept, left] @ np.linalg.solve(
            whole[left, left], whole[left, kept]
        )
        true = np.sqrt(scipy.linalg.eigvalsh(bent, mass[kept, kept]))
        np.testing.assert_allclose(structure.natural_frequencies(), true, rtol=1e-10)
    unstable = vv.Structure(mass=[2.0], stiffness=[[-8.0]])
    assert unstable.natural_frequencies() == pytest.approx([-2.0])


@pytest.mark.parametrize("kind", ["coupled", "massless", "reduced", "layers", "layers in modes"])
def test_used_structures_are_pickled_with_their_results(kind):
    """What a structure has computed for itself goes along, or is computed again."""
    n = 40 if kind == "reduced" else 6
    stiffness = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    mass, damping = np.eye(n), 0.02 * stiffness
    given: dict = {}
    if kind == "massless":
        mass[3, 3] = damping[3, 3] = 0
        damping[3, :] = damping[:, 3] = 0
    elif kind.startswith("layers"):
        part = stiffness if kind == "layers in modes" else np.diag(np.arange(1.0, n + 1))
        given["layers"] = [(0.1 * part, vv.PronyKernel(weights=[0.3], rates=[1.0]))]
    damping[0, 0] += 0.1 * (kind in ("coupled", "reduced"))
    spring = vv.Spring(on="x3", law="0.5*d^3")
    system = vv.Structure(
        mass=mass, stiffness=stiffness, damping=damping, elements=[spring], **given
    )
    if kind == "reduced":
        system = system.reduce(frequency=1.5, loads=["x1"])
    response = vv.forced_response(system, [0.2], load=0.1)
    again, same = pickle.loads(pickle.dumps((system, response)))
    assert np.array_equal(same.coefficients, response.coefficients)
    repeated = vv.forced_response(again, [0.2], load=0.1)
    assert np.abs(repeated.coefficients - response.coefficients).max() < 1e-12
