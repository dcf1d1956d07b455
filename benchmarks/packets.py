"""Time packet telemetry: decoding a stream with 20 stars a packet, and its whole ingest.

Peers on the same stream: space-packet-parser with our XTCE definition, and ccsdspy, whose arrays
hold one kind of number, so that it gets the stars as bare 16-bit words and checks no CRC.
"""

from __future__ import annotations

import argparse
import io
import json
import logging
import tempfile
import time
from pathlib import Path

import numpy as np
from timing import available

from stcal.config import load_config
from stcal.frames import FrameBatch
from stcal.telemetry.ingest import ingest
from stcal.telemetry.packet_decode import decode_packets, find_places, make_program
from stcal.telemetry.packet_layout import PacketLayout, parse_layout
from stcal.telemetry.packet_stream import frame_blocks
from stcal.telemetry.packet_writer import encode_packets
from stcal.telemetry.packet_xtce import xtce
from stcal.telemetry.store import Store

ROOT = Path(__file__).parents[1]
STARS = 20
T0_NS = 1_767_614_437_000_000_000
LAYOUT = """
schema = "stcal.packet-layout/1"
name = "benchmark"
error_control = "crc-16"
apids = { "ST16-1" = 321 }
time = { code = "CUC", epoch = "1958-01-01T00:00:00", scale = "TAI", fine_bytes = 2 }
fields = [
  { name = "frame_id", type = "u32" },
  { name = "q_x", type = "f32", empty = nan },
  { name = "q_y", type = "f32", empty = nan },
  { name = "q_z", type = "f32", empty = nan },
  { name = "q_w", type = "f32", empty = nan },
  { name = "temperature_c", type = "i16", scale = 0.01, unit = "degC" },
  { name = "n", type = "u16" },
  { list = "stars", name = "stars", count = "n", maximum = 24, exposure = 0, fields = [
    { name = "row_px", type = "u16", scale = 0.03125, unit = "px" },
    { name = "col_px", type = "u16", scale = 0.0625, unit = "px" },
    { name = "intensity", type = "u16", unit = "counts" },
    { name = "star_id", type = "u32", encoding = "hip-tyc" },
  ] },
]
"""


def make_frames(n: int) -> FrameBatch:
    """Return frames with 20 stars in the first exposure."""
    rng = np.random.default_rng(1)
    q = rng.normal(size=(n, 4))
    none = np.full((n, 3), np.nan)
    stars = n * STARS
    return FrameBatch(
        sensor_id="ST16-1",
        frame_id=np.arange(n),
        t_tai_ns=T0_NS + np.arange(n) * 10**9,
        best_exposure=np.zeros(n, np.int8),
        q_si=q / np.linalg.norm(q, axis=1)[:, None],
        rate_deg_s=none,
        temperature_c=rng.normal(20, 5, n),
        eclipse=np.zeros(n, np.bool_),
        intrusion=np.zeros(n, np.bool_),
        pos_km=none,
        vel_km_s=none,
        star_offsets=np.repeat(np.arange(n + 1) * STARS, 2)[1:],
        row_px=rng.uniform(0, 1943, stars),
        col_px=rng.uniform(0, 2591, stars),
        intensity=np.round(rng.uniform(10, 60_000, stars)),
        star_id=rng.integers(1, 118_000, stars),
    )


def timed(function, runs: int) -> float:
    """Return the median of several runs in seconds."""
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def decode(layout: PacketLayout, raw: bytes) -> int:
    """Frame, check and decode a stream; return its packets."""
    program = make_program(layout)
    parts = (raw[i : i + (1 << 20)] for i in range(0, len(raw), 1 << 20))
    packets = 0
    for block in frame_blocks(layout, program, parts, is_log=False):
        places = find_places(program, block.data, block.start, block.total)
        decoded = decode_packets(layout, block.data, places)
        packets += len(decoded.t_tai_ns)
    return packets


def space_packet_parser_rate(layout: PacketLayout, raw: bytes, packets: int) -> float:
    """Return packets a second."""
    import space_packet_parser as spp

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "layout.xml"
        path.write_text(xtce(layout))
        definition = spp.load_xtce(path)
    part = raw[: len(raw) // packets * 2000]

    def run():
        for one in spp.ccsds_generator(io.BytesIO(part)):
            definition.parse_bytes(one)

    return 2000 / timed(run, 1)


def ccsdspy_rate(raw: bytes, packets: int) -> float:
    """Return packets a second."""
    import ccsdspy

    logging.getLogger("ccsdspy").setLevel(logging.ERROR)
    field, array = ccsdspy.PacketField, ccsdspy.PacketArray
    definition = ccsdspy.VariableLength(
        [
            field(name="coarse", data_type="uint", bit_length=32),
            field(name="fine", data_type="uint", bit_length=16),
            field(name="frame_id", data_type="uint", bit_length=32),
            *(field(name=f"q_{a}", data_type="float", bit_length=32) for a in "xyzw"),
            field(name="temperature", data_type="int", bit_length=16),
            field(name="n", data_type="uint", bit_length=16),
            array(name="stars", data_type="uint", bit_length=16, array_shape="expand"),
            field(name="crc", data_type="uint", bit_length=16),
        ]
    )
    part = raw[: len(raw) // packets * 20_000]
    return 20_000 / timed(lambda: definition.load(io.BytesIO(part)), 1)


def peer_rates(layout: PacketLayout, raw: bytes, packets: int) -> dict[str, float | str]:
    """Return each peer's packets a second, or why it is missing."""
    peers = {
        "space-packet-parser": lambda: space_packet_parser_rate(layout, raw, packets),
        "ccsdspy (stars as words, no CRC)": lambda: ccsdspy_rate(raw, packets),
    }
    rates, missing = available(peers)
    return {name: rates.get(name, missing.get(name)) for name in peers}


def ingest_rate(layout: PacketLayout, raw: bytes, packets: int) -> float:
    """Return packets a second of the whole ingest into a new store."""
    config = load_config(ROOT / "configs" / "st16.toml")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.ccsds"
        path.write_bytes(raw)

        def run():
            store = Store.open(Path(folder) / "store", create=True)
            summary = ingest([path], store, [config], packets=layout)
            assert summary.counts.frames == packets, summary.document()

        return packets / timed(run, 1)


def main() -> None:
    """Print the rates, and write them as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--packets", type=int, default=200_000)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    layout, n = parse_layout(LAYOUT.encode(), "benchmark"), arguments.packets
    raw = encode_packets(layout, make_frames(n))
    assert decode(layout, raw) == n  # compiles the kernels
    document = {
        "packets": n,
        "bytes": len(raw),
        "stars_per_packet": STARS,
        "decode_packets_s": n / timed(lambda: decode(layout, raw), 5),
        "ingest_packets_s": ingest_rate(layout, raw, n),
        "peers": peer_rates(layout, raw, n),
    }
    print(
        f"{n} packets of {len(raw) // n} bytes, {STARS} stars each: decoded at "
        f"{document['decode_packets_s']:.0f} packets/s "
        f"({document['decode_packets_s'] * len(raw) / n / 1e6:.0f} MB/s), ingested at "
        f"{document['ingest_packets_s']:.0f}"
    )
    for peer, rate in document["peers"].items():
        print(f"  {peer}: {rate if isinstance(rate, str) else f'{rate:.0f} packets/s'}")
    if arguments.json:
        arguments.json.write_text(json.dumps(document, indent=1))


if __name__ == "__main__":
    main()
