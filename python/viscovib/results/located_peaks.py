"""Largest values along a motion in time, located between the states kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.values import Value
from viscovib.errors import InputError

#: Local axes of a mount.
_AXES = ("x", "y", "z")
#: Intervals between Chebyshev points around a state; every second point gives the error.
_INTERVALS = 16
#: States around which a peak may be: as large as this part of the largest, and how many.
_NEAR, _MOST = 0.9, 4
#: Places at which the polynomial through the points is looked at.
_FINE = 201


@dataclass(frozen=True)
class LocatedPeak(Value):
    """The largest value of a quantity along a motion.

    Attributes
    ----------
    name : str
        The quantity.
    value : float
        The value, with its sign, of the largest magnitude.
    t : float
        Its time.
    error : float
        Estimated error of the value: of its location, and of the motion if the run has an
        estimate.

    Examples
    --------
    >>> import viscovib as vv
    >>> swing = vv.PolynomialSystem(mass=1, stiffness=1)
    >>> run = vv.simulate(swing, 4, dt=0.4, initial=[0, 1])
    >>> top = run.peak("x")
    >>> round(top.value, 10), round(top.t, 6)
    (1.0, 1.570796)
    """

    name: str
    value: float
    t: float
    error: float


Quantity = str | Callable[[Any], Any]


def find_peaks(run: Any, quantities: Sequence[Quantity]) -> list[LocatedPeak]:
    """Peaks of quantities of a run, each by its name or by a function of a run."""
    if run.t.size < 2:
        raise InputError(f"peak: {run.t.size} states kept, must be at least 2")
    named = [_quantity(run, one) for one in quantities]
    kept = [_values(name, function, run) for name, function in named]
    windows = [_windows(run.t, values) for values in kept]
    chebyshev = (1 - np.cos(np.pi * np.arange(_INTERVALS + 1) / _INTERVALS)) / 2
    points = [[a + (b - a) * chebyshev for a, b in one] for one in windows]
    wanted = np.unique(np.concatenate([p for one in points for p in one]))
    fine = replace(run, t=wanted, state=run(wanted))
    found = []
    for (name, function), at_kept, own in zip(named, kept, points, strict=True):
        places = np.array(own)
        values = _values(name, function, fine)[np.searchsorted(wanted, places)]
        (tops, at), (coarse, _) = _tops(values, 1), _tops(values, 2)
        k = int(np.abs(tops).argmax())
        value = float(tops[k])
        t = float(places[k, 0] + (places[k, -1] - places[k, 0]) * (at[k] + 1) / 2)
        error = abs(abs(value) - abs(float(coarse[k])))
        if run.error is not None:
            # As much of it as the motion is off by of itself.
            error += run.error * abs(value) / max(float(np.abs(run.state).max()), 1e-300)
        error = max(error, 4 * np.finfo(float).eps * float(np.abs(at_kept).max()))
        found.append(LocatedPeak(name, value, t, error))
    return found


def _windows(t: FloatArray, values: FloatArray) -> list[tuple[float, float]]:
    """Times before and after the states near the largest values."""
    size = np.abs(values)
    above = np.concatenate([[-1.0], size, [-1.0]])
    high = size >= _NEAR * float(size.max())
    tops = np.flatnonzero(high & (size >= above[:-2]) & (size >= above[2:]))
    tops = tops[np.argsort(-size[tops], kind="stable")][:_MOST]
    before, after = np.maximum(tops - 1, 0), np.minimum(tops + 1, t.size - 1)
    return list(zip(t[before].tolist(), t[after].tolist(), strict=True))


@cache
def _fit(n: int) -> tuple[FloatArray, FloatArray]:
    """From values at n + 1 Chebyshev points to coefficients, and from these to a grid."""
    orders = np.arange(n + 1)
    # The ends count half, and so do their orders.
    weights = np.where((orders == 0) | (orders == n), 0.5, 1.0)
    cosines = np.cos(np.outer(np.pi * (1 - orders / n), orders))
    grid = np.linspace(-1, 1, _FINE)
    return weights[:, np.newaxis] * cosines * (weights * 2 / n), np.cos(
        np.outer(orders, np.arccos(grid))
    )


def _tops(values: FloatArray, step: int) -> tuple[FloatArray, FloatArray]:
    """Largest values of the polynomials through every ``step``-th point, and their places.

    ``values``: shape (m, _INTERVALS + 1), at Chebyshev points of [-1, 1].
    """
    n = _INTERVALS // step
    to_coefficients, on_grid = _fit(n)
    coefficients = values[:, ::step] @ to_coefficients
    size = np.abs(coefficients @ on_grid)
    rows = np.arange(size.shape[0])
    i = size.argmax(axis=1)
    inner = np.clip(i, 1, _FINE - 2)
    before, here, after = (size[rows, inner + k] for k in (-1, 0, 1))
    bend = before - 2 * here + after
    shift = np.where(
        (i == inner) & (bend < 0), 0.5 * (before - after) / np.minimum(bend, -1e-300), 0
    )
    at = np.clip(-1 + (i + np.clip(shift, -1, 1)) * 2 / (_FINE - 1), -1, 1)
    there = np.cos(np.arccos(at)[:, np.newaxis] * np.arange(n + 1))
    return (coefficients * there).sum(axis=1), at


def _values(name: str, function: Callable[[Any], Any], run: Any) -> FloatArray:
    values = np.asarray(function(run), dtype=float)
    if values.shape != run.t.shape:
        raise InputError(f"{name}: must return shape {run.t.shape}, got {values.shape}")
    if not np.isfinite(values).all():
        raise InputError(f"{name}: has values that are not finite along the motion")
    return values


def _quantity(run: Any, given: Quantity) -> tuple[str, Callable[[Any], Any]]:
    """A quantity by its name, and the function that gives it along a run."""
    if not isinstance(given, str):
        if not callable(given):
            raise InputError(
                f"quantity = {_native.shown(given)}: must be a name, a function of a run, or a "
                "list of these"
            )
        return getattr(given, "__name__", "quantity"), given
    known: dict[str, Callable[[Any], Any]] = {}
    for d, name in enumerate(run.dof_names):
        known[name] = partial(_column, "state", 2 * d)
        known[f"{name}_dot"] = partial(_column, "state", 2 * d + 1)
        known[f"{name}_ddot"] = partial(_column, "acceleration", d)
    mounts = getattr(run.system, "mounts", ())
    for i, mount in enumerate(mounts):
        for j, axis in enumerate(_AXES):
            known[f"{mount.name}.{axis}"] = partial(_of_mount, i, j)
    for j, axis in enumerate(_AXES if mounts else ()):
        known[f"floor.{axis}"] = partial(_of_floor, j)
    _native.choice("quantity", given, tuple(known))
    return given, known[given]


def _column(name: str, place: int, run: Any) -> Any:
    return getattr(run, name)[:, place]


def _of_mount(mount: int, axis: int, run: Any) -> Any:
    return run._mount_forces.force[:, mount, axis]


def _of_floor(axis: int, run: Any) -> Any:
    return run._floor_force.force[:, axis]
