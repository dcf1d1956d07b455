"""Days kept in memory end as if every window had been merged on disk."""

from __future__ import annotations

import random
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
import telemetry_cases as cases

from stcal.telemetry import parquet
from stcal.telemetry.days import Days
from stcal.telemetry.schema import StoredFrames
from stcal.telemetry.store import Store

WHOLE = cases.batch(200, mean=2.0)  # two and a half days


def windows(seed):
    """Return frames as windows of one day and sensor each: repeated, in versions, out of order."""
    rng = np.random.default_rng(seed)
    listed = []
    for k in range(25):
        first = int(rng.integers(0, 190))
        index = np.flatnonzero(rng.random(200) < 0.3) if rng.random() < 0.2 else None
        chosen = WHOLE.take(np.arange(first, first + 10) if index is None else index)
        if rng.random() < 0.3:
            chosen = replace(chosen, temperature_c=np.round(chosen.temperature_c + k, 1))
        day = (chosen.t_tai_ns - cases.T0_NS) // (86_400 * cases.SECOND_NS)
        for number in np.unique(day).tolist():
            part = chosen.take(day == number)
            sources = np.full(part.n_frames, f"{k}", dtype=object)
            frames = StoredFrames(part, sources, sources, np.arange(part.n_frames))
            listed.append((f"2026-01-{5 + number:02}", frames))
    return listed


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("maximum_rows", [0, 300, 10**9])
def test_same_store_and_outcomes_as_merging_on_disk(tmp_path, seed, maximum_rows):
    on_disk = Store.open(tmp_path / "disk", create=True)
    in_memory = Store.open(tmp_path / "memory", create=True)
    expected = [on_disk.merge_day(day, frames).outcome for day, frames in windows(seed)]
    with Days.filling(in_memory, maximum_rows) as days:
        found = [days.merge(day, frames) for day, frames in windows(seed)]
    assert {int(code) for outcome in expected for code in outcome} == {0, 1, 2, 3}
    for one, other in zip(expected, found, strict=True):
        np.testing.assert_array_equal(one, other)
    assert cases.snapshot(in_memory.root) == cases.snapshot(on_disk.root)


@contextmanager
def counted_writes(monkeypatch):
    """Count how often a day is written."""
    written: list[str] = []
    write = parquet.write

    def noted(path, table, **options):
        written.append(path.parent.name)
        write(path, table, **options)

    monkeypatch.setattr(parquet, "write", noted)
    yield written
    monkeypatch.setattr(parquet, "write", write)


def test_many_files_of_a_day_write_it_once(tmp_path, monkeypatch):
    table = cases.frames(40)
    files = [
        cases.write_rows(tmp_path / f"{k:02}.csv", table[3 * k : 3 * k + 3]) for k in range(40)
    ]
    with counted_writes(monkeypatch) as written:
        store, summary = cases.run(tmp_path, *files)
    assert written == ["day=2026-01-05"]
    assert summary.counts.new_frames == store.read_frames("ST16-1").n_frames == 40


def test_what_was_merged_before_an_error_is_written(tmp_path):
    store = Store.open(tmp_path / "store", create=True)
    (day, frames), *_ = windows(0)

    def merge_and_fail():
        with Days.filling(store, 10**9) as days:
            days.merge(day, frames)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        merge_and_fail()
    assert store.read_frames("ST16-1").n_frames == frames.frames.n_frames


def test_workers_change_nothing(tmp_path):
    """Neither the store nor what is said of good, bad, cut and unusable files."""
    rng = random.Random(3)
    files = []
    for k in range(12):
        rows = [dict(row) for row in cases.frames(30) if rng.random() < 0.9]
        for row in rng.sample(rows, 3):
            row["row_px"] = "nan"
        files.append(cases.write_rows(tmp_path / f"{k:02}.csv", rows))
    files[3].write_text("no telemetry\n")
    files[5].write_bytes(files[5].read_bytes()[:-20])
    files[7] = tmp_path / "missing.csv"
    documents, stores = [], []
    for workers in (1, 3):
        store, summary = cases.run(tmp_path / str(workers), *files, workers=workers, window_rows=40)
        documents.append(summary.document())
        stores.append(cases.snapshot(store.root))
    assert documents[0] == documents[1]
    assert stores[0] == stores[1]
    assert len(documents[0]["errors"]) == 2
