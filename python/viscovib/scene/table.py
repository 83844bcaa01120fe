"""Results that are a table: of analyses that have no class of their own."""

from __future__ import annotations

import csv
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
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
    _told: str = field(repr=False, default="")

    @property
    def stable(self) -> npt.NDArray[Any] | None:
        """The column of that name: 1 stable, 0 unstable, else unknown; None if there is none."""
        return self.columns.get("stable")

    def _headline(self) -> str:
        return self._told

    def _scope(self) -> list[str]:
        return list(self.notes)

    def _of_numbers(self) -> dict[str, npt.NDArray[Any]]:
        """Columns but those of words."""
        return {name: v for name, v in self.columns.items() if v.dtype.kind in "if"}

    def numbers(self) -> dict[str, Number]:
        """Return every column in its first row."""
        return {name: Number(values[0]) for name, values in self._of_numbers().items()}

    def panels(self) -> list[Panel]:
        """Return each column over the first one."""
        (first, x), *others = self._of_numbers().items()
        return [Panel(x, values, first, name, "1") for name, values in others]

    def to_dataset(self) -> xr.Dataset:
        """Return the columns as an xarray Dataset over the rows."""
        import xarray as xr

        return xr.Dataset(
            {name: ("row", values) for name, values in self.columns.items()},
            attrs={"notes": "\n".join(self.notes), "plan": str(self.plan)},
        )

    def _table(self, coordinates: object) -> Table:
        return Table(list(self.notes), dict(self.columns))


def run_tables(scene: Scene, kinds: Sequence[str], plan: Plan) -> list[TableResult]:
    """Let the core do what a scene asks for, as the standalone driver does, and read its tables.

    ``kinds``: their names, as in those of the files.
    """
    with TemporaryDirectory(prefix="viscovib") as folder:
        given = {"path": os.fsencode(scene.path), "text": scene.canonical.encode()}
        found = _native.interruptible(
            lambda: _native.run("scene run", **given, folder=os.fsencode(folder))
        )
        complete, told = bool(found["complete"]), found["summary"]
        return [
            _read(scene, kind, Path(folder), plan, complete=complete, told=told)
            for kind in kinds
            if complete or _path(scene, kind, Path(folder)).exists()
        ]


def _path(scene: Scene, kind: str, folder: Path) -> Path:
    return folder / f"{scene.path.stem}_{kind}.csv"


def _read(
    scene: Scene, kind: str, folder: Path, plan: Plan, *, complete: bool, told: str
) -> TableResult:
    """One of the tables."""
    lines = _path(scene, kind, folder).read_text("utf-8", "surrogateescape").splitlines()
    notes = [line.removeprefix("# ") for line in lines if line.startswith("#")]
    title = scene.groups.get("scene", {}).get("title", "")
    known = {f"viscovib {version('viscovib')}, scene {scene.path}", title, *str(plan).splitlines()}
    names, *rows = csv.reader(line for line in lines if not line.startswith("#"))
    values = map(_numbers, zip(*rows, strict=True) if rows else [()] * len(names))
    return TableResult(
        kind=kind,
        columns=dict(zip(names, values, strict=True)),
        notes=tuple(note for note in notes if note not in known),
        plan=plan,
        complete=complete,
        _told=told,
    )


def _numbers(cells: tuple[str, ...]) -> npt.NDArray[Any]:
    """Cells of a column as numbers, or as the words they are."""
    whole = all(cell.lstrip("-").isdigit() for cell in cells)
    try:
        return np.array(list(map(int, cells)) if whole else list(map(float, cells)))
    except ValueError:
        return np.array(cells)
