"""The store does not depend on the order of the files, nor on how often they come."""

from __future__ import annotations

import itertools
import random

import pyarrow.parquet as pq
import pytest
import telemetry_cases as cases

from stcal.telemetry.configurations import recorded_for
from stcal.telemetry.store import Store
from stcal.telemetry.writer import write_csv, write_jsonl


def downloads(folder):
    """Overlapping downloads of one sensor, with versions that differ, and rows that are bad."""
    table = cases.frames(12)
    weak = [row for i, row in enumerate(table) if i % 3 or i > 20]
    moved = [row | {"col_px": "321.5"} if row["frame_id"] == "5" else row for row in table]
    bad = [row | {"star_id": "?"} if row["frame_id"] in "348" else row for row in table]
    other = cases.rows(2, sensor_id="ST16-2", time_utc="2026-01-07T00:00:00Z")
    return [
        cases.write_rows(folder / "a.csv", table[:24]),
        cases.write_rows(folder / "b.csv", weak[6:]),
        cases.write_rows(folder / "c.csv", moved),
        cases.write_rows(folder / "d.csv", bad + other),
        cases.write_rows(folder / "e.csv", weak[5:30]),
    ]


@pytest.mark.parametrize("order", list(itertools.permutations(range(5)))[::13])
def test_any_order_ends_in_the_same_bytes(tmp_path, order):
    files = downloads(tmp_path)
    reference, _ = cases.run(tmp_path / "reference", *files)
    store, _ = cases.run(tmp_path / "one", *(files[i] for i in order))
    assert cases.snapshot(store.root) == cases.snapshot(reference.root)
    # One by one, some of them again.
    for i in (*order, order[0], order[2]):
        store, _ = cases.run(tmp_path / "by-one", files[i])
    assert cases.snapshot(store.root) == cases.snapshot(reference.root)
    conflicts = {r["content_sha256"] for r in cases.records(store) if r["code"] == "conflict"}
    assert len(conflicts) > 5


def test_twice_is_once(tmp_path):
    files = downloads(tmp_path)
    store, first = cases.run(tmp_path, *files)
    before = cases.snapshot(store.root)
    times = {path: path.stat().st_mtime_ns for path in store.root.rglob("frames.parquet")}
    store, again = cases.run(tmp_path, *files)
    assert cases.snapshot(store.root) == before
    assert {path: path.stat().st_mtime_ns for path in times} == times, "days were rewritten"
    assert again.counts.new_frames == again.counts.replaced_frames == 0
    assert again.counts.rows == first.counts.rows
    assert again.counts.duplicate_frames + again.counts.conflicting_frames == again.counts.frames


def test_a_file_under_two_names(tmp_path):
    a, b = (cases.write_rows(tmp_path / n, cases.rows(2, star_id="?")) for n in ("a.csv", "b.csv"))
    one, _ = cases.run(tmp_path / "ab", a, b)
    two, _ = cases.run(tmp_path / "ba", b, a)
    assert cases.snapshot(one.root) == cases.snapshot(two.root)
    assert {record["source"] for record in cases.records(two)} == {"a.csv"}


def test_the_version_with_more_stars_is_kept_and_the_other_recorded(tmp_path):
    few = cases.write_rows(tmp_path / "few.csv", cases.frames(3)[:-1])
    many = cases.write_rows(tmp_path / "many.csv", cases.frames(3))
    store, _ = cases.run(tmp_path, few)
    store, summary = cases.run(tmp_path, many)
    assert summary.counts.replaced_frames == 1
    assert store.read_frames("ST16-1").n_stars == 9
    (record,) = cases.records(store)
    assert (record["source"], record["row"], record["code"]) == ("few.csv", 8, "conflict")
    assert record["frame_id"] == "2"
    assert b'"row_px": 100.25' in record["raw"]
    _, summary = cases.run(tmp_path, few)
    assert summary.quarantined == {"conflict": 2}
    assert summary.counts.duplicate_frames == 2


def test_later_configuration_empties_the_quarantine_of_the_same_file(tmp_path):
    path = cases.write_rows(tmp_path / "a.csv", cases.rows(2, sensor_id="OTHER-1"))
    store, summary = cases.run(tmp_path, path)
    assert summary.quarantined == {"unknown_sensor": 2}
    other = cases.config().model_copy(update={"sensor_ids": ["OTHER-*"]})
    store, summary = cases.run(tmp_path, path, configs=[cases.config(), other])
    assert summary.exit_code == 0
    assert cases.records(store) == []
    assert store.sensors() == ["OTHER-1"]


def test_sources_of_a_frame_are_kept(tmp_path):
    path = cases.write_rows(tmp_path / "a.csv", cases.frames(2))
    store, summary = cases.run(tmp_path, path)
    (fragment,) = store.root.glob("frames/*/*/*.parquet")
    rows = pq.ParquetFile(fragment).read().to_pylist()
    assert [(row["source"], row["source_row"]) for row in rows] == [("a.csv", 2), ("a.csv", 5)]
    assert {row["source_sha256"] for row in rows} == {summary.sources[0].sha256}
    assert [str(row["time_utc"]) for row in rows][1] == "2026-01-05 12:00:40+00:00"


def test_a_folder_gives_its_telemetry_files_once(tmp_path):
    folder = tmp_path / "pass"
    folder.mkdir()
    frames = cases.batch()
    write_jsonl([frames.take(frames.frame_id < 10)], folder / "2.jsonl.gz")
    write_csv([frames.take(frames.frame_id >= 10)], folder / "1.csv.gz")
    (folder / "notes.txt").write_text("no telemetry")
    store, summary = cases.run(tmp_path, folder, folder / "1.csv.gz")
    assert [source.path.name for source in summary.sources] == ["1.csv.gz", "2.jsonl.gz"]
    assert store.read_frames("ST16-1").n_frames == 30


def test_content_hash_is_of_the_content(tmp_path):
    frames = cases.batch(200)
    write_csv([frames], tmp_path / "a.csv", decimals=None)
    parts = [frames.take(frames.frame_id % 3 == i) for i in range(3)]
    write_jsonl(parts, tmp_path / "b.jsonl", decimals=None)
    a, _ = cases.run(tmp_path / "a", tmp_path / "a.csv")
    b, _ = cases.run(tmp_path / "b", tmp_path / "b.jsonl")
    assert a.sha256("ST16-1") == b.sha256("ST16-1")
    middle = int(frames.t_tai_ns[100])
    assert a.sha256("ST16-1", start_tai_ns=middle) == b.sha256("ST16-1", start_tai_ns=middle)
    assert a.sha256("ST16-1", start_tai_ns=middle) != a.sha256("ST16-1")
    assert a.sha256("ST16-1", start_tai_ns=middle) != a.sha256("ST16-1", start_tai_ns=middle + 1)


def test_random_splits_end_in_the_same_frames(tmp_path):
    frames = cases.batch(60)
    rng = random.Random(5)
    for k in range(4):
        low = rng.randrange(0, 40)
        write_csv([frames.take(frames.frame_id >= low)], tmp_path / f"{k}.csv", decimals=None)
    write_csv([frames], tmp_path / "all.csv", decimals=None)
    cases.run(tmp_path, *(tmp_path / f"{k}.csv" for k in range(4)), tmp_path / "all.csv")
    cases.assert_same_frames(Store.open(tmp_path / "store").read_frames("ST16-1"), frames)


def test_the_configurations_are_recorded_for_later_commands(tmp_path):
    path = cases.write_rows(tmp_path / "a.csv", cases.rows(2))
    store, _ = cases.run(tmp_path, path)
    assert recorded_for(store.root, "ST16-1") == cases.config()


CHANGES = {
    "best_exposure": "1",
    "temperature_c": "21",
    "rate_x_deg_s": "0.5",
    "q_x": "-0.5",
    "exposure": "1",
    "row_px": "7",
    "col_px": "7",
    "intensity": "7",
    "star_id": "HIP 7",
    "eclipse": "1",
    "intrusion": "1",
    "pos_x_km": "7001",
    "vel_z_km_s": "1",
}


@pytest.mark.parametrize("name", CHANGES)
def test_versions_differ_in_any_value(tmp_path, name):
    state = {"pos_x_km": "7000", "pos_y_km": "0", "pos_z_km": "0"}
    row = cases.ROW | state | {"vel_x_km_s": "0", "vel_y_km_s": "7", "vel_z_km_s": "0"}
    a = cases.write_rows(tmp_path / "a.csv", [row], cases.OPTIONAL)
    b = cases.write_rows(tmp_path / "b.csv", [row | {name: CHANGES[name]}], cases.OPTIONAL)
    ab, summary = cases.run(tmp_path / "ab", a, b)
    counts = summary.counts
    assert (counts.duplicate_frames, counts.replaced_frames + counts.conflicting_frames) == (0, 1)
    ba, _ = cases.run(tmp_path / "ba", b, a)
    assert cases.snapshot(ab.root) == cases.snapshot(ba.root)


def test_the_two_zeros_are_one_value(tmp_path):
    zeros = {"row_px": "0.0", "rate_x_deg_s": "0", "temperature_c": "0"}
    a = cases.write_rows(tmp_path / "a.csv", [cases.ROW | zeros])
    minus = {name: f"-{text}" for name, text in zeros.items()}
    b = cases.write_rows(tmp_path / "b.csv", [cases.ROW | minus])
    ab, summary = cases.run(tmp_path / "ab", a, b)
    assert summary.counts.duplicate_frames == 1
    ba, _ = cases.run(tmp_path / "ba", b, a)
    assert cases.snapshot(ab.root) == cases.snapshot(ba.root)


def test_a_record_of_the_kept_version_is_taken_back(tmp_path):
    """What a kill leaves between the record of a loser and the day without it."""
    few = cases.write_rows(tmp_path / "few.csv", cases.frames(3)[:-1])
    many = cases.write_rows(tmp_path / "many.csv", cases.frames(3))
    only_few, _ = cases.run(tmp_path / "reference", few)
    killed, _ = cases.run(tmp_path, few, many)
    for path in killed.root.glob("frames/*/*/*"):
        path.write_bytes((only_few.root / path.relative_to(killed.root)).read_bytes())
    assert [record["code"] for record in cases.records(killed)] == ["conflict"]
    store, _ = cases.run(tmp_path, few)
    assert cases.records(store) == []
