"""Error estimates of runs: from runs with different step sizes, and amplified rounding errors."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from viscovib._native import FloatArray
from viscovib.analyses.accuracy import along, rounding_of
from viscovib.analyses.event_errors import with_event_errors
from viscovib.analyses.runs import SHAKEN, difference, least_error, told_in_one_way
from viscovib.common.plan import Plan
from viscovib.results.trajectory import Trajectory

_EPS = float(np.finfo(float).eps)
#: Roundings of every step and number have their own directions, of which one run tells one.
_SAFETY = 8.0
#: Roundings that a motion is left with where they do not grow.
_FEW = 64.0
#: Part of a motion within which a run is near enough to it to tell what roundings become.
_NEAR = 1e-3
#: Part of a motion up to which what becomes of a shake is linear.
_LINEAR = 0.1
#: Parts of a run that are looked at; how far beyond rounding a difference is that holds what
#: rounding adds in one of them, and by how much it may rise where nothing grows by itself.
_WINDOWS, _BEYOND, _STEADY = 8, 1024.0, 16.0


def grown(run: Trajectory, shaken: Callable[[int], Trajectory | None]) -> FloatArray:
    """What roundings become along a run, by columns where both are whole.

    Those of numbers of a system are the same in runs in any steps, whose difference does not tell
    them, and of those of steps one difference may be small by chance. ``shaken(sign)``: the run in
    the same steps of a system of which numbers and arguments of forces are other by `SHAKEN`, small
    enough for what becomes of it to be linear, and the start by so much of this sign. What both
    bring may cancel: where it grows the other sign is looked at, too.
    """
    found = _grown(run, shaken(1))
    if (found > _FEW * rounding_of(run.state)).any():
        found = np.maximum(found, _grown(run, shaken(-1)))
    return found


def _grown(run: Trajectory, other: Trajectory | None) -> FloatArray:
    part = _SAFETY * _EPS / SHAKEN
    if other is None or other.outcome != run.outcome:
        return np.full(run.state.shape[1] if run.outcome == "completed" else 1, math.inf)
    if run.outcome == "completed":
        apart = np.abs(other.state - told_in_one_way(run, other).state).max(axis=0)
        # What has become as large as the motion says nothing of what is smaller.
        sizes = np.abs(along(run)).max(axis=0)
        return np.asarray(np.where(apart > _LINEAR * sizes, apart, part * apart))
    return np.array([part * difference(run, other)])


def risen(coarse: Trajectory, fine: Trajectory) -> float:
    """What the difference of two runs tells that roundings become; inf: it does not tell it.

    Errors of steps and roundings grow alike. Where in every part of a run two differ by far more
    than rounding, so do their ends by far more than what becomes of it. Where their difference
    hardly rises from any part to a later one, roundings of numbers rise as much at most.
    """
    if not "completed" == coarse.outcome == fine.outcome:
        return math.inf
    if fine.t.size > 1:
        one, other = told_in_one_way(coarse, fine).state, fine.state
    else:
        one, other = looks_of(coarse, fine)
    if len(other) <= 2 * _WINDOWS or one.shape != other.shape:
        return math.inf
    apart, sizes = np.abs(other - one), np.abs(other).max(axis=0)
    ends = (np.arange(_WINDOWS) * len(other)) // _WINDOWS
    off = np.maximum.reduceat(apart, ends, axis=0)
    beyond = (off >= _BEYOND * _EPS * sizes).all(axis=0)
    floor = np.maximum(off, np.maximum(_EPS * sizes, 1e-300))
    rise = (off / np.minimum.accumulate(floor, axis=0)).max(axis=0)
    most = float(np.where(beyond, 0.0, rise).max(initial=0.0))
    if most > _STEADY:
        return math.inf
    return _SAFETY * _EPS * most * float(np.abs(fine.state).max(initial=0.0))


@dataclass
class Growth:
    """What roundings become along a motion, by a run as rough as will do."""

    #: Makes runs in steps shorter by a factor, of which states of so many parts are kept, shaken
    #: with a sign as `grown` takes it; None: it makes none.
    shaken: Callable[[int, int, int], Trajectory] | None
    _near: tuple[Trajectory, int] | None = None
    _grown: FloatArray | None = None

    def along(
        self, coarse: Trajectory, factor: int, fine: Trajectory, change: float, *, agreed: bool
    ) -> tuple[FloatArray | None, float]:
        """Return what they become where two runs agree that do not tell it, else None.

        And what these tell of it where they do.
        """
        size = float(np.abs(fine.state).max(initial=0.0))
        if self._near is None and (agreed or change <= _NEAR * size):
            self._near = coarse, factor
        if not agreed or self.shaken is None or self._near is None:
            return None, 0.0
        # Runs before and after thin layers are met are not in the same parts of steps.
        in_parts = fine._resume is not None and fine._resume.layers.seen
        if self._grown is not None or in_parts:
            return self._grown, 0.0
        rise = risen(coarse, fine)
        if rise < math.inf:
            return None, rise
        run, near = self._near
        self._grown = grown(run, partial(self.shaken, near, 1))
        if not np.isfinite(self._grown).all():
            # A coarse run may stop where a finer one does not.
            self._grown = grown(fine, partial(self.shaken, 2 * factor, 1))
        return self._grown, 0.0


def looks_of(*runs: Trajectory) -> list[FloatArray]:
    """States on the way of runs that keep a part of it alone, none if not at the same times."""
    looks = [np.array([] if run._resume is None else run._resume.looks) for run in runs]
    if any(not one.size or one.shape != looks[0].shape for one in looks):
        return [np.empty((0, run.state.shape[1])) for run in runs]
    return looks


def with_estimate(
    run: Trajectory,
    make: Callable[[int], Trajectory | None],
    begin: str = "",
    shaken: Callable[[int], Trajectory | None] | None = None,
) -> Trajectory:
    """The run with the error that others tell; ``make(k)``: in k times the steps, None: it stopped.

    ``begin``: where the others do, if elsewhere. ``shaken``: the same run as `grown` takes it.

    If steps cross kinks, runs with half the step size may have the same error from a kink next to
    the end of a step. A third of the step size has different ends of steps. Errors decrease slowly
    there, so finer runs keep a large part of them with the same sign, which their difference shows.
    """
    factors = (2, 3) if run._resume is not None and run._resume.over_kinks else (2,)
    finer = [make(factor) for factor in factors]
    change = max(math.inf if fine is None else difference(run, fine) for fine in finer)
    for one, other in itertools.pairwise(finer):
        if one is not None and other is not None:
            change += difference(one, other)
    how = "by a run in half steps" if len(factors) == 1 else "by runs in half steps and thirds"
    how += begin
    grown_to = 0.0
    if shaken is not None:
        rise = math.inf if finer[0] is None else risen(run, finer[0])
        if rise == math.inf:
            rise = float(grown(run, shaken).max())
            how += ", and of numbers that are other by 1e-12"
        change, grown_to = max(change, rise), rise
    error = max(change, least_error(run))
    told = replace(run, error=error, _planned=partial(_plan_with_estimate, run, how))
    if finer[0] is None:
        return told
    looks = looks_of(run, finer[0])
    return with_event_errors(told, finer[0], (finer[0], run), looks, grown_to)


def _plan_with_estimate(run: Trajectory, how: str) -> Plan:
    words = "estimate of the error"
    return run.plan.instead(words, f"computes: {words}, {how}")
