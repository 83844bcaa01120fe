"""Lyapunov exponents from neighbouring motions, for systems with switches or memory.

Neighbouring motions at a small distance d in coordinates and velocities are followed with the
motion. Their differences are repeatedly orthogonalized and scaled to the length d (Benettin et al.,
Meccanica 15, 1980, with differences instead of the variational equation). Each neighbour is a
separate run with its own switching times, so the difference includes the effect of kinks, jumps and
impacts on perturbations (saltation).

With memory the state is the whole past. A perturbation changes coordinates and velocities at t = 0,
with an unperturbed past. Afterwards its own past belongs to it and is scaled with it. Exponents are
the growth rates of the present coordinates and velocities; the past follows them.

All data of a run except its state (phases of loads, first guesses, flags) are copied from the
motion. Phases differ by rounding errors where steps end at kinks. If such errors were scaled with a
decaying difference, they would never decay and would become the largest perturbation.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from viscovib._native import FloatArray
from viscovib.analyses.runs import Run, Wanted
from viscovib.errors import InputError

#: Relative distance of a neighbour; relative length below which a difference has vanished.
_APART, _ONE = 1e-7, 1e-7
#: Growth between two renewals that may be due to a switch of one motion only.
_LEAP = 1e3
#: Smallest remaining difference above rounding errors, which sets the interval of renewals.
_LEFT = 1e-2
#: Smallest remaining difference after one step, and refinement of steps if less remains.
_LEFT_OF_STEP, _FINER = 1e-5, 8
#: Error of a mean rate, in units of the range of deviations from linear growth over the time.
_IN_RANGES = 2.0
#: Largest number of successive renewals that wait for a neighbour to switch.
_PATIENCE = 2
#: Smallest difference of switch states (whole numbers); bound of flags and counts.
_MARKED, _COUNTED = 0.5, 1e6
#: Number of states for the size of a motion, and of renewals for its recent size.
_LOOKS, _RECENT = 512, 16
#: Smallest distance of neighbours.
_LEAST = 1e-100
#: Largest share of the history in a perturbation, relative to the first perturbation.
_HIDDEN = 1e4
#: Largest such share of a perturbation that is followed.
_LOST = 1e12


class _TooFarError(Exception):
    """A difference nearly vanishes within one step."""


def exponents_of(
    make: Callable[..., Run],
    widths: tuple[int, int],
    n_steps: int,
    n_discard: int,
    count: int,
    quarter: int,
) -> tuple[FloatArray, FloatArray]:
    """Mean growth rates of ``count`` perturbations, and errors; NaN if the motion ends early.

    ``make(moved, finer=)`` creates the run, with the start changed by ``moved`` and steps shorter
    by the factor ``finer``; ``widths``: sizes of a start, and of coordinates and velocities;
    ``quarter``: largest number of steps between two renewals.
    -inf: the perturbation vanishes, for example by sticking friction. NaN: it nearly vanishes from
    coordinates and velocities but remains in the past.
    """
    try:
        nearby = _Neighbour(partial(make, finer=1), widths, count, quarter)
        return nearby.rates(n_steps, n_discard)
    except _TooFarError:
        nearby = _Neighbour(partial(make, finer=_FINER), widths, count, _FINER * quarter)
        nearby.last_try = True
        return nearby.rates(_FINER * n_steps, _FINER * n_discard)


@dataclass
class _Renewal:
    """Orthogonalized and rescaled differences."""

    parts: list[FloatArray]
    #: Length of each before, in units of the renewed length.
    lengths: FloatArray


class _Neighbour:
    """A motion and its neighbours."""

    def __init__(
        self,
        make: Callable[[FloatArray | None], Run],
        widths: tuple[int, int],
        count: int,
        quarter: int,
    ) -> None:
        self.make, self.widths, self.count, self.quarter = make, widths, count, quarter
        #: True if steps cannot become shorter.
        self.last_try = False
        self.runs: list[Run] = []
        #: Sums of the logarithms of growth.
        self.grown = np.zeros(count)
        #: Undetermined exponents: the history and its rounding errors hide the present state.
        self.unset = np.zeros(count, dtype=bool)
        #: Reduction of the distance of each neighbour, so that its past is near too.
        self.nearer = np.ones(count)

    def rates(self, n_steps: int, n_discard: int) -> tuple[FloatArray, FloatArray]:
        """Follow the motions; return mean growth between the first and the last counted renewal."""
        missing = np.full(self.count, math.nan), np.full(self.count, math.nan)
        if n_discard >= n_steps or not self._begin(n_steps):
            return missing
        course = [(0, self.grown.copy())]
        done = renewed = waited = 0
        since = 0 if n_discard == 0 else -1
        look = self.quarter
        while done < n_steps:
            n = min(look, (n_discard if done < n_discard else n_steps) - done)
            before = [copy.copy(run) for run in self.runs]
            if any(run.steps(n, Wanted(keep="last"), False).outcome != "completed"
                   for run in self.runs):  # fmt: skip
                return missing
            found = self._renewal()
            alive = found.lengths[np.isfinite(self.grown)]
            least, most = alive.min(initial=1.0), alive.max(initial=1.0)
            if n > 1 and (least < _LEFT or most > _LEAP):
                self.runs, look = before, max(1, n // 4)
                continue
            if least < _LEFT_OF_STEP and not self.last_try:
                raise _TooFarError
            done += n
            # One motion has switched and the other not yet: the difference is temporary.
            if (most > _LEAP or self._astride()) and waited < _PATIENCE:
                waited += 1
                if done < n_steps or renewed > max(since, 0):
                    continue
            waited = 0
            self._renew(found)
            renewed = done
            course.append((done, self.grown.copy()))
            if since < 0 and done >= n_discard:
                since = done
                self.grown[np.isfinite(self.grown)] = 0.0
                course = [(done, self.grown.copy())]
                self.unset[:] = False
            if least > math.sqrt(_LEFT):
                look = min(self.quarter, 2 * look)
        if since < 0 or renewed <= since:
            return missing
        span = self.runs[0].h * (renewed - since)
        off = np.where(np.isfinite(self.grown), _unsure(course) / span, 0.0)
        rates, off = (np.where(self.unset, math.nan, x) for x in (self.grown / span, off))
        return rates, off

    def _begin(self, n_steps: int) -> bool:
        """Create the motion and its neighbours; return False if the motion ends early."""
        scout = self.make(None)
        looked = scout.steps(n_steps, Wanted(every=max(1, n_steps // _LOOKS)), False)
        if looked.outcome != "completed":
            return False
        begun, width = self.widths
        size = np.abs(looked.state[:, :width]).max(axis=0)
        # Common scales of all coordinates and of all velocities.
        time = self.quarter * scout.h
        length = max(float(size[::2].max()), time * float(size[1::2].max())) or 1.0
        self.scale = np.resize([length, length / time], width)
        # A motion may grow or decay by many orders: distances refer to its size at this time.
        early = looked.state[: 2 + 4 * self.quarter // max(1, n_steps // _LOOKS), :width]
        self.sizes = [float(np.linalg.norm(early / self.scale, axis=1).max()) or 1.0]
        self.apart = _APART * self.sizes[0]
        # Random directions.
        first = np.linalg.qr(np.random.default_rng(1).standard_normal((begun, self.count)))[0]
        units = np.resize(self.scale, begun)
        moves = [None, *(self.apart * units * first[:, j] for j in range(self.count))]
        self.runs = [self.make(moved) for moved in moves]
        for run in self.runs:
            run.compute_all()
        return True

    def _renewal(self) -> _Renewal:
        """Orthogonalized differences from the motion, and their lengths."""
        own = _whole(self.runs[0])
        belongs = self.runs[0].belongs_to_state()
        n, width = self.runs[0].state.size, self.scale.size
        parts: list[FloatArray] = []
        lengths = np.zeros(self.count)
        for j, run in enumerate(self.runs[1:]):
            if math.isnan(self.grown[j]):
                parts.append(np.zeros_like(own))
                continue
            its = _whole(run)
            if its.size != own.size:
                raise InputError(
                    "lyapunov: neighbouring motions end their steps at kinks and have different "
                    "histories; must be False, or the kernels sums of exponentials"
                )
            whole = its - own
            whole[n:] = np.where(belongs & ~_marks(own[n:], its[n:]), whole[n:], 0.0)
            whole /= self.nearer[j]
            note = whole[n:][self.runs[0].state_columns()]
            # Reorder alternating values: first all coordinates, then all velocities.
            note[:] = whole[n - note.size : n].reshape(-1, 2).T.ravel()
            for _ in range(2):
                for part in parts:
                    along = (part[:width] / self.scale) @ (whole[:width] / self.scale)
                    whole = whole - along / self.apart * (part / self.apart)
            length = float(np.linalg.norm(whole[:width] / self.scale)) / self.apart
            lengths[j] = length
            parts.append(whole / length if length > _ONE else np.zeros_like(whole))
        return _Renewal(parts, lengths)

    def _renew(self, found: _Renewal) -> None:
        """Move the neighbours back to the small distance."""
        own, n = _whole(self.runs[0]), self.runs[0].state.size
        size = float(np.linalg.norm(own[: self.scale.size] / self.scale))
        self.sizes = [*self.sizes[1 - _RECENT :], size]
        apart = _APART * max(self.sizes)
        # For a motion at rest at zero keep the distance.
        new = apart / self.apart if apart > _LEAST else 1.0
        for j, (run, part) in enumerate(zip(self.runs[1:], found.parts, strict=True)):
            length = found.lengths[j]
            self.grown[j] += math.log(length) if length > _ONE else -math.inf
            hidden = _hidden(part, found.parts[0], n)
            self.unset[j:] |= hidden > _HIDDEN
            if hidden > _LOST:
                self.grown[j:] = math.nan
            self.nearer[j] = 1 / max(1.0, hidden)
            moved = own + new * self.nearer[j] * part
            run.state, run.memory = moved[:n].copy(), moved[n:].copy()
        self.apart *= new

    def _astride(self) -> bool:
        """True if a neighbour is on the other side of a switching surface."""
        mine = self.runs[0].switched
        return any(
            bool((np.abs(run.switched - mine) >= np.maximum(_MARKED, 1e-3 * np.abs(mine))).any())
            for run in self.runs[1:]
        )


def _unsure(course: list[tuple[int, FloatArray]]) -> FloatArray:
    """Error of mean rates times the time, as in the core (``flight.f90``)."""
    done, grown = np.array([n for n, _ in course]), np.array([g for _, g in course])
    part = ((done - done[0]) / (done[-1] - done[0]))[:, None]
    with np.errstate(invalid="ignore"):
        nearby = grown - grown[0] - part * (grown[-1] - grown[0])
    return np.asarray(_IN_RANGES * (nearby.max(axis=0) - nearby.min(axis=0)))


def _hidden(part: FloatArray, first: FloatArray, n: int) -> float:
    """Share of the history (after n numbers) in a perturbation, relative to the first one."""
    seen = np.abs(part[:n]).max() * np.abs(first[n:]).max()
    past = np.abs(part[n:]).max() * np.abs(first[:n]).max()
    # A vanished perturbation has no parts.
    return float(past / seen) if past > seen > 0 else 1.0


def _marks(own: FloatArray, its: FloatArray) -> npt.NDArray[np.bool_]:
    """Mask of the flags and counts in a memory (small whole numbers)."""
    small = np.maximum(np.abs(own), np.abs(its)) < _COUNTED
    whole = (own == np.rint(own)) & (its == np.rint(its))
    return np.asarray(whole & small)


def _whole(run: Run) -> FloatArray:
    """State and memory, which are sufficient to continue a run."""
    assert run.memory is not None
    return np.concatenate([run.state, run.memory])
