"""Reading ahead: threads work on the next sources while the results of one are taken in.

Threads suffice: unpacking, parsing and sorting release the interpreter's lock.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from queue import SimpleQueue
from threading import Event, Semaphore
from typing import Generic, TypeVar

T = TypeVar("T")

# Results of one source that may wait to be taken in.
_WAITING = 3


@contextmanager
def ahead(
    sources: Sequence[Callable[[], Iterator[T]]], workers: int
) -> Iterator[Iterator[Iterator[T]]]:
    """Give the results of every source, in order; ``workers`` threads read, none for one worker.

    An error of a source is raised where its results are taken in.
    """
    if workers <= 1:
        yield (source() for source in sources)
        return
    stop = Event()
    with ThreadPoolExecutor(workers, "read-ahead") as pool:
        try:
            yield _in_order(sources, pool, workers, stop)
        finally:
            stop.set()


def _in_order(
    sources: Sequence[Callable[[], Iterator[T]]],
    pool: ThreadPoolExecutor,
    workers: int,
    stop: Event,
) -> Iterator[Iterator[T]]:
    """Yield the results of every source; one more is under way than there are workers."""
    started: deque[_Feed[T]] = deque()
    for source in sources:
        feed = _Feed(source, stop)
        pool.submit(feed.fill)
        started.append(feed)
        if len(started) > workers:
            yield started.popleft().results()
    while started:
        yield started.popleft().results()


class _Feed(Generic[T]):
    """The results of one source, on their way from the thread that makes them."""

    def __init__(self, source: Callable[[], Iterator[T]], stop: Event) -> None:
        self._source, self._stop = source, stop
        self._queue: SimpleQueue[tuple[T | None, BaseException | None, bool]] = SimpleQueue()
        self._room = Semaphore(_WAITING)

    def fill(self) -> None:
        """Make the results; wait while enough of them have not been taken in."""
        try:
            for result in self._source():
                while not self._room.acquire(timeout=0.1):
                    if self._stop.is_set():
                        return
                self._queue.put((result, None, False))
                if self._stop.is_set():
                    return
            self._queue.put((None, None, True))
        except BaseException as error:
            self._queue.put((None, error, True))

    def results(self) -> Iterator[T]:
        """Yield the results as they come."""
        while True:
            result, error, ended = self._queue.get()
            if error is not None:
                raise error
            if ended:
                return
            self._room.release()
            yield result  # type: ignore[misc]
