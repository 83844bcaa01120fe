"""Step size search for motions in time: halving until the states kept change little enough.

The core makes all runs of a search (`viscovib_step_search`). This module passes the arguments, and
converts the results to a trajectory or to a message with the reason of the failure.
"""

from __future__ import annotations

import copy
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from viscovib import _native
from viscovib.analyses.accuracy import Accuracy, reason
from viscovib.analyses.runs import NotMetError, Run, Wanted, nothing, renamed_alike
from viscovib.common.plan import Plan
from viscovib.common.progress import counted_pieces
from viscovib.results.trajectory import OUTCOMES, Trajectory

#: Verdicts of the core.
_FOUND, _NOT_MET, _IN_LAYER, _GROWN, _TOO_MANY = range(5)
#: First number of steps from which on a search may take long.
_FEW = 16
_EPS = float(np.finfo(float).eps)


def by_tolerance(
    run: Run, n: int, end: float, want: Wanted, accuracy: Accuracy, progress: bool
) -> Trajectory:
    """Return the run to ``end`` with a step size that meets the tolerance.

    ``run``: at its start, with the first step size; n: number of steps if no load has corners.
    """
    first = copy.copy(run)
    found = _search(run, n, end, want, progress, accuracy=accuracy)
    if found["verdict"] != _FOUND:
        raise NotMetError(f"{accuracy}: {_why(run, found, n, accuracy)}")
    run.has_found_step = True
    result = _result(run, found, n, end, want)
    return replace(result, _planned=partial(_plan_of, first, want, end, accuracy))


def with_estimate(run: Run, n: int, end: float, want: Wanted, progress: bool) -> Trajectory:
    """Return the run to ``end`` with given steps and an error estimate."""
    found = _search(run, n, end, want, progress)
    result = _result(run, found, n, end, want)
    how = "by a run in half steps"
    if run.over_kinks:
        how = "by runs in half steps and thirds"
    if found["was_shaken"]:
        how += ", and of numbers that are other by 1e-12"
    return replace(result, _planned=partial(_plan_with_estimate, result._planned, how))


def _search(
    run: Run,
    n: int,
    end: float,
    want: Wanted,
    progress: bool,
    accuracy: Accuracy | None = None,
) -> dict[str, Any]:
    """Results of the core; without an accuracy: the error of the run with n steps."""
    times = nothing(0) if want.times is None else want.times
    asked = want.asked or want
    if want.times is not None:
        run._check_times(times, n if run.mesh is None else run.mesh.count)
    elif want.keep == "all":
        run._check_capacity(n // want.every)
    task, objects, values = run._values(n, want.every, times)
    allowed = accuracy or Accuracy(0.0)
    values |= {
        "estimate": accuracy is None, "absolute": allowed.absolute,
        "relative": 0.0 if allowed.by_size else allowed.relative,
        "t_end_of_run": float(end), "at_times": want.times is not None,
        "last_only": want.keep == "last", "tail": float(want.tail),
        "looks": asked.keep != "all" or asked.times is not None,
        "fills": accuracy is not None and want.no_choice,
        "rows": run._compared + 1, **run._search_values(),
    }  # fmt: skip
    long = n > _FEW or run._takes_long(n)
    with counted_pieces(progress):
        return _native.run_either(long, task, *objects, **values)


def _result(run: Run, found: dict[str, Any], n: int, end: float, want: Wanted) -> Trajectory:
    """The result of the search, which can be continued."""
    factor = found["factor"]
    run.h = found["step"]
    if run.mesh is not None:
        run.mesh = run.mesh.finer(factor)
    else:
        run.goal = n * factor, end
    if factor > 1 and run.sharpens:
        assert run.maker is not None
        run.maker = _Sharper(run.maker, factor)
        run.sharpen(factor)
    run.done, run.reached = found["made"], found["reached"]
    run.state, run.memory = found["last"], found["memory"]
    run.kept_of_step = found["per_step"]
    run.take_search(found)
    events: tuple[Any, ...] = ()
    if run.watch is not None:
        kept = run.watch.take(found["found"], found["n_found"])
        run.watch.sides[:] = found["sides"]
        errors = found["passage_errors"][:, kept]
        which = run.watch.rows[0]
        events = tuple(
            replace(one, error=errors[0, which == i], state_error=errors[1, which == i])
            for i, one in enumerate(run.watch.passages(slice(run.state.size)), start=1)
        )
    result = _trajectory(run, found, "")
    return replace(
        run._shaped(result), error=found["error"], events=_cut(events, run),
        _planned=partial(run.plan, want, end),
    )  # fmt: skip


def _cut(events: tuple[Any, ...], run: Run) -> tuple[Any, ...]:
    """The events with the state components that are kept."""
    return tuple(replace(one, state=one.state[:, run._compared]) for one in events)


def _trajectory(run: Run, found: dict[str, Any], prefix: str) -> Trajectory:
    """One of the runs of a search."""
    return Trajectory(
        t=found[f"{prefix}t"],
        state=found[f"{prefix}states"].T,
        outcome=OUTCOMES[found[f"{prefix}ended"]],
        t_reached=found[f"{prefix}reached"],
        step=found[f"{prefix}step"],
        method=run.method,
        error=None,
        stats={"steps": found[f"{prefix}made"], run.counts: found["counted"]},
        system=run.system,
        _resume=run,
        _planned=partial(run.plan, Wanted(), 0.0),
    )


class _Sharper:
    """Maker of runs with a reduced tolerance for their shorter steps."""

    def __init__(self, make: Any, factor: int) -> None:
        self.make, self.factor = make, factor

    def __call__(self, h: float) -> Run:
        run: Run = self.make(h)
        run.sharpen(self.factor)
        run.maker = self
        return run


def _why(run: Run, found: dict[str, Any], n: int, accuracy: Accuracy) -> str:
    """Return the reason why no step size meets the tolerance."""
    run.take_search(found)
    fine = copy.copy(run)
    fine.state, fine.memory = found["last"], found["memory"]
    fine.looks = found["looks"].T if "looks" in found else nothing(0)
    last = fine._shaped(_trajectory(fine, found, ""))
    grown, steps, change = found["grown"], n * found["factor"], found["change"]
    if found["verdict"] == _GROWN:
        if grown > 1e300:
            return (
                "not met: with numbers of the system changed by rounding errors the run ends "
                "differently: the motion is chaotic or unstable, take a shorter run or a larger "
                "tolerance"
            )
        if last.outcome == "event":
            return (
                f"not met: roundings leave an error of {grown:.1e} of the event that ends the "
                f"run at t = {last.t_reached:.6g}: it is close to grazing, or the motion is "
                "chaotic or unstable, take a larger tolerance"
            )
        return (
            f"not met: the motion makes roundings of the numbers of the system "
            f"{grown / _EPS:.1e} times as large until t = {last.t_reached:.6g}, which leaves an "
            f"error of {grown:.1e}: the motion is chaotic or unstable, take a shorter run or a "
            "larger tolerance"
        )
    if found["verdict"] == _IN_LAYER:
        layer = last._layer()
        why = "a law changes in a layer thinner than a step (take dt below that, or a wider layer)"
        why = last._pole_passed() or (why if layer is None else layer.note())
        return f"not met with {steps} steps: {why}"
    if found["verdict"] == _TOO_MANY or "coarse_t" not in found:
        return f"not met: {steps} steps, and twice as many, are too many: give dt"
    coarse = copy.copy(run)
    coarse.state, coarse.memory = found["coarse_last"], found["memory"]
    before = coarse._shaped(_trajectory(coarse, found, "coarse_"))
    changed = "runs with different step sizes end differently"
    if change < 1e300:
        changed = f"states still change by {change:.1e}"
    why = reason(renamed_alike(before, last), last, accuracy)
    return f"not met with {steps} steps ({changed}): {why}"


def _plan_of(first: Run, want: Wanted, end: float, accuracy: Accuracy) -> Plan:
    plan = first.plan(want, end, accuracy.absolute or accuracy.relative)
    if accuracy.relative == 0:
        return plan
    step = "computes: the step, halved until the states kept change by no more than "
    lines = str(plan).splitlines()
    return Plan("\n".join(step + accuracy.text if s.startswith(step) else s for s in lines))


def _plan_with_estimate(planned: Any, how: str) -> Plan:
    words = "estimate of the error"
    plan: Plan = planned()
    return plan.instead(words, f"computes: {words}, {how}")
