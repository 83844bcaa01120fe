"""Files that are there whole or not at all."""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from viscovib.common.parameters import FilePath
from viscovib.errors import FileError

#: Threads that write one file do so one after the other, since they share what stands beside it.
_WRITING: dict[Path, threading.Lock] = {}


@contextmanager
def whole_file(path: str | os.PathLike[str], mode: str = "w") -> Iterator[IO[str]]:
    """Open a file beside ``path`` and put it in its place only when all is written.

    What stands beside it is removed first, and not followed if it is a link.
    """
    target = Path(FilePath("path").check(path))
    if not target.name:
        raise FileError(f"path = {str(target)!r}: is no path of a file")
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
