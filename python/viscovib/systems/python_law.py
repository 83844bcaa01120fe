"""Force laws as Python functions."""

from __future__ import annotations

import ctypes
import inspect
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.errors import InputError

#: Largest number of arguments and parameters of a function, as in the core.
MOST_OPERANDS = 8
#: Imaginary part of an argument of a complex step: its square is negligible relative to 1e-16.
_STEP = 1e-40
#: Test of derivatives by difference quotients: sizes of the points, points per size, relative
#: steps; tolerance for two quotients to agree, for the derivative, and number of wrong points.
_SIZES, _OF_EACH, _PARTS = np.logspace(-6, 3, 10), 6, (1e-5, 1e-6)
_AGREE, _WRONG, _MOST_WRONG = 1e-3, 1e-2, 1
#: Rounding errors of values, and of differences of numbers of order 1.
_ROUNDING, _OF_PARTS = 1e-14, 2e-16
#: Relative tolerance between the results for an array and for single numbers.
_SAME = 1e-9
#: Type of compiled functions.
_Compiled: Any = ctypes.CFUNCTYPE(None).__mro__[1]
#: Compiled functions with their derivatives, by address. The core may use them at any time.
_compiled: dict[int, tuple[Any, ...]] = {}
#: Python functions that the core calls by number.
_called: WeakValueDictionary[int, CalledLaw] = WeakValueDictionary()


@dataclass(frozen=True, eq=False)
class PythonLaw:
    """A force law as a Python function.

    It works wherever a text works in `Spring`, `Coupling` and `PolynomialSystem`, with and without
    memory. A plain function, ``law=lambda d, v: ...``, equals ``PythonLaw(function)``.

    The function is called once with symbols. If it consists of arithmetic, comparisons and NumPy
    functions that a text has (``np.tanh``, ``np.where``, ``np.maximum``, ...), and the text has the
    same values at random arguments, the text is used. It costs as little as a text, and steps in
    time end at its kinks and jumps. Other numbers in the function keep their values at this call.

    Any other function is called with arrays of samples each time a force is needed, about 20 us per
    call (a text: less than 1 us); plans state this. Steps in time do not end at its kinks, and thin
    layers are not detected, so it should be smooth. Scenes and bodies accept texts only.

    A compiled function of numbers costs about as little as a text: a function of `ctypes`,
    ``double f(double, ...)``, or of ``numba.cfunc``. It must be deterministic and usable by several
    threads, needs compiled ``slopes``, and cannot be sent to another process.

    Parameters
    ----------
    function : callable
        f of arrays, element by element, like NumPy functions; NaN where it has no value. Its
        arguments have the names of a text: ``d`` and ``v`` of a `Spring`, coordinates and rates
        (``x``, ``x_dot``) of a `PolynomialSystem`, and parameters; at most 8. Arguments with a
        default are optional.
    slopes : callable, optional
        Its derivatives by the arguments that are not parameters, in their order: a function of the
        same arguments that returns an array, or a tuple of arrays. None: from the text, or by the
        complex step Im f(d + ih)/h, which is exact for an analytic function of complex numbers.
        Of a compiled function: a compiled function of the same arguments for each, in a list.
        Both are compared with difference quotients when the system is created.
    arguments : sequence of str, optional
        Names of the arguments, in order, for functions without a signature, such as those of SciPy.

    Examples
    --------
    >>> import numpy as np, viscovib as vv
    >>> law = vv.PythonLaw(lambda d, k: k * np.arctan(d**3))
    >>> spring = vv.Spring(on="x1", law=law, parameters={"k": 2.0})
    >>> from scipy.interpolate import CubicSpline
    >>> measured = CubicSpline([-2, -1, 0, 1, 2], [-5.0, -1.4, 0, 1.4, 5.0])
    >>> rubber = vv.PythonLaw(lambda d: measured(d), slopes=lambda d: measured(d, 1))
    """

    function: Callable[..., Any]
    slopes: Callable[..., Any] | Sequence[Callable[..., Any]] | None = None
    arguments: Sequence[str] | None = None

    def __post_init__(self) -> None:
        for name in ("function", "slopes"):
            if name == "slopes" and self._is_compiled:
                break
            value = getattr(self, name)
            if not callable(value) and not (value is None and name == "slopes"):
                raise InputError(f"{name} = {_native.shown(value)}: must be a function")
        if self.arguments is not None:
            names = self.arguments
            listed = isinstance(names, Sequence) and not isinstance(names, str)
            if not listed or not all(isinstance(name, str) for name in names):
                raise InputError(f"arguments = {_native.shown(names)}: must be a sequence of names")
            object.__setattr__(self, "arguments", tuple(names))

    @property
    def _is_compiled(self) -> bool:
        return isinstance(getattr(self.function, "ctypes", self.function), _Compiled)

    @property
    def _name(self) -> str:
        """Name in messages."""
        return str(getattr(self.function, "__name__", type(self.function).__name__))

    def __getstate__(self) -> dict[str, Any]:
        if self._is_compiled:
            raise InputError(
                f"{self._name} is a compiled function, which cannot be stored or sent to another "
                "process"
            )
        return {
            "function": self.function, "slopes": self.slopes, "arguments": self.arguments,
        }  # fmt: skip

    def _bound_to(
        self, where: str, variables: Sequence[str], parameters: Mapping[str, float]
    ) -> CalledLaw:
        """Return the law with its operands: which arguments are variables, which are parameters."""
        names: list[str] = []
        keywords: list[bool] = []
        left_out = False
        for name, needed, keyword in self._asked(where):
            if name in variables or name in parameters:
                names.append(name)
                keywords.append(keyword or left_out)
            elif not needed:
                left_out = True
            else:
                raise InputError(
                    f"{where}: the argument {name!r} of {self._name} is neither a variable "
                    f"({', '.join(variables[:8])}) nor a parameter; to make it one, give "
                    f"parameters={{{name!r}: its value}}"
                )
        of_variables = tuple(name in variables for name in names)
        if not any(of_variables):
            raise InputError(
                f"{where}: {self._name} must have one of {', '.join(variables[:8])} as an argument"
            )
        if len(names) > MOST_OPERANDS:
            raise InputError(
                f"{where}: {self._name} has {len(names)} arguments, must have at most "
                f"{MOST_OPERANDS}"
            )
        key = (tuple(names), of_variables)
        kept: dict[Any, CalledLaw] = self.__dict__.setdefault("_bound", {})
        if key not in kept:
            kind = CompiledLaw if self._is_compiled else CalledLaw
            kept[key] = kind(self, *key, tuple(keywords))
        return kept[key]

    def _asked(self, where: str) -> list[tuple[str, bool, bool]]:
        """For each argument: name, True if it is required, and True if it is keyword-only."""
        if self.arguments is not None:
            return [(name, True, False) for name in self.arguments]
        kinds = inspect.Parameter
        try:
            asked = inspect.signature(self.function).parameters.values()
        except (TypeError, ValueError):
            asked = None
        if asked is None or any(p.kind in (kinds.VAR_POSITIONAL, kinds.VAR_KEYWORD) for p in asked):
            raise InputError(
                f"{where}: {self._name} does not list its arguments; name them, "
                "PythonLaw(function, arguments=['d'])"
            )
        return [(p.name, p.default is kinds.empty, p.kind is kinds.KEYWORD_ONLY) for p in asked]


@dataclass(frozen=True, eq=False)
class CalledLaw:
    """A function with its operands, which the core calls by number."""

    law: PythonLaw
    names: tuple[str, ...]
    of_variables: tuple[bool, ...]
    #: True for operands that are passed by name.
    keywords: tuple[bool, ...]

    def __post_init__(self) -> None:
        # A random number keeps its meaning if the system is sent to another process.
        self._register(int.from_bytes(os.urandom(8)) >> 12)

    def _register(self, number: int) -> None:
        object.__setattr__(self, "number", number)
        _called[number] = self
        _native.register_functions(_answer)

    def __reduce__(self) -> tuple[Any, ...]:
        parts = (self.law, self.names, self.of_variables, self.keywords)
        return _restored, (self.number, *parts)  # type: ignore[attr-defined]

    def __deepcopy__(self, memo: Any) -> CalledLaw:
        return self

    def values(self, rows: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """The function at operands, shape (m, n)."""
        return self._called(self.law.function, rows)[0]

    def _called(
        self, function: Callable[..., Any], rows: npt.NDArray[Any], several: bool = False
    ) -> list[npt.NDArray[Any]]:
        own = [np.array(row) for row in rows]
        by_name = dict(zip(self.names, own, strict=True))
        first = [row for row, keyword in zip(own, self.keywords, strict=True) if not keyword]
        rest = {n: by_name[n] for n, keyword in zip(self.names, self.keywords, strict=True)
                if keyword}  # fmt: skip
        with np.errstate(all="ignore"):
            found = function(*first, **rest)
        parts = list(found) if several and isinstance(found, (tuple, list)) else [found]
        shape = rows.shape[1:]
        result = []
        for part in parts:
            array = np.asarray(part)
            if array.dtype.kind not in "biufc" or (
                array.dtype.kind == "c" and rows.dtype.kind != "c"
            ):
                raise InputError(f"{self.law._name} must return real numbers, got {array.dtype}")
            if array.shape not in ((), shape):
                raise InputError(
                    f"{self.law._name} must return one number for each entry of its arguments, "
                    f"shape {shape}, got {array.shape}"
                )
            result.append(np.broadcast_to(array, shape))
        return result

    def derivatives(self, rows: FloatArray) -> FloatArray:
        """Derivatives with respect to the operands, shape (m, n); 0 for parameters."""
        found = np.zeros_like(rows)
        places = np.flatnonzero(self.of_variables)
        if self.law.slopes is not None:
            parts = self._called(self.law.slopes, rows, several=True)  # type: ignore[arg-type]
            if len(parts) != places.size:
                raise InputError(
                    f"slopes of {self.law._name}: {len(parts)} derivatives, must be {places.size}"
                )
            found[places] = parts
            return found
        for place in places:
            at = rows.astype(complex)
            at[place] += 1j * _STEP
            found[place] = self.values(at).imag / _STEP
        return found

    def answer(self, rows: FloatArray, wanted: bool) -> tuple[FloatArray, FloatArray | None]:
        """Values and derivatives; both are not finite outside the domain."""
        values = np.asarray(self.values(rows), dtype=float)
        if not wanted:
            return values, None
        slopes = self.derivatives(rows)
        lost = np.isfinite(values) & ~np.isfinite(slopes).all(axis=0)
        if lost.any():
            at = ", ".join(
                f"{name} = {row[lost][0]:g}" for name, row in zip(self.names, rows, strict=True)
            )
            raise InputError(f"{self.law._name} has no finite derivative at {at}")
        return values, slopes

    def places(self, parameters: Mapping[str, float]) -> FloatArray:
        """Random operands of all sizes, shape (m, n)."""
        rng = np.random.default_rng(0)
        n = _SIZES.size * _OF_EACH
        rows = rng.uniform(-1, 1, (len(self.names), n)) * np.repeat(_SIZES, _OF_EACH)
        for row, name, variable in zip(rows, self.names, self.of_variables, strict=True):
            if not variable:
                row[:] = parameters[name]
        return rows

    def check(self, where: str, parameters: Mapping[str, float]) -> None:
        """Refuse a function that does not accept arrays or has wrong derivatives."""
        rows = self.places(parameters)
        n = rows.shape[1]
        try:
            values = np.asarray(self.values(rows), dtype=float)
            alone = np.array([self.values(rows[:, i : i + 1])[0] for i in range(n)], dtype=float)
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
        except Exception as error:
            raise InputError(
                f"{where}: {self.law._name} raised {type(error).__name__} "
                f"({_native.shown(error)}): must take arrays, entry by entry (np.where instead of "
                "if)"
            ) from error
        sound = np.isfinite(values) & np.isfinite(alone)
        if (np.abs(values[sound] - alone[sound]) > _SAME * np.abs(values[sound])).any():
            raise InputError(
                f"{where}: {self.law._name} returns different values for an array and for its "
                "entries"
            )
        self._check_slopes(where, rows, values)

    def _check_slopes(self, where: str, rows: FloatArray, values: FloatArray) -> None:
        try:
            slopes = self.derivatives(rows)
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
        except Exception as error:
            if self.law.slopes is None:
                raise InputError(
                    f"{where}: {self.law._name} does not accept complex numbers, which its "
                    f"derivatives need ({type(error).__name__}): give PythonLaw(function, "
                    "slopes=...)"
                ) from None
            raise InputError(
                f"{where}: slopes of {self.law._name} raised {type(error).__name__} "
                f"({_native.shown(error)})"
            ) from error
        moderate = np.isfinite(values) & (np.repeat(_SIZES, _OF_EACH) <= 1)
        parts = np.max(np.abs(values), initial=0.0, where=moderate)
        for place in np.flatnonzero(self.of_variables):
            near, nearer = (self._differences(rows, int(place), part) for part in _PARTS)
            size = np.maximum(np.abs(near), np.abs(slopes[place]))
            note = np.abs(near - nearer) <= _AGREE * np.maximum(np.abs(near), np.abs(nearer))
            # Rounding errors of the values limit the accuracy of differences, also inside the law:
            # sqrt(1 + x^2) - 1 has errors of numbers near 1. Small slopes are not checked.
            steps = min(_PARTS) * np.abs(rows[place])
            drowned = (near == 0) & (np.abs(slopes[place]) * steps < _OF_PARTS * parts)
            doubt = _ROUNDING * np.abs(values) / steps
            wrong = note & ~drowned & (np.abs(slopes[place] - near) > _WRONG * size + doubt)
            if np.count_nonzero(wrong) > _MOST_WRONG:
                i = int(wrong.argmax())
                at = ", ".join(
                    f"{name} = {row[i]:.3g}" for name, row in zip(self.names, rows, strict=True)
                )
                how = "its slopes give" if self.law.slopes is not None else "the complex step gives"
                hint = (
                    "" if self.law.slopes is not None
                    else "; it is not analytic (abs?): give PythonLaw(function, slopes=...)"
                )  # fmt: skip
                raise InputError(
                    f"{where}: the derivative of {self.law._name} by {self.names[place]} is "
                    f"{near[i]:.6g} at {at} by differences, {how} {slopes[place][i]:.6g}{hint}"
                )

    def _differences(self, rows: FloatArray, place: int, part: float) -> FloatArray:
        step = part * np.abs(rows[place])
        below, above = rows.copy(), rows.copy()
        below[place] -= step
        above[place] += step
        with np.errstate(all="ignore"):
            return np.asarray((self.values(above) - self.values(below)) / (2 * step))


class CompiledLaw(CalledLaw):
    """A compiled function with its operands, which the core calls by its address."""

    def __post_init__(self) -> None:
        law, m = self.law, len(self.names)
        given = law.slopes if isinstance(law.slopes, (list, tuple)) else [law.slopes]
        wanted = sum(self.of_variables)
        if len(given) != wanted or any(one is None for one in given):
            raise InputError(
                f"slopes of {law._name}: must be a list of {wanted} compiled functions, one for "
                "each argument that is not a parameter"
            )
        value, *slopes = (_pointer(law._name, one, m) for one in (law.function, *given))
        rest = iter(slopes)
        by_operand = [next(rest) if variable else None for variable in self.of_variables]
        addresses = [
            None if one is None else ctypes.cast(one, ctypes.c_void_p).value
            for one in (value, *by_operand)
        ]
        table = (ctypes.c_void_p * len(addresses))(*addresses)
        at = ctypes.addressof(table)
        _compiled[at] = (table, value, *slopes, law)
        object.__setattr__(self, "number", -at)
        object.__setattr__(self, "_pointers", (value, by_operand))

    def values(self, rows: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """The function at operands, shape (m, n)."""
        return _each(self._pointers[0], rows)  # type: ignore[attr-defined]

    def derivatives(self, rows: FloatArray) -> FloatArray:
        """Derivatives with respect to the operands, shape (m, n); 0 for parameters."""
        none = np.zeros(rows.shape[1])
        by = self._pointers[1]  # type: ignore[attr-defined]
        return np.array([none if one is None else _each(one, rows) for one in by])


def _each(pointer: Any, rows: FloatArray) -> FloatArray:
    return np.array([pointer(*column) for column in rows.T.tolist()])


def _pointer(name: str, function: Any, m: int) -> Any:
    """Return the function of ctypes of a compiled function with m arguments."""
    pointer = getattr(function, "ctypes", function)
    kinds = [*(getattr(pointer, "argtypes", None) or []), getattr(pointer, "restype", None)]
    if not isinstance(pointer, _Compiled) or kinds != [ctypes.c_double] * (m + 1):
        raise InputError(
            f"{name}: must be compiled functions of {m} numbers, restype c_double and argtypes "
            f"[{', '.join(['c_double'] * m)}]"
        )
    return pointer


def callable_law(value: object) -> bool:
    """True if a law is given as a function."""
    return isinstance(value, PythonLaw) or callable(value)


def python_law(value: Any) -> Any:
    """Return a function as a `PythonLaw`; return all other values unchanged."""
    return PythonLaw(value) if callable(value) else value


def python_laws(forces: Any) -> Any:
    """Return forces of a system with their functions as `PythonLaw`."""
    if isinstance(forces, Mapping):
        return {key: python_law(value) for key, value in forces.items()}
    if isinstance(forces, (list, tuple)):
        return tuple(map(python_law, forces))
    return python_law(forces)


def _restored(number: int, *parts: Any) -> CalledLaw:
    """Return the function of this number; register it if it comes from another process."""
    if number in _called:
        return _called[number]
    found = CalledLaw(*parts)
    del _called[found.number]  # type: ignore[attr-defined]
    found._register(number)
    return found


def _answer(number: int, rows: FloatArray, wanted: bool) -> tuple[FloatArray, FloatArray | None]:
    """Values and derivatives for the core."""
    found = _called.get(number)
    if found is None:
        raise InputError("a force law in Python is called whose system is gone")
    try:
        return found.answer(rows, wanted)
    except InputError as error:
        raise InputError(f"the law {found.law._name}: {error}") from None
    except Exception as error:
        raise InputError(
            f"the law {found.law._name} raised {type(error).__name__} ({_native.shown(error)})"
        ) from error
