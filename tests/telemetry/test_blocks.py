"""Files are read in blocks: where a block ends must not matter."""

from __future__ import annotations

import numpy as np
import pytest
import telemetry_cases as cases

from stcal.telemetry import csv, jsonl
from stcal.telemetry.columns import STAR_COLUMNS
from stcal.telemetry.sources import LineReader, examine
from stcal.telemetry.writer import write_csv, write_jsonl

STARS = {column.name for column in STAR_COLUMNS}
DECODE = {"a.csv": (write_csv, csv.decode), "a.jsonl": (write_jsonl, jsonl.decode)}


def texts_of(block, name):
    """Return a column's texts, one a row."""
    places = range(len(block)) if name in STARS else block.frame_index.tolist()
    return [block.columns[name][i].as_py() or "" for i in places]


def rows_of(blocks):
    listed = []
    for block in blocks:
        texts = zip(*(texts_of(block, name) for name in sorted(block.columns)), strict=True)
        raw = [block.raw(i) for i in range(len(block))]
        listed += zip(block.row.tolist(), texts, raw, strict=True)
    return listed


@pytest.mark.parametrize("name", DECODE)
@pytest.mark.parametrize("block_bytes", [1, 50, 333, 1000, 5000])
def test_rows_do_not_depend_on_the_block_size(tmp_path, name, block_bytes):
    write, decode = DECODE[name]
    write([cases.batch(20)], tmp_path / name)
    source = examine(tmp_path / name)
    warnings: list[str] = []
    whole = rows_of(decode(source, warnings.append))
    parts = list(decode(source, warnings.append, block_bytes))
    assert len(parts) > 1
    assert rows_of(parts) == whole
    assert warnings == []


@pytest.mark.parametrize("block_bytes", [400, 1000, 5000])
def test_a_frame_is_not_cut_between_blocks(tmp_path, block_bytes):
    path = cases.write_rows(tmp_path / "a.csv", cases.frames(40))
    text = path.read_text().splitlines()
    broken = [*range(40, 60), 80, 101]
    for i in broken:
        text[i] = "broken"
    path.write_text("\n".join(text) + "\n")
    seen: list[str] = []
    rejected = []
    for block in csv.decode(examine(path), print, block_bytes):
        ids = texts_of(block, "frame_id")
        seen += [ids[i] for i in np.flatnonzero(np.diff(block.run, prepend=-1))]
        rejected += block.rejected
    assert seen == [str(f) for f in range(40) if f not in range(13, 19)]
    assert [(r.row, r.code) for r in rejected] == [(i + 1, "ragged_row") for i in broken]


def test_a_frame_longer_than_the_limit_is_still_read(tmp_path):
    path = cases.write_rows(tmp_path / "a.csv", cases.rows(150))
    rows = [row for block in csv.decode(examine(path), print, 200) for row in block.row.tolist()]
    assert rows == list(range(2, 152))


def test_line_reader_counts_lines():
    reader = LineReader(iter([b"head\nab", b"c\n\nde", b"f\nlast"]), 4)
    assert reader.read_line() == b"head"
    blocks = [(b.data, b.first_row, b.last) for b in reader.blocks()]
    assert b"".join(data for data, _, _ in blocks) == b"abc\n\ndef\nlast"
    assert blocks[0][1] == 2
    assert blocks[-1][2]
    row = 2
    for data, first_row, _ in blocks:
        assert first_row == row
        row += data.count(b"\n")


def test_a_block_holds_few_lines(monkeypatch):
    """Short lines are cut into more blocks, long ones among them stay whole."""
    monkeypatch.setattr("stcal.telemetry.sources.BLOCK_LINES", 10)
    content = b"x" * 300 + b"\n" * 100 + b"".join(b"%d\n" % n for n in range(60)) + b"y" * 90
    blocks = list(LineReader(iter([content]), 10_000).blocks())
    assert b"".join(block.data for block in blocks) == content
    assert [b.first_row for b in blocks] == np.cumsum(
        [1, *(b.data.count(b"\n") for b in blocks[:-1])]
    ).tolist()
    assert all(block.data.count(b"\n") <= 10 for block in blocks)
    assert [block.last for block in blocks] == [False] * (len(blocks) - 1) + [True]


def test_lines_pushed_back_come_with_more(monkeypatch):
    monkeypatch.setattr("stcal.telemetry.sources.BLOCK_LINES", 10)
    reader, seen = LineReader(iter([b"a\n" * 95]), 40), []
    for block in reader.blocks():
        seen.append(block.data.count(b"\n"))
        if not block.last and seen[-1] < 50:
            reader.push_back(block.data)
    assert seen[:5] == [10, 20, 30, 40, 50]
    assert reader._row == 96


def test_a_large_gzip_file_is_unpacked_anew(tmp_path, monkeypatch):
    """What a small one holds is kept from the first look; a large one's is not."""
    write_csv([cases.batch(20)], tmp_path / "a.csv.gz")
    small = examine(tmp_path / "a.csv.gz")
    whole = rows_of(csv.decode(small, print))
    assert b"".join(small.unpacked).startswith(small.head)
    monkeypatch.setattr("stcal.telemetry.sources._KEPT_BYTES", len(small.head) - 1)
    large = examine(tmp_path / "a.csv.gz")
    assert large.unpacked is None
    assert rows_of(csv.decode(large, print)) == whole
