"""The column mapping of a foreign table: one TOML file says which column is what, in which unit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, ValidationError, model_validator

from stcal.config import STRICT, Finite, error_lines
from stcal.errors import ConfigError
from stcal.reading import read_toml
from stcal.telemetry.columns import COLUMNS, STAR_COLUMNS, UNITS
from stcal.telemetry.mapped_time import label_ns

SCHEMA = "stcal.source-mapping/1"
_RAD_DEG = 57.29577951308232
# Telemetry unit -> other units, each as (factor, offset): value * factor + offset.
CONVERSIONS: dict[str, dict[str, tuple[float, float]]] = {
    "deg/s": {
        "rad/s": (_RAD_DEG, 0.0),
        "mrad/s": (_RAD_DEG / 1e3, 0.0),
        "arcsec/s": (1 / 3600, 0.0),
    },
    "degC": {"K": (1.0, -273.15)},
    "km": {"m": (1e-3, 0.0)},
    "km/s": {"m/s": (1e-3, 0.0)},
}
STAR_NAMES = tuple(column.name for column in STAR_COLUMNS)
FRAME_NAMES = tuple(column.name for column in COLUMNS if column.name not in STAR_NAMES)
_REQUIRED_STAR = ("row_px", "col_px")
_EXTENSIONS = {
    "text": (".tsv", ".tsv.gz", ".csv", ".csv.gz", ".txt", ".txt.gz"),
    "arrow": (".parquet", ".arrow", ".feather", ".ipc"),
}
_DELIMITERS = {"tab": "\t", "comma": ",", "semicolon": ";"}

Name = Annotated[str, Field(min_length=1)]


class _Section(BaseModel):
    model_config = STRICT


class ColumnMap(_Section):
    """Where one telemetry column comes from.

    Exactly one of ``column`` (``index``: that element of an array column), ``columns`` (a pattern
    with ``{}`` for the numbers from ``first`` on, ``count`` of them: indexed columns as one list)
    and ``value`` (the same for every row).  A number becomes ``number * scale + offset`` in
    ``unit``, which is then converted; without any of the three it is taken as it is written.
    """

    column: Name | None = None
    columns: Annotated[str, Field(pattern=r"^[^{}]*\{\}[^{}]*$")] | None = None
    value: str | int | float | None = None
    index: Annotated[int, Field(ge=0)] | None = None
    first: Annotated[int, Field(ge=0)] = 0
    count: Annotated[int, Field(ge=1, le=10_000)] | None = None
    unit: str | None = None
    scale: Finite | None = None
    offset: Finite | None = None
    # Texts that stand for "no value", beside the empty one.
    empty: list[str] = []
    # Of star_id: text as telemetry has it; a Hipparcos number, 0 for none; stcal's own code.
    identifier: Literal["text", "hip", "code"] = "text"
    # Of time_utc: ISO 8601 text, a column of timestamps, or a number since an epoch.
    time: Literal["iso", "timestamp", "number"] = "iso"
    time_unit: Literal["s", "ms", "us", "ns"] = "s"
    epoch: str | None = None
    time_scale: Literal["UTC", "TAI", "GPS"] | None = None

    @model_validator(mode="after")
    def _one_place(self) -> ColumnMap:
        places = [p for p in (self.column, self.columns, self.value) if p is not None]
        if len(places) != 1:
            raise ValueError("give exactly one of column, columns and value")
        if (self.columns is None) != (self.count is None):
            raise ValueError("columns and count belong together")
        if self.index is not None and self.column is None:
            raise ValueError("index is an element of an array column: give column")
        if self.scale == 0:
            raise ValueError("scale is zero")
        return self

    @property
    def sources(self) -> list[str]:
        """The columns of the file that are read."""
        if self.columns is not None and self.count is not None:
            last = self.first + self.count
            return [self.columns.replace("{}", str(i)) for i in range(self.first, last)]
        return [] if self.column is None else [self.column]


class StarGroup(_Section):
    """Lists of stars in the row of a frame: those of one exposure, or with the exposure listed.

    ``count`` is a column with how many elements of the lists are valid; without it a list column
    is taken whole, and indexed columns up to the last star whose centroid is not empty.
    """

    exposure: Annotated[int, Field(ge=0, le=1)] | ColumnMap
    row_px: ColumnMap
    col_px: ColumnMap
    intensity: ColumnMap | None = None
    star_id: ColumnMap | None = None
    count: Name | None = None

    @property
    def maps(self) -> dict[str, ColumnMap]:
        """The mapped columns by their telemetry names."""
        listed = {name: getattr(self, name) for name in STAR_NAMES}
        return {name: one for name, one in listed.items() if isinstance(one, ColumnMap)}


class SourceMapping(_Section):
    """A foreign table as telemetry.

    ``format``: ``text`` (delimited, a header line; a Yamcs parameter export is one with tabs) or
    ``arrow`` (Parquet or Arrow IPC).  ``rows``: a row is a ``frame`` with lists of ``stars``, or a
    ``star`` (the long form), whose columns then are in ``columns`` too.
    """

    schema_: Literal["stcal.source-mapping/1"] = Field(alias="schema")
    name: Annotated[str, Field(min_length=1, max_length=100)]
    format: Literal["text", "arrow"]
    delimiter: Literal["tab", "comma", "semicolon"] = "tab"
    rows: Literal["frame", "star"]
    columns: dict[str, ColumnMap]
    stars: list[StarGroup] = []

    @model_validator(mode="after")
    def _complete(self) -> SourceMapping:
        problems = [*self._name_problems(), *self._value_problems()]
        if self.rows == "frame" and not self.stars:
            problems.append("rows are frames: [[stars]] is missing")
        if self.rows == "star" and self.stars:
            problems.append("rows are stars: map their columns in [columns], not in [[stars]]")
        if problems:
            raise ValueError("; ".join(problems))
        return self

    def _name_problems(self) -> list[str]:
        allowed = FRAME_NAMES if self.rows == "frame" else (*FRAME_NAMES, *STAR_NAMES)
        needed = ["sensor_id", "frame_id", "time_utc"]
        needed += [*_REQUIRED_STAR, "exposure"] if self.rows == "star" else []
        unknown = [n for n in self.columns if n not in allowed]
        missing = [n for n in needed if n not in self.columns]
        problems = [f"columns.{name} is not a column of a {self.rows}" for name in unknown]
        return problems + [f"columns.{name} is missing" for name in missing]

    def _value_problems(self) -> list[str]:
        problems = []
        located = [entry for entry in self._located() if entry[1] in UNITS]
        for where, name, one in located:
            problems += [f"{where}: {text}" for text in _problems(name, one)]
            if where.startswith("stars") and name in _REQUIRED_STAR and one.value is not None:
                problems.append(f"{where}: one value for every star makes no sense")
            if where.startswith("columns") and one.columns is not None:
                problems.append(f"{where}: indexed columns are lists: they belong into [[stars]]")
        return problems

    def _located(self) -> list[tuple[str, str, ColumnMap]]:
        found = [(f"columns.{name}", name, one) for name, one in self.columns.items()]
        for i, group in enumerate(self.stars):
            found += [(f"stars.{i}.{name}", name, one) for name, one in group.maps.items()]
        return found

    @property
    def is_text(self) -> bool:
        """Whether the file is text in lines."""
        return self.format == "text"

    @property
    def extensions(self) -> tuple[str, ...]:
        """The endings of such files' names, to find them in a folder."""
        return _EXTENSIONS[self.format]

    @property
    def separator(self) -> str:
        """The character between the fields of a line."""
        return _DELIMITERS[self.delimiter]

    @property
    def sources(self) -> list[str]:
        """The columns of the file that are read, each once."""
        listed = [name for _, _, one in self._located() for name in one.sources]
        listed += [group.count for group in self.stars if group.count is not None]
        return list(dict.fromkeys(listed))


def _problems(name: str, one: ColumnMap) -> list[str]:
    """Return what of a column's map makes no sense for the telemetry column of this name."""
    problems = []
    unit = UNITS[name]
    if one.unit is not None and one.unit != unit and one.unit not in CONVERSIONS.get(unit, {}):
        known = ", ".join([unit, *CONVERSIONS.get(unit, {})])
        problems.append(f"unit {one.unit!r} is not one of: {known}")
    is_number = unit not in ("text", "ISO 8601 UTC")
    if not is_number and (one.scale is not None or one.offset is not None):
        problems.append("scale and offset are for numbers")
    if name != "star_id" and one.identifier != "text":
        problems.append("identifier is for star_id")
    if name != "time_utc":
        given = one.model_fields_set & {"time", "epoch", "time_scale", "time_unit"}
        problems += [f"{key} is for time_utc" for key in sorted(given)]
    elif one.time == "number" and (one.epoch is None or one.time_scale is None):
        problems.append("a number of time needs its epoch and its time_scale")
    elif one.time != "number" and (one.epoch is not None or one.time_unit != "s"):
        problems.append("epoch and time_unit are for numbers of time")
    return problems + _epoch_problems(one)


def _epoch_problems(one: ColumnMap) -> list[str]:
    if one.epoch is None:
        return []
    try:
        label_ns(one.epoch)
    except ValueError as error:
        return [f"epoch: {error}"]
    return []


def load_mapping(path: Path) -> SourceMapping:
    """Read and validate a mapping.

    Raises
    ------
    ConfigError
        Naming the file and every error in it.
    """
    return _validated(read_toml(path), str(path))


def mapping_document(mapping: SourceMapping) -> dict[str, Any]:
    """Return a mapping as a JSON document, without what is as by default."""
    document: dict[str, Any] = mapping.model_dump(by_alias=True, exclude_defaults=True)
    return document


def mapping_from_document(document: Any, where: str) -> SourceMapping:
    """Read what :func:`mapping_document` gave."""
    return _validated(json.loads(json.dumps(document)), where)


def _validated(document: Any, where: str) -> SourceMapping:
    try:
        return SourceMapping.model_validate(document)
    except ValidationError as error:
        raise ConfigError(f"{where}:\n" + "\n".join(error_lines(error))) from None
