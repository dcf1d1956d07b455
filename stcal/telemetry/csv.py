"""Decode telemetry CSV (long form): the header by name, the rows block by block."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from stcal.errors import InputError
from stcal.frames import Ints
from stcal.telemetry.block import Decoder, RowBlock
from stcal.telemetry.columns import COLUMNS
from stcal.telemetry.csv_fields import Fields, columns_of, find_fields, runs_of
from stcal.telemetry.csv_lines import Header, Lines, header_line, parse, split_header
from stcal.telemetry.sources import BLOCK_BYTES, LineReader, SourceFile, stream

_KNOWN = {column.name for column in COLUMNS}
# A run of rows of one frame longer than this many blocks is cut in two.
_MAXIMUM_RUN_BLOCKS = 8


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
        lines = Lines(block, header, source.truncated and block.last)
        if lines.repeated_headers:
            warn("repeated header lines were skipped")
        hold = not block.last and len(block.data) < _MAXIMUM_RUN_BLOCKS * block_bytes
        rows, rest = _row_block(lines, header, hold)
        if rest:
            reader.push_back(rest)
        yield rows
    if not ended and not source.truncated:
        warn("the last row does not end with a newline; the file may have been cut")


def _parse_header(source: SourceFile, line: bytes, warn: Callable[[str], None]) -> Header:
    where, header = f"{source.path}: row 1", split_header(source, line)
    names = header.names
    missing = [c.name for c in COLUMNS if c.required and c.name not in names]
    if missing:
        raise InputError(f"{where}: missing column(s): {', '.join(missing)}")
    repeated = sorted({name for name in names if name in _KNOWN and names.count(name) > 1})
    if repeated:
        raise InputError(f"{where}: column(s) given more than once: {', '.join(repeated)}")
    unknown = [name or "(no name)" for name in names if name not in _KNOWN]
    if unknown:
        warn(f"unknown column(s) ignored: {', '.join(unknown)}")
    return header


def _row_block(lines: Lines, header: Header, hold: bool) -> tuple[RowBlock, bytes]:
    """Return the rows of a block and, when the last run is held back, its lines."""
    which = np.flatnonzero(lines.good)
    known = [name for name in header.names if name in _KNOWN]
    if len(which) and not lines.quoted:
        fields = find_fields(lines, which, header)
        first = runs_of(fields, known)
        if first is not None:
            return _compact_block(fields, first, known, hold)
    rows = _text_block(lines, which, header, known)
    return hold_last_run(rows, lines) if hold else (rows, b"")


def _compact_block(
    fields: Fields, first: Ints, known: list[str], hold: bool
) -> tuple[RowBlock, bytes]:
    """Return the rows with the columns of their frame given once a run."""
    lines, which = fields.lines, fields.which
    rest, rejected = b"", lines.rejected
    if hold:
        stop, first = int(first[-1]), first[:-1]
        rest = lines.data[lines.start[which[stop]] :]
        rejected = [record for record in rejected if record.row < lines.number[which[stop]]]
        fields = replace(fields, which=which[:stop], bounds=fields.bounds[:stop])
    new = np.zeros(len(fields.which), dtype=np.int64)
    new[first[1:]] = 1
    run = np.cumsum(new)
    rows = RowBlock(
        columns=columns_of(fields, first, known),
        row=lines.number[fields.which],
        run=run,
        raw=lambda i: lines.bytes_of(int(which[i])),
        offset=lines.offset[fields.which],
        rejected=rejected,
        truncated_run=lines.cut and not hold,
        frame=run,
    )
    return rows, rest


def _text_block(lines: Lines, which: Ints, header: Header, known: list[str]) -> RowBlock:
    """Return the rows with every column as text: quoted ones, and frames that contradict."""
    found = parse(lines, which, header, known)
    empty = pa.nulls(len(which), pa.string())
    columns = {column.name: found.get(column.name, empty) for column in COLUMNS}
    n = len(which)
    row = lines.number[which]
    new = np.zeros(n, dtype=np.bool_)
    for name in ("sensor_id", "frame_id"):
        text = columns[name]
        if n:
            new[1:] |= pc.not_equal(text[1:], text[:-1]).to_numpy(zero_copy_only=False)

    return RowBlock(
        columns=columns,
        row=row,
        run=np.cumsum(new),
        raw=lambda i: lines.bytes_of(int(which[i])),
        offset=lines.offset[which],
        rejected=lines.rejected,
        truncated_run=lines.cut,
    )


def hold_last_run(rows: RowBlock, lines: Lines) -> tuple[RowBlock, bytes]:
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
        offset=rows.offset[:first],
        rejected=[r for r in rows.rejected if r.row < rows.row[first]],
    )
    return kept, lines.data[lines.start[line] :]


DECODER = Decoder("csv", (".csv",), sniff, decode, header_line)
