"""Loads in time by the inertia of what is relative to a moving base."""

import numpy as np

from viscovib._native import FloatArray
from viscovib.systems.oscillators import Oscillator
from viscovib.systems.piecewise import derivative


def inertia_of(mount: Oscillator, times: FloatArray, moved: FloatArray) -> FloatArray:
    """Loads of a base with displacements of the coordinates by polynomials (n, n_powers, m).

    -M y'' - C_s y' - K_s y in relative coordinates. If K_s is not 0, infinite pieces before and
    after the table are added, shape (n, n_powers, m + 2).
    """
    moved = moved.copy()
    held = moved[:, -1].copy()
    moved[:, :, -1] = 0.0
    rate = derivative(moved)

    def forces(matrix: FloatArray, pieces: FloatArray) -> FloatArray:
        return np.asfortranarray(np.einsum("nk,kpm->npm", matrix, pieces))

    load = -forces(mount._mass_matrix, derivative(rate))
    space = getattr(mount, "_space", None)
    if space is None:
        return load
    damping, stiffness = space
    load -= forces(damping, rate) + forces(stiffness, moved)
    ever = np.zeros((*load.shape[:2], times.size + 2), order="F")
    ever[:, :, 1:-2] = load[:, :, :-1]
    ever[:, -1, 0] = -stiffness @ held[:, 0]
    ever[:, -1, -2] = -stiffness @ held[:, -1]
    return ever if stiffness.any() else load
