"""The members of an ensemble: data that differ from run to run, in the form of the core."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.memoryless import SIDE_BY_SIDE, checked_state
from viscovib.analyses.runs import MAX_STEPS, has_outrun
from viscovib.common.parameters import no_frequency
from viscovib.errors import InputError
from viscovib.results.trajectory import OUTCOMES
from viscovib.systems.load import LoadLike, harmonics_of, oscillator_series
from viscovib.systems.many_numbers import ManySystems, joined, scaled_parts
from viscovib.systems.pendulum import PARAMETERS, Pendulum
from viscovib.systems.polynomial_system import PolynomialSystem

#: Scales of a polynomial system that may vary, in the order of the core.
SCALES = ("load_scale", "stiffness_scale", "damping_scale", "forces_scale")
#: Index of the outcome "step too large".
_COARSE = OUTCOMES.index("step too large")


#: Sections of some runs, and their times if they are not periods of a load.
Sections = tuple[FloatArray | None, FloatArray | None]


class Members(ABC):
    """Runs of one kind of system; shapes begin with the number of runs n."""

    system: Any
    varied: dict[str, FloatArray]
    states: FloatArray
    #: Names of the coordinates in states.
    dof_names: tuple[str, ...]
    method_name: str
    #: True if runs are computed together in the vector unit; else the surface of sections.
    side_by_side = True
    surface: Any = None
    #: Discarded time of each run.
    discarded: FloatArray
    #: Start times of peaks and means along the motions; None: peaks and means of samples at
    #: steps.
    gathered_since: FloatArray | None = None
    #: True if the step size is searched by runs with decreasing step sizes.
    step_is_sought = False

    @property
    def n(self) -> int:
        """Number of runs."""
        return int(self.states.shape[0])

    @abstractmethod
    def load_frequencies(self, sections: int) -> tuple[str, FloatArray]:
        """Name and frequencies of the load of the sections."""

    @abstractmethod
    def first_steps(self, spans: FloatArray) -> int:
        """Number of steps at the start of the step size search."""

    @abstractmethod
    def call(self, part: slice, *given: Any) -> tuple[Any, ...]:
        """Compute a part of the runs."""

    def passages(self, sections: FloatArray | None) -> Sections:
        """Return the sections of the last run; of a load they are ``sections``."""
        return sections, None

    def found_so_far(self, part: slice, results: bool) -> Any:
        """Findings about a part of the runs that later runs with smaller steps need.

        ``results``: also the results that `call` does not return.
        """
        return None

    def add_findings(self, found: Any) -> None:  # noqa: B027
        """Add the findings of another process."""


class LaneMembers(Members):
    """Runs that are computed together in the vector unit."""

    @abstractmethod
    def _given(self, part: slice) -> tuple[str, dict[str, Any]]:
        """Kind of the systems of some runs, and their numbers for the core."""

    def first_steps(self, spans: FloatArray) -> int:
        """Four steps per period of the fastest linear motion and of the highest load harmonic."""
        kind, values = self._given(slice(0, self.n))
        fastest = _native.run(f"ensemble rates of {kind}", **values)["rates"]
        many = spans * fastest
        if not np.isfinite(many).all():
            raise InputError(
                f"t_end = {spans.max():g}: contains more periods of the fastest motion (frequency "
                f"{fastest.max():g}) than can be counted"
            )
        return max(1, math.ceil(min(float(many.max()) / (0.5 * math.pi), 2.0 * MAX_STEPS)))

    def call(self, part: slice, *given: Any) -> tuple[Any, ...]:
        """Make some of the runs."""
        kind, values = self._given(part)
        *found, others = side_by_side(f"ensemble of {kind}", given, **values)
        self._see_missed(part.start + np.flatnonzero(others["missed"]))
        return tuple(found)

    def _see_missed(self, runs: npt.NDArray[np.intp]) -> None:
        """Note runs whose steps may have skipped a thin layer of a law."""


class PendulumMembers(LaneMembers):
    """Pendulums with different parameters and starts."""

    def __init__(
        self,
        system: Pendulum,
        initial: npt.ArrayLike,
        given: Mapping[str, npt.ArrayLike],
        method: str,
    ) -> None:
        self.dof_names, self.method_name = system.dof_names, _side_by_side(method)
        for name in given:
            if name not in PARAMETERS:
                raise InputError(
                    f"parameters: {name!r} is not a parameter of the pendulum, must be one of "
                    f"{', '.join(PARAMETERS)}"
                )
        self.system = system
        self.varied, states = shared_runs(given, initial, 6)
        self.states = checked_state("initial", states, states.shape)
        self.flat = np.tile(system._flat[:, np.newaxis], (1, self.n))
        for name, values in self.varied.items():
            self.flat[PARAMETERS.index(name)] = values
        self.flat = np.asfortranarray(self.flat)

    def load_frequencies(self, sections: int) -> tuple[str, FloatArray]:
        """Return p1, p2 or p3."""
        name = f"p{_native.integer('sections', sections, 1, 3)}"
        return name, self.flat[PARAMETERS.index(name)]

    def _given(self, part: slice) -> tuple[str, dict[str, Any]]:
        return "pendulums", {"flat": self.flat[:, part], "initial": self.states[part].T}


class PolynomialMembers(LaneMembers):
    """Polynomial systems without memory, with any laws; ``alone``: creates single runs.

    ``with_parameters``: creates systems with different parameters of laws or elements.
    """

    def __init__(
        self,
        system: PolynomialSystem,
        initial: npt.ArrayLike,
        given: Mapping[str, npt.ArrayLike],
        load: LoadLike | None,
        nu: float | None,
        method: str,
        alone: Callable[[], Members],
        with_parameters: Callable[[Mapping[str, FloatArray]], ManySystems] | None = None,
    ) -> None:
        d = len(system.dof_names)
        self.dof_names, self.method_name = system.dof_names, _side_by_side(method)
        if "forces_scale" in given and any(group.laws for group in system.groups):
            raise InputError("parameters: 'forces_scale' must not scale laws with functions")
        self.system = system
        self.varied, self.states = shared_runs(given, initial, 2 * d)
        self.orders, self.series, self.formulas = oscillator_series(system, load, None)
        if load is None and nu is not None:
            raise InputError("nu: must not be given without load")
        frequency = 0.0 if nu is None else _native.number("nu", nu)
        self.nu = np.array(self.varied.get("nu", np.full(self.n, frequency)))
        highest = harmonics_of(self.orders)[self.series.any(axis=0)].max(initial=0)
        self._highest = int(highest)
        moving = self._highest > 0
        if (self.nu < 0).any() or (moving and (self.nu == 0).any()):
            has_nu = nu is not None or "nu" in self.varied
            raise no_frequency(self.nu.min() if has_nu else None)
        self.scales = np.ones((len(SCALES), self.n), order="F")
        for i, name in enumerate(SCALES):
            if name in self.varied:
                self.scales[i] = self.varied[name]
        self.systems = joined([(system._flat, scaled_parts(system))])
        numbers = {name: self.varied[name] for name in given if name not in ("nu", *SCALES)}
        if numbers:
            assert with_parameters is not None
            self.systems = with_parameters(numbers)
        self._alone = alone
        self._made_alone: set[int] = set()

    def load_frequencies(self, sections: int) -> tuple[str, FloatArray]:
        """Return nu."""
        _native.integer("sections", sections, 1, 1)
        return "nu", self.nu

    def _given(self, part: slice) -> tuple[str, dict[str, Any]]:
        flat, lengths, own = self.systems
        if len(flat) > 1:
            flat, lengths, own = flat[part], lengths[part], own[part]
        d = own.shape[1]
        return "oscillators", {
            "flat": flat.T, "lengths": lengths, "orders": self.orders, "series": self.series,
            "formulas": self.formulas,
            "own": own.transpose(1, 2, 3, 0).reshape((d, d, -1), order="F"), "nu": self.nu[part],
            "scales": self.scales[:, part], "initial": self.states[part].T,
        }  # fmt: skip

    def found_so_far(self, part: slice, results: bool) -> Any:
        """Runs that need partial steps, and the findings about them."""
        runs = {i for i in self._made_alone if part.start <= i < part.stop}
        return runs, self._single().found_so_far(part, results) if runs else None

    def add_findings(self, found: Any) -> None:
        """Add runs that need partial steps."""
        runs, about = found
        self._made_alone |= runs
        if runs:
            self._single().add_findings(about)

    def _single(self) -> Members:
        """The runs one by one, with the same times of their results."""
        members = self._alone()
        members.discarded, members.gathered_since = self.discarded, self.gathered_since
        return members

    def _see_missed(self, runs: npt.NDArray[np.intp]) -> None:
        self._made_alone.update(runs.tolist())

    def call(self, part: slice, *given: Any) -> tuple[Any, ...]:
        """Compute a part of the runs."""
        found = super().call(part, *given)
        h, *settings, sections = given
        # A run that needs partial steps once uses them for all step sizes: they are more accurate
        # than full steps and would disturb the comparison of step sizes.
        for i in [i for i in range(part.start, part.stop) if i in self._made_alone]:
            # Common steps may have jumped over thin layers of laws; a single run detects them.
            k = i - part.start
            here = slice(k, k + 1)
            its_own = sections[:, :, here] if sections.shape[2] else sections
            one = self._single().call(slice(i, i + 1), h[here], *settings, its_own)
            if self.step_is_sought and one[1][0] == _COARSE:
                self._refuse_outrun(i, float(h[k]), float(one[2][0]), settings)
            for all_of_it, its in zip(found, one, strict=True):
                if all_of_it.shape[-1]:
                    all_of_it[..., here] = its
        return found

    def _refuse_outrun(self, i: int, h: float, reached: float, settings: list[Any]) -> None:
        """Refuse a diverging run whose laws change too fast, if shorter steps end there too."""
        method, n_steps, cancel = settings[0], settings[1], settings[-1]
        nothing = np.empty((0, 0, 0), order="F")
        again = self._single().call(
            slice(i, i + 1), np.array([h / 2]), method, 2 * n_steps, 0, 0.0, 1, 0, 0, 0,
            np.empty(0), cancel, nothing,
        )  # fmt: skip
        state, end = again[0][:, 0], float(again[2][0])
        if again[1][0] == _COARSE and has_outrun(self.states[i], state, reached, end, h):
            raise InputError(
                f"dt = 'auto': run {i} ends at t = {end:.6g}, where its state is "
                f"{np.array2string(state, precision=3)}: there its laws change too fast for "
                "steps of any length: use a shorter run, or give dt"
            )


def side_by_side(
    task: str, given: tuple[Any, ...], *objects: _native.Handle, **values: Any
) -> tuple[Any, ...]:
    """Run a task on many runs; return its results in the order of `Members.call`, then others."""
    (
        h, method, n_steps, n_discard, ahead, every, section_every, n_moments, exponents, lines,
        _, sections,
    ) = given  # fmt: skip
    found = _native.run(
        task, *objects, h=h, method=method, n_steps=n_steps, n_discard=n_discard,
        ahead=float(ahead), sample_every=every, section_every=section_every,
        points=sections.shape[1], moments=n_moments > 0, n_exponents=exponents, lines=lines,
        **values,
    )  # fmt: skip
    if sections.shape[2]:
        sections[...] = found["sections"]
    names = (
        "state", "ended", "t_reached", "peak", "mean", "rms", "amplitudes", "lyapunov",
        "lyapunov_error",
    )  # fmt: skip
    return *(found.pop(name) for name in names), found


def _side_by_side(method: str) -> str:
    name = _native.choice("method", method, ("auto", *SIDE_BY_SIDE))
    return "verner9" if name == "auto" else name


#: Largest size of the states of all runs; matrices, peaks and sums need further memory.
_MOST_NUMBERS = 2**26


def shared_runs(
    given: Mapping[str, npt.ArrayLike], initial: npt.ArrayLike, width: int
) -> tuple[dict[str, FloatArray], FloatArray]:
    """Return the varied parameters, and a start for each run."""
    # Check before copying.
    n = max(
        [1]
        + [
            len(many)
            for many in (initial, *given.values())
            if isinstance(many, (list, tuple)) or (isinstance(many, np.ndarray) and many.ndim)
        ]
    )
    if n * width > _MOST_NUMBERS:
        raise InputError(
            f"initial, parameters: {n} runs with states of {width} numbers, must be at most "
            f"{_MOST_NUMBERS // width} runs; make several ensembles"
        )
    varied = {
        name: _native.real_array(f"parameters[{name!r}]", values, ndim=1)
        for name, values in given.items()
    }
    states = _native.real_array("initial", initial)
    if states.ndim not in (1, 2) or states.shape[-1] != width:
        raise InputError(f"initial: must have shape (n, {width}) or ({width},), got {states.shape}")
    counts = {name: values.size for name, values in varied.items()}
    if states.ndim == 2:
        counts["initial"] = states.shape[0]
    n = max(counts.values(), default=1)
    if any(count != n for count in counts.values()) or n == 0:
        sizes = ", ".join(f"{name}: {count}" for name, count in counts.items())
        raise InputError(f"lengths differ or are 0 ({sizes}): must be the same number of runs")
    return varied, np.ascontiguousarray(np.broadcast_to(states, (n, width)))
