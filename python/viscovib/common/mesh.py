"""Where the steps of a run end: on every jump and corner of its loads."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from viscovib._native import FloatArray

#: Two times closer than so many spacings of doubles are one.
_SAME = 8.0


@dataclass(frozen=True, eq=False)
class Mesh:
    """Equal steps on each piece of time within which the loads are smooth.

    Attributes
    ----------
    h : float
        Wanted step, which none exceeds.
    breaks : ndarray
        All times at which a load has a jump or a corner.
    ends : ndarray, shape (n,)
        Ends of the pieces, ascending; the first begins at 0.
    made_by : ndarray of int, shape (n,)
        Steps made by each end.
    """

    h: float
    breaks: FloatArray
    ends: FloatArray
    made_by: npt.NDArray[np.int64]

    @classmethod
    def until(cls, end: float, h: float, breaks: FloatArray, *, at_first: int = 1) -> "Mesh":
        """Steps of at most h to ``end``, ``at_first`` or more of them in the first piece."""
        none = cls(h, breaks, np.empty(0), np.empty(0, dtype=np.int64))
        mesh = none.extended(end)
        made_by = mesh.made_by.copy()
        made_by += max(0, at_first - int(made_by[0]))
        return cls(h, breaks, mesh.ends, made_by)

    def extended(self, end: float) -> "Mesh":
        """The same, on to a later end."""
        begin = float(self.ends[-1]) if self.ends.size else 0.0
        near = _SAME * np.spacing(max(abs(end), abs(begin)))
        inner = self.breaks[(self.breaks > begin + near) & (self.breaks < end - near)]
        apart = np.diff(inner, prepend=-math.inf) > near
        ends = np.append(inner[apart], end)
        counts = np.ceil(np.diff(ends, prepend=begin) / self.h * (1 - 1e-12)).astype(np.int64)
        made = int(self.made_by[-1]) if self.made_by.size else 0
        return Mesh(
            self.h,
            self.breaks,
            np.append(self.ends, ends),
            np.append(self.made_by, made + np.cumsum(np.maximum(counts, 1))),
        )

    def finer(self, factor: int) -> "Mesh":
        """So many steps for each."""
        return Mesh(self.h / factor, self.breaks, self.ends, self.made_by * factor)

    @property
    def count(self) -> int:
        """Steps in all."""
        return int(self.made_by[-1])

    @property
    def lengths(self) -> FloatArray:
        """Steps of each piece, shape (n,)."""
        return np.asarray(np.diff(self.ends, prepend=0.0) / np.diff(self.made_by, prepend=0))

    @property
    def shortest(self) -> float:
        """Shortest step of this run, and of one that goes on to the last break."""
        return float(min(self.lengths.min(), self.later))

    @property
    def later(self) -> float:
        """Shortest time between breaks after the end, infinite without any."""
        later = np.diff(self.breaks[self.breaks >= self.ends[-1]], prepend=self.ends[-1])
        later = later[later > _SAME * np.spacing(self.ends[-1])]
        return float(later.min(initial=math.inf))

    def time(self, k: int) -> float:
        """Time after k steps."""
        return float(self.times(np.array([k]))[0])

    def times(self, k: npt.NDArray[np.int64]) -> FloatArray:
        """Times after so many steps each."""
        piece = np.minimum(np.searchsorted(self.made_by, k, side="left"), self.ends.size - 1)
        before = np.where(piece > 0, self.made_by[piece - 1], 0)
        begin = np.where(piece > 0, self.ends[piece - 1], 0.0)
        inside = begin + (k - before) * self.lengths[piece]
        return np.asarray(np.where(k == self.made_by[piece], self.ends[piece], inside))
