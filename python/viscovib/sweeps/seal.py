"""Protection of a checkpoint against damage: seals of its chunks and a copy of its metadata.

A seal is a digest of the sweep (its job and its grid), the place of the chunk in
the grid, its outcomes and the files of all variables. If a chunk is exchanged with another, of
this sweep or of a similar one, its files are complete but its seal does not match.

Metadata and coordinates are small and necessary to read anything. A copy of them, with its
own digest, allows damaged ones to be restored. Seals and copy are in the folder of the outcomes,
where other readers of Zarr do not read them.
"""

import base64
import hashlib
import json
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib.common.files import Folder
from viscovib.errors import FileError
from viscovib.sweeps.points import OUTCOME

_META = "zarr.json"
COPIES = f"{OUTCOME}/copies.json"
#: Largest number of bytes of a copied coordinate, and of any file of a checkpoint.
_MOST, LARGEST = 1 << 22, 1 << 31


class Seals:
    """Digests of chunks, each in a small file."""

    def __init__(self, folder: Folder, identity: Any, grid_shape: Sequence[int]) -> None:
        self._folder = folder
        text = json.dumps([identity, list(grid_shape)], sort_keys=True)
        self._job = hashlib.sha256(text.encode()).digest()

    def write(
        self, place: tuple[int, ...], outcome: npt.NDArray[np.int8], files: Iterable[Path]
    ) -> None:
        """Seal a chunk whose variables are on disk; its outcomes are written afterwards."""
        self._folder.replace(self._name(place), self._digest(place, outcome, files).encode())

    def fits(
        self, place: tuple[int, ...], outcome: npt.NDArray[np.int8], files: Iterable[Path]
    ) -> bool:
        """Whether a chunk matches the seal at its place."""
        kept = self._folder.read(self._name(place), LARGEST)
        return kept == self._digest(place, outcome, files).encode()

    @staticmethod
    def _name(place: tuple[int, ...]) -> Path:
        return Path(OUTCOME, "seal", *map(str, place))

    def _digest(
        self, place: tuple[int, ...], outcome: npt.NDArray[np.int8], files: Iterable[Path]
    ) -> str:
        feed = hashlib.sha256(self._job)
        feed.update(f"{place} {outcome.shape}".encode() + np.ascontiguousarray(outcome).tobytes())
        for file in files:
            # Points that failed have no values.
            with suppress(FileNotFoundError):
                content = self._folder.read(file, LARGEST)
                feed.update(f"{file} {len(content)} ".encode() + content)
        return feed.hexdigest()


class Copies:
    """A copy of metadata and coordinates."""

    def __init__(self, folder: Folder) -> None:
        self._folder, self._path = folder, folder.path

    def save(self, attributes: dict[str, Any], coordinates: Iterable[str]) -> None:
        """Copy the present metadata and coordinates."""
        files = sorted(self._path.glob(f"*/{_META}"))
        for name in coordinates:
            data = [f for f in sorted((self._path / name / "c").rglob("*")) if f.is_file()]
            # The data of a number without dimensions are one file.
            data += [f for f in [self._path / name / "c"] if f.is_file()]
            if sum(f.stat().st_size for f in data) <= _MOST:
                files += data
        names = [f.relative_to(self._path) for f in files]
        held = {
            "attributes": attributes,
            "files": {
                str(name): base64.b64encode(self._folder.read(name, LARGEST)).decode()
                for name in names
            },
        }
        text = json.dumps(held)
        content = f"{hashlib.sha256(text.encode()).hexdigest()}\n{text}".encode()
        self._folder.replace(COPIES, content)

    def attributes(self) -> dict[str, Any] | None:
        """Return the attributes of the group from the copy; None without an undamaged copy."""
        held = self._held()
        found = None if held is None else held.get("attributes")
        return found if isinstance(found, dict) else None

    def group_attributes(self) -> dict[str, Any] | None:
        """Return the attributes of the group itself; None if its metadata are damaged."""
        try:
            found = json.loads(self._content(_META) or b"")["attributes"]
        except (ValueError, KeyError, TypeError, RecursionError):
            return None
        return found if isinstance(found, dict) else None

    def restore(self) -> None:
        """Restore the files that differ from the copy."""
        held = self._held()
        if held is None:
            return
        for name, content in held["files"].items():
            wanted = base64.b64decode(content)
            if self._content(name) != wanted:
                self._folder.replace(name, wanted)
        if self.group_attributes() != held["attributes"]:
            plain = {"zarr_format": 3, "node_type": "group", "attributes": held["attributes"]}
            self._folder.replace(_META, json.dumps(plain, indent=2).encode())

    def check(self) -> None:
        """Raise for metadata that cannot be read; no copy existed to restore them."""
        for file in [self._path / _META, *sorted(self._path.glob(f"*/{_META}"))]:
            name = file.relative_to(self._path)
            try:
                if not isinstance(json.loads(self._content(name) or b""), dict):
                    raise ValueError
            except Exception:
                raise FileError(
                    f"checkpoint = {self._path}: {name} is damaged and cannot be restored: use "
                    "another path, or remove this folder"
                ) from None

    def check_coordinates(self, names: Iterable[str]) -> None:
        """Raise for a coordinate whose file is missing and which no copy can restore.

        Zarr would read a missing file as zeros.
        """
        for name in names:
            place = self._path / name / "c"
            if not place.is_file() and not any(f.is_file() for f in place.rglob("*")):
                raise FileError(
                    f"checkpoint = {self._path}: the values of {name} are missing and cannot "
                    "be restored: use another path, or remove this folder"
                )

    def _held(self) -> dict[str, Any] | None:
        """Return the copy; None if there is none or it is damaged."""
        try:
            digest, _, text = (self._content(COPIES) or b"").decode().partition("\n")
            if hashlib.sha256(text.encode()).hexdigest() != digest:
                return None
            held: dict[str, Any] = json.loads(text)
        except ValueError:
            return None
        return held

    def _content(self, name: str | Path) -> bytes | None:
        try:
            return self._folder.read(name, LARGEST)
        except OSError:
            return None
