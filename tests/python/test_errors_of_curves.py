"""Error estimates of backbones and driven branches, and of their folds."""

import re

import mpmath
import numpy as np
import pytest
import viscovib as vv
from test_written_errors import written


def frequencies(mass, stiffness):
    """Frequencies of small motions with 40 digits."""
    with mpmath.workdps(40):
        unit = mpmath.diag([1 / mpmath.sqrt(m) for m in mass])
        squares = mpmath.eigsy(unit * mpmath.matrix(stiffness.tolist()) * unit)[0]
        return sorted(mpmath.sqrt(x) for x in squares)


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.filterwarnings("ignore::viscovib.RangeWarning")
def test_backbones_of_soft_springs_with_stiff_ones_tell_their_rounding():
    """Frequencies of small motions against eigenvalues; truncation alone was 40 times too small."""
    judged = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        mass, springs = rng.uniform(0.5, 2, 2), rng.uniform(0.5, 2, 2)
        springs[rng.integers(2)] *= 10 ** rng.uniform(6, 11)
        soft, stiff = springs
        stiffness = np.array([[soft + stiff, -stiff], [-stiff, stiff]])
        system = vv.PolynomialSystem(
            mass=mass, stiffness=stiffness, forces={"x1": "0.5*x1^3", "x2": "0.25*x2^3"}
        )
        curve = vv.backbone(system, 0, (1e-10, 1e-9), max_points=10)
        exact = frequencies(mass, stiffness)[0]
        off = np.array([abs(float(nu / exact - 1)) for nu in curve.nu])
        assert (off <= curve.truncation + curve.error + 4e-16).all(), seed
        judged += int((off > 1e-12).sum())
    assert judged > 50


def test_folds_of_backbones_are_as_far_off_as_reported():
    """Few harmonics against many: at a 5:1 resonance the first harmonic has a fold."""
    mount = vv.Mount(mass=1.15, inertia=0.0507, offset=0.5, stiffness_x=15, stiffness_phi=3.29)
    many = vv.backbone(mount, 0, (0.002, 0.2))
    with pytest.warns(vv.ConvergenceWarning, match="do not reach"):
        few = vv.backbone(mount, 0, (0.002, 0.2), harmonics=7)
    apart = abs(few.folds[0] - many.folds[0])
    assert few.fold_errors[0] == pytest.approx(apart, rel=0.2)
    assert many.fold_errors[0] < 1e-9


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.parametrize("harmonics", [2, 3, 4])
def test_folds_of_driven_branches_are_as_far_off_as_reported(harmonics, tmp_path):
    body = vv.Pendulum(
        e=0.1, w2=0.43, w3=0.734, alpha=0.5, c1=0.0086, c2=0.0086, c3=0.0086, f0=0.0076, p1=1
    )
    few, many = (
        vv.trace_response(body, p1=(0.7, 1.3), harmonics=n, stability=False)
        for n in (harmonics, 15)
    )
    assert few.folds.size == many.folds.size == 2
    apart = np.abs(few.folds - many.folds)
    assert few.fold_errors == pytest.approx(apart, rel=0.3)
    assert (many.fold_errors < 1e-9).all()
    notes, table = written(tmp_path / "t.csv", few)
    reported = re.search("estimated errors of these folds:(.*)", notes)[1]
    assert list(map(float, reported.split())) == list(few.fold_errors)
    assert (table["error"] == few.error).all()
    assert (few.error > 0).all()


def test_the_first_point_off_another_curve_tells_an_error():
    body = vv.Pendulum(e=0.1, w2=0.53, w3=0.9, alpha=0.5)
    free = vv.backbone(body, 0, (0.01, 0.2), subharmonic=2, stability=False)
    left = vv.backbone(
        body, 0, (0.01, 0.2), subharmonic=2, stability=False, leave=free.branch_points[0],
        harmonics=9, max_points=5,
    )  # fmt: skip
    assert (left.error > 0).all()


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.parametrize("load", [0.15, 0.3, 0.6])
def test_motions_at_folds_are_as_far_off_as_estimated(load):
    """Few harmonics against many."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="x^3 + 0.3*x^2")
    few, many = (
        vv.trace_response(system, (0.7, 2.8), load=load, harmonics=n, stability=False)
        for n in (4, 25)
    )
    m = few.harmonics.size
    for i in range(2):
        size = np.linalg.norm(many.fold_coefficients[i])
        off = np.linalg.norm(few.fold_coefficients[i] - many.fold_coefficients[i][:, :m]) / size
        rest = np.linalg.norm(many.fold_coefficients[i][:, m:]) / size
        error = few.fold_coefficient_errors[i]
        assert off + rest == pytest.approx(error, rel=0.5)
    assert (many.fold_coefficient_errors < 1e-11).all()


def test_motions_at_folds_are_those_of_50_digits():
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="x^3")
    for load, nu, first in (
        (0.15, 1.379781873645623362, 1.079881870382868044),
        (0.3, 1.779719524298573114, 1.670640253412805500),
    ):
        branch = vv.trace_response(system, (0.5, 2.2), load=load, harmonics=31, stability=False)
        i = branch.folds.argmax()
        assert branch.folds[i] == pytest.approx(nu, abs=branch.fold_errors[i])
        error = branch.fold_coefficient_errors[i]
        assert error < 1e-12
        assert abs(branch.fold_coefficients[i, 0, 0]) == pytest.approx(first, rel=error)
