"""Modal damping with dampers that couple the modes, against explicit matrices."""

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp
from scipy.linalg import eigh
from scipy.sparse import csc_array


def drawn(case):
    """A random chain with a damper and a cubic spring at one coordinate, and its matrices."""
    rng = np.random.default_rng([3, case])
    n = int(rng.integers(2, 8))
    links = rng.uniform(0.3, 2, n - 1)
    stiffness = np.diag(rng.uniform(0.5, 2, n))
    for i, k in enumerate(links):
        stiffness[i : i + 2, i : i + 2] += k * np.array([[1, -1], [-1, 1]])
    mass = np.diag(rng.uniform(0.5, 2, n))
    ratio = rng.uniform(0.01, 0.1, n) if case % 2 else rng.uniform(0.01, 0.1)
    rayleigh = tuple(rng.uniform(0, 0.05, 2)) if case % 3 == 0 else None
    turning = rng.normal(size=(n, n)) * 0.02 * (case % 5 == 0)
    turning -= turning.T
    at, c, k, k3 = int(rng.integers(n)), *rng.uniform(0.1, 0.5, 3)
    laws = ({"law": f"{c:.17e}*v + {k3:.17e}*d^3"}, {"law": f"{k3:.17e}*d^3", "damping": c})
    damper = vv.Spring(on=f"x{at + 1}", stiffness=k, **laws[case % 2])
    structure = vv.Structure(
        mass=mass, stiffness=stiffness, damping=turning, modal_damping=ratio, rayleigh=rayleigh,
        elements=[damper],
    )  # fmt: skip
    whole = stiffness + k * np.outer(np.arange(n) == at, np.arange(n) == at)
    squares, shapes = eigh(whole, mass)
    damping = turning + mass @ shapes @ np.diag(2 * ratio * squares**0.5) @ shapes.T @ mass
    damping[at, at] += c
    if rayleigh is not None:
        damping += rayleigh[0] * mass + rayleigh[1] * whole
    return structure, mass, damping, whole, at, k3, rng.uniform(0.5, 2.5), rng.uniform(0.1, 0.6)


@pytest.mark.parametrize("case", range(6))
def test_steady_motions_and_motions_in_time(case):
    structure, mass, damping, stiffness, at, k3, nu, load = drawn(case)
    n = len(mass)
    response = vv.forced_response(structure, [nu], load={"x1": load}, method="newton", harmonics=15)
    orders, found = response.harmonics, response.coefficients[0]
    theta = 2 * np.pi * np.arange(512) / 512
    waves = np.exp(1j * np.outer(orders, theta))
    force = np.zeros((n, orders.size), dtype=complex)
    force[at] = 2j * (k3 * (found[at] @ waves).imag ** 3 @ waves.conj().T) / 512
    force[0] -= load * (orders == 1)
    s = 1j * orders * nu
    left = mass @ found * s**2 + damping @ found * s + stiffness @ found + force
    assert np.abs(left).max() < 1e-11 * load

    def rates(t, y):
        push = -stiffness @ y[:n] - damping @ y[n:]
        push[at] -= k3 * y[at] ** 3
        push[0] += load * np.sin(nu * t)
        return np.concatenate([y[n:], push / np.diag(mass)])

    run = vv.simulate(structure, 10, load={"x1": load}, nu=nu, rtol=1e-9, times=[5.0, 10.0])
    true = solve_ivp(rates, (0, 10), np.zeros(2 * n), method="DOP853", rtol=1e-11, atol=1e-13)
    assert run.state[-1, : 2 * n : 2] == pytest.approx(true.y[:n, -1], abs=1e-8)


@pytest.mark.parametrize("case", range(3))
def test_reduced_structures_damp_each_mode_once(case):
    """Against all modes of the full matrices, and by the full equations of ``check``.

    Omitted modes have a damping proportional to K, with an error of about 1e-5.
    """
    rng = np.random.default_rng([5, case])
    n, ratio, c = 160, rng.uniform(0.01, 0.05), rng.uniform(0.05, 0.3) * (case % 3 != 0)
    stiffness = n * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    layer, rubber = np.zeros((n, n)), vv.PronyKernel(weights=[0.5], rates=[2.0])
    soft = slice(40, 70)
    layer[soft, soft] = 0.5 * stiffness[soft, soft]
    layers = [(csc_array(layer), rubber)] if case % 2 else []
    structure = vv.Structure(
        mass=csc_array(np.eye(n) / n), stiffness=csc_array(stiffness), layers=layers,
        modal_damping=ratio, elements=[vv.Spring(on="x110", damping=c, law="0.5*d^3")],
    )  # fmt: skip
    small = structure.reduce(frequency=60, tolerance=1e-6, loads=["x60"])
    nu = np.sort(rng.uniform(2, 8, 2))
    found = vv.forced_response(
        small, nu, load={"x60": 0.1}, coordinates=["x60", "x110"], method="newton", harmonics=5
    )
    assert found.check(points=2).max() < 1e-9
    whole = stiffness + layer if layers else stiffness
    squares, shapes = eigh(whole, np.eye(n) / n)
    damping = shapes @ np.diag(2 * ratio * squares**0.5) @ shapes.T / n**2
    damping[109, 109] += c
    for i, one in enumerate(nu):
        x = found.coefficients[i, :, 0]
        theta = 2 * np.pi * np.arange(64) / 64
        waves = np.exp(1j * np.outer(found.harmonics, theta))
        push = np.zeros(n, dtype=complex)
        push[59] = 0.1
        push[109] = -2j * np.mean(0.5 * (found.coefficients[i, 1] @ waves).imag ** 3 / waves[0])
        lost = layer * rubber.transform(one) if layers else 0.0
        true = np.linalg.solve(whole - lost - one**2 * np.eye(n) / n + 1j * one * damping, push)
        assert np.abs(true[[59, 109]] - x).max() < 1e-3 * np.abs(x).max()


def test_what_has_no_modes_to_damp_is_reported():
    chain = {"mass": [1, 2], "elements": [vv.Spring(on="x1", damping=0.1, law="d^3")]}
    for text, options in (
        ("loss_factor: .* must be 0 with other dampers", {"loss_factor": 0.1}),
        ("modal_damping: needs a symmetric stiffness", {"modal_damping": 0.1}),
    ):
        off = -1 if "loss_factor" in options else -0.5
        structure = vv.Structure(stiffness=[[2, -1], [off, 2]], **chain, **options)
        with pytest.raises(vv.InputError, match=text):
            vv.forced_response(structure, [1.0], load=0.1, method="newton")
