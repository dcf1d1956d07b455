"""The quarantine: the source's own bytes at their place, read back as they were written."""

from __future__ import annotations

import gzip
import json
import tempfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import telemetry_cases as cases
from hypothesis import given, settings
from hypothesis import strategies as st
from test_ingest_fuzz import mutated
from test_mapping import ROOT, few_stars, star_table, write_parquet, yamcs_text

from stcal.errors import InputError
from stcal.telemetry import quarantine
from stcal.telemetry.mapping import load_mapping
from stcal.telemetry.quarantine import Origin, Rejection
from stcal.telemetry.quarantine_list import Selection, hex_dump, listing, shown
from stcal.telemetry.retry import retry
from stcal.telemetry.writer import write_csv, write_jsonl

TEXT = st.text(st.characters(codec="utf-8"), max_size=20)
REJECTIONS = st.lists(
    st.builds(
        Rejection,
        row=st.integers(1, 2**40),
        code=st.sampled_from(sorted(quarantine.REASONS)),
        detail=TEXT,
        raw=st.binary(max_size=200),
        offset=st.integers(-1, 2**60),
        rows=st.integers(1, 2**40),
        sensor_id=TEXT,
        frame_id=TEXT,
    ),
    max_size=8,
)


@settings(max_examples=100, deadline=None)
@given(records=REJECTIONS, context=st.binary(max_size=300))
def test_records_are_read_back_as_written(records, context):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.parquet"
        quarantine.write_records(path, "a.csv", "ab" * 32, records, Origin("csv", context))
        table = quarantine.read_file(path)
        assert quarantine.records_of(table) == sorted(records, key=lambda record: record.row)
        assert quarantine.origin_of(table, path) == Origin("csv", context)
        assert table["length"].to_pylist() == [len(raw) for raw in table["raw"].to_pylist()]
        first = path.read_bytes()
        back = quarantine.records_of(table)
        quarantine.write_records(path, "a.csv", "ab" * 32, back, Origin("csv", context))
        assert path.read_bytes() == first


def assert_bytes_of_the_source(store, content: dict[str, bytes]) -> int:
    """Every record of a source must be its bytes at the offset; returns how many there are."""
    found = [r for r in cases.records(store) if r["code"] != "conflict"]
    for record in found:
        start, length = record["offset"], record["length"]
        assert start >= 0
        assert content[record["source"]][start : start + length] == record["raw"]
        assert content[record["source"]][:start].count(b"\n") == record["row"] - 1
    return len(found)


@settings(max_examples=120, deadline=None)
@given(
    data=mutated(".csv") | mutated(".jsonl"),
    bom=st.booleans(),
    block=st.sampled_from([100, 1000, 10**6]),
    packed=st.booleans(),
)
def test_the_bytes_are_those_of_the_source(data, bom, block, packed):
    data = b"\xef\xbb\xbf" * bom + data
    with tempfile.TemporaryDirectory() as folder:
        name = "a.txt.gz" if packed else "a.txt"
        path = Path(folder) / name
        path.write_bytes(gzip.compress(data) if packed else data)
        with cases.small_blocks(block):
            store, _ = cases.run(Path(folder), path)
        assert_bytes_of_the_source(store, {name: data})


@settings(max_examples=60, deadline=None)
@given(data=mutated(".csv") | mutated(".jsonl"))
def test_trying_again_without_a_change_changes_nothing(data):
    """Whatever is in quarantine stays there, with the reason that it had."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.txt"
        path.write_bytes(data)
        store, _ = cases.run(Path(folder), path)
        before = cases.snapshot(store.root)
        retry(store)
        assert cases.snapshot(store.root) == before


def without_repeated_identifiers(frames) -> bool:
    """Whether no exposure names a star twice: a frame in pieces that does is cut apart, and then
    depends on which of its rows are known when it is put together."""
    known = frames.star_id != 0
    pairs = np.column_stack([frames.exposure_of_star[known], frames.star_id[known]])
    return len(np.unique(pairs, axis=0)) == len(pairs)


@st.composite
def partly_refused(draw, suffix):
    """Telemetry of which some rows are bad whatever the configuration."""
    # A star given twice counts once in the store, so a row that comes later cannot tell.
    batches = cases.batches().filter(cases.without_repeated_stars)
    frames = draw(batches.filter(without_repeated_identifiers))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a"
        (write_csv if suffix == ".csv" else write_jsonl)([frames], path, decimals=None)
        lines = path.read_bytes().splitlines()
    for i in draw(st.lists(st.integers(1, max(1, len(lines) - 1)), max_size=3)):
        bad = draw(st.sampled_from([b"OTHER-1", b"ST16-\xff", b"ST16-2"]))
        if i < len(lines):
            lines[i] = lines[i].replace(b"ST16-1", bad)
    return b"\n".join(lines)


@settings(max_examples=60, deadline=None)
@given(data=partly_refused(".csv") | partly_refused(".jsonl"))
def test_trying_again_is_ingesting_again(data):
    other = cases.config(rows=1000)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.txt"
        path.write_bytes(data)
        small, _ = cases.run(Path(folder) / "one", path, configs=[other])
        cases.run(Path(folder) / "two", path, configs=[other])
        again, _ = cases.run(Path(folder) / "two", path)
        retry(small, [cases.config()])
        assert cases.snapshot(small.root) == cases.snapshot(again.root)


def test_a_yamcs_export_is_quarantined_and_tried_again(tmp_path):
    batch = few_stars()
    text = yamcs_text(batch, batch.star_id).splitlines()
    header, lines = text[0], text[1:]
    number = header.split("\t").index("/ST16/E0/ROW")
    for i, value in ((3, "[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]"), (5, "x")):
        fields = lines[i].split("\t")
        fields[number] = value
        lines[i] = "\t".join(fields)
    data = ("\r\n".join([header, *lines[:7], "short\tline", *lines[7:]]) + "\r\n").encode()
    path = tmp_path / "a.tsv"
    path.write_bytes(data)
    mapping = load_mapping(ROOT / "yamcs.toml")
    small = cases.config(rows=1000)
    store, summary = cases.run(tmp_path, path, mapping=mapping, configs=[small])
    assert {"bad_lists", "ragged_row", "outside_detector"} <= set(summary.quarantined)
    assert assert_bytes_of_the_source(store, {"a.tsv": data}) > 3
    (result,) = retry(store, [cases.config()])
    assert result.note is None
    assert "outside_detector" not in result.reasons
    again, _ = cases.run(tmp_path / "again", path, mapping=mapping, configs=[small])
    again, _ = cases.run(tmp_path / "again", path, mapping=mapping)
    assert cases.snapshot(store.root) == cases.snapshot(again.root)


@pytest.mark.parametrize("form", ["frames", "stars"])
def test_a_parquet_file_is_quarantined_and_tried_again(tmp_path, form):
    batch = few_stars(5, 2.0)
    if form == "stars":
        table, mapping = star_table(batch), load_mapping(ROOT / "parquet-stars.toml")
    else:
        from test_mapping import ARROW, mapping_from_document, table_of

        table, mapping = table_of(batch), mapping_from_document(ARROW, "test")
    write_parquet(table, tmp_path / "a.parquet")
    small = cases.config(rows=1000)
    store, summary = cases.run(tmp_path, tmp_path / "a.parquet", mapping=mapping, configs=[small])
    assert summary.quarantined["outside_detector"] > 3
    found = [r for r in cases.records(store) if r["code"] == "outside_detector"]
    assert {record["offset"] for record in found} == {-1}
    name = "y" if form == "stars" else "row0"
    for entry in shown(store.root, Selection(code="outside_detector"), 100):
        values = json.loads(entry["text"])
        original = table.slice(entry["row"] - 1, 1)[name].to_pylist()[0]
        assert values[name] == original
    before = cases.snapshot(store.root)
    retry(store)
    assert cases.snapshot(store.root) == before
    retry(store, [cases.config()])
    again, _ = cases.run(tmp_path / "b", tmp_path / "a.parquet", mapping=mapping, configs=[small])
    again, _ = cases.run(tmp_path / "b", tmp_path / "a.parquet", mapping=mapping)
    assert cases.snapshot(store.root) == cases.snapshot(again.root)


def bad_store(tmp_path):
    """A store with records of two sources, two sensors and a displaced version."""
    rows = cases.frames(4)
    rows[1]["row_px"] = "x"
    other = cases.rows(2, sensor_id="ST16-2", col_px="99999")
    a = cases.write_rows(tmp_path / "a.csv", rows + other)
    b = cases.write_rows(tmp_path / "b.csv", rows[:8])
    return cases.run(tmp_path, a, b)[0]


def test_the_list_counts_by_reason_source_and_sensor(tmp_path):
    store = bad_store(tmp_path)
    found = listing(store.root, Selection()).document()
    assert found["by_reason"] == {"bad_centroid": 2, "outside_detector": 2, "conflict": 2}
    assert [(s["source"], s["rows"]) for s in found["by_source"]] == [
        ("a.csv", {"bad_centroid": 1, "outside_detector": 2}),
        ("b.csv", {"bad_centroid": 1, "conflict": 2}),
    ]
    assert found["by_sensor"]["ST16-2"] == {"outside_detector": 2}
    sha256 = found["by_source"][1]["sha256"]
    for source in ("b.csv", sha256[:8], sha256.upper()):
        some = listing(store.root, Selection(source=source)).document()
        assert some["by_reason"] == {"bad_centroid": 1, "conflict": 2}
    assert listing(store.root, Selection(source=sha256[:5])).document()["records"] == 0
    assert listing(store.root, Selection(sensor="ST16-2")).document()["rows"] == 2
    assert listing(store.root, Selection(frame="2", code="conflict")).document()["rows"] == 2


def test_records_are_shown_with_their_bytes(tmp_path):
    store = bad_store(tmp_path)
    records = list(shown(store.root, Selection(source="a.csv"), 2))
    assert len(records) == 2
    lines = (tmp_path / "a.csv").read_text().splitlines()
    for record in records:
        assert record["text"] == lines[record["row"] - 1]
        assert bytes.fromhex(record["hex"]).decode() == record["text"]
    path = tmp_path / "c.csv"
    path.write_bytes(cases.csv_text(cases.rows(1)).encode().replace(b"HIP", b"\xff\0"))
    with pytest.raises(StopIteration):
        next(shown(store.root, Selection(source="c.csv"), 1))
    assert list(hex_dump(b"0123456789abcdef\x00\xff", 32)) == [
        "00000020  30 31 32 33 34 35 36 37 38 39 61 62 63 64 65 66  0123456789abcdef",
        "00000030  00 ff                                            ..",
    ]


def version_1(path):
    """Rewrite a quarantine file as the version before had it."""
    table = quarantine.read_file(path)
    columns = ["source", "source_sha256", "row", "rows", "sensor_id", "frame_id", "code", "detail"]
    table = table.select([*columns, "raw", "content_sha256"])
    table = table.set_column(8, "raw", table["raw"].cast(pa.string()))
    metadata = {"schema": "stcal.quarantine", "version": "1"}
    pq.write_table(table.replace_schema_metadata(metadata), path)


def test_a_store_of_the_version_before_is_read_and_not_tried(tmp_path):
    store = bad_store(tmp_path)
    before = [(r["source"], r["row"], r["raw"]) for r in cases.records(store)]
    for path in quarantine.paths(store.root):
        version_1(path)
    assert [(r["source"], r["row"], r["raw"]) for r in cases.records(store)] == before
    assert {record["offset"] for record in cases.records(store)} == {-1}
    snapshot = cases.snapshot(store.root)
    results = retry(store)
    assert all("ingest the file again" in result.note for result in results)
    assert cases.snapshot(store.root) == snapshot
    cases.run(tmp_path, tmp_path / "a.csv", tmp_path / "b.csv")
    assert all(result.note is None for result in retry(store))


def test_files_that_are_none_of_ours_are_refused(tmp_path):
    store = bad_store(tmp_path)
    path = quarantine.source_parts(store.root)[0]
    table = quarantine.read_file(path)
    for change, said in (
        ({b"version": b"3"}, "use a newer stcal"),
        ({b"version": b"x"}, "damaged"),
        ({b"schema": b"other"}, "damaged"),
        ({b"context": b"%"}, "origin"),
    ):
        pq.write_table(table.replace_schema_metadata(table.schema.metadata | change), path)
        with pytest.raises(InputError, match=said) as error:
            retry(store)
        assert str(path) in str(error.value)


def test_records_of_an_unknown_format_stay(tmp_path):
    store = bad_store(tmp_path)
    for path in quarantine.source_parts(store.root):
        table = quarantine.read_file(path)
        metadata = table.schema.metadata | {b"format": b"telepathy"}
        pq.write_table(table.replace_schema_metadata(metadata), path)
    before = cases.snapshot(store.root)
    assert all("'telepathy' is not known" in result.note for result in retry(store))
    assert cases.snapshot(store.root) == before


def test_a_damaged_store_is_an_error_not_a_note(tmp_path):
    rows = cases.frames(2)
    rows[1]["row_px"] = "3000"
    store, _ = cases.run(tmp_path, cases.write_rows(tmp_path / "a.csv", rows))
    (fragment,) = store.root.glob("frames/*/*/*.parquet")
    fragment.write_bytes(b"PAR1")
    records = cases.records(store)
    with pytest.raises(InputError, match="damaged fragment") as error:
        retry(store, [cases.config(rows=5000)])
    assert str(fragment) in str(error.value)
    assert cases.records(store) == records
