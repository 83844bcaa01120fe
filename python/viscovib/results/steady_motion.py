"""A periodic motion computed in time by shooting."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.common.counts import things
from viscovib.common.results import Dataset, Number, Panel, Result, as_dataset, named
from viscovib.errors import InputError

#: Relative error of a displacement at a zero of the velocity.
_LEFT = 1e-15


@dataclass(frozen=True, eq=False, repr=False)
class SteadyMotion(Result):
    """A motion that repeats after ``n_periods`` periods of its load, from `steady_motion`.

    Attributes
    ----------
    nu : float
        Circular frequency of the load (rad/s).
    n_periods : int
        Number of load periods after which the motion repeats; ``t`` and ``multipliers`` refer to
        this time.
    repeats_after : int
        Smallest number of load periods after which the motion repeats within its error: 1 for
        ``n_periods`` = 2 if the period has not doubled.
    t, state : ndarray, shapes (n,) and (n, 2 n_dof)
        States at equidistant times over one period: each coordinate and its velocity. For any other
        ``times`` call `simulate` with ``state[0]`` as ``initial`` (without memory).
    remembered : ndarray, shape (n_hidden,)
        With memory by exponentials: the internal rates at t = 0.
    multipliers : complex ndarray, shape (m,)
        Floquet multipliers, the largest first: factors of small perturbations per period of the
        motion. Friction that sticks and contact with a stop cause multipliers of 0 within rounding
        error.
    stable : bool or None
        True if all multipliers are inside the unit circle; None if the largest is closer to it than
        ``multiplier_error``.
    error : float
        Estimated largest error of ``state[0]``, velocities divided by ``nu``, by the step size, the
        last correction and rounding, which is amplified near folds.
    multiplier_error : float
        Estimated largest error of the multipliers.
    outcome : str
        "converged"; "stalled": Newton's method does not converge, or there are too many steps;
        "diverged": the motion escapes. Without convergence the last iterate is returned.
    iterations : int
        Total number of Newton iterations.
    switches : int
        Number of switches of laws in the motion.
    step : float
        Step size of the integrator.

    Examples
    --------
    >>> import viscovib as vv
    >>> stop = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.2, forces="20*max(x - 0.5, 0)")
    >>> motion = vv.steady_motion(stop, 0.9, load=0.3)
    >>> motion.outcome, motion.stable, motion.switches
    ('converged', True, 2)
    """

    nu: float
    n_periods: int
    repeats_after: int
    t: FloatArray
    state: FloatArray
    remembered: FloatArray
    multipliers: ComplexArray
    stable: bool | None
    error: float
    multiplier_error: float
    outcome: str
    iterations: int
    switches: int
    step: float
    method: str
    system: Any
    _map: Any = field(repr=False)

    kind = "steady_motion"

    @property
    def complete(self) -> bool:  # type: ignore[override]
        """True if the motion was found."""
        return self.outcome == "converged"

    @property
    def period(self) -> float:
        """Period of the motion: ``n_periods`` periods of the load."""
        return float(self._map.period)

    @property
    def dof_names(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return tuple(self.system.dof_names)

    @property
    def dof_units(self) -> tuple[str, ...]:
        """Units of the coordinates."""
        return tuple(self.system.dof_units)

    def __call__(self, t: npt.ArrayLike) -> FloatArray:
        """States at any times, shape (2 n_dof,) or (n, 2 n_dof), by additional steps."""
        times = _native.real_array("t", t)
        phases = np.mod(times.ravel(), self.period)
        # A remainder may be rounded up to the period.
        phases = np.where(phases >= self.period, 0.0, phases)
        wanted, back = np.unique(phases, return_inverse=True)
        start = np.concatenate([self.state[0], self.remembered])
        states = self._map.run(start, round(self.period / self.step), times=wanted).at_times
        if states.shape[0] < wanted.size:
            raise InputError("t: the motion does not reach these times")
        return np.asarray(states[back].reshape(*times.shape, self.state.shape[1]))

    def coordinate(self, name: str) -> FloatArray:
        """Return the displacement of a coordinate at the times ``t``, shape (n,)."""
        return self.state[:, 2 * self._place(name)]

    def _place(self, name: str) -> int:
        return self.dof_names.index(_native.choice("name", name, self.dof_names))

    def extremes(self, name: str) -> tuple[float, float]:
        """Return the smallest and largest displacement of a coordinate.

        Zeros of the velocity between the times ``t`` are located by steps of the integrator.
        """
        d, (low, high) = self._place(name), self._extremes
        return float(low[d]), float(high[d])

    @cached_property
    def _extremes(self) -> tuple[FloatArray, FloatArray]:
        """Smallest and largest displacements of all coordinates."""
        start = np.concatenate([self.state[0], self.remembered])
        steps = round(self.period / self.step)
        found: tuple[FloatArray, FloatArray] = self._map.extremes(start, steps, self.t, _LEFT)
        return found

    def _headline(self) -> str:
        words = {True: "stable", False: "unstable", None: "stability unknown"}[self.stable]
        sooner = ""
        if self.repeats_after < self.n_periods:
            sooner = f", repeats after {things(self.repeats_after, 'period')}"
        return (
            f"{self.outcome}, {words}, {things(self.switches, 'switch', 'switches')} of "
            f"laws{sooner}"
        )

    def _scope(self) -> list[str]:
        return [
            f"nu: {self.nu:.6g}; over {things(self.n_periods, 'period')}; "
            f"{named(self.dof_names, self.dof_units)}; {self.method}",
            f"estimated error {self.error:.1e}, step {self.step:.6g}, "
            f"{things(self.iterations, 'iteration')}",
        ]

    def numbers(self) -> dict[str, Number]:
        """Return ``min_x``, ``max_x``, ..., the size of the largest multiplier and ``outcome``."""
        found: dict[str, Number] = {}
        for name, unit in zip(self.dof_names, self.dof_units, strict=True):
            low, high = self.extremes(name)
            found |= {f"min_{name}": Number(low, unit), f"max_{name}": Number(high, unit)}
        found["multiplier"] = Number(float(np.abs(self.multipliers).max(initial=0.0)))
        return found | {"outcome": Number(self.outcome)}

    def panels(self) -> list[Panel]:
        """Return the coordinates over a period."""
        label = "$t$ (s)" if self.system.time_unit == "s" else r"$\tau$"
        return [
            Panel(self.t, self.state[:, 2 * d], label, name, unit)
            for d, (name, unit) in enumerate(zip(self.dof_names, self.dof_units, strict=True))
        ]

    def to_dataset(self) -> Dataset:
        """Return all data as an xarray Dataset: states over t, and multipliers."""
        columns = [f"{name}{dot}" for name in self.dof_names for dot in ("", "_dot")]
        return as_dataset(
            {
                "state": (("t", "column"), self.state),
                "multiplier": ("disturbance", self.multipliers),
            },
            coords={"t": self.t, "column": columns},
            attrs={
                "nu": self.nu, "n_periods": self.n_periods, "repeats_after": self.repeats_after,
                "outcome": self.outcome,
                "stable": {True: 1, False: 0, None: -1}[self.stable], "error": self.error,
                "multiplier_error": self.multiplier_error, "switches": self.switches,
                "iterations": self.iterations,
                "step": self.step, "method": self.method,
            },
        )  # fmt: skip
