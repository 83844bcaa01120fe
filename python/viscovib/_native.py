"""The only importer of the compiled core: checks arrays before a call, raises errors after it.

f2py checks shapes on one side only, truncates numbers to integers and copies silently, so every
argument is converted to its exact type, shape and memory order here.
"""

import ctypes
import math
import os
import sys
import threading
from collections.abc import Callable, Mapping
from numbers import Number
from types import MappingProxyType
from typing import Any, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from viscovib import _viscovib  # type: ignore[attr-defined]
from viscovib.common import progress
from viscovib.errors import FileError, InputError, nearest

#: The compiled core, without types.
core: Any = _viscovib
progress.pieces.append(core.pieces_of_work)

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

_T = TypeVar("_T")

# After a block of this size was freed, glibc keeps smaller blocks for the next call. Otherwise
# each call gets new pages from the system, up to 0.5 ms of the 1.1 ms of a branch.
np.empty(2**24, dtype=np.uint8)

_IO_ERROR = 3
#: Largest length of a list whose entries are checked one by one.
_LONG_LIST = 1000
#: Largest length of a list that is checked before the conversion to an array.
_SHORT_LIST = 64
#: Largest number of entries of an array that are checked by the sum of their squares.
_SHORT_ARRAY = 4096
#: Largest length of a range, which needs memory only as an array.
_LONG_RANGE = 10**8
#: Number of numbers from which on results stay in the memory of the core.
_MANY_NUMBERS = 8192
#: Largest depth of nested lists.
_DEEPEST = 32
#: Block size of the core, and number of vector lanes.
_BLOCK, _LANES = 1024, 8
#: Numbers of samples and of steps in time that may take long.
MANY_SAMPLES, MANY_STEPS = 2**18, 2000
#: Seconds of work between two checks of Ctrl-C on a busy machine.
_PART = 0.1


def number(name: str, value: object, other: str = "") -> float:
    """Return ``value`` as a finite float; ``other``: further allowed values for the message."""
    if type(value) is not float:
        refuse_mask(name, value)
        if isinstance(value, (bool, np.bool_, str, bytes)) or value is None:
            raise InputError(f"{name} = {shown(value)}: must be a real number{other}")
        if getattr(getattr(value, "dtype", None), "kind", "") == "c":
            raise InputError(f"{name} = {shown(value)}: must be a real number{other}")
        try:
            value = float(value)  # type: ignore[arg-type]
        except Exception:
            # Any exception of the conversion means that the object is not a number.
            raise InputError(f"{name} = {shown(value)}: must be a real number{other}") from None
    result: float = value
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
        near = nearest(value, allowed) if isinstance(value, str) else None
        meant = f"; did you mean {near!r}?" if near else ""
        raise InputError(f"{name} = {shown(value)}: must be one of {words}{meant}")
    return value


def real_array(name: str, value: object, *, ndim: int | None = None) -> FloatArray:
    """Return finite real numbers as a C-contiguous float64 array."""
    if type(value) in (tuple, list) and ndim in (None, 1):
        # A few plain numbers, such as a state: only check that they are finite.
        numbers: list[Any] | tuple[Any, ...] = value  # type: ignore[assignment]
        if 0 < len(numbers) <= _SHORT_LIST and set(map(type, numbers)) <= {float, int}:
            try:
                finite = math.isfinite(sum(numbers))
            except OverflowError:
                finite = False
            if finite:
                return np.array(numbers, dtype=float)
    array = _array(name, value)
    if array.dtype.kind == "c":
        raise InputError(f"{name}: must be real, got complex numbers")
    return _checked(name, array.astype(np.float64, copy=False), ndim)


def complex_array(name: str, value: object, *, ndim: int | None = None) -> ComplexArray:
    """Return finite complex numbers as a C-contiguous complex128 array."""
    return _checked(name, _array(name, value), ndim).astype(np.complex128, copy=False)


def any_array(name: str, value: object) -> npt.NDArray[Any]:
    """Return ``value`` as an array of any kind; all user arrays pass through this function."""
    if type(value) is np.ndarray:
        return value
    if type(value) is range and value:
        entries = (value[-1] - value[0]) // value.step + 1
        if entries > _LONG_RANGE:
            raise InputError(f"{name}: has {entries} entries, must have at most {_LONG_RANGE}")
    # Entries of a long list are not checked one by one: a masked entry becomes NaN.
    long = isinstance(value, (list, tuple)) and len(value) > _LONG_LIST
    if not long:
        refuse_mask(name, value)
    try:
        array = np.asarray(value)
    except Exception:
        # Any exception of the conversion means that the object is not an array.
        raise InputError(
            f"{name} = {shown(value)}: must be an array of numbers of one shape"
        ) from None
    if long and array.ndim > 1:
        refuse_mask(name, value)
    return array


def _masked() -> tuple[type, ...]:
    """The type of masked arrays. Before the import of `numpy.ma`, which is slow, there are none."""
    return (np.ma.MaskedArray,) if "numpy.ma" in sys.modules else ()


def refuse_mask(name: str, value: Any) -> None:
    """Refuse an array with masked entries, which have no value."""
    masked = _masked()
    if isinstance(value, masked):
        if np.ma.is_masked(value):
            flags = np.ma.getmaskarray(np.ma.asarray(value))
            raise InputError(
                f"{name}: {flags.sum()} of {flags.size} masked, must be without a mask: remove "
                "them, or replace them by filled()"
            )
    elif isinstance(value, (list, tuple)):
        # Most lists contain only numbers and need no further check.
        kinds = set(map(type, value))
        if any(issubclass(kind, (*masked, list, tuple)) for kind in kinds):
            if any(part is value for part in value):
                raise InputError(f"{name}: contains itself, must be numbers")
            for i, part in enumerate(value):
                _refuse_below(f"{name}[{i}]", part, 1)


def _refuse_below(name: str, value: object, depth: int) -> None:
    if depth < _DEEPEST and isinstance(value, (list, tuple)):
        for i, part in enumerate(value):
            _refuse_below(f"{name}[{i}]", part, depth + 1)
    elif isinstance(value, _masked()):
        refuse_mask(name, value)


def _array(name: str, value: object) -> npt.NDArray[Any]:
    array = any_array(name, value)
    if array.dtype.kind == "O" and all(isinstance(one, Number) for one in array.flat):
        # Fractions, decimals, or columns of a table that were read as objects.
        exact = any(isinstance(one, complex | np.complexfloating) for one in array.flat)
        try:
            array = array.astype(complex if exact else float)
        except (OverflowError, ValueError):
            raise InputError(f"{name} = {shown(value)}: must be finite numbers") from None
    if array.dtype.kind not in "iufc":
        raise InputError(f"{name} = {shown(value)}: must be numbers, got {_kind(array)}")
    return array


def _kind(array: npt.NDArray[Any]) -> str:
    """Kind of the content of an array without numbers."""
    if array.dtype.kind != "O":
        return {"U": "text", "S": "bytes", "b": "bool"}.get(array.dtype.kind, str(array.dtype))
    other = next((one for one in array.flat if not isinstance(one, Number)), None)
    return "None" if other is None else f"a {type(other).__name__}"


def _checked(name: str, array: npt.NDArray[Any], ndim: int | None) -> npt.NDArray[Any]:
    if ndim == 0 and array.ndim != 0:
        raise InputError(f"{name}: must be one number, got shape {array.shape}")
    if ndim is not None and array.ndim != ndim:
        raise InputError(f"{name}: must have {ndim} dimension(s), got shape {array.shape}")
    if not all_finite(array):
        finite = np.isfinite(array)
        where = tuple(int(i) for i in np.argwhere(~finite)[0])
        place = f"[{', '.join(map(str, where))}]" if where else ""
        raise InputError(f"{name}{place} = {array[where]}: must be a finite number")
    return array if array.flags.c_contiguous else np.asarray(array, order="C")


def flag(name: str, value: object) -> bool:
    """Return ``value`` if it is True or False."""
    if not isinstance(value, (bool, np.bool_)):
        raise InputError(f"{name} = {shown(value)}: must be True or False")
    return bool(value)


def is_auto(value: object) -> bool:
    """True if ``value`` is the word "auto"."""
    return isinstance(value, str) and value == "auto"


def check_instance(name: str, value: object, *types: type) -> None:
    """Refuse values of all other types."""
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
    """Return a value as a short line for messages."""
    try:
        text = " ".join(repr(value).split())
    except Exception:
        text = f"<{type(value).__name__}>"
    # Characters without an encoding would make the message unprintable.
    text = text.encode("utf-8", "backslashreplace").decode()
    return text if len(text) <= 60 else text[:57] + "..."


def letters(name: str, text: str) -> bytes:
    """Return a text as bytes for the core, which would end at a NUL character."""
    if "\0" in text:
        raise InputError(f"{name} = {shown(text)}: must have no NUL character")
    # Characters without an encoding have no bytes.
    return text.encode("utf-8", "backslashreplace")


def call(routine: Callable[..., tuple[Any, ...]], *arguments: object) -> tuple[Any, ...]:
    """Call a routine of the core and turn its status into an exception."""
    found = routine(*arguments)
    if _pending.error is not None:
        raise_pending()
    # A routine with one result returns no tuple.
    *results, status = found if type(found) is tuple else (found,)
    if status != 0:
        letters = core.last_message(core.last_message_length())
        text = letters.tobytes().decode(errors="replace")
        raise FileError(text) if status == _IO_ERROR else InputError(text)
    return tuple(results)


#: Status of a call that Ctrl-C interrupted.
_INTERRUPTED = -1
#: Kinds of values in the core, by the kinds of arrays.
_REAL, _COMPLEX, _INTEGER, _TEXT = 1, 2, 3, 4
_KINDS = {"f": _REAL, "c": _COMPLEX, "i": _INTEGER, "u": _INTEGER, "b": _INTEGER}
_NO_NUMBERS = np.empty(0)
_NOTHING: Mapping[str, Any] = MappingProxyType({})
#: Kernel kind that marks a system with all data in one vector for the core.
_IN_VECTOR = -2
#: True if calls of the main thread react to Ctrl-C.
_HEARS = os.name == "posix"
_NO_CANCEL = np.zeros(1, dtype=np.intc)


class Handle:
    """An object of the core, such as a system: built once, used by many tasks, freed with it.

    A copy or a pickled handle is a new object with the same values.
    """

    __slots__ = ("__weakref__", "_kind", "_parents", "_values", "number")

    def __init__(self, kind: str, /, *parents: "Handle", **values: Any) -> None:
        self._kind, self._parents, self._values = kind, parents, values
        self.number, _ = _begin(kind, parents, values, 1)

    def __reduce__(self) -> tuple[Any, ...]:
        return _new_handle, (self._kind, self._parents, self._values)

    def __del__(self, free: Any = core.free_object) -> None:
        # The attribute is missing if the object could not be created.
        number = getattr(self, "number", 0)
        if number:
            free(number)


def _new_handle(kind: str, parents: tuple[Handle, ...], values: dict[str, Any]) -> Handle:
    return Handle(kind, *parents, **values)


def run(task: str, /, *parents: Handle, **values: Any) -> dict[str, Any]:
    """Run a task of the core with objects and values by name, and return its results.

    Values are numbers, texts, and arrays of up to 4 dimensions; result arrays have Fortran order.
    """
    return _found(*_begin(task, parents, values, 0))


def oscillator_object(
    flat: FloatArray, kernels: "tuple[int, FloatArray, int, FloatArray]"
) -> Handle:
    """Build an oscillator from its vector and its kernels of x and phi."""
    kind_x, data_x, kind_phi, data_phi = kernels
    return Handle(
        "system oscillator", flat=flat, kind_x=kind_x, data_x=data_x, kind_phi=kind_phi,
        data_phi=data_phi,
    )  # fmt: skip


def polynomial_object(flat: FloatArray) -> Handle:
    """Build a polynomial system from its vector, which also contains its kernels."""
    return oscillator_object(flat, (_IN_VECTOR, _NO_NUMBERS, 0, _NO_NUMBERS))


def _begin(
    task: str, parents: tuple[Handle, ...], values: Mapping[str, Any], keep: int
) -> tuple[int, FloatArray]:
    """Run a task and return the handle and the sizes of its results.

    ``keep``: 1 if later tasks use the values, which are copied then.
    """
    given = list(values.values())
    kinds = tuple(map(type, given))
    key = task, kinds, *values
    plan = _plans.get(key)
    if plan is None:
        plan = _plans[key] = _plan_of(task, list(values), kinds)
    text, single_forms, of_reals, of_whole, of_arrays, of_texts = plan
    numbers: Any = [given[i] for i in of_reals]
    whole: Any = [given[i] for i in of_whole]
    layout: Any = [len(parents), *[parent.number for parent in parents], *single_forms]
    long_reals: list[Any] = []
    long_whole: list[Any] = []
    for i in of_arrays:
        value = given[i]
        if kinds[i] is complex:
            value = np.array(value)
        code = _KINDS[value.dtype.kind]
        layout += (code, value.ndim, *value.shape)
        flat = value if value.ndim == 1 else value.ravel("F")
        if code == _COMPLEX:
            flat = flat.view(np.float64)
        # A few numbers are joined faster as a list; the order of elements must be kept.
        elements, long = (whole, long_whole) if code == _INTEGER else (numbers, long_reals)
        if flat.size <= _SHORT_LIST and not long:
            elements += flat.tolist()
        else:
            long.append(flat)
    for i in of_texts:
        letters = given[i].encode() if kinds[i] is str else given[i]
        layout += (_TEXT, 1, len(letters))
        text += letters
    layout += whole
    if long_whole:
        layout = np.concatenate((layout, *long_whole))
    if long_reals:
        # A single array is not copied.
        alone = len(long_reals) == 1 and not numbers
        numbers = long_reals[0] if alone else np.concatenate((numbers, *long_reals))
    handle, sizes, status = core.begin_call(
        text, layout, numbers, keep,
        _NO_CANCEL if _listening.flag is None else _listening.flag,
    )  # fmt: skip
    if status == _INTERRUPTED and _pending.error is None:
        # Python has handled Ctrl-C by now. If nothing was raised, repeat the work.
        return _begin(task, parents, values, keep)
    if status != 0 or _pending.error is not None:
        call(lambda: status)
    return handle, sizes


#: A result of a task: its name, kind, rank, the range of its elements, and its reversed shape.
_Place: TypeAlias = tuple[str, int, int, int, int, list[int]]
#: Kinds, ranks and shapes of the last results of tasks, and their places, by the bytes of names.
_layouts: dict[bytes, tuple[list[int], list[_Place]]] = {}
#: Text of a call, forms of single numbers, and indices of the values of each kind.
_Plan: TypeAlias = tuple[bytes, list[int], list[int], list[int], list[int], list[int]]
#: Packing of values, by task, kinds and names.
_plans: dict[tuple[Any, ...], _Plan] = {}


def _plan_of(task: str, names: list[str], kinds: tuple[type, ...]) -> _Plan:
    """Return the names in the order of a call, and the indices of values of each kind.

    Single numbers come first, then arrays, then texts, so that all elements are joined in one step.
    """
    places: tuple[list[int], list[int], list[int], list[int]] = ([], [], [], [])
    for i, kind in enumerate(kinds):
        if issubclass(kind, float):
            places[0].append(i)
        elif issubclass(kind, (int, np.integer, np.bool_)):
            places[1].append(i)
        elif issubclass(kind, (np.ndarray, complex)):
            places[2].append(i)
        elif issubclass(kind, (str, bytes)):
            places[3].append(i)
        else:
            raise TypeError(f"{names[i]}: is a {kind.__name__}, which no task takes")
    ordered = "".join(f"{names[i]}," for one in places for i in one)
    forms = [*(_REAL, 0) * len(places[0]), *(_INTEGER, 0) * len(places[1])]
    return f"{task};{ordered};".encode(), forms, *places


class _Kept:
    """Numbers in the memory of the core, which is freed with the last array of them."""

    __slots__ = ("__array_interface__", "number")

    def __init__(self, handle: int, address: int, size: int) -> None:
        self.number = handle
        self.__array_interface__ = {
            "version": 3, "typestr": "<f8", "data": (address, False), "shape": (size,),
        }  # fmt: skip

    __del__ = Handle.__del__


def _found(handle: int, sizes: Any) -> dict[str, Any]:
    """Unpack the results of a task."""
    n_text, n_integers, n_numbers, address = sizes.tolist()
    kept = n_numbers >= _MANY_NUMBERS
    text, integers, numbers, status = core.end_call(
        handle, n_text, n_integers, 0 if kept else n_numbers
    )
    if status != 0:
        call(lambda: status)
    if kept:
        numbers = np.asarray(_Kept(handle, address, n_numbers))
    names, _, letters = text.tobytes().partition(b";")
    whole = integers.tolist()
    head, places = _layouts.get(names) or ([], [])
    if not places or whole[: len(head)] != head:
        head, places = _layouts[names] = _layout_of(names.decode().split(",")[:-1], whole)
    found: dict[str, Any] = {}
    for name, kind, rank, start, end, shape in places:
        if kind == _TEXT:
            found[name] = letters[start:end].decode(errors="replace")
            continue
        if kind == _INTEGER:
            if not rank:
                found[name] = whole[start]
                continue
            part = integers[start:end]
        else:
            part = numbers[start:end]
            if kind == _COMPLEX:
                part = part.view(np.complex128)
        found[name] = part if rank == 1 else part.reshape(shape).T if rank else part.item()
    return found


def _layout_of(names: list[str], whole: list[int]) -> tuple[list[int], list[_Place]]:
    """Return the part of the integers with kinds, ranks and shapes, and the places of results."""
    places: list[_Place] = []
    at, ends = 0, {_TEXT: 0, _INTEGER: 0, _REAL: 0}
    for name in names:
        kind, rank = whole[at], whole[at + 1]
        at += 2 + rank
        shape = whole[at - rank : at]
        of = _REAL if kind == _COMPLEX else kind
        start = ends[of]
        ends[of] += math.prod(shape) * (2 if kind == _COMPLEX else 1)
        places.append((name, kind, rank, start, ends[of], shape[::-1]))
    # The elements of integers follow.
    return whole[:at], [
        (name, kind, rank, start + at, end + at, shape) if kind == _INTEGER else
        (name, kind, rank, start, end, shape)
        for name, kind, rank, start, end, shape in places
    ]  # fmt: skip


class _Pending(threading.local):
    """Exception of a Python function called by the core, by thread: it cannot pass through it."""

    error: BaseException | None = None


_pending = _Pending()
#: The procedure that the core calls; a reference keeps it alive.
_heard: list[Any] = []


def raise_pending() -> None:
    """Raise the exception of a Python function that the core called in this thread."""
    error, _pending.error = _pending.error, None
    if error is not None:
        raise error


def register_functions(
    answer: Callable[[int, FloatArray, bool], tuple[FloatArray, FloatArray | None]],
) -> None:
    """Let the core call functions by number: values and derivatives at operands, shape (m, n)."""
    if _heard:
        return
    real = ctypes.POINTER(ctypes.c_double)

    def outside(which: int, n: int, m: int, wanted: int, x: Any, value: Any, by: Any) -> None:
        # Ignore all calls after an error.
        if _pending.error is not None:
            return
        try:
            values, slopes = answer(which, np.ctypeslib.as_array(x, (m, n)), bool(wanted))
            np.ctypeslib.as_array(value, (n,))[:] = values
            if slopes is not None:
                np.ctypeslib.as_array(by, (m, n))[:] = slopes
        except BaseException as error:
            _pending.error = error

    kind = ctypes.CFUNCTYPE(
        None, ctypes.c_int64, ctypes.c_int, ctypes.c_int, ctypes.c_int, real, real, real
    )
    _heard.append(kind(outside))
    core.law_set_outside(ctypes.cast(_heard[0], ctypes.c_void_p).value)


def run_either(long: bool, task: str, /, *parents: Handle, **values: Any) -> dict[str, Any]:
    """Run a task, as `interruptible` if it may take ``long``."""
    if long:
        return interruptible(lambda: run(task, *parents, **values))
    return run(task, *parents, **values)


def interruptible(work: Callable[[], _T]) -> _T:
    """Do native work whose loops react to signals, in a thread only if a bar may be shown.

    A thread costs 50 to 200 microseconds.
    """
    if _HEARS and not progress.shows_by_itself():
        return work()
    return apart(work)


class _Listening(threading.local):
    """The flag that ends native loops of a thread."""

    flag: npt.NDArray[np.intc] | None = None


_listening = _Listening()


def listen(flag: npt.NDArray[np.intc]) -> None:
    """End native loops of this thread, and of threads it waits for, when the flag is 1."""
    _listening.flag = flag
    core.listen(flag)


def apart(work: Callable[[], _T]) -> _T:
    """Do work in a thread and wait for it, so that Ctrl-C works.

    After Ctrl-C native loops of the thread end, and their results are dropped.
    """
    results: list[_T] = []
    errors: list[BaseException] = []
    flag = _listening.flag
    if flag is None:
        flag = np.zeros(1, dtype=np.intc)

    def run() -> None:
        listen(flag)
        try:
            results.append(work())
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=run, daemon=True)
    try:
        try:
            thread.start()
        except RuntimeError:
            raise MemoryError("no memory for a thread") from None
        progress.wait(thread)
    except BaseException:
        # Ctrl-C may occur at any point above.
        flag[0] = 1
        raise
    if errors:
        raise errors[0]
    return results[0]


def run_in_parts(
    task: str,
    about: Handle | None,
    seconds: float,
    whole: Mapping[str, Any] = _NOTHING,
    /,
    **arrays: npt.NDArray[Any],
) -> dict[str, Any]:
    """Run a task on parts of the values, so that Ctrl-C works between the parts.

    ``seconds``: largest time per value. Values are the last axis of input and result arrays; whole
    numbers in results are counts.
    ``whole``: arguments common to all values.
    """
    n = next(iter(arrays.values())).shape[-1]
    parents = () if about is None else (about,)
    if n * seconds <= _PART:
        return run(task, *parents, **whole, **arrays)
    # Use full blocks and lanes of the core, so that results do not depend on the parts.
    wide = int(_PART / seconds)
    size = max(wide // _BLOCK * _BLOCK, min(wide // _LANES * _LANES, _BLOCK), _LANES)
    found: dict[str, Any] = {}
    for start in range(0, n, size):
        end = start + size
        own = {name: array[..., start:end] for name, array in arrays.items()}
        parts = run(task, *parents, **whole, **own)
        for name, part in parts.items():
            if type(part) is int:
                found[name] = found.get(name, 0) + part
                continue
            if name not in found:
                found[name] = np.empty((*part.shape[:-1], n), dtype=part.dtype, order="F")
            found[name][..., start:end] = part
    return found


def all_finite(array: npt.NDArray[Any]) -> bool:
    """True without NaN and infinity."""
    flat = array.ravel("K")
    if array.size <= _SHORT_ARRAY:
        # Half the time; the products of more entries may start threads.
        if math.isfinite(np.vdot(flat, flat).real):
            return True
    elif flat.dtype == np.complex128:
        # The parts alone take a fifth of the time.
        flat = flat.view(np.float64)
    return bool(np.isfinite(flat).all())


def check_range(name: str, given: npt.NDArray[Any], found: npt.NDArray[Any], what: str) -> None:
    """Refuse the first given value at which ``what`` is not a finite number.

    ``found`` has an entry or a row for each value.
    """
    if all_finite(found):
        return
    rows = np.isfinite(found.reshape(given.size, -1)).all(axis=1)
    if rows.all():
        return
    i = int(np.flatnonzero(~rows)[0])
    place = f"[{', '.join(str(k) for k in np.unravel_index(i, given.shape))}]" if given.ndim else ""
    raise InputError(f"{name}{place} = {given.ravel()[i]:g}: {what} is not a finite number there")


def check_states(states: FloatArray, found: FloatArray, what: str) -> None:
    """Refuse the first state at which ``what`` is not a finite number."""
    if all_finite(found):
        return
    i = tuple(int(k) for k in np.argwhere(~np.isfinite(found))[0][: states.ndim - 1])
    place = f"[{', '.join(map(str, i))}]" if i else ""
    largest = float(np.abs(states[i]).max())
    raise InputError(
        f"state{place}: {what} of a state of size {largest:g} is not a finite number: "
        "the state must be smaller"
    )
