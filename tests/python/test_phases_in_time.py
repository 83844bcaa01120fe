"""Long motions with phase errors by rounding of frequencies: reference with 40 digits."""

import mpmath
import numpy as np
import pytest
import viscovib as vv


def motion(mass, damping, stiffness, start, t):
    """States (u, u') at t by the eigenvectors of the equations."""
    n = mass.size
    with mpmath.workdps(40):
        a = mpmath.zeros(2 * n)
        for i in range(n):
            a[i, n + i] = 1
            for j in range(n):
                a[n + i, j] = -mpmath.mpf(stiffness[i, j]) / mpmath.mpf(mass[i])
                a[n + i, n + j] = -mpmath.mpf(damping[i, j]) / mpmath.mpf(mass[i])
        values, vectors = mpmath.eig(a)
        parts = mpmath.lu_solve(vectors, mpmath.matrix(start))
        grown = [mpmath.exp(value * t) * part for value, part in zip(values, parts, strict=True)]
        return np.array([float(mpmath.re(x)) for x in vectors * mpmath.matrix(grown)])


@pytest.mark.parametrize("kind", ["none", "modal", "dampers"])
def test_errors_hold_what_rounding_of_frequencies_makes_of_long_motions(kind):
    """All runs share this error for any step size, so their differences do not show it."""
    rng = np.random.default_rng(4)
    for _ in range(10):
        n, t = int(rng.integers(2, 4)), float(10 ** rng.uniform(3, 5))
        soft, weak = rng.normal(size=(2, n, n))
        pair = np.eye(n)[0] - np.eye(n)[1]
        stiffness = soft @ soft.T + 0.2 * np.eye(n)
        stiffness = (stiffness + stiffness.T) / 2 + 10 ** rng.uniform(0, 7) * np.outer(pair, pair)
        mass = rng.uniform(0.5, 2, n)
        damping = {"none": 0 * weak, "modal": np.diag(mass), "dampers": weak @ weak.T}[kind] / t
        damping = (damping + damping.T) / 2
        u, v = rng.normal(size=(2, n))
        structure = vv.Structure(mass=np.diag(mass), stiffness=stiffness, damping=damping)
        run = vv.simulate(
            structure, t, initial=np.column_stack([u, v]).ravel(), times=[t], rtol=1e-6
        )
        true = motion(mass, damping, stiffness, [*u, *v], t).reshape(2, n)
        assert np.abs(run.state[0].reshape(n, 2).T - true).max() <= run.error


def test_errors_of_what_has_faded_or_stands_still_are_small():
    """Rounding of a frequency affects an oscillation only while it lasts."""
    structure = vv.Structure(
        mass=np.eye(2), stiffness=[[3e4, -1e4], [-1e4, 2e4]], damping=0.5 * np.eye(2)
    )
    push = vv.LoadTable(times=[0, 1, 1e4], values=[0, 1, 1], on="x1")
    run = vv.simulate(structure, 1e4, force=push, times=[1e4])
    assert run.error < 1e-14
