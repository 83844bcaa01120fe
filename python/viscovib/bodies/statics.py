"""Where a body rests under its weight, and what its mounts then carry."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from viscovib._native import FloatArray
from viscovib.bodies.mount_point import MountPoint
from viscovib.bodies.springs import MountSprings
from viscovib.common.values import Value
from viscovib.errors import InputError
from viscovib.systems.laws import Law

_MAX_STEPS = 30
#: Newton's method ends where a step is this part of the displacement, and has found a position if
#: it leaves that part of the weight.
_SETTLED, _ACCURATE = 1e-15, 1e-9
#: The least part of the weight that is put on at once.
_SMALLEST_PART = 1e-4


@dataclass(frozen=True, eq=False, repr=False)
class Sag(Value):
    """The loaded position of a body, all relaxation over.

    Attributes
    ----------
    displacement : ndarray, shape (n,)
        x, y, z (m) and rx, ry, rz (rad) from the position without weight.
    deflections : ndarray, shape (n_mounts, 3)
        Of each mount along its local axes (m).
    forces : ndarray, shape (n_mounts, 3)
        Of each mount on the body along its local axes (N).
    residual : float
        What is left of the weight, relative to it.

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


def find_sag(springs: MountSprings, weight: FloatArray) -> Sag:
    """Solve sum_j e_j (1 - I_j) [k_j d_j + g_j(d_j)] = weight, I_j the integral of R_j.

    The weight is put on little by little, Newton's method at each part, so that what is found is
    where the body comes to rest and not another solution of the equations.
    """
    kept = np.array([1.0 - _integral(kernel) for kernel in springs.kernels])
    u = np.zeros(springs.rows.shape[1])
    done, step = 0.0, 1.0
    while done < 1.0:
        part = min(done + step, 1.0)
        settled, residual = _settle(springs, kept, part * weight, u)
        if settled is None:
            step /= 2
            if step < _SMALLEST_PART:
                raise InputError(
                    f"gravity: the mounts give way under {100 * done:.4g} % of the weight, no "
                    "position at rest is known beyond"
                )
            continue
        u, done = settled, part
    d = springs.rows @ u
    force = kept * _forces(springs, d)[0]
    places = np.array(springs.first)[:, None] + np.arange(3)
    return Sag(u, d[places], -force[places], residual)


def _forces(springs: MountSprings, d: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Forces of springs that have not relaxed, and their slopes."""
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
    springs: MountSprings, kept: FloatArray, weight: FloatArray, u: FloatArray
) -> tuple[FloatArray | None, float]:
    """Position under a weight from one near it, and what is left; none if it is not held there."""
    rows = springs.rows
    size = float(np.abs(weight).max()) or 1.0
    for _ in range(_MAX_STEPS):
        force, slope = _forces(springs, rows @ u)
        left = weight - rows.T @ (kept * force)
        tangent = (rows.T * (kept * slope)) @ rows
        if not (np.isfinite(left).all() and np.isfinite(tangent).all()):
            return None, math.inf
        step = _solve(tangent, left, size)
        u = u + step
        if np.abs(step).max() <= _SETTLED * np.abs(u).max():
            break
    force, slope = _forces(springs, rows @ u)
    tangent = (rows.T * (kept * slope)) @ rows
    if not np.isfinite(tangent).all():
        return None, math.inf
    residual = float(np.abs(rows.T @ (kept * force) - weight).max()) / size
    squares = np.linalg.eigvalsh(tangent)
    held = squares[0] >= -1e-12 * np.abs(squares).max()
    return (u if held and residual < _ACCURATE else None), residual


def geometric_stiffness(
    mounts: Sequence[MountPoint], center: FloatArray, forces: FloatArray, n: int
) -> FloatArray:
    """Stiffness against rotation that forces of constant size and direction give.

    A force F on a body at p does the work F . [theta x p + theta x (theta x p)/2] to second order,
    so that it adds (p . F) 1 - (p F^T + F p^T)/2 to the stiffness against theta. It is the force's
    own, of the present: no material stands behind it, and nothing of it is remembered.
    """
    matrix = np.zeros((n, n))
    for mount, force in zip(mounts, forces, strict=True):
        p = np.asarray(mount.position) - center
        f = mount.rotation @ force
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
    """Solve; where the body is free to move without being pushed it stays."""
    if not np.isfinite(matrix).all():
        raise InputError("mounts: stiffnesses and positions give numbers that are too large")
    found = np.linalg.lstsq(matrix, right, rcond=1e-14)[0]
    if np.abs(matrix @ found - right).max() > 1e-6 * size:
        raise InputError("gravity: nothing carries the weight in a direction left free by mounts")
    return np.asarray(found)
