"""Fingerprints of functions that can be compared after a restart.

A checkpoint must not be continued by a different function. The fingerprint includes the compiled
code, default arguments, closure variables and the globals that the code names, including attributes
of modules and imports inside the function. Functions and classes of the user's modules are compared
by their code, also those that they name; functions of installed packages and of Python by name;
data by content.
"""

import dataclasses
import dis
import functools
import hashlib
import importlib
import sys
import sysconfig
import types
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

_DEEPEST = 12
_OF_PYTHON = [Path(sysconfig.get_path(name)).resolve() for name in ("stdlib", "platstdlib")]
_CLASS_DATA = (int, float, complex, str, bytes, tuple, list, dict, np.ndarray)
_PLAIN = (int, float, complex, str, bytes, bool, type(None), type(Ellipsis))


def describe(function: Callable[..., Any]) -> dict[str, str]:
    """Digests of all parts of a function, by the names of the parts."""
    parts: dict[str, str] = {"python": f"{sys.version_info[0]}.{sys.version_info[1]}"}
    called: Any = function
    while isinstance(called, functools.partial):
        for i, value in enumerate(called.args):
            parts[f"bound argument {i}"] = digest(value)
        for name, value in called.keywords.items():
            parts[f"bound argument {name!r}"] = digest(value)
        called = called.func
    if isinstance(called, types.MethodType):
        parts["object it is bound to"] = digest(called.__self__)
        called = called.__func__
    if not isinstance(called, types.FunctionType):
        parts["object"] = digest(called)
        method = vars(type(called)).get("__call__")
        if not isinstance(method, types.FunctionType):
            return parts
        called = method
    parts["code"] = _code(called.__code__)
    for name, value in _defaults(called).items():
        parts[f"default of {name!r}"] = digest(value)
    for name, value in _surroundings(called).items():
        parts[f"value of {name!r}"] = digest(value, called.__module__)
    return parts


def digest(value: object, module: str | None = None) -> str:
    """Digest of a value by its content; functions of ``module`` by their code, installed or not."""
    feed = hashlib.sha256()
    walk = _Walk(feed.update, module)
    walk.to(value, (), 0)
    # A queue instead of recursion: functions that call each other form long chains.
    for function in walk.waiting:
        walk.enter(function)
    return feed.hexdigest()[:24]


@dataclasses.dataclass
class _Walk:
    """Traversal of a value and its content."""

    put: Callable[[bytes], None]
    #: Module whose functions are always compared by their code.
    module: str | None
    #: Functions and classes found, without duplicates.
    waiting: list[Any] = dataclasses.field(default_factory=list)

    def to(self, value: Any, above: tuple[int, ...], depth: int) -> None:
        put = self.put
        if isinstance(value, _PLAIN):
            put(f"{type(value).__name__}:{value!r};".encode())
            return
        put(f"{type(value).__module__}.{type(value).__qualname__}(".encode())
        if id(value) in above or depth > _DEEPEST:
            put(b"...)")
            return
        above, depth = (*above, id(value)), depth + 1
        if isinstance(value, (np.ndarray, np.generic)):
            array = np.asarray(value)
            put(f"{array.dtype.str}{array.shape}".encode())
            plain = array.dtype.hasobject or array.dtype.kind == "T"
            put(repr(array.tolist()).encode() if plain else np.ascontiguousarray(array).tobytes())
        elif isinstance(value, Mapping):
            for key, item in value.items():
                self.to(key, above, depth)
                self.to(item, above, depth)
        elif isinstance(value, (set, frozenset)):
            for text in sorted(digest(item, self.module) for item in value):
                put(text.encode())
        elif isinstance(value, (list, tuple)):
            for item in value:
                self.to(item, above, depth)
        elif isinstance(value, (types.FunctionType, type)) and self._is_own(value.__module__):
            self._meet(value)
        elif isinstance(value, (types.ModuleType, type)) or (callable(value) and not _state(value)):
            name = getattr(value, "__qualname__", getattr(value, "__name__", ""))
            put(f"{getattr(value, '__module__', '')}.{name}".encode())
        else:
            self.to(_state(value) or repr(value).split(" at 0x")[0], above, depth)
            if self._is_own(type(value).__module__):
                self._meet(type(value))
        put(b")")

    def _is_own(self, name: str | None) -> bool:
        return name is not None and (name == self.module or _yours(name))

    def _meet(self, value: Any) -> None:
        self.put(value.__qualname__.encode())
        if not any(value is other for other in self.waiting):
            self.waiting.append(value)

    def enter(self, value: Any) -> None:
        """Add a function by its code and names, or a class by its definitions and bases."""
        if isinstance(value, types.FunctionType):
            self.put(_code(value.__code__).encode())
            self.to(_defaults(value) | _surroundings(value), (), 0)
            return
        for base in value.__bases__:
            self.to(base, (), 0)
        for name, item in sorted(vars(value).items()):
            for part in _parts(item):
                data = isinstance(part, _CLASS_DATA) and not name.startswith("__")
                method = isinstance(part, types.FunctionType)
                if data or (method and part.__module__ == value.__module__):
                    self.put(name.encode())
                    self.to(part, (), 0)


def _parts(item: Any) -> tuple[Any, ...]:
    """The functions of a class attribute, or the attribute."""
    if isinstance(item, (staticmethod, classmethod)):
        return (item.__func__,)
    if isinstance(item, property):
        return (item.fget, item.fset, item.fdel)
    if isinstance(item, functools.cached_property):
        return (item.func,)
    return (item,)


@functools.cache
def _yours(name: str) -> bool:
    """True if a module is neither installed nor part of Python, so its code may change."""
    if name.partition(".")[0] == "viscovib":
        return False
    file = getattr(sys.modules.get(name), "__file__", None)
    if file is None:
        return name == "__main__"
    path = Path(file).resolve()
    return not (
        {"site-packages", "dist-packages"} & set(path.parts)
        or any(path.is_relative_to(place) for place in _OF_PYTHON)
    )


def _state(value: Any) -> dict[str, Any]:
    """Attributes of an object."""
    if isinstance(value, (types.FunctionType, types.BuiltinFunctionType)):
        return {}
    if dataclasses.is_dataclass(value):
        return {field.name: getattr(value, field.name, None) for field in dataclasses.fields(value)}
    if isinstance(value, functools.partial):
        return {"func": value.func, "args": value.args, "keywords": value.keywords}
    return dict(getattr(value, "__dict__", {}))


def _code(code: types.CodeType) -> str:
    """Digest of code without its location in a file and its documentation."""
    feed = hashlib.sha256()
    for step in dis.get_instructions(code):
        feed.update(f"{step.opname} {_constant(step.argval)};".encode())
    feed.update(repr((code.co_argcount, code.co_kwonlyargcount, code.co_varnames)).encode())
    return feed.hexdigest()[:24]


def _constant(value: Any) -> str:
    """Text of a constant in code; sets have the same order in every run."""
    if isinstance(value, types.CodeType):
        return _code(value)
    if isinstance(value, frozenset):
        return f"{{{', '.join(sorted(map(_constant, value)))}}}"
    if isinstance(value, tuple):
        return f"({', '.join(map(_constant, value))})"
    return repr(value)


def _defaults(function: types.FunctionType) -> dict[str, Any]:
    code, given = function.__code__, function.__defaults__ or ()
    positional = code.co_varnames[: code.co_argcount]
    named = dict(zip(positional[len(positional) - len(given) :], given, strict=True))
    return named | (function.__kwdefaults__ or {})


def _surroundings(function: types.FunctionType) -> dict[str, Any]:
    """Closure variables and globals by name, without undefined names."""
    found: dict[str, Any] = {}
    named, attributes, imported = _names(function.__code__)
    for name in sorted(named):
        if name in function.__globals__:
            found[name] = function.__globals__[name]
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            found[name] = cell.cell_contents
        except ValueError:
            continue
    for level, name in sorted(imported):
        # A failed import raises its error when the function is called.
        with suppress(Exception):
            package = function.__globals__.get("__package__")
            found[f"import {name}"] = importlib.import_module("." * level + name, package)
    for name, value in list(found.items()):
        if isinstance(value, types.ModuleType):
            found |= _taken(name, value, attributes)
    return found


def _taken(name: str, module: types.ModuleType, attributes: set[str]) -> dict[str, Any]:
    """Attributes that code may use from a module of the user and from its modules, by name."""
    found: dict[str, Any] = {}
    if not _yours(module.__name__):
        return found
    for attribute in sorted(attributes & vars(module).keys()):
        value = vars(module)[attribute]
        found[f"{name}.{attribute}"] = value
        if isinstance(value, types.ModuleType) and name.count(".") < _DEEPEST:
            found |= _taken(f"{name}.{attribute}", value, attributes)
    return found


def _names(code: types.CodeType) -> tuple[set[str], set[str], set[tuple[int, str]]]:
    """Globals, attributes, and modules with their levels in code."""
    named: set[str] = set()
    attributes: set[str] = set()
    imported: set[tuple[int, str]] = set()
    level = 0
    for step in dis.get_instructions(code):
        if step.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
            named.add(str(step.argval))
        elif step.opname in ("LOAD_ATTR", "LOAD_METHOD", "IMPORT_FROM"):
            attributes.add(str(step.argval))
        elif step.opname == "IMPORT_NAME":
            imported.add((level, str(step.argval)))
        elif step.opname in ("LOAD_CONST", "LOAD_SMALL_INT") and isinstance(step.argval, int):
            level = step.argval
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            for mine, other in zip((named, attributes, imported), _names(constant), strict=True):
                mine |= other  # type: ignore[operator]
    return named, attributes, imported
