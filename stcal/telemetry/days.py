"""The days that an ingest is filling, kept in memory so that each is written a few times only.

Downloads come window by window and file by file, dozens of them a day; merging each into its day
on disk would rewrite a growing file every time.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from stcal.telemetry.merge import merge
from stcal.telemetry.quarantine import LostVersion
from stcal.telemetry.schema import StoredFrames, join
from stcal.telemetry.store import Store

Key = tuple[str, str]


@dataclass
class _Day:
    """One sensor and UTC day: as it is on disk, and as it will be, in parts one after another."""

    stored: StoredFrames | None
    stored_lost: list[LostVersion]
    parts: list[StoredFrames] = field(default_factory=list)
    lost: list[LostVersion] = field(default_factory=list)

    @property
    def rows(self) -> int:
        """About how many rows take as much memory."""
        return sum(part.frames.n_frames + part.frames.n_stars for part in self.parts)

    def merge(self, incoming: StoredFrames) -> Any:
        """Take in frames; return the outcome of each."""
        times = incoming.frames.t_tai_ns
        follows = self.parts and times.min() > self.parts[-1].frames.t_tai_ns[-1]
        before = None if follows or not self.parts else join(self.parts)
        merged = merge(before, self.lost, incoming)
        self.parts = [*self.parts, merged.kept] if follows else [merged.kept]
        self.lost = merged.lost
        return merged.outcome


class Days:
    """The days being filled, by sensor and UTC day."""

    def __init__(self, store: Store, maximum_rows: int) -> None:
        """Keep about so many rows before days are written; the caller holds the store's lock."""
        self._store, self._maximum_rows = store, maximum_rows
        self._days: dict[Key, _Day] = {}

    @staticmethod
    @contextmanager
    def filling(store: Store, maximum_rows: int) -> Iterator[Days]:
        """Give the days, and write them at the end, whatever ends it."""
        days = Days(store, maximum_rows)
        try:
            yield days
        finally:
            days.flush()

    def merge(self, day: str, incoming: StoredFrames) -> Any:
        """Merge frames of one sensor and UTC day; return the (F,) outcome of each."""
        key = (incoming.frames.sensor_id, day)
        if key not in self._days:
            self._days[key] = self._read(*key)
        outcome = self._days[key].merge(incoming)
        if self._rows > self._maximum_rows:
            # The day that is being filled is likely to grow further.
            self._write([other for other in self._days if other != key])
        if self._rows > self._maximum_rows:
            self.flush()
        return outcome

    def flush(self) -> None:
        """Write every day that has changed."""
        self._write(list(self._days))

    @property
    def _rows(self) -> int:
        return sum(day.rows for day in self._days.values())

    def _read(self, sensor_id: str, day: str) -> _Day:
        stored = self._store.read_day(sensor_id, day)
        lost = self._store.read_lost(sensor_id, day)
        return _Day(stored, lost, [] if stored is None else [stored], lost)

    def _write(self, keys: list[Key]) -> None:
        for key in keys:
            day = self._days[key]
            self._store.write_day(*key, (day.stored, day.stored_lost), (join(day.parts), day.lost))
            del self._days[key]
