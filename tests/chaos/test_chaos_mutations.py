"""Mutated downlinks of every format: ingest ends, tells of damage, and loses no row uncounted."""

import gzip
import os
import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from chaos_scene import LONG, ROOT, snapshot

from stcal.config import load_config
from stcal.frames import FrameBatch
from stcal.telemetry.cosmos import log_of
from stcal.telemetry.ingest import ingest
from stcal.telemetry.mapping import load_mapping
from stcal.telemetry.packet_layout import load_layout
from stcal.telemetry.packet_writer import encode_packets
from stcal.telemetry.store import Store
from stcal.telemetry.writer import write_csv, write_jsonl

CASES = int(os.environ.get("STCAL_MUTATIONS", "10000" if LONG else "70"))
NAMES = ("a.csv", "a.csv.gz", "packed.csv.gz", "a.jsonl", "a.ccsds", "log.bin", "a.tsv")
CONFIG = load_config(ROOT / "configs" / "st16.toml")
LAYOUT = load_layout(ROOT / "configs" / "packets" / "st16.toml")
YAMCS = load_mapping(ROOT / "configs" / "mappings" / "yamcs.toml")
PIECES = (
    b"\0", b"\0" * 300, b"\xff", b"\xed\xa0\x80", b"\xef\xbb\xbf", b'"', b"\n", b"\r", b"\r\n\n",
    b"9" * 400, b"-1", b"1e999", b"9223372036854775808", b"nan", b"null", b"x" * 70_000,
    b"," * 5000, b"[" * 20_000, b'{"a":' * 20_000, b"}", b"\\ud800", b"2026-13-45T99:99:99Z",
    b"ST16-1", b"../../x", b"\xff\xff\xff\xff", b"\x7f\xff\xff\xff\xff\xff\xff\xff", b"COSMOS5_",
)  # fmt: skip


def frames() -> FrameBatch:
    """Return 12 frames, two exposures each, of 0 to 4 stars."""
    rng, count = np.random.default_rng(3), 12
    stars = rng.integers(0, 5, 2 * count)
    total = int(stars.sum())
    return FrameBatch(
        sensor_id="ST16-1",
        frame_id=np.arange(count),
        t_tai_ns=1_767_614_437_000_000_000 + 60_000_000_000 * np.arange(count),
        best_exposure=np.zeros(count, np.int8),
        q_si=np.tile([0.5, 0.5, 0.5, 0.5], (count, 1)),
        rate_deg_s=np.full((count, 3), 0.01),
        temperature_c=np.full(count, 20.0),
        eclipse=np.zeros(count, bool),
        intrusion=np.zeros(count, bool),
        pos_km=np.full((count, 3), np.nan),
        vel_km_s=np.full((count, 3), np.nan),
        star_offsets=np.concatenate([[0], np.cumsum(stars)]),
        row_px=rng.uniform(10, 1900, total),
        col_px=rng.uniform(10, 2500, total),
        intensity=rng.uniform(1000, 2000, total),
        star_id=np.full(total, 27989),
    )


def yamcs_export() -> bytes:
    names = ["Time", "/ST16/FRAME_ID", "/ST16/BEST_EXPOSURE", "/ST16/Q"]
    names += [f"/ST16/RATE_{axis}" for axis in "XYZ"] + ["/ST16/TEMPERATURE"]
    names += [f"/ST16/E0/{name}" for name in ("ROW", "COL", "INTENSITY", "HIP")]
    names += ["/ST16/E1/STARS", *(f"/ST16/E1/{n}[{i}]" for n in ("ROW", "COL") for i in range(4))]
    lines = ["\t".join(names)]
    for f in range(12):
        numbers = [f"2026-01-05T12:{f:02d}:00.5Z", f, 0, "[0.5, 0.5, 0.5, 0.5]", 0.1, "", 0.2, 293]
        lists = ["[1.5, 20.5]", "[30.5, 400.5]", "[1000, 1001]", "[27989, 0]"]
        lines.append("\t".join(map(str, [*numbers, *lists, 1, 5.5, 0, 0, 0, 6.5, 0, 0, 0])))
    return "\n".join(lines).encode() + b"\n"


def split_packets(stream: bytes) -> list[bytes]:
    packets = []
    while stream:
        length = int.from_bytes(stream[4:6], "big") + 7
        packets.append(stream[:length])
        stream = stream[length:]
    return packets


@pytest.fixture(scope="module")
def downlinks(tmp_path_factory):
    """Every downlink's content, whole, by its name."""
    folder = tmp_path_factory.mktemp("whole")
    write_csv([frames()], folder / "a.csv")
    write_jsonl([frames()], folder / "a.jsonl")
    text, stream = (folder / "a.csv").read_bytes(), encode_packets(LAYOUT, frames())
    packets = [(10**18 + k, packet) for k, packet in enumerate(split_packets(stream))]
    return {
        "a.csv": text,
        "a.csv.gz": text,
        "packed.csv.gz": gzip.compress(text, mtime=0),
        "a.jsonl": (folder / "a.jsonl").read_bytes(),
        "a.ccsds": stream,
        "log.bin": log_of(packets, "SAT", "STARS", received_ns=3),
        "a.tsv": yamcs_export(),
    }


def mutate(content: bytes, rng: np.random.Generator) -> bytes:
    """Flip, insert, remove, repeat, move or overwrite at one to five places."""
    for _ in range(int(rng.integers(1, 6))):
        place, other = sorted(rng.integers(0, len(content) + 1, 2).tolist())
        near = min(len(content), place + int(rng.integers(1, 40)))
        piece = PIECES[int(rng.integers(len(PIECES)))]
        flipped = bytes(b ^ (1 << int(rng.integers(8))) for b in content[place : place + 1])
        changes = (
            (flipped, place + 1),
            (piece, place),
            (piece, min(len(content), place + len(piece))),
            (b"", near),
            (b"", other),
            (content[place:near] * 2, near),
            (content[other:][:200], place),
            (rng.bytes(int(rng.integers(1, 30))), near),
        )
        new, stop = changes[int(rng.integers(len(changes)))]
        content = content[:place] + new + content[stop:]
    return content


@cache
def options(name: str) -> dict[str, object]:
    if name == "a.tsv":
        return {"mapping": YAMCS}
    return {"packets": LAYOUT} if name in ("a.ccsds", "log.bin") else {}


def accounted(path: Path, window_rows: int, twice: bool) -> None:
    """Ingest a file and check that its rows are all somewhere, and the store readable.

    ``twice``: check too that the same file again changes nothing.
    """
    store = Store.open(path.parent / "store", create=True)
    summary = ingest([path], store, [CONFIG], window_rows=window_rows, **options(path.name))
    counts = summary.counts
    for error in summary.errors:
        assert path.name in error
        assert len(error) < 2000, error[:300]
    assert counts.rows == counts.stored_rows + counts.duplicate_rows + counts.quarantined_rows
    assert counts.quarantined_rows == sum(summary.quarantined.values())
    in_store = sum(store.read_frames(sensor).n_frames for sensor in store.sensors())
    assert in_store == counts.new_frames
    if not twice:
        return
    left = snapshot(store.root)
    ingest([path], store, [CONFIG], window_rows=window_rows, **options(path.name))
    assert snapshot(store.root) == left


@pytest.mark.parametrize("name", NAMES)
def test_mutated_downlinks(downlinks, tmp_path, name):
    """The names of a file's failures are its seeds; what is kept of it fits its rows."""
    for seed in range(-(-CASES // len(NAMES))):
        content = mutate(downlinks[name], np.random.default_rng([seed, NAMES.index(name)]))
        folder = tmp_path / str(seed)
        folder.mkdir()
        path = folder / name
        path.write_bytes(gzip.compress(content, 1) if name == "a.csv.gz" else content)
        try:
            accounted(path, 7 if seed % 2 else 500_000, twice=seed % 5 == 0)
        except BaseException as error:
            error.add_note(f"seed {seed} of {name}")
            raise
        shutil.rmtree(folder)


def test_whole_downlinks_lose_nothing(downlinks, tmp_path):
    for name, content in downlinks.items():
        path = tmp_path / name / name
        path.parent.mkdir()
        path.write_bytes(gzip.compress(content) if name == "a.csv.gz" else content)
        store = Store.open(path.parent / "store", create=True)
        summary = ingest([path], store, [CONFIG], **options(name))
        assert (summary.counts.new_frames, summary.exit_code) == (12, 0), (name, summary)
