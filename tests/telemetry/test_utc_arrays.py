"""Vectorised times against the one-by-one ones."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from stcal.times import format_utc, format_utc_array, parse_utc, parse_utc_array, utc_day

GOOD = [
    "2016-12-31T23:59:60Z",
    "2016-12-31T23:59:60.5Z",
    "2017-01-01T00:00:00.000Z",
    "2026-01-05T12:00:00.123456789Z",
    "2024-02-29T00:00:00Z",
    "1972-01-01T00:00:00Z",
    "2000-02-29T23:59:59.9Z",
]
BAD = [
    "",
    "2016-12-31T23:59:60",
    "2016-12-30T23:59:60Z",
    "2023-02-29T00:00:00Z",
    "2100-02-29T00:00:00Z",
    "2026-01-05 12:00:00Z",
    "2026-01-05T12:00:00.Z",
    "2026-01-05T12:00:00.1234567891Z",
    "2026-01-05T12:00:00.1Z3Z",
    "2026-01-05T12:00:00.1a3Z",
    "2026-13-05T12:00:00Z",
    "2026-00-05T12:00:00Z",
    "2026-01-00T12:00:00Z",
    "2026-01-05T24:00:00Z",
    "2026-01-05T12:60:00Z",
    "2026-01-05T12:00:61Z",
    "2026-01-05T12:00:00+00:00",
    "1971-12-31T23:59:59Z",
    "9999-01-05T12:00:00Z",
    "2026-01-05T12:00:00ZZ",
    "२०२६-01-05T12:00:00Z",
    "x" * 100,
]


def test_array_parser_agrees_with_the_single_one():
    tai, good = parse_utc_array(GOOD)
    assert good.all()
    assert tai.tolist() == [parse_utc(text) for text in GOOD]


def test_what_is_no_time_is_marked():
    texts = [text for bad in BAD for text in (bad, GOOD[0])]
    tai, good = parse_utc_array(texts)
    assert [text for text, ok in zip(texts, good, strict=True) if ok] == [GOOD[0]] * len(BAD)
    assert (tai[~good] == 0).all()


def test_the_leap_second_has_its_own_nanoseconds_and_day():
    tai, _ = parse_utc_array(["2016-12-31T23:59:59Z", *GOOD[:3]])
    assert np.diff(tai).tolist() == [10**9, 5 * 10**8, 5 * 10**8]
    days = utc_day(tai).astype(str).tolist()
    assert days == ["2016-12-31"] * 3 + ["2017-01-01"]


@given(st.lists(st.integers(63_072_010 * 10**9, 9_000_000_000 * 10**9), min_size=1))
def test_formatting_and_parsing_are_inverse(tai):
    texts = format_utc_array(np.array(tai, dtype=np.int64))
    back, good = parse_utc_array(texts.tolist())
    assert good.all()
    assert back.tolist() == tai
    assert [parse_utc(format_utc(t)) for t in tai] == tai


def test_leap_second_labels_survive():
    tai, _ = parse_utc_array(GOOD[:2])
    assert [text[:19] for text in format_utc_array(tai).tolist()] == ["2016-12-31T23:59:60"] * 2


def test_no_times():
    tai, good = parse_utc_array([])
    assert len(tai) == len(good) == 0
