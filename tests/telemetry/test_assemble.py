"""Rows to frames: pieces of a frame, copies of it, and versions that differ."""

from __future__ import annotations

import json
import random

import pytest
import telemetry_cases as cases
from test_bad_input import json_frame


def stored(tmp_path, table, name="a"):
    path = cases.write_rows(tmp_path / f"{name}.csv", table)
    store, summary = cases.run(tmp_path / name, path)
    assert summary.counts.rows == len(table)
    return store, summary


def test_shuffled_rows_give_the_same_frames(tmp_path):
    table = cases.frames(20)
    table[30:33] = [row | {"exposure": "1"} for row in table[30:33]]
    shuffled = table.copy()
    random.Random(1).shuffle(shuffled)
    a, _ = stored(tmp_path, table, "a")
    b, summary = stored(tmp_path, shuffled, "b")
    assert (summary.counts.new_frames, summary.counts.stored_rows) == (20, 60)
    cases.assert_same_frames(a.read_frames("ST16-1"), b.read_frames("ST16-1"))
    assert a.sha256("ST16-1") == b.sha256("ST16-1")


@pytest.mark.parametrize("shuffle", [False, True])
def test_copies_in_one_file_are_duplicates(tmp_path, shuffle):
    table = cases.frames(10) * 2 + cases.frames(3)
    if shuffle:
        random.Random(2).shuffle(table)
    store, summary = stored(tmp_path, table)
    counts = summary.counts
    assert (counts.frames, counts.new_frames, counts.duplicate_frames) == (23, 10, 13)
    assert (counts.stored_rows, counts.duplicate_rows) == (30, 39)
    assert summary.quarantined == {}
    assert store.read_frames("ST16-1").n_stars == 30


def test_copies_that_follow_each_other(tmp_path):
    _, summary = stored(tmp_path, cases.rows(3) + cases.rows(3))
    assert (summary.counts.new_frames, summary.counts.duplicate_frames) == (1, 1)


def test_frames_without_stars_given_twice(tmp_path):
    blank = cases.ROW | dict.fromkeys(("exposure", "row_px", "col_px", "intensity", "star_id"), "")
    _, summary = stored(tmp_path, [blank, blank, blank | {"frame_id": "8"}])
    assert (summary.counts.new_frames, summary.counts.duplicate_frames) == (2, 1)
    assert (summary.counts.stored_rows, summary.counts.duplicate_rows) == (2, 1)


@pytest.mark.parametrize("between", [0, 2])
def test_a_version_with_another_star_is_a_conflict_not_a_further_star(tmp_path, between):
    other = cases.rows(4)
    other[3] |= {"row_px": "999"}
    table = [*cases.rows(4), *cases.frames(between, 1), *other]
    store, summary = stored(tmp_path, table)
    assert summary.quarantined == {"conflict": 4}
    assert store.read_frames("ST16-1").n_stars == 4 + between


def test_a_version_with_every_centroid_moved_is_told_by_its_identifiers(tmp_path):
    first = [row | {"star_id": f"HIP {i + 1}"} for i, row in enumerate(cases.rows(3))]
    moved = [row | {"col_px": "300"} for row in first]
    _, summary = stored(tmp_path, [*first, *cases.frames(1, 1), *moved])
    assert summary.quarantined == {"conflict": 3}
    assert summary.counts.stars == 4


def test_one_identifier_given_twice_is_a_false_match_in_a_shuffled_file(tmp_path):
    table = [
        row | {"star_id": f"HIP {i + 1}"} for i, row in enumerate(cases.rows(8, frame_id="99"))
    ]
    table[7]["star_id"] = table[2]["star_id"]
    table = [row for pair in zip(table, cases.frames(8, 1), strict=True) for row in pair]
    store, summary = stored(tmp_path, table)
    assert summary.quarantined == {}
    assert store.read_frames("ST16-1").n_stars == 16


def test_the_exposure_that_steps_back_begins_another_version(tmp_path):
    first = [*cases.rows(2), *cases.rows(2, exposure="1")]
    other = [*cases.rows(2), *cases.rows(2, exposure="1")]
    other[0] |= {"row_px": "555"}
    store, summary = stored(tmp_path, [*first, *other])
    assert summary.quarantined == {"conflict": 4}
    assert store.read_frames("ST16-1").stars_per_exposure.tolist() == [2, 2]


def test_another_time_is_another_frame(tmp_path):
    later = cases.rows(2, time_utc="2026-01-06T12:00:00Z")
    store, summary = stored(tmp_path, [*cases.rows(2), *cases.frames(1), *later])
    assert summary.counts.new_frames == 3
    assert sorted(store.read_frames("ST16-1").frame_id.tolist()) == [0, 7, 7]
    assert len(store.fragments("ST16-1")) == 2


def test_json_lines_never_join(tmp_path):

    one, other = json_frame(0, seed=1), json_frame(0, seed=2, n=3)
    (tmp_path / "a.jsonl").write_text("\n".join(map(json.dumps, (one, other, one))))
    store, summary = cases.run(tmp_path, tmp_path / "a.jsonl")
    assert store.read_frames("ST16-1").n_stars == 3
    counts = summary.counts
    assert (counts.new_frames, counts.conflicting_frames) == (1, 2)


def test_windows_do_not_cut_frames(tmp_path, monkeypatch):
    monkeypatch.setattr("stcal.telemetry.windows.HELD_ROWS", 45)
    table = cases.frames(80)
    # Rows that are out of order by less than what is held.
    table = [row for i in range(0, 240, 20) for row in shuffled(table[i : i + 20])]
    path = cases.write_rows(tmp_path / "a.csv", table)
    whole, _ = cases.run(tmp_path / "whole", path)
    with cases.small_blocks(1000):
        cut, summary = cases.run(tmp_path / "cut", path, window_rows=300)
    assert (summary.counts.rows, summary.counts.stored_rows) == (240, 240)
    cases.assert_same_frames(whole.read_frames("ST16-1"), cut.read_frames("ST16-1"))


def shuffled(table):
    return random.Random(3).sample(table, len(table))


def test_rows_farther_apart_than_a_window_are_kept_as_a_conflict(tmp_path, monkeypatch):
    monkeypatch.setattr("stcal.telemetry.windows.HELD_ROWS", 3)
    table = [*cases.rows(3), *cases.frames(60), cases.rows(4)[3]]
    path = cases.write_rows(tmp_path / "a.csv", table)
    with cases.small_blocks(1000):
        store, summary = cases.run(tmp_path, path, window_rows=40)
    assert summary.quarantined == {"conflict": 1}
    assert cases.records(store)[0]["row"] == 185
    assert summary.counts.stored_rows == 183
