"""Results of a sweep: numbers, errors and warnings, and its row of the table."""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar

import viscovib as vv

Value = TypeVar("Value")
#: Outcomes from best to worst.
OK, WARNING, CLEAR_ERROR, WRONG = "ok", "warning", "clear error", "WRONG"


@dataclass(frozen=True)
class Row:
    """A row of the table."""

    topic: str
    what: str
    range: str
    outcome: str
    worst: float
    limit: float
    measure: str
    note: str


@dataclass
class Tally:
    """The trials of one sweep.

    A trial may end with a number, which ``measure`` checks, with vv.InputError (a clear error), or
    with a warning of the package as well. Every other exception is wrong, and so is a number beyond
    its limit, including NaN.
    """

    topic: str
    what: str
    range: str
    limit: float
    #: Label of the worst number.
    measured: str
    worst: float = 0.0
    at: str = ""
    kinds: dict[str, int] = field(default_factory=dict)
    first: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def trial(self, label: str, job: Callable[[], Value]) -> Value | None:
        """Return the result of a job, None if it refuses."""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                value = job()
            except vv.InputError as error:
                return self._count(CLEAR_ERROR, f"{label}: {error}")
            except Exception as error:  # any other exception is a finding
                return self._count(WRONG, f"{label}: {type(error).__name__}: {error}")
        ours = [w for w in caught if w.category.__module__.startswith("viscovib")]
        foreign = [w for w in caught if w not in ours]
        if foreign:
            self._count(WRONG, f"{label}: {foreign[0].category.__name__}: {foreign[0].message}")
        elif ours:
            self._count(WARNING, f"{label}: {ours[0].message}")
        else:
            self._count(OK, label)
        return value

    def measure(self, label: str, number: float, limit: float | None = None) -> None:
        """Check a number; the worst number is the largest relative to the limit of the row."""
        number = float(number)
        bound = self.limit if limit is None else limit
        if not number <= bound:
            self._count(WRONG, f"{label}: {number:.3g}, limit {bound:.3g}")
        scaled = number * self.limit / bound
        if math.isnan(number) or scaled > self.worst or not self.at:
            self.worst, self.at = scaled, label

    def check(self, label: str, good: bool, otherwise: str) -> None:
        """Count a failed check as wrong."""
        if not good:
            self._count(WRONG, f"{label}: {otherwise}")

    def row(self) -> Row:
        """Return the row of the table."""
        seen = [kind for kind in (WRONG, OK, WARNING, CLEAR_ERROR) if self.kinds.get(kind)]
        notes = list(self.notes)
        if self.at:
            notes.append(f"worst at {self.at}")
        for kind in (WARNING, CLEAR_ERROR, WRONG):
            if count := self.kinds.get(kind):
                notes.append(f"{count} x {kind}, first {_short(self.first[kind])}")
        return Row(
            topic=self.topic,
            what=self.what,
            range=self.range,
            outcome=WRONG if WRONG in seen else ", ".join(seen),
            worst=self.worst if self.at else math.nan,
            limit=self.limit,
            measure=self.measured,
            note="; ".join(notes),
        )

    def _count(self, kind: str, text: str) -> Any:
        self.kinds[kind] = self.kinds.get(kind, 0) + 1
        self.first.setdefault(kind, text)


def _short(text: str, width: int = 150) -> str:
    return text if len(text) <= width else text[: width - 3] + "..."
