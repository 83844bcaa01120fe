"""Third-order form of a system for the method of multiple scales."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.scales_terms import FlowTerm
from viscovib.errors import InputError
from viscovib.systems.cubic_system import CubicSystem
from viscovib.systems.oscillators import Oscillator, refuse_turning
from viscovib.systems.pendulum import Pendulum

ORDERINGS = ("general", "weak_coupling")


@dataclass(frozen=True, eq=False)
class ScalesForm:
    """A system to third order, as a vector of the core.

    Attributes
    ----------
    packed : ndarray
    handle : Handle
        The form and its system in the core.
    load_names : dict
        For each parameter: its load (from 1), and 1 for a frequency, 2 for an amplitude.
    """

    packed: FloatArray
    handle: _native.Handle
    load_names: dict[str, tuple[int, int]]

    @classmethod
    def of(
        cls,
        system: Pendulum | Oscillator | CubicSystem,
        load: npt.ArrayLike | None,
        nu: float | None,
        ordering: str,
    ) -> ScalesForm:
        """Create the form of a system; an oscillator contains no load."""
        if isinstance(system, Pendulum):
            number = ORDERINGS.index(ordering) + 1
            handle = _native.Handle("scales form", system._handle, ordering=number)
            names = {"p1": (1, 1), "p2": (2, 1), "p3": (3, 1), "f0": (1, 2),
                     "m01": (2, 2), "m02": (3, 2)}  # fmt: skip
        elif isinstance(system, Oscillator):
            refuse_turning(system, "an expansion in multiple scales")
            handle = _oscillator(system, load, nu)
            names = {"nu": (1, 1), "load": (1, 2)}
        else:
            handle = _native.Handle("scales form", packed=system._packed)
            n_loads = int(system._packed[4])
            names = {f"p{k + 1}": (k + 1, 1) for k in range(n_loads)}
            names |= {f"f{k + 1}": (k + 1, 2) for k in range(n_loads)}
        return cls(_native.run("scales numbers", handle)["numbers"], handle, names)

    @property
    def n_dof(self) -> int:
        """Number of coordinates."""
        return int(self.packed[1])

    @property
    def n(self) -> int:
        """Number of modes."""
        return int(self.packed[3])

    @property
    def drives(self) -> FloatArray:
        """Frequencies of the loads."""
        return self._tail()[1]

    @property
    def loads(self) -> FloatArray:
        """Loads, shape (n, n_loads)."""
        return self._tail()[0]

    def equations(self, tolerance: float) -> dict[str, Any]:
        """Return the modulation equations with their terms, and the modes."""
        found = _native.run("scales equations", self.handle, tolerance=float(tolerance))
        pairs = zip(found["terms"].T, found["coefficients"], strict=True)
        found["terms"] = tuple(
            FlowTerm(int(row[0]) - 1, _factors(row[1:]), complex(c)) for row, c in pairs
        )
        return found

    def _tail(self) -> tuple[FloatArray, FloatArray]:
        """Loads and their frequencies from the vector."""
        n, n_loads = int(self.packed[0]), int(self.packed[4])
        end = self.packed.size - self.n * (2 * n + 1)
        drives = self.packed[end - n_loads : end]
        loads = self.packed[end - n_loads * (n + 1) : end - n_loads]
        return loads.reshape(n, n_loads, order="F"), drives


def _oscillator(system: Oscillator, load: npt.ArrayLike | None, nu: float | None) -> _native.Handle:
    n_dof = len(system.dof_names)
    forces = _native.real_array("load", 0.0 if load is None else load)
    if forces.shape not in ((), (n_dof,)):
        raise InputError(
            f"load: must be a number or have shape ({n_dof},), got shape {forces.shape}"
        )
    if forces.ndim == 0:
        forces = np.append(forces, np.zeros(n_dof - 1))
    frequency = _native.number("nu", 1.0 if nu is None else nu)
    if frequency <= 0:
        raise InputError(f"nu = {frequency:g}: must be greater than 0")
    system = system._turned(nu)
    return _native.Handle("scales form", system._handle, load=forces, nu=frequency)


def _factors(row: Any) -> tuple[str, ...]:
    """Names of the factors of a term: amplitudes, then loads."""
    amplitudes = [f"a{k}" if k > 0 else f"a{-k}*" for k in map(int, row[:3]) if k]
    loads = [f"p{k}" if k > 0 else f"p{-k}*" for k in map(int, row[3:]) if k]
    return (*amplitudes, *loads)
