"""The layout of a telemetry packet: one TOML file, ``stcal.packet-layout/1``, checked in one go.

A packet is a primary header (CCSDS 133.0-B), a time code as its secondary header (CCSDS 301.0-B),
fields and lists in the order of the file, and perhaps a CRC-16.  A field whose name is a telemetry
column becomes that column; any other (a count, a flag, a spare) only takes its place.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, PrivateAttr, Tag, ValidationError, model_validator

from stcal.errors import ConfigError, InputError
from stcal.reading import MAXIMUM_TOML_BYTES, parse_toml, read_bytes
from stcal.telemetry.packet_checks import column_problems, list_problems, name_problems
from stcal.telemetry.packet_fields import Order, PacketField, PacketList, Section
from stcal.telemetry.packet_time import TimeCode

SCHEMA = "stcal.packet-layout/1"
PRIMARY_HEADER_BYTES = 6
CRC_BYTES = 2
IDLE_APID = 2047
LARGEST_PACKET = 65_542


def _tag(value: Any) -> str:
    is_list = "list" in value if isinstance(value, dict) else isinstance(value, PacketList)
    return "list" if is_list else "field"


Item = Annotated[
    Annotated[PacketField, Tag("field")] | Annotated[PacketList, Tag("list")],
    Discriminator(_tag),
]


class PacketLayout(Section):
    """A packet's layout, and which APIDs carry it for which sensor."""

    schema_name: Literal["stcal.packet-layout/1"] = Field(alias="schema")
    name: Annotated[str, Field(min_length=1, max_length=80)]
    description: str = ""
    byte_order: Order = "big"
    error_control: Literal["crc-16", "none"]
    # Sensor -> APID.
    apids: Annotated[dict[str, Annotated[int, Field(ge=0, le=2046)]], Field(min_length=1)]
    # Other APIDs of the same stream, which are stepped over; idle packets always are.
    ignored_apids: list[Annotated[int, Field(ge=0, le=2047)]] | Literal["any"] = Field(
        default_factory=list
    )
    time: TimeCode
    fields: Annotated[list[Item], Field(min_length=1)]
    _source: bytes = PrivateAttr(default=b"")

    @model_validator(mode="after")
    def _whole(self) -> PacketLayout:
        problems = [*name_problems(self), *column_problems(self), *list_problems(self)]
        if not problems and self.largest > LARGEST_PACKET:
            problems = [f"a packet may have {self.largest} bytes, CCSDS allows {LARGEST_PACKET}"]
        if problems:
            raise ValueError("; ".join(problems))
        return self

    @property
    def has_crc(self) -> bool:
        """Whether a packet ends with a CRC-16."""
        return self.error_control == "crc-16"

    @property
    def source(self) -> bytes:
        """The TOML file's own bytes."""
        return self._source

    @cached_property
    def scalars(self) -> tuple[PacketField, ...]:
        """The fields outside lists."""
        return tuple(item for item in self.fields if isinstance(item, PacketField))

    @cached_property
    def lists(self) -> tuple[PacketList, ...]:
        """The lists, in their order."""
        return tuple(item for item in self.fields if isinstance(item, PacketList))

    @cached_property
    def places(self) -> dict[str, tuple[int, int]]:
        """Segment and bit offset of every field outside lists.

        Segment 0 begins with the packet, segment k behind list k - 1.
        """
        found = {}
        segment, bit = 0, 8 * (PRIMARY_HEADER_BYTES + self.time.length)
        for item in self.fields:
            if isinstance(item, PacketList):
                segment, bit = segment + 1, 0
            else:
                found[item.name] = (segment, bit)
                bit += item.width
        return found

    @cached_property
    def segment_bits(self) -> tuple[int, ...]:
        """Bits of each segment."""
        bits = [8 * (PRIMARY_HEADER_BYTES + self.time.length)] + [0] * len(self.lists)
        segment = 0
        for item in self.fields:
            if isinstance(item, PacketList):
                segment += 1
            else:
                bits[segment] += item.width
        return tuple(bits)

    @property
    def smallest(self) -> int:
        """Bytes of a packet whose lists are empty."""
        full = sum(one.stride * one.maximum for one in self.lists if one.always_full)
        return self._bytes(full)

    @property
    def largest(self) -> int:
        """Bytes of a packet whose lists are full."""
        return self._bytes(sum(one.stride * one.maximum for one in self.lists))

    def _bytes(self, list_bits: int) -> int:
        return -(-(sum(self.segment_bits) + list_bits) // 8) + CRC_BYTES * self.has_crc

    def scalar(self, name: str) -> PacketField:
        """Return the field outside lists of this name."""
        return next(field for field in self.scalars if field.name == name)

    def is_little(self, field: PacketField) -> bool:
        """Whether a field's bytes come from the least significant on."""
        return (field.byte_order or self.byte_order) == "little" and field.width % 8 == 0

    @property
    def frames_span_packets(self) -> bool:
        """Whether the exposures of one frame may come in packets of their own."""
        return any(isinstance(one.exposure, str) for one in self.lists)


def parse_layout(content: bytes, where: str) -> PacketLayout:
    """Return the layout that a TOML file's bytes describe; ``where`` names them in errors.

    Raises
    ------
    ConfigError
        With every error in it.
    """
    document = parse_toml(content, where)
    try:
        layout = PacketLayout.model_validate(document)
    except ValidationError as error:
        raise ConfigError(f"{where}:\n" + "\n".join(_lines(error))) from None
    layout._source = content
    return layout


def _lines(error: ValidationError) -> Iterator[str]:
    for item in error.errors():
        parts = [str(part) for part in item["loc"] if part not in ("field", "list")]
        what = item["msg"].removeprefix("Value error, ")
        yield f"  {'.'.join(parts) or 'file'}: {what}"


def load_layout(path: Path) -> PacketLayout:
    """Read and validate a packet layout.

    Raises
    ------
    ConfigError
        Naming the file and every error in it.
    """
    try:
        content = read_bytes(path, MAXIMUM_TOML_BYTES)
    except InputError as error:
        raise ConfigError(str(error)) from None
    return parse_layout(content, str(path))
