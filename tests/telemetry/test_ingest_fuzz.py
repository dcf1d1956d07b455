"""Mutated files: nothing but stcal's own errors, and no row is ever lost."""

from __future__ import annotations

import gzip
import tempfile
from pathlib import Path

import telemetry_cases as cases
from hypothesis import given, settings
from hypothesis import strategies as st

from stcal.telemetry.store import Store
from stcal.telemetry.writer import write_csv, write_jsonl

WORDS = b"|nan|-1|1e999|x|0|1|0.5|true|null|NaN|ST16-2|HIP 1|{|}|[|:| |,|2026-01-05T12:00:00Z"
BYTES = [b'"', b'""', b"\n", b"\n\n", b"\r", b"\0", b"\xff", b"\xed\xa0\x80", b"\\ud800", b"9" * 25]
JUNK = st.sampled_from([*WORDS.split(b"|"), *BYTES])


@st.composite
def mutated(draw, suffix):
    """A valid file with pieces cut, replaced, repeated and moved; its header stays."""
    frames = draw(cases.batches())
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"a{suffix}"
        (write_csv if suffix == ".csv" else write_jsonl)([frames], path)
        data = path.read_bytes()
    header, data = data.split(b"\n", 1) if suffix == ".csv" else (b"", data)
    for _ in range(draw(st.integers(0, 4))):
        start = draw(st.integers(0, len(data)))
        stop = draw(st.integers(start, min(len(data), start + 40)))
        kind = draw(st.sampled_from(["replace", "repeat", "lines"]))
        if kind == "replace":
            data = data[:start] + draw(JUNK) + data[stop:]
        elif kind == "repeat":
            data = data[:stop] + data[start:]
        else:
            lines = data.split(b"\n")
            data = b"\n".join(draw(st.permutations(lines)))
    return header + b"\n" + data if header else data


def check(data: bytes, name: str, **options: object) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(data)
        store, summary = cases.run(Path(folder), path, **options)
        counts = summary.counts
        if summary.errors and counts.rows == 0:
            assert name in summary.errors[0]
            return
        parts = (counts.stored_rows, counts.duplicate_rows, counts.quarantined_rows)
        assert counts.rows == sum(parts)
        assert min(parts) >= 0
        assert counts.quarantined_rows == sum(summary.quarantined.values())
        kinds = (counts.new_frames, counts.replaced_frames, counts.duplicate_frames)
        assert counts.frames == sum(kinds) + counts.conflicting_frames
        if name.startswith("a.csv"):
            header, *lines = data.split(b"\n")
            lines = [line.removesuffix(b"\r") for line in lines]
            assert counts.rows == sum(bool(line) and line != header for line in lines)
            rows = [r["row"] for r in cases.records(store) if r["code"] != "conflict"]
            assert len(rows) == len(set(rows)), "a row was refused twice"
        in_store = sum(store.read_frames(s).n_frames for s in store.sensors())
        assert in_store == counts.new_frames
        before = cases.snapshot(store.root)
        again = cases.run(Path(folder), path, **options)[1]
        assert cases.snapshot(store.root) == before
        assert again.counts.rows == counts.rows


@settings(max_examples=80, deadline=None)
@given(data=mutated(".csv"))
def test_csv(data):
    check(data, "a.csv")


@settings(max_examples=80, deadline=None)
@given(data=mutated(".jsonl"))
def test_json_lines(data):
    check(data, "a.jsonl")


@settings(max_examples=30, deadline=None)
@given(data=mutated(".csv"))
def test_small_windows(data):
    with cases.small_blocks(200):
        check(data, "a.csv", window_rows=3)


@settings(max_examples=30, deadline=None)
@given(data=mutated(".csv"), cut=st.floats(0, 1))
def test_cut_gzip(data, cut):
    packed = gzip.compress(data)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.csv.gz"
        path.write_bytes(packed[: int(cut * len(packed))])
        store, summary = cases.run(Path(folder), path)
        counts = summary.counts
        assert counts.rows == (counts.stored_rows + counts.duplicate_rows + counts.quarantined_rows)
        assert summary.exit_code == 3 or cut == 1
        Store.open(store.root).quarantine()


@settings(max_examples=60, deadline=None)
@given(data=st.binary(max_size=300), name=st.sampled_from(["a.csv", "a.jsonl", "a.csv.gz", "a"]))
def test_junk(data, name):
    check(data, "junk-" + name)
