"""Where the arrays of each fragment wait between passes: in memory, or in files.

A pass reads a fragment, leaves there what later passes need of it, and returns only sums; so the
memory of a fit doesn't grow with the telemetry.  Files are read by whichever process has the
fragment next, so on a cluster their folder must be one that all workers see.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from stcal.atomic import named

T = TypeVar("T")
Arrays = tuple[NDArray[Any], ...]

_PREFIX, _LOCK = ".scratch-", "lock"


class Scratch(Protocol):
    """Arrays by name and fragment number."""

    def put(self, name: str, number: int, *arrays: NDArray[Any]) -> None:
        """Keep arrays; the same name and number again replaces them."""

    def get(self, name: str, number: int) -> Arrays:
        """Return kept arrays, as they were put."""

    def drop(self, name: str) -> None:
        """Forget the arrays of all fragments under a name."""

    def cached(self, name: str, number: int, make: Callable[[], T]) -> T:
        """Return what ``make`` gives, perhaps kept from before."""


@dataclass
class MemoryScratch:
    """For telemetry that is in memory anyway; not for worker processes."""

    kept: dict[tuple[str, int], Any] = field(default_factory=dict)

    def put(self, name: str, number: int, *arrays: NDArray[Any]) -> None:
        """Keep arrays."""
        self.kept[name, number] = arrays

    def get(self, name: str, number: int) -> Arrays:
        """Return kept arrays."""
        found: Arrays = self.kept[name, number]
        return found

    def drop(self, name: str) -> None:
        """Forget the arrays of all fragments under a name."""
        for key in [key for key in self.kept if key[0] == name]:
            del self.kept[key]

    def cached(self, name: str, number: int, make: Callable[[], T]) -> T:
        """Return what ``make`` gave the first time."""
        if (name, number) not in self.kept:
            self.kept[name, number] = make()
        found: T = self.kept[name, number]
        return found


@dataclass(frozen=True)
class FolderScratch:
    """In files of a folder, whole or not at all: a worker may die while it writes one."""

    folder: Path

    def put(self, name: str, number: int, *arrays: NDArray[Any]) -> None:
        """Keep arrays."""
        target = self._path(name, number)
        with named(target):
            target.parent.mkdir(exist_ok=True)
            handle, temporary = tempfile.mkstemp(dir=target.parent)
            with os.fdopen(handle, "wb") as stream:
                for array in arrays:
                    np.save(stream, array, allow_pickle=False)
            Path(temporary).replace(target)

    def get(self, name: str, number: int) -> Arrays:
        """Return kept arrays."""
        found = []
        with self._path(name, number).open("rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            while stream.tell() < size:
                found.append(np.load(stream, allow_pickle=False))
        return tuple(found)

    def drop(self, name: str) -> None:
        """Forget the arrays of all fragments under a name."""
        shutil.rmtree(self.folder / name, ignore_errors=True)

    def cached(self, name: str, number: int, make: Callable[[], T]) -> T:
        """Return what ``make`` gives: it costs less than a file of its size."""
        return make()

    def _path(self, name: str, number: int) -> Path:
        return self.folder / name / f"{number}.npy"


@contextmanager
def scratch_folder(beside: Path) -> Iterator[FolderScratch]:
    """Give a scratch in a folder of its own below ``beside``, and remove it at the end.

    What killed runs left there is removed first; a living run holds the lock in its folder.
    """
    for left in beside.glob(f"{_PREFIX}*"):
        with suppress(OSError), (left / _LOCK).open("a") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(left, ignore_errors=True)
    folder = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=beside))
    with (folder / _LOCK).open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            yield FolderScratch(folder)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
