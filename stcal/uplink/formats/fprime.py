"""Encoder of an F Prime parameter file: the whole calibration as one structure.

Svc::PrmDb's format: records of delimiter, size, id, value, all big-endian, behind a CRC where the
deployment expects one.
"""

from __future__ import annotations

import struct
import zlib

from stcal.calibration import Calibration
from stcal.uplink.formats.payload import serialised
from stcal.uplink.target import Target
from stcal.uplink.target_sections import FprimeSection

_DELIMITER = 0xA5
_ID_SIZE = 4


def encode(section: FprimeSection, calibration: Calibration, target: Target) -> dict[str, bytes]:
    """Return the parameter file by its name."""
    content = record(section.parameter_id, serialised(calibration, target))
    if section.crc_prefix:
        content = struct.pack(">I", prefix(content)) + content
    return {section.file: content}


def record(identifier: int, value: bytes) -> bytes:
    """Return the record of one parameter."""
    return struct.pack(">BII", _DELIMITER, _ID_SIZE + len(value), identifier) + value


def prefix(records: bytes) -> int:
    """Return PrmDb's CRC: crc32 once more inverted, so that zlib's final inversion is undone."""
    return zlib.crc32(records) ^ 0xFFFFFFFF
