"""Ends of motions, against an independent integrator, over random systems."""

import math
from dataclasses import replace

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp
from referee.models import Swinging


class TooLong(Exception):
    """The reference program takes too long."""


def reach(rhs, start, t_end, stops):
    """Return the end of a motion by the reference program, and the event that ended it."""
    calls = 0

    def counted(t, y):
        nonlocal calls
        calls += 1
        if calls > 20_000:
            raise TooLong
        return rhs(t, y)

    for event in stops:
        event.terminal = True
    run = solve_ivp(
        counted, (0, t_end), start, method="DOP853", rtol=1e-12, atol=1e-12, events=list(stops)
    )
    stopped = [k for k, times in enumerate(run.t_events) if len(times)]
    return run.t[-1], run.y[:, -1], stopped[0] if stopped else None


def softening(rng):
    """Return a softening oscillator of one or two coordinates and its equations."""
    n = int(rng.integers(1, 3))
    k = np.diag(rng.uniform(0.5, 2, n))
    if n == 2:
        c = rng.uniform(0.1, 0.5)
        k += c * np.array([[1, -1], [-1, 1]])
    damping = 0.05 * np.eye(n)
    soft, names = rng.uniform(0.2, 1.5, n), ["a", "b"][:n]
    system = vv.PolynomialSystem(
        mass=np.eye(n),
        stiffness=k,
        damping=damping,
        names=names,
        forces={name: f"-{float(s)!r}*{name}^3" for name, s in zip(names, soft, strict=True)},
    )
    size, nu = rng.uniform(0, 0.5), rng.uniform(0.3, 2)

    def rhs(t, y):
        u, v = y[::2], y[1::2]
        a = -k @ u - damping @ v + soft * u**3
        a[0] += size * math.sin(nu * t)
        return np.stack([v, a], axis=1).ravel()

    force = np.zeros(n)
    force[0] = size
    return system, rhs, force, nu


def escape_by(way, system, start, t_end):
    """Return outcome, time and error of a motion computed in one of the available ways."""
    if way == "ensemble":
        many = vv.simulate_ensemble(
            system, initial=[start, 0.1 * start], t_end=t_end, tolerance=1e-8
        )
        assert many.outcome[1] == "completed"
        return many.outcome[0], many.t_reached[0], many.error
    more = {"events": {"events": "x - 0.1"}, "times": {"times": np.linspace(0, t_end, 9)}}
    run = vv.simulate(system, t_end, initial=start, tolerance=1e-8, **more.get(way, {}))
    assert way in more or run.outcome == "completed" or run.t.size > 20
    # Errors near the escape belong to large states.
    return run.outcome, run.t_reached, run.error / max(1.0, abs(run.state).max())


@pytest.mark.parametrize("way", ["plain", "text", "events", "times", "structure", "ensemble"])
def test_escapes_on_either_side_of_the_separatrix(way):
    """Near the escape steps are inaccurate at every scale, but its time is accurate."""
    rng = np.random.default_rng(37)
    seen = {}
    for number in range(5):
        power, soft = int(rng.choice([2, 3, 5])), float(rng.uniform(0.05, 1))
        edge = soft ** (-1 / (power - 1))
        near = [1e-4, -1e-4, 1e-2, -1e-2, 0.3 * rng.random()][number % 5]
        start = np.array([edge * (1 + near), 0.0])
        if way == "structure":
            system = vv.Structure(
                mass=[1], stiffness=[[1]], damping=[[0.02]], names=["x"],
                elements=[vv.Spring(on="x", law=f"-{soft!r}*d^{power}")],
            )  # fmt: skip
        else:
            law = f"-{soft!r}*x^{power}"
            if way == "text":
                law = f"-{soft!r}*x*abs(x)^{power - 1}"
            system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.02, forces=law)

        def rhs(t, y, power=power, soft=soft):
            return [y[1], soft * y[0] ** power - 0.02 * y[1] - y[0]]

        # A motion continues until its time does not change.
        bound = 1e10 ** (2 / (power - 1))
        stop = [lambda t, y, bound=bound: max(abs(y[0]) / bound, abs(y[1]) / bound**2.5) - 1]
        t, _, event = reach(rhs, start, 18.0, stop)
        outcome, reached_at, error = escape_by(way, system, start, 18.0)
        assert outcome == ("completed" if event is None else "diverged"), (number, t)
        # Some ways keep large states, whose errors these are.
        assert error <= 1e-7 * max(1, t) or way in ("times", "structure", "ensemble")
        # The uncertainty is that of the rounded start, amplified along the motion.
        assert abs(reached_at - t) <= min(error, 1e-8 * t) + 3e-8, (number, t)
        seen[outcome] = seen.get(outcome, 0) + 1
    assert min(seen["completed"], seen["diverged"]) >= 1


def remembering(rng, kernel):
    """Return a softening oscillator with memory in its linear spring, its equations and a start."""
    soft, k = rng.uniform(0.2, 1), rng.uniform(0.5, 2)
    # With a base direction it uses the integrator of mounts, with or without memory.
    system = vv.PolynomialSystem(
        mass=1,
        stiffness=k,
        damping=0.02,
        kernel=kernel,
        base_direction=[1],
        springs=[vv.Springs(forces=f"-{float(soft)!r}*x^3")],
    )
    weights, rates = np.zeros(0), np.zeros(0)
    if isinstance(kernel, vv.PronyKernel):
        weights, rates = np.array(kernel.weights), np.array(kernel.rates)

    def rhs(t, y):
        pull = 0.02 * y[1] + k * (y[0] - weights @ y[2:]) - soft * y[0] ** 3
        return np.concatenate([[y[1], -pull], y[0] - rates * y[2:]])

    start = np.array([rng.uniform(0.8, 1.8) * math.sqrt(k / soft), 0.0])
    return system, rhs, np.concatenate([start, np.zeros(weights.size)])


@pytest.mark.parametrize("memory", [None, "exponentials", "direct"])
def test_escapes_with_memory_are_found_inside_the_step(memory):
    rng = np.random.default_rng(31)
    kernel = None if memory is None else vv.PronyKernel(weights=[0.1, 0.2], rates=[0.7, 3.0])
    job = {"base": {0: 0j}} | ({} if memory is None else {"memory": memory})
    seen = set()
    # The cost of the whole past grows with the square of the time.
    tolerance, t_end = (1e-5, 4.0) if memory == "direct" else (1e-8, 8.0)
    for _ in range(1 if memory == "direct" else 4):
        system, rhs, start = remembering(rng, kernel)
        t, state, event = reach(rhs, start, t_end, [lambda t, y: abs(y[0]) - 1e9])
        run = vv.simulate(system, t_end, initial=start[:2], tolerance=tolerance, **job)
        seen.add(run.outcome)
        assert run.outcome == ("completed" if event is None else "diverged")
        assert run.error is not None
        assert abs(run.t_reached - t) <= 2 * tolerance
        assert np.isfinite(run.state).all()
        assert run.t[-1] <= run.t_reached
        if event is None:
            assert np.abs(run.state[-1] - state[:2]).max() <= 10 * tolerance
        for dt in (0.1,) if memory == "direct" else (1.0, 0.1, 0.02):
            given = vv.simulate(system, t_end, initial=start[:2], dt=dt, keep="last", **job)
            if event is None:
                assert given.outcome == "completed"
            elif given.outcome != "step too large":
                assert given.outcome == "diverged"
                assert abs(given.t_reached - t) <= 1e-3
                assert given.t.tolist() == [given.t_reached]
                assert np.abs(given.state).max() > 1e6
    assert memory == "direct" or seen == {"completed", "diverged"}


@pytest.mark.parametrize(
    ("method", "dt", "off"), [("rk4", 0.02, 1e-4), ("dop8", 0.1, 1e-6), ("verner9", 0.1, 1e-6)]
)
def test_nothing_is_reported_after_an_escape(method, dt, off):
    """Steps pass the escape before one of them fails, from which small steps go back."""
    rng = np.random.default_rng(41)
    for _ in range(4):
        power, soft = int(rng.choice([2, 3])), float(rng.uniform(0.3, 1))
        system = vv.PolynomialSystem(
            mass=1, stiffness=1, damping=0.05, forces=f"-{soft!r}*x^{power}"
        )

        def rhs(t, y, power=power, soft=soft):
            return [y[1], soft * y[0] ** power - 0.05 * y[1] - y[0]]

        start = [rng.uniform(1.2, 2) * soft ** (-1 / (power - 1)), rng.uniform(-0.3, 0.3)]
        bound = 1e9 if power == 3 else 1e18
        whole_until_the_escape(system, rhs, np.array(start), dt, off, bound=bound, method=method)


def test_nothing_is_reported_after_an_escape_with_memory():
    rng = np.random.default_rng(42)
    kernel = vv.PronyKernel(weights=[0.1, 0.2], rates=[0.7, 3.0])
    for _ in range(6):
        system, rhs, start = remembering(rng, kernel)
        start[0] *= 1.5
        whole_until_the_escape(system, rhs, start, 0.1, 1e-5)


def whole_until_the_escape(system, rhs, start, dt, off, *, bound=1e9, **job):
    """Check that events and requested states are there up to the escape, and none after it.

    Of the step in which the motion escapes they may be missing.
    """
    t, _, event = reach(rhs, start, 5.0, [lambda t, y: abs(y[0]) - bound])
    assert event == 0
    times = np.arange(0.0, 5.0, 0.01)
    early = times[times < t - max(0.3, dt)]
    exact = solve_ivp(
        rhs, (0, early[-1]), start, "DOP853", rtol=1e-11, atol=1e-12, t_eval=early
    ).y[:2].T  # fmt: skip
    zeros = (np.arange(100) + 0.5) * np.pi / 40
    events = ["cos(40*t)", "x - 1e4"]
    for more in ({"times": times}, {}):
        run = vv.simulate(system, 5, initial=start[:2], events=events, dt=dt, **more, **job)
        assert run.outcome == "diverged"
        assert run.t_reached == pytest.approx(t, abs=off)
        clock, level = (one.t for one in run.events)
        for found, known in [(clock, zeros)] + ([(run.t, times)] if more else []):
            np.testing.assert_allclose(found, known[: found.size], atol=1e-9)
            lower, upper = (np.count_nonzero(known <= run.t_reached - part) for part in (dt, 0))
            assert lower <= found.size <= upper
        assert (level <= run.t_reached).all()
        assert run.t[-1] <= run.t_reached
        if more:
            assert np.abs(run.state[: early.size] - exact).max() <= off * np.abs(exact).max()


def test_an_escape_that_a_singular_kernel_remembers():
    """Divided steps need kernels fitted for them: the time does not depend on the step size."""
    rng = np.random.default_rng(32)
    kernel = vv.RabotnovKernel(amplitude=0.3, alpha=0.3, beta=0.5)
    # Each run fits its kernels, which takes most of the time.
    system, _, start = remembering(rng, kernel)
    start[0] *= 1.7
    runs = [vv.simulate(system, 8, initial=start, dt=dt) for dt in (0.2, 0.07)]
    assert [run.outcome for run in runs] == ["diverged"] * 2
    times = [run.t_reached for run in runs]
    assert np.ptp(times) < 2e-6


def hanging(rng, equations="exact"):
    """Return a random pendulum."""
    return vv.Pendulum(
        e=rng.uniform(0.02, 0.1), w2=rng.uniform(0.4, 0.8), w3=rng.uniform(0.6, 1.2),
        c1=0.01, c2=0.01, c3=0.01, f0=rng.uniform(0, 0.4), p1=rng.uniform(0.5, 1.5),
        m01=rng.uniform(0, 0.02), p2=rng.uniform(0.2, 0.9), equations=equations,
    )  # fmt: skip


def through_pivot(body, start, t_end):
    """Return the result of the reference program for a motion of a pendulum."""
    return reach(
        Swinging.of(body).right if body.equations == "exact" else body.rhs,
        start,
        t_end,
        [lambda t, y: y[0] + 1, lambda t, y: np.abs(y[::2]).max() - 1e6],
    )


def outcome_of(t, event, t_end):
    """Return the outcome; the reference program stops where a velocity becomes infinite."""
    if event is None:
        return "completed" if t >= t_end else "diverged"
    return ("unphysical", "diverged")[event]


@pytest.mark.parametrize("kind", ["spring", "swinging", "cubic"])
def test_pendulums_through_their_pivot(kind):
    """No false "unphysical", and true ones at the correct time."""
    rng = np.random.default_rng(8)
    seen = []
    for _ in range(6):
        body = hanging(rng, "cubic" if kind == "cubic" else "exact")
        start = np.array([rng.uniform(-0.6, 0.6), rng.uniform(-1, 1), *[0.0] * 4])
        if kind == "spring":
            body = replace(body, m01=0.0, alpha=rng.uniform(0, 0.2))
            start[:2] *= 1.5
        else:
            start[:2] *= 0.7
            start[2:] = rng.uniform(-0.3, 0.3, 4)
        try:
            t, state, event = through_pivot(body, start, 12.0)
        except TooLong:
            continue
        for job in (
            {"tolerance": 1e-6},
            {"dt": 0.01, "estimate_error": True},
            {"dt": 0.01, "method": "verner9", "estimate_error": True},
        ):
            try:
                run = vv.simulate(body, 12, initial=start, keep="last", **job)
            except vv.InputError as error:
                if "not met" not in str(error):
                    raise
                continue
            if run.error > 1e-6:
                continue
            wanted = outcome_of(t, event, 12.0)
            seen.append(wanted)
            assert run.outcome == wanted
            assert abs(run.t_reached - t) <= 2e-6
            assert run.state[-1, 0] > -1
            if event == 0:
                assert run.state[-1, 0] == pytest.approx(-1, abs=1e-12)
            if wanted != "diverged":
                assert np.abs(run.state[-1] - state).max() <= 1e-4
    assert len(seen) > 8
    assert kind == "swinging" or len(set(seen)) > 1


@pytest.mark.parametrize(
    ("method", "step"),
    [("gauss8", 2.0), ("gauss16", 3.0), ("gauss3", 0.5), ("verner9", 1.0), ("rk4", 0.3)],
)
def test_a_dip_below_the_pivot_inside_a_step_is_seen(method, step):
    """The spring alone passes z = -1 and returns within a step."""
    body = vv.Pendulum(e=0.1, w2=0.4, w3=0.8)
    for amplitude in (1.001, 1.01, 1.1, 1.3):
        run = vv.simulate(body, 20, dt=step, initial=(amplitude, 0, 0, 0, 0, 0), method=method)
        assert run.outcome == "unphysical"
        assert run.t_reached == pytest.approx(
            math.acos(-1 / amplitude), abs=1e-10 if step > 0.5 and method != "verner9" else 1e-2
        )
        assert run.t[-1] <= run.t_reached
        last = vv.simulate(
            body, 20, dt=step, initial=(amplitude, 0, 0, 0, 0, 0), method=method, keep="last"
        )
        assert last.t.tolist() == [run.t_reached]
        assert last.state[0, 0] == pytest.approx(-1, abs=1e-12)
    assert vv.simulate(body, 20, dt=step, initial=(0.99, 0, 0, 0, 0, 0)).outcome == "completed"


def test_wanted_times_end_at_the_stop():
    body = vv.Pendulum(e=0.1, w2=0.4, w3=0.8)
    t = np.linspace(0.1, 19, 57)
    run = vv.simulate(body, 20, dt=1.7, initial=(1.2, 0, 0, 0, 0, 0), times=t)
    stop = math.acos(-1 / 1.2)
    assert run.t.tolist() == t[t < stop].tolist()
    assert run.state[:, 0] == pytest.approx(1.2 * np.cos(run.t), abs=1e-9)


def test_tail_of_a_run_that_stops_before_it():
    body = vv.Pendulum(e=0.1, w2=0.4, w3=0.8)
    run = vv.simulate(body, 20, dt=0.5, initial=(1.2, 0, 0, 0, 0, 0), keep="tail", tail=5)
    assert run.t.tolist() == [run.t_reached]
    assert run.state[0, 0] == pytest.approx(-1, abs=1e-12)


def test_too_large_a_step_is_not_a_stop():
    """The motion continues; only the given step size cannot follow it."""
    body = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, f0=0.3, p1=1)
    start = (0, 0, 0.1, 0, 0, 0)
    assert through_pivot(body, np.array(start), 30.0)[2] is None
    assert vv.simulate(body, 30, dt=1.43, initial=start).outcome == "step too large"
    assert vv.simulate(body, 30, initial=start, tolerance=1e-6).outcome == "completed"


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"system": vv.PolynomialSystem(mass=1, stiffness=5)}, "system: must be that of the run"),
        ({"system": vv.Pendulum(e=0.1, w2=0.4, w3=0.8)}, "system: must be that of the run"),
        ({"dt": 0.2}, "dt: taken from the run"),
        ({"tolerance": 1e-6}, "tolerance: taken from the run"),
        ({"method": "rk4"}, "method: taken from the run"),
        ({"rtol": 1e-6}, "rtol: taken from the run"),
        ({"base": 0.1}, "base: this system has no base_direction"),
        ({"held": [0.1]}, "held: taken from the run"),
        ({"resume": 5}, "resume"),
    ],
)
def test_a_run_goes_on_with_what_it_has_or_refuses_by_name(changes, text):
    run = vv.simulate(vv.PolynomialSystem(mass=1, stiffness=4), 5, dt=0.1, initial=[1, 0])
    job = {"system": vv.PolynomialSystem(mass=1, stiffness=4), "resume": run} | changes
    with pytest.raises(vv.ViscovibError, match=text):
        vv.simulate(job.pop("system"), 10, **job)


def test_events_do_not_change_how_a_motion_ends():
    """Divided steps that are too large near the pivot are shortened, as without events."""
    rng = np.random.default_rng(5)
    seen = {}
    for _ in range(16):
        pendulum = vv.Pendulum(
            e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c3=0.01,
            c2=float(rng.choice([0, 0.02, 0.1])), f0=float(rng.choice([0, 0.05, 0.3])),
            p1=float(rng.uniform(0.5, 1.5)),
        )  # fmt: skip
        start = np.zeros(6)
        start[:2] = rng.uniform(-0.95, -0.5), rng.uniform(-2, 0)
        start[2:4] = 0.3 * rng.normal(size=2)
        plain = vv.simulate(pendulum, 3, initial=start, dt=0.02)
        watched = vv.simulate(pendulum, 3, initial=start, dt=0.02, events="phi")
        assert watched.outcome == plain.outcome
        if plain.outcome == "unphysical":
            assert abs(watched.t_reached - plain.t_reached) < 1e-6
        seen[plain.outcome] = seen.get(plain.outcome, 0) + 1
        (passages,) = watched.events
        assert (np.diff(passages.t) > 0).all()
        assert np.abs(passages.state.reshape(-1, 6)[:, 2]).max(initial=0.0) < 1e-9
    assert min(seen["completed"], seen["unphysical"]) >= 3, seen


@pytest.mark.parametrize("seed", range(2))
def test_the_error_holds_for_the_last_states_before_an_escape(seed):
    """Errors of the last states grow with the motion: against SciPy at 1e-13."""
    rng = np.random.default_rng(seed)
    k3, (w, r) = rng.uniform(0.2, 1), rng.uniform([0.02, 0.1], [0.1, 2])
    x0 = rng.uniform(1.02, 1.5) / np.sqrt(k3)
    system = vv.PolynomialSystem(
        mass=1.0, damping=0.02, stiffness=1.0, forces=f"-{k3}*x^3",
        kernel=vv.PronyKernel(weights=[w], rates=[r]),
    )  # fmt: skip
    run = vv.simulate(system, 30, initial=[x0, 0], tolerance=1e-6)

    def rhs(t, y):
        force = y[0] - k3 * y[0] ** 3
        return [y[1], w * y[2] - force - 0.02 * y[1], force - r * y[2]]

    true = solve_ivp(
        rhs, (0, run.t[-1]), [x0, 0, 0], t_eval=run.t, rtol=1e-13, atol=1e-15, method="DOP853"
    )
    assert run.outcome == "diverged"
    assert run.t.size > 20
    assert abs(true.y[:2].T - run.state).max() <= run.error
    assert run.error <= 1e-6 * abs(run.state).max()


@pytest.mark.parametrize("length", [1e7, 1e9, 1e12])
def test_motions_in_small_units_and_of_light_springs_are_not_cut(length):
    """A motion of some micrometres, and free flight, against SciPy and a closed form."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, forces=f"{1 / length**2!r}*x^3")
    run = vv.simulate(system, 9, initial=[length, 0], rtol=1e-10, keep="last")
    true = solve_ivp(
        lambda t, y: [y[1], -y[0] - y[0] ** 3], (0, 9), [1, 0], "DOP853", rtol=1e-12, atol=1e-13
    )
    assert run.outcome == "completed"
    np.testing.assert_allclose(run.state[0] / length, true.y[:, -1], atol=1e-8)
    free = vv.PolynomialSystem(mass=1, stiffness=0, damping=0)
    run = vv.simulate(free, 10, initial=[0, 0], load={0: 1j * length}, nu=1.0, dt=0.1, keep="last")
    assert run.outcome == "completed"
    np.testing.assert_allclose(run.state[0], [50 * length, 10 * length], rtol=1e-12)
