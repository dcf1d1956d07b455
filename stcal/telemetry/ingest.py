"""Ingest: downlink files to the store, file by file, window by window.

A window is what is read at a time: half a million rows.  At its end its quarantine is written, and
its frames join their days, which are written when enough has come together and at the end, each
file in one step; so a kill at any moment leaves a readable store, and running again ends in the
same one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stcal.config import SensorConfig
from stcal.errors import ConfigError, InputError
from stcal.frames import Ints
from stcal.telemetry import configurations, quarantine
from stcal.telemetry.ahead import ahead
from stcal.telemetry.assemble import Assembled, assemble
from stcal.telemetry.days import Days
from stcal.telemetry.decoders import choose, of_mapping
from stcal.telemetry.merge import Outcome
from stcal.telemetry.names import printable
from stcal.telemetry.quarantine import CONFLICT, Origin, Rejection
from stcal.telemetry.schema import StoredFrames
from stcal.telemetry.sensors import Sensors
from stcal.telemetry.sources import EXTENSIONS, SourceFile, examine, find_sources
from stcal.telemetry.store import Store
from stcal.telemetry.summary import IngestSummary, SourceSummary, unique
from stcal.telemetry.windows import Window, by_day, windows, with_source

if TYPE_CHECKING:
    from stcal.telemetry.mapping import SourceMapping
    from stcal.telemetry.packet_layout import PacketLayout

WINDOW_ROWS = 500_000
PACKET_EXTENSIONS = (".ccsds", ".ccsds.gz", ".bin", ".bin.gz", ".pkt", ".pkt.gz")
# Rows of the days being filled that may wait for more to come.
_WAITING_WINDOWS = 2

# (source, done files, all files), called before each file and after the last.
Progress = Callable[[str, int, int], None]


def ingest(
    sources: Sequence[Path],
    store: Store,
    configs: Sequence[SensorConfig],
    progress: Progress | None = None,
    window_rows: int = WINDOW_ROWS,
    packets: PacketLayout | None = None,
    mapping: SourceMapping | None = None,
    workers: int = 1,
) -> IngestSummary:
    """Read downlink files into the store.

    A file that cannot be used, or not whole, is reported in the summary and the others go on.  The
    configurations are recorded in the store, where later commands find them.

    Parameters
    ----------
    sources : files, and folders whose telemetry files are taken in the order of their names
    configs : which sensors are known, and what is valid for them
    packets : the layout of files that are no text, recorded in the store too
    mapping : the columns of the sources, which all are tables of that form
    workers : threads that read files ahead; the store and the summary don't depend on them

    Raises
    ------
    InputError
        The store is in use or damaged.
    ConfigError
        Several configurations apply to one sensor.
    """
    extensions = EXTENSIONS + (PACKET_EXTENSIONS if packets is not None else ())
    if mapping is not None:
        extensions = mapping.extensions
    files = find_sources(list(sources), extensions)
    readers = [partial(_read, path, configs, window_rows, packets, mapping) for path in files]
    summaries = []
    with store.lock():
        configurations.record(store.folder, configs)
        if packets is not None:
            configurations.record_layout(store.folder, packets)
        with (
            Days.filling(store, _WAITING_WINDOWS * window_rows) as days,
            ahead(readers, workers) as readings,
        ):
            for done, (path, reading) in enumerate(zip(files, readings, strict=True)):
                if progress is not None:
                    progress(printable(path.name), done, len(files))
                summaries.append(_take_in(path, reading, store, days))
    if progress is not None:
        progress("", len(files), len(files))
    share = min((config.ingest.maximum_quarantine_share for config in configs), default=0.0)
    return IngestSummary(tuple(summaries), share)


@dataclass(frozen=True)
class _Opened:
    """A file that can be used."""

    source: SourceFile
    origin: Origin


@dataclass(frozen=True)
class _Piece:
    """What a window holds: its frames, which of them belong to each day, and what was refused."""

    rejected: list[Rejection]
    frames: Assembled | None = None
    days: tuple[tuple[Ints, str, StoredFrames], ...] = ()


@dataclass(frozen=True)
class _Ended:
    """What is known of a file at its end; ``finished`` when it was read to there."""

    error: str | None = None
    warnings: tuple[str, ...] = ()
    packets: dict[str, Any] | None = None
    finished: bool = True


_Step = _Opened | _Piece | _Ended


def _read(
    path: Path,
    configs: Sequence[SensorConfig],
    window_rows: int,
    packets: PacketLayout | None,
    mapping: SourceMapping | None,
) -> Iterator[_Step]:
    """Yield what a file holds, without a look at the store; the last step is its end."""
    sensors, warnings = Sensors(configs), list[str]()
    foreign = None if mapping is None else of_mapping(mapping)
    try:
        source = examine(path, packets is None if foreign is None else foreign.text)
        decoder = choose(source, packets) if foreign is None else foreign
        yield _Opened(source, Origin(decoder.name, decoder.context(source)))
        for window in windows(decoder.decode(source, warnings.append), sensors, window_rows):
            yield _piece(window, source, sensors)
    except ConfigError:
        raise
    except InputError as error:
        yield _Ended(printable(str(error)), finished=False)
        return
    report = decoder.report() if decoder.report is not None else None
    cut = None
    if source.truncated:
        name = printable(path)
        cut = f"{name}: the gzip stream is cut; what it holds before the cut was taken"
    yield _Ended(cut, (*source.warnings, *warnings), report)


def _piece(window: Window, source: SourceFile, sensors: Sensors) -> _Piece:
    if not len(window.runs):
        return _Piece(window.rejected)
    frames = assemble(window.runs, window.stars)
    days = tuple(
        (which, day, with_source(frames, which, sensor_id, source))
        for which, sensor_id, day in by_day(frames, sensors)
    )
    return _Piece(window.rejected, frames, days)


def _take_in(path: Path, reading: Iterator[_Step], store: Store, days: Days) -> SourceSummary:
    """Write what a file holds; return what became of it."""
    summary = SourceSummary(Path(printable(path)))
    opened, parts = None, list[Path]()
    for number, step in enumerate(reading):
        match step:
            case _Opened():
                opened = step
                summary.sha256, summary.format = opened.source.sha256, opened.origin.format
            case _Piece():
                assert opened is not None
                # The step before the first window opened the file.
                parts += _refuse(step.rejected, number - 1, opened, store, summary)
                _keep(step, days, summary)
            case _Ended():
                _finish(step, opened, parts, store, summary)
    return summary


def _finish(
    end: _Ended, opened: _Opened | None, parts: list[Path], store: Store, summary: SourceSummary
) -> None:
    summary.error = end.error
    # A file that was not read to its end may have had more to refuse.
    if opened is None or not end.finished:
        return
    quarantine.remove_other_parts(store.folder, opened.source.sha256, parts)
    summary.packets = end.packets
    empty = ("the file holds no rows",) if summary.counts.rows == 0 else ()
    summary.warnings = unique([*end.warnings, *empty])


def _refuse(
    rejected: list[Rejection], number: int, opened: _Opened, store: Store, summary: SourceSummary
) -> list[Path]:
    """Write a window's quarantine; return the file written."""
    for record in rejected:
        summary.quarantined[record.code] += record.rows
    rows = sum(record.rows for record in rejected)
    summary.counts.rows += rows
    summary.counts.quarantined_rows += rows
    if not rejected:
        return []
    source = opened.source
    part = quarantine.write_source_part(
        store.folder, source.name, source.sha256, number, rejected, opened.origin
    )
    return [part]


def _keep(piece: _Piece, days: Days, summary: SourceSummary) -> None:
    """Merge a window's frames into their days."""
    for which, day, incoming in piece.days:
        assert piece.frames is not None
        outcome = days.merge(day, incoming)
        _count(summary, piece.frames, which, outcome)
        summary.sensors.add(incoming.frames.sensor_id)


def _count(summary: SourceSummary, frames: Assembled, which: Ints, outcome: Any) -> None:
    counts = summary.counts
    rows, copied_rows = frames.rows[which], frames.copied_rows[which]
    copies = int(frames.copies[which].sum())
    is_stored = (outcome == Outcome.NEW) | (outcome == Outcome.REPLACED)
    duplicate, conflict = outcome == Outcome.DUPLICATE, outcome == Outcome.CONFLICT
    lost_rows = int(rows[conflict].sum())
    counts.rows += int(rows.sum() + copied_rows.sum())
    counts.stored_rows += int(rows[is_stored].sum())
    counts.duplicate_rows += int(rows[duplicate].sum() + copied_rows.sum())
    counts.quarantined_rows += lost_rows
    summary.quarantined[CONFLICT] += lost_rows
    counts.frames += len(which) + copies
    counts.new_frames += int(np.count_nonzero(outcome == Outcome.NEW))
    counts.replaced_frames += int(np.count_nonzero(outcome == Outcome.REPLACED))
    counts.duplicate_frames += int(np.count_nonzero(duplicate)) + copies
    counts.conflicting_frames += int(np.count_nonzero(conflict))
    stars = frames.frames.take(which[is_stored])
    counts.stars += stars.n_stars
