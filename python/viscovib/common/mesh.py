"""Ends of the steps of a run, at every jump and corner of its loads."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray

#: Two times closer than this number of floating-point spacings are equal.
_SAME = 8.0


@dataclass(frozen=True, eq=False)
class Mesh:
    """Equal steps on each interval with smooth loads.

    Attributes
    ----------
    h : float
        Largest step size.
    breaks : ndarray
        Times of jumps and corners of the loads.
    ends : ndarray, shape (n,)
        Ends of the intervals, ascending; the first interval starts at 0.
    made_by : ndarray of int, shape (n,)
        Number of steps up to each end.
    """

    h: float
    breaks: FloatArray
    ends: FloatArray
    made_by: npt.NDArray[np.int64]

    @classmethod
    def until(cls, end: float, h: float, breaks: FloatArray, *, at_first: int = 1) -> "Mesh":
        """Steps of at most h to ``end``, at least ``at_first`` of them in the first interval."""
        none = cls(h, breaks, np.empty(0), np.empty(0, dtype=np.int64))
        mesh = none.extended(end)
        made_by = mesh.made_by.copy()
        made_by += max(0, at_first - int(made_by[0]))
        return cls(h, breaks, mesh.ends, made_by)

    def extended(self, end: float) -> "Mesh":
        """Return the mesh extended to a later end."""
        found = _native.run(
            "motion mesh", ends=self.ends, made_by=self.made_by, h=float(self.h), end=float(end),
            breaks=self.breaks,
        )  # fmt: skip
        return Mesh(self.h, self.breaks, found["ends"], found["made_by"].astype(np.int64))

    def finer(self, factor: int) -> "Mesh":
        """Return the mesh with each step divided by the factor."""
        return Mesh(self.h / factor, self.breaks, self.ends, self.made_by * factor)

    @property
    def count(self) -> int:
        """Total number of steps."""
        return int(self.made_by[-1])

    @property
    def lengths(self) -> FloatArray:
        """Step size of each interval, shape (n,)."""
        return np.asarray(np.diff(self.ends, prepend=0.0) / np.diff(self.made_by, prepend=0))

    @property
    def later(self) -> float:
        """Shortest time between breaks after the end; infinite without breaks."""
        later = np.diff(self.breaks[self.breaks >= self.ends[-1]], prepend=self.ends[-1])
        later = later[later > _SAME * np.spacing(self.ends[-1])]
        return float(later.min(initial=math.inf))

    def time(self, k: int) -> float:
        """Time after k steps."""
        return float(self.times(np.array([k]))[0])

    def times(self, k: npt.NDArray[np.int64]) -> FloatArray:
        """Times after k steps."""
        piece = np.minimum(np.searchsorted(self.made_by, k, side="left"), self.ends.size - 1)
        before = np.where(piece > 0, self.made_by[piece - 1], 0)
        begin = np.where(piece > 0, self.ends[piece - 1], 0.0)
        inside = begin + (k - before) * self.lengths[piece]
        return np.asarray(np.where(k == self.made_by[piece], self.ends[piece], inside))
