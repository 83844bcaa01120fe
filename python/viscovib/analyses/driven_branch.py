"""Branches of driven motions of the pendulum: folds, branch points, stability."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.analyses.torus import (
    FREQUENCIES,
    IntArray,
    axes_of,
    chosen,
    loads_of,
    order_name,
    place_of,
    tail,
    torus_plan,
    unknowns_of,
)
from viscovib.common.column_notes import NOTES
from viscovib.common.motion_stability import (
    stability_columns,
    three_valued,
    whole_or_codes,
)
from viscovib.common.parameters import (
    DURATION,
    OPPOSITE,
    STABILITY,
    SYMMETRIC,
    CurveOptions,
    checked,
)
from viscovib.common.periodic_motions import PeriodicMotions
from viscovib.common.plan import Plan, wanted_places
from viscovib.common.results import Dataset, Panel, as_dataset
from viscovib.common.stability import stability_by_rates, warn_of_unknown
from viscovib.common.tables import Table, listed
from viscovib.errors import ConvergenceWarning, InputError, caller
from viscovib.results.curves import (
    OUTCOMES,
    BranchPoint,
    Crossing,
    Curve,
    branch_notes,
    check_departure,
    checked_stops,
    crossing_variables,
    largest_panels,
    located_branch_points,
    located_crossings,
    range_of,
    rounding_text,
    warn_of_rounding,
)
from viscovib.systems.pendulum import Pendulum


@dataclass(frozen=True, eq=False, repr=False)
class DrivenBranch(PeriodicMotions, Curve):
    """A branch of driven motions q = Im sum_k X_k exp(i k.omega t), in the order followed.

    Attributes
    ----------
    varies : str
        "p1", "p2", "p3", "f0", "m01", "m02" or "nu".
    parameter : ndarray, shape (n,)
        Values of the parameter that varies.
    axes, base, orders : as in `DrivenResponse`
    coefficients : complex ndarray, shape (n, 3, m)
        X_k of z, phi (rad), psi (rad).
    stable : ndarray of bool, shape (n,), or None
        None: not requested, or several base frequencies without a ``duration``. If the stability of
        some motions is unknown (too stiff for the Floquet solver, a rate smaller than its error),
        the array contains objects: True, False and None.
    multipliers : complex ndarray, shape (n, 6), or None
        Floquet multipliers over a period of the base frequency, largest first; NaN if unknown.
    growing : ndarray of int, shape (n,), or None
        Number of multipliers outside the unit circle; -1: unknown.
    growth, growth_error : ndarray, shape (n, 6), or None
        With several base frequencies: as in `DrivenResponse`.
    folds : ndarray, shape (n_folds,)
        Parameter values at which the branch turns back.
    fold_errors : ndarray, shape (n_folds,)
        As in `Branch`.
    fold_coefficients : complex ndarray, shape (n_folds, 3, m)
    branch_points : tuple of BranchPoint
        Points at which a second branch crosses. Pass one of them to `trace_response` as ``leave``.
    crossings : tuple of Crossing
        Bifurcation points: "fold", "branch point" (also symmetry breaking), "period doubling" or
        "Neimark-Sacker".
    stops : ndarray of int
        Indices of the points at the values of ``at``.
    outcome : str
        As in `Branch`, or "unphysical": the motion reaches z = -1; "closed": back at the first
        point.
    error : ndarray, shape (n,)
        As in `Branch`: error of each motion at its parameter value by the last correction and
        rounding.
    plan : Plan
        What was computed, and what was skipped and why.

    Examples
    --------
    >>> import viscovib as vv
    >>> body = vv.Pendulum(
    ...     e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01, f0=0.002, p1=1.02
    ... )
    >>> branch = vv.trace_response(body, p1=(0.9, 1.0), harmonics=5)
    >>> branch.outcome
    'completed'
    """

    varies: str
    parameter: FloatArray
    axes: tuple[str, ...]
    base: FloatArray
    orders: IntArray
    coefficients: ComplexArray
    stable: npt.NDArray[Any] | None
    multipliers: ComplexArray | None
    growing: IntArray | None
    growth: FloatArray | None
    growth_error: FloatArray | None
    folds: FloatArray
    fold_errors: FloatArray
    fold_coefficients: ComplexArray
    branch_points: tuple[BranchPoint, ...]
    crossings: tuple[Crossing, ...]
    stops: npt.NDArray[np.intp]
    outcome: str
    iterations: IntArray
    error: FloatArray
    plan: Plan
    #: The pendulum, its loads and harmonics for the core, the relative tolerance, and the largest
    #: estimated error by neglected orders.
    _system: Pendulum = field(repr=False)
    _given: dict[str, Any] = field(repr=False)
    _tolerance: float = field(repr=False)
    _worst: float = field(repr=False)
    #: Rounding error of each point.
    _off: FloatArray = field(repr=False)
    dof_names: tuple[str, ...] = Pendulum.dof_names
    dof_units: tuple[str, ...] = ("1", "rad", "rad")

    @property
    def _crossed(self) -> tuple[BranchPoint, ...]:  # type: ignore[override]
        return self.branch_points

    @property
    def nu(self) -> FloatArray:
        """Base frequencies, shape (n,) for a single axis."""
        return self.base[:, 0] if len(self.axes) == 1 else self.base

    @property
    def harmonics(self) -> IntArray:
        """Harmonics, shape (m,) for a single axis."""
        return self.orders[:, 0] if len(self.axes) == 1 else self.orders

    @property
    def truncation(self) -> FloatArray:
        """Estimated relative error by neglected harmonics, shape (n,)."""
        return tail(self.coefficients, self.orders)

    @property
    def label(self) -> str:
        """Axis label of the parameter."""
        return {"nu": r"base frequency $\nu$"}.get(self.varies, self.varies)

    @property
    def _orders(self) -> IntArray:
        return self.orders

    def _motions(self) -> tuple[FloatArray, npt.NDArray[Any], ComplexArray]:
        if len(self.axes) > 1:
            raise InputError("these motions are quasi-periodic: they have no period")
        return self.nu, self.harmonics, self.coefficients

    def _lacking(self) -> str:
        words = rounding_text(self._off, self._tolerance)
        if self._worst <= self._tolerance:
            return words
        return f", too few harmonics (estimated error {self._worst:.1e}){words}"

    def panels(self) -> list[Panel]:
        """Return amplitudes along the branch, each of the largest harmonic."""
        if len(self.axes) > 1:
            raise InputError("quasi-periodic motions have no single harmonic to draw")
        return largest_panels(self, self.parameter, self.varies)

    def _place(self, dof: str, harmonic: int | tuple[int, ...]) -> tuple[int, int]:
        d = self.dof_names.index(_native.choice("dof", dof, self.dof_names))
        return d, place_of(self.orders, harmonic)

    def _summit(
        self, i: int, d: int, j: int, low: float, high: float
    ) -> tuple[float, float] | None:
        x = unknowns_of(self.coefficients[i])
        found = _native.apart(
            lambda: _native.run(
                "drive peak", self._system._handle, p=float(self.parameter[i]), x=x,
                tolerance=self._tolerance, dof=d + 1, place=j + 1, low=float(low),
                high=float(high), **self._given,
            )
        )  # fmt: skip
        return (found["at"], found["size"]) if found["enclosed"] else None

    def to_dataset(self) -> Dataset:
        """Return all data as an xarray Dataset over the points."""
        data: dict[str, Any] = {
            "parameter": ("point", self.parameter),
            "base": (("point", "axis"), self.base),
            "orders": (("order", "axis"), self.orders),
            "coefficients": (("point", "dof", "order"), self.coefficients),
            "truncation": ("point", self.truncation),
            "error": ("point", self.error),
            "iterations": ("point", self.iterations),
            **crossing_variables(self.crossings),
        }
        if self.stable is not None:
            data["stable"] = ("point", whole_or_codes(self.stable))
        if self.multipliers is not None:
            data["growing"] = ("point", self.growing)
            data["multipliers"] = (("point", "multiplier"), self.multipliers)
        if self.growth is not None:
            data["growth"] = (("point", "multiplier"), self.growth)
            data["growth_error"] = (("point", "multiplier"), self.growth_error)
        return as_dataset(
            data,
            coords={
                "dof": list(self.dof_names),
                "unit": ("dof", list(self.dof_units)),
                "axis": list(self.axes),
            },
            attrs={
                "varies": self.varies,
                "outcome": self.outcome,
                "folds": self.folds,
                "fold_errors": self.fold_errors,
                "branch_points": [point.parameter for point in self.branch_points],
                "branch_point_errors": [point.error for point in self.branch_points],
                "plan": str(self.plan),
            },
        )

    def _table(self, coordinates: Sequence[str] | None) -> Table:
        notes = branch_notes(self)
        places = listed(point.parameter for point in self.branch_points)
        message = [f"branch points at {self.varies} ={places}"]
        if self.branch_points:
            off = listed(point.error for point in self.branch_points)
            message.append(f"estimated errors of these branch points:{off}")
        first = 2 if self.folds.size else 1
        notes[first:first] = message
        table = Table(notes, {self.varies: self.parameter})
        table.columns |= {f"omega_{j + 1}": self.base[:, j] for j in range(len(self.axes))}
        note = NOTES["driven"]
        if self.growing is not None:
            note += NOTES["stability"]
            table.columns |= stability_columns(self.growing, self.multipliers)
        elif self.stable is not None:
            table.columns["stable"] = whole_or_codes(self.stable)
        highest = int(np.abs(self.orders).sum(axis=1).max())
        table.notes.append(
            f"{note}; harmonics up to {highest}, largest estimated relative error "
            f"{self._worst:.16e}{NOTES['driven_error']}"
        )
        table.columns["error"] = self.error
        names = {d: self.dof_names[d] for d in wanted_places(coordinates, self.dof_names)}
        table.add_harmonics(names, map(order_name, self.orders), self.coefficients)
        return table


def trace_pendulum(
    system: Pendulum,
    *,
    p1: tuple[float, float] | None,
    p2: tuple[float, float] | None,
    p3: tuple[float, float] | None,
    f0: tuple[float, float] | None,
    m01: tuple[float, float] | None,
    m02: tuple[float, float] | None,
    nu: tuple[float, float] | None,
    at: npt.ArrayLike,
    leave: BranchPoint | None,
    opposite: bool,
    harmonics: int | str,
    stability: bool,
    duration: float | None,
    symmetric: bool | None,
    subharmonic: int,
    max_denominator: int,
    **options: Any,
) -> DrivenBranch:
    """`trace_response` of a pendulum."""
    varies, value = chosen(
        {"p1": p1, "p2": p2, "p3": p3, "f0": f0, "m01": m01, "m02": m02, "nu": nu}
    )
    if varies is None:
        raise InputError("p1, p2, p3, f0, m01, m02 or nu: one must be given, as (from, to)")
    start, finish = range_of(varies, value)
    if (varies in FREQUENCIES or varies == "nu") and min(start, finish) <= 0:
        raise InputError(f"{varies} = ({start:g}, {finish:g}): must be greater than 0")
    curve = CurveOptions.checked(options)
    checked((STABILITY, OPPOSITE), locals())
    keeps = symmetric is not None and SYMMETRIC.check(symmetric)
    given = loads_of(varies, harmonics, keeps, subharmonic, max_denominator)
    if leave is not None:
        check_departure(leave)
    averaged = 0.0 if duration is None else DURATION.check(duration)
    stops = checked_stops(at, varies, start, finish)
    begin: dict[str, Any] = {}
    if leave is not None:
        unknowns, along = leave.departure(leave._unknowns.size, opposite)
        begin = {"begin": unknowns, "begin_p": leave.parameter, "along": along}
    found = _native.apart(
        lambda: _native.run(
            "drive branch", system._handle, stability=bool(stability), duration=float(averaged),
            **given, **begin, **curve.along(start, finish, stops=stops),
        )
    )  # fmt: skip
    worst = found["truncation"]
    if worst > curve.tolerance:
        warnings.warn(
            f"{found['bound']} harmonics: the estimated relative error is {worst:.1e}, more "
            f"than the tolerance {curve.tolerance:.1e}",
            ConvergenceWarning,
            stacklevel=caller(),
        )
    warn_of_rounding(found["off"], curve.tolerance)
    several = found["named"].size > 1
    assessed = "rates" if several else "multipliers"
    if "rates" not in found and "multipliers" not in found:
        assessed = "not requested"
        if several and stability:
            assessed = "of quasi-periodic motions: only over a duration"
    plan = torus_plan(
        f"computes: the branch from {varies} = {start:g} to {finish:g}",
        system, found, varies, assessed,
    )  # fmt: skip
    given |= {"choose": False, "harmonics": found["bound"]}
    return _branch(varies, system, given, curve.tolerance, found, plan)


def _branch(
    varies: str, system: Pendulum, given: dict[str, Any], tolerance: float,
    found: dict[str, Any], plan: Plan,
) -> DrivenBranch:  # fmt: skip
    """Create the result with names and units."""
    unit, n = found["unit"], found["p"].size
    places = (
        "folds", "fold_errors", "branch_points", "branch_errors", "crossings", "crossing_errors",
    )  # fmt: skip
    found |= {name: found[name] * unit for name in places if name in found}
    multipliers, stable, growing, growth, growth_error = None, None, None, None, None
    if "rates" in found:
        growth, growth_error = found["rates"].T, found["rates_off"].T
        stable = stability_by_rates(growth, growth_error, np.ones(n, dtype=bool))
    elif "multipliers" in found:
        multipliers, growing = found["multipliers"].T, found["growing"]
        stable = three_valued(growing == 0, growing < 0)
        warn_of_unknown(growing < 0)
    crossings: tuple[Crossing, ...] = ()
    if growing is not None:
        crossings = located_crossings(found, found["crossing_coefficients"].T, growing < 0)
    return DrivenBranch(
        varies=varies,
        parameter=found["p"] * unit,
        axes=axes_of(found),
        base=found["base"].T,
        orders=np.ascontiguousarray(found["orders"].T, dtype=np.int32),
        coefficients=found["coefficients"].T,
        stable=stable,
        multipliers=multipliers,
        growing=growing,
        growth=growth,
        growth_error=growth_error,
        folds=found["folds"],
        fold_errors=found["fold_errors"],
        fold_coefficients=found["fold_coefficients"].T,
        branch_points=located_branch_points(
            found, found["branch_coefficients"].T, found["branch_directions"].T
        ),
        crossings=crossings,
        stops=found["stops"] - 1,
        outcome=OUTCOMES[found["ended"]],
        iterations=found["iterations"],
        error=found["error"],
        _off=found["off"],
        _system=system,
        _given=given,
        _tolerance=tolerance,
        _worst=found["truncation"],
        plan=plan,
    )
