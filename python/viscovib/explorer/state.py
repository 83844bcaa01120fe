"""State of the explorer: a scene, its changes, and the steps for undo and redo."""

import re
import time
import urllib.parse
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from viscovib.errors import InputError
from viscovib.explorer.numbers import Number, chosen
from viscovib.scene.job import SceneResult, run_one
from viscovib.scene.scene import Scene
from viscovib.sweeps.points import quiet
from viscovib.sweeps.scenes import summary

#: Significant digits of a number that a slider sets.
_DIGITS = 6
#: Largest number of stored steps.
_MOST_STEPS = 500
#: Name of a scene that was typed or loaded, not read from the folder.
_TYPED = "explored.nml"


@dataclass(frozen=True)
class Moment:
    """A scene as it was read, and the values changed since then, by key."""

    scene: Scene
    changed: Mapping[str, float]
    #: Whether the scene is a file that can be read again by its path.
    on_disk: bool = True
    #: Keys with a slider; None: up to the largest number of sliders.
    keys: tuple[str, ...] | None = None

    def current(self) -> Scene:
        """Return the scene with its changes."""
        return self.scene.override(self.changed)


class State:
    """The present scene, with undo and redo.

    Every method that makes a change computes first. If that fails, the state does not change.
    """

    def __init__(self, scene: Scene, keys: Sequence[str] | None = None) -> None:
        wanted = None if keys is None else tuple(keys)
        self.now = Moment(scene.override({}), {}, keys=wanted)
        self.numbers = chosen(self.now.scene, wanted)
        self._past: list[Moment] = []
        self._future: list[Moment] = []
        self._moving: str | None = None
        self._first: tuple[SceneResult, dict[str, Any]] | None = None
        self.result, self.seconds = compute(self.now.scene)
        self.start = self.result

    def value(self, key: str) -> float:
        """Return the present value of a number."""
        return self.now.changed.get(key, self.numbers[key].value)

    def set(self, key: str, value: float) -> None:
        """Set a number. Steps of one movement are undone together: see `settle`."""
        number = self._number(key)
        rounded = float(f"{value:.{_DIGITS}g}")
        self._to(replace(self.now, changed=_changed(self.now.changed, number, rounded)), key)

    def set_exactly(self, key: str, text: str) -> None:
        """Set a number to the typed value."""
        try:
            value = float(text)
        except ValueError:
            raise InputError(f"{text!r}: must be a number") from None
        number = self._number(key)
        self._to(replace(self.now, changed=_changed(self.now.changed, number, value)), None)

    def settle(self) -> None:
        """End a movement: the next change is a separate step of undo."""
        self._moving = None

    def reset(self) -> None:
        """Return to the scene as it was read."""
        self._to(replace(self.now, changed={}), None)

    def read(self, path: Path) -> None:
        """Use another scene file."""
        self._take(Moment(Scene.read(path).override({}), {}))

    def read_text(self, text: str, name: str = _TYPED) -> None:
        """Use a typed or loaded scene; line numbers in messages are those of the text."""
        with TemporaryDirectory() as folder:
            path = Path(folder) / (Path(name).name or _TYPED)
            path.write_text(text, encoding="utf-8")
            try:
                scene = Scene.read(path)
            except InputError as error:
                message = re.sub(r"^(\d+): ", r"line \1: ", f"{error}".removeprefix(f"{path}:"))
                raise InputError(message.strip()) from None
        named = replace(scene, path=Path(path.name))
        self._take(Moment(named.override({}), {}, on_disk=False))

    @property
    def first_numbers(self) -> dict[str, Any]:
        """Return the summary of the result of the scene as it was read."""
        if self._first is None or self._first[0] is not self.start:
            self._first = self.start, summary(self.start)
        return self._first[1]

    @property
    def can_undo(self) -> bool:
        """Whether there is a step to undo."""
        return bool(self._past)

    @property
    def can_redo(self) -> bool:
        """Whether there is a step to redo."""
        return bool(self._future)

    def undo(self) -> None:
        """Undo a step."""
        if self._past:
            self._step(self._past, self._future)

    def redo(self) -> None:
        """Repeat the step that was undone."""
        if self._future:
            self._step(self._future, self._past)

    def link(self) -> str:
        """Return the query of an address for this state, "" without changes."""
        if not self.now.changed:
            return ""
        changed = self.now.changed.items()
        pairs = [(key, repr(value)) for key, value in changed if key in self.numbers]
        return "?" + urllib.parse.urlencode(pairs, safe="().")

    def follow(self, query: Iterable[tuple[str, str]]) -> None:
        """Set the values of an address, in the form of `link`: pairs of key and text."""
        changed: dict[str, float] = {}
        for key, text in query:
            if key == "scene":
                continue
            number = self._number(key)
            try:
                changed = _changed(changed, number, float(text))
            except ValueError:
                raise InputError(f"{key} = {text!r}: must be a number") from None
        if changed:
            self._to(replace(self.now, changed=changed), None)

    def scene_text(self) -> str:
        """Return the present scene as the text of a file."""
        return self.now.current().canonical

    def python_lines(self) -> str:
        """Return Python code that gives the same result."""
        path, changed = self.now.scene.path, dict(self.now.changed)
        if self.now.on_disk:
            read = f"scene = vv.Scene.read({str(path)!r})"
            if changed:
                pairs = "".join(f"    {key!r}: {value!r},\n" for key, value in changed.items())
                read += f".override({{\n{pairs}}})"
        else:
            lines = "".join(f"    {line!r}\n" for line in self.scene_text().splitlines(True))
            read = f"text = (\n{lines})\nPath({_TYPED!r}).write_text(text, encoding='utf-8')\n"
            read += f"scene = vv.Scene.read({_TYPED!r})"
        first = "" if self.now.on_disk else "from pathlib import Path\n\n"
        return (
            f"{first}import matplotlib.pyplot as plt\nimport viscovib as vv\n\n{read}\n"
            "result = vv.run(scene)\nprint(result.value.summary())\n"
            f"result.to_csv({f'{path.stem}_{self.result.kind}.csv'!r})\n"
            "result.value.plot()\nplt.show()\n"
        )

    def _number(self, key: str) -> Number:
        if key not in self.numbers:
            raise InputError(f"{key}: must be one of {', '.join(self.numbers)}")
        return self.numbers[key]

    def _take(self, moment: Moment) -> None:
        """Start with another scene."""
        found = chosen(moment.scene, None)
        result, seconds = compute(moment.scene)
        self._remember(None)
        self.now, self.numbers, self.start = moment, found, result
        self.result, self.seconds = result, seconds

    def _to(self, moment: Moment, moving: str | None) -> None:
        if moment == self.now:
            return
        result, seconds = compute(moment.current())
        self._remember(moving)
        self.now, self.result, self.seconds = moment, result, seconds

    def _remember(self, moving: str | None) -> None:
        if moving is None or moving != self._moving:
            self._past = [*self._past[-_MOST_STEPS:], self.now]
        self._future = []
        self._moving = moving

    def _step(self, source: list[Moment], target: list[Moment]) -> None:
        moment = source[-1]
        result, seconds = compute(moment.current())
        source.pop()
        target.append(self.now)
        if moment.scene is not self.now.scene:
            self.numbers = chosen(moment.scene, moment.keys)
            self.start, _ = compute(moment.scene)
        self.now, self.result, self.seconds, self._moving = moment, result, seconds, None


def _changed(changed: Mapping[str, float], number: Number, value: float) -> dict[str, float]:
    """Return the changes with one more; the value as it was read is not a change."""
    unchanged = {key: old for key, old in changed.items() if key not in (number.key, number.mirror)}
    if value == number.value:
        return unchanged
    one = int(value) if number.whole and value.is_integer() else value
    return unchanged | {key: one for key in (number.key, number.mirror) if key is not None}


def compute(scene: Scene) -> tuple[SceneResult, float]:
    """Compute a scene without warnings; return the result and the time (s)."""
    begun = time.perf_counter()
    with warnings.catch_warnings():
        quiet()
        result = run_one(scene)
    return result, time.perf_counter() - begun
