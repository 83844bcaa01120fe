"""Branches of periodic motions in time, by the continuation of the core."""

from __future__ import annotations

import warnings
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.accuracy import Accuracy
from viscovib.analyses.following import _Way
from viscovib.analyses.period_map import PeriodMap, check_mapped
from viscovib.analyses.shooting import MOST_PERIODS, SEARCHES, STABLE, begin_of
from viscovib.common.parameters import Number
from viscovib.errors import ConvergenceWarning, InputError, caller
from viscovib.results.curves import Crossing
from viscovib.results.motion_branch import MotionBranch
from viscovib.results.steady_motion import SteadyMotion
from viscovib.systems.load import LoadLike
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.structure import Structure
from viscovib.systems.system import turned

#: Outcomes of a branch and kinds of events, by their numbers in the core.
_OUTCOMES = ("completed", "stuck", "points", "stopped")
_EVENTS = ("", "fold", "branch point", "period doubling", "Neimark-Sacker", "grazing")
#: Smallest number of states of a motion over its period.
_SHOWN = 256
_MAX_STEP = Number("max_step", 1e-6, 0.5)


def trace_motion(
    system: PolynomialSystem | Structure,
    nu_range: tuple[float, float] | None = None,
    *,
    load: LoadLike | None = None,
    nu: float | None = None,
    load_range: tuple[float, float] | None = None,
    vary: str | None = None,
    vary_range: tuple[float, float] | None = None,
    initial: npt.ArrayLike | SteadyMotion | None = None,
    n_periods: int = 1,
    method: str = "auto",
    max_step: float = 0.02,
    max_points: int = 2000,
    tolerance: float | None = None,
    rtol: float | None = None,
    atol: float | None = None,
) -> MotionBranch:
    """Follow periodic motions along a parameter, in time, through folds.

    This is `trace_response` by shooting (`steady_motion`): steps end where laws switch, so folds,
    period doublings, Neimark-Sacker points and grazing are located as accurately as with smooth
    laws.

    Parameters
    ----------
    system, load, initial, n_periods, method, tolerance, rtol, atol
        As for `steady_motion`, which finds the motion at the start of the range.
    nu_range, nu, load_range, vary, vary_range
        The parameter that varies and its range, as for `trace_response`; ``vary`` for a
        `PolynomialSystem`.
    max_step : float
        Largest step along the branch, 1e-6 to 0.5: the change of the parameter relative to its
        range, and of the state relative to its size.
    max_points : int
        Largest number of points, 2 to 100000.

    Returns
    -------
    MotionBranch

    Warns
    -----
    ConvergenceWarning
        If no step continues the branch, if a bifurcation point could not be located, or if errors
        exceed the tolerance.

    Notes
    -----
    Pseudo-arclength continuation (Keller 1977) of P(y, p) = y. The test functions between two
    points are: for a fold the component of the tangent along the parameter, for a branch point the
    determinant of the derivatives with the tangent, for a period doubling det(P' + 1), for a
    Neimark-Sacker point the product of m_i m_j - 1 over the multipliers with a complex pair
    (Kuznetsov, Elements of Applied Bifurcation Theory, 10.2), for grazing the number of switches.
    If more multipliers cross the unit circle than these functions explain, the step is halved. At
    grazing of a rigid stop the branch has a corner. It continues where the derivatives behind the
    corner vanish, in the direction that keeps the sign of their determinant. Two changes between
    two points may be missed: use a smaller ``max_step``.

    Examples
    --------
    >>> import viscovib as vv
    >>> duffing = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="x^3")
    >>> vv.trace_motion(duffing, (0.5, 2.0), load=0.3).folds.size
    2
    """
    if nu is not None:
        system = turned(system, nu)
    check_mapped(system)
    ranges = {"nu_range": nu_range, "load_range": load_range, "vary_range": vary_range}
    if vary is not None and system._is_condensed:
        raise InputError(f"vary = {vary!r}: is for a PolynomialSystem here, see trace_response")
    way = _Way.checked(system, ranges, nu, vary, load, None)
    periods = _native.integer("n_periods", n_periods, 1, MOST_PERIODS)
    wanted = Accuracy.checked(tolerance, rtol, atol, 1e-10)
    assert wanted is not None
    longest = _MAX_STEP.check(max_step)
    most = _native.integer("max_points", max_points, 2, 100_000)
    mapping = PeriodMap.checked(system, load, way.fixed, periods, method)
    along = {}
    if way.numbers is not None:
        mapping = mapping.with_numbers(way.numbers.at(way.start))
        along = {"flat": way.numbers.rest, "direction": way.numbers.direction}
    begin = begin_of(system, mapping, initial)
    found = _native.apart(
        lambda: _native.run(
            "motion branch", mapping.system_in_core, **mapping.given, **along, **begin,
            varies=way.varies, start=way.start,
            finish=way.finish, max_step=longest, max_points=most, absolute=wanted.absolute,
            relative=wanted.relative,
        )
    )  # fmt: skip
    if found["doubts"]:
        warnings.warn(f"trace_motion{found['doubts']}", ConvergenceWarning, stacklevel=caller())
    return _branch(system, mapping, way, found)


def _branch(
    system: PolynomialSystem | Structure, mapping: PeriodMap, way: _Way, found: dict[str, Any]
) -> MotionBranch:
    """Create the result with names."""
    p, places, kinds = found["p"], found["place"], [_EVENTS[kind] for kind in found["kind"]]

    def of(kind: str, values: FloatArray) -> FloatArray:
        return values[[one == kind for one in kinds]]

    crossings = []
    for i, kind in enumerate(kinds):
        if kind == "grazing":
            continue
        located = not np.isnan(places[i])
        crossings.append(
            Crossing(
                kind, int(found["before"][i]) - 1, float(places[i]) if located else None,
                sure=bool(found["sure"][i]),
                error=float(found["place_error"][i]) if located else None,
            )
        )  # fmt: skip
    marks = tuple(
        (kind, place, largest)
        for kind, place, largest in zip(kinds, places.tolist(), found["largest"].T, strict=True)
        if not np.isnan(place)
    )
    return MotionBranch(
        varies=way.varies,
        parameter=p,
        nu=way.nu(p),
        state=found["begin"][: 2 * mapping.n_dof].T,
        smallest=found["low"].T,
        largest=found["high"].T,
        multipliers=found["multipliers"].T,
        stable=np.array([STABLE[code] for code in found["stable"].tolist()], dtype=object),
        switches=found["n_passed"].astype(np.int64),
        error=found["error"],
        folds=of("fold", places),
        fold_errors=of("fold", found["place_error"]),
        grazings=of("grazing", places),
        grazing_errors=of("grazing", found["place_error"]),
        crossings=tuple(crossings),
        outcome=_OUTCOMES[found["ended"]],
        n_periods=mapping.n_periods,
        system=system,
        repeats_after=found["repeats_after"].astype(np.int64),
        _marks=marks,
        _points=tuple(
            partial(_motion, system, mapping.along(way, float(p[i])), found, i)
            for i in range(p.size)
        ),
    )


def _motion(
    system: PolynomialSystem | Structure, mapping: PeriodMap, found: dict[str, Any], i: int
) -> SteadyMotion:
    """Compute the motion at a point over its period."""
    steps, begin = int(found["n_steps"][i]), found["begin"][:, i]
    t = np.linspace(0.0, mapping.period, -(-_SHOWN // steps) * steps + 1)
    states = mapping.run(begin, steps, times=t, derivatives=False).at_times
    return SteadyMotion(
        nu=mapping.nu,
        n_periods=mapping.n_periods,
        repeats_after=int(found["repeats_after"][i]),
        t=t[: len(states)],
        state=states,
        remembered=begin[2 * mapping.n_dof :].copy(),
        multipliers=found["multipliers"][:, i],
        stable=STABLE[int(found["stable"][i])],
        error=float(found["error"][i]),
        multiplier_error=float(found["multiplier_error"][i]),
        outcome=SEARCHES[int(found["outcome"][i])],
        iterations=0,
        switches=int(found["n_passed"][i]),
        step=mapping.period / steps,
        method=mapping.method,
        system=system,
        _map=mapping,
    )
