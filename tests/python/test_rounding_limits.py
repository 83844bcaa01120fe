"""Tolerances below rounding error: motions are found, with a stated error."""

import warnings

import numpy as np
import pytest
import viscovib as vv

N, HIGHEST, SAMPLES = 3, 61, 512


def drawn(seed):
    """Light damping near resonance: small rounding errors of forces have a large effect."""
    rng = np.random.default_rng(seed)
    b = rng.normal(size=(N, N))
    stiffness = b @ b.T / N + np.eye(N)
    springs = [
        (rng.normal(size=N), rng.uniform(0.1, 1), rng.uniform(0.1, 1),
         rng.uniform(1e-4, 1e-2), 10 ** rng.uniform(-1, 1)) for _ in range(3)
    ]  # fmt: skip
    nu = np.sqrt(np.linalg.eigvalsh(stiffness)[0]) * rng.uniform(0.8, 1.4)
    return stiffness, 1e-4 * stiffness, springs, nu, rng.normal(size=N)


def equations(x, stiffness, damping, springs, nu, load, kind):
    """Harmonic balance of odd harmonics and its derivatives, with the given number type."""
    orders = np.arange(1, HIGHEST + 1, 2)
    angle = 2 * np.arctan(kind(1)) * 4 * np.arange(SAMPLES, dtype=kind) / SAMPLES
    wave = np.exp(1j * np.outer(orders, angle))
    back = 2j * wave.conj().T / kind(SAMPLES)  # from samples to X, u = Im sum X exp(i k nu t)
    # Real unknowns: columns Re X and Im X of each harmonic.
    to_time = np.concatenate([wave.imag, wave.real])
    m, s = orders.size, 1j * orders * kind(nu)
    left = x @ (stiffness + 0j).T + s[:, None] * (x @ damping.T) + s[:, None] ** 2 * x
    left[0] -= load
    slope = np.zeros((m, 2, N, m, 2, N))
    for k in range(m):
        z = stiffness + complex(s[k]) * damping + complex(s[k]) ** 2 * np.eye(N)
        slope[k, :, :, k, :, :] = np.array([[z.real, -z.imag], [z.imag, z.real]]).swapaxes(1, 2)
    for e, k, a, weight, rate in springs:
        d = (x @ e) @ wave
        memory = 1 - kind(weight) / (kind(rate) + s)
        left += (memory * ((k * d.imag + a * d.imag**3) @ back))[:, None] * e
        bent = memory[:, None] * (back.T @ ((k + 3 * a * d.imag**2)[:, None] * to_time.T))
        parts = np.array([bent.real, bent.imag]).reshape(2, m, 2, m).astype(float)
        slope += np.einsum("pkqj,a,b->kpajqb", parts, e, e)
    return left, slope.reshape(2 * N * m, -1)


@pytest.mark.parametrize("seed", range(8))
def test_motions_down_to_rounding(seed):
    stiffness, damping, springs, nu, direction = drawn(seed)
    load = 10.0 ** -(seed % 4) * direction
    system = vv.Structure(
        mass=np.eye(N), stiffness=stiffness, damping=damping,
        elements=[
            vv.Spring(on=e, stiffness=k, law="a*d^3", parameters={"a": a},
                      kernel=vv.PronyKernel(weights=[w], rates=[rate]))
            for e, k, a, w, rate in springs
        ],
    )  # fmt: skip
    for tolerance in (1e-10, 1e-13, 1e-14):
        with warnings.catch_warnings(record=True) as reported:
            warnings.simplefilter("always")
            found = vv.forced_response(
                system, [nu], load=load, method="newton", harmonics="auto", tolerance=tolerance
            )
        assert found.converged[0], (tolerance, found.outcome)
        # Errors above the tolerance are reported.
        above = found.truncation[0] > tolerance
        assert above == any(issubclass(w.category, vv.ConvergenceWarning) for w in reported)
        x = np.zeros(((HIGHEST + 1) // 2, N), np.clongdouble)
        for order, row in zip(found.harmonics, found.coefficients[0].T, strict=True):
            if order % 2 and order <= HIGHEST:
                x[order // 2] = row
        begun = x.copy()
        for _ in range(6):
            left, slope = equations(x, stiffness, damping, springs, nu, load, np.longdouble)
            right = np.stack([left.real, left.imag], 1).astype(float).ravel()
            step = np.linalg.solve(slope, right).reshape(-1, 2, N)
            x = x - (step[:, 0] + 1j * step[:, 1])
            if np.abs(step).max() < 1e-15 * np.abs(x).max():
                break
        assert np.abs(step).max() < 1e-15 * np.abs(x).max()
        off = float(np.abs(x - begun).max() / np.abs(x).max())
        assert off < 3 * found.truncation[0] + 3 * tolerance
