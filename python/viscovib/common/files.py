"""Files that are there whole or not at all."""

import os
import stat
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from viscovib.common.parameters import FilePath
from viscovib.errors import FileError

#: Threads that write one file do so one after the other, since they share what stands beside it.
_WRITING: dict[Path, threading.Lock] = {}


def bytes_of(path: str, largest: int, what: str) -> bytes:
    """Return all of a regular file: pipes, devices and what the system makes up have no end.

    ``largest``: bytes at most, of ``what`` the file must be.
    """
    try:
        # Not waiting for the other end of a pipe.
        with open(os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0)), "rb") as file:
            told = os.fstat(file.fileno())
            if stat.S_ISDIR(told.st_mode):
                raise FileError(f"{path}: cannot be read (Is a directory)")
            if told.st_size > largest:
                raise FileError(f"{path}: has more than {largest // 2**20} MB, must be {what}")
            regular = stat.S_ISREG(told.st_mode)
            content = file.read(told.st_size + 1) if regular else b""
            if not regular or (content and not told.st_size):
                raise FileError(f"{path}: cannot be read (not a regular file)")
    except (OSError, ValueError) as error:
        if isinstance(error, FileError):
            raise
        why = getattr(error, "strerror", None) or error
        raise FileError(f"{path}: cannot be read ({why})") from None
    return content


def check_place(target: Path) -> None:
    """Refuse what is there and no file, link or folder: it would be replaced."""
    try:
        mode = target.lstat().st_mode
    except (OSError, ValueError):
        return
    if not (stat.S_ISREG(mode) or stat.S_ISLNK(mode) or stat.S_ISDIR(mode)):
        raise FileError(f"{target}: cannot be written (not a regular file)")


@contextmanager
def whole_file(path: str | os.PathLike[str], mode: str = "w") -> Iterator[IO[str]]:
    """Open a file beside ``path`` and put it in its place only when all is written.

    What stands beside it is removed first, and not followed if it is a link. A device or a pipe is
    refused: a file would take its place.
    """
    target = Path(FilePath("path").check(path))
    if not target.name:
        raise FileError(f"path = {str(target)!r}: is not a path of a file")
    check_place(target)
    part = target.with_name(target.name + ".part")
    encoding = None if "b" in mode else "utf-8"
    with _WRITING.setdefault(target.absolute(), threading.Lock()):
        try:
            with suppress(FileNotFoundError):
                part.unlink()
            with open(part, mode.replace("w", "x"), encoding=encoding) as file:
                yield file
            os.replace(part, target)
        except OSError as error:
            raise FileError(f"{target}: cannot be written ({error.strerror})") from None
        finally:
            with suppress(OSError):
                part.unlink()
