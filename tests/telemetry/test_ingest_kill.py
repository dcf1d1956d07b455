"""kill -9 at any moment: the store stays readable, and running again completes it."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time

import telemetry_cases as cases
from test_mapping import ROOT, few_stars, star_table, write_parquet

from stcal.telemetry.content import frame_digests
from stcal.telemetry.store import Store

WINDOW = 100
# A few by default, as all replacements are gone through below; STCAL_KILLS=200 for the long form.
KILLS = int(os.environ.get("STCAL_KILLS", "6"))
# Everything that writes to a store: downloads, a foreign table, and records tried again.
CODE = f"""
import sys
from pathlib import Path
import telemetry_cases as cases
from stcal.telemetry.ingest import ingest
from stcal.telemetry.mapping import load_mapping
from stcal.telemetry.retry import retry
from stcal.telemetry.store import Store
root, mapping, *files = map(Path, sys.argv[1:])
mapping, small = load_mapping(mapping), cases.config(rows=150)
print("ready", flush=True)
store = Store.open(root, create=True)
with cases.small_blocks(4000):
    for path in files:
        foreign = mapping if path.suffix == ".parquet" else None
        ingest([path], store, [small], window_rows={WINDOW}, mapping=foreign)
    retry(store, [cases.config()])
"""


def downloads(folder):
    """Files over several days that overlap, differ and hold bad rows; windows cut them."""
    table = [
        row | {"time_utc": row["time_utc"].replace("-05T", f"-{5 + day:02d}T")}
        for day in range(3)
        for row in cases.frames(12)
    ]
    files = []
    for k in range(6):
        rng = random.Random(k)
        part = [dict(row) for row in table if rng.random() < 0.9]
        for row in rng.sample(part, 10):
            row["row_px"] = "nan"
        files.append(cases.write_rows(folder / f"{k}.csv", part))
    return files


def foreign(folder):
    """A table of another tool with frames of other days."""
    batch = few_stars(8, 2.0)
    path = folder / "z.parquet"
    write_parquet(star_table(batch.take(batch.frame_id < 12)), path)
    return path


def start(root, files):
    mapping = ROOT / "parquet-stars.toml"
    command = [sys.executable, "-c", CODE, str(root), str(mapping), *map(str, files)]
    here = os.pathsep.join([str(cases.ROOT / "tests" / "telemetry"), str(cases.ROOT)])
    environment = {**os.environ, "PYTHONPATH": here}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    process.stdout.readline()
    return process


def frames_on_disk(root):
    """Return the frames of a store that may not be finished; everything in it must be whole."""
    if not (root / "store.json").exists():
        return set()
    store = Store.open(root)
    store.quarantine()
    if "ST16-1" not in store.sensors() or not store._days("ST16-1"):
        return set()
    frames = store.read_frames("ST16-1")
    return set(zip(frames.frame_id.tolist(), frames.t_tai_ns.tolist(), strict=True))


def versions_on_disk(root):
    """Return the content hashes of the frames kept and of those that lost."""
    store = Store.open(root)
    lost = {record["content_sha256"] for record in cases.records(store)} - {None}
    return lost | set(frame_digests(store.read_frames("ST16-1")))


def test_killed_at_random_moments(tmp_path):
    files = [*downloads(tmp_path), foreign(tmp_path)]
    process = start(tmp_path / "reference", files)
    began = time.monotonic()
    assert process.wait() == 0
    took = time.monotonic() - began
    reference = cases.snapshot(tmp_path / "reference")
    assert any("conflicts" in name for name in reference)
    rng = random.Random(0)
    root, killed, known = tmp_path / "store", 0, set()
    while killed < KILLS:
        # In any order, some of them twice.
        process = start(root, [*rng.sample(files, len(files)), *rng.sample(files, 2)])
        # The first is cut short, so that the store is not complete at once.
        time.sleep(rng.uniform(0, took) if killed else 0.02)
        process.send_signal(signal.SIGKILL)
        if process.wait() == -signal.SIGKILL:
            killed += 1
        else:  # it was done before: a quicker machine than a moment ago
            took *= 0.95
        now = frames_on_disk(root)
        assert known <= now, "frames were lost"
        known = now
    for order in (files, files[::-1]):
        assert start(root, order).wait() == 0
        assert cases.snapshot(root) == reference
    assert not [path for path in root.rglob(".stcal-*") if os.path.exists(path)]


def test_killed_at_every_replacement(tmp_path, monkeypatch):
    """Stop after the k-th file that appears, for every k: what a kill there would leave."""
    from stcal import atomic

    files = downloads(tmp_path)[:2]
    with cases.small_blocks(4000):
        reference, _ = cases.run(tmp_path / "reference", *files, window_rows=WINDOW)
    write = atomic.write_with
    steps, known = 0, set()
    while True:
        left = [steps]

        def counted(path, writer, left=left):
            if left[0] == 0:
                raise KeyboardInterrupt
            left[0] -= 1
            write(path, writer)

        monkeypatch.setattr(atomic, "write_with", counted)
        folder = tmp_path / str(steps)
        finished = True
        try:
            with cases.small_blocks(4000):
                cases.run(folder, *files, window_rows=WINDOW)
        except KeyboardInterrupt:
            finished = False
        monkeypatch.setattr(atomic, "write_with", write)
        frames = frames_on_disk(folder / "store")
        versions = versions_on_disk(folder / "store") if frames else set()
        assert known <= versions, "a version was lost between two files"
        known = versions
        refused = sum(r["rows"] for r in cases.records(Store(folder / "store"))) if frames else 0
        assert not frames or refused > 0, "frames came before their quarantine"
        with cases.small_blocks(4000):
            cases.run(folder, *files, window_rows=WINDOW)
        assert cases.snapshot(folder / "store") == cases.snapshot(reference.root)
        if finished:
            break
        steps += 1
    assert steps > 8
