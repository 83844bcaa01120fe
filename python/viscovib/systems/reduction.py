"""Reduction of a sparse linear model to modes and static corrections, with an error estimate.

The model is D(s) u = p, D(s) = sum_i c_i(s) A_i (`LinearModel`). A basis V (n, m) of real vectors
gives u = V q, (V' D V) q = V' p. The full equations have the residual

    rho = p - D(s) V q,   V' rho = 0,   error = u - V q = D(s)^-1 rho.                          (1)

V contains all modes up to a frequency above the highest frequency of interest, so the error
consists of higher modes. For these D^-1 rho = A rho to within the factor
(omega_c^2 - sigma) / (omega_c^2 - |s|^2), with A = (K - sigma M)^-1 and omega_c the lowest omitted
frequency. So one factorization gives the error in the norm of strain energy,
|e|^2 = rho' A rho, and the vectors A rho that are missing in V. They are added until the error is
small (a Krylov space of A M, C and the like; residual flexibility of every order; MacNeal 1971,
Craig and Kurdila 2006, chapter 17). Reduced matrices are as symmetric as the full ones, so the
reduced model generates no energy. Its additional high modes represent the static part.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import eigh
from scipy.sparse import csc_array

from viscovib._native import ComplexArray, FloatArray
from viscovib.errors import InputError
from viscovib.systems.linear_model import LinearModel, modal_rates, with_ratios
from viscovib.systems.sparse_pencil import HeldPencil, Modes, Pencil

#: Modes are kept up to this multiple of the highest frequency of interest.
_MARGIN = 1.5
#: Number of frequencies for the error estimate, and for new vectors.
_CHECKED, _SOUGHT = 50, 6
#: The shift is minus the square of this fraction of the highest frequency of interest.
_SHIFT = 0.1
#: Rounds of new vectors before the number of modes is increased, and number of increases.
_ROUNDS, _WIDER = 12, 3
#: A residual lies in the space of the solved residuals up to this relative part.
_SAME = 0.02
#: Largest number of complex columns of full length in memory.
_COLUMNS = 24
#: A vector lies in the span of V if its relative remainder is below this.
_HELD = 1e-9
#: Smallest relative square of a combination of vectors that is not a rounding error.
_ALIKE = 1e-13
#: A mode has no mass if phi' M phi / phi' (K - sigma M) phi, relative to the largest, is below it.
_MASSLESS = 1e-14
_TINY = np.finfo(float).tiny


@dataclass
class Reduction:
    """A reduced model, u = shapes q + static x, with its error.

    Attributes
    ----------
    squares : ndarray, shape (m,)
        omega^2 of the reduced modes (1/s^2), ascending; the first ``n_modes`` are modes of the
        full model.
    shapes : ndarray, shape (n, m)
        Mode shapes, shapes' M shapes = 1. The columns after ``n_modes`` are pseudo-modes: they
        represent the static part of the omitted modes.
    static : ndarray, shape (n, k)
        Massless part without delay: u = static static' p.
    rates : ndarray, shape (m,)
        Damping by ``rayleigh`` and ``ratio`` (1/s): q'' + rates q' + squares q = shapes' p.
    n_modes : int
        Number of modes of the full model.
    n_rigid, n_negative : int
        Numbers of its rigid-body modes and of its modes with omega^2 < 0.
    matrices : list of ndarray
        shapes' A shapes of damping and layers, in the order of the model's.
    at : ndarray, shape (50,)
        Frequencies (rad/s) at which the error was estimated.
    error : ndarray, shape (50,)
        Relative error of the displacements in the norm of strain energy, the largest over all
        loads, estimated from the residual of the full equations; includes the rounding error.
    """

    squares: FloatArray
    shapes: FloatArray
    static: FloatArray
    rates: FloatArray
    n_modes: int
    n_rigid: int
    n_negative: int
    matrices: list[FloatArray]
    at: FloatArray
    error: FloatArray

    @property
    def largest_error(self) -> float:
        """The largest error of all frequencies."""
        return float(self.error.max())


class _Basis:
    """V with A_i V and the reduced matrices V' A_i V, extended column by column."""

    def __init__(self, model: LinearModel, pencil: Any) -> None:
        self.model, self.pencil = model, pencil
        n = pencil.n
        self.vectors = np.zeros((n, 0))
        self.pushed = [np.zeros((n, 0)) for _ in model.matrices]
        self.reduced = [np.zeros((0, 0)) for _ in model.matrices]

    def add(self, new: FloatArray) -> None:
        """Add vectors, orthonormalized by K - sigma M; parts in the span of V are dropped."""
        if not new.shape[1]:
            return
        weights = np.sqrt(np.abs(_products(new, self.pencil.apply(new))))
        new = new / np.where(weights > 0, weights, 1.0)
        for _ in range(2):
            new = self._freed(new)
        values, mix = np.linalg.eigh(new.T @ self.pencil.apply(new))
        # The remainder of a vector in the span of V is a rounding error, so it is not added.
        kept = np.abs(values) > max(_HELD**2, _ALIKE * np.abs(values).max())
        new = self._freed(new @ (mix[:, kept] / np.sqrt(np.abs(values[kept]))))
        mass, *others = self.model.matrices
        pushed = [np.asarray(mass @ new), *(_image(matrix, new) for matrix in others)]
        v = self.vectors
        for i, image in enumerate(pushed):
            right = v.T @ image
            left = new.T @ self.pushed[i]
            self.reduced[i] = np.block([[self.reduced[i], right], [left, new.T @ image]])
            self.pushed[i] = np.concatenate([self.pushed[i], image], axis=1)
        self.vectors = np.concatenate([v, new], axis=1)

    def _freed(self, new: FloatArray) -> FloatArray:
        """Remove the components along V from vectors."""
        held = self._sum([matrix.T @ new for matrix in self.pushed])
        return np.asarray(new - self.vectors @ held)

    def _sum(self, parts: list[FloatArray]) -> FloatArray:
        """K - sigma M from matrices in the order of the model's."""
        total = -self.pencil.shift * parts[0]
        for i, part in enumerate(parts):
            if i != 0 and not self._is_damping(i):
                total = total + part
        return np.asarray(total)

    def matrix(self, s: ComplexArray) -> ComplexArray:
        """V' D(s) V, shape s.shape + (m, m)."""
        coefficients = self.model.coefficients(s)
        return np.asarray(np.einsum("i...,iab->...ab", coefficients, np.array(self.reduced)))

    def shifted(self) -> FloatArray:
        """V' (K - sigma M) V, near unity."""
        total = self._sum(self.reduced)
        return np.asarray(0.5 * (total + total.T))

    def modes(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """omega^2, the modes in V, and the massless part of V."""
        sigma, shifted = self.pencil.shift, self.shifted()
        mass = 0.5 * (self.reduced[0] + self.reduced[0].T)
        try:
            inverse, mix = eigh(mass, shifted)
        except np.linalg.LinAlgError:
            # Not definite: some omega^2 is below the shift. Then the mass must be definite.
            squares, mix = eigh(shifted + sigma * mass, mass)
            return squares, mix, np.zeros((mix.shape[0], 0))
        if inverse[0] < -1e-9 * abs(inverse[-1]):
            raise InputError("mass: must be positive semidefinite")
        massive = inverse > _MASSLESS * inverse[-1]
        squares = sigma + 1 / inverse[massive]
        shapes = mix[:, massive] / np.sqrt(inverse[massive])
        return squares[::-1], shapes[:, ::-1], mix[:, ~massive]

    def _is_damping(self, i: int) -> bool:
        return self.model.damping is not None and i == 2


def reduce_model(
    model: LinearModel,
    loads: FloatArray,
    *,
    frequency: float,
    tolerance: float = 1e-6,
    lowest: float = 0.0,
    most: int = 1000,
    boundary: Sequence[int] | None = None,
) -> Reduction:
    """Reduce a sparse model to the modes up to a frequency and the necessary static corrections.

    Parameters
    ----------
    model : LinearModel
        Symmetric except for the damping. Coordinates may have no mass.
    loads : ndarray, shape (n, r)
        All directions of elements, loads and required motions.
    frequency : float
        Highest circular frequency of interest (rad/s).
    tolerance : float
        Largest error, see `Reduction.error`.
    lowest : float
        Lowest circular frequency (rad/s); above 0 for a free structure.
    most : int
        Largest number of vectors.
    boundary : sequence of int, optional
        Coordinates that are fixed for the modes (Craig and Bampton 1968): coordinates of elements,
        which remain in the reduced model. None: modes of the whole structure.
    """
    top = float(frequency)
    pencil: Any
    shift = -((_SHIFT * top) ** 2)
    if boundary is not None and not np.delete(model.mass.diagonal(), boundary).any():
        # No mass remains between the fixed coordinates: all modes span the same space.
        boundary = None
    if boundary is None:
        pencil = Pencil(model.mass, model.at_rest, shift)
    else:
        pencil = HeldPencil(model.mass, model.at_rest, shift, np.asarray(boundary))
    loads = np.asarray(loads, dtype=float)
    loads = loads / np.where(np.abs(loads).max(axis=0) > 0, np.abs(loads).max(axis=0), 1.0)
    margin = _MARGIN
    for _ in range(_WIDER):
        found = pencil.lowest_modes((margin * top) ** 2, most)
        assessed = model if boundary is not None else with_ratios(model, found)
        basis = _Basis(assessed, pencil)
        if boundary is not None:
            basis.add(pencil.constraint_modes())
        basis.add(_massless(model, loads))
        basis.add(found.shapes)
        above = max(float(found.squares.max()), (margin * top) ** 2)
        estimate = _Estimate(basis, loads, found, above)
        estimate.rounding = pencil.rounding(loads)
        if _enriched(estimate, lowest, top, tolerance, most):
            return _finished(estimate, model, found.squares.size, boundary is not None)
        margin *= 1.5
    raise InputError(
        f"tolerance = {tolerance:g}: the reduction does not reach it with {basis.vectors.shape[1]} "
        f"vectors (error {estimate.worst:.2g}), must be larger"
    )


def _enriched(
    estimate: "_Estimate", lowest: float, top: float, tolerance: float, most: int
) -> bool:
    """Add vectors until the error is small at all frequencies; return True if this succeeds."""
    basis = estimate.basis
    sought, everywhere = _spread(lowest, top, _SOUGHT), _spread(lowest, top, _CHECKED)
    previous = np.inf
    for round_ in range(_ROUNDS):
        errors, vectors = estimate.at(sought)
        worst = float(errors.max())
        stalled = worst > 0.9 * previous and round_ > 2
        last = stalled or basis.vectors.shape[1] + vectors.shape[1] > most
        # The error may be larger between the frequencies: use a margin except in the last round.
        if worst <= (1.0 if last else 0.5) * tolerance:
            errors, vectors = estimate.at(everywhere)
            if errors.max() <= tolerance:
                estimate.frequencies, estimate.errors = everywhere, errors
                return True
            sought = np.unique(np.append(sought, everywhere[np.argmax(errors)]))
            last = stalled or basis.vectors.shape[1] + vectors.shape[1] > most
        estimate.worst = float(errors.max())
        if last:
            break
        previous = worst
        basis.add(vectors)
    return False


class _Estimate:
    """Errors of a basis from residuals of the full equations."""

    frequencies: FloatArray
    errors: FloatArray
    worst: float
    rounding: float = 0.0

    def __init__(self, basis: _Basis, loads: FloatArray, found: Modes, above: float) -> None:
        self.basis, self.loads, self.found, self.above = basis, loads, found, above

    def at(self, frequencies: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Relative errors, shape (k,), and vectors A W; W spans the residuals."""
        basis, loads = self.basis, self.loads
        pencil = basis.pencil
        r = loads.shape[1]
        met, solved = np.zeros((pencil.n, 0)), np.zeros((pencil.n, 0))
        step = max(1, _COLUMNS // r)
        errors = np.empty(frequencies.size)
        for start in range(0, frequencies.size, step):
            s = np.asarray(1j * frequencies[start : start + step], dtype=np.complex128)
            q = np.asarray(np.linalg.solve(basis.matrix(s), (basis.vectors.T @ loads) + 0j))
            rho = self._residual(s, q)
            met, solved = self._grown(met, solved, rho)
            seen = met.T @ rho
            # Real and imaginary parts are neighbouring columns.
            strain = _products(seen, (met.T @ solved) @ seen).reshape(s.size, r, 2).sum(axis=2)
            whole = np.abs(np.einsum("kai,ab,kbi->ki", q.conj(), basis.shifted(), q))
            relative = np.sqrt(np.abs(strain) / np.maximum(whole, _TINY))
            left = self._factor(s) * relative.max(axis=1)
            errors[start : start + step] = np.hypot(left, self.rounding)
        return errors, solved

    def _factor(self, s: ComplexArray) -> FloatArray:
        """Bound of |D(s)^-1| by |A| for vectors orthogonal to the modes kept."""
        shift = self.basis.pencil.shift
        kept = [np.abs(1 - kernel.laplace(s)) for _, kernel in self.basis.model.layers]
        softened = np.minimum(1.0, np.min(kept, axis=0)) if kept else np.ones(s.size)
        return np.asarray((self.above - shift) / (self.above - np.abs(s) ** 2) / softened)

    def _residual(self, s: ComplexArray, q: ComplexArray) -> FloatArray:
        """Residuals for every frequency and load, real and imaginary parts, shape (n, 2 k r)."""
        basis, model = self.basis, self.basis.model
        k, m, r = q.shape
        columns = q.transpose(1, 0, 2).reshape(m, k * r)
        rho = np.zeros((basis.pencil.n, 2 * k * r))
        rho[:, ::2] = np.tile(self.loads, (1, k))
        for pushed, c in zip(basis.pushed, model.coefficients(s), strict=True):
            rho -= pushed @ _parts(columns * np.repeat(c, r))
        return rho

    def _grown(
        self, met: FloatArray, solved: FloatArray, rho: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Extend the space of residuals by ``rho``."""
        sizes = np.sqrt(_products(rho, rho).reshape(-1, 2).sum(axis=1)).repeat(2)
        scale = np.where(sizes > 0, sizes, 1.0)
        while True:
            left = rho - met @ (met.T @ rho)
            left /= scale
            gram = left.T @ left
            if gram.diagonal().max() <= _SAME**2:
                return met, solved
            # The directions with the largest remainder.
            values, mix = np.linalg.eigh(gram)
            kept = values > max(0.25 * _SAME**2, 1e-3 * values[-1])
            new = left @ mix[:, kept]
            for _ in range(2):
                new -= met @ (met.T @ new)
                new, _ = np.linalg.qr(new)
            met = np.concatenate([met, new], axis=1)
            solved = np.concatenate([solved, self.basis.pencil.solve(new)], axis=1)


def _massless(model: LinearModel, loads: FloatArray) -> FloatArray:
    """Static displacements under loads on coordinates without mass, all others fixed."""
    free = np.flatnonzero(model.mass.diagonal() == 0)
    pushed = loads[free] if free.size else np.zeros((0, loads.shape[1]))
    pushed = pushed[:, pushed.any(axis=0)]
    moved = np.zeros((loads.shape[0], pushed.shape[1]))
    if pushed.size:
        stiffness = csc_array(model.at_rest[np.ix_(free, free)])
        moved[free] = Pencil(0.0 * stiffness, stiffness, 0.0).solve(pushed)
    return moved


def _finished(estimate: _Estimate, model: LinearModel, n_modes: int, held: bool) -> Reduction:
    """Return the modes of the reduced model as a `Reduction`."""
    basis = estimate.basis
    squares, mix, massless = basis.modes()
    if held:
        n_modes = int((squares <= estimate.above).sum())
    else:
        # The frequencies of rigid modes are rounding errors; the others are better than Lanczos'.
        squares[:n_modes][estimate.found.squares == 0] = 0.0
    a, b = model.rayleigh
    rates = a + b * squares
    if np.any(model.ratio):
        modal, slope = modal_rates(model, squares[:n_modes])
        rates += np.concatenate([modal, slope * squares[n_modes:]])
    v = basis.vectors
    # The rates contain the ratios. In the equations of the check they are in addition to C.
    damping = [] if model.damping is None else [v.T @ _image(model.damping, v)]
    layers = basis.reduced[len(basis.reduced) - len(model.layers) :]
    return Reduction(
        squares=squares,
        shapes=basis.vectors @ mix,
        static=basis.vectors @ massless,
        rates=rates,
        n_modes=n_modes,
        n_rigid=int((squares == 0).sum()),
        n_negative=int((squares < 0).sum()),
        matrices=[mix.T @ matrix @ mix for matrix in (*damping, *layers)],
        at=estimate.frequencies,
        error=estimate.errors,
    )


def _spread(lowest: float, top: float, count: int) -> FloatArray:
    """Frequencies from the lowest to the highest, denser at the high end with its larger errors."""
    part = np.sin(0.5 * np.pi * np.linspace(0, 1, count))
    return lowest + (top - lowest) * part


def _image(matrix: Any, vectors: FloatArray) -> FloatArray:
    """A V, summed in extended precision.

    For a fine mesh K V is a small difference of large numbers: rounding errors of 1e-16 would shift
    the lowest frequencies by 1e-16 times the squared ratio of the highest to the lowest.
    """
    if not hasattr(matrix, "tocsc"):
        return np.asarray(matrix @ vectors)
    wide = matrix.astype(np.longdouble)
    found = np.empty_like(vectors)
    for j in range(vectors.shape[1]):
        found[:, j] = wide @ vectors[:, j].astype(np.longdouble)
    return found


def _products(left: Any, right: Any) -> Any:
    """Scalar products of corresponding columns."""
    return np.einsum("ij,ij->j", left, right)


def _parts(columns: ComplexArray) -> FloatArray:
    """Real and imaginary parts of columns as neighbouring columns, shape (m, 2 k)."""
    return np.ascontiguousarray(columns).view(float).reshape(columns.shape[0], -1)
