"""The only importer of the compiled core: checks arrays before each call, raises after it.

f2py checks shapes on one side only, truncates numbers to integers and copies silently, so every
argument is brought to its exact type, shape and memory order here.
"""

import math
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _viscovib  # type: ignore[attr-defined]
from viscovib.errors import FileError, InputError

#: The compiled core: flat routines, typed by nothing but this module.
core: Any = _viscovib

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

_IO_ERROR = 3


def number(name: str, value: object) -> float:
    """Return ``value`` as a finite float, or say what it should have been."""
    if isinstance(value, (bool, np.bool_, str, bytes)) or value is None:
        raise InputError(f"{name} = {shown(value)}: must be a real number")
    try:
        result = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name} = {shown(value)}: must be a real number") from None
    if not math.isfinite(result):
        raise InputError(f"{name} = {result}: must be a finite number")
    return result


def integer(name: str, value: object, lowest: int, highest: int) -> int:
    """Return ``value`` as an int in [lowest, highest]."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
        raise InputError(f"{name} = {shown(value)}: must be an integer")
    if not lowest <= value <= highest:
        raise InputError(f"{name} = {value}: must be {lowest} to {highest}")
    return int(value)


def choice(name: str, value: object, allowed: tuple[str, ...]) -> str:
    """Return ``value`` if it is one of the allowed words."""
    if not isinstance(value, str) or value not in allowed:
        words = ", ".join(repr(word) for word in allowed)
        raise InputError(f"{name} = {shown(value)}: must be one of {words}")
    return value


def real_array(name: str, value: object, *, ndim: int | None = None) -> FloatArray:
    """Return finite real numbers as a C-contiguous float64 array."""
    array = _array(name, value)
    if array.dtype.kind == "c":
        raise InputError(f"{name}: must be real, got complex numbers")
    return _checked(name, array.astype(np.float64, copy=False), ndim)


def complex_array(name: str, value: object, *, ndim: int | None = None) -> ComplexArray:
    """Return finite complex numbers as a C-contiguous complex128 array."""
    return _checked(name, _array(name, value).astype(np.complex128, copy=False), ndim)


def _array(name: str, value: object) -> npt.NDArray[Any]:
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):
        raise InputError(f"{name}: must be an array of numbers of one shape") from None
    if array.dtype.kind not in "iufc":
        raise InputError(f"{name} = {shown(value)}: must be numbers, got {array.dtype}")
    return array


def _checked(name: str, array: npt.NDArray[Any], ndim: int | None) -> npt.NDArray[Any]:
    if ndim is not None and array.ndim != ndim:
        raise InputError(f"{name}: must have {ndim} dimension(s), got shape {array.shape}")
    finite = np.isfinite(array)
    if not finite.all():
        where = tuple(int(i) for i in np.argwhere(~finite)[0])
        place = f"[{', '.join(map(str, where))}]" if where else ""
        raise InputError(f"{name}{place} = {array[where]}: must be a finite number")
    return np.asarray(array, order="C")


def flag(name: str, value: object) -> bool:
    """Return ``value`` if it is True or False."""
    if not isinstance(value, (bool, np.bool_)):
        raise InputError(f"{name} = {shown(value)}: must be True or False")
    return bool(value)


def is_auto(value: object) -> bool:
    """Whether ``value`` is the word "auto"."""
    return isinstance(value, str) and value == "auto"


def check_instance(name: str, value: object, *types: type) -> None:
    """Refuse what is of none of these types."""
    if not isinstance(value, types):
        names = [one.__name__ for one in types]
        allowed = " or ".join(f"a{'n' if name[0] in 'AEIOU' else ''} {name}" for name in names)
        raise InputError(f"{name} = {shown(value)}: must be {allowed}")


def several(name: str, value: Any, *types: type) -> list[Any]:
    """Return one or more of these types as a list."""
    if isinstance(value, types):
        return [value]
    if not isinstance(value, (list, tuple)):
        check_instance(name, value, *types)
    if not value:
        raise InputError(f"{name}: must not be empty")
    for i, one in enumerate(value):
        check_instance(f"{name}[{i}]", one, *types)
    return list(value)


def mapping(name: str, value: Any) -> Mapping[str, Any]:
    """Return ``value`` if it is a mapping."""
    if not isinstance(value, Mapping):
        raise InputError(f"{name} = {shown(value)}: must be a mapping of names to numbers")
    return value


def shown(value: object) -> str:
    """Return a value as messages show it: a line, not too long."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else text[:57] + "..."


def call(routine: Callable[..., tuple[Any, ...]], *arguments: object) -> tuple[Any, ...]:
    """Call a flat routine and turn its status into an exception."""
    *results, status, message = routine(*arguments)
    if status != 0:
        text = message.decode(errors="replace").strip()
        raise FileError(text) if status == _IO_ERROR else InputError(text)
    return tuple(results)


def call_interruptibly(
    routine: Callable[..., tuple[Any, ...]], cancel: npt.NDArray[np.intc], *arguments: object
) -> tuple[Any, ...]:
    """Call a flat routine that may take long in a thread, so that Ctrl-C is heard.

    ``cancel`` is among the arguments; the routine gives up once it holds 1.
    """
    pool = ThreadPoolExecutor(1)
    try:
        return pool.submit(call, routine, *arguments).result()
    finally:
        # Reached early by Ctrl-C, which may come at any point above.
        cancel[0] = 1
        pool.shutdown()
