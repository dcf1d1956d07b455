"""Times of foreign tables: scales, epochs and leap seconds, against astropy and by hand."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pytest
from astropy.time import Time

from stcal.errors import InputError
from stcal.telemetry.mapped_time import label_ns, time_texts
from stcal.telemetry.mapping import ColumnMap
from stcal.times import parse_utc

# Not a day with a leap second: astropy stretches POSIX time on it.
UTC = ["1999-01-01T00:00:00.000Z", "2016-12-30T23:59:59.500Z", "2026-01-05T12:00:00.250Z"]


def texts(column, **how):
    array = column if isinstance(column, pa.Array) else pa.array(column)
    return time_texts(array, ColumnMap(column="t", **how), "t").to_pylist()


def number(**how):
    return {"time": "number", "epoch": "1970-01-01", "time_scale": "UTC", **how}


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
@pytest.mark.parametrize(
    ("scale", "epoch", "astropy"),
    [
        ("GPS", "1980-01-06", "gps"),
        ("UTC", "1970-01-01", "unix"),
        ("TAI", "1970-01-01", "unix_tai"),
    ],
)
def test_numbers_agree_with_astropy(scale, epoch, astropy, unit):
    seconds = np.array([float(getattr(Time(t[:-1], scale="utc"), astropy)) for t in UTC])
    factor = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[unit]
    how = number(time_unit=unit, epoch=epoch, time_scale=scale)
    got = texts(np.round(seconds * 4).astype(np.int64) / 4 * factor, **how)
    expected = [parse_utc(t) for t in UTC]
    np.testing.assert_allclose([parse_utc(t) for t in got], expected, rtol=0, atol=200)
    if unit != "s":
        whole = np.round(seconds * 4).astype(np.int64) * (factor // 4)
        assert [parse_utc(t) for t in texts(whole, **how)] == expected
        assert texts([str(x) for x in whole], **how) == texts(whole, **how)


def test_the_leap_second_itself():
    # TAI knows it, POSIX time does not.
    tai = parse_utc("2016-12-31T23:59:60.500Z")
    how = number(time_unit="ns", time_scale="TAI")
    assert texts([tai], **how) == ["2016-12-31T23:59:60.500Z"]
    assert texts(["2016-12-31T23:59:60.500Z"]) == ["2016-12-31T23:59:60.500Z"]
    # 36 s before, 37 s from the new year on: the label of TAI that is a leap second in UTC.
    assert texts(["2017-01-01T00:00:36.500"], time_scale="TAI") == ["2016-12-31T23:59:60.500Z"]
    assert texts(["2017-01-01T00:00:17.500"], time_scale="GPS") == ["2016-12-31T23:59:60.500Z"]


def test_iso_texts():
    given = ["2026-01-05 12:00:00", "2026-01-05T12:00:00.5Z", " 2026-01-05T12:00:00+00:00 "]
    assert texts(given) == [
        "2026-01-05T12:00:00Z",
        "2026-01-05T12:00:00.5Z",
        "2026-01-05T12:00:00Z",
    ]
    # What is no time, or of another zone, is left for the validation to refuse.
    odd = ["yesterday", "", "2026-01-05T12:00:00+01:00", None]
    assert texts(odd) == ["yesterday", "", "2026-01-05T12:00:00+01:00", ""]
    assert texts(odd, time_scale="TAI") == texts(odd)
    assert texts(["2026-01-05T12:00:60"], time_scale="TAI") == ["2026-01-05T12:00:60"]


def test_timestamps():
    stamps = np.array(["2026-01-05T12:00:00.000000001", "NaT"], dtype="datetime64[ns]")
    how = {"time": "timestamp"}
    assert texts(pa.array(stamps, pa.timestamp("ns", "UTC")), **how) == [
        "2026-01-05T12:00:00.000000001Z",
        "",
    ]
    plain = pa.array(stamps[:1].astype("datetime64[ms]"))
    assert texts(plain, **how, time_scale="TAI") == ["2026-01-05T11:59:23.000Z"]
    with pytest.raises(InputError, match="'t' has no time zone"):
        texts(plain, **how)
    with pytest.raises(InputError, match="'t' is int64, not a timestamp"):
        texts([1], **how)
    far = pa.array([2**62], pa.timestamp("s", "UTC"))
    assert texts(far, **how)[0] != ""
    assert not texts(far, **how)[0].endswith("Z")


@pytest.mark.parametrize("value", ["x", "", "nan", "inf", "1e300", "-1e18", -(2**62), 2**62])
@pytest.mark.parametrize("unit", ["s", "ns"])
def test_numbers_that_are_no_times_stay_as_they_are(value, unit):
    if (unit, value) == ("ns", 2**62):
        return  # the year 2116
    assert texts([value], **number(time_unit=unit)) == [str(value)]


def test_labels():
    assert label_ns("1958-01-01") == -378_691_200 * 10**9
    assert label_ns("1980-01-06T00:00:00Z") == 315_964_800 * 10**9
    for text in ("", "now", "NaT"):
        with pytest.raises(ValueError):
            label_ns(text)
