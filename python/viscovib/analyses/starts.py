"""Starting motions: a point of a result, harmonics, or the end of a motion in time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.common.periodic_motions import PeriodicMotions
from viscovib.errors import InputError
from viscovib.systems.condensed import LoadedStructure
from viscovib.systems.load import Job, base_shifts

#: Types of ``start``: (result, i), {order: X_k} or a Trajectory.
StartLike: TypeAlias = Any

#: Even harmonics below this part of the largest keep the symmetry: for a computed motion, and for
#: the end of a motion in time, which may not have settled.
_SMALL, _SETTLING = 1e-8, 1e-2
#: Smallest number of times per period for its harmonics; highest fitted harmonic.
_FEWEST_TIMES, _HIGHEST_FITTED = 16, 20
_WORDS = (
    "must be (result, i) for the i-th motion of a response or branch, {order: X_k} with a number "
    "of each coordinate, or a Trajectory"
)


class Start(NamedTuple):
    """Orders, shape (m,), X_k of named coordinates, shape (n, m), and their origin."""

    orders: Any
    names: tuple[str, ...]
    coefficients: ComplexArray
    #: Frequency (rad/s) and load factor of the motion; None: unknown.
    nu: float | None
    load_factor: float | None
    #: For a structure: X_k of the condensed coordinates, relative to the base, and the directions
    #: of these coordinates.
    condensed: ComplexArray | None = None
    directions: FloatArray | None = None
    small: float = _SMALL

    @property
    def has_even(self) -> bool:
        """True if the motion has no half-wave symmetry."""
        sizes = np.abs(self.coefficients).max(axis=0, initial=0.0)
        return bool((sizes[self.orders % 2 == 0] > self.small * sizes.max(initial=0.0)).any())

    def place(self, varies: str, first: float, last: float) -> float:
        """Start of a branch: the parameter value of the motion if the range contains it."""
        own = {"nu": self.nu, "load_factor": self.load_factor}.get(varies)
        inside = own is not None and min(first, last) <= own <= max(first, last)
        return own if inside and own is not None else first

    def unknowns(
        self, orders: Any, job: Job, direction: FloatArray | None, factor: float,
        names: tuple[str, ...], loaded: LoadedStructure | None,
    ) -> FloatArray:  # fmt: skip
        """Unknowns of the core, relative to the base, for the given orders, shape (2 m n_dof,)."""
        if loaded is not None:
            relative = self._of_structure(loaded, names, factor)
        else:
            relative = self._of(names)
            for order, moved in base_shifts(job.orders, job.series, direction):
                relative[:, self.orders == order] -= factor * moved[:, np.newaxis]
        x = np.zeros((relative.shape[0], orders.size), dtype=complex)
        for j, order in enumerate(self.orders):
            x[:, orders == order] = relative[:, j : j + 1]
        return np.stack([x.real, x.imag], axis=-1).reshape(-1)

    def _of(self, names: tuple[str, ...]) -> ComplexArray:
        """X_k of all coordinates of a system."""
        lacking = [name for name in names if name not in self.names]
        if lacking:
            raise InputError(f"start: lacks coordinate {lacking[0]!r}, must have all of them")
        return self.coefficients[[self.names.index(name) for name in names]].copy()

    def _of_structure(
        self, loaded: LoadedStructure, names: tuple[str, ...], factor: float
    ) -> ComplexArray:
        directions = loaded.condensation.laws.directions
        own = self.directions
        if self.condensed is not None and own is not None and np.array_equal(own, directions):
            return self.condensed.copy()
        used = np.flatnonzero(directions.any(axis=1))
        seen = self._of(tuple(names[i] for i in used))
        return directions[used].T @ seen - factor * loaded.base_motion(self.orders)


def start_of(start: Any, names: tuple[str, ...], nu: float) -> Start:
    """Check and convert a start of a system with these coordinates and the frequency ``nu``."""
    from viscovib.results.trajectory import Trajectory

    if isinstance(start, Trajectory):
        return _end_of(start, nu)
    if isinstance(start, Mapping):
        return _of_harmonics(start, names)
    if not (isinstance(start, tuple) and len(start) == 2 and isinstance(start[0], PeriodicMotions)):
        raise InputError(f"start = {_native.shown(start)}: {_WORDS}")
    result: Any = start[0]
    there, orders, coefficients = result._motions()
    if np.ndim(orders) != 1:
        raise InputError("start: has several base frequencies, must be a periodic motion")
    i = _native.integer("start index", start[1], -there.size, there.size - 1)
    if not np.isfinite(coefficients[i]).all():
        raise InputError(f"start: no solution was found at index {i} of this result")
    condensed = getattr(result, "_condensed", None)
    view = getattr(result, "_view", None)
    factors = getattr(result, "load_factor", None)
    return Start(
        np.asarray(orders), tuple(result.dof_names), coefficients[i], float(there[i]),
        None if factors is None else float(factors[i]),
        None if view is None or condensed is None else condensed[i],
        None if view is None else view.loaded.condensation.laws.directions,
    )  # fmt: skip


def _of_harmonics(start: Mapping[Any, Any], names: tuple[str, ...]) -> Start:
    orders = [_native.integer("start order", order, 0, 100_000) for order in start]
    if not orders:
        raise InputError(f"start = {{}}: {_WORDS}")
    columns = []
    for order, value in start.items():
        where = f"start[{order}]"
        if isinstance(value, Mapping):
            column = np.zeros(len(names), dtype=complex)
            for name, x in value.items():
                if name not in names:
                    raise InputError(f"{where}: {_native.shown(name)} is not a coordinate")
                column[names.index(name)] = _native.complex_array(f"{where}[{name!r}]", x, ndim=0)
        else:
            column = np.atleast_1d(_native.complex_array(where, value))
        if column.shape != (len(names),):
            raise InputError(f"{where}: must have shape ({len(names)},), got {column.shape}")
        columns.append(column)
    return Start(np.array(orders), names, np.stack(columns, axis=1), None, None)


def _end_of(run: Any, nu: float) -> Start:
    """Harmonics of the last period of a motion in time, by least squares of u and u'."""
    period = 2 * np.pi / nu
    last = run.t >= run.t[-1] - period
    t = run.t[last]
    if t.size < _FEWEST_TIMES or t[-1] - t[0] < 0.9 * period:
        raise InputError(
            f"start: the trajectory holds {t.size} states in its last period 2 pi/nu = "
            f"{period:.6g}, must be at least {_FEWEST_TIMES}: use a smaller save_every"
        )
    orders, x = _fitted(t, nu, np.asarray(run.state)[last, ::2], np.asarray(run.state)[last, 1::2])
    condensed, directions = None, None
    if hasattr(run, "deflections"):
        _, condensed = _fitted(t, nu, run.deflections[last], run.rates[last])
        directions = run.system._condensation.laws.directions
    return Start(orders, tuple(run.dof_names), x, None, None, condensed, directions, _SETTLING)


def _fitted(t: FloatArray, nu: float, u: FloatArray, v: FloatArray) -> tuple[Any, ComplexArray]:
    """Orders and harmonics, shape (n, m), of coordinates and velocities at times (len(t), n)."""
    highest = min(_HIGHEST_FITTED, t.size // 3)
    orders = np.arange(highest + 1)
    phase = np.outer(t, orders * nu)
    # u = sum a_k sin + b_k cos, X_k = a_k + i b_k.
    of_u = np.hstack([np.sin(phase[:, 1:]), np.cos(phase)])
    of_v = np.hstack([np.cos(phase[:, 1:]) * orders[1:], -np.sin(phase) * orders])
    scale = 1 / highest
    values = np.vstack([u, scale * v / nu])
    found = np.linalg.lstsq(np.vstack([of_u, scale * of_v]), values, rcond=None)[0]
    x = 1j * found[highest:].T
    x[:, 1:] += found[:highest].T
    return orders, x
