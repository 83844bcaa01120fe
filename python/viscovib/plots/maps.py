"""Plots of sweeps: a quantity over one or two parameters."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from viscovib import _native
from viscovib.common.files import whole_file
from viscovib.common.parameters import Flag, Optional, Text, checked
from viscovib.common.results import Axes
from viscovib.errors import InputError
from viscovib.plots.panels import panel
from viscovib.plots.style import COLOURS, bare, plain

if TYPE_CHECKING:
    import xarray as xr

_LOOKS = (Flag("log"), Optional.or_none(Text("label")))
#: Largest number of integer values that have one colour each.
_MOST_CLASSES = 8
#: Largest value for which axes and colours can be computed.
_LARGEST_DRAWN = 1e300


def plot_map(
    data: xr.Dataset | xr.DataArray,
    name: str | None = None,
    ax: Axes | None = None,
    *,
    log: bool = False,
    label: str | None = None,
) -> Axes:
    """Draw a quantity over its parameters: a curve over one, a map over two.

    Integers with few values, such as attractors, get one colour each. Points without a value are
    grey.

    Parameters
    ----------
    data : Dataset or DataArray
        From `sweep`, over one or two parameters; remove others with ``sel`` or ``isel``.
    name : str, optional
        The variable of a Dataset; optional for a single variable.
    ax : Axes, optional
    log : bool
        Logarithmic values.
    label : str, optional
        Label of the quantity; default: its name and units.

    Examples
    --------
    >>> import viscovib as vv
    >>> data = vv.sweep(
    ...     lambda a, b: {"y": a * b},
    ...     {"a": [1.0, 2.0, 3.0], "b": [1.0, 2.0]},
    ...     progress=False,
    ... )
    >>> ax = vv.plot_map(data, "y")
    """
    import xarray as xr

    checked(_LOOKS, locals())
    array = _array(data, name)
    if array.ndim not in (1, 2) or not all(array.shape):
        raise InputError(
            f"data: {array.name!r} has dimensions {array.dims}, must be one or two: select "
            "values by isel or sel"
        )
    if array.dtype.kind not in "biuf":
        raise InputError(f"data: {array.name!r} must be real numbers to be drawn")
    ax = panel(ax)
    shown = label or _called(array)
    axes = [array[d] if d in array.coords else xr.DataArray(np.arange(n), name=str(d))
            for d, n in zip(array.dims, array.shape, strict=True)]  # fmt: skip
    if array.ndim == 1:
        ax.plot(axes[0].values, array.values, color=COLOURS[0], linewidth=1.4, label=label)
        ax.set(xlabel=_called(axes[0]), ylabel=shown)
        if log:
            ax.set_yscale("log")
        bare(ax)
        return ax
    values = array.values.astype(float)
    if np.abs(values[np.isfinite(values)]).max(initial=0.0) > _LARGEST_DRAWN:
        raise InputError(f"data: contains values beyond {_LARGEST_DRAWN:g}, which cannot be drawn")
    _draw_map(ax, axes, values, log, shown)
    return ax


def _array(data: Any, name: str | None) -> xr.DataArray:
    import xarray as xr

    if isinstance(data, xr.DataArray):
        return data
    if not isinstance(data, xr.Dataset):
        raise InputError(f"data = {type(data).__name__}: must be a Dataset or DataArray")
    names = [str(key) for key in data.data_vars]
    if name is None and len(names) == 1:
        name = names[0]
    return data[_native.choice("name", name, tuple(names))]


def _called(array: xr.DataArray) -> str:
    units = array.attrs.get("units")
    return plain(f"{array.name} ({units})" if units else f"{array.name}")


def _draw_map(ax: Axes, axes: list[Any], values: Any, log: bool, label: str) -> None:
    from matplotlib.colors import BoundaryNorm, ListedColormap, LogNorm

    places, words = [], []
    for axis in axes:
        numbers = axis.values.dtype.kind in "biuf"
        places.append(axis.values if numbers else np.arange(axis.size))
        words.append(None if numbers else [str(v) for v in axis.values])
    finite = values[np.isfinite(values)]
    kinds = np.unique(finite) if finite.size else np.zeros(1)
    classes = kinds.size <= _MOST_CLASSES and (kinds == np.round(kinds)).all() and not log
    options: dict[str, Any] = {"cmap": "viridis_r"}
    if classes:
        edges = np.r_[kinds[0] - 0.5, 0.5 * (kinds[1:] + kinds[:-1]), kinds[-1] + 0.5]
        palette = [*COLOURS, "#4f9d8f", "#8fb8de", "#d9c3e8"][: kinds.size]
        options = {"cmap": ListedColormap(palette), "norm": BoundaryNorm(edges, kinds.size)}
    elif log:
        options["norm"] = LogNorm()
    ax.set_facecolor("0.8")
    mesh = ax.pcolormesh(
        places[1], places[0], np.ma.masked_invalid(values), shading="nearest", rasterized=True,
        **options,
    )  # fmt: skip
    bar = ax.figure.colorbar(mesh, ax=ax, label=label)
    if classes:
        # Ticks in the middle of each colour, even if integers between them are missing.
        bar.set_ticks(list(0.5 * edges[1:] + 0.5 * edges[:-1]), labels=[f"{k:g}" for k in kinds])
    for text, place, set_ticks in (
        (words[1], places[1], ax.set_xticks),
        (words[0], places[0], ax.set_yticks),
    ):
        if text is not None:
            set_ticks(place, labels=text)
    ax.set(xlabel=_called(axes[1]), ylabel=_called(axes[0]))


def save_map(data: xr.Dataset, path: str | os.PathLike[str]) -> str:
    """Draw the result of a sweep of a scene without a display, one panel per quantity.

    Return a line about omitted parts, or an empty one.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    names = [
        str(name)
        for name, item in data.data_vars.items()
        if item.dtype.kind == "f" and np.isfinite(item.values).any()
    ]
    # A constant quantity needs no picture.
    names = [n for n in names if np.nanmin(data[n]) < np.nanmax(data[n])] or names[:1]  # fmt: skip
    if not names:
        return "no picture: the result has no finite values"
    dims = [str(d) for d in data[names[0]].dims]
    # Parameters with one value need no axis; from the third on, parameters keep their first value.
    wide = [d for d in dims if data.sizes[d] > 1][:2] or dims[:1]
    selected = {d: 0 for d in dims if d not in wide}
    columns = min(2, len(names))
    rows = -(-len(names) // columns)
    figure = Figure(figsize=(5.5 * columns, 3.6 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    axes = np.atleast_1d(figure.subplots(rows, columns, squeeze=False)).ravel()
    for axis, name in zip(axes, names, strict=False):
        plot_map(data[name].isel(selected), ax=axis)
    for axis in axes[len(names) :]:
        axis.remove()
    with whole_file(path, "wb") as file:
        figure.savefig(file, dpi=150, format=Path(path).suffix.lstrip(".") or "png")
    fixed = [f"{d} = {data[d].values[0]}" for d in selected if data.sizes[d] > 1]
    return f"the picture shows {', '.join(fixed)} only" if fixed else ""
