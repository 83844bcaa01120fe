"""Motions by multiple scales with beating amplitudes, against integration."""

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp
from viscovib.analyses.beat_stability import growth_of_neighbours

BEATS = {
    # Each with the beats of its terms: one, two, and half of one (a mode that is excited
    # parametrically by one load and directly by another).
    "cubic system": (vv.CubicSystem(
        mass=np.eye(2), stiffness=np.diag([1, 4.1]), damping=np.diag([0.02, 0.02]),
        quadratic=0.2 * np.ones((2, 2, 2)), cubic=0.2 * np.ones((2, 2, 2, 2)),
        load=[[0.003, 0.003, 0.002], [0.001, 0.002, 0.004]], drives=[1.0, 2.0173, 1.05],
    ), 1.0, 2),
    "pendulum": (vv.Pendulum(
        e=0.0338, w2=0.552, w3=0.837, alpha=0.369, c1=0.0166, c2=0.00527, c3=0.0126,
        f0=0.0092, m01=0.0014, m02=0.0016, p1=1.041, p2=0.9113, p3=0.5521,
    ), 1.041, 2),
    "parametric": (vv.Pendulum(
        e=0.0102, w2=0.366, w3=0.988, alpha=0.573, c1=0.0258, c2=0.00555, c3=0.00837,
        f0=0.0046, m01=0.00058, m02=0.0017, p1=1.01, p2=1.0086, p3=0.3595,
    ), 1.01, 1),
}  # fmt: skip


def integrate(system, state, t):
    """States of a system by SciPy, of a pendulum by Gauss collocation."""
    if isinstance(system, vv.Pendulum):
        step = t[1] / 8
        return vv.simulate(system, t[-1], initial=state, dt=step, save_every=8).state
    n = len(system.dof_names)
    drives, load = np.asarray(system.drives), np.asarray(system.load)

    def rates(s, y):
        q, v = y[::2], y[1::2]
        force = load @ np.cos(drives * s) - system.stiffness @ q - system.damping @ v
        force -= np.einsum("ijk,j,k->i", system.quadratic, q, q)
        force -= np.einsum("ijkl,j,k,l->i", system.cubic, q, q, q)
        return np.ravel(np.column_stack([v, np.linalg.solve(system.mass, force)]))

    found = solve_ivp(rates, (0, t[-1]), state, "DOP853", t, rtol=1e-10, atol=1e-12)
    assert n == found.y.shape[0] // 2
    return found.y.T


def test_a_steady_motion_has_no_beats():
    steady = vv.MultipleScales(vv.Pendulum(e=0.1, w2=0.4, w3=0.8, c1=0.01, f0=0.002, p1=1.02))
    steady = steady.response("p1", [1.02])
    assert not steady.n_beats.any()
    assert not steady.beating_points.size
    with pytest.raises(vv.InputError, match=r"point = 0: is a steady motion"):
        steady.beating(0)


def test_a_motion_that_settles_on_no_beats_is_reported_with_what_follows_it():
    """Two modes exchange energy with a frequency that is not that of the loads."""
    pend = vv.Pendulum(
        e=0.137, w2=0.516, w3=0.621, alpha=0.244, c1=0.0067, c2=0.0299, c3=0.00647,
        f0=0.0043, m01=0.00017, m02=0.00054, p1=1.0131, p2=0.7472, p3=0.4759,
    )  # fmt: skip
    with pytest.warns(vv.RangeWarning, match=r"no beats with .*forced_response"):
        steady = vv.MultipleScales(pend).response("p1", [pend.p1])
    assert not steady.in_range.any()


@pytest.mark.parametrize("name", ["cubic system", "pendulum"])
def test_what_neighbours_grow_by_in_the_full_equations(name):
    """Two neighbouring integrated motions converge as stated by the full equations."""
    system, p1, _ = BEATS[name]
    scales = vv.MultipleScales(system)
    response = scales.response("p1", [p1])
    motion = response.beating(response.beating_points[0])
    f, x = motion.frequencies, motion.harmonics
    growth, error = growth_of_neighbours(
        system, {"p1": p1}, f, x, motion.errors, scales.decay.min()
    )
    assert motion.stable is True
    assert error < 0.2 * abs(growth)
    assert motion.growth_error <= abs(motion.growth)
    assert abs(motion.growth - growth) <= error + motion.growth_error
    state = np.ravel(np.column_stack([x.sum(axis=0).real, ((1j * f) @ x).real]))
    t = np.linspace(0, round(5 / abs(growth)), 501)
    if name == "pendulum":
        runs = [
            vv.simulate(system, t[-1], initial=s, dt=0.1, method="dop8", keep="last").state
            for s in (state, state * 1.001)
        ]
    else:
        runs = [integrate(system, s, t) for s in (state, state * 1.001)]
    apart = np.abs(runs[1][-1] - runs[0][-1]).max()
    # The remaining distance is e^-5 of a thousandth, within its fluctuation.
    found = np.log(apart / (1e-3 * np.abs(state).max())) / t[-1]
    assert abs(found - growth) < error + 1.5 / t[-1]


def test_a_motion_that_the_equations_leave_has_no_verdict():
    """Spectral lines that do not belong to the motion: the run ends elsewhere."""
    system, p1, _ = BEATS["pendulum"]
    response = vv.MultipleScales(system).response("p1", [p1])
    motion = response.beating(response.beating_points[0])
    lines = 1.5 * motion.harmonics
    reported = growth_of_neighbours(
        system, {"p1": p1}, motion.frequencies, lines, motion.errors / 10, 0.0025
    )
    assert reported[1] == np.inf
