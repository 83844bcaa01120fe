"""Parameters of public calls as records with name, type, bounds and words.

A record defines the allowed values of an argument; `checked` checks arguments with a table of
records. All errors have the form ``name = value: must be ...``.
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache, wraps
from inspect import Parameter as SignatureParameter, signature
from operator import is_
from typing import Any, Generic, TypeVar

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.curve_options import OPTIONS, WHOLE
from viscovib.errors import FileError, InputError

_F = TypeVar("_F", bound=Callable[..., Any])
_T = TypeVar("_T")
_MAX_PATH = 4096


def no_frequency(nu: float | None) -> InputError:
    """Return the error of an oscillating load whose frequency is missing or not positive."""
    if nu is None:
        return InputError(
            "nu: must be given with a load: its circular frequency (a constant load is "
            "load={0: ...})"
        )
    return InputError(f"nu = {nu:g}: must be greater than 0 with a load of order 1 or more")


@dataclass(frozen=True)
class Parameter(ABC, Generic[_T]):
    """An argument with its name and allowed values."""

    name: str

    @abstractmethod
    def check(self, value: Any) -> _T:
        """Return the value in its type, or raise an error."""


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
        """Text on the allowed values."""
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
    """Write a bound: a small one as 1e-4, a large one as 1e30."""
    if bound == 0 or 0.01 <= abs(bound) < 1e15:
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
    """Several texts, each one of ``words`` if given."""

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
        """Return the path as text for the system."""
        try:
            path = os.fsdecode(value)
            length = len(os.fsencode(path))
        except (TypeError, ValueError):
            raise InputError(f"{self.name} = {_native.shown(value)}: must be a path") from None
        if not path or "\0" in path or length > _MAX_PATH:
            raise FileError(f"{self.name} = {_native.shown(value)}: is not a path of a file")
        return path


@dataclass(frozen=True)
class Optional(Parameter[Any]):
    """None, or what another record allows."""

    of: Parameter[Any]

    @classmethod
    def or_none(cls, of: Parameter[Any]) -> Optional:
        """Also allow None."""
        return cls(of.name, of)

    def check(self, value: Any) -> Any:
        """Return None or the value."""
        return None if value is None else self.of.check(value)


_limits = _native.run("branch limits")
_lowest, _highest = _limits["tolerance"].tolist()
_lowest_in_time, _highest_in_time = _limits["time_tolerance"].tolist()
NEARLY_NOTHING: float = _limits["nearly_nothing"]
#: Highest harmonic of a periodic motion; for free motions of a pendulum, first and largest selected
#: number. All bounds here are those of the core.
MAX_HARMONICS: int = _limits["harmonics"]
FIRST_FREE: int = _limits["first_free"]
MOST_FREE: int = _limits["most_free"]
#: Options of several methods: the relative size of the last correction, ...
TOLERANCE = Number("tolerance", _lowest, _highest)
#: ... its alias, and the absolute tolerance, ...
_RELATIVE = Number("rtol", _lowest, _highest)
ATOL = Number("atol", 0, 1e30)
MAX_ITERATIONS = Whole("max_iterations", 1, _limits["iterations"])
#: ... switches, ...
STABILITY, SYMMETRIC, OPPOSITE = Flag("stability"), Flag("symmetric"), Flag("opposite")
PROGRESS = Flag("progress")
#: ... periods of a motion in periods of the loads, multiples of a base frequency, ...
SUBHARMONIC, MAX_DENOMINATOR = Whole("subharmonic", 1, 20), Whole("max_denominator", 1, 99)
#: ... and the averaging time of growth rates.
DURATION = Number("duration", 1, 1e6)
#: Errors of motions in time.
TIME_TOLERANCE = Number("tolerance", _lowest_in_time, _highest_in_time)
RTOL = Number("rtol", _lowest_in_time, _highest_in_time)


#: Options of curves of motions with their defaults, their bounds, ...
CURVE_DEFAULTS = {name: one.default for name, one in OPTIONS.items()}
_CURVE_BOUNDS: tuple[Parameter[Any], ...] = tuple(
    Whole(name, int(one.lowest), int(one.highest))
    if name in WHOLE
    else Number(name, one.lowest, one.highest)
    for name, one in OPTIONS.items()
)
#: ... and the outcomes of curves.
CURVE_OUTCOMES = tuple(_limits["endings"].split(","))

#: Tolerances of steady motions if none is given: of smooth forces, and of laws with corners, whose
#: harmonics decrease slowly. These bounds are those of the core.
SMOOTH_TOLERANCE: float = _limits["smooth_tolerance"]
CORNER_TOLERANCE: float = _limits["corner_tolerance"]


@dataclass(frozen=True)
class CurveOptions:
    """Options of the continuation of any curve of motions, with the names of the core."""

    values: Mapping[str, float]

    @classmethod
    def checked(cls, given: Mapping[str, Any]) -> CurveOptions:
        """Check all options."""
        return cls(checked(_CURVE_BOUNDS, given))

    @property
    def tolerance(self) -> float:
        """Relative size of the last correction."""
        return self.values["tolerance"]

    @property
    def max_points(self) -> int:
        """Largest number of points."""
        return int(self.values["max_points"])

    def along(self, start: float, finish: float, **more: Any) -> dict[str, Any]:
        """Return the options as values for tasks of the core, with start and end of the curve."""
        return {**self.values, "start": float(start), "finish": float(finish), **more}


def for_recent_options(find: Callable[..., _T]) -> Callable[..., _T]:
    """Keep the results of a check of options, which most calls repeat; they must not be changed."""
    known = lru_cache(maxsize=64, typed=True)(find)

    @wraps(find)
    def found(*options: Any) -> _T:
        try:
            return known(*options)
        except TypeError:
            # An option that is not a number or word has no hash.
            return find(*options)

    return found


def checked(table: Iterable[Parameter[Any]], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of a table, checked in its order."""
    return {one.name: one.check(given[one.name]) for one in table}


#: Kinds of systems, as `Taken` calls them.
OSCILLATOR, PENDULUM = "a mount, a polynomial system or a structure", "a pendulum"


def with_rtol(given: dict[str, Any], usual: float = SMOOTH_TOLERANCE) -> dict[str, Any]:
    """Replace ``tolerance`` by ``rtol`` in the arguments of a public function.

    ``usual``: default tolerance.
    """
    rtol = given["rtol"]
    if rtol is None and given["tolerance"] is None:
        given["tolerance"] = usual
    if rtol is not None:
        if given["tolerance"] is not None:
            raise InputError(
                "tolerance, rtol: tolerance is another name for rtol, give only one of them"
            )
        given["tolerance"] = _RELATIVE.check(rtol)
        given["rtol"] = None
    return given


def with_curve_options(function: _F) -> _F:
    """Insert the options of curves into signature and docstring of a function, for ``**curve``.

    They replace the line ``**curve`` of the docstring.
    """
    whole = signature(function)
    own = [
        one for one in whole.parameters.values() if one.kind is not SignatureParameter.VAR_KEYWORD
    ]
    named = [
        SignatureParameter(
            name,
            SignatureParameter.KEYWORD_ONLY,
            default=one.default,
            annotation=int if name in WHOLE else float | None if one.default is None else float,
        )
        for name, one in OPTIONS.items()
    ]
    function.__signature__ = whole.replace(parameters=[*own, *named])  # type: ignore[attr-defined]
    if function.__doc__:
        function.__doc__ = function.__doc__.replace("    **curve\n", _documented())
    return function


def _documented() -> str:
    """Return the documentation of the options of curves for a docstring."""
    from textwrap import indent, wrap

    lines = []
    for name, one in OPTIONS.items():
        if one.text:
            text = f"{one.text} {_spelt(one.lowest)} to {_spelt(one.highest)}."
            lines.append(f"{name} : {'int' if name in WHOLE else 'float'}")
            lines += [f"    {line}" for line in wrap(text, 92)]
    return indent("\n".join(lines) + "\n", "    ")


def with_curve(
    given: dict[str, Any], called: str, usual: float = SMOOTH_TOLERANCE
) -> dict[str, Any]:
    """Add the options of ``**curve`` to the other arguments, with their defaults."""
    curve = given.pop("curve")
    for name in curve.keys() - OPTIONS.keys():
        raise TypeError(f"{called}() got an unexpected keyword argument {name!r}")
    return with_rtol(given | CURVE_DEFAULTS | curve, usual)


class Taken:
    """The arguments of a public function for one kind of system: those of an inner function.

    All other arguments must have their defaults; other values are refused by name.
    """

    def __init__(self, public: Callable[..., Any], inner: Callable[..., Any], whose: str) -> None:
        arguments = signature(public).parameters
        self._called, self._whose = public.__name__, whose
        # `**curve` represents all options of curves.
        self._names = tuple(
            name
            for one in signature(inner).parameters.values()
            for name in (CURVE_DEFAULTS if one.kind is one.VAR_KEYWORD else (one.name,))
        )
        further = [one for name, one in arguments.items() if name not in self._names]
        self._further = tuple(one.name for one in further)
        self._defaults = tuple(one.default for one in further)

    def of(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return the arguments of the inner function from all of the public one."""
        # This is part of every call: without Python loops it takes half the time.
        value = given.__getitem__
        if not all(map(is_, map(value, self._further), self._defaults)):
            self._refuse(given)
        return dict(zip(self._names, map(value, self._names), strict=True))

    def _refuse(self, given: Mapping[str, Any]) -> None:
        """Refuse values that differ from the default (a different object may be equal)."""
        for name, default in zip(self._further, self._defaults, strict=True):
            value = given[name]
            if type(value) is not type(default) or value != default:
                raise InputError(
                    f"{self._called}: {name}: is not an argument for {self._whose}, must be one of "
                    f"{', '.join(self._names)}"
                )
