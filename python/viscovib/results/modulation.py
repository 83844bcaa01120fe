"""Resonances of the method of multiple scales, and its amplitudes in time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from viscovib._native import ComplexArray, FloatArray
from viscovib.common.counts import things
from viscovib.common.plan import Plan
from viscovib.common.results import Dataset, Result, as_dataset, span


class Resonance(NamedTuple):
    """A resonance condition: sum of multiples x frequencies near 0.

    ``order`` is the order of the expansion in which it acts. ``divisor`` is the sum divided by its
    highest frequency. ``near`` is True if the divisor is within the tolerance.

    Examples
    --------
    >>> import viscovib as vv
    >>> body = vv.Pendulum(
    ...     e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01, f0=0.002, p1=1.02
    ... )
    >>> near = vv.MultipleScales(body).resonances(tolerance=0.1)
    >>> words = [str(one) for one in near]
    """

    names: tuple[str, ...]
    multiples: tuple[int, ...]
    order: int
    divisor: float
    near: bool

    @property
    def coefficients(self) -> dict[str, int]:
        """Non-zero multiples, by the name of the frequency."""
        return {name: c for name, c in zip(self.names, self.multiples, strict=True) if c}

    @property
    def label(self) -> str:
        """The condition as text, "w1 ~ 2 w2"."""
        sides: list[list[str]] = [[], []]
        for name, c in self.coefficients.items():
            sides[int(c < 0)].append(name if abs(c) == 1 else f"{abs(c)} {name}")
        lone = [len(side) == 1 and " " not in side[0] for side in sides]
        loaded = [any("p" in word for word in side) for side in sides]
        if (lone[1], loaded[1]) > (lone[0], loaded[0]):
            sides.reverse()
        return " ~ ".join(" + ".join(side) for side in sides)

    def __str__(self) -> str:
        """Label, order and divisor."""
        near = ", near" if self.near else ""
        return f"{self.label}: order {self.order}, divisor {self.divisor:.4g}{near}"


@dataclass(frozen=True, eq=False, repr=False)
class Modulation(Result):
    """Amplitudes in time, q = Re sum_j r_j A_j(t) exp(i frame_j t) + higher orders.

    Attributes
    ----------
    t : ndarray, shape (n,)
    complex_amplitudes : ndarray, shape (n, n_modes)
        A_j.
    frame : ndarray, shape (n_modes,)
        Reference frequencies of the amplitudes.
    initial : complex ndarray, shape (n_modes,)
        Amplitudes at t = 0.
    error : ndarray, shape (n,)
        Estimated largest error of the complex amplitudes as a solution of the modulation equations,
        by the step size and rounding; inf at times that finer steps do not reach. The error of the
        expansion is separate: see the results of `MultipleScales.motion`.
    steps : int
        Number of integration steps.
    outcome : str
        "complete", "overflow", "step limit" or "cancelled".
    plan : Plan
        What was computed, and what was skipped and why.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> body = vv.Pendulum(
    ...     e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01, f0=0.002, p1=1.02
    ... )
    >>> scales = vv.MultipleScales(body)
    >>> slow = scales.modulation(np.linspace(0, 100, 50), [0.05, 0, 0.1, 0, 0, 0])
    """

    t: FloatArray
    complex_amplitudes: ComplexArray
    frame: FloatArray
    initial: ComplexArray
    error: FloatArray
    steps: int
    outcome: str
    plan: Plan

    kind = "modulation"

    @property
    def complete(self) -> bool:  # type: ignore[override]
        """True if the final time was reached."""
        return self.outcome == "complete"

    def _headline(self) -> str:
        return f"{self.outcome}, {things(self.t.size, 'time')}, {things(self.steps, 'step')}"

    def _scope(self) -> list[str]:
        worst = f"largest error of the integration {self.error.max(initial=0.0):.1e}"
        return [f"t: {span(self.t)}; {things(self.frame.size, 'mode')}, {worst}"]

    def to_dataset(self) -> Dataset:
        """Return amplitudes and phases as an xarray Dataset over t."""
        dims = ("t", "mode")
        return as_dataset(
            {
                "amplitude": (dims, self.amplitude),
                "phase": (dims, self.phase, {"units": "rad"}),
                "error": ("t", self.error),
            },
            coords={"t": self.t},
            attrs={"outcome": self.outcome, "plan": str(self.plan)},
        )

    @property
    def amplitude(self) -> FloatArray:
        """Return the real amplitudes b_j, shape (n, n_modes)."""
        return np.abs(self.complex_amplitudes)

    @property
    def phase(self) -> FloatArray:
        """Return the phases relative to the frame (rad), continuous in time, shape (n, n_modes)."""
        return np.asarray(np.unwrap(np.angle(self.complex_amplitudes), axis=0))
