"""Structures without damping, memory and loads."""

from __future__ import annotations

from typing import Any

import numpy as np

from viscovib.errors import InputError
from viscovib.systems.condensed import Condensation, LoadedStructure
from viscovib.systems.structure_matrices import dense_of, stiffness_parts, with_elements
from viscovib.systems.structure_rest import dense_rest


def undamped(structure: Any) -> LoadedStructure:
    """Return a `Structure` without its damping, its memory and loads."""
    rest = structure._rest
    if rest.poles.size:
        if structure._reduced is not None:
            raise InputError("backbone: a reduced structure needs damping that is modal")
        stiffness, damping = with_elements(
            structure._layers.added_to(structure.stiffness), structure.damping,
            structure._all_elements,
        )  # fmt: skip
        parts = [
            *stiffness_parts(structure.stiffness, structure._all_elements),
            *(dense_of(matrix) for matrix, _ in structure._layers.whole),
        ]
        rest = dense_rest(dense_of(structure.mass), 0 * damping, stiffness, parts=parts)
        if rest.poles.size:
            raise InputError("stiffness: must be symmetric for free motions without losses")
    nothing = np.zeros(rest.squares.size)
    condensation = Condensation(
        rest._replace(rates=nothing, losses=nothing), structure._condensation.laws,
        structure._reduced,
    )  # fmt: skip
    none = np.zeros((structure.n_coordinates, 0), dtype=complex)
    return LoadedStructure(
        condensation, np.zeros(0, dtype=np.int32), none, np.zeros(0, dtype=complex),
        np.zeros(structure.n_coordinates), None,
    )  # fmt: skip
