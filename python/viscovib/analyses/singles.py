"""Members of an ensemble that are computed singly: with kinks, hysteresis, memory or surfaces.

The steps of such motions end where laws switch, at different times, or the motions have memory. So
they cannot be computed together in the vector unit. Each member is a run of `simulate`.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.events import Event, Watch
from viscovib.analyses.members import Members, Sections, shared_runs, side_by_side
from viscovib.analyses.oscillator_motion import MOST_WHOLE
from viscovib.analyses.resume import known
from viscovib.analyses.runs import Run, ThinLayers
from viscovib.analyses.transient import Acting, kept_by, observed, runs_of
from viscovib.errors import InputError
from viscovib.systems.load import LoadLike
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.system import OF_LOADS
from viscovib.systems.varying import varied


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
        #: States of each run on the surface, and their times.
        self.passed: dict[int, tuple[FloatArray, FloatArray]] = {}

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

    def _begin(self, i: int, end: float, h: float) -> Run:
        """Run i at its start."""
        make, _, _ = runs_of(
            self._one(i), end, self.states[i], self.method, self._acting(i), None, False
        )
        watch = None
        if self.surface is not None:
            watch = Watch.checked([self.surface], observed(make(1.0)), "sections")
        if self.gathered_since is not None:
            watch = Watch.of_motion(watch, float(self.gathered_since[i]))
        run = known(make, watch=watch)(h)
        run.layers = self.layers.setdefault(i, ThinLayers())
        return run

    def load_frequencies(self, sections: int) -> tuple[str, FloatArray]:
        """Return the name and frequencies of the load."""
        name, own = "nu", self.given_nu
        if self.system._has_own_loads:
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
        h, _, n_steps, _, _, _, _, _, exponents, *_ = given
        runs = range(part.start, part.stop)
        starts = [self._begin(i, n_steps * one, one) for i, one in zip(runs, h, strict=True)]
        since = np.zeros(len(runs)) if self.gathered_since is None else self.gathered_since[part]
        *found, others = side_by_side(
            "ensemble of members", given, *(run.as_object() for run in starts),
            initial=np.zeros((2 * len(self.dof_names), len(runs))), since=since,
            late=self.discarded[part],
            first_steps=np.array([
                min(self._steps(i, n_steps * one), n_steps) if exponents else 1
                for i, one in zip(runs, h, strict=True)
            ], dtype=np.int32),
        )  # fmt: skip
        ends = np.cumsum(others["passed"])
        for k, i in enumerate(runs):
            self.layers[i].seen |= bool(others["in_parts"][k])
            if self.surface is not None:
                own = slice(ends[k] - others["passed"][k], ends[k])
                self.passed[i] = others["points"][:, own].T, others["times"][own]
        return tuple(found)

    def found_so_far(self, part: slice, results: bool) -> Any:
        """Thin layers of the runs, and their states on the surface."""
        runs = range(part.start, part.stop)
        layers = {i: self.layers[i] for i in runs if i in self.layers}
        return layers, {i: self.passed[i] for i in runs if results and i in self.passed}

    def add_findings(self, found: Any) -> None:
        """Add thin layers, and states on the surface."""
        for of, part in zip((self.layers, self.passed), found, strict=True):
            of |= part

    def passages(self, sections: FloatArray | None) -> Sections:
        """States and times on the surface, shape (n, most, 2 n_dof) and (n, most), NaN beyond."""
        if self.surface is None:
            return super().passages(sections)
        ones = [self.passed[i] for i in range(self.n)]
        most = max(at.size for _, at in ones)
        points = np.full((self.n, most, 2 * len(self.dof_names)), np.nan)
        times = np.full((self.n, most), np.nan)
        for i, (states, at) in enumerate(ones):
            points[i, : at.size], times[i, : at.size] = states, at
        return points, times


def _times(load: Any, factor: float) -> Any:
    """A load multiplied by a factor."""
    if isinstance(load, Mapping):
        return {key: _times(value, factor) for key, value in load.items()}
    return np.asarray(load) * factor


def _scaled(system: PolynomialSystem, numbers: Mapping[str, float]) -> PolynomialSystem:
    """The system with scaled parts: K of all springs, C, polynomial forces, or memory."""
    if not numbers:
        return system
    if len(system.dof_names) > MOST_WHOLE:
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
