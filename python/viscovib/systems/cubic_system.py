"""Systems with terms up to the third degree."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.values import own_fields
from viscovib.errors import InputError

#: Largest number of coordinates.
_MOST = 6


@dataclass(frozen=True, kw_only=True, eq=False)
class CubicSystem:
    """M q'' + C q' + K q + N2(x, x) + N3(x, x, x) = sum_k F_k cos(p_k t).

    Parameters
    ----------
    mass, stiffness : array_like, shape (n, n)
        M and K, n up to 6; the eigenvalues of M^-1 K must be positive.
    damping : array_like, shape (n, n), optional
    quadratic : array_like, shape (n, m, m), optional
        sum_jk quadratic[i, j, k] x_j x_k in equation i, with x = q (m = n) or
        x = (q, q', q'') (m = 3 n).
    cubic : array_like, shape (n, m, m, m), optional
    load : array_like, shape (n, n_loads), optional
        Amplitudes F_k, a column each.
    drives : array_like, shape (n_loads,), optional
        Circular frequencies p_k >= 0.

    Examples
    --------
    >>> import viscovib as vv
    >>> duffing = vv.CubicSystem(
    ...     mass=[[1.0]],
    ...     stiffness=[[1.0]],
    ...     damping=[[0.02]],
    ...     cubic=[[[[0.5]]]],
    ...     load=[[0.01]],
    ...     drives=[1.05],
    ... )
    >>> scales = vv.MultipleScales(duffing)
    """

    mass: npt.ArrayLike
    stiffness: npt.ArrayLike
    damping: npt.ArrayLike | None = None
    quadratic: npt.ArrayLike | None = None
    cubic: npt.ArrayLike | None = None
    load: npt.ArrayLike | None = None
    drives: npt.ArrayLike | None = None

    #: All numbers in the order of the core.
    _packed: FloatArray = field(init=False, repr=False)
    _n: int = field(init=False, repr=False)

    def __post_init__(self) -> None:
        own_fields(self)
        mass = _native.real_array("mass", self.mass, ndim=2)
        n = mass.shape[0]
        if not 1 <= n <= _MOST:
            raise InputError(f"mass: must have 1 to {_MOST} rows, got {n}")
        mass = _shaped("mass", mass, (n, n))
        stiffness = _shaped("stiffness", self.stiffness, (n, n))
        damping = _shaped("damping", self.damping, (n, n))
        drives = _native.real_array("drives", () if self.drives is None else self.drives, ndim=1)
        if (drives < 0).any():
            raise InputError(f"drives = {drives.min():g}: must not be negative")
        load = _shaped("load", self.load, (n, drives.size))
        quadratic, m = _terms("quadratic", self.quadratic, n, 2)
        cubic, m_cubic = _terms("cubic", self.cubic, n, 3)
        m = max(m, m_cubic)
        omega, left, right = _modes(mass, stiffness)
        head = [n, n, m, n, drives.size, quadratic.shape[0], cubic.shape[0], 1.0]
        arguments = np.arange(m)
        packed = [
            np.array(head),
            arguments % n + 1.0,
            arguments // n * 1.0,
            np.zeros(n),
            *(matrix.ravel(order="F") for matrix in (stiffness, damping, mass)),
            np.zeros(n * n),
            quadratic.ravel(),
            cubic.ravel(),
            load.ravel(order="F"),
            drives,
            omega,
            right.ravel(order="F"),
            left.ravel(order="F"),
        ]
        numbers = np.concatenate(packed)
        numbers.flags.writeable = False
        object.__setattr__(self, "_packed", numbers)
        object.__setattr__(self, "_n", n)

    @property
    def dof_names(self) -> tuple[str, ...]:
        """q1, q2, ..."""
        return tuple(f"q{i + 1}" for i in range(self._n))


def _shaped(name: str, value: npt.ArrayLike | None, shape: tuple[int, ...]) -> FloatArray:
    array = np.zeros(shape) if value is None else _native.real_array(name, value)
    if array.shape != shape:
        raise InputError(f"{name}: must have shape {shape}, got {array.shape}")
    return array


def _terms(name: str, value: npt.ArrayLike | None, n: int, degree: int) -> tuple[FloatArray, int]:
    """Return rows (equation, arguments, coefficient), counted from 1, and the arguments' count."""
    if value is None:
        return np.empty((0, degree + 2)), n
    array = _native.real_array(name, value)
    shapes = [(n, *(m,) * degree) for m in (n, 3 * n)]
    if array.shape not in shapes:
        raise InputError(f"{name}: must have shape {shapes[0]} or {shapes[1]}, got {array.shape}")
    where = np.argwhere(array != 0)
    return np.column_stack([where + 1.0, array[tuple(where.T)]]), array.shape[1]


def _modes(mass: FloatArray, stiffness: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Frequencies, ascending, with left and right vectors of K - omega^2 M."""
    import scipy.linalg

    try:
        if np.allclose(mass, mass.T, rtol=1e-14) and np.allclose(
            stiffness, stiffness.T, rtol=1e-14
        ):
            squares, right = scipy.linalg.eigh(stiffness, mass)
            left = right
        else:
            values, left, right = scipy.linalg.eig(stiffness, mass, left=True)
            left = left.conj()
            if np.abs(values.imag).max() > 1e-10 * np.abs(values).max():
                raise InputError("stiffness: M^-1 K must have real eigenvalues")
            squares, left, right = values.real, left.real, right.real
    except np.linalg.LinAlgError:
        raise InputError("mass: must be positive definite or at least regular") from None
    if not (np.isfinite(squares).all() and squares.min() > 0):
        raise InputError(
            f"stiffness: M^-1 K has the eigenvalue {squares.min():g}, all must be greater than 0"
        )
    order = np.argsort(squares)
    return np.sqrt(squares[order]), left[:, order], right[:, order]
