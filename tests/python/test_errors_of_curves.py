"""Errors of backbones and driven branches, and of their folds, hold what is off."""

import re

import mpmath
import numpy as np
import pytest
import viscovib as vv
from test_written_errors import written


def frequencies(mass, stiffness):
    """Of small motions, in 40 digits."""
    with mpmath.workdps(40):
        unit = mpmath.diag([1 / mpmath.sqrt(m) for m in mass])
        squares = mpmath.eigsy(unit * mpmath.matrix(stiffness.tolist()) * unit)[0]
        return sorted(mpmath.sqrt(x) for x in squares)


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.filterwarnings("ignore::viscovib.RangeWarning")
def test_backbones_of_soft_springs_beside_stiff_ones_tell_their_rounding():
    """Small motions have the frequencies of eigenvalues; truncation alone was 40 times low."""
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


def test_folds_of_backbones_are_as_far_off_as_told():
    """By few orders against many: at 5:1 of two modes the first harmonic turns back."""
    mount = vv.Mount(mass=1.15, inertia=0.0507, offset=0.5, stiffness_x=15, stiffness_phi=3.29)
    many = vv.backbone(mount, 0, (0.002, 0.2))
    with pytest.warns(vv.ConvergenceWarning, match="do not reach"):
        few = vv.backbone(mount, 0, (0.002, 0.2), harmonics=7)
    apart = abs(few.folds[0] - many.folds[0])
    assert few.fold_errors[0] == pytest.approx(apart, rel=0.2)
    assert many.fold_errors[0] < 1e-9


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.parametrize("harmonics", [2, 3, 4])
def test_folds_of_driven_branches_are_as_far_off_as_told(harmonics, tmp_path):
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
    told = re.search("estimated errors of these folds:(.*)", notes)[1]
    assert list(map(float, told.split())) == list(few.fold_errors)
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
