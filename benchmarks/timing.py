"""Timing: interleaved repeats, medians, pairwise ratios."""

import contextlib
import math
import platform
import statistics
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

PEERS = (
    "pyharm-os",
    "heyoka",
    "numba",
    "numbalsoda",
    "scikit-sundae",
    "OSCILATE",
    "idesolver",
    "pycaputo",
    "pyvisco",
)


def seconds(
    job: Callable[[], object],
    repeats: int = 9,
    shortest: float = 0.005,
    clock: Callable[[], float] = time.perf_counter,
) -> float:
    """Median time of one call; each sample is long enough for the clock."""
    job()
    start = clock()
    job()
    once = max(clock() - start, 1e-9)
    count = max(1, int(shortest / once))
    samples = []
    for _ in range(repeats):
        start = clock()
        for _ in range(count):
            job()
        samples.append((clock() - start) / count)
    return statistics.median(samples)


def least(job: Callable[[], object], repeats: int = 9, shortest: float = 0.02) -> float:
    """Least processor time of one call, for comparison with floors."""
    job()
    start = time.process_time()
    job()
    once = max(time.process_time() - start, 1e-9)
    count = max(1, int(shortest / once))
    best = math.inf
    for _ in range(repeats):
        start = time.process_time()
        for _ in range(count):
            job()
        best = min(best, (time.process_time() - start) / count)
    return best


def pair(
    ours: Callable[[], object],
    theirs: Callable[[], object],
    repeats: int = 7,
    clock: Callable[[], float] = time.perf_counter,
) -> tuple[float, float, float]:
    """Times of both and the median ratio theirs/ours, measured in turn.

    On a busy machine `time.process_time` compares two jobs of one thread.
    """
    mine, other = [], []
    for _ in range(repeats):
        mine.append(seconds(ours, repeats=1, clock=clock))
        other.append(seconds(theirs, repeats=1, shortest=0.0, clock=clock))
    ratios = [b / a for a, b in zip(mine, other, strict=True)]
    return statistics.median(mine), statistics.median(other), statistics.median(ratios)


def machine() -> str:
    """Processor and versions, for the head of a table."""
    import numpy
    import scipy
    import viscovib

    names = [
        line.split(":", 1)[1].strip()
        for line in Path("/proc/cpuinfo").read_text().splitlines()
        if line.startswith("model name")
    ]
    return (
        f"{names[0] if names else platform.processor()}, Python {platform.python_version()}, "
        f"viscovib {viscovib.__version__}, NumPy {numpy.__version__}, SciPy {scipy.__version__}"
    )


def versions() -> str:
    """Versions of the installed peers, and of the compiler."""
    from importlib.metadata import PackageNotFoundError, version

    found = []
    for name in PEERS:
        with contextlib.suppress(PackageNotFoundError):
            found.append(f"{name} {version(name)}")
    for command in (["dpkg-query", "-W", "auto-07p"], ["gfortran", "--version"]):
        with contextlib.suppress(OSError, subprocess.CalledProcessError):
            text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
            found.append(" ".join(text.splitlines()[0].split()))
    return ", ".join(found)


def show_time(value: float) -> str:
    """Format a time with a suitable unit."""
    for factor, unit in ((1e9, "ns"), (1e6, "us"), (1e3, "ms")):
        if value * factor < 1000:
            return f"{value * factor:.3g} {unit}"
    return f"{value:.3g} s"
