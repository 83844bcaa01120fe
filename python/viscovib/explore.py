"""The command ``viscovib explore``: a scene under one's hands.

With a display, a window: the curves of the scene, a slider for each of its numbers, and every
curve anew while a slider moves; the scene as it was stays in grey. Without one, a sheet: what each
number does when it is a quarter larger or smaller.
"""

import argparse
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from viscovib.errors import FileError, InputError, ViscovibError
from viscovib.files import whole_file
from viscovib.plots import _SYMBOLS, COLOURS, STYLES, _bare
from viscovib.results import Panel, Result
from viscovib.scene import Scene
from viscovib.scene_job import SceneResult, run_one
from viscovib.sweep_points import quiet
from viscovib.sweep_scene import summary

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Sliders at most, unless keys are named; a slider goes this many doublings each way.
_MOST, _DOUBLINGS = 12, 2.0
#: Seconds of computing from which a moving slider is waited for.
_SLOW = 0.05
#: Groups whose numbers say what the system is, not how it is computed.
_PHYSICS = ("mount", "kernel", "load", "pendulum", "transient")
_NOT_PHYSICS = ("t_end", "dt", "tolerance", "save_every", "order", "cubic_scale", "memory_scale")
#: How far the sheet moves each number.
_FACTOR = 1.25


def curves(result: SceneResult) -> list[Panel]:
    """One curve a coordinate."""
    if not isinstance(result.value, Result):
        raise InputError("explore: must be a single result, not a sweep")
    try:
        return result.value.panels()
    except InputError as error:
        raise InputError(f"explore: {error}") from None


def _label(panel: Panel) -> str:
    symbol = _SYMBOLS.get(panel.name, panel.name)
    if panel.order is None:
        return f"${symbol}$"
    return f"$|{symbol}_{{{panel.order}}}|$ ({panel.unit})"


def parameters(scene: Scene) -> dict[str, float]:
    """Numbers of a scene that a slider can move: real, not 0, of the system and its load."""
    found: dict[str, float] = {}
    for name in _PHYSICS:
        group = scene.groups.get(name, [])
        several = group if isinstance(group, list) else [group]
        for i, one in enumerate(several):
            place = f"{name}({i + 1})" if len(several) > 1 else name
            for key, value in one.items():
                if key in _NOT_PHYSICS:
                    continue
                if isinstance(value, float) and value != 0:
                    found[f"{place}.{key}"] = value
                elif key in ("initial", "damping"):
                    found |= {f"{place}.{key}({j + 1})": v for j, v in enumerate(value) if v != 0}
    return found


def _chosen(scene: Scene, keys: list[str] | None) -> dict[str, float]:
    known = parameters(scene)
    if keys is None:
        return dict(list(known.items())[:_MOST])
    for key in keys:
        if key not in known:
            raise InputError(f"--keys {key}: must be one of {', '.join(known)}")
    return {key: known[key] for key in keys}


class Explorer:
    """The window: curves, sliders, a line about peaks, and what went wrong if something did.

    Parameters
    ----------
    scene : Scene
    figure : matplotlib Figure
    keys : list of str, optional
        Which numbers get a slider.
    out : Path
        Where "save" writes the changed scene and the picture.
    """

    def __init__(
        self, scene: Scene, figure: "Figure", keys: list[str] | None = None, out: Path = Path("out")
    ) -> None:
        from matplotlib.widgets import Button, Slider

        self.scene, self.figure, self.out = scene.override({}), figure, out
        self.start = _chosen(self.scene, keys)
        self.changed: dict[str, float] = {}
        self.result, self.seconds = self._compute({})
        self._before = summary(self.result)
        self._timer: Any = None
        first = curves(self.result)
        n = len(self.start)
        grid = figure.add_gridspec(
            1, 2, width_ratios=[3, 1.3], left=0.08, right=0.95, bottom=0.09, top=0.9, wspace=0.45
        )
        left = grid[0].subgridspec(len(first), 1, hspace=0.12)
        self.axes = [figure.add_subplot(left[i]) for i in range(len(first))]
        self.lines = []
        for axis, curve in zip(self.axes, first, strict=True):
            axis.plot(curve.x, curve.y, color="0.75", linewidth=3, label="as it was")
            self.lines += axis.plot(curve.x, curve.y, color=COLOURS[0], linewidth=1.4, label="now")
            axis.set_ylabel(_label(curve))
            axis.set_yscale("log" if curve.log else "linear")
            axis.tick_params(labelbottom=axis is self.axes[-1])
            _bare(axis)
        self.axes[-1].set_xlabel(first[-1].x_label)
        self.axes[0].legend(frameon=False, loc="upper right")
        right = grid[1].subgridspec(max(n, 6) + 2, 1, hspace=0.6)
        self.sliders = {}
        for i, (key, value) in enumerate(self.start.items()):
            slider = Slider(
                figure.add_subplot(right[i]), key, -_DOUBLINGS, _DOUBLINGS, valinit=0.0,
                color=COLOURS[1],
            )  # fmt: skip
            slider.label.set_fontsize(8)
            slider.valtext.set_text(f"{value:.4g}")
            slider.on_changed(partial(self._moved, key))
            self.sliders[key] = slider
        self.buttons = {}
        for i, (name, action) in enumerate((("reset", self.reset), ("save", self.save))):
            button = Button(figure.add_subplot(right[-1 - i]), name)
            button.on_clicked(partial(_press, action))
            self.buttons[name] = button
        self.text = figure.text(0.08, 0.94, "", fontsize=9)
        self._say()

    def set(self, key: str, value: float) -> None:
        """Give a number a value; the window follows."""
        if key not in self.sliders:
            raise InputError(f"key = {key!r}: must be one of {', '.join(self.sliders)}")
        ratio = value / self.start[key]
        if not 2.0**-_DOUBLINGS <= ratio <= 2.0**_DOUBLINGS:
            raise InputError(f"{key} = {value:g}: must be within a factor 4 of {self.start[key]:g}")
        self.sliders[key].set_val(float(np.log2(ratio)))

    def reset(self) -> None:
        """Go back to the scene as it was."""
        for slider in self.sliders.values():
            slider.eventson = False
            slider.reset()
            slider.eventson = True
        for key, value in self.start.items():
            self.sliders[key].valtext.set_text(f"{value:.4g}")
        self.changed = {}
        self.update()

    def save(self) -> None:
        """Write the scene as it is now, and the picture of it."""
        stem = self.out / f"{self.scene.path.stem}_explored"
        try:
            self.out.mkdir(parents=True, exist_ok=True)
            with whole_file(stem.with_suffix(".nml")) as file:
                file.write(self.scene.override(self.changed).canonical)
            with whole_file(stem.with_suffix(".png"), "wb") as picture:
                self.figure.savefig(picture, dpi=150, format="png")
            self._say(f"saved {stem}.nml and .png")
        except (ViscovibError, OSError) as error:
            self._say(str(error), wrong=True)

    def update(self) -> None:
        """Compute the scene as the sliders stand, and draw it."""
        try:
            self.result, self.seconds = self._compute(self.changed)
        except ViscovibError as error:
            self._say(str(error), wrong=True)
            return
        for line, axis, curve in zip(self.lines, self.axes, curves(self.result), strict=True):
            line.set_data(curve.x, curve.y)
            axis.relim()
            axis.autoscale_view()
        self._say()

    def _moved(self, key: str, place: float) -> None:
        value = float(f"{self.start[key] * 2.0**place:.6g}")
        self.sliders[key].valtext.set_text(f"{value:.4g}")
        self.changed[key] = value
        if self.seconds < _SLOW:
            self.update()
            return
        # Long work waits until the hand rests.
        if self._timer is not None:
            self._timer.stop()
        self._timer = self.figure.canvas.new_timer(interval=150, callbacks=[(self.update, (), {})])
        self._timer.single_shot = True
        self._timer.start()

    def _compute(self, changed: dict[str, float]) -> tuple[SceneResult, float]:
        begun = time.perf_counter()
        with warnings.catch_warnings():
            quiet()
            result = run_one(self.scene.override(changed))
        return result, time.perf_counter() - begun

    def _say(self, message: str = "", *, wrong: bool = False) -> None:
        self.text.set(text=message or self._about(), color=COLOURS[2] if wrong else "0.2")
        self.figure.canvas.draw_idle()

    def _about(self) -> str:
        """Peaks, how they changed, and what it took."""
        now, parts = summary(self.result), []
        for key, value in now.items():
            if isinstance(value, str) or key.startswith("nu_"):
                continue
            before, text = self._before[key], f"{key} {value:.4g}"
            if f"nu_{key}" in now:
                text += f" at {now[f'nu_{key}']:.4g}"
            if before and np.isfinite(value / before) and value != before:
                text += f" ({100 * (value / before - 1):+.1f} %)"
            if value or before:
                parts.append(text)
        return f"{'   '.join(parts)}   [{1e3 * self.seconds:.1f} ms]"


def _press(action: Callable[[], None], _: object) -> None:
    action()


def save_sheet(scene: Scene, path: Path, keys: list[str] | None = None) -> None:
    """Draw what each number does: a row of panels a number, at 0.8, 1 and 1.25 times its value."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    one = scene.override({})
    start = _chosen(one, keys)
    with warnings.catch_warnings():
        quiet()
        middle = curves(run_one(one))
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
                        else curves(run_one(one.override({key: value * factor})))
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
                axis.set_yscale("log" if curve.log else "linear")
                _bare(axis)
            row[0].legend(
                frameon=False, fontsize=7, loc="lower left", bbox_to_anchor=(0, 1), ncols=3
            )
    for axis, curve in zip(axes[-1], middle, strict=True):
        axis.set_xlabel(curve.x_label)
    with whole_file(path, "wb") as file:
        figure.savefig(file, dpi=120, format="png")


def add_options(command: argparse.ArgumentParser) -> None:
    """Options of the command."""
    command.add_argument(
        "--keys", metavar="KEY,KEY", help="numbers that get a slider, as mount.stiffness_x"
    )
    command.add_argument("--sheet", action="store_true", help="the picture even with a display")


def run_explore(options: argparse.Namespace) -> int:
    """Open the window, or save the sheet where there is no display; the exit status."""
    scene = Scene.read(options.scene, allow_paths=options.allow_paths)
    keys = options.keys.split(",") if options.keys else None
    if not options.sheet and _has_display():
        import matplotlib.pyplot as plt

        figure = plt.figure(f"viscovib: {options.scene}", figsize=(12, 7))
        explorer = Explorer(scene, figure, keys, options.out)
        plt.show()
        if not options.quiet:
            print(*(f"{key} = {value:.6g}" for key, value in explorer.changed.items()), sep="\n")
        return 0
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{options.out}: cannot be made a folder ({error.strerror})") from None
    path = options.out / f"{options.scene.stem}_explore.png"
    save_sheet(scene, path, keys)
    if not options.quiet:
        print(f"{path}: no display, so a sheet of what each number does" if not options.sheet
              else f"{path}")  # fmt: skip
    return 0


def _has_display() -> bool:
    """Whether matplotlib can open windows here."""
    import matplotlib.pyplot as plt

    try:
        figure = plt.figure()
    except ImportError:
        return False
    shown = getattr(figure.canvas, "required_interactive_framework", None) is not None
    plt.close(figure)
    return shown
