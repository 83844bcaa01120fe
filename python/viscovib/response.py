"""Steady forced response: amplitudes of every harmonic over a band of frequencies."""

import csv
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import xarray as xr
from tqdm import tqdm

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray, core
from viscovib.errors import ConvergenceWarning, InputError
from viscovib.files import whole_file
from viscovib.load import LoadLike, load_series
from viscovib.motion_stability import Stability, codes_of
from viscovib.oscillators import Oscillator, check_oscillator
from viscovib.plan import Plan, wanted_places

METHODS = ("linear", "successive", "newton")
OUTCOMES = np.array(["converged", "stalled", "diverged", "singular", "overflow", "stopped"])
#: Frequencies a native call takes at most: how often progress shows and Ctrl-C is heard.
CHUNK = 4096

_MAX_HARMONICS = 199
_MAX_ITERATIONS = 100_000
#: Unknowns of Newton's method, as in the core.
_MAX_UNKNOWNS = 2000
#: Frequencies times unknowns squared that Newton's method takes without a thread of its own.
_LONG = 6400
#: Multiplications up to which a peak is looked for between all frequencies.
_MAX_SEARCH = 3e9
#: Orders that a frequency takes as a rule where they are chosen.
_TYPICAL = 10


class Peak(NamedTuple):
    """Largest amplitude in a band."""

    nu: float
    amplitude: float
    #: False if no summit of the branch is larger: the largest of the motions, which stands at the
    #: edge of the band, beside a point that was not found, or where the branch was left.
    enclosed: bool


@dataclass(frozen=True, eq=False)
class Response:
    """Steady response u(t) = Im sum_k X_k exp(i k nu t).

    Attributes
    ----------
    nu : ndarray, shape (n,)
        Circular frequencies of the load (rad/s).
    harmonics : ndarray of int, shape (m,)
        Orders k kept, at any frequency.
    coefficients : ndarray, complex, shape (n, n_dof, m)
        X_k (m, rad); NaN where no solution was found, 0 for orders not kept at this frequency.
    outcome : ndarray of str, shape (n,)
        "converged", "stalled", "diverged", "singular" (undamped resonance) or "overflow"
        (parameters so extreme that the solution leaves the range of numbers).
    iterations : ndarray of int, shape (n,)
        Iterations made.
    rate : ndarray, shape (n,)
        Factor by which the last corrections shrank in an iteration.
    highest : ndarray of int, shape (n,)
        Highest order kept at each frequency; 0 where no solution was found.
    truncation : ndarray, shape (n,)
        Estimated relative error of leaving out higher orders; 0 for a linear response, which
        lacks none: the largest change of any order, by the residual of those left out and what
        they do to those kept, in the norm of ``tolerance``.
    method : str
        The method that ran.
    plan : Plan
        What was computed, what was skipped and why.
    stable : ndarray of bool, shape (n,), or None
        Whether each motion is stable; None: not asked for. Where that is unknown, or no solution
        was found, the array holds objects: True, False and None.
    multipliers, exponents : complex ndarray, shape (n, m), or None
        As in `Branch`; NaN where unknown.
    """

    nu: FloatArray
    harmonics: npt.NDArray[np.int32]
    coefficients: ComplexArray
    outcome: npt.NDArray[np.str_]
    iterations: npt.NDArray[np.int32]
    rate: FloatArray
    highest: npt.NDArray[np.int32]
    truncation: FloatArray
    method: str
    plan: Plan
    dof_names: tuple[str, ...]
    dof_units: tuple[str, ...]
    _history: Callable[[], FloatArray] = field(repr=False)
    #: System and load as the core takes them, and the relative error wanted.
    _job: tuple[Any, ...] = field(repr=False)
    _tolerance: float = field(repr=False)
    stable: npt.NDArray[Any] | None = None
    multipliers: ComplexArray | None = None
    exponents: ComplexArray | None = None

    @property
    def converged(self) -> npt.NDArray[np.bool_]:
        """Where a solution was found, shape (n,)."""
        return np.asarray(self.outcome == "converged")

    @cached_property
    def corrections(self) -> FloatArray:
        """Relative size of each correction, shape (n, iterations); NaN past the last.

        Not kept in the first run: the job is run again when this is first asked for. Newton's
        method keeps none, shape (n, 0).
        """
        return self._history()

    def coefficient(self, dof: int | str, harmonic: int = 1) -> ComplexArray:
        """X_k of one coordinate, shape (n,)."""
        where = np.flatnonzero(self.harmonics == harmonic) if np.isscalar(harmonic) else np.empty(0)
        if not where.size:
            kept = ", ".join(map(str, self.harmonics))
            raise InputError(
                f"harmonic = {_native.shown(harmonic)}: must be one of those kept ({kept})"
            )
        return self.coefficients[:, self._dof(dof), where[0]]

    def amplitude(self, dof: int | str, harmonic: int = 1) -> FloatArray:
        """|X_k| of one coordinate, shape (n,)."""
        return np.abs(self.coefficient(dof, harmonic))

    def phase(self, dof: int | str, harmonic: int = 1) -> FloatArray:
        """Phase of X_k (rad), in (-pi, pi], shape (n,)."""
        return np.angle(self.coefficient(dof, harmonic))

    def peak(
        self, dof: int | str, harmonic: int = 1, *, band: tuple[float, float] | None = None
    ) -> Peak:
        """Largest amplitude in a band of nu (default: all), solved for.

        Between motions whose slopes tell of a summit, the branch of one is followed to it: the
        amplitude holds to the tolerance, on coarse grids too. A jump is no summit, and motions
        beyond it belong to another branch: if the largest amplitude stands there, it is that of a
        motion found, and not ``enclosed``.
        """
        inside = self.converged
        if band is not None:
            low, high = band_of(band)
            inside = inside & (self.nu >= low) & (self.nu <= high)
        if not inside.any():
            raise InputError(f"band = {band}: holds no frequency with a solution")
        amplitude = self.amplitude(dof, harmonic)
        places = np.flatnonzero(inside)
        _, first = np.unique(self.nu[places], return_index=True)
        places = places[first]
        summit = None
        if places.size > 1:
            j = int(np.flatnonzero(self.harmonics == harmonic)[0])
            summit = self._summit(places, self._dof(dof), j)
        i = int(np.where(inside, amplitude, -1.0).argmax())
        if summit is None or summit[1] < amplitude[i]:
            return Peak(float(self.nu[i]), float(amplitude[i]), enclosed=False)
        return Peak(*summit, enclosed=True)

    def _summit(self, places: npt.NDArray[np.intp], d: int, j: int) -> tuple[float, float] | None:
        """Largest summit between motions at ascending frequencies, if there is one."""
        if self.method == "linear":
            return _linear_summit(self, places, d, j)
        highest = int(self.highest[places].max())
        kept = np.flatnonzero(self.harmonics <= highest)
        if j >= kept.size:
            return None
        unknowns = 2 * kept.size * len(self.dof_names)
        cancel = np.zeros(1, dtype=np.intc)
        at, size, found = _native.call_interruptibly(
            core.mount_peak, cancel, *self._job, 1, np.zeros(len(self._job[0])), self.nu[places[0]],
            self.harmonics[kept], 0, self._tolerance, self.nu[places],
            np.asfortranarray(self.coefficients[places][:, :, kept].T), d + 1, j + 1, 0.0, 0.0,
            int(places.size * unknowns**3 < _MAX_SEARCH), cancel,
        )  # fmt: skip
        return (at, size) if found else None

    def waveform(self, i: int, n: int = 256) -> tuple[FloatArray, FloatArray]:
        """One period at the i-th frequency: times (s), shape (n,), and u, shape (n, n_dof)."""
        point = _native.integer("i", i, -self.nu.size, self.nu.size - 1)
        count = _native.integer("n", n, 1, 10_000_000)
        t = 2 * np.pi / self.nu[point] * np.arange(count) / count
        waves = np.exp(1j * np.outer(t, self.harmonics * self.nu[point]))
        return t, (waves @ self.coefficients[point].T).imag

    def to_dataset(self) -> xr.Dataset:
        """Everything as an xarray Dataset with units."""
        dims = ("nu", "dof", "harmonic")
        return xr.Dataset(
            {
                "coefficients": (dims, self.coefficients, {"long_name": "X_k, m or rad"}),
                "amplitude": (dims, np.abs(self.coefficients), {"long_name": "|X_k|, m or rad"}),
                "outcome": ("nu", self.outcome),
                "iterations": ("nu", self.iterations),
                "rate": ("nu", self.rate),
                "highest": ("nu", self.highest, {"long_name": "highest order kept"}),
                "truncation": ("nu", self.truncation),
            },
            coords={
                "nu": ("nu", self.nu, {"units": "rad/s", "long_name": "circular frequency"}),
                "dof": ("dof", list(self.dof_names)),
                "unit": ("dof", list(self.dof_units)),
                "harmonic": ("harmonic", self.harmonics),
            },
            attrs={"method": self.method, "plan": str(self.plan)},
        ).assign(self._judged())

    def _judged(self) -> dict[str, Any]:
        """Stability for a Dataset; stable is 1, 0 or, where that is unknown, -1."""
        if self.stable is None:
            return {}
        return {
            "stable": ("nu", codes_of(self.stable)),
            "multipliers": (("nu", "multiplier"), self.multipliers),
            "exponents": (("nu", "multiplier"), self.exponents),
        }

    def to_csv(self, path: str | Path, *, coordinates: Sequence[str] | None = None) -> None:
        """Write the table that the standalone driver writes: one row a frequency.

        ``coordinates``: names of those wanted; all by default.
        """
        wanted = wanted_places(coordinates, self.dof_names)
        columns: dict[str, Any] = {
            "nu": self.nu,
            "outcome": self.outcome,
            "iterations": self.iterations,
            "rate": self.rate,
            "highest": self.highest,
            "truncation": self.truncation,
        }
        if self.stable is not None:
            columns["stable"] = codes_of(self.stable)
        for d in wanted:
            name = self.dof_names[d]
            for j, k in enumerate(self.harmonics):
                columns[f"{name}_{k}_re"] = self.coefficients[:, d, j].real
                columns[f"{name}_{k}_im"] = self.coefficients[:, d, j].imag
        units = ", ".join(
            f"{self.dof_names[d]}_k_re, {self.dof_names[d]}_k_im: X_k of {self.dof_names[d]} "
            f"({self.dof_units[d]})"
            for d in wanted
        )
        with whole_file(path) as file:
            file.write(f"# viscovib {version('viscovib')}\n{self.plan.comments()}")
            file.write("# nu: circular frequency of the load (rad/s); ")
            file.write("rate: factor between the last corrections; highest: order kept; ")
            file.write("truncation: estimated relative error of leaving out higher orders; ")
            file.write("u = Im sum_k X_k exp(i k nu t),\n")
            if self.stable is not None:
                file.write("# stable: 1: stable, 0: not, -1: unknown\n")
            file.write(f"# {units}; nan where no solution was found\n")
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            for row in zip(*columns.values(), strict=True):
                writer.writerow([f"{v:.16e}" if isinstance(v, float) else v for v in row])

    def _dof(self, dof: int | str) -> int:
        if isinstance(dof, str) and dof in self.dof_names:
            return self.dof_names.index(dof)
        if isinstance(dof, (int, np.integer)) and 0 <= dof < len(self.dof_names):
            return int(dof)
        names = ", ".join(f"{name!r} ({i})" for i, name in enumerate(self.dof_names))
        raise InputError(f"dof = {_native.shown(dof)}: must be one of {names}")


def forced_response(
    mount: Oscillator,
    nu: npt.ArrayLike,
    *,
    load: LoadLike | None = None,
    base: LoadLike | None = None,
    method: str = "successive",
    harmonics: int | str = "auto",
    tolerance: float = 1e-10,
    max_iterations: int = 200,
    relaxation: float | str = 1.0,
    stability: bool = False,
    progress: bool = False,
) -> Response:
    """Steady response of a system to a periodic load or motion of its base.

    Parameters
    ----------
    mount : Mount or PolynomialSystem
        The system.
    nu : array_like, shape (n,)
        Circular frequencies of the load (rad/s), each > 0, in any order.
    load : complex, array_like or mapping
        Force on the first coordinate (x, N): P sin(nu t); or a vector over the coordinates (of a
        mount: force on x, moment on phi); or a Fourier series {order: either}, f(t) = Im sum_k
        P_k exp(i k nu t), whose mean is the imaginary part of P_0. `fourier_coefficients` makes
        one from samples.
    base : complex or mapping
        Displacement of the supports (of a mount: in x, m), likewise. The response stays
        absolute. Viscous damping acts on the motion relative to the base.
    method : {"successive", "newton", "linear"}
        "linear": nonlinear terms left out; "successive": successive approximations from the
        linear response, which converge where the nonlinear force is small against the dynamic
        stiffness; "newton": Newton's method, which also passes resonances. There each frequency
        starts from the one before in the order given, as in a slow sweep: where several motions
        exist, upwards and downwards may give different ones. Where the branch ends, or at the
        first frequency, the load is raised from nothing. `trace_response` gives all of a branch.
    harmonics : int or "auto"
        Highest order kept (1 to 199); even orders and the mean are dropped when the load has
        none. "auto": as many as bring `Response.truncation` below ``tolerance``: with Newton's
        method those that each frequency needs, which is also fastest; with successive
        approximations the same at all of them, or at all of a part of a long list.
    tolerance : float
        Wanted relative error of the iteration, 1e-14 to 0.1.
    max_iterations : int
        Iterations a frequency, 1 to 100000.
    relaxation : float or "auto"
        Fraction of each correction that is taken, in (0, 1]; "auto": start with 1 and halve, up
        to four times, where the iteration does not converge.
    stability : bool
        Also say whether each motion is stable, by Floquet multipliers or, with memory, by Hill's
        determinant (method "newton" only): see `Branch`.
    progress : bool
        Show a progress bar.

    Returns
    -------
    Response

    Raises
    ------
    InputError
        Naming the argument, its value and what is allowed.

    Warns
    -----
    ConvergenceWarning
        If some frequencies have no solution; they hold NaN. If the orders kept do not bring
        `Response.truncation` below ``tolerance``.
    StabilityWarning
        If the stability of motions found is unknown.

    Notes
    -----
    Source: seed paper 001, (14)-(19), corrected (see the theory pages). Fixed point
    D(k nu) X_k = P_k - N_k(X) with the harmonics N_k of the nonlinear force from alias-free
    samples of a period.
    """
    job, frequencies, options, planned = _prepare(
        mount, nu, load, base, method, harmonics, tolerance, max_iterations, relaxation,
        bool(stability), may_choose=True,
    )  # fmt: skip
    chosen = harmonics == "auto" and planned.method != "linear"

    n_dof = len(mount.dof_names)
    # A matrix of the unknowns is factorized a few times a frequency.
    typical = _TYPICAL if chosen else planned.orders.size
    long = frequencies.size * (n_dof * typical) ** 2 > _LONG

    def run(n_history: int, show: bool) -> list[tuple[Any, ...]]:
        # Newton's method follows its branch from frequency to frequency, all in one piece.
        whole = planned.method == "newton"
        size = frequencies.size if whole else max(CHUNK * 8 // max(n_dof, 2) ** 3, 1)
        starts = range(0, frequencies.size, size)
        cancel = np.zeros(1, dtype=np.intc)
        with tqdm(total=frequencies.size, unit=" nu", disable=not show, leave=False) as bar:
            parts = []
            for start in starts:
                chunk = frequencies[start : start + size]
                # Memory that no order needs is never touched.
                room = np.empty(chunk.size * n_dof * planned.orders.size, dtype=complex)
                judged = chunk.size if stability else 0
                given = (*job, chunk, *options, n_history, judged, room, cancel)
                if whole and (long or stability):
                    part = _native.call_interruptibly(core.mount_response, cancel, *given)
                else:
                    part = _native.call(core.mount_response, *given)
                kept = room[: chunk.size * n_dof * part[0]].reshape(chunk.size, n_dof, part[0])
                parts.append((kept.copy(), *part[1:]))
                bar.update(chunk.size)
        return parts

    parts = run(0, progress)
    iterations = _joined(parts, 2)

    def history() -> FloatArray:
        longest = int(iterations.max(initial=0))
        if not longest or planned.method == "newton":
            return np.empty((frequencies.size, 0))
        columns = [part[6][:longest] for part in run(options[3], False)]
        return np.concatenate(columns, axis=1).T

    most = max(part[0].shape[2] for part in parts)
    response = Response(
        nu=frequencies,
        harmonics=planned.orders[:most],
        coefficients=np.concatenate([_widened(part[0], most) for part in parts]),
        outcome=OUTCOMES[_joined(parts, 1)],
        iterations=iterations,
        rate=_joined(parts, 3),
        highest=_joined(parts, 4),
        truncation=_joined(parts, 5),
        method=planned.method,
        plan=planned.plan,
        dof_names=mount.dof_names,
        dof_units=mount.dof_units,
        _history=history,
        _job=job,
        _tolerance=options[2],
        **_stability_of(parts, _joined(parts, 1) == 0) if stability else {},
    )
    _warn_of_gaps(response)
    _warn_of_few_orders(response, options[2])
    return response


def _stability_of(
    parts: list[tuple[Any, ...]], solved: npt.NDArray[np.bool_]
) -> dict[str, npt.NDArray[Any]]:
    """Stability of all motions, of which some may not have been found."""
    ((stable, multipliers, exponents),) = (part[7:10] for part in parts)
    return Stability.of(stable, multipliers, exponents, solved)._asdict()


def plan_response(
    mount: Oscillator,
    nu: npt.ArrayLike,
    *,
    load: LoadLike | None = None,
    base: LoadLike | None = None,
    method: str = "successive",
    harmonics: int | str = "auto",
    tolerance: float = 1e-10,
    max_iterations: int = 200,
    relaxation: float | str = 1.0,
    stability: bool = False,
) -> Plan:
    """Say what `forced_response` would compute and skip, and why; same arguments."""
    return _prepare(
        mount, nu, load, base, method, harmonics, tolerance, max_iterations, relaxation,
        bool(stability), may_choose=True,
    )[3].plan  # fmt: skip


class _Plan(NamedTuple):
    orders: npt.NDArray[np.int32]
    method: str
    plan: Plan
    #: Lines that hold for a branch too.
    rest: str


def _prepare(
    mount: Oscillator,
    nu: npt.ArrayLike,
    load: LoadLike | None,
    base: LoadLike | None,
    method: str,
    harmonics: int | str,
    tolerance: float,
    max_iterations: int,
    relaxation: float | str,
    stability: bool = False,
    *,
    keep_idle: bool = False,
    may_choose: bool = False,
    flat: FloatArray | None = None,
) -> tuple[tuple[Any, ...], FloatArray, tuple[Any, ...], _Plan]:
    """Check everything and bring it into the form of the core.

    ``keep_idle``: take along coordinates that nothing moves; ``flat``: instead of the system's
    own numbers.
    """
    check_oscillator(mount, base)
    if load is None and base is None:
        raise InputError(
            "load or base: must be given, as without them every motion is 0 (a load of 0 may be)"
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
    job = (
        mount._flat if flat is None else flat,
        *mount._kernels,
        *load_series(load, base, len(mount.dof_names)),
    )
    options = (
        METHODS.index(_native.choice("method", method, METHODS)) + 1,
        0 if chosen else _native.integer("harmonics", harmonics, 1, _MAX_HARMONICS),
        _native.number("tolerance", tolerance),
        _native.integer("max_iterations", max_iterations, 1, _MAX_ITERATIONS),
        fraction,
    )
    n_kept, kept, _, _, ran, text, rest = _native.call(
        core.mount_plan, *job, frequencies, *options, 0, int(stability), int(keep_idle)
    )
    planned = _Plan(kept[:n_kept].copy(), METHODS[ran - 1], Plan(text.decode()), rest.decode())
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


def band_of(band: object) -> tuple[float, float]:
    """From and to of a band."""
    try:
        low, high = map(float, band)  # type: ignore[call-overload]
    except (TypeError, ValueError):
        raise InputError(f"band = {_native.shown(band)}: must be two numbers") from None
    return low, high


def _linear_summit(
    response: Response, places: npt.NDArray[np.intp], d: int, j: int
) -> tuple[float, float] | None:
    """Of a linear response: each frequency is solved for, so that intervals shrink to a summit."""

    def sizes(nu: FloatArray) -> FloatArray:
        room = np.empty(nu.size * len(response.dof_names) * response.harmonics.size, dtype=complex)
        _native.call(
            core.mount_response, *response._job, nu, 1, 0, response._tolerance, 1, 1.0, 0, 0, room,
            np.zeros(1, dtype=np.intc),
        )  # fmt: skip
        shape = (nu.size, len(response.dof_names), response.harmonics.size)
        return np.abs(room.reshape(shape)[:, d, j])

    nu = response.nu[places]
    # Slopes at both ends of each interval tell whether it holds a summit.
    h = 1e-6 * np.diff(nu)
    from_left = sizes(nu[:-1] + h) > sizes(nu[:-1])
    from_right = sizes(nu[1:] - h) > sizes(nu[1:])
    held = np.flatnonzero(from_left & from_right)
    if not held.size:
        return None
    low, high = nu[held], nu[held + 1]
    for _ in range(60):
        inner = np.linspace(low, high, 9)
        top = np.nan_to_num(sizes(inner.ravel()).reshape(inner.shape), nan=np.inf).argmax(axis=0)
        low = np.take_along_axis(inner, np.maximum(top - 1, 0)[np.newaxis], 0)[0]
        high = np.take_along_axis(inner, np.minimum(top + 1, 8)[np.newaxis], 0)[0]
        if (high - low <= 1e-9 * high).all():
            break
    middle = 0.5 * (low + high)
    found = sizes(middle)
    best = int(np.nanargmax(found))
    return float(middle[best]), float(found[best])


def _warn_of_gaps(response: Response) -> None:
    lost = ~response.converged
    if not lost.any():
        return
    kinds = ", ".join(
        f"{count} {name}" for name in OUTCOMES[1:] if (count := (response.outcome == name).sum())
    )
    warnings.warn(
        f"{lost.sum()} of {lost.size} frequencies have no solution ({kinds}), between nu = "
        f"{response.nu[lost].min():.6g} and {response.nu[lost].max():.6g}; they hold NaN",
        ConvergenceWarning,
        stacklevel=3,
    )


def _warn_of_few_orders(response: Response, tolerance: float) -> None:
    few = response.truncation > tolerance
    if not few.any():
        return
    worst = int(np.nanargmax(response.truncation))
    warnings.warn(
        f"at {few.sum()} of {few.size} frequencies the orders kept do not reach the "
        f"tolerance {tolerance:.1e}; worst at nu = {response.nu[worst]:.6g}, where those up to "
        f"{response.highest[worst]} leave an estimated relative error of "
        f"{response.truncation[worst]:.1e}",
        ConvergenceWarning,
        stacklevel=3,
    )
