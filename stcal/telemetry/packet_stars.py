"""Star identifiers as packets give them.

``hip``: the Hipparcos number.  ``hip-tyc``, 32 bits: the Hipparcos number where the first bit is 0;
else, behind that bit, 14 bits TYC1, 14 bits TYC2 and 3 bits TYC3.  0 is "unmatched" in both.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stcal.catalog.identifiers import TYCHO_BASE, Ints
from stcal.telemetry import packet_kernels as kernels

_TYCHO_BIT = 1 << 31
_TYC1_SHIFT, _TYC2_SHIFT = 17, 3
_TYC12_MASK, _TYC3_MASK = 0x3FFF, 0x7


def star_codes(raw: NDArray[np.uint64], encoding: str) -> Ints:
    """Return the identifier codes of raw numbers, -1 where one is no identifier."""
    codes = np.empty(len(raw), np.int64)
    kernels.star_codes(raw, encoding == "hip-tyc", codes)
    return codes


def raw_numbers(codes: Ints, encoding: str) -> NDArray[np.uint64]:
    """Return the raw numbers of identifier codes.

    Raises
    ------
    ValueError
        A code that the encoding cannot say.
    """
    rest, tyc3 = np.divmod(codes - TYCHO_BASE, 10)
    tyc1, tyc2 = np.divmod(rest, 100_000)
    tycho = codes >= TYCHO_BASE
    fits = (tyc1 <= _TYC12_MASK) & (tyc2 <= _TYC12_MASK) & (tyc3 <= _TYC3_MASK)
    if np.any(codes < 0) or np.any(tycho & ((encoding != "hip-tyc") | ~fits)):
        raise ValueError(f"a star identifier that encoding {encoding} cannot say")
    packed = _TYCHO_BIT | tyc1 << _TYC1_SHIFT | tyc2 << _TYC2_SHIFT | tyc3
    return np.where(tycho, packed, codes).astype(np.uint64)
