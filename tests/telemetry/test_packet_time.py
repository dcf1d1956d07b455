"""Time codes: against astropy, across leap seconds, and there and back."""

from __future__ import annotations

import numpy as np
import pytest
from astropy.time import Time
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from stcal.telemetry.packet_time import TimeCode, from_tai_ns, to_tai_ns
from stcal.times import format_utc, parse_utc

CCSDS = {"epoch": "1958-01-01T00:00:00", "scale": "TAI"}
CUC = TimeCode(code="CUC", **CCSDS, fine_bytes=3)
GPS = TimeCode(code="CUC", epoch="1980-01-06T00:00:00", scale="GPS", fine_bytes=4)
UNIX = TimeCode(code="CUC", epoch="1970-01-01T00:00:00", scale="UTC", fine_bytes=0)
CDS = TimeCode(code="CDS", epoch="1958-01-01T00:00:00", scale="UTC", submillisecond_bytes=2)
CODES = {
    "cuc": CUC,
    "gps": GPS,
    "unix": UNIX,
    "cds": CDS,
    "cds ms": TimeCode(code="CDS", epoch="2000-01-01T00:00:00", scale="UTC", day_bytes=3),
    "cds ps": TimeCode(code="CDS", **CCSDS, submillisecond_bytes=4),
    "long cuc": TimeCode(code="CUC", **CCSDS, coarse_bytes=7, fine_bytes=6),
    "preamble": TimeCode(code="CUC", **CCSDS, fine_bytes=3, p_field=True),
    "cds preamble": TimeCode(code="CDS", epoch="1958-01-01T00:00:00", scale="UTC", p_field=True),
}


def decoded(code: TimeCode, **parts: int) -> tuple[int, bool]:
    raw = {name: np.array([value], np.uint64) for name, value in parts.items()}
    t_tai_ns, bad = to_tai_ns(code, raw)
    return int(t_tai_ns[0]), bool(bad[0])


pytestmark = pytest.mark.filterwarnings("ignore:.*dubious year")


def tai_of(time: Time) -> int:
    """TAI ns since 1970 by astropy."""
    return round((time.tai - Time("1970-01-01", scale="tai")).sec * 1e9)


def test_the_ccsds_epoch_counts_tai():
    since = Time("2026-01-05T12:00:00", scale="utc").tai - Time("1958-01-01", scale="tai")
    coarse = round(since.sec)
    assert coarse == 2_146_305_637
    assert decoded(CUC, coarse=coarse, fine=1 << 23) == (
        parse_utc("2026-01-05T12:00:00.500Z"),
        False,
    )
    # One count of 2^-24 s is 59.6 ns.
    assert decoded(CUC, coarse=coarse, fine=1)[0] == parse_utc("2026-01-05T12:00:00.000000060Z")


@pytest.mark.parametrize("seconds", [800_000_000, 1_167_264_016, 1_167_264_017, 1_167_264_018])
def test_gps_seconds_as_astropy_counts_them(seconds):
    assert decoded(GPS, coarse=seconds, fine=0) == (tai_of(Time(seconds, format="gps")), False)


@pytest.mark.parametrize("days", [20_000, 21_549, 21_550, 24_846])
def test_days_of_utc_as_astropy_counts_them(days):
    """Day 21 549 is 2016-12-31, at whose end there was a leap second."""
    day = Time("1958-01-01", scale="utc").mjd + days
    for millisecond in (0, 43_200_000, 86_399_999):
        start = tai_of(Time(day, format="mjd", scale="utc"))
        expected = start + millisecond * 1_000_000 + 250_000
        parts = {"day": days, "millisecond": millisecond, "submillisecond": 250}
        assert decoded(CDS, **parts) == (expected, False)


def test_a_leap_second_has_its_own_milliseconds():
    within = parse_utc("2016-12-31T23:59:60.500Z")
    parts = {"day": 21_549, "millisecond": 86_400_500, "submillisecond": 0}
    assert decoded(CDS, **parts) == (within, False)
    assert format_utc(within) == "2016-12-31T23:59:60.500Z"
    assert {
        name: int(value[0]) for name, value in from_tai_ns(CDS, np.array([within])).items()
    } == parts
    # A second later the next day begins; no other day has these milliseconds.
    assert decoded(CDS, day=21_550, millisecond=0, submillisecond=0)[0] - within == 500_000_000
    assert decoded(CDS, day=21_548, millisecond=86_400_000, submillisecond=0) == (0, True)
    assert decoded(CDS, day=21_549, millisecond=86_401_000, submillisecond=0) == (0, True)


def test_posix_seconds_leave_leap_seconds_out():
    before = decoded(UNIX, coarse=1_483_228_799)[0]
    after = decoded(UNIX, coarse=1_483_228_800)[0]
    assert after - before == 2_000_000_000
    assert format_utc(after) == "2017-01-01T00:00:00.000Z"


def test_seconds_since_a_utc_epoch_with_leap_seconds():
    """J2000-like: the epoch's TAI label is 32 s ahead of its UTC label."""
    code = TimeCode(code="CUC", epoch="2000-01-01T12:00:32", scale="TAI", fine_bytes=0)
    assert decoded(code, coarse=0)[0] == parse_utc("2000-01-01T12:00:00.000Z")


@given(
    st.sampled_from(sorted(CODES)),
    st.integers(parse_utc("2001-01-01T00:00:00Z"), parse_utc("2080-01-01T00:00:00Z")),
)
def test_there_and_back_to_the_resolution(name, t_tai_ns):
    code = CODES[name]
    if name == "unix" and parse_utc("2016-12-31T23:59:59Z") < t_tai_ns < parse_utc(
        "2017-01-01T00:00:01Z"
    ):
        return  # it has no number for the leap second
    parts = from_tai_ns(code, np.array([t_tai_ns]))
    assert {
        n: int(v[0]) < 256**size for (n, size), v in zip(code.widths, parts.values(), strict=True)
    }
    again, bad = to_tai_ns(code, parts)
    assert not bad[0]
    assert abs(int(again[0]) - t_tai_ns) <= max(code.resolution_ns, 1.0)


def test_no_number_of_a_code_is_a_time_outside_what_is_supported():
    assert decoded(CUC, coarse=0, fine=0) == (0, True)  # before 1972
    assert decoded(CODES["long cuc"], coarse=2**56 - 1, fine=0) == (0, True)
    assert decoded(CDS, day=2**16 - 1, millisecond=2**32 - 1, submillisecond=2**16 - 1) == (0, True)
    assert decoded(CODES["cds preamble"], p_field=0, day=24_000, millisecond=0) == (0, True)


def test_preambles_of_the_standard():
    """301.0-B: 4 + 3 bytes of CUC from 1958 are 0x1F, from another epoch 0x2F; CDS is 0x40."""
    assert CODES["preamble"].preamble == 0x1F
    assert GPS.model_copy(update={"fine_bytes": 3}).preamble == 0x2F
    assert CODES["cds preamble"].preamble == 0x40
    assert CDS.preamble == 0x41


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"epoch": "1958-01-01"}, "is not as 1958-01-01T00:00:00"),
        ({"epoch": "1958-13-01T00:00:00"}, "month"),
        ({"day_bytes": 2}, "day_bytes: not for code CUC"),
        ({"scale": "UTC"}, "counts TAI"),
        ({"fine_bytes": 4, "p_field": True}, "at most 4 coarse and 3 fine"),
        ({"code": "CDS", "epoch": "1958-01-01T00:00:01"}, "beginning of a day"),
    ],
)
def test_codes_that_make_no_sense(changes, said):
    with pytest.raises(ValidationError, match=said):
        TimeCode(**({"code": "CUC"} | CCSDS | changes))
