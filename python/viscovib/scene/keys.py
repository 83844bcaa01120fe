"""Keys of a scene such as "load(2).amplitude": change one and write the new scene."""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from viscovib._native import letters
from viscovib.errors import InputError, near_name

#: A value in the form of the compiled reader: a text with doubled quotes, or a number.
_VALUE = re.compile(r"'((?:[^']|'')*)'|(\S+)")


def groups_of(text: str) -> list[tuple[str, dict[str, Any]]]:
    """Return the groups of a canonical scene in their order.

    A single value is not in a list, several are. The text is that of the compiled reader: a key per
    line, continued by lines without "=", and texts in single quotes on one line.
    """
    groups: list[tuple[str, dict[str, Any]]] = []
    lists: dict[str, list[Any]] = {}
    key = ""
    for line in text.split("\n"):
        if line.startswith("&"):
            lists = {}
            groups.append((line[1:], {}))
        elif line == "/":
            one = {name: values if len(values) > 1 else values[0] for name, values in lists.items()}
            groups[-1][1].update(one)
        elif line.startswith("    "):
            lists[key] += map(float, line.split())
        elif line:
            key, _, values = line[2:].partition(" =")
            lists[key] = _values(values)
    return groups


def _values(text: str) -> list[Any]:
    """Values of one line."""
    if "'" not in text:
        return [_number(word) for word in text.split()]
    found = _VALUE.finditer(text)
    return [m[1].replace("''", "'") if m[2] is None else _number(m[2]) for m in found]


def _number(word: str) -> int | float:
    return int(word) if word.lstrip("+-").isdigit() else float(word)


def with_key(groups: Mapping[str, Any], key: str, value: Any) -> dict[str, Any]:
    """Return groups with one changed key, without a check of its value."""
    form = re.fullmatch(r"(\w+)(?:\((\d+)\))?\.(\w+)(?:\((\d+)\))?", str(key).lower())
    if form is None:
        raise InputError(
            f"{key!r}: must be a key in its group, as 'mount.stiffness_x' or 'load(2).amplitude'"
        )
    name, which, entry, element = form[1], int(form[2] or 0), form[3], int(form[4] or 0)
    if "0" in (form[2], form[4]):
        raise InputError(f"{key!r}: groups and entries are counted from 1")
    found = groups.get(name, [])
    several = found if isinstance(found, list) else [found]
    if not 0 <= which <= len(several) or not several:
        raise InputError(f"{key!r}: this scene has &{name} {len(several)} times")
    if which == 0 and len(several) > 1:
        raise InputError(
            f"{key!r}: this scene has &{name} {len(several)} times, select one, as "
            f"'{name}(1).{entry}'"
        )
    place = max(which, 1) - 1
    group = dict(several[place])
    if entry not in group:
        raise InputError(f"{key!r}: &{name} has no {entry} here, {near_name(entry, group)}")
    before = group[entry]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, str):
        letters(key, value)
    listed = isinstance(before, list)
    if (element == 0) == listed or element > (len(before) if listed else 0):
        size = f"a list of {len(before)}, must be named as {entry}(1)" if listed else "one value"
        raise InputError(f"{key!r}: is {size}")
    if listed:
        group[entry] = [
            *before[: element - 1],
            _like(before[element - 1], value),
            *before[element:],
        ]
    else:
        group[entry] = _like(before, value)
    if isinstance(found, list):
        return {**groups, name: [*found[:place], group, *found[place + 1 :]]}
    return {**groups, name: group}


def _like(before: Any, value: Any) -> Any:
    """Convert a whole number to int if an integer, or a word in place of one, stood there."""
    if isinstance(before, (int, str)) and isinstance(value, float) and value.is_integer():
        return int(value)
    return value


def namelist_text(groups: Mapping[str, Any]) -> str:
    """Return groups as the text of a scene."""
    lines = []
    for name, group in groups.items():
        for one in group if isinstance(group, list) else [group]:
            lines.append(f"&{name}")
            lines += [f"  {key} = {_text(value)}" for key, value in one.items()]
            lines.append("/")
    return "\n".join(lines) + "\n"


#: A name, or a number (its exponent letter is not a name).
_WORD = re.compile(r"(?:\d+\.?\d*|\.\d+)(?:[ed][+-]?\d+)?|[a-z_]\w*(?!\w)(?!\s*\()", re.IGNORECASE)


def named_in(law: str, parameters: Mapping[str, float]) -> dict[str, float]:
    """Return the parameters that occur in a law."""
    words = {word.lower() for word in _WORD.findall(law)}
    return {name: value for name, value in parameters.items() if name in words}


#: First letters of keys whose texts are laws.
_LAWS = ("law", "function", "amplitude", "phase", "torque")


def with_numbers(group: Mapping[str, Any], parameters: Mapping[str, float]) -> dict[str, Any]:
    """Return a group with numbers in place of the parameters in its laws."""

    def number(found: re.Match[str]) -> str:
        name = found[0].lower()
        return f"({parameters[name]!r})" if name in parameters else found[0]

    return {
        key: _WORD.sub(number, value) if isinstance(value, str) and key.startswith(_LAWS) else value
        for key, value in group.items()
    }


def _text(value: Any) -> str:
    if isinstance(value, str):
        return "'" + value.replace("'", "''") + "'"
    if isinstance(value, list):
        return " ".join(map(_text, value))
    return repr(value)
