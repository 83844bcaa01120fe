"""What acts along a motion in time that is known: loads, the base, and what springs remember."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray


def loads_at(loads: dict[str, Any], t: FloatArray) -> dict[str, FloatArray]:
    """The load on coordinates relative to the base, and how the base moves them, at times.

    ``loads``: as the core takes them; returns ``load``, ``place``, ``speed`` and ``push``, each
    (n_times, n).
    """
    return _native.run("motion loads at", times=t, **loads)


def base_along(
    frequencies: FloatArray, waves: ComplexArray, table: dict[str, Any], t: FloatArray
) -> tuple[FloatArray, ...]:
    """Displacement, velocity and acceleration of a base along its direction, each (n_times,).

    ``waves``: its amplitudes, shape (n,); ``table``: as the core takes it.
    """
    none = np.zeros((1, waves.size), dtype=complex, order="F")
    loads = {"frequencies": frequencies, "amplitudes": none, "waves": waves[np.newaxis]} | table
    found = loads_at(loads, t)
    return found["place"][:, 0], found["speed"][:, 0], found["push"][:, 0]


@dataclass(frozen=True)
class KnownMotion:
    """A motion at ascending times, and what acts along it."""

    system: _native.Handle
    t: FloatArray
    #: Times, states and loads, and what the equations gave along the motion, for the core.
    given: dict[str, Any]
    #: Makes the motion on panels until then; None: the system has no memory.
    make_panels: Callable[[], dict[str, Any]] | None
    #: Forces of the mounts of a body, if they are known already.
    mounts: list[dict[str, Any]] = field(default_factory=list)
    #: Displacements, velocities and accelerations of supports that move each on its own.
    supports: tuple[FloatArray, ...] | None = None

    @cached_property
    def panels(self) -> dict[str, Any]:
        """The motion on panels until then; empty: the system has no memory."""
        return {} if self.make_panels is None else self.make_panels()

    @property
    def has_accelerations(self) -> bool:
        """True if the equations gave accelerations along the motion."""
        return "accelerations" in self.given

    def find(
        self, task: str, /, *systems: _native.Handle, remembers: bool = True, **values: Any
    ) -> dict[str, Any]:
        """Results of a task about the motion, or about its part on these systems.

        ``remembers``: the task needs the motion until each time.
        """
        panels = self.panels if remembers else {}
        return _native.run_either(
            bool(panels), task, *(systems or (self.system,)), **self.given, **panels, **values
        )


def accelerations(motion: KnownMotion, remembered: FloatArray | None = None) -> FloatArray:
    """Return accelerations of the body, shape (n_times, n), by the equations of motion.

    ``remembered``: forces -R * g on the coordinates, shape (n_times, n), if these are known.
    """
    more = {} if remembered is None else {"remembered": remembered}
    remembers = remembered is None and not motion.has_accelerations
    found = motion.find("motion accelerations", remembers=remembers, **more)
    return np.asarray(found["accelerations"])
