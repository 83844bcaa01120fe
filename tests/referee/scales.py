"""Steady motions by harmonic balance and Floquet multipliers; motions by SciPy; periods by quadrature."""

from itertools import product

import numpy as np
from scipy.integrate import quad

from referee.balance import Balance, load_rows, magnus, multipliers
from referee.case import Case, Claim, even, few
from referee.models import Draft, Swinging, Term, chain, pendulum, some_prony

JUDGES = (
    "MultipleScales", "MultipleScales.resonances", "MultipleScales.modulation",
    "MultipleScales.motion", "MultipleScales.response", "MultipleScales.backbone", "CubicSystem",
    "CubicSystem.dof_names", "ScalesResponse", "ScalesResponse.harmonic_errors",
    "ScalesResponse.motion_errors", "ScalesResponse.error_estimate", "ScalesResponse.in_range",
    "ScalesResponse.at", "ScalesResponse.stable", "ScalesResponse.decided",
    "ScalesResponse.growth_error", "ScalesResponse.amplitude",
    "ScalesResponse.routh_hurwitz", "ScalesMotion", "ScalesMotion.coordinate_errors",
    "ScalesMotion.error_estimate", "ScalesMotion.in_range", "Modulation", "Modulation.amplitude",
    "Modulation.phase", "Resonance", "Resonance.coefficients", "Resonance.label", "RangeWarning",
    "ScalesResponse.beating", "ScalesResponse.beating_points", "BeatingMotion",
    "BeatingMotion.orders", "BeatingMotion.mean", "BeatingMotion.rms", "BeatingMotion.largest",
    "BeatingMotion.lines", "BeatingMotion.at", "BeatingMotion.stable",
)  # fmt: skip
#: Factor by which an estimate may be smaller than the error.
ESTIMATE = 4.0


def _oscillator(rng, index):
    """A load at any frequency: near a mode, at a third of it, at twice it."""
    memory = some_prony(rng, 0.1) if index % 4 == 3 else None
    n = int(rng.integers(1, 3))
    model = chain(
        rng, n, few(rng, 2e-3, 0.03, 2), memory=memory, cubic=(0.2, 1.0), quadratic=index % 2 == 0
    ).model()
    w = model.frequencies[0]
    nu = float(
        f"{w * rng.choice([0.5, 1 / 3, 0.95, 1.0, 1.05, 1.5, 2.0, 0.8]) * rng.uniform(0.97, 1.03):.5g}"
    )
    size = few(rng, 1e-3, 0.05, 2)
    others = np.unique(np.append(nu * rng.uniform(0.8, 1.2, 4), nu)).round(6)
    nu = float(others[np.argmin(np.abs(others - nu))])
    call = f"""system = {model.source}
ms = vv.MultipleScales(system, load={size}, nu={nu})
s = ms.response("nu", [{nu}])
harmonics, estimate, in_range, stable = s.harmonics, s.harmonic_errors, s.in_range, s.stable
amplitude, at, single, whole = s.amplitude({model.names[0]!r}), s.at, s.error_estimate, s.motion_errors
decided, growth_error = s.decided, s.growth_error
several = ms.response("nu", {others.tolist()})
others = several.harmonics[several.at == {nu}]
tables = [s.routh_hurwitz(i) for i in range(len(stable))]
"""

    def judge(names, reported):
        yield Claim(
            "amplitude", names["amplitude"], np.abs(names["harmonics"][:, 0]), 1e-15, damage=1e-3
        )
        yield Claim("at", names["at"], np.full(len(names["stable"]), nu), 1e-14)
        yield Claim(
            "error_estimate", names["single"], names["estimate"].max(axis=1), 1e-300, damage=1e-3
        )
        yield Claim("as many motions as alone", len(names["others"]), len(names["harmonics"]))
        if len(names["others"]) == len(names["harmonics"]):
            yield Claim(
                "the same motions as alone",
                np.sort(np.abs(names["others"][:, 0])),
                np.sort(np.abs(names["harmonics"][:, 0])),
                1e-6 * size + names["single"].max(),
                limit=2.0,
                damage=100.0,
            )
        balance = Balance(model, 9)
        load = load_rows(balance, {1: np.array([1j * size] + [0.0] * (n - 1))})
        solved = 0
        for i in range(len(names["stable"])):
            column = np.asarray(names["tables"][i])
            eigen = names["s"].eigenvalues[i].real
            if np.isfinite(column).all() and np.abs(eigen).min() > 1e-9:
                yield Claim(
                    "routh_hurwitz",
                    bool((column > 0).all() or (column < 0).all()),
                    bool((eigen < 0).all()),
                )
            if not names["in_range"][i]:
                continue
            # The balance contains multiples of the load frequency only.
            moving = names["s"].frequencies[i][np.abs(names["s"].amplitudes[i]) > 0] / nu
            if (np.abs(moving - moving.round()) > 1e-6).any():
                continue
            x = names["harmonics"][i]
            a = balance.solve(balance.real(1j * x[:, None], np.array([1])), nu, load)
            if a is None:
                continue
            true = balance.complex(a)
            error = np.abs(true[:, 1] / 1j - x).max()
            estimate = names["estimate"][i].max()
            if error > 0.5 * np.abs(true).max() + 10 * estimate:
                continue  # Newton's method converged to another motion,
            apart = np.abs(names["harmonics"] - true[:, 1] / 1j).max(axis=1)
            if apart.argmin() != i:
                continue  # which is also a result.
            solved += 1
            yield Claim(
                "harmonics",
                np.abs(x).max() + error,
                np.abs(x).max(),
                estimate + 1e-12,
                limit=ESTIMATE,
                damage=10 * (estimate + 1e-12) / np.abs(x).max(),
            )
            mu, off = multipliers(model, true, nu, 128)
            growth = float(np.log(np.abs(mu[0])) * nu / (2 * np.pi))
            if names["decided"][i] and abs(growth) > 1e-4 + off[0]:
                yield Claim("stable", bool(names["stable"][i]), bool(growth < 0))

    return Case(call, judge, may_refuse=True)


def _parametric(rng, index):
    """The pendulum under f0 alone: stability of phi = psi = 0."""
    p = pendulum(rng, (0.002, 0.01), f0=few(rng, 0.02, 0.08, 2), p1=1.0)
    own = Swinging(p.e, p.w2, p.w3, p.alpha)
    a = own.jacobian(np.zeros(1), np.zeros((1, 6)))[0]
    swings = np.sort(np.sqrt(np.linalg.eigvals(-a[1::2, ::2]).real))[:2]
    places = [2 * swings[0], 2 * swings[0], swings[0], 2 * swings[1], swings.sum()]
    target = float(rng.choice(places))
    p1 = float(f"{max(0.1, target * rng.uniform(0.92, 1.08)):.4g}")
    p = Swinging(**(vars(p) | {"p1": p1}))
    call = f"""system = {p.source}
ms = vv.MultipleScales(system)
s = ms.response("p1", [{p1}])
harmonics, in_range, stable, amplitudes = s.harmonics, s.in_range, s.stable, s.amplitudes
"""

    def judge(names, reported):
        zr = p.z_r
        # The frequency of z alone, which is not always the highest.
        alone = np.sqrt(1 + 3 * zr**2 * p.alpha - p.c1**2 / 4)
        swinging = np.argsort(np.abs(names["ms"].frequencies - alone))[1:]
        upright = np.abs(names["amplitudes"][:, swinging]).max(axis=1)
        upright += np.abs(names["s"].amplitude("phi"))
        model = Draft(
            [1.0], [[p.c1]], [[1 + 3 * zr**2 * p.alpha]],
            [Term(p.alpha, (3,), 0), Term(3 * zr * p.alpha, (2,), 0)],
        ).model()  # fmt: skip
        balance = Balance(model, 8)
        load = load_rows(balance, {1: np.array([1j * p.f0])})
        x = 1j * p.f0 / model.dynamic_stiffness(p1)[0, 0]
        unknowns = balance.solve(balance.real(np.array([[x]]), np.array([1])), p1, load)
        if unknowns is None:
            return
        z = balance.complex(unknowns)[0]
        k = np.arange(z.size)

        def matrices(t):
            waves = np.exp(1j * p1 * np.outer(t, k))
            states = np.zeros((t.size, 6))
            states[:, 0], states[:, 1] = (waves @ z).imag, (waves @ (1j * p1 * k * z)).imag
            return p.jacobian(t, states)

        turn = np.exp(1j * np.outer(np.linspace(0, 2 * np.pi, 400), k))
        if (turn @ z).imag.min() < -0.99:
            return  # Newton's method converged to a motion through the pivot.
        mu = np.linalg.eigvals(magnus(matrices, 2 * np.pi / p1, 400))
        growth = np.log(np.abs(mu).max()) * p1 / (2 * np.pi)
        if abs(growth) < 2e-3:
            return
        for i in np.flatnonzero(upright < 1e-9):
            near = abs(names["harmonics"][i, 0] - z[1] / 1j) < 0.2 * abs(z[1])
            if near and names["in_range"][i] and names["s"].decided[i]:
                yield Claim("upright motion is stable", bool(names["stable"][i]), bool(growth < 0))

    return Case(call, judge, may_refuse=True)


def _several(rng, index):
    """Three loads near three modes, compared with a motion in time by default."""
    p = pendulum(rng, (0.005, 0.03))
    own = Swinging(p.e, p.w2, p.w3, p.alpha)
    a = own.jacobian(np.zeros(1), np.zeros((1, 6)))[0]
    w = np.sort(np.sqrt(np.linalg.eigvals(-a[1::2, ::2]).real))[::-1]
    drives = (w * rng.uniform(0.96, 1.04, 3)).round(4)
    p = Swinging(
        **(
            vars(p)
            | dict(
                f0=few(rng, 1e-4, 1e-3, 2),
                m01=few(rng, 1e-5, 3e-4, 2),
                m02=few(rng, 1e-5, 3e-4, 2),
                p1=float(drives[0]),
                p2=float(drives[1]),
                p3=float(drives[2]),
            )
        )
    )
    state = (rng.normal(size=6) * 0.02).round(4)
    t = np.linspace(0, 40, 9)
    call = f"""system = {p.source}
ms = vv.MultipleScales(system)
motion = ms.motion({t.tolist()}, {state.tolist()})
state, estimate, in_range = motion.state, motion.error_estimate, motion.in_range
errors = motion.coordinate_errors
steady = ms.response("p1", [{p.p1}])
"""

    def judge(names, reported):
        true = p.motion(state, t)
        yield from _motion(names, true)

    return Case(call, judge)


def _beating(rng, index):
    """Three loads near three modes, large enough for beats."""
    p = pendulum(rng, (0.005, 0.03))
    own = Swinging(p.e, p.w2, p.w3, p.alpha)
    a = own.jacobian(np.zeros(1), np.zeros((1, 6)))[0]
    w = np.sort(np.sqrt(np.linalg.eigvals(-a[1::2, ::2]).real))[::-1]
    drives = (w * rng.uniform(0.96, 1.04, 3)).round(4)
    size = rng.uniform(5, 20)
    p = Swinging(
        **(
            vars(p)
            | dict(
                f0=few(rng, 1e-4 * size, 1e-3 * size, 2),
                m01=few(rng, 1e-5 * size, 3e-4 * size, 2),
                m02=few(rng, 1e-5 * size, 3e-4 * size, 2),
                p1=float(drives[0]),
                p2=float(drives[1]),
                p3=float(drives[2]),
            )
        )
    )
    t = np.linspace(0, 300, 151)
    call = f"""system = {p.source}
response = vv.MultipleScales(system).response("p1", [{p.p1}])
points = [i for i in response.beating_points if response.in_range[i]]
beats = [response.beating(i) for i in points]
reported = [
    (b.at({t.tolist()}), b.errors, b.mean, b.rms, b.largest, b.frequencies, b.harmonics, b.orders,
     [b.lines(name) for name in b.dof_names], b.stable)
    for b in beats
]
"""

    def judge(names, reported):
        for q, errors, mean, rms, largest, f, x, orders, lines, stable in names["reported"]:
            state = np.ravel(np.column_stack([x.sum(axis=0).real, ((1j * f) @ x).real]))
            true = p.motion(state, t)[:, ::2]
            # Coordinates with a known error.
            kept = np.flatnonzero(errors <= 0.2 * rms)
            if not kept.size or stable is False:
                continue
            # The error of the initial state contributes until it has decayed.
            yield Claim(
                "motion that beats",
                q[:, kept],
                true[:, kept],
                np.tile(errors[kept], (t.size, 1)),
                limit=6.0,
                damage=float(30 * (errors / rms)[kept].max()),
            )
            known = np.isfinite(orders).all(axis=1)
            yield Claim("orders", f[known], orders[known] @ np.array([p.p1, p.p2, p.p3]), 1e-7)
            far = np.random.default_rng(index).uniform(0, 1e8, 40_000)
            samples = (np.exp(1j * np.outer(far, f)) @ x).real
            yield Claim("mean", mean, samples.mean(axis=0), 0.05 * rms, damage=10.0)
            yield Claim("rms", rms, samples.std(axis=0), 0.05 * rms, damage=0.3)
            top = np.abs(samples).max(axis=0)
            inside = bool((top <= largest * (1 + 1e-9)).all() and (top > 0.8 * largest).all())
            yield Claim("largest is the least bound", inside, True)
            biggest = [rows[0][1] for rows in lines]
            yield Claim("lines", np.array(biggest), np.abs(x).max(axis=0), 1e-15, damage=1e-3)

    return Case(call, judge)


def _motion(names, true):
    kept = names["in_range"]
    if not kept.any():
        return
    error = np.abs(names["state"] - true)[:, ::2]
    worst = np.maximum.accumulate(error.max(axis=1))
    estimate = np.maximum.accumulate(names["estimate"]) + 1e-12
    size = float(np.abs(true[:, ::2]).max())
    yield Claim(
        "motion",
        (size + worst)[kept],
        np.full(kept.sum(), size),
        estimate[kept],
        limit=15.0,
        damage=float(40 * estimate[kept].max() / size),
    )
    yield Claim(
        "estimate of the worst coordinate",
        names["estimate"],
        names["errors"].max(axis=1),
        1e-300,
        damage=1e-3,
    )


def _free(rng, index):
    """Free motions of a system of third degree."""
    n = int(rng.integers(1, 4))
    model = chain(rng, n, few(rng, 1e-3, 0.03, 2), quadratic=True).model()
    state = (rng.normal(size=2 * n) * few(rng, 0.01, 0.1, 2)).round(5)
    t = np.linspace(0, 25, 8)
    cubic, quadratic = np.zeros((n,) * 4), np.zeros((n,) * 3)
    eye = np.eye(n)
    base = np.asarray(model.stiffness)
    for d in range(n):
        up, down = (
            model.groups[0].force(eye[d]) - base @ eye[d],
            model.groups[0].force(-eye[d]) + base @ eye[d],
        )
        quadratic[:, d, d] = np.round((up + down) / 2, 9)
        cubic[:, d, d, d] = np.round((up - down) / 2, 9)
    call = f"""system = vv.CubicSystem(
    mass={model.mass.tolist()}, stiffness={base.tolist()}, damping={model.damping.tolist()},
    quadratic={quadratic.tolist()},
    cubic={cubic.tolist()},
)
ms = vv.MultipleScales(system)
motion = ms.motion({t.tolist()}, {state.tolist()})
state, estimate, in_range, errors = motion.state, motion.error_estimate, motion.in_range, motion.coordinate_errors
frequencies, decay, names = ms.frequencies, ms.decay, system.dof_names
modulation = motion.modulation
amplitude, phase, a = modulation.amplitude, modulation.phase, modulation.complex_amplitudes
again = ms.modulation({t.tolist()}, amplitudes=modulation.initial).complex_amplitudes
fine = ms.modulation({t.tolist()}, {state.tolist()}, accuracy=1e-13)
best, admitted = fine.complex_amplitudes, modulation.error + fine.error
"""

    def judge(names, reported):
        values = np.linalg.eigvals(model.linearised(np.zeros((1, n)))[0])
        values = values[values.imag > 0]
        values = values[np.argsort(values.imag)]
        order = np.argsort(names["frequencies"])
        yield Claim("frequencies", names["frequencies"][order], values.imag, 1e-10)
        yield Claim("decay", names["decay"][order], -values.real, 1e-10, damage=1e-5)
        yield Claim("dof_names", names["names"], tuple(f"q{i + 1}" for i in range(n)))
        yield Claim("amplitude", names["amplitude"], np.abs(names["a"]), 1e-15, damage=1e-3)
        yield Claim(
            "phase",
            np.exp(1j * names["phase"]) * names["amplitude"],
            names["a"],
            1e-14,
            damage=1e-3,
        )
        yield Claim("from amplitudes", names["again"], names["a"], 1e-8, damage=1e-3)
        yield Claim(
            "amplitudes to their error",
            names["a"],
            names["best"],
            1.3 * names["admitted"][:, np.newaxis] + 1e-300,
            damage=1e-3,
        )
        yield from _motion(names, model.motion(model.start(state), t, None))

    return Case(call, judge)


def _bend(rng, index):
    """Frequency over amplitude of one coordinate: the period by quadrature."""
    k2, k3 = even(rng, 0, 0.5, 2), even(rng, 0.1, 1, 2)
    b = few(rng, 0.01, 0.15, 2)
    call = f"""system = vv.PolynomialSystem(mass=1, stiffness=1, forces="{k2}*x^2 + {k3}*x^3")
nu = vv.MultipleScales(system).backbone(0, [{b}])[0]
"""

    def judge(names, reported):
        def potential(x):
            return x * x / 2 + k2 * x**3 / 3 + k3 * x**4 / 4

        def period_of(top):
            roots = np.roots([k3 / 4, k2 / 3, 0.5, 0, -potential(top)])
            low = max(r.real for r in roots if abs(r.imag) < 1e-9 and r.real < 0)
            middle, half = (top + low) / 2, (top - low) / 2

            def slowness(angle):
                x = middle + half * np.sin(angle)
                return half * np.cos(angle) / np.sqrt(2 * (potential(top) - potential(x)))

            return quad(slowness, -np.pi / 2, np.pi / 2, epsabs=1e-12, epsrel=1e-12)[0] * 2, half

        top = b
        for _ in range(30):
            period, half = period_of(top)
            top *= b / half
        # The amplitude of the leading term differs from half the peak-to-peak value by higher orders.
        yield Claim(
            "backbone",
            names["nu"],
            2 * np.pi / period,
            3 * b**4 + 2 * k2 * b**3 * (k2 + k3) + 1e-10,
            damage=max(1e-6, 20 * b**4 + 20 * b**3),
        )

    return Case(call, judge)


def _resonances(rng, index):
    p = pendulum(
        rng, (0.01, 0.02), f0=0.01, p1=even(rng, 0.3, 2, 3), m01=0.01, p2=even(rng, 0.2, 1, 3)
    )
    call = f"""system = {p.source}
ms = vv.MultipleScales(system)
frequencies = ms.frequencies
listed = ms.resonances(tolerance=0.03)
first = [(r.coefficients, r.label, r.order, r.divisor, r.near) for r in listed]
"""

    def judge(names, reported):
        known = {f"w{j + 1}": w for j, w in enumerate(names["frequencies"])} | {
            "p1": p.p1,
            "p2": p.p2,
        }
        got, true, near, close = [], [], [], []
        for c, _, _, divisor, is_near in names["first"]:
            got.append(divisor)
            true.append(abs(sum(k * known[x] for x, k in c.items())) / max(known[x] for x in c))
            near.append(bool(is_near))
            close.append(bool(divisor <= 0.03))
        yield Claim("divisor", np.array(got), np.array(true), 1e-12)
        yield Claim("near", np.array(near), np.array(close))
        # Each mode with one load, and with twice another mode, must be in the list.
        wanted = 0
        for w, q in product([k for k in known if k[0] == "w"], ["p1", "p2"]):
            wanted += any(
                set(c) == {w, q} and set(map(abs, c.values())) == {1} for c, *_ in names["first"]
            )
        yield Claim("loads against modes", wanted, 6)
        sides = [
            set(label.replace("~", " ").replace("+", " ").split()) - {"2", "3"}
            for _, label, *_ in names["first"]
        ]
        yield Claim(
            "labels",
            bool(all(s == set(c) for s, (c, *_) in zip(sides, names["first"], strict=True))),
            True,
        )

    return Case(call, judge)


def _static(rng, index):
    """A constant load together with a harmonic load."""
    k2, k3, c = even(rng, -0.3, 0.3, 2), even(rng, 0.2, 1, 2), few(rng, 0.01, 0.05, 2)
    f0, f1 = few(rng, 0.01, 0.2, 2), few(rng, 1e-3, 0.02, 2)
    p = float(f"{rng.choice([0.5, 0.8, 1.0, 1.1, 2.0]) * rng.uniform(0.95, 1.05):.4g}")
    model = Draft([1.0], [[c]], [[1.0]], [Term(k2, (2,), 0), Term(k3, (3,), 0)]).model()
    call = f"""system = vv.CubicSystem(
    mass=[[1]], stiffness=[[1]], damping=[[{c}]], quadratic=[[[{k2}]]], cubic=[[[[{k3}]]]],
    load=[[{f0}, {f1}]], drives=[0, {p}],
)
s = vv.MultipleScales(system).response("p2", [{p}])
harmonics, estimate, in_range = s.harmonics, s.harmonic_errors, s.in_range
"""

    def judge(names, reported):
        balance = Balance(model, 9)
        load = load_rows(balance, {0: np.array([1j * f0]), 1: np.array([1j * f1])})
        for i in np.flatnonzero(names["in_range"]):
            x = names["harmonics"][i]
            start = balance.real(np.array([[1j * f0, 1j * x[0]]]), np.array([0, 1]))
            a = balance.solve(start, p, load)
            if a is None:
                continue
            true = balance.complex(a)[0, 1] / 1j
            estimate = names["estimate"][i, 0] + 1e-12
            yield Claim(
                "harmonic with a static load",
                x[0],
                true,
                estimate,
                limit=ESTIMATE,
                damage=float(30 * estimate / abs(x[0])),
            )

    return Case(call, judge, may_refuse=True)


def _internal(rng, index):
    """Free motion of a mode that drives another mode at twice its frequency."""
    w2 = float(f"{2 * rng.uniform(0.985, 1.015):.5g}")
    g, b = even(rng, 0.1, 0.5, 2), few(rng, 0.01, 0.06, 2)
    # V = g q1^2 q2 couples both.
    model = Draft(
        [1.0, 1.0], np.zeros((2, 2)), np.diag([1.0, w2**2]),
        [Term(2 * g, (1, 1), 0), Term(g, (2, 0), 1)],
    ).model()  # fmt: skip
    call = f"""system = {model.source}
nu = vv.MultipleScales(system).backbone(0, [{b}])
"""

    def judge(names, reported):
        if reported:
            return
        balance = Balance(model, 6)
        known = []
        for start in (-1.0, 1.0):
            a = np.zeros((13, 2))
            a[2, 0], a[4, 1] = b, start * b / np.sqrt(8)
            nu = 1 + start * g * b / np.sqrt(8)
            for _ in range(40):
                r, jac = balance.residual(a, nu, 0 * a)
                d = 1e-7
                by_nu = (balance.residual(a, nu + d, 0 * a)[0] - r).ravel() / d
                m = np.zeros((a.size + 2, a.size + 1))
                m[:-2, :-1], m[:-2, -1] = jac, by_nu
                m[-2, 4], m[-1, 2] = 1, 1  # cosine and sine of the first harmonic of q1
                right = np.concatenate([r.ravel(), [a[2, 0] - b, a[1, 0]]])
                change = np.linalg.lstsq(m, right, rcond=None)[0]
                a, nu = a - change[:-1].reshape(a.shape), nu - change[-1]
            if np.abs(change).max() < 1e-10:
                known.append(nu)
        if known:
            got = float(np.ravel(names["nu"])[0])
            nearest = min(known, key=lambda x: abs(x - got))
            yield Claim(
                "frequency near an internal resonance",
                got,
                nearest,
                1e-4 + 0.05 * abs(nearest - 1),
                damage=0.05,
            )

    return Case(call, judge, may_refuse=True)


def _subharmonic(rng, index):
    """Stable motions with three periods of a load, by harmonic balance from a grid of starts."""
    p = even(rng, 3.03, 3.15, 4)
    damping, size, cubic = few(rng, 1e-3, 5e-3, 2), even(rng, 0.5, 1.2, 3), even(rng, 0.1, 0.4, 3)
    model = Draft([1.0], [[damping]], [[1.0]], [Term(cubic, (3,), 0)]).model()
    call = f"""system = {model.source}
s = vv.MultipleScales(system, load={size}, nu={p}).response("nu", [{p}])
moving = int((s.stable & (abs(s.amplitudes[:, 0]) > 1e-3)).sum())
complete = s.complete
"""

    def judge(names, reported):
        balance, nu = Balance(model, 21), p / 3
        load = load_rows(balance, {3: np.array([1j * size])})
        forced = 1j * size / model.dynamic_stiffness(p)[0, 0]
        found = []
        for a in (0.3, 0.5, 0.7, 0.9):
            for turn in np.arange(12) * np.pi / 6:
                start = np.array([[a * np.exp(1j * turn), forced]])
                x = balance.solve(balance.real(start, np.array([1, 3])), nu, load)
                if x is None:
                    continue
                x = balance.complex(x)
                if abs(x[0, 1]) < 1e-3 or any(abs(x - y).max() < 1e-6 for y in found):
                    continue
                if abs(multipliers(model, x, nu, 128)[0][0]) < 1 - 1e-4:
                    found.append(x)
        # Large motions are outside the range of the expansion.
        near = [x for x in found if abs(x[0, 1]) < 0.8]
        enough = names["moving"] >= len(near) or not names["complete"]
        yield Claim("subharmonic motions are listed", bool(enough), True)

    return Case(call, judge)


def case(rng, index):
    """Draw a system and an expansion."""
    kinds = (
        _oscillator,
        _parametric,
        _free,
        _oscillator,
        _bend,
        _several,
        _static,
        _resonances,
        _internal,
        _parametric,
        _beating,
    )
    if index % 22 == 18:
        return _subharmonic(rng, index // 22)
    return kinds[index % 11](rng, index // 11 * 2 + (index % 11 in (3, 9)))
