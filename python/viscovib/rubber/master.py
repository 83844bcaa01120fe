"""Master curves: sets at several temperatures, shifted onto each other.

All sets lie on one curve y = s(log10 f + log10 a_T), where y is the logarithm of the storage (or
loss, or the modulus over time) and s a cubic spline with a weak penalty on its curvature. Shift
factors and spline are found together by least squares, so the covariance of the factors gives their
uncertainty: if neighbouring sets hardly overlap, it is large.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.results import Axes, Dataset, Result, as_dataset
from viscovib.errors import ConvergenceWarning, InputError, caller
from viscovib.kernels.time_temperature import KELVIN, ShiftLaw
from viscovib.rubber.data import ModulusData, RelaxationData
from viscovib.rubber.shift_fit import ShiftFit, ShiftTable, bounded, fit_shift_law
from viscovib.rubber.superposition import (
    KNOTS,
    Curves,
    Ties,
    flatness,
    neighbours,
    scatter_of,
    superpose,
)

_BY = ("storage", "loss", "both")
_VERTICAL = ("none", "density", "free")
#: Other knot distances, to include the effect of this choice in the uncertainty.
_OTHER_KNOTS = (0.8,)
#: Bounds for warnings: smallest overlap (decades), and scatter of given factors relative to that of
#: fitted factors.
_THIN, _WORSE = 0.3, 2.0
#: Largest deviation of given factors from 0 at the reference (decades).
_ZERO = 0.1
#: Universal c2 (K) at the glass transition (Williams, Landel, Ferry, J. Am. Chem. Soc. 77, 1955).
_UNIVERSAL = 51.6


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MasterCurve(Result):
    """Sets shifted onto each other, at a reference temperature.

    Attributes
    ----------
    reference : float
        Degrees Celsius.
    temperatures, decades, uncertainty : ndarray, shape (n,)
        For each set, from cold to warm: its mean temperature, log10(a_T), and its standard
        uncertainty relative to the reference. With ``vertical="free"`` by one part it includes the
        difference from the factors by both parts.
    vertical : ndarray, shape (n,)
        b_T: measured moduli were divided by it. At T the modulus is b_T times that of a fit.
    overlap : ndarray, shape (n-1,)
        Common decades of reduced frequency of neighbouring sets.
    scatter, loss_scatter : float
        Root mean square distance from a smooth curve (decades of modulus).
    data : ModulusData or RelaxationData
        All rows at reduced frequencies (times), a single set.

    Examples
    --------
    >>> raw = vv.read_dma("data/rubber/pyvisco_freq_user_raw.csv")
    >>> master = vv.master_curve(raw, reference=20.0)
    >>> master.temperatures.size, round(master.scatter, 3)
    (21, 0.003)
    >>> fit = vv.fit_kernel(master, kind="prony")
    >>> fit.kernel.at(60.0).temperature
    60.0
    """

    reference: float
    temperatures: FloatArray
    decades: FloatArray
    uncertainty: FloatArray
    vertical: FloatArray
    overlap: FloatArray
    scatter: float
    loss_scatter: float
    data: ModulusData | RelaxationData

    kind = "master curve"

    def _headline(self) -> str:
        return (
            f"{self.temperatures.size} sets, {self.temperatures[0]:.4g} to "
            f"{self.temperatures[-1]:.4g} deg C, at {self.reference:g}; factors "
            f"{self.decades.min():.3g} to {self.decades.max():.3g} decades, the least sure "
            f"+-{1.96 * self.uncertainty.max():.2g}; scatter {self.scatter:.2g} decades"
        )

    def to_dataset(self) -> Dataset:
        """Return the factors of the sets, and all rows at reduced frequencies (times)."""
        over = "frequencies" if isinstance(self.data, ModulusData) else "times"
        names = (over, "storage", "loss") if over == "frequencies" else (over, "modulus")
        return as_dataset(
            {
                "decades": ("temperature", self.decades),
                "uncertainty": ("temperature", self.uncertainty),
                "vertical": ("temperature", self.vertical),
                **{name: ("row", np.asarray(getattr(self.data, name))) for name in names},
            },
            coords={"temperature": ("temperature", self.temperatures, {"units": "deg C"})},
            attrs={
                "reference": self.reference,
                "scatter": self.scatter,
                "loss_scatter": self.loss_scatter,
                "quantity": self.data.quantity,
            },
        )

    @property
    def shift(self) -> ShiftTable:
        """Return the factors as a law, linear between the measured temperatures."""
        t, d = self.temperatures, self.decades
        if self.reference not in t:
            i = int(np.searchsorted(t, self.reference))
            t, d = np.insert(t, i, self.reference), np.insert(d, i, 0.0)
        return ShiftTable(temperatures=t, decades=d)

    def fit_law(self, law: str = "wlf") -> ShiftFit:
        """Fit "wlf" or "arrhenius" to the factors: see `fit_shift_law`."""
        return fit_shift_law(self.temperatures, self.decades, law=law, reference=self.reference)

    def plot(
        self,
        ax: "Axes | Sequence[Axes] | None" = None,
        *,
        law: ShiftLaw | None = None,
        x: str = "rad/s",
    ) -> Sequence[Axes]:
        """Draw the curve and the factors, with a law; ``x``: "rad/s" or "hz"."""
        # Import by name, because that module imports this one.
        return import_module("viscovib.plots.rubber").plot_master(self, ax, law=law, x=x)  # type: ignore[no-any-return]


def master_curve(
    data: ModulusData | RelaxationData,
    *,
    reference: float,
    by: str = "storage",
    vertical: str = "none",
    factors: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
) -> MasterCurve:
    """Shift sets at several temperatures onto each other.

    Parameters
    ----------
    data : ModulusData or RelaxationData
        With temperatures, in two sets or more.
    reference : float
        Reference temperature (deg C), within the measured range. Between two sets the factors are
        interpolated by a law (Arrhenius, WLF) through three sets, and the uncertainty includes this
        interpolation.
    by : {"storage", "loss", "both"}
        Quantity that is superposed.
    vertical : {"none", "density", "free"}
        Divide moduli by b_T: 1, the ratio of absolute temperatures, or a fitted value.
    factors : pair of array_like, optional
        Given temperatures and log10(a_T), 0 at the reference, which are used at the nearest sets.

    Returns
    -------
    MasterCurve

    Raises
    ------
    InputError
        Without temperatures, with a single temperature, or with neighbouring sets that do not
        overlap.

    Warns
    -----
    ConvergenceWarning
        If neighbouring sets overlap by less than 0.3 decades, or if given factors superpose the
        sets worse than fitted factors.

    Examples
    --------
    >>> law = vv.WLF(reference=20.0, c1=8.86, c2=101.6)
    >>> rubber = vv.ThermalKernel(
    ...     kernel=vv.RabotnovKernel(amplitude=2, alpha=0.5, beta=3), shift=law
    ... )
    >>> nu, warm = np.geomspace(1, 1e3, 10), [0.0, 10.0, 20.0, 30.0, 40.0]
    >>> stiff = np.concatenate([2e6 * (1 - rubber.at(t).transform(nu)) for t in warm])
    >>> data = vv.ModulusData(
    ...     frequencies=np.tile(nu, 5), storage=stiff.real, loss=stiff.imag,
    ...     temperature=np.repeat(warm, 10),
    ... )
    >>> master = vv.master_curve(data, reference=20.0)
    >>> bool(np.abs(master.decades - law.log10(warm)).max() < 0.01)
    True
    """
    _native.check_instance("data", data, ModulusData, RelaxationData)
    at = _native.number("reference", reference)
    _native.choice("by", by, _BY)
    _native.choice("vertical", vertical, _VERTICAL)
    sets = _checked_sets(data, at)
    curves = _curves(sets, by if isinstance(data, ModulusData) else "modulus")
    b = np.ones(len(sets))
    if vertical == "density":
        b = (curves.temperatures + KELVIN) / (at + KELVIN)
    flat = Curves(curves.x, curves.y - np.log10(b)[curves.owner], curves.owner, curves.temperatures)
    known = flat
    if by != "storage" and isinstance(data, ModulusData):
        # The storage is monotonic, so its levels give a first shift.
        first = _curves(sets, "storage")
        known = Curves(first.x, first.y - np.log10(b)[first.owner], first.owner, first.temperatures)
    ties = neighbours(known)
    decades, covariance, lift = superpose(flat, ties, vertical == "free", KNOTS)
    between, doubt = _place(curves.temperatures, decades, at)
    turn = _to_reference(curves.temperatures, at, between)
    own = turn @ decades
    # The vertical factor at the reference is 1.
    b = b * 10 ** (_to_reference(curves.temperatures, at) @ lift) if vertical == "free" else b
    spread = np.sqrt(np.maximum(np.diag(turn @ covariance @ turn.T), 0))
    if factors is None:
        by_parts = [
            turn @ superpose(flat, ties, vertical == "free", knots)[0] for knots in _OTHER_KNOTS
        ]
        spread = np.hypot(spread, np.ptp([own, *by_parts], axis=0) / 2)
        if vertical == "free":
            spread = np.hypot(spread, _other_parts(sets, by, ties, turn, own))
        spread = np.hypot(spread, flatness(flat, turn, scatter_of(flat, own)))
        spread = np.hypot(spread, doubt)
    if factors is not None:
        given = _given(factors, curves.temperatures, at)
        _compare(flat, given, own)
        own, spread = given, np.zeros_like(given)
    overlap = _overlap(curves, own)
    for i in np.flatnonzero(overlap < _THIN) if factors is None else ():
        warnings.warn(
            f"the sets at {curves.temperatures[i]:.4g} and {curves.temperatures[i + 1]:.4g} "
            f"deg C share {max(overlap[i], 0):.2g} decades of reduced frequency: their shift "
            "depends on the smoothness of the curve",
            ConvergenceWarning,
            stacklevel=caller(),
        )
    merged = _merged(sets, own, b)
    return MasterCurve(
        reference=at,
        temperatures=curves.temperatures,
        decades=own,
        uncertainty=spread,
        vertical=b,
        overlap=overlap,
        scatter=scatter_of(flat, own),
        loss_scatter=_loss_scatter(sets, own, b),
        data=merged,
    )


def _other_parts(
    sets: "Sequence[ModulusData | RelaxationData]", by: str, ties: Ties, turn: FloatArray,
    own: FloatArray,
) -> FloatArray:  # fmt: skip
    """Difference from the factors by storage and loss together.

    If a modulus is nearly a power of frequency, one part cannot separate both kinds of shifts.
    """
    if by == "both" or not isinstance(sets[0], ModulusData):
        return np.zeros_like(own)
    if any(np.min(one.loss) <= 0 for one in sets):  # type: ignore[union-attr]
        return np.zeros_like(own)
    return np.abs(turn @ superpose(_curves(sets, "both"), ties, True, KNOTS)[0] - own)


def _checked_sets(
    data: ModulusData | RelaxationData, at: float
) -> "list[ModulusData] | list[RelaxationData]":
    if data.temperature is None:
        raise InputError("data: has no temperatures, must have them for a master curve")
    sets = data.sets()
    means = np.array([_mean_temperature(one) for one in sets])
    if len(sets) < 2:
        raise InputError(
            f"data: has only one temperature, {means[0]:.4g} deg C, must have two or more sets"
        )
    same = np.flatnonzero(np.diff(means) < 1e-6)
    if same.size:
        raise InputError(
            f"data: two sets have the temperature {means[same[0]]:.4g} deg C, must be one for each"
        )
    if not means[0] <= at <= means[-1]:
        raise InputError(
            f"reference = {at:g}: must be within the temperatures measured, {means[0]:.4g} to "
            f"{means[-1]:.4g} deg C"
        )
    return sets


def _curves(sets: "Sequence[ModulusData | RelaxationData]", by: str) -> Curves:
    x, y, owner = [], [], []
    for i, one in enumerate(sets):
        if isinstance(one, ModulusData):
            x.append(np.log10(np.asarray(one.frequencies)))
            parts = {"storage": [one.storage], "loss": [one.loss], "both": [one.storage, one.loss]}
            rows = np.array([np.asarray(part) for part in parts[by]])
            if (rows <= 0).any():
                raise InputError("loss: contains 0, must be greater than 0 to be superposed")
            y.append(np.log10(rows))
        else:
            x.append(-np.log10(np.asarray(one.times)))
            y.append(np.log10(np.asarray(one.modulus))[np.newaxis])
        owner.append(np.full(x[-1].size, i))
        if x[-1].size < 3:
            raise InputError(f"data: set {i} has {x[-1].size} rows, must have at least 3")
    means = [_mean_temperature(one) for one in sets]
    return Curves(
        np.concatenate(x), np.concatenate(y, axis=1), np.concatenate(owner), np.array(means)
    )


def _mean_temperature(one: ModulusData | RelaxationData) -> float:
    """Mean temperature; for equal temperatures exactly this value, which may be the reference."""
    t = np.asarray(one.temperature, dtype=float)
    low = float(np.min(t))
    return low + float(np.mean(t - low))


def _to_reference(t: FloatArray, at: float, bend: float = 1.0) -> FloatArray:
    """Matrix that makes factors relative to a temperature between sets.

    A straight line or, with ``bend``, a hyperbola interpolates the factor: see `_place`.
    """
    i = _below(t, at)
    part = (at - t[i]) / (t[i + 1] - t[i]) * bend
    turn = np.eye(t.size)
    turn[:, i] -= 1 - part
    turn[:, i + 1] -= part
    return turn


def _below(t: FloatArray, at: float) -> int:
    return int(np.clip(np.searchsorted(t, at) - 1, 0, t.size - 2))


def _place(t: FloatArray, decades: FloatArray, at: float) -> tuple[float, float]:
    """Curvature of the factors between sets around a temperature, and its uncertainty (decades).

    The laws of Arrhenius and of Williams, Landel and Ferry are hyperbolas c + b/(T - p). Between
    T_0 and T_1 the value is the fraction (T - T_0)/(T_1 - T_0) (T_1 - p)/(T - p) of the difference.
    Three sets determine p by the ratio of their slopes r = (T_2 - p)/(T_0 - p). With two sets p
    lies between far below (a straight line) and 51.6 K below the colder set, if this is at its
    glass transition (universal constant of the law).
    """
    i = _below(t, at)
    if at in (t[i], t[i + 1]):
        return 1.0, 0.0
    bends = []
    for j in (i - 1, i):
        if 0 <= j <= t.size - 3:
            low, middle = np.diff(decades[j : j + 3]) / np.diff(t[j : j + 3])
            if low * middle > 0:
                r = low / middle
                ahead = r * (t[i + 1] - t[j]) + t[j + 2] - t[i + 1]
                bends.append(float(ahead / (r * (at - t[j]) + t[j + 2] - at)))
    pole = t[i] - _UNIVERSAL
    open_to = [1.0, *(bends or [(t[i + 1] - pole) / (at - pole)])]
    widest = bends if len(bends) == 2 else open_to
    bend = float(np.mean(bends or widest))
    way = (at - t[i]) / (t[i + 1] - t[i]) * (decades[i + 1] - decades[i])
    return bend, float(abs(way) * np.ptp(widest) / 2)


def _loss_scatter(
    sets: "Sequence[ModulusData | RelaxationData]", decades: FloatArray, b: FloatArray
) -> float:
    if not isinstance(sets[0], ModulusData) or any(np.min(one.loss) <= 0 for one in sets):  # type: ignore[union-attr]
        return float("nan")
    curves = _curves(sets, "loss")
    flat = curves.y - np.log10(b)[curves.owner]
    return scatter_of(Curves(curves.x, flat, curves.owner, curves.temperatures), decades)


def _given(
    factors: tuple[npt.ArrayLike, npt.ArrayLike], t: FloatArray, reference: float
) -> FloatArray:
    if not isinstance(factors, (tuple, list)) or len(factors) != 2:
        raise InputError("factors: must be a pair: temperatures, log10(a_T)")
    at = bounded("factors[0]", factors[0], "temperatures")
    decades = bounded("factors[1]", factors[1], "decades")
    if at.size != decades.size or at.size == 0:
        raise InputError(f"factors: {at.size} temperatures and {decades.size} factors must match")
    _check_zero(at, decades, reference)
    near = np.abs(at[:, np.newaxis] - t).argmin(axis=0)
    far = np.abs(at[near] - t)
    if far.max() > 3:
        i = int(far.argmax())
        raise InputError(f"factors: none within 3 K of the set at {t[i]:.4g} deg C")
    return np.asarray(decades[near])


def _check_zero(t: FloatArray, decades: FloatArray, at: float) -> None:
    """Refuse factors with a different reference: data would get a wrong temperature."""
    t, rows = np.unique(t, return_index=True)
    decades = decades[rows]
    if t[0] < at < t[-1]:
        bend, doubt = _place(t, decades, at)
        found = float(decades[0] - (_to_reference(t, at, bend) @ decades)[0])
    else:
        found, doubt = float(decades[np.abs(t - at).argmin()]), 0.0
    if abs(found) > _ZERO + 2 * doubt:
        raise InputError(
            f"factors: log10(a_T) is {found:.3g} at the reference, {at:g} deg C, must be 0 there"
        )


def _compare(curves: Curves, given: FloatArray, own: FloatArray) -> None:
    theirs, ours = scatter_of(curves, given), scatter_of(curves, own)
    if theirs > _WORSE * ours:
        warnings.warn(
            f"with the given factors the scatter is {theirs:.2g} decades, with fitted factors "
            f"{ours:.2g}: they may belong to another material",
            ConvergenceWarning,
            stacklevel=caller(),
        )


def _overlap(curves: Curves, decades: FloatArray) -> FloatArray:
    ends = []
    for i in range(decades.size):
        x = curves.x[curves.owner == i] + decades[i]
        ends.append((x.min(), x.max()))
    return np.array([min(a[1], b[1]) - max(a[0], b[0]) for a, b in pairwise(ends)])


def _merged(
    sets: "Sequence[ModulusData | RelaxationData]", decades: FloatArray, b: FloatArray
) -> ModulusData | RelaxationData:
    slow = 10**decades
    if isinstance(sets[0], ModulusData):
        columns = [
            _stacked(sets, name, by)
            for name, by in (("frequencies", slow), ("storage", 1 / b), ("loss", 1 / b))
        ]
        nu, storage, loss = (column[np.argsort(columns[0], kind="stable")] for column in columns)
        return ModulusData(
            frequencies=_apart(nu), storage=storage, loss=loss, quantity=sets[0].quantity
        )
    times, modulus = (
        np.concatenate(
            [np.asarray(getattr(one, name)) * f for one, f in zip(sets, by, strict=True)]
        )
        for name, by in (("times", 1 / slow), ("modulus", 1 / b))
    )
    order = np.argsort(times, kind="stable")
    return RelaxationData(
        times=_apart(times[order]), modulus=modulus[order], quantity=sets[0].quantity
    )


def _stacked(
    sets: "Sequence[ModulusData | RelaxationData]", name: str, factors: FloatArray
) -> FloatArray:
    """A column of all sets, each multiplied by its factor."""
    pairs = zip(sets, factors, strict=True)
    return np.concatenate([np.asarray(getattr(one, name)) * factor for one, factor in pairs])


def _apart(x: FloatArray) -> FloatArray:
    """Make values strictly ascending: equal values are increased by a few ulps."""
    for i in range(1, x.size):
        if x[i] <= x[i - 1]:
            x[i] = x[i - 1] * (1 + 4e-16)
    return x
