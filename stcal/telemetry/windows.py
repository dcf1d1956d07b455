"""Windows of a file: the rows that are held in memory together, and the frames they make."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stcal.frames import Bools, Ints
from stcal.telemetry.assemble import Assembled
from stcal.telemetry.ordering import Validated, in_order
from stcal.telemetry.quarantine import Rejection
from stcal.telemetry.schema import StoredFrames
from stcal.telemetry.sensors import Sensors
from stcal.telemetry.sources import SourceFile
from stcal.telemetry.validate import RUN, STAR, validate
from stcal.times import utc_day

# Frames of a window's last rows wait for the next one: rows of a frame are joined when they lie
# within this distance, or in one window.
HELD_ROWS = 20_000
# What a refused row takes until it is written, in rows that are kept; its line adds to that.
_REFUSED_ROWS, _RAW_BYTES_A_ROW = 4, 256


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
        refused = sum(
            _REFUSED_ROWS + len(record.raw) // _RAW_BYTES_A_ROW for record in self.rejected
        )
        return len(self.stars) + len(self.runs) + refused


def windows(blocks: Iterator[Any], sensors: Sensors, window_rows: int) -> Iterator[Window]:
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
