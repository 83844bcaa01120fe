"""Warnings for springs of very different stiffness, whose rounding errors hide the soft ones.

A mode of unit modal mass has omega^2 = phi^T K phi. Each entry of K has an independent error of up
to half a unit in its last place. Then omega^2 has an error of about

    0.3 eps sqrt(sum_ij (phi_i K_ij phi_j)^2),                                                  (1)

and by eps/2 |phi|^T |K| |phi| at most (Wilkinson, The Algebraic Eigenvalue Problem, 1965, chapter
2: first-order perturbation of a simple eigenvalue; the root mean square error of an entry is
0.21 eps of the entry, equal to that of its mirror image). If stiff springs connect bodies on soft
springs, phi^T K phi is a small difference of large numbers.
"""

import warnings
from typing import Any

import numpy as np

from viscovib._native import ComplexArray, FloatArray
from viscovib.errors import RangeWarning, caller

_EPS = float(np.finfo(float).eps)
_TINY = float(np.finfo(float).tiny)
#: Squares of frequencies below this part of |phi|^T |K| |phi| are free motions.
_RIGID = 1e-12
#: Largest relative rounding error of a squared frequency without a warning, and the smallest one
#: that indicates a free body.
_LOST, _FREE = 1e-6, 0.15
#: If all squared frequencies are closer together than this, no error exceeds `_LOST`.
_ALIKE = 1e-8
#: Ratio of squared frequencies from which on a failed search for steady motions may be due to it.
_STIFF = 1e8
#: Relative error of a matrix entry in (1).
_OFF = 0.3 * _EPS
#: Smallest normal number.
_TINY = float(np.finfo(float).tiny)
#: Smallest share of a coordinate in the kinetic energy of a mode that counts; relative stiffness
#: that is a rounding error of cancellation.
_PART, _NOTHING = 1e-3, 1e-30


def warn_of_hidden(note: str) -> None:
    """Warn of springs hidden by rounding errors, with the accuracy of the mode."""
    warnings.warn(
        f"stiffness: springs are so different that rounding hides the soft ones: {note}; stiffer "
        "parts may be made rigid, or softer",
        RangeWarning,
        stacklevel=caller(),
    )


def without_rounding(squares: FloatArray, shapes: FloatArray, stiffness: FloatArray) -> FloatArray:
    """Set squared frequencies that are rounding errors to 0: motions without springs."""
    pulled = np.einsum("im,ij,jm->m", np.abs(shapes), np.abs(stiffness), np.abs(shapes))
    result = squares.copy()
    result[np.abs(squares) <= _RIGID * pulled] = 0.0
    return result


def warn_of_lost_modes(
    squares: FloatArray, shapes: FloatArray, mass: Any, stiffness: Any, least: float = _LOST
) -> None:
    """Warn of modes hidden by rounding errors: squares (m,), shapes (n, m).

    Matrices are dense or sparse; ``least``: largest relative rounding error of a squared frequency
    without a warning. A mode of rounding errors only, lost >= `_FREE`, counts as a free body,
    unless it is large relative to the softest coordinate that participates or is connected to
    participating ones: a pair of masses on a lost spring equals a pair without a spring.
    """
    lost = _OFF * _spread(shapes, stiffness)
    soft = np.flatnonzero(np.abs(squares) * least < 10 * lost)
    if not soft.size:
        return
    # The rounding error of the algorithm is as large: use the given matrix.
    shapes, lost = shapes[:, soft], lost[soft]
    wide = shapes.astype(np.longdouble)
    values = (wide * (stiffness.astype(np.longdouble) @ wide)).sum(axis=0)
    found = np.abs(np.asarray(values, dtype=float))
    weights, springs = mass.diagonal(), np.abs(stiffness.diagonal())
    held = (springs > _NOTHING * springs.max()) & (weights > 0)
    taking = weights[:, np.newaxis] * shapes**2 > _PART
    joined = abs(stiffness) > _NOTHING * springs.max()
    taking = ((joined @ taking) > 0) & held[:, np.newaxis]
    rates = np.divide(springs, weights, where=held, out=np.full(weights.size, np.inf))
    softest = np.where(taking, rates[:, np.newaxis], np.inf).min(axis=0)
    part = lost / np.maximum(found, _TINY)
    doubtful = (part > least) & ((part < _FREE) | (lost > _LOST * softest))
    doubtful &= np.maximum(found, lost) > _NOTHING * rates[held].max(initial=0.0)
    if not doubtful.any():
        return
    worst = int(np.where(doubtful, part, 0).argmax())
    free = squares[soft[worst]] == 0 or part[worst] >= _FREE
    square = max(found[worst], lost[worst]) if free else found[worst]
    warn_of_hidden(_note(int(soft[worst]), float(square), float(part[worst]), bool(free)))


def warn_of_lost_poles(
    poles: ComplexArray, left: ComplexArray, right: ComplexArray, stiffness: FloatArray
) -> None:
    """Warn of complex modes that rounding errors of the stiffness hide.

    With (s^2 M + s C + K)^-1 = sum left right^T/(s - pole), rounding errors of K move a pole by
    about (1) with right and left. The relative error of its square is twice as large.
    """
    moved = _OFF * _spread(np.abs(right), stiffness, np.abs(left))
    moving = poles != 0
    lost = np.zeros(poles.size)
    lost[moving] = 2 * moved[moving] / np.abs(poles[moving])
    worst = int(lost.argmax())
    if lost[worst] > _LOST:
        warn_of_hidden(_note(None, float(np.abs(poles[worst])) ** 2, float(lost[worst])))


def advice_on_springs(mass: FloatArray, stiffness: FloatArray) -> str:
    """Return advice if rounding errors of stiff springs may hide a steady motion.

    For matrices (n, n) that are solved directly: forces of stiff springs are small differences of
    displacements, so soft springs have a relative error of eps times the ratio of both, and light
    damping a larger one. A structure uses refined modes for its linear part and keeps these digits.
    """
    squares = np.abs(np.linalg.eigvals(np.linalg.solve(mass, stiffness)))
    ratio = squares.max() / max(squares.min(), _EPS * squares.max())
    if ratio < _STIFF:
        return ""
    return (
        f"; squares of natural frequencies differ by a factor of {ratio:.0e}, and rounding of "
        "stiff springs hides what soft ones do: vv.Structure with elements keeps these digits"
    )


def warn_of_lost_springs(mass: FloatArray, stiffness: FloatArray) -> None:
    """Warn of modes that rounding errors hide, for matrices (n, n) that are solved directly.

    Damping is ignored, because it hides nothing. The stiffness need not be symmetric.
    """
    n = mass.shape[0]
    if n == 1:
        return
    if np.count_nonzero(mass) == n:
        # The common case: a diagonal mass matrix.
        root = 1 / np.sqrt(mass.diagonal())
        reduced = stiffness * root * root[:, np.newaxis]
        root = np.diag(root)
    else:
        root = np.linalg.inv(np.linalg.cholesky(mass))
        reduced = root @ stiffness @ root.T
    symmetric = (stiffness == stiffness.T).all() or (
        np.abs(stiffness - stiffness.T).max() <= _RIGID * np.abs(stiffness).max()
    )
    sizes = np.abs(np.linalg.eigvalsh(reduced) if symmetric else np.linalg.eigvals(reduced))
    if sizes.min() > _ALIKE * sizes.max():
        return
    if not symmetric:
        _warn_of_lost_values(reduced, root, stiffness)
        return
    squares, turned = np.linalg.eigh(reduced)
    warn_of_lost_modes(squares, root.T @ turned, mass, stiffness)


def _warn_of_lost_values(reduced: FloatArray, root: FloatArray, stiffness: FloatArray) -> None:
    """The warning for an unsymmetric stiffness, with left and right eigenvectors."""
    from scipy.linalg import eig

    values, lefts, rights = eig(reduced, left=True, right=True)
    scale = np.abs(np.einsum("im,im->m", lefts.conj(), rights))
    moved = _OFF * _spread(np.abs(root.T @ lefts.conj()), stiffness, np.abs(root.T @ rights))
    sizes = np.maximum(np.abs(values), _TINY)
    lost = moved / np.maximum(scale, _TINY) / sizes
    doubtful = (lost > _LOST) & (lost < _FREE)
    if doubtful.any():
        worst = int(np.where(doubtful, lost, 0).argmax())
        warn_of_hidden(_note(None, float(sizes[worst]), float(lost[worst])))


def _spread(left: FloatArray, stiffness: Any, right: FloatArray | None = None) -> FloatArray:
    """The square root in (1), shape (m,), for shapes (n, m) and, if different, right shapes."""
    largest = abs(stiffness).max()
    if not largest > 0:
        return np.zeros(left.shape[1])
    entries = (stiffness / largest) ** 2
    right = left if right is None else right
    # Squares of shapes of light masses would overflow.
    sizes = [np.maximum(abs(shapes).max(axis=0, initial=0.0), _TINY) for shapes in (left, right)]
    squares = [(shapes / size) ** 2 for shapes, size in zip((left, right), sizes, strict=True)]
    spread = np.sqrt(np.sum(squares[0] * (entries @ squares[1]), axis=0))
    return np.asarray(largest * spread * sizes[0] * sizes[1])


def _note(mode: int | None, square: float, lost: float, free: bool = False) -> str:
    name = "a mode" if mode is None else f"mode {mode}"
    if free:
        return f"{name} may be free, or have up to about {square**0.5:.2g} rad/s"
    return (
        f"{name} has {square**0.5:.4g} rad/s, and the square of that is known to "
        f"about {lost:.1g} only"
    )
