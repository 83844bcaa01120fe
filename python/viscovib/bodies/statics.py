"""Static equilibrium of a body under its weight and preloads, and its mount forces."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from viscovib._native import FloatArray
from viscovib.bodies.springs import MountSprings
from viscovib.bodies.turning import place_along
from viscovib.common.values import Value
from viscovib.errors import InputError
from viscovib.systems.laws import Law

_Place = Callable[[MountSprings, FloatArray], tuple[FloatArray, FloatArray, Any]]

_MAX_STEPS = 30
#: Newton's method ends if a step is below this part of the displacement; largest residual of an
#: equilibrium relative to weight and preloads.
_SETTLED, _ACCURATE = 1e-15, 1e-9
#: Smallest increment of weight and preloads.
_SMALLEST_PART = 1e-4


@dataclass(frozen=True, eq=False, repr=False)
class Sag(Value):
    """The static equilibrium of a body after complete relaxation.

    Attributes
    ----------
    displacement : ndarray, shape (n,)
        x, y, z (m) and rx, ry, rz (rad) from the position without weight and preload.
    deflections : ndarray, shape (n_mounts, 3)
        Deflection of each mount along its local axes (m).
    forces : ndarray, shape (n_mounts, 3)
        Force of each mount on the body along its local axes (N).
    residual : float
        Residual of weight and preloads, relative to them.

    Examples
    --------
    >>> import viscovib as vv
    >>> foot = vv.MountPoint(
    ...     name="foot", position=(0, 0, 0), stiffness=(1e5, 1e5, 2e5),
    ...     rotational_stiffness=(1e3, 1e3, 1e3),
    ... )
    >>> sag = vv.Body(mass=5, inertia=(0.1, 0.2, 0.3), mounts=[foot], gravity=10).sag()
    >>> round(float(1e3 * sag.displacement[2]), 6)  # mm
    -0.25
    """

    displacement: FloatArray
    deflections: FloatArray
    forces: FloatArray
    residual: float
    #: Deflections and forces of all springs, including rotations and tracks.
    _deflection: FloatArray = field(repr=False)
    _carried: FloatArray = field(repr=False)


def find_sag(springs: MountSprings, weight: FloatArray, *, turns: bool = False) -> Sag:
    """Solve sum_j dd_j/dq (1 - I_j) [k_j d_j + g_j(d_j)] = weight, I_j the integral of R_j.

    Weight and preloads g_j(0) are applied in increments with Newton's method, so that the result is
    the equilibrium that the body reaches and no other solution of the equations. ``turns``:
    rotations are finite, else small.
    """
    kept = np.array([1.0 - _integral(kernel) for kernel in springs.kernels])
    preload = kept * springs.at_rest
    q = np.zeros(springs.rows.shape[1])
    place = place_along if turns else _place_nearby
    done, step = 0.0, 1.0
    while done < 1.0:
        part = min(done + step, 1.0)
        settled, residual = _settle(springs, kept, part * weight, (1.0 - part) * preload, q, place)
        if settled is None:
            step /= 2
            if step < _SMALLEST_PART:
                loads = "the weight" + " and of preloads" * bool(preload.any())
                raise InputError(
                    f"gravity: the mounts give way under {100 * done:.4g} % of {loads}, no "
                    "position at rest is known beyond"
                )
            continue
        q, done = settled, part
    d = place(springs, q)[0]
    force = kept * _forces(springs, d)[0]
    places = np.array(springs.first)[:, None] + np.arange(3)
    return Sag(q, d[places], -force[places], residual, d, force)


def _place_nearby(springs: MountSprings, q: FloatArray) -> tuple[FloatArray, FloatArray, Any]:
    """Deflections for small rotations: the linear part of `place_along`."""
    n = q.size
    return springs.rows @ q, springs.rows, lambda _: np.zeros((n, n))


def _forces(springs: MountSprings, d: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Forces of springs without relaxation, and their derivatives."""
    force, slope = springs.stiffness * d, springs.stiffness.copy()
    for j, law in enumerate(springs.laws):
        if isinstance(law, Law):
            value, by = law(np.array([[d[j], 0.0]]))
            force[j] += value[0]
            slope[j] += by[0, 0]
            continue
        for power, c in law.items():
            force[j] += c * d[j] ** power
            slope[j] += power * c * d[j] ** (power - 1)
    return force, slope


@np.errstate(over="ignore", invalid="ignore")
def _settle(
    springs: MountSprings,
    kept: FloatArray,
    weight: FloatArray,
    waiting: FloatArray,
    q: FloatArray,
    place: _Place,
) -> tuple[FloatArray | None, float]:
    """Equilibrium near a position, and its residual; None if it is unstable or not found.

    ``waiting``: part of the force of each spring that is not applied yet.
    """
    pushed = springs.rows.T @ (kept * springs.at_rest)
    size = max(float(np.abs(weight).max()), float(np.abs(pushed).max())) or 1.0

    def balance(q: FloatArray) -> tuple[FloatArray, FloatArray]:
        d, slopes, bends = place(springs, q)
        force, slope = _forces(springs, d)
        tangent = (slopes.T * (kept * slope)) @ slopes
        if not (np.isfinite(force).all() and np.isfinite(tangent).all()):
            return np.full(q.size, np.inf), tangent
        carried = kept * force - waiting
        return weight - slopes.T @ carried, tangent + bends(carried)

    for _ in range(_MAX_STEPS):
        left, tangent = balance(q)
        if not (np.isfinite(left).all() and np.isfinite(tangent).all()):
            return None, math.inf
        step = _solve(tangent, left, size)
        q = q + step
        if np.linalg.norm(q[3:6]) > math.pi and place is place_along:
            return None, math.inf
        if np.abs(step).max() <= _SETTLED * np.abs(q).max():
            break
    left, tangent = balance(q)
    if not (np.isfinite(left).all() and np.isfinite(tangent).all()):
        return None, math.inf
    residual = float(np.abs(left).max()) / size
    squares = np.linalg.eigvalsh(tangent)
    held = squares[0] >= -1e-12 * np.abs(squares).max()
    return (q if held and residual < _ACCURATE else None), residual


def geometric_stiffness(springs: MountSprings, carried: FloatArray) -> FloatArray:
    """Rotational stiffness by forces of constant size and direction, shape (n, n).

    A force F on a body at p does the work F . [theta x p + theta x (theta x p)/2] to second order.
    So it adds (p . F) 1 - (p F^T + F p^T)/2 to the stiffness against theta. This geometric
    stiffness is not a material property and has no memory.
    """
    n = springs.rows.shape[1]
    matrix = np.zeros((n, n))
    for row, p, size in zip(springs.rows, springs.arms, carried, strict=True):
        f = -size * row[:3]
        matrix[3:6, 3:6] += (p @ f) * np.eye(3) - (np.outer(p, f) + np.outer(f, p)) / 2
    return matrix


def _integral(kernel: object) -> float:
    integral = 0.0 if kernel is None else float(kernel.integral)  # type: ignore[attr-defined]
    if not math.isfinite(integral):
        raise InputError("gravity: a kernel has no integral, its mount never comes to rest")
    if integral >= 1:
        raise InputError(
            f"gravity: the integral of a kernel is {integral:.6g}, must be below 1: its mount "
            "carries no load in the end"
        )
    return integral


def _solve(matrix: FloatArray, right: FloatArray, size: float) -> FloatArray:
    """Solve; free rigid-body motions without a load stay 0."""
    if not np.isfinite(matrix).all():
        raise InputError("mounts: stiffnesses and positions give numbers that are too large")
    found = np.linalg.lstsq(matrix, right, rcond=1e-14)[0]
    if np.abs(matrix @ found - right).max() > 1e-6 * size:
        raise InputError("gravity: nothing carries the weight in a direction left free by mounts")
    return np.asarray(found)
