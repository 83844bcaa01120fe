"""Linear responses of many coordinates at the speed of their load, by direct solutions."""

from __future__ import annotations

from typing import Any

import numpy as np

from viscovib._native import ComplexArray, FloatArray
from viscovib.systems.frequency_formulas import values_of
from viscovib.systems.linear_model import LinearModel
from viscovib.systems.load import (
    LoadLike,
    base_by_order,
    in_components,
    load_series,
    name_places,
    parts_of,
)
from viscovib.systems.speed_matrices import OF_SPEED
from viscovib.systems.structure_matrices import linear_model

#: Fewer coordinates are as fast in the core.
_SMALLEST = 24
#: Largest share of entries that are not 0 for sparse factorizations.
_SPARSE = 0.2
#: Code of the core for a singular dynamic stiffness.
_SINGULAR = 3


def goes_directly(system: Any, base: Any) -> bool:
    """True if direct solutions are faster: many coordinates, and matrices that depend on speed."""
    if not system._depends_on_speed:
        return False
    several = any(in_components(term) for term in base_by_order(base).values())
    return len(system.dof_names) >= _SMALLEST and not several


class DirectLinear:
    """The linear responses to a load, with one factorization for each frequency and harmonic."""

    def __init__(self, system: Any, load: LoadLike | None, base: LoadLike | None) -> None:
        n, places = len(system.dof_names), name_places(system.dof_names)
        self.model = _model_of(system)
        matrices: list[Any] = [*self.model.matrices, *(getattr(system, one) for one in OF_SPEED)]
        known = [_csc(one) for one in matrices if one is not None]
        #: True if the dynamic stiffness is sparse.
        self.sparse = sum(abs(one) for one in known).nnz <= _SPARSE * n * n
        form = _csc if self.sparse else _dense
        self.matrices = [None if one is None else form(one) for one in matrices]
        constant, self.varying = parts_of(load, n, places)
        orders, series = load_series(constant, base, n, places)
        own = [one.order for one in self.varying]
        self.forces = {
            order: series[:, j]
            for j, order in enumerate(orders.tolist())
            if series[:, j].any() or order in own
        }
        self.forces = {k: np.zeros(n + 1, complex) for k in own} | self.forces
        direction = system._base_direction
        self.direction = np.zeros(n) if direction is None else direction

    def __call__(self, nu: FloatArray) -> dict[str, Any]:
        """The responses at these frequencies, in the form of the core."""
        orders = sorted(self.forces)
        values = [values_of([one.formula], nu)[:, 0] for one in self.varying]
        found = np.empty((len(orders), self.direction.size, nu.size), dtype=complex, order="F")
        for j, order in enumerate(orders):
            factors = self.model.coefficients(1j * order * nu)
            for i, at in enumerate(nu.tolist()):
                force = self.forces[order][:-1].copy()
                for one, value in zip(self.varying, values, strict=True):
                    if one.order == order:
                        force += value[i] * one.force
                moved = self.direction * self.forces[order][-1]
                force += (order * at) ** 2 * (self.matrices[0] @ moved)
                weights = [*factors[:, i], 1j * order * at * at, at, at**2]
                parts = zip(weights, self.matrices, strict=True)
                stiffness = sum(weight * one for weight, one in parts if one is not None)
                found[j, :, i] = self._solved(stiffness, force) + moved
        lost = ~np.isfinite(found).all(axis=(0, 1))
        found[:, :, lost] = np.nan
        none = np.zeros(nu.size)
        return {
            "kept": np.array(orders), "method": "linear", "coefficients": found,
            "outcomes": np.where(lost, _SINGULAR, 0), "iterations": none.astype(int),
            "highest": np.where(lost, 0, max(orders, default=0)), "rate": none,
            "truncation": np.where(lost, np.nan, 0.0), "allowed": none,
        }  # fmt: skip

    def _solved(self, stiffness: Any, force: ComplexArray) -> ComplexArray:
        """Return the displacements; NaN if the stiffness is singular."""
        try:
            if not self.sparse:
                return np.asarray(np.linalg.solve(stiffness, force))
            from scipy.sparse.linalg import splu

            return np.asarray(splu(stiffness).solve(force))
        except (np.linalg.LinAlgError, RuntimeError):
            return np.full(force.shape, np.nan, dtype=complex)


def _csc(matrix: Any) -> Any:
    from scipy.sparse import csc_array

    return csc_array(matrix)


def _dense(matrix: Any) -> Any:
    return matrix.toarray() if hasattr(matrix, "toarray") else np.asarray(matrix)


def _model_of(system: Any) -> LinearModel:
    """The linear part with memory, at rest."""
    if system._is_condensed:
        layers: Any = system._layers
        found = linear_model(
            system.mass, system._damping_at_rest, system.stiffness, None, system._all_elements,
            remembering=True,
        )  # fmt: skip
        return found._replace(layers=[*found.layers, *layers.whole])
    groups: list[Any] = [group for group in system.groups if group.kernel is not None]
    elastic = sum(group.stiffness for group in system.groups if group.kernel is None)
    none = np.zeros_like(system._mass_matrix)
    return LinearModel(
        system._mass_matrix, none + elastic, system._damping,
        layers=[(group.stiffness, group.kernel) for group in groups],
        dampers=[
            (group.law_dampers, group.kernel) for group in groups if group.law_dampers is not None
        ],
    )  # fmt: skip
