"""Decoder of an F Prime parameter file, as Svc::PrmDb reads it; no code of the encoder's."""

from __future__ import annotations

from dataclasses import dataclass
from zlib import crc32

from stcal.uplink.decode import DecodeError


@dataclass(frozen=True)
class Parameter:
    """The one parameter of a file: its id and its serialised value."""

    identifier: int
    value: bytes


def read_parameter(content: bytes, crc_prefix: bool) -> Parameter:
    """Return the only parameter of a file.

    Raises
    ------
    DecodeError
        When the CRC, the delimiter or the size is wrong, or another record follows.
    """
    records = content
    if crc_prefix:
        if len(content) < 4:
            raise DecodeError(f"F Prime file: {len(content)} bytes are no CRC")
        given, records = int.from_bytes(content[:4], "big"), content[4:]
        # Without zlib's last inversion, both add up to all ones.
        if given + crc32(records) != 0xFFFFFFFF:
            computed = 0xFFFFFFFF - crc32(records)
            raise DecodeError(
                f"F Prime file: CRC is {given:#010x}, of its records {computed:#010x}"
            )
    if len(records) < 9 or records[0] != 0xA5:
        raise DecodeError(f"F Prime file: begins with {records[:1].hex() or 'nothing'}, not a5")
    size = int.from_bytes(records[1:5], "big")
    if size != len(records) - 5:
        raise DecodeError(
            f"F Prime file: the record says {size} bytes, {len(records) - 5} follow; one parameter "
            "was expected"
        )
    return Parameter(int.from_bytes(records[5:9], "big"), records[9:])
