"""Branches of periodic solutions: continuation through folds, with stability."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray, core
from viscovib.analyses.starts import Start, StartLike, start_of
from viscovib.analyses.steady import _prepare, falling
from viscovib.bodies.body import Body
from viscovib.bodies.varying_body import varied_body
from viscovib.common.motion_stability import Stability, hanging, truncated_crossings
from viscovib.common.parameters import OPPOSITE, STABILITY, SYMMETRIC, CurveOptions
from viscovib.common.plan import Plan
from viscovib.errors import ConvergenceWarning, InputError, caller
from viscovib.results.branch import Branch
from viscovib.results.curves import (
    MAX_SPECIAL,
    OUTCOMES,
    BranchPoint,
    check_departure,
    checked_stops,
    located_branch_points,
    located_crossings,
    range_of,
)
from viscovib.results.dissipation import Parts
from viscovib.results.structure_results import StructureBranch
from viscovib.results.structure_view import View
from viscovib.systems.law_ends import told_edges
from viscovib.systems.load import LoadLike, base_shifts
from viscovib.systems.oscillators import Steady, check_steady, refuse_turning
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.sticking import advice_on_sticking
from viscovib.systems.stiffness_ratio import advice_on_springs
from viscovib.systems.structure import Structure
from viscovib.systems.varying import Varied, varied
from viscovib.systems.varying_structure import varied_structure

#: Numbers that all points together may hold.
_MAX_NUMBERS = 4e8
#: What varies, in the order of the core.
_KINDS = {"nu": 1, "load_factor": 2}


@dataclass(frozen=True)
class _Way:
    """What varies along a branch, and from where to where.

    ``fixed`` is the frequency where that does not vary; ``numbers`` what a parameter of the
    system is in the vector that the core takes.
    """

    argument: str
    varies: str
    start: float
    finish: float
    fixed: float
    numbers: Varied | None
    #: The system that has these numbers.
    system: Steady

    @classmethod
    def checked(
        cls,
        system: Steady,
        ranges: dict[str, tuple[float, float] | None],
        nu: float | None,
        vary: str | None,
        load: LoadLike | None,
        base: LoadLike | None,
    ) -> _Way:
        """Hold the arguments against each other."""
        given = [name for name, ends in ranges.items() if ends is not None]
        if len(given) != 1:
            raise InputError(
                "nu_range, load_range or vary_range: must be given, and only one of them"
            )
        if (given[0] == "nu_range") != (nu is None):
            raise InputError("nu: must be given with load_range or vary_range, and only then")
        if (given[0] == "vary_range") != (vary is not None):
            raise InputError("vary: must be given with vary_range, and only then")
        start, finish = range_of(given[0], ranges[given[0]])
        varies = {"nu_range": "nu", "load_range": "load_factor"}.get(given[0], "")
        numbers = None
        if vary is not None:
            if isinstance(system, Structure):
                numbers, system = varied_structure(system, vary, start, finish, load, base)
            else:
                refuse_turning(system, "a parameter that varies")
                if isinstance(system, Body):
                    numbers = varied_body(system, vary, start, finish)
                else:
                    numbers = varied(system, vary, start, finish)
            varies = numbers[0]
        if varies == "nu" and min(start, finish) <= 0:
            raise InputError(f"nu_range = ({start:g}, {finish:g}): must be greater than 0")
        fixed = start if nu is None else _native.number("nu", nu)
        return cls(given[0], varies, start, finish, fixed, numbers, system)

    @property
    def kind(self) -> int:
        """What varies, as the core counts it."""
        return _KINDS.get(self.varies, 3)

    def flat(self, at_start: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The system at 0 of what varies in it, and how it changes with that."""
        if self.numbers is None:
            return at_start, np.zeros(at_start.size)
        return self.numbers[1:]

    def nu(self, values: FloatArray) -> FloatArray:
        """Frequencies at values of what varies."""
        return values if self.varies == "nu" else self.fixed * np.ones(values.size)

    def factors(self, values: FloatArray) -> FloatArray:
        """Factors of the load there."""
        return values if self.varies == "load_factor" else np.ones(values.size)


@dataclass(frozen=True)
class _Shown:
    """From unknowns of the core to what results hold: absolute motions, coordinates wanted."""

    system: Steady
    way: _Way
    job: tuple[Any, ...]
    orders: npt.NDArray[np.int32]
    #: Of a structure: which coordinates are shown.
    view: View | None

    def absolute(self, relative: ComplexArray, at: FloatArray) -> ComplexArray:
        """Motions of the coordinates that the core has, shape (n, n_dof, n_orders)."""
        if self.view is not None:
            return np.ascontiguousarray(relative.T)
        direction = self.system._base_direction
        return _absolute(relative.T, direction, self.job, self.orders, self.way.factors(at))

    def motions(self, relative: ComplexArray, at: FloatArray) -> ComplexArray:
        """Motions in the coordinates that the result holds."""
        if self.view is None:
            return self.absolute(relative, at)
        return self.view.expand(self.way.nu(at), self.orders, relative.T, self.way.factors(at))

    def directions(self, relative: ComplexArray, at: FloatArray) -> ComplexArray:
        """Differences of motions in these coordinates."""
        if self.view is None:
            return np.ascontiguousarray(relative.T)
        return self.view.expand(self.way.nu(at), self.orders, relative.T, np.zeros(at.size))


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
    check_steady(system, base)
    way = _Way.checked(system, ranges, nu, vary, load, base)
    system = way.system
    stops = checked_stops(at, way.varies, way.start, way.finish)
    judged = STABILITY.check(stability)
    keeps = symmetric is None or SYMMETRIC.check(symmetric)
    begun: Start | None = None
    if start is not None:
        if leave is not None:
            raise InputError("start: must not be given with leave, which tells where to begin")
        begun = start_of(start, system.dof_names, way.fixed)
        keeps = keeps and not (symmetric is None and begun.has_even)
    curve = CurveOptions.checked(options)
    job, _, prepared, planned = _prepare(
        system, [way.fixed], load, base, "newton", harmonics,
        (curve.tolerance, curve.values["atol"]), 100, 1.0,
        keep_idle=True, flat=None if way.numbers is None else way.numbers.at(way.start),
        may_choose=True, whole=way.numbers is not None, judged=judged,
    )  # fmt: skip
    if planned.method != "newton":
        raise InputError(
            "system: nothing is nonlinear: its response is a single curve, see forced_response"
        )
    if planned.loaded is None and coordinates is not None:
        raise InputError("coordinates: can be chosen for a structure only, must be None")
    auto = _native.is_auto(harmonics)
    orders = planned.orders
    if not keeps:
        orders = np.arange((planned.orders[-1] if auto else prepared[1]) + 1, dtype=np.int32)
    n_dof, m, points = job[-1].shape[0] - 1, orders.size, curve.max_points
    _check_size(points, n_dof, m)
    begin, begin_p, along = _begin(system, way, job, planned.loaded, orders, leave, opposite, begun)
    flat, direction = way.flat(job[0])
    whole_job = (flat, *job[1:], way.kind, direction, way.fixed)
    cancel = np.zeros(1, dtype=np.intc)
    found = _native.call_interruptibly(
        core.mount_branch, cancel, *whole_job, curve.packed(way.start, way.finish, stops),
        prepared[1], int(keeps), points, int(leave is not None or begun is not None), begin,
        begin_p, along, points if judged else 0, m, min(points, MAX_SPECIAL), cancel,
    )  # fmt: skip
    if not found[0] and begun is not None:
        raise InputError(f"start: no solution was found near it at {way.varies} = {begin_p:g}")
    if not found[0]:
        raise InputError(
            f"{way.argument}: no solution was found at its beginning {way.start:g}: begin elsewhere"
            f"{_advice(system)}"
        )
    view = None
    if planned.loaded is not None:
        view = View.of(system, planned.loaded, coordinates)
    shown = _Shown(system, way, job, orders[: found[2]], view)
    plan = _plan(way.varies, way.start, way.finish, -orders[-1] if auto else m, planned, judged)
    return _branch(found, shown, (n_dof, m), curve.tolerance, judged, plan, whole_job)


def _advice(system: Steady) -> str:
    """Return why a branch may not begin or go on, and what helps, as far as the system tells."""
    advice = told_edges(system) + advice_on_sticking(system)
    if isinstance(system, PolynomialSystem):
        advice += advice_on_springs(system._mass_matrix, system._stiffness_at_rest)
    return advice


def _check_size(points: int, n_dof: int, m: int) -> None:
    """Refuse more points than there is room for."""
    most = int(_MAX_NUMBERS / (8 * m * n_dof + 8 * n_dof + 16))
    if points > most:
        raise InputError(
            f"max_points = {points}: must be at most {most} with {n_dof} coordinates and {m} "
            "harmonics"
        )


def _begin(
    system: Steady,
    way: _Way,
    job: tuple[Any, ...],
    loaded: Any,
    orders: npt.NDArray[np.int32],
    leave: BranchPoint | None,
    opposite: bool,
    begun: Start | None,
) -> tuple[FloatArray, float, FloatArray]:
    """Unknowns to begin with, where, and the direction; nothing: at the beginning of the range."""
    n = 2 * orders.size * (job[-1].shape[0] - 1)
    if leave is not None:
        check_departure(leave)
        begin, along = leave.departure(n, OPPOSITE.check(opposite))
        return begin, leave.parameter, along
    if begun is None:
        return np.zeros(n), 0.0, np.zeros(n + 1)
    at = begun.place(way.varies, way.start, way.finish)
    factor = at if way.varies == "load_factor" else 1.0
    begin = begun.unknowns(orders, job, system._base_direction, factor, system.dof_names, loaded)
    return begin, at, np.zeros(n + 1)


def _branch(
    found: tuple[Any, ...],
    shown: _Shown,
    size: tuple[int, int],
    tolerance: float,
    judged_too: bool,
    plan: Plan,
    job: tuple[Any, ...],
) -> Branch:
    """Give what the core found its names and units."""
    (
        n, ended, n_used, p, iterations, error, off, kept, truncation, missed, coefficients,
        is_stop, n_folds, folds, fold_errors, fold_coefficients, fold_coefficient_errors, n_branch,
        branch_p, branch_errors, branch_x, across, branch_before, judged, growing, multipliers,
        exponents, n_crossings, kinds, before, where, crossing_errors, crossing_coefficients,
        allowed,
    ) = found  # fmt: skip
    system, way, view, orders = shown.system, shown.way, shown.view, shown.orders
    stability: Stability | None = None
    if judged_too:
        stability = Stability.of(judged[:n], multipliers[:, :n], exponents[:, :n])
        if (judged[:n] == -1).all() and not system._active_kernels:
            stability = None
    allowed = allowed[:n].copy()
    values, places, crossed = p[:n].copy(), branch_p[:n_branch], where[:n_crossings]
    motions = shown.absolute(coefficients[:n_used, :, :n], values)
    at_folds = shown.absolute(fold_coefficients[:n_used, :, :n_folds], folds[:n_folds])
    names, units = system.dof_names, system.dof_units
    kind: Callable[..., Branch] = Branch
    if view is not None:
        names, units = view.names, view.units
        kind = partial(StructureBranch, _condensed=motions, _condensed_folds=at_folds, _view=view)
    branch = kind(
        nu=way.nu(values),
        load_factor=way.factors(values),
        harmonics=orders,
        coefficients=motions,
        stable=stability.stable if stability else None,
        growing=growing[:n].copy() if stability else None,
        multipliers=stability.multipliers if stability else None,
        exponents=stability.exponents if stability else None,
        slowest=stability.slowest if stability else None,
        folds=folds[:n_folds].copy(),
        fold_errors=fold_errors[:n_folds].copy(),
        fold_coefficients=at_folds,
        fold_coefficient_errors=fold_coefficient_errors[:n_folds].copy(),
        branch_points=located_branch_points(
            places,
            branch_errors,
            shown.motions(_complex(branch_x[:, :n_branch], *size)[:n_used], places),
            branch_before,
            shown.directions(_complex(across[:-1, :n_branch], *size)[:n_used], places),
            branch_x,
            across,
        ),
        crossings=located_crossings(
            (n_crossings, kinds, before, where, crossing_errors),
            shown.motions(crossing_coefficients[:n_used, :, :n_crossings], crossed),
            judged[:n] < 0,
        ),
        stops=np.flatnonzero(is_stop[:n]),
        outcome=OUTCOMES[ended],
        iterations=iterations[:n].copy(),
        error=error[:n].copy(),
        varies=way.varies,
        parameter=values,
        highest=orders[kept[:n] - 1],
        truncation=truncation[:n].copy(),
        dof_names=names,
        dof_units=units,
        plan=plan,
        _job=job,
        _tolerance=tolerance,
        _allowed=allowed,
        _off=off[:n].copy(),
        _missed=missed[:n].copy(),
        _parts=Parts(system, shown.job[-2], shown.job[-1]),
    )
    _warn_of_doubts(branch, motions, p)
    advice = ""
    if branch.outcome == "stuck":
        advice = _advice(system)
    if advice:
        warnings.warn(
            f"the branch ends at {way.varies} = {values[-1]:.6g}{advice}",
            ConvergenceWarning,
            stacklevel=caller(),
        )
    branch._warn_of_reduction()
    return branch


def _warn_of_doubts(branch: Branch, motions: ComplexArray, p: FloatArray) -> None:
    """Tell where rounding, or harmonics left out, leave more than the tolerance."""
    stable, allowed, tolerance = branch.stable, branch._allowed, branch._tolerance
    few, blurred = branch._few, branch._off > allowed
    _warn_above(
        branch._off, allowed, tolerance, branch.varies, p,
        "rounding leaves more than the tolerance",
        hanging(stable, blurred & ~few, "rounding decides"),
    )  # fmt: skip
    worst = int(np.where(few, branch._missed, 0).argmax())
    _warn_above(
        np.where(few, branch._missed, 0), allowed, tolerance, branch.varies, p,
        f"harmonics up to {branch.harmonics[-1]} do not reach the tolerance",
        (falling(motions[worst]) if few[worst] else "")
        + hanging(stable, few)
        + truncated_crossings([c.before for c in branch.crossings], few),
    )  # fmt: skip


def _warn_above(
    errors: FloatArray,
    allowed: FloatArray,
    tolerance: float,
    varies: str,
    p: FloatArray,
    told: str,
    more: str = "",
) -> None:
    """Warn of points whose error is above the tolerance."""
    above = errors > allowed
    if above.any():
        warnings.warn(
            f"at {above.sum()} of {errors.size} points {told} {tolerance:.1e}; worst at {varies} = "
            f"{p[errors.argmax()]:.6g}, with an estimated relative error of {errors.max():.1e}"
            f"{more}",
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
    for order, moved in base_shifts(orders, series, direction):
        for d in np.flatnonzero(moved):
            result[:, d, kept == order] += moved[d] * factors[:, np.newaxis]
    return result
