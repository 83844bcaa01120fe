"""Products of a matrix far beyond the digits of double precision, at the speed of BLAS.

Numbers are cut into slices with few bits, so that products of slices are sums of integers that are
exact in double precision. Cancellation of terms then loses no digits (Ozaki, Ogita, Oishi and Rump,
Numerical Algorithms 59 (2012) 95).
"""

import math
from typing import Any

import numpy as np

from viscovib._native import FloatArray

#: Bits of a number; fraction of nonzero entries up to which a matrix is stored as sparse.
_BITS, _SPARSE = 53, 0.1


class Sliced:
    """A real matrix (n, n), sliced for products.

    Errors of a product are about 2^-bits of the largest entries of its row and column.
    """

    def __init__(self, matrix: FloatArray, bits: float) -> None:
        room = math.ceil(math.log2(max(matrix.shape[1], 2)))
        self.width = (_BITS - room) // 2
        self.depth = math.ceil((bits + room) / self.width)
        rows, columns = np.nonzero(matrix)
        self.diagonal = None
        if (rows == columns).all():
            self.diagonal = matrix.diagonal().astype(np.longdouble)[:, np.newaxis]
            return
        self.slices: list[Any] = _cut(matrix, 1, self.width, self.depth)
        if rows.size < _SPARSE * matrix.size:
            from scipy.sparse import csr_array

            self.slices = [csr_array(part) for part in self.slices]

    def times(self, x: FloatArray) -> Any:
        """Product with columns (n, m), in extended precision."""
        if self.diagonal is not None:
            return self.diagonal * x
        others = _cut(x, 0, self.width, self.depth)
        total = np.zeros(x.shape, dtype=np.longdouble)
        # By decreasing size: large terms cancel before smaller terms are added.
        for level in range(self.depth):
            for i, part in enumerate(self.slices[: level + 1]):
                if level - i < len(others):
                    total += part @ others[level - i]
        return total


def _cut(matrix: FloatArray, axis: int, width: int, most: int) -> list[FloatArray]:
    """Slices that add up to a matrix; each has ``width`` bits relative to its row or column."""
    left, found = matrix, []
    for _ in range(most):
        largest = np.abs(left).max(axis=axis, keepdims=True, initial=0.0)
        if not largest.any():
            break
        # Adding and subtracting a large number rounds to ``width`` bits.
        large = np.ldexp(1.5, np.frexp(largest)[1] + (_BITS - 1 - width))
        found.append((left + large) - large)
        left = left - found[-1]
    return found
