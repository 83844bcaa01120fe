"""A progress bar, or no bar: even a silent bar of tqdm takes time."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol, Self

from viscovib._native import core

#: Seconds without a bar, and between two looks.
_PATIENCE, _LOOK = 0.5, 0.2


class Bar(Protocol):
    """A counter of finished units."""

    def __enter__(self) -> Self:
        """Open it."""
        ...

    def __exit__(self, *raised: object) -> None:
        """Close it."""

    def update(self, done: int) -> object:
        """Count so many as done."""


class _Silent:
    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        pass

    def update(self, done: int) -> object:
        return None


def progress_bar(total: int, unit: str, shown: bool, done: int = 0) -> Bar:
    """Return a bar of ``total`` units, of which some are ``done``; a silent one if not shown."""
    if not shown:
        return _Silent()
    from tqdm import tqdm

    bar: Bar = tqdm(total=total, initial=done, unit=f" {unit}", leave=False)
    return bar


@contextmanager
def counted_pieces(shown: bool) -> Iterator[None]:
    """Show how many points a long native call has begun, if it takes longer than half a second.

    For curves, whose number of points is not known before. The bar stands on standard error.
    """
    if not shown:
        yield
        return
    over = threading.Event()

    def watch() -> None:
        before = core.pieces_of_work()
        if over.wait(_PATIENCE):
            return
        from tqdm import tqdm

        with tqdm(unit=" points", leave=False) as bar:
            while not over.wait(_LOOK):
                now = core.pieces_of_work()
                bar.update(max(now - before, 0))
                before = now
                bar.refresh()

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        over.set()
        watcher.join()
