"""Job of a worker: run calls, and check how they end and what they return."""

import contextlib
import dataclasses
import gc
import hashlib
import importlib
import math
import traceback
import warnings
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse
import viscovib as vv
import xarray as xr
from calls import FILES, SOUND, public
from damage import checkpoint
from texts import texts

# A module whose import is interrupted would stay half initialized for all later calls.
for _late in ("dask.array", "matplotlib.pyplot"):
    with contextlib.suppress(ImportError):
        importlib.import_module(_late)

_PACKAGE = str(Path(vv.__file__).parent)
#: Warnings for users; other warnings are faults of the package.
_TOLD = (vv.ConvergenceWarning, vv.StabilityWarning, vv.RangeWarning)
#: Attributes that must be finite if a motion was found.
_HELD = ("coefficients", "state", "nu", "parameter", "omega", "frequencies", "t")
_WELL = ("converged", "completed")
#: Documented as possibly infinite or unknown.
_UNKNOWN = ("this.integral", "this.limit_amplitude", "this.growth_rate")
_MAKERS: dict[str, Any] = {}


class Odd:
    """An object that is no number; its conversion to an array fails."""

    def __array__(self, *_: object, **__: object) -> Any:
        raise RuntimeError("no array")


class Liar:
    """An object with an invalid length."""

    def __len__(self) -> int:
        return -1


def names() -> dict[str, Any]:
    """Names available to calls."""
    nested: list[Any] = []
    nested.append(nested)
    return {
        "vv": vv, "np": np, "sparse": scipy.sparse, "xr": xr,
        "nan": math.nan, "inf": math.inf, "Fraction": Fraction,
        "Decimal": Decimal, "Path": Path, "nested": nested, "Odd": Odd, "Liar": Liar,
    }  # fmt: skip


def call(text: str, files: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Run a call and return how it ended. ``files``: replaced files, bytes as Latin-1."""
    for name, content in FILES.items():
        Path(name).write_text(content)
    for name, content in (files or {}).items():
        Path(name).write_bytes(content.encode("latin-1"))
    *first, last = text.split("\n")
    space = names()
    with warnings.catch_warnings(record=True) as reported:
        warnings.simplefilter("always")
        np.seterr(all="warn", under="ignore")
        try:
            if first:
                maker = first[0].removeprefix("this = ")
                if maker not in _MAKERS:
                    _MAKERS[maker] = eval(maker, space)
                space["this"] = _MAKERS[maker]
            # Arguments are evaluated in the same line; their MemoryError is not a fault.
            value = eval(compile(last, "<call>", "eval"), space)
        except vv.ViscovibError as error:
            lines = str(error)
            if "\n" in lines or not lines or len(lines) > 2000:
                return _ending("message", lines)
            if lines.isspace() or lines.startswith(("u'", "(")):
                return _ending("message", lines)
            return _ending("refused with a line", lines)
        except Exception as error:
            return _ending(*_of_python(error, last))
        finally:
            _close_figures()
    for warning in reported:
        if not issubclass(warning.category, _TOLD) and _inside(warning.filename):
            where = f"{Path(warning.filename).name}:{warning.lineno}"
            return _ending("message", f"{warning.category.__name__} {where}: {warning.message}")
    try:
        fault = not_finite(last, value, space.get("this"))
    except Exception as error:
        # An attribute that is computed on access failed.
        return _ending(*_of_python(error, ""))
    if fault:
        return _ending("not finite", fault)
    return _ending("done with warnings" if reported else "done", type(value).__name__)


def _ending(verdict: str, detail: str) -> dict[str, Any]:
    return {"verdict": verdict, "detail": detail}


def _of_python(error: Exception, last: str) -> tuple[str, str]:
    """Verdict on an exception: raised by the text of the call, or inside the package."""
    frames = traceback.extract_tb(error.__traceback__)
    inside = [frame for frame in frames if _inside(frame.filename)]
    # errors.py only adds the intended keyword to a TypeError of Python.
    names = [Path(frame.filename).name for frame in inside]
    if not [name for name in names if name != "errors.py"]:
        # Raised while arguments were evaluated, or by Python for a wrong signature.
        return "refused with a line", f"{type(error).__name__}: {error}"
    of_caller = "lambda" in last and frames[-1].filename == "<call>"
    # Functions written in C have no frame.
    if of_caller or (isinstance(error, TypeError) and last.find("function=int") >= 0):
        # The exception was raised by a function of the caller and passed on.
        return "refused with a line", f"{type(error).__name__}: {error}"
    place = f"{Path(inside[-1].filename).name}:{inside[-1].lineno} {inside[-1].name}"
    return "exception", f"{type(error).__name__} at {place}: {str(error)[:300]}"


def _inside(filename: str) -> bool:
    return filename.startswith(_PACKAGE)


def _close_figures() -> None:
    import sys

    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


def not_finite(text: str, value: Any, this: Any) -> str:
    """Location of a non-finite number in a successful result; empty if there is none."""
    if isinstance(value, (float, complex, np.ndarray, np.inexact)):
        simple = isinstance(
            this, (vv.Kernel, vv.Mount, vv.Pendulum, vv.PolynomialSystem, type(None))
        )
        if simple and not text.startswith(_UNKNOWN) and not _finite(value):
            return f"{text.partition('(')[0]} gave {np.asarray(value).ravel()[:4]}"
        return ""
    outcome = getattr(value, "outcome", None)
    if outcome is None or not dataclasses.is_dataclass(value):
        return ""
    for name in _HELD:
        held = getattr(value, name, None)
        if not isinstance(held, np.ndarray) or held.dtype.kind not in "fc":
            continue
        if isinstance(outcome, str):
            if outcome in _WELL and not _finite(held):
                return f"{type(value).__name__}.{name} of a motion that is {outcome}"
        elif held.shape[:1] == outcome.shape and not _finite(held[np.isin(outcome, _WELL)]):
            return f"{type(value).__name__}.{name} where outcome is converged"
    return ""


def _finite(value: Any) -> bool:
    return bool(np.isfinite(np.asarray(value)).all())


def makers() -> dict[str, Any]:
    """For each public class expressions that create objects, from valid calls and their results."""
    classes = public().classes
    found: dict[str, list[str]] = {name: [] for name in classes}
    for name, content in FILES.items():
        Path(name).write_text(content)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for text in SOUND:
            value = eval(text, names())
            _note(found, classes, text, value, 2)
            _close_figures()
    return {"makers": {name: texts for name, texts in found.items() if texts}}


def _note(
    found: dict[str, list[str]], classes: dict[str, type], text: str, value: Any, deeper: int
) -> None:
    for name, kind in classes.items():
        if isinstance(value, kind) and len(found[name]) < 8 and text not in found[name]:
            found[name].append(text)
    if isinstance(value, tuple) and value:
        _note(found, classes, f"{text}[0]", value[0], deeper)
    if not deeper or not type(value).__module__.startswith("viscovib"):
        return
    for member in dir(value):
        if member.startswith("_") or callable(getattr(type(value), member, None)):
            continue
        try:
            held = getattr(value, member)
        except Exception:
            continue
        _note(found, classes, f"{text}.{member}", held, deeper - 1)
        if isinstance(held, tuple) and held:
            _note(found, classes, f"{text}.{member}[0]", held[0], deeper - 1)


def digest(value: Any) -> str:
    """Digest of a result, bitwise exact."""
    feed = hashlib.sha256()

    def walk(held: Any, deep: int) -> None:
        if deep > 6:
            return
        if isinstance(held, np.ndarray) and held.dtype != object:
            feed.update(f"{held.dtype}{held.shape}".encode() + np.ascontiguousarray(held).tobytes())
        elif isinstance(held, xr.Dataset):
            for name in held.variables:
                walk(held[name].values, deep + 1)
        elif isinstance(held, Mapping):
            for key, item in held.items():
                feed.update(repr(key).encode())
                walk(item, deep + 1)
        elif isinstance(held, (list, tuple)):
            for item in held:
                walk(item, deep + 1)
        elif dataclasses.is_dataclass(held):
            for field in dataclasses.fields(held):
                if not callable(getattr(held, field.name, None)):
                    walk(getattr(held, field.name, None), deep + 1)
        elif isinstance(held, (int, float, complex, str, np.generic)):
            feed.update(repr(held).encode())

    walk(value, 0)
    return feed.hexdigest()


def threads(texts: list[str], n: int) -> dict[str, Any]:
    """Run calls in sequence and in parallel: the results must agree bitwise."""
    for name, content in FILES.items():
        Path(name).write_text(content)

    def one(text: str) -> str:
        try:
            return digest(eval(text, names()))
        except vv.ViscovibError as error:
            return f"{type(error).__name__}: {error}"

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            alone = [one(text) for text in texts]
            pool = ThreadPoolExecutor(n)
            try:
                together = list(pool.map(one, texts))
            finally:
                pool.shutdown(wait=True, cancel_futures=True)
        except Exception as error:
            return _ending(*_of_python(error, ""))
    for text, a, b in zip(texts, alone, together, strict=True):
        if a != b:
            return _ending("not the same", f"alone {a}, at once {b}: {text}")
    return _ending("done", f"{len(texts)} calls in {n} threads")


def tidy() -> dict[str, Any]:
    """Release objects."""
    _MAKERS.clear()
    gc.collect()
    return {}


JOBS = {
    "call": call, "checkpoint": checkpoint, "makers": makers, "texts": texts, "threads": threads,
    "tidy": tidy,
}  # fmt: skip
