"""Run-up and coast-down of an unbalance: the formula in mpmath, rotors by SciPy."""

import pickle

import mpmath
import numpy as np
import pytest
import viscovib as vv


def force(u, speed, duration, start=0.0, phase=0.0):
    """Im[u (phi'^2 - i phi'') exp(i phi)] at a time, 0 before the start."""

    def at(t):
        tau = t - start
        slope = (speed[1] - speed[0]) / duration
        if tau < 0:
            return 0.0 * np.imag(u)
        early = min(tau, duration)
        rate = speed[0] + slope * early
        phi = phase + 0.5 * (speed[0] + rate) * early + speed[1] * (tau - early)
        return np.imag(u * (rate**2 - 1j * slope * (tau < duration)) * np.exp(1j * phi))

    return at


def test_the_load_has_the_values_of_its_formula():
    """Within 1e-14 of the largest force, up to 10000 revolutions, by mpmath with 40 digits."""
    rng = np.random.default_rng(1)
    for index in range(40):
        speed = 10.0 ** rng.uniform(-1, 3, 2) * [index % 3 != 1, index % 3 != 2]
        duration = 10.0 ** rng.uniform(-1, 4) * 2 * np.pi / speed.max()
        hold, start = rng.choice([0, duration * rng.uniform()]), duration * rng.uniform(-1, 3)
        u, phase = rng.normal() + 1j * rng.normal() * (index % 2), rng.uniform(-4, 4)
        load = vv.RunUp(
            unbalance=u, speed=speed, duration=duration, hold=hold, start=start, phase=phase
        )
        if speed[1] == 0:  # No force during the hold.
            hold = 0.0
        assert abs(load.times[-1] - start - duration - hold) < 1e-13 * abs(load.times).max()
        t = rng.uniform(load.times[0], load.times[-1], 60)
        with mpmath.workdps(40):
            first, last, length, begin, angle = map(
                mpmath.mpf, [*speed.tolist(), duration, start, phase]
            )
            slope = (last - first) / length
            for time, found in zip(t.tolist(), load(t), strict=True):
                tau = mpmath.mpf(time) - begin
                early = min(tau, length)
                rate = first + slope * early
                phi = angle + (first + rate) / 2 * early + last * (tau - early)
                turn = mpmath.mpc(u) * (rate**2 - 1j * (slope if tau < length else 0))
                off = abs((turn * mpmath.expj(phi)).imag - found)
                assert off < 1e-14 * abs(u) * max(speed.max() ** 2, abs(slope))


def test_the_last_speed_has_the_response_to_a_periodic_unbalance():
    """Of a body, with an arm from the centre of mass."""
    body = vv.Body(
        mass=10, inertia=(0.1, 0.2, 0.3),
        mounts=[
            vv.MountPoint(
                name=name, position=at, stiffness=(1e4, 1.5e4, 2e4), damping=(60, 80, 100)
            )
            for name, at in [("a", (0.3, 0.1, -0.1)), ("b", (-0.2, 0.2, -0.1)), ("c", (0, -0.3, 0))]
        ],
    )  # fmt: skip
    u = body.unbalance(1.0, 0.05, at=(0.1, 0.02, -0.1), axis=(1, 0, 0.3))
    speed, duration, hold = (20.0, 90.0), 3.0, 20.0
    load = vv.RunUp(unbalance=u, speed=speed, duration=duration, hold=hold, phase=0.4)
    end = duration + hold
    run = vv.simulate(body, end, force=load, tolerance=1e-11)
    dynamic = body.stiffness + 90.0j * body.damping - 90.0**2 * body.mass
    angle = 0.4 + 0.5 * sum(speed) * duration + 90.0 * hold
    wanted = np.imag(np.linalg.solve(dynamic, 90.0**2 * u) * np.exp(1j * angle))
    assert np.abs(run.state[-1, ::2] - wanted).max() < 1e-9 * np.abs(wanted).max()


def test_run_ups_act_alike_on_every_system():
    load = vv.RunUp(unbalance=(0.01, 0.02j), speed=(30.0, 0.0), duration=2.0)
    given = {"mass": np.eye(2), "stiffness": [[200, -50], [-50, 90]], "damping": 0.3 * np.eye(2)}
    rubber = vv.PronyKernel(weights=[0.1], rates=[2.0])
    runs = [
        vv.simulate(kind(**given), 2.5, dt=0.01, force=load)
        for kind in (vv.PolynomialSystem, vv.Structure)
    ]
    assert np.abs(runs[0].state - runs[1].state).max() < 1e-12 * np.abs(runs[0].state).max()
    one = vv.PolynomialSystem(mass=1, stiffness=100, damping=0.5, kernel=rubber)
    two = vv.Structure(
        mass=[[1.0]], stiffness=[[0.0]], damping=[[0.5]],
        elements=[vv.Spring(on={"x1": 1}, stiffness=100, kernel=rubber)],
    )  # fmt: skip
    load = vv.RunUp(unbalance=0.01j, speed=(30.0, 0.0), duration=2.0)
    along = vv.RunUp(unbalance=0.01j, speed=(30.0, 0.0), duration=2.0, on={"x1": 1})
    runs = [vv.simulate(one, 2.5, dt=0.01, force=load), vv.simulate(two, 2.5, dt=0.01, force=along)]
    assert np.abs(runs[0].state - runs[1].state).max() < 1e-12 * np.abs(runs[0].state).max()


def test_run_ups_are_pickled_and_printed_and_bad_ones_refused():
    load = vv.RunUp(unbalance=0.01, speed=(0.0, 100.0), duration=2.0)
    t = np.linspace(-1, 3, 50)
    assert np.array_equal(pickle.loads(pickle.dumps(load))(t), load(t))
    assert repr(load) == "RunUp(unbalance=0.01, speed=(0.0, 100.0), duration=2.0)"
    for given, says in [
        ({"speed": (-1, 2)}, "speed = -1, 2: must not be negative, and not both 0"),
        ({"speed": (0, 0)}, "speed = 0, 0: must not be negative, and not both 0"),
        ({"speed": 3.0}, "speed: must be two speeds"),
        ({"speed": (0, 1e6)}, "speed, duration: .* cycles, must be at most 20000"),
        ({"hold": 1e5}, "speed, duration: .* cycles, must be at most 20000"),
        ({"hold": -1}, "hold = -1: must not be negative"),
        ({"duration": 0}, "duration = 0: must be greater than 0"),
        ({"start": 1e17}, "times closer than rounding"),
        ({"unbalance": [[1.0]]}, "unbalance: must be a number or have shape"),
        ({"unbalance": np.nan}, "unbalance"),
    ]:
        arguments = {"unbalance": 1.0, "speed": (0, 10), "duration": 1.0} | given
        with pytest.raises(vv.InputError, match=says):
            vv.RunUp(**arguments)
