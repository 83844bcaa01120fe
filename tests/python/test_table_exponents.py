"""Exponents with kernels of finite duration: each is a zero of Hill's determinant, in NumPy."""

import numpy as np
import pytest
import viscovib as vv

#: Harmonics of the perturbation in the reference.
HIGHEST = 16


def laplace(times, values, s):
    """Transform of the linear pieces: integrated by parts twice."""
    t, v = np.insert(times, 0, 0.0), np.insert(values, 0, values[0])
    fall, s = np.diff(v) / np.diff(t), s[:, None]
    pieces = fall * np.exp(-s * t[:-1]) * -np.expm1(-s * np.diff(t)) / s
    ends = v[0] - v[-1] * np.exp(-s[:, 0] * t[-1])
    return (ends + pieces.sum(axis=1)) / s[:, 0]


def distance_to_zero(exponent, nu, waves, mass, damping, stiffness, kernel):
    """Newton correction of an exponent, by det H and its derivative; waves[m]: cubic stiffness."""
    orders = np.arange(-HIGHEST, HIGHEST + 1)
    own = waves[orders[:, None] - orders[None, :]]

    def rows(at):
        s = at + 1j * nu * orders
        kept = 1 - laplace(*kernel, s)
        springs = stiffness * np.eye(s.size) + own
        return np.diag(mass * s**2 + damping * s) + kept[:, None] * springs

    h = 1e-5 * nu
    rate = (rows(exponent + h) - rows(exponent - h)) / (2 * h)
    return 1 / abs(np.trace(np.linalg.solve(rows(exponent), rate)))


def drawn(seed):
    """Frequency, load, damping, cubic spring and a table of a few hundred to 2000 s."""
    rng = np.random.default_rng(seed)
    end = 10 ** rng.uniform(2.3, 3.3)
    times = np.geomspace(1e-4, end, int(rng.integers(8, 14)))
    values = times ** rng.uniform(-0.6, -0.2) * np.exp(-times / end * rng.uniform(0, 5))
    values *= rng.uniform(0.02, 0.3) / np.trapezoid(values, times)
    damping, load = 10 ** rng.uniform(-2.3, -1), rng.uniform(0.05, 0.4)
    return rng.uniform(0.6, 1.8), load, damping, rng.uniform(0.05, 0.5), (times, values)


@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
@pytest.mark.parametrize("structure", [False, True], ids=["system", "structure"])
def test_exponents_with_tables_are_zeros(structure):
    """In the left half plane the determinant is unbounded, so its slope is no criterion."""
    looked = 0
    for seed in range(30):
        nu, load, damping, cubic, table = drawn(seed)
        kernel = vv.TabulatedKernel(times=table[0], values=table[1])
        if structure:
            law = f"{cubic}*d^3 + 0.3*d^2"
            spring = vv.Spring(on=[1.0], stiffness=1.0, law=law, kernel=kernel)
            system = vv.Structure(mass=[1.0], damping=[damping], stiffness=[0.0], elements=[spring])
        else:
            system = vv.PolynomialSystem(
                mass=1, stiffness=1, damping=damping, forces=f"{cubic}*x^3 + 0.3*x^2", kernel=kernel
            )
        r = vv.forced_response(system, [nu], load=load, method="newton", stability=True)
        if not r.converged[0]:
            continue
        x = np.zeros(17, complex)
        kept = r.harmonics <= 16
        x[r.harmonics[kept]] = r.coefficients[0, 0, kept]
        u = (np.exp(2j * np.pi * np.outer(np.arange(256), np.arange(17)) / 256) @ x).imag
        waves = np.fft.fft(3 * cubic * u**2 + 0.6 * u) / 256
        for exponent in r.exponents[0][np.isfinite(r.exponents[0])]:
            off = distance_to_zero(exponent, nu, waves, 1.0, damping, 1.0, table)
            looked += 1
            assert off < 1e-7 * nu, (seed, exponent, off)
    assert looked > 35
