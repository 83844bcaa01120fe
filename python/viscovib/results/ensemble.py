"""Ensembles of motions and their results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib._native import ComplexArray, FloatArray
from viscovib.common.counts import things
from viscovib.common.plan import Plan
from viscovib.common.results import Dataset, Result, as_dataset, span
from viscovib.results.located_peaks import LocatedPeaks
from viscovib.systems.mount import Mount
from viscovib.systems.pendulum import Pendulum
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.structure import Structure


@dataclass(frozen=True, eq=False, repr=False)
class Ensemble(Result):
    """Many motions and their selected results.

    Attributes
    ----------
    t_end : ndarray, shape (n,)
        Requested end time of each run.
    t_reached : ndarray, shape (n,)
        Time at which each run ended.
    state : ndarray, shape (n, 2 n_dof)
        Final states, as in a Trajectory.
    outcome : ndarray of str, shape (n,)
        "completed", "diverged", "unphysical" or "step too large", as in a Trajectory. The final
        state of a run that ended early is that at ``t_reached``.
    step : ndarray, shape (n,)
        Step sizes of the integrator.
    dt : ndarray, shape (n,)
        Spacing of the states kept: the periods between ``sections``; NaN without sections.
    peak, mean, rms : ndarray, shape (n, 2 n_dof), or None
        Largest absolute value, mean and root mean square of the motion, also between steps; NaN
        for a run that ended early.
    amplitudes : complex ndarray, shape (n, n_lines, n_dof), or None
        X of each coordinate at each requested frequency: u = mean + Re(X exp(i omega t)); NaN in
        both parts for a run that ended early.
    sections : ndarray, shape (n, n_points, 2 n_dof), or None
        States at whole periods of a load, or on a surface; NaN after the end of a run.
    section_times : ndarray, shape (n, n_points), or None
        Times of the states on a surface, NaN after the last one.
    lyapunov : ndarray, shape (n,), or None
        Largest Lyapunov exponent (a time average): small errors grow like exp(lyapunov t). NaN for
        a run that ended early.
    lyapunov_error : ndarray, shape (n,), or None
        Estimated distance from the infinite-time exponent: twice the range by which the logarithmic
        growth deviates from a straight line, divided by the run time, plus the change with half the
        step size (not for a given step size).
    spectrum : ndarray, shape (n, 2 n_dof), or None
        All exponents in the directions of the states, if requested, largest first. The phase of the
        load has the additional exponent 0. -inf: a perturbation vanishes, as with friction that
        sticks.
    spectrum_error : ndarray, shape (n, 2 n_dof), or None
        As ``lyapunov_error``, for each exponent; 0 for -inf.
    error : float or None
        Estimated largest error of the final states, of ``t_reached``, and of ``peak``, ``mean`` and
        ``rms``, for ``dt`` = "auto"; None for a given step size.
    section_error : float or None
        Estimated largest error of ``sections`` and ``section_times``, from half the step size; inf
        if the number of points differs.
    amplitude_error : float or None
        Estimated largest error of ``amplitudes``, from a different step size and a finer spacing of
        samples. It does not include the finite resolution of the run time.
    peaks : tuple of LocatedPeaks
        Located peaks of the requested quantities.
    method : str
        Integrator.
    parameters : mapping
        Parameters that vary, each an array of shape (n,).
    system : Pendulum, PolynomialSystem, Structure or Mount
    plan : Plan
        What was computed, and what was skipped and why.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> body = vv.Pendulum(
    ...     e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01, f0=0.002, p1=1.02
    ... )
    >>> many = vv.simulate_ensemble(
    ...     body,
    ...     initial=np.zeros((4, 6)),
    ...     t_end=20.0,
    ...     parameters={"f0": [0.001, 0.002, 0.003, 0.004]},
    ... )
    >>> many.state.shape[0]
    4
    """

    t_end: FloatArray
    t_reached: FloatArray
    state: FloatArray
    outcome: npt.NDArray[np.str_]
    step: FloatArray
    dt: FloatArray
    peak: FloatArray | None
    mean: FloatArray | None
    rms: FloatArray | None
    amplitudes: ComplexArray | None
    sections: FloatArray | None
    lyapunov: FloatArray | None
    error: float | None
    method: str
    parameters: Mapping[str, FloatArray]
    system: Pendulum | PolynomialSystem | Structure | Mount
    plan: Plan
    lyapunov_error: FloatArray | None = None
    spectrum: FloatArray | None = None
    spectrum_error: FloatArray | None = None
    section_times: FloatArray | None = None
    section_error: float | None = None
    amplitude_error: float | None = None
    peaks: tuple[LocatedPeaks, ...] = ()
    _names: tuple[str, ...] = ()

    kind = "ensemble"

    @property
    def dof_names(self) -> tuple[str, ...]:
        """Names of the coordinates in the states."""
        return self._names or self.system.dof_names

    @property
    def complete(self) -> bool:  # type: ignore[override]
        """True if all motions were followed to their ends."""
        return bool((self.outcome == "completed").all())

    def _headline(self) -> str:
        kinds, counts = np.unique(self.outcome, return_counts=True)
        ends = ", ".join(f"{n} {kind}" for kind, n in zip(kinds, counts, strict=True))
        return f"{things(self.t_end.size, 'motion')}: {ends}"

    def _scope(self) -> list[str]:
        varied = ", ".join(f"{name} {span(v)}" for name, v in self.parameters.items()) or "nothing"
        sure = "error not estimated" if self.error is None else f"estimated error {self.error:.1e}"
        for name, error in (("sections", self.section_error), ("lines", self.amplitude_error)):
            sure += "" if error is None else f", of {name} {error:.1e}"
        return [f"t_end: {span(self.t_end)}; varied: {varied}; {self.method}, {sure}"]

    def to_dataset(self) -> Dataset:
        """Return all results over the runs."""
        names = [f"{d}{dot}" for d in self.dof_names for dot in ("", "_dot")]
        time = {"units": self.system.time_unit}
        data: dict[str, Any] = {
            "state": (("run", "quantity"), self.state),
            "outcome": ("run", self.outcome),
            "t_reached": ("run", self.t_reached, time),
        }
        for key in ("peak", "mean", "rms"):
            if (value := getattr(self, key)) is not None:
                data[key] = (("run", "quantity"), value)
        if self.amplitudes is not None:
            data["amplitudes"] = (("run", "line", "dof"), self.amplitudes)
        if self.sections is not None:
            data["sections"] = (("run", "point", "quantity"), self.sections)
        if self.section_times is not None:
            data["section_times"] = (("run", "point"), self.section_times, time)
        if self.lyapunov is not None:
            data["lyapunov"] = ("run", self.lyapunov)
            data["lyapunov_error"] = ("run", self.lyapunov_error)
        if self.spectrum is not None:
            data["spectrum"] = (("run", "exponent"), self.spectrum)
            data["spectrum_error"] = (("run", "exponent"), self.spectrum_error)
        for one in self.peaks:
            data[f"peak of {one.name}"] = ("run", one.value, {"error": one.error, "t": one.t})
        kept = [self.system.dof_names.index(name) for name in self.dof_names]
        own, rates = self.system.dof_units, self.system.rate_units
        units = [own[i] for i in kept]
        both = [unit for i in kept for unit in (own[i], rates[i])]
        coordinates: dict[str, Any] = {
            "quantity": names,
            "unit_of_quantity": ("quantity", both),
            "dof": list(self.dof_names),
            "unit": ("dof", units),
        }
        coordinates |= {name: ("run", values) for name, values in self.parameters.items()}
        attributes: dict[str, Any] = {"method": self.method, "plan": str(self.plan)}
        for name in ("error", "section_error", "amplitude_error"):
            if (value := getattr(self, name)) is not None:
                attributes[name] = value
        return as_dataset(data, coords=coordinates, attrs=attributes)
