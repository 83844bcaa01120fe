"""Shift laws fitted to factors: WLF, Arrhenius, or a table of the factors."""

import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.values import Value
from viscovib.errors import ConvergenceWarning, InputError, caller
from viscovib.kernels.time_temperature import GAS_CONSTANT, KELVIN, WLF, Arrhenius, ShiftLaw

#: Residual of the law (decades) above which a warning is issued.
_MISFIT = 0.1
LAWS = ("wlf", "arrhenius")
#: Largest temperature (deg C) and decade, by argument name.
_LARGEST = {"temperatures": 1e6, "decades": 300.0}


def bounded(name: str, value: npt.ArrayLike, kind: str = "") -> FloatArray:
    """Return temperatures or decades, within their bounds, as a one-dimensional array."""
    array, largest = _native.real_array(name, value, ndim=1), _LARGEST[kind or name]
    if array.size and np.abs(array).max() > largest:
        i = int(np.abs(array).argmax())
        raise InputError(f"{name}[{i}] = {array[i]:g}: must be within +-{largest:g}")
    return array


@dataclass(frozen=True, kw_only=True, eq=False)
class ShiftTable(ShiftLaw):
    """Measured shift factors, linear between temperatures and undefined outside.

    Parameters
    ----------
    temperatures : array_like, shape (n,)
        Ascending (deg C), n >= 2.
    decades : array_like, shape (n,)
        log10(a_T).

    Examples
    --------
    >>> law = vv.ShiftTable(temperatures=[0, 20, 60], decades=[2.0, 0.0, -2.5])
    >>> float(law.log10(40)), law.reference
    (-1.25, 20.0)
    """

    temperatures: npt.ArrayLike
    decades: npt.ArrayLike
    _least: ClassVar[int] = 2

    def __post_init__(self) -> None:
        for name in ("temperatures", "decades"):
            array = bounded(name, getattr(self, name)).copy()
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        t, d = np.asarray(self.temperatures), np.asarray(self.decades)
        if t.size < self._least or d.size != t.size:
            raise InputError(
                f"temperatures and decades have {t.size} and {d.size} numbers: must match and be 2 "
                "or more"
            )
        if (np.diff(t) <= 0).any():
            raise InputError("temperatures: must be strictly ascending")
        if not d.min() <= 0 <= d.max():
            raise InputError("decades: must be 0 at the reference, within the table")

    @cached_property
    def reference(self) -> float:  # type: ignore[override]
        """Temperature at which the factor is 1 (deg C)."""
        t, d = np.asarray(self.temperatures), np.asarray(self.decades)
        exact = np.flatnonzero(d == 0)
        if exact.size:
            return float(t[exact[0]])
        i = int(np.flatnonzero(np.sign(d[1:]) != np.sign(d[:-1]))[0])
        return float(t[i] - d[i] * (t[i + 1] - t[i]) / (d[i + 1] - d[i]))

    def log10(self, temperature: npt.ArrayLike) -> FloatArray:
        """Decades log10(a_T) at temperatures (deg C) within the table, any shape."""
        at = _native.real_array("temperature", temperature)
        t = np.asarray(self.temperatures)
        wrong = at[(at < t[0]) | (at > t[-1])] if at.ndim else at
        if (at.ndim and wrong.size) or (not at.ndim and not t[0] <= at <= t[-1]):
            raise InputError(
                f"temperature = {float(np.ravel(wrong)[0]):g}: must be {t[0]:g} to {t[-1]:g}, "
                "the measured range; use a law outside"
            )
        return np.asarray(np.interp(at, t, np.asarray(self.decades)))[()]


@dataclass(frozen=True, kw_only=True, eq=False)
class ShiftFit(Value):
    """A law fitted to shift factors.

    Attributes
    ----------
    law : WLF or Arrhenius
    misfit : float
        Root mean square of the residuals (decades).
    residuals : ndarray, shape (n,)
        Factor minus law at each temperature (decades).
    interval : dict
        95 % interval of each parameter of the law, linearized, from the residuals.

    Examples
    --------
    >>> found = vv.fit_shift_law([0, 20, 40, 60], [2.1, 0, -1.5, -2.5], reference=20)
    >>> type(found.law).__name__, bool(found.misfit < 0.1)
    ('WLF', True)
    """

    law: WLF | Arrhenius
    misfit: float
    residuals: FloatArray
    interval: dict[str, tuple[float, float]]

    def __repr__(self) -> str:
        ends = ", ".join(f"{k} {a:.4g} to {b:.4g}" for k, (a, b) in self.interval.items())
        return f"ShiftFit({self.law}, misfit {self.misfit:.2g} decades; 95 %: {ends})"


def fit_shift_law(
    temperatures: npt.ArrayLike,
    decades: npt.ArrayLike,
    *,
    law: str = "wlf",
    reference: float,
) -> ShiftFit:
    """Fit a law to shift factors.

    Parameters
    ----------
    temperatures : array_like, shape (n,)
        Degrees Celsius, n >= 3.
    decades : array_like, shape (n,)
        log10(a_T), 0 at the reference.
    law : {"wlf", "arrhenius"}
    reference : float
        T_r (deg C), at which the factor is 1.

    Warns
    -----
    ConvergenceWarning
        If the residual exceeds 0.1 decades (rms).

    Examples
    --------
    >>> t = np.array([0.0, 20.0, 40.0, 60.0])
    >>> found = vv.fit_shift_law(t, -8.86 * (t - 20) / (101.6 + t - 20), reference=20)
    >>> round(found.law.c1, 6), round(found.law.c2, 6)
    (8.86, 101.6)
    """
    t, d = bounded("temperatures", temperatures), bounded("decades", decades)
    _native.choice("law", law, LAWS)
    at = _native.number("reference", reference)
    if t.size < 3 or d.size != t.size:
        raise InputError(
            f"temperatures and decades have {t.size} and {d.size} numbers: must match and be 3 or "
            "more"
        )
    if at <= -KELVIN:
        raise InputError(f"reference = {at:g}: must be above -{KELVIN} deg C")
    if t.min() <= -KELVIN:
        i = int(t.argmin())
        raise InputError(f"temperatures[{i}] = {t[i]:g}: must be above -{KELVIN} deg C")
    if (t == at).all():
        raise InputError(
            f"temperatures: are all equal to the reference, {at:g} deg C, must "
            "contain other temperatures"
        )
    found, names, slopes = (_wlf if law == "wlf" else _arrhenius)(t, d, at)
    residuals = np.asarray(d - found.log10(t))
    misfit = float(np.sqrt(np.mean(residuals**2)))
    if misfit > _MISFIT:
        warnings.warn(
            f"{law} misses the factors by {misfit:.2g} decades (rms), at "
            f"{t[np.abs(residuals).argmax()]:g} deg C by {np.abs(residuals).max():.2g}: it does "
            "not describe them",
            ConvergenceWarning,
            stacklevel=caller(),
        )
    return ShiftFit(
        law=found,
        misfit=misfit,
        residuals=residuals,
        interval=_interval(found, names, slopes, residuals),
    )


def _wlf(t: FloatArray, d: FloatArray, at: float) -> tuple[WLF, tuple[str, ...], FloatArray]:
    """Fit c1 linearly, and c2 by a search over its logarithm, with the pole below the data."""
    from scipy.optimize import minimize_scalar

    warm = t - at
    lowest = max(-warm.min(), 0.0)

    def best(log_c2: float) -> tuple[float, float]:
        shape = -warm / (lowest + np.exp(log_c2) + warm)
        c1 = float(shape @ d / (shape @ shape))
        return float(((d - c1 * shape) ** 2).sum()), c1

    grid = np.linspace(np.log(1e-2), np.log(1e5), 60)
    sums = [best(x)[0] for x in grid]
    i = int(np.argmin(sums))
    ends = (grid[max(i - 1, 0)], grid[min(i + 1, grid.size - 1)])
    found = minimize_scalar(
        lambda x: best(x)[0], bounds=ends, method="bounded", options={"xatol": 1e-12}
    )
    c1, c2 = best(found.x)[1], lowest + float(np.exp(found.x))
    if not c1 > 0:
        raise _refusal("WLF", t, d, at)
    # Newton's method on both: a minimum is only accurate to the root of the rounding error.
    for _ in range(20):
        slopes = np.column_stack([-warm / (c2 + warm), c1 * warm / (c2 + warm) ** 2])
        step = np.linalg.lstsq(slopes, d + c1 * warm / (c2 + warm), rcond=None)[0]
        if not (c2 + step[1] > lowest and c1 + step[0] > 0):
            break
        c1, c2 = c1 + float(step[0]), c2 + float(step[1])
        if abs(step[1]) <= 1e-14 * c2:
            break
    slopes = np.column_stack([-warm / (c2 + warm), c1 * warm / (c2 + warm) ** 2])
    return WLF(reference=at, c1=c1, c2=c2), ("c1", "c2"), slopes


def _arrhenius(
    t: FloatArray, d: FloatArray, at: float
) -> tuple[Arrhenius, tuple[str, ...], FloatArray]:
    shape = -(t - at) / ((at + KELVIN) * (t + KELVIN)) / (GAS_CONSTANT * np.log(10))
    energy = float(shape @ d / (shape @ shape))
    if not energy > 0:
        raise _refusal("Arrhenius", t, d, at)
    law = Arrhenius(reference=at, activation_energy=energy)
    return law, ("activation_energy",), shape[:, np.newaxis]


def _refusal(law: str, t: FloatArray, d: FloatArray, at: float) -> InputError:
    """Error for factors without a law: they rise, or are not 0 at the reference."""
    warm = t - t.mean()
    if float(warm @ d) < 0:
        i = int(((t - at) * d).argmax())
        side = "below 0 above" if t[i] > at else "above 0 below"
        return InputError(
            f"decades[{i}] = {d[i]:g} at {t[i]:g} deg C: must be {side} the reference, {at:g} deg "
            f"C, where a law of {law} is 0"
        )
    cold, hot = int(t.argmin()), int(t.argmax())
    return InputError(
        f"decades: do not fall with temperature ({d[cold]:g} at {t[cold]:g} deg C, {d[hot]:g} at "
        f"{t[hot]:g}), must do so for a law of {law}"
    )


def _interval(
    law: ShiftLaw, names: tuple[str, ...], slopes: FloatArray, residuals: FloatArray
) -> dict[str, tuple[float, float]]:
    from scipy.stats import t as student

    free = residuals.size - len(names)
    if free < 1:
        return {name: (float("nan"), float("nan")) for name in names}
    variance = float(residuals @ residuals) / free
    spread = np.sqrt(np.diag(np.linalg.pinv(slopes.T @ slopes)) * variance)
    reach = float(student.ppf(0.975, free))
    return {
        name: (getattr(law, name) - reach * s, getattr(law, name) + reach * s)
        for name, s in zip(names, spread.tolist(), strict=True)
    }
