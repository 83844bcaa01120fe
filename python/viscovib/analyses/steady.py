"""Steady forced response: amplitudes of every harmonic over a band of frequencies."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray, core
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
)
from viscovib.common.periodic_motions import power_of_fall
from viscovib.common.plan import Plan
from viscovib.common.progress import progress_bar
from viscovib.errors import ConvergenceWarning, InputError, caller
from viscovib.results.dissipation import Parts
from viscovib.results.response import Response
from viscovib.results.structure_results import StructureResponse
from viscovib.results.structure_view import View
from viscovib.systems.condensed import LoadedStructure
from viscovib.systems.law_ends import told_edges
from viscovib.systems.load import LoadLike
from viscovib.systems.oscillators import Steady, check_steady, oscillator_job, refuse_turning
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.sticking import advice_on_sticking

METHODS = ("linear", "successive", "newton")
OUTCOMES = np.array(["converged", "stalled", "diverged", "singular", "overflow", "stopped"])
#: Frequencies a native call takes at most: how often progress shows and Ctrl-C is heard.
CHUNK = 4096

#: Frequencies times unknowns squared that Newton's method takes without a thread of its own.
_LONG = 6400
#: Orders that a frequency takes as a rule where they are chosen.
_TYPICAL = 10
#: Powers from which on harmonics fall fast.
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
    job, frequencies, options, planned = _prepare(
        system, nu, load, base, method, harmonics, (tolerance, atol), max_iterations, relaxation,
        STABILITY.check(stability), may_choose=True,
    )  # fmt: skip
    PROGRESS.check(progress)
    chosen = _native.is_auto(harmonics) and planned.method != "linear"

    # Forces on the coordinates, and the base.
    n_dof = job[-1].shape[0] - 1
    # A matrix of the unknowns is factorized a few times a frequency.
    typical = _TYPICAL if chosen else planned.orders.size
    long = frequencies.size * (n_dof * typical) ** 2 > _LONG
    begin = np.zeros(1)
    if start is not None:
        begin = _begin(system, start, frequencies[0], job, planned)
    work = _Work(job, frequencies, options, planned, n_dof, long, bool(stability), begin)
    parts = work.run(progress)
    iterations = _joined(parts, 2)

    most = max(part[0].shape[2] for part in parts)
    given: dict[str, Any] = {
        "nu": frequencies,
        "harmonics": planned.orders[:most],
        "coefficients": np.concatenate([_widened(part[0], most) for part in parts]),
        "outcome": OUTCOMES[_joined(parts, 1)],
        "iterations": iterations,
        "rate": _joined(parts, 3),
        "highest": _joined(parts, 4),
        "truncation": _joined(parts, 5),
        "method": planned.method,
        "plan": planned.plan,
        "dof_names": system.dof_names,
        "dof_units": system.dof_units,
        "_work": work,
        "_job": job,
        "_tolerance": float(options[2][0]),
        "_allowed": _joined(parts, 10),
        "_parts": Parts(system, job[-2], job[-1]),
    }
    if stability:
        given |= _stability_of(parts, _joined(parts, 1) == 0)
    response: Response
    if planned.loaded is not None:
        linear = planned.method == "linear"
        loaded = planned.loaded.linear_part() if linear else planned.loaded
        view = View.of(system, loaded, coordinates)
        # What the core gives is absolute.
        own = given["coefficients"] - planned.loaded.base_motion(given["harmonics"])
        given |= {"dof_names": view.names, "dof_units": view.units}
        response = StructureResponse(**given, _condensed=own, _view=view)
        response._warn_of_reduction()
    else:
        if coordinates is not None:
            raise InputError("coordinates: can be chosen for a structure only, must be None")
        response = Response(**given)
    _warn_of_gaps(response, system)
    _warn_of_few_orders(response)
    return response


def _begin(
    system: Steady, start: StartLike, nu: float, job: tuple[Any, ...], planned: "_Plan"
) -> FloatArray:
    """Unknowns of a motion to begin at."""
    if planned.method != "newton":
        raise InputError("start: needs method = 'newton', and something that is nonlinear")
    begun = start_of(start, system.dof_names, nu)
    if begun.has_even and not (planned.orders % 2 == 0).any():
        raise InputError(
            "start: has even harmonics, which load and forces have not: see trace_response with "
            "symmetric=False"
        )
    return begun.unknowns(
        planned.orders, job, system._base_direction, 1.0, system.dof_names, planned.loaded
    )


def _stability_of(
    parts: list[tuple[Any, ...]], solved: npt.NDArray[np.bool_]
) -> dict[str, npt.NDArray[Any]]:
    """Stability of all motions, of which some may not have been found."""
    ((stable, multipliers, exponents),) = (part[7:10] for part in parts)
    return Stability.of(stable, multipliers, exponents, solved)._asdict()


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
    return _prepare(
        system, nu, load, base, method, harmonics, (tolerance, atol), max_iterations, relaxation,
        STABILITY.check(stability), may_choose=True,
    )[3].plan  # fmt: skip


class _Plan(NamedTuple):
    orders: npt.NDArray[np.int32]
    method: str
    plan: Plan
    #: Lines that hold for a branch too.
    rest: str
    loaded: LoadedStructure | None = None


@dataclass(frozen=True)
class _Work:
    """All that a run takes, so that it can be run again."""

    job: tuple[Any, ...]
    frequencies: FloatArray
    options: tuple[Any, ...]
    planned: _Plan
    n_dof: int
    #: Whether it takes so long that Ctrl-C must be heard on the way.
    long: bool
    stability: bool
    #: Unknowns of a motion to begin at; one number: none.
    begin: FloatArray

    def run(self, show: bool = False, n_history: int = 0) -> list[tuple[Any, ...]]:
        # Newton's method follows its branch from frequency to frequency, all in one piece.
        whole = self.planned.method == "newton"
        nu, n_dof = self.frequencies, self.n_dof
        size = nu.size if whole else max(CHUNK * 8 // max(n_dof, 2) ** 3, 1)
        cancel = np.zeros(1, dtype=np.intc)
        with progress_bar(nu.size, "nu", show) as bar:
            parts = []
            for start in range(0, nu.size, size):
                chunk = nu[start : start + size]
                # Memory that no order needs is never touched.
                room = np.empty(chunk.size * n_dof * self.planned.orders.size, dtype=complex)
                judged = chunk.size if self.stability else 0
                given = (
                    *self.job, chunk, *self.options, n_history, judged, self.begin, room, cancel
                )  # fmt: skip
                if whole and (self.long or self.stability):
                    part = _native.call_interruptibly(core.mount_response, cancel, *given)
                else:
                    part = _native.call(core.mount_response, *given)
                kept = room[: chunk.size * n_dof * part[0]].reshape(chunk.size, n_dof, part[0])
                parts.append((kept.copy(), *part[1:]))
                bar.update(chunk.size)
        return parts

    def corrections(self, longest: int) -> FloatArray:
        """Run again, and keep the size of each correction."""
        if not longest or self.planned.method == "newton":
            return np.empty((self.frequencies.size, 0))
        columns = [part[6][:longest] for part in self.run(n_history=self.options[3])]
        return np.concatenate(columns, axis=1).T


def _prepare(
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
    keep_idle: bool = False,
    may_choose: bool = False,
    flat: FloatArray | None = None,
    whole: bool = False,
    judged: bool = False,
) -> tuple[tuple[Any, ...], FloatArray, tuple[Any, ...], _Plan]:
    """Check everything and bring it into the form of the core.

    ``keep_idle``: take along coordinates that nothing moves; ``flat``: instead of the system's
    own numbers; ``whole``: do not condense a polynomial system;
    ``judged``: the stability of a branch is wanted.
    """
    check_steady(system, base)
    if isinstance(method, str) and method == "successive":
        refuse_turning(system, "the method of successive approximations")
    if nu is None:
        raise InputError("nu: must be given for a mount or a polynomial system")
    if all(term is None or (isinstance(term, Mapping) and not term) for term in (load, base)):
        raise InputError(
            "load or base: must be given (0 is allowed): without them every motion is 0"
        )
    frequencies = _native.real_array("nu", nu)
    if frequencies.ndim > 1:
        raise InputError(f"nu: must have 0 or 1 dimension(s), got shape {frequencies.shape}")
    frequencies = frequencies.reshape(-1)
    if not frequencies.size:
        raise InputError("nu: must not be empty")
    if frequencies.min() <= 0:
        raise InputError(f"nu = {frequencies.min():g}: must be greater than 0")
    fraction = 0.0
    if not _native.is_auto(relaxation):
        fraction = _native.number("relaxation", relaxation)
        if not 0 < fraction <= 1:
            raise InputError(f"relaxation = {fraction:g}: must be in (0, 1], or 'auto'")
    chosen = may_choose and isinstance(harmonics, str)
    if chosen and harmonics != "auto":
        raise InputError(f"harmonics = {harmonics!r}: must be an integer or 'auto'")
    judged = judged or stability
    if isinstance(method, str) and method == "linear" and isinstance(system, PolynomialSystem):
        # What condensing spares is nonlinear; on the way back it costs digits near antiresonances.
        whole = whole or system._may_be_whole
    job, loaded = oscillator_job(system, load, base, flat, whole=whole, stability=judged)
    options = (
        METHODS.index(_native.choice("method", method, METHODS)) + 1,
        0 if chosen else _native.integer("harmonics", harmonics, 1, MAX_HARMONICS),
        np.array([TOLERANCE.check(wanted[0]), ATOL.check(wanted[1])]),
        MAX_ITERATIONS.check(max_iterations),
        fraction,
    )
    n_kept, kept, _, _, ran, text, rest = _native.call(
        core.mount_plan, *job, frequencies, *options, 0, int(stability), int(keep_idle),
        max(job[-2].size, MAX_HARMONICS + 1),
    )  # fmt: skip
    words, lines = text.decode(), rest.decode()
    if loaded is not None:
        told = f"computes: {loaded.told}\n"
        words, lines = told + words, told + lines
    planned = _Plan(kept[:n_kept].copy(), METHODS[ran - 1], Plan(words), lines, loaded)
    return job, frequencies, options, planned


def _widened(coefficients: ComplexArray, n_orders: int) -> ComplexArray:
    """Add orders that were not kept: 0, or NaN where there is no solution."""
    lacking = n_orders - coefficients.shape[2]
    if not lacking:
        return coefficients
    more = np.where(np.isnan(coefficients[:, :, :1]), coefficients[:, :, :1], 0)
    return np.concatenate([coefficients, np.repeat(more, lacking, axis=2)], axis=2)


def _joined(parts: list[tuple[Any, ...]], index: int) -> npt.NDArray[Any]:
    return np.concatenate([part[index] for part in parts])


def _warn_of_gaps(response: Response, system: Steady) -> None:
    lost = ~response.converged
    if not lost.any():
        return
    asked = things(lost.size, "frequency", "frequencies")
    kinds = ", ".join(
        f"{count} {name}" for name in OUTCOMES[1:] if (count := (response.outcome == name).sum())
    )
    warnings.warn(
        f"{lost.sum()} of {asked} {'has' if lost.sum() == 1 else 'have'} no solution ({kinds}), "
        "between nu = "
        f"{response.nu[lost].min():.6g} and {response.nu[lost].max():.6g}; they hold NaN"
        f"{told_edges(system)}{advice_on_sticking(system)}",
        ConvergenceWarning,
        stacklevel=caller(),
    )


def falling(coefficients: ComplexArray) -> str:
    """Say how slowly harmonics of a motion fall, if that is slow."""
    power = power_of_fall(coefficients)
    if not power < _FAST:
        return ""
    return f"; harmonics there fall as k^-{power:.1f}"


def _warn_of_few_orders(response: Response) -> None:
    few = response.truncation > response._allowed
    if not few.any():
        return
    worst = int(np.nanargmax(np.where(few, response.truncation, 0)))
    motions = response._solved
    warnings.warn(
        f"at {few.sum()} of {things(few.size, 'frequency', 'frequencies')} the orders kept do "
        f"not reach the tolerance {response._tolerance:.1e}; worst at nu = "
        f"{response.nu[worst]:.6g}, where those up to {response.highest[worst]} "
        f"leave an estimated relative error of {response.truncation[worst]:.1e}"
        f"{falling(motions[worst])}{hanging(response.stable, few)}",
        ConvergenceWarning,
        stacklevel=caller(),
    )
