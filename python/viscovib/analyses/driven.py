"""Periodic and quasi-periodic motions of the pendulum under its loads, by harmonic balance."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.analyses.steady import OUTCOMES
from viscovib.analyses.torus import (
    FREQUENCIES,
    IntArray,
    axes_of,
    chosen,
    loads_of,
    order_name,
    place_of,
    torus_plan,
)
from viscovib.common.column_notes import NOTES
from viscovib.common.counts import things
from viscovib.common.motion_stability import three_valued, whole_or_codes
from viscovib.common.parameters import DURATION, STABILITY, TOLERANCE
from viscovib.common.plan import Plan, wanted_places
from viscovib.common.results import Dataset, Result, as_dataset, span
from viscovib.common.stability import stability_by_rates, warn_of_unknown
from viscovib.common.tables import Table
from viscovib.errors import ConvergenceWarning, InputError, caller
from viscovib.systems.pendulum import Pendulum

_DOFS = Pendulum.dof_names
#: Default averaging time of rates.
_AVERAGED = 3000.0


@dataclass(frozen=True, eq=False, repr=False)
class DrivenResponse(Result):
    """Steady motions q = Im sum_k X_k exp(i k.omega t) of the pendulum, one per row.

    They are periodic with a single base frequency omega, otherwise quasi-periodic. Half of the
    lattice of orders k is stored, X_(-k) = -conj X_k.

    Attributes
    ----------
    varies : str or None
        Parameter that varies from row to row: "p1", "p2", "p3", "f0", "m01", "m02", "nu"; None: a
        single row.
    parameter : ndarray, shape (n,)
        Its values (the base frequency if nothing varies).
    axes : tuple of str
        Names of the base frequencies; "nu" for a common base frequency of several loads.
    base : ndarray, shape (n, n_axes)
        Base circular frequencies.
    orders : ndarray of int, shape (m, n_axes)
        k, the mean first.
    coefficients : complex ndarray, shape (n, 3, m)
        X_k of z, phi (rad), psi (rad), the mean of a coordinate being Im X_0; NaN without a
        solution.
    outcome : ndarray of str, shape (n,)
        "converged", "stalled", "diverged" (also: outside the physical range z > -1), "singular" or
        "overflow".
    iterations : ndarray of int, shape (n,)
    highest : ndarray of int, shape (n,)
        Highest harmonic, with several base frequencies highest |k1| + |k2| + ... ; 0 without a
        solution.
    truncation : ndarray, shape (n,)
        Estimated relative error by neglected harmonics: the change by the next two shells of
        orders, relative to the largest coefficient; NaN without a solution.
    error : ndarray, shape (n,)
        Estimated relative error of each motion as a solution of the equations with the harmonics
        kept, by the last correction and rounding, relative to the largest coefficient. NaN without
        a solution, or with singular derivatives.
    multipliers : complex ndarray, shape (n, 6), or None
        Floquet multipliers over a period of the base frequency, largest first; None with several
        base frequencies, or if not requested. NaN if unknown.
    growth : ndarray, shape (n, 6), or None
        Growth rates of small perturbations (Lyapunov exponents), largest first. NaN if unknown.
    growth_error : ndarray, shape (n, 6), or None
        Estimated errors of the rates, which are means over a ``duration``; None for periodic
        motions.
    stable : ndarray of bool, shape (n,), or None
        True if all perturbations decay. If there is no solution, if multipliers or rates are
        unknown, or if a rate is smaller than its error, the array contains objects: True, False and
        None.
    plan : Plan
        What was computed, and what was skipped and why.

    Examples
    --------
    >>> import viscovib as vv
    >>> body = vv.Pendulum(
    ...     e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01, f0=0.002, p1=1.02
    ... )
    >>> rows = vv.forced_response(body, p1=[1.0, 1.02], harmonics=5)
    >>> size = rows.amplitude("z")
    """

    varies: str | None
    parameter: FloatArray
    axes: tuple[str, ...]
    base: FloatArray
    orders: IntArray
    coefficients: ComplexArray
    outcome: npt.NDArray[np.str_]
    iterations: IntArray
    highest: IntArray
    truncation: FloatArray
    error: FloatArray
    multipliers: ComplexArray | None
    growth: FloatArray | None
    growth_error: FloatArray | None
    stable: npt.NDArray[Any] | None
    plan: Plan
    dof_names: tuple[str, ...] = _DOFS
    dof_units: tuple[str, ...] = ("1", "rad", "rad")

    kind = "response"
    _form = "response"

    @property
    def _along(self) -> tuple[FloatArray, str, bool]:
        """The varied parameter: values, label, and True if it is a circular frequency (rad/s)."""
        return self.parameter, self.varies or self.axes[0], False

    @property
    def complete(self) -> bool:  # type: ignore[override]
        """True if all motions are solved."""
        return bool(self.converged.all())

    def _headline(self) -> str:
        return f"{self.converged.sum()} of {things(self.parameter.size, 'motion')} solved"

    def _scope(self) -> list[str]:
        worst, left = (np.nanmax(x, initial=0.0) for x in (self.truncation, self.error))
        known = "" if self.stable is None else f", {np.sum(self.stable == True)} stable"  # noqa: E712
        return [
            f"{self.varies or 'nu'}: {span(self.parameter)}; base frequencies: "
            f"{', '.join(self.axes)}{known}",
            f"harmonics up to {self.highest.max(initial=0)}, estimated error by neglected "
            f"harmonics {worst:.1e}, by the last correction and rounding {left:.1e}",
        ]

    @property
    def nu(self) -> FloatArray:
        """Base frequencies, shape (n,) for a single axis."""
        return self.base[:, 0] if len(self.axes) == 1 else self.base

    @property
    def harmonics(self) -> IntArray:
        """Harmonics, shape (m,) for a single axis."""
        return self.orders[:, 0] if len(self.axes) == 1 else self.orders

    @property
    def converged(self) -> npt.NDArray[np.bool_]:
        """True where a solution was found, shape (n,)."""
        return np.asarray(self.outcome == "converged")

    def frequencies(self, i: int = 0) -> FloatArray:
        """Return k.omega of all orders in row i, shape (m,); some may be negative."""
        return np.asarray(self.orders @ self.base[self._row(i)])

    def coefficient(self, dof: str, harmonic: int | tuple[int, ...] = 1) -> ComplexArray:
        """Return X_k of one coordinate, shape (n,); with several axes ``harmonic`` is a tuple."""
        d = _DOFS.index(_native.choice("dof", dof, _DOFS))
        j = place_of(self.orders, harmonic)
        kept = self.coefficients[:, d, j]
        same = bool((self.orders[j] == np.atleast_1d(harmonic)).all())
        return kept if same else -kept.conj()

    def amplitude(self, dof: str, harmonic: int | tuple[int, ...] = 1) -> FloatArray:
        """Return |X_k| of one coordinate, shape (n,)."""
        return np.abs(self.coefficient(dof, harmonic))

    def state(self, i: int, t: npt.ArrayLike) -> FloatArray:
        """Return states (z, z', phi, phi', psi, psi') of row i at times t, shape (..., 6)."""
        row = self._row(i)
        times = _native.real_array("t", t)
        omega = self.frequencies(row)
        with np.errstate(over="ignore", invalid="ignore"):
            phases = np.multiply.outer(times, omega)
        _native.check_range("t", times, phases, "the phase of the motion")
        waves = np.exp(1j * phases)
        result = np.empty((*times.shape, 6))
        result[..., ::2] = (waves @ self.coefficients[row].T).imag
        result[..., 1::2] = (waves @ (1j * omega * self.coefficients[row]).T).imag
        return result

    def waveform(self, i: int, n: int = 256) -> tuple[FloatArray, FloatArray]:
        """Return one period of row i: times, shape (n,), and coordinates, shape (n, 3)."""
        if len(self.axes) > 1:
            raise InputError("waveform: a quasi-periodic motion has no period, see `state`")
        count = _native.integer("n", n, 1, 10_000_000)
        t = 2 * np.pi / self.base[self._row(i), 0] * np.arange(count) / count
        return t, self.state(i, t)[:, ::2]

    def _row(self, i: int) -> int:
        n = self.parameter.size
        return _native.integer("i", i, -n, n - 1) % n

    def to_dataset(self) -> Dataset:
        """Return all data as an xarray Dataset over the rows."""
        data: dict[str, Any] = {
            "parameter": ("point", self.parameter),
            "base": (("point", "axis"), self.base),
            "orders": (("order", "axis"), self.orders),
            "coefficients": (("point", "dof", "order"), self.coefficients),
            "outcome": ("point", self.outcome),
            "iterations": ("point", self.iterations),
            "highest": ("point", self.highest),
            "truncation": ("point", self.truncation),
            "error": ("point", self.error),
        }
        if self.multipliers is not None:
            data["multipliers"] = (("point", "multiplier"), self.multipliers)
        if self.growth is not None:
            data["growth"] = (("point", "multiplier"), self.growth)
        if self.stable is not None:
            data["stable"] = ("point", whole_or_codes(self.stable))
        if self.growth_error is not None:
            data["growth_error"] = (("point", "multiplier"), self.growth_error)
        return as_dataset(
            data,
            coords={
                "dof": list(_DOFS),
                "unit": ("dof", list(self.dof_units)),
                "axis": list(self.axes),
            },
            attrs={"varies": self.varies or "", "plan": str(self.plan)},
        )

    def _table(self, coordinates: Sequence[str] | None) -> Table:
        varies = self.varies or self.axes[0]
        table = Table(
            [f"{varies} varies; {NOTES['driven']}; {NOTES['unsolved']}"],
            {varies: self.parameter},
        )
        table.columns |= {f"omega_{j + 1}": self.base[:, j] for j in range(len(self.axes))}
        table.columns |= {"outcome": self.outcome, "iterations": self.iterations}
        table.columns |= {"highest": self.highest, "truncation": self.truncation}
        table.columns["error"] = self.error
        if self.stable is not None:
            table.columns["stable"] = whole_or_codes(self.stable)
        names = {d: _DOFS[d] for d in wanted_places(coordinates, _DOFS)}
        table.add_harmonics(names, map(order_name, self.orders), self.coefficients)
        return table


def pendulum_response(
    system: Pendulum,
    *,
    p1: npt.ArrayLike | None,
    p2: npt.ArrayLike | None,
    p3: npt.ArrayLike | None,
    f0: npt.ArrayLike | None,
    m01: npt.ArrayLike | None,
    m02: npt.ArrayLike | None,
    nu: npt.ArrayLike | None,
    harmonics: int | str,
    tolerance: float,
    stability: bool,
    duration: float | None,
    subharmonic: int,
    max_denominator: int,
) -> DrivenResponse:
    """`forced_response` of a pendulum."""
    varies, values = chosen(
        {"p1": p1, "p2": p2, "p3": p3, "f0": f0, "m01": m01, "m02": m02, "nu": nu}
    )
    wanted = TOLERANCE.check(tolerance)
    if not STABILITY.check(stability) and duration is not None:
        raise InputError(f"duration = {_native.shown(duration)}: needs stability=True")
    averaged = DURATION.check(_AVERAGED if duration is None else duration)
    span = averaged if stability else 0.0
    given = loads_of(varies, harmonics, True, subharmonic, max_denominator)
    rows = _native.real_array(varies or "nu", 0.0 if varies is None else values)
    if rows.ndim > 1 or not rows.size:
        raise InputError(f"{varies}: must have 0 or 1 dimension(s) and not be empty, got shape "
                         f"{rows.shape}")  # fmt: skip
    rows = rows.reshape(-1)
    if (varies in FREQUENCIES or varies == "nu") and rows.min() <= 0:
        raise InputError(f"{varies} = {rows.min():g}: must be greater than 0")
    result = _solve(system, varies, rows, given, wanted, span)
    if given["choose"] and result.truncation[result.converged].max(initial=0.0) > wanted:
        worst = int(np.nanargmax(result.truncation))
        warnings.warn(
            f"{result.highest[worst]} harmonics: the estimated relative error is "
            f"{result.truncation[worst]:.1e}, more than the tolerance {wanted:.1e}",
            ConvergenceWarning,
            stacklevel=caller(),
        )
    unsolved = ~result.converged
    if unsolved.any():
        warnings.warn(
            f"{unsolved.sum()} of {things(unsolved.size, 'motion')} not found, at "
            f"{varies or result.axes[0]} = {result.parameter[unsolved].min():.6g} to "
            f"{result.parameter[unsolved].max():.6g}; "
            "their values are NaN",
            ConvergenceWarning,
            stacklevel=caller(),
        )
    return result


def _solve(
    pend: Pendulum,
    varies: str | None,
    rows: FloatArray,
    given: dict[str, Any],
    tolerance: float,
    duration: float,
) -> DrivenResponse:
    solved = _native.apart(
        lambda: _native.run(
            "drive solve", pend._handle, p=rows, tolerance=tolerance, duration=float(duration),
            **given,
        )
    )  # fmt: skip
    codes, axes, base = solved["outcomes"], axes_of(solved), solved["base"].T
    orders = np.ascontiguousarray(solved["orders"].T, dtype=np.int32)
    found = codes == 0
    coefficients = solved["coefficients"].T[:, :, : len(orders)]
    coefficients[~found] = np.nan
    truncation, error = (np.where(found, solved[name], np.nan) for name in ("truncation", "error"))
    multipliers, stable, growth, growth_error = None, None, None, None
    if "multipliers" in solved:
        growing = solved["growing"]
        multipliers, stable = solved["multipliers"].T, three_valued(growing == 0, growing < 0)
        multipliers[~found] = np.nan
        warn_of_unknown(found & (growing < 0))
        growth = np.log(np.abs(multipliers)) * base / (2 * np.pi)
    elif "rates" in solved:
        growth = np.where(found, solved["rates"], np.nan).T
        growth_error = np.where(found, solved["rates_off"], np.nan).T
        stable = stability_by_rates(growth, growth_error, found)
    return DrivenResponse(
        varies=varies,
        parameter=rows if varies else base[:, 0],
        axes=axes,
        base=base,
        orders=orders,
        coefficients=coefficients,
        outcome=OUTCOMES[codes],
        iterations=solved["iterations"],
        highest=solved["highest"],
        truncation=truncation,
        error=error,
        multipliers=multipliers,
        stable=stable,
        growth=growth,
        growth_error=growth_error,
        plan=torus_plan(
            f"computes: steady motions at {things(rows.size, 'value')} of {varies or axes[0]}"
            + (", each with as many harmonics as it needs" if solved["grows"] else ""),
            pend, solved, varies,
            "not requested" if not duration else "multipliers" if len(axes) == 1 else "rates",
        ),
    )  # fmt: skip
