"""Common parts of all results: print, compare, pickle, plot and save."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from viscovib._native import FloatArray
from viscovib.common.files import whole_file
from viscovib.common.tables import Table
from viscovib.common.values import Value
from viscovib.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.figure import Figure as Figure
    from xarray import Dataset as Dataset
else:
    # These packages are imported when a plot or a dataset is made.
    Axes = Figure = Dataset = Any


class Number(NamedTuple):
    """A number of a result with its unit ("" if it has none)."""

    value: Any
    unit: str = ""


@dataclass(frozen=True)
class Panel:
    """A curve of a result: one coordinate over frequency, parameter or time."""

    x: FloatArray
    y: FloatArray
    x_label: str
    #: The coordinate, its unit and, for an amplitude, its harmonic.
    name: str
    unit: str
    order: int | None = None
    #: True for a logarithmic axis.
    log: bool = False


class Result(Value):
    """Base class of all results, which are values: frozen, comparable, picklable, copyable.

    Examples
    --------
    >>> import viscovib as vv
    >>> mount = vv.Mount(
    ...     mass=1,
    ...     inertia=0.1,
    ...     offset=0.5,
    ...     stiffness_x=10,
    ...     stiffness_phi=2,
    ...     damping=[[0.2, -0.1], [-0.1, 0.09]],
    ... )
    >>> response = vv.forced_response(mount, [1.0, 2.0], load=0.1)
    >>> isinstance(response, vv.Result)
    True
    >>> words = response.summary()
    """

    #: Kind as in the names of tables: "response", "branch", "backbone", "transient", ...
    kind: ClassVar[str]
    #: True if all parts were found with the requested accuracy.
    complete: bool = True
    #: Name in scenes and user interfaces: "response", "branch", "backbone", "trajectory", "steady",
    #: "table", or "".
    _form: ClassVar[str] = ""

    def _headline(self) -> str:
        """Return outcome, amount of results and problems in one line."""
        raise NotImplementedError

    def _scope(self) -> list[str]:
        """Return ranges, coordinates and accuracy."""
        return []

    def _details(self) -> list[str]:
        """Return lines with details, which may need further computation."""
        return self._scope()

    def summary(self) -> str:
        """Return a few lines about the result and its accuracy."""
        return "\n".join([self._headline(), *self._details()])

    def numbers(self) -> dict[str, Number]:
        """Return a few numbers, with the same names for all parameters: the summary for sweeps."""
        raise InputError(f"numbers: must be those of a response, branch or motion, not {self.kind}")

    def panels(self) -> list[Panel]:
        """Return one curve per coordinate, for plots that compare results."""
        raise InputError(f"panels: must be those of a response, branch or motion, not {self.kind}")

    def _base_frequencies(self) -> dict[str, float] | None:
        """Return the frequencies of the loads by name, for marks of their multiples in pictures."""
        return None

    def _pieces(self) -> tuple[int, str, str]:
        """Return the number of parts, a text with this number, and the noun."""
        raise InputError("bench: this scene has nothing that can be timed")

    def plot(self, *args: Any, **options: Any) -> Any:
        """Plot the result by the function for its kind (`plot_response`, ...) and return axes."""
        return _pictures().plot(self, *args, **options)

    def to_dataset(self) -> Dataset:
        """Return all data as an xarray Dataset."""
        raise NotImplementedError

    def _table(self, coordinates: Sequence[str] | None) -> Table:
        """Return the table of the selected coordinates, or of all.

        By default it has the columns over the first dimension of `to_dataset`.
        """
        if coordinates is not None:
            raise InputError(f"coordinates: the table of a {self.kind} has no choice, must be None")
        data = self.to_dataset()
        over = next(iter(data.data_vars.values())).dims[0]
        table = Table()
        if over in data.coords:
            table.columns[str(over)] = data.coords[over].values
        for name, array in data.data_vars.items():
            if array.dims[:1] != (over,):
                continue
            if "units" in array.attrs:
                table.notes.append(f"{name} in {array.attrs['units']}")
            labels = [array.coords[d].values if d in array.coords else None for d in array.dims]
            for place in np.ndindex(array.shape[1:]):
                pairs = zip(place, labels[1:], strict=True)
                words = [str(i if label is None else label[i]) for i, label in pairs]
                table.add(" ".join([str(name), *words]).replace(" ", "_"), array.values[:, *place])
        return table

    def to_csv(
        self, path: str | os.PathLike[str], *, coordinates: Sequence[str] | None = None
    ) -> None:
        """Write the table of the driver.

        ``coordinates``: names of selected coordinates; by default all.
        """
        self._table(coordinates).write(path, str(getattr(self, "plan", "")))

    def to_netcdf(self, path: str | Path) -> None:
        """Write `to_dataset` into a netCDF file (version 3, by SciPy).

        The format has no complex numbers: each complex array becomes two, NAME_re and NAME_im.
        """
        data = self.to_dataset()
        parts: dict[str, Any] = {}
        for name, array in data.data_vars.items():
            if np.iscomplexobj(array):
                parts |= {f"{name}_re": array.real, f"{name}_im": array.imag}
            else:
                parts[f"{name}"] = array.astype("int8") if array.dtype == bool else array
        content = as_dataset(parts, data.coords, data.attrs).to_netcdf(engine="scipy")
        with whole_file(path, "wb") as file:
            file.write(bytes(content))  # type: ignore[arg-type]

    def __repr__(self) -> str:
        """Return a description in a few lines."""
        return f"<{type(self).__name__}: " + "\n  ".join([self._headline(), *self._scope()]) + ">"

    def _repr_html_(self) -> str:
        """Return the description with a small picture, for notebooks."""
        from html import escape

        text = f"<pre>{escape(repr(self))}</pre>"
        try:
            picture = io.StringIO()
            _pictures().save_picture(self, picture, small=True)
        except InputError:
            # A result without a plot is described as text.
            return text
        return f"{text}{picture.getvalue()[picture.getvalue().index('<svg') :]}"


def as_dataset(
    data: Mapping[str, Any], coords: Mapping[Any, Any] | None = None,
    attrs: Mapping[Any, Any] | None = None,
) -> Dataset:  # fmt: skip
    """Return data as an xarray Dataset; the arguments are those of its constructor."""
    import xarray as xr

    return xr.Dataset(data, coords, attrs)


def span(values: FloatArray, unit: str = "") -> str:
    """Return the ends of a range as text with the unit."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return "nowhere"
    low, high = finite.min(), finite.max()
    ends = f"{low:.6g}" if low == high else f"{low:.6g} to {high:.6g}"
    return f"{ends} {unit}".rstrip()


def named(names: tuple[str, ...], units: tuple[str, ...]) -> str:
    """Return coordinates with their units as text; only the first six of many."""
    pairs = [f"{n} ({u})" if u != "1" else n for n, u in zip(names, units, strict=True)]
    more = [f"{len(pairs) - 6} more"] if len(pairs) > 6 else []
    return ", ".join([*pairs[:6], *more])


def _pictures() -> Any:
    """Return the module of pictures, which is loaded at the first drawing."""
    return import_module("viscovib.plots.pictures")
