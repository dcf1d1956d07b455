import numpy as np
import pytest
from astropy.time import Time
from hypothesis import given
from hypothesis import strategies as st

from stcal.times import (
    format_utc,
    julian_date_tt,
    parse_utc,
    tai_from_utc_ns,
    utc_from_tai_ns,
)

TAI = st.integers(parse_utc("1972-01-01T00:00:00Z"), parse_utc("2060-01-01T00:00:00Z"))


@given(TAI)
def test_text_round_trips_to_the_nanosecond(t):
    assert parse_utc(format_utc(t)) == t


@pytest.mark.parametrize(
    "text",
    ["2013-11-21T07:10:11.000Z", "2016-12-31T23:59:60.500Z", "2017-01-01T00:00:00.000Z",
     "1999-01-01T00:00:00.000Z", "2026-11-24T23:20:00.123Z"],
)  # fmt: skip
def test_agrees_with_astropy(text):
    theirs = Time(text.removesuffix("Z"), scale="utc").tai
    seconds = (theirs - Time("1970-01-01T00:00:00", scale="tai")).sec
    assert parse_utc(text) / 1e9 == pytest.approx(seconds, abs=1e-6)
    assert format_utc(parse_utc(text)) == text
    jd1, jd2 = julian_date_tt(np.array([parse_utc(text)]))
    assert (jd1[0] - theirs.tt.jd1) + (jd2[0] - theirs.tt.jd2) == pytest.approx(0, abs=1e-13)


def test_the_leap_second_of_2016():
    last, leap, first = (
        parse_utc(t)
        for t in ("2016-12-31T23:59:59Z", "2016-12-31T23:59:60Z", "2017-01-01T00:00:00Z")
    )
    assert (leap - last, first - leap) == (10**9, 10**9)
    utc = utc_from_tai_ns(np.array([last, leap, first]))
    assert np.array_equal(tai_from_utc_ns(utc[[0, 2]]), [last, first])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("2026-01-05 12:00:00Z", "ISO 8601"),
        ("2026-01-05T12:00:00", "ISO 8601"),
        ("2026-13-05T12:00:00Z", "not a time"),
        ("2026-02-30T12:00:00Z", "not a time"),
        ("2026-06-30T23:59:60Z", "not a leap second"),
        ("1969-01-05T12:00:00Z", "1972"),
        ("", "ISO 8601"),
        ("9999-01-05T12:00:00Z", "beyond the year"),
        ("2026-01-05T12:00:00Z\n", "ISO 8601"),
        ("２０２６-01-05T12:00:00Z", "ISO 8601"),
        ("2026-01-05T12:00:00.٥Z", "ISO 8601"),
    ],
)
def test_what_is_no_utc_time_is_refused(text, message):
    with pytest.raises(ValueError, match=message):
        parse_utc(text)
