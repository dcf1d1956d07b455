"""Damaged foreign tables: no row is lost uncounted, nothing breaks, twice is once."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import telemetry_cases as cases
from hypothesis import given, settings
from hypothesis import strategies as st
from test_ingest_fuzz import JUNK
from test_mapping import (
    ARROW,
    ROOT,
    few_stars,
    mapping_from_document,
    table_of,
    write_parquet,
    yamcs_text,
)

from stcal.telemetry.mapped import unfold
from stcal.telemetry.mapping import load_mapping
from stcal.telemetry.retry import retry

YAMCS = load_mapping(ROOT / "yamcs.toml")
BATCH = few_stars()
TEXT = yamcs_text(BATCH, BATCH.star_id).encode()
LISTS = [
    b"[]",
    b"[1.0",
    b"1.0, 2.0]",
    b"[,]",
    b"[a, b]",
    b"{1.0}",
    b'"[1.0\t2.0]"',
    b"\t",
    b"[[1]]",
]


def check(folder, path, mapping):
    store, summary = cases.run(folder, path, mapping=mapping)
    counts = summary.counts
    if summary.errors:
        assert path.name in summary.errors[0]
        return
    assert counts.rows == counts.stored_rows + counts.duplicate_rows + counts.quarantined_rows
    assert counts.quarantined_rows == sum(summary.quarantined.values())
    before = cases.snapshot(store.root)
    cases.run(folder, path, mapping=mapping)
    assert cases.snapshot(store.root) == before
    retry(store)
    assert cases.snapshot(store.root) == before


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_damaged_exports(data):
    header, body = TEXT.split(b"\n", 1)
    for _ in range(data.draw(st.integers(1, 5))):
        start = data.draw(st.integers(0, len(body)))
        stop = data.draw(st.integers(start, min(len(body), start + 30)))
        body = body[:start] + data.draw(JUNK | st.sampled_from(LISTS)) + body[stop:]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.tsv"
        path.write_bytes(header + b"\n" + body)
        check(Path(folder), path, YAMCS)


VALUES = st.none() | st.floats(allow_nan=True) | st.sampled_from([0.0, 1.0, 100.0, -3.0])


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_odd_tables(data):
    """Nulls, NaN, infinities and lists of any length wherever the types allow."""
    table = table_of(BATCH.take(np.arange(BATCH.n_frames) < 6))
    n = table.num_rows
    for name in data.draw(st.lists(st.sampled_from(table.column_names), max_size=4, unique=True)):
        kind = table.schema.field(name).type
        if pa.types.is_dictionary(kind):
            value, kind = st.none() | st.sampled_from(["ST16-1", "", "\x00"]), pa.string()
        elif pa.types.is_list(kind):
            text = st.none() | st.sampled_from(["HIP 1", "?", ""])
            inner = text if pa.types.is_string(kind.value_type) else VALUES
            value = st.none() | st.lists(inner, max_size=4)
        elif pa.types.is_floating(kind):
            value = VALUES
        elif pa.types.is_boolean(kind):
            value = st.none() | st.booleans()
        else:
            value = st.none() | st.integers(-100, 100)
        drawn = data.draw(st.lists(value, min_size=n, max_size=n))
        column = pa.array(drawn, kind)
        table = table.set_column(table.column_names.index(name), name, column)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.parquet"
        write_parquet(table, path)
        check(Path(folder), path, mapping_from_document(ARROW, "test"))


LENGTHS = st.lists(st.integers(0, 5), min_size=1, max_size=6)


@settings(max_examples=150, deadline=None)
@given(lengths=LENGTHS, other=LENGTHS, count=st.none() | LENGTHS)
def test_lists_against_a_loop(lengths, other, count):
    """The vectorised unfolding gives what a loop over rows gives."""
    n = min(len(lengths), len(other), *([] if count is None else [len(count)]))
    rows = [[10.0 * i + k for k in range(lengths[i])] for i in range(n)]
    cols = [[500.0 + 10 * i + k for k in range(other[i])] for i in range(n)]
    stars = {"exposure": 0, "row_px": {"column": "r"}, "col_px": {"column": "c"}}
    table = {"r": pa.array(rows, pa.list_(pa.float64())), "c": pa.array([str(c) for c in cols])}
    table |= {"f": pa.array(range(n)), "n": pa.array((count or [0])[:n] if count else [0] * n)}
    if count is not None:
        stars["count"] = "n"
    time = {"value": "2026-01-05T12:00:00Z"}
    columns = {"sensor_id": {"value": "ST16-1"}, "frame_id": {"column": "f"}, "time_utc": time}
    document = ARROW | {"columns": columns, "stars": [stars]}
    found = unfold(table, n, mapping_from_document(document, "test"))
    expected, bad = [], []
    for i in range(n):
        wanted = len(rows[i]) if count is None else count[i]
        fits = len(cols[i]) == wanted if count is None else min(lengths[i], other[i]) >= wanted
        if not fits:
            bad.append(i)
        elif wanted == 0:
            expected.append((i, None, None, None))
        else:
            expected += [(i, "0", rows[i][k], cols[i][k]) for k in range(wanted)]
    assert sorted(found.bad) == bad
    got = zip(
        found.record.tolist(),
        found.columns["exposure"].to_pylist(),
        [None if x is None else float(x) for x in found.columns["row_px"].to_pylist()],
        [None if x is None else float(x) for x in found.columns["col_px"].to_pylist()],
        strict=True,
    )
    assert list(got) == expected
    assert found.columns["frame_id"].to_pylist() == [str(i) for i, *_ in expected]
