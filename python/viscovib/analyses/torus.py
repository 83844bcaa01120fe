"""Base frequencies, orders and plan of harmonic balance of a pendulum under several loads."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.common.counts import things
from viscovib.common.parameters import MAX_DENOMINATOR, SUBHARMONIC
from viscovib.common.plan import Plan
from viscovib.errors import InputError
from viscovib.systems.pendulum import Pendulum

FREQUENCIES = ("p1", "p2", "p3")
AMPLITUDES = ("f0", "m01", "m02")
#: Parameters that may vary, in the order of the core, from 1.
_VARIES = (*FREQUENCIES, *AMPLITUDES, "nu")

IntArray = npt.NDArray[np.int32]


def chosen(given: Mapping[str, object]) -> tuple[str | None, object]:
    """Return the one keyword that varies and its value; (None, None) if none does."""
    named = [name for name, value in given.items() if value is not None]
    if len(named) > 1:
        raise InputError(f"{named[0]}, {named[1]}: only one of them may vary")
    return (named[0], given[named[0]]) if named else (None, None)


def loads_of(
    varies: str | None, harmonics: object, symmetric: bool, subharmonic: int, max_denominator: int
) -> dict[str, Any]:
    """Values for tasks of the core about the loads of a pendulum and the harmonics."""
    auto = _native.is_auto(harmonics)
    most = np.iinfo(np.int32).max
    return {
        "varies": 0 if varies is None else _VARIES.index(varies) + 1, "choose": auto,
        "harmonics": 0 if auto else _native.integer("harmonics", harmonics, -most, most),
        "symmetric": symmetric, "subharmonic": SUBHARMONIC.check(subharmonic),
        "max_denominator": MAX_DENOMINATOR.check(max_denominator),
    }  # fmt: skip


def axes_of(found: dict[str, Any]) -> tuple[str, ...]:
    """Names of the base frequencies: "nu", or the load with this frequency."""
    return tuple("nu" if j == 0 else FREQUENCIES[j - 1] for j in found["named"].tolist())


def unknowns_of(coefficients: ComplexArray) -> FloatArray:
    """Unknowns of one motion from X_k, shape (3, n_orders)."""
    x = np.empty((3, 2 * coefficients.shape[1] - 1))
    x[:, 0] = coefficients[:, 0].imag
    x[:, 1::2] = coefficients[:, 1:].real
    x[:, 2::2] = coefficients[:, 1:].imag
    return x.ravel()


def place_of(orders: IntArray, harmonic: object) -> int:
    """Index of an order, or of its negative, which has the same amplitude."""
    wanted = np.atleast_1d(np.asarray(harmonic))
    if wanted.dtype.kind not in "iu" or wanted.shape != orders.shape[1:]:
        raise InputError(
            f"harmonic = {_native.shown(harmonic)}: "
            f"must be {'an integer' if orders.shape[1] == 1 else ''}"
            f"{f'{orders.shape[1]} integers' if orders.shape[1] > 1 else ''}"
        )
    for sign in (1, -1):
        where = np.flatnonzero((orders == sign * wanted).all(axis=1))
        if where.size:
            return int(where[0])
    highest = int(np.abs(orders).sum(axis=1).max())
    raise InputError(
        f"harmonic = {_native.shown(harmonic)}: must be one of those kept, up to {highest} in all"
    )


def order_name(order: npt.NDArray[np.int32]) -> str:
    """Name of an order in column names: "3" or "1,-2"."""
    return ",".join(str(int(k)) for k in order)


def tail(coefficients: ComplexArray, orders: IntArray) -> FloatArray:
    """Largest coefficient of the two outermost shells relative to the largest of all, (n,)."""
    shell = np.abs(orders).sum(axis=1)
    sizes = np.abs(coefficients)
    largest = np.maximum(sizes.max(axis=(1, 2)), 1e-300)
    return np.asarray(sizes[:, :, shell >= shell.max() - 1].max(axis=(1, 2)) / largest)


def torus_plan(
    first: str, pend: Pendulum, found: dict[str, Any], varies: str | None, stability: str
) -> Plan:
    """Return the plan of harmonic balance that starts with the line ``first``.

    ``found``: by the core; ``stability``: "multipliers", "rates", or the reason for its absence.
    """
    kept, names = found["kept"], axes_of(found)
    base = things(len(names), "base frequency", "base frequencies")
    axes = ", ".join(names)
    real = np.where(np.arange(len(kept)) > 0, 2, 1)
    n, whole = int(real @ kept.sum(axis=1)), 3 * int(real.sum())
    lines = [
        first,
        f"computes: {things(len(kept), 'harmonic')} of {base} ({axes}), {n} unknowns",
    ]
    if len(names) > 1:
        lines.append(f"computes: samples on a torus of {things(len(names), 'angle')}")
    elif not kept[:, 1:].any():
        lines.append(
            "skips: unknowns of phi and psi (no moment acts on them, and they are at rest)"
        )
    if n < whole and kept[:, 1:].any():
        lines.append(
            f"skips: {whole - n} of {whole} unknowns (they are 0 by the symmetry of system and "
            "loads)"
        )
    silent = [size for size in AMPLITUDES if getattr(pend, size) == 0 and size != varies]
    if silent:
        lines.append(f"skips: loads {', '.join(silent)} (amplitude 0)")
    if stability in ("multipliers", "rates"):
        what = "Floquet multipliers" if stability == "multipliers" else "rates of growth"
        lines.append(f"computes: {what} of every motion")
    else:
        lines.append(f"skips: stability ({stability})")
    return Plan("\n".join(lines))
