"""A branch of periodic motions, followed in time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.common.counts import things
from viscovib.common.motion_stability import codes_of
from viscovib.common.results import Dataset, Number, Panel, Result, as_dataset, named, span
from viscovib.results.curves import Crossing, crossing_variables
from viscovib.results.steady_motion import SteadyMotion


@dataclass(frozen=True, eq=False, repr=False)
class MotionBranch(Result):
    """Periodic motions along a parameter, from `trace_motion`.

    Attributes
    ----------
    parameter : ndarray, shape (n,)
        Values of the parameter ``varies`` at the points of the branch.
    nu : ndarray, shape (n,)
        Circular frequencies of the load.
    state : ndarray, shape (n, 2 n_dof)
        State of each motion at t = 0; ``branch.motion(i)`` returns the motion.
    smallest, largest : ndarray, shape (n, n_dof)
        Extremes of each coordinate, accurate to about 1e-9.
    multipliers : complex ndarray, shape (n, m)
        Floquet multipliers, the largest first.
    stable : ndarray, shape (n,)
        True or False, or None if the largest multiplier is on the unit circle within its error.
    switches : ndarray of int, shape (n,)
        Number of switches of laws per period.
    repeats_after : ndarray of int, shape (n,)
        Smallest number of load periods after which each motion repeats, see `SteadyMotion`.
    error : ndarray, shape (n,)
        Estimated largest error of each state, velocities divided by ``nu``.
    folds, grazings : ndarray
        Parameter values at which the branch turns back, and at which a switch appears or
        disappears, as at a grazing contact. They are located to rounding error, which is amplified
        near folds and bifurcation points; nan and a warning if the search fails. At a rigid stop a
        branch has a corner at grazing. A fold or a bifurcation point may coincide with it.
    fold_errors, grazing_errors : ndarray
        Estimated errors of these values, from a different step size; inf if the values do not exist
        with it.
    crossings : tuple of Crossing
        Bifurcation points: "fold", "branch point", "period doubling", "Neimark-Sacker".
    outcome : str
        "completed"; "stuck": no step continues the branch; "points": the maximum number of points
        is reached.

    Examples
    --------
    >>> import viscovib as vv
    >>> stop = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.2, forces="20*max(x - 0.5, 0)")
    >>> branch = vv.trace_motion(stop, (0.5, 1.5), load=0.3)
    >>> branch.outcome, branch.grazings.size
    ('completed', 2)
    """

    varies: str
    parameter: FloatArray
    nu: FloatArray
    state: FloatArray
    smallest: FloatArray
    largest: FloatArray
    multipliers: ComplexArray
    stable: npt.NDArray[Any]
    switches: npt.NDArray[np.int64]
    error: FloatArray
    folds: FloatArray
    fold_errors: FloatArray
    grazings: FloatArray
    grazing_errors: FloatArray
    crossings: tuple[Crossing, ...]
    outcome: str
    n_periods: int
    repeats_after: npt.NDArray[np.int64]
    system: Any
    #: Marks in pictures: kind, parameter, largest displacements.
    _marks: tuple[tuple[str, float, FloatArray], ...] = field(repr=False)
    #: Functions that compute the motion at each point.
    _points: tuple[Callable[[], SteadyMotion], ...] = field(repr=False)

    kind = "motion_branch"

    @property
    def complete(self) -> bool:  # type: ignore[override]
        """True if the whole range was followed."""
        return self.outcome == "completed"

    @property
    def dof_names(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return tuple(self.system.dof_names)

    @property
    def _n_not_located(self) -> int:
        """Number of bifurcation points and grazings without a location."""
        lost = sum(one.parameter is None for one in self.crossings)
        return lost + int(np.isnan(self.grazings).sum())

    @property
    def label(self) -> str:
        """Axis label of the parameter."""
        if self.varies == "nu":
            return r"circular frequency of the load $\nu$ (rad/s)"
        name = "factor of the load" if self.varies == "load_factor" else self.varies
        return f"{name}, at frequency {self.nu[0]:g} rad/s"

    def motion(self, i: int) -> SteadyMotion:
        """Return the motion at the i-th point."""
        place = _native.integer("i", i, -len(self._points), len(self._points) - 1)
        return self._points[place]()

    def _headline(self) -> str:
        return (
            f"{self.outcome}, {things(self.parameter.size, 'point')}, "
            f"{things(self.folds.size, 'fold')}, {things(self.grazings.size, 'grazing')}"
            + (f", {self._n_not_located} not located" if self._n_not_located else "")
            + self._sooner()
        )

    def _sooner(self) -> str:
        early = int((self.repeats_after < self.n_periods).sum())
        if not early:
            return ""
        return f", {things(early, 'motion')} of a shorter period than {self.n_periods}"

    def _scope(self) -> list[str]:
        stable = int(sum(one is True for one in self.stable))
        return [
            f"{self.varies}: {span(self.parameter)}; "
            f"{named(self.dof_names, tuple(self.system.dof_units))}",
            f"stable at {things(stable, 'point')}, largest error {self.error.max(initial=0.0):.1e}",
        ]

    def _details(self) -> list[str]:
        return [*self._scope(), *map(str, self.crossings)]

    def numbers(self) -> dict[str, Number]:
        """Return ``max_x``, ..., ``folds``, ``grazings`` and ``outcome``."""
        found: dict[str, Number] = {}
        for d, (name, unit) in enumerate(zip(self.dof_names, self.system.dof_units, strict=True)):
            found[f"max_{name}"] = Number(float(self.largest[:, d].max()), unit)
        found["folds"], found["grazings"] = Number(self.folds.size), Number(self.grazings.size)
        return found | {"outcome": Number(self.outcome)}

    def panels(self) -> list[Panel]:
        """Return the largest displacements along the branch."""
        units = self.system.dof_units
        return [
            Panel(self.parameter, self.largest[:, d], self.varies, name, unit)
            for d, (name, unit) in enumerate(zip(self.dof_names, units, strict=True))
        ]

    def to_dataset(self) -> Dataset:
        """Return all data as an xarray Dataset over the points."""
        columns = [f"{name}{dot}" for name in self.dof_names for dot in ("", "_dot")]
        return as_dataset(
            {
                "nu": ("point", self.nu),
                "state": (("point", "column"), self.state),
                "smallest": (("point", "dof"), self.smallest),
                "largest": (("point", "dof"), self.largest),
                "stable": ("point", codes_of(self.stable)),
                "multiplier": (("point", "disturbance"), self.multipliers),
                "switches": ("point", self.switches),
                "repeats_after": ("point", self.repeats_after),
                "error": ("point", self.error),
                "parameter": ("point", self.parameter),
                "folds": ("fold", self.folds),
                "fold_errors": ("fold", self.fold_errors),
                "grazings": ("grazing", self.grazings),
                "grazing_errors": ("grazing", self.grazing_errors),
                **crossing_variables(self.crossings),
            },
            coords={
                "column": columns,
                "dof": list(self.dof_names),
                "unit": ("dof", list(self.system.dof_units)),
            },
            attrs={"varies": self.varies, "outcome": self.outcome, "n_periods": self.n_periods},
        )
