"""Progress bars: on request, and automatically for work of more than two seconds.

They appear automatically only on a terminal or in a notebook, and never in worker processes, in
threads other than the main one, or if the environment variable CI or TQDM_DISABLE is set. Short
calls only read the clock.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol, Self

#: Seconds after which a bar appears automatically.
PATIENCE = 2.0
#: Seconds without a requested bar, and between two updates.
_PATIENCE, _LOOK = 0.5, 0.2
#: Steps of a motion between two reports of the core.
_STEPS_OF_PIECE = 1024
#: Function that counts the parts of work that the core has started.
pieces: list[Callable[[], int]] = []
#: Bars shown at present (at most one).
_shown: list[Any] = []


class Bar(Protocol):
    """A counter of finished units."""

    def __enter__(self) -> Self:
        """Open it."""
        ...

    def __exit__(self, *raised: object) -> None:
        """Close it."""

    def update(self, done: int) -> object:
        """Add finished units."""


class _Silent:
    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        pass

    def update(self, done: int) -> object:
        return None


#: No bar.
SILENT: Bar = _Silent()


class _Late(_Silent):
    """A bar that opens automatically if the work takes long."""

    def __init__(self, total: int, unit: str, done: int) -> None:
        self.total, self.unit, self.done = total, unit, done
        self.opens = time.monotonic() + PATIENCE
        self.bar: Any = None

    def __exit__(self, *raised: object) -> None:
        if self.bar is not None:
            _shown.remove(self)
            self.bar.close()

    def update(self, done: int) -> object:
        self.done += done
        if self.bar is not None:
            self.bar.update(done)
        elif time.monotonic() > self.opens and not _shown:
            _shown.append(self)
            self.bar = _new_bar(total=self.total, initial=self.done, unit=f" {self.unit}")
        return None


def _new_bar(**options: Any) -> Any:
    from tqdm import tqdm

    return tqdm(**options, leave=False)


def shows_by_itself() -> bool:
    """True in the main thread on a terminal or in a notebook."""
    if threading.current_thread() is not threading.main_thread() or os.environ.get("CI"):
        return False
    shell = sys.modules.get("IPython")
    notebook = shell is not None and type(shell.get_ipython()).__name__ == "ZMQInteractiveShell"
    if not (notebook or (sys.stderr is not None and sys.stderr.isatty())):
        return False
    workers = sys.modules.get("multiprocessing")
    return workers is None or workers.parent_process() is None


def progress_bar(total: int, unit: str, shown: bool, done: int = 0) -> Bar:
    """Return a bar of ``total`` units, of which some are ``done``.

    Without ``shown`` it opens automatically if the work takes long on a terminal or in a notebook.
    """
    if shown:
        bar: Bar = _new_bar(total=total, initial=done, unit=f" {unit}")
        return bar
    return _Late(total, unit, done) if shows_by_itself() else SILENT


class _Work(threading.local):
    """Number of steps of the native call of a thread, if it is known."""

    steps: int | None = None


_work = _Work()


@contextmanager
def counted_pieces(shown: bool, steps: int | None = None) -> Iterator[None]:
    """Show the number of points that a native call has started, after half a second.

    For curves, whose number of points is unknown; for a motion of a known number of ``steps`` show
    these. The bar appears on standard error. Without ``shown`` `wait` may show it.
    """
    if not shown:
        _work.steps = steps
        try:
            yield
        finally:
            _work.steps = None
        return
    over = threading.Event()
    _shown.append(over)
    watcher = threading.Thread(target=_count, args=(over.wait, _PATIENCE, steps), daemon=True)
    watcher.start()
    try:
        yield
    finally:
        over.set()
        watcher.join()
        _shown.remove(over)


def wait(thread: threading.Thread) -> None:
    """Wait for a thread; with a bar if it takes long on a terminal or in a notebook."""
    thread.join(PATIENCE)
    if not thread.is_alive():
        return
    if _shown or not shows_by_itself():
        thread.join()
        return

    def ended(seconds: float) -> bool:
        thread.join(seconds)
        return not thread.is_alive()

    _shown.append(thread)
    try:
        _count(ended, 0, _work.steps)
    finally:
        _shown.remove(thread)


def _count(ended: Any, patience: float, steps: int | None = None) -> None:
    """Count parts of work until ``ended``, called with a number of seconds, returns True."""
    before = pieces[0]()
    if patience and ended(patience):
        return
    size = 1 if steps is None else _STEPS_OF_PIECE
    with _new_bar(total=steps, unit=" points" if steps is None else " steps") as bar:
        while not ended(_LOOK):
            now = pieces[0]()
            # For work without parts show the elapsed time.
            bar.bar_format = None if bar.n or now != before else "computing: {elapsed}"
            more = size * max(now - before, 0)
            bar.update(more if steps is None else min(more, steps - bar.n))
            before = now
            bar.refresh()
