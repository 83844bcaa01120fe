"""Reference values of relaxation kernels at 50 digits: transforms and time values.

Koltunov-Rzhanitsyn (beta = 0: Abel): A Gamma(alpha) (beta + i mu)^(-alpha); Rabotnov:
A/((i mu)^alpha + beta), R(t) = A t^(alpha-1) E_{alpha,alpha}(-beta t^alpha), the Mittag-Leffler
function by its power series in as many digits as cancellation costs. Parameters are exact doubles.
"""

import argparse
from pathlib import Path

import mpmath as mp
import numpy as np

mp.mp.dps = 50
ALPHAS = (0.01, 0.05, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 0.999999, 1.0)


def rzhanitsyn(alpha, beta, mu):
    """R_c - i R_s for A = 1."""
    return mp.gamma(mp.mpf(alpha)) * mp.mpc(beta, mu) ** (-mp.mpf(alpha))


def rabotnov(alpha, beta, mu):
    """R_c - i R_s for A = 1."""
    return 1 / (mp.mpc(0, mu) ** mp.mpf(alpha) + mp.mpf(beta))


def rabotnov_value(alpha, beta, t):
    """R(t) for A = 1; None where the series would need too many terms."""
    alpha, beta, t = mp.mpf(alpha), mp.mpf(beta), mp.mpf(t)
    z = beta * t**alpha
    size = float(z ** (1 / alpha))
    if size > 400:
        return None
    with mp.workdps(60 + int(size)):
        total, term, n = mp.mpf(0), mp.mpf(1), 1
        while True:
            part = term / mp.gamma(alpha * n)
            total += part
            if alpha * n > 2 and abs(part) < mp.mpf(10) ** -40 * abs(total):
                return t ** (alpha - 1) * total
            term *= -z
            n += 1


def main():
    """Write both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1])
    out = parser.parse_args().out
    with open(out / "kernel_transforms.csv", "w", encoding="utf-8") as file:
        file.write(
            "# R_c and R_s for amplitude 1, 25 digits; by data/programs/kernel_transforms.py\n"
        )
        file.write("kernel,alpha,beta,mu,cosine,sine\n")
        for kernel in (rzhanitsyn, rabotnov):
            for alpha in ALPHAS:
                for beta in (0.0, 1e-6, 1e-3, 0.05, 1.0, 10.0):
                    for mu in 10.0 ** np.linspace(-8, 8, 9):
                        value = kernel(alpha, beta, float(mu))
                        file.write(f"{kernel.__name__},{alpha!r},{beta!r},{float(mu)!r},")
                        file.write(f"{mp.nstr(value.real, 25)},{mp.nstr(-value.imag, 25)}\n")
    with open(out / "kernel_values.csv", "w", encoding="utf-8") as file:
        file.write("# R(t) of the Rabotnov kernel for amplitude 1, 25 digits; same program\n")
        file.write("alpha,beta,t,value\n")
        for alpha in (0.1, 0.3, 0.5, 0.8, 0.95, 1.0):
            for beta in (0.05, 1.0, 5.0):
                for t in 10.0 ** np.linspace(-6, 3, 10):
                    value = rabotnov_value(alpha, beta, float(t))
                    if value is not None:
                        file.write(f"{alpha!r},{beta!r},{float(t)!r},{mp.nstr(value, 25)}\n")


if __name__ == "__main__":
    main()
