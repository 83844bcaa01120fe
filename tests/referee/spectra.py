"""Signals of known tones, with or without decay; sums written out."""

import numpy as np

from referee.case import Case, Claim, even, few

JUDGES = (
    "spectrum", "Spectrum", "Spectrum.amplitude", "Spectrum.phase", "Lines", "Lines.__call__",
    "amplitudes_at", "dominant_frequencies", "name_frequencies", "Trajectory.dt",
)  # fmt: skip


def _tones(rng, n, dt, m, apart=4.0):
    """Frequencies at least ``apart`` bins apart, amplitudes and phases."""
    width = 2 * np.pi / (n * dt)
    while True:
        omega = rng.uniform(6 * width, 0.8 * np.pi / dt, m)
        if m == 1 or np.diff(np.sort(omega)).min() > apart * width:
            break
    return omega.round(6), rng.uniform(0.2, 2, m).round(3), rng.uniform(-3, 3, m).round(3)


def _text(n, dt, omega, a, phase, mean, decay=None):
    terms = [
        f"{x} * {f'np.exp(-{d} * t) * ' if decay is not None else ''}np.cos({w} * t + {p})"
        for x, w, p, d in zip(a, omega, phase, decay if decay is not None else a, strict=True)
    ]
    return f"t = {dt} * np.arange({n})\nu = {mean} + {' + '.join(terms)}\n"


def _at(rng, index):
    n, dt, m = int(rng.integers(200, 900)), few(rng, 0.05, 0.5, 2), int(rng.integers(1, 6))
    omega, a, phase = _tones(rng, n, dt, m)
    mean = even(rng, -1, 1, 3)
    call = (
        _text(n, dt, omega, a, phase, mean)
        + f"""lines = vv.amplitudes_at(u, {dt}, {omega.tolist()})
omega, amplitude, phase, mean, value = lines.omega, lines.amplitude, lines.phase, lines.mean, lines(t)
"""
    )

    def judge(names, reported):
        yield Claim("frequencies in the order asked for", names["omega"], omega, 1e-12)
        yield Claim("amplitudes", names["amplitude"], a, 1e-10)
        wave = names["amplitude"] * np.exp(1j * names["phase"])
        yield Claim("phases", wave, a * np.exp(1j * phase), 1e-10)
        yield Claim("mean", names["mean"], mean, 1e-10)
        yield Claim("sum", names["value"], names["u"], 1e-9)

    return Case(call, judge)


def _steady(rng, index):
    n, dt, m = int(rng.integers(300, 1200)), few(rng, 0.05, 0.5, 2), int(rng.integers(1, 5))
    omega, a, phase = _tones(rng, n, dt, m, 6.0)
    call = (
        _text(n, dt, omega, a, phase, 0.3)
        + f"""lines = vv.dominant_frequencies(u, {dt}, count={m})
omega, amplitude, resolved, residual = lines.omega, lines.amplitude, lines.resolved, lines.residual
"""
    )

    def judge(names, reported):
        # Largest first; rounding errors decide between tones of equal size.
        falling = np.argsort(-a, kind="stable")
        got = np.argsort(names["omega"])
        order = np.argsort(omega)
        yield Claim("frequencies", names["omega"][got], omega[order], 1e-8)
        yield Claim("amplitudes", names["amplitude"][got], a[order], 1e-8)
        yield Claim("largest first", names["amplitude"], a[falling], 1e-8)
        yield Claim("resolved", bool(np.all(names["resolved"])), True)
        yield Claim("residual", 1 + names["residual"], 1.0, 1e-8)

    return Case(call, judge)


def _decaying(rng, index):
    n, dt, m = int(rng.integers(400, 1200)), few(rng, 0.05, 0.3, 2), int(rng.integers(1, 3))
    omega, a, phase = _tones(rng, n, dt, m, 60.0)
    # Up to 18 bins: a tone decays in the first hundredth of the record; none is overdamped.
    decay = (rng.uniform(0.3, 6 if index % 2 else 110, m) / (n * dt)).round(6)
    decay = np.minimum(decay, (0.6 * omega).round(6))
    call = (
        _text(n, dt, omega, a, phase, 0.0, decay)
        + f"""lines = vv.dominant_frequencies(u, {dt}, count={m})
omega, resolved, residual = lines.omega, lines.resolved, lines.residual
"""
    )

    def judge(names, reported):
        width = 2 * np.pi / (n * dt)
        for w in names["omega"][np.asarray(names["resolved"], bool)]:
            off = np.abs(omega - w).min() / width
            yield Claim("frequency of a decaying tone, in bins", 1 + off, 1.0, 1e-3, damage=0.2)
        count = len(names["omega"])
        yield Claim("tones found", bool(count >= 1), True)

    return Case(call, judge)


def _bins(rng, index):
    n = int(rng.choice([64, 100, 256, 255]))
    dt, k = few(rng, 0.01, 1, 2), int(rng.integers(6, 25))
    a, phase, mean = even(rng, 0.1, 3, 3), even(rng, -3, 3, 3), even(rng, -1, 1, 3)
    omega = 2 * np.pi * k / (n * dt)
    window = ("hann", "rectangular", "blackman_harris", "flat_top")[index % 4]
    call = f"""t = {dt} * np.arange({n})
u = {mean} + {a} * np.cos({omega!r} * t + {phase})
s = vv.spectrum(u, {dt}, window={window!r})
omega, amplitude, phase, mean = s.omega, s.amplitude, s.phase, s.amplitude[0]
"""

    def judge(names, reported):
        true = 2 * np.pi * np.fft.rfftfreq(n, dt)
        yield Claim("omega", names["omega"], true, 1e-12 * true.max())
        yield Claim(
            "amplitude at a bin",
            names["amplitude"][k],
            a,
            1e-3 * a if window == "flat_top" else 1e-8 * a,
            damage=1e-2 if window == "flat_top" else 1e-6,
        )
        wave = a * np.exp(1j * names["phase"][k])
        yield Claim("phase at a bin", wave, a * np.exp(1j * phase), 1e-3 * a, damage=1e-2)
        yield Claim(
            "mean",
            names["mean"],
            abs(mean),
            1e-3 * (a + abs(mean)),
            damage=0.1 * (a + abs(mean)) / abs(mean),
        )

    return Case(call, judge)


def _of_runs(rng, index):
    """The spectrum of a motion contains the load frequency for any number of stored states."""
    p, c, every = even(rng, 0.5, 1.5, 3), even(rng, 0.5, 1, 2), int(rng.choice([1, 2, 5]))
    step = f"dt=0.1, save_every={every}" if index % 2 else 'dt="auto", tolerance=1e-8'
    call = f"""system = vv.PolynomialSystem(mass=1, stiffness=1, damping={c})
run = vv.simulate(system, 200, load=1.0, nu={p}, initial=[0, 0], {step})
if np.ptp(np.diff(run.t)) > 1e-9:
    run = vv.simulate(system, 200, load=1.0, nu={p}, initial=[0, 0], dt=0.1, save_every=2)
u = run.coordinate("x")
lines = vv.dominant_frequencies(u[u.size // 2 :], run.dt, count=1)
try:
    s = vv.spectrum(run)
    peak = s.omega[np.argmax(s.amplitude.reshape(s.omega.size, -1)[:, 0])]
except TypeError:
    s = vv.spectrum(u, run.dt, window="hann")
    peak = s.omega[1:][np.argmax(s.amplitude[1:])]
spacing, t = run.dt, run.t
"""

    def judge(names, reported):
        width = 2 * np.pi / 200
        yield Claim("peak of the spectrum of a run", names["peak"], p, 2.5 * width, damage=0.3)
        yield Claim("spacing of a run", names["spacing"], np.diff(names["t"]).mean(), 1e-12)

    return Case(call, judge)


def _names(rng, index):
    bases = {"p1": even(rng, 0.5, 1.2, 4), "p2": even(rng, 1.5, 3, 4)}
    k1, k2 = int(rng.integers(-2, 3)), int(rng.integers(1, 3))
    value = k1 * bases["p1"] + k2 * bases["p2"]
    call = f"""names = vv.name_frequencies([{value!r}, 0.0], {bases})
"""

    def judge(names, reported):
        from itertools import product

        near = [
            (abs(i) + abs(j), i, j)
            for i, j in product(range(-5, 6), repeat=2)
            if 0 < abs(i) + abs(j) <= 5 and abs(i * bases["p1"] + j * bases["p2"] - value) <= 1e-6
        ]
        least = min(near)[0]
        chosen = [(i, j) for size, i, j in near if size == least]
        if len(chosen) > 1:
            return
        i, j = chosen[0]
        parts = sorted([(i, "p1"), (j, "p2")], key=lambda x: x[0] < 0)
        text = ""
        for k, name in parts:
            if k:
                sign = ("- " if k < 0 else "+ ") if text else ("-" if k < 0 else "")
                text += f"{' ' if text else ''}{sign}{'' if abs(k) == 1 else f'{abs(k)} '}{name}"
        yield Claim("name", names["names"][0], text)
        yield Claim("mean", names["names"][1], "mean")

    return Case(call, judge)


def case(rng, index):
    """Draw a signal."""
    kinds = (_at, _steady, _decaying, _bins, _at, _decaying, _of_runs, _names)
    return kinds[index % 8](rng, index // 8)
