"""Peaks, means and final states of ensembles with kinked or jumping laws, by SciPy."""

import re

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

#: Laws of one coordinate x1 (and its velocity) with numbers k and g; their switching surfaces; and
#: the laws with fixed sides of these surfaces.
LAWS = {
    "k*max(x1 - g, 0)": (
        [lambda y, g: y[0] - g],
        lambda y, k, g, s: k * (y[0] - g) * (s[0] > 0),
    ),
    "0.1*k*abs(x1 - 0.2*g)": (
        [lambda y, g: y[0] - 0.2 * g],
        lambda y, k, g, s: 0.1 * k * s[0] * (y[0] - 0.2 * g),
    ),
    "where(x1 > g, k*(x1 - g) + 0.2, 0)": (
        [lambda y, g: y[0] - g],
        lambda y, k, g, s: (k * (y[0] - g) + 0.2) * (s[0] > 0),
    ),
    "k*(max(x1 - g, 0) + min(x1 + g, 0))": (
        [lambda y, g: y[0] - g, lambda y, g: y[0] + g],
        lambda y, k, g, s: k * ((y[0] - g) * (s[0] > 0) + (y[0] + g) * (s[1] < 0)),
    ),
    "g*sign(x1)": ([lambda y, g: y[0]], lambda y, k, g, s: g * s[0]),
    "k*max(x1_dot, 0)": ([lambda y, g: y[1]], lambda y, k, g, s: k * y[1] * (s[0] > 0)),
}
END = 12.0


def matrices(n):
    """Springs and dampers of a chain fixed at one end."""
    chain = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    chain[-1, -1] = 1.0
    return chain, 0.08 * chain


def true_motion(text, n, k, g, load, nu, start, begin=0.0, end=END):
    """Final state, and peaks, means and rms from begin to end, from switch to switch."""
    surfaces, law = LAWS[text]
    stiffness, damping = matrices(n)

    def acceleration(t, y, sides):
        force = -stiffness @ y[: 2 * n : 2] - damping @ y[1 : 2 * n : 2]
        force[0] += load * np.sin(nu * t) - law(y, k, g, sides)
        return force

    def rates(t, y, sides):
        own = np.empty(2 * n)
        own[::2], own[1::2] = y[1 : 2 * n : 2], acceleration(t, y, sides)
        return np.concatenate([own, y[: 2 * n], y[: 2 * n] ** 2])

    switches = [lambda t, y, sides, f=f: f(y, g) for f in surfaces]
    for one in switches:
        one.terminal = True
    tops = [lambda t, y, sides, i=i: y[2 * i + 1] for i in range(n)]
    tops += [lambda t, y, sides, i=i: acceleration(t, y, sides)[i] for i in range(n)]
    t, y = begin, np.concatenate([start, np.zeros(4 * n)])
    sides = [np.sign(f(y, g)) or 1.0 for f in surfaces]
    peak = np.abs(start)
    while t < end:
        # Start slightly off the surface, or the event would be found again.
        run = None
        for until, events in ((min(t + 1e-7, end), []), (end, [*switches, *tops])):
            if t >= until:
                continue
            run = solve_ivp(
                rates, (t, until), y, "DOP853", rtol=1e-11, atol=1e-13, args=(sides,),
                events=events, max_step=0.05,
            )  # fmt: skip
            t, y = run.t[-1], run.y[:, -1]
            found = [one[:, : 2 * n] for one in (run.y_events or []) if one.size]
            peak = np.max([peak, *(np.abs(one).max(0) for one in [*found, run.y.T[:, : 2 * n]])], 0)
        for j, times in enumerate((run.t_events or [])[: len(switches)]):
            if times.size:
                sides[j] = -sides[j]
    mean, squares = y[2 * n : 4 * n] / (end - begin), y[4 * n :] / (end - begin)
    return y[: 2 * n], peak, mean, np.sqrt(squares)


@pytest.mark.parametrize("seed", range(9))
def test_kinked_ensembles(seed):
    """For random systems each member has its stated accuracy and equals the single run."""
    rng = np.random.default_rng(seed)
    text, n = list(LAWS)[seed % len(LAWS)], 1 + seed % 3
    stiffness, damping = matrices(n)
    names = [f"x{i + 1}" for i in range(n)]
    system = vv.PolynomialSystem(
        mass=np.eye(n), stiffness=stiffness, damping=damping, names=names,
        forces=text if n == 1 else {"x1": text}, parameters={"k": 1.0, "g": 0.3},
    )  # fmt: skip
    drawn = {"k": rng.uniform(0.5, 4, 2), "g": rng.uniform(0.1, 0.4, 2)}
    given = {name: values for name, values in drawn.items() if re.search(rf"\b{name}\b", text)}
    discard = float(rng.choice([0.0, 3.1]))
    starts, nu = rng.uniform(-0.5, 0.5, (2, 2 * n)), float(rng.uniform(0.5, 2))
    many = vv.simulate_ensemble(
        system, initial=starts, t_end=END, load={"x1": 0.9}, nu=nu, parameters=given,
        statistics=True, tolerance=1e-9, discard=discard,
    )  # fmt: skip
    assert many.error <= 1e-9
    for i in range(2):
        k, g = (float(drawn[name][i]) for name in "kg")
        at = (text, n, k, g, 0.9, nu)
        start = true_motion(*at, starts[i], 0.0, discard)[0] if discard else starts[i]
        true = true_motion(*at, start, discard)
        allowed = 3 * many.error + 2e-9
        for reported, value in zip((many.state, many.peak, many.mean, many.rms), true, strict=True):
            np.testing.assert_allclose(reported[i], value, rtol=0, atol=allowed, err_msg=text)


def test_impacts_and_friction_with_memory_of_their_own():
    """Means of velocities are displacements over time; peaks agree with those of many states."""
    hard = vv.Gap(on={"x1": 1}, gap=0.3, restitution=0.8)
    slip = vv.Jenkins(on={"x1": 1}, stiffness=2.0, limit=0.3)
    for element in (hard, slip):
        body = vv.Structure(mass=[1.0], stiffness=[1.0], damping=[0.05], elements=[element])
        call = {"initial": [0.1, 0.3], "load": 0.7, "nu": 0.9}
        many = vv.simulate_ensemble(body, t_end=15.0, statistics=True, **call)
        run = vv.simulate(body, 15.0, times=np.linspace(0, 15, 20_001), **call)
        assert many.error < 1e-8
        assert many.mean[0, 1] == pytest.approx((many.state[0, 0] - 0.1) / 15, abs=1e-12)
        most = np.abs(run.state).max(0)
        assert (many.peak[0] >= most - 1e-9).all()
        np.testing.assert_allclose(many.peak[0], most, rtol=1e-3)


def test_a_lane_that_stops_before_anything_is_gathered():
    """Its statistics are unknown; the other member is unchanged."""
    away = vv.PolynomialSystem(mass=1, stiffness=1, forces="-0.5*x^3 + 0.3*max(x - 0.2, 0)")
    many = vv.simulate_ensemble(
        away, initial=[[0.1, 0], [9.0, 0]], t_end=10.0, discard=5.0, statistics=True
    )
    assert list(many.outcome) == ["completed", "diverged"]
    assert np.isnan(many.peak[1]).all()
    assert many.peak[0, 0] <= 0.1 + 1e-8


@pytest.mark.parametrize("seed", range(5))
def test_located_peaks_of_members(seed):
    """Of oscillators with parameters, by SciPy: at the times of the peaks, and around these."""
    rng = np.random.default_rng([7, seed])
    system = vv.PolynomialSystem(
        mass=1, stiffness=1, damping=0.1, forces="k3*x^3", parameters={"k3": 1.0}
    )
    starts, k3 = rng.uniform(-1, 1, (3, 2)), rng.uniform(0.2, 2, 3)
    nu, discard = float(rng.uniform(0.5, 2)), float(rng.choice([0.0, 2.3]))
    many = vv.simulate_ensemble(
        system, initial=starts, t_end=12.0, load=0.7, nu=nu, parameters={"k3": k3}, tolerance=1e-10,
        discard=discard, peaks=["x", "x_dot", "x_ddot", lambda run: 2 * run.state[:, 0]],
    )  # fmt: skip
    assert [one.name for one in many.peaks] == ["x", "x_dot", "x_ddot", "<lambda>"]
    for i in range(3):

        def slopes(t, y, k=k3[i]):
            return y[1], 0.7 * np.sin(nu * t) - y[0] - 0.1 * y[1] - k * y[0] ** 3

        own = [one.t[i] for one in many.peaks]
        times = np.unique([*np.linspace(discard, 12, 3001), *own])
        run = solve_ivp(
            slopes, (0, 12), starts[i], "DOP853", rtol=1e-12, atol=1e-13, t_eval=times,
            dense_output=True,
        )  # fmt: skip
        values = np.array([*run.y, slopes(run.t, run.y)[1], 2 * run.y[0]])
        for one, column in zip(many.peaks, values, strict=True):
            assert abs(column[np.searchsorted(times, one.t[i])] - one.value[i]) < 3e-9
            assert abs(one.value[i]) > np.abs(column).max() - one.error[i] - 3e-9
            assert one.error[i] < 1e-8


def test_located_peaks_of_every_kind_of_member():
    """Those of single runs with the numbers of each member; NaN where a motion ends early."""
    foot = vv.MountPoint(
        name="foot", position=(0, 0, 0.1), stiffness=(200, 200, 400), damping=(1, 1, 2),
        kernel=vv.PronyKernel(weights=[0.2], rates=[3.0]),
    )  # fmt: skip
    body = vv.Body(mass=8, inertia=(0.2, 0.3, 0.35), mounts=[foot])
    slip = vv.Jenkins(on={"x1": 1}, stiffness=2.0, limit=0.3)
    frame = vv.Structure(mass=[1.0], stiffness=[1.0], damping=[0.05], elements=[slip])
    pendulum = vv.Pendulum(
        e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01, f0=0.02, p1=0.93
    )
    cases = [
        (body, {"mass": [7.0, 8.0]}, {"load": body.load((1, 0, 9)), "nu": 9.0},
         ["foot.z", "floor.x", "ry_ddot", lambda run: run.motion_of("foot").velocity[:, 2]]),
        (frame, {"elements[0].limit": [0.2, 0.4]}, {"load": 0.9, "nu": 0.8}, ["x1_ddot", "x1"]),
        (pendulum, {"f0": [0.02, 0.04]}, {}, ["z_ddot", "phi"]),
    ]  # fmt: skip
    for system, given, call, peaks in cases:
        start = np.linspace(0.05, 0.1, 2 * len(system.dof_names))
        many = vv.simulate_ensemble(
            system, initial=start, t_end=5.0, parameters=given, peaks=peaks, **call
        )
        for i in range(2):
            numbers = {name: values[i] for name, values in given.items()}
            one = system._with_parameters(numbers)
            run = vv.simulate(one, 5.0, initial=start, tolerance=1e-8, **call)
            alone = run.peak(peaks)
            for top, its in zip(many.peaks, alone, strict=True):
                assert (top.name, top.value[i]) == (its.name, its.value)
        assert "peak of " + many.peaks[0].name in many.to_dataset()
    away = vv.PolynomialSystem(mass=1, stiffness=1, forces="-0.5*x^3")
    many = vv.simulate_ensemble(away, initial=[[0.1, 0], [9.0, 0]], t_end=10.0, peaks=["x"])
    assert np.isnan(many.peaks[0].value).tolist() == [False, True]
    with pytest.raises(vv.InputError, match=r"quantity = 'y': must be one of .*'x_ddot'"):
        vv.simulate_ensemble(away, initial=[0.1, 0], t_end=10.0, peaks=["y"])
    for wrong in ("x", 1, None):
        with pytest.raises(vv.InputError, match=r"peaks = .*: must be a list of names"):
            vv.simulate_ensemble(away, initial=[0.1, 0], t_end=10.0, peaks=wrong)
