"""The points of a sweep: the grid, and the computation of a part of it.

`compute` runs in threads and, with Dask, in other processes. It depends only on its
arguments and returns plain arrays.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib.errors import ConvergenceWarning, InputError, StabilityWarning

if TYPE_CHECKING:
    import xarray as xr

Array = npt.NDArray[Any]

#: Outcomes of a point; `point_outcome` contains the index. 0: the point is not computed yet.
OUTCOMES = ("not computed", "completed", "failed", "lost")
COMPLETED, FAILED, LOST = 1, 2, 3
#: Names of the variables that the sweep adds.
OUTCOME, ERROR = "point_outcome", "point_error"
#: Value of a variable at a point without a result, for each kind of dtype.
BLANK: dict[str, Any] = {"f": math.nan, "c": complex(math.nan, math.nan), "U": ""}
#: Stored type for each kind.
TYPES: dict[str, Any] = {
    "f": np.dtype(np.float64),
    "c": np.dtype(np.complex128),
    "U": np.dtypes.StringDType(),
}
_MAX_POINTS = 10**10
#: Python and NumPy types of a single real number, and of a word.
_PLAIN: dict[str, frozenset[type]] = {
    "f": frozenset({float, int, bool, np.float64, np.float32, np.int64, np.int32, np.bool_}),
    "U": frozenset({str}),
}


@dataclass(frozen=True)
class Grid:
    """Parameters and their values; the last parameter varies fastest in the order of points."""

    values: dict[str, Array]
    units: dict[str, str] = field(default_factory=dict)

    @classmethod
    def checked(cls, grid: Mapping[str, npt.ArrayLike]) -> Grid:
        """Check names and values."""
        if not isinstance(grid, Mapping) or not grid:
            raise InputError(
                f"grid = {_native.shown(grid)}: must be a mapping of names to lists of values"
            )
        values = {}
        for name, given in grid.items():
            if not isinstance(name, str) or not _is_name(name) or name in (OUTCOME, ERROR):
                raise InputError(f"grid: {name!r} is not a name of a parameter")
            array = _native.any_array(f"grid[{name!r}]", given)
            if array.ndim != 1 or not array.size:
                raise InputError(
                    f"grid[{name!r}]: must be a list of at least one value, got shape {array.shape}"
                )
            if array.dtype.kind not in "biufU":
                raise InputError(f"grid[{name!r}]: must be real numbers or words")
            if array.dtype.kind == "f" and not np.isfinite(array).all():
                raise InputError(f"grid[{name!r}]: must be finite numbers")
            values[name] = array.astype(np.float64) if array.dtype.kind == "f" else array
        made = cls(values)
        if made.size > _MAX_POINTS:
            raise InputError(f"grid: {made.size} points, must be at most {_MAX_POINTS:.0e}")
        return made

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(self.values)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values of each parameter."""
        return tuple(array.size for array in self.values.values())

    @property
    def size(self) -> int:
        """Number of points."""
        return math.prod(self.shape)

    def columns(self, box: Box) -> dict[str, Array]:
        """Values of each parameter at each point of a box."""
        parts = [v[cut] for v, cut in zip(self.values.values(), box, strict=True)]
        return {
            name: mesh.ravel()
            for name, mesh in zip(self.names, np.meshgrid(*parts, indexing="ij"), strict=True)
        }


def _is_name(name: str) -> bool:
    """Whether an array in a file may have this name."""
    return bool(name) and "/" not in name and not name.startswith((".", "__"))


#: A block of the grid: a slice of each parameter.
Box = tuple[slice, ...]


@dataclass(frozen=True)
class Chunks:
    """The grid divided into equal boxes; the last parameter varies fastest in their order."""

    shape: tuple[int, ...]
    chunk: tuple[int, ...]

    @classmethod
    def of_about(cls, shape: tuple[int, ...], points: int) -> Chunks:
        """Boxes of at most ``points`` points (at least 1), filled from the last parameter."""
        chunk, remaining = [], max(points, 1)
        for n in reversed(shape):
            chunk.append(min(n, max(remaining, 1)))
            remaining //= n
        return cls(shape, tuple(reversed(chunk)))

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of boxes along each parameter."""
        return tuple(-(-n // c) for n, c in zip(self.shape, self.chunk, strict=True))

    def __len__(self) -> int:
        return math.prod(self.counts)

    def box(self, i: int) -> Box:
        """The i-th box."""
        place = np.unravel_index(i, self.counts)
        return tuple(
            slice(int(p) * c, min((int(p) + 1) * c, n))
            for p, c, n in zip(place, self.chunk, self.shape, strict=True)
        )


def box_shape(box: Box) -> tuple[int, ...]:
    """Number of points of a box along each axis."""
    return tuple(cut.stop - cut.start for cut in box)


@dataclass(frozen=True)
class Variable:
    """One quantity of a result; its dimensions do not include those of the grid."""

    dims: tuple[str, ...]
    shape: tuple[int, ...]
    kind: str
    attrs: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Template:
    """Structure of the result at every point: variables and their common coordinates."""

    variables: dict[str, Variable]
    coords: dict[str, tuple[tuple[str, ...], Array, dict[str, Any]]]

    @property
    def plain(self) -> dict[str, frozenset[type]] | None:
        """Permitted types of each variable, if all are single real numbers and words."""
        kinds = {name: _PLAIN.get(v.kind) for name, v in self.variables.items() if v.shape == ()}
        single = len(kinds) == len(self.variables) and not self.coords
        return kinds if single and None not in kinds.values() else None  # type: ignore[return-value]

    def difference(self, other: Template) -> str:
        """Describe how another result differs from this one; empty if it does not."""
        if self.variables.keys() != other.variables.keys():
            return (
                f"the result has {', '.join(other.variables)}, other points have "
                f"{', '.join(self.variables)}"
            )
        for name, mine in self.variables.items():
            theirs = other.variables[name]
            if (mine.dims, mine.shape) != (theirs.dims, theirs.shape):
                return f"its {name!r} has shape {theirs.shape}, at other points {mine.shape}"
            if mine.kind != theirs.kind and (mine.kind, theirs.kind) != ("c", "f"):
                return f"its {name!r} is of another kind than at other points"
        for name, (_, values, _) in self.coords.items():
            if name not in other.coords or not np.array_equal(values, other.coords[name][1]):
                return f"its coordinate {name!r} differs from that at other points"
        return ""


@dataclass(frozen=True)
class Numbers:
    """Numbers and words by name, with units: a result that needs no analysis."""

    values: Mapping[str, Any]
    units: Mapping[str, str]


@dataclass(frozen=True)
class Computed:
    """Results of some points; the points are the first axis of each array."""

    outcome: npt.NDArray[np.int8]
    errors: list[str]
    template: Template | None
    arrays: dict[str, Array]
    #: The first exception, if it occurred in this process.
    cause: BaseException | None = field(default=None, compare=False)
    #: Time of one point (s), after the first one; NaN: not measured.
    seconds: float = field(default=math.nan, compare=False)

    @classmethod
    def none(cls, n: int, why: str) -> Computed:
        """Points that were lost because their worker died."""
        return cls(np.full(n, LOST, dtype=np.int8), [why] * n, None, {})


@dataclass(frozen=True)
class Task:
    """The computation at each point."""

    function: Callable[..., Any]
    vectorized: bool = False
    #: Continue after a point that fails.
    keep_errors: bool = False


def compute(
    task: Task,
    columns: dict[str, Array],
    template: Template | None = None,
    stopped: Callable[[], bool] = bool,
    with_cause: bool = False,
) -> Computed:
    """Compute some points; a failure is part of the returned value.

    ``stopped`` is called between points. After it returns True, the returned value is incomplete.
    """
    n = next(iter(columns.values())).size
    if task.vectorized:
        try:
            found, arrays = _gathered(task.function(**columns), n)
            if template is not None and (why := template.difference(found)):
                raise InputError(why)
            return Computed(np.full(n, COMPLETED, dtype=np.int8), [""] * n, found, arrays)
        except Exception as error:
            if n == 1:
                failed = np.full(1, FAILED, dtype=np.int8)
                return Computed(failed, [_text(error)], None, {}, _cause(error, with_cause))
        # One of the points fails: compute each separately to find it.
    return _one_by_one(task, columns, n, template, stopped, with_cause)


def timed(task: Task, columns: dict[str, Array], most: float) -> Computed:
    """Compute one point and measure its time.

    The first point of a worker includes imports and the start of libraries. If it takes less than
    ``most`` seconds, it is computed again for the measurement.
    """
    for _ in range(2):
        begun = time.perf_counter()
        part = compute(task, columns)
        seconds = time.perf_counter() - begun
        if seconds > most:
            break
    return replace(part, seconds=seconds)


def quiet() -> None:
    """Ignore warnings that the result of each point also contains."""
    warnings.simplefilter("ignore", ConvergenceWarning)
    warnings.simplefilter("ignore", StabilityWarning)


def _one_by_one(
    task: Task,
    columns: dict[str, Array],
    n: int,
    template: Template | None,
    stopped: Callable[[], bool],
    with_cause: bool,
) -> Computed:
    outcome = np.zeros(n, dtype=np.int8)
    errors, arrays, cause = [""] * n, dict[str, Array](), None
    # Arrays with one entry for a vectorized function, otherwise plain numbers and words.
    parts = [np.split(v, n) if task.vectorized else v.tolist() for v in columns.values()]
    plain = template.plain if template is not None else None
    for i, given in enumerate(zip(*parts, strict=True)):
        if stopped():
            break
        try:
            result = task.function(**dict(zip(columns, given, strict=True)))
            values: Mapping[str, Any] | None = None
            if plain is not None and not task.vectorized:
                values = _plainly(result, plain)
            if values is None:
                found, values = _gathered(result, 1) if task.vectorized else _result(result)
                if task.vectorized:
                    values = {name: value[0] for name, value in values.items()}
                if template is None:
                    template, plain = found, found.plain
                elif why := template.difference(found):
                    raise InputError(why)
            if not arrays and template is not None:
                arrays = blank(template, n)
            for name, value in values.items():
                arrays[name][i] = value
        except Exception as error:
            outcome[i], errors[i] = FAILED, _text(error)
            cause = cause or _cause(error, with_cause)
            if not task.keep_errors:
                break
            continue
        outcome[i] = COMPLETED
    return Computed(outcome, errors, template if arrays else None, arrays, cause)


def _plainly(result: Any, kinds: dict[str, frozenset[type]]) -> Mapping[str, Any] | None:
    """Return a result of numbers and words with these names unchanged, None for any other."""
    if isinstance(result, Numbers):
        result = result.values
    elif type(result) is not dict:
        result = {"result": result}
    if result.keys() != kinds.keys():
        return None
    for name, value in result.items():
        if type(value) not in kinds[name]:
            return None
    found: Mapping[str, Any] = result
    return found


def blank(template: Template, n: int) -> dict[str, Array]:
    """Arrays of n points without values."""
    return {
        name: np.full((n, *variable.shape), BLANK[variable.kind], dtype=TYPES[variable.kind])
        for name, variable in template.variables.items()
    }


def _text(error: BaseException) -> str:
    first = str(error).strip().splitlines()[:1]
    return f"{type(error).__name__}: {first[0]}" if first else type(error).__name__


def _cause(error: BaseException, wanted: bool) -> BaseException | None:
    return error if wanted else None


def _gathered(result: Any, n: int) -> tuple[Template, dict[str, Array]]:
    """Split a result for n points into variables whose first axis is the points."""
    template, arrays = _result(result, attributes=False)
    variables = {}
    for name, variable in template.variables.items():
        if variable.shape[:1] != (n,):
            raise InputError(
                f"vectorized: {name!r} has shape {variable.shape}, must be ({n}, ...): one "
                "entry per point first"
            )
        variables[name] = Variable(
            variable.dims[1:], variable.shape[1:], variable.kind, variable.attrs
        )
    points = {variable.dims[:1] for variable in template.variables.values()}
    coords = {name: coord for name, coord in template.coords.items() if coord[0][:1] not in points}
    return Template(variables, coords), arrays


def _result(result: Any, attributes: bool = True) -> tuple[Template, dict[str, Array]]:
    """Split a result into variables: numbers and arrays, or datasets with their coordinates."""
    import xarray as xr

    if hasattr(result, "to_dataset") and not isinstance(result, xr.DataArray):
        result = result.to_dataset()
    if isinstance(result, xr.DataArray):
        result = result.to_dataset(name=result.name or "result")
    if isinstance(result, xr.Dataset):
        return _from_dataset(result, attributes)
    units: Mapping[str, str] = {}
    if isinstance(result, Numbers):
        result, units = result.values, result.units
    if hasattr(result, "_asdict"):
        result = result._asdict()
    named = dict(result) if isinstance(result, Mapping) else {"result": result}
    if not named:
        raise InputError("result: is empty")
    variables, arrays = {}, {}
    for name, value in named.items():
        array, kind = _values(str(name), value)
        dims = tuple(f"{name}_{d}" for d in range(array.ndim))
        attrs = {"units": units[name]} if name in units else {}
        variables[str(name)] = Variable(dims, array.shape, kind, attrs)
        arrays[str(name)] = array
    return Template(variables, {}), arrays


def _from_dataset(dataset: xr.Dataset, attributes: bool) -> tuple[Template, dict[str, Array]]:
    variables, arrays = {}, {}
    for name, item in _items(dataset, attributes):
        array, kind = _values(name, item.values)
        attrs = {key: value for key, value in item.attrs.items() if isinstance(value, (str, float))}
        variables[name] = Variable(tuple(map(str, item.dims)), array.shape, kind, attrs)
        arrays[name] = array
    coords: dict[str, Any] = {}
    for key, coord in dataset.coords.items():
        values, kind = _values(str(key), coord.values, keep_integers=True)
        attrs = {k: value for k, value in coord.attrs.items() if isinstance(value, (str, float))}
        coords[str(key)] = (tuple(map(str, coord.dims)), values, attrs)
    return Template(variables, coords), arrays


def _items(dataset: xr.Dataset, attributes: bool) -> Iterator[tuple[str, Any]]:
    """Variables, and attributes that are a number or one line and may differ between points."""
    import xarray as xr

    for name, item in dataset.data_vars.items():
        yield str(name), item
    for key, value in dataset.attrs.items() if attributes else ():
        line = isinstance(value, str) and "\n" not in value
        if (line or isinstance(value, (int, float))) and key not in dataset:
            yield str(key), xr.Variable((), value)


def _values(name: str, value: Any, keep_integers: bool = False) -> tuple[Array, str]:
    """Return an array of one of the kinds that can be stored."""
    if isinstance(value, np.ma.MaskedArray) and value.dtype.kind in "biufc":
        # A masked value is missing, so it becomes NaN like a value that was not found.
        inexact = np.asarray(value.data, dtype=np.result_type(value.dtype, np.float64))
        value = np.where(np.ma.getmaskarray(value), math.nan, inexact)
    try:
        array = np.asarray(value)
    except Exception:
        raise InputError(f"result: {name!r} must be numbers of one shape") from None
    kind = array.dtype.kind
    if name in (OUTCOME, ERROR):
        raise InputError(f"result: {name!r} is a name that the sweep uses")
    if not _is_name(name):
        raise InputError(f"result: {name!r} is not a name of a variable")
    if kind == "O" and all(isinstance(item, str) for item in array.flat):
        kind = "U"
    if kind in "biuf":
        return (array if keep_integers else array.astype(np.float64, copy=False)), "f"
    if kind == "c":
        return array.astype(np.complex128, copy=False), "c"
    if kind in "UT":
        return array.astype(TYPES["U"]), "U"
    raise InputError(
        f"result: {name!r} = {type(value).__name__}: must be numbers, words, arrays or a dict of "
        "them, or have to_dataset"
    )
