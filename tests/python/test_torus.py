"""Quasi-periodic motions of the pendulum, against long time integration."""

import itertools
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp
from referee.models import Swinging

# Few harmonics are intended here; test_truncation.py tests the warning.
pytestmark = pytest.mark.filterwarnings("ignore:.*estimated relative error")

BODY = {"e": 0.1, "w2": 0.4, "w3": 0.8, "alpha": 0.5, "c1": 0.1, "c2": 0.1, "c3": 0.1}
TWO = vv.Pendulum(**BODY, f0=0.02, m01=0.005, p1=0.93, p2=0.37)
THREE = vv.Pendulum(**BODY, f0=0.01, m01=0.001, m02=0.003, p1=0.93, p2=0.37, p3=0.71)


@pytest.mark.parametrize("equations", ["exact", "cubic", "printed"])
def test_motion_solves_the_equations(equations):
    """The Fourier sum with its velocity and acceleration, at random times."""
    pend = replace(TWO, equations=equations, m01=0.002)
    r = vv.forced_response(pend)
    assert r.truncation[0] <= 1e-10
    t = np.random.default_rng(3).uniform(0, 1e4, 200)
    state, omega = r.state(0, t), r.frequencies()
    waves = np.exp(1j * np.outer(t, omega))
    acceleration = (waves @ (-(omega**2) * r.coefficients[0]).T).imag
    assert pend.rhs(t, state)[:, 1::2] == pytest.approx(acceleration, abs=1e-9)


def test_two_axes_of_one_frequency_give_the_periodic_motion():
    """Frequencies 1 : 2, first treated as incommensurate, then as periodic."""
    pend = replace(TWO, p1=0.74)
    apart = vv.forced_response(pend, p1=0.74, harmonics=14, stability=True)
    together = vv.forced_response(pend, harmonics=30, stability=True)
    assert apart.axes == ("p1", "p2")
    assert together.axes == ("nu",)
    assert together.nu[0] == 0.37
    t = np.linspace(0, 50, 200)
    assert apart.state(0, t) == pytest.approx(together.state(0, t), abs=1e-8)


def test_growth_of_small_motions_is_the_linear_one():
    """Real parts of the characteristic roots at rest."""
    pend = replace(TWO, f0=1e-5, m01=1e-5, c1=0.02, c2=0.05, c3=0.15)
    r = vv.forced_response(pend, stability=True)
    roots = np.linalg.eigvals(pend.jacobian(0.0, np.zeros(6))).real
    assert r.growth[0] == pytest.approx(np.sort(roots)[::-1], rel=1e-4)
    assert r.stable[0]


def test_growth_adds_up_to_the_divergence():
    """Liouville: the sum of all rates is the mean trace of the Jacobian along the motion."""
    r = vv.forced_response(TWO, harmonics=14, stability=True)
    s = np.linspace(0, 1, 20001)[1:-1]
    weight, t = np.exp(-1 / (s * (1 - s))), 20000 * s
    trace = np.trace(TWO.jacobian(t, r.state(0, t)), axis1=1, axis2=2)
    assert np.ptp(trace) > 1e-2
    mean = (weight * trace).sum() / weight.sum()
    assert r.growth[0].sum() == pytest.approx(mean, rel=1e-9)


def test_growth_of_a_periodic_motion_taken_for_a_quasi_periodic_one():
    pend = replace(TWO, p1=0.74)
    apart = vv.forced_response(pend, p1=0.74, harmonics=14, duration=20000, stability=True)
    together = vv.forced_response(pend, harmonics=30, stability=True)
    assert apart.growth[0] == pytest.approx(together.growth[0], rel=2e-3)
    assert together.growth[0].sum() == pytest.approx(apart.growth[0].sum(), rel=1e-9)
    size = np.abs(together.multipliers[0])
    assert together.growth[0] == pytest.approx(np.log(size) * 0.37 / (2 * np.pi), rel=1e-12)


def test_parametric_resonance_of_a_quasi_periodic_motion():
    """f0 makes a small swing at p2 unstable; a perturbed run grows with the computed rate."""
    pend = vv.Pendulum(
        e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.02, c2=0.02, c3=0.02, f0=0.1, p1=0.72,
        m01=1e-5, p2=0.2517,
    )  # fmt: skip
    r = vv.forced_response(pend, harmonics=10, stability=True)
    assert r.converged[0]
    assert not r.stable[0]
    t = np.array([10, 25]) * 4 * np.pi / 0.72
    start = r.state(0, 0.0) + [0, 0, 1e-9, 0, 0, 0]
    run = vv.simulate(pend, 450, dt=0.25, initial=start, method="gauss16", times=t)
    away = np.linalg.norm((run.state - r.state(0, t))[:, 2:], axis=1)
    rate = np.log(away[1] / away[0]) / (t[1] - t[0])
    assert r.growth[0, 0] == pytest.approx(rate, rel=0.02)


def test_what_symmetry_leaves_out_is_zero():
    orders = vv.forced_response(THREE, harmonics=3)
    odd = (orders.orders[:, 1] + orders.orders[:, 2]) % 2 != 0
    assert np.abs(orders.coefficients[0, 0, odd]).max() == 0
    assert np.abs(orders.coefficients[0, 1:, ~odd]).max() == 0
    assert np.abs(orders.coefficients[0, 1:, odd]).max() > 1e-3
    # Loads of one frequency on z and on phi do not have this symmetry.
    free = vv.forced_response(replace(TWO, p1=0.37), harmonics=5)
    assert np.abs(free.coefficients[0]).min(axis=1).max() > 0


def test_branch_of_quasi_periodic_motions():
    branch = vv.trace_response(TWO, m01=(0, 0.005), harmonics=6)
    assert branch.outcome == "completed"
    assert branch.stable is None
    assert branch.axes == ("p1", "p2")
    single = vv.forced_response(TWO, harmonics=6, tolerance=1e-12)
    assert branch.coefficients[-1] == pytest.approx(single.coefficients[0], abs=1e-9)
    assert branch.amplitude("z", (1, 2))[-1] == pytest.approx(
        single.amplitude("z", (1, 2))[0], abs=1e-9
    )
    vv.plot_branch(branch, harmonic=(0, 1))[1].figure.clear()
    again = vv.trace_response(TWO, m01=(0, 0.005), harmonics=6, symmetric=True, duration=500)
    assert again.coefficients[-1] == pytest.approx(branch.coefficients[-1], abs=1e-12)
    assert again.stable.all()
    rates = vv.forced_response(TWO, harmonics=6, duration=500, stability=True).growth[0]
    assert again.growth[-1] == pytest.approx(rates, rel=1e-6)
    swept = vv.trace_response(TWO, p1=(0.9, 1.1), harmonics=5)
    assert swept.outcome == "completed"
    assert swept.base[:, 0] == pytest.approx(swept.parameter)
    assert np.ptp(swept.base[:, 1]) == 0


def test_orders_and_their_negatives():
    r = vv.forced_response(TWO, harmonics=4)
    assert r.orders[0].tolist() == [0, 0]
    kept = {tuple(k) for k in r.orders.tolist()}
    for k in itertools.product(range(-4, 5), repeat=2):
        inside = sum(map(abs, k)) <= 4
        negative = (-k[0], -k[1])
        assert inside == (k in kept or negative in kept)
        if inside:
            both = r.coefficient("phi", k), r.coefficient("phi", negative)
            assert both[0] == -both[1].conj() or k == (0, 0)
    with pytest.raises(vv.InputError, match=r"harmonic = 1: must be 2 integers"):
        r.amplitude("phi")
    with pytest.raises(vv.InputError, match="no period"):
        r.waveform(0)


@pytest.mark.parametrize(
    ("loads", "axes", "base", "drives"),
    [
        ({"p1": 0.6, "p2": 0.4}, ("nu",), [0.2], [[3], [2], [0]]),
        ({"p1": 0.1 * 3, "p2": 0.1}, ("nu",), [0.1], [[3], [1], [0]]),
        ({"p1": 1.0, "p2": 2**0.5}, ("p1", "p2"), [1.0, 2**0.5], [[1, 0], [0, 1], [0, 0]]),
        ({"p1": 1.0, "p2": 13 / 14}, ("p1", "p2"), [1.0, 13 / 14], [[1, 0], [0, 1], [0, 0]]),
        (
            {"p1": 1.0, "p2": 2**0.5, "p3": 0.5, "m02": 1.0},
            ("nu", "p2"), [0.5, 2**0.5], [[2, 0], [0, 1], [1, 0]],
        ),
        ({"p1": 0.0, "p2": 0.3}, ("p2",), [0.3], [[0], [1], [0]]),
    ],
)  # fmt: skip
def test_frequencies_are_sorted(loads, axes, base, drives):
    pend = vv.Pendulum(**(BODY | {"f0": 0.001, "m01": 0.001} | loads))
    r = vv.forced_response(pend, stability=False)
    assert r.axes == axes
    assert r.base[0] == pytest.approx(base, rel=1e-15)
    assert np.dot(drives, r.base[0]) == pytest.approx([pend.p1, pend.p2, pend.p3], rel=1e-15)
    lowest = np.abs(drives).sum(axis=1).max()
    with pytest.raises(vv.InputError, match=rf"harmonics = 0: must be {lowest} to"):
        vv.forced_response(pend, harmonics=0)


def _cross_polytope(n_axes, bound):
    sides = itertools.product(range(-bound, bound + 1), repeat=n_axes)
    return {k for k in sides if sum(map(abs, k)) <= bound}


def test_lattices_are_complete():
    """Half of the points of a cross polytope, shell by shell, 0 first, up to the capacity."""
    loads = {"f0": 1e-4, "m01": 1e-4, "m02": 1e-4}
    for n_axes in (1, 2, 3):
        acting = dict(list(loads.items())[:n_axes])
        pend = vv.Pendulum(**BODY, **acting, p1=0.93, p2=0.37, p3=0.71)
        for bound in (1, 2, 5):
            orders = vv.forced_response(pend, harmonics=bound, stability=False).orders
            whole = _cross_polytope(n_axes, bound)
            half = {tuple(k) for k in orders.tolist()}
            assert half | {tuple(-i for i in k) for k in half} == whole
            assert len(half) == len(orders) == (len(whole) + 1) // 2
            shells = np.abs(orders).sum(axis=1)
            assert shells[0] == 0
            assert (np.diff(shells) >= 0).all()
        with pytest.raises(vv.InputError, match="harmonics = 0: must be 1 to") as caught:
            vv.trace_response(pend, f0=(1e-4, 2e-4), harmonics=0)
        largest = int(str(caught.value).split()[-1])
        assert 3 * len(_cross_polytope(n_axes, largest)) <= 4000
        assert 3 * len(_cross_polytope(n_axes, largest + 1)) > 4000 or largest == 399


def test_a_static_load_shifts_the_rest():
    pend = vv.Pendulum(**BODY, f0=0.05, p1=0.0, m01=1e-5, p2=0.3)
    r = vv.forced_response(pend)
    run = solve_ivp(
        Swinging.of(pend).right, (0, 600), np.zeros(6), "DOP853", rtol=1e-12, atol=1e-14
    )
    assert r.state(0, 600.0) == pytest.approx(run.y[:, -1], abs=1e-9)
    assert r.coefficients[0, 0, 0].imag > 0.04


def test_too_much_is_refused():
    with pytest.raises(vv.InputError, match="p1: 99999 points, must be at most"):
        vv.forced_response(TWO, p1=np.linspace(0.5, 1.5, 99999), harmonics=18)
    with pytest.raises(vv.InputError, match="harmonics = 90: must be 1 to"):
        vv.forced_response(TWO, harmonics=90)
    with pytest.raises(vv.InputError, match="duration = 0: must be in"):
        vv.forced_response(TWO, stability=True, duration=0)
    with pytest.raises(vv.InputError, match="duration = 500: needs stability=True"):
        vv.forced_response(TWO, duration=500)


def test_long_work_hears_an_interrupt(start):
    """Work of minutes ends after little processor time."""
    program = (
        "import numpy as np, viscovib as vv\n"
        "p = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, c1=0.1, c2=0.1, c3=0.1, f0=0.01, m01=0.001, "
        "p1=0.93, p2=0.37)\n"
        "print('ready', flush=True)\n"
        "vv.forced_response(p, p1=np.linspace(0.5, 1.5, 5000), harmonics=18)\n"
    )
    begun = os.times()
    child = start(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert child.stdout.readline() == "ready\n"
    time.sleep(0.5)
    child.send_signal(signal.SIGINT)
    _, errors = child.communicate(timeout=300)
    ended = os.times()
    spent = ended.children_user + ended.children_system
    assert spent - begun.children_user - begun.children_system < 20
    assert "KeyboardInterrupt" in errors


def test_a_duration_that_decides_nothing_is_reported():
    with pytest.warns(vv.StabilityWarning, match="smaller than its error, take a longer duration"):
        rows = vv.forced_response(TWO, harmonics=6, stability=True, duration=3)
    assert rows.stable.tolist() == [None]
    assert rows.to_dataset().stable.values.tolist() == [-1]
    assert "0 stable" in str(rows)
    with pytest.warns(vv.StabilityWarning, match="take a longer duration"):
        branch = vv.trace_response(TWO, m01=(0.004, 0.005), harmonics=6, duration=3)
    assert set(branch.stable.tolist()) == {None}
    assert branch.growth_error.shape == branch.growth.shape
    vv.plot_branch(branch, harmonic=(1, 0))
    assert branch.to_dataset().stable.values.tolist() == [-1] * branch.parameter.size
