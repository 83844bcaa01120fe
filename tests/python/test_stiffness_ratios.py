"""Springs so different that the rounding of the matrix hides the soft ones: told, or right."""

import warnings

import mpmath
import numpy as np
import pytest
import viscovib as vv
from viscovib.systems.structure_rest import dense_rest


def chain(springs):
    """Masses in a row, the first held by the first spring."""
    n = springs.size
    stiffness = np.zeros((n, n))
    for i, k in enumerate(springs):
        e = np.zeros(n)
        e[i] = 1
        if i > 0:
            e[i - 1] = -1
        stiffness += k * np.outer(e, e)
    return stiffness


def exact(mass, damping, stiffness, nu, load):
    """Amplitudes with 50 digits."""
    with mpmath.workdps(50):
        n = load.size
        matrix = mpmath.matrix(n, n)
        for i in range(n):
            for j in range(n):
                matrix[i, j] = mpmath.mpc(stiffness[i, j], mpmath.mpf(damping[i, j]) * nu)
            matrix[i, i] -= mpmath.mpf(mass[i]) * nu**2
        x = mpmath.lu_solve(matrix, mpmath.matrix(load.tolist()))
        return np.array([float(abs(value)) for value in x])


@pytest.mark.parametrize("kind", ["modal", "dampers", "follower"])
def test_what_rounding_hides_is_told(kind):
    """Of real modes; of complex ones, by dampers or by a stiffness that is not symmetric."""
    rng = np.random.default_rng(1)
    told = 0
    for _ in range(40):
        n = int(rng.integers(3, 7))
        springs = rng.uniform(0.5, 2, n)
        springs[rng.integers(1, n)] *= 10 ** rng.uniform(2, 14.5)
        mass, nu = rng.uniform(0.5, 2, n), rng.uniform(0.1, 1)
        load = np.zeros(n)
        load[-1] = 1e-3
        stiffness, damping = chain(springs), 0.02 * np.diag(mass)
        if kind == "dampers":
            damping += 0.1 * chain(rng.uniform(0.5, 2, n))
        elif kind == "follower":
            stiffness[0, 0] += 0.1
            stiffness[0, 1] += 0.05 * springs[0]
        with warnings.catch_warnings(record=True) as seen:
            warnings.simplefilter("always")
            structure = vv.Structure(
                mass=np.diag(mass),
                stiffness=stiffness,
                damping=damping,
                elements=[vv.Spring(on="x1", law="1e-9*d^3")],
            )
            response = vv.forced_response(
                structure, [nu], load=load, harmonics=3, method="newton",
                coordinates=structure.dof_names,
            )  # fmt: skip
        true = exact(mass, damping, stiffness, nu, load)
        found = np.array([response.amplitude(name)[0] for name in structure.dof_names])
        warned = any("rounding hides the soft ones" in str(w.message) for w in seen)
        told += warned
        assert warned or np.abs(found - true).max() < 1e-5 * true.max()
    assert 10 < told < 30


def test_free_bodies_are_no_false_alarm():
    rng = np.random.default_rng(3)
    for _ in range(200):
        n = int(rng.integers(2, 40))
        stiffness = np.zeros((n, n))
        size = 10 ** rng.uniform(0, 6)
        for _ in range(2 * n):
            i, j = rng.choice(n, 2, replace=False)
            e = np.zeros(n)
            e[i], e[j] = 1, -1
            stiffness += size ** rng.uniform() * np.outer(e, e)
        with warnings.catch_warnings():
            warnings.simplefilter("error", vv.RangeWarning)
            rest = dense_rest(np.diag(rng.uniform(0.5, 2, n)), np.zeros((n, n)), stiffness)
        assert rest.squares.min() == pytest.approx(0, abs=1e-9 * rest.squares.max())


def test_springs_of_one_kind_are_no_false_alarm_under_any_damping():
    rng = np.random.default_rng(5)
    for _ in range(200):
        n = int(rng.integers(2, 40))
        size = 10 ** rng.uniform(0, 4)
        stiffness = chain(size ** rng.uniform(0, 1, n))
        if rng.uniform() < 0.5:
            stiffness = stiffness + np.triu(rng.normal(size=(n, n)), 1) * 0.01
        damping = 10 ** rng.uniform(-4, 0) * chain(rng.uniform(0.5, 2, n))
        with warnings.catch_warnings():
            warnings.simplefilter("error", vv.RangeWarning)
            dense_rest(np.diag(rng.uniform(0.5, 2, n)), damping, stiffness)
