"""Common parts of all branches: points, bifurcation points, branch points."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.common.counts import things
from viscovib.common.parameters import CURVE_OUTCOMES
from viscovib.common.results import Number, Panel, Result, named, span
from viscovib.common.tables import listed
from viscovib.common.values import Value
from viscovib.errors import ConvergenceWarning, InputError, caller
from viscovib.results.response import Peak, band_of, lowest_order, only_rounding, peaks

OUTCOMES = CURVE_OUTCOMES
#: Kinds of bifurcation points, in the order of the core.
CROSSINGS = ("fold", "branch point", "symmetry breaking", "period doubling", "Neimark-Sacker")


@dataclass(frozen=True)
class Crossing:
    """A bifurcation point of a branch, between two of its points.

    ``kind`` is "fold", "branch point" (a multiplier 1 where the branch does not turn back),
    "symmetry breaking", "period doubling" or "Neimark-Sacker". ``before`` is the index of the last
    point before it. ``parameter`` and ``coefficients`` (shape (n_dof, m), not for the pendulum) are
    its location and motion; None if they were not found. ``sure`` is True if the stability of both
    neighbouring points is known. ``error`` estimates the error of ``parameter`` by neglected
    harmonics (from a balance with twice the harmonics), by the search and by rounding; inf if no
    such point exists nearby with twice the harmonics, None without ``parameter``.

    If ``sure`` is False, a multiplier is too close to the unit circle or there are too few
    harmonics. The crossing then belongs to the truncated motion; the converged motion may bifurcate
    at a different location or in a different way.

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
    >>> sorted({crossing.kind for crossing in branch.crossings})
    ['fold']
    """

    kind: str
    before: int
    parameter: float | None = None
    coefficients: ComplexArray | None = field(default=None, compare=False, repr=False)
    sure: bool = True
    error: float | None = None

    def __str__(self) -> str:
        """Return the kind and location, with points counted from 1."""
        place = "" if self.parameter is None else f" at {self.parameter:.15g}"
        if self.error is not None:
            place += f" (error {self.error:.1e})"
        unsure = "" if self.sure else " (not sure: stability of a neighbour is unknown)"
        return f"stability changes after point {self.before + 1}: {self.kind}{place}{unsure}"


def crossing_variables(crossings: Sequence[Crossing]) -> dict[str, Any]:
    """Return crossings as variables of a Dataset, without their motions; NaN: no location."""
    places = [np.nan if one.parameter is None else one.parameter for one in crossings]
    errors = [np.nan if one.error is None else one.error for one in crossings]
    return {
        "crossing_kind": ("crossing", np.array([one.kind for one in crossings], dtype="U17")),
        "crossing_before": ("crossing", np.array([one.before for one in crossings], dtype=int)),
        "crossing_parameter": ("crossing", np.array(places, dtype=float)),
        "crossing_error": ("crossing", np.array(errors, dtype=float)),
        "crossing_sure": ("crossing", np.array([one.sure for one in crossings], dtype=bool)),
    }


@dataclass(frozen=True, eq=False, repr=False)
class BranchPoint(Value):
    """A point at which a second branch crosses: parameter value, X_k, index of the point before.

    ``error`` estimates the error of the value, as for a `Crossing`. ``across`` is the direction of
    the second branch in X_k, the null vector of the derivatives. The second branch continues in
    both directions.

    Examples
    --------
    >>> import viscovib as vv
    >>> parametric = vv.PolynomialSystem(
    ...     mass=[1, 1],
    ...     stiffness=[[1, 0], [0, 0.25]],
    ...     damping=[0.05, 0.02],
    ...     forces={"x1": "0.5*x2^2", "x2": "x1*x2"},
    ... )
    >>> branch = vv.trace_response(parametric, (0.8, 1.2), load={1: [0.1, 0]})
    >>> points = branch.branch_points  # each may be given as leave=
    """

    parameter: float
    coefficients: ComplexArray
    before: int
    across: ComplexArray
    error: float
    #: The point as unknowns of the core, and the direction including the parameter.
    _unknowns: FloatArray
    _direction: FloatArray

    def departure(self, n: int, opposite: bool) -> tuple[FloatArray, FloatArray]:
        """Return the start point and direction of a branch with ``n`` unknowns."""
        _native.integer("n", n, 1, 2**31 - 1)
        if self._unknowns.size != n:
            raise InputError(
                f"leave: has {self._unknowns.size} unknowns, must have as many as this curve "
                f"({n}): use the same harmonics, loads and symmetry"
            )
        if not self._direction.any():
            raise InputError("leave: the direction of the bifurcating branch was not found")
        return self._unknowns, (-1 if opposite else 1) * self._direction


class Curve(Result):
    """Common parts of all branches: amplitudes and their peaks."""

    kind = "branch"
    _form = "branch"

    #: Branch points, with or without a change of stability; None: taken from the changes of
    #: stability.
    _crossed: tuple[BranchPoint, ...] | None = None

    @property
    def _circular(self) -> bool:
        """True if the parameter is a circular frequency, which can be shown in Hz."""
        return False

    coefficients: ComplexArray
    dof_names: tuple[str, ...]
    dof_units: tuple[str, ...]
    stable: npt.NDArray[Any] | None
    folds: FloatArray
    fold_coefficients: ComplexArray
    branch_points: tuple[BranchPoint, ...]
    outcome: str
    varies: str
    #: Values of the varied parameter.
    parameter: FloatArray

    @property
    def label(self) -> str:
        """Axis label of the parameter."""
        raise NotImplementedError

    def _place(self, dof: str, harmonic: int | tuple[int, ...]) -> tuple[int, int]:
        raise NotImplementedError

    @property
    def _orders(self) -> npt.NDArray[Any]:
        """Harmonics that are kept."""
        raise NotImplementedError

    def _motions(self) -> tuple[FloatArray, npt.NDArray[Any], ComplexArray]:
        """Frequencies, harmonic orders, and motions of shape (n, n_dof, m)."""
        raise NotImplementedError

    def _lacking(self) -> str:
        """Return a text about missing harmonics, or an empty text."""
        raise NotImplementedError

    @property
    def complete(self) -> bool:  # type: ignore[override]
        """True if the whole branch was followed with enough harmonics."""
        return self.outcome == "completed" and not self._lacking()

    def _headline(self) -> str:
        return (
            f"{self.outcome}, {things(self.parameter.size, 'point')}, "
            f"{things(self.folds.size, 'fold')}, "
            f"{things(len(self.branch_points), 'branch point')}{self._lacking()}"
        )

    def _scope(self) -> list[str]:
        unit = "rad/s" if self.varies == "nu" and "m" in self.dof_units else ""
        known = ""
        if self.stable is not None:
            known = f", stable at {things(np.sum(self.stable == True), 'point')}"  # noqa: E712
        return [
            f"{self.varies}: {span(self.parameter, unit)}; {named(self.dof_names, self.dof_units)}",
            f"{things(len(self._orders), 'harmonic')}{known}",
        ]

    def _details(self) -> list[str]:
        lines = [f"fold at {self.varies} = {fold:.10g}" for fold in self.folds]
        return lines + [
            f"branch point at {self.varies} = {point.parameter:.10g}"
            for point in self.branch_points
        ]

    def numbers(self) -> dict[str, Number]:
        """Return peaks ``peak_x``, their locations ``nu_peak_x``, ``folds`` and ``outcome``."""
        found = peaks(self, "rad/s" if "m" in self.dof_units else "")
        return found | {"folds": Number(self.folds.size), "outcome": Number(self.outcome)}

    def panels(self) -> list[Panel]:
        """Return the amplitudes of the lowest harmonic along the branch."""
        order = lowest_order(self._orders)
        return [
            Panel(self.parameter, self.amplitude(name, order), self.label, name, unit, order)
            for name, unit in zip(self.dof_names, self.dof_units, strict=True)
        ]

    def _pieces(self) -> tuple[int, str, str]:
        n = self.parameter.size
        return n, f"{things(n, 'point')} of {things(len(self._orders), 'harmonic')}", "point"

    def amplitude(self, dof: str, harmonic: int | tuple[int, ...] = 1) -> FloatArray:
        """Return the amplitude of a harmonic of a coordinate, shape (n,)."""
        d, j = self._place(dof, harmonic)
        return np.abs(self.coefficients[:, d, j])

    def peak(
        self,
        dof: str,
        harmonic: int | tuple[int, ...] = 1,
        *,
        band: tuple[float, float] | None = None,
    ) -> Peak:
        """Return the largest amplitude, also on overhanging parts, located between the points.

        A small component may have a resonance between two points. It is found if the derivatives at
        both points indicate it (for a structure along frequencies). ``band`` limits the search to a
        range of `parameter`. ``enclosed`` is False at an end of the branch or of the range, and if
        the component is 0 within the rounding error of the other components.
        """
        amplitude = self.amplitude(dof, harmonic)
        low, high = (-np.inf, np.inf) if band is None else band_of(band)
        inside = (self.parameter >= low) & (self.parameter <= high)
        if not inside.any():
            raise InputError(f"band = {band}: contains no point of the branch")
        i = int(np.where(inside, amplitude, -np.inf).argmax())
        ends = max(low, self.parameter.min()), min(high, self.parameter.max())
        place = float(self.parameter[i]), float(amplitude[i])
        summit = None
        if ends[0] < ends[1] and not only_rounding(amplitude[inside], self._motions()[2][inside]):
            d, j = self._place(dof, harmonic)
            found = [self._summit(i, d, j, *ends)]
            found += [self._summit_between(way, d, j) for way in one_way(self.parameter, inside)]
            summit = max((s for s in found if s), key=lambda s: s[1], default=None)
        if summit is None or summit[1] < place[1] * (1 - 1e-9):
            return Peak(*place, False)
        return Peak(*summit, True)

    def _summit(
        self, i: int, d: int, j: int, low: float, high: float
    ) -> tuple[float, float] | None:
        """Maximum that is reached uphill from the i-th point, or None if outside the bounds."""
        raise NotImplementedError

    def _summit_between(
        self, places: npt.NDArray[np.intp], d: int, j: int
    ) -> tuple[float, float] | None:
        """Largest maximum between points in ascending order of the parameter, or None.

        Step sizes follow the whole motion: a small component may have a resonance between points.
        """
        return None


def one_way(parameter: FloatArray, inside: npt.NDArray[np.bool_]) -> Iterator[npt.NDArray[np.intp]]:
    """Return the ascending index ranges of monotonic parameter, of 2 or more points each."""
    ways = np.sign(np.diff(parameter)) * (inside[1:] & inside[:-1])
    ends = np.flatnonzero(np.diff(ways)) + 1
    for part in np.split(np.arange(ways.size), ends):
        if part.size and ways[part[0]] != 0:
            places = np.append(part, part[-1] + 1)
            yield places if ways[part[0]] > 0 else places[::-1]


def fold_notes(kind: str, curve: Any) -> list[str]:
    """Return lines of a table: the outcome of a curve and its folds with their errors."""
    lines = [f"{kind} {curve.outcome}; folds at {curve.varies} ={listed(curve.folds)}"]
    if curve.folds.size:
        lines.append(f"estimated errors of these folds:{listed(curve.fold_errors)}")
    return lines


def rounding_text(off: FloatArray, allowed: FloatArray | float) -> str:
    """Return a text about points whose rounding error exceeds the tolerance, or an empty text."""
    blurred = int((off > allowed).sum())
    if not blurred:
        return ""
    return f", {things(blurred, 'point')} with a rounding error above the tolerance"


def allowed_nearby(coefficients: ComplexArray, tolerance: float, absolute: float) -> FloatArray:
    """Return the allowed relative error of motions (n, ...) from an absolute error."""
    sizes = np.abs(coefficients).reshape(coefficients.shape[0], -1).max(axis=1, initial=0.0)
    return np.asarray(tolerance + absolute / np.maximum(sizes, np.finfo(float).tiny))


def warn_of_rounding(off: FloatArray, tolerance: float, allowed: FloatArray | None = None) -> None:
    """Warn the caller of a public function about points whose rounding error exceeds the limit."""
    blurred = off > (tolerance if allowed is None else allowed)
    if blurred.any():
        warnings.warn(
            f"at {blurred.sum()} of {off.size} points the rounding error exceeds the tolerance "
            f"{tolerance:.1e}; the worst has an estimated relative error of {off.max():.1e}",
            ConvergenceWarning,
            stacklevel=caller(),
        )


def branch_notes(branch: Any) -> list[str]:
    """Return lines of a table: the outcome of the branch, its folds and bifurcation points."""
    at = branch.varies
    errors = (np.nan if one.error is None else one.error for one in branch.crossings)
    return [
        *fold_notes("branch", branch),
        *(
            f"stability changes after point {crossing.before + 1}: {crossing.kind}"
            + (
                f" at {at} ={listed([crossing.parameter])}"
                if crossing.parameter is not None
                else ""
            )
            for crossing in branch.crossings
        ),
        *([f"estimated errors of these changes:{listed(errors)}"] if branch.crossings else []),
    ]


def largest_order(coefficients: ComplexArray, harmonics: npt.NDArray[Any], d: int) -> int:
    """Return the index of the largest harmonic of a coordinate, without the mean."""
    first = int(not np.any(harmonics[0]))
    return first + int(np.abs(coefficients[:, d, first:]).max(axis=0).argmax())


def largest_panels(curve: Any, x: FloatArray, x_label: str) -> list[Panel]:
    """Return amplitudes along a curve, each of the largest harmonic.

    The lowest harmonic may be 0 if the motion has a longer period than the loads.
    """
    found = []
    for d, (name, unit) in enumerate(zip(curve.dof_names, curve.dof_units, strict=True)):
        order = int(curve.harmonics[largest_order(curve.coefficients, curve.harmonics, d)])
        found.append(Panel(x, curve.amplitude(name, order), x_label, name, unit, order))
    return found


def located_crossings(
    found: Mapping[str, Any], motions: ComplexArray, unknown: npt.NDArray[np.bool_] | None = None
) -> tuple[Crossing, ...]:
    """Create crossings from kinds, points before (from 1), locations (NaN: none), and errors.

    ``motions``: X_k at the crossings, shape (n, n_dof, m). ``unknown``: True for points of the
    branch with unknown stability.
    """
    crossings = []
    for kind, before, where, error, motion in zip(
        found["kinds"].tolist(), found["before"].tolist(), found["crossings"].tolist(),
        found["crossing_errors"].tolist(), motions, strict=True,
    ):  # fmt: skip
        last = before - 1
        sure = unknown is None or not unknown[last : last + 2].any()
        if math.isnan(where):
            crossings.append(Crossing(CROSSINGS[kind - 1], last, None, None, sure, None))
        else:
            crossings.append(Crossing(CROSSINGS[kind - 1], last, where, motion, sure, error))
    return tuple(crossings)


def located_branch_points(
    found: Mapping[str, Any], motions: ComplexArray, directions: ComplexArray
) -> tuple[BranchPoint, ...]:
    """Create branch points from parameter values, errors, points before (from 1) and unknowns.

    ``motions``, ``directions``: X_k at the points and of the crossing branches, (n, n_dof, m).
    """
    return tuple(
        BranchPoint(
            float(place),
            motions[i],
            int(found["branch_before"][i]) - 1,
            directions[i],
            float(found["branch_errors"][i]),
            found["branch_x"][:, i].copy(),
            found["across"][:, i].copy(),
        )
        for i, place in enumerate(found["branch_points"])
    )


def check_departure(leave: object) -> None:
    """Refuse a value that is not a branch point."""
    if not isinstance(leave, BranchPoint):
        raise InputError(f"leave = {_native.shown(leave)}: must be one of a branch's branch_points")


def checked_stops(at: npt.ArrayLike, varies: str, start: float, finish: float) -> FloatArray:
    """Return parameter values for points, all within the range."""
    stops = _native.real_array("at", at).reshape(-1)
    low, high = sorted((start, finish))
    beyond = stops[(stops < low) | (stops > high)]
    if beyond.size:
        raise InputError(
            f"at = {beyond[0]:g}: must be in [{low:g}, {high:g}], the range of {varies}"
        )
    return stops


def range_of(name: str, value: object) -> tuple[float, float]:
    """Return the ends of a range, two different numbers."""
    ends = _native.real_array(name, value)
    if ends.shape != (2,):
        raise InputError(f"{name}: must be two numbers, from and to, got shape {ends.shape}")
    if ends[0] == ends[1]:
        raise InputError(f"{name} = ({ends[0]:g}, {ends[1]:g}): must be two different numbers")
    return float(ends[0]), float(ends[1])
