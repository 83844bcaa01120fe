"""Pieces of work on the workers of a Dask cluster."""

import math
import pickle
import time
import uuid
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from queue import Empty, SimpleQueue
from typing import Any

from viscovib import _native
from viscovib.errors import InputError, ViscovibError

#: Largest number of repetitions of a finished piece whose result was lost with its worker.
_MADE_AGAIN = 8
#: Time between checks of a silent cluster, and longest time without workers (s).
_LOOK, _ALONE = 1.0, 180.0
#: Functions that a worker of Dask has received, as bytes.
_sent: dict[str, bytes] = {}


@dataclass(frozen=True)
class Lost:
    """A piece that was not computed, with the reason."""

    why: str


@dataclass
class _Piece:
    i: int
    given: tuple[Any, ...]
    tries: int = 0
    future: Any = None


class Cluster:
    """A function on the workers of a Dask cluster, which returns pieces as they finish.

    The function is sent once to each worker, by a plugin, and to each worker that starts later.
    If a worker dies, Dask moves its piece to another worker, a few times. A piece that Dask then
    abandons is tried again alone, ``retries`` times.
    """

    def __init__(self, function: Callable[..., Any], client: Any, retries: int) -> None:
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
        self._name = uuid.uuid4().hex
        client.register_plugin(_carrier(self._name, _pickled(function)), self._name)
        #: Number of threads of the workers; at least 1.
        self.threads = max(1, sum(client.nthreads().values()))
        self._done: SimpleQueue[Any] = SimpleQueue()
        #: Last time at which workers were present; infinite before the first.
        self._last_seen = time.monotonic() if client.nthreads() else math.inf
        #: Pieces whose worker died: they are tried again alone, because one may kill workers again.
        self._suspects: list[_Piece] = []
        self._made_again: Counter[int] = Counter()
        self._pieces: dict[str, _Piece] = {}

    def submit(self, i: int, *given: Any) -> None:
        """Accept the i-th piece: the arguments of the function."""
        self._submit(_Piece(i, given))

    def _submit(self, piece: _Piece) -> None:
        try:
            piece.future = self._client.submit(_remote, self._name, *piece.given, pure=False)
        except Exception as error:
            raise ViscovibError(f"client: {type(error).__name__}: {error}") from error
        self._pieces[piece.future.key] = piece
        piece.future.add_done_callback(self._done.put)

    def next(self) -> tuple[int, Any]:
        """Wait for a finished piece: its number, and its value or `Lost`.

        An exception of the function is raised.
        """
        while True:
            if not self._pieces and self._suspects:
                self._submit(self._suspects.pop())
            future = self._awaited()
            piece = self._pieces.pop(future.key)
            why: BaseException | None = None
            if future.status == "finished":
                try:
                    value, failure = future.result()
                except Exception as error:
                    why = error
                else:
                    if failure is not None:
                        raise failure
                    return piece.i, value
            elif future.status == "error":
                why = future.exception()
            if isinstance(why, _LoadError):
                raise InputError(f"client: its workers cannot load the function ({why})") from None
            reason = type(why).__name__ if why is not None else future.status
            if self._client.status != "running":
                raise ViscovibError(f"client: is {self._client.status}, its cluster was lost")
            if why is not None and type(why).__name__ != "KilledWorker":
                # The piece killed no worker: its result was lost with a worker that died later.
                self._made_again[piece.i] += 1
                if self._made_again[piece.i] <= _MADE_AGAIN:
                    self._suspects.append(piece)
                    continue
            piece.tries += 1
            if piece.tries > self._retries:
                lost = f"the worker was lost at each of {piece.tries} attempts ({reason})"
                return piece.i, Lost(lost)
            self._suspects.append(piece)

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
        for piece in self._pieces.values():
            piece.future.release()
        if self._client.status == "running":
            self._client.unregister_worker_plugin(self._name)


class _LoadError(Exception):
    """A worker cannot load the function."""


def _pickled(function: Callable[..., Any]) -> bytes:
    """Return the function as bytes, so that it is serialized only once.

    If Dask serialized a function that a worker cannot import, the connection of the worker, and
    with it the whole computation, would stop without a message.
    """
    import cloudpickle

    try:
        data: bytes = cloudpickle.dumps(function)
    except Exception as error:
        raise InputError(f"client: the function cannot be sent to its workers ({error})") from None
    return data


@lru_cache(maxsize=4)
def _loaded(name: str) -> Callable[..., Any]:
    try:
        function: Callable[..., Any] = pickle.loads(_sent[name])
    except Exception as error:
        raise _LoadError(f"{type(error).__name__}: {error}") from None
    return function


def _carrier(name: str, data: bytes) -> Any:
    """Plugin of Dask that gives a function to each worker."""
    from distributed import WorkerPlugin

    class Carrier(WorkerPlugin):
        def setup(self, worker: Any) -> None:
            # Dask sends this class by value, so the module of the worker must be named.
            import viscovib.common.cluster as here

            here._sent[name] = data

        def teardown(self, worker: Any) -> None:
            import viscovib.common.cluster as here

            here._sent.pop(name, None)

    return Carrier()


def _remote(name: str, *given: Any) -> tuple[Any, ViscovibError | None]:
    """Return the value of the function, or the error that ends the computation."""
    function = _loaded(name)
    try:
        return function(*given), None
    except ViscovibError as error:
        return None, error
