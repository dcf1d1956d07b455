from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stcal.catalog.identifiers import MALFORMED, UNMATCHED, decode, encode, tycho_code


def test_codes_are_the_fixed_ones() -> None:
    texts = np.array(["", "HIP 27989", "TYC 129-1873-1", "HIP 1"])
    expected = [0, 27989, 2**40 + (129 * 100_000 + 1873) * 10 + 1, 1]
    assert encode(texts).tolist() == expected
    assert encode(texts.astype(object)).dtype == np.int64


@pytest.mark.parametrize(
    "text",
    [
        *("HIP", "HIP 0", "HIP -5", "HIP 200001", "hip 5", "HIP 5x", "HIP5", "27989", "HIP 1e3"),
        *("TYC 1-2", "TYC 1-2-0", "TYC 0-1-1", "TYC 1-2-3-4", "TYC 1-123456-1", "HD 1", "HIP ١"),
    ],
)
def test_text_that_is_no_identifier(text: str) -> None:
    assert encode(np.array([text], dtype=object))[0] == MALFORMED


def test_missing_values_are_unmatched() -> None:
    codes = encode(np.array([None, np.nan, "", "  ", 7], dtype=object))
    assert codes.tolist() == [UNMATCHED] * 4 + [MALFORMED]


def test_zero_padded_numbers_are_understood_and_written_plainly() -> None:
    codes = encode(["TYC 0129-01873-1", "HIP 000042"])
    assert decode(codes).tolist() == ["TYC 129-1873-1", "HIP 42"]


@given(st.lists(st.one_of(
    st.integers(1, 200_000).map(lambda n: f"HIP {n}"),
    st.tuples(st.integers(1, 9999), st.integers(1, 99_999), st.integers(1, 9)).map(
        lambda t: f"TYC {t[0]}-{t[1]}-{t[2]}"
    ),
    st.just(""),
)))  # fmt: skip
def test_round_trip(texts: list[str]) -> None:
    assert decode(encode(texts)).tolist() == texts


def test_decoding_keeps_the_shape_and_empties_bad_codes() -> None:
    assert decode(np.array([[0, -1], [5, 5]])).tolist() == [["", ""], ["HIP 5", "HIP 5"]]


def test_tycho_code_agrees_with_the_text() -> None:
    code = tycho_code(np.array([9537]), np.array([12121]), np.array([3]))
    assert decode(code)[0] == "TYC 9537-12121-3"
