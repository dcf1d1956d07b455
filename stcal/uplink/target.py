"""The upload target: one TOML file says how flight software holds a calibration.

The payload is one C structure, the fields in their order.  The same fields make the cFE table, the
F Prime structure, the OpenC3 table and the arguments of the Yamcs command.  What a field holds is

    number on the target = value / unit + offset        (floating-point words)
    count on the target  = (value / unit + offset) / scale      (integer words)

with the value in SI (or px) as the calibration file has it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, field_validator, model_validator

from stcal.cameras import CAMERAS
from stcal.config import Finite, Positive
from stcal.errors import ConfigError
from stcal.reading import read_toml
from stcal.uplink.target_fields import field_problems, whole_problems
from stcal.uplink.target_sections import (
    Ascii,
    CfeSection,
    FprimeSection,
    Openc3Section,
    Section,
    YamcsSection,
)

SCHEMA = "stcal.upload-target/1"

Word = Literal[
    "float32", "float64", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"
]


class TargetDetector(Section):
    """What the flight software has compiled in; a calibration of another detector is refused."""

    rows: Annotated[int, Field(ge=2)] | None = None
    cols: Annotated[int, Field(ge=2)] | None = None
    pixel_size_m: Positive | None = None


class TableSection(Section):
    """The structure in the target's memory."""

    byte_order: Literal["big", "little"]
    # Largest alignment that the compiler gives a member; 1: packed.
    alignment: Literal[1, 2, 4, 8] = 8
    # Where given, the structure must have this size: what sizeof says on the target.
    size_bytes: Annotated[int, Field(ge=1)] | None = None


class TableField(Section):
    """One member of the structure.

    ``value``: a camera parameter, ``serial``, ``rows``, ``cols``, ``pixel_size_m``; ``c_sd``, nine
    elements; ``q_sd`` or ``q_ds``, four elements with ``A(q_sd) = c_sd`` (the convention of
    ``q_si``) or its conjugate, real part not negative; ``constant``; ``padding``, ``count`` bytes
    of zero, which F Prime and Yamcs leave out.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$", max_length=60)]
    value: str
    word: Word = "uint8"
    # None: the unit of the value, in SI.
    unit: str | None = None
    # In the field's unit: 1.0 for a principal point counted from one.
    offset: Finite = 0.0
    # Value of one count, in the field's unit; or 2^-fraction_bits.
    scale: Positive | None = None
    fraction_bits: Annotated[int, Field(ge=0, le=63)] | None = None
    order: Literal["row", "column", "xyzw", "wxyz"] | None = None
    constant: int | None = None
    count: Annotated[int, Field(ge=1, le=4096)] | None = None
    # Limits of the number on the target, in the field's unit (offset included, scale not).
    minimum: Finite | None = None
    maximum: Finite | None = None

    @model_validator(mode="after")
    def _consistent(self) -> TableField:
        problems = list(field_problems(self))
        if problems:
            raise ValueError("; ".join(problems))
        return self

    @property
    def is_float(self) -> bool:
        """Whether the word is a floating-point number."""
        return self.word.startswith("float")


class RoundingSection(Section):
    """What the target's words may cost."""

    # Largest angle between star vectors before and after rounding, as a part of the fit's RMS.
    maximum_part_of_rms: Annotated[float, Field(gt=0, le=1)]


class Target(Section):
    """One upload target, as its TOML file describes it."""

    schema_: Literal["stcal.upload-target/1"] = Field(alias="schema")
    name: Ascii
    sensor_ids: Annotated[list[Annotated[str, Field(min_length=1)]], Field(min_length=1)]
    model: str
    detector: TargetDetector = TargetDetector()
    table: TableSection
    members: Annotated[list[TableField], Field(min_length=1, alias="field")]
    rounding: RoundingSection
    cfe: CfeSection | None = None
    fprime: FprimeSection | None = None
    openc3: Openc3Section | None = None
    yamcs: YamcsSection | None = None

    @field_validator("model")
    @classmethod
    def _known_model(cls, model: str) -> str:
        if model not in CAMERAS:
            raise ValueError(f"{model!r} is not known; known: {', '.join(CAMERAS)}")
        return model

    def applies_to(self, sensor_id: str) -> bool:
        """Whether calibrations of this sensor are for this target."""
        return any(fnmatchcase(sensor_id, pattern) for pattern in self.sensor_ids)


def load_target(path: Path) -> Target:
    """Read and validate an upload target.

    Raises
    ------
    ConfigError
        Naming the file and every error in it.
    """
    document = read_toml(path)
    lines: list[str] = []
    target = None
    try:
        target = Target.model_validate(document)
    except ValidationError as error:
        lines = [_line(item, document) for item in error.errors()]
    lines += [f"  {problem}" for problem in whole_problems(document)]
    if target is not None:
        lines += [f"  {problem}" for problem in _size_problems(target)]
    if lines or target is None:
        raise ConfigError(f"{path}:\n" + "\n".join(lines))
    return target


def _size_problems(target: Target) -> Iterator[str]:
    from stcal.uplink.formats.words import layout

    _, size = layout(target)
    declared = target.table.size_bytes
    if declared is not None and declared != size:
        yield f"table.size_bytes is {declared}; the fields make a structure of {size} bytes"


def target_sha256(target: Target) -> str:
    """Return the hex SHA-256 of the target's canonical JSON."""
    return hashlib.sha256(target.model_dump_json(by_alias=True).encode()).hexdigest()


def _line(item: Any, document: dict[str, Any]) -> str:
    place = list(item["loc"])
    if place[:1] == ["field"] and len(place) > 1:
        section = document["field"][place[1]]
        # The field's name says more than its number.
        place[1] = section.get("name", place[1]) if isinstance(section, dict) else place[1]
    where = ".".join(map(str, place)) or "file"
    return f"  {where}: {item['msg'].removeprefix('Value error, ')}"
