"""The step of a run: halved until the states kept change by no more than is allowed."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from viscovib._native import FloatArray
from viscovib.analyses.accuracy import Accuracy, along, most_states, parts_for_peaks, reason
from viscovib.analyses.estimates import Growth, looks_of
from viscovib.analyses.event_errors import with_event_errors
from viscovib.analyses.runs import (
    NotMetError,
    difference,
    has_outrun,
    hopeless,
    least_error,
    told_in_one_way,
)
from viscovib.bodies.turning import told_like
from viscovib.common.plan import Plan
from viscovib.results.trajectory import Trajectory

#: Steps up to which a layer of a law is gone after.
_MOST_STEPS = 1 << 16
#: What polynomials follow, as a part of what nodes see.
_FOLLOWED = 0.05
#: Steps before a stop that two runs must differ by: a first step with memory ends as the second
#: of half its length does, and what follows a step that fails is found by steps of its own.
_FEW = 4
#: Parts of a step in which polynomials are compared, a power of 2: their degree, less 1 or 2.
_PARTS = 8
#: The method whose polynomials have that degree.
_HIGH = "gauss8"
#: Factor by which the gain of shorter steps is taken to be less than seen.
_SAFETY = 8.0
#: What halving the step gains inside steps that are short enough for the order to show.
_GAIN = 64.0
#: The same of errors where steps go over kinks of forces.
_GAIN_AT_KINKS = 4.0
#: States that a run which stops keeps at least, by so many parts of a step at most.
_STATES_AT_STOP, _MOST_PARTS = 100, 64
#: Halvings of the step by which these states are made exact, before they are given up.
_HALVINGS_AT_STOP = 6
#: Runs of one motion differ by a smaller part of it anywhere.
_ONE_MOTION = 1e-6
_EPS = float(np.finfo(float).eps)
#: What a run keeps of each time.
_KEPT = ("t", "state", "deflections", "rates")

#: Whether states inside steps are those at the ends of shorter ones.
_ENDS_ALONE = ContextVar("ends_alone", default=False)


@contextmanager
def ends_alone() -> Iterator[None]:
    """Keep states at ends of steps alone, as the standalone driver does, to the last bit."""
    before = _ENDS_ALONE.set(True)
    try:
        yield
    finally:
        _ENDS_ALONE.reset(before)


def by_tolerance(
    make: Callable[[int, int], Trajectory],
    n: int,
    want: Accuracy,
    *,
    dense: bool = False,
    inside: bool = False,
    shaken: Callable[[int, int, int], Trajectory] | None = None,
) -> Trajectory:
    """Halve the step until the states kept change by no more than is allowed.

    ``make(factor, parts)`` makes a run in steps shorter by the factor from n of them; it keeps the
    states of the first, and of so many parts of its steps. ``dense``: keep so many states that
    peaks between them are low; not where all of the past costs more with every step. These are
    found by the polynomials of the steps (``inside``: ``make`` takes more parts than the factor)
    where they change as little as those at the ends of steps, else by a run in steps as short.
    ``shaken``: as of `Growth`.
    """
    inside = inside and not _ENDS_ALONE.get()
    least = min(_PARTS, most_states(n)) if dense and inside else 1
    first = coarse = make(1, least)
    factor, held, parts = 1, least, 1
    if least > 1:
        parts = max(2 * least, parts_for_peaks(_every(first, least)))
    changes: list[float] = []
    lost: FloatArray | None = None
    growth = Growth(shaken)
    while not hopeless(changes):
        factor *= 2
        fine = make(factor, parts)
        ends, ends_before = _every(fine, parts), _every(coarse, held)
        change = difference(ends_before, ends)
        completed = "completed" == coarse.outcome == fine.outcome
        most = want.allowed(along(ends)) if completed else _allowed_at_stop(ends, want)
        if completed:
            parted = _parted(coarse, fine, want)
            agreed = not parted and agree(ends_before, ends, want)
            change = max(change, parted)
        else:
            agreed = change <= float(most) and not 0 < fine.stats["steps"] < _FEW
        if _over_kinks(fine):
            if agreed and lost is not None:
                lost = np.maximum(lost, _off(make(factor + 1, 1), ends))
            agreed = agreed and lost is not None
            if lost is not None:
                agreed = agreed and bool((lost <= most).all())
                change = max(change, float(lost.max()))
            # What the error of a run in steps half as long is, by its difference from this one.
            lost = _off(ends_before, ends) / _GAIN_AT_KINKS
        rounding, risen = growth.along(ends_before, factor // 2, ends, change, agreed=agreed)
        change = max(change, risen)
        if rounding is not None:
            change = max(change, float(rounding.max()))
            if (rounding > most).any():
                raise NotMetError(_told_grown(want, ends, float(rounding.max())))
            risen = max(risen, float(rounding.max()))
        told = partial(_found, coarse, (ends_before, ends), risen, partial(_plan_of, first, want))
        if completed:
            if agreed:
                if _too_long(fine):
                    factor = _seeing(fine, factor, n, want)
                    before, coarse, held = ends_before, make(factor, parts), parts
                    continue
                needed = parts_for_peaks(ends) if dense and not _keeps_all(fine) else 1
                if needed > parts:
                    return told(make(max(factor, needed), needed), change)
                kept = _every(fine, parts // needed)
                if needed <= factor:
                    return told(kept, change)
                # At all that both keep: places further apart may be ends of steps alone.
                both = min(held, parts)
                two = _every(coarse, held // both), _every(fine, parts // both)
                change_inside = np.abs(two[1].state - told_in_one_way(*two).state)
                gain = _gain(coarse, 2 * held // factor, fine, parts // factor)
                error = change_inside[1:].reshape(len(gain), -1, gain.shape[1]).max(axis=1) / gain
                allowed = np.maximum(want.allowed(along(ends)), 1e-300)
                beyond = error.max(axis=0) / allowed
                if (beyond <= 1).all():
                    kept._resume.kept_of_step = needed // factor
                    return told(kept, max(change, float(error.max())))
                halvings = math.log2(needed / 4 / factor)
                if halvings < 1 or beyond.max() > _GAIN**halvings:
                    return told(make(needed, needed), change)
                before, coarse, held = ends_before, fine, parts
                continue
        elif agreed:
            if _too_long(fine):
                factor = _seeing(fine, factor, n, want)
                before, coarse, held = ends_before, make(factor, parts), parts
                continue
            if dense:
                ends, change = _with_more_states(make, ends, factor, change, want)
            return told(ends, change)
        changes.append(change)
        outrun = _outrun(coarse, fine)
        before, coarse, held = ends_before, fine, parts
        if outrun:
            break
        # Halving gains nothing before what a law depends on is followed.
        if hopeless(changes) and fine.outcome == "completed" and _too_long(fine, _FOLLOWED):
            changes.clear()
            factor = _seeing(fine, factor, n, want)
            coarse = make(factor, parts)
    raise NotMetError(
        f"{want}: not met with {n * factor} steps ({_told_change(changes[-1])}): "
        f"{reason(told_in_one_way(before, ends), ends, want)}"
    )


def _over_kinks(run: Trajectory) -> bool:
    """Return True if steps cross kinks and jumps of laws, so that two runs may have equal errors.

    The error of a kink in a step h is C h^p. C depends on the position in the step and has either
    sign, so errors of runs with steps h and h/2 may be equal by chance. A run with steps 2 h then
    differs from both, which is the second measure. For a kink next to the end of a step of 2 h all
    three errors are equal. A run with one more step for each first step, whose ends are different,
    is the third measure.
    """
    return run._resume is not None and run._resume.over_kinks


def _size(run: Trajectory) -> float:
    return float(np.abs(run.state).max(initial=0.0))


def _told_change(change: float) -> str:
    """How far runs with different step sizes differ, in words."""
    if math.isfinite(change):
        return f"states still change by {change:.1e}"
    return "runs with different step sizes end differently"


def _told_grown(want: Accuracy, run: Trajectory, grown: float) -> str:
    if not math.isfinite(grown):
        return (
            f"{want}: not met: with numbers of the system changed by rounding errors the run ends "
            "differently: the motion is chaotic or unstable, take a shorter run or a larger "
            "tolerance"
        )
    if run.outcome == "event":
        return (
            f"{want}: not met: roundings leave an error of {grown:.1e} of the event that ends the "
            f"run at t = {run.t_reached:.6g}: it is close to grazing, or the motion is chaotic or "
            "unstable, take a larger tolerance"
        )
    return (
        f"{want}: not met: the motion makes roundings of the numbers of the system "
        f"{grown / _EPS:.1e} times as large until t = {run.t_reached:.6g}, which leaves an error "
        f"of {grown:.1e}: the motion is chaotic or unstable, take a shorter run or a larger "
        "tolerance"
    )


def _off(run: Trajectory, fine: Trajectory) -> FloatArray:
    """By how much a run differs from another, by columns where both are whole."""
    if "completed" == run.outcome == fine.outcome and run.state.shape == fine.state.shape:
        return np.asarray(np.abs(fine.state - told_in_one_way(run, fine).state).max(axis=0))
    return np.array([difference(run, fine)])


def _parted(coarse: Trajectory, fine: Trajectory, want: Accuracy) -> float:
    """By how much two runs differ on the way, where that tells that they are not one, else 0.

    Motions that part, as those that pass through chaos do, may end alike by chance.
    """
    looks = looks_of(coarse, fine)
    if not looks[0].size:
        return 0.0
    if getattr(fine.system, "_winds", False):
        looks[0] = told_like(looks[0], looks[1])
    off = np.abs(looks[1] - looks[0]).max(axis=0)
    one = np.maximum(want.allowed(looks[1]), _ONE_MOTION * np.abs(looks[1]).max(axis=0))
    return float(off.max()) if (off > one).any() else 0.0


def _outrun(coarse: Trajectory, fine: Trajectory) -> bool:
    """Whether the motion outruns its laws: a step has as many parts at most, of any length."""
    seen = fine._resume is not None and fine._resume.layers.seen
    if not seen or not coarse.outcome == fine.outcome == "step too large" or not fine.t.size:
        return False
    ends = coarse.t_reached, fine.t_reached
    return has_outrun(fine.state[0], fine.state[-1], *ends, coarse.step)


def _too_long(run: Trajectory, most: float = 1.0) -> bool:
    """Whether the nodes of its steps may miss a thin layer of a law, as another run's then do."""
    return run._resume is not None and run._resume.too_long > most


def _seeing(run: Trajectory, factor: int, n: int, want: Accuracy) -> int:
    """By what to shorten the first of n steps for nodes to lie in the layers a run missed."""
    # How thin a layer is shows as steps come near it.
    factor *= 2 if run._resume.too_long <= 2 else 4
    if n * factor > _MOST_STEPS:
        layer = run._layer()
        told = "a law changes in a layer thinner than a step (take dt below that, or a wider layer)"
        told = run._pole_passed() or (told if layer is None else layer.told())
        raise NotMetError(f"{want}: not met with {n * factor} steps: {told}")
    return factor


def _with_more_states(
    make: Callable[[int, int], Trajectory],
    run: Trajectory,
    factor: int,
    change: float,
    want: Accuracy,
) -> tuple[Trajectory, float]:
    """A run that stops soon, with enough states on the way to be looked at, and its error.

    Some of them are nearer to the stop than all that were compared. Where a motion runs away
    errors grow with it, so they are compared with those of runs in shorter steps.
    """
    parts = 1
    while parts < _MOST_PARTS and parts * max(run.t.size - 1, 1) < _STATES_AT_STOP:
        parts *= 2
    if parts == 1 or _keeps_all(run):
        return run, change
    steps = max(factor, parts)
    finer = make(steps, parts)
    for _ in range(_HALVINGS_AT_STOP):
        steps *= 2
        more, finer = finer, make(steps, parts)
        if finer.outcome != run.outcome:
            break
        error = difference(more, finer)
        if error <= _allowed_at_stop(finer, want):
            return finer, max(change, error)
    return run, change


def _found(
    coarse: Trajectory,
    pair: tuple[Trajectory, Trajectory],
    grown: float,
    plan: Callable[[], Plan],
    run: Trajectory,
    change: float,
) -> Trajectory:
    """The run with its error and those of its events, as of `with_event_errors`."""
    found = replace(run, error=max(change, least_error(run)), _planned=plan)
    if found._resume is not None:
        found._resume.has_found_step = True
    return with_event_errors(found, coarse, pair, looks_of(*pair), grown)


def _gain(coarse: Trajectory, per_coarse: int, fine: Trajectory, per_fine: int) -> FloatArray:
    """How much more exact polynomials are in steps of half the length at least, by step and column.

    Their errors go like their highest terms, which differences of as high an order tell. Of so
    many states a step; too few of them tell nothing, nor do those that are renamed between steps,
    nor polynomials of a lower degree, whose differences are rounding or of another term.
    """
    least = np.ones((1, fine.state.shape[1]))
    if fine.method != _HIGH or min(per_coarse, per_fine) < _PARTS:
        return least
    if getattr(fine.system, "_winds", False):
        return least
    highest, less = (
        np.abs(np.diff(_every(run, k // _PARTS).state, _PARTS, axis=0)[::_PARTS])
        for run, k in ((coarse, per_coarse), (fine, per_fine))
    )
    # Where the highest term of a velocity passes 0, that of its displacement does not.
    sizes = np.maximum(highest.max(axis=0, initial=0.0), 1e-300)
    (u, v), (less_u, less_v) = (
        ((one / sizes)[:, ::2], (one / sizes)[:, 1::2]) for one in (highest, less)
    )
    both_less = np.hypot(less_u, less_v)
    both_less = np.maximum(both_less[::2], both_less[1::2])
    seen = np.hypot(u, v) / np.maximum(both_less, 1e-300)
    return np.repeat(np.where(seen < _GAIN, 1.0, seen / _SAFETY), 2, axis=1)


def _every(run: Trajectory, k: int) -> Trajectory:
    if k == 1:
        return run
    kept: dict[str, Any] = {
        name: np.ascontiguousarray(getattr(run, name)[::k]) for name in _KEPT if hasattr(run, name)
    }
    return replace(run, **kept)


def _keeps_all(run: Trajectory) -> bool:
    """Whether all of the past is kept."""
    return getattr(run._resume, "past", None) == "direct"


def _allowed_at_stop(run: Trajectory, want: Accuracy) -> float:
    """Largest error allowed of a motion that stops: absolute of 1 or of a state that runs away."""
    size = max(1.0, _size(run))
    if want.by_size:
        return want.relative * size
    return want.absolute * size + want.relative * max(size, run.t_reached)


def _plan_of(first: Trajectory, want: Accuracy) -> Plan:
    plan = first._planned(want.absolute or want.relative)
    if want.relative == 0:
        return plan
    step = "computes: the step, halved until the states kept change by no more than "
    lines = str(plan).splitlines()
    return Plan("\n".join(step + want.text if s.startswith(step) else s for s in lines))


def agree(coarse: Trajectory, fine: Trajectory, want: Accuracy) -> bool:
    """Whether two runs differ by no more than is allowed."""
    return _apart(coarse, fine, want) <= 1


def _apart(coarse: Trajectory, fine: Trajectory, want: Accuracy) -> float:
    """By how much two runs differ, relative to what is allowed."""
    if coarse.state.shape != fine.state.shape:
        return math.inf
    parts = np.abs(fine.state - told_in_one_way(coarse, fine).state).max(axis=0)
    return float((parts / np.maximum(want.allowed(along(fine)), 1e-300)).max())
