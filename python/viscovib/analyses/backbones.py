"""Backbone curves: free periodic motions of systems without damping."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.common.column_notes import NOTES
from viscovib.common.counts import things
from viscovib.common.motion_stability import stability_columns
from viscovib.common.parameters import MAX_HARMONICS, CurveOptions, Interval
from viscovib.common.periodic_motions import PeriodicMotions
from viscovib.common.plan import Plan, wanted_places
from viscovib.common.results import Dataset, Number, Panel, Result, as_dataset, named, span
from viscovib.common.tables import Table, listed, listed_units
from viscovib.common.values import Value
from viscovib.errors import ConvergenceWarning, InputError, caller
from viscovib.results.curves import (
    OUTCOMES,
    allowed_nearby,
    fold_notes,
    largest_panels,
    rounding_text,
    warn_of_rounding,
)
from viscovib.results.structure_view import View
from viscovib.systems.law_ends import edges_text
from viscovib.systems.oscillators import check_steady, refuse_turning


@dataclass(frozen=True, eq=False, repr=False)
class BackbonePoint(Value):
    """A point at which a second branch of free motions crosses.

    It contains the parameter value, the frequency, X_k and the index of the point before.
    ``across`` is the direction of the second branch in X_k.

    Examples
    --------
    >>> import viscovib as vv
    >>> body = vv.Pendulum(e=0.1, w2=0.53, w3=0.9, alpha=0.5)
    >>> free = vv.backbone(body, 0, (0.01, 0.2), subharmonic=2)
    >>> points = free.branch_points  # each may be given as leave=
    """

    parameter: float
    nu: float
    coefficients: ComplexArray
    before: int
    across: ComplexArray
    _direction: FloatArray


@dataclass(frozen=True, eq=False, repr=False)
class Backbone(PeriodicMotions, Result):
    """A nonlinear normal mode u = Im sum_k X_k exp(i k nu t) = sum_k a_k cos(k nu t).

    Every motion starts with zero velocity, u'(0) = 0, so X_k = i a_k.

    Attributes
    ----------
    nu : ndarray, shape (n,)
        Circular frequencies (rad/s), in the order followed.
    harmonics : ndarray of int, shape (m,)
        Harmonics k that are kept.
    coefficients : complex ndarray, shape (n, n_dof, m)
        X_k.
    truncation : ndarray, shape (n,)
        Estimated relative error of the motion or of its frequency by neglected harmonics, whichever
        is larger; at most 1, which also means unknown.
    error : ndarray, shape (n,)
        Estimated relative error of the motion at its parameter value, or of its frequency,
        whichever is larger, by the last correction and rounding. It may exceed ``tolerance`` with
        springs of very different stiffness, or near a fold, where the motion changes fast with the
        parameter.
    mode : int
        Index of the linear mode at its start, from 0.
    outcome : str
        "completed"; "step limit": max_points reached; "fold limit": max_folds reached; "stuck": no
        smaller step size helps; "returned": back at the initial size, as with an internal resonance
        where the motion becomes that of a higher mode; "closed": back at the first point;
        "overflow"; "unphysical": no oscillation exists beyond, or a pendulum reaches z = -1;
        "unresolved": the harmonics no longer represent the motion, as near a homoclinic orbit,
        whose period is infinite.
    plan : Plan
        What was computed, and what was skipped and why.
    varies : str
        "amplitude" or "energy".
    energy : ndarray, shape (n,), or None
        For a pendulum: `Pendulum.energy`.
    folds : ndarray, shape (n_folds,)
        Parameter values at which the curve turns back.
    fold_errors : ndarray, shape (n_folds,)
        Estimated error of each fold by neglected harmonics and rounding, in the unit of the
        parameter.
    branch_points : tuple of BackbonePoint
        For a pendulum: points at which a second branch crosses. Pass one of them to `backbone` as
        ``leave``.
    multipliers : complex ndarray, shape (n, 6), or None
        For a pendulum: Floquet multipliers over 2 pi/nu, largest first. Two multipliers are 1 for
        every motion, with an error of the square root of the rounding error.
    stable : ndarray of bool, shape (n,), or None
        True if no perturbation grows exponentially: no multiplier above 1 + 1e-6.
    growing : ndarray of int, shape (n,), or None
        Number of multipliers above this value; -1: unknown.

    Examples
    --------
    >>> import viscovib as vv
    >>> duffing = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="0.5*x^3")
    >>> free = vv.backbone(duffing, 0, (0.01, 2))
    >>> bool(free.nu[-1] > free.nu[0])
    True
    """

    nu: FloatArray
    harmonics: npt.NDArray[np.int32]
    coefficients: ComplexArray
    truncation: FloatArray
    error: FloatArray
    mode: int
    outcome: str
    dof_names: tuple[str, ...]
    dof_units: tuple[str, ...]
    plan: Plan
    varies: str = "amplitude"
    energy: FloatArray | None = None
    folds: FloatArray = field(default_factory=lambda: np.empty(0))
    fold_errors: FloatArray = field(default_factory=lambda: np.empty(0))
    branch_points: tuple[BackbonePoint, ...] = ()
    multipliers: ComplexArray | None = None
    stable: npt.NDArray[np.bool_] | None = None
    growing: npt.NDArray[np.int32] | None = None
    _tolerance: float = 1e-10
    #: Rounding error of each point.
    _off: FloatArray = field(default_factory=lambda: np.empty(0), repr=False)
    #: Allowed relative error of each point.
    _allowed: FloatArray = field(default_factory=lambda: np.empty(0), repr=False)

    kind = "backbone"
    _form = "backbone"

    @property
    def complete(self) -> bool:  # type: ignore[override]
        """True if the whole curve was followed with enough harmonics."""
        return self.outcome == "completed" and not self._short

    @property
    def _short(self) -> int:
        """Number of points with too few harmonics."""
        return int((self.truncation > np.maximum(self._tolerance, self._off)).sum())

    @property
    def _unit(self) -> str:
        """Unit of frequencies."""
        return "rad/s" if self.energy is None else ""

    def _headline(self) -> str:
        points = (
            "" if self.energy is None else f", {things(len(self.branch_points), 'branch point')}"
        )
        short = f", {things(self._short, 'point')} with too few harmonics" if self._short else ""
        short += rounding_text(self._off, self._allowed)
        found = f"{things(self.nu.size, 'point')}, {things(self.folds.size, 'fold')}"
        return f"{self.outcome}, {found}{points}{short}"

    def _scope(self) -> list[str]:
        return [
            f"mode {self.mode}, nu: {span(self.nu, self._unit)}; "
            f"{named(self.dof_names, self.dof_units)}; {things(self.harmonics.size, 'harmonic')}"
        ]

    def _details(self) -> list[str]:
        lines = [f"fold at {self.varies} = {fold:.10g}" for fold in self.folds]
        return lines + [
            f"branch point at {self.varies} = {point.parameter:.10g}"
            for point in self.branch_points
        ]

    def numbers(self) -> dict[str, Number]:
        """Frequencies at its ends, ``nu_first`` and ``nu_last``, ``folds`` and ``outcome``."""
        return {
            "nu_first": Number(self.nu[0], self._unit),
            "nu_last": Number(self.nu[-1], self._unit),
            "folds": Number(self.folds.size),
            "outcome": Number(self.outcome),
        }

    def panels(self) -> list[Panel]:
        """Return amplitudes over frequency, each of the largest harmonic."""
        return largest_panels(self, self.nu, f"$\\nu$ ({self._unit})" if self._unit else r"$\nu$")

    def _pieces(self) -> tuple[int, str, str]:
        n = self.nu.size
        return n, f"{things(n, 'point')} of {things(self.harmonics.size, 'harmonic')}", "point"

    def _motions(self) -> tuple[FloatArray, npt.NDArray[Any], ComplexArray]:
        return self.nu, self.harmonics, self.coefficients

    def amplitude(self, dof: int | str, harmonic: int = 1) -> FloatArray:
        """Return the amplitude of a harmonic of a coordinate, shape (n,)."""
        return np.abs(self.coefficient(dof, harmonic))

    @property
    def start(self) -> FloatArray:
        """u(0), shape (n, n_dof): with zero velocity the motion from there is periodic."""
        return np.asarray(self.coefficients.imag.sum(axis=2))

    def to_dataset(self) -> Dataset:
        """Return all data as an xarray Dataset over the points."""
        data: dict[str, Any] = {
            "nu": ("point", self.nu, {"units": "rad/s"}),
            "coefficients": (("point", "dof", "harmonic"), self.coefficients),
            "truncation": ("point", self.truncation),
            "error": ("point", self.error),
        }
        if self.energy is not None:
            data["energy"] = ("point", self.energy)
        if self.multipliers is not None:
            data["stable"] = ("point", self.stable)
            data["growing"] = ("point", self.growing)
            data["multipliers"] = (("point", "multiplier"), self.multipliers)
        return as_dataset(
            data,
            coords={
                "dof": list(self.dof_names),
                "unit": ("dof", list(self.dof_units)),
                "harmonic": self.harmonics,
            },
            attrs={
                "outcome": self.outcome,
                "linear_mode": self.mode,
                "folds": self.folds,
                "fold_errors": self.fold_errors,
                "plan": str(self.plan),
            },
        )

    def _table(self, coordinates: Sequence[str] | None) -> Table:
        names = {d: self.dof_names[d] for d in wanted_places(coordinates, self.dof_names)}
        table = Table(fold_notes("backbone", self), {"nu": self.nu})
        if self.branch_points:
            places = listed(point.parameter for point in self.branch_points)
            table.notes.append(f"branch points at {self.varies} ={places}")
        if self.energy is not None:
            table.columns["energy"] = self.energy
        note = NOTES["backbone"]
        if self.growing is not None:
            note += NOTES["stability"]
            table.columns |= stability_columns(self.growing, self.multipliers)
        units = listed_units(list(names.values()), [self.dof_units[d] for d in names])
        table.notes.append(f"{note}{NOTES['backbone_errors']}{units}")
        table.columns |= {"truncation": self.truncation, "error": self.error}
        for d, name in names.items():
            for j, k in enumerate(self.harmonics):
                table.columns[f"{name}_{k}"] = self.coefficients[:, d, j].imag
        return table


def oscillator_backbone(
    system: Any,
    mode: int,
    amplitude_range: tuple[float, float] | None,
    *,
    dof: str | None,
    harmonics: int | str,
    coordinates: Sequence[str] | None,
    **options: Any,
) -> Backbone:
    """`backbone` of a mount, a polynomial system or a structure."""
    check_steady(system, None)
    refuse_turning(system, "the backbone")
    if np.any(getattr(system, "spin", 0.0)):
        raise InputError("spin: must be 0 for a backbone, which omits damping and gyroscopic terms")
    if getattr(system, "_is_gyroscopic", False):
        raise InputError(
            "gyroscopic: must be 0 for a backbone, which omits damping and gyroscopic terms"
        )
    system = system._turned()
    names = system.dof_names
    j = _native.integer("mode", mode, 0, len(names) - 1)
    place = 0 if dof is None else names.index(_native.choice("dof", dof, names)) + 1
    view = None
    if amplitude_range is None:
        raise InputError("amplitude_range: must be given for all systems except a pendulum")
    ends = Interval("amplitude_range", above=0).check(amplitude_range)
    curve = CurveOptions.checked(options)
    wanted = curve.tolerance
    chosen = _native.is_auto(harmonics)
    highest = 1 if chosen else _native.integer("harmonics", harmonics, 1, MAX_HARMONICS)
    if system._is_condensed:
        # Add the coordinate of the amplitude to the condensed ones.
        most = place - 1 if place else system._moving_most(j)
        loaded, row = system._free.watching(most)
        view = View.of(system, loaded, coordinates)
        handle, place = loaded._handle, row + 1
    else:
        if coordinates is not None:
            raise InputError("coordinates: can be chosen for a structure only, must be None")
        handle = system._handle
    found = _native.interruptible(
        lambda: _native.run(
            "backbone oscillator", handle, mode=j, dof=place, name=dof or "",
            harmonics=0 if chosen else highest, **curve.along(*ends),
        )
    )  # fmt: skip
    nu, orders, off = found["nu"], found["harmonics"], found["off"]
    ended = OUTCOMES[found["ended"]]
    if not nu.size:
        raise InputError(
            f"amplitude_range: no solution was found at the start {ends[0]:g}, because "
            "the mode ends at a smaller amplitude: start at a smaller value"
            f"{edges_text(system)}"
        )
    edges = edges_text(system) if ended == "stuck" else ""
    if edges:
        warnings.warn(
            f"the backbone ends at nu = {nu[-1]:.6g}{edges}",
            ConvergenceWarning,
            stacklevel=caller(),
        )
    own = imaginary(found["cosines"].T)
    allowed = allowed_nearby(own, wanted, curve.values["atol"])
    warn_of_doubts(found["truncation"], off, (wanted, allowed), int(orders[-1]))
    text, units = found["text"], system.dof_units
    if view is not None:
        own = view.expand(nu, orders, own)
        names, units = view.names, view.units
        text = f"computes: {view.loaded.note}\n{text}"
    return Backbone(
        nu=nu,
        harmonics=orders,
        coefficients=own,
        truncation=found["truncation"],
        error=found["error"],
        mode=j,
        outcome=ended,
        folds=found["folds"],
        fold_errors=found["fold_errors"],
        dof_names=names,
        dof_units=units,
        plan=Plan(text),
        _tolerance=wanted,
        _off=off,
        _allowed=allowed,
    )


def imaginary(cosines: FloatArray) -> ComplexArray:
    """X_k of cosine coefficients."""
    found = np.zeros(cosines.shape, dtype=complex)
    found.imag = cosines
    return found


def warn_of_doubts(
    truncation: FloatArray, off: FloatArray, wanted: tuple[float, FloatArray], highest: int
) -> None:
    """Warn the caller of `backbone` of too few harmonics or too large rounding errors.

    ``wanted``: the tolerance, and with an absolute tolerance the allowed error of each point.
    """
    tolerance, allowed = wanted
    warn_of_rounding(off, tolerance, allowed)
    few = truncation > np.maximum(tolerance, off)
    if few.any():
        warnings.warn(
            f"at {few.sum()} of {few.size} points harmonics up to {highest} do not reach the "
            f"tolerance {tolerance:.1e}; the worst has an estimated relative error of "
            f"{truncation[few].max():.1e}",
            ConvergenceWarning,
            stacklevel=caller(),
        )
