"""Quarantine: every row or frame that was not taken, with its source, place, reason and bytes.

``quarantine/<source sha256>.parquet`` holds what one file's rows were refused for (further parts of
a very long file: ``<sha256>-0001.parquet``), and is replaced when the file is ingested again.
``quarantine/conflicts/sensor=<id>/day=<day>.parquet`` holds the versions of a frame that lost
against another one.  They are kept by day and not by source because which version loses is known
only when the last source has come: so the records do not depend on the order of ingestion.

``raw`` are the bytes as they stand in the decompressed source from ``offset`` on.  Where they stand
in no one place (a row of a Parquet file; a displaced version, which may come from a store long
after its source is gone) the offset is -1 and ``raw`` is the record in a form that decodes to the
same values.  What else it takes to decode them again (``Origin``) is in the file's metadata.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from stcal.telemetry import parquet
from stcal.telemetry.places import Place, listed
from stcal.telemetry.quarantine_schema import Origin, origin_of, read_file, schema

__all__ = ["Origin", "origin_of", "read_file", "schema"]

FOLDER = "quarantine"
CONFLICT = "conflict"
TRUNCATED = "truncated"
TIME_BACKWARDS = "time_backwards"
# Shorter beginnings of a hash are not taken for one.
SHORTEST_HASH = 6

# Code of a reason -> what it means.  Row: the row alone is refused.  Frame: all its rows are.
REASONS = {
    "ragged_row": "row: not as many fields as the header has columns",
    "bad_encoding": "row: not UTF-8",
    "bad_text": "row: control characters or quotes that do not close",
    "bad_json": "row: not a JSON object of the telemetry's form",
    "bad_lists": "row: the lists of an exposure do not fit each other or their number",
    "bad_exposure": "row: exposure is neither 0 nor 1",
    "bad_centroid": "row: row_px or col_px is empty or not a finite number",
    "outside_detector": "row: the centroid lies outside the detector",
    "bad_intensity": "row: intensity is not a finite number",
    "bad_star_id": "row: star_id is neither HIP n nor TYC a-b-c",
    "bad_sensor_id": "frame: sensor_id is empty, too long or not printable",
    "unknown_sensor": "frame: no configuration given applies to this sensor",
    "bad_frame_id": "frame: frame_id is not an integer of at most 18 digits",
    "bad_time": "frame: time_utc is not an ISO 8601 UTC time with Z, from 1972 on",
    "bad_best_exposure": "frame: best_exposure is neither 0, 1 nor empty",
    "bad_quaternion": "frame: partly empty, not numbers, zero or not of unit norm",
    "bad_rate": "frame: a rate is not a finite number",
    "bad_temperature": "frame: temperature_c is not a finite number",
    "bad_flag": "frame: eclipse or intrusion is neither 0, 1 nor empty",
    "bad_state": "frame: position or velocity is partly empty or not finite numbers",
    "inconsistent_frame": "frame: its rows give different values for the frame",
    TIME_BACKWARDS: "frame: its time lies outside those of its neighbours, which agree",
    TRUNCATED: "frame: the file ends within it",
    "packet_sync": "packet: bytes that begin no packet of the layout",
    "packet_crc": "packet: its CRC is not that of its bytes",
    "packet_length": "packet: its length does not fit the layout or its lists",
    "packet_segmented": "packet: a segment, not a whole packet",
    "match_index": "frame: a match points beyond the list of stars, or two at one star",
    CONFLICT: "frame: another version of it (more stars, then smaller content hash) is kept",
}


@dataclass(frozen=True)
class Rejection:
    """One record: ``rows`` telemetry rows from line ``row`` on, refused for one reason.

    ``raw`` are their bytes as the source has them, from ``offset`` of the decompressed source on.
    """

    row: int
    code: str
    detail: str
    raw: bytes
    offset: int = -1
    rows: int = 1
    sensor_id: str = ""
    frame_id: str = ""


@dataclass(frozen=True)
class LostVersion:
    """A version of a frame that another version of it displaced."""

    source: str
    source_sha256: str
    row: int
    rows: int
    sensor_id: str
    frame_id: int
    raw: bytes
    content_sha256: str


def write_source_part(
    store: Path,
    name: str,
    sha256: str,
    part: int,
    rejections: Sequence[Rejection],
    origin: Origin,
) -> Path:
    """Write one part of a source's quarantine atomically and return its path.

    A file known under two names keeps the first in the alphabet, whichever comes first.
    """
    path = _source_path(store, sha256, part)
    if path.exists():
        name = min([name, *read_file(path)["source"].to_pylist()[:1]])
    write_records(path, name, sha256, rejections, origin)
    return path


def write_records(
    path: Path, name: str, sha256: str, rejections: Sequence[Rejection], origin: Origin
) -> None:
    """Write the records of one source to a file, atomically and in the order of their rows."""
    ordered = sorted(rejections, key=lambda record: record.row)
    records = [
        {
            **vars(record),
            "source": name,
            "source_sha256": sha256,
            "length": len(record.raw),
            "detail": _encodable(record.detail),
        }
        for record in ordered
    ]
    parquet.write(path, pa.Table.from_pylist(records, schema=schema(origin)))


def paths(store: Place) -> list[Place]:
    """Return every quarantine file of a store."""
    return listed(store / FOLDER, "**/*.parquet")


def is_of_source(table: pa.Table, source: str | None) -> bool:
    """Whether a source's file is that of a source named by its name or its hash's beginning."""
    if source is None or not table.num_rows:
        return bool(table.num_rows)
    name, sha256 = table["source"][0].as_py(), table["source_sha256"][0].as_py()
    is_hash = len(source) >= SHORTEST_HASH and sha256.startswith(source.lower())
    return bool(name == source or is_hash)


def records_of(table: pa.Table) -> list[Rejection]:
    """Return the records of a source's file."""
    names = list(Rejection.__dataclass_fields__)
    return [Rejection(**row) for row in table.select(names).to_pylist()]


def source_parts(store: Path) -> list[Path]:
    """Return the files of the records of sources; those of displaced versions are not among them.

    Every one is read by itself: together they may not fit into memory.
    """
    return sorted((store / FOLDER).glob("*.parquet"))


def remove_other_parts(store: Path, sha256: str, kept: Iterable[Path]) -> None:
    """Remove what an earlier ingest of this source left that the latest one did not write."""
    known = set(kept)
    for path in (store / FOLDER).glob(f"{sha256}*.parquet"):
        if path not in known:
            path.unlink(missing_ok=True)


def conflicts_path(store: Path, sensor_folder: str, day: str) -> Path:
    """Return the file of the displaced versions of one sensor's day."""
    return store / FOLDER / "conflicts" / sensor_folder / f"day={day}.parquet"


def read_conflicts(path: Path) -> list[LostVersion]:
    """Return the displaced versions in a conflicts file; none when there is no file."""
    if not path.exists():
        return []
    names = LostVersion.__dataclass_fields__
    rows = [{k: row[k] for k in names} for row in read_file(path).to_pylist()]
    return [LostVersion(**{**row, "frame_id": int(row["frame_id"])}) for row in rows]


def write_conflicts(path: Path, lost: Iterable[LostVersion]) -> None:
    """Write a conflicts file atomically, in an order that depends on the content only."""
    ordered = sorted(lost, key=lambda version: (version.frame_id, version.content_sha256))
    detail = REASONS[CONFLICT].removeprefix("frame: ")
    records = [
        {
            **vars(version),
            "frame_id": str(version.frame_id),
            "offset": -1,
            "length": len(version.raw),
            "code": CONFLICT,
            "detail": detail,
        }
        for version in ordered
    ]
    parquet.write(path, pa.Table.from_pylist(records, schema=schema(Origin("jsonl"))))


def read_all(store: Place) -> pa.Table:
    """Return every quarantine record of a store."""
    found = map(read_file, paths(store))
    tables = [table.replace_schema_metadata(schema().metadata) for table in found]
    return pa.concat_tables([schema().empty_table(), *tables])


def _source_path(store: Path, sha256: str, part: int) -> Path:
    return store / FOLDER / (f"{sha256}-{part:04d}.parquet" if part else f"{sha256}.parquet")


def _encodable(text: str) -> str:
    return text.encode("utf-8", "backslashreplace").decode()
