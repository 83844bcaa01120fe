"""Numbers of things in words, for summaries, plans and messages."""

from __future__ import annotations

from typing import SupportsInt


def things(n: SupportsInt, name: str, many: str = "") -> str:
    """Return how many things there are: "1 fold", "2 folds"; ``many`` where s makes no plural."""
    count = int(n)
    return f"{count} {name if count == 1 else many or name + 's'}"
