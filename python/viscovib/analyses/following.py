"""Branches of periodic solutions: continuation through folds, with stability."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.analyses.starts import Start, StartLike, start_of
from viscovib.analyses.steady import condensed_line, falling, prepare
from viscovib.bodies.body import Body
from viscovib.bodies.varying_body import varied_body
from viscovib.common.motion_stability import Stability, hanging, truncated_crossings
from viscovib.common.parameters import (
    MAX_HARMONICS,
    OPPOSITE,
    STABILITY,
    SYMMETRIC,
    CurveOptions,
)
from viscovib.common.plan import Plan
from viscovib.errors import ConvergenceWarning, InputError, caller
from viscovib.results.branch import Branch
from viscovib.results.curves import (
    OUTCOMES,
    BranchPoint,
    Crossing,
    check_departure,
    checked_stops,
    located_branch_points,
    located_crossings,
    range_of,
)
from viscovib.results.dissipation import Parts
from viscovib.results.structure_results import StructureBranch
from viscovib.results.structure_view import View
from viscovib.systems.law_ends import edges_text
from viscovib.systems.load import Job, LoadLike, base_shifts
from viscovib.systems.oscillators import Steady, check_steady, refuse_turning
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.sticking import advice_on_sticking
from viscovib.systems.stiffness_ratio import advice_on_springs
from viscovib.systems.structure import Structure
from viscovib.systems.system import turned
from viscovib.systems.varying import Varied, varied
from viscovib.systems.varying_structure import varied_structure
from viscovib.systems.whole import in_all_coordinates

#: Largest array size of all points together.
_MAX_NUMBERS = 4e8


@dataclass(frozen=True)
class _Way:
    """The varied parameter of a branch and its range.

    ``fixed`` is the frequency if it does not vary; ``numbers`` maps a parameter of the system to
    the vector of the core.
    """

    argument: str
    varies: str
    start: float
    finish: float
    fixed: float
    numbers: Varied | None
    #: The system with this vector.
    system: Steady

    @classmethod
    def checked(
        cls,
        system: Steady,
        ranges: dict[str, tuple[float, float] | None],
        nu: float | None,
        vary: str | None,
        load: LoadLike | None,
        base: LoadLike | None,
    ) -> _Way:
        """Check the arguments."""
        given = [name for name, ends in ranges.items() if ends is not None]
        if len(given) != 1:
            raise InputError("nu_range, load_range or vary_range: give exactly one of them")
        if (given[0] == "nu_range") != (nu is None):
            raise InputError(
                "nu: must be given with load_range or vary_range, and not without them"
            )
        if (given[0] == "vary_range") != (vary is not None):
            raise InputError("vary: must be given with vary_range, and not without it")
        start, finish = range_of(given[0], ranges[given[0]])
        varies = {"nu_range": "nu", "load_range": "load_factor"}.get(given[0], "")
        numbers = None
        if vary is not None:
            if isinstance(system, Structure):
                numbers, system = varied_structure(system, vary, start, finish, load, base)
            else:
                refuse_turning(system, "a parameter that varies")
                if isinstance(system, Body):
                    numbers = varied_body(system, vary, start, finish)
                else:
                    numbers = varied(system, vary, start, finish)
            varies = numbers[0]
        if varies == "nu" and min(start, finish) <= 0:
            raise InputError(f"nu_range = ({start:g}, {finish:g}): must be greater than 0")
        fixed = start if nu is None else _native.number("nu", nu)
        return cls(given[0], varies, start, finish, fixed, numbers, system)

    def along(self, job: Job) -> Job:
        """Return system and load with the varied parameter for tasks."""
        job = job.along(varies=self.varies, at_nu=self.fixed)
        if self.numbers is None:
            return job
        return job.along(flat=self.numbers.rest, direction=self.numbers.direction)

    def nu(self, values: FloatArray) -> FloatArray:
        """Frequencies at values of the parameter."""
        return values if self.varies == "nu" else self.fixed * np.ones(values.size)

    def factors(self, values: FloatArray) -> FloatArray:
        """Factors of the load at values of the parameter."""
        return values if self.varies == "load_factor" else np.ones(values.size)


@dataclass(frozen=True)
class _Shown:
    """Conversion of unknowns of the core to absolute motions of the requested coordinates."""

    system: Steady
    way: _Way
    job: Job
    orders: npt.NDArray[np.int32]
    #: For a structure: the coordinates of the result.
    view: View | None

    def absolute(self, relative: ComplexArray, at: FloatArray) -> ComplexArray:
        """Motions of the coordinates of the core, shape (n, n_dof, n_orders)."""
        if self.view is not None:
            return np.ascontiguousarray(relative.T)
        direction = self.system._base_direction
        return _absolute(relative.T, direction, self.job, self.orders, self.way.factors(at))

    def motions(self, relative: ComplexArray, at: FloatArray) -> ComplexArray:
        """Motions in the coordinates of the result."""
        if self.view is None:
            return self.absolute(relative, at)
        return self.view.expand(self.way.nu(at), self.orders, relative.T, self.way.factors(at))

    def directions(self, relative: ComplexArray, at: FloatArray) -> ComplexArray:
        """Differences of motions in the coordinates of the result."""
        if self.view is None:
            return np.ascontiguousarray(relative.T)
        return self.view.expand(self.way.nu(at), self.orders, relative.T, np.zeros(at.size))


def trace_mount(
    system: Steady,
    nu_range: tuple[float, float] | None,
    *,
    load: LoadLike | None,
    base: LoadLike | None,
    nu: float | None,
    load_range: tuple[float, float] | None,
    vary: str | None,
    vary_range: tuple[float, float] | None,
    at: npt.ArrayLike,
    start: StartLike | None,
    leave: BranchPoint | None,
    opposite: bool,
    symmetric: bool | None,
    harmonics: int | str,
    stability: bool,
    coordinates: Sequence[str] | None,
    **options: Any,
) -> Branch:
    """`trace_response` of a mount, a polynomial system or a structure."""
    ranges = {"nu_range": nu_range, "load_range": load_range, "vary_range": vary_range}
    check_steady(system, base)
    if nu is not None:
        system = turned(system, nu)
    system = in_all_coordinates(system, base)
    way = _Way.checked(system, ranges, nu, vary, load, base)
    system = way.system
    stops = checked_stops(at, way.varies, way.start, way.finish)
    assessed = STABILITY.check(stability)
    keeps = symmetric is None or SYMMETRIC.check(symmetric)
    begun: Start | None = None
    if start is not None:
        if leave is not None:
            raise InputError("start: must not be given with leave, which determines the start")
        begun = start_of(start, system.dof_names, way.fixed)
        keeps = keeps and not (symmetric is None and begun.has_even)
    curve = CurveOptions.checked(options)
    job, nu_fixed, prepared, loaded = prepare(
        system, [way.fixed], load, base, "newton", harmonics,
        (curve.tolerance, curve.values["atol"]), 100, 1.0, assessed,
        flat=None if way.numbers is None else way.numbers.at(way.start),
        whole=way.numbers is not None,
    )  # fmt: skip
    if loaded is None and coordinates is not None:
        raise InputError("coordinates: can be chosen for a structure only, must be None")
    options = {**prepared, "stability": False, "nu": nu_fixed}
    options |= {"keep_idle": True, "on_branch": True, "symmetric": keeps}
    begin: dict[str, Any] = {}
    many = curve.max_points > _most_points(job.n_dof, MAX_HARMONICS + 1)
    if many or leave is not None or begun is not None:
        orders = job.run("response plan", **options)["kept"]
        _check_size(curve.max_points, job.n_dof, orders.size)
        begin = _begin(system, way, job, loaded, orders, leave, opposite, begun)
    along = way.along(job)
    found = along.run_long(
        "branch follow", **curve.along(way.start, way.finish, stops=stops),
        harmonics=prepared["harmonics"], symmetric=keeps, stability=assessed, **begin,
    )  # fmt: skip
    if not found and begun is not None:
        raise InputError(
            f"start: no solution was found near it at {way.varies} = {begin['begin_p']:g}"
        )
    if not found:
        raise InputError(
            f"{way.argument}: no solution was found at the start {way.start:g}: start at "
            f"another value{_advice(system)}"
        )
    view = None if loaded is None else View.of(system, loaded, coordinates)
    planned = partial(_plan, job, options, way, assessed, condensed_line(loaded))
    shown = _Shown(system, way, job, found["harmonics"], view)
    return _branch(found, shown, curve.tolerance, assessed, planned, along)


def _advice(system: Steady) -> str:
    """Return possible reasons why a branch does not begin or continue, with advice."""
    advice = edges_text(system) + advice_on_sticking(system)
    if isinstance(system, PolynomialSystem):
        advice += advice_on_springs(system._mass_matrix, system._stiffness_at_rest)
    return advice


def _plan(job: Job, options: dict[str, Any], way: _Way, assessed: bool, condensed: str) -> Plan:
    """Return the plan of a branch; ``options``: those of the plan of a response."""
    planned = job.run("response plan", **options)
    orders = planned["kept"]
    first = _native.run(
        "branch plan", name=way.varies.replace("load_factor", "load factor"), start=way.start,
        finish=way.finish, n_orders=orders.size if options["harmonics"] else 0,
        most=int(orders[-1]), stability=assessed,
    )["text"]  # fmt: skip
    return Plan(f"{first.strip()}\n{condensed}{planned['rest'].strip()}")


def _most_points(n_dof: int, m: int) -> int:
    """Largest number of points with m harmonics."""
    return int(_MAX_NUMBERS / (8 * m * n_dof + 8 * n_dof + 16))


def _check_size(points: int, n_dof: int, m: int) -> None:
    """Refuse more points than fit into memory."""
    most = _most_points(n_dof, m)
    if points > most:
        raise InputError(
            f"max_points = {points}: must be at most {most} with {n_dof} coordinates and {m} "
            "harmonics"
        )


def _begin(
    system: Steady,
    way: _Way,
    job: Job,
    loaded: Any,
    orders: npt.NDArray[np.int32],
    leave: BranchPoint | None,
    opposite: bool,
    begun: Start | None,
) -> dict[str, Any]:
    """Unknowns, parameter and direction of the first point; empty: start of the range."""
    n = 2 * orders.size * job.n_dof
    if leave is not None:
        check_departure(leave)
        begin, along = leave.departure(n, OPPOSITE.check(opposite))
        return {"begin": begin, "begin_p": leave.parameter, "along": along}
    if begun is None:
        return {}
    at = begun.place(way.varies, way.start, way.finish)
    factor = at if way.varies == "load_factor" else 1.0
    begin = begun.unknowns(orders, job, system._base_direction, factor, system.dof_names, loaded)
    return {"begin": begin, "begin_p": float(at), "along": np.zeros(n + 1)}


def _branch(
    found: dict[str, Any],
    shown: _Shown,
    tolerance: float,
    assessed_too: bool,
    planned: Callable[[], Plan],
    job: Job,
) -> Branch:
    """Create the result with names and units."""
    system, way, view = shown.system, shown.way, shown.view
    stability: Stability | None = None
    crossings: tuple[Crossing, ...] = ()
    if assessed_too:
        codes = found["stable"]
        stability = Stability.of(codes, found["multipliers"], found["exponents"])
        if (codes == -1).all() and not system._active_kernels:
            stability = None
        crossed = shown.motions(found["crossing_coefficients"], found["crossings"])
        crossings = located_crossings(found, crossed, codes < 0)
    values, places = found["p"], found["branch_points"]
    motions = shown.absolute(found["coefficients"], values)
    at_folds = shown.absolute(found["fold_coefficients"], found["folds"])
    names, units = system.dof_names, system.dof_units
    kind: Callable[..., Branch] = Branch
    if view is not None:
        names, units = view.names, view.units
        kind = partial(StructureBranch, _condensed=motions, _condensed_folds=at_folds, _view=view)
    branch = kind(
        nu=way.nu(values),
        load_factor=way.factors(values),
        harmonics=shown.orders,
        coefficients=motions,
        stable=stability.stable if stability else None,
        growing=found["growing"] if stability else None,
        multipliers=stability.multipliers if stability else None,
        exponents=stability.exponents if stability else None,
        slowest=stability.slowest if stability else None,
        folds=found["folds"],
        fold_errors=found["fold_errors"],
        fold_coefficients=at_folds,
        fold_coefficient_errors=found["fold_coefficient_errors"],
        branch_points=located_branch_points(
            found,
            shown.motions(found["branch_coefficients"], places),
            shown.directions(found["branch_directions"], places),
        ),
        crossings=crossings,
        stops=found["stops"] - 1,
        outcome=OUTCOMES[found["ended"]],
        iterations=found["iterations"],
        error=found["error"],
        varies=way.varies,
        parameter=values,
        highest=found["highest"],
        truncation=found["truncation"],
        dof_names=names,
        dof_units=units,
        _planned=planned,
        _job=job,
        _tolerance=tolerance,
        _allowed=found["allowed"],
        _off=found["off"],
        _missed=found["missed"],
        _parts=Parts(system, job.orders, job.series),
    )
    _warn_of_doubts(branch, motions, values)
    advice = ""
    if branch.outcome == "stuck":
        advice = _advice(system)
    if advice:
        warnings.warn(
            f"the branch ends at {way.varies} = {values[-1]:.6g}{advice}",
            ConvergenceWarning,
            stacklevel=caller(),
        )
    branch._warn_of_reduction()
    return branch


def _warn_of_doubts(branch: Branch, motions: ComplexArray, p: FloatArray) -> None:
    """Warn of points whose rounding or truncation error exceeds the tolerance."""
    stable, allowed, off, few = branch.stable, branch._allowed, branch._off, branch._few
    shown = branch._tolerance, branch.varies, p
    blurred = off > allowed
    if blurred.any():
        note = "the rounding error exceeds the tolerance"
        _warn_above(off, blurred, *shown, note, hanging(stable, blurred & ~few, "rounding decides"))
    if few.any():
        missed = np.where(few, branch._missed, 0)
        _warn_above(
            missed, few, *shown,
            f"harmonics up to {branch.harmonics[-1]} do not reach the tolerance",
            falling(motions[int(missed.argmax())])
            + hanging(stable, few)
            + truncated_crossings([c.before for c in branch.crossings], few),
        )  # fmt: skip


def _warn_above(
    errors: FloatArray,
    above: npt.NDArray[np.bool_],
    tolerance: float,
    varies: str,
    p: FloatArray,
    note: str,
    more: str,
) -> None:
    """Warn of points whose error is ``above`` the tolerance."""
    warnings.warn(
        f"at {above.sum()} of {errors.size} points {note} {tolerance:.1e}; worst at {varies} = "
        f"{p[errors.argmax()]:.6g}, with an estimated relative error of {errors.max():.1e}{more}",
        ConvergenceWarning,
        stacklevel=caller(),
    )


def _absolute(
    relative: ComplexArray,
    direction: FloatArray | None,
    job: Job,
    kept: npt.NDArray[np.int32],
    factors: FloatArray,
) -> ComplexArray:
    """Convert coordinates relative to the base to absolute coordinates."""
    result = np.ascontiguousarray(relative)
    for order, moved in base_shifts(job.orders, job.series, direction):
        for d in np.flatnonzero(moved):
            result[:, d, kept == order] += moved[d] * factors[:, np.newaxis]
    return result
