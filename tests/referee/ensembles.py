"""Ensemble members against SciPy and single runs; statistics by quadrature; tangents by Magnus."""

import numpy as np

from referee.balance import exponential
from referee.case import Case, Claim, even, few
from referee.integration import solve_ivp
from referee.models import Swinging, pendulum

JUDGES = (
    "simulate_ensemble",
    "Ensemble",
    "Ensemble.dof_names",
    "Ensemble.to_dataset",
    "basins",
    "Basins",
    "Basins.to_dataset",
)

METHODS = ("auto", "gauss8", "gauss16")
SERIES = ("taylor8", "taylor12", "taylor16", "taylor20", "taylor24")


def _lanes(rng, index):
    p = pendulum(rng, f0=few(rng, 1e-3, 0.02, 2), p1=even(rng, 0.6, 1.4, 3))
    n = int(rng.choice([1, 3, 9]))
    states = np.zeros((n, 6))
    states[:, 2] = rng.uniform(-0.5, 0.5, n).round(3)
    states[:, 0] = rng.uniform(-0.1, 0.1, n).round(3)
    varied = rng.uniform(0, 0.03, n).round(4)
    end, discard = even(rng, 8, 20, 3), even(rng, 0, 6, 2)
    tolerance = float(rng.choice([1e-8, 1e-10]))
    auto = index % 2 == 0
    method = METHODS[index // 2 % len(METHODS)]
    step = f"tolerance={tolerance}" if auto else "dt=0.1, lyapunov=True"
    call = f"""system = {p.source}
many = vv.simulate_ensemble(
    system, initial={states.tolist()}, t_end={end}, parameters={{"f0": {varied.tolist()}}}, {step},
    method={method!r}, statistics=True, discard={discard},
)
state, outcome, error, dt = many.state, many.outcome, many.error, many.step
peak, mean, rms, lyapunov = many.peak, many.mean, many.rms, many.lyapunov
table = many.to_dataset()["state"].values
names_reported = many.dof_names
"""

    def judge(names, reported):
        lane = int(index % n)
        q = Swinging(**(vars(p) | {"f0": float(varied[lane])}))
        yield Claim("names", names["names_reported"] == ("z", "phi", "psi"), True)
        yield Claim("completed", bool((names["outcome"] == "completed").all()), True)
        yield Claim("table", names["table"], names["state"], 1e-300, damage=1e-3)
        if auto:
            true = q.motion(states[lane], [end])[-1]
            yield Claim(
                "state",
                names["state"][lane],
                true,
                10 * (names["error"] + 1e-11) + 0.02 * tolerance,
                damage=1e-4,
            )
            yield Claim("tolerance met", bool(names["error"] <= tolerance), True)
            admitted = 10 * (names["error"] + 1e-10)
        else:
            path = q.motion(states[lane], [end])
            yield Claim("state", names["state"][lane], path[-1], 1e-7, damage=1e-4)
            admitted = 1e-7
        peak, mean, rms = _along(lambda t: q.motion(states[lane], t), discard, end)
        yield Claim("peak", names["peak"][lane], peak, admitted, damage=1e-2)
        yield Claim("mean", names["mean"][lane], mean, admitted, damage=1.0)
        yield Claim("rms", names["rms"][lane], rms, admitted, damage=1e-2)
        if auto:
            return
        h = names["dt"][lane]
        since = h * np.ceil(discard / h - 1e-9)
        tangent = np.zeros(6)
        tangent[::2] = 1 / np.sqrt(3)
        # Perturbation at the start of the averaging, and its growth from there.
        tangent = _carried(q, states[lane], np.linspace(0, since, 1001), tangent)
        grown = _carried(q, states[lane], np.linspace(since, end, 2001), tangent)
        rate = np.log(np.linalg.norm(grown) / np.linalg.norm(tangent)) / (end - since)
        yield Claim("lyapunov", names["lyapunov"][lane], rate, 2e-4, damage=0.2)

    return Case(call, judge)


def _carried(q, state, times, tangent):
    """Propagate a perturbation of a motion from the first time to the last."""
    if times[-1] <= times[0]:
        return tangent
    along = q.motion(state, times)
    middle = q.jacobian((times[1:] + times[:-1]) / 2, (along[1:] + along[:-1]) / 2)
    for step_of in exponential(middle * (times[1] - times[0])):
        tangent = step_of @ tangent
    return tangent


def _along(motion, start, end):
    """Peak, mean and rms of a motion from `start`: Gauss quadrature, parabolas at the maxima."""
    x, w = np.polynomial.legendre.leggauss(12)
    edges = np.linspace(start, end, 121)
    half = np.diff(edges)[:, np.newaxis] / 2
    times = (edges[:-1, np.newaxis] + half * (x + 1)).ravel()
    weights = (half * w / (end - start)).ravel()
    path = motion(times)
    mean, rms = weights @ path, np.sqrt(weights @ path**2)
    peak = np.empty(path.shape[1])
    for i, place in enumerate(times[np.abs(path).argmax(axis=0)]):
        near = np.linspace(max(place - 0.05, start), min(place + 0.05, end), 81)
        size = np.abs(motion(near)[:, i])
        k = int(size.argmax())
        peak[i] = size[k]
        if 0 < k < 80:
            bend = 2 * size[k] - size[k - 1] - size[k + 1]
            peak[i] += (size[k + 1] - size[k - 1]) ** 2 / (8 * bend)
    return peak, mean, rms


def _failed(rng, index):
    """A member that fails contains only collected values and does not affect other members."""
    p = pendulum(rng, (0.01, 0.05))
    states = np.zeros((4, 6))
    states[:, 2] = [0.1, 0.2, 0.3, -0.2]
    bad = int(rng.integers(4))
    method = METHODS[index % len(METHODS)]
    states[bad, 1] = -even(rng, 4, 9, 2)
    call = f"""system = {p.source}
options = dict(t_end=20, dt=0.2, statistics=True, lyapunov=True, discard=10, method={method!r})
many = vv.simulate_ensemble(system, initial={states.tolist()}, **options)
outcome, lyapunov, mean, peak, state = many.outcome, many.lyapunov, many.mean, many.peak, many.state
alone = vv.simulate_ensemble(system, initial={states[(bad + 1) % 4].tolist()}, **options).state[0]
"""

    def judge(names, reported):
        yield Claim("outcome", bool(names["outcome"][bad] != "completed"), True)
        good = [i for i in range(4) if i != bad]
        yield Claim("others go on", bool((names["outcome"][good] == "completed").all()), True)
        for what in ("lyapunov", "mean", "peak"):
            known = np.isfinite(names[what][bad]).any()
            # It stopped before anything was collected.
            yield Claim(f"{what} of a lane that stopped before", bool(known), False)
        yield Claim("states are numbers", bool(np.isfinite(names["state"]).all()), True)
        yield Claim(
            "a lane alone", names["state"][(bad + 1) % 4], names["alone"], 1e-300, damage=1e-3
        )

    return Case(call, judge)


def _gathered(rng, index):
    """Sections and amplitudes of known motions: linear, with a large motion in z alone."""
    w2, c1, f0, p1 = (
        even(rng, 0.3, 0.6, 3),
        even(rng, 0.3, 0.8, 2),
        even(rng, 0.01, 0.1, 2),
        even(rng, 0.5, 1.8, 3),
    )
    step = "dt=0.1" if index % 2 else f"tolerance={float(rng.choice([1e-6, 1e-9]))}"
    call = f"""system = vv.Pendulum(e=0.1, w2={w2}, w3=0.7, c1={c1}, c2=0.1, c3=0.1, f0={f0}, p1={p1})
many = vv.simulate_ensemble(
    system, initial=np.zeros(6), n_periods=60, {step}, discard=50, sections=1,
    amplitudes_at=[{p1}],
)
sections, amplitudes = many.sections[0], many.amplitudes[0]
section_error = many.section_error
"""

    def judge(names, reported):
        # z'' + c z' + z = f cos(p t): without the cubic spring z is linear.
        x = f0 / (1 - p1**2 + 1j * c1 * p1)
        true = np.array([x.real, (1j * p1 * x).real])
        yield Claim(
            "sections",
            names["sections"][:, :2],
            np.tile(true, (len(names["sections"]), 1)),
            1e-6 * abs(x) + 1e-9,
            damage=1e-4,
        )
        yield Claim("an error is reported", names["section_error"] is None, bool(index % 2))
        if names["section_error"] is not None:
            yield Claim(
                "sections to their error",
                names["sections"][:, :2],
                np.tile(true, (len(names["sections"]), 1)),
                1.5 * names["section_error"] + 1e-12,
                damage=1e-2,
            )
        yield Claim("amplitudes", names["amplitudes"][0, 0], x, 2e-3 * abs(x), damage=2e-2)

    return Case(call, judge)


def _systems(rng, index):
    """Members of an oscillator with a law: motions by SciPy, sum of all exponents."""
    c, k, load = even(rng, 0.05, 0.4, 3), even(rng, -1, 2, 3), even(rng, 0.1, 0.6, 3)
    law, force = (
        ("x^3", lambda x, v: x**3),
        ("x^3 + 0.5*tanh(2*x)", lambda x, v: x**3 + 0.5 * np.tanh(2 * x)),
        ("x^3 + 0.4*sin(x)", lambda x, v: x**3 + 0.4 * np.sin(x)),
    )[index % 3]
    nus = [even(rng, 0.5, 2, 3) for _ in range(5)]
    start = [[even(rng, -1, 1, 3), even(rng, -1, 1, 3)] for _ in range(5)]
    method = (*METHODS, *SERIES)[index // 3 % (len(METHODS) + len(SERIES))]
    # Power series do not compute exponents.
    series = method in SERIES
    call = f"""system = vv.PolynomialSystem(mass=1, stiffness={k}, damping={c}, forces={law!r})
many = vv.simulate_ensemble(system, initial={start}, parameters={{"nu": {nus}}}, load={load},
    t_end=15, dt=0.05, method={method!r}{"" if series else ', lyapunov="all"'})
state, total = many.state, {"None" if series else "many.spectrum.sum(axis=1)"}
"""

    def judge(names, reported):
        if not series:
            yield Claim("sum of exponents", names["total"], np.full(5, -c), 1e-8)
        for i in (0, 4):
            run = solve_ivp(
                lambda t, y, nu=nus[i]: [
                    y[1], load * np.sin(nu * t) - c * y[1] - k * y[0] - force(*y)
                ],
                (0, 15), start[i], "DOP853", rtol=1e-12, atol=1e-13,
            )  # fmt: skip
            yield Claim("a lane", names["state"][i], run.y[:, -1], 1e-8)

    return Case(call, judge)


def _numbers(rng, index):
    """Members with different parameters of a law, some 0 or a power of 2, by SciPy."""
    c, k = even(rng, 0.05, 0.4, 3), even(rng, 0.5, 2, 3)
    text, force = (
        ("A*tanh(x_dot/B) + x^3", lambda x, v, a, b: a * np.tanh(v / b) + x**3),
        ("A*x_dot*(1 + x^2)^B", lambda x, v, a, b: a * v * (1 + x**2) ** b),
        ("A*x^3 + B*x^2*x_dot", lambda x, v, a, b: a * x**3 + b * x**2 * v),
        ("A*sin(B*x) + A^2*x^3", lambda x, v, a, b: a * np.sin(b * x) + a**2 * x**3),
        ("A*atan2(x, B)", lambda x, v, a, b: a * np.arctan2(x, b)),
    )[index % 5]
    n = int(rng.choice([3, 9, 20]))
    a = [float(rng.choice([0.0, even(rng, 0.1, 1, 3)], p=[0.2, 0.8])) for _ in range(n)]
    b = [float(rng.choice([2.0, even(rng, 0.1, 2, 3)], p=[0.2, 0.8])) for _ in range(n)]
    start = [even(rng, -2, 2, 3), even(rng, -2, 2, 3)]
    # The last two laws have a function or a power without a series.
    series = SERIES[index // 4 % len(SERIES)]
    method = (*METHODS, series)[index % (3 if index % 5 in (1, 4) else 4)]
    step = ", dt=0.02" if method == series else ""
    call = f"""system = vv.PolynomialSystem(mass=1, stiffness={k}, damping={c}, forces={text!r},
    parameters={{"A": 0.5, "B": 0.5}})
many = vv.simulate_ensemble(system, initial={start}, t_end=12, method={method!r}{step},
    parameters={{"A": {a}, "B": {b}}})
state, error = many.state, many.error or 0.0
"""

    def judge(names, reported):
        for i in range(n):
            run = solve_ivp(
                lambda t, y, a=a[i], b=b[i]: [y[1], -c * y[1] - k * y[0] - force(*y, a, b)],
                (0, 12), start, "DOP853", rtol=1e-12, atol=1e-13,
            )  # fmt: skip
            yield Claim("a lane", names["state"][i], run.y[:, -1], 1e-10 + 2 * names["error"])

    return Case(call, judge)


def _nearby(rng, index):
    """Exponents from neighbouring motions: their sum is the mean trace along the motion of SciPy."""
    k, c = few(rng, 0.3, 30, 3), few(rng, 0.01, (1, 60)[index % 2], 3)
    law, force, slope = (
        ("0.5*abs(x)", lambda x, v: 0.5 * abs(x), lambda x, v: 0.0),
        ("4*max(x - 0.3, 0)", lambda x, v: 4 * max(x - 0.3, 0), lambda x, v: 0.0),
        ("5*x_dot*abs(x_dot)", lambda x, v: 5 * v * abs(v), lambda x, v: 10 * abs(v)),
        ("20*max(x_dot, 0)", lambda x, v: 20 * max(v, 0), lambda x, v: 20.0 * (v > 0)),
    )[index % 4]
    load, nu = even(rng, 0.2, 2, 2), round(float(rng.uniform(0.3, 2) * np.sqrt(k)), 3)
    start = [even(rng, 0.1, 1, 3), even(rng, -1, -0.1, 3)]
    # With a given step size the error of coarse steps would be checked as well.
    step = round(min(0.3 / np.sqrt(k), 2 / (c + 20)), 4)
    n, before = int(rng.integers(80, 200)), int(rng.choice([0, 40]))
    call = f"""system = vv.PolynomialSystem(mass=1, stiffness={k}, damping={c}, forces={law!r})
many = vv.simulate_ensemble(system, initial={start}, load={load}, nu={nu}, t_end={n * step},
    discard={before * step}, dt={step}, lyapunov="all")
total, h, outcome = many.spectrum.sum(), many.step[0], many.outcome[0]
"""

    def judge(names, reported):
        yield Claim("completed", names["outcome"] == "completed", True)
        begin, end = before * names["h"], n * step
        # A neighbouring motion passes a corner earlier or later, which matters at grazing.
        off = 3e-7 * np.sqrt(k) * max(1.0, load / k)

        def rates(t, y):
            x, v = y[:2]
            traces = [-c - slope(x + d, v + d) for d in (0.0, off, -off)]
            return [v, load * np.sin(nu * t) - c * v - k * x - force(x, v), *traces]

        run = solve_ivp(
            rates, (0, end), [*start, 0.0, 0.0, 0.0], "DOP853", rtol=1e-10, atol=1e-13,
            t_eval=[begin, end], max_step=0.05 / np.sqrt(k),
        )  # fmt: skip
        grown, *others = run.y[2:, 1] - run.y[2:, 0]
        grazed = max(abs(other - grown) for other in others)
        admitted = 2e-4 + 2e-5 * abs(grown) + grazed
        total = names["total"] * (end - begin)
        yield Claim("sum by neighbours", total, grown, admitted, damage=1e-2)

    return Case(call, judge)


def _settled(rng, index):
    """Two potential wells: the attractor of each start by SciPy."""
    c, k = even(rng, 0.2, 0.6, 3), even(rng, 0.5, 1.5, 3)
    grid = [even(rng, -1.5, 1.5, 3) for _ in range(3)]
    call = f"""system = vv.PolynomialSystem(mass=1, stiffness=-{k}, damping={c}, forces="x^3")
b = vv.basins(system, {{"x": {grid}, "x_dot": {grid}}}, t_end=150)
place = np.array([[b.attractors[i][0, 0] if i >= 0 else 9 for i in row] for row in b.labels])
same = bool((b.to_dataset()["label"].values == b.labels).all())
"""

    def judge(names, reported):
        yield Claim("dataset", names["same"], True)
        for j in range(3):
            run = solve_ivp(
                lambda t, y: [y[1], -c * y[1] + k * y[0] - y[0] ** 3], (0, 150),
                [grid[(j + 1) % 3], grid[j]], "DOP853", rtol=1e-10, atol=1e-12,
            )  # fmt: skip
            if abs(abs(run.y[0, -1]) - np.sqrt(k)) < 1e-5:
                place = names["place"][j, (j + 1) % 3]
                yield Claim("well", place, run.y[0, -1], 1e-4, damage=1e-3)

    return Case(call, judge)


def case(rng, index):
    """Draw an ensemble."""
    families = (_lanes, _failed, _systems, _gathered, _settled, _nearby, _numbers)
    return families[index % 7](rng, index // 7)
