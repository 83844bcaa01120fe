"""Animation of a mode of a body in space."""

from __future__ import annotations

import math
import os
from typing import TYPE_CHECKING, Any

import numpy as np

from viscovib import _native
from viscovib.bodies.body import Body
from viscovib.common.parameters import Number, Whole
from viscovib.plots.animation import checked_path, write_film
from viscovib.plots.bodies import EDGES, SWING, box_of, main_coordinate, moved_by, plot_body
from viscovib.plots.style import COLOURS

if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation

_FRAMES, _RATE = Whole("frames", 2, 5000), Number("fps", above=0, highest=200)


def film_of_mode(
    body: Body,
    mode: int,
    path: str | os.PathLike[str] | None,
    frames: int,
    fps: float,
) -> FuncAnimation:
    """Animate a mode: the body is a box, its mounts are lines between the box and the ground."""
    from matplotlib.animation import FuncAnimation
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    target = None if path is None else checked_path(path)
    count, rate = _FRAMES.check(frames), _RATE.check(fps)
    modes = body.modes()
    number = _native.integer("mode", mode, 1, modes.omega.size)
    figure = Figure(figsize=(6, 5), layout="constrained")
    FigureCanvasAgg(figure)
    axis: Any = plot_body(body, figure.add_subplot(projection="3d"))
    corners = box_of(body) + body.center
    feet = np.array([np.asarray(mount.position) for mount in body.mounts])
    size = float(np.ptp(np.vstack([feet, corners]), axis=0).max())
    shape = modes.shapes[:6, number - 1]
    largest = np.abs(moved_by(corners, body.center, shape.real) - corners).max()
    swing = SWING * size / max(largest, 1e-300)
    title = f"mode {number}: {modes.hz[number - 1]:.4g} Hz"
    share = modes.decoupling[number - 1]
    axis.set_title(f"{title}, {share:.0f} % {main_coordinate(modes, number)}")
    edges = [axis.plot([], [], [], color=COLOURS[2], linewidth=2)[0] for _ in EDGES]
    links = [axis.plot([], [], [], color=COLOURS[3], linewidth=1)[0] for _ in feet]
    for limits, at in ((axis.set_xlim, 0), (axis.set_ylim, 1), (axis.set_zlim, 2)):
        both = np.vstack([feet, corners])[:, at]
        limits(both.min() - SWING * size, both.max() + SWING * size)
    axis.set_aspect("equal")

    def show(frame: int) -> list[Any]:
        angle = 2 * math.pi * frame / count
        now = swing * (math.sin(angle) * shape.real + math.cos(angle) * shape.imag)
        box = moved_by(corners, body.center, now)
        ends = moved_by(feet, body.center, now)
        for line, (a, b) in zip(edges, EDGES, strict=True):
            line.set_data_3d(*box[[a, b]].T)
        for line, foot, end in zip(links, feet, ends, strict=True):
            line.set_data_3d(*np.array([foot, end]).T)
        return [*edges, *links]

    made = FuncAnimation(figure, show, frames=count, interval=1000 / rate, blit=False)
    # Suppress the warning about an animation that was not drawn: it may only be saved.
    made._draw_was_started = True  # type: ignore[attr-defined]
    if target is not None:
        write_film(made, target, rate)
    return made
