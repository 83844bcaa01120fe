"""What is linear in rates in laws with a kernel, which linear analyses of the core leave out."""

from __future__ import annotations

import warnings
from typing import Any

from viscovib.errors import RangeWarning, caller
from viscovib.systems.elements import Coupling, Spring
from viscovib.systems.laws import Law


def warn_of_rates_left_out(what: str, system: Any) -> None:
    """Warn where the result wanted leaves such a part out."""
    groups = getattr(system, "groups", ())
    elements = getattr(system, "elements", ())
    if any(group.law_dampers is not None for group in groups) or any(map(_damps, elements)):
        warnings.warn(
            f"{what} leaves out what is linear in rates in laws with a kernel; "
            "method='newton' under a small load has it",
            RangeWarning,
            stacklevel=caller(),
        )


def _damps(element: Any) -> bool:
    """Whether a law with a kernel has a slope by a rate at rest."""
    if not isinstance(element, (Spring, Coupling)) or element.kernel is None:
        return False
    laws = [law for _, law in element._programs] if isinstance(element, Coupling) else []  # type: ignore[attr-defined]
    if isinstance(element, Spring):
        laws = [element._program]  # type: ignore[attr-defined]
    return any(isinstance(law, Law) and law.damping_at_rest().any() for law in laws)
