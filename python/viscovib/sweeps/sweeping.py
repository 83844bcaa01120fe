"""Runs over a grid of parameters in threads or on a Dask cluster; can resume after a stop."""

from __future__ import annotations

import inspect
import itertools
import math
import os
import warnings
from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib.common.fingerprint import describe, digest
from viscovib.common.progress import progress_bar
from viscovib.errors import InputError, SweepError
from viscovib.scene.scene import Scene
from viscovib.sweeps.points import (
    COMPLETED,
    ERROR,
    LOST,
    OUTCOME,
    OUTCOMES,
    Chunks,
    Computed,
    Grid,
    Task,
    Template,
    blank,
    quiet,
)
from viscovib.sweeps.scenes import scene_job
from viscovib.sweeps.store import DiskStore, MemoryStore, Store, is_begun
from viscovib.sweeps.workers import DaskWorkers, Threads, Workers

if TYPE_CHECKING:
    import xarray as xr

#: Intended work in a chunk (s), and its largest size (bytes).
_CHUNK_SECONDS, _CHUNK_BYTES = 0.5, 2**24
_CHUNK_POINTS = 4096
_MAX_CHUNKS = 10**6
_MAX_RETRIES = 100
_LANES = 8


def sweep(
    function_or_scene: Any,
    grid: Mapping[str, npt.ArrayLike] | None = None,
    client: Any = None,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: bool = True,
    *,
    errors: str = "raise",
    extract: Callable[..., Any] | str = "all",
    vectorized: bool = False,
    chunk: int | str = "auto",
    n_threads: int | None = None,
    retries: int = 2,
) -> xr.Dataset:
    """Compute a function or a scene at every point of a grid of parameters.

    Parameters
    ----------
    function_or_scene : callable, Scene or path
        A function with keyword arguments named as in the grid. It returns a number, a word, an
        array, a dict of them, a Dataset, or an object with ``to_dataset``, of one shape at all
        points. Or a scene, run with changed keys.
    grid : mapping of str to array_like, shape (n,)
        Values of each parameter, numbers or words; the grid is their product. For a scene the names
        are keys in their groups, such as "mount.stiffness_x"; for one of several groups
        "load(2).amplitude", for one entry of a list "transient.initial(3)", counted from 1. None:
        the &sweep groups of the scene.
    client : dask.distributed.Client, optional
        Compute on its cluster instead of in threads.
    checkpoint : path, optional
        A folder for the results (Zarr, format 3), written chunk by chunk. Existing chunks of the
        same sweep are not computed again. The returned Dataset reads from it.
    progress : bool
        Show a progress bar.
    errors : {"raise", "keep"}
        Treatment of a point that fails: "raise" ends the sweep with a `SweepError` that names the
        point; "keep" continues with NaN (words: ""). Then ``point_outcome`` is "completed",
        "failed" or "lost" (with its worker) for each point, and ``point_error`` contains the
        reason.
    extract : "all", "summary" or callable
        For a scene: the part of each result to keep. "all": its ``to_dataset``; "summary": a few
        numbers (`viscovib.sweeps.scenes.summary`); or a function of the SceneResult.
    vectorized : bool
        The function accepts arrays, one entry per point, and returns arrays with the points first:
        for `simulate_ensemble`, which computes thousands together.
    chunk : int or "auto"
        Points that are computed and written together. "auto": half a second of work, estimated from
        the first point; a vectorized function gets up to 4096. A checkpoint keeps its own value.
    n_threads : int, optional
        Default: the number of processors.
    retries : int
        Number of repetitions of a chunk whose Dask worker failed (Dask's ``allowed-failures``
        applies each time).

    Returns
    -------
    xarray.Dataset
        Over the grid; integers and booleans as floats, so that each may be NaN.

    Raises
    ------
    SweepError
        If a point failed.
    InputError
        For wrong arguments, or a checkpoint of a different function, scene or grid.

    Notes
    -----
    Ctrl-C stops immediately; finished chunks are in the checkpoint. A point that is being computed
    in a thread then ends in the background. The memory contains a few chunks at a time, and without
    a checkpoint the result. Warnings about convergence and stability are omitted: see the outcomes
    in the results.

    Examples
    --------
    >>> import viscovib as vv
    >>> mount = vv.Mount(
    ...     mass=1,
    ...     inertia=0.1,
    ...     offset=0.5,
    ...     stiffness_x=10,
    ...     stiffness_phi=2,
    ...     damping=[[0.2, -0.1], [-0.1, 0.09]],
    ... )
    >>> data = vv.sweep(
    ...     lambda load: (
    ...         vv.forced_response(mount, [1.0, 2.0], load=load).peak("x").amplitude
    ...     ),
    ...     {"load": [0.1, 0.2]},
    ...     progress=False,
    ... )
    """
    function, points, identity, name = _job(function_or_scene, grid, extract)
    mode = _native.choice("errors", errors, ("raise", "keep"))
    whole = _native.flag("vectorized", vectorized)
    progress = _native.flag("progress", progress)
    identity = {
        "viscovib": version("viscovib"),
        **identity,
        "vectorized": whole,
        "grid": {n: _axis(values) for n, values in points.values.items()},
    }
    task = Task(function, whole, mode == "keep")
    bound = _native.integer("retries", retries, 0, _MAX_RETRIES)
    cores = os.cpu_count() or 1
    threads = cores if n_threads is None else _native.integer("n_threads", n_threads, 1, 4096)
    wanted = None if _native.is_auto(chunk) else _chunk(chunk, points)
    with warnings.catch_warnings():
        quiet()
        workers: Workers = (
            Threads(task, min(threads, points.size))
            if client is None
            else DaskWorkers(task, client, bound)
        )
        try:
            data = _Sweep(points, mode == "keep", workers, whole).run(
                wanted, checkpoint, identity, progress
            )
        finally:
            workers.close()
    data.attrs |= {"swept": name, "viscovib": version("viscovib")}
    return data


class _Sweep:
    """The execution of a sweep."""

    def __init__(self, grid: Grid, keep: bool, workers: Workers, vectorized: bool) -> None:
        self.grid, self.keep, self.workers, self.vectorized = grid, keep, workers, vectorized
        self.first: Computed | None = None

    def run(
        self,
        wanted: int | None,
        checkpoint: str | os.PathLike[str] | None,
        identity: dict[str, Any],
        progress: bool,
    ) -> xr.Dataset:
        if checkpoint is None:
            store: Store = MemoryStore(self.grid, self._chunks(wanted))
            self._fill(store, np.zeros(len(store.chunks), dtype=bool), progress)
            return self._named(store.dataset())
        path = _path(checkpoint)
        begun = is_begun(path)
        # An existing checkpoint defines its chunks, so that the first point needs no trial.
        chunks = Chunks.of_about(self.grid.shape, 1) if begun else self._chunks(wanted)
        disk = DiskStore(path, self.grid, chunks, identity)
        try:
            self._fill(disk, disk.finished(self.keep), progress)
            return self._named(disk.dataset())
        finally:
            disk.close()

    def _chunks(self, wanted: int | None) -> Chunks:
        """Divide the grid into chunks; may compute the first point to choose their size."""
        least = -(-self.grid.size // _MAX_CHUNKS)
        if wanted is None and self.vectorized:
            share = -(-self.grid.size // (2 * self.workers.capacity))
            wanted = min(-(-share // _LANES) * _LANES, _CHUNK_POINTS)
        elif wanted is None:
            origin = tuple(slice(0, 1) for _ in self.grid.shape)
            self.first = self.workers.trial(self.grid.columns(origin), _CHUNK_SECONDS)
            self._check(self.first, self.grid.columns(origin))
            seconds = self.first.seconds
            taken = _CHUNK_SECONDS if math.isnan(seconds) else max(seconds, 1e-6)
            size = sum(array.nbytes for array in self.first.arrays.values())
            share = -(-self.grid.size // (2 * self.workers.capacity))
            wanted = min(
                share, _CHUNK_POINTS, int(_CHUNK_SECONDS / taken), _CHUNK_BYTES // max(size, 1)
            )
        return Chunks.of_about(self.grid.shape, max(wanted, least, 1))

    def _fill(self, store: Store, done: npt.NDArray[np.bool_], progress: bool) -> None:
        """Compute the missing chunks, a few at a time, and store each when it is finished."""
        points = math.prod(store.chunks.chunk)
        with progress_bar(
            self.grid.size, "points", progress, min(int(done.sum()) * points, self.grid.size)
        ) as bar:
            for i, part in self._parts(store, np.flatnonzero(~done).tolist()):
                columns = self.grid.columns(store.chunks.box(i))
                self._check(part, columns)
                if part.template is not None:
                    self._agree(store, part.template, columns)
                store.write(i, part)
                bar.update(part.outcome.size)

    def _parts(self, store: Store, missing: list[int]) -> Iterator[tuple[int, Computed]]:
        """Chunks in the order in which they finish; a few are computed at a time."""
        first, self.first = self.first, None
        if first is not None and math.prod(store.chunks.chunk) == 1:
            yield missing.pop(0), first
        waiting, under_way = iter(missing), 0
        while True:
            for i in itertools.islice(waiting, self.workers.capacity - under_way):
                columns = self.grid.columns(store.chunks.box(i))
                if first is not None and i == 0:
                    columns = {name: values[1:] for name, values in columns.items()}
                like = store.template or (first.template if first is not None else None)
                self.workers.submit(i, columns, like)
                under_way += 1
            if not under_way:
                return
            i, part = self.workers.next()
            under_way -= 1
            yield i, part if first is None or i > 0 else _joined(first, part)

    def _check(self, part: Computed, columns: dict[str, Any]) -> None:
        """Raise if a point failed, unless failures are kept."""
        bad = np.flatnonzero(part.outcome > COMPLETED)
        if bad.size and not self.keep:
            k = int(bad[0])
            if part.outcome[k] == LOST:
                last = {name: values[-1] for name, values in columns.items()}
                text = f"{_words(columns, 0)} to {', '.join(f'{n} = {v}' for n, v in last.items())}"
                raise SweepError(f"between {text}: {part.errors[k]}", _point(columns, 0))
            raise SweepError(
                f"at {_words(columns, k)}: {part.errors[k]}", _point(columns, k)
            ) from part.cause

    def _agree(self, store: Store, template: Template, columns: dict[str, Any]) -> None:
        """Make the arrays for the first result; later results must have the same structure."""
        if store.template is None:
            _check_names(template, self.grid)
            store.define(template)
        elif why := store.template.difference(template):
            raise SweepError(f"at {_words(columns, 0)}: {why}", _point(columns, 0))

    def _named(self, data: xr.Dataset) -> xr.Dataset:
        if not self.keep:
            return data.drop_vars([OUTCOME, ERROR])
        outcome = data[OUTCOME]
        words = np.array(OUTCOMES)[outcome.values]
        return data.assign({OUTCOME: (outcome.dims, words)})


def _job(
    what: Any, grid: Mapping[str, npt.ArrayLike] | None, extract: Callable[..., Any] | str
) -> tuple[Callable[..., Any], Grid, dict[str, Any], str]:
    """Return the function, its grid, its identity and its name."""
    if isinstance(what, (str, os.PathLike, Scene)):
        return scene_job(what, grid, extract)
    if not callable(what):
        raise InputError(
            f"function_or_scene = {_native.shown(what)}: "
            "must be a function, a scene or the path of one"
        )
    if not (isinstance(extract, str) and extract == "all"):
        raise InputError("extract: is for scenes; a function returns what is to be kept")
    if grid is None:
        raise InputError("grid: must be given with a function")
    points = Grid.checked(grid)
    name = getattr(what, "__qualname__", None) or type(what).__qualname__
    try:
        inspect.signature(what).bind(**dict.fromkeys(points.names))
    except TypeError as error:
        raise InputError(f"grid: does not fit the arguments of {name} ({error})") from None
    except ValueError:
        pass
    return what, points, {"function": {"name": name, **describe(what)}}, name


def _axis(values: npt.NDArray[Any]) -> dict[str, Any]:
    first, last = values[0].item(), values[-1].item()
    return {"count": int(values.size), "first": first, "last": last, "values": digest(values)}


def _chunk(chunk: int | str, grid: Grid) -> int:
    if isinstance(chunk, str):
        raise InputError(f"chunk = {_native.shown(chunk)}: must be a number of points or 'auto'")
    wanted = _native.integer("chunk", chunk, 1, 2**31)
    if len(Chunks.of_about(grid.shape, wanted)) > _MAX_CHUNKS:
        raise InputError(f"chunk = {wanted}: gives more than {_MAX_CHUNKS} chunks, must be larger")
    return wanted


def _path(checkpoint: Any) -> str:
    try:
        return os.fsdecode(checkpoint)
    except TypeError:
        raise InputError(f"checkpoint = {_native.shown(checkpoint)}: must be a path") from None


def _check_names(template: Template, grid: Grid) -> None:
    for name in grid.names:
        dims = {d for item in template.variables.values() for d in item.dims}
        if name in template.variables or name in template.coords or name in dims:
            raise InputError(
                f"result: {name!r} is a parameter of the grid, must be named otherwise"
            )


def _joined(first: Computed, remaining: Computed) -> Computed:
    """Put the point of the first trial before the other points of its chunk."""
    template = first.template or remaining.template
    n, arrays = remaining.outcome.size, {}
    if template is not None:
        head = first.arrays or blank(template, 1)
        tail = remaining.arrays or blank(template, n)
        arrays = {name: np.concatenate([head[name], tail[name]]) for name in head}
    return Computed(
        np.concatenate([first.outcome, remaining.outcome]),
        first.errors + remaining.errors,
        template,
        arrays,
        first.cause or remaining.cause,
    )


def _words(columns: dict[str, Any], k: int) -> str:
    return ", ".join(f"{name} = {value}" for name, value in _point(columns, k).items())


def _point(columns: dict[str, Any], k: int) -> dict[str, Any]:
    return {name: values[k].item() for name, values in columns.items()}
