"""Display of curves: rad/s or Hz; amplitudes, decibels or phases; gaps at jumps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib._native import ComplexArray, FloatArray
from viscovib.common.parameters import Number, Word
from viscovib.common.results import Axes
from viscovib.plots.style import plain

_X, _Y = Word("x", ("rad/s", "hz")), Word("y", ("linear", "log", "db", "phase"))
_REFERENCE = Number("reference", above=0)
#: Smallest length of a jump, relative to the neighbouring steps and to the largest motion.
_LONGER, _PART = 3.5, 0.1
#: A coordinate below this part of the largest one does not move.
_STILL = 1e-12


@dataclass(frozen=True)
class Shown:
    """Units and scale of a plot: its arguments x, y and reference."""

    x: str
    y: str
    reference: float

    @classmethod
    def checked(cls, x: object, y: object, reference: object = 1.0) -> Shown:
        """Check the arguments."""
        return cls(_X.check(x), _Y.check(y), _REFERENCE.check(reference))

    def places(self, values: FloatArray, circular: bool) -> FloatArray:
        """Return horizontal values in the shown unit; ``circular``: a frequency in rad/s."""
        return values / (2 * math.pi) if circular and self.x == "hz" else values

    def x_label(self, label: str, circular: bool) -> str:
        """Return the label of the horizontal axis."""
        if not circular or self.x != "hz":
            return label
        label = label.replace("circular frequency", "frequency").replace("(rad/s)", "(Hz)")
        # The symbols nu and omega mean circular frequencies.
        label = " ".join(label.replace(r"$\nu$", "").replace(r"$\omega$", "").split())
        return "frequency (Hz)" if label == "(Hz)" else label

    def sizes(self, values: ComplexArray | FloatArray) -> FloatArray:
        """Return sizes, decibels or phases of complex amplitudes."""
        if self.y == "phase":
            return np.asarray(np.degrees(np.angle(values)))
        size = np.abs(values)
        if self.y != "db":
            return np.asarray(size)
        with np.errstate(divide="ignore"):
            level = 20 * np.log10(size / self.reference)
        return np.asarray(np.where(np.isfinite(level), level, np.nan))

    def y_label(self, symbol: str, unit: str) -> str:
        """Return the label of the vertical axis, for a harmonic of a coordinate."""
        unit = "" if unit in ("1", "L") else plain(unit)
        if self.y == "phase":
            return f"phase of ${symbol}$ (degrees)"
        if self.y == "db":
            return f"$|{symbol}|$ (dB re {self.reference:g}{f' {unit}' if unit else ''})"
        return f"amplitude $|{symbol}|$" + (f" ({unit})" if unit else "")

    def finish(self, axis: Axes) -> None:
        """Set the scale and the ticks of an axis."""
        if self.y == "log" and any(
            np.nanmax(np.asarray(line.get_ydata()), initial=0.0) > 0 for line in axis.lines
        ):
            logarithmic(axis)
        elif self.y == "phase":
            axis.set_yticks(range(-180, 181, 90))


def logarithmic(axis: Axes) -> None:
    """Set a logarithmic scale with labels that do not overlap.

    Between powers of ten only 2 and 5 are labelled, and only if the axis has few powers.
    """
    from matplotlib.ticker import FuncFormatter, LogFormatterSciNotation

    axis.set_yscale("log")
    powers = LogFormatterSciNotation()
    powers.set_axis(axis.yaxis)

    def few() -> bool:
        low, high = axis.get_ylim()
        return 0 < low < high and math.log10(high / low) <= 1.5

    def at_power(value: float, place: int) -> str:
        return f"{value:g}" if few() else powers(value, place)

    def between(value: float, _: object) -> str:
        digit = value / 10.0 ** math.floor(math.log10(value) + 1e-9)
        return f"{value:g}" if few() and round(digit, 6) in (2, 5) else ""

    axis.yaxis.set_major_formatter(FuncFormatter(at_power))
    axis.yaxis.set_minor_formatter(FuncFormatter(between))


def plain_hertz(axis: Axes) -> None:
    """Label a logarithmic axis of frequencies with plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axis.xaxis.set_minor_formatter(NullFormatter())


def torn(jumps: npt.NDArray[np.bool_], *columns: FloatArray) -> list[FloatArray]:
    """Return columns with a row of NaN at each jump, so that no line crosses it."""
    after = np.flatnonzero(jumps) + 1
    return [np.insert(column.astype(float), after, np.nan) for column in columns]


def jumps_of(coefficients: ComplexArray) -> npt.NDArray[np.bool_]:
    """Mark the steps at which a sequence of motions jumps to another branch, shape (n - 1,).

    A step is a jump if it is much longer than both neighbouring steps. It is measured in complex
    harmonics, in which a steep flank is a smooth turn: across a pole a step is only three times
    as long as its neighbours. Curves with too few samples are not divided.
    """
    flat = coefficients.reshape(len(coefficients), -1)
    sizes = np.abs(flat).max(axis=1, initial=0.0)
    steps = np.abs(np.diff(flat, axis=0)).max(axis=1, initial=0.0)
    found = np.zeros(steps.shape, dtype=bool)
    if steps.size < 3 or not np.isfinite(sizes).any():
        return found
    nearby = np.maximum(steps[:-2], steps[2:])
    inner = steps[1:-1]
    with np.errstate(invalid="ignore"):
        found[1:-1] = (inner > _LONGER * nearby) & (inner > _PART * np.nanmax(sizes))
    return found


def moving(names: tuple[str, ...], values: npt.NDArray[Any]) -> tuple[str, ...]:
    """Return the names of coordinates that move, all if none does; ``values``: (n, n_dof, ...)."""
    flat = np.abs(values).reshape(*values.shape[:2], -1).max(axis=2, initial=0.0)
    sizes = np.where(np.isfinite(flat), flat, 0.0).max(axis=0, initial=0.0)
    kept = [n for n, s in zip(names, sizes, strict=True) if s > _STILL * sizes.max(initial=0.0)]
    return tuple(kept) if kept else tuple(names)
