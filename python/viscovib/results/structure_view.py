"""Selection of the coordinates of a condensed structure in a result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.errors import InputError
from viscovib.systems.condensed import LoadedStructure
from viscovib.systems.load import one_of
from viscovib.systems.supports import Supports


@dataclass(frozen=True)
class View:
    """A condensed structure with its load, and the coordinates selected for a result."""

    loaded: LoadedStructure
    places: Any
    names: tuple[str, ...]
    units: tuple[str, ...]
    #: Names and units of all coordinates.
    all_names: tuple[str, ...] = field(repr=False)
    all_units: tuple[str, ...] = field(repr=False)
    #: Elements in their order, in the form of the condensation.
    elements: tuple[Any, ...] = field(repr=False)
    #: Supports that were removed from the matrices; None: none.
    held: Supports | None = field(default=None, repr=False)

    @classmethod
    def of(cls, system: Any, loaded: LoadedStructure, coordinates: Sequence[str] | None) -> View:
        """Create a view of the requested coordinates, or of the default ones."""
        places = system._wanted(coordinates, loaded)
        names, units = system.dof_names, system.dof_units
        # Springs of a polynomial system or a body are not elements.
        elements: tuple[Any, ...] = system._terms_in_order if system._is_condensed else ()
        return cls(
            loaded, places, tuple(names[i] for i in places), tuple(units[i] for i in places),
            names, units, elements, system._held,
        )  # fmt: skip

    def at(self, coordinates: Sequence[str]) -> View:
        """Return a view of the motions in selected coordinates."""
        if isinstance(coordinates, str) or not isinstance(coordinates, Sequence) or not coordinates:
            raise InputError(f"coordinates = {_native.shown(coordinates)}: must be a list of names")
        index = {name: i for i, name in enumerate(self.all_names)}
        for name in coordinates:
            if name not in index:
                raise InputError(f"coordinates: {_native.shown(name)} {one_of(index)}")
        places = np.array([index[name] for name in coordinates])
        return replace(
            self, places=places, names=tuple(coordinates),
            units=tuple(self.all_units[i] for i in places),
        )  # fmt: skip

    def expand(
        self, nu: FloatArray, orders: Any, y: ComplexArray, factors: FloatArray | None = None
    ) -> ComplexArray:
        """X_k of the coordinates, shape (n, n_dof, m), from condensed ones (n, q, m)."""
        return self.loaded.expand(nu, orders, y, self.places, factors)
