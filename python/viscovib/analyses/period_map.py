"""The map over one or more periods of the load, computed by the core."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.analyses.following import _Way
from viscovib.analyses.memoryless import MAX_DOF
from viscovib.analyses.oscillator_motion import METHODS
from viscovib.analyses.runs import nothing
from viscovib.analyses.whole_structure import check_whole
from viscovib.errors import InputError
from viscovib.results.trajectory import OUTCOMES
from viscovib.systems.load import LoadLike, oscillator_series
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.structure import Structure
from viscovib.systems.whole import in_all_coordinates, n_hidden


class Ran(NamedTuple):
    """A motion over the whole time of the map."""

    last: FloatArray
    #: Derivatives of the last state with respect to the first; empty if not requested.
    by_start: FloatArray
    #: States at the requested times that were reached, without hidden states.
    at_times: FloatArray
    #: Number of switches of laws.
    passed: int
    outcome: str
    n_steps: int


def check_mapped(system: object) -> None:
    """Refuse a system without a map over a period."""
    if not isinstance(system, (PolynomialSystem, Structure)):
        raise InputError(
            f"system = {_native.shown(system)}: must be a PolynomialSystem or a Structure (for "
            "other systems use forced_response and trace_response)"
        )


@dataclass(frozen=True)
class PeriodMap:
    """Map of a state at t = 0 to the state after ``n_periods`` periods of the load.

    A state contains coordinates and velocities alternately, then the rates of hidden states.
    """

    flat: FloatArray
    orders: npt.NDArray[np.int32]
    series: ComplexArray
    formulas: str
    nu: float
    n_periods: int
    n_dof: int
    hidden: int
    method: str

    @classmethod
    def checked(
        cls,
        system: PolynomialSystem | Structure,
        load: LoadLike | None,
        nu: float,
        n_periods: int,
        method: str,
    ) -> PeriodMap:
        """Check the arguments; the core checks the system."""
        check_mapped(system)
        if system._turns:
            raise InputError(
                "geometry = 'exact': a steady motion in time takes a Body with small rotations"
            )
        check_whole(system)
        whole: PolynomialSystem = in_all_coordinates(system, always=True)
        n, hidden = len(whole.dof_names), n_hidden(whole)[0]
        sections = n > MAX_DOF or hidden > 0
        allowed = ("auto", "gauss8") if sections else ("auto", "gauss8", "gauss16")
        name = _native.choice("method", method, allowed)
        if load is None:
            raise InputError("load: must be given: its period is that of the motion")
        frequency = _native.number("nu", nu)
        if frequency <= 0:
            raise InputError(f"nu = {frequency:g}: must be greater than 0")
        orders, series, formulas = oscillator_series(whole, load, None)
        return cls(
            whole._flat, orders, series, formulas, frequency, n_periods, n, max(hidden, 0),
            "gauss8" if name == "auto" else name,
        )  # fmt: skip

    @property
    def period(self) -> float:
        """Period of the motion."""
        return 2 * math.pi * self.n_periods / self.nu

    @cached_property
    def system_in_core(self) -> _native.Handle:
        """The system in the core."""
        return _native.polynomial_object(self.flat)

    @property
    def given(self) -> dict[str, Any]:
        """The map as arguments of tasks of the core."""
        return {
            "orders": self.orders, "series": self.series, "formulas": self.formulas, "nu": self.nu,
            "n_periods": self.n_periods, "method": METHODS[self.method],
        }  # fmt: skip

    def with_numbers(self, flat: FloatArray) -> PeriodMap:
        """Return the map of a system with a different vector."""
        return replace(self, flat=flat)

    def along(self, way: _Way, p: float) -> PeriodMap:
        """Return the map at a value of the parameter that varies."""
        if way.numbers is not None:
            return self.with_numbers(way.numbers.at(p))
        if way.varies == "nu":
            return replace(self, nu=p)
        return replace(self, series=self.series * p)

    def extremes(self, begin: FloatArray, steps: int, times: FloatArray, tolerance: float) -> Any:
        """Return the smallest and largest displacements of the motion from a state."""
        found = _native.apart(
            lambda: _native.run(
                "motion extremes", self.system_in_core, **self.given, begin=begin, n_steps=steps,
                times=times, tolerance=tolerance,
            )
        )  # fmt: skip
        return found["low"], found["high"]

    def run(
        self,
        state: FloatArray,
        steps: int,
        times: FloatArray | None = None,
        derivatives: bool = True,
    ) -> Ran:
        """Compute the motion from a state; ``steps`` = 0: number at the start of a search."""
        found = _native.run_either(
            steps > _native.MANY_STEPS, "motion of a period", self.system_in_core, **self.given,
            begin=state, n_steps=steps, times=nothing(0) if times is None else times,
            derivatives=derivatives,
        )  # fmt: skip
        outcome = OUTCOMES[found["ended"]]
        if outcome == "completed" and not found["known"]:
            outcome = "grazing"
        return Ran(
            found["last"], found["by_start"], found["at_times"].T, found["n_passed"], outcome,
            found["n_steps"],
        )  # fmt: skip
