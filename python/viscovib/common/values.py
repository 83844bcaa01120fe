"""Values: comparison field by field, copying, pickling and short printing."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from viscovib.errors import NearNames

#: Largest array size for which all numbers are printed.
_FEW = 6
#: Largest depth of nested lists that are copied.
_DEEPEST = 32


class Value(NearNames):
    """Base of frozen dataclasses with results."""

    def __eq__(self, other: object) -> bool:
        """True if all fields are equal (NaN equals NaN)."""
        if type(self) is not type(other):
            return NotImplemented
        return all(same(getattr(self, name), getattr(other, name)) for name in _public(self))

    def __hash__(self) -> int:
        """Hash of the printed form, which is the same for equal values."""
        return hash(repr(self))

    def __repr__(self) -> str:
        """Return the fields, with the shape and the range of long arrays."""
        return short_repr(self)


def short_repr(value: Any) -> str:
    """Return the name and the fields of a dataclass, with shape and range of long arrays."""
    fields = ", ".join(f"{name}={_short(getattr(value, name))}" for name in _public(value))
    return f"{type(value).__name__}({fields})"


def own(value: Any, deep: int = 0) -> Any:
    """Return a copy of an argument that the caller cannot change; arrays are read-only.

    ``deep``: depth of nesting. Deeper lists, or a list that contains itself, are not copied.
    """
    if deep > _DEEPEST:
        return value
    if isinstance(value, np.ndarray):
        array = np.array(value, subok=True)
        array.setflags(write=False)
        return array
    if type(value) in (list, tuple):
        return type(value)([own(one, deep + 1) for one in value])
    if type(value) is dict:
        return {key: own(one, deep + 1) for key, one in value.items()}
    # Matrices of SciPy and other containers of numbers, such as tables and buffers.
    holds = hasattr(value, "__array__") or hasattr(value, "toarray") or hasattr(value, "typecode")
    return copy.deepcopy(value) if holds else value


def own_fields(value: Any, *names: str) -> None:
    """Replace fields of a frozen dataclass (default: all arguments) by own copies."""
    given = names or [field.name for field in dataclasses.fields(value) if field.init]
    for name in given:
        object.__setattr__(value, name, own(getattr(value, name)))


def _public(value: Any) -> list[str]:
    return [field.name for field in dataclasses.fields(value) if not field.name.startswith("_")]


def same(one: Any, other: Any) -> bool:
    """True if two fields are equal."""
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        numbers = one.dtype.kind in "fc" and other.dtype.kind in "fc"
        return np.array_equal(one, other, equal_nan=numbers)
    if isinstance(one, (tuple, list)) and isinstance(other, (tuple, list)):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if type(one) is type(other) and dataclasses.is_dataclass(one) and not isinstance(one, Value):
        return all(same(getattr(one, n), getattr(other, n)) for n in _public(one))
    equal = one == other
    return bool(equal) or (one != one and other != other)


def _short(value: Any) -> str:
    if not isinstance(value, np.ndarray):
        text = repr(value)
        return text if len(text) <= 80 else f"{text[:77]}..."
    if value.size <= _FEW:
        return np.array2string(value, precision=6, separator=", ").replace("\n", "")
    ends = ""
    if value.dtype.kind in "fiu" and not np.isnan(value).all():
        ends = f", {np.nanmin(value):.6g} to {np.nanmax(value):.6g}"
    return f"<{' x '.join(map(str, value.shape))} numbers{ends}>"
