"""Downlinks that unfold without end, and sensors whose names would lead elsewhere."""

import gzip
import json
import os
import re
from pathlib import Path

import pytest

from stcal.config import load_config
from stcal.telemetry.ingest import ingest
from stcal.telemetry.packet_layout import load_layout
from stcal.telemetry.store import Store

ROOT = Path(__file__).parents[2]
CONFIG = load_config(ROOT / "configs" / "st16.toml").model_copy(update={"sensor_ids": ["*"]})
LAYOUT = load_layout(ROOT / "configs" / "packets" / "st16.toml")
HEADER = b"sensor_id,frame_id,time_utc,best_exposure,q_x,q_y,q_z,q_w,rate_x_deg_s,rate_y_deg_s,"
HEADER += b"rate_z_deg_s,temperature_c,exposure,row_px,col_px,intensity,star_id\n"
BOMB_BYTES = (256 if os.environ.get("STCAL_CHAOS") == "1" else 4) << 20
# Some blocks and a window of refused rows, whatever the file's length.
MOST_BYTES = 500 << 20
BOMBS = {
    "line.csv.gz": (HEADER, b"x"),
    "nulls.csv.gz": (HEADER, b"\0"),
    "newlines.csv.gz": (HEADER, b"\n"),
    "short.csv.gz": (HEADER, b"x\n"),
    "open.jsonl.gz": (b"", b"["),
    "deep.jsonl.gz": (b"", b'{"a":' * 20_000 + b"\n"),
    "zeros.ccsds.gz": (b"\x09\x41\xc0\x00\xff\xff", b"\0"),
    "log.bin.gz": (b"COSMOS5_", b"\xff"),
}


def memory_bytes(name):
    status = Path("/proc/self/status").read_text()
    return int(re.search(rf"{name}:\s+(\d+) kB", status)[1]) << 10


@pytest.mark.parametrize("name", BOMBS)
def test_a_gzip_bomb_does_not_fill_the_memory(tmp_path, name):
    head, piece = BOMBS[name]
    block = piece * ((1 << 20) // len(piece))
    path = tmp_path / name
    with gzip.open(path, "wb", 1) as stream:
        stream.write(head)
        # Half a million refused rows a MiB tell enough.
        for _ in range(1 if name == "short.csv.gz" else BOMB_BYTES >> 20):
            stream.write(block)
    store = Store.open(tmp_path / "store", create=True)
    try:
        Path("/proc/self/clear_refs").write_text("5")  # the peak starts anew
    except OSError:
        pytest.skip("the peak of the memory cannot be measured here")
    before = memory_bytes("VmRSS")
    packets = LAYOUT if name.endswith((".ccsds.gz", ".bin.gz")) else None
    summary = ingest([path], store, [CONFIG], packets=packets)
    counts = summary.counts
    assert memory_bytes("VmHWM") - before < MOST_BYTES
    assert counts.new_frames == 0
    assert counts.rows == counts.quarantined_rows
    assert all(name in error for error in summary.errors)


STAY = ["../../x", "/etc/x", "..", ".", "a/b", "C:\\x", "~", "$HOME", "%2e%2e", "sensor=ST16-1"]
GO = ["", "\0", "a\0b", "\n", "\x1b[2J", "x" * 65, "\u202e" + "x", "☾" * 64, "\ud800"]


def frame(sensor, number):
    return {"sensor_id": sensor, "frame_id": number, "time_utc": f"2026-01-05T12:00:{number:02d}Z",
            "best_exposure": None, "quaternion": None, "rate_deg_s": None, "temperature_c": None,
            "exposures": [{"stars": []}, {"stars": []}]}  # fmt: skip


def test_names_of_sensors(tmp_path):
    """Each is a folder of its own in the store, or goes to quarantine."""
    inside = tmp_path / "in"
    inside.mkdir()
    path = inside / "a.jsonl"
    frames = [frame(sensor, i) for i, sensor in enumerate(STAY + GO)]
    path.write_text("".join(json.dumps(one) + "\n" for one in frames))
    store = Store.open(inside / "store", create=True)
    counts = ingest([path], store, [CONFIG]).counts
    assert store.sensors() == sorted(STAY)
    assert counts.new_frames == len(STAY)
    assert counts.quarantined_rows == counts.rows - counts.stored_rows > 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["in"]
    assert len(list((store.root / "frames").iterdir())) == len(STAY)
    for sensor in STAY:
        assert store.read_frames(sensor).n_frames == 1
