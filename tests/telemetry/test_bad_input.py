"""Everything that comes down broken: a clear reason, file and row, and nothing lost."""

from __future__ import annotations

import errno
import gzip
import json
import os
from pathlib import Path

import numpy as np
import pytest
import telemetry_cases as cases

from stcal.telemetry.quarantine import REASONS

STAR_FAULTS = [
    ({"row_px": "nan"}, "bad_centroid", "row_px is 'nan'"),
    ({"row_px": "NaN"}, "bad_centroid", "row_px"),
    ({"col_px": "inf"}, "bad_centroid", "col_px"),
    ({"row_px": ""}, "bad_centroid", "row_px is ''"),
    ({"col_px": "12,5"[:2] + "x"}, "bad_centroid", "col_px is '12x'"),
    ({"row_px": "0x10"}, "bad_centroid", "row_px"),
    ({"row_px": "1e400"}, "bad_centroid", "row_px"),
    ({"row_px": "1_0"}, "bad_centroid", "row_px"),
    ({"row_px": "-0.51"}, "outside_detector", "-0.5 to 1943.5"),
    ({"row_px": "1943.6"}, "outside_detector", "1943.6"),
    ({"col_px": "2591.51"}, "outside_detector", "-0.5 to 2591.5"),
    ({"exposure": "2"}, "bad_exposure", "exposure is '2'"),
    ({"exposure": ""}, "bad_exposure", "exposure is ''"),
    ({"exposure": "-1"}, "bad_exposure", "exposure"),
    ({"exposure": "0.5"}, "bad_exposure", "exposure"),
    ({"intensity": "bright"}, "bad_intensity", "'bright'"),
    ({"intensity": "nan"}, "bad_intensity", "'nan'"),
    ({"star_id": "HIP"}, "bad_star_id", "'HIP'"),
    ({"star_id": "HIP 0"}, "bad_star_id", "'HIP 0'"),
    ({"star_id": "Sirius"}, "bad_star_id", "'Sirius'"),
]
FRAME_FAULTS = [
    ({"sensor_id": ""}, "bad_sensor_id", "sensor_id is ''"),
    ({"sensor_id": "ST16-" + "9" * 70}, "bad_sensor_id", "64"),
    ({"sensor_id": "ST16-" + "\U0001f6f0" * 16}, "bad_sensor_id", "200 bytes"),
    ({"sensor_id": "ST17-1"}, "unknown_sensor", "'ST17-1'"),
    ({"frame_id": ""}, "bad_frame_id", "''"),
    ({"frame_id": "seven"}, "bad_frame_id", "'seven'"),
    ({"frame_id": "7.5"}, "bad_frame_id", "'7.5'"),
    ({"frame_id": "9" * 19}, "bad_frame_id", "18 digits"),
    ({"time_utc": "05/01/2026 12:00"}, "bad_time", "05/01/2026"),
    ({"time_utc": "2026-01-05T12:00:00"}, "bad_time", "2026-01-05T12:00:00"),
    ({"time_utc": ""}, "bad_time", "''"),
    ({"time_utc": "2026-02-30T12:00:00Z"}, "bad_time", "02-30"),
    ({"time_utc": "2026-01-05T12:00:60Z"}, "bad_time", ":60Z"),
    ({"best_exposure": "2"}, "bad_best_exposure", "'2'"),
    ({"q_x": ""}, "bad_quaternion", "partly empty"),
    ({"q_x": "0", "q_y": "0", "q_z": "0", "q_w": "0"}, "bad_quaternion", "norm is 0"),
    ({"q_w": "0.6"}, "bad_quaternion", "norm is 1.05"),
    ({"q_w": "1e300"}, "bad_quaternion", "norm is inf"),
    ({"q_w": "x"}, "bad_quaternion", "q_w is 'x'"),
    ({"q_w": "nan"}, "bad_quaternion", "q_w is 'nan'"),
    ({"rate_x_deg_s": "fast"}, "bad_rate", "'fast'"),
    ({"temperature_c": "warm"}, "bad_temperature", "'warm'"),
    ({"eclipse": "maybe"}, "bad_flag", "'maybe'"),
    ({"pos_x_km": "1"}, "bad_state", "pos_km is partly empty"),
    ({"vel_z_km_s": "x"}, "bad_state", "'x'"),
]


@pytest.mark.parametrize(("change", "code", "said"), STAR_FAULTS)
def test_a_fault_of_a_star_costs_its_row_only(tmp_path, change, code, said):
    table = cases.rows(4)
    table[2] |= change
    path = cases.write_rows(tmp_path / "a.csv", table)
    store, summary = cases.run(tmp_path, path)
    assert summary.quarantined == {code: 1}
    (record,) = cases.records(store)
    assert (record["source"], record["row"], record["rows"]) == ("a.csv", 4, 1)
    assert (record["sensor_id"], record["frame_id"]) == ("ST16-1", "7")
    assert said in record["detail"]
    assert record["raw"] == path.read_bytes().splitlines()[3]
    back = store.read_frames("ST16-1")
    assert back.row_px.tolist() == [100.25, 110.25, 130.25]


@pytest.mark.parametrize(("change", "code", "said"), FRAME_FAULTS)
def test_a_fault_of_a_frame_costs_the_frame(tmp_path, change, code, said):
    table = cases.frames(3)
    table[3:6] = [row | change for row in table[3:6]]
    path = cases.write_rows(tmp_path / "a.csv", table, cases.OPTIONAL)
    store, summary = cases.run(tmp_path, path)
    assert summary.quarantined == {code: 3}
    found = cases.records(store)
    assert [record["row"] for record in found] == [5, 6, 7]
    assert all(said in record["detail"] for record in found)
    assert [record["raw"] for record in found] == path.read_bytes().splitlines()[4:7]
    assert store.read_frames("ST16-1").frame_id.tolist() == [0, 2]


def test_rows_of_one_frame_that_disagree(tmp_path):
    table = cases.frames(3)
    table[4] |= {"temperature_c": "21"}
    path = cases.write_rows(tmp_path / "a.csv", table)
    store, summary = cases.run(tmp_path, path)
    assert summary.quarantined == {"inconsistent_frame": 3}
    assert "temperature_c" in cases.records(store)[0]["detail"]
    assert "row 5" in cases.records(store)[0]["detail"]
    table[4] |= {"temperature_c": "20.50"}  # the same number in other words
    _, summary = cases.run(tmp_path / "other", cases.write_rows(tmp_path / "b.csv", table))
    assert summary.quarantined == {}


def test_quaternion_within_the_tolerance_is_normalised(tmp_path):
    store, summary = cases.run(
        tmp_path, cases.write_rows(tmp_path / "a.csv", cases.rows(1, q_w="0.5009"))
    )
    assert summary.exit_code == 0
    q = store.read_frames("ST16-1").q_si[0]
    np.testing.assert_allclose(np.linalg.norm(q), 1.0, atol=1e-15)
    np.testing.assert_allclose(q[3] / q[0], 1.0018)


def test_spaces_plus_signs_and_whole_numbers_written_as_decimals(tmp_path):
    change = {"row_px": " +1.5e2 ", "frame_id": "7.0", "best_exposure": "1.0", "exposure": "1.0"}
    store, summary = cases.run(
        tmp_path, cases.write_rows(tmp_path / "a.csv", cases.rows(1, **change))
    )
    assert summary.exit_code == 0
    back = store.read_frames("ST16-1")
    assert (back.row_px[0], back.frame_id[0], back.best_exposure[0]) == (150.0, 7, 1)
    assert back.star_offsets.tolist() == [0, 0, 1]


def test_frames_without_stars_and_with_three(tmp_path):
    blank = dict.fromkeys(("exposure", "row_px", "col_px", "intensity", "star_id"), "")
    table = [*cases.rows(3), cases.ROW | blank | {"frame_id": "8"}]
    store, summary = cases.run(tmp_path, cases.write_rows(tmp_path / "a.csv", table))
    assert summary.exit_code == 0
    assert summary.counts.rows == summary.counts.stored_rows == 4
    back = store.read_frames("ST16-1")
    assert back.frame_id.tolist() == [7, 8]
    assert back.stars_per_exposure.tolist() == [3, 0, 0, 0]


def test_a_frame_whose_stars_are_all_refused_stays_without_stars(tmp_path):
    path = cases.write_rows(tmp_path / "a.csv", cases.rows(2, star_id="?"))
    store, _ = cases.run(tmp_path, path)
    assert store.read_frames("ST16-1").stars_per_exposure.tolist() == [0, 0]


def test_ragged_rows_blank_lines_and_repeated_headers_keep_the_row_numbers(tmp_path):
    header, *lines = cases.csv_text(cases.frames(4, 1)).splitlines()
    text = "\n".join(
        [header, "", lines[0], "one,two", header, lines[1], lines[2] + ",9", "", lines[3][:-3]]
    )
    (tmp_path / "a.csv").write_text(text)
    store, summary = cases.run(tmp_path, tmp_path / "a.csv")
    assert summary.quarantined == {"ragged_row": 3}
    found = cases.records(store)
    assert [record["row"] for record in found] == [4, 7, 9]
    assert found[0]["raw"] == b"one,two"
    assert "2 fields, the header has 17" in found[0]["detail"]
    assert store.read_frames("ST16-1").frame_id.tolist() == [0, 1]
    warnings = summary.sources[0].warnings
    assert any("header" in text for text in warnings)
    assert any("does not end with a newline" in text for text in warnings)


def test_quotes_windows_line_ends_and_a_byte_order_mark(tmp_path):
    header, *lines = cases.csv_text(cases.frames(3, 1)).splitlines()
    quoted = ",".join(f'"{field}"' for field in lines[1].split(","))
    text = "\r\n".join(["\ufeff" + header, lines[0], quoted, lines[2]]) + "\r\n"
    (tmp_path / "a.csv").write_bytes(text.encode())
    store, summary = cases.run(tmp_path, tmp_path / "a.csv")
    assert summary.exit_code == 0
    assert summary.sources[0].warnings == []
    assert store.read_frames("ST16-1").frame_id.tolist() == [0, 1, 2]


def test_bytes_that_are_no_text(tmp_path):
    header, *lines = cases.csv_text(cases.frames(5, 1)).encode().splitlines()
    lines[1] = lines[1].replace(b"ST16-1", b"ST16-\xe9")
    lines[2] = lines[2].replace(b"0.5", b"0.\r5", 1)
    lines[3] = lines[3].replace(b"20.5", b'"20.5')
    (tmp_path / "a.csv").write_bytes(b"\n".join([header, *lines]) + b"\n")
    store, summary = cases.run(tmp_path, tmp_path / "a.csv")
    assert summary.quarantined == {"bad_encoding": 1, "bad_text": 2}
    found = cases.records(store)
    assert [record["row"] for record in found] == [3, 4, 5]
    assert b"ST16-\xe9" in found[0]["raw"]
    assert store.read_frames("ST16-1").frame_id.tolist() == [0, 4]


def test_unknown_columns_are_named_and_ignored(tmp_path):
    table = [row | {"mode": "x", "": "y"} for row in cases.rows(2)]
    path = cases.write_rows(tmp_path / "a.csv", table, ("mode", "mode", "gain"))
    store, summary = cases.run(tmp_path, path)
    assert summary.exit_code == 0
    assert summary.sources[0].warnings == ["unknown column(s) ignored: mode, mode, gain"]
    assert store.read_frames("ST16-1").n_stars == 2


def json_frame(f: int, seed: int = 0, n: int = 2, **changes: object) -> dict:
    rng = np.random.default_rng(seed)
    stars = [
        {"row_px": rng.uniform(0, 1900), "col_px": 2.0, "intensity": None, "star_id": "HIP 5"}
        for _ in range(n)
    ]
    frame = {
        "sensor_id": "ST16-1",
        "frame_id": f,
        "time_utc": f"2026-01-05T12:00:{f:02d}.000Z",
        "best_exposure": 0,
        "quaternion": [0.5, 0.5, 0.5, 0.5],
        "rate_deg_s": None,
        "temperature_c": 20.5,
        "exposures": [{"exposure": 0, "stars": stars}, {"exposure": 1, "stars": []}],
    }
    return frame | changes


def bad_files() -> dict[str, tuple[bytes, str]]:
    text = cases.csv_text(cases.frames(3))
    header, body = text.split("\n", 1)
    short = "\n".join(line.split(",", 2)[2] for line in text.splitlines())
    packed = gzip.compress(text.encode())
    flipped = packed[:-6] + bytes([packed[-6] ^ 1]) + packed[-5:]
    return {
        "empty.csv": (b"", "is empty"),
        "empty.csv.gz": (gzip.compress(b""), "is empty"),
        "cut-at-once.csv.gz": (packed[:12], "empty"),
        "missing.csv": (short.encode(), "missing column(s): sensor_id, frame_id"),
        "twice.csv": (f"{header},q_x\n{body}".encode(), "more than once: q_x"),
        "utf16.csv": (text.encode("utf-16"), "UTF-16"),
        "utf16-be.csv": (text.encode("utf-16-be"), "binary"),
        "latin.csv": (b"sensor_id,\xe9\n", "not UTF-8"),
        "junk.csv": (bytes(range(256)) * 50, "binary"),
        "junk.jsonl": (bytes(range(255, 0, -1)) * 50, "not UTF-8"),
        "packed.csv": (b"PK\x03\x04" + b"\x01" * 100, "zip"),
        "flipped.csv.gz": (flipped, "damaged"),
        "array.jsonl": (f"[{json.dumps(json_frame(0))}]".encode(), "a JSON array, not JSON Lines"),
        "spread.jsonl": (json.dumps([json_frame(0)], indent=1).encode(), "a JSON array"),
        "no-frames.jsonl": (b"\xef\xbb\xbf [\n]\n", "a JSON array"),
        "note.txt": (b"hello\n", "not telemetry"),
        "header.csv": (b"a,b,c\n1,2,3\n", "missing column(s): sensor_id, frame_id, time_utc"),
    }


@pytest.mark.parametrize("name", bad_files())
def test_a_file_that_cannot_be_used_is_named_and_the_others_go_on(tmp_path, name):
    content, said = bad_files()[name]
    (tmp_path / name).write_bytes(content)
    good = cases.write_rows(tmp_path / "good.csv", cases.frames(3))
    store, summary = cases.run(tmp_path, tmp_path / name, good)
    assert summary.exit_code == 3
    bad, fine = summary.sources
    assert name in bad.error
    assert said in bad.error
    assert fine.error is None
    assert store.read_frames("ST16-1").n_frames == 3
    assert not list(store.root.glob("quarantine/*"))


def test_a_path_that_is_not_there_and_an_empty_folder(tmp_path):
    (tmp_path / "folder").mkdir()
    _, summary = cases.run(tmp_path, tmp_path / "no.csv", tmp_path / "folder")
    assert summary.exit_code == 3
    assert "no.csv: cannot be read: No such file" in summary.errors[0]
    assert "folder: a folder without" in summary.errors[1]


def test_garbage_before_json_lines_costs_its_line_only(tmp_path):
    (tmp_path / "a.jsonl").write_text('["sensor_id", 2]\n' + json.dumps(json_frame(0)) + "\n")
    store, summary = cases.run(tmp_path, tmp_path / "a.jsonl")
    assert summary.quarantined == {"bad_json": 1}
    assert store.read_frames("ST16-1").n_frames == 1


def unusable(folder):
    """Return sources that the file system itself refuses, with what is said of each."""
    (folder / "loop.csv").symlink_to(folder / "back.csv")
    (folder / "back.csv").symlink_to(folder / "loop.csv")
    os.mkfifo(folder / "pipe.csv")
    return {
        folder / "loop.csv": "loop.csv: cannot be read: Too many levels",
        folder / "pipe.csv": "pipe.csv: is not a regular file",
        folder / ("n" * 300): "cannot be read: File name too long",
        folder / "good.csv" / "x.csv": "cannot be read: Not a directory",
    }


def test_what_the_file_system_refuses_is_an_error_of_that_source_only(tmp_path):
    good = cases.write_rows(tmp_path / "good.csv", cases.frames(3))
    expected = unusable(tmp_path)
    store, summary = cases.run(tmp_path, *expected, good)
    assert summary.exit_code == 3
    for said, source in zip(expected.values(), summary.sources, strict=False):
        assert said in source.error
    assert summary.sources[-1].error is None
    assert store.read_frames("ST16-1").n_frames == 3


def test_sources_without_permission_are_errors_of_their_own(tmp_path, monkeypatch):
    good = cases.write_rows(tmp_path / "good.csv", cases.frames(3))
    closed = cases.write_rows(tmp_path / "closed.csv", cases.frames(3))
    (tmp_path / "folder").mkdir()

    def refusing(function, refused):
        def call(path, *arguments, **options):
            if os.fspath(path) == str(refused):
                raise PermissionError(errno.EACCES, "Permission denied", str(path))
            return function(path, *arguments, **options)

        return call

    monkeypatch.setattr("pathlib.Path.open", refusing(Path.open, closed))
    monkeypatch.setattr("os.listdir", refusing(os.listdir, tmp_path / "folder"))
    store, summary = cases.run(tmp_path, closed, tmp_path / "folder", good)
    assert summary.errors == [
        f"{closed}: cannot be read: Permission denied",
        f"{tmp_path / 'folder'}: cannot be read: Permission denied",
    ]
    assert store.read_frames("ST16-1").n_frames == 3


def test_names_that_are_not_utf8_are_written_as_escapes(tmp_path):
    folder = tmp_path / os.fsdecode(b"pass\xff")
    folder.mkdir()
    cases.write_rows(
        folder / os.fsdecode(b"a\xff.csv"), [*cases.rows(2), cases.ROW | {"row_px": "x"}]
    )
    (folder / os.fsdecode(b"b\xfe.csv")).write_text("")
    cases.write_rows(folder / os.fsdecode(b"c\xfe.csv"), cases.rows(1))
    seen = []
    store, summary = cases.run(
        tmp_path, folder, progress=lambda name, done, total: seen.append(name)
    )
    assert [source.path.name for source in summary.sources] == [
        "a\\xff.csv",
        "b\\xfe.csv",
        "c\\xfe.csv",
    ]
    assert summary.errors == [f"{tmp_path}/pass\\xff/b\\xfe.csv: the file is empty"]
    assert {record["source"] for record in cases.records(store)} == {"a\\xff.csv", "c\\xfe.csv"}
    assert seen[:2] == ["a\\xff.csv", "b\\xfe.csv"]
    json.dumps(summary.document(), ensure_ascii=False).encode()


def test_header_alone_is_no_error(tmp_path):
    _, summary = cases.run(tmp_path, cases.write_rows(tmp_path / "a.csv", []))
    assert summary.exit_code == 0
    assert summary.sources[0].warnings == ["the file holds no rows"]


@pytest.mark.parametrize("keep", [0.3, 0.6, 0.95])
def test_truncated_gzip_keeps_the_frames_before_the_cut(tmp_path, keep):
    rng = np.random.default_rng(0)
    table = cases.frames(40)
    for row in table:
        row["intensity"] = f"{rng.uniform(1, 1000):.6f}"
    whole = cases.csv_text(table).encode()
    packed = gzip.compress(whole)
    (tmp_path / "cut.csv.gz").write_bytes(packed[: int(len(packed) * keep)])
    store, summary = cases.run(tmp_path, tmp_path / "cut.csv.gz")
    assert summary.exit_code == 3
    assert "is cut" in summary.errors[0]
    found = cases.records(store)
    assert {record["code"] for record in found} == {"truncated"}
    last = min(int(record["row"]) for record in found)
    back = store.read_frames("ST16-1")
    assert back.frame_id.tolist() == list(range((last - 2) // 3))
    assert back.n_stars == last - 2
    # Nothing between: the refused rows follow the stored ones, to where the stream ends.
    refused = b"\n".join(record["raw"] for record in found)
    assert whole.splitlines()[last - 1 :][0] in refused or refused in whole
    assert [record["row"] for record in found] == list(range(last, last + len(found)))


def test_truncated_json_lines_lose_the_cut_line_only(tmp_path):
    lines = [json.dumps(json_frame(f, seed=f)) for f in range(40)]
    packed = gzip.compress("\n".join(lines).encode())
    (tmp_path / "cut.jsonl.gz").write_bytes(packed[: len(packed) // 2])
    store, summary = cases.run(tmp_path, tmp_path / "cut.jsonl.gz")
    assert summary.exit_code == 3
    n = store.read_frames("ST16-1").n_frames
    (record,) = cases.records(store)
    assert (record["code"], record["row"]) == ("truncated", n + 1)
    assert lines[n].encode().startswith(record["raw"])


BROKEN_LINES = {
    "{": ("bad_json", "not JSON"),
    "[1, 2]": ("bad_json", "not a JSON object"),
    '{"a": 1, "a": 2}': ("bad_json", "given twice"),
    "[" * 100_000: ("bad_json", "not JSON"),
    json.dumps(json_frame(1, exposures=None)): ("bad_json", "exposures is not a list"),
    json.dumps(json_frame(1, exposures=[{"exposure": 0}])): ("bad_json", "list of stars"),
    json.dumps(json_frame(1, exposures=[{"exposure": 0, "stars": [None]}])): (
        "bad_json",
        "a star is not an object",
    ),
    json.dumps(json_frame(1, quaternion=[1, 2, 3])): ("bad_json", "quaternion"),
    json.dumps(json_frame(1, quaternion=[0, 0, 0, 0])): ("bad_quaternion", "norm is 0"),
    json.dumps(json_frame(1, frame_id="x")): ("bad_frame_id", "'x'"),
    json.dumps(json_frame(1, frame_id=10**30)): ("bad_frame_id", "18 digits"),
    json.dumps(json_frame(1, time_utc=None)): ("bad_time", "''"),
    json.dumps(json_frame(1, sensor_id="ST17")): ("unknown_sensor", "ST17"),
    json.dumps(json_frame(1, sensor_id="ST16-\ud800")): ("bad_sensor_id", "ud800"),
    json.dumps(json_frame(1, temperature_c=True)): ("bad_temperature", "true"),
    json.dumps(json_frame(1, temperature_c=[1])): ("bad_temperature", "[1]"),
}


@pytest.mark.parametrize("line", BROKEN_LINES, ids=lambda line: line[:40])
def test_a_broken_json_line_costs_that_line_only(tmp_path, line):
    code, said = BROKEN_LINES[line]
    lines = [json.dumps(json_frame(0)), line, "", json.dumps(json_frame(2))]
    (tmp_path / "a.jsonl").write_text("\n".join(lines))
    store, summary = cases.run(tmp_path, tmp_path / "a.jsonl")
    (record,) = cases.records(store)
    assert (record["code"], record["row"]) == (code, 2)
    assert said in record["detail"]
    assert record["raw"] == line.encode()
    assert store.read_frames("ST16-1").frame_id.tolist() == [0, 2]
    assert summary.counts.rows == 4 + record["rows"]
    assert summary.counts.quarantined_rows == record["rows"]


@pytest.mark.parametrize("value", ["NaN", '"x"', "null", "-3.0", "[]", "1e999", "true"])
def test_a_broken_star_in_json_costs_that_star_only(tmp_path, value):
    text = json.dumps(json_frame(0, n=3)).replace('"col_px": 2.0', f'"col_px": {value}', 1)
    (tmp_path / "a.jsonl").write_text(text + "\n" + json.dumps(json_frame(1)) + "\n")
    store, _ = cases.run(tmp_path, tmp_path / "a.jsonl")
    (record,) = cases.records(store)
    assert record["code"] == ("outside_detector" if value == "-3.0" else "bad_centroid")
    assert record["row"] == 1
    assert record["raw"] == text.encode()
    stars = [star for exposure in json_frame(0, n=3)["exposures"] for star in exposure["stars"]]
    broken = next(i for i, star in enumerate(stars) if star["col_px"] == 2.0)
    assert record["detail"].startswith(f"star {broken + 1}: col_px is ")
    assert store.read_frames("ST16-1").stars_per_exposure.tolist() == [2, 0, 2, 0]


@pytest.mark.parametrize("tail", ["", "{"], ids=["fast", "careful"])
def test_the_line_of_broken_stars_is_in_quarantine_once_a_reason(tmp_path, tail):
    frame = json_frame(0, n=3)
    star = {"row_px": 5000.0, "col_px": 1.0, "intensity": 9.5, "star_id": None}
    frame["exposures"][1]["stars"] = [star | {"row_px": 1.0}, star, star]
    (tmp_path / "a.jsonl").write_text(json.dumps(frame) + "\n" + tail)
    store, summary = cases.run(tmp_path, tmp_path / "a.jsonl")
    (record,) = (r for r in cases.records(store) if r["code"] == "outside_detector")
    assert json.loads(record["raw"]) == frame
    place = len(frame["exposures"][0]["stars"]) + 2
    assert record["detail"].startswith(f"star {place}: row_px is 5000")
    assert "and 1 more" in record["detail"]
    assert (record["rows"], summary.quarantined["outside_detector"]) == (2, 2)


def test_the_careful_reader_gives_the_same_rows_as_the_fast_one(tmp_path):
    lines = [json.dumps(json_frame(f, seed=f, n=f % 4)) for f in range(20)]
    (tmp_path / "a.jsonl").write_text("\n".join(lines))
    (tmp_path / "b.jsonl").write_text("\n".join([*lines, "{"]))
    fast, _ = cases.run(tmp_path / "fast", tmp_path / "a.jsonl")
    slow, summary = cases.run(tmp_path / "slow", tmp_path / "b.jsonl")
    assert summary.quarantined == {"bad_json": 1}
    cases.assert_same_frames(fast.read_frames("ST16-1"), slow.read_frames("ST16-1"))


def test_unknown_json_keys_are_named(tmp_path):
    frame = json_frame(0) | {"mode": "x", "\udcff": 1}
    frame["exposures"][0]["stars"][0]["snr"] = 5
    (tmp_path / "a.jsonl").write_text(json.dumps(frame) + "\n")
    (tmp_path / "b.jsonl").write_text(json.dumps(frame) + "\n{\n")
    _, summary = cases.run(tmp_path, tmp_path / "a.jsonl", tmp_path / "b.jsonl")
    for source in summary.sources:
        assert set(source.warnings) == {
            f"unknown key ignored: {key}" for key in ("mode", "snr", "\\udcff")
        }


def test_unknown_lists_with_nulls_do_no_harm(tmp_path):
    lines = [json.dumps(json_frame(f) | ({"gyro": [None, 0.5]} if f else {})) for f in range(3)]
    (tmp_path / "a.jsonl").write_text("\n".join(lines) + "\n")
    store, summary = cases.run(tmp_path, tmp_path / "a.jsonl")
    assert summary.sources[0].warnings == ["unknown key ignored: gyro"]
    assert store.read_frames("ST16-1").n_frames == 3


def test_every_reason_is_in_the_table():
    codes = {code for _, code, _ in STAR_FAULTS + FRAME_FAULTS}
    codes |= {code for code, _ in BROKEN_LINES.values()}
    codes |= {"ragged_row", "bad_encoding", "bad_text", "inconsistent_frame", "truncated"}
    # Of packets, of foreign tables and of the order of frames: tested with these.
    codes |= {"packet_sync", "packet_crc", "packet_length", "packet_segmented", "match_index"}
    codes |= {"bad_lists", "time_backwards", "conflict"}
    assert codes == set(REASONS)
