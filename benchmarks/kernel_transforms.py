"""Transforms of the Koltunov-Rzhanitsyn kernel: closed form against quadrature."""

import math

import mpmath as mp
import numpy as np
import viscovib as vv
from scipy.integrate import quad
from timing import pair, seconds, show_time

A, ALPHA, BETA = 0.048, 0.1, 0.05
TARGET_NS = 25.0


def exact(mu: float) -> tuple[float, float]:
    """R_c and R_s with 40 digits."""
    with mp.workdps(40):
        z = mp.mpf(A) * mp.gamma(ALPHA) * mp.mpc(BETA, mu) ** (-mp.mpf(ALPHA))
        return float(z.real), float(-z.imag)


def by_quad(mu: float) -> tuple[float, float]:
    """SciPy: the singular part with t = u^(1/alpha), the other part with Fourier weights."""
    end = 1.0
    part = []
    for weight, wave in (("cos", math.cos), ("sin", math.sin)):
        start = quad(
            lambda u, wave=wave: (
                A / ALPHA * math.exp(-BETA * u ** (1 / ALPHA)) * wave(mu * u ** (1 / ALPHA))
            ),
            0.0,
            end**ALPHA,
            epsabs=1e-15,
            epsrel=1e-14,
            limit=400,
        )[0]
        tail = quad(
            lambda t: A * math.exp(-BETA * t) * t ** (ALPHA - 1),
            end,
            np.inf,
            weight=weight,
            wvar=mu,
            epsabs=1e-15,
            limit=400,
            limlst=400,
        )[0]
        part.append(start + tail)
    return part[0], part[1]


def by_midpoint(mu: float, end: float = 50.0, n: int = 5000) -> tuple[float, float]:
    """Truncated midpoint rule, as in hand-written scripts."""
    t = (np.arange(n) + 0.5) * end / n
    r = A * np.exp(-BETA * t) * t ** (ALPHA - 1) * end / n
    return float((r * np.cos(mu * t)).sum()), float((r * np.sin(mu * t)).sum())


def run() -> list[dict[str, object]]:
    """Rows: method, time per pair, largest relative error of R_c and R_s."""
    kernel = vv.RzhanitsynKernel(amplitude=A, alpha=ALPHA, beta=BETA)
    mu = np.linspace(0.01, 100.0, 100_000)
    probes = (0.3, 1.5, 7.0, 30.0)

    def error(method):
        return max(
            abs(got - want) / want
            for m in probes
            for got, want in zip(method(m), exact(m), strict=True)
        )

    ours, theirs, ratio = pair(
        lambda: kernel.transform(mu), lambda: [by_quad(m) for m in probes], repeats=5
    )
    vector, quadrature = ours / mu.size, theirs / len(probes)
    rows = [
        {
            "method": "viscovib, vector of 1e5",
            "seconds": vector,
            "error": error(lambda m: (kernel.cosine(m), kernel.sine(m))),
        },
        {
            "method": "viscovib, one frequency from Python",
            "seconds": seconds(lambda: kernel.transform(1.5)),
            "error": error(lambda m: (kernel.cosine(m), kernel.sine(m))),
        },
        {
            "method": "SciPy quad with Fourier weights",
            "seconds": quadrature,
            "error": error(by_quad),
        },
        {
            "method": "midpoint rule to t = 50, 5000 points",
            "seconds": seconds(lambda: by_midpoint(1.5)),
            "error": error(by_midpoint),
        },
    ]
    print(
        f"a pair (R_c, R_s): {show_time(vector)} (target {TARGET_NS:.0f} ns); SciPy quad needs "
        f"{ratio * mu.size / len(probes):.0f} times as long"
    )
    return rows
