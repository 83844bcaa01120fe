"""Errors and warnings of the public interface."""

from __future__ import annotations

import re
from typing import Any


class ViscovibError(Exception):
    """Base of every error that viscovib raises on purpose: its text is one line."""

    def __str__(self) -> str:
        # Names of files may hold what ends a line or steers a terminal.
        return re.sub(r"[\x00-\x1f\x7f]", "?", super().__str__())


class InputError(ViscovibError, ValueError):
    """Wrong input: the message names the argument, its value and what is allowed."""


class FileError(ViscovibError, OSError):
    """A file cannot be read or written."""


class ConvergenceWarning(UserWarning):
    """Some points of a result were not found; they hold NaN."""


class StabilityWarning(UserWarning):
    """The system creeps away from rest, though its forced response exists."""


class SweepError(ViscovibError):
    """A point of a sweep failed: the message names its parameters, which ``point`` holds."""

    def __init__(self, message: str, point: dict[str, Any] | None = None) -> None:
        super().__init__(message)
        self.point = dict(point or {})


class RangeWarning(UserWarning):
    """An asymptotic result is outside the range in which its expansion holds."""
