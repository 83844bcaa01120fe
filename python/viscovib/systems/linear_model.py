"""Linear models in matrices: D(s) = sum_i c_i(s) A_i, with memory and every kind of damping."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from viscovib._native import ComplexArray, FloatArray
from viscovib.kernels.relaxation import Kernel

if TYPE_CHECKING:
    from viscovib.systems.sparse_pencil import Modes


class LinearModel(NamedTuple):
    """K, M, C and hereditary stiffnesses of a linear model, dense or sparse.

    D(s) = M s^2 + C s + (K + sum_j K_j) (1 + b s + i eta) + a s M - sum_j K_j R_j(s) + C_r s
    + sum_j C_j s (1 - R_j(s)).

    Attributes
    ----------
    mass, stiffness : array or sparse array, shape (n, n)
    damping : array or sparse array, or None
        C.
    rayleigh : (float, float)
        a and b: a M + b K is added to C.
    ratio : float or sequence of float
        Damping ratios of the modes that the reduction finds; the last value of a sequence applies
        to all higher modes. Modes that are not computed have no ratio: above the last computed
        mode C_r is b K with b = 2 ratio/omega of this mode.
    loss : float
        eta, loss factor of K: for periodic motions, s = i omega, omega > 0.
    layers : sequence of (array, Kernel)
        K_j with their kernels. ``stiffness`` does not contain them.
    dampers : sequence of (array, Kernel)
        C_j with their kernels: linear forces of rates with memory.
    """

    mass: Any
    stiffness: Any
    damping: Any = None
    rayleigh: tuple[float, float] = (0.0, 0.0)
    ratio: float | Sequence[float] = 0.0
    loss: float = 0.0
    layers: Sequence[tuple[Any, Kernel]] = ()
    dampers: Sequence[tuple[Any, Kernel]] = ()

    @property
    def at_rest(self) -> Any:
        """K plus the layers without relaxation: the instantaneous stiffness."""
        total = self.stiffness
        for layer, _ in self.layers:
            total = total + layer
        return total

    @property
    def matrices(self) -> list[Any]:
        """A_i: M, K, C if there is one, the layers and the dampers."""
        damping = [] if self.damping is None else [self.damping]
        relaxing = (matrix for matrix, _ in (*self.layers, *self.dampers))
        return [self.mass, self.stiffness, *damping, *relaxing]

    def coefficients(self, s: ComplexArray) -> ComplexArray:
        """Values c_i(s), shape (number of matrices,) + s.shape, without modal ratios."""
        s = np.asarray(s, dtype=complex)
        a, b = self.rayleigh
        damped = b * s + 1j * self.loss * np.sign(s.imag)
        total = [s**2 + a * s, 1 + damped]
        if self.damping is not None:
            total.append(s)
        total += [1 + damped - np.asarray(kernel.laplace(s)) for _, kernel in self.layers]
        total += [s * (1 - np.asarray(kernel.laplace(s))) for _, kernel in self.dampers]
        return np.asarray(total)

    def ratios(self, count: int) -> FloatArray:
        """Ratios of ``count`` modes."""
        given = np.atleast_1d(np.asarray(self.ratio, dtype=float))
        return np.concatenate([given[:count], np.full(max(0, count - given.size), given[-1])])


class ModalDampingMatrix:
    """C + b K + M Phi (2 zeta omega - b omega^2) Phi' M, b = 2 zeta/omega of the highest mode.

    The full matrix with the given ratios in the modes Phi.
    """

    def __init__(self, model: LinearModel, modes: Modes) -> None:
        self._model = model
        rates, self._slope = modal_rates(model, modes.squares)
        self._rates = rates - self._slope * modes.squares
        self._weighted = np.asarray(model.mass @ modes.shapes)

    @property
    def T(self) -> ModalDampingMatrix:  # noqa: N802
        """The transpose; the matrix is symmetric."""
        return self

    def __matmul__(self, vectors: FloatArray) -> FloatArray:
        model = self._model
        seen = self._rates[:, np.newaxis] * (self._weighted.T @ vectors)
        total = self._slope * (model.at_rest @ vectors) + self._weighted @ seen
        return np.asarray(total if model.damping is None else total + model.damping @ vectors)


def modal_rates(model: LinearModel, squares: FloatArray) -> tuple[FloatArray, float]:
    """2 zeta omega of the modes, and b for all higher modes."""
    omega, ratios = np.sqrt(np.abs(squares)), model.ratios(squares.size)
    return 2 * ratios * omega, float(2 * ratios[-1] / omega.max())


def damping_and_layers(model: LinearModel, found: Any) -> tuple[FloatArray, list[FloatArray]]:
    """Return the damping matrix in the coordinates of a `Reduction`, and those of the layers."""
    damping, layers = np.diag(found.rates), list(found.matrices)
    if model.damping is not None:
        damping = damping + layers.pop(0)
    return damping, layers


def with_ratios(model: LinearModel, modes: Modes) -> LinearModel:
    """Return a model whose damping matrix contains the modal ratios."""
    if not np.any(model.ratio):
        return model
    return model._replace(damping=ModalDampingMatrix(model, modes), ratio=0.0)
