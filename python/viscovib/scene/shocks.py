"""Shocks and records of a scene: loads in time, and shock response spectra."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import reduce
from typing import Any

import numpy as np

from viscovib import units
from viscovib._native import FloatArray
from viscovib.analyses.shock_spectra import ShockResponseSpectrum, shock_response_spectrum
from viscovib.results.trajectory import Trajectory
from viscovib.systems.base_acceleration import warn_of_record
from viscovib.systems.load_table import (
    Chirp,
    FormulaLoad,
    HalfSine,
    Haversine,
    LoadTable,
    PiecewiseTable,
    RunUp,
    Sawtooth,
    Step,
    Trapezoid,
    added,
)

_SHAPES: dict[str, Any] = {
    "half_sine": HalfSine, "haversine": Haversine, "chirp": Chirp, "sawtooth": Sawtooth,
    "trapezoid": Trapezoid, "step": Step,
}  # fmt: skip
_NUMBERS = ("start", "duration", "rise", "fall", "hz", "sweep", "speed", "hold", "unit")


def loads_in_time(groups: Sequence[Mapping[str, Any]], names: Sequence[str]) -> dict[str, Any]:
    """Return the arguments of `simulate` for the shocks and records of groups &load."""
    forces: list[LoadTable] = []
    accelerations: dict[str | None, list[LoadTable]] = {}
    for group in groups:
        if "shape" not in group:
            continue
        if group["kind"] != "acceleration":
            on = np.array([group["on"] == name for name in names], dtype=float)
            forces.append(_table(group, on))
        else:
            accelerations.setdefault(group.get("on"), []).append(_table(group, 1.0))
    found: dict[str, Any] = {}
    if forces:
        found["force"] = _sum(forces, len(names))
    if accelerations:
        sums = {on: _sum(tables, 0) for on, tables in accelerations.items()}
        found["base_acceleration"] = sums.get(None, sums)
    return found


def _table(group: Mapping[str, Any], on: float | FloatArray) -> LoadTable:
    """The load of a group along a direction."""
    given = {name: group[name] for name in _NUMBERS if name in group}
    size = group["amplitude"] * on
    if group["shape"] == "run_up":
        return RunUp(unbalance=size, phase=group["phase"], **given)
    if group["shape"] != "record":
        table: LoadTable = _SHAPES[group["shape"]](amplitude=size, **given)
        return table
    return LoadTable(times=group["times"], values=np.multiply.outer(group["values"], size), **given)


def _sum(tables: Sequence[LoadTable], n_dof: int) -> LoadTable:
    """Forces on coordinates together, or accelerations (``n_dof`` = 0)."""
    if len(tables) == 1:
        return tables[0]
    run_ups = [one for one in tables if isinstance(one, RunUp)]
    if len(run_ups) == len(tables) and all(_turns_with(run_ups[0], one) for one in run_ups):
        # One shaft turns them all.
        first = run_ups[0]
        turned = [np.exp(1j * (one.phase - first.phase)) for one in run_ups]
        sizes = [np.asarray(one.unbalance) for one in run_ups]
        return replace(first, unbalance=np.sum(np.multiply(np.transpose(sizes), turned), axis=1))
    parts = []
    for one in tables:
        factor = units.g if one.unit == "g" else 1.0
        values = np.asarray(one.values)
        if n_dof:
            pieces = one._pieces(n_dof)
        else:
            warn_of_record("base_acceleration", values, one.unit, not isinstance(one, FormulaLoad))
            pieces = factor * one._polynomials(values[:, np.newaxis])
        parts.append((np.asarray(one.times), pieces))
    return PiecewiseTable.of(*reduce(added, parts))


def _turns_with(one: RunUp, other: RunUp) -> bool:
    """True if both run-ups have the same speed at all times."""
    numbers = [np.append(x.speed, [x.start, x.duration, x.hold]) for x in (one, other)]
    return bool((numbers[0] == numbers[1]).all())


def shock_spectrum(
    group: Mapping[str, Any], hz: FloatArray, run: Trajectory
) -> ShockResponseSpectrum:
    """Return the spectrum that a group &shock_spectrum requests at frequencies."""
    record: Trajectory | LoadTable = run
    if "coordinate" not in group:
        record = LoadTable(times=group["times"], values=group["values"], unit=group["unit"])
    return shock_response_spectrum(
        record, hz, coordinate=group.get("coordinate"), damping=group["damping"],
        kind=group["kind"],
    )  # fmt: skip
