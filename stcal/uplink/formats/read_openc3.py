"""Decoder of an OpenC3 table definition, as Table Manager makes a binary of it.

Shares no code with the encoder.  Strict: anything but what the encoder is meant to write is an
error.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass, replace

from stcal.uplink.decode import DecodeError

_TABLE = re.compile(r'TABLE "([A-Z][A-Z0-9_]*)" (BIG|LITTLE)_ENDIAN KEY_VALUE "([^"]+)"')
_ITEM = re.compile(
    r'  APPEND_PARAMETER "([A-Z][A-Z0-9_]*)" (8|16|32|64) (INT|UINT|FLOAT)'
    r' (MIN|\S+) (MAX|\S+) (\S+) "([^"]+)"'
)
_UNITS = re.compile(r'    UNITS "([^"]+)" "([^"]+)"')


@dataclass(frozen=True)
class Item:
    """One item of the table with its default; ``flags`` are UNEDITABLE and HIDDEN."""

    name: str
    bits: int
    kind: str
    lowest: float | int | None
    highest: float | int | None
    default: float | int
    description: str
    unit: str | None = None
    flags: tuple[str, ...] = ()

    @property
    def word(self) -> bytes:
        """The default as a word, most significant byte first."""
        if self.kind == "FLOAT":
            return struct.pack(">f" if self.bits == 32 else ">d", self.default)
        return int(self.default).to_bytes(self.bits // 8, "big", signed=self.kind == "INT")


@dataclass(frozen=True)
class Definition:
    """The comments, the table's name, byte order and description, and its items."""

    comments: tuple[str, ...]
    table: str
    byte_order: str
    description: str
    items: tuple[Item, ...]

    def binary(self) -> bytes:
        """Return what Table Manager generates: every default in its place.

        Raises
        ------
        DecodeError
            When a default does not fit its item.
        """
        content = b""
        for item in self.items:
            try:
                word = item.word
            except (OverflowError, struct.error) as error:
                raise DecodeError(f"OpenC3 table: default of {item.name}: {error}") from None
            content += word if self.byte_order == "big" else word[::-1]
        return content


def read_definition(content: bytes) -> Definition:
    """Read a table definition.

    Raises
    ------
    DecodeError
        Naming the line that is not understood.
    """
    try:
        text = content.decode("ascii")
    except UnicodeDecodeError as error:
        raise DecodeError(f"OpenC3 table: byte {error.start} is not ASCII") from None
    if not text.endswith("\n"):
        raise DecodeError("OpenC3 table: the last line has no end")
    lines = text[:-1].split("\n")
    comments = [line for line in lines if line.startswith("# ")]
    if lines[: len(comments)] != comments or len(lines) <= len(comments):
        raise DecodeError("OpenC3 table: a comment is not where comments are, or nothing follows")
    table = _TABLE.fullmatch(lines[len(comments)])
    if table is None:
        raise DecodeError(f"OpenC3 table: line {len(comments) + 1}: {lines[len(comments)]!r}")
    items: list[Item] = []
    for number, line in enumerate(lines[len(comments) + 1 :], start=len(comments) + 2):
        _take(line, number, items)
    name, order, description = table.groups()
    return Definition(tuple(comments), name, order.lower(), description, tuple(items))


def _take(line: str, number: int, items: list[Item]) -> None:
    """Add the item of a line, or what the line says of the last one."""
    item, units = _ITEM.fullmatch(line), _UNITS.fullmatch(line)
    try:
        if item is not None:
            items.append(_item(*item.groups()))
        elif units is not None and units[1] == units[2] and items[-1].unit is None:
            items[-1] = replace(items[-1], unit=units[1])
        elif line in ("    UNEDITABLE", "    HIDDEN") and line.strip() not in items[-1].flags:
            items[-1] = replace(items[-1], flags=(*items[-1].flags, line.strip()))
        else:
            raise ValueError(line)
    except (ValueError, IndexError) as error:
        raise DecodeError(f"OpenC3 table: line {number}: {error}") from None


def _item(
    name: str, bits: str, kind: str, lowest: str, highest: str, default: str, description: str
) -> Item:
    return Item(
        name, int(bits), kind,
        None if lowest == "MIN" else _number(lowest, kind),
        None if highest == "MAX" else _number(highest, kind),
        _number(default, kind), description,
    )  # fmt: skip


def _number(text: str, kind: str) -> float | int:
    """Return a number that is written in its shortest form."""
    number: float | int = float(text) if kind == "FLOAT" else int(text)
    if repr(number) != text:
        raise ValueError(f"{text} is not written as {number!r}")
    return number
