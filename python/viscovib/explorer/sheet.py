"""A sheet of paper instead of the page: what each number of a scene does, as one picture."""

import warnings
from collections.abc import Sequence
from pathlib import Path

from viscovib.common.files import whole_file
from viscovib.common.results import Panel
from viscovib.errors import InputError, ViscovibError
from viscovib.explorer.numbers import chosen
from viscovib.plots.axes import logarithmic
from viscovib.plots.style import COLOURS, STYLES, SYMBOLS, bare
from viscovib.scene.job import SceneResult, run_one
from viscovib.scene.scene import Scene
from viscovib.sweeps.points import quiet

#: Numbers shown at most, and how far each is moved.
_MOST, _FACTOR = 12, 1.25


def _curves(result: SceneResult) -> list[Panel]:
    try:
        return result.value.panels()
    except InputError as error:
        raise InputError(f"explore: {error}") from None


def _label(panel: Panel) -> str:
    symbol = SYMBOLS.get(panel.name, panel.name)
    if panel.order is None:
        return f"${symbol}$"
    return f"$|{symbol}_{{{panel.order}}}|$ ({panel.unit})"


def save_sheet(scene: Scene, path: Path, keys: Sequence[str] | None = None) -> None:
    """Draw what each number does: a row of panels a number, at 0.8, 1 and 1.25 times its value."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    one = scene.override({})
    start = {key: number.value for key, number in chosen(one, keys).items() if number.value}
    start = dict(list(start.items())[:_MOST])
    with warnings.catch_warnings():
        quiet()
        middle = _curves(run_one(one))
        n = len(middle)
        figure = Figure(figsize=(4.2 * n, 1.9 * len(start) + 0.6), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(len(start), n, sharex=True, squeeze=False)
        for row, (key, value) in zip(axes, start.items(), strict=True):
            for factor, colour, style in (
                (1 / _FACTOR, COLOURS[3], STYLES[1]),
                (1.0, "0.3", "-"),
                (_FACTOR, COLOURS[0], STYLES[3]),
            ):
                try:
                    found = (
                        middle
                        if factor == 1
                        else _curves(run_one(one.override({key: value * factor})))
                    )
                except ViscovibError:
                    # Out of range on this side: the others show.
                    continue
                for axis, curve in zip(row, found, strict=True):
                    label = f"{key} = {value * factor:.4g}"
                    axis.plot(
                        curve.x, curve.y, color=colour, linestyle=style, linewidth=1.1, label=label
                    )
            for axis, curve in zip(row, middle, strict=True):
                axis.set_ylabel(_label(curve))
                if curve.log:
                    logarithmic(axis)
                bare(axis)
            row[0].legend(
                frameon=False, fontsize=7, loc="lower left", bbox_to_anchor=(0, 1), ncols=3
            )
    for axis, curve in zip(axes[-1], middle, strict=True):
        axis.set_xlabel(curve.x_label)
    with whole_file(path, "wb") as file:
        figure.savefig(file, dpi=120, format="png")
