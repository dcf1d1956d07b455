"""The Parquet store: ``frames/sensor=<id>/day=<UTC day>/frames.parquet``, one row a frame.

Each fragment is replaced in one step, so a reader and a kill at any moment find a whole store.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import date
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any, TextIO
from urllib.parse import unquote

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from stcal import atomic
from stcal.errors import InputError
from stcal.execution import OrderedMap, serial
from stcal.frames import FrameBatch, Ints, concatenate
from stcal.reading import read_json_object
from stcal.telemetry import parquet, quarantine
from stcal.telemetry.content import combined_sha256, day_digests
from stcal.telemetry.merge import Merge, merge
from stcal.telemetry.names import sensor_folder
from stcal.telemetry.quarantine import LostVersion
from stcal.telemetry.schema import (
    StoredFrames,
    batch_from_table,
    check_version,
    stored_from_table,
    table_from_stored,
)
from stcal.telemetry.undisturbed import Stamp, stamp_of, unchanged, undisturbed
from stcal.times import format_utc, parse_utc

SCHEMA = "stcal.store"
VERSION = 1
MARKER = "store.json"
FRAMES = "frames"
LOCK = ".lock"
# A fragment's frames: enough that a pass over it costs more than its start, few enough that some
# fit in memory together.
FEWEST_FRAMES, MAXIMUM_FRAMES = 256, 10_000
_FRAGMENTS = 128
_FRAGMENT = "frames.parquet"
_ROW_GROUP_FRAMES = 1_000
_DAY_NS = 86_400 * 1_000_000_000
_REMEDY = "; move it away and ingest its files again"


@dataclass(frozen=True)
class Fragment:
    """A cheap handle of consecutive frames of one sensor and day; picklable.

    ``first`` and ``n_frames`` count in the file, which had this ``stamp``.
    """

    path: Path
    sensor_id: str
    day: str
    first: int
    n_frames: int
    stamp: Stamp
    span_tai_ns: tuple[int, int]

    def read(self) -> FrameBatch:
        """Return the frames; raises as :func:`read_fragment`."""
        return read_fragment(self)


@dataclass(frozen=True)
class Store:
    """A store of telemetry on disk."""

    root: Path

    @staticmethod
    def open(path: Path, create: bool = False) -> Store:
        """Open a store, or make an empty one where there is none and ``create`` is set.

        Raises
        ------
        InputError
            There is none, the folder holds something else, or a newer stcal wrote it.
        """
        marker = path / MARKER
        if not _is_there(marker):
            if not create:
                raise InputError(f"{path}: no stcal store here ({MARKER} is missing)")
            _create(path)
        _check_marker(marker)
        return Store(path)

    def sensors(self) -> list[str]:
        """Return the sensors that the store has frames of, sorted."""
        folders = (self.root / FRAMES).glob("sensor=*")
        # A writer that was killed may have left a day's folder without its file.
        filled = (f.name for f in folders if any(f.glob(f"day=*/{_FRAGMENT}")))
        return sorted(unquote(name.removeprefix("sensor=")) for name in filled)

    def files(self, sensor_id: str) -> list[Path]:
        """Return the files with frames of a sensor, by day; none when there are none."""
        return self._days(sensor_id)

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
        days = []
        with undisturbed(self.root, self.root / LOCK):
            for path in self._days(sensor_id):
                if _may_overlap(path, start_tai_ns, stop_tai_ns):
                    stamp, times = stamp_of(path), _times(path)
                    first, last = _within(times, start_tai_ns, stop_tai_ns)
                    if first < last:
                        days.append((path, stamp, times, first, last))
        if not days:
            raise InputError(self._nothing(sensor_id, start_tai_ns, stop_tai_ns))
        most = maximum_frames or _share(sum(last - first for *_, first, last in days))
        return [part for day in days for part in _split(sensor_id, *day, most)]

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
        path = self._folder(sensor_id) / f"day={day}" / _FRAGMENT
        if not path.exists():
            return None
        table = _read(path)
        with _decoding(path):
            return stored_from_table(table, sensor_id)

    def read_lost(self, sensor_id: str, day: str) -> list[LostVersion]:
        """Return the displaced versions of one sensor and UTC day."""
        return quarantine.read_conflicts(
            quarantine.conflicts_path(self.root, sensor_folder(sensor_id), day)
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
        self._check_there()
        if set(after[1]) != set(before[1]):
            conflicts = quarantine.conflicts_path(self.root, sensor_folder(sensor_id), day)
            quarantine.write_conflicts(conflicts, after[1])
        table = table_from_stored(after[0])
        if before[0] is None or not table.equals(table_from_stored(before[0])):
            path = self._folder(sensor_id) / f"day={day}" / _FRAGMENT
            parquet.write(path, table, row_group_size=_ROW_GROUP_FRAMES)

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Hold the store for writing, and clear what a killed writer left.

        Raises
        ------
        InputError
            Another process holds it (the message has its number), or it cannot be written.
        """
        with self._open_lock() as stream:
            try:
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                stream.seek(0)
                owner = stream.read().strip() or "unknown"
                raise InputError(
                    f"{self.root}: process {owner} is writing to this store; wait for its end"
                ) from None
            stream.truncate(0)
            stream.write(str(os.getpid()))
            stream.flush()
            self._clear()
            try:
                yield
                self._check_there()
            finally:
                stream.truncate(0)

    def _clear(self) -> None:
        """Remove what a killed writer left; refuse links, which lead writers out of the store."""
        for folder, folders, names in os.walk(self.root):
            links = [name for name in folders if os.path.islink(os.path.join(folder, name))]
            if links:
                raise InputError(
                    f"{Path(folder) / links[0]}: a symbolic link to a folder; a store is written "
                    "only within its own folder"
                )
            for name in names:
                if name.startswith(atomic.TEMPORARY_PREFIX):
                    Path(folder, name).unlink(missing_ok=True)

    def _check_there(self) -> None:
        """Refuse to go on with a store that was moved or removed: its files would be strays."""
        if not (self.root / MARKER).exists():
            raise InputError(f"{self.root}: the store was moved or removed while it was written")

    def _open_lock(self) -> TextIO:
        path = self.root / LOCK
        try:
            # Not through a link: what it points to would be emptied.
            handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
            return os.fdopen(handle, "r+")
        except OSError as error:
            raise InputError(
                f"{self.root / LOCK}: the store cannot be locked for writing: {error.strerror}"
            ) from None

    def _folder(self, sensor_id: str) -> Path:
        return self.root / FRAMES / sensor_folder(sensor_id)

    def _days(self, sensor_id: str) -> list[Path]:
        return sorted(self._folder(sensor_id).glob(f"day=*/{_FRAGMENT}"))

    def _nothing(self, sensor_id: str, start: int | None, stop: int | None) -> str:
        days = self._days(sensor_id)
        if not days:
            known = ", ".join(self.sensors()) or "none"
            return f"{self.root}: no frames of sensor {sensor_id!r}; sensors in the store: {known}"
        limits = ("" if t is None else format_utc(t) for t in (start, stop))
        first, last = (path.parent.name.removeprefix("day=") for path in (days[0], days[-1]))
        return (
            f"{self.root}: no frames of sensor {sensor_id!r} in [{', '.join(limits)}); "
            f"it has frames from {first} to {last}"
        )


def fragments_sha256(
    sensor_id: str, fragments: Sequence[Fragment], mapper: OrderedMap = serial
) -> str:
    """Return the content hash of fragments in time order, days being hashed beside each other."""
    days = [list(day) for _, day in groupby(fragments, key=lambda fragment: fragment.day)]
    digests: dict[str, str] = {}
    for found in mapper(_digests, days):
        digests |= found
    return combined_sha256(sensor_id, digests)


def _digests(day: list[Fragment]) -> dict[str, str]:
    return day_digests(map(read_fragment, day))


def read_fragment(fragment: Fragment) -> FrameBatch:
    """Return the frames of a fragment.

    Raises
    ------
    InputError
        Naming the file: it is damaged, or was rewritten since the handle was made.
    """
    path = fragment.path
    with unchanged(path, fragment.stamp), _reading(path) as file:
        groups, skipped = _row_groups(file, fragment.first, fragment.first + fragment.n_frames)
        table = file.read_row_groups(groups).slice(fragment.first - skipped, fragment.n_frames)
    with _decoding(path):
        return batch_from_table(table, fragment.sensor_id)


def _row_groups(file: pq.ParquetFile, first: int, stop: int) -> tuple[list[int], int]:
    """Return the row groups that hold rows [first, stop), and the rows before them."""
    sizes = [file.metadata.row_group(i).num_rows for i in range(file.num_row_groups)]
    ends = np.cumsum(sizes)
    low, high = np.searchsorted(ends, [first, stop - 1], side="right").tolist()
    return list(range(low, high + 1)), int(ends[low] - sizes[low])


def _times(path: Path) -> Ints:
    with _reading(path) as file:
        times: Ints = file.read(["t_tai_ns"])["t_tai_ns"].to_numpy()
    _check_order(path, times)
    return times


def _within(times: Ints, start: int | None, stop: int | None) -> tuple[int, int]:
    """Return the range of frames with start <= t < stop."""
    first = 0 if start is None else int(np.searchsorted(times, start))
    return first, len(times) if stop is None else int(np.searchsorted(times, stop))


def _share(frames: int) -> int:
    """Return the most frames of a fragment, by their number alone, so that results are too."""
    return min(max(frames // _FRAGMENTS, FEWEST_FRAMES), MAXIMUM_FRAMES)


def _split(
    sensor_id: str, path: Path, stamp: Stamp, times: Ints, first: int, last: int, most: int
) -> list[Fragment]:
    edges = np.linspace(first, last, -(-(last - first) // most) + 1).astype(int).tolist()
    day = path.parent.name.removeprefix("day=")
    return [
        Fragment(
            path, sensor_id, day, low, high - low, stamp, (int(times[low]), int(times[high - 1]))
        )
        for low, high in pairwise(edges)
    ]


def _may_overlap(path: Path, start: int | None, stop: int | None) -> bool:
    """Whether a day's folder can hold frames of [start, stop); spares opening the others."""
    day = path.parent.name.removeprefix("day=")
    try:
        begin = parse_utc(f"{date.fromisoformat(day).isoformat()}T00:00:00Z")
    except ValueError:
        raise InputError(f"{path}: {day!r} is not a day") from None
    end = begin + _DAY_NS + 1_000_000_000  # a day may have a leap second
    return (stop is None or begin < stop) and (start is None or end > start)


@contextmanager
def _reading(path: Path) -> Iterator[pq.ParquetFile]:
    with parquet.reading(path, "fragment", _REMEDY) as file:
        check_version(file.schema_arrow, str(path))
        yield file


@contextmanager
def _decoding(path: Path) -> Iterator[None]:
    """Name the file whose content turns out not to be what ingest writes."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: damaged fragment: {error}{_REMEDY}") from None


def _check_order(path: Path, times: Ints) -> None:
    """Refuse a fragment that is not in time order: time ranges are found by bisection."""
    if np.any(times[1:] < times[:-1]):
        raise InputError(f"{path}: damaged fragment: not in the order of time{_REMEDY}")


def _read(path: Path) -> pa.Table:
    with _reading(path) as file:
        table = file.read()
    _check_order(path, table["t_tai_ns"].to_numpy())
    return table


def _is_there(marker: Path) -> bool:
    try:
        marker.stat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    except OSError as error:
        raise InputError(f"{marker}: cannot be read: {error.strerror}") from None
    return True


def _create(path: Path) -> None:
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: is not a folder")
    marker = path / MARKER
    filled = path.is_dir() and any(not child.name.startswith(".") for child in path.iterdir())
    if filled and not _is_there(marker):  # another process may just have made the store
        raise InputError(f"{path}: is neither a store nor empty; name another folder")
    document: dict[str, Any] = {"schema": SCHEMA, "version": VERSION}
    parquet.make_folder(path)
    try:
        atomic.write_text(marker, json.dumps(document) + "\n")
    except FileNotFoundError:
        if not _is_there(marker):  # else another one made it, and cleared away what this one wrote
            raise


def _check_marker(marker: Path) -> None:
    document = read_json_object(marker)
    schema, version = document.get("schema"), document.get("version")
    if schema != SCHEMA:
        raise InputError(f"{marker}: not the marker of a store: schema {schema!r}, not {SCHEMA!r}")
    if type(version) is not int or version < 1:  # true is an int too
        raise InputError(f"{marker}: store version {version!r} is not a version")
    if version > VERSION:
        raise InputError(
            f"{marker}: written with store version {version}, this stcal reads up to {VERSION}; "
            "use a newer stcal"
        )
