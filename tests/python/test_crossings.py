"""Bifurcations on random branches: they explain every change, and do not depend on the steps."""

import numpy as np
import pytest
import viscovib as vv
from referee.crossings import case as crossings_case, reported_by_crossings
from referee.worker import answer, generator

pytestmark = pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")


def _pair(rng):
    """Two masses in a row, lightly damped: resonances with all kinds of bifurcations."""
    k = rng.uniform(0.5, 1.8, 3)
    stiffness = np.array([[k[0] + k[1], -k[1]], [-k[1], k[1] + k[2]]])
    coefficients = rng.uniform(0.1, 0.6, 3)
    terms = zip(coefficients, ((3, 0), (0, 3), (2, 0)), (0, 1, 0), strict=True)
    return vv.PolynomialSystem(
        mass=rng.uniform(0.6, 2, 2), stiffness=stiffness,
        damping=rng.uniform(0.005, 0.03) * stiffness,
        forces=[vv.Monomial(coefficient=c, powers=p, on=d) for c, p, d in terms],
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(6))
def test_they_explain_every_change(seed):
    rng = np.random.default_rng(seed)
    system = _pair(rng)
    same = dict(load={1: [rng.uniform(0.1, 0.5), 0]}, harmonics=15, symmetric=bool(seed % 2))
    branch = vv.trace_response(system, (0.4, 2.0), **same)
    for claim in reported_by_crossings(branch):
        assert claim.ratio() == 0, str(claim)
    fine = vv.trace_response(system, (0.4, 2.0), **same, max_step=0.03, max_points=6000)
    if branch.outcome == fine.outcome == "completed" and fine.truncation.max() < 1e-4:
        assert [c.kind for c in branch.crossings] == [c.kind for c in fine.crossings]
        places = [[c.parameter for c in b.crossings] for b in (branch, fine)]
        np.testing.assert_allclose(*places, rtol=1e-6)


def test_breaking_of_symmetry_with_memory():
    kernel = vv.PronyKernel(weights=[0.05], rates=[0.4])
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="x^3", kernel=kernel)
    branch = vv.trace_response(system, load_range=(0.1, 6), nu=1.1, load=1, harmonics=15)
    for claim in reported_by_crossings(branch):
        assert claim.ratio() == 0, str(claim)
    assert {c.kind for c in branch.crossings} <= {"fold", "symmetry breaking"}


def test_two_crossings_within_a_step_have_their_places_whatever_the_step():
    # The equations are singular at both points, so Newton's method fails near the second point.
    system = vv.PolynomialSystem(mass=1.62, damping=0.01312, stiffness=1.312, forces="0.69*x^3")
    places = []
    for step in (0.02, 0.025, 0.03):
        branch = vv.trace_response(
            system, (0.5, 0.56), load=0.73, harmonics=13, symmetric=False, max_step=step
        )
        assert [c.kind for c in branch.crossings] == ["branch point"] * 2
        places.append([c.parameter for c in branch.crossings])
    assert np.array(places) == pytest.approx(np.tile([0.516402, 0.519724], (3, 1)), abs=1e-6)


@pytest.mark.parametrize("index", [34, 84])
def test_pairs_of_condensed_systems_with_memory_have_places(index):
    # Followed exponents may return as their conjugates.
    case = crossings_case(generator(77, "crossings", index), index)
    claims, ended, _ = answer(case)
    assert ended == "answered"
    assert any("Neimark-Sacker" in claim.what for claim in claims)
    for claim in claims:
        assert claim.ratio() <= claim.limit, str(claim)


def _crossings(system, nu, load, **options):
    branch = vv.trace_response(system, nu, load={1: load}, harmonics=13, symmetric=True, **options)
    return [(c.kind, c.parameter) for c in branch.crossings]


def test_a_pair_of_crossings_near_a_fold_is_found():
    """Two symmetry-breaking points and the fold between them lie within one step."""
    system = vv.PolynomialSystem(
        mass=[1.8, 1.12], damping=[[0.030206, -0.01947], [-0.01947, 0.03344]],
        stiffness=[[2.746, -1.77], [-1.77, 3.04]],
        forces=[vv.Monomial(coefficient=0.587, powers=(0, 3), on=1)],
    )  # fmt: skip
    found = _crossings(system, (0.4298, 1.461), [0.82, 0.0])
    fine = _crossings(system, (0.4298, 1.461), [0.82, 0.0], max_step=0.02, max_points=4000)
    assert [kind for kind, _ in found] == [kind for kind, _ in fine]
    assert [kind for kind, _ in found].count("symmetry breaking") == 2
    assert [p for _, p in found] == pytest.approx([p for _, p in fine], rel=1e-9)


def test_exponents_that_turn_fast_have_a_place_too():
    """If no exponent can be followed between two points, their count locates the bifurcation."""
    modes = np.array([
        [0.766899, -0.172606, 0.452802, -0.311555, -0.570422],
        [-0.172606, 1.058112, -0.274281, 0.526452, -0.124451],
        [0.452802, -0.274281, 1.21967, -0.023766, -0.263841],
        [-0.311555, 0.526452, -0.023766, 1.653747, 0.949518],
        [-0.570422, -0.124451, -0.263841, 0.949518, 1.843256],
    ])  # fmt: skip
    spring = np.zeros((5, 5))
    spring[1, 1] = 0.741
    system = vv.PolynomialSystem(
        mass=[1.409, 0.813, 1.591, 0.924, 1.112], damping=0.043 * modes, stiffness=modes,
        forces=[vv.Monomial(coefficient=0.571, powers=(0, 2, 0, 0, 0), on=1)],
        springs=[
            vv.Springs(stiffness=spring, kernel=vv.PronyKernel(weights=[0.521], rates=[2.39]))
        ],
    )  # fmt: skip
    load = [0.64, 0.0, 0.0, 0.0, 0.0]
    found = _crossings(system, (0.2603, 0.885), load, max_points=600)
    fine = _crossings(system, (0.2603, 0.885), load, max_step=0.02, max_points=4000)
    assert [kind for kind, _ in found] == [kind for kind, _ in fine]
    assert [p for _, p in found] == pytest.approx([p for _, p in fine], rel=1e-8)


def test_places_of_truncated_motions_are_reported_as_such():
    """The location is exact for the given harmonics; its error is the truncation of the motion."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="x^3")
    with pytest.warns(vv.ConvergenceWarning, match="2 of 2 crossings next to these are those of"):
        few = vv.trace_response(system, (1.2, 3), load=0.4, harmonics=3)
    whole = vv.trace_response(system, (1.2, 3), load=0.4, harmonics=31)
    places = [np.array([c.parameter for c in b.crossings]) for b in (few, whole)]
    off = abs(places[0] / places[1] - 1).max()
    assert [c.kind for c in few.crossings] == [c.kind for c in whole.crossings] == ["fold"] * 2
    assert 1e-8 < off < 10 * few.truncation.max()
    assert whole.truncation.max() < 1e-10
