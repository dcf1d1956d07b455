"""Lists of stars in the rows of frames, with vectorised checks that they fit each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from stcal.frames import Bools, Ints
from stcal.telemetry.arrow_texts import texts_of
from stcal.telemetry.mapped_values import as_lists, converted
from stcal.telemetry.mapping import ColumnMap, StarGroup
from stcal.telemetry.values import integers


def _listed(table: dict[str, Any], n: int, name: str, one: ColumnMap) -> tuple[Any, Ints]:
    """Return (texts, offsets) of a star column, indexed columns side by side as one list."""
    if one.columns is not None:
        parts = [texts_of(table[source], source) for source in one.sources]
        width = len(parts)
        place = np.arange(n * width).reshape(width, n).T.ravel()
        values = pa.concat_arrays(parts).take(pa.array(place))
        return converted(values, name, one), width * np.arange(n + 1)
    if one.column is None:
        return pa.repeat(str(one.value), 1), np.zeros(0, dtype=np.int64)
    values, offsets = as_lists(table[one.column], one.column)
    return converted(values, name, one), offsets


@dataclass(frozen=True)
class Stars:
    """Stars of one exposure, or with the exposure listed: texts, and the record of each."""

    columns: dict[str, Any]
    record: Ints


def unfold_group(table: dict[str, Any], n: int, group: StarGroup, bad: dict[int, str]) -> Stars:
    """Return the stars of a group; records whose lists do not fit go to ``bad``."""
    lists = {name: _listed(table, n, name, one) for name, one in group.maps.items()}
    counts = _counts(table, n, group, lists, bad)
    for name, (_, offsets) in lists.items():
        if len(offsets):
            lengths = np.diff(offsets)
            needs_all = group.count is None and group.maps[name].columns is None
            wrong = (lengths != counts) if needs_all else (lengths < counts)
            for i in np.flatnonzero(wrong).tolist():
                what = f"{name} has {lengths[i]} elements, {counts[i]} stars are listed"
                bad.setdefault(i, what)
    counts = np.where(np.isin(np.arange(n), list(bad)), 0, counts)
    record = np.repeat(np.arange(n), counts)
    within = np.arange(len(record)) - np.repeat(np.cumsum(counts) - counts, counts)
    columns = {}
    for name, (texts, offsets) in lists.items():
        place = offsets[record] + within if len(offsets) else np.zeros(len(record), dtype=np.int64)
        columns[name] = texts.take(pa.array(place))
    if isinstance(group.exposure, int):
        columns["exposure"] = pa.repeat(str(group.exposure), len(record))
    return Stars(columns, record)


def _counts(
    table: dict[str, Any],
    n: int,
    group: StarGroup,
    lists: dict[str, tuple[Any, Ints]],
    bad: dict[int, str],
) -> Ints:
    """Return (n,) how many stars each record lists."""
    if group.count is not None:
        texts = pc.utf8_trim_whitespace(texts_of(table[group.count], group.count).fill_null(""))
        count, wrong = integers(texts)
        wrong = (wrong & ~_is_blank(texts)) | (count < 0)
        for i in np.flatnonzero(wrong).tolist():
            bad.setdefault(i, f"{group.count} is {texts[i].as_py()!r}, not a number of stars")
        return np.where(wrong, 0, count)
    if group.row_px.columns is None:
        return np.diff(lists["row_px"][1])
    counts = np.zeros(n, dtype=np.int64)
    for name in ("row_px", "col_px"):
        texts, offsets = lists[name]
        there = np.flatnonzero(~_is_blank(texts.fill_null("")))
        record = np.searchsorted(offsets, there, side="right") - 1
        np.maximum.at(counts, record, there - offsets[record] + 1)
    return counts


def _is_blank(texts: Any) -> Bools:
    blank = pc.equal(pc.utf8_trim_whitespace(texts), "")
    return np.asarray(blank.to_numpy(zero_copy_only=False), dtype=np.bool_)
