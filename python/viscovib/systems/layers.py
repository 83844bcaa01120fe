"""Layers of a structure: stiffness matrices with a kernel, for example of rubber."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.errors import InputError
from viscovib.kernels.relaxation import Kernel, PronyKernel
from viscovib.kernels.sum_kernel import SumKernel
from viscovib.kernels.tabulated import TabulatedKernel
from viscovib.kernels.time_temperature import ThermalKernel
from viscovib.systems.elements import ElementTerms
from viscovib.systems.relaxing_rest import Layer
from viscovib.systems.structure_matrices import dense_of, is_sparse, matrix_of

#: Bounds for layers whose kernel is not a sum of exponentials: number of directions, eigenvalues
#: that count as 0 (relative to the largest), coordinates of a layer in sparse matrices.
_MOST_DIRECTIONS, _RANK, _MOST_TOUCHED = 64, 1e-12, 2000


class Layers(NamedTuple):
    """Layers for the linear subsystem and for the elements."""

    #: Matrices and kernels that are sums of exponentials.
    whole: tuple[tuple[Any, Kernel], ...]
    #: All other layers, as elements along the directions in which they act.
    elements: tuple[ElementTerms, ...]

    @property
    def dense(self) -> list[Layer]:
        """Matrices, weights and rates."""
        return [(dense_of(matrix), *exponentials_of(kernel)) for matrix, kernel in self.whole]

    def added_to(self, stiffness: Any) -> Any:
        """K plus the unrelaxed stiffness of the layers."""
        for matrix, _ in self.whole:
            stiffness = stiffness + matrix
        return stiffness


def checked_layers(layers: Any, n: int, sparse: bool) -> Layers:
    """Check ``layers`` of a structure of n coordinates."""
    whole: list[tuple[Any, Kernel]] = []
    elements: list[ElementTerms] = []
    for i, (matrix, kernel) in enumerate(matrices_of(layers, n, sparse)):
        if not abs(matrix).max() > 0:
            continue
        if exponentials_of(kernel) is not None:
            whole.append((matrix, kernel))
        else:
            elements += _directions(f"layers[{i}]", matrix, kernel)
    return Layers(tuple(whole), tuple(elements))


def matrices_of(layers: Any, n: int, sparse: bool) -> list[tuple[Any, Kernel]]:
    """Return the matrices, in one form, and the kernels of layers."""
    if not isinstance(layers, (list, tuple)):
        raise InputError(f"layers = {_native.shown(layers)}: must be a list of (matrix, kernel)")
    found = []
    for i, layer in enumerate(layers):
        if not (isinstance(layer, (list, tuple)) and len(layer) == 2):
            raise InputError(f"layers[{i}] = {_native.shown(layer)}: must be (matrix, kernel)")
        _native.check_instance(f"layers[{i}][1]", layer[1], Kernel)
        found.append((matrix_of(f"layers[{i}][0]", layer[0], n, sparse), layer[1]))
    return found


def exponentials_of(kernel: Kernel) -> Any:
    """Weights and rates (1/s) of a kernel that is a sum of exponentials; None for other kernels."""
    if isinstance(kernel, SumKernel):
        parts = [exponentials_of(part) for part in kernel.parts]
        if any(part is None for part in parts):
            return None
        return tuple(np.concatenate(column) for column in zip(*parts, strict=True))
    within = kernel.kernel if isinstance(kernel, ThermalKernel) else kernel
    if not isinstance(within, PronyKernel):
        return None
    weights, rates = np.split(np.asarray(kernel._data, dtype=float), 2)
    return weights, rates


def finite_at_first(kernel: Kernel) -> bool:
    """True if R(0) is known to be finite."""
    if isinstance(kernel, SumKernel):
        return all(finite_at_first(part) for part in kernel.parts)
    within = kernel.kernel if isinstance(kernel, ThermalKernel) else kernel
    return isinstance(within, (PronyKernel, TabulatedKernel))


def _directions(name: str, matrix: Any, kernel: Kernel) -> Sequence[ElementTerms]:
    """A layer as springs along its eigenvectors."""
    n = matrix.shape[0]
    touched = np.arange(n)
    if is_sparse(matrix):
        touched = np.flatnonzero(np.diff(matrix.indptr) + np.diff(matrix.tocsr().indptr))
        if touched.size > _MOST_TOUCHED:
            raise InputError(
                f"{name}: touches {touched.size} coordinates with a kernel that is not a sum "
                f"of exponentials, must be at most {_MOST_TOUCHED}; pass "
                "kernel.sum_of_exponentials(t_min=, t_max=)"
            )
        matrix = matrix[np.ix_(touched, touched)]
    dense: FloatArray = dense_of(matrix)
    if np.abs(dense - dense.T).max() > _RANK * np.abs(dense).max():
        raise InputError(
            f"{name}: its matrix must be symmetric with a kernel that is not a sum of exponentials"
        )
    sizes, vectors = np.linalg.eigh(0.5 * (dense + dense.T))
    kept = np.flatnonzero(np.abs(sizes) > _RANK * np.abs(sizes).max())
    if kept.size > _MOST_DIRECTIONS:
        raise InputError(
            f"{name}: acts in {kept.size} directions with a kernel that is not a sum of "
            f"exponentials, must be at most {_MOST_DIRECTIONS}; pass "
            "kernel.sum_of_exponentials(t_min=, t_max=)"
        )
    found = []
    for j in kept:
        e = np.zeros(n)
        e[touched] = vectors[:, j]
        found.append(ElementTerms(e, {1: float(sizes[j])}, 0.0, kernel))
    return found
