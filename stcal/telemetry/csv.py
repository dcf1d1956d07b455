"""Decode telemetry CSV (long form): the header by name, the rows block by block with Arrow.

Line numbers must stay exact, so the lines are found and counted here, lines that cannot be split
into fields are taken out, and Arrow parses the rest.  A quoted field may not hold a newline.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as arrow_csv
from numpy.typing import NDArray

from stcal.errors import InputError
from stcal.frames import Ints
from stcal.telemetry.block import Decoder, RowBlock, text_of
from stcal.telemetry.columns import COLUMNS
from stcal.telemetry.quarantine import TRUNCATED, Rejection
from stcal.telemetry.sources import BLOCK_BYTES, LineBlock, LineReader, SourceFile, stream

_KNOWN = {column.name for column in COLUMNS}
_LF, _CR, _COMMA = b"\n\r,"
# A run of rows of one frame longer than this many blocks is cut in two.
_MAXIMUM_RUN_BLOCKS = 8


@dataclass(frozen=True)
class _Header:
    names: list[str]
    line: bytes

    def place(self, name: str) -> int:
        return self.names.index(name)


def sniff(head: bytes) -> bool:
    """Whether the first line names a telemetry column."""
    first = head.removeprefix(b"\xef\xbb\xbf").split(b"\n", 1)[0]
    return b"sensor_id" in first and not first.lstrip().startswith((b"{", b"["))


def decode(
    source: SourceFile, warn: Callable[[str], None], block_bytes: int = BLOCK_BYTES
) -> Iterator[RowBlock]:
    """Yield the rows of a CSV file.

    Raises
    ------
    InputError
        Naming the file: the header lacks columns (all are named), repeats one, or is not UTF-8.
    """
    reader = LineReader(stream(source), block_bytes)
    header = _parse_header(source, reader.read_line(), warn)
    ended = True
    for block in reader.blocks():
        ended = block.data.endswith(b"\n")
        lines = _Lines(block, header, source.truncated and block.last)
        if lines.repeated_headers:
            warn("repeated header lines were skipped")
        rows = _row_block(lines, header)
        if not block.last and len(block.data) < _MAXIMUM_RUN_BLOCKS * block_bytes:
            rows, rest = _hold_last_run(rows, lines)
            reader.push_back(rest)
        yield rows
    if not ended and not source.truncated:
        warn("the last row does not end with a newline; the file may have been cut")


def _parse_header(source: SourceFile, line: bytes, warn: Callable[[str], None]) -> _Header:
    where = f"{source.path}: row 1"
    try:
        fields = next(csv.reader([line.decode("utf-8")], strict=True), [])
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{where}: the header is not UTF-8 CSV text: {error}") from None
    names = [field.strip() for field in fields]
    missing = [c.name for c in COLUMNS if c.required and c.name not in names]
    if missing:
        raise InputError(f"{where}: missing column(s): {', '.join(missing)}")
    repeated = sorted({name for name in names if name in _KNOWN and names.count(name) > 1})
    if repeated:
        raise InputError(f"{where}: column(s) given more than once: {', '.join(repeated)}")
    unknown = [name or "(no name)" for name in names if name not in _KNOWN]
    if unknown:
        warn(f"unknown column(s) ignored: {', '.join(unknown)}")
    return _Header(names, line)


class _Lines:
    """The lines of a block: where they are, and which can be split into fields."""

    def __init__(self, block: LineBlock, header: _Header, cut: bool) -> None:
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
        self.rejected: list[Rejection] = []
        self.good = self.end > self.start
        self.repeated_headers = self._drop_headers(header)
        self._check(bytes_, len(header.names))

    def bytes_of(self, i: int) -> bytes:
        return self.data[self.start[i] : self.end[i]]

    def _drop_headers(self, header: _Header) -> int:
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
        # NUL and a lone carriage return would be line ends to other readers.
        odd = np.flatnonzero((bytes_ == 0) | (bytes_ == _CR))
        line = self._line_of(odd)
        inside = (bytes_[odd] == 0) | (odd < self.end[line])
        self._reject(np.unique(line[inside]), "bad_text", "a control character in the row")
        self._reject(self._not_utf8(), "bad_encoding", "the row is not UTF-8")
        commas = np.flatnonzero(bytes_ == _COMMA)
        fields = np.searchsorted(commas, self.stop) - np.searchsorted(commas, self.start) + 1
        quoted = np.unique(self._line_of(np.flatnonzero(bytes_ == ord('"'))))
        self.quoted = bool(len(quoted))
        for i in quoted[self.good[quoted]].tolist():
            fields[i] = self._quoted_fields(i)
        ragged = np.flatnonzero(self.good & (fields != n_columns))
        for i in ragged.tolist():
            self._reject([i], "ragged_row", f"{fields[i]} fields, the header has {n_columns}")

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
        return next(csv.reader([self.bytes_of(i).decode()], strict=True))

    def _reject(self, which: Any, code: str, detail: str) -> None:
        for i in which:
            if self.good[i]:
                raw = text_of(self.bytes_of(i))
                self.rejected.append(Rejection(int(self.number[i]), code, detail, raw))
                self.good[i] = False


def _is_utf8(line: bytes) -> bool:
    try:
        line.decode("utf-8")
    except UnicodeDecodeError:
        return False
    return True


def _row_block(lines: _Lines, header: _Header) -> RowBlock:
    which = np.flatnonzero(lines.good)
    columns = _parse(lines, which, header)
    n = len(which)
    row = lines.number[which]
    new = np.zeros(n, dtype=np.bool_)
    for name in ("sensor_id", "frame_id"):
        text = columns[name]
        if n:
            new[1:] |= pc.not_equal(text[1:], text[:-1]).to_numpy(zero_copy_only=False)

    def raw(i: int) -> str:
        return text_of(lines.bytes_of(int(which[i])))

    return RowBlock(
        columns=columns,
        row=row,
        run=np.cumsum(new),
        raw=raw,
        raw_line=raw,
        rejected=lines.rejected,
        truncated_run=lines.cut,
    )


def _parse(lines: _Lines, which: Ints, header: _Header) -> dict[str, Any]:
    """Return the known columns of the lines ``which`` as Arrow string arrays."""
    known = [name for name in header.names if name in _KNOWN]
    if not len(which):
        parsed = {name: pa.array([], pa.string()) for name in known}
    elif lines.quoted:
        fields = [lines.split(i) for i in which.tolist()]
        places = {name: header.place(name) for name in known}
        parsed = {
            name: pa.array([row[place] for row in fields], pa.string())
            for name, place in places.items()
        }
    else:
        parsed = _parse_with_arrow(_only(lines, which), header, known)
    empty = pa.nulls(len(which), pa.string())
    return {column.name: parsed.get(column.name, empty) for column in COLUMNS}


def _only(lines: _Lines, which: Ints) -> bytes:
    """Return the block without the lines that are not in ``which``."""
    if len(which) == len(lines.stop):
        return lines.data
    length = np.minimum(lines.stop + 1, len(lines.data)) - lines.start
    keep = np.zeros(len(lines.stop), dtype=np.bool_)
    keep[which] = True
    return np.frombuffer(lines.data, np.uint8)[np.repeat(keep, length)].tobytes()


def _parse_with_arrow(data: bytes, header: _Header, known: list[str]) -> dict[str, Any]:
    # Names of our own: a header may repeat an unknown name.
    names = [str(i) for i in range(len(header.names))]
    wanted = [str(header.place(name)) for name in known]
    table = arrow_csv.read_csv(
        io.BytesIO(data),
        # One Arrow block: its threads gain nothing on 8 MB.
        read_options=arrow_csv.ReadOptions(
            use_threads=False, block_size=len(data) + 1, column_names=names
        ),
        parse_options=arrow_csv.ParseOptions(quote_char=False),
        convert_options=arrow_csv.ConvertOptions(
            column_types={place: pa.string() for place in wanted},
            include_columns=wanted,
            strings_can_be_null=False,
            check_utf8=False,  # done line by line above
        ),
    )
    return {name: table[place].combine_chunks() for name, place in zip(known, wanted, strict=True)}


def _hold_last_run(rows: RowBlock, lines: _Lines) -> tuple[RowBlock, bytes]:
    """Return the block without its last run, and that run's lines: the next block may go on it."""
    if not len(rows):
        return rows, b""
    first = int(np.searchsorted(rows.run, rows.run[-1]))
    line = int(rows.row[first] - lines.number[0])
    kept = RowBlock(
        columns={name: text[:first] for name, text in rows.columns.items()},
        row=rows.row[:first],
        run=rows.run[:first],
        raw=rows.raw,
        raw_line=rows.raw_line,
        rejected=[r for r in rows.rejected if r.row < rows.row[first]],
    )
    return kept, lines.data[lines.start[line] :]


DECODER = Decoder("csv", (".csv",), sniff, decode)
