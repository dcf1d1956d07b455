"""Columns of numbers to text, without a Python object a number."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from stcal.frames import Floats

# Below the first, a product with a power of ten is off by 1e-4 at most; within the second of a
# whole number that is then the nearest one.
_EXACT_PRODUCT = 1e12
_SURELY_NEAREST = 0.49


def number_texts(values: Floats, decimals: int | None) -> Any:
    """Return numbers as text, null where NaN: fixed decimals, or the shortest exact form."""
    empty = np.isnan(values)
    if decimals is None:
        return pc.cast(pa.array(values, mask=empty), pa.string())
    return pc.if_else(pa.array(empty), pa.scalar(None, pa.string()), _fixed(values, decimals))


def _fixed(values: Floats, decimals: int) -> Any:
    """Return numbers as ``%.<decimals>f`` writes them."""
    # What is not plain needs exact decimals: ties, and more digits than the product keeps.
    with np.errstate(invalid="ignore", over="ignore"):
        scaled = np.abs(values) * 10.0**decimals
        whole = np.rint(scaled)
        plain = (np.abs(scaled - whole) < _SURELY_NEAREST) & (whole < _EXACT_PRODUCT)
    if not decimals or not plain.any():
        return _by_printf(values, decimals)
    before, behind = np.divmod(np.where(plain, whole, 0).astype(np.int64), 10**decimals)
    digits = pc.ascii_lpad(pc.cast(pa.array(behind), pa.string()), decimals, "0")
    sign = pc.if_else(pa.array(np.signbit(values)), "-", "")
    texts = pc.binary_join_element_wise(
        pc.binary_join_element_wise(sign, pc.cast(pa.array(before), pa.string()), ""), digits, "."
    )
    if plain.all():
        return texts
    return pc.replace_with_mask(texts, pa.array(~plain), _by_printf(values[~plain], decimals))


def _by_printf(values: Floats, decimals: int) -> Any:
    texts = np.strings.mod(f"%.{decimals}f", values) if len(values) else np.array([], dtype=str)
    return pa.array(texts.astype(object), pa.string())
