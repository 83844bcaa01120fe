"""Numbers of a scene that can have a slider: their keys, units and ranges."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from viscovib.bodies.checks import NAMES as BODY
from viscovib.errors import InputError
from viscovib.scene.scene import Scene, texts
from viscovib.scene.units import unit_of

#: Groups whose numbers define the system and its loads.
_PHYSICS = (
    "mount", "body", "mount_point", "system", "spring", "element", "force", "kernel", "pendulum",
    "load", "parameters",
)  # fmt: skip
#: Keys of the other groups: ranges and durations of the computation.
_RANGES = (
    "nu", "nu_from", "nu_to", "nu_count", "from", "to", "count", "t_end", "dt",
    "initial", "mode", "discard",
)  # fmt: skip
#: Keys of the first groups whose integers are indices, not quantities.
_NAMES = ("kernel", "kernels", "order", "powers")
_MATRICES = ("mass", "stiffness", "damping", "inertia")
#: Keys without negative values, and scales of the small numbers of a pendulum.
_NOT_NEGATIVE = ("damping", "c1", "c2", "c3", "p1", "p2", "p3")
_SMALL = {**dict.fromkeys(("c1", "c2", "c3", "f0", "m01", "m02"), 0.1), "p1": 2, "p2": 2, "p3": 2}
#: Largest number of sliders if no keys are named; end of a slider relative to the value.
MOST, _TIMES = 40, 4.0


@dataclass(frozen=True)
class Number:
    """One number of a scene: its key for `Scene.override`, and its label on the page."""

    key: str
    label: str
    group: str
    unit: str
    value: float
    whole: bool = False
    #: Key of the equal entry on the other side of the diagonal of a symmetric matrix.
    mirror: str | None = None
    #: End of the slider of a number that is 0.
    scale: float = 1.0
    positive: bool = False

    def ends(self, value: float) -> tuple[float, float]:
        """Smallest and largest value of a slider at this value."""
        if value == 0:
            if self.whole:
                return 0.0, 10.0
            return (0.0 if self.positive else -self.scale), self.scale
        ends = sorted((value / _TIMES, value * _TIMES))
        return (math.floor(ends[0]), math.ceil(ends[1])) if self.whole else (ends[0], ends[1])


def numbers(scene: Scene) -> dict[str, Number]:
    """Every number of a scene by its key, first those of the system and its loads."""
    found: dict[str, Number] = {}
    for name in (*_PHYSICS, *scene.groups):
        if name not in ("scene", "sweep"):
            for number in _of_group(scene, name):
                found.setdefault(number.key, number)
    return found


def _of_group(scene: Scene, name: str) -> Iterator[Number]:
    group = scene.groups.get(name) or []
    several = group if isinstance(group, list) else [group]
    for i, one in enumerate(several):
        place = f"{name}({i + 1})" if len(several) > 1 else name
        title = f"{name} {i + 1}" if len(several) > 1 else name
        for key, value in one.items():
            if (name in _PHYSICS and key not in _NAMES) or key in _RANGES:
                yield from _of_key(scene, place, title, key, value)


def chosen(scene: Scene, keys: Sequence[str] | None) -> dict[str, Number]:
    """Return the numbers with these keys; without keys, first those that are not 0."""
    known = numbers(scene)
    if keys is None:
        order = sorted(known.values(), key=lambda number: number.value == 0)
        kept = {number.key for number in order[:MOST]}
        return {key: number for key, number in known.items() if key in kept}
    for key in keys:
        if key not in known:
            raise InputError(f"--keys {key}: must be one of {', '.join(known)}")
    return {key: known[key] for key in keys}


def _of_key(scene: Scene, place: str, title: str, key: str, value: Any) -> list[Number]:
    values = value if isinstance(value, list) else [value]
    if not all(isinstance(one, (int, float)) for one in values):
        return []
    scale = max((abs(one) for one in values), default=0.0) or 1.0
    if "pendulum" in scene.groups:
        scale = _SMALL.get(key, scale)
    whole = all(isinstance(one, int) for one in values)
    size = math.isqrt(len(values))
    names = _names(scene.groups, title)
    square = key in _MATRICES and size == len(names) > 1 and size**2 == len(values)
    symmetric = square and all(
        values[i * size + j] == values[j * size + i] for i in range(size) for j in range(i)
    )
    found = []
    for i, one in enumerate(values):
        entry = f"{place}.{key}({i + 1})" if isinstance(value, list) else f"{place}.{key}"
        label, mirror = key, None
        if square:
            row, column = divmod(i, size)
            if symmetric and column < row:
                continue
            if symmetric and column > row:
                mirror = f"{place}.{key}({column * size + row + 1})"
            label = f"{key} [{names[row]}, {names[column]}]"
        elif isinstance(value, list):
            label = _entry(key, i, len(values), names)
        unit = unit_of(scene.groups, entry)
        positive = key in _NOT_NEGATIVE and not (square and i % (size + 1))
        found.append(Number(entry, label, title, unit, float(one), whole, mirror, scale, positive))
    return found


def _entry(key: str, i: int, n: int, names: tuple[str, ...]) -> str:
    if key == "initial" and n == 2 * len(names):
        return f"{key} {names[i // 2]}" + ("'" if i % 2 else "")
    if key == "track":
        return f"{key} {('mass', 'damping', 'stiffness')[i]}"
    if key == "base_direction" and n == len(BODY):
        return f"{key} [{BODY[i]}]"
    if n == len(names):
        return f"{key} [{names[i]}]"
    return f"{key} {i + 1}"


def _names(groups: Mapping[str, Any], title: str) -> tuple[str, ...]:
    if title.startswith(("body", "mount_point")):
        # Their lists of three numbers refer to three axes.
        return ("x", "y", "z")
    if "system" in groups:
        return texts(groups["system"]["coordinates"])
    return ("z", "phi", "psi") if "pendulum" in groups else ("x", "phi")
