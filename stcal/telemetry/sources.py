"""Downlink files as streams of lines: plain or gzip, checked before anything is taken from them."""

from __future__ import annotations

import hashlib
import os
import stat
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from stcal.errors import InputError
from stcal.telemetry.names import printable

EXTENSIONS = (".csv", ".csv.gz", ".jsonl", ".jsonl.gz")
HEAD_BYTES = 1 << 16
BLOCK_BYTES = 8 << 20
# Fewer of telemetry's lines fill a block; each takes some hundred bytes while it is looked at.
BLOCK_LINES = 1 << 17
_CHUNK = 1 << 20
_KEPT_BYTES = 64 << 20
_MAXIMUM_LINE = 16 << 20
_GZIP_MAGIC = b"\x1f\x8b"
_GZIP_WBITS = 31
_PARQUET = b"PAR1"
_FOREIGN = {
    b"PK\x03\x04": "a zip archive",
    b"\x28\xb5\x2f\xfd": "zstd-compressed",
    b"BZh": "bzip2-compressed",
    b"\xfd7zXZ": "xz-compressed",
    _PARQUET: "a Parquet file (one is read with a column mapping)",
    b"\xff\xfe": "UTF-16 text",
    b"\xfe\xff": "UTF-16 text",
}


@dataclass(frozen=True)
class SourceFile:
    """A file that passed the first look.

    Attributes
    ----------
    size, sha256 : of the bytes on disk
    head : the first decompressed bytes
    truncated : a gzip stream that ends too early; what it holds until there is intact
    content : the bytes themselves, in place of a file
    unpacked : what a small gzip file holds, so that it is unpacked once
    """

    path: Path
    size: int
    sha256: str
    compressed: bool
    head: bytes
    truncated: bool = False
    warnings: tuple[str, ...] = ()
    content: bytes | None = None
    unpacked: tuple[bytes, ...] | None = field(default=None, repr=False)

    @property
    def name(self) -> str:
        """The file's name as the store keeps it."""
        return printable(self.path.name)


def find_sources(given: list[Path], extensions: tuple[str, ...] = EXTENSIONS) -> list[Path]:
    """Return the files named, folders replaced by their telemetry files, each file once.

    Raises nothing: a path that cannot be used stays in the list and is reported when it is opened.
    """
    found: list[Path] = []
    for path in given:
        # os.path, because Path's own is_dir and resolve raise for some paths.
        found += (_inside(path, extensions) if os.path.isdir(path) else []) or [path]
    first: dict[str, Path] = {}
    for path in found:
        first.setdefault(os.path.realpath(path), path)
    return list(first.values())


def _inside(folder: Path, extensions: tuple[str, ...]) -> list[Path]:
    """Return the telemetry files of a folder, none when it cannot be read."""
    try:
        names = sorted(name for name in os.listdir(folder) if name.endswith(extensions))
    except OSError:
        return []
    return [folder / name for name in names if os.path.isfile(folder / name)]


def examine(path: Path, is_text: bool = True) -> SourceFile:
    """Read a file once: its hash, whether it is whole, and (``is_text``) that it is text in lines.

    Raises
    ------
    InputError
        Naming the file: unreadable, empty, a gzip stream whose content does not fit its checksum
        (nothing of it can be trusted), another kind of file, or a line beyond 16 MiB.
    """
    _check_kind(path)
    digest, size = hashlib.sha256(), 0
    text = _TextCheck(path, is_text)
    unpack = None
    kept: list[bytes] = []
    for chunk in _chunks(path):
        if size == 0 and chunk.startswith(_GZIP_MAGIC):
            unpack = Gunzip(str(path))
        digest.update(chunk)
        size += len(chunk)
        for part in unpack.feed(chunk) if unpack else (chunk,):
            text.add(part)
            if unpack is not None:
                kept.append(part)
            if text.size > _KEPT_BYTES:
                kept.clear()
    if size == 0 or text.size == 0:
        cut = ": the gzip stream is cut before its first byte" if unpack and size else ""
        raise InputError(f"{path}: the file is empty{cut}")
    truncated = unpack is not None and not unpack.complete
    warnings = unpack.warnings if unpack is not None else ()
    head = bytes(text.head)
    sha256 = digest.hexdigest()
    return SourceFile(
        path,
        size,
        sha256,
        unpack is not None,
        head,
        truncated,
        warnings,
        unpacked=tuple(kept) or None,
    )


def from_memory(name: str, sha256: str, content: bytes) -> SourceFile:
    """Return bytes in memory as a source under the name and the hash of the file they are from."""
    head = content[:HEAD_BYTES]
    return SourceFile(Path(name), len(content), sha256, False, head, content=content)


def _check_kind(path: Path) -> None:
    try:
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode):
            os.listdir(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    if stat.S_ISDIR(mode):
        raise InputError(f"{path}: a folder without {', '.join('*' + e for e in EXTENSIONS)} files")
    if not stat.S_ISREG(mode):
        raise InputError(f"{path}: is not a regular file")


def stream(source: SourceFile) -> Iterator[bytes]:
    """Yield the decompressed bytes of an examined file; of a truncated one, what there is."""
    if source.content is not None:
        yield source.content
        return
    if source.unpacked is not None:
        yield from source.unpacked
        return
    unpack = Gunzip(str(source.path)) if source.compressed else None
    left = source.size  # a file that still grows is read up to where it was examined
    for chunk in _chunks(source.path):
        chunk, left = chunk[:left], left - len(chunk[:left])
        yield from unpack.feed(chunk) if unpack else (chunk,)


class Gunzip:
    """A gzip stream, several members allowed, in parts of bounded size."""

    def __init__(self, name: str) -> None:
        """Start; ``name`` is the file's, for messages."""
        self._name = name
        self._member = zlib.decompressobj(_GZIP_WBITS)
        self._started, self._ended = False, False
        self.warnings: tuple[str, ...] = ()

    @property
    def complete(self) -> bool:
        """Whether the stream ended with a member's end."""
        return self._ended or (self._member.eof and not self._started)

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Yield what the next bytes of the file unpack to."""
        while data and not self._ended:
            self._started = True
            try:
                part = self._member.decompress(data, _CHUNK)
            except zlib.error as error:
                raise InputError(
                    f"{self._name}: the gzip stream is damaged ({error}); nothing was taken "
                    "from it, get the file again"
                ) from None
            if part:
                yield part
            data = self._member.unconsumed_tail
            if self._member.eof:
                data = self._next_member(self._member.unused_data)

    def _next_member(self, rest: bytes) -> bytes:
        if rest.strip(b"\0") and not _GZIP_MAGIC.startswith(rest[:2]):
            self.warnings = ("bytes after the end of the gzip stream were ignored",)
            self._ended = True
            return b""
        rest = rest if rest.strip(b"\0") else b""
        self._started = bool(rest)
        self._member = zlib.decompressobj(_GZIP_WBITS) if rest else self._member
        return rest


class _TextCheck:
    """Looks at the decompressed bytes as they pass."""

    def __init__(self, path: Path, is_text: bool) -> None:
        self._path, self._is_text = path, is_text
        self.size = 0
        self.head = bytearray()
        self._line = 0

    def add(self, part: bytes) -> None:
        """Take the next bytes."""
        if self.size == 0:
            for magic, kind in _FOREIGN.items():
                if part.startswith(magic) and (self._is_text or magic != _PARQUET):
                    raise InputError(f"{self._path}: is {kind}, not UTF-8 telemetry text")
        self.size += len(part)
        if len(self.head) < HEAD_BYTES:
            self.head += part[: HEAD_BYTES - len(self.head)]
            if self._is_text and b"\0" in self.head:
                raise InputError(f"{self._path}: is binary, not UTF-8 telemetry text")
        newline = part.rfind(b"\n")
        self._line = self._line + len(part) if newline < 0 else len(part) - newline
        if self._is_text and self._line > _MAXIMUM_LINE:
            raise InputError(f"{self._path}: has a line beyond {_MAXIMUM_LINE >> 20} MiB")


def _chunks(path: Path) -> Iterator[bytes]:
    try:
        with path.open("rb") as file:
            while chunk := file.read(_CHUNK):
                yield chunk
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


@dataclass(frozen=True)
class LineBlock:
    """Consecutive whole lines.

    Attributes
    ----------
    data : bytes, every line with its newline except perhaps the file's last
    first_row : the number of the first line in the file, from 1
    last : whether the file ends here
    offset : where the data begin in the decompressed file
    """

    data: bytes
    first_row: int
    last: bool
    offset: int = 0


class LineReader:
    """Cuts a stream into blocks of whole lines; the caller may push back lines not yet done."""

    def __init__(self, parts: Iterator[bytes], block_bytes: int = BLOCK_BYTES) -> None:
        """Start at the file's first line."""
        self._parts, self._block_bytes = parts, block_bytes
        self._kept = b""
        self._row = 1
        self._offset = 0
        self._pushed = 0
        self._done = False

    def read_line(self) -> bytes:
        """Return the next line without its end; a byte-order mark at the file's start is cut."""
        while b"\n" not in self._kept and not self._done:
            self._fill(len(self._kept) + 1)
        line, newline, self._kept = self._kept.partition(b"\n")
        self._offset += len(line) + len(newline)
        line = line.removeprefix(b"\xef\xbb\xbf") if self._row == 1 else line
        self._row += bool(newline)
        return line.removesuffix(b"\r")

    def blocks(self) -> Iterator[LineBlock]:
        """Yield blocks until the file ends; :meth:`push_back` may return a block's last lines."""
        wanted = self._block_bytes
        while self._kept or not self._done:
            self._fill(wanted)
            if self._done and len(self._kept) <= wanted:
                end = len(self._kept)
            else:
                end = self._kept.rfind(b"\n", 0, wanted) + 1
                if end <= self._pushed:  # what was pushed back has to come with more behind it
                    wanted += self._block_bytes
                    continue
            end = self._few_lines(end)
            fresh = end - self._pushed
            data, self._kept = self._kept[:end], self._kept[end:]
            row, self._row = self._row, self._row + data.count(b"\n")
            offset, self._offset = self._offset, self._offset + len(data)
            self._pushed = 0
            if data:
                yield LineBlock(data, row, self._done and not self._kept, offset)
            # Where lines were too short for a whole block, those behind them often are too.
            wanted = min(self._block_bytes, 2 * fresh) + self._pushed

    def _few_lines(self, end: int) -> int:
        """Return the end of a block up to ``end``, or of an earlier line when it holds too many."""
        while self._kept.count(b"\n", self._pushed, end) > BLOCK_LINES:
            middle = (self._pushed + end) // 2
            before = self._kept.rfind(b"\n", self._pushed, middle)
            end = 1 + (before if before >= 0 else self._kept.find(b"\n", middle, end))
        return end

    def push_back(self, data: bytes) -> None:
        """Put the last lines of the block just yielded in front of the next one."""
        self._kept = data + self._kept
        self._row -= data.count(b"\n")
        self._offset -= len(data)
        self._pushed = len(data)

    def _fill(self, wanted: int) -> None:
        parts, size = [self._kept], len(self._kept)
        while size < wanted and not self._done:
            part = next(self._parts, None)
            if part is None:
                self._done = True
            else:
                parts.append(part)
                size += len(part)
        self._kept = b"".join(parts)
