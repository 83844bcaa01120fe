"""Members of an ensemble that are computed singly: with kinks, hysteresis, memory or surfaces.

The steps of such motions end where laws switch, at different times, or the motions have memory. So
they cannot be computed together in the vector unit. Each member is a run of `simulate`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.analyses.events import Event, Watch
from viscovib.analyses.members import Members, shared_runs
from viscovib.analyses.neighbours import exponents_of
from viscovib.analyses.resume import known
from viscovib.analyses.runs import Run, ThinLayers, Wanted
from viscovib.analyses.structure_motion import goes_condensed
from viscovib.analyses.transient import Acting, kept_by, observed, runs_of
from viscovib.errors import InputError
from viscovib.results.trajectory import OUTCOMES
from viscovib.systems.load import LoadLike
from viscovib.systems.pendulum import Pendulum
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.system import OF_LOADS
from viscovib.systems.varying import varied

#: Largest number of samples of a run in memory.
_HELD = 100_000


@dataclass
class _Gathered:
    """Results of one run."""

    state: FloatArray
    ended: int
    reached: float
    peak: FloatArray
    mean: FloatArray
    rms: FloatArray
    lines: ComplexArray
    exponents: FloatArray
    exponent_errors: FloatArray
    #: States of a section, and their times.
    points: FloatArray
    times: FloatArray


class SingleMembers(Members):
    """Systems of any kind, with single runs."""

    side_by_side = False

    def __init__(
        self,
        system: Any,
        initial: npt.ArrayLike,
        given: Mapping[str, npt.ArrayLike],
        load: LoadLike | None,
        nu: float | None,
        method: str,
        surface: Event | None,
    ) -> None:
        self.system, self.surface, self.method = system, surface, method
        #: Thin layers of each run, for all step sizes.
        self.layers: dict[int, ThinLayers] = {}
        if surface is not None and surface.terminal:
            raise InputError("sections: terminal = True: must be False for a section")
        self.load, self.given_nu = load, nu
        self.varied, self.states = shared_runs(given, initial, 2 * len(system.dof_names))
        for name in self.varied:
            self._check_name(name)
        if system._has_own_loads:
            for name, value in (("load", load), ("nu", nu)):
                if value is not None:
                    raise InputError(f"{name}: a Pendulum has its loads in itself, must be None")
        elif load is None:
            for name in ("nu", "load_scale"):
                if name in given or (name == "nu" and nu is not None):
                    raise InputError(f"{name}: must not be given without load")
        # Check the arguments with a first run.
        first = self._begin(0, 1.0, 1.0)
        self.method_name = first.method
        self.dof_names = kept_by(first)
        self.passed: dict[int, _Gathered] = {}

    def _check_name(self, name: str) -> None:
        """Refuse a parameter that cannot vary."""
        system = self.system
        allowed = (*self._of_loads, *system._scales, *system._parameter_names)
        if name not in allowed:
            # List the names of the first mount of a body only.
            mounts = [one for one in allowed if one.startswith("mounts[")]
            first = mounts[0].split(".")[0] if mounts else ""
            note = [one for one in allowed if one not in mounts or one.startswith(first)]
            raise InputError(
                f"parameters: {name!r} does not vary in an ensemble of this system, must be one of "
                f"{', '.join(note)}"
            )

    def _one(self, i: int) -> Any:
        """The system of run i."""
        system = self.system
        numbers = {
            name: float(values[i])
            for name, values in self.varied.items()
            if name not in self._of_loads
        }
        scales = {name: numbers.pop(name) for name in system._scales if name in numbers}
        if numbers:
            system = system._with_parameters(numbers)
        return _scaled(system, scales)

    @property
    def _of_loads(self) -> tuple[str, ...]:
        return () if self.system._has_own_loads else OF_LOADS

    def _acting(self, i: int) -> Acting:
        """Loads of run i."""
        if self.load is None:
            return Acting()
        load, nu = self.load, self.given_nu
        if "load_scale" in self.varied:
            load = _times(load, float(self.varied["load_scale"][i]))
        if "nu" in self.varied:
            nu = float(self.varied["nu"][i])
        return Acting(load, nu)

    def _begin(self, i: int, end: float, h: float, moved: FloatArray | None = None) -> Run:
        """Run i at its start, which may be changed by ``moved``."""
        state = self.states[i] if moved is None else self.states[i] + moved
        make, _, _ = runs_of(self._one(i), end, state, self.method, self._acting(i), None, False)
        watch = None
        if self.surface is not None and moved is None:
            watch = Watch.checked([self.surface], observed(make(1.0)), "sections")
        if self.gathered_since is not None and moved is None:
            watch = Watch.of_motion(watch, float(self.gathered_since[i]))
        run = known(make, watch=watch)(h)
        run.layers = self.layers.setdefault(i, ThinLayers())
        return run

    def load_frequencies(self, sections: int) -> tuple[str, FloatArray]:
        """Return the name and frequencies of the load."""
        name, own = "nu", self.given_nu
        if isinstance(self.system, Pendulum):
            name = f"p{_native.integer('sections', sections, 1, 3)}"
            own = float(getattr(self.system, name))
        else:
            _native.integer("sections", sections, 1, 1)
        fixed = 0.0 if own is None else _native.number("nu", own)
        return name, np.array(self.varied.get(name, np.full(self.n, fixed)))

    def first_steps(self, spans: FloatArray) -> int:
        """Largest first number of steps of the runs with the extreme parameters."""
        ends = [int(values.argmax()) for values in self.varied.values()]
        ends += [int(values.argmin()) for values in self.varied.values()]
        return max(self._steps(i, float(spans[i])) for i in {0, *ends})

    def _steps(self, i: int, end: float) -> int:
        acting = self._acting(i)
        return runs_of(self._one(i), end, self.states[i], self.method, acting, None, False)[1]

    def call(self, part: slice, *given: Any) -> tuple[Any, ...]:
        """Compute a part of the runs, one after another."""
        h, _, n_steps, n_discard, _, every, section_every, _, exponents, lines, *rest = given
        cancel, sections = rest
        requested = _Requested(n_steps, n_discard, every, section_every, exponents, lines)
        found: list[_Gathered] = []
        for k, i in enumerate(range(part.start, part.stop)):
            if cancel[0]:
                raise InputError("ensemble: interrupted")
            one = self._gather(i, float(h[k]), requested)
            found.append(one)
            if self.surface is not None:
                self.passed[i] = one
            elif section_every:
                sections[:, : one.points.shape[0], k] = one.points.T
        names = (
            "state", "ended", "reached", "peak", "mean", "rms", "lines", "exponents",
            "exponent_errors",
        )  # fmt: skip
        return tuple(np.stack([getattr(one, x) for one in found], axis=-1) for x in names)

    def found_so_far(self, part: slice, results: bool) -> Any:
        """Thin layers of the runs, and their states on the surface."""
        runs = range(part.start, part.stop)
        layers = {i: self.layers[i] for i in runs if i in self.layers}
        return layers, {i: self.passed[i] for i in runs if results and i in self.passed}

    def add_findings(self, found: Any) -> None:
        """Add thin layers, and states on the surface."""
        for of, part in zip((self.layers, self.passed), found, strict=True):
            of |= part

    def _gather(self, i: int, h: float, requested: _Requested) -> _Gathered:
        """Compute run i."""
        run = self._begin(i, h * requested.n_steps, h)
        track = _Track(h, requested)
        done, latest = 0, None
        stride = requested.stride
        while done < requested.n_steps:
            n = requested.n_discard - done
            want = Wanted(keep="last")
            if n <= 0:
                n = requested.n_steps - done
                if stride and n >= stride:
                    n = min(n // stride, max(1, _HELD // stride)) * stride
                    want = Wanted(every=stride)
            latest = run.steps(n, want, False)
            if want.keep == "all":
                track.add(latest.state[1:])
            done += n
            if latest.outcome != "completed":
                break
        assert latest is not None
        stopped = latest.outcome != "completed"
        last = latest if latest.t.size and not stopped else None
        state = latest.state[-1] if last is not None else run.state[: latest.state.shape[1]]
        found = track.result(state.size, stopped)
        along = None if run.watch is None else run.watch.gathered
        if self.gathered_since is not None and along is not None:
            found.peak, total, squares = along[:, : state.size]
            length = h * requested.n_steps - self.gathered_since[i]
            found.mean, found.rms = total / length, np.sqrt(squares / length)
        found.state, found.ended = np.array(state), OUTCOMES.index(latest.outcome)
        found.reached = latest.t_reached
        if self.surface is not None:
            times, states = latest.events[0]
            late = times >= self.discarded[i]
            found.points, found.times = states[late], times[late]
        if requested.exponents:
            found.exponents, found.exponent_errors = self._exponents(i, h, requested)
        return found

    def _exponents(self, i: int, h: float, requested: _Requested) -> tuple[FloatArray, FloatArray]:
        end = h * requested.n_steps
        quarter = max(1, round(requested.n_steps / self._steps(i, end)))
        return exponents_of(
            lambda moved, *, finer: self._begin(i, end, h / finer, moved),
            (self.states.shape[1], 2 * len(self.dof_names)),
            requested.n_steps, requested.n_discard, requested.exponents, quarter,
        )  # fmt: skip

    def passages(self) -> tuple[FloatArray, FloatArray]:
        """States and times on the surface, shape (n, most, 2 n_dof) and (n, most), NaN beyond."""
        ones = [self.passed[i] for i in range(self.n)]
        most = max(one.times.size for one in ones)
        points = np.full((self.n, most, 2 * len(self.dof_names)), np.nan)
        times = np.full((self.n, most), np.nan)
        for i, one in enumerate(ones):
            if one.times.size:
                points[i, : one.times.size] = one.points
                times[i, : one.times.size] = one.times
        return points, times


@dataclass(frozen=True)
class _Requested:
    """Requested results, in steps."""

    n_steps: int
    n_discard: int
    every: int
    section_every: int
    exponents: int
    lines: FloatArray

    @property
    def samples(self) -> bool:
        """True if states are sampled during the run."""
        return self.lines.size > 0

    @property
    def stride(self) -> int:
        """Steps between the states that are needed; 0: only the last state."""
        needed = [self.every] if self.samples else []
        return math.gcd(*needed, *([self.section_every] if self.section_every else []))


class _Track:
    """Accumulated results of a run."""

    def __init__(self, h: float, requested: _Requested) -> None:
        self.h, self.requested = h, requested
        self.steps = 0
        self.n = 0
        self.parts: list[FloatArray] = []
        self.sums: Any = 0.0
        self.weight: Any = 0.0
        self.mean: Any = 0.0
        self.empty: Any = 0.0

    def add(self, states: FloatArray) -> None:
        """Add states at the distance of a stride."""
        requested = self.requested
        at = self.steps + requested.stride * np.arange(1, states.shape[0] + 1)
        self.steps += requested.stride * states.shape[0]
        if requested.section_every:
            self.parts.append(states[at % requested.section_every == 0])
        if not requested.samples:
            return
        some = states[at % requested.every == 0]
        if not some.size:
            return
        place = self.n + np.arange(some.shape[0])
        n_samples = (requested.n_steps - requested.n_discard) // requested.every
        # A Hann window that is 0 one sample before the first and one after the last.
        window = np.sin(math.pi * (place + 1) / (n_samples + 1)) ** 2
        times = self.h * (requested.n_discard + requested.every * (place + 1))
        waves = window[:, np.newaxis] * np.exp(-1j * np.outer(times, requested.lines))
        self.sums = self.sums + some[:, ::2].T @ waves
        self.empty = self.empty + waves.sum(axis=0)
        self.mean = self.mean + window @ some[:, ::2]
        self.weight = self.weight + window.sum()
        self.n += some.shape[0]

    def result(self, width: int, stopped: bool) -> _Gathered:
        """The results; amplitudes of a motion that ended early are NaN."""
        missing, unset = np.full(width, math.nan), np.full(self.requested.exponents, math.nan)
        lines = np.full((width // 2, self.requested.lines.size), math.nan, dtype=complex)
        if self.n and lines.size and not stopped:
            own = self.mean / self.weight
            lines = 2 * (self.sums - np.outer(own, self.empty)) / self.weight
        points = np.concatenate(self.parts) if self.parts else np.empty((0, width))
        return _Gathered(
            missing, 0, 0.0, missing, missing, missing, lines, unset, unset, points, np.empty(0),
        )  # fmt: skip


def _times(load: Any, factor: float) -> Any:
    """A load multiplied by a factor."""
    if isinstance(load, Mapping):
        return {key: _times(value, factor) for key, value in load.items()}
    return np.asarray(load) * factor


def _scaled(system: PolynomialSystem, numbers: Mapping[str, float]) -> PolynomialSystem:
    """The system with scaled parts: K of all springs, C, polynomial forces, or memory."""
    if not numbers:
        return system
    if goes_condensed(system):
        raise InputError(
            f"parameters: {', '.join(numbers)} do not vary of a system that is condensed "
            f"({len(system.dof_names)} coordinates)"
        )
    flat = system._flat.copy()
    for name, value in numbers.items():
        found = varied(system, name, value, value)
        at = found.direction != 0
        flat[at] = found.at(value)[at]
    other = copy(system)
    other.__dict__["_vector"] = flat
    other.__dict__.pop("_handle", None)
    return other
