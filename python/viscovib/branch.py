"""Branches of periodic solutions: continuation through folds, with stability."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray, core
from viscovib._plan import Plan, wanted_places
from viscovib.curves import (
    MAX_SPECIAL,
    OUTCOMES,
    BranchPoint,
    Crossing,
    Curve,
    branch_notes,
    check_departure,
    located_crossings,
    range_of,
)
from viscovib.errors import ConvergenceWarning, InputError
from viscovib.load import LoadLike
from viscovib.motion_stability import STABILITY_NOTE, Stability, codes_of, stability_columns
from viscovib.oscillators import Oscillator, check_oscillator
from viscovib.parameters import MOST_CHOSEN, OPPOSITE, STABILITY, SYMMETRIC, CurveOptions
from viscovib.periodic_motions import PeriodicMotions
from viscovib.response import _prepare
from viscovib.tables import Table, listed_units
from viscovib.varying import varied

if TYPE_CHECKING:
    import xarray as xr

#: Numbers that all points together may hold.
_MAX_NUMBERS = 4e8
#: What varies, in the order of the core.
_KINDS = {"nu": 1, "load_factor": 2}


@dataclass(frozen=True, eq=False, repr=False)
class Branch(PeriodicMotions, Curve):
    """A branch of periodic solutions u = Im sum_k X_k exp(i k nu t), in the order followed.

    Attributes
    ----------
    nu : ndarray, shape (n,)
        Circular frequencies (rad/s).
    load_factor : ndarray, shape (n,)
        Factor of the load given.
    harmonics : ndarray of int, shape (m,)
        Orders k kept.
    coefficients : complex ndarray, shape (n, n_dof, m)
        X_k.
    stable : ndarray of bool, shape (n,), or None
        None: unknown (time scales too far apart) or not asked for. If it is unknown of some motions
        only, the array holds objects, True, False and None.
    growing : ndarray of int, shape (n,), or None
        How many disturbances grow; -1: unknown.
    multipliers : complex ndarray, shape (n, 2 n_dof), or None
        Floquet multipliers, largest first, NaN where unknown; with memory exp(2 pi exponents/nu).
    exponents : complex ndarray, shape (n, m), or None
        Exponents lambda (1/s) of disturbances exp(lambda t) times a periodic function, largest real
        part first, modulo i nu (of motions symmetric about half a period: 2 i nu; there Im lambda =
        nu at a breaking of the symmetry). With memory those that grow are complete, or all of a
        motion's are NaN; of those that decay some may lack; NaN behind the last.
    slowest : ndarray of bool, shape (n,), or None
        True: no disturbance decays more slowly than the first multiplier says. False: some may. The
        search may have failed, or memory itself fades more slowly: right of the rate at which it
        does, exponents are counted; further left no multiplier says how disturbances decay. Memory
        of a Rabotnov kernel fades like a power of time, more slowly than any exponential.
    folds : ndarray, shape (n_folds,)
        Where the branch turns back: values of what varies (nu, or the load factor).
    fold_coefficients : complex ndarray, shape (n_folds, n_dof, m)
    branch_points : tuple of BranchPoint
        Where others branch off: each may be given to `trace_response` as ``leave``.
    crossings : tuple of Crossing
        Changes of stability, located to 1e-8 or better of what varies.
    stops : ndarray of int
        Which points lie at the values asked for.
    outcome : str
        "completed"; "returned": back at the beginning, another branch leads on; "step limit":
        max_points reached; "stuck": no smaller step helps; "overflow"; "closed": back at the first
        point; "unphysical": at the end of the values that make a system.
    error : ndarray, shape (n,)
        Estimated error of each point as a solution of its equations, relative to its size: what the
        last correction and rounding leave. At very light damping that is rounding divided by the
        damping, and may exceed ``tolerance``.
    varies : str
        "nu", "load_factor" or a parameter of the system.
    parameter : ndarray, shape (n,)
        Its values.
    highest : ndarray of int, shape (n,)
        Highest order kept at each point.
    truncation : ndarray, shape (n,)
        Estimated relative change of the motion if all orders were kept.
    plan : Plan
        What was computed, what was skipped and why.
    """

    nu: FloatArray
    load_factor: FloatArray
    harmonics: npt.NDArray[np.int32]
    coefficients: ComplexArray
    stable: npt.NDArray[Any] | None
    growing: npt.NDArray[np.int32] | None
    multipliers: ComplexArray | None
    exponents: ComplexArray | None
    slowest: npt.NDArray[np.bool_] | None
    folds: FloatArray
    fold_coefficients: ComplexArray
    branch_points: tuple[BranchPoint, ...]
    crossings: tuple[Crossing, ...]
    stops: npt.NDArray[np.intp]
    outcome: str
    iterations: npt.NDArray[np.int32]
    error: FloatArray
    varies: str
    parameter: FloatArray
    highest: npt.NDArray[np.int32]
    truncation: FloatArray
    dof_names: tuple[str, ...]
    dof_units: tuple[str, ...]
    plan: Plan
    #: System, load and what varies as the core takes them, and the relative error wanted.
    _job: tuple[Any, ...] = field(repr=False)
    _tolerance: float = field(repr=False)

    @property
    def label(self) -> str:
        """What varies, for the axis of a picture."""
        if self.varies == "nu":
            return r"circular frequency of the load $\nu$ (rad/s)"
        name = "factor of the load" if self.varies == "load_factor" else self.varies
        return f"{name}, at frequency {self.nu[0]:g} rad/s"

    @property
    def _orders(self) -> npt.NDArray[np.int32]:
        return self.harmonics

    def _lacking(self) -> str:
        short = int((self.truncation > self._tolerance).sum())
        return f", {short} with too few harmonics" if short else ""

    def _motions(self) -> tuple[FloatArray, npt.NDArray[Any], ComplexArray]:
        return self.nu, self.harmonics, self.coefficients

    def _place(self, dof: str, harmonic: int | tuple[int, ...]) -> tuple[int, int]:
        d = self.dof_names.index(_native.choice("dof", dof, self.dof_names))
        where = np.flatnonzero(self.harmonics == harmonic) if np.isscalar(harmonic) else np.empty(0)
        if not where.size:
            kept = ", ".join(map(str, self.harmonics))
            raise InputError(
                f"harmonic = {_native.shown(harmonic)}: must be one of those kept ({kept})"
            )
        return d, int(where[0])

    def _summit(
        self, i: int, d: int, j: int, low: float, high: float
    ) -> tuple[float, float] | None:
        kept = np.flatnonzero(self.harmonics <= self.highest[i])
        if j >= kept.size:
            return None
        cancel = np.zeros(1, dtype=np.intc)
        at, size, found = _native.call_interruptibly(
            core.mount_peak, cancel, *self._job, self.harmonics[kept], 1, self._tolerance,
            self.parameter[i : i + 1], np.asfortranarray(self.coefficients[i : i + 1][..., kept].T),
            d + 1, j + 1, low, high, 1, cancel,
        )  # fmt: skip
        return (at, size) if found else None

    def to_dataset(self) -> xr.Dataset:
        """Everything as an xarray Dataset over the points."""
        import xarray as xr

        data: dict[str, Any] = {
            "nu": ("point", self.nu, {"units": "rad/s"}),
            "load_factor": ("point", self.load_factor),
            "coefficients": (("point", "dof", "harmonic"), self.coefficients),
            "highest": ("point", self.highest),
            "truncation": ("point", self.truncation),
            "error": ("point", self.error),
        }
        if self.stable is not None and self.multipliers is not None:
            whole = self.stable.dtype == bool
            data["stable"] = ("point", self.stable if whole else codes_of(self.stable))
            data["growing"] = ("point", self.growing)
            data["exponents"] = (("point", "multiplier"), self.exponents)
            data["multipliers"] = (("point", "multiplier"), self.multipliers)
            data["slowest"] = ("point", self.slowest)
        return xr.Dataset(
            data,
            coords={"dof": list(self.dof_names), "harmonic": self.harmonics},
            attrs={"outcome": self.outcome, "folds": self.folds, "plan": str(self.plan)},
        )

    def _table(self, coordinates: Sequence[str] | None) -> Table:
        names = {d: self.dof_names[d] for d in wanted_places(coordinates, self.dof_names)}
        table = Table(branch_notes(self), {self.varies: self.parameter})
        note = "nu: circular frequency of the load (rad/s); u = Im sum_k X_k exp(i k nu t)"
        if self.growing is not None:
            note += STABILITY_NOTE
            table.columns |= stability_columns(self.growing, self.multipliers)
        units = listed_units(list(names.values()), [self.dof_units[d] for d in names])
        table.notes.append(
            f"{note}; highest: order kept; truncation: estimated relative error of leaving out "
            f"higher orders; error: of the last correction and rounding; {units}"
        )
        table.columns |= {"highest": self.highest, "truncation": self.truncation}
        table.columns["error"] = self.error
        table.add_harmonics(names, map(str, self.harmonics), self.coefficients)
        return table


def trace_mount(
    system: Oscillator,
    nu_range: tuple[float, float] | None,
    *,
    load: LoadLike | None,
    base: LoadLike | None,
    nu: float | None,
    load_range: tuple[float, float] | None,
    vary: str | None,
    vary_range: tuple[float, float] | None,
    at: npt.ArrayLike,
    leave: BranchPoint | None,
    opposite: bool,
    symmetric: bool | None,
    harmonics: int | str,
    tolerance: float,
    max_points: int,
    max_step: float,
    stability: bool,
) -> Branch:
    """`trace_response` of a mount or a polynomial system."""
    ranges = {"nu_range": nu_range, "load_range": load_range, "vary_range": vary_range}
    given = [name for name, ends in ranges.items() if ends is not None]
    if len(given) != 1:
        raise InputError("nu_range, load_range or vary_range: must be given, and only one of them")
    if (given[0] == "nu_range") != (nu is None):
        raise InputError("nu: must be given with load_range or vary_range, and only then")
    if (given[0] == "vary_range") != (vary is not None):
        raise InputError("vary: must be given with vary_range, and only then")
    start, finish = range_of(given[0], ranges[given[0]])
    varies = {"nu_range": "nu", "load_range": "load_factor"}.get(given[0], "")
    check_oscillator(system, base)
    flat, direction, first = system._flat, np.zeros(system._flat.size), None
    if vary is not None:
        numbers = varied(system, vary, start, finish)
        varies, flat, direction = numbers
        first = numbers.at(start)
    if varies == "nu" and min(start, finish) <= 0:
        raise InputError(f"nu_range = ({start:g}, {finish:g}): must be greater than 0")
    fixed = start if nu is None else _native.number("nu", nu)
    stops = _native.real_array("at", at).reshape(-1)
    judged_too = STABILITY.check(stability)
    keeps = symmetric is None or SYMMETRIC.check(symmetric)
    curve = CurveOptions.checked(tolerance, max_points, max_step)
    job, _, options, planned = _prepare(
        system, [fixed], load, base, "newton", harmonics, curve.tolerance, 100, 1.0, keep_idle=True,
        flat=first, may_choose=True,
    )  # fmt: skip
    chosen = _native.is_auto(harmonics)
    if planned.method != "newton":
        raise InputError(
            "system: nothing is nonlinear, its response is a single curve: see forced_response"
        )
    orders = planned.orders
    if not keeps:
        orders = np.arange((planned.orders[-1] if chosen else options[1]) + 1, dtype=np.int32)
    if chosen:
        orders = orders[orders <= max(MOST_CHOSEN, *job[-2])]
    n_dof, m = len(system.dof_names), orders.size
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
    cancel = np.zeros(1, dtype=np.intc)
    (
        n, ended, n_used, p, iterations, error, kept, truncation, coefficients, is_stop, n_folds,
        folds, fold_coefficients, n_branch, branch_p, branch_x, across, branch_before, judged,
        growing, multipliers, exponents, n_crossings, kinds, before, where, crossing_coefficients,
    ) = _native.call_interruptibly(
        core.mount_branch, cancel, flat, *job[1:], _KINDS.get(varies, 3), direction, fixed, start,
        finish, options[1], int(keeps), curve.tolerance, points, curve.max_step, stops,
        int(leave is not None), begin, begin_p, along, points if judged_too else 0, m,
        min(points, MAX_SPECIAL), cancel,
    )  # fmt: skip
    if not n:
        raise InputError(
            f"{given[0]}: no solution was found at its beginning {start:g}: begin elsewhere"
        )
    found: Stability | None = None
    if judged_too:
        found = Stability.of(judged[:n], multipliers[:, :n], exponents[:, :n])
        if (judged[:n] < 0).all() and not system._active_kernels:
            found = None

    def absolute(relative: ComplexArray, factors: FloatArray) -> ComplexArray:
        if varies != "load_factor":
            factors = np.ones(factors.size)
        return _absolute(relative.T, system._base_direction, job, orders, factors)

    orders = orders[:n_used]
    crossings = located_crossings(
        (n_crossings, kinds, before, where),
        absolute(crossing_coefficients[:n_used, :, :n_crossings], where[:n_crossings]),
    )
    values = p[:n].copy()
    same = np.ones(n)
    few = truncation[:n] > tolerance
    if few.any():
        warnings.warn(
            f"at {few.sum()} of {n} points harmonics up to {orders[-1]} do not reach the tolerance "
            f"{tolerance:.1e}; worst at {varies} = {p[truncation[:n].argmax()]:.6g}, with an "
            f"estimated relative error of {truncation[:n].max():.1e}",
            ConvergenceWarning,
            stacklevel=3,
        )
    if error[:n].max() > tolerance:
        warnings.warn(
            f"at {(error[:n] > tolerance).sum()} of {n} points rounding leaves more than the "
            f"tolerance {tolerance:.1e}; worst at {varies} = {p[error[:n].argmax()]:.6g}, with an "
            f"estimated relative error of {error[:n].max():.1e}",
            ConvergenceWarning,
            stacklevel=3,
        )
    points_off = absolute(_complex(branch_x[:, :n_branch], n_dof, m)[:n_used], branch_p[:n_branch])
    directions = _complex(across[:-1, :n_branch], n_dof, m)[:n_used].T
    return Branch(
        nu=values if varies == "nu" else fixed * same,
        load_factor=values if varies == "load_factor" else same,
        harmonics=orders,
        coefficients=absolute(coefficients[:n_used, :, :n], values),
        stable=found.stable if found else None,
        growing=growing[:n].copy() if found else None,
        multipliers=found.multipliers if found else None,
        exponents=found.exponents if found else None,
        slowest=found.slowest if found else None,
        folds=folds[:n_folds].copy(),
        fold_coefficients=absolute(fold_coefficients[:n_used, :, :n_folds], folds[:n_folds]),
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
        dof_names=system.dof_names,
        dof_units=system.dof_units,
        plan=_plan(varies, start, finish, 0 if chosen else m, planned, judged_too),
        _job=(flat, *job[1:], _KINDS.get(varies, 3), direction, fixed),
        _tolerance=curve.tolerance,
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
