"""Processes of their own, and what they spend whatever else this machine does."""

import os
import resource
import signal
from pathlib import Path


def end_by_interrupt(child):
    """Send Ctrl-C and wait; return the seconds of processor time spent since, and what was said."""
    others = _of_children()
    before = _of(child.pid)
    child.send_signal(signal.SIGINT)
    _, said = child.communicate(timeout=60)
    return _of_children() - others - before, said


def _of(pid):
    """Time of a process that runs (proc(5), utime and stime)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _of_children():
    """Time of children that have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime
