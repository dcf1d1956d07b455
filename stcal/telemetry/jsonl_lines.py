"""Read JSON Lines one line at a time: the careful way, for blocks with a line that is broken."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from stcal.frames import Ints
from stcal.telemetry.block import RowBlock
from stcal.telemetry.columns import COLUMNS, OPTIONAL_COLUMNS, STAR_COLUMNS, VECTORS
from stcal.telemetry.quarantine import TRUNCATED, Rejection

LISTS = {"quaternion": VECTORS["q_si"], "rate_deg_s": VECTORS["rate_deg_s"]}
_SCALARS = ("sensor_id", "frame_id", "time_utc", "best_exposure", "temperature_c")
_OPTIONAL = tuple(column.name for column in OPTIONAL_COLUMNS)
FRAME_KEYS = {*_SCALARS, *_OPTIONAL, *LISTS, "exposures"}
STAR_KEYS = tuple(column.name for column in STAR_COLUMNS if column.name != "exposure")
_EXPOSURE_KEYS = ("exposure", "stars")

Row = dict[str, str]


class _NotAFrameError(ValueError):
    """The line is no frame; the message says why, the code is the quarantine's."""

    def __init__(self, message: str, code: str = "bad_json") -> None:
        super().__init__(message)
        self.code = code


@dataclass(frozen=True)
class Lines:
    """The lines of a block that are not blank, without their ends.

    Attributes
    ----------
    number, offset : (n,) of each line in the file, from 1, and in the decompressed bytes
    """

    data: list[bytes]
    number: Ints
    offset: Ints

    def rows(self, columns: dict[str, Any], line: Ints, rejected: list[Rejection]) -> RowBlock:
        """Return the block of rows that were unfolded from ``line`` (n,), an index of lines."""
        return RowBlock(
            columns=columns,
            row=self.number[line],
            run=np.unique(line, return_inverse=True)[1],  # rejected lines leave no gap
            raw=lambda i: self.data[int(line[i])],
            offset=self.offset[line],
            rejected=rejected,
            lines_are_frames=True,
        )


def read_lines(lines: Lines, cut: bool, warn: Callable[[str], None]) -> RowBlock:
    """Return the rows of the lines; the ``cut`` last one and broken ones are rejected."""
    rows: list[Row] = []
    line_of: list[int] = []
    rejected: list[Rejection] = []
    for i, line in enumerate(lines.data):
        last = cut and i == len(lines.data) - 1
        unfolded = _CUT if last else read_line(line, warn)
        if isinstance(unfolded, list):
            rows += unfolded
            line_of += [i] * len(unfolded)
            continue
        row, offset = int(lines.number[i]), int(lines.offset[i])
        rejected.append(Rejection(row, *unfolded, line, offset))
    columns = {
        c.name: pa.array([row.get(c.name, "") for row in rows], pa.string()) for c in COLUMNS
    }
    return lines.rows(columns, np.array(line_of, dtype=np.int64), rejected)


_CUT = (TRUNCATED, "the file ends within this line")


def read_line(line: bytes, warn: Callable[[str], None]) -> list[Row] | tuple[str, str]:
    """Return the rows of one line, or (code, detail) of why it is refused."""
    try:
        text = line.decode("utf-8")
    except UnicodeDecodeError:
        return "bad_encoding", "the line is not UTF-8"
    try:
        document = json.loads(text, object_pairs_hook=_object)
        return list(_rows(document, warn))
    except _NotAFrameError as error:
        return error.code, str(error)
    # ValueError: syntax, or an integer of thousands of digits; RecursionError: deep nesting.
    except (ValueError, RecursionError) as error:
        return "bad_json", f"not JSON: {error}"


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    document = dict(pairs)
    if len(document) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise _NotAFrameError(f"key {twice!r} is given twice")
    return document


def _rows(document: Any, warn: Callable[[str], None]) -> Iterator[Row]:
    frame = _frame(document, warn)
    empty = True
    exposures = document.get("exposures")
    if not isinstance(exposures, list):
        raise _NotAFrameError("exposures is not a list")
    for exposure in exposures:
        if not isinstance(exposure, dict) or not isinstance(exposure.get("stars"), list):
            raise _NotAFrameError("an exposure is not an object with a list of stars")
        _warn_unknown(exposure, _EXPOSURE_KEYS, warn)
        number = _text(exposure.get("exposure"))
        for star in exposure["stars"]:
            if not isinstance(star, dict):
                raise _NotAFrameError("a star is not an object")
            _warn_unknown(star, STAR_KEYS, warn)
            empty = False
            yield frame | {"exposure": number} | {k: _text(star.get(k)) for k in STAR_KEYS}
    if empty:
        yield frame


def _frame(document: Any, warn: Callable[[str], None]) -> Row:
    if not isinstance(document, dict):
        raise _NotAFrameError("the line is not a JSON object")
    _warn_unknown(document, FRAME_KEYS, warn)
    sensor_id = document.get("sensor_id")
    if isinstance(sensor_id, str) and any("\ud800" <= c <= "\udfff" for c in sensor_id):
        raise _NotAFrameError(f"sensor_id is {sensor_id!r}: a lone surrogate", "bad_sensor_id")
    frame = {key: _text(document.get(key)) for key in (*_SCALARS, *_OPTIONAL)}
    for key, names in LISTS.items():
        values = document.get(key)
        if values is None:
            continue
        if not isinstance(values, list) or len(values) != len(names):
            raise _NotAFrameError(f"{key} is not null or a list of {len(names)} numbers")
        frame |= {name: _text(value) for name, value in zip(names, values, strict=True)}
    return frame


def _text(value: Any) -> str:
    """Return a JSON value as the text that the long form would have."""
    if value is None:
        return ""
    text = value if isinstance(value, str) else json.dumps(value)
    # A lone surrogate is valid JSON, but not text.
    return text.encode("utf-8", "backslashreplace").decode()


def _warn_unknown(document: dict[str, Any], known: Any, warn: Callable[[str], None]) -> None:
    for key in document:
        if key not in known:
            warn(f"unknown key ignored: {_text(key)}")
