"""Internal coordinates of the elements of a structure, behind its own coordinates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from viscovib._native import FloatArray
from viscovib.errors import InputError
from viscovib.systems.elements import direction_of
from viscovib.systems.load import name_places
from viscovib.systems.series_dampers import Maxwell
from viscovib.systems.structure_matrices import is_sparse

#: Name of an internal coordinate, and its unit.
_NAME, _UNIT = "maxwell", "m s"


def has_series(elements: Any) -> bool:
    """True if Maxwell elements are among the elements of a structure."""
    return isinstance(elements, (list, tuple)) and any(isinstance(e, Maxwell) for e in elements)


def extended(structure: Any, given: Mapping[str, Any]) -> tuple[list[Any], dict[str, Any]]:
    """Return the elements with internal coordinates, and the arguments with these coordinates.

    ``given``: arguments of the structure without them, with matrices in one form.
    """
    for name in ("modal_damping", "rayleigh", "loss_factor"):
        if np.any(getattr(structure, name)):
            raise InputError(
                f"{name}: must not be given with a Maxwell element, whose internal coordinate it "
                "would damp: use damping"
            )
    names, mass = given["names"], given["mass"]
    elements, (columns, stiffness, rates) = _with_inner(structure.elements, names, mass.diagonal())
    n, m = columns.shape

    def joined(matrix: Any, right: Any, below: Any, corner: Any) -> Any:
        blocks = [[matrix, right], [below, np.diag(corner)]]
        if not is_sparse(matrix):
            return np.block(blocks)
        from scipy.sparse import block_array, csc_array

        return csc_array(block_array([[csc_array(part) for part in row] for row in blocks]))

    none, wide = np.zeros((n, m)), columns * rates
    more = {
        "mass": joined(mass, none, none.T, stiffness),
        "damping": joined(given["damping"], columns, -columns.T, stiffness * rates),
        "stiffness": joined(given["stiffness"], wide, none.T, 0 * rates),
        "names": (*names, *(f"{_NAME}{j + 1}" for j in range(m))),
        "units": (*given["units"], *[_UNIT] * m),
        "layers": [(joined(one, none, none.T, 0 * rates), k) for one, k in given["layers"]],
    }
    if given["base_direction"] is not None:
        more["base_direction"] = _longer(given["base_direction"], n, m)
    return elements, more


def _with_inner(elements: Sequence[Any], names: Sequence[str], mass: FloatArray) -> tuple[Any, Any]:
    """Return elements with the names of internal coordinates, and A, k and r of the coordinates.

    ``names`` and ``mass``: coordinates, and the diagonal of the mass matrix, shape (n,). Column j
    of A, shape (n, m), is k e of the Maxwell element j; k and r have the shape (m,).
    """
    n, places = len(names), name_places(names)
    m = sum(isinstance(one, Maxwell) for one in elements)
    found, columns, numbers = [], [], []
    for i, one in enumerate(elements):
        if isinstance(one, Maxwell):
            e = direction_of(f"elements[{i}].on", one.on, n, places)
            softness = float((e[mass > 0] ** 2 / mass[mass > 0]).sum())
            rate = float(np.sqrt(one.stiffness * softness)) if softness else 1.0
            columns.append(one.stiffness * e)
            numbers.append((one.stiffness, rate))
        own = replace(one, on=_longer(one.on, n, m)) if hasattr(one, "on") else one
        if isinstance(own, Maxwell):
            object.__setattr__(own, "_inner", f"{_NAME}{len(columns)}")
            object.__setattr__(own, "_rate", numbers[-1][1])
        found.append(own)
    stiffness, rates = np.array(numbers).T
    return found, (np.array(columns).T, stiffness, rates)


def _longer(on: Any, n: int, m: int) -> Any:
    """A direction given by n numbers with m more numbers, 0."""
    if isinstance(on, Mapping):
        return {name: _longer(one, n, m) for name, one in on.items()}
    numbers = isinstance(on, (list, tuple, np.ndarray)) and not any(isinstance(x, str) for x in on)
    return np.append(np.asarray(on), np.zeros(m)) if numbers and np.shape(on) == (n,) else on
