"""Numbers with nouns for summaries, plans and messages."""

from __future__ import annotations

from typing import SupportsInt


def things(n: SupportsInt, name: str, many: str = "") -> str:
    """Return a number with a noun: "1 fold", "2 folds"; ``many``: irregular plural."""
    count = int(n)
    return f"{count} {name if count == 1 else many or name + 's'}"
