"""Child processes, and their processor time, which does not depend on other processes."""

import os
import resource
import signal
from pathlib import Path


def end_by_interrupt(child):
    """Send Ctrl-C and wait; return the processor time used since then (s), and the output."""
    others = _of_children()
    before = _of(child.pid)
    child.send_signal(signal.SIGINT)
    _, said = child.communicate(timeout=60)
    return _of_children() - others - before, said


def _of(pid):
    """Processor time of a running process (proc(5), utime and stime)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _of_children():
    """Processor time of finished children."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime
