"""Results of the method of multiple scales."""

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
from viscovib.common.plan import Plan, wanted_places
from viscovib.common.results import Dataset, Result, as_dataset, span
from viscovib.common.tables import Table
from viscovib.errors import InputError
from viscovib.results.beats import BeatingMotion
from viscovib.results.modulation import Modulation

#: Growth below this part of the frequency counts as 0.
_NEUTRAL = 1e-9
#: Largest ratio of successive orders, and of the error to the first order, within the range.
LEAST_FALL = 0.3


def falling(sizes: FloatArray) -> FloatArray:
    """Return the ratios of successive orders, from rows of the sizes of three orders."""
    first = np.maximum(sizes[:, 0], np.finfo(float).tiny)
    return np.asarray(np.maximum(sizes[:, 1] / first, np.sqrt(sizes[:, 2] / first)))


@dataclass(frozen=True, eq=False, repr=False)
class ScalesMotion(Result):
    """A motion to third order.

    Attributes
    ----------
    t : ndarray, shape (n,)
    state : ndarray, shape (n, 2 n_dof)
        (q1, q1', q2, q2', ...).
    modulation : Modulation
    order_sizes : ndarray, shape (n, 3)
        Upper bounds of the terms of first, second and third order, each in the coordinate where it
        is largest. Coordinates are compared in units from the modal masses.
    mode_shapes : ndarray, shape (n_dof, n_modes)
        As in `MultipleScales`.
    plan : Plan
        What was computed, and what was skipped and why.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> body = vv.Pendulum(
    ...     e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01, f0=0.002, p1=1.02
    ... )
    >>> motion = vv.MultipleScales(body).motion(
    ...     np.linspace(0, 50, 100), [0.05, 0, 0.1, 0, 0, 0]
    ... )
    """

    t: FloatArray
    state: FloatArray
    modulation: Modulation
    order_sizes: FloatArray
    mode_shapes: npt.NDArray[Any]
    dof_names: tuple[str, ...]
    plan: Plan
    _errors: Callable[[], FloatArray] = field(repr=False)
    #: Units of the coordinates in units of the sizes, shape (n, n_dof).
    _units: FloatArray = field(repr=False)

    kind = "motion"

    def _headline(self) -> str:
        found = things(self.t.size, "state")
        return f"{found} by multiple scales, {self.in_range.sum()} of them in range"

    def _scope(self) -> list[str]:
        error = float(self.error_estimate.max(initial=0.0))
        return [f"t: {span(self.t)}; {', '.join(self.dof_names)}; estimated error {error:.1e}"]

    @cached_property
    def coordinate_errors(self) -> FloatArray:
        """Estimated error of each coordinate, shape (n, n_dof).

        It is the size of the correction that follows from the residual of the full equations. It
        is computed on first access.
        """
        return self._errors()

    @property
    def error_estimate(self) -> FloatArray:
        """Largest ``coordinate_errors`` of all coordinates, shape (n,)."""
        return np.asarray(self.coordinate_errors.max(axis=1))

    @property
    def in_range(self) -> npt.NDArray[np.bool_]:
        """True if the orders decrease and the error is small relative to the motion, shape (n,)."""
        largest = np.maximum.accumulate(self.order_sizes[:, 0])
        fall = falling(self.order_sizes) <= LEAST_FALL
        error = (self.coordinate_errors / self._units).max(axis=1)
        return np.asarray(fall & (error <= LEAST_FALL * largest))

    def to_dataset(self) -> Dataset:
        """Return all data as an xarray Dataset over t."""
        names = [text for name in self.dof_names for text in (name, f"{name}'")]
        return as_dataset(
            {
                "state": (("t", "component"), self.state),
                "amplitude": (("t", "mode"), self.modulation.amplitude),
                "order_sizes": (("t", "order"), self.order_sizes),
                "coordinate_errors": (("t", "dof"), self.coordinate_errors),
                "error_estimate": ("t", self.error_estimate),
                "in_range": ("t", self.in_range),
            },
            coords={
                "t": self.t,
                "component": names,
                "dof": list(self.dof_names),
                "order": [1, 2, 3],
            },
            attrs={"plan": str(self.plan)},
        )


@dataclass(frozen=True, eq=False, repr=False)
class ScalesResponse(Result):
    """Steady motions, one per point; several may belong to one value.

    Attributes
    ----------
    parameter : str
        Parameter that varies.
    values : ndarray, shape (n_values,)
    index : ndarray of int, shape (n,)
        Index of the value of each point; for one value smaller motions come first.
    amplitudes : complex ndarray, shape (n, n_modes)
        A_j; mode j moves as Re A_j exp(i frequencies_j t).
    frequencies : ndarray, shape (n, n_modes)
    eigenvalues : complex ndarray, shape (n, 2 n_modes)
        Eigenvalues of the modulation equations.
    harmonics : complex ndarray, shape (n, n_dof)
        Harmonic of the varied load's frequency in each coordinate, u = Re X exp(i p t), including
        terms of third order.
    order_sizes : ndarray, shape (n, 3)
        Upper bounds of the terms of each order, as in `ScalesMotion`.
    left_out : ndarray, shape (n,)
        Largest influence of a near-resonant term that is not part of the modulation equations: its
        coupling times the amplitudes, divided by its divisor. It is usually below 0.05. It is
        larger if its frequency does not fit and no beating motion was found. It includes 0.6 times
        the influence of terms farther from a mode than half of its frequency.
    resting_growth : ndarray, shape (n,)
        Growth of modes at rest by terms that are not part of the modulation equations: terms of
        fourth order (as at 3 p ~ 2 w1), and under large motions terms whose frequency is farther
        from the mode than half of its own. -inf without such a condition.
    n_beats : ndarray of int, shape (n,)
        Number of incommensurate beat frequencies of the amplitudes; 0 for a steady motion. For
        beating motions ``amplitudes`` are root mean squares and ``eigenvalues`` mean growth rates;
        ``beating`` returns the lines.
    may_lack : ndarray of bool, shape (n_values,)
        True for values at which a subharmonic or superharmonic motion may be missing: a load could
        sustain it, but its frequency contradicts terms that are part of the modulation equations.
    plan : Plan
        What was computed, and what was skipped and why.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> body = vv.Pendulum(
    ...     e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01, f0=0.002, p1=1.02
    ... )
    >>> steady = vv.MultipleScales(body).response("p1", np.linspace(1.0, 1.05, 20))
    >>> sizes = steady.amplitude("z")[steady.in_range]
    """

    parameter: str
    values: FloatArray
    index: npt.NDArray[np.int32]
    amplitudes: ComplexArray
    frequencies: FloatArray
    eigenvalues: ComplexArray
    harmonics: ComplexArray
    order_sizes: FloatArray
    left_out: FloatArray
    resting_growth: FloatArray
    n_beats: npt.NDArray[np.int32]
    may_lack: npt.NDArray[np.bool_]
    dof_names: tuple[str, ...]
    plan: Plan
    _errors: Callable[[], tuple[FloatArray, FloatArray, FloatArray]] = field(repr=False)
    #: As in `ScalesMotion`.
    _units: FloatArray = field(repr=False)
    #: Beating motions: point of each line, frequencies, X.
    _lines: tuple[npt.NDArray[np.int32], FloatArray, ComplexArray] = field(repr=False)
    #: Frequencies of the loads.
    _loads: dict[str, float] = field(repr=False)
    #: Function for the growth of neighbours of a motion by the full equations, and its error.
    _perturbed: Callable[[float, FloatArray, ComplexArray, FloatArray], tuple[float, float]] = (
        field(repr=False)
    )
    _varied: str = field(repr=False)

    kind = "multiple_scales"
    _form = "steady"

    @property
    def complete(self) -> bool:  # type: ignore[override]
        """True if every value has a steady motion and ``may_lack`` is False everywhere."""
        return bool(np.unique(self.index).size == self.values.size and not self.may_lack.any())

    def _headline(self) -> str:
        return (
            f"{things(self.index.size, 'steady motion')} at {things(self.values.size, 'value')}, "
            f"{self.stable.sum()} of them stable"
        )

    def _scope(self) -> list[str]:
        return [f"{self.parameter}: {span(self.values)}; {', '.join(self.dof_names)}"]

    def _details(self) -> list[str]:
        outside = int((~self.in_range).sum())
        unsure = int((~self.decided & self.in_range).sum())
        lines = [f"{outside} of them are outside the range of the expansion"] if outside else []
        if self.beating_points.size:
            lines.append(f"{self.beating_points.size} of them beat (quasi-periodic)")
        if self.may_lack.any():
            count = things(int(self.may_lack.sum()), "value")
            lines.append(f"subharmonic or superharmonic motions may be missing at {count}")
        if unsure:
            lines.append(f"the stability of {unsure} of them is not decided by this expansion")
        return lines

    @property
    def beating_points(self) -> npt.NDArray[np.intp]:
        """Points with beating amplitudes."""
        return np.flatnonzero(np.isin(np.arange(self.index.size), self._lines[0]))

    def beating(self, point: int) -> BeatingMotion:
        """Return the lines of a beating motion with its mean, rms and largest value.

        If the modulation equations do not decide its stability, the full equations of a Pendulum or
        a CubicSystem are integrated.
        """
        i = _native.integer("point", point, 0, self.index.size - 1)
        of, frequencies, lines = self._lines
        which = of == i
        if not which.any():
            raise InputError(f"point = {i}: is a steady motion, must be one of beating_points")
        value = float(self.at[i])
        loads = self._loads | ({self._varied: value} if self._varied else {})
        errors = self.motion_errors[i].copy()
        waves = np.ascontiguousarray(lines[which])
        growth, growth_error = float(self._growth[i]), float(self.growth_error[i])
        if abs(growth) <= growth_error:
            exact = self._perturbed(value, frequencies[which], waves, errors)
            if exact[1] < growth_error:
                growth, growth_error = exact
        return BeatingMotion(
            value=value,
            n_beats=int(self.n_beats[i]),
            frequencies=frequencies[which],
            harmonics=waves,
            errors=errors,
            growth=growth,
            growth_error=growth_error,
            loads=loads,
            dof_names=self.dof_names,
        )

    @cached_property
    def _all_errors(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self._errors()

    @property
    def harmonic_errors(self) -> FloatArray:
        """Estimated error |change of X| of ``harmonics``, shape (n, n_dof).

        It is the size of the correction that follows from the residual of the full equations. It
        is computed on first access.
        """
        return self._all_errors[0]

    @property
    def motion_errors(self) -> FloatArray:
        """Estimated error summed over all frequencies of the motion, shape (n, n_dof)."""
        return self._all_errors[1]

    @property
    def growth_error(self) -> FloatArray:
        """Estimated error of the largest growth, whose sign is ``stable``, shape (n,).

        Neglected terms of fourth order and above change a motion by its ``motion_errors`` e, and
        eigenvalues by 8 max|eigenvalue| e divided by the size of the motion. Modes at rest also
        have the effect of the next order on their growth.
        """
        return self._all_errors[2]

    @property
    def decided(self) -> npt.NDArray[np.bool_]:
        """True if the growth exceeds its error, so that ``stable`` is certain, shape (n,).

        Otherwise use Floquet multipliers: ``trace_response(...).stable``.
        """
        return np.asarray(np.abs(self._growth) > self.growth_error)

    @property
    def error_estimate(self) -> FloatArray:
        """Largest ``harmonic_errors`` of all coordinates, shape (n,)."""
        return np.asarray(self.harmonic_errors.max(axis=1))

    @property
    def in_range(self) -> npt.NDArray[np.bool_]:
        """True if the orders decrease and the error is small relative to the motion, shape (n,)."""
        error = (self.motion_errors / self._units).max(axis=1)
        return np.asarray(
            (falling(self.order_sizes) <= LEAST_FALL)
            & (self.left_out <= LEAST_FALL)
            & (error <= LEAST_FALL * self.order_sizes[:, 0])
        )

    @property
    def at(self) -> FloatArray:
        """Parameter value of each point, shape (n,)."""
        return self.values[self.index]

    @property
    def stable(self) -> npt.NDArray[np.bool_]:
        """True if no perturbation grows, by eigenvalues and by terms of fourth order, shape (n,).

        ``decided`` states whether neglected orders could change this.
        """
        return np.asarray(self._growth <= _NEUTRAL * self.frequencies.max(axis=1))

    @property
    def _growth(self) -> FloatArray:
        return np.asarray(np.maximum(self.eigenvalues.real.max(axis=1), self.resting_growth))

    def amplitude(self, dof: str) -> FloatArray:
        """Size of the first harmonic of a coordinate, shape (n,)."""
        d = self.dof_names.index(_native.choice("dof", dof, self.dof_names))
        return np.abs(self.harmonics[:, d])

    def routh_hurwitz(self, point: int) -> FloatArray:
        """First column of Routh's table of the characteristic polynomial at a point.

        All of one sign: stable. Shape (2 n_modes + 1,); NaN after a zero, where the table ends.
        """
        i = _native.integer("point", point, 0, self.index.size - 1)
        scale = float(np.abs(self.eigenvalues[i]).max()) or 1.0
        polynomial = np.poly(self.eigenvalues[i] / scale).real
        width = polynomial.size // 2 + 1
        rows = np.zeros((2, width))
        rows[0, : polynomial[::2].size] = polynomial[::2]
        rows[1, : polynomial[1::2].size] = polynomial[1::2]
        column = np.full(polynomial.size, np.nan)
        column[0] = rows[0, 0]
        for k in range(1, polynomial.size):
            column[k] = rows[1, 0]
            if abs(rows[1, 0]) < 1e-14:
                break
            below = rows[0] - rows[0, 0] / rows[1, 0] * rows[1]
            rows = np.array([rows[1], np.append(below[1:], 0.0)])
        return column

    def to_dataset(self) -> Dataset:
        """Return all data as an xarray Dataset over the points."""
        return as_dataset(
            {
                self.parameter: ("point", self.at),
                "amplitudes": (("point", "mode"), self.amplitudes),
                "eigenvalues": (("point", "eigenvalue"), self.eigenvalues),
                "harmonics": (("point", "dof"), self.harmonics),
                "stable": ("point", self.stable),
                "n_beats": ("point", self.n_beats),
                "growth_error": ("point", self.growth_error),
                "error_estimate": ("point", self.error_estimate),
                "in_range": ("point", self.in_range),
            },
            coords={"dof": list(self.dof_names)},
            attrs={"plan": str(self.plan)},
        )

    def _table(self, coordinates: Sequence[str] | None) -> Table:
        table = Table(
            [NOTES["scales"], NOTES["scales_columns"]],
            {self.parameter: self.at, "stable": self.stable, "beats": self.n_beats},
        )
        for d in wanted_places(coordinates, self.dof_names):
            table.add_complex(self.dof_names[d], self.harmonics[:, d])
        for j in range(self.amplitudes.shape[1]):
            own = self.amplitudes[:, j]
            table.columns[f"mode_{j + 1}"] = np.hypot(own.real, own.imag)
        table.columns["growth"] = self._growth
        table.columns["growth_error"] = self.growth_error
        for k in range(3):
            table.columns[f"order_{k + 1}"] = self.order_sizes[:, k]
        table.columns["error_estimate"] = self.error_estimate
        return table

    def nearest(self, value: float) -> npt.NDArray[np.intp]:
        """Points that belong to the value nearest to ``value``."""
        wanted = _native.number("value", value)
        if not self.index.size:
            raise InputError(f"value = {wanted:g}: the response has no points")
        return np.flatnonzero(self.index == np.abs(self.values - wanted).argmin())
