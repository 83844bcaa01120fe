"""Motions in time against DOP853 of SciPy at 1e-12, memory as ordinary equations, known breaks."""

import math

import mpmath
import numpy as np

from referee.case import Case, Claim, even, few
from referee.models import (
    Draft,
    Term,
    chain,
    escape,
    integrate,
    interleaved,
    mount,
    pendulum,
    some_prony,
)
from referee.pivots import case as pivot_case

JUDGES = (
    "simulate", "Trajectory", "Trajectory.coordinate", "LoadTable", "LoadTable.__call__", "Past",
    "Pendulum",
)  # fmt: skip
#: Limit for a step found by halving: the change of the last halving is only an estimate.
ESTIMATE = 10.0
METHODS = ("auto", "gauss8", "gauss16", "gauss2", "gauss3", "rk4", "dop8", "verner8", "verner9")
WITH_MEMORY = ("auto", "gauss8", "gauss2", "gauss3", "gauss4", "gauss6")


def error_of(got, true):
    """Largest difference; inf for wrong shapes and non-finite numbers."""
    if got.shape != true.shape or not np.isfinite(got).all():
        return math.inf
    return float(np.abs(got - true).max())


def ending(names, when):
    """Check the end of the run. ``when`` computes the escape time of the true motion, None: never.

    Only for runs that do not complete; completed runs are checked by their states.
    """
    escaped = when() if names["outcome"] != "completed" else None
    yield Claim("completed", names["outcome"], "completed" if escaped is None else "diverged")
    if escaped is not None and names["outcome"] == "diverged":
        reached = float(names["run"].t_reached)
        yield Claim("time of the escape", reached, escaped, 0.01 * escaped, damage=0.1)


def never():
    """Return None: the motion does not escape."""


def claims(names, true, asked, *, scale=1.0, when=never):
    """Check states against the reference, within the stated error of the run."""
    got = names["state"]
    yield from ending(names, when)
    reported = names["error"]
    yield Claim("error is estimated", reported is not None, True)
    size = float(np.abs(true).max())
    admitted = max(reported or 0.0, 0.0) + 0.02 * asked + 3e-11 * max(size, scale) * 1e-1
    yield Claim(
        "state",
        got,
        true,
        admitted,
        limit=ESTIMATE,
        damage=max(1e-5, 300 * admitted / max(size, 1e-300)),
    )


def _smooth_pendulum(rng, index):
    """Automatic step size, or a given one with an error estimate; all methods."""
    p = pendulum(
        rng,
        f0=few(rng, 1e-3, 0.02, 2),
        m01=few(rng, 1e-3, 0.01, 2),
        m02=few(rng, 1e-3, 0.01, 2),
        p1=even(rng, 0.5, 1.5, 3),
        p2=even(rng, 0.2, 0.8, 3),
        p3=even(rng, 0.4, 1.5, 3),
    )
    state = [
        even(rng, -0.1, 0.1, 3),
        0.0,
        even(rng, -0.5, 0.5, 3),
        0.0,
        even(rng, -0.5, 0.5, 3),
        even(rng, -0.1, 0.1, 3),
    ]
    end = even(rng, 5, 20, 3)
    method = METHODS[index % len(METHODS)]
    auto = index % 2 == 0
    tolerance = (
        float(rng.choice([1e-10, 1e-8])) if method not in ("gauss2", "rk4", "gauss3") else 1e-6
    )
    step = f'dt="auto", tolerance={tolerance}' if auto else "dt=0.1, estimate_error=True"
    every = int(rng.choice([1, 3]))
    call = f"""system = {p.source}
run = vv.simulate(system, {end}, initial={state}, method={method!r}, {step}, save_every={every})
t, state, outcome, error = run.t, run.state, run.outcome, run.error
phi_dot = run.coordinate("phi_dot")
"""

    def judge(names, reported):
        true = p.motion(state, names["t"])
        yield from claims(names, true, tolerance if auto else 0.0)
        yield Claim("coordinate", names["phi_dot"], names["state"][:, 3], 1e-300, damage=1e-3)
        if auto:
            yield Claim("tolerance met", bool(names["error"] <= tolerance), True)

    return Case(call, judge, may_refuse=False)


def _load_of(load, nu, n):
    def push(t):
        out = np.zeros(n)
        for k, p in load.items():
            out += np.imag(np.asarray(p, complex) * np.exp(1j * k * nu * t))
        return out

    return push


def _system(rng, index):
    """Oscillators with or without memory; integrated by the methods of the pendulum or not."""
    memory = some_prony(rng) if index % 2 else None
    if index % 3 == 0:
        return mount(rng, damped=few(rng, 1e-3, 0.05, 2), memory=memory), memory
    n = int(rng.integers(1, 4))
    return chain(
        rng, n, few(rng, 1e-3, 0.05, 2), memory=memory, quadratic=index % 5 == 0
    ).model(), memory


def _smooth(rng, index):
    """Periodic loads with a mean and high harmonics."""
    model, memory = _system(rng, index)
    nu = even(rng, 0.3, 2, 3)
    load = {1: np.array([few(rng, 0.05, 0.5, 2)] + [0.0] * (model.n - 1))}
    if rng.random() < 0.5:
        load[int(rng.choice([3, 7, 20, 60]))] = rng.normal(size=model.n).round(2) * 0.3
    if rng.random() < 0.3:
        load[0] = 1j * rng.normal(size=model.n).round(2) * 0.2
    text = ", ".join(f"{k}: {np.asarray(p).tolist()}" for k, p in load.items())
    end = even(rng, 3, 12, 3)
    names_of = WITH_MEMORY if memory or "Mount" in model.source else METHODS[:5]
    method = names_of[index % len(names_of)] if rng.random() < 0.4 else "auto"
    loose = method in ("gauss2", "gauss3", "gauss4")
    tolerance = float(rng.choice([1e-10, 1e-8])) if not loose else 1e-6
    held = rng.normal(size=model.n).round(2) * 0.2 if memory and rng.random() < 0.4 else None
    state = np.zeros(2 * model.n)
    if held is not None:
        state[::2] = held
    elif rng.random() < 0.5:
        state = rng.normal(size=2 * model.n).round(2) * 0.3
    given = f"held={held.tolist()}" if held is not None else f"initial={state.tolist()}"
    # A fraction of the largest value of each coordinate and velocity, instead of one tolerance.
    relative = index % 3 == 0
    asked = f"rtol={tolerance}" if relative else f"tolerance={tolerance}"
    resume = rng.random() < 0.25
    call = f"""system = {model.source}
load = {{{text}}}
run = vv.simulate(system, {end}, load=load, nu={nu}, {given}, method={method!r}, {asked})
t, state, outcome, error = run.t, run.state, run.outcome, run.error
"""
    if resume:
        call += f"""if outcome == "completed":
    more = vv.simulate(system, {2 * end}, resume=run)
    t_more, state_more, ended = more.t, more.state, more.outcome
"""

    def judge(names, reported):
        push = _load_of(load, nu, model.n)
        y = model.start(state, held)
        stays = names["outcome"] == "completed"

        def when():
            return escape(model.equations(push), y, model.n, end)

        true = model.motion(y, names["t"], push)
        sizes = np.abs(true).max(axis=0)
        if relative and stays:
            sizes = np.maximum(sizes, 1e-6 * sizes.max())
            allowed = np.broadcast_to(tolerance * sizes + 3e-12 * sizes.max(), true.shape)
            hurt = float(100 * (allowed.max() / max(sizes.min(), 1e-9)))
            yield Claim("completed", names["outcome"], "completed")
            yield Claim("state by rtol", names["state"], true, allowed, limit=ESTIMATE, damage=hurt)
        else:
            scale = max(float(sizes.max()), 1.0)
            yield from claims(names, true, tolerance, scale=scale, when=when)
            # For a motion that escapes, a fraction of its largest value is allowed.
            most = tolerance if stays else tolerance * max(scale, names["run"].t_reached)
            yield Claim("tolerance met", bool(names["error"] <= most), True)
        if resume and stays and names["ended"] == "completed":
            true = model.motion(y, np.concatenate([[0.0], names["t_more"]]), push)[1:]
            off = 100 * (names["error"] + tolerance)
            yield Claim(
                "state after going on", names["state_more"], true, off, damage=max(1e-4, 1e2 * off)
            )

    return Case(call, judge)


def _table(rng, index):
    """Pulses, boxes, records: shorter than the motion, at any time."""
    model, _memory = _system(rng, index)
    kind = index % 4
    end = even(rng, 10, 14, 3)
    begin = even(rng, 0.0, 8, 4)
    n = model.n
    if kind == 0:
        width = few(rng, 1e-3, 0.3, 2)
        t = begin + width * np.arange(12) / 11
        v = np.sin(np.pi * np.arange(12) / 11) * few(rng, 0.5, 3, 2) / width * 0.2
        interpolation = "cubic" if rng.random() < 0.5 else "linear"
    elif kind == 1:
        t = np.array([begin, begin + few(rng, 0.05, 3, 2)])
        v = np.array([0.5, 0.5])
        interpolation = "linear"
    elif kind == 2:
        t = np.arange(0, 4, 0.1)
        v = np.random.default_rng(index).normal(size=t.size) * 0.3
        interpolation = "linear"
    else:
        t = np.sort(rng.uniform(0, 10, 6))
        v = rng.normal(size=6) * 0.3
        interpolation = "cubic" if rng.random() < 0.3 else "linear"
    t, v = np.round(t, 7), np.round(v, 5)
    state = np.zeros(2 * n) if rng.random() < 0.7 else rng.normal(size=2 * n).round(2) * 0.2
    tolerance = float(rng.choice([1e-10, 1e-8, 1e-6]))
    if kind == 2:
        text = f"times = np.arange(0, 4, 0.1)\nvalues = np.random.default_rng({index}).normal(size=times.size) * 0.3\ntable = vv.LoadTable(times=np.round(times, 7), values=np.round(values, 5))"
    else:
        text = f"table = vv.LoadTable(times={t.tolist()}, values={v.tolist()}, interpolation={interpolation!r})"
    call = f"""system = {model.source}
{text}
run = vv.simulate(system, {end}, force=table, initial={state.tolist()}, tolerance={tolerance})
t, state, outcome, error = run.t, run.state, run.outcome, run.error
at = table({[float(t[0] + t[1]) / 2, float(t[-1]) + 1.0]})
"""

    def judge(names, reported):
        from scipy.interpolate import CubicSpline

        if interpolation == "cubic":
            spline = CubicSpline(t, v)
        else:

            def spline(x):
                return np.interp(x, t, v)

        def push(x):
            out = np.zeros(n)
            if t[0] <= x <= t[-1]:
                out[0] = spline(x)
            return out

        y = model.start(state)
        true = model.motion(y, names["t"], push, breaks=t.tolist())
        scale = float(np.abs(true).max())

        def when():
            return escape(model.equations(push), y, n, end, t.tolist())

        yield from claims(names, true, tolerance, scale=scale, when=when)
        own = np.array([push(x)[0] for x in (float(t[0] + t[1]) / 2, t[-1] + 1)])
        yield Claim("load table", names["at"], own, 1e-12 * np.abs(v).max() + 1e-300, damage=1e-2)

    return Case(call, judge)


def _past(rng, index):
    """A known past with corners, with memory of exponentials."""
    memory = some_prony(rng, 0.4)
    model = chain(rng, int(rng.integers(1, 3)), few(rng, 0.01, 0.05, 2), memory=memory).model()
    n = model.n
    times = np.append(-np.cumsum(rng.uniform(0.05, 1.7, 3))[::-1], 0.0).round(3)
    moved = (rng.normal(size=(4, n)) * 0.3).round(3)
    end = even(rng, 5, 20, 3)
    call = f"""system = {model.source}
past = vv.Past(times={times.tolist()}, displacements={moved.tolist()})
run = vv.simulate(system, {end}, held=past, tolerance=1e-9)
t, state, outcome, error = run.t, run.state, run.outcome, run.error
"""

    def judge(names, reported):
        state = np.zeros(2 * n)
        state[::2] = moved[-1]
        y = model.start(state, moved[0])
        terms = model.remembered()
        h = y[2 * n :]
        for a, b, x, z in zip(times[:-1], times[1:], moved[:-1], moved[1:], strict=True):

            def right(t, h, a=a, b=b, x=x, z=z):
                force = model.groups[0].force(x + (z - x) * (t - a) / (b - a))
                return np.concatenate(
                    [force - r * h[j * n : (j + 1) * n] for j, (_, _, r) in enumerate(terms)]
                )

            h = integrate(right, h, np.array([b]), begin=a)[-1]
        y[2 * n :] = h
        yield from claims(names, model.motion(y, names["t"], None), 1e-9)

    return Case(call, judge)


def _base(rng, index):
    """The supports have a periodic motion."""
    memory = some_prony(rng) if index % 2 else None
    model = mount(rng, damped=few(rng, 1e-3, 0.05, 2), memory=memory)
    nu, size, end = even(rng, 0.5, 3, 3), few(rng, 0.01, 0.2, 2), even(rng, 5, 20, 3)
    call = f"""system = {model.source}
run = vv.simulate(system, {end}, base={size}, nu={nu}, initial=[0, 0, 0, 0], tolerance=1e-9)
t, state, outcome, error = run.t, run.state, run.outcome, run.error
"""

    def judge(names, reported):
        push = model.base
        right = model.equations(lambda t: model.mass @ push * size * nu**2 * np.sin(nu * t))
        state = np.zeros(4)
        state[1::2] -= push * size * nu
        found = integrate(right, model.start(state), names["t"])[:, interleaved(2)]
        found[:, ::2] += np.outer(size * np.sin(nu * names["t"]), push)
        found[:, 1::2] += np.outer(size * nu * np.cos(nu * names["t"]), push)
        yield from claims(names, found, 1e-9)

    return Case(call, judge)


def _base_table(rng, index):
    """The supports follow a table with corners; then the run is resumed under another load."""
    memory = some_prony(rng) if index % 2 else None
    model = mount(rng, damped=few(rng, 1e-3, 0.05, 2), memory=memory)
    times = np.cumsum(rng.uniform(0.3, 1.5, 4)).round(3)
    places = np.append(rng.normal(size=3).round(2) * 0.1, 0.0)
    middle, end = float(times[-1]) + 1, float(times[-1]) + 5
    size, nu = few(rng, 0.05, 0.5, 2), even(rng, 0.5, 3, 3)
    call = f"""system = {model.source}
table = vv.LoadTable(times={times.tolist()}, values={places.tolist()})
begun = [{places[0]}, 0, 0, 0]
run = vv.simulate(system, {middle}, base=table, initial=begun, tolerance=1e-9)
t, state, outcome, error = run.t, run.state, run.outcome, run.error
more = vv.simulate(system, {end}, resume=run, load={size}, nu={nu})
t_more, state_more = more.t, more.state
"""

    def judge(names, reported):
        push = model.base
        right = model.equations(None)
        y = model.start([0, 0, 0, 0])
        t, found, before = names["t"], [], 0.0
        ends = np.append(times, middle)
        begin = 0.0
        for i, until in enumerate(ends):
            slope = np.diff(places)[i - 1] / np.diff(times)[i - 1] if 0 < i < 4 else 0.0
            y = y.copy()
            y[2:4] -= push * (slope - before)  # relative to the base
            inside = t[(t > begin) & (t <= until)] if i else t[t <= until]
            at = np.unique(np.concatenate([[begin], inside, [until]]))
            path = integrate(right, y, at, begin=begin)
            y, before = path[-1], slope
            part = path[np.isin(at, inside)][:, interleaved(2)]
            part[:, ::2] += np.outer(np.interp(inside, times, places), push)
            part[:, 1::2] += push * slope
            found.append(part)
            begin = until
        yield from claims(names, np.concatenate(found), 1e-9)
        loaded = model.equations(lambda t: np.array([size * np.sin(nu * t), 0]))
        later = integrate(loaded, y, names["t_more"], begin=middle)[:, interleaved(2)]
        off = 100 * (names["error"] + 1e-9)
        yield Claim("state under another load", names["state_more"], later, off, damage=1e-3)

    return Case(call, judge)


def _escape(rng, index):
    """A softening spring: outcome "diverged", and the time."""
    memory = some_prony(rng, 0.1) if index % 2 else None
    k3 = even(rng, 0.2, 1, 2)
    model = Draft([1.0], [[0.02]], [[1.0]], [Term(-k3, (3,), 0)], memory).model()
    start = float(f"{rng.uniform(0.5, 1.6) / np.sqrt(k3):.3g}")
    call = f"""system = {model.source}
run = vv.simulate(system, 30, initial=[{start}, 0], tolerance=1e-8)
t, state, outcome, reached, error = run.t, run.state, run.outcome, run.t_reached, run.error
"""

    def judge(names, reported):
        found = escape(model.equations(None), model.start([start, 0]), 1, 30.0)
        escaped = found is not None
        yield Claim("outcome", names["outcome"], "diverged" if escaped else "completed")
        finite = np.isfinite(names["state"]).all()
        yield Claim("states kept are numbers", bool(finite), True)
        if escaped and names["outcome"] == "diverged":
            yield Claim("time of the escape", names["reached"], found, 0.01 * found, damage=0.1)
        if not escaped and names["outcome"] == "completed":
            true = model.motion(model.start([start, 0]), names["t"], None)
            yield from claims(names, true, 1e-8)

    return Case(call, judge)


def _resumed(rng, index):
    """Resumed with another system or load: effective or refused; parts equal the whole run."""
    p = pendulum(rng)
    state = [0.05, 0.0, even(rng, -0.3, 0.3, 2), 0.0, 0.1, 0.0]
    other = p.__class__(**(vars(p) | {"w2": float(f"{p.w2 * 1.3:.4g}"), "e": p.e / 2}))
    if index % 2:
        call = f"""system = {p.source}
other = {other.source}
run = vv.simulate(system, 10, dt=0.25, initial={state})
more = vv.simulate(other, 20, resume=run)
t, state, first = more.t, more.state, run.state[-1]
"""

        def judge(names, reported):
            true = integrate(
                lambda t, y: other.right(t, y),
                names["first"],
                np.concatenate([[10.0], names["t"]]),
                begin=10.0,
            )[1:]
            yield Claim("goes on with the system given", names["state"], true, 1e-8, damage=1e-3)

        return Case(call, judge, may_refuse=True)
    times = np.sort(rng.uniform(0, 20, 5)).round(3)
    call = f"""system = {p.source}
whole = vv.simulate(system, 20, dt=0.25, initial={state}).state
half = vv.simulate(system, 10, dt=0.25, initial={state})
rest = vv.simulate(system, 20, resume=half).state
last = vv.simulate(system, 20, dt=0.25, initial={state}, keep="last").state
tail = vv.simulate(system, 20, dt=0.25, initial={state}, keep="tail", tail=5).state
at = vv.simulate(system, 20, dt=0.25, initial={state}, times={times.tolist()}).state
"""

    def judge(names, reported):
        whole = names["whole"]
        yield Claim("goes on bit for bit", names["rest"], whole[40:], 1e-300, damage=1e-3)
        yield Claim("last state", names["last"], whole[-1:], 1e-300, damage=1e-3)
        yield Claim("tail", names["tail"], whole[-len(names["tail"]) :], 1e-300, damage=1e-3)
        true = p.motion(state, np.concatenate([[0.0], times]))[1:]
        yield Claim("states at times", names["at"], true, 1e-9, damage=1e-4)

    return Case(call, judge)


def _long(rng, index):
    """Many periods without damping against Jacobi's elliptic function, with 40 digits."""
    cubic, size = even(rng, 0.2, 1.0, 3), even(rng, 0.5, 1.2, 3)
    end = even(rng, 2e4, 1e5, 3)
    call = f"""system = vv.PolynomialSystem(mass=1, stiffness=1, forces="{cubic}*x^3")
run = vv.simulate(system, {end}, initial=[{size}, 0], keep="last", tolerance=1e-6)
last, error, outcome = run.state[-1, 0], run.error, run.outcome
"""

    def judge(names, reported):
        with mpmath.workdps(40):
            squared = mpmath.mpf(cubic) * mpmath.mpf(size) ** 2
            phase, m = mpmath.sqrt(1 + squared) * mpmath.mpf(end), squared / (2 + 2 * squared)
            true = float(size * mpmath.ellipfun("cn", phase, m=m))
        yield Claim("completed", names["outcome"], "completed")
        yield Claim("after many periods", names["last"], true, names["error"], damage=1e-3)

    return Case(call, judge, may_refuse=False)


def case(rng, index):
    """Draw a motion."""
    kinds = (
        _smooth_pendulum,
        _smooth,
        _table,
        _table,
        _past,
        _base,
        pivot_case,
        _escape,
        _resumed,
        _smooth,
    )
    if index % 40 == 15:
        return _long(rng, index // 40)
    if index % 10 == 5 and index % 20 == 5:
        return _base_table(rng, index // 20)
    if index % 10 in (1, 2, 3, 9):
        return kinds[index % 10](rng, index // 10 * 2 + (index % 10 in (3, 9)))
    return kinds[index % 10](rng, index // 10)
