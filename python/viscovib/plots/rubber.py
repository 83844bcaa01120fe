"""Pictures of measurements of rubber, master curves, fits and bands."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib.common.parameters import Text
from viscovib.errors import InputError
from viscovib.kernels.time_temperature import ShiftLaw
from viscovib.plots.panels import panel, panels
from viscovib.rubber.bands import Band
from viscovib.rubber.data import ModulusData
from viscovib.rubber.fit import KernelFit
from viscovib.rubber.kramers_kronig_pair import KramersKronig
from viscovib.rubber.master import MasterCurve

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_DARK, _BRIGHT, _WARM = "#0b1d51", "#c8452e", "#e08e1b"
_MARKS = ("o", "s", "^", "D", "v")
_FREQUENCY = "circular frequency (rad/s)"


def plot_modulus(data: ModulusData, ax: "Axes | Sequence[Axes] | None" = None) -> "Sequence[Axes]":
    """Draw storage and loss, and the loss factor below, over frequency.

    Parameters
    ----------
    data : ModulusData
        Sets are coloured from cold to warm.
    ax : two Axes, optional
        Axes of the plot; None creates a figure.

    Returns
    -------
    sequence of Axes

    Examples
    --------
    >>> raw = vv.read_dma("data/rubber/pyvisco_freq_user_raw.csv")
    >>> axes = vv.plot_modulus(raw)
    """
    _native.check_instance("data", data, ModulusData)
    upper, lower = panels(ax, 2, "moduli and loss factor")
    sets = data.sets()
    for i, one in enumerate(sets):
        nu, colour = np.asarray(one.frequencies), _shade(i, len(sets))
        first = i == 0
        upper.loglog(nu, one.storage, "-o", color=colour, ms=3, label="storage" if first else None)
        upper.loglog(
            nu, one.loss, "--s", color=colour, ms=3, mfc="none", label="loss" if first else None
        )
        lower.loglog(nu, one.loss_factor, "-^", color=colour, ms=3)
    upper.set_ylabel(_label(data))
    upper.legend()
    lower.set_ylabel("loss factor")
    lower.set_xlabel(_FREQUENCY)
    return [upper, lower]


def plot_cole_cole(data: ModulusData, ax: "Axes | None" = None) -> "Axes":
    """Draw loss over storage (Cole-Cole plot): one arc for a material at all temperatures.

    Examples
    --------
    >>> raw = vv.read_dma("data/rubber/pyvisco_freq_user_raw.csv")
    >>> axes = vv.plot_cole_cole(raw)
    """
    return _without_frequency(data, ax, log=False)


def plot_van_gurp(data: ModulusData, ax: "Axes | None" = None) -> "Axes":
    """Draw the loss angle over |M*| (van Gurp-Palmen plot): one curve for sets that superpose.

    Examples
    --------
    >>> raw = vv.read_dma("data/rubber/pyvisco_freq_user_raw.csv")
    >>> axes = vv.plot_van_gurp(raw)
    """
    return _without_frequency(data, ax, log=True)


def _without_frequency(data: ModulusData, ax: "Axes | None", log: bool) -> "Axes":
    _native.check_instance("data", data, ModulusData)
    axes = panel(ax)
    sets = data.sets()
    for i, one in enumerate(sets):
        x, y = np.asarray(one.storage), np.asarray(one.loss)
        if log:
            x, y = np.abs(one.modulus), np.degrees(np.angle(one.modulus))
        mark = _MARKS[i % len(_MARKS)]
        axes.plot(x, y, "-" + mark, color=_shade(i, len(sets)), ms=3, label=_warmth(one))
    if log:
        axes.set_xscale("log")
    axes.set_xlabel(f"|{data.quantity}*| {_unit(data)}" if log else _label(data, "'"))
    axes.set_ylabel("loss angle (degrees)" if log else _label(data, "''"))
    if 1 < len(sets) <= 8 and data.temperature is not None:
        axes.legend()
    return axes


def plot_ratio(check: KramersKronig, ax: "Axes | None" = None) -> "Axes":
    """Draw measured loss over the loss that belongs to the storage."""
    axes = panel(ax, (7, 3.5))
    axes.loglog(check.frequencies, check.ratio, "o", ms=3, color=_DARK)
    axes.axhspan(1 / 1.25, 1.25, color=_WARM, alpha=0.3, lw=0)
    axes.axhline(1, color="k", lw=0.8)
    axes.set_xlabel(_FREQUENCY)
    axes.set_ylabel("loss / expected loss")
    return axes


def plot_master(
    master: MasterCurve,
    ax: "Axes | Sequence[Axes] | None" = None,
    *,
    law: ShiftLaw | None = None,
) -> "Sequence[Axes]":
    """Draw the curve and, below, the factors with their 95 % intervals and a law."""
    _native.check_instance("master", master, MasterCurve)
    if law is not None:
        _native.check_instance("law", law, ShiftLaw)
    if ax is None:
        import matplotlib.pyplot as plt

        ax = list(plt.figure(figsize=(7, 7), layout="constrained").subplots(2, 1))
    upper, lower = panels(ax, 2, "curve and factors")
    data = master.data
    if isinstance(data, ModulusData):
        upper.loglog(data.frequencies, data.storage, "o", ms=3, color=_DARK, label="storage")
        upper.loglog(
            data.frequencies, data.loss, "s", ms=3, mfc="none", color=_BRIGHT, label="loss"
        )
        upper.set_xlabel(f"reduced {_FREQUENCY} at {master.reference:g} deg C")
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
) -> "Axes":
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

    Examples
    --------
    >>> raw = vv.read_dma("data/rubber/pyvisco_freq_user_raw.csv")
    >>> ax = vv.plot_nomogram(vv.master_curve(raw, reference=60), [40, 60, 80])
    """
    _native.check_instance("master", master, MasterCurve)
    data = master.data
    if not isinstance(data, ModulusData):
        raise InputError("master: is over time, must be of storage and loss")
    axes = panel(ax)
    reduced = np.asarray(data.frequencies)
    axes.loglog(reduced, data.storage, "o", ms=3, color=_DARK, label="storage")
    axes.loglog(reduced, data.loss, "s", ms=3, mfc="none", color=_BRIGHT, label="loss")
    axes.set_xlabel(f"reduced {_FREQUENCY}")
    axes.set_ylabel(_label(data))
    axes.legend(loc="upper left")
    right = axes.twinx()
    right.set_yscale("log")
    right.set_ylabel(_FREQUENCY)
    wanted = (
        master.temperatures
        if temperatures is None
        else np.ravel(_native.real_array("temperatures", temperatures))
    )
    shift = master.shift
    low, high = reduced.min(), reduced.max()
    ends = np.array([1e-2, 1e4])
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


def plot_fit(fit: KernelFit, ax: "Axes | None" = None) -> "Axes":
    """Draw measurements and fit."""
    _native.check_instance("fit", fit, KernelFit)
    axes = panel(ax)
    measured = fit.measured
    said = fit._predicted()
    if isinstance(measured.data, ModulusData):
        nu = np.exp(measured.log_rates)
        order, n = np.argsort(nu), nu.size
        for part, mark, colour, name in (
            (slice(0, n), "o", _DARK, "storage"),
            (slice(n, 2 * n), "s", _BRIGHT, "loss"),
        ):
            axes.loglog(nu, measured.target[part], mark, ms=3, mfc="none", color=colour, label=name)
            axes.loglog(nu[order], said[part][order], "-", color=colour)
        axes.set_xlabel(_FREQUENCY)
        axes.legend()
    else:
        t = np.exp(-measured.log_rates)
        order = np.argsort(t)
        axes.loglog(t, measured.target, "o", ms=3, mfc="none", color=_DARK)
        axes.loglog(t[order], said[order], "-", color=_BRIGHT)
        axes.set_xlabel("time (s)")
    axes.set_ylabel(_label(measured.data))
    return axes


def plot_band(band: Band, x: npt.ArrayLike, ax: "Axes | None" = None, *, label: str = "") -> "Axes":
    """Draw the band and the nominal answer over x."""
    place, title = _native.real_array("x", x, ndim=1), Text("label").check(label)
    if band.nominal.shape != place.shape:
        raise InputError(f"x: has shape {place.shape}, answers have {band.nominal.shape}")
    axes = panel(ax)
    name = f"{100 * band.level:g} %, parameters only"
    axes.fill_between(place, band.low, band.high, color=_WARM, alpha=0.5, lw=0, label=name)
    axes.plot(place, band.nominal, color=_DARK, lw=1.2, label=title or "fit")
    axes.legend()
    return axes


def _shade(i: int, n: int) -> Any:
    """Blue for cold, red for warm."""
    part = i / max(n - 1, 1)
    ends = np.array([[0.04, 0.11, 0.32], [0.88, 0.45, 0.11]])
    return tuple((1 - part) * ends[0] + part * ends[1])


def _unit(data: Any) -> str:
    return "(N/m)" if data.quantity == "K" else "(Pa)"


def _label(data: Any, part: str = "") -> str:
    return f"{data.quantity}{part} {_unit(data)}"


def _warmth(data: ModulusData) -> str | None:
    if data.temperature is None:
        return None
    return f"{float(np.mean(np.asarray(data.temperature))):.3g} deg C"
