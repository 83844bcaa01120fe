"""What makes a checkpoint of a sweep trustworthy: seals of its chunks and a copy of its metadata.

A seal is a digest of everything that a chunk is: the sweep (its job and its grid), the place in
the grid, the outcomes and the files of all variables. A chunk that was swapped with another, of
this sweep or of a like one, has files that are whole and a seal that does not fit.

Metadata and coordinates are small and needed to read anything at all. A copy of them, with a
digest of its own, lets damaged ones be put right. Both lie in the folder of the outcomes, where
other readers of Zarr do not look.
"""

import base64
import hashlib
import json
import os
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib.errors import FileError
from viscovib.sweeps.points import OUTCOME

_META = "zarr.json"
#: Bytes of coordinates that are copied at most.
_MOST = 1 << 22


class Seals:
    """Digests of chunks, a small file each."""

    def __init__(self, path: Path, identity: Any, grid_shape: Sequence[int]) -> None:
        self._path = path
        text = json.dumps([identity, list(grid_shape)], sort_keys=True)
        self._job = hashlib.sha256(text.encode()).digest()

    def write(
        self, place: tuple[int, ...], outcome: npt.NDArray[np.int8], files: Iterable[Path]
    ) -> None:
        """Seal a chunk whose variables are on disk, and whose outcomes are not yet."""
        replace(self._file(place), self._digest(place, outcome, files).encode())

    def fits(
        self, place: tuple[int, ...], outcome: npt.NDArray[np.int8], files: Iterable[Path]
    ) -> bool:
        """Whether a chunk is what was sealed at its place."""
        kept = self._file(place).read_bytes()
        return kept == self._digest(place, outcome, files).encode()

    def _file(self, place: tuple[int, ...]) -> Path:
        return self._path.joinpath(OUTCOME, "seal", *map(str, place))

    def _digest(
        self, place: tuple[int, ...], outcome: npt.NDArray[np.int8], files: Iterable[Path]
    ) -> str:
        feed = hashlib.sha256(self._job)
        feed.update(f"{place} {outcome.shape}".encode() + np.ascontiguousarray(outcome).tobytes())
        for file in files:
            # Points that failed have no values.
            if file.exists():
                content = file.read_bytes()
                feed.update(f"{file.relative_to(self._path)} {len(content)} ".encode() + content)
        return feed.hexdigest()


class Copies:
    """A copy of metadata and coordinates."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file = path / OUTCOME / "copies.json"

    def save(self, attributes: dict[str, Any], coordinates: Iterable[str]) -> None:
        """Copy what is there now."""
        files = sorted(self._path.glob(f"*/{_META}"))
        for name in coordinates:
            data = [f for f in sorted((self._path / name / "c").rglob("*")) if f.is_file()]
            # A number without dimensions is one file.
            data += [f for f in [self._path / name / "c"] if f.is_file()]
            if sum(f.stat().st_size for f in data) <= _MOST:
                files += data
        held = {
            "attributes": attributes,
            "files": {
                str(f.relative_to(self._path)): base64.b64encode(f.read_bytes()).decode()
                for f in files
            },
        }
        text = json.dumps(held)
        replace(self._file, f"{hashlib.sha256(text.encode()).hexdigest()}\n{text}".encode())

    def restore(self) -> None:
        """Put right what differs from the copy; a copy that is damaged itself is not used."""
        held = self._held()
        if held is None:
            return
        for name, content in held["files"].items():
            if ".." in Path(name).parts or Path(name).is_absolute():
                continue
            wanted, file = base64.b64decode(content), self._path / name
            if _content(file) != wanted:
                replace(file, wanted)
        root = self._path / _META
        try:
            known = json.loads(_content(root) or b"")["attributes"] == held["attributes"]
        except Exception:
            known = False
        if not known:
            plain = {"zarr_format": 3, "node_type": "group", "attributes": held["attributes"]}
            replace(root, json.dumps(plain, indent=2).encode())

    @property
    def begun(self) -> bool:
        """Whether there is a copy, of which a checkpoint could be put right."""
        return self._held() is not None

    def check(self) -> None:
        """Name metadata that cannot be read: no copy was there to put them right."""
        for file in [self._path / _META, *sorted(self._path.glob(f"*/{_META}"))]:
            try:
                if not isinstance(json.loads(file.read_bytes()), dict):
                    raise ValueError
            except Exception:
                name = file.relative_to(self._path)
                raise FileError(
                    f"checkpoint = {self._path}: {name} is damaged and cannot be put right; must "
                    "be another path, or this one removed"
                ) from None

    def check_coordinates(self, names: Iterable[str]) -> None:
        """Name a coordinate whose file is gone where no copy can bring it back.

        A file that is not there would be read as zeros.
        """
        if self._held() is not None:
            return
        for name in names:
            place = self._path / name / "c"
            if not place.is_file() and not any(f.is_file() for f in place.rglob("*")):
                raise FileError(
                    f"checkpoint = {self._path}: the values of {name} are gone and cannot be put "
                    "right; must be another path, or this one removed"
                )

    def _held(self) -> dict[str, Any] | None:
        try:
            digest, _, text = self._file.read_text().partition("\n")
            if hashlib.sha256(text.encode()).hexdigest() != digest:
                return None
            held: dict[str, Any] = json.loads(text)
        except (OSError, ValueError):
            return None
        return held


def _content(file: Path) -> bytes | None:
    try:
        return file.read_bytes()
    except OSError:
        return None


def replace(file: Path, content: bytes) -> None:
    """Put a file in place whole."""
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_name(f"{file.name}.part")
    try:
        part.write_bytes(content)
        os.replace(part, file)
    finally:
        with suppress(OSError):
            part.unlink()
