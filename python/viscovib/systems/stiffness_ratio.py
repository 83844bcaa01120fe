"""Warnings for springs of very different stiffness, whose rounding errors hide the soft ones.

The core decides (`viscovib_stiffness_ratio`).
"""

import warnings
from typing import Any

import numpy as np

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.errors import RangeWarning, caller

_EPS = float(np.finfo(float).eps)
#: Squares of frequencies below this part of |phi|^T |K| |phi| are free motions.
_RIGID = 1e-12
#: Largest relative rounding error of a squared frequency without a warning.
LOST = 1e-6
#: Ratio of squared frequencies from which on a failed search for steady motions may be due to it.
_STIFF = 1e8


def without_rounding(squares: FloatArray, shapes: FloatArray, stiffness: FloatArray) -> FloatArray:
    """Set squared frequencies that are rounding errors to 0: motions without springs."""
    size = np.abs(shapes)
    pulled = (size * (np.abs(stiffness) @ size)).sum(axis=0)
    result = squares.copy()
    result[np.abs(squares) <= _RIGID * pulled] = 0.0
    return result


def warn_of_lost_modes(
    squares: FloatArray, shapes: FloatArray, mass: Any, stiffness: Any, least: float = LOST
) -> None:
    """Warn of modes hidden by rounding errors: squares (m,), shapes (n, m).

    Matrices are dense or sparse; ``least``: largest relative rounding error of a squared frequency
    without a warning.
    """
    given = {"stiffness": stiffness}
    if not isinstance(stiffness, np.ndarray):
        entries = stiffness.tocoo()
        given = {"rows": entries.row + 1, "columns": entries.col + 1, "values": entries.data}
    _warn(
        _native.run(
            "system lost modes", squares=squares, shapes=shapes, mass=mass.diagonal(), **given,
            least=least,
        )
    )  # fmt: skip


def warn_of_lost_poles(
    poles: ComplexArray, left: ComplexArray, right: ComplexArray, stiffness: FloatArray
) -> None:
    """Warn of complex modes that rounding errors of the stiffness hide.

    With (s^2 M + s C + K)^-1 = sum left right^T/(s - pole).
    """
    given = {"poles": poles, "left": left, "right": right}
    given = {name: value.astype(complex) for name, value in given.items()}
    _warn(_native.run("system lost poles", **given, stiffness=stiffness))


def warn_of_lost_springs(system: _native.Handle) -> None:
    """Warn of modes of a polynomial system that rounding errors hide."""
    _warn(_native.run("system lost springs", system))


def _warn(found: dict[str, Any]) -> None:
    for line in found["note"].splitlines():
        warnings.warn(line, RangeWarning, stacklevel=caller())


def advice_on_springs(mass: FloatArray, stiffness: FloatArray) -> str:
    """Return advice if rounding errors of stiff springs may hide a steady motion.

    For matrices (n, n) that are solved directly: forces of stiff springs are small differences of
    displacements, so soft springs have a relative error of eps times the ratio of both, and light
    damping a larger one. A structure uses refined modes for its linear part and keeps these digits.
    """
    squares = np.abs(np.linalg.eigvals(np.linalg.solve(mass, stiffness)))
    ratio = squares.max() / max(squares.min(), _EPS * squares.max())
    if ratio < _STIFF:
        return ""
    return (
        f"; squares of natural frequencies differ by a factor of {ratio:.0e}, and the rounding "
        "error of stiff springs affects the soft springs: vv.Structure with elements avoids "
        "this"
    )
