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

#: Fraction of the memory of the machine that a command may use. With more the system would swap
#: for hours or kill a program.
_SHARE = 0.75
#: Bytes that a command needs in addition to Python.
_CAPACITY = 1 << 26


class StoppedError(Exception):
    """A bound was reached."""


def limit_memory(gigabytes: float | None) -> float:
    """Set a bound of memory; by default three quarters of the memory of the machine.

    Return the bound (GB). Requests beyond it fail.
    """
    import resource

    if gigabytes is None:
        bound = _SHARE * os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    else:
        bound = 1e9 * _positive("--max-memory", gigabytes)
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    most = min([int(bound), *(n for n in (soft, hard) if n != resource.RLIM_INFINITY)])
    # Without memory for a thread its start would fail or block.
    if most < _used() + _CAPACITY:
        raise StoppedError(f"more than {most / 1e9:.3g} GB of memory are needed (--max-memory)")
    resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
    return most / 1e9


def _used() -> int:
    """Bytes of data of this process; 0 if unknown."""
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
    """Raise `StoppedError` inside the context after this number of seconds.

    ``partial``: native loops first get a request to end with partial results, and a quarter of the
    time (at least three seconds) to do so.
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
