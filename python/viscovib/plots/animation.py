"""Animations of motions: GIF, MP4 or a self-contained HTML page."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.files import whole_file
from viscovib.common.parameters import FilePath, Number, Whole
from viscovib.common.results import Figure
from viscovib.errors import InputError
from viscovib.plots.outlines import Drawing, drawing_of
from viscovib.plots.style import COLOURS, in_brackets, plain

if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation

_FRAMES, _RATE = Whole("frames", 2, 5000), Number("fps", lowest=1e-3, highest=200)
#: Number of frames of one period, and largest number of a motion in time.
_OF_PERIOD, _OF_MOTION = 60, 400
_SUFFIXES = (".gif", ".html", ".mp4")


def animate(
    motion: Any,
    path: str | os.PathLike[str] | None = None,
    *,
    point: int | None = None,
    system: Any = None,
    frames: int | None = None,
    fps: float = 30.0,
) -> FuncAnimation:
    """Animate a motion: the body, and its coordinates over time.

    A mount is a block on its spring, a pendulum hangs on its spring. For other systems every
    coordinate has a row. Very small motions are drawn enlarged; the title states the factor.

    Parameters
    ----------
    motion : Trajectory, Response, Branch, Backbone, DrivenResponse or DrivenBranch
        A motion in time, or a set of periodic motions of which one is shown.
    path : path, optional
        File to write: ``.gif``, ``.html`` (with buttons, self-contained) or ``.mp4`` (requires the
        program ffmpeg). None: not written.
    point : int, optional
        Index of one of several motions; by default the one with the largest first coordinate.
    system : Mount or Pendulum, optional
        For lengths if the result does not contain its system.
    frames : int, optional
        Number of pictures: by default 60 per period, or up to 400 of the last states of a motion in
        time.
    fps : float
        Pictures per second, 0.001 to 200.

    Returns
    -------
    matplotlib.animation.FuncAnimation
        In a notebook use ``HTML(animation.to_jshtml())``.

    Raises
    ------
    InputError
        If the motion does not exist or the file type is not supported.

    Examples
    --------
    >>> import viscovib as vv
    >>> mount = vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2,
    ...                  damping=[[0.2, -0.1], [-0.1, 0.09]])
    >>> branch = vv.trace_response(mount, (0.5, 6), load=0.5)
    >>> moving = vv.animate(branch, "jump.gif", point=40, frames=8)

    See Also
    --------
    plot_trajectory, explore
    """
    rate = _RATE.check(fps)
    count = None if frames is None else _FRAMES.check(frames)
    target = None if path is None else checked_path(path)
    t, coordinates, names, units, about = _motion(motion, point, count)
    known = system if system is not None else getattr(motion, "system", None)
    drawing = drawing_of(coordinates, names, units, known)
    made = _animation(drawing, t, coordinates, names, units, about, rate)
    if target is not None:
        write_film(made, target, rate)
    return made


def checked_path(path: str | os.PathLike[str]) -> Path:
    """Return the path after a check that its file type can be written."""
    target = Path(FilePath("path").check(path))
    if target.suffix.lower() not in _SUFFIXES:
        raise InputError(f"path = {str(target)!r}: must end in {', '.join(_SUFFIXES)}")
    if target.suffix.lower() == ".mp4" and shutil.which("ffmpeg") is None:
        raise InputError(
            f"path = {str(target)!r}: MP4 needs the program ffmpeg, which is not installed; "
            "use .gif or .html"
        )
    return target


def _motion(
    motion: Any, point: int | None, count: int | None
) -> tuple[FloatArray, FloatArray, Sequence[str], Sequence[str], str]:
    """Return times, coordinates (n, n_dof), their names and units, and a description."""
    if getattr(motion, "_form", None) == "trajectory":
        if point is not None:
            raise InputError("point: a motion in time is one motion, leave it out")
        if motion.t.size < 2:
            raise InputError(f"motion: has {motion.t.size} states, must have 2 at least")
        late = slice(max(0, motion.t.size - (count or _OF_MOTION)), None)
        return (
            motion.t[late],
            motion.state[late, ::2],
            motion.dof_names,
            motion.system.dof_units,
            "",
        )
    if not hasattr(motion, "waveform"):
        raise InputError(
            f"motion = {_native.shown(motion)}: must be a Trajectory, or a response, branch or "
            "backbone"
        )
    row: Any = motion
    n = len(row.coefficients)
    if point is None:
        sizes = np.abs(row.coefficients[:, 0]).max(axis=-1, initial=0.0)
        if not np.isfinite(sizes).any():
            raise InputError("motion: contains no solution")
        chosen = int(np.nanargmax(sizes))
    else:
        chosen = _native.integer("point", point, -n, n - 1) % n
    t, coordinates = row.waveform(chosen, count or _OF_PERIOD)
    if not np.isfinite(coordinates).all():
        raise InputError(f"point = {chosen}: no motion was found there")
    place = float(np.ravel(row.nu)[chosen])
    units = row.dof_units
    in_seconds = "m" in units
    return t, coordinates, row.dof_names, units, f"{place:.5g} {'rad/s' if in_seconds else ''}"


def _animation(
    drawing: Drawing,
    t: FloatArray,
    coordinates: FloatArray,
    names: Sequence[str],
    units: Sequence[str],
    about: str,
    rate: float,
) -> FuncAnimation:
    from matplotlib.animation import FuncAnimation

    figure, (scene, history) = _figure()
    shapes = []
    for one in drawing.outlines:
        if one.kind == "body":
            (shape,) = scene.fill(one.x[0], one.y[0], facecolor="#c9d3ea", edgecolor=COLOURS[0])
        else:
            (shape,) = scene.plot(one.x[0], one.y[0], color="0.35", linewidth=1.3)
        shapes.append(shape)
    left, right, low, high = drawing.limits()
    for name, height in drawing.names:
        scene.text(left, height, plain(name), ha="right", va="center")
    scene.set(xlim=(left, right), ylim=(low, high), aspect="equal")
    scene.axis("off")
    parts = [rf"$\nu$ = {about}".rstrip()] if about else []
    if drawing.factor != 1:
        parts.append(f"drawn {drawing.factor:g} times as large")
    scene.set_title(", ".join(parts), fontsize=10)
    moving = np.abs(coordinates).max(axis=0)
    largest = moving.max() or 1.0
    for d in np.argsort(-moving)[:5]:
        history.plot(
            t, coordinates[:, d], label=plain(names[d]) + in_brackets(units[d]),
            color=COLOURS[d % len(COLOURS)], linestyle=("-", "--", "-.", ":")[d % 4],
        )  # fmt: skip
    now = history.axvline(t[0], color="0.5", linewidth=1)
    history.set(xlabel="t (s)" if "m" in units else "time", ylim=(-1.08 * largest, 1.08 * largest))
    history.spines[["top", "right"]].set_visible(False)
    history.legend(frameon=False, loc="lower left", bbox_to_anchor=(0, 1), ncols=5)

    # Compute the layout once: repeating it for each frame would take most of the time.
    figure.canvas.draw()
    figure.set_layout_engine("none")

    def show(frame: int) -> list[Any]:
        for shape, one in zip(shapes, drawing.outlines, strict=True):
            if one.kind == "body":
                shape.set_xy(np.column_stack([one.x[frame], one.y[frame]]))
            else:
                shape.set_data(one.x[frame], one.y[frame])
        now.set_xdata([t[frame], t[frame]])
        return [*shapes, now]

    made = FuncAnimation(figure, show, frames=len(t), interval=1000 / rate, blit=False)
    # Suppress the warning about an animation that was not drawn: it may only be saved.
    made._draw_was_started = True  # type: ignore[attr-defined]
    return made


def _figure() -> tuple[Figure, Any]:
    """Return a figure without a window, and its axes for the body and the history."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 5.6), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(2, 1, height_ratios=[2, 1])


def write_film(made: FuncAnimation, path: Path, rate: float) -> None:
    """Write an animation; after an error no incomplete file remains."""
    from matplotlib.animation import PillowWriter

    # Matplotlib would draw each frame twice: before and while it is written.
    made._fig.canvas.draw_idle = lambda: None  # type: ignore[attr-defined]
    if path.suffix.lower() == ".html":
        with whole_file(path) as file:
            page = made.to_jshtml(fps=max(1, round(rate)))
            file.write(f"<!DOCTYPE html><meta charset='utf-8'><title>motion</title>{page}")
        return
    # ffmpeg and Pillow would follow a link with the name of the file.
    with whole_file(path, "wb") as target, TemporaryDirectory() as folder:
        part = Path(folder) / f"film{path.suffix}"
        # Pillow rounds the duration of a frame to hundredths of a second.
        film = path.suffix.lower() == ".mp4"
        made.save(part, writer="ffmpeg" if film else PillowWriter(max(1, round(rate))), dpi=90)
        with part.open("rb") as written:
            shutil.copyfileobj(written, target)  # type: ignore[misc]
