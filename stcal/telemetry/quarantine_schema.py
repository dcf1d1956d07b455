"""The schema of a quarantine file, its version, and reading what the version before wrote."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from stcal.errors import InputError
from stcal.telemetry import parquet
from stcal.telemetry.places import Place

VERSION = 2
_SCHEMA = "stcal.quarantine"


@dataclass(frozen=True)
class Origin:
    """Which decoder a source went through, and what that needs beside the raw bytes.

    ``context`` is the decoder's own: a header line, a mapping, a layout.
    """

    format: str = ""
    context: bytes = b""


def schema(origin: Origin | None = None) -> pa.Schema:
    """Return the Arrow schema of a quarantine file."""
    text, whole = pa.string(), pa.int64()
    fields = [
        ("source", text),
        ("source_sha256", text),
        ("row", whole),
        ("rows", whole),
        ("offset", whole),
        ("length", whole),
        ("code", text),
        ("detail", text),
        ("raw", pa.binary()),
        ("sensor_id", text),
        ("frame_id", text),
        ("content_sha256", text),
    ]
    metadata = {"schema": _SCHEMA, "version": str(VERSION)}
    if origin is not None:
        metadata["format"] = origin.format
        metadata["context"] = base64.b64encode(origin.context).decode("ascii")
    return pa.schema([pa.field(name, kind) for name, kind in fields], metadata=metadata)


def read_file(path: Place) -> pa.Table:
    """Read one quarantine file; one of version 1 is given the columns that it lacks.

    Raises
    ------
    InputError
        Naming the file when it cannot be read, is damaged, or a newer stcal wrote it.
    """
    with parquet.reading(path, "quarantine file") as file:
        version = _version(file.schema_arrow, path)
        expected = schema() if version == VERSION else _schema_of_version_1()
        parquet.check_columns(file.schema_arrow, expected, str(path))
        table = file.read()
    return table if version == VERSION else _from_version_1(table)


def origin_of(table: pa.Table, path: Place) -> Origin | None:
    """Return how the records of a file were decoded; None in a file of version 1.

    Raises
    ------
    InputError
        Naming the file: its metadata are damaged.
    """
    metadata = table.schema.metadata or {}
    if b"format" not in metadata:
        return None
    try:
        context = base64.b64decode(metadata.get(b"context", b""), validate=True)
        return Origin(metadata[b"format"].decode("ascii"), context)
    except ValueError as error:
        raise InputError(f"{path}: damaged quarantine file: its origin: {error}") from None


def _version(found: pa.Schema, path: Place) -> int:
    metadata = found.metadata or {}
    text = metadata.get(b"version", b"").decode("ascii", "replace")
    if metadata.get(b"schema") != _SCHEMA.encode() or text not in map(str, range(1, VERSION + 1)):
        if text.isdigit() and int(text) > VERSION:
            raise InputError(
                f"{path}: written with quarantine version {text}, this stcal reads up to "
                f"{VERSION}; use a newer stcal"
            )
        raise InputError(f"{path}: damaged: not a quarantine file of an stcal store")
    return int(text)


def _schema_of_version_1() -> pa.Schema:
    """Version 1 kept text instead of bytes, and no place in the source."""
    text, whole = pa.string(), pa.int64()
    kinds: dict[str, Any] = {"row": whole, "rows": whole}
    names = ("source", "source_sha256", "row", "rows", "sensor_id", "frame_id", "code", "detail")
    return pa.schema([(name, kinds.get(name, text)) for name in (*names, "raw", "content_sha256")])


def _from_version_1(table: pa.Table) -> pa.Table:
    columns = {name: table[name] for name in table.column_names}
    columns["raw"] = table["raw"].cast(pa.binary())
    columns["offset"] = pa.array([-1] * table.num_rows, pa.int64())
    columns["length"] = pc.binary_length(columns["raw"]).cast(pa.int64())
    return pa.table([columns[name] for name in schema().names], schema=schema())
