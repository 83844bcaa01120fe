"""Step size search for motions in time: halving until the states kept change little enough.

The core makes all runs of a search (`viscovib_step_search`). This module passes the arguments, and
converts the results to a trajectory or to a message with the reason of the failure.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from viscovib.analyses.accuracy import Accuracy
from viscovib.analyses.runs import WITH_ERROR, WITH_SEARCH, NotMetError, Run, Wanted
from viscovib.common.plan import Plan
from viscovib.results.trajectory import Trajectory
from viscovib.systems.law_ends import edges_text

#: Verdicts of the core.
_FOUND, _NOT_MET, _IN_LAYER = range(3)


def by_tolerance(
    run: Run, n: int, end: float, want: Wanted, accuracy: Accuracy, progress: bool
) -> Trajectory:
    """Return the run to ``end`` with a step size that meets the tolerance.

    ``run``: at its start, with the first step size; n: number of steps if no load has corners.
    """
    first = copy.copy(run)
    found = _search(run, n, end, want, progress, accuracy=accuracy)
    if found["verdict"] != _FOUND:
        raise NotMetError(f"{accuracy}: {_why(run, found)}")
    run.has_found_step = True
    return _result(run, found, n, end, partial(first.plan, want, end, accuracy))


def with_estimate(run: Run, n: int, end: float, want: Wanted, progress: bool) -> Trajectory:
    """Return the run to ``end`` with given steps and an error estimate."""
    continues = run.done > 0
    found = _search(run, n, end, want, progress)
    how = "by a run with half the step size"
    if run.over_kinks:
        how = "by runs with a half and a third of the step size"
    if continues:
        how += " from the first start on"
    if found["was_shaken"]:
        how += ", and with numbers changed by 1e-12"
    plan = partial(run.plan, want, end)
    return _result(run, found, n, end, partial(_plan_with_estimate, plan, how))


def _search(
    run: Run,
    n: int,
    end: float,
    want: Wanted,
    progress: bool,
    accuracy: Accuracy | None = None,
) -> dict[str, Any]:
    """Results of the core; without an accuracy: the error of the run with n steps."""
    asked = want.asked or want
    run.check_wanted(want, n if run.mesh is None else run.mesh.count - run.done)
    more: dict[str, Any] = {"looks": asked.keep != "all" or asked.times is not None}
    if accuracy is None:
        return run.compute(WITH_ERROR, n, want, end, progress, **more)
    more |= {
        "absolute": accuracy.absolute, "relative": 0.0 if accuracy.by_size else accuracy.relative,
        "fills": want.no_choice,
    }  # fmt: skip
    return run.compute(WITH_SEARCH, n, want, end, progress, **more)


def _result(
    run: Run, found: dict[str, Any], n: int, end: float, planned: Callable[[], Plan]
) -> Trajectory:
    """The result of the search, which can be continued."""
    factor = found["factor"]
    run.h = found["step"]
    if run.mesh is not None:
        run.mesh = run.mesh.finer(factor)
    else:
        run.goal = (run.done + n) * factor, end
    run.solved, run.kept_of_step = found["solved"], found["per_step"]
    kept = run.take(found)
    events: tuple[Any, ...] = ()
    if run.watch is not None:
        errors = found["passage_errors"][:, kept]
        which = run.watch.rows[0]
        events = tuple(
            replace(one, error=errors[0, which == i], state_error=errors[1, which == i])
            for i, one in enumerate(run.watch.located(slice(run.state.size)), start=1)
        )
    result = run._shaped(run.result(found, "", found["error"], planned))
    return replace(result, events=_cut(events, run)) if events else result


def _cut(events: tuple[Any, ...], run: Run) -> tuple[Any, ...]:
    """The events with the state components that are kept."""
    return tuple(replace(one, state=one.state[:, run._compared]) for one in events)


def _why(run: Run, found: dict[str, Any]) -> str:
    """Return the reason why no step size meets the tolerance, with what laws have to do with it."""
    run.take(found)
    runs = [("", found["last"])]
    if "coarse_t" in found:
        runs.append(("coarse_", found["coarse_last"]))
    made = []
    for prefix, state in runs:
        one = copy.copy(run)
        one.state, one.memory = state, found["memory"]
        made.append(one._shaped(one.result(found, prefix)))
    last, cause = made[0], found["cause"]
    stopped = next((one for one in made if one.outcome != "completed"), None)
    if found["verdict"] == _IN_LAYER:
        cause = last._pole_passed() or last._layer_passed() or cause
    elif found["verdict"] == _NOT_MET and stopped is not None:
        pole = stopped._pole_passed() or stopped._pole_after(stopped.t.size - 1)
        if stopped._law_end is not None or pole is not None:
            cause += f": {stopped.reason}"
        elif stopped.outcome == "diverged":
            cause += edges_text(run.system)
    elif found["place"]:
        i = found["place"] - 1
        pole = last._pole_passed() or last._pole_after(i)
        cause = pole or last._layer_passed(slice(max(i - 1, 0), i + 3)) or cause
    return f"{found['not_met']}: {cause}"


def _plan_with_estimate(planned: Any, how: str) -> Plan:
    words = "estimate of the error"
    plan: Plan = planned()
    return plan.instead(words, f"computes: {words}, {how}")
