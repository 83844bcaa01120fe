"""Motions in time of systems on a shaft whose speed changes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib.analyses.forces_in_time import element_forces
from viscovib.analyses.memoryless import MAX_DOF
from viscovib.analyses.oscillator_motion import (
    METHODS,
    OscillatorRun,
)
from viscovib.analyses.runs import Run
from viscovib.analyses.whole_structure import WholeMotion, WholeRun, check_outside
from viscovib.errors import InputError
from viscovib.results.motion_forces import ElementForces
from viscovib.results.trajectory import Trajectory
from viscovib.systems.load import LoadLike
from viscovib.systems.load_table import LoadTable
from viscovib.systems.shaft import OnShaft
from viscovib.systems.structure import ALL_GIVEN, Structure
from viscovib.systems.whole import n_hidden

#: Methods for more coordinates than a lane of the core, and with memory.
_IN_SECTIONS, _REMEMBERING = ("gauss8", "gauss2", "gauss3"), ("gauss8",)


def shaft_runs(
    system: OnShaft,
    end: float,
    initial: npt.ArrayLike | None,
    method: str,
    load: LoadLike | None,
    nu: float | None,
    force: LoadTable | None,
    solved: float,
    base: LoadLike | LoadTable | None,
    memory: str,
    coordinates: Sequence[str] | None,
) -> tuple[Callable[[float], Run], int]:
    """Return a function that creates a run with a step size, and the first number of steps."""
    _native.choice("memory", memory, ("auto", "exponentials"))
    methods = tuple(METHODS) if len(system.dof_names) <= MAX_DOF else _IN_SECTIONS
    if hidden := n_hidden(system)[0]:
        methods = _REMEMBERING
    if hidden < 0:
        raise InputError(
            "kernel: must be, or be fitted by, a sum of exponentials while the speed changes: use "
            "kernel.sum_of_exponentials()"
        )
    _native.choice("method", method, ("auto", *methods))
    n = len(system.dof_names) - 1
    if isinstance(load, Mapping):
        # No load acts on the angle.
        given: Mapping[Any, Any] = load
        load = {
            key: np.append(value, 0.0) if np.shape(value) == (n,) else value
            for key, value in given.items()
        }
    motion = WholeMotion.checked(
        system, end, initial, method, load, nu, base, force, None, memory
    ).with_equations()
    first: int = motion.chosen["first"]
    if not isinstance(system.given, Structure):
        return partial(_SystemRun, motion, solved), first
    check_outside(system.given, motion.state[:-2])
    motion = replace(motion, structure=system, places=_places(system, coordinates, load))
    return partial(_StructureRun, motion, solved), first


def _places(
    system: Any, coordinates: Sequence[str] | None, load: LoadLike | None
) -> npt.NDArray[np.intp]:
    """Indices of the coordinates in results: those of the structure, and the angle."""
    n = len(system.dof_names)
    if coordinates is not None:
        return Structure._chosen(system, coordinates)
    if n <= ALL_GIVEN:
        return np.arange(n)
    still = system.given._turned(0.0)
    return np.append(still._wanted(None, still._loaded(load, None)), n - 1)


class _ShaftRun(OscillatorRun):
    """A run with the accelerations of the shaft."""

    always_repeats = True

    @property
    def has_layers(self) -> bool:
        """True: a torque is a law."""
        return True

    def element_forces(self, kept: Trajectory) -> ElementForces:
        """Forces of elements or springs, none of which acts on the angle."""
        system: Any = self.system
        return element_forces(system.given, kept._known)


class _SystemRun(_ShaftRun):
    """A run of a polynomial system."""


class _StructureRun(_ShaftRun, WholeRun):
    """A run of a structure."""
