"""Reference tables of data/."""

import csv
import re
from pathlib import Path

import numpy as np

DATA = Path(__file__).parents[2] / "data"


def read_table(name):
    """Rows of a reference table as dictionaries, without comment lines."""
    with open(DATA / name, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def lines_without_plan(path):
    """Lines of a table except those of the plan."""
    lines = path.read_text().splitlines()
    kept = [line for line in lines if not line.startswith(("# computes: ", "# skips: "))]
    assert len(kept) < len(lines)
    return kept


def equal_to_rounding(mine, theirs):
    """Equal words and columns, and equal numbers except estimates of rounding errors."""
    tables = []
    for text in (mine.decode(), theirs.decode()):
        lines = text.splitlines()
        names, *rows = [line.split(",") for line in lines if not line.startswith("#")]
        # Steps along a curve may differ: the ends and the notes are compared.
        rows = np.array(rows[:1] + rows[-1:]).reshape(-1, len(names))
        kept = [i for i, name in enumerate(names) if not name.endswith(("error", "truncation"))]
        notes = "\n".join(line for line in lines if line.startswith("#"))
        tables.append((names, notes, rows[:, kept]))
    (names, notes, rows), (others, their_notes, their_rows) = tables
    number = re.compile(r"-?\d\.\d{9,}e[+-]\d+")
    values, their_values = (np.array(number.findall(x), float) for x in (notes, their_notes))
    large = np.maximum(values, their_values) > 1e-9
    words = [re.sub(r"point \d+", "", number.sub("", x)) for x in (notes, their_notes)]
    assert names == others
    assert words[0] == words[1]
    assert np.allclose(values[large], their_values[large], rtol=1e-9, atol=0)
    for one, other in zip(rows.T, their_rows.T, strict=True):
        if any(re.search("[a-z]{2}", cell) for cell in (*one, *other)):
            assert list(one) == list(other)
        else:
            assert np.allclose(one.astype(float), other.astype(float), rtol=1e-8, atol=1e-11)
    return True
