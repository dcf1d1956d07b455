"""Layouts and streams that the packet tests share; bytes are made here without stcal's writer."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np

from stcal.frames import FrameBatch
from stcal.telemetry.packet_layout import PacketLayout, parse_layout
from stcal.telemetry.packets import PacketDecoder

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "configs" / "packets" / "st16.toml"

SMALL = """
schema = "stcal.packet-layout/1"
name = "small"
error_control = "crc-16"
ignored_apids = [99]
apids = {{ "ST16-1" = 321, "ST16-2" = 322 }}
time = {{ code = "CUC", epoch = "1958-01-01T00:00:00", scale = "TAI", fine_bytes = 2 }}
fields = [
  {{ name = "frame_id", type = "u32" }},
  {{ name = "temperature_c", type = "i16", scale = 0.5, offset = 1.0, unit = "degC" }},
  {{ name = "n", type = "u8" }},
  {{ list = "stars", name = "stars", count = "n", maximum = 5, exposure = 0, fields = [
    {{ name = "row_px", type = "u16", scale = 0.125, unit = "px" }},
    {{ name = "col_px", type = "u16", scale = 0.125, unit = "px" }},
    {{ name = "star_id", type = "u32", encoding = "hip-tyc" }},
  ] }},
{more}
]
"""


def small_layout(more: str = "", **changes: str) -> PacketLayout:
    """Return a small layout; ``changes`` replace pieces of its text."""
    text = SMALL.format(more=more)
    for old, new in changes.items():
        wanted = _PIECES[old]
        assert wanted in text
        text = text.replace(wanted, new)
    return parse_layout(text.encode(), "layout")


_PIECES = {
    "crc": '"crc-16"',
    "ignored": "[99]",
    "exposure": "exposure = 0",
    "count": 'count = "n"',
    "apids": '{ "ST16-1" = 321, "ST16-2" = 322 }',
}


def crc16(content: bytes) -> int:
    """CRC-16, bit by bit."""
    crc = 0xFFFF
    for byte in content:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1
    return crc & 0xFFFF


def packet(
    data: bytes, apid: int = 321, sequence: int = 0, flags: int = 3, crc: bool = True
) -> bytes:
    """Return a telemetry packet with a secondary header around its data."""
    length = len(data) + (2 if crc else 0) - 1
    content = struct.pack(">HHH", 0x0800 | apid, flags << 14 | sequence % 16384, length) + data
    return content + struct.pack(">H", crc16(content)) if crc else content


def star_packet(frame: int, stars: list[tuple[int, int, int]], **options) -> bytes:
    """Return a packet of the small layout: frame number and raw stars."""
    data = struct.pack(">IHIhB", 2_146_305_637 + frame, 0x8000, frame, 40, len(stars))
    data += b"".join(struct.pack(">HHI", *star) for star in stars)
    return packet(data, sequence=options.pop("sequence", frame), **options)


def stars_of(frame: int) -> list[tuple[int, int, int]]:
    """Return the raw stars that the tests' frame of this number holds, 0 to 5."""
    return [(100 + frame, 200 + 10 * k, 27989 + k) for k in range(frame % 6)]


def decode(layout: PacketLayout, content: bytes, is_log: bool = False, block_bytes: int = 1 << 20):
    """Return (decoder, row blocks, all records) of a stream in memory."""
    decoder = PacketDecoder(layout, is_log, block_bytes, may_be_junk=True)
    parts = (content[i : i + block_bytes] for i in range(0, len(content), block_bytes))
    blocks = list(decoder.decode_parts(parts, "x", lambda _: None))
    return decoder, blocks, [record for block in blocks for record in block.rejected]


def frame_numbers(blocks) -> list[int]:
    """Return the frame numbers decoded, a number a packet."""
    found: list[int] = []
    for block in blocks:
        found += block.columns["frame_id"].values.tolist() if len(block) else []
    return found


def as_sent(frames: FrameBatch) -> FrameBatch:
    """Return frames as the example layout's numbers say them."""

    def step(values, size):
        return np.rint(np.asarray(values) / size) * size

    return replace(
        frames,
        q_si=step(frames.q_si, 2.0**-30),
        rate_deg_s=frames.rate_deg_s.astype(np.float32).astype(np.float64),
        temperature_c=step(frames.temperature_c, 0.01),
        pos_km=step(frames.pos_km, 1e-4),
        vel_km_s=step(frames.vel_km_s, 1e-6),
        row_px=step(frames.row_px + 0.5, 2.0**-8) - 0.5,
        col_px=step(frames.col_px + 0.5, 2.0**-8) - 0.5,
        intensity=frames.intensity.astype(np.float32).astype(np.float64),
    )
