"""Star identifiers as text (``HIP 27989``, ``TYC 129-1873-1``) and as int64 codes.

Code 0 is "unmatched", a Hipparcos star has its number, a Tycho star has ``TYCHO_BASE`` plus its
three numbers, and -1 is text that is no identifier.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]

UNMATCHED = 0
MALFORMED = -1
HIP_LIMIT = 200_000
TYCHO_BASE = 2**40

# Ranges of Tycho-2's byte-by-byte description (CDS I/259), with room for its supplements.
_TYC1_LIMIT, _TYC2_LIMIT, _TYC3_LIMIT = 9_999, 99_999, 9
_HIP = re.compile(r"HIP +0*(\d{1,6})", re.ASCII)
_TYC = re.compile(r"TYC +0*(\d{1,4})-0*(\d{1,5})-(\d)", re.ASCII)


def tycho_code(tyc1: Ints, tyc2: Ints, tyc3: Ints) -> Ints:
    """Return the codes of Tycho numbers, arrays of one shape."""
    return np.asarray(TYCHO_BASE + (tyc1 * 100_000 + tyc2) * 10 + tyc3, dtype=np.int64)


def encode(texts: Iterable[object] | NDArray[np.str_] | NDArray[np.object_]) -> Ints:
    """Return the codes (S,) of identifiers (S,), text or missing (None, NaN).

    Telemetry repeats few identifiers often, so each distinct text is parsed once.
    """
    array = np.asarray(texts if isinstance(texts, np.ndarray) else list(texts), dtype=object)
    known: dict[object, int] = {}
    codes = np.empty(array.shape, dtype=np.int64)
    flat = codes.reshape(-1)
    for i, text in enumerate(array.reshape(-1).tolist()):
        code = known.get(text)
        if code is None:
            code = known[text] = _encode_one(text)
        flat[i] = code
    return codes


def _encode_one(text: object) -> int:
    if text is None or (isinstance(text, float) and np.isnan(text)):
        return UNMATCHED
    if not isinstance(text, str):
        return MALFORMED
    text = text.strip()
    if not text:
        return UNMATCHED
    if hip := _HIP.fullmatch(text):
        number = int(hip.group(1))
        return number if 1 <= number <= HIP_LIMIT else MALFORMED
    if tyc := _TYC.fullmatch(text):
        a, b, c = (int(part) for part in tyc.groups())
        inside = 1 <= a <= _TYC1_LIMIT and 1 <= b <= _TYC2_LIMIT and 1 <= c <= _TYC3_LIMIT
        return TYCHO_BASE + (a * 100_000 + b) * 10 + c if inside else MALFORMED
    return MALFORMED


def decode(codes: Ints) -> NDArray[np.object_]:
    """Return the identifiers (S,) as text; unmatched and malformed codes give ``''``."""
    codes = np.asarray(codes, dtype=np.int64)
    distinct, inverse = np.unique(codes, return_inverse=True)
    texts = np.empty(len(distinct), dtype=object)
    texts[:] = [_decode_one(code) for code in distinct.tolist()]
    return np.asarray(texts[inverse.reshape(codes.shape)], dtype=object)


def _decode_one(code: int) -> str:
    if code <= 0:
        return ""
    if code < TYCHO_BASE:
        return f"HIP {code}"
    rest, c = divmod(code - TYCHO_BASE, 10)
    a, b = divmod(rest, 100_000)
    return f"TYC {a}-{b}-{c}"
