"""Largest values along a motion in time, located between the states kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.values import Value
from viscovib.errors import InputError

#: Local axes of a mount.
_AXES = ("x", "y", "z")


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


@dataclass(frozen=True, eq=False, repr=False)
class LocatedPeaks(Value):
    """The largest values of a quantity along the motions of an ensemble.

    Attributes
    ----------
    name : str
        The quantity.
    value, t, error : ndarray, shape (n,)
        As of `LocatedPeak`, of each motion; NaN for a motion that ended early.

    Examples
    --------
    >>> import viscovib as vv
    >>> swing = vv.PolynomialSystem(mass=1, stiffness=1)
    >>> many = vv.simulate_ensemble(swing, initial=[[0, 1], [0, 2]], t_end=4, peaks=["x_ddot"])
    >>> many.peaks[0].value.round(9).tolist()
    [-1.0, -2.0]
    """

    name: str
    value: FloatArray
    t: FloatArray
    error: FloatArray


Quantity = str | Callable[[Any], Any]


def find_peaks(run: Any, quantities: Sequence[Quantity]) -> list[LocatedPeak]:
    """Peaks of quantities of a run, each by its name or by a function of a run."""
    if run.t.size < 2:
        raise InputError(f"peak: {run.t.size} states kept, must be at least 2")
    named = named_quantities(run, quantities)
    kept = np.empty((run.t.size, len(named)), order="F")
    for k, (name, function) in enumerate(named):
        kept[:, k] = _values(name, function, run)
    breaks = getattr(run._resume, "breaks", np.empty(0))
    found, windows = _located(run.t, kept, breaks)
    if windows:
        wanted = np.unique(np.concatenate([times for times, _ in windows.values()]))
        fine = replace(run, t=wanted, state=run(wanted))
        for k, (t, ends) in windows.items():
            values = _values(*named[k], fine)[np.searchsorted(wanted, t), np.newaxis]
            found[k] = _located(t, values, np.unique(np.concatenate([breaks, ends])))[0]
    if run.error is not None:
        # As much of it as the motion is off by of itself.
        found[:, 2] += run.error * np.abs(found[:, 0]) / max(np.abs(run.state).max(), 1e-300)
    return [LocatedPeak(name, *one) for (name, _), one in zip(named, found.tolist(), strict=True)]


def _located(
    t: FloatArray, values: FloatArray, breaks: FloatArray
) -> tuple[FloatArray, dict[int, tuple[FloatArray, FloatArray]]]:
    """Return values, times and errors of peaks, shape (m, 3), of samples (n, m).

    Also, for quantities that need more samples, their times and the ends of separate windows.
    """
    found = _native.run("motion peaks", t=t, values=values, breaks=breaks)
    windows = {k - 1: (found[f"times_{k}"], found[f"ends_{k}"]) for k in found["loose"].tolist()}
    return np.stack([found["peak"], found["at"], found["error"]], axis=1), windows


def _values(name: str, function: Callable[[Any], Any], run: Any) -> FloatArray:
    values = np.asarray(function(run), dtype=float)
    if values.shape != run.t.shape:
        raise InputError(f"{name}: must return shape {run.t.shape}, got {values.shape}")
    if not np.isfinite(values).all():
        raise InputError(f"{name}: has values that are not finite along the motion")
    return values


def named_quantities(run: Any, given: Sequence[Quantity]) -> list[tuple[str, Callable[[Any], Any]]]:
    """Quantities by their names, and the functions that give them along a run."""
    if isinstance(given, str) or not isinstance(given, Sequence):
        raise InputError(f"peaks = {_native.shown(given)}: must be a list of names and functions")
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
    found = []
    for one in given:
        if isinstance(one, str):
            found.append((_native.choice("quantity", one, tuple(known)), known[one]))
        elif callable(one):
            found.append((getattr(one, "__name__", "quantity"), one))
        else:
            raise InputError(
                f"quantity = {_native.shown(one)}: must be a name, a function of a run, or a "
                "list of these"
            )
    return found


def _column(name: str, place: int, run: Any) -> Any:
    return getattr(run, name)[:, place]


def _of_mount(mount: int, axis: int, run: Any) -> Any:
    return run._mount_forces.force[:, mount, axis]


def _of_floor(axis: int, run: Any) -> Any:
    return run._floor_force.force[:, axis]
