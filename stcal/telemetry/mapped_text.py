"""Decode a delimited text table with a column mapping, such as a Yamcs parameter export.

Yamcs writes a header line of parameter names, then a row a time: ``Time`` and the values, an array
parameter as ``[1.0, 2.0]``, separated by tabs.  A parameter that has no value at a time is empty.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterator

import numpy as np
import pyarrow.compute as pc

from stcal.errors import InputError
from stcal.frames import Ints
from stcal.telemetry.block import Again, Decoder, RowBlock
from stcal.telemetry.csv import hold_last_run
from stcal.telemetry.csv_lines import Header, Lines, header_line, parse, split_header
from stcal.telemetry.mapped import check_columns, context_of, read_context, unfold
from stcal.telemetry.mapping import SourceMapping
from stcal.telemetry.quarantine import Rejection
from stcal.telemetry.sources import BLOCK_BYTES, LineReader, SourceFile, stream

NAME = "mapped-text"
# A run of rows of one frame longer than this many blocks is cut in two.
_MAXIMUM_RUN_BLOCKS = 8


def make_decoder(mapping: SourceMapping) -> Decoder:
    """Return the decoder of text tables with this mapping."""

    def run(source: SourceFile, warn: Callable[[str], None]) -> Iterator[RowBlock]:
        return decode(source, warn, mapping)

    def context(source: SourceFile) -> bytes:
        return context_of(mapping, header=base64.b64encode(header_line(source)).decode())

    return Decoder(NAME, (), lambda head: False, run, context)


def decode_again(context: bytes) -> Again:
    """Return how records of such a table are decoded again."""
    mapping, more = read_context(context)
    header = base64.b64decode(more.get("header", ""))
    return Again(make_decoder(mapping).decode, prefix=header, separator=b"\n")


def decode(
    source: SourceFile,
    warn: Callable[[str], None],
    mapping: SourceMapping,
    block_bytes: int = BLOCK_BYTES,
) -> Iterator[RowBlock]:
    """Yield the rows of a text table.

    Raises
    ------
    InputError
        Naming the file: columns of the mapping are missing, or the header is no text.
    """
    reader = LineReader(stream(source), block_bytes)
    header = split_header(source, reader.read_line(), mapping.separator)
    check_columns(mapping, header.names, str(source.path))
    for block in reader.blocks():
        lines = Lines(block, header, source.truncated and block.last)
        if lines.repeated_headers:
            warn("repeated header lines were skipped")
        try:
            rows = _rows(lines, header, mapping)
        except InputError as error:
            raise InputError(f"{source.path}: {error}") from None
        is_short = len(block.data) < _MAXIMUM_RUN_BLOCKS * block_bytes
        if mapping.rows == "star" and not block.last and is_short:
            rows, rest = hold_last_run(rows, lines)
            reader.push_back(rest)
        yield rows


def _rows(lines: Lines, header: Header, mapping: SourceMapping) -> RowBlock:
    which = np.flatnonzero(lines.good)
    unfolded = unfold(parse(lines, which, header, mapping.sources), len(which), mapping)
    rejected = [
        Rejection(
            int(lines.number[which[i]]),
            "bad_lists",
            detail,
            lines.bytes_of(int(which[i])),
            int(lines.offset[which[i]]),
        )
        for i, detail in unfolded.bad.items()
    ]
    line = which[unfolded.record]
    return RowBlock(
        columns=unfolded.columns,
        row=lines.number[line],
        run=runs_of(unfolded.columns, unfolded.record, mapping),
        raw=lambda i: lines.bytes_of(int(line[i])),
        offset=lines.offset[line],
        rejected=[*lines.rejected, *rejected],
        lines_are_frames=mapping.rows == "frame",
        truncated_run=lines.cut and mapping.rows == "star",
    )


def runs_of(columns: dict[str, object], record: Ints, mapping: SourceMapping) -> Ints:
    """Return (n,) the run of each row: its record's, or where sensor and frame change."""
    if mapping.rows == "frame":
        return np.unique(record, return_inverse=True)[1]
    new = np.zeros(len(record), dtype=np.bool_)
    for name in ("sensor_id", "frame_id"):
        text = pc.fill_null(columns[name], "")
        if len(record):
            new[1:] |= pc.not_equal(text[1:], text[:-1]).to_numpy(zero_copy_only=False)
    return np.cumsum(new)
