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
    errors = job.run_long(
        "response sampling_errors",
        kept=result.harmonics, p=p, motions=y.T, highest=result.highest,
    )["errors"]  # fmt: skip
    return np.asarray(errors)


def rounding_errors(result: Any, job: Job, y: ComplexArray, *, linear: bool) -> FloatArray:
    """Errors of the motions of a response as solutions of their equations, shape (n,).

    ``job``: system and load for the core; ``y``: motions relative to the base.
    """
    errors = job.run_long(
        "response rounding_errors",
        kept=result.harmonics, nu=result.nu, motions=y.T, highest=result.highest, linear=linear,
    )["errors"]  # fmt: skip
    return np.asarray(errors)


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
