"""Loads of motions with memory: sinusoids, and inertia relative to a moving base."""

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.common.parameters import no_frequency
from viscovib.errors import InputError
from viscovib.systems.load import LoadLike, oscillator_series
from viscovib.systems.oscillators import Oscillator
from viscovib.systems.piecewise import derivative


def sinusoids(
    mount: Oscillator, load: LoadLike | None, nu: float | None, base: LoadLike | None
) -> tuple[FloatArray, ComplexArray, ComplexArray, tuple[npt.NDArray[np.int32], ComplexArray]]:
    """Return frequencies, amplitudes of the load, shape (n_dof, m), and of the base.

    The acceleration of the base acts on coordinates relative to it. Last are orders and series as
    given.
    """
    n = len(mount.dof_names)
    if load is None and base is None:
        if nu is not None:
            raise InputError("nu: must not be given without load or base")
        nothing = np.zeros((n, 1), dtype=complex, order="F")
        return np.zeros(1), nothing, nothing[:1], oscillator_series(mount, load, base)[:2]
    given = orders, series = oscillator_series(mount, load, base)[:2]
    apart = orders < 0
    alone = base is None and not apart.any()
    if not alone:
        orders = np.where(apart, -1 - orders, orders)
    frequency = 0.0 if nu is None else _native.number("nu", nu)
    if frequency < 0 or (frequency == 0 and (orders > 0).any() and series.any()):
        raise no_frequency(nu if nu is None else frequency)
    frequencies = np.asarray(orders * frequency, dtype=np.float64)
    if alone:
        return frequencies, np.asfortranarray(series[:n]), np.asfortranarray(series[n:]), given
    amplitudes = np.array(np.where(apart, 0.0, series[:n]), order="F")
    direction = mount._base_direction
    moved = np.where(apart, series[:n], 0.0)
    if direction is not None and series[n].any():
        squares = _squares(frequencies)
        amplitudes += np.outer(mount._mass_matrix @ direction, squares * series[n])
    if apart.any():
        amplitudes += mount._mass_matrix @ (_squares(frequencies) * moved)
    if direction is not None:
        moved += np.outer(direction, series[n])
    space = getattr(mount, "_space", None)
    if space is not None:
        amplitudes -= space[0] @ (1j * frequencies * moved) + space[1] @ moved
    waves = moved if apart.any() else series[n:]
    return frequencies, amplitudes, np.asfortranarray(waves), given


def _squares(frequencies: FloatArray) -> FloatArray:
    """Squares of the frequencies of a moving base, for its acceleration."""
    with np.errstate(over="ignore"):
        squares = frequencies**2
    if not np.isfinite(squares).all():
        raise InputError(f"nu: {frequencies.max():.3g} rad/s of a moving base is beyond all range")
    return squares


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
