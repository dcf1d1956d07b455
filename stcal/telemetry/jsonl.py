"""Decode telemetry JSON Lines: one frame a line, unfolded to the rows of the long form.

A block of lines goes through Arrow's JSON reader.  One line that does not fit its types fails the
whole block there; such a block is read again line by line, which gives the same rows and says what
is wrong with which line.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.json as arrow_json

from stcal.frames import Ints
from stcal.telemetry.block import Decoder, RowBlock
from stcal.telemetry.columns import COLUMNS, OPTIONAL_COLUMNS, STAR_COLUMNS
from stcal.telemetry.jsonl_lines import LISTS, Lines, read_line, read_lines
from stcal.telemetry.sources import BLOCK_BYTES, LineBlock, LineReader, SourceFile, stream

_BOM = b"\xef\xbb\xbf"
_SCALARS = ("sensor_id", "frame_id", "time_utc", "best_exposure", "temperature_c")


def sniff(head: bytes) -> bool:
    """Whether the file begins with a JSON object."""
    return head.removeprefix(_BOM).lstrip().startswith(b"{")


def decode(
    source: SourceFile, warn: Callable[[str], None], block_bytes: int = BLOCK_BYTES
) -> Iterator[RowBlock]:
    """Yield the rows of a JSON Lines file; every line is a frame of its own."""
    for block in LineReader(stream(source), block_bytes).blocks():
        lines = _split(block)
        cut = source.truncated and block.last and not block.data.endswith(b"\n")
        unfolded = None if cut else _unfold(lines.data, warn)
        if unfolded is None:
            yield read_lines(lines, cut, warn)
        else:
            yield lines.rows(*unfolded, rejected=[])


def _split(block: LineBlock) -> Lines:
    """Return the lines that are not blank; a byte-order mark at the file's start is cut."""
    whole = block.data.split(b"\n")
    start = block.offset + np.cumsum([0, *(len(line) + 1 for line in whole[:-1])])
    if block.first_row == 1 and whole[0].startswith(_BOM):
        whole[0] = whole[0].removeprefix(_BOM)
        start[0] += len(_BOM)
    kept = [i for i, line in enumerate(whole) if line.strip()]
    number = block.first_row + np.array(kept, dtype=np.int64)
    return Lines([whole[i].rstrip(b"\r") for i in kept], number, start[kept])


def _schema() -> pa.Schema:
    real = pa.float64()
    star = pa.struct(
        [("row_px", real), ("col_px", real), ("intensity", real), ("star_id", pa.string())]
    )
    exposure = pa.struct([("exposure", pa.int64()), ("stars", pa.list_(star))])
    fields = [
        ("sensor_id", pa.string()),
        ("frame_id", pa.int64()),
        ("time_utc", pa.string()),
        ("best_exposure", pa.int64()),
        ("temperature_c", real),
        *((key, pa.list_(real)) for key in LISTS),
        ("exposures", pa.list_(exposure)),
        ("eclipse", pa.int64()),
        ("intrusion", pa.int64()),
        *((column.name, real) for column in OPTIONAL_COLUMNS[2:]),
    ]
    return pa.schema(fields)


def _unfold(lines: list[bytes], warn: Callable[[str], None]) -> tuple[dict[str, Any], Ints] | None:
    """Return (columns as text, line of every row); None if Arrow balks."""
    if not lines:
        return {column.name: pa.array([], pa.string()) for column in COLUMNS}, _NONE
    table = _parse(lines, "error")
    if table is None:
        table = _parse(lines, "ignore")
        if table is not None:
            _warn_unknown(lines, warn)
    if table is None or table.num_rows != len(lines):
        return None
    frame = {name: table[name].combine_chunks() for name in table.column_names}
    stars = _stars(frame)
    if stars is None or not _regular_lists(frame):
        return None
    star_columns, line = stars
    columns = {name: text.take(pa.array(line)) for name, text in _frame_texts(frame)}
    return columns | star_columns, line


_NONE = np.zeros(0, dtype=np.int64)


def _stars(frame: dict[str, Any]) -> tuple[dict[str, Any], Ints] | None:
    """Return the star columns with one row a star (or a line without stars), and the lines."""
    exposures = frame["exposures"]
    each = exposures.flatten()
    if exposures.null_count or each.null_count or each.field("stars").null_count:
        return None
    lists = each.field("stars")
    detections = lists.flatten()
    if detections.null_count:
        return None
    line_of_exposure = pc.list_parent_indices(exposures).to_numpy()
    exposure_of_star = pc.list_parent_indices(lists).to_numpy()
    line_of_star = line_of_exposure[exposure_of_star]
    counts = np.bincount(line_of_star, minlength=len(exposures))
    rows = np.maximum(counts, 1)
    line = np.repeat(np.arange(len(exposures)), rows)
    is_star = np.repeat(counts > 0, rows)
    place = pa.array(np.cumsum(is_star) - 1, mask=~is_star)
    exposure = pc.cast(each.field("exposure"), pa.string()).take(pa.array(exposure_of_star))
    texts = {"exposure": exposure}
    for column in STAR_COLUMNS[1:]:
        texts[column.name] = pc.cast(detections.field(column.name), pa.string())
    return {name: text.take(place) for name, text in texts.items()}, line


def _regular_lists(frame: dict[str, Any]) -> bool:
    """Whether the quaternion and the rates have their lengths, or are null."""
    return all(
        bool(pc.all(pc.equal(pc.list_value_length(frame[key]), len(names))).as_py() in (True, None))
        for key, names in LISTS.items()
    )


def _frame_texts(frame: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    for name in (*_SCALARS, *(column.name for column in OPTIONAL_COLUMNS)):
        yield name, pc.cast(frame[name], pa.string())
    for key, names in LISTS.items():
        for i, name in enumerate(names):
            yield name, pc.cast(pc.list_element(frame[key], i), pa.string())


def _parse(lines: list[bytes], unknown_keys: str) -> pa.Table | None:
    """Return the lines as Arrow reads them, or None; unknown keys are an error or ignored.

    They must not be inferred: Arrow 26 then makes inconsistent arrays of some lists with nulls.
    """
    try:
        table = arrow_json.read_json(
            io.BytesIO(b"\n".join(lines)),
            read_options=arrow_json.ReadOptions(
                use_threads=False, block_size=sum(map(len, lines)) + len(lines) + 1
            ),
            parse_options=arrow_json.ParseOptions(
                explicit_schema=_schema(), unexpected_field_behavior=unknown_keys
            ),
        )
        table.validate(full=True)
    # Text that is not UTF-8 fails in the making of Arrow's own message.
    except (pa.ArrowException, UnicodeDecodeError):
        return None
    return table


def _warn_unknown(lines: list[bytes], warn: Callable[[str], None]) -> None:
    """Name the unknown keys of the first line that has any: the others will be like it."""
    for line in lines:
        found: list[str] = []
        read_line(line, found.append)
        if found:
            for text in found:
                warn(text)
            return


DECODER = Decoder("jsonl", (".jsonl", ".ndjson"), sniff, decode)
