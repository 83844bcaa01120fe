"""What the method of multiple scales takes of a system: its third-order form, packed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray, core
from viscovib.analyses.scales_terms import FlowTerm
from viscovib.errors import InputError
from viscovib.systems.cubic_system import CubicSystem
from viscovib.systems.oscillators import Oscillator, refuse_turning
from viscovib.systems.pendulum import Pendulum

#: Room for terms at first; where there are more the call is repeated.
_ROOM = 500
_MAX_FORM = 20_000
ORDERINGS = ("general", "weak_coupling")


@dataclass(frozen=True, eq=False)
class ScalesForm:
    """A system to third order, as the core packs it.

    Attributes
    ----------
    packed : ndarray
    system : tuple
        ``packed``, the system itself and its kernels, as every flat routine takes them.
    load_names : dict
        For each number that may vary its load (from 1), and 1 for a frequency, 2 for an amplitude.
    """

    packed: FloatArray
    system: tuple[Any, ...]
    load_names: dict[str, tuple[int, int]]

    @classmethod
    def of(
        cls,
        system: Pendulum | Oscillator | CubicSystem,
        load: npt.ArrayLike | None,
        nu: float | None,
        ordering: str,
    ) -> ScalesForm:
        """Pack a system; an oscillator has no load of its own."""
        nothing = np.zeros(1)
        flat, kernels = nothing, (0, nothing, 0, nothing)
        if isinstance(system, Pendulum):
            flat = system._flat
            found, length = _native.call(
                core.pendulum_form, flat, ORDERINGS.index(ordering) + 1, _MAX_FORM
            )
            packed: FloatArray = found[:length].copy()
            names = {"p1": (1, 1), "p2": (2, 1), "p3": (3, 1), "f0": (1, 2),
                     "m01": (2, 2), "m02": (3, 2)}  # fmt: skip
        elif isinstance(system, Oscillator):
            refuse_turning(system, "an expansion in multiple scales")
            flat, kernels = system._flat, system._kernels
            packed = _oscillator(system, load, nu)
            names = {"nu": (1, 1), "load": (1, 2)}
        else:
            packed = system._packed
            n_loads = int(packed[4])
            names = {f"p{k + 1}": (k + 1, 1) for k in range(n_loads)}
            names |= {f"f{k + 1}": (k + 1, 2) for k in range(n_loads)}
        return cls(packed, (packed, flat, *kernels), names)

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

    def equations(self, tolerance: float) -> tuple[Any, ...]:
        """Return the modulation equations and what belongs to them, as the core has it."""
        room = n_terms = _ROOM
        while n_terms >= room:
            room = n_terms + 1
            *found, n_terms, terms, coefficients = _native.call(
                core.scales_form, *self.system, tolerance, self.n, int(self.packed[0]), room
            )
        read = tuple(
            FlowTerm(int(terms[0, i]) - 1, _factors(terms[1:, i]), complex(coefficients[i]))
            for i in range(n_terms)
        )
        return (*found, read)

    def _tail(self) -> tuple[FloatArray, FloatArray]:
        """Loads and their frequencies out of the packed numbers."""
        n, n_loads = int(self.packed[0]), int(self.packed[4])
        end = self.packed.size - self.n * (2 * n + 1)
        drives = self.packed[end - n_loads : end]
        loads = self.packed[end - n_loads * (n + 1) : end - n_loads]
        return loads.reshape(n, n_loads, order="F"), drives


def _oscillator(system: Oscillator, load: npt.ArrayLike | None, nu: float | None) -> FloatArray:
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
    packed, length = _native.call(
        core.oscillator_form, system._flat, *system._kernels, forces, frequency, _MAX_FORM
    )
    if length > _MAX_FORM:
        raise InputError("system: has too many terms for multiple scales")
    return np.asarray(packed[:length].copy())


def _factors(row: Any) -> tuple[str, ...]:
    """Names of the factors of a term: amplitudes, then loads."""
    amplitudes = [f"a{k}" if k > 0 else f"a{-k}*" for k in map(int, row[:3]) if k]
    loads = [f"p{k}" if k > 0 else f"p{-k}*" for k in map(int, row[3:]) if k]
    return (*amplitudes, *loads)
