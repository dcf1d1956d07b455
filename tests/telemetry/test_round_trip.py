"""Frames through the writers, ingest and the store, and back."""

from __future__ import annotations

import gzip
import tempfile
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import telemetry_cases as cases
from hypothesis import assume, given, settings

from stcal.telemetry.columns import UNITS
from stcal.telemetry.schema import (
    StoredFrames,
    batch_from_table,
    frame_schema,
    star_id_codes,
    star_id_texts,
    table_from_stored,
)
from stcal.telemetry.writer import write_csv, write_jsonl

WRITERS = {
    "a.csv": write_csv,
    "a.csv.gz": write_csv,
    "a.jsonl": write_jsonl,
    "a.jsonl.gz": write_jsonl,
}


@pytest.mark.parametrize("name", WRITERS)
@settings(max_examples=25, deadline=None)
@given(frames=cases.batches())
def test_store_returns_what_was_written(name, frames):
    assume(cases.without_repeated_stars(frames))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        WRITERS[name]([frames], path, decimals=None)
        store, summary = cases.run(Path(folder), path)
        assert summary.exit_code == 0
        assert summary.counts.new_frames == frames.n_frames
        assert summary.counts.stars == frames.n_stars
        cases.assert_same_frames(store.read_frames("ST16-1"), frames)


@settings(max_examples=25, deadline=None)
@given(frames=cases.batches())
def test_table_and_batch_are_the_same(frames):
    n = frames.n_frames
    text = np.full(n, "x", dtype=object)
    table = table_from_stored(StoredFrames(frames, text, text, np.arange(n)))
    table.validate(full=True)
    cases.assert_same_frames(batch_from_table(table, "ST16-1"), frames)
    middle = batch_from_table(table.slice(1, n - 1), "ST16-1")
    cases.assert_same_frames(middle, frames.take(np.arange(1, n)))


def test_default_decimals_round_centroids(tmp_path):
    frames = cases.batch()
    for name, write in WRITERS.items():
        write([frames], tmp_path / name)
        store, _ = cases.run(tmp_path / name.replace(".", "-"), tmp_path / name)
        back = store.read_frames("ST16-1")
        np.testing.assert_allclose(back.row_px, frames.row_px, atol=5.1e-5)
        np.testing.assert_allclose(back.q_si, frames.q_si, atol=1e-9)
        np.testing.assert_array_equal(back.star_id, frames.star_id)
        norm = np.linalg.norm(back.q_si[back.has_fix], axis=1)
        np.testing.assert_allclose(norm, 1.0, rtol=0, atol=1e-15)


def test_csv_and_json_lines_are_duplicates_of_each_other(tmp_path):
    frames = cases.batch()
    write_csv([frames], tmp_path / "a.csv", decimals=None)
    write_jsonl([frames], tmp_path / "b.jsonl", decimals=None)
    _, summary = cases.run(tmp_path, tmp_path / "a.csv", tmp_path / "b.jsonl")
    assert summary.counts.new_frames == summary.counts.duplicate_frames == frames.n_frames
    assert summary.counts.conflicting_frames == 0


def test_same_frames_give_the_same_bytes(tmp_path):
    for name, write in WRITERS.items():
        write([cases.batch()], tmp_path / name)
        write([cases.batch()], tmp_path / f"again-{name}")
        assert (tmp_path / name).read_bytes() == (tmp_path / f"again-{name}").read_bytes()
    packed = (tmp_path / "a.csv.gz").read_bytes()
    assert packed[3:8] == b"\0\0\0\0\0"  # neither a name nor a time
    assert gzip.decompress(packed) == (tmp_path / "a.csv").read_bytes()


def test_optional_columns_only_when_set(tmp_path):
    frames = cases.batch()
    bare = frames.take(~frames.eclipse & ~frames.intrusion)
    none = np.full((bare.n_frames, 3), np.nan)
    bare = type(bare)(**{**vars_of(bare), "pos_km": none, "vel_km_s": none})
    write_csv([bare], tmp_path / "bare.csv")
    write_csv([bare, frames], tmp_path / "both.csv")
    header, *_ = (tmp_path / "bare.csv").read_text().splitlines()
    assert header == ",".join(cases.ROW)
    header, *_ = (tmp_path / "both.csv").read_text().splitlines()
    assert header == ",".join([*cases.ROW, *cases.OPTIONAL])


def vars_of(frames):
    return {name: getattr(frames, name) for name in frames.__dataclass_fields__}


def test_first_pixel_convention_is_taken_off(tmp_path):
    frames = cases.batch()
    write_csv([frames], tmp_path / "a.csv", first_pixel_centre_px=1.0)
    configs = [cases.config(first_pixel_centre_px=1.0)]
    store, summary = cases.run(tmp_path, tmp_path / "a.csv", configs=configs)
    assert summary.exit_code == 0
    back = store.read_frames("ST16-1")
    np.testing.assert_allclose(back.row_px, frames.row_px, rtol=0, atol=1e-9)
    np.testing.assert_allclose(back.col_px, frames.col_px, rtol=0, atol=1e-9)


def test_schema_names_units_and_version(tmp_path):
    write_csv([cases.batch()], tmp_path / "a.csv")
    store, _ = cases.run(tmp_path, tmp_path / "a.csv")
    for path in store.root.glob("frames/*/*/*.parquet"):
        schema = pq.ParquetFile(path).schema_arrow
        assert schema.remove_metadata() == frame_schema().remove_metadata()
        assert schema.metadata[b"schema"] == b"stcal.frames"
        assert schema.metadata[b"version"] == b"1"
        units = {field.name: field.metadata[b"unit"].decode() for field in schema}
        expected = {name: unit for name, unit in UNITS.items() if name in units}
        assert units | {"time_utc": expected["time_utc"]} == units | expected
        assert (units["row_px"], units["time_utc"]) == ("px", "UTC")
        assert "TAI" in units["t_tai_ns"]


def test_identifiers_through_arrow():
    codes = np.array([0, 27989, 0, 2**40 + 129_018_731, 27989])
    texts = star_id_texts(codes)
    assert texts.to_pylist() == [None, "HIP 27989", None, "TYC 129-1873-1", "HIP 27989"]
    np.testing.assert_array_equal(star_id_codes(texts), codes)
