"""Tables of results, byte for byte as written by the standalone driver."""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib._native import ComplexArray
from viscovib.common.files import whole_file


@dataclass
class Table:
    """Notes for the header, and columns by name: arrays of numbers, flags or words."""

    notes: list[str] = field(default_factory=list)
    columns: dict[str, Any] = field(default_factory=dict)

    def add(self, name: str, values: npt.NDArray[Any]) -> None:
        """Add a column, or two columns for complex numbers."""
        if np.iscomplexobj(values):
            self.add_complex(name, values)
        else:
            self.columns[name] = values

    def add_complex(self, name: str, values: ComplexArray) -> None:
        """Add two columns, NAME_re and NAME_im."""
        self.columns[f"{name}_re"] = values.real
        self.columns[f"{name}_im"] = values.imag

    def add_harmonics(
        self, names: Mapping[int, str], orders: Iterable[str], coefficients: ComplexArray
    ) -> None:
        """Add X_k of coordinates, given by index and name."""
        labels = list(orders)
        for d, name in names.items():
            for j, order in enumerate(labels):
                self.add_complex(f"{name}_{order}", coefficients[:, d, j])

    def write(self, path: str | os.PathLike[str], plan: str, heading: str = "") -> None:
        """Write the file atomically.

        ``heading``: text after the version, such as the scene and its title.
        """
        from importlib.metadata import version

        lines = [f"viscovib {version('viscovib')}{heading}", *plan.splitlines(), *self.notes]
        names = [_quoted(name) for name in self.columns]
        columns = [cells(values) for values in self.columns.values()]
        with whole_file(path) as file:
            file.writelines(f"# {line}\n" for one in lines for line in one.splitlines())
            file.write(",".join(names) + "\n")
            file.writelines(",".join(row) + "\n" for row in zip(*columns, strict=True))


def _quoted(name: str) -> str:
    """Return a name as a cell of CSV."""
    doubled = name.replace('"', '""')
    return f'"{doubled}"' if "," in name or doubled != name else name


def cells(values: Any) -> list[str]:
    """Return numbers with 17 digits, which are read back exactly; other values unchanged."""
    array = np.asarray(values)
    if array.dtype.kind == "f":
        return [f"{value:.16e}" for value in array.tolist()]
    return [str(value) for value in (array.astype(int) if array.dtype == bool else array).tolist()]


def listed(values: Iterable[float]) -> str:
    """Return numbers in one line, each after a space."""
    return "".join(f" {value:.16e}" for value in values)


def listed_units(names: Sequence[str], units: Sequence[str]) -> str:
    """Return "x in m, phi in rad"."""
    return ", ".join(f"{name} in {unit}" for name, unit in zip(names, units, strict=True))
