"""Plan of a job: what it computes, what it skips, and why."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from viscovib.common.parameters import Names, Text
from viscovib.errors import InputError

_SKIP = re.compile(r"skips: (.*?) \((.*)\)")


class Plan(Mapping[str, Any]):
    """Plan of a job: what it computes, what it skips, and why.

    As text it has lines ``computes: ...`` and ``skips: ... (why)``. As a mapping it has
    ``plan["computes"]``, a tuple of texts, and ``plan["skips"]``, a mapping from each skipped part
    to the reason.

    Parameters
    ----------
    text : str
        The lines.

    Examples
    --------
    >>> import viscovib as vv
    >>> mount = vv.Mount(
    ...     mass=1,
    ...     inertia=0.1,
    ...     offset=0.5,
    ...     stiffness_x=10,
    ...     stiffness_phi=2,
    ...     damping=[[0.2, -0.1], [-0.1, 0.09]],
    ... )
    >>> plan = vv.forced_response(mount, [1.0, 2.0], load=0.1).plan
    >>> reasons = plan["skips"]  # what is skipped, and why
    """

    def __init__(self, text: str) -> None:
        Text("text").check(text)
        self._lines = tuple(line.strip() for line in text.strip().splitlines())

    def and_also(self, lines: Sequence[str]) -> Plan:
        """Return the plan with more lines."""
        return Plan("\n".join([*self._lines, *Names("lines").check(lines)]))

    def instead(self, beginning: str, line: str) -> Plan:
        """Return the plan with ``line`` instead of the line that skips ``beginning``..."""
        Text("beginning").check(beginning)
        Text("line").check(line)
        return Plan(
            "\n".join(line if s.startswith(f"skips: {beginning}") else s for s in self._lines)
        )

    @property
    def computes(self) -> tuple[str, ...]:
        """Computed parts."""
        return tuple(
            line.removeprefix("computes: ") for line in self._lines if line.startswith("computes: ")
        )

    @property
    def skips(self) -> Mapping[str, str]:
        """Skipped parts with the reasons."""
        found = (_SKIP.fullmatch(line) for line in self._lines)
        return MappingProxyType({match[1]: match[2] for match in found if match})

    def __getitem__(self, key: str) -> Any:
        """Return one of the two parts."""
        if isinstance(key, str) and key == "computes":
            return self.computes
        if isinstance(key, str) and key == "skips":
            return self.skips
        raise KeyError(key)

    def __iter__(self) -> Iterator[str]:
        """Names of the parts."""
        return iter(("computes", "skips"))

    def __len__(self) -> int:
        """Count the parts."""
        return 2

    def __str__(self) -> str:
        """All lines."""
        return "\n".join(self._lines)

    def __repr__(self) -> str:
        """Return the numbers of computed and skipped parts."""
        return f"<Plan: computes {len(self.computes)}, skips {len(self.skips)}>"

    def comments(self) -> str:
        """Return the lines as comments on top of a table."""
        return "".join(f"# {line}\n" for line in self._lines)


def given_plan(plan: Plan) -> Plan:
    """Return the plan; a function that can be pickled."""
    return plan


def wanted_places(coordinates: Sequence[str] | None, names: tuple[str, ...]) -> list[int]:
    """Return the indices of the requested coordinates in their order; None: all."""
    if coordinates is None:
        return list(range(len(names)))
    chosen = Names("coordinates", names).check(coordinates)
    if not chosen:
        raise InputError("coordinates: must not be empty")
    return [d for d, name in enumerate(names) if name in chosen]
