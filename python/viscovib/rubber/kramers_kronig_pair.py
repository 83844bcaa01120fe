"""Consistency of storage and loss.

For a passive relaxing material both parts have one non-negative spectrum (`prony_spectrum`). The
storage then determines the loss, except for relaxation outside the measured frequencies. Three fits
of such spectra are compared: to storage alone, to loss alone, and to both with equal weights of
their relative errors.
"""

import math
from dataclasses import dataclass
from importlib import import_module

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.results import Axes, Dataset, Result, as_dataset
from viscovib.errors import InputError
from viscovib.rubber.data import ModulusData
from viscovib.rubber.prony_spectrum import dynamic_design, grid_of_times, nonnegative, rms

#: Terms per decade, and decades beyond the data.
_PER_DECADE, _BEYOND = 4.0, 1.0
#: Largest residual of a fit to both parts: multiple of the scatter of each, plus this error.
_FACTOR, _SLACK = 1.5, 0.025
#: Expected residual of a fit to one part, in units of its scatter from row to row.
_ROW_TO_ROW = 1.2
#: Allowed growth of the storage residual by smoothing the spectrum: factor and addition.
_ROUGHER, _LEAST = 1.2, 5e-4
#: Relative variation of the storage below which the check of the loss is weak.
_WEAK = 0.2
#: Larger deviations of the loss from the expected loss are reported.
_TELLING = 1.25
#: Width (decades) at the ends of the range in which the loss is not checked.
_END = 0.3
_FEWEST = 5


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class KramersKronig(Result):
    """Result of `kramers_kronig`.

    Attributes
    ----------
    consistent : bool
        True if one material may have both parts: the closest spectrum leaves at most 1.5 times
        their scatter, plus 2.5 % for systematic errors of measured moduli. If the storage varies by
        less than a fifth, this is a weak check, which the summary states.
    together : tuple of float
        Relative rms residuals (storage, loss) of the spectrum closest to both, with equal weights.
    storage_alone, loss_alone : float
        Relative rms residual of the spectrum closest to one part: its scatter.
    storage_varies : float
        Largest minus smallest storage, divided by the largest.
    frequencies : ndarray, shape (n,)
        Circular frequencies (rad/s), ascending.
    expected_loss : ndarray, shape (n,)
        Loss of a smooth spectrum that fits the storage.
    ratio : ndarray, shape (n,)
        Measured loss divided by the expected loss.
    wrong : tuple of (float, float, float, float)
        Ranges in which the ratio is outside [0.8, 1.25]: from, to (rad/s), smallest and largest
        ratio. If ``consistent`` is True, the scatter of the storage may explain them.

    Examples
    --------
    >>> found = vv.read_dma("data/rubber/pyvisco_freq_user_master.csv").kramers_kronig()
    >>> found.consistent, f"{100 * found.together[0]:.0f} %, {100 * found.together[1]:.0f} %"
    (False, '20 %, 13 %')
    >>> low, high, least, most = found.wrong[0]
    >>> bool(high < 2 * np.pi and most > 10)
    True
    """

    consistent: bool
    together: tuple[float, float]
    storage_alone: float
    loss_alone: float
    storage_varies: float
    frequencies: FloatArray
    expected_loss: FloatArray
    ratio: FloatArray
    wrong: tuple[tuple[float, float, float, float], ...]

    kind = "kramers kronig"

    def _headline(self) -> str:
        both = (
            f"the closest spectrum leaves {100 * self.together[0]:.2g} % of the storage and "
            f"{100 * self.together[1]:.2g} % of the loss; storage alone "
            f"{100 * self.storage_alone:.2g} %, loss alone {100 * self.loss_alone:.2g} %"
        )
        if self.consistent:
            doubt = ""
            middle = float(np.median(self.ratio))
            if self.storage_varies < _WEAK and not 1 / _TELLING < middle < _TELLING:
                doubt = (
                    f"; the storage varies by {100 * self.storage_varies:.2g} % only, so "
                    f"it determines little: the loss is {middle:.2g} times that of the smoothest "
                    "spectrum"
                )
            elif self.wrong:
                off = float(np.mean((self.ratio > _TELLING) | (self.ratio < 1 / _TELLING)))
                doubt = (
                    f"; at {100 * off:.0f} % of the frequencies the loss is not 0.8 to 1.25 times "
                    "what belongs to the smoothest spectrum of the storage (see wrong)"
                )
            return f"storage and loss may belong together: {both}{doubt}"
        places = [
            f"from {_hertz(low)} to {_hertz(high)} the loss is {least:.2g} to {most:.2g} times "
            "what belongs to the storage"
            for low, high, least, most in self.wrong
        ]
        return "; ".join([f"storage and loss contradict each other: {both}", *places])

    def to_dataset(self) -> Dataset:
        """Return the expected loss, and the measured loss divided by it."""
        return as_dataset(
            {
                "expected_loss": ("frequency", self.expected_loss),
                "ratio": ("frequency", self.ratio),
            },
            coords={"frequency": ("frequency", self.frequencies, {"units": "rad/s"})},
            attrs={
                "consistent": int(self.consistent),
                "together": self.together,
                "storage_alone": self.storage_alone,
                "loss_alone": self.loss_alone,
                "storage_varies": self.storage_varies,
            },
        )

    def plot(self, ax: "Axes | None" = None, *, x: str = "rad/s") -> Axes:
        """Draw the measured loss divided by the loss expected from the storage."""
        # Import by name: that module imports this one.
        return import_module("viscovib.plots.rubber").plot_ratio(self, ax, x=x)  # type: ignore[no-any-return]


def kramers_kronig(data: ModulusData) -> KramersKronig:
    """Check the consistency of storage and loss.

    Parameters
    ----------
    data : ModulusData
        One set, or a master curve: at least 5 frequencies.

    Returns
    -------
    KramersKronig

    Notes
    -----
    Two errors are not detectable: frequencies in Hz instead of rad/s, and a constant added to the
    storage.

    Examples
    --------
    >>> nu = np.geomspace(1e-2, 1e4, 40)
    >>> stiff = 2e6 * (1 - vv.RabotnovKernel(amplitude=2, alpha=0.5, beta=3).transform(nu))
    >>> good = vv.ModulusData(frequencies=nu, storage=stiff.real, loss=stiff.imag)
    >>> vv.kramers_kronig(good).consistent
    True
    >>> bad = vv.ModulusData(frequencies=nu, storage=stiff.real, loss=2 * stiff.imag)
    >>> found = vv.kramers_kronig(bad)
    >>> found.consistent, bool(1.9 < np.median(found.ratio) < 2.1)
    (False, True)
    """
    _native.check_instance("data", data, ModulusData)
    sets = data.sets()
    if len(sets) > 1:
        raise InputError(
            f"data: has {len(sets)} sets, must have one: take data.sets()[i], or a master curve"
        )
    one = sets[0]
    nu = np.asarray(one.frequencies)
    storage, loss = np.asarray(one.storage), np.asarray(one.loss)
    if nu.size < _FEWEST:
        raise InputError(f"data: has {nu.size} frequencies, must be at least {_FEWEST}")
    if (loss <= 0).any():
        i = int(np.argmin(loss))
        raise InputError(f"loss = {loss[i]:g} at {nu[i]:g} rad/s: must be greater than 0 here")
    tau = grid_of_times(1 / nu[-1], 1 / nu[0], _PER_DECADE, _BEYOND)
    a, b = dynamic_design(nu, tau)
    a, b = a / storage[:, np.newaxis], b / loss[:, np.newaxis]
    ones = np.ones(nu.size)
    both = nonnegative(np.vstack([a, b]), np.ones(2 * nu.size))
    alone = rms(a @ nonnegative(a, ones) - 1)
    of_loss = rms(b @ nonnegative(b, ones) - 1)
    expected = b @ _smooth_spectrum(a, alone, storage) * loss
    together = rms(a @ both - 1), rms(b @ both - 1)
    scatter = (
        min(residual, _ROW_TO_ROW * _scatter(nu, part))
        for residual, part in ((alone, storage), (of_loss, loss))
    )
    consistent = all(
        joint <= math.hypot(_FACTOR * own, _SLACK)
        for joint, own in zip(together, scatter, strict=True)
    )
    # If the expected loss is 0, the ratio is infinite.
    ratio = np.divide(loss, expected, out=np.full(nu.size, np.inf), where=expected > 0)
    return KramersKronig(
        consistent=consistent,
        together=together,
        storage_alone=alone,
        loss_alone=of_loss,
        storage_varies=float(np.ptp(storage) / np.abs(storage).max()),
        frequencies=nu,
        expected_loss=expected,
        ratio=ratio,
        wrong=_ranges(nu, ratio),
    )


def _scatter(nu: FloatArray, values: FloatArray) -> float:
    """Relative scatter from row to row: the median distance from the line through neighbours."""
    x, y = np.log(nu), np.log(values)
    part = (x[1:-1] - x[:-2]) / (x[2:] - x[:-2])
    off = y[1:-1] - (1 - part) * y[:-2] - part * y[2:]
    return 1.4826 * float(np.median(np.abs(off) / np.sqrt(1 + part**2 + (1 - part) ** 2)))


def _smooth_spectrum(rows: FloatArray, best: float, storage: FloatArray) -> FloatArray:
    """The smoothest spectrum whose fit of the storage is nearly as good as the best."""
    target = np.ones(rows.shape[0])
    size = np.full(rows.shape[1] - 1, float(np.median(storage)))
    allowed = _ROUGHER * best + _LEAST
    found = nonnegative(rows, target)
    for weight in np.geomspace(1e-3, 1e2, 16):
        smoother = nonnegative(rows, target, float(weight), size)
        if rms(rows @ smoother - 1) > allowed:
            break
        found = smoother
    return found


def _ranges(nu: FloatArray, ratio: FloatArray) -> tuple[tuple[float, float, float, float], ...]:
    decades = np.log10(nu)
    assessed = (decades > decades[0] + _END) & (decades < decades[-1] - _END)
    off = assessed & ((ratio > _TELLING) | (ratio < 1 / _TELLING))
    side = np.where(off, np.sign(np.log(ratio)), 0)
    found = []
    first = 0
    for i in range(1, nu.size + 1):
        if i < nu.size and side[i] == side[first]:
            continue
        if side[first] and i - first > 1:
            part = ratio[first:i]
            found.append((float(nu[first]), float(nu[i - 1]), float(part.min()), float(part.max())))
        first = i
    return tuple(found)


def _hertz(nu: float) -> str:
    return f"{nu / (2 * np.pi):.3g} Hz"
