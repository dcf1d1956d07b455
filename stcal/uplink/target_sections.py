"""Sections of an upload target's TOML file, one for each file format."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    Field,
    field_validator,
    model_validator,
)

from stcal.config import STRICT, Finite
from stcal.times import parse_utc

U32 = Annotated[int, Field(ge=0, lt=2**32)]


def _ascii(text: str) -> str:
    # OpenC3 runs definitions through ERB, which takes <% for code.
    if not (text.isascii() and text.isprintable()) or '"' in text or "<%" in text:
        raise ValueError('is not printable ASCII without " and <%')
    return text


def _utc(text: str) -> str:
    parse_utc(text)
    return text


def _file_name(text: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]*", text):
        raise ValueError("is not a plain file name of letters, digits, and _ . -")
    return text


Ascii = Annotated[str, Field(min_length=1), AfterValidator(_ascii)]
FileName = Annotated[str, Field(max_length=100), AfterValidator(_file_name)]


class Section(BaseModel):
    """A part of the file: nothing unknown in it, every type as declared."""

    model_config = STRICT


class CfeSection(Section):
    """A cFE table image."""

    file: FileName
    # As registered: application and table, "APP.TABLE".
    table_name: Annotated[Ascii, Field(max_length=39)]
    description: Annotated[Ascii, Field(max_length=31)]
    spacecraft_id: U32
    processor_id: U32
    application_id: U32 = 0
    # The header's time is the end of the fitted data since this epoch; zero without one.
    epoch_utc: Annotated[str, AfterValidator(_utc)] | None = None
    time_scale: Literal["tai", "utc"] = "tai"


class FprimeSection(Section):
    """An F Prime parameter file with the fields as one structure."""

    file: FileName
    parameter_id: U32
    # The CRC that PrmDb of version 4 and later expects first.
    crc_prefix: bool = True


class Openc3Section(Section):
    """A table definition of OpenC3's Table Manager, and its binary."""

    definition: FileName
    binary: FileName
    # The COSMOS target whose tables folder the files belong into.
    target: Annotated[str, Field(pattern=r"^[A-Z][A-Z0-9_]*$", max_length=60)]
    table: Annotated[str, Field(pattern=r"^[A-Z][A-Z0-9_]*$", max_length=60)]
    description: Ascii

    @field_validator("definition")
    @classmethod
    def _not_partial(cls, name: str) -> str:
        if name.startswith("_") or not name.endswith(".txt"):
            raise ValueError("must end in .txt and not begin with _, which OpenC3 passes over")
        return name


class YamcsCommand(Section):
    """One command of the stack."""

    name: Annotated[Ascii, Field(pattern=r"^/")]
    # Whether the table's fields are arguments, after the constant ones.
    calibration: bool = False
    # Where given, the fields are members of this one argument, arrays as lists, as F Prime's
    # PRM_SET has it; otherwise each number is an argument.
    argument: Ascii | None = None
    arguments: dict[Ascii, str | bool | int | Finite] = {}
    comment: Ascii | None = None
    # Acknowledgment that the next command waits for, and how long it waits after it.
    acknowledgment: Ascii | None = None
    wait_ms: Annotated[int, Field(ge=0)] | None = None

    @model_validator(mode="after")
    def _argument_of_calibration(self) -> YamcsCommand:
        if self.argument is not None and not self.calibration:
            raise ValueError("argument goes with calibration = true")
        return self


class YamcsSection(Section):
    """A Yamcs command stack."""

    file: Annotated[FileName, Field(pattern=r"\.ycs$")]
    # Told in the comment of the command that carries the calibration.
    instance: Ascii
    commands: Annotated[list[YamcsCommand], Field(min_length=1)]

    @model_validator(mode="after")
    def _one_calibration(self) -> YamcsSection:
        if sum(command.calibration for command in self.commands) != 1:
            raise ValueError("exactly one command must have calibration = true")
        return self
