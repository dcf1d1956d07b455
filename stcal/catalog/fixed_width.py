"""Tables of fixed-width text records, as the CDS distributes them: columns in, no loop over rows.

Byte numbers are those of the "byte-by-byte description", from 1, both ends included.
"""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stcal.errors import InputError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_CHUNK_BYTES = 32 * 2**20
_GZIP_MAGIC = b"\x1f\x8b"
_BLANK, _NEWLINE, _RETURN = ord(" "), ord("\n"), ord("\r")


@dataclass(frozen=True)
class Records:
    """Some records of one file.

    Attributes
    ----------
    path : the file, for messages
    first_row : row number, from 1, of the first record
    text : (N, length) uint8, the records without their line ends
    """

    path: Path
    first_row: int
    text: NDArray[np.uint8]

    def fail(self, index: int, reason: str) -> InputError:
        """Return the error of the record with this index."""
        return InputError(f"{self.path}: row {self.first_row + index}: {reason}")

    def require(self, good: NDArray[np.bool_], reason: str) -> None:
        """Raise InputError at the first record (N,) that is not good."""
        if not good.all():
            raise self.fail(int(np.argmin(good)), reason)

    def letters(self, byte: int) -> NDArray[np.str_]:
        """Return the characters (N,) at one byte."""
        return self.text[:, byte - 1].astype(np.uint32).view("U1")

    def blank(self, first: int, last: int) -> NDArray[np.bool_]:
        """Return (N,) whether the field holds only blanks."""
        return np.asarray((self.text[:, first - 1 : last] == _BLANK).all(axis=1))

    def floats(
        self, name: str, first: int, last: int, low: float, high: float, optional: bool = False
    ) -> Floats:
        """Return the numbers (N,) of a field, NaN where it may be blank and is.

        Raises
        ------
        InputError
            Naming file, row and field: blank, not a number, or outside ``low`` to ``high``.
        """
        field = np.ascontiguousarray(self.text[:, first - 1 : last])
        blank = self.blank(first, last)
        if not optional:
            self.require(~blank, f"{name} (bytes {first}-{last}) is blank")
        texts = field.view(f"S{last - first + 1}")[:, 0]
        texts = np.where(blank, b"nan", texts)
        try:
            values = texts.astype(np.float64)
        except ValueError:
            raise self._not_a_number(texts, f"{name} (bytes {first}-{last})") from None
        inside = blank | ((values >= low) & (values <= high))
        self.require(inside, f"{name} (bytes {first}-{last}) is outside {low:g} to {high:g}")
        return values

    def ints(
        self, name: str, first: int, last: int, low: int, high: int, optional: bool = False
    ) -> Ints:
        """Return the integers (N,) of a field, 0 where it may be blank and is."""
        values = self.floats(name, first, last, low, high, optional)
        values = np.where(np.isnan(values), 0.0, values)
        whole = values == np.rint(values)
        self.require(whole, f"{name} (bytes {first}-{last}) is not an integer")
        return values.astype(np.int64)

    def _not_a_number(self, texts: NDArray[np.bytes_], what: str) -> InputError:
        for index, text in enumerate(texts.tolist()):
            try:
                float(text)
            except ValueError:
                shown = text.decode("ascii", "replace").strip()
                return self.fail(index, f"{what} is not a number: {shown!r}")
        return self.fail(0, f"{what} is not a number")


def read_records(path: Path, length: int) -> Iterator[Records]:
    """Yield the records of a file, plain or gzip, LF or CRLF, a bounded number at a time.

    Raises
    ------
    InputError
        Naming file and row: unreadable, empty, cut short, or a row of another length.
    """
    try:
        with path.open("rb") as probe:
            packed = probe.read(2) == _GZIP_MAGIC
        with gzip.open(path) if packed else path.open("rb") as stream:
            yield from _chunks(path, stream, length)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None


def count_records(path: Path, length: int) -> int:
    """Return the number of records; raises what :func:`read_records` does."""
    return sum(len(records.text) for records in read_records(path, length))


def _chunks(path: Path, stream: BufferedReader | gzip.GzipFile, length: int) -> Iterator[Records]:
    row, rest, line = 1, b"", 0
    while True:
        block = _read(path, stream, row)
        data = rest + block
        if line == 0:
            line = _line_length(path, data, length)
        if not block and rest:
            data = _completed(path, data, row, line, length)
        whole = len(data) // line * line
        if whole:
            yield _split(path, row, data[:whole], line, length)
        row, rest = row + whole // line, data[whole:]
        if not block:
            return


def _read(path: Path, stream: BufferedReader | gzip.GzipFile, row: int) -> bytes:
    """Return the next block; ``row`` is the number of the row that it begins with or within."""
    blocks: list[bytes] = []
    missing = _CHUNK_BYTES
    try:
        # In single reads, so that what comes before the damage is seen and its rows counted.
        while missing and (block := stream.read1(missing)):
            blocks.append(block)
            missing -= len(block)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        last = row - 1 + sum(block.count(b"\n") for block in blocks)
        raise InputError(f"{path}: gzip damaged or cut short after row {last}: {error}") from None
    return b"".join(blocks)


def _line_length(path: Path, data: bytes, length: int) -> int:
    """Return bytes a row with its line end, by the first row."""
    if not data:
        raise InputError(f"{path}: the file is empty")
    end = data.find(b"\n")
    found = len(data) if end < 0 else end
    returns = 1 if end > 0 and data[end - 1] == _RETURN else 0
    if found - returns != length:
        raise InputError(f"{path}: row 1: {found - returns} characters, {length} expected")
    return length + returns + 1


def _completed(path: Path, data: bytes, row: int, line: int, length: int) -> bytes:
    """Give the last row the line end that it may lack; anything else was cut."""
    if b"\n" not in data and len(data.rstrip(b"\r")) == length:
        return data.rstrip(b"\r").ljust(line - 1, b"\r") + b"\n"
    raise InputError(f"{path}: row {row}: cut short after {len(data)} of {line} bytes")


def _split(path: Path, row: int, data: bytes, line: int, length: int) -> Records:
    text = np.frombuffer(data, dtype=np.uint8).reshape(-1, line)
    records = Records(path, row, text[:, :length])
    ends = (text[:, -1] == _NEWLINE) & (text[:, :length] != _NEWLINE).all(axis=1)
    if line > length + 1:
        ends &= text[:, length] == _RETURN
    records.require(ends, f"not {length} characters long")
    return records
