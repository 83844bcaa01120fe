"""Branches of periodic solutions: continuation through folds, with stability."""

import csv
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray, core
from viscovib.errors import InputError, StabilityWarning
from viscovib.files import whole_file
from viscovib.hill import stability_with_memory
from viscovib.load import LoadLike
from viscovib.oscillators import Oscillator
from viscovib.plan import Plan, wanted_places
from viscovib.response import Peak, _prepare

OUTCOMES: tuple[str, ...] = ("completed", "returned", "step limit", "stuck", "overflow")
#: Multipliers this close to the unit circle count as on it.
_CIRCLE = 1e-9
#: Numbers that all points together may hold.
_MAX_NUMBERS = 4e8
#: Entries of a monodromy matrix beyond this say nothing any more.
_LARGEST = 1e100


@dataclass(frozen=True)
class Crossing:
    """Where stability changes along a branch: between two of its points.

    ``kind`` is "fold", "symmetry breaking", "period doubling" or "Neimark-Sacker"; ``before`` is
    the index of the last point before it. ``parameter``: where, for branches of the pendulum; None
    where that was not found.
    """

    kind: str
    before: int
    parameter: float | None = None


class Curve:
    """What branches of either system share: amplitudes along them and their peaks."""

    coefficients: ComplexArray
    dof_names: tuple[str, ...]
    dof_units: tuple[str, ...]
    stable: npt.NDArray[Any] | None
    folds: FloatArray
    fold_coefficients: ComplexArray
    #: What varies along the branch.
    parameter: FloatArray

    @property
    def label(self) -> str:
        """What varies, for the axis of a picture."""
        raise NotImplementedError

    def _place(self, dof: str, harmonic: int | tuple[int, ...]) -> tuple[int, int]:
        raise NotImplementedError

    def amplitude(self, dof: str, harmonic: int | tuple[int, ...] = 1) -> FloatArray:
        """Size of a harmonic of a coordinate, shape (n,)."""
        d, j = self._place(dof, harmonic)
        return np.abs(self.coefficients[:, d, j])

    def peak(
        self,
        dof: str,
        harmonic: int | tuple[int, ...] = 1,
        *,
        band: tuple[float, float] | None = None,
    ) -> Peak:
        """Largest amplitude, overhanging parts included, refined between the points.

        ``band`` limits the search to values of `parameter`. Not `enclosed` at an end of the
        branch or of the band.
        """
        amplitude = self.amplitude(dof, harmonic)
        low, high = (-np.inf, np.inf) if band is None else band
        inside = (self.parameter >= low) & (self.parameter <= high)
        if not inside.any():
            raise InputError(f"band = {band}: holds no point of the branch")
        i = int(np.where(inside, amplitude, -np.inf).argmax())
        if not 0 < i < amplitude.size - 1 or not inside[i - 1 : i + 2].all():
            return Peak(float(self.parameter[i]), float(amplitude[i]), False)
        # A parabola over the distance along the curve, in which it has no fold.
        near = slice(i - 1, i + 2)
        p, a = self.parameter[near], amplitude[near]
        steps = np.hypot(np.diff(p) / p[1], np.diff(a) / max(a[1], 1e-300))
        s = np.array([-steps[0], 0.0, steps[1]])
        of_a, of_p = np.polyfit(s, a, 2), np.polyfit(s, p, 2)
        top = -of_a[1] / (2 * of_a[0]) if of_a[0] < 0 else 0.0
        return Peak(float(np.polyval(of_p, top)), float(np.polyval(of_a, top)), True)


@dataclass(frozen=True, eq=False)
class Branch(Curve):
    """A branch of periodic solutions u = Im sum_k X_k exp(i k nu t), in the order followed.

    Attributes
    ----------
    nu : ndarray, shape (n,)
        Circular frequencies (rad/s).
    load_factor : ndarray, shape (n,)
        Factor of the load given.
    harmonics : ndarray of int, shape (m,)
        Orders k kept.
    coefficients : complex ndarray, shape (n, n_dof, m)
        X_k.
    stable : ndarray of bool, shape (n,), or None
        None: unknown (time scales too far apart) or not asked for. With memory single motions may
        be unknown; the array then holds objects, True, False and None.
    multipliers : complex ndarray, shape (n, 2 n_dof), or None
        Floquet multipliers, largest first; with memory exp(2 pi exponents/nu).
    exponents : complex ndarray, shape (n, m), or None
        Exponents lambda (1/s) of disturbances exp(lambda t) times a periodic function, largest real
        part first, modulo i nu (of motions symmetric about half a period: 2 i nu; there Im lambda =
        nu at a breaking of the symmetry). With memory those that grow are complete, or all of a
        motion's are NaN; of those that decay some may lack; NaN behind the last.
    folds : ndarray, shape (n_folds,)
        Where the branch turns back: values of what varies (nu, or the load factor).
    fold_coefficients : complex ndarray, shape (n_folds, n_dof, m)
    crossings : tuple of Crossing
        Changes of stability.
    outcome : str
        "completed"; "returned": back at the beginning, another branch leads on; "step limit":
        max_points reached; "stuck": no smaller step helps; "overflow".
    plan : Plan
        What was computed, what was skipped and why.
    """

    nu: FloatArray
    load_factor: FloatArray
    harmonics: npt.NDArray[np.int32]
    coefficients: ComplexArray
    stable: npt.NDArray[Any] | None
    multipliers: ComplexArray | None
    exponents: ComplexArray | None
    folds: FloatArray
    fold_coefficients: ComplexArray
    crossings: tuple[Crossing, ...]
    outcome: str
    iterations: npt.NDArray[np.int32]
    varies: str
    dof_names: tuple[str, ...]
    dof_units: tuple[str, ...]
    plan: Plan

    @property
    def parameter(self) -> FloatArray:  # type: ignore[override]
        """What varies along the branch: nu or load_factor."""
        return self.nu if self.varies == "nu" else self.load_factor

    @property
    def label(self) -> str:
        """What varies, for the axis of a picture."""
        if self.varies == "nu":
            return r"circular frequency of the load $\nu$ (rad/s)"
        return f"factor of the load, at frequency {self.nu[0]:g} rad/s"

    def _place(self, dof: str, harmonic: int | tuple[int, ...]) -> tuple[int, int]:
        d = self.dof_names.index(_native.choice("dof", dof, self.dof_names))
        where = np.flatnonzero(self.harmonics == harmonic)
        if not where.size:
            kept = ", ".join(map(str, self.harmonics))
            raise InputError(f"harmonic = {harmonic}: must be one of those kept ({kept})")
        return d, int(where[0])

    def to_dataset(self) -> xr.Dataset:
        """Everything as an xarray Dataset over the points."""
        data: dict[str, Any] = {
            "nu": ("point", self.nu, {"units": "rad/s"}),
            "load_factor": ("point", self.load_factor),
            "coefficients": (("point", "dof", "harmonic"), self.coefficients),
        }
        if self.stable is not None and self.multipliers is not None:
            known = [-1 if s is None else int(s) for s in self.stable]
            data["stable"] = ("point", self.stable if self.stable.dtype == bool else known)
            data["exponents"] = (("point", "multiplier"), self.exponents)
            data["multipliers"] = (("point", "multiplier"), self.multipliers)
        return xr.Dataset(
            data,
            coords={"dof": list(self.dof_names), "harmonic": self.harmonics},
            attrs={"outcome": self.outcome, "folds": self.folds, "plan": str(self.plan)},
        )

    def to_csv(self, path: str | Path, *, coordinates: Sequence[str] | None = None) -> None:
        """Write a table: one row a point; stable is 1, 0 or, where that is unknown, -1.

        ``coordinates``: names of those wanted; all by default.
        """
        columns: dict[str, Any] = {"nu": self.nu, "load_factor": self.load_factor}
        if self.stable is not None:
            columns["stable"] = np.array([-1 if s is None else int(s) for s in self.stable])
        for d in wanted_places(coordinates, self.dof_names):
            name = self.dof_names[d]
            for j, k in enumerate(self.harmonics):
                columns[f"{name}_{k}_re"] = self.coefficients[:, d, j].real
                columns[f"{name}_{k}_im"] = self.coefficients[:, d, j].imag
        with whole_file(path) as file:
            file.write(f"# viscovib {version('viscovib')}, branch {self.outcome}\n")
            file.write(self.plan.comments())
            file.write(f"# folds at {self.varies} = {', '.join(f'{x:.15g}' for x in self.folds)}\n")
            file.write("# nu (rad/s); u = Im sum_k X_k exp(i k nu t)\n")
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            for row in zip(*columns.values(), strict=True):
                writer.writerow([f"{v:.16e}" if isinstance(v, float) else v for v in row])


def trace_response(
    mount: Oscillator,
    nu_range: tuple[float, float] | None = None,
    *,
    load: LoadLike | None = None,
    base: LoadLike | None = None,
    nu: float | None = None,
    load_range: tuple[float, float] | None = None,
    harmonics: int = 9,
    tolerance: float = 1e-10,
    max_points: int = 2000,
    max_step: float = 0.1,
    stability: bool = True,
) -> Branch:
    """Follow a branch of periodic solutions through its folds.

    Parameters
    ----------
    mount : Mount or PolynomialSystem
    nu_range : (float, float)
        Frequencies (rad/s) from which and to which the branch is followed, up or down.
    load, base : as for `forced_response`
    nu : float
        With ``load_range`` instead of ``nu_range``: the frequency at which the load varies.
    load_range : (float, float)
        Factors of the load from which and to which the branch is followed.
    harmonics : int
        Highest order kept.
    tolerance : float
        Relative size of the last correction.
    max_points : int
        Points at most, 2 to 100000.
    max_step : float
        Largest step as a part of the present point, 1e-4 to 1.
    stability : bool
        Compute Floquet multipliers; with memory, exponents from Hill's determinant, those that
        grow counted by the argument principle; with many coordinates that takes longer than the
        branch itself (0.1 s a point with 20), and beyond 240 unknowns it is not tried.

    Returns
    -------
    Branch

    Notes
    -----
    Newton's method on the equations of harmonic balance with exact derivatives;
    pseudo-arclength continuation (Keller 1977), steps by the angle between tangents; folds located
    to rounding of the parameter.
    """
    if (nu_range is None) == (load_range is None):
        raise InputError("nu_range or load_range: must be given, and only one of them")
    if (load_range is None) != (nu is None):
        raise InputError("nu: must be given with load_range, and only then")
    varies = "nu" if nu_range is not None else "load_range"
    start, finish = _range(varies if varies != "nu" else "nu_range", nu_range or load_range)
    if varies == "nu" and min(start, finish) <= 0:
        raise InputError(f"nu_range = ({start:g}, {finish:g}): must be greater than 0")
    at = start if nu is None else _native.number("nu", nu)
    points = _native.integer("max_points", max_points, 2, 100_000)
    step = _native.number("max_step", max_step)
    if not 1e-4 <= step <= 1:
        raise InputError(f"max_step = {step:g}: must be in [1e-4, 1]")
    job, _, options, planned = _prepare(
        mount, [at], load, base, "newton", harmonics, tolerance, 100, 1.0, keep_idle=True
    )
    if planned.method != "newton":
        raise InputError(
            "mount: nothing is nonlinear, its response is a single curve: see forced_response"
        )
    n, m = len(mount.dof_names), planned.orders.size
    most = int(_MAX_NUMBERS / (8 * m * n + 4 * n**2))
    if points > most:
        raise InputError(
            f"max_points = {points}: must be at most {most} with {n} coordinates and {m} harmonics"
        )
    cancel = np.zeros(1, dtype=np.intc)
    remembers = bool(mount._active_kernels)
    known = bool(stability) and not remembers
    (
        n, ended, p, iterations, coefficients, matrices, half_wave, n_folds, folds,
        fold_coefficients,
    ) = _native.call_interruptibly(
        core.mount_branch, cancel, *job, 1 if varies == "nu" else 2, at, start, finish, options[1],
        options[2], points, step, int(known), planned.orders.size, cancel,
    )  # fmt: skip
    if ended < 0:
        raise InputError(
            f"{'nu_range' if varies == 'nu' else 'load_range'}: no solution was found at its "
            f"beginning {start:g}: begin elsewhere"
        )
    multipliers: ComplexArray | None = None
    exponents: ComplexArray | None = None
    stable: npt.NDArray[Any] | None = None
    crossings: tuple[Crossing, ...] = ()
    if known and not np.all(np.abs(matrices[:, :, :n]) < _LARGEST):
        known = False
        warnings.warn(
            "stability was not computed: the motion's time scales are too far apart",
            StabilityWarning,
            stacklevel=2,
        )
    if known:
        roots = np.linalg.eigvals(np.ascontiguousarray(matrices[:, :, :n].transpose(2, 0, 1)))
        multipliers, stable, crossings, exponents = _stability(roots, bool(half_wave))
        exponents *= (p[:n] if varies == "nu" else np.full(n, at))[:, np.newaxis]
    elif stability and remembers:
        along = p[:n] if varies == "nu" else np.full(n, at)
        stable, exponents, n_growing = stability_with_memory(
            job[:-2], along, coefficients[:, :, :n], planned.orders, bool(half_wave)
        )
        multipliers = np.exp(2 * np.pi * exponents / along[:, np.newaxis])
        halves = np.exp(np.pi * exponents / along[:, np.newaxis]) if half_wave else multipliers
        crossings = _crossings(halves, n_growing, exponents.real > 0, bool(half_wave))
    values = p[:n].copy()
    same = np.ones(n)
    return Branch(
        nu=values if varies == "nu" else at * same,
        load_factor=same if varies == "nu" else values,
        harmonics=planned.orders,
        coefficients=_absolute(
            coefficients[:, :, :n].T,
            mount._base_direction,
            job,
            planned.orders,
            same if varies == "nu" else values,
        ),
        stable=stable,
        multipliers=multipliers,
        exponents=exponents,
        folds=folds[:n_folds].copy(),
        fold_coefficients=_absolute(
            fold_coefficients[:, :, :n_folds].T,
            mount._base_direction,
            job,
            planned.orders,
            np.ones(n_folds) if varies == "nu" else folds[:n_folds],
        ),
        crossings=crossings,
        outcome=OUTCOMES[ended],
        iterations=iterations[:n].copy(),
        varies="nu" if varies == "nu" else "load_factor",
        dof_names=mount.dof_names,
        dof_units=mount.dof_units,
        plan=_plan(varies == "nu", start, finish, planned, stability),
    )


def _plan(of_nu: bool, start: float, finish: float, planned: Any, stability: bool) -> Plan:
    first = core.branch_plan(1 if of_nu else 2, start, finish, planned.orders.size).decode()
    told = "computes: stability" if stability else "skips: stability (not asked for)"
    return Plan(f"{first.strip()}\n{planned.rest.strip()}\n{told}")


def _range(name: str, value: object) -> tuple[float, float]:
    ends = _native.real_array(name, value)
    if ends.shape != (2,):
        raise InputError(f"{name}: must be two numbers, from and to, got shape {ends.shape}")
    if ends[0] == ends[1]:
        raise InputError(f"{name} = ({ends[0]:g}, {ends[1]:g}): must be two different numbers")
    return float(ends[0]), float(ends[1])


def _absolute(
    relative: ComplexArray,
    direction: FloatArray | None,
    job: tuple[Any, ...],
    kept: npt.NDArray[np.int32],
    factors: FloatArray,
) -> ComplexArray:
    """From coordinates relative to the base to absolute ones."""
    result = np.ascontiguousarray(relative)
    orders, series = job[-2], job[-1]
    if direction is None:
        return result
    for order, moved in zip(orders, series[-1], strict=True):
        for d in np.flatnonzero(direction):
            result[:, d, kept == order] += direction[d] * moved * factors[:, np.newaxis]
    return result


def _stability(
    roots: ComplexArray, half_wave: bool
) -> tuple[ComplexArray, npt.NDArray[np.bool_], tuple[Crossing, ...], ComplexArray]:
    """Return multipliers, stability, what is crossed where it changes, and exponents over nu."""
    roots = np.take_along_axis(roots, np.argsort(-np.abs(roots), axis=1), axis=1)
    multipliers = roots**2 if half_wave else roots
    stable = np.abs(multipliers).max(axis=1) <= 1 + _CIRCLE
    beyond = np.abs(roots) > 1 + _CIRCLE
    with np.errstate(divide="ignore"):
        exponents = np.log(roots.astype(complex)) / (np.pi if half_wave else 2 * np.pi)
    return multipliers, stable, _crossings(roots, beyond.sum(axis=1), beyond, half_wave), exponents


def _crossings(
    roots: ComplexArray,
    outside: npt.NDArray[np.integer[Any]],
    beyond: npt.NDArray[np.bool_],
    half_wave: bool,
) -> tuple[Crossing, ...]:
    """Find what is crossed where the number ``outside`` of growing disturbances changes.

    ``roots``: multipliers of a period or, half_wave, half a period, NaN where not known; beyond:
    those outside the unit circle. A number below 0 is not known.
    """
    crossings = []
    for i in np.flatnonzero(outside[1:] != outside[:-1]):
        # The root nearest to the circle on the side with more roots outside.
        j = i + 1 if outside[i + 1] > outside[i] else i
        out = roots[j][beyond[j]]
        if min(outside[i], outside[i + 1]) < 0 or not out.size:
            continue
        root = out[np.abs(out).argmin()]
        if abs(root.imag) > 1e-6 * abs(root):
            kind = "Neimark-Sacker"
        elif root.real > 0:
            kind = "fold"
        else:
            kind = "symmetry breaking" if half_wave else "period doubling"
        crossings.append(Crossing(kind, int(i)))
    return tuple(crossings)
