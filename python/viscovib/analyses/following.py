"""Branches of periodic solutions: continuation through folds, with stability."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray, core
from viscovib.analyses.starts import Start, StartLike, start_of
from viscovib.analyses.steady import _prepare
from viscovib.common.motion_stability import Stability
from viscovib.common.parameters import MOST_CHOSEN, OPPOSITE, STABILITY, SYMMETRIC, CurveOptions
from viscovib.common.plan import Plan
from viscovib.errors import ConvergenceWarning, InputError, caller
from viscovib.results.branch import Branch
from viscovib.results.curves import (
    MAX_SPECIAL,
    OUTCOMES,
    BranchPoint,
    check_departure,
    located_crossings,
    range_of,
)
from viscovib.results.structure_results import StructureBranch, warn_of_reduction
from viscovib.results.structure_view import View
from viscovib.systems.load import LoadLike
from viscovib.systems.oscillators import Steady, check_steady
from viscovib.systems.structure import Structure
from viscovib.systems.varying import varied

#: Numbers that all points together may hold.
_MAX_NUMBERS = 4e8
#: What varies, in the order of the core.
_KINDS = {"nu": 1, "load_factor": 2}


def trace_mount(
    system: Steady,
    nu_range: tuple[float, float] | None,
    *,
    load: LoadLike | None,
    base: LoadLike | None,
    nu: float | None,
    load_range: tuple[float, float] | None,
    vary: str | None,
    vary_range: tuple[float, float] | None,
    at: npt.ArrayLike,
    start: StartLike | None,
    leave: BranchPoint | None,
    opposite: bool,
    symmetric: bool | None,
    harmonics: int | str,
    stability: bool,
    coordinates: Sequence[str] | None,
    **options: Any,
) -> Branch:
    """`trace_response` of a mount, a polynomial system or a structure."""
    ranges = {"nu_range": nu_range, "load_range": load_range, "vary_range": vary_range}
    given = [name for name, ends in ranges.items() if ends is not None]
    if len(given) != 1:
        raise InputError("nu_range, load_range or vary_range: must be given, and only one of them")
    if (given[0] == "nu_range") != (nu is None):
        raise InputError("nu: must be given with load_range or vary_range, and only then")
    if (given[0] == "vary_range") != (vary is not None):
        raise InputError("vary: must be given with vary_range, and only then")
    first_p, finish = range_of(given[0], ranges[given[0]])
    varies = {"nu_range": "nu", "load_range": "load_factor"}.get(given[0], "")
    check_steady(system, base)
    numbers, first = None, None
    if vary is not None:
        if isinstance(system, Structure):
            raise InputError("vary: the numbers of a structure do not vary: follow nu or the load")
        numbers = varied(system, vary, first_p, finish)
        varies = numbers[0]
        first = numbers.at(first_p)
    if varies == "nu" and min(first_p, finish) <= 0:
        raise InputError(f"nu_range = ({first_p:g}, {finish:g}): must be greater than 0")
    fixed = first_p if nu is None else _native.number("nu", nu)
    stops = _native.real_array("at", at).reshape(-1)
    judged_too = STABILITY.check(stability)
    keeps = symmetric is None or SYMMETRIC.check(symmetric)
    begun: Start | None = None
    if start is not None:
        if leave is not None:
            raise InputError("start: must not be given with leave, which tells where to begin")
        begun = start_of(start, system.dof_names, fixed)
        keeps = keeps and not (symmetric is None and begun.has_even)
    curve = CurveOptions.checked(options)
    job, _, prepared, planned = _prepare(
        system, [fixed], load, base, "newton", harmonics, curve.tolerance, 100, 1.0, keep_idle=True,
        flat=first, may_choose=True, whole=numbers is not None,
    )  # fmt: skip
    chosen = _native.is_auto(harmonics)
    if planned.method != "newton":
        raise InputError(
            "system: nothing is nonlinear, its response is a single curve: see forced_response"
        )
    flat, direction = (job[0], np.zeros(job[0].size)) if numbers is None else numbers[1:]
    view = None
    if planned.loaded is not None:
        view = View.of(system, planned.loaded, coordinates)
    elif coordinates is not None:
        raise InputError("coordinates: only those of a structure are chosen")
    orders = planned.orders
    if not keeps:
        orders = np.arange((planned.orders[-1] if chosen else prepared[1]) + 1, dtype=np.int32)
    if chosen:
        orders = orders[orders <= max(MOST_CHOSEN, *job[-2])]
    n_dof, m = job[-1].shape[0] - 1, orders.size
    most = int(_MAX_NUMBERS / (8 * m * n_dof + 8 * n_dof + 16))
    points = curve.max_points
    if points > most:
        raise InputError(
            f"max_points = {points}: must be at most {most} with {n_dof} coordinates and {m} "
            "harmonics"
        )
    begin, along = np.zeros(2 * m * n_dof), np.zeros(2 * m * n_dof + 1)
    begin_p = 0.0
    if leave is not None:
        check_departure(leave)
        begin, along = leave.departure(2 * m * n_dof, OPPOSITE.check(opposite))
        begin_p = leave.parameter
    if begun is not None:
        begin_p = begun.place(varies, first_p, finish)
        factor = begin_p if varies == "load_factor" else 1.0
        begin = begun.unknowns(
            orders, job, system._base_direction, factor, system.dof_names, planned.loaded
        )
    cancel = np.zeros(1, dtype=np.intc)
    (
        n, ended, n_used, p, iterations, error, kept, truncation, coefficients, is_stop, n_folds,
        folds, fold_coefficients, n_branch, branch_p, branch_x, across, branch_before, judged,
        growing, multipliers, exponents, n_crossings, kinds, before, where, crossing_coefficients,
    ) = _native.call_interruptibly(
        core.mount_branch, cancel, flat, *job[1:], _KINDS.get(varies, 3), direction, fixed,
        curve.packed(first_p, finish, stops), prepared[1], int(keeps), points,
        int(leave is not None or begun is not None), begin, begin_p, along,
        points if judged_too else 0, m, min(points, MAX_SPECIAL), cancel,
    )  # fmt: skip
    if not n and begun is not None:
        raise InputError(f"start: no solution was found near it at {varies} = {begin_p:g}")
    if not n:
        raise InputError(
            f"{given[0]}: no solution was found at its beginning {first_p:g}: begin elsewhere"
        )
    found: Stability | None = None
    if judged_too:
        found = Stability.of(judged[:n], multipliers[:, :n], exponents[:, :n])
        if (judged[:n] < 0).all() and not system._active_kernels:
            found = None

    def absolute(relative: ComplexArray, factors: FloatArray) -> ComplexArray:
        if varies != "load_factor":
            factors = np.ones(factors.size)
        if view is not None:
            return np.ascontiguousarray(relative.T)
        return _absolute(relative.T, system._base_direction, job, orders, factors)

    def shown(relative: ComplexArray, at: FloatArray, whole: bool = True) -> ComplexArray:
        """Motions, or their directions, in the coordinates that the result holds."""
        if view is None:
            return absolute(relative, at) if whole else np.ascontiguousarray(relative.T)
        ones = np.ones(at.size)
        factors = whole * (at if varies == "load_factor" else ones)
        nu_there = at if varies == "nu" else fixed * ones
        return view.expand(nu_there, orders, relative.T, factors)

    orders = orders[:n_used]
    crossings = located_crossings(
        (n_crossings, kinds, before, where),
        shown(crossing_coefficients[:n_used, :, :n_crossings], where[:n_crossings]),
    )
    values = p[:n].copy()
    same = np.ones(n)
    _warn_above(
        truncation[:n], curve.tolerance, varies, p,
        f"harmonics up to {orders[-1]} do not reach the tolerance",
    )  # fmt: skip
    _warn_above(error[:n], curve.tolerance, varies, p, "rounding leaves more than the tolerance")
    places = branch_p[:n_branch]
    points_off = shown(_complex(branch_x[:, :n_branch], n_dof, m)[:n_used], places)
    directions = shown(_complex(across[:-1, :n_branch], n_dof, m)[:n_used], places, whole=False)
    motions = absolute(coefficients[:n_used, :, :n], values)
    at_folds = absolute(fold_coefficients[:n_used, :, :n_folds], folds[:n_folds])
    names, units = system.dof_names, system.dof_units
    kind: Callable[..., Branch] = Branch
    if view is not None:
        names, units = view.names, view.units
        kind = partial(StructureBranch, _condensed=motions, _condensed_folds=at_folds, _view=view)
    branch = kind(
        nu=values if varies == "nu" else fixed * same,
        load_factor=values if varies == "load_factor" else same,
        harmonics=orders,
        coefficients=motions,
        stable=found.stable if found else None,
        growing=growing[:n].copy() if found else None,
        multipliers=found.multipliers if found else None,
        exponents=found.exponents if found else None,
        slowest=found.slowest if found else None,
        folds=folds[:n_folds].copy(),
        fold_coefficients=at_folds,
        branch_points=tuple(
            BranchPoint(
                float(branch_p[i]),
                points_off[i],
                int(branch_before[i]) - 1,
                directions[i],
                branch_x[:, i].copy(),
                across[:, i].copy(),
            )
            for i in range(n_branch)
        ),
        crossings=crossings,
        stops=np.flatnonzero(is_stop[:n]),
        outcome=OUTCOMES[ended],
        iterations=iterations[:n].copy(),
        error=error[:n].copy(),
        varies=varies,
        parameter=values,
        highest=orders[kept[:n] - 1],
        truncation=truncation[:n].copy(),
        dof_names=names,
        dof_units=units,
        plan=_plan(varies, first_p, finish, 0 if chosen else m, planned, judged_too),
        _job=(flat, *job[1:], _KINDS.get(varies, 3), direction, fixed),
        _tolerance=curve.tolerance,
    )
    if isinstance(branch, StructureBranch):
        warn_of_reduction(branch)
    return branch


def _warn_above(
    errors: FloatArray, tolerance: float, varies: str, p: FloatArray, told: str
) -> None:
    """Warn of points whose error is above the tolerance."""
    above = errors > tolerance
    if above.any():
        warnings.warn(
            f"at {above.sum()} of {errors.size} points {told} {tolerance:.1e}; worst at {varies} = "
            f"{p[errors.argmax()]:.6g}, with an estimated relative error of {errors.max():.1e}",
            ConvergenceWarning,
            stacklevel=caller(),
        )


def _plan(
    varies: str, start: float, finish: float, n_orders: int, planned: Any, stability: bool
) -> Plan:
    first = core.branch_plan(
        _KINDS.get(varies, 3), start, finish, n_orders, int(stability)
    ).decode()
    if varies not in _KINDS:
        first = first.replace("the parameter", varies)
    return Plan(f"{first.strip()}\n{planned.rest.strip()}")


def _complex(unknowns: FloatArray, n_dof: int, n_orders: int) -> ComplexArray:
    """X_k, shape (n_orders, n_dof, n), from unknowns (2 n_orders n_dof, n) of the core."""
    parts = unknowns.reshape(n_dof, n_orders, 2, unknowns.shape[1])
    return np.moveaxis(parts[:, :, 0] + 1j * parts[:, :, 1], 0, 1)


def _absolute(
    relative: ComplexArray,
    direction: FloatArray | None,
    job: tuple[Any, ...],
    kept: npt.NDArray[np.int32],
    factors: FloatArray,
) -> ComplexArray:
    """From coordinates relative to the base to absolute ones."""
    result = np.ascontiguousarray(relative)
    orders, series = job[-2], job[-1]
    if direction is None:
        return result
    for order, moved in zip(orders, series[-1], strict=True):
        for d in np.flatnonzero(direction):
            result[:, d, kept == order] += direction[d] * moved * factors[:, np.newaxis]
    return result
