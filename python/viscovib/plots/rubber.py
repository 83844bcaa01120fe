"""Plots of rubber measurements, master curves, fits and bands."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib.common.parameters import Text, Word
from viscovib.common.results import Axes
from viscovib.errors import InputError
from viscovib.kernels.time_temperature import ShiftLaw
from viscovib.plots.panels import panel, panels
from viscovib.rubber.bands import Band
from viscovib.rubber.data import ModulusData
from viscovib.rubber.fit import KernelFit, Profile
from viscovib.rubber.kramers_kronig_pair import KramersKronig
from viscovib.rubber.master import MasterCurve

_DARK, _BRIGHT, _WARM = "#0b1d51", "#c8452e", "#e08e1b"
_MARKS = ("o", "s", "^", "D", "v")
_X = Word("x", ("rad/s", "hz"))


def plot_modulus(
    data: ModulusData, ax: "Axes | Sequence[Axes] | None" = None, *, x: str = "rad/s"
) -> Sequence[Axes]:
    """Draw storage and loss over frequency, and the loss factor below them.

    Parameters
    ----------
    data : ModulusData
        Sets are coloured from cold to warm, with a colour bar of the temperatures.
    ax : two Axes, optional
        Axes of the plot; None creates a figure.
    x : {"rad/s", "hz"}
        Unit of the frequencies.

    Returns
    -------
    sequence of Axes

    Examples
    --------
    >>> raw = vv.read_dma("data/rubber/pyvisco_freq_user_raw.csv")
    >>> axes = vv.plot_modulus(raw)
    """
    _native.check_instance("data", data, ModulusData)
    per, label = _frequency(x)
    upper, lower = panels(ax, 2, "moduli and loss factor")
    sets = data.sets()
    for i, (one, colour) in enumerate(zip(sets, _shades(sets), strict=True)):
        nu = np.asarray(one.frequencies) * per
        first = i == 0
        upper.loglog(nu, one.storage, "-o", color=colour, ms=3, label="storage" if first else None)
        upper.loglog(
            nu, one.loss, "--s", color=colour, ms=3, mfc="none", label="loss" if first else None
        )
        lower.loglog(nu, one.loss_factor, "-^", color=colour, ms=3)
    upper.set_ylabel(_label(data))
    upper.legend()
    lower.set_ylabel("loss factor")
    lower.set_xlabel(label)
    _add_temperatures(sets, [upper, lower])
    return [upper, lower]


def plot_cole_cole(data: ModulusData, ax: "Axes | None" = None) -> Axes:
    """Draw loss over storage (Cole-Cole plot): one arc for a material at all temperatures.

    Examples
    --------
    >>> raw = vv.read_dma("data/rubber/pyvisco_freq_user_raw.csv")
    >>> axes = vv.plot_cole_cole(raw)
    """
    return _without_frequency(data, ax, log=False)


def plot_van_gurp(data: ModulusData, ax: "Axes | None" = None) -> Axes:
    """Draw the loss angle over |M*| (van Gurp-Palmen plot): one curve for sets that superpose.

    Examples
    --------
    >>> raw = vv.read_dma("data/rubber/pyvisco_freq_user_raw.csv")
    >>> axes = vv.plot_van_gurp(raw)
    """
    return _without_frequency(data, ax, log=True)


def _without_frequency(data: ModulusData, ax: "Axes | None", log: bool) -> Axes:
    _native.check_instance("data", data, ModulusData)
    axes = panel(ax)
    sets = data.sets()
    for i, (one, colour) in enumerate(zip(sets, _shades(sets), strict=True)):
        x, y = np.asarray(one.storage), np.asarray(one.loss)
        if log:
            x, y = np.abs(one.modulus), np.degrees(np.angle(one.modulus))
        mark = _MARKS[i % len(_MARKS)]
        axes.plot(x, y, "-" + mark, color=colour, ms=3)
    if log:
        axes.set_xscale("log")
    axes.set_xlabel(f"|{data.quantity}*| {_unit(data)}" if log else _label(data, "'"))
    axes.set_ylabel("loss angle (degrees)" if log else _label(data, "''"))
    _add_temperatures(sets, [axes])
    return axes


def plot_ratio(check: KramersKronig, ax: "Axes | None" = None, *, x: str = "rad/s") -> Axes:
    """Draw the ratio of measured loss to the loss that follows from the storage."""
    per, label = _frequency(x)
    axes = panel(ax, (7, 3.5))
    axes.loglog(np.asarray(check.frequencies) * per, check.ratio, "o", ms=3, color=_DARK)
    axes.axhspan(1 / 1.25, 1.25, color=_WARM, alpha=0.3, lw=0)
    axes.axhline(1, color="k", lw=0.8)
    axes.set_xlabel(label)
    axes.set_ylabel("loss / expected loss")
    return axes


def plot_master(
    master: MasterCurve,
    ax: "Axes | Sequence[Axes] | None" = None,
    *,
    law: ShiftLaw | None = None,
    x: str = "rad/s",
) -> Sequence[Axes]:
    """Draw the master curve and, below it, the factors with 95 % intervals and a law."""
    _native.check_instance("master", master, MasterCurve)
    per, label = _frequency(x)
    if law is not None:
        _native.check_instance("law", law, ShiftLaw)
    if ax is None:
        import matplotlib.pyplot as plt

        ax = list(plt.figure(figsize=(7, 7), layout="constrained").subplots(2, 1))
    upper, lower = panels(ax, 2, "curve and factors")
    data = master.data
    if isinstance(data, ModulusData):
        nu = np.asarray(data.frequencies) * per
        upper.loglog(nu, data.storage, "o", ms=3, color=_DARK, label="storage")
        upper.loglog(nu, data.loss, "s", ms=3, mfc="none", color=_BRIGHT, label="loss")
        upper.set_xlabel(f"reduced {label} at {master.reference:g} deg C")
        upper.set_ylabel(_label(data))
        upper.legend()
    else:
        upper.loglog(data.times, data.modulus, "o", ms=3, color=_DARK)
        upper.set_xlabel(f"reduced time (s) at {master.reference:g} deg C")
        upper.set_ylabel(f"{data.quantity} {_unit(data)}")
    t = master.temperatures
    lower.errorbar(
        t, master.decades, 1.96 * master.uncertainty, fmt="o", ms=4, color=_DARK, capsize=2
    )
    if law is not None:
        fine = np.linspace(t[0], t[-1], 200)
        lower.plot(fine, law.log10(fine), "--", color=_BRIGHT, label=type(law).__name__)
        lower.legend()
    lower.set_xlabel("temperature (deg C)")
    lower.set_ylabel(r"$\log_{10} a_T$")
    return [upper, lower]


def plot_nomogram(
    master: MasterCurve,
    temperatures: npt.ArrayLike | None = None,
    ax: "Axes | None" = None,
    *,
    x: str = "rad/s",
) -> Axes:
    """Draw the reduced-frequency nomogram (Jones, 1978).

    The moduli are drawn over reduced frequency, with the frequency on the right axis: a horizontal
    line from a frequency meets the inclined line of a temperature above the reduced frequency.

    Parameters
    ----------
    master : MasterCurve
        Of storage and loss.
    temperatures : array_like, optional
        Temperatures of the inclined lines (deg C), within the measured range; default: those of the
        sets.
    ax : Axes, optional
        Axes of the plot; None creates a figure.
    x : {"rad/s", "hz"}
        Unit of the frequencies.

    Examples
    --------
    >>> raw = vv.read_dma("data/rubber/pyvisco_freq_user_raw.csv")
    >>> ax = vv.plot_nomogram(vv.master_curve(raw, reference=60), [40, 60, 80])
    """
    _native.check_instance("master", master, MasterCurve)
    data = master.data
    if not isinstance(data, ModulusData):
        raise InputError("master: is over time, must be of storage and loss")
    per, label = _frequency(x)
    axes = panel(ax)
    reduced = np.asarray(data.frequencies) * per
    axes.loglog(reduced, data.storage, "o", ms=3, color=_DARK, label="storage")
    axes.loglog(reduced, data.loss, "s", ms=3, mfc="none", color=_BRIGHT, label="loss")
    axes.set_xlabel(f"reduced {label}")
    axes.set_ylabel(_label(data))
    axes.legend(loc="upper left")
    right = axes.twinx()
    right.set_yscale("log")
    right.set_ylabel(label)
    wanted = (
        master.temperatures
        if temperatures is None
        else np.ravel(_native.real_array("temperatures", temperatures))
    )
    shift = master.shift
    low, high = reduced.min(), reduced.max()
    ends = np.array([1e-2, 1e4]) * per
    for t in wanted.tolist():
        across = ends * shift(t)
        inside = (across >= low * 0.1) & (across <= high * 10)
        if inside.any():
            right.plot(across, ends, "-", lw=0.6, color="0.5")
            right.annotate(
                f"{t:.3g}", (across[1], ends[1]), fontsize=7, rotation=90, va="bottom", ha="center"
            )
    right.set_ylim(*ends)
    axes.set_xlim(low, high)
    return axes


def plot_fit(
    fit: KernelFit, ax: "Axes | Sequence[Axes] | None" = None, *, x: str = "rad/s"
) -> Sequence[Axes]:
    """Draw measurements and fit, with the 95 % band of the curve, and the residuals below.

    The band contains the uncertainty of the parameters only.

    Parameters
    ----------
    fit : KernelFit
    ax : Axes or two Axes, optional
        A single axis shows the curve without residuals; None creates a figure with both.
    x : {"rad/s", "hz"}
        Unit of the frequencies.

    Returns
    -------
    sequence of Axes
    """
    _native.check_instance("fit", fit, KernelFit)
    axes = _axes_of_fit(ax)
    measured, said, error = fit.measured, fit._predicted(), fit._predicted_error()
    n = measured.log_rates.size
    if isinstance(measured.data, ModulusData):
        per, label = _frequency(x)
        place = np.exp(measured.log_rates) * per
        parts = [("storage", slice(0, n), "o", _DARK), ("loss", slice(n, 2 * n), "s", _BRIGHT)]
    else:
        place, label = np.exp(-measured.log_rates), "time (s)"
        parts = [("", slice(0, n), "o", _DARK)]
    order = np.argsort(place)
    for name, part, mark, colour in parts:
        target, curve, reach = measured.target[part], said[part], error[part]
        axes[0].loglog(place, target, mark, ms=3, mfc="none", color=colour, label=name or None)
        axes[0].loglog(place[order], curve[order], "-", color=colour)
        if np.isfinite(reach).all():
            # Relative limits, because the axis is logarithmic.
            factor = np.exp(reach / np.abs(curve))[order]
            low, high = curve[order] / factor, curve[order] * factor
            axes[0].fill_between(place[order], low, high, color=colour, alpha=0.25, lw=0)
        if len(axes) > 1:
            axes[1].semilogx(place, 100 * (target / curve - 1), mark, ms=3, color=colour)
    if len(axes) > 1:
        axes[1].axhline(0, color="k", lw=0.8)
        axes[1].set_ylabel("residual (%)")
    axes[-1].set_xlabel(label)
    axes[0].set_ylabel(_label(measured.data))
    if len(parts) > 1:
        axes[0].legend()
    return axes


def _axes_of_fit(ax: "Axes | Sequence[Axes] | None") -> "list[Axes]":
    """Return one axis for the curve, or two for the curve and its residuals."""
    from matplotlib.axes import Axes

    if ax is None:
        import matplotlib.pyplot as plt

        figure = plt.figure(figsize=(7, 5.5), layout="constrained")
        return list(figure.subplots(2, 1, sharex=True, height_ratios=(3, 1)))
    return [panel(ax)] if isinstance(ax, Axes) else panels(ax, 2, "curve and residuals")


def plot_profile(profile: Profile, ax: "Axes | None" = None) -> Axes:
    """Draw the rise of the sum of squares over the parameter, with its interval."""
    axes = panel(ax, (6, 3.6))
    inside = np.isfinite(profile.rise)
    axes.plot(profile.values[inside], profile.rise[inside], "o-", ms=3, color=_DARK)
    low = max(profile.interval[0], float(profile.values[0]))
    high = min(profile.interval[1], float(profile.values[-1]))
    axes.axvspan(low, high, color=_WARM, alpha=0.3, lw=0, label=f"{100 * profile.level:g} %")
    axes.set_xlabel(profile.name)
    axes.set_ylabel("rise of the sum of squares")
    axes.legend()
    return axes


def plot_band(band: Band, x: npt.ArrayLike, ax: "Axes | None" = None, *, label: str = "") -> Axes:
    """Draw the band and the nominal result over x."""
    place, title = _native.real_array("x", x, ndim=1), Text("label").check(label)
    if band.nominal.shape != place.shape:
        raise InputError(f"x: has shape {place.shape}, answers have {band.nominal.shape}")
    axes = panel(ax)
    name = f"{100 * band.level:g} %, parameters only"
    axes.fill_between(place, band.low, band.high, color=_WARM, alpha=0.5, lw=0, label=name)
    axes.plot(place, band.nominal, color=_DARK, lw=1.2, label=title or "fit")
    axes.legend()
    return axes


def _frequency(x: str) -> tuple[float, str]:
    """Return the factor from rad/s to the unit x, and the label of the axis."""
    if _X.check(x) == "hz":
        return 1 / (2 * math.pi), "frequency (Hz)"
    return 1.0, "circular frequency (rad/s)"


def _temperatures(sets: Sequence[ModulusData]) -> list[float] | None:
    """Return the mean temperature of each set, or None if a set has none."""
    found = [np.asarray(one.temperature) for one in sets if one.temperature is not None]
    return [float(one.mean()) for one in found] if len(found) == len(sets) else None


def _colours() -> Any:
    """Return the colour map: blue for cold, orange for warm."""
    from matplotlib.colors import LinearSegmentedColormap

    ends = [(0.04, 0.11, 0.32), (0.88, 0.45, 0.11)]
    return LinearSegmentedColormap.from_list("temperature", ends)


def _shades(sets: Sequence[ModulusData]) -> list[Any]:
    """Return a colour for each set by its temperature; without one, by its index."""
    values = np.array(_temperatures(sets) or range(len(sets)))
    span = np.ptp(values)
    return [_colours()(part) for part in (values - values.min()) / (span if span > 0 else 1.0)]


def _add_temperatures(sets: Sequence[ModulusData], axes: Sequence[Axes]) -> None:
    """Add a colour bar if the sets have different temperatures."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    values = _temperatures(sets)
    if values is None or max(values) == min(values):
        return
    scale = ScalarMappable(Normalize(min(values), max(values)), _colours())
    axes[0].figure.colorbar(scale, ax=list(axes), label="temperature (deg C)")


def _unit(data: Any) -> str:
    return "(N/m)" if data.quantity == "K" else "(Pa)"


def _label(data: Any, part: str = "") -> str:
    return f"{data.quantity}{part} {_unit(data)}"
