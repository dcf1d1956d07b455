"""The parts of a packet layout: fields and lists of entries, as a TOML file gives them."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import BaseModel, Field, StringConstraints, model_validator

from stcal.config import STRICT, Finite
from stcal.telemetry.columns import FLAGS, FRAME_COLUMNS, OPTIONAL_COLUMNS, UNITS

Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,39}$")]
Order = Literal["big", "little"]

FRAME_FIELDS = tuple(
    c.name for c in (*FRAME_COLUMNS, *OPTIONAL_COLUMNS) if c.name not in ("sensor_id", "time_utc")
)
STAR_FIELDS = ("row_px", "col_px", "intensity", "star_id")
WHOLE_NUMBERS = ("frame_id", "best_exposure", *FLAGS, "star_id")
# Units in which a packet may give a column: value of the column = factor * value + shift.
_CONVERSIONS = {
    "deg/s": {"deg/s": (1.0, 0.0), "rad/s": (57.29577951308232, 0.0)},
    "km": {"km": (1.0, 0.0), "m": (1e-3, 0.0)},
    "km/s": {"km/s": (1.0, 0.0), "m/s": (1e-3, 0.0)},
    "degC": {"degC": (1.0, 0.0), "K": (1.0, -273.15)},
}
_TYPE = re.compile(r"(?P<kind>[uif])(?P<width>[1-9][0-9]?)")


class Section(BaseModel):
    """A table of the file: no key too many, no number as text."""

    model_config = STRICT


class PacketField(Section):
    """One number: ``value = scale * raw + offset``, in ``unit``."""

    name: Name
    # u1 to u64, i2 to i64 (two's complement), f32, f64.
    type: str
    scale: Finite = 1.0
    offset: Finite = 0.0
    unit: str = "1"
    # The raw number that stands for "no value"; NaN only counts as one where it is given here.
    empty: int | float | None = None
    # A field that is 0 where this one means nothing.
    valid_if: Name | None = None
    # hip: a Hipparcos number.  hip-tyc: 32 bits, see packet_stars.py.  0 is "unmatched" in both.
    encoding: Literal["hip", "hip-tyc"] | None = None
    byte_order: Order | None = None
    description: str = ""

    @model_validator(mode="after")
    def _numbers(self) -> PacketField:
        match = _TYPE.fullmatch(self.type)
        if match is None or not _exists(match["kind"], int(match["width"])):
            raise ValueError(f"type {self.type!r} is not u1 to u64, i2 to i64, f32 or f64")
        if self.scale == 0.0:
            raise ValueError("scale is 0")
        if self.byte_order == "little" and self.width % 8:
            raise ValueError(f"type {self.type!r} has no byte order: it is not whole bytes")
        self._check_empty()
        return self

    def _check_empty(self) -> None:
        if self.empty is None or self.kind == "f":
            return
        low = -(2 ** (self.width - 1)) if self.kind == "i" else 0
        if not isinstance(self.empty, int) or not low <= self.empty < low + 2**self.width:
            raise ValueError(f"empty = {self.empty} is no number of type {self.type!r}")

    @property
    def kind(self) -> str:
        """``u``, ``i`` or ``f``."""
        return self.type[0]

    @property
    def width(self) -> int:
        """Bits."""
        return int(self.type[1:])

    @property
    def is_plain(self) -> bool:
        """Whether the value is the raw number."""
        return self.scale == 1.0 and self.offset == 0.0

    @property
    def conversion(self) -> tuple[float, float]:
        """(factor, shift) from the field's unit to its column's."""
        return _CONVERSIONS.get(UNITS.get(self.name, ""), {}).get(self.unit, (1.0, 0.0))

    def unit_problem(self) -> str:
        """Return what is wrong with the unit of a field that becomes a column, or ``''``."""
        column = UNITS[self.name]
        allowed = list(_CONVERSIONS.get(column, {column: None}))
        if self.name == "star_id":
            allowed = ["1"]
        if self.unit in allowed:
            return ""
        return f"{self.name}: unit {self.unit!r} is not {' or '.join(allowed)}"


def _exists(kind: str, width: int) -> bool:
    return width in (32, 64) if kind == "f" else 1 + (kind == "i") <= width <= 64


class PacketList(Section):
    """A list of variable length: stars, or matches that point into a list of stars."""

    holds: Literal["stars", "matches"] = Field(alias="list")
    name: Name
    # The field before the list that says how many entries mean something.
    count: Name
    maximum: Annotated[int, Field(ge=1, le=4096)]
    # Stars: which exposure they belong to, or the field that says it.
    exposure: Annotated[int, Field(ge=0, le=1)] | Name | None = None
    # Matches: the list of stars whose entry ``star`` counts in, from ``first_index``.
    of: Name | None = None
    first_index: Annotated[int, Field(ge=0, le=1)] = 0
    # All ``maximum`` entries are always there, whatever the count.
    always_full: bool = False
    fields: Annotated[list[PacketField], Field(min_length=1)]

    @property
    def stride(self) -> int:
        """Bits of one entry."""
        return sum(field.width for field in self.fields)

    def field(self, name: str) -> PacketField | None:
        """Return the field of this name, None where there is none."""
        return next((field for field in self.fields if field.name == name), None)

    def offset_of(self, name: str) -> int:
        """Return at which bit of an entry a field begins."""
        names = [field.name for field in self.fields]
        return sum(field.width for field in self.fields[: names.index(name)])
