"""Time scales: UTC as telemetry and operators write it, TAI nanoseconds inside.

Leap seconds come from ERFA's table.  Dates before 1972 (no integral leap seconds) are refused.
"""

from __future__ import annotations

import re
from datetime import date
from functools import cache

import erfa
import numpy as np
from numpy.typing import NDArray

from stcal.constants import DAY_S, TT_MINUS_TAI_S

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

UTC_PATTERN = r"^\d{4}-\d{2}-\d{2}T\d{2}:\d{2}:(\d{2})(\.\d{1,9})?Z$"
_UTC = re.compile(UTC_PATTERN)
_NS = 1_000_000_000
_JD_1970 = 2_440_587.5
FIRST_UTC_NS = int(np.datetime64("1972-01-01", "ns").astype(np.int64))


@cache
def _leap_table() -> tuple[Ints, Ints]:
    """Return (UTC ns at which each offset starts, TAI - UTC in ns)."""
    table = erfa.leap_seconds.get()
    table = table[table["year"] >= 1972]
    start = [
        np.datetime64(date(int(y), int(m), 1), "ns").astype(np.int64)
        for y, m in zip(table["year"], table["month"], strict=True)
    ]
    offset = np.round(table["tai_utc"]).astype(np.int64) * _NS
    return np.array(start, dtype=np.int64), offset


def tai_from_utc_ns(utc_ns: Ints) -> Ints:
    """Return TAI ns since 1970 TAI of POSIX-like UTC ns since 1970 UTC (no leap second labels)."""
    start, offset = _leap_table()
    index = np.searchsorted(start, utc_ns, side="right") - 1
    if np.any(index < 0):
        raise ValueError("times before 1972-01-01 are not supported")
    return np.asarray(utc_ns + offset[index], dtype=np.int64)


def utc_from_tai_ns(t_tai_ns: Ints) -> Ints:
    """Return POSIX-like UTC ns; a leap second is given the label of the second before it."""
    start, offset = _leap_table()
    index = np.maximum(np.searchsorted(start + offset, t_tai_ns, side="right") - 1, 0)
    utc = t_tai_ns - offset[index]
    following = np.minimum(index + 1, len(start) - 1)
    within_leap = (following > index) & (utc >= start[following])
    return np.asarray(np.where(within_leap, utc - _NS, utc), dtype=np.int64)


def parse_utc(text: str) -> int:
    """Return TAI ns of an ISO 8601 UTC time with ``Z``; a leap second (``:60``) is understood.

    Raises
    ------
    ValueError
        With the text and what is wrong with it.
    """
    match = _UTC.match(text)
    if match is None:
        raise ValueError(f"{text!r} is not an ISO 8601 UTC time such as 2026-01-05T12:00:00.000Z")
    leap = match.group(1) == "60"
    body = text[:-1]
    if leap:
        body = body[:17] + "59" + body[19:]
    try:
        utc_ns = np.datetime64(body, "ns").astype(np.int64)
    except ValueError as error:
        raise ValueError(f"{text!r} is not a time: {error}") from None
    tai = int(tai_from_utc_ns(np.array([utc_ns]))[0])
    if not leap:
        return tai
    if int(tai_from_utc_ns(np.array([utc_ns + _NS]))[0]) - tai != 2 * _NS:
        raise ValueError(f"{text!r} is not a leap second")
    return tai + _NS


def format_utc(t_tai_ns: int) -> str:
    """Return ISO 8601 UTC with milliseconds (or nanoseconds where they matter) and ``Z``."""
    tai = np.array([t_tai_ns], dtype=np.int64)
    utc = utc_from_tai_ns(tai)
    unit = "ms" if t_tai_ns % 1_000_000 == 0 else "ns"
    text = str(np.datetime_as_string(utc.astype("datetime64[ns]")[0], unit=unit))
    if tai_from_utc_ns(utc)[0] != t_tai_ns:  # only inside a leap second
        text = text[:17] + "60" + text[19:]
    return text + "Z"


def julian_date_tt(t_tai_ns: Ints) -> tuple[Floats, Floats]:
    """Return the two-part Julian date of TT (ERFA's convention); TDB differs by under 2 ms."""
    days, rest = np.divmod(t_tai_ns, int(DAY_S) * _NS)
    return _JD_1970 + days.astype(np.float64), (rest / _NS + TT_MINUS_TAI_S) / DAY_S
