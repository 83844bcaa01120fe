"""Transforms in closed form by mpmath, values and relaxation by incomplete gamma functions and contours."""

import mpmath as mp
import numpy as np

from referee.case import Case, Claim, even, few, numbers

JUDGES = (
    "RzhanitsynKernel", "RzhanitsynKernel.limit_amplitude", "AbelKernel", "RabotnovKernel",
    "PronyKernel", "TabulatedKernel", "ExponentialSum", "Kernel", "Kernel.__call__",
    "Kernel.transform", "Kernel.cosine", "Kernel.sine", "Kernel.laplace", "Kernel.relaxation",
    "Kernel.integral", "Kernel.sum_of_exponentials",
)  # fmt: skip
#: Allowed relative rounding error: some units in the last place, as after a logarithm.
ROUNDING = 2e-14


def _power(rng, index):
    """Parameters and mpmath functions of a kernel with a transform in closed form."""
    alpha = rng.choice([even(rng, 0.05, 0.99, 3), even(rng, 0.01, 0.05, 2), 1.0])
    alpha, amplitude, beta = float(alpha), few(rng, 1e-3, 2), few(rng, 1e-3, 5)
    kind = index % 4
    a, al, be = mp.mpf(amplitude), mp.mpf(alpha), mp.mpf(beta)
    if kind == 0:
        return (
            f"vv.RzhanitsynKernel(amplitude={amplitude}, alpha={alpha}, beta={beta})",
            lambda s: a * mp.gamma(al) * (s + be) ** (-al),
            lambda t: a * mp.exp(-be * t) * t ** (al - 1),
            lambda t: a * be ** (-al) * mp.gammainc(al, 0, be * t),
            a * mp.gamma(al) * be ** (-al),
        )
    if kind == 1:
        return (
            f"vv.AbelKernel(amplitude={amplitude}, alpha={alpha})",
            lambda s: a * mp.gamma(al) * s ** (-al),
            lambda t: a * t ** (al - 1),
            lambda t: a * t**al / al,
            mp.inf,
        )
    if kind == 2:
        return (
            f"vv.RabotnovKernel(amplitude={amplitude}, alpha={alpha}, beta={beta})",
            lambda s: a / (s**al + be),
            lambda t: _rabotnov(a, al, be, t, 0),
            lambda t: _rabotnov(a, al, be, t, 1),
            a / be,
        )
    n = int(rng.integers(1, 6))
    weights = [few(rng, 1e-3, 1, 3) for _ in range(n)]
    rates = [few(rng, 1e-3, 50, 3) for _ in range(n)]
    w, r = [mp.mpf(x) for x in weights], [mp.mpf(x) for x in rates]
    return (
        f"vv.PronyKernel(weights={weights}, rates={rates})",
        lambda s: sum(x / (s + y) for x, y in zip(w, r, strict=True)),
        lambda t: sum(x * mp.exp(-y * t) for x, y in zip(w, r, strict=True)),
        lambda t: sum(-x / y * mp.expm1(-y * t) for x, y in zip(w, r, strict=True)),
        sum(x / y for x, y in zip(w, r, strict=True)),
    )


def _rabotnov(a, al, be, t, integrals):
    """The kernel, or its integral, as an integral over rates: trapezoidal rule in their logarithm."""
    a, al, be, t = map(float, (a, al, be, t))
    if al == 1:
        return a * np.exp(-be * t) if not integrals else -a / be * np.expm1(-be * t)
    # Poles lie pi (1 - alpha)/alpha off the axis: the error is exp(-2 pi times this / step).
    step = min(0.05, np.pi * (1 - al) / al / 7)
    middle, fast = np.log(be) / al, -np.log(t)
    low = min(middle, fast) - 40 / (1 + al)
    high = max(middle + (40 / al if integrals else 0), fast) + (40 / al if integrals else 5)
    # np.arange computes its step from two values, which loses digits if they are large.
    x = low + step * np.arange(int((high - low) / step))
    # p = x^alpha / beta, expressed in p or 1/p, whichever is small.
    p = np.exp(-al * np.abs(x - middle))
    spectrum = p / (1 + 2 * p * np.cos(np.pi * al) + p * p) / be
    rate = np.exp(np.minimum(x, fast + 8))
    fall = (
        rate * np.exp(-rate * t)
        if not integrals
        else -np.expm1(-np.exp(np.minimum(x, fast + 8)) * t)
    )
    return a * np.sin(np.pi * al) / np.pi * step * float(np.sum(fall * spectrum))


def _closed(rng, index):
    source, laplace, value, integral, total = _power(rng, index)
    mu = [few(rng, 1e-6, 1e6, 5) for _ in range(6)]
    s = [complex(even(rng, 0.01, 5), even(rng, -20, 20)) for _ in range(5)]
    t = [few(rng, 1e-5, 1e4, 4) for _ in range(3)]
    call = f"""kernel = {source}
mu, s, t = {mu}, {s}, {t}
hats, cosine, sine = kernel.transform(mu), kernel.cosine(mu), kernel.sine(mu)
laplace, value, relaxation = kernel.laplace(s), kernel(t), kernel.relaxation(t)
integral = kernel.integral
""" + ("limit = kernel.limit_amplitude\n" if index % 4 == 0 else "")

    def judge(names, reported):
        with mp.workdps(30):
            hats = np.array([complex(laplace(mp.mpc(0, m))) for m in mu])
            of_s = np.array([complex(laplace(mp.mpc(x))) for x in s])
            at = np.array([float(value(mp.mpf(x))) for x in t])
            passed = np.array([float(integral(mp.mpf(x))) for x in t])
        yield Claim("transform", names["hats"], hats, ROUNDING * np.abs(hats))
        yield Claim("cosine", names["cosine"], hats.real, ROUNDING * np.abs(hats.real) + 1e-300)
        yield Claim("sine", names["sine"], -hats.imag, ROUNDING * np.abs(hats.imag) + 1e-300)
        yield Claim("laplace", names["laplace"], of_s, ROUNDING * np.abs(of_s))
        tail = 1e-12 if "Rabotnov" in source else 1e-13
        yield Claim("value", names["value"], at, tail * np.abs(at) + 1e-300)
        yield Claim("relaxation", names["relaxation"], 1 - passed, tail * (1 + np.abs(passed)))
        if mp.isinf(total):
            yield Claim("no integral", bool(np.isinf(names["integral"])), True)
        else:
            yield Claim("integral", names["integral"], float(total), ROUNDING * float(total))
        if "limit" in names:
            limit = float(names["kernel"].amplitude / total)
            yield Claim("limit_amplitude", names["limit"], limit, ROUNDING * limit)

    return Case(call, judge)


def _sum(rng, index):
    source, laplace, value, _, _ = _power(rng, int(rng.integers(3)))
    tolerance = float(f"{10 ** -rng.uniform(2, 13.9):.1e}")
    t_min = few(rng, 1e-4, 1e-1, 2)
    t_max = float(f"{t_min * 10 ** rng.uniform(1, 6):.2g}")
    # Values that have decayed completely have no relative error.
    rate = float(source.rpartition("beta=")[2].rstrip(")")) if "Rzhanitsyn" in source else 0.0
    t_max = min(t_max, float(f"{max(60 / rate, 2 * t_min):.2g}")) if rate else t_max
    t = np.geomspace(t_min, t_max, 42)[:-1] * rng.uniform(1, 1.01)
    t = np.unique(np.clip(t, t_min, t_max))
    mu = np.geomspace(1 / t_max, 6 / t_min, 12)
    call = f"""kernel = {source}
fit = kernel.sum_of_exponentials(tolerance={tolerance}, t_min={t_min}, t_max={t_max})
at = fit({numbers(t)})
error, weights, rates = fit.error, fit.weights, fit.rates
hats = fit.transform({numbers(mu)})
"""

    def judge(names, reported):
        with mp.workdps(25):
            true = np.array([float(value(mp.mpf(x))) for x in t])
        # If the error is larger than the tolerance, the result must state it.
        # Strong decay loses digits in the exponent.
        lost = 4e-15 - 1e-15 * np.log(np.clip(true / true.max(), 1e-300, 1))
        if "Rabotnov" in source:
            # The quadrature of the reference itself, in double precision.
            lost = lost + 2e-13
        yield Claim("error of the sum", names["at"], true, (1.1 * names["error"] + lost) * true + 1e-300,
                    limit=1.5, damage=max(1e-6, 20 * tolerance))  # fmt: skip
        with mp.workdps(25):
            of_mu = np.array([complex(laplace(mp.mpc(0, x))) for x in mu])
        smaller = np.minimum(1, np.abs(of_mu))
        yield Claim("transform of the sum", names["hats"], of_mu, (1.1 * names["error"] + 1e-13) * smaller,
                    limit=1.5, damage=max(1e-6, 20 * tolerance))  # fmt: skip
        met = bool(names["error"] <= 1.01 * tolerance + 1e-14 + 5e-16 * rate * t_max) or bool(
            reported
        )
        yield Claim("tolerance met or reported", met, True)
        direct = np.exp(-np.outer(t, names["rates"])) @ names["weights"]
        yield Claim("weights and rates", direct, names["at"], 1e-13 * np.abs(direct))

    return Case(call, judge, may_refuse=True)


def _table(rng, index):
    n = int(rng.integers(3, 9))
    t = np.cumsum(rng.uniform(0.05, 1, n)).round(4)
    v = np.sort(rng.uniform(0.01, 1, n))[::-1].round(5)
    kind = ("linear", "exponential")[index % 2]
    mu = [few(rng, 1e-3, 1e3, 4) for _ in range(4)]
    at = rng.uniform(t[0], t[-1], 6).round(5)
    call = f"""kernel = vv.TabulatedKernel(times={t.tolist()}, values={v.tolist()}, interpolation={kind!r})
hats, value, integral = kernel.transform({mu}), kernel({at.tolist()}), kernel.integral
"""

    def judge(names, reported):
        with mp.workdps(40):
            pieces = [(mp.mpf(0), mp.mpf(t[0]), *_piece(kind, t, v, 0, first=True))]
            pieces += [
                (mp.mpf(t[i]), mp.mpf(t[i + 1]), *_piece(kind, t, v, i)) for i in range(n - 1)
            ]
            if kind == "exponential":
                pieces.append((mp.mpf(t[-1]), mp.inf, *_piece(kind, t, v, n - 2)))
            hats = np.array([complex(_hat(kind, pieces, mp.mpc(0, m))) for m in mu])
            total = float(_hat(kind, pieces, mp.mpf(0)).real)
        true = np.interp(at, t, v if kind == "linear" else np.log(v))
        true = true if kind == "linear" else np.exp(true)
        # Angles mu t have a rounding error of their own size. The jump at the end of a linear table
        # contributes v/mu, which may exceed the whole transform.
        blur = 1e-13 + 4e-16 * np.array(mu) * t[-1]
        blur = blur * np.abs(hats) + (2e-16 * t[-1] * v[-1] if kind == "linear" else 0)
        yield Claim("transform of a table", names["hats"], hats, blur)
        yield Claim("value of a table", names["value"], true, 1e-13 * true)
        if np.isinf(total):  # If the last two values are equal, the extrapolation does not decay.
            yield Claim("integral without end", bool(np.isposinf(names["integral"])), True)
        else:
            yield Claim("integral of a table", names["integral"], total, 1e-13 * total)

    return Case(call, judge)


def _piece(kind, t, v, i, first=False):
    """Value at 0 and slope (linear), or factor at 0 and rate (exponential), of a piece."""
    a, b, x, y = (mp.mpf(float(q)) for q in (t[i], t[i + 1], v[i], v[i + 1]))
    if kind == "linear":
        slope = mp.mpf(0) if first else (y - x) / (b - a)
        return x - slope * a, slope
    rate = (mp.log(y) - mp.log(x)) / (b - a)
    return x * mp.exp(-rate * a), rate


def _hat(kind, pieces, s):
    total = mp.mpc(0)
    for a, b, x, y in pieces:
        if kind == "exponential":
            power = y - s
            upper = mp.mpf(0) if mp.isinf(b) else mp.exp(power * b)
            total += x * (upper - mp.exp(power * a)) / power if power else x * (b - a)
        elif s == 0:
            total += x * (b - a) + y * (b * b - a * a) / 2
        else:
            total += _ramp(x, y, s, a) - _ramp(x, y, s, b)
    return total


def _ramp(x, y, s, q):
    """Integral of (x + y t) exp(-s t) from q to infinity."""
    return mp.exp(-s * q) * ((x + y * q) / s + y / s**2)


def _singular_table(rng, index):
    """Values before the first point of a table are unknown: a warning or an accurate extrapolation."""
    alpha, beta = even(rng, 0.08, 0.5, 2), few(rng, 0.05, 0.5, 2)
    amplitude = float(f"{0.7 * beta**alpha / float(mp.gamma(alpha)):.4g}")
    first = few(rng, 1e-4, 1e-2, 2)
    call = f"""t = np.geomspace({first}, 200, 50)
values = {amplitude} * np.exp(-{beta} * t) * t**({alpha} - 1)
kernel = vv.TabulatedKernel(times=t, values=values, interpolation={("linear", "exponential")[index % 2]!r})
integral = kernel.integral
"""

    def judge(names, reported):
        true = float(amplitude * mp.gamma(alpha) * mp.mpf(beta) ** (-alpha))
        near = abs(names["integral"] - true) <= 0.05 * true
        yield Claim("singular mass kept or reported", bool(near or reported), True)

    return Case(call, judge)


def case(rng, index):
    """Draw a kernel and a question."""
    if index % 8 in (0, 1, 2, 3):
        return _closed(rng, index)
    if index % 8 in (4, 5):
        return _sum(rng, index)
    return _table(rng, index // 8) if index % 8 == 6 else _singular_table(rng, index // 8)
