"""Pictures: every curve is told apart by line style as well as by colour."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from viscovib.errors import InputError
from viscovib.files import whole_file
from viscovib.response import Response

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Dark to light, so that order survives a greyscale print.
COLOURS = ("#0b1d51", "#7b1e7a", "#c8452e", "#e08e1b", "#b9b21a")
STYLES = ("-", (0, (6, 1.5)), (0, (4, 1.2, 1, 1.2)), (0, (2, 1)), (0, (1, 1)))

_SYMBOLS = {"x": "x", "phi": r"\varphi"}


def plot_response(
    response: Response | Sequence[Response],
    ax: "Axes | Sequence[Axes] | None" = None,
    *,
    labels: Sequence[str] | None = None,
    harmonic: int = 1,
    log: bool = True,
) -> "Sequence[Axes]":
    """Draw amplitude against frequency, one panel a coordinate.

    Parameters
    ----------
    response : Response or sequence of them
        Curves; gaps show where no solution was found.
    ax : Axes or sequence of Axes, optional
        Where to draw: as many as there are coordinates; None makes a figure.
    labels : sequence of str, optional
        A legend entry a curve.
    harmonic : int
        Order to draw.
    log : bool
        Logarithmic amplitudes.

    Returns
    -------
    sequence of Axes, one a coordinate.
    """
    import matplotlib.pyplot as plt

    curves = [response] if isinstance(response, Response) else list(response)
    if not curves:
        raise InputError("response: must not be empty")
    names = curves[0].dof_names
    if ax is None:
        import matplotlib.pyplot as plt

        figure = plt.figure(figsize=(7, 3 * len(names)), layout="constrained")
        ax = figure.subplots(len(names), 1, sharex=True)
    axes = list(np.atleast_1d(np.asarray(ax, dtype=object)))
    if len(axes) != len(names):
        raise InputError(f"ax: {len(axes)} axes given, must be {len(names)}, one a coordinate")
    for axis, name, unit in zip(axes, names, curves[0].dof_units, strict=True):
        for i, curve in enumerate(curves):
            axis.plot(
                curve.nu,
                curve.amplitude(name, harmonic),
                color=COLOURS[i % len(COLOURS)],
                linestyle=STYLES[i % len(STYLES)],
                linewidth=1.6,
                label=labels[i] if labels else None,
            )
        axis.set_ylabel(rf"amplitude $|{_SYMBOLS.get(name, name)}_{harmonic}|$ ({unit})")
        if log:
            axis.set_yscale("log")
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(color="0.9", linewidth=0.6)
        axis.set_axisbelow(True)
    axes[-1].set_xlabel(r"circular frequency of the load $\nu$ (rad/s)")
    if labels:
        axes[0].legend(frameon=False)
    return axes


def save_response(response: Response, path: str | os.PathLike[str]) -> None:
    """Draw a response into a file, without a display; harmonic 1, or the lowest there is."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    orders = response.harmonics[response.harmonics > 0]
    if not orders.size:
        raise InputError("response: holds a mean only, which has no amplitude curve")
    names = response.dof_names
    figure = Figure(figsize=(7, 3 * len(names)), layout="constrained")
    FigureCanvasAgg(figure)
    plot_response(response, figure.subplots(len(names), 1, sharex=True), harmonic=int(orders[0]))
    with whole_file(path, "wb") as file:
        figure.savefig(file, dpi=200, format=Path(path).suffix.lstrip(".") or "png")
