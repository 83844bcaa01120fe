"""Events of motions in time: sign changes of functions of the state."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.errors import InputError
from viscovib.results.trajectory import LocatedEvents
from viscovib.systems.laws import Law, compile_law

#: Largest number of events of a run.
_MOST = 5_000_000
#: Columns for peaks and means along the motion.
_GATHERED = 3
#: Exponent of the size of a signal that never had a value (`watch_type` of the core).
_NO_VALUE = -1022
#: The text of impacts; relative distance within which a deflection is at its stop.
_IMPACT, _AT_STOP = re.compile(r"\s*impact\s*(?:\[\s*(\d+)\s*\])?\s*"), 1e-9
_DIRECTIONS = {"any": 0, "up": 1, "down": -1}
_MOST_EVENTS = 100


@dataclass(frozen=True)
class Event:
    """A sign change of a function of the state during a motion in time.

    Parameters
    ----------
    function : str
        Text of coordinates, their velocities (``x_dot``) and the time ``t``, with the functions of
        force laws: ``"x - 0.1"``, ``"x_dot"``, ``"x1 - x2"``, ``"sin(1.3*t)"``. For a structure
        also ``"impact[i]"``: impacts at the rigid stop ``elements[i]``, a `Gap` or a `Stop` with a
        restitution, with the state right after the impact; ``"impact"`` for a single stop.
    direction : {"any", "up", "down"}
        Sign changes that count: "up" from negative to positive.
    terminal : bool
        True: the first event ends the run (outcome "event").

    Examples
    --------
    >>> import viscovib as vv
    >>> ball = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1)
    >>> top = vv.Event("x_dot", direction="down")
    >>> run = vv.simulate(ball, 20, initial=[0, 1], events=[top, "x - 0.3"])
    >>> run.events[0].t.size
    3
    """

    function: str
    direction: str = "any"
    terminal: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.function, str):
            raise InputError(
                f"function = {_native.shown(self.function)}: must be a text, such as 'x - 0.1'"
            )
        _native.choice("direction", self.direction, tuple(_DIRECTIONS))
        _native.flag("terminal", self.terminal)


class Impact(NamedTuple):
    """Condition under which a zero of the rate of a deflection is an impact."""

    direction: FloatArray
    gap: float
    both: bool

    def keeps(self, states: FloatArray) -> npt.NDArray[np.bool_]:
        """Mask of the states, shape (n, 2 m), at the stop."""
        d = states[:, : 2 * self.direction.size : 2] @ self.direction
        place = np.abs(d) if self.both else d
        return np.asarray(
            np.abs(place - self.gap) <= _AT_STOP * max(1e-300, abs(self.gap), *abs(d))
        )


def impact_of(called: str, event: Event, system: Any, names: Sequence[str]) -> tuple[Event, Impact]:
    """Return the event of the core for ``"impact[i]"``, and the condition of an impact."""
    from viscovib.systems.contacts import Contact, Stop
    from viscovib.systems.elements import direction_of

    elements = list(getattr(system, "elements", ()))
    rigid = [
        i for i, one in enumerate(elements)
        if isinstance(one, Contact) and one.restitution is not None
    ]  # fmt: skip
    found = _IMPACT.fullmatch(event.function)
    place = int(found[1]) if found and found[1] else (rigid[0] if len(rigid) == 1 else -1)
    if place not in rigid:
        listed = ", ".join(f"impact[{i}]" for i in rigid) or "a function of the state: no element"
        raise InputError(
            f"{called} = {event.function!r}: must be {listed}{'' if rigid else ' is a rigid stop'}"
        )
    if event.terminal:
        raise InputError(f"{called} = {event.function!r}: must not be terminal")
    stop = elements[place]
    e = direction_of("on", stop.on, len(system.dof_names), system._places)
    seen = {name: e[i] for name, i in system._places.items() if e[i]}
    if lacking := sorted(set(seen) - set(names)):
        raise InputError(f"coordinates: must include {', '.join(lacking)} for {event.function!r}")
    text = "+".join(f"({float(w)!r})*{name}_dot" for name, w in seen.items())
    both = isinstance(stop, Stop)
    direction = np.array([seen.get(name, 0.0) for name in names])
    way = "any" if both else "down"
    return replace(event, function=text, direction=way), Impact(direction, stop.gap, both)


def n_states(rows: int) -> int:
    """Number of rows with the state of an event; the others are index, time and derivatives."""
    return 2 * ((rows - 4) // 3)


class Watch:
    """Events in the form of the core, and the events found so far."""

    def __init__(
        self,
        laws: Sequence[Law],
        events: Sequence[Event],
        impacts: Sequence[Impact | None] = (),
    ) -> None:
        self.events = events
        #: Condition of each event; None: no condition.
        self.impacts = impacts
        numbers: list[float] = [len(laws)]
        for law, event in zip(laws, events, strict=True):
            numbers += [_DIRECTIONS[event.direction], int(event.terminal), len(law.code)]
            numbers += [x for pair in zip(law.code, law.number, strict=True) for x in pair]
        self.vector = np.array(numbers, dtype=float)
        # For each event: its sign, the exponent of its largest value so far, and the number of
        # steps in which events may be missing.
        self.sides = np.zeros(3 * len(events), dtype=np.intc)
        self.found: list[FloatArray] = []
        #: True if peaks and means are computed.
        self.gathers = False
        #: Largest sizes, and integrals of values and of squares; None: nothing observed yet.
        self.gathered: FloatArray | None = None

    @classmethod
    def checked(
        cls, events: object, names: Sequence[str], note: str = "", system: Any = None
    ) -> Watch:
        """Compile events of a motion with these coordinates; ``note`` is the name in messages."""
        if isinstance(events, (str, Event)):
            events = [events]
        if not isinstance(events, (list, tuple)) or not 0 < len(events) <= _MOST_EVENTS:
            raise InputError(
                f"events = {_native.shown(events)}: must be 1 to {_MOST_EVENTS} texts or Event"
            )
        called = [note or f"events[{i}]" for i in range(len(events))]
        own = []
        for i, event in enumerate(events):
            if isinstance(event, str):
                event = Event(event)
            if not isinstance(event, Event):
                raise InputError(
                    f"{called[i]} = {_native.shown(event)}: must be a text or an Event"
                )
            own.append(event)
        impacts: list[Impact | None] = [None] * len(own)
        given = list(own)
        for i, event in enumerate(own):
            if _IMPACT.fullmatch(event.function) and "impact" not in names:
                given[i], impacts[i] = impact_of(called[i], event, system, names)
        arguments = [f"{name}{dot}" for name in names for dot in ("", "_dot")] + ["t"]
        laws = [
            compile_law(called[i], event.function, arguments, {}) for i, event in enumerate(given)
        ]
        for i, law in enumerate(laws):
            if not law.places:
                raise InputError(
                    f"{called[i]} = {own[i].function!r}: depends on no quantity, must name "
                    f"{', '.join(arguments[:6])}{', ...' if len(arguments) > 6 else ''}"
                )
        watch = cls(laws, given, impacts)
        watch.events = own
        return watch

    def fresh(self) -> Watch:
        """Return the events for a new run."""
        other = object.__new__(Watch)
        other.events, other.vector, other.impacts = self.events, self.vector, self.impacts
        other.sides = np.zeros_like(self.sides)
        other.found = []
        other.gathers, other.gathered = self.gathers, None
        return other

    @classmethod
    def of_motion(cls, other: Watch | None, since: float) -> Watch:
        """Return the events, if any, with peaks and means of the motion from a time on."""
        watch = cls([], []) if other is None else other.fresh()
        watch.vector = np.append(watch.vector, since)
        watch.gathers = True
        return watch

    def going_on(self) -> Watch:
        """Return the events for a continued run, with new results only."""
        other = self.fresh()
        other.sides = self.sides.copy()
        other.sides[2 * len(self.events) :] = 0
        return other

    @property
    def undefined(self) -> list[int]:
        """Indices of events that had no value at any state of the run."""
        _, sizes, _ = self.sides.reshape(3, -1)
        return np.flatnonzero(sizes <= _NO_VALUE).tolist()

    @property
    def lost(self) -> list[int]:
        """Number of steps in which events may be missing, for each event."""
        return [int(steps) for steps in self.sides.reshape(3, -1)[2]]

    def take(self, found: FloatArray, count: int) -> npt.NDArray[np.bool_]:
        """Store the events of a native call; return the mask of valid events."""
        if sum(map(len, self.found)) + count > _MOST:
            raise InputError(f"events: more than {_MOST}: use a shorter run, or fewer events")
        rows = np.array(found[:, :count].T)
        counts = np.ones(count, dtype=bool)
        for i, impact in enumerate(self.impacts):
            if impact is not None and count:
                states = rows[:, 2 : 2 + n_states(found.shape[0])]
                counts &= (rows[:, 0] != i + 1) | impact.keeps(states)
        if counts.any():
            self.found.append(rows[counts])
        return counts

    def take_gathered(self, found: FloatArray, count: int) -> None:
        """Add the peaks and integrals of a native call that found ``count`` events."""
        states = found[2 : 2 + n_states(found.shape[0])]
        peak, *integrals = states[:, count : count + _GATHERED].T
        if self.gathered is None:
            self.gathered = np.zeros((_GATHERED, peak.size))
        self.gathered[0] = np.maximum(self.gathered[0], peak)
        self.gathered[1:] += integrals

    def located(self, columns: slice) -> tuple[LocatedEvents, ...]:
        """Events found, for each event function."""
        if not self.found:
            none = np.empty((0, columns.stop))
            return tuple(LocatedEvents(np.empty(0), none) for _ in self.events)
        whole = self.rows
        states = whole[2:][columns]
        return tuple(
            LocatedEvents(whole[1, at], states[:, at].T.copy())
            for at in (whole[0] == i + 1 for i in range(len(self.events)))
        )

    @property
    def rows(self) -> FloatArray:
        """Events found, one per column, for `passage_errors` of the core."""
        if not self.found:
            return np.empty((4, 0), order="F")
        return np.asfortranarray(np.concatenate(self.found).T)
