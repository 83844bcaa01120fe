"""Motions of structures of few coordinates by their full equations: steps end where laws switch.

Each term of a kernel that is a sum of exponentials is a hidden coordinate of the core. All other
kernels are replaced by such sums, fitted for the steps of a run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.acting import KnownMotion, loads_at
from viscovib.analyses.oscillator_motion import (
    BY_MODES,
    MOST_WHOLE,
    WITH_MEMORY,
    OscillatorMotion,
    OscillatorRun,
)
from viscovib.analyses.structure_motion import with_deflections
from viscovib.common.past import Past
from viscovib.errors import InputError
from viscovib.results.trajectory import Trajectory
from viscovib.systems.load import LoadLike
from viscovib.systems.load_table import LoadTable, PiecewiseTable
from viscovib.systems.structure import ALL_GIVEN, Structure
from viscovib.systems.structure_loads import table_columns, warn_of_creeping
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


@dataclass(eq=False)
class WholeMotion(OscillatorMotion):
    """A requested motion of a structure by its full equations."""

    structure: Any = None
    #: Indices of the coordinates kept; None: all.
    places: _Places = None


def whole_motion(
    structure: Structure,
    end: float,
    initial: npt.ArrayLike | None,
    method: str,
    load: LoadLike | None,
    nu: float | None,
    force: LoadTable | None,
    coordinates: Sequence[str] | None = None,
    *,
    base: LoadLike | LoadTable | None = None,
    held: npt.ArrayLike | Past | None = None,
    memory: str = "auto",
    before: OscillatorMotion | None = None,
    may_have_modes: bool = True,
    auto: bool = True,
) -> WholeMotion | None:
    """Return a motion by the full equations; None: modes are faster, or these do not exist.

    ``coordinates``: names of those kept; None: all if few, else those with loads or elements.
    ``before``: earlier motion by full equations under other loads; ``may_have_modes``: False if
    these are wanted anyway; ``auto``: False if the step size is given, for which modes are exact.
    """
    switches = structure._has_kinks
    if not switches and not (auto and structure.n_coordinates <= MOST_WHOLE):
        return None
    if may_have_modes and _is_linear(structure):
        return None
    note = lacks_wholeness(structure)
    if note is None:
        frequency = 0.0 if nu is None else _native.number("nu", nu)
        if getattr(force, "on", None) is not None:
            on, times, pieces = table_columns(force, structure)
            force = PiecewiseTable.of(times, np.einsum("nc,cpt->npt", on, pieces))
        own, table = with_base_loads(structure, end, load, frequency, base, force)
        motion = WholeMotion.checked(
            whole_system(structure), end, initial, method, own, nu, base, table, held, memory
        )
        kind = WITH_MEMORY if before is not None and before.remembers_all else 0
        motion.with_equations(kind, may_have_modes=may_have_modes and not (switches or before))
        note = motion.chosen.get("lack") if switches else None
        if motion.chosen["equations"] == BY_MODES:
            return None
        if not note:
            check_outside(structure, motion.state)
            warn_of_creeping(structure)
            motion = motion if before is None else motion.after(before)
            places = _places_of(structure, coordinates, load, base)
            return replace(motion, structure=structure, places=places)
    if any(element.law is not None and element.law.state for element in structure._all_elements):
        raise InputError(f"elements: a motion in time with hysteresis or restitution {note}")
    return None


def _is_linear(structure: Structure) -> bool:
    """True if all forces are linear, so that modes are exact."""
    elements = structure._all_elements
    bent = any(one.law is not None or max(one.powers, default=0) > 1 for one in elements)
    return not (bent or structure._couplings)


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

    def __init__(self, motion: WholeMotion, solved: float, h: float) -> None:
        super().__init__(motion, solved, h)
        self.places = motion.places
        self.system = motion.structure

    def _base_motion(self, t: FloatArray) -> tuple[FloatArray, ...]:
        return tuple(self.motion.base_motion(t))

    def along(self, kept: Trajectory) -> KnownMotion:
        """As of other runs, of all coordinates."""
        if self.places is None:
            return super().along(kept)
        return self._along(kept, self.repeat(kept.t, kept, accelerates=not self.by_nodes))

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
        values = super()._run_values()
        return values | {"holds_places": self._n_stops > 0, "rows": self._compared + 1}

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
        # Times since which the motion rests against each side of each stop.
        since = self.switched[: 2 * count].reshape(count, 2) if count else np.empty((0, 2))
        return with_deflections(
            run, structure, places, self._compared, relative[:, ::2] @ directions,
            relative[:, 1::2] @ directions, resting_since=np.where(since < 0, np.nan, since),
        )  # fmt: skip


WholeMotion.run_type = WholeRun
