"""The bytes of the structure: in the target's memory, and as F Prime serialises them."""

from __future__ import annotations

import struct

from stcal.calibration import Calibration
from stcal.uplink.formats.words import CODES, layout, words
from stcal.uplink.target import Target

_ORDERS = {"little": "<", "big": ">"}


def structure(calibration: Calibration, target: Target) -> bytes:
    """Return the structure as it lies in memory, padding zero."""
    slots, size = layout(target)
    numbers = words(calibration, target)
    payload = bytearray(size)
    order = _ORDERS[target.table.byte_order]
    for slot in slots:
        code = order + CODES[slot.field.word]
        struct.pack_into(code, payload, slot.offset, numbers[slot.label])
    return bytes(payload)


def serialised(calibration: Calibration, target: Target) -> bytes:
    """Return the members one after the other, big-endian, without padding."""
    numbers = words(calibration, target)
    slots, _ = layout(target)
    return b"".join(struct.pack(">" + CODES[s.field.word], numbers[s.label]) for s in slots)
