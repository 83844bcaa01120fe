"""Steady forced response: amplitudes of every harmonic over a band of frequencies."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray, Handle
from viscovib.analyses.direct_linear import DirectLinear, goes_directly
from viscovib.analyses.starts import StartLike, start_of
from viscovib.common.counts import things
from viscovib.common.motion_stability import Stability, hanging
from viscovib.common.parameters import (
    ATOL,
    MAX_HARMONICS,
    MAX_ITERATIONS,
    PROGRESS,
    STABILITY,
    TOLERANCE,
    for_recent_options,
)
from viscovib.common.periodic_motions import power_of_fall
from viscovib.common.plan import Plan
from viscovib.common.progress import progress_bar
from viscovib.errors import ConvergenceWarning, InputError, RangeWarning, caller
from viscovib.results.dissipation import Parts
from viscovib.results.response import Response
from viscovib.results.structure_results import StructureResponse
from viscovib.results.structure_view import View
from viscovib.systems.condensed import LoadedStructure
from viscovib.systems.law_ends import edges_text
from viscovib.systems.load import Job, LoadLike, for_recent_loads
from viscovib.systems.oscillators import Steady, check_steady, oscillator_job, refuse_turning
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.sticking import advice_on_sticking
from viscovib.systems.whole import in_all_coordinates

METHODS = ("linear", "successive", "newton", "auto")
OUTCOMES = np.array(["converged", "stalled", "diverged", "singular", "overflow", "stopped"])
#: Largest number of frequencies per native call, which sets the interval of progress and Ctrl-C.
CHUNK = 4096

#: Largest number of frequencies times unknowns squared without a separate thread, for Newton's
#: method and for successive approximations with polynomial forces.
_LONG, _LONG_POLYNOMIAL = 6400, 640000
#: Typical number of harmonics with automatic selection.
_TYPICAL = 10
#: Power from which on harmonics decrease fast.
_FAST = 8.0


def mount_response(
    system: Steady,
    nu: npt.ArrayLike | None,
    *,
    load: LoadLike | None,
    base: LoadLike | None,
    method: str,
    harmonics: int | str,
    tolerance: float,
    atol: float,
    max_iterations: int,
    relaxation: float | str,
    stability: bool,
    start: StartLike | None,
    coordinates: Sequence[str] | None,
    progress: bool,
) -> Response:
    """`forced_response` of a mount, a polynomial system or a structure."""
    asked = system
    system = in_all_coordinates(system, base)
    if start is not None and method == "auto":
        method = "newton"
    frequencies = _checked_frequencies(nu)
    request = _requested(
        system, load, base, method, harmonics, tolerance, atol, max_iterations, relaxation,
        stability, False,
    )  # fmt: skip
    job, options, loaded = request.job, request.options, request.loaded
    if method == "linear" and goes_directly(asked, base):
        request.direct = DirectLinear(asked, load, base)
    PROGRESS.check(progress)
    if coordinates is not None and loaded is None:
        raise InputError("coordinates: can be chosen for a structure only, must be None")
    work = _Work(request, frequencies)
    if start is not None:
        begin = _begin(system, start, job, work, frequencies[0])
        work = _Work(replace(request, options={**options, "start": begin}), frequencies)
    parts = work.run(progress)
    codes = _joined(parts, "outcomes")
    ran = parts[0]["method"]
    # The harmonics of each part are the first harmonics of the largest part.
    most = max((part["kept"] for part in parts), key=len)
    given: dict[str, Any] = {
        "nu": frequencies,
        "harmonics": most,
        "coefficients": _all_coefficients(parts, most.size),
        "outcome": OUTCOMES[codes],
        "iterations": _joined(parts, "iterations"),
        "rate": _joined(parts, "rate"),
        "highest": _joined(parts, "highest"),
        "truncation": _joined(parts, "truncation"),
        "method": ran,
        "_methods": np.array(METHODS)[parts[0]["methods"]] if ran == "auto" else None,
        "dof_names": system.dof_names,
        "dof_units": system.dof_units,
        "_work": work,
        "_planned": work.plan,
        "_job": job,
        "_tolerance": options["tolerance"],
        "_allowed": _joined(parts, "allowed"),
        "_parts": Parts(system, job.orders, job.series),
    }
    if stability:
        # Newton's method computes all frequencies in one call.
        (part,) = parts
        assessed = part["stable"], part["multipliers"], part["exponents"]
        given |= Stability.of(*assessed, codes == 0)._asdict()
    response: Response
    if loaded is not None:
        view = View.of(system, loaded.linear_part() if ran == "linear" else loaded, coordinates)
        # The core returns absolute motions.
        own = given["coefficients"] - loaded.base_motion(given["harmonics"])
        given |= {"dof_names": view.names, "dof_units": view.units}
        response = StructureResponse(**given, _condensed=own, _view=view)
        response._warn_of_reduction()
    else:
        response = Response(**given)
    if np.count_nonzero(codes):
        _warn_of_gaps(response, system)
    if "lacks_forces" in parts[0]:
        warnings.warn(
            "forces without a finite slope at rest are left out by method='linear', take 'auto'",
            RangeWarning,
            stacklevel=caller(),
        )
    _warn_of_few_orders(response)
    return response


def _begin(system: Steady, start: StartLike, job: Job, work: "_Work", nu: float) -> FloatArray:
    """Unknowns of the starting motion."""
    planned = work.planned()
    if planned["method"] != "newton":
        raise InputError("start: needs method = 'newton', and something that is nonlinear")
    begun = start_of(start, system.dof_names, nu)
    orders = planned["kept"]
    if begun.has_even and not (orders % 2 == 0).any():
        raise InputError(
            "start: has even harmonics, which load and forces have not: see trace_response with "
            "symmetric=False"
        )
    loaded = work.request.loaded
    return begun.unknowns(orders, job, system._base_direction, 1.0, system.dof_names, loaded)


def mount_plan(
    system: Steady,
    nu: npt.ArrayLike,
    *,
    load: LoadLike | None,
    base: LoadLike | None,
    method: str,
    harmonics: int | str,
    tolerance: float,
    atol: float,
    max_iterations: int,
    relaxation: float | str,
    stability: bool,
) -> Plan:
    """`plan_response` of a mount or a polynomial system."""
    system = in_all_coordinates(system, base)
    frequencies = _checked_frequencies(nu)
    request = _requested(
        system, load, base, method, harmonics, tolerance, atol, max_iterations, relaxation,
        stability, False,
    )  # fmt: skip
    return _Work(request, frequencies).plan()


@dataclass
class _Request:
    """The checked system, load and options of responses."""

    job: Job
    options: Mapping[str, Any]
    loaded: LoadedStructure | None
    #: All forces are polynomials.
    is_polynomial: bool
    #: Job and options as an object of the core, for repeated requests.
    kept: Handle | None = field(default=None, init=False)
    is_repeated: bool = field(default=False, init=False)
    #: Computes linear responses of many coordinates that depend on the speed.
    direct: DirectLinear | None = field(default=None, init=False)

    def solve(self, nu: FloatArray, **more: Any) -> dict[str, Any]:
        """Compute the responses at these frequencies; ``more``: further or other options."""
        if self.direct is not None:
            return self.direct(nu)
        if self.kept is None and self.is_repeated:
            self.kept = Handle("values", self.job.system, **self.job.given, **self.options)
        self.is_repeated = True
        if self.kept is None:
            return self.job.run("response solve", nu=nu, **{**self.options, **more})
        return _native.run("response solve", self.kept, nu=nu, **more)


@dataclass(frozen=True)
class _Work:
    """All data of a run, so that it can be repeated."""

    request: _Request
    frequencies: FloatArray

    def run(self, show: bool = False, **more: Any) -> list[dict[str, Any]]:
        if self.request.options["method"] in ("newton", "auto"):
            # Newton's method follows its branch from frequency to frequency in one call.
            return [self._whole(show, more)]
        nu, parts = self.frequencies, []
        size = max(CHUNK * 8 // max(self.request.job.n_dof, 2) ** 3, 1)
        if nu.size <= size and not show:
            return [self.request.solve(nu, **more)]
        with progress_bar(nu.size, "nu", show) as bar:
            for start in range(0, nu.size, size):
                chunk = nu[start : start + size]
                parts.append(self.request.solve(chunk, **more))
                bar.update(chunk.size)
        return parts

    def _whole(self, show: bool, more: dict[str, Any]) -> dict[str, Any]:
        # A matrix of the unknowns is factorized several times per frequency. Successive
        # approximations are faster.
        request, options, n = self.request, self.request.options, self.frequencies.size
        unknowns = request.job.n_dof * (options["harmonics"] or _TYPICAL)
        fast = options["method"] == "auto" and request.is_polynomial
        most = _LONG_POLYNOMIAL if fast else _LONG
        long = options["stability"] or n * unknowns**2 > most
        if not (long or show):
            return request.solve(self.frequencies, **more)
        with progress_bar(n, "nu", show) as bar:
            found = _native.interruptible(partial(request.solve, self.frequencies, **more))
            bar.update(n)
        return found

    def corrections(self, longest: int) -> FloatArray:
        """Run again, and return the size of each correction."""
        if not longest or self.request.options["method"] == "newton":
            return np.empty((self.frequencies.size, 0))
        columns = [part["corrections"][:longest] for part in self.run(history=True)]
        return np.concatenate(columns, axis=1).T

    def iterates(self, longest: int, orders: int) -> ComplexArray:
        """Run again with these harmonics, and return each iterate, shape (1 + longest, n, ...)."""
        solve = partial(
            self.request.solve, self.frequencies, method="successive", harmonics=orders,
            max_iterations=max(longest, 1), iterates=True,
        )  # fmt: skip
        return np.asarray(np.moveaxis(_native.interruptible(solve)["iterates"].T, 1, 0))

    def planned(self) -> dict[str, Any]:
        """Harmonics that may be kept, the selected method, and the text of the plan."""
        options = {name: one for name, one in self.request.options.items() if name != "start"}
        return self.request.job.run("response plan", nu=self.frequencies, **options)

    def plan(self) -> Plan:
        """The plan of the run."""
        return Plan(condensed_line(self.request.loaded) + self.planned()["text"])


def condensed_line(loaded: LoadedStructure | None) -> str:
    """Return the line of a plan about the condensation."""
    return "" if loaded is None else f"computes: {loaded.note}\n"


def prepare(
    system: Steady,
    nu: npt.ArrayLike | None,
    load: LoadLike | None,
    base: LoadLike | None,
    method: str,
    harmonics: int | str,
    wanted: tuple[float, float],
    max_iterations: int,
    relaxation: float | str,
    stability: bool = False,
    *,
    flat: FloatArray | None = None,
    whole: bool = False,
) -> tuple[Job, FloatArray, Mapping[str, Any], LoadedStructure | None]:
    """Check all arguments and convert them to the form of the core.

    ``flat``: replaces the vector of the system; ``whole``: do not condense a polynomial system.
    """
    frequencies = _checked_frequencies(nu)
    arguments = (load, base, method, harmonics, *wanted, max_iterations, relaxation, stability)
    if flat is None:
        request = _requested(system, *arguments, whole)
    else:
        request = _request_of(system, *arguments, whole, flat)
    return request.job, frequencies, request.options, request.loaded


def _checked_frequencies(nu: npt.ArrayLike | None) -> FloatArray:
    """Frequencies as a vector."""
    if nu is None:
        raise InputError("nu: must be given for a mount or a polynomial system")
    frequencies = _native.real_array("nu", nu)
    if frequencies.ndim > 1:
        raise InputError(f"nu: must have 0 or 1 dimension(s), got shape {frequencies.shape}")
    frequencies = frequencies.reshape(-1)
    if not frequencies.size:
        raise InputError("nu: must not be empty")
    if np.count_nonzero(frequencies > 0) < frequencies.size:
        raise InputError(f"nu = {frequencies.min():g}: must be greater than 0")
    return frequencies


def _request_of(
    system: Steady,
    load: LoadLike | None,
    base: LoadLike | None,
    method: str,
    harmonics: int | str,
    tolerance: float,
    atol: float,
    max_iterations: int,
    relaxation: float | str,
    stability: bool,
    whole: bool,
    flat: FloatArray | None = None,
) -> _Request:
    """Check system, load and options; ``whole`` and ``flat`` as for `prepare`."""
    check_steady(system, base)
    options = _checked_options(
        method, harmonics, tolerance, atol, max_iterations, relaxation, stability
    )
    if method == "successive":
        refuse_turning(system, "the method of successive approximations")
    if all(term is None or (isinstance(term, Mapping) and not term) for term in (load, base)):
        raise InputError(
            "load or base: must be given (0 is allowed): without them every motion is 0"
        )
    if method == "linear" and isinstance(system, PolynomialSystem):
        # Condensation only helps nonlinear problems; expansion loses digits near antiresonances.
        whole = whole or system._may_be_whole
    job, loaded = oscillator_job(system, load, base, flat, whole=whole, stability=stability)
    return _Request(job, options, loaded, not system._all_laws)


_requested = for_recent_loads(_request_of)


@for_recent_options
def _checked_options(
    method: str,
    harmonics: int | str,
    tolerance: float,
    atol: float,
    max_iterations: int,
    relaxation: float | str,
    stability: bool,
) -> Mapping[str, Any]:
    """Options in the form of the core."""
    _native.choice("method", method, METHODS)
    fraction = 0.0
    if not _native.is_auto(relaxation):
        fraction = _native.number("relaxation", relaxation)
        if not 0 < fraction <= 1:
            raise InputError(f"relaxation = {fraction:g}: must be in (0, 1], or 'auto'")
    if isinstance(harmonics, str) and harmonics != "auto":
        raise InputError(f"harmonics = {harmonics!r}: must be an integer or 'auto'")
    return {
        "method": method,
        "harmonics": 0
        if isinstance(harmonics, str)
        else _native.integer("harmonics", harmonics, 1, MAX_HARMONICS),
        "tolerance": TOLERANCE.check(tolerance),
        "atol": ATOL.check(atol),
        "max_iterations": MAX_ITERATIONS.check(max_iterations),
        "relaxation": fraction,
        "stability": STABILITY.check(stability),
    }


def _all_coefficients(parts: list[dict[str, Any]], n_orders: int) -> ComplexArray:
    """X_k of all parts, shape (n, n_dof, n_orders); harmonics that were not kept are 0 or NaN."""
    if len(parts) == 1:
        return np.asarray(parts[0]["coefficients"].T)
    return np.concatenate([_widened(part["coefficients"].T, n_orders) for part in parts])


def _widened(coefficients: ComplexArray, n_orders: int) -> ComplexArray:
    """Add harmonics that were not kept: 0, or NaN without a solution."""
    lacking = n_orders - coefficients.shape[2]
    if not lacking:
        return coefficients
    more = np.where(np.isnan(coefficients[:, :, :1]), coefficients[:, :, :1], 0)
    return np.concatenate([coefficients, np.repeat(more, lacking, axis=2)], axis=2)


def _joined(parts: list[dict[str, Any]], name: str) -> npt.NDArray[Any]:
    if len(parts) == 1:
        return np.asarray(parts[0][name])
    return np.concatenate([part[name] for part in parts])


def _warn_of_gaps(response: Response, system: Steady) -> None:
    unsolved = ~response.converged
    total = things(unsolved.size, "frequency", "frequencies")
    kinds = ", ".join(
        f"{count} {name}" for name in OUTCOMES[1:] if (count := (response.outcome == name).sum())
    )
    low, high = response.nu[unsolved].min(), response.nu[unsolved].max()
    found, remedy = _REMEDIES[response.methods[unsolved][0]]
    if (response.outcome[unsolved] == "overflow").all():
        remedy = "amplitudes are limited to 1e40, or less with high powers: choose other units"
    warnings.warn(
        f"{found} at {unsolved.sum()} of {total} ({kinds}), between nu = {low:.6g} and {high:.6g}, "
        f"NaN there: {remedy}{edges_text(system)}{advice_on_sticking(system)}",
        ConvergenceWarning,
        stacklevel=caller(),
    )


#: Reason for no solution, by method, and remedy.
_REMEDIES = {
    "linear": ("no finite linear response", "add damping to the system"),
    "successive": (
        "successive approximations do not converge",
        "use forced_response(..., method='auto'), which continues with Newton's method",
    ),
    "newton": (
        "Newton's method finds no motion",
        "use trace_response(system, nu_range, load=...), which follows the branch, or a larger "
        "tolerance=",
    ),
}


def falling(coefficients: ComplexArray) -> str:
    """Text on the decrease of the harmonics of a motion, if it is slow."""
    power = power_of_fall(coefficients)
    if not power < _FAST:
        return ""
    return f"; harmonics there fall as k^-{power:.1f}"


def _warn_of_few_orders(response: Response) -> None:
    few = response.truncation > response._allowed
    if not np.count_nonzero(few):
        return
    worst = int(np.nanargmax(np.where(few, response.truncation, 0)))
    motions = response._solved
    warnings.warn(
        f"at {few.sum()} of {things(few.size, 'frequency', 'frequencies')} the harmonics do "
        f"not reach the tolerance {response._tolerance:.1e}; worst at nu = "
        f"{response.nu[worst]:.6g}, with an estimated relative error of "
        f"{response.truncation[worst]:.1e} by neglected harmonics above "
        f"{response.highest[worst]}{falling(motions[worst])}{hanging(response.stable, few)}",
        ConvergenceWarning,
        stacklevel=caller(),
    )
