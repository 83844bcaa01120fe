"""Files that are there whole or not at all."""

import errno
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
_WRITING: dict[Path, threading.RLock] = {}


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


def place_of(target: Path) -> Path:
    """Return where a file is put: a link leads on to what it names, which need not be there.

    What is there and no file or folder is refused: it would be replaced.
    """
    try:
        place = target.resolve() if target.is_symlink() else target
        mode = place.lstat().st_mode
    except FileNotFoundError:
        return place
    except (OSError, RuntimeError, ValueError) as error:
        # Links in a circle among them.
        why = getattr(error, "strerror", None) or error
        raise FileError(f"{target}: cannot be written ({why})") from None
    if stat.S_ISLNK(mode):
        raise FileError(f"{target}: cannot be written ({os.strerror(errno.ELOOP)})")
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise FileError(f"{target}: cannot be written (not a regular file)")
    return place


@contextmanager
def whole_file(path: str | os.PathLike[str], mode: str = "w") -> Iterator[IO[str]]:
    """Open a file beside ``path`` and put it in its place only when all is written.

    A link is followed, and stays. What stands beside the file is removed first, and not followed if
    it is a link. A device or a pipe is refused: a file would take its place.
    """
    target = Path(FilePath("path").check(path))
    if not target.name:
        raise FileError(f"path = {str(target)!r}: is not a path of a file")
    place = place_of(target)
    part = place.with_name(place.name + ".part")
    encoding = None if "b" in mode else "utf-8"
    with _WRITING.setdefault(place.absolute(), threading.RLock()):
        try:
            with suppress(FileNotFoundError):
                part.unlink()
            with open(part, mode.replace("w", "x"), encoding=encoding) as file:
                yield file
            os.replace(part, place)
        except OSError as error:
            if isinstance(error, FileError):
                raise
            raise FileError(f"{target}: cannot be written ({error.strerror})") from None
        finally:
            with suppress(OSError):
                part.unlink()
