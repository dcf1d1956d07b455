"""The store on disk: layout, fragments, versions, locks, damage."""

from __future__ import annotations

import errno
import json
import os
import pickle
import re
import subprocess
import sys

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import telemetry_cases as cases

from stcal.errors import ConfigError, InputError
from stcal.frames import concatenate
from stcal.telemetry.configurations import recorded_for
from stcal.telemetry.fragments import read_fragment
from stcal.telemetry.store import Store
from stcal.telemetry.writer import write_csv
from stcal.times import parse_utc


@pytest.fixture
def filled(tmp_path):
    frames = cases.batch(200)
    write_csv([frames], tmp_path / "a.csv", decimals=None)
    store, _ = cases.run(tmp_path, tmp_path / "a.csv")
    return store, frames


def test_partitions_by_sensor_and_utc_day(filled):
    store, _ = filled
    paths = sorted(str(p.relative_to(store.root)) for p in store.root.glob("frames/**/*.parquet"))
    days = ["2026-01-05", "2026-01-06", "2026-01-07", "2026-01-08"]
    assert paths == [f"frames/sensor=ST16-1/day={day}/frames.parquet" for day in days]
    assert json.loads((store.root / "store.json").read_text()) == {
        "schema": "stcal.store",
        "version": 1,
    }


def test_a_leap_second_belongs_to_the_day_it_ends(tmp_path):
    times = ("2016-12-31T23:59:59Z", "2016-12-31T23:59:60.5Z", "2017-01-01T00:00:00Z")
    table = [cases.ROW | {"frame_id": str(i), "time_utc": t} for i, t in enumerate(times)]
    store, summary = cases.run(tmp_path, cases.write_rows(tmp_path / "a.csv", table))
    assert summary.exit_code == 0
    assert [(f.day, f.n_frames) for f in store.fragments("ST16-1")] == [
        ("2016-12-31", 2),
        ("2017-01-01", 1),
    ]
    assert store.read_frames("ST16-1").t_tai_ns.tolist() == [parse_utc(t) for t in times]
    inside = store.read_frames("ST16-1", parse_utc(times[1]), parse_utc(times[2]))
    assert inside.frame_id.tolist() == [1]


def test_names_cannot_leave_the_store(tmp_path):
    names = ["ST16-../../x", "ST16-a/b", "ST16-é %", "ST16-.."]
    table = [cases.ROW | {"sensor_id": name} for name in names]
    store, summary = cases.run(tmp_path, cases.write_rows(tmp_path / "a.csv", table))
    assert summary.exit_code == 0
    assert store.sensors() == sorted(names)
    for name in names:
        assert store.read_frames(name).n_frames == 1
    assert {path.parent.name for path in store.root.glob("frames/*/*")} == {
        path.name for path in (store.root / "frames").iterdir()
    }


def test_time_ranges_are_half_open(filled):
    store, frames = filled
    start, stop = int(frames.t_tai_ns[50]), int(frames.t_tai_ns[130])
    cases.assert_same_frames(
        store.read_frames("ST16-1", start, stop),
        frames.take((frames.frame_id // 1 >= 50) & (frames.frame_id < 130)),
    )


@pytest.mark.parametrize("maximum", [1, 7, 33, 1000])
def test_fragments_are_a_partition_in_time_order(filled, maximum):
    store, frames = filled
    start = int(frames.t_tai_ns[10])
    fragments = store.fragments("ST16-1", start_tai_ns=start, maximum_frames=maximum)
    assert max(fragment.n_frames for fragment in fragments) <= maximum
    assert fragments == pickle.loads(pickle.dumps(fragments))
    joined = concatenate([read_fragment(fragment) for fragment in fragments])
    cases.assert_same_frames(joined, frames.take(frames.frame_id >= 10))


def test_fragments_across_row_groups(tmp_path, monkeypatch):
    monkeypatch.setattr("stcal.telemetry.store._ROW_GROUP_FRAMES", 16)
    frames = cases.batch(78)
    write_csv([frames], tmp_path / "a.csv", decimals=None)
    store, _ = cases.run(tmp_path, tmp_path / "a.csv")
    for maximum in (5, 16, 17, 100):
        parts = [read_fragment(f) for f in store.fragments("ST16-1", maximum_frames=maximum)]
        cases.assert_same_frames(concatenate(parts), frames)


def test_what_is_not_there_is_said(filled):
    store, frames = filled
    with pytest.raises(InputError, match=r"'ST16-9'; sensors in the store: ST16-1"):
        store.read_frames("ST16-9")
    with pytest.raises(InputError, match="from 2026-01-05 to 2026-01-08"):
        store.fragments("ST16-1", start_tai_ns=int(frames.t_tai_ns[-1]) + 1)
    with pytest.raises(InputError, match="no stcal store here"):
        Store.open(store.root / "frames")


def test_newer_versions_are_refused(filled):
    store, _ = filled
    path = next(store.root.glob("frames/*/*/*.parquet"))
    table = pq.ParquetFile(path).read()
    pq.write_table(table.replace_schema_metadata({"schema": "stcal.frames", "version": "2"}), path)
    with pytest.raises(InputError, match=rf"{path.name}: written with schema version 2"):
        store.read_frames("ST16-1")
    (store.root / "store.json").write_text('{"schema": "stcal.store", "version": 2}')
    for create in (False, True):
        with pytest.raises(InputError, match="store version 2, this stcal reads up to 1"):
            Store.open(store.root, create=create)
    (store.root / "store.json").write_text("{")
    with pytest.raises(InputError, match=r"store\.json: not JSON"):
        Store.open(store.root)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ('{"schema": "stcal.store", "version": 0}', "version 0 is not a version"),
        ('{"schema": "stcal.store", "version": true}', "version True is not a version"),
        ('{"schema": "stcal.store", "version": "1"}', "version '1' is not a version"),
        ('{"schema": "stcal.store"}', "version None is not a version"),
        ('{"schema": "other", "version": 1}', "not the marker of a store"),
        ("[" * 100_000, "not JSON"),
        ("[]", "not an object"),
    ],
    ids=range(7),
)
def test_markers_that_are_none(tmp_path, content, said):
    (tmp_path / "store.json").write_text(content)
    for create in (False, True):
        with pytest.raises(InputError, match=rf"store\.json: .*{said}"):
            Store.open(tmp_path, create=create)


def test_foreign_folders_are_not_taken_over(tmp_path):
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(InputError, match="neither a store nor empty"):
        Store.open(tmp_path, create=True)
    with pytest.raises(InputError, match="is not a folder"):
        Store.open(tmp_path / "thesis.tex", create=True)
    with pytest.raises(InputError, match=r"thesis\.tex/a/b: .*a file is in the way"):
        Store.open(tmp_path / "thesis.tex" / "a" / "b", create=True)
    with pytest.raises(InputError, match="no stcal store here"):
        Store.open(tmp_path / "thesis.tex" / "a")
    with pytest.raises(InputError, match="cannot be read: File name too long"):
        Store.open(tmp_path / ("n" * 300))


@pytest.mark.parametrize("name", ["ST16-" + "x" * 10_000, "\U0001f6f0" * 20, "ST16-\udcff"])
def test_names_that_no_sensor_can_have(filled, name):
    store, _ = filled
    with pytest.raises(InputError, match=r"sensor '.{1,80}': the name") as caught:
        store.fragments(name)
    assert len(str(caught.value)) < 200


def change_columns(table):
    times = table["t_tai_ns"]
    at = table.schema.get_field_index
    return {
        "missing or unknown columns: row_px": table.drop_columns(["row_px"]),
        "missing or unknown columns: extra": table.append_column("extra", times),
        "columns: none, but moved": table.select(table.column_names[::-1]),
        "column frame_id is string": table.set_column(
            at("frame_id"), pa.field("frame_id", pa.string(), False), times.cast(pa.string())
        ),
        "column t_tai_ns is int64, not int64 without nulls": table.set_column(
            at("t_tai_ns"), pa.field("t_tai_ns", pa.int64()), times
        ),
        "not in the order of time": table.take(list(range(table.num_rows))[::-1]),
    }


@pytest.mark.parametrize("said", list(range(6)))
def test_fragments_with_other_columns_or_order_are_refused(filled, tmp_path, said):
    store, frames = filled
    path = sorted(store.root.glob("frames/*/*/*.parquet"))[1]
    table = pq.ParquetFile(path).read()
    said, changed = list(change_columns(table).items())[said]
    pq.write_table(changed.replace_schema_metadata(table.schema.metadata), path)
    before = int(frames.t_tai_ns[0])
    for action in (
        lambda: store.read_frames("ST16-1"),
        lambda: store.fragments("ST16-1", start_tai_ns=before),
        lambda: cases.run(tmp_path, tmp_path / "a.csv"),
    ):
        with pytest.raises(InputError, match=rf"2026-01-06/frames\.parquet: damaged.*{said}"):
            action()


def test_quarantine_files_with_other_columns_are_refused(tmp_path):
    source = cases.write_rows(tmp_path / "a.csv", [*cases.rows(3), cases.ROW | {"row_px": "x"}])
    other = cases.write_rows(tmp_path / "b.csv", cases.rows(4, col_px="7"))
    store, _ = cases.run(tmp_path, source, other)
    paths = sorted(store.root.glob("quarantine/**/*.parquet"))
    assert len(paths) == 2
    for path in paths:
        content = path.read_bytes()
        pq.write_table(pq.ParquetFile(path).read().drop_columns(["source"]), path)
        for action in (store.quarantine, lambda: cases.run(tmp_path, source)):
            with pytest.raises(InputError, match=rf"{path.name}: damaged: .*: source"):
                action()
        path.write_bytes(content)


def test_fragments_that_cannot_be_read_are_not_called_damaged(filled, monkeypatch):
    store, _ = filled

    def refuse(path, *arguments):
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr("pathlib.Path.open", refuse)
    with pytest.raises(InputError, match=r"frames\.parquet: cannot be read: Permission denied$"):
        store.read_frames("ST16-1")


@pytest.mark.parametrize(
    "stray",
    [
        "frames",
        "frames/sensor=ST16-1",
        "frames/sensor=ST16-1/day=2026-01-05",
        "quarantine",
        "configs",
    ],
)
def test_files_where_folders_belong_are_named(tmp_path, stray):
    store = Store.open(tmp_path / "store", create=True)
    (store.root / stray).parent.mkdir(parents=True, exist_ok=True)
    (store.root / stray).write_text("")
    source = cases.write_rows(tmp_path / "a.csv", [*cases.rows(2), cases.ROW | {"row_px": "x"}])
    with pytest.raises(InputError, match=f"{stray}.*a file is in the way"):
        cases.run(tmp_path, source)
    with pytest.raises(InputError, match="no frames of sensor 'ST16-1'; sensors in the store"):
        store.read_frames("ST16-1")


def test_a_folder_in_place_of_the_lock(filled, tmp_path):
    store, _ = filled
    (store.root / ".lock").unlink()
    (store.root / ".lock").mkdir()
    with pytest.raises(InputError, match=r"\.lock: .*cannot be locked for writing: Is a dir"):
        cases.run(tmp_path, tmp_path / "a.csv")


def test_damaged_configurations_are_named(filled, tmp_path):
    store, _ = filled
    (path,) = (store.root / "configs").glob("*.json")
    for content, said in ((b"\xff", "not JSON"), (b"[" * 100_000, "not JSON")):
        path.write_bytes(content)
        with pytest.raises(ConfigError, match=rf"{path.name}.*{said}"):
            recorded_for(store.root, "ST16-1")
    path.unlink()
    path.mkdir()
    for action in (
        lambda: recorded_for(store.root, "ST16-1"),
        lambda: cases.run(tmp_path, tmp_path / "a.csv"),
    ):
        with pytest.raises(ConfigError, match=rf"{path.name}: cannot be read: Is a directory"):
            action()


def test_a_changed_digit_of_a_configuration_is_seen(filled, tmp_path):
    """It would be another sensor's noise or tolerance, and as good a number."""
    store, _ = filled
    (path,) = (store.root / "configs").glob("*.json")
    whole = path.read_text()
    for place in [match.start() for match in re.finditer(r"\d", whole)][::7]:
        other = "1" if whole[place] != "1" else "2"
        path.write_text(whole[:place] + other + whole[place + 1 :])
        with pytest.raises(ConfigError, match=re.escape(str(path))):
            recorded_for(store.root, "ST16-1")
    cases.run(tmp_path, tmp_path / "a.csv")
    assert path.read_text() == whole
    document = json.loads(whole)
    del document["sha256"]  # as older versions wrote it
    path.write_text(json.dumps(document))
    assert recorded_for(store.root, "ST16-1") == cases.config()


def test_every_byte_of_the_marker_is_checked(filled):
    """It has no hash: whatever is changed is refused, or is white space."""
    store, _ = filled
    marker = store.root / "store.json"
    whole = marker.read_bytes()
    blank = {match.start() for match in re.finditer(rb"\s", whole)}
    for place in range(len(whole)):
        for byte in {whole[place] ^ (1 << bit) for bit in range(8)} | set(b' \t0159-e."}'):
            changed = whole[:place] + bytes([byte]) + whole[place + 1 :]
            marker.write_bytes(changed)
            if byte == whole[place] or (place in blank and byte in b" \t\r\n"):
                Store.open(store.root)
                continue
            with pytest.raises(InputError, match=re.escape(str(marker))):
                Store.open(store.root)


def test_damaged_fragments_are_named(filled, tmp_path):
    store, _ = filled
    path = sorted(store.root.glob("frames/*/*/*.parquet"))[1]
    path.write_bytes(path.read_bytes()[:-20])
    for action in (
        lambda: store.read_frames("ST16-1"),
        lambda: cases.run(tmp_path, tmp_path / "a.csv"),
    ):
        with pytest.raises(InputError, match=r"2026-01-06/frames\.parquet: damaged"):
            action()


def test_a_store_that_changes_under_a_reader(filled, tmp_path):
    store, _ = filled
    fragments = store.fragments("ST16-1")
    other = cases.write_rows(tmp_path / "b.csv", cases.rows(1, frame_id="999"))
    cases.run(tmp_path, other)
    with pytest.raises(InputError, match="changed while it was read"):
        read_fragment(fragments[0])


def test_a_day_that_is_replaced_by_as_many_frames(filled):
    """A better version of a frame in place of another leaves their number as it is."""
    store, _ = filled
    first, *others = store.fragments("ST16-1")
    assert others
    first.path.write_bytes(first.path.read_bytes())
    with pytest.raises(InputError, match=f"{first.path}: the store changed while it was read"):
        first.read()
    assert others[0].read().n_frames == others[0].n_frames


def test_only_one_process_writes(filled, tmp_path):
    store, _ = filled
    code = (
        "import sys; from pathlib import Path; from stcal.telemetry.store import Store\n"
        "with Store(Path(sys.argv[1])).lock():\n"
        "    print('held', flush=True); sys.stdin.read()"
    )
    command = [sys.executable, "-c", code, str(store.root)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout.readline() == "held\n"
        with pytest.raises(InputError, match=f"process {process.pid} is writing"):
            cases.run(tmp_path, tmp_path / "a.csv")
        process.kill()
    with store.lock():
        assert (store.root / ".lock").read_text() == str(os.getpid())
    cases.run(tmp_path, tmp_path / "a.csv")


def test_remains_of_a_killed_writer_are_cleared(filled):
    store, _ = filled
    (store.root / ".stcal-folder").mkdir()
    left = [store.root / ".stcal-1", store.root / "frames" / "sensor=ST16-1" / ".stcal-2"]
    for path in left:
        path.write_text("")
    with store.lock():
        assert not any(path.exists() for path in left)
