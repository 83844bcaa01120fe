"""Springs of very different stiffness, whose rounding errors hide the soft ones: warnings.

A mode of unit modal mass has omega^2 = phi^T K phi. Each entry of K is off by up to half a unit in
its last place, independently of the others: omega^2 is then off by about

    0.3 eps sqrt(sum_ij (phi_i K_ij phi_j)^2),                                                  (1)

and by eps/2 |phi|^T |K| |phi| at most (Wilkinson, The Algebraic Eigenvalue Problem, 1965, chapter
2: first-order perturbation of a simple eigenvalue; an entry is off by 0.21 eps of itself in the
mean square, and by the same as its mirror image). Where stiff springs join what soft ones hold,
phi^T K phi is the small difference of large numbers.
"""

import warnings
from typing import Any

import numpy as np

from viscovib._native import ComplexArray, FloatArray
from viscovib.errors import RangeWarning, caller

_EPS = float(np.finfo(float).eps)
_TINY = float(np.finfo(float).tiny)
#: A square of a frequency next to |phi|^T |K| |phi|: below, what no spring resists.
_RIGID = 1e-12
#: Part of the square of a frequency that may be rounding error without a warning, and the smallest
#: part that is the rounding error of a free body.
_LOST, _FREE = 1e-6, 0.15
#: Squares of frequencies closer together than this lose no more than `_LOST`.
_ALIKE = 1e-8
#: Squares of frequencies so far apart may be why no steady motion is found.
_STIFF = 1e8
#: Part that an entry of the matrix is off by, in (1).
_OFF = 0.3 * _EPS
#: Smallest number with all digits.
_TINY = float(np.finfo(float).tiny)
#: Part of a mode's kinetic energy that a coordinate takes part with; stiffnesses that are rounding
#: of what cancels, next to the largest.
_PART, _NOTHING = 1e-3, 1e-30


def warn_of_hidden(told: str) -> None:
    """Warn of springs hidden by rounding errors, with the accuracy of the mode."""
    warnings.warn(
        f"stiffness: springs are so different that rounding hides the soft ones: {told}; stiffer "
        "parts may be made rigid, or softer",
        RangeWarning,
        stacklevel=caller(),
    )


def without_rounding(squares: FloatArray, shapes: FloatArray, stiffness: FloatArray) -> FloatArray:
    """Squares of frequencies that are rounding become 0: motions that no spring resists."""
    pulled = np.einsum("im,ij,jm->m", np.abs(shapes), np.abs(stiffness), np.abs(shapes))
    result = squares.copy()
    result[np.abs(squares) <= _RIGID * pulled] = 0.0
    return result


def warn_of_lost_modes(
    squares: FloatArray, shapes: FloatArray, mass: Any, stiffness: Any, least: float = _LOST
) -> None:
    """Warn of modes hidden by rounding errors: squares (m,), shapes (n, m).

    Matrices are dense or sparse; ``least``: part of the square of a frequency that may be rounding
    error without a warning. A mode of rounding errors only, lost >= `_FREE`, is that of a free
    body, unless it is large relative to the softest coordinate that takes part or is joined to
    those: a pair of masses on a lost spring equals a pair without a spring.
    """
    lost = _OFF * _spread(shapes, stiffness)
    soft = np.flatnonzero(np.abs(squares) * least < 10 * lost)
    if not soft.size:
        return
    # Rounding of the algorithm is as large: of the matrix as it stands.
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
    warn_of_hidden(_told(int(soft[worst]), float(square), float(part[worst]), bool(free)))


def warn_of_lost_poles(
    poles: ComplexArray, left: ComplexArray, right: ComplexArray, stiffness: FloatArray
) -> None:
    """Tell of complex modes of which rounding of the stiffness leaves little.

    With (s^2 M + s C + K)^-1 = sum left right^T/(s - pole), entries of K that are off by a
    rounding move a pole by about (1) with right and left; twice that is the part of its square.
    """
    moved = _OFF * _spread(np.abs(right), stiffness, np.abs(left))
    moving = poles != 0
    lost = np.zeros(poles.size)
    lost[moving] = 2 * moved[moving] / np.abs(poles[moving])
    worst = int(lost.argmax())
    if lost[worst] > _LOST:
        warn_of_hidden(_told(None, float(np.abs(poles[worst])) ** 2, float(lost[worst])))


def advice_on_springs(mass: FloatArray, stiffness: FloatArray) -> str:
    """Return what to do where rounding of stiff springs may be what hides a steady motion.

    Of matrices (n, n) that are solved as they stand: forces of stiff springs are small differences
    of displacements, of which rounding leaves soft ones eps times the ratio of both, and light
    damping more. A structure has its linear part by refined modes, which keep these digits.
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
    """Tell of modes of matrices (n, n), which are solved as they stand, that rounding hides.

    Without damping, which hides nothing. The stiffness need not be symmetric.
    """
    n = mass.shape[0]
    if n == 1:
        return
    if np.count_nonzero(mass) == n:
        # The common case, soon decided.
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
    """The same of a stiffness that is not symmetric: by vectors of both sides."""
    from scipy.linalg import eig

    values, lefts, rights = eig(reduced, left=True, right=True)
    scale = np.abs(np.einsum("im,im->m", lefts.conj(), rights))
    moved = _OFF * _spread(np.abs(root.T @ lefts.conj()), stiffness, np.abs(root.T @ rights))
    sizes = np.maximum(np.abs(values), _TINY)
    lost = moved / np.maximum(scale, _TINY) / sizes
    doubtful = (lost > _LOST) & (lost < _FREE)
    if doubtful.any():
        worst = int(np.where(doubtful, lost, 0).argmax())
        warn_of_hidden(_told(None, float(sizes[worst]), float(lost[worst])))


def _spread(left: FloatArray, stiffness: Any, right: FloatArray | None = None) -> FloatArray:
    """The root of (1), shape (m,), of shapes (n, m), those of the right where they differ."""
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


def _told(mode: int | None, square: float, lost: float, free: bool = False) -> str:
    name = "a mode" if mode is None else f"mode {mode}"
    if free:
        return f"{name} may be free, or have up to about {square**0.5:.2g} rad/s"
    return (
        f"{name} has {square**0.5:.4g} rad/s, and the square of that is known to "
        f"about {lost:.1g} only"
    )
