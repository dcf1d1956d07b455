"""Write frames as telemetry: CSV (long form) and JSON Lines, optionally gzip.

The bytes depend on the frames and arguments only (gzip without a time or a name).
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from stcal import atomic
from stcal.constants import EXPOSURES_PER_FRAME
from stcal.frames import Floats, FrameBatch, Ints
from stcal.telemetry.columns import COLUMNS, FLAGS, OPTIONAL_COLUMNS, STAR_COLUMNS, VECTORS
from stcal.telemetry.number_texts import number_texts
from stcal.telemetry.schema import star_id_texts
from stcal.times import format_utc_array

# Decimals of the columns that are not centroids; None everywhere writes what reads back exactly.
_DECIMALS = {
    "q_si": 9,
    "rate_deg_s": 7,
    "pos_km": 4,
    "vel_km_s": 7,
    "temperature_c": 3,
    "intensity": 2,
}
_COMPRESSION_LEVEL = 9
# The lines of a batch may exceed the 2 GiB of plain strings.
_TEXT = pa.large_string()
_COMMA = pa.scalar(",", _TEXT)


def write_csv(
    batches: Sequence[FrameBatch],
    path: Path,
    decimals: int | None = 4,
    first_pixel_centre_px: float = 0.0,
    compression_level: int = _COMPRESSION_LEVEL,
) -> None:
    """Write frames as telemetry CSV, gzip-compressed when the name ends in ``.gz``.

    Parameters
    ----------
    decimals : of the centroids; None writes every number so that it reads back exactly
    first_pixel_centre_px : the coordinate that the sensor gives to the centre of the first pixel
    compression_level : of gzip, 1 (fast) to 9 (small)
    """
    names = _column_names(batches)

    def fill(stream: BinaryIO) -> None:
        stream.write((",".join(names) + "\n").encode())
        for batch in batches:
            _write_lines(stream, _csv_lines(batch, names, decimals, first_pixel_centre_px))

    _write(path, fill, compression_level)


def write_jsonl(
    batches: Sequence[FrameBatch],
    path: Path,
    decimals: int | None = 4,
    first_pixel_centre_px: float = 0.0,
) -> None:
    """Write frames as JSON Lines; the arguments are those of :func:`write_csv`."""
    optional = any(_has_optional(batch) for batch in batches)

    def fill(stream: BinaryIO) -> None:
        for batch in batches:
            for document in _documents(batch, decimals, first_pixel_centre_px, optional):
                stream.write((json.dumps(document) + "\n").encode())

    _write(path, fill)


def write_attitudes(path: Path, t_tai_ns: Ints, q_bi: Floats, sd_urad: float) -> None:
    """Write a record of the body's attitude, as :mod:`stcal.telemetry.attitudes` reads it.

    ``q_bi`` (T, 4) is B relative to I, scalar last; its noise is ``sd_urad`` about every axis.
    """
    columns = [pa.array(format_utc_array(t_tai_ns).tolist(), pa.string())]
    columns += [number_texts(column, _DECIMALS["q_si"]) for column in q_bi.T]
    columns.append(pa.repeat(f"{sd_urad:g}", len(t_tai_ns)))
    lines = pc.binary_join_element_wise(*columns, ",").to_pylist()
    text = "\n".join(["time_utc,q_x,q_y,q_z,q_w,sd_urad", *lines]) + "\n"

    def fill(stream: BinaryIO) -> None:
        stream.write(text.encode())

    _write(path, fill)


def frame_json(batch: FrameBatch, index: int) -> str:
    """Return one frame as its JSON line, exact, centroids in the package's own convention."""
    one = batch.take(np.array([index]))
    return json.dumps(next(iter(_documents(one, None, 0.0, _has_optional(one)))))


def _write(path: Path, fill: Callable[[BinaryIO], None], level: int = _COMPRESSION_LEVEL) -> None:
    def compressed(stream: BinaryIO) -> None:
        with gzip.GzipFile("", "wb", level, stream, mtime=0) as packed:
            fill(packed)  # type: ignore[arg-type]

    atomic.write_with(path, compressed if path.suffix == ".gz" else fill)


def _has_optional(batch: FrameBatch) -> bool:
    state = np.isfinite(batch.pos_km).any() or np.isfinite(batch.vel_km_s).any()
    return bool(state or batch.eclipse.any() or batch.intrusion.any())


def _column_names(batches: Sequence[FrameBatch]) -> list[str]:
    optional = any(_has_optional(batch) for batch in batches)
    return [column.name for column in COLUMNS if column.required or optional]


def _csv_lines(batch: FrameBatch, names: Sequence[str], decimals: int | None, first: float) -> Any:
    """Return the lines as Arrow strings, one a row: a star, or a frame without stars.

    What a frame's rows have in common is joined once a frame: its columns before those of the
    stars, and those behind.
    """
    texts = {name: text.fill_null("") for name, text in _frame_texts(batch, decimals)}
    stars = [column.name for column in STAR_COLUMNS]
    first_star = names.index(stars[0])
    behind = names[first_star + len(stars) :]
    before = _joined([texts[name] for name in names[:first_star]])
    after = _joined([texts[name] for name in behind]) if behind else None

    counts = np.diff(batch.star_offsets[::EXPOSURES_PER_FRAME])
    rows = np.maximum(counts, 1)
    frame = pa.array(np.repeat(np.arange(batch.n_frames), rows))
    is_star = np.repeat(counts > 0, rows)
    place = pa.array(np.cumsum(is_star) - 1, mask=~is_star)
    columns = _star_texts(batch, decimals, first)
    parts = [before.take(frame)]
    parts += [columns[name].fill_null("").take(place).fill_null("") for name in stars]
    return _joined(parts if after is None else [*parts, after.take(frame)])


def _joined(columns: Sequence[Any]) -> Any:
    """Return the columns joined by commas."""
    return pc.binary_join_element_wise(*(pc.cast(c, _TEXT) for c in columns), _COMMA)


def _write_lines(stream: BinaryIO, lines: Any) -> None:
    """Write the lines, each with a newline, without making Python objects of them."""
    ended = pc.binary_join_element_wise(lines, pa.scalar("", _TEXT), pa.scalar("\n", _TEXT))
    text = ended.buffers()[2]
    if text is not None:
        stream.write(text)


def _star_texts(batch: FrameBatch, decimals: int | None, first: float) -> dict[str, Any]:
    exposure = batch.exposure_of_star % EXPOSURES_PER_FRAME
    return {
        "exposure": pc.cast(pa.array(exposure), pa.string()),
        "row_px": number_texts(batch.row_px + first, decimals),
        "col_px": number_texts(batch.col_px + first, decimals),
        "intensity": number_texts(batch.intensity, _digits("intensity", decimals)),
        "star_id": star_id_texts(batch.star_id),
    }


def _frame_texts(batch: FrameBatch, decimals: int | None) -> Iterable[tuple[str, Any]]:
    yield "sensor_id", pa.repeat(_quoted(batch.sensor_id), batch.n_frames)
    yield "frame_id", pc.cast(pa.array(batch.frame_id), pa.string())
    yield "time_utc", pa.array(format_utc_array(batch.t_tai_ns).tolist(), pa.string())
    best = pa.array(batch.best_exposure, mask=batch.best_exposure < 0)
    yield "best_exposure", pc.cast(best, pa.string())
    temperature = number_texts(batch.temperature_c, _digits("temperature_c", decimals))
    yield "temperature_c", temperature
    for name in FLAGS:
        yield name, pc.cast(pa.array(getattr(batch, name).astype(np.int8)), pa.string())
    for field, names in VECTORS.items():
        vector = getattr(batch, field)
        for i, name in enumerate(names):
            yield name, number_texts(vector[:, i], _digits(field, decimals))


def _digits(field: str, decimals: int | None) -> int | None:
    return None if decimals is None else _DECIMALS[field]


def _quoted(text: str) -> str:
    if any(character in text for character in ',"'):
        return '"' + text.replace('"', '""') + '"'
    return text


def _documents(
    batch: FrameBatch, decimals: int | None, first: float, optional: bool
) -> Iterable[dict[str, Any]]:
    """Yield the JSON document of every frame.  Not for hot paths: it makes an object a star."""
    times = format_utc_array(batch.t_tai_ns).tolist()
    star_columns = {
        "row_px": _rounded(batch.row_px + first, decimals),
        "col_px": _rounded(batch.col_px + first, decimals),
        "intensity": _rounded(batch.intensity, _digits("intensity", decimals)),
        "star_id": star_id_texts(batch.star_id).to_pylist(),
    }
    vectors = {name: _rounded(getattr(batch, name), _digits(name, decimals)) for name in VECTORS}
    temperature = _rounded(batch.temperature_c, _digits("temperature_c", decimals))
    for f in range(batch.n_frames):
        best = int(batch.best_exposure[f])
        document = {
            "sensor_id": batch.sensor_id,
            "frame_id": int(batch.frame_id[f]),
            "time_utc": times[f],
            "best_exposure": None if best < 0 else best,
            "quaternion": _vector(vectors["q_si"][f]),
            "rate_deg_s": _vector(vectors["rate_deg_s"][f]),
            "temperature_c": temperature[f],
            "exposures": _exposures(batch.star_offsets, f, star_columns),
        }
        if optional:
            values = [int(batch.eclipse[f]), int(batch.intrusion[f])]
            values += [*vectors["pos_km"][f], *vectors["vel_km_s"][f]]
            document |= dict(zip((c.name for c in OPTIONAL_COLUMNS), values, strict=True))
        yield document


def _exposures(offsets: Ints, frame: int, stars: dict[str, list[Any]]) -> list[dict[str, Any]]:
    """Return the exposures of one frame; one without detections has an empty list."""
    exposures = []
    for exposure in range(EXPOSURES_PER_FRAME):
        e = EXPOSURES_PER_FRAME * frame + exposure
        inside = range(int(offsets[e]), int(offsets[e + 1]))
        listed = [{name: column[s] for name, column in stars.items()} for s in inside]
        exposures.append({"exposure": exposure, "stars": listed})
    return exposures


def _rounded(values: Floats, decimals: int | None) -> list[Any]:
    rounded = values if decimals is None else np.round(values, decimals)
    listed = rounded.astype(object)
    listed[np.isnan(rounded)] = None
    return list(listed.tolist())


def _vector(values: list[float | None]) -> list[float | None] | None:
    return None if all(value is None for value in values) else values
