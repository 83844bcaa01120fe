"""Factorization of a sparse symmetric pencil K - sigma M, and its modes."""

import math
import os
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.sparse import csc_array, csgraph
from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh, splu

from viscovib._native import FloatArray
from viscovib.errors import InputError

#: Modes per run of Lanczos' method; modes found before are projected out.
_BATCH = 32
#: Largest number of coordinates.
MOST = 1_000_000
#: Largest number of coordinates for modes of dense matrices.
_SMALL = 60
#: Entries of a matrix may differ from those of its transpose by this, relative to the largest.
_SYMMETRIC = 1e-10
#: phi' K phi is a rounding error below this number of units in the last place of phi' |K| phi.
_ROUNDING = 1e3
#: Bytes per entry of the two factors, including indices and workspace.
_ENTRY = 24.0
#: Factors with more entries are computed again to save memory.
_LARGE = 2e7
#: Largest estimated memory of a factorization as a fraction of the free memory.
_SHARE = 0.8


@dataclass
class Modes:
    """Undamped modes: M phi omega^2 = K phi, phi' M phi = 1, by ascending omega^2.

    Attributes
    ----------
    squares : ndarray, shape (m,)
        omega^2 (1/s^2): negative for buckling, exactly 0 for rigid-body modes.
    shapes : ndarray, shape (n, m)
    """

    squares: FloatArray
    shapes: FloatArray


@dataclass
class Pencil:
    """K - sigma M, factored once.

    K and M are symmetric, M is semidefinite (coordinates may have no mass). For a singular K use a
    negative shift sigma: then K - sigma M is positive definite.

    Attributes
    ----------
    mass, stiffness : csc_array, shape (n, n)
    shift : float
        sigma (1/s^2).
    n_below : int or None
        Number of omega^2 below sigma, by Sylvester's law of inertia; None if the factorization had
        to exchange rows, because its signs are then useless.
    """

    mass: Any
    stiffness: Any
    shift: float
    n_below: int | None = field(init=False)
    _factors: Any = field(init=False, repr=False)

    def __post_init__(self) -> None:
        shifted = csc_array(self.stiffness - self.shift * self.mass)
        check_memory(shifted)
        # Diagonal pivots of a symmetric matrix need a third of the time and of the memory.
        self._factors = factored(shifted, symmetric=True)
        if self._factors is None or self._inaccurate(shifted):
            self._factors = factored(shifted, symmetric=False)
        if self._factors is None or self._inaccurate(shifted):
            raise InputError(
                f"stiffness: K - sigma M is singular at sigma = {self.shift:.6g}: a coordinate "
                "has neither mass nor stiffness, or frequency is that of a mode"
            )
        self.n_below = None
        if np.array_equal(self._factors.perm_r, self._factors.perm_c):
            self.n_below = int((self._factors.U.diagonal() < 0).sum())
            if self._factors.nnz > _LARGE:
                # Access to the factors stores a copy of them in the object.
                self._factors = None
                self._factors = factored(shifted, symmetric=True)

    @property
    def n(self) -> int:
        """Coordinates."""
        return int(self.mass.shape[0])

    def solve(self, right: FloatArray) -> FloatArray:
        """(K - sigma M)^-1 right, shape (n,) or (n, k)."""
        return np.asarray(self._factors.solve(right))

    def apply(self, vectors: FloatArray) -> FloatArray:
        """(K - sigma M) vectors."""
        return np.asarray(self.stiffness @ vectors - self.shift * (self.mass @ vectors))

    def _inaccurate(self, shifted: Any) -> bool:
        """True if solutions have errors far above rounding errors, or are not finite."""
        right = shifted @ np.random.default_rng(1).standard_normal(self.n)
        found = self._factors.solve(right)
        if not np.isfinite(found).all():
            return True
        scale = abs(shifted) @ np.abs(found) + np.abs(right)
        with np.errstate(invalid="ignore", divide="ignore"):
            backward = np.nanmax(np.abs(shifted @ found - right) / scale, initial=0.0)
        return bool(backward > 1e-10)

    def lowest_modes(self, above: float, most: int) -> Modes:
        """All modes with omega^2 up to ``above`` (> sigma), and the next one.

        Shift-invert Lanczos (ARPACK) in batches. Known modes are projected out of the next batch,
        so that each mode is found once. ``most``: largest number of modes.
        """
        n_mass = int((self.mass.diagonal() > 0).sum())
        squares, shapes = np.zeros(0), np.zeros((self.n, 0))
        while squares.size < n_mass:
            batch = min(_BATCH, n_mass - squares.size)
            found, vectors = self._next_modes(batch, shapes)
            squares = np.concatenate([squares, found])
            shapes = np.concatenate([shapes, vectors], axis=1)
            reached = squares.max() > above
            if reached and (self.n_below is None or (squares < self.shift).sum() >= self.n_below):
                break
            if squares.size >= most:
                raise InputError(
                    f"frequency: there are more than {most} modes below "
                    f"{math.sqrt(max(above, 0)):.6g} rad/s, must be lower"
                )
        order = np.argsort(squares)
        squares, shapes = squares[order], shapes[:, order]
        for i in np.flatnonzero(np.abs(squares) < 1e-3 * abs(self.shift)):
            squares[i] = self._rayleigh(shapes[:, i])
        return Modes(squares, shapes)

    def lowest_count(self, count: int) -> Modes:
        """The ``count`` lowest modes, or all modes if there are fewer."""
        n_mass = int((self.mass.diagonal() > 0).sum())
        squares, shapes = np.zeros(0), np.zeros((self.n, 0))
        wanted = min(count, n_mass)
        while squares.size < wanted:
            found, vectors = self._next_modes(min(wanted - squares.size + 4, n_mass), shapes)
            squares = np.concatenate([squares, found])
            shapes = np.concatenate([shapes, vectors], axis=1)
        order = np.argsort(squares)[:wanted]
        return Modes(squares[order], shapes[:, order])

    def _rayleigh(self, shape: FloatArray) -> float:
        """Phi' K phi, or 0 if it is a rounding error (a rigid-body mode)."""
        value = float(shape @ (self.stiffness @ shape))
        size = float(np.abs(shape) @ (abs(self.stiffness) @ np.abs(shape)))
        return 0.0 if abs(value) < _ROUNDING * np.finfo(float).eps * size else value

    def _next_modes(self, count: int, known: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The ``count`` modes nearest to sigma, without the ``known`` ones."""
        # Lanczos' method needs more modes than that: compute all modes of small systems.
        if self.n <= _SMALL or (self.mass.diagonal() > 0).sum() - known.shape[1] <= 3 * count:
            return self._all_modes(known)
        weighted = self.mass @ known

        def solve(right: FloatArray) -> FloatArray:
            # Project before and after: M-orthogonal to the known modes in spite of rounding errors.
            found = self.solve(right - weighted @ (known.T @ right))
            return np.asarray(found - known @ (weighted.T @ found))

        start = solve(self.mass @ np.random.default_rng(2).standard_normal(self.n))
        operator = LinearOperator((self.n, self.n), solve, dtype=float)
        try:
            squares, shapes = eigsh(
                self.stiffness, k=count, M=self.mass, sigma=self.shift, OPinv=operator, v0=start,
                ncv=min(self.n, max(2 * count + 1, 20)),
            )  # fmt: skip
        except ArpackError as error:
            raise InputError(f"stiffness: its modes do not converge ({error})") from None
        # Orthogonalize to the known modes and among themselves, for multiple modes.
        shapes = shapes - known @ (weighted.T @ shapes)
        gram = shapes.T @ (self.mass @ shapes)
        factor = np.linalg.cholesky(0.5 * (gram + gram.T))
        return squares, np.linalg.solve(factor, shapes.T).T

    def _all_modes(self, known: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The remaining modes of a system that is too small for Lanczos' method."""
        from scipy.linalg import eigh

        mass = self.mass.toarray()
        shifted = (self.stiffness - self.shift * self.mass).toarray()
        try:
            inverse, vectors = eigh(mass, shifted)
            massive = inverse > 1e-13 * inverse.max()
            squares = self.shift + 1 / inverse[massive]
            shapes = vectors[:, massive] / np.sqrt(inverse[massive])
        except np.linalg.LinAlgError:
            # Modes below the shift: solve the inverse problem without massless coordinates.
            kept = self.mass.diagonal() > 0
            inner = np.linalg.solve(shifted[np.ix_(~kept, ~kept)], shifted[np.ix_(~kept, kept)])
            left = shifted[np.ix_(kept, kept)] - shifted[np.ix_(kept, ~kept)] @ inner
            squares, moved = eigh(left, mass[np.ix_(kept, kept)])
            squares = squares + self.shift
            shapes = np.zeros((self.n, squares.size))
            shapes[kept], shapes[~kept] = moved, -inner @ moved
        order = np.argsort(np.abs(squares - self.shift))[known.shape[1] :]
        return squares[order], shapes[:, order]

    def rounding(self, right: FloatArray) -> float:
        """Relative rounding error of solutions in the norm of strain energy.

        It is the size of a correction with the residual in extended precision.
        """
        found = self.solve(right)
        exact = (self.stiffness - self.shift * self.mass).astype(np.longdouble)
        left = np.asarray(right - exact @ found.astype(np.longdouble), dtype=float)
        lost = np.einsum("ij,ij->j", left, self.solve(left))
        whole = np.einsum("ij,ij->j", right, found)
        # A load and its displacement may both be zero: no error.
        some = whole > 0
        return float(np.sqrt(np.abs(lost[some] / whole[some])).max(initial=0.0))


class HeldPencil:
    """A `Pencil` with some fixed coordinates, the boundary.

    Its inverse is the inverse for the interior. If the basis contains the constraint modes, whose
    residual is 0, this is sufficient for all coordinates.
    """

    def __init__(self, mass: Any, stiffness: Any, shift: float, boundary: Any) -> None:
        self.mass, self.stiffness, self.shift = mass, stiffness, shift
        self.boundary = np.unique(boundary)
        inside = np.ones(mass.shape[0], dtype=bool)
        inside[self.boundary] = False
        self._inside = np.flatnonzero(inside)
        cut = np.ix_(self._inside, self._inside)
        self._pencil = Pencil(csc_array(mass[cut]), csc_array(stiffness[cut]), shift)
        self.n = int(mass.shape[0])

    def solve(self, right: FloatArray) -> FloatArray:
        """Displacements of the interior with a fixed boundary, shape (n, k)."""
        return self._whole(self._pencil.solve(right[self._inside]))

    def apply(self, vectors: FloatArray) -> FloatArray:
        """(K - sigma M) vectors."""
        return np.asarray(self.stiffness @ vectors - self.shift * (self.mass @ vectors))

    def rounding(self, right: FloatArray) -> float:
        """`Pencil.rounding` for unit displacements of the boundary."""
        return self._pencil.rounding(self.apply(self._unit())[self._inside])

    def lowest_modes(self, above: float, most: int) -> Modes:
        """Modes with a fixed boundary."""
        modes = self._pencil.lowest_modes(above, most)
        return Modes(modes.squares, self._whole(modes.shapes))

    def constraint_modes(self) -> FloatArray:
        """Displacements by a unit displacement of each boundary coordinate, shape (n, b)."""
        moved = self._unit()
        return moved - self.solve(self.apply(moved))

    def _unit(self) -> FloatArray:
        moved = np.zeros((self.n, self.boundary.size))
        moved[self.boundary, np.arange(self.boundary.size)] = 1.0
        return moved

    def _whole(self, interior: FloatArray) -> FloatArray:
        whole = np.zeros((self.n, interior.shape[1]))
        whole[self._inside] = interior
        return whole


def checked_sparse(name: str, value: Any, n: int | None = None) -> Any:
    """Return a matrix as a real, finite, square csc_array without stored zeros."""
    if value.dtype.kind == "c":
        raise InputError(f"{name}: must be real, got complex numbers")
    if value.dtype.kind not in "iufb":
        raise InputError(f"{name}: must be numbers, got {value.dtype}")
    if len(value.shape) != 2:
        raise InputError(f"{name}: must have 2 dimensions, got shape {value.shape}")
    # Check before the conversion to columns, which needs memory for each column.
    rows, columns = value.shape
    size = rows if n is None else n
    if (rows, columns) != (size, size):
        wanted = "square" if n is None else f"({n}, {n}) as mass is"
        raise InputError(f"{name}: must be {wanted}, got shape ({rows}, {columns})")
    if rows > MOST:
        raise InputError(f"{name}: {rows} coordinates, must be 1 to {MOST}")
    matrix = csc_array(value).astype(float, copy=True)
    matrix.sum_duplicates()
    if not np.isfinite(matrix.data).all():
        bad = matrix.tocoo()
        at = int(np.flatnonzero(~np.isfinite(bad.data))[0])
        i, j = (int(axis[at]) for axis in bad.coords)
        raise InputError(f"{name}[{i}, {j}] = {bad.data[at]}: must be a finite number")
    matrix.eliminate_zeros()
    return matrix


def is_symmetric(matrix: Any) -> bool:
    """True if a sparse matrix is symmetric up to rounding errors."""
    difference = abs(matrix - matrix.T)
    largest = abs(matrix).max() if matrix.nnz else 0.0
    return bool(difference.nnz == 0 or difference.max() <= _SYMMETRIC * largest)


def check_mass(mass: Any) -> None:
    """Refuse a mass that is not symmetric, or couples a coordinate without mass to others."""
    diagonal = mass.diagonal()
    if not is_symmetric(mass):
        raise InputError("mass: must be symmetric")
    if not diagonal.any():
        raise InputError("mass: must not be 0 everywhere")
    massless = np.flatnonzero(diagonal == 0)
    filled = np.diff(mass.indptr)[massless] > 0
    if filled.any():
        i = int(massless[filled][0])
        raise InputError(
            f"mass: row {i} has 0 on its diagonal and other entries, must be positive semidefinite"
        )


def estimated_fill(matrix: Any) -> float:
    """Estimated number of entries in the factors of a symmetric sparse matrix.

    A breadth-first search from an outer coordinate gives levels. A mean level of S coordinates
    separates the model. Stored as a band, L has about n S entries; by nested dissection
    S^2 log2 n (George and Liu 1981, chapter 8). Minimum degree lies between: the geometric mean
    is within a factor of 2 for the plates and blocks of `tests/python/test_sparse.py`.
    """
    n = matrix.shape[0]
    linked = csc_array((np.ones(matrix.nnz), matrix.indices, matrix.indptr), shape=matrix.shape)
    _, part = csgraph.connected_components(linked, directed=False)
    first = int(np.argmax(part == np.bincount(part).argmax()))
    away = csgraph.dijkstra(linked, directed=False, indices=first, unweighted=True)
    # Repeat from the most distant coordinate, which lies at the boundary of the model.
    first = int(np.where(np.isfinite(away), away, -1).argmax())
    away = csgraph.dijkstra(linked, directed=False, indices=first, unweighted=True)
    reached = away[np.isfinite(away)]
    depth = reached.max() + 1
    level = max(1.0, reached.size / depth)
    band, dissected = 1.3 * n * level, level**2 * math.log2(max(n, 2))
    return float(matrix.nnz + 2 * (band if depth > level else math.sqrt(band * dissected)))


def check_memory(matrix: Any) -> None:
    """Refuse a factorization that would not fit into memory."""
    needed = _ENTRY * estimated_fill(matrix)
    free = free_memory()
    if needed > _SHARE * free:
        raise InputError(
            f"mass: {matrix.shape[0]} coordinates with {matrix.nnz} entries need about "
            f"{needed / 1e9:.3g} GB to factor, of which {free / 1e9:.3g} GB are free"
        )


def free_memory() -> float:
    """Available memory (bytes): free memory of the machine, or the limit of the process."""
    import resource

    try:
        with open("/proc/meminfo", encoding="ascii") as file:
            lines = dict(line.split(":", 1) for line in file)
        free = 1024.0 * float(lines["MemAvailable"].split()[0])
    except (OSError, KeyError, ValueError):
        free = float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    soft, _ = resource.getrlimit(resource.RLIMIT_DATA)
    return free if soft == resource.RLIM_INFINITY else min(free, float(soft))


def factored(matrix: Any, *, symmetric: bool) -> Any:
    """Return the factors of a sparse matrix, None if it is singular.

    ``symmetric``: pivots stay on the diagonal.
    """
    try:
        if symmetric:
            return splu(
                matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )  # fmt: skip
        return splu(matrix)
    except RuntimeError:
        # Exactly singular.
        return None
    except MemoryError:
        raise InputError(
            f"mass: {matrix.shape[0]} coordinates: the factorization of the stiffness does not "
            "fit into memory"
        ) from None
