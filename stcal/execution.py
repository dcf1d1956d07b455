"""Ordered map over fragments: the same function and the same answer whatever the scheduler.

What is mapped must not depend on where or how often it runs: a worker may die, and its items then
go to another.  Results are yielded in the order of the items, and only a few items run ahead of
the one that is waited for, so memory doesn't grow with their number.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager
from itertools import islice
from threading import Thread
from typing import Any, Protocol, TypeVar

from stcal.errors import InputError, UsageError, WorkerError

T = TypeVar("T")
U = TypeVar("U")

# Items that may run ahead of the one waited for, by worker.
_AHEAD = 3
# A task on a cluster costs milliseconds by itself: small items are batched to about this time.
_TASK_S = 1.0
_LARGEST_BATCH = 256
_RETRIES = 3
_CONNECT_S = 15


class OrderedMap(Protocol):
    """Apply a function to items; results come in the order of the items."""

    def __call__(self, function: Callable[[T], U], items: Iterable[T]) -> Iterator[U]:
        """Return the results, in order."""


def serial(function: Callable[[T], U], items: Iterable[T]) -> Iterator[U]:
    """Map one item after the other in this thread."""
    return map(function, items)


@contextmanager
def scheduler(
    workers: int, name: str = "threads", largest_batch: int = _LARGEST_BATCH
) -> Iterator[OrderedMap]:
    """Give an ordered map: a name in SCHEDULERS, or the address of a Dask scheduler.

    A cluster is handed items in batches of at most ``largest_batch``: 1 where an item may take
    far longer than those before it.

    Raises
    ------
    UsageError
        There is no such scheduler, or Dask isn't installed.
    InputError
        No scheduler answers at the address.
    WorkerError
        While mapping: a worker process died, or the cluster gave an item up.
    """
    if name not in SCHEDULERS and "://" not in name:
        known = ", ".join(SCHEDULERS)
        raise UsageError(f"no scheduler {name!r}; known: {known}, or an address such as tcp://…")
    make = SCHEDULERS.get(name)
    opened = _dask(name, largest_batch) if make is None else make(workers)
    with opened as mapper:
        yield mapper


@contextmanager
def _serial(workers: int) -> Iterator[OrderedMap]:
    yield serial


@contextmanager
def _threads(workers: int) -> Iterator[OrderedMap]:
    """Kernels and numpy's large operations release the interpreter's lock; nothing is copied."""
    if workers <= 1:
        yield serial
        return
    with ThreadPoolExecutor(workers) as pool:
        yield _over(pool, workers)


@contextmanager
def _processes(workers: int) -> Iterator[OrderedMap]:
    """Each worker is a fresh process: a forked one would inherit the locks of our threads."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, initializer=_follow_parent) as pool:
        yield _over(pool, workers)


def _follow_parent() -> None:
    """Let a worker end with the command, even one that is killed, and with nothing else.

    The terminal sends Ctrl-C to all processes; the command ends the others.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_after_parent, daemon=True).start()


def _end_after_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _over(pool: Executor, workers: int) -> OrderedMap:
    def mapped(function: Callable[[T], U], items: Iterable[T]) -> Iterator[U]:
        pending: deque[Any] = deque()
        try:
            for item in items:
                pending.append(pool.submit(function, item))
                if len(pending) > _AHEAD * workers:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        except BrokenProcessPool:
            raise WorkerError("a worker process died: killed, or out of memory") from None
        finally:
            for future in pending:
                future.cancel()

    return mapped


@contextmanager
def _dask(address: str, largest_batch: int) -> Iterator[OrderedMap]:
    try:
        from distributed import Client
    except ImportError:
        raise UsageError(
            f"scheduler {address}: Dask is not installed; install stcal-startracker[dask]"
        ) from None
    try:
        client: Any = Client(  # type: ignore[no-untyped-call]
            address, timeout=_CONNECT_S, set_as_default=False
        )
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(f"scheduler {address}: no answer: {error}") from None
    with client:
        yield _on_cluster(client, largest_batch)


def _on_cluster(client: Any, largest_batch: int) -> OrderedMap:
    """Map over a cluster's workers; items are batched by the time that those before them took."""

    def mapped(function: Callable[[T], U], items: Iterable[T]) -> Iterator[U]:
        rest, size = iter(items), 1
        pending: deque[Any] = deque()
        while True:
            ahead = _AHEAD * max(1, len(client.nthreads()))
            while len(pending) < ahead and (batch := list(islice(rest, size))):
                pending.append(client.submit(_timed, function, batch, pure=False, retries=_RETRIES))
            if not pending:
                return
            seconds, results = _gathered(pending.popleft())
            size = max(1, min(largest_batch, round(_TASK_S * len(results) / max(seconds, 1e-3))))
            yield from results

    return mapped


def _timed(function: Callable[[T], U], batch: list[T]) -> tuple[float, list[U]]:
    start = time.perf_counter()
    results = [function(item) for item in batch]
    return time.perf_counter() - start, results


def _gathered(future: Any) -> Any:
    from distributed import KilledWorker
    from distributed.client import FutureCancelledError

    try:
        return future.result()
    except (KilledWorker, FutureCancelledError) as error:
        raise WorkerError(f"the cluster gave up on a task: {error}") from None


SCHEDULERS: dict[str, Callable[[int], AbstractContextManager[OrderedMap]]] = {
    "serial": _serial,
    "threads": _threads,
    "processes": _processes,
}
