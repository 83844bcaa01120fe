"""Reference tables of data/."""

import csv
from pathlib import Path

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
