"""Holding a store for writing: one process at a time, within its folder only."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from stcal import atomic
from stcal.errors import InputError
from stcal.telemetry.store_marker import MARKER

LOCK = ".lock"


@contextmanager
def held(root: Path) -> Iterator[None]:
    """Hold the store for writing, and clear what a killed writer left.

    Raises
    ------
    InputError
        Another process holds it (the message has its number), or it cannot be written.
    """
    with _open_lock(root / LOCK) as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            stream.seek(0)
            owner = stream.read().strip() or "unknown"
            raise InputError(
                f"{root}: process {owner} is writing to this store; wait for its end"
            ) from None
        stream.truncate(0)
        stream.write(str(os.getpid()))
        stream.flush()
        _clear(root)
        try:
            yield
            check_there(root)
        finally:
            stream.truncate(0)


def check_there(root: Path) -> None:
    """Refuse to go on with a store that was moved or removed: its files would be strays.

    Raises
    ------
    InputError
    """
    if not (root / MARKER).exists():
        raise InputError(f"{root}: the store was moved or removed while it was written")


def _open_lock(path: Path) -> TextIO:
    try:
        # Not through a link: what it points to would be emptied.
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        return os.fdopen(handle, "r+")
    except OSError as error:
        raise InputError(
            f"{path}: the store cannot be locked for writing: {error.strerror}"
        ) from None


def _clear(root: Path) -> None:
    """Remove what a killed writer left; refuse links, which lead writers out of the store."""
    for folder, folders, names in os.walk(root):
        links = [name for name in folders if os.path.islink(os.path.join(folder, name))]
        if links:
            raise InputError(
                f"{Path(folder) / links[0]}: a symbolic link to a folder; a store is written "
                "only within its own folder"
            )
        for name in names:
            if name.startswith(atomic.TEMPORARY_PREFIX):
                Path(folder, name).unlink(missing_ok=True)
