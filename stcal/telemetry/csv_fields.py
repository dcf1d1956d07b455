"""The fields of unquoted lines without an Arrow string each: frames once a run, stars as numbers.

The rows of a frame repeat its values, twenty times over in a usual file.  Where their bytes repeat
too, they are parsed once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from stcal.frames import Bools, Ints
from stcal.telemetry import csv_kernels as kernels
from stcal.telemetry import values
from stcal.telemetry.columns import COLUMNS, STAR_COLUMNS
from stcal.telemetry.csv_lines import Header, Lines, parse
from stcal.telemetry.typed import Typed

Bytes = NDArray[np.uint8]
Kinds = NDArray[np.int8]

_STARS = {column.name for column in STAR_COLUMNS}
_KEY = ("sensor_id", "frame_id")
_SPACES = b" \t\n\v\f\r"


@dataclass(frozen=True)
class _Cells(Typed):
    """A column whose values were parsed already, and whose texts can still be shown."""

    text: Callable[[int], str]

    def __getitem__(self, i: int) -> Any:
        """Return the text of value i."""
        return pa.scalar(self.text(i))


@dataclass(frozen=True)
class Fields:
    """Where the fields of lines are.

    Attributes
    ----------
    lines, which : the block, and the n lines of it that are rows
    bounds : (n, columns + 1), as :func:`stcal.telemetry.csv_kernels.find_fields` fills them
    """

    lines: Lines
    which: Ints
    header: Header
    data: Bytes
    bounds: NDArray[np.int64]

    def text(self, i: int, place: int) -> str:
        """Return a field without the spaces around it."""
        first, behind = self.bounds[i, place : place + 2].tolist()
        return self.lines.data[first : behind - 1].strip(_SPACES).decode()

    def take(self, which: Ints, name: str) -> Any:
        """Return a column of some of the rows as Arrow strings."""
        return parse(self.lines, self.which[which], self.header, [name])[name]


def find_fields(lines: Lines, which: Ints, header: Header) -> Fields:
    """Return the fields of the lines ``which``, none of which is quoted."""
    data = np.frombuffer(lines.data, np.uint8)
    bounds = np.empty((len(which), len(header.names) + 1), np.int64)
    start, end = lines.start[which], lines.end[which]
    kernels.find_fields(data, start, end, ord(header.delimiter), bounds)
    return Fields(lines, which, header, data, bounds)


def runs_of(fields: Fields, known: list[str]) -> Ints | None:
    """Return the first row of every run; None when the rows of one differ in the frame's bytes."""
    key, frame = (
        np.array([fields.header.place(name) for name in names])
        for names in (_KEY, [name for name in known if name not in _STARS])
    )
    new = np.empty(len(fields.which), np.bool_)
    agree = kernels.begins(fields.data, fields.bounds, key, frame, new)
    return np.flatnonzero(new) if agree else None


def columns_of(fields: Fields, first: Ints, known: list[str]) -> dict[str, Any]:
    """Return the columns: those of the frame a value a run (``first`` row), of the stars a row."""
    frame_names = [name for name in known if name not in _STARS]
    found = parse(fields.lines, fields.which[first], fields.header, frame_names)
    empty = pa.nulls(len(first), pa.string())
    columns = {c.name: found.get(c.name, empty) for c in COLUMNS if c.name not in _STARS}
    return columns | {name: _STAR_COLUMNS[name](fields, name) for name in _STARS}


def _real(fields: Fields, name: str) -> Typed:
    number, kind = _numbers(fields, name)
    return _finished(fields, name, number, kind, values.numbers)


def _exposure(fields: Fields, name: str) -> Typed:
    number, kind = _numbers(fields, name)
    kind[(kind == kernels.PLAIN) & (number != 0) & (number != 1)] = kernels.OTHER
    whole = np.where(kind == kernels.PLAIN, number, 0).astype(np.int64)
    return _finished(fields, name, whole, kind, values.integers)


def _star_id(fields: Fields, name: str) -> Typed:
    code, kind = np.empty(len(fields.which), np.int64), _kinds(fields)
    kernels.hipparcos(fields.data, fields.bounds, fields.header.place(name), code, kind)
    return _finished(fields, name, code, kind, values.star_ids)


_STAR_COLUMNS: dict[str, Callable[[Fields, str], Typed]] = {
    "exposure": _exposure,
    "row_px": _real,
    "col_px": _real,
    "intensity": _real,
    "star_id": _star_id,
}


def _kinds(fields: Fields) -> Kinds:
    return np.empty(len(fields.which), np.int8)


def _numbers(fields: Fields, name: str) -> tuple[Any, Kinds]:
    number, kind = np.empty(len(fields.which)), _kinds(fields)
    kernels.numbers(fields.data, fields.bounds, fields.header.place(name), number, kind)
    return number, kind


def _finished(
    fields: Fields,
    name: str,
    value: Any,
    kind: Kinds,
    parse_texts: Callable[[Any], tuple[Any, Bools]],
) -> Typed:
    """Return the column, with what is not plain parsed in the general way."""
    bad, empty = np.zeros(len(value), np.bool_), kind == kernels.EMPTY
    other = np.flatnonzero(kind == kernels.OTHER)
    if len(other):
        texts = values.strip(fields.take(other, name))
        value[other], bad[other] = parse_texts(texts)
        empty[other] = values.is_empty(texts)
        bad &= ~empty
    place = fields.header.place(name)
    return _Cells(value, bad, empty, lambda i: fields.text(i, place))
