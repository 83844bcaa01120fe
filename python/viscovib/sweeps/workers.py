"""Workers for the pieces of a sweep: threads of this process, or those of a Dask cluster."""

import math
import pickle
import threading
import time
import uuid
import warnings
from collections import Counter
from dataclasses import replace
from functools import lru_cache
from queue import Empty, SimpleQueue
from typing import Any, Protocol

import numpy as np

from viscovib import _native
from viscovib.errors import InputError, ViscovibError
from viscovib.sweeps.points import Array, Computed, Task, Template, compute, quiet, timed

#: Largest number of repetitions of a finished piece whose result was lost with its worker.
_MADE_AGAIN = 8
#: Time between checks of a silent cluster, and longest time without workers (s).
_LOOK, _ALONE = 1.0, 180.0
#: Functions that a worker of Dask has received, as bytes.
_sent: dict[str, bytes] = {}


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
    """Workers of a Dask cluster.

    The function is sent once to each worker, by a plugin, and to each worker that starts later.
    If a worker dies, Dask moves its piece to another worker, a few times. A piece that Dask then
    abandons is tried again alone.
    """

    def __init__(self, task: Task, client: Any, retries: int) -> None:
        for name in ("submit", "nthreads", "scheduler_info"):
            if not hasattr(client, name):
                raise InputError(
                    f"client = {_native.shown(client)}: must be a dask.distributed.Client"
                )
        if getattr(client, "asynchronous", False):
            raise InputError("client: is asynchronous, must be an ordinary one")
        if client.status != "running":
            raise InputError(f"client: is {client.status}, must be running")
        self._client, self._retries = client, retries
        #: The longest first trial that is repeated; NaN: the piece is no trial.
        self._most = math.nan
        self._task = uuid.uuid4().hex
        client.register_plugin(_carrier(self._task, _pickled(task)), self._task)
        self.capacity = max(2 * sum(client.nthreads().values()), 8)
        self._done: SimpleQueue[Any] = SimpleQueue()
        #: Last time at which workers were present; infinite before the first.
        self._last_seen = time.monotonic() if client.nthreads() else math.inf
        #: Pieces whose worker died: they are tried again alone, because one may kill workers again.
        self._suspects: list[tuple[int, dict[str, Array], Template | None, int]] = []
        self._made_again: Counter[int] = Counter()
        self._pieces: dict[str, tuple[int, dict[str, Array], Template | None, int, Any]] = {}

    def submit(self, i: int, columns: dict[str, Array], template: Template | None) -> None:
        """Accept the i-th piece."""
        self._submit(i, columns, template, 0)

    def _submit(
        self, i: int, columns: dict[str, Array], template: Template | None, tries: int
    ) -> None:
        try:
            future = self._client.submit(
                _remote, self._task, columns, template, self._most, pure=False
            )
        except Exception as error:
            raise ViscovibError(f"client: {type(error).__name__}: {error}") from error
        self._pieces[future.key] = (i, columns, template, tries, future)
        future.add_done_callback(self._done.put)

    def trial(self, columns: dict[str, Array], most: float) -> Computed:
        """Compute a single point, and measure its time without that of the connection."""
        self._most = most
        self.submit(0, columns, None)
        _, part = self.next()
        self._most = math.nan
        return part

    def next(self) -> tuple[int, Computed]:
        """Wait for a finished piece."""
        while True:
            if not self._pieces and self._suspects:
                self._submit(*self._suspects.pop())
            future = self._awaited()
            i, columns, template, tries, _ = self._pieces.pop(future.key)
            why: BaseException | None = None
            if future.status == "finished":
                try:
                    part: Computed = future.result()
                    return i, part
                except Exception as error:
                    why = error
            elif future.status == "error":
                why = future.exception()
            if isinstance(why, _LoadError):
                raise InputError(f"client: its workers cannot load the function ({why})") from None
            reason = type(why).__name__ if why is not None else future.status
            if self._client.status != "running":
                raise ViscovibError(f"client: is {self._client.status}, its cluster was lost")
            if why is not None and type(why).__name__ != "KilledWorker":
                # The piece killed no worker: its result was lost with a worker that died later.
                self._made_again[i] += 1
                if self._made_again[i] <= _MADE_AGAIN:
                    self._suspects.append((i, columns, template, tries))
                    continue
            if tries >= self._retries:
                n = next(iter(columns.values())).size
                lost = f"the worker was lost at each of {tries + 1} attempts ({reason})"
                return i, Computed.none(n, lost)
            self._suspects.append((i, columns, template, tries + 1))

    def _awaited(self) -> Any:
        """Wait for a piece to end; raise if all workers died and none replaces them."""
        while True:
            try:
                return self._done.get(timeout=_LOOK)
            except Empty:
                now = time.monotonic()
                # The first workers, for example of a queue, may take any time to start.
                if self._client.nthreads():
                    self._last_seen = now
                elif now - self._last_seen > _ALONE:
                    raise ViscovibError(
                        f"client: all its workers are gone, and for {_ALONE:g} s none came instead"
                    ) from None

    def close(self) -> None:
        """Abandon the present pieces."""
        for *_, future in self._pieces.values():
            future.release()
        if self._client.status == "running":
            self._client.unregister_worker_plugin(self._task)


class _LoadError(Exception):
    """A worker cannot load the function."""


def _pickled(task: Task) -> bytes:
    """Return the task as bytes, so that it is serialized only once.

    If Dask serialized a function that a worker cannot import, the connection of the worker, and
    with it the whole computation, would stop without a message.
    """
    import cloudpickle

    try:
        data: bytes = cloudpickle.dumps(task)
    except Exception as error:
        raise InputError(f"client: the function cannot be sent to its workers ({error})") from None
    return data


@lru_cache(maxsize=4)
def _loaded(data: bytes) -> Task:
    try:
        task: Task = pickle.loads(data)
    except Exception as error:
        raise _LoadError(f"{type(error).__name__}: {error}") from None
    return task


def _carrier(name: str, data: bytes) -> Any:
    """Plugin of Dask that gives a function to each worker."""
    from distributed import WorkerPlugin

    class Carrier(WorkerPlugin):
        def setup(self, worker: Any) -> None:
            # Dask sends this class by value, so the module of the worker must be named.
            import viscovib.sweeps.workers as here

            here._sent[name] = data

        def teardown(self, worker: Any) -> None:
            import viscovib.sweeps.workers as here

            here._sent.pop(name, None)

    return Carrier()


def _remote(
    name: str, columns: dict[str, Array], template: Template | None, most: float
) -> Computed:
    task = _loaded(_sent[name])
    with warnings.catch_warnings():
        quiet()
        if not math.isnan(most):
            return timed(task, columns, most)
        return compute(task, columns, template)
