"""Time scales: UTC as telemetry and operators write it, TAI nanoseconds inside.

Leap seconds come from ERFA's table.  Dates before 1972 (no integral leap seconds) are refused.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import date
from functools import cache
from typing import Any, Literal

import erfa
import numpy as np
from numpy.typing import NDArray

from stcal.constants import DAY_S, TT_MINUS_TAI_S

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_UTC = re.compile(r"\d{4}-\d{2}-\d{2}T\d{2}:\d{2}:(\d{2})(\.\d{1,9})?Z", re.ASCII)
# int64 nanoseconds end in 2262.
_YEARS = (1972, 2261)
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
    match = _UTC.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r} is not an ISO 8601 UTC time such as 2026-01-05T12:00:00.000Z")
    if int(text[:4]) > _YEARS[1]:
        raise ValueError(f"{text!r} lies beyond the year {_YEARS[1]}")
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


# A time of the longest form has 30 characters; one more shows that a text is longer.
_WIDTH = 31
_DIGITS = np.array([0, 1, 2, 3, 5, 6, 8, 9, 11, 12, 14, 15, 17, 18])
_SEPARATORS = {4: "-", 7: "-", 10: "T", 13: ":", 16: ":"}
_MONTH_DAYS = np.array([31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31])


def parse_utc_array(texts: Sequence[str] | NDArray[np.object_]) -> tuple[Ints, NDArray[np.bool_]]:
    """Parse many times as :func:`parse_utc` does, without a loop over them.

    Returns
    -------
    t_tai_ns : (n,) int64, 0 where the text is not a time
    good : (n,) bool
    """
    if len(texts) == 0:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.bool_)
    characters = np.asarray(texts, dtype=f"U{_WIDTH}").view(np.uint32).reshape(-1, _WIDTH)
    good, fraction_ns = _check_layout(characters)
    d = np.where(good[:, None], characters[:, _DIGITS].astype(np.int64) - ord("0"), 0)
    year = d[:, 0] * 1000 + d[:, 1] * 100 + d[:, 2] * 10 + d[:, 3]
    month, day, hour, minute, second = (d[:, i] * 10 + d[:, i + 1] for i in (4, 6, 8, 10, 12))
    good &= (year >= _YEARS[0]) & (year <= _YEARS[1]) & (month >= 1) & (month <= 12)
    year, month = np.where(good, year, 1972), np.where(good, month, 1)
    is_leap_year = (year % 4 == 0) & ((year % 100 != 0) | (year % 400 == 0))
    last_day = _MONTH_DAYS[month - 1] + (is_leap_year & (month == 2))
    good &= (day >= 1) & (day <= last_day) & (hour <= 23) & (minute <= 59) & (second <= 60)
    leap = good & (second == 60)
    months = ((year - 1970) * 12 + month - 1).astype("datetime64[M]")
    days = months.astype("datetime64[D]").astype(np.int64) + np.where(good, day - 1, 0)
    seconds = ((days * 24 + hour) * 60 + minute) * 60 + second - leap
    utc = np.where(good, seconds * _NS + fraction_ns, FIRST_UTC_NS)
    tai = tai_from_utc_ns(utc)
    # A leap second exists where TAI runs two seconds on while the label runs one.
    good &= ~leap | (tai_from_utc_ns(utc + _NS) - tai == 2 * _NS)
    return np.where(good, tai + leap * _NS, 0), good


def _check_layout(characters: NDArray[np.uint32]) -> tuple[NDArray[np.bool_], Ints]:
    """Return which rows of code points look like a UTC time, and their fractions in ns."""
    is_digit = (characters >= ord("0")) & (characters <= ord("9"))
    good = is_digit[:, _DIGITS].all(axis=1)
    for position, separator in _SEPARATORS.items():
        good &= characters[:, position] == ord(separator)
    end = np.argmax(characters == ord("Z"), axis=1)
    good &= (end == 19) | ((end >= 21) & (end <= 29) & (characters[:, 19] == ord(".")))
    good &= np.count_nonzero(characters, axis=1) == end + 1
    fraction = np.zeros(len(characters), dtype=np.int64)
    for i in range(9):
        inside = 20 + i < end
        good &= ~inside | is_digit[:, 20 + i]
        digit = np.where(inside & is_digit[:, 20 + i], characters[:, 20 + i], ord("0"))
        fraction += (digit.astype(np.int64) - ord("0")) * 10 ** (8 - i)
    return good, fraction


def format_utc_array(t_tai_ns: Ints) -> NDArray[np.str_]:
    """Format many times as :func:`format_utc` does; milliseconds where they suffice for all."""
    utc = utc_from_tai_ns(t_tai_ns)
    unit: Literal["ms", "ns"] = "ms" if not np.any(t_tai_ns % 1_000_000) else "ns"
    texts = np.datetime_as_string(utc.astype("datetime64[ns]"), unit=unit)
    in_leap = tai_from_utc_ns(utc) != t_tai_ns
    texts[in_leap] = [text[:17] + "60" + text[19:] for text in texts[in_leap].tolist()]
    return np.strings.add(texts, "Z")


def utc_day(t_tai_ns: Ints) -> NDArray[np.datetime64]:
    """Return the UTC days (datetime64[D]) that the times fall in."""
    return utc_from_tai_ns(t_tai_ns).astype("datetime64[ns]").astype("datetime64[D]")


def format_utc(t_tai_ns: int) -> str:
    """Return ISO 8601 UTC with milliseconds (or nanoseconds where they matter) and ``Z``."""
    tai = np.array([t_tai_ns], dtype=np.int64)
    utc = utc_from_tai_ns(tai)
    unit: Any = "ms" if t_tai_ns % 1_000_000 == 0 else "ns"
    text = str(np.datetime_as_string(utc.astype("datetime64[ns]")[0], unit=unit))
    if tai_from_utc_ns(utc)[0] != t_tai_ns:  # only inside a leap second
        text = text[:17] + "60" + text[19:]
    return text + "Z"


def julian_date_tt(t_tai_ns: Ints) -> tuple[Floats, Floats]:
    """Return the two-part Julian date of TT (ERFA's convention); TDB differs by under 2 ms."""
    days, rest = np.divmod(t_tai_ns, int(DAY_S) * _NS)
    return _JD_1970 + days.astype(np.float64), (rest / _NS + TT_MINUS_TAI_S) / DAY_S
