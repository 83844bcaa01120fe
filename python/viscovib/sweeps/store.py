"""Storage of the results of a sweep: in memory, or chunk by chunk on disk.

On disk it is a Zarr group (format 3) with one file for each chunk and variable. The file gets its
name when complete, is compressed and ends with a CRC-32C. NetCDF is not used: its single file can
be unreadable after a kill and has no complex numbers. A chunk is finished if its outcomes,
written last, and all its variables exist and match its seal (`viscovib.sweeps.seal`).
"""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from viscovib.common.files import Folder
from viscovib.errors import FileError, InputError, ViscovibError
from viscovib.sweeps.points import (
    BLANK,
    COMPLETED,
    ERROR,
    OUTCOME,
    OUTCOMES,
    TYPES,
    Chunks,
    Computed,
    Grid,
    Template,
    Variable,
    box_shape,
)
from viscovib.sweeps.seal import COPIES, LARGEST, Copies, Seals

if TYPE_CHECKING:
    import xarray as xr

_T = TypeVar("_T")
_ABOUT = "viscovib_sweep"
#: Time to finish a write after Ctrl-C (s).
_PATIENCE = 0.5
_FLAGS = {"flag_values": list(range(len(OUTCOMES))), "flag_meanings": " ".join(OUTCOMES)}


class Store(Protocol):
    """Stores chunks."""

    chunks: Chunks
    template: Template | None

    def define(self, template: Template) -> None:
        """Make the arrays of the variables."""

    def write(self, i: int, part: Computed) -> None:
        """Store the i-th chunk."""

    def dataset(self) -> xr.Dataset:
        """All stored results, with outcomes as numbers."""


class MemoryStore:
    """Arrays in memory."""

    def __init__(self, grid: Grid, chunks: Chunks) -> None:
        self.grid, self.chunks = grid, chunks
        self.template: Template | None = None
        self._outcome = np.zeros(grid.shape, dtype=np.int8)
        self._errors: dict[tuple[int, ...], str] = {}
        self._arrays: dict[str, npt.NDArray[Any]] = {}

    def define(self, template: Template) -> None:
        """Make the arrays of the variables."""
        self.template = template
        for name, item in template.variables.items():
            shape = (*self.grid.shape, *item.shape)
            self._arrays[name] = np.full(shape, BLANK[item.kind], dtype=TYPES[item.kind])

    def write(self, i: int, part: Computed) -> None:
        """Store the i-th chunk."""
        box = self.chunks.box(i)
        shape = box_shape(box)
        for name, values in part.arrays.items():
            self._arrays[name][box] = values.reshape(*shape, *values.shape[1:])
        self._outcome[box] = part.outcome.reshape(shape)
        for k in np.flatnonzero(part.outcome != COMPLETED):
            place = np.unravel_index(k, shape)
            key = tuple(int(p) + cut.start for p, cut in zip(place, box, strict=True))
            self._errors[key] = part.errors[k]

    def dataset(self) -> xr.Dataset:
        """All results."""
        import xarray as xr

        errors = np.full(self.grid.shape, "", dtype=object)
        for key, text in self._errors.items():
            errors[key] = text
        names = self.grid.names
        data: dict[str, Any] = {OUTCOME: (names, self._outcome), ERROR: (names, errors)}
        coords: dict[str, Any] = {
            name: (name, values, _units(self.grid, name))
            for name, values in self.grid.values.items()
        }
        if self.template is not None:
            for name, item in self.template.variables.items():
                data[name] = ((*names, *item.dims), self._arrays[name], item.attrs)
            coords |= self.template.coords
        return xr.Dataset(data, coords=coords)


def is_begun(path: str | os.PathLike[str]) -> bool:
    """Whether a folder contains a Zarr group, or only the copy of its metadata."""
    return any(os.path.lexists(Path(path, name)) for name in ("zarr.json", COPIES))


class DiskStore:
    """A Zarr group: a new one, or an existing one of the same sweep."""

    def __init__(
        self, path: str | os.PathLike[str], grid: Grid, chunks: Chunks, identity: dict[str, Any]
    ) -> None:
        self.path, self.grid, self.chunks = Path(path), grid, chunks
        self.template: Template | None = None
        self._arrays: dict[str, Any] = {}
        self._thread = ThreadPoolExecutor(1)
        # Start the thread now: after Ctrl-C during its start it would continue unseen.
        self._thread.submit(int).result()
        self._folder: Folder | None = None
        # The identity passes through JSON, like the one it is compared with.
        self._identity: dict[str, Any] = json.loads(json.dumps(identity))
        _zarr()
        try:
            self._apart(self._start)
        except BaseException as error:
            self.close()
            if isinstance(error, ViscovibError) or not isinstance(error, Exception):
                raise
            raise self._unusable(error) from None

    def _start(self) -> None:
        """Open the group or make it."""
        zarr = _zarr()
        self.path.mkdir(parents=True, exist_ok=True)
        self._folder = _locked(self.path)
        self._seals = Seals(self._folder, self._identity, self.grid.shape)
        if is_begun(self.path):
            self._reopen()
        else:
            if any(self.path.iterdir()):
                raise InputError(f"checkpoint = {self.path}: exists and is not a checkpoint")
            about = {
                "identity": self._identity, "chunk": list(self.chunks.chunk), "variables": None
            }  # fmt: skip
            # Do not overwrite: that would make a new folder, which is not locked.
            self._group = zarr.create_group(self.path, zarr_format=3, attributes={_ABOUT: about})
        if not all(name in self._group for name in (OUTCOME, ERROR, *self.grid.names)):
            self._begin()

    def _reopen(self) -> None:
        """Open the group, whose origin may be unknown.

        The identity is compared before anything is written; links are not followed.
        """
        assert self._folder is not None
        try:
            self._folder.check(LARGEST)
        except FileError as error:
            raise FileError(f"checkpoint = {error}") from None
        copies = Copies(self._folder)
        here, copied = copies.group_attributes(), copies.attributes()
        sound = copied is not None and not self._wrong(copied)
        if not sound and (here is not None or copied is not None):
            # The copy must be that of the same sweep.
            self._check(here if here is not None else copied)
        if sound:
            copies.restore()
        copies.check()
        # Codecs of other formats may execute the data that they read.
        self._group = _zarr().open_group(
            self.path, mode="r+", use_consolidated=False, zarr_format=3
        )
        about = self._group.attrs[_ABOUT]
        if about.get("variables") is not None and not sound:
            copies.check_coordinates([*self.grid.names, *about.get("coords", ())])
        self.chunks = Chunks(self.grid.shape, tuple(about["chunk"]))
        if about.get("variables") is not None:
            self.template = self._read_template(about)

    def _unusable(self, error: Exception) -> FileError:
        """Return the error for files that cannot be read."""
        why = " ".join(f"{getattr(error, 'strerror', None) or error}".split())[:200]
        return FileError(f"checkpoint = {self.path}: cannot be used ({why})")

    def _wrong(self, attributes: Any) -> str:
        """Describe the error in attributes of a group; empty if they are those of this sweep."""
        about = attributes.get(_ABOUT)
        if not isinstance(about, dict) or "identity" not in about:
            return "is not the checkpoint of a sweep"
        if why := _difference(about["identity"], self._identity):
            return f"contains another sweep ({why}); use another path"
        return ""

    def _check(self, attributes: Any) -> None:
        if why := self._wrong(attributes):
            raise InputError(f"checkpoint = {self.path}: {why}")

    def _begin(self) -> None:
        names = self.grid.names
        for name, values in self.grid.values.items():
            self._coordinate(name, (name,), values, _units(self.grid, name))
        chunk = self.chunks.chunk
        self._array(OUTCOME, self.grid.shape, chunk, np.dtype(np.int8), names, 0, _FLAGS)
        self._array(ERROR, self.grid.shape, chunk, str, names, "", {})
        self._save_copies(names)

    def _save_copies(self, coordinates: Iterable[str]) -> None:
        assert self._folder is not None
        Copies(self._folder).save(dict(self._group.attrs), coordinates)

    def define(self, template: Template) -> None:
        """Make the arrays of the variables."""
        self._written(self._define, template)

    def write(self, i: int, part: Computed) -> None:
        """Store the i-th chunk; its outcomes are last, so that they indicate a complete chunk."""
        self._written(self._write, i, part)

    def _written(self, action: Callable[..., None], *given: Any) -> None:
        try:
            self._apart(action, *given)
        except OSError as error:
            if isinstance(error, ViscovibError):
                raise
            why = error.strerror or error
            raise FileError(f"checkpoint = {self.path}: cannot be written ({why})") from None

    def _apart(self, action: Callable[..., _T], *given: Any) -> _T:
        """Work on the files in a thread, so that Ctrl-C does not interrupt the work.

        Coroutines of Zarr then always run to their end.
        """
        work = self._thread.submit(action, *given)
        try:
            return work.result()
        except KeyboardInterrupt:
            wait([work], timeout=_PATIENCE)
            raise

    def _define(self, template: Template) -> None:
        for name, item in template.variables.items():
            kind = str if item.kind == "U" else TYPES[item.kind]
            shape, extent = (*self.grid.shape, *item.shape), tuple(max(n, 1) for n in item.shape)
            self._array(
                name, shape, (*self.chunks.chunk, *extent), kind, (*self.grid.names, *item.dims),
                BLANK[item.kind], item.attrs,
            )  # fmt: skip
        for name, (dims, values, attrs) in template.coords.items():
            self._coordinate(name, dims, values, attrs)
        about = dict(self._group.attrs[_ABOUT])
        about["variables"] = {n: item.kind for n, item in template.variables.items()}
        about["coords"] = list(template.coords)
        self._group.attrs[_ABOUT] = about
        self._save_copies([*self.grid.names, *template.coords])
        self.template = template

    def _read_template(self, about: dict[str, Any]) -> Template:
        n = len(self.grid.names)
        variables, coords = {}, {}
        for name in (*about["variables"], *about["coords"]):
            # The name must be below the folder: its files are removed where a point failed.
            if Path(name).is_absolute() or ".." in Path(name).parts:
                raise ValueError(f"it has a variable {name!r}")
        for name, kind in about["variables"].items():
            array = self._group[name]
            dims, attrs = array.metadata.dimension_names[n:], dict(array.attrs)
            variables[name] = Variable(tuple(dims), array.shape[n:], kind, attrs)
        for name in about["coords"]:
            array = self._group[name]
            if array.nbytes > LARGEST:
                raise ValueError(f"{name} has more than {LARGEST // 2**20} MB")
            coords[name] = (array.metadata.dimension_names, array[...], dict(array.attrs))
        return Template(variables, coords)

    def _array(
        self,
        name: str,
        shape: tuple[int, ...],
        chunk: tuple[int, ...],
        kind: Any,
        dims: tuple[str, ...],
        fill: Any,
        attrs: dict[str, Any],
    ) -> Any:
        from zarr.codecs import Crc32cCodec, ZstdCodec

        return self._group.create_array(
            name,
            shape=shape,
            chunks=chunk,
            dtype=kind,
            fill_value=fill,
            dimension_names=dims,
            attributes=attrs,
            compressors=[ZstdCodec(level=1), Crc32cCodec()],
            overwrite=True,
        )

    def _coordinate(
        self, name: str, dims: tuple[str, ...], values: Any, attrs: dict[str, Any]
    ) -> None:
        array = np.asarray(values)
        kind = str if array.dtype.kind in "UTO" else array.dtype
        fill = "" if kind is str else np.zeros((), dtype=array.dtype)[()]
        extent = tuple(max(n, 1) for n in array.shape)
        self._array(name, array.shape, extent, kind, dims, fill, attrs)[...] = array

    def finished(self, failures_count: bool) -> npt.NDArray[np.bool_]:
        """Mark complete and undamaged chunks; with failed points only if ``failures_count``."""
        n = len(self.chunks)
        done = np.zeros(n, dtype=bool)
        for i in range(n):
            with suppress(Exception):
                done[i] = self._apart(self._sound, i, failures_count)
        return done

    def _open(self, name: str) -> Any:
        """Return an array; open it only once."""
        if name not in self._arrays:
            # Write a file for a chunk of blanks too: otherwise it would look like a missing chunk.
            with _zarr().config.set({"array.write_empty_chunks": True}):
                self._arrays[name] = self._group[name]
        return self._arrays[name]

    def _sound(self, i: int, failures_count: bool) -> bool:
        box = self.chunks.box(i)
        place = self._place(i)
        if not (self.path / self._file(OUTCOME, place)).exists():
            return False
        # Reading raises if a checksum is wrong.
        outcome = self._open(OUTCOME)[box]
        if not (outcome == COMPLETED).all() and not (failures_count and (outcome != 0).all()):
            return False
        if self.template is None and (outcome == COMPLETED).any():
            return False
        return self._seals.fits(place, outcome, self._files(place))

    def _place(self, i: int) -> tuple[int, ...]:
        """Index of a chunk along each parameter."""
        box = self.chunks.box(i)
        return tuple(cut.start // c for cut, c in zip(box, self.chunks.chunk, strict=True))

    def _files(self, place: tuple[int, ...]) -> list[Path]:
        """Files of a chunk, relative to the folder, without that of its outcomes."""
        files = [self._file(ERROR, place)]
        for name, item in (self.template.variables if self.template else {}).items():
            files.append(self._file(name, (*place, *(0 for _ in item.shape))))
        return files

    def _file(self, name: str, place: tuple[int, ...]) -> Path:
        return Path(name, "c", *map(str, place))

    def _write(self, i: int, part: Computed) -> None:
        box = self.chunks.box(i)
        shape = box_shape(box)
        errors = np.array(part.errors, dtype=TYPES["U"])
        for name, values in part.arrays.items():
            if values.size:
                self._open(name)[box] = values.reshape(*shape, *values.shape[1:])
        self._open(ERROR)[box] = errors.reshape(shape)
        place, outcome = self._place(i), part.outcome.reshape(shape)
        if not part.arrays:
            # Failed points have no values: an existing file belongs to another chunk.
            for file in self._files(place)[1:]:
                (self.path / file).unlink(missing_ok=True)
        self._seals.write(place, outcome, self._files(place))
        self._open(OUTCOME)[box] = outcome

    def dataset(self) -> xr.Dataset:
        """All results; they are read from disk when used."""
        try:
            data = self._apart(self._opened)
        except Exception as error:
            raise self._unusable(error) from None
        data.attrs.pop(_ABOUT, None)
        wanted, coords = [OUTCOME, ERROR], []
        if self.template is not None:
            wanted += self.template.variables
            coords = list(self.template.coords)
        return data.set_coords(coords)[wanted]

    def _opened(self) -> xr.Dataset:
        import xarray as xr

        with warnings.catch_warnings():
            # Zarr warns that consolidated metadata are not yet part of format 3.
            warnings.simplefilter("ignore")
            _zarr().consolidate_metadata(self._group.store, zarr_format=3)
        opened: xr.Dataset = xr.open_zarr(
            self.path, chunks=None, consolidated=False, mask_and_scale=False, zarr_format=3
        )
        return opened

    def close(self) -> None:
        """Release the checkpoint for other processes after the present write."""
        wait([self._thread.submit(self._release)], timeout=_PATIENCE)
        self._thread.shutdown(wait=False)

    def _release(self) -> None:
        if self._folder is not None:
            self._folder.close()


def _units(grid: Grid, name: str) -> dict[str, str]:
    return {"units": grid.units[name]} if name in grid.units else {}


def _zarr() -> Any:
    try:
        import zarr
    except ImportError:
        raise InputError(
            "checkpoint: needs the package zarr: pip install 'viscovib[sweep]'"
        ) from None
    return zarr


def _locked(path: Path) -> Folder:
    """Lock the folder against other processes; the lock always ends with this process."""
    folder = Folder(path)
    try:
        import fcntl

        fcntl.flock(folder.handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except ImportError:
        pass
    except OSError:
        folder.close()
        raise InputError(
            f"checkpoint = {path}: is being written by another sweep, use another path"
        ) from None
    return folder


def _difference(old: Any, new: Any, name: str = "") -> str:
    """Describe the first difference between two identities; empty if there is none."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in {**old, **new}:
            place = f"{name} {key}".strip()
            if key not in new:
                return f"{place}: is gone"
            if key not in old:
                return f"{place}: is new"
            if why := _difference(old[key], new[key], place):
                return why
        if list(old) != list(new):
            return f"{name}: have another order"
        return ""
    if old == new:
        return ""
    digests = isinstance(old, str) and isinstance(new, str) and len(old) == len(new) == 24
    return f"{name}: differs" if digests else f"{name}: was {old}, is {new}"
