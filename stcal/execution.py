"""Ordered map over fragments: the same function and the same answer whatever the scheduler."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Protocol, TypeVar

T = TypeVar("T")
U = TypeVar("U")


class OrderedMap(Protocol):
    """Apply a function to items; results come in the order of the items."""

    def __call__(self, function: Callable[[T], U], items: Iterable[T]) -> Iterator[U]:
        """Return the results, in order."""


def serial(function: Callable[[T], U], items: Iterable[T]) -> Iterator[U]:
    """Map one item after the other in this thread."""
    return map(function, items)


@contextmanager
def scheduler(workers: int) -> Iterator[OrderedMap]:
    """Give an ordered map over ``workers`` threads; one worker is the serial map.

    Threads suffice: the kernels and numpy's large operations release the interpreter's lock.
    """
    if workers <= 1:
        yield serial
        return
    with ThreadPoolExecutor(workers) as pool:

        def threaded(function: Callable[[T], U], items: Iterable[T]) -> Iterator[U]:
            return pool.map(function, items)

        yield threaded
