"""CRC-16/ARC, which the cFE's load service reports of a table."""

from __future__ import annotations

_POLYNOMIAL = 0xA001  # 0x8005 reflected


def crc16_arc(content: bytes) -> int:
    """Return the CRC-16/ARC: reflected, initial value zero, no final inversion (check 0xBB3D)."""
    crc = 0
    for byte in content:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (_POLYNOMIAL if crc & 1 else 0)
    return crc


def shown(crc: int) -> str:
    """Return a CRC as files and people have it: ``0xBB3D``."""
    return f"0x{crc:04X}"
