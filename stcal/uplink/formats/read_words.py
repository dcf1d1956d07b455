"""Decoders' side of the words: what a reader of the bytes takes them for.

Written apart from the encoders, with which it shares no code: its own layout, units and orders.
All numbers are exact.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from math import isfinite, pi

from stcal.uplink.decode import DecodeError
from stcal.uplink.target import TableField, Target

# word -> (bytes, exponent bits; 0 of an integer, signed)
_WORDS = {
    "float32": (4, 8, True), "float64": (8, 11, True),
    "int8": (1, 0, True), "int16": (2, 0, True), "int32": (4, 0, True), "int64": (8, 0, True),
    "uint8": (1, 0, False), "uint16": (2, 0, False), "uint32": (4, 0, False),
    "uint64": (8, 0, False),
}  # fmt: skip
_ARCSEC_PER_TURN = 1296000
# What one of the unit is in SI.
_SI = {
    "1": Fraction(1), "px": Fraction(1), "m": Fraction(1), "rad": Fraction(1),
    "mm": Fraction("0.001"), "um": Fraction("0.000001"),
    "mrad": Fraction("0.001"), "urad": Fraction("0.000001"),
    "deg": 2 * Fraction(pi) / 360, "arcsec": 2 * Fraction(pi) / _ARCSEC_PER_TURN,
}  # fmt: skip


@dataclass(frozen=True)
class Place:
    """Where a number lies: label, what it means, field, first byte, bytes."""

    label: str
    meaning: str
    field: TableField
    offset: int
    size: int


@dataclass(frozen=True)
class Reading:
    """A number as the target reads it.

    Attributes
    ----------
    number : the float or the count
    value : in SI or pixels, exact
    below, above : the values of the neighbouring words; None beyond the last one
    even : whether the last bit of the word is zero
    """

    place: Place
    number: float | int
    value: Fraction
    below: Fraction | None
    above: Fraction | None
    even: bool


def places(target: Target, packed: bool = False) -> tuple[list[Place], int]:
    """Return where each number of the structure lies, and the size of it.

    ``packed``: as F Prime serialises it, without padding.
    """
    result: list[Place] = []
    here, strictest = 0, 1
    for field in target.members:
        if field.value == "padding":
            here += 0 if packed else int(field.count or 0)
            continue
        size = _WORDS[field.word][0]
        step = 1 if packed else min(target.table.alignment, size)
        strictest = max(strictest, step)
        for label, meaning in _parts(field):
            while here % step:
                here += 1
            result.append(Place(label, meaning, field, here, size))
            here += size
    while here % strictest:
        here += 1
    return result, here


def _parts(field: TableField) -> Iterator[tuple[str, str]]:
    name, value = field.name, field.value
    if value == "c_sd":
        for k in range(9):
            i, j = divmod(k, 3)
            element = f"{j + 1}{i + 1}" if field.order == "column" else f"{i + 1}{j + 1}"
            yield f"{name}_{element}", f"c_sd_{element}"
    elif value in ("q_sd", "q_ds"):
        for axis in "wxyz" if field.order == "wxyz" else "xyzw":
            yield f"{name}_{axis}", f"{value}_{axis}"
    else:
        yield name, value


def read_numbers(
    content: bytes, target: Target, packed: bool = False, clean: bool = True
) -> list[Reading]:
    """Return every number of a structure.

    ``clean`` : whether padding must be zero, as in a file; memory may hold anything there.

    Raises
    ------
    DecodeError
        When the size is another, padding is not zero, or a number is not finite.
    """
    found, size = places(target, packed)
    if len(content) != size:
        raise DecodeError(f"the structure has {len(content)} bytes, the target's has {size}")
    big = packed or target.table.byte_order == "big"
    used = set[int]()
    readings = []
    for place in found:
        used.update(range(place.offset, place.offset + place.size))
        word = content[place.offset : place.offset + place.size]
        readings.append(reading(place, word if big else word[::-1]))
    dirty = [k for k, byte in enumerate(content) if byte and k not in used]
    if dirty and clean:
        raise DecodeError(f"padding at byte {dirty[0]} is {content[dirty[0]]:#04x}, not zero")
    return readings


def reading(place: Place, word: bytes) -> Reading:
    """Return what a word (most significant byte first) says.

    Raises
    ------
    DecodeError
        When the number is not finite, or a negative zero.
    """
    pattern = int.from_bytes(word, "big")
    number = number_of(place.field, word)
    if isinstance(number, float):
        if not isfinite(number):
            raise DecodeError(f"{place.label} is {number!r}")
        if number == 0.0 and pattern:
            raise DecodeError(f"{place.label} is a negative zero")
    around = (_neighbour(place.field, word, up) for up in (False, True))
    below, above = (None if n is None else _value(place.field, n) for n in around)
    return Reading(place, number, _value(place.field, number), below, above, not pattern & 1)


def word_of(place: Place, number: float | int) -> bytes:
    """Return the word that holds a number exactly, most significant byte first.

    Raises
    ------
    DecodeError
        When no such word exists.
    """
    size, exponent_bits, signed = _WORDS[place.field.word]
    try:
        if exponent_bits:
            word = struct.pack(">f" if size == 4 else ">d", number)
        else:
            word = int.to_bytes(number, size, "big", signed=signed)  # type: ignore[arg-type]
    except (OverflowError, TypeError, struct.error):
        word = b""
    if not word or number_of(place.field, word) != number:
        raise DecodeError(f"{place.label}: {number!r} is no {place.field.word}")
    return word


def number_of(field: TableField, word: bytes) -> float | int:
    """Return the float or the count of a word, most significant byte first."""
    size, exponent_bits, signed = _WORDS[field.word]
    if exponent_bits:
        return float(struct.unpack(">f" if size == 4 else ">d", word)[0])
    return int.from_bytes(word, "big", signed=signed)


def _neighbour(field: TableField, word: bytes, up: bool) -> float | int | None:
    """Return the next number of the word; None where there is none."""
    size, exponent_bits, signed = _WORDS[field.word]
    pattern, bits = int.from_bytes(word, "big"), 8 * size
    if not exponent_bits:
        count = int.from_bytes(word, "big", signed=signed) + (1 if up else -1)
        lowest = -(1 << (bits - 1)) if signed else 0
        return count if lowest <= count < lowest + (1 << bits) else None
    # Floats are ordered as sign and magnitude.
    sign = 1 << (bits - 1)
    if pattern & ~sign == 0:
        pattern = 1 if up else sign | 1
    else:
        pattern += 1 if up == (pattern < sign) else -1
    number = float(number_of(field, pattern.to_bytes(size, "big")))
    return number if isfinite(number) else None


def _value(field: TableField, number: float | int) -> Fraction:
    """Return a number on the target in SI or pixels."""
    in_unit = Fraction(number)
    if field.fraction_bits is not None:
        in_unit /= 1 << field.fraction_bits
    elif field.scale is not None:
        in_unit *= Fraction(Decimal(repr(field.scale)))
    in_unit -= Fraction(Decimal(repr(field.offset)))
    return in_unit * _one(field.unit)


def _one(unit: str | None) -> Fraction:
    """Return one of a unit in SI; values without a unit of their own are in SI already."""
    if unit is None:
        return Fraction(1)
    base, inverse, power = unit.partition("^-")
    return Fraction(1) / _SI[base] ** int(power) if inverse else _SI[base]


def by_meaning(readings: list[Reading]) -> Mapping[str, Fraction]:
    """Return the values by what they mean, constants left out."""
    return {r.place.meaning: r.value for r in readings if r.place.meaning != "constant"}
