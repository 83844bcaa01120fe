"""How sure passages of events are: by those of another run, and by the errors of its states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.events import n_states
from viscovib.analyses.runs import LOCATED, least_error, told_in_one_way
from viscovib.results.trajectory import Trajectory

#: Part of the end of a run by which times of states of two runs may differ by rounding.
_ONE_TIME = 1e-12


def with_event_errors(
    run: Trajectory,
    other: Trajectory,
    pair: tuple[Trajectory, Trajectory],
    looks: list[FloatArray],
    grown: float,
) -> Trajectory:
    """The run with the errors of its events, and that of its end where one of them ended it.

    ``other``: a run in other steps, with the same events. ``pair``: two runs of which states differ
    as much, at times on the way; ``looks``: such states of which the times are not kept.
    ``grown``: what roundings become, which two runs do not tell.
    """
    assert run.error is not None
    watches = [None if one._resume is None else one._resume.watch for one in (run, other)]
    watch, others = watches
    if watch is None or others is None or not watch.events:
        return _ended(run, None)
    # Two runs may have equal errors at kinks; large rotations have two equivalent vectors.
    winds = getattr(run.system, "_winds", False)
    alike = run._resume.over_kinks or winds
    least = run.error if alike else max(least_error(run), grown)
    own, rows = watch.rows, others.rows
    if not own.shape[1]:
        none = np.empty(0)
        found = tuple(replace(one, error=none, state_error=none) for one in run.events)
        return _ended(replace(run, events=found), None)
    if not rows.shape[1]:
        rows = np.empty((own.shape[0], 0), order="F")
    columns = run._resume.event_columns()
    times, apart = _apart(pair, [] if winds else looks, columns, own.shape[0])
    errors = _native.run(
        "motion event errors", watched=watch.vector, own=own, other=rows, times=times,
        apart=apart, least=float(least), compared=not winds,
        span=np.array([run._resume.began, min(run.t_reached, other.t_reached)]),
    )["errors"]  # fmt: skip
    found = tuple(
        replace(one, error=errors[0, own[0] == i], state_error=errors[1, own[0] == i])
        for i, one in enumerate(run.events, start=1)
    )
    last = float(errors[0, -1]) if run.outcome == "event" else None
    return _ended(replace(run, events=found), last)


def _ended(run: Trajectory, late: float | None) -> Trajectory:
    """The run with the error of where it stops: that of the event, else as a stop is located."""
    assert run.error is not None
    if run.outcome == "completed":
        return run
    if late is None or np.isnan(late):
        # Where it stops is found by the same small steps every time.
        late = LOCATED * max(1.0, run.t_reached)
    return replace(run, error=max(run.error, late))


def _apart(
    pair: tuple[Trajectory, Trajectory],
    looks: list[FloatArray],
    columns: npt.NDArray[np.int64] | None,
    n_rows: int,
) -> tuple[FloatArray, FloatArray]:
    """By how much states of two runs differ, a column each of all that events tell, and when."""
    coarse, fine = pair
    coarse = told_in_one_way(coarse, fine)
    n = min(coarse.t.size, fine.t.size)
    same = np.abs(coarse.t[:n] - fine.t[:n]) <= _ONE_TIME * max(abs(fine.t_reached), 1e-300)
    times, known = fine.t[:n][same], np.abs(fine.state[:n] - coarse.state[:n])[same].T
    if looks and looks[0].size:
        most = np.abs(looks[1] - looks[0]).max(axis=0)
        times, known = np.r_[0.0, times], np.c_[most, known]
    n_all = n_states(n_rows)
    if columns is None and known.shape[0] == n_all:
        return times, np.asfortranarray(known)
    # What is not kept is off by as much as what is, at most.
    apart = np.tile(known.max(axis=0, initial=0.0), (n_all, 1))
    apart[slice(known.shape[0]) if columns is None else columns] = known
    return times, np.asfortranarray(apart)
