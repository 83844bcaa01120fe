"""A bar that shows how far a call is, or nothing: making even a silent one of tqdm takes time."""

from __future__ import annotations

from typing import Protocol, Self


class Bar(Protocol):
    """What is told that so much more is done."""

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
