"""Retry: decode what is in quarantine again, with the present configuration.

What is good now goes into the store and leaves the quarantine; the rest stays, for the reason that
holds now.  Frames are in the store before their records leave, so a kill at any moment loses
nothing, and trying again ends in the same store.  Displaced versions are not tried: which version
of a frame is kept does not depend on a configuration.

The store ends as ingesting the source again would leave it, but for a frame in pieces that names a
star twice in an exposure: how such a frame is cut apart (``assemble``) depends on which of its rows
are known at the time.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from stcal.config import SensorConfig
from stcal.errors import InputError
from stcal.frames import Ints
from stcal.telemetry import configurations, quarantine
from stcal.telemetry.assemble import assemble
from stcal.telemetry.block import Again, RowBlock
from stcal.telemetry.decoders import AGAIN
from stcal.telemetry.merge import Outcome
from stcal.telemetry.ordering import excess_of
from stcal.telemetry.quarantine import TIME_BACKWARDS, TRUNCATED, Origin, Rejection
from stcal.telemetry.rejoin import with_stored
from stcal.telemetry.sensors import Sensors
from stcal.telemetry.sources import SourceFile, from_memory
from stcal.telemetry.store import Store
from stcal.telemetry.summary import by_reason
from stcal.telemetry.validate import validate
from stcal.telemetry.windows import Window, by_day, join, with_source


@dataclass
class SourceRetry:
    """What became of one source's records; counts are of telemetry rows.

    Attributes
    ----------
    refused, kept : rows in quarantine before and after; ``reasons`` are those of the kept ones
    frames : frames that were new to the store, or better than the version it had
    note : why nothing of the source was tried; None when it was
    """

    source: str
    sha256: str
    refused: int = 0
    kept: int = 0
    frames: int = 0
    reasons: Counter[str] = field(default_factory=Counter)
    note: str | None = None

    def document(self) -> dict[str, Any]:
        """Return the counts as a JSON document."""
        return {
            "source": self.source,
            "sha256": self.sha256,
            "refused_rows": self.refused,
            "taken_rows": self.refused - self.kept,
            "kept_rows": self.kept,
            "frames": self.frames,
            "reasons": by_reason(self.reasons),
            "note": self.note,
        }


def retry(
    store: Store, configs: Sequence[SensorConfig] | None = None, source: str | None = None
) -> list[SourceRetry]:
    """Try the records of every source again, or those of one source.

    Parameters
    ----------
    configs : the configurations to use from now on, recorded in the store; those that it has
        recorded if None
    source : a file's name, or the beginning of its hash

    Raises
    ------
    InputError
        The store is in use or damaged.
    """
    with store.lock():
        if configs is not None:
            configurations.record(store.folder, configs)
        used = configurations.recorded(store.folder)
        done: dict[str, SourceRetry] = {}
        for path in quarantine.source_parts(store.folder):
            table = quarantine.read_file(path)
            if quarantine.is_of_source(table, source):
                _retry_part(path, table, store, used, done)
    return list(done.values())


def _retry_part(
    path: Path,
    table: pa.Table,
    store: Store,
    configs: Sequence[SensorConfig],
    done: dict[str, SourceRetry],
) -> None:
    name, sha256 = table["source"][0].as_py(), table["source_sha256"][0].as_py()
    result = done.setdefault(sha256, SourceRetry(name, sha256))
    records = quarantine.records_of(table)
    result.refused += sum(record.rows for record in records)
    origin = quarantine.origin_of(table, path)
    sensors, source = Sensors(configs), from_memory(name, sha256, b"")
    stays = _not_to_try(records, sensors)
    tried = [record for record, stay in zip(records, stays, strict=True) if not stay]
    try:
        blocks = list(_blocks(tried, _again(origin), source))
    except InputError as error:
        # A record of another stcal, or a mapping that this one doesn't know: it stays as it is.
        result.note, kept = str(error), records
    else:
        kept = [record for record, stay in zip(records, stays, strict=True) if stay]
        kept += _take(blocks, source, store, sensors, configs, result)
        kept.sort(key=lambda record: record.row)
    result.kept += sum(record.rows for record in kept)
    for record in kept:
        result.reasons[record.code] += record.rows
    if not kept:
        path.unlink()
    elif kept != records and origin is not None:
        quarantine.write_records(path, name, sha256, kept, origin)


def _again(origin: Origin | None) -> Again:
    if origin is None:
        raise InputError("kept by an older stcal without its bytes; ingest the file again")
    if origin.format not in AGAIN:
        raise InputError(f"its format {origin.format!r} is not known to this stcal")
    return AGAIN[origin.format](origin.context)


def _take(
    blocks: list[RowBlock],
    source: SourceFile,
    store: Store,
    sensors: Sensors,
    configs: Sequence[SensorConfig],
    result: SourceRetry,
) -> list[Rejection]:
    """Store what is good now and return what is refused again."""
    good = join([Window(*validate(block, sensors)) for block in blocks])
    if len(good.runs):
        plain = Sensors([_first_pixel_at_zero(config) for config in configs])
        runs, stars = with_stored(good.runs, good.stars, store, sensors, plain, source.sha256)
        frames = assemble(runs, stars)
        for which, sensor_id, day in by_day(frames, sensors):
            outcome = store.merge_day(day, with_source(frames, which, sensor_id, source)).outcome
            result.frames += int(np.isin(outcome, (Outcome.NEW, Outcome.REPLACED)).sum())
    return good.rejected


def _first_pixel_at_zero(config: SensorConfig) -> SensorConfig:
    detector = config.detector.model_copy(update={"first_pixel_centre_px": 0.0})
    return config.model_copy(update={"detector": detector})


def _not_to_try(records: Sequence[Rejection], sensors: Sensors) -> list[bool]:
    """Return which records stay whatever they decode to, with all others of their frames.

    A cut row cannot be made whole, and a time that its neighbours contradict is judged by the
    measure that was taken of it, since the neighbours are not here.
    """
    index, _ = sensors.look_up(pa.array([record.sensor_id for record in records], pa.string()))
    frames = {
        (record.sensor_id, record.frame_id)
        for record, sensor in zip(records, index.tolist(), strict=True)
        if (record.code == TRUNCATED and record.sensor_id)
        or (
            record.code == TIME_BACKWARDS
            and excess_of(record) > sensors.maximum_backwards_s[sensor]
        )
    }
    return [(r.sensor_id, r.frame_id) in frames or r.code == TRUNCATED for r in records]


def _blocks(records: list[Rejection], again: Again, source: SourceFile) -> Iterator[RowBlock]:
    """Yield the rows that the records' bytes decode to, at their places in the source."""
    # Several records may hold one line.
    pieces = list({(record.row, record.offset): record for record in records}.values())
    for group in [[piece] for piece in pieces] if again.one_by_one else [pieces] * bool(pieces):
        content = again.prefix + again.separator
        content += b"".join(piece.raw + again.separator for piece in group)
        whole = from_memory(source.name, source.sha256, content)
        places = _Places(group, len(again.prefix) + len(again.separator), len(again.separator))
        for block in again.decode(whole, lambda _: None):
            yield places.moved_back(block)


class _Places:
    """Where pieces are among the bytes decoded again, and where they were in their source."""

    def __init__(self, pieces: list[Rejection], first: int, separator: int) -> None:
        self._raw = [piece.raw for piece in pieces]
        length = np.array([len(piece.raw) for piece in pieces], dtype=np.int64)
        self._start = first + np.cumsum(length + separator) - length - separator
        self._offset = np.array([piece.offset for piece in pieces], dtype=np.int64)
        self._row = np.array([piece.row for piece in pieces], dtype=np.int64)
        # Pieces with nothing but line ends between them stood side by side in the source.
        gap = np.diff(self._offset) - length[:-1]
        apart = np.where(
            self._offset[1:] >= 0, gap > 2 * np.diff(self._row), np.diff(self._row) > 1
        )
        self._stretch = np.concatenate(([0], np.cumsum(apart)))

    def moved_back(self, block: RowBlock) -> RowBlock:
        """Return a block with the rows, offsets and runs that it has in the source."""
        piece = self._piece(block.row, block.offset)
        run = block.run
        if len(block) and not block.lines_are_frames:
            cut = (np.diff(block.run) != 0) | (np.diff(self._stretch[piece]) != 0)
            run = np.concatenate(([0], np.cumsum(cut)))
        return replace(
            block,
            raw=lambda i: block.raw(i) if block.offset[i] >= 0 else self._raw[piece[i]],
            row=self._row[piece],
            offset=self._at(piece, block.offset),
            run=run,
            rejected=[self._record(record) for record in block.rejected],
        )

    def _record(self, record: Rejection) -> Rejection:
        offset = np.array([record.offset])
        piece = self._piece(np.array([record.row]), offset)
        raw = record.raw if record.offset >= 0 else self._raw[int(piece[0])]
        row, moved = int(self._row[piece[0]]), int(self._at(piece, offset)[0])
        return replace(record, row=row, offset=moved, raw=raw)

    def _piece(self, row: Ints, offset: Ints) -> Ints:
        """Return the piece of each place; records without an offset are a row each."""
        by_offset = np.searchsorted(self._start, offset, side="right") - 1
        return np.asarray(np.where(offset >= 0, by_offset, row - 1))

    def _at(self, piece: Ints, offset: Ints) -> Ints:
        moved = self._offset[piece] + offset - self._start[piece]
        return np.asarray(np.where((offset >= 0) & (self._offset[piece] >= 0), moved, -1))
