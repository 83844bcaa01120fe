"""Measured curves from a CSV file, for comparison with computed ones."""

import csv
import io
from collections.abc import Sequence

import numpy as np

from viscovib._native import FloatArray
from viscovib.errors import InputError

_MOST_ROWS = 100_000


def read_measured(
    text: str, names: Sequence[str], orders: Sequence[int | None]
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return x and y of each coordinate that has a column.

    The first column is x. A line of names is optional. With it, a column belongs to the coordinate
    of that name; without it, the second column belongs to the first coordinate, etc. Tables of
    viscovib contain real and imaginary parts ``x_1_re`` and ``x_1_im``; they give amplitudes.
    Lines that begin with ``#`` are ignored.
    """
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if not lines:
        raise InputError("the file contains no numbers")
    separator = next((sign for sign in ",;\t" if sign in lines[0]), " ")
    rows = list(csv.reader(io.StringIO("\n".join(lines)), delimiter=separator))
    if separator == " ":
        rows = [[cell for cell in row if cell] for row in rows]
    header: list[str] = []
    if any(not _is_number(cell) for cell in rows[0]):
        header = [cell.strip() for cell in rows.pop(0)]
    if not rows:
        raise InputError("the file contains names of columns but no numbers")
    if len(rows) > _MOST_ROWS:
        raise InputError(f"the file contains {len(rows)} rows, must be {_MOST_ROWS} at most")
    width = len(header or rows[0])
    columns = []
    for j in range(width):
        try:
            columns.append([float(row[j]) if _is_number(row[j]) else np.nan for row in rows])
        except IndexError:
            short = next(i for i, row in enumerate(rows) if len(row) <= j)
            raise InputError(
                f"row {short + 1} has {len(rows[short])} columns, must have {width}"
            ) from None
    table = np.array(columns)
    if width < 2:
        raise InputError("the file has one column, must have two or more: x and amplitudes")
    if not np.isfinite(table[0]).any():
        raise InputError("the first column contains no numbers")
    found = _columns(table, header, names, orders)
    if not found:
        raise InputError(
            f"no column is named after a coordinate: {', '.join(header)}; must be one of "
            f"{', '.join(names)}"
        )
    return {name: (table[0], y) for name, y in found.items()}


def _columns(
    table: FloatArray, header: list[str], names: Sequence[str], orders: Sequence[int | None]
) -> dict[str, FloatArray]:
    if not header:
        return dict(zip(names, table[1:], strict=False))
    found = {}
    for name, order in zip(names, orders, strict=True):
        parts = [f"{name}_{order}_re", f"{name}_{order}_im"]
        if name in header[1:]:
            found[name] = table[header.index(name, 1)]
        elif all(part in header for part in parts):
            found[name] = np.hypot(*(table[header.index(part)] for part in parts))
    if not found and len(header) == 2 and np.isfinite(table[1]).any():
        # A single curve, with any name, belongs to the first coordinate.
        found[names[0]] = table[1]
    return found


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
