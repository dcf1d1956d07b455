"""The Parquet store: ``frames/sensor=<id>/day=<UTC day>/frames.parquet``, one row a frame.

Each fragment is replaced in one step, so a reader and a kill at any moment find a whole store.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pyarrow as pa

from stcal.errors import InputError
from stcal.frames import FrameBatch, concatenate
from stcal.telemetry import day_file, parquet, quarantine, store_lock, store_marker
from stcal.telemetry.fragments import DayTimes, Fragment, cut, fragments_sha256, read_fragment
from stcal.telemetry.merge import Merge, merge
from stcal.telemetry.names import sensor_folder
from stcal.telemetry.places import Place, listed, local_folder
from stcal.telemetry.quarantine import LostVersion
from stcal.telemetry.schema import StoredFrames, table_from_stored
from stcal.telemetry.undisturbed import stamp_of, undisturbed
from stcal.times import format_utc, parse_utc

FRAMES = "frames"
_FILES = f"{day_file.PREFIX}*/{day_file.NAME}"
_ROW_GROUP_FRAMES = 1_000
_DAY_NS = 86_400 * 1_000_000_000


@dataclass(frozen=True)
class Store:
    """A store of telemetry: in a folder, or at a URL for reading only."""

    root: Place

    @staticmethod
    def open(path: Place, create: bool = False) -> Store:
        """Open a store, or make an empty one where there is none and ``create`` is set.

        Raises
        ------
        InputError
            There is none, the folder holds something else, a newer stcal wrote it, or it is to be
            made at a URL.
        """
        if create and not store_marker.is_there(local_folder(path)):
            store_marker.create(local_folder(path))
        store_marker.check(path)
        return Store(path)

    @property
    def folder(self) -> Path:
        """The folder of a store that is to be written; raises InputError at a URL."""
        return local_folder(self.root)

    def sensors(self) -> list[str]:
        """Return the sensors that the store has frames of, sorted."""
        folders = listed(self.root / FRAMES, "sensor=*")
        # A writer that was killed may have left a day's folder without its file.
        filled = (f.name for f in folders if any(f.glob(_FILES)))
        return sorted(unquote(name.removeprefix("sensor=")) for name in filled)

    def files(self, sensor_id: str) -> list[Path]:
        """Return a folder's files with frames of a sensor, by day; none when there are none."""
        return [local_folder(path) for path in self._days(sensor_id)]

    def fragments(
        self,
        sensor_id: str,
        start_tai_ns: int | None = None,
        stop_tai_ns: int | None = None,
        maximum_frames: int | None = None,
    ) -> list[Fragment]:
        """Return handles of the frames with start <= t < stop, in time order.

        A day of more than ``maximum_frames`` selected frames is cut into nearly equal parts, the
        same ones whenever the store is the same.  By default the parts are such that their number
        is worth sharing among workers, and each of them fits easily in memory.

        Raises
        ------
        InputError
            Naming the store: the sensor is not in it, or has no frames in that time, or another
            process is writing to it; or naming a fragment that is damaged.
        """
        with undisturbed(self.root, store_lock.LOCK):
            found = [
                _within(path, start_tai_ns, stop_tai_ns)
                for path in self._days(sensor_id)
                if _may_overlap(path, start_tai_ns, stop_tai_ns)
            ]
        days = [day for day in found if day.first < day.stop]
        if not days:
            raise InputError(self._nothing(sensor_id, start_tai_ns, stop_tai_ns))
        return cut(sensor_id, days, maximum_frames)

    def read_frames(
        self, sensor_id: str, start_tai_ns: int | None = None, stop_tai_ns: int | None = None
    ) -> FrameBatch:
        """Return the frames with start <= t < stop as one batch; raises as :meth:`fragments`."""
        fragments = self.fragments(sensor_id, start_tai_ns, stop_tai_ns)
        return concatenate([read_fragment(fragment) for fragment in fragments])

    def sha256(
        self, sensor_id: str, start_tai_ns: int | None = None, stop_tai_ns: int | None = None
    ) -> str:
        """Return the content hash of the selected frames; their sources do not enter it."""
        fragments = self.fragments(sensor_id, start_tai_ns, stop_tai_ns)
        return fragments_sha256(sensor_id, fragments)

    def quarantine(self) -> pa.Table:
        """Return every quarantine record, in the schema of :mod:`stcal.telemetry.quarantine`."""
        return quarantine.read_all(self.root)

    def read_day(self, sensor_id: str, day: str) -> StoredFrames | None:
        """Return what the store has of one sensor and UTC day, None when nothing."""
        path = self._day(sensor_id, day)
        return day_file.read_stored(path, sensor_id) if path.exists() else None

    def read_lost(self, sensor_id: str, day: str) -> list[LostVersion]:
        """Return the displaced versions of one sensor and UTC day."""
        return quarantine.read_conflicts(
            quarantine.conflicts_path(self.folder, sensor_folder(sensor_id), day)
        )

    def merge_day(self, day: str, incoming: StoredFrames) -> Merge:
        """Merge frames of one sensor and UTC day into the store; the caller holds the lock."""
        sensor_id = incoming.frames.sensor_id
        stored, lost = self.read_day(sensor_id, day), self.read_lost(sensor_id, day)
        merged = merge(stored, lost, incoming)
        self.write_day(sensor_id, day, (stored, lost), (merged.kept, merged.lost))
        return merged

    def write_day(
        self,
        sensor_id: str,
        day: str,
        before: tuple[StoredFrames | None, list[LostVersion]],
        after: tuple[StoredFrames, list[LostVersion]],
    ) -> None:
        """Write a day's frames and displaced versions as far as they differ from ``before``.

        The displaced versions are on disk before the day that no longer has them.
        """
        store_lock.check_there(self.folder)
        if set(after[1]) != set(before[1]):
            conflicts = quarantine.conflicts_path(self.folder, sensor_folder(sensor_id), day)
            quarantine.write_conflicts(conflicts, after[1])
        table = table_from_stored(after[0])
        if before[0] is None or not table.equals(table_from_stored(before[0])):
            parquet.write(self._day(sensor_id, day), table, row_group_size=_ROW_GROUP_FRAMES)

    def lock(self) -> AbstractContextManager[None]:
        """Hold the store for writing; raises as :func:`stcal.telemetry.store_lock.held`."""
        return store_lock.held(self.folder)

    def _day(self, sensor_id: str, day: str) -> Path:
        days = self.folder / FRAMES / sensor_folder(sensor_id)
        return days / f"{day_file.PREFIX}{day}" / day_file.NAME

    def _days(self, sensor_id: str) -> list[Place]:
        return listed(self.root / FRAMES / sensor_folder(sensor_id), _FILES)

    def _nothing(self, sensor_id: str, start: int | None, stop: int | None) -> str:
        days = self._days(sensor_id)
        if not days:
            known = ", ".join(self.sensors()) or "none"
            return f"{self.root}: no frames of sensor {sensor_id!r}; sensors in the store: {known}"
        limits = ("" if t is None else format_utc(t) for t in (start, stop))
        first, last = map(day_file.day_of, (days[0], days[-1]))
        return (
            f"{self.root}: no frames of sensor {sensor_id!r} in [{', '.join(limits)}); "
            f"it has frames from {first} to {last}"
        )


def _within(path: Place, start: int | None, stop: int | None) -> DayTimes:
    """Select a day's frames with start <= t < stop."""
    stamp, times = stamp_of(path), day_file.read_times(path)
    first = 0 if start is None else int(np.searchsorted(times, start))
    end = len(times) if stop is None else int(np.searchsorted(times, stop))
    return DayTimes(path, stamp, times, first, end)


def _may_overlap(path: Place, start: int | None, stop: int | None) -> bool:
    """Whether a day's folder can hold frames of [start, stop); spares opening the others."""
    day = day_file.day_of(path)
    try:
        begin = parse_utc(f"{date.fromisoformat(day).isoformat()}T00:00:00Z")
    except ValueError:
        raise InputError(f"{path}: {day!r} is not a day") from None
    end = begin + _DAY_NS + 1_000_000_000  # a day may have a leap second
    return (stop is None or begin < stop) and (start is None or end > start)
