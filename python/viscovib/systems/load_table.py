"""Loads in time from tables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.values import own_fields, short_repr
from viscovib.errors import InputError

#: Pieces of a half sine: the spline is off by 6e-11 of its peak.
_PIECES = 256
#: Two times of a base closer than this, relative to the last, are a jump.
_JUMP = 1e-12


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class LoadTable:
    """A load given at times; 0 before the first and after the last time.

    As ``base`` of `simulate` it is a displacement of the base, constant before the first and after
    the last time.

    Parameters
    ----------
    times : array_like, shape (n,)
        Strictly ascending (s), n >= 2.
    values : array_like, shape (n,) or (n, n_dof)
        Force on the first coordinate, or on each (N, N m). For a base: shape (n,), its displacement
        (m), or a column for each coordinate (for a body x, y, z, rx, ry, rz).
    on : str, int, mapping or array_like, optional
        For a `Structure` with values of shape (n,): direction of the load, as ``on`` of a `Spring`.
    interpolation : {"linear", "cubic"}
        Straight lines, or a spline that is twice continuously differentiable. Steps in time end on
        every corner and end, so the order of the integrator is kept.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> mount = vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2)
    >>> shock = vv.LoadTable(times=[0, 0.1, 0.2], values=[[0, 0], [5, 0], [0, 0]])
    >>> run = vv.simulate(mount, 2, force=shock)
    """

    times: npt.ArrayLike
    values: npt.ArrayLike
    interpolation: str = "linear"
    on: Any = None
    _kinds: ClassVar[tuple[str, ...]] = ("linear", "cubic")

    __repr__ = short_repr

    def __post_init__(self) -> None:
        own_fields(self, "on")
        _native.choice("interpolation", self.interpolation, self._kinds)
        for name in ("times", "values"):
            array = _native.real_array(name, getattr(self, name)).copy()
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        times, values = np.asarray(self.times), np.asarray(self.values)
        if times.ndim != 1 or times.size < 2:
            raise InputError(f"times: must have shape (n,) with n >= 2, got {times.shape}")
        wrong = np.flatnonzero(np.diff(times) <= 0)
        if wrong.size:
            i = int(wrong[0])
            raise InputError(
                f"times[{i + 1}] = {times[i + 1]:g} after {times[i]:g}: must be strictly ascending"
            )
        if values.ndim not in (1, 2) or values.shape[0] != times.size:
            raise InputError(
                f"values: must have shape ({times.size},) or ({times.size}, n_dof), "
                f"got {values.shape}"
            )

        if self.on is not None and values.ndim == 2:
            raise InputError("on: must not be given with values for every coordinate")

    @classmethod
    def half_sine(
        cls, peak: npt.ArrayLike, duration: float, *, start: float = 0.0, on: Any = None
    ) -> LoadTable:
        """Return a half-sine shock peak sin(pi (t - start)/duration), to 6e-11 of its peak.

        Parameters
        ----------
        peak : float or array_like, shape (n_dof,)
            Force on the first coordinate, or on each (N, N m), for example from `Body.load`. An
            acceleration a of the floor acts on the relative motion as the force -m a.
        duration, start : float
            Times (s).
        on : str, int, mapping or array_like, optional
            As for `LoadTable`.

        Examples
        --------
        >>> import viscovib as vv
        >>> shock = vv.LoadTable.half_sine(50.0, 0.011)
        >>> round(float(shock(0.0055)), 6)
        50.0
        """
        places = np.linspace(0.0, 1.0, _PIECES + 1)
        return cls._shock(peak, duration, start, on, places, np.sin(np.pi * places), "cubic")

    @classmethod
    def sawtooth(
        cls, peak: npt.ArrayLike, duration: float, *, start: float = 0.0, on: Any = None
    ) -> LoadTable:
        """Return a terminal-peak sawtooth: a shock that grows linearly to its peak and ends there.

        Parameters
        ----------
        peak, duration, start, on
            As for `half_sine`.

        Examples
        --------
        >>> import viscovib as vv
        >>> shock = vv.LoadTable.sawtooth(50.0, 0.011)
        >>> round(float(shock(0.0055)), 6)
        25.0
        """
        ends = np.array([0.0, 1.0])
        return cls._shock(peak, duration, start, on, ends, ends, "linear")

    @classmethod
    def _shock(
        cls, peak: npt.ArrayLike, duration: float, start: float, on: Any, places: FloatArray,
        shape: FloatArray, interpolation: str,
    ) -> LoadTable:  # fmt: skip
        size = _native.real_array("peak", peak)
        if size.ndim > 1:
            raise InputError(f"peak: must be a number or have shape (n_dof,), got {size.shape}")
        length, begin = _native.number("duration", duration), _native.number("start", start)
        if not length > 0:
            raise InputError(f"duration = {length:g}: must be greater than 0")
        values = shape * size if size.ndim == 0 else np.multiply.outer(shape, size)
        return cls(times=begin + length * places, values=values, interpolation=interpolation, on=on)

    def __call__(self, t: npt.ArrayLike) -> FloatArray:
        """Load at times t, shape t.shape + values.shape[1:]."""
        from scipy.interpolate import CubicSpline

        at = _native.real_array("t", t)
        times, values = np.asarray(self.times), np.asarray(self.values)
        columns = values.reshape(times.size, -1)
        if self.interpolation == "cubic":
            result = CubicSpline(times, columns)(at)
        else:
            result = np.stack([np.interp(at, times, column) for column in columns.T], axis=-1)
        result = np.where(((at >= times[0]) & (at <= times[-1]))[..., np.newaxis], result, 0.0)
        return np.asarray(result.reshape(at.shape + values.shape[1:]))

    def _pieces(self, n_dof: int) -> FloatArray:
        """Cubics between the times as the core takes them, shape (n_dof, 4, n)."""
        return self._cubics(self._columns(n_dof))

    def _cubics(self, values: FloatArray) -> FloatArray:
        """The same of columns, shape (n, n_columns)."""
        from scipy.interpolate import CubicSpline

        n_dof = values.shape[1]
        times = np.asarray(self.times)
        pieces = np.zeros((n_dof, 4, times.size), order="F")
        if self.interpolation == "cubic":
            pieces[:, :, :-1] = np.moveaxis(CubicSpline(times, values).c, 2, 0)
        else:
            pieces[:, 2, :-1] = (np.diff(values, axis=0) / np.diff(times)[:, np.newaxis]).T
            pieces[:, 3, :-1] = values[:-1].T
        return pieces

    def _breaks(self, n_dof: int) -> FloatArray:
        """Times at which a piece does not go on smoothly into the next, and the ends."""
        times, values = np.asarray(self.times), np.asarray(self.values)
        one = values.ndim == 1
        pieces = self._cubics(values[:, np.newaxis] if one else self._columns(n_dof))
        length = np.diff(times)
        # Value and derivatives at both ends of each piece, by order.
        a = pieces[:, :, :-1]
        begin = np.stack([a[:, 3], a[:, 2], 2 * a[:, 1], 6 * a[:, 0]])
        end = np.stack(
            [
                ((a[:, 0] * length + a[:, 1]) * length + a[:, 2]) * length + a[:, 3],
                (3 * a[:, 0] * length + 2 * a[:, 1]) * length + a[:, 2],
                6 * a[:, 0] * length + 2 * a[:, 1],
                6 * a[:, 0],
            ]
        )
        # Relative to the two pieces that meet: a steep one elsewhere hides no corner.
        size = np.maximum(np.abs(begin), np.abs(end))
        size = np.maximum(size[:, :, 1:], size[:, :, :-1])
        jumps = np.abs(begin[:, :, 1:] - end[:, :, :-1]) > 1e-11 * size
        inner = times[1:-1][jumps.any(axis=(0, 1))]
        return np.concatenate([times[:1], inner, times[-1:]])

    @property
    def _columned(self) -> bool:
        """Whether it has a column for each coordinate."""
        return np.asarray(self.values).ndim == 2

    def _base_pieces(self, n_columns: int = 0, n_dof: int = 1) -> FloatArray:
        """Cubics between times of displacements of the base, shape (4, q, n), the last for ever.

        0 columns: one displacement, q = 1; else one for each of the first coordinates, q = n_dof.
        """
        times, values = np.asarray(self.times), np.asarray(self.values)
        wanted = (times.size, n_columns) if n_columns else (times.size,)
        if values.shape != wanted:
            raise InputError(f"base: values must have shape {wanted}, got {values.shape}")
        columns = np.zeros((times.size, n_dof if n_columns else 1))
        columns[:, : max(n_columns, 1)] = values.reshape(times.size, -1)
        short = np.diff(times) < _JUMP * np.abs(times).max()
        jumps = short[:, np.newaxis] & (np.diff(columns, axis=0) != 0)
        if jumps.any():
            i, j = np.argwhere(jumps)[0]
            raise InputError(
                f"base: moves from {columns[i, j]:g} to {columns[i + 1, j]:g} within "
                f"{np.diff(times)[i]:g} at t = {times[i]:g}, must not jump: take a longer ramp"
            )
        pieces = self._cubics(columns)
        pieces[:, 3, -1] = columns[-1]
        return np.asfortranarray(np.moveaxis(pieces, 0, 1))

    def _columns(self, n_dof: int) -> FloatArray:
        values = np.asarray(self.values)
        if self.on is not None:
            raise InputError("on: is for the load of a Structure")
        if values.ndim == 1:
            columns = np.zeros((values.size, n_dof))
            columns[:, 0] = values
            return columns
        if values.shape[1] != n_dof:
            raise InputError(
                f"values: must have {n_dof} columns for this system, got {values.shape[1]}"
            )
        return values


def added(
    one: tuple[FloatArray, FloatArray], other: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """The sum of two tables, each by its times and cubics of shape (n_dof, 4, n)."""
    times = np.union1d(one[0], other[0])
    total = np.zeros((one[1].shape[0], 4, times.size), order="F")
    middle = (times[1:] + times[:-1]) / 2
    for own, pieces in (one, other):
        place = np.searchsorted(own, middle, side="right") - 1
        inside = (place >= 0) & (place < own.size - 1)
        a, b, c, d = np.moveaxis(pieces[:, :, place[inside]], 1, 0)
        x = times[:-1][inside] - own[place[inside]]
        shifted = np.stack(
            [a, b + 3 * x * a, c + x * (2 * b + 3 * x * a), d + x * (c + x * (b + x * a))], axis=1
        )
        total[:, :, :-1][:, :, inside] += shifted
    return times, total
