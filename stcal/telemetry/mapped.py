"""A foreign table as telemetry: columns as a mapping says, to the rows of the long form."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from stcal.errors import ConfigError, InputError
from stcal.frames import Bools, Ints
from stcal.telemetry.columns import COLUMNS
from stcal.telemetry.mapped_stars import Stars, unfold_group
from stcal.telemetry.mapped_values import converted, element
from stcal.telemetry.mapping import (
    STAR_NAMES,
    ColumnMap,
    SourceMapping,
    mapping_document,
    mapping_from_document,
)

# Characters of a column's name in a message.
_SHOWN = 64


@dataclass(frozen=True)
class Rows:
    """A table's rows in the long form.

    Attributes
    ----------
    columns : text by telemetry column, one entry a row of the long form
    record : (n,) the row of the table that each is from
    bad : rows of the table whose lists make no sense, with the reason; they are not in the rest
    """

    columns: dict[str, Any]
    record: Ints
    bad: dict[int, str]


def unfold(table: dict[str, Any], n: int, mapping: SourceMapping) -> Rows:
    """Return the n rows of a table, given as Arrow arrays by column, in the long form.

    Raises
    ------
    InputError
        A column's type is not what the mapping makes of it; the message names the column.
    """
    frame = {name: _frame_column(table, n, name, one) for name, one in mapping.columns.items()}
    if mapping.rows == "star":
        return Rows(_complete(frame, n), np.arange(n), {})
    bad: dict[int, str] = {}
    groups = [unfold_group(table, n, group, bad) for group in mapping.stars]
    good = np.ones(n, dtype=np.bool_)
    good[list(bad)] = False
    return _long_form(frame, groups, n, good, bad)


def _complete(columns: dict[str, Any], n: int) -> dict[str, Any]:
    nothing = pa.nulls(n, pa.string())
    return {column.name: columns.get(column.name, nothing) for column in COLUMNS}


def _frame_column(table: dict[str, Any], n: int, name: str, one: ColumnMap) -> Any:
    if one.column is None:
        column: Any = pa.repeat(str(one.value), n)
    else:
        column = table[one.column]
        if one.index is not None:
            column = element(column, one.index, one.column)
    return converted(column, name, one)


def _long_form(
    frame: dict[str, Any], groups: list[Stars], n: int, good: Bools, bad: dict[int, str]
) -> Rows:
    """Return the stars of all groups by record; a record without stars has one row."""
    record = np.concatenate([group.record for group in groups])
    kept = good[record]
    starless = np.flatnonzero(good & (np.bincount(record[kept], minlength=n) == 0))
    record = np.concatenate([record, starless])
    kept = np.concatenate([kept, np.ones(len(starless), dtype=np.bool_)])
    order = np.argsort(record, kind="stable")
    order = order[kept[order]]
    columns = {name: text.take(pa.array(record[order])) for name, text in frame.items()}
    for name in STAR_NAMES:
        parts = [_part(group, name) for group in groups]
        parts.append(pa.nulls(len(starless), pa.string()))
        columns[name] = pa.concat_arrays(parts).take(pa.array(order))
    return Rows(_complete(columns, len(order)), record[order], bad)


def _part(group: Stars, name: str) -> Any:
    return group.columns.get(name, pa.nulls(len(group.record), pa.string()))


def check_columns(mapping: SourceMapping, there: list[str], where: str) -> None:
    """Refuse a file without the columns that a mapping reads, or with one of them twice.

    Raises
    ------
    InputError
        Naming the file and all such columns.
    """
    missing = [name for name in mapping.sources if name not in there]
    if missing:
        shown = [name if len(name) <= _SHOWN else name[:_SHOWN] + "..." for name in there[:20]]
        known = ", ".join(shown) + (", ..." if len(there) > 20 else "")
        raise InputError(
            f"{where}: mapping {mapping.name!r}: no column(s) {', '.join(missing)}; "
            f"the file has {known}"
        )
    twice = [name for name in mapping.sources if there.count(name) > 1]
    if twice:
        raise InputError(f"{where}: column(s) given more than once: {', '.join(twice)}")


def context_of(mapping: SourceMapping, **more: str) -> bytes:
    """Return what decodes records of a mapped source again, as JSON."""
    return json.dumps({"mapping": mapping_document(mapping), **more}).encode()


def read_context(context: bytes) -> tuple[SourceMapping, dict[str, str]]:
    """Read what :func:`context_of` gave.

    Raises
    ------
    InputError
        It is damaged, or of a mapping that this stcal does not know.
    """
    try:
        document = json.loads(context)
        mapping = mapping_from_document(document.pop("mapping"), "mapping kept in quarantine")
    except (ValueError, KeyError, AttributeError, ConfigError) as error:
        raise InputError(f"the mapping kept in quarantine is damaged: {error}") from None
    return mapping, document
