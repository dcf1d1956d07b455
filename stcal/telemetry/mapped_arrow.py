"""Decode a Parquet or Arrow IPC file with a column mapping.

A row of such a file stands in no one place of it, so a refused row is kept as an Arrow record batch
of its own, with its values exact, and without an offset; the columns' types are in the context.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from stcal.errors import InputError
from stcal.telemetry.block import Again, Decoder, RowBlock
from stcal.telemetry.mapped import check_columns, context_of, read_context, unfold
from stcal.telemetry.mapped_text import runs_of
from stcal.telemetry.mapping import SourceMapping
from stcal.telemetry.quarantine import Rejection
from stcal.telemetry.sources import SourceFile

NAME = "mapped-arrow"
BATCH_ROWS = 16_384
_PARQUET, _FILE, _STREAM = b"PAR1", b"ARROW1", b"\xff\xff\xff\xff"
# A run of rows of one frame longer than this many batches is cut in two.
_MAXIMUM_RUN_BATCHES = 8


def make_decoder(mapping: SourceMapping) -> Decoder:
    """Return the decoder of Parquet and Arrow files with this mapping."""

    def run(source: SourceFile, warn: Callable[[str], None]) -> Iterator[RowBlock]:
        return decode(source, warn, mapping)

    def context(source: SourceFile) -> bytes:
        with _opened(source, mapping) as (schema, _):
            packed = base64.b64encode(schema.serialize().to_pybytes()).decode()
        return context_of(mapping, schema=packed)

    return Decoder(NAME, (), lambda head: False, run, context, text=False)


def decode_again(context: bytes) -> Again:
    """Return how records of such a table are decoded again."""
    mapping, more = read_context(context)
    prefix = base64.b64decode(more.get("schema", ""))

    def show(raw: bytes) -> str:
        try:
            (row,) = pa.ipc.open_stream(prefix + raw).read_all().to_pylist()
        except (pa.ArrowException, ValueError) as error:
            raise InputError(f"a damaged record: {error}") from None
        return json.dumps(row, default=str, ensure_ascii=False)

    return Again(make_decoder(mapping).decode, prefix=prefix, show=show)


def decode(
    source: SourceFile,
    warn: Callable[[str], None],
    mapping: SourceMapping,
    batch_rows: int = BATCH_ROWS,
) -> Iterator[RowBlock]:
    """Yield the rows of a Parquet or Arrow file; row 1 is the first.

    Raises
    ------
    InputError
        Naming the file: it is neither, damaged, or columns of the mapping are missing or of a type
        that the mapping cannot be.
    """
    held, first_row = None, 1
    with _opened(source, mapping) as (schema, batches):
        for batch in _sized(batches, batch_rows):
            table = pa.Table.from_batches([batch] if held is None else [*held, batch], schema)
            whole = table.combine_chunks()
            try:
                rows, done = _rows(whole, first_row, mapping)
            except InputError as error:
                raise InputError(f"{source.path}: {error}") from None
            if mapping.rows == "star" and whole.num_rows < _MAXIMUM_RUN_BATCHES * batch_rows:
                held = whole.slice(done).to_batches()
                first_row += done
                yield _first(rows, done)
            else:
                held, first_row = None, first_row + whole.num_rows
                yield rows
        if held:
            yield _rows(pa.Table.from_batches(held, schema).combine_chunks(), first_row, mapping)[0]


def _rows(table: pa.Table, first_row: int, mapping: SourceMapping) -> tuple[RowBlock, int]:
    """Return a table's rows, and where its last run begins."""
    arrays = {name: _array(table[name]) for name in table.column_names}
    unfolded = unfold(arrays, table.num_rows, mapping)

    def raw(record: int) -> bytes:
        (batch,) = table.slice(record, 1).combine_chunks().to_batches()
        return bytes(batch.serialize().to_pybytes())

    rejected = [
        Rejection(first_row + i, "bad_lists", detail, raw(i)) for i, detail in unfolded.bad.items()
    ]
    record, run = unfolded.record, runs_of(unfolded.columns, unfolded.record, mapping)
    block = RowBlock(
        columns=unfolded.columns,
        row=first_row + record,
        run=run,
        raw=lambda i: raw(int(record[i])),
        offset=np.full(len(record), -1),
        rejected=rejected,
        lines_are_frames=mapping.rows == "frame",
    )
    return block, int(np.searchsorted(run, run[-1])) if len(run) else 0


def _first(rows: RowBlock, n: int) -> RowBlock:
    """Return the first n rows of a block whose rows are the table's."""
    return RowBlock(
        columns={name: text[:n] for name, text in rows.columns.items()},
        row=rows.row[:n],
        run=rows.run[:n],
        raw=rows.raw,
        offset=rows.offset[:n],
        rejected=rows.rejected,
    )


def _array(column: Any) -> Any:
    chunks = column.chunks
    return chunks[0] if len(chunks) == 1 else pa.concat_arrays(chunks) if chunks else _none(column)


def _none(column: Any) -> Any:
    return pa.array([], column.type)


def _sized(batches: Iterator[Any], rows: int) -> Iterator[Any]:
    for batch in batches:
        for start in range(0, batch.num_rows, rows):
            yield batch.slice(start, rows)


@contextmanager
def _opened(source: SourceFile, mapping: SourceMapping) -> Iterator[tuple[pa.Schema, Any]]:
    """Give the schema of the mapped columns and an iterator of record batches of them."""
    if source.compressed:
        raise InputError(f"{source.path}: is gzip-compressed as a whole; unpack it first")
    opener = next((o for magic, o in _OPENERS.items() if source.head.startswith(magic)), None)
    if opener is None:
        raise InputError(f"{source.path}: is neither a Parquet nor an Arrow IPC file")
    try:
        with opener(source) as (schema, read):
            check_columns(mapping, schema.names, str(source.path))
            plain = pa.schema([_plain(schema.field(name)) for name in mapping.sources])
            yield plain, _plain_batches(read(mapping.sources), plain)
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{source.path}: damaged or not readable: {error}") from None


def _plain(field: pa.Field) -> pa.Field:
    """Return a field whose records stand for themselves: without a dictionary."""
    kind = field.type
    return pa.field(field.name, kind.value_type if pa.types.is_dictionary(kind) else kind)


def _plain_batches(batches: Iterator[Any], plain: pa.Schema) -> Iterator[Any]:
    for batch in batches:
        arrays = [batch.column(batch.schema.get_field_index(name)) for name in plain.names]
        decoded = [a.dictionary_decode() if hasattr(a, "dictionary_decode") else a for a in arrays]
        yield pa.RecordBatch.from_arrays(decoded, schema=plain)


@contextmanager
def _parquet(source: SourceFile) -> Iterator[tuple[pa.Schema, Any]]:
    with source.path.open("rb") as stream, pq.ParquetFile(stream) as file:

        def read(names: list[str]) -> Iterator[Any]:
            return iter(file.iter_batches(BATCH_ROWS, columns=names))

        yield file.schema_arrow, read


@contextmanager
def _ipc_file(source: SourceFile) -> Iterator[tuple[pa.Schema, Any]]:
    with source.path.open("rb") as stream, pa.ipc.open_file(stream) as file:

        def read(names: list[str]) -> Iterator[Any]:
            return (file.get_batch(i).select(names) for i in range(file.num_record_batches))

        yield file.schema, read


@contextmanager
def _ipc_stream(source: SourceFile) -> Iterator[tuple[pa.Schema, Any]]:
    content = source.content
    stream = source.path.open("rb") if content is None else pa.BufferReader(content)
    with stream, pa.ipc.open_stream(stream) as reader:

        def read(names: list[str]) -> Iterator[Any]:
            return (batch.select(names) for batch in reader)

        yield reader.schema, read


_OPENERS: dict[bytes, Callable[[SourceFile], Any]] = {
    _PARQUET: _parquet,
    _FILE: _ipc_file,
    _STREAM: _ipc_stream,
}
