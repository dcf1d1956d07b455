"""Lines of a delimited text file: where they are, which can be split into fields, and the fields.

Line numbers must stay exact, so the lines are found and counted here, lines that cannot be split
into fields are taken out, and Arrow parses the rest.  A quoted field may not hold a newline.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as arrow_csv
from numpy.typing import NDArray

from stcal.errors import InputError
from stcal.frames import Ints
from stcal.telemetry.csv_kernels import count_fields
from stcal.telemetry.quarantine import TRUNCATED, Rejection
from stcal.telemetry.sources import LineBlock, LineReader, SourceFile, stream

_LF, _CR = b"\n\r"


@dataclass(frozen=True)
class Header:
    """The first line of a file: the names of its columns."""

    names: list[str]
    line: bytes
    delimiter: str = ","

    def place(self, name: str) -> int:
        """Return which column bears a name."""
        return self.names.index(name)


def header_line(source: SourceFile) -> bytes:
    """Return the file's first line as it stands, without its end."""
    return LineReader(stream(source)).read_line()


def split_header(source: SourceFile, line: bytes, delimiter: str = ",") -> Header:
    """Return a file's header.

    Raises
    ------
    InputError
        Naming the file: the line is not UTF-8 text that splits into fields.
    """
    try:
        text = line.decode("utf-8")
        fields = next(csv.reader([text], strict=True, delimiter=delimiter), [])
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(
            f"{source.path}: row 1: the header is not UTF-8 CSV text: {error}"
        ) from None
    return Header([field.strip() for field in fields], line, delimiter)


class Lines:
    """The lines of a block: where they are, and which can be split into fields."""

    def __init__(self, block: LineBlock, header: Header, cut: bool) -> None:
        """Look at the lines; ``cut``: the file ends too early, within or behind the last."""
        self.data = block.data
        self.cut = cut
        bytes_ = np.frombuffer(block.data, np.uint8)
        newline = np.flatnonzero(bytes_ == _LF)
        self.ended = block.data.endswith(b"\n")
        self.stop = newline if self.ended else np.append(newline, len(bytes_))
        self.start = np.concatenate(([0], self.stop[:-1] + 1))
        self.number = block.first_row + np.arange(len(self.stop))
        crlf = (self.stop > self.start) & (bytes_[np.maximum(self.stop, 1) - 1] == _CR)
        self.end = self.stop - crlf
        self.offset = block.offset + self.start
        self.rejected: list[Rejection] = []
        self.good = self.end > self.start
        self.repeated_headers = self._drop_headers(header)
        self._delimiter = header.delimiter
        self._check(bytes_, len(header.names))

    def bytes_of(self, i: int) -> bytes:
        """Return a line without its end."""
        return self.data[self.start[i] : self.end[i]]

    def _drop_headers(self, header: Header) -> int:
        """Files joined end to end repeat the header: it is no row."""
        same = np.flatnonzero(self.good & (self.end - self.start == len(header.line)))
        if header.line not in self.data:
            return 0
        found = [i for i in same.tolist() if self.bytes_of(i) == header.line]
        self.good[found] = False
        return len(found)

    def _check(self, bytes_: NDArray[np.uint8], n_columns: int) -> None:
        if self.cut and not self.ended and self.good[-1]:
            self._reject([len(self.stop) - 1], TRUNCATED, "the file ends within this row")
        fields = np.empty(len(self.start), np.int64)
        special = count_fields(bytes_, self.start, self.stop, ord(self._delimiter), fields)
        self.quoted = special and self._check_special(bytes_, fields)
        ragged = np.flatnonzero(self.good & (fields != n_columns))
        for i in ragged.tolist():
            self._reject([i], "ragged_row", f"{fields[i]} fields, the header has {n_columns}")

    def _check_special(self, bytes_: NDArray[np.uint8], fields: Ints) -> bool:
        """Refuse what is no text, count quoted fields, and return whether there are any."""
        # NUL and a lone carriage return would be line ends to other readers.
        odd = np.flatnonzero((bytes_ == 0) | (bytes_ == _CR))
        line = self._line_of(odd)
        inside = (bytes_[odd] == 0) | (odd < self.end[line])
        self._reject(np.unique(line[inside]), "bad_text", "a control character in the row")
        self._reject(self._not_utf8(), "bad_encoding", "the row is not UTF-8")
        quoted = np.unique(self._line_of(np.flatnonzero(bytes_ == ord('"'))))
        for i in quoted[self.good[quoted]].tolist():
            fields[i] = self._quoted_fields(i)
        return bool(len(quoted))

    def _line_of(self, position: Ints) -> Ints:
        return np.searchsorted(self.stop, position)

    def _not_utf8(self) -> list[int]:
        try:
            self.data.decode("utf-8")
        except UnicodeDecodeError:
            return [i for i in range(len(self.stop)) if not _is_utf8(self.bytes_of(i))]
        return []

    def _quoted_fields(self, i: int) -> int:
        try:
            return len(self.split(i))
        except csv.Error as error:
            self._reject([i], "bad_text", f"quotes: {error}")
            return 0

    def split(self, i: int) -> list[str]:
        """Return the fields of a line that may hold quotes."""
        line = self.bytes_of(i).decode()
        return next(csv.reader([line], strict=True, delimiter=self._delimiter))

    def _reject(self, which: Any, code: str, detail: str) -> None:
        for i in which:
            if self.good[i]:
                row, offset = int(self.number[i]), int(self.offset[i])
                self.rejected.append(Rejection(row, code, detail, self.bytes_of(i), offset))
                self.good[i] = False


def _is_utf8(line: bytes) -> bool:
    try:
        line.decode("utf-8")
    except UnicodeDecodeError:
        return False
    return True


def parse(lines: Lines, which: Ints, header: Header, known: Sequence[str]) -> dict[str, Any]:
    """Return the ``known`` columns of the lines ``which`` as Arrow string arrays."""
    if not len(which):
        return {name: pa.array([], pa.string()) for name in known}
    if lines.quoted:
        fields = [lines.split(i) for i in which.tolist()]
        places = {name: header.place(name) for name in known}
        return {
            name: pa.array([row[place] for row in fields], pa.string())
            for name, place in places.items()
        }
    return _parse_with_arrow(_only(lines, which), header, known)


def _only(lines: Lines, which: Ints) -> bytes:
    """Return the block without the lines that are not in ``which``."""
    if len(which) == len(lines.stop):
        return lines.data
    # Neighbours are copied together.
    breaks = np.flatnonzero(np.diff(which) != 1)
    first = lines.start[which[np.concatenate(([0], breaks + 1))]]
    behind = lines.stop[which[np.concatenate((breaks, [len(which) - 1]))]] + 1
    return b"".join(map(lines.data.__getitem__, map(slice, first.tolist(), behind.tolist())))


def _parse_with_arrow(data: bytes, header: Header, known: Sequence[str]) -> dict[str, Any]:
    # Names of our own: a header may repeat an unknown name.
    names = [str(i) for i in range(len(header.names))]
    wanted = [str(header.place(name)) for name in known]
    table = arrow_csv.read_csv(
        io.BytesIO(data),
        # One Arrow block: its threads gain nothing on 8 MB.
        read_options=arrow_csv.ReadOptions(
            use_threads=False, block_size=len(data) + 1, column_names=names
        ),
        parse_options=arrow_csv.ParseOptions(delimiter=header.delimiter, quote_char=False),
        convert_options=arrow_csv.ConvertOptions(
            column_types={place: pa.string() for place in wanted},
            include_columns=wanted,
            strings_can_be_null=False,
            check_utf8=False,  # done line by line above
        ),
    )
    return {name: table[place].combine_chunks() for name, place in zip(known, wanted, strict=True)}
