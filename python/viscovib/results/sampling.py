"""Errors of periodic motions by sampling of their forces and by rounding."""

from __future__ import annotations

from typing import Any

import numpy as np

from viscovib._native import ComplexArray, FloatArray
from viscovib.common.column_notes import NOTES
from viscovib.common.tables import Table
from viscovib.systems.load import Job

#: Largest number of multiplications for sampling errors in a summary.
_QUICK = 3e8


def sampling_errors(result: Any, job: Job, p: FloatArray, y: ComplexArray) -> FloatArray:
    """Return the sampling errors of a response or branch, shape (n,); NaN if unknown.

    ``job``: system, load and varied parameter for the core; ``p``: its values; ``y``: motions
    relative to the base, shape (n, n_dof, m).
    """
    used = np.searchsorted(result.harmonics, result.highest, side="right")
    used[~np.isfinite(y).all(axis=(1, 2)) | (result.highest <= 0)] = 0
    errors = job.run_long(
        "response sampling_errors", kept=result.harmonics, p=p, motions=y.T, used=used
    )["errors"]
    return np.where(errors < 0, np.nan, errors)


def rounding_errors(result: Any, job: Job, y: ComplexArray, *, linear: bool) -> FloatArray:
    """Errors of the motions of a response as solutions of their equations, shape (n,).

    ``job``: system and load for the core; ``y``: motions relative to the base.
    """
    kept = result.harmonics
    if linear:
        # Only harmonics of the load, of any order.
        odd = kept.size > 0 and (kept % 2 == 1).all()
        last = kept.max(initial=0)
        kept = np.arange(1 if odd else 0, last + 1, 2 if odd else 1)
        whole = np.zeros((*y.shape[:2], kept.size), dtype=complex)
        whole[..., np.searchsorted(kept, result.harmonics)] = y
        y = whole
    used = np.searchsorted(kept, result.highest, side="right")
    # The highest harmonic is 0 for a motion at rest, a mean only, or no solution.
    used[~np.isfinite(y).all(axis=(1, 2)) | ~result.converged] = 0
    errors = job.run_long(
        "response rounding_errors", kept=kept, nu=result.nu, motions=y.T, used=used, linear=linear
    )["errors"]
    return np.where(errors < 0, np.nan, errors)


def lost_energy(
    result: Any, job: Job, factors: FloatArray, y: ComplexArray, *, linear: bool = False
) -> FloatArray:
    """Energy loss of each motion per period by all forces (J), shape (n,).

    ``job``: system and load for the core; ``y``: motions relative to the base.
    """
    found = job.run(
        "response losses", kept=result.harmonics, nu=result.nu, factor=factors,
        highest=result.highest, linear=linear, motions=y.T,
    )  # fmt: skip
    return np.asarray(found["lost"])


def add_requested(table: Table, result: Any) -> None:
    """Add the columns that a scene requests."""
    table.notes += [NOTES[name] for name in result._extra_columns]
    values = {"sampling": lambda: result.sampling, "dissipation": result._energy_loss}
    table.columns |= {name: values[name]() for name in result._extra_columns}


def sampling_text(result: Any) -> str:
    """Text of a summary on sampling errors; empty if they are 0 or would take long."""
    n, d = result.highest.size, len(result.dof_names)
    if (
        getattr(result, "method", "") == "linear"
        or n * (2.0 * d * result.harmonics.size) ** 3 > _QUICK
    ):
        return ""
    worst = np.nanmax(result.sampling, initial=0.0)
    return f", of samples {worst:.1e}" if worst > 0 else ""
