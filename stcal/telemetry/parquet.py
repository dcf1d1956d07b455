"""The store's Parquet files: read with every failure naming the file, written in one step."""

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


@contextmanager
def reading(path: Path, kind: str, remedy: str = "") -> Iterator[pq.ParquetFile]:
    """Open a Parquet file; ``kind`` and ``remedy`` are for the message when it is damaged.

    Raises
    ------
    InputError
        Naming the file: it cannot be read, or is damaged.
    """
    try:
        # Not read_table: it would invent columns from the folder names.
        with path.open("rb") as stream, pq.ParquetFile(stream) as file:
            yield file
    except (pa.ArrowException, OSError) as error:
        # Of the two only the operating system's errors have a number.
        if isinstance(error, OSError) and error.errno is not None:
            raise InputError(f"{path}: cannot be read: {os.strerror(error.errno)}") from None
        raise InputError(f"{path}: damaged {kind}: {error}{remedy}") from None


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
        pq.write_table(table, stream, compression="zstd", **options)

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
