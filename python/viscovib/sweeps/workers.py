"""Workers for the pieces of a sweep: threads of this process, or those of a Dask cluster."""

import math
import threading
import time
import warnings
from dataclasses import replace
from queue import SimpleQueue
from typing import Any, Protocol

import numpy as np

from viscovib import _native
from viscovib.common.cluster import Cluster, Lost
from viscovib.sweeps.points import Array, Computed, Task, Template, compute, quiet, timed


class Workers(Protocol):
    """Accepts pieces and returns them in the order in which they finish."""

    #: Number of pieces that are computed or wait at a time.
    capacity: int

    def submit(self, i: int, columns: dict[str, Array], template: Template | None) -> None:
        """Accept the i-th piece."""

    def next(self) -> tuple[int, Computed]:
        """Wait for a finished piece."""

    def trial(self, columns: dict[str, Array], most: float) -> Computed:
        """Compute a single point and measure its time; it may be repeated if shorter than most."""

    def close(self) -> None:
        """Abandon the present pieces without waiting for them."""


class Threads:
    """Threads of this process; the core computes without the Python lock (GIL).

    They are daemons: neither Ctrl-C nor the end of the program waits for an unfinished point.
    """

    def __init__(self, task: Task, n: int) -> None:
        self.capacity = 2 * n
        self._task = task
        self._work: SimpleQueue[tuple[int, dict[str, Array], Template | None] | None] = (
            SimpleQueue()
        )
        self._done: SimpleQueue[tuple[int, Computed | BaseException]] = SimpleQueue()
        self._stop = threading.Event()
        self._flag = np.zeros(1, dtype=np.intc)
        self._threads = [threading.Thread(target=self._loop, daemon=True) for _ in range(n)]
        for thread in self._threads:
            thread.start()

    def submit(self, i: int, columns: dict[str, Array], template: Template | None) -> None:
        """Accept the i-th piece."""
        self._work.put((i, columns, template))

    def next(self) -> tuple[int, Computed]:
        """Wait for a finished piece."""
        i, done = self._done.get()
        if isinstance(done, BaseException):
            raise done
        return i, done

    def trial(self, columns: dict[str, Array], most: float) -> Computed:
        """Compute a single point and measure its time."""
        begun = time.perf_counter()
        self.submit(0, columns, None)
        _, part = self.next()
        return replace(part, seconds=time.perf_counter() - begun)

    def close(self) -> None:
        """Stop the threads: native loops end early and their results are discarded."""
        self._stop.set()
        self._flag[0] = 1
        for _ in self._threads:
            self._work.put(None)

    def _loop(self) -> None:
        _native.listen(self._flag)
        while (work := self._work.get()) is not None and not self._stop.is_set():
            i, columns, template = work
            try:
                part = compute(self._task, columns, template, self._stop.is_set, True)
                self._done.put((i, part))
            except BaseException as error:
                self._done.put((i, error))


class DaskWorkers:
    """Workers of a Dask cluster (`Cluster`)."""

    def __init__(self, task: Task, client: Any, retries: int) -> None:
        self._cluster = Cluster(_Piece(task), client, retries)
        self.capacity = max(2 * self._cluster.threads, 8)
        self._sizes: dict[int, int] = {}

    def submit(self, i: int, columns: dict[str, Array], template: Template | None) -> None:
        """Accept the i-th piece."""
        self._sizes[i] = next(iter(columns.values())).size
        self._cluster.submit(i, columns, template, math.nan)

    def next(self) -> tuple[int, Computed]:
        """Wait for a finished piece."""
        i, part = self._cluster.next()
        if isinstance(part, Lost):
            return i, Computed.none(self._sizes[i], part.why)
        assert isinstance(part, Computed)
        return i, part

    def trial(self, columns: dict[str, Array], most: float) -> Computed:
        """Compute a single point, and measure its time without that of the connection."""
        self._sizes[0] = 1
        self._cluster.submit(0, columns, None, most)
        return self.next()[1]

    def close(self) -> None:
        """Abandon the present pieces."""
        self._cluster.close()


class _Piece:
    """The computation of a piece in a worker; ``most`` is NaN, or a limit for `timed`."""

    def __init__(self, task: Task) -> None:
        self._task = task

    def __call__(
        self, columns: dict[str, Array], template: Template | None, most: float
    ) -> Computed:
        with warnings.catch_warnings():
            quiet()
            if not math.isnan(most):
                return timed(self._task, columns, most)
            return compute(self._task, columns, template)
