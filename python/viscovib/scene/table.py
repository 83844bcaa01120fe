"""Results as a table, for analyses without a result class of their own."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib.common.plan import Plan
from viscovib.common.results import Number, Panel, Result
from viscovib.common.tables import Table
from viscovib.scene.scene import Scene

if TYPE_CHECKING:
    import xarray as xr


#: Tables that a scene may have in addition to its result.
_FURTHER = (
    "spectrum", "event", "free_decay", "shock_spectrum", "forces", "reactions", "peaks",
)  # fmt: skip


@dataclass(frozen=True, eq=False, repr=False)
class TableResult(Result):
    """The result of a scene as columns.

    Attributes
    ----------
    kind : str
        Name of the group, such as "modes".
    columns : dict
        Arrays by name, shape (n,); the first one is the abscissa of plots.
    notes : tuple of str
        Descriptions of the columns, with units.
    plan : Plan
        What was computed, and what was skipped and why.

    Examples
    --------
    >>> from pathlib import Path
    >>> import viscovib as vv
    >>> mount = "&mount mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2 /"
    >>> size = Path("modes.nml").write_text(f"{mount} &modes /")
    >>> vv.run("modes.nml").kind
    'modes'
    """

    _form = "table"

    kind: str  # type: ignore[misc]
    columns: dict[str, npt.NDArray[Any]]
    notes: tuple[str, ...]
    plan: Plan
    complete: bool
    _note: str = field(repr=False, default="")

    @property
    def stable(self) -> npt.NDArray[Any] | None:
        """The column "stable": 1 stable, 0 unstable, otherwise unknown; None without the column."""
        return self.columns.get("stable")

    def _headline(self) -> str:
        return self._note

    def _scope(self) -> list[str]:
        return list(self.notes)

    def _of_numbers(self) -> dict[str, npt.NDArray[Any]]:
        """Columns without those of words."""
        return {name: v for name, v in self.columns.items() if v.dtype.kind in "if"}

    def numbers(self) -> dict[str, Number]:
        """Return the first row of every column."""
        return {name: Number(values[0]) for name, values in self._of_numbers().items()}

    def panels(self) -> list[Panel]:
        """Return each column over the first one."""
        (first, x), *columns_left = self._of_numbers().items()
        return [Panel(x, values, first, name, "1") for name, values in columns_left]

    def to_dataset(self) -> xr.Dataset:
        """Return the columns as an xarray Dataset over the rows."""
        import xarray as xr

        return xr.Dataset(
            {name: ("row", values) for name, values in self.columns.items()},
            attrs={"notes": "\n".join(self.notes), "plan": str(self.plan)},
        )

    def _table(self, coordinates: object) -> Table:
        return Table(list(self.notes), dict(self.columns))


def run_tables(scene: Scene, plan: Plan) -> dict[str, TableResult]:
    """Compute a scene in the core, like the standalone driver.

    Returns the tables by name, as in the names of files of the driver, the result first.
    """
    given = {"path": os.fsencode(scene.path), "text": scene.canonical.encode()}
    found = _native.interruptible(lambda: _native.run("scene run", **given))
    numbers = {found[f"name_{i}"]: i for i in range(1, found["n_tables"] + 1)}
    names = sorted(numbers, key=_FURTHER.__contains__)
    return {
        name: TableResult(
            # Further branches, NAME_1, are of the same kind.
            kind=names[0] if name.startswith(f"{names[0]}_") else name,
            columns=_columns(found, numbers[name]),
            notes=tuple(found[f"notes_{numbers[name]}"].splitlines()),
            plan=plan,
            complete=bool(found["complete"]),
            _note=found["summary"],
        )
        for name in names
    }


def _columns(found: Mapping[str, Any], i: int) -> dict[str, npt.NDArray[Any]]:
    """The columns of table i: numbers, integers or words."""
    words: dict[int, list[str]] = defaultdict(list)
    for line in found[f"words_{i}"].splitlines():
        column, word = line.split(" ", 1)
        words[int(column) - 1].append(word)
    names = found[f"columns_{i}"].splitlines()
    columns = {}
    for j, (name, whole) in enumerate(zip(names, found[f"whole_{i}"], strict=True)):
        values = np.array(found[f"values_{i}"][:, j])
        if whole:
            values = values.astype(int)
        columns[name] = np.array(words[j])[values] if j in words else values
    return columns
