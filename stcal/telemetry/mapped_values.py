"""Values of foreign columns: as text in the telemetry's units, lists as elements and offsets."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from stcal.catalog.identifiers import decode
from stcal.errors import InputError
from stcal.frames import Ints
from stcal.telemetry.arrow_texts import texts_of
from stcal.telemetry.columns import UNITS
from stcal.telemetry.mapped_time import time_texts
from stcal.telemetry.mapping import CONVERSIONS, ColumnMap
from stcal.telemetry.values import integers, numbers

_LIST_KINDS = (pa.types.is_list, pa.types.is_large_list, pa.types.is_fixed_size_list)
_BRACKETS = r"^\s*[\[({]?|[\])}]?\s*$"


def converted(column: Any, name: str, one: ColumnMap) -> Any:
    """Return a column as the text of the telemetry column ``name``."""
    if one.empty:
        texts = texts_of(column, one.column or name)
        is_empty = pc.is_in(texts, pa.array(one.empty, pa.string()))
        column = pc.if_else(is_empty, pa.scalar(None, column.type), column)
    if name == "time_utc":
        return time_texts(column, one, one.column or name)
    texts = texts_of(column, one.column or one.columns or name)
    if name == "star_id":
        return _identifiers(texts, one)
    if one.scale is None and one.offset is None and one.unit in (None, UNITS[name]):
        return texts
    return _scaled(texts, name, one)


def _scaled(texts: Any, name: str, one: ColumnMap) -> Any:
    """Return numbers in the telemetry's unit; what is no number stays as it is written."""
    stripped = pc.utf8_trim_whitespace(texts.fill_null(""))
    value, bad = numbers(stripped)
    factor, shift = CONVERSIONS.get(UNITS[name], {}).get(one.unit or "", (1.0, 0.0))
    scale = 1.0 if one.scale is None else one.scale
    with np.errstate(over="ignore"):
        value = (value * scale + (one.offset or 0.0)) * factor + shift
    written = pc.cast(pa.array(value, from_pandas=True), pa.string())
    return pc.if_else(pa.array(bad), stripped, written)


def _identifiers(texts: Any, one: ColumnMap) -> Any:
    if one.identifier == "text":
        return texts
    stripped = pc.utf8_trim_whitespace(texts.fill_null(""))
    value, bad = integers(stripped)
    bad = np.asarray(bad | (value < 0))
    if one.identifier == "hip":
        written = pc.binary_join_element_wise("HIP", pc.cast(pa.array(value), pa.string()), " ")
    else:
        written = pa.array(decode(np.where(bad, 0, value)).tolist(), pa.string())
        # A code that stands for no identifier is no "unmatched".
        bad |= (value != 0) & np.asarray(pc.equal(written, "").to_numpy(zero_copy_only=False), bool)
    written = pc.if_else(pa.array(value == 0), "", written)
    return pc.if_else(pa.array(bad), stripped, written)


def element(column: Any, index: int, name: str) -> Any:
    """Return one element of an array column; nothing where the array is shorter."""
    values, offsets = as_lists(column, name)
    there = np.diff(offsets) > index
    place = pa.array(np.where(there, offsets[:-1] + index, 0), mask=~there)
    return values.take(place)


def as_lists(column: Any, name: str) -> tuple[Any, Ints]:
    """Return (elements, offsets (n + 1,)) of an array column, or of texts such as ``[1.0, 2.0]``.

    Raises
    ------
    InputError
        Naming the column: it is neither.
    """
    kind = column.type
    if pa.types.is_string(kind) or pa.types.is_large_string(kind):
        inner = pc.replace_substring_regex(column.fill_null(""), _BRACKETS, "")
        column = pc.split_pattern(inner, ",")
        nothing = np.asarray(pc.equal(inner, "").to_numpy(zero_copy_only=False), dtype=np.bool_)
        counts = np.where(nothing, 0, pc.list_value_length(column).to_numpy())
        listed = pc.list_parent_indices(column).to_numpy()
        values = pc.utf8_trim_whitespace(column.flatten())
        values = values.filter(pa.array(~nothing[listed]))
    elif any(is_kind(kind) for is_kind in _LIST_KINDS):
        counts = pc.list_value_length(column).fill_null(0).to_numpy()
        values = column.flatten()
    else:
        raise InputError(f"column {name!r} is {kind}, not a list")
    return values, np.concatenate(([0], np.cumsum(counts))).astype(np.int64)
