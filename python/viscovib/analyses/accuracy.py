"""Tolerances of motions in time, and reasons why two runs disagree."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.parameters import RTOL, TIME_TOLERANCE
from viscovib.errors import InputError
from viscovib.systems.law_ends import edges_text

if TYPE_CHECKING:
    from viscovib.results.trajectory import Trajectory

_EPS = float(np.finfo(float).eps)
#: Smallest size of a coordinate in comparisons, relative to the largest coordinate.
_SMALLEST = 1e-6


@dataclass(frozen=True)
class Accuracy:
    """Allowed errors: ``absolute``, and ``relative`` to the largest value of each column.

    ``by_size``: relative to the size of the motion instead, which for displacements is the largest
    displacement, for velocities the largest of all numbers.
    """

    absolute: float
    relative: float = 0.0
    by_size: bool = False

    @classmethod
    def checked(
        cls, tolerance: float | None, rtol: float | None, atol: float | None, default: float | None
    ) -> "Accuracy | None":
        """Check the arguments; ``default``: relative to the size of the motion, None: none."""
        if rtol is None and atol is None:
            if tolerance is not None:
                return cls(TIME_TOLERANCE.check(tolerance))
            return None if default is None else cls(0.0, default, by_size=True)
        if tolerance is not None:
            raise InputError(
                "tolerance, rtol and atol: tolerance is another name of atol, give one of them"
            )
        relative = 0.0 if rtol is None else RTOL.check(rtol)
        absolute = 0.0 if atol is None else _native.number("atol", atol)
        if absolute < 0 or (rtol is None and absolute == 0):
            raise InputError(f"atol = {absolute:g}: must be greater than 0, or 0 with an rtol")
        return cls(absolute, relative)

    @property
    def solved(self) -> float:
        """Relative tolerance for approximations, such as kernels."""
        return 0.1 * min(filter(None, (self.absolute, self.relative)))

    def allowed(self, states: FloatArray) -> FloatArray:
        """Largest allowed error of each column of states."""
        sizes = np.abs(states).max(axis=0, initial=0.0)
        if self.by_size:
            pair = sizes[::2].max(initial=0.0), sizes.max(initial=0.0)
            return self.relative * np.tile(pair, sizes.size // 2)
        sizes = np.maximum(sizes, _SMALLEST * sizes.max(initial=0.0))
        return np.asarray(self.absolute + self.relative * sizes)

    @property
    def text(self) -> str:
        """The allowed error as a text."""
        if self.by_size:
            return f"{self.relative:g} of the size of the motion"
        if self.relative == 0:
            return f"{self.absolute:g}"
        return f"{self.absolute:g} and {self.relative:g} of the largest"

    def __str__(self) -> str:
        """Return the tolerance as given by the user."""
        if self.by_size:
            return f"tolerance = {self.relative:g} of the size of the motion"
        if self.relative == 0:
            return f"tolerance = {self.absolute:g}"
        return f"rtol = {self.relative:g}, atol = {self.absolute:g}"


def along(run: "Trajectory") -> FloatArray:
    """States of a run, including observed states that it does not keep."""
    looks = [] if run._resume is None else run._resume.looks
    return np.concatenate([looks, run.state]) if len(looks) else run.state


def rounding_of(states: FloatArray) -> float:
    """Rounding error of states; 0 only if all states are 0."""
    return 4 * _EPS * float(np.abs(states).max(initial=0.0))


#: Relative rounding error of a step; number of states within which growing errors are still
#: small.
_ROUNDING, _FEW = 4 * np.finfo(float).eps, 20


def reason(coarse: "Trajectory", fine: "Trajectory", want: Accuracy) -> str:
    """Return a text that explains why halving the step size does not help."""
    for run in (fine, coarse):
        if run.outcome != "completed":
            pole = run._pole_passed() or run._pole_after(run.t.size - 1)
            law = f": {run.reason}"
            if run._law_end is None and pole is None:
                law = edges_text(run.system) if run.outcome == "diverged" else ""
            return (
                f"the run is {run.outcome!r} at t = {run.t_reached:.6g}, in steps of "
                f"{run.step:.3g} (largest value {np.abs(run.state).max():.3g}){law}"
            )
    if coarse.state.shape != fine.state.shape:
        return "the two runs end at different times"
    parts = np.abs(fine.state - coarse.state)
    allowed = want.allowed(along(fine))
    worst = int((parts.max(axis=0) / np.maximum(allowed, 1e-300)).argmax())
    part, size = parts[:, worst], float(np.abs(fine.state[:, worst]).max())
    if allowed[worst] < 1e-13 * size and part.max() < 1e-6 * size:
        return (
            f"the motion is as large as {size:.3g}, and the tolerance is "
            f"{allowed[worst] / size:.1e} of that, too near to rounding: give rtol"
        )
    bad = np.flatnonzero(part > allowed[worst])
    if not bad.size:
        return (
            "two runs differ on the way and end alike by chance, as motions that pass through "
            "chaos do: take a shorter run, or look at all states"
        )
    first = int(bad[0])
    t = fine.t
    # Unstable errors grow over many steps; a kink or jump causes an error within one step.
    most = np.maximum(np.maximum.accumulate(part), 1e-3 * allowed[worst])
    sudden = np.flatnonzero(most[1:] > 100 * most[:-1])
    if sudden.size:
        i = int(sudden[0])
        pole = fine._pole_passed() or fine._pole_after(i)
        if pole is not None:
            return pole
        layer = fine._layer_passed(slice(max(i - 1, 0), i + 3))
        if layer is not None:
            return f"two runs agree to t = {t[i]:.6g} and differ suddenly after it: {layer}"
        return (
            f"two runs agree to t = {t[i]:.6g} and differ suddenly by t = {t[i + 1]:.6g}, as where "
            "a force has a jump or corner on which no step ends, or changes too fast for them: "
            "take a larger tolerance or a smaller dt"
        )
    steps = fine.t_reached / fine.step
    lost = _ROUNDING * steps * size
    if part.max() <= min(lost, 1e-8 * size):
        return (
            f"rounding leaves about {part.max():.1e} of a motion as large as {size:.3g} in "
            f"{steps:.0f} steps: take a larger tolerance or a shorter run"
        )
    # In a long run unstable errors may grow early, but not within a few steps.
    alike = min(0.05 * t.size, _FEW)
    if first > alike and np.median(part[: first // 2 + 1]) < 0.1 * allowed[worst]:
        grown = part[first:].max() / max(float(part[: first // 2 + 1].max()), 1e-300)
        until = float(t[first - 1])
        return (
            f"two runs agree to t = {until:.6g} and differ {grown:.1e} times as much after it: "
            "the motion is chaotic or unstable, take a shorter run or a larger tolerance"
        )
    if t.size <= _FEW:
        # With so few states the source of errors is unknown.
        return (
            "the fastest motion is not resolved, or the motion is chaotic or unstable: take a "
            "larger tolerance, a smaller dt or a shorter run"
        )
    return (
        "the fastest motion is not resolved (it is too stiff for this method): take a larger "
        "tolerance or a smaller dt"
    )
