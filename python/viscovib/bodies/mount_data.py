"""Data of mounts from test benches: tables of forces, gaps, loss factors, units."""

from __future__ import annotations

import re
from typing import Any, NamedTuple

import numpy as np

from viscovib import _native, units
from viscovib._native import FloatArray
from viscovib.errors import InputError
from viscovib.kernels.relaxation import PronyKernel
from viscovib.systems.laws import Law, function_law
from viscovib.systems.python_law import PythonLaw

#: Largest number of rows of a table of forces.
_MOST_ROWS = 60
#: Exponential terms per decade, decades beyond either end of the band, and largest relative error
#: of the loss factor in it.
_PER_DECADE, _BEYOND, _WORST = 3, 1.0, 0.01


class Units(NamedTuple):
    """Factors from given units to SI."""

    force: float
    length: float

    @classmethod
    def read(cls, where: str, text: Any) -> Units:
        """Read two units such as "N, mm"."""
        forces, lengths = {"N": 1.0, "kN": units.kN}, {"m": 1.0, "mm": units.mm}
        words = text.replace(",", " ").split() if isinstance(text, str) else []
        if len(words) != 2 or words[0] not in forces or words[1] not in lengths:
            raise InputError(
                f"{where}: units = {_native.shown(text)}: must be a force, N or kN, and a length, "
                'm or mm, such as "N, mm"; angles are in rad'
            )
        return cls(forces[words[0]], lengths[words[1]])


def law_text(where: str, law: Any, parameters: dict[str, float], given: Units | None) -> str | None:
    """Return a law of a mount (text, Python function or table) as a text in SI units."""
    if callable(law) or isinstance(law, PythonLaw):
        found = function_law(where, law, ("d",), parameters, ("v",))
        if isinstance(found, Law):
            raise InputError(
                f"{where}: the function {found.text} has no form as a text: must consist of "
                "arithmetic and NumPy functions, or be a table of deflections and forces"
            )
        text: str | None = found
    elif law is None or isinstance(law, str):
        text = law
    else:
        text = _interpolated(where, law)
    if text is None or given is None:
        return text
    for name in ("d", "v"):
        text = re.sub(rf"\b{name}\b", f"({1 / given.length!r}*{name})", text)
    return f"{given.force!r}*({text})"


def is_table(law: Any) -> bool:
    """Return True for rows of two numbers, False for laws of three directions."""
    return all(isinstance(row, (list, tuple, np.ndarray)) and np.ndim(row) == 1 for row in law)


def _interpolated(where: str, law: Any) -> str:
    """Return a table, shape (n, 2), as linear pieces; the first and last continue."""
    if not isinstance(law, (list, tuple, np.ndarray)):
        raise InputError(
            f"{where} = {_native.shown(law)}: must be a str, a function, a table of deflections "
            "and forces, None or three of them"
        )
    table = _native.real_array(where, law)
    if table.ndim != 2 or table.shape[1] != 2 or not 2 <= len(table) <= _MOST_ROWS:
        raise InputError(
            f"{where}: must be a text, a function, or a table of deflections and forces of shape "
            f"(n, 2) with 2 to {_MOST_ROWS} rows, got shape {table.shape}"
        )
    d, f = table.T
    if not (np.diff(d) > 0).all():
        raise InputError(f"{where}: deflections must increase from row to row")
    slopes = np.diff(f) / np.diff(d)
    # Terms max(d - d_i, 0) make the law exact at all rows.
    text = f"{_signed(f[0])} + {_signed(slopes[0])}*(d - {_signed(d[0])})"
    for at, change in zip(d[1:-1], np.diff(slopes), strict=True):
        if change:
            text += f" + {_signed(change)}*max(d - {_signed(at)}, 0)"
    return text


def _signed(number: float) -> str:
    return f"({float(number)!r})"


def gap_text(where: str, gap: float, stiffness: float) -> str:
    """Return the force of stops on both sides at a gap."""
    if gap < 0 or stiffness <= 0:
        raise InputError(
            f"{where}: gap = {gap:g}, gap_stiffness = {stiffness:g}: must not be negative, and be "
            "greater than 0"
        )
    return f"{stiffness!r}*(max(d - {gap!r}, 0) + min(d + {gap!r}, 0))"


def loss_kernel(where: str, loss_factor: float, band: FloatArray) -> tuple[PronyKernel, float]:
    """Return a kernel with a constant loss factor in a band, and the relaxed share at its centre.

    The loss factor is R_s/(1 - R_c). With terms u_j r_j exp(-r_j t) the condition is linear in the
    shares u_j >= 0.
    """
    from scipy.optimize import nnls

    low, high = np.log10(band)
    count = int(np.ceil(_PER_DECADE * (high - low + 2 * _BEYOND))) + 1
    rates = np.logspace(low - _BEYOND, high + _BEYOND, count)
    nu = np.logspace(low, high, 8 * count)[:, np.newaxis]
    cosine, sine = rates**2 / (rates**2 + nu**2), rates * nu / (rates**2 + nu**2)
    shares, _ = nnls(sine + loss_factor * cosine, np.full(nu.size, loss_factor))
    error = np.abs(sine @ shares / (1 - cosine @ shares) / loss_factor - 1).max()
    if not (shares.sum() < 1 and error <= _WORST):
        raise InputError(
            f"{where}: loss_factor = {loss_factor:g}: no relaxation has this loss factor in the "
            f"whole band {band[0]:g} to {band[1]:g} rad/s, give a smaller band"
        )
    at = float(np.sqrt(band[0] * band[1]))
    kept = shares > 0
    kernel = PronyKernel(weights=shares[kept] * rates[kept], rates=rates[kept])
    return kernel, 1 - float(kernel.cosine(at))


def each_number(where: str, value: Any) -> list[float | None]:
    """Return a number or None for each of three directions."""
    several = list(value) if isinstance(value, (list, tuple, np.ndarray)) else [value] * 3
    if len(several) != 3:
        raise InputError(f"{where}: must be a number, None or three of them")
    return [None if one is None else _native.number(where, one) for one in several]
