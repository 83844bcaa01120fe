"""Accelerations of the base: the loads -M b a(t) of coordinates relative to it."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from viscovib import _native, units
from viscovib._native import ComplexArray, FloatArray
from viscovib.common.values import Value
from viscovib.errors import InputError, RangeWarning, caller
from viscovib.systems.load import LoadLike, load_series, name_places
from viscovib.systems.load_table import FormulaLoad, LoadTable, PiecewiseTable, added, table_at


@dataclass(frozen=True)
class BaseMotion(Value):
    """How a base moves the coordinates: accelerations by polynomials from rest, and sinusoids.

    ``tables``: of each the direction (n,), the times and the polynomials (n_powers, m).
    ``amplitudes``: of accelerations, shape (n, k), with ``frequencies`` (k,).
    """

    tables: tuple[tuple[FloatArray, FloatArray, FloatArray], ...]
    frequencies: FloatArray
    amplitudes: ComplexArray

    def push(self, t: FloatArray) -> FloatArray:
        """Accelerations at times, shape (n_times, n)."""
        waves = np.exp(1j * np.outer(t, self.frequencies))
        found: FloatArray = (waves @ self.amplitudes.T).imag
        for direction, times, pieces in self.tables:
            found += np.multiply.outer(table_at(times, pieces[np.newaxis], t)[:, 0], direction)
        return found

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Displacements, velocities and accelerations at times, each of shape (n_times, n)."""
        from scipy.interpolate import PPoly

        waves = self.amplitudes * np.exp(1j * t[:, np.newaxis, np.newaxis] * self.frequencies)
        slow = np.where(self.frequencies > 0, self.frequencies, 1.0)
        parts = [(waves / (1j * slow) ** k).imag.sum(axis=2) for k in (2, 1)]
        for direction, times, pieces in self.tables:
            a = PPoly(pieces[:, :-1], times)
            inside = np.clip(t, times[0], times[-1])
            speed = a.antiderivative()(inside)
            place = a.antiderivative(2)(inside) + speed * np.maximum(t - times[-1], 0.0)
            for part, own in zip(parts, (place, speed), strict=True):
                part += np.multiply.outer(own, direction)
        return parts[0], parts[1], self.push(t)


def relative_loads(
    system: Any, acceleration: Any, load: LoadLike | None, nu: Any, force: LoadTable | None
) -> tuple[LoadLike | None, LoadTable | None, BaseMotion]:
    """Return all loads on coordinates relative to a base, and the motion of the base."""
    n = len(system.dof_names)
    named = isinstance(acceleration, Mapping) and any(isinstance(k, str) for k in acceleration)
    parts = acceleration.items() if named else [(None, acceleration)]
    series: dict[int, ComplexArray] = {}
    waves: dict[int, ComplexArray] = {}
    tables = []
    for name, part in parts:
        where = "base_acceleration" if name is None else f"base_acceleration[{name!r}]"
        direction = _direction(system, where, name)
        push = -_inertia(system, where, direction)
        if isinstance(part, LoadTable):
            pieces = _polynomials(where, part)
            times = np.asarray(part.times)
            force = _with_table(times, pieces, push, force)
            tables.append((direction, times, pieces))
            continue
        if isinstance(part, (str, bytes)):
            raise InputError(
                f"{where} = {_native.shown(part)}: must be a LoadTable, a shock such as HalfSine, "
                "a number or {order: number}"
            )
        orders, found = load_series(part, None, 1)
        for order, value in zip(orders.tolist(), found[0], strict=True):
            series[order] = series.get(order, 0) + push * value
            waves[order] = waves.get(order, 0) + direction * value
    if series:
        orders, found = load_series(load, None, n, name_places(system.dof_names))
        for order, column in zip(orders.tolist(), found[:n].T, strict=True):
            series[order] = series.get(order, 0) + column
        load = series
    frequencies = np.array(list(waves), dtype=float) * (nu or 0.0)
    amplitudes = np.array(list(waves.values()), dtype=complex).reshape(-1, n).T
    return load, force, BaseMotion(tuple(tables), frequencies, amplitudes)


def _direction(system: Any, where: str, name: str | None) -> FloatArray:
    """Return the direction in which the base moves the coordinates."""
    n = len(system.dof_names)
    direction = system._base_direction
    if name is not None:
        names: tuple[str, ...] = getattr(system, "_base_names", ())
        if name not in names:
            raise InputError(
                f"{where}: must be one of {', '.join(names)}"
                if names
                else f"{where}: the base of this system moves along its base_direction, must have "
                "no name"
            )
        direction = np.zeros(n)
        direction[names.index(name)] = 1.0
        system._check_base_motion(direction[: len(names), np.newaxis])
        space = getattr(system, "_space", None)
        if space is not None and any((matrix @ direction).any() for matrix in space):
            raise InputError(
                f"{where}: the weight or the spin does not turn with the base, must be a motion of "
                "the base (base=)"
            )
    elif direction is None:
        raise InputError(
            f"{where}: this system has no base_direction: give it one, or the acceleration of a "
            f"coordinate, as {{{system.dof_names[-1]!r}: ...}}"
        )
    return np.asarray(direction, dtype=float)


def _inertia(system: Any, where: str, direction: FloatArray) -> FloatArray:
    """Return M b, for the direction b in which the base moves."""
    mass = system._mass_matrix if hasattr(system, "_mass_matrix") else system.mass
    push = np.asarray(mass @ direction, dtype=float)
    held = system._held
    if held is not None:
        if held.strains:
            raise InputError(
                f"{where}: the base deforms springs or dampers, so its displacement matters: give "
                "base, or a base_direction without deformation"
            )
        push = push + held.mass
    if not push.any():
        raise InputError(f"{where}: no mass moves in this direction of the base")
    return push


def _polynomials(where: str, table: LoadTable) -> FloatArray:
    """Return the polynomials (n_powers, m) of an acceleration in m/s^2."""
    values = np.asarray(table.values)
    if values.shape[1:] == (1,):
        values = values[:, 0]
    if values.ndim != 1 or table.on is not None:
        raise InputError(f"{where}: must have values of shape (n,), without on")
    if not isinstance(table, PiecewiseTable):
        warn_of_record(where, values, table.unit, not isinstance(table, FormulaLoad))
    factor = units.g if table.unit == "g" else 1.0
    return np.asarray(factor * table._polynomials(values[:, np.newaxis])[0])


def _with_table(
    times: FloatArray, pieces: FloatArray, push: FloatArray, force: LoadTable | None
) -> LoadTable:
    """Return a load in time with that of an acceleration."""
    if force is None and push.size == 1:
        return PiecewiseTable.of(times, push[0] * pieces[np.newaxis])
    if force is None:
        # One direction, however many coordinates there are.
        return PiecewiseTable.of(times, pieces[np.newaxis], on=push)
    if not isinstance(force, LoadTable):
        raise InputError(f"force = {_native.shown(force)}: must be a LoadTable")
    own = times, np.multiply.outer(push, pieces)
    return PiecewiseTable.of(*added((np.asarray(force.times), force._pieces(push.size)), own))


def warn_of_record(name: str, values: FloatArray, unit: str, is_record: bool) -> None:
    """Warn of a unit that looks wrong, and of an offset of a record."""
    doubts: str = _native.run(
        "spectrum doubts", name=name, unit=unit, is_record=is_record,
        values=values * (units.g if unit == "g" else 1.0),
    )["text"]  # fmt: skip
    for doubt in doubts.splitlines():
        warnings.warn(doubt, RangeWarning, stacklevel=caller())
