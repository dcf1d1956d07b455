"""The store's Parquet files: read with every failure naming the file, written in one step.

Pages carry checksums: without them most flipped bits of a fragment decode silently to other numbers
(3 of 4, measured).  Files of older versions have none and are read as before.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import pyarrow as pa
import pyarrow.parquet as pq

from stcal import atomic
from stcal.errors import InputError
from stcal.telemetry.places import Place

# A file with more values than both is a bomb: frames take about a byte a value.
_MANY_VALUES, _VALUES_A_BYTE = 50_000_000, 200


@contextmanager
def reading(path: Place, kind: str, remedy: str = "") -> Iterator[pq.ParquetFile]:
    """Open a Parquet file; ``kind`` and ``remedy`` are for the message when it is damaged.

    Raises
    ------
    InputError
        Naming the file: it cannot be read, or is damaged.
    """
    try:
        # Not read_table: it would invent columns from the folder names.
        with path.open("rb") as stream:
            size = stream.seek(0, os.SEEK_END)
            with pq.ParquetFile(stream, page_checksum_verification=True) as file:
                _check_size(file, path, size)
                yield file
    except UnicodeDecodeError as error:  # a name in the file's schema
        raise InputError(f"{path}: damaged {kind}: {error}{remedy}") from None
    except (pa.ArrowException, OSError) as error:
        # Of the two only the operating system's errors have a number.
        if isinstance(error, OSError) and error.errno is not None:
            raise InputError(f"{path}: cannot be read: {os.strerror(error.errno)}") from None
        raise InputError(f"{path}: damaged {kind}: {error}{remedy}") from None


def _check_size(file: pq.ParquetFile, path: Place, size: int) -> None:
    """Refuse a file of few bytes that says it holds far more values than stcal ever packs.

    Run lengths and dictionaries may unfold a kilobyte to more than fits into memory.  Counted are
    rows: to ask a damaged footer for its columns' facts may end the whole process.
    """
    values = file.metadata.num_rows * file.metadata.num_columns
    if values > _MANY_VALUES and values > _VALUES_A_BYTE * size:
        raise InputError(f"{path}: says that it holds {values} values in {size} bytes: refused")


def check_columns(found: pa.Schema, expected: pa.Schema, where: str) -> None:
    """Refuse a file whose columns are not those of its schema.

    Raises
    ------
    InputError
        Naming the file and its first column that differs.
    """
    if found.equals(expected):
        return
    if found.names != expected.names:
        odd = ", ".join(sorted(set(found.names) ^ set(expected.names))) or "none, but moved"
        raise InputError(f"{where}: damaged: missing or unknown columns: {odd}")
    a, b = next((a, b) for a, b in zip(found, expected, strict=True) if not a.equals(b))
    raise InputError(f"{where}: damaged: column {a.name} is {_kind(a)}, not {_kind(b)}")


def _kind(field: pa.Field) -> str:
    return f"{field.type}" + ("" if field.nullable else " without nulls")


def write(path: Path, table: pa.Table, **options: Any) -> None:
    """Write a table atomically; its folders are made."""

    def fill(stream: BinaryIO) -> None:
        pq.write_table(table, stream, compression="zstd", write_page_checksum=True, **options)

    make_folder(path.parent)
    atomic.write_with(path, fill)


def make_folder(path: Path) -> None:
    """Make a folder and those above it.

    Raises
    ------
    InputError
        Naming the folder: a file stands in its place or above it.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise InputError(f"{path}: cannot be made: a file is in the way") from None
