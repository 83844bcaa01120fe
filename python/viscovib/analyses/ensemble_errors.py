"""Errors of ensemble results except the final states."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from viscovib._native import ComplexArray, FloatArray
from viscovib.analyses.accuracy import rounding_of
from viscovib.analyses.members import Members
from viscovib.analyses.singles import SingleMembers


class Raw(Protocol):
    """Results of the core that are compared."""

    @property
    def amplitudes(self) -> ComplexArray | None:
        """Amplitudes of lines."""

    @property
    def sections(self) -> FloatArray | None:
        """States at whole periods of a load."""


@dataclass(frozen=True)
class Neighbour:
    """Errors of results except the final states; None: no result, or a given step size."""

    sections: float | None = None
    amplitudes: float | None = None


#: Sections of some runs, and their times if they are not periods of a load.
Sections = tuple[FloatArray | None, FloatArray | None]


def sections_of(members: Members, raw: Raw) -> Sections:
    """Sections of the last run."""
    if isinstance(members, SingleMembers) and members.surface is not None:
        return members.passages()
    return raw.sections, None


def errors_by_neighbours(
    coarse: Raw, fine: Raw, before: Sections, after: Sections, runs: npt.NDArray[np.bool_]
) -> Neighbour:
    """Changes of sections and amplitudes by halved steps, with their rounding errors."""
    sections, amplitudes = None, None
    if before[0] is not None and after[0] is not None:
        sections = 0.0
        for early, late in zip(before, after, strict=True):
            if early is None or late is None:
                continue
            a, b = early[runs], late[runs]
            # If the numbers of crossings differ, the error is unknown.
            alike = a.shape == b.shape and bool((np.isnan(a) == np.isnan(b)).all())
            moved = float(np.nanmax(np.abs(b - a), initial=0.0)) if alike else math.inf
            known = b[~np.isnan(b)]
            sections = max(sections, moved, rounding_of(known) if known.size else 0.0)
    if coarse.amplitudes is not None and fine.amplitudes is not None:
        lines = fine.amplitudes[runs]
        amplitudes = max(
            float(np.abs(lines - coarse.amplitudes[runs]).max(initial=0.0)),
            rounding_of(np.abs(lines)) if lines.size else 0.0,
        )
    return Neighbour(sections, amplitudes)
