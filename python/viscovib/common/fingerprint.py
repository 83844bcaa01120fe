"""What a function is, in a form that can be compared after a restart.

A checkpoint must not be filled by another function than the one that began it. Compared are the
compiled code, default arguments, closure variables and the globals that the code names: functions
of the same module by their own code, other functions and modules by name, data by content.
"""

import dataclasses
import dis
import functools
import hashlib
import sys
import types
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

_DEEPEST = 12
_PLAIN = (int, float, complex, str, bytes, bool, type(None), type(Ellipsis))


def describe(function: Callable[..., Any]) -> dict[str, str]:
    """Digests of everything that the function consists of, by what they are digests of."""
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
    """Digest of a value by its content; functions of ``module`` by their code."""
    feed = hashlib.sha256()
    _walk(value, feed.update, module, (), 0)
    return feed.hexdigest()[:24]


def _walk(
    value: Any, put: Callable[[bytes], None], module: str | None, above: tuple[int, ...], depth: int
) -> None:
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
            _walk(key, put, module, above, depth)
            _walk(item, put, module, above, depth)
    elif isinstance(value, (set, frozenset)):
        for text in sorted(digest(item, module) for item in value):
            put(text.encode())
    elif isinstance(value, (list, tuple)):
        for item in value:
            _walk(item, put, module, above, depth)
    elif isinstance(value, types.FunctionType) and value.__module__ == module:
        put(_code(value.__code__).encode())
        around = _defaults(value) | _surroundings(value)
        _walk(around, put, module, above, depth)
    elif isinstance(value, (types.ModuleType, type)) or (callable(value) and not _state(value)):
        name = getattr(value, "__qualname__", getattr(value, "__name__", ""))
        put(f"{getattr(value, '__module__', '')}.{name}".encode())
    else:
        _walk(_state(value) or repr(value).split(" at 0x")[0], put, module, above, depth)
    put(b")")


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
    """Digest of what the code does: neither its place in a file nor its documentation."""
    feed = hashlib.sha256()
    for step in dis.get_instructions(code):
        feed.update(f"{step.opname} {_constant(step.argval)};".encode())
    feed.update(repr((code.co_argcount, code.co_kwonlyargcount, code.co_varnames)).encode())
    return feed.hexdigest()[:24]


def _constant(value: Any) -> str:
    """Text of a constant in code; sets in an order that does not change from run to run."""
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
    """Closure variables and globals by name; names that stand for nothing are left out."""
    found: dict[str, Any] = {}
    for name in sorted(_names(function.__code__)):
        if name in function.__globals__:
            found[name] = function.__globals__[name]
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            found[name] = cell.cell_contents
        except ValueError:
            continue
    return found


def _names(code: types.CodeType) -> set[str]:
    names = {
        str(step.argval)
        for step in dis.get_instructions(code)
        if step.opname in ("LOAD_GLOBAL", "LOAD_NAME")
    }
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            names |= _names(constant)
    return names
