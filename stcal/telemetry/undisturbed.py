"""Reading a store that others may write to: all of what an ingest brings, or an error.

Readers hold no lock, so that a long fit doesn't keep downlinks out.  The files are found while
nobody writes, and each bears a stamp by which a later look sees that it was replaced.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager

from stcal.errors import InputError
from stcal.telemetry.places import Place, Remote

# Size in bytes, and time of the last change or hash: a rewritten file has others.
Stamp = tuple[int, str]


@contextmanager
def undisturbed(store: Place, lock: str) -> Iterator[None]:
    """Find files of a store; its file ``lock`` holds the number of the process that writes to it.

    At a URL nobody writes, and a copy's stamps tell whether it is replaced.

    Raises
    ------
    InputError
        Naming the store: another process is writing to it, or was meanwhile.
    """
    before = _last_writing(store, lock)
    yield
    if _last_writing(store, lock) != before:
        raise InputError(f"{store}: the store changed while it was read; run again")


def _last_writing(store: Place, lock: str) -> int:
    """Return when a process last took or left the lock; 0 when none ever did."""
    if isinstance(store, Remote):
        return 0
    try:
        handle = os.open(store / lock, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:  # none, or of a store that only its owner may write to
        return 0
    try:
        owner = os.read(handle, 20).decode("ascii", "replace").strip()
        # A killed writer leaves its number, but not its hold.
        if owner not in ("", str(os.getpid())) and _is_held(handle):
            raise InputError(f"{store}: process {owner} is writing to this store; wait for its end")
        return os.fstat(handle).st_mtime_ns
    finally:
        os.close(handle)


def _is_held(handle: int) -> bool:
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    return False


def stamp_of(path: Place) -> Stamp:
    """Return a file's stamp.

    Raises
    ------
    InputError
        Naming the file: it cannot be read.
    """
    if isinstance(path, Remote):
        return path.version()
    try:
        status = path.stat()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    return status.st_size, str(status.st_mtime_ns)


@contextmanager
def unchanged(path: Place, stamp: Stamp) -> Iterator[None]:
    """Read a file that must still be the one of this stamp; it is only ever replaced as a whole.

    Raises
    ------
    InputError
        Naming the file: it is another one, or has become another meanwhile.
    """
    _check(path, stamp)
    yield
    _check(path, stamp)


def _check(path: Place, stamp: Stamp) -> None:
    if stamp_of(path) != stamp:
        raise InputError(f"{path}: the store changed while it was read; run again")
