"""Branches of driven motions of the pendulum: folds, branch points, stability."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray, core
from viscovib.analyses.driven import check_size
from viscovib.analyses.torus import (
    FREQUENCIES,
    IntArray,
    Torus,
    bound_of,
    chosen,
    complex_coefficients,
    core_job,
    kept_by_symmetry,
    make_torus,
    moved,
    order_name,
    place_of,
    tail,
    unknowns_of,
)
from viscovib.analyses.torus_plan import torus_plan
from viscovib.common.motion_stability import STABILITY_NOTE, stability_columns
from viscovib.common.parameters import (
    DURATION,
    MAX_DENOMINATOR,
    OPPOSITE,
    STABILITY,
    SUBHARMONIC,
    SYMMETRIC,
    CurveOptions,
    checked,
)
from viscovib.common.periodic_motions import PeriodicMotions
from viscovib.common.plan import Plan, wanted_places
from viscovib.common.results import Panel
from viscovib.common.stability import STILL, warn_of_unknown
from viscovib.common.tables import Table, listed
from viscovib.errors import ConvergenceWarning, InputError, caller
from viscovib.results.curves import (
    MAX_SPECIAL,
    OUTCOMES,
    BranchPoint,
    Crossing,
    Curve,
    branch_notes,
    check_departure,
    largest_panels,
    located_crossings,
    range_of,
)
from viscovib.systems.pendulum import Pendulum

if TYPE_CHECKING:
    import xarray as xr

#: "auto" stops at half of the unknowns that may be asked for, and once so many additions failed to
#: halve the estimate.
_FEWER, _MAX_VAIN = 2.0, 2


@dataclass(frozen=True, eq=False, repr=False)
class DrivenBranch(PeriodicMotions, Curve):
    """A branch of driven motions q = Im sum_k X_k exp(i k.omega t), in the order followed.

    Attributes
    ----------
    varies : str
        "p1", "p2", "p3", "f0", "m01", "m02" or "nu".
    parameter : ndarray, shape (n,)
        Its values.
    axes, base, orders : as in `DrivenResponse`
    coefficients : complex ndarray, shape (n, 3, m)
        X_k of z, phi (rad), psi (rad).
    stable : ndarray of bool, shape (n,), or None
        None: unknown (not asked for; with several base frequencies if no ``duration`` is given).
        False too where multipliers or rates are unknown (too stiff for the Floquet
        solver).
    multipliers : complex ndarray, shape (n, 6), or None
        Floquet multipliers over a period of the base frequency, largest first; NaN where unknown.
    growing : ndarray of int, shape (n,), or None
        How many of them are outside the unit circle; -1: unknown.
    growth : ndarray, shape (n, 6), or None
        With several base frequencies: as in `DrivenResponse`.
    folds : ndarray, shape (n_folds,)
        Values of the parameter where the branch turns back.
    fold_coefficients : complex ndarray, shape (n_folds, 3, m)
    branch_points : tuple of BranchPoint
        Where others branch off: each may be given to `trace_response` as ``leave``.
    crossings : tuple of Crossing
        Changes of stability: "fold", "branch point" (as where a symmetry breaks), "period
        doubling" or "Neimark-Sacker".
    stops : ndarray of int
        Which points lie at the values asked for.
    outcome : str
        As in `Branch`, or "unphysical": the motion reaches z = -1; "closed": back at the first
        point.
    plan : Plan
        What was computed, what was skipped and why.

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
    stable: npt.NDArray[np.bool_] | None
    multipliers: ComplexArray | None
    growing: IntArray | None
    growth: FloatArray | None
    folds: FloatArray
    fold_coefficients: ComplexArray
    branch_points: tuple[BranchPoint, ...]
    crossings: tuple[Crossing, ...]
    stops: npt.NDArray[np.intp]
    outcome: str
    iterations: IntArray
    plan: Plan
    #: The job as the core takes it, units of what varies in the parameter, the relative error
    #: wanted and what orders left out come to where that is largest.
    _job: tuple[Any, ...] = field(repr=False)
    _unit: float = field(repr=False)
    _tolerance: float = field(repr=False)
    _worst: float = field(repr=False)
    dof_names: tuple[str, ...] = Pendulum.dof_names
    dof_units: tuple[str, ...] = ("1", "rad", "rad")

    @property
    def nu(self) -> FloatArray:
        """Base frequencies, shape (n,) if there is one axis."""
        return self.base[:, 0] if len(self.axes) == 1 else self.base

    @property
    def harmonics(self) -> IntArray:
        """Orders, shape (m,) if there is one axis."""
        return self.orders[:, 0] if len(self.axes) == 1 else self.orders

    @property
    def truncation(self) -> FloatArray:
        """Estimated relative error of leaving out higher orders, shape (n,)."""
        return tail(self.coefficients, self.orders)

    @property
    def label(self) -> str:
        """What varies, for the axis of a picture."""
        return {"nu": r"base frequency $\nu$"}.get(self.varies, self.varies)

    @property
    def _orders(self) -> IntArray:
        return self.orders

    def _motions(self) -> tuple[FloatArray, npt.NDArray[Any], ComplexArray]:
        if len(self.axes) > 1:
            raise InputError("these motions are quasi-periodic: they have no period")
        return self.nu, self.harmonics, self.coefficients

    def _lacking(self) -> str:
        if self._worst <= self._tolerance:
            return ""
        return f", too few harmonics (estimated error {self._worst:.1e})"

    def panels(self) -> list[Panel]:
        """Amplitudes along the branch, each of the order of which there is most."""
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
        cancel = np.zeros(1, dtype=np.intc)
        at, size, found = _native.call_interruptibly(
            core.pendulum_peak, cancel, *self._job, self.parameter[i] / self._unit, x,
            self._tolerance, d + 1, j + 1, low / self._unit, high / self._unit, cancel,
        )  # fmt: skip
        return (at * self._unit, size) if found else None

    def to_dataset(self) -> xr.Dataset:
        """Everything as an xarray Dataset over the points."""
        import xarray as xr

        data: dict[str, Any] = {
            "parameter": ("point", self.parameter),
            "base": (("point", "axis"), self.base),
            "orders": (("order", "axis"), self.orders),
            "coefficients": (("point", "dof", "order"), self.coefficients),
        }
        if self.stable is not None:
            data["stable"] = ("point", self.stable)
        if self.multipliers is not None:
            data["growing"] = ("point", self.growing)
            data["multipliers"] = (("point", "multiplier"), self.multipliers)
        if self.growth is not None:
            data["growth"] = (("point", "multiplier"), self.growth)
        return xr.Dataset(
            data,
            coords={"dof": list(self.dof_names), "axis": list(self.axes)},
            attrs={
                "varies": self.varies,
                "outcome": self.outcome,
                "folds": self.folds,
                "branch_points": [point.parameter for point in self.branch_points],
                "plan": str(self.plan),
            },
        )

    def _table(self, coordinates: Sequence[str] | None) -> Table:
        notes = branch_notes(self)
        places = listed(point.parameter for point in self.branch_points)
        notes.insert(1, f"branch points at {self.varies} ={places}")
        table = Table(notes, {self.varies: self.parameter})
        table.columns |= {f"omega_{j + 1}": self.base[:, j] for j in range(len(self.axes))}
        note = "q = Im sum_k X_k exp(i k.omega t) of z, phi (rad), psi (rad)"
        if self.growing is not None:
            note += STABILITY_NOTE
            table.columns |= stability_columns(self.growing, self.multipliers)
        elif self.stable is not None:
            table.columns["stable"] = self.stable
        highest = int(np.abs(self.orders).sum(axis=1).max())
        table.notes.append(
            f"{note}; orders to {highest} leave an estimated relative error of {self._worst:.16e} "
            "at most"
        )
        names = {d: self.dof_names[d] for d in wanted_places(coordinates, self.dof_names)}
        table.add_harmonics(names, map(order_name, self.orders), self.coefficients)
        return table


def _kept(
    pend: Pendulum, torus: Torus, orders: IntArray, varies: str, *, symmetric: bool
) -> IntArray:
    """All orders, or what the symmetry of system and loads leaves of them."""
    if symmetric:
        return np.asfortranarray(kept_by_symmetry(pend, torus, orders, varies))
    return np.ones((len(orders), 3), dtype=np.intc, order="F")


def _bound_left(torus: Torus, leave: BranchPoint) -> int:
    """Highest order of the branch that is left, or one that its unknowns do not match."""
    bound = torus.lowest
    while 3 * (2 * len(torus.lattice(bound)) - 1) < leave._unknowns.size:
        bound += 1
    return bound


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
    pend = system
    varies, value = chosen(
        {"p1": p1, "p2": p2, "p3": p3, "f0": f0, "m01": m01, "m02": m02, "nu": nu}
    )
    if varies is None:
        raise InputError("p1, p2, p3, f0, m01, m02 or nu: one must be given, as (from, to)")
    start, finish = range_of(varies, value)
    if (varies in FREQUENCIES or varies == "nu") and min(start, finish) <= 0:
        raise InputError(f"{varies} = ({start:g}, {finish:g}): must be greater than 0")
    curve = CurveOptions.checked(options)
    wanted, points = curve.tolerance, curve.max_points
    checked((STABILITY, OPPOSITE), locals())
    keeps = symmetric is not None and SYMMETRIC.check(symmetric)
    denominator = MAX_DENOMINATOR.check(max_denominator)
    if varies in FREQUENCIES:
        pend = moved(pend, varies, start)
    torus = make_torus(pend, varies, SUBHARMONIC.check(subharmonic), denominator)
    auto = _native.is_auto(harmonics)
    if leave is not None:
        check_departure(leave)
    wanted_bound: object = torus.usual if auto else harmonics
    if auto and leave is not None:
        auto, wanted_bound = False, _bound_left(torus, leave)
    bound = bound_of(torus, wanted_bound, torus.largest())
    vain, last = 0, np.inf
    span = 1.0 if stability and torus.n_axes == 1 else 0.0
    averaged = None if duration is None else DURATION.check(duration)
    if averaged is not None and torus.n_axes > 1:
        span = averaged
    stops = _native.real_array("at", at).reshape(-1)
    cancel = np.zeros(1, dtype=np.intc)
    while True:
        orders = torus.lattice(bound)
        n = 3 * (2 * len(orders) - 1)
        check_size("max_points", points, n)
        begin, begin_p, along = np.zeros(n), 0.0, np.zeros(n + 1)
        job, unit = core_job(pend, torus, orders, varies)
        kept = _kept(pend, torus, orders, varies, symmetric=keeps)
        if leave is not None:
            begin, along = leave.departure(n, opposite)
            lost = np.where(kept.T == 1, 0.0, np.abs(leave.across)).max()
            if lost > 1e-6 * np.abs(leave.across).max():
                raise InputError(
                    "leave: leads to motions that do not share the symmetry, "
                    "must have symmetric=False"
                )
            begin_p = leave.parameter / unit
        (
            n_points, ended, p, iterations, x, is_stop, multipliers_found, found, rates, n_folds,
            folds, fold_x, n_branch, branch_p, branch_x, across, before, n_crossings, kinds,
            crossed_after, crossed_at, crossed_x,
        ) = _native.call_interruptibly(
            core.pendulum_branch, cancel, *job[:2], kept, *job[2:],
            curve.packed(start / unit, finish / unit, stops / unit), points, span,
            int(leave is not None), begin, begin_p, along, MAX_SPECIAL, cancel,
        )  # fmt: skip
        if not n_points:
            break
        # call_interruptibly leaves it set.
        cancel[0] = 0
        more = torus.lattice(bound + torus.shells)
        judged, _ = core_job(pend, torus, more, varies)
        worst, next_bound = _native.call_interruptibly(
            core.pendulum_truncation, cancel, *judged[:2],
            _kept(pend, torus, more, varies, symmetric=keeps), *judged[2:], p[:n_points],
            np.asfortranarray(x[:, :n_points]), wanted, bound, torus.shells,
            torus.largest(_FEWER) if auto else bound, cancel,
        )  # fmt: skip
        cancel[0] = 0
        vain += worst > 0.5 * last
        if next_bound <= bound or vain >= _MAX_VAIN:
            break
        bound, last = next_bound, worst
    if n_points and worst > wanted:
        warnings.warn(
            f"{bound} orders leave an estimated relative error of {worst:.1e}, more than the "
            f"tolerance {wanted:.1e}",
            ConvergenceWarning,
            stacklevel=caller(),
        )
    if not n_points:
        raise InputError(
            f"{varies}: no solution was found at its beginning {start:g}: begin elsewhere"
        )
    multipliers, stable, growing, growth = None, None, None, None
    if span and torus.n_axes > 1:
        growth = rates[:, :n_points].T.copy()
        stable = growth[:, 0] < -STILL
    elif span:
        multipliers, growing = multipliers_found[:, :n_points].T.copy(), found[:n_points].copy()
        stable = growing == 0
        warn_of_unknown(growing < 0)
    crossings = located_crossings(
        (n_crossings, kinds, crossed_after, crossed_at * unit),
        complex_coefficients(crossed_x[:, :n_crossings]),
    )
    base = np.tile(torus.base, (n_points, 1))
    if job[5] == 1:
        base[:, job[6] - 1] = p[:n_points]  # type: ignore[operator]
    points_off = complex_coefficients(branch_x[:, :n_branch])
    directions = complex_coefficients(across[:-1, :n_branch])
    return DrivenBranch(
        varies=varies,
        parameter=p[:n_points] * unit,
        axes=torus.names,
        base=base,
        orders=orders,
        coefficients=complex_coefficients(x[:, :n_points]),
        stable=stable,
        multipliers=multipliers,
        growing=growing,
        growth=growth,
        folds=folds[:n_folds] * unit,
        fold_coefficients=complex_coefficients(fold_x[:, :n_folds]),
        branch_points=tuple(
            BranchPoint(
                float(branch_p[i] * unit),
                points_off[i],
                int(before[i]) - 1,
                directions[i],
                branch_x[:, i].copy(),
                across[:, i].copy(),
            )
            for i in range(n_branch)
        ),
        crossings=crossings,
        stops=np.flatnonzero(is_stop[:n_points]),
        outcome=OUTCOMES[ended],
        iterations=iterations[:n_points].copy(),
        _job=(*job[:2], kept, *job[2:]),
        _unit=unit,
        _tolerance=wanted,
        _worst=worst,
        plan=torus_plan(
            f"computes: the branch from {varies} = {start:g} to {finish:g}",
            pend, torus, kept, varies,
            "rates" if torus.n_axes > 1 and span else "multipliers" if span
            else "not asked for" if torus.n_axes == 1 or not stability
            else "of quasi-periodic motions, only over a duration",
        ),
    )  # fmt: skip
