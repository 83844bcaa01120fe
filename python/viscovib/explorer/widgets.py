"""Parts of the explorer page: rows with a slider, folding cards, saved files, the player."""

import base64
import html
from collections.abc import Callable
from typing import Any

from bokeh.models import (
    Button,
    Column,
    ColumnDataSource,
    CustomJS,
    Div,
    Row,
    Slider,
    TextInput,
    Toggle,
)

from viscovib.explorer.numbers import Number

_WRONG = ".bk-input { border: 2px solid #b3261e; background: #fdecea; }"
#: Style of sliders with a visible handle and a visible focus.
HANDLE = (
    ".noUi-handle { background: #1a56c4; border: 1px solid #0b1d51; box-shadow: none; }"
    ".noUi-handle:focus { outline: 3px solid #e08e1b; outline-offset: 1px; }"
    ".noUi-target { border: 1px solid #767676; background: #f1f1f1; }"
)
_CARD = ":host { border: 1px solid #c4c4c4; border-radius: 6px; padding: 0 8px 6px 8px; }"
_TITLE = (
    ".bk-btn { text-align: left; font-weight: 600; background: none !important; border: none;"
    " box-shadow: none; color: #222; padding: 6px 0; }"
    ".bk-btn:focus-visible { outline: 2px solid #1a56c4; }"
    ".bk-btn::before { content: '\\25B8\\00A0' / ''; }"
    ".bk-btn.bk-active::before { content: '\\25BE\\00A0' / ''; }"
)
_SAVE = """
const {name, type, base64} = cb_obj.data
const bytes = Uint8Array.from(atob(base64[0]), c => c.charCodeAt(0))
const link = document.createElement('a')
link.href = URL.createObjectURL(new Blob([bytes], {type: type[0]}))
link.download = name[0]
document.body.append(link)
link.click()
link.remove()
setTimeout(() => URL.revokeObjectURL(link.href), 60000)
"""
#: The browser draws the frames and sends nothing to the server.
_PLAY = """
const quiet = {sync: false}
const show = (f) => {
  const at = frames.data
  if (f >= at.bx.length) return
  bodies.setv({data: {xs: at.bx[f], ys: at.by[f]}}, quiet)
  springs.setv({data: {xs: at.sx[f], ys: at.sy[f]}}, quiet)
}
clearInterval(window.viscovib_timer)
if (cb_obj.active) {
  let f = 0
  window.viscovib_timer = setInterval(() => {
    f = (f + 1) % Math.max(frames.data.bx.length, 1)
    show(f)
  }, 33)
}
"""


def words(text: str = "") -> Div:
    """Return an element for text as HTML."""
    # Formulas may contain links that execute code; escaping HTML does not prevent this.
    return Div(
        text=text, disable_math=True, sizing_mode="stretch_width", margin=(2, 5, 2, 5)
    )  # fmt: skip


def alert(message: str) -> str:
    """Return an error message as HTML that screen readers read immediately."""
    if not message:
        return ""
    return f"<div role='alert' style='color:#b3261e'>{html.escape(message)}</div>"


def card(title: str, *parts: Any, folded: bool = False) -> Column:
    """Return parts below a title that hides and shows them."""
    head = Toggle(
        label=title, active=not folded, stylesheets=[_TITLE], sizing_mode="stretch_width",
        margin=0,
    )  # fmt: skip
    body = Column(*parts, visible=not folded, sizing_mode="stretch_width")
    head.js_link("active", body, "visible")
    return Column(head, body, stylesheets=[_CARD], sizing_mode="stretch_width", margin=(4, 0, 4, 0))


def flow(*parts: Any) -> Row:
    """Return parts in a row that wraps if the page is narrow."""
    style = ":host { flex-wrap: wrap; gap: 4px; align-items: flex-end; }"
    return Row(*parts, stylesheets=[style], sizing_mode="stretch_width", margin=(2, 0, 2, 0))


class Saver:
    """Buttons that send files to the browser."""

    def __init__(self, failed: Callable[[str], None]) -> None:
        self._failed = failed
        self.source = ColumnDataSource({"name": [""], "type": [""], "base64": [""]})
        self.source.js_on_change("data", CustomJS(code=_SAVE))

    def button(
        self, label: str, name: Callable[[], str], content: Callable[[], bytes], kind: str
    ) -> Button:
        """Return a button that saves the bytes returned by ``content``."""

        def save() -> None:
            try:
                text = base64.b64encode(content()).decode()
            except (OSError, ValueError, TypeError) as error:
                self._failed(str(error))
                return
            self.source.data = {"name": [name()], "type": [kind], "base64": [text]}

        button = Button(label=label, margin=(2, 2, 2, 2))
        button.on_click(lambda _: save())
        return button


def player(motion: Any) -> Toggle:
    """Return a button that starts and stops the animation of the motion."""
    toggle = Toggle(label="Play", margin=(2, 5, 2, 5), width=90)
    toggle.js_on_change(
        "active",
        CustomJS(
            args={"frames": motion.frames, "bodies": motion.bodies, "springs": motion.springs},
            code=_PLAY + "cb_obj.label = cb_obj.active ? 'Stop' : 'Play'",
        ),
    )
    return toggle


class NumberRow:
    """A slider, a field for its number, and the error message for a typed value."""

    def __init__(
        self,
        number: Number,
        value: float,
        moved: Callable[[str, float], str],
        typed: Callable[[str, str], str],
        rested: Callable[[], None],
    ) -> None:
        self.number, self._moved, self._typed = number, moved, typed
        self._filling = False
        unit = f" ({number.unit})" if number.unit else ""
        low, high = number.ends(value)
        self.slider = Slider(
            title="", start=low, end=high, value=value, step=self._step(low, high),
            show_value=False, tooltips=False, sizing_mode="stretch_width",
            margin=(20, 10, 0, 10), stylesheets=[HANDLE], bar_color="#c9d3ea",
        )  # fmt: skip
        self.field = TextInput(
            title=f"{number.label}{unit}", value=_text(value), width=140, margin=(2, 5, 0, 5)
        )
        self.range = words()
        self.error = words()
        self.error.visible = False
        self._update_range()
        self.slider.on_change("value", self._on_slide)
        self.slider.on_change("value_throttled", lambda _attr, _old, _new: rested())
        self.field.on_change("value", self._on_type)
        self.view = Column(
            Row(self.field, self.slider, sizing_mode="stretch_width"),
            self.range,
            self.error,
            sizing_mode="stretch_width",
        )

    def fill(self, value: float) -> None:
        """Show a value that was set elsewhere; the range changes if the value is outside it."""
        self._filling = True
        if not self.slider.start <= value <= self.slider.end:
            low, high = self.number.ends(value)
            self.slider.update(start=low, end=high, step=self._step(low, high))
            self._update_range()
        self.slider.value = value
        self.field.value = _text(value)
        self._filling = False
        self.show_message("")

    def show_message(self, message: str) -> None:
        """Show the error of the field next to it, or remove it."""
        if bool(message) == self.error.visible and not message:
            return
        self.error.visible = bool(message)
        self.error.text = alert(message)
        self.field.stylesheets = [_WRONG] if message else []

    def _step(self, low: float, high: float) -> float:
        return 1.0 if self.number.whole else (high - low) / 400

    def _update_range(self) -> None:
        unit = f" {html.escape(self.number.unit)}" if self.number.unit else ""
        low, high = _text(self.slider.start), _text(self.slider.end)
        self.range.text = f"<small style='color:#555'>slider: {low} to {high}{unit}</small>"

    def _on_slide(self, _name: str, _old: float, new: float) -> None:
        if self._filling:
            return
        message = self._moved(self.number.key, float(new))
        self._filling = True
        self.field.value = _text(float(f"{new:.6g}"))
        self._filling = False
        self.show_message(message)

    def _on_type(self, _name: str, _old: str, new: str) -> None:
        if self._filling:
            return
        message = self._typed(self.number.key, new)
        if message:
            self.show_message(message)
        else:
            self.fill(float(new))


def _text(value: float) -> str:
    return f"{value:.10g}"
