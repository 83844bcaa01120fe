"""A clamped beam with a cubic spring at its tip, against motions and folds of another program."""

import json
from pathlib import Path

import numpy as np
import pytest
import viscovib as vv
from viscovib._native import FloatArray

DATA = Path(__file__).parents[2] / "data" / "structures" / "beam_cubic_reference.json"
REFERENCE = json.loads(DATA.read_text())


def beam_matrices(
    elements: int, length: float, side: float, young: float, density: float
) -> tuple[FloatArray, FloatArray]:
    """Mass and stiffness of a clamped Euler-Bernoulli beam: deflections and rotations alternate."""
    h, area, inertia = length / elements, side**2, side**4 / 12
    n = 2 * (elements + 1)
    mass, stiffness = np.zeros((n, n)), np.zeros((n, n))
    k = np.array([[12, 6 * h, -12, 6 * h], [0, 4 * h * h, -6 * h, 2 * h * h],
                  [0, 0, 12, -6 * h], [0, 0, 0, 4 * h * h]])  # fmt: skip
    m = np.array([[156, 22 * h, 54, -13 * h], [0, 4 * h * h, 13 * h, -3 * h * h],
                  [0, 0, 156, -22 * h], [0, 0, 0, 4 * h * h]])  # fmt: skip
    for i in range(elements):
        part = slice(2 * i, 2 * i + 4)
        stiffness[part, part] += young * inertia / h**3 * (k + np.triu(k, 1).T)
        mass[part, part] += density * area * h / 420 * (m + np.triu(m, 1).T)
    return mass, stiffness


@pytest.fixture(scope="module")
def beam() -> vv.Structure:
    mass, stiffness = (m[2:, 2:] for m in beam_matrices(20, 0.7, 0.014, 2.05e11, 7800))
    names = [f"{kind}{i}" for i in range(1, 21) for kind in ("w", "r")]
    return vv.Structure(
        mass=mass, stiffness=stiffness, names=names, modal_damping=0.01,
        elements=[vv.Spring(on="w20", law="6e9*d^3")],
    )  # fmt: skip


def test_folds_and_motions(beam: vv.Structure) -> None:
    hz = np.array([motion["hz"] for motion in REFERENCE["motions"]])
    b = vv.trace_response(
        beam, (15 * 2 * np.pi, 50 * 2 * np.pi), load={"w20": 1.0}, at=2 * np.pi * np.unique(hz),
        stability=False,
    )  # fmt: skip
    assert np.abs(np.sort(b.folds) / REFERENCE["folds"] - 1).max() < 1e-9
    assert b.stops.size == 6
    tip = np.abs(b.at(["w20"]).coefficients[b.stops, 0])
    for motion in REFERENCE["motions"]:
        same = np.abs(b.nu[b.stops] / (2 * np.pi) - motion["hz"]) < 1e-9
        expected = np.array([motion["tip1"], motion["tip3"], motion["tip5"]])
        error = np.abs(tip[same, :3] - expected).max(axis=1) / expected[0]
        assert error.min() < 1e-9


def test_plan_says_what_was_condensed(beam: vv.Structure) -> None:
    plan = vv.plan_response(beam, [200.0], load={"w20": 1.0}, method="newton")
    assert "40 coordinates condensed to 1 deflection by 40 real modes" in plan["computes"]


@pytest.mark.parametrize("elements", [1, 2, 4, 7])
def test_base_motion_with_a_consistent_mass(elements: int) -> None:
    """With the load -M_fs a: rows of the free coordinates of the full beam by NumPy."""
    rng = np.random.default_rng(elements)
    mass, stiffness = beam_matrices(elements, rng.uniform(0.3, 2), 0.01, 2.1e11, 7800)
    mass[-2, -2] += rng.uniform(0, 0.5)
    up = np.tile([1.0, 0.0], elements)
    eta, y = 0.02, 1e-3
    whole = stiffness * (1 + 1j * eta)
    rod = vv.Structure(
        mass=mass[2:, 2:], stiffness=stiffness[2:, 2:], loss_factor=eta, base_direction=up
    )
    nu_1 = np.sqrt(np.linalg.eigvals(np.linalg.solve(mass[2:, 2:], stiffness[2:, 2:])).real.min())
    for nu in nu_1 * rng.uniform(0.3, 4, 4):
        dynamic = whole - nu**2 * mass
        true = np.abs(np.linalg.solve(dynamic[2:, 2:], -dynamic[2:, 0] * y))
        load = nu**2 * mass[2:, 0] * y
        found = vv.forced_response(rod, [nu], base=y, load=load, method="linear")
        got = np.abs(found.coefficients[0, :, 0])
        np.testing.assert_allclose(got, true, rtol=1e-8, atol=1e-9 * true.max())
