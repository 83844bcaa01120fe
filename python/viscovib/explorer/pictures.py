"""Figures of the explorer page: a curve for each coordinate, and the motion at a point."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from bokeh.events import Tap
from bokeh.models import ColumnDataSource, Range1d, Span
from bokeh.plotting import figure

from viscovib._native import FloatArray
from viscovib.explorer.drawn import STABLE, UNKNOWN, UNSTABLE, Curve, Motion
from viscovib.plots.axes import torn

#: Dark and solid, lighter and dashed, grey and dotted: distinguishable without colour.
_LINES: dict[int, tuple[str, dict[str, Any]]] = {
    STABLE: ("stable", {"color": "#0b1d51", "line_width": 2.2}),
    UNSTABLE: ("unstable", {"color": "#c8452e", "line_width": 1.8, "line_dash": [7, 4]}),
    UNKNOWN: ("stability unknown", {"color": "#666666", "line_width": 1.8, "line_dash": [2, 3]}),
}
_MARKS = {
    "fold": "circle",
    "branch point": "square",
    "symmetry breaking": "triangle",
    "period doubling": "diamond",
    "Neimark-Sacker": "inverted_triangle",
}
_FROZEN, _MEASURED = "#9a9a9a", "#1b7f4d"
_INK = "#222222"
#: Width and height of the figure of the motion (pixels), narrow enough for a telephone.
_WIDE, _HIGH = 330, 210
#: Decibels of amplitudes refer to 1 in their unit.
SCALES = ("linear", "logarithmic", "decibels")
FREQUENCIES = ("rad/s", "Hz")

#: x and y of additional curves, by coordinate.
Neighbour = Mapping[str, tuple[FloatArray, FloatArray]]


class CurvePicture:
    """The figure of one coordinate."""

    def __init__(
        self,
        curve: Curve,
        scale: str,
        frequency: str,
        high: int,
        on_tap: Callable[[int], None],
    ) -> None:
        self._scale, self._frequency = scale, frequency
        self._curve, self._on_tap = curve, on_tap
        label = curve.label
        if scale == "decibels":
            label += ", in dB"
        x_label = curve.x_label
        if self._in_hertz:
            x_label = x_label.replace("circular frequency", "frequency")
            x_label = x_label.replace(
                "ν (rad/s)", "(Hz)" if "freq" in x_label else "frequency (Hz)"
            )
        self.figure = figure(
            height=high, sizing_mode="stretch_width", x_axis_label=x_label, y_axis_label=label,
            y_axis_type="log" if scale == "logarithmic" else "linear",
            tools="pan,box_zoom,wheel_zoom,reset,hover",
            toolbar_location="right",
            tooltips=[(x_label, "@x{0.00000}"), (label, "@y{0.00000}")],
            output_backend="canvas",
        )  # fmt: skip
        self.figure.toolbar.logo = None
        _plain(self.figure)
        self._at = Span(dimension="height", line_color="#777777", line_dash=[1, 2], visible=False)
        self.figure.add_layout(self._at)
        names = ("frozen", "measured", *(name for name, _ in _LINES.values()), *_MARKS)
        self.sources = {
            name: ColumnDataSource({"x": [], "y": []}, name=f"{curve.name}: {name}")
            for name in names
        }
        self.figure.line("x", "y", source=self.sources["frozen"], color=_FROZEN, line_width=4,
                         alpha=0.7)  # fmt: skip
        self.figure.scatter("x", "y", source=self.sources["measured"], marker="x", size=7,
                            color=_MEASURED, line_width=1.4)  # fmt: skip
        for name, style in _LINES.values():
            source = self.sources[name]
            if curve.points:
                marker = "x" if name == "unstable" else "circle"
                self.figure.scatter("x", "y", source=source, marker=marker, size=5,
                                    color=style["color"])  # fmt: skip
            else:
                self.figure.line("x", "y", source=source, **style)
        for kind, marker in _MARKS.items():
            self.figure.scatter("x", "y", source=self.sources[kind], marker=marker, size=8,
                                fill_color="white", line_color="black", line_width=1.4)  # fmt: skip
        self.figure.on_event(Tap, self._tapped)
        self.draw(curve)

    @property
    def _in_hertz(self) -> bool:
        return self._frequency == "Hz" and self._curve.in_radians_per_second

    def draw(self, curve: Curve) -> None:
        """Show a curve of the same coordinate."""
        self._curve = curve
        for stability, (name, _) in _LINES.items():
            columns = curve.x, curve.part(stability)
            self._put(name, *(columns if curve.jumps is None else torn(curve.jumps, *columns)))
        for kind in _MARKS:
            self._put(kind, *curve.marks.get(kind, (np.empty(0), np.empty(0))))

    def overlay(self, name: str, curve: tuple[FloatArray, FloatArray] | None) -> None:
        """Show a frozen or measured curve; None removes it."""
        self._put(name, *(curve or (np.empty(0), np.empty(0))))

    def mark(self, point: int | None) -> None:
        """Mark the point of the animated motion with a vertical line."""
        self._at.visible = point is not None
        if point is not None and self._curve.x.size:
            x = self._curve.x[min(point, self._curve.x.size - 1)]
            self._at.location = float(self._shown_x(x))

    def _put(self, name: str, x: FloatArray, y: FloatArray) -> None:
        source = self.sources[name]
        if not len(x) and not len(source.data["x"]):
            return
        source.data = {"x": np.asarray(self._shown_x(x)), "y": self._shown_y(np.asarray(y))}

    def _shown_x(self, x: Any) -> Any:
        return x / (2 * math.pi) if self._in_hertz else x

    def _shown_y(self, y: FloatArray) -> FloatArray:
        if self._scale == "linear":
            return y
        # There is no logarithm of 0 or of negative values.
        positive = np.where(y > 0, y, np.nan)
        return 20 * np.log10(positive) if self._scale == "decibels" else positive

    def _tapped(self, event: Any) -> None:
        """Choose the point nearest to the touched place on the screen."""
        x = np.asarray(self._shown_x(self._curve.x), dtype=float)
        y = self._shown_y(self._curve.y)
        place = float(event.y)
        if self._scale == "logarithmic":
            y = np.log(y)
            place = math.log(place) if place > 0 else math.nan
        spans = [np.nanmax(v) - np.nanmin(v) if np.isfinite(v).any() else 1.0 for v in (x, y)]
        far = np.hypot((x - event.x) / (spans[0] or 1.0), (y - place) / (spans[1] or 1.0))
        if np.isfinite(far).any():
            self._on_tap(int(np.nanargmin(far)))


class MotionPicture:
    """The figure of the moving body; the browser has all frames and plays them."""

    def __init__(self) -> None:
        self.bodies = ColumnDataSource({"xs": [], "ys": []})
        self.springs = ColumnDataSource({"xs": [], "ys": []})
        self.names = ColumnDataSource({"x": [], "y": [], "text": []})
        self.frames = ColumnDataSource({"bx": [], "by": [], "sx": [], "sy": []})
        self.figure = figure(
            width=_WIDE, height=_HIGH, tools="", toolbar_location=None, min_border=0,
            x_range=Range1d(-1, 1), y_range=Range1d(-1, 1),
        )  # fmt: skip
        self.figure.axis.visible = False
        _plain(self.figure)
        self.figure.min_border_left = 0
        self.figure.grid.visible = False
        self.figure.multi_line("xs", "ys", source=self.springs, color="#555555", line_width=1.6)
        self.figure.patches("xs", "ys", source=self.bodies, fill_color="#c9d3ea",
                            line_color="#0b1d51", line_width=1.8)  # fmt: skip
        self.figure.text("x", "y", text="text", source=self.names, text_font_size="12px",
                         text_color=_INK, text_align="right", text_baseline="middle")  # fmt: skip

    def show(self, motion: Motion | None) -> None:
        """Load the frames of a motion."""
        kinds: dict[str, list[Any]] = {"body": [], "spring": []}
        n = 1
        if motion is not None:
            for one in motion.drawing.outlines:
                kinds["body" if one.kind == "body" else "spring"].append(one)
            n = len(motion.drawing.outlines[0].x)
            left, right, low, high = motion.drawing.limits()
            if motion.drawing.names:
                left -= 0.15 * (right - left)
            # One scale for both axes, so that a square remains a square.
            unit = max((right - left) / _WIDE, (high - low) / _HIGH)
            for axis, middle, size in (
                (self.figure.x_range, 0.5 * (left + right), _WIDE),
                (self.figure.y_range, 0.5 * (low + high), _HIGH),
            ):
                axis.update(start=middle - 0.5 * unit * size, end=middle + 0.5 * unit * size)
            self.names.data = {
                "x": [left + 0.1 * (right - left)] * len(motion.drawing.names),
                "y": [height for _, height in motion.drawing.names],
                "text": [name for name, _ in motion.drawing.names],
            }
        columns = {
            f"{kind[0]}{axis}": [[getattr(one, axis)[f].tolist() for one in kinds[kind]]
                                 for f in range(n)]
            for kind in kinds for axis in "xy"
        }  # fmt: skip
        self.frames.data = columns
        self.bodies.data = {"xs": columns["bx"][0], "ys": columns["by"][0]}
        self.springs.data = {"xs": columns["sx"][0], "ys": columns["sy"][0]}


def _plain(shown: Any) -> None:
    shown.outline_line_color = None
    shown.grid.grid_line_color = "#e4e4e4"
    shown.axis.axis_label_text_font_style = "normal"
    shown.axis.axis_label_text_color = shown.axis.major_label_text_color = _INK
    shown.min_border_left = 60
