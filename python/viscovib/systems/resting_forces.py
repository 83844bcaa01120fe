"""Forces of elements where the compliance of the linear subsystem nearly vanishes."""

from typing import Any, NamedTuple

import numpy as np

from viscovib._native import ComplexArray, FloatArray
from viscovib.systems.element_laws import Laws

#: Cancellation in H from which on rounding errors are estimated; relative size of a harmonic below
#: which they are not.
_CANCELLED, _NOTHING = 100.0, 1e-10
#: Relative rounding error of a motion from which on forces are computed from the laws; relative
#: difference of motions for derivatives of laws; tolerance of iterations.
_WORTH, _NEARBY, _ENDED = 3e-14, 1e-6, 1e-8
_TINY = np.finfo(float).tiny
#: Samples per period and harmonic for laws that are not polynomials, and the smallest number.
_PER_ORDER, _FEWEST = 16, 256
#: Size of the array of one part of the samples.
_AT_ONCE = 1_000_000


class Motions(NamedTuple):
    """All harmonics of motions, with the index k of one harmonic and the selected motions."""

    nu: FloatArray
    orders: Any
    #: Shape (n, q, m).
    y: ComplexArray
    k: int
    part: Any
    #: Largest harmonic of each motion, shape (n,).
    whole: FloatArray


def forces_of_laws(
    c: Any,
    g: ComplexArray,
    h: ComplexArray,
    t: ComplexArray,
    w: ComplexArray,
    pushed: ComplexArray,
    turned: ComplexArray,
    y: ComplexArray,
    motions: Motions,
) -> ComplexArray:
    """Return forces g from the laws where H g = y - free loses more digits.

    ``c``: a `Condensation`; t and w: 1/(squares + rates s + s^2) and 1/(s - poles), ``pushed`` and
    ``turned``: times the loads on the modes, at each motion.

    This happens at an antiresonance: H nearly vanishes although its terms do not, and the element
    is at rest for any force. Rounding errors of H and free cause the error |H^-1| eps (sum of the
    sizes of the terms); the law has only the rounding error of y. Forces of the law that differ by
    more than this error, or the tolerance of iterations, belong to different equations, such as
    those of a branch with a varied parameter.
    """
    if not _are_smooth(c.laws):
        return g
    eps = np.finfo(float).eps
    seen, left, right = np.abs(c.seen), np.abs(c.left), np.abs(c.right)
    # Negligible harmonics need no more digits.
    real, turning = np.abs(t.real) + np.abs(t.imag), np.abs(w.real) + np.abs(w.imag)
    most = real.max(axis=1, initial=0.0) * float((seen**2).sum(axis=0).max(initial=0.0))
    if w.size:
        most += turning.max(axis=1) * float((left.sum(axis=1) * right.sum(axis=1)).sum())
    effect = most * np.abs(g).max(axis=1)
    near = np.flatnonzero(effect > _NOTHING * motions.whole[motions.part])
    if not near.size:
        return g
    sizes = products(real[near], seen, seen)
    if w.size:
        sizes += products(turning[near], left, right)
    inverse = _inverse_sizes(h[near])
    cancelled = (inverse @ sizes).max(axis=(1, 2)) > _CANCELLED
    near, inverse, sizes = near[cancelled], inverse[cancelled], sizes[cancelled]
    if not near.size:
        return g
    given = g
    g, y, t, w, pushed, turned = (part[near] for part in (g, y, t, w, pushed, turned))
    size = np.abs(y) + np.abs(pushed) @ seen + np.abs(turned) @ left
    size += (sizes @ np.abs(g)[:, :, np.newaxis])[:, :, 0]
    lost = eps * (inverse @ size[:, :, np.newaxis])[:, :, 0]
    # The rounding error relative to the motion.
    moved = (np.abs(t) * (lost @ seen.T)).max(axis=1, initial=0.0)
    whole = np.abs(pushed + t * (g @ c.seen.T)).max(axis=1, initial=0.0)
    if w.size:
        moved += (np.abs(w) * (lost @ right.T)).max(axis=1)
        whole += np.abs(turned + w * (g @ c.right.T)).max(axis=1)
    doubtful = np.flatnonzero(moved > _WORTH * whole)
    if not doubtful.size:
        return given
    places = near[doubtful]
    found = motions.part[places]
    nu, orders, own = motions.nu[found], motions.orders, np.nan_to_num(motions.y[found])
    order = int(orders[motions.k])
    at = _forces_on_rest(c.laws, nu, orders, own, order)
    nearby = _forces_on_rest(c.laws, nu, orders, own * (1 + _NEARBY), order)
    bend = np.abs(nearby - at).max(axis=1) / _NEARBY
    own_size = np.abs(own).max(axis=(1, 2))
    of_law = eps * bend * size[doubtful].max(axis=1) / np.maximum(own_size, _TINY)
    lost = lost[doubtful]
    ended = (inverse[doubtful] @ np.abs(y[doubtful])[:, :, np.newaxis])[:, :, 0]
    same = (np.abs(at - g[doubtful]) <= 100 * lost + _ENDED * ended).all(axis=1)
    taken = same & (of_law < lost.max(axis=1))
    given[places[taken]] = at[taken]
    return given


def products(t: ComplexArray, left: Any, right: Any) -> ComplexArray:
    """sum_m t_nm left_mq right_mp, shape (n, q, p), without the path search of einsum."""
    (n, m), q, p = t.shape, left.shape[1], right.shape[1]
    if p <= n:
        pairs = (left[:, :, np.newaxis] * right[:, np.newaxis, :]).reshape(m, q * p)
        return np.asarray((t @ pairs).reshape(n, q, p))
    return np.asarray((t[:, np.newaxis, :] * left.T) @ right)


def solved(matrices: ComplexArray, right: ComplexArray) -> ComplexArray:
    """Solutions of systems (n, q, q) with one right-hand side each, (n, q)."""
    if matrices.shape[1] == 1 and matrices.all():
        # A motion that was not located, such as a crossing, is NaN.
        with np.errstate(invalid="ignore"):
            return right / matrices[:, 0]
    return np.asarray(np.linalg.solve(matrices, right[:, :, np.newaxis])[:, :, 0])


def _inverse_sizes(matrices: ComplexArray) -> FloatArray:
    """Sizes of the entries of inverses, (n, q, q)."""
    q = matrices.shape[1]
    if q > 2:
        return np.asarray(np.abs(np.linalg.inv(matrices)))
    if q == 1:
        sizes, determinant = np.ones(matrices.shape), matrices[:, 0, 0]
    else:
        sizes = np.abs(matrices[:, ::-1, ::-1]).transpose(0, 2, 1)
        determinant = matrices[:, 0, 0] * matrices[:, 1, 1] - matrices[:, 0, 1] * matrices[:, 1, 0]
    with np.errstate(divide="ignore", over="ignore"):
        return np.asarray(sizes / np.abs(determinant)[:, np.newaxis, np.newaxis])


def _are_smooth(laws: Laws) -> bool:
    """True if samples of a period give the harmonics of all forces to rounding error."""
    return not any(place.law.state or place.law.branches for place in laws.programs)


def _forces_on_rest(
    laws: Laws, nu: FloatArray, orders: Any, y: ComplexArray, order: int
) -> ComplexArray:
    """-G_k of one harmonic k > 0, shape (n, q), at deflections y = Im sum_k Y_k exp(i k nu t).

    G_k = 2 i/N sum_j g(y(t_j)) exp(-i k nu t_j) over N samples of a period, times 1 - R(i k nu)
    with a kernel. Polynomials of degree p are free of aliasing if N > (p + 1) k_max. Linear forces
    contribute only -R kappa Y_k: their elastic part belongs to the linear subsystem.

    ``y``: shape (n, q, m), of smooth laws (`_are_smooth`).
    """
    degree = max((sum(powers) for group in laws.forces for _, powers in group), default=1)
    highest = int(orders.max())
    count = (degree + 1) * highest + 1
    if laws.programs:
        count = max(count, _PER_ORDER * highest, _FEWEST)
    phase = 2 * np.pi * np.arange(count) / count
    waves = np.exp(1j * np.outer(orders, phase))
    back = 2j / count * np.exp(-1j * order * phase)
    found = np.empty(y.shape[:2], dtype=complex)
    step = max(1, _AT_ONCE // (count * y.shape[1]))
    for first in range(0, nu.size, step):
        part = slice(first, first + step)
        found[part] = _of_some(laws, nu[part], orders, y[part], order, waves, back)
    return found


def _of_some(
    laws: Laws, nu: FloatArray, orders: Any, y: ComplexArray, order: int, waves: ComplexArray,
    back: ComplexArray,
) -> ComplexArray:  # fmt: skip
    (n, q, _), count = y.shape, waves.shape[1]

    def samples(harmonics: ComplexArray) -> FloatArray:
        return np.asarray((harmonics @ waves).imag.transpose(1, 0, 2).reshape(q, -1))

    at = samples(y)
    rates = samples(1j * nu[:, np.newaxis, np.newaxis] * orders * y) if laws.programs else at
    own = y[:, :, np.flatnonzero(orders == order)[0]]
    total = np.zeros_like(own)
    parts = zip(laws.kernels, laws.stiffness, laws.forces_at(at, rates), strict=True)
    for kernel, stiffness, force in parts:
        retained = 0.0 if kernel is None else kernel.transform(order * nu)[:, np.newaxis]
        # Linear forces without a kernel are not relaxed.
        total += (-1.0 if kernel is None else retained) * (own @ stiffness.T)
        total -= (1 - retained) * (force.reshape(q, n, count) @ back).T
    return total
