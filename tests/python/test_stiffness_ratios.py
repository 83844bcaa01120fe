"""Very different springs, where rounding of the matrix hides the soft ones: a message."""

import warnings

import mpmath
import numpy as np
import pytest
import scipy.sparse as sp
import viscovib as vv
from viscovib.systems.structure_rest import dense_rest


def chain(springs):
    """Masses in a row; the first spring connects the first mass to the ground."""
    n = springs.size
    stiffness = np.zeros((n, n))
    for i, k in enumerate(springs):
        e = np.zeros(n)
        e[i] = 1
        if i > 0:
            e[i - 1] = -1
        stiffness += k * np.outer(e, e)
    return stiffness


def exact(mass, damping, stiffness, nu, load):
    """Amplitudes with 50 digits."""
    with mpmath.workdps(50):
        n = load.size
        matrix = mpmath.matrix(n, n)
        for i in range(n):
            for j in range(n):
                matrix[i, j] = mpmath.mpc(stiffness[i, j], mpmath.mpf(damping[i, j]) * nu)
            matrix[i, i] -= mpmath.mpf(mass[i]) * nu**2
        x = mpmath.lu_solve(matrix, mpmath.matrix(load.tolist()))
        return np.array([float(abs(value)) for value in x])


@pytest.mark.parametrize("kind", ["modal", "dampers", "follower"])
def test_what_rounding_hides_is_reported(kind):
    """Real modes; complex modes with dampers or unsymmetric stiffness."""
    rng = np.random.default_rng(1)
    reported = 0
    for _ in range(40):
        n = int(rng.integers(3, 7))
        springs = rng.uniform(0.5, 2, n)
        springs[rng.integers(1, n)] *= 10 ** rng.uniform(2, 14.5)
        mass, nu = rng.uniform(0.5, 2, n), rng.uniform(0.1, 1)
        load = np.zeros(n)
        load[-1] = 1e-3
        stiffness, damping = chain(springs), 0.02 * np.diag(mass)
        if kind == "dampers":
            damping += 0.1 * chain(rng.uniform(0.5, 2, n))
        elif kind == "follower":
            stiffness[0, 0] += 0.1
            stiffness[0, 1] += 0.05 * springs[0]
        with warnings.catch_warnings(record=True) as seen:
            warnings.simplefilter("always")
            structure = vv.Structure(
                mass=np.diag(mass),
                stiffness=stiffness,
                damping=damping,
                elements=[vv.Spring(on="x1", law="1e-9*d^3")],
            )
            response = vv.forced_response(
                structure, [nu], load=load, harmonics=3, method="newton",
                coordinates=structure.dof_names,
            )  # fmt: skip
        true = exact(mass, damping, stiffness, nu, load)
        found = np.array([response.amplitude(name)[0] for name in structure.dof_names])
        warned = any("rounding hides the soft ones" in str(w.message) for w in seen)
        reported += warned
        assert warned or np.abs(found - true).max() < 1e-5 * true.max()
    assert 10 < reported < 30


def test_free_bodies_are_no_false_alarm():
    rng = np.random.default_rng(3)
    for _ in range(200):
        n = int(rng.integers(2, 40))
        stiffness = np.zeros((n, n))
        size = 10 ** rng.uniform(0, 6)
        for _ in range(2 * n):
            i, j = rng.choice(n, 2, replace=False)
            e = np.zeros(n)
            e[i], e[j] = 1, -1
            stiffness += size ** rng.uniform() * np.outer(e, e)
        with warnings.catch_warnings():
            warnings.simplefilter("error", vv.RangeWarning)
            rest = dense_rest(np.diag(rng.uniform(0.5, 2, n)), np.zeros((n, n)), stiffness)
        assert rest.squares.min() == pytest.approx(0, abs=1e-9 * rest.squares.max())


def test_springs_of_one_kind_are_no_false_alarm_under_any_damping():
    rng = np.random.default_rng(5)
    for _ in range(200):
        n = int(rng.integers(2, 40))
        size = 10 ** rng.uniform(0, 4)
        stiffness = chain(size ** rng.uniform(0, 1, n))
        if rng.uniform() < 0.5:
            stiffness = stiffness + np.triu(rng.normal(size=(n, n)), 1) * 0.01
        damping = 10 ** rng.uniform(-4, 0) * chain(rng.uniform(0.5, 2, n))
        with warnings.catch_warnings():
            warnings.simplefilter("error", vv.RangeWarning)
            dense_rest(np.diag(rng.uniform(0.5, 2, n)), damping, stiffness)


def springs_between(rng, n, decades, free=False):
    """Random springs as (stiffness, mass, other mass or -1 for the ground)."""
    found = [[rng.uniform(0.5, 2), i, i - 1] for i in range(n)]
    for _ in range(rng.integers(0, n)):
        found.append([rng.uniform(0.5, 2), *rng.choice(n, 2, replace=False)])
    if free:
        found = found[1:]
    for _ in range(rng.integers(0, 3)):
        found[rng.integers(len(found))][0] = 10 ** rng.uniform(0, decades)
    return found


def assembled(springs, n, number=float):
    k = [[number(0)] * n for _ in range(n)]
    for stiffness, i, j in springs:
        value = number(float(stiffness))
        k[i][i] += value
        if j >= 0:
            k[j][j] += value
            k[i][j] -= value
            k[j][i] -= value
    return k


def reported_of(build, *arguments, **options):
    """Whether a call gives the message, and its result."""
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        made = build(*arguments, **options)
    return any("rounding hides the soft ones" in str(w.message) for w in seen), made


def polynomial(mass, stiffness):
    n = mass.size
    laws = {f"x{i + 1}": f"x{i + 1}^3" for i in range(n)}
    k = np.array(stiffness, float)
    return vv.PolynomialSystem(mass=mass, stiffness=k, damping=0.01 * k, forces=laws)


def test_polynomial_systems_tell_what_rounding_hides():
    """Squared frequencies of the given springs, against those of the rounded matrix."""
    rng = np.random.default_rng(11)
    reported = hidden = 0
    for _ in range(100):
        n = int(rng.integers(2, 6))
        springs = springs_between(rng, n, 14)
        mass = 10 ** rng.uniform(-1, 1, n)
        seen, _ = reported_of(polynomial, mass, assembled(springs, n))
        with mpmath.workdps(50):
            unit = mpmath.diag([1 / mpmath.sqrt(m) for m in mass])
            squares = [
                mpmath.eigsy(unit * mpmath.matrix(assembled(springs, n, number)) * unit)[0]
                for number in (mpmath.mpf, float)
            ]
            error = max(abs(b / a - 1) for a, b in zip(*squares, strict=True))
        reported += seen
        hidden += error > 4e-6
        assert seen or error < 4e-6
        assert not seen or error > 1e-10
    assert 10 < hidden <= reported < 50


def test_ordinary_polynomial_systems_are_no_false_alarm():
    rng = np.random.default_rng(12)
    for _ in range(300):
        n = int(rng.integers(2, 9))
        springs = springs_between(rng, n, 6, free=rng.uniform() < 0.5)
        assert not reported_of(polynomial, rng.uniform(0.5, 2, n), assembled(springs, n))[0]


def test_springs_of_follower_forces_are_judged_too():
    stiffness = [[1e12 + 1, -1e12 - 0.5], [-1e12, 1e12]]
    assert reported_of(polynomial, np.ones(2), stiffness)[0]
    assert not reported_of(polynomial, np.ones(2), [[3, 1], [-1, 2]])[0]


@pytest.mark.parametrize("decades", [0, 3, 13])
def test_reduced_structures_tell_what_rounding_hides(decades):
    """Squared frequencies change as for springs in extended precision."""
    rng = np.random.default_rng(decades)
    reported = refused = 0
    for _ in range(12):
        n = int(rng.integers(130, 300))
        springs = rng.uniform(0.5, 2, n)
        springs[rng.integers(1, n)] *= 10 ** rng.uniform(0.7 * decades, decades)
        k, wide = chain_of(springs), chain_of(springs.astype(np.longdouble))
        build = vv.Structure(
            mass=sp.eye_array(n), stiffness=sp.csc_array(k), modal_damping=0.01,
            elements=[vv.Spring(on=f"x{n}", law="0.1*d^3")],
        )  # fmt: skip
        try:
            seen, made = reported_of(build.reduce, frequency=0.1, loads=["x1"], tolerance=1e-2)
        except vv.InputError:
            # Refused: its own estimate of rounding errors is above the tolerance.
            refused += 1
            continue
        found = made.reduction
        shapes = found.shapes[:, : found.n_modes]
        off = np.array(wide - k, dtype=float)
        error = (
            np.abs(np.einsum("im,ij,jm->m", shapes, off, shapes)) / found.squares[: found.n_modes]
        )
        reported += seen
        assert seen or error.max() < 3e-2
    assert (reported > 0) == (decades == 13)
    assert refused < 8 * (decades == 13) + 1


def chain_of(springs):
    """The chain in the precision of its springs."""
    k = np.diag(springs + np.append(springs[1:], 0))
    return k - np.diag(springs[1:], 1) - np.diag(springs[1:], -1)


@pytest.mark.filterwarnings("ignore:stiffness. springs are so different:viscovib.RangeWarning")
@pytest.mark.parametrize("decades", [10.5, 11])
def test_where_stiff_springs_hide_a_branch_the_way_out_is_reported_and_right(decades):
    """Two masses with a coupling of 10^decades; coordinates are their sum and difference."""
    c = 10.0**decades
    mass, stiffness = np.diag([1.0, 1.3]), np.array([[1 + c, -c], [-c, 0.7 + c]])
    damping = 0.02 * mass
    given = {"mass": mass, "damping": damping, "stiffness": stiffness}
    system = vv.PolynomialSystem(**given, forces=["0.5*x1^3", "0"])
    with pytest.raises(vv.InputError, match=r"differ by a factor of .*vv\.Structure"):
        vv.trace_response(system, (0.3, 2.0), load=[0.0, 0.1])
    structure = vv.Structure(**given, elements=[vv.Spring(on="x1", law="0.5*d^3")])
    found = vv.trace_response(structure, (0.3, 2.0), load=[0.0, 0.1])
    # x1 = y1, x2 = y1 + y2: sums of these entries are exact.
    turn = np.array([[1.0, 0.0], [1.0, 1.0]])
    softer = (stiffness[0, 0] + stiffness[0, 1]) + (stiffness[1, 0] + stiffness[1, 1])
    corner = stiffness[0, 1] + stiffness[1, 1]
    turned = vv.PolynomialSystem(
        mass=turn.T @ mass @ turn, damping=turn.T @ damping @ turn,
        stiffness=[[softer, corner], [corner, stiffness[1, 1]]], forces=["0.5*x1^3", "0"],
    )  # fmt: skip
    right = vv.trace_response(turned, (0.3, 2.0), load=[0.1, 0.1], stability=False)
    assert found.complete
    assert right.complete
    assert right.folds.size == 2
    np.testing.assert_allclose(found.folds, right.folds, rtol=1e-12)
