"""Retry: what a later configuration accepts leaves the quarantine, as if ingested with it."""

from __future__ import annotations

import json

import pytest
import telemetry_cases as cases

from stcal.telemetry.retry import retry


def wide():
    """The ST-16 with a larger detector, and another type of sensor."""
    other = cases.config().model_copy(update={"sensor_ids": ["OTHER-*"], "name": "other"})
    return [cases.config(rows=5000), other]


def table():
    """Rows of which some are good with another configuration, and some never."""
    rows = cases.frames(8)
    rows[4]["row_px"] = "3000"  # the star alone
    for row in rows[6:9]:
        row["row_px"] = str(2000 + 10 * float(row["row_px"]))  # every star of its frame
    rows[10]["row_px"], rows[11]["row_px"] = "3000", "9000"
    rows[13]["temperature_c"] = "99"  # the frame, whatever the configuration
    for row in rows[15:18]:
        row["sensor_id"] = "OTHER-1"
    rows[19]["col_px"] = "x"
    return rows


def source(folder, suffix=".csv"):
    path = folder / f"a{suffix}"
    if suffix == ".csv":
        return cases.write_rows(path, table())
    frames: dict[tuple, dict] = {}
    for row in table():
        key = row["sensor_id"], row["frame_id"]
        frame = frames.setdefault(
            key,
            {
                "sensor_id": key[0],
                "frame_id": int(key[1]),
                "time_utc": row["time_utc"],
                "best_exposure": 0,
                "quaternion": [0.5] * 4,
                "exposures": [{"exposure": 0, "stars": []}],
            },
        )
        star = {name: _number(row[name]) for name in ("row_px", "col_px", "intensity")}
        frame["exposures"][0]["stars"].append(star)
    path.write_text("".join(json.dumps(frame) + "\n" for frame in frames.values()))
    return path


def _number(text):
    return float(text) if text.replace(".", "").isdigit() else text


@pytest.mark.parametrize("suffix", [".csv", ".jsonl"])
def test_retry_ends_in_the_store_of_an_ingest_again(tmp_path, suffix):
    path = source(tmp_path, suffix)
    cases.run(tmp_path / "again", path)
    again, _ = cases.run(tmp_path / "again", path, configs=wide())
    store, _ = cases.run(tmp_path / "retry", path)
    before = len(cases.records(store))
    (result,) = retry(store, wide())
    assert cases.snapshot(store.root) == cases.snapshot(again.root)
    after = [record for record in cases.records(store) if record["code"] != "conflict"]
    assert 0 < len(after) < before
    assert result.kept == sum(record["rows"] for record in after)
    assert store.read_frames("OTHER-1").n_stars == 3
    assert 3000 in store.read_frames("ST16-1").row_px


@pytest.mark.parametrize("suffix", [".csv", ".jsonl"])
def test_retry_is_idempotent_and_changes_nothing_by_itself(tmp_path, suffix):
    store, _ = cases.run(tmp_path, source(tmp_path, suffix))
    before = cases.snapshot(store.root)
    (result,) = retry(store)
    assert cases.snapshot(store.root) == before
    assert result.frames == 0
    assert result.kept == result.refused
    retry(store, wide())
    after = cases.snapshot(store.root)
    retry(store)
    retry(store, wide())
    assert cases.snapshot(store.root) == after


def test_a_star_joins_its_own_source_version_among_displaced_ones(tmp_path):
    """The frame of the source lost against another one; its refused star makes it the better."""
    rows = cases.frames(1, 5)
    mine = [dict(row) for row in rows[:3]]
    mine += [dict(rows[3]) | {"row_px": "3000"}, dict(rows[4]) | {"row_px": "3100"}]
    mine.append(dict(rows[4]) | {"row_px": "3200"})
    a = cases.write_rows(tmp_path / "a.csv", mine)
    b = cases.write_rows(tmp_path / "b.csv", rows[:4])
    store, _ = cases.run(tmp_path / "retry", a, b)
    assert store.read_frames("ST16-1").n_stars == 4
    retry(store, wide())
    assert store.read_frames("ST16-1").n_stars == 6
    again, _ = cases.run(tmp_path / "again", a, b)
    again, _ = cases.run(tmp_path / "again", a, b, configs=wide())
    assert cases.snapshot(store.root) == cases.snapshot(again.root)


def test_one_source_by_name(tmp_path):
    one = cases.write_rows(tmp_path / "a.csv", cases.rows(2, row_px="3000"))
    two = cases.write_rows(tmp_path / "b.csv", cases.rows(2, row_px="3000", frame_id="8"))
    store, _ = cases.run(tmp_path, one, two)
    results = retry(store, wide(), "b.csv")
    assert [result.source for result in results] == ["b.csv"]
    assert store.read_frames("ST16-1").frame_id.tolist() == [7, 8]
    assert {record["source"] for record in cases.records(store)} == {"a.csv", "b.csv"}
    left = [r["source"] for r in cases.records(store) if r["code"] != "conflict"]
    assert set(left) == {"a.csv"}


def test_killed_at_every_replacement(tmp_path, monkeypatch):
    """Stop after the k-th file that appears, for every k: nothing may be gone."""
    from stcal import atomic

    path = source(tmp_path)
    reference, _ = cases.run(tmp_path / "reference", path)
    retry(reference, wide())
    write = atomic.write_with
    for steps in range(100):
        left = [steps]

        def counted(path, writer, left=left):
            if left[0] == 0:
                raise KeyboardInterrupt
            left[0] -= 1
            write(path, writer)

        store, _ = cases.run(tmp_path / str(steps), path)
        held = {record["raw"] for record in cases.records(store)}
        monkeypatch.setattr(atomic, "write_with", counted)
        finished = True
        try:
            retry(store, wide())
        except KeyboardInterrupt:
            finished = False
        monkeypatch.setattr(atomic, "write_with", write)
        gone = held - {record["raw"] for record in cases.records(store)}
        rows = {float(raw.split(b",")[13]) for raw in gone}
        stored = set(store.read_frames("ST16-1").row_px)
        if "OTHER-1" in store.sensors():
            stored |= set(store.read_frames("OTHER-1").row_px)
        assert rows <= stored, "a record left before its frame was in the store"
        retry(store, wide())
        assert cases.snapshot(store.root) == cases.snapshot(reference.root)
        if finished:
            break
    assert steps > 3


def test_a_star_that_is_in_the_store_already(tmp_path):
    """What a kill leaves between the frame and its record's leaving: the star comes again."""
    rows = cases.frames(1, 3)
    rows[0] |= {"row_px": "3000", "intensity": "9999"}  # the first in the store's order
    store, _ = cases.run(tmp_path, cases.write_rows(tmp_path / "a.csv", rows))
    (path,) = store.root.glob("quarantine/*.parquet")
    record = path.read_bytes()
    retry(store, wide())
    before = cases.snapshot(store.root)
    path.write_bytes(record)
    (result,) = retry(store)
    assert (result.kept, result.frames) == (0, 0)
    assert cases.snapshot(store.root) == before


def test_refused_rows_of_two_versions_are_not_taken_for_one_frame(tmp_path):
    """Side by side in quarantine, but not in the source, and their temperatures differ."""
    first, second = (cases.rows(3, temperature_c=text) for text in ("20", "21"))
    first[2]["row_px"], second[0]["row_px"] = "3000", "3100"
    rows = [*first, *cases.frames(2)[3:], *second]
    path = cases.write_rows(tmp_path / "a.csv", rows)
    store, _ = cases.run(tmp_path / "retry", path)
    assert [r["row"] for r in cases.records(store) if r["code"] != "conflict"] == [4, 8]
    (result,) = retry(store, wide())
    assert result.kept == 0
    again, _ = cases.run(tmp_path / "again", path)
    again, _ = cases.run(tmp_path / "again", path, configs=wide())
    assert cases.snapshot(store.root) == cases.snapshot(again.root)
