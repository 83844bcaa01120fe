"""Loads of a structure in time as columns with directions, and checks of loads."""

from __future__ import annotations

import warnings
from typing import TypeAlias

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.errors import InputError, StabilityWarning, caller
from viscovib.systems.condensed import LoadedStructure
from viscovib.systems.elements import direction_of
from viscovib.systems.layers import finite_at_first
from viscovib.systems.load_table import LoadTable
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.structure import Structure

#: Systems that are condensed.
Condensed: TypeAlias = Structure | PolynomialSystem
#: Combinations of columns of a table below this relative size are rounding errors.
_ROUNDING = 1e-15


def check_forces(structure: Condensed, loaded: LoadedStructure, patterns: FloatArray) -> None:
    """Refuse forces for which the linear subsystem has no motion in time."""
    reduced = getattr(structure, "_reduced", None)
    if reduced is not None:
        reduced.check_loads(patterns.astype(complex), structure.dof_names)
    rest, laws = loaded.condensation.rest, loaded.condensation.laws
    if rest.flexibility is None:
        return
    if any(kernel is not None and not finite_at_first(kernel) for kernel in laws.kernels):
        moved, _ = rest.flexibility(laws.directions)
        if moved.any():
            i = int(np.flatnonzero(moved.any(axis=1))[0])
            raise InputError(
                f"elements: a kernel that is infinite at first acts on a coordinate without mass "
                f"({structure.dof_names[i]}), whose rate has no limit there; must have mass, or a "
                "kernel that is a sum of exponentials"
            )
    for place in laws.programs:
        rates = place.reads[place.reads.shape[0] - place.law.n_rates :]
        moved, _ = rest.flexibility(laws.directions @ rates.T)
        if moved.any():
            i = int(np.flatnonzero(moved.any(axis=1))[0])
            raise InputError(
                f"elements: a law reads the rate of a coordinate without mass "
                f"({structure.dof_names[i]} follows at once), must have mass there for a motion in "
                "time"
            )


def table_columns(
    force: LoadTable | None, structure: Condensed
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Directions of the columns of a table, its times, and its polynomials for the core."""
    n = len(structure.dof_names)
    if force is None:
        return np.zeros((n, 1)), np.zeros(1), np.zeros((1, 4, 1), order="F")
    if not isinstance(force, LoadTable):
        raise InputError(f"force = {_native.shown(force)}: must be a LoadTable")
    force._refuse_g("force")
    times = np.asarray(force.times)
    values = np.asarray(force.values)
    if values.ndim == 1:
        on = 0 if force.on is None else force.on
        e = direction_of("force.on", on, n, {name: d for d, name in enumerate(structure.dof_names)})
        return e[:, np.newaxis], times, force._polynomials(values[:, np.newaxis])
    pieces = force._pieces(n)
    used = np.flatnonzero(pieces.any(axis=(1, 2)))
    patterns = np.zeros((n, max(used.size, 1)))
    patterns[used, np.arange(used.size)] = 1.0
    pieces = pieces[used] if used.size else pieces[:1]
    if used.size > 8:
        # Many columns with few independent motions: use these combinations.
        flat = pieces.reshape(used.size, -1)
        left, sizes, right = np.linalg.svd(flat, full_matrices=False)
        rank = int((sizes > _ROUNDING * sizes[0]).sum())
        patterns = patterns @ (left[:, :rank] * sizes[:rank])
        pieces = right[:rank].reshape(rank, *pieces.shape[1:])
    return patterns, times, np.asfortranarray(pieces)


def warn_of_creeping(structure: Condensed) -> None:
    """Warn of kernels with which free motion may not decay."""
    kernels = structure._all_kernels
    if any(kernel.integral >= 1 for kernel in kernels):
        warnings.warn(
            "the integral of a kernel is 1 or more: free motion may creep away, and a run does "
            "not settle on the steady response",
            StabilityWarning,
            stacklevel=caller(),
        )
