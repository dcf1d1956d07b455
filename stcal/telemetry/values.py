"""Columns of text to typed columns, vectorised; a text that is no value is marked, not raised.

A column that is typed already (:class:`stcal.telemetry.typed.Typed`) goes through as it is.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from stcal.catalog.identifiers import MALFORMED
from stcal.frames import Bools, Floats, Ints
from stcal.telemetry.schema import star_id_codes
from stcal.telemetry.typed import Typed
from stcal.times import parse_utc_array

# At most 18 digits fit an int64; spreadsheets write whole numbers as 12.0.
_INTEGER = r"^[+-]?[0-9]{1,18}(\.0*)?$"
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?", re.ASCII)
_FLAGS = {"": 0, "0": 0, "1": 1, "0.0": 0, "1.0": 1, "false": 0, "true": 1}


def strip(text: Any) -> Any:
    """Return the texts without spaces around them, ``''`` where null."""
    if isinstance(text, Typed):
        return text
    return pc.ascii_trim_whitespace(text.fill_null(""))


def is_empty(text: Any) -> Bools:
    """Return (n,) whether the texts are empty; they are stripped already."""
    if isinstance(text, Typed):
        return text.empty
    return _numpy(pc.equal(text, ""))


def numbers(text: Any) -> tuple[Floats, Bools]:
    """Return (values, bad): NaN where the text is empty or bad; ``nan`` and ``inf`` are bad."""
    if isinstance(text, Typed):
        return text.values, text.bad
    filled = pc.if_else(pc.equal(text, ""), None, text)
    try:
        parsed = pc.cast(filled, pa.float64()).to_numpy(zero_copy_only=False)
    except pa.ArrowInvalid:
        return _numbers_one_by_one(text)
    values = parsed + 0.0  # a copy; and -0.0 becomes 0.0, so that equal frames have equal bytes
    bad = ~np.isfinite(values) & _numpy(filled.is_valid())
    values[bad] = np.nan
    return values, bad


def _numbers_one_by_one(text: Any) -> tuple[Floats, Bools]:
    """For a column with some text that is no number: each distinct text is parsed once."""
    packed = text.dictionary_encode()
    distinct = [_number(entry) for entry in packed.dictionary.to_pylist()]
    codes = packed.indices.to_numpy()
    values = np.array([value for value, _ in distinct], dtype=np.float64)[codes] + 0.0
    return values, np.array([bad for _, bad in distinct], dtype=np.bool_)[codes]


def _number(text: str) -> tuple[float, bool]:
    if not text:
        return np.nan, False
    value = float(text) if _NUMBER.fullmatch(text) else np.nan
    return (value, False) if np.isfinite(value) else (np.nan, True)


def integers(text: Any) -> tuple[Ints, Bools]:
    """Return (values, bad): 0 where empty or bad; empty is bad."""
    if isinstance(text, Typed):
        return text.values, text.bad | text.empty
    packed = text.dictionary_encode()
    distinct = packed.dictionary
    good = pc.match_substring_regex(distinct, _INTEGER)
    digits = pc.replace_substring_regex(distinct, r"^\+|\.0*$", "")
    values = pc.cast(pc.if_else(good, digits, "0"), pa.int64()).to_numpy()
    codes = packed.indices.to_numpy()
    return values[codes], ~_numpy(good)[codes]


def flags(text: Any) -> tuple[Bools, Bools]:
    """Return (values, bad): 0 and 1, false and true, empty is false."""
    if isinstance(text, Typed):
        return text.values == 1, text.bad
    packed = text.dictionary_encode()
    found = [_FLAGS.get(entry.lower(), -1) for entry in packed.dictionary.to_pylist()]
    values = np.array(found, dtype=np.int8)[packed.indices.to_numpy()]
    return values == 1, values < 0


def times(text: Any) -> tuple[Ints, Bools]:
    """Return (TAI ns, bad); empty is bad."""
    if isinstance(text, Typed):
        return text.values, text.bad | text.empty
    packed = text.dictionary_encode()
    values, good = parse_utc_array(packed.dictionary.to_pylist())
    codes = packed.indices.to_numpy()
    return values[codes], ~good[codes]


def star_ids(text: Any) -> tuple[Ints, Bools]:
    """Return (identifier codes, bad); empty is 0, unmatched."""
    if isinstance(text, Typed):
        return text.values, text.bad
    codes = star_id_codes(text)
    return codes, codes == MALFORMED


def _numpy(mask: Any) -> Bools:
    return np.asarray(mask.to_numpy(zero_copy_only=False), dtype=np.bool_)
