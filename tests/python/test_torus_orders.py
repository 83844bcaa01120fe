"""Automatic harmonics of steady motions of the pendulum, and the truncation error."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import viscovib as vv

BODY = {"e": 0.1, "w2": 0.4, "w3": 0.8, "alpha": 0.5, "c1": 0.1, "c2": 0.1, "c3": 0.1}
ONE = vv.Pendulum(**BODY, f0=0.01, m01=0.02, p1=0.74, p2=0.37)
TWO = vv.Pendulum(**BODY, f0=0.02, m01=0.005, p1=0.93, p2=0.37)
THREE = vv.Pendulum(**BODY, f0=0.01, m01=0.001, m02=0.003, p1=0.93, p2=0.37, p3=0.71)
LIGHT = vv.Pendulum(
    e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.02, c2=0.02, c3=0.02, m01=0.004, p2=0.5
)  # fmt: skip


def size(pend, r, row=0):
    """Largest error of a row against many harmonics, relative to the largest coefficient."""
    many = {1: 45, 2: 28, 3: 14}[len(r.axes)]
    fine = vv.forced_response(pend, harmonics=many, tolerance=1e-13, stability=False)
    errors = fine.coefficients[0].copy()
    errors[:, : len(r.orders)] -= r.coefficients[row]
    return np.abs(errors).max() / np.abs(fine.coefficients[0]).max()


@pytest.mark.parametrize(
    ("pend", "bounds"), [(ONE, (5, 9, 15, 21)), (TWO, (4, 6, 9, 13)), (THREE, (3, 5, 7))]
)
def test_truncation_is_the_error(pend, bounds):
    for bound in bounds:
        r = vv.forced_response(pend, harmonics=bound, stability=False)
        assert r.highest[0] == bound
        assert r.truncation[0] == pytest.approx(size(pend, r), rel=0.3)


@pytest.mark.parametrize("pend", [ONE, TWO, THREE])
def test_as_many_orders_as_the_tolerance_needs(pend):
    used = []
    for tolerance in (1e-4, 1e-7, 1e-10):
        r = vv.forced_response(pend, tolerance=tolerance, stability=False)
        assert r.truncation[0] <= tolerance
        assert size(pend, r) <= 1.3 * tolerance
        used.append(int(r.highest[0]))
        assert np.abs(r.orders).sum(axis=1).max() == r.highest[0]
    assert used[0] < used[1] < used[2]


def test_orders_come_and_go_along_a_row():
    p2 = np.linspace(0.25, 0.6, 36)
    r = vv.forced_response(LIGHT, p2=p2, tolerance=1e-8, stability=False)
    assert r.converged.all()
    assert r.truncation.max() <= 1e-8
    peak = int(np.argmax(r.highest))
    assert r.highest[peak] > r.highest[0]
    assert r.highest[peak] > r.highest[-1]
    for row in (0, peak, 35):
        assert size(replace(LIGHT, p2=p2[row]), r, row) < 3e-8
        # Omitted harmonics of a row are 0.
        beyond = r.orders[:, 0] > r.highest[row]
        assert np.abs(r.coefficients[row][:, beyond]).max(initial=0) == 0
    assert "each with as many harmonics as it needs" in str(r.plan)
    table = r.to_dataset()
    assert table.highest.values.tolist() == r.highest.tolist()


def test_strong_motions_need_more_than_few_orders_inside():
    """The amplitude of z is up to 0.9 of the pivot distance: inner harmonics are added."""
    strong = replace(TWO, f0=0.2, m01=0.01, p1=1.02, p2=0.41)
    r = vv.forced_response(strong, harmonics=14, stability=False)
    assert r.converged[0]
    assert np.abs(r.coefficients[0, 0]).max() > 0.8
    again = vv.forced_response(strong, p1=[1.0, 1.01, 1.02], harmonics=14, stability=False)
    assert again.converged.all()
    assert again.coefficients[2] == pytest.approx(r.coefficients[0], abs=1e-9)


def test_more_unknowns_than_a_matrix_may_have():
    r = vv.forced_response(THREE, harmonics=14, tolerance=1e-13, stability=False)
    assert 3 * (2 * len(r.orders) - 1) > 12000
    assert r.converged[0]
    assert r.truncation[0] < 1e-14
    state = r.state(0, np.linspace(0, 1e4, 50))
    some = vv.forced_response(THREE, harmonics=9, stability=False)
    assert some.state(0, np.linspace(0, 1e4, 50)) == pytest.approx(state, abs=1e-11)


def test_plans_made_by_many_threads():
    """Grids of new shapes in eight threads equal those of one thread."""
    jobs = [(pend, bound) for bound in (16, 17, 19, 21, 23) for pend in (TWO, ONE)]
    with ThreadPoolExecutor(8) as pool:
        found = list(
            pool.map(lambda j: vv.forced_response(j[0], harmonics=j[1], stability=False), jobs)
        )
    for (pend, bound), r in zip(jobs, found, strict=True):
        alone = vv.forced_response(pend, harmonics=bound, stability=False)
        assert (r.coefficients == alone.coefficients).all()


def test_branches_choose_their_orders():
    """Folds against many more harmonics; the estimate is that of the worst point."""
    job = {"p2": (0.25, 0.6), "stability": False}
    strong = replace(LIGHT, m01=0.005)
    fine = vv.trace_response(strong, **job, harmonics=41, tolerance=1e-12)
    used = []
    for tolerance in (1e-6, 1e-10):
        branch = vv.trace_response(strong, **job, harmonics="auto", tolerance=tolerance)
        assert branch.outcome == "completed"
        assert branch.folds == pytest.approx(fine.folds, abs=tolerance)
        used.append(int(branch.harmonics.max()))
        peak = int(np.argmax(branch.truncation))
        p2 = branch.parameter[peak]
        with_more = vv.trace_response(strong, **job, harmonics=41, at=[p2])
        errors = []
        for point in with_more.stops:
            rest = with_more.coefficients[point].copy()
            rest[:, : len(branch.orders)] -= branch.coefficients[peak]
            errors.append(np.abs(rest).max() / np.abs(branch.coefficients[peak]).max())
        assert min(errors) < 3 * tolerance
    assert used[0] < used[1]


def test_orders_of_a_branch_that_cannot_be_chosen():
    with pytest.warns(vv.ConvergenceWarning, match="3 harmonics: the estimated relative error"):
        rest = vv.trace_response(TWO, m01=(0, 0.001), harmonics=3)
    point = vv.BranchPoint(
        0.0, rest.coefficients[0], 0, rest.coefficients[0], 0.0, np.zeros(1), np.ones(1)
    )
    with pytest.raises(
        vv.InputError, match="leave: has 1 unknowns, must have as many as this curve"
    ):
        vv.trace_response(TWO, m01=(0, 0.001), harmonics="auto", leave=point)
    with pytest.raises(vv.InputError, match="harmonics = 'some'"):
        vv.trace_response(TWO, m01=(0, 0.001), harmonics="some")
    heavy = replace(TWO, f0=0.1, p1=1.02, p2=0.41)
    with (
        pytest.warns(vv.ConvergenceWarning, match="17 harmonics: the estimated relative error"),
        pytest.warns(vv.ConvergenceWarning, match="the rounding error exceeds the tolerance 1"),
    ):
        vv.trace_response(
            heavy, m01=(0.008, 0.01), harmonics="auto", tolerance=1e-14, max_points=2,
            symmetric=True,
        )  # fmt: skip


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"harmonics": 64}, r"harmonics = 64: must be 1 to 63"),
        ({"harmonics": 0}, r"harmonics = 0: must be 1 to 63"),
        ({"harmonics": "all"}, r"harmonics = 'all'"),
        ({"tolerance": 1e-15}, r"tolerance = 1e-15: must be in \[1e-14, 0.1\]"),
        ({"nu": [1.0]}, r"nu: needs a single base frequency, but those of the loads are "
                        r"incommensurate \(0.93, 0.37\)"),
        ({"subharmonic": 2}, r"subharmonic = 2: needs a single base frequency"),
        ({"p3": [0.5]}, r"p3: varies, but no load acts at it: m02 = 0"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_named(change, message):
    with pytest.raises(vv.InputError, match=message):
        vv.forced_response(TWO, stability=False, **change)


def test_loads_of_no_size_or_frequency():
    with pytest.raises(vv.InputError, match="at least one load of a frequency > 0 must act"):
        vv.forced_response(replace(TWO, f0=0.0, m01=0.0))
    with pytest.raises(vv.InputError, match="at least one load of a frequency > 0 must act"):
        vv.forced_response(replace(TWO, p1=0.0, p2=0.0))


def test_equal_and_nearly_equal_frequencies():
    """Equal frequencies are one axis; 12 : 11 too, 14 : 13 only if requested; all agree."""
    same = vv.forced_response(replace(TWO, p1=0.37), stability=False)
    assert same.axes == ("nu",)
    close = vv.forced_response(replace(TWO, p1=0.37 * 12 / 11), stability=False)
    assert close.axes == ("nu",)
    apart = replace(TWO, p1=0.37 * 14 / 13)
    two = vv.forced_response(apart, stability=False)
    one = vv.forced_response(apart, max_denominator=14, stability=False)
    assert two.axes == ("p1", "p2")
    assert one.axes == ("nu",)
    assert one.truncation[0] <= 1e-10
    t = np.linspace(0, 100, 50)
    assert two.state(0, t) == pytest.approx(one.state(0, t), abs=1e-9)


def test_loads_must_fit_in_their_orders():
    """Loads at 12 and 11 times a base frequency do not appear with five harmonics."""
    close = replace(TWO, p1=0.37 * 12 / 11)
    with pytest.raises(vv.InputError, match=r"harmonics = 11: must be 12 to 399"):
        vv.forced_response(close, harmonics=11)
    with pytest.raises(vv.InputError, match=r"harmonics = 5: must be 12 to 399"):
        vv.trace_response(close, f0=(0.01, 0.02), harmonics=5)
    with pytest.warns(vv.ConvergenceWarning, match="25 harmonics: the estimated relative error"):
        branch = vv.trace_response(close, f0=(0.01, 0.02), harmonics=25, stability=False)
    assert branch.harmonics.max() == 25
    assert branch.outcome == "completed"
    chosen = vv.trace_response(close, f0=(0.01, 0.02), stability=False)
    assert chosen.harmonics.max() > 25
    assert chosen.outcome == "completed"


def test_a_small_common_base_is_no_axis_of_three_loads():
    """12 : 11 and 11 : 12 give 144 and 121 times their base: two axes, unless requested."""
    three = replace(THREE, p1=0.4, p2=0.4 * 12 / 11, p3=0.4 * 11 / 12)
    apart = vv.forced_response(three, harmonics=12, stability=False)
    assert apart.axes == ("nu", "p3")
    assert apart.base[0] == pytest.approx([0.4 / 11, three.p3], rel=1e-14)
    together = vv.forced_response(three, nu=[0.4 / 132], harmonics=144, stability=False)
    assert together.axes == ("nu",)
    with pytest.raises(vv.InputError, match=r"harmonics = 143: must be 144 to"):
        vv.forced_response(three, nu=[0.4 / 132], harmonics=143)
    far = replace(THREE, p1=0.4, p2=0.4 * 97 / 96, p3=0.4 * 89 / 91)
    with pytest.raises(vv.InputError, match=r"max_denominator = 99: the loads are up to 8827 times "
                       r"their base frequency, must be at most 399"):  # fmt: skip
        vv.forced_response(far, nu=[1e-4], max_denominator=99)
    with pytest.raises(vv.InputError, match=r"max_denominator: the loads are up to 97 times"):
        vv.forced_response(far, max_denominator=99)


def test_a_load_that_throws_the_spring_to_its_pivot():
    thrown = replace(TWO, f0=3.0, p1=1.0)
    with pytest.warns(vv.ConvergenceWarning, match="1 of 1 motion not found"):
        r = vv.forced_response(thrown, harmonics=8, stability=False)
    assert not r.converged[0]
    assert r.highest[0] == 0
    assert np.isnan(r.truncation[0])
    assert np.isnan(r.coefficients).all()


def test_too_few_orders_are_reported():
    heavy = replace(TWO, c1=0.005, c2=0.005, c3=0.005, f0=0.05, m01=0.01, p1=1.02, p2=0.41)
    with pytest.warns(vv.ConvergenceWarning, match="harmonics: the estimated relative error is"):
        r = vv.forced_response(heavy, tolerance=1e-14, stability=False)
    assert r.truncation[0] > 1e-14


def test_many_unknowns_hear_an_interrupt(start):
    program = (
        "import numpy as np, viscovib as vv\n"
        "p = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.03, c2=0.03, c3=0.03, f0=0.05, "
        "m01=0.003, m02=0.003, p1=1.02, p2=0.41, p3=0.87)\n"
        "vv.forced_response(p, harmonics=2, stability=False)\n"
        "print('ready', flush=True)\n"
        "vv.forced_response(p, p1=np.linspace(0.9, 1.1, 300), harmonics=11)\n"
    )
    child = start(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert child.stdout.readline() == "ready\n"
    time.sleep(1.0)
    before = os.times()
    child.send_signal(signal.SIGINT)
    _, errors = child.communicate(timeout=300)
    after = os.times()
    assert "KeyboardInterrupt" in errors
    spent = after.children_user + after.children_system
    assert spent - before.children_user - before.children_system < 20
