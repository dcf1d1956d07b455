"""Make the sample downlinks of sample_telemetry/ from its telemetry, always the same bytes.

    python tools/sample_downlink.py

ST16-2.downlink.ccsds: 150 frames as packets; eight are lost, one comes twice.
ST16-2.damaged.ccsds: 40 frames with a flipped bit, a dropped byte, and junk.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from stcal.atomic import write_bytes
from stcal.config import load_config
from stcal.frames import FrameBatch
from stcal.telemetry.ingest import ingest
from stcal.telemetry.packet_layout import load_layout
from stcal.telemetry.packet_writer import encode_packets
from stcal.telemetry.store import Store

ROOT = Path(__file__).parents[1]
SAMPLE = ROOT / "sample_telemetry"
FIRST_SEQUENCE = 16_300  # the 14-bit count wraps within the file


def frames_of(path: Path) -> FrameBatch:
    """Return the frames of a telemetry file."""
    with tempfile.TemporaryDirectory() as folder:
        store = Store.open(Path(folder) / "store", create=True)
        ingest([path], store, [load_config(ROOT / "configs" / "st16.toml")])
        return store.read_frames("ST16-2")


def cut(stream: bytes) -> list[bytes]:
    """Return the packets of a stream without damage."""
    packets, place = [], 0
    while place < len(stream):
        total = int.from_bytes(stream[place + 4 : place + 6], "big") + 7
        packets.append(stream[place : place + total])
        place += total
    return packets


def damaged(packets: list[bytes]) -> bytes:
    """Return a stream with a flipped bit, a dropped byte, and junk between packets."""
    packets = list(packets)
    packets[5] = packets[5][:40] + bytes([packets[5][40] ^ 0x10]) + packets[5][41:]
    packets[17] = packets[17][:60] + packets[17][61:]
    packets[29] = b"\x1a\xcf\xfc\x1d" + bytes(20) + packets[29]
    return b"".join(packets)


def main() -> None:
    """Write both files."""
    layout = load_layout(ROOT / "configs" / "packets" / "st16.toml")
    frames = frames_of(SAMPLE / "ST16-2.validation.csv.gz")
    packets = cut(encode_packets(layout, frames, FIRST_SEQUENCE))
    sent = packets[:60] + packets[68:100] + [packets[99]] + packets[100:]
    write_bytes(SAMPLE / "ST16-2.downlink.ccsds", b"".join(sent))
    write_bytes(SAMPLE / "ST16-2.damaged.ccsds", damaged(packets[:40]))


if __name__ == "__main__":
    main()
