"""Branches of periodic solutions, computed by continuation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.common.column_notes import NOTES
from viscovib.common.counts import things
from viscovib.common.motion_stability import stability_columns, whole_or_codes
from viscovib.common.periodic_motions import PeriodicMotions
from viscovib.common.plan import Plan, wanted_places
from viscovib.common.results import Dataset, as_dataset
from viscovib.common.tables import Table, listed_units
from viscovib.errors import InputError
from viscovib.results.curves import (
    BranchPoint,
    Crossing,
    Curve,
    branch_notes,
    crossing_variables,
)
from viscovib.results.dissipation import Parts
from viscovib.results.response import MAX_SEARCH, find_peak
from viscovib.results.sampling import add_requested, lost_energy, sampling_errors, sampling_text
from viscovib.systems.load import Job


@dataclass(frozen=True, eq=False, repr=False)
class Branch(PeriodicMotions, Curve):
    """A branch of periodic solutions u = Im sum_k X_k exp(i k nu t), in the order followed.

    Attributes
    ----------
    nu : ndarray, shape (n,)
        Circular frequencies (rad/s).
    load_factor : ndarray, shape (n,)
        Factor of the load.
    harmonics : ndarray of int, shape (m,)
        Harmonics k that are kept.
    coefficients : complex ndarray, shape (n, n_dof, m)
        X_k.
    stable : ndarray of bool, shape (n,), or None
        Stability of each motion. None: not requested, or unknown because the system is too stiff
        for the Floquet solver. If the stability of some motions is unknown, the array contains
        objects: True, False and None.
    growing : ndarray of int, shape (n,), or None
        Number of growing perturbations; -1: unknown.
    multipliers : complex ndarray, shape (n, 2 n_dof), or None
        Floquet multipliers, largest first, NaN if unknown; with memory exp(2 pi exponents/nu).
    exponents : complex ndarray, shape (n, m), or None
        Exponents lambda (1/s) of perturbations exp(lambda t) times a periodic function, largest
        real part first, modulo i nu (2 i nu for motions with half-wave symmetry, where Im lambda =
        nu at symmetry breaking). With memory the growing exponents are complete, or all exponents
        of the motion are NaN. Some decaying exponents may be missing.
    slowest : ndarray of bool, shape (n,), or None
        True: no perturbation decays more slowly than the first multiplier. False: a slower
        perturbation may exist, because the search failed or because the kernel itself relaxes more
        slowly. The kernel of Rabotnov relaxes as a power of time, more slowly than any exponential.
    folds : ndarray, shape (n_folds,)
        Parameter values at which the branch turns back. A closed branch lists its start, if it
        turns back there, as the last fold.
    fold_errors : ndarray, shape (n_folds,)
        Estimated error of each fold by neglected harmonics and rounding, in the unit of the
        parameter.
    fold_coefficients : complex ndarray, shape (n_folds, n_dof, m)
        X_k at each fold.
    fold_coefficient_errors : ndarray, shape (n_folds,)
        Estimated error of the motion at each fold by neglected harmonics and rounding, relative to
        its size, in the norm of ``tolerance``.
    branch_points : tuple of BranchPoint
        Points at which a second branch crosses. Pass one of them to `trace_response` as ``leave``.
    crossings : tuple of Crossing
        Bifurcation points, located to 1e-8 or better on the motions with the harmonics kept. If
        ``truncation`` of a neighbouring point exceeds the tolerance, the converged motion may
        bifurcate at a different value.
    stops : ndarray of int
        Indices of the points at the values of ``at``.
    outcome : str
        "completed"; "returned": back at the start, a second branch continues; "step limit":
        max_points reached; "fold limit": max_folds reached; "stuck": no smaller step size helps, or
        steps alternate; "overflow"; "closed": back at the first point; "unphysical": at the limit
        of valid parameter values.
    error : ndarray, shape (n,)
        Estimated relative error of each motion at its parameter value by the last correction and
        rounding. With very small damping it is the rounding error divided by the damping and may
        exceed ``tolerance``. It may also exceed it near a fold, where the motion changes fast with
        the parameter.
    varies : str
        "nu", "load_factor" or a parameter of the system.
    parameter : ndarray, shape (n,)
        Values of the parameter that varies.
    highest : ndarray of int, shape (n,)
        Highest harmonic of each point.
    truncation : ndarray, shape (n,)
        Estimated relative error of each motion at its parameter value by neglected harmonics, in
        the norm of ``tolerance``. Near a fold it exceeds ``tolerance``, up to 1 (the motion may not
        exist at this value), although the point is within ``tolerance`` of the converged branch.
        ``fold_errors`` estimates the shift of the folds. Warnings and `complete` refer to the
        distance from the branch.

    Examples
    --------
    >>> import viscovib as vv
    >>> mount = vv.Mount(
    ...     mass=1,
    ...     inertia=0.1,
    ...     offset=0.5,
    ...     stiffness_x=10,
    ...     stiffness_phi=2,
    ...     damping=[[0.2, -0.1], [-0.1, 0.09]],
    ... )
    >>> branch = vv.trace_response(mount, (0.5, 6), load=0.5)
    >>> branch.outcome
    'completed'
    >>> len(branch.folds)
    2
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
    fold_errors: FloatArray
    fold_coefficients: ComplexArray
    fold_coefficient_errors: FloatArray
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
    #: Creates the plan.
    _planned: Callable[[], Plan] = field(repr=False)
    #: System, load and varied parameter for the core, and the relative tolerance.
    _job: Job = field(repr=False)
    _tolerance: float = field(repr=False)
    #: Allowed relative error of each motion, including the absolute tolerance.
    _allowed: FloatArray = field(repr=False)
    #: Rounding error of each point, relative to motion and parameter.
    _off: FloatArray = field(repr=False)
    #: Truncation error of each point, relative to motion and parameter.
    _missed: FloatArray = field(repr=False)
    #: Data for the energy loss of the motions.
    _parts: Parts | None = field(default=None, repr=False)
    #: Additional columns requested by a scene.
    _extra_columns: tuple[str, ...] = field(default=(), repr=False)

    @cached_property
    def plan(self) -> Plan:
        """What was computed, and what was skipped and why; created on first access."""
        return self._planned()

    @property
    def _circular(self) -> bool:
        return self.varies == "nu"

    @property
    def label(self) -> str:
        """Axis label of the parameter."""
        if self.varies == "nu":
            return r"circular frequency of the load $\nu$ (rad/s)"
        name = "factor of the load" if self.varies == "load_factor" else self.varies
        return f"{name}, at frequency {self.nu[0]:g} rad/s"

    @property
    def _orders(self) -> npt.NDArray[np.int32]:
        return self.harmonics

    def _scope(self) -> list[str]:
        *lines, last = super()._scope()
        worst = np.nanmax(self._missed, initial=0.0)
        return [
            *lines,
            f"{last}; estimated error by neglected harmonics {worst:.1e}{sampling_text(self)}",
        ]

    def _lacking(self) -> str:
        short, blurred = (int(which.sum()) for which in (self._few, self._off > self._allowed))
        words = f", {things(short, 'point')} with too few harmonics" if short else ""
        if blurred:
            words += f", {things(blurred, 'point')} with a rounding error above the tolerance"
        return words

    @property
    def _few(self) -> npt.NDArray[np.bool_]:
        """Mask of points with too few harmonics, without points limited by rounding errors."""
        return np.asarray(self._missed > np.maximum(self._allowed, self._off))

    @property
    def complete(self) -> bool:  # type: ignore[override]
        """True if the whole branch was followed with enough harmonics."""
        return self.outcome == "completed" and not self._few.any()

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
        return find_peak(
            self._job, self.harmonics[kept], self.parameter[i : i + 1],
            self.coefficients[i : i + 1][..., kept], (d, j), self._tolerance, keep_idle=True,
            low=float(low), high=float(high),
        )  # fmt: skip

    def _summit_between(
        self, places: npt.NDArray[np.intp], d: int, j: int
    ) -> tuple[float, float] | None:
        kept = np.flatnonzero(self.harmonics <= self.highest[places].max())
        unknowns = 2 * kept.size * len(self.dof_names)
        if j >= kept.size or places.size * unknowns**3 > MAX_SEARCH:
            return None
        along = self.parameter[places]
        return find_peak(
            self._job, self.harmonics[kept], along, self.coefficients[places][..., kept], (d, j),
            self._tolerance, keep_idle=True, low=along[0], high=along[-1],
        )  # fmt: skip

    @cached_property
    def sampling(self) -> FloatArray:
        """Estimated relative error of each point by sampling of its forces; see `Response`."""
        return sampling_errors(self, self._job, self.parameter, self._relative(self.load_factor))

    def _relative(self, factors: FloatArray) -> ComplexArray:
        """Motions relative to the base, of the coordinates that the core computes."""
        assert self._parts is not None
        return self._parts.relative(self.harmonics, self.coefficients, factors)

    def dissipation(self) -> FloatArray:
        """Energy loss per period as in `Response`; for branches over the frequency or the load."""
        self._check_loses()
        assert self._parts is not None
        return self._parts.dissipated(
            self.nu, self.harmonics, self._whole(), self.load_factor, linear=False
        )

    def _energy_loss(self) -> FloatArray:
        """Energy loss of each motion per period by all forces (J), shape (n,)."""
        factors = self.load_factor
        return lost_energy(self, self._job, factors, self._relative(factors))

    def _check_loses(self) -> None:
        if self.varies not in ("nu", "load_factor"):
            raise InputError(
                f"dissipation: the system changes along a branch over {self.varies}, must be one "
                "over nu or load_factor"
            )

    def _whole(self) -> ComplexArray:
        """X_k of all coordinates."""
        return self.coefficients

    def to_dataset(self) -> Dataset:
        """Return all data as an xarray Dataset over the points."""
        data: dict[str, Any] = {
            "nu": ("point", self.nu, {"units": "rad/s"}),
            "load_factor": ("point", self.load_factor),
            "coefficients": (("point", "dof", "harmonic"), self.coefficients),
            "highest": ("point", self.highest),
            "truncation": ("point", self.truncation),
            "sampling": ("point", self.sampling),
            "error": ("point", self.error),
            "iterations": ("point", self.iterations),
            **crossing_variables(self.crossings),
        }
        if self.stable is not None and self.multipliers is not None:
            data["stable"] = ("point", whole_or_codes(self.stable))
            data["growing"] = ("point", self.growing)
            data["exponents"] = (("point", "multiplier"), self.exponents)
            data["multipliers"] = (("point", "multiplier"), self.multipliers)
            data["slowest"] = ("point", self.slowest)
        return as_dataset(
            data,
            coords={
                "dof": list(self.dof_names),
                "unit": ("dof", list(self.dof_units)),
                "harmonic": self.harmonics,
            },
            attrs={
                "outcome": self.outcome,
                "folds": self.folds,
                "fold_errors": self.fold_errors,
                "fold_coefficient_errors": self.fold_coefficient_errors,
                "plan": str(self.plan),
            },
        )

    def _table(self, coordinates: Sequence[str] | None) -> Table:
        names = {d: self.dof_names[d] for d in wanted_places(coordinates, self.dof_names)}
        table = Table(branch_notes(self), {self.varies: self.parameter})
        note = NOTES["branch"]
        if self.growing is not None:
            note += NOTES["stability"]
            table.columns |= stability_columns(self.growing, self.multipliers)
        units = listed_units(list(names.values()), [self.dof_units[d] for d in names])
        table.notes.append(f"{note}{NOTES['branch_errors']}{units}")
        table.columns |= {"highest": self.highest, "truncation": self.truncation}
        table.columns["error"] = self.error
        add_requested(table, self)
        table.add_harmonics(names, map(str, self.harmonics), self.coefficients)
        return table
