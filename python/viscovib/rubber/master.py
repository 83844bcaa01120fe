"""Master curves: sets at several temperatures, shifted over each other.

All sets lie on one curve y = s(log10 f + log10 a_T), y the logarithm of the storage (or loss, or
the modulus over time), s a cubic spline with a weak penalty on its bends. Shift factors and spline
are found together by least squares, so that the covariance of the factors says how sure each is:
where neighbours hardly overlap, the curve between them hardly ties them.
"""

import warnings
from dataclasses import dataclass
from importlib import import_module
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.results import Result
from viscovib.errors import ConvergenceWarning, InputError
from viscovib.kernels.time_temperature import KELVIN, ShiftLaw
from viscovib.rubber.data import ModulusData, RelaxationData
from viscovib.rubber.shift_fit import ShiftFit, ShiftTable, bounded, fit_shift_law
from viscovib.rubber.superposition import KNOTS, Curves, flatness, neighbours, scatter_of, superpose

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray as xr
    from matplotlib.axes import Axes

_BY = ("storage", "loss", "both")
_VERTICAL = ("none", "density", "free")
#: Other distances of knots: what factors owe to this choice belongs to their uncertainty.
_OTHER_KNOTS = (0.8,)
#: A set that others overlap by less (decades) is told; so are given factors that superpose this
#: much worse than those found here.
_THIN, _WORSE = 0.3, 2.0


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MasterCurve(Result):
    """Sets over each other, at a reference temperature.

    Attributes
    ----------
    reference : float
        Degrees Celsius.
    temperatures, decades, uncertainty : ndarray, shape (n,)
        Of each set, from cold to warm: its mean temperature, log10(a_T), and the standard
        uncertainty of that relative to the reference.
    vertical : ndarray, shape (n,)
        b_T: measured moduli were divided by it.
    overlap : ndarray, shape (n-1,)
        Decades of reduced frequency that neighbours share.
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

    def to_dataset(self) -> "xr.Dataset":
        """Factors of the sets, and all rows at reduced frequencies (times)."""
        import xarray as xr

        over = "frequencies" if isinstance(self.data, ModulusData) else "times"
        names = (over, "storage", "loss") if over == "frequencies" else (over, "modulus")
        return xr.Dataset(
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
        """The factors as a law, straight between the temperatures measured."""
        t, d = self.temperatures, self.decades
        if self.reference not in t:
            i = int(np.searchsorted(t, self.reference))
            t, d = np.insert(t, i, self.reference), np.insert(d, i, 0.0)
        return ShiftTable(temperatures=t, decades=d)

    def fit_law(self, law: str = "wlf") -> ShiftFit:
        """Fit "wlf" or "arrhenius" to the factors: see `fit_shift_law`."""
        return fit_shift_law(self.temperatures, self.decades, law=law, reference=self.reference)

    def plot(
        self, ax: "Axes | Sequence[Axes] | None" = None, *, law: ShiftLaw | None = None
    ) -> "Sequence[Axes]":
        """Draw the curve and the factors: see `plot_master`."""
        # By name, since that module knows this one.
        return import_module("viscovib.plots.rubber").plot_master(self, ax, law=law)  # type: ignore[no-any-return]


def master_curve(
    data: ModulusData | RelaxationData,
    *,
    reference: float,
    by: str = "storage",
    vertical: str = "none",
    factors: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
) -> MasterCurve:
    """Shift sets at several temperatures over each other.

    Parameters
    ----------
    data : ModulusData or RelaxationData
        With temperatures, in two sets or more.
    reference : float
        Temperature of the curve (deg C), within those measured.
    by : {"storage", "loss", "both"}
        What is superposed.
    vertical : {"none", "density", "free"}
        Divide moduli by b_T: 1, the absolute temperature over that of the reference, or what fits.
    factors : pair of array_like, optional
        Temperatures and log10(a_T) to be taken as they are, at the nearest sets.

    Returns
    -------
    MasterCurve

    Raises
    ------
    InputError
        Without temperatures, with one alone, or with neighbours that do not overlap.

    Warns
    -----
    ConvergenceWarning
        Where neighbours overlap by less than 0.3 decades; for given factors that superpose the sets
        worse than those found here.

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
        # Storage alone rises all the way, so that its levels tell a first shift.
        first = _curves(sets, "storage")
        known = Curves(first.x, first.y - np.log10(b)[first.owner], first.owner, first.temperatures)
    ties = neighbours(known)
    decades, covariance, lift = superpose(flat, ties, vertical == "free", KNOTS)
    turn = _to_reference(curves.temperatures, at)
    own = turn @ decades
    # The lift of the reference is 1 as well.
    b = b * 10 ** (turn @ lift) if vertical == "free" else b
    spread = np.sqrt(np.maximum(np.diag(turn @ covariance @ turn.T), 0))
    if factors is None:
        others = [
            turn @ superpose(flat, ties, vertical == "free", knots)[0] for knots in _OTHER_KNOTS
        ]
        spread = np.hypot(spread, np.ptp([own, *others], axis=0) / 2)
        spread = np.hypot(spread, flatness(flat, turn, scatter_of(flat, own)))
    if factors is not None:
        given = _given(factors, curves.temperatures)
        _compare(flat, given, own)
        own, spread = given, np.zeros_like(given)
    overlap = _overlap(curves, own)
    for i in np.flatnonzero(overlap < _THIN) if factors is None else ():
        warnings.warn(
            f"the sets at {curves.temperatures[i]:.4g} and {curves.temperatures[i + 1]:.4g} deg C "
            f"share {max(overlap[i], 0):.2g} decades of reduced frequency: their shift is known "
            "only as far as the curve is smooth",
            ConvergenceWarning,
            stacklevel=2,
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


def _checked_sets(
    data: ModulusData | RelaxationData, at: float
) -> "list[ModulusData] | list[RelaxationData]":
    if data.temperature is None:
        raise InputError("data: has no temperatures, must have them for a master curve")
    sets = data.sets()
    means = np.array([np.mean(np.asarray(one.temperature)) for one in sets])
    if len(sets) < 2:
        raise InputError(
            f"data: has one temperature alone, {means[0]:.4g} deg C, must have two or more sets"
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
                raise InputError("loss: holds 0, must be greater than 0 to be superposed")
            y.append(np.log10(rows))
        else:
            x.append(-np.log10(np.asarray(one.times)))
            y.append(np.log10(np.asarray(one.modulus))[np.newaxis])
        owner.append(np.full(x[-1].size, i))
        if x[-1].size < 3:
            raise InputError(f"data: set {i} has {x[-1].size} rows, must have at least 3")
    means = [float(np.mean(np.asarray(one.temperature))) for one in sets]
    return Curves(
        np.concatenate(x), np.concatenate(y, axis=1), np.concatenate(owner), np.array(means)
    )


def _to_reference(t: FloatArray, at: float) -> FloatArray:
    """Matrix that takes factors to those relative to a temperature, straight between sets."""
    i = int(np.clip(np.searchsorted(t, at) - 1, 0, t.size - 2))
    part = (at - t[i]) / (t[i + 1] - t[i])
    turn = np.eye(t.size)
    turn[:, i] -= 1 - part
    turn[:, i + 1] -= part
    return turn


def _loss_scatter(
    sets: "Sequence[ModulusData | RelaxationData]", decades: FloatArray, b: FloatArray
) -> float:
    if not isinstance(sets[0], ModulusData) or any(np.min(one.loss) <= 0 for one in sets):  # type: ignore[union-attr]
        return float("nan")
    curves = _curves(sets, "loss")
    flat = curves.y - np.log10(b)[curves.owner]
    return scatter_of(Curves(curves.x, flat, curves.owner, curves.temperatures), decades)


def _given(factors: tuple[npt.ArrayLike, npt.ArrayLike], t: FloatArray) -> FloatArray:
    if not isinstance(factors, (tuple, list)) or len(factors) != 2:
        raise InputError("factors: must be a pair: temperatures, log10(a_T)")
    at = bounded("factors[0]", factors[0], "temperatures")
    decades = bounded("factors[1]", factors[1], "decades")
    if at.size != decades.size or at.size == 0:
        raise InputError(f"factors: {at.size} temperatures and {decades.size} factors must match")
    near = np.abs(at[:, np.newaxis] - t).argmin(axis=0)
    far = np.abs(at[near] - t)
    if far.max() > 3:
        i = int(far.argmax())
        raise InputError(f"factors: none within 3 K of the set at {t[i]:.4g} deg C")
    return np.asarray(decades[near])


def _compare(curves: Curves, given: FloatArray, own: FloatArray) -> None:
    theirs, ours = scatter_of(curves, given), scatter_of(curves, own)
    if theirs > _WORSE * ours:
        warnings.warn(
            f"the given factors leave a scatter of {theirs:.2g} decades, those of the sets "
            f"themselves {ours:.2g}: they may belong to another material",
            ConvergenceWarning,
            stacklevel=3,
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
    """A column of all sets, each times its factor."""
    pairs = zip(sets, factors, strict=True)
    return np.concatenate([np.asarray(getattr(one, name)) * factor for one, factor in pairs])


def _apart(x: FloatArray) -> FloatArray:
    """Values that ascend strictly: of equal ones the later is moved by a few roundings."""
    for i in range(1, x.size):
        if x[i] <= x[i - 1]:
            x[i] = x[i - 1] * (1 + 4e-16)
    return x
