"""The systems that responses and branches are computed of."""

from collections.abc import Mapping
from typing import Any, TypeAlias

from viscovib import _native
from viscovib.errors import InputError
from viscovib.load import LoadLike
from viscovib.load_table import LoadTable
from viscovib.mount import Mount
from viscovib.polynomial_system import PolynomialSystem

Oscillator: TypeAlias = Mount | PolynomialSystem


def check_oscillator(system: Any, base: "LoadLike | LoadTable | None") -> None:
    """Refuse what is no such system, or a motion of a base that it lacks."""
    if not isinstance(system, (Mount, PolynomialSystem)):
        raise InputError(f"system = {_native.shown(system)}: must be a Mount or a PolynomialSystem")
    moves = base is not None and not (isinstance(base, Mapping) and not base)
    if moves and system._base_direction is None:
        raise InputError("base: this system has no base_direction, its base is fixed")
