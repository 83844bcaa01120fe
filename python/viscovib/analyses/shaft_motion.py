"""Motions in time of systems on a shaft whose speed changes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib.analyses.acting import KnownMotion
from viscovib.analyses.forces_in_time import element_forces
from viscovib.analyses.memoryless import (
    AS_COORDINATES,
    IN_SECTIONS,
    MAX_DOF,
    METHODS,
    REMEMBERING,
    PolynomialRun,
    polynomial_runs,
)
from viscovib.analyses.runs import Run
from viscovib.analyses.whole_structure import WholeRun, check_outside
from viscovib.errors import InputError
from viscovib.results.motion_forces import ElementForces
from viscovib.results.trajectory import Trajectory
from viscovib.systems.load import LoadLike
from viscovib.systems.load_table import LoadTable
from viscovib.systems.shaft import OnShaft
from viscovib.systems.structure import ALL_GIVEN, Structure
from viscovib.systems.whole import n_hidden


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
    _native.choice("memory", memory, AS_COORDINATES)
    methods = tuple(METHODS) if len(system.dof_names) <= MAX_DOF else IN_SECTIONS
    if hidden := n_hidden(system)[0]:
        methods = REMEMBERING
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
    make, steps = polynomial_runs(system, end, initial, method, load, nu, force, solved, True, base)
    if not isinstance(system.given, Structure):
        return partial(_of_system, system, make), steps
    check_outside(system.given, make(1.0).state[:-2])
    return partial(_of_structure, system, _places(system, coordinates, load), make), steps


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


def _of_system(system: OnShaft, make: Callable[[float], Run], h: float) -> Run:
    run: Any = make(h)
    return _SystemRun(system, run.method, run.state, h, run.solved, run.job)


def _of_structure(
    system: Any, places: npt.NDArray[np.intp], make: Callable[[float], Run], h: float
) -> Run:
    run: Any = make(h)
    return _StructureRun(system, places, run)


class _ShaftRun(PolynomialRun):
    """A run with the accelerations of the shaft."""

    always_repeats = True

    @property
    def has_layers(self) -> bool:
        """True: a torque is a law."""
        return True

    def element_forces(self, kept: Trajectory) -> ElementForces:
        """Forces of elements or springs, none of which acts on the angle."""
        system: Any = self.system
        return element_forces(system.given, _without_angle(kept._known))


class _SystemRun(_ShaftRun):
    """A run of a polynomial system."""


class _StructureRun(_ShaftRun, WholeRun):
    """A run of a structure."""


def _without_angle(motion: KnownMotion) -> KnownMotion:
    """The motion of the coordinates of the system."""
    panels = motion.panels
    if panels is not None:
        panels = replace(
            panels, u=panels.u[:, :-1], rate=panels.rate[:, :-1], held=panels.held[:-1]
        )
    return replace(
        motion, u=motion.u[:, :-1], rate=motion.rate[:, :-1],
        make_panels=None if panels is None else lambda: panels,
    )  # fmt: skip
