"""Bounds on the time and memory of a command."""

import _thread
import os
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from viscovib._native import core
from viscovib.errors import InputError

#: Part of the machine's memory that a command may use: with more the system, which needs some
#: itself, pages for hours or kills this or another program.
_SHARE = 0.75
#: Bytes that a command needs besides what Python takes.
_ROOM = 1 << 26


class StoppedError(Exception):
    """A bound was reached."""


def limit_memory(gigabytes: float | None) -> float:
    """Let requests for more memory fail; by default for three quarters of the machine's.

    Returns the bound (GB).
    """
    import resource

    if gigabytes is None:
        bound = _SHARE * os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    else:
        bound = 1e9 * _positive("--max-memory", gigabytes)
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    most = min([int(bound), *(n for n in (soft, hard) if n != resource.RLIM_INFINITY)])
    # Without room for a thread its start would fail, or be waited for in vain.
    if most < _used() + _ROOM:
        raise StoppedError(f"more than {most / 1e9:.3g} GB of memory are needed (--max-memory)")
    resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
    return most / 1e9


def _used() -> int:
    """Bytes of data that this process has; 0 where the system does not tell."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[5]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return 0


def _positive(name: str, value: float) -> float:
    if not 0.01 <= value <= 1e8:
        raise InputError(f"{name} = {value:g}: must be 0.01 to 1e8")
    return value


@contextmanager
def limited_seconds(seconds: float | None, *, partial: bool) -> Iterator[None]:
    """Raise `StoppedError` inside once so many seconds have passed.

    ``partial``: native loops are first asked to end with what they have, and a quarter of the time
    (three seconds at least) is left for it.
    """
    if seconds is None:
        yield
        return
    bound = _positive("--max-seconds", seconds)
    grace = max(3.0, 0.25 * bound)
    over = threading.Event()

    def watch() -> None:
        if partial:
            if over.wait(bound):
                return
            core.stop_loops(1)
        if over.wait(grace if partial else bound):
            return
        _thread.interrupt_main()
        if not over.wait(grace):
            print(
                f"viscovib: stopped: the limit of {bound:g} s is reached (--max-seconds)",
                file=sys.stderr,
            )
            sys.stderr.flush()
            os._exit(1)

    watcher = threading.Thread(target=watch, daemon=True)
    started = time.monotonic()
    watcher.start()
    try:
        yield
    except KeyboardInterrupt:
        if time.monotonic() - started >= bound:
            raise StoppedError(f"the limit of {bound:g} s is reached (--max-seconds)") from None
        raise
    finally:
        over.set()
        core.stop_loops(0)
