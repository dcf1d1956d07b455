"""Times that go backwards: what neighbours contradict is refused, seams of downloads are not."""

from __future__ import annotations

import json

import pytest
import telemetry_cases as cases

from stcal.telemetry.retry import retry
from stcal.telemetry.writer import write_jsonl


def at(frame, seconds):
    """Return the two rows of a frame at so many seconds after 12:00."""
    minutes, rest = divmod(seconds, 60)
    time = f"2026-01-05T12:{int(minutes):02d}:{rest:06.3f}Z"
    return cases.rows(2, frame_id=str(frame), time_utc=time)


def table(*frames):
    return [row for frame, seconds in frames for row in at(frame, seconds)]


REFUSED = {
    "back": ([(1, 100), (2, 200), (3, 30), (4, 400)], [3]),
    "ahead": ([(1, 100), (2, 2000), (3, 300), (4, 400)], [2]),
    "back twice": ([(1, 100), (2, 10), (3, 300), (4, 120), (5, 500)], [2, 4]),
    "back to before one only": ([(1, 100), (2, 200), (3, 300), (4, 220), (5, 500)], [4]),
    "ahead of one only": ([(1, 100), (2, 200), (3, 290), (4, 220)], [3]),
    "little": ([(1, 100), (2, 200), (3, 141), (4, 400)], []),
    "repeated": ([(1, 100), (2, 200), (1, 100), (2, 200), (3, 300)], []),
    "earlier download later": ([(8, 800), (9, 900), (1, 100), (2, 200), (3, 300)], []),
    "restarted": ([(1, 1000), (2, 1100), (900, 100), (901, 200)], []),
    "clock set back": ([(1, 1000), (2, 1100), (3, 300), (4, 400)], []),
    "reordered": ([(1, 100), (3, 300), (2, 200), (4, 400)], []),
    "first and last": ([(1, 900), (2, 200), (3, 300), (4, 40)], []),
}


@pytest.mark.parametrize("block_bytes", [700, 10**6])
@pytest.mark.parametrize("name", REFUSED)
def test_which_frames_are_refused(tmp_path, name, block_bytes):
    frames, refused = REFUSED[name]
    path = cases.write_rows(tmp_path / "a.csv", table(*frames))
    with cases.small_blocks(block_bytes):
        store, summary = cases.run(tmp_path, path)
    expected = {"time_backwards": 2 * len(refused)} if refused else {}
    assert summary.quarantined == expected
    found = cases.records(store)
    assert sorted({int(record["frame_id"]) for record in found}) == refused
    lines = path.read_bytes().splitlines()
    assert all(record["raw"] == lines[record["row"] - 1] for record in found)
    kept = store.read_frames("ST16-1").frame_id.tolist()
    assert sorted(kept) == sorted({frame for frame, _ in frames} - set(refused))
    counts = summary.counts
    assert counts.rows == 2 * len(frames)
    assert counts.rows == counts.stored_rows + counts.duplicate_rows + counts.quarantined_rows


def test_sensors_are_judged_apart(tmp_path):
    rows = []
    for frame, seconds in ((1, 100), (2, 200), (3, 300)):
        rows += at(frame, seconds)
        rows += [row | {"sensor_id": "ST16-2"} for row in at(frame, seconds - 195 * (frame == 2))]
        rows += [row | {"sensor_id": "ST16-3"} for row in at(frame, 1000 + seconds)]
    path = cases.write_rows(tmp_path / "a.csv", rows)
    _, summary = cases.run(tmp_path, path)
    assert summary.quarantined == {"time_backwards": 2}


def limited(seconds):
    config = cases.config()
    changed = config.ingest.model_copy(update={"maximum_backwards_s": seconds})
    return config.model_copy(update={"ingest": changed})


@pytest.mark.parametrize("suffix", [".csv", ".jsonl"])
def test_a_larger_limit_takes_them_on_a_retry(tmp_path, suffix):
    rows = table((1, 100), (2, 200), (3, 30), (4, 400), (5, 320), (6, 600))
    rows[5]["col_px"] = "x"  # frame 3, refused for its time: its broken star waits with it
    path = cases.write_rows(tmp_path / "a.csv", rows)
    if suffix == ".jsonl":
        whole, _ = cases.run(tmp_path / "whole", path, configs=[limited(1e6)])
        path = tmp_path / "a.jsonl"
        frames = whole.read_frames("ST16-1")
        write_jsonl([frames.take(frames.frame_id.argsort())], path, decimals=None)
    store, summary = cases.run(tmp_path, path)
    assert summary.quarantined["time_backwards"] == 3
    before = cases.snapshot(store.root)
    retry(store)
    assert cases.snapshot(store.root) == before
    (result,) = retry(store, [limited(100.0)])
    assert result.reasons["time_backwards"] == 1
    assert store.read_frames("ST16-1").frame_id.tolist() == [1, 2, 5, 4, 6]
    retry(store, [limited(200.0)])
    again, _ = cases.run(tmp_path / "again", path)
    again, _ = cases.run(tmp_path / "again", path, configs=[limited(200.0)])
    assert cases.snapshot(store.root) == cases.snapshot(again.root)


def test_neighbours_are_of_the_same_sensor(tmp_path):
    """The last frame of one sensor is not judged by the first of the next."""
    rows = table((1, 100), (2, 200))
    rows += [row | {"sensor_id": "ST16-2"} for row in table((3, 110), (4, 210))]
    _, summary = cases.run(tmp_path, cases.write_rows(tmp_path / "a.csv", rows))
    assert summary.quarantined == {}


def test_a_line_with_a_broken_star_counts_each_row_once(tmp_path):
    lines = []
    for frame, seconds in ((1, 100), (2, 10), (3, 300)):
        stars = [{"row_px": 1.0, "col_px": 1.0}, {"row_px": 9999.0 if frame == 2 else 2.0}]
        stars[1]["col_px"] = 2.0
        document = {
            "sensor_id": "ST16-1",
            "frame_id": frame,
            "time_utc": at(frame, seconds)[0]["time_utc"],
            "exposures": [{"exposure": 0, "stars": stars}],
        }
        lines.append(json.dumps(document))
    (tmp_path / "a.jsonl").write_text("\n".join(lines) + "\n")
    _, summary = cases.run(tmp_path, tmp_path / "a.jsonl")
    assert summary.quarantined == {"outside_detector": 1, "time_backwards": 1}
    assert summary.counts.rows == 6
