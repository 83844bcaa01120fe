"""Errors and warnings of the public interface."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterable, Sequence
from types import FunctionType, ModuleType
from typing import Any, TypeVar

_F = TypeVar("_F", bound=Callable[..., Any])
#: Largest length of a message.
_LONGEST = 1900


def one_line(text: str) -> str:
    """Return a text without control characters, which file names may contain."""
    return re.sub(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]", "?", text)


class ViscovibError(Exception):
    """Base class of all errors of viscovib; the text is one line."""

    def __str__(self) -> str:
        text = one_line(super().__str__())
        return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 600]} ... {text[-500:]}"


class InputError(ViscovibError, ValueError):
    """Wrong input: the message names the argument, its value and what is allowed."""


class FileError(ViscovibError, OSError):
    """A file cannot be read or written."""


class ConvergenceWarning(UserWarning):
    """Some points of a result were not found (NaN), or the accuracy is lower than requested."""


class StabilityWarning(UserWarning):
    """Stability is unknown, a system creeps away from rest, or units or matrices seem wrong."""


class SweepError(ViscovibError):
    """A point of a sweep failed: the message contains its parameters, also in ``point``."""

    def __init__(self, message: str, point: dict[str, Any] | None = None) -> None:
        super().__init__(message)
        self.point = dict(point or {})


class RangeWarning(UserWarning):
    """A result is outside the valid range of its expansion or of floating-point numbers."""


def near_name(wrong: str, known: Iterable[str]) -> str:
    """Return a hint with the most similar known name, or all known names."""
    known = list(known)
    near = nearest(wrong, known)
    return f"did you mean {near}?" if near else f"must be one of {', '.join(known)}"


#: Words of textbooks and other programs, each with option words of the same meaning.
_SYNONYMS = {
    "harmonic balance": ("newton",),
    "harmonicbalance": ("newton",),
    "balance": ("newton",),
    "hb": ("newton",),
    "hbm": ("newton",),
    "aft": ("newton",),
    "newton-raphson": ("newton",),
    "picard": ("successive",),
    "fixed point": ("successive",),
    "fixed-point": ("successive",),
    "iteration": ("successive",),
    "perturbation": ("successive",),
    "runge-kutta": ("rk4",),
    "dopri": ("dop8",),
    "dopri5": ("dop8",),
    "rk45": ("dop8",),
    "dop853": ("dop8",),
    "radau": ("gauss8",),
    "maxwell": ("prony",),
    "zener": ("fractional_zener",),
    "power law": ("abel",),
    "spline": ("cubic",),
    "end": ("last",),
    "final": ("last",),
    "rising": ("up",),
    "positive": ("up",),
    "falling": ("down",),
    "negative": ("down",),
    "hanning": ("hann",),
    "none": ("rectangular",),
    "boxcar": ("rectangular",),
    "decibel": ("db",),
    "angle": ("phase",),
    "rad": ("rad/s",),
    "omega": ("nu", "rad/s"),
    "freq": ("nu", "hz"),
    "frequency": ("nu", "hz"),
}


def nearest(wrong: str, known: Iterable[str]) -> str | None:
    """Return the most similar word, ignoring case; None if no word is similar."""
    from difflib import get_close_matches

    known = list(known)
    word = wrong.strip().lower()
    for meant in _SYNONYMS.get(word, ()):
        if meant in known:
            return meant
    lower = {one.lower(): one for one in known}
    if len(word) == 1:
        return lower.get(word)  # a symbol: other symbols are not near
    near = get_close_matches(word, lower, n=1)
    return lower[near[0]] if near else None


def no_attribute(name: str, known: Iterable[str]) -> AttributeError:
    """Return the error of an unknown name of the package, with the most similar name."""
    near = "" if name.startswith("_") else near_name(name, known)
    meant = f": {near}" if near.startswith("did you mean") else ""
    return AttributeError(f"module 'viscovib' has no attribute {name!r}{meant}", name=name)


def named_near(module: ModuleType, name: str) -> Any:
    """Return a public name of a module; errors of misspelt keywords suggest similar names."""
    value = getattr(module, name)
    if isinstance(value, FunctionType):
        value = _naming_near(value)
        # Replace it in the module too, because pickle refers to functions by their module.
        setattr(module, name, value)
    elif isinstance(value, type) and "__init__" in vars(value):
        value.__init__ = _naming_near(value.__init__)  # type: ignore[misc]
    return value


def _naming_near(function: _F) -> _F:
    """Return the function with a TypeError that suggests similar keywords."""

    @functools.wraps(function)
    def called(*args: Any, **options: Any) -> Any:
        try:
            return function(*args, **options)
        except TypeError as error:
            if text := _misspelt(function, options) or _unnamed(function, args):
                said = str(error.args[0]).replace(".__init__()", "()")
                raise TypeError(f"{said}: {text}") from None
            raise

    return called  # type: ignore[return-value]


class NearNames:
    """Base of classes whose methods suggest similar names of misspelt keywords."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        for name, function in list(vars(cls).items()):
            if isinstance(function, FunctionType) and not name.startswith("_"):
                setattr(cls, name, _naming_near(function))


def _unnamed(function: Callable[..., Any], given: Sequence[Any]) -> str:
    """Hint for too many positional arguments; empty if there are not too many."""
    import inspect

    parameters = list(inspect.signature(function).parameters.values())
    if any(p.kind is p.VAR_POSITIONAL for p in parameters):
        return ""
    positional = sum(p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD) for p in parameters)
    by_name = [f"{p.name}=" for p in parameters if p.kind is p.KEYWORD_ONLY]
    return f"give {', '.join(by_name)} by name" if by_name and len(given) > positional else ""


def _misspelt(function: Callable[..., Any], options: Iterable[str]) -> str:
    """Hint for the first unknown keyword; empty if all are known."""
    import inspect

    parameters = inspect.signature(function).parameters
    if any(p.kind is p.VAR_KEYWORD for p in parameters.values()):
        return ""
    wrong = [name for name in options if name not in parameters]
    known = [name for name in parameters if name != "self"]
    return near_name(wrong[0], known) if wrong and known else ""


#: Python modules between a call and the package: cached properties, wrappers, contexts.
_BETWEEN = frozenset({"viscovib", "functools", "contextlib"})


def caller() -> int:
    """Return the ``stacklevel`` at which a warning names the line that called the package.

    Python 3.12 has ``skip_file_prefixes`` for this; older versions are supported too.
    """
    import sys

    level, frame = 1, sys._getframe(1)
    while (
        frame.f_back is not None
        and str(frame.f_globals.get("__name__")).partition(".")[0] in _BETWEEN
    ):
        level, frame = level + 1, frame.f_back
    return level
