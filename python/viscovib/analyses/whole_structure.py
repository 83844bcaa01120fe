"""Motions of structures of few coordinates by their full equations: steps end where laws switch.

Each term of a kernel that is a sum of exponentials is a hidden coordinate of the core. All other
kernels are replaced by such sums, fitted for the steps of a run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.acting import loads_at
from viscovib.analyses.oscillator_motion import OscillatorMotion, OscillatorRun
from viscovib.analyses.runs import Run
from viscovib.analyses.structure_motion import with_deflections
from viscovib.common.past import Past
from viscovib.errors import InputError
from viscovib.results.trajectory import Trajectory
from viscovib.systems.load import LoadLike
from viscovib.systems.load_table import LoadTable
from viscovib.systems.structure import ALL_GIVEN, Structure
from viscovib.systems.supports import with_base_loads
from viscovib.systems.whole import (
    MOST_WITH_MEMORY,
    lacks_wholeness,
    n_hidden,
    once_each,
    whole_system,
)

#: Indices of the coordinates kept; None: all.
_Places = npt.NDArray[np.intp] | None


def check_whole(system: Any) -> None:
    """Refuse a structure that does not go by its whole equations, in a motion that repeats."""
    if not system._is_condensed:
        return
    note = lacks_wholeness(system) or _lacks_exponentials(system)
    if note is None and any(one.law is not None and one.law.state and one.law.text != "restitution"
                            for one in system._all_elements):  # fmt: skip
        note = "does not support hysteresis elements (use forced_response)"
    if note is not None:
        raise InputError(f"system: a steady motion in time {note}")


@once_each
def _lacks_exponentials(structure: Structure) -> str | None:
    """Return the reason why memory cannot be represented by exponentials; None: no reason."""
    if not structure._all_kernels:
        return None
    n, (hidden, fitted) = len(structure.dof_names), n_hidden(whole_system(structure))
    if hidden < 0:
        kinds = sorted({type(kernel).__name__ for kernel in structure._all_kernels})
        return (
            "needs kernels that can be replaced by sums of exponentials, has "
            f"{', '.join(kinds)}: use kernel.sum_of_exponentials(), or the steady motions of "
            "forced_response and trace_response"
        )
    if n + hidden > MOST_WITH_MEMORY:
        return (
            f"is for at most {MOST_WITH_MEMORY} coordinates and exponentials of forces that "
            f"remember, has {n} and {'up to ' if fitted else ''}{hidden}"
        )
    return None


def whole_runs(
    structure: Structure,
    end: float,
    initial: npt.ArrayLike | None,
    method: str,
    load: LoadLike | None,
    nu: float | None,
    force: LoadTable | None,
    solved: float,
    coordinates: Sequence[str] | None = None,
    *,
    base: LoadLike | LoadTable | None = None,
    held: npt.ArrayLike | Past | None = None,
    memory: str = "auto",
    before: OscillatorMotion | None = None,
) -> tuple[Callable[[float], Run], int] | None:
    """Return a function that creates a run with a step size, and the first number of steps.

    None: steps cannot end where laws switch, or no law does. ``coordinates``: names of those kept;
    None: all if few, else those with loads or elements. ``before``: earlier motion under other
    loads.
    """
    if not structure._has_kinks:
        return None
    note = lacks_wholeness(structure)
    if note is None:
        frequency = 0.0 if nu is None else _native.number("nu", nu)
        own, table = with_base_loads(structure, end, load, frequency, base, force)
        motion = OscillatorMotion.checked(
            whole_system(structure), end, initial, method, own, nu, base, table, held, memory
        ).with_equations()
        note = motion.chosen.get("lack")
        if not note:
            motion = motion if before is None else motion.after(before)
            check_outside(structure, motion.state)
            places = _places_of(structure, coordinates, load, base)
            return partial(WholeRun, structure, places, motion, solved), motion.chosen["first"]
    if any(element.law is not None and element.law.state for element in structure._all_elements):
        raise InputError(f"elements: a motion in time with hysteresis or restitution {note}")
    return None


def _places_of(
    structure: Structure, coordinates: Sequence[str] | None, load: LoadLike | None, base: Any
) -> _Places:
    """Indices of the coordinates kept."""
    if coordinates is not None:
        return structure._chosen(coordinates)
    if structure.n_coordinates <= ALL_GIVEN:
        return None
    waved = None if isinstance(base, LoadTable) else base
    return np.asarray(structure._wanted(None, structure._loaded(load, waved)))


def check_outside(structure: Structure, state: FloatArray) -> None:
    """Refuse a start beyond a rigid stop."""
    for i, element in enumerate(structure._all_elements):
        if element.law is None or element.law.text != "restitution":
            continue
        gap, _, both = element.law.number[1:]
        d = float(element.direction @ state[::2])
        if d > gap or (both and d < -gap):
            raise InputError(
                f"initial: element {i} has the deflection {d:g}, beyond its stop at {gap:g}"
            )


class WholeRun(OscillatorRun):
    """A run of a structure by its full equations."""

    power: ClassVar[Any] = None

    def __init__(
        self, structure: Structure, places: _Places, motion: OscillatorMotion, solved: float,
        h: float,
    ) -> None:  # fmt: skip
        super().__init__(motion, solved, h)
        self.places = places
        self.system = structure  # type: ignore[assignment]

    def _base_motion(self, t: FloatArray) -> tuple[FloatArray, ...]:
        return tuple(self.motion.base_motion(t))

    def accelerations(self, kept: Trajectory) -> FloatArray:
        """Of the coordinates that are kept."""
        found = super().accelerations(kept)
        return found if self.places is None else found[:, self.places]

    @property
    def _compared(self) -> npt.NDArray[np.intp]:
        """Indices of the coordinates that are kept."""
        structure: Any = self.system
        places = np.arange(len(structure.dof_names)) if self.places is None else self.places
        return np.asarray((2 * places[:, np.newaxis] + [0, 1]).ravel())

    def _run_values(self) -> dict[str, Any]:
        """Values as for other systems; a start on a rigid stop must stay on it."""
        return {"holds_places": self._n_stops > 0, "rows": self._compared + 1}

    @property
    def _n_stops(self) -> int:
        """Number of rigid stops."""
        structure: Any = self.system
        stops = [one.law for one in structure._all_elements if one.law is not None]
        return sum(law.text == "restitution" for law in stops)

    def _shaped(self, run: Trajectory) -> Trajectory:
        """The result with the selected coordinates and the deflections."""
        structure: Any = self.system
        directions = structure._element_directions
        places = np.arange(len(structure.dof_names)) if self.places is None else self.places
        relative = run.state
        if self.motion.moves_base:
            # At a corner of its table the base has the velocity before it.
            at = run.t if self.motion.table is None else np.nextafter(run.t, -np.inf)
            moved = loads_at(self.motion.acting, at)
            relative = run.state.copy()
            relative[:, ::2] -= moved["place"]
            relative[:, 1::2] -= moved["speed"]
        count = self._n_stops
        assert self.memory is not None
        # Times since which the motion rests against each side of each stop.
        begin = int(self.memory[-1])
        since = self.memory[begin : begin + 2 * count].reshape(count, 2)
        return with_deflections(
            run, structure, places, self._compared, relative[:, ::2] @ directions,
            relative[:, 1::2] @ directions, resting_since=np.where(since < 0, np.nan, since),
        )  # fmt: skip
