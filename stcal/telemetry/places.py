"""Where a store lies: a folder of this machine's file systems, or a place in an object store.

A folder is a :class:`pathlib.Path`, and nothing here stands between it and its reader.  A place in
an object store is a :class:`Remote`, which has those of a path's methods that reading a store
needs; fsspec does the work and is imported when the first is opened.  A store is written in a
folder and then copied: an object store has neither locks nor renames.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, BinaryIO, Literal, cast

from stcal.errors import InputError, StcalError

# Of fsspec's schemes those whose files lie in them.  The others unpack or cache files of a second
# file system, or point to files anywhere (zip, simplecache, reference), or cannot list (http).
SCHEMES = ("s3", "s3a", "gs", "gcs", "az", "abfs", "file", "memory")
# Theirs is container@account.
_WITH_ACCOUNT = ("az", "abfs")
# What back ends tell of a file that is replaced: its hash, or when it was written.
_VERSIONS = ("ETag", "etag", "mtime", "LastModified", "updated", "created")
# Read ahead, since a fragment's columns lie together: a longer one costs a request's time itself.
_BLOCK_BYTES = 1 << 20


@dataclass(frozen=True, order=True)
class Remote:
    """A file or folder of an object store, by its URL; picklable.

    The URL never holds credentials: fsspec's back ends find them in the environment.
    """

    url: str

    def __str__(self) -> str:
        """Return the URL."""
        return self.url

    def __truediv__(self, name: str) -> Remote:
        """Return what is called ``name`` in this folder."""
        return Remote(f"{self.url}/{name}")

    @property
    def parts(self) -> tuple[str, ...]:
        """The URL's parts, which places are ordered by."""
        return tuple(self.url.split("/"))

    @property
    def name(self) -> str:
        """The last part."""
        return self.url.rpartition("/")[2]

    @property
    def parent(self) -> Remote:
        """The folder that this lies in."""
        return Remote(self.url.rpartition("/")[0])

    def exists(self) -> bool:
        """Whether there is such a file; raises as :meth:`open`."""
        with self._naming():
            system, path = self._opened()
            system.invalidate_cache()
            try:
                system.info(path)
            except (FileNotFoundError, NotADirectoryError):
                return False
        return True

    def version(self) -> tuple[int, str]:
        """Return the file's size, and what else tells it from one that replaced it.

        Raises
        ------
        InputError
            Naming the URL and the reason.
        """
        with self._naming():
            system, path = self._opened()
            system.invalidate_cache()
            found = system.info(path)
            told = (found[key] for key in _VERSIONS if found.get(key) is not None)
            return int(found["size"]), str(next(told, ""))

    def open(self, mode: Literal["rb"]) -> BinaryIO:
        """Open the file for reading.

        Raises
        ------
        InputError
            Naming the URL and the reason; so does reading from the file.
        """
        with self._naming():
            system, path = self._opened()
            stream = system.open(path, mode, block_size=_BLOCK_BYTES)
        return cast(BinaryIO, _Stream(self, stream))

    def glob(self, pattern: str) -> list[Remote]:
        """Return what lies below and matches, as ``Path.glob``; ``**`` only as the first part.

        Raises
        ------
        InputError
            Naming the URL: it cannot be listed, or lists what may be outside the store.
        """
        with self._naming():
            system, path = self._opened()
            system.invalidate_cache()
            try:
                # The files of all folders in one answer, rather than folder by folder.
                found = system.find(path) if "/" in pattern else system.ls(path, detail=False)
            except (FileNotFoundError, NotADirectoryError):
                return []
        base = path.rstrip("/") + "/"
        names = (name.removeprefix(base).rstrip("/") for name in found if name.startswith(base))
        return [self._below(name) for name in names if _matches(name, pattern)]

    def _below(self, name: str) -> Remote:
        """Return what was listed as ``name``: names in object stores are any text."""
        odd = {"", ".", ".."} & set(name.split("/"))
        if odd or "::" in name or "?" in name or not name.isprintable():
            raise InputError(f"{self}: lists {name!r}, which no store has: refused")
        return self / name

    def _opened(self) -> tuple[Any, str]:
        """Return the file system, one a thread, and the path in it."""
        try:
            from fsspec.core import url_to_fs
        except ImportError:
            raise InputError(
                f"{self}: reading over URLs needs fsspec; install stcal-startracker[remote]"
            ) from None
        system, path = url_to_fs(self.url)
        return system, path

    @contextmanager
    def _naming(self) -> Iterator[None]:
        """Name the URL in whatever a back end raises: each has exceptions of its own."""
        try:
            yield
        except StcalError:
            raise
        except Exception as error:
            raise InputError(f"{self}: cannot be read: {_reason(error)}") from None


Place = Path | Remote


class _Stream(io.RawIOBase):
    """A remote file whose errors name it: inside Arrow they would pass for damage."""

    def __init__(self, remote: Remote, stream: Any) -> None:
        super().__init__()
        self._remote, self._stream = remote, stream

    def read(self, size: int = -1) -> bytes:
        with self._remote._naming():
            return bytes(self._stream.read(size))

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        return int(self._stream.seek(offset, whence))

    def tell(self) -> int:
        return int(self._stream.tell())

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def close(self) -> None:
        self._stream.close()
        super().close()


def place_of(text: str) -> Place:
    """Return the place that a user names: a folder, or the URL of one.

    Raises
    ------
    InputError
        A URL that no store is read from.  The message has its scheme only, since what is wrong
        may hold credentials.
    """
    if "://" not in text:
        return Path(text)
    scheme, rest = text.split("://", 1)
    if scheme not in SCHEMES or "::" in rest:
        known = ", ".join(f"{name}://" for name in SCHEMES)
        raise InputError(
            f"{scheme}://...: a store is a folder, or a URL of {known}; chains of file systems "
            "are not followed"
        )
    host = rest.partition("/")[0]
    if ":" in host or "?" in rest or ("@" in host and scheme not in _WITH_ACCOUNT):
        raise InputError(
            f"{scheme}://...: a store's URL holds no credentials, ports or queries; set them in "
            "the environment, or in fsspec's configuration"
        )
    if not rest.strip("/"):
        raise InputError(f"{text}: names no folder")
    return Remote(f"{scheme}://{rest.rstrip('/')}")


def local_folder(found: Place) -> Path:
    """Return the folder of a store that is to be written.

    Raises
    ------
    InputError
        It is a URL.
    """
    if isinstance(found, Remote):
        raise InputError(
            f"{found}: a store is written in a folder of a file system, not at a URL; write it "
            "there and copy it when it is done"
        )
    return found


def listed(found: Place, pattern: str) -> list[Place]:
    """Return what lies in a place and matches, in the order of names; nothing where it is none."""
    names: list[Place] = [*found.glob(pattern)]
    return sorted(names, key=lambda name: name.parts)


def _matches(name: str, pattern: str) -> bool:
    parts, wanted = name.split("/"), pattern.split("/")
    if wanted[0] == "**":
        wanted = wanted[1:]
        parts = parts[-len(wanted) :]
    return len(parts) == len(wanted) and all(map(fnmatchcase, parts, wanted))


def _reason(error: Exception) -> str:
    """Return a line: the errors of back ends are often empty, or a whole page."""
    if isinstance(error, ImportError):
        return f"{error}; stcal-startracker[remote] has that of s3://"
    if isinstance(error, TimeoutError):
        return "no answer in time"
    text = (error.strerror if isinstance(error, OSError) else None) or str(error)
    line = text.partition("\n")[0]
    if isinstance(error, FileNotFoundError):
        return f"no such file or bucket: {line}"
    if isinstance(error, PermissionError):
        return f"access refused: {line}"
    if isinstance(error, OSError) and line:
        return line
    return f"{type(error).__name__}: {line}"
