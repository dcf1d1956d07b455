"""One sensor's day in the store, a Parquet file: opened and decoded with its checks.

Every failure names the file, and what to do about one that is damaged.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pyarrow.parquet as pq

from stcal.errors import InputError
from stcal.frames import FrameBatch, Ints
from stcal.telemetry import parquet
from stcal.telemetry.places import Place
from stcal.telemetry.schema import (
    StoredFrames,
    batch_from_table,
    check_version,
    stored_from_table,
)

NAME = "frames.parquet"
PREFIX = "day="
_REMEDY = "; move it away and ingest its files again"


def day_of(path: Place) -> str:
    """Return the UTC day that a file is of, as its folder names it."""
    return path.parent.name.removeprefix(PREFIX)


def read_times(path: Place) -> Ints:
    """Return the times of all frames of a day (F,), TAI ns.

    Raises
    ------
    InputError
        Naming the file: it is damaged, or not in the order of time.
    """
    with _reading(path) as file:
        times: Ints = file.read(["t_tai_ns"])["t_tai_ns"].to_numpy()
    _check_order(path, times)
    return times


def read_stored(path: Place, sensor_id: str) -> StoredFrames:
    """Return all frames of a day with their sources; raises as :func:`read_times`."""
    with _reading(path) as file:
        table = file.read()
    _check_order(path, table["t_tai_ns"].to_numpy())
    with _decoding(path):
        return stored_from_table(table, sensor_id)


def read_rows(path: Place, sensor_id: str, first: int, stop: int) -> FrameBatch:
    """Return the frames [first, stop) of a day; raises as :func:`read_times`."""
    with _reading(path) as file:
        groups, skipped = _row_groups(file, first, stop)
        table = file.read_row_groups(groups).slice(first - skipped, stop - first)
    with _decoding(path):
        return batch_from_table(table, sensor_id)


def _row_groups(file: pq.ParquetFile, first: int, stop: int) -> tuple[list[int], int]:
    """Return the row groups that hold rows [first, stop), and the rows before them."""
    sizes = [file.metadata.row_group(i).num_rows for i in range(file.num_row_groups)]
    ends = np.cumsum(sizes)
    low, high = np.searchsorted(ends, [first, stop - 1], side="right").tolist()
    return list(range(low, high + 1)), int(ends[low] - sizes[low])


@contextmanager
def _reading(path: Place) -> Iterator[pq.ParquetFile]:
    with parquet.reading(path, "fragment", _REMEDY) as file:
        check_version(file.schema_arrow, str(path))
        yield file


@contextmanager
def _decoding(path: Place) -> Iterator[None]:
    """Name the file whose content turns out not to be what ingest writes."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{path}: damaged fragment: {error}{_REMEDY}") from None


def _check_order(path: Place, times: Ints) -> None:
    """Refuse a file that is not in time order: time ranges are found by bisection."""
    if np.any(times[1:] < times[:-1]):
        raise InputError(f"{path}: damaged fragment: not in the order of time{_REMEDY}")
