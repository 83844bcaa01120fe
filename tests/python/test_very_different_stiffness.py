"""Structures with very different springs and dampers: motions with 40 digits."""

import mpmath
import numpy as np
import pytest
import viscovib as vv
from scipy.linalg import expm


def motion(mass, damping, stiffness, load, nu, start, t):
    """States (u, u') at t by the eigenvectors of the equations, with sin and cos of the load."""
    n = mass.size
    with mpmath.workdps(40):
        a = mpmath.zeros(2 * n + 2)
        for i in range(n):
            a[i, n + i] = 1
            for j in range(n):
                a[n + i, j] = -mpmath.mpf(stiffness[i, j]) / mpmath.mpf(mass[i])
                a[n + i, n + j] = -mpmath.mpf(damping[i, j]) / mpmath.mpf(mass[i])
            a[n + i, 2 * n] = mpmath.mpf(load[i]) / mpmath.mpf(mass[i])
        a[2 * n, 2 * n + 1], a[2 * n + 1, 2 * n] = nu, -nu
        values, vectors = mpmath.eig(a)
        parts = mpmath.lu_solve(vectors, mpmath.matrix([*start, 0, 1]))
        grown = [mpmath.exp(value * t) * part for value, part in zip(values, parts, strict=True)]
        return np.array([float(mpmath.re(x)) for x in vectors * mpmath.matrix(grown)][: 2 * n])


@pytest.mark.parametrize("kind", ["modal", "dampers", "strong damper"])
def test_soft_motions_with_a_stiff_spring(kind):
    """The matrix entries contain the soft springs; an eigensolver loses 1e-16 of the stiff one."""
    rng = np.random.default_rng(5)
    for i in range(3):
        n = int(rng.integers(2, 5))
        mass, high = rng.uniform(0.5, 2, n), 10 ** rng.uniform(5, 8)
        soft, weak = rng.normal(size=(2, n, n))
        stiff = rng.normal(size=n)
        if i % 3 == 0:
            stiff = np.eye(n)[0]
        elif i % 3 == 1:
            stiff = np.eye(n)[0] - np.eye(n)[1]
        stiffness = soft @ soft.T + 0.1 * np.eye(n) + high * np.outer(stiff, stiff)
        damping = 0.01 * np.diag(mass) + 1e-3 / np.sqrt(high) * stiffness
        if kind != "modal":
            damping = 0.02 * weak @ weak.T
        if kind == "strong damper":
            damping = damping + np.sqrt(high) * np.outer(stiff, stiff)
        u, v = rng.normal(size=(2, n))
        u, v = (x - stiff * (stiff @ x) / (stiff @ stiff) for x in (u, v))
        load = rng.normal(size=n)
        structure = vv.Structure(mass=np.diag(mass), stiffness=stiffness, damping=damping)
        run = vv.simulate(
            structure, 10, initial=np.column_stack([u, v]).ravel(), load=load, nu=0.7, times=[10]
        )
        right = motion(mass, damping, stiffness, load, 0.7, [*u, *v], 10)
        # Regression: errors of 2e-16 times the ratio.
        assert np.abs(run.state[0] - right.reshape(2, n).T.ravel()).max() < 3e-12 + 1e-18 * high


@pytest.mark.parametrize(("strong", "turn"), [(1e3, 1), (1e11, -1), (1e15, 1)])
def test_weak_dampers_with_a_strong_one(strong, turn):
    """They couple or rotate modes and dissipate, also if loads act elsewhere."""
    for between in (0.15, 0.0):
        damping = np.diag([0.2, 0.3, strong])
        damping[0, 1], damping[1, 0] = between, turn * between
        structure = vv.Structure(mass=np.eye(3), stiffness=np.diag([1, 2, 1e4]), damping=damping)
        run = vv.simulate(structure, 5, initial=[1, 0, 0.5, 0, 0, 0], times=[5])
        a = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.diag([1.0, 2]), -damping[:2, :2]]])
        right = expm(5 * a) @ [1, 0.5, 0, 0]
        assert np.abs(run.state[0, :4] - right[[0, 2, 1, 3]]).max() < 1e-13
        r = vv.forced_response(structure, [1.1], load=[1, 0, 0])
        dynamic = np.diag([1.0, 2]) + 1.1j * damping[:2, :2] - 1.21 * np.eye(2)
        found = [r.amplitude(name)[0] for name in ("x1", "x2")]
        assert found == pytest.approx(np.abs(np.linalg.solve(dynamic, [1, 0])), rel=1e-12)


@pytest.mark.parametrize("kind", ["of modes", "coupled", "free"])
def test_soft_motions_with_stiff_springs_that_relax(kind):
    """Layers with memory: rounding of the sum of stiffnesses must not affect the motion."""
    rng = np.random.default_rng(6)
    for i in range(4):
        n, rate = 3, 10 ** rng.uniform(-1, 1)
        weight = rate * rng.uniform(0.1, 0.5)
        joints = np.eye(n + 1, n) - np.eye(n + 1, n, k=-1)
        springs, held = rng.uniform(0.5, 2, n + 1), rng.uniform(0.2, 0.8, n + 1)
        if kind == "free":
            # Numbers with exact sums, because rounding errors would act as a spring.
            springs, held = np.array([0, 0.75, 1.5, 0]), np.array([0.5, 0.25, 0.75, 0.5])
        springs[1 + i % 2] = 2.0 ** rng.integers(14, 27)
        stiffness = joints.T @ (springs[:, np.newaxis] * joints)
        layer = joints.T @ ((springs * held)[:, np.newaxis] * joints)
        damping = 0.02 * np.diag(rng.uniform(0.5, 2, n)) * (kind == "coupled")
        mass = rng.uniform(0.5, 2, n)
        if kind == "of modes":
            layer = 0.5 * stiffness
        start = np.linalg.solve(stiffness + np.diag(mass), rng.normal(size=n))
        kernel = vv.PronyKernel(weights=[weight], rates=[rate])
        structure = vv.Structure(
            mass=np.diag(mass), stiffness=stiffness, damping=damping, layers=[(layer, kernel)]
        )
        run = vv.simulate(
            structure, 8, initial=np.column_stack([start, 0 * start]).ravel(), times=[8]
        )
        with mpmath.workdps(70):
            a = mpmath.zeros(3 * n)
            for j in range(n):
                a[j, n + j], a[2 * n + j, j], a[2 * n + j, 2 * n + j] = 1, weight, -rate
                for k in range(n):
                    m, own = mpmath.mpf(mass[j]), mpmath.mpf(layer[j, k])
                    a[n + j, k] = -(mpmath.mpf(stiffness[j, k]) + own) / m
                    a[n + j, n + k] = -mpmath.mpf(damping[j, k]) / m
                    a[n + j, 2 * n + k] = own / m
            found = mpmath.expm(8 * a) * mpmath.matrix([*start, *np.zeros(2 * n)])
            true = np.array([float(x) for x in found][: 2 * n]).reshape(2, n)
        assert np.abs(run.state[0].reshape(n, 2).T - true).max() < 2e-13


def test_soft_natural_frequencies_with_a_stiff_spring():
    rng = np.random.default_rng(2)
    for _ in range(20):
        n = int(rng.integers(2, 6))
        mass, soft, stiff = rng.uniform(0.5, 2, n), rng.normal(size=(n, n)), rng.normal(size=n)
        if rng.random() < 0.5:
            stiff = np.eye(n)[0]
        stiffness = soft @ soft.T + 0.1 * np.eye(n)
        stiffness += 10 ** rng.uniform(2, 9) * np.outer(stiff, stiff)
        system = vv.PolynomialSystem(mass=mass, stiffness=stiffness)
        with mpmath.workdps(40):
            root = [1 / mpmath.sqrt(m) for m in mass]
            a = mpmath.matrix(n, n)
            for i in range(n):
                for j in range(n):
                    a[i, j] = mpmath.mpf(stiffness[i, j]) * root[i] * root[j]
            right = [float(mpmath.sqrt(x)) for x in mpmath.eigsy(a, eigvals_only=True)]
        # Regression: a stiffness ratio of 1e9 gave errors of 1e-7 of the softest mode.
        assert system.natural_frequencies() == pytest.approx(right, rel=2e-11)


def twin_chains(n, stiff):
    """Stiffness of two chains of n masses, coupled mass by mass: both move like one chain.

    Squared frequencies are 4 sin(j pi/(2 n + 2))^2, and these plus twice the coupling.
    """
    one = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    return one, np.kron(np.eye(2), one) + stiff * np.kron(np.array([[1, -1], [-1, 1]]), np.eye(n))


@pytest.mark.parametrize("stiff", [2.0**8, 2.0**20, 2.0**26])
def test_modes_of_many_coordinates_are_those_of_a_chain(stiff):
    n = 70
    _, stiffness = twin_chains(n, stiff)
    rest = vv.Structure(mass=np.eye(2 * n), stiffness=stiffness)._rest
    angles = np.arange(1, n + 1) * np.pi / (2 * n + 2)
    soft = 4 * np.sin(angles) ** 2
    assert rest.squares == pytest.approx([*soft, *(soft + 2 * stiff)], rel=2e-14)
    waves = np.sin(2 * np.outer(np.arange(1, n + 1), angles)) / np.sqrt(n + 1)
    mixed = rest.shapes[:, :n].T @ np.concatenate([waves, waves])
    assert np.abs(mixed) == pytest.approx(np.eye(n), abs=1e-13)


@pytest.mark.parametrize(
    ("kind", "stiff"), [("none", 2.0**26), ("dampers", 2.0**20), ("follower forces", 2.0**8)]
)
def test_many_coordinates_with_stiff_springs_move_as_one_chain(kind, stiff):
    rng = np.random.default_rng(3)
    n = 55
    one, stiffness = twin_chains(n, stiff)
    mass, damping = rng.uniform(0.5, 2, n), np.zeros((n, n))
    if kind != "none":
        for i in rng.integers(1, n, 3):
            damping[i, i], damping[i, i - 1] = 0.4, 0.1
    if kind == "dampers":
        damping = (damping + damping.T) / 2
    load, start = np.zeros(n), np.linalg.solve(one, np.eye(n)[7])
    load[30] = 1.0
    structure = vv.Structure(
        mass=np.diag(np.tile(mass, 2)), stiffness=stiffness, damping=np.kron(np.eye(2), damping)
    )
    t = 10.0
    run = vv.simulate(
        structure, t, initial=np.column_stack([np.tile(start, 2), np.zeros(2 * n)]).ravel(),
        load=np.tile(load, 2), nu=0.5, times=[t], coordinates=structure.dof_names,
    )  # fmt: skip
    rates = np.block(
        [[np.zeros((n, n)), np.eye(n)], [-one / mass[:, None], -damping / mass[:, None]]]
    )
    wave = np.concatenate([np.zeros(n), load / mass])[:, None] * [[1, 0]]
    turning = np.array([[0, 0.5], [-0.5, 0]])
    grown = expm(t * np.block([[rates, wave], [np.zeros((2, 2 * n)), turning]]))
    right = (grown @ [*start, *np.zeros(n), 0, 1])[: 2 * n].reshape(2, n)
    off = np.abs(run.state[0].reshape(2, n, 2) - right.T).max(axis=(0, 1))
    # Velocities too: a start with small deflections of stiff springs does not excite them.
    assert off.max() < 2e-13


def test_strong_dampers_that_hardly_move_resist_a_start_by_all_digits():
    rng = np.random.default_rng(10)
    for _ in range(10):
        pair = np.array([1.0, -1.0, 0.0])
        damping = 10 ** rng.uniform(3, 6) * np.outer(pair, pair) + np.diag(rng.uniform(0.1, 1, 3))
        start = rng.normal() + 1e-8 * rng.normal(size=3)
        structure = vv.Structure(mass=np.eye(3), stiffness=np.diag([1.0, 2, 3]), damping=damping)
        found = structure._rest.resisting(start)
        with mpmath.workdps(50):
            true = mpmath.matrix(damping) * mpmath.matrix(start)
            assert found == pytest.approx([float(x) for x in true], rel=4e-16)
