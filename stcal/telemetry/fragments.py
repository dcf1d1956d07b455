"""Fragments: handles of consecutive frames of the store, the unit of work of every pass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise

import numpy as np

from stcal.execution import OrderedMap, serial
from stcal.frames import FrameBatch, Ints
from stcal.telemetry.content import combined_sha256, day_digests
from stcal.telemetry.day_file import day_of, read_rows
from stcal.telemetry.places import Place
from stcal.telemetry.undisturbed import Stamp, unchanged

# A fragment's frames: enough that a pass over it costs more than its start, few enough that some
# fit in memory together.
FEWEST_FRAMES, MAXIMUM_FRAMES = 256, 10_000
_FRAGMENTS = 128


@dataclass(frozen=True)
class Fragment:
    """A cheap handle of consecutive frames of one sensor and day; picklable.

    ``first`` and ``n_frames`` count in the file, which had this ``stamp``.
    """

    path: Place
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
class DayTimes:
    """Which frames of a day's file are selected.

    Attributes
    ----------
    stamp : the file's
    times : (F,) of all frames of the file, TAI ns, ascending
    first, stop : the selected ones
    """

    path: Place
    stamp: Stamp
    times: Ints
    first: int
    stop: int


def read_fragment(fragment: Fragment) -> FrameBatch:
    """Return the frames of a fragment.

    Raises
    ------
    InputError
        Naming the file: it is damaged, or was rewritten since the handle was made.
    """
    stop = fragment.first + fragment.n_frames
    with unchanged(fragment.path, fragment.stamp):
        return read_rows(fragment.path, fragment.sensor_id, fragment.first, stop)


def cut(sensor_id: str, days: Sequence[DayTimes], maximum_frames: int | None) -> list[Fragment]:
    """Cut each day into nearly equal fragments of at most ``maximum_frames``.

    By default by the number of selected frames alone, so that results depend on nothing else.
    """
    most = maximum_frames or _share(sum(day.stop - day.first for day in days))
    return [fragment for day in days for fragment in _split(sensor_id, day, most)]


def _share(frames: int) -> int:
    return min(max(frames // _FRAGMENTS, FEWEST_FRAMES), MAXIMUM_FRAMES)


def _split(sensor_id: str, day: DayTimes, most: int) -> list[Fragment]:
    parts = -(-(day.stop - day.first) // most)
    edges = np.linspace(day.first, day.stop, parts + 1).astype(int).tolist()
    times, name = day.times, day_of(day.path)
    return [
        Fragment(
            day.path, sensor_id, name, low, high - low, day.stamp,
            (int(times[low]), int(times[high - 1])),
        )
        for low, high in pairwise(edges)
    ]  # fmt: skip


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
