"""Kernels fitted to measurements, with their uncertainty."""

import math
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.parameters import Flag, Number
from viscovib.errors import ConvergenceWarning, InputError, caller
from viscovib.kernels.time_temperature import ShiftLaw
from viscovib.rubber.data import CreepData, ModulusData, RelaxationData
from viscovib.rubber.fit import KernelFit, Optimum
from viscovib.rubber.master import MasterCurve
from viscovib.rubber.measured import LOSS_SHARE, SHARE, Measured, descend
from viscovib.rubber.models import PARTS, Model, start_shapes
from viscovib.rubber.parametric_fit import ParametricFit
from viscovib.rubber.prony_fit import fit_prony

_WEIGHTS = ("model", "data")
_ALPHAS = (0.12, 0.3, 0.5, 0.7, 0.9)
#: Number of times in the grid of starts; number of starts continued, for one part and several.
_TIMES, _STARTS, _MORE_STARTS = 14, 4, 8
#: Largest relative residual for weights by the model.
_NOISE = 0.15
#: Largest number of passes with weights by the model, and tolerance between two passes.
_PASSES, _SETTLED = 12, 1e-10
#: Ratio of instantaneous to largest measured modulus from which on a warning is issued.
_BEYOND = 1.6
#: Smallest residual, and ratio to the residual of a Prony series, for a warning.
_MISFIT, _FAR_ABOVE = 0.05, 2.5
#: Temperature difference (K) below which sets have the same temperature.
_ONE_TEMPERATURE = 1.0
_ALLOW, _MODULUS = Flag("allow_creep"), Number("modulus", above=0)


def fit_kernel(
    data: ModulusData | RelaxationData | CreepData | MasterCurve,
    *,
    kind: str | Sequence[str] = "rabotnov",
    modulus: float | None = None,
    storage_weight: float = 1.0,
    loss_weight: float = 1.0,
    weights: str = "model",
    allow_creep: bool = False,
    shift: ShiftLaw | None = None,
    terms: str | int = "auto",
    smooth: str | float = 0.0,
) -> KernelFit:
    """Fit a kernel and the instantaneous modulus to measurements.

    The fit minimizes the sum of squares of the relative residuals of storage and loss, from several
    starts. The best optimum is returned.

    Parameters
    ----------
    data : ModulusData, RelaxationData, CreepData or MasterCurve
        At one temperature, or a master curve, whose kernel then has a temperature.
    kind : {"rabotnov", "rzhanitsyn", "abel", "fractional_zener", "prony"} or sequence of these
        Several kinds are summed: ["rabotnov", "rabotnov"] is two spring-pots in parallel. A
        fractional Zener element (a spring in parallel with a spring and a spring-pot in series) is
        a Rabotnov kernel.
    modulus : float, optional
        M_0 if it is known (Pa, N/m); otherwise it is fitted.
    storage_weight, loss_weight : float
        Factors of the residuals of each part.
    weights : {"model", "data"}
        Reference of the relative residuals. With "model" (not used for residuals above 15 %) noise
        causes no bias of the modulus; with "data" it does.
    allow_creep : bool
        Allow an integral of 1 or more: complete relaxation.
    shift : ShiftLaw, optional
        Temperature dependence of the kernel; by default the factors of a master curve.
    terms : {"auto"} or int
        For prony kernels: number of terms over the whole range of the data; "auto" tries 0.5 to 4
        terms per decade and selects the density with the smallest information criterion (Schwarz).
    smooth : {"L-curve"} or float
        For prony kernels: weight of the second differences of the spectrum relative to the
        residuals.

    Returns
    -------
    KernelFit

    Raises
    ------
    InputError
        For sets at several temperatures: use `master_curve` first.

    Warns
    -----
    ConvergenceWarning
        If the data do not determine a parameter (NaN in ``parameters``), if the instantaneous
        modulus is far outside the data, if residuals are far above those of a Prony series, or if
        rows are read as several sets.

    Examples
    --------
    >>> nu = np.geomspace(1e-2, 1e4, 40)
    >>> true = vv.RabotnovKernel(amplitude=2, alpha=0.5, beta=3)
    >>> stiff = 2e6 * (1 - true.transform(nu))
    >>> data = vv.ModulusData(frequencies=nu, storage=stiff.real, loss=stiff.imag)
    >>> fit = vv.fit_kernel(data, kind="rabotnov")
    >>> round(fit.modulus), round(fit.kernel.amplitude, 6), round(fit.kernel.alpha, 6)
    (2000000, 2.0, 0.5)
    """
    _native.check_instance("data", data, ModulusData, RelaxationData, CreepData, MasterCurve)
    law = shift
    if isinstance(data, MasterCurve):
        law = data.shift if shift is None else shift
        data = data.data
    if law is not None:
        _native.check_instance("shift", law, ShiftLaw)
    _check_sets(data)
    shares = SHARE.check(storage_weight), LOSS_SHARE.check(loss_weight)
    if not any(shares):
        raise InputError("storage_weight, loss_weight: must not both be 0")
    _native.choice("weights", weights, _WEIGHTS)
    given = None if modulus is None else _MODULUS.check(modulus)
    measured = Measured.of(data, shares)
    if given is not None and given < measured.largest:
        raise InputError(
            f"modulus = {given:g}: is below the largest one measured, {measured.largest:g}; must "
            "be at least that"
        )
    kinds = _kinds(kind)
    if kinds == ("prony",):
        return fit_prony(data, measured, given, terms, smooth, weights, law)
    allow = _ALLOW.check(allow_creep)
    unit = math.exp(-float(np.mean(measured.log_rates)))
    model = Model(kinds, allow, given, unit)
    if measured.count < model.size:
        raise InputError(
            f"data: {measured.count} numbers do not determine {model.size} parameters, must be more"
        )
    ends = _search(model, measured)
    fit = _result(model, measured, ends, weights, law, str(kind))
    _warn_of_misfit(fit, data, given, weights)
    return fit


def _check_sets(data: ModulusData | RelaxationData | CreepData) -> None:
    """Refuse sets at several temperatures; warn of several sets at one temperature."""
    sets = data.sets()
    if len(sets) == 1:
        return
    if data.temperature is not None:
        means = [float(np.mean(np.asarray(one.temperature))) for one in sets]
        low, high = min(means), max(means)
        if high - low > _ONE_TEMPERATURE:
            raise InputError(
                f"data: has {len(sets)} sets at {low:.4g} to {high:.4g} deg C, must have one "
                "temperature: take a master curve (master_curve), or data.sets()[i]"
            )
    over = "frequencies" if isinstance(data, ModulusData) else "times"
    warnings.warn(
        f"data: is read as {len(sets)} sets, which are fitted together; if it is one sweep, "
        f"sort its rows by {over}",
        ConvergenceWarning,
        stacklevel=caller(),
    )


def _warn_of_misfit(fit: ParametricFit, data: Any, given: float | None, weights: str) -> None:
    """Warn of residuals far above those of a Prony series, which show the scatter of the data."""
    if isinstance(data, CreepData):
        return
    counted = [True, False]
    if isinstance(data, ModulusData):
        n = fit.measured.log_rates.size
        counted = [bool(part.any()) for part in np.split(fit.measured.shares > 0, [n])]
    own = [r for r, does in zip(fit.residual, counted, strict=True) if does]
    if not max(own) > _MISFIT:
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        series = fit_prony(data, fit.measured, given, "auto", 0.0, weights, None)
    best = [r for r, does in zip(series.residual, counted, strict=True) if does]
    pairs = list(zip(own, best, strict=True))
    if any(a > _MISFIT and a > _FAR_ABOVE * b for a, b in pairs) and max(best) < max(own):
        left, other = (" and ".join(f"{100 * r:.2g} %" for r in found) for found in (own, best))
        warnings.warn(
            f"the residuals of kind = {fit.kind!r}, {left}, are far above the scatter of the "
            f"data: with kind='prony' they are {other}",
            ConvergenceWarning,
            stacklevel=caller(),
        )
    elif isinstance(data, ModulusData) and all(counted) and min(best) > _NOISE:
        warnings.warn(
            f"residuals of {100 * own[0]:.2g} % and {100 * own[1]:.2g} %, too large for a "
            "relaxing material: are storage and loss exchanged? See kramers_kronig(data)",
            ConvergenceWarning,
            stacklevel=caller(),
        )


def _kinds(kind: str | Sequence[str]) -> tuple[str, ...]:
    allowed = (*PARTS, "fractional_zener", "prony")
    several = [kind] if isinstance(kind, str) else kind
    if not isinstance(several, (list, tuple)) or not several:
        raise InputError(f"kind = {_native.shown(kind)}: must be a kind of kernel, or several")
    found = tuple(_native.choice("kind", one, allowed) for one in several)
    if "prony" in found and len(found) > 1:
        raise InputError("kind: prony already includes any sum, must be the only kind")
    if len(found) > 3:
        raise InputError(f"kind: {len(found)} parts, must be at most 3")
    # A fractional Zener element is a Rabotnov kernel.
    return tuple("rabotnov" if one == "fractional_zener" else one for one in found)


def _search(model: Model, measured: Measured) -> list[tuple[float, FloatArray]]:
    """Results of all starts, the best first: sums of squares (weights by the data), unknowns."""
    factor = measured.scale(model, np.zeros(0), "data")

    def residual(x: FloatArray) -> FloatArray:
        return (measured.predicted(model, x) - measured.target) * factor

    def slopes(x: FloatArray) -> FloatArray:
        return measured.slopes(model, x) * factor[:, np.newaxis]

    ends: list[tuple[float, FloatArray]] = []
    for start in _starts(model, measured, factor):
        theta = descend(residual, slopes, start, rough=True)
        with np.errstate(all="ignore"):
            left = residual(theta)
            cost = float(left @ left)
        if math.isfinite(cost):
            ends.append((cost, theta))
    if not ends:
        raise InputError("data: no fit converges, must be data of a relaxing material")
    ends.sort(key=lambda end: end[0])
    theta = descend(residual, slopes, ends[0][1])
    left = residual(theta)
    return [(float(left @ left), theta), *ends[1:]]


def _starts(model: Model, measured: Measured, factor: FloatArray) -> list[FloatArray]:
    """The best points of a coarse grid of alphas and times, with solved linear unknowns."""
    low, high = measured.log_rates.min(), measured.log_rates.max()
    taus = np.exp(-np.linspace(low - 2, high + 2, _TIMES))
    columns, places = [], []
    for part in dict.fromkeys(model.parts):
        times = np.array([model.unit]) if part == "abel" else taus
        shapes = _shapes(part, times, measured)
        for i, alpha in enumerate(_ALPHAS):
            for j, tau in enumerate(times.tolist()):
                columns.append(shapes[i, j])
                places.append((part, alpha, tau))
    n = measured.log_rates.size
    whole = np.concatenate([np.ones(n), np.zeros(measured.target.size - n)])
    columns_scaled = np.array(columns) * factor
    first, target = whole * factor, _as_modulus(measured) * factor
    combined = _combinations(model, places)
    a = np.stack(
        [np.broadcast_to(first, (len(combined), first.size))]
        + [columns_scaled[[c[k] for c in combined]] for k in range(len(model.parts))],
        axis=1,
    )
    if model.modulus:
        target = target - model.modulus * first
        a = a[:, 1:]
    normal, right = a @ a.transpose(0, 2, 1), a @ target
    size = np.sqrt(np.einsum("ijj->ij", normal))
    size[size == 0] = 1.0
    unit = normal / (size[:, :, np.newaxis] * size[:, np.newaxis, :])
    unit += 1e-9 * np.eye(unit.shape[1])
    x = np.linalg.solve(unit, (right / size)[:, :, np.newaxis])[:, :, 0] / size
    if model.modulus:
        x = np.column_stack([np.full(x.shape[0], model.modulus), x])
    x[:, 0] = np.maximum(x[:, 0], 1.02 * measured.largest if not model.modulus else 0)
    share = np.clip(-x[:, 1:] / x[:, :1], 1e-3, 0.98)
    if not model.free and "abel" not in model.parts:
        share *= np.minimum(1, 0.98 / share.sum(axis=1))[:, np.newaxis]
    parts = np.stack([columns_scaled[[c[k] for c in combined]] for k in range(len(model.parts))], 1)
    said = x[:, :1] * (first - np.einsum("ck,ckn->cn", share, parts))
    cost = ((said - _as_modulus(measured) * factor) ** 2).sum(axis=1)
    most = _STARTS if len(model.parts) == 1 else _MORE_STARTS
    chosen: list[int] = []
    for i in np.argsort(cost).tolist():
        # Neighbours on the grid lead to the same result.
        if all(_far(places, combined[i], combined[k]) for k in chosen):
            chosen.append(i)
        if len(chosen) == most:
            break
    return [
        model.join(
            float(x[i, 0]),
            np.array([places[c][1] for c in combined[i]]),
            np.array([places[c][2] for c in combined[i]]),
            share[i],
        )
        for i in chosen
    ]


def _far(places: list[tuple[str, float, float]], one: Any, other: Any) -> bool:
    apart = 0.0
    for a, b in zip(one, other, strict=True):
        apart += abs(places[a][1] - places[b][1]) / 0.25
        apart += abs(math.log(places[a][2] / places[b][2])) / 4
    return apart > 1


def _combinations(model: Model, places: list[tuple[str, float, float]]) -> list[tuple[int, ...]]:
    """Assignments of grid points to parts; among equal parts the slower one comes first."""
    of = [[i for i, place in enumerate(places) if place[0] == part] for part in model.parts]
    if len(of) > 2:
        of = [one[::3] for one in of]
    found: list[tuple[int, ...]] = [()]
    for k, own in enumerate(of):
        found = [
            (*before, i)
            for before in found
            for i in own
            if not (k and model.parts[k] == model.parts[k - 1])
            or places[i][2] < places[before[-1]][2]
        ]
    return found


def _as_modulus(measured: Measured) -> FloatArray:
    return 1 / measured.target if isinstance(measured.data, CreepData) else measured.target


def _shapes(part: str, taus: FloatArray, measured: Measured) -> FloatArray:
    """Relaxing parts of a modulus for p = 1, shape (alphas, taus, n)."""
    if isinstance(measured.data, ModulusData):
        h = start_shapes(part, _ALPHAS, taus, measured.along)
        return np.concatenate([h.real, h.imag], axis=2)
    # A modulus at time t is nearly the storage at 1/t.
    return start_shapes(part, _ALPHAS, taus, measured.along).real


def _settle(model: Model, measured: Measured, theta: FloatArray) -> tuple[FloatArray, str]:
    """Fit with weights by the model, which are updated until they converge.

    The equations sum (m - d) dm/m^2 = 0 have no bias by noise that is relative to m.
    """
    for _ in range(_PASSES):
        factor = measured.scale(model, theta, "model")
        found = descend(
            lambda x, f=factor: (measured.predicted(model, x) - measured.target) * f,  # type: ignore[misc]
            lambda x, f=factor: measured.slopes(model, x) * f[:, np.newaxis],  # type: ignore[misc]
            theta,
        )
        moved = float(np.abs(found - theta).max())
        theta = found
        if moved < _SETTLED:
            break
    return theta, "model"


def _result(
    model: Model,
    measured: Measured,
    ends: list[tuple[float, FloatArray]],
    weights: str,
    law: ShiftLaw | None,
    kind: str,
) -> ParametricFit:
    theta, used = ends[0][1], "data"
    residual = (measured.predicted(model, theta) - measured.target) * measured.scale(
        model, theta, "data"
    )
    if weights == "model" and np.sqrt(np.mean(residual**2)) < _NOISE:
        theta, used = _settle(model, measured, theta)
    optima: list[Optimum] = []
    for cost, end in ends:
        if not any(abs(cost - other.cost) <= 1e-3 * cost + 1e-10 for other in optima):
            values = dict(zip(model.names, model.parameters(end).tolist(), strict=True))
            optima.append(Optimum(cost=cost, parameters=values))
    fit = ParametricFit(
        model=model, measured=measured, theta=theta, weights=used, shift=law, kind=kind,
        optima=tuple(optima),
    )  # fmt: skip
    if fit.unconstrained:
        note = "; ".join(
            f"{name}: {low:.3g} to {high:.3g}"
            for name, (low, high) in fit.interval.items()
            if name in fit.unconstrained
        )
        warnings.warn(
            f"the data do not constrain {', '.join(fit.unconstrained)} (95 %: {note})",
            ConvergenceWarning,
            stacklevel=caller(),
        )
    if model.modulus is None and fit.modulus > _BEYOND * measured.largest:
        ramp = isinstance(measured.data, RelaxationData) and not measured.data.ramp
        warnings.warn(
            f"the instantaneous modulus {fit.modulus:.4g} lies beyond the largest one measured, "
            f"{measured.largest:.4g}: it is an extrapolation by the kernel"
            + ("; a ramp treated as a step gives such a modulus, see ramp=" if ramp else ""),
            ConvergenceWarning,
            stacklevel=caller(),
        )
    return fit
