"""The store's Arrow schema, and its conversion to and from :class:`FrameBatch`.

One row is one frame.  Its stars are list columns of equal lengths, ordered by exposure and within
an exposure from bright to faint (then by row, column and identifier), so that the order in which a
file gives its rows leaves no trace.  An empty value is null.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from stcal.catalog.identifiers import decode, encode
from stcal.constants import EXPOSURES_PER_FRAME
from stcal.errors import InputError
from stcal.frames import Floats, FrameBatch, Ints, concatenate
from stcal.telemetry.columns import FLAGS, UNITS, VECTORS
from stcal.telemetry.parquet import check_columns
from stcal.times import utc_from_tai_ns

SCHEMA = "stcal.frames"
VERSION = 1
_STAR_NUMBERS = ("row_px", "col_px", "intensity")

Objects = NDArray[np.object_]


@dataclass(frozen=True)
class StoredFrames:
    """Frames with the downlink file that each came from.

    Attributes
    ----------
    frames : the batch
    source, source_sha256 : (F,) text, the file's name and the hash of its bytes
    source_row : (F,) the frame's first row in that file (the header is row 1)
    """

    frames: FrameBatch
    source: Objects
    source_sha256: Objects
    source_row: Ints

    def take(self, index: NDArray[np.bool_] | Ints) -> StoredFrames:
        """Return the selected frames."""
        return StoredFrames(
            self.frames.take(index),
            self.source[index],
            self.source_sha256[index],
            self.source_row[index],
        )


def join(parts: Sequence[StoredFrames]) -> StoredFrames:
    """Join stored frames of one sensor, in the order given."""
    return StoredFrames(
        concatenate([part.frames for part in parts]),
        np.concatenate([part.source for part in parts]),
        np.concatenate([part.source_sha256 for part in parts]),
        np.concatenate([part.source_row for part in parts]),
    )


def _field(name: str, kind: pa.DataType, unit: str | None = None, empty: bool = True) -> pa.Field:
    return pa.field(name, kind, nullable=empty, metadata={"unit": unit or UNITS[name]})


def frame_schema() -> pa.Schema:
    """Return the Arrow schema of a stored fragment, with units, name and version as metadata."""
    real = pa.float64()
    stars = [
        ("exposure", pa.list_(pa.int8())),
        *((name, pa.list_(real)) for name in _STAR_NUMBERS),
        ("star_id", pa.list_(pa.string())),
    ]
    fields = [
        _field("sensor_id", pa.string(), empty=False),
        _field("frame_id", pa.int64(), empty=False),
        _field("t_tai_ns", pa.int64(), "ns of TAI since 1970-01-01T00:00:00 TAI", empty=False),
        _field("time_utc", pa.timestamp("ns", "UTC"), "UTC", empty=False),
        _field("best_exposure", pa.int8()),
        *(_field(name, real) for name in (*VECTORS["q_si"], *VECTORS["rate_deg_s"])),
        _field("temperature_c", real),
        *(_field(name, pa.bool_(), empty=False) for name in FLAGS),
        *(_field(name, real) for name in (*VECTORS["pos_km"], *VECTORS["vel_km_s"])),
        *(_field(name, kind, empty=False) for name, kind in stars),
        _field("source", pa.string(), "text", empty=False),
        _field("source_sha256", pa.string(), "hex", empty=False),
        _field("source_row", pa.int64(), "1", empty=False),
    ]
    return pa.schema(fields, metadata={"schema": SCHEMA, "version": str(VERSION)})


def check_version(schema: pa.Schema, where: str) -> None:
    """Refuse a fragment that is not of this schema, of a newer version, or has other columns.

    Raises
    ------
    InputError
        Naming the file.
    """
    metadata = schema.metadata or {}
    if metadata.get(b"schema") != SCHEMA.encode():
        raise InputError(f"{where}: not a fragment of an stcal store")
    text = metadata.get(b"version", b"").decode("ascii", "replace")
    if not text.isdigit() or int(text) < 1:
        raise InputError(f"{where}: schema version {text!r} is not a version")
    if int(text) > VERSION:
        raise InputError(
            f"{where}: written with schema version {text}, this stcal reads up to {VERSION}; "
            "use a newer stcal"
        )
    check_columns(schema, frame_schema(), where)


def table_from_stored(stored: StoredFrames) -> pa.Table:
    """Return the Arrow table of stored frames, in :func:`frame_schema`."""
    frames = stored.frames
    utc = utc_from_tai_ns(frames.t_tai_ns)
    best = frames.best_exposure
    columns: dict[str, Any] = {
        "sensor_id": pa.repeat(frames.sensor_id, frames.n_frames),
        "frame_id": pa.array(frames.frame_id),
        "t_tai_ns": pa.array(frames.t_tai_ns),
        "time_utc": pa.array(utc.astype("datetime64[ns]"), pa.timestamp("ns", "UTC")),
        "best_exposure": pa.array(best, mask=best < 0),
        "temperature_c": _nullable(frames.temperature_c),
        "source": pa.array(stored.source, pa.string()),
        "source_sha256": pa.array(stored.source_sha256, pa.string()),
        "source_row": pa.array(stored.source_row),
    }
    for field, names in VECTORS.items():
        vector = getattr(frames, field)
        columns |= {name: _nullable(vector[:, i]) for i, name in enumerate(names)}
    columns |= {name: pa.array(getattr(frames, name)) for name in FLAGS}
    columns |= _star_lists(frames)
    schema = frame_schema()
    return pa.Table.from_arrays([columns[name] for name in schema.names], schema=schema)


def _star_lists(frames: FrameBatch) -> dict[str, Any]:
    """Return the list columns: the exposures of one frame follow each other already."""
    offsets = pa.array(frames.star_offsets[::EXPOSURES_PER_FRAME].astype(np.int32))
    exposure = (frames.exposure_of_star % EXPOSURES_PER_FRAME).astype(np.int8)
    flat = {"exposure": pa.array(exposure), "star_id": star_id_texts(frames.star_id)}
    flat |= {name: _nullable(getattr(frames, name)) for name in _STAR_NUMBERS}
    return {name: pa.ListArray.from_arrays(offsets, values) for name, values in flat.items()}


def star_id_texts(codes: Ints) -> Any:
    """Return the identifiers as an Arrow string array, null where unmatched."""
    distinct, inverse = np.unique(codes, return_inverse=True)
    texts = pa.array([text or None for text in decode(distinct)], pa.string())
    return texts.take(pa.array(inverse))


def star_id_codes(texts: Any) -> Ints:
    """Return the int64 codes of an Arrow string array of identifiers; -1 where malformed."""
    packed = texts.dictionary_encode()
    codes = np.append(encode(packed.dictionary.to_pylist()), 0)
    # A null has no place in the dictionary: it takes the appended zero, "unmatched".
    return np.asarray(codes[packed.indices.fill_null(len(codes) - 1).to_numpy()], dtype=np.int64)


def _nullable(values: Floats) -> Any:
    return pa.array(values, mask=np.isnan(values))


def _floats(column: Any) -> Floats:
    values = column.to_numpy(zero_copy_only=False)
    return np.array(values, dtype=np.float64)  # null becomes NaN; a copy, as Arrow's is read-only


def batch_from_table(table: pa.Table, sensor_id: str) -> FrameBatch:
    """Return the frames of a table in :func:`frame_schema` as columns, without a star loop.

    Raises
    ------
    InputError
        The table is not what ingest writes; kernels trust its lists.
    """
    column = {name: table[name].combine_chunks() for name in table.column_names}
    _check_lists(column)
    _check_values(column, sensor_id)
    counts = pc.list_value_length(column["exposure"]).to_numpy()
    frame = np.repeat(np.arange(table.num_rows), counts)
    exposure = column["exposure"].flatten().to_numpy()
    per_exposure = np.bincount(
        EXPOSURES_PER_FRAME * frame + exposure, minlength=EXPOSURES_PER_FRAME * table.num_rows
    )
    star_id = star_id_codes(column["star_id"].flatten())
    if (star_id < 0).any():
        raise InputError("star_id holds what is no identifier")
    vectors = {
        field: np.column_stack([_floats(column[name]) for name in names])
        for field, names in VECTORS.items()
    }
    return FrameBatch(
        sensor_id=sensor_id,
        frame_id=np.array(column["frame_id"].to_numpy()),
        t_tai_ns=np.array(column["t_tai_ns"].to_numpy()),
        best_exposure=np.array(column["best_exposure"].fill_null(-1).to_numpy(), dtype=np.int8),
        temperature_c=_floats(column["temperature_c"]),
        eclipse=np.array(column["eclipse"].to_numpy(zero_copy_only=False), dtype=np.bool_),
        intrusion=np.array(column["intrusion"].to_numpy(zero_copy_only=False), dtype=np.bool_),
        star_offsets=np.concatenate(([0], np.cumsum(per_exposure))).astype(np.int64),
        row_px=_floats(column["row_px"].flatten()),
        col_px=_floats(column["col_px"].flatten()),
        intensity=_floats(column["intensity"].flatten()),
        star_id=star_id,
        **vectors,
    )


def _check_lists(column: dict[str, Any]) -> None:
    """Refuse star lists that do not belong together."""
    lengths = pc.list_value_length(column["exposure"])
    for name in (*_STAR_NUMBERS, "star_id"):
        if not pc.list_value_length(column[name]).equals(lengths):
            raise InputError(f"its lists exposure and {name} have other lengths")
    exposure = column["exposure"].flatten()
    steps = np.diff(exposure.fill_null(-1).to_numpy(), prepend=0)
    first = np.cumsum(lengths.to_numpy())[:-1]
    steps[first[first < len(steps)]] = 0  # a new frame may begin with any exposure
    inside = pc.all(pc.is_in(exposure, pa.array([0, 1], pa.int8())), min_count=0).as_py()
    if not inside or (steps < 0).any():
        raise InputError("its exposures are not 0 and 1, in that order")


def _check_values(column: dict[str, Any], sensor_id: str) -> None:
    """Refuse frames of another sensor and numbers that no telemetry has."""
    if not pc.all(pc.equal(column["sensor_id"], sensor_id), min_count=0).as_py():
        raise InputError(f"it holds frames of another sensor than {sensor_id!r}")
    for name in ("row_px", "col_px"):
        values = column[name].flatten()
        if values.null_count or not np.isfinite(values.to_numpy()).all():
            raise InputError(f"{name} holds what is no number")
    best = column["best_exposure"].fill_null(0)
    if not pc.all(pc.is_in(best, pa.array([0, 1], pa.int8())), min_count=0).as_py():
        raise InputError("best_exposure is neither 0 nor 1")


def stored_from_table(table: pa.Table, sensor_id: str) -> StoredFrames:
    """Return the frames of a table in :func:`frame_schema` with their sources."""
    return StoredFrames(
        batch_from_table(table, sensor_id),
        table["source"].to_numpy().astype(object),
        table["source_sha256"].to_numpy().astype(object),
        np.array(table["source_row"].to_numpy(), dtype=np.int64),
    )
