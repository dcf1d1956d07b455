"""Times of foreign tables to the telemetry's: ISO 8601 UTC text, scale and epoch as declared."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from stcal.errors import InputError
from stcal.frames import Bools, Ints
from stcal.telemetry.arrow_texts import texts_of
from stcal.telemetry.values import numbers
from stcal.times import FIRST_UTC_NS, format_utc_array, parse_utc_array, tai_from_utc_ns

if TYPE_CHECKING:
    from stcal.telemetry.mapping import ColumnMap

_NS = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}
# GPS time runs 19 s behind TAI (IS-GPS-200, 3.3.4: equal to UTC on 1980-01-06).
_TAI_MINUS_GPS_NS = 19 * _NS["s"]
_LAST_NS = int(np.datetime64("2261-12-31", "ns").astype(np.int64))
_DATE = re.compile(r"\d{4}-\d{2}-\d{2}")
_WHOLE = r"^[+-]?([0-9]{1,18}|[1-8][0-9]{18})$"
# A date, T or a space, a time, perhaps its zone.
_ISO = r"^([0-9]{4}-[0-9]{2}-[0-9]{2})[ T]([0-9:.]+)(Z|\+00:00)?$"


def label_ns(text: str) -> int:
    """Return the ns since 1970 of an ISO 8601 date or time read as a mere label, of any scale.

    Raises
    ------
    ValueError
        The text is neither.
    """
    problem = f"{text!r} is not a date or time such as 1980-01-06T00:00:00"
    if not _DATE.match(text):  # numpy also takes "now"
        raise ValueError(problem)
    try:
        return int(np.datetime64(text.removesuffix("Z"), "ns").astype(np.int64))
    except ValueError:
        raise ValueError(problem) from None


def time_texts(column: Any, spec: ColumnMap, name: str) -> Any:
    """Return a column of times as ISO 8601 UTC texts; what is no time stays as it is written.

    Raises
    ------
    InputError
        A column of timestamps without a zone, whose scale the mapping does not say.
    """
    if spec.time == "iso":
        return _from_labels(_stripped(column, name), spec)
    if spec.time == "timestamp":
        return _from_timestamps(column, spec, name)
    return _from_numbers(_stripped(column, name), spec)


def _stripped(column: Any, name: str) -> Any:
    return pc.utf8_trim_whitespace(texts_of(column, name).fill_null(""))


def _from_labels(texts: Any, spec: ColumnMap) -> Any:
    matched = pc.match_substring_regex(texts, _ISO)
    labels = pc.if_else(matched, pc.replace_substring_regex(texts, _ISO, r"\1T\2Z"), texts)
    if spec.time_scale in (None, "UTC"):
        return labels
    # A label of TAI or GPS has no leap second: read as if it were UTC, then as the scale's own.
    _, good = parse_utc_array(labels.to_pylist())
    good &= ~np.asarray(pc.match_substring(labels, ":60").to_numpy(zero_copy_only=False), bool)
    plain = [text.removesuffix("Z") for text in labels.to_pylist()]
    stamps = np.array([plain[i] if good[i] else "1972-01-01" for i in range(len(plain))])
    ns = stamps.astype("datetime64[ns]").astype(np.int64) if len(plain) else np.zeros(0, np.int64)
    return _written(_tai(ns, spec), good, texts)


def _from_timestamps(column: Any, spec: ColumnMap, name: str) -> Any:
    if not pa.types.is_timestamp(column.type):
        raise InputError(f"column {name!r} is {column.type}, not a timestamp")
    if column.type.tz is None and spec.time_scale is None:
        raise InputError(f"column {name!r} has no time zone: the mapping must give its time_scale")
    good = column.is_valid().to_numpy(zero_copy_only=False)
    ns = pc.cast(column, pa.timestamp("ns", column.type.tz), safe=False)
    whole = pc.cast(ns, pa.int64()).fill_null(0).to_numpy().astype(np.int64)
    # Beyond what ns can hold the cast wraps; the seconds tell.
    seconds = pc.cast(pc.cast(column, pa.timestamp("s", column.type.tz), safe=False), pa.int64())
    good &= np.abs(seconds.fill_null(0).to_numpy()) < _LAST_NS // _NS["s"]
    shown = pa.array([str(value) for value in whole.tolist()], pa.string())
    texts = pc.if_else(column.is_valid(), shown, "")
    return _written(_tai(whole, spec), good & _in_range(whole), texts)


def _from_numbers(texts: Any, spec: ColumnMap) -> Any:
    unit = _NS[spec.time_unit]
    is_whole = pc.match_substring_regex(texts, _WHOLE)
    whole = pc.cast(pc.if_else(is_whole, texts, "0"), pa.int64()).to_numpy().astype(np.int64)
    real, bad = numbers(texts)
    limit = _LAST_NS / unit
    good = ~bad & np.isfinite(real) & (np.abs(np.nan_to_num(real)) < limit)
    real = np.where(good, real, 0.0)
    floor = np.floor(real)
    # Whole numbers exactly; the fraction of others apart, so that no digit of it is lost.
    is_exact = np.asarray(is_whole.to_numpy(zero_copy_only=False), dtype=np.bool_) & good
    ns = floor.astype(np.int64) * unit + np.round((real - floor) * unit).astype(np.int64)
    ns = np.where(is_exact, np.where(good, whole, 0) * unit, ns) + label_ns(spec.epoch or "")
    return _written(_tai(ns, spec), good & _in_range(ns), texts)


def _in_range(ns: Ints) -> Bools:
    return np.asarray((ns >= FIRST_UTC_NS) & (ns < _LAST_NS))


def _tai(ns: Ints, spec: ColumnMap) -> Ints:
    """Return TAI ns of labels in the spec's scale; those out of range are of no use."""
    if spec.time_scale == "TAI":
        return ns
    if spec.time_scale == "GPS":
        return ns + _TAI_MINUS_GPS_NS
    return tai_from_utc_ns(np.maximum(ns, FIRST_UTC_NS))


def _written(t_tai_ns: Ints, good: Bools, texts: Any) -> Any:
    """Return the good times as text, and the others' own texts."""
    shown = np.where(good & (t_tai_ns >= FIRST_UTC_NS), t_tai_ns, FIRST_UTC_NS + 10 * _NS["s"])
    written = pa.array(format_utc_array(shown).tolist(), pa.string())
    return pc.if_else(pa.array(good & (t_tai_ns >= FIRST_UTC_NS)), written, texts)
