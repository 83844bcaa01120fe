"""The page of the explorer: sliders, curves, the moving body, exports."""

import base64
import html
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import urlencode

import numpy as np
from bokeh.models import (
    Button,
    Column,
    ColumnDataSource,
    CustomJS,
    FileInput,
    Select,
    Slider,
    TextAreaInput,
)

from viscovib.errors import ViscovibError
from viscovib.explorer.drawn import Curve, curves_of, motion_of
from viscovib.explorer.measured import read_measured
from viscovib.explorer.pictures import FREQUENCIES, SCALES, CurvePicture, MotionPicture, Neighbour
from viscovib.explorer.state import State
from viscovib.explorer.widgets import HANDLE, NumberRow, Saver, alert, card, flow, player, words
from viscovib.explorer.words import legend, peaks
from viscovib.plots.pictures import save_picture

#: Computing time (s) from which a slider must rest before the computation, and that rest (ms).
_SLOW, _REST = 0.05, 200
#: Delay of texts after a change (ms).
_WORDS = 60
#: Number of groups that are open at first.
_OPEN = 3
#: Wide page: curves at the left, sliders at the right. Narrow page: one below the other; the curves
#: remain visible while the sliders scroll below them.
_AREAS = """
:host { display: flex !important; flex-direction: column; gap: 4px 16px; overflow: visible; }
@media (min-width: 900px) {
  :host {
    display: grid !important;
    grid-template-columns: minmax(0, 3fr) minmax(330px, 1.3fr);
    grid-template-areas: "head side" "curves side" "more side";
    grid-template-rows: auto auto 1fr;
  }
}
"""
_CURVES = """
@media (max-width: 899px) {
  :host { position: sticky; top: 0; z-index: 3; background: white; }
}
"""
_TYPED = "textarea { font-family: monospace; white-space: pre; }"
_ADDRESS = "history.replaceState(null, '', location.pathname + cb_obj.data.query[0])"


class Page:
    """One page, for one session of the browser.

    ``folder``: folder of the scenes to choose from; ``document``: runs slow work later.
    """

    def __init__(self, state: State, folder: Path | None = None, document: Any = None) -> None:
        self.state, self._folder, self._document = state, folder, document
        self._frozen: Neighbour = {}
        self._measured: Neighbour = {}
        self._waiting: Any = None
        self._telling: Any = None
        self._point: int | None = None
        self._filling = False
        self.rows: dict[str, NumberRow] = {}
        self.pictures: list[CurvePicture] = []
        self.curves: list[Curve] = []
        self._make_words()
        self._make_buttons()
        self._make_files()
        self._make_motion()
        self.view = self._arranged()
        self._build()

    def complain(self, message: str) -> None:
        """Show an error above the curves."""
        self.trouble.text = alert(message)

    def _make_words(self) -> None:
        self.title, self.status, self.trouble, self.legend = words(), words(), words(), words()
        self.about_motion, self.python = words(), words()
        self.scene_error, self.compare_error = words(), words()
        self.address = ColumnDataSource({"query": [""]}, name="address")
        self.address.js_on_change("data", CustomJS(code=_ADDRESS))
        self.curve_column = Column(
            sizing_mode="stretch_width", stylesheets=[_CURVES],
            styles={"grid-area": "curves", "order": "2", "min-width": "0"},
        )  # fmt: skip
        self.number_column = Column(sizing_mode="stretch_width")

    def _make_buttons(self) -> None:
        def button(label: str, action: Callable[[], None]) -> Button:
            made = Button(label=label, margin=(2, 2, 2, 2))
            made.on_click(lambda _: action())
            return made

        self.undo = button("Undo", partial(self._pressed, self.state.undo))
        self.redo = button("Redo", partial(self._pressed, self.state.redo))
        self.reset = button("Reset", partial(self._pressed, self.state.reset))
        self.freeze = button("Freeze curve", self._freeze)
        self.thaw = button("Clear", self._thaw)
        self.apply = button("Use this scene", lambda: self._use(self.editor.value))
        self.scale = Select(title="Amplitude", options=list(SCALES), value=SCALES[0], width=120)
        self.frequency = Select(
            title="Frequency", options=list(FREQUENCIES), value=FREQUENCIES[0], width=90
        )
        for chosen in (self.scale, self.frequency):
            chosen.on_change("value", lambda _attr, _old, _new: self._redraw())

    def _make_files(self) -> None:
        self.editor = TextAreaInput(
            title="The scene as it is now", rows=14, sizing_mode="stretch_width", margin=(5, 5),
            max_length=1_000_000, stylesheets=[_TYPED],
        )  # fmt: skip
        self.upload = FileInput(accept=".nml", title="Load a scene file (*.nml)")
        self.upload.on_change("value", self._on_upload)
        self.compare = FileInput(
            accept=".csv,.txt",
            title="Measured curve (*.csv): frequency, then a column for each coordinate",
        )
        self.compare.on_change("value", self._on_compare)
        self.pick = Select(title="Scenes of the folder", options=[], width=300)
        self.pick.on_change("value", self._on_pick)
        self.saver = Saver(self.complain)

    def _make_motion(self) -> None:
        self.motion = MotionPicture()
        self.play = player(self.motion)
        self.place = Slider(
            title="Motion at point", start=0, end=1, step=1, value=0, sizing_mode="stretch_width",
            margin=(5, 10), stylesheets=[HANDLE], bar_color="#c9d3ea",
        )  # fmt: skip
        self.place.on_change("value", self._on_place)

    def _arranged(self) -> Column:
        def area(name: str, order: int, *parts: Any) -> Column:
            return Column(
                *parts, sizing_mode="stretch_width",
                styles={"grid-area": name, "order": str(order), "min-width": "0"},
            )  # fmt: skip

        save, stem = self.saver.button, self._stem
        files = flow(
            save("Table (CSV)", lambda: stem("", "csv"), self._table, "text/csv"),
            save("Picture (PNG)", lambda: stem("", "png"), partial(self._image, "png"),
                 "image/png"),
            save("Picture (SVG)", lambda: stem("", "svg"), partial(self._image, "svg"),
                 "image/svg+xml"),
            save("Scene (NML)", lambda: stem("explored", "nml"),
                 lambda: self.state.scene_text().encode(), "text/plain"),
            save("Python lines", lambda: stem("explored", "py"),
                 lambda: self.state.python_lines().encode(), "text/x-python"),
        )  # fmt: skip
        head = area(
            "head", 1, self.trouble, self.status, self.legend,
            flow(self.scale, self.frequency, self.freeze, self.thaw),
        )  # fmt: skip
        more = area(
            "more", 4,
            card("Motion", self.about_motion, self.motion.figure, self.play, self.place),
            card("Compare with a file", self.compare, self.compare_error, folded=True),
            card("Python lines", self.python, folded=True),
        )  # fmt: skip
        side = area(
            "side", 3, flow(self.undo, self.redo, self.reset), self.number_column,
            card("Scene", self.pick, self.upload, self.editor, self.apply, self.scene_error,
                 folded=True),
        )  # fmt: skip
        grid = Column(
            head, self.curve_column, side, more,
            stylesheets=[_AREAS], sizing_mode="stretch_width",
        )  # fmt: skip
        return Column(
            self.title, files, grid, sizing_mode="stretch_width", styles={"max-width": "1500px"},
            # Invisible parts must belong to the page too.
            tags=[self.address, self.saver.source],
        )  # fmt: skip

    # Changes of the state.

    def _change(self, change: Callable[[], None]) -> str:
        """Make a change and show its result; return the error message, if any."""
        try:
            change()
        except (ViscovibError, UnicodeError, ArithmeticError) as error:
            return str(error)
        self.complain("")
        self._refresh()
        return ""

    def _moved(self, key: str, value: float) -> str:
        if self.state.seconds < _SLOW or self._document is None:
            return self._change(partial(self.state.set, key, value))
        # Long work waits until the slider rests.
        if self._waiting is not None:
            self._document.remove_timeout_callback(self._waiting)
        late = partial(self._late, key, value)
        self._waiting = self._document.add_timeout_callback(late, _REST)
        return ""

    def _late(self, key: str, value: float) -> None:
        self._waiting = None
        self.rows[key].show_message(self._change(partial(self.state.set, key, value)))

    def _typed(self, key: str, text: str) -> str:
        return self._change(partial(self.state.set_exactly, key, text))

    def _pressed(self, action: Callable[[], None]) -> None:
        numbers = self.state.numbers
        message = self._change(action)
        if message:
            self.complain(message)
        elif self.state.numbers is not numbers:
            self._build()
        else:
            for key, row in self.rows.items():
                row.fill(self.state.value(key))

    def _use(self, text: str, name: str = "explored.nml") -> None:
        """Use a scene that was typed or loaded."""
        self._take(partial(self.state.read_text, text, name))

    def _take(self, change: Callable[[], None]) -> None:
        try:
            change()
        except (ViscovibError, UnicodeError) as error:
            self.scene_error.text = alert(str(error))
            return
        self._frozen, self._measured, self._point = {}, {}, None
        self._build()

    def _on_upload(self, _name: str, _old: object, new: Any) -> None:
        if new:
            self._soon(self._load)

    def _load(self) -> None:
        """Use the uploaded scene file."""
        name, content = _handed_over(self.upload)
        try:
            text = content.decode()
        except UnicodeError:
            self.scene_error.text = alert(f"{name}: is not a text file")
            return
        self._use(text, name)

    def _soon(self, action: Callable[[], None]) -> None:
        """Do something after all data of a file, such as its name, have arrived."""
        if self._document is None:
            action()
        else:
            self._document.add_next_tick_callback(action)

    def _on_pick(self, _name: str, _old: object, new: str) -> None:
        if not self._filling and self._folder is not None and new in self._scenes():
            self._take(partial(self.state.read, self._folder / new))

    def _scenes(self) -> list[str]:
        if self._folder is None:
            return []
        return sorted(path.name for path in self._folder.glob("*.nml"))

    def _on_compare(self, _name: str, _old: object, new: Any) -> None:
        if new:
            self._soon(self._draw_overlay)

    def _draw_overlay(self) -> None:
        """Show the uploaded measured curve."""
        name, content = _handed_over(self.compare)
        names = [curve.name for curve in self.curves]
        orders = [curve.order for curve in self.curves]
        try:
            self._measured = read_measured(content.decode(), names, orders)
        except (ViscovibError, UnicodeError) as error:
            self.compare_error.text = alert(f"{name}: {error}")
            return
        self.compare_error.text = ""
        self._show_overlay()

    def _freeze(self) -> None:
        self._frozen = {curve.name: (curve.x, curve.y) for curve in self.curves}
        self._show_overlay()

    def _thaw(self) -> None:
        self._frozen, self._measured = {}, {}
        self._show_overlay()

    # The display.

    def _build(self) -> None:
        """Make new rows and figures for another scene."""
        self.rows = {
            key: NumberRow(
                number, self.state.value(key), self._moved, self._typed, self.state.settle
            )
            for key, number in self.state.numbers.items()
        }
        groups: dict[str, list[Any]] = {}
        for row in self.rows.values():
            groups.setdefault(row.number.group, []).append(row.view)
        self.number_column.children = [
            card(title.capitalize(), *views, folded=place >= _OPEN and not title.startswith("load"))
            for place, (title, views) in enumerate(groups.items())
        ]
        self.scene_error.text = ""
        self._filling = True
        name = self.state.now.scene.path.name
        self.pick.options = self._scenes() if name in self._scenes() else ["", *self._scenes()]
        self.pick.value = name if name in self._scenes() and self.state.now.on_disk else ""
        self.pick.visible = bool(self._scenes())
        self._filling = False
        self.pictures = []
        self._refresh()
        self._update_text()

    def _redraw(self) -> None:
        """Make new figures for other axes."""
        high = max(150, min(260, 470 // max(len(self.curves), 1)))
        self.pictures = [
            CurvePicture(curve, self.scale.value, self.frequency.value, high, self._choose)
            for curve in self.curves
        ]
        for picture in self.pictures[:-1]:
            picture.figure.xaxis.axis_label = None
        self.curve_column.children = [picture.figure for picture in self.pictures]
        self._show_overlay()
        self._mark()

    def _refresh(self) -> None:
        """Show the present result."""
        before = [(curve.name, curve.order, curve.x_label) for curve in self.curves]
        self.curves = curves_of(self.state.result.value, self.state.result.switched)
        now = [(curve.name, curve.order, curve.x_label) for curve in self.curves]
        if now != before or not self.pictures:
            self._redraw()
        for picture, curve in zip(self.pictures, self.curves, strict=True):
            picture.draw(curve)
        self._show_motion()
        if self._document is None:
            self._update_text()
            return
        # First the curves; peaks, which need a solution, and texts follow when the slider rests.
        if self._telling is not None:
            self._document.remove_timeout_callback(self._telling)
        self._telling = self._document.add_timeout_callback(self._update_text, _WORDS)

    def _update_text(self) -> None:
        """Update all texts."""
        self._telling = None
        state = self.state
        scene = state.now.scene
        title = scene.title or scene.path.name
        self.title.text = f"<h1 style='font-size:1.3em;margin:0'>{html.escape(title)}</h1>"
        self.status.text = (
            f"<div role='status'>{peaks(state)} <small>computed in "
            f"{1e3 * state.seconds:.1f} ms; {html.escape(state.result.value._headline())}"
            "</small></div>"
        )
        self.undo.disabled, self.redo.disabled = not state.can_undo, not state.can_redo
        self.reset.disabled = not state.now.changed
        self.editor.value = state.scene_text()
        self.python.text = f"<pre style='overflow-x:auto'>{html.escape(state.python_lines())}</pre>"
        self._update_legend()
        self.address.data = {"query": [self._query()]}

    def _update_legend(self) -> None:
        value = self.state.result.value
        known = getattr(value, "stable", None) is not None
        self.legend.text = legend(self.curves, known, bool(self._frozen), bool(self._measured))

    def _query(self) -> str:
        query, moment = self.state.link(), self.state.now
        if moment.on_disk and moment.scene.path.name in self._scenes():
            query = f"?{urlencode({'scene': moment.scene.path.name})}" + query.replace("?", "&", 1)
        return query

    def _show_overlay(self) -> None:
        for picture, curve in zip(self.pictures, self.curves, strict=True):
            picture.overlay("frozen", self._frozen.get(curve.name))
            picture.overlay("measured", self._measured.get(curve.name))
        self._update_legend()

    # The motion.

    def _choose(self, point: int) -> None:
        self._point = point
        self._show_motion()

    def _on_place(self, _name: str, _old: int, new: int) -> None:
        if not self._filling:
            self._choose(int(new))

    def _show_motion(self) -> None:
        if not self.curves:
            return
        curve = self.curves[0]
        last = max(curve.x.size - 1, 1)
        # Before a point is chosen, show the motion of the peak.
        point = self._point
        if point is None:
            finite = np.isfinite(curve.y)
            point = int(np.nanargmax(np.abs(curve.y))) if finite.any() else 0
        result = self.state.result
        shown = min(point, last)
        motion = motion_of(self.state.now.scene, result.value, result.switched, curve, shown)
        self.motion.show(motion)
        self._filling = True
        self.place.update(end=last, value=shown)
        self.place.visible = hasattr(result.value, "waveform")
        self._filling = False
        if motion is None:
            self.about_motion.text = "No single motion belongs to a point of these curves."
        else:
            factor = motion.drawing.factor
            size = "" if factor == 1 else f", drawn {factor:g} times as large"
            self.about_motion.text = html.escape(f"{motion.about}{size}")
        self._mark()

    def _mark(self) -> None:
        for picture in self.pictures:
            picture.mark(int(self.place.value) if self.place.visible else None)

    # Files.

    def _stem(self, what: str, suffix: str) -> str:
        stem = self.state.now.scene.path.stem.removesuffix("_explored")
        return f"{stem}_{what or self.state.result.kind}.{suffix}"

    def _table(self) -> bytes:
        return _content("csv", self.state.result.to_csv)

    def _image(self, suffix: str) -> bytes:
        result: Any = self.state.result
        draw = partial(save_picture, switched=result.switched)
        return _content(suffix, lambda path: draw(result.value, path))


def _handed_over(chosen: FileInput) -> tuple[str, bytes]:
    """Return name and content of a chosen file, and allow it to be chosen again."""
    name, content = str(chosen.filename), base64.b64decode(str(chosen.value))
    # A browser reports no second choice of the same file, although it may have changed.
    chosen.clear()
    return name, content


def _content(suffix: str, write: Callable[[Path], None]) -> bytes:
    """Return the bytes that a function writes into a file."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"file.{suffix}"
        write(path)
        return path.read_bytes()
