"""Ingest: downlink files to the store, file by file, window by window.

A window is what is held in memory: half a million rows.  At its end its quarantine is written
first, then its frames, each file in one step; so a kill at any moment leaves a readable store, and
running again ends in the same one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stcal.config import SensorConfig
from stcal.errors import ConfigError, InputError
from stcal.frames import Bools, Ints
from stcal.telemetry import configurations, quarantine
from stcal.telemetry.assemble import Assembled, assemble
from stcal.telemetry.block import Decoder
from stcal.telemetry.decoders import choose, of_mapping
from stcal.telemetry.merge import Outcome
from stcal.telemetry.names import printable
from stcal.telemetry.ordering import Validated, in_order
from stcal.telemetry.quarantine import CONFLICT, Origin, Rejection
from stcal.telemetry.schema import StoredFrames
from stcal.telemetry.sensors import Sensors
from stcal.telemetry.sources import EXTENSIONS, SourceFile, examine, find_sources
from stcal.telemetry.store import Store
from stcal.telemetry.summary import IngestSummary, SourceSummary, unique
from stcal.telemetry.validate import RUN, STAR, validate
from stcal.times import utc_day

if TYPE_CHECKING:
    from stcal.telemetry.mapping import SourceMapping
    from stcal.telemetry.packet_layout import PacketLayout

WINDOW_ROWS = 500_000
PACKET_EXTENSIONS = (".ccsds", ".ccsds.gz", ".bin", ".bin.gz", ".pkt", ".pkt.gz")
# Frames of a window's last rows wait for the next one: rows of a frame are joined when they lie
# within this distance, or in one window.
HELD_ROWS = 20_000
_RAW_BYTES_A_ROW = 256

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

    Raises
    ------
    InputError
        The store is in use or damaged.
    ConfigError
        Several configurations apply to one sensor.
    """
    sensors = Sensors(configs)
    extensions = EXTENSIONS + (PACKET_EXTENSIONS if packets is not None else ())
    if mapping is not None:
        extensions = mapping.extensions
    files = find_sources(list(sources), extensions)
    summaries = []
    with store.lock():
        configurations.record(store.root, configs)
        if packets is not None:
            configurations.record_layout(store.root, packets)
        for done, path in enumerate(files):
            if progress is not None:
                progress(printable(path.name), done, len(files))
            foreign = None if mapping is None else of_mapping(mapping)
            summaries.append(_ingest_file(path, store, sensors, window_rows, packets, foreign))
    if progress is not None:
        progress("", len(files), len(files))
    share = min((config.ingest.maximum_quarantine_share for config in configs), default=0.0)
    return IngestSummary(tuple(summaries), share)


def _ingest_file(
    path: Path,
    store: Store,
    sensors: Sensors,
    window_rows: int,
    packets: PacketLayout | None,
    foreign: Decoder | None,
) -> SourceSummary:
    summary = SourceSummary(Path(printable(path)))
    warnings: list[str] = []
    try:
        is_text = packets is None if foreign is None else foreign.text
        source = examine(path, is_text)
        decoder = choose(source, packets) if foreign is None else foreign
        origin = Origin(decoder.name, decoder.context(source))
        blocks = decoder.decode(source, warnings.append)
    except InputError as error:
        summary.error = printable(str(error))
        return summary
    summary.sha256, summary.format = source.sha256, decoder.name
    parts: list[Path] = []
    windows = _until_error(_windows(blocks, sensors, window_rows), summary)
    for number, window in enumerate(windows):
        parts += _commit(window, number, source, origin, store, sensors, summary)
    if summary.error is not None:
        return summary
    quarantine.remove_other_parts(store.root, source.sha256, parts)
    summary.packets = decoder.report() if decoder.report is not None else None
    if summary.counts.rows == 0:
        warnings.append("the file holds no rows")
    if source.truncated:
        summary.error = (
            f"{summary.path}: the gzip stream is cut; what it holds before the cut was taken"
        )
    summary.warnings = unique([*source.warnings, *warnings])
    return summary


def _until_error(windows: Iterator[Window], summary: SourceSummary) -> Iterator[Window]:
    """Yield windows until the file turns out not to be usable; the store's errors pass."""
    while True:
        try:
            window = next(windows, None)
        except ConfigError:
            raise
        except InputError as error:
            summary.error = printable(str(error))
            return
        if window is None:
            return
        yield window


@dataclass
class Window:
    """Rows in memory: good runs with their stars, and what was refused."""

    runs: Any = field(default_factory=lambda: np.empty(0, RUN))
    stars: Any = field(default_factory=lambda: np.empty(0, STAR))
    rejected: list[Rejection] = field(default_factory=list)

    @property
    def size(self) -> int:
        """About how many rows take as much memory."""
        # A record holds its line, which may be a whole frame.
        refused = sum(1 + len(record.raw) // _RAW_BYTES_A_ROW for record in self.rejected)
        return len(self.stars) + len(self.runs) + refused


def _windows(blocks: Iterator[Any], sensors: Sensors, window_rows: int) -> Iterator[Window]:
    """Yield windows; the frames of a window's last rows go on into the next."""
    parts: list[Window] = []
    validated = (Validated(block, *validate(block, sensors)) for block in blocks)
    for checked in in_order(validated, sensors):
        parts.append(Window(checked.runs, checked.stars, checked.rejected))
        if sum(part.size for part in parts) >= window_rows:
            done, held = _hold(join(parts))
            parts = [held]
            yield done
    yield join(parts)


def join(parts: list[Window]) -> Window:
    """Return the rows of all parts, the runs of their stars counted on."""
    if not parts:
        return Window()
    shift = np.cumsum([0, *(len(part.runs) for part in parts)])
    stars = np.concatenate([part.stars for part in parts])
    stars["run"] += np.repeat(shift[:-1], [len(part.stars) for part in parts])
    rejected = [record for part in parts for record in part.rejected]
    return Window(np.concatenate([part.runs for part in parts]), stars, rejected)


def _hold(window: Window) -> tuple[Window, Window]:
    """Split off the frames that the next window may have more rows of."""
    runs = window.runs
    recent = runs["row"] >= runs["row"].max(initial=0) - HELD_ROWS
    keys = runs[["sensor", "frame_id", "t_tai_ns"]]
    held = np.isin(_packed(keys), _packed(keys[recent])) & ~runs["alone"]
    if np.count_nonzero(held) > len(runs) // 2:
        held[:] = False  # memory stays bounded whatever the file's order
    return _select(window, ~held, window.rejected), _select(window, held, [])


def _packed(keys: Any) -> Any:
    whole = np.column_stack([keys[name].astype(np.int64) for name in keys.dtype.names])
    return np.ascontiguousarray(whole).view(np.dtype((np.void, 8 * whole.shape[1]))).ravel()


def _select(window: Window, runs: Bools, rejected: list[Rejection]) -> Window:
    stars = window.stars[runs[window.stars["run"]]]
    stars["run"] = (np.cumsum(runs) - 1)[stars["run"]]
    return Window(window.runs[runs], stars, rejected)


def _commit(
    window: Window,
    number: int,
    source: SourceFile,
    origin: Origin,
    store: Store,
    sensors: Sensors,
    summary: SourceSummary,
) -> list[Path]:
    """Write a window's quarantine, then its frames; return the quarantine files written."""
    parts = []
    if window.rejected:
        parts.append(
            quarantine.write_source_part(
                store.root, source.name, source.sha256, number, window.rejected, origin
            )
        )
    for record in window.rejected:
        summary.quarantined[record.code] += record.rows
    quarantined = sum(record.rows for record in window.rejected)
    summary.counts.rows += quarantined
    summary.counts.quarantined_rows += quarantined
    if len(window.runs):
        frames = assemble(window.runs, window.stars)
        for which, sensor_id, day in by_day(frames, sensors):
            incoming = with_source(frames, which, sensor_id, source)
            outcome = store.merge_day(day, incoming).outcome
            _count(summary, frames, which, outcome)
            summary.sensors.add(sensor_id)
    return parts


def by_day(frames: Assembled, sensors: Sensors) -> Iterator[tuple[Ints, str, str]]:
    """Yield the frames of every sensor and UTC day, in that order."""
    day = utc_day(frames.frames.t_tai_ns).astype(np.int64)
    order = np.lexsort((day, frames.sensor))
    changes = (np.diff(day[order]) != 0) | (np.diff(frames.sensor[order]) != 0)
    for which in np.split(order, np.flatnonzero(changes) + 1):
        name = sensors.names[int(frames.sensor[which[0]])]
        yield which, name, str(np.datetime64(int(day[which[0]]), "D"))


def with_source(frames: Assembled, which: Ints, sensor_id: str, source: SourceFile) -> StoredFrames:
    """Return the frames ``which`` of one sensor under its name, with where they came from."""
    n = len(which)
    return StoredFrames(
        frames.of_sensor(which, sensor_id),
        np.full(n, source.name, dtype=object),
        np.full(n, source.sha256, dtype=object),
        frames.row[which],
    )


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
