"""Tables of measurements with columns found by name, with units.

A table has a line of names and either a line of units below it ("Hz, MPa, MPa, C") or the unit in
each name ("f [Hz]", "E' (MPa)"). Columns are separated by semicolons, tabs or commas; numbers have
a decimal point or, unless commas separate columns, a decimal comma.
"""

import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.files import bytes_of
from viscovib.common.parameters import FilePath
from viscovib.errors import FileError, InputError

_SPREADSHEETS = (".xlsx", ".xls", ".xlsm", ".ods")
#: Larger files are refused before they are read (bytes).
_LARGEST = 256 * 2**20
#: Factors to the units of the library, by the spelling that `_unit` returns: capitals only to
#: distinguish milli and mega.
_PRESSURE = {"pa": 1.0, "kpa": 1e3, "mpa": 1e6, "gpa": 1e9, "n/mm2": 1e6, "n/m2": 1.0}
UNITS: dict[str, Mapping[str, float]] = {
    "frequency": {
        "hz": 2 * math.pi, "1/s": 2 * math.pi, "khz": 2e3 * math.pi,
        "mHz": 2e-3 * math.pi, "MHz": 2e6 * math.pi,
        "rad/s": 1.0, "1/min": 2 * math.pi / 60, "rpm": 2 * math.pi / 60,
    },
    "time": {"s": 1.0, "sec": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0},
    "modulus": _PRESSURE,
    "compliance": {f"1/{name}": 1 / size for name, size in _PRESSURE.items() if "/" not in name},
    "stiffness": {
        "n/m": 1.0, "n/mm": 1e3, "kn/m": 1e3, "kn/mm": 1e6, "mN/m": 1e-3, "MN/m": 1e6,
        "nm/rad": 1.0,
    },
    "ratio": {"-": 1.0, "1": 1.0, "%": 0.01, "": 1.0},
    "angle": {"rad": 1.0, "deg": math.pi / 180, "grad": math.pi / 180},
    "length": {"m": 1.0, "mm": 1e-3, "um": 1e-6},
    "decades": {"-": 1.0, "1": 1.0, "": 1.0},
    "label": {"-": 1.0, "1": 1.0, "": 1.0},
    "temperature": {"c": 1.0, "degc": 1.0, "k": 1.0, "degf": 1.0, "f": 1.0},
}  # fmt: skip
#: Numbers without the additional forms of Python, such as 1_0.
_NUMBER = re.compile(
    r"[+-]?(?:(?:\d+[.,]?\d*|[.,]\d+)(?:e[+-]?\d+)?|nan|inf|infinity)", re.ASCII | re.IGNORECASE
)
#: Units of cycles or radians; the name of the column decides.
_PER_TIME = ("1/s", "1/min")


@dataclass(frozen=True)
class Column:
    """A column: role, kind of its unit, and possible names."""

    role: str
    kind: str
    names: tuple[str, ...]


@dataclass(frozen=True)
class Table:
    """Columns by role in the units of the library, and the line of each row in the file."""

    path: str
    columns: Mapping[str, FloatArray]
    #: Name of each column in the file.
    named: Mapping[str, str]
    lines: tuple[int, ...]

    def __contains__(self, role: str) -> bool:
        return role in self.columns

    def __getitem__(self, role: str) -> FloatArray:
        return self.columns[role]

    def get(self, role: str) -> FloatArray | None:
        """Return a column, or None."""
        return self.columns.get(role)

    def where(self, row: int, role: str) -> str:
        """Return the location of a value for messages."""
        return f"{self.path}:{self.lines[row]}: column {_native.shown(self.named[role])}"


def read_columns(
    path: str | os.PathLike[str], wanted: Sequence[Column], given: Mapping[str, str] | None = None
) -> Table:
    """Read the requested columns that a file contains.

    Parameters
    ----------
    path : path
        A text file, or a spreadsheet if pandas is installed.
    wanted : sequence of Column
    given : mapping, optional
        Names of columns that differ from the usual ones, {role: name in the file}.

    Raises
    ------
    InputError
        ``file:line: column 'name': reason``: a cell that is not a finite number, a column without a
        unit or with an unknown unit, two columns of one role. ``file:line`` of a row with more
        cells than names, for example by decimal commas in a table separated by commas.
    FileError
        If the file cannot be read.
    """
    name = FilePath("path").check(path)
    rows = _cells(name)
    if not rows:
        raise InputError(f"{name}: is empty, must have a line of names, units and rows of numbers")
    first, names = rows[0]
    if all(_is_number(cell) for cell in names):
        raise InputError(f"{name}:{first}: is a row of numbers, must be a line of names of columns")
    body = rows[1:]
    units = [""] * len(names)
    if body and not any(_is_number(cell) for cell in body[0][1]):
        units = [*body[0][1], *units][: len(names)]
        body = body[1:]
    if not body:
        raise InputError(f"{name}: has no row of numbers")
    for line, row in body:
        filled = max((i for i, cell in enumerate(row, start=1) if cell.strip()), default=0)
        if filled > len(names):
            raise InputError(
                f"{name}:{line}: has {filled} cells below {len(names)} names of columns, must have "
                "no more; where commas separate columns numbers have a decimal point"
            )
    places = _places(name, first, names, units, wanted, given or {})
    columns, spelt = {}, {}
    for column, place in places.items():
        spelt[column.role] = names[place].strip()
        unit = units[place].strip() or _unit_within(names[place])
        values = [_cell(name, line, spelt[column.role], row, place) for line, row in body]
        where = f"{name}:{first}: column {_native.shown(spelt[column.role])}"
        size = 1.0
        if column.kind == "frequency" and _unit(unit, UNITS["frequency"]) in _PER_TIME:
            size = _cycle(where, _plain(spelt[column.role]))
        columns[column.role] = _in_units(where, np.array(values), column.kind, unit) * size
    return Table(name, columns, spelt, tuple(line for line, _ in body))


def _places(
    name: str,
    first: int,
    names: Sequence[str],
    units: Sequence[str],
    wanted: Sequence[Column],
    given: Mapping[str, str],
) -> dict[Column, int]:
    """Indices of the columns found; for equal names, such as t and T, the unit decides."""
    plain = [_plain(one) for one in names]
    roles = [column.role for column in wanted]
    for role in given:
        _native.choice("columns", role, tuple(roles))
    places: dict[Column, int] = {}
    unit_texts = [units[i].strip() or _unit_within(one) for i, one in enumerate(names)]
    for column in wanted:
        if column.role in given:
            stripped = [one.strip() for one in names]
            if given[column.role] not in stripped:
                raise InputError(
                    f"{name}:{first}: no column {_native.shown(given[column.role])}, must be one "
                    f"of {', '.join(map(repr, stripped))}"
                )
            places[column] = stripped.index(given[column.role])
            continue
        found = [i for i, one in enumerate(plain) if one in column.names]
        if len(found) > 1 or "t" in column.names:
            known = UNITS[column.kind]
            fits = [i for i in found if _unit(unit_texts[i], known) in known]
            if "t" in column.names and not fits:
                fits = [
                    i for i in found if plain[i] != "t" or _bare(column, names[i], unit_texts[i])
                ]
            found = fits
        if len(found) > 1:
            both = " and ".join(repr(names[i].strip()) for i in found)
            raise InputError(
                f"{name}:{first}: columns {both} both contain {column.role}: select one by "
                f"columns={{{column.role!r}: ...}}"
            )
        if found:
            places[column] = found[0]
    return places


def _cells(name: str) -> list[tuple[int, list[str]]]:
    """Non-empty rows with their line numbers."""
    if name.lower().endswith(_SPREADSHEETS):
        return _spreadsheet(name)
    raw = bytes_of(name, _LARGEST, "a table")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    lines = [
        (i, line)
        for i, line in enumerate(text.splitlines(), start=1)
        if line.strip(" \t,;") and not line.lstrip().startswith("#")
    ]
    if not lines:
        return []
    header = lines[0][1]
    mark = next((mark for mark in ";\t," if mark in header), None)
    return [(i, line.split(mark) if mark else line.split()) for i, line in lines]


def _spreadsheet(name: str) -> list[tuple[int, list[str]]]:
    try:
        import pandas
    except ImportError:
        raise FileError(f"{name}: spreadsheets need pandas, or save it as CSV") from None
    try:
        sheet = pandas.read_excel(name, header=None, dtype=object)
    except Exception as error:
        # Readers of spreadsheets raise different exceptions for other files.
        unit_texts = f"{error}".splitlines() or [""]
        raise FileError(f"{name}: cannot be read as a spreadsheet ({unit_texts[0]})") from None
    rows = []
    for i, row in enumerate(sheet.itertuples(index=False), start=1):
        cells = ["" if cell is None or cell != cell else str(cell) for cell in row]
        if any(cells):
            rows.append((i, cells))
    return rows


def _cell(name: str, line: int, column: str, row: Sequence[str], place: int) -> float:
    text = row[place].strip() if place < len(row) else ""
    if _is_number(text):
        value = float(text.replace(",", "."))
        if math.isfinite(value):
            return value
    what = f"{_native.shown(text)} is" if text else "is empty,"
    raise InputError(f"{name}:{line}: column {_native.shown(column)}: {what} not a finite number")


def _is_number(text: str) -> bool:
    return _NUMBER.fullmatch(text.strip()) is not None


def _plain(name: str) -> str:
    """A name without unit, case, blanks and variable punctuation."""
    text = re.sub(r"\[[^\[\]]*\]|\([^()]*\)", " ", name).lower()
    text = text.replace("’", "'").replace("′", "'").replace("″", "''").replace('"', "''")  # noqa: RUF001
    return re.sub(r"[\s_\-.]+", "", text)


def _unit_within(name: str) -> str:
    found = re.search(r"\[([^\[\]]*)\]|\(([^()]*)\)", name)
    return "" if found is None else (found[1] or found[2] or "")


def _bare(column: Column, name: str, unit: str) -> bool:
    """True if T is a temperature, or t a time, without a unit."""
    return not unit and name.strip()[0] == ("T" if column.kind == "temperature" else "t")


def _spelled(text: str) -> str:
    """A unit without brackets, blanks and variable signs; m and M remain different."""
    unit = text.strip().strip("[]()").strip().replace("²", "2").replace("^", "")
    unit = unit.replace("°", "deg").replace("µ", "u").replace("μ", "u").replace("·", "")
    return re.sub(r"\s+", "", unit)


def _unit(text: str, known: Iterable[str]) -> str:
    unit = _spelled(text)
    if unit in known:
        return unit
    unit = unit.lower()
    if unit in ("degc", "deg.c", "celsius", "degreesc"):
        return "c"
    unit = re.sub(r"^(k|m|g)?pa-1$", r"1/\1pa", unit)
    return {"degrees": "deg", "degree": "deg", "s-1": "1/s", "radians": "rad", "degk": "k"}.get(
        unit, unit
    )


def _cycle(where: str, name: str) -> float:
    """Return the length of a cycle for a frequency in 1/s, from the plain name of its column."""
    if name == "w" or re.search("omega|ω|angular|circular|radian", name):
        return 1 / (2 * math.pi)
    if name == "f" or "freq" in name:
        return 1.0
    raise InputError(f"{where}: 1/s may be Hz or rad/s, must be one of these")


def _in_units(where: str, values: FloatArray, kind: str, text: str) -> FloatArray:
    known = UNITS[kind]
    unit = _unit(text, known)
    if unit not in known:
        allowed = ", ".join(one for one in known if one)
        what = f"unit {_native.shown(text.strip())} is not known" if unit else "has no unit"
        raise InputError(f"{where}: {what}, must be one of {allowed}")
    if kind in ("modulus", "compliance") and _spelled(text).removeprefix("1/").startswith("mP"):
        raise InputError(f"{where}: unit {_native.shown(text.strip())} is millipascal; write MPa")
    if kind == "temperature":
        if unit == "k":
            return values - 273.15
        return (values - 32) / 1.8 if unit in ("f", "degf") else values
    return np.asarray(values * known[unit])
