"""Motions of a pendulum by methods for ODEs, and the names of these methods."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.oscillator_motion import METHODS
from viscovib.analyses.runs import MAX_STEPS, Run
from viscovib.errors import InputError
from viscovib.results.trajectory import Trajectory
from viscovib.systems.pendulum import Pendulum

#: Explicit methods by their index in the core.
EXPLICIT = {"rk4": 1, "dop8": 2, "verner8": 3, "verner9": 4}
#: Taylor's method by its order, only for many motions together.
TAYLOR = {"taylor8": 7, "taylor12": 8, "taylor16": 9, "taylor20": 10, "taylor24": 11}
#: Methods for many motions together.
SIDE_BY_SIDE = EXPLICIT | {"gauss8": 5, "gauss16": 6} | TAYLOR
#: Largest number of coordinates for explicit methods: the size of a vector lane of the core.
MAX_DOF = 6


def pendulum_runs(
    system: Pendulum,
    end: float,
    initial: npt.ArrayLike | None,
    method: str,
    solved: float,
) -> tuple[Callable[[float], Run], int]:
    """Return a function that creates a run with a step size, and the first number of steps."""
    if initial is None:
        raise InputError("initial: must be given (or resume)")
    state = checked_state("initial", initial, (6,))
    name = _native.choice("method", method, ("auto", *METHODS))
    name = "gauss8" if name == "auto" else name
    return partial(_PendulumRun.of, system, name, state, solved), first_steps(system, end)


def checked_state(name: str, value: npt.ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Return states with z > -1, of the given shape."""
    state = _native.real_array(name, value)
    if state.shape != shape:
        raise InputError(f"{name}: must have shape {shape}, got {state.shape}")
    lowest = state[0] if state.ndim == 1 else state[..., 0].min()
    if lowest <= -1:
        raise InputError(f"{name} z = {lowest:g}: must be greater than -1")
    return state


def first_steps(system: Pendulum, end: float) -> int:
    """First number of steps of the step size search: four per fastest linear period."""
    fastest = system._fastest()
    if not math.isfinite(end * fastest):
        raise InputError(
            f"t_end = {end:g}: contains more periods of the fastest motion (frequency "
            f"{fastest:g}) than can be counted"
        )
    return max(1, math.ceil(min(end * fastest / (0.5 * math.pi), 2.0 * MAX_STEPS)))


class _PendulumRun(Run):
    """A run of a pendulum."""

    counts: str = "evaluations"
    system: Pendulum

    @classmethod
    def of(
        cls, system: Pendulum, method: str, state: FloatArray, solved: float, h: float
    ) -> "_PendulumRun":
        """Create a run, with the step size as the last argument."""
        return cls(system, method, state, h, solved)

    def power(self, t: FloatArray, state: FloatArray) -> FloatArray:
        """Power of loads and damping."""
        return self.system.power(t, state)

    def accelerations(self, kept: Trajectory) -> FloatArray:
        """By the equations of motion."""
        return self.system.rhs(kept.t, kept.state)[:, 1::2]

    def _plan(self, **steps: Any) -> str:
        text: str = _native.run(
            "motion plan of pendulum", self.system._handle, initial=self.begin,
            method=METHODS[self.method], **steps,
        )["text"]  # fmt: skip
        return text

    def _given(self) -> tuple[str, tuple[_native.Handle, ...], dict[str, Any]]:
        """Task, handles and values for a pendulum."""
        return "motion of pendulum", (self.system._handle,), {"method": METHODS[self.method]}
