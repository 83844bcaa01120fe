"""Parameters of public calls as records: a name, a type, bounds and words.

What an argument may be is said once, by a record; `checked` holds what is given against a table
of them. Every record refuses in the same words: ``name = value: must be ...``.
"""

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from inspect import Parameter as _Argument
from inspect import signature
from typing import Any, Generic, TypeVar

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.errors import FileError, InputError

_T = TypeVar("_T")
_R = TypeVar("_R")
_MAX_PATH = 4096


@dataclass(frozen=True)
class Parameter(ABC, Generic[_T]):
    """One argument: its name, and what it may be."""

    name: str

    @abstractmethod
    def check(self, value: Any) -> _T:
        """Return the value in its type, or refuse it in a line."""


@dataclass(frozen=True)
class Number(Parameter[float]):
    """A finite real number: at least ``lowest``, or above ``above``; at most ``highest``."""

    lowest: float | None = None
    highest: float | None = None
    above: float | None = None

    def check(self, value: Any) -> float:
        """Return a float."""
        number = _native.number(self.name, value)
        if (
            (self.above is not None and not number > self.above)
            or (self.lowest is not None and not number >= self.lowest)
            or (self.highest is not None and not number <= self.highest)
        ):
            raise InputError(f"{self.name} = {number:g}: must {self.allowed}")
        return number

    @cached_property
    def allowed(self) -> str:
        """What is allowed, in words."""
        if self.highest is not None:
            opening = "[" if self.above is None else "("
            least = self.lowest if self.above is None else self.above
            if least is None:
                return f"be at most {_spelt(self.highest)}"
            return f"be in {opening}{_spelt(least)}, {_spelt(self.highest)}]"
        if self.above is not None:
            return f"be greater than {_spelt(self.above)}"
        assert self.lowest is not None
        return "not be negative" if self.lowest == 0 else f"be at least {_spelt(self.lowest)}"


def _spelt(bound: float) -> str:
    """Write a bound: a small one as 1e-4."""
    if bound == 0 or abs(bound) >= 0.01:
        return f"{bound:g}"
    digits, _, power = f"{bound:e}".partition("e")
    return f"{float(digits):g}e{int(power)}"


@dataclass(frozen=True)
class Whole(Parameter[int]):
    """A whole number in [lowest, highest]."""

    lowest: int
    highest: int

    def check(self, value: Any) -> int:
        """Return an int."""
        return _native.integer(self.name, value, self.lowest, self.highest)


@dataclass(frozen=True)
class Word(Parameter[str]):
    """One of some words."""

    words: tuple[str, ...]

    def check(self, value: Any) -> str:
        """Return the word."""
        return _native.choice(self.name, value, self.words)


@dataclass(frozen=True)
class Flag(Parameter[bool]):
    """True or False."""

    def check(self, value: Any) -> bool:
        """Return a bool."""
        return _native.flag(self.name, value)


@dataclass(frozen=True)
class Text(Parameter[str]):
    """Any text."""

    def check(self, value: Any) -> str:
        """Return it."""
        if not isinstance(value, str):
            raise InputError(f"{self.name} = {_native.shown(value)}: must be a text")
        return value


@dataclass(frozen=True)
class Names(Parameter[tuple[str, ...]]):
    """Several texts, each one of the words if there are any."""

    words: tuple[str, ...] = ()
    count: int | None = None

    def check(self, value: Any) -> tuple[str, ...]:
        """Return a tuple."""
        if not isinstance(value, (list, tuple)) or not all(isinstance(one, str) for one in value):
            raise InputError(
                f"{self.name} = {_native.shown(value)}: must be a list or tuple of names"
            )
        if self.count is not None and len(value) != self.count:
            raise InputError(f"{self.name}: {len(value)} given, must be {self.count}")
        if self.words:
            for one in value:
                _native.choice(self.name, one, self.words)
        return tuple(value)


@dataclass(frozen=True)
class Instance(Parameter[Any]):
    """An object of one of some classes."""

    types: tuple[type, ...]

    def check(self, value: Any) -> Any:
        """Return it."""
        _native.check_instance(self.name, value, *self.types)
        return value


@dataclass(frozen=True)
class Interval(Parameter[FloatArray]):
    """Two finite numbers; with ``above`` ascending and greater than it."""

    above: float | None = None

    def check(self, value: Any) -> FloatArray:
        """Return an array of two."""
        if isinstance(value, (bool, np.bool_, str, bytes)) or value is None:
            raise InputError(f"{self.name} = {_native.shown(value)}: must be two numbers")
        ends = _native.real_array(self.name, value)
        if ends.shape != (2,):
            raise InputError(f"{self.name} = {_native.shown(value)}: must be two numbers")
        if self.above is not None and not self.above < ends[0] < ends[1]:
            raise InputError(f"{self.name}: must be two numbers, {self.above:g} < from < to")
        return ends


@dataclass(frozen=True)
class FilePath(Parameter[str]):
    """The path of a file."""

    def check(self, value: Any) -> str:
        """Return it as a text that the system takes."""
        try:
            path = os.fsdecode(value)
            length = len(os.fsencode(path))
        except (TypeError, ValueError):
            raise InputError(f"{self.name} = {_native.shown(value)}: must be a path") from None
        if not path or "\0" in path or length > _MAX_PATH:
            raise FileError(f"{self.name} = {_native.shown(value)}: is no path of a file")
        return path


@dataclass(frozen=True)
class Optional(Parameter[Any]):
    """None, or what another record allows."""

    of: Parameter[Any]

    @classmethod
    def or_none(cls, of: Parameter[Any]) -> "Optional":
        """Allow None besides."""
        return cls(of.name, of)

    def check(self, value: Any) -> Any:
        """Return None or the value."""
        return None if value is None else self.of.check(value)


#: What the methods that follow a branch share, and what they may do or not.
TOLERANCE = Number("tolerance", 1e-14, 0.1)
MAX_POINTS = Whole("max_points", 2, 100_000)
MAX_STEP = Number("max_step", 1e-4, 1)
STABILITY, SYMMETRIC, OPPOSITE = Flag("stability"), Flag("symmetric"), Flag("opposite")


def checked(table: Iterable[Parameter[Any]], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments that a table names, checked in its order."""
    return {one.name: one.check(given[one.name]) for one in table}


class Form(Generic[_R]):
    """One of the forms in which a function may be called, chosen by its first argument.

    Arguments that the form does not have are refused by name: Python's own words would name a
    function that nobody called.
    """

    def __init__(self, function: Callable[..., _R], called: str, whose: str) -> None:
        self._function, self._called, self._whose = function, called, whose
        arguments = signature(function).parameters.values()
        self._names = tuple(one.name for one in arguments)
        self._known = frozenset(self._names)
        self._most = sum(one.kind is not _Argument.KEYWORD_ONLY for one in arguments)
        self._needed = tuple(one.name for one in arguments if one.default is _Argument.empty)
        self.__doc__ = function.__doc__

    def __call__(self, arguments: Sequence[Any], options: Mapping[str, Any]) -> _R:
        """Call the function, once the names fit."""
        n = len(arguments)
        if not (n <= self._most and self._known.issuperset(options)):
            self._refuse(arguments, options)
        if not options.keys().isdisjoint(self._names[:n]):
            twice = next(name for name in self._names[:n] if name in options)
            raise InputError(f"{self._called}: {twice}: is given twice")
        for name in self._needed[n:]:
            if name not in options:
                raise InputError(f"{self._called}: {name}: must be given for {self._whose}")
        return self._function(*arguments, **options)

    def _refuse(self, arguments: Sequence[Any], options: Mapping[str, Any]) -> None:
        if len(arguments) > self._most:
            raise InputError(
                f"{self._called}: {len(arguments)} arguments without a name, must be at most "
                f"{self._most} for {self._whose}"
            )
        unknown = next(name for name in options if name not in self._known)
        raise InputError(
            f"{self._called}: {unknown}: is no argument for {self._whose}, must be one of "
            f"{', '.join(self._names)}"
        )
