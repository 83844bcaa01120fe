"""Atomic writing of files, and reading of regular files only."""

import errno
import os
import stat
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, BinaryIO

from viscovib.common.parameters import FilePath
from viscovib.errors import FileError

#: Locks: threads write the same file one after another, because its part has one name.
_WRITING: dict[Path, threading.RLock] = {}


@contextmanager
def regular_file(path: str | os.PathLike[str], largest: int, what: str) -> Iterator[BinaryIO]:
    """Open a regular file for reading: pipes, devices and files of /proc have no end.

    ``largest``: largest size in bytes; ``what``: required kind of file. System errors become a
    `FileError`.
    """
    try:
        # Opening a pipe without a writer would block.
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
            _check_regular(file, path, largest, what)
            yield file
    except FileError:
        raise
    except OSError as error:
        raise FileError(f"{path}: cannot be read ({error.strerror or error})") from None


def bytes_of(path: str, largest: int, what: str) -> bytes:
    """Return a regular file of at most ``largest`` bytes; ``what``: required kind of file."""
    try:
        with regular_file(path, largest, what) as file:
            # Without a size Python would reserve more memory.
            return file.read(os.fstat(file.fileno()).st_size)
    except ValueError as error:
        if isinstance(error, FileError):
            raise
        raise FileError(f"{path}: cannot be read ({error})") from None


def _check_regular(file: BinaryIO, path: str | os.PathLike[str], largest: int, what: str) -> None:
    found = os.fstat(file.fileno())
    if stat.S_ISDIR(found.st_mode):
        raise FileError(f"{path}: cannot be read (Is a directory)")
    # Files that the system generates during reading have the size 0.
    if not stat.S_ISREG(found.st_mode) or (found.st_size == 0 and file.read(1)):
        raise FileError(f"{path}: cannot be read (not a regular file)")
    if found.st_size > largest:
        raise FileError(f"{path}: has more than {largest // 2**20} MB, must be {what}")


class Folder:
    """A folder, opened once; files are read and replaced without following links.

    Names are paths below the folder. A link in any part of such a path is refused by the system.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.handle = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)

    def close(self) -> None:
        """Close the handle; a second time does nothing."""
        if self.handle >= 0:
            os.close(self.handle)
        self.handle = -1

    def read(self, name: str | os.PathLike[str], largest: int) -> bytes:
        """Return the content of a regular file."""
        with self._parent(name) as (folder, last):
            flags = os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC
            with open(os.open(last, flags, dir_fd=folder), "rb") as file:
                _check_regular(file, self.path / name, largest, "smaller")
                return file.read(os.fstat(file.fileno()).st_size)

    def replace(self, name: str | os.PathLike[str], content: bytes) -> None:
        """Replace a file atomically; create folders, and replace a link with this name."""
        with self._parent(name, make=True) as (folder, last):
            part = f"{last}.part"
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
            try:
                with suppress(FileNotFoundError):
                    os.unlink(part, dir_fd=folder)
                with open(os.open(part, flags, 0o666, dir_fd=folder), "wb") as file:
                    file.write(content)
                os.replace(part, last, src_dir_fd=folder, dst_dir_fd=folder)
            finally:
                with suppress(OSError):
                    os.unlink(part, dir_fd=folder)

    def check(self, largest: int) -> None:
        """Raise a `FileError` that names a link, a pipe, a device or a file that is too large."""
        for place, folders, names, handle in os.fwalk(".", dir_fd=self.handle):
            for name in (*folders, *names):
                found = os.lstat(name, dir_fd=handle)
                regular, inside = stat.S_ISREG(found.st_mode), Path(place) / name
                if not regular and not stat.S_ISDIR(found.st_mode):
                    what = "a link" if stat.S_ISLNK(found.st_mode) else "no file"
                    raise FileError(f"{self.path}: {inside} is {what}, must be a file or a folder")
                if regular and found.st_size > largest:
                    raise FileError(f"{self.path}: {inside} has more than {largest // 2**20} MB")

    @contextmanager
    def _parent(
        self, name: str | os.PathLike[str], *, make: bool = False
    ) -> Iterator[tuple[int, str]]:
        """Open the folder of a file, one path component after another."""
        *parts, last = Path(name).parts
        if Path(name).is_absolute() or ".." in (*parts, last):
            raise FileError(f"{self.path}: {name} is not below it")
        folder = os.dup(self.handle)
        try:
            for part in parts:
                if make:
                    with suppress(FileExistsError):
                        os.mkdir(part, dir_fd=folder)
                flags = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
                inner = os.open(part, flags, dir_fd=folder)
                os.close(folder)
                folder = inner
            yield folder, last
        finally:
            os.close(folder)


def check_target(target: Path) -> None:
    """Refuse a device, a pipe and a link to one: a file would replace it."""
    try:
        mode = target.stat().st_mode
    except (OSError, ValueError) as error:
        if getattr(error, "errno", None) in (errno.ENOENT, errno.ELOOP):
            return
        why = getattr(error, "strerror", None) or error
        raise FileError(f"{target}: cannot be written ({why})") from None
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise FileError(f"{target}: cannot be written (not a regular file)")


@contextmanager
def whole_file(path: str | os.PathLike[str], mode: str = "w") -> Iterator[IO[str]]:
    """Open the new file ``path``.part; it is renamed to ``path`` when writing is complete.

    A link with either name is replaced and never followed. A device or a pipe is refused, because
    the file would replace it.
    """
    target = Path(FilePath("path").check(path))
    if not target.name:
        raise FileError(f"path = {str(target)!r}: is not a path of a file")
    check_target(target)
    part = target.with_name(target.name + ".part")
    # The name of a scene file keeps its bytes in a table.
    encoding, errors = (None, None) if "b" in mode else ("utf-8", "surrogateescape")
    with _WRITING.setdefault(target.absolute(), threading.RLock()):
        try:
            with suppress(FileNotFoundError):
                part.unlink()
            with open(part, mode.replace("w", "x"), encoding=encoding, errors=errors) as file:
                yield file
            os.replace(part, target)
        except OSError as error:
            if isinstance(error, FileError):
                raise
            raise FileError(f"{target}: cannot be written ({error.strerror})") from None
        finally:
            with suppress(OSError):
                part.unlink()
