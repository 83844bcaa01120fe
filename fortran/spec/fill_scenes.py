"""Fill the rows of groups and keys of scenes into their module.

`fill_scenes.py scenes.toml curve_options.py scene_table.f90.in scene_table.f90`, in the build.
The page of scenes and the tests import `read_groups`.
"""

import runpy
import sys
import tomllib
from pathlib import Path
from typing import Any

SYSTEMS = ("mount", "system", "structure", "body", "pendulum")
ROLES = ("scene", "system", "part", "result")
BOUNDS = ("above", "at_least", "below", "at_most")
#: What a group and a row may have.
GROUP = {"name", "text", "role", "systems", "needs", "repeats", "python", "keys", "sets"}
ROW = {"type", "default", "otherwise", *BOUNDS, "must", "words", "size", "unit", "text", "systems"}
ROW |= {"when", "python"}
WHOLE = ("integer", "integers", "count")
LARGEST = "1.7976931348623157e308"


def read_groups(table: Path, options: Path) -> list[dict[str, Any]]:
    """Return the groups in order, each with ``rows``, which have ``name`` and ``systems``."""
    content = tomllib.loads(table.read_text(encoding="utf-8"))
    sets = {one["name"]: dict(one["keys"]) for one in content["set"]}
    curve = _curve_rows(options)
    sets["curve"] = curve | {key: curve.get(key, {}) | row for key, row in sets["curve"].items()}
    for group in content["group"]:
        _check(set(group) <= GROUP and group["role"] in ROLES, group["name"])
        group.setdefault("systems", list(SYSTEMS))
        rows = dict(group.get("keys", {}))
        for name in group.get("sets", ()):
            rows |= {key: {**row, "set": name} for key, row in sets[name].items()}
        group["rows"] = [
            {"systems": group["systems"], **row, "name": key}
            for key, value in rows.items()
            for row in (value if isinstance(value, list) else [value])
        ]
        for row in group["rows"]:
            where = f"{group['name']}.{row['name']}"
            _check(set(row) <= ROW | {"name", "set"} and {"type", "text"} <= set(row), where)
            _check(set(row["systems"]) <= set(group["systems"]), where)
            row["must"] = phrase(row)
            if row["type"] == "yes/no":
                row["words"] = sorted(("no", "yes"), key=row["default"].__ne__)
    return content["group"]


def _check(right: bool, where: str) -> None:
    if not right:
        raise SystemExit(f"scenes.toml: {where} has a wrong attribute")


def _curve_rows(options: Path) -> dict[str, dict[str, Any]]:
    """Return the options of curves as rows."""
    known = runpy.run_path(str(options))
    rows = {}
    for name, option in known["OPTIONS"].items():
        whole = name in known["WHOLE"]
        rows[name] = {
            "type": "integer" if whole else "real",
            "at_least": option.lowest,
            "at_most": option.highest,
            "text": option.text,
        }
        if option.default is None:
            rows[name]["otherwise"] = "selected by the system"
        else:
            rows[name]["default"] = option.default
    return rows


def phrase(row: dict[str, Any]) -> str:
    """Return what the message of a number out of bounds says."""
    if "must" in row:
        return f"must be {row['must']}"
    low, high = (
        None if bound is None else _spelt(bound)
        for bound in (row.get("above", row.get("at_least")), row.get("below", row.get("at_most")))
    )
    if low and high:
        if row["type"] in WHOLE:
            return f"must be {low} to {high}"
        first, last = "(" if "above" in row else "[", ")" if "below" in row else "]"
        return f"must be in {first}{low}, {high}{last}"
    if "at_least" in row:
        return "must not be negative" if low == "0" else f"must be at least {low}"
    return f"must be greater than {low}" if low else f"must be at most {high}" if high else ""


def _spelt(bound: float) -> str:
    """Write a bound: a small one as 1e-4, a large one as 1e30."""
    if bound == 0 or 0.01 <= abs(bound) < 1e15:
        return f"{bound:.12g}"
    digits, _, power = f"{bound:e}".partition("e")
    return f"{float(digits):g}e{int(power)}"


def _number(value: float) -> str:
    return f"{float(value)!r}_wp"


def _flag(value: object) -> str:
    return ".true." if value else ".false."


def _bits(systems: list[str]) -> int:
    return sum(1 << SYSTEMS.index(name) for name in systems)


def key_row(row: dict[str, Any]) -> str:
    """Return the constructor of a row in Fortran."""
    default = row.get("default")
    word = default if isinstance(default, str) else ""
    number = row.get("at_least", 0.0) if default is None or word == default else default
    lowest = row.get("above", row.get("at_least", f"-{LARGEST}"))
    highest = row.get("below", row.get("at_most", LARGEST))
    return ", &\n      ".join(
        [
            f"key_row('{row['name']}', {_bits(row['systems'])}, {_flag(row['type'] in WHOLE)}, "
            f"{_flag(default is not None)}, {_number(number)}, '{word}'",
            f"{row.get('size', 0)}, {_number(lowest)}, {_number(highest)}, "
            f"{_flag('above' in row)}, {_flag('below' in row)}",
            f"'{row['must']}'",
            f"'{' '.join(row.get('words', []))}')",
        ]
    )


def module(groups: list[dict[str, Any]], template: str) -> str:
    """Return the module."""
    filled: dict[str, list[str]] = {"systems": [", ".join(f"'{one}'" for one in SYSTEMS) + " &"]}
    filled |= {"keys": [], "all_keys": [], "groups": []}
    names, rows, last = [], [], 0
    for group in groups:
        first, last = last + 1, last + len(group["rows"])
        rows.append(
            f"group_row('{group['name']}', {first}, {last}, {_bits(group['systems'])}, "
            f"role_{group['role']}, {_flag(group.get('repeats'))}, '{group.get('needs', '')}')"
        )
        if group["rows"]:
            names.append(f"keys_of_{group['name']}")
            listed = ", &\n    ".join(map(key_row, group["rows"]))
            declared = f"type(key_row), parameter :: {names[-1]}(*)"
            filled["keys"].append(f"{declared} = [ &\n    {listed}]")
    filled["all_keys"] = [", &\n    ".join(names) + " &"]
    filled["groups"] = [", &\n    ".join(rows) + " &"]
    for place, lines in filled.items():
        template = template.replace(f"@{place}@", "\n".join(f"    {line}" for line in lines))
    return template


if __name__ == "__main__":
    table, options, template, target = map(Path, sys.argv[1:])
    text = module(read_groups(table, options), template.read_text(encoding="utf-8"))
    # A file that is the same keeps its time, or every configuration would compile all that uses it.
    if not target.exists() or target.read_text(encoding="utf-8") != text:
        target.write_text(text, encoding="utf-8")
