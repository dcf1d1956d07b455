"""Files appear whole or not at all: temporary file in the same folder, fsync, rename."""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

TEMPORARY_PREFIX = ".stcal-"


def write_with(path: Path, writer: Callable[[BinaryIO], None]) -> None:
    """Let ``writer`` fill a temporary file, then move it to ``path`` in one step.

    Raises
    ------
    OSError
        Naming ``path``, whatever it was that failed: a full disk's own error names nothing.
    """
    with named(path):
        _write_with(path, writer)


@contextmanager
def named(path: Path) -> Iterator[None]:
    """Let an error of the operating system name ``path``: a full disk's own names nothing."""
    try:
        yield
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, os.strerror(error.errno), str(path)) from error


def _write_with(path: Path, writer: Callable[[BinaryIO], None]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=TEMPORARY_PREFIX, dir=path.parent)
    temporary = Path(name)
    try:
        with os.fdopen(handle, "wb") as stream:
            writer(stream)
            stream.flush()
            os.fsync(stream.fileno())
        # mkstemp makes files private; give what a plain open() would have given.
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    _sync_directory(path.parent)


def write_bytes(path: Path, content: bytes) -> None:
    """Write a whole file atomically."""
    write_with(path, lambda stream: _write_all(stream, content))


def write_text(path: Path, content: str) -> None:
    """Write a whole UTF-8 text file atomically; half of a surrogate pair becomes its escape."""
    write_bytes(path, content.encode("utf-8", "backslashreplace"))


@contextmanager
def staged(folder: Path, last: str) -> Iterator[Path]:
    """Give a folder to write a set of files into; they move to ``folder`` when all are written.

    A failure leaves the files of ``folder`` as they were.  The file ``last`` goes first and comes
    last, so that it is never beside the files of another set.
    """
    stage = Path(tempfile.mkdtemp(prefix=TEMPORARY_PREFIX, dir=folder))
    try:
        yield stage
        names = sorted((path.name for path in stage.iterdir()), key=lambda name: name == last)
        (folder / last).unlink(missing_ok=True)
        for name in names:
            (stage / name).replace(folder / name)
        _sync_directory(folder)
    finally:
        remove(stage)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder of results for writing, and clear what a killed writer left in it.

    The folder itself is locked, so that no file of it stays behind.

    Raises
    ------
    BlockingIOError
        Another process holds it.
    """
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise
        except OSError:  # a network file system that cannot lock a folder
            yield
            return
        clear(folder)
        yield
    finally:
        os.close(handle)


def clear(folder: Path) -> None:
    """Remove what killed writers left in a folder, which nobody else may be writing to."""
    for left in folder.glob(f"{TEMPORARY_PREFIX}*"):
        remove(left)


def remove(path: Path) -> None:
    """Remove a file or a whole folder, never what a symbolic link points to."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _write_all(stream: BinaryIO, content: bytes) -> None:
    stream.write(content)


def _sync_directory(folder: Path) -> None:
    """Make the rename itself durable."""
    with named(folder):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
